// The isolation's judgement against a second reckoning: sums of random windows under random tables, judged in double at once (THEORY 7.21
// and isolation.h), where the core judges one hypothesis a call in lpvg_real_t. Compiled for every test vehicle with redundant outputs.
#include "../catch.hpp"

#include <algorithm>
#include <cmath>
#include <limits>
#include <numeric>
#include <random>
#include <vector>

#include "isolation_head.hpp"
#include "lpvguard/isolation.h"
#include "monitor/acceptance.hpp"

namespace {

using Real = lpvg_real_t;
constexpr std::size_t nu = LPVG_NU, ny = LPVG_NY, m = LPVG_ISOLATION_COLUMNS, signals = ny + nu, places = signals + 3U;
using Vector = std::vector<double>;
using Matrix = std::vector<Vector>;

// Part of the place of a column, and size of a column, as isolation.h lists them.
std::size_t place_of(std::size_t column) { return column < 5U * signals ? column / 5U : signals + column - 5U * signals; }
std::size_t size_of(std::size_t column) {
    constexpr std::size_t kind[5] = {0U, 1U, 1U, 1U, 2U};
    return column < 5U * signals ? 3U * (column / 5U) + kind[column % 5U] : 3U * signals + column - 5U * signals;
}

// Comparisons that decide, and how close the closest was: rounding may turn what is closer than the core's digits.
struct Decisions {
    double closest = std::numeric_limits<double>::infinity();
    bool above(double a, double b) {
        closest = std::min(closest, std::abs(a - b) / (1.0 + std::abs(a) + std::abs(b)));
        return a > b;
    }
};

// Inverse of a positive matrix, and the logarithm of its determinant, by Gauss and Jordan.
std::pair<Matrix, double> inverted(Matrix a) {
    const std::size_t n = a.size();
    Matrix inverse(n, Vector(n, 0.0));
    double log = 0.0;
    for (std::size_t i = 0; i < n; ++i) {
        inverse[i][i] = 1.0;
    }
    for (std::size_t i = 0; i < n; ++i) {
        const double pivot = a[i][i];
        log += std::log(pivot);
        for (std::size_t k = 0; k < n; ++k) {
            a[i][k] /= pivot;
            inverse[i][k] /= pivot;
        }
        for (std::size_t j = 0; j < n; ++j) {
            const double factor = a[j][i];
            for (std::size_t k = 0; j != i && k < n; ++k) {
                a[j][k] -= factor * a[i][k];
                inverse[j][k] -= factor * inverse[i][k];
            }
        }
    }
    return {inverse, log};
}

struct Expected {
    std::vector<double> fit, misfit;  // by part; then of a healthy vehicle, and of all parts
    bool differs = false, explained = false, paired = false;
    uint32_t parts = 0U;
    std::size_t likeliest = 0U, size = 0U;
    double value = 0.0, low = 0.0, high = 0.0;
    bool now = false;
    double closest = 0.0;
};

class Window {
public:
    explicit Window(uint32_t seed) : random_(seed) {
        lpvg_isolation_words_t& w = table.words;
        lpvg_isolation_reals_t& r = table.reals;
        isolation_test::set_head(w);
        w.window_us = 20000000U;
        w.half = 5U;
        w.parameters = 2U;
        w.parts = 1U + whole(static_cast<uint32_t>(signals) + 1U);
        for (std::size_t i = 0; i < places; ++i) {
            w.part[i] = i < w.parts ? static_cast<uint32_t>(i) : whole(w.parts - 1U);
        }
        r.period_s = Real(0.01);
        for (std::size_t i = 0; i < m; ++i) {
            const bool unused = whole(9U) == 0U;
            r.fault[i] = static_cast<Real>(unused ? 0.0 : 0.3 * std::exp(0.5 * normal()));
            r.spread[i] = static_cast<Real>(0.03 * std::exp(0.5 * normal()));
            r.mean[i] = static_cast<Real>(0.01 * normal());
        }
        r.scale = static_cast<Real>(uniform(1.0, 4.0));
        r.least = static_cast<Real>(uniform(0.0, 8.0));
        r.lack = static_cast<Real>(whole(1U) == 0U ? uniform(0.0, 10.0) : 1e4);  // then two faults are explained, too
        w.crc32 = lpvg_isolation_table_crc32(&table);
        draw();
    }
    lpvg_isolation_table_t table{};
    bool alarmed = false;
    Matrix sums = Matrix(m + 1U, Vector(m + 1U, 0.0));  // of products of error and columns

