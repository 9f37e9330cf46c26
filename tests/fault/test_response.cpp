// How long the loop acts on a vehicle whose response to the demand is wrong: from a cold start, and after each kind of release during which
// it goes wrong. Three tables in lib/REQUIREMENTS.md are made of it: `LPVGUARD_RESPONSES=lib/REQUIREMENTS.md test_response` writes the
// first, LPVGUARD_WEAK the second, LPVGUARD_CONSTANT the third, and without that the tests compare them.
#include "../long_form.hpp"
#include "../marked_table.hpp"
#include "response_drive.hpp"

#include <cstdio>
#include <initializer_list>
#include <sstream>
#include <string>

#include "lpvguard_plant/parameters.hpp"

namespace {

constexpr int before_steps = 3'000, after_steps = 6'000, acknowledge_steps = 300;
constexpr std::array<double, 3> speeds_mps = {8.0, 15.0, 21.0};
constexpr std::array<double, 6> responses = {-1.0, 0.0, 0.3, 2.0, 3.0, 1.0};

struct Case {
    const char* name;
    Release kind;
    int steps;
};
const Case cases[] = {
    {"cold start", Release::cold, 0},
    {"VDC2 lost for 60 ms", Release::vdc2_gap, 6},
    {"VDC2 lost for 0.5 s", Release::vdc2_gap, 50},
    {"VDC2 lost for 5 s", Release::vdc2_gap, 500},
    {"GUARD_IN lost for 0.5 s", Release::guard_in_gap, 50},
    {"brake pedal for 0.5 s", Release::pedal, 50},
    {"ABS for 0.5 s", Release::abs, 50},
    {"no request for 0.5 s", Release::request, 50},
    {"another command for 0.5 s", Release::priority, 50},
    {"not asked for 0.5 s", Release::asker, 50},
    {"no step for 0.5 s", Release::clock_gap, 50},
};

const lpvguard_plant::PlantParameters& truck() {
    static const auto parameters = lpvguard_plant::load_parameters(LPVGUARD_TRUCK_TOML);
    return parameters;
}

// Seconds engaged in the minute after the release, in which an acknowledgement is asked for every 3 s.
double engaged_s(const Case& which, double response, double speed_mps, std::uint64_t seed, double amplitude_radps = 0.06,
                 bool constant = false) {
    ResponseDrive drive(truck(), speed_mps, seed);
    drive.command = [=](double t) { return constant ? amplitude_radps : ResponseDrive::sines(amplitude_radps, t); };
    if (which.kind != Release::cold) {
        drive.run(before_steps);
        REQUIRE(drive.bench.engaged());
    }
    drive.response = response;
    drive.release(which.kind, which.steps, 0, response);
    int engaged = 0;
    for (int k = 0; k < after_steps; k += acknowledge_steps) {
        engaged += drive.engaged_steps(acknowledge_steps);
        (void)lpvg_ecu_acknowledge(&drive.bench.ecu);
    }
    return 0.01 * engaged;
}

// At most this long, whatever the release; a healthy truck is engaged again at most 1 s later than wait and measurement of the period ask
// for.
bool within_limit(double response, double seconds) {
    const double most = response <= 0.0 ? 3.0 : 20.0;
    return response == 1.0 ? seconds >= 60.0 - 2.4 : seconds <= most;
}

std::string table() {
    std::ostringstream text;
    text << "| release | × -1 | × 0 | × 0.3 | × 2 | × 3 | healthy |\n| --- | --- | --- | --- | --- | --- | --- |\n";
    const std::uint64_t seeds = long_form() ? 5U : 1U;
    for (const Case& each : cases) {
        text << "| " << each.name;
        for (const double response : responses) {
            double extreme = response == 1.0 ? 60.0 : 0.0;
            for (const double speed_mps : speeds_mps) {
                for (std::uint64_t seed = 1; seed <= seeds; ++seed) {
                    const double seconds = engaged_s(each, response, speed_mps, seed);
                    CAPTURE(each.name, response, speed_mps, seed, seconds);
                    CHECK(within_limit(response, seconds));
                    extreme = seed > 1U ? extreme : response == 1.0 ? std::fmin(extreme, seconds) : std::fmax(extreme, seconds);
                }
            }
            char number[16];
            std::snprintf(number, sizeof number, " | %.2f", extreme);
            text << number;
        }
        text << " |\n";
    }
    return text.str();
}

// Seconds engaged in the minute behind a cold start, the longest of the three speeds: for each command the sum of sines, or, where it
// stays, the amplitude alone, to either side.
template <std::size_t N>
std::string cold_table(const std::array<double, N>& responses, std::initializer_list<double> amplitudes, bool constant) {
    std::ostringstream text, rule;
    text << (constant ? "| command [mrad/s]" : "| amplitude [mrad/s]");
    for (const double response : responses) {
        text << " | × " << response;
        rule << " | ---";
    }
    text << " |\n| ---" << rule.str() << " |\n";
    for (const double amplitude : amplitudes) {
        text << "| " << std::lround(1e3 * amplitude);
        for (const double response : responses) {
            double longest = 0.0;
            for (const double speed_mps : speeds_mps) {
                longest = std::fmax(longest, engaged_s(cases[0], response, speed_mps, 1U, amplitude, constant));
                longest = constant ? std::fmax(longest, engaged_s(cases[0], response, speed_mps, 1U, -amplitude, true)) : longest;
            }
            char number[16];
            std::snprintf(number, sizeof number, " | %.1f", longest);
            text << number;
        }
        text << " |\n";
    }
    return text.str();
}

}  // namespace

