// ecu.cpp -- see ecu.h.
#include "lpvguard/ecu.h"

#if LPVG_NK > 0

#include <cmath>
#include <cstring>
#include <utility>

#include "control_begin.hpp"
#include "monitor/acceptance.hpp"
#include "monitor/begin.hpp"

namespace {

using Real = lpvg_real_t;
constexpr std::size_t n_kept = sizeof(lpvg_ecu_kept_t) / sizeof(uint32_t);
static_assert(sizeof(lpvg_ecu_kept_t) % sizeof(uint32_t) == 0U, "inverted word by word");
constexpr std::size_t n_model = lpvguard::n_items<lpvg_coeff_t>, n_all = n_model + lpvguard::n_items<lpvg_control_coeff_t>;
constexpr int64_t dm1_period_us = 1'000'000;
constexpr uint32_t period_longest_us = LPVG_ECU_WINDOW_US / 4U;  // two steps make a half window
static_assert(n_all < UINT32_MAX / period_longest_us, "their product is a number of 32 bits");
constexpr uint8_t priority_max = 3U;
constexpr uint8_t occurrence_max = 126U;  // 127 says "unknown"
static_assert(LPVG_J1939_CODES_MAX >= 8U + LPVG_CAN_RULES_MAX, "every finding and every message has a code; a verdict is one");

// The limits are what lpvg_can_plausibility accepts: asked of it, on a sample that it leaves out.
bool limits_good(const lpvg_can_plausibility_limits_t& limits) {
    lpvg_can_plausibility_t scratch{};
    return lpvg_can_plausibility(&scratch, &limits, NAN, NAN, NAN, NAN) == lpvg_status_ok;
}

void count(uint32_t& counter) { counter += counter < UINT32_MAX ? 1U : 0U; }

// Between any two times, in any order.
uint64_t elapsed_us(int64_t now, int64_t before) { return now > before ? static_cast<uint64_t>(now) - static_cast<uint64_t>(before) : 0U; }

bool follows(uint64_t step, uint64_t period) { return 2U * step >= period && 2U * step <= 3U * period; }

// How far the ECU's own time moves in a call at now_us; 0: the call is refused.
uint32_t step_us(lpvg_ecu_t& self, int64_t now_us) {
    lpvg_ecu_clock_t& clock = self.clock;
    if (!clock.started) {
        return now_us >= self.kept.now_us && now_us <= INT64_MAX / 2 ? self.kept.period_us : 0U;
    }
    const uint64_t step = elapsed_us(now_us, self.kept.now_us);
    if (step <= LPVG_ECU_JUMP_US && 2U * step >= self.kept.period_us) {
        return static_cast<uint32_t>(step);
    }
    const uint64_t since = elapsed_us(now_us, clock.jump_us);
    clock.in_step = static_cast<uint8_t>(since <= LPVG_ECU_JUMP_US && follows(since, self.kept.period_us) ? clock.in_step + 1U : 1U);
    clock.jump_us = now_us;
    if (clock.in_step >= LPVG_ECU_RESYNC_CALLS) {
        return LPVG_ECU_JUMP_US;
    }
    count(clock.refused);
    return 0U;
}

// Whether `us` for so many steps is the exported period.
bool in_pace(uint64_t us, uint64_t steps, uint64_t period_us) {
    const uint64_t wanted = steps * period_us;
    const uint64_t off = us > wanted ? us - wanted : wanted - us;
    return 100U * off <= LPVG_ECU_PERIOD_PERCENT * wanted;
}

// Measures the mean period over two half windows, over one where there is no more.
void pace(lpvg_ecu_t& self, uint32_t step) {
    lpvg_ecu_clock_t& clock = self.clock;
    if (!follows(step, self.kept.period_us)) {
        clock.pace = lpvg_ecu_pace_unknown;
        clock.before_us = 0U;
        clock.steps = 0U;
        clock.half_us = self.core_us;
        count(clock.gaps);
        return;
    }
    const uint32_t half = LPVG_ECU_WINDOW_US / 2U / self.kept.period_us;
    if (++clock.steps < half) {
        return;
    }
    const auto newest = static_cast<uint32_t>(self.core_us - clock.half_us);
    const uint64_t steps = clock.before_us > 0U ? 2U * half : half;
    const bool good = in_pace(static_cast<uint64_t>(newest) + clock.before_us, steps, self.kept.period_us);
    clock.pace = good ? lpvg_ecu_pace_good : lpvg_ecu_pace_bad;
    clock.before_us = newest;
    clock.steps = 0U;
    clock.half_us = self.core_us;
}

// Written out word by word: both run in every step.
template <std::size_t... i>
void invert(lpvg_ecu_t& self, std::index_sequence<i...>) {
    ((self.inverted[i] = ~lpvguard::item_at<uint32_t>(self.kept, i)), ...);
}
template <std::size_t... i>
uint32_t differences(const lpvg_ecu_t& self, std::index_sequence<i...>) {
    return (0U | ... | (~lpvguard::item_at<uint32_t>(self.kept, i) ^ self.inverted[i]));
}

void keep(lpvg_ecu_t& self) {
    invert(self, std::make_index_sequence<n_kept>{});
    self.sum = lpvguard::sum_of_words(self.kept);
}

bool demands_kept(const lpvg_ecu_t& self) {
    for (std::size_t i = 0; i < LPVG_NU; ++i) {
        if (!(self.control.u[i] >= self.kept.demand[i] && self.control.u[i] <= self.kept.demand[i])) {
            return false;
        }
    }
    return true;
}

bool kept_well(const lpvg_ecu_t& self) { return differences(self, std::make_index_sequence<n_kept>{}) == 0U; }

// Takes the kept values from whichever copy still has their sum; false where none has.
bool rescue(lpvg_ecu_t& self) {
    uint32_t plain = 0U, inverted = 0U, words[n_kept];
    for (std::size_t i = 0; i < n_kept; ++i) {
        words[i] = ~self.inverted[i];
        plain += lpvguard::item_at<uint32_t>(self.kept, i);
        inverted += words[i];
    }
    if (plain != self.sum) {
        std::memcpy(&self.kept, words, sizeof self.kept);
    }
    return plain == self.sum || inverted == self.sum;
}

// What other software, or a fault of the memory, may have changed since the newest step. The kept values are good.
bool state_well(const lpvg_ecu_t& self) {
    return self.monitor.coeff == self.kept.coeff && self.control.coeff == self.kept.control && self.supervisor.rules == lpvg_bus.rules &&
           self.supervisor.n_rules == lpvg_bus.n_rules && self.supervisor.now_us == self.core_us && self.monitor.t_us <= self.core_us &&
           self.dm1_us <= self.core_us && self.core_us - self.dm1_us <= 2 * dm1_period_us && demands_kept(self) &&
           self.counter < LPVG_CAN_COUNTERS && self.occurrence <= occurrence_max;
}

// After damage: nothing is used that may have been hit, and the step that follows only reports.
void restore(lpvg_ecu_t& self, bool kept) {
    if (!kept) {
        std::memset(&self.kept, 0, sizeof self.kept);
        self.kept.period_us = LPVG_ECU_WINDOW_US / 100U;
        self.kept.now_us = self.now_us;
    }
    self.kept.corrupt = true;
    std::memcpy(self.control.u, self.kept.demand, sizeof self.control.u);
    self.supervisor.rules = lpvg_bus.rules;
    self.supervisor.n_rules = lpvg_bus.n_rules;
    self.supervisor.now_us = self.core_us;
    self.dm1_us = self.core_us - dm1_period_us;  // told at once
    // Beyond their ranges these would silence the messages.
    self.counter = static_cast<uint8_t>(self.counter % LPVG_CAN_COUNTERS);
    self.occurrence = self.occurrence < occurrence_max ? self.occurrence : occurrence_max;
    keep(self);
}

// The next few of all coefficients; false when a round ends with another CRC than they carry.
bool coefficients_well(lpvg_ecu_t& self) {
    const std::size_t items = static_cast<uint32_t>(n_all) * self.kept.period_us / LPVG_ECU_ROUND_US + 1U;
    const std::size_t first = self.next_item < n_all ? self.next_item : 0U;
    const std::size_t end = first + items < n_all ? first + items : n_all;
    bool good = true;
    std::size_t i = first;
    if (i < n_model) {
        const std::size_t stop = end < n_model ? end : n_model;
        self.crc = lpvguard::crc32_items(i == 0U ? lpvguard::crc32_start : self.crc, *self.kept.coeff, i, stop);
        i = stop;
        good = i < n_model || ~self.crc == self.kept.coeff->words.crc32;
    }
    if (good && i < end) {
        const uint32_t crc = i == n_model ? lpvguard::crc32_start : self.crc;
        self.crc = lpvguard::crc32_items(crc, *self.kept.control, i - n_model, end - n_model);
        good = end < n_all || ~self.crc == self.kept.control->words.crc32;
    }
    self.next_item = static_cast<uint32_t>(end < n_all ? end : 0U);
    if (end == n_all) {
        count(self.rounds);
    }
    return good;
}

// Takes a step at now_us, `step` after the newest one on the ECU's own time.
void tick(lpvg_ecu_t& self, int64_t now_us, uint32_t step) {
    lpvg_ecu_clock_t& clock = self.clock;
    self.kept.now_us = self.now_us = now_us;
    if (clock.started) {
        self.core_us += step;
        pace(self, step);
    } else {
        self.core_us = clock.half_us = now_us;
        clock.started = true;
    }
    clock.in_step = 0U;
}

// Finite, and broken by an actuator that is stuck at 0 under the largest demand.
bool actuator_limits_good(const lpvg_ecu_actuator_limits_t& limits, Real u_max) {
    return limits.lag_s > 0.0F && std::isfinite(limits.lag_s) && limits.tolerance > 0.0F && limits.relative >= 0.0F &&
           limits.tolerance < (1.0F - limits.relative) * static_cast<float>(u_max) && limits.confirm > 0U;
}

Real largest_limit(const lpvg_control_coeff_t& control, std::size_t input) {
    Real largest = Real(0);
    for (const auto& node : control.reals.u_max) {
        largest = node[input] > largest ? node[input] : largest;
    }
    return largest;
}

void receive(lpvg_ecu_t& self, const lpvg_can_frame_t* frames, std::size_t n) {
    const std::size_t taken = n < LPVG_ECU_FRAMES_IN ? n : LPVG_ECU_FRAMES_IN;
    const std::size_t dropped = n - taken;
    self.dropped += dropped < UINT32_MAX - self.dropped ? static_cast<uint32_t>(dropped) : UINT32_MAX - self.dropped;
    for (std::size_t i = dropped; i < n; ++i) {  // the newest
        lpvg_can_frame_t frame = frames[i];
        // Nothing arrives later than now: a driver's wrong time stamp must not carry the supervisor's clock away.
        const uint64_t age_us = elapsed_us(self.kept.now_us, frame.t_us);
        frame.t_us = age_us < static_cast<uint64_t>(self.core_us) ? self.core_us - static_cast<int64_t>(age_us) : 0;
        uint8_t index = LPVG_CAN_NO_INDEX;
        if (lpvg_can_receive(&self.supervisor, &frame, &index) == lpvg_can_event_accepted) {
            lpvg_bus_take(&self.signals, index, &frame);
        }
    }
}

// The message that stands worst; n_needed >= 1 by construction of the generated table.
const lpvg_bus_need_t& worst_need(const lpvg_ecu_t& self) {
    const lpvg_bus_need_t* worst = &lpvg_bus.needed[0];
    for (uint8_t i = 1U; i < lpvg_bus.n_needed; ++i) {
        const lpvg_bus_need_t* need = &lpvg_bus.needed[i];
        if (lpvg_can_state(&self.supervisor, need->index) < lpvg_can_state(&self.supervisor, worst->index)) {
            worst = need;
        }
    }
    return *worst;
}

// Why a message is not live: silence, unless frames came and were rejected lately; then the rejection seen most of.
lpvg_can_event_t main_reason(const lpvg_can_watch_t& watch) {
    if (watch.window_bad == 0U) {
        return lpvg_can_event_missed;
    }
    uint8_t reason = lpvg_can_event_early;
    for (uint8_t event = lpvg_can_event_length; event <= lpvg_can_event_gradient; ++event) {
        reason = watch.count[event] > watch.count[reason] ? event : reason;
    }
    return static_cast<lpvg_can_event_t>(reason);
}

// The gravest first.
constexpr lpvg_ecu_fault_t by_gravity[] = {
    lpvg_ecu_fault_corrupt,  lpvg_ecu_fault_refused,     lpvg_ecu_fault_time,   lpvg_ecu_fault_message,  lpvg_ecu_fault_invalid,
    lpvg_ecu_fault_actuator, lpvg_ecu_fault_implausible, lpvg_ecu_fault_locked, lpvg_ecu_fault_degraded, lpvg_ecu_fault_keyless};

bool has(const lpvg_ecu_t& self, lpvg_ecu_fault_t fault, lpvg_can_state_t supervision) {
    switch (fault) {
        case lpvg_ecu_fault_corrupt: return self.kept.corrupt;
        case lpvg_ecu_fault_refused: return self.refused;
        case lpvg_ecu_fault_time: return self.clock.pace == lpvg_ecu_pace_bad;
        // Before the bus has come up for the first time nothing is wrong yet.
        case lpvg_ecu_fault_message: return supervision != lpvg_can_state_live && self.seen_live;
        case lpvg_ecu_fault_invalid: return self.report.verdict == static_cast<uint8_t>(lpvg_verdict_invalid);
        case lpvg_ecu_fault_degraded: return self.report.verdict == static_cast<uint8_t>(lpvg_verdict_degraded);
        case lpvg_ecu_fault_actuator: return self.actuator_failed;
        case lpvg_ecu_fault_keyless: return !self.kept.config.authenticated;
        case lpvg_ecu_fault_implausible: return self.plausibility.flags != 0U;
        default: return self.kept.locked;
    }
}

lpvg_ecu_fault_t gravest(const lpvg_ecu_t& self, lpvg_can_state_t supervision) {
    for (const lpvg_ecu_fault_t fault : by_gravity) {
        if (has(self, fault, supervision)) {
            return fault;
        }
    }
    return lpvg_ecu_fault_none;
}

uint8_t mode_of(const lpvg_found_t* found) {
    switch (found == nullptr ? lpvg_cause_unknown : found->cause) {
        case lpvg_cause_other: return LPVG_CAN_FMI_ROOT_UNKNOWN;
        case lpvg_cause_gain:
        case lpvg_cause_sign: return LPVG_CAN_FMI_CALIBRATION;
        case lpvg_cause_delay: return LPVG_CAN_FMI_UPDATE_RATE;
        case lpvg_cause_bias: return found->value > Real(0) ? LPVG_CAN_FMI_DRIFTED_HIGH : LPVG_CAN_FMI_DRIFTED_LOW;
        case lpvg_cause_frozen: return LPVG_CAN_FMI_RATE_OF_CHANGE;
        case lpvg_cause_noise: return LPVG_CAN_FMI_ERRATIC;
        default: return LPVG_CAN_FMI_CONDITION;
    }
}

lpvg_can_dtc_t trouble_code(const lpvg_ecu_t& self, lpvg_ecu_fault_t fault, const lpvg_bus_need_t& need) {
    switch (fault) {
        case lpvg_ecu_fault_message: return {need.spn, lpvg_can_fmi(main_reason(self.supervisor.watch[need.index])), self.occurrence};
        case lpvg_ecu_fault_time: return {LPVG_ECU_SPN_TIME, LPVG_CAN_FMI_UPDATE_RATE, self.occurrence};
        case lpvg_ecu_fault_corrupt: return {LPVG_ECU_SPN_CORRUPT, LPVG_CAN_FMI_BAD_DEVICE, self.occurrence};
        case lpvg_ecu_fault_actuator: return {LPVG_ECU_SPN_ACTUATOR, LPVG_CAN_FMI_RESPONSE, self.occurrence};
        case lpvg_ecu_fault_locked: return {LPVG_ECU_SPN_LOCKED, LPVG_CAN_FMI_CONDITION, self.occurrence};
        case lpvg_ecu_fault_degraded: return {LPVG_ECU_SPN_DEGRADED, self.explained, self.occurrence};
        case lpvg_ecu_fault_invalid: return {LPVG_ECU_SPN_INVALID, self.explained, self.occurrence};
        case lpvg_ecu_fault_keyless: return {LPVG_ECU_SPN_KEYLESS, LPVG_CAN_FMI_CONDITION, self.occurrence};
        case lpvg_ecu_fault_implausible: return {LPVG_ECU_SPN_IMPLAUSIBLE, LPVG_CAN_FMI_ERRATIC, self.occurrence};
        default: return {LPVG_ECU_SPN_REFUSED, LPVG_CAN_FMI_ERRATIC, self.occurrence};
    }
}

// Whether the controller's speed is one that it was designed for.
void judge_speed(lpvg_ecu_t& self) {
    const lpvg_ecu_kept_t& r = self.kept;
    const lpvg_real_t beyond = self.in_range ? static_cast<lpvg_real_t>(LPVG_ECU_SPEED_HYSTERESIS_MPS) : lpvg_real_t(0);
    self.in_range = self.signals.speed >= r.speed_min - beyond && self.signals.speed <= r.speed_max + beyond;
}

// Whether the actuator of the first input does what was demanded up to the newest step, by its gain and by its distance. Nothing is
// compared without a measurement, while a message is missing, and until what was demanded meanwhile has died out; the means begin anew.
void judge_actuator(lpvg_ecu_t& self, bool live) {
    const lpvg_ecu_actuator_limits_t& limits = self.kept.config.actuator;
    const float period = static_cast<float>(self.kept.period_us) * 1e-6F;
    self.expected += (static_cast<float>(self.control.u[0]) - self.expected) * period / (limits.lag_s + period);
    self.live_us = live ? self.live_us : self.core_us;
    if (std::isnan(self.signals.measured) || self.core_us - self.live_us < int64_t{LPVG_ECU_ACTUATOR_US}) {
        self.expected_square = self.deviation_square = self.deviation_along = 0.0F;
        return;
    }
    const float deviation = self.signals.measured - self.expected;
    const float share = period / (1e-6F * static_cast<float>(LPVG_ECU_ACTUATOR_US) + period);
    self.expected_square += (self.expected * self.expected - self.expected_square) * share;
    self.deviation_square += (deviation * deviation - self.deviation_square) * share;
    self.deviation_along += (deviation * self.expected - self.deviation_along) * share;
    const float size = std::sqrt(self.expected_square), widest = size + limits.tolerance;
    const float along = (limits.relative * size + limits.tolerance) * size;
    const bool agrees = std::fabs(self.deviation_along) <= along && self.deviation_square <= widest * widest;
    self.actuator_failed = lpvg_can_confirm(&self.deviations, self.actuator_failed, !agrees, limits.confirm);
}

// Whether the loop has been engaged as often as it may in the last hour.
bool engaged_often(const lpvg_ecu_t& self) {
    uint32_t sum = 0U;
    for (const uint8_t engagements : self.engagements) {
        sum += engagements;
    }
    return sum >= LPVG_ECU_ENGAGEMENTS_MAX;
}

// The slot of now; a step moves by less than one.
void move_slot(lpvg_ecu_t& self) {
    if (self.core_us - self.slot_us >= int64_t{LPVG_ECU_SLOT_US}) {
        self.slot_us += int64_t{LPVG_ECU_SLOT_US};
        self.slot = static_cast<uint8_t>((self.slot + 1U) % LPVG_ECU_SLOTS);  // a power of two: within the ring after any damage
        self.engagements[self.slot] = 0U;
    }
}

// What an acknowledgement may not end: a cause that stands, or an invalid verdict that nothing speaks against. What the watch found is
// such a verdict: the response shows only while engaged.
bool stands(const lpvg_ecu_t& self) {
    const uint32_t measured = self.causes & ~static_cast<uint32_t>(self.kept.config.report_only);
    const bool calm = self.core_us - self.doubted_us >= int64_t{LPVG_ECU_CALM_US};
    return (measured & (LPVG_ECU_CAUSES_LATCHING & ~LPVG_ECU_CAUSE_INVALID)) != 0U || engaged_often(self) ||
           (self.kept.falsified && (self.kept.refuted || self.kept.on_trial || !calm));
}

void end_lock(lpvg_ecu_t& self) {
    if (!self.kept.locked || stands(self)) {
        return;
    }
    self.kept.locked = false;
    if (self.kept.falsified) {
        self.kept.falsified = false;
        self.kept.on_trial = true;
        self.trial_us = 0U;
        self.monitor.has_falsified = false;
    }
}

void take_request(lpvg_ecu_t& self) {
    const bool acknowledge = self.signals.request == static_cast<float>(LPVG_BUS_REQUEST_ACKNOWLEDGE);
    self.kept.standby = self.kept.standby || acknowledge || self.signals.request == static_cast<float>(LPVG_BUS_REQUEST_RELEASE);
    if (acknowledge && !self.acknowledging) {
        end_lock(self);
    }
    self.acknowledging = acknowledge;
}

// What the newest messages say of the driver and of the vehicle; a number that is not there permits nothing.
bool overridden(const lpvg_bus_signals_t& signals) {
    return !(signals.brake_pedal <= LPVG_ECU_PEDAL_PERCENT) || !(signals.abs_active <= 0.0F);
}

bool wanted(const lpvg_ecu_t& self) {
    return self.kept.standby && self.signals.request == static_cast<float>(LPVG_BUS_REQUEST_CONTROL) &&
           self.signals.other_priority <= static_cast<float>(self.kept.config.priority);
}

uint16_t causes_of(const lpvg_ecu_t& self, bool live) {
    const auto verdict = static_cast<lpvg_verdict_t>(self.report.verdict);
    const bool judged = verdict == lpvg_verdict_valid || verdict == lpvg_verdict_invalid || verdict == lpvg_verdict_not_judged ||
                        verdict == lpvg_verdict_degraded;
    uint32_t causes = self.kept.engage ? 0U : LPVG_ECU_CAUSE_NOT_ASKED;
    causes |= live ? 0U : LPVG_ECU_CAUSE_MESSAGE;
    causes |= self.refused ? LPVG_ECU_CAUSE_REFUSED : 0U;
    causes |= self.clock.pace == lpvg_ecu_pace_good ? 0U : LPVG_ECU_CAUSE_TIME;
    causes |= self.in_range ? 0U : LPVG_ECU_CAUSE_RANGE;
    causes |= overridden(self.signals) ? LPVG_ECU_CAUSE_OVERRIDE : 0U;
    causes |= wanted(self) ? 0U : LPVG_ECU_CAUSE_PERMISSION;
    causes |= self.actuator_failed ? LPVG_ECU_CAUSE_ACTUATOR : 0U;
    causes |= self.kept.corrupt ? LPVG_ECU_CAUSE_CORRUPT : 0U;
    causes |= judged ? 0U : LPVG_ECU_CAUSE_UNJUDGED;
    causes |= verdict == lpvg_verdict_invalid ? LPVG_ECU_CAUSE_INVALID : 0U;
    causes |= self.plausibility.flags != 0U ? LPVG_ECU_CAUSE_IMPLAUSIBLE : 0U;
    return static_cast<uint16_t>(causes);
}

void lock(lpvg_ecu_t& self, uint32_t causes) {
    self.kept.locked = true;
    self.lock_causes = static_cast<uint16_t>(causes);
}

// What ends an engagement voids the evidence, and locks if it must not come back by itself.
void note_release(lpvg_ecu_t& self, uint32_t causes) {
    lpvg_monitor_void(&self.monitor);
    if ((causes & ~LPVG_ECU_CAUSES_ORDINARY) != 0U) {
        const bool recent = self.core_us - self.released_us < LPVG_ECU_RELEASES_US;
        self.releases = static_cast<uint8_t>(recent ? self.releases + 1U : 1U);
        self.released_us = self.core_us;
    }
    if ((causes & LPVG_ECU_CAUSES_LATCHING) != 0U || self.releases > LPVG_ECU_RELEASES_MAX) {
        lock(self, causes);
    }
}

// Counts an engagement that begins; one too many locks instead. Returns whether it may begin.
bool may_begin(lpvg_ecu_t& self) {
    if (engaged_often(self)) {
        lock(self, LPVG_ECU_CAUSE_OFTEN);
        return false;
    }
    ++self.engagements[self.slot % LPVG_ECU_SLOTS];
    return true;
}

// Whether this step is engaged.
bool allowed(lpvg_ecu_t& self, bool live) {
    self.causes = causes_of(self, live);
    const uint32_t releasing = self.causes & ~static_cast<uint32_t>(self.kept.config.report_only);
    if (releasing != 0U && self.permitted) {
        note_release(self, releasing);
    }
    if (releasing != 0U && self.was_engaged) {
        self.caused_us = self.core_us;
    }
    // Without signs: a damaged time is long ago, so no loop waits for ever.
    const bool wait = static_cast<uint64_t>(self.core_us) - static_cast<uint64_t>(self.caused_us) < LPVG_ECU_WAIT_US;
    const bool unhindered = releasing == 0U && !wait && !self.kept.locked;
    const bool permitted = unhindered && (self.permitted || may_begin(self));
    const uint32_t more = (wait ? LPVG_ECU_CAUSE_WAIT : 0U) | (self.kept.locked ? LPVG_ECU_CAUSE_LOCKED : 0U) |
                          (!permitted && engaged_often(self) ? LPVG_ECU_CAUSE_OFTEN : 0U);
    self.causes = static_cast<uint16_t>(self.causes | more);
    self.permitted = permitted;
    self.was_engaged = self.was_engaged || self.permitted;
    return self.permitted;
}

Real largest_change(const lpvg_ecu_t& self, std::size_t input, uint32_t step) {
    const uint32_t longest_us = self.kept.period_us + self.kept.period_us / 2U;
    return self.kept.rate_max[input] * (static_cast<Real>(step < longest_us ? step : longest_us) * Real(1e-6));
}

// The demand goes to zero without controller. Where not even the kept values can be used it is zero already: restore cleared them.
void run_down(lpvg_ecu_t& self, uint32_t step) {
    for (std::size_t i = 0; i < LPVG_NU; ++i) {
        const Real before = self.kept.demand[i], change = largest_change(self, i, step);
        const Real left = before < Real(0) ? before + change : before - change;
        self.kept.demand[i] = self.control.u[i] = left * before > Real(0) ? left : Real(0);
    }
    self.control.engaged = false;
    self.permitted = false;
}

// Whether the controller's demands are within the kept limits. Rounding aside they always are.
bool demand_well(const lpvg_ecu_t& self, uint32_t step) {
    for (std::size_t i = 0; i < LPVG_NU; ++i) {
        const Real u = self.control.u[i], change = u - self.kept.demand[i];
        const Real most = Real(1.001) * largest_change(self, i, step), top = Real(1.001) * self.kept.u_max[i];
        if (!(u <= top && u >= -top && change <= most && change >= -most)) {
            return false;
        }
    }
    return true;
}

void run_controller(lpvg_ecu_t& self, bool live, uint32_t step) {
    lpvg_real_t m[LPVG_NM];
    m[0] = self.signals.reference;
    std::memcpy(&m[1], self.signals.y, sizeof self.signals.y);
    const lpvg_status_t status = lpvg_control_step_within(&self.control, self.signals.speed, m, allowed(self, live), step, self.share);
    if (demand_well(self, step)) {
        std::memcpy(self.kept.demand, self.control.u, sizeof self.kept.demand);
    } else {
        self.kept.corrupt = true;
        run_down(self, step);
    }
    // Before the first good frame there is nothing to measure, which is not a fault.
    self.refused = live && status != lpvg_status_ok;
}

// The monitor's verdict is about samples of the exported period: none is valid while that is not measured. A verdict that was invalid
// stays so until it is acknowledged.
uint8_t verdict(const lpvg_ecu_t& self, lpvg_verdict_t said) {
    if (self.kept.corrupt || self.clock.pace == lpvg_ecu_pace_bad) {
        return lpvg_verdict_fault;
    }
    if (self.kept.falsified) {
        return lpvg_verdict_invalid;
    }
    if (said != lpvg_verdict_valid && said != lpvg_verdict_degraded) {
        return static_cast<uint8_t>(said);
    }
    if (self.clock.pace == lpvg_ecu_pace_unknown) {
        return lpvg_verdict_unknown;
    }
    return static_cast<uint8_t>(self.in_range ? said : lpvg_verdict_not_judged);
}

bool invalid_releases(const lpvg_ecu_t& self) { return (self.kept.config.report_only & LPVG_ECU_CAUSE_INVALID) == 0U; }

// Share of the demand's limit that needs no evidence.
Real least_share(const lpvg_ecu_t& self) { return invalid_releases(self) ? static_cast<Real>(LPVG_ECU_PROBE_SHARE) : Real(1); }

// Evidence widens the demand's limit steadily, and without evidence a limit that the demand does not reach narrows. A demand that rests at
// the limit without evidence widens it by a step, which the watch can judge.
void widen_demand(lpvg_ecu_t& self, uint32_t step) {
    const bool pressed = self.control.limited != self.limited;
    self.limited = self.control.limited;
    self.pressed_us = pressed && !self.watch.evidence ? self.pressed_us + step : 0U;
    const Real range = (Real(1) - static_cast<Real>(LPVG_ECU_PROBE_SHARE)) * static_cast<Real>(step), least = least_share(self);
    Real share = self.share;
    if (self.watch.evidence) {
        share += range / static_cast<Real>(LPVG_ECU_PROBE_US);
    } else if (!pressed) {
        share -= range / static_cast<Real>(LPVG_ECU_AGE_US);
    } else if (self.pressed_us >= LPVG_ECU_PROBE_US) {
        share += static_cast<Real>(LPVG_ECU_PROBE_SHARE);
        self.pressed_us = 0U;
    }
    share = share > least ? share : least;
    self.share = share < Real(1) ? share : Real(1);
}

// The watch follows the demand in every step. It sums while the demand acts, from LPVG_ECU_SETTLE_US after the newest gap on. Behind a gap
// of the clock, and while the model is falsified, it starts anew. An engagement begins with a share of the demand's limit, which evidence
// raises.
void watch_response(lpvg_ecu_t& self, bool sampled, uint32_t step) {
    const bool paced = self.clock.pace != lpvg_ecu_pace_unknown;
    const bool settled = self.settled_us >= LPVG_ECU_SETTLE_US;
    if (paced && !self.kept.falsified && !self.kept.corrupt) {
        lpvg_watch_take(&self.watch, &self.kept.watch, self.kept.coeff, &self.monitor.model, settled, sampled ? self.signals.y : nullptr,
                        self.control.u);
    } else {
        lpvg_watch_start(&self.watch, &self.monitor.model);
    }
    self.settled_us = paced && sampled ? self.settled_us + (settled ? 0U : step) : 0U;
    if (sampled && self.control.engaged) {
        widen_demand(self, step);
    } else {
        lpvg_watch_void(&self.watch);
        self.share = least_share(self);
    }
}

// A falsified model stays so until it is acknowledged, and locks. Time without doubt begins with the release. A trial ends with a valid
// verdict, or with evidence of the watch for as long as its acknowledgement asked for.
void judge_falsified(lpvg_ecu_t& self, lpvg_verdict_t said, bool live, uint32_t step) {
    const bool anew = self.monitor.has_falsified && self.monitor.t_falsified_us > self.doubted_us;
    if (!live || self.control.engaged || anew) {
        self.doubted_us = self.core_us;
    }
    if (invalid_releases(self) && (said == lpvg_verdict_invalid || self.watch.violated)) {
        self.kept.falsified = true;
        self.kept.refuted = self.kept.refuted || self.watch.violated;
        self.kept.locked = true;
        self.lock_causes = static_cast<uint16_t>(self.lock_causes | LPVG_ECU_CAUSE_INVALID);
    }
    if (self.kept.on_trial && self.control.engaged) {
        self.trial_us += self.watch.evidence ? step : 0U;
        self.kept.on_trial = said != lpvg_verdict_valid && self.trial_us < LPVG_ECU_CALM_US;
    }
}

// A gap is what the monitor expects where measurements are old, or of another period: it restarts behind it.
void run_monitor(lpvg_ecu_t& self, bool live, uint32_t step) {
    bool sampled = false;
    if (live && self.clock.pace != lpvg_ecu_pace_bad && !self.kept.corrupt) {
        lpvg_sample_t sample{};
        sample.t_us = self.core_us;
        sample.speed = self.signals.speed;
        std::memcpy(sample.u, self.control.u, sizeof sample.u);
        std::memcpy(sample.y, self.signals.y, sizeof sample.y);
        sampled = lpvg_monitor_push(&self.monitor, &sample) == lpvg_status_ok;
        self.refused = self.refused || !sampled;
    }
    // Damage may have hit the monitor's pointer to its coefficients.
    const lpvg_verdict_t said = self.kept.corrupt ? lpvg_verdict_fault : lpvg_monitor_verdict(&self.monitor, self.core_us);
    watch_response(self, sampled, step);
    judge_falsified(self, said, live, step);
    self.report.verdict = verdict(self, said);
    self.report.statistic = static_cast<float>(lpvg_monitor_frame(&self.monitor)->statistic);
}

}  // namespace

