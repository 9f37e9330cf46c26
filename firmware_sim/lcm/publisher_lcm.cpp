// The simulator with LCM (CMake: LPVG_BUILD_LCM).
#include <algorithm>
#include <iterator>

#include <lcm/lcm-cpp.hpp>

#include "arguments.hpp"
#include "lpvguard/guard_t.hpp"
#include "lpvguard/supervision_t.hpp"
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

    void publish(std::int64_t now_us, const lpvg_can_supervisor_t& supervisor, const TroubleCode& trouble) override {
        static_assert(sizeof(lpvguard::supervision_t::other) / sizeof(std::int64_t) == lpvg_can_event_count, "as in lpvguard_supervision.lcm");
        lpvguard::supervision_t s;
        s.utime = now_us;
        s.bus_off = supervisor.bus_off != 0U;
        std::copy(std::begin(supervisor.count), std::end(supervisor.count), s.other);
        s.messages = supervisor.n_rules;
        for (std::size_t i = 0; i < supervisor.n_rules; ++i) {
            const lpvg_can_watch_t& from = supervisor.watch[i];
            lpvguard::watch_t to;
            to.id = static_cast<std::int32_t>(supervisor.rules[i].id & 0x1FFFFFFFU);
            to.state = static_cast<std::int8_t>(from.state);
            to.score = static_cast<std::int8_t>(from.score);
            to.missed = from.missed;
            std::copy(std::begin(from.count), std::end(from.count), to.count);
            s.watch.push_back(to);
        }
        s.trouble_spn = static_cast<std::int32_t>(trouble.spn);
        s.trouble_fmi = static_cast<std::int8_t>(trouble.fmi);
        lcm_.publish("LPVGUARD_SUPERVISION", &s);
    }

private:
    lcm::LCM lcm_;
};

}  // namespace

std::unique_ptr<Publisher> open_publisher(const std::string& url) {
    return std::make_unique<LcmPublisher>(url);
}

}  // namespace lpvguard_sim
