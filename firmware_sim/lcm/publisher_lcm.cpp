// The publisher of a simulator with LCM (CMake: LPVG_BUILD_LCM).
#include "publisher_lcm.hpp"

#include <algorithm>
#include <iterator>
#include <stdexcept>
#include <utility>

#include "arguments.hpp"
#include "lpvguard/coeff.h"
#include "lpvguard_lcm/bus_t.hpp"
#include "lpvguard_lcm/cause_t.hpp"
#include "lpvguard_lcm/control_t.hpp"
#include "lpvguard_lcm/guard_t.hpp"
#include "lpvguard_lcm/margin_t.hpp"
#include "lpvguard_lcm/status_t.hpp"
#include "lpvguard_lcm/supervision_t.hpp"
#include "lpvguard_lcm/truth_t.hpp"

namespace lpvguard_sim {
namespace {

static_assert(ControlCommand::pause == lpvguard_lcm::control_t::PAUSE && ControlCommand::resume == lpvguard_lcm::control_t::RESUME &&
                  ControlCommand::step == lpvguard_lcm::control_t::STEP && ControlCommand::stop == lpvguard_lcm::control_t::STOP &&
                  ControlCommand::inject == lpvguard_lcm::control_t::INJECT && ControlCommand::clear == lpvguard_lcm::control_t::CLEAR,
              "as in lpvguard_control.lcm");
static_assert(Status::running == lpvguard_lcm::status_t::RUNNING && Status::paused == lpvguard_lcm::status_t::PAUSED &&
                  Status::ended == lpvguard_lcm::status_t::ENDED,
              "as in lpvguard_status.lcm");
static_assert(sizeof(lpvguard_lcm::supervision_t::other) / sizeof(std::int64_t) == lpvg_can_event_count &&
                  sizeof(lpvguard_lcm::watch_t::count) / sizeof(std::int64_t) == lpvg_can_event_count,
              "as in lpvguard_supervision.lcm");

class LcmPublisher final : public Publisher {
public:
    explicit LcmPublisher(std::shared_ptr<lcm::LCM> lcm)
        : lcm_(std::move(lcm)), subscription_(lcm_->subscribe("LPVGUARD_CONTROL", &LcmPublisher::hear, this)) {
        if (subscription_ == nullptr) {
            throw std::runtime_error("LCM: LPVGUARD_CONTROL cannot be subscribed to");
        }
    }
    ~LcmPublisher() override { lcm_->unsubscribe(subscription_); }
    LcmPublisher(const LcmPublisher&) = delete;
    LcmPublisher& operator=(const LcmPublisher&) = delete;

    void publish(std::int64_t now_us, const lpvguard_plant::Truth& truth) override {
        lpvguard_lcm::truth_t t;
        t.utime = now_us;
        t.speed = truth.speed_mps;
        t.yaw_rate = truth.yaw_rate_radps;
        t.road_wheel_angle = truth.road_wheel_rad;
        t.lateral_acceleration = truth.lateral_acceleration_mps2;
        t.roll = truth.roll_rad;
        t.bank = truth.bank_rad;
        t.pressure_left = truth.pressure_left_bar;
        t.pressure_right = truth.pressure_right_bar;
        lcm_->publish("LPVGUARD_TRUTH", &t);
    }

    void publish(std::int64_t now_us, const GuardTelemetry& guard) override {
        lpvguard_lcm::guard_t g;
        g.utime = now_us;
        g.command = guard.command_radps;
        g.wanted = guard.wanted_radps;
        g.demand = guard.demand_bar;
        g.statistic = guard.statistic;
        g.verdict = static_cast<std::int8_t>(guard.verdict);
        g.supervision = static_cast<std::int8_t>(guard.supervision);
        lcm_->publish("LPVGUARD_GUARD", &g);
    }

    void publish(std::int64_t now_us, const Supervision& supervision, const TroubleCode& trouble) override {
        lpvguard_lcm::supervision_t s;
        s.utime = now_us;
        s.bus_off = supervision.bus_off != 0U;
        std::copy(std::begin(supervision.other), std::end(supervision.other), s.other);
        s.messages = static_cast<std::int32_t>(supervision.messages);
        for (std::size_t i = 0; i < supervision.messages; ++i) {
            const Supervision::Watch& from = supervision.watch[i];
            lpvguard_lcm::watch_t to;
            to.id = static_cast<std::int32_t>(from.id);
            to.state = static_cast<std::int8_t>(from.state);
            to.score = static_cast<std::int8_t>(from.score);
            to.missed = from.missed;
            std::copy(std::begin(from.count), std::end(from.count), to.count);
            s.watch.push_back(to);
        }
        s.trouble_spn = static_cast<std::int32_t>(trouble.spn);
        s.trouble_fmi = static_cast<std::int8_t>(trouble.fmi);
        lcm_->publish("LPVGUARD_SUPERVISION", &s);
    }

