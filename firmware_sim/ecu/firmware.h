/* firmware.h -- the guarded controller's firmware, the same on every target: bus -> lpvg_ecu_step -> bus.
 *
 * Ports supply a clock, a bus driver and a call of firmware_tick every sample period of the vehicle. */
#ifndef LPVGUARD_FIRMWARE_H
#define LPVGUARD_FIRMWARE_H

#include "bus.h"
#include "lpvguard/ecu.h"

LPVG_EXTERN_C_BEGIN

/* Frames taken in one tick; further ones wait for the next. A 250 kbit/s bus carries at most 20 in 10 ms. */
#define FIRMWARE_FRAMES_IN 32u

typedef struct firmware_t {
    lpvg_ecu_t ecu;
    const bus_t* bus;
    lpvg_can_frame_t in[FIRMWARE_FRAMES_IN];
    uint32_t send_failures; /* saturating */
} firmware_t;

/* The configuration that the simulator and the targets run: engagement is asked for, and every cause releases. */
extern const lpvg_ecu_config_t firmware_config;

/* Starts with the vehicle that is linked in. Returns what lpvg_ecu_init says, bad_argument for NULL. */
LPVG_NODISCARD lpvg_status_t firmware_init(firmware_t* self, const bus_t* bus, const lpvg_ecu_config_t* config, int64_t now_us);

/* One sample period. Returns what lpvg_ecu_step says. */
LPVG_NODISCARD lpvg_status_t firmware_tick(firmware_t* self, int64_t now_us);

LPVG_EXTERN_C_END

#endif