extern "C" lpvg_status_t lpvg_ecu_init(lpvg_ecu_t* self, const lpvg_coeff_t* coeff, const lpvg_control_coeff_t* control,
                                       const lpvg_ecu_config_t* config, int64_t now_us) {
    if (self == nullptr || config == nullptr || now_us < 0 || now_us > INT64_MAX / 2 ||
        (config->report_only & ~LPVG_ECU_CAUSES_OPTIONAL) != 0U || config->priority > priority_max || !limits_good(config->plausibility)) {
        return lpvg_status_bad_argument;
    }
    lpvg_status_t status = lpvg_coeff_check(coeff);
    if (status == lpvg_status_ok) {
        status = lpvg_control_coeff_check(control);
    }
    if (status == lpvg_status_ok &&
        (coeff->words.sample_period_us != control->words.sample_period_us || coeff->words.sample_period_us > period_longest_us)) {
        status = lpvg_status_bad_value;
    }
    if (status != lpvg_status_ok) {
        return status;
    }
    if (!actuator_limits_good(config->actuator, largest_limit(*control, 0U))) {
        return lpvg_status_bad_argument;
    }
    std::memset(self, 0, sizeof *self);
    self->kept.config = *config;
    self->kept.engage = config->engage;
    self->kept.period_us = coeff->words.sample_period_us;
    self->kept.now_us = self->now_us = self->core_us = now_us;
    self->kept.coeff = coeff;
    self->kept.control = control;
    for (std::size_t i = 0; i < LPVG_NU; ++i) {
        self->kept.rate_max[i] = control->reals.rate_max[i];
        self->kept.u_max[i] = largest_limit(*control, i);
    }
    self->kept.speed_min = control->reals.speed_min;
    self->kept.speed_max = control->reals.speed_max;
    lpvg_watch_limits(&self->kept.watch, coeff);
    self->share = least_share(*self);
    self->dm1_us = now_us - dm1_period_us;
    self->caused_us = now_us - LPVG_ECU_WAIT_US;
    self->slot_us = self->doubted_us = now_us;
    self->explained = LPVG_CAN_FMI_CONDITION;
    self->signals.speed = self->signals.reference = static_cast<lpvg_real_t>(NAN);
    for (lpvg_real_t& y : self->signals.y) {
        y = static_cast<lpvg_real_t>(NAN);
    }
    self->signals.yaw_rate = self->signals.lateral = self->signals.wheel_difference = NAN;
    self->signals.brake_pedal = self->signals.abs_active = self->signals.measured = NAN;
    self->signals.request = self->signals.other_priority = NAN;
    lpvg_monitor_begin(&self->monitor, coeff);
    lpvg_control_begin(&self->control, control);
    status = lpvg_can_init(&self->supervisor, lpvg_bus.rules, lpvg_bus.n_rules, now_us);  // generated rules
    keep(*self);
    return status;
}

