/* filter.h -- filter of a firmware's driver: it passes frames that match a rule of the vehicle, authenticators, and error reports. */
#ifndef LPVGUARD_FIRMWARE_FILTER_H
#define LPVGUARD_FIRMWARE_FILTER_H

#include <stdbool.h>
#include <stddef.h>

#include "firmware.h"
#include "lpvguard/bus.h"

#define FILTER_ANY_PRIORITY 0xE3FFFFFFu /* flags and identifier without the priority of J1939 */

/* Tells if a frame is the command message or its authenticator, which lpvguard defines on every bus. */
static inline bool filter_is_ours(const lpvg_can_frame_t* frame) {
    return ((frame->id ^ lpvg_bus.command_id) & FILTER_ANY_PRIORITY) == 0u ||
           ((frame->id ^ lpvg_bus.authenticator_id) & FILTER_ANY_PRIORITY) == 0u;
}

static inline bool filter_passes(const lpvg_can_frame_t* frame) {
    size_t i;
    lpvg_can_frame_t taken = *frame;
    if (filter_is_ours(frame) || (frame->id & LPVG_CAN_ERROR) != 0u) {
        return true;
    }
#if FIRMWARE_OWN_BUS
    {
        lpvg_can_own_t scratch = {0};
        if (lpvg_can_own_take(&scratch, frame->id, frame->data, frame->dlc, frame->t_us, &taken) != lpvg_status_ok) {
            return false;
        }
    }
#endif
    for (i = 0u; i < lpvg_bus.n_rules; ++i) {
        if (((taken.id ^ lpvg_bus.rules[i].id) & lpvg_bus.rules[i].id_mask) == 0u) {
            return true;
        }
    }
    return false;
}

#endif
