// The simulator with LCM (CMake: LPVG_BUILD_LCM).
#include <lcm/lcm-cpp.hpp>

#include "arguments.hpp"
#include "lpvguard/guard_t.hpp"
#include "lpvguard/truth_t.hpp"
#include "publisher.hpp"

namespace lpvguard_sim {
namespace {

class LcmPublisher final : public Publisher {
public:
    explicit LcmPublisher(const std::string& url) : lcm_(url) {
        if (!lcm_.good()) {
            throw lpvguard_plant::UsageError("--lcm '" + url + "': cannot be opened");
        }
    }

    void publish(std::int64_t now_us, const lpvguard_plant::Truth& truth, const GuardTelemetry& guard) override {
        lpvguard::truth_t t;
        t.utime = now_us;
        t.speed = truth.speed_mps;
        t.yaw_rate = truth.yaw_rate_radps;
        t.road_wheel_angle = truth.road_wheel_rad;
        t.lateral_acceleration = truth.lateral_acceleration_mps2;
        t.roll = truth.roll_rad;
        t.bank = truth.bank_rad;
        t.pressure_left = truth.pressure_left_bar;
        t.pressure_right = truth.pressure_right_bar;
        lcm_.publish("LPVGUARD_TRUTH", &t);
        lpvguard::guard_t g;
        g.utime = now_us;
        g.command = guard.command_radps;
        g.wanted = guard.wanted_radps;
        g.demand = guard.demand_bar;
        g.margin = guard.margin;
        g.verdict = static_cast<std::int8_t>(guard.verdict);
        g.supervision = static_cast<std::int8_t>(guard.supervision);
        lcm_.publish("LPVGUARD_GUARD", &g);
    }

private:
    lcm::LCM lcm_;
};

}  // namespace

std::unique_ptr<Publisher> open_publisher(const std::string& url) {
    return std::make_unique<LcmPublisher>(url);
}

}  // namespace lpvguard_sim
