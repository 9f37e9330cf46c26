#include "lpvguard/can.h"

#include <cstring>

namespace {

constexpr uint32_t kPeriodMinUs = 4U;
constexpr uint32_t kPeriodMaxUs = 10'000'000U;
constexpr uint8_t kFrameBytes = 8U;

// Table for a CRC-8 with polynomial 0x1D, one byte at a time. Entry n is the remainder of n * x^8.
struct CrcTable {
    uint8_t entry[256];
    constexpr CrcTable() : entry() {
        for (uint32_t n = 0U; n < 256U; ++n) {
            uint32_t crc = n;
            for (int bit = 0; bit < 8; ++bit) {
                crc = (crc << 1U) ^ ((crc & 0x80U) != 0U ? 0x11DU : 0U);
            }
            entry[n] = static_cast<uint8_t>(crc);
        }
    }
};
constexpr CrcTable kCrc;

uint8_t crc_step(uint8_t crc, uint8_t byte) { return kCrc.entry[static_cast<uint8_t>(crc ^ byte)]; }

// Profile 11, data-id mode BOTH: id low, id high, then the frame without its CRC byte; start value and xor-out 0.
uint8_t e2e_crc(const lpvg_can_frame_t& frame, uint16_t data_id) {
    uint8_t crc = crc_step(0U, static_cast<uint8_t>(data_id & 0xFFU));
    crc = crc_step(crc, static_cast<uint8_t>(data_id >> 8U));
    for (uint8_t i = 1U; i < frame.dlc; ++i) {
        crc = crc_step(crc, frame.data[i]);
    }
    return crc;
}

bool e2e_length(const lpvg_can_frame_t& frame) { return frame.dlc >= 2U && frame.dlc <= kFrameBytes; }

void add(uint32_t& count, uint32_t n) { count = (n > UINT32_MAX - count) ? UINT32_MAX : count + n; }

bool sane(const lpvg_can_rule_t& rule) {
    if (rule.period_us < kPeriodMinUs || rule.period_us > kPeriodMaxUs || rule.gap_min_us >= rule.period_us || rule.dlc > kFrameBytes ||
        rule.e2e > 1U || (rule.e2e == 1U && rule.dlc < 2U) || rule.n_signals > LPVG_CAN_SIGNALS_MAX ||
        (rule.n_signals > 0U && rule.signals == nullptr)) {
        return false;
    }
    for (uint8_t i = 0U; i < rule.n_signals; ++i) {
        const lpvg_can_signal_rule_t& s = rule.signals[i];
        if (s.length < 1U || s.length > 16U || s.start + s.length > 8 * rule.dlc || s.raw_min > s.raw_max) {
            return false;
        }
    }
    return true;
}

// A signal of at most 16 bits lies in at most three bytes. Bytes beyond the frame are not read.
uint16_t extract(const lpvg_can_frame_t& frame, const lpvg_can_signal_rule_t& s) {
    const uint32_t first = s.start >> 3U;
    uint32_t bits = frame.data[first];
    if (first < kFrameBytes - 1U) {
        bits |= static_cast<uint32_t>(frame.data[first + 1U]) << 8U;
    }
    if (first < kFrameBytes - 2U) {
        bits |= static_cast<uint32_t>(frame.data[first + 2U]) << 16U;
    }
    return static_cast<uint16_t>((bits >> (s.start & 7U)) & ((1UL << s.length) - 1U));
}

lpvg_can_event_t judge_signal(const lpvg_can_signal_rule_t& s, uint16_t raw, const uint16_t* before, int64_t dt_us) {
    if (s.absent_min > 0U && raw >= s.absent_min) {
        return lpvg_can_event_absent;
    }
    if (s.error_min > 0U && raw >= s.error_min) {
        return lpvg_can_event_invalid;
    }
    if (raw < s.raw_min || raw > s.raw_max) {
        return lpvg_can_event_range;
    }
    if (before != nullptr && s.rate_max > 0U) {
        // This is |change| > rate * dt + 1 without a division. dt is less than 6 of the longest periods, so it fits in 32 bits.
        const uint32_t change = raw > *before ? raw - *before : *before - raw;
        const auto dt = static_cast<uint32_t>(dt_us);
        if (change > 1U && static_cast<uint64_t>(change - 1U) * 1'000'000U > static_cast<uint64_t>(s.rate_max) * dt) {
            return lpvg_can_event_gradient;
        }
    }
    return lpvg_can_event_accepted;
}

// Judges the signals of a frame that is otherwise good, and writes them to `raw`.
lpvg_can_event_t judge_signals(const lpvg_can_rule_t& rule, const lpvg_can_watch_t& watch, const lpvg_can_frame_t& frame,
                               uint16_t (&raw)[LPVG_CAN_SIGNALS_MAX]) {
    // With jitter, frames come closer together than their values were sampled. The values are at least one period apart.
    // After the switch-off there is no old value for a comparison, so the product below stays small.
    const int64_t age_us = frame.t_us - watch.t_accepted_us;
    const int64_t dt_us = age_us < rule.period_us ? rule.period_us : age_us;
    for (uint8_t i = 0U; i < rule.n_signals; ++i) {
        raw[i] = extract(frame, rule.signals[i]);
        const auto event = judge_signal(rule.signals[i], raw[i], watch.has_raw != 0U ? &watch.raw[i] : nullptr, dt_us);
        if (event != lpvg_can_event_accepted) {
            return event;
        }
    }
    return lpvg_can_event_accepted;
}

// Judges checksum and counter. The counter of a frame with a right checksum is always stored. After a restart of the
// sender, only one frame is therefore rejected.
lpvg_can_event_t judge_protection(const lpvg_can_rule_t& rule, lpvg_can_watch_t& watch, const lpvg_can_frame_t& frame) {
    if (e2e_crc(frame, rule.e2e_data_id) != frame.data[0]) {
        return lpvg_can_event_checksum;
    }
    const auto counter = static_cast<uint8_t>(frame.data[1] & 0x0FU);
    if (counter >= LPVG_CAN_COUNTERS) {
        return lpvg_can_event_sequence;
    }
    const auto step = static_cast<uint8_t>((counter + LPVG_CAN_COUNTERS - watch.counter) % LPVG_CAN_COUNTERS);
    const bool had_one = watch.has_counter != 0U;
    watch.counter = counter;
    watch.has_counter = 1U;
    if (had_one && step == 0U) {
        return lpvg_can_event_repeated;
    }
    if (had_one && step > LPVG_CAN_COUNTER_STEP) {
        return lpvg_can_event_sequence;
    }
    if (had_one) {
        add(watch.count[lpvg_can_event_lost], step - 1U);
    }
    return lpvg_can_event_accepted;
}

constexpr uint8_t fast_short = 1U, fast_long = 2U;

// Tells if frames arrive faster than one sender sends, over few and over many arrivals. Counting restarts after a burst.
void count_arrival(const lpvg_can_rule_t& rule, lpvg_can_watch_t& watch, int64_t t_us) {
    const int64_t period = rule.period_us;
    if (watch.has_arrival == 0U) {
        watch.t_window_us = watch.t_rate_us = t_us;
        return;
    }
    ++watch.arrivals;
    ++watch.rate_arrivals;
    if (watch.arrivals >= LPVG_CAN_ARRIVALS) {
        watch.fast = static_cast<uint8_t>(watch.fast & fast_long);
        if (t_us - watch.t_window_us < LPVG_CAN_ARRIVALS_PERIODS * period) {
            watch.fast = fast_short;
            watch.t_rate_us = t_us;
            watch.rate_arrivals = 0U;
        }
        watch.t_window_us = t_us;
        watch.arrivals = 0U;
    }
    if (watch.rate_arrivals >= LPVG_CAN_RATE_ARRIVALS) {
        watch.fast = static_cast<uint8_t>(t_us - watch.t_rate_us < LPVG_CAN_RATE_PERIODS * period ? watch.fast | fast_long
                                                                                                  : watch.fast & fast_short);
        watch.t_rate_us = t_us;
        watch.rate_arrivals = 0U;
    }
}

lpvg_can_event_t judge(const lpvg_can_rule_t& rule, lpvg_can_watch_t& watch, const lpvg_can_frame_t& frame,
                       uint16_t (&raw)[LPVG_CAN_SIGNALS_MAX]) {
    const bool early = watch.has_arrival != 0U && frame.t_us - watch.t_arrival_us < rule.gap_min_us;
    count_arrival(rule, watch, frame.t_us);
    watch.t_arrival_us = frame.t_us;
    watch.has_arrival = 1U;
    if (early || watch.fast != 0U) {
        return lpvg_can_event_early;
    }
    if (frame.dlc != rule.dlc) {
        return lpvg_can_event_length;
    }
    if (rule.e2e != 0U) {
        const auto event = judge_protection(rule, watch, frame);
        if (event != lpvg_can_event_accepted) {
            return event;
        }
    }
    return judge_signals(rule, watch, frame, raw);
}

void switch_off(lpvg_can_watch_t& watch) {
    watch.state = lpvg_can_state_off;
    watch.good_in_row = 0U;
    watch.has_raw = 0U;
    watch.has_counter = 0U;
    watch.window = 0U;
    watch.window_bad = 0U;
}

// Adds the newest frame to the window of errors.
void note(lpvg_can_watch_t& watch, bool bad) {
    const bool oldest_bad = (watch.window >> (LPVG_CAN_WINDOW - 1U)) != 0U;
    watch.window = static_cast<uint16_t>((static_cast<uint32_t>(watch.window) << 1U) | (bad ? 1U : 0U));
    watch.window_bad = static_cast<uint8_t>(watch.window_bad + (bad ? 1U : 0U) - (oldest_bad ? 1U : 0U));
}

// Tells if a bad frame shows a second sender: it repeats the newest accepted counter, and it comes earlier than any repetition of the
// sender. A frame that is early by jitter has the next counter. A repeated frame that replaces the next one keeps the period.
bool foreign(const lpvg_can_rule_t& rule, const lpvg_can_watch_t& watch, const lpvg_can_frame_t& frame, lpvg_can_event_t event) {
    const bool same = rule.e2e != 0U && watch.has_counter != 0U && (frame.data[1] & 0x0FU) == watch.counter;
    const bool soon = 4 * (frame.t_us - watch.t_accepted_us) < 3 * static_cast<int64_t>(rule.period_us);
    return same && soon && (event == lpvg_can_event_repeated || event == lpvg_can_event_early);
}

void take_bad(lpvg_can_watch_t& watch, bool from_foreign) {
    if (watch.score < LPVG_CAN_SCORE_OFF) {
        ++watch.score;
    }
    if (from_foreign) {
        const uint32_t sum = watch.foreign + LPVG_CAN_FOREIGN_ADD;
        watch.foreign = static_cast<uint8_t>(sum < LPVG_CAN_FOREIGN_OFF ? sum : LPVG_CAN_FOREIGN_OFF);
    }
    if (watch.state == lpvg_can_state_off) {
        watch.good_in_row = 0U;
        watch.has_raw = 0U;
    } else if (watch.score >= LPVG_CAN_SCORE_OFF || watch.foreign >= LPVG_CAN_FOREIGN_OFF || watch.fast != 0U) {
        switch_off(watch);
    }
    note(watch, true);
    if (watch.window_bad >= LPVG_CAN_WINDOW_BAD && watch.state != lpvg_can_state_off) {
        switch_off(watch);
        note(watch, true);
    }
}

// Takes a good frame. Returns whether the frame may be used.
lpvg_can_event_t take_good(lpvg_can_watch_t& watch, int64_t t_us, const uint16_t (&raw)[LPVG_CAN_SIGNALS_MAX]) {
    watch.t_accepted_us = t_us;
    watch.missed = 0U;
    std::memcpy(watch.raw, raw, sizeof watch.raw);
    watch.has_raw = 1U;
    if (watch.state == lpvg_can_state_off) {
        ++watch.good_in_row;
        if (watch.good_in_row < LPVG_CAN_RECOVER_FRAMES) {
            return lpvg_can_event_recovering;
        }
        watch.score = 0U;
        watch.foreign = 0U;
        watch.good_in_row = 0U;
        watch.window = 0U;
        watch.window_bad = 0U;
    } else {
        watch.score = static_cast<uint8_t>(watch.score - (watch.score > 0U ? 1U : 0U));
        watch.foreign = static_cast<uint8_t>(watch.foreign - (watch.foreign > 0U ? 1U : 0U));
        note(watch, false);
    }
    watch.state = lpvg_can_state_live;
    return lpvg_can_event_accepted;
}

void advance(lpvg_can_watch_t& watch, const lpvg_can_rule_t& rule, int64_t now_us) {
    const int64_t period = rule.period_us;
    const int64_t late = now_us - watch.t_accepted_us - period / 2 - static_cast<int64_t>(watch.missed) * period;
    if (late <= period) {
        return;  // no further period is missed; this common case needs no division
    }
    // A delay beyond 2^32 us is counted in the following calls.
    const uint32_t whole = (late > UINT32_MAX ? UINT32_MAX : static_cast<uint32_t>(late - 1)) / rule.period_us;
    add(watch.count[lpvg_can_event_missed], whole);
    add(watch.missed, whole);
    if (watch.missed >= LPVG_CAN_OFF_MISSED) {
        switch_off(watch);
    } else if (watch.missed >= LPVG_CAN_HOLD_MISSED && watch.state == lpvg_can_state_live) {
        watch.state = lpvg_can_state_hold;
    }
}

// Takes one sample of a check. A `deviation` beyond `limit` is a violation.
void plausibility_step(lpvg_can_plausibility_t& self, uint8_t check, float deviation, float limit, uint16_t confirm) {
    const auto flag = static_cast<uint8_t>(1U << check);
    const bool violation = deviation > limit || deviation < -limit;
    const bool failed = lpvg_can_confirm(&self.score[check], (self.flags & flag) != 0U, violation, confirm);
    self.flags = static_cast<uint8_t>(failed ? self.flags | flag : self.flags & ~flag);
}

bool finite(float x) { return x - x == 0.0F; }
bool positive(float x) { return x > 0.0F && finite(x); }

}  // namespace

