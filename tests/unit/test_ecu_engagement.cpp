// When the ECU may act: speed range, verdicts, waiting, and locks.
#include "../long_form.hpp"
#include "ecu_bench.hpp"

#include <algorithm>

namespace {

constexpr float hysteresis = LPVG_ECU_SPEED_HYSTERESIS_MPS;

Bench engaged_bench(const lpvg_ecu_config_t& config = bench_config) {
    Bench bench(config);
    bench.run_until_engaged();
    return bench;
}

// Speed ramps at 2 m/s2, as slowly as the message table allows and a truck can.
void drive_to(Bench& bench, float speed) {
    while (std::fabs(bench.speed - speed) > 0.02F) {
        bench.speed += bench.speed < speed ? 0.02F : -0.02F;
        bench.step();
    }
    bench.run(11);  // the axle speed comes every tenth step
}

bool has(const Bench& bench, uint32_t cause) { return (bench.ecu.causes & cause) != 0U; }

enum Evidence {
    nothing,
    a_valid_verdict,
    the_watch,
    the_watch_too_shortly
};

}  // namespace

TEST_CASE("a vehicle that changed within its bounds is reported, and stays engaged", "[unit][ecu][REQ-ECU-11]") {
    Bench bench;
    bench.run_until_engaged();
    bench.ecu.monitor.has_changed = true;
    bench.ecu.monitor.t_changed_us = bench.ecu.monitor.t_us;
    bench.run(20);
    CHECK(bench.ecu.report.verdict == lpvg_verdict_degraded);
    CHECK(bench.ecu.causes == 0U);
    CHECK(bench.ecu.fault == lpvg_ecu_fault_degraded);
    CHECK(bench.engaged());
}

TEST_CASE("before a frame has ended nothing is known of the vehicle, then lack of excitation permits",
          "[unit][ecu][REQ-ECU-1][REQ-ECU-11]") {
    Bench bench;
    while (bench.ecu.report.verdict == lpvg_verdict_unknown && bench.k < 2000) {
        bench.step();
        CHECK_FALSE(bench.engaged());
    }
    CHECK(bench.ecu.report.verdict == lpvg_verdict_not_judged);
    bench.step();
    CHECK(bench.ecu.causes == 0U);  // no wait where nothing was released
    CHECK(bench.engaged());
}

TEST_CASE("at every speed outside the scheduling range the loop is released, with hysteresis at its ends", "[unit][ecu][REQ-ECU-10]") {
    const lpvg_control_reals_t& r = lpvg_control_coeff.reals;
    Bench bench = engaged_bench();
    const float beyond = GENERATE(0.0F, 3.0F, 7.7F, 22.3F, 30.0F, 38.0F);
    CAPTURE(beyond);
    const bool low = beyond < static_cast<float>(r.speed_min);
    const auto edge = static_cast<float>(low ? r.speed_min : r.speed_max);
    std::size_t wrong = 0;
    drive_to(bench, edge + (low ? -0.8F : 0.8F) * hysteresis);
    CHECK(bench.engaged());
    bench.ecu.monitor.has_evidence = true;
    while (std::fabs(bench.speed - beyond) > 0.02F) {
        bench.ecu.monitor.t_evidence_us = bench.ecu.core_us;
        bench.speed += low ? -0.02F : 0.02F;
        bench.step();
        const auto now = bench.ecu.signals.speed;  // the newest that has come
        const bool outside = now < r.speed_min - hysteresis || now > r.speed_max + hysteresis;
        wrong += outside && (bench.engaged() || bench.report.verdict == static_cast<float>(lpvg_verdict_valid)) ? 1U : 0U;
    }
    bench.run(10);
    CHECK(wrong == 0U);
    CHECK(has(bench, LPVG_ECU_CAUSE_RANGE));
    CHECK_FALSE(bench.ecu.kept.locked);
    CHECK(bench.ecu.releases == 0U);
    bench.ecu.monitor.has_evidence = false;
    drive_to(bench, edge + (low ? -0.2F : 0.2F) * hysteresis);
    bench.run(wait_steps);
    CHECK_FALSE(bench.engaged());
    drive_to(bench, edge + (low ? 0.2F : -0.2F) * hysteresis);
    bench.run(wait_steps);
    CHECK(bench.engaged());
}

