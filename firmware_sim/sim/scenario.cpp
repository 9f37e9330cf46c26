#include "scenario.hpp"

#include <string_view>

#include "lpvg_can_codec.h"
#include "toml_input.hpp"

#if __has_include("lpvg_rest.h")
#include "lpvg_rest.h"
#endif

namespace lpvguard_sim {
namespace {

using lpvguard_plant::number;
using lpvguard_plant::ParameterError;
using lpvguard_plant::require_in_range;
using lpvguard_plant::require_known_keys;

/// A word of the file and its value.
template <class Value>
struct Named {
    std::string_view name;
    Value value;
};

/// Largest rms and amplitude of the command: of the truck's yaw rate, or of any output of a vehicle on its own bus.
#ifdef LPVG_REST_H
constexpr double rms_max = 1e3, amplitude_max = 1e3;
#else
constexpr double rms_max = 0.2, amplitude_max = 0.5;
#endif

/// Messages to the controller.
std::vector<Named<std::uint32_t>> message_names() {
#ifdef LPVG_REST_H
    std::vector<Named<std::uint32_t>> names;
    for (std::size_t i = 0; i < LPVG_REST_MESSAGES; ++i) {
        names.push_back({lpvg_rest_messages[i].name, lpvg_rest_messages[i].id});
    }
    names.push_back({"GUARD_IN", LPVG_CAN_GUARD_IN_ID});
    return names;
#else
    return {{"VDC2", LPVG_CAN_VDC2_ID}, {"EBC2", LPVG_CAN_EBC2_ID}, {"CCVS1", LPVG_CAN_CCVS1_ID},
            {"EBC3", LPVG_CAN_EBC3_ID}, {"EBC1", LPVG_CAN_EBC1_ID}, {"GUARD_IN", LPVG_CAN_GUARD_IN_ID}};
#endif
}

constexpr Named<CommandSettings::Kind> command_kinds[] = {
    {"zero", CommandSettings::Kind::zero},
    {"multisine", CommandSettings::Kind::multisine},
    {"steps", CommandSettings::Kind::steps},
    {"profile", CommandSettings::Kind::profile},
};
constexpr Named<bool> spacings[] = {{"log", false}, {"linear", true}};
constexpr Named<CanFault::Kind> can_fault_kinds[] = {
    {"lost", CanFault::Kind::lost},
    {"corrupted", CanFault::Kind::corrupted},
    {"delayed", CanFault::Kind::delayed},
    {"repeated", CanFault::Kind::repeated},
    {"swapped", CanFault::Kind::swapped},
    {"stuck_counter", CanFault::Kind::stuck_counter},
    {"wrong_length", CanFault::Kind::wrong_length},
    {"unknown_id", CanFault::Kind::unknown_id},
    {"babbling", CanFault::Kind::babbling},
    {"bus_off", CanFault::Kind::bus_off},
};

/// One table of the file. Its numbers and words are read by name.
class Reader {
public:
    Reader(const toml::table& table, const std::string& file, const std::string& where) : table_(table), file_(file), where_(where) {}

    double required(std::string_view key, double low, double high) const {
        const toml::node* const node = table_.get(key);
        if (node == nullptr) {
            throw ParameterError(file_ + ": " + where_ + std::string(key) + ": missing, expected a number");
        }
        const double value = number(*node, file_, where_ + std::string(key));
        require_in_range(file_, where_ + std::string(key), value, low, high);
        return value;
    }

    double optional(std::string_view key, double otherwise, double low, double high) const {
        return table_.contains(key) ? required(key, low, high) : otherwise;
    }

