// energy.cpp -- see energy.h.
//
// W_delta is a chain of sections (b0 d^2 + b1 d + b2) / (d^2 + a1 d + a2) in the operator d = z - 1. Their coefficients keep
// their relative precision in float, however slow the poles are. So does the forgetting as x - k x with k = 1 - rho^2.
//
// The bands are made by a low-pass at each corner and differences, so they sum to the signal itself. W_delta commutes with them and acts
// first, once for all bands. With one Delta an output the directions are single outputs, and each has its own W_delta.
#include "lpvguard/energy.h"

#include <cmath>
#include <limits>

#include "eigen.hpp"

namespace {

using Real = lpvg_real_t;
constexpr int ny = LPVG_NY;
constexpr int group = LPVG_NY / LPVG_NDELTA;  // outputs that one Delta is common to
constexpr std::size_t last = LPVG_NBANDS - 1;
constexpr Real beyond = std::numeric_limits<Real>::infinity();
template <int N>
using Row = Eigen::Array<Real, N, 1>;

// One section for the outputs of one Delta: values in place.
void section(const Real* c, Real* values, Real* before, Real* before_that) {
    Eigen::Map<Row<group>> x(values), first(before), second(before_that);
    const Row<group> y = c[0] * x + first;
    first += c[1] * x - c[3] * y + second;
    second += c[2] * x - c[4] * y;
    x = y;
}

// The signals below a corner: a pole by the trapezoidal rule.
template <int N>
Row<N> low_pass(Real g, const Row<N>& x, Real* state) {
    Eigen::Map<Row<N>> s(state);
    const Row<N> half_step = g * (x - s);
    const Row<N> y = s + half_step;
    s = y + half_step;
    return y;
}

void add(Real* gram, const Real* x, Real forget) {
    std::size_t k = 0;
    for (std::size_t i = 0; i < LPVG_NY; ++i) {
        for (std::size_t j = i; j < LPVG_NY; ++j, ++k) {
            gram[k] += x[i] * x[j] - forget * gram[k];
        }
    }
}

// Direction a in a band, divided by the band's sigma.
Row<ny> direction(const lpvg_coeff_reals_t& r, std::size_t index, std::size_t band) {
    return Eigen::Map<const Row<ny>>(r.energy_direction[index]) * Eigen::Map<const Row<ny>>(r.energy_scale[band]);
}

// sqrt(a' G a); rounding may leave a small negative number where a direction carries nothing. What is not finite stays so.
Real norm(const Real* gram, const Row<ny>& along) {
    const Real* const a = along.data();
    Real sum = Real(0);
    std::size_t k = 0;
    for (std::size_t i = 0; i < LPVG_NY; ++i) {
        Real row = Real(0.5) * a[i] * gram[k++];
        for (std::size_t j = i + 1U; j < LPVG_NY; ++j, ++k) {
            row += a[j] * gram[k];
        }
        sum += a[i] * row;
    }
    return sum <= Real(0) ? Real(0) : std::sqrt(Real(2) * sum);
}

// The right side in direction a of a band; `faded` is rho^(T - t0 + 1).
inline Real right_side(const lpvg_energy_band_t& band, const Real* start, Real faded, const Row<ny>& a) {
    return norm(band.right, a) + faded * (a.abs() * Eigen::Map<const Row<ny>>(start)).sum() + Real(1);
}

}  // namespace

extern "C" void lpvg_energy_start(lpvg_energy_t* self) {
    *self = lpvg_energy_t{};
    self->fading = Real(1);
}

extern "C" void lpvg_energy_advance(lpvg_energy_t* self, const lpvg_coeff_t* coeff, const lpvg_real_t* signal, bool settled) {
    const lpvg_coeff_reals_t& r = coeff->reals;
    Row<3 * ny> whole;  // e, yhat, W_delta yhat
    whole.template head<2 * ny>() = Eigen::Map<const Row<2 * ny>>(signal);
    whole.template tail<ny>() = whole.template segment<ny>(ny);
    for (std::size_t d = 0; d < LPVG_NDELTA; ++d) {
        const std::size_t j = d * group;
        for (std::size_t s = 0; s < LPVG_NWEIGHT; ++s) {
            section(r.energy_W[d][s], whole.data() + (2 * ny) + j, self->W[s][0] + j, self->W[s][1] + j);
        }
    }
    Row<3 * ny> filtered[LPVG_NBANDS];
    filtered[last] = whole;
    for (std::size_t b = last; b > 0U; --b) {
        filtered[b - 1U] = low_pass<3 * ny>(r.energy_corner[b - 1U], filtered[b], self->F[b - 1U]);
        filtered[b] -= filtered[b - 1U];
    }
    const Real fades = r.energy_forget[0];
    self->fading -= fades * self->fading;
    for (std::size_t b = 0; b < LPVG_NBANDS; ++b) {
        lpvg_energy_band_t& band = self->band[b];
        const Real* const x = filtered[b].data();
        add(band.right, x + (2 * ny), fades);
        if (settled) {
            const Real forget = r.energy_forget[b];
            add(band.left, x, forget);
            add(band.nominal, x + ny, forget);
        }
    }
}

extern "C" lpvg_real_t lpvg_energy_judge(lpvg_energy_t* self, const lpvg_coeff_t* coeff) {
    self->direction = self->next_direction;
    self->next_direction = self->direction + 1U < LPVG_NDIRECTIONS ? self->direction + 1U : 0U;
    self->ratio = Real(0);
    self->strongest = 0U;
    const Real faded = std::sqrt(self->fading);
    for (uint32_t b = 0; b < LPVG_NBANDS; ++b) {
        const Row<ny> a = direction(coeff->reals, self->direction, b);
        const Real right = right_side(self->band[b], coeff->reals.energy_start[b], faded, a);
        const Real quotient = norm(self->band[b].left, a) / right;
        const Real ratio = quotient < beyond && right < beyond ? quotient : beyond;
        if (ratio > self->ratio) {
            self->ratio = ratio;
            self->strongest = b;
        }
    }
    return self->ratio;
}

extern "C" lpvg_real_t lpvg_energy_evidence(const lpvg_energy_t* self, const lpvg_coeff_t* coeff) {
    const lpvg_energy_band_t& band = self->band[self->strongest];
    const Row<ny> a = direction(coeff->reals, self->direction, self->strongest);
    return norm(band.nominal, a) / right_side(band, coeff->reals.energy_start[self->strongest], std::sqrt(self->fading), a);
}
