// margin.hpp -- exact margin t* of one frame (T17): a weighted 1-centre problem of n_y + 1 discs in the plane.
//
//     t* = min over complex d of max( |d| / W, |E_j - d Z_j| / B_j )
//
// At the optimum two or three of the terms are active, so d is one of finitely many candidates, each in closed form:
//   two discs i, j:   d on the segment between the centres, dividing it as the radii do;
//   three discs:      d equidistant (in units of the radii) from three centres, a quadratic equation in t^2.
// Every candidate is *evaluated*, and the least maximum is returned: rounding in a candidate can only raise t*, and never
// lowers it below a value that some d attains. Z_j = 0 needs no gate: its term does not depend on d.
//
// Range of float (tests/unit/test_margin.cpp): the units of an output, that is E_j, Z_j, B_j together, are free from 1e-30
// to 1e30. For |E_j|/B_j from 1e-9 to 1e9 and W|Z_j|/B_j up to 2e4 the error is at most 5e-5 of max |E_j|/B_j, upward,
// and 1e-6 of it downward. Beyond, results err upward only; what is not finite reads infinity.
#pragma once

#include <array>
#include <cmath>
#include <cstddef>
#include <limits>

namespace lpvg {

template <class Real>
struct Complex2 {
    Real re, im;
};

template <class Real>
constexpr Complex2<Real> operator+(Complex2<Real> a, Complex2<Real> b) { return {a.re + b.re, a.im + b.im}; }
template <class Real>
constexpr Complex2<Real> operator-(Complex2<Real> a, Complex2<Real> b) { return {a.re - b.re, a.im - b.im}; }
template <class Real>
constexpr Complex2<Real> operator*(Complex2<Real> a, Complex2<Real> b) {
    return {a.re * b.re - a.im * b.im, a.re * b.im + a.im * b.re};
}
template <class Real>
constexpr Complex2<Real> operator*(Real s, Complex2<Real> a) { return {s * a.re, s * a.im}; }
template <class Real>
constexpr Complex2<Real> conj(Complex2<Real> a) { return {a.re, -a.im}; }
template <class Real>
constexpr Real squared(Complex2<Real> a) { return a.re * a.re + a.im * a.im; }

/// Margin of one frame with NY outputs. W > 0, B_j > 0; E and Z finite.
template <class Real, std::size_t NY>
class Margin {
public:
    using C = Complex2<Real>;

    // Z = 0 bounds no d: its radius is infinite by IEEE arithmetic, which the sanitizer reports, and is never looked at.
    __attribute__((no_sanitize("float-divide-by-zero"))) Margin(const C* E, const C* Z, Real W, const Real* B) {
        for (std::size_t j = 0; j < NY; ++j) {
            E_[j] = (Real(1) / B[j]) * E[j];
            Z_[j] = (Real(1) / B[j]) * Z[j];
            size_[j] = squared(Z_[j]);
            radius_[j] = Real(1) / size_[j];
            centre_[j] = radius_[j] * (E_[j] * conj(Z_[j]));
            gain_[j] = std::sqrt(size_[j]);
        }
        // The size of d itself is the disc of an output with E = 0, Z = 1 and bound W.
        gain_[NY] = Real(1) / W;
        size_[NY] = gain_[NY] * gain_[NY];
        radius_[NY] = Real(1) / size_[NY];
        centre_[NY] = {Real(0), Real(0)};
    }

    Real operator()() { return with_triples(with_pairs()); }

    /// The work in two parts: the least squared maximum over d = 0 and the pairs ...
    Real with_pairs() {
        consider_zero();
        for (std::size_t i = 0; i < NY; ++i) {
            for (std::size_t j = i + 1; j <= NY; ++j) {
                if (size_[i] > Real(0) && size_[j] > Real(0)) {
                    pair(i, j);
                }
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
                    if (size_[i] > Real(0) && size_[j] > Real(0) && size_[k] > Real(0)) {
                        triple(i, j, k);
                    }
                }
            }
        }
        return std::sqrt(best_);
    }

    /// The margin had the vehicle not responded, E = -Z: d is real from -1 to 0, where |d| / W rises to meet
    /// (1 - |d|) max |Z_j| / B_j.
    Real dead() const {
        Real largest = Real(0);
        for (std::size_t j = 0; j < NY; ++j) {
            largest = gain_[j] > largest ? gain_[j] : largest;
        }
        return largest * (gain_[NY] / (gain_[NY] + largest));
    }

private:
    std::array<C, NY> E_, Z_;                          // scaled by B
    std::array<C, NY + 1> centre_;                     // E / Z; a disc with Z = 0 is never looked at
    std::array<Real, NY + 1> size_, radius_, gain_;    // |Z|^2, its inverse (the squared radius at t = 1), |Z|
    Real best_ = std::numeric_limits<Real>::infinity();

    void consider(C d) {
        Real worst = squared(gain_[NY] * d);
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

    // d = 0. The products with Z are there for what is not finite.
    void consider_zero() {
        Real worst = Real(0);
        for (std::size_t j = 0; j < NY; ++j) {
            const Real f = squared(E_[j] - Real(0) * Z_[j]);
            if (!(f < best_)) {
                return;
            }
            worst = f > worst ? f : worst;
        }
        best_ = worst;
    }

    void pair(std::size_t i, std::size_t j) {
        const Real a = gain_[i], b = gain_[j];  // the radius of disc i is t / a
        consider((Real(1) / (a + b)) * (a * centre_[i] + b * centre_[j]));
    }

    // |d - c_m|^2 = s r_m^2 with s = t^2 for three discs. With the first centre as origin, subtracting the first equation
    // from the others gives d = p + s q; the first then is quadratic in s.
    void triple(std::size_t i, std::size_t j, std::size_t k) {
        const C origin = centre_[i];
        const C a = centre_[j] - origin;
        const C b = centre_[k] - origin;
        const Real ri = radius_[i], rj = radius_[j], rk = radius_[k];
        const Real det = Real(2) * (a.re * b.im - a.im * b.re);
        if (!(std::fabs(det) > Real(0))) {
            return;  // collinear centres: two discs decide
        }
        const Real ha = squared(a), hb = squared(b);
        const Real ga = ri - rj, gb = ri - rk;
        const Real inverse = Real(1) / det;
        const C p = inverse * C{ha * b.im - hb * a.im, hb * a.re - ha * b.re};
        const C q = inverse * C{ga * b.im - gb * a.im, gb * a.re - ga * b.re};
        // |p + s q|^2 = s ri, that is |q|^2 s^2 + 2 h s + |p|^2 = 0. The discriminant h^2 - |p|^2 |q|^2 is written with the
        // cross product of p and q: beside a disc much smaller than the others p and q are antiparallel, and the plain
        // form loses half of the digits.
        const Real dot = p.re * q.re + p.im * q.im;
        const Real cross = Real(0.5) * inverse * (ha * gb - hb * ga);
        const Real discriminant = ri * (Real(0.25) * ri - dot) - cross * cross;
        if (!(discriminant >= Real(0))) {
            return;
        }
        // Smaller root in the form that does not cancel (h < 0 whenever a positive root exists).
        const Real s = squared(p) / (std::sqrt(discriminant) + Real(0.5) * ri - dot);
        consider(origin + p + s * q);
    }
};

}  // namespace lpvg
