/// @file live_scenario.hpp -- a scenario that may still be changed while it runs, from the next tick on.
///
/// Whatever changes is an entry of the scenario's file, and text() is that file. Run from the start, it gives the same frames, byte for
/// byte, as the run that was changed on its way. A change therefore has to begin after the newest tick.
#pragma once

#include <cstdint>
#include <memory>
#include <string>

#include "scenario.hpp"

namespace lpvguard_sim {

class LiveScenario {
public:
    /// Reads and checks a scenario file. Throws lpvguard_plant::ParameterError.
    explicit LiveScenario(const std::string& path);
    ~LiveScenario();

    void set_seed(std::uint64_t seed);  ///< In place of the file's.

    const Scenario& now() const;
    std::string text() const;  ///< TOML. Comments of the file are gone.

    /// What a change would make of it.
    struct Change {
        std::string entry;  ///< Name of what was made or ended: plant.sensor_fault[0]
        std::string text;
        Scenario scenario;
    };

    /// `toml`: one entry without start_s, as in control_t (firmware_sim/lcm). It is of can_fault, plant.sensor_fault,
    /// plant.actuator_fault, plant.surroundings_fault or plant.speed_change. All three throw ParameterError for what the scenario file
    /// could not hold, or says already.
    Change injected(double start_s, const std::string& toml) const;
    Change cleared(double end_s, const std::string& entry) const;
    Change ended(double duration_s) const;

    void take(const Change& change);

private:
    struct Document;  ///< Its TOML.
    std::unique_ptr<Document> document_;
    Scenario scenario_;
};

}  // namespace lpvguard_sim
