// main.cpp -- lpvguard_sim: one scenario of the closed loop over CAN frames; what happened goes to standard output as JSON.
//
//   lpvguard_sim SCENARIO --parameters TRUCK.toml [--seed N] [--bus memory|socketcan:INTERFACE] [--engage yes|no]
//                [--ecu PROGRAM] [--pace X] [--log F] [--frames F] [--drive F] [--telemetry F] [--lcm URL]
//
//   --ecu        the ECU's firmware is this program (lpvguard_ecu), a process of its own on the same CAN interface, in lock-step by
//                simulated time; what it says is then read off the bus, and --frames and --drive stay empty
//   --pace       at most X times real time (default: as fast as it goes)
//   --log        every frame of the bus as candump -L writes it, with simulated time
//   --frames     every frame that the monitor judged (CSV)
//   --drive      the samples that the monitor was given, as a drive table (CSV): what `lpvguard replay` reads
//   --telemetry  the loop every 100 ms (CSV)
//   --lcm        the loop every 10 ms and the supervision every 100 ms as LCM messages (firmware_sim/lcm), where built with LCM
//
// The expectations of the scenario are judged by `lpvguard sim`, which builds and calls this program.
#include <algorithm>
#include <chrono>
#include <cinttypes>
#include <cmath>
#include <cstdio>
#include <cstring>
#include <ctime>
#include <memory>
#include <stdexcept>
#include <string>
#include <thread>
#include <vector>

#include "arguments.hpp"
#include "command.hpp"
#include "ecu_node.hpp"
#include "lpvguard_plant/plant.hpp"
#include "publisher.hpp"
#include "loop_bus.hpp"
#include "vehicle_node.hpp"

namespace {

using lpvguard_plant::Plant;
using lpvguard_plant::UsageError;
using lpvguard_sim::LoopBus;

constexpr std::int64_t tick_us = 10'000;
constexpr int telemetry_every = 10;  // ticks
constexpr const char* verdict_names[] = {"unknown", "valid", "invalid", "not_judged", "stale", "fault"};
constexpr const char* supervision_names[] = {"off", "hold", "live"};

/// A file that is written when a name is given.
class OutputFile {
public:
    explicit OutputFile(const std::string& path) : file_(path.empty() ? nullptr : std::fopen(path.c_str(), "wb")) {
        if (file_ == nullptr && !path.empty()) {
            throw UsageError(path + ": cannot be written: " + std::strerror(errno));
        }
    }
    ~OutputFile() {
        if (file_ != nullptr) {
            std::fclose(file_);
        }
    }
    OutputFile(const OutputFile&) = delete;
    OutputFile& operator=(const OutputFile&) = delete;

    std::FILE* get() const { return file_; }

private:
    std::FILE* file_;
};

/// Counts, hashes (FNV-1a) and, when asked, logs what passes the bus.
class FrameWatcher {
public:
    explicit FrameWatcher(std::FILE* log) : log_(log) {}

    static void watch(void* self, const lpvg_can_frame_t& frame) { static_cast<FrameWatcher*>(self)->take(frame); }
    std::uint64_t count() const { return count_; }
    std::uint64_t hash() const { return hash_; }

private:
    void take(const lpvg_can_frame_t& frame) {
        ++count_;
        add(frame.id, 4);
        add(static_cast<std::uint64_t>(frame.t_us), 8);
        for (std::size_t i = 0; i < frame.dlc; ++i) {
            add(frame.data[i], 1);
        }
        if (log_ != nullptr) {
            // As candump: eight digits say "extended", and the flag of an error report stays.
            std::fprintf(log_, "(%" PRId64 ".%06" PRId64 ") can0 %08X#", frame.t_us / 1'000'000, frame.t_us % 1'000'000,
                         frame.id & ~LPVG_CAN_EXTENDED);
            for (std::size_t i = 0; i < frame.dlc; ++i) {
                std::fprintf(log_, "%02X", frame.data[i]);
            }
            std::fputc('\n', log_);
        }
    }
    void add(std::uint64_t value, int bytes) {
        for (int i = 0; i < bytes; ++i) {
            hash_ = (hash_ ^ ((value >> (8 * i)) & 0xFFU)) * 0x100000001B3U;
        }
    }

