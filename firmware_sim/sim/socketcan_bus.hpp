/// @file socketcan_bus.hpp -- the two nodes on a real SocketCAN interface, in lock-step by simulated time.
///
/// A node that receives waits until everything the other one has sent has come through the kernel. So a run gives the same
/// frames as on the memory bus, whatever the machine's speed. Others may listen (candump). A foreign sender's frames reach
/// both nodes and break the count; such a run cannot be repeated exactly.
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
        std::uint64_t due = 0;  ///< Sent to this node since it last received.
    };

    static bool send(void* driver, const lpvg_can_frame_t* frame);
    static bool receive(void* driver, std::int64_t now_us, lpvg_can_frame_t* frame);

    std::array<Port, 2> ports_;
};

}  // namespace lpvguard_sim
