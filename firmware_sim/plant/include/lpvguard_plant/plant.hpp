/// @file plant.hpp -- the simulated vehicle: a two-axle truck that is steered by braking one front wheel.
///
/// Frames and signs (ISO 8855): x forward, y left, z up. Yaw rate, road-wheel angle, slip and lateral force are positive to the left.
/// Roll is positive when the left side rises, so a left bend rolls the body positively. Bank is positive when the road's left edge
/// is the higher one. Brake demand = pressure right - pressure left [bar]. A positive demand turns the truck right: the
/// scrub radius of the braked wheel turns the wheels towards it (Table I of the paper: DC gain r / demand = -1.94 / v).
///
/// Equations, in the order of plant.cpp
///   delay and lag     the demand passes a pure delay, is split into the two sides and lags: T dp/dt = demand - p
///   wheel loads       static + longitudinal + roll moments of each axle through its own springs, never below zero
///   tyres             relaxation s dα/dt + Vx α = Vy per wheel (α: tangent of slip, Pacejka, "Tire and Vehicle Dynamics", ch. 7);
///                     lateral force -C α F / sqrt(F² + (C α)²), F² = (μ Fz)² - Fx²: slope C at zero, friction ellipse as its
///                     limit, cubic departure from the line as Magic Formula curves have, no fall beyond the peak
///   lateral and roll  m A - ms h φ'' = ΣY - m g e + W;  Ix φ'' - ms h A = ms g h (φ + e) - K φ - c φ' - W hw;
///                     A = vy' + vx r, e the road's bank, W the side wind's force at height hw
///   yaw               Iz r' = lf ΣY_front - lr ΣY_rear + t/2 (ΣX_right - ΣX_left) + W lw
///   steering          J δ'' = -n ΣFy_front - scrub (B_right - B_left) + k (A + g e) - d δ' - friction + driver
///   speed             prescribed by a profile that an ideal drive follows, or free (rolling resistance, drag, brakes)
/// The model deliberately omits suspension compliance steer other than rear roll steer, pitch and heave dynamics, wheel spin (braked
/// wheels slip in proportion to the force), the drive force's share of the friction ellipse (3 kN of 45), and free play.
///
/// Range: side-slip below about 0.3 rad. The numbers of a spinning truck (low friction, high speed, strong braking) stay finite but
/// are not realistic, especially with a prescribed speed.
///
/// Integration: classical Runge-Kutta of order 4 at a fixed 1 ms, disturbances and demand held over the step. The fastest pole is
/// the tyre relaxation, at most 150 1/s (30 m/s over 0.2 m), far inside the stability limit of 2785 1/s. Explicit stages need no
/// iteration, so the cost per step is constant. Halving the step (`substeps`) moves the yaw rate by less than 1e-4 of its peak.
///
/// Use:     construct once, step() once per millisecond, read truth() and sensors() at any time.
/// Cost:    no heap, no libm beyond sqrt and floor in step(); about 0.3 us a step on a desktop core.
/// Repeats: same seed and inputs give the same bits with every compiler (tested: gcc -O3 and clang -O1 with sanitizers).
/// Threads: one instance per thread.
#pragma once

#include <array>
#include <cstddef>
#include <cstdint>
#include <vector>

#include "lpvguard_plant/faults.hpp"
#include "lpvguard_plant/parameters.hpp"
#include "lpvguard_plant/random.hpp"

namespace lpvguard_plant {

/// Wheel order of every array of four.
enum Wheel : std::size_t {
    front_left,
    front_right,
    rear_left,
    rear_right
};

struct SpeedKnot {
    double time_s = 0.0;
    double speed_mps = 0.0;
};

/// Speed of a profile, linear between its knots and constant outside. ``segment`` is the segment of an earlier time; it starts at 0.
double speed_at(const std::vector<SpeedKnot>& profile, double time_s, std::size_t& segment);

/// From start_s on, the speed moves at rate_mps2 to speed_mps and stays there.
struct SpeedChange {
    double start_s = 0.0;
    double speed_mps = 0.0;
    double rate_mps2 = 1.0;          ///< > 0
};

/// Longitudinal driving of the truck. Speeds lie in Plant::slowest_mps .. fastest_mps.
struct Drive {
    /// Linear between knots, constant outside them; the first knot is the initial speed. Times ascend strictly.
    std::vector<SpeedKnot> speed_profile;
    bool speed_is_free = false;      ///< Only the first knot is used, and the truck then coasts.
    std::vector<SpeedChange> speed_changes;  ///< Changes in the order of their starts; the newest started change replaces the profile.
    int substeps = 1;                ///< Integration steps per millisecond.
};

/// True state of the truck at the present time.
struct Truth {
    double time_s = 0.0;
    double speed_mps = 0.0;
    double lateral_velocity_mps = 0.0;        ///< Velocity of the roll axis below the CG.
    double yaw_rate_radps = 0.0;
    double lateral_acceleration_mps2 = 0.0;   ///< A above, horizontal, without gravity.
    double roll_rad = 0.0;
    double roll_rate_radps = 0.0;
    double road_wheel_rad = 0.0;
    double road_wheel_rate_radps = 0.0;
    double pressure_left_bar = 0.0;
    double pressure_right_bar = 0.0;
    double bank_rad = 0.0;
    double crosswind_mps = 0.0;
    std::array<double, 4> wheel_load_n{};
    std::array<double, 4> tyre_slip{};             ///< Tangent of the slip angle after relaxation, left positive.
    std::array<double, 4> tyre_lateral_force_n{};  ///< Force along the axis of each wheel.
    std::array<double, 4> brake_force_n{};         ///< Backwards along each wheel.
};

/// Sensor values of the truck: sampled every 10 ms with noise, faults and quantisation, and held in between.
struct Sensors {
    double time_s = 0.0;                      ///< Time of sampling.
    double yaw_rate_radps = 0.0;
    double steering_wheel_rad = 0.0;          ///< Road-wheel angle x PlantParameters::steering_ratio.
    double lateral_acceleration_mps2 = 0.0;   ///< Reading of an accelerometer on the body: A + g (roll + bank).
    double speed_mps = 0.0;                   ///< From the unbraked rear wheels.
    std::array<double, 4> wheel_speed_mps{};
    double brake_pressure_left_bar = 0.0;
    double brake_pressure_right_bar = 0.0;
};

class Plant {
public:
    static constexpr double step_s = 0.001;
    static constexpr int steps_per_sample = 10;   ///< Sensors sample every 10 ms.
    static constexpr double slowest_mps = 3.0;    ///< A free truck stops decelerating here.
    static constexpr double fastest_mps = 30.0;
    static constexpr double longest_delay_s = 2.0;

