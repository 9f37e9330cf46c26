// The isolation as a black box: a vehicle whose parts are told apart by its outputs, of the sizes of whatever vehicle it is built for.
#include "../catch.hpp"

#include <algorithm>
#include <cmath>
#include <cstring>
#include <functional>
#include <limits>
#include <string>
#include <utility>
#include <vector>

#include "isolation_head.hpp"
#include "lpvguard/isolation.h"

namespace {

using Real = lpvg_real_t;
constexpr std::size_t nu = LPVG_NU, ny = LPVG_NY, m = LPVG_ISOLATION_COLUMNS, signals = ny + nu;
constexpr uint32_t half = 5U, window_s = 20U, speed_part = signals, vehicle_part = signals + 1U;
constexpr double two_pi = 6.283185307179586, noise_share = 0.01;

double period_s() { return 1e-6 * lpvg_coeff.words.sample_period_us; }

const lpvg_coeff_reals_t& coeff() { return lpvg_coeff.reals; }

// Half of the measured range: the size of input i.
double size_of(std::size_t i) { return 0.25 * static_cast<double>(coeff().input_valid[i][1]); }

// The parameter: entries of Ad are smaller by half of its change.
void with_parameter(double change, Real* base, Real (*cell)[LPVG_NVARYING][4]) {
    const auto by = [&](std::size_t entry) { return static_cast<Real>(entry < LPVG_NX * LPVG_NX ? 1.0 - 0.5 * change : 1.0); };
    for (std::size_t i = 0; i < LPVG_NENTRIES; ++i) {
        base[i] = coeff().base[i] * by(i);
    }
    for (std::size_t k = 0; k < LPVG_NCELLS; ++k) {
        for (std::size_t i = 0; i < LPVG_NVARYING; ++i) {
            for (std::size_t p = 0; p < 4U; ++p) {
                cell[k][i][p] = coeff().cell[k][i][p] * by(lpvg_coeff.words.varying_entry[i]);
            }
        }
    }
}

// Difference of the vehicle.
struct Fault {
    double gain[signals]{}, bias[signals]{};
    uint32_t late[ny]{};  // samples
    double speed = 0.0, parameter = 0.0;
};

class Vehicle {
public:
    explicit Vehicle(
        const std::function<void(lpvg_isolation_table_t&)>& change = [](lpvg_isolation_table_t&) {}, double threshold = 1e6,
        bool certified = false) {
        coeff_ = lpvg_coeff;
        coeff_.reals.threshold = static_cast<Real>(threshold);
        coeff_.reals.energy_threshold = coeff_.reals.energy_certificate = coeff_.reals.change_threshold = Real(1e6);
        for (std::size_t b = 0; certified && b < LPVG_NBINS; ++b) {  // nothing refutes a certificate of so much
            std::fill(coeff_.reals.W_certificate[b], coeff_.reals.W_certificate[b] + LPVG_NDELTA, Real(100));
        }
        coeff_.words.crc32 = lpvg_coeff_crc32(&coeff_);
        REQUIRE(lpvg_monitor_init(&monitor, &coeff_) == lpvg_status_ok);
        rms_ = rms();
        table = table_of(change);
        REQUIRE(lpvg_isolation_init(&isolation, &table) == lpvg_status_ok);
    }
    Vehicle(const Vehicle&) = delete;
    Vehicle& operator=(const Vehicle&) = delete;

    Fault fault;
    double measured_speed = 0.0;  // above 0: in the place of the true one
    lpvg_monitor_t monitor;
    lpvg_isolation_t isolation;
    lpvg_isolation_table_t table;
    int64_t t_us = 0;
    lpvg_sample_t sample{};
    double rms_of(std::size_t j) const { return rms_[j]; }

    // A sample; the isolation takes it and works until nothing remains.
    void step(bool works = true) {
        next();
        REQUIRE(lpvg_monitor_push(&monitor, &sample) == lpvg_status_ok);
        REQUIRE(lpvg_isolation_take(&isolation, &monitor, &sample) == lpvg_status_ok);
        while (works && lpvg_isolation_work(&isolation, &monitor)) {
        }
    }
    void run(double seconds) {
        for (auto left = static_cast<uint32_t>(std::lround(seconds / period_s())); left > 0U; --left) {
            step();
        }
    }
    // An index of the model's entries has flipped.
    void flip() { coeff_.words.varying_entry[0] = LPVG_NENTRIES; }
    // Until the verdict alarms, which output 0 gives cause for after 4 s; the time of that sample.
    int64_t alarmed() {
        run(4.0);
        fault.gain[0] = 1.0;
        for (uint32_t k = 0; !isolation.alarming; ++k) {
            REQUIRE(k < 20000U);
            step();
        }
        return sample.t_us;
    }
    // Until another window has been judged.
    const lpvg_parts_t& judged() {
        const uint32_t before = isolation.windows;
        for (uint32_t k = 0; isolation.windows == before; ++k) {
            REQUIRE(static_cast<double>(k) * period_s() < 3.0 * window_s);
            step();
        }
        return isolation.newest;
    }
    // Measurement one period later.
    void next() {
        const double t = period_s() * count_;
        const double mean = 0.5 * static_cast<double>(coeff().speed_min + coeff().speed_max),
                     span = static_cast<double>(coeff().speed_max) - mean;
        const double v = mean + 0.7 * span * std::sin(0.9 * t);
        Real u[nu];
        for (std::size_t i = 0; i < nu; ++i) {
            const double phase = static_cast<double>(i) + 1.0;
            const double wave =
                std::sin(two_pi * 0.31 * phase * t) + 0.7 * std::sin(two_pi * 0.83 * t + phase) + 0.4 * std::sin(two_pi * 0.11 * t * phase);
            u[i] = static_cast<Real>(0.5 * size_of(i) * wave);
            sample.u[i] = static_cast<Real>((1.0 + fault.gain[ny + i]) * static_cast<double>(u[i]) + fault.bias[ny + i]);
        }
        lpvg_coeff_t changed = coeff_;
        with_parameter(fault.parameter, changed.reals.base, changed.reals.cell);
        if (count_ == 0U) {
            lpvg_model_start(&truth_, &changed, u, coeff().output_offset);
        }
        std::vector<Real> y(ny);
        lpvg_model_output(&truth_, &changed, y.data());
        past_.push_back(y);
        truth_.speed = std::numeric_limits<Real>::lowest();  // entries anew, with the parameter of now
        lpvg_model_advance(&truth_, &changed, static_cast<Real>(v), u);
        for (std::size_t j = 0; j < ny; ++j) {
            const std::size_t at = past_.size() - 1U - std::min<std::size_t>(fault.late[j], past_.size() - 1U);
            const double noise = noise_share * (rms_.empty() ? 1.0 : rms_[j]) * std::sqrt(12.0 * 2.0 * half) * random();
            sample.y[j] = static_cast<Real>((1.0 + fault.gain[j]) * static_cast<double>(past_[at][j]) + fault.bias[j] + noise);
        }
        sample.speed = static_cast<Real>(measured_speed > 0.0 ? measured_speed : v * (1.0 + fault.speed));
        sample.t_us = t_us;
        t_us += lpvg_coeff.words.sample_period_us;
        ++count_;
    }

private:
    lpvg_coeff_t coeff_;
    lpvg_model_t truth_{};
    std::vector<std::vector<Real>> past_;
    std::vector<double> rms_;
    uint32_t count_ = 0U, seed_ = 7U;

