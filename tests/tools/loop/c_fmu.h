/* c_fmu.h -- the functions of a co-simulation FMU (FMI 2.0) around a vehicle in C, for tests.
 *
 * The including file defines N_IN, N_OUT, `start` and vehicle_step. Value references are 0 to N_IN - 1 for inputs and parameters, and
 * from 10 on for outputs. */
#include <stddef.h>
#include <stdlib.h>
#include <string.h>

typedef struct {
    double in[N_IN], out[N_OUT], x[8];
} vehicle_t;

static const double start[N_IN];
static void vehicle_step(vehicle_t* self, double h);

enum {
    ok = 0,
    error = 3,
    first_output = 10
};

const char* fmi2GetTypesPlatform(void) { return "default"; }
const char* fmi2GetVersion(void) { return "2.0"; }
void* fmi2Instantiate(const char* name, int kind, const char* guid, const char* resources, const void* callbacks, int visible,
                      int logging) {
    vehicle_t* self = calloc(1, sizeof *self);
    (void)name, (void)kind, (void)guid, (void)resources, (void)callbacks, (void)visible, (void)logging;
    memcpy(self->in, start, sizeof self->in);
    return self;
}
void fmi2FreeInstance(void* self) { free(self); }
int fmi2SetupExperiment(void* self, int defined, double tolerance, double begin, int ends, double stop) {
    (void)self, (void)defined, (void)tolerance, (void)begin, (void)ends, (void)stop;
    return ok;
}
int fmi2EnterInitializationMode(void* self) { return (void)self, ok; }
int fmi2ExitInitializationMode(void* self) { return vehicle_step(self, 0.0), ok; }

int fmi2SetReal(void* model, const unsigned* references, size_t n, const double* values) {
    vehicle_t* self = model;
    for (size_t k = 0; k < n; ++k) {
        if (references[k] >= N_IN) {
            return error;
        }
        self->in[references[k]] = values[k];
    }
    return ok;
}
int fmi2GetReal(void* model, const unsigned* references, size_t n, double* values) {
    const vehicle_t* self = model;
    for (size_t k = 0; k < n; ++k) {
        if (references[k] < first_output || references[k] >= first_output + N_OUT) {
            return error;
        }
        values[k] = self->out[references[k] - first_output];
    }
    return ok;
}
int fmi2DoStep(void* self, double t, double h, int final) {
    (void)t, (void) final;
    vehicle_step(self, h);
    return ok;
}
