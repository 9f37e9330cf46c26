/// @file main.cpp -- lpvguard_plant_tool: the simulated truck from the command line.
#include <cstdio>
#include <cstring>
#include <exception>

#include "commands.hpp"

namespace {

constexpr const char usage[] = R"(usage: lpvguard_plant_tool COMMAND [OPTION VALUE]...

frequency-response   compare yaw rate and road-wheel angle per brake pressure with the paper's Table I
    --amplitude 1        of the demand's sine [bar]
    --points 24          frequencies in 0.2 .. 30 rad/s
    exit status 1 unless at 1 bar and each speed both differ by 3 .. 13 % in the median to 6 rad/s and by 40 % at most

response             print the frequency response per bar of a scenario's truck (its variation, actuator and surroundings
                     faults from the start on; flat road, no wind; demand held over each sample of 10 ms): the omega
                     driven, yaw rate, road-wheel angle as CSV
    --scenario FILE      its [plant] table
    --speed 15           [m/s]
    --amplitude 0.5      [bar]
    --omega W,W,...      [rad/s]; 0: of a constant demand

generate             write one experiment: t,v,dp,r,delta every 10 ms, as the sensors see it
    -o FILE              CSV, written whole or not at all
    --speed 12           [m/s], held; or --scenario FILE, whose [plant] table says it, with variations and faults
    --program pulses     pulses | telegraph | multisine | sweep | zero
    --amplitude-low 0.5 --amplitude-high 2   [bar]; high is at least low
    --further-column bank                    generate only: the road's bank [rad], as a sensor without error would see it
    --duration 60        [s]
    --seed 1

digest               run without writing and print a hash of all truth and sensor bits (time it for the speed)
    --speed 12 --duration 600 --seed 1

All take --parameters FILE in place of the shipped truck.toml. Exit status 2: bad input.
)";

int run(int argc, char** argv) {
    using namespace lpvguard_plant;
    if (argc < 2) {
        std::fputs(usage, stderr);
        return 2;
    }
    for (int i = 1; i < argc; ++i) {
        if (std::strcmp(argv[i], "--help") == 0) {
            std::fputs(usage, stdout);
            return 0;
        }
    }
    const std::string command = argv[1];
    const Arguments arguments(argc - 2, argv + 2);
    if (command == "frequency-response") {
        return frequency_response(arguments);
    }
    if (command == "response") {
        return response(arguments);
    }
    if (command == "generate") {
        return generate(arguments);
    }
    if (command == "digest") {
        return digest(arguments);
    }
    throw UsageError("unknown command '" + command + "', see --help");
}

}  // namespace

int main(int argc, char** argv) {
    try {
        return run(argc, argv);
    } catch (const std::exception& error) {
        std::fprintf(stderr, "lpvguard_plant_tool: %s\n", error.what());
        return 2;
    }
}