    double random() {
        seed_ = seed_ * 1664525U + 1013904223U;
        return static_cast<double>(seed_) / 4294967296.0 - 0.5;
    }
    std::vector<double> rms() {
        std::vector<double> square(ny, 0.0);
        constexpr uint32_t n = 3000U;
        for (uint32_t k = 0; k < n; ++k) {
            next();
            for (std::size_t j = 0; j < ny; ++j) {
                const double y = static_cast<double>(past_.back()[j] - coeff().output_offset[j]);
                square[j] += y * y / n;
            }
        }
        past_.clear();
        count_ = 0U;
        t_us = 0;
        for (double& x : square) {
            x = std::sqrt(x);
        }
        return square;
    }
    // Every signal is a part, and so are the speed and the vehicle; healthy sizes are a thousandth of faulty ones.
    lpvg_isolation_table_t table_of(const std::function<void(lpvg_isolation_table_t&)>& change) const {
        lpvg_isolation_table_t t{};
        lpvg_isolation_words_t& w = t.words;
        lpvg_isolation_reals_t& r = t.reals;
        isolation_test::set_head(w);
        w.window_us = 1000000U * window_s;
        w.half = half;
        w.parameters = 1U;
        w.parts = signals + 2U;
        for (uint32_t i = 0; i < signals + 3U; ++i) {
            w.part[i] = std::min<uint32_t>(i, vehicle_part);
        }
        r.period_s = static_cast<Real>(period_s());
        for (std::size_t j = 0; j < ny; ++j) {
            r.white[j][j] = static_cast<Real>(1.0 / (noise_share * rms_[j]));
        }
        for (std::size_t i = 0; i < m; ++i) {
            const std::size_t signal = i / 5U, kind = i % 5U;
            const double unit = signal < ny ? rms_[signal] : signal < signals ? size_of(signal - ny) : 1.0;
            const double bias = 0.5 * unit, delay = 0.2;
            const double fault_size = signal >= signals ? 0.2 : kind == 0U ? 0.3 : kind == 4U ? bias : delay;
            r.fault[i] = static_cast<Real>(i + 1U < m ? fault_size : 0.0);
            r.spread[i] = r.fault[i] * Real(1e-3);
        }
        with_parameter(0.02, r.base[0], r.cell[0]);
        r.scale = Real(1);
        r.least = Real(10);
        r.lack = Real(10);
        change(t);
        t.words.crc32 = lpvg_isolation_table_crc32(&t);
        return t;
    }
};

// The part that a window after the fault began names.
void require_named(const Fault& fault, uint32_t part, uint32_t size, double value) {
    Vehicle vehicle;
    CHECK(!vehicle.judged().differs);
    CHECK(vehicle.isolation.newest.parts == 0U);
    vehicle.fault = fault;
    vehicle.judged();
    const lpvg_parts_t& found = vehicle.judged();
    CAPTURE(part, size, value, found.likeliest, found.size, found.value, found.low, found.high);
    CHECK(found.differs);
    CHECK(!found.alarmed);
    CHECK(found.likeliest == part);
    CHECK((ny > 1U ? found.parts : (found.parts & (1U << part))) == 1U << part);
    CHECK(found.size == size);
    CHECK(static_cast<double>(found.value) > 0.8 * value - 1e-3);
    CHECK(static_cast<double>(found.value) < 1.2 * value + 1e-3);
    CHECK((found.low < found.value && found.value < found.high));
    const uint32_t kind = size >= 3U * signals ? size - 3U * signals : size % 3U;
    const Real usual = vehicle.table.reals.fault[size >= 3U * signals ? 5U * signals + kind : 5U * (size / 3U) + (kind == 2U ? 4U : kind)];
    CHECK(found.now == (found.value > Real(0.3) * usual));
    CHECK(found.until_us - found.from_us == 1000000 * static_cast<int64_t>(window_s));
}

}  // namespace

TEST_CASE("a healthy vehicle's windows follow each other and name nothing", "[REQ-ISO-1]") {
    Vehicle vehicle;
    for (uint32_t k = 0; k < 3U; ++k) {
        const lpvg_parts_t& found = vehicle.judged();
        CHECK(!found.differs);
        CHECK(found.parts == 0U);
        CHECK(found.from_us == 1000000 * static_cast<int64_t>(k * window_s));
        CHECK(found.until_us == 1000000 * static_cast<int64_t>((k + 1U) * window_s));
    }
}

