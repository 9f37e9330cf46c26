// What the ECU tells of its findings to the module that reports them over J1939.
#include "ecu_bench.hpp"
#include "lpvguard/j1939.h"

namespace {

lpvg_j1939_findings_t findings_of(const lpvg_ecu_t& ecu) {
    lpvg_j1939_findings_t findings;
    REQUIRE(lpvg_ecu_findings(&ecu, &findings) == lpvg_status_ok);
    return findings;
}

std::vector<uint32_t> spns(const lpvg_j1939_findings_t& findings) {
    std::vector<uint32_t> all;
    for (uint8_t i = 0U; i < findings.n_codes; ++i) {
        all.push_back(findings.code[i].spn);
    }
    return all;
}

}  // namespace

TEST_CASE("nothing is found of a vehicle without fault", "[unit][ecu][REQ-J1939-10]") {
    Bench bench;
    bench.clock_off_us = 5'000;
    bench.run_until_engaged();
    const lpvg_j1939_findings_t findings = findings_of(bench.ecu);
    CHECK(findings.n_codes == 0U);
    CHECK(findings.freeze.causes == 0U);
    CHECK(findings.freeze.t_us == bench.now_us + 5'000);
    CHECK(findings.freeze.speed == Approx(12.0F).margin(0.01));
    CHECK(findings.freeze.statistic == static_cast<float>(bench.ecu.monitor.frame.statistic));
}

TEST_CASE("every message that is not live has a code of its own", "[unit][ecu][REQ-J1939-10]") {
    Bench bench;
    bench.run_until_engaged();
    bench.send_vdc2 = false;
    bench.spoil_guard_in = true;
    bench.run(20);
    const lpvg_j1939_findings_t findings = findings_of(bench.ecu);
    REQUIRE(spns(findings) == std::vector<uint32_t>{520192U, 1808U});
    CHECK(findings.code[0].fmi == LPVG_CAN_FMI_NETWORK);
    CHECK(findings.code[1].fmi == LPVG_CAN_FMI_UPDATE_RATE);
    CHECK((findings.freeze.causes & LPVG_ECU_CAUSE_MESSAGE) != 0U);
}

TEST_CASE("all findings are named, the gravest first", "[unit][ecu][REQ-J1939-10]") {
    Bench bench;
    bench.run_until_engaged();
    lpvg_ecu_t& ecu = bench.ecu;
    ecu.kept.corrupt = ecu.refused = ecu.actuator_failed = ecu.kept.locked = true;
    ecu.clock.pace = lpvg_ecu_pace_bad;
    ecu.report.verdict = lpvg_verdict_invalid;
    ecu.plausibility.flags = LPVG_CAN_IMPLAUSIBLE_WHEELS;
    std::vector<uint32_t> all = {LPVG_ECU_SPN_CORRUPT,  LPVG_ECU_SPN_REFUSED,     LPVG_ECU_SPN_TIME,  LPVG_ECU_SPN_INVALID,
                                 LPVG_ECU_SPN_ACTUATOR, LPVG_ECU_SPN_IMPLAUSIBLE, LPVG_ECU_SPN_LOCKED};
    CHECK(spns(findings_of(ecu)) == all);
    ecu.report.verdict = lpvg_verdict_degraded;  // instead of invalid, and the least grave
    std::vector<uint32_t> changed = all;
    changed.erase(changed.begin() + 3);
    changed.push_back(LPVG_ECU_SPN_DEGRADED);
    CHECK(spns(findings_of(ecu)) == changed);
    CHECK(findings_of(ecu).code[changed.size() - 1U].fmi == LPVG_CAN_FMI_CONDITION);
    ecu.report.verdict = lpvg_verdict_invalid;
    for (lpvg_can_watch_t& watch : ecu.supervisor.watch) {
        watch.state = lpvg_can_state_off;
    }
    all.insert(all.begin() + 3, {904U, 520192U, 1808U, 563U});
    CHECK(spns(findings_of(ecu)) == all);
    ecu.seen_live = false;  // the bus has not come up yet
    all.erase(all.begin() + 3, all.begin() + 7);
    CHECK(spns(findings_of(ecu)) == all);
}

TEST_CASE("every finding has the failure mode of its cause, and the count of occurrences", "[unit][ecu][REQ-J1939-10]") {
    Bench bench;
    bench.run_until_engaged();
    lpvg_ecu_t& ecu = bench.ecu;
    ecu.kept.corrupt = ecu.refused = ecu.actuator_failed = ecu.kept.locked = true;
    ecu.clock.pace = lpvg_ecu_pace_bad;
    ecu.report.verdict = lpvg_verdict_invalid;
    ecu.plausibility.flags = LPVG_CAN_IMPLAUSIBLE_WHEELS;
    ecu.occurrence = 17U;
    const lpvg_j1939_findings_t findings = findings_of(ecu);
    const std::vector<uint8_t> modes = {LPVG_CAN_FMI_BAD_DEVICE, LPVG_CAN_FMI_ERRATIC, LPVG_CAN_FMI_UPDATE_RATE, LPVG_CAN_FMI_CONDITION,
                                        LPVG_CAN_FMI_RESPONSE,   LPVG_CAN_FMI_ERRATIC, LPVG_CAN_FMI_CONDITION};
    REQUIRE(findings.n_codes == modes.size());
    for (std::size_t i = 0; i < modes.size(); ++i) {
        CAPTURE(i);
        CHECK(findings.code[i].fmi == modes[i]);
        CHECK(findings.code[i].occurrence == 17U);
    }
    ecu.report.verdict = lpvg_verdict_degraded;
    for (lpvg_can_watch_t& watch : ecu.supervisor.watch) {
        watch.state = lpvg_can_state_off;
    }
    const lpvg_j1939_findings_t more = findings_of(ecu);
    REQUIRE(more.n_codes == modes.size() + lpvg_bus.n_needed);
    for (uint8_t i = 0U; i < more.n_codes; ++i) {
        CAPTURE(i);
        CHECK(more.code[i].occurrence == 17U);
    }
}

TEST_CASE("a missing key is the least grave finding, and DM1 says it", "[unit][ecu][REQ-AUTH-4][REQ-J1939-10]") {
    lpvg_ecu_config_t config = bench_config;
    config.authenticated = false;
    Bench bench(config);
    bench.run_until_engaged();
    bench.run(100);
    CHECK(bench.engaged());
    CHECK(bench.spn == LPVG_ECU_SPN_KEYLESS);
    CHECK(bench.fmi == LPVG_CAN_FMI_CONDITION);
    CHECK(bench.lamps == LPVG_CAN_LAMP_AMBER);
    lpvg_ecu_t& ecu = bench.ecu;
    CHECK(spns(findings_of(ecu)) == std::vector<uint32_t>{LPVG_ECU_SPN_KEYLESS});
    ecu.report.verdict = lpvg_verdict_degraded;
    CHECK(spns(findings_of(ecu)) == std::vector<uint32_t>{LPVG_ECU_SPN_DEGRADED, LPVG_ECU_SPN_KEYLESS});
}

TEST_CASE("the freeze frame has the caller's time, behind a jump too", "[unit][ecu][REQ-J1939-10]") {
    Bench bench;
    bench.run_until_engaged();
    bench.clock_off_us = 3'000'000;
    for (uint32_t i = 0U; i < LPVG_ECU_RESYNC_CALLS; ++i) {
        bench.step_at(bench.k * tick_us);
        ++bench.k;
    }
    REQUIRE(bench.status == lpvg_status_ok);
    REQUIRE(bench.ecu.core_us != bench.ecu.now_us);
    CHECK(findings_of(bench.ecu).freeze.t_us == bench.now_us + bench.clock_off_us);
}

TEST_CASE("an alarm's code has the failure mode of the cause that was found", "[unit][ecu][REQ-J1939-13]") {
    struct Case {
        lpvg_cause_t cause;
        float value;
        uint8_t fmi;
    };
    const Case cases[] = {
        {lpvg_cause_unknown, 0.0F, 31U}, {lpvg_cause_other, 0.0F, 11U}, {lpvg_cause_gain, 0.7F, 13U}, {lpvg_cause_sign, -1.0F, 13U},
        {lpvg_cause_delay, 0.2F, 9U},    {lpvg_cause_bias, 0.1F, 20U},  {lpvg_cause_bias, 0.0F, 21U}, {lpvg_cause_bias, -0.1F, 21U},
        {lpvg_cause_frozen, 0.1F, 10U},  {lpvg_cause_noise, 0.1F, 2U},
    };
    Bench bench;
    bench.run_until_engaged();
    lpvg_ecu_t& ecu = bench.ecu;
    lpvg_ecu_explain(nullptr, nullptr);
    for (const lpvg_verdict_t verdict : {lpvg_verdict_invalid, lpvg_verdict_degraded}) {
        for (const Case& test : cases) {
            CAPTURE(test.cause, test.value);
            lpvg_found_t found{};
            found.cause = test.cause;
            found.value = test.value;
            ecu.report.verdict = static_cast<uint8_t>(verdict);
            lpvg_ecu_explain(&ecu, &found);
            REQUIRE(findings_of(ecu).n_codes == 1U);
            CHECK(findings_of(ecu).code[0].fmi == test.fmi);
            lpvg_ecu_explain(&ecu, nullptr);
            CHECK(findings_of(ecu).code[0].fmi == 31U);
        }
    }
}

TEST_CASE("the freeze frame of an alarm is its record's", "[unit][ecu][REQ-J1939-10]") {
    Bench bench;
    bench.run_until_engaged();
    lpvg_ecu_t& ecu = bench.ecu;
    ecu.monitor.frame.bin = 2U;
    ecu.monitor.frame.statistic = 0.25F;
    ecu.monitor.record[0].bin = 4U;
    ecu.monitor.record[1].bin = 5U;
    ecu.monitor.record[1].statistic = 1.75F;
    ecu.monitor.record[1].test = lpvg_test_energy;
    ecu.monitor.n_records = 2U;
    CHECK(findings_of(ecu).freeze.bin == 2U);  // no test alarms now
    ecu.report.verdict = GENERATE(lpvg_verdict_invalid, lpvg_verdict_degraded);
    CHECK(findings_of(ecu).freeze.bin == 5U);
    CHECK(findings_of(ecu).freeze.test == lpvg_test_energy);
    CHECK(findings_of(ecu).freeze.statistic == 1.75F);
    ecu.monitor.n_records = LPVG_NRECORDS;  // as many as there are places
    ecu.monitor.record[LPVG_NRECORDS - 1U].bin = 3U;
    CHECK(findings_of(ecu).freeze.bin == 3U);
    for (const uint32_t n : {0U, static_cast<uint32_t>(LPVG_NRECORDS) + 1U}) {  // read out; damaged
        ecu.monitor.n_records = n;
        CHECK(findings_of(ecu).freeze.bin == 2U);
        CHECK(findings_of(ecu).freeze.test == lpvg_test_frame);
        CHECK(findings_of(ecu).freeze.statistic == 0.25F);
    }
}

TEST_CASE("a lost message reaches the bus as a code with its freeze frame", "[unit][ecu][REQ-J1939-10]") {
    Bench bench;
    bench.run_until_engaged();
    lpvg_j1939_memory_t memory{};
    lpvg_j1939_t j1939;
    const lpvg_j1939_config_t config = {1U, lpvg_bus.own_address};
    REQUIRE(lpvg_j1939_init(&j1939, &config, &memory, bench.now_us, nullptr) == lpvg_status_ok);
    bench.send_vdc2 = false;
    int dm1_steps = -1;
    for (int i = 0; i < 10; ++i) {
        bench.step();
        const lpvg_j1939_findings_t findings = findings_of(bench.ecu);
        lpvg_can_frame_t out[LPVG_J1939_FRAMES_OUT];
        size_t n = 0U;
        REQUIRE(lpvg_j1939_step(&j1939, bench.now_us, bench.handed.data(), bench.handed.size(), &findings, out, LPVG_J1939_FRAMES_OUT,
                                &n) == lpvg_status_ok);
        const bool told = n > 0U && out[n - 1U].id == (LPVG_CAN_EXTENDED | 0x18FECAFCU) && out[n - 1U].data[2] == 0x10U;
        dm1_steps = told && dm1_steps < 0 ? i : dm1_steps;
    }
    CHECK(dm1_steps == 3);  // in the step in which the message is on hold
    const lpvg_j1939_entry_t* entry = lpvg_j1939_entry(&j1939, 0U);
    REQUIRE(entry != nullptr);
    CHECK(entry->spn == 1808U);
    CHECK((entry->freeze.causes & LPVG_ECU_CAUSE_MESSAGE) != 0U);
    CHECK(entry->freeze.t_us == bench.now_us - 6 * tick_us);
}

TEST_CASE("a message that is not live has the failure mode of the rejection seen most of, the first of equals",
          "[unit][ecu][REQ-J1939-10]") {
    Bench bench;
    bench.run_until_engaged();
    lpvg_can_watch_t& watch = bench.ecu.supervisor.watch[lpvg_bus.needed[0].index];
    watch.state = lpvg_can_state_hold;
    const auto mode = [&] {
        const lpvg_j1939_findings_t findings = findings_of(bench.ecu);
        REQUIRE(findings.n_codes == 1U);
        return findings.code[0].fmi;
    };
    for (uint32_t& count : watch.count) {
        count = 7U;  // those before `early` and behind `gradient` are no rejections
    }
    watch.window_bad = 0U;
    CHECK(mode() == lpvg_can_fmi(lpvg_can_event_missed));
    watch.window_bad = 1U;
    for (int event = lpvg_can_event_early; event <= lpvg_can_event_gradient; ++event) {
        watch.count[event] = 0U;
    }
    CHECK(mode() == lpvg_can_fmi(lpvg_can_event_early));
    for (int event = lpvg_can_event_early; event <= lpvg_can_event_gradient; ++event) {
        CAPTURE(event);
        watch.count[event] = 1U;
        CHECK(mode() == lpvg_can_fmi(static_cast<lpvg_can_event_t>(event)));
        for (int later = event + 1; later <= lpvg_can_event_gradient; ++later) {
            watch.count[later] = 1U;
        }
        CHECK(mode() == lpvg_can_fmi(static_cast<lpvg_can_event_t>(event)));
        for (int other = lpvg_can_event_early; other <= lpvg_can_event_gradient; ++other) {
            watch.count[other] = 0U;
        }
    }
}

TEST_CASE("findings need an ECU that was made ready", "[unit][ecu][REQ-J1939-10]") {
    lpvg_ecu_t ecu;
    std::memset(&ecu, 0, sizeof ecu);
    lpvg_j1939_findings_t findings{};
    findings.n_codes = 9U;
    CHECK(lpvg_ecu_findings(&ecu, &findings) == lpvg_status_not_ready);
    CHECK(lpvg_ecu_findings(nullptr, &findings) == lpvg_status_bad_argument);
    CHECK(lpvg_ecu_findings(&ecu, nullptr) == lpvg_status_bad_argument);
    CHECK(findings.n_codes == 9U);
}
