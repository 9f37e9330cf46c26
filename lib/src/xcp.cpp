// xcp.cpp -- see xcp.h.
#include "lpvguard/xcp.h"

#include <cstring>

namespace {

constexpr uint32_t name_max = 255U;
constexpr uint8_t n_data = 8U, ok = 0xFFU, error = 0xFEU, version = 0x01U, with_optional = 0x80U, id_text = 0U;

enum Command : uint8_t {
    connect = 0xFFU,
    disconnect = 0xFEU,
    get_status = 0xFDU,
    synch = 0xFCU,
    get_comm_mode_info = 0xFBU,
    get_id = 0xFAU,
    set_mta = 0xF6U,
    upload = 0xF5U,
    short_upload = 0xF4U,
    download = 0xF0U,
    modify_bits = 0xECU  // with those between: all that write to memory
};

uint32_t word_of(const uint8_t* bytes) {
    uint32_t word{};
    std::memcpy(&word, bytes, sizeof word);
    return word;
}

uint8_t big_endian() {
    const uint16_t one = 0x0001U;
    uint8_t first{};
    std::memcpy(&first, &one, sizeof first);
    return static_cast<uint8_t>(one - first);
}

// What the master is answered.
class Answer {
public:
    explicit Answer(lpvg_can_frame_t& frame) : frame_(frame) { put(ok); }
    void put(uint8_t byte) {
        frame_.data[frame_.dlc] = byte;
        ++frame_.dlc;
    }
    void put(const uint8_t* bytes, uint8_t n) {
        std::memcpy(&frame_.data[frame_.dlc], bytes, n);
        frame_.dlc = static_cast<uint8_t>(frame_.dlc + n);
    }
    void fail(uint8_t code) {
        frame_.dlc = 0U;
        put(error);
        put(code);
    }

private:
    lpvg_can_frame_t& frame_;
};

// Bytes that a command has at least.
uint8_t length_of(uint8_t command) {
    switch (command) {
        case connect:
        case get_id:
        case upload: return 2U;
        case set_mta:
        case short_upload: return 8U;
        default: return 1U;
    }
}

// The memory that an address and a length name; NULL where no range holds all of it.
const uint8_t* memory(const lpvg_xcp_t& self, uint32_t address, uint8_t n) {
    for (uint8_t i = 0U; i < self.config.n_ranges; ++i) {
        const lpvg_xcp_range_t& range = self.config.ranges[i];
        const uint32_t offset = address - range.address;  // of an address below it beyond every range that ends at 2^32
        if (uint64_t{offset} + n <= range.bytes) {
            return static_cast<const uint8_t*>(range.data) + offset;
        }
    }
    return nullptr;
}

const uint8_t* name_from(const lpvg_xcp_t& self, uint8_t n) {
    return self.mta + n <= self.name_bytes ? reinterpret_cast<const uint8_t*>(self.config.name) + self.mta : nullptr;
}

void put_memory(lpvg_xcp_t& self, uint8_t n, Answer& answer) {
    if (n == 0U || n >= n_data) {
        answer.fail(LPVG_XCP_ERR_OUT_OF_RANGE);
        return;
    }
    const uint8_t* const bytes = self.in_name ? name_from(self, n) : memory(self, self.mta, n);
    if (bytes == nullptr) {
        answer.fail(LPVG_XCP_ERR_ACCESS_DENIED);
        return;
    }
    answer.put(bytes, n);
    self.mta += n;
}

// Extension and address in the last five bytes of a command.
bool take_address(lpvg_xcp_t& self, const uint8_t* command, Answer& answer) {
    if (command[3] != 0U) {
        answer.fail(LPVG_XCP_ERR_OUT_OF_RANGE);
        return false;
    }
    self.mta = word_of(&command[4]);
    self.in_name = false;
    return true;
}

void put_id(lpvg_xcp_t& self, uint8_t type, Answer& answer) {
    const uint32_t length = type == id_text ? self.name_bytes : 0U;
    const uint8_t uploaded[3] = {};
    uint8_t bytes[sizeof length] = {};
    std::memcpy(bytes, &length, sizeof length);
    answer.put(uploaded, sizeof uploaded);
    answer.put(bytes, sizeof bytes);
    self.mta = 0U;
    self.in_name = type == id_text;
}

void put_zeros(uint8_t n, Answer& answer) {
    const uint8_t zeros[n_data] = {};
    answer.put(zeros, n);
}

void put_connected(lpvg_xcp_t& self, Answer& answer) {
    const uint16_t longest = n_data;
    uint8_t bytes[sizeof longest] = {};
    std::memcpy(bytes, &longest, sizeof longest);
    self.connected = true;
    self.in_name = false;
    self.mta = 0U;
    answer.put(0U);  // neither calibration nor DAQ, stimulation or programming
    answer.put(static_cast<uint8_t>(with_optional | big_endian()));
    answer.put(n_data);
    answer.put(bytes, sizeof bytes);
    answer.put(version);
    answer.put(version);
}

void execute(lpvg_xcp_t& self, const uint8_t* command, Answer& answer) {
    switch (command[0]) {
        case connect: put_connected(self, answer); break;
        case disconnect: self.connected = false; break;
        case get_status: put_zeros(5U, answer); break;
        case synch: answer.fail(LPVG_XCP_ERR_SYNCH); break;
        case get_comm_mode_info:
            put_zeros(6U, answer);
            answer.put(version);
            break;
        case get_id: put_id(self, command[1], answer); break;
        case set_mta: (void)take_address(self, command, answer); break;
        case short_upload:
            if (take_address(self, command, answer)) {
                put_memory(self, command[1], answer);
            }
            break;
        case upload: put_memory(self, command[1], answer); break;
        default:
            answer.fail(command[0] >= modify_bits && command[0] <= download ? LPVG_XCP_ERR_ACCESS_DENIED : LPVG_XCP_ERR_UNKNOWN);
            break;
    }
}

uint32_t length_of_name(const char* name) {
    uint32_t n = 0U;
    while (n <= name_max && name[n] != 0) {
        ++n;
    }
    return n;
}

bool readable(const lpvg_xcp_config_t& config) {
    bool good = config.n_ranges >= 1U && config.n_ranges <= LPVG_XCP_RANGES_MAX;
    for (uint8_t i = 0U; good && i < config.n_ranges; ++i) {
        const lpvg_xcp_range_t& range = config.ranges[i];
        good = range.data != nullptr && range.bytes > 0U && range.bytes - 1U <= UINT32_MAX - range.address;
    }
    return good;
}

}  // namespace

