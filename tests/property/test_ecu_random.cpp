// Random drives of the guarded controller. An oracle that is written from ecu.h and can.h, and that knows the frames and the times of
// the calls only, says of every step whether it is taken, what supervision it has, which causes it names, and whether it is engaged or
// locked. The verdict is the ECU's own; what must hold of it:
//
//     valid only in the range, with a good sample period, with samples of the newest five periods, and no sooner than the shortest frame
//     after the newest release, gap or missing message; fault with a bad period; invalid until acknowledged
//
// The demand keeps its limits. Every other drive has trouble seldom, so that the monitor gets to judge. 10^6 steps; 10^7 with
// LPVGUARD_FULL=1.
#include "../long_form.hpp"
#include "../unit/control_limits.hpp"
#include "../unit/ecu_bench.hpp"

#include <deque>
#include <random>
#include <string>

namespace {

constexpr int64_t half_period_us = tick_us / 2;
constexpr int steps_an_episode = 20'000;

// Supervision of one message, by the table of can.h.
class Message {
public:
    explicit Message(uint8_t index) : rule_(lpvg_can_rules[index]) {}

    void pass(int64_t t_us) {
        const int64_t twice_age_us = 2 * (t_us - good_us_), period_us = rule_.period_us;
        if (twice_age_us > (2 * LPVG_CAN_OFF_MISSED + 1) * period_us) {
            go_off();
        } else if (twice_age_us > (2 * LPVG_CAN_HOLD_MISSED + 1) * period_us && state == lpvg_can_state_live) {
            state = lpvg_can_state_hold;
        }
    }

    // A frame of it, with all its values there or not. Returns whether it may be used.
    bool take(const lpvg_can_frame_t& frame, int64_t t_us, bool complete) {
        out_of_step_ = false;
        const int counter_before = counter_;
        const bool soon = arrived_ && t_us - arrival_us_ < rule_.gap_min_us;
        count_arrival(t_us);
        arrived_ = true;
        arrival_us_ = t_us;
        const bool good = !soon && !fast_ && protection_good(frame) && complete;
        score_ = good ? std::max(0, score_ - 1) : std::min<int>(LPVG_CAN_SCORE_OFF, score_ + 1);
        if (!good) {
            foreign_ =
                std::min<int>(LPVG_CAN_FOREIGN_OFF, foreign_ + (foreign(frame, soon || fast_, counter_before) ? LPVG_CAN_FOREIGN_ADD : 0));
            in_row_ = 0;
            bad_.push_back(true);
            trim();
            if (fast_ || score_ == LPVG_CAN_SCORE_OFF || foreign_ == LPVG_CAN_FOREIGN_OFF ||
                std::count(bad_.begin(), bad_.end(), true) >= LPVG_CAN_WINDOW_BAD) {
                go_off();
            }
            return false;
        }
        good_us_ = t_us;
        if (state == lpvg_can_state_off) {
            if (++in_row_ < static_cast<int>(LPVG_CAN_RECOVER_FRAMES)) {
                return false;
            }
            score_ = foreign_ = 0;
            bad_.clear();
        } else {
            foreign_ = std::max(0, foreign_ - 1);
            bad_.push_back(false);
            trim();
        }
        state = lpvg_can_state_live;
        return true;
    }

    void go_off() {
        state = lpvg_can_state_off;
        in_row_ = 0;
        counter_ = -1;
        bad_.clear();
    }

    lpvg_can_state_t state = lpvg_can_state_off;

private:
    // Of every eighth arrival whether as many took less than 6 periods, and of the 64th after the newest such burst whether they took less
    // than 58.
    void count_arrival(int64_t t_us) {
        arrivals_us_.push_back(t_us);
        const std::size_t n = arrivals_us_.size() - 1U;
        const auto faster = [&](std::size_t begin, int64_t periods) {
            return t_us - arrivals_us_[begin] < periods * static_cast<int64_t>(rule_.period_us);
        };
        if (n > 0U && n % LPVG_CAN_ARRIVALS == 0U) {
            short_fast_ = faster(n - LPVG_CAN_ARRIVALS, LPVG_CAN_ARRIVALS_PERIODS);
            long_fast_ = long_fast_ && !short_fast_;
            rate_begin_ = short_fast_ ? n : rate_begin_;
        }
        if (n - rate_begin_ == LPVG_CAN_RATE_ARRIVALS) {
            long_fast_ = faster(rate_begin_, LPVG_CAN_RATE_PERIODS);
            rate_begin_ = n;
        }
        fast_ = short_fast_ || long_fast_;
    }

