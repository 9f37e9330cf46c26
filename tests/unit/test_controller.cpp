// The controller against a dense recursion in double, its limits, anti-windup, engagement, and every documented failure.
#include "../catch.hpp"

#include <algorithm>
#include <cmath>
#include <cstring>
#include <functional>
#include <limits>
#include <vector>

#include "control_limits.hpp"
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

// The same controller with limits that differ from node to node and from input to input: sharp steps down and up.
lpvg_control_coeff_t with_scheduled_limits() {
    return sealed([](lpvg_control_coeff_t& c) {
        for (std::size_t g = 0; g < LPVG_NG; ++g) {
            for (std::size_t i = 0; i < nu; ++i) {
                const Real share = g % 2U == 0U ? Real(1) : Real(0.25);
                c.reals.u_max[g][i] *= share + Real(0.01) * static_cast<Real>(g + 3U * i);
            }
        }
    });
}

void check_refused(const lpvg_control_coeff_t* coeff, lpvg_status_t want) {
    CHECK(lpvg_control_coeff_check(coeff) == want);
    lpvg_control_t control, before;
    std::memset(&control, 0xA5, sizeof control);
    std::memcpy(&before, &control, sizeof control);
    CHECK(lpvg_control_init(&control, coeff) == want);
    CHECK(std::memcmp(&control, &before, sizeof control) == 0);
}

// The law of controller.h written with dense matrices of all demands' states in double: no code shared with the core.
struct Reference {
    static constexpr std::size_t n = nu * nk;
    using Matrix = std::vector<std::vector<double>>;
    const lpvg_control_reals_t& reals;
    Matrix A1 = Matrix(n, std::vector<double>(n, 0.0)), C = Matrix(nu, std::vector<double>(n, 0.0));
    std::vector<double> x = std::vector<double>(n, 0.0), u = std::vector<double>(nu, 0.0);

    explicit Reference(const lpvg_control_coeff_t& coeff) : reals(coeff.reals) {
        for (std::size_t i = 0; i < nu; ++i) {
            for (std::size_t j = 0; j < nk; ++j) {
                const std::size_t head = j / 2 * 2;
                A1[i * nk + j][i * nk + head] = static_cast<double>(reals.A1[j]);
                if (j == head) {
                    C[i][i * nk + j] = 1.0;
                    if (j + 1 < nk) {
                        A1[i * nk + j][i * nk + j + 1] = 1.0;
                    }
                }
            }
        }
    }

