// The wealth of a life, against the Python package's (golden_life.hpp).
#include "../catch.hpp"

#include <algorithm>
#include <cmath>
#include <cstring>
#include <limits>

#include "monitor/crc32.hpp"
#include "golden_life.hpp"

namespace {

uint32_t bits(float x) {
    uint32_t word;
    std::memcpy(&word, &x, sizeof word);
    return word;
}

struct Bytes {
    uint8_t of[LPVG_LIFE_BYTES];
};

Bytes saved(const lpvg_life_t& life) {
    Bytes bytes{};
    REQUIRE(lpvg_life_save(&life, bytes.of) == lpvg_status_ok);
    return bytes;
}

lpvg_life_t begun(const lpvg_life_table_t& table) {
    lpvg_life_t life{};
    REQUIRE(lpvg_life_init(&life, &table) == lpvg_status_ok);
    return life;
}

lpvg_life_table_t sealed(lpvg_life_table_t table) {
    uint32_t crc = lpvguard::crc32_start;
    for (std::size_t i = 0; i + 1U < sizeof table / 4U; ++i) {
        crc = lpvguard::crc32_word(crc, lpvguard::item_at<uint32_t>(table, i));
    }
    table.crc32 = ~crc;
    return table;
}

// Bytes with a CRC that fits, low byte first.
Bytes sealed(Bytes bytes) {
    uint32_t crc = lpvguard::crc32_start;
    for (std::size_t i = 0; i + 4U < LPVG_LIFE_BYTES; i += 4U) {
        uint32_t word = 0U;
        for (std::size_t k = 0; k < 4U; ++k) {
            word |= static_cast<uint32_t>(bytes.of[i + k]) << (8U * k);
        }
        crc = lpvguard::crc32_word(crc, word);
    }
    for (std::size_t k = 0; k < 4U; ++k) {
        bytes.of[LPVG_LIFE_BYTES - 4U + k] = static_cast<uint8_t>(~crc >> (8U * k));
    }
    return bytes;
}

template <std::size_t N>
void follows(const lpvg_life_table_t& table, const GoldenStep (&golden)[N], bool cut) {
    lpvg_life_t life = begun(table);
    CHECK(lpvg_life_wealth(&life) == 1.0f);
    for (const GoldenStep& step : golden) {
        REQUIRE(lpvg_life_update(&life, step.score) == lpvg_status_ok);
        REQUIRE(bits(lpvg_life_wealth(&life)) == step.wealth);
        for (std::size_t i = 0; i < LPVG_LIFE_BETS; ++i) {
            REQUIRE(bits(life.bet[i]) == step.bet[i]);
        }
        REQUIRE(life.changed_at == step.changed_at);
        REQUIRE(lpvg_life_changed(&life) == (step.changed_at > 0U));
        if (cut) {
            const Bytes bytes = saved(life);
            std::memset(static_cast<void*>(&life), 0xA5, sizeof life);
            REQUIRE(lpvg_life_load(&life, &table, bytes.of) == lpvg_status_ok);
        }
    }
    CHECK(life.recordings == N);
}

}  // namespace

TEST_CASE("a life has the bits of the Python package's, also across power-off", "[unit][REQ-LIFE-1][REQ-LIFE-3]") {
    const bool cut = GENERATE(false, true);
    follows(golden_table_11, golden_life_11, cut);
    follows(golden_table_100, golden_life_100, cut);
    follows(golden_table_400, golden_life_400, cut);
    CHECK(golden_life_11[399].changed_at > 0U);
    CHECK(golden_life_400[399].changed_at == 0U);
}

