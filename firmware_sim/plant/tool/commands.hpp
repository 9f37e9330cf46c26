/// @file commands.hpp -- the subcommands of lpvguard_plant_tool; each returns the exit status.
#pragma once

#include "arguments.hpp"

namespace lpvguard_plant {

/// Compares the plant with Table I and prints the differences. Returns 1 if they exceed the limits, else 0.
int frequency_response(Arguments arguments);

/// Prints the frequency response of a scenario's truck, with its faults, at one speed as CSV.
int response(Arguments arguments);

/// Writes one seeded experiment as CSV.
int generate(Arguments arguments);

/// Runs the plant and prints a hash of all its output bits, to compare machines and to measure time.
int digest(Arguments arguments);

}  // namespace lpvguard_plant
