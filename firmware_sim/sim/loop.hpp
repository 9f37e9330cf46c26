/// @file loop.hpp -- one run: truck, command and controller from tick to tick, and the record of the run.
#pragma once

#include <cstdint>
#include <cstdio>
#include <memory>
#include <string>
#include <utility>
#include <vector>

#include "command.hpp"
#include "control.hpp"
#include "ecu_node.hpp"
#include "loop_bus.hpp"
#include "lpvguard_plant/plant.hpp"
#include "publisher.hpp"
#include "vehicle_model.hpp"
#include "vehicle_node.hpp"

namespace lpvguard_sim {

/// Counts and hashes (FNV-1a) the frames of the bus. On request, logs and publishes them.
class FrameWatcher {
public:
    FrameWatcher(std::FILE* log, Publisher* publisher) : log_(log), publisher_(publisher) {}

    static void watch(void* self, const lpvg_can_frame_t& frame) { static_cast<FrameWatcher*>(self)->take(frame); }
    std::uint64_t count() const { return count_; }
    std::uint64_t hash() const { return hash_; }

private:
    void take(const lpvg_can_frame_t& frame);
    void add(std::uint64_t value, int bytes);

    std::FILE* log_;
    Publisher* publisher_;
    std::uint64_t count_ = 0;
    std::uint64_t hash_ = 0xCBF29CE484222325U;
};

/// Values of a quantity that changes seldom, with the times of the changes.
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

/// Outputs of a run, and the source of its commands; null: none.
struct LoopEnds {
    std::FILE* log = nullptr;        ///< Every frame of the bus in the form of candump -L.
    std::FILE* frames = nullptr;     ///< Every frame that the monitor judged.
    std::FILE* drive = nullptr;      ///< The samples that the monitor received.
    std::FILE* telemetry = nullptr;  ///< State of the loop every 100 ms.
    Publisher* publisher = nullptr;
    Control* control = nullptr;
    std::string columns = "t,v,dp,r,delta";  ///< Header of `drive`.
};

class Loop {
public:
    /// Without `model` the vehicle is the simulated truck.
    Loop(const Scenario& scenario, const lpvguard_plant::PlantParameters& parameters, LoopBus& bus, EcuNode& ecu, const LoopEnds& ends,
         std::unique_ptr<VehicleModel> model = nullptr, const std::array<double, 6>& reference_model = papers_reference_model);

    /// Runs at most at `pace` times real time; 0: as fast as possible. Throws std::runtime_error if the bus or the ECU fails.
    void run(double pace);

    /// Returns the events of the run as JSON. Verdicts and supervision are numbers: lpvg_verdict_t, lpvg_can_state_t.
    void print(std::FILE* out, std::uint64_t seed);

    const FrameWatcher& watcher() const { return watcher_; }

private:
    void tick(std::int64_t k);
    void note(std::int64_t k, double time_s, double command_radps, double wanted_radps);
    void note_frame(const Judged& judged, std::int64_t now_us, std::uint8_t verdict);
    void note_sample(const lpvg_ecu_t& ecu, std::int64_t k, double time_s);

    std::int64_t ticks_;
    std::unique_ptr<VehicleModel> model_;
    VehicleNode vehicle_;
    Command command_;
    ReferenceModel wanted_;
    const LoopBus& bus_;
    EcuNode& ecu_;
    LoopEnds ends_;
    FrameWatcher watcher_;
    Changes<std::uint8_t> verdicts_, supervision_, implausible_;
    Changes<TroubleCode> troubles_;
    double demand_max_[LPVG_NU] = {};
    std::vector<std::pair<double, Found>> causes_;  ///< causes with their times
    double error_squares_ = 0.0, wanted_squares_ = 0.0, real_time_factor_ = 0.0;
};

}  // namespace lpvguard_sim
