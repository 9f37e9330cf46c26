// monitor.cpp -- a vehicle's monitor as a co-simulation FMU: the functions of FMI 2.0 and of FMI 3.0 around lpvguard/monitor.h.
//
// A step takes the inputs that were set as the sample of its beginning. Its outputs are those of the core after that sample. The step
// size is the sample period. description.py names the value references below.
#include <cmath>
#include <cstdarg>
#include <cstddef>
#include <cstdint>
#include <cstdio>
#include <cstring>
#include <new>
#include <string>

#include "lpvguard/diagnosis.h"

namespace {

// Value references. Inputs: speed, then u, then y.
constexpr unsigned n_inputs = 1U + LPVG_NU + LPVG_NY;
enum Number : unsigned {
    vr_time = 99,
    vr_margin,
    vr_statistic,
    vr_evidence,
    vr_energy_ratio,
    vr_change_ratio,
    vr_cause_value,
    vr_cause_low,
    vr_cause_high,
    vr_threshold,
    vr_energy_threshold,
    vr_change_threshold
};
enum Count : unsigned {
    vr_verdict = 200,
    vr_reason,
    vr_status,
    vr_cause,
    vr_frames,
    vr_bin,
    vr_cause_output
};

enum Status {
    ok = 0,
    warning = 1,
    error = 3
};  // The same numbers in FMI 2 and FMI 3.
enum class Phase : uint32_t {
    instantiated,
    initialising,
    stepping,
    terminated
};

// What a saved state holds. No pointers but those that restore() sets.
struct State {
    lpvg_monitor_t monitor;
    lpvg_diagnosis_t diagnosis;
    double input[n_inputs];
    int64_t t_us;
    uint32_t status;
    Phase phase;
};

struct Serialized {
    uint32_t size, coefficients;
    State state;
};

struct Model {
    State state;
    std::string name;
    void* environment;
    void* log2;  // of FMI 2, which is variadic
    void* log3;  // of FMI 3
};

Status say(const Model* self, Status status, const char* format, ...) {
    char text[256];
    va_list arguments;
    va_start(arguments, format);
    std::vsnprintf(text, sizeof text, format, arguments);
    va_end(arguments);
    const char* category = status == error ? "logStatusError" : "logStatusWarning";
    if (self->log2 != nullptr) {
        using Log2 = void (*)(void*, const char*, int, const char*, const char*, ...);
        reinterpret_cast<Log2>(self->log2)(self->environment, self->name.c_str(), status, category, "%s", text);
    }
    if (self->log3 != nullptr) {
        using Log3 = void (*)(void*, int, const char*, const char*);
        reinterpret_cast<Log3>(self->log3)(self->environment, status, category, text);
    }
    return status;
}

Status start(Model* self) {
    State& state = self->state;
    std::memset(static_cast<void*>(&state), 0, sizeof state);
    lpvg_status_t status = lpvg_monitor_init(&state.monitor, &lpvg_coeff);
#ifdef LPVG_FMU_DIAGNOSIS
    if (status == lpvg_status_ok) {
        status = lpvg_diagnosis_init(&state.diagnosis, &lpvg_diagnosis_table);
    }
#endif
    return status == lpvg_status_ok ? ok : say(self, error, "init refused the coefficients with status %d", static_cast<int>(status));
}

Model* instantiate(const char* name, void* environment, void* log2, void* log3) {
    Model* self = new (std::nothrow) Model{{}, name == nullptr ? "" : name, environment, log2, log3};
    if (self != nullptr && start(self) != ok) {
        delete self;
        return nullptr;
    }
    return self;
}

// Moves to the next phase from the one that must come before.
Status enter(Model* self, Phase before, Phase next, const char* function) {
    if (self->state.phase != before) {
        return say(self, error, "%s: called in the wrong order", function);
    }
    self->state.phase = next;
    return ok;
}

Status set_number(Model* self, unsigned reference, double value) {
    if (reference >= n_inputs) {
        return say(self, error, "value reference %u: expected an input, 0 .. %u", reference, n_inputs - 1U);
    }
    if (!std::isfinite(value)) {
        return say(self, error, "input with value reference %u: not finite; expected a finite number", reference);
    }
    self->state.input[reference] = value;
    return ok;
}

const lpvg_found_t* cause_of(const State& state) {
#ifdef LPVG_FMU_DIAGNOSIS
    return lpvg_diagnosis_named(&state.diagnosis);
#else
    static_cast<void>(state);
    return nullptr;
#endif
}

Status get_number(const Model* self, unsigned reference, double* value) {
    const State& state = self->state;
    const lpvg_frame_t& frame = state.monitor.frame;
    const lpvg_coeff_reals_t& reals = lpvg_coeff.reals;
    const lpvg_found_t* found = cause_of(state);
    switch (reference) {
        case vr_time: *value = static_cast<double>(state.t_us) * 1e-6; break;
        case vr_margin: *value = frame.margin; break;
        case vr_statistic: *value = frame.statistic; break;
        case vr_evidence: *value = frame.evidence; break;
        case vr_energy_ratio: *value = state.monitor.energy.ratio; break;
        case vr_change_ratio: *value = state.monitor.change.ratio; break;
        case vr_cause_value: *value = found == nullptr ? 0.0 : static_cast<double>(found->value); break;
        case vr_cause_low: *value = found == nullptr ? 0.0 : static_cast<double>(found->low); break;
        case vr_cause_high: *value = found == nullptr ? 0.0 : static_cast<double>(found->high); break;
        case vr_threshold: *value = reals.threshold; break;
        case vr_energy_threshold: *value = reals.energy_threshold; break;
        case vr_change_threshold: *value = reals.change_threshold; break;
        default:
            if (reference >= n_inputs) {
                return say(self, error, "value reference %u: no such number", reference);
            }
            *value = state.input[reference];
    }
    return ok;
}

Status get_count(const Model* self, unsigned reference, int64_t* value) {
    const State& state = self->state;
    const lpvg_found_t* found = cause_of(state);
    switch (reference) {
        case vr_verdict: *value = lpvg_monitor_verdict(&state.monitor, state.t_us); break;
        case vr_reason: *value = lpvg_monitor_reason(&state.monitor); break;
        case vr_status: *value = state.status; break;
        case vr_cause: *value = found == nullptr ? lpvg_cause_unknown : found->cause; break;
        case vr_frames: *value = state.monitor.frame.sequence; break;
        case vr_bin: *value = state.monitor.frame.bin; break;
        case vr_cause_output: *value = found == nullptr ? 0 : found - state.diagnosis.found; break;
        default: return say(self, error, "value reference %u: no such integer", reference);
    }
    return ok;
}

Status step(Model* self, double t, double h) {
    State& state = self->state;
    if (state.phase != Phase::stepping) {
        return say(self, error, "doStep: called before the initialisation has ended, or after terminate");
    }
    const double period = lpvg_coeff.words.sample_period_us * 1e-6;
    if (!(std::fabs(h - period) <= 1e-6 * period)) {
        return say(self, error, "communication step size %.9g s; expected the sample period %.9g s", h, period);
    }
    lpvg_sample_t sample;
    sample.t_us = std::llround(t * 1e6);
    const double* input = state.input;
    sample.speed = static_cast<lpvg_real_t>(*input++);
    for (lpvg_real_t& u : sample.u) {
        u = static_cast<lpvg_real_t>(*input++);
    }
    for (lpvg_real_t& y : sample.y) {
        y = static_cast<lpvg_real_t>(*input++);
    }
    state.t_us = sample.t_us;
    const lpvg_status_t status = lpvg_monitor_push(&state.monitor, &sample);
    state.status = static_cast<uint32_t>(status);
#ifdef LPVG_FMU_DIAGNOSIS
    if (lpvg_diagnosis_take(&state.diagnosis, &state.monitor) == lpvg_status_ok) {
        while (lpvg_diagnosis_work(&state.diagnosis)) {
        }
    }
#endif
    lpvg_frame_t record;
    while (lpvg_monitor_take_record(&state.monitor, &record)) {
    }
    return status == lpvg_status_ok ? ok
                                    : say(self, warning, "the sample at %.6f s is refused with status %d", t, static_cast<int>(status));
}

void restore(Model* self, const State& state) {
    self->state = state;
    self->state.monitor.coeff = &lpvg_coeff;
#ifdef LPVG_FMU_DIAGNOSIS
    self->state.diagnosis.table = &lpvg_diagnosis_table;
#endif
}

// The state without addresses, so that it has the same bytes in every process.
void serialize(const State& state, void* bytes) {
    Serialized copy;
    std::memset(static_cast<void*>(&copy), 0, sizeof copy);
    copy.size = sizeof(State);
    copy.coefficients = lpvg_coeff.words.crc32;
    std::memcpy(static_cast<void*>(&copy.state), &state, sizeof(State));
    copy.state.monitor.coeff = nullptr;
    copy.state.diagnosis.table = nullptr;
    std::memcpy(bytes, &copy, sizeof copy);  // the caller's bytes need not be aligned
}

Status deserialize(const Model* self, const void* bytes, std::size_t size, State** state) {
    Serialized copy;
    if (size != sizeof copy) {
        return say(self, error, "serialized state: %zu bytes; expected %zu", size, sizeof copy);
    }
    std::memcpy(static_cast<void*>(&copy), bytes, sizeof copy);
    if (copy.size != sizeof(State) || copy.coefficients != lpvg_coeff.words.crc32) {
        return say(self, error, "serialized state: of another vehicle; expected one of these coefficients");
    }
    *state = new (std::nothrow) State(copy.state);
    return *state == nullptr ? error : ok;
}

template <typename T>
Status get_counts(void* model, const unsigned* references, std::size_t n, T* values) {
    for (std::size_t k = 0; k < n; ++k) {
        int64_t value = 0;
        if (get_count(static_cast<Model*>(model), references[k], &value) != ok) {
            return error;
        }
        values[k] = static_cast<T>(value);
    }
    return ok;
}

Status get_numbers(void* model, const unsigned* references, std::size_t n, double* values) {
    Status status = ok;
    for (std::size_t k = 0; k < n && status == ok; ++k) {
        status = get_number(static_cast<Model*>(model), references[k], &values[k]);
    }
    return status;
}

Status set_numbers(void* model, const unsigned* references, std::size_t n, const double* values) {
    Status status = ok;
    for (std::size_t k = 0; k < n && status == ok; ++k) {
        status = set_number(static_cast<Model*>(model), references[k], values[k]);
    }
    return status;
}

Status keep_state(const Model* self, void** kept) {
    if (*kept == nullptr) {
        *kept = new (std::nothrow) State(self->state);
    } else {
        *static_cast<State*>(*kept) = self->state;
    }
    return *kept == nullptr ? error : ok;
}

Status drop_state(void** kept) {
    delete static_cast<State*>(*kept);
    *kept = nullptr;
    return ok;
}

Model* of(void* model) { return static_cast<Model*>(model); }

Status nothing_of(void* model, const char* function) {
    return say(of(model), error, "%s: this FMU has none; see modelDescription.xml", function);
}

}  // namespace

