// The diagnosis of an alarm, fed with e and yhat as the monitor leaves them. Compiled for every test vehicle.
#include <algorithm>
#include <cmath>
#include <cstring>
#include <limits>
#include <random>
#include <utility>

#include "monitor/acceptance.hpp"
#include "diagnosis_table.hpp"

namespace {

// Nominal output of output j, t seconds on.
double nominal(double t, std::size_t j) {
    const double p = 0.6 * static_cast<double>(j);
    return std::sin(0.9 * t + p) + 0.7 * std::sin(2.3 * t + 1.0 + p) + 0.4 * std::sin(4.1 * t + p) + 0.2;
}

using Plant = std::function<double(double t, std::size_t j)>;  // what the vehicle does

double healthy(double t, std::size_t j) { return nominal(t, j); }

// A monitor that is no more than what the diagnosis reads of it, and the diagnosis that follows it.
class Followed {
public:
    explicit Followed(const lpvg_diagnosis_table_t& table) : table_(table) {
        monitor.coeff = &lpvg_coeff;
        monitor.restarts = 1U;
        monitor.newest = n_block - 1U;
        REQUIRE(lpvg_diagnosis_init(&diagnosis, &table_) == lpvg_status_ok);
    }
    Followed(const Followed&) = delete;
    Followed& operator=(const Followed&) = delete;

    lpvg_monitor_t monitor{};
    lpvg_diagnosis_t diagnosis{};
    bool alarms = false, falsified = false;
    bool works = true;  // whether work goes on until it has come to its end
    lpvg_reason_t reason = lpvg_reason_none;
    double noise = 0.005;
    double t = 0.0;
    Plant yhat = nominal;

    void sample(const Plant& y) {
        monitor.t_us += 20000;
        monitor.newest = (monitor.newest + 1U) % n_block;
        monitor.n_block = std::min(monitor.n_block + 1U, n_block);
        for (std::size_t j = 0; j < ny; ++j) {
            monitor.signal[monitor.newest][j] = static_cast<Real>(y(t, j) - yhat(t, j) + noise * normal_(random_));
            monitor.signal[monitor.newest][ny + j] = static_cast<Real>(yhat(t, j));
        }
        monitor.block[monitor.newest].span.reason = reason;
        monitor.has_changed = alarms;
        monitor.t_changed_us = monitor.t_us;
        monitor.has_falsified = falsified;
        monitor.t_falsified_us = monitor.t_us;
        t += period_s;
        REQUIRE(lpvg_diagnosis_take(&diagnosis, &monitor) == lpvg_status_ok);
        if (works) {
            while (lpvg_diagnosis_work(&diagnosis)) {
            }
        }
    }
    void run(double seconds, const Plant& y) {
        for (int k = 0; k < static_cast<int>(seconds / period_s + 0.5); ++k) {
            sample(y);
        }
    }
    bool done() const { return diagnosis.alarms > 0U && diagnosis.blocks == LPVG_DIAGNOSIS_DONE; }

private:
    lpvg_diagnosis_table_t table_;
    std::mt19937 random_{7};
    std::normal_distribution<double> normal_;
};

// What is found of each output after 20 s of a healthy vehicle, `until` seconds of the fault, and an alarm.
struct Outcome {
    lpvg_found_t found[ny];
    lpvg_diagnosis_t diagnosis;
};
Outcome diagnosed(const Plant& y, const lpvg_diagnosis_table_t& table, double until = 3.0, double noise = 0.005) {
    Followed f(table);
    f.run(20.0, healthy);
    f.noise = noise;
    f.run(until, y);
    f.alarms = true;
    f.run(14.0, y);
    REQUIRE(f.done());
    Outcome outcome{};
    std::copy(std::begin(f.diagnosis.found), std::end(f.diagnosis.found), std::begin(outcome.found));
    outcome.diagnosis = f.diagnosis;
    return outcome;
}

void holds(const lpvg_found_t& found, lpvg_cause_t cause, double value) {
    CAPTURE(found.cause, found.value, found.low, found.high);
    CHECK(found.cause == cause);
    CHECK(static_cast<double>(found.low) <= value);
    CHECK(static_cast<double>(found.high) >= value);
    CHECK(found.low < found.value);
    CHECK(found.value < found.high);
}

}  // namespace

TEST_CASE("each cause is found with an interval that holds it", "[unit][REQ-DIAG-1]") {
    const lpvg_diagnosis_table_t table = table_with();
    const Plant gain = [](double t, std::size_t j) { return 0.7 * nominal(t, j); };
    const Plant more = [](double t, std::size_t j) { return 1.3 * nominal(t, j); };
    const Plant late = [](double t, std::size_t j) { return nominal(t - 0.2, j); };
    const Plant soon = [](double t, std::size_t j) { return nominal(t + 0.13, j); };
    const Plant bias = [](double t, std::size_t j) { return nominal(t, j) + 0.15; };
    const Plant sign = [](double t, std::size_t j) { return -nominal(t, j); };
    const Plant frozen = [](double, std::size_t) { return 0.37; };
    for (const lpvg_found_t& found : diagnosed(gain, table).found) {
        holds(found, lpvg_cause_gain, 0.7);
    }
    for (const lpvg_found_t& found : diagnosed(more, table).found) {
        holds(found, lpvg_cause_gain, 1.3);
    }
    for (const lpvg_found_t& found : diagnosed(late, table).found) {
        holds(found, lpvg_cause_delay, 0.2);
    }
    for (const lpvg_found_t& found : diagnosed(soon, table).found) {
        holds(found, lpvg_cause_delay, -0.13);
    }
    for (const lpvg_found_t& found : diagnosed(bias, table).found) {
        holds(found, lpvg_cause_bias, 0.15);
    }
    for (const lpvg_found_t& found : diagnosed(sign, table).found) {
        holds(found, lpvg_cause_sign, -1.0);
    }
    for (const lpvg_found_t& found : diagnosed(frozen, table).found) {
        CHECK(found.cause == lpvg_cause_frozen);
        CHECK(std::abs(static_cast<double>(found.value) - 0.37) < 0.01);
    }
    for (const lpvg_found_t& found : diagnosed(healthy, table, 3.0, 0.1).found) {
        CHECK(found.cause == lpvg_cause_noise);
        CHECK(std::abs(static_cast<double>(found.value) - 0.1) < 0.02);
    }
}

