/// @file control.hpp -- commands of clients to a running simulation (control_t, status_t: firmware_sim/lcm).
///
/// Commands are processed between two ticks. Pausing and stepping change no simulated time. Changes by INJECT and CLEAR act from the
/// next tick on, whose sensors have not been sampled yet. They change the scenario file (live_scenario.hpp). A run of the changed file
/// from the start gives the same frames.
#pragma once

#include <cstdint>
#include <functional>

#include "live_scenario.hpp"
#include "publisher.hpp"

namespace lpvguard_sim {

class Control {
public:
    static const std::int64_t tick_us;  ///< Sample period of the vehicle.

    Control(Publisher& publisher, LiveScenario& scenario, bool paused)
        : publisher_(publisher), scenario_(scenario), left_(paused ? 0 : without_end) {}

    /// Continues with a changed scenario. If this is impossible, throws lpvguard_plant::ParameterError and changes nothing.
    using Revise = std::function<void(const Scenario&)>;

    /// Call before the tick of now_us. Processes commands, and waits while paused. Returns false if a client has sent stop.
    bool may_tick(std::int64_t now_us, const Revise& revise);

    void ended(std::int64_t now_us) { publisher_.publish(Status{now_us, Status::ended}); }

private:
    static constexpr std::int64_t without_end = -1;
    static constexpr std::int64_t report_us = 1'000'000;
    static constexpr int report_paused_ms = 200;

    Status::State state() const { return stopped_ ? Status::ended : left_ == 0 ? Status::paused : Status::running; }
    Status answer(std::int64_t now_us, const ControlCommand& command, const Revise& revise);
    void change(LiveScenario::Change change, const Revise& revise, Status& answer);

    Publisher& publisher_;
    LiveScenario& scenario_;
    std::int64_t left_;  ///< Number of ticks until the next pause.
    bool stopped_ = false;
};

}  // namespace lpvguard_sim
