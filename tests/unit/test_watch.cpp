// The watch of the response: its limits, and a violation exactly where a gain error is beyond them.
#include "../catch.hpp"

#include <algorithm>
#include <cmath>
#include <cstring>
#include <limits>
#include <vector>

#include "lpvguard/watch.h"

namespace {

constexpr std::size_t ny = LPVG_NY;
constexpr double period_s = 0.01;

// A vehicle at rest whose nominal error is `gain` times its response to the demand, plus an offset that was there before.
class Vehicle {
public:
    explicit Vehicle(const lpvg_coeff_t& coeff = lpvg_coeff) : coeff_(coeff) {
        const lpvg_real_t nothing[LPVG_NU + LPVG_NY] = {};
        lpvg_model_start(&model_, &coeff_, nothing, nothing);
        lpvg_model_advance(&model_, &coeff_, lpvg_real_t(15), nothing);
        lpvg_watch_limits(&limits, &coeff_);
        lpvg_watch_start(&watch, &model_);
    }

    // A sample: the watch's verdicts, and what they must be by the definition in double. True where both agree, or rounding decides.
    bool step(double demand, double gain, bool settled = true, bool measured = true) {
        settled = settled && !rests_;
        rests_ = !measured;
        lpvg_real_t phi[ny];
        lpvg_model_output(&model_, &coeff_, phi);
        for (std::size_t j = 0; j < ny; ++j) {
            y_[j] = static_cast<lpvg_real_t>(1.0 + gain) * phi[j] + static_cast<lpvg_real_t>(offset(j));
        }
        const lpvg_real_t u[LPVG_NU] = {static_cast<lpvg_real_t>(demand)};
        lpvg_watch_take(&watch, &limits, &coeff_, &model_, settled, measured ? y_ : nullptr, u);
        lpvg_model_advance(&model_, &coeff_, lpvg_real_t(15), u);
        if (!measured) {
            return true;
        }
        bool violated = false, evidence = false, close = false;
        for (std::size_t j = 0; j < ny; ++j) {
            const double now = static_cast<double>(phi[j]);
            const double slow_share = 1.0 - 1.0 / (1.0 + static_cast<double>(LPVG_WATCH_CORNER_RPS) * period_s);
            slow_[j] += (settled ? slow_share : 1.0) * (now - slow_[j]);
            below_[j] += (settled ? 2.0 * static_cast<double>(coeff_.reals.energy_corner[LPVG_NBANDS - 2]) : 1.0) * (now - below_[j]);
            const double parts[LPVG_WATCH_MEMORIES] = {now - below_[j], now - slow_[j], below_[j]};
            for (std::size_t m = 0; m < LPVG_WATCH_MEMORIES; ++m) {
                const bool lasting = m == 2U;
                const double response = parts[m], error = gain * response + (lasting ? offset(j) : 0.0);
                const double memory_s = static_cast<double>(m == 0U ? LPVG_WATCH_SHORT_S : LPVG_WATCH_LONG_S);
                const double rho = lasting ? 1.0 - static_cast<double>(coeff_.reals.energy_forget[0]) : memory_s / (memory_s + period_s);
                const double disturbance = static_cast<double>(limits.disturbance[m][j]);
                double &p = products_[m][j], &q = sums_[m][j];
                p = settled ? p * rho + error * response : p;
                q = settled ? q * rho + response * response : q;
                const double limit = static_cast<double>(limits.gain[j]) * q + disturbance * std::sqrt(q);
                violated = violated || (std::fabs(p) > limit && static_cast<double>(LPVG_WATCH_ERROR_SHOWN) * q > limit);
                evidence = evidence || q > limit;
                close = close || std::fabs(std::fabs(p) - limit) <= 1e-2 * limit || std::fabs(q - limit) <= 1e-2 * limit ||
                        std::fabs(static_cast<double>(LPVG_WATCH_ERROR_SHOWN) * q - limit) <= 1e-2 * limit;
            }
        }
        return close || (violated == watch.violated && evidence == watch.evidence);
    }

    // The sums anew, as behind lpvg_watch_void.
    void forget() {
        std::fill(&sums_[0][0], &sums_[0][0] + LPVG_WATCH_MEMORIES * ny, 0.0);
        std::fill(&products_[0][0], &products_[0][0] + LPVG_WATCH_MEMORIES * ny, 0.0);
    }
    // Largest constant offset that the third pair of sums leaves to a disturbance.
    double largest_offset(std::size_t j) const {
        return static_cast<double>(limits.disturbance[2][j]) * std::sqrt(static_cast<double>(coeff_.reals.energy_forget[0]));
    }
    double offset(std::size_t j) const { return share * largest_offset(j); }

    double share = 0.5;  // of the offset in the largest one

