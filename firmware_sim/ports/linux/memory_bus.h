/// @file memory_bus.h -- a CAN bus in memory: what one node sends, every other node receives, in the order of sending.
///
/// Frames keep the t_us that the sender gave them (simulated time), so a simulation is repeatable to the bit. A node that
/// does not receive in time loses the oldest frames; `overrun` counts them. Any node may send an error report.
#ifndef LPVGUARD_MEMORY_BUS_H
#define LPVGUARD_MEMORY_BUS_H

#include "../../ecu/bus.h"

namespace lpvguard {

/// The wire: the newest kDepth frames. Outlives its nodes.
struct MemoryWire {
    static constexpr uint64_t kDepth = 1024;
    struct Slot {
        lpvg_can_frame_t frame;
        const void*      sender;
    };
    Slot     slots[kDepth] = {};
    uint64_t sent          = 0;  ///< Frames ever sent; number n lies in slot n % kDepth
};

/// One node on a wire.
struct MemoryBus {
    explicit MemoryBus(MemoryWire& wire);
    MemoryBus(const MemoryBus&)            = delete;
    MemoryBus& operator=(const MemoryBus&) = delete;

    lpvg_bus_t bus;  ///< Give &bus to the firmware.
    MemoryWire* wire;
    const lpvg_bus_filter_t* filters = nullptr;
    size_t   n_filters = 0;
    uint64_t next      = 0;  ///< Number of the next frame to look at
    uint64_t overrun   = 0;  ///< Frames lost because they were not received in time
    bool     is_open   = false;
};

}  // namespace lpvguard

#endif
