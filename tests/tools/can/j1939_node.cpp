// One node of the core's J1939 module behind plain arguments, for Python.
#include <cstring>

#include "lpvguard/j1939.h"
#include "lpvguard/uds.h"

namespace {

lpvg_j1939_t node;
lpvg_j1939_memory_t memory;

}  // namespace

extern "C" {

uint64_t node_name(const uint32_t* field) {
    lpvg_j1939_name_t name{};
    name.identity = field[0];
    name.manufacturer = static_cast<uint16_t>(field[1]);
    name.ecu_instance = static_cast<uint8_t>(field[2]);
    name.function_instance = static_cast<uint8_t>(field[3]);
    name.function = static_cast<uint8_t>(field[4]);
    name.vehicle_system = static_cast<uint8_t>(field[5]);
    name.system_instance = static_cast<uint8_t>(field[6]);
    name.industry_group = static_cast<uint8_t>(field[7]);
    name.arbitrary = field[8] != 0U;
    uint64_t packed = 0U;
    return lpvg_j1939_name_pack(&name, &packed) == lpvg_status_ok ? packed : 0U;
}

int node_start(uint64_t name, uint8_t address, int64_t now_us) {
    std::memset(&memory, 0, sizeof memory);
    const lpvg_j1939_config_t config = {name, address};
    return lpvg_j1939_init(&node, &config, &memory, now_us, nullptr);
}

// Frames are an identifier each (29 bits), a length, and eight bytes. Returns how many were sent; below 0: the status, negative.
int node_step(int64_t now_us, const uint32_t* id, const uint8_t* dlc, const uint8_t* data, size_t n, const uint32_t* spn,
              const uint8_t* fmi, size_t n_codes, uint32_t* id_out, uint8_t* data_out) {
    lpvg_can_frame_t in[64] = {}, out[LPVG_J1939_FRAMES_OUT];
    lpvg_j1939_findings_t findings{};
    if (n > 64U || n_codes > LPVG_J1939_CODES_MAX) {
        return -static_cast<int>(lpvg_status_bad_argument);
    }
    for (size_t i = 0; i < n; ++i) {
        in[i].id = LPVG_CAN_EXTENDED | id[i];
        in[i].dlc = dlc[i];
        std::memcpy(in[i].data, &data[8U * i], 8U);
    }
    findings.freeze = {now_us, 1.5F, 12.5F, 0U, 0x1240U, 9U, 0U};
    findings.n_codes = static_cast<uint8_t>(n_codes);
    for (size_t i = 0; i < n_codes; ++i) {
        findings.code[i] = {spn[i], fmi[i], 0U};
    }
    size_t n_out = 0;
    const lpvg_status_t status = lpvg_j1939_step(&node, now_us, in, n, &findings, out, LPVG_J1939_FRAMES_OUT, &n_out);
    for (size_t i = 0; i < n_out; ++i) {
        id_out[i] = out[i].id & 0x1FFFFFFFU;
        std::memcpy(&data_out[8U * i], out[i].data, 8U);
    }
    return status == lpvg_status_ok ? static_cast<int>(n_out) : -static_cast<int>(status);
}

size_t node_uds(const uint8_t* request, size_t n, uint8_t* answer) {
    return lpvg_uds_answer(&node, request, n, answer, LPVG_UDS_ANSWER_MAX);
}

int node_address(void) { return lpvg_j1939_address(&node); }

}  // extern "C"
