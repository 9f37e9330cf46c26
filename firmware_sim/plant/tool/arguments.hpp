/// @file arguments.hpp -- reads "--name value" command lines. Unknown, repeated and unread options are errors.
#pragma once

#include <cstdint>
#include <map>
#include <stdexcept>
#include <string>
#include <vector>

namespace lpvguard_plant {

/// Error of a wrong command line; exit status 2.
class UsageError : public std::runtime_error {
public:
    using std::runtime_error::runtime_error;
};

class Arguments {
public:
    Arguments(int count, const char* const* words);

    bool has(const std::string& name) const { return values_.count(name) != 0; }
    std::string text(const std::string& name, const std::string& otherwise);
    std::string text(const std::string& name);                        ///< Throws when missing.
    double number(const std::string& name, double otherwise, double low, double high);
    std::vector<double> numbers(const std::string& name, double low, double high);  ///< Separated by commas. Throws when missing.
    std::uint64_t seed(const std::string& name, std::uint64_t otherwise);
    void done() const;                                                ///< Throws if an option was never read.

private:
    static double to_number(const std::string& name, const std::string& word, double low, double high);
    std::string take(const std::string& name);

    std::map<std::string, std::string> values_;
};

}  // namespace lpvguard_plant
