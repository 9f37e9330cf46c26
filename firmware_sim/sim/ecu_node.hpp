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

    /// One sample period: takes what was sent to it, and has sent its answer when it returns. `supervision`: what it has
    /// counted is to be known then. Throws std::runtime_error.
    virtual void tick(std::int64_t now_us, bool supervision) = 0;
    const Judged* judged() const { return has_judged_ ? &judged_ : nullptr; }  ///< The frame that the newest tick judged, or null.
    /// What each output's cause is, where the newest tick found causes, or null.
    const Found (*found() const)[LPVG_NY] { return has_found_ ? &found_ : nullptr; }
    const Supervision& supervision() const { return supervision_; }            ///< After the newest tick that was asked for it.

    /// Its state, where it runs in this process; else null.
    virtual const lpvg_ecu_t* inside() const = 0;

    /// Ends it. What its supervision counted, as JSON (reception.hpp).
    virtual std::string finish() = 0;

protected:
    bool has_judged_ = false;
    Judged judged_{};
    bool has_found_ = false;
    Found found_[LPVG_NY]{};
    Supervision supervision_{};
};

struct Nodes {
    std::unique_ptr<LoopBus> bus;
    std::unique_ptr<EcuNode> ecu;
};

struct EcuOptions {
    bool engage = true;
    bool report_only = false;  ///< What the configuration may only report does not release.
};

/// `bus`: memory or socketcan:INTERFACE. `program`: empty, or the executable lpvguard_ecu, for a process of its own (SocketCAN).
/// Throws lpvguard_plant::UsageError for anything else, what cannot be opened, and coefficients that the core refuses.
Nodes open_nodes(const std::string& bus, const std::string& program, const EcuOptions& options);

}  // namespace lpvguard_sim
