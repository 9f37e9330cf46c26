// controller.cpp -- see controller.h.
#include "lpvguard/controller.h"

#if LPVG_NK > 0

#include <cmath>
#include <utility>

#include "control_begin.hpp"
#include "control_checks.hpp"

namespace {

using Real = lpvg_real_t;
constexpr std::size_t nk = LPVG_NK, nm = LPVG_NM, nu = LPVG_NU, nq = nm + nu;

void count(uint32_t& counter) { counter += counter < UINT32_MAX ? 1U : 0U; }

// Zero times infinity or NaN is NaN, and the sum then stays NaN.
bool all_finite_at(const Real* values, std::size_t n) {
    Real probe = Real(0);
    for (std::size_t i = 0; i < n; ++i) {
        probe += Real(0) * values[i];
    }
    return probe >= Real(0);
}

// Position of a speed between the nodes.
struct Place {
    std::size_t node;  // lower node
    Real weight;       // weight of the upper node
};

Place place(const lpvg_control_reals_t& r, Real speed) {
    const Real inside = speed < r.speed_min ? r.speed_min : (speed > r.speed_max ? r.speed_max : speed);
    const Real position = (inside - r.speed_min) / (r.speed_max - r.speed_min) * Real(LPVG_NG - 1);
    // Damaged coefficients may make the position NaN. It is never above LPVG_NG - 1.
    const Real bounded = position > Real(0) ? position : Real(0);
    auto node = static_cast<std::size_t>(bounded);
    node = node < LPVG_NG - 1U ? node : LPVG_NG - 2U;
    return {node, bounded - static_cast<Real>(node)};
}

// Largest |demand i| at a position between the nodes.
Real limit_at(const lpvg_control_reals_t& r, const Place& at, std::size_t i) {
    const Real below = r.u_max[at.node][i];
    return below + at.weight * (r.u_max[at.node + 1U][i] - below);
}

// Input of the states, q = (m, u - v), divided between the lower and the upper node. Weighting q once replaces the
// interpolation of every coefficient.
struct Drive {
    const Real (*below)[nk][nq];
    const Real (*above)[nk][nq];
    Real q_below[nq], q_above[nq];

    Drive(const lpvg_control_reals_t& r, const Place& at, const Real* m, const Real* excess)
        : below(r.BL[at.node]), above(r.BL[at.node + 1U]) {
        for (std::size_t c = 0; c < nq; ++c) {
            const Real q = c < nm ? m[c] : excess[c - nm];
            q_above[c] = at.weight * q;
            q_below[c] = q - q_above[c];
        }
    }
    // Adds row j of B and L times q, for demand i. The compiler unrolls this into one chain of additions.
    Real added(Real sum, std::size_t i, std::size_t j) const {
        return added(sum, below[i][j], above[i][j], std::make_index_sequence<nq>());
    }

private:
    template <std::size_t... C>
    Real added(Real sum, const Real* row_below, const Real* row_above, std::index_sequence<C...>) const {
        ((sum += row_below[C] * q_below[C]), ...);
        ((sum += row_above[C] * q_above[C]), ...);
        return sum;
    }
};

void wanted(const Real (&x)[nu][nk], Real (&v)[nu]) {
    for (std::size_t i = 0; i < nu; ++i) {
        v[i] = Real(0);
        for (std::size_t j = 0; j < nk; j += 2U) {
            v[i] += x[i][j];
        }
    }
}

Real towards(Real from, Real target, Real step) {
    return target > from + step ? from + step : (target < from - step ? from - step : target);
}

// Changes x so that C x = u. With m and without limits, C (A x + B m) = u then also holds.
void align(const lpvg_control_reals_t& r, const Place& at, const Real* m, const Real* u, const Real* v, Real (*x)[nk]) {
    const Real nothing[nu] = {};
    const Drive drive(r, at, m, nothing);
    for (std::size_t i = 0; i < nu; ++i) {
        Real drift = Real(0);
        for (std::size_t j = 0; j < nk; j += 2U) {
            drift = drive.added(drift + r.A1[j] * x[i][j], i, j);
            drift += j + 1U < nk ? x[i][j + 1U] : Real(0);
        }
        const Real missing = u[i] - v[i];
        for (std::size_t j = 0; j < nk; ++j) {
            x[i][j] += r.engage[j][0] * missing - r.engage[j][1] * drift;
        }
    }
}

void clear(lpvg_control_t& self) {
    std::memset(self.x, 0, sizeof self.x);
    std::memset(self.carry, 0, sizeof self.carry);
}

// Adds a change to a state. The change already contains `carry`, the rounding error of the previous change.
Real moved(Real x, Real change, Real& carry) {
    const Real next = x + change;
    carry = change - (next - x);
    return next;
}

void advance(lpvg_control_t& self, const Drive& drive) {
    const Real* a = self.coeff->reals.A1;
    for (std::size_t i = 0; i < nu; ++i) {
        Real* x = self.x[i];
        Real* carry = self.carry[i];
        for (std::size_t j = 0; j + 1U < nk; j += 2U) {
            const Real head = x[j], tail = x[j + 1U];
            const Real to_head = drive.added(carry[j] + a[j] * head + tail, i, j);
            const Real to_tail = drive.added(carry[j + 1U] + a[j + 1U] * head, i, j + 1U);
            x[j] = moved(head, to_head, carry[j]);
            x[j + 1U] = moved(tail, to_tail, carry[j + 1U]);
        }
        if constexpr (nk % 2U == 1U) {
            constexpr std::size_t last = nk - 1U;
            const Real single = x[last];
            x[last] = moved(single, drive.added(carry[last] + a[last] * single, i, last), carry[last]);
        }
    }
}

}  // namespace