TEST_CASE("an output's gain, delay and bias are named", "[REQ-ISO-1]") {
    for (std::size_t j = 0; j < ny; ++j) {
        const Vehicle healthy;
        Fault gain, late, bias;
        gain.gain[j] = 0.2;
        require_named(gain, static_cast<uint32_t>(j), static_cast<uint32_t>(3U * j), 0.2);
        late.late[j] = 2U * half;
        require_named(late, static_cast<uint32_t>(j), static_cast<uint32_t>(3U * j + 1U), 2.0 * half * period_s());
        bias.bias[j] = 0.3 * healthy.rms_of(j);
        require_named(bias, static_cast<uint32_t>(j), static_cast<uint32_t>(3U * j + 2U), bias.bias[j]);
    }
}

TEST_CASE("an input's gain and offset, the speed's factor and a parameter are named where the outputs tell them apart", "[REQ-ISO-1]") {
    for (std::size_t i = 0; i < nu && ny > 1U; ++i) {
        Fault gain, offset;
        gain.gain[ny + i] = 0.1;
        require_named(gain, static_cast<uint32_t>(ny + i), static_cast<uint32_t>(3U * (ny + i)), 0.1);
        offset.bias[ny + i] = 0.2 * size_of(i);
        require_named(offset, static_cast<uint32_t>(ny + i), static_cast<uint32_t>(3U * (ny + i) + 2U), offset.bias[ny + i]);
    }
    if (ny > 1U) {
        Fault speed, parameter;
        speed.speed = 0.04;
        require_named(speed, speed_part, 3U * signals, 0.04);
        parameter.parameter = 0.01;
        require_named(parameter, vehicle_part, 3U * signals + 1U, 0.01);
    }
}

// What block b of an isolation adds to the sums, reckoned from the kept means in double: error and columns without what the blocks before
// predict, with unit covariance.
std::vector<std::vector<double>> whitened(const lpvg_isolation_t& self, uint32_t b) {
    const lpvg_isolation_reals_t& r = self.table->reals;
    const auto half_mean = [&](uint32_t block, int shift, std::size_t row, std::size_t j) {
        const uint32_t first = 2U * block + static_cast<uint32_t>(shift);
        return 0.5 *
               (double(self.half[first % LPVG_ISOLATION_HALVES][row][j]) + double(self.half[(first + 1U) % LPVG_ISOLATION_HALVES][row][j]));
    };
    const auto response = [&](uint32_t block, int shift, std::size_t i, std::size_t j) {
        double rest = half_mean(block, shift, i, j) - (i == 0U ? double(coeff().output_offset[j]) : 0.0);
        for (std::size_t k = 1U; i == 0U && k < nu; ++k) {
            rest -= half_mean(block, shift, k, j);
        }
        return rest;
    };
    const auto raw = [&](uint32_t block) {
        std::vector<std::vector<double>> items(m + 1U, std::vector<double>(ny, 0.0));
        const auto& kept = self.block[block % LPVG_ISOLATION_BLOCKS];
        for (std::size_t j = 0; j < ny; ++j) {
            const double now = half_mean(block, 0, 0U, j);
            items[0][j] = double(kept[0][j]);
            items[1U + 5U * j][j] = now;
            items[5U + 5U * j][j] = 1.0;
            for (std::size_t k = 0; k < 3U; ++k) {
                const int shift = 1 << k;
                const double delay = shift * half * period_s();
                items[2U + 5U * j + k][j] = (half_mean(block, -shift, 0U, j) - now) / delay;
                for (std::size_t i = 0; i < nu; ++i) {
                    items[2U + 5U * (ny + i) + k][j] = (response(block, shift, i, j) - response(block, 0, i, j)) / delay;
                }
            }
            for (std::size_t i = 0; i < nu; ++i) {
                items[1U + 5U * (ny + i)][j] = -response(block, 0, i, j);
                items[5U + 5U * (ny + i)][j] = -double(kept[1U + i][j]);
            }
            for (std::size_t k = 0; k < 3U; ++k) {
                items[1U + 5U * signals + k][j] = double(kept[1U + nu + k][j]) + (k == 0U ? double(r.power[j]) * now : 0.0);
            }
        }
        return items;
    };
    auto left = raw(b);
    for (uint32_t k = 0; k < 3U; ++k) {
        const auto before = raw(b - k - 1U);
        for (std::size_t a = 0; a <= m; ++a) {
            for (std::size_t i = 0; i < ny; ++i) {
                for (std::size_t j = 0; j < ny; ++j) {
                    left[a][i] -= double(r.lags[k][i][j]) * before[a][j];
                }
            }
        }
    }
    std::vector<std::vector<double>> white(m + 1U, std::vector<double>(ny, 0.0));
    for (std::size_t a = 0; a <= m; ++a) {
        for (std::size_t i = 0; i < ny; ++i) {
            for (std::size_t j = 0; j < ny; ++j) {
                white[a][i] += double(r.white[i][j]) * left[a][j];
            }
        }
    }
    return white;
}