TEST_CASE("one output's cause is not the other's", "[unit][REQ-DIAG-1]") {
    const Outcome of = diagnosed([](double t, std::size_t j) { return (j == 0 ? 0.7 : 1.0) * nominal(t, j); }, table_with());
    holds(of.found[0], lpvg_cause_gain, 0.7);
    for (std::size_t j = 1; j < ny; ++j) {
        CHECK(of.found[j].cause == lpvg_cause_other);
    }
}

TEST_CASE("the named cause is that of the first output that has one, once an alarm's causes are found", "[unit][REQ-DIAG-1]") {
    const lpvg_diagnosis_table_t table = table_with();
    CHECK(lpvg_diagnosis_named(nullptr) == nullptr);
    Followed f(table);
    CHECK(lpvg_diagnosis_named(&f.diagnosis) == nullptr);
    f.run(20.0, healthy);
    const Plant last = [](double t, std::size_t j) { return (j == ny - 1U ? 0.7 : 1.0) * nominal(t, j); };
    f.run(3.0, last);
    f.alarms = true;
    f.run(1.0, last);
    CHECK(lpvg_diagnosis_named(&f.diagnosis) == nullptr);
    f.run(13.0, last);
    REQUIRE(f.done());
    CHECK(lpvg_diagnosis_named(&f.diagnosis) == &f.diagnosis.found[ny - 1U]);
    f.diagnosis.found[0].cause = lpvg_cause_bias;
    CHECK(lpvg_diagnosis_named(&f.diagnosis) == &f.diagnosis.found[0]);
    for (lpvg_found_t& found : f.diagnosis.found) {
        found.cause = lpvg_cause_other;
    }
    CHECK(lpvg_diagnosis_named(&f.diagnosis) == &f.diagnosis.found[0]);
}

TEST_CASE("half of the record names a cause first, and the whole record replaces it", "[unit][REQ-DIAG-1][REQ-DIAG-7]") {
    const lpvg_diagnosis_table_t table = table_with();
    const Plant gain = [](double t, std::size_t j) { return 0.7 * nominal(t, j); };
    const Plant two = [](double t, std::size_t j) { return 1.4 * nominal(t - 0.2, j) + 0.3; };
    const bool stays = GENERATE(true, false);
    Followed f(table);
    f.run(20.0, healthy);
    f.alarms = true;
    while (f.diagnosis.blocks < table.words.blocks / 2U) {
        CHECK(lpvg_diagnosis_named(&f.diagnosis) == nullptr);
        f.sample(gain);
    }
    CHECK_FALSE(f.done());
    CHECK(f.diagnosis.t_found_us == f.diagnosis.t_us);
    for (const lpvg_found_t& found : f.diagnosis.found) {
        holds(found, lpvg_cause_gain, 0.7);
    }
    CHECK(lpvg_diagnosis_named(&f.diagnosis) == &f.diagnosis.found[0]);
    const int64_t half_us = f.diagnosis.t_found_us;
    f.run(4.0, stays ? gain : two);
    CHECK(f.diagnosis.t_found_us == half_us);
    CHECK(lpvg_diagnosis_named(&f.diagnosis) == &f.diagnosis.found[0]);
    f.run(3.0, stays ? gain : two);
    REQUIRE(f.done());
    for (const lpvg_found_t& found : f.diagnosis.found) {
        CHECK(found.cause == (stays ? lpvg_cause_gain : lpvg_cause_other));
    }
}

TEST_CASE("half of the record says nothing where it names no cause, or is not excited", "[unit][REQ-DIAG-2][REQ-DIAG-7]") {
    const lpvg_diagnosis_table_t table = table_with();
    const bool excited = GENERATE(true, false);
    const Plant gain = [](double t, std::size_t j) { return 0.7 * nominal(t, j); };
    const Plant still = [](double, std::size_t) { return 0.0; };
    Followed f(table);
    f.run(20.0, healthy);
    f.yhat = excited ? nominal : still;
    f.alarms = true;
    f.run(8.0, excited ? healthy : still);
    CHECK(f.diagnosis.blocks > table.words.blocks / 2U);
    CHECK(lpvg_diagnosis_named(&f.diagnosis) == nullptr);
    for (const lpvg_found_t& found : f.diagnosis.found) {
        CHECK(found.cause == lpvg_cause_unknown);
    }
    f.yhat = nominal;
    f.run(6.0, excited ? healthy : gain);
    CHECK(f.done());
    CHECK(lpvg_diagnosis_named(&f.diagnosis) == &f.diagnosis.found[0]);
}

TEST_CASE("what a drive was before an alarm tells a change from what vehicles differ by", "[unit][REQ-DIAG-8]") {
    // Vehicles differ by 0.2 in their gain. This one has 1.3 of it, and loses a quarter.
    const bool remembers = GENERATE(true, false);
    const lpvg_diagnosis_table_t table = table_with([=](lpvg_diagnosis_table_t& t) {
        for (std::size_t j = 0; j < ny; ++j) {
            t.reals.spread[j][0] = Real(0.04);
            t.reals.kept[j] = remembers ? Real(0.99) : Real(0);
        }
    });
    const Plant own = [](double t, std::size_t j) { return 1.3 * nominal(t, j); };
    const Plant less = [](double t, std::size_t j) { return 0.75 * 1.3 * nominal(t, j); };
    Followed f(table);
    f.run(40.0, own);
    f.run(2.0, less);
    f.alarms = true;
    f.run(14.0, less);
    REQUIRE(f.done());
    for (const lpvg_found_t& found : f.diagnosis.found) {
        if (remembers) {
            holds(found, lpvg_cause_gain, 0.75);
            CHECK(std::abs(block_s * found.onset_blocks - 2.0) <= 16.0 * block_s);
            CHECK_FALSE(found.before);
        } else {
            CHECK(found.cause == lpvg_cause_other);
        }
    }
}

