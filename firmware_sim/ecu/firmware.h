/* firmware.h -- the guarded controller's firmware, the same on every target: bus -> authentication -> lpvg_ecu_step -> bus.
 *
 * Ports supply a clock, a bus driver, a call of firmware_tick every sample period of the vehicle, and one of firmware_idle in the time that
 * is left of it. */
#ifndef LPVGUARD_FIRMWARE_H
#define LPVGUARD_FIRMWARE_H

#include "bus.h"
#include "lpvguard/authentication.h"
#include "lpvguard/diagnosis.h"
#include "lpvguard/ecu.h"

/* A vehicle without the table of causes is monitored all the same. */
#if __has_include("lpvguard_diagnosis.c")
#define FIRMWARE_DIAGNOSES 1
#else
#define FIRMWARE_DIAGNOSES 0
#endif

LPVG_EXTERN_C_BEGIN

/* Frames taken in one tick; further ones wait for the next. A 250 kbit/s bus carries at most 20 in 10 ms. */
#define FIRMWARE_FRAMES_IN 32u
#define FIRMWARE_PAIR_US 5000u /* longest time from a command to its authenticator */

/* What both ends of the command message's authentication share. */
typedef struct firmware_key_t {
    lpvg_can_cmac_t cmac;
    void* context;      /* first argument of cmac */
    uint64_t freshness; /* newest value that may have been used under the key */
} firmware_key_t;

typedef struct firmware_t {
    lpvg_ecu_t ecu;
    const bus_t* bus;
    lpvg_can_auth_t authentication; /* of the command message; not initialised without a key */
    lpvg_can_frame_t in[FIRMWARE_FRAMES_IN];
    uint32_t send_failures; /* saturating */
#if FIRMWARE_DIAGNOSES
    lpvg_diagnosis_t diagnosis;
#endif
} firmware_t;

/* The configuration that the simulator and the targets run: engagement is asked for, and every cause releases. */
extern const lpvg_ecu_config_t firmware_config;

/* Makes an end of the authentication of the vehicle's command message. Returns what lpvg_can_auth_init says. */
LPVG_NODISCARD lpvg_status_t firmware_authenticate(lpvg_can_auth_t* end, const firmware_key_t* key);

/* Starts with the vehicle that is linked in. Without a key (NULL) every command is obeyed, and each report says "not authenticated".
 * Returns what lpvg_ecu_init, lpvg_can_auth_init and lpvg_diagnosis_init say, bad_argument for another NULL. */
LPVG_NODISCARD lpvg_status_t firmware_init(firmware_t* self, const bus_t* bus, const lpvg_ecu_config_t* config, const firmware_key_t* key,
                                           int64_t now_us);

/* One sample period. Returns what lpvg_ecu_step says. */
LPVG_NODISCARD lpvg_status_t firmware_tick(firmware_t* self, int64_t now_us);

/* After a tick, before the next, where nothing waits for it: an alarm's cause is looked for, and DM1 tells it. */
void firmware_idle(firmware_t* self);

LPVG_EXTERN_C_END

#endif