TEST_CASE("a block adds the whitened products of its error and columns", "[REQ-ISO-1]") {
    Vehicle vehicle([](lpvg_isolation_table_t& t) {
        t.words.parameters = 2U;
        for (std::size_t i = 0; i < ny; ++i) {
            t.reals.power[i] = static_cast<Real>(i) - Real(1);
            for (std::size_t j = 0; j < ny; ++j) {
                const Real sign = (i + j) % 2U == 0U ? Real(1) : Real(-1);
                t.reals.white[i][j] += sign * Real(0.2) * t.reals.white[i == j ? i : j][j];
                for (std::size_t k = 0; k < 3U; ++k) {
                    t.reals.lags[k][i][j] = sign * Real(0.3) / static_cast<Real>(1U + i + 2U * j + k);
                }
            }
        }
        std::copy(std::begin(t.reals.base[0]), std::end(t.reals.base[0]), std::begin(t.reals.base[1]));
        t.reals.base[1][0] *= Real(1.02);
    });
    vehicle.fault.gain[0] = 0.3;
    vehicle.run(4.0);
    constexpr double digits = sizeof(Real) == 4U ? 1e-4 : 1e-10;
    uint32_t compared = 0U;
    for (uint32_t k = 0; k < 600U && compared < 5U; ++k) {
        const bool waits = vehicle.isolation.pending;
        const lpvg_isolation_t before = vehicle.isolation;
        if (waits) {
            REQUIRE(!lpvg_isolation_work(&vehicle.isolation, &vehicle.monitor));
        }
        if (waits && vehicle.isolation.count == before.count + 1U) {
            ++compared;
            const auto white = whitened(before, before.halves / 2U - 3U);
            for (std::size_t a = 0, at = 0; a <= m; ++a) {
                for (std::size_t c = a; c <= m; ++c, ++at) {
                    double expected = 0.0, size = 0.0;
                    for (std::size_t j = 0; j < ny; ++j) {
                        expected += white[a][j] * white[c][j];
                        size += std::abs(white[a][j] * white[c][j]);
                    }
                    const double all = std::abs(double(before.gram[at])) + size + 1e-3;
                    CAPTURE(a, c, before.gram[at], vehicle.isolation.gram[at], expected);
                    CHECK(std::abs(double(vehicle.isolation.gram[at]) - double(before.gram[at]) - expected) <= digits * all);
                }
            }
        }
        vehicle.step(false);
    }
    CHECK(compared == 5U);
}

TEST_CASE("parts that no driving tells apart are named together, two faults at once too", "[REQ-ISO-1]") {
    // One part has two signals: its name is the same, whichever differs.
    for (std::size_t j = 0; j < std::min<std::size_t>(ny, 2U); ++j) {
        Vehicle vehicle([](lpvg_isolation_table_t& t) {
            t.words.parts = signals + 2U - (ny > 1U ? 1U : 0U);
            for (uint32_t i = 0; i < signals + 3U; ++i) {
                t.words.part[i] = std::min(ny > 1U && i > 0U ? i - 1U : i, t.words.parts - 1U);
            }
        });
        vehicle.fault.bias[j] = 0.3 * vehicle.rms_of(j);
        vehicle.judged();
        CHECK((vehicle.judged().parts & 1U) == 1U);
        CHECK(vehicle.isolation.newest.size == 3U * j + 2U);
    }
}

TEST_CASE("two other parts are named beside one that explains less than both", "[REQ-ISO-1]") {
    // Biases of two outputs as an offset of the input has them at the mean speed, and at no other.
    Vehicle vehicle([](lpvg_isolation_table_t& t) {
        t.reals.lack = Real(1e9);
        t.reals.fault[5] = t.reals.fault[9] = t.reals.fault[4];
    });
    const Real speed = Real(0.5) * (coeff().speed_min + coeff().speed_max);
    Real y[2][ny];
    for (std::size_t k = 0; k < 2U; ++k) {
        Real u[nu];
        std::copy(coeff().input_offset, coeff().input_offset + nu, u);
        u[nu - 1U] += static_cast<Real>(k == 0U ? 0.0 : 0.3 * size_of(nu - 1U));
        lpvg_model_t model;
        lpvg_model_start(&model, &lpvg_coeff, u, coeff().output_offset);
        for (uint32_t n = 0; n < 3000U; ++n) {
            lpvg_model_output(&model, &lpvg_coeff, y[k]);
            lpvg_model_advance(&model, &lpvg_coeff, speed, u);
        }
    }
    for (std::size_t j = 0; j < ny; ++j) {
        vehicle.fault.bias[j] = static_cast<double>(y[0][j] - y[1][j]);
    }
    vehicle.judged();
    const lpvg_parts_t& found = vehicle.judged();
    CHECK(found.differs);
    if (ny == 2U) {
        CHECK(found.likeliest >= ny);
        CHECK((found.parts & 3U) == 3U);
    }
}

TEST_CASE("no single part explains two large faults", "[REQ-ISO-1]") {
    Vehicle vehicle([](lpvg_isolation_table_t& t) { t.reals.lack = Real(0); });
    vehicle.fault.bias[0] = 0.5 * vehicle.rms_of(0);
    vehicle.fault.gain[ny - 1U] = 0.5;
    vehicle.judged();
    const lpvg_parts_t& found = vehicle.judged();
    CHECK(found.differs);
    if (ny > 1U) {
        CHECK(found.parts == 0U);
        CHECK(found.value == Real(0));
    }
}

TEST_CASE("an alarm ends a window and begins another one, in which less evidence will do", "[REQ-ISO-2]") {
    const bool certified = GENERATE(false, true);
    Vehicle vehicle([](lpvg_isolation_table_t& t) { t.reals.least = Real(1e30); }, 1.5, certified);
    const int64_t alarm_us = vehicle.alarmed();
    CHECK((!certified || lpvg_monitor_verdict(&vehicle.monitor, alarm_us) == lpvg_verdict_degraded));
    const uint32_t windows = vehicle.isolation.windows;
    const bool is_long = 2 * (alarm_us - vehicle.isolation.from_us) > 1000000 * static_cast<int64_t>(window_s);
    const lpvg_parts_t* found = &vehicle.judged();
    if (is_long) {
        CHECK(found->until_us == alarm_us);
        CHECK((!found->differs && !found->alarmed));
        found = &vehicle.judged();
    }
    CHECK(vehicle.isolation.windows == windows + (is_long ? 2U : 1U));
    CHECK(found->from_us == alarm_us);
    CHECK(found->until_us == alarm_us + 1000000 * static_cast<int64_t>(window_s));
    CHECK((found->alarmed && found->differs));
    CHECK(found->likeliest == 0U);
}