TEST_CASE("what was there long before the alarm is held against healthy vehicles", "[unit][REQ-DIAG-8]") {
    const lpvg_diagnosis_table_t table = table_with([](lpvg_diagnosis_table_t& t) {
        for (Real& kept : t.reals.kept) {
            kept = Real(0.99);
        }
    });
    const Plant gain = [](double t, std::size_t j) { return 0.7 * nominal(t, j); };
    Followed f(table);
    f.run(40.0, gain);
    f.alarms = true;
    f.run(14.0, gain);
    REQUIRE(f.done());
    for (const lpvg_found_t& found : f.diagnosis.found) {
        holds(found, lpvg_cause_gain, 0.7);
        CHECK(found.before);
    }
}

TEST_CASE("of the past count settled blocks without a gap, in parts as long as half a record", "[unit][REQ-DIAG-8]") {
    const lpvg_diagnosis_table_t table = table_with();
    const uint32_t part = table.words.blocks / 2U;
    Followed f(table);
    const auto counts = [&] { return std::make_pair(f.diagnosis.past_blocks, f.diagnosis.filling_blocks); };
    const auto sums = [&](const auto& of) { return static_cast<uint32_t>(of.gram[7]); };  // of 1: as many as there are
    f.run(block_s, healthy);
    CHECK(counts() == std::make_pair(0U, 0U));  // none before it
    f.run((part - 1U) * block_s, healthy);
    CHECK(counts() == std::make_pair(0U, part - 1U));
    f.run(block_s, healthy);
    CHECK(counts() == std::make_pair(part, 0U));
    f.run(3.0 * block_s, healthy);
    CHECK(counts() == std::make_pair(part, 3U));
    f.reason = lpvg_reason_out_of_range;
    f.run(2.0 * block_s, healthy);
    f.reason = lpvg_reason_none;
    f.run(block_s, healthy);
    CHECK(counts() == std::make_pair(part, 3U));
    f.run(block_s, healthy);
    CHECK(counts() == std::make_pair(part, 4U));
    f.monitor.t_us += 1000000;
    f.run(block_s, healthy);
    CHECK(counts() == std::make_pair(part, 4U));
    for (const lpvg_diagnosis_output_t& of : f.diagnosis.output) {
        CHECK(sums(of.past) == part);
        CHECK(sums(of) == 4U);
        CHECK(of.cell_sum[1] != Real(0));
    }
    f.alarms = true;
    f.run(3.0, healthy);
    CHECK(counts() == std::make_pair(part, 0U));
    for (const lpvg_diagnosis_output_t& of : f.diagnosis.output) {
        CHECK(sums(of.past) == part);
        CHECK(sums(of) == f.diagnosis.blocks);
    }
    f.run(11.0, healthy);
    REQUIRE(f.done());
    CHECK(f.diagnosis.past_blocks == 0U);
    const uint32_t since = f.diagnosis.filling_blocks;  // an alarm that stands hinders no new past
    CHECK(since > 0U);
    f.run(block_s, healthy);
    CHECK(f.diagnosis.filling_blocks == since + 1U);
    for (const lpvg_diagnosis_output_t& of : f.diagnosis.output) {
        CHECK(sums(of.past) == 0U);
        CHECK(sums(of) == since + 1U);
    }
}

TEST_CASE("a long past is halved", "[unit][REQ-DIAG-8]") {
    const lpvg_diagnosis_table_t table = table_with([](lpvg_diagnosis_table_t& t) { t.words.blocks = 8U; });
    Followed f(table);
    f.run(block_s, healthy);
    f.run(64.0 * 4.0 * block_s, healthy);
    CHECK(f.diagnosis.past_blocks == 64U * 4U);
    const lpvg_past_t before = f.diagnosis.output[ny - 1U].past;
    f.run(3.0 * block_s, healthy);
    const lpvg_diagnosis_output_t filled = f.diagnosis.output[ny - 1U];
    f.run(block_s, healthy);
    CHECK(f.diagnosis.past_blocks == 130U);
    const lpvg_past_t& past = f.diagnosis.output[ny - 1U].past;
    CHECK(past.gram[7] == Real(130));
    const Real last = f.diagnosis.output[ny - 1U].error_square;
    CHECK(past.error_square == (before.error_square + last) * Real(0.5));
    CHECK(last > filled.error_square);
    for (std::size_t i = 0; i < LPVG_DIAGNOSIS_TRIANGLE; ++i) {
        CHECK(past.gram[i] == (before.gram[i] + f.diagnosis.output[ny - 1U].gram[i]) * Real(0.5));
    }
    for (std::size_t i = 0; i < LPVG_DIAGNOSIS_PARTS; ++i) {
        CHECK(past.along[i] == (before.along[i] + f.diagnosis.output[ny - 1U].along[i]) * Real(0.5));
    }
    f.run(4.0 * block_s, healthy);
    CHECK(f.diagnosis.past_blocks == 134U);
}

TEST_CASE("the same record says the same wherever the histories go round", "[unit][REQ-DIAG-4]") {
    const lpvg_diagnosis_table_t table = table_with();
    const Plant late = [](double t, std::size_t j) { return nominal(t - 0.2, j); };
    constexpr uint32_t round = LPVG_DIAGNOSIS_HISTORY * LPVG_DIAGNOSIS_ERRORS;
    const auto after = [&](uint32_t blocks) {
        Followed f(table);
        f.noise = 0.0;
        f.run(blocks * block_s, healthy);
        f.t = 0.0;
        f.run(20.0, healthy);
        f.alarms = true;
        f.run(14.0, late);
        REQUIRE(f.done());
        return f.diagnosis;
    };
    const lpvg_diagnosis_t first = after(0U), second = after(round - GENERATE(300U, 350U));
    for (std::size_t j = 0; j < ny; ++j) {
        CHECK(first.found[j].cause == lpvg_cause_delay);
        CHECK(second.found[j].cause == lpvg_cause_delay);
        CHECK(second.found[j].value == first.found[j].value);
        CHECK(second.found[j].low == first.found[j].low);
        CHECK(second.output[j].still == first.output[j].still);
        CHECK(second.output[j].error_square == first.output[j].error_square);
        CHECK(second.output[j].moved_error[0] == first.output[j].moved_error[0]);
    }
}

