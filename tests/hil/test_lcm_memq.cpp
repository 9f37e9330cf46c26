// The loop on LCM's memq://, in one process and without a network: what every channel carries, and what commands do.
#include "../catch.hpp"

#include <algorithm>
#include <cmath>
#include <cstdio>
#include <cstdlib>
#include <filesystem>
#include <fstream>
#include <functional>
#include <map>
#include <memory>
#include <sstream>
#include <string>
#include <utility>
#include <vector>

#include <lcm/lcm-cpp.hpp>

#include "control.hpp"
#include "loop.hpp"
#include "lpvguard_lcm/bus_t.hpp"
#include "lpvguard_lcm/control_t.hpp"
#include "lpvguard_lcm/guard_t.hpp"
#include "lpvguard_lcm/margin_t.hpp"
#include "lpvguard_lcm/status_t.hpp"
#include "lpvguard_lcm/supervision_t.hpp"
#include "lpvguard_lcm/truth_t.hpp"
#include "publisher_lcm.hpp"

namespace {

using namespace lpvguard_sim;
using Catch::Matchers::ContainsSubstring;
using lpvguard_lcm::control_t;
using lpvguard_lcm::status_t;

constexpr std::int64_t kTick = 10'000;  // of the truck
constexpr std::int64_t kSecond = 1'000'000;

constexpr const char* kSteady = R"(
title = "steady driving with a fault of its own"
duration_s = 24.0
seed = 5
[plant]
speed_profile = [[0.0, 15.0]]
[[plant.actuator_fault]]
start_s = 2.0
end_s = 3.0
brake_gain_ratio = 0.9
[[can_fault]]
message = "VDC2"
kind = "bus_off"
start_s = 4.0
end_s = 4.1
[command]
kind = "multisine"
spacing = "log"
low_radps = 0.5
high_radps = 4.0
rms_radps = 0.08
[expect]
verdict = "any"
supervision = "live"
)";

/// A file that is gone at the end.
class Scratch {
public:
    explicit Scratch(const std::string& text) : path_(std::filesystem::temp_directory_path() / "lpvguard_memq_XXXXXX") {
        const int file = mkstemp(path_.data());
        REQUIRE(file >= 0);
        std::ofstream(path_) << text;
    }
    ~Scratch() { std::filesystem::remove(path_); }
    Scratch(const Scratch&) = delete;
    Scratch& operator=(const Scratch&) = delete;
    const std::string& path() const { return path_; }

private:
    std::string path_;
};

/// Lines that were written to a stream in memory.
class Lines {
public:
    Lines() : file_(open_memstream(&text_, &bytes_)) {}
    ~Lines() {
        std::fclose(file_);
        std::free(text_);
    }
    Lines(const Lines&) = delete;
    Lines& operator=(const Lines&) = delete;
    std::FILE* file() { return file_; }
    std::vector<std::string> list() {
        std::fflush(file_);
        std::istringstream text(std::string(text_, bytes_));
        std::vector<std::string> lines;
        for (std::string line; std::getline(text, line);) {
            lines.push_back(line);
        }
        return lines;
    }

private:
    char* text_ = nullptr;
    std::size_t bytes_ = 0;
    std::FILE* file_;
};

/// A client in the simulator's process: keeps what it hears, and sends what its script says.
class Client {
public:
    explicit Client(std::shared_ptr<lcm::LCM> lcm) : lcm_(std::move(lcm)) {
        hear("LPVGUARD_TRUTH", truth);
        hear("LPVGUARD_GUARD", guard);
        hear("LPVGUARD_SUPERVISION", supervision);
        hear("LPVGUARD_BUS", bus);
        hear("LPVGUARD_MARGINS", margins);
        hear("LPVGUARD_STATUS", status);
    }

    /// When the truth of this time has come, or the first status that says paused after it.
    void at(std::int64_t utime, std::function<void()> act) { script_[utime] = std::move(act); }
    void when_paused(std::function<void()> act) { paused_.push_back(std::move(act)); }

    std::int64_t send(std::int8_t action, const std::string& entry = "", std::int32_t ticks = 0) {
        control_t command;
        command.id = ++id_;
        command.action = action;
        command.entry = entry;
        command.ticks = ticks;
        lcm_->publish("LPVGUARD_CONTROL", &command);
        return id_;
    }

