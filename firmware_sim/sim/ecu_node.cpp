#include "ecu_node.hpp"

#include <algorithm>
#include <array>
#include <cerrno>
#include <csignal>
#include <cstring>
#include <stdexcept>
#include <vector>

#include <spawn.h>
#include <sys/socket.h>
#include <sys/wait.h>
#include <unistd.h>

#include "arguments.hpp"
#include "counted_bus.hpp"
#include "filter.h"
#include "lpvg_can_codec.h"
#include "memory_bus.hpp"
#include "reception.hpp"
#include "socketcan_bus.hpp"
#include "test_key.hpp"
#include "time_line.h"

namespace lpvguard_sim {
namespace {

using lpvguard_plant::UsageError;

class LocalEcu final : public EcuNode {
public:
    LocalEcu(const bus_t* bus, const EcuOptions& options) {
        lpvg_ecu_config_t config = firmware_config;
        config.engage = options.engage;
        config.report_only = options.report_only ? LPVG_ECU_CAUSES_OPTIONAL : config.report_only;
        if (firmware_init(&firmware_, bus, &config, test_key(), 0) != lpvg_status_ok) {
            throw UsageError("the core refused its coefficients");
        }
    }

    void tick(std::int64_t now_us, bool supervision) override {
        if (firmware_tick(&firmware_, now_us) != lpvg_status_ok) {
            throw std::logic_error("the firmware refused a tick");
        }
        firmware_idle(&firmware_);
        reception_.note(firmware_.ecu.supervisor, now_us);
        has_judged_ = judgements_.note(firmware_);
        if (has_judged_) {
            judged_ = judgements_.newest();
        }
        has_found_ = findings_.note(firmware_);
        if (has_found_) {
            std::copy(std::begin(findings_.newest()), std::end(findings_.newest()), found_);
        }
        if (supervision) {
            supervision_ = supervision_of(firmware_);
        }
    }
    const lpvg_ecu_t* inside() const override { return &firmware_.ecu; }
    std::string finish() override {
        std::array<char, TIME_LINE_TEXT_MAX> buffer;
        Text text(buffer.data(), buffer.size());
        reception_.write(firmware_, text.put('{'));
        text.put('}');
        return buffer.data();
    }

private:
    firmware_t firmware_{};
    Reception reception_;
    Judgements judgements_;
    Findings findings_;
};

/// The vehicle's end of a CAN interface whose other end is another process.
class RemoteBus final : public LoopBus {
public:
    explicit RemoteBus(const std::string& interface) {
        constexpr std::uint32_t any_priority = ~0x1C000000U, dm1_id = LPVG_CAN_EXTENDED | 0x18FECA00U;
        const std::array<socketcan_filter_t, 2> from_ecu = {
            {{LPVG_CAN_GUARD_OUT_ID, any_priority}, {dm1_id | lpvg_bus.own_address, any_priority}}};
        if (!bus_.open(interface.c_str(), from_ecu.data(), from_ecu.size())) {
            throw UsageError("--bus socketcan:" + interface + ": " + std::strerror(bus_.driver().error));
        }
        ends_[vehicle] = {this, &RemoteBus::send, &RemoteBus::receive};
    }

    CountedBus& counted() { return bus_; }

private:
    static bool send(void* self, const lpvg_can_frame_t* frame) {
        auto& bus = *static_cast<RemoteBus*>(self);
        bus.pass(*frame);
        if (!bus_send(bus.bus_.end(), frame)) {
            bus.failure_ = std::string("the CAN interface took no frame: ") + std::strerror(bus.bus_.driver().error);
            return false;
        }
        return true;
    }
    static bool receive(void* self, std::int64_t now_us, lpvg_can_frame_t* frame) {
        auto& bus = *static_cast<RemoteBus*>(self);
        if (!bus_receive(bus.bus_.end(), now_us, frame)) {
            if (bus.bus_.waited_in_vain()) {
                bus.failure_ = "a frame that the ECU sent did not come through the CAN interface";
            }
            return false;
        }
        bus.pass(*frame);
        return true;
    }

