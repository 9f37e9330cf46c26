// The ECU step as a black box on its bus: engagement, every supervision state, reactions, reports, documented failures.
#include "ecu_bench.hpp"

#include <algorithm>

namespace {

const lpvg_ecu_config_t& config = bench_config;

}  // namespace

TEST_CASE("engaged the ECU demands what the controller does at the measured speed", "[unit][ecu]") {
    Bench bench;
    bench.speed = GENERATE(9.0F, 12.0F, 20.0F);
    bench.run_until_engaged();
    bench.run(300);
    REQUIRE(bench.ecu.share == lpvg_real_t(1));
    lpvg_control_t twin = bench.ecu.control;
    for (int i = 0; i < 50; ++i) {
        bench.step();
        lpvg_real_t m[LPVG_NM];
        m[0] = bench.ecu.signals.reference;
        std::memcpy(&m[1], bench.ecu.signals.y, sizeof bench.ecu.signals.y);
        REQUIRE(static_cast<double>(bench.ecu.signals.speed) == Approx(static_cast<double>(bench.speed)).epsilon(1e-3));
        REQUIRE(lpvg_control_step(&twin, bench.ecu.signals.speed, m, true) == lpvg_status_ok);
        REQUIRE(twin.u[0] == bench.ecu.control.u[0]);
    }
    CHECK(std::abs(twin.u[0]) > lpvg_real_t(0.01));
}

TEST_CASE("nothing is demanded before every needed message is live, then the loop engages", "[unit][ecu][REQ-ECU-1]") {
    Bench bench;
    bench.run(to_live - 1);
    CHECK_FALSE(bench.live());
    CHECK(bench.report.demand == Approx(0.0F).margin(0.0003));
    CHECK(bench.report.verdict == static_cast<float>(lpvg_verdict_unknown));
    CHECK(bench.spn == 0U);  // a bus that comes up is no fault
    CHECK(bench.lamps == 0U);
    bench.run(1);
    CHECK(bench.live());
    const int waited = bench.run_until_engaged();
    CAPTURE(waited);
    CHECK(bench.ecu.report.verdict == lpvg_verdict_not_judged);
    bench.run(190);
    CHECK(std::fabs(bench.report.demand) > 0.1F);
    CHECK(bench.report.demand == Approx(static_cast<float>(bench.ecu.control.u[0])).margin(0.5 / 2048.0 + 1e-6));
}

TEST_CASE("engagement is asked for by configuration or call, and given back without a jump", "[unit][ecu][REQ-ECU-1]") {
    lpvg_ecu_config_t waiting = config;
    waiting.engage = false;
    Bench bench(waiting);
    bench.run(300);
    CHECK(bench.live());
    CHECK(bench.report.demand == Approx(0.0F).margin(0.0003));
    lpvg_ecu_engage(&bench.ecu, true);
    bench.run(1);
    CHECK(std::fabs(bench.ecu.control.u[0]) < 1.0 / 2048.0);
    bench.run(300);
    CHECK(std::fabs(bench.report.demand) > 0.1F);
    lpvg_ecu_engage(&bench.ecu, false);
    bench.run(100);
    CHECK(bench.report.demand == Approx(0.0F).margin(0.0003));
    lpvg_ecu_engage(nullptr, true);
}

TEST_CASE("a dead yaw sensor shows within 5 periods and its demand is released", "[unit][ecu][REQ-ECU-2]") {
    const bool absent = GENERATE(false, true);  // no frame at all, or frames that say "not available"
    Bench bench;
    bench.run(400);
    REQUIRE(bench.live());
    const float demand = bench.report.demand;
    if (absent) {
        bench.yaw_rate = NAN;
    } else {
        bench.send_vdc2 = false;
    }
    int steps = 0;
    while (bench.live() && steps < 20) {
        bench.step();
        ++steps;
    }
    CHECK(steps <= 5);
    CHECK(std::fabs(bench.report.demand) <= std::fabs(demand));
    bench.run(3);
    CHECK(bench.report.supervision == static_cast<float>(lpvg_can_state_off));
    bench.run(100);
    CHECK(bench.report.demand == Approx(0.0F).margin(0.0003));
    CHECK(bench.report.verdict == static_cast<float>(lpvg_verdict_stale));
    CHECK(bench.spn == 1808U);
    CHECK(bench.fmi == (absent ? 2U : 9U));
    CHECK(bench.lamps == LPVG_CAN_LAMP_AMBER);
    CHECK(bench.ecu.occurrence == 1U);
    bench.yaw_rate = 0.0F;
    bench.send_vdc2 = true;
    bench.run(LPVG_CAN_RECOVER_FRAMES);
    CHECK(bench.live());
    CHECK_FALSE(bench.engaged());
    bench.run(wait_steps + 1);  // the verdict is there one step later
    CHECK(bench.engaged());
    bench.run(100);
    CHECK(bench.spn == 0U);
    CHECK(bench.lamps == 0U);
    CHECK(bench.ecu.occurrence == 1U);  // the end of a fault is none
}