    const status_t& answer(std::int64_t id) const {
        for (const status_t& said : status) {
            if (said.id == id) {
                return said;
            }
        }
        FAIL("no answer to command " << id);
        std::abort();
    }

    std::vector<lpvguard_lcm::truth_t> truth;
    std::vector<lpvguard_lcm::guard_t> guard;
    std::vector<lpvguard_lcm::supervision_t> supervision;
    std::vector<lpvguard_lcm::bus_t> bus;
    std::vector<lpvguard_lcm::margin_t> margins;
    std::vector<status_t> status;

private:
    template <class Message>
    void hear(const char* channel, std::vector<Message>& heard) {
        lcm_->subscribeFunction(
            channel,
            +[](const lcm::ReceiveBuffer*, const std::string&, const Message* message, std::pair<Client*, std::vector<Message>*> to) {
                to.second->push_back(*message);
                to.first->react(*message);
            },
            std::make_pair(this, &heard));
    }
    template <class Message>
    void react(const Message&) {}
    void react(const lpvguard_lcm::truth_t& t) {
        const auto due = script_.find(t.utime);
        if (due != script_.end()) {
            due->second();
        }
    }
    void react(const status_t& s) {
        if (s.state == +status_t::PAUSED && s.id == 0 && !paused_.empty()) {
            const auto act = paused_.front();
            paused_.erase(paused_.begin());
            act();
        }
    }

    std::shared_ptr<lcm::LCM> lcm_;
    std::map<std::int64_t, std::function<void()>> script_;
    std::vector<std::function<void()>> paused_;
    std::int64_t id_ = 100;
};

/// One run of a scenario with a client.
struct Session {
    explicit Session(const std::string& scenario_text = kSteady, bool paused = false)
        : file(scenario_text), scenario(file.path()), control(*publisher, scenario, paused), client(lcm) {}

    Session& run() {
        const Nodes nodes = open_nodes("memory", "", {});
        Loop loop(scenario.now(), lpvguard_plant::load_parameters(LPVGUARD_TRUCK_TOML), *nodes.bus, *nodes.ecu,
                  LoopEnds{log.file(), frames.file(), nullptr, nullptr, publisher.get(), &control});
        loop.run(0.0);
        static_cast<void>(publisher->take(0));  // what the last tick published
        sent = loop.watcher().count();
        hash = loop.watcher().hash();
        return *this;
    }

    Scratch file;
    std::shared_ptr<lcm::LCM> lcm = std::make_shared<lcm::LCM>("memq://");
    std::unique_ptr<Publisher> publisher = publisher_on(lcm);
    LiveScenario scenario;
    Control control;
    Client client;
    Lines log, frames;
    std::uint64_t sent = 0, hash = 0;
};

/// The same file run without anybody: count and hash of its frames.
std::pair<std::uint64_t, std::uint64_t> alone(const std::string& text) {
    const Scratch file(text);
    const LiveScenario scenario(file.path());
    const Nodes nodes = open_nodes("memory", "", {});
    Loop loop(scenario.now(), lpvguard_plant::load_parameters(LPVGUARD_TRUCK_TOML), *nodes.bus, *nodes.ecu, LoopEnds{});
    loop.run(0.0);
    return {loop.watcher().count(), loop.watcher().hash()};
}

std::string candump_line(const lpvguard_lcm::bus_t& b) {
    char text[64];
    int n = std::snprintf(text, sizeof text, "(%lld.%06lld) can0 %08X#", static_cast<long long>(b.utime / kSecond),
                          static_cast<long long>(b.utime % kSecond), static_cast<unsigned>(b.id) | (b.error ? 0x20000000U : 0U));
    for (int i = 0; i < b.dlc; ++i) {
        n += std::snprintf(text + n, sizeof text - static_cast<std::size_t>(n), "%02X", b.data[i]);
    }
    return text;
}

}  // namespace

