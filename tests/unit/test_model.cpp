// The nominal model's recursion against exact zero-order hold in double (golden_model.hpp, from the Python package).
#include "../catch.hpp"

#include <algorithm>
#include <cmath>
#include <cstddef>
#include <cstring>
#include <limits>

#include "monitor/acceptance.hpp"
#include "golden_model.hpp"
#include "lpvguard/model.h"

namespace {

using Real = lpvg_real_t;
constexpr std::size_t n_samples = sizeof golden::speed / sizeof golden::speed[0];

// Speed table 1e-6 of an entry (TABLE_TOLERANCE), rounding of float, both amplified by the slowest pole's memory.
constexpr double tolerance = sizeof(Real) == 4U ? 2e-5 : 1e-5;

struct Inputs {
    Real u[LPVG_NU];
    explicit Inputs(std::size_t k) {
        for (std::size_t i = 0; i < LPVG_NU; ++i) {
            u[i] = static_cast<Real>(golden::input[k][i]);
        }
    }
};

lpvg_model_t started() {
    Real y[LPVG_NY];
    for (std::size_t j = 0; j < LPVG_NY; ++j) {
        y[j] = static_cast<Real>(golden::first_output[0][j]);
    }
    lpvg_model_t model;
    std::memset(&model, 0xFF, sizeof model);  // NaN: whatever a start leaves as it was spoils the outputs
    lpvg_model_start(&model, &lpvg_coeff, Inputs(0).u, y);
    return model;
}

// Entries that belong to one speed, as an advance at that speed leaves them.
lpvg_model_t advanced_at(Real speed) {
    lpvg_model_t model = started();
    lpvg_model_advance(&model, &lpvg_coeff, speed, Inputs(0).u);
    return model;
}

bool same_entries(const lpvg_model_t& a, const lpvg_model_t& b) {
    return std::equal(std::begin(a.entry), std::end(a.entry), std::begin(b.entry));
}

}  // namespace

TEST_CASE("a start leaves nothing of what the memory held", "[unit][model][REQ-MOD-1]") {
    const lpvg_model_t model = started();
    CHECK(std::equal(std::begin(model.entry), std::end(model.entry), std::begin(lpvg_coeff.reals.base)));
    CHECK(model.sum == lpvguard::sum_of_words(model.entry));
    for (const auto& past : model.past) {
        for (const Real u : past) {
            CHECK(std::isfinite(u));
        }
    }
}

TEST_CASE("the recursion follows the exact zero-order hold, delay included", "[unit][model][REQ-MOD-1]") {
    double size[LPVG_NY] = {};
    for (std::size_t k = 0; k < n_samples; ++k) {
        for (std::size_t j = 0; j < LPVG_NY; ++j) {
            size[j] = std::max(size[j], std::fabs(golden::output[k][j]));
        }
    }
    lpvg_model_t model = started();
    double worst = 0.0;
    for (std::size_t k = 0; k < n_samples; ++k) {
        Real yhat[LPVG_NY];
        lpvg_model_output(&model, &lpvg_coeff, yhat);
        for (std::size_t j = 0; j < LPVG_NY; ++j) {
            worst = std::max(worst, std::fabs(static_cast<double>(yhat[j]) - golden::output[k][j]) / size[j]);
        }
        lpvg_model_advance(&model, &lpvg_coeff, static_cast<Real>(golden::speed[k][0]), Inputs(k).u);
    }
    CAPTURE(worst);
    CHECK(worst <= tolerance);
}

TEST_CASE("an input step reaches the output after the delay and not before", "[unit][model][REQ-MOD-1]") {
    const lpvg_coeff_reals_t& r = lpvg_coeff.reals;
    Real rest[LPVG_NU], step[LPVG_NU];
    for (std::size_t i = 0; i < LPVG_NU; ++i) {
        rest[i] = r.input_offset[i];
        step[i] = rest[i] + Real(0.25);
    }
    lpvg_model_t model{};
    lpvg_model_start(&model, &lpvg_coeff, rest, r.output_offset);
    const Real speed = Real(0.5) * (r.speed_min + r.speed_max);
    Real yhat[LPVG_NY];
    for (std::size_t k = 0; k != LPVG_DELAY; ++k) {
        lpvg_model_advance(&model, &lpvg_coeff, speed, step);
        lpvg_model_output(&model, &lpvg_coeff, yhat);
        for (std::size_t j = 0; j < LPVG_NY; ++j) {
            CHECK(yhat[j] == r.output_offset[j]);
        }
    }
    lpvg_model_advance(&model, &lpvg_coeff, speed, step);
    lpvg_model_output(&model, &lpvg_coeff, yhat);
    for (std::size_t j = 0; j < LPVG_NY; ++j) {
        CHECK(yhat[j] != r.output_offset[j]);
    }
}

TEST_CASE("outside the scheduling range the nearest speed is used", "[unit][model][REQ-MOD-2]") {
    const lpvg_coeff_reals_t& r = lpvg_coeff.reals;
    const lpvg_model_t slowest = advanced_at(r.speed_min);
    const lpvg_model_t fastest = advanced_at(r.speed_max);
    CHECK_FALSE(same_entries(slowest, fastest));
    for (std::size_t i = 0; i < LPVG_NVARYING; ++i) {  // the table's own ends: the first cell at 0, the last one at 1
        const Real *low = r.cell[0][i], *high = r.cell[LPVG_NCELLS - 1][i];
        const uint32_t entry = lpvg_coeff.words.varying_entry[i];
        CHECK(slowest.entry[entry] == low[0]);
        CHECK(fastest.entry[entry] == high[0] + (high[1] + (high[2] + high[3])));
    }
    for (const Real speed : {Real(-100), Real(-1), Real(0), r.speed_min / Real(2)}) {
        CAPTURE(speed);
        CHECK(same_entries(advanced_at(speed), slowest));
    }
    for (const Real speed : {r.speed_max * Real(1.001), Real(100), Real(1e30)}) {
        CAPTURE(speed);
        CHECK(same_entries(advanced_at(speed), fastest));
    }
}