TEST_CASE("the ends of the range belong to it, and so do the ends of its hysteresis", "[unit][ecu][REQ-ECU-10]") {
    const bool low = GENERATE(false, true);
    const bool was_in = GENERATE(false, true);
    const bool beyond = GENERATE(false, true);
    const auto speed = [] {
        Bench bench;
        bench.run(100);
        return bench.ecu.signals.speed;
    }();
    // A range of which the bench's speed is an end, exactly.
    lpvg_control_coeff_t control = lpvg_control_coeff;
    const lpvg_real_t wide = was_in ? static_cast<lpvg_real_t>(hysteresis) : lpvg_real_t(0), outwards = lpvg_real_t(low ? 1000 : -1000);
    const lpvg_real_t end = low ? speed + wide : speed - wide;
    (low ? control.reals.speed_min : control.reals.speed_max) = beyond ? std::nextafter(end, outwards) : end;
    control.words.crc32 = lpvg_control_coeff_crc32(&control);
    Bench bench(bench_config, lpvg_coeff, control);
    bench.ecu.in_range = was_in;
    bench.run(100);
    REQUIRE(bench.live());
    REQUIRE(bench.ecu.signals.speed == speed);
    CHECK(bench.ecu.in_range != beyond);
    CHECK(has(bench, LPVG_ECU_CAUSE_RANGE) == beyond);
}

TEST_CASE("an unknown, stale or faulty verdict releases, unless it is only to be reported", "[unit][ecu][REQ-ECU-11]") {
    const bool only_reported = GENERATE(false, true);
    lpvg_ecu_config_t with = bench_config;
    with.report_only = only_reported ? LPVG_ECU_CAUSE_UNJUDGED : 0U;
    Bench bench = engaged_bench(with);
    bench.run(400);
    const auto verdict = GENERATE(lpvg_verdict_unknown, lpvg_verdict_stale, lpvg_verdict_fault);
    bench.ecu.report.verdict = static_cast<uint8_t>(verdict);
    bench.step();
    CHECK(has(bench, LPVG_ECU_CAUSE_UNJUDGED));
    CHECK(bench.engaged() == only_reported);
    bench.step();
    CHECK_FALSE(has(bench, LPVG_ECU_CAUSE_UNJUDGED));
    bench.run(wait_steps - 2);
    CHECK(has(bench, LPVG_ECU_CAUSE_WAIT) == !only_reported);
    CHECK(bench.engaged() == only_reported);
    bench.step();
    CHECK(bench.engaged());
    CHECK(bench.ecu.releases == (only_reported ? 0U : 1U));
}