    // Finding of the core.
    lpvg_isolation_t judged() {
        lpvg_monitor_t monitor;
        lpvg_isolation_t self;
        REQUIRE(lpvg_monitor_init(&monitor, &lpvg_coeff) == lpvg_status_ok);
        REQUIRE(lpvg_isolation_init(&self, &table) == lpvg_status_ok);
        self.running = self.closing = self.judging = true;
        self.alarmed = alarmed;
        self.count = 50U;
        self.from_us = 1000;
        self.until_us = 2000;
        for (std::size_t a = 0, at = 0; a <= m; ++a) {
            for (std::size_t k = a; k <= m; ++k, ++at) {
                self.gram[at] = static_cast<Real>(sums[a][k]);
            }
        }
        self.sum = lpvguard::sum_of_words(self.gram);
        while (lpvg_isolation_work(&self, &monitor)) {
        }
        REQUIRE(self.windows == 1U);
        return self;
    }

    Expected reckoned() const {
        const std::size_t parts = table.words.parts;
        Expected x;
        Decisions decides;
        for (std::size_t p = 0; p < parts; ++p) {
            fit(x, 1U << p);
        }
        fit(x, 0U);
        fit(x, (1U << parts) - 1U);
        const double healthy = x.fit[parts], freed = x.misfit[parts + 1U];
        x.likeliest = static_cast<std::size_t>(std::max_element(x.fit.begin(), x.fit.begin() + static_cast<int>(parts)) - x.fit.begin());
        const double best = x.fit[x.likeliest], against = best - healthy;
        for (std::size_t p = 0; p < parts; ++p) {
            if (p != x.likeliest) {
                decides.above(x.fit[p], best);
            }
        }
        x.differs = decides.above(against, alarmed ? 0.0 : double(table.reals.least));
        x.explained = x.differs && !decides.above(x.misfit[x.likeliest] - freed, 2.0 * double(table.reals.lack) + 19.0 + 0.1 * against);
        if (x.explained) {
            name(x, decides);
            measure(x, decides);
        }
        x.closest = decides.closest;
        return x;
    }

private:
    std::mt19937 random_;

    double normal() { return std::normal_distribution<double>()(random_); }
    double uniform(double low, double high) { return std::uniform_real_distribution<double>(low, high)(random_); }
    uint32_t whole(uint32_t most) { return std::uniform_int_distribution<uint32_t>(0U, most)(random_); }

    static std::size_t first_column(std::size_t part) { return part < signals ? 5U * part : 4U * signals + part; }

    // A window with the sizes of healthy parts and of up to two faulty ones; or of two that a third part nearly mimics.
    void draw() {
        const uint32_t kind = whole(3U), parts = table.words.parts;
        const uint32_t faulty = kind % 3U == 0U ? 0U : (1U << whole(parts - 1U)) | (kind == 1U ? 1U << whole(parts - 1U) : 0U);
        const double strength = std::exp(uniform(-2.0, 1.5));
        const bool mimics = kind == 3U && parts > 2U;
        const double excitation = mimics ? 3.0 : std::exp(normal());
        Vector size(m);
        for (std::size_t i = 0; i < m; ++i) {
            const bool own = (faulty >> table.words.part[place_of(i)] & 1U) != 0U;
            size[i] = double(table.reals.mean[i]) + double(table.reals.spread[i]) * normal() +
                      (own ? strength * double(table.reals.fault[i]) * normal() : 0.0);
        }
        std::vector<std::size_t> chosen(parts);
        std::iota(chosen.begin(), chosen.end(), 0U);
        std::shuffle(chosen.begin(), chosen.end(), random_);
        for (std::size_t k = 0; mimics && k < 2U; ++k) {
            size[first_column(chosen[k])] += uniform(0.3, 1.5);
        }
        alarmed = whole(3U) == 0U;
        for (std::size_t row = 0; row < m + 20U; ++row) {
            Vector x(m + 1U);
            x[0] = normal();
            for (std::size_t i = 0; i < m; ++i) {
                x[i + 1U] = excitation * normal();
            }
            if (mimics) {
                double& third = x[first_column(chosen[2]) + 1U];
                third = 0.5 * third + x[first_column(chosen[0]) + 1U] + x[first_column(chosen[1]) + 1U];
            }
            x[0] += std::inner_product(size.begin(), size.end(), x.begin() + 1, 0.0);
            for (std::size_t a = 0; a <= m; ++a) {
                for (std::size_t k = 0; k <= m; ++k) {
                    sums[a][k] += x[a] * x[k];
                }
            }
        }
        for (Vector& line : sums) {
            for (double& x : line) {
                x = static_cast<double>(static_cast<Real>(x));
            }
        }
    }

