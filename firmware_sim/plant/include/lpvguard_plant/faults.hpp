/// @file faults.hpp -- faults of the simulated truck: place, size and time.
///
/// Each fault acts in its own window of simulated time, at the place where it would act in a truck. A fault of a sensor acts after the
/// truth and before the quantisation. A fault of the actuator acts between the demand and the brake force. A fault of the surroundings
/// acts in the tyre contact and the air.
/// Windows of one kind may overlap: gains multiply, offsets add. The default of every member means no fault.
/// A fault with a ramp grows. Its share is 0 at the start of the window, and 1 after ramp_s. A ratio or gain g acts as
/// 1 + share (g - 1). An offset, a delay, a lag, a drift and the rms of a noise act as share times their size. A frozen sensor reads
/// (1 - share) measured + share held.
#pragma once

#include <algorithm>
#include <limits>
#include <vector>

namespace lpvguard_plant {

/// start <= t < end, simulated time since the first step.
struct Window {
    double start_s = 0.0;
    double end_s = std::numeric_limits<double>::infinity();
    double ramp_s = 0.0;  ///< Time in which a fault of the plant reaches its full size; 0: at once.

    bool contains(double time_s) const { return time_s >= start_s && time_s < end_s; }

    /// Share of a fault's size at this time: 0 outside the window, 0 to 1 on the ramp, 1 after the ramp.
    double share(double time_s) const {
        if (!contains(time_s)) {
            return 0.0;
        }
        return ramp_s > 0.0 ? std::min(1.0, (time_s - start_s) / ramp_s) : 1.0;
    }
};

/// Returns a gain or ratio with a share of its effect.
inline double shared_ratio(double ratio, double share) { return share < 1.0 ? 1.0 + share * (ratio - 1.0) : ratio; }

enum class Signal {
    yaw_rate,
    steering_wheel,
    lateral_acceleration,
    speed,
    wheel_speed_front_left,
    wheel_speed_front_right,
    wheel_speed_rear_left,
    wheel_speed_rear_right,
    brake_pressure_left,
    brake_pressure_right,
};
inline constexpr int signal_count = 10;

/// measured = gain * truth + bias + drift * (time since the window's start) + noise, in the signal's unit.
struct SensorFault {
    Signal signal = Signal::yaw_rate;
    Window window;
    double gain = 1.0;  ///< -1: sign flipped.
    double bias = 0.0;
    double drift_ps = 0.0;  ///< Per second.
    double extra_noise_rms = 0.0;
    bool frozen = false;  ///< Repeats the last value before the window. Of several such faults, the one with the largest share counts.
};

struct ActuatorFault {
    Window window;
    double brake_gain_ratio = 1.0;  ///< Brake force per pressure; 0: actuator lost.
    double extra_lag_s = 0.0;
    double extra_delay_s = 0.0;  ///< The sum with the truck's own delay is at most Plant::longest_delay_s.
};

struct SurroundingsFault {
    Window window;
    double friction_left_ratio = 1.0;
    double friction_right_ratio = 1.0;
    double cornering_stiffness_front_ratio = 1.0;
    double cornering_stiffness_rear_ratio = 1.0;
    double crosswind_mps = 0.0;  ///< Added wind, positive towards the left.
};

struct Faults {
    std::vector<SensorFault> sensors;
    std::vector<ActuatorFault> actuators;
    std::vector<SurroundingsFault> surroundings;
};

}  // namespace lpvguard_plant
