#include "command.hpp"

#include <cmath>

#include "lpvguard_plant/random.hpp"

namespace lpvguard_sim {
namespace {

constexpr double two_pi = 6.283185307179586477;
constexpr double fade_in_s = 5.0;
constexpr std::uint64_t command_stream = 300;
constexpr int sines_log = 24;     // dense enough to excite every monitor bin of the band
constexpr int sines_linear = 48;  // enough for a nearly Gaussian amplitude

}  // namespace

Command::Command(const CommandSettings& settings, std::uint64_t seed, double period_s) : settings_(settings), period_s_(period_s) {
    if (settings_.kind != CommandSettings::Kind::multisine) {
        return;
    }
    lpvguard_plant::Random random(seed, command_stream);
    const int n = settings_.linear_spacing ? sines_linear : sines_log;
    amplitude_radps_ = settings_.rms_radps * std::sqrt(2.0 / n);
    for (int i = 0; i < n; ++i) {
        // A random frequency in each of n equal cells, so that different seeds have different periods.
        const double place = (i + random.uniform()) / n;
        const double omega = settings_.linear_spacing ? settings_.low_radps + place * (settings_.high_radps - settings_.low_radps)
                                                      : settings_.low_radps * std::pow(settings_.high_radps / settings_.low_radps, place);
        const double phase = random.uniform(0.0, two_pi);
        oscillators_.push_back({std::cos(phase), std::sin(phase), std::cos(omega * period_s), std::sin(omega * period_s)});
    }
}

double Command::next() {
    const double time_s = static_cast<double>(samples_++) * period_s_;
    if (settings_.kind == CommandSettings::Kind::steps) {
        return std::fmod(time_s, settings_.period_s) < 0.5 * settings_.period_s ? settings_.amplitude_radps : -settings_.amplitude_radps;
    }
    if (settings_.kind == CommandSettings::Kind::profile) {
        return on_profile(time_s);
    }
    double sum = 0.0;
    for (Oscillator& o : oscillators_) {
        sum += o.im;
        const double re = o.re * o.step_re - o.im * o.step_im;
        o.im = o.re * o.step_im + o.im * o.step_re;
        o.re = re;
    }
    return amplitude_radps_ * sum * std::fmin(1.0, time_s / fade_in_s);
}

double Command::on_profile(double time_s) {
    const auto& knots = settings_.knots;
    while (segment_ + 1 < knots.size() && time_s >= knots[segment_ + 1].first) {
        ++segment_;
    }
    const auto& [from_s, from_radps] = knots[segment_];
    if (time_s <= from_s || segment_ + 1 == knots.size()) {
        return from_radps;
    }
    const auto& [to_s, to_radps] = knots[segment_ + 1];
    return from_radps + (to_radps - from_radps) * (time_s - from_s) / (to_s - from_s);
}

ReferenceModel::ReferenceModel(const std::array<double, 6>& coefficients, double period_s) {
    const double h = period_s;
    const auto by_rule = [h](const double* of, double* to) {
        to[0] = 4.0 * of[0] + 2.0 * of[1] * h + of[2] * h * h;
        to[1] = 2.0 * of[2] * h * h - 8.0 * of[0];
        to[2] = 4.0 * of[0] - 2.0 * of[1] * h + of[2] * h * h;
    };
    by_rule(coefficients.data(), b_);
    by_rule(coefficients.data() + 3, a_);
}

double ReferenceModel::step(double command) {
    const double out = (b_[0] * command + b_[1] * in_[0] + b_[2] * in_[1] - a_[1] * out_[0] - a_[2] * out_[1]) / a_[0];
    in_[1] = in_[0];
    in_[0] = command;
    out_[1] = out_[0];
    out_[0] = out;
    return out;
}

}  // namespace lpvguard_sim
