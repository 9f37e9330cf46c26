/// @file experiment.cpp -- seeded experiments: a brake program, the truck, and its sensor values.
#include <array>
#include <cerrno>
#include <cmath>
#include <cstdio>
#include <cstring>
#include <memory>

#include "commands.hpp"
#include "lpvguard_plant/plant.hpp"
#include "lpvguard_plant/scenario.hpp"

namespace lpvguard_plant {
namespace {

constexpr double two_pi = 6.283185307179586477;
constexpr double sample_s = Plant::step_s * Plant::steps_per_sample;

/// Sine with an error of 1e-9 for any moderate x, by its series on [-pi/2, pi/2]. The last bit of libm differs between machines.
double sine(double x) {
    double folded = x - two_pi * std::floor(x / two_pi + 0.5);
    if (std::fabs(folded) > 0.25 * two_pi) {
        folded = std::copysign(0.5 * two_pi, folded) - folded;
    }
    const double f2 = folded * folded;
    return folded * (1.0 - f2 / 6.0 * (1.0 - f2 / 20.0 * (1.0 - f2 / 42.0 * (1.0 - f2 / 72.0 * (1.0 - f2 / 110.0 * (1.0 - f2 / 156.0))))));
}

/// The brake demand over time, with one call per 10 ms.
class Program {
public:
    Program(const std::string& kind, double low_bar, double high_bar, double duration_s, std::uint64_t seed)
        : kind_(kind), low_bar_(low_bar), high_bar_(high_bar), duration_s_(duration_s), random_(seed, 100) {
        if (kind_ != "pulses" && kind_ != "telegraph" && kind_ != "multisine" && kind_ != "sweep" && kind_ != "zero") {
            throw UsageError("--program '" + kind_ + "': expected pulses, telegraph, multisine, sweep or zero");
        }
        for (double& phase : phases_) {
            phase = random_.uniform(0.0, two_pi);
        }
    }

    double next() {
        const double time_s = static_cast<double>(samples_++) * sample_s;
        if (kind_ == "zero") {
            return 0.0;
        }
        if (kind_ == "multisine") {
            return multisine(time_s);
        }
        if (kind_ == "sweep") {
            return sweep(time_s);
        }
        if (time_s >= switch_s_) {
            kind_ == "pulses" ? switch_pulse(time_s) : switch_telegraph(time_s);
        }
        return level_bar_;
    }

private:
    double amplitude_bar() { return random_.uniform(low_bar_, high_bar_); }

    /// Brakes a random side for 1 to 4 s, then no side for 1 to 4 s.
    void switch_pulse(double time_s) {
        const bool braking = level_bar_ != 0.0;
        level_bar_ = braking ? 0.0 : (random_.uniform() < 0.5 ? -1.0 : 1.0) * amplitude_bar();
        switch_s_ = time_s + random_.uniform(1.0, 4.0);
    }

    /// Alternates between the sides, 0.3 to 3 s each with a random amplitude, to excite short periods.
    void switch_telegraph(double time_s) {
        level_bar_ = (level_bar_ > 0.0 ? -1.0 : 1.0) * amplitude_bar();
        switch_s_ = time_s + random_.uniform(0.3, 3.0);
    }

    /// 24 sines with logarithmic spacing from 0.1 to 8 rad/s and an rms of amplitude_high / 2, clipped at amplitude_high.
    double multisine(double time_s) const {
        double sum = 0.0;
        double omega_radps = 0.1;
        for (const double phase : phases_) {
            sum += sine(omega_radps * time_s + phase);
            omega_radps *= 1.2098731;  // 80^(1/23)
        }
        const double scaled = sum * high_bar_ / std::sqrt(2.0 * static_cast<double>(phases_.size()));
        return std::fmax(-high_bar_, std::fmin(high_bar_, scaled));
    }

    /// A sine of amplitude_high whose frequency rises exponentially from 0.1 to 30 rad/s, after one second without demand.
    double sweep(double time_s) const {
        constexpr double first_s = 1.0, lowest_radps = 0.1, span = 5.703782474656201;  // ln(30 / 0.1)
        if (time_s < first_s) {
            return 0.0;
        }
        const double rate_ps = span / (duration_s_ - first_s);
        return high_bar_ * sine(lowest_radps / rate_ps * std::expm1(rate_ps * (time_s - first_s)));
    }

    std::string kind_;
    double low_bar_, high_bar_, duration_s_;
    Random random_;
    std::array<double, 24> phases_{};
    std::int64_t samples_ = 0;
    double level_bar_ = 0.0;
    double switch_s_ = 1.0;  ///< The first second is straight driving, so that a model of the data starts in equilibrium.
};

/// A file that gets its name only when it is complete.
class ResultFile {
public:
    explicit ResultFile(const std::string& path) : path_(path), temporary_(path + ".part") {
        file_ = std::fopen(temporary_.c_str(), "wb");
        if (file_ == nullptr) {
            throw UsageError(temporary_ + ": cannot be written: " + std::strerror(errno));
        }
    }
    ResultFile(const ResultFile&) = delete;
    ResultFile& operator=(const ResultFile&) = delete;
    ~ResultFile() {
        if (file_ != nullptr) {
            std::fclose(file_);
            std::remove(temporary_.c_str());
        }
    }

