// margin.hpp -- exact margin t* of one frame (T17). With one Delta common to all outputs it is a weighted 1-centre problem of
// n_y + 1 discs in the plane:
//
//     t* = min over complex d of max( |d| / W, |E_j - d Z_j| / B_j )
//
// With one Delta an output (S1_diagonal, and one output alone) each d_j is found by itself, and no candidate is needed:
//
//     t* = max over j of |E_j| / (B_j + W_j |Z_j|)
//
// At the optimum of the first two or three of the terms are equal to t*. So d is one of finitely many candidates, each in closed form:
//   two terms i, j:   d on the segment between E_i/Z_i and E_j/Z_j, dividing it as the radii B_i/|Z_i|, B_j/|Z_j| do;
//   three terms:      d makes them equal: a quadratic equation, solved from d = 0 and twice more from the d so found.
// Centres E_j/Z_j and radii are never formed: an output with a small Z_j has both far out, and differences of them cancel.
// Every candidate is *evaluated*, and the least maximum is returned. Z_j = 0 needs no gate: its term does not depend on d.
//
// t* > 1: no one complex number d (no d_j) with |d| <= W and no disturbance within B explain this frame in this bin. It does not refute
// every causal Delta of a certificate: one with memory is no such number (tools/README.md).
//
// Accuracy (tests/unit/test_margin.cpp, against a certified long double reference). The evaluation of E_j - d Z_j itself
// rounds, by a part of |E_j|/B_j; no method in one number type avoids that. What is returned is therefore lowered by
// 6 units of rounding of max |E_j|/B_j: rounding alone never raises an alarm. In float t* is never above the exact margin,
// and at most 1.1e-6 of max |E_j|/B_j below it. Relative to t* that is 1.1e-6 (1 + max W |Z_j|/B_j) at most. With one Delta an
// output nothing cancels: t* is lowered by 6 units of its own size, and is at most 1.1e-6 of itself below. On a processor for
// which subnormal numbers are zero, t* is at most 1e-6 of max |E_j|/B_j above the exact margin.
// Range: |E_j|/B_j from 1e-9 to 1e9, and W |Z_j|/B_j up to 2e4. The units of an output scale E_j, Z_j and B_j together, from
// 1e-30 to 1e30. Beyond, a candidate may be lost and results err upward; what is not finite reads infinity.
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

/// What rounding may have added to a margin, in parts of max |E_j|/B_j; it is taken off.
template <class Real>
constexpr Real margin_rounding = Real(6) * std::numeric_limits<Real>::epsilon();

