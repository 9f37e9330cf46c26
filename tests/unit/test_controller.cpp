// The controller against a dense recursion in double, its limits, anti-windup, engagement, and every documented failure.
#include <catch2/catch.hpp>

#include <cmath>
#include <cstring>
#include <functional>
#include <limits>
#include <vector>

#include "lpvguard/controller.h"

namespace {

using Real = lpvg_real_t;
constexpr std::size_t nk = LPVG_NK, nm = LPVG_NM, nu = LPVG_NU;
const double period_s = 1e-6 * lpvg_control_coeff.words.sample_period_us;
const lpvg_control_reals_t& reals = lpvg_control_coeff.reals;

lpvg_control_t ready(const lpvg_control_coeff_t& coeff = lpvg_control_coeff) {
    lpvg_control_t control;
    REQUIRE(lpvg_control_init(&control, &coeff) == lpvg_status_ok);
    return control;
}

lpvg_control_coeff_t sealed(const std::function<void(lpvg_control_coeff_t&)>& change) {
    lpvg_control_coeff_t coeff = lpvg_control_coeff;
    change(coeff);
    coeff.words.crc32 = lpvg_control_coeff_crc32(&coeff);
    return coeff;
}

void check_refused(const lpvg_control_coeff_t* coeff, lpvg_status_t want) {
    CHECK(lpvg_control_coeff_check(coeff) == want);
    lpvg_control_t control, before;
    std::memset(&control, 0xA5, sizeof control);
    std::memcpy(&before, &control, sizeof control);
    CHECK(lpvg_control_init(&control, coeff) == want);
    CHECK(std::memcmp(&control, &before, sizeof control) == 0);
}

// The law of controller.h written with dense matrices in double: no code shared with the core.
struct Reference {
    std::vector<double> x = std::vector<double>(nk, 0.0), u = std::vector<double>(nu, 0.0);
    double wanted_max = 0.0;  // largest |C x| so far

    static double entry(const Real* below, const Real* above, double w) {
        return (1.0 - w) * static_cast<double>(*below) + w * static_cast<double>(*above);
    }

    void step(double speed, const std::vector<double>& m) {
        const double low = static_cast<double>(reals.speed_min), high = static_cast<double>(reals.speed_max);
        const double position = (std::fmin(std::fmax(speed, low), high) - low) / (high - low) * (LPVG_NG - 1);
        const auto g = static_cast<std::size_t>(std::fmin(std::floor(position), LPVG_NG - 2));
        const double w = position - static_cast<double>(g);
        std::vector<double> next = x, excess(nu);
        for (std::size_t i = 0; i < nu; ++i) {
            double v = 0.0;
            for (std::size_t j = 0; j < nk; ++j) {
                v += entry(&reals.C[g][i][j], &reals.C[g + 1][i][j], w) * x[j];
            }
            const double rate = static_cast<double>(reals.rate_max[i]) * period_s, top = static_cast<double>(reals.u_max[i]);
            const double inside = std::fmin(std::fmax(v, -top), top);
            u[i] = std::fmin(std::fmax(inside, u[i] - rate), u[i] + rate);
            excess[i] = u[i] - v;
            wanted_max = std::fmax(wanted_max, std::fabs(v));
        }
        for (std::size_t i = 0; i < nk; ++i) {
            for (uint32_t e = lpvg_control_coeff.words.row_begin[i]; e < lpvg_control_coeff.words.row_begin[i + 1]; ++e) {
                next[i] += entry(&reals.A1[g][e], &reals.A1[g + 1][e], w) * x[lpvg_control_coeff.words.column[e]];
            }
            for (std::size_t j = 0; j < nm; ++j) {
                next[i] += entry(&reals.B[g][i][j], &reals.B[g + 1][i][j], w) * m[j];
            }
            for (std::size_t j = 0; j < nu; ++j) {
                next[i] += entry(&reals.L[g][i][j], &reals.L[g + 1][i][j], w) * excess[j];
            }
        }
        x = next;
    }
};

std::vector<Real> measurement(double scale, int k) {
    std::vector<Real> m(nm);
    for (std::size_t j = 0; j < nm; ++j) {
        m[j] = static_cast<Real>(scale * std::sin(0.013 * (1.0 + static_cast<double>(j)) * k + static_cast<double>(j)));
    }
    return m;
}

Real mid_speed() { return (reals.speed_min + reals.speed_max) / Real(2); }

}  // namespace

