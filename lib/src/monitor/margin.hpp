// margin.hpp -- exact margin t* of one frame (T17). With one Delta common to all outputs it is a weighted 1-centre problem of
// n_y + 1 discs in the plane:
//
//     t* = min over complex d of max( |d| / W, |E_j - d Z_j| / B_j )
//
// With one Delta for each output (S1_diagonal, or a single output), each d_j is found separately, without candidates:
//
//     t* = max over j of |E_j| / (B_j + W_j |Z_j|)
//
// At the optimum of the common problem, two or three terms equal t*. So d is one of finitely many candidates in closed form:
//   two terms i, j:   d lies between E_i/Z_i and E_j/Z_j and divides this segment in the ratio of the radii B_i/|Z_i|, B_j/|Z_j|;
//   three terms:      d makes them equal; this quadratic equation is solved from d = 0, then twice more from the solution.
// Centres E_j/Z_j and radii are never computed. For a small Z_j both are large, and their differences would cancel.
// Every candidate is *evaluated*, and the least maximum is returned. Z_j = 0 needs no special case: its term does not depend on d.
//
// t* > 1 means: no complex number d (or d_j) with |d| <= W and no disturbance within B explain this frame in this bin. This does not
// refute every causal Delta of a certificate, because a Delta with memory is not one complex number (THEORY 7.1).
//
// Accuracy (tests/unit/test_margin.cpp, against a certified long double reference). The evaluation of E_j - d Z_j has a
// rounding error in proportion to |E_j|/B_j, with every method in one number type. The result is therefore reduced by
// 6 rounding units of max |E_j|/B_j, so that rounding alone never raises an alarm. In float, t* is never above the exact
// margin and at most 1.1e-6 max |E_j|/B_j below it. Relative to t*, this is at most 1.1e-6 (1 + max W |Z_j|/B_j). With one
// Delta for each output, nothing cancels. t* is then reduced by 6 rounding units of t*, and its error is at most 1.1e-6 t*.
// On a processor that replaces subnormal numbers by zero, t* is at most 1e-6 max |E_j|/B_j above the exact margin.
// Range: |E_j|/B_j from 1e-9 to 1e9, and W |Z_j|/B_j up to 2e4. The units of an output scale E_j, Z_j and B_j together, from
// 1e-30 to 1e30. Outside this range, a candidate may be lost and the result may be too large. NaN and infinity give infinity.
#pragma once

#include <array>
#include <cmath>
#include <cstddef>
#include <limits>
#include <type_traits>

namespace lpvg {

template <class Real>
struct Complex2 {
    Real re, im;
};

template <class Real>
constexpr Complex2<Real> operator+(Complex2<Real> a, Complex2<Real> b) {
    return {a.re + b.re, a.im + b.im};
}
template <class Real>
constexpr Complex2<Real> operator-(Complex2<Real> a, Complex2<Real> b) {
    return {a.re - b.re, a.im - b.im};
}
template <class Real>
constexpr Complex2<Real> operator*(Complex2<Real> a, Complex2<Real> b) {
    return {a.re * b.re - a.im * b.im, a.re * b.im + a.im * b.re};
}
template <class Real>
constexpr Complex2<Real> operator*(Real s, Complex2<Real> a) {
    return {s * a.re, s * a.im};
}
template <class Real>
constexpr Complex2<Real> conj(Complex2<Real> a) {
    return {a.re, -a.im};
}
template <class Real>
constexpr Real squared(Complex2<Real> a) {
    return a.re * a.re + a.im * a.im;
}
template <class Real>
constexpr Real cross(Complex2<Real> a, Complex2<Real> b) {
    return a.re * b.im - a.im * b.re;
}

/// Largest rounding error of a margin, relative to max |E_j|/B_j. It is subtracted from the margin.
template <class Real>
constexpr Real margin_rounding = Real(6) * std::numeric_limits<Real>::epsilon();

/// Margin of one frame with NY outputs and one common Delta. W points to one number > 0, and B to NY numbers. E and Z are finite.
template <class Real, std::size_t NY>
class CommonMargin {
public:
    using C = Complex2<Real>;

