// acceptance.hpp -- what every coefficient struct of the core has in common: 32-bit words, then numbers, under one CRC.
#pragma once

#include <cmath>
#include <cstddef>
#include <cstdint>
#include <cstring>
#include <type_traits>

#include "lpvguard/config.h"

namespace lpvguard {

static_assert(sizeof(lpvg_real_t) == 4U || sizeof(lpvg_real_t) == 8U, "float or double");

inline uint32_t crc32_byte(uint32_t crc, uint32_t byte) {
    crc ^= byte;
    for (int bit = 0; bit < 8; ++bit) {
        crc = (crc >> 1U) ^ ((crc & 1U) != 0U ? 0xEDB88320U : 0U);
    }
    return crc;
}

// Least significant byte first whatever the target's byte order.
template <class Word>
uint32_t crc32_word(uint32_t crc, Word word) {
    for (std::size_t i = 0; i < sizeof(Word); ++i) {
        crc = crc32_byte(crc, static_cast<uint32_t>((word >> (8U * i)) & 0xFFU));
    }
    return crc;
}

// Item i of a struct that consists of Items only.
template <class Item, class Struct>
Item item_at(const Struct& all, std::size_t i) {
    static_assert(std::is_standard_layout<Struct>::value && sizeof(Struct) % sizeof(Item) == 0U, "walked as items");
    Item value;
    std::memcpy(&value, reinterpret_cast<const unsigned char*>(&all) + i * sizeof value, sizeof value);
    return value;
}

// CRC-32 (ISO-HDLC) over coeff.words, its crc32 read as zero, and coeff.reals.
template <class Coeff>
uint32_t coefficients_crc32(const Coeff& coeff) {
    using Bits = std::conditional_t<sizeof(lpvg_real_t) == 4U, uint32_t, uint64_t>;
    constexpr std::size_t crc_word = offsetof(decltype(coeff.words), crc32) / sizeof(uint32_t);
    uint32_t crc = 0xFFFFFFFFU;
    for (std::size_t i = 0; i < sizeof coeff.words / sizeof(uint32_t); ++i) {
        crc = crc32_word(crc, i == crc_word ? 0U : item_at<uint32_t>(coeff.words, i));
    }
    for (std::size_t i = 0; i < sizeof coeff.reals / sizeof(Bits); ++i) {
        crc = crc32_word(crc, item_at<Bits>(coeff.reals, i));
    }
    return ~crc;
}

// Whether a condition holds for a number, or for every number of an array of any rank.
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