    /// Returns the value of the word at `key`, which must be one of `allowed`.
    template <class Allowed>
    auto choice(std::string_view key, const Allowed& allowed) const {
        const std::string word = table_[key].value_or(std::string{});
        std::string message = file_ + ": " + where_ + std::string(key) + " = \"" + word + "\": expected one of:";
        for (const auto& one : allowed) {
            if (one.name == word) {
                return one.value;
            }
            message += " " + std::string(one.name);
        }
        throw ParameterError(message);
    }

private:
    const toml::table& table_;
    std::string file_, where_;
};

std::vector<std::pair<double, double>> read_knots(const toml::table& table, const std::string& file) {
    const std::string key = "command.knots";
    const toml::array* const rows = table["knots"].as_array();
    if (rows == nullptr || rows->empty()) {
        throw ParameterError(file + ": " + key + ": missing, expected [[time s, yaw rate rad/s], ...]");
    }
    std::vector<std::pair<double, double>> knots;
    for (const toml::node& row : *rows) {
        const toml::array* const pair = row.as_array();
        if (pair == nullptr || pair->size() != 2) {
            throw ParameterError(file + ": " + key + ": expected [[time s, yaw rate rad/s], ...]");
        }
        const double time_s = number(*pair->get(0), file, key);
        const double yaw_rate_radps = number(*pair->get(1), file, key);
        require_in_range(file, key + " time", time_s, knots.empty() ? 0.0 : knots.back().first + 1e-3, 1e6);
        require_in_range(file, key + " yaw rate", yaw_rate_radps, -amplitude_max, amplitude_max);
        knots.emplace_back(time_s, yaw_rate_radps);
    }
    return knots;
}

CommandSettings read_command(const toml::table& table, const std::string& file) {
    const Reader reader(table, file, "command.");
    CommandSettings command;
    command.kind = reader.choice("kind", command_kinds);
    switch (command.kind) {
        case CommandSettings::Kind::zero: require_known_keys(table, file, "command.", {"kind"}); break;
        case CommandSettings::Kind::multisine: {
            require_known_keys(table, file, "command.", {"kind", "rms_radps", "low_radps", "high_radps", "spacing"});
            command.rms_radps = reader.required("rms_radps", 0.0, rms_max);
            command.low_radps = reader.required("low_radps", 0.001, 50.0);
            command.high_radps = reader.required("high_radps", command.low_radps, 50.0);
            command.linear_spacing = reader.choice("spacing", spacings);
            break;
        }
        case CommandSettings::Kind::steps:
            require_known_keys(table, file, "command.", {"kind", "amplitude_radps", "period_s"});
            command.amplitude_radps = reader.required("amplitude_radps", 0.0, amplitude_max);
            command.period_s = reader.required("period_s", 0.1, 1e6);
            break;
        case CommandSettings::Kind::profile:
            require_known_keys(table, file, "command.", {"kind", "knots"});
            command.knots = read_knots(table, file);
            break;
    }
    return command;
}

CanFault read_can_fault(const toml::table& table, const std::string& file) {
    const Reader reader(table, file, "can_fault.");
    require_known_keys(table, file, "can_fault.", {"message", "kind", "start_s", "end_s", "probability", "delay_s"});
    CanFault fault;
    fault.id = reader.choice("message", message_names());
    fault.kind = reader.choice("kind", can_fault_kinds);
    fault.window.start_s = reader.required("start_s", 0.0, 1e9);
    fault.window.end_s = reader.optional("end_s", fault.window.end_s, fault.window.start_s, 1e9);
    fault.probability = reader.optional("probability", 1.0, 0.0, 1.0);
    if (fault.kind == CanFault::Kind::stuck_counter && fault.id != LPVG_CAN_GUARD_IN_ID) {
        throw ParameterError(file + ": can_fault.message: only GUARD_IN has a counter that can be stuck");
    }
    if (fault.kind == CanFault::Kind::delayed) {
        fault.delay_s = reader.required("delay_s", 0.0, 1.0);
    } else if (table.contains("delay_s")) {
        throw ParameterError(file + ": can_fault.delay_s: only for kind = \"delayed\"");
    }
    return fault;
}

}  // namespace

Scenario parse_scenario(const std::string& text, const std::string& name) {
    const toml::table document = lpvguard_plant::parse_toml(text, name);
    require_known_keys(document, name, "", {"title", "duration_s", "seed", "plant", "command", "can_fault", "expect"});
    const Reader reader(document, name, "");
    Scenario scenario;
    scenario.duration_s = reader.required("duration_s", 1.0, 1e6);
    scenario.seed = static_cast<std::uint64_t>(reader.optional("seed", 1.0, 0.0, 9e15));
    scenario.plant = lpvguard_plant::parse_scenario(text, name);
    const toml::table* const command = document["command"].as_table();
    if (command == nullptr) {
        throw ParameterError(name + ": command: missing, expected a table [command]");
    }
    scenario.command = read_command(*command, name);
    if (const toml::node* const node = document.get("can_fault")) {
        const toml::array* const faults = node->as_array();
        if (faults == nullptr || !faults->is_homogeneous<toml::table>()) {
            throw ParameterError(name + ": can_fault: expected an array of tables, [[can_fault]]");
        }
        for (const toml::node& fault : *faults) {
            scenario.can_faults.push_back(read_can_fault(*fault.as_table(), name));
        }
    }
    return scenario;
}

}  // namespace lpvguard_sim
