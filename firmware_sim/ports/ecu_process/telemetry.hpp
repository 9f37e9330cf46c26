/// @file telemetry.hpp -- what a simulator may ask of an ECU beside the frames on its bus. Not part of the loop.
///
/// It goes over the time line (time_line.h), in a layout that every processor shares.
#pragma once

#include <cstdint>

#include "firmware.h"

/// A frame that the monitor has judged, and what the other tests said meanwhile.
struct Judged {
    std::int64_t t_end_us;  ///< of the frame's last sample
    std::uint32_t sequence, bin, reason, falsified;  ///< as in lpvg_frame_t
    double speed_mps, margin, statistic, evidence;   ///< likewise
    double energy_ratio, change_ratio;  ///< largest ratios of the energy test and of the change test since the frame before
};

/// What the diagnosis of an alarm found of an output.
struct Found {
    std::int64_t t_alarm_us, t_onset_us;  ///< of the alarm's block; of the onset
    std::uint32_t alarm, output, cause, before;  ///< number of the alarm since init, index, the others as in lpvg_found_t
    double value, low, high;              ///< likewise
};

/// What the supervision of the ECU's bus has counted: saturating, kinds in the order of lpvg_can_event_t.
struct Supervision {
    struct Watch {
        std::uint32_t id;  ///< as supervised, without flags
        std::uint32_t state, score, missed;  ///< as in lpvg_can_watch_t
        std::uint32_t count[lpvg_can_event_count];
    };
    std::uint32_t bus_off, messages;
    std::uint32_t other[lpvg_can_event_count];  ///< frames that belong to no message
    Watch watch[LPVG_CAN_RULES_MAX];            ///< [messages]
};

static_assert(sizeof(Judged) == 72 && sizeof(Found) == 56 && sizeof(Supervision) == 4 * (2 + 18 + 8 * 22),
              "no padding: the same on every processor");

/// Notices what the monitor judges.
class Judgements {
public:
    /// Call after every tick. True: a frame has been judged in it, newest().
    bool note(const firmware_t& firmware);
    const Judged& newest() const { return newest_; }

private:
    Judged newest_{};
    double energy_ratio_ = 0.0, change_ratio_ = 0.0;
};

/// Notices when causes are found.
class Findings {
public:
    /// Call after every firmware_idle. True: an alarm's causes were found in it, newest() an output each.
    bool note(const firmware_t& firmware);
    const Found (&newest() const)[LPVG_NY] { return newest_; }

private:
    Found newest_[LPVG_NY]{};
    std::uint32_t alarms_ = 0U;
};

Supervision supervision_of(const firmware_t& firmware);
