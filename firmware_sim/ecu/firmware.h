/* firmware.h -- the guarded controller's firmware, the same on every target: bus -> authentication -> lpvg_ecu_step -> bus.
 *
 * A port supplies a clock and a bus driver. It calls firmware_tick every sample period of the vehicle, and firmware_idle in the remaining
 * time. */
#ifndef LPVGUARD_FIRMWARE_H
#define LPVGUARD_FIRMWARE_H

#include "bus.h"
#include "lpvguard/authentication.h"
#include "lpvguard/diagnosis.h"
#include "lpvguard/ecu.h"

/* A vehicle without the table of causes is also monitored. */
#if __has_include("lpvguard_diagnosis.c")
#define FIRMWARE_DIAGNOSES 1
#else
#define FIRMWARE_DIAGNOSES 0
#endif
/* A vehicle on its own bus: frames of the car become frames of the codec, and the demands go into the car's messages. */
#if __has_include("lpvg_demand.h")
#define FIRMWARE_OWN_BUS 1
#include "lpvg_can_own.h"
#include "lpvg_demand.h"
#else
#define FIRMWARE_OWN_BUS 0
#endif

LPVG_EXTERN_C_BEGIN

/* Frames taken in one tick; further frames wait for the next tick. A 250 kbit/s bus carries at most 20 frames in 10 ms. */
#define FIRMWARE_FRAMES_IN 32u
#define FIRMWARE_PAIR_US 5000u /* longest time from a command to its authenticator */

/* Common data of both ends of the command message's authentication. */
typedef struct firmware_key_t {
    lpvg_can_cmac_t cmac;
    void* context;      /* first argument of cmac */
    uint64_t freshness; /* newest value that may have been used under the key */
} firmware_key_t;

typedef struct firmware_t {
    lpvg_ecu_t ecu;
    const bus_t* bus;
    lpvg_can_auth_t authentication; /* authentication of the command message; not initialised without a key */
    lpvg_can_frame_t in[FIRMWARE_FRAMES_IN];
    uint32_t send_failures; /* saturating */
#if FIRMWARE_OWN_BUS
    lpvg_can_own_t own;
    uint16_t demand_counters[LPVG_DEMAND_MESSAGES];
    lpvg_demand_frame_t demand_frames[LPVG_DEMAND_MESSAGES]; /* their other bits may be set before a tick */
#endif
#if FIRMWARE_DIAGNOSES
    lpvg_diagnosis_t diagnosis;
#endif
} firmware_t;

/* The configuration that the simulator and the targets run: engagement is asked for, and every cause releases. On a car's own bus, no
 * message has the measured output of the actuator and the signals of the cross-checks, which therefore do nothing. */
extern const lpvg_ecu_config_t firmware_config;

/* Makes one end of the authentication of the vehicle's command message. Returns the result of lpvg_can_auth_init. */
LPVG_NODISCARD lpvg_status_t firmware_authenticate(lpvg_can_auth_t* end, const firmware_key_t* key);

/* Starts with the linked vehicle. Without a key (NULL), every command is obeyed, and each report says "not authenticated".
 * Returns the status of lpvg_ecu_init, lpvg_can_auth_init or lpvg_diagnosis_init; bad_argument for another NULL. */
LPVG_NODISCARD lpvg_status_t firmware_init(firmware_t* self, const bus_t* bus, const lpvg_ecu_config_t* config, const firmware_key_t* key,
                                           int64_t now_us);

/* Runs one sample period. Returns the result of lpvg_ecu_step. */
LPVG_NODISCARD lpvg_status_t firmware_tick(firmware_t* self, int64_t now_us);

/* Call in idle time between two ticks. Searches the cause of an alarm, which DM1 then reports. */
void firmware_idle(firmware_t* self);

LPVG_EXTERN_C_END

#endif