TEST_CASE("DM1 comes when all of its second has passed", "[unit][ecu][REQ-ECU-2]") {
    const bool due = GENERATE(false, true);
    Bench bench;
    bench.run_until_engaged();
    const int told = bench.dm1s;
    bench.ecu.dm1_us = bench.ecu.core_us + tick_us - 1'000'000 + (due ? 0 : 1);
    bench.step();
    CHECK(bench.dm1s == told + (due ? 1 : 0));
}

TEST_CASE("occurrences are counted up to 126", "[unit][ecu][REQ-ECU-2]") {
    const unsigned before = GENERATE(range(123U, 127U));
    Bench bench;
    bench.run_until_engaged();
    bench.ecu.occurrence = static_cast<uint8_t>(before);
    bench.send_vdc2 = false;
    bench.run(20);
    CHECK(bench.ecu.fault == lpvg_ecu_fault_message);
    CHECK(bench.ecu.occurrence == std::min(before + 1U, 126U));
}

TEST_CASE("every needed message is missed when it is lost or damaged", "[unit][ecu][REQ-ECU-2]") {
    const int which = GENERATE(0, 1, 2);
    Bench bench;
    bench.run(200);
    REQUIRE(bench.live());
    bench.send_guard_in = which != 0;
    bench.spoil_guard_in = which == 1;
    bench.send_ebc2 = which != 2;
    const int periods = which == 2 ? 10 * LPVG_CAN_OFF_MISSED : LPVG_CAN_OFF_MISSED;
    bench.run(periods + (which == 2 ? 10 : 2));
    CHECK(bench.report.supervision == static_cast<float>(lpvg_can_state_off));
    bench.run(100);
    CHECK(bench.spn == (which == 2 ? 904U : 520192U));
    CHECK(bench.fmi == (which == 1 ? 19U : 9U));
    CHECK(bench.report.demand == Approx(0.0F).margin(0.0003));
}

TEST_CASE("bus-off releases at once", "[unit][ecu][REQ-ECU-2]") {
    Bench bench;
    bench.run(300);
    REQUIRE(bench.live());
    lpvg_can_frame_t error{};
    error.id = LPVG_CAN_ERROR | LPVG_CAN_BUS_OFF;
    error.t_us = bench.k * tick_us;
    lpvg_can_frame_t out[LPVG_ECU_FRAMES_OUT];
    size_t n_out = 0;
    REQUIRE(lpvg_ecu_step(&bench.ecu, error.t_us, &error, 1, out, LPVG_ECU_FRAMES_OUT, &n_out) == lpvg_status_ok);
    CHECK(bench.ecu.report.supervision == lpvg_can_state_off);
    CHECK_FALSE(bench.ecu.control.engaged);
}

TEST_CASE("a frame keeps a time stamp that lies before the step", "[unit][ecu]") {
    Bench bench;
    bench.run(60);
    lpvg_can_frame_t frame{}, out[LPVG_ECU_FRAMES_OUT];
    frame.t_us = bench.k * tick_us - 1;
    size_t n = 0U;
    REQUIRE(lpvg_ecu_step(&bench.ecu, bench.k * tick_us, &frame, 1, out, LPVG_ECU_FRAMES_OUT, &n) == lpvg_status_ok);
    CHECK(n >= 1U);
    CHECK(bench.ecu.supervisor.now_us == bench.k * tick_us);
}

TEST_CASE("a frame from the future does not carry the clock away", "[unit][ecu][REQ-ECU-5]") {
    Bench bench;
    bench.run(100);
    REQUIRE(bench.live());
    lpvg_can_frame_t frame{};
    REQUIRE(lpvg_can_vdc2_pack(&bench.newest_vdc2, &frame) == lpvg_status_ok);
    frame.t_us = std::numeric_limits<int64_t>::max();
    lpvg_can_frame_t out[LPVG_ECU_FRAMES_OUT];
    size_t n_out = 0;
    REQUIRE(lpvg_ecu_step(&bench.ecu, bench.k * tick_us, &frame, 1, out, LPVG_ECU_FRAMES_OUT, &n_out) == lpvg_status_ok);
    ++bench.k;
    ++bench.reports;
    bench.run(100);
    CHECK(bench.live());
}

