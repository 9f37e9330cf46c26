// What the diagnosis concludes from given sums, at the borders of its conditions: values by hand, of regressors that are orthogonal.
// Compiled for every test vehicle.
#include <algorithm>
#include <cmath>
#include <cstddef>
#include <functional>
#include <limits>

#include "monitor/acceptance.hpp"
#include "at_the_end.hpp"
#include "diagnosis_table.hpp"

namespace {

constexpr int delays = LPVG_DIAGNOSIS_DELAYS;
constexpr uint32_t blocks = 128U;
constexpr Real n = Real(128), infinity = std::numeric_limits<Real>::infinity();
constexpr double step_s = 2.0 * block_s;
using Sums = lpvg_diagnosis_output_t;

// yhat is 1/2 in the mean square, and so 1/4 its square: a healthy residue is 0.01 + 0.06 / 4 = 0.025 at most.
constexpr double largest = 0.025;
lpvg_diagnosis_table_t table_of(const std::function<void(lpvg_diagnosis_table_t&)>& change = [](lpvg_diagnosis_table_t&) {}) {
    return table_with([&](lpvg_diagnosis_table_t& t) {
        t.words.stride = 2U;
        for (std::size_t j = 0; j < ny; ++j) {
            t.reals.unit[j][0] = Real(2);
            t.reals.residue[j][0] = Real(0.01);
            t.reals.residue[j][1] = Real(0.06);
        }
        change(t);
    });
}

// A table without rounding: a healthy theta varies by 1/2 in each part but the delay's, and the residue's own noise is lost in the digits.
lpvg_diagnosis_table_t exact_table(const std::function<void(lpvg_diagnosis_table_t&)>& change = [](lpvg_diagnosis_table_t&) {}) {
    return table_of([&](lpvg_diagnosis_table_t& t) {
        for (std::size_t j = 0; j < ny; ++j) {
            for (const std::size_t i : diagonal) {
                t.reals.spread[j][i] = Real(0.25);
            }
            t.reals.spread[j][diagonal[1]] = Real(0.00000095367431640625);  // 2^-20: the delay's own is known to a millisecond
            t.reals.correlated[j] = Real(1);
            t.reals.residue[j][0] = Real(1e-28);
        }
        t.reals.fits = Real(1000);
        t.reals.margin = Real(0);
        change(t);
    });
}

// Of a record whose estimate is theta and which leaves `left` of the residue's sum of squares. yhat moves by so much a stride that no
// delay explains anything.
Sums sums_of(const double (&theta)[4], double left) {
    Sums of{};
    const Real whole = n + Real(1e-5) * n;
    double explained = 0.0;
    for (std::size_t i = 0; i < 4U; ++i) {
        of.gram[diagonal[i]] = n;
        of.along[i] = whole * static_cast<Real>(theta[i]);
        explained += theta[i] * static_cast<double>(of.along[i]);
    }
    of.error_square = static_cast<Real>(explained + left);
    for (int m = 1; m <= delays; ++m) {
        for (const int at : {m - 1, delays + m - 1}) {
            of.moved_square[at] = n * static_cast<Real>(m * m);
            of.moved_cross[at] = n * static_cast<Real>(m * (m - 1));
        }
    }
    return of;
}

// Of a record that comes `late` strides late, of a yhat that moves by a line whose square sums up to `square` a stride.
Sums late_by(double late, double square, double left) {
    Sums of = sums_of({0.0, 0.0, 0.0, 0.0}, 0.0);
    of.error_square = static_cast<Real>(late * late * square + left);
    for (int m = 1; m <= delays; ++m) {
        for (const int sign : {1, -1}) {
            const int at = sign > 0 ? m - 1 : delays + m - 1;
            of.moved_error[at] = static_cast<Real>(-late * sign * m * square);
            of.moved_square[at] = static_cast<Real>(m * m * square);
            of.moved_cross[at] = static_cast<Real>(m * (m - 1) * square);
        }
    }
    return of;
}

// A diagnosis that has these sums of every output and is about to judge them.
lpvg_diagnosis_t about_to_judge(const lpvg_diagnosis_table_t& table, const Sums& of) {
    lpvg_diagnosis_t self{};
    REQUIRE(lpvg_diagnosis_init(&self, &table) == lpvg_status_ok);
    self.alarms = 1U;
    self.blocks = blocks;
    self.judging = self.excited = true;
    self.pending = ny;
    for (std::size_t j = 0; j < ny; ++j) {
        self.output[j] = of;
        self.sum[j] = lpvguard::sum_of_words(of);
    }
    return self;
}

lpvg_found_t judged(const lpvg_diagnosis_table_t& table, const Sums& of) {
    lpvg_diagnosis_t self = about_to_judge(table, of);
    while (lpvg_diagnosis_work(&self)) {
    }
    REQUIRE(self.blocks == LPVG_DIAGNOSIS_DONE);
    return self.found[ny - 1U];
}

lpvg_cause_t cause(const lpvg_diagnosis_table_t& table, const Sums& of) { return judged(table, of).cause; }

}  // namespace

