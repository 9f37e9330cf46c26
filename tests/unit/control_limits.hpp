// control_limits.hpp -- the controller's limits as a test sees them, in double: no code shared with the core.
#ifndef TESTS_UNIT_CONTROL_LIMITS_HPP
#define TESTS_UNIT_CONTROL_LIMITS_HPP

#include <algorithm>
#include <cmath>
#include <cstddef>
#include <limits>

#include "lpvguard/controller.h"

// What rounding may add to a number that a few operations made.
inline constexpr double rounding = 1.0 + 8.0 * static_cast<double>(std::numeric_limits<lpvg_real_t>::epsilon());

// Position of a speed between the nodes, 0 to LPVG_NG - 1.
inline double node_position(const lpvg_control_reals_t& r, double speed) {
    const double low = static_cast<double>(r.speed_min), high = static_cast<double>(r.speed_max);
    return (std::fmin(std::fmax(speed, low), high) - low) / (high - low) * (LPVG_NG - 1);
}

// Largest |demand i| at a speed.
inline double limit_at(const lpvg_control_reals_t& r, double speed, std::size_t i) {
    const double position = node_position(r, speed);
    const auto below = static_cast<std::size_t>(std::floor(position)), above = static_cast<std::size_t>(std::ceil(position));
    const double weight = position - std::floor(position);
    return (1.0 - weight) * static_cast<double>(r.u_max[below][i]) + weight * static_cast<double>(r.u_max[above][i]);
}

// Largest |demand i| at any speed.
inline double largest_limit(const lpvg_control_reals_t& r, std::size_t i) {
    double largest = 0.0;
    for (const auto& node : r.u_max) {
        largest = std::fmax(largest, static_cast<double>(node[i]));
    }
    return largest;
}

// Largest |change of demand i| in a sample.
inline double largest_change(const lpvg_control_coeff_t& c, std::size_t i) {
    return static_cast<double>(c.reals.rate_max[i]) * 1e-6 * static_cast<double>(c.words.sample_period_us);
}

// Whether demand i follows `before` within the limits: its change is within the rate limit, and it is above the limit of the
// speed only while it comes down to it.
inline bool within_limits(const lpvg_control_coeff_t& c, double speed, std::size_t i, lpvg_real_t before, lpvg_real_t now) {
    const double was = static_cast<double>(before), is = static_cast<double>(now), change = largest_change(c, i);
    const double top = std::fmax(limit_at(c.reals, speed, i), std::fabs(was) - change);
    return std::fabs(is - was) <= change * (1.0 + 1e-4) && std::fabs(is) <= top * rounding + 1e-4 * change;
}

#endif