TEST_CASE("an alarm just after a window's end begins the next one", "[REQ-ISO-2]") {
    const int64_t alarm_us = Vehicle([](lpvg_isolation_table_t&) {}, 1.5).alarmed();
    Vehicle vehicle([alarm_us](lpvg_isolation_table_t& t) { t.words.window_us = static_cast<uint32_t>(alarm_us - 60000); }, 1.5);
    CHECK(vehicle.alarmed() == alarm_us);
    CHECK(vehicle.isolation.closing);
    CHECK(vehicle.judged().until_us == alarm_us - 60000);
    CHECK(!vehicle.isolation.newest.alarmed);
    CHECK(vehicle.isolation.from_us == alarm_us);
    CHECK(vehicle.isolation.alarmed);
    // While the window before is judged, too.
    Vehicle slow([alarm_us](lpvg_isolation_table_t& t) { t.words.window_us = static_cast<uint32_t>(alarm_us - 400000); }, 1.5);
    slow.run(4.0);
    slow.fault.gain[0] = 1.0;
    while (!slow.isolation.judging) {
        slow.step(false);
        (void)lpvg_isolation_work(&slow.isolation, &slow.monitor);
    }
    while (!slow.isolation.alarming) {
        slow.step(false);
    }
    CHECK(slow.isolation.judging);
    CHECK(slow.judged().until_us == alarm_us - 400000);
    CHECK(slow.isolation.from_us == alarm_us);
    CHECK(slow.isolation.alarmed);
}

TEST_CASE("few parts have no two others, and a window without blocks does not differ", "[REQ-ISO-1]") {
    Vehicle vehicle([](lpvg_isolation_table_t& t) {
        t.words.parts = 2U;
        for (uint32_t& part : t.words.part) {
            part = std::min(part, 1U);
        }
    });
    vehicle.fault.bias[0] = 0.3 * vehicle.rms_of(0);
    CHECK(vehicle.judged().likeliest == 0U);
    vehicle.measured_speed = 0.95 * static_cast<double>(coeff().speed_min);
    vehicle.judged();
    CHECK(!vehicle.judged().differs);
    CHECK(vehicle.isolation.newest.parts == 0U);
}

TEST_CASE("parts are named until they are sure together", "[REQ-ISO-1]") {
    Vehicle vehicle([](lpvg_isolation_table_t& t) {
        t.reals.least = Real(0);
        t.reals.scale = Real(50);
    });
    vehicle.fault.bias[0] = 0.02 * vehicle.rms_of(0);
    vehicle.judged();
    const uint32_t parts = vehicle.judged().parts;
    CHECK((parts & 1U) == 1U);
    CHECK(parts != 1U);
}

TEST_CASE("a further part is named unless it fits worse than its columns let expect", "[REQ-ISO-1]") {
    // A signal has five columns, the vehicle one beside an unused one. 2 log(0.95 / 0.05) is 5.889.
    const bool is_signal = GENERATE(true, false), is_named = GENERATE(true, false);
    const uint32_t part = is_signal ? 1U : vehicle_part;
    Vehicle vehicle;
    while (!vehicle.isolation.judging || vehicle.isolation.step < ny + nu + 4U) {
        vehicle.step(false);
        (void)lpvg_isolation_work(&vehicle.isolation, &vehicle.monitor);
    }
    std::fill(std::begin(vehicle.isolation.fit), std::end(vehicle.isolation.fit), Real(0));
    std::fill(std::begin(vehicle.isolation.misfit), std::end(vehicle.isolation.misfit), Real(1e3));
    vehicle.isolation.fit[0] = Real(100);
    vehicle.isolation.misfit[0] = Real(0);
    vehicle.isolation.misfit[part] = Real((is_signal ? 5.889 : 13.889) + (is_named ? -0.01 : 0.01));
    vehicle.isolation.misfit[ny + nu + 3U] = Real(0);
    CHECK(vehicle.judged().parts == (is_named ? 1U | (1U << part) : 1U));
}

namespace {

std::string line_of(const lpvg_parts_t& parts, std::size_t room = 400U) {
    lpvg_part_words_t part[signals + 2U];
    std::fill(std::begin(part), std::end(part), lpvg_part_words_t{"speed", "the wheel size"});
    part[0] = {"gyro", "the gyro's mounting"};
    lpvg_size_words_t size[3U * signals + 3U];
    std::fill(std::begin(size), std::end(size), lpvg_size_words_t{"gain", ""});
    size[2] = {"bias", " rad/s"};
    std::string text(room, 'x');
    const std::size_t length = lpvg_isolation_line(&parts, part, size, &text[0], room);
    CHECK(text[length] == '\0');
    return text.substr(0U, length);
}

lpvg_parts_t found(uint32_t parts, double value, double low = -0.111, double high = -0.08) {
    lpvg_parts_t p{};
    p.differs = true;
    p.parts = parts;
    p.value = static_cast<Real>(value);
    p.low = static_cast<Real>(low);
    p.high = static_cast<Real>(high);
    p.from_us = 59500000;
    return p;
}

}  // namespace

TEST_CASE("a window is one line that says what to do", "[REQ-ISO-5]") {
    const std::string rest = " (-0.111 to -0.08), since about 60 s; check the gyro's mounting; service ";
    lpvg_parts_t one = found(1U, -0.0954);
    CHECK(line_of(one) == "gyro: gain -0.0954" + rest + "later");
    one.now = true;
    one.size = 2U;
    CHECK(line_of(one) == "gyro: bias -0.0954 rad/s" + rest + "now");
    one.from_us = 59400000;
    CHECK(line_of(one).find("since about 59 s;") != std::string::npos);
    one.from_us = 0;
    CHECK(line_of(one).find("since about 0 s;") != std::string::npos);
    one.from_us = 1030000000;
    CHECK(line_of(one).find("since about 1030 s;") != std::string::npos);
    one.from_us = -12000000;
    CHECK(line_of(one).find("since about -12 s;") != std::string::npos);
    one.from_us = std::numeric_limits<int64_t>::max();
    CHECK(line_of(one).find("since about 2000000000 s;") != std::string::npos);
    one.from_us = std::numeric_limits<int64_t>::min();
    CHECK(line_of(one).find("since about -2000000000 s;") != std::string::npos);
    const struct {
        double x;
        const char* text;
    } numbers[] = {{0.0, "+0"},           {1.0, "+1"},      {-1.25, "-1.25"},       {9.996, "+10"},
                   {99.96, "+100"},       {123.4, "+123"},  {999.0, "+999"},        {120.0, "+120"},
                   {10.5, "+10.5"},       {50.0, "+50"},    {999.6, "+1e+03"},      {-1.25e12, "-1.25e+12"},
                   {0.5, "+0.5"},         {0.07, "+0.07"},  {0.0125, "+0.0125"},    {1e-4, "+0.0001"},
                   {0.00034, "+0.00034"}, {3e-5, "+3e-05"}, {-2.5e-11, "-2.5e-11"}, {0.1004, "+0.1"}};
    for (const auto& number : numbers) {
        CHECK(line_of(found(1U, number.x)).substr(0U, std::strlen(number.text) + 13U) == std::string("gyro: gain ") + number.text + " (");
    }
    CHECK(line_of(found(1U, std::numeric_limits<double>::infinity())).substr(0U, 15U) == "gyro: gain +0 (");
    CHECK(line_of(found(1U, std::numeric_limits<double>::quiet_NaN())).find("0 (") != std::string::npos);
}

