#include "loop.hpp"

#include <algorithm>
#include <chrono>
#include <cinttypes>
#include <cmath>
#include <ctime>
#include <stdexcept>
#include <thread>

#include "lpvguard/coeff.h"

namespace lpvguard_sim {
namespace {

const std::int64_t tick_us = lpvg_coeff.words.sample_period_us;
constexpr int telemetry_every = 10;  // ticks
constexpr double two_pi = 6.283185307179586477;

template <class Value, class Print>
void print_changes(std::FILE* out, const char* name, const Changes<Value>& changes, const Print& print_value) {
    std::fprintf(out, " \"%s\": [", name);
    const char* separator = "";
    for (const auto& change : changes.list()) {
        std::fprintf(out, "%s[%.9g, ", separator, change.time_s);
        print_value(change.value);
        std::fprintf(out, "]");
        separator = ", ";
    }
    std::fprintf(out, "],\n");
}

}  // namespace

void FrameWatcher::take(const lpvg_can_frame_t& frame) {
    ++count_;
    add(frame.id, 4);
    add(static_cast<std::uint64_t>(frame.t_us), 8);
    for (std::size_t i = 0; i < frame.dlc; ++i) {
        add(frame.data[i], 1);
    }
    if (publisher_ != nullptr) {
        publisher_->publish(frame);
    }
    if (log_ != nullptr) {
        const int digits = (frame.id & (LPVG_CAN_ERROR | LPVG_CAN_EXTENDED)) != 0U ? 8 : 3;
        std::fprintf(log_, "(%" PRId64 ".%06" PRId64 ") can0 %0*X#", frame.t_us / 1'000'000, frame.t_us % 1'000'000, digits,
                     frame.id & (LPVG_CAN_ERROR | 0x1FFFFFFFU));
        for (std::size_t i = 0; i < frame.dlc; ++i) {
            std::fprintf(log_, "%02X", frame.data[i]);
        }
        std::fputc('\n', log_);
    }
}

void FrameWatcher::add(std::uint64_t value, int bytes) {
    for (int i = 0; i < bytes; ++i) {
        hash_ = (hash_ ^ ((value >> (8 * i)) & 0xFFU)) * 0x100000001B3U;
    }
}

Loop::Loop(const Scenario& scenario, const lpvguard_plant::PlantParameters& parameters, LoopBus& bus, EcuNode& ecu, const LoopEnds& ends,
           std::unique_ptr<VehicleModel> model, const std::array<double, 6>& reference_model)
    : ticks_(std::llround(scenario.duration_s * 1e6 / static_cast<double>(tick_us))),
      model_(model != nullptr ? std::move(model) : simulated_truck(scenario, parameters)),
      vehicle_(bus.end(LoopBus::vehicle), parameters.steering_ratio, scenario.can_faults, scenario.seed),
      command_(scenario.command, scenario.seed, static_cast<double>(tick_us) * 1e-6),
      wanted_(reference_model, static_cast<double>(tick_us) * 1e-6),
      bus_(bus),
      ecu_(ecu),
      ends_(ends),
      watcher_(ends.log, ends.publisher) {
    bus.watch(&FrameWatcher::watch, &watcher_);
    if (ends_.frames != nullptr) {
        std::fputs("t_end_s,t_begin_s,bin,reason,falsified,speed_mps,margin,statistic,evidence,energy_ratio,change_ratio\n", ends_.frames);
    }
    if (ends_.drive != nullptr) {
        std::fprintf(ends_.drive, "%s\n", ends_.columns.c_str());
    }
    if (ends_.telemetry != nullptr) {
        std::fputs("t_s,speed_mps,command_radps,wanted_radps,yaw_rate_radps,road_wheel_rad,demand_bar,statistic,verdict,supervision\n",
                   ends_.telemetry);
    }
}

void Loop::run(double pace) {
    using Clock = std::chrono::steady_clock;
    const std::clock_t started = std::clock();
    auto begin = Clock::now();
    const auto revise = [this](const Scenario& scenario) {
        model_->revise(scenario.plant.drive, scenario.plant.faults);
        vehicle_.revise(scenario.can_faults);
    };
    for (std::int64_t k = 0; k < ticks_; ++k) {
        if (ends_.control != nullptr) {
            const auto asked = Clock::now();
            if (!ends_.control->may_tick(k * tick_us, revise)) {
                ticks_ = k;
                break;
            }
            begin += Clock::now() - asked;  // time lost in a pause is not caught up
        }
        if (pace > 0.0) {
            std::this_thread::sleep_until(begin + std::chrono::duration_cast<Clock::duration>(
                                                      std::chrono::duration<double>(static_cast<double>(k * tick_us) * 1e-6 / pace)));
        }
        tick(k);
    }
    if (ends_.control != nullptr) {
        ends_.control->ended(ticks_ * tick_us);
    }
    // Processor time does not depend on the load of the machine. With the ECU in another process, elapsed time is used instead.
    const double processor_s = static_cast<double>(std::max<std::clock_t>(std::clock() - started, 1)) / CLOCKS_PER_SEC;
    const std::chrono::duration<double> elapsed = Clock::now() - begin;
    real_time_factor_ = static_cast<double>(ticks_ * tick_us) * 1e-6 / (ecu_.inside() != nullptr ? processor_s : elapsed.count());
}

void Loop::print(std::FILE* out, std::uint64_t seed) {
    const auto n = static_cast<double>(ticks_);
    std::fprintf(out, "{\"seed\": %" PRIu64 ", \"duration_s\": %.9g, \"threshold\": %.9g, \"verdict_final\": %d,\n", seed,
                 static_cast<double>(ticks_ * tick_us) * 1e-6, static_cast<double>(lpvg_coeff.reals.threshold),
                 verdicts_.list().back().value);
    std::fprintf(out, " \"tracking_rms\": %.9g, \"command_rms\": %.9g, ", std::sqrt(error_squares_ / n), std::sqrt(wanted_squares_ / n));
    for (std::size_t i = 0; i < LPVG_NU; ++i) {
        std::fprintf(out, "%s%.9g", i == 0 ? "\"demand_max\": [" : ", ", demand_max_[i]);
    }
    std::fprintf(out, "],\n");
    if (ecu_.inside() != nullptr) {
        std::fprintf(out, " \"limited_s\": %.9g,\n",
                     static_cast<double>(ecu_.inside()->control.limited) * static_cast<double>(tick_us) * 1e-6);
    }
    std::fprintf(out, " \"frames\": %" PRIu64 ", \"frames_hash\": \"%016" PRIx64 "\", \"real_time_factor\": %.4g,\n", watcher_.count(),
                 watcher_.hash(), real_time_factor_);
    const auto print_number = [out](std::uint8_t value) { std::fprintf(out, "%d", value); };
    print_changes(out, "verdicts", verdicts_, print_number);
    print_changes(out, "supervision", supervision_, print_number);
    print_changes(out, "implausible", implausible_, print_number);
    print_changes(out, "trouble_codes", troubles_,
                  [out](const TroubleCode& t) { std::fprintf(out, "{\"spn\": %" PRIu32 ", \"fmi\": %d}", t.spn, t.fmi); });
    std::fprintf(out, " \"causes\": [");
    const char* separator = "";
    for (const auto& [time_s, of] : causes_) {
        std::fprintf(out, "%s[%.9g, %.9g, %.9g, %u, %u, %u, %.9g, %.9g, %.9g]", separator, time_s,
                     static_cast<double>(of.t_alarm_us) * 1e-6, static_cast<double>(of.t_onset_us) * 1e-6, of.before, of.output, of.cause,
                     of.value, of.low, of.high);
        separator = ", ";
    }
    std::fprintf(out, "],\n");
    std::fprintf(out, " \"reception\": %s,\n", ecu_.finish().c_str());
    std::fprintf(out, " \"schema\": 1}\n");
}

// Row k of a drive holds the sensor values at t, and the demand from t to the next row.
void Loop::tick(std::int64_t k) {
    const std::int64_t now_us = k * tick_us;
    const double time_s = static_cast<double>(now_us) * 1e-6;
    const double command_radps = command_.next();
    const double wanted_radps = wanted_.step(command_radps);
    const double yaw_rate_radps = model_->truth().yaw_rate_radps;
    error_squares_ += (wanted_radps - yaw_rate_radps) * (wanted_radps - yaw_rate_radps);
    wanted_squares_ += wanted_radps * wanted_radps;

    vehicle_.send(now_us, model_->sensors(), model_->values(), command_radps);
    ecu_.tick(now_us, ends_.publisher != nullptr && k % telemetry_every == 0);
    vehicle_.receive(now_us);
    if (!bus_.failure().empty()) {
        throw std::runtime_error(bus_.failure());
    }
    note(k, time_s, command_radps, wanted_radps);
    model_->advance(vehicle_.demand());
}

void Loop::note(std::int64_t k, double time_s, double command_radps, double wanted_radps) {
    const std::int64_t now_us = k * tick_us;
    const lpvg_ecu_t* const ecu = ecu_.inside();
    const lpvg_bus_report_t& report = ecu != nullptr ? ecu->report : vehicle_.report();
    verdicts_.take(time_s, report.verdict);
    supervision_.take(time_s, report.supervision);
    troubles_.take(time_s, vehicle_.trouble());
    for (std::size_t i = 0; i < LPVG_NU; ++i) {
        demand_max_[i] = std::fmax(demand_max_[i], std::fabs(vehicle_.demand()[i]));
    }
    if (ecu != nullptr) {
        implausible_.take(time_s, ecu->plausibility.flags);
        note_sample(*ecu, k, time_s);
    }
    if (const Judged* const judged = ecu_.judged()) {
        note_frame(*judged, now_us, report.verdict);
    }
    if (ecu_.found() != nullptr) {
        for (const Found& found : *ecu_.found()) {
            causes_.emplace_back(time_s, found);
            if (ends_.publisher != nullptr) {
                ends_.publisher->publish(now_us, found);
            }
        }
    }
    if (ends_.publisher != nullptr) {
        ends_.publisher->publish(now_us, model_->truth());
        ends_.publisher->publish(now_us, GuardTelemetry{command_radps, wanted_radps, *vehicle_.demand(),
                                                        static_cast<double>(report.statistic), report.verdict, report.supervision});
        if (k % telemetry_every == 0) {
            ends_.publisher->publish(now_us, ecu_.supervision(), vehicle_.trouble());
        }
    }
    if (ends_.telemetry != nullptr && k % telemetry_every == 0) {
        const lpvguard_plant::Truth& truth = model_->truth();
        std::fprintf(ends_.telemetry, "%.9g,%.9g,%.9g,%.9g,%.9g,%.9g,%.9g,%.9g,%d,%d\n", time_s, truth.speed_mps, command_radps,
                     wanted_radps, truth.yaw_rate_radps, truth.road_wheel_rad, *vehicle_.demand(), static_cast<double>(report.statistic),
                     report.verdict, report.supervision);
    }
}

void Loop::note_frame(const Judged& judged, std::int64_t now_us, std::uint8_t verdict) {
    const double length_us = static_cast<double>(lpvg_coeff.words.frame_length[judged.bin]) * static_cast<double>(tick_us);
    const JudgedFrame frame{now_us, judged, judged.t_end_us - std::llround(length_us),
                            two_pi * 1e6 * lpvg_coeff.words.cycles[judged.bin] / length_us, verdict};
    if (ends_.frames != nullptr) {
        std::fprintf(ends_.frames, "%.9g,%.9g,%u,%u,%u,%.9g,%.9g,%.9g,%.9g,%.9g,%.9g\n", static_cast<double>(judged.t_end_us) * 1e-6,
                     static_cast<double>(frame.begin_us) * 1e-6, judged.bin, judged.reason, judged.falsified, judged.speed_mps,
                     judged.margin, judged.statistic, judged.evidence, judged.energy_ratio, judged.change_ratio);
    }
    if (ends_.publisher != nullptr) {
        ends_.publisher->publish(frame);
    }
}

/// A sample with a missing or refused measurement never reached the monitor.
void Loop::note_sample(const lpvg_ecu_t& ecu, std::int64_t k, double time_s) {
    if (ends_.drive != nullptr && ecu.monitor.running && ecu.monitor.t_us == k * tick_us) {
        std::fprintf(ends_.drive, "%.9g,%.9g", time_s, static_cast<double>(ecu.signals.speed));
        for (const lpvg_real_t u : ecu.control.u) {
            std::fprintf(ends_.drive, ",%.9g", static_cast<double>(u));
        }
        for (const lpvg_real_t y : ecu.signals.y) {
            std::fprintf(ends_.drive, ",%.9g", static_cast<double>(y));
        }
        std::fputc('\n', ends_.drive);
    }
}

}  // namespace lpvguard_sim
