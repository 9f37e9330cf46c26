// j1939.cpp -- see j1939.h.
#include "lpvguard/j1939.h"

#include <cstring>

#include "monitor/crc32.hpp"
#include "freeze_bytes.hpp"

namespace {

using Entry = lpvg_j1939_entry_t;
using Memory = lpvg_j1939_memory_t;

constexpr uint32_t memory_version = 0x4A390001U;
constexpr uint8_t occurrence_max = 126U;  // 127 says "unknown"
constexpr uint32_t run_modulo = 251U;     // 251 .. 255 are no numbers on the bus
constexpr uint8_t address_max = 253U;
constexpr uint64_t arbitrary_bit = 1ULL << 63U;
constexpr uint32_t delay_steps = 154U;  // of 1 ms: 0 .. 153 ms, so that those who cannot claim do not collide (J1939-81)

static_assert(sizeof(lpvg_j1939_freeze_t) == 24U && sizeof(Entry) == 32U && sizeof(Memory) == 16U + LPVG_J1939_CODES_MAX * sizeof(Entry),
              "without holes");

constexpr uint32_t pgn_request = 0xEA00U, pgn_acknowledge = 0xE800U, pgn_claim = 0xEE00U, pgn_connection = 0xEC00U, pgn_transfer = 0xEB00U;
constexpr uint32_t pgn_dm1 = 0xFECAU, pgn_dm3 = 0xFECCU, pgn_dm11 = 0xFED3U;
constexpr uint8_t priority_management = 6U, priority_transport = 7U;
constexpr uint8_t control_bam = 32U, acknowledged = 0U, refused = 1U;
constexpr uint8_t packet_bytes = 7U, frame_bytes = 8U, none = 0xFFU;

// What is sent of its own accord or on request, in the order in which they wait.
enum Message : uint8_t {
    message_dm1,
    message_dm2,
    message_dm4,
    message_dm24,
    message_dm25,
    n_messages
};
constexpr uint32_t pgn_of[n_messages] = {pgn_dm1, 0xFECBU, 0xFECDU, 0xFDB6U, 0xFDB7U};
constexpr std::size_t dm4_before = 6U;  // bytes of what an engine would tell, between code and speed

// What a freeze frame holds, in its order.
struct Held {
    uint32_t spn;
    uint8_t bytes;
};
constexpr Held held[] = {{84U, 2U},
                         {LPVG_J1939_SPN_BIN, 1U},
                         {LPVG_J1939_SPN_STATISTIC, 2U},
                         {LPVG_J1939_SPN_CAUSES, 2U},
                         {LPVG_J1939_SPN_TIME, 4U},
                         {LPVG_J1939_SPN_RUN, 1U}};
constexpr std::size_t dm25_bytes = 1U + lpvguard::code_bytes + lpvguard::held_bytes, dm4_bytes = dm25_bytes + dm4_before;
static_assert(LPVG_J1939_FREEZE_MAX * dm4_bytes <= LPVG_J1939_MESSAGE_MAX &&
                  2U + LPVG_J1939_CODES_MAX * lpvguard::code_bytes <= LPVG_J1939_MESSAGE_MAX,
              "every message has room");

void count(uint32_t& counter) { counter += counter < UINT32_MAX ? 1U : 0U; }

// --- memory ---

uint32_t crc_of(const Memory& memory) {
    constexpr std::size_t place = offsetof(Memory, crc32) / sizeof(uint32_t);
    uint32_t crc = lpvguard::crc32_start;
    for (std::size_t i = 0U; i < sizeof memory / sizeof(uint32_t); ++i) {
        crc = lpvguard::crc32_word(crc, i == place ? 0U : lpvguard::item_at<uint32_t>(memory, i));
    }
    return ~crc;
}

// Place of a code, `none` where it is not remembered.
uint8_t find(const Memory& memory, const lpvg_can_dtc_t& code) {
    uint8_t i = 0U;
    while (i < LPVG_J1939_CODES_MAX &&
           !(lpvguard::remembered(memory.entry[i]) && memory.entry[i].spn == code.spn && memory.entry[i].fmi == code.fmi)) {
        ++i;
    }
    return i < LPVG_J1939_CODES_MAX ? i : none;
}

// A free place, or that of the code that has been inactive since the longest ago. There is one: no more codes are active than places.
uint8_t place_of(const Memory& memory) {
    uint8_t best = none;
    for (uint8_t i = 0U; i < LPVG_J1939_CODES_MAX; ++i) {
        const bool older = best == none || memory.entry[i].freeze.sequence < memory.entry[best].freeze.sequence;
        best = memory.entry[i].active == 0U && older ? i : best;
    }
    return best;
}

// --- codes ---

bool names(const lpvg_j1939_findings_t& findings, const Entry& entry) {
    for (uint8_t i = 0U; i < findings.n_codes; ++i) {
        if (findings.code[i].spn == entry.spn && findings.code[i].fmi == entry.fmi) {
            return true;
        }
    }
    return false;
}

bool good(const lpvg_j1939_findings_t& findings) {
    bool all = findings.n_codes <= LPVG_J1939_CODES_MAX;
    for (uint8_t i = 0U; all && i < findings.n_codes; ++i) {
        all = findings.code[i].spn <= 0x7FFFFU && findings.code[i].fmi <= 31U;
    }
    return all;
}

void ask(lpvg_j1939_t& self, Message message) { self.waiting = static_cast<uint8_t>(self.waiting | (1U << message)); }

// A code became active or has gone: told at once, but a code that comes and goes only once a second.
void tell(lpvg_j1939_t& self, uint8_t i) {
    if (self.now_us - self.told_us[i] >= static_cast<int64_t>(LPVG_J1939_DM1_US)) {
        self.told_us[i] = self.now_us;
        ask(self, message_dm1);
    }
}

uint8_t activate(lpvg_j1939_t& self, const lpvg_can_dtc_t& code, const lpvg_j1939_freeze_t& freeze) {
    Memory& memory = *self.memory;
    uint8_t i = find(memory, code);
    if (i == none) {
        i = place_of(memory);
        std::memset(&memory.entry[i], 0, sizeof memory.entry[i]);
        memory.entry[i].spn = code.spn;
        memory.entry[i].fmi = code.fmi;
        self.told_us[i] = self.now_us - LPVG_J1939_DM1_US;
    }
    Entry& entry = memory.entry[i];
    if (entry.active == 0U) {
        count(memory.activations);
        entry.freeze = freeze;
        entry.freeze.sequence = memory.activations;
        entry.occurrence = static_cast<uint8_t>(entry.occurrence + (entry.occurrence < occurrence_max ? 1U : 0U));
        entry.active = 1U;
        entry.run = static_cast<uint8_t>(memory.runs % run_modulo);
        self.changed = true;
        tell(self, i);
    }
    return i;
}

void take_findings(lpvg_j1939_t& self, const lpvg_j1939_findings_t& findings) {
    Memory& memory = *self.memory;
    for (uint8_t i = 0U; i < LPVG_J1939_CODES_MAX; ++i) {
        if (memory.entry[i].active != 0U && !names(findings, memory.entry[i])) {
            memory.entry[i].active = 0U;
            self.changed = true;
            tell(self, i);
        }
    }
    self.n_listed = 0U;
    for (uint8_t i = 0U; i < findings.n_codes; ++i) {
        self.listed[self.n_listed] = activate(self, findings.code[i], findings.freeze);
        ++self.n_listed;
    }
}

void forget(lpvg_j1939_t& self, uint8_t active) {
    for (Entry& entry : self.memory->entry) {
        if (entry.active == active) {
            std::memset(&entry, 0, sizeof entry);
        }
    }
    self.changed = true;
}

// --- what is received ---

void claim(lpvg_j1939_t& self, uint8_t address) {
    const bool arbitrary = address >= LPVG_J1939_ARBITRARY_MIN && address <= LPVG_J1939_ARBITRARY_MAX;
    self.address = address;
    self.state = static_cast<uint8_t>(arbitrary ? lpvg_j1939_state_waiting : lpvg_j1939_state_claimed);
    self.claim = true;
}

// Says that there is no address, a time from the NAME later.
void say_lost(lpvg_j1939_t& self) {
    const uint64_t name = self.config.name;
    const auto folded = static_cast<uint32_t>(name ^ (name >> 32U));
    self.claim = true;
    self.claim_us = self.now_us + static_cast<int64_t>(1000U * (folded % delay_steps));
}

bool is_taken(const lpvg_j1939_t& self, uint32_t address) { return ((self.taken[address / 32U] >> (address % 32U)) & 1U) != 0U; }

// The address went to a lower NAME.
void lose(lpvg_j1939_t& self) {
    constexpr uint32_t n = LPVG_J1939_ARBITRARY_MAX - LPVG_J1939_ARBITRARY_MIN + 1U;
    const bool within = self.address >= LPVG_J1939_ARBITRARY_MIN && self.address <= LPVG_J1939_ARBITRARY_MAX;
    const uint32_t first = within ? self.address : LPVG_J1939_ARBITRARY_MIN;
    self.broadcast.next = 0U;
    if ((self.config.name & arbitrary_bit) != 0U) {
        for (uint32_t i = 0U; i < n; ++i) {
            const uint32_t next = LPVG_J1939_ARBITRARY_MIN + (first - LPVG_J1939_ARBITRARY_MIN + i) % n;
            if (!is_taken(self, next)) {
                claim(self, static_cast<uint8_t>(next));
                return;
            }
        }
    }
    self.address = LPVG_J1939_ADDRESS_NULL;
    self.state = lpvg_j1939_state_lost;
    say_lost(self);
}

void take_claim(lpvg_j1939_t& self, const lpvg_can_frame_t& frame, uint8_t source) {
    uint64_t name = 0U;
    for (uint8_t i = frame_bytes; i > 0U; --i) {
        name = (name << 8U) | frame.data[i - 1U];
    }
    if (source > address_max || name == self.config.name) {
        return;  // who has none takes none; a driver may hand back what was sent
    }
    if (source == self.address && name > self.config.name) {
        self.claim = true;
        return;
    }
    self.taken[source / 32U] |= 1U << (source % 32U);
    if (source == self.address) {
        lose(self);
    }
}

void answer(lpvg_j1939_t& self, uint32_t pgn, uint8_t control, uint8_t to) {
    if (self.n_answers == LPVG_J1939_REFUSALS_MAX) {
        count(self.unanswered);
        return;
    }
    self.answer[self.n_answers] = {pgn, control, to};
    ++self.n_answers;
}

// The message that a group number asks for, n_messages where there is none.
uint8_t message_of(uint32_t pgn) {
    uint8_t i = 0U;
    while (i < n_messages && pgn_of[i] != pgn) {
        ++i;
    }
    return i;
}

void take_request(lpvg_j1939_t& self, const lpvg_can_frame_t& frame, uint8_t source, bool of_all) {
    const uint32_t pgn = frame.data[0] | (static_cast<uint32_t>(frame.data[1]) << 8U) | (static_cast<uint32_t>(frame.data[2]) << 16U);
    const uint8_t message = message_of(pgn);
    if (pgn == pgn_claim) {
        if (self.state == lpvg_j1939_state_lost) {
            say_lost(self);
        } else {
            self.claim = true;
        }
    } else if (self.state != lpvg_j1939_state_claimed || source > address_max) {
        // Nothing else is said without an address, or to somebody without one.
    } else if (message < n_messages) {
        ask(self, static_cast<Message>(message));
    } else {
        const bool clears = pgn == pgn_dm3 || pgn == pgn_dm11;
        if (clears) {
            forget(self, pgn == pgn_dm11 ? 1U : 0U);
        }
        if (!of_all) {
            answer(self, pgn, clears ? acknowledged : refused, source);
        }
    }
}

void take_frame(lpvg_j1939_t& self, const lpvg_can_frame_t& frame) {
    if ((frame.id & (LPVG_CAN_EXTENDED | LPVG_CAN_REMOTE | LPVG_CAN_ERROR)) != LPVG_CAN_EXTENDED) {
        return;
    }
    const uint32_t group = (frame.id >> 8U) & 0x3FF00U;  // of a message to one address, which both kinds here are
    const auto to = static_cast<uint8_t>(frame.id >> 8U), source = static_cast<uint8_t>(frame.id);
    const bool of_all = to == LPVG_J1939_ADDRESS_ALL;
    if (group == pgn_claim && of_all && frame.dlc == frame_bytes) {
        take_claim(self, frame, source);
    } else if (group == pgn_request && frame.dlc >= 3U && (of_all || (to == self.address && to <= address_max))) {
        take_request(self, frame, source, of_all);
    }
}

// --- what is sent ---

// Frames of one step.
class Out {
public:
    Out(lpvg_can_frame_t* first, int64_t now_us) : first_(first), next_(first), now_us_(now_us) {}
    // A frame with eight bytes 0xFF.
    uint8_t* add(uint8_t priority, uint32_t pgn, uint8_t source) {
        lpvg_can_frame_t& frame = *next_;
        ++next_;
        frame.id = LPVG_CAN_EXTENDED | (static_cast<uint32_t>(priority) << 26U) | (pgn << 8U) | source;
        frame.dlc = frame_bytes;
        frame.t_us = now_us_;
        std::memset(frame.data, 0xFF, sizeof frame.data);
        return frame.data;
    }
    std::size_t size() const { return static_cast<std::size_t>(next_ - first_); }

private:
    lpvg_can_frame_t* first_;
    lpvg_can_frame_t* next_;
    int64_t now_us_;
};

uint8_t* put_lamps(uint8_t* at, const lpvg_j1939_t& self) {
    *at = static_cast<uint8_t>(self.n_listed > 0U ? LPVG_CAN_LAMP_AMBER : 0U);
    at[1] = 0xFFU;  // no lamp flashes
    return at + 2U;
}

uint8_t* put_frozen(uint8_t* at, const Memory& memory, bool dm25) {
    const Entry* entry = lpvguard::newest(memory, UINT32_MAX);
    for (uint8_t n = 0U; entry != nullptr && n < LPVG_J1939_FREEZE_MAX; ++n) {
        *at = static_cast<uint8_t>((dm25 ? dm25_bytes : dm4_bytes) - 1U);
        at = lpvguard::put_code(at + 1U, *entry);
        at = lpvguard::put_held(dm25 ? at : lpvguard::put(at, ~0ULL, dm4_before), *entry);
        entry = lpvguard::newest(memory, entry->freeze.sequence);
    }
    return at;
}

uint8_t* put_known(uint8_t* at) {
    for (const Held& item : held) {
        // In the expanded freeze frame: bit 0 is zero. In the data stream, in scaled tests: ones say no.
        at = lpvguard::put(at, item.spn & 0xFFFFU, 2U);
        at = lpvguard::put(at, ((item.spn >> 11U) & 0xE0U) | 0x1EU, 1U);
        at = lpvguard::put(at, item.bytes, 1U);
    }
    return at;
}

// Writes a message; returns behind it. Without a code, and without a freeze frame, it holds zeros in place of one.
uint8_t* put_message(uint8_t* at, const lpvg_j1939_t& self, uint8_t message) {
    const Memory& memory = *self.memory;
    uint8_t* end = at;
    switch (message) {
        case message_dm1:
        case message_dm2: {
            end = put_lamps(at, self);
            uint8_t* const first = end;
            for (uint8_t i = 0U; i < (message == message_dm1 ? self.n_listed : LPVG_J1939_CODES_MAX); ++i) {
                const Entry& entry = memory.entry[message == message_dm1 ? self.listed[i] : i];
                if (message == message_dm1 || (lpvguard::remembered(entry) && entry.active == 0U)) {
                    end = lpvguard::put_code(end, entry);
                }
            }
            return end == first ? lpvguard::put(end, 0U, lpvguard::code_bytes) : end;
        }
        case message_dm24: return put_known(at);
        default:
            end = put_frozen(at, memory, message == message_dm25);
            return end == at ? lpvguard::put(end, 0U, 1U + lpvguard::code_bytes) : end;
    }
}

void send_packet(lpvg_j1939_t& self, Out& out) {
    lpvg_j1939_broadcast_t& b = self.broadcast;
    const std::size_t first = static_cast<std::size_t>(b.next - 1U) * packet_bytes;
    const std::size_t left = b.size - first;
    uint8_t* const data = out.add(priority_transport, pgn_transfer | LPVG_J1939_ADDRESS_ALL, self.address);
    data[0] = b.next;
    std::memcpy(&data[1], &b.data[first], left < packet_bytes ? left : packet_bytes);
    b.packet_us = self.now_us;
    b.next = static_cast<uint8_t>(left > packet_bytes ? b.next + 1U : 0U);
}

// Begins with the first of the messages that wait, where it fits into a frame or no broadcast runs.
void send_message(lpvg_j1939_t& self, Out& out) {
    uint8_t buffer[LPVG_J1939_MESSAGE_MAX];
    for (uint8_t message = 0U; message < n_messages; ++message) {
        if ((self.waiting & (1U << message)) == 0U) {
            continue;
        }
        const auto size = static_cast<std::size_t>(put_message(buffer, self, message) - buffer);
        if (size > frame_bytes && self.broadcast.next != 0U) {
            continue;
        }
        self.waiting = static_cast<uint8_t>(self.waiting & ~(1U << message));
        self.dm1_us = message == message_dm1 ? self.now_us : self.dm1_us;
        if (size <= frame_bytes) {
            std::memcpy(out.add(priority_management, pgn_of[message], self.address), buffer, size);
            return;
        }
        uint8_t* const data = out.add(priority_transport, pgn_connection | LPVG_J1939_ADDRESS_ALL, self.address);
        data[0] = control_bam;
        (void)lpvguard::put(&data[1], size, 2U);
        data[3] = static_cast<uint8_t>((size + packet_bytes - 1U) / packet_bytes);
        (void)lpvguard::put(&data[5], pgn_of[message], 3U);
        std::memcpy(self.broadcast.data, buffer, size);
        self.broadcast.size = static_cast<uint16_t>(size);
        self.broadcast.next = 1U;
        self.broadcast.packet_us = self.now_us;
        return;
    }
}

void send_answers(lpvg_j1939_t& self, Out& out) {
    for (uint8_t i = 0U; i < self.n_answers; ++i) {
        uint8_t* const data = out.add(priority_management, pgn_acknowledge | LPVG_J1939_ADDRESS_ALL, self.address);
        data[0] = self.answer[i].control;
        data[4] = self.answer[i].to;
        (void)lpvguard::put(&data[5], self.answer[i].pgn, 3U);
    }
}

void send(lpvg_j1939_t& self, Out& out) {
    if (self.claim && self.now_us >= self.claim_us) {
        (void)lpvguard::put(out.add(priority_management, pgn_claim | LPVG_J1939_ADDRESS_ALL, self.address), self.config.name, frame_bytes);
        self.claim = false;
        self.claim_us = self.now_us;
    }
    if (self.state == lpvg_j1939_state_waiting && self.now_us - self.claim_us >= static_cast<int64_t>(LPVG_J1939_CLAIM_US)) {
        self.state = lpvg_j1939_state_claimed;
    }
    if (self.state != lpvg_j1939_state_claimed) {
        return;
    }
    send_answers(self, out);
    if (self.broadcast.next != 0U && self.now_us - self.broadcast.packet_us >= static_cast<int64_t>(LPVG_J1939_PACKET_US)) {
        send_packet(self, out);
    }
    if (self.now_us - self.dm1_us >= static_cast<int64_t>(LPVG_J1939_DM1_US)) {
        ask(self, message_dm1);
    }
    send_message(self, out);
}

}  // namespace

