/* firmware.c -- see firmware.h. */
#include "firmware.h"

const lpvg_ecu_config_t firmware_config = {
    .engage = true,
    .report_only = 0u,
    /* Track of the truck's rear axle. The limits hold bank (5 mrad), roll and 1/16 km/h wheel speeds many times over. */
    .plausibility = {.track_m = 2.07f, .speed_min_mps = 5.0f, .lateral_mps2 = 1.5f, .yaw_rps = 0.15f, .confirm = 100u},
    /* Brake lag 0.1 s and delay 0.04 s. */
    .actuator = {.lag_s = 0.14f, .tolerance = 0.04f, .confirm = 30u, .relative = 0.25f},
};

lpvg_status_t firmware_init(firmware_t* self, const bus_t* bus, const lpvg_ecu_config_t* config, int64_t now_us) {
    if (self == NULL || bus == NULL) {
        return lpvg_status_bad_argument;
    }
    self->bus = bus;
    self->send_failures = 0u;
#if FIRMWARE_DIAGNOSES
    {
        const lpvg_status_t status = lpvg_diagnosis_init(&self->diagnosis, &lpvg_diagnosis_table);
        if (status != lpvg_status_ok) {
            return status;
        }
    }
#endif
    return lpvg_ecu_init(&self->ecu, &lpvg_coeff, &lpvg_control_coeff, config, now_us);
}

lpvg_status_t firmware_tick(firmware_t* self, int64_t now_us) {
    lpvg_can_frame_t out[LPVG_ECU_FRAMES_OUT];
    size_t n_in = 0u;
    size_t n_out = 0u;
    size_t i;
    lpvg_status_t status;
    while (n_in < FIRMWARE_FRAMES_IN && bus_receive(self->bus, now_us, &self->in[n_in])) {
        ++n_in;
    }
    status = lpvg_ecu_step(&self->ecu, now_us, self->in, n_in, out, LPVG_ECU_FRAMES_OUT, &n_out);
    for (i = 0u; i < n_out; ++i) {
        if (!bus_send(self->bus, &out[i]) && self->send_failures < UINT32_MAX) {
            ++self->send_failures;
        }
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
