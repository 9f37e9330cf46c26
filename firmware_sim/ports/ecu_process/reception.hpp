/// @file reception.hpp -- counters and times of the supervision, for people and for the simulator; not part of the loop.
#pragma once

#include <cstdint>

#include "firmware.h"
#include "text.hpp"

class Reception {
public:
    Reception();

    /// Records the new kinds of events. Call it after every tick.
    void note(const lpvg_can_supervisor_t& supervisor, std::int64_t now_us);

    /// Members of a JSON object: "send_failures": n, "authentication": null without a key, else the counts of authenticators
    /// by event, "rules": [row, ...]. A row is [id, state, [counts], [first seen s]]. The state is lpvg_can_state_t, the
    /// counts are in the order of lpvg_can_event_t, and the time of an event that never occurred is -1.
    /// The last row, [0, bus-off, [counts], [first seen s]], is for frames without a rule.
    void write(const firmware_t& firmware, Text& out) const;

private:
    std::int64_t first_us_[LPVG_CAN_RULES_MAX + 1U][lpvg_can_event_count];
};
