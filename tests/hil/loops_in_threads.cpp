// Simulated loops at once, each in a thread of its own: what "one instance per thread" promises of core, firmware, truck and bus. Built
// with ThreadSanitizer (test_threads.py).
//
//   loops_in_threads TRUCK.toml SCENARIO...            count and hash of the frames of each, in their order
//   loops_in_threads --shared TRUCK.toml SCENARIO...   all on one bus and one ECU: races, which must be reported
#include <cinttypes>
#include <cstdio>
#include <memory>
#include <string>
#include <thread>
#include <vector>

#include "loop.hpp"
#include "scenario.hpp"

namespace {

using lpvguard_sim::Loop;
using lpvguard_sim::Nodes;

Nodes new_nodes() { return lpvguard_sim::open_nodes("memory", "", {true, true}); }

struct Run {
    explicit Run(const char* path) : scenario(path) {}

    lpvguard_sim::LiveScenario scenario;
    std::uint64_t count = 0, hash = 0;

    void drive(const lpvguard_plant::PlantParameters& parameters, const Nodes& nodes) {
        Loop loop(scenario.now(), parameters, *nodes.bus, *nodes.ecu, lpvguard_sim::LoopEnds{});
        loop.run(0.0);
        count = loop.watcher().count();
        hash = loop.watcher().hash();
    }
};

}  // namespace

int main(int argc, char** argv) {
    const bool shared = argc > 1 && std::string(argv[1]) == "--shared";
    const int first = shared ? 2 : 1;
    if (argc < first + 2) {
        std::fputs("usage: loops_in_threads [--shared] TRUCK.toml SCENARIO...\n", stderr);
        return 2;
    }
    const lpvguard_plant::PlantParameters parameters = lpvguard_plant::load_parameters(argv[first]);
    std::vector<std::unique_ptr<Run>> runs;
    for (int i = first + 1; i < argc; ++i) {
        runs.push_back(std::make_unique<Run>(argv[i]));
    }
    const Nodes one = new_nodes();
    std::vector<std::thread> threads;
    for (const auto& run : runs) {
        threads.emplace_back([&, self = run.get()] {
            if (shared) {
                self->drive(parameters, one);
            } else {
                self->drive(parameters, new_nodes());
            }
        });
    }
    for (std::thread& thread : threads) {
        thread.join();
    }
    for (const auto& run : runs) {
        std::printf("%" PRIu64 " %016" PRIx64 "\n", run->count, run->hash);
    }
    return 0;
}