    // A second frame with one counter, sooner behind the good one than a sender repeats.
    bool foreign(const lpvg_can_frame_t& frame, bool early, int counter) const {
        const bool soon = arrival_us_ - good_us_ < int64_t{3} * rule_.period_us / 4;
        return rule_.e2e != 0U && counter == frame.data[1] % 16 && soon && (early || out_of_step_);
    }

    bool protection_good(const lpvg_can_frame_t& frame) {
        uint8_t counter = 0U;
        if (rule_.e2e == 0U) {
            return true;
        }
        if (lpvg_can_e2e_check(&frame, rule_.e2e_data_id, &counter) != lpvg_status_ok) {
            return false;
        }
        const int step = counter_ < 0 ? 1 : (counter + 15 - counter_) % 15;
        counter_ = counter;
        out_of_step_ = step < 1 || step > static_cast<int>(LPVG_CAN_COUNTER_STEP);
        return !out_of_step_;
    }

    void trim() {
        if (bad_.size() > LPVG_CAN_WINDOW) {
            bad_.pop_front();
        }
    }

    const lpvg_can_rule_t& rule_;
    int64_t good_us_ = 0, arrival_us_ = 0;
    std::vector<int64_t> arrivals_us_;
    std::size_t rate_begin_ = 0U;
    int score_ = 0, foreign_ = 0, in_row_ = 0, counter_ = -1;
    bool arrived_ = false, fast_ = false, short_fast_ = false, long_fast_ = false, out_of_step_ = false;
    std::deque<bool> bad_;
};

// What a step must be. Its configuration is the bench's; init was at time 0.
class Oracle {
public:
    // A call at a time of the steps' clock, with the verdict and the demand of the newest step.
    void call(int64_t now_us, const std::vector<lpvg_can_frame_t>& frames, float verdict, float demand) {
        const int64_t step = step_us(now_us);
        taken = step > 0;
        if (!taken) {
            return;
        }
        elapsed_us = step;
        now_us_ = now_us;
        in_step_ = 0;
        core_us_ = times_.empty() ? now_us : core_us_ + step;
        measure(step);
        receive(frames);
        state = std::min(std::min(vdc2_.state, guard_in_.state), std::min(ebc1_.state, ebc2_.state));
        lagged_ += (demand - lagged_) * 0.01F / (bench_config.actuator.lag_s + 0.01F);
        if (state == lpvg_can_state_live) {
            judge();
            newest_live_us_ = core_us_;
        } else {
            not_live_us_ = void_us_ = core_us_;
        }
        if (core_us_ - not_live_us_ < LPVG_ECU_ACTUATOR_US) {
            along_ = off_ = size_ = 0.0F;
        }
        void_us_ = in_pace(step) ? void_us_ : core_us_;
        take_request();
        const bool before = engaged;
        decide(verdict);
        void_us_ = before && !engaged ? core_us_ : void_us_;
    }

    // What the tests of the step said: its verdict, whether the monitor alone finds the model valid, its newest falsification, and what the
    // watch says.
    void hear(lpvg_verdict_t reported, bool valid, int64_t falsified_us, bool evidence, bool violated) {
        if (state != lpvg_can_state_live || engaged || falsified_us > doubted_us_) {
            doubted_us_ = core_us_;
        }
        falsified_ = falsified_ || reported == lpvg_verdict_invalid;
        refuted_ = refuted_ || violated;
        locked = locked || falsified_;
        if (engaged) {
            proved_us_ += on_trial_ && evidence ? elapsed_us : 0;
            on_trial_ = on_trial_ && !valid && proved_us_ < int64_t{LPVG_ECU_CALM_US};
        }
    }

    void ask(bool engage) { asked_ = engage; }

