// The ECU of a vehicle with two inputs: each demand is kept twice, and stays within limits and rate of its own. toy has no place on a bus,
// so its bus is written here: one message, whose values are those of the test.
#include "../catch.hpp"

#include <algorithm>
#include <cmath>
#include <limits>

#include "lpvguard/ecu.h"

namespace {

constexpr int64_t tick_us = 10'000;
constexpr lpvg_can_signal_rule_t signal_rule = {0U, 8U, 0U, 255U, 0U, 0U, 0U};
constexpr lpvg_can_rule_t rule = {0x100U, 0x1FFFFFFFU, tick_us, tick_us / 4, 0U, 0U, 8U, 1U, &signal_rule};
lpvg_bus_signals_t sent;

}  // namespace

extern "C" const lpvg_bus_t lpvg_bus = {&rule, 1U, 0xFCU, rule.id, 0U, 0U, 1U, {{0U, 1U}}};
extern "C" void lpvg_bus_take(lpvg_bus_signals_t* signals, uint8_t, const lpvg_can_frame_t*) { *signals = sent; }
extern "C" lpvg_status_t lpvg_bus_pack_report(const lpvg_bus_report_t*, lpvg_can_frame_t*, uint8_t*) { return lpvg_status_ok; }

namespace {

// The car stands still, whatever is demanded; that it does not respond is reported only.
const lpvg_ecu_config_t config = {true, LPVG_ECU_CAUSE_INVALID, 0U, true, {2.07F, 5.0F, 1.5F, 0.15F, 100U}, {0.14F, 0.04F, 30U, 0.32F}};

struct TwoInputs {
    explicit TwoInputs(const lpvg_control_coeff_t& control = lpvg_control_coeff) {
        const float none = std::numeric_limits<float>::quiet_NaN();
        sent = {lpvg_real_t(12), lpvg_real_t(0.3), {}, none, none, none, 0.0F, 0.0F, none, 0.0F, 0.0F};
        REQUIRE(lpvg_ecu_init(&ecu, &lpvg_coeff, &control, &config, 0) == lpvg_status_ok);
        for (int i = 0; i < 200; ++i) {
            step();
            sent.request = static_cast<float>(i < 20 ? LPVG_BUS_REQUEST_RELEASE : LPVG_BUS_REQUEST_CONTROL);
        }
        REQUIRE(ecu.control.engaged);
        REQUIRE(std::fabs(ecu.kept.demand[1]) > lpvg_real_t(0.1));
    }

    void step() {
        lpvg_can_frame_t frame{};
        frame.id = rule.id;
        frame.dlc = rule.dlc;
        frame.t_us = k * tick_us;
        lpvg_can_frame_t out[LPVG_ECU_FRAMES_OUT];
        size_t n_out = 0U;
        REQUIRE(lpvg_ecu_step(&ecu, k * tick_us, &frame, 1U, out, LPVG_ECU_FRAMES_OUT, &n_out) == lpvg_status_ok);
        ++k;
    }

    // Changes of the second demand beyond its rate, and demands beyond its limit or unlike the kept ones, in so many steps.
    int beyond(int steps) {
        int wrong = 0;
        for (int i = 0; i < steps; ++i) {
            const lpvg_real_t before = ecu.kept.demand[1];
            step();
            const lpvg_real_t now = ecu.control.u[1], most = lpvg_real_t(0.01001) * lpvg_control_coeff.reals.rate_max[1];
            const bool kept = std::equal(std::begin(ecu.control.u), std::end(ecu.control.u), std::begin(ecu.kept.demand));
            wrong += !kept || std::fabs(now - before) > most || std::fabs(now) > lpvg_real_t(1.001) * limit() ? 1 : 0;
        }
        return wrong;
    }

    static lpvg_real_t limit() {
        lpvg_real_t largest = lpvg_real_t(0);
        for (const auto& node : lpvg_control_coeff.reals.u_max) {
            largest = std::max(largest, node[1]);
        }
        return largest;
    }

    lpvg_ecu_t ecu;
    int64_t k = 0;
};

}  // namespace

TEST_CASE("each of two demands has a limit and a rate of its own, and is kept", "[unit][ecu][REQ-ECU-15]") {
    TwoInputs car;
    CHECK(car.ecu.kept.u_max[1] == TwoInputs::limit());
    CHECK(car.ecu.kept.u_max[0] != car.ecu.kept.u_max[1]);
    CHECK(car.ecu.kept.rate_max[1] == lpvg_control_coeff.reals.rate_max[1]);
    for (const double reference : {-2.0, 2.0, 0.0}) {
        sent.reference = static_cast<lpvg_real_t>(reference);
        CHECK(car.beyond(100) == 0);
    }
    CHECK_FALSE(car.ecu.kept.corrupt);
}

TEST_CASE("a changed second demand is found, and the kept one runs down by its rate", "[unit][ecu][REQ-ECU-15]") {
    TwoInputs car;
    const bool copy = GENERATE(false, true);
    const lpvg_real_t before = car.ecu.kept.demand[1];
    (copy ? car.ecu.kept.demand : car.ecu.control.u)[1] = -before;
    car.step();
    CHECK(car.ecu.kept.corrupt);
    const lpvg_real_t left = std::max(std::fabs(before) - lpvg_real_t(0.01) * lpvg_control_coeff.reals.rate_max[1], lpvg_real_t(0));
    CHECK(static_cast<double>(car.ecu.kept.demand[1]) == Approx(static_cast<double>(std::copysign(left, before))).margin(1e-5));
    CHECK(car.beyond(100) == 0);
    CHECK(car.ecu.kept.demand[1] == lpvg_real_t(0));
}

TEST_CASE("a second demand beyond its kept limits does not leave the ECU", "[unit][ecu][REQ-ECU-15][REQ-CTL-2]") {
    const bool only_rate = GENERATE(false, true);
    lpvg_control_coeff_t control = lpvg_control_coeff;
    TwoInputs car(control);
    control.reals.rate_max[1] *= lpvg_real_t(10);
    for (auto& node : control.reals.u_max) {
        node[1] *= lpvg_real_t(only_rate ? 1 : 10);
    }
    for (auto& x : car.ecu.control.x[1]) {
        x = lpvg_real_t(only_rate ? 1 : 30);
    }
    CHECK(car.beyond(100) == 0);
    CHECK(car.ecu.kept.corrupt);
    CHECK(car.ecu.kept.demand[1] == lpvg_real_t(0));
}
