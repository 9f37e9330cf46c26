/// @file loop_bus.hpp -- the bus between the two nodes of the loop, for the simulator: two ends and a watcher.
#pragma once

#include <array>
#include <cstddef>
#include <string>

#include "bus.h"

namespace lpvguard_sim {

class LoopBus {
public:
    enum Node : std::size_t {
        vehicle,
        ecu
    };

    /// Called for every frame that a node sends, before it arrives.
    using Watcher = void (*)(void* context, const lpvg_can_frame_t& frame);

    LoopBus() = default;
    LoopBus(const LoopBus&) = delete;
    LoopBus& operator=(const LoopBus&) = delete;
    virtual ~LoopBus() = default;

    const bus_t* end(Node node) const { return &ends_[node]; }

    void watch(Watcher watcher, void* context) {
        watcher_ = watcher;
        context_ = context;
    }

    /// Reason why the bus no longer carries every frame; empty without a failure. C calls the drivers, so they do not throw.
    const std::string& failure() const { return failure_; }

protected:
    void pass(const lpvg_can_frame_t& frame) const {
        if (watcher_ != nullptr) {
            watcher_(context_, frame);
        }
    }

    std::array<bus_t, 2> ends_{};
    std::string failure_;

private:
    Watcher watcher_ = nullptr;
    void* context_ = nullptr;
};

/// Returns the word after "socketcan:". Throws lpvguard_plant::UsageError for any other name of a bus.
std::string socketcan_interface(const std::string& bus);

}  // namespace lpvguard_sim
