// evidence.cpp -- see evidence.h.
#include "lpvguard/evidence.h"

#include <cmath>
#include <cstring>

#include "freeze_bytes.hpp"
#include "monitor/crc32.hpp"
#include "uds_bytes.hpp"

namespace {

constexpr std::size_t n_word = 4U, sample_bytes = 2U;
constexpr uint32_t longest_us = 1'000'000'000U;
constexpr float highest = 32767.0F;
constexpr int16_t no_number = INT16_MIN;
constexpr uint32_t head_magic = 0x5356504CU;  // "LPVS"
constexpr uint8_t request_upload = 0x35U, transfer = 0x36U, transfer_exit = 0x37U;
constexpr uint8_t bad_sequence = 0x24U, wrong_block = 0x73U;
constexpr std::size_t upload_bytes = 11U;

uint32_t crc_of(uint32_t crc, const uint8_t* bytes, std::size_t n) {
    for (std::size_t i = 0U; i < n; ++i) {
        crc = lpvguard::crc32_taken(crc ^ bytes[i]);
    }
    return crc;
}

uint32_t word_at(const uint8_t* bytes) {
    uint32_t word = 0U;
    for (std::size_t i = 0U; i < n_word; ++i) {
        word |= static_cast<uint32_t>(bytes[i]) << (8U * i);
    }
    return word;
}

uint32_t bits_of(float x) {
    uint32_t word = 0U;
    std::memcpy(&word, &x, sizeof word);
    return word;
}

uint8_t* put_big(uint8_t* at, uint32_t value) {
    for (std::size_t i = 0U; i < n_word; ++i) {
        at[i] = static_cast<uint8_t>(value >> (24U - 8U * i));
    }
    return at + n_word;
}

bool allowed(const lpvg_evidence_config_t& config) {
    bool good = config.buffer != nullptr && config.after >= config.slots && config.after < config.samples && config.period_us > 0U &&
                config.period_us <= longest_us && config.channels >= 3U && config.channels <= LPVG_EVIDENCE_CHANNELS_MAX &&
                config.inputs >= 1U && config.inputs <= config.channels - 2U && config.slots >= 2U &&
                config.slots <= LPVG_EVIDENCE_SLOTS_MAX;
    for (std::size_t i = 0U; good && i < config.channels; ++i) {
        good = config.scale[i] > 0.0F && std::isfinite(config.scale[i]) && std::isfinite(1.0F / config.scale[i]);
    }
    return good;
}

int16_t* sample_of(const lpvg_evidence_t& ring, uint32_t slot, uint32_t index) {
    return ring.config.buffer + (static_cast<std::size_t>(slot) * ring.config.samples + index) * ring.config.channels;
}

// To the nearest, halves up; the sum has a grid of 1/256 bit.
int16_t rounded(float bits) {
    if (std::fabs(bits) <= highest) {
        return static_cast<int16_t>(static_cast<int32_t>(bits + 32768.5F) - 32768);
    }
    return bits > 0.0F ? INT16_MAX : (bits < 0.0F ? -INT16_MAX : no_number);
}

// Place of a record: its level, then its ratio, whose bits rise with it. No record has 0.
uint32_t rank_of(const lpvg_evidence_slot_t& slot) { return (static_cast<uint32_t>(slot.level) << 29U) | (bits_of(slot.ratio) >> 3U); }

// Its time is that of no event.
void emptied(lpvg_evidence_slot_t& slot) {
    slot.number = 0U;
    slot.next = 0U;
    slot.count = 0U;
    slot.before = 0U;
    slot.ratio = 0.0F;
    slot.rank = 0U;
    slot.level = lpvg_evidence_none;
}

// Looks at one more slot for the one that says the least.
void look(lpvg_evidence_t& self) {
    if (self.seen < self.config.slots) {
        const bool other = self.seen != self.active;
        const bool less = self.least == self.active || self.slot[self.seen].rank < self.slot[self.least].rank;
        self.least = other && less ? self.seen : self.least;
        ++self.seen;
    }
}

// The ring becomes a record, and the slot that says the least the next ring. Every slot has been looked at.
void freeze(lpvg_evidence_t& self) {
    lpvg_evidence_slot_t& record = self.slot[self.active];
    self.numbered = self.numbered == UINT32_MAX ? 1U : self.numbered + 1U;
    record.number = self.numbered;
    record.rank = rank_of(record);
    self.remaining = 0U;
    self.active = self.slot[self.least].rank < record.rank ? self.least : self.active;
    self.least = self.active;
    self.seen = 0U;
    emptied(self.slot[self.active]);
}

void add_sample(lpvg_evidence_t& self, const float* values) {
    lpvg_evidence_slot_t& slot = self.slot[self.active];
    int16_t* const sample = sample_of(self, self.active, slot.next);
    for (std::size_t i = 0U; i < self.config.channels; ++i) {
        sample[i] = rounded(values[i] * self.bits[i]);
    }
    slot.next = slot.next + 1U < self.config.samples ? slot.next + 1U : 0U;
    if (slot.count < self.config.samples) {
        ++slot.count;
    } else if (slot.before > 0U) {  // a full ring loses its oldest sample
        --slot.before;
    }
}

// Level of the event that a sample is.
lpvg_evidence_level_t event_of(lpvg_evidence_t& self, lpvg_evidence_level_t level, float ratio) {
    const bool rises = level > self.level;
    self.level = level;
    const bool larger = ratio > self.largest;
    self.largest = larger ? ratio : self.largest;
    if (level > lpvg_evidence_near) {
        return rises ? level : lpvg_evidence_none;
    }
    return larger && ratio >= self.config.near_ratio ? lpvg_evidence_near : lpvg_evidence_none;
}

void judge(lpvg_evidence_t& self, int64_t t_us, lpvg_evidence_level_t level, float ratio) {
    lpvg_evidence_slot_t& slot = self.slot[self.active];
    const lpvg_evidence_level_t event = event_of(self, level, ratio);
    const bool pending = self.remaining > 0U;
    slot.ratio = (pending || event != lpvg_evidence_none) && ratio > slot.ratio ? ratio : slot.ratio;
    if (event != lpvg_evidence_none && (event > slot.level || (event == lpvg_evidence_near && slot.level == lpvg_evidence_near))) {
        slot.level = event;
        slot.t_us = t_us;
        slot.before = slot.count;
        self.remaining = self.config.after;
    } else if (pending) {
        --self.remaining;
        if (self.remaining == 0U) {
            freeze(self);
        }
    }
}

const lpvg_evidence_slot_t* record_of(const lpvg_evidence_t& ring, uint32_t number, uint32_t& at) {
    const lpvg_evidence_slot_t* found = nullptr;
    for (uint32_t i = 0U; i < ring.config.slots; ++i) {
        if (number != 0U && ring.slot[i].number == number) {
            found = &ring.slot[i];
            at = i;
        }
    }
    return found;
}

uint32_t size_of(const lpvg_evidence_config_t& config, uint32_t samples) {
    return static_cast<uint32_t>(LPVG_EVIDENCE_HEADER + sample_bytes * samples * config.channels + n_word);
}

void put_header(uint8_t* at, const lpvg_evidence_config_t& config, const lpvg_evidence_slot_t& slot) {
    at = lpvguard::put(at, LPVG_EVIDENCE_MAGIC, n_word);
    at = lpvguard::put(at, LPVG_EVIDENCE_SCHEMA, n_word);
    at = lpvguard::put(at, slot.number, n_word);
    at = lpvguard::put(at, config.coefficients, n_word);
    at = lpvguard::put(at, config.period_us, n_word);
    at = lpvguard::put(at, slot.count, n_word);
    at = lpvguard::put(at, slot.before, n_word);
    at = lpvguard::put(at, static_cast<uint64_t>(slot.level), 1U);
    at = lpvguard::put(at, config.channels, 1U);
    at = lpvguard::put(at, config.inputs, 1U);
    at = lpvguard::put(at, 0U, 1U);
    at = lpvguard::put(at, bits_of(slot.ratio), n_word);
    at = lpvguard::put(at, static_cast<uint64_t>(slot.t_us), 2U * n_word);
    for (std::size_t i = 0U; i < LPVG_EVIDENCE_CHANNELS_MAX; ++i) {
        at = lpvguard::put(at, i < config.channels ? bits_of(config.scale[i]) : 0U, n_word);
    }
}

// Byte of the samples, the oldest sample first.
uint8_t byte_of(const lpvg_evidence_t& ring, uint32_t at, uint32_t offset) {
    const lpvg_evidence_slot_t& slot = ring.slot[at];
    const auto row = static_cast<uint32_t>(sample_bytes * ring.config.channels);
    const uint32_t oldest = slot.count < ring.config.samples ? 0U : slot.next;
    const uint32_t index = (oldest + offset / row) % ring.config.samples;
    const auto value = static_cast<uint16_t>(sample_of(ring, at, index)[(offset % row) / sample_bytes]);
    return static_cast<uint8_t>(value >> (8U * (offset % sample_bytes)));
}

// The record of an area; none where a byte of it or of its head has changed.
lpvg_evidence_stored_t found_in(const uint8_t* bytes, std::size_t capacity, uint8_t area) {
    lpvg_evidence_stored_t found{};
    found.area = area;
    if (capacity < LPVG_EVIDENCE_HEAD || word_at(bytes) != head_magic ||
        word_at(bytes + 3U * n_word) != ~crc_of(lpvguard::crc32_start, bytes, 3U * n_word)) {
        return found;
    }
    const uint32_t size = word_at(bytes + 2U * n_word);
    const uint8_t* const record = bytes + LPVG_EVIDENCE_HEAD;
    if (size > n_word && size <= capacity - LPVG_EVIDENCE_HEAD &&
        word_at(record + size - n_word) == ~crc_of(lpvguard::crc32_start, record, size - n_word)) {
        found.record = record;
        found.size = size;
        found.sequence = word_at(bytes + n_word);
    }
    return found;
}

void put_head(lpvg_evidence_chunk_t& chunk, const lpvg_evidence_writer_t& writer) {
    uint8_t* at = lpvguard::put(chunk.data, head_magic, n_word);
    at = lpvguard::put(at, writer.sequence, n_word);
    at = lpvguard::put(at, writer.reader.size, n_word);
    (void)lpvguard::put(at, ~crc_of(lpvguard::crc32_start, chunk.data, 3U * n_word), n_word);
}

// An answer as it grows, or why it is refused.
struct Answer {
    uint8_t* data;
    std::size_t size;
    uint8_t refusal;  // 0: none
};

void answer_records(Answer& answer, const lpvg_evidence_t& ring, const uint8_t* request, std::size_t n) {
    const bool known = n == 3U && request[1] == (LPVG_EVIDENCE_RECORDS >> 8U) && request[2] == (LPVG_EVIDENCE_RECORDS & 0xFFU);
    if (!known) {
        answer.refusal = n == 3U ? lpvguard::uds_out_of_range : lpvguard::uds_bad_length;
        return;
    }
    answer.data[1] = request[1];
    answer.data[2] = request[2];
    uint8_t* at = &answer.data[3];
    uint32_t slot = 0U;
    for (uint32_t rank = 0U; rank < ring.config.slots; ++rank) {
        const lpvg_evidence_slot_t* const record = record_of(ring, lpvg_evidence_number(&ring, rank), slot);
        if (record != nullptr) {
            at = put_big(at, record->number);
            *at = static_cast<uint8_t>(record->level);
            at = put_big(put_big(at + 1U, bits_of(record->ratio)), size_of(ring.config, record->count));
        }
    }
    answer.size = static_cast<std::size_t>(at - answer.data);
}

void answer_request(Answer& answer, lpvg_evidence_upload_t& upload, const lpvg_evidence_t& ring, const uint8_t* request, std::size_t n) {
    uint32_t number = 0U;
    for (std::size_t i = 3U; i < 7U && i < n; ++i) {
        number = (number << 8U) | request[i];
    }
    if (n != upload_bytes) {
        answer.refusal = lpvguard::uds_bad_length;
    } else if (lpvg_evidence_open(&upload.reader, &ring, number) != lpvg_status_ok) {
        answer.refusal = lpvguard::uds_out_of_range;
    } else {
        upload.open = true;
        upload.counter = 0U;
        upload.size = 0U;
        answer.data[1] = 0x20U;  // the longest block is given in two bytes
        answer.data[2] = 0U;
        answer.data[3] = static_cast<uint8_t>(LPVG_EVIDENCE_CHUNK + 2U);
        answer.size = 4U;
    }
}

void answer_transfer(Answer& answer, lpvg_evidence_upload_t& upload, const uint8_t* request, std::size_t n) {
    if (n != 2U) {
        answer.refusal = lpvguard::uds_bad_length;
    } else if (!upload.open) {
        answer.refusal = bad_sequence;
    } else if (request[1] == static_cast<uint8_t>(upload.counter + 1U)) {
        upload.size = static_cast<uint32_t>(lpvg_evidence_read(&upload.reader, upload.data, LPVG_EVIDENCE_CHUNK));
        upload.counter = request[1];
    } else if (request[1] != upload.counter || upload.size == 0U) {  // a repeated request gets the same block
        answer.refusal = wrong_block;
    }
    if (answer.refusal == 0U && upload.size == 0U) {  // the end, or the record is gone
        answer.refusal = bad_sequence;
    }
    answer.data[1] = n > 1U ? request[1] : 0U;
    std::memcpy(&answer.data[2], upload.data, upload.size);
    answer.size = 2U + upload.size;
}

void answer_exit(Answer& answer, lpvg_evidence_upload_t& upload, std::size_t n) {
    if (n != 1U || !upload.open) {
        answer.refusal = n == 1U ? bad_sequence : lpvguard::uds_bad_length;
    }
    upload.open = upload.open && n != 1U;
}

}  // namespace