    bool is_of(std::size_t column, uint32_t faulty) const { return (faulty >> table.words.part[place_of(column)] & 1U) != 0U; }

    Vector spreads(uint32_t faulty) const {
        Vector spread(m);
        for (std::size_t i = 0; i < m; ++i) {
            spread[i] = std::hypot(double(table.reals.spread[i]), is_of(i, faulty) ? double(table.reals.fault[i]) : 0.0);
        }
        return spread;
    }
    // g - G mean, by spreads.
    Vector change(const Vector& spread) const {
        Vector b(m);
        for (std::size_t i = 0; i < m; ++i) {
            b[i] = sums[0][i + 1U];
            for (std::size_t k = 0; k < m; ++k) {
                b[i] -= sums[i + 1U][k + 1U] * double(table.reals.mean[k]);
            }
            b[i] *= spread[i];
        }
        return b;
    }
    std::pair<Matrix, double> factored(const Vector& spread, double scale) const {
        Matrix inner(m, Vector(m));
        for (std::size_t i = 0; i < m; ++i) {
            for (std::size_t k = 0; k < m; ++k) {
                inner[i][k] = (i == k ? 1.0 : 0.0) + spread[i] * sums[i + 1U][k + 1U] * spread[k] / scale;
            }
        }
        return inverted(inner);
    }
    void fit(Expected& x, uint32_t faulty) const {
        const Vector spread = spreads(faulty), b = change(spread);
        const auto [inverse, log] = factored(spread, 1.0);
        double explained = 0.0;
        for (std::size_t i = 0; i < m; ++i) {
            explained += b[i] * std::inner_product(b.begin(), b.end(), inverse[i].begin(), 0.0);
        }
        x.fit.push_back(0.5 * (explained - log) / double(table.reals.scale));
        x.misfit.push_back(-explained / double(table.reals.scale));
    }

    void name(Expected& x, Decisions& decides) const {
        const std::size_t parts = table.words.parts;
        std::vector<std::size_t> order(parts);
        std::iota(order.begin(), order.end(), 0U);
        std::sort(order.begin(), order.end(), [&x](std::size_t a, std::size_t b) { return x.fit[a] > x.fit[b]; });
        Vector weight(parts), columns(parts, 0.0);
        for (std::size_t p = 0; p < parts; ++p) {
            weight[p] = std::exp(x.fit[p] - x.fit[x.likeliest]);
        }
        for (std::size_t i = 0; i < m; ++i) {
            columns[table.words.part[place_of(i)]] += table.reals.fault[i] > Real(0) ? 2.0 : 0.0;
        }
        const double all = std::accumulate(weight.begin(), weight.end(), 0.0);
        double together = 0.0;
        for (const std::size_t p : order) {
            if (p == x.likeliest || decides.above(0.95 * all, together)) {
                x.parts |= 1U << p;
            }
            together += weight[p];
        }
        const double own = x.misfit[x.likeliest] + columns[x.likeliest];
        for (std::size_t p = 0; p < parts; ++p) {
            if (p != x.likeliest && decides.above(own + 2.0 * std::log(0.95 / 0.05), x.misfit[p] + columns[p])) {
                x.parts |= 1U << p;
            }
        }
        Expected pairs;
        std::vector<uint32_t> of_pair;
        for (std::size_t a = 0; a < parts; ++a) {
            for (std::size_t b = a + 1U; b < parts; ++b) {
                if (a != x.likeliest && b != x.likeliest) {
                    of_pair.push_back((1U << a) | (1U << b));
                    fit(pairs, of_pair.back());
                }
            }
        }
        if (!of_pair.empty()) {
            const auto best = std::max_element(pairs.fit.begin(), pairs.fit.end());
            if (decides.above(*best, x.fit[x.likeliest] + std::log(1000.0) - std::log(0.95 / 0.05))) {
                x.paired = true;
                x.parts |= of_pair[static_cast<std::size_t>(best - pairs.fit.begin())];
                for (auto other = pairs.fit.begin(); other != pairs.fit.end(); ++other) {
                    if (other != best) {
                        decides.above(*best, *other);
                    }
                }
            }
        }
    }