    std::FILE* log_;
    std::uint64_t count_ = 0;
    std::uint64_t hash_ = 0xCBF29CE484222325U;
};

/// Values of something that changes seldom, with the times of the changes.
template <class Value>
class Changes {
public:
    struct Change {
        double time_s;
        Value value;
    };

    void take(double time_s, const Value& value) {
        if (list_.empty() || list_.back().value != value) {
            list_.push_back({time_s, value});
        }
    }
    const std::vector<Change>& list() const { return list_; }

private:
    std::vector<Change> list_;
};

class Loop {
public:
    Loop(const lpvguard_sim::Scenario& scenario, const lpvguard_plant::PlantParameters& parameters, LoopBus& bus, lpvguard_sim::EcuNode& ecu,
         std::FILE* log, std::FILE* frames, std::FILE* drive, std::FILE* telemetry, lpvguard_sim::Publisher* publisher)
        : duration_s_(scenario.duration_s),
          plant_(lpvguard_plant::varied(parameters, scenario.plant.variation), scenario.plant.drive, scenario.seed,
                 scenario.plant.faults),
          vehicle_(bus.end(LoopBus::vehicle), parameters.steering_ratio, scenario.can_faults, scenario.seed),
          command_(scenario.command, scenario.seed),
          bus_(bus),
          ecu_(ecu),
          watcher_(log),
          frames_(frames),
          drive_(drive),
          telemetry_(telemetry),
          publisher_(publisher) {
        bus.watch(&FrameWatcher::watch, &watcher_);
        if (frames_ != nullptr) {
            std::fputs("t_end_s,t_begin_s,bin,reason,falsified,speed_mps,margin,statistic,evidence\n", frames_);
        }
        if (drive_ != nullptr) {
            std::fputs("t,v,dp,r,delta\n", drive_);
        }
        if (telemetry_ != nullptr) {
            std::fputs("t_s,speed_mps,command_radps,wanted_radps,yaw_rate_radps,road_wheel_rad,demand_bar,margin,verdict,"
                       "supervision\n", telemetry_);
        }
    }

    void run(double pace) {
        const std::clock_t started = std::clock();
        const auto begin = std::chrono::steady_clock::now();
        ticks_ = std::llround(duration_s_ * 1e6 / static_cast<double>(tick_us));
        for (std::int64_t k = 0; k < ticks_; ++k) {
            if (pace > 0.0) {
                std::this_thread::sleep_until(begin + std::chrono::duration_cast<std::chrono::steady_clock::duration>(
                                                          std::chrono::duration<double>(static_cast<double>(k * tick_us) * 1e-6 / pace)));
            }
            tick(k);
        }
        // Processor time: what one core needs, whatever else the machine does. Of an ECU elsewhere it would be the smaller part.
        const double processor_s = static_cast<double>(std::max<std::clock_t>(std::clock() - started, 1)) / CLOCKS_PER_SEC;
        const std::chrono::duration<double> elapsed = std::chrono::steady_clock::now() - begin;
        real_time_factor_ = duration_s_ / (ecu_.inside() != nullptr ? processor_s : elapsed.count());
    }