extern "C" void lpvg_ecu_engage(lpvg_ecu_t* self, bool engage) {
    if (self != nullptr && kept_well(*self)) {
        self->kept.engage = engage;
        keep(*self);
    }
}

extern "C" void lpvg_ecu_explain(lpvg_ecu_t* self, const lpvg_found_t* found) {
    if (self != nullptr) {
        self->explained = mode_of(found);
    }
}

extern "C" bool lpvg_ecu_acknowledge(lpvg_ecu_t* self) {
    if (self == nullptr || !kept_well(*self)) {
        return false;
    }
    end_lock(*self);
    keep(*self);
    return !self->kept.locked;
}

extern "C" lpvg_status_t lpvg_ecu_step(lpvg_ecu_t* self, int64_t now_us, const lpvg_can_frame_t* frames_in, size_t n_in,
                                       lpvg_can_frame_t* frames_out, size_t max_out, size_t* n_out) {
    if (n_out != nullptr) {
        *n_out = 0U;
    }
    if (self == nullptr || (frames_in == nullptr && n_in > 0U) || frames_out == nullptr || n_out == nullptr ||
        max_out < LPVG_ECU_FRAMES_OUT) {
        return lpvg_status_bad_argument;
    }
    if (self->kept.period_us == 0U && self->inverted[0] == 0U) {
        return lpvg_status_not_ready;
    }
    const bool kept = kept_well(*self);
    const bool usable = kept || rescue(*self);
    if (!kept || (!self->kept.corrupt && !state_well(*self))) {
        restore(*self, usable);
    }
    const uint32_t step = step_us(*self, now_us);
    if (step == 0U) {
        return lpvg_status_out_of_order;
    }
    tick(*self, now_us, step);
    if (!self->kept.corrupt) {
        self->kept.corrupt = !coefficients_well(*self);
    }
    receive(*self, frames_in, n_in);
    lpvg_can_advance(&self->supervisor, self->core_us);
    move_slot(*self);
    const lpvg_bus_need_t& need = worst_need(*self);
    const lpvg_can_state_t supervision = lpvg_can_state(&self->supervisor, need.index);
    const bool live = supervision == lpvg_can_state_live;
    self->seen_live = self->seen_live || live;

    if (live) {
        judge_speed(*self);
        // The limits have been checked by init.
        (void)(lpvg_can_plausibility(&self->plausibility, &self->kept.config.plausibility, self->signals.yaw_rate, self->signals.lateral,
                                     static_cast<float>(self->signals.speed), self->signals.wheel_difference) == lpvg_status_ok);
    }
    judge_actuator(*self, live);
    take_request(*self);
    if (self->kept.corrupt) {
        self->causes = causes_of(*self, live);
        run_down(*self, step);
        self->refused = false;
    } else {
        run_controller(*self, live, step);
    }
    run_monitor(*self, live, step);
    self->report.demand = static_cast<float>(self->kept.demand[0]);
    self->report.authenticated = self->kept.config.authenticated ? 1U : 0U;
    const lpvg_ecu_engagement_t released = self->kept.locked ? lpvg_ecu_locked : lpvg_ecu_released;
    self->report.engagement = static_cast<uint8_t>(self->control.engaged ? lpvg_ecu_engaged : released);
    self->report.supervision = static_cast<uint8_t>(self->refused ? lpvg_can_state_off : supervision);

    const lpvg_ecu_fault_t before = self->fault;
    self->fault = gravest(*self, supervision);
    if (self->fault != before && self->fault != lpvg_ecu_fault_none) {
        self->occurrence = static_cast<uint8_t>(self->occurrence + (self->occurrence < occurrence_max ? 1U : 0U));
    }
    lpvg_can_frame_t* out = frames_out;
    out->t_us = now_us;
    out += lpvg_bus_pack_report(&self->report, out, &self->counter) == lpvg_status_ok ? 1 : 0;
    if (self->core_us - self->dm1_us >= dm1_period_us) {
        const lpvg_can_dtc_t dtc = trouble_code(*self, self->fault, need);
        const bool active = self->fault != lpvg_ecu_fault_none;
        out->t_us = now_us;
        const auto lamps = static_cast<uint8_t>(active ? LPVG_CAN_LAMP_AMBER : 0U);
        out += lpvg_can_dm1_pack(out, lpvg_bus.own_address, lamps, active ? &dtc : nullptr) == lpvg_status_ok ? 1 : 0;
        self->dm1_us = self->core_us;
    }
    keep(*self);
    *n_out = static_cast<std::size_t>(out - frames_out);
    return lpvg_status_ok;
}

