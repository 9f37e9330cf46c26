#include "socketcan_bus.hpp"

#include <cerrno>
#include <cstring>

#include "arguments.hpp"

namespace lpvguard_sim {
namespace {

constexpr int patience_ms = 1000;  // a kernel that keeps a frame longer has lost it

}  // namespace

SocketCanBus::SocketCanBus(const std::string& interface) {
    for (const Node node : {vehicle, ecu}) {
        Port& port = ports_[node];
        port.bus = this;
        port.peer = &ports_[node == vehicle ? ecu : vehicle];
        // Simulated time: the kernel's clock knows nothing of it.
        if (!socketcan_open(&port.socket, interface.c_str(), nullptr, 0, socketcan_time_now, &port.raw)) {
            const std::string reason = std::strerror(port.socket.error);
            if (node == ecu) {
                socketcan_close(&ports_[vehicle].socket);
            }
            throw lpvguard_plant::UsageError("--bus socketcan:" + interface + ": " + reason);
        }
        ends_[node] = bus_t{&port, &SocketCanBus::send, &SocketCanBus::receive};
    }
}

SocketCanBus::~SocketCanBus() {
    for (Port& port : ports_) {
        socketcan_close(&port.socket);
    }
}

bool SocketCanBus::send(void* driver, const lpvg_can_frame_t* frame) {
    Port& from = *static_cast<Port*>(driver);
    from.bus->pass(*frame);
    if (from.socket.bus_off) {
        return false;  // as from a real controller; the vehicle's node ends it
    }
    if (!bus_send(&from.raw, frame)) {
        from.bus->failure_ = std::string("the CAN interface took no frame: ") + std::strerror(errno);
        return false;
    }
    ++from.sent;
    return true;
}

bool SocketCanBus::receive(void* driver, std::int64_t now_us, lpvg_can_frame_t* frame) {
    Port& port = *static_cast<Port*>(driver);
    if (port.received == port.peer->sent) {
        return false;
    }
    if (!socketcan_wait(&port.socket, patience_ms) || !bus_receive(&port.raw, now_us, frame)) {
        port.bus->failure_ = "a frame that was sent did not come through the CAN interface";
        return false;
    }
    ++port.received;
    return true;
}

std::string socketcan_interface(const std::string& bus) {
    const std::string socketcan = "socketcan:";
    if (bus.compare(0, socketcan.size(), socketcan) != 0) {
        throw lpvguard_plant::UsageError("--bus '" + bus + "': expected memory or socketcan:INTERFACE");
    }
    return bus.substr(socketcan.size());
}

}  // namespace lpvguard_sim