TEST_CASE("what a small command shows of the response, and the table of it is the one of the requirements", "[fault][ecu][REQ-ECU-17]") {
    constexpr std::array<double, 3> responses_shown = {-1.0, 0.0, 0.3};
    MarkedTable("weak", "test_response").require(cold_table(responses_shown, {0.06, 0.02, 0.01, 0.006, 0.002}, false), "LPVGUARD_WEAK");
}

TEST_CASE("what a constant command shows of the response, and the table of it is the one of the requirements", "[fault][ecu][REQ-ECU-17]") {
    constexpr std::array<double, 5> responses_shown = {-1.0, 0.0, 0.3, 2.0, 3.0};
    MarkedTable("constant", "test_response")
        .require(cold_table(responses_shown, {0.08, 0.06, 0.05, 0.03, 0.02, 0.01}, true), "LPVGUARD_CONSTANT");
}

TEST_CASE("a vehicle whose response is wrong is not engaged for long, whatever came before", "[fault][ecu][REQ-ECU-17][REQ-ECU-18]") {
    MarkedTable("responses", "test_response").require(table(), "LPVGUARD_RESPONSES");
}

TEST_CASE("a response that goes wrong while nothing excites it meets a small demand", "[fault][ecu][REQ-ECU-17]") {
    constexpr double quiet_s = 60.0;
    for (const double speed_mps : speeds_mps) {
        for (const double response : responses) {
            ResponseDrive drive(truck(), speed_mps, 1U);
            drive.command = [](double t) { return t < 30.0 || t >= 30.0 + quiet_s ? ResponseDrive::sines(0.06, t) : 0.0; };
            drive.run(before_steps + 3'000);
            drive.response = response;
            drive.run(3'000);
            int engaged = 0, strong = 0;
            for (int k = 0; k < 2'000; ++k) {
                drive.step();
                engaged += drive.bench.engaged() ? 1 : 0;
                strong += drive.bench.engaged() && drive.beyond_probing() ? 1 : 0;
            }
            CAPTURE(speed_mps, response, engaged, strong);
            CHECK((response == 1.0 ? engaged == 2'000 && strong > 500 : engaged <= 300 && strong <= 100));
        }
    }
}
