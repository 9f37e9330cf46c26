#include <cmath>
#include <cstdarg>
#include <cstdio>
#include <cstdlib>
#include <map>
#include <optional>
#include <stdexcept>

#include <dlfcn.h>

#include "toml_input.hpp"
#include "vehicle_model.hpp"

namespace lpvguard_sim {
namespace {

using lpvguard_plant::ParameterError;
using lpvguard_plant::Sensors;
using lpvguard_plant::Truth;
using lpvguard_plant::Wheel;

constexpr int worst_status = 1;  // ok and warning

/// The functions of FMI 2.0 or 3.0 that a vehicle needs. The caller manages the rest of the instance.
class Fmu {
public:
    explicit Fmu(const toml::table& link, const std::string& file)
        : version_(static_cast<int>(lpvguard_plant::number(*link.get("version"), file, "version"))) {
        const auto text = [&](const char* key) { return link[key].value_or(std::string{}); };
        library_.reset(::dlopen(text("library").c_str(), RTLD_NOW | RTLD_LOCAL));
        if (library_ == nullptr) {
            throw std::runtime_error(text("library") + ": " + ::dlerror());
        }
        const std::string token = text("token"), resources = text("resources");
        if (version_ == 2) {
            callbacks_ = {&Fmu::hear2, &std::calloc, &std::free, nullptr, this};
            const std::string uri = "file://" + resources;
            instance_ = function<void*(const char*, int, const char*, const char*, const Callbacks2*, int, int)>("Instantiate")(
                "vehicle", 1, token.c_str(), uri.c_str(), &callbacks_, 0, 0);
        } else {
            instance_ = function<void*(const char*, const char*, const char*, bool, bool, bool, bool, const unsigned*, std::size_t, void*,
                                       void (*)(void*, int, const char*, const char*), void*)>("InstantiateCoSimulation")(
                "vehicle", token.c_str(), (resources + "/").c_str(), false, false, false, false, nullptr, 0, this, &Fmu::hear3, nullptr);
        }
        if (instance_ == nullptr) {
            throw std::runtime_error("the FMU makes no instance: " + said_);
        }
    }
    Fmu(const Fmu&) = delete;
    Fmu& operator=(const Fmu&) = delete;
    ~Fmu() { function<void(void*)>("FreeInstance")(instance_); }

    template <class T>
    void set(const char* type, unsigned reference, T value) {
        if (version_ == 2) {
            call<int(void*, const unsigned*, std::size_t, const T*)>(std::string("Set") + type, &reference, 1U, &value);
        } else {
            call<int(void*, const unsigned*, std::size_t, const T*, std::size_t)>(std::string("Set") + type, &reference, 1U, &value, 1U);
        }
    }
    void set_number(unsigned reference, double value) { set(version_ == 2 ? "Real" : "Float64", reference, value); }
    double get_number(unsigned reference) {
        double value = 0.0;
        if (version_ == 2) {
            call<int(void*, const unsigned*, std::size_t, double*)>("GetReal", &reference, 1U, &value);
        } else {
            call<int(void*, const unsigned*, std::size_t, double*, std::size_t)>("GetFloat64", &reference, 1U, &value, 1U);
        }
        return value;
    }
    void begin() {
        if (version_ == 2) {
            call<int(void*, int, double, double, int, double)>("SetupExperiment", 0, 0.0, 0.0, 0, 0.0);
            call<int(void*)>("EnterInitializationMode");
        } else {
            call<int(void*, bool, double, double, bool, double)>("EnterInitializationMode", false, 0.0, 0.0, false, 0.0);
        }
        call<int(void*)>("ExitInitializationMode");
    }
    void step(double t, double h) {
        if (version_ == 2) {
            call<int(void*, double, double, int)>("DoStep", t, h, 1);
        } else {
            bool event = false, terminate = false, early = false;
            double last = t;
            call<int(void*, double, double, bool, bool*, bool*, bool*, double*)>("DoStep", t, h, true, &event, &terminate, &early, &last);
            if (terminate) {
                throw std::runtime_error("the FMU ends its simulation at " + std::to_string(last) + " s");
            }
        }
    }

private:
    struct Callbacks2 {
        void (*logger)(void*, const char*, int, const char*, const char*, ...);
        void* (*allocate)(std::size_t, std::size_t);
        void (*release)(void*);
        void (*step_finished)(void*, int);
        void* environment;
    };
    struct Close {
        void operator()(void* library) const { ::dlclose(library); }
    };

