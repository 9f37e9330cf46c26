/// @file toml_input.hpp -- reads TOML tables strictly: a key that nobody reads is an error.
#pragma once

#include <initializer_list>
#include <string>
#include <string_view>

#include <toml++/toml.h>

#include "lpvguard_plant/parameters.hpp"

namespace lpvguard_plant {

/// Parses TOML; a syntax error becomes a ParameterError with file, line and column.
toml::table parse_toml(const std::string& text, const std::string& name);

/// Returns the whole content of a text file. Throws ParameterError if it cannot be read.
std::string read_text(const std::string& path);

/// Throws "file: key = value: expected low .. high" unless value lies in [low, high]. NaN does not.
void require_in_range(const std::string& file, const std::string& key, double value, double low, double high);

/// Throws for the first key of `table` that is not in `allowed`.
void require_known_keys(const toml::table& table, const std::string& file, const std::string& where,
                        std::initializer_list<std::string_view> allowed);

/// Returns the number at `key`, integer or float. Throws for any other value.
double number(const toml::node& node, const std::string& file, const std::string& key);

}  // namespace lpvguard_plant
