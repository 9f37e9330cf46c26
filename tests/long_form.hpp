/// @file long_form.hpp -- whether a test runs its long form: LPVGUARD_FULL=1 in the environment (tools/test --full).
#pragma once

#include <cstdlib>
#include <string>

inline bool long_form() {
    const char* const full = std::getenv("LPVGUARD_FULL");
    return full != nullptr && std::string(full) == "1";
}
