/// @file memory_bus.hpp -- a CAN bus of two nodes in memory: what one sends, the other receives, in order, at once.
///
/// Deterministic: nothing depends on the host's clock, scheduler or kernel. Everything sent can be watched.
#pragma once

#include <array>
#include <cstddef>
#include <cstdint>

#include "bus.h"

namespace lpvguard_sim {

class MemoryBus {
public:
    enum Node : std::size_t { vehicle, ecu };

    MemoryBus();
    MemoryBus(const MemoryBus&) = delete;
    MemoryBus& operator=(const MemoryBus&) = delete;

    const bus_t* open(Node node) const { return &handles_[node]; }

    /// Called for every frame as it passes the bus; none by default.
    using Watcher = void (*)(void* context, const lpvg_can_frame_t& frame);
    void watch(Watcher watcher, void* context) {
        watcher_ = watcher;
        context_ = context;
    }

private:
    static constexpr std::size_t capacity = 64;  ///< Frames that wait for one node; a power of two.

    struct Port {
        MemoryBus* bus = nullptr;
        Port* peer = nullptr;
        std::array<lpvg_can_frame_t, capacity> queue{};
        std::size_t head = 0, tail = 0;  ///< Counted up without end; the index is the remainder.
    };

    static bool send(void* driver, const lpvg_can_frame_t* frame);
    static bool receive(void* driver, std::int64_t now_us, lpvg_can_frame_t* frame);

    std::array<Port, 2> ports_;
    std::array<bus_t, 2> handles_;
    Watcher watcher_ = nullptr;
    void* context_ = nullptr;
};

}  // namespace lpvguard_sim
