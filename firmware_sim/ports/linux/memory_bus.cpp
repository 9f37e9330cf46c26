#include "memory_bus.h"

#include <algorithm>
#include <type_traits>

namespace lpvguard {
namespace {

// `bus` is the first member of a standard-layout struct, so the two addresses are one.
static_assert(std::is_standard_layout_v<MemoryBus>);
MemoryBus& node_of(lpvg_bus_t* bus) { return *reinterpret_cast<MemoryBus*>(bus); }

bool passes(const MemoryBus& node, uint32_t id) {
    return node.n_filters == 0 || (id & LPVG_CAN_ERROR) != 0U ||
           std::any_of(node.filters, node.filters + node.n_filters,
                       [id](const lpvg_bus_filter_t& f) { return ((id ^ f.id) & f.mask) == 0U; });
}

lpvg_bus_result_t open(lpvg_bus_t* bus, const lpvg_bus_filter_t* filters, size_t n_filters) {
    MemoryBus& node = node_of(bus);
    node.filters    = filters;
    node.n_filters  = n_filters;
    node.next       = node.wire->sent;
    node.is_open    = true;
    return lpvg_bus_ok;
}

lpvg_bus_result_t send(lpvg_bus_t* bus, const lpvg_can_frame_t* frame) {
    MemoryBus& node = node_of(bus);
    if (!node.is_open || frame->dlc > sizeof frame->data) {
        return lpvg_bus_fault;
    }
    node.wire->slots[node.wire->sent % MemoryWire::kDepth] = {*frame, bus};
    ++node.wire->sent;
    return lpvg_bus_ok;
}

lpvg_bus_result_t receive(lpvg_bus_t* bus, lpvg_can_frame_t* frame) {
    MemoryBus& node = node_of(bus);
    if (!node.is_open) {
        return lpvg_bus_fault;
    }
    if (node.wire->sent - node.next > MemoryWire::kDepth) {
        node.overrun += node.wire->sent - node.next - MemoryWire::kDepth;
        node.next = node.wire->sent - MemoryWire::kDepth;
    }
    while (node.next != node.wire->sent) {
        const MemoryWire::Slot& slot = node.wire->slots[node.next % MemoryWire::kDepth];
        ++node.next;
        if (slot.sender != bus && passes(node, slot.frame.id)) {
            *frame = slot.frame;
            return lpvg_bus_ok;
        }
    }
    return lpvg_bus_empty;
}

}  // namespace

MemoryBus::MemoryBus(MemoryWire& on) : bus{open, send, receive}, wire(&on) {}

}  // namespace lpvguard
