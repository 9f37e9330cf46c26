// uds.cpp -- see uds.h.
#include "lpvguard/uds.h"

#include <cstring>

#include "freeze_bytes.hpp"
#include "uds_bytes.hpp"

namespace {

constexpr uint8_t read_codes = 0x19U, suppressed = 0x80U;
constexpr uint8_t by_mask = 0x02U, snapshot = 0x04U, extended = 0x06U;
constexpr uint8_t no_subfunction = 0x12U, too_long = 0x14U;
constexpr uint8_t active = 0x09U, confirmed = 0x08U, available = active | confirmed;
constexpr uint8_t first_record = 0x01U, all_records = 0xFFU;
constexpr std::size_t dtc_bytes = 3U;

uint8_t status_of(const lpvg_j1939_entry_t& entry) { return entry.active != 0U ? active : confirmed; }

// Bytes of an answer, or why it is refused.
struct Answer {
    uint8_t data[LPVG_UDS_ANSWER_MAX];
    std::size_t size;
    uint8_t refusal;  // 0: none
};

void add(Answer& answer, uint64_t value, std::size_t bytes) {
    answer.size = static_cast<std::size_t>(lpvguard::put(&answer.data[answer.size], value, bytes) - answer.data);
}

void add_code(Answer& answer, const lpvg_j1939_entry_t& entry) {
    uint8_t code[lpvguard::code_bytes];
    (void)lpvguard::put_code(code, entry);
    std::memcpy(&answer.data[answer.size], code, dtc_bytes);
    answer.size += dtc_bytes;
}

void add_held(Answer& answer, const lpvg_j1939_entry_t& entry) {
    (void)lpvguard::put_held(&answer.data[answer.size], entry);
    answer.size += lpvguard::held_bytes;
}

void add_identifier(Answer& answer, uint32_t identifier) {
    add(answer, identifier >> 8U, 1U);
    add(answer, identifier & 0xFFU, 1U);
}

// The entry of a code as it stands in a request, nullptr where there is none.
const lpvg_j1939_entry_t* entry_of(const lpvg_j1939_memory_t& memory, const uint8_t* dtc) {
    for (const lpvg_j1939_entry_t& entry : memory.entry) {
        uint8_t code[lpvguard::code_bytes];
        (void)lpvguard::put_code(code, entry);
        if (lpvguard::remembered(entry) && code[0] == dtc[0] && code[1] == dtc[1] && code[2] == dtc[2]) {
            return &entry;
        }
    }
    return nullptr;
}

void answer_mask(Answer& answer, const lpvg_j1939_memory_t& memory, uint8_t mask) {
    add(answer, available, 1U);
    for (const lpvg_j1939_entry_t& entry : memory.entry) {
        if (lpvguard::remembered(entry) && (status_of(entry) & mask) != 0U) {
            add_code(answer, entry);
            add(answer, status_of(entry), 1U);
        }
    }
}

void answer_code(Answer& answer, const lpvg_j1939_memory_t& memory, const uint8_t* request, bool frozen) {
    const lpvg_j1939_entry_t* entry = entry_of(memory, &request[2]);
    const uint8_t record = request[2U + dtc_bytes];
    if (entry == nullptr || (record != first_record && record != all_records)) {
        answer.refusal = lpvguard::uds_out_of_range;
        return;
    }
    add_code(answer, *entry);
    add(answer, status_of(*entry), 1U);
    add(answer, first_record, 1U);
    if (frozen) {
        add(answer, 1U, 1U);  // identifiers in the record
        add_identifier(answer, LPVG_UDS_FREEZE);
        add_held(answer, *entry);
    } else {
        add(answer, entry->occurrence, 1U);
    }
}

void answer_codes(Answer& answer, const lpvg_j1939_memory_t& memory, const uint8_t* request, std::size_t n) {
    const auto kind = static_cast<uint8_t>(n > 1U ? uint32_t{request[1]} & ~uint32_t{suppressed} : 0U);
    const std::size_t want = kind == by_mask ? 3U : 3U + dtc_bytes;
    add(answer, kind, 1U);
    if (n < 2U) {
        answer.refusal = lpvguard::uds_bad_length;
    } else if (kind != by_mask && kind != snapshot && kind != extended) {
        answer.refusal = no_subfunction;
    } else if (n != want) {
        answer.refusal = lpvguard::uds_bad_length;
    } else if (kind == by_mask) {
        answer_mask(answer, memory, request[2]);
    } else {
        answer_code(answer, memory, request, kind == snapshot);
    }
}

void answer_data(Answer& answer, const lpvg_j1939_t& self, const uint8_t* request, std::size_t n) {
    if (n != 3U) {
        answer.refusal = lpvguard::uds_bad_length;
        return;
    }
    const uint32_t identifier = (static_cast<uint32_t>(request[1]) << 8U) | request[2];
    const lpvg_j1939_entry_t* newest = lpvguard::newest(*self.memory, UINT32_MAX);
    add_identifier(answer, identifier);
    if (identifier == LPVG_UDS_STATE) {
        uint32_t n_active = 0U, n_all = 0U;  // words: gcc 12 at -O3 counts bytes of such a condition the wrong way round
        for (const lpvg_j1939_entry_t& entry : self.memory->entry) {
            n_active += entry.active;
            n_all += lpvguard::remembered(entry) ? 1U : 0U;
        }
        add(answer, self.state, 1U);
        add(answer, self.address, 1U);
        add(answer, n_active, 1U);
        add(answer, n_all, 1U);
    } else if (identifier == LPVG_UDS_FREEZE && newest != nullptr) {
        add_code(answer, *newest);
        add(answer, newest->occurrence, 1U);
        add_held(answer, *newest);
    } else if (identifier == LPVG_UDS_NAME) {
        add(answer, self.config.name, sizeof self.config.name);
    } else {
        answer.refusal = lpvguard::uds_out_of_range;
    }
}

}  // namespace

extern "C" size_t lpvg_uds_answer(const lpvg_j1939_t* self, const uint8_t* request, size_t n, uint8_t* answer, size_t max) {
    if (self == nullptr || self->memory == nullptr || request == nullptr || n == 0U || answer == nullptr ||
        max < lpvguard::uds_refusal_bytes) {
        return 0U;
    }
    Answer made = {};
    add(made, static_cast<uint8_t>(request[0] + lpvguard::uds_positive), 1U);
    if (request[0] == read_codes) {
        answer_codes(made, *self->memory, request, n);
    } else if (request[0] == lpvguard::uds_read_data) {
        answer_data(made, *self, request, n);
    } else {
        made.refusal = lpvguard::uds_no_service;
    }
    if (made.size > max) {  // what is refused is no longer than a refusal
        made.refusal = too_long;
    }
    if (made.refusal != 0U) {
        return lpvguard::uds_refused(answer, request[0], made.refusal);
    }
    if (request[0] == read_codes && (request[1] & suppressed) != 0U) {
        return 0U;
    }
    std::memcpy(answer, made.data, made.size);
    return made.size;
}
