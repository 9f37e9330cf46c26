#include "telemetry.hpp"

#include <algorithm>

namespace {

template <std::size_t n>
void copy(const std::uint32_t (&from)[n], std::uint32_t (&to)[n]) {
    for (std::size_t i = 0; i < n; ++i) {
        to[i] = from[i];
    }
}

}  // namespace

bool Judgements::note(const firmware_t& firmware) {
    const lpvg_monitor_t& monitor = firmware.ecu.monitor;
    const lpvg_frame_t& frame = *lpvg_monitor_frame(&monitor);
    energy_ratio_ = std::max(energy_ratio_, static_cast<double>(monitor.energy.ratio));
    change_ratio_ = std::max(change_ratio_, static_cast<double>(monitor.change.ratio));
    if (frame.sequence == newest_.sequence) {
        return false;
    }
    newest_ = {frame.t_end_us,
               frame.sequence,
               frame.bin,
               static_cast<std::uint32_t>(frame.reason),
               frame.falsified ? 1U : 0U,
               static_cast<double>(frame.speed),
               static_cast<double>(frame.margin),
               static_cast<double>(frame.statistic),
               static_cast<double>(frame.evidence),
               energy_ratio_,
               change_ratio_};
    energy_ratio_ = change_ratio_ = 0.0;
    return true;
}

bool Findings::note(const firmware_t& firmware) {
#if FIRMWARE_DIAGNOSES
    const lpvg_diagnosis_t& from = firmware.diagnosis;
    if (from.blocks != LPVG_DIAGNOSIS_DONE || from.alarms == alarms_) {
        return false;
    }
    alarms_ = from.alarms;
    const std::int64_t block_us = static_cast<std::int64_t>(LPVG_NBLOCK) * lpvg_coeff.words.sample_period_us;
    for (std::uint32_t j = 0U; j < LPVG_NY; ++j) {
        const lpvg_found_t& of = from.found[j];
        newest_[j] = {from.t_alarm_us,
                      from.t_alarm_us - block_us * of.onset_blocks,
                      from.alarms,
                      j,
                      static_cast<std::uint32_t>(of.cause),
                      of.before ? 1U : 0U,
                      static_cast<double>(of.value),
                      static_cast<double>(of.low),
                      static_cast<double>(of.high)};
    }
    return true;
#else
    static_cast<void>(firmware);
    return false;
#endif
}

Supervision supervision_of(const firmware_t& firmware) {
    const lpvg_can_supervisor_t& from = firmware.ecu.supervisor;
    Supervision to{};
    to.bus_off = from.bus_off;
    to.messages = from.n_rules;
    copy(from.count, to.other);
    for (std::size_t i = 0; i < from.n_rules; ++i) {
        const lpvg_can_watch_t& watch = from.watch[i];
        to.watch[i].id = from.rules[i].id & 0x1FFFFFFFU;
        to.watch[i].state = watch.state;
        to.watch[i].score = watch.score;
        to.watch[i].missed = watch.missed;
        copy(watch.count, to.watch[i].count);
    }
    return to;
}