    CommonMargin(const C* E, const C* Z, const Real* W, const Real* B) : W_(*W) {
        for (std::size_t j = 0; j < NY; ++j) {
            const Real unit = Real(1) / B[j];
            E_[j] = unit * E[j];
            Z_[j] = (W_ * unit) * Z[j];
            size_[j] = squared(Z_[j]);
            gain_[j] = std::sqrt(size_[j]);
            pull_[j] = (gain_[j] > Real(0) ? Real(1) / gain_[j] : Real(0)) * (E_[j] * conj(Z_[j]));
        }
        // The term |d| / W has the form of an output with E = 0 and Z = 1.
        E_[NY] = pull_[NY] = {Real(0), Real(0)};
        Z_[NY] = {Real(1), Real(0)};
        size_[NY] = gain_[NY] = Real(1);
    }

    Real operator()() { return with_triples(with_pairs()); }

    /// First part of the work: returns the least squared maximum over d = 0 and the pairs.
    Real with_pairs() {
        consider({Real(0), Real(0)});
        for (std::size_t i = 0; i < NY; ++i) {
            for (std::size_t j = i + 1; j <= NY; ++j) {
                pair(i, j);
            }
        }
        return best_;
    }

    /// Second part of the work: returns t*, from the result of the first part.
    Real with_triples(Real best) {
        best_ = best;
        for (std::size_t i = 0; i < NY; ++i) {
            for (std::size_t j = i + 1; j < NY; ++j) {
                for (std::size_t k = j + 1; k <= NY; ++k) {
                    triple(k, i, j);
                }
            }
        }
        return lowered();
    }

    /// Returns the evidence: the margin of a vehicle without response, E = -Z. The best d is real and within -1 .. 0. It
    /// makes |d| / W equal to (1 - |d|) max |Z_j| / B_j.
    Real dead() const {
        Real largest = Real(0);
        for (std::size_t j = 0; j < NY; ++j) {
            largest = gain_[j] > largest ? gain_[j] : largest;
        }
        return largest / (Real(1) + largest) / W_;
    }

private:
    Real W_;
    std::array<C, NY + 1> E_, Z_;           // E / B and W Z / B: d is in units of W
    std::array<C, NY + 1> pull_;            // E conj(Z) / |Z|; 0 where Z = 0
    std::array<Real, NY + 1> size_, gain_;  // |Z|^2, |Z|
    Real best_ = std::numeric_limits<Real>::infinity();

    void consider(C d) {
        Real worst = squared(d);
        if (!(worst < best_)) {
            return;  // not better, or NaN: a candidate that overflowed must not count as small
        }
        for (std::size_t j = 0; j < NY; ++j) {
            const Real f = squared(E_[j] - d * Z_[j]);
            if (!(f < best_)) {
                return;
            }
            worst = f > worst ? f : worst;
        }
        best_ = worst;
    }

    void pair(std::size_t i, std::size_t j) {
        const Real both = gain_[i] + gain_[j];
        if (both > Real(0)) {
            consider((Real(1) / both) * (pull_[i] + pull_[j]));
        }
    }

    // Two d make three terms equal. If |d| is one of the terms (i = NY), the d nearer to 0 is better. Otherwise either can be better.
    void triple(std::size_t i, std::size_t j, std::size_t k) {
        constexpr C zero{Real(0), Real(0)};
        settle(i, j, k, equalised(i, j, k, zero, false));
        if (i != NY) {
            settle(i, j, k, equalised(i, j, k, zero, true));
        }
    }

    // Solves twice more from the first solution, which can have large rounding errors if three gradients are nearly parallel.
    void settle(std::size_t i, std::size_t j, std::size_t k, C d) {
        for (int again = 0; again < 2; ++again) {
            d = equalised(i, j, k, d, false);
            consider(d);
        }
    }

