// receiver.cpp -- the frames of a log through supervision and decoder as on the ECU, for lpvguard.replay.receive (ctypes). Not part
// of the ECU image. lpvgb_take is generated (receive.py): it decodes an accepted frame of message `index` into `values`.
#include <cmath>
#include <cstddef>
#include <cstring>

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

// Frames [n] in order of time, data [n][width] with width >= 8, lengths as they were on the bus. Tick k = 0 .. n_ticks - 1 is at
// first_us + k * period_us and sees every frame up to then, as a step of the ECU does: values [n_ticks][n_values] become the
// newest accepted ones (NaN: none yet), states [n_ticks][rules] the supervision's. counts [rules + 1][events]: what became of
// the frames, the last row for those of no rule. Returns 0, or -1 when the supervision refuses its rules or the time.
int lpvgb_receive(int64_t n, const int64_t* t_us, const uint32_t* id, const uint8_t* length, const uint8_t* data, int64_t width,
                  int64_t first_us, int64_t period_us, int64_t n_ticks, int64_t n_values, double* values, uint8_t* states,
                  uint32_t* counts) {
    lpvg_can_supervisor_t supervisor{};
    if (lpvg_can_init(&supervisor, lpvg_can_rules, LPVG_CAN_RULES, n > 0 && t_us[0] < first_us ? t_us[0] : first_us) != lpvg_status_ok) {
        return -1;
    }
#ifdef LPVGB_OWN_BUS
    lpvg_can_own_t own{};
#endif
    int64_t i = 0;
    for (int64_t k = 0; k < n_ticks; ++k) {
        double* row = values + k * n_values;
        for (int64_t j = 0; j < n_values; ++j) {
            row[j] = k > 0 ? (row - n_values)[j] : static_cast<double>(NAN);
        }
        const int64_t now_us = first_us + k * period_us;
        for (; i < n && t_us[i] <= now_us; ++i) {
            lpvg_can_frame_t frame{};
#ifdef LPVGB_OWN_BUS
            if (lpvg_can_own_take(&own, id[i], data + i * width, length[i], t_us[i], &frame) != lpvg_status_ok) {
                return -1;
            }
#else
            frame.id = id[i];
            frame.dlc = length[i];
            frame.t_us = t_us[i];
            std::memcpy(frame.data, data + i * width, sizeof frame.data);
#endif
            uint8_t index = LPVG_CAN_NO_INDEX;
            if (lpvg_can_receive(&supervisor, &frame, &index) == lpvg_can_event_accepted) {
                lpvgb_take(row, index, &frame);
            }
        }
        lpvg_can_advance(&supervisor, now_us);
        for (uint8_t rule = 0U; rule < LPVG_CAN_RULES; ++rule) {
            states[k * LPVG_CAN_RULES + rule] = static_cast<uint8_t>(lpvg_can_state(&supervisor, rule));
        }
    }
    for (uint8_t rule = 0U; rule < LPVG_CAN_RULES; ++rule) {
        std::memcpy(counts + rule * lpvg_can_event_count, supervisor.watch[rule].count, sizeof supervisor.watch[rule].count);
    }
    std::memcpy(counts + LPVG_CAN_RULES * lpvg_can_event_count, supervisor.count, sizeof supervisor.count);
    return 0;
}

}  // extern "C"