    lpvg_watch_limits_t limits{};
    lpvg_watch_t watch{};

private:
    const lpvg_coeff_t& coeff_;
    lpvg_model_t model_{};
    lpvg_real_t y_[ny] = {};
    bool rests_ = true;
    double slow_[ny] = {}, below_[ny] = {}, sums_[LPVG_WATCH_MEMORIES][ny] = {}, products_[LPVG_WATCH_MEMORIES][ny] = {};
};

}  // namespace

TEST_CASE("a constant gain error violates exactly beyond the limit", "[unit][watch][REQ-ECU-17]") {
    const double sign = GENERATE(-1.0, 1.0);
    const double factor = GENERATE(0.0, 0.5, 0.9, 1.5, 3.0, 6.0);
    const double demand = GENERATE(1e-4, 0.2, 1.0);
    Vehicle vehicle;
    const double size = factor * static_cast<double>(*std::min_element(vehicle.limits.gain, vehicle.limits.gain + ny));
    CAPTURE(sign, size, demand);
    int wrong = 0, violations = 0, evidence = 0;
    for (int k = 0; k < 3000; ++k) {
        wrong += vehicle.step(demand * std::sin(0.02 * k), sign * size) ? 0 : 1;
        violations += vehicle.watch.violated ? 1 : 0;
        evidence += vehicle.watch.evidence ? 1 : 0;
    }
    CHECK(wrong == 0);
    if (factor < 1.0) {
        CHECK(violations == 0);
    }
    if (demand > 0.5) {
        CHECK(evidence > 2000);
        CHECK((violations > 2000) == (factor > 1.0));
    }
    if (demand < 0.1) {
        CHECK(evidence == 0);
    }
}

TEST_CASE("a constant demand shows a gain error beyond the limit, and a constant offset within its own is none",
          "[unit][watch][REQ-ECU-17]") {
    const double share = GENERATE(-0.9, 0.9);
    const double factor = GENERATE(-3.0, -0.9, 0.9, 3.0);
    Vehicle vehicle;
    vehicle.share = share;
    const double gain = factor * static_cast<double>(*std::min_element(vehicle.limits.gain, vehicle.limits.gain + ny));
    CAPTURE(share, factor);
    int wrong = 0, violations = 0;
    for (int k = 0; k < 6000; ++k) {
        wrong += vehicle.step(1.0, gain) ? 0 : 1;
        violations += k >= 3000 && vehicle.watch.violated ? 1 : 0;
    }
    CHECK(wrong == 0);
    CHECK(violations == (std::fabs(factor) > 1.0 ? 3000 : 0));
}

TEST_CASE("while the model settles nothing is summed, and the filter begins at rest behind it", "[unit][watch][REQ-ECU-17]") {
    Vehicle vehicle;
    int wrong = 0;
    for (int k = 0; k < 1000; ++k) {  // a demand that would violate at once
        wrong += vehicle.step(1.0, -2.0, k >= 500) ? 0 : 1;
        if (k < 500) {
            CHECK(*std::max_element(&vehicle.watch.Q[0][0], &vehicle.watch.Q[0][0] + LPVG_WATCH_MEMORIES * ny) < lpvg_real_t(1e-9));
        }
    }
    CHECK(wrong == 0);
}

TEST_CASE("the response goes on through missing measurements, and behind a cleared sum", "[unit][watch][REQ-ECU-17]") {
    Vehicle vehicle;
    int wrong = 0, violations = 0;
    for (int k = 0; k < 1000; ++k) {
        if (k == 700) {
            const lpvg_watch_t before = vehicle.watch;
            lpvg_watch_void(&vehicle.watch);
            CHECK_FALSE(vehicle.watch.violated);
            CHECK_FALSE(vehicle.watch.evidence);
            CHECK(*std::max_element(&vehicle.watch.Q[0][0], &vehicle.watch.Q[0][0] + LPVG_WATCH_MEMORIES * ny) == lpvg_real_t(0));
            CHECK(*std::min_element(&vehicle.watch.P[0][0], &vehicle.watch.P[0][0] + LPVG_WATCH_MEMORIES * ny) == lpvg_real_t(0));
            CHECK(std::equal(std::begin(before.x), std::end(before.x), std::begin(vehicle.watch.x)));
            CHECK(std::equal(&before.lag[0][0], &before.lag[0][0] + 4U * ny, &vehicle.watch.lag[0][0]));
            vehicle.forget();
        }
        wrong += vehicle.step(std::sin(0.02 * k), -1.0, true, k % 300 < 250) ? 0 : 1;
        violations += vehicle.watch.violated ? 1 : 0;
    }
    CHECK(wrong == 0);
    CHECK(violations > 500);
}