TEST_CASE("what no single cause explains is other", "[unit][REQ-DIAG-2]") {
    const lpvg_diagnosis_table_t table = table_with();
    const Plant none[] = {
        healthy,
        [](double t, std::size_t j) { return 0.7 * nominal(t - 0.2, j); },
        [](double t, std::size_t j) { return 0.7 * nominal(t, j) + 0.2; },
        [](double t, std::size_t j) { return nominal(t - 0.2, j) + 0.2; },
        [](double t, std::size_t j) { return nominal(t - 0.8, j); },  // longer than any that is tried
        [](double t, std::size_t j) { return nominal(t, j) + 0.5 * std::sin(7.0 * t); },
        [](double t, std::size_t j) { return 0.5 * nominal(t, j) + 0.5 * std::sin(9.0 * t); },  // a gain that leaves too much
    };
    for (const Plant& y : none) {
        for (const lpvg_found_t& found : diagnosed(y, table).found) {
            CAPTURE(found.cause, found.value);
            CHECK(found.cause == lpvg_cause_other);
            CHECK(found.value == Real(0));
        }
    }
    for (const lpvg_found_t& found : diagnosed([](double t, std::size_t j) { return 0.6 * nominal(t, j); }, table, 3.0, 0.1).found) {
        CHECK(found.cause == lpvg_cause_other);  // noise beside a gain
    }
}

TEST_CASE("a cause that another explains nearly as well is other", "[unit][REQ-DIAG-2]") {
    const Plant y = [](double t, std::size_t j) { return 0.7 * nominal(t, j); };
    for (const lpvg_found_t& found : diagnosed(y, table_with([](lpvg_diagnosis_table_t& t) { t.reals.margin = Real(1e9); })).found) {
        CHECK(found.cause == lpvg_cause_other);
    }
}

TEST_CASE("a dead zone and a tyre that saturates have no one gain", "[unit][REQ-DIAG-2]") {
    const lpvg_diagnosis_table_t table = table_with();
    const double dead = 0.4, most = 0.8;
    const Plant zone = [=](double t, std::size_t j) {
        const double y = nominal(t, j);
        return y - std::max(-dead, std::min(dead, y));
    };
    const Plant tyre = [=](double t, std::size_t j) { return most * std::tanh(nominal(t, j) / most); };
    for (const Plant& y : {zone, tyre}) {
        for (const lpvg_found_t& found : diagnosed(y, table).found) {
            CAPTURE(found.cause, found.value, found.low, found.high);
            CHECK(found.cause == lpvg_cause_other);
        }
    }
}

TEST_CASE("the onset is within two cells, and before what was kept where it was there from the start", "[unit][REQ-DIAG-3]") {
    const Plant y = [](double t, std::size_t j) { return 0.6 * nominal(t, j); };
    const lpvg_diagnosis_table_t table = table_with();
    const double cell_s = 8.0 * block_s;
    for (const double until : {0.5, 3.0, 6.0, 10.0}) {
        for (const lpvg_found_t& found : diagnosed(y, table, until).found) {
            CAPTURE(until, found.onset_blocks);
            CHECK(std::abs(block_s * found.onset_blocks - until) <= 2.0 * cell_s);
            CHECK_FALSE(found.before);
        }
    }
    for (const lpvg_found_t& found : diagnosed(y, table, 40.0).found) {
        CHECK(found.before);
        CHECK(block_s * found.onset_blocks >= (LPVG_DIAGNOSIS_CELLS - 1) * cell_s);
    }
}

TEST_CASE("blocks that are not settled, not whole, lost or not finite are not taken", "[unit][REQ-DIAG-4]") {
    const lpvg_diagnosis_table_t table = table_with();
    const Plant y = [](double t, std::size_t j) { return 0.7 * nominal(t, j); };
    const Plant wrong = [](double, std::size_t) { return 50.0; };
    const Plant no_number = [](double, std::size_t) { return std::numeric_limits<double>::quiet_NaN(); };
    for (int way = 0; way < 4; ++way) {
        Followed f(table);
        f.run(20.0, healthy);
        f.alarms = true;
        f.run(4.0, y);
        const uint32_t before = f.diagnosis.blocks;
        REQUIRE(before > 20U);
        f.reason = way == 0 ? lpvg_reason_out_of_range : lpvg_reason_none;
        f.monitor.n_block = way == 1 ? 0U : n_block;
        f.works = way != 2;
        // Of those that are not settled none is added, but leads of the settled ones before reach into them: as yhat, not as y.
        const uint32_t led = way == 0 ? LPVG_DIAGNOSIS_DELAYS : 0U;
        f.run(way == 1 ? 0.06 : 2.0, way == 3 ? no_number : wrong);
        if (way == 1) {
            f.sample(wrong);
            f.monitor.n_block = 3U;
        }
        CHECK(f.diagnosis.blocks <= before + (way == 1 ? 1U : led));
        f.reason = lpvg_reason_none;
        f.works = true;
        if (way != 1) {
            f.run(12.0, y);
            REQUIRE(f.done());
            for (const lpvg_found_t& found : f.diagnosis.found) {
                holds(found, lpvg_cause_gain, 0.7);
            }
        }
    }
}

