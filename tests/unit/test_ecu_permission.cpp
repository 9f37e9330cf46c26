// Who may have the brakes: the driver, ABS, the vehicle's request and other commands, and brakes that do not do what is demanded.
#include "ecu_bench.hpp"

namespace {

Bench engaged_bench(const lpvg_ecu_config_t& config = bench_config) {
    Bench bench(config);
    bench.run_until_engaged();
    return bench;
}

bool has(const Bench& bench, uint32_t cause) { return (bench.ecu.causes & cause) != 0U; }

}  // namespace

TEST_CASE("the driver's pedal and ABS release with the message that says so, and are given back after the wait",
          "[unit][ecu][REQ-ECU-13]") {
    const bool pedal = GENERATE(false, true);
    Bench bench = engaged_bench();
    bench.pedal_percent = LPVG_ECU_PEDAL_PERCENT;
    bench.run(20);
    CHECK(bench.engaged());
    bench.pedal_percent = pedal ? LPVG_ECU_PEDAL_PERCENT + 0.4F : 0.0F;
    bench.abs_active = pedal ? 0U : 1U;
    while (bench.k % 10 != 0) {  // EBC1 comes every tenth step
        bench.step();
        CHECK(bench.engaged());
    }
    bench.step();
    CHECK_FALSE(bench.engaged());
    CHECK((bench.ecu.causes & ~LPVG_ECU_CAUSE_WAIT) == LPVG_ECU_CAUSE_OVERRIDE);
    bench.pedal_percent = 0.0F;
    bench.abs_active = 0U;
    bench.run(9 + wait_steps - 1);
    CHECK_FALSE(bench.engaged());
    bench.run(1);
    CHECK(bench.engaged());
    CHECK(bench.ecu.releases == 0U);
}

TEST_CASE("without the message of pedal and ABS nothing is engaged", "[unit][ecu][REQ-ECU-13][REQ-ECU-2]") {
    const int what = GENERATE(0, 1, 2);
    Bench bench = engaged_bench();
    bench.send_ebc1 = what != 0;
    bench.abs_active = what == 1 ? 3U : 0U;  // "not available"
    bench.pedal_percent = what == 2 ? NAN : 0.0F;
    bench.run(45);
    CHECK_FALSE(bench.engaged());
    CHECK(has(bench, LPVG_ECU_CAUSE_MESSAGE));
    bench.run(115);
    CHECK(bench.spn == 563U);
    CHECK(bench.fmi == (what == 0 ? LPVG_CAN_FMI_UPDATE_RATE : LPVG_CAN_FMI_ERRATIC));
}

TEST_CASE("nothing is engaged unless the vehicle asks for control, after it has not", "[unit][ecu][REQ-ECU-13]") {
    SECTION("a request that stands from the start is not followed") {
        Bench bench;
        bench.early_request = LPVG_BUS_REQUEST_CONTROL;
        bench.run(500);
        CHECK(bench.ecu.causes == LPVG_ECU_CAUSE_PERMISSION);
        bench.request = GENERATE(as<uint8_t>{}, LPVG_BUS_REQUEST_RELEASE, LPVG_BUS_REQUEST_ACKNOWLEDGE);
        bench.run(1);
        bench.request = LPVG_BUS_REQUEST_CONTROL;
        bench.run(1);
        CHECK(bench.engaged());
    }
    SECTION("release is followed at once, and control after a wait") {
        Bench bench = engaged_bench();
        bench.request = LPVG_BUS_REQUEST_RELEASE;
        bench.run(1);
        CHECK_FALSE(bench.engaged());
        CHECK(bench.ecu.causes == (LPVG_ECU_CAUSE_PERMISSION | LPVG_ECU_CAUSE_WAIT));
        bench.request = LPVG_BUS_REQUEST_CONTROL;
        bench.run(wait_steps - 1);
        CHECK_FALSE(bench.engaged());
        bench.run(1);
        CHECK(bench.engaged());
        CHECK(bench.ecu.releases == 0U);
    }
    SECTION("other commands go first") {
        lpvg_ecu_config_t with = bench_config;
        with.priority = GENERATE(as<uint8_t>{}, 0, 1, 2, 3);
        Bench bench = engaged_bench(with);
        for (uint8_t other = 0U; other <= 3U; ++other) {
            bench.other_priority = other;
            bench.run(1);
            CHECK(bench.engaged() == (other <= with.priority));
        }
    }
}

TEST_CASE("the request to acknowledge ends a lock where it begins", "[unit][ecu][REQ-ECU-12][REQ-ECU-13]") {
    Bench bench = engaged_bench();
    bench.lock();
    bench.run(1);
    CHECK_FALSE(bench.engaged());
    bench.request = LPVG_BUS_REQUEST_ACKNOWLEDGE;
    bench.run(1);
    CHECK_FALSE(bench.ecu.kept.locked);
    CHECK_FALSE(bench.engaged());
    bench.lock();  // the same request is no second one
    bench.run(3);
    CHECK(bench.ecu.kept.locked);
    bench.request = LPVG_BUS_REQUEST_CONTROL;
    bench.run(1);
    CHECK_FALSE(bench.engaged());
    bench.request = LPVG_BUS_REQUEST_ACKNOWLEDGE;
    bench.run(1);
    bench.request = LPVG_BUS_REQUEST_CONTROL;
    bench.run(wait_steps);
    CHECK(bench.engaged());
}