TEST_CASE("the largest gain is the certificate's, or the healthy one, or the output is not watched", "[unit][watch][REQ-ECU-17]") {
    lpvg_coeff_t coeff = lpvg_coeff;
    lpvg_watch_limits_t limits{};
    for (auto& bin : coeff.reals.W_certificate) {
        std::fill(std::begin(bin), std::end(bin), lpvg_real_t(0.9));
    }
    coeff.reals.W_certificate[LPVG_NBINS - 1][0] = lpvg_real_t(0.6);
    const auto set_healthy = [&](std::size_t j, double gain) {
        coeff.reals.change_scale[j][0] = coeff.reals.change_threshold * coeff.reals.change_unit[j][0] / static_cast<lpvg_real_t>(gain);
    };
    set_healthy(0U, 0.1);
    set_healthy(1U, 0.3);
    lpvg_watch_limits(&limits, &coeff);
    CHECK(limits.gain[0] == lpvg_real_t(0.6));
    CHECK(static_cast<double>(limits.gain[1]) == Approx(LPVG_NDELTA > 1 ? 0.3 : 0.6).epsilon(1e-5));
    coeff.reals.W_certificate[LPVG_NBINS - 1][0] = lpvg_real_t(0.7);
    set_healthy(0U, 0.7);
    lpvg_watch_limits(&limits, &coeff);
    CHECK(limits.gain[0] == std::numeric_limits<lpvg_real_t>::max());
    coeff.reals.W_certificate[1][0] = lpvg_real_t(0.25);
    coeff.reals.W_certificate[2][LPVG_NDELTA - 1] = lpvg_real_t(0.5);
    lpvg_watch_limits(&limits, &coeff);
    CHECK(limits.gain[0] == lpvg_real_t(0.25));
    CHECK(limits.gain[1] == (LPVG_NDELTA > 1 ? lpvg_real_t(0.5) : lpvg_real_t(0.25)));
}

TEST_CASE("the limits are those of their formulas", "[unit][watch][REQ-ECU-17]") {
    lpvg_coeff_t coeff = lpvg_coeff;
    coeff.words.sample_period_us = 200'000U;
    for (auto& bin : coeff.reals.W_certificate) {
        for (std::size_t d = 0; d < LPVG_NDELTA; ++d) {
            bin[d] = lpvg_real_t(0.8) + lpvg_real_t(0.1) * static_cast<lpvg_real_t>(d);
        }
    }
    coeff.reals.change_threshold = lpvg_real_t(0.3);
    for (std::size_t b = 0; b < LPVG_NBANDS; ++b) {
        coeff.reals.energy_forget[b] = lpvg_real_t(0.01) * static_cast<lpvg_real_t>(1U + b * b);
    }
    for (std::size_t j = 0; j < ny; ++j) {
        coeff.reals.change_unit[j][0] = lpvg_real_t(0.5);
        coeff.reals.change_unit[j][1] = lpvg_real_t(0.25);
        coeff.reals.change_scale[j][0] = lpvg_real_t(0.5);
    }
    lpvg_watch_limits_t limits{};
    lpvg_watch_limits(&limits, &coeff);
    CHECK(static_cast<double>(limits.share) == Approx(0.2 / 1.2).epsilon(1e-5));
    CHECK(static_cast<double>(limits.keep[0]) == Approx(1.0 / 1.2).epsilon(1e-5));
    CHECK(static_cast<double>(limits.keep[1]) == Approx(5.0 / 5.2).epsilon(1e-5));
    for (std::size_t j = 0; j < ny; ++j) {
        CHECK(static_cast<double>(limits.gain[j]) == Approx(0.3).epsilon(1e-5));
        double power[LPVG_NBANDS], inner = 0.0;
        for (std::size_t b = 0; b < LPVG_NBANDS; ++b) {
            const auto scale = static_cast<double>(coeff.reals.energy_scale[b][j]);
            power[b] = static_cast<double>(coeff.reals.energy_forget[b]) / (scale * scale);
            inner += b > 0U && b + 1U < LPVG_NBANDS ? power[b] : 0.0;
        }
        CHECK(static_cast<double>(limits.disturbance[0][j]) == Approx(std::sqrt(power[LPVG_NBANDS - 1] * 4.75)).epsilon(1e-4));
        CHECK(static_cast<double>(limits.disturbance[1][j]) == Approx(std::sqrt(inner * 8.5)).epsilon(1e-4));
        const double sigma = 1.0 / static_cast<double>(coeff.reals.energy_scale[0][j]);
        CHECK(static_cast<double>(limits.disturbance[2][j]) == Approx(std::sqrt(inner * 8.5 + sigma * sigma)).epsilon(1e-4));
    }
    coeff.reals.change_threshold = LPVG_WATCH_GAIN_MAX;
    lpvg_watch_limits(&limits, &coeff);
    CHECK(limits.gain[0] == static_cast<lpvg_real_t>(LPVG_WATCH_GAIN_MAX));
    std::fill(&coeff.reals.W_certificate[0][0], &coeff.reals.W_certificate[0][0] + LPVG_NBINS * LPVG_NDELTA, lpvg_real_t(0.5));
    for (auto& bin : coeff.reals.W_certificate) {
        bin[0] = lpvg_real_t(0.2);
    }
    lpvg_watch_limits(&limits, &coeff);
    CHECK(static_cast<double>(limits.gain[ny - 1U]) == Approx(LPVG_NDELTA > 1 ? 0.5 : 0.2).epsilon(1e-5));
}

