/// @file publisher.hpp -- interface of the simulation to people and other programs: telemetry out, commands in.
///
/// The message types in firmware_sim/lcm state units, signs and channels. CAN carries only the signals of a truck's bus. This
/// interface carries everything else.
#pragma once

#include <cstdint>
#include <memory>
#include <string>
#include <vector>

#include "lpvguard_plant/plant.hpp"
#include "telemetry.hpp"
#include "vehicle_node.hpp"

namespace lpvguard_sim {

/// Content of guard_t.
struct GuardTelemetry {
    double command_radps, wanted_radps, demand_bar, statistic;
    std::uint8_t verdict, supervision;
};

/// Content of margin_t: a frame that the monitor judged in this tick.
struct JudgedFrame {
    std::int64_t now_us;
    Judged judged;
    std::int64_t begin_us;
    double frequency_radps;
    std::uint8_t verdict;
};

/// Content of control_t.
struct ControlCommand {
    enum Action : std::int8_t {
        pause,
        resume,
        step,
        stop,
        inject,
        clear
    };
    std::int64_t id;
    std::int8_t action;           ///< Received value; it can be none of the above.
    std::int32_t ticks;
    std::string entry;
};

/// Content of status_t.
struct Status {
    enum State : std::int8_t {
        running,
        paused,
        ended
    };
    std::int64_t now_us;
    State state;
    std::int64_t id = 0;
    bool accepted = false;
    std::string entry = {}, reason = {};
};

class Publisher {
public:
    virtual ~Publisher() = default;
    virtual void publish(std::int64_t now_us, const lpvguard_plant::Truth& truth) = 0;
    virtual void publish(std::int64_t now_us, const GuardTelemetry& guard) = 0;
    virtual void publish(std::int64_t now_us, const Supervision& supervision, const TroubleCode& trouble) = 0;
    virtual void publish(const lpvg_can_frame_t& frame) = 0;  ///< Frames of the bus, in the order of sending.
    virtual void publish(const JudgedFrame& frame) = 0;
    virtual void publish(std::int64_t now_us, const Found& found) = 0;  ///< Cause in one output, in the tick that found it.
    virtual void publish(const Status& status) = 0;

    /// Returns the new commands of clients, in order of arrival. Waits at most `wait_ms` for the first one. Throws std::runtime_error.
    virtual std::vector<ControlCommand> take(int wait_ms) = 0;
};

/// `url` is a URL of LCM, e.g. udpm://239.255.76.67:7667?ttl=0 or file:///tmp/run.lcm?mode=w (a file gives no commands).
/// Throws lpvguard_plant::UsageError if the URL cannot be opened, or if the simulator was built without LCM.
std::unique_ptr<Publisher> open_publisher(const std::string& url);

}  // namespace lpvguard_sim
