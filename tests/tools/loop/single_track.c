/* single_track.c -- another vehicle as an FMU: a linear single-track model of yaw rate and kingpin, steered by braking.
 *
 * Inputs: demand [bar], wanted speed [m/s], kingpin gain [rad/s2/bar]. Outputs: speed, yaw rate, road-wheel angle, lateral acceleration
 * [g], brake pressure difference [bar]. */
#define N_IN 3
#define N_OUT 5
#include "c_fmu.h"

static const double start[N_IN] = {0.0, 15.0, 0.32};

static void vehicle_step(vehicle_t* self, double h) {
    const double l = 4.5, dt = 1e-3, v = self->in[1];
    double *r = &self->x[0], *delta = &self->x[1], *rate = &self->x[2], *pressure = &self->x[3];
    for (int k = 0; k < (int)(h / dt + 0.5); ++k) {
        const double turning = 14.54 * (*delta - *r * l / v) + 0.06 * v * *r;
        const double aligning = 20.6 * (*r * l / v - *delta) - 0.25 * v * *r;
        *r += dt * turning;
        *rate += dt * (aligning - 4.96 * *rate - self->in[2] * *pressure);
        *delta += dt * *rate;
        *pressure += dt * (self->in[0] - *pressure) / 0.1;
    }
    const double out[N_OUT] = {v, *r, *delta, v * *r / 9.81, *pressure};
    memcpy(self->out, out, sizeof out);
}
