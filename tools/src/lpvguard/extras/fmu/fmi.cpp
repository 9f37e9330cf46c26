// fmi.cpp -- the functions of FMI 2.0 and of FMI 3.0 for co-simulation, around a unit (unit.hpp).
//
// A step takes the inputs that were set as those of its beginning. The step size is the unit's period.
#include <cmath>
#include <cstring>
#include <new>

#include "unit.hpp"

namespace {

using lpvguard_fmu::error;
using lpvguard_fmu::Log;
using lpvguard_fmu::ok;
using lpvguard_fmu::Phase;
using lpvguard_fmu::Status;
using lpvguard_fmu::Unit;

// An instance keeps its unit and what its get functions hand out.
struct Instance {
    std::unique_ptr<Unit> unit;
    Log log;
};

Unit& of(void* instance) { return *static_cast<Instance*>(instance)->unit; }

void* instantiate(const char* name, void* environment, void* log2, void* log3, bool with_events) {
    auto made = std::make_unique<Instance>();
    made->log = {name == nullptr ? "" : name, environment, log2, log3};
    made->unit = lpvguard_fmu::make_unit(made->log);
    if (made->unit == nullptr) {
        return nullptr;
    }
    made->unit->with_events = with_events && made->unit->has_events();
    return made.release();
}

// Moves to the next phase from the one that must come before.
Status enter(void* instance, Phase before, Phase next, const char* function) {
    if (of(instance).phase != before) {
        return of(instance).say(error, "%s: called in the wrong order", function);
    }
    of(instance).phase = next;
    return ok;
}

Status initialise(void* instance, double start_s, const char* function) {
    of(instance).now_s = start_s;
    return enter(instance, Phase::instantiated, Phase::initialising, function);
}

Status exit_initialisation(void* instance, const char* function) {
    Unit& unit = of(instance);
    const Status status = enter(instance, Phase::initialising, unit.with_events ? Phase::event : Phase::stepping, function);
    return status == ok ? unit.start() : status;
}

Status terminate(void* instance, const char* function) {
    return of(instance).phase == Phase::event ? enter(instance, Phase::event, Phase::terminated, function)
                                              : enter(instance, Phase::stepping, Phase::terminated, function);
}

Status reset(void* instance) {
    auto& self = *static_cast<Instance*>(instance);
    const bool with_events = self.unit->with_events;
    std::unique_ptr<Unit> unit = lpvguard_fmu::make_unit(self.log);
    if (unit == nullptr) {
        return error;
    }
    self.unit = std::move(unit);
    self.unit->with_events = with_events;
    return ok;
}

Status step(void* instance, double t, double h) {
    Unit& unit = of(instance);
    if (unit.phase != Phase::stepping) {
        return unit.say(error, "doStep: called before the initialisation has ended, in event mode, or after terminate");
    }
    const double period = unit.period_s();
    if (!(std::fabs(h - period) <= 1e-6 * period)) {
        return unit.say(error, "communication step size %.9g s; expected the sample period %.9g s", h, period);
    }
    unit.now_s = t;
    const Status status = unit.step();
    unit.now_s = status == error ? t : t + h;
    return status;
}

template <typename Own, typename T>
Status get(void* instance, const unsigned* references, std::size_t n, T* values) {
    Status status = ok;
    for (std::size_t k = 0; k < n && status == ok; ++k) {
        Own value{};
        status = of(instance).get(references[k], value);
        values[k] = static_cast<T>(value);
    }
    return status;
}

template <typename Own, typename T>
Status set(void* instance, const unsigned* references, std::size_t n, T const* values) {
    Unit& unit = of(instance);
    Status status = ok;
    for (std::size_t k = 0; k < n && status == ok; ++k) {
        if constexpr (std::is_same_v<Own, double>) {
            if (!std::isfinite(values[k])) {
                return unit.say(error, "input with value reference %u: not finite; expected a finite number", references[k]);
            }
        } else if (unit.phase != Phase::instantiated && unit.phase != Phase::initialising) {
            return unit.say(error, "parameter with value reference %u: fixed once the initialisation has ended", references[k]);
        }
        status = unit.set(references[k], static_cast<Own>(values[k]));
    }
    return status;
}

Status keep_state(void* instance, void** kept) {
    delete static_cast<Unit*>(*kept);
    *kept = of(instance).copy().release();
    return ok;
}

Status go_on(void* instance, const void* kept) {
    Unit& unit = of(instance);
    const auto& from = *static_cast<const Unit*>(kept);
    unit.phase = from.phase;
    unit.now_s = from.now_s;
    unit.go_on_from(from);
    return ok;
}

Status drop_state(void** kept) {
    delete static_cast<Unit*>(*kept);
    *kept = nullptr;
    return ok;
}

// A serialized state: phase and time, then the unit's bytes.
struct Head {
    uint64_t phase;
    double now_s;
};

Status serialized_size(void* instance, const void* kept, std::size_t* size) {
    const std::size_t own = static_cast<const Unit*>(kept)->bytes().size();
    *size = sizeof(Head) + own;
    return own == 0 ? of(instance).say(error, "this FMU's states are not serialized") : ok;
}

Status serialize(void* instance, const void* kept, unsigned char* bytes, std::size_t size) {
    const auto& unit = *static_cast<const Unit*>(kept);
    const std::vector<unsigned char> own = unit.bytes();
    if (own.empty() || size < sizeof(Head) + own.size()) {
        return of(instance).say(error, "serialize: room for %zu bytes; expected %zu", size, sizeof(Head) + own.size());
    }
    const Head head = {static_cast<uint64_t>(unit.phase), unit.now_s};
    std::memcpy(bytes, &head, sizeof head);
    std::memcpy(bytes + sizeof head, own.data(), own.size());
    return ok;
}

Status deserialize(void* instance, const unsigned char* bytes, std::size_t size, void** kept) {
    Unit& unit = of(instance);
    *kept = nullptr;
    Head head{};
    if (size < sizeof head) {
        return unit.say(error, "serialized state: %zu bytes; expected at least %zu", size, sizeof head);
    }
    std::memcpy(&head, bytes, sizeof head);
    std::unique_ptr<Unit> made = unit.copy();
    const Status status = made->go_on_from(bytes + sizeof head, size - sizeof head);
    if (status == ok) {
        made->phase = static_cast<Phase>(head.phase);
        made->now_s = head.now_s;
        *kept = made.release();
    }
    return status;
}

Status nothing_of(void* instance, const char* function) {
    return of(instance).say(error, "%s: this FMU has none; see modelDescription.xml", function);
}

// For a function of event mode: whether it may be called.
Status in_events(void* instance, const char* function) {
    return of(instance).phase == Phase::event ? ok : of(instance).say(error, "%s: called outside event mode", function);
}

}  // namespace