TEST_CASE("a number that the bus let pass and the core refuses releases the demand", "[unit][ecu][REQ-ECU-3]") {
    // The ranges of bus and signal table agree for the truck, so one is narrowed.
    lpvg_coeff_t narrow = lpvg_coeff;
    narrow.reals.output_valid[0][1] = lpvg_real_t(0.01);
    narrow.words.crc32 = lpvg_coeff_crc32(&narrow);
    Bench bench(config, narrow);
    bench.answers = false;
    bench.command = 0.0F;
    bench.run(300);
    REQUIRE(bench.ecu.control.engaged);
    bench.yaw_rate = 0.03F;
    bench.run(2);
    CHECK_FALSE(bench.ecu.control.engaged);
    CHECK(bench.report.supervision == static_cast<float>(lpvg_can_state_off));
    bench.run(100);
    CHECK(bench.spn == LPVG_ECU_SPN_REFUSED);
    CHECK(bench.report.demand == Approx(0.0F).margin(0.0003));
    bench.yaw_rate = 0.0F;
    bench.run(wait_steps + 2);
    CHECK(bench.ecu.control.engaged);
}

TEST_CASE("a vehicle that does not answer is found out, and released if so configured", "[unit][ecu][REQ-ECU-4]") {
    const bool only_reported = GENERATE(false, true);
    lpvg_ecu_config_t with = config;
    with.report_only = only_reported ? LPVG_ECU_CAUSE_INVALID : 0U;
    Bench bench(with);
    bench.answers = false;
    for (int i = 0; i < 6000 && bench.report.verdict != static_cast<float>(lpvg_verdict_invalid); ++i) {
        bench.command = 0.15F * std::sin(0.01F * static_cast<float>(i));
        bench.step();
    }
    REQUIRE(bench.report.verdict == static_cast<float>(lpvg_verdict_invalid));
    if (only_reported) {
        lpvg_frame_t record{};  // of whichever of the tests was first
        REQUIRE(lpvg_monitor_take_record(&bench.ecu.monitor, &record));
        const lpvg_coeff_reals_t& reals = lpvg_coeff.reals;
        CHECK(record.statistic > (record.test == lpvg_test_frame    ? reals.threshold
                                  : record.test == lpvg_test_energy ? reals.energy_threshold
                                                                    : reals.change_threshold));
    } else {  // the watch is sooner than any frame
        CHECK(bench.ecu.watch.violated);
        CHECK(bench.ecu.core_us < 8'000'000);
    }
    bench.run(120);
    CHECK(bench.live());
    CHECK(bench.spn == LPVG_ECU_SPN_INVALID);
    CHECK(bench.ecu.control.engaged == only_reported);
}

TEST_CASE("sensors that contradict each other are told, and released if so configured", "[unit][ecu][REQ-ECU-4]") {
    const bool only_reported = GENERATE(false, true);
    lpvg_ecu_config_t with = config;
    with.report_only = only_reported ? LPVG_ECU_CAUSE_IMPLAUSIBLE : 0U;
    Bench bench(with);
    bench.run(100);
    bench.lateral = 3.0F;  // a bend of 0.25 rad/s that the yaw sensor does not see
    bench.run(230);
    CHECK(bench.ecu.plausibility.flags == LPVG_CAN_IMPLAUSIBLE_LATERAL);
    CHECK(bench.spn == LPVG_ECU_SPN_IMPLAUSIBLE);
    CHECK(bench.ecu.control.engaged == only_reported);
}

TEST_CASE("sensors are not held against each other while a message is missing", "[unit][ecu][REQ-ECU-4]") {
    Bench bench;
    bench.run_until_engaged();
    bench.lateral = 3.0F;  // a contradiction, for less than it takes to be told
    bench.run(60);
    REQUIRE(bench.live());
    bench.send_vdc2 = false;
    bench.run(200);
    CHECK_FALSE(bench.live());
    CHECK(bench.ecu.plausibility.flags == 0U);
}

