#include "lpvguard_plant/parameters.hpp"

#include <string>
#include <string_view>

#include "toml_input.hpp"

namespace lpvguard_plant {
namespace {

using P = PlantParameters;

/// One scalar of the file and its meaningful range.
struct Field {
    std::string_view section;
    std::string_view key;
    double P::* member;
    double low;
    double high;
};

constexpr Field fields[] = {
    {"chassis", "mass_kg", &P::mass_kg, 3000.0, 40000.0},
    {"chassis", "sprung_mass_kg", &P::sprung_mass_kg, 2000.0, 38000.0},
    {"chassis", "yaw_inertia_kgm2", &P::yaw_inertia_kgm2, 5000.0, 500000.0},
    {"chassis", "roll_inertia_kgm2", &P::roll_inertia_kgm2, 1000.0, 60000.0},
    {"chassis", "wheelbase_m", &P::wheelbase_m, 2.5, 7.0},
    {"chassis", "cg_to_front_axle_m", &P::cg_to_front_axle_m, 0.5, 6.0},
    {"chassis", "track_m", &P::track_m, 1.5, 2.6},
    {"chassis", "sprung_cg_height_m", &P::sprung_cg_height_m, 0.1, 2.5},
    {"chassis", "unsprung_cg_height_m", &P::unsprung_cg_height_m, 0.1, 1.0},
    {"chassis", "roll_stiffness_front_nmprad", &P::roll_stiffness_front_nmprad, 1e4, 2e6},
    {"chassis", "roll_stiffness_rear_nmprad", &P::roll_stiffness_rear_nmprad, 1e4, 2e6},
    {"chassis", "roll_damping_nmsprad", &P::roll_damping_nmsprad, 1e3, 2e5},
    {"chassis", "rolling_resistance_ratio", &P::rolling_resistance_ratio, 0.0, 0.05},
    {"chassis", "drag_area_m2", &P::drag_area_m2, 0.0, 15.0},
    {"tyres", "cornering_stiffness_front_nprad", &P::cornering_stiffness_front_nprad, 5e4, 1.5e6},
    {"tyres", "cornering_stiffness_rear_nprad", &P::cornering_stiffness_rear_nprad, 5e4, 1.5e6},
    {"tyres", "load_sensitivity_ratio", &P::load_sensitivity_ratio, 0.0, 0.9},
    {"tyres", "relaxation_length_m", &P::relaxation_length_m, 0.1, 2.0},
    {"tyres", "brake_slip_stiffness_n", &P::brake_slip_stiffness_n, 2e4, 2e6},
    {"tyres", "friction_left_ratio", &P::friction_left_ratio, 0.05, 1.5},
    {"tyres", "friction_right_ratio", &P::friction_right_ratio, 0.05, 1.5},
    {"steering", "steering_inertia_kgm2", &P::steering_inertia_kgm2, 10.0, 2000.0},
    {"steering", "steering_damping_nmsprad", &P::steering_damping_nmsprad, 50.0, 10000.0},
    {"steering", "kingpin_friction_nm", &P::kingpin_friction_nm, 0.0, 500.0},
    {"steering", "kingpin_friction_blend_radps", &P::kingpin_friction_blend_radps, 1e-4, 0.1},
    {"steering", "trail_m", &P::trail_m, 0.0, 0.3},
    {"steering", "scrub_radius_m", &P::scrub_radius_m, -0.3, 0.3},
    {"steering", "lateral_acceleration_moment_nms2pm", &P::lateral_acceleration_moment_nms2pm, -2000.0, 2000.0},
    {"steering", "rear_roll_steer_ratio", &P::rear_roll_steer_ratio, -0.5, 0.5},
    {"steering", "steering_ratio", &P::steering_ratio, 5.0, 40.0},
    {"steering", "steering_stop_rad", &P::steering_stop_rad, 0.1, 0.8},
    {"brakes", "brake_force_npbar", &P::brake_force_npbar, 0.0, 10000.0},
    {"brakes", "brake_lag_s", &P::brake_lag_s, 0.01, 2.0},
    {"brakes", "brake_delay_s", &P::brake_delay_s, 0.0, 1.0},
    {"brakes", "brake_pressure_limit_bar", &P::brake_pressure_limit_bar, 0.5, 12.0},
    {"surroundings", "bank_rms_rad", &P::bank_rms_rad, 0.0, 0.05},
    {"surroundings", "bank_length_m", &P::bank_length_m, 5.0, 2000.0},
    {"surroundings", "crosswind_mean_mps", &P::crosswind_mean_mps, -30.0, 30.0},
    {"surroundings", "crosswind_gust_rms_mps", &P::crosswind_gust_rms_mps, 0.0, 10.0},
    {"surroundings", "crosswind_gust_time_s", &P::crosswind_gust_time_s, 0.1, 100.0},
    {"surroundings", "side_force_area_m2", &P::side_force_area_m2, 0.0, 100.0},
    {"surroundings", "wind_arm_m", &P::wind_arm_m, -3.0, 3.0},
    {"surroundings", "wind_height_m", &P::wind_height_m, 0.0, 4.0},
};

/// One sensor: the section names the sensor, and its three keys are the members of SensorParameters.
struct SensorField {
    std::string_view section;
    SensorParameters P::* member;
    double largest;  ///< Bound on the magnitude of every key, in the sensor's unit.
};

constexpr SensorField sensor_fields[] = {
    {"sensor_yaw_rate_radps", &P::yaw_rate_sensor, 10.0},
    {"sensor_steering_wheel_rad", &P::steering_wheel_sensor, 50.0},
    {"sensor_lateral_acceleration_mps2", &P::lateral_acceleration_sensor, 50.0},
    {"sensor_speed_mps", &P::speed_sensor, 50.0},
    {"sensor_wheel_speed_mps", &P::wheel_speed_sensor, 50.0},
    {"sensor_brake_pressure_bar", &P::brake_pressure_sensor, 50.0},
};

struct SensorKey {
    std::string_view key;
    double SensorParameters::* member;
    double low_ratio;  ///< Lower end of the range over SensorField::largest.
};

constexpr SensorKey sensor_keys[] = {
    {"noise_rms", &SensorParameters::noise_rms, 0.0},
    {"lsb", &SensorParameters::lsb, 1e-9},  // The step of a grid is positive.
    {"offset", &SensorParameters::offset, -1.0},
};

std::string dotted(std::string_view section, std::string_view key) { return std::string(section) + "." + std::string(key); }

/// Returns the value of `section.key = { value = ..., source = "..." }`, and removes the key, so that unknown keys can be found.
double take_value(toml::table& document, const std::string& file, std::string_view section, std::string_view key) {
    const std::string where = dotted(section, key);
    toml::table* const group = document[section].as_table();
    toml::table* const entry = group == nullptr ? nullptr : (*group)[key].as_table();
    if (entry == nullptr) {
        throw ParameterError(file + ": " + where + ": missing, expected { value = number, source = \"text\" }");
    }
    require_known_keys(*entry, file, where + ".", {"value", "source"});
    const toml::node* const value = entry->get("value");
    if (value == nullptr) {
        throw ParameterError(file + ": " + where + ".value: missing, expected a number");
    }
    if ((*entry)["source"].value_or(std::string_view{}).empty()) {
        throw ParameterError(file + ": " + where + ".source: missing, expected where the value comes from");
    }
    const double result = number(*value, file, where + ".value");
    group->erase(key);
    return result;
}

void require_nothing_left(const toml::table& document, const std::string& file) {
    for (const auto& [section, node] : document) {
        const toml::table* const group = node.as_table();
        if (group == nullptr) {
            throw ParameterError(file + ": " + std::string(section.str()) + ": unknown key, expected sections only");
        }
        bool known = false;
        for (const Field& field : fields) {
            known = known || field.section == section.str();
        }
        for (const SensorField& sensor : sensor_fields) {
            known = known || sensor.section == section.str();
        }
        if (!known) {
            throw ParameterError(file + ": [" + std::string(section.str()) + "]: unknown section");
        }
        for (const auto& [key, entry] : *group) {
            static_cast<void>(entry);
            throw ParameterError(file + ": " + dotted(section.str(), key.str()) + ": unknown key");
        }
    }
}

void require_relation(bool holds, const std::string& file, const char* relation) {
    if (!holds) {
        throw ParameterError(file + ": expected " + relation);
    }
}

}  // namespace

void check(const PlantParameters& p, const std::string& name) {
    for (const Field& field : fields) {
        require_in_range(name, dotted(field.section, field.key), p.*field.member, field.low, field.high);
    }
    for (const SensorField& sensor : sensor_fields) {
        for (const SensorKey& key : sensor_keys) {
            require_in_range(name, dotted(sensor.section, key.key), p.*sensor.member.*key.member, key.low_ratio * sensor.largest,
                             sensor.largest);
        }
    }
    require_relation(p.sprung_mass_kg < p.mass_kg, name, "chassis.sprung_mass_kg < chassis.mass_kg");
    require_relation(p.cg_to_front_axle_m < p.wheelbase_m, name, "chassis.cg_to_front_axle_m < chassis.wheelbase_m");
    const double sprung_moment = p.sprung_mass_kg * p.sprung_cg_height_m;
    require_relation(p.roll_inertia_kgm2 > sprung_moment * sprung_moment / p.mass_kg, name,
                     "chassis.roll_inertia_kgm2 > (sprung_mass_kg sprung_cg_height_m)^2 / mass_kg (it is about the roll axis)");
    constexpr double gravity_mps2 = 9.81;
    require_relation(p.roll_stiffness_front_nmprad + p.roll_stiffness_rear_nmprad > gravity_mps2 * sprung_moment, name,
                     "roll stiffness > 9.81 sprung_mass_kg sprung_cg_height_m (else the truck tips over at rest)");
}

PlantParameters parse_parameters(const std::string& toml_text, const std::string& name) {
    toml::table document = parse_toml(toml_text, name);
    PlantParameters p;
    for (const Field& field : fields) {
        p.*field.member = take_value(document, name, field.section, field.key);
    }
    for (const SensorField& sensor : sensor_fields) {
        for (const SensorKey& key : sensor_keys) {
            p.*sensor.member.*key.member = take_value(document, name, sensor.section, key.key);
        }
    }
    require_nothing_left(document, name);
    check(p, name);
    return p;
}

PlantParameters load_parameters(const std::string& path) { return parse_parameters(read_text(path), path); }

PlantParameters varied(const PlantParameters& nominal, const Variation& v) {
    PlantParameters p = nominal;
    // The frame carries the payload. It adds to the sprung mass, and both inertias increase with their masses.
    p.mass_kg *= v.load_ratio;
    p.sprung_mass_kg += p.mass_kg - nominal.mass_kg;
    p.yaw_inertia_kgm2 *= v.load_ratio;
    p.roll_inertia_kgm2 *= p.sprung_mass_kg / nominal.sprung_mass_kg * v.cg_height_ratio * v.cg_height_ratio;
    p.cg_to_front_axle_m += v.cg_shift_m;
    // The moment comes from the load transfer between the front wheels, so it is proportional to the axle load.
    p.lateral_acceleration_moment_nms2pm *=
        v.load_ratio * (p.wheelbase_m - p.cg_to_front_axle_m) / (nominal.wheelbase_m - nominal.cg_to_front_axle_m);
    p.sprung_cg_height_m *= v.cg_height_ratio;
    p.friction_left_ratio *= v.friction_left_ratio;
    p.friction_right_ratio *= v.friction_right_ratio;
    p.cornering_stiffness_front_nprad *= v.cornering_stiffness_front_ratio;
    p.cornering_stiffness_rear_nprad *= v.cornering_stiffness_rear_ratio;
    p.brake_force_npbar *= v.brake_gain_ratio;
    p.brake_lag_s *= v.brake_lag_ratio;
    p.brake_delay_s += v.extra_brake_delay_s;
    p.bank_rms_rad = v.bank_rms_rad.value_or(p.bank_rms_rad);
    p.crosswind_mean_mps += v.crosswind_mean_mps;
    p.crosswind_gust_rms_mps = v.crosswind_gust_rms_mps.value_or(p.crosswind_gust_rms_mps);
    for (const SensorField& sensor : sensor_fields) {
        (p.*sensor.member).noise_rms *= v.sensor_noise_ratio;
        (p.*sensor.member).lsb *= v.sensor_lsb_ratio;
    }
    check(p, "variation");
    return p;
}

}  // namespace lpvguard_plant
