// xcp_ecu.cpp -- an ECU with an XCP slave on the emulated Cortex-R5F: one step for each VDC2 that comes, and one at first.
#include "can0.h"
#include "lpvg_can_codec.h"
#include "lpvguard/ecu.h"
#include "lpvguard/xcp.h"

lpvg_ecu_t ecu;

namespace {

constexpr uint32_t period_us = 10'000U;
constexpr uint32_t to_slave = 0x98EF27F9U, to_master = 0x98EFF927U;
can0_t can;
bus_t bus;
lpvg_xcp_t slave;

void step(int64_t now_us, const lpvg_can_frame_t* in, size_t n_in) {
    lpvg_can_frame_t out[LPVG_ECU_FRAMES_OUT], list[LPVG_XCP_ODTS_MAX];
    size_t n_out = 0U;
    if (lpvg_ecu_step(&ecu, now_us, in, n_in, out, LPVG_ECU_FRAMES_OUT, &n_out) == lpvg_status_ok) {
        for (size_t i = 0U; i < n_out; ++i) {
            (void)bus_send(&bus, &out[i]);
        }
    }
    const size_t n_list = lpvg_xcp_event(&slave, now_us, list, LPVG_XCP_ODTS_MAX);
    for (size_t i = 0U; i < n_list; ++i) {
        (void)bus_send(&bus, &list[i]);
    }
}

}  // namespace

int main() {
    const lpvg_ecu_config_t config = {true, 0U, 0U, false, {2.07F, 5.0F, 1.5F, 0.15F, 100U}, {0.14F, 0.04F, 30U, 0.32F}};
    const lpvg_xcp_range_t range = {static_cast<uint32_t>(reinterpret_cast<uintptr_t>(&ecu)), sizeof ecu, &ecu};
    const lpvg_xcp_config_t xcp = {to_slave, to_master, "truck", &range, 1U, period_us};
    if (lpvg_ecu_init(&ecu, &lpvg_coeff, &lpvg_control_coeff, &config, 0) != lpvg_status_ok ||
        lpvg_xcp_init(&slave, &xcp) != lpvg_status_ok) {
        return 1;
    }
    can0_open(&can, &bus);
    can.also = to_slave;
    int64_t now_us = 0;
    step(now_us, nullptr, 0U);
    lpvg_can_frame_t in[LPVG_ECU_FRAMES_IN];
    size_t n_in = 0U;
    for (;;) {
        lpvg_can_frame_t answer;
        can0_await(&can, 1U);
        if (!bus_receive(&bus, now_us, &in[n_in])) {
            continue;
        }
        if (in[n_in].id == to_slave) {
            if (lpvg_xcp_receive(&slave, &in[n_in], &answer)) {
                (void)bus_send(&bus, &answer);
            }
            continue;
        }
        const bool last = in[n_in].id == LPVG_CAN_VDC2_ID;
        ++n_in;
        if (last || n_in == LPVG_ECU_FRAMES_IN) {
            now_us += period_us;
            step(now_us, in, n_in);
            n_in = 0U;
        }
    }
}
