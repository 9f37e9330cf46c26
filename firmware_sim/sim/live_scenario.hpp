/// @file live_scenario.hpp -- a scenario that clients can change while it runs, from the next tick on.
///
/// Each change is an entry of the scenario file, and text() returns the changed file. A run of this file from the start gives the same
/// frames, byte for byte, as the changed run. A change must therefore begin after the newest tick.
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

    void set_seed(std::uint64_t seed);  ///< Replaces the seed of the file.

    const Scenario& now() const;
    std::string text() const;  ///< TOML without the comments of the file.

    /// Result of a change.
    struct Change {
        std::string entry;  ///< Name of the new or ended entry, e.g. plant.sensor_fault[0].
        std::string text;
        Scenario scenario;
    };

    /// `toml` is one entry without start_s, as in control_t (firmware_sim/lcm). Its table is can_fault, plant.sensor_fault,
    /// plant.actuator_fault, plant.surroundings_fault or plant.speed_change. All three functions throw ParameterError for an entry that
    /// the scenario file cannot hold, or already holds.
    Change injected(double start_s, const std::string& toml) const;
    Change cleared(double end_s, const std::string& entry) const;
    Change ended(double duration_s) const;

    void take(const Change& change);

private:
    struct Document;  ///< The TOML document.
    std::unique_ptr<Document> document_;
    Scenario scenario_;
};

}  // namespace lpvguard_sim