TEST_CASE("one level or recording more than there can be is refused, and so is every bet that is no number",
          "[unit][REQ-LIFE-2][REQ-LIFE-3]") {
    lpvg_life_table_t table = golden_table_100;
    table.n_levels = LPVG_LIFE_LEVELS + 1U;
    table = sealed(table);
    CHECK(lpvg_life_table_check(&table) == lpvg_status_bad_value);
    lpvg_life_t life = begun(golden_table_100);
    const auto loaded = [&](std::size_t word, uint32_t value) {
        Bytes bytes = saved(begun(golden_table_100));
        for (std::size_t k = 0; k < 4U; ++k) {
            bytes.of[4U * word + k] = static_cast<uint8_t>(value >> (8U * k));
        }
        return lpvg_life_load(&life, &golden_table_100, sealed(bytes).of);
    };
    CHECK(loaded(1U, LPVG_LIFE_MOST) == lpvg_status_ok);
    CHECK(loaded(1U, LPVG_LIFE_MOST + 1U) == lpvg_status_bad_value);
    constexpr std::size_t changed_at = LPVG_LIFE_BYTES / 4U - 2U;
    CHECK(loaded(changed_at, 0U) == lpvg_status_ok);
    CHECK(loaded(changed_at, 1U) == lpvg_status_bad_value);  // after the last recording, of none
    for (std::size_t i = 0; i < LPVG_LIFE_BETS; ++i) {
        CHECK(loaded(2U + i, bits(std::numeric_limits<float>::quiet_NaN())) == lpvg_status_bad_value);
    }
}

TEST_CASE("a table that cannot be is refused by what is wrong", "[unit][REQ-LIFE-2]") {
    lpvg_life_table_t table = golden_table_100;
    lpvg_life_t life = begun(golden_table_11);
    const Bytes before = saved(life);
    const auto refused = [&](lpvg_status_t why) {
        CHECK(lpvg_life_table_check(&table) == why);
        CHECK(lpvg_life_init(&life, &table) == why);
        CHECK(lpvg_life_load(&life, &table, before.of) == why);
        CHECK(std::memcmp(saved(life).of, before.of, sizeof before.of) == 0);
        table = golden_table_100;
    };
    CHECK(lpvg_life_table_check(&table) == lpvg_status_ok);
    table.magic ^= 1U;
    refused(lpvg_status_bad_magic);
    table.schema += 1U;
    refused(lpvg_status_bad_schema);
    for (std::size_t bit = 64U; bit < 8U * sizeof table; ++bit) {  // behind magic and schema
        reinterpret_cast<unsigned char*>(&table)[bit / 8U] ^= static_cast<unsigned char>(1U << (bit % 8U));
        CHECK(lpvg_life_table_check(&table) == lpvg_status_bad_crc);
        table = golden_table_100;
    }
    const float inf = std::numeric_limits<float>::infinity();
    for (float* number : {&table.judged_s, &table.alarm, &table.level[7], &table.factor[0][0], &table.factor[8][2]}) {
        *number = inf;
        table = sealed(table);
        refused(lpvg_status_not_finite);
    }
    const auto not_allowed = [&] {
        table = sealed(table);
        refused(lpvg_status_bad_value);
    };
    table.n_levels = 0U;
    not_allowed();
    table.n_levels = LPVG_LIFE_LEVELS + 1U;
    not_allowed();
    table.alarm = 1.0f;
    not_allowed();
    for (std::size_t i = 1; i < golden_table_100.n_levels; ++i) {
        table.level[i] = table.level[i - 1U] - 0.01f;
        not_allowed();
    }
    for (auto& factors : table.factor) {
        for (float& factor : factors) {
            factor = -0.01f;
            not_allowed();
        }
    }
    table.level[1] = table.level[0];  // the last that is allowed
    table.factor[0][0] = 0.0f;
    table = sealed(table);
    CHECK(lpvg_life_table_check(&table) == lpvg_status_ok);
    table.n_levels = 1U;
    table = sealed(table);
    CHECK(lpvg_life_table_check(&table) == lpvg_status_ok);
}

TEST_CASE("a life alarms with the wealth that is stated, with the first recording too", "[unit][REQ-LIFE-1]") {
    lpvg_life_table_t table = golden_table_100;
    lpvg_life_t life = begun(golden_table_100);
    REQUIRE(lpvg_life_update(&life, 1e6f) == lpvg_status_ok);
    table.alarm = lpvg_life_wealth(&life);
    REQUIRE(table.alarm > 1.0f);
    table = sealed(table);
    std::memset(static_cast<void*>(&life), 0xA5, sizeof life);
    REQUIRE(lpvg_life_init(&life, &table) == lpvg_status_ok);
    REQUIRE(lpvg_life_update(&life, 1e6f) == lpvg_status_ok);
    CHECK(life.changed_at == 1U);
    CHECK(lpvg_life_changed(&life));
    table.alarm = std::nextafter(table.alarm, 2.0f * table.alarm);
    table = sealed(table);
    life = begun(table);
    REQUIRE(lpvg_life_update(&life, 1e6f) == lpvg_status_ok);
    CHECK_FALSE(lpvg_life_changed(&life));
}

