/// @file frequency_response.cpp -- distance of the simulated truck from the nominal model, measured as on a test track.
///
/// For each speed and frequency, the truck is driven with a sine demand on a flat road without wind. After the transient, its
/// true yaw rate and road-wheel angle are correlated over whole periods with the pressure difference at the wheels, the input of
/// Table I. Table I is only the target of this comparison. The plant does not use it.
///
/// `response` prints the response that a controller meets, for a scenario's truck. Its input is a demand that is held over each
/// sample of 10 ms. Its outputs are the true ones at the sample instants, just before the demand changes. It includes hold, brake
/// delay and brake lag. It excludes the controller's own sample of delay, and the noise and quantisation of the sensors.
#include <algorithm>
#include <array>
#include <cmath>
#include <complex>
#include <cstdio>
#include <memory>
#include <vector>

#include "commands.hpp"
#include "lpvguard_plant/plant.hpp"
#include "lpvguard_plant/scenario.hpp"

namespace lpvguard_plant {
namespace {

constexpr double two_pi = 6.283185307179586477;
constexpr double lowest_radps = 0.2, judged_radps = 6.0, highest_radps = 30.0;
// Limits of the difference between truck.toml and Table I, for each speed and output, up to judged_radps. Above it, Table I rolls off,
// but the direct yaw moment of the brakes does not. Kingpin friction makes the response depend on the amplitude.
constexpr double judged_bar = 1.0;
constexpr double largest_worst_ratio = 0.40;
constexpr double least_median_ratio = 0.03;      ///< A plant equal to the model would prove nothing.
constexpr double largest_median_ratio = 0.13;
constexpr std::array<double, 8> speeds_mps{8.0, 10.0, 12.0, 14.0, 16.0, 18.0, 20.0, 22.0};

using Complex = std::complex<double>;

/// Response per bar: yaw rate [rad/s], road-wheel angle [rad].
struct Response {
    Complex yaw_rate, road_wheel;
};

/// The paper's nominal model, Table I with l = 4.5 m, at s = j omega.
Response nominal(double speed_mps, double omega_radps) {
    constexpr double p1 = 14.54, p2 = 0.06, p3 = 20.60, p4 = -0.25, p5 = -4.96, p6 = -0.32, l = 4.5;
    const Complex s(0.0, omega_radps);
    // r = p1 delta / (s + p1 l / v - p2 v); the third row then gives delta.
    const Complex yaw_per_wheel = p1 / (s + p1 * l / speed_mps - p2 * speed_mps);
    const Complex wheel = p6 / (s * s - p5 * s + p3 - (p3 * l / speed_mps + p4 * speed_mps) * yaw_per_wheel);
    return {yaw_per_wheel * wheel, wheel};
}

constexpr long transient_steps = 25000;  // 10 time constants of the slowest pole (8 m/s).

/// The response to a demand that is held over each sample. The frequency is the nearest one to the wanted frequency with whole
/// periods in whole samples.
struct HeldMeasurement {
    double omega_radps = 0.0;
    Response from_demand;
};

constexpr long transient_samples = transient_steps / Plant::steps_per_sample;
constexpr long least_samples = 1000;     ///< Least length: frequency error 0.05 %, and non-periodic parts are averaged.

/// Response on a flat road without wind.
PlantParameters undisturbed(PlantParameters parameters) {
    parameters.bank_rms_rad = 0.0;
    parameters.crosswind_mean_mps = 0.0;
    parameters.crosswind_gust_rms_mps = 0.0;
    return parameters;
}

std::unique_ptr<Plant> at_speed(const PlantParameters& parameters, double speed_mps, const Faults& faults) {
    Drive drive;
    drive.speed_profile = {{0.0, speed_mps}};
    return std::make_unique<Plant>(parameters, drive, 1, faults);
}

/// Response to a constant demand.
Response steady(const PlantParameters& parameters, double speed_mps, double demand_bar, const Faults& faults) {
    const auto plant = at_speed(parameters, speed_mps, faults);
    for (long k = 0; k < 2 * transient_steps; ++k) {
        plant->step(demand_bar);
    }
    return {plant->truth().yaw_rate_radps / demand_bar, plant->truth().road_wheel_rad / demand_bar};
}

/// Response from the pressure difference at the wheels, without brake delay and lag.
Response measure(const PlantParameters& parameters, double speed_mps, double omega_radps, double amplitude_bar) {
    const auto plant = at_speed(parameters, speed_mps, {});
    const auto period_steps = std::lround(two_pi / omega_radps / Plant::step_s);
    const double phase_per_step = two_pi / static_cast<double>(period_steps);
    const long settle_periods = transient_steps / period_steps + 1;
    const long measured_periods = std::max(2L, 10000 / period_steps);
    const long first = settle_periods * period_steps;
    Complex pressure, yaw_rate, road_wheel;
    for (long k = 0; k < first + measured_periods * period_steps; ++k) {
        const double phase = phase_per_step * static_cast<double>(k);
        const double demand_bar = amplitude_bar * std::sin(phase);
        if (k >= first) {
            const Complex carrier(std::cos(phase), -std::sin(phase));
            const Truth& truth = plant->truth();
            pressure += carrier * (truth.pressure_right_bar - truth.pressure_left_bar);
            yaw_rate += carrier * truth.yaw_rate_radps;
            road_wheel += carrier * truth.road_wheel_rad;
        }
        plant->step(demand_bar);
    }
    return {yaw_rate / pressure, road_wheel / pressure};
}

HeldMeasurement measure_held(const PlantParameters& parameters, double speed_mps, double omega_radps, double amplitude_bar,
                             const Faults& faults) {
    constexpr double sample_s = Plant::step_s * Plant::steps_per_sample;
    const auto plant = at_speed(parameters, speed_mps, faults);
    const double period_samples = two_pi / omega_radps / sample_s;
    const double periods = std::ceil(static_cast<double>(least_samples) / period_samples);
    const long samples = std::lround(periods * period_samples);
    const double phase_per_sample = two_pi * periods / static_cast<double>(samples);
    Complex demand, yaw_rate, road_wheel;
    for (long k = -transient_samples; k < samples; ++k) {
        const double phase = phase_per_sample * static_cast<double>(k);
        const double demand_bar = amplitude_bar * std::sin(phase);
        if (k >= 0) {
            const Complex carrier(std::cos(phase), -std::sin(phase));
            demand += carrier * demand_bar;
            yaw_rate += carrier * plant->truth().yaw_rate_radps;
            road_wheel += carrier * plant->truth().road_wheel_rad;
        }
        for (int step = 0; step < Plant::steps_per_sample; ++step) {
            plant->step(demand_bar);
        }
    }
    return {phase_per_sample / sample_s, {yaw_rate / demand, road_wheel / demand}};
}

/// Relative differences |G - G0| / |G0| of one transfer function over the frequencies.
class Differences {
public:
    void add(double omega_radps, Complex truth, Complex model) {
        const double ratio = std::abs(truth - model) / std::abs(model);
        if (ratios_.empty() || ratio > worst_) {
            worst_ = ratio;
            worst_radps_ = omega_radps;
        }
        ratios_.push_back(ratio);
    }

