// A bus of the catalogue's messages for tests: sends good frames on their periods, and lets a test spoil them.
#pragma once

#include <bitset>
#include <cstring>

#include "catch.hpp"
#include "lpvg_can_codec.h"
#include "lpvguard/can.h"

class CanBus {
public:
    static constexpr int64_t kStart = 1'000'000;

    CanBus() {
        if (lpvg_can_init(&supervisor, lpvg_can_rules, LPVG_CAN_RECEIVED, kStart) != lpvg_status_ok) {
            throw 1;
        }
        lpvg_can_vdc2_t vdc2{};
        vdc2.steering_wheel_angle = lpvg_can_encode(&lpvg_can_vdc2_steering_wheel_angle, 0.1F);
        vdc2.yaw_rate = lpvg_can_encode(&lpvg_can_vdc2_yaw_rate, 0.05F);
        vdc2.lateral_acceleration = lpvg_can_encode(&lpvg_can_vdc2_lateral_acceleration, 0.7F);
        vdc2.longitudinal_acceleration = lpvg_can_encode(&lpvg_can_vdc2_longitudinal_acceleration, 0.0F);
        packed_ = lpvg_can_vdc2_pack(&vdc2, &vdc2_) == lpvg_status_ok;
        lpvg_can_guard_in_t in{};
        in.dp_measured = lpvg_can_encode(&lpvg_can_guard_in_dp_measured, 0.5F);
        in.yaw_rate_command = lpvg_can_encode(&lpvg_can_guard_in_yaw_rate_command, 0.05F);
        in.control_request = 1U;
        packed_ = packed_ && lpvg_can_guard_in_pack(&in, &guard_in_) == lpvg_status_ok;
    }

    // Frame number k >= 1 of each message is due at kStart + k periods.
    lpvg_can_frame_t vdc2(int64_t k) const { return at(vdc2_, kStart + k * LPVG_CAN_VDC2_PERIOD_US); }
    lpvg_can_frame_t guard_in(int64_t k) const {
        lpvg_can_frame_t frame = at(guard_in_, kStart + k * LPVG_CAN_GUARD_IN_PERIOD_US);
        auto counter = static_cast<uint8_t>(k % 15);
        return lpvg_can_e2e_protect(&frame, LPVG_CAN_GUARD_IN_E2E_DATA_ID, &counter) == lpvg_status_ok ? frame : lpvg_can_frame_t{};
    }

    // Receives a frame, and holds what became of its watch against what can.h says of every frame.
    lpvg_can_event_t send(const lpvg_can_frame_t& frame) {
        lpvg_can_supervisor_t before = supervisor;
        lpvg_can_advance(&before, frame.t_us);
        uint8_t index = 0U;
        const auto event = lpvg_can_receive(&supervisor, &frame, &index);
        if (index == LPVG_CAN_NO_INDEX) {
            return event;
        }
        const lpvg_can_watch_t &was = before.watch[index], &is = supervisor.watch[index];
        const bool bad = event != lpvg_can_event_accepted && event != lpvg_can_event_recovering;
        CHECK(is.window_bad == std::bitset<LPVG_CAN_WINDOW>(is.window).count());
        if (bad) {
            const bool switched_off = was.state != lpvg_can_state_off && is.state == lpvg_can_state_off;
            CHECK(is.window == (switched_off ? 1U : static_cast<uint16_t>(was.window << 1U) + 1U));
            CHECK(is.score == was.score + (was.score < LPVG_CAN_SCORE_OFF ? 1 : 0));
            CHECK(is.good_in_row == 0U);
        } else if (event == lpvg_can_event_accepted) {
            const bool recovered = was.state == lpvg_can_state_off;
            CHECK(is.window == (recovered ? 0U : static_cast<uint16_t>(was.window << 1U)));
            CHECK(is.score == (recovered || was.score == 0U ? 0 : was.score - 1));
        } else {
            CHECK(is.good_in_row == was.good_in_row + 1U);
        }
        return event;
    }

    // Good frames first .. last of both fast messages.
    void run(int64_t first, int64_t last) {
        for (int64_t k = first; k <= last; ++k) {
            send(vdc2(k));
            send(guard_in(k));
        }
    }

    lpvg_can_state_t state(uint8_t index) const { return lpvg_can_state(&supervisor, index); }
    lpvg_can_state_t state_at(uint8_t index, int64_t t_us) {
        lpvg_can_advance(&supervisor, t_us);
        return state(index);
    }
    uint32_t count(uint8_t index, lpvg_can_event_t event) const { return supervisor.watch[index].count[event]; }
    bool packed() const { return packed_; }

    lpvg_can_supervisor_t supervisor{};

private:
    static lpvg_can_frame_t at(lpvg_can_frame_t frame, int64_t t_us) {
        frame.t_us = t_us;
        return frame;
    }
    lpvg_can_frame_t vdc2_{};
    lpvg_can_frame_t guard_in_{};
    bool packed_ = false;
};
