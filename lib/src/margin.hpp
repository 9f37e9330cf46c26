// margin.hpp -- exact margin t* of one frame (DESIGN 4.7): a weighted 1-centre problem of n_y + 1 discs in the plane.
//
//     t* = min over complex d of max( |d| / W, |E_j - d Z_j| / B_j )
//
// At the optimum two or three of the terms are active, so d is one of finitely many candidates, each in closed form:
//   two discs i, j:   d on the segment between the centres, dividing it as the radii do;
//   three discs:      d equidistant (in units of the radii) from three centres, a quadratic equation in t^2.
// Every candidate is *evaluated*, and the least maximum is returned: rounding in a candidate can only raise t*, to second
// order, and never lowers it below a value that some d attains. Z_j = 0 needs no gate: its term does not depend on d.
#pragma once

#include <array>
#include <cmath>
#include <cstddef>

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

    Margin(const C* E, const C* Z, Real W, const Real* B) {
        for (std::size_t j = 0; j < NY; ++j) {
            E_[j] = (Real(1) / B[j]) * E[j];
            Z_[j] = (Real(1) / B[j]) * Z[j];
        }
        // The size of d itself is the disc of an output with E = 0, Z = 1 and bound W.
        E_[NY] = {Real(0), Real(0)};
        Z_[NY] = {Real(1) / W, Real(0)};
    }

    Real operator()() {
        consider({Real(0), Real(0)});
        for (std::size_t i = 0; i <= NY; ++i) {
            if (!(squared(Z_[i]) > Real(0))) {
                continue;
            }
            for (std::size_t j = i + 1; j <= NY; ++j) {
                if (squared(Z_[j]) > Real(0)) {
                    pair(i, j);
                    for (std::size_t k = j + 1; k <= NY; ++k) {
                        if (squared(Z_[k]) > Real(0)) {
                            triple(i, j, k);
                        }
                    }
                }
            }
        }
        return std::sqrt(best_);
    }

private:
    std::array<C, NY + 1> E_, Z_;
    Real best_ = Real(-1);

    void consider(C d) {
        Real worst = Real(0);
        for (std::size_t j = 0; j <= NY; ++j) {
            const Real f = squared(E_[j] - d * Z_[j]);
            worst = f > worst ? f : worst;
        }
        best_ = (best_ < Real(0) || worst < best_) ? worst : best_;
    }

    C centre(std::size_t j) const { return (Real(1) / squared(Z_[j])) * (E_[j] * conj(Z_[j])); }

    void pair(std::size_t i, std::size_t j) {
        const Real a = std::sqrt(squared(Z_[i]));  // the radius of disc i is t / a
        const Real b = std::sqrt(squared(Z_[j]));
        consider((Real(1) / (a + b)) * (a * centre(i) + b * centre(j)));
    }

    // |d - c_m|^2 = s r_m^2 with s = t^2 for three discs. With the first centre as origin, subtracting the first equation
    // from the others gives d = p + s q; the first then is quadratic in s.
    void triple(std::size_t i, std::size_t j, std::size_t k) {
        const C origin = centre(i);
        const C a = centre(j) - origin;
        const C b = centre(k) - origin;
        const Real ri = Real(1) / squared(Z_[i]);
        const Real rj = Real(1) / squared(Z_[j]);
        const Real rk = Real(1) / squared(Z_[k]);
        const Real det = Real(2) * (a.re * b.im - a.im * b.re);
        if (!(std::fabs(det) > Real(0))) {
            return;  // collinear centres: two discs decide
        }
        const Real ha = squared(a), hb = squared(b);
        const Real ga = ri - rj, gb = ri - rk;
        const C p = (Real(1) / det) * C{ha * b.im - hb * a.im, hb * a.re - ha * b.re};
        const C q = (Real(1) / det) * C{ga * b.im - gb * a.im, gb * a.re - ga * b.re};
        // |p + s q|^2 = s ri
        const Real A = squared(q);
        const Real half_B = p.re * q.re + p.im * q.im - Real(0.5) * ri;
        const Real C0 = squared(p);
        const Real discriminant = half_B * half_B - A * C0;
        if (!(discriminant >= Real(0))) {
            return;
        }
        // Smaller root in the form that does not cancel (half_B < 0 whenever a positive root exists).
        const Real s = C0 / (std::sqrt(discriminant) - half_B);
        consider(origin + p + s * q);
    }
};

}  // namespace lpvg
