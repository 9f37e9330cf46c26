// freeze_bytes.hpp -- codes and freeze frames of j1939.h as bytes, for what reads them: J1939 and UDS.
#pragma once

#include <cstddef>
#include <cstdint>
#include <cstring>

#include "lpvguard/j1939.h"

namespace lpvguard {

constexpr std::size_t held_bytes = 12U, code_bytes = 4U;

inline bool remembered(const lpvg_j1939_entry_t& entry) { return entry.occurrence > 0U; }

// The low byte first; returns where the next ones go.
inline uint8_t* put(uint8_t* at, uint64_t value, std::size_t bytes) {
    for (std::size_t i = 0U; i < bytes; ++i) {
        at[i] = static_cast<uint8_t>(value >> (8U * i));
    }
    return at + bytes;
}

inline uint8_t* put_code(uint8_t* at, const lpvg_j1939_entry_t& entry) {
    const lpvg_can_dtc_t code{entry.spn, entry.fmi, entry.occurrence};
    lpvg_can_frame_t frame{};
    (void)!lpvg_can_dm1_pack(&frame, 0U, 0U, &code);  // findings and counts are within their ranges
    std::memcpy(at, &frame.data[2], code_bytes);
    return at + code_bytes;
}

// As J1939 holds numbers: up to 0xFAFF, and 0xFFFF says "not available".
inline uint32_t scaled(float value, float per_bit) {
    const float raw = value / per_bit;
    if (raw != raw) {
        return 0xFFFFU;
    }
    return raw < 64255.0F ? static_cast<uint32_t>(raw > 0.0F ? raw + 0.5F : 0.0F) : 0xFAFFU;
}

// Up to 0xFAFFFFFF, in two steps of 32 bits: small processors divide no more at once.
inline uint32_t milliseconds(int64_t t_us) {
    constexpr int64_t last_us = 0xFAFFFFFFLL * 1000;
    const auto us = static_cast<uint64_t>(t_us < last_us ? t_us : last_us);
    const auto high = static_cast<uint32_t>(us >> 16U), low = static_cast<uint32_t>(us & 0xFFFFU);
    return ((high / 1000U) << 16U) + (((high % 1000U) << 16U) + low) / 1000U;
}

inline uint8_t* put_held(uint8_t* at, const lpvg_j1939_entry_t& entry) {
    const lpvg_j1939_freeze_t& freeze = entry.freeze;
    at = put(at, scaled(freeze.speed, 1.0F / (256.0F * 3.6F)), 2U);
    at = put(at, freeze.bin, 1U);
    at = put(at, scaled(freeze.statistic, 1.0F / 1024.0F), 2U);
    at = put(at, freeze.causes, 2U);
    at = put(at, milliseconds(freeze.t_us), 4U);
    return put(at, entry.run, 1U);
}

// Newest remembered activation before number `before`; nullptr where there is none.
inline const lpvg_j1939_entry_t* newest(const lpvg_j1939_memory_t& memory, uint32_t before) {
    const lpvg_j1939_entry_t* found = nullptr;
    for (const lpvg_j1939_entry_t& entry : memory.entry) {
        const bool newer = found == nullptr || entry.freeze.sequence > found->freeze.sequence;
        found = remembered(entry) && entry.freeze.sequence < before && newer ? &entry : found;
    }
    return found;
}

}  // namespace lpvguard
