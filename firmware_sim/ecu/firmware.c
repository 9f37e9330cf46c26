/* firmware.c -- see firmware.h. */
#include "firmware.h"

#include <float.h>
#include <string.h>

#include "filter.h"

const lpvg_ecu_config_t firmware_config = {
    .engage = true,
    .report_only = 0u,
    /* Track of the truck's rear axle. The limits are many times the effects of bank (5 mrad), roll and 1/16 km/h steps. */
    .plausibility = {.track_m = 2.07f, .speed_min_mps = 5.0f, .lateral_mps2 = 1.5f, .yaw_rps = 0.15f, .confirm = 100u},
#if FIRMWARE_OWN_BUS
    .actuator = {.lag_s = 1.0f, .tolerance = FLT_MIN, .confirm = 1u},
#else
    /* Brake lag 0.1 s and delay 0.04 s. */
    .actuator = {.lag_s = 0.14f, .tolerance = 0.04f, .confirm = 30u, .relative = 0.32f},
#endif
};

lpvg_status_t firmware_authenticate(lpvg_can_auth_t* end, const firmware_key_t* key) {
    const lpvg_can_auth_config_t config = {
        .cmac = key->cmac,
        .context = key->context,
        .id = lpvg_bus.command_id,
        .auth_id = lpvg_bus.authenticator_id,
        .id_mask = FILTER_ANY_PRIORITY,
        .pair_us = FIRMWARE_PAIR_US,
        .data_id = lpvg_bus.command_data_id,
    };
    return lpvg_can_auth_init(end, &config, key->freshness);
}

lpvg_status_t firmware_init(firmware_t* self, const bus_t* bus, const lpvg_ecu_config_t* config, const firmware_key_t* key,
                            int64_t now_us) {
    lpvg_ecu_config_t own;
    if (self == NULL || bus == NULL || config == NULL) {
        return lpvg_status_bad_argument;
    }
    own = *config;
    own.authenticated = key != NULL;
    self->bus = bus;
    memset(&self->authentication, 0, sizeof self->authentication);
    if (key != NULL) {
        const lpvg_status_t status = firmware_authenticate(&self->authentication, key);
        if (status != lpvg_status_ok) {
            return status;
        }
    }
    self->send_failures = 0u;
#if FIRMWARE_OWN_BUS
    memset(&self->own, 0, sizeof self->own);
    memset(self->demand_counters, 0, sizeof self->demand_counters);
    memset(self->demand_frames, 0, sizeof self->demand_frames);
#endif
#if FIRMWARE_DIAGNOSES
    {
        const lpvg_status_t status = lpvg_diagnosis_init(&self->diagnosis, &lpvg_diagnosis_table);
        if (status != lpvg_status_ok) {
            return status;
        }
    }
#endif
    return lpvg_ecu_init(&self->ecu, &lpvg_coeff, &lpvg_control_coeff, &own, now_us);
}

/* Tells if a received frame is for the ECU. With a key, a command waits for its authenticator. */
static bool passes(firmware_t* self, const lpvg_can_frame_t* received, lpvg_can_frame_t* out) {
    lpvg_can_auth_event_t event;
#if FIRMWARE_OWN_BUS
    if (!filter_is_ours(received)) {
        return lpvg_can_own_take(&self->own, received->id, received->data, received->dlc, received->t_us, out) == lpvg_status_ok &&
               out->id != 0u;
    }
#endif
    if (!self->ecu.kept.config.authenticated) {
        *out = *received;
        return true;
    }
    event = lpvg_can_auth_receive(&self->authentication, received, out);
    return event == lpvg_can_auth_passed || event == lpvg_can_auth_other;
}

static void send(firmware_t* self, const lpvg_can_frame_t* frame) {
    if (!bus_send(self->bus, frame) && self->send_failures < UINT32_MAX) {
        ++self->send_failures;
    }
}

#if FIRMWARE_OWN_BUS
/* Sends the newest demands in the car's own messages. */
static void send_demands(firmware_t* self, int64_t now_us) {
    float u[LPVG_NU];
    size_t i;
    for (i = 0u; i < LPVG_NU; ++i) {
        u[i] = (float)self->ecu.control.u[i];
    }
    if (lpvg_demand_pack(u, self->demand_counters, self->demand_frames) == lpvg_status_ok) {
        for (i = 0u; i < LPVG_DEMAND_MESSAGES; ++i) {
            const lpvg_demand_frame_t* const packed = &self->demand_frames[i];
            lpvg_can_frame_t frame = {.id = packed->id, .dlc = packed->length, .t_us = now_us};
            memcpy(frame.data, packed->data, packed->length);
            send(self, &frame);
        }
    }
}
#endif

lpvg_status_t firmware_tick(firmware_t* self, int64_t now_us) {
    lpvg_can_frame_t out[LPVG_ECU_FRAMES_OUT];
    lpvg_can_frame_t received;
    size_t n_received;
    size_t n_in = 0u;
    size_t n_out = 0u;
    size_t i;
    lpvg_status_t status;
    for (n_received = 0u; n_received < FIRMWARE_FRAMES_IN && bus_receive(self->bus, now_us, &received); ++n_received) {
        n_in += passes(self, &received, &self->in[n_in]) ? 1u : 0u;
    }
    status = lpvg_ecu_step(&self->ecu, now_us, self->in, n_in, out, LPVG_ECU_FRAMES_OUT, &n_out);
#if FIRMWARE_OWN_BUS
    if (status == lpvg_status_ok) {
        send_demands(self, now_us);
    }
#endif
    for (i = 0u; i < n_out; ++i) {
        send(self, &out[i]);
    }
    return status;
}

void firmware_idle(firmware_t* self) {
#if FIRMWARE_DIAGNOSES
    if (lpvg_diagnosis_take(&self->diagnosis, &self->ecu.monitor) == lpvg_status_ok) {
        while (lpvg_diagnosis_work(&self->diagnosis)) {
        }
        lpvg_ecu_explain(&self->ecu, lpvg_diagnosis_named(&self->diagnosis));
    }
#else
    (void)self;
#endif
}