TEST_CASE("the report holds the statistic of the newest frame", "[unit][ecu][REQ-ECU-4]") {
    Bench bench;
    bench.run_until_engaged();
    bench.ecu.monitor.frame.statistic = lpvg_real_t(0.75);
    bench.step();
    REQUIRE(bench.ecu.monitor.frame.statistic > lpvg_real_t(0));
    CHECK(bench.report.statistic == Approx(static_cast<float>(bench.ecu.monitor.frame.statistic)).margin(0.01));
}

TEST_CASE("a controller or monitor that refuses its sample releases the demand and is told", "[unit][ecu][REQ-ECU-3]") {
    const bool of_monitor = GENERATE(false, true);
    Bench bench;
    bench.run(400);
    REQUIRE(bench.engaged());
    REQUIRE(bench.live());
    bench.ecu.occurrence = 126U;  // the greatest count that DM1 can tell
    if (of_monitor) {
        bench.ecu.monitor.n_queue = LPVG_NBINS + 1U;
    } else {
        bench.ecu.control.x[0][0] = std::numeric_limits<lpvg_real_t>::infinity();
    }
    bench.step();  // the one with the fifth DM1
    CHECK(bench.ecu.refused);
    CHECK(bench.report.supervision == static_cast<float>(lpvg_can_state_off));
    CHECK(bench.spn == LPVG_ECU_SPN_REFUSED);
    CHECK(bench.fmi == 2U);
    CHECK(bench.ecu.occurrence == 126U);
    CHECK(bench.ecu.control.engaged == of_monitor);
    bench.step();
    CHECK(bench.live());  // both start anew at once
    CHECK((bench.ecu.causes & ~(LPVG_ECU_CAUSE_WAIT | LPVG_ECU_CAUSE_UNJUDGED)) == LPVG_ECU_CAUSE_REFUSED);
    CHECK_FALSE(bench.engaged());
    bench.step();
    CHECK((bench.ecu.causes & LPVG_ECU_CAUSE_REFUSED) == 0U);
}

TEST_CASE("arguments and times that are wrong change and send nothing", "[unit][ecu][REQ-ECU-6]") {
    Bench bench;
    bench.run(60);
    const lpvg_ecu_t before = bench.ecu;
    const int64_t now_us = bench.k * tick_us;
    lpvg_can_frame_t out[LPVG_ECU_FRAMES_OUT];
    size_t n = 7U;
    CHECK(lpvg_ecu_step(nullptr, now_us, nullptr, 0, out, 2, &n) == lpvg_status_bad_argument);
    CHECK(n == 0U);
    CHECK(lpvg_ecu_step(&bench.ecu, now_us, nullptr, 1, out, 2, &n) == lpvg_status_bad_argument);
    CHECK(lpvg_ecu_step(&bench.ecu, now_us, nullptr, 0, nullptr, 2, &n) == lpvg_status_bad_argument);
    CHECK(lpvg_ecu_step(&bench.ecu, now_us, nullptr, 0, out, LPVG_ECU_FRAMES_OUT - 1U, &n) == lpvg_status_bad_argument);
    CHECK(lpvg_ecu_step(&bench.ecu, now_us, nullptr, 0, out, 2, nullptr) == lpvg_status_bad_argument);
    CHECK(std::memcmp(&before, &bench.ecu, sizeof before) == 0);
    CHECK(lpvg_ecu_step(&bench.ecu, now_us - tick_us, nullptr, 0, out, 2, &n) == lpvg_status_out_of_order);
    CHECK(lpvg_ecu_step(&bench.ecu, std::numeric_limits<int64_t>::min(), nullptr, 0, out, 2, &n) == lpvg_status_out_of_order);
    CHECK(bench.ecu.clock.refused == 2U);
    bench.ecu.clock = before.clock;
    CHECK(std::memcmp(&before, &bench.ecu, sizeof before) == 0);
    lpvg_ecu_t cleared{};
    CHECK(lpvg_ecu_step(&cleared, now_us, nullptr, 0, out, 2, &n) == lpvg_status_not_ready);
}