TEST_CASE("every channel carries what the run writes to its files", "[hil][lcm]") {
    Session session;
    const Client& heard = session.run().client;
    constexpr std::size_t ticks = 2400;
    REQUIRE(heard.truth.size() == ticks);
    REQUIRE(heard.guard.size() == ticks);
    REQUIRE(heard.supervision.size() == ticks / 10);
    for (std::size_t k = 0; k < ticks; ++k) {
        REQUIRE(heard.truth[k].utime == static_cast<std::int64_t>(k) * kTick);
        REQUIRE(heard.guard[k].utime == heard.truth[k].utime);
    }
    CHECK(heard.guard.back().supervision == 2);

    const std::vector<std::string> log = session.log.list();
    REQUIRE(log.size() == session.sent);
    REQUIRE(heard.bus.size() == session.sent);
    std::size_t reports = 0;
    for (std::size_t i = 0; i < log.size(); ++i) {
        REQUIRE(heard.bus[i].sequence == static_cast<std::int64_t>(i));
        REQUIRE(candump_line(heard.bus[i]) == log[i]);
        REQUIRE(heard.bus[i].extended != heard.bus[i].error);
        reports += heard.bus[i].error ? 1U : 0U;
    }
    CHECK(reports == 1);  // bus-off
    CHECK(heard.supervision.back().other[lpvg_can_event_bus_off] == 1);

    const std::vector<std::string> frames = session.frames.list();
    REQUIRE(frames.size() == heard.margins.size() + 1);  // and the header
    std::size_t counted = 0;
    for (std::size_t i = 0; i < heard.margins.size(); ++i) {
        const lpvguard_lcm::margin_t& m = heard.margins[i];
        double row[11];
        REQUIRE(std::sscanf(frames[i + 1].c_str(), "%lf,%lf,%lf,%lf,%lf,%lf,%lf,%lf,%lf,%lf,%lf", row, row + 1, row + 2, row + 3, row + 4,
                            row + 5, row + 6, row + 7, row + 8, row + 9, row + 10) == 11);
        const double said[] = {static_cast<double>(m.end_utime) * 1e-6,
                               static_cast<double>(m.begin_utime) * 1e-6,
                               static_cast<double>(m.bin),
                               static_cast<double>(m.reason),
                               m.falsified ? 1.0 : 0.0,
                               m.speed,
                               m.margin,
                               m.statistic,
                               m.evidence,
                               m.energy_ratio,
                               m.change_ratio};
        for (std::size_t j = 0; j < 11; ++j) {
            REQUIRE(said[j] == Approx(row[j]).epsilon(1e-8));
        }
        REQUIRE((m.utime >= m.end_utime && m.utime <= m.end_utime + LPVG_NLATENCY * kTick));
        REQUIRE((m.bin >= 0 && m.bin < m.bins && m.bins == LPVG_NBINS));
        const double cycles = m.frequency * static_cast<double>(m.end_utime - m.begin_utime) * 1e-6 / 6.283185307179586;
        REQUIRE(cycles == Approx(std::round(cycles)).margin(1e-9));
        REQUIRE(m.threshold > 0.0);
        REQUIRE(m.energy_threshold >= 1.0);
        REQUIRE(m.change_threshold > 0.0);  // may be below 1 (THEORY 7.7)
        counted += m.reason <= 1 ? 1U : 0U;
    }
    CHECK(counted > 5);

    CHECK(heard.status.front().state == +status_t::RUNNING);
    CHECK(heard.status.back().state == +status_t::ENDED);
    CHECK(heard.status.back().utime == 24 * kSecond);
    CHECK(alone(kSteady) == std::make_pair(session.sent, session.hash));
}