extern "C" lpvg_status_t lpvg_evidence_init(lpvg_evidence_t* self, const lpvg_evidence_config_t* config) {
    if (self == nullptr || config == nullptr || !allowed(*config)) {
        return lpvg_status_bad_argument;
    }
    *self = lpvg_evidence_t{};
    self->config = *config;
    self->gap_us = config->period_us + (config->period_us + 1U) / 2U;
    for (std::size_t i = 0U; i < config->channels; ++i) {
        self->bits[i] = 1.0F / config->scale[i];
    }
    return lpvg_status_ok;
}

extern "C" lpvg_status_t lpvg_evidence_take(lpvg_evidence_t* self, int64_t t_us, const float* values, lpvg_evidence_level_t level,
                                            float ratio) {
    if (self == nullptr || values == nullptr) {
        return lpvg_status_bad_argument;
    }
    if (self->config.buffer == nullptr) {
        return lpvg_status_not_ready;
    }
    if (self->running && t_us <= self->t_us) {
        return lpvg_status_out_of_order;
    }
    const uint64_t step = static_cast<uint64_t>(t_us) - static_cast<uint64_t>(self->t_us);
    if (self->running && step >= self->gap_us) {
        if (self->remaining > 0U && self->seen == self->config.slots) {
            freeze(*self);
        } else {
            self->remaining = 0U;
            emptied(self->slot[self->active]);
        }
    }
    self->running = true;
    self->t_us = t_us;
    look(*self);
    add_sample(*self, values);
    judge(*self, t_us, level, std::isfinite(ratio) ? ratio : 0.0F);
    return lpvg_status_ok;
}