TEST_CASE("a start takes each input for what it was before", "[unit][model][REQ-MOD-1]") {
    lpvg_coeff_t coeff = lpvg_coeff;
    Real u[LPVG_NU];
    for (std::size_t i = 0; i < LPVG_NU; ++i) {
        coeff.reals.input_offset[i] = static_cast<Real>(i + 1U);
        u[i] = static_cast<Real>(3U * (i + 1U));
    }
    lpvg_model_t model{};
    lpvg_model_start(&model, &coeff, u, coeff.reals.output_offset);
    for (const auto& past : model.past) {
        for (std::size_t i = 0; i < LPVG_NU; ++i) {
            CHECK(past[i] == static_cast<Real>(2U * (i + 1U)));
        }
    }
}

TEST_CASE("a speed has the cubic of its own cell, up to the cell's end", "[unit][model][REQ-MOD-1]") {
    lpvg_coeff_t steps = lpvg_coeff;  // entry = number of the cell + place in it
    for (std::size_t c = 0; c < LPVG_NCELLS; ++c) {
        for (auto& p : steps.reals.cell[c]) {
            p[0] = static_cast<Real>(2U * c);
            p[1] = Real(1);
            p[2] = p[3] = Real(0);
        }
    }
    const lpvg_coeff_reals_t& r = steps.reals;
    const Real width = (r.speed_max - r.speed_min) / static_cast<Real>(LPVG_NCELLS);
    for (std::size_t c = 0; c < LPVG_NCELLS; ++c) {
        for (const Real x : {Real(0.01), Real(0.5), Real(0.99)}) {
            lpvg_model_t model = started();
            lpvg_model_advance(&model, &steps, r.speed_min + (static_cast<Real>(c) + x) * width, Inputs(0).u);
            const auto entry = static_cast<double>(model.entry[lpvg_coeff.words.varying_entry[0]]);
            CHECK(entry == Approx(2.0 * static_cast<double>(c) + static_cast<double>(x)).margin(2e-3));
        }
    }
}

TEST_CASE("entries join at the cell borders", "[unit][model][REQ-MOD-1]") {
    const lpvg_coeff_reals_t& r = lpvg_coeff.reals;
    double worst = 0.0;
    for (std::size_t c = 1; c < LPVG_NCELLS; ++c) {
        const Real border = r.speed_min + (r.speed_max - r.speed_min) * static_cast<Real>(c) / static_cast<Real>(LPVG_NCELLS);
        const lpvg_model_t below = advanced_at(border * Real(0.999999));
        const lpvg_model_t above = advanced_at(border * Real(1.000001));
        for (std::size_t i = 0; i < LPVG_NENTRIES; ++i) {
            worst = std::max(worst, static_cast<double>(std::fabs(above.entry[i] - below.entry[i])));
        }
    }
    CAPTURE(worst);
    CHECK(worst <= 2e-5);
}

TEST_CASE("a damaged index of an entry is used as the first: nothing behind the entries is written", "[unit][model][REQ-MON-15]") {
    lpvg_coeff_t damaged = lpvg_coeff;
    damaged.words.varying_entry[0] = LPVG_NENTRIES;
    const lpvg_coeff_reals_t& r = lpvg_coeff.reals;
    lpvg_model_t model = advanced_at(r.speed_min), good = model;
    lpvg_model_advance(&model, &damaged, r.speed_max, Inputs(0).u);
    lpvg_model_advance(&good, &lpvg_coeff, r.speed_max, Inputs(0).u);
    const std::size_t hit = lpvg_coeff.words.varying_entry[0];
    CHECK(model.entry[0] == good.entry[hit]);
    for (std::size_t i = 1; i < LPVG_NENTRIES; ++i) {
        CHECK((i == hit || model.entry[i] == good.entry[i]));
    }
}

TEST_CASE("entries are recomputed when the speed moves, and only then", "[unit][model]") {
    const lpvg_coeff_reals_t& r = lpvg_coeff.reals;
    const Real speed = Real(0.5) * (r.speed_min + r.speed_max);
    lpvg_model_t model = advanced_at(speed);
    const lpvg_model_t fresh = model;
    const std::size_t varying = lpvg_coeff.words.varying_entry[0];
    model.entry[varying] = Real(123);  // shows whether the table was read again
    lpvg_model_advance(&model, &lpvg_coeff, speed, Inputs(0).u);
    CHECK(model.entry[varying] == Real(123));
    lpvg_model_advance(&model, &lpvg_coeff, r.speed_min, Inputs(0).u);
    lpvg_model_advance(&model, &lpvg_coeff, speed, Inputs(0).u);
    CHECK(same_entries(model, fresh));
}

TEST_CASE("damaged ends of the scheduling range are as its lowest speed: nothing beside the cells is read", "[unit][model][REQ-MON-15]") {
    lpvg_coeff_t damaged = lpvg_coeff;
    (GENERATE(false, true) ? damaged.reals.speed_max : damaged.reals.speed_min) = std::numeric_limits<Real>::quiet_NaN();
    const lpvg_coeff_reals_t& r = lpvg_coeff.reals;
    lpvg_model_t model = started();
    lpvg_model_advance(&model, &damaged, Real(0.5) * (r.speed_min + r.speed_max), Inputs(0).u);
    CHECK(same_entries(model, advanced_at(r.speed_min)));
}
