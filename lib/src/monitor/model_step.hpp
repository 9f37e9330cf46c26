// model_step.hpp -- entries of a model at a speed, and one step of its state, for the nominal and for further models.
#pragma once

#include "eigen.hpp"
#include "lpvguard/coeff.h"

namespace lpvguard {

template <int Rows, int Cols>
using Matrix = Eigen::Matrix<lpvg_real_t, Rows, Cols, Cols == 1 ? Eigen::ColMajor : Eigen::RowMajor>;
template <int Rows, int Cols>
using ConstMap = Eigen::Map<const Matrix<Rows, Cols>>;

// Sets the entries of a model that vary with speed, from the cubics of the speed's cell.
inline void set_varying(const lpvg_coeff_t& coeff, const lpvg_real_t (*cubic)[LPVG_NVARYING][4], lpvg_real_t speed, lpvg_real_t* entry) {
    using Real = lpvg_real_t;
    const lpvg_coeff_reals_t& r = coeff.reals;
    const Real inside = speed < r.speed_min ? r.speed_min : (speed > r.speed_max ? r.speed_max : speed);
    const Real position = (inside - r.speed_min) / (r.speed_max - r.speed_min) * Real(LPVG_NCELLS);
    // Damaged coefficients may make the position NaN. It is never above LPVG_NCELLS.
    const Real bounded = position > Real(0) ? position : Real(0);
    auto cell = static_cast<std::size_t>(bounded);
    cell = cell < LPVG_NCELLS ? cell : LPVG_NCELLS - 1U;
    const Real x = bounded - static_cast<Real>(cell);
    for (std::size_t i = 0; i < LPVG_NVARYING; ++i) {
        const Real* const p = cubic[cell][i];
        const uint32_t index = coeff.words.varying_entry[i];
        entry[index < LPVG_NENTRIES ? index : 0U] = p[0] + x * (p[1] + x * (p[2] + x * p[3]));
    }
}

// Advances x with the input u. `entry` holds Ad, B_old and B_new. `past` holds the delayed inputs, the newest first.
inline void step_model(const lpvg_real_t* entry, lpvg_real_t* x, lpvg_real_t (*past)[LPVG_NU], const lpvg_real_t* u) {
    constexpr int nx = LPVG_NX, nu = LPVG_NU;
    // With a delay of d samples, past[d] is u_{k-d-1} before the shift, and u_{k-d} after it.
    const Matrix<nu, 1> u_old = ConstMap<nu, 1>(past[LPVG_DELAY]);
    for (std::size_t d = LPVG_DELAY; d > 0; --d) {
        Eigen::Map<Matrix<nu, 1>>{past[d]} = ConstMap<nu, 1>(past[d - 1]);
    }
    Eigen::Map<Matrix<nu, 1>>{past[0]} = ConstMap<nu, 1>(u);
    const Matrix<nx, 1> next = ConstMap<nx, nx>(entry) * ConstMap<nx, 1>(x) + ConstMap<nx, nu>(entry + nx * nx) * u_old +
                               ConstMap<nx, nu>(entry + nx * (nx + nu)) * ConstMap<nu, 1>(past[LPVG_DELAY]);
    Eigen::Map<Matrix<nx, 1>>{x} = next;
}

}  // namespace lpvguard
