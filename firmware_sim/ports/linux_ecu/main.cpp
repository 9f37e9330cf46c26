// main.cpp -- lpvguard_ecu: the ECU's firmware as a Linux process on a CAN interface, real or vcan.
//
//   lpvguard_ecu INTERFACE [--engage yes|no] [--reactions release|report] [--key test|none] [--time-line FD | --seconds S]
//
// --key none: commands need no authenticator, and every report says so (default: the simulator's key).
// Without --time-line, the program runs in real time until SIGINT, SIGTERM or S seconds, with a tick every sample period.
// With --time-line, it runs in simulated time. FD is one end of a socket pair (stream); the simulator has the other (time_line.h).
// The kernel passes frames with a rule of the supervision at any priority, authenticators, and error reports. At the end, the
// program writes the supervision's counters as JSON (reception.hpp).
#include <cerrno>
#include <csignal>
#include <cstdio>
#include <cstdlib>
#include <cstring>
#include <ctime>
#include <string>

#include <sys/socket.h>

#include "counted_bus.hpp"
#include "filter.h"
#include "lpvguard/bus.h"
#include "reception.hpp"
#include "telemetry.hpp"
#include "test_key.hpp"
#include "time_line.h"

namespace {

volatile std::sig_atomic_t g_stop = 0;

struct Options {
    const char* interface = nullptr;
    bool engage = true, report_only = false;
    const firmware_key_t* key = test_key();
    int time_line = -1;
    double seconds = 0.0;  // 0: until a signal
};

bool parse(int argc, char** argv, Options& options) {
    if (argc < 2 || argc % 2 != 0) {
        return false;
    }
    options.interface = argv[1];
    for (int i = 2; i < argc; i += 2) {
        const std::string name = argv[i], value = argv[i + 1];
        char* end = nullptr;
        if (name == "--engage" && (value == "yes" || value == "no")) {
            options.engage = value == "yes";
        } else if (name == "--reactions" && (value == "release" || value == "report")) {
            options.report_only = value == "report";
        } else if (name == "--key" && (value == "test" || value == "none")) {
            options.key = value == "test" ? test_key() : nullptr;
        } else if (name == "--time-line") {
            options.time_line = static_cast<int>(std::strtol(value.c_str(), &end, 10));
        } else if (name == "--seconds") {
            options.seconds = std::strtod(value.c_str(), &end);
        } else {
            return false;
        }
        if (end != nullptr && (*end != '\0' || end == value.c_str())) {
            return false;
        }
    }
    return true;
}

class Filters {
public:
    Filters() {
        for (; n_ < lpvg_bus.n_rules; ++n_) {
            list_[n_] = {lpvg_bus.rules[n_].id, lpvg_bus.rules[n_].id_mask};
        }
        list_[n_++] = {lpvg_bus.authenticator_id, FILTER_ANY_PRIORITY};
    }
    const socketcan_filter_t* list() const { return list_; }
    std::size_t size() const { return n_; }

private:
    socketcan_filter_t list_[LPVG_CAN_RULES_MAX + 1U];
    std::size_t n_ = 0;
};

std::string counters(const Reception& reception, const firmware_t& firmware) {
    char buffer[TIME_LINE_TEXT_MAX];
    Text text(buffer, sizeof buffer);
    reception.write(firmware, text.put('{'));
    text.put('}');
    return buffer;
}

int complain(const std::string& what) {
    std::fprintf(stderr, "lpvguard_ecu: %s\n", what.c_str());
    return 2;
}

int run_on_time_line(const Options& options, const lpvg_ecu_config_t& config) {
    CountedBus bus;
    firmware_t firmware{};
    Reception reception;
    Judgements judgements;
    Findings findings;
    if (!bus.open(options.interface, Filters().list(), Filters().size())) {
        return complain(std::string(options.interface) + ": " + std::strerror(bus.driver().error));
    }
    if (firmware_init(&firmware, bus.end(), &config, options.key, 0) != lpvg_status_ok) {
        return complain("the core refused its coefficients");
    }
    const auto send = [&](const void* data, std::size_t bytes) {
        return ::send(options.time_line, data, bytes, 0) == static_cast<ssize_t>(bytes);
    };
    time_request_t request{};
    time_answer_t answer{};
    // The first answer tells that the socket is open, so that later frames arrive.
    bool sent = send(&answer, sizeof answer);
    while (sent && ::recv(options.time_line, &request, sizeof request, MSG_WAITALL) == static_cast<ssize_t>(sizeof request) &&
           request.now_us >= 0) {
        bus.expect(request.frames);
        answer.status = static_cast<std::uint64_t>(firmware_tick(&firmware, request.now_us));
        answer.frames = bus.take_sent();
        firmware_idle(&firmware);
        answer.judged = judgements.note(firmware) ? 1U : 0U;
        answer.found = findings.note(firmware) ? 1U : 0U;
        reception.note(firmware.ecu.supervisor, request.now_us);
        sent = send(&answer, sizeof answer) && (answer.judged == 0U || send(&judgements.newest(), sizeof judgements.newest())) &&
               (answer.found == 0U || send(&findings.newest(), sizeof findings.newest()));
        if (request.supervision != 0U) {
            const Supervision supervision = supervision_of(firmware);
            sent = sent && send(&supervision, sizeof supervision);
        }
    }
    const std::string text = counters(reception, firmware);
    answer = {lpvg_status_ok, text.size(), 0U, 0U};
    return send(&answer, sizeof answer) && send(text.data(), text.size()) ? 0 : complain(std::strerror(errno));
}

int run_in_real_time(const Options& options, const lpvg_ecu_config_t& config) {
    socketcan_t driver{};
    bus_t bus{};
    if (!socketcan_open(&driver, options.interface, Filters().list(), Filters().size(), socketcan_time_arrival, &bus)) {
        return complain(std::string(options.interface) + ": " + std::strerror(driver.error));
    }
    firmware_t firmware{};
    Reception reception;
    const std::int64_t period_us = lpvg_coeff.words.sample_period_us;
    timespec next{};
    clock_gettime(CLOCK_MONOTONIC, &next);
    const auto micros = [](const timespec& t) { return static_cast<std::int64_t>(t.tv_sec) * 1'000'000 + t.tv_nsec / 1'000; };
    const std::int64_t start_us = micros(next);
    if (firmware_init(&firmware, &bus, &config, options.key, start_us) != lpvg_status_ok) {
        socketcan_close(&driver);
        return complain("the core refused its coefficients");
    }
    for (std::int64_t due_us = start_us;
         g_stop == 0 && (options.seconds <= 0.0 || static_cast<double>(due_us - start_us) < options.seconds * 1e6); due_us += period_us) {
        next = {static_cast<time_t>(due_us / 1'000'000), static_cast<long>(due_us % 1'000'000 * 1'000)};
        while (clock_nanosleep(CLOCK_MONOTONIC, TIMER_ABSTIME, &next, nullptr) == EINTR && g_stop == 0) {
        }
        timespec now{};
        clock_gettime(CLOCK_MONOTONIC, &now);
        (void)!firmware_tick(&firmware, micros(now));  // a tick directly after a late one is refused, because its time is too early
        firmware_idle(&firmware);
        reception.note(firmware.ecu.supervisor, micros(now) - start_us);
    }
    socketcan_close(&driver);
    std::printf("%s\n", counters(reception, firmware).c_str());
    return 0;
}

}  // namespace

int main(int argc, char** argv) {
    Options options;
    if (!parse(argc, argv, options)) {
        return complain(
            "usage: lpvguard_ecu INTERFACE [--engage yes|no] [--reactions release|report] [--key test|none] "
            "[--time-line FD | --seconds S]");
    }
    std::signal(SIGINT, [](int) { g_stop = 1; });
    std::signal(SIGTERM, [](int) { g_stop = 1; });
    lpvg_ecu_config_t config = firmware_config;
    config.engage = options.engage;
    config.report_only = options.report_only ? LPVG_ECU_CAUSES_OPTIONAL : config.report_only;
    return options.time_line >= 0 ? run_on_time_line(options, config) : run_in_real_time(options, config);
}
