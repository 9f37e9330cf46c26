/* single_track.c -- another vehicle as a co-simulation FMU (FMI 2.0): a linear single-track model of yaw rate and kingpin, steered by
 * braking.
 *
 * References: 0 dp demand [bar], 1 wanted speed [m/s], 2 kingpin gain [rad/s2/bar], 10 speed, 11 yaw rate, 12 road-wheel angle, 13 lateral
 * acceleration [g], 14 brake pressure difference [bar]. */
#include <stddef.h>
#include <stdlib.h>

typedef struct {
    double in[3], r, delta, rate, pressure, ay;
} vehicle_t;

enum {
    ok = 0,
    error = 3
};

const char* fmi2GetTypesPlatform(void) { return "default"; }
const char* fmi2GetVersion(void) { return "2.0"; }
void* fmi2Instantiate(const char* name, int kind, const char* guid, const char* resources, const void* callbacks, int visible,
                      int logging) {
    vehicle_t* self = calloc(1, sizeof *self);
    (void)name, (void)kind, (void)guid, (void)resources, (void)callbacks, (void)visible, (void)logging;
    self->in[1] = 15.0;
    self->in[2] = 0.32;
    return self;
}
void fmi2FreeInstance(void* self) { free(self); }
int fmi2SetupExperiment(void* self, int defined, double tolerance, double start, int ends, double stop) {
    (void)self, (void)defined, (void)tolerance, (void)start, (void)ends, (void)stop;
    return ok;
}
int fmi2EnterInitializationMode(void* self) { return (void)self, ok; }
int fmi2ExitInitializationMode(void* self) { return (void)self, ok; }

int fmi2SetReal(void* model, const unsigned* references, size_t n, const double* values) {
    vehicle_t* self = model;
    for (size_t k = 0; k < n; ++k) {
        if (references[k] > 2) {
            return error;
        }
        self->in[references[k]] = values[k];
    }
    return ok;
}
int fmi2GetReal(void* model, const unsigned* references, size_t n, double* values) {
    const vehicle_t* self = model;
    const double out[] = {self->in[1], self->r, self->delta, self->ay, self->pressure};
    for (size_t k = 0; k < n; ++k) {
        if (references[k] < 10 || references[k] > 14) {
            return error;
        }
        values[k] = out[references[k] - 10];
    }
    return ok;
}

int fmi2DoStep(void* model, double t, double h, int final) {
    const double l = 4.5, dt = 1e-3;
    vehicle_t* self = model;
    (void)t, (void) final;
    for (int k = 0; k < (int)(h / dt + 0.5); ++k) {
        const double v = self->in[1], turning = 14.54 * (self->delta - self->r * l / v) + 0.06 * v * self->r;
        const double aligning = 20.6 * (self->r * l / v - self->delta) - 0.25 * v * self->r;
        self->r += dt * turning;
        self->rate += dt * (aligning - 4.96 * self->rate - self->in[2] * self->pressure);
        self->delta += dt * self->rate;
        self->pressure += dt * (self->in[0] - self->pressure) / 0.1;
        self->ay = v * self->r / 9.81;
    }
    return ok;
}
