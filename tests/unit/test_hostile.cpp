// Every input that a number, a clock or a memory can hold: statuses as documented, demands within their limits, and an object
// that was refused unchanged or in its safe state.
#include "../catch.hpp"

#include <cmath>
#include <cstring>
#include <limits>
#include <random>
#include <vector>

#include "control_limits.hpp"
#include "lpvguard/ecu.h"

namespace {

using Real = lpvg_real_t;
using Limits = std::numeric_limits<Real>;

const Real special[] = {Limits::quiet_NaN(),
                        Limits::signaling_NaN(),
                        Limits::infinity(),
                        -Limits::infinity(),
                        Limits::max(),
                        Limits::lowest(),
                        Real(0),
                        -Real(0),
                        Limits::denorm_min(),
                        -Limits::denorm_min(),
                        Limits::min(),
                        -Limits::min(),
                        Limits::epsilon(),
                        Real(1e30),
                        Real(-1e30),
                        Real(1000),
                        Real(-1000)};

bool within(Real value, const Real* range) { return value >= range[0] && value <= range[1]; }

template <class Struct>
bool same_bytes(const Struct& a, const Struct& b) {
    return std::memcmp(&a, &b, sizeof a) == 0;
}

// Mostly ordinary numbers, so that objects run on between the blows.
class Blows {
public:
    Real number(Real ordinary) { return one_of(40U) == 0U ? special[one_of(sizeof special / sizeof special[0])] : ordinary; }
    // The next time: mostly one period on, else anywhere.
    int64_t time(int64_t now, int64_t period) {
        const int64_t jumps[] = {0, -1, 1, -period, period / 2 - 1, 2 * period, int64_t{1} << 40, -(int64_t{1} << 40)};
        return one_of(60U) == 0U ? now + jumps[one_of(8U)] : now + period;
    }
    std::size_t one_of(std::size_t n) { return std::uniform_int_distribution<std::size_t>(0, n - 1U)(random_); }
    Real wave(Real size) { return size * std::uniform_real_distribution<Real>(Real(-1), Real(1))(random_); }

private:
    std::mt19937 random_{20240607U};
};

// Of coefficients cut off after every 13th byte, from the last number backwards; the erased rest differs from what was there, or there
// is nothing to find.
template <class Coefficients, class Check>
void for_each_cut(const Coefficients& whole, int erased, const Check& check) {
    for (std::size_t kept = 0; kept < sizeof(Coefficients); kept += 13U) {
        Coefficients cut = whole;
        std::memset(reinterpret_cast<unsigned char*>(&cut) + kept, erased, sizeof cut - kept);
        if (!same_bytes(cut, whole)) {
            check(cut);
        }
    }
}

Real cruise() { return Real(0.5) * (lpvg_coeff.reals.speed_min + lpvg_coeff.reals.speed_max); }

}  // namespace