TEST_CASE("what is not watched neither violates nor is evidence, and what is not a number violates", "[unit][watch][REQ-ECU-17]") {
    Vehicle blind;
    std::fill(std::begin(blind.limits.gain), std::end(blind.limits.gain), std::numeric_limits<lpvg_real_t>::max());
    Vehicle damaged;
    damaged.watch.P[1][0] = lpvg_real_t(NAN);
    for (int k = 0; k < 300; ++k) {
        (void)blind.step(1.0, -2.0);
        CHECK_FALSE(blind.watch.violated);
        CHECK_FALSE(blind.watch.evidence);
        (void)damaged.step(1.0, 0.0);
        CHECK((damaged.watch.violated || k < 100));
    }
}

TEST_CASE("a violation is beyond both limits, to the last digit", "[unit][watch][REQ-ECU-17]") {
    struct Case {
        double disturbance, product;
        bool violated;
    };
    // With Q = 4 the limit is twice the disturbance, and it counts below 6.
    constexpr Case cases[] = {{1.0, 2.0, false}, {1.0, 2.5, true}, {3.0, 7.0, false}, {4.0, 9.0, false}, {2.5, 6.0, true}};
    for (const Case& each : cases) {
        for (std::size_t m = 0; m < LPVG_WATCH_MEMORIES; ++m) {
            Vehicle vehicle;
            vehicle.share = 0.0;
            (void)vehicle.step(0.0, 0.0);
            std::fill(std::begin(vehicle.limits.gain), std::end(vehicle.limits.gain), lpvg_real_t(0));
            std::fill(&vehicle.limits.disturbance[0][0], &vehicle.limits.disturbance[0][0] + LPVG_WATCH_MEMORIES * ny, lpvg_real_t(100));
            std::fill(std::begin(vehicle.limits.disturbance[m]), std::end(vehicle.limits.disturbance[m]),
                      static_cast<lpvg_real_t>(each.disturbance));
            std::fill(std::begin(vehicle.limits.keep), std::end(vehicle.limits.keep), lpvg_real_t(1));
            vehicle.watch.P[m][ny - 1U] = static_cast<lpvg_real_t>(each.product);
            vehicle.watch.Q[m][ny - 1U] = lpvg_real_t(4);
            (void)vehicle.step(0.0, 0.0);
            CAPTURE(m, each.disturbance, each.product);
            CHECK(vehicle.watch.violated == each.violated);
            CHECK(vehicle.watch.evidence == (each.disturbance < 2.0));
        }
    }
}

TEST_CASE("the response is that of the demand less the offset", "[unit][watch][REQ-ECU-17]") {
    lpvg_coeff_t coeff = lpvg_coeff;
    coeff.reals.input_offset[0] = lpvg_real_t(0.5);
    Vehicle vehicle(coeff);
    int wrong = 0;
    for (int k = 0; k < 1000; ++k) {
        wrong += vehicle.step(0.5 + std::sin(0.02 * k), 0.9 * static_cast<double>(vehicle.limits.gain[0])) ? 0 : 1;
    }
    CHECK(wrong == 0);
}

TEST_CASE("a start takes over the model, and nothing else", "[unit][watch][REQ-ECU-17]") {
    lpvg_model_t model{};
    const lpvg_real_t nothing[LPVG_NU + LPVG_NY] = {};
    lpvg_model_start(&model, &lpvg_coeff, nothing, nothing);
    for (int k = 0; k < 100; ++k) {
        const lpvg_real_t u[LPVG_NU] = {static_cast<lpvg_real_t>(std::sin(0.1 * k))};
        lpvg_model_advance(&model, &lpvg_coeff, lpvg_real_t(15), u);
    }
    lpvg_watch_t watch, expected{};
    std::memset(&watch, 0xFF, sizeof watch);
    lpvg_watch_start(&watch, &model);
    std::memcpy(expected.x, model.x, sizeof expected.x);
    std::memcpy(expected.past, model.past, sizeof expected.past);
    CHECK(std::memcmp(&watch, &expected, sizeof watch) == 0);
    CHECK(watch.past[0][0] != lpvg_real_t(0));
}
