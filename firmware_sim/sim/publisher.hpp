/// @file publisher.hpp -- telemetry for people and other programs: truth and what the controller says, every 10 ms, and what its
/// supervision counts, every 100 ms.
///
/// CAN carries only what a truck's bus carries; the truth goes this way (LCM: firmware_sim/lcm). Nothing comes back.
#pragma once

#include <cstdint>
#include <memory>
#include <string>

#include "lpvguard/can.h"
#include "lpvguard_plant/plant.hpp"
#include "vehicle_node.hpp"

namespace lpvguard_sim {

/// Units and signs as in firmware_sim/lcm/lpvguard_guard.lcm.
struct GuardTelemetry {
    double command_radps, wanted_radps, demand_bar, margin;
    std::uint8_t verdict, supervision;
};

class Publisher {
public:
    virtual ~Publisher() = default;
    virtual void publish(std::int64_t now_us, const lpvguard_plant::Truth& truth, const GuardTelemetry& guard) = 0;
    virtual void publish(std::int64_t now_us, const lpvg_can_supervisor_t& supervisor, const TroubleCode& trouble) = 0;
};

/// `url` as LCM reads it, e.g. udpm://239.255.76.67:7667?ttl=0 or file:///tmp/run.lcm?mode=w.
/// Throws lpvguard_plant::UsageError when it cannot be opened or the simulator was built without LCM.
std::unique_ptr<Publisher> open_publisher(const std::string& url);

}  // namespace lpvguard_sim