TEST_CASE("several parts, no single one and none have a line", "[REQ-ISO-5]") {
    CHECK(line_of(lpvg_parts_t{}) == "no part differs");
    CHECK(line_of(found(0U, 0.0)) == "no single part explains it, since about 60 s");
    lpvg_parts_t two = found(3U, 0.1);
    CHECK(line_of(two) == "one of gyro, speed, since about 60 s; check the gyro's mounting; check the wheel size");
    two.likeliest = 1U;
    const std::string text = "one of speed, gyro, since about 60 s; check the wheel size; check the gyro's mounting";
    CHECK(line_of(two) == text);
    for (const std::size_t room : {1U, 2U, 20U}) {
        CHECK(line_of(two, room) == text.substr(0U, room - 1U));
    }
    CHECK(line_of(two, text.size() + 1U) == text);
    CHECK(line_of(found(1U << vehicle_part | 1U, 0.1)).substr(0U, 20U) == "one of gyro, speed, ");
    const lpvg_part_words_t part{};
    const lpvg_size_words_t size{};
    char letter = 'x';
    CHECK(lpvg_isolation_line(nullptr, &part, &size, &letter, 1U) == 0U);
    CHECK(lpvg_isolation_line(&two, nullptr, &size, &letter, 1U) == 0U);
    CHECK(lpvg_isolation_line(&two, &part, nullptr, &letter, 1U) == 0U);
    CHECK(lpvg_isolation_line(&two, &part, &size, nullptr, 1U) == 0U);
    CHECK(lpvg_isolation_line(&two, &part, &size, &letter, 0U) == 0U);
    CHECK(letter == 'x');
}

TEST_CASE("each named part is a trouble code", "[REQ-ISO-5]") {
    const auto codes = [](const lpvg_parts_t& parts, uint8_t before = 1U) {
        lpvg_j1939_findings_t findings{};
        findings.n_codes = before;
        lpvg_isolation_findings(&parts, &findings);
        std::vector<std::pair<uint32_t, uint32_t>> told;
        for (uint32_t k = before; k < findings.n_codes; ++k) {
            told.emplace_back(findings.code[k].spn, findings.code[k].fmi);
        }
        return told;
    };
    using Codes = std::vector<std::pair<uint32_t, uint32_t>>;
    lpvg_parts_t one = found(2U, 0.1);
    const uint32_t spn = LPVG_ISOLATION_SPN + 2U;
    CHECK(codes(one) == Codes{{spn, LPVG_CAN_FMI_CALIBRATION}});
    one.size = 4U;
    CHECK(codes(one) == Codes{{spn, LPVG_CAN_FMI_UPDATE_RATE}});
    one.size = 5U;
    CHECK(codes(one) == Codes{{spn, LPVG_CAN_FMI_DRIFTED_HIGH}});
    one.value = Real(0);
    CHECK(codes(one) == Codes{{spn, LPVG_CAN_FMI_DRIFTED_LOW}});
    for (uint32_t k = 0; k < 3U; ++k) {
        one.size = 3U * signals + k;
        CHECK(codes(one) == Codes{{spn, LPVG_CAN_FMI_CALIBRATION}});
    }
    const uint32_t last = LPVG_ISOLATION_SPN + 1U + vehicle_part;
    const lpvg_parts_t two = found(1U << vehicle_part | 1U, 0.1);
    CHECK(codes(two) == Codes{{LPVG_ISOLATION_SPN + 1U, LPVG_CAN_FMI_CONDITION}, {last, LPVG_CAN_FMI_CONDITION}});
    CHECK(codes(two, LPVG_J1939_CODES_MAX - 1U).size() == 1U);
    CHECK(codes(two, LPVG_J1939_CODES_MAX).empty());
    CHECK(codes(found(0U, 0.0)) == Codes{{LPVG_ISOLATION_SPN, LPVG_CAN_FMI_ROOT_UNKNOWN}});
    CHECK(codes(lpvg_parts_t{}).empty());
    lpvg_j1939_findings_t none{};
    lpvg_isolation_findings(nullptr, &none);
    lpvg_isolation_findings(&two, nullptr);
    CHECK(none.n_codes == 0U);
}