TEST_CASE("init refuses what it documents and leaves the object alone", "[unit][ecu][REQ-ECU-6]") {
    lpvg_ecu_t ecu, before;
    std::memset(&ecu, 0xA5, sizeof ecu);
    std::memcpy(&before, &ecu, sizeof ecu);
    const auto refused = [&](const lpvg_coeff_t* coeff, const lpvg_control_coeff_t* control, const lpvg_ecu_config_t* with,
                             int64_t now_us) {
        const lpvg_status_t status = lpvg_ecu_init(&ecu, coeff, control, with, now_us);
        CHECK(std::memcmp(&ecu, &before, sizeof ecu) == 0);
        return status;
    };
    CHECK(lpvg_ecu_init(nullptr, &lpvg_coeff, &lpvg_control_coeff, &config, 0) == lpvg_status_bad_argument);
    CHECK(refused(nullptr, &lpvg_control_coeff, &config, 0) == lpvg_status_bad_argument);
    CHECK(refused(&lpvg_coeff, nullptr, &config, 0) == lpvg_status_bad_argument);
    CHECK(refused(&lpvg_coeff, &lpvg_control_coeff, nullptr, 0) == lpvg_status_bad_argument);
    CHECK(refused(&lpvg_coeff, &lpvg_control_coeff, &config, -1) == lpvg_status_bad_argument);
    CHECK(refused(&lpvg_coeff, &lpvg_control_coeff, &config, std::numeric_limits<int64_t>::max() / 2 + 1) == lpvg_status_bad_argument);
    lpvg_ecu_config_t wrong = config;
    wrong.report_only = LPVG_ECU_CAUSE_RANGE;
    CHECK(refused(&lpvg_coeff, &lpvg_control_coeff, &wrong, 0) == lpvg_status_bad_argument);
    wrong = config;
    wrong.plausibility.yaw_rps = 0.0F;
    CHECK(refused(&lpvg_coeff, &lpvg_control_coeff, &wrong, 0) == lpvg_status_bad_argument);
    lpvg_coeff_t model = lpvg_coeff;
    model.words.magic = 0U;
    CHECK(refused(&model, &lpvg_control_coeff, &config, 0) == lpvg_status_bad_magic);
    lpvg_control_coeff_t control = lpvg_control_coeff;
    control.reals.BL[0][0][0][0] += lpvg_real_t(1);
    CHECK(refused(&lpvg_coeff, &control, &config, 0) == lpvg_status_bad_crc);
    control = lpvg_control_coeff;
    control.words.sample_period_us *= 2U;
    control.words.crc32 = lpvg_control_coeff_crc32(&control);
    CHECK(refused(&lpvg_coeff, &control, &config, 0) == lpvg_status_bad_value);
    model = lpvg_coeff;
    model.words.sample_period_us = control.words.sample_period_us = LPVG_ECU_WINDOW_US / 4U + 1U;
    model.words.crc32 = lpvg_coeff_crc32(&model);
    control.words.crc32 = lpvg_control_coeff_crc32(&control);
    REQUIRE(lpvg_coeff_check(&model) == lpvg_status_ok);
    CHECK(refused(&model, &control, &config, 0) == lpvg_status_bad_value);
}

TEST_CASE("init leaves nothing of what was there, and nothing is known of the bus", "[unit][ecu][REQ-ECU-1][REQ-ECU-6]") {
    lpvg_ecu_t ecu, other;
    std::memset(&ecu, 0xA5, sizeof ecu);
    std::memset(&other, 0, sizeof other);
    const int64_t now_us = 5'000'000;
    REQUIRE(lpvg_ecu_init(&ecu, &lpvg_coeff, &lpvg_control_coeff, &config, now_us) == lpvg_status_ok);
    REQUIRE(lpvg_ecu_init(&other, &lpvg_coeff, &lpvg_control_coeff, &config, now_us) == lpvg_status_ok);
    CHECK(std::memcmp(&ecu, &other, sizeof ecu) == 0);
    const lpvg_bus_signals_t& s = ecu.signals;
    CHECK(std::isnan(s.speed));
    CHECK(std::isnan(s.reference));
    for (const lpvg_real_t y : s.y) {
        CHECK(std::isnan(y));
    }
    for (const float x :
         {s.yaw_rate, s.lateral, s.wheel_difference, s.brake_pedal, s.abs_active, s.measured, s.request, s.other_priority}) {
        CHECK(std::isnan(x));
    }
    CHECK(ecu.now_us == now_us);
    CHECK(ecu.core_us == now_us);
    CHECK(ecu.explained == LPVG_CAN_FMI_CONDITION);
    lpvg_real_t largest = lpvg_real_t(0);
    for (const auto& node : lpvg_control_coeff.reals.u_max) {
        largest = std::max(largest, node[0]);
    }
    CHECK(ecu.kept.u_max[0] == largest);
    CHECK(ecu.kept.rate_max[0] == lpvg_control_coeff.reals.rate_max[0]);
    lpvg_control_coeff_t control = lpvg_control_coeff;
    control.reals.u_max[1][0] = lpvg_real_t(2) * largest;  // neither the first node's nor the last one's
    control.words.crc32 = lpvg_control_coeff_crc32(&control);
    REQUIRE(lpvg_ecu_init(&other, &lpvg_coeff, &control, &config, now_us) == lpvg_status_ok);
    CHECK(other.kept.u_max[0] == lpvg_real_t(2) * largest);
    // The first step may come at once: it tells DM1, and waits for nothing.
    lpvg_can_frame_t out[LPVG_ECU_FRAMES_OUT];
    size_t n = 0U;
    REQUIRE(lpvg_ecu_step(&ecu, now_us, nullptr, 0, out, LPVG_ECU_FRAMES_OUT, &n) == lpvg_status_ok);
    CHECK(n == 2U);
    CHECK_FALSE(ecu.kept.corrupt);
    CHECK((ecu.causes & LPVG_ECU_CAUSE_WAIT) == 0U);
    CHECK(lpvg_ecu_init(&ecu, &lpvg_coeff, &lpvg_control_coeff, &config, std::numeric_limits<int64_t>::max() / 2) == lpvg_status_ok);
}