extern "C" uint32_t lpvg_evidence_number(const lpvg_evidence_t* self, uint32_t rank) {
    uint32_t found = 0U;
    for (uint32_t i = 0U; self != nullptr && i < self->config.slots; ++i) {
        uint32_t above = 0U;
        for (uint32_t k = 0U; k < self->config.slots; ++k) {
            const uint32_t own = self->slot[i].rank, other = self->slot[k].rank;
            above += other > own || (other == own && k < i) ? 1U : 0U;  // of equal ones the first
        }
        found = above == rank ? self->slot[i].number : found;
    }
    return found;
}

extern "C" uint32_t lpvg_evidence_size(const lpvg_evidence_config_t* config) {
    return config == nullptr ? 0U : size_of(*config, config->samples);
}

extern "C" bool lpvg_evidence_release(lpvg_evidence_t* self, uint32_t number) {
    uint32_t at = 0U;
    if (self == nullptr || record_of(*self, number, at) == nullptr) {
        return false;
    }
    emptied(self->slot[at]);
    self->seen = self->config.slots;
    self->least = at;
    return true;
}

extern "C" lpvg_status_t lpvg_evidence_open(lpvg_evidence_reader_t* reader, const lpvg_evidence_t* ring, uint32_t number) {
    if (reader == nullptr || ring == nullptr) {
        return lpvg_status_bad_argument;
    }
    uint32_t at = 0U;
    const lpvg_evidence_slot_t* const record = record_of(*ring, number, at);
    if (record == nullptr) {
        return lpvg_status_bad_value;
    }
    *reader = {ring, number, at, 0U, size_of(ring->config, record->count), lpvguard::crc32_start};
    return lpvg_status_ok;
}

