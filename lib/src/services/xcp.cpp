// xcp.cpp -- see xcp.h.
#include "lpvguard/xcp.h"

#include <cstring>

namespace {

constexpr uint32_t name_max = 255U;
constexpr uint8_t n_data = 8U, ok = 0xFFU, error = 0xFEU, version = 0x01U, with_optional = 0x80U, id_text = 0U;
constexpr uint8_t with_daq = 0x04U, session_daq = 0x40U, mode_selected = 0x01U, mode_running = 0x40U;
constexpr uint8_t daq_dynamic = 0x01U, daq_prescaler = 0x02U, event_daq = 0x04U, event_consistent = 0x80U;
constexpr uint8_t stop = 0U, start = 1U, select = 2U, start_selected = 1U, stop_selected = 2U, no_bit = 0xFFU;
constexpr uint8_t cycle_unit_us = 3U, cycle_max = 255U;
constexpr char event_name[] = LPVG_XCP_EVENT_NAME;

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
    modify_bits = 0xECU,  // with those between: all that write to memory
    clear_daq_list = 0xE3U,
    set_daq_ptr = 0xE2U,
    write_daq = 0xE1U,
    set_daq_list_mode = 0xE0U,
    get_daq_list_mode = 0xDFU,
    start_stop_daq_list = 0xDEU,
    start_stop_synch = 0xDDU,
    get_daq_processor_info = 0xDAU,
    get_daq_resolution_info = 0xD9U,
    get_daq_event_info = 0xD7U,
    free_daq = 0xD6U,
    alloc_daq = 0xD5U,
    alloc_odt = 0xD4U,
    alloc_odt_entry = 0xD3U
};

uint32_t word_of(const uint8_t* bytes) {
    uint32_t word{};
    std::memcpy(&word, bytes, sizeof word);
    return word;
}

