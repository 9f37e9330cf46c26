// results.hpp -- what a monitor and its diagnosis have found, by the value references of variables.py.
#pragma once

#include <cstdint>
#include <cstring>
#include <vector>

#include "lpvguard/diagnosis.h"

namespace lpvguard_fmu {

#ifdef LPVG_FMU_DIAGNOSIS
inline const lpvg_found_t* cause_of(const lpvg_diagnosis_t& diagnosis) { return lpvg_diagnosis_named(&diagnosis); }
#else
inline const lpvg_found_t* cause_of(const lpvg_diagnosis_t&) { return nullptr; }
#endif

// Whether there is such a number; it goes to `value`.
inline bool get_result(const lpvg_monitor_t& monitor, const lpvg_diagnosis_t& diagnosis, unsigned reference, double& value) {
    const lpvg_frame_t& frame = monitor.frame;
    const lpvg_coeff_reals_t& reals = lpvg_coeff.reals;
    const lpvg_found_t* found = cause_of(diagnosis);
    const lpvg_found_t none{};
    const lpvg_found_t& cause = found == nullptr ? none : *found;
    const double numbers[] = {frame.margin, frame.statistic, frame.evidence,  monitor.energy.ratio,   monitor.change.ratio,  cause.value,
                              cause.low,    cause.high,      reals.threshold, reals.energy_threshold, reals.change_threshold};
    constexpr unsigned first = 100;
    if (reference < first || reference >= first + sizeof numbers / sizeof *numbers) {
        return false;
    }
    value = numbers[reference - first];
    return true;
}

inline bool get_result(const lpvg_monitor_t& monitor, const lpvg_diagnosis_t& diagnosis, int64_t t_us, unsigned reference, int64_t& value) {
    const lpvg_found_t* found = cause_of(diagnosis);
    const int64_t numbers[] = {lpvg_monitor_verdict(&monitor, t_us),
                               lpvg_monitor_reason(&monitor),
                               found == nullptr ? lpvg_cause_unknown : found->cause,
                               monitor.frame.sequence,
                               monitor.frame.bin,
                               found == nullptr ? 0 : found - diagnosis.found};
    constexpr unsigned first = 200;
    if (reference < first || reference >= first + sizeof numbers / sizeof *numbers) {
        return false;
    }
    value = numbers[reference - first];
    return true;
}

// A state without addresses, behind the numbers that say whose it is.
struct Owner {
    uint32_t size, coefficients;
};
template <typename State>
std::vector<unsigned char> bytes_of(const State& without_addresses) {
    const Owner owner = {sizeof(State), lpvg_coeff.words.crc32};
    std::vector<unsigned char> bytes(sizeof owner + sizeof(State));
    std::memcpy(bytes.data(), &owner, sizeof owner);
    std::memcpy(bytes.data() + sizeof owner, &without_addresses, sizeof(State));
    return bytes;
}

// Null, or why these bytes are no state of this vehicle.
template <typename State>
const char* state_of(const unsigned char* bytes, std::size_t size, State& without_addresses) {
    Owner owner{};
    if (size != sizeof owner + sizeof(State)) {
        return "serialized state: of another length; expected a state of this FMU";
    }
    std::memcpy(&owner, bytes, sizeof owner);
    if (owner.size != sizeof(State) || owner.coefficients != lpvg_coeff.words.crc32) {
        return "serialized state: of another vehicle; expected one of these coefficients";
    }
    std::memcpy(static_cast<void*>(&without_addresses), bytes + sizeof owner, sizeof(State));
    return nullptr;
}

}  // namespace lpvguard_fmu
