#include "lpvguard_plant/scenario.hpp"

#include <optional>
#include <string_view>
#include <utility>
#include <vector>

#include "toml_input.hpp"

namespace lpvguard_plant {
namespace {

template <typename Owner>
struct Key {
    std::string_view name;
    double Owner::* member;
    double low;
    double high;
};

constexpr Key<Window> window_keys[] = {
    {"start_s", &Window::start_s, 0.0, 1e9},
    {"end_s", &Window::end_s, 0.0, 1e9},
    {"ramp_s", &Window::ramp_s, 0.0, 1e9},
};

constexpr Key<Variation> variation_keys[] = {
    {"load_ratio", &Variation::load_ratio, 0.4, 3.0},
    {"cg_shift_m", &Variation::cg_shift_m, -1.5, 1.5},
    {"cg_height_ratio", &Variation::cg_height_ratio, 0.3, 2.5},
    {"friction_left_ratio", &Variation::friction_left_ratio, 0.05, 1.5},
    {"friction_right_ratio", &Variation::friction_right_ratio, 0.05, 1.5},
    {"cornering_stiffness_front_ratio", &Variation::cornering_stiffness_front_ratio, 0.2, 3.0},
    {"cornering_stiffness_rear_ratio", &Variation::cornering_stiffness_rear_ratio, 0.2, 3.0},
    {"brake_gain_ratio", &Variation::brake_gain_ratio, 0.0, 5.0},
    {"brake_lag_ratio", &Variation::brake_lag_ratio, 0.1, 10.0},
    {"extra_brake_delay_s", &Variation::extra_brake_delay_s, 0.0, 0.96},
    {"crosswind_mean_mps", &Variation::crosswind_mean_mps, -30.0, 30.0},
    {"sensor_noise_ratio", &Variation::sensor_noise_ratio, 0.0, 50.0},
    {"sensor_lsb_ratio", &Variation::sensor_lsb_ratio, 0.001, 1000.0},
};

constexpr Key<SensorFault> sensor_keys[] = {
    {"gain", &SensorFault::gain, -10.0, 10.0},
    {"bias", &SensorFault::bias, -100.0, 100.0},
    {"drift_ps", &SensorFault::drift_ps, -10.0, 10.0},
    {"extra_noise_rms", &SensorFault::extra_noise_rms, 0.0, 100.0},
};

constexpr Key<ActuatorFault> actuator_keys[] = {
    {"brake_gain_ratio", &ActuatorFault::brake_gain_ratio, 0.0, 10.0},
    {"extra_lag_s", &ActuatorFault::extra_lag_s, 0.0, 10.0},
    {"extra_delay_s", &ActuatorFault::extra_delay_s, 0.0, Plant::longest_delay_s},
};

constexpr Key<SurroundingsFault> surroundings_keys[] = {
    {"friction_left_ratio", &SurroundingsFault::friction_left_ratio, 0.02, 5.0},
    {"friction_right_ratio", &SurroundingsFault::friction_right_ratio, 0.02, 5.0},
    {"cornering_stiffness_front_ratio", &SurroundingsFault::cornering_stiffness_front_ratio, 0.02, 5.0},
    {"cornering_stiffness_rear_ratio", &SurroundingsFault::cornering_stiffness_rear_ratio, 0.02, 5.0},
    {"crosswind_mps", &SurroundingsFault::crosswind_mps, -50.0, 50.0},
};

constexpr Key<SpeedChange> speed_change_keys[] = {
    {"start_s", &SpeedChange::start_s, 0.0, 1e9},
    {"speed_mps", &SpeedChange::speed_mps, Plant::slowest_mps, Plant::fastest_mps},
    {"rate_mps2", &SpeedChange::rate_mps2, 0.01, 5.0},
};

struct SignalName {
    std::string_view name;
    Signal signal;
};

constexpr SignalName signal_names[signal_count] = {
    {"yaw_rate", Signal::yaw_rate},
    {"steering_wheel", Signal::steering_wheel},
    {"lateral_acceleration", Signal::lateral_acceleration},
    {"speed", Signal::speed},
    {"wheel_speed_front_left", Signal::wheel_speed_front_left},
    {"wheel_speed_front_right", Signal::wheel_speed_front_right},
    {"wheel_speed_rear_left", Signal::wheel_speed_rear_left},
    {"wheel_speed_rear_right", Signal::wheel_speed_rear_right},
    {"brake_pressure_left", Signal::brake_pressure_left},
    {"brake_pressure_right", Signal::brake_pressure_right},
};

/// One table of a scenario. Reading a key removes it, so that done() can refuse unknown keys.
class Table {
public:
    Table(toml::table table, const std::string& file, const std::string& where) : table_(std::move(table)), file_(file), where_(where) {}

    template <typename Owner, std::size_t count>
    void take(Owner& owner, const Key<Owner> (&keys)[count]) {
        for (const Key<Owner>& key : keys) {
            if (const std::optional<double> value = take_number(key.name, key.low, key.high)) {
                owner.*key.member = *value;
            }
        }
    }

    void require(std::string_view name) const {
        if (!table_.contains(name)) {
            throw ParameterError(file_ + ": " + path(name) + ": missing, expected a number");
        }
    }

    std::optional<double> take_number(std::string_view name, double low, double high) {
        const toml::node* const node = table_.get(name);
        if (node == nullptr) {
            return std::nullopt;
        }
        const double value = number(*node, file_, path(name));
        require_in_range(file_, path(name), value, low, high);
        table_.erase(name);
        return value;
    }