TEST_CASE("the law equals a dense recursion in double, within 1e-5 of its range, 5e-4 against the limits", "[unit][controller]") {
    const double scale = GENERATE(0.02, 0.5);  // the second one saturates
    lpvg_control_t control = ready();
    Reference reference;
    double worst = 0.0;
    for (int k = 0; k < 20000; ++k) {
        const double low = static_cast<double>(reals.speed_min), high = static_cast<double>(reals.speed_max);
        const double speed = 0.5 * (low + high) + 0.6 * (high - low) * std::sin(0.0007 * k);  // leaves the range at both ends
        const std::vector<Real> m = measurement(scale, k);
        const std::vector<double> same(m.begin(), m.end());
        REQUIRE(lpvg_control_step(&control, static_cast<Real>(speed), m.data(), true) == lpvg_status_ok);
        reference.step(static_cast<double>(static_cast<Real>(speed)), same);
        for (std::size_t i = 0; i < nu; ++i) {
            worst = std::fmax(worst, std::fabs(static_cast<double>(control.u[i]) - reference.u[i]));
        }
    }
    // Overdriven, C x is beyond the limit all the time, and the injection of u - C x feeds its rounding back into the state.
    const double allowed = (sizeof(Real) == 4U ? 1e-5 : 1e-12) * (scale < 0.1 ? 1.0 : 50.0);
    const double range = std::fmax(static_cast<double>(reals.u_max[0]), reference.wanted_max);
    CAPTURE(worst, range);
    CHECK(worst <= allowed * range);
    CHECK((scale < 0.1 || control.limited > 1000U));
}

TEST_CASE("demand and its change never exceed their limits, engaged or not", "[unit][controller]") {
    lpvg_control_t control = ready();
    std::vector<Real> before(nu, Real(0));
    for (int k = 0; k < 5000; ++k) {
        const std::vector<Real> m = measurement(k % 500 < 250 ? 50.0 : 0.01, k);
        REQUIRE(lpvg_control_step(&control, mid_speed(), m.data(), k % 70 < 50) == lpvg_status_ok);
        for (std::size_t i = 0; i < nu; ++i) {
            REQUIRE(std::fabs(control.u[i]) <= reals.u_max[i]);
            REQUIRE(static_cast<double>(std::fabs(control.u[i] - before[i])) <=
                    static_cast<double>(reals.rate_max[i]) * period_s * (1.0 + 1e-4));
            before[i] = control.u[i];
        }
    }
}

TEST_CASE("released, the demand is zero after at most u_max / rate_max", "[unit][controller]") {
    lpvg_control_t control = ready();
    const std::vector<Real> m = measurement(50.0, 40);
    for (int k = 0; k < 300; ++k) {
        REQUIRE(lpvg_control_step(&control, mid_speed(), m.data(), true) == lpvg_status_ok);
    }
    CHECK(std::fabs(control.u[0]) == reals.u_max[0]);
    const auto steps = static_cast<int>(
        std::ceil(static_cast<double>(reals.u_max[0]) / (static_cast<double>(reals.rate_max[0]) * period_s)));
    for (int k = 0; k <= steps; ++k) {
        REQUIRE(lpvg_control_step(&control, mid_speed(), m.data(), false) == lpvg_status_ok);
    }
    for (std::size_t i = 0; i < nu; ++i) {
        CHECK(control.u[i] == Real(0));
    }
}

TEST_CASE("engaging jumps by less than one step of the demand's number grid", "[unit][controller]") {
    constexpr double quantisation = 1.0 / 2048.0;
    const int released = GENERATE(1, 7, 150, 3000);
    const double scale = GENERATE(0.02, 2.0);
    lpvg_control_t control = ready();
    for (int k = 0; k < 400; ++k) {
        const std::vector<Real> m = measurement(scale, k);
        REQUIRE(lpvg_control_step(&control, mid_speed(), m.data(), true) == lpvg_status_ok);
    }
    for (int k = 400; k < 400 + released; ++k) {
        const std::vector<Real> m = measurement(scale, k);
        REQUIRE(lpvg_control_step(&control, mid_speed(), m.data(), false) == lpvg_status_ok);
    }
    const std::vector<Real> before(control.u, control.u + nu);
    const std::vector<Real> m = measurement(scale, 400 + released);
    REQUIRE(lpvg_control_step(&control, mid_speed(), m.data(), true) == lpvg_status_ok);
    CAPTURE(released, scale);
    for (std::size_t i = 0; i < nu; ++i) {
        CHECK(static_cast<double>(std::fabs(control.u[i] - before[i])) < quantisation);
    }
}

