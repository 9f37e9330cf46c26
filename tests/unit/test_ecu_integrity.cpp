// What the ECU finds of damage to its own memory, and what it does then. Every single bit: tests/fault/test_flips.cpp.
#include "ecu_bench.hpp"

#include <algorithm>
#include <cstddef>
#include <cstdint>
#include <cstring>
#include <iterator>
#include <limits>
#include <utility>

#include "monitor/acceptance.hpp"

namespace {

Bench engaged_bench(const lpvg_coeff_t& coeff = lpvg_coeff, const lpvg_control_coeff_t& control = lpvg_control_coeff) {
    Bench bench(bench_config, coeff, control);
    bench.run_until_engaged();
    bench.run(150);
    REQUIRE(std::fabs(bench.ecu.kept.demand[0]) > lpvg_real_t(0.1));
    return bench;
}

// Released for good, told, and neither asking nor acknowledging helps.
void check_dead(Bench& bench) {
    const int told = bench.dm1s;
    bench.run(120);
    CHECK(bench.dm1s - told <= 2);  // once a second, as ever
    CHECK_FALSE(bench.engaged());
    CHECK_FALSE(bench.ecu.permitted);
    CHECK(bench.report.demand == Approx(0.0F).margin(0.0003));
    CHECK(bench.report.verdict == static_cast<float>(lpvg_verdict_fault));
    CHECK(bench.spn == LPVG_ECU_SPN_CORRUPT);
    CHECK(bench.fmi == LPVG_CAN_FMI_BAD_DEVICE);
    lpvg_ecu_engage(&bench.ecu, true);
    (void)lpvg_ecu_acknowledge(&bench.ecu);
    bench.run(120);
    CHECK_FALSE(bench.engaged());
    CHECK((bench.ecu.causes & (LPVG_ECU_CAUSE_CORRUPT | LPVG_ECU_CAUSE_NOT_ASKED)) == LPVG_ECU_CAUSE_CORRUPT);
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
    bench.command = 0.12F;  // for a demand that takes more than a step to run down
    auto before = static_cast<double>(bench.ecu.kept.demand[0]);
    std::size_t wrong = 0;
    int steps = 0;
    for (; !bench.ecu.kept.corrupt && steps < 2000; ++steps) {
        bench.step();
        const auto now = static_cast<double>(bench.ecu.kept.demand[0]);
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
    const auto before = static_cast<double>(bench.ecu.kept.demand[0]);
    if (which != 1) {
        bench.ecu.kept.rate_max[0] *= lpvg_real_t(-3);
        bench.ecu.kept.coeff = nullptr;
    }
    if (which != 0) {
        bench.ecu.inverted[offsetof(lpvg_ecu_kept_t, rate_max) / sizeof(uint32_t)] ^= 0x80000000U;
    }
    lpvg_ecu_engage(&bench.ecu, true);  // seals no damage
    CHECK_FALSE(lpvg_ecu_acknowledge(&bench.ecu));
    bench.step();
    const auto now = static_cast<double>(bench.ecu.kept.demand[0]);
    const double left = std::fmax(std::fabs(before) - static_cast<double>(lpvg_control_coeff.reals.rate_max[0]) * 0.01, 0.0);
    CHECK(std::fabs(now) == Approx(which == 2 ? 0.0 : left).margin(1e-6));
    CHECK(bench.ecu.kept.corrupt);
    if (which == 2) {
        CHECK(bench.ecu.kept.rate_max[0] == lpvg_real_t(0));
        CHECK(bench.ecu.kept.period_us == 10'000U);
        CHECK_FALSE(bench.ecu.kept.engage);
    }
    CHECK(bench.ecu.sum == lpvguard::sum_of_words(bench.ecu.kept));
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
    const auto before = static_cast<double>(bench.ecu.kept.demand[0]);
    bench.step();
    const double left = std::fmax(std::fabs(before) - static_cast<double>(lpvg_control_coeff.reals.rate_max[0]) * 0.01, 0.0);
    CHECK(std::fabs(static_cast<double>(bench.ecu.kept.demand[0])) == Approx(left).margin(1e-6));
    CHECK(bench.ecu.control.u[0] == bench.ecu.kept.demand[0]);
    CHECK_FALSE(bench.engaged());
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
    const uint32_t room = GENERATE(1U, 4U, 5U);
    Bench bench;
    bench.ecu.dropped = UINT32_MAX - room;
    bench.frames.resize(LPVG_ECU_FRAMES_IN);  // and the bench's own four
    bench.step();
    CHECK(bench.ecu.dropped == UINT32_MAX - (room > 4U ? room - 4U : 0U));
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
    CHECK(ecu.supervisor.now_us == ecu.core_us);
    CHECK(std::fabs(ecu.expected) < 3.0F);  // the actuator is not held against a demand that never was
    check_dead(bench);
}

TEST_CASE("state at the ends of what can be is none, and just beyond them is damage", "[unit][ecu][REQ-ECU-15]") {
    const int which = GENERATE(range(0, 12));
    const bool beyond = GENERATE(false, true);
    CAPTURE(which, beyond);
    Bench bench = engaged_bench();
    lpvg_ecu_t& ecu = bench.ecu;
    const int64_t dm1_us = 1'000'000;
    const lpvg_real_t infinity = std::numeric_limits<lpvg_real_t>::infinity();
    switch (which) {
        case 0: ecu.dm1_us = ecu.core_us + (beyond ? 1 : 0); break;
        case 1: ecu.dm1_us = ecu.core_us - 2 * dm1_us - (beyond ? 1 : 0); break;
        case 2: ecu.monitor.t_us = ecu.core_us + (beyond ? 1 : 0); break;
        case 3: ecu.supervisor.now_us = ecu.core_us + (beyond ? 1 : 0); break;
        case 4: ecu.supervisor.now_us = ecu.core_us - (beyond ? 1 : 0); break;
        case 5: ecu.control.u[0] = beyond ? std::nextafter(ecu.kept.demand[0], infinity) : ecu.kept.demand[0]; break;
        case 6: ecu.control.u[0] = beyond ? std::nextafter(ecu.kept.demand[0], -infinity) : ecu.kept.demand[0]; break;
        case 7:
            bench.reports = ecu.counter = static_cast<uint8_t>(LPVG_CAN_COUNTERS - 1U);
            if (beyond) {
                bench.reports = 0;  // whatever it was, it begins anew
                ecu.counter = static_cast<uint8_t>(LPVG_CAN_COUNTERS);
            }
            break;
        case 8: ecu.occurrence = beyond ? 127U : 126U; break;
        case 9: ecu.supervisor.n_rules = static_cast<uint8_t>(lpvg_bus.n_rules + (beyond ? 1U : 0U)); break;
        case 10: ecu.supervisor.n_rules = static_cast<uint8_t>(lpvg_bus.n_rules - (beyond ? 1U : 0U)); break;
        default: ecu.supervisor.rules = lpvg_bus.rules + (beyond ? 1 : 0); break;
    }
    const unsigned occurrence = ecu.occurrence;
    bench.step();
    CHECK(ecu.kept.corrupt == beyond);
    if (beyond) {
        CHECK(ecu.occurrence == std::min(occurrence + 1U, 126U));
        CHECK(ecu.supervisor.rules == lpvg_bus.rules);
        CHECK(ecu.supervisor.n_rules == lpvg_bus.n_rules);
        CHECK(ecu.supervisor.now_us == ecu.core_us);
        CHECK(bench.spn == LPVG_ECU_SPN_CORRUPT);  // told at once
        CHECK(ecu.control.u[0] == ecu.kept.demand[0]);
    }
}

namespace {

constexpr auto n_model = static_cast<uint32_t>(lpvguard::n_items<lpvg_coeff_t>);
constexpr auto n_all = static_cast<uint32_t>(n_model + lpvguard::n_items<lpvg_control_coeff_t>);

}  // namespace

TEST_CASE("a step checks as few coefficients as make a round shorter than its longest", "[unit][ecu][REQ-ECU-15]") {
    // Periods beside those at which one more item is due.
    constexpr uint64_t longest_us = LPVG_ECU_WINDOW_US / 4U, round_us = LPVG_ECU_ROUND_US;
    std::vector<uint32_t> periods = {10'000U, static_cast<uint32_t>(longest_us)};
    for (const auto& other :
         {std::pair<uint64_t, uint64_t>{n_all + 1U, round_us}, {n_all - 1U, round_us}, {n_all, round_us + 1U}, {n_all, round_us - 1U}}) {
        uint64_t us = 1'000U;
        while (us < longest_us && n_all * us / round_us == other.first * us / other.second) {
            ++us;
        }
        periods.push_back(static_cast<uint32_t>(us));
    }
    for (const uint32_t period_us : periods) {
        CAPTURE(n_all, period_us);
        lpvg_coeff_t model = lpvg_coeff;
        lpvg_control_coeff_t control = lpvg_control_coeff;
        model.words.sample_period_us = control.words.sample_period_us = period_us;
        model.words.crc32 = lpvg_coeff_crc32(&model);
        control.words.crc32 = lpvg_control_coeff_crc32(&control);
        lpvg_ecu_t ecu;
        REQUIRE(lpvg_ecu_init(&ecu, &model, &control, &bench_config, 0) == lpvg_status_ok);
        lpvg_can_frame_t out[LPVG_ECU_FRAMES_OUT];
        size_t n = 0U;
        REQUIRE(lpvg_ecu_step(&ecu, 0, nullptr, 0, out, LPVG_ECU_FRAMES_OUT, &n) == lpvg_status_ok);
        const uint64_t items = ecu.next_item;
        CHECK(items * LPVG_ECU_ROUND_US > static_cast<uint64_t>(n_all) * period_us);
        CHECK((items - 1U) * LPVG_ECU_ROUND_US <= static_cast<uint64_t>(n_all) * period_us);
        int64_t steps = 1;
        for (; ecu.rounds == 0U; ++steps) {
            REQUIRE(lpvg_ecu_step(&ecu, steps * period_us, nullptr, 0, out, LPVG_ECU_FRAMES_OUT, &n) == lpvg_status_ok);
        }
        CHECK(static_cast<uint64_t>(steps) == (n_all + items - 1U) / items);
        CHECK(ecu.next_item == 0U);
        CHECK_FALSE(ecu.kept.corrupt);
    }
}

TEST_CASE("a place at the end of the coefficients begins the round anew, and the last one ends it", "[unit][ecu][REQ-ECU-15]") {
    Bench bench = engaged_bench();
    while (bench.ecu.next_item != 0U) {
        bench.step();
    }
    const uint32_t rounds = bench.ecu.rounds;
    bench.step();
    const uint32_t items = bench.ecu.next_item;
    for (const uint32_t behind : {n_all, n_all + 1U, UINT32_MAX}) {
        bench.ecu.next_item = behind;
        bench.step();
        CHECK(bench.ecu.next_item == items);
    }
    CHECK(bench.ecu.rounds == rounds);
    bench.ecu.next_item = n_all - items - 1U;
    bench.step();
    CHECK(bench.ecu.next_item == n_all - 1U);
    bench.ecu.next_item = n_model - items - 1U;  // the model's do not end in this step
    bench.ecu.crc = 0U;
    bench.step();
    CHECK(bench.ecu.next_item == n_model - 1U);
    CHECK_FALSE(bench.ecu.kept.corrupt);
    bench.ecu.next_item = n_model;  // where the controller's begin, with a sum of their own
    bench.ecu.crc = 0U;
    bench.step();
    CHECK_FALSE(bench.ecu.kept.corrupt);
    bench.ecu.next_item = n_all - 1U;  // what was summed up by then is not what it should be
    bench.step();
    CHECK(bench.ecu.next_item == 0U);
    CHECK(bench.ecu.kept.corrupt);
}

TEST_CASE("a CRC that is wrong at the end of the model's coefficients is found there", "[unit][ecu][REQ-ECU-15]") {
    Bench bench = engaged_bench();
    bench.ecu.next_item = n_model - 1U;  // the step goes on with the controller's
    bench.ecu.crc = 0U;
    bench.step();
    CHECK(bench.ecu.kept.corrupt);
}

TEST_CASE("a demand within a thousandth of the kept limits is rounding, more is damage", "[unit][ecu][REQ-ECU-15]") {
    const int sign = GENERATE(-1, 1);
    const bool of_rate = GENERATE(false, true);
    const bool beyond = GENERATE(false, true);
    lpvg_control_coeff_t control = lpvg_control_coeff;
    Bench bench = engaged_bench(lpvg_coeff, control);
    const auto factor = static_cast<lpvg_real_t>(beyond ? 1.0015 : 1.0007);
    if (of_rate) {
        control.reals.rate_max[0] *= factor;
    } else {
        for (auto& node : control.reals.u_max) {
            node[0] = factor * bench.ecu.kept.u_max[0];
        }
    }
    int steps = 0;
    for (; !bench.ecu.kept.corrupt && steps < 40; ++steps) {
        bench.ecu.control.x[0][0] = static_cast<lpvg_real_t>(sign * 121);
        bench.step();
    }
    CHECK(bench.ecu.kept.corrupt == beyond);
    CHECK(((steps == 1) == (of_rate && beyond)));
    if (!of_rate && !beyond) {
        CHECK(std::fabs(bench.ecu.kept.demand[0]) > bench.ecu.kept.u_max[0]);
    }
}

namespace {

// The allowance of the kept limits, to the last digit: what the ECU may just demand.
lpvg_real_t with_rounding(lpvg_real_t limit) { return lpvg_real_t(1.001) * limit; }

// Writes kept values as the ECU itself does, with their copy and their sum.
void write_kept(lpvg_ecu_t& ecu) {
    std::uint32_t words[sizeof ecu.kept / sizeof(std::uint32_t)];
    std::memcpy(words, &ecu.kept, sizeof words);
    std::transform(std::begin(words), std::end(words), std::begin(ecu.inverted), [](std::uint32_t word) { return ~word; });
    ecu.sum = lpvguard::sum_of_words(ecu.kept);
}

}  // namespace

TEST_CASE("a demand that is exactly a thousandth beyond the kept largest one is rounding, the next number is damage",
          "[unit][ecu][REQ-ECU-15]") {
    const int sign = GENERATE(-1, 1);
    const bool beyond = GENERATE(false, true);
    lpvg_control_coeff_t control = lpvg_control_coeff;
    Bench bench = engaged_bench(lpvg_coeff, control);
    const lpvg_real_t most = with_rounding(bench.ecu.kept.u_max[0]);
    const lpvg_real_t limit = beyond ? std::nextafter(most, lpvg_real_t(2) * most) : most;
    for (auto& node : control.reals.u_max) {
        node[0] = limit;
    }
    for (int steps = 0; steps < 40; ++steps) {
        bench.ecu.control.x[0][0] = static_cast<lpvg_real_t>(sign * 121);
        bench.step();
        if (bench.ecu.kept.corrupt || bench.ecu.kept.demand[0] == lpvg_real_t(sign) * limit) {
            break;
        }
    }
    CHECK(bench.ecu.kept.corrupt == beyond);
    CHECK((bench.ecu.kept.demand[0] == lpvg_real_t(sign) * most) != beyond);
}

TEST_CASE("a change of the demand that is exactly a thousandth beyond the kept rate is rounding, the next number is damage",
          "[unit][ecu][REQ-ECU-15]") {
    const int sign = GENERATE(-1, 1);
    const bool beyond = GENERATE(false, true);
    lpvg_control_coeff_t control = lpvg_control_coeff;
    Bench bench = engaged_bench(lpvg_coeff, control);
    lpvg_ecu_t& ecu = bench.ecu;
    // From a demand of 0 the demand is the change itself, without rounding. The kept rate is lowered by its last digits until a rate of
    // the controller's leads exactly to what is allowed.
    const lpvg_real_t elapsed = static_cast<lpvg_real_t>(ecu.kept.period_us) * lpvg_real_t(1e-6);
    const auto least_that_reaches = [&](lpvg_real_t change) {
        lpvg_real_t rate = (lpvg_real_t(1) - lpvg_real_t(4) * std::numeric_limits<lpvg_real_t>::epsilon()) * change / elapsed;
        while (rate * elapsed < change) {
            rate = std::nextafter(rate, lpvg_real_t(2) * rate);
        }
        return rate;
    };
    lpvg_real_t& rate = control.reals.rate_max[0];
    lpvg_real_t most = with_rounding(ecu.kept.rate_max[0] * elapsed);
    for (rate = least_that_reaches(most); rate * elapsed > most; rate = least_that_reaches(most)) {
        ecu.kept.rate_max[0] = std::nextafter(ecu.kept.rate_max[0], lpvg_real_t(0));
        most = with_rounding(ecu.kept.rate_max[0] * elapsed);
    }
    rate = beyond ? least_that_reaches(std::nextafter(most, lpvg_real_t(2) * most)) : rate;
    ecu.kept.demand[0] = ecu.control.u[0] = lpvg_real_t(0);
    write_kept(ecu);
    ecu.control.x[0][0] = static_cast<lpvg_real_t>(sign * 121);
    bench.step();
    CHECK(ecu.kept.corrupt == beyond);
    CHECK(ecu.kept.demand[0] == (beyond ? lpvg_real_t(0) : lpvg_real_t(sign) * most));
}

TEST_CASE("without any copy of the kept values calls are judged by 10 ms", "[unit][ecu][REQ-ECU-15]") {
    Bench bench = engaged_bench();
    bench.ecu.kept.rate_max[0] = lpvg_real_t(-3);
    bench.ecu.inverted[0] ^= 1U;
    bench.step();
    REQUIRE(bench.ecu.kept.corrupt);
    const int64_t now_us = bench.now_us;
    bench.step_at(now_us + 4'999);
    CHECK(bench.status == lpvg_status_out_of_order);
    bench.step_at(now_us + 5'000);
    CHECK(bench.status == lpvg_status_ok);
}

TEST_CASE("damage soon after init is told at once", "[unit][ecu][REQ-ECU-15]") {
    Bench bench;
    bench.run(150);
    const int told = bench.dm1s;
    bench.ecu.occurrence = 127U;
    bench.step();
    CHECK(bench.dm1s == told + 1);
    CHECK(bench.spn == LPVG_ECU_SPN_CORRUPT);
    CHECK(bench.ecu.occurrence == 126U);
}

TEST_CASE("a damaged copy is made good in a call that is refused, too", "[unit][ecu][REQ-ECU-15]") {
    Bench bench = engaged_bench();
    const double before = std::fabs(static_cast<double>(bench.ecu.kept.demand[0]));
    bench.ecu.inverted[offsetof(lpvg_ecu_kept_t, rate_max) / sizeof(uint32_t)] ^= 0x80000000U;
    bench.step_at(bench.now_us + 1'000);
    CHECK(bench.status == lpvg_status_out_of_order);
    bench.ecu.kept.rate_max[0] *= lpvg_real_t(-3);  // the other copy: the first one has the rate again
    bench.step();
    const double left = std::fmax(before - static_cast<double>(lpvg_control_coeff.reals.rate_max[0]) * 0.01, 0.0);
    CHECK(std::fabs(static_cast<double>(bench.ecu.kept.demand[0])) == Approx(left).margin(1e-6));
    CHECK(bench.ecu.kept.corrupt);
}

TEST_CASE("after damage neither controller nor monitor runs, and nothing is refused", "[unit][ecu][REQ-ECU-15]") {
    Bench bench = engaged_bench();
    bench.ecu.refused = true;
    bench.ecu.occurrence = 127U;
    const lpvg_monitor_t monitor = bench.ecu.monitor;
    const lpvg_control_t control = bench.ecu.control;
    bench.step();
    CHECK(bench.live());  // what is said of the bus is of the bus
    bench.run(10);
    CHECK(bench.ecu.monitor.t_us == monitor.t_us);
    CHECK(std::memcmp(bench.ecu.control.x, control.x, sizeof control.x) == 0);
    CHECK((bench.ecu.causes & (LPVG_ECU_CAUSE_CORRUPT | LPVG_ECU_CAUSE_NOT_ASKED)) == LPVG_ECU_CAUSE_CORRUPT);
}

TEST_CASE("after damage the demand runs to zero by the kept rate, a late step counting as one and a half", "[unit][ecu][REQ-ECU-15]") {
    const float sign = GENERATE(-1.0F, 1.0F);
    lpvg_ecu_config_t with = bench_config;
    with.report_only = LPVG_ECU_CAUSES_OPTIONAL;
    Bench bench(with);
    bench.answers = false;
    bench.command = 0.2F * sign;
    bench.run_until_engaged();
    const double rate = static_cast<double>(lpvg_control_coeff.reals.rate_max[0]);
    for (int i = 0; i < 300 && std::fabs(static_cast<double>(bench.ecu.kept.demand[0])) < 0.06 * rate; ++i) {
        bench.step();
    }
    bench.ecu.occurrence = 127U;
    const double began = static_cast<double>(bench.ecu.kept.demand[0]);
    double before = std::fabs(began);
    REQUIRE(before > 0.04 * rate);
    int64_t t_us = bench.now_us;
    for (const int64_t late_us : {0, 100'000, 2'000, 5'000, 0, 0, 0, 0, 0, 0, 0, 0}) {
        t_us += tick_us + late_us;
        bench.step_at(t_us);
        const double most = rate * 1e-6 * static_cast<double>(std::min<int64_t>(tick_us + late_us, 15'000));
        const auto now = static_cast<double>(bench.ecu.kept.demand[0]);
        CHECK(std::fabs(now) == Approx(std::fmax(before - most, 0.0)).margin(1e-5));
        CHECK(now * began >= 0.0);
        before = std::fabs(now);
    }
    CHECK(before == 0.0);
    CHECK_FALSE(bench.engaged());
}

TEST_CASE("a word of zeros in a copy is damage, not an ECU without init", "[unit][ecu][REQ-ECU-15]") {
    const int which = GENERATE(0, 1);
    Bench bench = engaged_bench();
    bench.ecu.inverted[which] = 0U;
    if (which == 1) {
        bench.ecu.kept.period_us = 0U;
    }
    bench.step();
    CHECK(bench.ecu.kept.corrupt);
    check_dead(bench);
}

TEST_CASE("two copies that agree are used whatever their sum says", "[unit][ecu][REQ-ECU-15]") {
    Bench bench = engaged_bench();
    const double before = std::fabs(static_cast<double>(bench.ecu.kept.demand[0]));
    bench.ecu.sum ^= 1U;
    bench.ecu.occurrence = 127U;
    bench.step();
    const double left = std::fmax(before - static_cast<double>(lpvg_control_coeff.reals.rate_max[0]) * 0.01, 0.0);
    CHECK(std::fabs(static_cast<double>(bench.ecu.kept.demand[0])) == Approx(left).margin(1e-6));
    CHECK(bench.ecu.kept.corrupt);
}