    /// Straight driving at the profile's first speed, brakes released. Copies its arguments.
    /// Throws ParameterError when the parameters, the profile or a fault lie outside their ranges.
    Plant(const PlantParameters& parameters, const Drive& drive, std::uint64_t seed, const Faults& faults = {});

    /// Advances by 1 ms under a brake demand and a driver's torque on the steering wheel, positive to the left. The demand is
    /// pressure right - left, limited to the brake's range; one that is not finite counts as 0.
    void step(double demand_bar, double driver_torque_nm = 0.0);

    /// Continues with another drive and other faults. The run equals that of a plant which had them from the start, on two conditions.
    /// They differ from the previous ones only after truth().time_s. The speed profile and the order of the faults stay the same.
    /// Throws ParameterError like the constructor, and then changes nothing.
    void revise(const Drive& drive, const Faults& faults);

    const Truth& truth() const { return truth_; }
    const Sensors& sensors() const { return sensors_; }

private:
    /// Integrated quantities. Arrays from `slip` on have the order of Wheel.
    enum Index : std::size_t {
        lateral_velocity,
        yaw_rate,
        roll,
        roll_rate,
        steer,
        steer_rate,
        pressure_left,
        pressure_right,
        speed,
        slip,
        state_size = slip + 4
    };
    using State = std::array<double, state_size>;

    /// Quantities that are held over a step.
    struct Held {
        double demand_left_bar, demand_right_bar;
        double inverse_lag_ps;
        double brake_force_npbar;
        double driver_moment_nm;
        double acceleration_mps2;   ///< Longitudinal acceleration, of the speed profile or of the previous step.
        double bank_rad;
        double crosswind_mps;
        std::array<double, 4> friction_squared;
        std::array<double, 4> cornering_stiffness_n;
    };

    /// By-products of the derivative that truth() shows.
    struct Forces {
        double lateral_acceleration_mps2;
        double longitudinal_acceleration_mps2;
        std::array<double, 4> wheel_load_n;
        std::array<double, 4> brake_force_n;
        std::array<double, 4> lateral_n;
    };

    Held hold(double demand_bar, double driver_torque_nm);
    State derivative(const State& x, const Held& in, Forces& forces) const;
    void integrate(const Held& in);
    double next_speed();
    void publish_truth(const Held& in);
    void sample_sensors();
    double measured(Signal signal, double true_value, const SensorParameters& sensor);

    PlantParameters p_;
    Drive drive_;
    Faults faults_;

    // Constants of the truck, computed once.
    double cg_to_rear_axle_m_;
    double static_load_front_n_, static_load_rear_n_;   ///< One wheel.
    double longitudinal_transfer_kg_;                   ///< One wheel's load change per longitudinal acceleration.
    double roll_damping_front_nmsprad_, roll_damping_rear_nmsprad_;
    double unsprung_moment_front_kgm_, unsprung_moment_rear_kgm_;
    double sprung_moment_kgm_;
    double reduced_roll_inertia_kgm2_;
    double side_force_factor_kgpm_;                     ///< 1/2 rho x side area.

    static constexpr std::size_t delay_line_size = 2048;  ///< Power of two above longest_delay_s / step_s.
    std::array<double, delay_line_size> delay_line_bar_{};

    std::int64_t step_count_ = 0;
    std::size_t profile_segment_ = 0;
    State x_{};
    Forces forces_{};
    double bank_rad_ = 0.0;
    double gust_mps_ = 0.0;
    Random bank_random_, gust_random_, sensor_random_;
    Truth truth_;
    Sensors sensors_;
    std::array<double, signal_count> held_{};  ///< For each Signal, the last value that was sampled while it was not frozen.
};

}  // namespace lpvguard_plant