    void acknowledge() {
        const bool refuted = falsified_ && (refuted_ || on_trial_ || core_us_ - doubted_us_ < LPVG_ECU_CALM_US);
        if (locked && (causes & (LPVG_ECU_CAUSE_IMPLAUSIBLE | LPVG_ECU_CAUSE_ACTUATOR)) == 0U && !refuted && !often()) {
            locked = false;
            on_trial_ = on_trial_ || falsified_;
            proved_us_ = falsified_ ? 0 : proved_us_;
            falsified_ = false;
        }
    }

    // Whether nothing forbids the verdict `valid`.
    bool may_be_valid() const {
        const int64_t shortest = *std::min_element(lpvg_coeff.words.frame_length, lpvg_coeff.words.frame_length + LPVG_NBINS);
        return pace == lpvg_ecu_pace_good && in_range_ && !falsified_ && core_us_ - newest_live_us_ <= 5 * tick_us &&
               core_us_ - void_us_ >= (shortest - 1) * tick_us;  // n samples from the step of the release on
    }
    bool must_be_invalid() const { return falsified_ && pace != lpvg_ecu_pace_bad; }

    bool taken = false, engaged = false, locked = false;
    lpvg_can_state_t state = lpvg_can_state_off;
    lpvg_ecu_pace_t pace = lpvg_ecu_pace_unknown;
    uint32_t causes = 0U;
    int64_t elapsed_us = 0;

private:
    static bool in_pace(int64_t step) { return step >= half_period_us && step <= 3 * half_period_us; }

    int64_t step_us(int64_t now_us) {
        if (times_.empty()) {
            return now_us >= 0 ? tick_us : 0;
        }
        const int64_t step = now_us - now_us_;
        if (step >= half_period_us && step <= LPVG_ECU_JUMP_US) {
            return step;
        }
        in_step_ = in_pace(now_us - refused_us_) ? in_step_ + 1 : 1;
        refused_us_ = now_us;
        return in_step_ >= static_cast<int>(LPVG_ECU_RESYNC_CALLS) ? LPVG_ECU_JUMP_US : 0;
    }

    // The mean over the newest second, every half second; over half of it where there is no more since the newest gap.
    void measure(int64_t step) {
        constexpr std::size_t half = LPVG_ECU_WINDOW_US / 2U / tick_us;
        if (!in_pace(step)) {
            times_.clear();
            pace = lpvg_ecu_pace_unknown;
        }
        times_.push_back(core_us_);
        const std::size_t steps = times_.size() - 1U;
        if (steps == 0U || steps % half != 0U) {
            return;
        }
        const std::size_t over = std::min(steps, 2U * half);
        const int64_t wanted = static_cast<int64_t>(over) * tick_us, is = times_[steps] - times_[steps - over];
        pace = 100 * std::abs(is - wanted) <= LPVG_ECU_PERIOD_PERCENT * wanted ? lpvg_ecu_pace_good : lpvg_ecu_pace_bad;
    }

    void receive(const std::vector<lpvg_can_frame_t>& frames) {
        const std::size_t n = frames.size(), first = n > LPVG_ECU_FRAMES_IN ? n - LPVG_ECU_FRAMES_IN : 0U;
        for (std::size_t i = first; i < n; ++i) {
            const int64_t t_us = std::max(int64_t{0}, core_us_ - std::max(int64_t{0}, now_us_ - frames[i].t_us));
            if (t_us < bus_us_ - LPVG_CAN_REORDER_US) {
                continue;
            }
            pass(t_us);
            take(frames[i], t_us);
        }
        pass(core_us_);
    }

    void pass(int64_t t_us) {
        bus_us_ = std::max(bus_us_, t_us);
        for (Message* message : {&vdc2_, &guard_in_, &ebc1_, &ebc2_}) {
            message->pass(bus_us_);
        }
    }