TEST_CASE("a residue above the largest healthy one, which grows with yhat and with the gain, has no single cause",
          "[unit][diagnosis][REQ-DIAG-2]") {
    const lpvg_diagnosis_table_t table = table_of();
    for (const double share : {0.98, 1.02}) {
        CAPTURE(share);
        const double left = share * largest * static_cast<double>(n);
        const bool good = share < 1.0;
        const lpvg_found_t less = judged(table, sums_of({-0.15, 0.0, 0.0, 0.0}, left));
        CHECK(less.cause == (good ? lpvg_cause_gain : lpvg_cause_other));
        CHECK(static_cast<double>(less.value) == Approx(good ? 0.7 : 0.0));
        // A gain of 2 makes healthy noise 2 times as large, its square 4 times.
        const lpvg_found_t more = judged(table, sums_of({0.5, 0.0, 0.0, 0.0}, 4.0 * left));
        CHECK(more.cause == (good ? lpvg_cause_gain : lpvg_cause_other));
        CHECK(static_cast<double>(more.value) == Approx(good ? 2.0 : 0.0));
        const lpvg_found_t bias = judged(table, sums_of({0.0, 0.0, 0.3, 0.0}, left));
        CHECK(bias.cause == (good ? lpvg_cause_bias : lpvg_cause_other));
        CHECK(static_cast<double>(bias.value) == Approx(good ? 0.3 : 0.0));
        const lpvg_found_t late = judged(table, late_by(2.0, 2.56, left));
        CHECK(late.cause == (good ? lpvg_cause_delay : lpvg_cause_other));
        CHECK(static_cast<double>(late.value) == Approx(good ? 2.0 * step_s : 0.0));
    }
}

TEST_CASE("a cause that grows may leave a tenth of the error", "[unit][diagnosis][REQ-DIAG-2]") {
    const lpvg_diagnosis_table_t table = table_of();
    // The error is 0.64 in the mean square and what is left; a tenth of both is left.
    const double border = 0.64 / 9.0 * static_cast<double>(n);
    CHECK(cause(table, sums_of({-0.8, 0.0, 0.0, 0.0}, 0.98 * border)) == lpvg_cause_sign);
    CHECK(cause(table, sums_of({-0.8, 0.0, 0.0, 0.0}, 1.02 * border)) == lpvg_cause_other);
}