TEST_CASE("the monitor answers every sample as documented, whatever it holds", "[unit][hostile][REQ-MON-8][REQ-MON-9]") {
    const lpvg_coeff_reals_t& r = lpvg_coeff.reals;
    const int64_t period = lpvg_coeff.words.sample_period_us;
    Blows blows;
    lpvg_monitor_t monitor;
    REQUIRE(lpvg_monitor_init(&monitor, &lpvg_coeff) == lpvg_status_ok);
    int64_t newest = 0, now = 0;
    bool any = false;
    std::size_t seen[3] = {}, wrong = 0, not_finite = 0;
    for (int k = 0; k < 200000; ++k) {
        lpvg_sample_t sample{};
        sample.t_us = now = blows.time(now, period);
        sample.speed = blows.number(cruise());
        bool good = within(sample.speed, r.speed_valid);
        for (std::size_t i = 0; i < LPVG_NU; ++i) {
            sample.u[i] = blows.number(blows.wave(r.input_valid[i][1] / Real(4)));
            good = good && within(sample.u[i], r.input_valid[i]);
        }
        for (std::size_t j = 0; j < LPVG_NY; ++j) {
            sample.y[j] = blows.number(blows.wave(r.output_valid[j][1] / Real(4)));
            good = good && within(sample.y[j], r.output_valid[j]);
        }
        const bool late = any && sample.t_us <= newest;
        const lpvg_status_t want = late ? lpvg_status_out_of_order : (good ? lpvg_status_ok : lpvg_status_bad_sample);
        const lpvg_verdict_t before = lpvg_monitor_verdict(&monitor, newest);
        wrong += lpvg_monitor_push(&monitor, &sample) != want ? 1U : 0U;
        now = late ? newest : now;
        newest = now;
        any = true;
        const lpvg_verdict_t verdict = lpvg_monitor_verdict(&monitor, now);
        wrong += !late && (verdict == lpvg_verdict_fault) == good ? 1U : 0U;
        wrong += late && verdict != before && k > 0 ? 1U : 0U;
        const lpvg_frame_t& frame = *lpvg_monitor_frame(&monitor);
        not_finite += std::isfinite(frame.margin) && std::isfinite(frame.evidence) && std::isfinite(frame.speed) ? 0U : 1U;
        ++seen[late ? 0 : (good ? 1 : 2)];
    }
    CHECK(wrong == 0U);
    CHECK(not_finite == 0U);  // whatever came before, no frame holds it
    CHECK((seen[0] > 100U && seen[1] > 100000U && seen[2] > 1000U));
}

TEST_CASE("the controller's demand keeps its limits, whatever it is given", "[unit][hostile][REQ-CTL-2][REQ-CTL-6]") {
    Blows blows;
    lpvg_control_t control;
    REQUIRE(lpvg_control_init(&control, &lpvg_control_coeff) == lpvg_status_ok);
    Real before[LPVG_NU] = {};
    std::size_t refused = 0, wrong = 0;
    for (int k = 0; k < 100000; ++k) {
        const Real speed = blows.number(cruise());
        Real m[LPVG_NM];
        bool finite = std::isfinite(speed);
        for (Real& value : m) {
            value = blows.number(blows.wave(Real(0.2)));
            finite = finite && std::isfinite(value);
        }
        const lpvg_status_t status = lpvg_control_step(&control, speed, m, k % 50 < 40);
        wrong += !finite && status != lpvg_status_bad_sample ? 1U : 0U;
        wrong += status != lpvg_status_ok && control.engaged ? 1U : 0U;
        refused += status != lpvg_status_ok ? 1U : 0U;
        for (std::size_t i = 0; i < LPVG_NU; ++i) {
            const double known = std::isfinite(speed) ? static_cast<double>(speed) : 0.0;  // refused: towards zero, whatever the limit
            wrong += within_limits(lpvg_control_coeff, known, i, before[i], control.u[i]) ? 0U : 1U;
            before[i] = control.u[i];
        }
    }
    CHECK(wrong == 0U);
    CHECK(refused > 1000U);
    CHECK(refused == control.bad_samples);
}

