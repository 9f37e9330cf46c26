// main.cpp -- lpvguard_sim: one scenario of the closed loop over CAN frames; what happened goes to standard output as JSON.
//
//   lpvguard_sim SCENARIO --parameters TRUCK.toml [--seed N] [--bus memory|socketcan:INTERFACE] [--engage yes|no]
//                [--reactions release|report] [--ecu PROGRAM] [--pace X] [--log F] [--frames F] [--drive F] [--telemetry F]
//                [--lcm URL [--start running|paused] [--applied F]] [--plant LINK.toml]
//
//   --reactions  report: what the configuration may only report (LPVG_ECU_CAUSES_OPTIONAL) does not release, so that the loop goes on
//                behind a finding (default: release, as the firmware is configured)
//   --ecu        the ECU's firmware is this program (lpvguard_ecu), a process of its own on the same CAN interface, in lock-step by
//                simulated time. What it says is then read off the bus and the time line, and --drive stays empty.
//   --plant      an FMU is the vehicle, linked by this file (vehicle_model.hpp)
//   --pace       at most X times real time (default: as fast as it goes)
//   --log        every frame of the bus as candump -L writes it, with simulated time
//   --frames     every frame that the monitor judged (CSV)
//   --drive      the samples that the monitor was given, as a drive table (CSV): what `lpvguard replay` reads
//   --telemetry  the loop every 100 ms (CSV)
//   --lcm        telemetry out and commands in as LCM messages (firmware_sim/lcm), where built with LCM
//   --start      paused: nothing happens before a client says so
//   --applied    the scenario as it was run, with what clients changed: the same frames without them
//
// The expectations of the scenario are judged by `lpvguard sim`, which builds and calls this program.
#include <cerrno>
#include <cstdio>
#include <cstring>
#include <initializer_list>
#include <memory>
#include <string>

#include "arguments.hpp"
#include "loop.hpp"

namespace {

using lpvguard_plant::UsageError;

struct CloseFile {
    void operator()(std::FILE* file) const { std::fclose(file); }
};
using OutputFile = std::unique_ptr<std::FILE, CloseFile>;

/// A file to write; none where no name is given.
OutputFile output_file(const std::string& path) {
    OutputFile file(path.empty() ? nullptr : std::fopen(path.c_str(), "wb"));
    if (file == nullptr && !path.empty()) {
        throw UsageError(path + ": cannot be written: " + std::strerror(errno));
    }
    return file;
}

/// UsageError unless everything that was written has reached the file: a full disk must not pass for a result.
void require_written(const OutputFile& file) {
    if (file != nullptr && (std::fflush(file.get()) != 0 || std::ferror(file.get()) != 0)) {
        throw UsageError(std::string("an output file cannot be written: ") + std::strerror(errno));
    }
}

int run(int argc, char** argv) {
    if (argc < 2 || std::strncmp(argv[1], "--", 2) == 0) {
        throw UsageError(
            "usage: lpvguard_sim SCENARIO --parameters TRUCK.toml [--seed N] [--engage yes|no] [--reactions release|report] [--ecu "
            "PROGRAM] [--pace X] [--log F] "
            "[--frames F] [--drive F] [--telemetry F] [--lcm URL [--start running|paused] [--applied F]] "
            "[--bus memory|socketcan:INTERFACE] [--plant LINK.toml]");
    }
    lpvguard_plant::Arguments arguments(argc - 2, argv + 2);
    lpvguard_sim::LiveScenario scenario(argv[1]);
    scenario.set_seed(arguments.seed("--seed", scenario.now().seed));
    const lpvguard_plant::PlantParameters parameters = lpvguard_plant::load_parameters(arguments.text("--parameters"));
    const std::string engage = arguments.text("--engage", "yes");
    if (engage != "yes" && engage != "no") {
        throw UsageError("--engage '" + engage + "': expected yes or no");
    }
    const std::string reactions = arguments.text("--reactions", "release");
    if (reactions != "release" && reactions != "report") {
        throw UsageError("--reactions '" + reactions + "': expected release or report");
    }
    const lpvguard_sim::Nodes nodes =
        lpvguard_sim::open_nodes(arguments.text("--bus", "memory"), arguments.text("--ecu", ""), {engage == "yes", reactions == "report"});
    const double pace = arguments.number("--pace", 0.0, 1e-3, 1e3);
    const OutputFile log = output_file(arguments.text("--log", "")), frames = output_file(arguments.text("--frames", "")),
                     drive = output_file(arguments.text("--drive", "")), telemetry = output_file(arguments.text("--telemetry", ""));
    std::unique_ptr<lpvguard_sim::Publisher> publisher;
    std::unique_ptr<lpvguard_sim::Control> control;
    OutputFile applied;
    if (arguments.has("--lcm")) {
        publisher = lpvguard_sim::open_publisher(arguments.text("--lcm"));
        const std::string start = arguments.text("--start", "running");
        if (start != "running" && start != "paused") {
            throw UsageError("--start '" + start + "': expected running or paused");
        }
        control = std::make_unique<lpvguard_sim::Control>(*publisher, scenario, start == "paused");
        applied = output_file(arguments.text("--applied", ""));
    }
    const std::string plant = arguments.text("--plant", "");
    arguments.done();
    std::unique_ptr<lpvguard_sim::VehicleModel> model;
    if (!plant.empty()) {
        model = lpvguard_sim::fmu_vehicle(plant, scenario.now(), scenario.text());
    }
    const auto loop = std::make_unique<lpvguard_sim::Loop>(
        scenario.now(), parameters, *nodes.bus, *nodes.ecu,
        lpvguard_sim::LoopEnds{log.get(), frames.get(), drive.get(), telemetry.get(), publisher.get(), control.get()}, std::move(model));
    loop->run(pace);
    loop->print(stdout, scenario.now().seed);
    if (applied.get() != nullptr) {
        std::fputs(scenario.text().c_str(), applied.get());
    }
    for (const OutputFile* file : std::initializer_list<const OutputFile*>{&log, &frames, &drive, &telemetry, &applied}) {
        require_written(*file);
    }
    return 0;
}

}  // namespace

int main(int argc, char** argv) {
    try {
        return run(argc, argv);
    } catch (const std::exception& error) {
        std::fprintf(stderr, "lpvguard_sim: %s\n", error.what());
        return 2;
    }
}