    void take(const lpvg_can_frame_t& frame, int64_t t_us) {
        if ((frame.id & LPVG_CAN_ERROR) != 0U) {
            for (Message* message : {&vdc2_, &guard_in_, &ebc1_, &ebc2_}) {
                message->go_off();
            }
        } else if (frame.id == LPVG_CAN_VDC2_ID) {
            lpvg_can_vdc2_t vdc2{};
            REQUIRE(lpvg_can_vdc2_unpack(&vdc2, &frame) == lpvg_status_ok);
            float yaw_rate = NAN;
            const bool there = lpvg_can_decode(&lpvg_can_vdc2_yaw_rate, vdc2.yaw_rate, &yaw_rate) == lpvg_can_quality_good;
            if (vdc2_.take(frame, t_us, there)) {
                yaw_rate_ = yaw_rate;
                (void)lpvg_can_decode(&lpvg_can_vdc2_lateral_acceleration, vdc2.lateral_acceleration, &lateral_);
            }
        } else if (frame.id == LPVG_CAN_GUARD_IN_ID) {
            lpvg_can_guard_in_t guard{};
            REQUIRE(lpvg_can_guard_in_unpack(&guard, &frame) == lpvg_status_ok);
            if (guard_in_.take(frame, t_us, true)) {
                (void)lpvg_can_decode(&lpvg_can_guard_in_dp_measured, guard.dp_measured, &pressure_);
                request_ = guard.control_request;
                other_priority_ = guard.other_priority;
            }
        } else if (frame.id == LPVG_CAN_EBC1_ID) {
            lpvg_can_ebc1_t ebc1{};
            REQUIRE(lpvg_can_ebc1_unpack(&ebc1, &frame) == lpvg_status_ok);
            if (ebc1_.take(frame, t_us, true)) {
                (void)lpvg_can_decode(&lpvg_can_ebc1_brake_pedal_position, ebc1.brake_pedal_position, &pedal_);
                abs_ = ebc1.abs_active != 0U;
            }
        } else {
            lpvg_can_ebc2_t ebc2{};
            REQUIRE(lpvg_can_ebc2_unpack(&ebc2, &frame) == lpvg_status_ok);
            if (ebc2_.take(frame, t_us, true)) {
                float kmh = NAN;
                (void)lpvg_can_decode(&lpvg_can_ebc2_front_axle_speed, ebc2.front_axle_speed, &kmh);
                speed_ = static_cast<lpvg_real_t>(kmh) * lpvg_real_t(1.0 / 3.6);
            }
        }
    }

    // Violations minus agreements reach `confirm`, or have not been back at 0 since they did.
    static bool failed(int& score, bool before, bool violation, int confirm) {
        score = violation ? std::min(confirm, score + 1) : std::max(0, score - 1);
        return score == confirm || (before && score > 0);
    }

    // Engagements of the slot of now and of the fifteen before.
    bool often() const {
        constexpr int64_t slot_us = LPVG_ECU_SLOT_US;
        const auto counts = [this](int64_t begin_us) { return core_us_ / slot_us - begin_us / slot_us < int64_t{LPVG_ECU_SLOTS}; };
        return std::count_if(begins_.begin(), begins_.end(), counts) >= int64_t{LPVG_ECU_ENGAGEMENTS_MAX};
    }

    void judge() {
        const lpvg_control_reals_t& r = lpvg_control_coeff.reals;
        const auto beyond = static_cast<lpvg_real_t>(in_range_ ? LPVG_ECU_SPEED_HYSTERESIS_MPS : 0.0F);
        in_range_ = speed_ >= r.speed_min - beyond && speed_ <= r.speed_max + beyond;
        // In the numbers of the core: where a violation begins, rounding decides.
        const lpvg_ecu_actuator_limits_t& actuator = bench_config.actuator;
        if (core_us_ - not_live_us_ >= LPVG_ECU_ACTUATOR_US) {
            const float share = 0.01F / (1e-6F * static_cast<float>(LPVG_ECU_ACTUATOR_US) + 0.01F), off = pressure_ - lagged_;
            size_ += (lagged_ * lagged_ - size_) * share;
            off_ += (off * off - off_) * share;
            along_ += (off * lagged_ - along_) * share;
            const float rms = std::sqrt(size_), widest = rms + actuator.tolerance;
            const bool violation = std::fabs(along_) > (actuator.relative * rms + actuator.tolerance) * rms || off_ > widest * widest;
            actuator_failed_ = failed(deviations_, actuator_failed_, violation, actuator.confirm);
        }
        if (speed_ >= lpvg_real_t(bench_config.plausibility.speed_min_mps)) {
            const float off = yaw_rate_ * static_cast<float>(speed_) - lateral_;
            const bool violation = std::fabs(off) > bench_config.plausibility.lateral_mps2;
            implausible_ = failed(contradictions_, implausible_, violation, bench_config.plausibility.confirm);
        }
    }