extern "C" {

lpvg_status_t lpvg_can_init(lpvg_can_supervisor_t* self, const lpvg_can_rule_t* rules, size_t n_rules, int64_t now_us) {
    if (self == nullptr || rules == nullptr || n_rules == 0U || n_rules > LPVG_CAN_RULES_MAX || now_us < 0) {
        return lpvg_status_bad_argument;
    }
    for (size_t i = 0U; i < n_rules; ++i) {
        if (!sane(rules[i])) {
            return lpvg_status_bad_argument;
        }
    }
    std::memset(self, 0, sizeof *self);
    self->rules = rules;
    self->n_rules = static_cast<uint8_t>(n_rules);
    self->now_us = now_us;
    for (uint8_t i = 0U; i < self->n_rules; ++i) {
        self->watch[i].t_accepted_us = now_us;
    }
    return lpvg_status_ok;
}

void lpvg_can_advance(lpvg_can_supervisor_t* self, int64_t now_us) {
    if (self == nullptr || now_us < self->now_us) {
        return;
    }
    self->now_us = now_us;
    for (uint8_t i = 0U; i < self->n_rules; ++i) {
        advance(self->watch[i], self->rules[i], now_us);
    }
}

lpvg_can_event_t lpvg_can_receive(lpvg_can_supervisor_t* self, const lpvg_can_frame_t* frame, uint8_t* index) {
    if (self == nullptr || frame == nullptr || index == nullptr) {
        return lpvg_can_event_none;
    }
    *index = LPVG_CAN_NO_INDEX;
    if (frame->t_us < self->now_us - LPVG_CAN_REORDER_US) {
        add(self->count[lpvg_can_event_backwards], 1U);
        return lpvg_can_event_backwards;
    }
    lpvg_can_advance(self, frame->t_us);
    if ((frame->id & LPVG_CAN_ERROR) != 0U) {
        const auto event = (frame->id & LPVG_CAN_BUS_OFF) != 0U ? lpvg_can_event_bus_off : lpvg_can_event_error;
        add(self->count[event], 1U);
        if (event == lpvg_can_event_bus_off) {
            self->bus_off = 1U;
            for (uint8_t i = 0U; i < self->n_rules; ++i) {
                switch_off(self->watch[i]);
            }
        }
        return event;
    }
    self->bus_off = 0U;
    uint8_t i = 0U;
    while (i < self->n_rules && ((frame->id ^ self->rules[i].id) & self->rules[i].id_mask) != 0U) {
        ++i;
    }
    if (i == self->n_rules) {
        add(self->count[lpvg_can_event_unknown_id], 1U);
        return lpvg_can_event_unknown_id;
    }
    *index = i;
    lpvg_can_watch_t& watch = self->watch[i];
    uint16_t raw[LPVG_CAN_SIGNALS_MAX] = {};
    lpvg_can_event_t event = judge(self->rules[i], watch, *frame, raw);
    if (event == lpvg_can_event_accepted) {
        event = take_good(watch, frame->t_us, raw);
    } else {
        take_bad(watch, foreign(self->rules[i], watch, *frame, event));
    }
    add(watch.count[event], 1U);
    return event;
}

lpvg_can_state_t lpvg_can_state(const lpvg_can_supervisor_t* self, uint8_t index) {
    if (self == nullptr || index >= self->n_rules) {
        return lpvg_can_state_off;
    }
    return static_cast<lpvg_can_state_t>(self->watch[index].state);
}

lpvg_status_t lpvg_can_e2e_protect(lpvg_can_frame_t* frame, uint16_t data_id, uint8_t* counter) {
    if (frame == nullptr || counter == nullptr || !e2e_length(*frame) || *counter >= LPVG_CAN_COUNTERS) {
        return lpvg_status_bad_argument;
    }
    frame->data[1] = static_cast<uint8_t>((frame->data[1] & 0xF0U) | *counter);
    frame->data[0] = e2e_crc(*frame, data_id);
    *counter = static_cast<uint8_t>((*counter + 1U) % LPVG_CAN_COUNTERS);
    return lpvg_status_ok;
}

lpvg_status_t lpvg_can_e2e_check(const lpvg_can_frame_t* frame, uint16_t data_id, uint8_t* counter) {
    if (frame == nullptr || counter == nullptr || !e2e_length(*frame)) {
        return lpvg_status_bad_argument;
    }
    const auto received = static_cast<uint8_t>(frame->data[1] & 0x0FU);
    if (received >= LPVG_CAN_COUNTERS || e2e_crc(*frame, data_id) != frame->data[0]) {
        return lpvg_status_bad_sample;
    }
    *counter = received;
    return lpvg_status_ok;
}

lpvg_status_t lpvg_can_plausibility(lpvg_can_plausibility_t* self, const lpvg_can_plausibility_limits_t* limits, float yaw_rate,
                                    float lateral, float speed, float wheel_difference) {
    if (self == nullptr || limits == nullptr || !positive(limits->track_m) || !positive(limits->speed_min_mps) ||
        !positive(limits->lateral_mps2) || !positive(limits->yaw_rps) || limits->confirm == 0U) {
        return lpvg_status_bad_argument;
    }
    if (!finite(yaw_rate) || !finite(speed) || speed < limits->speed_min_mps) {
        return lpvg_status_ok;
    }
    if (finite(lateral)) {
        plausibility_step(*self, 0U, yaw_rate * speed - lateral, limits->lateral_mps2, limits->confirm);
    }
    if (finite(wheel_difference)) {
        plausibility_step(*self, 1U, yaw_rate - wheel_difference / limits->track_m, limits->yaw_rps, limits->confirm);
    }
    return lpvg_status_ok;
}

bool lpvg_can_confirm(uint16_t* score, bool failed, bool violation, uint16_t confirm) {
    if (score == nullptr) {
        return false;
    }
    if (violation && *score < confirm) {
        ++*score;
    } else if (!violation && *score > 0U) {
        --*score;
    }
    return *score >= confirm || (failed && *score > 0U);
}

uint8_t lpvg_can_fmi(lpvg_can_event_t event) {
    switch (event) {
        case lpvg_can_event_missed: return LPVG_CAN_FMI_UPDATE_RATE;
        case lpvg_can_event_early: return LPVG_CAN_FMI_FREQUENCY;
        case lpvg_can_event_gradient: return LPVG_CAN_FMI_RATE_OF_CHANGE;
        case lpvg_can_event_absent:
        case lpvg_can_event_invalid:
        case lpvg_can_event_range: return LPVG_CAN_FMI_ERRATIC;
        case lpvg_can_event_length:
        case lpvg_can_event_checksum:
        case lpvg_can_event_repeated:
        case lpvg_can_event_sequence:
        case lpvg_can_event_lost:
        case lpvg_can_event_bus_off:
        case lpvg_can_event_error: return LPVG_CAN_FMI_NETWORK;
        default: return LPVG_CAN_FMI_CONDITION;
    }
}

lpvg_status_t lpvg_can_dm1_pack(lpvg_can_frame_t* frame, uint8_t source_address, uint8_t lamps, const lpvg_can_dtc_t* dtc) {
    constexpr uint32_t kDm1Id = 0x18FECA00U;
    constexpr uint8_t kLampMask = LPVG_CAN_LAMP_PROTECT | LPVG_CAN_LAMP_AMBER | LPVG_CAN_LAMP_RED | LPVG_CAN_LAMP_MIL;
    if (frame == nullptr || (lamps & ~kLampMask) != 0 ||
        (dtc != nullptr && (dtc->spn > 0x7FFFFU || dtc->fmi > 31U || dtc->occurrence > 127U))) {
        return lpvg_status_bad_argument;
    }
    const lpvg_can_dtc_t none{};
    const lpvg_can_dtc_t& code = dtc != nullptr ? *dtc : none;
    frame->id = LPVG_CAN_EXTENDED | kDm1Id | source_address;
    frame->dlc = kFrameBytes;
    frame->data[0] = lamps;
    frame->data[1] = 0xFFU;  // no lamp flashes
    frame->data[2] = static_cast<uint8_t>(code.spn & 0xFFU);
    frame->data[3] = static_cast<uint8_t>((code.spn >> 8U) & 0xFFU);
    frame->data[4] = static_cast<uint8_t>(((code.spn >> 11U) & 0xE0U) | code.fmi);
    frame->data[5] = code.occurrence;
    frame->data[6] = 0xFFU;
    frame->data[7] = 0xFFU;
    return lpvg_status_ok;
}

}  // extern "C"
