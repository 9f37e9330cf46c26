#include "live_scenario.hpp"

#include <array>
#include <cstdio>
#include <sstream>
#include <string_view>
#include <utility>

#include "toml_input.hpp"

namespace lpvguard_sim {
namespace {

using lpvguard_plant::ParameterError;

constexpr const char* source = "command";  // replaces the file name in error messages
constexpr std::array<std::string_view, 5> lists = {"can_fault", "plant.sensor_fault", "plant.actuator_fault", "plant.surroundings_fault",
                                                   "plant.speed_change"};

std::string expected_lists() {
    std::string words = "expected one entry of one of:";
    for (const std::string_view list : lists) {
        words += " [[" + std::string(list) + "]]";
    }
    return words;
}

std::string print(const toml::table& document) {
    std::ostringstream text;
    text << document << '\n';
    return text.str();
}

std::string words(const char* format, double value) {
    char buffer[64];
    std::snprintf(buffer, sizeof buffer, format, value);
    return buffer;
}

LiveScenario::Change change_to(const toml::table& document, std::string entry) {
    std::string text = print(document);
    Scenario scenario = parse_scenario(text, source);
    return {std::move(entry), std::move(text), std::move(scenario)};
}

/// Returns the list in `fragment`, if `fragment` holds only this list and the list has one entry.
std::pair<std::string_view, const toml::table*> only_entry(const toml::table& fragment) {
    for (const std::string_view list : lists) {
        const toml::array* const entries = fragment.at_path(list).as_array();
        const bool inside_plant = list.find('.') != std::string_view::npos;
        const toml::table& holder = inside_plant && entries != nullptr ? *fragment["plant"].as_table() : fragment;
        if (entries != nullptr && entries->size() == 1U && entries->get(0)->is_table() && fragment.size() == 1U && holder.size() == 1U) {
            return {list, entries->get(0)->as_table()};
        }
    }
    throw ParameterError(std::string(source) + ": " + expected_lists());
}

}  // namespace

struct LiveScenario::Document {
    toml::table toml;
};

LiveScenario::LiveScenario(const std::string& path) : document_(std::make_unique<Document>()) {
    const std::string text = lpvguard_plant::read_text(path);
    scenario_ = parse_scenario(text, path);
    document_->toml = lpvguard_plant::parse_toml(text, path);
}

void LiveScenario::set_seed(std::uint64_t seed) {
    scenario_.seed = seed;
    document_->toml.insert_or_assign("seed", static_cast<std::int64_t>(seed));
}

LiveScenario::~LiveScenario() = default;

const Scenario& LiveScenario::now() const { return scenario_; }

std::string LiveScenario::text() const { return print(document_->toml); }

LiveScenario::Change LiveScenario::injected(double start_s, const std::string& toml) const {
    const toml::table fragment = lpvguard_plant::parse_toml(toml, source);
    const auto [list, given] = only_entry(fragment);
    if (given->contains("start_s")) {
        throw ParameterError(std::string(source) + ": " + std::string(list) + ".start_s: not to be given, it begins with the next tick");
    }
    toml::table entry = *given;
    entry.insert("start_s", start_s);
    toml::table document = document_->toml;
    const bool inside_plant = list.find('.') != std::string_view::npos;
    toml::table& holder = inside_plant ? *document["plant"].as_table() : document;
    const std::string_view key = list.substr(inside_plant ? list.find('.') + 1 : 0);
    toml::array& entries = *holder.insert(key, toml::array{}).first->second.as_array();
    entries.push_back(std::move(entry));
    return change_to(document, std::string(list) + '[' + std::to_string(entries.size() - 1) + ']');
}

LiveScenario::Change LiveScenario::cleared(double end_s, const std::string& entry) const {
    toml::table document = document_->toml;
    toml::table* const fault = document.at_path(entry).as_table();
    bool named = false;
    for (const std::string_view list : lists) {
        named = named || (list != "plant.speed_change" && entry.compare(0, list.size() + 1, std::string(list) + '[') == 0);
    }
    if (fault == nullptr || !named) {
        throw ParameterError(std::string(source) + ": '" + entry + "': no such fault, expected a name like plant.sensor_fault[0]");
    }
    const double begins_s = (*fault)["start_s"].value_or(0.0);
    const double ends_s = (*fault)["end_s"].value_or(lpvguard_plant::Window{}.end_s);
    if (begins_s >= end_s || ends_s <= end_s) {
        throw ParameterError(std::string(source) + ": " + entry + ": is not active, " +
                             (begins_s >= end_s ? words("it begins at %.9g s", begins_s) : words("it ends at %.9g s", ends_s)));
    }
    fault->insert_or_assign("end_s", end_s);
    return change_to(document, entry);
}

LiveScenario::Change LiveScenario::ended(double duration_s) const {
    toml::table document = document_->toml;
    document.insert_or_assign("duration_s", duration_s);
    return change_to(document, "duration_s");
}

void LiveScenario::take(const Change& change) {
    document_->toml = lpvguard_plant::parse_toml(change.text, source);
    scenario_ = change.scenario;
}

}  // namespace lpvguard_sim
