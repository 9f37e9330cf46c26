// watch.cpp -- see watch.h.
#include "lpvguard/watch.h"

#include <cmath>
#include <cstring>
#include <limits>

#include "model_step.hpp"

namespace {

using Real = lpvg_real_t;
constexpr std::size_t group = LPVG_NY / LPVG_NDELTA;  // outputs that one Delta is common to
using lpvguard::ConstMap;
using Signals = Eigen::Array<Real, 2 * LPVG_NY, 1>;
using Outputs = Eigen::Array<Real, LPVG_NY, 1>;
using ConstOutputs = Eigen::Map<const Outputs>;

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
    return healthy <= largest ? healthy : std::numeric_limits<Real>::max();
}

}  // namespace

extern "C" void lpvg_watch_limits(lpvg_watch_limits_t* limits, const lpvg_coeff_t* coeff) {
    const lpvg_coeff_reals_t& r = coeff->reals;
    const Real period = static_cast<Real>(coeff->words.sample_period_us) * Real(1e-6);
    const Real turn = static_cast<Real>(LPVG_WATCH_CORNER_RPS) * period;
    limits->share = turn / (Real(1) + turn);
    limits->keep[0] = static_cast<Real>(LPVG_WATCH_SHORT_S) / (static_cast<Real>(LPVG_WATCH_SHORT_S) + period);
    limits->keep[1] = static_cast<Real>(LPVG_WATCH_LONG_S) / (static_cast<Real>(LPVG_WATCH_LONG_S) + period);
    const Real quick = static_cast<Real>(LPVG_WATCH_QUICK_COHERENCE_S) / period + Real(1);
    const Real coherence = static_cast<Real>(LPVG_WATCH_COHERENCE_S) / period + Real(1);
    for (std::size_t j = 0; j < LPVG_NY; ++j) {
        // Power of the disturbance a sample: of each band sigma^2 over the samples of its memory.
        Real power[LPVG_NBANDS];
        for (std::size_t b = 0; b < LPVG_NBANDS; ++b) {
            power[b] = r.energy_forget[b] / (r.energy_scale[b][j] * r.energy_scale[b][j]);
        }
        Real inner = Real(0);
        for (std::size_t b = 1; b + 1U < LPVG_NBANDS; ++b) {
            inner += power[b] * coherence;
        }
        limits->disturbance[0][j] = std::sqrt(power[LPVG_NBANDS - 1] * quick);
        limits->disturbance[1][j] = std::sqrt(inner);
        limits->disturbance[2][j] = std::sqrt(inner + power[0] / r.energy_forget[0]);
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
    Eigen::Map<Signals> below(self->lag[0]), slow(self->lag[1]);
    below += (settled ? Real(2) * coeff->reals.energy_corner[LPVG_NBANDS - 2] : Real(1)) * (signal - below);
    slow += (settled ? limits->share : Real(1)) * (signal - slow);
    if (!settled) {
        return;
    }
    Eigen::Array<Real, 2 * LPVG_NY, LPVG_WATCH_MEMORIES> parts;
    parts.col(0) = signal - below;
    parts.col(1) = signal - slow;
    parts.col(2) = below;
    const Real keep[LPVG_WATCH_MEMORIES] = {limits->keep[0], limits->keep[1], Real(1) - coeff->reals.energy_forget[0]};
    bool violated = false, evidence = false;
    for (Eigen::Index m = 0; m < LPVG_WATCH_MEMORIES; ++m) {
        const Outputs error = parts.col(m).head<LPVG_NY>(), response = parts.col(m).tail<LPVG_NY>();
        Eigen::Map<Outputs> p(self->P[m]), q(self->Q[m]);
        p = keep[m] * p + error * response;
        q = keep[m] * q + response.square();
        const Outputs limit = ConstOutputs(limits->gain) * q + ConstOutputs(limits->disturbance[m]) * q.sqrt();
        violated = violated || !(p.abs() <= limit || static_cast<Real>(LPVG_WATCH_ERROR_SHOWN) * q <= limit).all();
        evidence = evidence || (q > limit).any();  // never of an output that is not watched
    }
    self->violated = violated;
    self->evidence = evidence;
}