    CountedBus bus_{&filter_passes};
};

class RemoteEcu final : public EcuNode {
public:
    RemoteEcu(const std::string& program, const std::string& interface, const EcuOptions& options, CountedBus& bus) : bus_(bus) {
        int pair[2];
        if (::socketpair(AF_UNIX, SOCK_STREAM | SOCK_CLOEXEC, 0, pair) != 0) {
            throw std::runtime_error(std::string("socketpair: ") + std::strerror(errno));
        }
        line_ = pair[0];
        constexpr int line_of_child = 3;
        posix_spawn_file_actions_t actions;
        posix_spawn_file_actions_init(&actions);
        posix_spawn_file_actions_adddup2(&actions, pair[1], line_of_child);  // without close-on-exec even if both numbers are the same
        std::vector<std::string> words = {
            program, interface, "--engage", options.engage ? "yes" : "no", "--time-line", std::to_string(line_of_child)};
        if (options.report_only) {
            words.insert(words.end(), {"--reactions", "report"});
        }
        std::vector<char*> argv;
        for (std::string& word : words) {
            argv.push_back(word.data());
        }
        argv.push_back(nullptr);
        const int failed = ::posix_spawn(&child_, program.c_str(), &actions, nullptr, argv.data(), environ);
        posix_spawn_file_actions_destroy(&actions);
        ::close(pair[1]);
        if (failed != 0) {
            child_ = 0;
            throw UsageError("--ecu " + program + ": " + std::strerror(failed));
        }
        static_cast<void>(answer());
    }
    ~RemoteEcu() override {
        ::close(line_);
        if (child_ > 0) {
            ::kill(child_, SIGTERM);
            ::waitpid(child_, nullptr, 0);
        }
    }

    void tick(std::int64_t now_us, bool supervision) override {
        ask(now_us, supervision);
        const time_answer_t got = answer();
        bus_.expect(got.frames);
        has_judged_ = got.judged != 0U;
        if (has_judged_) {
            receive(&judged_, sizeof judged_);
        }
        has_found_ = got.found != 0U;
        if (has_found_) {
            receive(found_, sizeof found_);
        }
        if (supervision) {
            receive(&supervision_, sizeof supervision_);
        }
    }
    const lpvg_ecu_t* inside() const override { return nullptr; }
    std::string finish() override {
        ask(-1, false);
        std::string text(std::min<std::size_t>(answer().frames, TIME_LINE_TEXT_MAX), '\0');
        receive(text.data(), text.size());
        return text;
    }

private:
    void ask(std::int64_t now_us, bool supervision) {
        const time_request_t request = {now_us, bus_.take_sent(), supervision ? 1U : 0U};
        if (::send(line_, &request, sizeof request, MSG_NOSIGNAL) != static_cast<ssize_t>(sizeof request)) {
            throw std::runtime_error("the ECU's process has ended");
        }
    }
    void receive(void* data, std::size_t bytes) {
        if (::recv(line_, data, bytes, MSG_WAITALL) != static_cast<ssize_t>(bytes)) {
            throw std::runtime_error("the ECU's process has ended");
        }
    }
    time_answer_t answer() {
        time_answer_t got{};
        receive(&got, sizeof got);
        if (got.status != static_cast<std::uint64_t>(lpvg_status_ok)) {
            throw std::logic_error("the firmware refused a tick");
        }
        return got;
    }

    CountedBus& bus_;
    int line_ = -1;
    pid_t child_ = 0;
};

}  // namespace

Nodes open_nodes(const std::string& bus, const std::string& program, const EcuOptions& options) {
    Nodes nodes;
    if (!program.empty()) {
        const std::string interface = socketcan_interface(bus);
        auto remote = std::make_unique<RemoteBus>(interface);
        nodes.ecu = std::make_unique<RemoteEcu>(program, interface, options, remote->counted());
        nodes.bus = std::move(remote);
        return nodes;
    }
    if (bus == "memory") {
        nodes.bus = std::make_unique<MemoryBus>();
    } else {
        nodes.bus = std::make_unique<SocketCanBus>(socketcan_interface(bus));
    }
    nodes.ecu = std::make_unique<LocalEcu>(nodes.bus->end(LoopBus::ecu), options);
    return nodes;
}

}  // namespace lpvguard_sim
