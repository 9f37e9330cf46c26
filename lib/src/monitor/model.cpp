// model.cpp -- see model.h.
#include "lpvguard/model.h"

#include <limits>

#include "acceptance.hpp"
#include "model_step.hpp"

namespace {

using Real = lpvg_real_t;
using lpvguard::ConstMap;
using lpvguard::Matrix;

constexpr int nx = LPVG_NX, nu = LPVG_NU, ny = LPVG_NY;
constexpr Real no_speed = std::numeric_limits<Real>::lowest();  // below every reading: sensors can give small negative speeds

// Sets the entries that vary to their values at the speed. Constant entries stay.
void set_speed(lpvg_model_t* self, const lpvg_coeff_t* coeff, Real speed) {
    if (speed == self->speed) {
        return;
    }
    lpvguard::set_varying(*coeff, coeff->reals.cell, speed, self->entry);
    self->speed = speed;
    self->sum = lpvguard::sum_of_words(self->entry);
}

}  // namespace

extern "C" void lpvg_model_start(lpvg_model_t* self, const lpvg_coeff_t* coeff, const lpvg_real_t* u, const lpvg_real_t* y) {
    const lpvg_coeff_reals_t& r = coeff->reals;
    for (std::size_t i = 0; i < LPVG_NENTRIES; ++i) {
        self->entry[i] = r.base[i];
    }
    self->speed = no_speed;
    self->sum = lpvguard::sum_of_words(self->entry);
    for (auto& past : self->past) {
        for (std::size_t i = 0; i < LPVG_NU; ++i) {
            past[i] = u[i] - r.input_offset[i];
        }
    }
    Eigen::Map<Matrix<nx, 1>>(self->x) = ConstMap<nx, ny>(&r.C_pinv[0][0]) * (ConstMap<ny, 1>(y) - ConstMap<ny, 1>(r.output_offset));
}

extern "C" void lpvg_model_output(const lpvg_model_t* self, const lpvg_coeff_t* coeff, lpvg_real_t* yhat) {
    const lpvg_coeff_reals_t& r = coeff->reals;
    Eigen::Map<Matrix<ny, 1>>{yhat} = ConstMap<ny, nx>(&r.C[0][0]) * ConstMap<nx, 1>(self->x) + ConstMap<ny, 1>(r.output_offset);
}

extern "C" void lpvg_model_advance(lpvg_model_t* self, const lpvg_coeff_t* coeff, lpvg_real_t speed, const lpvg_real_t* u) {
    set_speed(self, coeff, speed);
    const Matrix<nu, 1> deviation = ConstMap<nu, 1>(u) - ConstMap<nu, 1>(coeff->reals.input_offset);
    lpvguard::step_model(self->entry, self->x, self->past, deviation.data());
}
