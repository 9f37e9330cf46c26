#include "lpvguard_plant/plant.hpp"

#include <algorithm>
#include <cmath>
#include <string>

namespace lpvguard_plant {
namespace {

constexpr double gravity_mps2 = 9.81;
constexpr double air_density_kgpm3 = 1.2;

/// The EBS keeps a braked wheel within this share of its friction limit, so that the wheel still steers (an ideal anti-lock function).
constexpr double usable_brake_share = 0.9;

double square(double x) { return x * x; }

/// Series for |x| <= 0.8 (the largest steering stop), with an error below 4e-7, or 1e-12 in ordinary driving. Unlike libm, it gives
/// the same bits on machines with and without FMA.
double small_sine(double x) {
    const double x2 = x * x;
    return x * (1.0 - x2 / 6.0 * (1.0 - x2 / 20.0 * (1.0 - x2 / 42.0)));
}

double small_cosine(double x) {
    const double x2 = x * x;
    return 1.0 - x2 / 2.0 * (1.0 - x2 / 12.0 * (1.0 - x2 / 30.0 * (1.0 - x2 / 56.0)));
}

/// One step of a stationary first-order Gauss-Markov process with standard deviation rms; share = step / correlation length.
double gauss_markov(double value, double rms, double share, Random& random) {
    const double memory = 1.0 - share;
    return memory * value + rms * std::sqrt(1.0 - memory * memory) * random.normal();
}

void require(bool holds, const std::string& expectation) {
    if (!holds) {
        throw ParameterError("plant: expected " + expectation);
    }
}

void check_drive(const Drive& drive) {
    require(!drive.speed_profile.empty(), "at least one knot in the speed profile");
    for (std::size_t i = 0; i < drive.speed_profile.size(); ++i) {
        const SpeedKnot& knot = drive.speed_profile[i];
        require(knot.speed_mps >= Plant::slowest_mps && knot.speed_mps <= Plant::fastest_mps,
                "speeds of 3 .. 30 m/s in the profile, found " + std::to_string(knot.speed_mps));
        require(std::isfinite(knot.time_s) && (i == 0 || knot.time_s > drive.speed_profile[i - 1].time_s),
                "finite, strictly ascending times in the speed profile");
    }
    for (std::size_t i = 0; i < drive.speed_changes.size(); ++i) {
        const SpeedChange& change = drive.speed_changes[i];
        require(!drive.speed_is_free, "no speed changes of a truck that coasts");
        require(change.speed_mps >= Plant::slowest_mps && change.speed_mps <= Plant::fastest_mps && change.rate_mps2 > 0.0,
                "speed changes to 3 .. 30 m/s at a rate above 0");
        require(std::isfinite(change.start_s) && (i == 0 || change.start_s >= drive.speed_changes[i - 1].start_s),
                "speed changes in the order of their starts");
    }
    require(drive.substeps >= 1 && drive.substeps <= 100, "1 .. 100 substeps");
}

void check_window(const Window& window) {
    require(window.end_s > window.start_s, "fault windows that end after they start");
    require(std::isfinite(window.ramp_s) && window.ramp_s >= 0.0, "fault ramp_s >= 0 s");
}

void check_faults(const Faults& faults, const PlantParameters& p) {
    for (const SensorFault& fault : faults.sensors) {
        check_window(fault.window);
        require(fault.extra_noise_rms >= 0.0, "sensor fault extra_noise_rms >= 0");
        require(
            std::isfinite(fault.gain) && std::isfinite(fault.bias) && std::isfinite(fault.drift_ps) && std::isfinite(fault.extra_noise_rms),
            "finite sensor fault sizes");
    }
    double delay_s = p.brake_delay_s;
    for (const ActuatorFault& fault : faults.actuators) {
        check_window(fault.window);
        require(fault.brake_gain_ratio >= 0.0 && fault.brake_gain_ratio <= 10.0, "actuator fault brake_gain_ratio 0 .. 10");
        require(fault.extra_lag_s >= 0.0 && fault.extra_lag_s <= 10.0, "actuator fault extra_lag_s 0 .. 10 s");
        require(fault.extra_delay_s >= 0.0, "actuator fault extra_delay_s >= 0");
        delay_s += fault.extra_delay_s;
    }
    require(delay_s <= Plant::longest_delay_s, "at most 2 s of brake delay in total");
    for (const SurroundingsFault& fault : faults.surroundings) {
        check_window(fault.window);
        for (const double ratio : {fault.friction_left_ratio, fault.friction_right_ratio, fault.cornering_stiffness_front_ratio,
                                   fault.cornering_stiffness_rear_ratio}) {
            require(ratio > 0.01 && ratio < 10.0, "surroundings fault ratios 0.01 .. 10");
        }
        require(std::fabs(fault.crosswind_mps) <= 50.0, "surroundings fault crosswind_mps -50 .. 50");
    }
}

}  // namespace

Plant::Plant(const PlantParameters& parameters, const Drive& drive, std::uint64_t seed, const Faults& faults)
    : p_(parameters), drive_(drive), faults_(faults), bank_random_(seed, 1), gust_random_(seed, 2), sensor_random_(seed, 3) {
    check(p_, "plant parameters");
    check_drive(drive_);
    check_faults(faults_, p_);

    cg_to_rear_axle_m_ = p_.wheelbase_m - p_.cg_to_front_axle_m;
    const double front_share = cg_to_rear_axle_m_ / p_.wheelbase_m;
    static_load_front_n_ = 0.5 * p_.mass_kg * gravity_mps2 * front_share;
    static_load_rear_n_ = 0.5 * p_.mass_kg * gravity_mps2 * (1.0 - front_share);
    const double unsprung_mass_kg = p_.mass_kg - p_.sprung_mass_kg;
    sprung_moment_kgm_ = p_.sprung_mass_kg * p_.sprung_cg_height_m;
    unsprung_moment_front_kgm_ = unsprung_mass_kg * p_.unsprung_cg_height_m * front_share;
    unsprung_moment_rear_kgm_ = unsprung_mass_kg * p_.unsprung_cg_height_m * (1.0 - front_share);
    longitudinal_transfer_kg_ = 0.5 * (sprung_moment_kgm_ + unsprung_mass_kg * p_.unsprung_cg_height_m) / p_.wheelbase_m;
    const double front_roll_share = p_.roll_stiffness_front_nmprad / (p_.roll_stiffness_front_nmprad + p_.roll_stiffness_rear_nmprad);
    roll_damping_front_nmsprad_ = p_.roll_damping_nmsprad * front_roll_share;
    roll_damping_rear_nmsprad_ = p_.roll_damping_nmsprad * (1.0 - front_roll_share);
    reduced_roll_inertia_kgm2_ = p_.roll_inertia_kgm2 - square(sprung_moment_kgm_) / p_.mass_kg;
    side_force_factor_kgpm_ = 0.5 * air_density_kgpm3 * p_.side_force_area_m2;

    x_[speed] = drive_.speed_profile.front().speed_mps;
    bank_rad_ = p_.bank_rms_rad * bank_random_.normal();
    gust_mps_ = p_.crosswind_gust_rms_mps * gust_random_.normal();
    forces_ = Forces{};
    Held in = hold(0.0, 0.0);
    in.acceleration_mps2 = 0.0;
    derivative(x_, in, forces_);
    publish_truth(in);
    sample_sensors();
}

double speed_at(const std::vector<SpeedKnot>& profile, double time_s, std::size_t& segment) {
    while (segment + 1 < profile.size() && time_s >= profile[segment + 1].time_s) {
        ++segment;
    }
    const SpeedKnot& from = profile[segment];
    if (time_s <= from.time_s || segment + 1 == profile.size()) {
        return from.speed_mps;
    }
    const SpeedKnot& to = profile[segment + 1];
    return from.speed_mps + (to.speed_mps - from.speed_mps) * (time_s - from.time_s) / (to.time_s - from.time_s);
}

// Speed of an ideal drive at the end of the step that begins now.
double Plant::next_speed() {
    const auto& changes = drive_.speed_changes;
    const auto begun = std::find_if(changes.rbegin(), changes.rend(), [&](const SpeedChange& c) { return c.start_s <= truth_.time_s; });
    if (begun == changes.rend()) {
        return speed_at(drive_.speed_profile, truth_.time_s + step_s, profile_segment_);
    }
    const double most_mps = begun->rate_mps2 * step_s;
    return x_[speed] + std::clamp(begun->speed_mps - x_[speed], -most_mps, most_mps);
}

void Plant::revise(const Drive& drive, const Faults& faults) {
    check_drive(drive);
    check_faults(faults, p_);
    drive_ = drive;
    faults_ = faults;
}

Plant::Held Plant::hold(double demand_bar, double driver_torque_nm) {
    const double time_s = truth_.time_s;
    double gain = 1.0;
    double lag_s = p_.brake_lag_s;
    double delay_s = p_.brake_delay_s;
    for (const ActuatorFault& fault : faults_.actuators) {
        const double share = fault.window.share(time_s);
        gain *= shared_ratio(fault.brake_gain_ratio, share);
        lag_s += share * fault.extra_lag_s;
        delay_s += share * fault.extra_delay_s;
    }
    double friction_left = p_.friction_left_ratio;
    double friction_right = p_.friction_right_ratio;
    double stiffness_front_n = 0.5 * p_.cornering_stiffness_front_nprad;
    double stiffness_rear_n = 0.5 * p_.cornering_stiffness_rear_nprad;
    double crosswind_mps = p_.crosswind_mean_mps + gust_mps_;
    for (const SurroundingsFault& fault : faults_.surroundings) {
        const double share = fault.window.share(time_s);
        friction_left *= shared_ratio(fault.friction_left_ratio, share);
        friction_right *= shared_ratio(fault.friction_right_ratio, share);
        stiffness_front_n *= shared_ratio(fault.cornering_stiffness_front_ratio, share);
        stiffness_rear_n *= shared_ratio(fault.cornering_stiffness_rear_ratio, share);
        crosswind_mps += share * fault.crosswind_mps;
    }

    constexpr std::size_t wrap = delay_line_size - 1;
    const auto now = static_cast<std::size_t>(step_count_);
    const double limit = p_.brake_pressure_limit_bar;
    delay_line_bar_[now & wrap] = std::isfinite(demand_bar) ? std::clamp(demand_bar, -limit, limit) : 0.0;
    const auto delay_steps = static_cast<std::size_t>(delay_s / step_s + 0.5);
    // The demand before the first step is 0. The line holds these zeros.
    const double delayed_bar = delay_line_bar_[(now - delay_steps) & wrap];

    Held in{};
    in.demand_left_bar = std::max(-delayed_bar, 0.0);
    in.demand_right_bar = std::max(delayed_bar, 0.0);
    in.inverse_lag_ps = 1.0 / lag_s;
    in.brake_force_npbar = p_.brake_force_npbar * gain;
    in.driver_moment_nm = driver_torque_nm * p_.steering_ratio;
    in.acceleration_mps2 = drive_.speed_is_free ? forces_.longitudinal_acceleration_mps2 : (next_speed() - x_[speed]) / step_s;
    in.bank_rad = bank_rad_;
    in.crosswind_mps = crosswind_mps;
    in.friction_squared = {square(friction_left), square(friction_right), square(friction_left), square(friction_right)};
    in.cornering_stiffness_n = {stiffness_front_n, stiffness_front_n, stiffness_rear_n, stiffness_rear_n};
    return in;
}

// This function is long because it has all equations of plant.hpp in their order. Each one uses forces of the previous ones.
Plant::State Plant::derivative(const State& x, const Held& in, Forces& forces) const {
    State dx{};
    const double vx = x[speed];
    const double vy = x[lateral_velocity];
    const double r = x[yaw_rate];

    dx[pressure_left] = (in.demand_left_bar - x[pressure_left]) * in.inverse_lag_ps;
    dx[pressure_right] = (in.demand_right_bar - x[pressure_right]) * in.inverse_lag_ps;

    // Wheel loads. The unsprung masses use vx r + g e instead of A, because A depends on the loads, and vy' is small.
    const double felt_mps2 = vx * r + gravity_mps2 * in.bank_rad;
    const double front_roll_moment_nm =
        p_.roll_stiffness_front_nmprad * x[roll] + roll_damping_front_nmsprad_ * x[roll_rate] + unsprung_moment_front_kgm_ * felt_mps2;
    const double rear_roll_moment_nm =
        p_.roll_stiffness_rear_nmprad * x[roll] + roll_damping_rear_nmsprad_ * x[roll_rate] + unsprung_moment_rear_kgm_ * felt_mps2;
    const double longitudinal_n = longitudinal_transfer_kg_ * in.acceleration_mps2;
    const double mean_front_n = static_load_front_n_ - longitudinal_n;
    const double mean_rear_n = static_load_rear_n_ + longitudinal_n;
    // After lift-off, the other wheel carries the axle.
    const double shift_front_n = std::clamp(front_roll_moment_nm / p_.track_m, -mean_front_n, mean_front_n);
    const double shift_rear_n = std::clamp(rear_roll_moment_nm / p_.track_m, -mean_rear_n, mean_rear_n);
    forces.wheel_load_n = {mean_front_n - shift_front_n, mean_front_n + shift_front_n, mean_rear_n - shift_rear_n,
                           mean_rear_n + shift_rear_n};

    // Tyres.
    const double sine_front = small_sine(x[steer]);
    const double cosine_front = small_cosine(x[steer]);
    const double sine_rear = small_sine(p_.rear_roll_steer_ratio * x[roll]);
    const double cosine_rear = small_cosine(p_.rear_roll_steer_ratio * x[roll]);
    const std::array<double, 4> sine{sine_front, sine_front, sine_rear, sine_rear};
    const std::array<double, 4> cosine{cosine_front, cosine_front, cosine_rear, cosine_rear};
    const double half_track_speed = 0.5 * p_.track_m * r;
    const std::array<double, 4> body_vx{vx - half_track_speed, vx + half_track_speed, vx - half_track_speed, vx + half_track_speed};
    const double front_vy = vy + p_.cg_to_front_axle_m * r;
    const double rear_vy = vy - cg_to_rear_axle_m_ * r;
    const std::array<double, 4> body_vy{front_vy, front_vy, rear_vy, rear_vy};
    const double inverse_front_load = 1.0 / static_load_front_n_;
    const double inverse_rear_load = 1.0 / static_load_rear_n_;
    const std::array<double, 4> inverse_static_load{inverse_front_load, inverse_front_load, inverse_rear_load, inverse_rear_load};
    const std::array<double, 4> wanted_brake_n{in.brake_force_npbar * x[pressure_left], in.brake_force_npbar * x[pressure_right], 0.0, 0.0};
    const double inverse_relaxation_pm = 1.0 / p_.relaxation_length_m;
    std::array<double, 4> body_x_n{};
    std::array<double, 4> body_y_n{};
    for (std::size_t i = 0; i < 4; ++i) {
        const double wheel_vx = body_vx[i] * cosine[i] + body_vy[i] * sine[i];
        const double wheel_vy = body_vy[i] * cosine[i] - body_vx[i] * sine[i];
        // Slip relaxes in both rolling directions. With the sign of the speed, it would grow without limit in a truck that has spun round.
        dx[slip + i] = (wheel_vy - std::fabs(wheel_vx) * x[slip + i]) * inverse_relaxation_pm;

        const double load_ratio = forces.wheel_load_n[i] * inverse_static_load[i];
        const double stiffness_n = in.cornering_stiffness_n[i] * load_ratio * (1.0 - p_.load_sensitivity_ratio * (load_ratio - 1.0));
        const double grip_squared = in.friction_squared[i] * square(forces.wheel_load_n[i]);
        const double brake_squared = std::min(square(wanted_brake_n[i]), square(usable_brake_share) * grip_squared);
        forces.brake_force_n[i] = brake_squared < square(wanted_brake_n[i]) ? std::sqrt(brake_squared) : wanted_brake_n[i];
        const double limit_squared = grip_squared - brake_squared;
        const double linear_n = -stiffness_n * x[slip + i];
        constexpr double lifted_wheel_n2 = 1e-6;  // Prevents a division by zero for a wheel in the air.
        forces.lateral_n[i] = linear_n * std::sqrt(limit_squared / (limit_squared + square(linear_n) + lifted_wheel_n2));

        body_x_n[i] = -forces.brake_force_n[i] * cosine[i] - forces.lateral_n[i] * sine[i];
        body_y_n[i] = forces.lateral_n[i] * cosine[i] - forces.brake_force_n[i] * sine[i];
    }

    // Lateral and roll motion: solves the equations for A and the roll acceleration.
    const double wind_n = side_force_factor_kgpm_ * vx * in.crosswind_mps;
    const double front_y_n = body_y_n[front_left] + body_y_n[front_right];
    const double rear_y_n = body_y_n[rear_left] + body_y_n[rear_right];
    const double side_n = front_y_n + rear_y_n + wind_n - p_.mass_kg * gravity_mps2 * in.bank_rad;
    const double roll_nm = sprung_moment_kgm_ * gravity_mps2 * (x[roll] + in.bank_rad) -
                           (p_.roll_stiffness_front_nmprad + p_.roll_stiffness_rear_nmprad) * x[roll] -
                           p_.roll_damping_nmsprad * x[roll_rate] - wind_n * p_.wind_height_m;
    const double roll_acceleration = (roll_nm + sprung_moment_kgm_ / p_.mass_kg * side_n) / reduced_roll_inertia_kgm2_;
    const double lateral_mps2 = (side_n + sprung_moment_kgm_ * roll_acceleration) / p_.mass_kg;
    forces.lateral_acceleration_mps2 = lateral_mps2;
    dx[lateral_velocity] = lateral_mps2 - vx * r;
    dx[roll] = x[roll_rate];
    dx[roll_rate] = roll_acceleration;

    // Yaw.
    const double left_x_n = body_x_n[front_left] + body_x_n[rear_left];
    const double right_x_n = body_x_n[front_right] + body_x_n[rear_right];
    dx[yaw_rate] = (p_.cg_to_front_axle_m * front_y_n - cg_to_rear_axle_m_ * rear_y_n + 0.5 * p_.track_m * (right_x_n - left_x_n) +
                    wind_n * p_.wind_arm_m) /
                   p_.yaw_inertia_kgm2;

    // Steering. Coulomb friction is smoothed near rest, so that the step size need not resolve a jump.
    const double friction_nm =
        p_.kingpin_friction_nm * x[steer_rate] / std::sqrt(square(x[steer_rate]) + square(p_.kingpin_friction_blend_radps));
    const double steering_nm = -p_.trail_m * (forces.lateral_n[front_left] + forces.lateral_n[front_right]) -
                               p_.scrub_radius_m * (forces.brake_force_n[front_right] - forces.brake_force_n[front_left]) +
                               p_.lateral_acceleration_moment_nms2pm * (lateral_mps2 + gravity_mps2 * in.bank_rad) -
                               p_.steering_damping_nmsprad * x[steer_rate] - friction_nm + in.driver_moment_nm;
    dx[steer] = x[steer_rate];
    dx[steer_rate] = steering_nm / p_.steering_inertia_kgm2;

    // Speed.
    const double resistance_n =
        p_.rolling_resistance_ratio * p_.mass_kg * gravity_mps2 + 0.5 * air_density_kgpm3 * p_.drag_area_m2 * square(vx);
    forces.longitudinal_acceleration_mps2 = (left_x_n + right_x_n - resistance_n) / p_.mass_kg;
    dx[speed] = drive_.speed_is_free ? forces.longitudinal_acceleration_mps2 + vy * r : in.acceleration_mps2;
    return dx;
}

void Plant::integrate(const Held& in) {
    const double h = step_s / drive_.substeps;
    const auto moved = [](const State& from, double duration, const State& rate) {
        State to;
        for (std::size_t i = 0; i < state_size; ++i) {
            to[i] = from[i] + duration * rate[i];
        }
        return to;
    };
    for (int substep = 0; substep < drive_.substeps; ++substep) {
        const State k1 = derivative(x_, in, forces_);
        const State k2 = derivative(moved(x_, 0.5 * h, k1), in, forces_);
        const State k3 = derivative(moved(x_, 0.5 * h, k2), in, forces_);
        const State k4 = derivative(moved(x_, h, k3), in, forces_);
        for (std::size_t i = 0; i < state_size; ++i) {
            x_[i] += h / 6.0 * (k1[i] + 2.0 * (k2[i] + k3[i]) + k4[i]);
        }
        if (std::fabs(x_[steer]) > p_.steering_stop_rad) {
            x_[steer] = std::copysign(p_.steering_stop_rad, x_[steer]);
            x_[steer_rate] = 0.0;
        }
        x_[speed] = std::max(x_[speed], slowest_mps);
    }
}

void Plant::step(double demand_bar, double driver_torque_nm) {
    const Held in = hold(demand_bar, driver_torque_nm);
    integrate(in);
    ++step_count_;
    bank_rad_ = gauss_markov(bank_rad_, p_.bank_rms_rad, x_[speed] * step_s / p_.bank_length_m, bank_random_);
    gust_mps_ = gauss_markov(gust_mps_, p_.crosswind_gust_rms_mps, step_s / p_.crosswind_gust_time_s, gust_random_);
    publish_truth(in);
    if (step_count_ % steps_per_sample == 0) {
        sample_sensors();
    }
}

void Plant::publish_truth(const Held& in) {
    truth_.time_s = static_cast<double>(step_count_) * step_s;
    truth_.speed_mps = x_[speed];
    truth_.lateral_velocity_mps = x_[lateral_velocity];
    truth_.yaw_rate_radps = x_[yaw_rate];
    truth_.lateral_acceleration_mps2 = forces_.lateral_acceleration_mps2;
    truth_.roll_rad = x_[roll];
    truth_.roll_rate_radps = x_[roll_rate];
    truth_.road_wheel_rad = x_[steer];
    truth_.road_wheel_rate_radps = x_[steer_rate];
    truth_.pressure_left_bar = x_[pressure_left];
    truth_.pressure_right_bar = x_[pressure_right];
    truth_.bank_rad = in.bank_rad;
    truth_.crosswind_mps = in.crosswind_mps;
    truth_.wheel_load_n = forces_.wheel_load_n;
    std::copy(x_.begin() + slip, x_.end(), truth_.tyre_slip.begin());
    truth_.tyre_lateral_force_n = forces_.lateral_n;
    truth_.brake_force_n = forces_.brake_force_n;
}

double Plant::measured(Signal signal, double true_value, const SensorParameters& sensor) {
    double gain = 1.0;
    double offset = 0.0;
    double variance = square(sensor.noise_rms);
    double frozen = 0.0;
    for (const SensorFault& fault : faults_.sensors) {
        if (fault.signal == signal) {
            const double share = fault.window.share(truth_.time_s);
            gain *= shared_ratio(fault.gain, share);
            offset += share * (fault.bias + fault.drift_ps * (truth_.time_s - fault.window.start_s));
            variance += square(share * fault.extra_noise_rms);
            frozen = fault.frozen ? std::max(frozen, share) : frozen;
        }
    }
    // Noise is drawn even for a frozen sensor, because a fault on one signal must not change the noise of the others.
    const double noise = std::sqrt(variance) * sensor_random_.normal();
    double& held = held_[static_cast<std::size_t>(signal)];
    if (frozen >= 1.0) {
        return held;
    }
    const double moving = gain * true_value + offset + noise;
    const double raw = std::floor((moving + frozen * (held - moving) - sensor.offset) / sensor.lsb + 0.5);
    const double value = sensor.offset + sensor.lsb * raw;
    if (frozen == 0.0) {
        held = value;
    }
    return value;
}

void Plant::sample_sensors() {
    sensors_.time_s = truth_.time_s;
    sensors_.yaw_rate_radps = measured(Signal::yaw_rate, truth_.yaw_rate_radps, p_.yaw_rate_sensor);
    sensors_.steering_wheel_rad = measured(Signal::steering_wheel, truth_.road_wheel_rad * p_.steering_ratio, p_.steering_wheel_sensor);
    sensors_.lateral_acceleration_mps2 =
        measured(Signal::lateral_acceleration, truth_.lateral_acceleration_mps2 + gravity_mps2 * (truth_.roll_rad + truth_.bank_rad),
                 p_.lateral_acceleration_sensor);
    sensors_.speed_mps = measured(Signal::speed, truth_.speed_mps, p_.speed_sensor);

    const double half_track_speed = 0.5 * p_.track_m * truth_.yaw_rate_radps;
    const double front_vy = truth_.lateral_velocity_mps + p_.cg_to_front_axle_m * truth_.yaw_rate_radps;
    const double cosine = small_cosine(truth_.road_wheel_rad);
    const double sine = small_sine(truth_.road_wheel_rad);
    const std::array<double, 4> wheel_speed_mps{
        (truth_.speed_mps - half_track_speed) * cosine + front_vy * sine,
        (truth_.speed_mps + half_track_speed) * cosine + front_vy * sine,
        truth_.speed_mps - half_track_speed,
        truth_.speed_mps + half_track_speed,
    };
    constexpr std::array<Signal, 4> wheel_signal{Signal::wheel_speed_front_left, Signal::wheel_speed_front_right,
                                                 Signal::wheel_speed_rear_left, Signal::wheel_speed_rear_right};
    for (std::size_t i = 0; i < 4; ++i) {
        const double slip_ratio = forces_.brake_force_n[i] / p_.brake_slip_stiffness_n;
        sensors_.wheel_speed_mps[i] =
            measured(wheel_signal[i], std::max(wheel_speed_mps[i] * (1.0 - slip_ratio), 0.0), p_.wheel_speed_sensor);
    }
    sensors_.brake_pressure_left_bar = measured(Signal::brake_pressure_left, truth_.pressure_left_bar, p_.brake_pressure_sensor);
    sensors_.brake_pressure_right_bar = measured(Signal::brake_pressure_right, truth_.pressure_right_bar, p_.brake_pressure_sensor);
}

}  // namespace lpvguard_plant
