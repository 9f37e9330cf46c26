/// @file plant.hpp -- the truth of the simulator: a two-axle truck that is steered by braking one front wheel.
///
/// Frames and signs (ISO 8855): x forward, y left, z up. Yaw rate, road-wheel angle, slip and lateral force are positive to the left.
/// Roll is positive when the left side rises, so a left bend rolls the body positively. Bank is positive when the road's left edge
/// is the higher one. Brake demand = pressure right - pressure left [bar]. A positive demand turns the truck right: the
/// scrub radius of the braked wheel turns the wheels towards it (Table I of the paper: DC gain r / demand = -1.94 / v).
///
/// Equations (plant.cpp carries them out in this order)
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
/// Left out, knowingly: suspension compliance steer other than rear roll steer, pitch and heave dynamics, wheel spin (braked
/// wheels slip in proportion to the force), the drive force's share of the friction ellipse (3 kN of 45), free play.
///
/// Range: side-slip below about 0.3 rad. A truck that spins (low friction, high speed, much brake) stays finite but is no longer a
/// truck, least of all with its speed held.
///
/// Integration: classical Runge-Kutta of order 4 at a fixed 1 ms, disturbances and demand held over the step. The fastest pole is
/// the tyre relaxation, at most 150 1/s (30 m/s over 0.2 m), far inside the stability limit of 2785 1/s. Explicit stages need no
/// iteration, so the cost per step is constant. Halving the step (`substeps`) moves the yaw rate by less than 1e-4 of its peak.
///
/// Use:     construct once, step() once per millisecond, read truth() and sensors() at any time.
/// Cost:    no heap, no libm beyond sqrt and floor in step(); about 0.3 us a step on a desktop core.
/// Repeats: same seed, same inputs, same bits, whatever the compiler (tested: gcc -O3 and clang -O1 with sanitizers).
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

/// Speed of a profile, linear between its knots and constant outside. ``segment`` is that of an earlier time, from 0 on.
double speed_at(const std::vector<SpeedKnot>& profile, double time_s, std::size_t& segment);

/// From start_s on the speed goes at rate_mps2 from where it is to speed_mps and stays there.
struct SpeedChange {
    double start_s = 0.0;
    double speed_mps = 0.0;
    double rate_mps2 = 1.0;          ///< > 0
};

/// How the truck is driven along. Speeds lie in Plant::slowest_mps .. fastest_mps.
struct Drive {
    /// Linear between knots, constant outside them; the first knot is the initial speed. Times ascend strictly.
    std::vector<SpeedKnot> speed_profile;
    bool speed_is_free = false;      ///< Only the first knot counts, then the truck coasts.
    std::vector<SpeedChange> speed_changes;  ///< In the order of their starts; the newest one that has begun replaces the profile.
    int substeps = 1;                ///< Integration steps per millisecond.
};

/// What really happens, at the present time.
struct Truth {
    double time_s = 0.0;
    double speed_mps = 0.0;
    double lateral_velocity_mps = 0.0;        ///< Of the roll axis below the CG.
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
    std::array<double, 4> tyre_lateral_force_n{};  ///< Along each wheel's own axis.
    std::array<double, 4> brake_force_n{};         ///< Backwards along each wheel.
};

/// What the truck's sensors deliver: sampled every 10 ms, noisy, faulty, on their number grids, held in between.
struct Sensors {
    double time_s = 0.0;                      ///< Of sampling.
    double yaw_rate_radps = 0.0;
    double steering_wheel_rad = 0.0;          ///< Road-wheel angle x PlantParameters::steering_ratio.
    double lateral_acceleration_mps2 = 0.0;   ///< What an accelerometer on the body feels: A + g (roll + bank).
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

    /// Goes on with another drive and other faults. The run is that of a plant which had them from the start, on two conditions.
    /// They differ from the ones before only after truth().time_s. The speed profile and the order of the faults stay.
    /// Throws ParameterError as the constructor does; nothing has changed then.
    void revise(const Drive& drive, const Faults& faults);

    const Truth& truth() const { return truth_; }
    const Sensors& sensors() const { return sensors_; }

private:
    /// Integrated quantities; `slip` and on are ordered as Wheel.
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

    /// Everything held over a step.
    struct Held {
        double demand_left_bar, demand_right_bar;
        double inverse_lag_ps;
        double brake_force_npbar;
        double driver_moment_nm;
        double acceleration_mps2;   ///< Longitudinal, of the speed profile or of the previous step.
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

    // Constants of the truck, derived once.
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
    std::array<double, signal_count> held_{};  ///< Per Signal the last value sampled while it was not freezing.
};

}  // namespace lpvguard_plant
