// One slave of lpvguard/xcp.h behind plain arguments, for Python. It may read one piece of memory.
#include <cstring>

#include "lpvguard/xcp.h"

namespace {

constexpr uint32_t place = 0x20000000U;
uint8_t memory[256];
const lpvg_xcp_range_t range = {place, sizeof memory, memory};
lpvg_xcp_t slave;

}  // namespace

extern "C" {

int slave_start(uint32_t receive_id, uint32_t send_id) {
    const lpvg_xcp_config_t config = {receive_id, send_id, "a slave to read", &range, 1U, 10'000U};
    return lpvg_xcp_init(&slave, &config);
}

void slave_write(uint32_t offset, const uint8_t* bytes, size_t n) { std::memcpy(&memory[offset], bytes, n); }

// Bytes of the answer; 0: none.
size_t slave_receive(uint32_t id, const uint8_t* bytes, uint8_t n, uint8_t* answer) {
    lpvg_can_frame_t frame{}, out{};
    frame.id = id;
    frame.dlc = n;
    std::memcpy(frame.data, bytes, n);
    if (!lpvg_xcp_receive(&slave, &frame, &out)) {
        return 0U;
    }
    std::memcpy(answer, out.data, out.dlc);
    return out.dlc;
}

// Frames of an event: eight bytes each, and how many of them count.
size_t slave_event(uint8_t* data, uint8_t* n) {
    lpvg_can_frame_t out[LPVG_XCP_ODTS_MAX];
    const size_t n_out = lpvg_xcp_event(&slave, 0, out, LPVG_XCP_ODTS_MAX);
    for (size_t i = 0; i < n_out; ++i) {
        std::memcpy(&data[8U * i], out[i].data, 8U);
        n[i] = out[i].dlc;
    }
    return n_out;
}

}  // extern "C"