    // The surest size of the likeliest part.
    void measure(Expected& x, Decisions& decides) const {
        const uint32_t faulty = 1U << x.likeliest;
        const double scale = double(table.reals.scale);
        const Vector spread = spreads(faulty), b = change(spread);
        const Matrix inverse = factored(spread, scale).first;
        double surest = -1.0;
        for (std::size_t size = 0; size < 3U * signals + 3U; ++size) {
            double value = 0.0, variance = 0.0, usual = 0.0;
            for (std::size_t i = 0; i < m; ++i) {
                if (!is_of(i, faulty) || size_of(i) != size || !(table.reals.fault[i] > Real(0))) {
                    continue;
                }
                usual = double(table.reals.fault[i]);
                variance += double(table.reals.spread[i]) * double(table.reals.spread[i]);
                for (std::size_t k = 0; k < m; ++k) {
                    value += spread[i] * inverse[i][k] * b[k] / scale;
                    variance += is_of(k, faulty) && size_of(k) == size && table.reals.fault[k] > Real(0)
                                    ? spread[i] * inverse[i][k] * spread[k]
                                    : 0.0;
                }
            }
            const double half = 1.96 * std::sqrt(variance);
            if (usual > 0.0 && (surest < 0.0 || decides.above(std::abs(value) / half, surest))) {
                surest = std::abs(value) / half;
                x.size = size;
                x.value = value;
                x.low = value - half;
                x.high = value + half;
                x.now = std::abs(value) > 0.3 * usual;
            }
        }
        decides.above(std::abs(x.value), 0.0);
    }
};

}  // namespace

TEST_CASE("random windows under random tables are judged as a second reckoning judges them", "[REQ-ISO-1]") {
    constexpr double digits = sizeof(Real) == 4U ? 2e-5 : 1e-10;
    uint32_t named = 0U, unnamed = 0U, healthy = 0U, paired = 0U, close = 0U;
    double largest = 0.0;
    for (uint32_t seed = 1U; seed <= 300U; ++seed) {
        Window window(seed);
        const Expected x = window.reckoned();
        const lpvg_isolation_t self = window.judged();
        const std::size_t parts = window.table.words.parts;
        for (std::size_t p = 0; p < parts + 2U; ++p) {
            const std::size_t at = p < parts ? p : signals + 2U + p - parts;
            CAPTURE(seed, p, parts);
            largest = std::max(largest, std::abs(double(self.fit[at]) - x.fit[p]) / (1.0 + std::abs(x.fit[p])));
            CHECK(std::abs(double(self.fit[at]) - x.fit[p]) <= digits * (1.0 + std::abs(x.fit[p])));
            CHECK(std::abs(double(self.misfit[at]) - x.misfit[p]) <= digits * (1.0 + std::abs(x.misfit[p])));
        }
        if (x.closest < 10.0 * digits) {
            ++close;
            continue;
        }
        const lpvg_parts_t& found = self.newest;
        CAPTURE(seed, parts, x.parts, found.parts, x.size, found.size, x.value, found.value);
        CHECK(found.differs == x.differs);
        CHECK(found.parts == x.parts);
        CHECK(found.likeliest == x.likeliest);
        CHECK(found.alarmed == window.alarmed);
        CHECK((found.from_us == 1000 && found.until_us == 2000));
        if (x.parts != 0U) {
            const double width = x.high - x.low;
            CHECK(found.size == x.size);
            CHECK(std::abs(double(found.value) - x.value) <= 10.0 * digits * width);
            CHECK(std::abs(double(found.low) - x.low) <= 10.0 * digits * width);
            CHECK(std::abs(double(found.high) - x.high) <= 10.0 * digits * width);
            CHECK(found.now == x.now);
        } else {
            CHECK((found.value == Real(0) && found.low == Real(0) && found.high == Real(0)));
        }
        named += x.parts != 0U ? 1U : 0U;
        paired += x.paired ? 1U : 0U;
        unnamed += x.differs && x.parts == 0U ? 1U : 0U;
        healthy += x.differs ? 0U : 1U;
    }
    CAPTURE(named, unnamed, healthy, paired, close, largest);
    CHECK(close <= 30U);
    CHECK(std::min({named, unnamed, healthy, paired}) >= 3U);
}