#define LPVG_FMI extern "C" __attribute__((visibility("default")))
// A function for what this FMU does not have, whatever its further arguments.
#define LPVG_FMI_NONE(name) \
    LPVG_FMI int name(void* model, ...) { return nothing_of(model, #name); }

// ---------------------------------------------------------------------------------------------------------------- FMI 2.0

struct Callbacks2 {
    void* logger;
    void* allocate;
    void* release;
    void* step_finished;
    void* environment;
};

LPVG_FMI const char* fmi2GetTypesPlatform() { return "default"; }
LPVG_FMI const char* fmi2GetVersion() { return "2.0"; }
LPVG_FMI int fmi2SetDebugLogging(void*, int, std::size_t, const char* const*) { return ok; }
LPVG_FMI void* fmi2Instantiate(const char* name, int kind, const char* /*guid*/, const char*, const Callbacks2* callbacks, int, int) {
    return kind == 1 ? instantiate(name, callbacks->environment, callbacks->logger, nullptr) : nullptr;
}
LPVG_FMI void fmi2FreeInstance(void* model) { delete of(model); }
LPVG_FMI int fmi2SetupExperiment(void*, int, double, double, int, double) { return ok; }
LPVG_FMI int fmi2EnterInitializationMode(void* model) {
    return enter(of(model), Phase::instantiated, Phase::initialising, "fmi2EnterInitializationMode");
}
LPVG_FMI int fmi2ExitInitializationMode(void* model) {
    return enter(of(model), Phase::initialising, Phase::stepping, "fmi2ExitInitializationMode");
}
LPVG_FMI int fmi2Terminate(void* model) { return enter(of(model), Phase::stepping, Phase::terminated, "fmi2Terminate"); }
LPVG_FMI int fmi2Reset(void* model) { return start(of(model)); }
LPVG_FMI int fmi2GetReal(void* model, const unsigned* references, std::size_t n, double* values) {
    return get_numbers(model, references, n, values);
}
LPVG_FMI int fmi2SetReal(void* model, const unsigned* references, std::size_t n, const double* values) {
    return set_numbers(model, references, n, values);
}
LPVG_FMI int fmi2GetInteger(void* model, const unsigned* references, std::size_t n, int* values) {
    return get_counts(model, references, n, values);
}
LPVG_FMI int fmi2GetFMUstate(void* model, void** kept) { return keep_state(of(model), kept); }
LPVG_FMI int fmi2SetFMUstate(void* model, void* kept) {
    restore(of(model), *static_cast<State*>(kept));
    return ok;
}
LPVG_FMI int fmi2FreeFMUstate(void*, void** kept) { return drop_state(kept); }
LPVG_FMI int fmi2SerializedFMUstateSize(void*, void*, std::size_t* size) {
    *size = sizeof(Serialized);
    return ok;
}
LPVG_FMI int fmi2SerializeFMUstate(void* model, void* kept, unsigned char* bytes, std::size_t size) {
    if (size < sizeof(Serialized)) {
        return say(of(model), error, "fmi2SerializeFMUstate: room for %zu bytes; expected %zu", size, sizeof(Serialized));
    }
    serialize(*static_cast<const State*>(kept), bytes);
    return ok;
}
LPVG_FMI int fmi2DeSerializeFMUstate(void* model, const unsigned char* bytes, std::size_t size, void** kept) {
    State* state = nullptr;
    const Status status = deserialize(of(model), bytes, size, &state);
    *kept = state;
    return status;
}
LPVG_FMI int fmi2DoStep(void* model, double t, double h, int) { return step(of(model), t, h); }
LPVG_FMI_NONE(fmi2GetBoolean)
LPVG_FMI_NONE(fmi2GetString)
LPVG_FMI_NONE(fmi2SetInteger)
LPVG_FMI_NONE(fmi2SetBoolean)
LPVG_FMI_NONE(fmi2SetString)
LPVG_FMI_NONE(fmi2GetDirectionalDerivative)
LPVG_FMI_NONE(fmi2SetRealInputDerivatives)
LPVG_FMI_NONE(fmi2GetRealOutputDerivatives)
LPVG_FMI_NONE(fmi2CancelStep)
LPVG_FMI_NONE(fmi2GetStatus)
LPVG_FMI_NONE(fmi2GetRealStatus)
LPVG_FMI_NONE(fmi2GetIntegerStatus)
LPVG_FMI_NONE(fmi2GetBooleanStatus)
LPVG_FMI_NONE(fmi2GetStringStatus)

// ---------------------------------------------------------------------------------------------------------------- FMI 3.0

LPVG_FMI const char* fmi3GetVersion() { return "3.0"; }
LPVG_FMI int fmi3SetDebugLogging(void*, bool, std::size_t, const char* const*) { return ok; }
LPVG_FMI void* fmi3InstantiateCoSimulation(const char* name, const char* /*token*/, const char*, bool, bool, bool, bool, const unsigned*,
                                           std::size_t, void* environment, void* logger, void* /*intermediate*/) {
    return instantiate(name, environment, nullptr, logger);
}
LPVG_FMI void* fmi3InstantiateModelExchange(...) { return nullptr; }
LPVG_FMI void* fmi3InstantiateScheduledExecution(...) { return nullptr; }
LPVG_FMI void fmi3FreeInstance(void* model) { delete of(model); }
LPVG_FMI int fmi3EnterInitializationMode(void* model, bool, double, double, bool, double) {
    return enter(of(model), Phase::instantiated, Phase::initialising, "fmi3EnterInitializationMode");
}
LPVG_FMI int fmi3ExitInitializationMode(void* model) {
    return enter(of(model), Phase::initialising, Phase::stepping, "fmi3ExitInitializationMode");
}
LPVG_FMI int fmi3Terminate(void* model) { return enter(of(model), Phase::stepping, Phase::terminated, "fmi3Terminate"); }
LPVG_FMI int fmi3Reset(void* model) { return start(of(model)); }
LPVG_FMI int fmi3GetFloat64(void* model, const unsigned* references, std::size_t n, double* values, std::size_t) {
    return get_numbers(model, references, n, values);
}
LPVG_FMI int fmi3SetFloat64(void* model, const unsigned* references, std::size_t n, const double* values, std::size_t) {
    return set_numbers(model, references, n, values);
}
LPVG_FMI int fmi3GetInt64(void* model, const unsigned* references, std::size_t n, int64_t* values, std::size_t) {
    return get_counts(model, references, n, values);
}
LPVG_FMI int fmi3GetUInt32(void* model, const unsigned* references, std::size_t n, uint32_t* values, std::size_t) {
    return get_counts(model, references, n, values);
}
LPVG_FMI int fmi3GetFMUState(void* model, void** kept) { return keep_state(of(model), kept); }
LPVG_FMI int fmi3SetFMUState(void* model, void* kept) { return fmi2SetFMUstate(model, kept); }
LPVG_FMI int fmi3FreeFMUState(void*, void** kept) { return drop_state(kept); }
LPVG_FMI int fmi3SerializedFMUStateSize(void*, void*, std::size_t* size) {
    *size = sizeof(Serialized);
    return ok;
}
LPVG_FMI int fmi3SerializeFMUState(void* model, void* kept, unsigned char* bytes, std::size_t size) {
    return fmi2SerializeFMUstate(model, kept, bytes, size);
}
LPVG_FMI int fmi3DeserializeFMUState(void* model, const unsigned char* bytes, std::size_t size, void** kept) {
    return fmi2DeSerializeFMUstate(model, bytes, size, kept);
}
LPVG_FMI int fmi3DoStep(void* model, double t, double h, bool, bool* event, bool* terminate, bool* early, double* last) {
    *event = false;
    *terminate = false;
    *early = false;
    const Status status = step(of(model), t, h);
    *last = status == error ? t : t + h;
    return status;
}
LPVG_FMI_NONE(fmi3EnterEventMode)
LPVG_FMI_NONE(fmi3EnterStepMode)
LPVG_FMI_NONE(fmi3EnterConfigurationMode)
LPVG_FMI_NONE(fmi3ExitConfigurationMode)
LPVG_FMI_NONE(fmi3GetFloat32)
LPVG_FMI_NONE(fmi3GetInt8)
LPVG_FMI_NONE(fmi3GetUInt8)
LPVG_FMI_NONE(fmi3GetInt16)
LPVG_FMI_NONE(fmi3GetUInt16)
LPVG_FMI_NONE(fmi3GetInt32)
LPVG_FMI_NONE(fmi3GetUInt64)
LPVG_FMI_NONE(fmi3GetBoolean)
LPVG_FMI_NONE(fmi3GetString)
LPVG_FMI_NONE(fmi3GetBinary)
LPVG_FMI_NONE(fmi3GetClock)
LPVG_FMI_NONE(fmi3SetFloat32)
LPVG_FMI_NONE(fmi3SetInt8)
LPVG_FMI_NONE(fmi3SetUInt8)
LPVG_FMI_NONE(fmi3SetInt16)
LPVG_FMI_NONE(fmi3SetUInt16)
LPVG_FMI_NONE(fmi3SetInt32)
LPVG_FMI_NONE(fmi3SetUInt32)
LPVG_FMI_NONE(fmi3SetInt64)
LPVG_FMI_NONE(fmi3SetUInt64)
LPVG_FMI_NONE(fmi3SetBoolean)
LPVG_FMI_NONE(fmi3SetString)
LPVG_FMI_NONE(fmi3SetBinary)
LPVG_FMI_NONE(fmi3SetClock)
LPVG_FMI_NONE(fmi3GetNumberOfVariableDependencies)
LPVG_FMI_NONE(fmi3GetVariableDependencies)
LPVG_FMI_NONE(fmi3GetDirectionalDerivative)
LPVG_FMI_NONE(fmi3GetAdjointDerivative)
LPVG_FMI_NONE(fmi3GetIntervalDecimal)
LPVG_FMI_NONE(fmi3GetIntervalFraction)
LPVG_FMI_NONE(fmi3GetShiftDecimal)
LPVG_FMI_NONE(fmi3GetShiftFraction)
LPVG_FMI_NONE(fmi3SetIntervalDecimal)
LPVG_FMI_NONE(fmi3SetIntervalFraction)
LPVG_FMI_NONE(fmi3SetShiftDecimal)
LPVG_FMI_NONE(fmi3SetShiftFraction)
LPVG_FMI_NONE(fmi3EvaluateDiscreteStates)
LPVG_FMI_NONE(fmi3UpdateDiscreteStates)
LPVG_FMI_NONE(fmi3EnterContinuousTimeMode)
LPVG_FMI_NONE(fmi3CompletedIntegratorStep)
LPVG_FMI_NONE(fmi3SetTime)
LPVG_FMI_NONE(fmi3SetContinuousStates)
LPVG_FMI_NONE(fmi3GetContinuousStateDerivatives)
LPVG_FMI_NONE(fmi3GetEventIndicators)
LPVG_FMI_NONE(fmi3GetContinuousStates)
LPVG_FMI_NONE(fmi3GetNominalsOfContinuousStates)
LPVG_FMI_NONE(fmi3GetNumberOfEventIndicators)
LPVG_FMI_NONE(fmi3GetNumberOfContinuousStates)
LPVG_FMI_NONE(fmi3GetOutputDerivatives)
LPVG_FMI_NONE(fmi3ActivateModelPartition)