uint16_t half_of(const uint8_t* bytes) {
    uint16_t half{};
    std::memcpy(&half, bytes, sizeof half);
    return half;
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
    void put_half(uint16_t half) {
        uint8_t bytes[sizeof half] = {};
        std::memcpy(bytes, &half, sizeof half);
        put(bytes, sizeof bytes);
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
        case upload:
        case start_stop_synch: return 2U;
        case clear_daq_list:
        case get_daq_list_mode:
        case start_stop_daq_list:
        case get_daq_event_info:
        case alloc_daq: return 4U;
        case alloc_odt: return 5U;
        case set_daq_ptr:
        case alloc_odt_entry: return 6U;
        case set_mta:
        case short_upload:
        case write_daq:
        case set_daq_list_mode: return 8U;
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

const uint8_t* text_from(const lpvg_xcp_t& self, uint8_t n) {
    return self.mta + n <= self.text_bytes ? reinterpret_cast<const uint8_t*>(self.text) + self.mta : nullptr;
}

void upload_text(lpvg_xcp_t& self, const char* text, uint32_t n) {
    self.text = text;
    self.text_bytes = n;
    self.mta = 0U;
}

void put_memory(lpvg_xcp_t& self, uint8_t n, Answer& answer) {
    if (n == 0U || n >= n_data) {
        answer.fail(LPVG_XCP_ERR_OUT_OF_RANGE);
        return;
    }
    const uint8_t* const bytes = self.text != nullptr ? text_from(self, n) : memory(self, self.mta, n);
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
    self.text = nullptr;
    return true;
}

void put_id(lpvg_xcp_t& self, uint8_t type, Answer& answer) {
    const uint32_t length = type == id_text ? self.name_bytes : 0U;
    const uint8_t uploaded[3] = {};
    uint8_t bytes[sizeof length] = {};
    std::memcpy(bytes, &length, sizeof length);
    answer.put(uploaded, sizeof uploaded);
    answer.put(bytes, sizeof bytes);
    upload_text(self, type == id_text ? self.config.name : nullptr, length);
}

void put_zeros(uint8_t n, Answer& answer) {
    const uint8_t zeros[n_data] = {};
    answer.put(zeros, n);
}

void put_connected(lpvg_xcp_t& self, Answer& answer) {
    self.connected = true;
    self.daq = lpvg_xcp_daq_t{};
    upload_text(self, nullptr, 0U);
    answer.put(with_daq);  // neither calibration, stimulation nor programming
    answer.put(static_cast<uint8_t>(with_optional | big_endian()));
    answer.put(n_data);
    answer.put_half(n_data);
    answer.put(version);
    answer.put(version);
}

void end_session(lpvg_xcp_t& self) {
    self.connected = false;
    self.daq = lpvg_xcp_daq_t{};
}

void put_status(const lpvg_xcp_t& self, Answer& answer) {
    answer.put(self.daq.running ? session_daq : uint8_t{0U});
    put_zeros(4U, answer);
}

void put_processor_info(const lpvg_xcp_daq_t& daq, Answer& answer) {
    answer.put(daq_dynamic | daq_prescaler);
    answer.put_half(daq.allocation >= lpvg_xcp_allocation_list ? 1U : 0U);
    answer.put_half(1U);  // event
    put_zeros(2U, answer);  // no list before the allocated one; a frame's first byte is its number
}

void put_resolution_info(Answer& answer) {
    answer.put(1U);
    answer.put(LPVG_XCP_ODT_ENTRIES_MAX);
    answer.put(1U);
    put_zeros(4U, answer);  // no stimulation, no time stamps
}

void put_event_info(lpvg_xcp_t& self, uint16_t event, Answer& answer) {
    if (event != 0U) {
        answer.fail(LPVG_XCP_ERR_OUT_OF_RANGE);
        return;
    }
    uint32_t cycle = self.config.period_us;
    uint8_t unit = cycle_unit_us;
    for (; cycle > cycle_max; cycle /= 10U) {
        ++unit;
    }
    constexpr auto name_bytes = static_cast<uint8_t>(sizeof event_name - 1U);
    upload_text(self, event_name, name_bytes);
    answer.put(event_daq | event_consistent);
    answer.put(1U);
    answer.put(name_bytes);
    answer.put(static_cast<uint8_t>(cycle));
    answer.put(unit);
    answer.put(0U);
}

void allocate_list(lpvg_xcp_daq_t& daq, uint16_t n, Answer& answer) {
    if (daq.allocation != lpvg_xcp_allocation_freed) {
        answer.fail(LPVG_XCP_ERR_SEQUENCE);
    } else if (n == 0U) {
        answer.fail(LPVG_XCP_ERR_OUT_OF_RANGE);
    } else if (n > 1U) {
        answer.fail(LPVG_XCP_ERR_MEMORY_OVERFLOW);
    } else {
        daq.allocation = lpvg_xcp_allocation_list;
    }
}

void allocate_odts(lpvg_xcp_daq_t& daq, uint8_t n, Answer& answer) {
    if (daq.allocation != lpvg_xcp_allocation_list) {
        answer.fail(LPVG_XCP_ERR_SEQUENCE);
    } else if (n == 0U) {
        answer.fail(LPVG_XCP_ERR_OUT_OF_RANGE);
    } else if (n > LPVG_XCP_ODTS_MAX) {
        answer.fail(LPVG_XCP_ERR_MEMORY_OVERFLOW);
    } else {
        daq.allocation = lpvg_xcp_allocation_odts;
        daq.n_odts = daq.next_odt = n;
    }
}

void allocate_entries(lpvg_xcp_daq_t& daq, uint8_t odt, uint8_t n, Answer& answer) {
    if (daq.allocation != lpvg_xcp_allocation_odts) {
        answer.fail(LPVG_XCP_ERR_SEQUENCE);
    } else if (odt >= daq.n_odts || n == 0U) {
        answer.fail(LPVG_XCP_ERR_OUT_OF_RANGE);
    } else if (n > LPVG_XCP_ODT_ENTRIES_MAX) {
        answer.fail(LPVG_XCP_ERR_MEMORY_OVERFLOW);
    } else {
        daq.odt[odt] = lpvg_xcp_odt_t{};
        daq.odt[odt].n_entries = n;
    }
}

void point(lpvg_xcp_daq_t& daq, uint8_t odt, uint8_t entry, Answer& answer) {
    if (odt >= daq.n_odts || entry >= daq.odt[odt].n_entries) {
        answer.fail(LPVG_XCP_ERR_OUT_OF_RANGE);
    } else {
        daq.next_odt = odt;
        daq.next_entry = entry;
    }
}

// Bytes of a frame but for those of one entry.
uint32_t bytes_beside(const lpvg_xcp_odt_t& odt, uint8_t entry) {
    uint32_t bytes = 0U;
    for (uint8_t i = 0U; i < odt.n_entries; ++i) {
        bytes += i == entry ? 0U : odt.bytes[i];
    }
    return bytes;
}

// Bit, length, extension and address in the command.
void write_entry(lpvg_xcp_t& self, const uint8_t* command, Answer& answer) {
    lpvg_xcp_daq_t& daq = self.daq;
    if (daq.next_odt >= daq.n_odts) {
        answer.fail(LPVG_XCP_ERR_SEQUENCE);
        return;
    }
    lpvg_xcp_odt_t& odt = daq.odt[daq.next_odt];
    const uint8_t n = command[2];
    if (command[1] != no_bit || n == 0U || command[3] != 0U || bytes_beside(odt, daq.next_entry) + n >= n_data) {
        answer.fail(LPVG_XCP_ERR_OUT_OF_RANGE);
        return;
    }
    const uint8_t* const bytes = memory(self, word_of(&command[4]), n);
    if (bytes == nullptr) {
        answer.fail(LPVG_XCP_ERR_ACCESS_DENIED);
        return;
    }
    odt.data[daq.next_entry] = bytes;
    odt.bytes[daq.next_entry] = n;
    ++daq.next_entry;
    daq.next_odt = daq.next_entry < odt.n_entries ? daq.next_odt : daq.n_odts;
}

void clear_list(lpvg_xcp_daq_t& daq) {
    for (uint8_t i = 0U; i < daq.n_odts; ++i) {
        const uint8_t n = daq.odt[i].n_entries;
        daq.odt[i] = lpvg_xcp_odt_t{};
        daq.odt[i].n_entries = n;
    }
    daq.next_odt = daq.n_odts;
    daq.running = daq.selected = false;
}

// Mode, event, prescaler and priority in the command.
void set_mode(lpvg_xcp_daq_t& daq, const uint8_t* command, Answer& answer) {
    if (command[1] != 0U) {
        answer.fail(LPVG_XCP_ERR_MODE);
    } else if (half_of(&command[4]) != 0U || command[6] == 0U || command[7] != 0U) {
        answer.fail(LPVG_XCP_ERR_OUT_OF_RANGE);
    } else {
        daq.prescaler = command[6];
    }
}

void put_mode(const lpvg_xcp_daq_t& daq, Answer& answer) {
    answer.put(static_cast<uint8_t>((daq.selected ? mode_selected : 0U) | (daq.running ? mode_running : 0U)));
    put_zeros(4U, answer);  // reserved, event
    answer.put(daq.prescaler);
    answer.put(0U);
}

// Every frame carries something, and a mode has been set.
bool complete(const lpvg_xcp_daq_t& daq) {
    bool good = daq.n_odts > 0U && daq.prescaler > 0U;
    for (uint8_t i = 0U; i < daq.n_odts; ++i) {
        good = good && bytes_beside(daq.odt[i], LPVG_XCP_ODT_ENTRIES_MAX) > 0U;
    }
    return good;
}

void run(lpvg_xcp_daq_t& daq) {
    daq.events = static_cast<uint8_t>(daq.prescaler - 1U);  // the next event is sent
    daq.running = true;
}

void start_stop_list(lpvg_xcp_daq_t& daq, uint8_t mode, Answer& answer) {
    if (mode > select) {
        answer.fail(LPVG_XCP_ERR_MODE);
    } else if (mode != stop && !complete(daq)) {
        answer.fail(LPVG_XCP_ERR_DAQ_CONFIG);
    } else {
        if (mode == start) {
            run(daq);
        }
        daq.running = daq.running && mode != stop;
        daq.selected = mode == select;
        answer.put(0U);  // number of the first frame
    }
}

void start_stop_selected(lpvg_xcp_daq_t& daq, uint8_t mode, Answer& answer) {
    if (mode > stop_selected) {
        answer.fail(LPVG_XCP_ERR_MODE);
        return;
    }
    if (mode == start_selected && daq.selected) {
        run(daq);
    }
    if (mode == stop || (mode == stop_selected && daq.selected)) {
        daq.running = false;
    }
    daq.selected = false;
}

// Commands that name a list. The number stands behind a byte of their own.
void execute_on_list(lpvg_xcp_t& self, const uint8_t* command, Answer& answer) {
    lpvg_xcp_daq_t& daq = self.daq;
    const bool changes = command[0] != get_daq_list_mode && command[0] != start_stop_daq_list && command[0] != clear_daq_list;
    if (daq.allocation < lpvg_xcp_allocation_list) {
        answer.fail(LPVG_XCP_ERR_SEQUENCE);
        return;
    }
    if (half_of(&command[2]) != 0U) {
        answer.fail(LPVG_XCP_ERR_OUT_OF_RANGE);
        return;
    }
    if (daq.running && changes) {
        answer.fail(LPVG_XCP_ERR_DAQ_ACTIVE);
        return;
    }
    switch (command[0]) {
        case alloc_odt: allocate_odts(daq, command[4], answer); break;
        case alloc_odt_entry: allocate_entries(daq, command[4], command[5], answer); break;
        case set_daq_ptr: point(daq, command[4], command[5], answer); break;
        case set_daq_list_mode: set_mode(daq, command, answer); break;
        case get_daq_list_mode: put_mode(daq, answer); break;
        case start_stop_daq_list: start_stop_list(daq, command[1], answer); break;
        default: clear_list(daq); break;
    }
}

void execute_on_lists(lpvg_xcp_t& self, const uint8_t* command, Answer& answer) {
    switch (command[0]) {
        case get_daq_processor_info: put_processor_info(self.daq, answer); break;
        case get_daq_resolution_info: put_resolution_info(answer); break;
        case get_daq_event_info: put_event_info(self, half_of(&command[2]), answer); break;
        case free_daq:
            self.daq = lpvg_xcp_daq_t{};
            self.daq.allocation = lpvg_xcp_allocation_freed;
            break;
        case alloc_daq: allocate_list(self.daq, half_of(&command[2]), answer); break;
        case start_stop_synch: start_stop_selected(self.daq, command[1], answer); break;
        case write_daq:
            if (self.daq.running) {
                answer.fail(LPVG_XCP_ERR_DAQ_ACTIVE);
            } else {
                write_entry(self, command, answer);
            }
            break;
        default: execute_on_list(self, command, answer); break;
    }
}

bool of_lists(uint8_t command) {
    return (command >= start_stop_synch && command <= clear_daq_list) ||
           (command >= get_daq_resolution_info && command <= get_daq_processor_info) ||
           (command >= alloc_odt_entry && command <= get_daq_event_info);
}

void execute(lpvg_xcp_t& self, const uint8_t* command, Answer& answer) {
    switch (command[0]) {
        case connect: put_connected(self, answer); break;
        case disconnect: end_session(self); break;
        case get_status: put_status(self, answer); break;
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
            if (of_lists(command[0])) {
                execute_on_lists(self, command, answer);
            } else {
                answer.fail(command[0] >= modify_bits && command[0] <= download ? LPVG_XCP_ERR_ACCESS_DENIED : LPVG_XCP_ERR_UNKNOWN);
            }
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
        config->receive_id == config->send_id || config->period_us == 0U || !readable(*config)) {
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

size_t lpvg_xcp_event(lpvg_xcp_t* self, int64_t now_us, lpvg_can_frame_t* out, size_t max_out) {
    if (self == nullptr || out == nullptr || !self->daq.running) {
        return 0U;
    }
    lpvg_xcp_daq_t& daq = self->daq;
    ++daq.events;
    if (daq.events < daq.prescaler) {
        return 0U;
    }
    daq.events = 0U;
    if (max_out < daq.n_odts) {
        self->missed += self->missed < UINT32_MAX ? 1U : 0U;
        return 0U;
    }
    for (uint8_t i = 0U; i < daq.n_odts; ++i) {
        const lpvg_xcp_odt_t& odt = daq.odt[i];
        lpvg_can_frame_t& frame = out[i];
        frame = lpvg_can_frame_t{};
        frame.id = self->config.send_id;
        frame.t_us = now_us;
        frame.data[0] = i;
        frame.dlc = 1U;
        for (uint8_t k = 0U; k < odt.n_entries; ++k) {
            if (odt.bytes[k] > 0U) {
                std::memcpy(&frame.data[frame.dlc], odt.data[k], odt.bytes[k]);
                frame.dlc = static_cast<uint8_t>(frame.dlc + odt.bytes[k]);
            }
        }
    }
    return daq.n_odts;
}

}  // extern "C"