TEST_CASE("what clients change acts from the tick that the answer says, and the applied scenario gives the same run", "[hil][lcm]") {
    Session session(kSteady, true);
    Client& client = session.client;
    std::map<std::string, std::int64_t> id;
    client.when_paused([&] { id["resume"] = client.send(control_t::RESUME); });
    client.at(2 * kSecond + kSecond / 2, [&] { id["own"] = client.send(control_t::CLEAR, "plant.actuator_fault[0]"); });
    client.at(6 * kSecond, [&] { id["lost"] = client.send(control_t::INJECT, "[[can_fault]]\nmessage = \"VDC2\"\nkind = \"lost\""); });
    client.at(7 * kSecond, [&] { id["found"] = client.send(control_t::CLEAR, "can_fault[1]"); });
    client.at(9 * kSecond, [&] {
        id["gain"] = client.send(control_t::INJECT, "plant.sensor_fault = [{signal = \"yaw_rate\", gain = -1.0, end_s = 12.0}]");
        id["friction"] = client.send(control_t::INJECT, "[[plant.surroundings_fault]]\nfriction_left_ratio = 0.8");
        id["repeated"] = client.send(control_t::INJECT, "[[can_fault]]\nmessage = \"GUARD_IN\"\nkind = \"repeated\"\nprobability = 0.05");
    });
    client.at(14 * kSecond,
              [&] { id["slower"] = client.send(control_t::INJECT, "[[plant.speed_change]]\nspeed_mps = 12.5\nrate_mps2 = 2.0"); });
    client.at(17 * kSecond, [&] { id["pause"] = client.send(control_t::PAUSE); });
    client.when_paused([&] { id["step"] = client.send(control_t::STEP, "", 7); });
    client.when_paused([&] { id["go"] = client.send(control_t::RESUME); });
    client.at(20 * kSecond, [&] { id["stop"] = client.send(control_t::STOP); });
    session.run();

    CHECK(client.status.front().state == +status_t::PAUSED);
    for (const auto& [name, number] : id) {
        INFO(name << ": " << client.answer(number).reason);
        CHECK(client.answer(number).accepted);
    }
    CHECK(client.answer(id["own"]).entry == "plant.actuator_fault[0]");
    CHECK(client.answer(id["lost"]).entry == "can_fault[1]");
    CHECK(client.answer(id["gain"]).entry == "plant.sensor_fault[0]");
    CHECK(client.answer(id["repeated"]).entry == "can_fault[2]");

    // Taken before the tick after the one whose truth it was sent at, acts from the next.
    const std::int64_t lost = client.answer(id["lost"]).utime, found = client.answer(id["found"]).utime;
    CHECK(lost == 6 * kSecond + 2 * kTick);
    std::vector<std::int64_t> vdc2;
    for (const auto& b : client.bus) {
        if ((b.id & 0x00FFFFFF) == (LPVG_CAN_VDC2_ID & 0x00FFFFFFU)) {
            vdc2.push_back(b.utime);
        }
    }
    const auto sent_at = [&](std::int64_t utime) { return std::count(vdc2.begin(), vdc2.end(), utime) == 1; };
    CHECK((sent_at(lost - kTick) && !sent_at(lost) && !sent_at(found - kTick) && sent_at(found)));
    const auto guard = [&](std::int64_t utime) { return client.guard[static_cast<std::size_t>(utime / kTick)]; };
    CHECK((guard(lost).supervision == 2 && guard(lost + 5 * kTick).supervision != 2 && guard(found + kSecond).supervision == 2));

    const auto speed = [&](std::int64_t utime) { return client.truth[static_cast<std::size_t>(utime / kTick)].speed; };
    const std::int64_t slower = client.answer(id["slower"]).utime;
    CHECK(speed(slower) == 15.0);
    CHECK(speed(slower + kSecond) == Approx(13.0).epsilon(1e-9));
    CHECK(speed(slower + 2 * kSecond) == Approx(12.5).epsilon(1e-12));

    const std::int64_t pause = client.answer(id["pause"]).utime;
    CHECK((client.answer(id["step"]).utime == pause && client.answer(id["go"]).utime == pause + 7 * kTick));
    CHECK(client.status.back().state == +status_t::ENDED);
    CHECK(client.status.back().utime == client.answer(id["stop"]).utime);
    CHECK(client.truth.back().utime == client.answer(id["stop"]).utime - kTick);

    const auto again = alone(session.scenario.text());
    CHECK(again.first == session.sent);
    CHECK(again.second == session.hash);
    CHECK(alone(kSteady).second != session.hash);
}