#define LPVG_FMI extern "C" __attribute__((visibility("default")))
// A function for what this FMU does not have, whatever its further arguments.
#define LPVG_FMI_NONE(name) \
    LPVG_FMI int name(void* instance, ...) { return nothing_of(instance, #name); }

// ---------------------------------------------------------------------------------------------------------------- FMI 2.0

struct Callbacks2 {
    void* logger;
    void* allocate;
    void* release;
    void* step_finished;
    void* environment;
};

#define LPVG_FMI2_VALUES(type, Own, T)                                                                       \
    LPVG_FMI int fmi2Get##type(void* instance, const unsigned* references, std::size_t n, T* values) {       \
        return get<Own>(instance, references, n, values);                                                    \
    }                                                                                                        \
    LPVG_FMI int fmi2Set##type(void* instance, const unsigned* references, std::size_t n, T const* values) { \
        return set<Own>(instance, references, n, values);                                                    \
    }
LPVG_FMI2_VALUES(Real, double, double)
LPVG_FMI2_VALUES(Integer, int64_t, int)
LPVG_FMI2_VALUES(Boolean, bool, int)
LPVG_FMI2_VALUES(String, const char*, const char*)

LPVG_FMI const char* fmi2GetTypesPlatform() { return "default"; }
LPVG_FMI const char* fmi2GetVersion() { return "2.0"; }
LPVG_FMI int fmi2SetDebugLogging(void*, int, std::size_t, const char* const*) { return ok; }
LPVG_FMI void* fmi2Instantiate(const char* name, int kind, const char* /*guid*/, const char*, const Callbacks2* callbacks, int, int) {
    return kind == 1 ? instantiate(name, callbacks->environment, callbacks->logger, nullptr, false) : nullptr;
}
LPVG_FMI void fmi2FreeInstance(void* instance) { delete static_cast<Instance*>(instance); }
LPVG_FMI int fmi2SetupExperiment(void* instance, int, double, double start_s, int, double) {
    of(instance).now_s = start_s;
    return ok;
}
LPVG_FMI int fmi2EnterInitializationMode(void* instance) { return initialise(instance, of(instance).now_s, "fmi2EnterInitializationMode"); }
LPVG_FMI int fmi2ExitInitializationMode(void* instance) { return exit_initialisation(instance, "fmi2ExitInitializationMode"); }
LPVG_FMI int fmi2Terminate(void* instance) { return terminate(instance, "fmi2Terminate"); }
LPVG_FMI int fmi2Reset(void* instance) { return reset(instance); }
LPVG_FMI int fmi2GetFMUstate(void* instance, void** kept) { return keep_state(instance, kept); }
LPVG_FMI int fmi2SetFMUstate(void* instance, void* kept) { return go_on(instance, kept); }
LPVG_FMI int fmi2FreeFMUstate(void*, void** kept) { return drop_state(kept); }
LPVG_FMI int fmi2SerializedFMUstateSize(void* instance, void* kept, std::size_t* size) { return serialized_size(instance, kept, size); }
LPVG_FMI int fmi2SerializeFMUstate(void* instance, void* kept, unsigned char* bytes, std::size_t size) {
    return serialize(instance, kept, bytes, size);
}
LPVG_FMI int fmi2DeSerializeFMUstate(void* instance, const unsigned char* bytes, std::size_t size, void** kept) {
    return deserialize(instance, bytes, size, kept);
}
LPVG_FMI int fmi2DoStep(void* instance, double t, double h, int) { return step(instance, t, h); }
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