    void step(double speed, const std::vector<double>& m) {
        const double position = node_position(reals, speed);
        const auto g = static_cast<std::size_t>(std::fmin(std::floor(position), LPVG_NG - 2));
        const double w = position - static_cast<double>(g);
        std::vector<double> q = m, next = x;
        for (std::size_t i = 0; i < nu; ++i) {
            double v = 0.0;
            for (std::size_t j = 0; j < n; ++j) {
                v += C[i][j] * x[j];
            }
            const double rate = static_cast<double>(reals.rate_max[i]) * period_s, top = limit_at(reals, speed, i);
            const double inside = std::fmin(std::fmax(v, -top), top);
            u[i] = std::fmin(std::fmax(inside, u[i] - rate), u[i] + rate);
            q.push_back(u[i] - v);
        }
        for (std::size_t i = 0; i < n; ++i) {
            for (std::size_t j = 0; j < n; ++j) {
                next[i] += A1[i][j] * x[j];
            }
            for (std::size_t c = 0; c < nm + nu; ++c) {
                const auto entry = [&](std::size_t node) { return static_cast<double>(reals.BL[node][i / nk][i % nk][c]); };
                next[i] += ((1.0 - w) * entry(g) + w * entry(g + 1)) * q[c];
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

TEST_CASE("the law equals a dense recursion in double, within 1e-4 of its range, also against the limits",
          "[unit][controller][REQ-CTL-1]") {
    const double scale = GENERATE(0.02, 0.5);  // the second one saturates
    const bool scheduled = GENERATE(false, true);
    const lpvg_control_coeff_t coeff = scheduled ? with_scheduled_limits() : lpvg_control_coeff;
    lpvg_control_t control = ready(coeff);
    Reference reference(coeff);
    double worst = 0.0;
    for (int k = 0; k < 20000; ++k) {
        const double low = static_cast<double>(reals.speed_min), high = static_cast<double>(reals.speed_max);
        const double speed = 0.5 * (low + high) + 0.6 * (high - low) * std::sin(0.0007 * k);  // leaves the range at both ends
        const std::vector<Real> m = measurement(k == 0 ? 0.0 : scale, k);  // at rest, engaging moves nothing
        const std::vector<double> same(m.begin(), m.end());
        REQUIRE(lpvg_control_step(&control, static_cast<Real>(speed), m.data(), true) == lpvg_status_ok);
        reference.step(static_cast<double>(static_cast<Real>(speed)), same);
        for (std::size_t i = 0; i < nu; ++i) {
            const double error = std::fabs(static_cast<double>(control.u[i]) - reference.u[i]);
            worst = std::fmax(worst, error / largest_limit(reals, i));
        }
    }
    CAPTURE(worst, scheduled);
    CHECK(worst <= (sizeof(Real) == 4U ? 1e-4 : 1e-12));
    CHECK((scale < 0.1 || control.limited > 1000U));
}

TEST_CASE("changes of a state that rounding would swallow one by one add up", "[unit][controller][REQ-CTL-1]") {
    // Every state by itself: at 1, moved by 1e-8 a sample, which float cannot add to it.
    constexpr int steps = 10000;
    const std::size_t i = GENERATE(range(std::size_t{0}, nu));
    for (std::size_t j = 0; j < nk; ++j) {
        const lpvg_control_coeff_t coeff = sealed([&](lpvg_control_coeff_t& c) {
            std::memset(c.reals.A1, 0, sizeof c.reals.A1);
            std::memset(c.reals.BL, 0, sizeof c.reals.BL);
            for (auto& node : c.reals.BL) {
                node[i][j][0] = Real(1e-8);
            }
        });
        lpvg_control_t control = ready(coeff);
        control.x[i][j] = Real(1);
        std::vector<Real> m(nm, Real(0));
        m[0] = Real(1);
        for (int k = 0; k < steps; ++k) {
            REQUIRE(lpvg_control_step(&control, mid_speed(), m.data(), false) == lpvg_status_ok);
        }
        CAPTURE(i, j);
        CHECK(static_cast<double>(control.x[i][j]) == Approx(1.0 + 1e-8 * steps).margin(2e-7));
    }
}

TEST_CASE("demand and its change never exceed their limits, engaged or not", "[unit][controller][REQ-CTL-2]") {
    lpvg_control_t control = ready();
    std::vector<Real> before(nu, Real(0));
    for (int k = 0; k < 5000; ++k) {
        const std::vector<Real> m = measurement(k % 500 < 250 ? 50.0 : 0.01, k);
        REQUIRE(lpvg_control_step(&control, mid_speed(), m.data(), k % 70 < 50) == lpvg_status_ok);
        for (std::size_t i = 0; i < nu; ++i) {
            REQUIRE(static_cast<double>(std::fabs(control.u[i])) <= limit_at(reals, static_cast<double>(mid_speed()), i) * rounding);
            REQUIRE(static_cast<double>(std::fabs(control.u[i] - before[i])) <= largest_change(lpvg_control_coeff, i) * (1.0 + 1e-4));
            before[i] = control.u[i];
        }
    }
}

TEST_CASE("overdriven, the demand stands at the limit of the speed: at nodes, between them and beyond", "[unit][controller][REQ-CTL-2]") {
    const lpvg_control_coeff_t coeff = with_scheduled_limits();
    const lpvg_control_reals_t& r = coeff.reals;
    const Real sign = GENERATE(Real(1), Real(-1));
    std::vector<Real> m(nm, Real(0));
    m[0] = sign * Real(50);
    for (int place = -1; place <= 4 * (LPVG_NG - 1) + 1; ++place) {  // four places a cell, and one beyond either end
        const Real speed = r.speed_min + (r.speed_max - r.speed_min) * static_cast<Real>(place) / Real(4 * (LPVG_NG - 1));
        lpvg_control_t control = ready(coeff);
        for (int k = 0; k < 400; ++k) {
            REQUIRE(lpvg_control_step(&control, speed, m.data(), true) == lpvg_status_ok);
        }
        const double want = limit_at(r, static_cast<double>(speed), 0U);
        CAPTURE(place, want);
        CHECK(std::fabs(static_cast<double>(std::fabs(control.u[0])) - want) <= 1e-6 * want);
        const auto node = static_cast<std::size_t>(place < 0 ? 0 : std::min(place / 4, LPVG_NG - 1));
        if (place < 0 || place % 4 == 0 || place > 4 * (LPVG_NG - 1)) {
            // A node's speed is rounded, and its neighbours' limits differ by as much as its own.
            CHECK(std::fabs(static_cast<double>(std::fabs(control.u[0]) - r.u_max[node][0])) <= 4e-6 * want);
        }
        const auto settled = static_cast<double>(std::fabs(control.u[0]));
        CHECK((control.limited >= 1U && settled > 0.0));
    }
}

TEST_CASE("a speed that moves or jumps makes no jump of the demand, and its limit is met at the rate limit",
          "[unit][controller][REQ-CTL-2]") {
    const lpvg_control_coeff_t coeff = with_scheduled_limits();
    const lpvg_control_reals_t& r = coeff.reals;
    const int hold = GENERATE(1, 7, 100);  // samples between jumps
    lpvg_control_t control = ready(coeff);
    std::vector<Real> before(nu, Real(0));
    std::size_t above = 0, longest = 0, in_a_row = 0, at_limit = 0;
    for (int k = 0; k < 20000; ++k) {
        const std::vector<Real> m = measurement(k % 5000 < 4000 ? 50.0 : 0.01, k);
        const double share = 0.5 + 0.6 * std::sin(2.4 * (k / hold));  // NOLINT: jumps of every size
        const Real speed = r.speed_min + static_cast<Real>(share) * (r.speed_max - r.speed_min);
        REQUIRE(lpvg_control_step(&control, speed, m.data(), k % 700 < 600) == lpvg_status_ok);
        bool any = false;
        for (std::size_t i = 0; i < nu; ++i) {
            REQUIRE(within_limits(coeff, static_cast<double>(speed), i, before[i], control.u[i]));
            const double size = static_cast<double>(std::fabs(control.u[i])), top = limit_at(r, static_cast<double>(speed), i);
            any = any || size > top * 1.001;
            at_limit += std::fabs(size - top) <= 1e-6 * top ? 1U : 0U;
            before[i] = control.u[i];
        }
        above += any ? 1U : 0U;
        in_a_row = any ? in_a_row + 1U : 0U;
        longest = std::max(longest, in_a_row);
    }
    CAPTURE(above, longest, at_limit);
    CHECK(above > 0U);  // a jump that the rate limit cannot follow at once
    CHECK((hold < 100 || at_limit > 1000U));
    double bound = 0.0;
    for (std::size_t i = 0; i < nu; ++i) {
        bound = std::fmax(bound, largest_limit(r, i) / largest_change(coeff, i));
    }
    CHECK((hold < 100 || static_cast<double>(longest) <= std::ceil(bound)));
}

TEST_CASE("released, the demand is zero after at most the largest u_max / rate_max", "[unit][controller][REQ-CTL-3]") {
    lpvg_control_t control = ready();
    const std::vector<Real> m = measurement(50.0, 40);
    for (int k = 0; k < 300; ++k) {
        REQUIRE(lpvg_control_step(&control, mid_speed(), m.data(), true) == lpvg_status_ok);
    }
    CHECK(static_cast<double>(std::fabs(control.u[0])) * rounding >= limit_at(reals, static_cast<double>(mid_speed()), 0U));
    const auto steps = static_cast<int>(std::ceil(largest_limit(reals, 0U) / largest_change(lpvg_control_coeff, 0U)));
    for (int k = 0; k <= steps; ++k) {
        REQUIRE(lpvg_control_step(&control, mid_speed(), m.data(), false) == lpvg_status_ok);
    }
    for (std::size_t i = 0; i < nu; ++i) {
        CHECK(control.u[i] == Real(0));
    }
}

TEST_CASE("engaging moves neither this demand nor the next by a step of its number grid", "[unit][controller][REQ-CTL-4]") {
    constexpr double quantisation = 1.0 / 2048.0;  // of the demand on the bus
    const int released = GENERATE(1, 7, 150, 3000);
    const double scale = GENERATE(0.02, 2.0);
    lpvg_control_t control = ready();
    int k = 0;
    const auto step = [&](bool engaged) {
        REQUIRE(lpvg_control_step(&control, mid_speed(), measurement(scale, k).data(), engaged) == lpvg_status_ok);
        ++k;
    };
    while (k < 400) {
        step(true);
    }
    while (k < 400 + released) {
        step(false);
    }
    const std::vector<Real> before(control.u, control.u + nu);
    CAPTURE(released, scale);
    for (int sample = 0; sample < 2; ++sample) {
        step(true);
        for (std::size_t i = 0; i < nu; ++i) {
            CHECK(static_cast<double>(std::fabs(control.u[i] - before[i])) < quantisation);
        }
    }
}

namespace {

// Seconds in the minute after a minute of overdriving in which the demand is within a tenth of its limit, at either sign: a wound-up
// state may pass 0 and swing to the other limit.
double seconds_at_the_limit(const lpvg_control_coeff_t& coeff) {
    lpvg_control_t control = ready(coeff);
    std::vector<Real> m(nm, Real(0));
    m[0] = Real(1);
    for (int k = 0; k < 6000; ++k) {
        REQUIRE(lpvg_control_step(&control, mid_speed(), m.data(), true) == lpvg_status_ok);
    }
    const double top = limit_at(reals, static_cast<double>(mid_speed()), 0U);
    REQUIRE(static_cast<double>(std::fabs(control.u[0])) * rounding >= top);
    m[0] = Real(0);
    int steps = 0;
    for (int k = 0; k < 6000; ++k) {
        steps += static_cast<double>(std::fabs(control.u[0])) > 0.9 * top ? 1 : 0;
        REQUIRE(lpvg_control_step(&control, mid_speed(), m.data(), true) == lpvg_status_ok);
    }
    return steps * period_s;
}

}  // namespace

TEST_CASE("saturation does not wind the state up", "[unit][controller][REQ-CTL-5]") {
    const lpvg_control_coeff_t without = sealed([](lpvg_control_coeff_t& c) {
        for (auto& row : reinterpret_cast<Real(&)[LPVG_NG * nu * nk][nm + nu]>(c.reals.BL)) {
            std::fill(row + nm, row + nm + nu, Real(0));
        }
    });
    const double with_s = seconds_at_the_limit(lpvg_control_coeff), without_s = seconds_at_the_limit(without);
    CAPTURE(with_s, without_s);
    CHECK(with_s < 5.0);
    CHECK(with_s < 0.2 * without_s);
}

TEST_CASE("a number that is not finite releases the demand and spoils nothing", "[unit][controller][REQ-CTL-6]") {
    const Real bad =
        GENERATE(std::numeric_limits<Real>::quiet_NaN(), std::numeric_limits<Real>::infinity(), -std::numeric_limits<Real>::infinity());
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

TEST_CASE("a state that grew beyond the numbers is cleared", "[unit][controller][REQ-CTL-6]") {
    const Real huge = std::numeric_limits<Real>::max();
    const lpvg_control_coeff_t steep = sealed([](lpvg_control_coeff_t& c) {
        for (auto& node : c.reals.BL) {
            for (auto& demand : node) {
                for (auto& row : demand) {
                    std::for_each(row, row + nm, [](Real& gain) { gain *= Real(100); });
                }
            }
        }
    });
    lpvg_control_t control = ready(steep);
    std::vector<Real> m(nm, -huge);
    m[0] = huge;
    bool refused = false;
    for (int k = 0; k < 2000; ++k) {
        refused = lpvg_control_step(&control, mid_speed(), m.data(), true) == lpvg_status_bad_sample || refused;
        for (std::size_t i = 0; i < nu; ++i) {
            REQUIRE(std::isfinite(control.u[i]));
            REQUIRE(static_cast<double>(std::fabs(control.u[i])) <= limit_at(reals, static_cast<double>(mid_speed()), i) * rounding);
        }
    }
    CHECK(refused);
    for (int k = 0; k < 2000; ++k) {
        REQUIRE(lpvg_control_step(&control, mid_speed(), measurement(0.05, k).data(), k > 1500) == lpvg_status_ok);
    }
}

TEST_CASE("a state that is cleared forgets what rounding had taken, too", "[unit][controller][REQ-CTL-6]") {
    const std::vector<Real> m(nm, Real(0));
    lpvg_control_t control = ready(), rested = ready();
    control.x[0][0] = std::numeric_limits<Real>::infinity();
    for (auto& carries : control.carry) {
        std::fill(std::begin(carries), std::end(carries), Real(0.5));
    }
    CHECK(lpvg_control_step(&control, mid_speed(), m.data(), false) == lpvg_status_bad_sample);
    CHECK(lpvg_control_step(&rested, mid_speed(), m.data(), false) == lpvg_status_ok);
    CHECK(std::memcmp(control.x, rested.x, sizeof control.x) == 0);
    CHECK(std::memcmp(control.carry, rested.carry, sizeof control.carry) == 0);
}

TEST_CASE("what is limited is counted while engaged, and only then", "[unit][controller][REQ-CTL-2]") {
    lpvg_control_t control = ready();
    const std::vector<Real> still(nm, Real(0)), hard(nm, Real(50));
    for (int k = 0; k < 10; ++k) {
        REQUIRE(lpvg_control_step(&control, mid_speed(), still.data(), true) == lpvg_status_ok);
    }
    CHECK(control.limited == 0U);  // at rest nothing is
    for (int k = 0; k < 300; ++k) {
        REQUIRE(lpvg_control_step(&control, mid_speed(), hard.data(), true) == lpvg_status_ok);
    }
    const uint32_t counted = control.limited;
    CHECK(counted > 200U);
    for (int k = 0; k < 50; ++k) {  // the states still ask for more than the released demand is
        REQUIRE(lpvg_control_step(&control, mid_speed(), hard.data(), false) == lpvg_status_ok);
    }
    CHECK(control.limited == counted);
}

TEST_CASE("counters of the controller saturate", "[unit][controller]") {
    lpvg_control_t control = ready();
    control.bad_samples = UINT32_MAX - 1U;
    const std::vector<Real> m(nm, std::numeric_limits<Real>::quiet_NaN());
    for (int k = 0; k < 2; ++k) {
        CHECK(lpvg_control_step(&control, mid_speed(), m.data(), true) == lpvg_status_bad_sample);
        CHECK(control.bad_samples == UINT32_MAX);
    }
}

TEST_CASE("NULL and missing init are refused, nothing happens", "[unit][controller][REQ-CTL-7]") {
    lpvg_control_t control{};
    const std::vector<Real> m(nm, Real(0));
    CHECK(lpvg_control_step(nullptr, mid_speed(), m.data(), true) == lpvg_status_bad_argument);
    CHECK(lpvg_control_step(&control, mid_speed(), nullptr, true) == lpvg_status_bad_argument);
    CHECK(lpvg_control_step(&control, mid_speed(), m.data(), true) == lpvg_status_not_ready);
    CHECK(lpvg_control_init(nullptr, &lpvg_control_coeff) == lpvg_status_bad_argument);
    CHECK(lpvg_control_coeff_crc32(nullptr) == 0U);
    check_refused(nullptr, lpvg_status_bad_argument);
}

TEST_CASE("foreign, damaged and impossible controller coefficients are refused by name", "[unit][controller][REQ-COEF-1]") {
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
        {"NaN", lpvg_status_not_finite, [nan](lpvg_control_coeff_t& c) { c.reals.BL[LPVG_NG - 1][nu - 1][nk - 1][nm + nu - 1] = nan; }},
        {"period", lpvg_status_bad_value, [](lpvg_control_coeff_t& c) { c.words.sample_period_us = 0U; }},
        {"speed", lpvg_status_bad_value, [](lpvg_control_coeff_t& c) { c.reals.speed_min = Real(0); }},
        {"speeds", lpvg_status_bad_value, [](lpvg_control_coeff_t& c) { c.reals.speed_max = c.reals.speed_min; }},
        {"hardly a range of speeds", lpvg_status_ok, [](lpvg_control_coeff_t& c) { c.reals.speed_min = Real(0.999) * c.reals.speed_max; }},
        {"first limit", lpvg_status_bad_value, [](lpvg_control_coeff_t& c) { c.reals.u_max[0][0] = Real(0); }},
        {"last limit", lpvg_status_bad_value, [](lpvg_control_coeff_t& c) { c.reals.u_max[LPVG_NG - 1][nu - 1] = Real(-1); }},
        {"least limit", lpvg_status_ok,
         [](lpvg_control_coeff_t& c) { c.reals.u_max[LPVG_NG - 1][nu - 1] = std::numeric_limits<Real>::min(); }},
        {"largest limits", lpvg_status_ok,
         [](lpvg_control_coeff_t& c) { c.reals.u_max[0][0] = c.reals.u_max[1][0] = std::numeric_limits<Real>::max(); }},
        {"rate", lpvg_status_bad_value, [](lpvg_control_coeff_t& c) { c.reals.rate_max[LPVG_NU - 1] = Real(-1); }},
        {"no rate", lpvg_status_bad_value, [](lpvg_control_coeff_t& c) { c.reals.rate_max[LPVG_NU - 1] = Real(0); }},
        {"least rate, period and speed", lpvg_status_ok,
         [](lpvg_control_coeff_t& c) {
             c.reals.rate_max[LPVG_NU - 1] = c.reals.speed_min = std::numeric_limits<Real>::min();
             c.words.sample_period_us = 1U;
         }},
    };
    for (std::size_t i = 0; i < 4U; ++i) {
        cases.push_back({"size", lpvg_status_bad_size, [i](lpvg_control_coeff_t& c) { ++c.words.sizes[i]; }});
    }
    for (const Case& test : cases) {
        CAPTURE(test.what);
        const lpvg_control_coeff_t coeff = sealed(test.change);
        if (test.want == lpvg_status_ok) {
            CHECK(lpvg_control_coeff_check(&coeff) == lpvg_status_ok);
        } else {
            check_refused(&coeff, test.want);
        }
    }
    lpvg_control_coeff_t altered = lpvg_control_coeff;
    altered.reals.BL[0][0][0][0] += Real(1);
    check_refused(&altered, lpvg_status_bad_crc);
}

TEST_CASE("the rate limit goes by the time since the sample before, up to one and a half periods", "[unit][controller][REQ-CTL-2]") {
    const uint32_t period_us = lpvg_control_coeff.words.sample_period_us;
    const uint32_t elapsed_us = GENERATE_COPY(0U, period_us / 4U, period_us, period_us + period_us / 2U, 10U * period_us, UINT32_MAX);
    lpvg_control_t control;
    REQUIRE(lpvg_control_init(&control, &lpvg_control_coeff) == lpvg_status_ok);
    const auto start = static_cast<double>(lpvg_control_coeff.reals.u_max[0][0]);
    control.u[0] = static_cast<lpvg_real_t>(start);
    const lpvg_real_t m[LPVG_NM] = {};
    REQUIRE(lpvg_control_step_after(&control, lpvg_control_coeff.reals.speed_min, m, false, elapsed_us) == lpvg_status_ok);
    const double allowed_us = std::fmin(elapsed_us, 1.5 * period_us);
    const double moved = static_cast<double>(lpvg_control_coeff.reals.rate_max[0]) * 1e-6 * allowed_us;
    CHECK(static_cast<double>(control.u[0]) == Approx(std::fmax(start - moved, 0.0)).margin(1e-6 * start));
    CHECK(lpvg_control_step_after(nullptr, lpvg_real_t(1), m, false, elapsed_us) == lpvg_status_bad_argument);
    CHECK(lpvg_control_step(nullptr, lpvg_real_t(1), m, false) == lpvg_status_bad_argument);
}

TEST_CASE("nothing behind the measurements is read", "[unit][controller][REQ-CTL-6]") {
    lpvg_control_t control = ready();
    std::vector<Real> m(nm + 1U, Real(0.01));
    m[nm] = std::numeric_limits<Real>::quiet_NaN();
    CHECK(lpvg_control_step(&control, mid_speed(), m.data(), true) == lpvg_status_ok);
}

TEST_CASE("a refused sample moves the states the same way whatever is not finite, engaging or not", "[unit][controller][REQ-CTL-6]") {
    const Real inf = std::numeric_limits<Real>::infinity(), nan = std::numeric_limits<Real>::quiet_NaN();
    const bool engaged = GENERATE(false, true);
    const std::vector<Real> m = measurement(0.05, 7), bad(nm, nan);
    lpvg_control_t driven = ready();
    for (int k = 0; k < 100; ++k) {
        REQUIRE(lpvg_control_step(&driven, mid_speed(), measurement(0.05, k).data(), true) == lpvg_status_ok);
    }
    REQUIRE(lpvg_control_step(&driven, mid_speed(), m.data(), false) == lpvg_status_ok);
    lpvg_control_t reference = driven;
    const std::vector<Real> nothing(nm, Real(0));
    REQUIRE(lpvg_control_step(&reference, reals.speed_min, nothing.data(), false) == lpvg_status_ok);
    struct Sample {
        Real speed;
        const std::vector<Real>& m;
    };
    for (const Sample& sample : {Sample{mid_speed(), bad}, {reals.speed_max, bad}, {inf, m}, {-inf, m}, {nan, m}}) {
        lpvg_control_t control = driven;
        CHECK(lpvg_control_step(&control, sample.speed, sample.m.data(), engaged) == lpvg_status_bad_sample);
        CHECK(std::memcmp(control.x, reference.x, sizeof control.x) == 0);
        CHECK(std::memcmp(control.u, reference.u, sizeof control.u) == 0);
    }
}

TEST_CASE("every step in which a limit changed the demand is counted, however little and in either direction",
          "[unit][controller][REQ-CTL-2]") {
    const Real scale = GENERATE(Real(0.02), Real(-0.02), Real(1), Real(-1));
    lpvg_control_t control = ready();
    uint32_t expected = 0;
    for (int k = 0; k < 600; ++k) {
        Real v[nu] = {};
        for (std::size_t i = 0; i < nu; ++i) {
            for (std::size_t j = 0; j < nk; j += 2U) {
                v[i] += control.x[i][j];
            }
        }
        const Real reference = k == 0 ? Real(0) : scale;  // engages at rest: no state is moved
        std::vector<Real> m(nm, -reference);
        m[0] = reference;
        REQUIRE(lpvg_control_step(&control, mid_speed(), m.data(), true) == lpvg_status_ok);
        expected += std::equal(std::begin(v), std::end(v), std::begin(control.u)) ? 0U : 1U;
    }
    CHECK(control.limited == expected);
    CHECK((std::fabs(scale) < Real(1) || expected > 0U));
}

TEST_CASE("a demand that alone is limited counts, whichever it is and whichever way", "[unit][controller][REQ-CTL-2]") {
    const Real scale = GENERATE(Real(1), Real(-1));
    for (std::size_t only = 0; only < nu; ++only) {
        const lpvg_control_coeff_t coeff = sealed([only](lpvg_control_coeff_t& c) {
            for (std::size_t i = 0; i < nu; ++i) {
                c.reals.rate_max[i] = i == only ? Real(1e-6) : Real(1e6);
                for (auto& limits : c.reals.u_max) {
                    limits[i] = Real(1e6);
                }
            }
        });
        lpvg_control_t control = ready(coeff);
        const std::vector<Real> still(nm, Real(0)), m(nm, scale);
        REQUIRE(lpvg_control_step(&control, mid_speed(), still.data(), true) == lpvg_status_ok);
        for (int k = 0; k < 20; ++k) {
            REQUIRE(lpvg_control_step(&control, mid_speed(), m.data(), true) == lpvg_status_ok);
        }
        CHECK(control.limited >= 18U);
    }
}

TEST_CASE("damaged speeds of the nodes are as the lowest speed: nothing beside the nodes is read", "[unit][controller][REQ-CTL-6]") {
    lpvg_control_coeff_t damaged = with_scheduled_limits();
    const lpvg_control_coeff_t whole = damaged;
    (GENERATE(false, true) ? damaged.reals.speed_max : damaged.reals.speed_min) = std::numeric_limits<Real>::quiet_NaN();
    lpvg_control_t control = ready(whole), reference = ready(whole);
    control.coeff = &damaged;
    for (int k = 0; k < 50; ++k) {
        const std::vector<Real> m = measurement(0.5, k);
        CHECK(lpvg_control_step(&control, mid_speed(), m.data(), true) == lpvg_status_ok);
        CHECK(lpvg_control_step(&reference, whole.reals.speed_min, m.data(), true) == lpvg_status_ok);
    }
    CHECK(std::memcmp(control.x, reference.x, sizeof control.x) == 0);
    CHECK(std::memcmp(control.u, reference.u, sizeof control.u) == 0);
}