TEST_CASE("between short settled pieces nothing is lost but their first block", "[unit][REQ-DIAG-4]") {
    const Plant y = [](double t, std::size_t j) { return 0.7 * nominal(t, j); };
    const Plant wrong = [](double, std::size_t) { return 50.0; };
    Followed f(table_with());
    f.run(20.0, healthy);
    f.alarms = true;
    uint32_t settled = 0U;
    constexpr uint32_t reach = LPVG_DIAGNOSIS_DELAYS, piece = 9U;  // shorter than what delays and leads reach over
    for (int k = 0; k < 8; ++k) {
        f.reason = lpvg_reason_none;
        f.run(piece * block_s, y);
        settled += piece - (k == 0 ? 0U : 1U);  // the change of yhat is that from a settled block
        f.reason = k % 2 == 0 ? lpvg_reason_out_of_range : lpvg_reason_settling;
        f.run((reach + 1U) * block_s, wrong);
        CHECK(f.diagnosis.blocks == settled);
    }
    f.reason = lpvg_reason_none;
    f.run(8.0, y);
    REQUIRE(f.done());
    for (const lpvg_found_t& found : f.diagnosis.found) {
        holds(found, lpvg_cause_gain, 0.7);  // nothing of `wrong` is in it
    }
}

TEST_CASE("a block that is not settled leads, but its roughness does not count", "[unit][REQ-DIAG-4]") {
    Followed f(table_with());
    f.run(20.0, healthy);
    f.alarms = true;
    f.run(3.0, healthy);
    const uint32_t blocks = f.diagnosis.blocks;
    const Real rough = f.diagnosis.output[ny - 1U].rough;
    CHECK(rough > Real(0));
    f.reason = lpvg_reason_out_of_range;
    f.noise = 1.0;
    f.run(3.0 * block_s, healthy);
    CHECK(f.diagnosis.blocks == blocks + 3U);
    CHECK(f.diagnosis.output[ny - 1U].rough == rough);
}

TEST_CASE("one sample that is not settled makes its block one", "[unit][REQ-DIAG-4]") {
    const uint32_t place = GENERATE(range(0U, n_block));
    Followed f(table_with());
    f.run(20.0, healthy);
    CHECK(f.diagnosis.settled);
    for (uint32_t i = 0; i < n_block; ++i) {
        f.reason = i == place ? lpvg_reason_out_of_range : lpvg_reason_none;
        f.sample(healthy);
    }
    CHECK_FALSE(f.diagnosis.settled);
}

TEST_CASE("a gap in time is not bridged", "[unit][REQ-DIAG-4]") {
    const int64_t until_us = GENERATE(int64_t{1}, int64_t{-5}, int64_t{20000000});
    Followed f(table_with());
    f.monitor.t_us = until_us - 20000000;
    f.run(20.0, healthy);
    CHECK(f.diagnosis.t_us == until_us);
    CHECK(f.diagnosis.good_cells != 0U);
    f.monitor.t_us += 1000000;
    f.run(block_s, healthy);
    CHECK(f.diagnosis.good_cells == 0U);
    CHECK(f.diagnosis.known == 1U);
    f.alarms = true;
    f.run(5.0, healthy);
    const uint32_t known = f.diagnosis.known, newest = f.diagnosis.newest, blocks = f.diagnosis.blocks;
    REQUIRE(known > 20U);
    f.monitor.refused = true;  // verdict fault: no block is taken
    f.run(1.0, healthy);
    CHECK(f.diagnosis.known == known);
    CHECK(f.diagnosis.newest == newest);
    CHECK(f.diagnosis.blocks == blocks);
}

TEST_CASE("half a block more than a block is no gap, a microsecond more is", "[unit][REQ-DIAG-4]") {
    const bool beyond = GENERATE(false, true);
    Followed f(table_with());
    f.run(20.0, healthy);
    f.monitor.t_us += 40000 + (beyond ? 1 : 0);
    f.run(block_s, healthy);
    CHECK((f.diagnosis.known == 1U) == beyond);
    CHECK((f.diagnosis.good_cells == 0U) == beyond);
}

TEST_CASE("more pending outputs than there are spoil nothing", "[unit][REQ-DIAG-5]") {
    Followed f(table_with());
    f.run(20.0, healthy);
    f.diagnosis.pending = ny + 1U;
    f.diagnosis.mean[0] = Real(3);
    CHECK(lpvg_diagnosis_work(&f.diagnosis));
    CHECK(f.diagnosis.output[0].errors[(f.diagnosis.newest + 1U) % LPVG_DIAGNOSIS_ERRORS] == Real(3));  // the first takes it
    CHECK(f.diagnosis.pending == ny);
    CHECK(f.diagnosis.known == LPVG_DIAGNOSIS_HISTORY);
}

TEST_CASE("cells that are not settled end the search for the onset", "[unit][REQ-DIAG-3][REQ-DIAG-4]") {
    const Plant y = [](double t, std::size_t j) { return 0.7 * nominal(t, j); };
    Followed f(table_with());
    f.run(10.0, healthy);
    f.reason = lpvg_reason_out_of_range;
    f.run(1.0, y);
    f.reason = lpvg_reason_none;
    f.run(4.0, y);
    f.alarms = true;
    f.run(14.0, y);
    REQUIRE(f.done());
    for (const lpvg_found_t& found : f.diagnosis.found) {
        holds(found, lpvg_cause_gain, 0.7);
        CHECK(found.before);  // as far back as whole cells go, it was there
        CHECK(block_s * found.onset_blocks > 2.0);
        CHECK(block_s * found.onset_blocks < 4.0);
    }
}

TEST_CASE("one monitor's state is taken once", "[unit][REQ-DIAG-4]") {
    Followed f(table_with());
    f.run(20.0, healthy);
    const uint32_t known = f.diagnosis.known;
    const uint32_t newest = f.diagnosis.newest;
    REQUIRE(lpvg_diagnosis_take(&f.diagnosis, &f.monitor) == lpvg_status_ok);
    CHECK_FALSE(lpvg_diagnosis_work(&f.diagnosis));
    CHECK(f.diagnosis.known == known);
    CHECK(f.diagnosis.newest == newest);
}

TEST_CASE("what falsifies is diagnosed as what only changed is", "[unit][REQ-DIAG-1]") {
    const Plant y = [](double t, std::size_t j) { return 0.7 * nominal(t, j); };
    Followed f(table_with());
    f.run(20.0, healthy);
    f.falsified = true;
    f.run(14.0, y);
    REQUIRE(f.done());
    for (const lpvg_found_t& found : f.diagnosis.found) {
        holds(found, lpvg_cause_gain, 0.7);
    }
}