    void print(std::uint64_t seed) {
        const auto n = static_cast<double>(ticks_);
        std::printf("{\"seed\": %" PRIu64 ", \"duration_s\": %.9g, \"threshold\": %.9g, \"verdict_final\": \"%s\",\n", seed,
                    duration_s_, static_cast<double>(lpvg_coeff.reals.threshold), verdict_names[verdicts_.list().back().value]);
        std::printf(" \"tracking_rms\": %.9g, \"command_rms\": %.9g, \"demand_max_bar\": %.9g,\n",
                    std::sqrt(error_squares_ / n), std::sqrt(wanted_squares_ / n), demand_max_bar_);
        if (ecu_.inside() != nullptr) {
            std::printf(" \"limited_s\": %.9g,\n", static_cast<double>(ecu_.inside()->control.limited) * tick_us * 1e-6);
        }
        std::printf(" \"frames\": %" PRIu64 ", \"frames_hash\": \"%016" PRIx64 "\", \"real_time_factor\": %.4g,\n",
                    watcher_.count(), watcher_.hash(), real_time_factor_);
        print_changes("verdicts", verdicts_, [](std::uint8_t v) { std::printf("\"%s\"", verdict_names[v]); });
        print_changes("supervision", supervision_, [](std::uint8_t s) { std::printf("\"%s\"", supervision_names[s]); });
        print_changes("implausible", implausible_, [](std::uint8_t flags) { std::printf("%d", flags); });
        print_changes("trouble_codes", troubles_, [](const lpvguard_sim::TroubleCode& t) {
            std::printf("{\"spn\": %" PRIu32 ", \"fmi\": %d}", t.spn, t.fmi);
        });
        std::printf(" \"reception\": %s,\n", ecu_.finish().c_str());
        std::printf(" \"schema\": 1}\n");
    }

private:
    // Row k of a drive: what the sensors say at t, and the demand that holds from t to the next row.
    void tick(std::int64_t k) {
        const std::int64_t now_us = k * tick_us;
        const double time_s = static_cast<double>(now_us) * 1e-6;
        const double command_radps = command_.next();
        const double wanted_radps = wanted_.step(command_radps);
        const double yaw_rate_radps = plant_.truth().yaw_rate_radps;
        error_squares_ += (wanted_radps - yaw_rate_radps) * (wanted_radps - yaw_rate_radps);
        wanted_squares_ += wanted_radps * wanted_radps;

        vehicle_.send(now_us, plant_.sensors(), command_radps);
        ecu_.tick(now_us);
        vehicle_.receive(now_us);
        if (!bus_.failure().empty()) {
            throw std::runtime_error(bus_.failure());
        }
        note(k, time_s, command_radps, wanted_radps);
        for (int i = 0; i < Plant::steps_per_sample; ++i) {
            plant_.step(vehicle_.demand_bar());
        }
    }

    void note(std::int64_t k, double time_s, double command_radps, double wanted_radps) {
        const lpvg_ecu_t* const ecu = ecu_.inside();
        const lpvg_bus_report_t& report = ecu != nullptr ? ecu->report : vehicle_.report();
        verdicts_.take(time_s, report.verdict);
        supervision_.take(time_s, report.supervision);
        troubles_.take(time_s, vehicle_.trouble());
        demand_max_bar_ = std::fmax(demand_max_bar_, std::fabs(vehicle_.demand_bar()));
        if (ecu != nullptr) {
            implausible_.take(time_s, ecu->plausibility.flags);
            note_frame(*ecu);
            note_sample(*ecu, k, time_s);
        }
        if (publisher_ != nullptr) {
            publisher_->publish(k * tick_us, plant_.truth(),
                                {command_radps, wanted_radps, vehicle_.demand_bar(), static_cast<double>(report.margin),
                                 report.verdict, report.supervision});
            if (ecu != nullptr && k % telemetry_every == 0) {
                publisher_->publish(k * tick_us, ecu->supervisor, vehicle_.trouble());
            }
        }
        if (telemetry_ != nullptr && k % telemetry_every == 0) {
            const lpvguard_plant::Truth& truth = plant_.truth();
            std::fprintf(telemetry_, "%.9g,%.9g,%.9g,%.9g,%.9g,%.9g,%.9g,%.9g,%d,%d\n", time_s, truth.speed_mps, command_radps,
                         wanted_radps, truth.yaw_rate_radps, truth.road_wheel_rad, vehicle_.demand_bar(),
                         static_cast<double>(report.margin), report.verdict, report.supervision);
        }
    }

    void note_frame(const lpvg_ecu_t& ecu) {
        const lpvg_frame_t& frame = *lpvg_monitor_frame(&ecu.monitor);
        if (frames_ != nullptr && frame.sequence != last_frame_) {
            const double end_s = static_cast<double>(frame.t_end_us) * 1e-6;
            const double length_s = lpvg_coeff.words.frame_length[frame.bin] * tick_us * 1e-6;
            std::fprintf(frames_, "%.9g,%.9g,%u,%d,%d,%.9g,%.9g,%.9g,%.9g\n", end_s, end_s - length_s, frame.bin,
                         static_cast<int>(frame.reason), frame.falsified ? 1 : 0, static_cast<double>(frame.speed),
                         static_cast<double>(frame.margin), static_cast<double>(frame.statistic),
                         static_cast<double>(frame.evidence));
        }
        last_frame_ = frame.sequence;
    }