/// Margin of one frame with NY outputs that one Delta is common to. W points to one number > 0, B to NY; E and Z finite.
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
        // The size of d itself is the term of an output with E = 0 and Z = 1.
        E_[NY] = pull_[NY] = {Real(0), Real(0)};
        Z_[NY] = {Real(1), Real(0)};
        size_[NY] = gain_[NY] = Real(1);
    }

    Real operator()() { return with_triples(with_pairs()); }

    /// The work in two parts: the least squared maximum over d = 0 and the pairs ...
    Real with_pairs() {
        consider({Real(0), Real(0)});
        for (std::size_t i = 0; i < NY; ++i) {
            for (std::size_t j = i + 1; j <= NY; ++j) {
                pair(i, j);
            }
        }
        return best_;
    }

    /// ... and, given that, t*.
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

    /// The evidence: the margin had the vehicle not responded, E = -Z. The best d is real, from -1 to 0. It makes |d| / W
    /// equal to (1 - |d|) max |Z_j| / B_j.
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
            return;  // no better; or not a number, where a candidate overflowed, and that must not read as small
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

    // Two d make three terms equal. Where |d| is one of the terms (i = NY), the one nearer to 0 is the better. Else either may be.
    void triple(std::size_t i, std::size_t j, std::size_t k) {
        constexpr C zero{Real(0), Real(0)};
        settle(i, j, k, equalised(i, j, k, zero, false));
        if (i != NY) {
            settle(i, j, k, equalised(i, j, k, zero, true));
        }
    }

    // Two more solutions from where the first led: it may have lost all digits where three gradients are nearly in line.
    void settle(std::size_t i, std::size_t j, std::size_t k, C d) {
        for (int again = 0; again < 2; ++again) {
            d = equalised(i, j, k, d, false);
            consider(d);
        }
    }

    // The d nearest to `origin` (or the farther one) that makes three terms equal, `origin` itself where none does. With
    // d = origin + h and R_m = E_m - origin Z_m the squared terms are |R_m|^2 - 2 <conj(Z_m) R_m, h> + |Z_m|^2 |h|^2. Their
    // differences give h = p + n q with n = |h|^2; that is |q|^2 n^2 - 2 (1/2 - <p, q>) n + |p|^2 = 0.
    C equalised(std::size_t i, std::size_t j, std::size_t k, C origin, bool farther) const {
        const C Ri = E_[i] - origin * Z_[i], Rj = E_[j] - origin * Z_[j], Rk = E_[k] - origin * Z_[k];
        const C gi = conj(Z_[i]) * Ri;
        const C gj = conj(Z_[j]) * Rj - gi, gk = conj(Z_[k]) * Rk - gi;
        const Real det = Real(2) * cross(gj, gk);
        if (!(std::fabs(det) > Real(0))) {
            return origin;  // gradients in line: two terms decide
        }
        const Real inverse = Real(1) / det;
        const Real fi = squared(Ri), fj = squared(Rj) - fi, fk = squared(Rk) - fi;
        const Real sj = size_[j] - size_[i], sk = size_[k] - size_[i];
        const C p = inverse * C{fj * gk.im - fk * gj.im, fk * gj.re - fj * gk.re};
        const C q = inverse * C{sj * gk.im - sk * gj.im, sk * gj.re - sj * gk.re};
        // The discriminant (1/2 - <p, q>)^2 - |p|^2 |q|^2 is written with the cross product of p and q, which does not
        // cancel. Below zero it is rounding, or no d makes the terms equal. The candidate is then merely poor.
        const Real dot = p.re * q.re + p.im * q.im;
        const Real across = Real(0.5) * inverse * (fj * sk - fk * sj);
        const Real discriminant = Real(0.25) - dot - across * across;
        const Real sum = Real(0.5) - dot + std::sqrt(discriminant > Real(0) ? discriminant : Real(0));
        const Real top = farther ? sum : squared(p);
        const Real bottom = farther ? squared(q) : sum;
        return bottom > Real(0) ? origin + p + (top / bottom) * q : origin;
    }

    // t* from its square, less what rounding of the evaluation may have added.
    Real lowered() const {
        Real largest = Real(0);
        for (std::size_t j = 0; j < NY; ++j) {
            const Real f = squared(E_[j]);
            largest = f > largest ? f : largest;
        }
        const Real t = std::sqrt(best_);
        if (!(largest < std::numeric_limits<Real>::infinity())) {
            return t;  // beyond the range: upward
        }
        const Real rounding = margin_rounding<Real> * std::sqrt(largest);
        return t > rounding ? t - rounding : Real(0);
    }
};

/// Margin of one frame with NY outputs, each with a Delta of its own: every output for itself. W and B point to NY numbers > 0.
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
                return infinity;  // not a number, or beyond the range
            }
            const Real t = std::sqrt(size_[j]) / (Real(1) + gain_[j]);
            largest = t > largest ? t : largest;
        }
        return (Real(1) - margin_rounding<Real>)*largest;
    }

    /// The evidence: the margin had the vehicle not responded, E = -Z.
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

/// Margin of one frame with NY outputs and ND blocks Delta: one common to all outputs, or one an output.
template <class Real, std::size_t NY, std::size_t ND>
using Margin = std::conditional_t<ND == NY, SeparateMargin<Real, NY>, CommonMargin<Real, NY>>;

}  // namespace lpvg