    // Returns the d that makes three terms equal: the nearer or the farther one from `origin`, or `origin` without a solution.
    // With d = origin + h and R_m = E_m - origin Z_m, the squared terms are |R_m|^2 - 2 <conj(Z_m) R_m, h> + |Z_m|^2 |h|^2.
    // Their differences give h = p + n q with n = |h|^2. This means |q|^2 n^2 - 2 (1/2 - <p, q>) n + |p|^2 = 0.
    C equalised(std::size_t i, std::size_t j, std::size_t k, C origin, bool farther) const {
        const C Ri = E_[i] - origin * Z_[i], Rj = E_[j] - origin * Z_[j], Rk = E_[k] - origin * Z_[k];
        const C gi = conj(Z_[i]) * Ri;
        const C gj = conj(Z_[j]) * Rj - gi, gk = conj(Z_[k]) * Rk - gi;
        const Real det = Real(2) * cross(gj, gk);
        if (!(std::fabs(det) > Real(0))) {
            return origin;  // parallel gradients: two terms decide
        }
        const Real inverse = Real(1) / det;
        const Real fi = squared(Ri), fj = squared(Rj) - fi, fk = squared(Rk) - fi;
        const Real sj = size_[j] - size_[i], sk = size_[k] - size_[i];
        const C p = inverse * C{fj * gk.im - fk * gj.im, fk * gj.re - fj * gk.re};
        const C q = inverse * C{sj * gk.im - sk * gj.im, sk * gj.re - sj * gk.re};
        // The cross product of p and q gives the discriminant (1/2 - <p, q>)^2 - |p|^2 |q|^2 without cancellation. It is
        // negative by rounding, or if no d makes the terms equal. The candidate is then poor, but not wrong.
        const Real dot = p.re * q.re + p.im * q.im;
        const Real across = Real(0.5) * inverse * (fj * sk - fk * sj);
        const Real discriminant = Real(0.25) - dot - across * across;
        const Real sum = Real(0.5) - dot + std::sqrt(discriminant > Real(0) ? discriminant : Real(0));
        const Real top = farther ? sum : squared(p);
        const Real bottom = farther ? squared(q) : sum;
        return bottom > Real(0) ? origin + p + (top / bottom) * q : origin;
    }

    // Returns t* from its square, minus the largest rounding error of the evaluation.
    Real lowered() const {
        Real largest = Real(0);
        for (std::size_t j = 0; j < NY; ++j) {
            const Real f = squared(E_[j]);
            largest = f > largest ? f : largest;
        }
        const Real t = std::sqrt(best_);
        if (!(largest < std::numeric_limits<Real>::infinity())) {
            return t;  // outside the range: not reduced
        }
        const Real rounding = margin_rounding<Real> * std::sqrt(largest);
        return t > rounding ? t - rounding : Real(0);
    }
};

/// Margin of one frame with NY outputs, each with its own Delta and judged separately. W and B point to NY numbers > 0.
template <class Real, std::size_t NY>
class SeparateMargin {
public:
    using C = Complex2<Real>;

    SeparateMargin(const C* E, const C* Z, const Real* W, const Real* B) : W_(W) {
        for (std::size_t j = 0; j < NY; ++j) {
            const Real unit = Real(1) / B[j];
            size_[j] = squared(unit * E[j]);
            gain_[j] = std::sqrt(squared((W[j] * unit) * Z[j]));
        }
    }

    Real operator()() const {
        constexpr Real infinity = std::numeric_limits<Real>::infinity();
        Real largest = Real(0);
        for (std::size_t j = 0; j < NY; ++j) {
            if (!(size_[j] < infinity) || !(gain_[j] < infinity)) {
                return infinity;  // NaN, or outside the range
            }
            const Real t = std::sqrt(size_[j]) / (Real(1) + gain_[j]);
            largest = t > largest ? t : largest;
        }
        return (Real(1) - margin_rounding<Real>)*largest;
    }

    /// Returns the evidence: the margin of a vehicle without response, E = -Z.
    Real dead() const {
        Real largest = Real(0);
        for (std::size_t j = 0; j < NY; ++j) {
            const Real t = gain_[j] / (Real(1) + gain_[j]) / W_[j];
            largest = t > largest ? t : largest;
        }
        return largest;
    }

private:
    const Real* W_;
    std::array<Real, NY> size_, gain_;  // |E|^2 / B^2, W |Z| / B
};

/// Margin of one frame with NY outputs and ND blocks Delta: one common block, or one block for each output.
template <class Real, std::size_t NY, std::size_t ND>
using Margin = std::conditional_t<ND == NY, SeparateMargin<Real, NY>, CommonMargin<Real, NY>>;

}  // namespace lpvg