TEST_CASE("a flipped bit of what is saved, or of the life, is refused", "[unit][REQ-LIFE-3]") {
    lpvg_life_t life = begun(golden_table_100);
    for (const GoldenStep& step : golden_life_100) {
        REQUIRE(lpvg_life_update(&life, step.score) == lpvg_status_ok);
    }
    const Bytes good = saved(life);
    lpvg_life_t other = begun(golden_table_100);
    const Bytes fresh = saved(other);
    for (std::size_t bit = 0; bit < 8U * LPVG_LIFE_BYTES; ++bit) {
        Bytes flipped = good;
        flipped.of[bit / 8U] = static_cast<uint8_t>(flipped.of[bit / 8U] ^ (1U << (bit % 8U)));
        CHECK(lpvg_life_load(&other, &golden_table_100, flipped.of) == lpvg_status_bad_crc);
        if (bit < 32U) {  // with a CRC that fits: of another table
            CHECK(lpvg_life_load(&other, &golden_table_100, sealed(flipped).of) == lpvg_status_bad_value);
        }
    }
    CHECK(lpvg_life_load(&other, &golden_table_11, good.of) == lpvg_status_bad_value);
    Bytes impossible = good;
    impossible.of[7] = 0xFFU;  // more recordings than are counted
    CHECK(lpvg_life_load(&other, &golden_table_100, sealed(impossible).of) == lpvg_status_bad_value);
    impossible = good;
    impossible.of[23] = 0x01U;  // changed after the last
    CHECK(lpvg_life_load(&other, &golden_table_100, sealed(impossible).of) == lpvg_status_bad_value);
    impossible = good;
    impossible.of[10] = 0x80U;  // infinity
    impossible.of[11] = 0x7FU;
    impossible.of[8] = impossible.of[9] = 0U;
    CHECK(lpvg_life_load(&other, &golden_table_100, sealed(impossible).of) == lpvg_status_bad_value);
    CHECK(std::memcmp(saved(other).of, fresh.of, sizeof fresh.of) == 0);

    life.bet[1] *= 2.0f;
    Bytes untouched = good;
    CHECK(lpvg_life_update(&life, 0.1f) == lpvg_status_bad_crc);
    CHECK(lpvg_life_save(&life, untouched.of) == lpvg_status_bad_crc);
    CHECK(std::memcmp(untouched.of, good.of, sizeof good.of) == 0);
}

TEST_CASE("what cannot be is refused and nothing is counted", "[unit][REQ-LIFE-4]") {
    lpvg_life_t life{};
    uint8_t bytes[LPVG_LIFE_BYTES] = {};
    CHECK(lpvg_life_table_check(nullptr) == lpvg_status_bad_argument);
    CHECK(lpvg_life_init(nullptr, &golden_table_11) == lpvg_status_bad_argument);
    CHECK(lpvg_life_init(&life, nullptr) == lpvg_status_bad_argument);
    CHECK(lpvg_life_update(nullptr, 0.0f) == lpvg_status_bad_argument);
    CHECK(lpvg_life_update(&life, 0.0f) == lpvg_status_not_ready);
    CHECK(lpvg_life_save(&life, bytes) == lpvg_status_not_ready);
    CHECK(lpvg_life_save(nullptr, bytes) == lpvg_status_bad_argument);
    CHECK(lpvg_life_wealth(nullptr) == 0.0f);
    CHECK(lpvg_life_wealth(&life) == 0.0f);
    CHECK_FALSE(lpvg_life_changed(nullptr));
    life.changed_at = 1U;
    CHECK_FALSE(lpvg_life_changed(&life));
    life = begun(golden_table_11);
    CHECK(lpvg_life_save(&life, nullptr) == lpvg_status_bad_argument);
    CHECK(lpvg_life_load(nullptr, &golden_table_11, bytes) == lpvg_status_bad_argument);
    CHECK(lpvg_life_load(&life, nullptr, bytes) == lpvg_status_bad_argument);
    CHECK(lpvg_life_load(&life, &golden_table_11, nullptr) == lpvg_status_bad_argument);
    const float inf = std::numeric_limits<float>::infinity();
    for (const float score : {inf, -inf, std::numeric_limits<float>::quiet_NaN(), -0.1f}) {
        CHECK(lpvg_life_update(&life, score) == lpvg_status_bad_sample);
    }
    CHECK(life.recordings == 0U);
    CHECK(lpvg_life_update(&life, 0.0f) == lpvg_status_ok);
    CHECK(life.recordings == 1U);
}