TEST_CASE("work that waits over a window's end judges what was added before", "[REQ-ISO-3]") {
    Vehicle vehicle;
    while (!vehicle.isolation.closing) {
        vehicle.step();
    }
    const uint32_t count = vehicle.isolation.count;
    for (uint32_t k = 0; k < 8U * half + 1U; ++k) {
        vehicle.step(false);
    }
    CHECK(vehicle.isolation.count == count);
    CHECK(vehicle.isolation.windows == 0U);
    CHECK(!vehicle.judged().differs);
    // A block ends while a window is judged, and is added after it.
    while (!vehicle.isolation.closing) {
        vehicle.step();
    }
    while (!vehicle.isolation.judging) {
        vehicle.step(false);
        REQUIRE(lpvg_isolation_take(&vehicle.isolation, &vehicle.monitor, &vehicle.sample) == lpvg_status_ok);
        const bool more = lpvg_isolation_work(&vehicle.isolation, &vehicle.monitor);
        CHECK(more == vehicle.isolation.judging);
    }
    while (!vehicle.isolation.pending) {
        vehicle.step(false);
    }
    const uint32_t windows = vehicle.isolation.windows;
    while (vehicle.isolation.windows == windows) {
        CHECK(lpvg_isolation_work(&vehicle.isolation, &vehicle.monitor));
    }
    CHECK(!lpvg_isolation_work(&vehicle.isolation, &vehicle.monitor));
}

TEST_CASE("a window shorter than half of the usual one is not judged", "[REQ-ISO-2]") {
    Vehicle vehicle([](lpvg_isolation_table_t& t) { t.words.window_us = 600000000U; }, 1.5);
    const int64_t alarm_us = vehicle.alarmed();
    vehicle.run(2.0);
    CHECK(vehicle.isolation.windows == 0U);
    CHECK(vehicle.isolation.from_us == alarm_us);
    CHECK(vehicle.isolation.alarmed);
}

TEST_CASE("a gap begins blocks and models anew, and the window goes on", "[REQ-ISO-3]") {
    Vehicle vehicle;
    vehicle.run(8.0);
    const uint32_t count = vehicle.isolation.count;
    vehicle.next();
    vehicle.t_us += 1000000;
    vehicle.run(0.2);
    CHECK(vehicle.isolation.count == count);
    CHECK(vehicle.isolation.halves <= 4U);
    vehicle.fault.bias[0] = 0.3 * vehicle.rms_of(0);
    const lpvg_parts_t& found = vehicle.judged();
    CHECK(found.from_us == 0);
    CHECK(found.until_us >= 1000000 * static_cast<int64_t>(window_s));
    CHECK(found.until_us < 1000000 * static_cast<int64_t>(window_s) + lpvg_coeff.words.sample_period_us);
    CHECK(found.likeliest == 0U);
}

TEST_CASE("a gap just after a window's end judges what the window has", "[REQ-ISO-3]") {
    Vehicle vehicle;
    while (!vehicle.isolation.closing) {
        vehicle.step();
    }
    vehicle.next();
    vehicle.t_us += 1000000;
    vehicle.step();
    CHECK(vehicle.isolation.windows == 1U);
    CHECK(!vehicle.isolation.newest.differs);
    CHECK(vehicle.isolation.newest.until_us == 1000000 * static_cast<int64_t>(window_s));
    // Another one while a window is judged does not judge it twice.
    while (!vehicle.isolation.judging) {
        vehicle.step(false);
        (void)lpvg_isolation_work(&vehicle.isolation, &vehicle.monitor);
    }
    const uint32_t step = vehicle.isolation.step;
    vehicle.t_us += 1000000;
    vehicle.step(false);
    CHECK(vehicle.isolation.step == step);
    CHECK(vehicle.judged().until_us == 2000000 * static_cast<int64_t>(window_s));
}

TEST_CASE("blocks out of the speed's range, refused samples and repeated ones do not count", "[REQ-ISO-3]") {
    Vehicle vehicle;
    vehicle.run(4.0);
    const uint32_t count = vehicle.isolation.count, in_half = vehicle.isolation.in_half;
    REQUIRE(lpvg_isolation_take(&vehicle.isolation, &vehicle.monitor, &vehicle.sample) == lpvg_status_ok);
    CHECK(vehicle.isolation.in_half == in_half);
    vehicle.next();
    vehicle.sample.y[0] = std::numeric_limits<Real>::quiet_NaN();
    CHECK(lpvg_monitor_push(&vehicle.monitor, &vehicle.sample) == lpvg_status_bad_sample);
    REQUIRE(lpvg_isolation_take(&vehicle.isolation, &vehicle.monitor, &vehicle.sample) == lpvg_status_ok);
    CHECK(vehicle.isolation.in_half == in_half);
    vehicle.measured_speed = 1.05 * static_cast<double>(coeff().speed_max);
    vehicle.run(0.5);
    CHECK(vehicle.isolation.count <= count + 4U);
    CHECK(!vehicle.isolation.good);
    const uint32_t before = vehicle.isolation.in_half;
    vehicle.sample.t_us -= 1;
    CHECK(lpvg_monitor_push(&vehicle.monitor, &vehicle.sample) == lpvg_status_out_of_order);
    REQUIRE(lpvg_isolation_take(&vehicle.isolation, &vehicle.monitor, &vehicle.sample) == lpvg_status_ok);
    CHECK(vehicle.isolation.in_half == before);
    // A monitor that repaired itself began anew, as often as before or not.
    vehicle.monitor.newest = 1000U;
    vehicle.next();
    CHECK(lpvg_monitor_push(&vehicle.monitor, &vehicle.sample) == lpvg_status_bad_sample);
    vehicle.isolation.restarts = 1U;
    vehicle.step();
    CHECK(vehicle.monitor.restarts == 1U);
    CHECK(vehicle.isolation.halves == 0U);
    CHECK(vehicle.isolation.in_half == 1U);
}

TEST_CASE("a block that is not worked on in time is lost, and those after it begin a stretch", "[REQ-ISO-3]") {
    Vehicle vehicle;
    vehicle.run(6.0);
    const uint32_t count = vehicle.isolation.count;
    CHECK(vehicle.isolation.stretch == 4U);
    for (uint32_t k = 0; k < 6U * half; ++k) {
        vehicle.step(false);
    }
    CHECK(vehicle.isolation.stretch == 0U);
    vehicle.run(6.0 * half * period_s());
    CHECK(vehicle.isolation.count <= count + 1U);
}