    void publish(const lpvg_can_frame_t& frame) override {
        lpvguard_lcm::bus_t b{};
        b.utime = frame.t_us;
        b.sequence = frames_++;
        b.id = static_cast<std::int32_t>(frame.id & 0x1FFFFFFFU);
        b.extended = (frame.id & LPVG_CAN_EXTENDED) != 0U;
        b.error = (frame.id & LPVG_CAN_ERROR) != 0U;
        b.dlc = static_cast<std::int8_t>(frame.dlc);
        std::copy_n(std::begin(frame.data), std::min<std::size_t>(frame.dlc, sizeof b.data), std::begin(b.data));
        lcm_->publish("LPVGUARD_BUS", &b);
    }

    void publish(const JudgedFrame& frame) override {
        lpvguard_lcm::margin_t m;
        m.utime = frame.now_us;
        m.begin_utime = frame.begin_us;
        m.end_utime = frame.judged.t_end_us;
        m.bins = LPVG_NBINS;
        m.bin = static_cast<std::int32_t>(frame.judged.bin);
        m.frequency = frame.frequency_radps;
        m.reason = static_cast<std::int8_t>(frame.judged.reason);
        m.speed = frame.judged.speed_mps;
        m.margin = frame.judged.margin;
        m.statistic = frame.judged.statistic;
        m.evidence = frame.judged.evidence;
        m.falsified = frame.judged.falsified != 0U;
        m.threshold = static_cast<double>(lpvg_coeff.reals.threshold);
        m.energy_ratio = frame.judged.energy_ratio;
        m.energy_threshold = static_cast<double>(lpvg_coeff.reals.energy_threshold);
        m.change_ratio = frame.judged.change_ratio;
        m.change_threshold = static_cast<double>(lpvg_coeff.reals.change_threshold);
        m.verdict = static_cast<std::int8_t>(frame.verdict);
        lcm_->publish("LPVGUARD_MARGINS", &m);
    }

    void publish(std::int64_t now_us, const Found& found) override {
        lpvguard_lcm::cause_t c;
        c.utime = now_us;
        c.alarm_utime = found.t_alarm_us;
        c.onset_utime = found.t_onset_us;
        c.before = found.before != 0U;
        c.output = static_cast<std::int32_t>(found.output);
        c.cause = static_cast<std::int8_t>(found.cause);
        c.value = found.value;
        c.low = found.low;
        c.high = found.high;
        lcm_->publish("LPVGUARD_CAUSES", &c);
    }

    void publish(const Status& status) override {
        lpvguard_lcm::status_t s;
        s.utime = status.now_us;
        s.state = status.state;
        s.id = status.id;
        s.accepted = status.accepted;
        s.entry = status.entry;
        s.reason = status.reason;
        lcm_->publish("LPVGUARD_STATUS", &s);
    }

    std::vector<ControlCommand> take(int wait_ms) override {
        int handled = lcm_->handleTimeout(wait_ms);
        while (handled > 0) {
            handled = lcm_->handleTimeout(0);
        }
        if (handled < 0) {
            throw std::runtime_error("LCM: receiving failed");
        }
        return std::exchange(heard_, {});
    }

private:
    void hear(const lcm::ReceiveBuffer*, const std::string&, const lpvguard_lcm::control_t* c) {
        heard_.push_back({c->id, c->action, c->ticks, c->entry});
    }

    std::shared_ptr<lcm::LCM> lcm_;
    lcm::Subscription* subscription_;
    std::vector<ControlCommand> heard_;
    std::int64_t frames_ = 0;
};

}  // namespace

std::unique_ptr<Publisher> publisher_on(std::shared_ptr<lcm::LCM> lcm) { return std::make_unique<LcmPublisher>(std::move(lcm)); }

std::unique_ptr<Publisher> open_publisher(const std::string& url) {
    auto lcm = std::make_shared<lcm::LCM>(url);
    if (!lcm->good()) {
        throw lpvguard_plant::UsageError("--lcm '" + url + "': cannot be opened");
    }
    return publisher_on(std::move(lcm));
}

}  // namespace lpvguard_sim