extern "C" lpvg_status_t lpvg_ecu_findings(const lpvg_ecu_t* self, lpvg_j1939_findings_t* findings) {
    if (self == nullptr || findings == nullptr) {
        return lpvg_status_bad_argument;
    }
    if (self->kept.period_us == 0U) {
        return lpvg_status_not_ready;
    }
    std::memset(findings, 0, sizeof *findings);
    const uint32_t newest = self->monitor.n_records - 1U;
    const auto said = static_cast<lpvg_verdict_t>(self->report.verdict);
    const bool alarming = said == lpvg_verdict_invalid || said == lpvg_verdict_degraded;
    const bool recorded = alarming && newest < LPVG_NRECORDS;
    const lpvg_frame_t& frame = recorded ? self->monitor.record[newest] : self->monitor.frame;
    findings->freeze.t_us = self->kept.now_us;
    findings->freeze.statistic = static_cast<float>(frame.statistic);
    findings->freeze.speed = static_cast<float>(self->signals.speed);
    findings->freeze.causes = self->causes;
    findings->freeze.bin = static_cast<uint8_t>(frame.bin);
    findings->freeze.test = static_cast<uint8_t>(frame.test);
    for (const lpvg_ecu_fault_t fault : by_gravity) {
        const uint8_t n_needs = fault == lpvg_ecu_fault_message ? lpvg_bus.n_needed : 1U;
        for (uint8_t i = 0U; i < n_needs; ++i) {
            const lpvg_bus_need_t& need = lpvg_bus.needed[i];
            if (has(*self, fault, lpvg_can_state(&self->supervisor, need.index))) {
                findings->code[findings->n_codes] = trouble_code(*self, fault, need);
                ++findings->n_codes;
            }
        }
    }
    return lpvg_status_ok;
}

#endif
