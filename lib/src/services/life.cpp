// life.cpp -- see life.h.
//
// No product is added to anything, so that no compiler can contract the two. Python has the same operations
// (tools/src/lpvguard/extras/fleet).
#include "lpvguard/life.h"

#include <cmath>
#include <cstring>

#include "monitor/crc32.hpp"

namespace {

constexpr std::size_t n_bytes = LPVG_LIFE_BYTES, n_word = sizeof(uint32_t), n_saved = n_bytes / n_word;
constexpr float ceiling = 1e30F;
static_assert(sizeof(lpvg_life_table_t) % n_word == 0U, "walked as words");
static_assert(sizeof(float) == n_word, "a float is a word");

// What is saved: the table's CRC, the life, and their CRC.
struct Saved {
    uint32_t word[n_saved];
};

uint32_t crc_of(const Saved& saved) {
    uint32_t crc = lpvguard::crc32_start;
    for (std::size_t i = 0; i + 1U < n_saved; ++i) {
        crc = lpvguard::crc32_word(crc, saved.word[i]);
    }
    return ~crc;
}

uint32_t crc_of(const lpvg_life_table_t& table) {
    uint32_t crc = lpvguard::crc32_start;
    for (std::size_t i = 0; i + 1U < sizeof table / n_word; ++i) {
        crc = lpvguard::crc32_word(crc, lpvguard::item_at<uint32_t>(table, i));
    }
    return ~crc;
}

Saved saved_of(const lpvg_life_t& life) {
    Saved saved{};
    saved.word[0] = life.table->crc32;
    saved.word[1] = life.recordings;
    saved.word[n_saved - 2U] = life.changed_at;
    static_assert(n_saved == LPVG_LIFE_BETS + 4U, "table, recordings, bets, changed, CRC");
    std::memcpy(&saved.word[2], life.bet, sizeof life.bet);
    saved.word[n_saved - 1U] = crc_of(saved);
    return saved;
}

bool all_finite(const float* x, std::size_t n) {
    std::size_t good = 0U;
    while (good < n && std::isfinite(x[good])) {
        ++good;
    }
    return good == n;
}

bool allowed(const lpvg_life_table_t& table) {
    bool good = table.n_levels >= 1U && table.n_levels <= LPVG_LIFE_LEVELS && table.alarm > 1.0F;
    for (std::size_t i = 1U; good && i < table.n_levels; ++i) {
        good = table.level[i - 1U] <= table.level[i];
    }
    for (std::size_t i = 0U; good && i < (LPVG_LIFE_LEVELS + 1U) * LPVG_LIFE_BETS; ++i) {
        good = table.factor[i / LPVG_LIFE_BETS][i % LPVG_LIFE_BETS] >= 0.0F;
    }
    return good;
}

// Share of the money that is not on the bets after so many recordings, LPVG_LIFE_MOST at most.
float put_aside(uint32_t recordings) {
    constexpr float start = static_cast<float>(LPVG_LIFE_START);
    return start / (start + static_cast<float>(recordings));
}

float wealth_of(const lpvg_life_t& life) {
    float whole = life.bet[0];
    for (std::size_t i = 1U; i < LPVG_LIFE_BETS; ++i) {
        whole = whole + life.bet[i];
    }
    return whole + put_aside(life.recordings);
}

// Whether an object may be used: initialised, and as the last call left it.
lpvg_status_t usable(const lpvg_life_t* life) {
    if (life == nullptr) {
        return lpvg_status_bad_argument;
    }
    if (life->table == nullptr) {
        return lpvg_status_not_ready;
    }
    return saved_of(*life).word[n_saved - 1U] == life->crc32 ? lpvg_status_ok : lpvg_status_bad_crc;
}

}  // namespace

extern "C" lpvg_status_t lpvg_life_table_check(const lpvg_life_table_t* table) {
    if (table == nullptr) {
        return lpvg_status_bad_argument;
    }
    if (table->magic != LPVG_LIFE_MAGIC) {
        return lpvg_status_bad_magic;
    }
    if (table->schema != LPVG_LIFE_SCHEMA) {
        return lpvg_status_bad_schema;
    }
    if (table->crc32 != crc_of(*table)) {
        return lpvg_status_bad_crc;
    }
    if (!std::isfinite(table->judged_s) || !std::isfinite(table->alarm) || !all_finite(table->level, LPVG_LIFE_LEVELS) ||
        !all_finite(table->factor[0], (LPVG_LIFE_LEVELS + 1U) * LPVG_LIFE_BETS)) {
        return lpvg_status_not_finite;
    }
    return allowed(*table) ? lpvg_status_ok : lpvg_status_bad_value;
}