TEST_CASE("without excitation there is no cause yet", "[unit][REQ-DIAG-4]") {
    Followed f(table_with([](lpvg_diagnosis_table_t& t) { t.reals.excited = Real(0.99); }));
    f.run(5.0, healthy);
    f.alarms = true;
    f.run(60.0, [](double t, std::size_t j) { return 0.7 * nominal(t, j); });
    CHECK_FALSE(f.done());
    CHECK(f.diagnosis.found[0].cause == lpvg_cause_unknown);
}

TEST_CASE("excitation is the mean square over the blocks since the alarm, of the output that has most", "[unit][REQ-DIAG-4]") {
    // yhat is 1/4 all the time, so its mean square is 1/16 from the first block on: as much as is asked for, or just less.
    const Real asked = GENERATE(Real(0.0625), std::nextafter(Real(0.0625), Real(1)));
    const std::size_t excited = GENERATE(std::size_t{0}, ny - 1U);
    const lpvg_diagnosis_table_t table = table_with([=](lpvg_diagnosis_table_t& t) {
        t.words.blocks = 8U;
        t.reals.excited = asked;
    });
    const Plant still = [excited](double, std::size_t j) { return j == excited ? 0.25 : 0.0; };
    Followed f(table);
    f.yhat = still;
    f.noise = 0.0;
    f.run(5.0, still);
    f.alarms = true;
    f.run(block_s * (8.0 + LPVG_DIAGNOSIS_DELAYS - 1.0), still);  // those before the first whose leads are from after the alarm
    CHECK(f.diagnosis.blocks == 7U);
    f.run(block_s, still);
    CHECK(f.done() == (asked <= Real(0.0625)));
}

TEST_CASE("a shift by no stride moves nothing", "[unit][REQ-DIAG-4]") {
    Followed f(table_with());
    f.run(20.0, healthy);
    f.alarms = true;
    f.run(4.0, healthy);
    REQUIRE(f.diagnosis.blocks > 20U);
    for (const lpvg_diagnosis_output_t& of : f.diagnosis.output) {
        CHECK(of.moved_square[0] > Real(0));
        CHECK(of.moved_cross[0] == Real(0));  // of the first delay, and of the first lead
        CHECK(of.moved_cross[LPVG_DIAGNOSIS_DELAYS] == Real(0));
    }
}

TEST_CASE("the first cell after a diagnosis is that of its own blocks", "[unit][REQ-DIAG-3][REQ-DIAG-4]") {
    const Plant yhat = [](double, std::size_t) { return 0.5; };
    const Plant before = [](double, std::size_t) { return 0.75; };
    const Plant after = [](double, std::size_t) { return 1.25; };
    Followed f(table_with([](lpvg_diagnosis_table_t& t) { t.words.blocks = 8U; }));
    f.yhat = yhat;
    f.noise = 0.0;
    f.run(block_s * 83.0, before);  // ten cells, and three blocks of the next
    REQUIRE(f.diagnosis.cells == 10U);
    REQUIRE(f.diagnosis.cell_good == 3U);
    f.diagnosis.cell_good = 1U;  // as after a gap
    f.alarms = true;
    f.run(block_s * (8.0 + LPVG_DIAGNOSIS_DELAYS), before);
    REQUIRE(f.done());
    CHECK(f.diagnosis.partial == 3U);
    f.run(block_s * 7.0, after);
    CHECK(f.diagnosis.cells == 0U);
    f.run(block_s, after);
    REQUIRE(f.diagnosis.cells == 1U);
    for (const lpvg_diagnosis_output_t& of : f.diagnosis.output) {
        CHECK(of.cell[f.diagnosis.cell_newest][0] == Real(0.75));
        CHECK(of.cell[f.diagnosis.cell_newest][1] == Real(0.5));
    }
}

TEST_CASE("a block is taken as its means and its roughness, output by output", "[unit][REQ-DIAG-1]") {
    Followed f(table_with());
    f.run(20.0, healthy);
    CHECK(f.diagnosis.known == LPVG_DIAGNOSIS_HISTORY);  // as many as the history holds
    const double yhat[4] = {1.0, 2.0, 4.0, 8.0}, e[4] = {0.0, 0.0, 0.0, 1.0};
    for (uint32_t i = 0; i < n_block; ++i) {
        for (std::size_t j = 0; j < ny; ++j) {
            const auto size = static_cast<double>(j + 1U);
            f.monitor.signal[i][j] = static_cast<Real>(e[i] * size);
            f.monitor.signal[i][ny + j] = static_cast<Real>(yhat[i] * size);
        }
    }
    f.monitor.t_us += 80000;
    REQUIRE(lpvg_diagnosis_take(&f.diagnosis, &f.monitor) == lpvg_status_ok);
    for (std::size_t j = 0; j < ny; ++j) {
        const auto size = static_cast<Real>(j + 1U);
        CHECK(f.diagnosis.mean[j] == Real(0.25) * size);
        CHECK(f.diagnosis.mean[ny + j] == Real(3.75) * size);
        CHECK(f.diagnosis.rough[j] == Real(2) * size);  // (1 - 2 - 4 + 9) / 2
    }
}

TEST_CASE("init forgets what was there", "[unit][REQ-DIAG-6]") {
    Followed f(table_with());
    f.run(20.0, healthy);
    f.alarms = true;
    f.run(1.0, healthy);
    REQUIRE(f.diagnosis.alarms == 1U);
    REQUIRE(lpvg_diagnosis_init(&f.diagnosis, f.diagnosis.table) == lpvg_status_ok);
    CHECK(f.diagnosis.alarms == 0U);
    CHECK(f.diagnosis.known == 0U);
    CHECK(f.diagnosis.cells == 0U);
    CHECK(f.diagnosis.output[0].gram[0] == Real(0));
}

