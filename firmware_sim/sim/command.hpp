/// @file command.hpp -- the driver's yaw-rate command over time, and the reference model for the tracking error.
#pragma once

#include <array>
#include <cstddef>
#include <cstdint>
#include <vector>

#include "scenario.hpp"

namespace lpvguard_sim {

/// Call next() once per sample period. The same settings and seed give the same bits.
class Command {
public:
    Command(const CommandSettings& settings, std::uint64_t seed, double period_s = 0.01);

    double next();  ///< [unit of the controlled output]

private:
    double on_profile(double time_s);

    struct Oscillator {
        double re, im;            ///< exp(j phase) of the next sample
        double step_re, step_im;
    };

    CommandSettings settings_;
    double period_s_;
    std::vector<Oscillator> oscillators_;
    double amplitude_radps_ = 0.0;
    std::int64_t samples_ = 0;
    std::size_t segment_ = 0;  ///< Segment of the profile.
};

/// b2, b1, b0, a2, a1, a0 of W_R = 9 / (s^2 + 5.4 s + 9).
constexpr std::array<double, 6> papers_reference_model = {0.0, 0.0, 9.0, 1.0, 5.4, 9.0};

/// W_R = (b2 s^2 + b1 s + b0) / (a2 s^2 + a1 s + a0) by the trapezoidal rule (0.1 % at 10 rad/s with 10 ms).
class ReferenceModel {
public:
    /// `coefficients` are b2, b1, b0, a2, a1, a0.
    ReferenceModel(const std::array<double, 6>& coefficients, double period_s);

    double step(double command);

private:
    double b_[3], a_[3];  ///< of the newest value, then of the older ones
    double in_[2] = {0.0, 0.0};
    double out_[2] = {0.0, 0.0};
};

}  // namespace lpvguard_sim
