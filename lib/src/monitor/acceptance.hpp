// acceptance.hpp -- common form of the core's coefficient structs: 32-bit words, then numbers, with one CRC.
#pragma once

#include <cmath>
#include <cstddef>
#include <cstdint>
#include <type_traits>

#include "crc32.hpp"
#include "lpvguard/config.h"

namespace lpvguard {

static_assert(sizeof(lpvg_real_t) == 4U || sizeof(lpvg_real_t) == 8U, "float or double");

// Number of words and numbers in a struct of coefficients.
template <class Coeff>
constexpr std::size_t n_items = sizeof(Coeff::words) / sizeof(uint32_t) + sizeof(Coeff::reals) / sizeof(lpvg_real_t);

// Continues a CRC-32 (ISO-HDLC) over coeff.words and coeff.reals, from item `first` to before `end`. The word crc32 reads as zero.
template <class Coeff>
uint32_t crc32_items(uint32_t crc, const Coeff& coeff, std::size_t first, std::size_t end) {
    using Bits = std::conditional_t<sizeof(lpvg_real_t) == 4U, uint32_t, uint64_t>;
    constexpr std::size_t n_words = sizeof coeff.words / sizeof(uint32_t);
    constexpr std::size_t crc_word = offsetof(decltype(coeff.words), crc32) / sizeof(uint32_t);
    for (std::size_t i = first; i < end; ++i) {
        if (i < n_words) {
            crc = crc32_word(crc, i == crc_word ? 0U : item_at<uint32_t>(coeff.words, i));
        } else {
            crc = crc32_word(crc, item_at<Bits>(coeff.reals, i - n_words));
        }
    }
    return crc;
}

template <class Coeff>
uint32_t coefficients_crc32(const Coeff& coeff) {
    return ~crc32_items(crc32_start, coeff, 0U, n_items<Coeff>);
}

// Sum of the words of a plain struct or array. One flipped bit changes it. The loop adds four words per turn, to save time.
template <class Items>
uint32_t sum_of_words(const Items& items) {
    constexpr std::size_t n_bytes = sizeof(Items), n = n_bytes / sizeof(uint32_t), n_fours = n / 4U;
    uint32_t sum = 0U;
    for (std::size_t k = 0; k < n_fours; ++k) {
        const std::size_t i = 4U * k;
        sum += item_at<uint32_t>(items, i) + item_at<uint32_t>(items, i + 1U) + item_at<uint32_t>(items, i + 2U) +
               item_at<uint32_t>(items, i + 3U);
    }
    for (std::size_t i = 4U * n_fours; i < n; ++i) {
        sum += item_at<uint32_t>(items, i);
    }
    return sum;
}

// Tells if a condition holds for a number, or for every number of an array of any rank.
template <class Items, class Condition>
bool every(const Items& items, Condition holds) {
    if constexpr (std::is_array<Items>::value) {
        for (const auto& item : items) {
            if (!every(item, holds)) {
                return false;
            }
        }
        return true;
    } else {
        return holds(items);
    }
}

template <class Reals>
bool all_finite(const Reals& reals) {
    for (std::size_t i = 0; i < sizeof reals / sizeof(lpvg_real_t); ++i) {
        if (!std::isfinite(item_at<lpvg_real_t>(reals, i))) {
            return false;
        }
    }
    return true;
}

}  // namespace lpvguard
