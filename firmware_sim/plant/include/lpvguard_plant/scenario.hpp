/// @file scenario.hpp -- the plant's part of a scenario file.
///
/// The plant only reads the table `plant` and ignores the rest of the file.
///
///     [plant]
///     speed_profile = [[0.0, 12.0], [30.0, 17.0]]      # [time s, speed m/s]
///     speed_is_free = false                            # optional
///     [plant.variation]                                # optional; keys are the members of Variation
///     load_ratio = 1.4
///     [[plant.sensor_fault]]                           # any number of each; keys are the members of SensorFault, ...
///     signal = "yaw_rate"
///     start_s = 30.0
///     end_s = 60.0                                     # optional: until the end
///     ramp_s = 20.0                                    # optional, for every kind of fault: time of growth
///     gain = -1.0
///     [[plant.actuator_fault]]
///     extra_delay_s = 0.4
///     [[plant.surroundings_fault]]
///     friction_left_ratio = 0.3
///     [[plant.speed_change]]                           # any number, in the order of their starts; members of SpeedChange
///     start_s = 40.0
///     speed_mps = 10.0
///     rate_mps2 = 0.5                                  # optional: 1
///
/// Unknown keys, wrong types and numbers outside their ranges throw ParameterError naming file, key and range.
#pragma once

#include <string>

#include "lpvguard_plant/faults.hpp"
#include "lpvguard_plant/parameters.hpp"
#include "lpvguard_plant/plant.hpp"

namespace lpvguard_plant {

struct Scenario {
    Drive drive;
    Variation variation;
    Faults faults;
};

Scenario load_scenario(const std::string& path);

/// Same, from text. Error messages use `name` as the file name.
Scenario parse_scenario(const std::string& toml_text, const std::string& name);

}  // namespace lpvguard_plant