namespace {

// Seconds from the end of a minute of overdriving until the demand has left its limit by a tenth.
double seconds_at_the_limit(const lpvg_control_coeff_t& coeff) {
    lpvg_control_t control = ready(coeff);
    std::vector<Real> m(nm, Real(0));
    m[0] = Real(1);
    for (int k = 0; k < 6000; ++k) {
        REQUIRE(lpvg_control_step(&control, mid_speed(), m.data(), true) == lpvg_status_ok);
    }
    REQUIRE(std::fabs(control.u[0]) == reals.u_max[0]);
    m[0] = Real(0);
    int steps = 0;
    while (std::fabs(control.u[0]) > Real(0.9) * reals.u_max[0] && steps < 6000) {
        REQUIRE(lpvg_control_step(&control, mid_speed(), m.data(), true) == lpvg_status_ok);
        ++steps;
    }
    return steps * period_s;
}

}  // namespace

TEST_CASE("saturation does not wind the state up", "[unit][controller]") {
    const lpvg_control_coeff_t without = sealed([](lpvg_control_coeff_t& c) { std::memset(c.reals.L, 0, sizeof c.reals.L); });
    const double with_s = seconds_at_the_limit(lpvg_control_coeff), without_s = seconds_at_the_limit(without);
    CAPTURE(with_s, without_s);
    CHECK(with_s < 5.0);
    CHECK(with_s < 0.2 * without_s);
}

TEST_CASE("a number that is not finite releases the demand and spoils nothing", "[unit][controller]") {
    const Real bad = GENERATE(std::numeric_limits<Real>::quiet_NaN(), std::numeric_limits<Real>::infinity(),
                              -std::numeric_limits<Real>::infinity());
    const int where = GENERATE(range(-1, static_cast<int>(LPVG_NM)));
    lpvg_control_t control = ready();
    for (int k = 0; k < 300; ++k) {
        REQUIRE(lpvg_control_step(&control, mid_speed(), measurement(0.05, k).data(), true) == lpvg_status_ok);
    }
    const Real demand = control.u[0];
    std::vector<Real> m = measurement(0.05, 300);
    if (where >= 0) {
        m[static_cast<std::size_t>(where)] = bad;
    }
    for (int k = 0; k < 50; ++k) {
        CHECK(lpvg_control_step(&control, where < 0 ? bad : mid_speed(), m.data(), true) == lpvg_status_bad_sample);
        CHECK_FALSE(control.engaged);
    }
    CHECK(control.bad_samples == 50U);
    CHECK(std::fabs(control.u[0]) < std::fabs(demand) + Real(1e-6));
    for (int k = 0; k < 300; ++k) {
        REQUIRE(lpvg_control_step(&control, mid_speed(), measurement(0.05, k).data(), true) == lpvg_status_ok);
        REQUIRE(std::isfinite(control.u[0]));
    }
}

TEST_CASE("a state that grew beyond the numbers is cleared", "[unit][controller]") {
    const Real huge = std::numeric_limits<Real>::max();
    lpvg_control_t control = ready();
    const std::vector<Real> m(nm, huge);
    bool refused = false;
    for (int k = 0; k < 2000; ++k) {
        refused = lpvg_control_step(&control, mid_speed(), m.data(), true) == lpvg_status_bad_sample || refused;
        for (std::size_t i = 0; i < nu; ++i) {
            REQUIRE(std::isfinite(control.u[i]));
            REQUIRE(std::fabs(control.u[i]) <= reals.u_max[i]);
        }
    }
    CHECK(refused);
    for (int k = 0; k < 2000; ++k) {
        REQUIRE(lpvg_control_step(&control, mid_speed(), measurement(0.05, k).data(), k > 1500) == lpvg_status_ok);
    }
}

TEST_CASE("where no state changes the demand, engaging leaves the state alone", "[unit][controller]") {
    const lpvg_control_coeff_t deaf = sealed([](lpvg_control_coeff_t& c) { std::memset(c.reals.C, 0, sizeof c.reals.C); });
    lpvg_control_t engaged = ready(deaf), released = ready(deaf);
    for (int k = 0; k < 20; ++k) {
        const std::vector<Real> m = measurement(0.05, k);
        REQUIRE(lpvg_control_step(&engaged, mid_speed(), m.data(), k >= 10) == lpvg_status_ok);
        REQUIRE(lpvg_control_step(&released, mid_speed(), m.data(), false) == lpvg_status_ok);
    }
    CHECK(engaged.engaged);
    CHECK(std::memcmp(engaged.x, released.x, sizeof engaged.x) == 0);
    CHECK(engaged.u[0] == Real(0));
}

