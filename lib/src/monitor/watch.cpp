// watch.cpp -- see watch.h.
#include "lpvguard/watch.h"

#include <cmath>
#include <cstring>

#include "model_step.hpp"

namespace {

using Real = lpvg_real_t;
constexpr std::size_t ny = LPVG_NY;
constexpr std::size_t group = LPVG_NY / LPVG_NDELTA;  // outputs that one Delta is common to
using lpvguard::ConstMap;
using Signals = Eigen::Array<Real, 2 * LPVG_NY, 1>;

// The largest constant error of output j's gain that is inside of the certificate set, or of the healthy set where that one is too wide.
Real largest_gain(const lpvg_coeff_reals_t& r, std::size_t j) {
    const auto largest = static_cast<Real>(LPVG_WATCH_GAIN_MAX);
    Real least = r.W_certificate[0][j / group];
    for (const auto& bin : r.W_certificate) {
        least = bin[j / group] < least ? bin[j / group] : least;
    }
    if (least <= largest) {
        return least;
    }
    const Real healthy = r.change_threshold * r.change_unit[j][0] / r.change_scale[j][0];
    return healthy <= largest ? healthy : Real(1);
}

}  // namespace

extern "C" void lpvg_watch_limits(lpvg_watch_limits_t* limits, const lpvg_coeff_t* coeff) {
    const lpvg_coeff_reals_t& r = coeff->reals;
    const Real period = static_cast<Real>(coeff->words.sample_period_us) * Real(1e-6);
    const Real turn = static_cast<Real>(LPVG_WATCH_CORNER_RPS) * period;
    limits->share = turn / (Real(1) + turn);
    limits->forget[0] = period / (static_cast<Real>(LPVG_WATCH_SHORT_S) + period);
    limits->forget[1] = period / (static_cast<Real>(LPVG_WATCH_LONG_S) + period);
    limits->forget[2] = r.energy_forget[0];
    const Real coherence = static_cast<Real>(LPVG_WATCH_COHERENCE_S) / period + Real(1);
    for (std::size_t j = 0; j < ny; ++j) {
        // Power of the disturbance a sample: of each band sigma^2 over the samples of its memory.
        Real power = Real(0);
        for (std::size_t b = 1; b + 1U < LPVG_NBANDS; ++b) {
            power += r.energy_forget[b] / (r.energy_scale[b][j] * r.energy_scale[b][j]);
        }
        limits->disturbance[j] = std::sqrt(power * coherence);
        limits->slow_disturbance[j] = std::sqrt(power * coherence + Real(1) / (r.energy_scale[0][j] * r.energy_scale[0][j]));
        limits->gain[j] = largest_gain(r, j);
    }
}

extern "C" void lpvg_watch_start(lpvg_watch_t* self, const lpvg_model_t* model) {
    std::memset(self, 0, sizeof *self);
    std::memcpy(self->x, model->x, sizeof self->x);
    std::memcpy(self->past, model->past, sizeof self->past);
}

extern "C" void lpvg_watch_void(lpvg_watch_t* self) {
    std::memset(self->P, 0, sizeof self->P);
    std::memset(self->Q, 0, sizeof self->Q);
    self->violated = false;
    self->evidence = false;
}

extern "C" void lpvg_watch_take(lpvg_watch_t* self, const lpvg_watch_limits_t* limits, const lpvg_coeff_t* coeff, const lpvg_model_t* model,
                                bool settled, const lpvg_real_t* y, const lpvg_real_t* u) {
    Signals signal;
    signal.tail<LPVG_NY>() = (ConstMap<LPVG_NY, LPVG_NX>(&coeff->reals.C[0][0]) * ConstMap<LPVG_NX, 1>(self->x)).array();
    const lpvguard::Matrix<LPVG_NU, 1> deviation = ConstMap<LPVG_NU, 1>(u) - ConstMap<LPVG_NU, 1>(coeff->reals.input_offset);
    lpvguard::step_model(model->entry, self->x, self->past, deviation.data());
    if (y == nullptr) {
        return;
    }
    signal.head<LPVG_NY>() = Eigen::Map<const Eigen::Array<Real, LPVG_NY, 1>>(y) - signal.tail<LPVG_NY>();
    Eigen::Map<Signals> slow(self->slow);
    slow += (settled ? limits->share : Real(1)) * (signal - slow);
    if (!settled) {
        return;
    }
    signal -= slow;
    bool violated = false, evidence = false;
    for (std::size_t m = 0; m < LPVG_WATCH_MEMORIES; ++m) {
        const bool lasting = m + 1U == LPVG_WATCH_MEMORIES;
        const Real* error = lasting ? self->slow : signal.data();
        const Real* response = error + ny;
        const Real* disturbance = lasting ? limits->slow_disturbance : limits->disturbance;
        for (std::size_t j = 0; j < ny; ++j) {
            Real& p = self->P[m][j];
            Real& q = self->Q[m][j];
            p += error[j] * response[j] - limits->forget[m] * p;
            q += response[j] * response[j] - limits->forget[m] * q;
            const Real limit = limits->gain[j] * q + disturbance[j] * std::sqrt(q);
            const bool beyond = !(std::fabs(p) <= limit) && !(static_cast<Real>(LPVG_WATCH_ERROR_SHOWN) * q <= limit);
            violated = violated || (beyond && limits->gain[j] < Real(1));
            evidence = evidence || q > limit;  // never of an output that is not watched
        }
    }
    self->violated = violated;
    self->evidence = evidence;
}
