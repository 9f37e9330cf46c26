#include "memory_bus.hpp"

namespace lpvguard_sim {

MemoryBus::MemoryBus() {
    for (const Node node : {vehicle, ecu}) {
        ports_[node].bus = this;
        ports_[node].peer = &ports_[node == vehicle ? ecu : vehicle];
        ends_[node] = bus_t{&ports_[node], &MemoryBus::send, &MemoryBus::receive};
    }
}

bool MemoryBus::send(void* driver, const lpvg_can_frame_t* frame) {
    Port& from = *static_cast<Port*>(driver);
    Port& to = *from.peer;
    if (to.tail - to.head == capacity) {
        from.bus->failure_ = "a node's queue is full";
        return false;
    }
    from.bus->pass(*frame);
    to.queue[to.tail++ % capacity] = *frame;
    return true;
}

bool MemoryBus::receive(void* driver, std::int64_t now_us, lpvg_can_frame_t* frame) {
    Port& port = *static_cast<Port*>(driver);
    if (port.head == port.tail || port.queue[port.head % capacity].t_us > now_us) {
        return false;
    }
    *frame = port.queue[port.head++ % capacity];
    return true;
}

}  // namespace lpvguard_sim
