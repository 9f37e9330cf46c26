// unit.hpp -- a functional mock-up unit without FMI: fmi.cpp has the functions of FMI 2.0 and FMI 3.0 around it.
#pragma once

#include <cstdarg>
#include <cstddef>
#include <cstdint>
#include <cstdio>
#include <memory>
#include <string>
#include <utility>
#include <vector>

namespace lpvguard_fmu {

enum Status {
    ok = 0,
    warning = 1,
    error = 3
};  // The same numbers in FMI 2 and FMI 3.

enum class Phase : uint32_t {
    instantiated,
    initialising,
    stepping,
    event,
    terminated
};

// The importer's functions for messages. A null pointer: it has none.
struct Log {
    std::string name;
    void* environment = nullptr;
    void* log2 = nullptr;  // of FMI 2, which is variadic
    void* log3 = nullptr;  // of FMI 3

    __attribute__((format(printf, 3, 4))) Status say(Status status, const char* format, ...) const {
        char text[512];
        va_list arguments;
        va_start(arguments, format);
        std::vsnprintf(text, sizeof text, format, arguments);
        va_end(arguments);
        const char* category = status == error ? "logStatusError" : "logStatusWarning";
        if (log2 != nullptr) {
            using Log2 = void (*)(void*, const char*, int, const char*, const char*, ...);
            reinterpret_cast<Log2>(log2)(environment, name.c_str(), status, category, "%s", text);
        }
        if (log3 != nullptr) {
            using Log3 = void (*)(void*, int, const char*, const char*);
            reinterpret_cast<Log3>(log3)(environment, status, category, text);
        }
        return status;
    }
};

// What the FMU computes. References are those of modelDescription.xml. A function of what a unit does not have says so.
class Unit {
public:
    explicit Unit(const Log& log) : log_(log) {}
    Unit& operator=(const Unit&) = delete;
    virtual ~Unit() = default;

    Phase phase = Phase::instantiated;
    double now_s = 0.0;         // end of the newest step
    bool with_events = false;   // the importer uses event mode

    virtual double period_s() const = 0;
    virtual Status start() = 0;  // at the end of the initialisation, and before it with the start values
    virtual Status step() = 0;   // from now_s on

    virtual Status set(unsigned reference, double) { return none(reference, "input"); }
    virtual Status set(unsigned reference, int64_t) { return none(reference, "integer parameter"); }
    virtual Status set(unsigned reference, bool) { return none(reference, "boolean parameter"); }
    virtual Status set(unsigned reference, const char*) { return none(reference, "text parameter"); }
    virtual Status get(unsigned reference, double&) const { return none(reference, "number"); }
    virtual Status get(unsigned reference, int64_t&) const { return none(reference, "integer"); }
    virtual Status get(unsigned reference, bool&) const { return none(reference, "boolean"); }
    virtual Status get(unsigned reference, const char*&) const { return none(reference, "text"); }

    // Event mode: clocked binary variables.
    virtual bool has_events() const { return false; }
    virtual Status set_binary(unsigned reference, const unsigned char*, std::size_t) { return none(reference, "binary input"); }
    virtual Status get_binary(unsigned reference, const unsigned char*&, std::size_t&) { return none(reference, "binary output"); }
    virtual Status tick(unsigned reference) { return none(reference, "input clock"); }
    virtual Status update() { return ok; }

    // A copy that is only kept, and going on from one.
    virtual std::unique_ptr<Unit> copy() const = 0;
    virtual void go_on_from(const Unit& kept) = 0;
    // The same bytes in every process. Empty: cannot be serialized.
    virtual std::vector<unsigned char> bytes() const { return {}; }
    virtual Status go_on_from(const unsigned char*, std::size_t) { return say(error, "this FMU's states are not serialized"); }

    template <typename... Arguments>
    Status say(Status status, const char* format, Arguments... arguments) const {
        return log_.say(status, format, arguments...);
    }

protected:
    Unit(const Unit&) = default;
    Status none(unsigned reference, const char* what) const {
        return say(error, "value reference %u: this FMU has no such %s; see modelDescription.xml", reference, what);
    }
    // Inputs are numbers with the references from 0.
    template <std::size_t n>
    Status set_input(double (&inputs)[n], unsigned reference, double value) const {
        if (reference >= n) {
            return none(reference, "input");
        }
        inputs[reference] = value;
        return ok;
    }

private:
    Log log_;
};

// Made by the file of each unit. Null: it has said why.
std::unique_ptr<Unit> make_unit(const Log& log);

template <class Kind>
std::unique_ptr<Unit> started(const Log& log) {
    auto unit = std::make_unique<Kind>(log);
    return unit->start() == ok ? std::move(unit) : nullptr;
}

}  // namespace lpvguard_fmu