TEST_CASE("noise counts from the largest healthy one on, and with a gain from as much more", "[unit][diagnosis][REQ-DIAG-1]") {
    const lpvg_diagnosis_table_t table = exact_table([](lpvg_diagnosis_table_t& t) {
        t.reals.rough[ny - 1U] = Real(0.0009765625);  // 1/1024: 1/8 in 128 blocks
        t.reals.interval = Real(0.25);
    });
    Sums none = sums_of({0.0, 0.0, 0.0, 0.0}, 0.0), twice = sums_of({0.5, 0.0, 0.0, 0.0}, 0.0);
    none.rough = Real(0.125);
    twice.rough = Real(0.5);
    CHECK(cause(table, none) == lpvg_cause_other);  // nothing is wrong
    CHECK(cause(table, twice) == lpvg_cause_gain);
    none.rough = std::nextafter(none.rough, Real(1));
    twice.rough = std::nextafter(twice.rough, Real(1));
    const lpvg_found_t noise = judged(table, none);
    CHECK(noise.cause == lpvg_cause_noise);
    CHECK(static_cast<double>(noise.value) == Approx(1.0 / 32.0));
    CHECK(cause(table, twice) == lpvg_cause_noise);
}

TEST_CASE("noise is alone where theta fits a healthy vehicle's, up to the chi-squared itself", "[unit][diagnosis][REQ-DIAG-2]") {
    // theta_3 = 1/2, one standard deviation: a chi-squared of 1.
    for (const Real fits : {Real(1), std::nextafter(Real(1), Real(0))}) {
        const lpvg_diagnosis_table_t table = exact_table([&](lpvg_diagnosis_table_t& t) { t.reals.fits = fits; });
        Sums of = sums_of({0.0, 0.0, 0.5, 0.0}, 0.0);
        of.rough = n;
        CHECK(cause(table, of) == (fits < Real(1) ? lpvg_cause_other : lpvg_cause_noise));
    }
}

TEST_CASE("an interval that ends at no change does not leave it out", "[unit][diagnosis][REQ-DIAG-2]") {
    for (const Real interval : {Real(1), std::nextafter(Real(1), Real(0))}) {
        const lpvg_diagnosis_table_t table = exact_table([&](lpvg_diagnosis_table_t& t) { t.reals.interval = interval; });
        const Sums of = sums_of({0.0, 0.0, 0.5, 0.0}, 0.0);
        CHECK(cause(table, of) == (interval < Real(1) ? lpvg_cause_bias : lpvg_cause_other));
    }
}

TEST_CASE("an output is frozen where it moves less than its share, not as much", "[unit][diagnosis][REQ-DIAG-1]") {
    const lpvg_diagnosis_table_t table = table_of([](lpvg_diagnosis_table_t& t) { t.reals.still[ny - 1U] = Real(0.015625); });
    Sums of = sums_of({0.0, 0.0, 0.0, 0.0}, 0.0);
    of.changed = Real(64);
    of.still = Real(1);
    CHECK(cause(table, of) == lpvg_cause_other);
    of.still = std::nextafter(of.still, Real(0));
    // The mean of y is that of e and that of yhat, whose sum is kept over its size.
    of.along[2] = n;
    of.gram[2] = n;
    const lpvg_found_t found = judged(table, of);
    CHECK(found.cause == lpvg_cause_frozen);
    CHECK(static_cast<double>(found.value) == Approx(1.5));
}

TEST_CASE("a delay that yhat shows little of has an interval as wide", "[unit][diagnosis][REQ-DIAG-1]") {
    const lpvg_diagnosis_table_t table = table_of();
    // Left is 0.02 in the mean square, by 4 for its correlation 0.08: a stride's square of 0.02 in all is a quarter of that.
    const lpvg_found_t found = judged(table, late_by(5.0, 0.02, 0.02 * static_cast<double>(n)));
    CHECK(found.cause == lpvg_cause_delay);
    CHECK(static_cast<double>(found.value) == Approx(5.0 * step_s).epsilon(1e-3));
    CHECK(static_cast<double>(found.high - found.value) == Approx(1.96 * 2.0 * step_s).epsilon(1e-3));
    CHECK(static_cast<double>(found.value - found.low) == Approx(1.96 * 2.0 * step_s).epsilon(1e-3));
}

