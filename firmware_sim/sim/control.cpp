#include "control.hpp"

#include "lpvguard/coeff.h"

namespace lpvguard_sim {
namespace {

using lpvguard_plant::ParameterError;

constexpr double s_per_us = 1e-6;
constexpr std::int64_t early_us = 500;  // half a step of the plant, so that rounding of times moves no change to the next tick
constexpr std::int32_t steps_max = 1'000'000;

}  // namespace

const std::int64_t Control::tick_us = lpvg_coeff.words.sample_period_us;

bool Control::may_tick(std::int64_t now_us, const Revise& revise) {
    if (now_us % report_us == 0) {
        publisher_.publish(Status{now_us, state()});
    }
    for (int wait_ms = 0;; wait_ms = report_paused_ms) {
        const std::vector<ControlCommand> commands = publisher_.take(wait_ms);
        for (const ControlCommand& command : commands) {
            publisher_.publish(answer(now_us, command, revise));
        }
        if (stopped_ || left_ != 0) {
            break;
        }
        if (commands.empty() && wait_ms != 0) {
            publisher_.publish(Status{now_us, state()});
        }
    }
    if (left_ > 0) {
        --left_;
    }
    return !stopped_;
}

Status Control::answer(std::int64_t now_us, const ControlCommand& command, const Revise& revise) {
    const std::int64_t next_us = now_us + tick_us;
    const double from_s = static_cast<double>(next_us - early_us) * s_per_us;
    Status answer{now_us, state(), command.id, true};
    try {
        switch (command.action) {
            case ControlCommand::pause: left_ = 0; break;
            case ControlCommand::resume: left_ = without_end; break;
            case ControlCommand::step:
                if (command.ticks < 1 || command.ticks > steps_max) {
                    throw ParameterError("command: ticks = " + std::to_string(command.ticks) + ": expected 1 .. " +
                                         std::to_string(steps_max));
                }
                left_ = command.ticks;
                break;
            case ControlCommand::stop:
                change(scenario_.ended(static_cast<double>(now_us) * s_per_us), revise, answer);
                stopped_ = true;
                break;
            case ControlCommand::inject:
                change(scenario_.injected(from_s, command.entry), revise, answer);
                answer.now_us = next_us;
                break;
            case ControlCommand::clear:
                change(scenario_.cleared(from_s, command.entry), revise, answer);
                answer.now_us = next_us;
                break;
            default:
                throw ParameterError("command: action = " + std::to_string(command.action) + ": expected 0 .. " +
                                     std::to_string(ControlCommand::clear));
        }
    } catch (const ParameterError& error) {
        answer.accepted = false;
        answer.reason = error.what();
    }
    answer.state = state();
    return answer;
}

void Control::change(LiveScenario::Change change, const Revise& revise, Status& answer) {
    revise(change.scenario);
    scenario_.take(change);
    answer.entry = change.entry;
}

}  // namespace lpvguard_sim