extern "C" lpvg_status_t lpvg_life_init(lpvg_life_t* self, const lpvg_life_table_t* table) {
    const lpvg_status_t status = lpvg_life_table_check(table);
    if (self == nullptr || status != lpvg_status_ok) {
        return self == nullptr ? lpvg_status_bad_argument : status;
    }
    *self = lpvg_life_t{};
    self->table = table;
    self->crc32 = saved_of(*self).word[n_saved - 1U];
    return lpvg_status_ok;
}

extern "C" lpvg_status_t lpvg_life_update(lpvg_life_t* self, float score) {
    const lpvg_status_t status = usable(self);
    if (status != lpvg_status_ok) {
        return status;
    }
    if (!(std::isfinite(score) && score >= 0.0F)) {
        return lpvg_status_bad_sample;
    }
    const lpvg_life_table_t& table = *self->table;
    std::size_t place = 0U;
    while (place < table.n_levels && table.level[place] < score) {
        ++place;
    }
    const uint32_t next = self->recordings < LPVG_LIFE_MOST ? self->recordings + 1U : LPVG_LIFE_MOST;
    const float added = (put_aside(self->recordings) - put_aside(next)) / static_cast<float>(LPVG_LIFE_BETS);
    for (std::size_t i = 0U; i < LPVG_LIFE_BETS; ++i) {
        const float wealth = (self->bet[i] + added) * table.factor[place][i];
        self->bet[i] = wealth < ceiling ? wealth : ceiling;
    }
    self->recordings = next;
    if (self->changed_at == 0U && wealth_of(*self) >= table.alarm) {
        self->changed_at = next;
    }
    self->crc32 = saved_of(*self).word[n_saved - 1U];
    return lpvg_status_ok;
}

extern "C" float lpvg_life_wealth(const lpvg_life_t* self) { return self == nullptr || self->table == nullptr ? 0.0F : wealth_of(*self); }

extern "C" bool lpvg_life_changed(const lpvg_life_t* self) { return self != nullptr && self->table != nullptr && self->changed_at > 0U; }

extern "C" lpvg_status_t lpvg_life_save(const lpvg_life_t* self, uint8_t bytes[LPVG_LIFE_BYTES]) {
    const lpvg_status_t status = usable(self);
    if (bytes == nullptr || status != lpvg_status_ok) {
        return bytes == nullptr ? lpvg_status_bad_argument : status;
    }
    const Saved saved = saved_of(*self);
    for (std::size_t i = 0U; i < n_bytes; ++i) {
        bytes[i] = static_cast<uint8_t>((saved.word[i / n_word] >> (8U * (i % n_word))) & 0xFFU);
    }
    return lpvg_status_ok;
}

extern "C" lpvg_status_t lpvg_life_load(lpvg_life_t* self, const lpvg_life_table_t* table, const uint8_t bytes[LPVG_LIFE_BYTES]) {
    const lpvg_status_t status = lpvg_life_table_check(table);
    if (self == nullptr || bytes == nullptr || status != lpvg_status_ok) {
        return self == nullptr || bytes == nullptr ? lpvg_status_bad_argument : status;
    }
    Saved saved{};
    for (std::size_t i = 0U; i < n_bytes; ++i) {
        saved.word[i / n_word] |= static_cast<uint32_t>(bytes[i]) << (8U * (i % n_word));
    }
    if (saved.word[n_saved - 1U] != crc_of(saved)) {
        return lpvg_status_bad_crc;
    }
    lpvg_life_t life{};
    life.table = table;
    life.recordings = saved.word[1];
    std::memcpy(life.bet, &saved.word[2], sizeof life.bet);
    life.changed_at = saved.word[n_saved - 2U];
    life.crc32 = saved.word[n_saved - 1U];
    if (saved.word[0] != table->crc32 || life.recordings > LPVG_LIFE_MOST || life.changed_at > life.recordings ||
        !all_finite(life.bet, LPVG_LIFE_BETS)) {
        return lpvg_status_bad_value;
    }
    *self = life;
    return lpvg_status_ok;
}
