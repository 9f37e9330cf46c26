// controller.cpp -- see controller.h.
#include "lpvguard/controller.h"

#if LPVG_NK > 0

#include <utility>

#include "acceptance.hpp"

namespace {

using Real = lpvg_real_t;
constexpr std::size_t nk = LPVG_NK, nm = LPVG_NM, nu = LPVG_NU;

bool sizes_match(const uint32_t* sizes) {
    return sizes[0] == LPVG_NK && sizes[1] == LPVG_NM && sizes[2] == LPVG_NG && sizes[3] == LPVG_NA && sizes[4] == LPVG_NU;
}

bool words_in_range(const lpvg_control_words_t& w) {
    bool good = w.sample_period_us > 0U && w.row_begin[0] == 0U && w.row_begin[nk] == LPVG_NA;
    for (std::size_t i = 0; i < nk; ++i) {
        good = good && w.row_begin[i] <= w.row_begin[i + 1U];
    }
    for (const uint32_t column : w.column) {
        good = good && column < nk;
    }
    return good;
}

bool reals_in_range(const lpvg_control_reals_t& r) {
    bool good = r.speed_min > Real(0) && r.speed_min < r.speed_max;
    for (std::size_t i = 0; i < nu; ++i) {
        good = good && r.u_max[i] > Real(0) && r.rate_max[i] > Real(0);
    }
    return good;
}

void count(uint32_t& counter) { counter += counter < UINT32_MAX ? 1U : 0U; }

// Zero times a number that is not finite is not a number, and stays so.
bool all_finite_at(const Real* values, std::size_t n) {
    Real probe = Real(0);
    for (std::size_t i = 0; i < n; ++i) {
        probe += Real(0) * values[i];
    }
    return probe >= Real(0);
}

// Where a speed lies between the nodes.
struct Place {
    std::size_t node;  // the one below
    Real weight;       // of the one above
};

Place place(const lpvg_control_reals_t& r, Real speed) {
    const Real inside = speed < r.speed_min ? r.speed_min : (speed > r.speed_max ? r.speed_max : speed);
    const Real position = (inside - r.speed_min) / (r.speed_max - r.speed_min) * Real(LPVG_NG - 1);
    auto node = static_cast<std::size_t>(position);
    node = node < LPVG_NG - 1U ? node : LPVG_NG - 2U;
    return {node, position - static_cast<Real>(node)};
}

Real between(Real below, Real above, Real weight) { return below + weight * (above - below); }

// A row of an interpolated matrix times a vector, summed at the node below and at the one above: interpolating the two
// sums instead of every entry saves a subtraction an entry.
struct Product {
    Real below = Real(0), above = Real(0);

