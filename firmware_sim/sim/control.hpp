/// @file control.hpp -- what clients may do to a running simulation (control_t, status_t: firmware_sim/lcm).
///
/// Commands are taken between two ticks. Pausing and stepping change no simulated time. What INJECT and CLEAR change acts from the
/// next tick on, whose sensors have not been sampled yet. It is a change of the scenario's file (live_scenario.hpp). Run from the
/// start, that file gives the same run.
#pragma once

#include <cstdint>
#include <functional>

#include "live_scenario.hpp"
#include "publisher.hpp"

namespace lpvguard_sim {

class Control {
public:
    static constexpr std::int64_t tick_us = 10'000;

    Control(Publisher& publisher, LiveScenario& scenario, bool paused)
        : publisher_(publisher), scenario_(scenario), left_(paused ? 0 : without_end) {}

    /// Goes on with a changed scenario; throws lpvguard_plant::ParameterError, with nothing changed, where it cannot.
    using Revise = std::function<void(const Scenario&)>;

    /// Before the tick of now_us: takes commands, and waits while paused. False: a client has said stop.
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
    std::int64_t left_;  ///< Ticks to go until it is paused.
    bool stopped_ = false;
};

}  // namespace lpvguard_sim
