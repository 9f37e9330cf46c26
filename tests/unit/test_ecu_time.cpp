// The ECU's clock: steps too soon, too late, at another period, and clocks that jump.
#include "control_limits.hpp"
#include "ecu_bench.hpp"

namespace {

constexpr int64_t window_us = LPVG_ECU_WINDOW_US;

// A bench whose loop is engaged, in the middle of a window.
Bench engaged_bench() {
    Bench bench;
    bench.run(333);
    REQUIRE(bench.engaged());
    return bench;
}

}  // namespace

TEST_CASE("a step sooner than half a period is refused, the demand keeps its rate in true time", "[unit][ecu][REQ-ECU-7][REQ-CTL-2]") {
    const int64_t every_us = GENERATE(1, 100, 1'000, 2'499, 4'999, 5'000, 5'001, 7'000, 9'000);
    Bench bench = engaged_bench();
    CAPTURE(every_us);
    bench.command = 0.3F;
    const auto rate_max = static_cast<double>(lpvg_control_coeff.reals.rate_max[0]);
    int64_t taken_us = bench.now_us, released_us = -1, begin_us = bench.now_us;
    auto before = static_cast<double>(bench.ecu.control.u[0]);
    std::size_t wrong = 0;
    const int64_t end_us = begin_us + (every_us < 100 ? window_us / 20 : 2 * window_us);
    for (int64_t t_us = begin_us + every_us; t_us < end_us; t_us += every_us) {
        bench.step_at(t_us);
        const bool soon = t_us - taken_us < tick_us / 2;
        wrong += (bench.status == lpvg_status_out_of_order) != soon ? 1U : 0U;
        if (bench.status == lpvg_status_ok) {
            const auto u = static_cast<double>(bench.ecu.control.u[0]);
            wrong += std::fabs(u - before) > rate_max * 1e-6 * static_cast<double>(t_us - taken_us) * rounding ? 1U : 0U;
            before = u;
            taken_us = t_us;
        }
        released_us = released_us < 0 && !bench.engaged() ? t_us : released_us;
    }
    CHECK(wrong == 0U);
    if (every_us == 4'999) {  // every other call is refused: the rest has the period
        CHECK(released_us < 0);
    } else if (every_us >= 100) {
        CHECK(released_us > 0);
        CHECK(released_us - begin_us <= window_us);
        CHECK(bench.report.verdict == static_cast<float>(lpvg_verdict_fault));
        CHECK(bench.spn == LPVG_ECU_SPN_TIME);
    }
}

TEST_CASE("a mean period off by more than 2 % releases within a second and a half, and is never valid", "[unit][ecu][REQ-ECU-8]") {
    const int64_t period_us = GENERATE(9'500, 9'750, 9'799, 9'800, 10'200, 10'201, 10'250, 10'500, 12'000, 14'900);
    const bool allowed = period_us >= 9'800 && period_us <= 10'200;
    const int phase = GENERATE(0, 13, 49);
    Bench bench;
    bench.run(300 + phase);
    bench.ecu.monitor.has_evidence = true;
    bench.ecu.monitor.t_evidence_us = bench.now_us;
    bench.step();
    REQUIRE(bench.report.verdict == static_cast<float>(lpvg_verdict_valid));
    const int64_t begin_us = bench.now_us;
    int64_t released_us = -1;
    std::size_t valid_after = 0;
    for (int64_t t_us = begin_us + period_us; t_us < begin_us + 4 * window_us; t_us += period_us) {
        bench.step_at(t_us);
        REQUIRE(bench.status == lpvg_status_ok);
        released_us = released_us < 0 && !bench.engaged() ? t_us : released_us;
        valid_after += released_us > 0 && bench.report.verdict == static_cast<float>(lpvg_verdict_valid) ? 1U : 0U;
    }
    CHECK(bench.engaged() == allowed);
    CHECK((released_us < 0) == allowed);
    CHECK(released_us - begin_us <= 3 * window_us / 2);
    CHECK(valid_after == 0U);
    const int64_t begin_good_us = bench.now_us;
    for (int64_t t_us = begin_good_us + tick_us; t_us < begin_good_us + 2 * window_us + window_us / 2; t_us += tick_us) {
        bench.step_at(t_us);
    }
    CHECK(bench.engaged());
    CHECK(bench.ecu.clock.gaps == 0U);
}

TEST_CASE("the monitor gets samples of live messages at the exported period only", "[unit][ecu][REQ-ECU-8][REQ-ECU-4]") {
    Bench bench = engaged_bench();
    CHECK(bench.ecu.monitor.t_us == bench.ecu.core_us);
    int64_t t_us = bench.now_us;
    for (int64_t i = 0; bench.ecu.clock.pace != lpvg_ecu_pace_bad && i < 2 * window_us / tick_us; ++i) {
        CHECK(bench.ecu.monitor.t_us == bench.ecu.core_us);
        t_us += 10'500;
        bench.step_at(t_us);
    }
    REQUIRE(bench.ecu.clock.pace == lpvg_ecu_pace_bad);
    REQUIRE(bench.live());
    const int64_t newest_us = bench.ecu.monitor.t_us;
    bench.step_at(t_us + 10'500);
    CHECK(bench.ecu.monitor.t_us == newest_us);
    CHECK(newest_us < bench.ecu.core_us - 10'500);
}

TEST_CASE("a verdict that speaks for the vehicle is said of speeds in the range, and once the period is measured",
          "[unit][ecu][REQ-ECU-8][REQ-ECU-10]") {
    const bool degraded = GENERATE(false, true);
    Bench bench = engaged_bench();
    const auto says = [&] {
        bench.ecu.monitor.has_evidence = true;
        bench.ecu.monitor.has_changed = degraded;
        bench.ecu.monitor.t_evidence_us = bench.ecu.monitor.t_changed_us = bench.ecu.core_us;
        bench.step();
        return bench.ecu.report.verdict;
    };
    CHECK(says() == (degraded ? lpvg_verdict_degraded : lpvg_verdict_valid));
    bench.ecu.clock.pace = lpvg_ecu_pace_unknown;
    CHECK(says() == (degraded ? lpvg_verdict_unknown : lpvg_verdict_not_judged));  // the release voids the evidence
    bench.ecu.clock.pace = lpvg_ecu_pace_unknown;
    CHECK(says() == lpvg_verdict_unknown);
    bench.ecu.clock.pace = lpvg_ecu_pace_good;
    bench.speed = 7.0F;
    while (bench.ecu.in_range) {
        bench.step();
    }
    CHECK(says() == lpvg_verdict_not_judged);
    bench.ecu.monitor.has_falsified = true;  // what speaks against the vehicle is said at any speed
    bench.ecu.monitor.t_falsified_us = bench.ecu.core_us;
    CHECK(says() == lpvg_verdict_invalid);
    bench.ecu.clock.pace = lpvg_ecu_pace_unknown;
    CHECK(says() == lpvg_verdict_invalid);
    bench.ecu.clock.pace = lpvg_ecu_pace_bad;
    CHECK(says() == lpvg_verdict_fault);
}

TEST_CASE("jitter within half a period is no change of period", "[unit][ecu][REQ-ECU-8]") {
    Bench bench = engaged_bench();
    std::size_t released = 0;
    for (int i = 0; i < 1000; ++i) {
        bench.step_at(bench.k * tick_us + (i % 2 == 0 ? 2'400 : -2'400));
        ++bench.k;
        released += bench.engaged() ? 0U : 1U;
    }
    CHECK(released == 0U);
}

TEST_CASE("a late step releases at once; the loop comes back when the period has been measured again", "[unit][ecu][REQ-ECU-7]") {
    const int64_t late_us = GENERATE(5'001, 20'000, 989'999, 990'000);
    Bench bench = engaged_bench();
    bench.ecu.monitor.has_evidence = true;
    bench.ecu.monitor.t_evidence_us = bench.now_us;
    const int64_t begin_us = bench.now_us + tick_us + late_us;
    bench.step_at(begin_us);
    CHECK(bench.status == lpvg_status_ok);
    CHECK_FALSE(bench.engaged());
    CHECK(bench.report.verdict != static_cast<float>(lpvg_verdict_valid));
    CHECK(bench.ecu.clock.gaps == 1U);
    int64_t t_us = begin_us + tick_us;
    for (; !bench.engaged() && t_us < begin_us + 2 * window_us; t_us += tick_us) {
        bench.step_at(t_us);
    }
    CHECK(bench.now_us - begin_us == window_us / 2 + static_cast<int64_t>(LPVG_ECU_WAIT_US) - tick_us);
    CHECK(bench.ecu.core_us == bench.now_us);
    const int64_t sooner_us = bench.now_us + 3 * tick_us / 2;  // the latest step that is in time
    bench.step_at(sooner_us);
    CHECK(bench.engaged());
    CHECK(bench.ecu.clock.gaps == 1U);
}

TEST_CASE("the period behind a gap is measured without what was before it", "[unit][ecu][REQ-ECU-8]") {
    Bench bench = engaged_bench();
    int64_t t_us = bench.now_us + 20 * tick_us;
    bench.step_at(t_us);
    REQUIRE(bench.ecu.clock.gaps == 1U);
    for (int64_t i = 0; i < window_us / 2 / tick_us; ++i) {
        CHECK(bench.ecu.clock.pace == lpvg_ecu_pace_unknown);
        t_us += 10'300;  // with a good half window before it the mean would be within 2 %
        bench.step_at(t_us);
    }
    CHECK(bench.ecu.clock.pace == lpvg_ecu_pace_bad);
}

TEST_CASE("one call with a wrong time is refused and forgotten", "[unit][ecu][REQ-ECU-9]") {
    const int64_t off_us =
        GENERATE(std::numeric_limits<int64_t>::max() / 2, int64_t{1} << 40, int64_t{1'000'001}, int64_t{-1}, int64_t{-1'000'000});
    Bench bench = engaged_bench();
    bench.clock_off_us = off_us;
    bench.step_at(bench.now_us);
    CHECK(bench.status == lpvg_status_out_of_order);
    bench.clock_off_us = 0;
    bench.step();
    CHECK(bench.engaged());
    CHECK(bench.ecu.clock.gaps == 0U);
}

TEST_CASE("wrong times between steps that are taken are never followed", "[unit][ecu][REQ-ECU-9]") {
    Bench bench = engaged_bench();
    for (int i = 0; i < 10; ++i) {
        bench.clock_off_us = int64_t{1} << 40;  // wrong calls a period apart: in step with each other, but for those in between
        bench.step_at(bench.now_us + tick_us / 2);
        CHECK(bench.status == lpvg_status_out_of_order);
        bench.clock_off_us = 0;
        bench.step();
    }
    CHECK(bench.engaged());
    CHECK(bench.ecu.clock.gaps == 0U);
    CHECK(bench.ecu.clock.refused == 10U);
    bench.clock_off_us = int64_t{1} << 40;
    const int64_t from_us = bench.now_us - tick_us / 2;
    for (int64_t i = 1; i <= LPVG_ECU_RESYNC_CALLS; ++i) {  // those before the step that was taken do not count
        bench.step_at(from_us + i * tick_us);
        CHECK((bench.status == lpvg_status_ok) == (i == LPVG_ECU_RESYNC_CALLS));
    }
}

TEST_CASE("a clock that has jumped either way is followed after three calls, released", "[unit][ecu][REQ-ECU-9]") {
    const int64_t off_us = GENERATE(std::numeric_limits<int64_t>::max() / 2, int64_t{1'000'001}, int64_t{-3'000'000});
    Bench bench = engaged_bench();
    bench.ecu.monitor.has_evidence = true;
    bench.ecu.monitor.t_evidence_us = bench.now_us;
    const int64_t core_us = bench.ecu.core_us;
    const int64_t begin_us = bench.now_us;
    bench.clock_off_us = off_us;
    for (int64_t i = 1; i <= LPVG_ECU_RESYNC_CALLS; ++i) {
        bench.step_at(begin_us + i * tick_us);
        CHECK(bench.status == (i < LPVG_ECU_RESYNC_CALLS ? lpvg_status_out_of_order : lpvg_status_ok));
    }
    CHECK(bench.ecu.core_us == core_us + LPVG_ECU_JUMP_US);
    CHECK_FALSE(bench.engaged());
    CHECK_FALSE(bench.live());
    CHECK(bench.report.verdict != static_cast<float>(lpvg_verdict_valid));
    const int64_t from_us = bench.now_us;
    int valid = 0;
    for (int64_t t_us = from_us + tick_us; t_us <= from_us + 3 * window_us / 2; t_us += tick_us) {
        bench.step_at(t_us);
        valid += t_us < from_us + window_us / 2 && bench.report.verdict == static_cast<float>(lpvg_verdict_valid) ? 1 : 0;
    }
    CHECK(valid == 0);
    CHECK(bench.live());
    CHECK(bench.engaged());
}

TEST_CASE("calls that agree with nothing stay refused, and their count does not wrap", "[unit][ecu][REQ-ECU-9]") {
    Bench bench = engaged_bench();
    bench.ecu.clock.refused = UINT32_MAX - 2U;
    const int64_t begin_us = bench.now_us;
    for (int64_t i = 1; i < 10; ++i) {
        bench.clock_off_us = -i * 100'000;  // a clock that runs backwards
        bench.step_at(begin_us);
        CHECK(bench.status == lpvg_status_out_of_order);
    }
    CHECK(bench.ecu.clock.refused == UINT32_MAX);
    for (int64_t i = 0; i < 10; ++i) {  // one that stands
        bench.clock_off_us = -2'000'000;
        bench.step_at(begin_us);
        CHECK(bench.status == lpvg_status_out_of_order);
    }
}

TEST_CASE("frames stamped before the ECU's time begins count as of its beginning", "[unit][ecu][REQ-ECU-5]") {
    const int first = GENERATE(0, 1);  // of the steps, that has frames
    Bench bench;
    bench.send_vdc2 = false;
    bench.run(first);
    bench.send_vdc2 = true;
    bench.filter = [](std::vector<lpvg_can_frame_t> frames) {
        for (lpvg_can_frame_t& frame : frames) {
            frame.t_us = -1'000;
        }
        return frames;
    };
    bench.step();
    CHECK(bench.ecu.supervisor.watch[LPVG_CAN_VDC2_INDEX].has_arrival != 0U);
    CHECK(bench.ecu.supervisor.watch[LPVG_CAN_VDC2_INDEX].t_arrival_us == 0);
}

TEST_CASE("a frame whose time stamp cannot be carries no clock away, behind a jump too", "[unit][ecu][REQ-ECU-5]") {
    Bench bench = engaged_bench();
    bench.clock_off_us = 3'000'000;
    for (int64_t i = 1; i <= LPVG_ECU_RESYNC_CALLS; ++i) {
        bench.step_at(bench.k * tick_us);
        ++bench.k;
    }
    REQUIRE(bench.status == lpvg_status_ok);
    bench.filter = [](std::vector<lpvg_can_frame_t> frames) {
        for (lpvg_can_frame_t& frame : frames) {
            frame.t_us = std::numeric_limits<int64_t>::min();
        }
        return frames;
    };
    bench.step();
    CHECK(bench.ecu.supervisor.now_us == bench.ecu.core_us);
    CHECK(bench.ecu.supervisor.count[lpvg_can_event_backwards] > 0U);
}

TEST_CASE("refused calls are in step half to one and a half periods after each other", "[unit][ecu][REQ-ECU-9]") {
    const int64_t every_us = GENERATE(4'999, 5'000, 15'000, 15'001);
    const bool in_step = every_us >= 5'000 && every_us <= 15'000;
    Bench bench = engaged_bench();
    const int64_t begin_us = bench.now_us;
    for (int64_t i = 1; i <= LPVG_ECU_RESYNC_CALLS + 3; ++i) {
        bench.clock_off_us = i * every_us - 3'000'000;
        bench.step_at(begin_us);
        CHECK((bench.status == lpvg_status_ok) == (in_step && i == LPVG_ECU_RESYNC_CALLS));
        if (in_step && i == LPVG_ECU_RESYNC_CALLS) {
            break;
        }
    }
}

TEST_CASE("refused calls half of all times apart are not in step", "[unit][ecu][REQ-ECU-9]") {
    Bench bench = engaged_bench();
    const int64_t quarter_us = int64_t{1} << 62;  // twice the time between both calls is a period, where it wraps
    lpvg_can_frame_t out[LPVG_ECU_FRAMES_OUT];
    size_t n = 0U;
    for (const int64_t t_us : {-quarter_us, quarter_us + tick_us / 2}) {
        CHECK(lpvg_ecu_step(&bench.ecu, t_us, nullptr, 0, out, LPVG_ECU_FRAMES_OUT, &n) == lpvg_status_out_of_order);
        CHECK(bench.ecu.clock.in_step == 1U);
    }
}

TEST_CASE("frames stamped later than their step count as of its time", "[unit][ecu][REQ-ECU-5]") {
    Bench bench;
    bench.filter = [](std::vector<lpvg_can_frame_t> frames) {
        for (lpvg_can_frame_t& frame : frames) {
            frame.t_us += 1'000;
        }
        return frames;
    };
    bench.run_until_engaged();
    CHECK(bench.ecu.supervisor.now_us == bench.now_us);
}

TEST_CASE("the first step may come at once or much later, but not before init", "[unit][ecu][REQ-ECU-9]") {
    const int64_t start_us = 1'000'000;
    const int64_t first_us = GENERATE(as<int64_t>{}, 1'000'000, INT64_MAX / 2);
    lpvg_ecu_t ecu;
    REQUIRE(lpvg_ecu_init(&ecu, &lpvg_coeff, &lpvg_control_coeff, &bench_config, start_us) == lpvg_status_ok);
    lpvg_can_frame_t out[LPVG_ECU_FRAMES_OUT];
    size_t n = 0U;
    CHECK(lpvg_ecu_step(&ecu, start_us - 1, nullptr, 0, out, LPVG_ECU_FRAMES_OUT, &n) == lpvg_status_out_of_order);
    CHECK(lpvg_ecu_step(&ecu, INT64_MAX / 2 + 1, nullptr, 0, out, LPVG_ECU_FRAMES_OUT, &n) == lpvg_status_out_of_order);
    CHECK(lpvg_ecu_step(&ecu, first_us, nullptr, 0, out, LPVG_ECU_FRAMES_OUT, &n) == lpvg_status_ok);
    CHECK(ecu.core_us == first_us);
    CHECK(ecu.clock.gaps == 0U);
}
