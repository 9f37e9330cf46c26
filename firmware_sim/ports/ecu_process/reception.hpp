/// @file reception.hpp -- what the supervision counted and when, for people and for the simulator: not part of the loop.
#pragma once

#include <cstdint>

#include "firmware.h"
#include "text.hpp"

class Reception {
public:
    Reception();

    /// Notes which kinds of events have come up since; call after every tick.
    void note(const lpvg_can_supervisor_t& supervisor, std::int64_t now_us);

    /// Members of a JSON object: "send_failures": n, "authentication": null without a key, else counts of authenticators
    /// by event, "rules": [row, ...]. A row is [id, state, [counts], [first seen s]]: the state as
    /// lpvg_can_state_t, the counts in the order of lpvg_can_event_t, and -1 for what was never seen.
    /// The last row, [0, bus-off, [counts], [first seen s]], is for frames of no rule.
    void write(const firmware_t& firmware, Text& out) const;

private:
    std::int64_t first_us_[LPVG_CAN_RULES_MAX + 1U][lpvg_can_event_count];
};