    static void hear2(void* self, const char*, int, const char*, const char* format, ...) {
        char text[1024];
        va_list arguments;
        va_start(arguments, format);
        std::vsnprintf(text, sizeof text, format, arguments);
        va_end(arguments);
        static_cast<Fmu*>(self)->said_ = text;
    }
    static void hear3(void* self, int, const char*, const char* text) { static_cast<Fmu*>(self)->said_ = text; }

    template <class F>
    F* function(const std::string& name) {
        void*& found = functions_[name];
        if (found == nullptr) {
            found = ::dlsym(library_.get(), ((version_ == 2 ? "fmi2" : "fmi3") + name).c_str());
        }
        if (found == nullptr) {
            throw std::runtime_error("the FMU has no function " + name);
        }
        return reinterpret_cast<F*>(found);
    }
    template <class F, class... Arguments>
    void call(const std::string& name, Arguments... arguments) {
        said_.clear();
        if (function<F>(name)(instance_, arguments...) > worst_status) {
            throw std::runtime_error("the FMU's function " + name + " failed: " + (said_.empty() ? "it says nothing" : said_));
        }
    }

    int version_;
    std::unique_ptr<void, Close> library_;
    Callbacks2 callbacks_{};
    std::map<std::string, void*> functions_;
    std::string said_;
    void* instance_ = nullptr;
};

/// A variable of the FMU. Our quantity is factor x value + offset.
struct Linked {
    std::string name;
    unsigned reference;
    double factor, offset;
};

std::vector<Linked> read_linked(const toml::table& link, const std::string& key, const std::string& file) {
    std::vector<Linked> linked;
    for (const toml::node& node : *link[key].as_array()) {
        const toml::table& table = *node.as_table();
        const auto value = [&](const char* name) { return lpvguard_plant::number(*table.get(name), file, key + "." + name); };
        linked.push_back(
            {table["name"].value_or(std::string{}), static_cast<unsigned>(value("reference")), value("factor"), value("offset")});
    }
    return linked;
}

class FmuVehicle final : public VehicleModel {
public:
    FmuVehicle(const toml::table& link, const std::string& file, const Scenario& scenario, const std::string& text)
        : fmu_(link, file),
          profile_(scenario.plant.drive.speed_profile),
          tick_s_(lpvguard_plant::number(*link.get("tick_s"), file, "tick_s")),
          step_s_(lpvguard_plant::number(*link.get("step_s"), file, "step_s")),
          track_m_(link["track_m"].value_or(0.0)),
          inputs_(read_linked(link, "inputs", file)),
          outputs_(read_linked(link, "outputs", file)),
          controlled_(link["controlled"].value<std::int64_t>()),
          values_(outputs_.size()) {
        for (const toml::node& node : *link["parameters"].as_array()) {
            set_parameter(*node.as_table());
        }
        if (const auto reference = link["scenario"].value<std::int64_t>()) {
            fmu_.set<const char*>("String", static_cast<unsigned>(*reference), text.c_str());
        }
        give(0.0, std::vector<double>(inputs_.size()).data());
        fmu_.begin();
        read(0.0);
    }

    const Truth& truth() const override { return truth_; }
    const Sensors& sensors() const override { return sensors_; }
    const double* values() const override { return controlled_ ? values_.data() : nullptr; }
    void advance(const double* demand) override {
        const auto steps = std::lround(tick_s_ / step_s_);
        for (long i = 0; i < steps; ++i) {
            const double time_s = static_cast<double>(ticks_) * tick_s_ + static_cast<double>(i) * step_s_;
            give(time_s, demand);
            fmu_.step(time_s, step_s_);
        }
        ++ticks_;
        read(static_cast<double>(ticks_) * tick_s_);
    }
    void revise(const lpvguard_plant::Drive&, const lpvguard_plant::Faults&) override {
        throw std::runtime_error("an FMU's drive and faults cannot be changed while it runs");
    }

private:
    void set_parameter(const toml::table& table) {
        const auto reference = static_cast<unsigned>(table["reference"].value_or(std::int64_t{0}));
        const std::string type = table["type"].value_or(std::string{});
        const toml::node& value = *table.get("value");
        const bool integer = value.is_integer();
        const std::int64_t number = value.value_or(std::int64_t{0});
        if (type == "String") {
            fmu_.set<const char*>("String", reference, value.as_string()->get().c_str());
        } else if (type == "Boolean2") {
            fmu_.set("Boolean", reference, value.value_or(false) ? 1 : 0);
        } else if (type == "Boolean") {
            fmu_.set("Boolean", reference, value.value_or(false));
        } else if (type == "Real" || type == "Float64") {
            fmu_.set_number(reference, integer ? static_cast<double>(number) : value.value_or(0.0));
        } else if (type == "Int64") {
            fmu_.set("Int64", reference, number);
        } else if (type == "UInt64") {
            fmu_.set("UInt64", reference, static_cast<std::uint64_t>(number));
        } else if (type == "UInt32") {
            fmu_.set("UInt32", reference, static_cast<std::uint32_t>(number));
        } else {
            fmu_.set(type.c_str(), reference, static_cast<std::int32_t>(number));
        }
    }

