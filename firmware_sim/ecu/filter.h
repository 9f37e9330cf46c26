/* filter.h -- which frames a firmware's driver hands on: those that a rule of its vehicle matches, and error reports. */
#ifndef LPVGUARD_FIRMWARE_FILTER_H
#define LPVGUARD_FIRMWARE_FILTER_H

#include <stdbool.h>
#include <stddef.h>

#include "lpvguard/bus.h"

static inline bool filter_passes(const lpvg_can_frame_t* frame) {
    size_t i;
    for (i = 0u; i < lpvg_bus.n_rules; ++i) {
        if (((frame->id ^ lpvg_bus.rules[i].id) & lpvg_bus.rules[i].id_mask) == 0u) {
            return true;
        }
    }
    return (frame->id & LPVG_CAN_ERROR) != 0u;
}

#endif
