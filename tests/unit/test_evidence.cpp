// The ring of samples around alarms: what is kept, its bytes, and what power-off and changed bits do to it.
#include "../catch.hpp"

#include <algorithm>
#include <cmath>
#include <cstring>
#include <limits>
#include <random>
#include <vector>

#include "lpvguard/evidence.h"

namespace {

constexpr uint32_t samples = 100U, after = 30U, channels = 4U;
constexpr int64_t period_us = 10'000;

struct Ring {
    std::vector<int16_t> buffer;
    lpvg_evidence_config_t config{};
    lpvg_evidence_t object{};
    int64_t k = 0;

    explicit Ring(uint8_t slots = 3U) : buffer(slots * samples * channels) {
        config = {buffer.data(), samples, after, period_us, 0xC0FFEEU, 0.5f, {0.01f, 0.5f, 2.0f, 0.25f}, channels, 1U, slots};
        REQUIRE(lpvg_evidence_init(&object, &config) == lpvg_status_ok);
    }

    // Takes n samples; every channel has the number of the sample, in bits.
    void take(int n, lpvg_evidence_level_t level = lpvg_evidence_none, float ratio = 0.0f) {
        for (int i = 0; i < n; ++i, ++k) {
            float values[channels];
            for (std::size_t c = 0; c < channels; ++c) {
                values[c] = static_cast<float>(k % 1000) * config.scale[c];
            }
            REQUIRE(lpvg_evidence_take(&object, k * period_us, values, level, ratio) == lpvg_status_ok);
        }
    }

    // An event of a level after which the ring is frozen.
    uint32_t record(lpvg_evidence_level_t level, float ratio) {
        const uint32_t before = object.numbered;
        take(samples);
        take(1, level, ratio);
        take(after);
        return object.numbered == before + 1U ? object.numbered : 0U;
    }

    std::vector<uint8_t> bytes(uint32_t number, std::size_t piece = 7U) const {
        lpvg_evidence_reader_t reader{};
        REQUIRE(lpvg_evidence_open(&reader, &object, number) == lpvg_status_ok);
        std::vector<uint8_t> all(reader.size + 10U, 0xAAU);
        std::size_t n = 0;
        for (std::size_t got = 1U; got > 0U; n += got) {
            got = lpvg_evidence_read(&reader, &all[n], std::min(piece, all.size() - n));
        }
        REQUIRE(n == reader.size);
        all.resize(n);
        return all;
    }
};

uint32_t word(const std::vector<uint8_t>& bytes, std::size_t at) {
    return bytes[at] | static_cast<uint32_t>(bytes[at + 1]) << 8 | static_cast<uint32_t>(bytes[at + 2]) << 16 |
           static_cast<uint32_t>(bytes[at + 3]) << 24;
}

int16_t value(const std::vector<uint8_t>& bytes, uint32_t sample, uint32_t channel) {
    const std::size_t at = LPVG_EVIDENCE_HEADER + 2U * (sample * channels + channel);
    return static_cast<int16_t>(static_cast<uint16_t>(bytes[at] | bytes[at + 1] << 8));
}

// CRC-32 bit by bit.
uint32_t crc(const std::vector<uint8_t>& bytes, std::size_t n) {
    uint32_t remainder = 0xFFFFFFFFU;
    for (std::size_t i = 0; i < 8U * n; ++i) {
        const uint32_t bit = (remainder ^ (bytes[i / 8U] >> (i % 8U))) & 1U;
        remainder = (remainder >> 1U) ^ (bit != 0U ? 0xEDB88320U : 0U);
    }
    return ~remainder;
}

// Two areas of memory, and how many bytes can still be written.
struct Memory {
    std::vector<uint8_t> area[2];
    std::size_t left = SIZE_MAX;

    explicit Memory(std::size_t capacity) : area{std::vector<uint8_t>(capacity, 0xFFU), std::vector<uint8_t>(capacity, 0xFFU)} {}

    lpvg_status_t stored(lpvg_evidence_stored_t* found) const {
        return lpvg_evidence_stored(area[0].data(), area[1].data(), area[0].size(), found);
    }

    std::size_t write(const Ring& ring, uint32_t number) {
        lpvg_evidence_stored_t newest{};
        (void)!stored(&newest);
        lpvg_evidence_writer_t writer{};
        REQUIRE(lpvg_evidence_write(&writer, &ring.object, number, &newest) == lpvg_status_ok);
        std::size_t written = 0;
        for (lpvg_evidence_chunk_t chunk; lpvg_evidence_write_next(&writer, &chunk);) {
            REQUIRE(chunk.offset + chunk.size <= area[chunk.area].size());
            const std::size_t n = std::min<std::size_t>(chunk.size, left);
            std::copy_n(chunk.data, n, area[chunk.area].begin() + chunk.offset);
            left -= n;
            written += n;
        }
        CHECK_FALSE(lpvg_evidence_write_next(&writer, nullptr));
        return written;
    }
};

std::size_t capacity_of(const Ring& ring) { return LPVG_EVIDENCE_HEAD + lpvg_evidence_size(&ring.config); }

using Bytes = std::vector<uint8_t>;

}  // namespace