    void give(double time_s, const double* demand) {
        for (const Linked& input : inputs_) {
            const double value = input.name == "speed" ? lpvguard_plant::speed_at(profile_, time_s, profile_segment_) : *demand++;
            fmu_.set_number(input.reference, (value - input.offset) / input.factor);
        }
    }

    void read(double time_s) {
        std::map<std::string, double> seen;
        auto next = values_.begin();
        for (const Linked& output : outputs_) {
            const double value = output.factor * fmu_.get_number(output.reference) + output.offset;
            if (!std::isfinite(value)) {
                throw std::runtime_error("the FMU's output for " + output.name + " is not finite at " + std::to_string(time_s) + " s");
            }
            seen[output.name] = *next++ = value;
        }
        const auto of = [&](const char* name, double otherwise) {
            const auto found = seen.find(name);
            return found == seen.end() ? otherwise : found->second;
        };
        Sensors& s = sensors_;
        s.time_s = truth_.time_s = time_s;
        s.speed_mps = of("speed", 0.0);
        s.yaw_rate_radps = of("yaw_rate", 0.0);
        s.steering_wheel_rad = of("steering_wheel_angle", 0.0);
        s.lateral_acceleration_mps2 = of("lateral_acceleration", 0.0);
        const double right_faster = 0.5 * track_m_ * s.yaw_rate_radps;
        s.wheel_speed_mps[Wheel::front_left] = of("wheel_speed_front_left", s.speed_mps - right_faster);
        s.wheel_speed_mps[Wheel::front_right] = of("wheel_speed_front_right", s.speed_mps + right_faster);
        s.wheel_speed_mps[Wheel::rear_left] = of("wheel_speed_rear_left", s.speed_mps - right_faster);
        s.wheel_speed_mps[Wheel::rear_right] = of("wheel_speed_rear_right", s.speed_mps + right_faster);
        const double difference = of("brake_pressure_difference", 0.0);
        s.brake_pressure_left_bar = of("brake_pressure_left", std::fmax(-difference, 0.0));
        s.brake_pressure_right_bar = of("brake_pressure_right", std::fmax(difference, 0.0));
        truth_.speed_mps = of("true_speed", s.speed_mps);
        truth_.yaw_rate_radps = controlled_ ? values_[static_cast<std::size_t>(*controlled_)] : of("true_yaw_rate", s.yaw_rate_radps);
        truth_.lateral_acceleration_mps2 = of("true_lateral_acceleration", s.lateral_acceleration_mps2);
        truth_.road_wheel_rad = of("true_road_wheel_angle", 0.0);
    }

    Fmu fmu_;
    std::vector<lpvguard_plant::SpeedKnot> profile_;
    double tick_s_, step_s_, track_m_;
    std::vector<Linked> inputs_, outputs_;
    std::optional<std::int64_t> controlled_;  ///< index of the controlled output, for a vehicle on its own bus
    std::vector<double> values_;              ///< of the outputs
    std::int64_t ticks_ = 0;
    std::size_t profile_segment_ = 0;
    Truth truth_{};
    Sensors sensors_{};
};

}  // namespace

std::unique_ptr<VehicleModel> fmu_vehicle(const std::string& link, const Scenario& scenario, const std::string& text) {
    const toml::table table = lpvguard_plant::parse_toml(lpvguard_plant::read_text(link), link);
    return std::make_unique<FmuVehicle>(table, link, scenario, text);
}

}  // namespace lpvguard_sim
