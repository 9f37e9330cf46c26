// An ECU and the frames of a vehicle that answers the demand as the nominal model does, while a yaw rate is asked for. The bus runs on true
// time; steps come when a test says, and their clock may be off from it.
#pragma once

#include "../catch.hpp"

#include <cmath>
#include <cstring>
#include <functional>
#include <limits>
#include <vector>

#include "heap_counter.hpp"
#include "lpvg_can_codec.h"
#include "lpvguard/ecu.h"

constexpr int64_t tick_us = 10'000;

const lpvg_ecu_config_t bench_config = {true, 0U, 0U, true, {2.07F, 5.0F, 1.5F, 0.15F, 100U}, {0.14F, 0.04F, 30U, 0.32F}};

struct BenchReport {
    float demand = NAN, statistic = NAN, verdict = NAN, supervision = NAN, engagement = NAN;
};

class Bench {
public:
    explicit Bench(const lpvg_ecu_config_t& with = bench_config, const lpvg_coeff_t& coeff = lpvg_coeff,
                   const lpvg_control_coeff_t& control = lpvg_control_coeff) {
        REQUIRE(lpvg_ecu_init(&ecu, &coeff, &control, &with, 0) == lpvg_status_ok);
        const lpvg_real_t nothing[LPVG_NU + LPVG_NY] = {};
        lpvg_model_start(&vehicle_, &lpvg_coeff, nothing, nothing);
    }

    // Writes what is kept as the ECU does, its second copy included.
    void lock() {
        ecu.kept.locked = true;
        uint32_t words[sizeof ecu.inverted / sizeof(uint32_t)];
        std::memcpy(words, &ecu.kept, sizeof words);
        ecu.sum = 0U;
        for (std::size_t i = 0; i < sizeof words / sizeof words[0]; ++i) {
            ecu.inverted[i] = ~words[i];
            ecu.sum += words[i];
        }
    }

    // One step a sample period after the newest one; it must be taken. A test may spoil its frames through the members below.
    void step() {
        step_at(k * tick_us);
        REQUIRE(status == lpvg_status_ok);
        ++k;
    }

    void run(int steps) {
        for (int i = 0; i < steps; ++i) {
            step();
        }
    }

    // A step at a time of the bus, with the frames since the newest one that was taken.
    void step_at(int64_t t_us) {
        std::vector<lpvg_can_frame_t>& in = frames;
        in.insert(in.end(), late_.begin(), late_.end());
        late_.clear();
        for (; next_frame_us <= t_us; next_frame_us += tick_us) {
            send(in, next_frame_us);
        }
        if (filter) {
            in = filter(in);
        }
        handed = in;
        const size_t n_in = in.size();
        lpvg_can_frame_t behind{};  // what lies behind the frames handed over is not looked at
        behind.id = LPVG_CAN_ERROR | LPVG_CAN_BUS_OFF;
        behind.t_us = t_us + clock_off_us;
        in.push_back(behind);
        const long allocations = heap_allocations();
        lpvg_can_frame_t out[LPVG_ECU_FRAMES_OUT];
        size_t n_out = 99U;
        const lpvg_real_t before = ecu.control.u[0];
        status = lpvg_ecu_step(&ecu, t_us + clock_off_us, in.data(), n_in, out, LPVG_ECU_FRAMES_OUT, &n_out);
        CHECK(heap_allocations() == allocations);
        in.resize(n_in);
        if (status != lpvg_status_ok) {
            CHECK(n_out == 0U);
            CHECK(std::memcmp(&before, &ecu.control.u[0], sizeof before) == 0);
            return;
        }
        now_us = t_us;
        in.clear();
        take(out, n_out, t_us + clock_off_us);
    }

    // Returns the steps that it took.
    int run_until_engaged() {
        int steps = 0;
        for (; !engaged() && steps < 2000; ++steps) {
            step();
        }
        REQUIRE(engaged());
        return steps;
    }

    bool live() const { return report.supervision == static_cast<float>(lpvg_can_state_live); }
    bool engaged() const { return ecu.control.engaged; }

