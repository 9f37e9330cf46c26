/// @file scenario.hpp -- a scenario file: the driving of the truck, the yaw-rate command, and the faults.
///
///     title = "..."                    # one line for people
///     duration_s = 120.0
///     seed = 1                         # of road, noise, command and bus faults; --seed replaces it
///     [plant]                          # speed profile, variation, faults: lpvguard_plant/scenario.hpp
///     [command]                        # yaw-rate command; on a car's own bus in the unit of the controlled output
///     kind = "multisine"               # multisine, steps, profile or zero
///     rms_radps = 0.05                 # multisine
///     low_radps = 0.5                  # multisine: sines of random phase between these frequencies, with the rms above,
///     high_radps = 4.0                 #            at most high_radps, faded in over 5 s
///     spacing = "log"                  # multisine: "log" (few, excitation) or "linear" (many, band-limited noise)
///     amplitude_radps = 0.05           # steps: from side to side
///     period_s = 10.0                  # steps: of a whole cycle
///     knots = [[0.0, 0.0], [9.0, 0.1]] # profile: [time s, yaw rate rad/s], linear between knots, constant outside them
///     [[can_fault]]                    # any number, on messages to the controller, before GUARD_IN is authenticated
///     message = "VDC2"
///     kind = "lost"                    # lost; corrupted (one bit flipped); delayed; repeated (the previous frame replaces the
///                                      # new one); swapped (two frames at the time of the later one, in the wrong order);
///                                      # stuck_counter (GUARD_IN); wrong_length (7 bytes); unknown_id (10 additional
///                                      # foreign frames); babbling (10 additional frames with random data);
///                                      # bus_off (the controller reports it at start_s; no frame passes until end_s)
///     start_s = 30.0
///     end_s = 60.0                     # optional: until the end
///     probability = 1.0                # optional, for each frame
///     delay_s = 0.05                   # delayed
///     [expect]                         # required reactions and deadlines, for `lpvguard sim` (tools/src/lpvguard/extras/loop/sim.py)
///
/// Unknown keys, wrong types and numbers outside their ranges throw ParameterError naming file, key and range.
#pragma once

#include <cstdint>
#include <string>
#include <utility>
#include <vector>

#include "lpvguard_plant/scenario.hpp"

namespace lpvguard_sim {

struct CommandSettings {
    enum class Kind {
        zero,
        multisine,
        steps,
        profile
    };
    Kind kind = Kind::zero;
    double rms_radps = 0.0;
    double low_radps = 0.0;
    double high_radps = 0.0;
    bool linear_spacing = false;
    double amplitude_radps = 0.0;
    double period_s = 0.0;
    std::vector<std::pair<double, double>> knots;  ///< Time [s], yaw rate [rad/s]; times ascend strictly.
};

struct CanFault {
    enum class Kind {
        lost,
        corrupted,
        delayed,
        repeated,
        swapped,
        stuck_counter,
        wrong_length,
        unknown_id,
        babbling,
        bus_off
    };
    std::uint32_t id = 0;  ///< Identifier of the message on the bus.
    Kind kind = Kind::lost;
    lpvguard_plant::Window window;
    double probability = 1.0;
    double delay_s = 0.0;
};

struct Scenario {
    double duration_s = 0.0;
    std::uint64_t seed = 1;
    lpvguard_plant::Scenario plant;
    CommandSettings command;
    std::vector<CanFault> can_faults;
};

/// Reads and checks the text of a scenario file. Error messages use `name` as the file name. Throws lpvguard_plant::ParameterError.
Scenario parse_scenario(const std::string& text, const std::string& name);

}  // namespace lpvguard_sim