    void add(Real entry_below, Real entry_above, Real x) {
        below += entry_below * x;
        above += entry_above * x;
    }
    // Short rows, written out by the compiler.
    template <std::size_t... Column>
    void add_row(const Real* row_below, const Real* row_above, const Real* x, std::index_sequence<Column...>) {
        (add(row_below[Column], row_above[Column], x[Column]), ...);
    }
    Real at(Real weight) const { return between(below, above, weight); }
};

void wanted(const lpvg_control_reals_t& r, const Place& at, const Real* x, Real* v) {
    for (std::size_t i = 0; i < nu; ++i) {
        const Real* below = r.C[at.node][i];
        const Real* above = r.C[at.node + 1U][i];
        Product sum;
        for (std::size_t j = 0; j < nk; ++j) {
            sum.add(below[j], above[j], x[j]);
        }
        v[i] = sum.at(at.weight);
    }
}

Real towards(Real from, Real target, Real step) {
    return target > from + step ? from + step : (target < from - step ? from - step : target);
}

// The least change of x after which C x = u: x += C' (C C')^-1 (u - v). Where C C' is singular nothing is changed; the
// rate limit then bounds the jump.
void align(const lpvg_control_reals_t& r, const Place& at, const Real* u, const Real* v, Real* x) {
    Real c[nu][nk], gram[nu][nu], miss[nu];
    for (std::size_t i = 0; i < nu; ++i) {
        for (std::size_t j = 0; j < nk; ++j) {
            c[i][j] = between(r.C[at.node][i][j], r.C[at.node + 1U][i][j], at.weight);
        }
        for (std::size_t l = 0; l <= i; ++l) {
            Real sum = Real(0);
            for (std::size_t j = 0; j < nk; ++j) {
                sum += c[i][j] * c[l][j];
            }
            gram[i][l] = gram[l][i] = sum;
        }
        miss[i] = u[i] - v[i];
    }
    Real multiplier[nu];
#if LPVG_NU == 1
    const Real determinant = gram[0][0];
    multiplier[0] = miss[0];
#else
    const Real determinant = gram[0][0] * gram[1][1] - gram[0][1] * gram[1][0];
    multiplier[0] = gram[1][1] * miss[0] - gram[0][1] * miss[1];
    multiplier[1] = gram[0][0] * miss[1] - gram[1][0] * miss[0];
#endif
    if (!(determinant > Real(0))) {
        return;
    }
    for (std::size_t j = 0; j < nk; ++j) {
        for (std::size_t i = 0; i < nu; ++i) {
            x[j] += c[i][j] * (multiplier[i] / determinant);
        }
    }
}

void clear(lpvg_control_t& self) {
    std::memset(self.x, 0, sizeof self.x);
    std::memset(self.carry, 0, sizeof self.carry);
}

// False, x unchanged, when the next state would not be finite; what carry then holds is for clear().
bool advance(lpvg_control_t& self, const Place& at, const Real* m, const Real* excess) {
    const lpvg_control_words_t& w = self.coeff->words;
    const lpvg_control_reals_t& r = self.coeff->reals;
    const Real* below = r.A1[at.node];
    const Real* above = r.A1[at.node + 1U];
    Real next[nk];
    Real probe = Real(0);  // as in all_finite_at
    for (std::size_t i = 0; i < nk; ++i) {
        Product sum;
        for (uint32_t e = w.row_begin[i]; e < w.row_begin[i + 1U]; ++e) {
            sum.add(below[e], above[e], self.x[w.column[e]]);
        }
        sum.add_row(r.B[at.node][i], r.B[at.node + 1U][i], m, std::make_index_sequence<nm>());
        sum.add_row(r.L[at.node][i], r.L[at.node + 1U][i], excess, std::make_index_sequence<nu>());
        const Real change = sum.at(at.weight) + self.carry[i];
        next[i] = self.x[i] + change;
        self.carry[i] = change - (next[i] - self.x[i]);
        probe += Real(0) * next[i];
    }
    const bool finite = probe >= Real(0);
    if (finite) {
        std::memcpy(self.x, next, sizeof next);
    }
    return finite;
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
    if (w.real_bytes != sizeof(lpvg_real_t) || !sizes_match(w.sizes)) {
        return lpvg_status_bad_size;
    }
    if (w.crc32 != lpvg_control_coeff_crc32(coeff)) {
        return lpvg_status_bad_crc;
    }
    if (!lpvguard::all_finite(coeff->reals)) {
        return lpvg_status_not_finite;
    }
    return words_in_range(w) && reals_in_range(coeff->reals) ? lpvg_status_ok : lpvg_status_bad_value;
}

extern "C" lpvg_status_t lpvg_control_init(lpvg_control_t* self, const lpvg_control_coeff_t* coeff) {
    if (self == nullptr) {
        return lpvg_status_bad_argument;
    }
    const lpvg_status_t status = lpvg_control_coeff_check(coeff);
    if (status == lpvg_status_ok) {
        *self = lpvg_control_t{};
        self->coeff = coeff;
    }
    return status;
}

extern "C" lpvg_status_t lpvg_control_step(lpvg_control_t* self, lpvg_real_t speed, const lpvg_real_t* m, bool engaged) {
    if (self == nullptr || m == nullptr) {
        return lpvg_status_bad_argument;
    }
    if (self->coeff == nullptr) {
        return lpvg_status_not_ready;
    }
    const lpvg_control_reals_t& r = self->coeff->reals;
    const Real nothing[nm] = {};
    bool good = all_finite_at(&speed, 1U) && all_finite_at(m, nm);
    const Place at = place(r, good ? speed : r.speed_min);

    Real v[nu];
    wanted(r, at, self->x, v);
    if (!all_finite_at(v, nu)) {  // the state has grown beyond what can be multiplied
        good = false;
        clear(*self);
        wanted(r, at, self->x, v);
    }
    const bool active = engaged && good;
    if (active && !self->engaged) {
        align(r, at, self->u, v, self->x);
        wanted(r, at, self->x, v);
    }
    const Real period = static_cast<Real>(self->coeff->words.sample_period_us) * Real(1e-6);
    Real excess[nu];
    bool limited = false;
    for (std::size_t i = 0; i < nu; ++i) {
        const Real target = !active ? Real(0) : towards(Real(0), v[i], r.u_max[i]);
        self->u[i] = towards(self->u[i], target, r.rate_max[i] * period);
        excess[i] = self->u[i] - v[i];
        limited = limited || excess[i] < Real(0) || excess[i] > Real(0);
    }
    if (active && limited) {
        count(self->limited);
    }
    if (!advance(*self, at, good ? m : nothing, excess)) {
        clear(*self);
        good = false;
    }
    self->engaged = active && good;
    if (!good) {
        count(self->bad_samples);
    }
    return good ? lpvg_status_ok : lpvg_status_bad_sample;
}

#endif