TEST_CASE("a delay is known no better than a healthy vehicle's own", "[unit][diagnosis][REQ-DIAG-1]") {
    // theta_2 varies by 1/4 over the size 1/10 of a change over a block: by 2.5 blocks, 0.2 s, where the record alone says 0.08 s.
    const lpvg_diagnosis_table_t table = exact_table([](lpvg_diagnosis_table_t& t) {
        t.reals.spread[ny - 1U][diagonal[1]] = Real(0.0625);
        t.reals.interval = Real(1);
    });
    const lpvg_found_t found = judged(table, late_by(5.0, 0.015625, 0.5));
    CHECK(found.cause == lpvg_cause_delay);
    CHECK(static_cast<double>(found.high - found.value) == Approx(0.25 * 10.0 * block_s).epsilon(1e-3));
    CHECK(cause(table, late_by(1.2, 0.015625, 0.5)) == lpvg_cause_other);  // 0.19 s
    CHECK(cause(table, late_by(1.3, 0.015625, 0.5)) == lpvg_cause_delay);
}

TEST_CASE("a delay or a lead between two strides is found between them, the longest that is tried is none",
          "[unit][diagnosis][REQ-DIAG-1]") {
    const lpvg_diagnosis_table_t table = table_of([](lpvg_diagnosis_table_t& t) { t.words.stride = 4U; });
    const double stride_s = 4.0 * block_s;
    for (const double late : {-5.75, -3.5, -1.25, -1.0, 1.0, 1.25, 3.5, 5.75}) {
        CAPTURE(late);
        const lpvg_found_t found = judged(table, late_by(late, 64.0, 0.02 * static_cast<double>(n)));
        CHECK(found.cause == lpvg_cause_delay);
        CHECK(static_cast<double>(found.value) == Approx(late * stride_s).epsilon(1e-3));
    }
    for (const double late : {-8.0, -6.0, 6.0, 8.0}) {
        CAPTURE(late);
        CHECK(cause(table, late_by(late, 64.0, 0.02 * static_cast<double>(n))) == lpvg_cause_other);
    }
}

TEST_CASE("what a line through two strides promises beyond them is no delay", "[unit][diagnosis][REQ-DIAG-1]") {
    const lpvg_diagnosis_table_t table = table_of();
    // A shift by m strides moves yhat along (m, 0), from one stride on along (1, m - 1). The record lies beyond the corner, where no shift
    // leads: the nearest is that by 1.3 strides.
    struct Moved {
        double first, second;
    };
    const auto moved = [](int m) { return m <= 1 ? Moved{static_cast<double>(m), 0.0} : Moved{1.0, static_cast<double>(m - 1)}; };
    const auto along = [](Moved a, Moved b) { return a.first * b.first + a.second * b.second; };
    struct Record {
        Moved at;
        double square;
    };
    for (const Record& record : {Record{{3.0, 0.3}, 0.5}, Record{{1.8, 0.3}, 2.0}}) {
        CAPTURE(record.at.first);
        Sums of = sums_of({0.0, 0.0, 0.0, 0.0}, record.square * along(record.at, record.at));
        for (int m = 1; m <= delays; ++m) {
            for (const int sign : {1, -1}) {
                const int at = sign > 0 ? m - 1 : delays + m - 1;
                const Moved here = moved(sign * m), nearer = moved(sign * (m - 1));
                of.moved_error[at] = static_cast<Real>(-record.square * along(record.at, here));
                of.moved_square[at] = static_cast<Real>(record.square * along(here, here));
                of.moved_cross[at] = static_cast<Real>(record.square * along(here, nearer));
            }
        }
        const lpvg_found_t found = judged(table, of);
        CHECK(found.cause == lpvg_cause_delay);
        CHECK(static_cast<double>(found.value) == Approx(1.3 * step_s).epsilon(1e-3));
    }
}

