#include "arguments.hpp"

#include <cerrno>
#include <cstdlib>
#include <sstream>

namespace lpvguard_plant {

Arguments::Arguments(int count, const char* const* words) {
    for (int i = 0; i < count; i += 2) {
        const std::string name = words[i];
        if (name.size() < 2 || name[0] != '-') {
            throw UsageError("expected an option, found '" + name + "'");
        }
        if (i + 1 == count) {
            throw UsageError(name + ": expected a value");
        }
        if (!values_.emplace(name, words[i + 1]).second) {
            throw UsageError(name + ": given twice");
        }
    }
}

std::string Arguments::take(const std::string& name) {
    const auto found = values_.find(name);
    const std::string value = found->second;
    values_.erase(found);
    return value;
}

std::string Arguments::text(const std::string& name, const std::string& otherwise) { return has(name) ? take(name) : otherwise; }

std::string Arguments::text(const std::string& name) {
    if (!has(name)) {
        throw UsageError(name + ": missing");
    }
    return take(name);
}

double Arguments::to_number(const std::string& name, const std::string& word, double low, double high) {
    char* end = nullptr;
    const double value = std::strtod(word.c_str(), &end);
    if (word.empty() || *end != '\0' || !(value >= low && value <= high)) {
        throw UsageError(name + " '" + word + "': expected a number, " + std::to_string(low) + " .. " + std::to_string(high));
    }
    return value;
}

double Arguments::number(const std::string& name, double otherwise, double low, double high) {
    return has(name) ? to_number(name, take(name), low, high) : otherwise;
}

std::vector<double> Arguments::numbers(const std::string& name, double low, double high) {
    std::vector<double> values;
    std::istringstream words(text(name));
    for (std::string word; std::getline(words, word, ',');) {
        values.push_back(to_number(name, word, low, high));
    }
    return values;
}

std::uint64_t Arguments::seed(const std::string& name, std::uint64_t otherwise) {
    if (!has(name)) {
        return otherwise;
    }
    const std::string word = take(name);
    errno = 0;
    const std::uint64_t value = std::strtoull(word.c_str(), nullptr, 10);
    if (word.empty() || word.find_first_not_of("0123456789") != std::string::npos || errno != 0) {
        throw UsageError(name + " '" + word + "': expected a whole number, 0 .. 2^64 - 1");
    }
    return value;
}

void Arguments::done() const {
    if (!values_.empty()) {
        throw UsageError(values_.begin()->first + ": unknown option, or of no use beside the others given");
    }
}

}  // namespace lpvguard_plant