extern "C" uint32_t lpvg_control_coeff_crc32(const lpvg_control_coeff_t* coeff) {
    return coeff == nullptr ? 0U : lpvguard::coefficients_crc32(*coeff);
}

extern "C" lpvg_status_t lpvg_control_coeff_check(const lpvg_control_coeff_t* coeff) {
    if (coeff == nullptr) {
        return lpvg_status_bad_argument;
    }
    const lpvg_control_words_t& w = coeff->words;
    if (w.magic != LPVG_CONTROL_MAGIC) {
        return lpvg_status_bad_magic;
    }
    if (w.schema != LPVG_CONTROL_SCHEMA) {
        return lpvg_status_bad_schema;
    }
    if (w.real_bytes != sizeof(lpvg_real_t) || !lpvguard::sizes_match(w)) {
        return lpvg_status_bad_size;
    }
    if (w.crc32 != lpvg_control_coeff_crc32(coeff)) {
        return lpvg_status_bad_crc;
    }
    if (!lpvguard::all_finite(coeff->reals)) {
        return lpvg_status_not_finite;
    }
    return lpvguard::items_in_range(w) && lpvguard::items_in_range(coeff->reals) ? lpvg_status_ok : lpvg_status_bad_value;
}

extern "C" lpvg_status_t lpvg_control_init(lpvg_control_t* self, const lpvg_control_coeff_t* coeff) {
    if (self == nullptr) {
        return lpvg_status_bad_argument;
    }
    const lpvg_status_t status = lpvg_control_coeff_check(coeff);
    if (status == lpvg_status_ok) {
        lpvg_control_begin(self, coeff);
    }
    return status;
}

extern "C" void lpvg_control_begin(lpvg_control_t* self, const lpvg_control_coeff_t* coeff) {
    *self = lpvg_control_t{};
    self->coeff = coeff;
}

extern "C" lpvg_status_t lpvg_control_step(lpvg_control_t* self, lpvg_real_t speed, const lpvg_real_t* m, bool engaged) {
    const bool ready = self != nullptr && self->coeff != nullptr;
    return lpvg_control_step_after(self, speed, m, engaged, ready ? self->coeff->words.sample_period_us : 0U);
}

extern "C" lpvg_status_t lpvg_control_step_after(lpvg_control_t* self, lpvg_real_t speed, const lpvg_real_t* m, bool engaged,
                                                 uint32_t elapsed_us) {
    return lpvg_control_step_within(self, speed, m, engaged, elapsed_us, Real(1));
}

extern "C" lpvg_status_t lpvg_control_step_within(lpvg_control_t* self, lpvg_real_t speed, const lpvg_real_t* m, bool engaged,
                                                  uint32_t elapsed_us, lpvg_real_t share) {
    if (self == nullptr || m == nullptr) {
        return lpvg_status_bad_argument;
    }
    if (self->coeff == nullptr) {
        return lpvg_status_not_ready;
    }
    const lpvg_control_reals_t& r = self->coeff->reals;
    const Real nothing[nm] = {};
    bool good = std::isfinite(speed) && all_finite_at(m, nm);
    const Place at = place(r, good ? speed : r.speed_min);

    Real v[nu];
    wanted(self->x, v);
    if (engaged && good && !self->engaged) {
        align(r, at, m, self->u, v, self->x);
        wanted(self->x, v);
    }
    if (!lpvguard::every(v, [](Real each) { return std::isfinite(each); })) {  // the states are too large for the number type
        good = false;
        clear(*self);
        wanted(self->x, v);
    }
    const bool active = engaged && good;
    const uint32_t longest_us = self->coeff->words.sample_period_us + self->coeff->words.sample_period_us / 2U;
    const Real elapsed = static_cast<Real>(elapsed_us < longest_us ? elapsed_us : longest_us) * Real(1e-6);
    Real excess[nu];
    bool limited = false;
    for (std::size_t i = 0; i < nu; ++i) {
        const Real target = !active ? Real(0) : towards(Real(0), v[i], share * limit_at(r, at, i));
        self->u[i] = towards(self->u[i], target, r.rate_max[i] * elapsed);
        excess[i] = self->u[i] - v[i];
        limited = limited || excess[i] < Real(0) || excess[i] > Real(0);
    }
    if (active && limited) {
        count(self->limited);
    }
    advance(*self, Drive(r, at, good ? m : nothing, excess));
    self->engaged = active;
    if (!good) {
        count(self->bad_samples);
    }
    return good ? lpvg_status_ok : lpvg_status_bad_sample;
}

#endif