    bool take_flag(std::string_view name) {
        const toml::node* const node = table_.get(name);
        if (node == nullptr) {
            return false;
        }
        if (!node->is_boolean()) {
            throw ParameterError(file_ + ": " + path(name) + ": expected true or false");
        }
        const bool value = *node->value<bool>();
        table_.erase(name);
        return value;
    }

    Signal take_signal(std::string_view name) {
        const std::string text = table_[name].value_or(std::string{});
        for (const SignalName& candidate : signal_names) {
            if (candidate.name == text) {
                table_.erase(name);
                return candidate.signal;
            }
        }
        std::string message = file_ + ": " + path(name) + " = \"" + text + "\": expected one of:";
        for (const SignalName& candidate : signal_names) {
            message += ' ';
            message += candidate.name;
        }
        throw ParameterError(message);
    }

    /// The knots of `name = [[time, speed], ...]`.
    std::vector<SpeedKnot> take_profile(std::string_view name) {
        const toml::array* const rows = table_[name].as_array();
        if (rows == nullptr || rows->empty()) {
            throw ParameterError(file_ + ": " + path(name) + ": missing, expected [[time s, speed m/s], ...]");
        }
        std::vector<SpeedKnot> knots;
        for (const toml::node& row : *rows) {
            const toml::array* const pair = row.as_array();
            if (pair == nullptr || pair->size() != 2) {
                throw ParameterError(file_ + ": " + path(name) + ": expected [[time s, speed m/s], ...]");
            }
            SpeedKnot knot;
            knot.time_s = number(*pair->get(0), file_, path(name));
            knot.speed_mps = number(*pair->get(1), file_, path(name));
            const double after = knots.empty() ? 0.0 : knots.back().time_s + Plant::step_s;
            require_in_range(file_, path(name) + " time", knot.time_s, after, 1e9);
            require_in_range(file_, path(name) + " speed", knot.speed_mps, 0.1, 100.0);  // of any vehicle; Plant has the truck's
            knots.push_back(knot);
        }
        table_.erase(name);
        return knots;
    }

    std::optional<Table> take_table(std::string_view name) {
        toml::node* const node = table_.get(name);
        if (node == nullptr) {
            return std::nullopt;
        }
        if (!node->is_table()) {
            throw ParameterError(file_ + ": " + path(name) + ": expected a table");
        }
        Table result(std::move(*node->as_table()), file_, path(name));
        table_.erase(name);
        return result;
    }

    std::vector<Table> take_tables(std::string_view name) {
        std::vector<Table> result;
        if (toml::node* const node = table_.get(name)) {
            toml::array* const tables = node->as_array();
            if (tables == nullptr || !tables->is_homogeneous<toml::table>()) {
                throw ParameterError(file_ + ": " + path(name) + ": expected an array of tables, [[" + path(name) + "]]");
            }
            for (toml::node& item : *tables) {
                result.emplace_back(std::move(*item.as_table()), file_, path(name));
            }
            table_.erase(name);
        }
        return result;
    }

    void done() const {
        for (const auto& [key, node] : table_) {
            static_cast<void>(node);
            throw ParameterError(file_ + ": " + path(key.str()) + ": unknown key");
        }
    }

    Window take_window() {
        Window window;
        take(window, window_keys);
        if (!(window.end_s > window.start_s)) {
            throw ParameterError(file_ + ": " + path("end_s") + ": expected later than start_s");
        }
        return window;
    }

private:
    std::string path(std::string_view name) const { return where_ + "." + std::string(name); }

    toml::table table_;
    std::string file_;
    std::string where_;
};

}  // namespace

Scenario parse_scenario(const std::string& toml_text, const std::string& name) {
    toml::table document = parse_toml(toml_text, name);
    toml::table* const root = document["plant"].as_table();
    if (root == nullptr) {
        throw ParameterError(name + ": plant: missing, expected a table [plant]");
    }
    Table plant(std::move(*root), name, "plant");
    Scenario scenario;
    scenario.drive.speed_profile = plant.take_profile("speed_profile");
    scenario.drive.speed_is_free = plant.take_flag("speed_is_free");
    if (std::optional<Table> table = plant.take_table("variation")) {
        table->take(scenario.variation, variation_keys);
        scenario.variation.bank_rms_rad = table->take_number("bank_rms_rad", 0.0, 0.05);
        scenario.variation.crosswind_gust_rms_mps = table->take_number("crosswind_gust_rms_mps", 0.0, 10.0);
        table->done();
    }
    for (Table& table : plant.take_tables("sensor_fault")) {
        SensorFault fault;
        fault.signal = table.take_signal("signal");
        fault.window = table.take_window();
        table.take(fault, sensor_keys);
        fault.frozen = table.take_flag("frozen");
        table.done();
        scenario.faults.sensors.push_back(fault);
    }
    for (Table& table : plant.take_tables("actuator_fault")) {
        ActuatorFault fault;
        fault.window = table.take_window();
        table.take(fault, actuator_keys);
        table.done();
        scenario.faults.actuators.push_back(fault);
    }
    for (Table& table : plant.take_tables("surroundings_fault")) {
        SurroundingsFault fault;
        fault.window = table.take_window();
        table.take(fault, surroundings_keys);
        table.done();
        scenario.faults.surroundings.push_back(fault);
    }
    for (Table& table : plant.take_tables("speed_change")) {
        SpeedChange change;
        table.require("speed_mps");
        table.take(change, speed_change_keys);
        table.done();
        scenario.drive.speed_changes.push_back(change);
    }
    plant.done();
    return scenario;
}

Scenario load_scenario(const std::string& path) { return parse_scenario(read_text(path), path); }

}  // namespace lpvguard_plant