    void take_request() {
        const bool now = request_ == LPVG_BUS_REQUEST_ACKNOWLEDGE;
        standby_ = standby_ || now || request_ == LPVG_BUS_REQUEST_RELEASE;
        if (now && !acknowledging_) {
            acknowledge();
        }
        acknowledging_ = now;
    }

    void decide(float verdict) {
        const auto is = [verdict](lpvg_verdict_t one) { return verdict == static_cast<float>(one); };
        const bool wanted = standby_ && request_ == LPVG_BUS_REQUEST_CONTROL && other_priority_ == 0;
        causes = 0U;
        name(!asked_, LPVG_ECU_CAUSE_NOT_ASKED);
        name(state != lpvg_can_state_live, LPVG_ECU_CAUSE_MESSAGE);
        name(pace != lpvg_ecu_pace_good, LPVG_ECU_CAUSE_TIME);
        name(!in_range_, LPVG_ECU_CAUSE_RANGE);
        name(!(pedal_ <= LPVG_ECU_PEDAL_PERCENT) || abs_, LPVG_ECU_CAUSE_OVERRIDE);
        name(!wanted, LPVG_ECU_CAUSE_PERMISSION);
        name(actuator_failed_, LPVG_ECU_CAUSE_ACTUATOR);
        name(is(lpvg_verdict_unknown) || is(lpvg_verdict_stale) || is(lpvg_verdict_fault), LPVG_ECU_CAUSE_UNJUDGED);
        name(is(lpvg_verdict_invalid), LPVG_ECU_CAUSE_INVALID);
        name(implausible_, LPVG_ECU_CAUSE_IMPLAUSIBLE);
        if (engaged && causes != 0U) {
            if ((causes & ~LPVG_ECU_CAUSES_ORDINARY) != 0U) {
                releases_ = core_us_ - released_us_ < LPVG_ECU_RELEASES_US ? releases_ + 1 : 1;
                released_us_ = core_us_;
            }
            locked = locked || (causes & LPVG_ECU_CAUSES_LATCHING) != 0U || releases_ > static_cast<int>(LPVG_ECU_RELEASES_MAX);
        }
        if (was_engaged_ && causes != 0U) {
            caused_us_ = core_us_;
        }
        name(core_us_ - caused_us_ < LPVG_ECU_WAIT_US, LPVG_ECU_CAUSE_WAIT);
        const bool begins = !engaged && causes == 0U && !locked;
        locked = locked || (begins && often());
        name(locked, LPVG_ECU_CAUSE_LOCKED);
        engaged = causes == 0U;
        name(!engaged && often(), LPVG_ECU_CAUSE_OFTEN);
        if (begins && engaged) {
            begins_.push_back(core_us_);
        }
        was_engaged_ = was_engaged_ || engaged;
    }

    void name(bool there, uint32_t cause) { causes |= there ? cause : 0U; }

