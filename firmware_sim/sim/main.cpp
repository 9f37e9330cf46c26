// main.cpp -- lpvguard_sim: runs one scenario of the closed loop over CAN frames, and writes the result to standard output as JSON.
//
//   lpvguard_sim SCENARIO --parameters TRUCK.toml [--seed N] [--bus memory|socketcan:INTERFACE] [--engage yes|no]
//                [--reactions release|report] [--ecu PROGRAM] [--pace X] [--log F] [--frames F] [--drive F] [--telemetry F]
//                [--lcm URL [--start running|paused] [--applied F]] [--plant LINK.toml] [--reference "B2 B1 B0 A2 A1 A0"] [--columns T,..]
//
//   --reactions  report: causes of LPVG_ECU_CAUSES_OPTIONAL do not release, so that the loop continues after a finding
//                (default: release, the configuration of the firmware)
//   --ecu        the ECU's firmware is this program (lpvguard_ecu), a separate process on the same CAN interface, in lock-step with
//                simulated time. Its outputs are then read from the bus and the time line, and --drive stays empty.
//   --plant      an FMU replaces the vehicle; this file links it (vehicle_model.hpp)
//   --reference  reference model for the tracking error (command.hpp; default: the paper's)
//   --columns    header of --drive (default: the truck's)
//   --pace       at most X times real time (default: as fast as possible)
//   --log        every frame of the bus in the form of candump -L, with simulated time
//   --frames     every frame that the monitor judged (CSV)
//   --drive      the samples that the monitor received, as a drive table (CSV) for `lpvguard replay`
//   --telemetry  state of the loop every 100 ms (CSV)
//   --lcm        telemetry and commands as LCM messages (firmware_sim/lcm), if built with LCM
//   --start      paused: the run starts when a client sends resume
//   --applied    the scenario with the changes of clients; it gives the same frames without clients
//
// `lpvguard sim` builds and calls this program, and judges the expectations of the scenario.
#include <array>
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

/// A file to write; no file if there is no name.
OutputFile output_file(const std::string& path) {
    OutputFile file(path.empty() ? nullptr : std::fopen(path.c_str(), "wb"));
    if (file == nullptr && !path.empty()) {
        throw UsageError(path + ": cannot be written: " + std::strerror(errno));
    }
    return file;
}

/// Throws UsageError unless all data have reached the file, so that a full disk is not taken for a result.
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
            "[--bus memory|socketcan:INTERFACE] [--plant LINK.toml] [--reference \"B2 B1 B0 A2 A1 A0\"] [--columns T,...]");
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
    const std::string reference = arguments.text("--reference", "");
    std::array<double, 6> r = lpvguard_sim::papers_reference_model;
    if (!reference.empty() && std::sscanf(reference.c_str(), "%lf %lf %lf %lf %lf %lf", &r[0], &r[1], &r[2], &r[3], &r[4], &r[5]) != 6) {
        throw UsageError("--reference '" + reference + "': expected six numbers");
    }
    const std::string columns = arguments.text("--columns", "t,v,dp,r,delta");
    arguments.done();
    std::unique_ptr<lpvguard_sim::VehicleModel> model;
    if (!plant.empty()) {
        model = lpvguard_sim::fmu_vehicle(plant, scenario.now(), scenario.text());
    }
    const auto loop = std::make_unique<lpvguard_sim::Loop>(
        scenario.now(), parameters, *nodes.bus, *nodes.ecu,
        lpvguard_sim::LoopEnds{log.get(), frames.get(), drive.get(), telemetry.get(), publisher.get(), control.get(), columns},
        std::move(model), r);
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