    std::FILE* handle() { return file_; }

    void commit() {
        const bool intact = std::ferror(file_) == 0;
        const bool closed = std::fclose(file_) == 0;
        file_ = nullptr;
        if (!intact || !closed || std::rename(temporary_.c_str(), path_.c_str()) != 0) {
            std::remove(temporary_.c_str());
            throw UsageError(path_ + ": writing failed: " + std::strerror(errno));
        }
    }

private:
    std::string path_, temporary_;
    std::FILE* file_ = nullptr;
};

/// Common part of `generate` and `digest`: the truck, its program, and the duration.
struct Experiment {
    PlantParameters parameters;
    Scenario scenario;
    std::uint64_t seed;
    double duration_s;
    Program program;
    std::int64_t samples;

    Experiment(Arguments& arguments, double default_duration_s)
        : parameters(load_parameters(arguments.text("--parameters", LPVGUARD_TRUCK_TOML))),
          scenario(read_scenario(arguments)),
          seed(arguments.seed("--seed", 1)),
          duration_s(arguments.number("--duration", default_duration_s, sample_s, 1e6)),
          program(read_program(arguments, duration_s, seed)),
          samples(std::llround(duration_s / sample_s)) {
        parameters = varied(parameters, scenario.variation);
    }

private:
    static Scenario read_scenario(Arguments& arguments) {
        if (arguments.has("--scenario")) {
            return load_scenario(arguments.text("--scenario"));
        }
        Scenario scenario;
        scenario.drive.speed_profile = {{0.0, arguments.number("--speed", 12.0, Plant::slowest_mps, Plant::fastest_mps)}};
        return scenario;
    }

    static Program read_program(Arguments& arguments, double duration_s, std::uint64_t seed) {
        const double low_bar = arguments.number("--amplitude-low", 0.5, 0.0, 10.0);
        const double high_bar = arguments.number("--amplitude-high", std::fmax(low_bar, 2.0), low_bar, 10.0);
        return Program(arguments.text("--program", "pulses"), low_bar, high_bar, duration_s, seed);
    }
};

/// FNV-1a over the bytes of plain numbers.
class Hash {
public:
    void add(double value) {
        std::array<unsigned char, sizeof value> bytes;
        std::memcpy(bytes.data(), &value, sizeof value);
        for (const unsigned char byte : bytes) {
            state_ = (state_ ^ byte) * 0x100000001B3U;
        }
    }
    unsigned long long value() const { return state_; }

private:
    std::uint64_t state_ = 0xCBF29CE484222325U;
};

}  // namespace

int generate(Arguments arguments) {
    const std::string path = arguments.text("-o");
    Experiment experiment(arguments, 60.0);
    const std::string further = arguments.text("--further-column", "");
    const bool with_bank = further == "bank";
    if (!further.empty() && !with_bank) {
        throw UsageError("--further-column '" + further + "': expected bank");
    }
    arguments.done();
    const auto plant =
        std::make_unique<Plant>(experiment.parameters, experiment.scenario.drive, experiment.seed, experiment.scenario.faults);
    ResultFile result(path);
    std::fprintf(result.handle(), "t,v,dp,r,delta%s\n", with_bank ? ",bank" : "");
    for (std::int64_t k = 0; k < experiment.samples; ++k) {
        // Row k holds the sensor values at t, and the demand from t to the next row.
        const double demand_bar = experiment.program.next();
        const Sensors& seen = plant->sensors();
        std::fprintf(result.handle(), "%.9g,%.9g,%.9g,%.9g,%.9g", static_cast<double>(k) * sample_s, seen.speed_mps, demand_bar,
                     seen.yaw_rate_radps, seen.steering_wheel_rad / experiment.parameters.steering_ratio);
        if (with_bank) {
            std::fprintf(result.handle(), ",%.9g", plant->truth().bank_rad);
        }
        std::fputc('\n', result.handle());
        for (int i = 0; i < Plant::steps_per_sample; ++i) {
            plant->step(demand_bar);
        }
    }
    result.commit();
    return 0;
}

int digest(Arguments arguments) {
    Experiment experiment(arguments, 600.0);
    arguments.done();
    const auto plant =
        std::make_unique<Plant>(experiment.parameters, experiment.scenario.drive, experiment.seed, experiment.scenario.faults);
    Hash hash;
    for (std::int64_t k = 0; k < experiment.samples; ++k) {
        const double demand_bar = experiment.program.next();
        for (int i = 0; i < Plant::steps_per_sample; ++i) {
            plant->step(demand_bar);
        }
        const Truth& truth = plant->truth();
        const Sensors& seen = plant->sensors();
        for (const double value : {truth.yaw_rate_radps, truth.road_wheel_rad, truth.roll_rad, truth.lateral_velocity_mps, truth.speed_mps,
                                   seen.yaw_rate_radps, seen.steering_wheel_rad, seen.speed_mps, seen.lateral_acceleration_mps2}) {
            hash.add(value);
        }
    }
    std::printf("%016llx\n", hash.value());
    return 0;
}

}  // namespace lpvguard_plant
