// truck_node.cpp -- messages of the truck: VDC2 and GUARD_IN every 10 ms, the others every 100 ms.
#include "vehicle_node.hpp"

#include <cmath>
#include <stdexcept>

namespace lpvguard_sim {
namespace {

constexpr std::int64_t slow_period_us = 100'000;
constexpr double kmh_per_mps = 3.6;
constexpr double kpa_per_bar = 100.0;

float single(double value) { return static_cast<float>(value); }

void require(lpvg_status_t status) {
    if (status != lpvg_status_ok) {
        throw std::logic_error("the codec refused a frame of the simulator's own");
    }
}

}  // namespace

void VehicleNode::send(std::int64_t now_us, const lpvguard_plant::Sensors& sensors, const double*, double command) {
    bus_off_ = off_the_bus(now_us);
    release_due(now_us);
    lpvg_can_frame_t frame{};
    frame.t_us = now_us;

    lpvg_can_vdc2_t vdc2{};
    vdc2.steering_wheel_angle = lpvg_can_encode(&lpvg_can_vdc2_steering_wheel_angle, single(sensors.steering_wheel_rad));
    vdc2.yaw_rate = lpvg_can_encode(&lpvg_can_vdc2_yaw_rate, single(sensors.yaw_rate_radps));
    vdc2.lateral_acceleration = lpvg_can_encode(&lpvg_can_vdc2_lateral_acceleration, single(sensors.lateral_acceleration_mps2));
    vdc2.longitudinal_acceleration = lpvg_can_encode(&lpvg_can_vdc2_longitudinal_acceleration, NAN);  // the plant has no such sensor
    require(lpvg_can_vdc2_pack(&vdc2, &frame));
    put(frame);

    lpvg_can_guard_in_t in{};
    in.dp_measured =
        lpvg_can_encode(&lpvg_can_guard_in_dp_measured, single(sensors.brake_pressure_right_bar - sensors.brake_pressure_left_bar));
    in.yaw_rate_command = lpvg_can_encode(&lpvg_can_guard_in_yaw_rate_command, single(command));
    send_command(now_us, in);

    if (now_us % slow_period_us == 0) {
        send_slow(now_us, sensors);
    }
}

// Sends the messages that are due every 100 ms.
void VehicleNode::send_slow(std::int64_t now_us, const lpvguard_plant::Sensors& sensors) {
    using lpvguard_plant::Wheel;
    lpvg_can_frame_t frame{};
    frame.t_us = now_us;
    const auto& wheel = sensors.wheel_speed_mps;
    const double front = 0.5 * (wheel[Wheel::front_left] + wheel[Wheel::front_right]);
    const auto relative = [&](Wheel which) { return single((wheel[which] - front) * kmh_per_mps); };
    lpvg_can_ebc2_t ebc2{};
    ebc2.front_axle_speed = lpvg_can_encode(&lpvg_can_ebc2_front_axle_speed, single(front * kmh_per_mps));
    ebc2.relative_speed_front_left = lpvg_can_encode(&lpvg_can_ebc2_relative_speed_front_left, relative(Wheel::front_left));
    ebc2.relative_speed_front_right = lpvg_can_encode(&lpvg_can_ebc2_relative_speed_front_right, relative(Wheel::front_right));
    ebc2.relative_speed_rear1_left = lpvg_can_encode(&lpvg_can_ebc2_relative_speed_rear1_left, relative(Wheel::rear_left));
    ebc2.relative_speed_rear1_right = lpvg_can_encode(&lpvg_can_ebc2_relative_speed_rear1_right, relative(Wheel::rear_right));
    ebc2.relative_speed_rear2_left = lpvg_can_encode(&lpvg_can_ebc2_relative_speed_rear2_left, NAN);  // two axles
    ebc2.relative_speed_rear2_right = lpvg_can_encode(&lpvg_can_ebc2_relative_speed_rear2_right, NAN);
    require(lpvg_can_ebc2_pack(&ebc2, &frame));
    put(frame);

    lpvg_can_ccvs1_t ccvs1{};
    ccvs1.wheel_based_speed = lpvg_can_encode(&lpvg_can_ccvs1_wheel_based_speed, single(sensors.speed_mps * kmh_per_mps));
    require(lpvg_can_ccvs1_pack(&ccvs1, &frame));
    put(frame);

    lpvg_can_ebc3_t ebc3{};
    ebc3.pressure_front_left = lpvg_can_encode(&lpvg_can_ebc3_pressure_front_left, single(sensors.brake_pressure_left_bar * kpa_per_bar));
    ebc3.pressure_front_right =
        lpvg_can_encode(&lpvg_can_ebc3_pressure_front_right, single(sensors.brake_pressure_right_bar * kpa_per_bar));
    ebc3.pressure_rear1_left = lpvg_can_encode(&lpvg_can_ebc3_pressure_rear1_left, 0.0F);  // only front wheels are braked
    ebc3.pressure_rear1_right = lpvg_can_encode(&lpvg_can_ebc3_pressure_rear1_right, 0.0F);
    ebc3.pressure_rear2_left = lpvg_can_encode(&lpvg_can_ebc3_pressure_rear2_left, NAN);
    ebc3.pressure_rear2_right = lpvg_can_encode(&lpvg_can_ebc3_pressure_rear2_right, NAN);
    ebc3.pressure_rear3_left = lpvg_can_encode(&lpvg_can_ebc3_pressure_rear3_left, NAN);
    ebc3.pressure_rear3_right = lpvg_can_encode(&lpvg_can_ebc3_pressure_rear3_right, NAN);
    require(lpvg_can_ebc3_pack(&ebc3, &frame));
    put(frame);

    lpvg_can_ebc1_t ebc1{};
    ebc1.abs_active = lpvg_can_encode(&lpvg_can_ebc1_abs_active, 0.0F);
    ebc1.brake_pedal_position = lpvg_can_encode(&lpvg_can_ebc1_brake_pedal_position, 0.0F);
    require(lpvg_can_ebc1_pack(&ebc1, &frame));
    put(frame);
}

void VehicleNode::take_demand(const lpvg_can_frame_t& frame) {
    lpvg_can_guard_out_t out{};
    float demand_bar = 0.0F;
    constexpr std::uint32_t any_priority = ~0x1C000000U;
    if (((frame.id ^ LPVG_CAN_GUARD_OUT_ID) & any_priority) == 0U && lpvg_can_guard_out_unpack(&out, &frame) == lpvg_status_ok) {
        static_cast<void>(lpvg_can_decode(&lpvg_can_guard_out_dp_demand, out.dp_demand, &demand_bar));
        demand_[0] = static_cast<double>(demand_bar);
    }
}

}  // namespace lpvguard_sim
