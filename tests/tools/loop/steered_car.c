/* steered_car.c -- a car as an FMU: a nonlinear single-track model of yaw rate and side slip, with steering and a yaw moment.
 *
 * Inputs: road-wheel angle [rad], yaw moment [N m], wanted speed [m/s], factor on the angle. Outputs: speed [km/h], yaw rate [deg/s]. */
#define N_IN 4
#define N_OUT 2
#include <math.h>

#include "c_fmu.h"

static const double start[N_IN] = {0.0, 0.0, 10.0, 1.0};

static void vehicle_step(vehicle_t* self, double h) {
    const double mass = 2050.0, inertia = 3600.0, front = 1.31, rear = 1.35, grip = 4.5 * mass, dt = 5e-4, v = self->in[2];
    double *lateral = &self->x[0], *r = &self->x[1];
    for (int k = 0; k < (int)(h / dt + 0.5); ++k) {
        const double slip_f = self->in[3] * self->in[0] - atan2(*lateral + front * *r, v), slip_r = -atan2(*lateral - rear * *r, v);
        const double force_f = grip * tanh(124e3 * slip_f / grip), force_r = grip * tanh(178e3 * slip_r / grip);
        *lateral += dt * ((force_f + force_r) / mass - v * *r);
        *r += dt * ((front * force_f - rear * force_r + self->in[1]) / inertia);
    }
    self->out[0] = 3.6 * v;
    self->out[1] = *r * 57.29577951308232;
}