TEST_CASE("a delay whose interval ends at none, or holds it, is not named", "[unit][diagnosis][REQ-DIAG-2]") {
    // A stride's square is four times the noise of what is left: the deviation is half a stride.
    for (const Real interval : {Real(2), std::nextafter(Real(2), Real(0))}) {
        const lpvg_diagnosis_table_t table = exact_table([&](lpvg_diagnosis_table_t& t) { t.reals.interval = interval; });
        for (const double late : {-1.0, 1.0}) {
            CHECK(cause(table, late_by(late, 0.015625, 0.5)) == (interval < Real(2) ? lpvg_cause_delay : lpvg_cause_other));
        }
        for (const double late : {-0.875, 0.0, 0.875}) {
            CHECK(cause(table, late_by(late, 0.015625, 0.5)) == lpvg_cause_other);
        }
    }
}

TEST_CASE("of two causes that explain equally well the former is named, and none where a margin is asked for",
          "[unit][diagnosis][REQ-DIAG-2]") {
    // A gain of 2 leaves a bias of 1, one deviation of a healthy vehicle's with that gain; a bias of 1 leaves a gain of 2, one deviation.
    const Sums of = sums_of({0.5, 0.0, 1.0, 0.0}, 0.0);
    const auto table = [](Real margin, Real fits) {
        return exact_table([=](lpvg_diagnosis_table_t& t) {
            t.reals.interval = Real(0.25);
            t.reals.margin = margin;
            t.reals.fits = fits;
        });
    };
    CHECK(cause(table(Real(0), Real(1000)), of) == lpvg_cause_gain);
    CHECK(cause(table(Real(0.001), Real(1000)), of) == lpvg_cause_other);
    // Its misfit is 1, a chi-squared that may be as large as `fits`.
    CHECK(cause(table(Real(0), Real(1)), of) == lpvg_cause_gain);
    CHECK(cause(table(Real(0), std::nextafter(Real(1), Real(0))), of) == lpvg_cause_other);
}

TEST_CASE("a residue may be as large as the largest healthy one", "[unit][diagnosis][REQ-DIAG-2]") {
    const lpvg_diagnosis_table_t table = exact_table([](lpvg_diagnosis_table_t& t) {
        t.reals.interval = Real(0.25);
        t.reals.residue[ny - 1U][1] = Real(0.0625);  // of a square of 1/4: 2 in 128 blocks
    });
    Sums of = sums_of({0.0, 0.0, 0.25, 0.0}, 2.0);
    CHECK(cause(table, of) == lpvg_cause_bias);
    of.error_square = std::nextafter(of.error_square, infinity);
    CHECK(cause(table, of) == lpvg_cause_other);
}

TEST_CASE("a gain is turned where all of its interval is below zero", "[unit][diagnosis][REQ-DIAG-1]") {
    const lpvg_diagnosis_table_t table = table_of([](lpvg_diagnosis_table_t& t) { t.reals.correlated[ny - 1U] = Real(40); });
    const double left = 0.02 * static_cast<double>(n);  // half an interval is 0.31
    CHECK(cause(table, sums_of({-0.45, 0.0, 0.0, 0.0}, left)) == lpvg_cause_gain);
    CHECK(cause(table, sums_of({-0.55, 0.0, 0.0, 0.0}, left)) == lpvg_cause_gain);
    CHECK(cause(table, sums_of({-0.7, 0.0, 0.0, 0.0}, left)) == lpvg_cause_sign);
    // A gain of -1 with a deviation of 1.
    for (const Real interval : {Real(1), std::nextafter(Real(1), Real(0))}) {
        const lpvg_diagnosis_table_t exact = exact_table([&](lpvg_diagnosis_table_t& t) { t.reals.interval = interval; });
        CHECK(cause(exact, sums_of({-1.0, 0.0, 0.0, 0.0}, 0.0)) == (interval < Real(1) ? lpvg_cause_sign : lpvg_cause_gain));
    }
}

