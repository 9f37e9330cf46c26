// The ECU in its loop with the simulated truck, whose response to the demand can be scaled at any time. The brake pressure that the vehicle
// reports follows the demand all the same: nothing but the motion tells that the response is wrong.
#pragma once

#include "../unit/ecu_bench.hpp"

#include <algorithm>
#include <array>
#include <functional>

#include "lpvguard_plant/plant.hpp"

constexpr double steering_ratio = 20.0;

// How a release begins and ends. The cause lasts `steps` sample periods.
enum class Release {
    cold,
    vdc2_gap,
    guard_in_gap,
    ebc2_gap,
    ebc1_gap,
    pedal,
    abs,
    request,
    priority,
    asker,
    clock_gap
};
constexpr unsigned n_releases = static_cast<unsigned>(Release::clock_gap) + 1U;

class ResponseDrive {
public:
    ResponseDrive(const lpvguard_plant::PlantParameters& parameters, double speed_mps, std::uint64_t seed)
        : plant_(parameters, straight(speed_mps), seed) {
        bench.answers = false;
    }

    void step() {
        const lpvguard_plant::Sensors& s = plant_.sensors();
        bench.yaw_rate = static_cast<float>(s.yaw_rate_radps);
        bench.wheel_angle = static_cast<float>(s.steering_wheel_rad / steering_ratio);
        bench.lateral = static_cast<float>(s.lateral_acceleration_mps2);
        bench.speed = static_cast<float>(s.speed_mps);
        bench.command = static_cast<float>(command(static_cast<double>(bench.k) * 0.01));
        bench.step();
        move();
    }
    void run(int steps) {
        for (int i = 0; i < steps; ++i) {
            step();
        }
    }

    // A release of a kind that lasts `steps` sample periods; after `onset` of them the response becomes `then`.
    void release(Release kind, int steps, int onset, double then) {
        set(kind, true);
        for (int i = 0; i < steps; ++i) {
            response = i < onset ? response : then;
            if (kind == Release::clock_gap) {  // no step is taken, and the truck drives on
                ++bench.k;
                move();
            } else {
                step();
            }
        }
        set(kind, false);
        response = then;
    }

    // Steps of the next `steps` in which the loop is engaged.
    int engaged_steps(int steps) {
        int engaged = 0;
        for (int i = 0; i < steps; ++i) {
            step();
            engaged += bench.engaged() ? 1 : 0;
        }
        return engaged;
    }

    // True if the demand is larger than that of a probing engagement.
    bool beyond_probing() const {
        const auto probing = static_cast<double>(LPVG_ECU_PROBE_SHARE) * static_cast<double>(bench.ecu.kept.u_max[0]);
        return std::fabs(static_cast<double>(bench.ecu.control.u[0])) > 1.001 * probing;
    }

    Bench bench;
    double response = 1.0;  // of the truck to the demand, over the healthy one
    std::function<double(double)> command = [](double t) { return sines(0.06, t); };  // yaw rate [rad/s] over time [s]
    static double sines(double amplitude_radps, double t) {
        return amplitude_radps * (std::sin(t) + std::sin(0.5 * t) + std::sin(2.0 * t));
    }
    const lpvguard_plant::Truth& truth() const { return plant_.truth(); }

private:
    static lpvguard_plant::Drive straight(double speed_mps) {
        lpvguard_plant::Drive drive;
        drive.speed_profile = {{0.0, speed_mps}};
        return drive;
    }

    void move() {
        for (int i = 0; i < lpvguard_plant::Plant::steps_per_sample; ++i) {
            plant_.step(response * static_cast<double>(bench.ecu.control.u[0]));
        }
    }

    void set(Release kind, bool lasts) {
        switch (kind) {
            case Release::vdc2_gap: bench.send_vdc2 = !lasts; break;
            case Release::guard_in_gap: bench.send_guard_in = !lasts; break;
            case Release::ebc2_gap: bench.send_ebc2 = !lasts; break;
            case Release::ebc1_gap: bench.send_ebc1 = !lasts; break;
            case Release::pedal: bench.pedal_percent = lasts ? 10.0F : 0.0F; break;
            case Release::abs: bench.abs_active = lasts ? 1U : 0U; break;
            case Release::request: bench.request = lasts ? LPVG_BUS_REQUEST_RELEASE : LPVG_BUS_REQUEST_CONTROL; break;
            case Release::priority: bench.other_priority = lasts ? 2U : 0U; break;
            case Release::asker: lpvg_ecu_engage(&bench.ecu, !lasts); break;
            default: break;
        }
    }

    lpvguard_plant::Plant plant_;
};
