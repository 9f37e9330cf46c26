/// @file parameters.hpp -- the parameters of the simulated truck, read from one TOML file and checked.
///
/// Every entry of truck.toml is `key = { value = ..., source = "..." }`. The suffix of the key is the unit. For a missing or unknown
/// entry, an entry without source, or a value out of range, ParameterError names the file, the key and the expected range. Units are
/// SI, except brake pressure [bar]. Axle quantities ("front", "rear") are for the whole axle, i.e. both wheels.
#pragma once

#include <optional>
#include <stdexcept>
#include <string>

namespace lpvguard_plant {

/// Error in a parameter or scenario file; what() names file, key and expected range.
class ParameterError : public std::runtime_error {
public:
    using std::runtime_error::runtime_error;
};

/// Noise and number grid of one measured signal: output = offset + lsb * round((signal + noise - offset) / lsb).
struct SensorParameters {
    double noise_rms = 0.0;  ///< Rms of the white noise at the 10 ms sampling instants, in the signal's unit.
    double lsb = 0.0;        ///< Step of the number grid, in the signal's unit.
    double offset = 0.0;     ///< Value of raw 0. The grid need not contain zero (e.g. J1939 yaw rate).
};

struct PlantParameters {
    // Chassis. CG = centre of gravity of the whole truck. The roll axis lies in the ground plane below the CG.
    double mass_kg = 0.0;
    double sprung_mass_kg = 0.0;
    double yaw_inertia_kgm2 = 0.0;         ///< About the vertical through the CG.
    double roll_inertia_kgm2 = 0.0;        ///< Sprung mass, about the roll axis.
    double wheelbase_m = 0.0;
    double cg_to_front_axle_m = 0.0;
    double track_m = 0.0;                  ///< Same at both axles.
    double sprung_cg_height_m = 0.0;       ///< Above the roll axis.
    double unsprung_cg_height_m = 0.0;
    double roll_stiffness_front_nmprad = 0.0;
    double roll_stiffness_rear_nmprad = 0.0;
    double roll_damping_nmsprad = 0.0;     ///< Sum of both axles, divided between them like the stiffness.
    double rolling_resistance_ratio = 0.0; ///< Share of the weight; only used with a free speed.
    double drag_area_m2 = 0.0;             ///< c_d A; only used with a free speed.

    // Tyres.
    double cornering_stiffness_front_nprad = 0.0;
    double cornering_stiffness_rear_nprad = 0.0;
    double load_sensitivity_ratio = 0.0;   ///< k in C = C0 x (1 - k (x - 1)), x = wheel load / static wheel load.
    double relaxation_length_m = 0.0;
    double brake_slip_stiffness_n = 0.0;   ///< Brake force per unit of longitudinal slip, one wheel.
    double friction_left_ratio = 0.0;
    double friction_right_ratio = 0.0;

    // Steering of both front wheels together, about the kingpins.
    double steering_inertia_kgm2 = 0.0;
    double steering_damping_nmsprad = 0.0;
    double kingpin_friction_nm = 0.0;
    double kingpin_friction_blend_radps = 0.0; ///< Rate at which friction reaches 71 % of its limit.
    double trail_m = 0.0;                      ///< Kingpin axis to the lateral force, at the ground, positive ahead.
    double scrub_radius_m = 0.0;               ///< Kingpin axis to the wheel's middle plane, at the ground.
    double lateral_acceleration_moment_nms2pm = 0.0; ///< [Nm/(m/s^2)], turns the wheels into the bend.
    double rear_roll_steer_ratio = 0.0;        ///< Rear-axle steer angle per body roll angle, into the bend.
    double steering_ratio = 0.0;               ///< Steering-wheel angle per road-wheel angle.
    double steering_stop_rad = 0.0;            ///< Largest road-wheel angle.

    // Brakes: EBS, front discs.
    double brake_force_npbar = 0.0;        ///< One wheel.
    double brake_lag_s = 0.0;
    double brake_delay_s = 0.0;            ///< Rounded to the 1 ms step.
    double brake_pressure_limit_bar = 0.0;

    // Surroundings.
    double bank_rms_rad = 0.0;
    double bank_length_m = 0.0;
    double crosswind_mean_mps = 0.0;       ///< Blowing towards the left.
    double crosswind_gust_rms_mps = 0.0;
    double crosswind_gust_time_s = 0.0;
    double side_force_area_m2 = 0.0;       ///< Side area times d(side-force coefficient)/d(flow angle).
    double wind_arm_m = 0.0;               ///< Centre of pressure ahead of the CG.
    double wind_height_m = 0.0;            ///< Centre of pressure above the roll axis.

    // Sensors.
    SensorParameters yaw_rate_sensor;
    SensorParameters steering_wheel_sensor;
    SensorParameters lateral_acceleration_sensor;
    SensorParameters speed_sensor;
    SensorParameters wheel_speed_sensor;
    SensorParameters brake_pressure_sensor;
};

/// Differences of one truck from truck.toml, as stated by scenarios. The default is no difference.
struct Variation {
    double load_ratio = 1.0;                 ///< Total mass over nominal; payload changes the sprung mass and both inertias.
    double cg_shift_m = 0.0;                 ///< Rearwards positive.
    double cg_height_ratio = 1.0;
    double friction_left_ratio = 1.0;        ///< All ratios multiply the values of truck.toml.
    double friction_right_ratio = 1.0;
    double cornering_stiffness_front_ratio = 1.0;
    double cornering_stiffness_rear_ratio = 1.0;
    double brake_gain_ratio = 1.0;
    double brake_lag_ratio = 1.0;
    double extra_brake_delay_s = 0.0;
    std::optional<double> bank_rms_rad;      ///< Empty: the value of truck.toml.
    double crosswind_mean_mps = 0.0;         ///< Added.
    std::optional<double> crosswind_gust_rms_mps;
    double sensor_noise_ratio = 1.0;         ///< Factor for every sensor.
    double sensor_lsb_ratio = 1.0;           ///< Factor of the quantisation step of every sensor.
};

/// Reads and checks a parameter file. Throws ParameterError.
PlantParameters load_parameters(const std::string& path);

/// Same, from text. Error messages use `name` as the file name.
PlantParameters parse_parameters(const std::string& toml_text, const std::string& name);

/// Applies a variation. Throws ParameterError if a parameter is then out of range.
PlantParameters varied(const PlantParameters& nominal, const Variation& variation);

/// Throws ParameterError that names the first parameter out of range, or a violated relation between two parameters.
void check(const PlantParameters& parameters, const std::string& name);

}  // namespace lpvguard_plant
