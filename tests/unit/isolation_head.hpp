// isolation_head.hpp -- what every isolation table of a test begins with.
#pragma once

#include <algorithm>
#include <cstdint>

#include "lpvguard/coeff.h"
#include "lpvguard/isolation.h"

namespace isolation_test {

// Fills identity, sizes and sample period of the compiled vehicle.
inline void set_head(lpvg_isolation_words_t& words) {
    words.magic = LPVG_ISOLATION_MAGIC;
    words.schema = LPVG_ISOLATION_SCHEMA;
    words.real_bytes = sizeof(lpvg_real_t);
    const uint32_t sizes[6] = {LPVG_NX, LPVG_NU, LPVG_NY, LPVG_DELAY, LPVG_NCELLS, LPVG_NVARYING};
    std::copy(sizes, sizes + 6, words.sizes);
    words.sample_period_us = lpvg_coeff.words.sample_period_us;
}

}  // namespace isolation_test
