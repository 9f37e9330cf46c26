/// @file vehicle_node.hpp -- the rest of the vehicle on the bus: sends its sensor values, and obeys the controller's demand.
///
/// truck_node.cpp makes the messages of the truck, own_node.cpp those of a car's own bus.
#pragma once

#include <cstdint>
#include <map>
#include <vector>

#include "bus.h"
#include "lpvguard/authentication.h"
#include "lpvguard/bus.h"
#include "lpvg_can_codec.h"
#include "lpvguard/config.h"
#include "lpvguard_plant/plant.hpp"
#include "lpvguard_plant/random.hpp"
#include "scenario.hpp"

#if __has_include("lpvg_rest.h")
#include "lpvg_rest.h"
#endif

namespace lpvguard_sim {

/// A received trouble code; spn 0: none active.
struct TroubleCode {
    std::uint32_t spn = 0;
    std::uint8_t fmi = 0;
    bool operator!=(const TroubleCode& other) const { return spn != other.spn || fmi != other.fmi; }
};

class VehicleNode {
public:
    VehicleNode(const bus_t* bus, double steering_ratio, const std::vector<CanFault>& faults, std::uint64_t seed);

    /// Continues with these faults: the previous ones, possibly with other ends, then new ones. All changes are after the newest send().
    void revise(const std::vector<CanFault>& faults);

    /// Sends the messages that are due since the tick before, with their faults. Faults act before the authentication: the node
    /// authenticates each faulty frame of GUARD_IN. On a car's own bus, `values` are those of VehicleModel.
    void send(std::int64_t now_us, const lpvguard_plant::Sensors& sensors, const double* values, double command);

    /// Receives the frames that have arrived. The demand is kept while GUARD_OUT is late. It is 0 in the supervision state off.
    void receive(std::int64_t now_us);

    const double* demand() const { return demand_; }  ///< [LPVG_NU], input unit
    const lpvg_bus_report_t& report() const { return report_; }  ///< Newest accepted report; supervision is off without one.
    const TroubleCode& trouble() const { return trouble_; }

private:
    struct Delayed {
        std::int64_t due_us;
        lpvg_can_frame_t frame;
    };

    struct Fault : CanFault {
        lpvg_can_frame_t held{};  ///< repeated, stuck_counter: the last frame before the fault; swapped: a frame that is not sent yet.
        bool holds = false;
    };

    void send_slow(std::int64_t now_us, const lpvguard_plant::Sensors& sensors);
    void send_command(std::int64_t now_us, lpvg_can_guard_in_t& command);
    void take_demand(const lpvg_can_frame_t& frame);  ///< Takes the demands of a good frame that has some.
    void put(const lpvg_can_frame_t& frame);
    void transmit(const lpvg_can_frame_t& frame);
    bool spoil(Fault& fault, lpvg_can_frame_t& frame, const lpvg_can_frame_t& before);
    bool off_the_bus(std::int64_t now_us);
    void send_beside(const lpvg_can_frame_t& frame, std::uint32_t id);
    void release_due(std::int64_t now_us);

    const bus_t* bus_;
    double steering_ratio_;
    std::vector<Fault> faults_;
    std::map<std::uint32_t, lpvg_can_frame_t> newest_;  ///< Newest frame of each message without its fault.
    lpvguard_plant::Random random_;
    std::vector<Delayed> delayed_;  ///< Delayed frames in order of sending.
    lpvg_can_supervisor_t supervisor_{};
    lpvg_can_auth_t authentication_{};
    std::uint8_t counter_ = 0;
    double demand_[LPVG_NU] = {};
#ifdef LPVG_REST_H
    std::uint16_t rest_counters_[LPVG_REST_MESSAGES] = {};
#endif
    bool bus_off_ = false;
    lpvg_bus_report_t report_{};
    TroubleCode trouble_;
};

}  // namespace lpvguard_sim