TEST_CASE("a flipped sum empties the window", "[REQ-ISO-4]") {
    Vehicle vehicle;
    vehicle.run(8.0);
    CHECK(vehicle.isolation.count > 20U);
    vehicle.isolation.gram[5] = Real(1e20);
    const lpvg_parts_t& found = vehicle.judged();
    CHECK(!found.differs);
}

TEST_CASE("a flipped index of the model's entries leads nowhere else", "[REQ-ISO-4]") {
    Vehicle vehicle;
    vehicle.flip();
    vehicle.run(2.0);
    CHECK(vehicle.isolation.halves > 2U);
    CHECK(vehicle.isolation.table == &vehicle.table);
}

TEST_CASE("sums that are not finite name nothing and end", "[REQ-ISO-4]") {
    Vehicle vehicle([](lpvg_isolation_table_t& t) {
        for (std::size_t j = 0; j < ny; ++j) {
            t.reals.white[j][j] = std::numeric_limits<Real>::max();
        }
    });
    CHECK(!vehicle.judged().differs);
    CHECK(vehicle.isolation.newest.parts == 0U);
}

TEST_CASE("a table that is foreign, damaged, not finite or not allowed is refused", "[REQ-ISO-4]") {
    const Vehicle made;
    const auto status = [&](const std::function<void(lpvg_isolation_table_t&)>& change, bool seal = true) {
        lpvg_isolation_table_t t = made.table;
        change(t);
        t.words.crc32 = seal ? lpvg_isolation_table_crc32(&t) : t.words.crc32;
        lpvg_isolation_t object{};
        const lpvg_status_t said = lpvg_isolation_init(&object, &t);
        CHECK((said == lpvg_status_ok) == (object.table != nullptr));
        CHECK(said == lpvg_isolation_table_check(&t));
        return said;
    };
    using Table = lpvg_isolation_table_t;
    CHECK(status([](Table&) {}) == lpvg_status_ok);
    CHECK(status([](Table& t) { t.words.magic = 0U; }) == lpvg_status_bad_magic);
    CHECK(status([](Table& t) { t.words.schema = 0U; }) == lpvg_status_bad_schema);
    CHECK(status([](Table& t) { t.words.real_bytes = 2U; }) == lpvg_status_bad_size);
    for (std::size_t i = 0; i < 6U; ++i) {
        CHECK(status([i](Table& t) { ++t.words.sizes[i]; }) == lpvg_status_bad_size);
    }
    CHECK(status([](Table& t) { t.reals.scale = Real(2); }, false) == lpvg_status_bad_crc);
    CHECK(status([](Table& t) { t.reals.mean[0] = std::numeric_limits<Real>::infinity(); }) == lpvg_status_not_finite);
    CHECK(status([](Table& t) { t.words.parameters = 3U; }) == lpvg_status_bad_value);
    CHECK(status([](Table& t) { t.words.part[0] = t.words.parts; }) == lpvg_status_bad_value);
    CHECK(status([](Table& t) { t.words.parts = signals + 3U; }) == lpvg_status_bad_value);
    CHECK(status([](Table& t) { t.words.half = 0U; }) == lpvg_status_bad_value);
    CHECK(status([](Table& t) { t.words.window_us = 999999U; }) == lpvg_status_bad_value);
    CHECK(status([](Table& t) { t.reals.scale = Real(0.5); }) == lpvg_status_bad_value);
    CHECK(status([](Table& t) { t.reals.spread[m - 1U] = Real(-1); }) == lpvg_status_bad_value);
    CHECK(status([](Table& t) { t.reals.fault[0] = Real(-1); }) == lpvg_status_bad_value);
    CHECK(status([](Table& t) { t.words.sample_period_us = 0U; }) == lpvg_status_bad_value);
    CHECK(status([](Table& t) { t.words.window_us = 600000001U; }) == lpvg_status_bad_value);
    CHECK(status([](Table& t) { t.words.half = 65537U; }) == lpvg_status_bad_value);
    CHECK(status([](Table& t) { t.words.parts = 0U; }) == lpvg_status_bad_value);
    CHECK(status([](Table& t) { t.reals.period_s = Real(0); }) == lpvg_status_bad_value);
    CHECK(status([](Table& t) { t.reals.least = Real(-1); }) == lpvg_status_bad_value);
    CHECK(status([](Table& t) { t.reals.lack = Real(-1); }) == lpvg_status_bad_value);
}

TEST_CASE("NULL and missing init have defined answers", "[REQ-ISO-4]") {
    Vehicle vehicle;
    lpvg_isolation_t cleared{};
    const lpvg_monitor_t no_monitor{};
    vehicle.next();
    CHECK(lpvg_isolation_table_crc32(nullptr) == 0U);
    CHECK(lpvg_isolation_table_check(nullptr) == lpvg_status_bad_argument);
    CHECK(lpvg_isolation_init(nullptr, &vehicle.table) == lpvg_status_bad_argument);
    CHECK(lpvg_isolation_init(&cleared, nullptr) == lpvg_status_bad_argument);
    CHECK(lpvg_isolation_take(nullptr, &vehicle.monitor, &vehicle.sample) == lpvg_status_bad_argument);
    CHECK(lpvg_isolation_take(&cleared, nullptr, &vehicle.sample) == lpvg_status_bad_argument);
    CHECK(lpvg_isolation_take(&cleared, &vehicle.monitor, nullptr) == lpvg_status_bad_argument);
    CHECK(lpvg_isolation_take(&cleared, &vehicle.monitor, &vehicle.sample) == lpvg_status_not_ready);
    CHECK(lpvg_isolation_take(&vehicle.isolation, &no_monitor, &vehicle.sample) == lpvg_status_not_ready);
    vehicle.isolation.pending = true;
    CHECK(!lpvg_isolation_work(nullptr, &vehicle.monitor));
    CHECK(!lpvg_isolation_work(&vehicle.isolation, nullptr));
    CHECK(!lpvg_isolation_work(&cleared, &vehicle.monitor));
    CHECK(!lpvg_isolation_work(&vehicle.isolation, &no_monitor));
    CHECK(vehicle.isolation.pending);
}
