/// @file memory_bus.hpp -- a CAN bus of two nodes in memory: each node receives the other's frames at once and in order.
///
/// Deterministic: nothing depends on the host's clock, scheduler or kernel.
#pragma once

#include <array>
#include <cstdint>

#include "loop_bus.hpp"

namespace lpvguard_sim {

class MemoryBus final : public LoopBus {
public:
    MemoryBus();

private:
    static constexpr std::size_t capacity = 64;  ///< Largest number of frames that wait for one node; a power of two.

    struct Port {
        MemoryBus* bus = nullptr;
        Port* peer = nullptr;
        std::array<lpvg_can_frame_t, capacity> queue{};
        std::size_t head = 0, tail = 0;  ///< These only count up; the index is the remainder.
    };

    static bool send(void* driver, const lpvg_can_frame_t* frame);
    static bool receive(void* driver, std::int64_t now_us, lpvg_can_frame_t* frame);

    std::array<Port, 2> ports_;
};

}  // namespace lpvguard_sim