extern "C" size_t lpvg_evidence_read(lpvg_evidence_reader_t* reader, uint8_t* bytes, size_t max) {
    if (reader == nullptr || bytes == nullptr || reader->ring == nullptr || reader->ring->slot[reader->slot].number != reader->number) {
        return 0U;
    }
    uint8_t header[LPVG_EVIDENCE_HEADER];
    put_header(header, reader->ring->config, reader->ring->slot[reader->slot]);
    const uint32_t end = reader->size - static_cast<uint32_t>(n_word);
    std::size_t n = 0U;
    while (n < max && reader->offset < reader->size) {
        const uint32_t at = reader->offset;
        if (at < end) {
            bytes[n] = at < LPVG_EVIDENCE_HEADER ? header[at] : byte_of(*reader->ring, reader->slot, at - LPVG_EVIDENCE_HEADER);
            reader->crc = crc_of(reader->crc, &bytes[n], 1U);
        } else {
            bytes[n] = static_cast<uint8_t>(~reader->crc >> (8U * (at - end)));
        }
        ++reader->offset;
        ++n;
    }
    return n;
}

extern "C" lpvg_status_t lpvg_evidence_stored(const uint8_t* first, const uint8_t* second, size_t capacity, lpvg_evidence_stored_t* found) {
    if (first == nullptr || second == nullptr || found == nullptr) {
        return lpvg_status_bad_argument;
    }
    const lpvg_evidence_stored_t of[2] = {found_in(first, capacity, 0U), found_in(second, capacity, 1U)};
    // The sequence may overflow: the newer one is less than half a turn ahead.
    const bool later = of[1].record != nullptr && (of[0].record == nullptr || of[1].sequence - of[0].sequence < 0x80000000U);
    *found = of[later ? 1U : 0U];
    return found->record == nullptr ? lpvg_status_bad_crc : lpvg_status_ok;
}