    lpvg_ecu_t ecu;
    std::vector<lpvg_can_frame_t> frames, handed;  // since the newest step that was taken; of the newest call
    std::function<std::vector<lpvg_can_frame_t>(const std::vector<lpvg_can_frame_t>&)> filter;  // what the ECU gets of a step's frames
    lpvg_can_vdc2_t newest_vdc2{};
    lpvg_status_t status = lpvg_status_ok;
    int64_t k = 0;
    int64_t now_us = 0, next_frame_us = 0;  // true time of the newest step, and of the next frames
    int64_t clock_off_us = 0;  // the steps' clock less true time
    float speed = 12.0F, yaw_rate = 0.0F, lateral = 0.0F, wheel_angle = 0.0F, command = 0.05F;
    float brake_gain = 1.0F, brake_lag_s = 0.14F;  // of the pressure to the demand
    float pressure = 0.0F, pedal_percent = 0.0F;
    uint8_t early_request = LPVG_BUS_REQUEST_RELEASE, request = LPVG_BUS_REQUEST_CONTROL, other_priority = 0U, abs_active = 0U;
    bool answers = true;  // the demand moves the vehicle; what follows is added to that
    float response = 1.0F;  // of the vehicle to the demand, over the nominal one
    bool send_vdc2 = true, send_guard_in = true, send_ebc2 = true, send_ebc1 = true, spoil_guard_in = false, brakes_work = true,
         second_sender = false;
    BenchReport report;
    int reports = 0, dm1s = 0;
    uint32_t spn = 0;
    uint8_t fmi = 0, lamps = 0;

private:
    struct Motion {
        float yaw_rate = 0.0F, wheel_angle = 0.0F;
    };

    // The outputs of the nominal model, which goes on by a sample period.
    Motion move() {
        lpvg_real_t y[LPVG_NY];
        lpvg_model_output(&vehicle_, &lpvg_coeff, y);
        const lpvg_real_t u[LPVG_NU] = {ecu.control.u[0] * static_cast<lpvg_real_t>(response)};
        lpvg_model_advance(&vehicle_, &lpvg_coeff, static_cast<lpvg_real_t>(speed), u);
        return {static_cast<float>(y[0]), static_cast<float>(y[1])};
    }

    void send(std::vector<lpvg_can_frame_t>& in, int64_t t_us) {
        lpvg_can_frame_t frame{};
        frame.t_us = t_us + clock_off_us;
        const Motion motion = answers ? move() : Motion{};
        lpvg_can_vdc2_t vdc2{};
        vdc2.steering_wheel_angle = lpvg_can_encode(&lpvg_can_vdc2_steering_wheel_angle, 20.0F * (wheel_angle + motion.wheel_angle));
        vdc2.yaw_rate = lpvg_can_encode(&lpvg_can_vdc2_yaw_rate, yaw_rate + motion.yaw_rate);
        vdc2.lateral_acceleration = lpvg_can_encode(&lpvg_can_vdc2_lateral_acceleration, lateral + motion.yaw_rate * speed);
        vdc2.longitudinal_acceleration = lpvg_can_encode(&lpvg_can_vdc2_longitudinal_acceleration, 0.0F);
        REQUIRE(lpvg_can_vdc2_pack(&vdc2, &frame) == lpvg_status_ok);
        newest_vdc2 = vdc2;
        if (send_vdc2) {
            in.push_back(frame);
        }
        lpvg_can_guard_in_t guard{};
        // The brakes: what was demanded a period ago, through a lag.
        pressure += brakes_work ? (brake_gain * static_cast<float>(ecu.control.u[0]) - pressure) * 0.01F / (brake_lag_s + 0.01F) : 0.0F;
        guard.dp_measured = lpvg_can_encode(&lpvg_can_guard_in_dp_measured, pressure);
        guard.control_request = t_us < 200'000 ? early_request : request;
        guard.other_priority = other_priority;
        guard.yaw_rate_command = lpvg_can_encode(&lpvg_can_guard_in_yaw_rate_command, command);
        REQUIRE(lpvg_can_guard_in_pack(&guard, &frame) == lpvg_status_ok);
        REQUIRE(lpvg_can_e2e_protect(&frame, LPVG_CAN_GUARD_IN_E2E_DATA_ID, &counter_) == lpvg_status_ok);
        frame.data[4] ^= spoil_guard_in ? 1U : 0U;
        if (send_guard_in) {
            in.push_back(frame);
        }
        if (second_sender) {  // half a period later, with the counter that the genuine sender uses next
            lpvg_can_frame_t other = frame;
            uint8_t next = counter_;
            REQUIRE(lpvg_can_e2e_protect(&other, LPVG_CAN_GUARD_IN_E2E_DATA_ID, &next) == lpvg_status_ok);
            other.t_us += tick_us / 2;
            late_.push_back(other);
        }
        if (t_us / tick_us % 10 == 0) {
            lpvg_can_ebc2_t ebc2;
            std::memset(&ebc2, 0xFF, sizeof ebc2);
            ebc2.front_axle_speed = lpvg_can_encode(&lpvg_can_ebc2_front_axle_speed, speed * 3.6F);
            REQUIRE(lpvg_can_ebc2_pack(&ebc2, &frame) == lpvg_status_ok);
            if (send_ebc2) {
                in.push_back(frame);
            }
            lpvg_can_ebc1_t ebc1{};
            ebc1.abs_active = abs_active;
            ebc1.brake_pedal_position = lpvg_can_encode(&lpvg_can_ebc1_brake_pedal_position, pedal_percent);
            REQUIRE(lpvg_can_ebc1_pack(&ebc1, &frame) == lpvg_status_ok);
            if (send_ebc1) {
                in.push_back(frame);
            }
        }
    }

