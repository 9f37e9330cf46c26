// energy.cpp -- see energy.h.
//
// Filters are chains of sections in the operator d = z - 1, (b0 d^2 + b1 d + b2) / (d^2 + a1 d + a2), whose coefficients
// keep their relative precision in float however slow the poles are. So does the forgetting as x - k x with k = 1 - rho^2.
#include "lpvguard/energy.h"

#include <Eigen/Core>

#include <cmath>

namespace {

using Real = lpvg_real_t;
constexpr int ny = LPVG_NY;
template <int N>
using Row = Eigen::Array<Real, N, 1>;

// One section for N signals: values in place, state[2][N].
template <int N>
void section(const Real* c, Row<N>& x, Real (*state)[N]) {
    Eigen::Map<Row<N>> first(state[0]), second(state[1]);
    const Row<N> y = c[0] * x + first;
    first += c[1] * x - c[3] * y + second;
    second += c[2] * x - c[4] * y;
    x = y;
}

void add(Real* gram, const Real* x, Real forget) {
    std::size_t k = 0;
    for (std::size_t i = 0; i < LPVG_NY; ++i) {
        for (std::size_t j = i; j < LPVG_NY; ++j, ++k) {
            gram[k] += x[i] * x[j] - forget * gram[k];
        }
    }
}

// sqrt(a' G a); rounding may leave a small negative number where a direction carries nothing.
Real norm(const Real* gram, const Real* a) {
    Real sum = Real(0);
    std::size_t k = 0;
    for (std::size_t i = 0; i < LPVG_NY; ++i) {
        Real row = Real(0.5) * a[i] * gram[k++];
        for (std::size_t j = i + 1U; j < LPVG_NY; ++j, ++k) {
            row += a[j] * gram[k];
        }
        sum += a[i] * row;
    }
    return sum > Real(0) ? std::sqrt(Real(2) * sum) : Real(0);
}

}  // namespace

extern "C" void lpvg_energy_start(lpvg_energy_t* self, const lpvg_coeff_t* coeff) {
    *self = lpvg_energy_t{};
    std::size_t k = 0;
    for (std::size_t i = 0; i < LPVG_NY; ++i) {
        self->right[k] = coeff->reals.energy_start[i];
        k += LPVG_NY - i;
    }
}

extern "C" void lpvg_energy_advance(lpvg_energy_t* self, const lpvg_coeff_t* coeff, const lpvg_real_t* signal, bool settled) {
    const lpvg_coeff_reals_t& r = coeff->reals;
    const Row<ny> scale = Eigen::Map<const Row<ny>>(r.energy_scale);
    Row<2 * ny> filtered = Eigen::Map<const Row<2 * ny>>(signal);
    filtered.template head<ny>() *= scale;
    filtered.template tail<ny>() *= scale;
    section<2 * ny>(r.energy_F, filtered, self->F);
    Row<ny> weighted = filtered.template tail<ny>();
    for (std::size_t s = 0; s < LPVG_NWEIGHT; ++s) {
        section<ny>(r.energy_W[s], weighted, self->W[s]);
    }
    add(self->right, weighted.data(), r.energy_forget);
    if (settled) {
        add(self->left, filtered.data(), r.energy_forget);
        add(self->nominal, filtered.data() + ny, r.energy_forget);
    }
}

extern "C" lpvg_real_t lpvg_energy_judge(lpvg_energy_t* self, const lpvg_coeff_t* coeff) {
    const lpvg_coeff_reals_t& r = coeff->reals;
    self->direction = self->next_direction;
    self->next_direction = self->direction + 1U < LPVG_NDIRECTIONS ? self->direction + 1U : 0U;
    const Real* a = r.energy_direction[self->direction];
    self->ratio = norm(self->left, a) / (norm(self->right, a) + Real(1));
    return self->ratio;
}

extern "C" lpvg_real_t lpvg_energy_evidence(const lpvg_energy_t* self, const lpvg_coeff_t* coeff) {
    const Real* a = coeff->reals.energy_direction[self->direction];
    return norm(self->nominal, a) / (norm(self->right, a) + Real(1));
}