TEST_CASE("an alarm freezes the samples around it", "[unit][REQ-EVID-1]") {
    Ring ring;
    ring.take(250, lpvg_evidence_none, 0.4f);
    ring.take(1, lpvg_evidence_invalid, 1.5f);
    CHECK(lpvg_evidence_number(&ring.object, 0U) == 0U);
    ring.take(after - 1, lpvg_evidence_invalid, 1.75f);
    CHECK(lpvg_evidence_number(&ring.object, 0U) == 0U);
    ring.take(1, lpvg_evidence_invalid, 1.25f);
    REQUIRE(lpvg_evidence_number(&ring.object, 0U) == 1U);
    ring.take(1000, lpvg_evidence_invalid, 9.0f);  // the same alarm: no other record
    CHECK(lpvg_evidence_number(&ring.object, 1U) == 0U);

    const Bytes bytes = ring.bytes(1U);
    CHECK(std::memcmp(bytes.data(), "LPVE", 4) == 0);
    CHECK(word(bytes, 4) == LPVG_EVIDENCE_SCHEMA);
    CHECK(word(bytes, 8) == 1U);
    CHECK(word(bytes, 12) == 0xC0FFEEU);
    CHECK(word(bytes, 16) == 10'000U);
    CHECK(word(bytes, 20) == samples);
    CHECK(word(bytes, 24) == samples - after);
    CHECK((bytes[28] == 3U && bytes[29] == channels && bytes[30] == 1U && bytes[31] == 0U));
    CHECK(word(bytes, 32) == 0x3FE00000U);  // 1.75f
    CHECK(word(bytes, 36) == 2'500'000U);
    CHECK(word(bytes, 40) == 0U);
    CHECK(word(bytes, 48) == 0x3F000000U);  // 0.5f
    CHECK(word(bytes, 60) == 0U);
    REQUIRE(bytes.size() == LPVG_EVIDENCE_HEADER + 2U * samples * channels + 4U);
    CHECK(bytes.size() == lpvg_evidence_size(&ring.config));
    for (uint32_t i = 0; i < samples; ++i) {
        for (uint32_t c = 0; c < channels; ++c) {
            REQUIRE(value(bytes, i, c) == static_cast<int16_t>(181 + i));
        }
    }
    CHECK(word(bytes, bytes.size() - 4U) == crc(bytes, bytes.size() - 4U));
    CHECK(ring.bytes(1U, 64U) == bytes);
    CHECK(ring.bytes(1U, 1U) == bytes);
}

TEST_CASE("a ring that is not full keeps what it has", "[unit][REQ-EVID-1]") {
    Ring ring;
    ring.take(10);
    ring.take(1, lpvg_evidence_degraded, 1.1f);
    ring.take(after);
    const Bytes bytes = ring.bytes(1U);
    CHECK(word(bytes, 20) == 11U + after);
    CHECK(word(bytes, 24) == 11U);
    CHECK(bytes[28] == 2U);
    CHECK(value(bytes, 0U, 3U) == 0);
    CHECK(value(bytes, 10U + after, 3U) == 10 + static_cast<int>(after));
}

TEST_CASE("the largest ratio of a drive is a near alarm, and a higher event takes its place", "[unit][REQ-EVID-2]") {
    Ring ring;
    ring.take(150, lpvg_evidence_none, 0.4f);
    ring.take(2, lpvg_evidence_none, 0.5f);  // the least ratio; the second is no larger one
    ring.take(10, lpvg_evidence_none, 0.3f);
    ring.take(1, lpvg_evidence_near, 0.75f);  // a larger one within the same record
    ring.take(after - 1);
    CHECK(ring.object.numbered == 0U);
    ring.take(1);
    REQUIRE(ring.object.numbered == 1U);
    Bytes bytes = ring.bytes(1U);
    CHECK((bytes[28] == 1U && word(bytes, 32) == 0x3F400000U));
    CHECK(value(bytes, word(bytes, 24) - 1U, 0U) == 162);
    ring.take(200, lpvg_evidence_none, 0.75f);  // no larger one
    CHECK(ring.object.numbered == 1U);
    ring.take(1, lpvg_evidence_none, 0.8f);
    ring.take(5);
    ring.take(1, lpvg_evidence_degraded, 0.7f);
    ring.take(5, lpvg_evidence_degraded, 0.85f);  // neither another edge, nor near beside an alarm
    ring.take(1, lpvg_evidence_invalid, 0.7f);
    ring.take(1, lpvg_evidence_none, 0.8125f);   // a larger ratio of the drive is none
    ring.take(1, lpvg_evidence_none, 0.875f);    // it is, and not near beside the alarm
    ring.take(1, lpvg_evidence_invalid, 0.7f);   // the same level again
    ring.take(1, lpvg_evidence_none, 0.0f);
    ring.take(1, lpvg_evidence_degraded, 0.0f);  // a lower one
    ring.take(after - 5);
    REQUIRE(ring.object.numbered == 2U);
    bytes = ring.bytes(2U);
    CHECK((bytes[28] == 3U && word(bytes, 32) == 0x3F600000U));  // 0.875f
    CHECK(value(bytes, word(bytes, 24) - 1U, 0U) == 405);
    CHECK(lpvg_evidence_number(&ring.object, 0U) == 2U);
    CHECK(lpvg_evidence_number(&ring.object, 1U) == 1U);
    CHECK(lpvg_evidence_number(&ring.object, 2U) == 0U);
}

TEST_CASE("the records that say the most stay", "[unit][REQ-EVID-2]") {
    Ring ring;
    CHECK(ring.record(lpvg_evidence_degraded, 1.2f) == 1U);
    CHECK(ring.record(lpvg_evidence_near, 2.0f) == 2U);
    CHECK(ring.record(lpvg_evidence_degraded, 1.1f) == 3U);  // takes the place of the near one
    CHECK(lpvg_evidence_number(&ring.object, 0U) == 1U);
    CHECK(lpvg_evidence_number(&ring.object, 1U) == 3U);
    CHECK(ring.record(lpvg_evidence_degraded, 1.0f) == 4U);  // says the least itself
    CHECK(lpvg_evidence_number(&ring.object, 1U) == 3U);
    lpvg_evidence_reader_t reader{};
    REQUIRE(lpvg_evidence_open(&reader, &ring.object, 3U) == lpvg_status_ok);
    uint8_t byte = 0U;
    CHECK(lpvg_evidence_read(&reader, &byte, 1U) == 1U);
    CHECK(ring.record(lpvg_evidence_invalid, 1.0f) == 5U);
    CHECK(lpvg_evidence_read(&reader, &byte, 1U) == 0U);  // gone
    CHECK(lpvg_evidence_open(&reader, &ring.object, 3U) == lpvg_status_bad_value);
    CHECK(lpvg_evidence_number(&ring.object, 0U) == 5U);
    CHECK(lpvg_evidence_release(&ring.object, 5U));
    CHECK_FALSE(lpvg_evidence_release(&ring.object, 5U));
    CHECK_FALSE(lpvg_evidence_release(&ring.object, 0U));
    CHECK(lpvg_evidence_number(&ring.object, 0U) == 1U);
    CHECK(ring.record(lpvg_evidence_degraded, 1.0f) == 6U);  // the free slot is the next ring
    CHECK(lpvg_evidence_number(&ring.object, 1U) == 6U);
    ring.object.numbered = UINT32_MAX;
    ring.take(samples);
    ring.take(1, lpvg_evidence_invalid, 3.0f);
    ring.take(after);
    CHECK(lpvg_evidence_number(&ring.object, 0U) == 1U);  // 0 is none
}

TEST_CASE("of equal records the first ranks first", "[unit][REQ-EVID-2]") {
    Ring ring(4U);
    for (int i = 0; i < 3; ++i) {
        ring.record(lpvg_evidence_invalid, 1.5f);
    }
    for (uint32_t rank = 0U; rank < 3U; ++rank) {
        CHECK(lpvg_evidence_number(&ring.object, rank) == rank + 1U);
    }
}

TEST_CASE("the lowest record goes first, an equal one never, and ratios count to eight units of the last place", "[unit][REQ-EVID-2]") {
    Ring ring;
    ring.record(lpvg_evidence_near, 2.0f);
    ring.record(lpvg_evidence_degraded, 1.5f);
    ring.record(lpvg_evidence_degraded, 1.5f);  // in the place of the first
    CHECK((lpvg_evidence_number(&ring.object, 0U) + lpvg_evidence_number(&ring.object, 1U)) == 5U);
    ring.record(lpvg_evidence_degraded, 1.5f);
    CHECK((lpvg_evidence_number(&ring.object, 0U) + lpvg_evidence_number(&ring.object, 1U)) == 5U);
    Ring fine;
    const float unit = std::numeric_limits<float>::epsilon();
    fine.record(lpvg_evidence_degraded, 1.5f);
    fine.record(lpvg_evidence_degraded, 1.5f + 4.0f * unit);
    CHECK(lpvg_evidence_number(&fine.object, 0U) == 1U);
    fine.record(lpvg_evidence_degraded, 1.5f + 8.0f * unit);
    CHECK(lpvg_evidence_number(&fine.object, 0U) == 3U);
}

TEST_CASE("a near alarm needs the ratio of one, and rises alone", "[unit][REQ-EVID-2]") {
    Ring ring;
    ring.take(1, lpvg_evidence_near, 0.25f);
    ring.take(after + 1, lpvg_evidence_none, 0.25f);
    REQUIRE(ring.object.numbered == 0U);
    ring.take(1, lpvg_evidence_none, 0.5f);
    ring.take(after, lpvg_evidence_none, 0.5f);
    REQUIRE(ring.object.numbered == 1U);
    CHECK(word(ring.bytes(1U), 24) == after + 3U);
    ring.take(60, lpvg_evidence_none, 0.375f);
    ring.take(1, lpvg_evidence_invalid, 0.25f);  // what was larger before the event is not the record's
    ring.take(after, lpvg_evidence_invalid, -1.0f);
    CHECK(word(ring.bytes(2U), 32) == 0x3E800000U);
    ring.take(60, lpvg_evidence_degraded, -0.5f);
    REQUIRE(ring.object.numbered == 2U);  // the level fell
    ring.take(1);
    ring.take(after + 1, lpvg_evidence_degraded, -0.5f);
    CHECK(word(ring.bytes(3U), 32) == 0U);
}

TEST_CASE("what a record says is its own configuration", "[unit][REQ-EVID-1]") {
    Ring ring;
    ring.config.inputs = 2U;
    ring.config.scale[channels] = 7.0f;  // of no channel
    REQUIRE(lpvg_evidence_init(&ring.object, &ring.config) == lpvg_status_ok);
    const auto take = [&](lpvg_evidence_level_t level) {
        float values[channels];
        for (std::size_t c = 0; c < channels; ++c) {
            values[c] = static_cast<float>(10U * c + 1U) * ring.config.scale[c];
        }
        REQUIRE(lpvg_evidence_take(&ring.object, ring.k++ * period_us, values, level, 1.0f) == lpvg_status_ok);
    };
    take(lpvg_evidence_invalid);
    for (uint32_t i = 0; i < after; ++i) {
        take(lpvg_evidence_none);
    }
    const Bytes bytes = ring.bytes(1U);
    CHECK(bytes[30] == 2U);
    CHECK(word(bytes, 60) == 0U);
    for (uint32_t c = 0; c < channels; ++c) {
        CHECK(value(bytes, 5U, c) == static_cast<int16_t>(10U * c + 1U));
    }
    REQUIRE(lpvg_evidence_init(&ring.object, &ring.config) == lpvg_status_ok);
    CHECK(lpvg_evidence_number(&ring.object, 0U) == 0U);

    std::vector<int16_t> buffer(3U * samples * LPVG_EVIDENCE_CHANNELS_MAX);
    lpvg_evidence_config_t config = ring.config;
    config.buffer = buffer.data();
    config.channels = LPVG_EVIDENCE_CHANNELS_MAX;
    std::fill(std::begin(config.scale), std::end(config.scale), 0.5f);
    config.period_us = 3U;
    REQUIRE(lpvg_evidence_init(&ring.object, &config) == lpvg_status_ok);
    const float values[LPVG_EVIDENCE_CHANNELS_MAX] = {};
    REQUIRE(lpvg_evidence_take(&ring.object, 0, values, lpvg_evidence_none, 0.0f) == lpvg_status_ok);
    REQUIRE(lpvg_evidence_take(&ring.object, 4, values, lpvg_evidence_none, 0.0f) == lpvg_status_ok);  // no gap
    for (int64_t t = 7; t < 7 + 3 * int64_t{after} + 3; t += 3) {
        REQUIRE(lpvg_evidence_take(&ring.object, t, values, lpvg_evidence_invalid, 1.0f) == lpvg_status_ok);
    }
    const Bytes wide = ring.bytes(1U);
    CHECK(word(wide, 20) == after + 3U);
    CHECK(word(wide, 72) == 0x3F000000U);
}

TEST_CASE("a gap ends a record or empties the ring", "[unit][REQ-EVID-1]") {
    Ring ring;
    ring.take(50);
    ++ring.k;
    ring.take(5);
    ring.take(1, lpvg_evidence_invalid, 1.0f);
    ring.take(3);
    CHECK(ring.object.numbered == 0U);
    ++ring.k;
    ring.take(1);
    REQUIRE(ring.object.numbered == 1U);
    const Bytes bytes = ring.bytes(1U);
    CHECK(word(bytes, 20) == 9U);
    CHECK(word(bytes, 24) == 6U);
    CHECK(ring.object.slot[ring.object.active].count == 1U);
    ring.take(2 * after);  // nothing is pending behind it
    CHECK(ring.object.numbered == 1U);
    ++ring.k;
    ring.take(3);
    ring.take(1, lpvg_evidence_invalid, 1.0f);
    ring.take(after);
    REQUIRE(ring.object.numbered == 2U);
    ring.take(1);
    ring.take(1, lpvg_evidence_invalid, 1.0f);
    ++ring.k;
    ring.take(2 * after);  // two samples since the record before, and three slots
    CHECK(ring.object.numbered == 2U);
    CHECK(ring.object.remaining == 0U);
    ring.take(1, lpvg_evidence_invalid, 1.0f);
    ring.take(after);
    REQUIRE(ring.object.numbered == 3U);
    ring.take(2);
    ring.take(1, lpvg_evidence_invalid, 1.0f);
    ++ring.k;
    ring.take(1);  // three samples
    CHECK(ring.object.numbered == 4U);
    // A step below one and a half periods is none.
    const float values[channels] = {};
    CHECK(lpvg_evidence_take(&ring.object, ring.object.t_us + 14'990, values, lpvg_evidence_none, 0.0f) == lpvg_status_ok);
    CHECK(ring.object.slot[ring.object.active].count == 2U);
    CHECK(lpvg_evidence_take(&ring.object, ring.object.t_us + 15'000, values, lpvg_evidence_none, 0.0f) == lpvg_status_ok);
    CHECK(ring.object.slot[ring.object.active].count == 1U);
    // Over the whole range of the clock.
    CHECK(lpvg_evidence_take(&ring.object, INT64_MAX, values, lpvg_evidence_none, 0.0f) == lpvg_status_ok);
    CHECK(ring.object.slot[ring.object.active].count == 1U);
    CHECK(lpvg_evidence_take(&ring.object, INT64_MAX, values, lpvg_evidence_none, 0.0f) == lpvg_status_out_of_order);
}

TEST_CASE("a gap in the last step of a record, and behind a full ring or a freed slot", "[unit][REQ-EVID-1][REQ-EVID-2]") {
    Ring ring;
    ring.take(150);
    ++ring.k;
    ring.take(10);
    ring.take(1, lpvg_evidence_invalid, 1.0f);
    ring.take(after - 1);
    ++ring.k;
    ring.take(1);
    REQUIRE(ring.object.numbered == 1U);
    const Bytes bytes = ring.bytes(1U);
    CHECK(word(bytes, 20) == 10U + after);
    CHECK(value(bytes, 0U, 0U) == 151);
    CHECK(value(bytes, 9U + after, 0U) == 160 + static_cast<int>(after));
    ring.record(lpvg_evidence_invalid, 1.5f);
    ring.object.remaining = 0U;
    REQUIRE(lpvg_evidence_release(&ring.object, 1U));
    ring.take(1);
    ring.take(1, lpvg_evidence_degraded, 1.0f);
    ++ring.k;
    ring.take(1);  // every slot is known: the freed one is the next ring
    CHECK(lpvg_evidence_number(&ring.object, 0U) == 2U);
    CHECK(lpvg_evidence_number(&ring.object, 1U) == 3U);
}

TEST_CASE("numbers that are none, too large or between bits are kept as defined", "[unit][REQ-EVID-1]") {
    Ring ring;
    ring.config.scale[0] = 1.0f;
    REQUIRE(lpvg_evidence_init(&ring.object, &ring.config) == lpvg_status_ok);
    const float inf = std::numeric_limits<float>::infinity(), nan = std::numeric_limits<float>::quiet_NaN();
    const float rows[][2] = {{nan, -32768.0f},       {inf, 32767.0f},       {-inf, -32767.0f},     {40000.0f, 32767.0f},
                             {-40000.0f, -32767.0f}, {32766.25f, 32766.0f}, {32767.75f, 32767.0f}, {1.5f, 2.0f},
                             {-1.5f, -1.0f},         {1.4f, 1.0f},          {-1.4f, -1.0f},        {0.0f, 0.0f}};
    int64_t t = INT64_MIN;
    for (const auto& row : rows) {
        const float values[channels] = {row[0]};
        REQUIRE(lpvg_evidence_take(&ring.object, t, values, lpvg_evidence_none, nan) == lpvg_status_ok);
        t += period_us;
    }
    const float values[channels] = {};
    REQUIRE(lpvg_evidence_take(&ring.object, t, values, lpvg_evidence_degraded, inf) == lpvg_status_ok);
    for (uint32_t i = 0; i < after; ++i) {
        t += period_us;
        REQUIRE(lpvg_evidence_take(&ring.object, t, values, lpvg_evidence_degraded, 0.0f) == lpvg_status_ok);
    }
    const Bytes bytes = ring.bytes(1U);
    CHECK(word(bytes, 32) == 0U);
    for (uint32_t i = 0; i < std::size(rows); ++i) {
        CHECK(value(bytes, i, 0U) == static_cast<int16_t>(rows[i][1]));
    }
}

TEST_CASE("power that fails at any instant leaves the record before or the new one", "[unit][REQ-EVID-3]") {
    Ring ring;
    ring.record(lpvg_evidence_invalid, 1.5f);
    ring.record(lpvg_evidence_invalid, 1.6f);
    const Bytes old = ring.bytes(1U), fresh = ring.bytes(2U);
    Memory memory(capacity_of(ring));
    lpvg_evidence_stored_t found{};
    CHECK(memory.stored(&found) == lpvg_status_bad_crc);
    CHECK(found.record == nullptr);
    memory.write(ring, 1U);
    REQUIRE(memory.stored(&found) == lpvg_status_ok);
    CHECK((found.area == 0U && found.sequence == 1U && found.size == old.size()));
    Memory whole = memory;
    const std::size_t all = whole.write(ring, 2U);
    std::mt19937 random(59U);
    std::uniform_int_distribution<std::size_t> instant(0U, all - 1U);
    std::size_t seen_old = 0U;
    for (int i = 0; i < 200; ++i) {
        Memory cut = memory;
        cut.left = i == 0 ? all - 1U : instant(random);
        cut.write(ring, 2U);
        REQUIRE(cut.stored(&found) == lpvg_status_ok);
        const Bytes kept(found.record, found.record + found.size);
        REQUIRE((kept == old || kept == fresh));
        seen_old += kept == old ? 1U : 0U;
        cut.left = SIZE_MAX;  // with power again the writing succeeds
        cut.write(ring, 2U);
        REQUIRE(cut.stored(&found) == lpvg_status_ok);
        REQUIRE(Bytes(found.record, found.record + found.size) == fresh);
    }
    CHECK(seen_old == 200U);  // only the last byte makes the new one whole
    REQUIRE(whole.stored(&found) == lpvg_status_ok);
    CHECK((found.area == 1U && found.sequence == 2U));
    CHECK(Bytes(found.record, found.record + found.size) == fresh);
    Memory second = whole;
    second.area[0][20] ^= 1U;
    REQUIRE(second.stored(&found) == lpvg_status_ok);
    CHECK(found.area == 1U);
    whole.write(ring, 1U);
    REQUIRE(whole.stored(&found) == lpvg_status_ok);
    CHECK((found.area == 0U && found.sequence == 3U));
}

TEST_CASE("a stored record with a flipped bit is refused", "[unit][REQ-EVID-3]") {
    Ring ring;
    ring.record(lpvg_evidence_invalid, 1.5f);
    Memory memory(capacity_of(ring));
    const std::size_t size = memory.write(ring, 1U) - LPVG_EVIDENCE_HEAD;  // the head is written twice
    lpvg_evidence_stored_t found{};
    for (std::size_t bit = 0; bit < 8U * size; ++bit) {
        memory.area[0][bit / 8U] ^= static_cast<uint8_t>(1U << (bit % 8U));
        REQUIRE(memory.stored(&found) == lpvg_status_bad_crc);
        memory.area[0][bit / 8U] ^= static_cast<uint8_t>(1U << (bit % 8U));
    }
    REQUIRE(memory.stored(&found) == lpvg_status_ok);
    CHECK(lpvg_evidence_stored(memory.area[0].data(), memory.area[1].data(), size, &found) == lpvg_status_ok);
    CHECK(lpvg_evidence_stored(memory.area[0].data(), memory.area[1].data(), size - 1U, &found) == lpvg_status_bad_crc);
    CHECK(lpvg_evidence_stored(memory.area[0].data(), memory.area[1].data(), LPVG_EVIDENCE_HEAD - 1U, &found) == lpvg_status_bad_crc);
    // A head whose CRC fits, of a record that cannot be.
    for (const uint32_t wrong : {0U, 4U, UINT32_MAX}) {
        Bytes& area = memory.area[0];
        for (std::size_t i = 0; i < 4U; ++i) {
            area[8U + i] = static_cast<uint8_t>(wrong >> (8U * i));
        }
        const uint32_t fits = crc(area, 12U);
        for (std::size_t i = 0; i < 4U; ++i) {
            area[12U + i] = static_cast<uint8_t>(fits >> (8U * i));
        }
        CHECK(memory.stored(&found) == lpvg_status_bad_crc);
    }
}

TEST_CASE("the newer of two stored records counts, also where the sequence overflows", "[unit][REQ-EVID-3]") {
    Ring ring;
    ring.record(lpvg_evidence_invalid, 1.5f);
    Memory memory(capacity_of(ring));
    const auto put = [&](uint8_t area, uint32_t sequence) {
        const lpvg_evidence_stored_t before = {area == 0U ? nullptr : memory.area[0].data(), 0U, sequence - 1U, 0U};
        lpvg_evidence_writer_t writer{};
        REQUIRE(lpvg_evidence_write(&writer, &ring.object, 1U, &before) == lpvg_status_ok);
        REQUIRE(writer.area == area);
        for (lpvg_evidence_chunk_t chunk; lpvg_evidence_write_next(&writer, &chunk);) {
            std::copy_n(chunk.data, chunk.size, memory.area[area].begin() + chunk.offset);
        }
    };
    lpvg_evidence_stored_t found{};
    for (const auto& [first, second, newer] : {std::tuple<uint32_t, uint32_t, int>{4U, 5U, 1},
                                               {5U, 4U, 0},
                                               {UINT32_MAX, 0U, 1},
                                               {0U, UINT32_MAX, 0},
                                               {7U, 7U, 1},
                                               {5U, 0x80000004U, 1},
                                               {5U, 0x80000005U, 0}}) {
        put(0U, first);
        put(1U, second);
        REQUIRE(memory.stored(&found) == lpvg_status_ok);
        CHECK(found.area == newer);
    }
    for (const uint8_t only : {0U, 1U}) {  // an area without a record is no newer one, whatever the number of the other
        memory = Memory(capacity_of(ring));
        put(only, 0x80000001U);
        REQUIRE(memory.stored(&found) == lpvg_status_ok);
        CHECK(found.area == only);
    }
}

TEST_CASE("a stored record has the magic of its head, and a byte at least", "[unit][REQ-EVID-3]") {
    struct Case {
        uint32_t magic, size;
        bool whole;
    };
    for (const auto& [magic, size, whole] : {Case{0x5356504CU, 5U, true}, {0x5356504DU, 5U, false}, {0x5356504CU, 4U, false}}) {
        Bytes area;
        const auto add = [&](uint32_t number) {
            for (uint32_t i = 0; i < 4U; ++i) {
                area.push_back(static_cast<uint8_t>(number >> (8U * i)));
            }
        };
        add(magic);
        add(9U);
        add(size);
        add(crc(area, 12U));
        const Bytes one = {0x5AU};
        area.insert(area.end(), one.begin(), size > 4U ? one.end() : one.begin());
        add(size > 4U ? crc(one, 1U) : 0U);  // that of nothing is 0
        lpvg_evidence_stored_t found{};
        CAPTURE(magic, size);
        CHECK((lpvg_evidence_stored(area.data(), area.data(), area.size(), &found) == lpvg_status_ok) == whole);
    }
}

TEST_CASE("a record that is gone while it is written leaves the one before", "[unit][REQ-EVID-3]") {
    Ring ring;
    ring.record(lpvg_evidence_invalid, 1.5f);
    Memory memory(capacity_of(ring));
    memory.write(ring, 1U);
    lpvg_evidence_stored_t newest{};
    REQUIRE(memory.stored(&newest) == lpvg_status_ok);
    lpvg_evidence_writer_t writer{};
    REQUIRE(lpvg_evidence_write(&writer, &ring.object, 1U, &newest) == lpvg_status_ok);
    lpvg_evidence_chunk_t chunk{};
    CHECK_FALSE(lpvg_evidence_write_next(&writer, nullptr));
    REQUIRE(lpvg_evidence_write_next(&writer, &chunk));
    lpvg_evidence_writer_t same = writer;
    CHECK(lpvg_evidence_write(&same, &ring.object, 2U, &newest) == lpvg_status_bad_value);
    CHECK(same.step == writer.step);
    REQUIRE(lpvg_evidence_write_next(&same, &chunk));
    CHECK((chunk.offset == LPVG_EVIDENCE_HEAD && chunk.size == LPVG_EVIDENCE_CHUNK));
    CHECK(lpvg_evidence_read(&writer.reader, nullptr, 1U) == 0U);
    CHECK(writer.reader.offset == 0U);
    chunk = {0U, LPVG_EVIDENCE_HEAD, {}, 1U};
    CHECK((chunk.offset == 0U && chunk.size == LPVG_EVIDENCE_HEAD && chunk.area == 1U));
    REQUIRE(lpvg_evidence_release(&ring.object, 1U));
    CHECK_FALSE(lpvg_evidence_write_next(&writer, &chunk));
    CHECK_FALSE(lpvg_evidence_write_next(&writer, &chunk));
    REQUIRE(memory.stored(&newest) == lpvg_status_ok);
    CHECK(newest.sequence == 1U);
}

TEST_CASE("a tester lists the records and uploads one", "[unit][REQ-EVID-4]") {
    Ring ring(8U);
    lpvg_evidence_upload_t upload{};
    uint8_t answer[LPVG_EVIDENCE_ANSWER_MAX];
    const auto ask = [&](const Bytes& request) {
        const std::size_t n = lpvg_evidence_answer(&upload, &ring.object, request.data(), request.size(), answer, sizeof answer);
        return Bytes(answer, answer + n);
    };
    CHECK(ask({0x22, 0x4C, 0x03}) == Bytes{0x62, 0x4C, 0x03});
    for (int i = 0; i < 7; ++i) {
        REQUIRE(ring.record(lpvg_evidence_invalid, 1.5f) > 0U);
    }
    const Bytes listed = ask({0x22, 0x4C, 0x03});
    REQUIRE(listed.size() == LPVG_EVIDENCE_ANSWER_MAX);
    const Bytes bytes = ring.bytes(7U);
    const auto size = static_cast<uint32_t>(bytes.size());
    const Bytes row = {0, 0, 0, 7, 3, 0x3F, 0xC0, 0, 0, 0, 0, static_cast<uint8_t>(size >> 8), static_cast<uint8_t>(size)};
    CHECK(Bytes(listed.end() - 13, listed.end()) == row);

    CHECK(ask({0x36, 0x01}) == Bytes{0x7F, 0x36, 0x24});
    CHECK(ask({0x37}) == Bytes{0x7F, 0x37, 0x24});
    CHECK(ask({0x35, 0, 0x44, 0, 0, 0, 9, 0, 0, 0, 0}) == Bytes{0x7F, 0x35, 0x31});
    CHECK(ask({0x35, 0, 0x44, 1, 0, 0, 7, 0, 0, 0, 0}) == Bytes{0x7F, 0x35, 0x31});
    CHECK(ask({0x35, 0, 0x44, 0, 0, 0, 7}) == Bytes{0x7F, 0x35, 0x13});
    CHECK(ask({0x35, 0}) == Bytes{0x7F, 0x35, 0x13});
    REQUIRE(ask({0x35, 0, 0x44, 0, 0, 0, 7, 0, 0, 0, 0}) == Bytes{0x75, 0x20, 0x00, 66});
    CHECK(ask({0x36, 0x00}) == Bytes{0x7F, 0x36, 0x73});
    CHECK(ask({0x36, 0x02}) == Bytes{0x7F, 0x36, 0x73});
    CHECK(ask({0x36}) == Bytes{0x7F, 0x36, 0x13});
    Bytes received;
    uint8_t counter = 1U;
    while (received.size() < bytes.size()) {
        const Bytes block = ask({0x36, counter});
        REQUIRE((block.size() > 2U && block[0] == 0x76U && block[1] == counter));
        CHECK(ask({0x36, counter}) == block);  // asked again
        received.insert(received.end(), block.begin() + 2, block.end());
        ++counter;
    }
    CHECK(received == bytes);
    CHECK(ask({0x36, counter}) == Bytes{0x7F, 0x36, 0x24});
    CHECK(ask({0x37, 0x00}) == Bytes{0x7F, 0x37, 0x13});
    CHECK(ask({0x37}) == Bytes{0x77});
    CHECK(ask({0x36, counter}) == Bytes{0x7F, 0x36, 0x24});
    ring.object.numbered = 0x01020303U;
    REQUIRE(ring.record(lpvg_evidence_invalid, 2.0f) == 0x01020304U);
    const Bytes first = ring.bytes(0x01020304U);
    for (int i = 0; i < 2; ++i) {  // again from the start
        REQUIRE(ask({0x35, 0, 0x44, 1, 2, 3, 4, 0, 0, 0, 0}) == Bytes{0x75, 0x20, 0x00, 66});
        CHECK(ask({0x36, 0x00}) == Bytes{0x7F, 0x36, 0x73});
        const Bytes block = ask({0x36, 0x01});
        REQUIRE(block.size() == LPVG_EVIDENCE_CHUNK + 2U);
        CHECK(std::equal(block.begin() + 2, block.end(), first.begin()));
        CHECK(ask({0x36, 0x03}) == Bytes{0x7F, 0x36, 0x73});
    }
    CHECK(ask({0x37}) == Bytes{0x77});
    CHECK(ask({0x36, 0x02}) == Bytes{0x7F, 0x36, 0x24});
    CHECK(ask({0x37, 0x00}) == Bytes{0x7F, 0x37, 0x13});
    CHECK(ask({0x36, 0x02}) == Bytes{0x7F, 0x36, 0x24});
    CHECK(ask({0x22, 0x4C, 0x03, 0x00}) == Bytes{0x7F, 0x22, 0x13});
    CHECK(ask({0x22, 0x4C, 0x04}) == Bytes{0x7F, 0x22, 0x31});
    CHECK(ask({0x22, 0x4D, 0x03}) == Bytes{0x7F, 0x22, 0x31});
    CHECK(ask({0x22, 0x4C}) == Bytes{0x7F, 0x22, 0x13});
    CHECK(ask({0x2E, 0x4C, 0x03}) == Bytes{0x7F, 0x2E, 0x11});
    const uint8_t request[3] = {0x22, 0x4C, 0x03};
    CHECK(lpvg_evidence_answer(nullptr, &ring.object, request, 3U, answer, sizeof answer) == 0U);
    CHECK(lpvg_evidence_answer(&upload, nullptr, request, 3U, answer, sizeof answer) == 0U);
    CHECK(lpvg_evidence_answer(&upload, &ring.object, nullptr, 3U, answer, sizeof answer) == 0U);
    CHECK(lpvg_evidence_answer(&upload, &ring.object, request, 0U, answer, sizeof answer) == 0U);
    CHECK(lpvg_evidence_answer(&upload, &ring.object, request, 3U, nullptr, sizeof answer) == 0U);
    CHECK(lpvg_evidence_answer(&upload, &ring.object, request, 3U, answer, sizeof answer - 1U) == 0U);
}

TEST_CASE("settings outside their range, NULL and missing init are refused", "[unit][REQ-EVID-5]") {
    Ring ring;
    const lpvg_evidence_t before = ring.object;
    const auto refused = [&](auto change) {
        lpvg_evidence_config_t config = ring.config;
        change(config);
        return lpvg_evidence_init(&ring.object, &config) == lpvg_status_bad_argument;
    };
    using C = lpvg_evidence_config_t&;
    CHECK(refused([](C c) { c.buffer = nullptr; }));
    CHECK(refused([](C c) { c.after = c.slots - 1U; }));
    CHECK(refused([](C c) { c.after = c.samples; }));
    CHECK(refused([](C c) { c.period_us = 0U; }));
    CHECK(refused([](C c) { c.period_us = 1'000'000'001U; }));
    for (const uint8_t few : {0U, 1U, 2U}) {
        CHECK(refused([=](C c) { c.channels = few; }));
    }
    CHECK(refused([](C c) { c.scale[0] = 0.0f; }));
    CHECK(refused([](C c) {
        std::fill(std::begin(c.scale), std::end(c.scale), 1.0f);
        c.channels = LPVG_EVIDENCE_CHANNELS_MAX + 1U;
    }));
    CHECK(refused([](C c) { c.inputs = 0U; }));
    CHECK(refused([](C c) { c.inputs = 3U; }));
    CHECK(refused([](C c) { c.slots = 1U; }));
    CHECK(refused([](C c) { c.slots = LPVG_EVIDENCE_SLOTS_MAX + 1U; }));
    for (const float wrong :
         {0.0f, -0.5f, -1.0f, std::numeric_limits<float>::infinity(), std::numeric_limits<float>::quiet_NaN(), 1e-45f}) {
        CHECK(refused([&](C c) { c.scale[3] = wrong; }));
    }
    CHECK(std::memcmp(&before, &ring.object, sizeof before) == 0);
    lpvg_evidence_config_t config = ring.config;
    config.scale[4] = 0.0f;  // of no channel
    config.after = config.samples - 1U;
    config.inputs = 2U;
    config.period_us = 1'000'000'000U;
    config.slots = 2U;
    CHECK(lpvg_evidence_init(&ring.object, &config) == lpvg_status_ok);
    config.channels = 3U;
    config.inputs = 1U;
    config.after = config.slots;
    config.period_us = 1U;
    config.scale[2] = 3.4e-39f;  // its inverse is a number, twice of it is none
    CHECK(lpvg_evidence_init(&ring.object, &config) == lpvg_status_ok);
    std::fill(std::begin(config.scale), std::end(config.scale), 1.0f);
    config.channels = LPVG_EVIDENCE_CHANNELS_MAX;
    config.inputs = LPVG_EVIDENCE_CHANNELS_MAX - 2U;
    CHECK(lpvg_evidence_init(&ring.object, &config) == lpvg_status_ok);
    CHECK(lpvg_evidence_init(nullptr, &config) == lpvg_status_bad_argument);
    CHECK(lpvg_evidence_init(&ring.object, nullptr) == lpvg_status_bad_argument);

    lpvg_evidence_t empty{};
    const float values[channels] = {};
    CHECK(lpvg_evidence_take(nullptr, 0, values, lpvg_evidence_none, 0.0f) == lpvg_status_bad_argument);
    CHECK(lpvg_evidence_take(&empty, 0, nullptr, lpvg_evidence_none, 0.0f) == lpvg_status_bad_argument);
    CHECK(lpvg_evidence_take(&empty, 0, values, lpvg_evidence_none, 0.0f) == lpvg_status_not_ready);
    CHECK(lpvg_evidence_number(nullptr, 0U) == 0U);
    CHECK(lpvg_evidence_number(&empty, 0U) == 0U);
    CHECK(lpvg_evidence_size(nullptr) == 0U);
    CHECK_FALSE(lpvg_evidence_release(nullptr, 1U));
    lpvg_evidence_reader_t reader{};
    uint8_t byte = 0U;
    CHECK(lpvg_evidence_open(nullptr, &empty, 1U) == lpvg_status_bad_argument);
    CHECK(lpvg_evidence_open(&reader, nullptr, 1U) == lpvg_status_bad_argument);
    CHECK(lpvg_evidence_read(nullptr, &byte, 1U) == 0U);
    CHECK(lpvg_evidence_read(&reader, &byte, 1U) == 0U);
    CHECK(lpvg_evidence_read(&reader, nullptr, 1U) == 0U);
    lpvg_evidence_stored_t found{};
    CHECK(lpvg_evidence_stored(nullptr, &byte, 1U, &found) == lpvg_status_bad_argument);
    CHECK(lpvg_evidence_stored(&byte, nullptr, 1U, &found) == lpvg_status_bad_argument);
    CHECK(lpvg_evidence_stored(&byte, &byte, 1U, nullptr) == lpvg_status_bad_argument);
    lpvg_evidence_writer_t writer{};
    lpvg_evidence_chunk_t chunk{};
    CHECK(lpvg_evidence_write(nullptr, &empty, 1U, &found) == lpvg_status_bad_argument);
    CHECK(lpvg_evidence_write(&writer, &empty, 1U, nullptr) == lpvg_status_bad_argument);
    CHECK(lpvg_evidence_write(&writer, nullptr, 1U, &found) == lpvg_status_bad_argument);
    CHECK(lpvg_evidence_write(&writer, &empty, 1U, &found) == lpvg_status_bad_value);
    CHECK_FALSE(lpvg_evidence_write_next(nullptr, &chunk));
}