TEST_CASE("an alarm while it is diagnosed is no further one; one after it is", "[unit][REQ-DIAG-4]") {
    const Plant y = [](double t, std::size_t j) { return 0.7 * nominal(t, j); };
    Followed f(table_with());
    f.run(20.0, healthy);
    f.alarms = true;
    f.run(4.0, y);
    f.alarms = false;
    f.run(1.0, y);
    f.alarms = true;
    f.run(10.0, y);
    REQUIRE(f.done());
    CHECK(f.diagnosis.alarms == 1U);
    f.run(2.0, y);
    CHECK(f.diagnosis.alarms == 1U);
    f.alarms = false;
    f.run(10.0, healthy);
    CHECK(f.diagnosis.found[0].cause == lpvg_cause_gain);
    f.alarms = true;
    f.run(1.0, healthy);
    CHECK(f.diagnosis.alarms == 2U);
    CHECK(f.diagnosis.found[0].cause == lpvg_cause_unknown);
}

TEST_CASE("state that cannot be ends the diagnosis", "[unit][REQ-DIAG-5]") {
    const Plant y = [](double t, std::size_t j) { return 0.7 * nominal(t, j); };
    for (int way = 0; way < 6; ++way) {
        Followed f(table_with());
        f.run(20.0, healthy);
        if (way == 3) {  // without an alarm nothing was found, and nothing is
            f.diagnosis.output[ny - 1U].gram[0] += Real(1);
            f.run(block_s, healthy);
            CHECK(f.diagnosis.found[0].cause == lpvg_cause_unknown);
            CHECK(f.diagnosis.known == 0U);
            CHECK_FALSE(lpvg_diagnosis_work(&f.diagnosis));  // the block it was found with is lost
            f.run(block_s, healthy);
            CHECK(f.diagnosis.known == 1U);
            CHECK(f.diagnosis.cell_blocks == 1U);
            continue;
        }
        f.alarms = true;
        f.run(5.0, y);
        REQUIRE_FALSE(f.done());
        lpvg_diagnosis_output_t& of = f.diagnosis.output[0];
        const Real inf = std::numeric_limits<Real>::infinity();
        if (way == 0) {
            f.diagnosis.output[ny - 1U].gram[4] += Real(1);
        } else if (way == 1) {
            f.diagnosis.newest = LPVG_DIAGNOSIS_HISTORY * LPVG_DIAGNOSIS_ERRORS;
        } else {  // the sums agree, and are none of any drive
            of.along[1] = way == 2 ? inf : of.along[1];
            of.error_square = way == 4 ? inf : of.error_square;
            of.gram[4] = way == 5 ? Real(-1e6) : of.gram[4];
            f.diagnosis.sum[0] = lpvguard::sum_of_words(of);
        }
        f.run(10.0, y);
        REQUIRE(f.done());
        const lpvg_found_t& found = f.diagnosis.found[way == 0 ? ny - 1U : 0U];
        CHECK(found.cause == lpvg_cause_other);
        CHECK((found.value == Real(0) && found.low == Real(0) && found.high == Real(0)));
        if (way < 2) {  // nothing is known of what was kept
            CHECK(found.onset_blocks == 0U);
            CHECK_FALSE(found.before);
        }
    }
}

TEST_CASE("state that cannot be leaves a cause that was found", "[unit][REQ-DIAG-5]") {
    Followed f(table_with());
    f.run(20.0, healthy);
    f.alarms = true;
    f.run(60.0, [](double t, std::size_t j) { return (j == 0U ? 0.7 : 0.8) * nominal(t, j); });
    REQUIRE(f.done());
    lpvg_found_t found[ny];
    std::copy(std::begin(f.diagnosis.found), std::end(f.diagnosis.found), found);
    f.diagnosis.output[0].gram[0] += Real(1);
    f.run(2.0 * block_s, healthy);
    CHECK(f.diagnosis.known <= 1U);
    for (std::size_t j = 0; j < ny; ++j) {
        CHECK(f.diagnosis.found[j].cause == lpvg_cause_gain);
        CHECK(f.diagnosis.found[j].value == found[j].value);
    }
}

TEST_CASE("a signal that overflows is other", "[unit][REQ-DIAG-5]") {
    const double huge = 100.0 * std::sqrt(static_cast<double>(std::numeric_limits<Real>::max()));
    for (const lpvg_found_t& found :
         diagnosed([=](double t, std::size_t) { return std::sin(t) > 0.0 ? huge : -huge; }, table_with()).found) {
        CHECK(found.cause == lpvg_cause_other);
    }
}