TEST_CASE("counts saturate and no wealth is infinite", "[unit][REQ-LIFE-4]") {
    lpvg_life_t life = begun(golden_table_400);
    for (int k = 0; k < 1000; ++k) {
        REQUIRE(lpvg_life_update(&life, 1e6f) == lpvg_status_ok);
    }
    CHECK(std::isfinite(lpvg_life_wealth(&life)));
    CHECK(lpvg_life_wealth(&life) > 1e30f);
    life = begun(golden_table_400);
    Bytes late = saved(life);
    const uint32_t almost = LPVG_LIFE_MOST - 1U;
    for (std::size_t k = 0; k < 4U; ++k) {
        late.of[4U + k] = static_cast<uint8_t>(almost >> (8U * k));
    }
    REQUIRE(lpvg_life_load(&life, &golden_table_400, sealed(late).of) == lpvg_status_ok);
    REQUIRE(lpvg_life_update(&life, 0.0f) == lpvg_status_ok);
    CHECK(life.recordings == LPVG_LIFE_MOST);
    const float wealth = lpvg_life_wealth(&life);
    const Bytes last = saved(life);
    REQUIRE(lpvg_life_load(&life, &golden_table_400, last.of) == lpvg_status_ok);
    REQUIRE(lpvg_life_update(&life, 0.0f) == lpvg_status_ok);
    CHECK(life.recordings == LPVG_LIFE_MOST);
    CHECK(lpvg_life_wealth(&life) <= wealth);
}

TEST_CASE("the CRC is that of ISO-HDLC, low byte first, of words of either size", "[unit][REQ-LIFE-2]") {
    // "12345678" has 9AE0DAAF.
    const uint32_t halves = lpvguard::crc32_word(lpvguard::crc32_word(lpvguard::crc32_start, uint32_t{0x34333231U}), uint32_t{0x38373635U});
    CHECK(~halves == 0x9AE0DAAFU);
    CHECK(~lpvguard::crc32_word(lpvguard::crc32_start, uint64_t{0x3837363534333231U}) == 0x9AE0DAAFU);
}

TEST_CASE("a table with more levels than there is room for is refused, whatever stands behind them", "[unit][REQ-LIFE-2]") {
    lpvg_life_table_t table = golden_table_100;
    std::fill(std::begin(table.level), std::end(table.level), 0.0f);
    table.n_levels = LPVG_LIFE_LEVELS;
    table = sealed(table);
    CHECK(lpvg_life_table_check(&table) == lpvg_status_ok);
    table.n_levels = LPVG_LIFE_LEVELS + 1U;
    table = sealed(table);
    CHECK(lpvg_life_table_check(&table) == lpvg_status_bad_value);
}

TEST_CASE("a table is good though its CRC, read as a float, is no number", "[unit][REQ-LIFE-2]") {
    lpvg_life_table_t table = golden_table_100;
    for (uint32_t calibrated = 0U; (table.crc32 & 0x7F800000U) != 0x7F800000U; ++calibrated) {
        REQUIRE(calibrated < 100'000U);
        table.calibrated = calibrated;
        table = sealed(table);
    }
    CHECK(lpvg_life_table_check(&table) == lpvg_status_ok);
}