TEST_CASE("brakes that do not do what is demanded release and lock, unless it is only to be reported", "[unit][ecu][REQ-ECU-14]") {
    const bool only_reported = GENERATE(false, true);
    const bool too_much = GENERATE(false, true);
    lpvg_ecu_config_t with = bench_config;
    with.report_only = static_cast<uint16_t>(LPVG_ECU_CAUSE_INVALID | (only_reported ? LPVG_ECU_CAUSE_ACTUATOR : 0U));
    Bench bench = engaged_bench(with);
    bench.run(500);
    CHECK(bench.ecu.deviations == 0U);
    CHECK(bench.engaged());
    bench.brakes_work = false;
    bench.pressure = static_cast<float>(bench.ecu.control.u[0]) + (too_much ? 2.2F : -2.2F);
    bench.run(with.actuator.confirm - 1);
    CHECK(bench.engaged());
    bench.run(10);
    CHECK(has(bench, LPVG_ECU_CAUSE_ACTUATOR));
    CHECK(bench.engaged() == only_reported);
    CHECK(bench.ecu.kept.locked != only_reported);
    bench.run(101);
    CHECK(bench.spn == (only_reported ? LPVG_ECU_SPN_ACTUATOR : bench.spn));
    if (only_reported) {
        CHECK(bench.fmi == LPVG_CAN_FMI_RESPONSE);
    }
}

TEST_CASE("the actuator is held against the demand through its lag", "[unit][ecu][REQ-ECU-14]") {
    Bench bench = engaged_bench();
    double expected = static_cast<double>(bench.ecu.expected), moved = 0.0;
    for (int i = 0; i < 200; ++i) {
        const auto demand = static_cast<double>(bench.ecu.control.u[0]);
        expected += (demand - expected) * 0.01 / (0.14 + 0.01);
        moved = std::fmax(moved, std::fabs(demand - expected));
        bench.step();
        CHECK(static_cast<double>(bench.ecu.expected) == Approx(expected).margin(1e-5));
    }
    CHECK(moved > 0.01);
}

TEST_CASE("the actuator may be off by its tolerance, and by no more", "[unit][ecu][REQ-ECU-14]") {
    const float sign = GENERATE(-1.0F, 1.0F);
    lpvg_ecu_config_t with = bench_config;
    with.engage = false;  // the demand is 0
    const auto waiting = [&] {
        Bench bench(with);
        bench.brakes_work = false;
        bench.pressure = sign;
        bench.run(1000);
        REQUIRE(bench.live());
        return bench;
    };
    with.actuator.tolerance = std::fabs(waiting().ecu.signals.measured);  // as the bus has it
    Bench bench = waiting();
    REQUIRE(bench.ecu.signals.measured == sign * with.actuator.tolerance);
    CHECK(bench.ecu.expected == 0.0F);
    CHECK(bench.ecu.deviations == 0U);
    bench.pressure *= 1.01F;
    bench.run(20);
    CHECK(bench.ecu.deviations >= 18U);
    with.actuator.tolerance *= 0.999F;
    CHECK(waiting().ecu.deviations > 0U);
}

TEST_CASE("an actuator without a measurement is not held against the demand", "[unit][ecu][REQ-ECU-14]") {
    Bench bench = engaged_bench();
    bench.brakes_work = false;
    bench.run(5);
    REQUIRE(bench.ecu.deviation_square > 0.0F);
    bench.send_guard_in = false;  // two periods are no cause yet
    bench.ecu.signals.measured = NAN;
    bench.run(2);
    REQUIRE(bench.live());
    CHECK(bench.engaged());
    CHECK(bench.ecu.deviation_square == 0.0F);
    CHECK_FALSE(bench.ecu.actuator_failed);
}

TEST_CASE("limits and priorities that make no sense are refused", "[unit][ecu][REQ-ECU-6]") {
    const int which = GENERATE(range(0, 15));  // those from 7 on that are good: 7 and 8
    const auto u_max = static_cast<float>(lpvg_control_coeff.reals.u_max[0][0]);
    constexpr float infinite = std::numeric_limits<float>::infinity();
    lpvg_ecu_config_t with = bench_config;
    with.priority = which == 0 ? 4U : 3U;
    with.actuator.lag_s = which == 1 ? 0.0F : which == 4 ? -0.1F : which == 9 ? infinite : 0.1F;
    with.actuator.tolerance = which == 2    ? NAN
                              : which == 5  ? 0.0F
                              : which == 6  ? -0.1F
                              : which == 10 ? infinite
                              : which == 11 ? u_max
                                            : 0.1F;
    with.actuator.confirm = which == 3 ? 0U : 1U;
    with.actuator.relative = which == 8 ? 0.0F : which == 12 ? 1.0F : which == 13 ? NAN : 0.25F;
    with.plausibility.lateral_mps2 = which == 14 ? infinite : 1.5F;
    lpvg_ecu_t ecu;
    CHECK(lpvg_ecu_init(&ecu, &lpvg_coeff, &lpvg_control_coeff, &with, 0) ==
          (which == 7 || which == 8 ? lpvg_status_ok : lpvg_status_bad_argument));
}
