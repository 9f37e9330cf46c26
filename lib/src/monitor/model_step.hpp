// model_step.hpp -- one step of the nominal model's state, for the whole model and for its response to the demand alone.
#pragma once

#include "eigen.hpp"
#include "lpvguard/coeff.h"

namespace lpvguard {

template <int Rows, int Cols>
using Matrix = Eigen::Matrix<lpvg_real_t, Rows, Cols, Cols == 1 ? Eigen::ColMajor : Eigen::RowMajor>;
template <int Rows, int Cols>
using ConstMap = Eigen::Map<const Matrix<Rows, Cols>>;

// Advances x with the input u: entry holds Ad, B_old and B_new; past the delayed inputs, the newest first.
inline void step_model(const lpvg_real_t* entry, lpvg_real_t* x, lpvg_real_t (*past)[LPVG_NU], const lpvg_real_t* u) {
    constexpr int nx = LPVG_NX, nu = LPVG_NU;
    // With a delay of d samples u_{k-d} is past[d] with this input as the newest, and u_{k-d-1} is past[d] before.
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