TEST_CASE("sums that are not finite are other, also where the output would be frozen", "[unit][diagnosis][REQ-DIAG-5]") {
    const lpvg_diagnosis_table_t table = table_of();
    Sums frozen = sums_of({0.0, 0.0, 0.0, 0.0}, 0.0);
    frozen.changed = Real(64);
    REQUIRE(cause(table, frozen) == lpvg_cause_frozen);
    Sums of = frozen;
    of.error_square = infinity;
    CHECK(cause(table, of) == lpvg_cause_other);
    of = frozen;
    of.along[1] = infinity;
    CHECK(cause(table, of) == lpvg_cause_other);
    of = frozen;
    of.gram[4] = Real(-1e6);
    CHECK(cause(table, of) == lpvg_cause_other);
}

TEST_CASE("an output that has no estimate has no onset", "[unit][diagnosis][REQ-DIAG-3]") {
    const lpvg_diagnosis_table_t table = table_of();
    const auto with_cells = [&](bool good) {
        Sums of = sums_of({-0.5, 0.0, 0.0, 0.0}, 0.0);
        of.error_square = good ? of.error_square : infinity;
        for (auto& cell : of.cell) {
            cell[0] = Real(-1);
            cell[1] = Real(1);
        }
        lpvg_diagnosis_t self = about_to_judge(table, of);
        self.cells = LPVG_DIAGNOSIS_CELLS;
        self.good_cells = 0xFFFFFFFFU;
        return self;
    };
    // In turns, so that nothing of the one before is taken for the next.
    lpvg_diagnosis_t known = with_cells(true), unknown = with_cells(false);
    for (std::size_t j = 0; j < ny; ++j) {
        (void)lpvg_diagnosis_work(&known);
        (void)lpvg_diagnosis_work(&unknown);
    }
    for (std::size_t j = 0; j < ny; ++j) {
        CHECK(known.found[j].before);
        CHECK(known.found[j].onset_blocks == LPVG_DIAGNOSIS_CELLS * table.words.cell_blocks);
        CHECK_FALSE(unknown.found[j].before);
        CHECK(unknown.found[j].onset_blocks == 0U);
    }
}

TEST_CASE("what changes from a cell that is not whole to the next explains nothing", "[unit][diagnosis][REQ-DIAG-3]") {
    const lpvg_diagnosis_table_t table = table_of();
    const uint32_t newest = 5U, all = (1U << LPVG_DIAGNOSIS_CELLS) - 1U;
    const bool whole = GENERATE(true, false);
    const uint32_t back = GENERATE(0U, 1U, 2U);
    CAPTURE(whole, back);
    // yhat has risen by 1 to the cell so far back, by 1/8 a block: e of that cell is what theta makes of it.
    Sums of = sums_of({0.0, 0.5, 0.0, 0.0}, 0.0);
    for (uint32_t i = 0U; i <= back; ++i) {
        of.cell[newest - i][1] = Real(1);
    }
    of.cell[newest - back][0] = Real(-0.5 * 10.0 / 8.0);
    lpvg_diagnosis_t self = about_to_judge(table, of);
    self.cells = LPVG_DIAGNOSIS_CELLS;
    self.cell_newest = newest;
    self.good_cells = whole ? all : all & ~(1U << (newest - back - 1U));
    self.partial = 3U;
    while (lpvg_diagnosis_work(&self)) {
    }
    CHECK(self.found[ny - 1U].onset_blocks == (whole ? 3U + (back + 1U) * table.words.cell_blocks : 0U));
    CHECK_FALSE(self.found[ny - 1U].before);
}