extern "C" {

lpvg_status_t lpvg_xcp_init(lpvg_xcp_t* self, const lpvg_xcp_config_t* config) {
    if (self == nullptr || config == nullptr || config->name == nullptr || config->ranges == nullptr ||
        config->receive_id == config->send_id || !readable(*config)) {
        return lpvg_status_bad_argument;
    }
    const uint32_t name_bytes = length_of_name(config->name);
    if (name_bytes > name_max) {
        return lpvg_status_bad_argument;
    }
    *self = lpvg_xcp_t{};
    self->config = *config;
    self->name_bytes = name_bytes;
    return lpvg_status_ok;
}

bool lpvg_xcp_receive(lpvg_xcp_t* self, const lpvg_can_frame_t* frame, lpvg_can_frame_t* out) {
    if (self == nullptr || frame == nullptr || out == nullptr || self->config.ranges == nullptr || frame->id != self->config.receive_id ||
        frame->dlc < 1U || frame->dlc > n_data || (!self->connected && frame->data[0] != connect)) {
        return false;
    }
    uint8_t command[n_data] = {};
    std::memcpy(command, frame->data, frame->dlc);
    lpvg_can_frame_t made{};
    made.id = self->config.send_id;
    made.t_us = frame->t_us;
    Answer answer(made);
    if (frame->dlc < length_of(command[0])) {
        answer.fail(LPVG_XCP_ERR_SYNTAX);
    } else {
        execute(*self, command, answer);
    }
    self->commands += self->commands < UINT32_MAX ? 1U : 0U;
    self->errors += made.data[0] == error && made.data[1] != LPVG_XCP_ERR_SYNCH && self->errors < UINT32_MAX ? 1U : 0U;
    *out = made;
    return true;
}

}  // extern "C"
