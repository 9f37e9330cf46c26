#include "toml_input.hpp"

#include <algorithm>
#include <cstdio>
#include <fstream>
#include <sstream>

namespace lpvguard_plant {

toml::table parse_toml(const std::string& text, const std::string& name) {
    try {
        return toml::parse(text, name);
    } catch (const toml::parse_error& error) {
        std::ostringstream message;
        message << name << ':' << error.source().begin.line << ':' << error.source().begin.column << ": " << error.description();
        throw ParameterError(message.str());
    }
}

std::string read_text(const std::string& path) {
    std::ifstream file(path, std::ios::binary);
    std::ostringstream text;
    text << file.rdbuf();
    if (!file) {
        throw ParameterError(path + ": cannot be read");
    }
    return text.str();
}

void require_in_range(const std::string& file, const std::string& key, double value, double low, double high) {
    if (value >= low && value <= high) {
        return;
    }
    char numbers[96];
    std::snprintf(numbers, sizeof numbers, " = %.9g: expected %.9g .. %.9g", value, low, high);
    throw ParameterError(file + ": " + key + numbers);
}

void require_known_keys(const toml::table& table, const std::string& file, const std::string& where,
                        std::initializer_list<std::string_view> allowed) {
    for (const auto& [key, node] : table) {
        if (std::find(allowed.begin(), allowed.end(), key.str()) == allowed.end()) {
            std::string message = file + ": " + where + std::string(key.str()) + ": unknown key, expected one of:";
            for (const std::string_view name : allowed) {
                message += ' ';
                message += name;
            }
            throw ParameterError(message);
        }
    }
}

double number(const toml::node& node, const std::string& file, const std::string& key) {
    if (!node.is_number()) {
        throw ParameterError(file + ": " + key + ": expected a number");
    }
    return *node.value<double>();
}

}  // namespace lpvguard_plant