TEST_CASE("a falsified model and contradicting sensors lock until they are acknowledged", "[unit][ecu][REQ-ECU-12]") {
    const bool invalid = GENERATE(false, true);
    const uint32_t cause = invalid ? LPVG_ECU_CAUSE_INVALID : LPVG_ECU_CAUSE_IMPLAUSIBLE;
    Bench bench = engaged_bench();
    if (invalid) {
        bench.ecu.monitor.has_falsified = true;
        bench.ecu.monitor.t_falsified_us = bench.ecu.core_us;
    } else {
        bench.ecu.plausibility.flags = LPVG_CAN_IMPLAUSIBLE_WHEELS;
        bench.ecu.plausibility.score[1] = 20U;
    }
    bench.run(2);
    CHECK(has(bench, cause));
    CHECK(has(bench, LPVG_ECU_CAUSE_LOCKED));
    CHECK((bench.ecu.lock_causes & cause) != 0U);
    CHECK_FALSE(bench.engaged());
    CHECK_FALSE(lpvg_ecu_acknowledge(&bench.ecu));
    bench.ecu.monitor.has_falsified = false;
    bench.ecu.plausibility = {};
    bench.run(300);
    CHECK(bench.ecu.causes == (LPVG_ECU_CAUSE_LOCKED | (invalid ? LPVG_ECU_CAUSE_INVALID | LPVG_ECU_CAUSE_WAIT : 0U)));
    CHECK(bench.spn == (invalid ? LPVG_ECU_SPN_INVALID : LPVG_ECU_SPN_LOCKED));
    CHECK(bench.fmi == LPVG_CAN_FMI_CONDITION);
    CHECK_FALSE(bench.engaged());
    if (invalid) {  // silence is no evidence
        CHECK_FALSE(lpvg_ecu_acknowledge(&bench.ecu));
        bench.run(static_cast<int>(LPVG_ECU_CALM_US / tick_us));
        CHECK(bench.ecu.report.verdict == lpvg_verdict_invalid);
    }
    CHECK(lpvg_ecu_acknowledge(&bench.ecu));
    bench.run(wait_steps + 1);
    CHECK(bench.engaged());
    CHECK_FALSE(lpvg_ecu_acknowledge(nullptr));
}

TEST_CASE("an invalid verdict that comes back on trial is not acknowledged again, one after evidence for the response is",
          "[unit][ecu][REQ-ECU-12][REQ-ECU-18]") {
    const auto spoke = GENERATE(nothing, a_valid_verdict, the_watch, the_watch_too_shortly);
    const bool passed = spoke == a_valid_verdict || spoke == the_watch;
    Bench bench;
    bench.command = 0.0F;  // the watch itself has no evidence
    bench.run_until_engaged();
    const auto falsify = [&] {
        bench.ecu.monitor.has_falsified = true;
        bench.ecu.monitor.t_falsified_us = bench.ecu.core_us;
        bench.run(2);
        CHECK_FALSE(bench.engaged());
        bench.run(static_cast<int>(LPVG_ECU_CALM_US / tick_us) + 1);
    };
    bench.ecu.trial_us = LPVG_ECU_CALM_US;  // of an earlier trial
    falsify();
    REQUIRE(lpvg_ecu_acknowledge(&bench.ecu));
    bench.run(wait_steps + 1);
    REQUIRE(bench.engaged());
    CHECK(bench.ecu.kept.on_trial);
    CHECK(bench.ecu.trial_us == 0U);
    if (spoke == a_valid_verdict) {
        bench.ecu.monitor.has_evidence = true;
        bench.ecu.monitor.t_evidence_us = bench.ecu.core_us;
        bench.step();
    } else if (spoke != nothing) {
        std::fill(&bench.ecu.watch.Q[0][0], &bench.ecu.watch.Q[0][0] + LPVG_WATCH_MEMORIES * LPVG_NY, lpvg_real_t(1));
        bench.step();
        REQUIRE(bench.ecu.watch.evidence);
        CHECK(bench.ecu.trial_us == static_cast<uint32_t>(tick_us));
        bench.ecu.trial_us = LPVG_ECU_CALM_US - static_cast<uint32_t>(tick_us) - (spoke == the_watch ? 0U : 1U);
        bench.step();
        if (spoke == the_watch_too_shortly) {  // a step whose sample the monitor refuses is no evidence
            bench.ecu.trial_us -= static_cast<uint32_t>(tick_us);
            const uint32_t before_us = bench.ecu.trial_us;
            ++bench.ecu.monitor.energy_sum;
            bench.step();
            REQUIRE(bench.engaged());
            CHECK(bench.ecu.trial_us == before_us);
            bench.run(2);
            bench.run_until_engaged();
        }
        std::memset(bench.ecu.watch.Q, 0, sizeof bench.ecu.watch.Q);
    }
    CHECK(bench.ecu.kept.on_trial != passed);
    falsify();
    CHECK(lpvg_ecu_acknowledge(&bench.ecu) == passed);
}

