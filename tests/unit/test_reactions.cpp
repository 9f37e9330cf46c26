// From cause to release: the longest time over the phases of sample period, messages and windows. The table in lib/REQUIREMENTS.md is
// made of it: `LPVGUARD_REACTIONS=lib/REQUIREMENTS.md test_reactions` writes the table, and without that the test compares it.
#include "../long_form.hpp"
#include "../marked_table.hpp"
#include "../../firmware_sim/ports/aes_cmac.hpp"
#include "ecu_bench.hpp"
#include "lpvguard/authentication.h"

#include <cstdio>
#include <deque>
#include <functional>
#include <memory>
#include <sstream>
#include <string>

namespace {

struct Row {
    const char* cause;
    const char* reaction;
    int phases;                           // one step apart
    double limit_ms;                      // of this many at most
    std::function<void(Bench&)> begin;    // the cause, right before a step
    std::function<void(Bench&)> goes_on;  // a step of it
    float speed_mps = 12.0F;              // before it
    bool until_locked = false;            // measured until the lock, not the first release
};

void step(Bench& bench) { bench.step(); }

// A step that comes later than the sample period after the one before.
std::function<void(Bench&)> every(int64_t period_us) {
    return [period_us](Bench& bench) { bench.step_at(bench.now_us + period_us); };
}

void nothing(Bench&) {}

using Frames = std::vector<lpvg_can_frame_t>;

// Every frame of GUARD_IN is followed by what `follower` makes of it, half a period later.
template <class Follower>
std::function<void(Bench&)> followed_by(Follower follower) {
    return [follower](Bench& bench) {
        bench.filter = [follower](const Frames& frames) mutable {
            Frames out;
            for (const auto& frame : frames) {
                out.push_back(frame);
                if (frame.id == LPVG_CAN_GUARD_IN_ID) {
                    out.push_back(follower(frame));
                    out.back().t_us += tick_us / 2;
                }
            }
            return out;
        };
    };
}

// Behind every n-th GUARD_IN, 2 ms before the next one, comes a frame with that one's counter: the genuine frame is the early one.
template <int n>
void thinned(Bench& bench) {
    auto count = std::make_shared<int>(0);
    auto waiting = std::make_shared<Frames>();
    bench.filter = [count, waiting](const Frames& frames) {
        Frames out = *waiting;
        waiting->clear();
        for (const auto& frame : frames) {
            out.push_back(frame);
            if (frame.id == LPVG_CAN_GUARD_IN_ID && ++*count % n == 0) {
                lpvg_can_frame_t foreign = frame;
                auto next = static_cast<uint8_t>((frame.data[1] % 16U + 1U) % LPVG_CAN_COUNTERS);
                REQUIRE(lpvg_can_e2e_protect(&foreign, LPVG_CAN_GUARD_IN_E2E_DATA_ID, &next) == lpvg_status_ok);
                foreign.t_us += tick_us - 2'000;
                waiting->push_back(foreign);
            }
        }
        return out;
    };
}

void thinned_vdc2(Bench& bench) {
    auto count = std::make_shared<int>(0);
    bench.filter = [count](const Frames& frames) {
        Frames out;
        for (const auto& frame : frames) {
            out.push_back(frame);
            if (frame.id == LPVG_CAN_VDC2_ID && ++*count % 5 == 0) {
                out.push_back(frame);
                out.back().t_us += tick_us / 2;
            }
        }
        return out;
    };
}

// What was sent so many periods ago: counter and checksum are right, and so is the sequence for a receiver of these frames alone.
class Recording {
public:
    lpvg_can_frame_t operator()(const lpvg_can_frame_t& frame) {
        frames_.push_back(frame);
        auto old = frames_[frames_.size() > 37U ? frames_.size() - 37U : 0U];
        old.t_us = frame.t_us;
        return old;
    }

private:
    Frames frames_;
};

// GUARD_IN with authenticators. From the call on, a recording of the genuine pairs takes their place on the bus.
class Authenticated {
public:
    Authenticated() {
        static const uint8_t key[16] = {1, 2, 3};
        static AesCmac cmac(key);
        const lpvg_can_auth_config_t with = {AesCmac::hook, &cmac,  LPVG_CAN_GUARD_IN_ID,         LPVG_CAN_GUARD_IN_ID ^ 0x0300U,
                                             0xE3FFFFFFU,   5'000U, LPVG_CAN_GUARD_IN_E2E_DATA_ID};
        REQUIRE(lpvg_can_auth_init(&sender_, &with, 0U) == lpvg_status_ok);
        REQUIRE(lpvg_can_auth_init(&receiver_, &with, 0U) == lpvg_status_ok);
    }
    void replay() { replayed_ = true; }
    Frames operator()(const Frames& frames) {
        Frames out;
        for (const auto& frame : frames) {
            if (frame.id != LPVG_CAN_GUARD_IN_ID) {
                out.push_back(frame);
                continue;
            }
            lpvg_can_frame_t pair[2] = {frame, {}};
            REQUIRE(lpvg_can_auth_protect(&sender_, &frame, &pair[1]) == lpvg_status_ok);
            for (std::size_t i = 0; i < 2U; ++i) {
                recording_.push_back(pair[i]);
                pair[i] = replayed_ && recording_.size() > 40U ? recording_[recording_.size() - 40U] : pair[i];
                pair[i].t_us = frame.t_us;
                lpvg_can_frame_t passed{};
                if (lpvg_can_auth_receive(&receiver_, &pair[i], &passed) == lpvg_can_auth_passed) {
                    out.push_back(passed);
                }
            }
        }
        return out;
    }

private:
    lpvg_can_auth_t sender_, receiver_;
    Frames recording_;
    bool replayed_ = false;
};

// The recording is of the run that the bench has behind it: it is made by running on, before the replay begins.
void replay_authenticated(Bench& bench) {
    auto bus = std::make_shared<Authenticated>();
    bench.filter = [bus](const Frames& frames) { return (*bus)(frames); };
    bench.run(40);
    REQUIRE(bench.engaged());
    bus->replay();
}

std::function<void(Bench&)> brakes_of(float gain) {
    return [gain](Bench& bench) { bench.brake_gain = gain; };
}

std::function<void(Bench&)> response_of(float gain) {
    return [gain](Bench& bench) { bench.response = gain; };
}

void excited(Bench& bench) {
    const auto t = 0.01F * static_cast<float>(bench.k);
    bench.command = 0.06F * (std::sin(t) + std::sin(0.5F * t) + std::sin(2.0F * t));
    bench.step();
}

template <int steps>
void lost_for_60_ms_of(Bench& bench) {
    bench.send_vdc2 = bench.k % steps >= 6;
    bench.step();
}

const Row rows[] = {
    {"clock: one step later than 1.5 periods (30 ms)", "release", 10, 30.0, nothing, every(30'000)},
    {"clock: period 10.25 ms", "release, verdict fault", 60, 1'600.0, nothing, every(10'250)},
    {"clock: period 10.5 ms", "release, verdict fault", 60, 1'100.0, nothing, every(10'500)},
    {"clock: period 12 ms", "release, verdict fault", 60, 1'100.0, nothing, every(12'000)},
    {"clock: period 14.9 ms", "release, verdict fault", 60, 1'100.0, nothing, every(14'900)},
    {"speed above the range", "release", 10, 110.0, [](Bench& b) { b.speed = 22.3F; }, step, 21.7F},
    {"speed below the range", "release", 10, 110.0, [](Bench& b) { b.speed = 7.7F; }, step, 8.3F},
    {"brake pedal", "release", 10, 110.0, [](Bench& b) { b.pedal_percent = 10.0F; }, step},
    {"ABS active", "release", 10, 110.0, [](Bench& b) { b.abs_active = 1U; }, step},
    {"request release", "release", 10, 10.0, [](Bench& b) { b.request = LPVG_BUS_REQUEST_RELEASE; }, step},
    {"another command of higher priority", "release", 10, 10.0, [](Bench& b) { b.other_priority = 1U; }, step},
    {"VDC2 lost", "release", 10, 50.0, [](Bench& b) { b.send_vdc2 = false; }, step},
    {"GUARD_IN lost", "release", 10, 50.0, [](Bench& b) { b.send_guard_in = false; }, step},
    {"GUARD_IN, every checksum wrong", "release", 10, 50.0, [](Bench& b) { b.spoil_guard_in = true; }, step},
    {"GUARD_IN, every other checksum wrong", "release", 10, 170.0, nothing,
     [](Bench& b) {
         b.spoil_guard_in = !b.spoil_guard_in;
         b.step();
     }},
    {"GUARD_IN, a second sender with counter + 1", "release", 10, 130.0, [](Bench& b) { b.second_sender = true; }, step},
    {"GUARD_IN, every frame sent twice", "release", 10, 130.0, followed_by([](const lpvg_can_frame_t& frame) { return frame; }), step},
    {"GUARD_IN, a recording sent beside it", "release", 10, 130.0, [](Bench& b) { followed_by(Recording())(b); }, step},
    {"GUARD_IN, a foreign frame with the next counter behind every fifth", "release", 10, 1'100.0, thinned<5>, step},
    {"GUARD_IN, a foreign frame with the next counter behind every tenth", "release", 10, 2'000.0, thinned<10>, step},
    {"VDC2, a foreign frame behind every fifth", "release", 10, 1'300.0, thinned_vdc2, step},
    {"GUARD_IN, a recording in its place, where it is authenticated", "release", 10, 50.0, replay_authenticated, step},
    {"VDC2 lost for 60 ms of every 200 ms", "release, while it lasts", 20, 220.0, nothing, lost_for_60_ms_of<20>},
    {"VDC2 lost for 60 ms of every 2 s", "release, then lock", 200, 8'100.0, nothing, lost_for_60_ms_of<200>, 12.0F, true},
    {"EBC2 or EBC1 lost", "release", 10, 460.0, [](Bench& b) { b.send_ebc2 = b.send_ebc1 = false; }, step},
    {"verdict unknown, stale or fault", "release", 1, 10.0, [](Bench& b) { b.ecu.report.verdict = lpvg_verdict_stale; }, step},
    {"verdict invalid", "release, lock", 1, 20.0,
     [](Bench& b) {
         b.ecu.monitor.has_falsified = true;
         b.ecu.monitor.t_falsified_us = b.ecu.core_us;
     },
     step},
    {"sensors contradict each other", "release, lock", 10, 1'020.0, [](Bench& b) { b.lateral = 3.0F; }, step},
    {"actuator 2.2 bar off the demand", "release, lock", 10, 320.0,
     [](Bench& b) {
         b.brakes_work = false;
         b.pressure = static_cast<float>(b.ecu.control.u[0]) - 2.2F;
     },
     step},
    {"brakes stuck at 0.3 bar of demand", "release, lock", 10, 2'000.0, brakes_of(0.0F), step},
    {"brakes with half the gain at 0.3 bar", "release, lock", 10, 2'000.0, brakes_of(0.5F), step},
    {"brakes with twice the gain at 0.3 bar", "release, lock", 10, 2'000.0, brakes_of(2.0F), step},
    {"brakes reversed at 0.3 bar", "release, lock", 10, 2'000.0, brakes_of(-1.0F), step},
    {"the vehicle's response reversed", "release, lock", 10, 1'500.0, response_of(-1.0F), excited},
    {"the vehicle does not respond", "release, lock", 10, 1'500.0, response_of(0.0F), excited},
    {"the vehicle responds with 0.3 of the gain", "release, lock", 10, 5'000.0, response_of(0.3F), excited},
    {"the vehicle responds with 3 times the gain", "release, lock", 10, 5'000.0, response_of(3.0F), excited},
    {"kept values or state damaged", "release until init", 10, 10.0, [](Bench& b) { b.ecu.inverted[5] ^= 4U; }, step},
    {"coefficients damaged", "release until init", 997, 10'010.0,
     [](Bench& b) { const_cast<lpvg_coeff_t*>(b.ecu.kept.coeff)->reals.threshold *= lpvg_real_t(2); }, step},
};

lpvg_coeff_t coeff;

// Longest time [ms] from the last step before the cause to the first one released.
double longest_ms(const Row& row) {
    double longest = 0.0;
    lpvg_ecu_config_t with = bench_config;
    with.report_only = 0U;
    coeff = lpvg_coeff;
    Bench start(with, coeff);
    start.speed = row.speed_mps;
    start.run_until_engaged();
    start.run(30);
    const int stride = row.phases > 100 ? 83 : 1;
    for (int phase = 0; phase < row.phases; phase += stride) {
        coeff = lpvg_coeff;
        Bench bench = start;
        bench.run(phase);
        REQUIRE(bench.engaged());
        row.begin(bench);
        const int64_t begin_us = bench.now_us;
        const auto goes_on = [&] { return row.until_locked ? !bench.ecu.kept.locked : bench.engaged(); };
        while (goes_on() && bench.now_us - begin_us < 20'000'000) {
            row.goes_on(bench);
        }
        CAPTURE(row.cause, phase);
        CHECK_FALSE(goes_on());
        longest = std::fmax(longest, 1e-3 * static_cast<double>(bench.now_us - begin_us));
    }
    return longest;
}

std::string table() {
    std::ostringstream text;
    text << "| cause | reaction | longest time to release [ms] | at most [ms] |\n| --- | --- | --- | --- |\n";
    for (const Row& row : rows) {
        const double ms = longest_ms(row);
        CAPTURE(row.cause);
        CHECK(ms <= row.limit_ms);
        text << "| " << row.cause << " | " << row.reaction << " | " << ms << " | " << row.limit_ms << " |\n";
    }
    return text.str();
}

}  // namespace

// The causes that come back: what begins and ends one, and whether it is a fault.
struct Flicker {
    const char* cause;
    std::function<void(Bench&, bool)> set;
};

const Flicker flickers[] = {
    {"not asked", [](Bench& b, bool on) { lpvg_ecu_engage(&b.ecu, !on); }},
    {"no request", [](Bench& b, bool on) { b.request = on ? LPVG_BUS_REQUEST_RELEASE : LPVG_BUS_REQUEST_CONTROL; }},
    {"acknowledgement", [](Bench& b, bool on) { b.request = on ? LPVG_BUS_REQUEST_ACKNOWLEDGE : LPVG_BUS_REQUEST_CONTROL; }},
    {"another command", [](Bench& b, bool on) { b.other_priority = on ? 1U : 0U; }},
    {"brake pedal", [](Bench& b, bool on) { b.pedal_percent = on ? 10.0F : 0.0F; }},
    {"ABS", [](Bench& b, bool on) { b.abs_active = on ? 1U : 0U; }},
    {"speed", [](Bench& b, bool on) { b.speed = on ? 22.3F : 21.95F; }},
    {"message", [](Bench& b, bool on) { b.send_vdc2 = !on; }},
    {"verdict unknown", [](Bench& b, bool on) { b.ecu.report.verdict = on ? uint8_t{lpvg_verdict_unknown} : b.ecu.report.verdict; }},
    {"verdict invalid",
     [](Bench& b, bool on) {
         b.ecu.monitor.has_falsified = on;
         b.ecu.monitor.t_falsified_us = b.ecu.core_us;
     }},
    {"sensors",
     [](Bench& b, bool on) {
         b.ecu.plausibility.flags = on ? LPVG_CAN_IMPLAUSIBLE_WHEELS : 0U;
         b.ecu.plausibility.score[1] = on ? 1U : 0U;
     }},
    {"actuator",
     [](Bench& b, bool on) {
         b.ecu.actuator_failed = on;
         b.ecu.deviations = on ? 2U : 0U;
     }},
};

struct Flickered {
    int engagements = 1;
    int64_t longest_us = 0, locked_us = 0;  // from the cause's end to engagement; until the first lock
    bool locked = false;
};

// A cause that lasts 0.2 s of every two seconds, for ten minutes; `acknowledged`: every 3 s.
Flickered flickered(const Flicker& flicker, bool acknowledged) {
    Bench bench;
    bench.speed = 21.95F;
    bench.run_until_engaged();
    bench.run(30);
    Flickered was;
    int64_t ended_us = 0;
    const int64_t begin_us = bench.now_us;
    bool before = true;
    for (int k = 0; k < 60'000; ++k) {
        flicker.set(bench, k % 200 < 20);
        ended_us = k % 200 == 20 ? bench.now_us : ended_us;
        bench.step();
        if (acknowledged && k % 300 == 0) {
            (void)lpvg_ecu_acknowledge(&bench.ecu);
        }
        if (bench.engaged() && !before) {
            ++was.engagements;
            was.longest_us = std::max(was.longest_us, bench.now_us - ended_us);
        }
        was.locked_us = bench.ecu.kept.locked && was.locked_us == 0 ? bench.now_us - begin_us : was.locked_us;
        before = bench.engaged();
    }
    was.locked = bench.ecu.kept.locked;
    return was;
}

std::string flicker_row(const Flicker& flicker) {
    const Flickered was = flickered(flicker, false), again = flickered(flicker, true);
    CAPTURE(flicker.cause, was.engagements, again.engagements);
    CHECK(was.locked);
    CHECK(again.locked);
    CHECK(std::max(was.engagements, again.engagements) <= static_cast<int>(LPVG_ECU_ENGAGEMENTS_MAX));
    CHECK((was.engagements == 1 || was.longest_us >= LPVG_ECU_WAIT_US));
    std::ostringstream row;
    row << "| " << flicker.cause << " | " << (was.engagements > 1 ? std::to_string(was.longest_us / 1000) : "–") << " | " << was.engagements
        << " | " << was.locked_us / 1000 << " | " << again.engagements << " |\n";
    return row.str();
}

// Engagements under a cause that lasts a share of each period, until the loop locks or 72 periods or an hour have passed.
struct Swept {
    int engagements = 0, most_in_an_hour = 0;
    bool locked = false, waited = true;
};

Swept swept(const Flicker& flicker, int period_steps, int on_steps) {
    Bench bench;
    bench.speed = 21.95F;
    bench.run_until_engaged();
    bench.run(30);
    Swept was;
    std::deque<int64_t> begins_us = {bench.now_us};
    was.engagements = was.most_in_an_hour = 1;
    bool before = true;
    int64_t caused_us = bench.now_us;
    const int steps = std::min(360'000, std::max(72 * period_steps, 6'000));
    for (int k = 0; k < steps && !bench.ecu.kept.locked; ++k) {
        const bool on = k % period_steps < on_steps;
        flicker.set(bench, on);
        bench.step();
        caused_us = (bench.ecu.causes & ~static_cast<uint32_t>(LPVG_ECU_CAUSE_WAIT)) != 0U ? bench.now_us : caused_us;
        if (bench.engaged() && !before) {
            was.waited = was.waited && bench.now_us - caused_us >= int64_t{LPVG_ECU_WAIT_US};
            ++was.engagements;
            begins_us.push_back(bench.now_us);
            while (bench.now_us - begins_us.front() >= 3'600'000'000) {
                begins_us.pop_front();
            }
            was.most_in_an_hour = std::max(was.most_in_an_hour, static_cast<int>(begins_us.size()));
        }
        before = bench.engaged();
    }
    was.locked = bench.ecu.kept.locked;
    return was;
}

TEST_CASE("no cause engages the loop more than 60 times an hour, however long it lasts and pauses", "[unit][reactions][REQ-ECU-18]") {
    // A step that comes 20 ms late: a gap of the clock.
    const Flicker clock = {"clock", [](Bench& b, bool on) { b.k += on ? 2 : 0; }};
    std::vector<Flicker> all(std::begin(flickers), std::end(flickers));
    all.push_back(clock);
    std::vector<int> periods = {1, 5, 150};  // of 10 ms
    if (long_form()) {
        periods.insert(periods.end(), {20, 60, 500, 2'000, 6'000});
    }
    for (const Flicker& flicker : all) {
        int most = 0;
        for (const int period : periods) {
            for (const int percent : {5, 50, 95}) {
                const int on = std::max(1, period * percent / 100);
                const Swept was = swept(flicker, period, on);
                CAPTURE(flicker.cause, period, percent, was.engagements, was.most_in_an_hour);
                CHECK(was.most_in_an_hour <= static_cast<int>(LPVG_ECU_ENGAGEMENTS_MAX));
                CHECK(was.waited);
                CHECK((was.locked || was.engagements < static_cast<int>(LPVG_ECU_ENGAGEMENTS_MAX)));
                most = std::max(most, was.engagements);
            }
        }
        std::printf("%s: at most %d engagements\n", flicker.cause, most);
    }
}

TEST_CASE("every cause waits, counts and locks, and the table of them is the one of the requirements", "[unit][reactions][REQ-ECU-18]") {
    std::string text =
        "| cause, 0.2 s of every 2 s | from its end to engagement [ms] | engagements | until locked [ms] | engagements, acknowledged every "
        "3 s "
        "|\n| --- | --- | --- | --- | --- |\n";
    for (const Flicker& flicker : flickers) {
        text += flicker_row(flicker);
    }
    MarkedTable("flickers", "test_reactions").require(text, "LPVGUARD_FLICKERS");
}

TEST_CASE("every cause releases within its time, and the table of them is the one of the requirements", "[unit][reactions][REQ-ECU-16]") {
    MarkedTable("reactions", "test_reactions").require(table(), "LPVGUARD_REACTIONS");
}
