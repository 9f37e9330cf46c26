// mutant_switch.cpp -- the switch of mutant_switch.h in a test program, and what each test case reaches.
//
// In the environment: LPVGUARD_MUTANT, number of the mutant that runs; LPVGUARD_SITES_MAX, sites that may be reached in all, then the
// program ends with status 86; LPVGUARD_CPU_S, seconds of processor time after which the system ends it; LPVGUARD_REACHED, a file that
// receives a line for each test case: its seconds, the sites it reached in all, its name, and the number of every site that it reached,
// tabs between.
#include "mutant_switch.h"

#include <sys/resource.h>

#include <cstdio>
#include <cstdlib>
#include <cstring>
#include <ctime>
#include <string>

#include "../catch.hpp"

namespace {

constexpr int status_runs_on = 86;

unsigned long long number(const char* name, unsigned long long otherwise) {
    const char* const text = std::getenv(name);
    return text == nullptr ? otherwise : std::strtoull(text, nullptr, 10);
}

}  // namespace

extern "C" {
int lpvg_mutant = -1;
unsigned char lpvg_reached[LPVG_SITES_MAX] = {};
unsigned long long lpvg_sites_left = ~0ULL;
void lpvg_runs_on(void) { std::_Exit(status_runs_on); }
}

namespace {

// Before the constants of other sources are made.
__attribute__((constructor(101))) void read_switch() {
    lpvg_mutant = static_cast<int>(number("LPVGUARD_MUTANT", ~0ULL));
    lpvg_sites_left = number("LPVGUARD_SITES_MAX", ~0ULL);
    const rlim_t seconds = number("LPVGUARD_CPU_S", RLIM_INFINITY);
    const rlimit limit{seconds, seconds};
    (void)setrlimit(RLIMIT_CPU, &limit);
}

struct Reached : Catch::TestEventListenerBase {
    using TestEventListenerBase::TestEventListenerBase;
    unsigned long long before = 0U;
    // What constants reached as they were made counts to every case.
    std::string always;

    void testRunStarting(const Catch::TestRunInfo& info) override {
        TestEventListenerBase::testRunStarting(info);
        always.assign(reinterpret_cast<const char*>(lpvg_reached), sizeof lpvg_reached);
    }
    void testCaseStarting(const Catch::TestCaseInfo& info) override {
        TestEventListenerBase::testCaseStarting(info);
        std::memcpy(lpvg_reached, always.data(), sizeof lpvg_reached);
        before = lpvg_sites_left;
        began = std::clock();
    }
    void testCaseEnded(const Catch::TestCaseStats& stats) override {
        const unsigned long long reached = before - lpvg_sites_left;
        if (const char* const path = std::getenv("LPVGUARD_REACHED")) {
            const double seconds = static_cast<double>(std::clock() - began) / CLOCKS_PER_SEC;
            std::FILE* const file = std::fopen(path, "a");
            (void)std::fprintf(file, "%.6f\t%llu\t%s", seconds, reached, stats.testInfo.name.c_str());
            for (int n = 0; n < LPVG_SITES_MAX; ++n) {
                if (lpvg_reached[n] != 0U) {
                    (void)std::fprintf(file, "\t%d", n);
                }
            }
            (void)std::fprintf(file, "\n");
            (void)std::fclose(file);
        }
        TestEventListenerBase::testCaseEnded(stats);
    }
    std::clock_t began = 0;
};
CATCH_REGISTER_LISTENER(Reached)

}  // namespace