TEST_CASE("a table that cannot be is refused by what is wrong", "[unit][REQ-DIAG-6]") {
    lpvg_diagnosis_t diagnosis{};
    const auto status = [&](const std::function<void(lpvg_diagnosis_table_t&)>& change) {
        const lpvg_diagnosis_table_t t = table_with(change);
        CHECK(lpvg_diagnosis_table_check(&t) == lpvg_diagnosis_init(&diagnosis, &t));
        return lpvg_diagnosis_table_check(&t);
    };
    using Table = lpvg_diagnosis_table_t;
    CHECK(status([](Table&) {}) == lpvg_status_ok);
    diagnosis = lpvg_diagnosis_t{};
    CHECK(status([](Table& t) { t.words.magic ^= 1U; }) == lpvg_status_bad_magic);
    CHECK(status([](Table& t) { t.words.schema += 1U; }) == lpvg_status_bad_schema);
    CHECK(status([](Table& t) { t.words.real_bytes += 1U; }) == lpvg_status_bad_size);
    CHECK(status([](Table& t) { t.words.sizes[0] += 1U; }) == lpvg_status_bad_size);
    CHECK(status([](Table& t) { t.reals.margin = std::numeric_limits<Real>::infinity(); }) == lpvg_status_not_finite);
    // The borders of what is allowed, and what lies just beyond them.
    CHECK(status([](Table& t) {
              t.words.blocks = 8U;
              t.words.stride = 4U;
              t.words.cell_blocks = 65536U;
              t.reals.margin = t.reals.kept[0] = Real(0);
          }) == lpvg_status_ok);
    CHECK(status([](Table& t) {
              t.words.blocks = 65536U;
              t.words.cell_blocks = t.words.sample_period_us = 1U;
              t.reals.correlated[0] = t.reals.fits = t.reals.interval = Real(0.5);
              t.reals.kept[0] = t.reals.still[0] = t.reals.excited = Real(0.999);
          }) == lpvg_status_ok);
    diagnosis = lpvg_diagnosis_t{};
    const std::pair<uint32_t lpvg_diagnosis_words_t::*, uint32_t> words[] = {
        {&lpvg_diagnosis_words_t::sample_period_us, 0U}, {&lpvg_diagnosis_words_t::blocks, 7U}, {&lpvg_diagnosis_words_t::blocks, 65537U},
        {&lpvg_diagnosis_words_t::stride, 0U},           {&lpvg_diagnosis_words_t::stride, 5U}, {&lpvg_diagnosis_words_t::cell_blocks, 0U},
        {&lpvg_diagnosis_words_t::cell_blocks, 65537U},
    };
    for (const auto& [item, value] : words) {
        CHECK(status([item = item, value = value](Table& t) { t.words.*item = value; }) == lpvg_status_bad_value);
    }
    const std::pair<std::function<Real*(Table&)>, Real> reals[] = {
        {[](Table& t) { return &t.reals.block_s; }, Real(0)},
        {[](Table& t) { return &t.reals.unit[ny - 1U][0]; }, Real(0)},
        {[](Table& t) { return &t.reals.unit[0][1]; }, Real(-1)},
        {[](Table& t) { return &t.reals.correlated[ny - 1U]; }, Real(0)},
        {[](Table& t) { return &t.reals.residue[0][0]; }, Real(0)},
        {[](Table& t) { return &t.reals.residue[ny - 1U][1]; }, Real(0)},
        {[](Table& t) { return &t.reals.rough[ny - 1U]; }, Real(0)},
        {[](Table& t) { return &t.reals.still[ny - 1U]; }, Real(0)},
        {[](Table& t) { return &t.reals.still[0]; }, Real(1)},
        {[](Table& t) { return &t.reals.excited; }, Real(0)},
        {[](Table& t) { return &t.reals.excited; }, Real(1)},
        {[](Table& t) { return &t.reals.fits; }, Real(0)},
        {[](Table& t) { return &t.reals.margin; }, Real(-0.001)},
        {[](Table& t) { return &t.reals.interval; }, Real(0)},
        {[](Table& t) { return &t.reals.kept[ny - 1U]; }, Real(-0.001)},
        {[](Table& t) { return &t.reals.kept[0]; }, Real(1)},
    };
    for (const auto& [item, value] : reals) {
        CHECK(status([&item = item, value = value](Table& t) { *item(t) = value; }) == lpvg_status_bad_value);
    }
    for (std::size_t i = 0; i < sizeof(lpvg_diagnosis_reals_t) / sizeof(Real); ++i) {
        const Real no_number = std::numeric_limits<Real>::quiet_NaN();
        CHECK(status([&](Table& t) {
                  std::memcpy(reinterpret_cast<unsigned char*>(&t.reals) + i * sizeof(Real), &no_number, sizeof no_number);
              }) == lpvg_status_not_finite);
    }
    CHECK(status([](Table& t) { t.reals.spread[ny - 1U][1] = Real(1); }) == lpvg_status_bad_value);
    for (const std::size_t i : diagonal) {  // a part that does not vary at all
        CHECK(status([i](Table& t) { t.reals.spread[ny - 1U][i] = Real(0); }) == lpvg_status_bad_value);
    }
    CHECK(diagnosis.table == nullptr);
    const Table good = table_with();
    // In double there may be bytes between words and reals that belong to neither.
    constexpr std::size_t words_end = 8U * (offsetof(Table, words) + sizeof(Table::words)), reals_begin = 8U * offsetof(Table, reals);
    for (std::size_t bit = 8U * offsetof(Table, words.sample_period_us); bit < 8U * sizeof good; bit += 7U) {
        if (bit >= words_end && bit < reals_begin) {
            continue;
        }
        Table flipped = good;
        reinterpret_cast<unsigned char*>(&flipped)[bit / 8U] ^= static_cast<unsigned char>(1U << (bit % 8U));
        CHECK(lpvg_diagnosis_table_check(&flipped) == lpvg_status_bad_crc);
    }
}

TEST_CASE("NULL and missing init have defined answers", "[unit][REQ-DIAG-6]") {
    lpvg_diagnosis_t diagnosis{};
    lpvg_monitor_t monitor{};
    const lpvg_diagnosis_table_t good = table_with();
    CHECK(lpvg_diagnosis_table_check(nullptr) == lpvg_status_bad_argument);
    CHECK(lpvg_diagnosis_table_crc32(nullptr) == 0U);
    CHECK(lpvg_diagnosis_init(nullptr, &good) == lpvg_status_bad_argument);
    CHECK(lpvg_diagnosis_init(&diagnosis, nullptr) == lpvg_status_bad_argument);
    CHECK(lpvg_diagnosis_take(nullptr, &monitor) == lpvg_status_bad_argument);
    CHECK(lpvg_diagnosis_take(&diagnosis, nullptr) == lpvg_status_bad_argument);
    CHECK(lpvg_diagnosis_take(&diagnosis, &monitor) == lpvg_status_not_ready);
    monitor.coeff = &lpvg_coeff;
    CHECK(lpvg_diagnosis_take(&diagnosis, &monitor) == lpvg_status_not_ready);  // a diagnosis without init
    monitor.coeff = nullptr;
    CHECK_FALSE(lpvg_diagnosis_work(nullptr));
    diagnosis.pending = 1U;
    CHECK_FALSE(lpvg_diagnosis_work(&diagnosis));
    REQUIRE(lpvg_diagnosis_init(&diagnosis, &good) == lpvg_status_ok);
    CHECK(lpvg_diagnosis_take(&diagnosis, &monitor) == lpvg_status_not_ready);  // a monitor without init
}
