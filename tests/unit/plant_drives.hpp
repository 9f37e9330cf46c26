/// @file plant_drives.hpp -- the shipped truck, a quiet one, and runs of it, for the tests of the plant.
#ifndef LPVGUARD_TESTS_PLANT_DRIVES_HPP
#define LPVGUARD_TESTS_PLANT_DRIVES_HPP

#include "../catch.hpp"

#include <array>
#include <cmath>
#include <fstream>
#include <sstream>
#include <string>

#include "lpvguard_plant/plant.hpp"
#include "lpvguard_plant/scenario.hpp"

namespace plant_drives {

using namespace lpvguard_plant;

inline PlantParameters shipped() { return load_parameters(LPVGUARD_TRUCK_TOML); }

/// Flat road, no wind, exact sensors.
inline PlantParameters quiet() {
    PlantParameters p = shipped();
    p.bank_rms_rad = 0.0;
    p.crosswind_gust_rms_mps = 0.0;
    for (SensorParameters* sensor : {&p.yaw_rate_sensor, &p.steering_wheel_sensor, &p.lateral_acceleration_sensor, &p.speed_sensor,
                                     &p.wheel_speed_sensor, &p.brake_pressure_sensor}) {
        *sensor = SensorParameters{0.0, 1e-7, 0.0};
    }
    return p;
}

inline Drive at(double speed_mps) {
    Drive drive;
    drive.speed_profile = {{0.0, speed_mps}};
    return drive;
}

inline void run(Plant& plant, double duration_s, double demand_bar, double driver_torque_nm = 0.0) {
    const long steps = std::lround(duration_s / Plant::step_s);
    for (long k = 0; k < steps; ++k) {
        plant.step(demand_bar, driver_torque_nm);
    }
}

inline std::string text_of(const char* path) {
    std::ifstream file(path);
    std::ostringstream text;
    text << file.rdbuf();
    return text.str();
}

inline std::string replaced(std::string text, const std::string& old_words, const std::string& new_words) {
    const std::size_t found = text.find(old_words);
    REQUIRE(found != std::string::npos);
    return text.replace(found, old_words.size(), new_words);
}

inline double sum(const std::array<double, 4>& values) { return values[0] + values[1] + values[2] + values[3]; }

}  // namespace plant_drives

#endif
