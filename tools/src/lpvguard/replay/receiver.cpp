// receiver.cpp -- the frames of a log through supervision and decoder as on the ECU, for lpvguard.replay.receive (ctypes). Not part
// of the ECU image. lpvgb_take is generated (receive.py): it decodes an accepted frame of message `index` into `values`.
#include <algorithm>
#include <cmath>
#include <cstddef>
#include <cstring>
#include <vector>

#include "lpvg_can_codec.h"
#ifdef LPVGB_OWN_BUS  // the car's frames become the codec's first (can/own_code.py)
#include "lpvg_can_own.h"
#endif

extern "C" {

void lpvgb_take(double* values, uint8_t index, const lpvg_can_frame_t* frame);

void lpvgb_receiver_sizes(uint32_t* sizes) {
    sizes[0] = LPVG_CAN_RULES;
    sizes[1] = lpvg_can_event_count;
}

struct lpvgb_receiver_t {
    lpvg_can_supervisor_t supervisor;
#ifdef LPVGB_OWN_BUS
    lpvg_can_own_t own;
#endif
    std::vector<double> newest;  // of each value, NaN: none yet
};

// A receiver of n_values values whose clock begins at start_us. NULL when the supervision refuses its rules or the time.
lpvgb_receiver_t* lpvgb_receiver_create(int64_t start_us, int64_t n_values) {
    auto* self = new lpvgb_receiver_t{};
    self->newest.assign(static_cast<size_t>(n_values), static_cast<double>(NAN));
    if (lpvg_can_init(&self->supervisor, lpvg_can_rules, LPVG_CAN_RULES, start_us) != lpvg_status_ok) {
        delete self;
        return nullptr;
    }
    return self;
}

void lpvgb_receiver_destroy(lpvgb_receiver_t* self) { delete self; }

// Frames [n] in order of time, data [n][width] with width >= 8, lengths as they were on the bus. Tick k = 0 .. n_ticks - 1 is at
// first_us + k * period_us and sees every frame up to then, as a step of the ECU does: values [n_ticks][n_values] become the
// newest accepted ones, states [n_ticks][rules] the supervision's. counts [rules + 1][events]: what became of the frames since
// the beginning, the last row for those of no rule. Frames after the last tick are not looked at. Returns how many frames were,
// or -1 when the supervision refuses the time.
int64_t lpvgb_receive(lpvgb_receiver_t* self, int64_t n, const int64_t* t_us, const uint32_t* id, const uint8_t* length,
                      const uint8_t* data, int64_t width, int64_t first_us, int64_t period_us, int64_t n_ticks, double* values,
                      uint8_t* states, uint32_t* counts) {
    const size_t n_values = self->newest.size();
    int64_t i = 0;
    for (int64_t k = 0; k < n_ticks; ++k) {
        const int64_t now_us = first_us + k * period_us;
        for (; i < n && t_us[i] <= now_us; ++i) {
            lpvg_can_frame_t frame{};
#ifdef LPVGB_OWN_BUS
            if (lpvg_can_own_take(&self->own, id[i], data + i * width, length[i], t_us[i], &frame) != lpvg_status_ok) {
                return -1;
            }
#else
            frame.id = id[i];
            frame.dlc = length[i];
            frame.t_us = t_us[i];
            std::memcpy(frame.data, data + i * width, sizeof frame.data);
#endif
            uint8_t index = LPVG_CAN_NO_INDEX;
            if (lpvg_can_receive(&self->supervisor, &frame, &index) == lpvg_can_event_accepted) {
                lpvgb_take(self->newest.data(), index, &frame);
            }
        }
        lpvg_can_advance(&self->supervisor, now_us);
        std::copy(self->newest.begin(), self->newest.end(), values + static_cast<size_t>(k) * n_values);
        for (uint8_t rule = 0U; rule < LPVG_CAN_RULES; ++rule) {
            states[k * LPVG_CAN_RULES + rule] = static_cast<uint8_t>(lpvg_can_state(&self->supervisor, rule));
        }
    }
    for (uint8_t rule = 0U; rule < LPVG_CAN_RULES; ++rule) {
        std::memcpy(counts + rule * lpvg_can_event_count, self->supervisor.watch[rule].count, sizeof self->supervisor.watch[rule].count);
    }
    std::memcpy(counts + LPVG_CAN_RULES * lpvg_can_event_count, self->supervisor.count, sizeof self->supervisor.count);
    return i;
}

}  // extern "C"