    /// Tells if these limits hold.
    bool within() const {
        const double middle = median();
        return middle >= least_median_ratio && middle <= largest_median_ratio && worst_ <= largest_worst_ratio;
    }

    void print() const { std::printf(" | %5.1f %% %5.1f %% at %4.2f", 100.0 * median(), 100.0 * worst_, worst_radps_); }

private:
    double median() const {
        std::vector<double> sorted = ratios_;
        std::sort(sorted.begin(), sorted.end());
        const std::size_t half = sorted.size() / 2;
        return sorted.size() % 2 == 1 ? sorted[half] : 0.5 * (sorted[half - 1] + sorted[half]);
    }

    std::vector<double> ratios_;
    double worst_ = 0.0;
    double worst_radps_ = 0.0;
};

}  // namespace

int frequency_response(Arguments arguments) {
    const PlantParameters parameters = undisturbed(load_parameters(arguments.text("--parameters", LPVGUARD_TRUCK_TOML)));
    const double amplitude_bar = arguments.number("--amplitude", 1.0, 0.01, 10.0);
    const int points = static_cast<int>(arguments.number("--points", 24.0, 2.0, 1000.0));
    arguments.done();

    const bool judged = amplitude_bar == judged_bar;
    std::printf(
        "relative difference of the response from the pressure to Table I (l = 4.5 m), %.3g to %.3g rad/s, %d points, sine of "
        "%.3g bar\n",
        lowest_radps, highest_radps, points, amplitude_bar);
    std::printf("columns: median, worst, its frequency [rad/s]\n");
    std::printf("limits (%.3g bar, to %.3g rad/s): median in %.0f .. %.0f %%, worst at most %.0f %%\n\n", judged_bar, judged_radps,
                100.0 * least_median_ratio, 100.0 * largest_median_ratio, 100.0 * largest_worst_ratio);
    std::printf("  v   | yaw rate to %-2.0f rad/s     | wheel angle to %-2.0f rad/s  | yaw rate, all           | wheel angle, all\n",
                judged_radps, judged_radps);
    bool all_within = true;
    for (const double speed_mps : speeds_mps) {
        Differences yaw, wheel, yaw_all, wheel_all;
        for (int i = 0; i < points; ++i) {
            const double omega = lowest_radps * std::pow(highest_radps / lowest_radps, static_cast<double>(i) / (points - 1));
            const Response model = nominal(speed_mps, omega);
            const Response truth = measure(parameters, speed_mps, omega, amplitude_bar);
            if (omega <= judged_radps) {
                yaw.add(omega, truth.yaw_rate, model.yaw_rate);
                wheel.add(omega, truth.road_wheel, model.road_wheel);
            }
            yaw_all.add(omega, truth.yaw_rate, model.yaw_rate);
            wheel_all.add(omega, truth.road_wheel, model.road_wheel);
        }
        std::printf("%5.1f", speed_mps);
        for (const Differences* column : {&yaw, &wheel, &yaw_all, &wheel_all}) {
            column->print();
        }
        const bool within = yaw.within() && wheel.within();
        std::printf("%s\n", within || !judged ? "" : "  OUTSIDE");
        all_within = all_within && within;
    }
    if (!judged) {
        std::printf("\nnot judged: the limits are for %.3g bar\n", judged_bar);
        return 0;
    }
    std::printf("\n%s\n", all_within ? "within the limits" : "OUTSIDE the limits");
    return all_within ? 0 : 1;
}

int response(Arguments arguments) {
    const PlantParameters nominal_truck = load_parameters(arguments.text("--parameters", LPVGUARD_TRUCK_TOML));
    const Scenario scenario = load_scenario(arguments.text("--scenario"));
    const double amplitude_bar = arguments.number("--amplitude", 0.5, 0.01, 10.0);
    const double speed_mps = arguments.number("--speed", 15.0, Plant::slowest_mps, Plant::fastest_mps);
    const std::vector<double> omegas_radps = arguments.numbers("--omega", 0.0, 100.0);
    arguments.done();
    const PlantParameters parameters = undisturbed(varied(nominal_truck, scenario.variation));
    // A fault that begins later is measured as if it began at the start.
    Faults faults = scenario.faults;
    for (ActuatorFault& fault : faults.actuators) {
        fault.window = {};
    }
    for (SurroundingsFault& fault : faults.surroundings) {
        fault.window = {};
    }
    std::printf("omega_radps,yaw_rate_re,yaw_rate_im,road_wheel_re,road_wheel_im\n");
    for (const double omega : omegas_radps) {
        const HeldMeasurement measured = omega == 0.0 ? HeldMeasurement{0.0, steady(parameters, speed_mps, amplitude_bar, faults)}
                                                      : measure_held(parameters, speed_mps, omega, amplitude_bar, faults);
        const Response& found = measured.from_demand;
        std::printf("%.9g,%.9g,%.9g,%.9g,%.9g\n", measured.omega_radps, found.yaw_rate.real(), found.yaw_rate.imag(),
                    found.road_wheel.real(), found.road_wheel.imag());
    }
    return 0;
}

}  // namespace lpvguard_plant