#define LPVG_FMI3_VALUES(type, Own, T)                                                                                    \
    LPVG_FMI int fmi3Get##type(void* instance, const unsigned* references, std::size_t n, T* values, std::size_t) {       \
        return get<Own>(instance, references, n, values);                                                                 \
    }                                                                                                                     \
    LPVG_FMI int fmi3Set##type(void* instance, const unsigned* references, std::size_t n, T const* values, std::size_t) { \
        return set<Own>(instance, references, n, values);                                                                 \
    }
LPVG_FMI3_VALUES(Float64, double, double)
LPVG_FMI3_VALUES(Int64, int64_t, int64_t)
LPVG_FMI3_VALUES(UInt32, int64_t, uint32_t)
LPVG_FMI3_VALUES(Boolean, bool, bool)
LPVG_FMI3_VALUES(String, const char*, const char*)

LPVG_FMI const char* fmi3GetVersion() { return "3.0"; }
LPVG_FMI int fmi3SetDebugLogging(void*, bool, std::size_t, const char* const*) { return ok; }
LPVG_FMI void* fmi3InstantiateCoSimulation(const char* name, const char* /*token*/, const char*, bool, bool, bool with_events, bool,
                                           const unsigned*, std::size_t, void* environment, void* logger, void* /*intermediate*/) {
    return instantiate(name, environment, nullptr, logger, with_events);
}
LPVG_FMI void* fmi3InstantiateModelExchange(...) { return nullptr; }
LPVG_FMI void* fmi3InstantiateScheduledExecution(...) { return nullptr; }
LPVG_FMI void fmi3FreeInstance(void* instance) { fmi2FreeInstance(instance); }
LPVG_FMI int fmi3EnterInitializationMode(void* instance, bool, double, double start_s, bool, double) {
    return initialise(instance, start_s, "fmi3EnterInitializationMode");
}
LPVG_FMI int fmi3ExitInitializationMode(void* instance) { return exit_initialisation(instance, "fmi3ExitInitializationMode"); }
LPVG_FMI int fmi3Terminate(void* instance) { return terminate(instance, "fmi3Terminate"); }
LPVG_FMI int fmi3Reset(void* instance) { return reset(instance); }
LPVG_FMI int fmi3GetFMUState(void* instance, void** kept) { return keep_state(instance, kept); }
LPVG_FMI int fmi3SetFMUState(void* instance, void* kept) { return go_on(instance, kept); }
LPVG_FMI int fmi3FreeFMUState(void*, void** kept) { return drop_state(kept); }
LPVG_FMI int fmi3SerializedFMUStateSize(void* instance, void* kept, std::size_t* size) { return serialized_size(instance, kept, size); }
LPVG_FMI int fmi3SerializeFMUState(void* instance, void* kept, unsigned char* bytes, std::size_t size) {
    return serialize(instance, kept, bytes, size);
}
LPVG_FMI int fmi3DeserializeFMUState(void* instance, const unsigned char* bytes, std::size_t size, void** kept) {
    return deserialize(instance, bytes, size, kept);
}
LPVG_FMI int fmi3DoStep(void* instance, double t, double h, bool, bool* event, bool* terminate, bool* early, double* last) {
    *event = of(instance).with_events;
    *terminate = false;
    *early = false;
    const Status status = step(instance, t, h);
    *last = of(instance).now_s;
    return status;
}
LPVG_FMI int fmi3EnterEventMode(void* instance) {
    return of(instance).with_events ? enter(instance, Phase::stepping, Phase::event, "fmi3EnterEventMode")
                                    : nothing_of(instance, "fmi3EnterEventMode without event mode at the instantiation");
}
LPVG_FMI int fmi3EnterStepMode(void* instance) { return enter(instance, Phase::event, Phase::stepping, "fmi3EnterStepMode"); }
LPVG_FMI int fmi3SetBinary(void* instance, const unsigned* references, std::size_t n, const std::size_t* sizes,
                           const unsigned char* const* values, std::size_t) {
    Status status = in_events(instance, "fmi3SetBinary");
    for (std::size_t k = 0; k < n && status == ok; ++k) {
        status = of(instance).set_binary(references[k], values[k], sizes[k]);
    }
    return status;
}
LPVG_FMI int fmi3GetBinary(void* instance, const unsigned* references, std::size_t n, std::size_t* sizes, const unsigned char** values,
                           std::size_t) {
    Status status = in_events(instance, "fmi3GetBinary");
    for (std::size_t k = 0; k < n && status == ok; ++k) {
        status = of(instance).get_binary(references[k], values[k], sizes[k]);
    }
    return status;
}
LPVG_FMI int fmi3SetClock(void* instance, const unsigned* references, std::size_t n, const bool* active) {
    Status status = in_events(instance, "fmi3SetClock");
    for (std::size_t k = 0; k < n && status == ok; ++k) {
        status = active[k] ? of(instance).tick(references[k]) : ok;
    }
    return status;
}
LPVG_FMI int fmi3EvaluateDiscreteStates(void* instance) { return in_events(instance, "fmi3EvaluateDiscreteStates"); }
LPVG_FMI int fmi3UpdateDiscreteStates(void* instance, bool* again, bool* terminate, bool* nominals, bool* values, bool* has_next,
                                      double* next) {
    *again = *terminate = *nominals = *values = *has_next = false;
    *next = 0.0;
    const Status status = in_events(instance, "fmi3UpdateDiscreteStates");
    return status == ok ? of(instance).update() : status;
}
LPVG_FMI_NONE(fmi3EnterConfigurationMode)
LPVG_FMI_NONE(fmi3ExitConfigurationMode)
LPVG_FMI_NONE(fmi3GetFloat32)
LPVG_FMI_NONE(fmi3GetInt8)
LPVG_FMI_NONE(fmi3GetUInt8)
LPVG_FMI_NONE(fmi3GetInt16)
LPVG_FMI_NONE(fmi3GetUInt16)
LPVG_FMI_NONE(fmi3GetInt32)
LPVG_FMI_NONE(fmi3GetUInt64)
LPVG_FMI_NONE(fmi3GetClock)
LPVG_FMI_NONE(fmi3SetFloat32)
LPVG_FMI_NONE(fmi3SetInt8)
LPVG_FMI_NONE(fmi3SetUInt8)
LPVG_FMI_NONE(fmi3SetInt16)
LPVG_FMI_NONE(fmi3SetUInt16)
LPVG_FMI_NONE(fmi3SetInt32)
LPVG_FMI_NONE(fmi3SetUInt64)
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
