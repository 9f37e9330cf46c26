// uds_bytes.hpp -- bytes that all answers to a tester have in common (ISO 14229-1): services, refusals and their reasons.
#pragma once

#include <cstddef>
#include <cstdint>

namespace lpvguard {

constexpr uint8_t uds_read_data = 0x22U, uds_positive = 0x40U, uds_negative = 0x7FU;
constexpr uint8_t uds_no_service = 0x11U, uds_bad_length = 0x13U, uds_out_of_range = 0x31U;
constexpr std::size_t uds_refusal_bytes = 3U;

// Writes the refusal of a request for a service; returns its size.
inline std::size_t uds_refused(uint8_t* answer, uint8_t service, uint8_t reason) {
    answer[0] = uds_negative;
    answer[1] = service;
    answer[2] = reason;
    return uds_refusal_bytes;
}

}  // namespace lpvguard