TEST_CASE("coefficients that end early are refused, and leave every object as it was", "[unit][hostile][REQ-COEF-1][REQ-COEF-5]") {
    const int erased = GENERATE(0x00, 0xFF);
    const lpvg_ecu_config_t config = {true, LPVG_ECU_CAUSES_OPTIONAL, 0U, false, {2.0f, 5.0f, 1.5f, 0.2f, 10u}, {0.14f, 0.04f, 30u, 0.32f}};
    lpvg_ecu_t ecu, ecu_before;
    lpvg_monitor_t monitor, monitor_before;
    lpvg_control_t control, control_before;
    std::memset(&ecu, 0x5A, sizeof ecu);
    std::memset(&monitor, 0x5A, sizeof monitor);
    std::memset(&control, 0x5A, sizeof control);
    std::memcpy(&ecu_before, &ecu, sizeof ecu);
    std::memcpy(&monitor_before, &monitor, sizeof monitor);
    std::memcpy(&control_before, &control, sizeof control);
    std::size_t accepted = 0;
    for_each_cut(lpvg_coeff, erased, [&](const lpvg_coeff_t& cut) {
        accepted += lpvg_monitor_init(&monitor, &cut) == lpvg_status_ok ? 1U : 0U;
        accepted += lpvg_ecu_init(&ecu, &cut, &lpvg_control_coeff, &config, 0) == lpvg_status_ok ? 1U : 0U;
    });
    for_each_cut(lpvg_control_coeff, erased, [&](const lpvg_control_coeff_t& cut) {
        accepted += lpvg_control_init(&control, &cut) == lpvg_status_ok ? 1U : 0U;
        accepted += lpvg_ecu_init(&ecu, &lpvg_coeff, &cut, &config, 0) == lpvg_status_ok ? 1U : 0U;
    });
    CHECK(accepted == 0U);
    CHECK(same_bytes(ecu, ecu_before));
    CHECK(same_bytes(monitor, monitor_before));
    CHECK(same_bytes(control, control_before));
}

TEST_CASE("any frame at any time leaves the ECU within its limits and its report sendable", "[unit][hostile][REQ-ECU-6][REQ-CAN-8]") {
    const lpvg_ecu_config_t config = {true, 0U, 0U, false, {2.0f, 5.0f, 1.5f, 0.2f, 10u}, {0.14f, 0.04f, 30u, 0.32f}};
    const int64_t period = lpvg_coeff.words.sample_period_us;
    Blows blows;
    lpvg_ecu_t ecu;
    REQUIRE(lpvg_ecu_init(&ecu, &lpvg_coeff, &lpvg_control_coeff, &config, 0) == lpvg_status_ok);
    int64_t now = 0;
    std::size_t wrong = 0, refused = 0;
    for (int k = 0; k < 20000; ++k) {
        std::vector<lpvg_can_frame_t> in(blows.one_of(5U));
        for (lpvg_can_frame_t& frame : in) {
            unsigned char bytes[sizeof frame];
            for (unsigned char& byte : bytes) {
                byte = static_cast<unsigned char>(blows.one_of(256U));
            }
            std::memcpy(&frame, bytes, sizeof frame);
            if (blows.one_of(2U) == 0U) {  // of a message that is listened to
                frame.id = lpvg_bus.rules[blows.one_of(lpvg_bus.n_rules)].id;
                frame.dlc = 8U;
            }
            frame.t_us = blows.one_of(4U) == 0U ? frame.t_us : now;
        }
        const int64_t next = blows.time(now, period);
        lpvg_can_frame_t out[LPVG_ECU_FRAMES_OUT];
        std::size_t n_out = 99U;
        const lpvg_status_t status = lpvg_ecu_step(&ecu, next, in.data(), in.size(), out, LPVG_ECU_FRAMES_OUT, &n_out);
        // Jumps come one at a time, so that none is followed.
        const int64_t apart = next - now;
        const bool late = k > 0 && (2 * apart < period || apart > static_cast<int64_t>(LPVG_ECU_JUMP_US));
        wrong += status != (late ? lpvg_status_out_of_order : lpvg_status_ok) ? 1U : 0U;
        wrong += late ? (n_out != 0U ? 1U : 0U) : (n_out >= 1U && n_out <= LPVG_ECU_FRAMES_OUT ? 0U : 1U);
        for (std::size_t i = 0; i < LPVG_NU; ++i) {
            wrong += static_cast<double>(std::fabs(ecu.control.u[i])) <= largest_limit(lpvg_control_coeff.reals, i) * rounding ? 0U : 1U;
        }
        refused += late ? 1U : 0U;
        now = late ? now : next;
    }
    CHECK(wrong == 0U);
    CHECK(refused > 50U);
}
