/// @file catch_main.cpp -- main() of every Catch2 test program of the project; kept apart because it compiles slowly.
///
/// With LPVGUARD_FLUSH_TO_ZERO in the environment subnormal numbers count as zero, as operands and as results: the default of many ECUs.
/// Exit status 2 where this processor's mode is not known here.
#define CATCH_CONFIG_RUNNER
#include "../catch.hpp"

#include <cstdio>
#include <cstdlib>
#ifdef __SSE2__
#include <xmmintrin.h>
#endif

namespace {

bool flush_to_zero() {
#ifdef __SSE2__
    constexpr unsigned flushed_results = 0x8000U, zero_operands = 0x0040U;
    _mm_setcsr(_mm_getcsr() | flushed_results | zero_operands);
    const volatile float smallest = 1e-40F;
    return smallest + smallest == 0.0F;
#else
    return false;
#endif
}

}  // namespace

int main(int argc, char* argv[]) {
    if (std::getenv("LPVGUARD_FLUSH_TO_ZERO") != nullptr && !flush_to_zero()) {
        (void)std::fputs("flush-to-zero: unknown mode of this processor\n", stderr);
        return 2;
    }
    return Catch::Session().run(argc, argv);
}