TEST_CASE("a delay is named below 0.999 of the longest that is tried, to the last digit", "[unit][diagnosis][REQ-DIAG-1]") {
    const lpvg_diagnosis_table_t table = exact_table([](lpvg_diagnosis_table_t& t) { t.reals.block_s = Real(0.5); });  // a stride is 1 s
    const Real end = Real(0.999) * Real(delays);
    const bool lead = GENERATE(false, true);
    const std::size_t longest = lead ? 2U * delays - 1U : delays - 1U, shorter = longest - 1U;
    // Of a theta that no gain and no bias explains the two longest shifts leave nothing, and of the error only what follows.
    Sums of = sums_of({0.0, 0.5, 0.0, 0.0}, 0.0);
    for (const std::size_t at : {longest, shorter}) {
        of.moved_to[at][1] = -of.along[1];
        of.moved_error[at] = Real(-0.5) * of.error_square;
    }
    Real most = Real(0);
    bool named = false, other = false;
    for (int i = -500; i <= 500; ++i) {
        const double f = static_cast<double>(end) - (delays - 1) +
                         0.1 * static_cast<double>(std::numeric_limits<Real>::epsilon()) * i;  // of the way from the shorter to the longest
        of.moved_square[shorter] = static_cast<Real>(f * f);
        of.moved_square[longest] = static_cast<Real>((1.0 - f) * (1.0 - f));
        of.moved_cross[longest] = static_cast<Real>(-f * (1.0 - f));
        const lpvg_found_t found = judged(table, of);
        named = named || found.cause == lpvg_cause_delay;
        other = other || found.cause == lpvg_cause_other;
        most = std::max(most, std::abs(found.value));
    }
    CHECK(named);
    CHECK(other);
    CHECK(most < end);
    CHECK(most >= end - Real(8) * (end - std::nextafter(end, Real(0))));
}

TEST_CASE("sums that are not as work left them are not kept", "[unit][diagnosis][REQ-DIAG-5]") {
    const lpvg_diagnosis_table_t table = table_of();
    for (const bool spoilt : {false, true}) {
        lpvg_diagnosis_t self = about_to_judge(table, sums_of({-0.5, 0.0, 0.0, 0.0}, 0.0));
        self.sum[0] ^= spoilt ? 1U : 0U;
        self.t_us = 7;
        self.t_alarm_us = 3;
        CHECK(lpvg_diagnosis_work(&self) == (ny > 1U && !spoilt));
        while (lpvg_diagnosis_work(&self)) {
        }
        CHECK(self.blocks == LPVG_DIAGNOSIS_DONE);
        CHECK(self.t_found_us == 7);
        CHECK_FALSE(self.judging);
        for (const Sums& of : self.output) {
            CHECK((of.gram[0] == Real(0)) == spoilt);
            CHECK((of.error_square == Real(0)) == spoilt);
        }
    }
}

#if defined(__linux__)
TEST_CASE("nothing behind a diagnosis is read or written", "[unit][diagnosis][REQ-DIAG-5]") {
    const lpvg_diagnosis_table_t table = table_of();
    for (const bool spoilt : {false, true}) {
        const AtTheEnd<lpvg_diagnosis_t> last({about_to_judge(table, sums_of({-0.5, 0.0, 0.0, 0.0}, 0.0))});
        last.get()->sum[0] ^= spoilt ? 1U : 0U;
        while (lpvg_diagnosis_work(last.get())) {
        }
        CHECK(last.get()->blocks == LPVG_DIAGNOSIS_DONE);
    }
}
#endif

TEST_CASE("the first output with a cause is named, of however many", "[unit][diagnosis][REQ-DIAG-1]") {
    const lpvg_diagnosis_table_t table = table_of();
    lpvg_diagnosis_t self = about_to_judge(table, sums_of({0.0, 0.0, 0.0, 0.0}, 0.0));
    while (lpvg_diagnosis_work(&self)) {
    }
    CHECK(lpvg_diagnosis_named(&self) == &self.found[0]);  // none has one
    for (std::size_t j = ny; j-- > 0U;) {
        self.found[j].cause = lpvg_cause_bias;
        CHECK(lpvg_diagnosis_named(&self) == &self.found[j]);
    }
}
