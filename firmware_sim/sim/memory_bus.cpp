#include "memory_bus.hpp"

namespace lpvguard_sim {

MemoryBus::MemoryBus() : handles_{} {
    for (const Node node : {vehicle, ecu}) {
        ports_[node].bus = this;
        ports_[node].peer = &ports_[node == vehicle ? ecu : vehicle];
        handles_[node] = bus_t{&ports_[node], &MemoryBus::send, &MemoryBus::receive};
    }
}

bool MemoryBus::send(void* driver, const lpvg_can_frame_t* frame) {
    Port& from = *static_cast<Port*>(driver);
    Port& to = *from.peer;
    if (to.tail - to.head == capacity) {
        return false;
    }
    to.queue[to.tail++ % capacity] = *frame;
    if (from.bus->watcher_ != nullptr) {
        from.bus->watcher_(from.bus->context_, *frame);
    }
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