    /// A sample with a missing or refused measurement never reached the monitor.
    void note_sample(const lpvg_ecu_t& ecu, std::int64_t k, double time_s) {
        if (drive_ != nullptr && ecu.monitor.running && ecu.monitor.t_us == k * tick_us) {
            std::fprintf(drive_, "%.9g,%.9g,%.9g,%.9g,%.9g\n", time_s, static_cast<double>(ecu.signals.speed),
                         static_cast<double>(ecu.control.u[0]), static_cast<double>(ecu.signals.y[0]),
                         static_cast<double>(ecu.signals.y[1]));
        }
    }

    template <class Value, class Print>
    static void print_changes(const char* name, const Changes<Value>& changes, const Print& print_value) {
        std::printf(" \"%s\": [", name);
        const char* separator = "";
        for (const auto& change : changes.list()) {
            std::printf("%s[%.9g, ", separator, change.time_s);
            print_value(change.value);
            std::printf("]");
            separator = ", ";
        }
        std::printf("],\n");
    }

    double duration_s_;
    Plant plant_;
    lpvguard_sim::VehicleNode vehicle_;
    lpvguard_sim::Command command_;
    lpvguard_sim::ReferenceModel wanted_;
    const LoopBus& bus_;
    lpvguard_sim::EcuNode& ecu_;
    FrameWatcher watcher_;
    std::FILE* frames_;
    std::FILE* drive_;
    std::FILE* telemetry_;
    lpvguard_sim::Publisher* publisher_;
    Changes<std::uint8_t> verdicts_, supervision_, implausible_;
    Changes<lpvguard_sim::TroubleCode> troubles_;
    std::int64_t ticks_ = 0;
    std::uint32_t last_frame_ = 0;
    double error_squares_ = 0.0, wanted_squares_ = 0.0, demand_max_bar_ = 0.0, real_time_factor_ = 0.0;
};

int run(int argc, char** argv) {
    if (argc < 2 || std::strncmp(argv[1], "--", 2) == 0) {
        throw UsageError("usage: lpvguard_sim SCENARIO --parameters TRUCK.toml [--seed N] [--engage yes|no] [--ecu PROGRAM] [--pace X] [--log F] "
                         "[--frames F] [--drive F] [--telemetry F] [--lcm URL] [--bus memory|socketcan:INTERFACE]");
    }
    lpvguard_plant::Arguments arguments(argc - 2, argv + 2);
    lpvguard_sim::Scenario scenario = lpvguard_sim::load_scenario(argv[1]);
    scenario.seed = arguments.seed("--seed", scenario.seed);
    const lpvguard_plant::PlantParameters parameters = lpvguard_plant::load_parameters(arguments.text("--parameters"));
    const std::string engage = arguments.text("--engage", "yes");
    if (engage != "yes" && engage != "no") {
        throw UsageError("--engage '" + engage + "': expected yes or no");
    }
    const lpvguard_sim::Nodes nodes =
        lpvguard_sim::open_nodes(arguments.text("--bus", "memory"), arguments.text("--ecu", ""), engage == "yes");
    const double pace = arguments.number("--pace", 0.0, 1e-3, 1e3);
    const OutputFile log(arguments.text("--log", "")), frames(arguments.text("--frames", "")),
        drive(arguments.text("--drive", "")), telemetry(arguments.text("--telemetry", ""));
    std::unique_ptr<lpvguard_sim::Publisher> publisher;
    if (arguments.has("--lcm")) {
        publisher = lpvguard_sim::open_publisher(arguments.text("--lcm"));
    }
    arguments.done();
    const auto loop = std::make_unique<Loop>(scenario, parameters, *nodes.bus, *nodes.ecu, log.get(), frames.get(), drive.get(),
                                             telemetry.get(), publisher.get());
    loop->run(pace);
    loop->print(scenario.seed);
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
