// What the ECU finds of damage to its own memory, and what it does then. Every single bit: tests/fault/test_flips.cpp.
#include "ecu_bench.hpp"

namespace {

Bench engaged_bench(const lpvg_coeff_t& coeff = lpvg_coeff, const lpvg_control_coeff_t& control = lpvg_control_coeff) {
    Bench bench(bench_config, coeff, control);
    bench.run_until_engaged();
    bench.run(150);
    REQUIRE(std::fabs(bench.ecu.kept.demand) > lpvg_real_t(0.1));
    return bench;
}

// Released for good, told, and neither asking nor acknowledging helps.
void check_dead(Bench& bench) {
    bench.run(120);
    CHECK_FALSE(bench.engaged());
    CHECK(bench.report.demand == Approx(0.0F).margin(0.0003));
    CHECK(bench.report.verdict == static_cast<float>(lpvg_verdict_fault));
    CHECK(bench.spn == LPVG_ECU_SPN_CORRUPT);
    CHECK(bench.fmi == LPVG_CAN_FMI_BAD_DEVICE);
    lpvg_ecu_engage(&bench.ecu, true);
    (void)lpvg_ecu_acknowledge(&bench.ecu);
    bench.run(120);
    CHECK_FALSE(bench.engaged());
    CHECK((bench.ecu.causes & LPVG_ECU_CAUSE_CORRUPT) != 0U);
}

}  // namespace

TEST_CASE("damaged coefficients of either kind release by the kept rate", "[unit][ecu][REQ-ECU-15]") {
    const bool of_model = GENERATE(false, true);
    lpvg_coeff_t model = lpvg_coeff;
    lpvg_control_coeff_t control = lpvg_control_coeff;
    Bench bench = engaged_bench(model, control);
    if (of_model) {
        model.reals.threshold *= lpvg_real_t(2);
    } else {
        control.reals.rate_max[0] *= lpvg_real_t(2);
    }
    auto before = static_cast<double>(bench.ecu.kept.demand);
    std::size_t wrong = 0;
    int steps = 0;
    for (; !bench.ecu.kept.corrupt && steps < 2000; ++steps) {
        bench.step();
        const auto now = static_cast<double>(bench.ecu.kept.demand);
        wrong += std::fabs(now - before) > 1.001 * static_cast<double>(lpvg_control_coeff.reals.rate_max[0]) * 0.01 ? 1U : 0U;
        before = now;
    }
    CHECK(wrong == 0U);
    CHECK(steps * tick_us <= 2 * static_cast<int64_t>(LPVG_ECU_ROUND_US) + tick_us);
    CHECK(std::fabs(before) > 0.0);  // it runs down
    check_dead(bench);
}

TEST_CASE("one damaged copy of what is kept still gives the rate to release by, none gives zero at once", "[unit][ecu][REQ-ECU-15]") {
    const int which = GENERATE(0, 1, 2);
    Bench bench = engaged_bench();
    const auto before = static_cast<double>(bench.ecu.kept.demand);
    if (which != 1) {
        bench.ecu.kept.rate_max *= lpvg_real_t(-3);
        bench.ecu.kept.coeff = nullptr;
    }
    if (which != 0) {
        bench.ecu.inverted[4] ^= 1U;
    }
    lpvg_ecu_engage(&bench.ecu, true);  // seals no damage
    CHECK_FALSE(lpvg_ecu_acknowledge(&bench.ecu));
    bench.step();
    const auto now = static_cast<double>(bench.ecu.kept.demand);
    const double left = std::fmax(std::fabs(before) - static_cast<double>(lpvg_control_coeff.reals.rate_max[0]) * 0.01, 0.0);
    CHECK(std::fabs(now) == Approx(which == 2 ? 0.0 : left).margin(1e-6));
    CHECK(bench.ecu.kept.corrupt);
    check_dead(bench);
}

TEST_CASE("a demand beyond the kept limits does not leave the ECU", "[unit][ecu][REQ-ECU-15][REQ-CTL-2]") {
    const int sign = GENERATE(-1, 1);
    const bool only_rate = GENERATE(false, true);
    lpvg_control_coeff_t control = lpvg_control_coeff;
    Bench bench = engaged_bench(lpvg_coeff, control);
    for (auto& node : control.reals.u_max) {
        node[0] = only_rate ? node[0] : lpvg_real_t(1e9);
    }
    control.reals.rate_max[0] = lpvg_real_t(1e12);
    bench.ecu.control.x[0][0] = static_cast<lpvg_real_t>(sign * 121);
    const auto before = static_cast<double>(bench.ecu.kept.demand);
    bench.step();
    CHECK(std::fabs(static_cast<double>(bench.ecu.kept.demand)) <= std::fabs(before));
    CHECK(bench.ecu.kept.corrupt);
    check_dead(bench);
}

TEST_CASE("a sample period of zero in one copy is taken from the other", "[unit][ecu][REQ-ECU-15]") {
    Bench bench = engaged_bench();
    bench.ecu.kept.period_us = 0U;
    bench.step();
    CHECK(bench.ecu.kept.period_us == lpvg_coeff.words.sample_period_us);
    CHECK(bench.ecu.kept.corrupt);
    check_dead(bench);
}

TEST_CASE("a place in the coefficients behind their end begins the round anew", "[unit][ecu][REQ-ECU-15]") {
    Bench bench = engaged_bench();
    bench.ecu.next_item = UINT32_MAX;
    bench.run(2 * static_cast<int>(LPVG_ECU_ROUND_US) / static_cast<int>(tick_us));
    CHECK(bench.ecu.rounds >= 1U);
    CHECK_FALSE(bench.ecu.kept.corrupt);
}

TEST_CASE("the count of frames that are too many does not wrap", "[unit][ecu][REQ-ECU-6]") {
    Bench bench;
    bench.ecu.dropped = UINT32_MAX - 1U;
    bench.frames.resize(LPVG_ECU_FRAMES_IN);
    bench.step();
    CHECK(bench.ecu.dropped == UINT32_MAX);
}

TEST_CASE("state of the ECU that cannot be is damage", "[unit][ecu][REQ-ECU-15]") {
    const int which = GENERATE(range(0, 12));
    Bench bench = engaged_bench();
    const lpvg_coeff_t other = lpvg_coeff;
    const lpvg_control_coeff_t other_control = lpvg_control_coeff;
    lpvg_ecu_t& ecu = bench.ecu;
    switch (which) {
        case 0: ecu.monitor.coeff = &other; break;
        case 1: ecu.control.coeff = &other_control; break;
        case 2: ecu.supervisor.rules = nullptr; break;
        case 3: ecu.supervisor.n_rules = 200U; break;
        case 4: ecu.supervisor.now_us += int64_t{1} << 40; break;
        case 5: ecu.dm1_us += int64_t{1} << 40; break;
        case 6: ecu.dm1_us -= int64_t{1} << 40; break;
        case 7: ecu.control.u[0] = lpvg_real_t(-121); break;
        case 8: ecu.control.u[0] = lpvg_real_t(121); break;
        case 9:
            ecu.counter = 2U * LPVG_CAN_COUNTERS;
            bench.reports = 0;
            break;
        case 10: ecu.monitor.t_us += int64_t{1} << 24; break;
        default: ecu.occurrence = 127U; break;
    }
    bench.step();
    CHECK(ecu.kept.corrupt);
    check_dead(bench);
}
