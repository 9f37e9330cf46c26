/// @file telemetry.hpp -- data that a simulator can request from an ECU, in addition to the frames on its bus. Not part of the loop.
///
/// The data use the time line (time_line.h), in a layout that all processors share.
#pragma once

#include <cstdint>

#include "firmware.h"

/// A frame that the monitor judged, and the results of the other tests meanwhile.
struct Judged {
    std::int64_t t_end_us;  ///< time of the frame's last sample
    std::uint32_t sequence, bin, reason, falsified;  ///< as in lpvg_frame_t
    double speed_mps, margin, statistic, evidence;   ///< as in lpvg_frame_t
    double energy_ratio, change_ratio;  ///< largest ratios of the energy test and of the change test since the previous frame
};

/// Result of the diagnosis of an alarm for one output.
struct Found {
    std::int64_t t_alarm_us, t_onset_us;  ///< time of the alarm's block; time of the onset
    std::uint32_t alarm, output, cause, before;  ///< number of the alarm since init; index; fields of lpvg_found_t
    double value, low, high;              ///< as in lpvg_found_t
};

/// Saturating counters of the supervision of the ECU's bus, in the order of lpvg_can_event_t.
struct Supervision {
    struct Watch {
        std::uint32_t id;  ///< supervised identifier without flags
        std::uint32_t state, score, missed;  ///< as in lpvg_can_watch_t
        std::uint32_t count[lpvg_can_event_count];
    };
    std::uint32_t bus_off, messages;
    std::uint32_t other[lpvg_can_event_count];  ///< frames that belong to no message
    Watch watch[LPVG_CAN_RULES_MAX];            ///< [messages]
};

static_assert(sizeof(Judged) == 72 && sizeof(Found) == 56 && sizeof(Supervision) == 4 * (2 + 18 + 8 * 22),
              "no padding: the same on every processor");

/// Detects new judged frames of the monitor.
class Judgements {
public:
    /// Call it after every tick. Returns true if a frame was judged in the tick; newest() returns it.
    bool note(const firmware_t& firmware);
    const Judged& newest() const { return newest_; }

private:
    Judged newest_{};
    double energy_ratio_ = 0.0, change_ratio_ = 0.0;
};

/// Detects new causes of alarms.
class Findings {
public:
    /// Call it after every firmware_idle. Returns true if causes of an alarm were found; newest() returns one for each output.
    bool note(const firmware_t& firmware);
    const Found (&newest() const)[LPVG_NY] { return newest_; }

private:
    Found newest_[LPVG_NY]{};
    std::uint32_t alarms_ = 0U;
};

Supervision supervision_of(const firmware_t& firmware);
