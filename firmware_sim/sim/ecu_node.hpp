/// @file ecu_node.hpp -- the guarded controller's end of the loop: the firmware in this process or in a separate process.
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

    /// Runs one sample period: receives the waiting frames, and sends its frames before it returns. With `supervision`, the
    /// counters are updated. Throws std::runtime_error.
    virtual void tick(std::int64_t now_us, bool supervision) = 0;
    const Judged* judged() const { return has_judged_ ? &judged_ : nullptr; }  ///< The frame that the newest tick judged, or null.
    /// The cause in each output if the newest tick found causes, otherwise null.
    const Found (*found() const)[LPVG_NY] { return has_found_ ? &found_ : nullptr; }
    const Supervision& supervision() const { return supervision_; }            ///< Counters after the newest tick with `supervision`.

    /// State of the firmware if it runs in this process, otherwise null.
    virtual const lpvg_ecu_t* inside() const = 0;

    /// Ends the firmware. Returns the counters of its supervision as JSON (reception.hpp).
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
    bool report_only = false;  ///< Causes that the configuration may only report (LPVG_ECU_CAUSES_OPTIONAL) do not release.
};

/// `bus` is memory or socketcan:INTERFACE. `program` is empty, or the executable lpvguard_ecu for a separate process (SocketCAN).
/// Throws lpvguard_plant::UsageError for another bus, for a bus that cannot be opened, and for coefficients that the core refuses.
Nodes open_nodes(const std::string& bus, const std::string& program, const EcuOptions& options);

}  // namespace lpvguard_sim
