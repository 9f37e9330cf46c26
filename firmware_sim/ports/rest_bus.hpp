/// @file rest_bus.hpp -- frames of a car on its own bus from its sensors' values, for simulations; by the generated lpvg_rest.c.
#pragma once

#include <algorithm>
#include <cstdint>
#include <cstring>

#include "lpvg_rest.h"

/// Period of a message of the car; 0: another message.
inline std::int64_t rest_period_us(std::uint32_t id) {
    const auto* const end = lpvg_rest_messages + LPVG_REST_NAMES;
    const auto* const found = std::find_if(lpvg_rest_messages, end, [id](const lpvg_rest_message_t& m) { return m.id == id; });
    return found == end ? 0 : found->period_us;
}

/// Calls put(frame) for every message that is due after now_us - period_us, up to now_us. `values` [LPVG_REST_INPUTS] are finite.
/// Periods on the bus are whole milliseconds. `counters` [LPVG_REST_MESSAGES] are 0 before first use.
template <class Put>
void each_rest_frame(const double* values, std::int64_t now_us, std::int64_t period_us, std::uint16_t* counters, Put put) {
    constexpr std::int64_t ms_us = 1000;
    float measured[LPVG_REST_INPUTS];
    std::transform(values, values + LPVG_REST_INPUTS, measured, [](double value) { return static_cast<float>(value); });
    for (std::int64_t t_us = std::max<std::int64_t>(0, now_us - period_us + ms_us); t_us <= now_us; t_us += ms_us) {
        for (std::size_t i = 0; i < LPVG_REST_MESSAGES; ++i) {
            lpvg_rest_frame_t packed[LPVG_REST_MESSAGES] = {};
            std::uint16_t next[LPVG_REST_MESSAGES];
            std::copy(counters, counters + LPVG_REST_MESSAGES, next);
            if (t_us % lpvg_rest_messages[i].period_us == 0 && lpvg_rest_pack(measured, next, packed) == lpvg_status_ok) {
                counters[i] = next[i];
                lpvg_can_frame_t frame{};
                frame.id = packed[i].id;
                frame.dlc = packed[i].length;
                frame.t_us = t_us;
                std::memcpy(frame.data, packed[i].data, packed[i].length);
                put(frame);
            }
        }
    }
}
