/// @file ecu_node.hpp -- the guarded controller's end of the loop: the firmware in this process, or in one of its own.
#pragma once

#include <cstdint>
#include <memory>
#include <string>

#include "loop_bus.hpp"
#include "lpvguard/ecu.h"
#include "telemetry.hpp"

namespace lpvguard_sim {

class EcuNode {
public:
    virtual ~EcuNode() = default;

    /// One sample period: takes what was sent to it, and has sent its answer when it returns. `wanted`: what is to be known of it
    /// then, sum of TIME_LINE_JUDGED and TIME_LINE_SUPERVISION (time_line.h). Throws std::runtime_error.
    virtual void tick(std::int64_t now_us, std::uint64_t wanted) = 0;
    const Judged& judged() const { return judged_; }                 ///< After the newest tick that it was wanted of.
    const Supervision& supervision() const { return supervision_; }  ///< Likewise.

    /// Its state, where it runs in this process; else null.
    virtual const lpvg_ecu_t* inside() const = 0;

    /// Ends it. What its supervision counted, as JSON (reception.h).
    virtual std::string finish() = 0;

protected:
    Judged judged_{};
    Supervision supervision_{};
};

struct Nodes {
    std::unique_ptr<LoopBus> bus;
    std::unique_ptr<EcuNode> ecu;
};

/// `bus`: memory or socketcan:INTERFACE. `program`: empty, or the executable lpvguard_ecu, for a process of its own (SocketCAN).
/// Throws lpvguard_plant::UsageError for anything else, what cannot be opened, and coefficients that the core refuses.
Nodes open_nodes(const std::string& bus, const std::string& program, bool engage);

}  // namespace lpvguard_sim
