/// @file command.hpp -- the driver's yaw-rate command over time, and the reference model for the tracking error.
#pragma once

#include <cstddef>
#include <cstdint>
#include <vector>

#include "scenario.hpp"

namespace lpvguard_sim {

/// Call next() once per 10 ms. The same settings and seed give the same bits.
class Command {
public:
    Command(const CommandSettings& settings, std::uint64_t seed);

    double next();  ///< [rad/s]

private:
    double on_profile(double time_s);

    struct Oscillator {
        double re, im;            ///< exp(j phase) of the next sample
        double step_re, step_im;
    };

    CommandSettings settings_;
    std::vector<Oscillator> oscillators_;
    double amplitude_radps_ = 0.0;
    std::int64_t samples_ = 0;
    std::size_t segment_ = 0;  ///< Segment of the profile.
};

/// W_R = 9 / (s^2 + 5.4 s + 9) at 10 ms by the trapezoidal rule (0.1 % at 10 rad/s).
class ReferenceModel {
public:
    double step(double command_radps);

private:
    double in_[2] = {0.0, 0.0};
    double out_[2] = {0.0, 0.0};
};

}  // namespace lpvguard_sim
