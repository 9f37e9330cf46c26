#include "socketcan_bus.hpp"

#include <cstring>

#include "arguments.hpp"

namespace lpvguard_sim {

SocketCanBus::SocketCanBus(const std::string& interface) {
    for (const Node node : {vehicle, ecu}) {
        Port& port = ports_[node];
        port.bus = this;
        port.peer = &ports_[node == vehicle ? ecu : vehicle];
        if (!port.can.open(interface.c_str(), nullptr, 0)) {
            throw lpvguard_plant::UsageError("--bus socketcan:" + interface + ": " + std::strerror(port.can.driver().error));
        }
        ends_[node] = bus_t{&port, &SocketCanBus::send, &SocketCanBus::receive};
    }
}

bool SocketCanBus::send(void* driver, const lpvg_can_frame_t* frame) {
    Port& from = *static_cast<Port*>(driver);
    from.bus->pass(*frame);
    if (!bus_send(from.can.end(), frame)) {
        if (!from.can.driver().bus_off) {
            from.bus->failure_ = std::string("the CAN interface took no frame: ") + std::strerror(from.can.driver().error);
        }
        return false;
    }
    ++from.peer->due;
    return true;
}

bool SocketCanBus::receive(void* driver, std::int64_t now_us, lpvg_can_frame_t* frame) {
    Port& port = *static_cast<Port*>(driver);
    if (port.due > 0) {
        port.can.expect(port.due);
        port.due = 0;
    }
    if (bus_receive(port.can.end(), now_us, frame)) {
        return true;
    }
    if (port.can.waited_in_vain()) {
        port.bus->failure_ = "a frame that was sent did not come through the CAN interface";
    }
    return false;
}

std::string socketcan_interface(const std::string& bus) {
    const std::string socketcan = "socketcan:";
    if (bus.compare(0, socketcan.size(), socketcan) != 0) {
        throw lpvguard_plant::UsageError("--bus '" + bus + "': expected memory or socketcan:INTERFACE");
    }
    return bus.substr(socketcan.size());
}

}  // namespace lpvguard_sim