TEST_CASE("counters of the controller saturate", "[unit][controller]") {
    lpvg_control_t control = ready();
    control.bad_samples = UINT32_MAX;
    const std::vector<Real> m(nm, std::numeric_limits<Real>::quiet_NaN());
    CHECK(lpvg_control_step(&control, mid_speed(), m.data(), true) == lpvg_status_bad_sample);
    CHECK(control.bad_samples == UINT32_MAX);
}

TEST_CASE("NULL and missing init are refused, nothing happens", "[unit][controller]") {
    lpvg_control_t control{};
    const std::vector<Real> m(nm, Real(0));
    CHECK(lpvg_control_step(nullptr, mid_speed(), m.data(), true) == lpvg_status_bad_argument);
    CHECK(lpvg_control_step(&control, mid_speed(), nullptr, true) == lpvg_status_bad_argument);
    CHECK(lpvg_control_step(&control, mid_speed(), m.data(), true) == lpvg_status_not_ready);
    CHECK(lpvg_control_init(nullptr, &lpvg_control_coeff) == lpvg_status_bad_argument);
    CHECK(lpvg_control_coeff_crc32(nullptr) == 0U);
    check_refused(nullptr, lpvg_status_bad_argument);
}

TEST_CASE("foreign, damaged and impossible controller coefficients are refused by name", "[unit][controller]") {
    CHECK(lpvg_control_coeff_check(&lpvg_control_coeff) == lpvg_status_ok);
    struct Case {
        const char* what;
        lpvg_status_t want;
        std::function<void(lpvg_control_coeff_t&)> change;
    };
    const Real nan = std::numeric_limits<Real>::quiet_NaN();
    std::vector<Case> cases = {
        {"erased", lpvg_status_bad_magic, [](lpvg_control_coeff_t& c) { std::memset(&c, 0xFF, sizeof c); }},
        {"magic", lpvg_status_bad_magic, [](lpvg_control_coeff_t& c) { ++c.words.magic; }},
        {"schema", lpvg_status_bad_schema, [](lpvg_control_coeff_t& c) { ++c.words.schema; }},
        {"number type", lpvg_status_bad_size, [](lpvg_control_coeff_t& c) { c.words.real_bytes = 12U - c.words.real_bytes; }},
        {"NaN", lpvg_status_not_finite, [nan](lpvg_control_coeff_t& c) { c.reals.L[LPVG_NG - 1][0][0] = nan; }},
        {"period", lpvg_status_bad_value, [](lpvg_control_coeff_t& c) { c.words.sample_period_us = 0U; }},
        {"first row", lpvg_status_bad_value, [](lpvg_control_coeff_t& c) { c.words.row_begin[0] = 1U; }},
        {"last row", lpvg_status_bad_value, [](lpvg_control_coeff_t& c) { ++c.words.row_begin[LPVG_NK]; }},
        {"rows descend", lpvg_status_bad_value, [](lpvg_control_coeff_t& c) { c.words.row_begin[1] = LPVG_NA + 1U; }},
        {"column", lpvg_status_bad_value, [](lpvg_control_coeff_t& c) { c.words.column[0] = LPVG_NK; }},
        {"speed", lpvg_status_bad_value, [](lpvg_control_coeff_t& c) { c.reals.speed_min = Real(0); }},
        {"speeds", lpvg_status_bad_value, [](lpvg_control_coeff_t& c) { c.reals.speed_max = c.reals.speed_min; }},
        {"limit", lpvg_status_bad_value, [](lpvg_control_coeff_t& c) { c.reals.u_max[0] = Real(0); }},
        {"rate", lpvg_status_bad_value, [](lpvg_control_coeff_t& c) { c.reals.rate_max[LPVG_NU - 1] = Real(-1); }},
    };
    for (std::size_t i = 0; i < 5U; ++i) {
        cases.push_back({"size", lpvg_status_bad_size, [i](lpvg_control_coeff_t& c) { ++c.words.sizes[i]; }});
    }
    for (const Case& test : cases) {
        CAPTURE(test.what);
        const lpvg_control_coeff_t coeff = sealed(test.change);
        check_refused(&coeff, test.want);
    }
    lpvg_control_coeff_t altered = lpvg_control_coeff;
    altered.reals.B[0][0][0] += Real(1);
    check_refused(&altered, lpvg_status_bad_crc);
}