extern "C" {

lpvg_status_t lpvg_j1939_name_pack(const lpvg_j1939_name_t* name, uint64_t* packed) {
    if (name == nullptr || packed == nullptr || name->identity > 0x1FFFFFU || name->manufacturer > 0x7FFU || name->ecu_instance > 7U ||
        name->function_instance > 31U || name->vehicle_system > 127U || name->system_instance > 15U || name->industry_group > 7U) {
        return lpvg_status_bad_argument;
    }
    uint64_t value = name->arbitrary ? 1U : 0U;
    value = (value << 3U) | name->industry_group;
    value = (value << 4U) | name->system_instance;
    value = (value << 7U) | name->vehicle_system;
    value = (value << 9U) | name->function;  // a reserved bit, zero, in between
    value = (value << 5U) | name->function_instance;
    value = (value << 3U) | name->ecu_instance;
    value = (value << 11U) | name->manufacturer;
    *packed = (value << 21U) | name->identity;
    return lpvg_status_ok;
}

lpvg_status_t lpvg_j1939_init(lpvg_j1939_t* self, const lpvg_j1939_config_t* config, lpvg_j1939_memory_t* memory, int64_t now_us,
                              bool* kept) {
    if (self == nullptr || config == nullptr || memory == nullptr || config->address > address_max || now_us < 0 ||
        now_us > INT64_MAX / 2) {
        return lpvg_status_bad_argument;
    }
    const bool well = memory->version == memory_version && memory->crc32 == crc_of(*memory);
    if (!well) {
        std::memset(memory, 0, sizeof *memory);
        memory->version = memory_version;
    }
    for (Entry& entry : memory->entry) {
        entry.active = 0U;
    }
    count(memory->runs);
    memory->crc32 = crc_of(*memory);
    std::memset(self, 0, sizeof *self);
    self->config = *config;
    self->memory = memory;
    self->now_us = now_us;
    self->address = LPVG_J1939_ADDRESS_NULL;
    self->dm1_us = now_us - LPVG_J1939_DM1_US;
    for (int64_t& told_us : self->told_us) {
        told_us = self->dm1_us;
    }
    if (kept != nullptr) {
        *kept = well;
    }
    return lpvg_status_ok;
}

lpvg_status_t lpvg_j1939_step(lpvg_j1939_t* self, int64_t now_us, const lpvg_can_frame_t* frames_in, size_t n_in,
                              const lpvg_j1939_findings_t* findings, lpvg_can_frame_t* frames_out, size_t max_out, size_t* n_out) {
    if (n_out != nullptr) {
        *n_out = 0U;
    }
    if (self == nullptr || (frames_in == nullptr && n_in > 0U) || findings == nullptr || frames_out == nullptr || n_out == nullptr ||
        max_out < LPVG_J1939_FRAMES_OUT || !good(*findings)) {
        return lpvg_status_bad_argument;
    }
    if (self->memory == nullptr) {
        return lpvg_status_not_ready;
    }
    if (now_us < self->now_us || now_us > INT64_MAX / 2) {
        return lpvg_status_out_of_order;
    }
    self->now_us = now_us;
    self->n_answers = 0U;
    if (self->state == lpvg_j1939_state_none) {
        claim(*self, self->config.address);
    }
    for (size_t i = 0U; i < n_in; ++i) {
        take_frame(*self, frames_in[i]);
    }
    take_findings(*self, *findings);
    if (self->changed) {
        self->memory->crc32 = crc_of(*self->memory);
        self->changed = false;
    }
    Out out(frames_out, now_us);
    send(*self, out);
    *n_out = out.size();
    return lpvg_status_ok;
}

bool lpvg_j1939_pass(const lpvg_j1939_t* self, lpvg_can_frame_t* frame) {
    if (self == nullptr || frame == nullptr || self->state != lpvg_j1939_state_claimed || ((frame->id >> 8U) & 0x3FFFFU) == pgn_dm1) {
        return false;
    }
    frame->id = (frame->id & 0xFFFFFF00U) | self->address;
    return true;
}

uint8_t lpvg_j1939_address(const lpvg_j1939_t* self) {
    return self != nullptr && self->state == lpvg_j1939_state_claimed ? self->address : static_cast<uint8_t>(LPVG_J1939_ADDRESS_NULL);
}

const lpvg_j1939_entry_t* lpvg_j1939_entry(const lpvg_j1939_t* self, uint8_t index) {
    if (self == nullptr || self->memory == nullptr || index >= LPVG_J1939_CODES_MAX || !lpvguard::remembered(self->memory->entry[index])) {
        return nullptr;
    }
    return &self->memory->entry[index];
}

}  // extern "C"