extern "C" lpvg_status_t lpvg_evidence_write(lpvg_evidence_writer_t* writer, const lpvg_evidence_t* ring, uint32_t number,
                                             const lpvg_evidence_stored_t* newest) {
    if (writer == nullptr || newest == nullptr) {
        return lpvg_status_bad_argument;
    }
    lpvg_evidence_reader_t reader{};
    const lpvg_status_t status = lpvg_evidence_open(&reader, ring, number);
    if (status == lpvg_status_ok) {
        const auto other = static_cast<uint8_t>(newest->record != nullptr && newest->area == 0U ? 1U : 0U);
        *writer = {reader, newest->sequence + 1U, other, 0U};
    }
    return status;
}

extern "C" bool lpvg_evidence_write_next(lpvg_evidence_writer_t* writer, lpvg_evidence_chunk_t* chunk) {
    if (writer == nullptr || chunk == nullptr || writer->step > 2U) {
        return false;
    }
    *chunk = lpvg_evidence_chunk_t{};
    chunk->area = writer->area;
    chunk->size = LPVG_EVIDENCE_HEAD;
    if (writer->step == 1U) {
        chunk->offset = LPVG_EVIDENCE_HEAD + writer->reader.offset;
        chunk->size = static_cast<uint32_t>(lpvg_evidence_read(&writer->reader, chunk->data, LPVG_EVIDENCE_CHUNK));
        writer->step = writer->reader.offset == writer->reader.size ? 2U : 1U;
        return chunk->size > 0U;
    }
    if (writer->step == 2U) {
        put_head(*chunk, *writer);
    }
    ++writer->step;
    return true;
}

extern "C" size_t lpvg_evidence_answer(lpvg_evidence_upload_t* upload, const lpvg_evidence_t* ring, const uint8_t* request, size_t n,
                                       uint8_t* answer, size_t max) {
    if (upload == nullptr || ring == nullptr || request == nullptr || n == 0U || answer == nullptr || max < LPVG_EVIDENCE_ANSWER_MAX) {
        return 0U;
    }
    Answer made = {answer, 1U, 0U};
    answer[0] = static_cast<uint8_t>(request[0] + lpvguard::uds_positive);
    if (request[0] == lpvguard::uds_read_data) {
        answer_records(made, *ring, request, n);
    } else if (request[0] == request_upload) {
        answer_request(made, *upload, *ring, request, n);
    } else if (request[0] == transfer) {
        answer_transfer(made, *upload, request, n);
    } else if (request[0] == transfer_exit) {
        answer_exit(made, *upload, n);
    } else {
        made.refusal = lpvguard::uds_no_service;
    }
    if (made.refusal != 0U) {
        return lpvguard::uds_refused(answer, request[0], made.refusal);
    }
    return made.size;
}