TEST_CASE("what the watch found is not acknowledged, whatever else is found later, and init ends it", "[unit][ecu][REQ-ECU-18]") {
    const bool only_reported = GENERATE(false, true);
    lpvg_ecu_config_t with = bench_config;
    with.report_only = only_reported ? LPVG_ECU_CAUSE_INVALID : 0U;
    Bench bench = engaged_bench(with);
    bench.ecu.watch.P[0][0] = bench.ecu.watch.Q[0][0] = lpvg_real_t(1);  // the response is twice the nominal one
    bench.run(2);
    CHECK(bench.engaged() == only_reported);
    CHECK(bench.ecu.kept.refuted != only_reported);
    bench.ecu.monitor.has_falsified = true;
    bench.ecu.monitor.t_falsified_us = bench.ecu.core_us;
    bench.run(static_cast<int>(LPVG_ECU_CALM_US / tick_us) + 300);
    CHECK(lpvg_ecu_acknowledge(&bench.ecu) == only_reported);
    CHECK((Bench().run_until_engaged(), true));
}

TEST_CASE("behind a gap the watch begins its sums a second later, behind another release at once", "[unit][ecu][REQ-ECU-17]") {
    const bool gap = GENERATE(false, true);
    Bench bench = engaged_bench();
    bench.send_vdc2 = !gap;
    bench.pedal_percent = gap ? 0.0F : 10.0F;
    bench.run(12);
    bench.send_vdc2 = true;
    bench.pedal_percent = 0.0F;
    const int64_t since_us = bench.ecu.core_us;
    REQUIRE_FALSE(bench.engaged());
    bench.run_until_engaged();
    const auto sum = [&] { return *std::max_element(&bench.ecu.watch.Q[0][0], &bench.ecu.watch.Q[0][0] + LPVG_WATCH_MEMORIES * LPVG_NY); };
    int64_t begun_us = -1;
    for (int k = 0; k < 200 && begun_us < 0; ++k) {
        bench.step();
        begun_us = sum() > lpvg_real_t(1e-9) ? bench.ecu.core_us : -1;
    }
    CHECK((begun_us - since_us >= int64_t{LPVG_ECU_SETTLE_US}) == gap);
    CHECK(begun_us - since_us < int64_t{LPVG_ECU_SETTLE_US} + 150'000);
}

TEST_CASE("evidence from before a gap or a release makes no verdict valid", "[unit][ecu][REQ-ECU-17]") {
    const bool gap = GENERATE(false, true);
    Bench bench = engaged_bench();
    const auto speak = [&] {
        bench.ecu.monitor.has_evidence = true;
        bench.ecu.monitor.t_evidence_us = bench.ecu.core_us;
        bench.step();
    };
    speak();
    REQUIRE(bench.ecu.report.verdict == lpvg_verdict_valid);
    if (gap) {
        bench.send_vdc2 = false;
        bench.run(6);
        bench.send_vdc2 = true;
    } else {
        bench.request = LPVG_BUS_REQUEST_RELEASE;
        bench.run(1);
        bench.request = LPVG_BUS_REQUEST_CONTROL;
    }
    for (int i = 0; i < 1500; ++i) {
        bench.step();
        REQUIRE(bench.ecu.report.verdict != lpvg_verdict_valid);
    }
    CHECK(bench.engaged());
}

TEST_CASE("an engagement begins with a share of the demand, which evidence raises and a release takes back", "[unit][ecu][REQ-ECU-17]") {
    Bench bench = engaged_bench();
    const auto probe = static_cast<lpvg_real_t>(LPVG_ECU_PROBE_SHARE);
    CHECK(bench.ecu.share == probe);
    int steps = 0;
    for (; bench.ecu.share < lpvg_real_t(1) && steps < 300; ++steps) {
        const auto limit = static_cast<double>(bench.ecu.share * bench.ecu.kept.u_max[0]);
        bench.step();
        CHECK(std::fabs(static_cast<double>(bench.ecu.control.u[0])) <= limit * 1.001);
    }
    CHECK(steps > static_cast<int>(LPVG_ECU_PROBE_US / tick_us));
    CHECK(steps < 200);
    bench.pedal_percent = 10.0F;
    bench.run(12);
    CHECK_FALSE(bench.engaged());
    CHECK(bench.ecu.share == probe);
}

TEST_CASE("a demand that rests at its limit without evidence widens the limit by a step", "[unit][ecu][REQ-ECU-17]") {
    Bench bench;
    bench.command = 0.0F;  // the demand stays small: no evidence
    bench.run_until_engaged();
    const auto probe = static_cast<lpvg_real_t>(LPVG_ECU_PROBE_SHARE);
    const lpvg_real_t before = bench.ecu.share;
    int steps = 0;
    for (; bench.ecu.share < before + probe && steps < 1000; ++steps) {
        REQUIRE(bench.ecu.share == before);
        ++bench.ecu.control.limited;  // as if the limit had cut the demand
        bench.step();
    }
    CHECK(bench.ecu.share == before + probe);
    CHECK(steps == static_cast<int>(LPVG_ECU_PROBE_US / tick_us));
}

TEST_CASE("a limit that evidence has widened narrows where the evidence lapses, unless the demand rests at it", "[unit][ecu][REQ-ECU-17]") {
    lpvg_ecu_config_t config = bench_config;
    const bool releases = GENERATE(true, false);
    config.report_only = releases ? 0U : LPVG_ECU_CAUSE_INVALID;
    Bench bench(config);
    bench.run_until_engaged();
    bench.run(200);
    REQUIRE(bench.ecu.share == lpvg_real_t(1));
    bench.command = 0.0F;
    int lasting = 0;
    for (; bench.ecu.watch.evidence && lasting < 20'000; ++lasting) {
        bench.step();
        REQUIRE((bench.ecu.share == lpvg_real_t(1)) == (bench.ecu.watch.evidence || !releases));
    }
    CAPTURE(lasting);
    REQUIRE_FALSE(bench.ecu.watch.evidence);
    if (!releases) {
        bench.run(600);
        CHECK(bench.ecu.share == lpvg_real_t(1));
        return;
    }
    const lpvg_real_t before = bench.ecu.share;
    CHECK(static_cast<double>(before) == Approx(1.0 - 0.75 * static_cast<double>(tick_us) / static_cast<double>(LPVG_ECU_AGE_US)));
    for (int i = 1; i < static_cast<int>(LPVG_ECU_PROBE_US / tick_us); ++i) {
        ++bench.ecu.control.limited;  // as if the limit had cut the demand
        bench.step();
        REQUIRE(bench.ecu.share == before);
    }
    const auto least = static_cast<double>(LPVG_ECU_PROBE_SHARE);
    for (int i = 1; bench.ecu.share > static_cast<lpvg_real_t>(LPVG_ECU_PROBE_SHARE); ++i) {
        bench.step();
        const double fallen = (1.0 - least) * i * static_cast<double>(tick_us) / static_cast<double>(LPVG_ECU_AGE_US);
        REQUIRE(static_cast<double>(bench.ecu.share) == Approx(std::fmax(static_cast<double>(before) - fallen, least)).margin(1e-4));
    }
    bench.run(10);
    CHECK(bench.ecu.share == static_cast<lpvg_real_t>(LPVG_ECU_PROBE_SHARE));
}

TEST_CASE("a lock ends by acknowledging whether or not engagement is asked for", "[unit][ecu][REQ-ECU-12]") {
    Bench bench = engaged_bench();
    bench.lock();
    bench.ecu.releases = 2U;
    lpvg_ecu_engage(&bench.ecu, false);
    bench.step();
    CHECK(bench.ecu.causes == (LPVG_ECU_CAUSE_NOT_ASKED | LPVG_ECU_CAUSE_LOCKED | LPVG_ECU_CAUSE_WAIT));
    CHECK(lpvg_ecu_acknowledge(&bench.ecu));
    CHECK(bench.ecu.releases == 2U);  // acknowledging forgets no release
    bench.step();
    CHECK(bench.ecu.causes == (LPVG_ECU_CAUSE_NOT_ASKED | LPVG_ECU_CAUSE_WAIT));
}

TEST_CASE("a model that is falsified while nothing is engaged is not engaged before it is acknowledged", "[unit][ecu][REQ-ECU-12]") {
    lpvg_ecu_config_t waiting = bench_config;
    waiting.engage = false;
    Bench bench(waiting);
    bench.run(300);
    bench.ecu.monitor.has_falsified = true;
    bench.ecu.monitor.t_falsified_us = bench.ecu.core_us;
    bench.run(2);
    CHECK(bench.ecu.causes == (LPVG_ECU_CAUSE_NOT_ASKED | LPVG_ECU_CAUSE_INVALID | LPVG_ECU_CAUSE_LOCKED));
    bench.ecu.monitor.has_falsified = false;
    lpvg_ecu_engage(&bench.ecu, true);
    bench.run(static_cast<int>(LPVG_ECU_CALM_US / tick_us));
    CHECK_FALSE(bench.engaged());
    CHECK(lpvg_ecu_acknowledge(&bench.ecu));
    bench.run(2);
    CHECK(bench.engaged());
}

TEST_CASE("messages lost for 60 ms of every 200 lock within the fourth release", "[unit][ecu][hour][REQ-ECU-12]") {
    Bench bench = engaged_bench();
    bench.ecu.released_us = bench.ecu.core_us;
    int engagements = 0;
    bool before = true;
    const int steps = long_form() ? 360'000 : 60'000;  // an hour, or ten minutes
    for (int i = 0; i < steps; ++i) {
        // 60 ms of every 2 s too: there is time to engage again in between.
        bench.send_vdc2 = i % (i < 3'000 ? 200 : 20) >= 6;
        bench.step();
        engagements += bench.engaged() && !before ? 1 : 0;
        before = bench.engaged();
    }
    CHECK(engagements == static_cast<int>(LPVG_ECU_RELEASES_MAX));
    CHECK(bench.ecu.kept.locked);
    CHECK(bench.ecu.lock_causes == LPVG_ECU_CAUSE_MESSAGE);
    bench.send_vdc2 = true;
    CHECK(lpvg_ecu_acknowledge(&bench.ecu));
    bench.run(LPVG_CAN_RECOVER_FRAMES + wait_steps + 2);
    CHECK(bench.engaged());
}

TEST_CASE("a minute without a release by a fault forgets those before", "[unit][ecu][REQ-ECU-12]") {
    const bool in_time = GENERATE(false, true);
    lpvg_ecu_config_t with = bench_config;
    with.report_only = LPVG_ECU_CAUSE_INVALID;  // this truck does not answer
    Bench bench = engaged_bench(with);
    for (unsigned i = 0; i <= LPVG_ECU_RELEASES_MAX; ++i) {
        bench.ecu.report.verdict = lpvg_verdict_fault;
        bench.step();
        REQUIRE_FALSE(bench.engaged());
        const int64_t steps = static_cast<int64_t>(LPVG_ECU_RELEASES_US) / tick_us - (in_time ? 0 : 1);
        bench.run(static_cast<int>(steps) - 1);
    }
    CHECK(bench.ecu.releases == (in_time ? 1U : LPVG_ECU_RELEASES_MAX + 1U));
    CHECK(bench.engaged() == in_time);
    CHECK(bench.ecu.kept.locked != in_time);
}

TEST_CASE("a release by a fault a minute after the one before is the first again, one sooner is one more", "[unit][ecu][REQ-ECU-12]") {
    const bool in_time = GENERATE(false, true);
    Bench bench = engaged_bench();
    bench.ecu.releases = LPVG_ECU_RELEASES_MAX;
    bench.ecu.released_us = bench.ecu.core_us + tick_us - static_cast<int64_t>(LPVG_ECU_RELEASES_US) + (in_time ? 0 : 1);
    bench.ecu.report.verdict = lpvg_verdict_fault;
    bench.step();
    CHECK_FALSE(bench.engaged());
    CHECK(bench.ecu.releases == (in_time ? 1U : LPVG_ECU_RELEASES_MAX + 1U));
    CHECK(bench.ecu.released_us == bench.ecu.core_us);
    CHECK(bench.ecu.kept.locked != in_time);
    CHECK(bench.ecu.lock_causes == (in_time ? 0U : LPVG_ECU_CAUSE_UNJUDGED));
}

TEST_CASE("the wait is over when all of it has passed", "[unit][ecu][REQ-ECU-12]") {
    const bool over = GENERATE(false, true);
    Bench bench = engaged_bench();
    bench.ecu.caused_us = bench.ecu.core_us + tick_us - static_cast<int64_t>(LPVG_ECU_WAIT_US) + (over ? 0 : 1);
    bench.step();
    CHECK(bench.ecu.causes == (over ? 0U : LPVG_ECU_CAUSE_WAIT));
}

TEST_CASE("asking releases without being counted as a fault, and waits as every cause does", "[unit][ecu][REQ-ECU-12]") {
    Bench bench = engaged_bench();
    for (unsigned i = 0; i < 2U * LPVG_ECU_RELEASES_MAX; ++i) {
        lpvg_ecu_engage(&bench.ecu, false);
        bench.step();
        CHECK(bench.ecu.causes == (LPVG_ECU_CAUSE_NOT_ASKED | LPVG_ECU_CAUSE_WAIT));
        lpvg_ecu_engage(&bench.ecu, true);
        bench.run(wait_steps - 1);
        CHECK_FALSE(bench.engaged());
        bench.step();
        CHECK(bench.engaged());
    }
    CHECK(bench.ecu.releases == 0U);
}

TEST_CASE("the sixtieth engagement of an hour is the last, whatever ended them and whoever acknowledges", "[unit][ecu][REQ-ECU-18]") {
    const int kind = GENERATE(0, 1, 2, 3);
    Bench bench = engaged_bench();
    int engagements = 1;
    const int64_t begin_us = bench.ecu.core_us;
    for (bool before = true; bench.ecu.core_us - begin_us < 3'600'000'000; before = bench.engaged()) {
        const bool flickers = bench.k % 100 < 10;
        bench.other_priority = kind == 0 && flickers ? 2U : 0U;
        bench.pedal_percent = kind == 1 && flickers ? 10.0F : 0.0F;
        bench.abs_active = kind == 2 && flickers ? 1U : 0U;
        bench.request = kind == 3 && flickers ? LPVG_BUS_REQUEST_RELEASE : LPVG_BUS_REQUEST_CONTROL;
        if (bench.k % 300 == 299) {
            (void)lpvg_ecu_acknowledge(&bench.ecu);
        }
        bench.step();
        engagements += bench.engaged() && !before ? 1 : 0;
        if (!long_form() && bench.ecu.core_us - begin_us > 300'000'000) {
            break;
        }
    }
    CHECK(engagements == static_cast<int>(LPVG_ECU_ENGAGEMENTS_MAX));
    CHECK(bench.ecu.kept.locked);
    CHECK(bench.ecu.lock_causes == LPVG_ECU_CAUSE_OFTEN);
    CHECK(has(bench, LPVG_ECU_CAUSE_OFTEN));
}
