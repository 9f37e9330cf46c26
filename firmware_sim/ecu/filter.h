/* filter.h -- filter of a firmware's driver: it passes frames that match a rule of the vehicle, authenticators, and error reports. */
#ifndef LPVGUARD_FIRMWARE_FILTER_H
#define LPVGUARD_FIRMWARE_FILTER_H

#include <stdbool.h>
#include <stddef.h>

#include "lpvguard/bus.h"

#define FILTER_ANY_PRIORITY 0xE3FFFFFFu /* flags and identifier without the priority of J1939 */

static inline bool filter_passes(const lpvg_can_frame_t* frame) {
    size_t i;
    for (i = 0u; i < lpvg_bus.n_rules; ++i) {
        if (((frame->id ^ lpvg_bus.rules[i].id) & lpvg_bus.rules[i].id_mask) == 0u) {
            return true;
        }
    }
    return ((frame->id ^ lpvg_bus.authenticator_id) & FILTER_ANY_PRIORITY) == 0u || (frame->id & LPVG_CAN_ERROR) != 0u;
}

#endif
