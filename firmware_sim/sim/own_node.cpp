// own_node.cpp -- messages of a car on its own bus.
#include <algorithm>
#include <iterator>
#include <stdexcept>

#include "lpvguard/coeff.h"
#include "rest_bus.hpp"
#include "vehicle_node.hpp"

namespace lpvguard_sim {

void VehicleNode::send(std::int64_t now_us, const lpvguard_plant::Sensors&, const double* values, double command) {
    if (values == nullptr) {
        throw std::runtime_error("--plant: missing, expected an FMU of the vehicle, which is on its own bus");
    }
    bus_off_ = off_the_bus(now_us);
    release_due(now_us);
    each_rest_frame(values, now_us, lpvg_coeff.words.sample_period_us, rest_counters_, [&](const lpvg_can_frame_t& frame) { put(frame); });
    lpvg_can_guard_in_t in{};
    in.reference = lpvg_can_encode(&lpvg_can_guard_in_reference, static_cast<float>(command));
    send_command(now_us, in);
}

void VehicleNode::take_demand(const lpvg_can_frame_t& frame) {
    float u[LPVG_NU];
    std::transform(std::begin(demand_), std::end(demand_), u, [](double value) { return static_cast<float>(value); });
    if (lpvg_rest_take(&frame, u) == lpvg_status_ok) {
        std::copy(std::begin(u), std::end(u), demand_);
    }
}

}  // namespace lpvguard_sim