    void take(const lpvg_can_frame_t* out, size_t n, int64_t clock_us) {
        REQUIRE(n >= 1U);
        for (size_t i = 0; i < n; ++i) {
            CHECK(out[i].t_us == clock_us);
            if (out[i].id != LPVG_CAN_GUARD_OUT_ID) {
                CHECK(out[i].id == (LPVG_CAN_EXTENDED | 0x18FECAFCU));
                ++dm1s;
                lamps = out[i].data[0];
                spn = out[i].data[2] + 256U * out[i].data[3] + 65536U * (out[i].data[4] >> 5U);
                fmi = out[i].data[4] & 0x1FU;
                continue;
            }
            uint8_t received = 0xFF;
            CHECK(lpvg_can_e2e_check(&out[i], LPVG_CAN_GUARD_OUT_E2E_DATA_ID, &received) == lpvg_status_ok);
            CHECK(received == reports++ % 15);
            lpvg_can_guard_out_t message{};
            REQUIRE(lpvg_can_guard_out_unpack(&message, &out[i]) == lpvg_status_ok);
            lpvg_can_decode(&lpvg_can_guard_out_dp_demand, message.dp_demand, &report.demand);
            lpvg_can_decode(&lpvg_can_guard_out_monitor_margin, message.monitor_margin, &report.statistic);
            lpvg_can_decode(&lpvg_can_guard_out_monitor_verdict, message.monitor_verdict, &report.verdict);
            lpvg_can_decode(&lpvg_can_guard_out_supervision_state, message.supervision_state, &report.supervision);
            lpvg_can_decode(&lpvg_can_guard_out_engagement, message.engagement, &report.engagement);
            CHECK(message.command_authentication == (ecu.kept.config.authenticated ? 1U : 0U));
            CHECK(report.engagement ==
                  static_cast<float>(engaged() ? lpvg_ecu_engaged : (ecu.kept.locked ? lpvg_ecu_locked : lpvg_ecu_released)));
        }
    }

    std::vector<lpvg_can_frame_t> late_;
    lpvg_model_t vehicle_{};
    uint8_t counter_ = 0;
};

constexpr int to_live = 41;  // EBC2's fifth frame is the 41st tick's
constexpr int wait_steps = LPVG_ECU_WAIT_US / tick_us;