TEST_CASE("bad commands are refused with the reason and change nothing", "[hil][lcm]") {
    struct Bad {
        std::int8_t action;
        const char* entry;
        std::int32_t ticks;
        const char* reason;
    };
    const Bad bad[] = {
        {9, "", 0, "action = 9: expected 0 .. 5"},
        {-1, "", 0, "action = -1: expected 0 .. 5"},
        {control_t::STEP, "", 0, "ticks = 0: expected 1 .. 1000000"},
        {control_t::STOP, "", 0, "duration_s = 0.51: expected 1 .. 1000000"},
        {control_t::INJECT, "", 0, "expected one entry of one of: [[can_fault]]"},
        {control_t::INJECT, "duration_s = 3.0", 0, "expected one entry of one of"},
        {control_t::INJECT, "plant.speed_profile = [[0.0, 3.0]]", 0, "expected one entry of one of"},
        {control_t::INJECT, "plant.speed_change = [{speed_mps = 12.0}]\nseed = 2", 0, "expected one entry of one of"},
        {control_t::INJECT, "plant.speed_change = [{speed_mps = 12.0}]\nplant.speed_is_free = true", 0, "expected one entry of one of"},
        {control_t::INJECT, "plant.speed_change = [{speed_mps = 12.0}, {speed_mps = 13.0}]", 0, "expected one entry of one of"},
        {control_t::INJECT, "plant.speed_change = [12.0]", 0, "expected one entry of one of"},
        {control_t::INJECT, "plant.speed_change = [{rate_mps2 = 1.0}]", 0, "plant.speed_change.speed_mps: missing"},
        {control_t::INJECT, "plant.speed_change = [{speed_mps = 31.0}]", 0, "plant.speed_change.speed_mps = 31: expected 3 .. 30"},
        {control_t::INJECT, "plant.sensor_fault = [{signal = \"yaw\"}]", 0,
         "plant.sensor_fault.signal = \"yaw\": expected one of: yaw_rate"},
        {control_t::INJECT, "plant.sensor_fault = [{signal = \"yaw_rate\", start_s = 0.0}]", 0,
         "plant.sensor_fault.start_s: not to be given"},
        {control_t::INJECT, "plant.sensor_fault = [{signal = \"yaw_rate\", end_s = 0.4}]", 0, "plant.sensor_fault.end_s: expected later"},
        {control_t::INJECT, "plant.actuator_fault = [{extra_delay_s = 1.99}]", 0, "at most 2 s of brake delay in total"},
        {control_t::INJECT, "can_fault = [{message = \"VDC2\", kind = \"gone\"}]", 0, "can_fault.kind = \"gone\": expected one of: lost"},
        {control_t::INJECT, "can_fault = ", 0, "command:1"},
        {control_t::CLEAR, "", 0, "'': no such fault"},
        {control_t::CLEAR, "plant", 0, "'plant': no such fault"},
        {control_t::CLEAR, "plant.speed_profile[0]", 0, "no such fault"},
        {control_t::CLEAR, "can_fault[x", 0, "no such fault"},
        {control_t::CLEAR, "can_fault[1]", 0, "no such fault"},
        {control_t::CLEAR, "can_fault[0]", 0, "can_fault[0]: is not active, it begins at 4 s"},
    };
    Session session;
    Client& client = session.client;
    std::vector<std::int64_t> ids;
    client.at(kSecond / 2, [&] {
        for (const Bad& b : bad) {
            ids.push_back(client.send(b.action, b.entry, b.ticks));
        }
    });
    std::int64_t late = 0;
    client.at(5 * kSecond, [&] { late = client.send(control_t::CLEAR, "plant.actuator_fault[0]"); });
    const std::string before = session.scenario.text();
    session.run();
    REQUIRE(ids.size() == std::size(bad));
    for (std::size_t i = 0; i < ids.size(); ++i) {
        INFO(bad[i].entry);
        CHECK_FALSE(client.answer(ids[i]).accepted);
        CHECK_THAT(client.answer(ids[i]).reason, ContainsSubstring(bad[i].reason));
        CHECK(client.answer(ids[i]).utime == kSecond / 2 + kTick);
    }
    CHECK_THAT(client.answer(late).reason, ContainsSubstring("is not active, it ends at 3 s"));
    CHECK(session.scenario.text() == before);
    CHECK(alone(kSteady) == std::make_pair(session.sent, session.hash));
}
