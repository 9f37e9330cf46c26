/// @file socketcan_bus.hpp -- the two nodes on a real SocketCAN interface, in lock-step with simulated time.
///
/// A receiving node waits until all frames of the other node have passed the kernel. A run therefore gives the same frames as
/// on the memory bus, at every speed of the machine. Other programs may listen (candump). Frames of a foreign sender reach
/// both nodes and disturb the count. Such a run is not repeatable.
#pragma once

#include <array>
#include <cstdint>
#include <string>

#include "counted_bus.hpp"
#include "loop_bus.hpp"

namespace lpvguard_sim {

class SocketCanBus final : public LoopBus {
public:
    /// Throws lpvguard_plant::UsageError when the interface cannot be opened.
    explicit SocketCanBus(const std::string& interface);

private:
    struct Port {
        SocketCanBus* bus = nullptr;
        Port* peer = nullptr;
        CountedBus can;
        std::uint64_t due = 0;  ///< Number of frames sent to this node since it last received.
    };

    static bool send(void* driver, const lpvg_can_frame_t* frame);
    static bool receive(void* driver, std::int64_t now_us, lpvg_can_frame_t* frame);

    std::array<Port, 2> ports_;
};

}  // namespace lpvguard_sim
