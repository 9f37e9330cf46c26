// crc32.hpp -- CRC-32 (ISO-HDLC) over structs that are walked as items.
#pragma once

#include <cstddef>
#include <cstdint>
#include <cstring>
#include <type_traits>

namespace lpvguard {

// Entry n is the remainder of n * x^4. With half a byte at a time, the table only needs 64 bytes.
struct Crc32Table {
    uint32_t entry[16];
    constexpr Crc32Table() : entry() {
        uint32_t n = 0U;
        for (uint32_t& remainder : entry) {
            remainder = n;
            for (int bit = 0; bit < 4; ++bit) {
                remainder = (remainder >> 1U) ^ ((remainder & 1U) != 0U ? 0xEDB88320U : 0U);
            }
            ++n;
        }
    }
};
inline constexpr Crc32Table crc32_table;

// Processes a byte that has already been added to crc.
inline uint32_t crc32_taken(uint32_t crc) {
    crc = (crc >> 4U) ^ crc32_table.entry[crc & 0xFU];
    return (crc >> 4U) ^ crc32_table.entry[crc & 0xFU];
}

// Processes a word with its least significant byte first, for every byte order of the target. It adds 32 bits to crc at once.
template <class Word>
uint32_t crc32_word(uint32_t crc, Word word) {
    for (std::size_t taken = 0; taken < 8U * sizeof(Word); taken += 32U) {
        crc ^= static_cast<uint32_t>(word >> taken);
        for (int byte = 0; byte < 4; ++byte) {
            crc = crc32_taken(crc);
        }
    }
    return crc;
}

// Returns item i of a struct that consists only of Items.
template <class Item, class Struct>
Item item_at(const Struct& all, std::size_t i) {
    static_assert(std::is_standard_layout<Struct>::value && sizeof(Struct) % sizeof(Item) == 0U, "walked as items");
    Item value;
    std::memcpy(&value, reinterpret_cast<const unsigned char*>(&all) + i * sizeof value, sizeof value);
    return value;
}

constexpr uint32_t crc32_start = 0xFFFFFFFFU;

}  // namespace lpvguard