    Message vdc2_{LPVG_CAN_VDC2_INDEX}, guard_in_{LPVG_CAN_GUARD_IN_INDEX}, ebc1_{LPVG_CAN_EBC1_INDEX}, ebc2_{LPVG_CAN_EBC2_INDEX};
    std::vector<int64_t> times_;  // of the steps since the newest gap
    int64_t now_us_ = 0, core_us_ = 0, bus_us_ = 0, refused_us_ = 0, newest_live_us_ = 0;
    int64_t released_us_ = -int64_t{LPVG_ECU_RELEASES_US}, caused_us_ = -int64_t{LPVG_ECU_WAIT_US};
    int in_step_ = 0, releases_ = 0, deviations_ = 0, contradictions_ = 0, request_ = -1, other_priority_ = -1;
    int64_t not_live_us_ = 0, void_us_ = 0, doubted_us_ = 0, proved_us_ = 0;
    std::vector<int64_t> begins_;  // of engagements
    float yaw_rate_ = NAN, lateral_ = NAN, pressure_ = NAN, pedal_ = NAN, lagged_ = 0.0F, along_ = 0.0F, off_ = 0.0F, size_ = 0.0F;
    lpvg_real_t speed_ = lpvg_real_t(NAN);
    bool asked_ = true, standby_ = false, acknowledging_ = false, in_range_ = false, was_engaged_ = false, abs_ = true;
    bool actuator_failed_ = false, implausible_ = false, falsified_ = false, refuted_ = false, on_trial_ = false;
};

// What goes wrong, for how long. Several at once, or none for a while.
enum Trouble {
    vdc2_lost,
    guard_in_lost,
    ebc1_lost,
    ebc2_lost,
    checksums_wrong,
    every_other_checksum_wrong,
    other_sender,
    yaw_rate_absent,
    driver_brakes,
    abs_acts,
    not_requested,
    other_command,
    out_of_range,
    sensors_contradict,
    brakes_stuck,
    gain_lost,
    period_off,
    jitters,
    not_asked,
    n_troubles
};

// A vehicle on the road, its bus and its clock, by chance.
class Drive {
public:
    explicit Drive(unsigned seed) : random_(seed), seldom_(seed % 2U == 0U) {
        const lpvg_real_t nothing[LPVG_NY] = {};
        lpvg_model_start(&vehicle_, &lpvg_coeff, nothing, nothing);
        bench_.answers = false;
    }