TEST_CASE("the longest sample period is a quarter of the window, and both periods are one", "[unit][ecu][REQ-ECU-6]") {
    lpvg_coeff_t model = lpvg_coeff;
    lpvg_control_coeff_t control = lpvg_control_coeff;
    model.words.sample_period_us = control.words.sample_period_us = LPVG_ECU_WINDOW_US / 4U;
    model.words.crc32 = lpvg_coeff_crc32(&model);
    control.words.crc32 = lpvg_control_coeff_crc32(&control);
    lpvg_ecu_t ecu;
    CHECK(lpvg_ecu_init(&ecu, &model, &control, &config, 0) == lpvg_status_ok);
    CHECK(lpvg_ecu_init(&ecu, &model, &lpvg_control_coeff, &config, 0) == lpvg_status_bad_value);
}

TEST_CASE("only the optional causes may be reported only", "[unit][ecu][REQ-ECU-6]") {
    lpvg_ecu_t ecu;
    lpvg_ecu_config_t with = config;
    for (unsigned bit = 0U; bit < 16U; ++bit) {
        with.report_only = static_cast<uint16_t>(1U << bit);
        const bool optional = (with.report_only & LPVG_ECU_CAUSES_OPTIONAL) != 0U;
        CHECK((lpvg_ecu_init(&ecu, &lpvg_coeff, &lpvg_control_coeff, &with, 0) == lpvg_status_ok) == optional);
    }
    with.report_only = LPVG_ECU_CAUSES_OPTIONAL;
    CHECK(lpvg_ecu_init(&ecu, &lpvg_coeff, &lpvg_control_coeff, &with, 0) == lpvg_status_ok);
}

TEST_CASE("of a step's frames the newest are taken, and those before them are counted", "[unit][ecu][REQ-ECU-6]") {
    const std::size_t n = LPVG_ECU_FRAMES_IN + GENERATE(range(0U, 5U)) - 1U, dropped = n > LPVG_ECU_FRAMES_IN ? n - LPVG_ECU_FRAMES_IN : 0U;
    Bench bench;
    bench.run_until_engaged();
    while (bench.k % 10 != 5) {  // a step with two frames
        bench.step();
    }
    const uint32_t before = bench.ecu.dropped;
    bench.filter = [&](std::vector<lpvg_can_frame_t> frames) {
        lpvg_can_frame_t off{}, unknown{};
        off.id = LPVG_CAN_ERROR | LPVG_CAN_BUS_OFF;
        unknown.t_us = off.t_us = frames.front().t_us;
        frames.insert(frames.begin(), n - frames.size(), unknown);
        std::fill_n(frames.begin(), dropped, off);
        return frames;
    };
    bench.step();
    CHECK(bench.ecu.dropped == before + dropped);
    CHECK(bench.engaged());  // those that say bus-off are not taken
}

TEST_CASE("of messages that stand equally badly the first of the table is told", "[unit][ecu][REQ-ECU-2]") {
    Bench bench;
    bench.run_until_engaged();
    bench.send_vdc2 = bench.send_guard_in = bench.send_ebc1 = bench.send_ebc2 = false;
    bench.run(300);
    CHECK(bench.spn == lpvg_bus.needed[0].spn);
}
