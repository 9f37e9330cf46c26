// change.cpp -- see change.h.
//
// The regressors are divided by their sizes on the bound-setting drives, so the prior is a correlation matrix times a weight and the
// normal equations are well conditioned in float.
#include "lpvguard/change.h"

#include <limits>

#include "acceptance.hpp"
#include "eigen.hpp"

namespace {

using Real = lpvg_real_t;
constexpr std::size_t ny = LPVG_NY;
constexpr int parts = 3;
template <int N>
using Row = Eigen::Array<Real, N, 1>;
constexpr Real beyond = std::numeric_limits<Real>::infinity();

// Solves A x = b by Cholesky without roots. A is symmetric and positive definite, stored as its upper triangle row by row.
Row<parts> solution(const Row<6>& A, const Row<parts>& b) {
    const Real first = Real(1) / A[0];
    const Real p = A[1] * first, q = A[2] * first;
    const Real m = A[4] - p * A[2];
    const Real second = Real(1) / (A[3] - p * A[1]);
    const Real r = m * second;
    const Real y = b[1] - p * b[0];
    const Real x2 = (b[2] - q * b[0] - r * y) / (A[5] - q * A[2] - r * m);
    const Real x1 = y * second - r * x2;
    return {b[0] * first - p * x1 - q * x2, x1, x2};
}

}  // namespace

extern "C" void lpvg_change_start(lpvg_change_t* self) {
    *self = lpvg_change_t{};  // the check sum of zeros is 0
}

extern "C" void lpvg_change_take(lpvg_change_t* self, const lpvg_real_t* signal) {
    using Signals = Eigen::Array<Real, 2 * LPVG_NY, 1>;
    Signals sum = Eigen::Map<const Signals>(signal);
    for (std::size_t k = 1; k < LPVG_NBLOCK; ++k) {
        sum += Eigen::Map<const Signals>(signal + 2U * ny * k);
    }
    Eigen::Map<Signals>(self->mean) = sum * (Real(1) / Real(LPVG_NBLOCK));
    self->begun = self->pending > 0U ? 0U : self->begun;
    self->pending = ny;
}

extern "C" lpvg_real_t lpvg_change_judge(lpvg_change_t* self, const lpvg_coeff_t* coeff) {
    const lpvg_coeff_reals_t& r = coeff->reals;
    const std::size_t j = ny - (self->pending - 1U < ny ? self->pending : 1U);
    lpvg_change_output_t& of = self->output[j];
    if (self->sum[j] != lpvguard::sum_of_words(of)) {
        lpvg_change_start(self);
        return Real(0);
    }
    const Real e = self->mean[j], yhat = self->mean[ny + j];
    const Row<parts> phi(yhat * r.change_unit[j][0], (of.before - yhat) * r.change_unit[j][1], Real(1));
    of.before = yhat;
    Eigen::Map<Row<6>> gram(of.gram);
    Eigen::Map<Row<parts>> along(of.along);
    if (self->begun != 0U) {
        Row<6> products;
        products << phi[0] * phi[0], phi[0] * phi[1], phi[0], phi[1] * phi[1], phi[1], Real(1);
        gram += products - r.change_forget * gram;
        along += phi * e - r.change_forget * along;
    }
    const Row<6> A = gram + Eigen::Map<const Row<6>>(r.change_prior[j]);
    const Row<parts> theta = solution(A, along);
    self->sum[j] = lpvguard::sum_of_words(of);
    self->pending = static_cast<uint32_t>(ny - 1U - j);
    self->begun = self->pending == 0U ? 1U : self->begun;
    const Row<parts> ratios = theta.abs() * Eigen::Map<const Row<parts>>(r.change_scale[j]);
    self->ratio = Real(0);
    self->strongest = static_cast<uint32_t>(parts * j);
    for (uint32_t i = 0; i < parts; ++i) {
        if (!(ratios[i] <= self->ratio)) {
            self->ratio = ratios[i] < beyond ? ratios[i] : beyond;
            self->strongest = static_cast<uint32_t>(parts * j) + i;
        }
    }
    self->estimate[0] = theta[0] * r.change_unit[j][0];
    self->estimate[1] = theta[1] * r.change_unit[j][1] * r.change_block_s;
    self->estimate[2] = theta[2];
    return self->ratio;
}