    // Everything up to the next call, and the call. False where the ECU is not what the oracle says.
    bool step() {
        draw();
        move();
        const bool engage = !has(not_asked);
        lpvg_ecu_engage(&bench_.ecu, engage);
        oracle_.ask(engage);
        if (chance(2'000)) {
            CHECK(lpvg_ecu_acknowledge(&bench_.ecu) == (oracle_.acknowledge(), !oracle_.locked));
        }
        if (chance(20'000)) {
            lpvg_can_frame_t off{};
            off.id = LPVG_CAN_ERROR | LPVG_CAN_BUS_OFF;
            off.t_us = at_us_ + bench_.clock_off_us;
            bench_.frames.push_back(off);
        }
        return call();
    }

    std::size_t engaged = 0, locked = 0, valid = 0, invalid = 0, refused = 0;
    uint32_t released_by = 0U;

    std::string story() const {
        std::string text = "wanted: causes " + std::to_string(oracle_.causes) + ", supervision " + std::to_string(oracle_.state) +
                           ", taken " + std::to_string(oracle_.taken) + "; causes " + std::to_string(bench_.ecu.causes) + ", supervision " +
                           std::to_string(bench_.ecu.report.supervision) + ", verdict " + std::to_string(bench_.ecu.report.verdict) +
                           ", pace " + std::to_string(bench_.ecu.clock.pace) + "; troubles";
        for (int i = 0; i < n_troubles; ++i) {
            text += has(static_cast<Trouble>(i)) ? " " + std::to_string(i) : "";
        }
        return text;
    }

private:
    bool chance(uint64_t of) { return random_() % of == 0U; }
    int between(int low, int high) { return low + static_cast<int>(random_() % static_cast<uint64_t>(high - low + 1)); }
    bool has(Trouble trouble) const { return left_[trouble] > 0; }

    void draw() {
        for (int& steps : left_) {
            steps -= steps > 0 ? 1 : 0;
        }
        if (chance(seldom_ ? 3'000 : 300)) {
            const int trouble = between(0, n_troubles - 1);
            left_[trouble] = trouble == gain_lost ? 4'000 : between(1, chance(2) ? 20 : 400);
            period_us_ = between(9'700, 10'300);
            period_us_ = chance(3) ? between(5'000, 15'000) : period_us_;
        }
    }

    // The road, and the frames of the next ticks.
    void move() {
        Bench& b = bench_;
        b.send_vdc2 = !has(vdc2_lost);
        b.send_guard_in = !has(guard_in_lost);
        b.send_ebc1 = !has(ebc1_lost);
        b.send_ebc2 = !has(ebc2_lost);
        b.spoil_guard_in = has(checksums_wrong) || (has(every_other_checksum_wrong) && !b.spoil_guard_in);
        b.second_sender = has(other_sender);
        b.pedal_percent = has(driver_brakes) ? 10.0F : 0.0F;
        b.abs_active = has(abs_acts) ? 1U : 0U;
        b.other_priority = has(other_command) ? 2U : 0U;
        b.brakes_work = !has(brakes_stuck);
        b.request = LPVG_BUS_REQUEST_CONTROL;
        if (has(not_requested)) {
            b.request = left_[not_requested] % 3 == 0 ? LPVG_BUS_REQUEST_RELEASE : LPVG_BUS_REQUEST_ACKNOWLEDGE;
        }
        const float wanted = has(out_of_range) ? (fast_ ? 23.0F : 7.0F) : (fast_ ? 21.0F : 9.0F);
        b.speed += std::fabs(wanted - b.speed) > 0.02F ? std::copysign(0.02F, wanted - b.speed) : 0.0F;
        fast_ = chance(10'000) ? !fast_ : fast_;
        // By less than the message table allows in half a period.
        contradiction_ = has(sensors_contradict) ? std::min(contradiction_ + 1, 5) : std::max(contradiction_ - 1, 0);

        const auto t = static_cast<float>(at_us_) * 1e-6F;
        b.command = 0.06F * (std::sin(t) + std::sin(0.5F * t) + std::sin(2.0F * t));
        lpvg_real_t y[LPVG_NY];
        lpvg_model_output(&vehicle_, &lpvg_coeff, y);
        const auto yaw_rate = static_cast<float>(y[0]);
        b.wheel_angle = static_cast<float>(y[1]);
        b.lateral = yaw_rate * b.speed + 0.6F * static_cast<float>(contradiction_);
        b.yaw_rate = has(yaw_rate_absent) ? NAN : yaw_rate;
        const lpvg_real_t u[LPVG_NU] = {b.ecu.control.u[0] * lpvg_real_t(has(gain_lost) ? 0.3 : 1.0)};
        lpvg_model_advance(&vehicle_, &lpvg_coeff, static_cast<lpvg_real_t>(b.speed), u);
    }

    // The time of the next call.
    void wait() {
        if (has(period_off)) {
            at_us_ += period_us_;
        } else {
            grid_us_ = std::max(grid_us_ + tick_us, at_us_ + 1);
            at_us_ = grid_us_ + (has(jitters) ? between(-2'400, 2'400) : 0);
        }
        grid_us_ = has(period_off) ? at_us_ : grid_us_;
        if (chance(5'000)) {
            at_us_ = grid_us_ += between(1, 120) * tick_us;
        }
        if (chance(20'000)) {
            bench_.clock_off_us = chance(3) ? int64_t{1} << 40 : between(-5'000'000, 5'000'000);
        }
    }

    bool call() {
        const auto before = static_cast<double>(bench_.ecu.control.u[0]);
        const float verdict = static_cast<float>(bench_.ecu.report.verdict);
        const bool was_engaged = bench_.engaged();
        bench_.step_at(at_us_);
        oracle_.call(at_us_ + bench_.clock_off_us, bench_.handed, verdict, static_cast<float>(before));
        wait();
        if ((bench_.status == lpvg_status_ok) != oracle_.taken) {
            return false;
        }
        if (!oracle_.taken) {
            ++refused;
            return true;
        }
        const lpvg_ecu_t& ecu = bench_.ecu;
        oracle_.hear(static_cast<lpvg_verdict_t>(ecu.report.verdict), lpvg_monitor_verdict(&ecu.monitor, ecu.core_us) == lpvg_verdict_valid,
                     ecu.monitor.has_falsified ? ecu.monitor.t_falsified_us : -1, ecu.watch.evidence, ecu.watch.violated);
        const auto demand = static_cast<double>(ecu.control.u[0]);
        const int64_t counted_us = std::min<int64_t>(oracle_.elapsed_us, 3 * half_period_us);
        const double change = static_cast<double>(lpvg_control_coeff.reals.rate_max[0]) * 1e-6 * static_cast<double>(counted_us) * rounding;
        const bool is_valid = ecu.report.verdict == lpvg_verdict_valid;
        engaged += oracle_.engaged ? 1U : 0U;
        locked += oracle_.locked ? 1U : 0U;
        valid += is_valid ? 1U : 0U;
        invalid += ecu.report.verdict == lpvg_verdict_invalid ? 1U : 0U;
        released_by |= was_engaged && !oracle_.engaged ? oracle_.causes : 0U;
        return ecu.causes == oracle_.causes && bench_.engaged() == oracle_.engaged && ecu.kept.locked == oracle_.locked &&
               ecu.report.supervision == oracle_.state && (!is_valid || oracle_.may_be_valid()) &&
               (!oracle_.must_be_invalid() || ecu.report.verdict == lpvg_verdict_invalid) &&
               (oracle_.pace != lpvg_ecu_pace_bad || ecu.report.verdict == lpvg_verdict_fault) &&
               std::fabs(demand) <= largest_limit(lpvg_control_coeff.reals, 0) * rounding && std::fabs(demand - before) <= change &&
               (oracle_.engaged || std::fabs(demand) <= std::fmax(0.0, std::fabs(before) - change / rounding) * rounding + 1e-6);
    }

    Bench bench_;
    Oracle oracle_;
    lpvg_model_t vehicle_;
    std::mt19937_64 random_;
    int left_[n_troubles] = {};
    int64_t at_us_ = 0, grid_us_ = 0;
    int period_us_ = tick_us, contradiction_ = 0;
    bool fast_ = false, seldom_;
};

struct Counts {
    std::size_t engaged = 0, locked = 0, valid = 0, invalid = 0, refused = 0;
    uint32_t released_by = 0U;
};

Counts driven(unsigned first_seed, unsigned episodes) {
    Counts counts;
    for (unsigned seed = first_seed; seed < first_seed + episodes; ++seed) {
        Drive drive(seed);
        for (int k = 0; k < steps_an_episode; ++k) {
            if (!drive.step()) {
                FAIL("seed " << seed << ", step " << k << ": " << drive.story());
            }
        }
        counts.engaged += drive.engaged;
        counts.locked += drive.locked;
        counts.valid += drive.valid;
        counts.invalid += drive.invalid;
        counts.refused += drive.refused;
        counts.released_by |= drive.released_by;
    }
    return counts;
}

}  // namespace

// What the mutants are asked: an episode of either kind.
TEST_CASE("in two random drives a step is what time, frames and newest verdict say", "[property][ecu]") {
    const Counts counts = driven(1U, 2U);
    CHECK(counts.engaged > 0U);
    CHECK(counts.refused > 0U);
}

TEST_CASE("whatever happens, a step is what time, frames and newest verdict say",
          "[property][ecu][hour][REQ-ECU-1][REQ-ECU-2][REQ-ECU-7][REQ-ECU-8][REQ-ECU-9][REQ-ECU-10][REQ-ECU-11][REQ-ECU-12][REQ-ECU-13]"
          "[REQ-ECU-14]") {
    const unsigned episodes = long_form() ? 500U : 50U;
    const Counts counts = driven(1U, episodes);
    const std::size_t steps = static_cast<std::size_t>(steps_an_episode) * episodes;
    CAPTURE(steps, counts.engaged, counts.locked, counts.valid, counts.invalid, counts.refused, counts.released_by);
    CHECK(counts.engaged > steps / 5U);
    CHECK(counts.locked > steps / 100U);
    CHECK(counts.valid > steps / 25U);
    CHECK(counts.invalid > 0U);
    CHECK(counts.refused > 0U);
    // LPVG_ECU_CAUSE_UNJUDGED never comes alone: what leaves no verdict releases in the same step.
    const uint32_t all = LPVG_ECU_CAUSE_NOT_ASKED | LPVG_ECU_CAUSE_MESSAGE | LPVG_ECU_CAUSE_TIME | LPVG_ECU_CAUSE_RANGE |
                         LPVG_ECU_CAUSE_INVALID | LPVG_ECU_CAUSE_IMPLAUSIBLE | LPVG_ECU_CAUSE_OVERRIDE | LPVG_ECU_CAUSE_PERMISSION |
                         LPVG_ECU_CAUSE_ACTUATOR | LPVG_ECU_CAUSE_LOCKED;
    CHECK((counts.released_by & all) == all);
}
