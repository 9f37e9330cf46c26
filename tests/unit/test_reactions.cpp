// From cause to release: the longest time over the phases of sample period, messages and windows. The table in lib/REQUIREMENTS.md is
// made of it: `LPVGUARD_REACTIONS=lib/REQUIREMENTS.md test_reactions` writes the table, and without that the test compares it.
#include "ecu_bench.hpp"

#include <cstdlib>
#include <fstream>
#include <functional>
#include <sstream>
#include <string>

namespace {

struct Row {
    const char* cause;
    const char* reaction;
    int phases;                           // one step apart
    double limit_ms;                      // of this many at most
    std::function<void(Bench&)> begin;    // the cause, right before a step
    std::function<void(Bench&)> goes_on;  // a step of it
    float speed_mps = 12.0F;              // before it
};

void step(Bench& bench) { bench.step(); }

// A step that comes later than the sample period after the one before.
std::function<void(Bench&)> every(int64_t period_us) {
    return [period_us](Bench& bench) { bench.step_at(bench.now_us + period_us); };
}

void nothing(Bench&) {}

const Row rows[] = {
    {"clock: one step later than 1.5 periods (30 ms)", "release", 10, 30.0, nothing, every(30'000)},
    {"clock: period 10.25 ms", "release, verdict fault", 60, 1'600.0, nothing, every(10'250)},
    {"clock: period 10.5 ms", "release, verdict fault", 60, 1'100.0, nothing, every(10'500)},
    {"clock: period 12 ms", "release, verdict fault", 60, 1'100.0, nothing, every(12'000)},
    {"clock: period 14.9 ms", "release, verdict fault", 60, 1'100.0, nothing, every(14'900)},
    {"speed above the range", "release", 10, 110.0, [](Bench& b) { b.speed = 22.05F; }, step, 21.7F},
    {"speed below the range", "release", 10, 110.0, [](Bench& b) { b.speed = 7.95F; }, step, 8.3F},
    {"brake pedal", "release", 10, 110.0, [](Bench& b) { b.pedal_percent = 10.0F; }, step},
    {"ABS active", "release", 10, 110.0, [](Bench& b) { b.abs_active = 1U; }, step},
    {"request release", "release", 10, 10.0, [](Bench& b) { b.request = LPVG_BUS_REQUEST_RELEASE; }, step},
    {"another command of higher priority", "release", 10, 10.0, [](Bench& b) { b.other_priority = 1U; }, step},
    {"VDC2 lost", "release", 10, 50.0, [](Bench& b) { b.send_vdc2 = false; }, step},
    {"GUARD_IN lost", "release", 10, 50.0, [](Bench& b) { b.send_guard_in = false; }, step},
    {"GUARD_IN, every checksum wrong", "release", 10, 50.0, [](Bench& b) { b.spoil_guard_in = true; }, step},
    {"GUARD_IN, every other checksum wrong", "release", 10, 170.0, nothing,
     [](Bench& b) {
         b.spoil_guard_in = !b.spoil_guard_in;
         b.step();
     }},
    {"GUARD_IN, a second sender with counter + 1", "release", 10, 130.0, [](Bench& b) { b.second_sender = true; }, step},
    {"EBC2 or EBC1 lost", "release", 10, 460.0, [](Bench& b) { b.send_ebc2 = b.send_ebc1 = false; }, step},
    {"verdict unknown, stale or fault", "release", 1, 10.0, [](Bench& b) { b.ecu.report.verdict = lpvg_verdict_stale; }, step},
    {"verdict invalid", "release, lock", 1, 20.0,
     [](Bench& b) {
         b.ecu.monitor.has_falsified = true;
         b.ecu.monitor.t_falsified_us = b.ecu.core_us;
     },
     step},
    {"sensors contradict each other", "release, lock", 10, 1'020.0, [](Bench& b) { b.lateral = 3.0F; }, step},
    {"actuator 2.2 bar off the demand", "release, lock", 10, 320.0,
     [](Bench& b) {
         b.brakes_work = false;
         b.pressure = static_cast<float>(b.ecu.control.u[0]) - 2.2F;
     },
     step},
    {"kept values or state damaged", "release until init", 10, 10.0, [](Bench& b) { b.ecu.inverted[5] ^= 4U; }, step},
    {"coefficients damaged", "release until init", 997, 10'010.0,
     [](Bench& b) { const_cast<lpvg_coeff_t*>(b.ecu.kept.coeff)->reals.threshold *= lpvg_real_t(2); }, step},
};

lpvg_coeff_t coeff;

// Longest time [ms] from the last step before the cause to the first one released.
double longest_ms(const Row& row) {
    double longest = 0.0;
    lpvg_ecu_config_t with = bench_config;
    with.report_only = 0U;
    coeff = lpvg_coeff;
    Bench start(with, coeff);
    start.speed = row.speed_mps;
    start.run_until_engaged();
    start.run(30);
    const int stride = row.phases > 100 ? 83 : 1;
    for (int phase = 0; phase < row.phases; phase += stride) {
        coeff = lpvg_coeff;
        Bench bench = start;
        bench.run(phase);
        REQUIRE(bench.engaged());
        const int64_t begin_us = bench.now_us;
        row.begin(bench);
        while (bench.engaged() && bench.now_us - begin_us < 20'000'000) {
            row.goes_on(bench);
        }
        CAPTURE(row.cause, phase);
        CHECK_FALSE(bench.engaged());
        longest = std::fmax(longest, 1e-3 * static_cast<double>(bench.now_us - begin_us));
    }
    return longest;
}

const std::string begin_mark = "<!-- reactions: written by `test_reactions`, do not edit -->\n", end_mark = "<!-- reactions: end -->\n";

std::string table() {
    std::ostringstream text;
    text << "| cause | reaction | longest time to release [ms] | at most [ms] |\n| --- | --- | --- | --- |\n";
    for (const Row& row : rows) {
        const double ms = longest_ms(row);
        CAPTURE(row.cause);
        CHECK(ms <= row.limit_ms);
        text << "| " << row.cause << " | " << row.reaction << " | " << ms << " | " << row.limit_ms << " |\n";
    }
    return text.str();
}

}  // namespace

TEST_CASE("every cause releases within its time, and the table of them is the one of the requirements", "[unit][reactions][REQ-ECU-16]") {
    const std::string rows_now = begin_mark + table() + end_mark;
    std::ifstream file(LPVG_REQUIREMENTS);
    std::string document((std::istreambuf_iterator<char>(file)), std::istreambuf_iterator<char>());
    const std::size_t begin = document.find(begin_mark), end = document.find(end_mark);
    REQUIRE(begin != std::string::npos);
    REQUIRE(end != std::string::npos);
    const std::string before = document.substr(begin, end + end_mark.size() - begin);
    if (const char* const target = std::getenv("LPVGUARD_REACTIONS")) {
        document.replace(begin, before.size(), rows_now);
        std::ofstream(target) << document;
    } else {
        CHECK(before == rows_now);
    }
}
