/// @file monitor_drive.hpp -- a simulated drive for the tests of the monitor, as a black box, of whatever vehicle they are built for.
#pragma once

#include "../catch.hpp"

#include <cmath>
#include <functional>

#include "lpvguard/monitor.h"

namespace {

using Real = lpvg_real_t;

const lpvg_coeff_words_t& words() { return lpvg_coeff.words; }
int64_t period_us() { return words().sample_period_us; }
uint32_t longest() { return words().frame_length[0]; }
Real cruise() { return Real(0.5) * (lpvg_coeff.reals.speed_min + lpvg_coeff.reals.speed_max); }

lpvg_coeff_t sealed(const std::function<void(lpvg_coeff_t&)>& change) {
    lpvg_coeff_t coeff = lpvg_coeff;
    change(coeff);
    coeff.words.crc32 = lpvg_coeff_crc32(&coeff);
    return coeff;
}

// A vehicle that answers with gain times the nominal output: E = (gain - 1) Z in every frame.
class Drive {
public:
    explicit Drive(const lpvg_coeff_t& coeff = lpvg_coeff, int64_t start_us = 0) : coeff_(coeff), t_us_(start_us) {
        REQUIRE(lpvg_monitor_init(&monitor, &coeff_) == lpvg_status_ok);
    }
    Drive(const Drive&) = delete;
    Drive& operator=(const Drive&) = delete;

    double gain = 1.0;
    double amplitude = 0.25;  // of the inputs, as part of their physical range
    uint32_t bin = LPVG_NBINS / 2;  // whose frequency the inputs have
    Real speed = cruise();
    lpvg_monitor_t monitor;
    lpvg_sample_t sample{};

    // Prepares the next sample, one period on.
    lpvg_sample_t& next() {
        if (started_) {
            lpvg_model_advance(&vehicle_, &coeff_, sample.speed, sample.u);
        }
        const double phase = 6.283185307179586 * coeff_.words.cycles[bin] * count_ / coeff_.words.frame_length[bin];
        for (std::size_t i = 0; i < LPVG_NU; ++i) {
            const double range = static_cast<double>(coeff_.reals.input_valid[i][1]);
            sample.u[i] = static_cast<Real>(amplitude * range * std::sin(phase + static_cast<double>(i)));
        }
        if (!started_) {
            lpvg_model_start(&vehicle_, &coeff_, sample.u, coeff_.reals.output_offset);
            started_ = true;
        }
        Real yhat[LPVG_NY];
        lpvg_model_output(&vehicle_, &coeff_, yhat);
        for (std::size_t j = 0; j < LPVG_NY; ++j) {
            sample.y[j] = static_cast<Real>(gain * static_cast<double>(yhat[j]));
        }
        sample.speed = speed;
        sample.t_us = t_us_;
        t_us_ += period_us();
        ++count_;
        return sample;
    }
    lpvg_status_t step() { return lpvg_monitor_push(&monitor, &next()); }

    // Pushes n samples; every status must be ok. Calls each frame that was judged on the way.
    void run(uint32_t n, const std::function<void(const lpvg_frame_t&)>& each = [](const lpvg_frame_t&) {}) {
        for (uint32_t k = 0; k < n; ++k) {
            const uint32_t before = monitor.frame.sequence;
            if (step() != lpvg_status_ok) {
                FAIL("a good sample was refused");
            }
            if (lpvg_monitor_frame(&monitor)->sequence != before) {
                each(*lpvg_monitor_frame(&monitor));
            }
        }
    }
    void settle() { run(words().settle_samples + longest() + LPVG_NLATENCY); }
    void skip(int64_t us) { t_us_ += us; }
    lpvg_verdict_t verdict() const { return lpvg_monitor_verdict(&monitor, sample.t_us); }
    int64_t now() const { return sample.t_us; }

private:
    lpvg_coeff_t coeff_;
    lpvg_model_t vehicle_{};
    bool started_ = false;
    int64_t t_us_;
    double count_ = 0.0;
};

}  // namespace
