// SocketCAN as the firmware's bus, on a real vcan0: run through tools/with-vcan. Fails, and is never skipped, without one.
#include "../catch.hpp"

#include <array>
#include <atomic>
#include <cerrno>
#include <chrono>
#include <cstdlib>
#include <cstring>
#include <string>
#include <thread>

#include "../../firmware_sim/ports/linux/socketcan.h"
#include "../can_bus.hpp"

namespace {

// A socket and its bus, closed at the end of the test.
struct Node {
    Node() = default;
    Node(const Node&) = delete;
    Node& operator=(const Node&) = delete;
    ~Node() { socketcan_close(&driver); }

    bool open(const socketcan_filter_t* filters = nullptr, size_t n = 0, socketcan_time_t time = socketcan_time_arrival) {
        socketcan_close(&driver);
        return socketcan_open(&driver, "vcan0", filters, n, time, &bus);
    }
    bool send(const lpvg_can_frame_t& frame) { return bus_send(&bus, &frame); }
    bool receive(lpvg_can_frame_t& frame, int64_t now = 0) { return bus_receive(&bus, now, &frame); }

    socketcan_t driver = closed();
    bus_t bus{};

private:
    static socketcan_t closed() {
        socketcan_t driver{};
        driver.socket = -1;
        return driver;
    }
};

lpvg_can_frame_t frame_of(uint32_t id, uint8_t first) {
    lpvg_can_frame_t frame{};
    frame.id = id;
    frame.dlc = 8U;
    frame.data[0] = first;
    return frame;
}

socketcan_filter_t filter_of(uint8_t index) { return {lpvg_can_rules[index].id, lpvg_can_rules[index].id_mask}; }

const std::array<socketcan_filter_t, 2> kOurs = {filter_of(LPVG_CAN_VDC2_INDEX), filter_of(LPVG_CAN_GUARD_IN_INDEX)};

int64_t now_us() {
    return std::chrono::duration_cast<std::chrono::microseconds>(std::chrono::steady_clock::now().time_since_epoch()).count();
}

// A sender of good EBC2 frames and a supervised receiver, on a clock of their own: it goes on by 1 ms with each turn, which lasts no less,
// so a busy machine stretches time and makes nothing late.
class Ebc2Link {
public:
    static constexpr uint8_t kIndex = LPVG_CAN_EBC2_INDEX;

    Ebc2Link() {
        const socketcan_filter_t filter = filter_of(kIndex);
        lpvg_can_ebc2_t m{};
        m.front_axle_speed = kSpeed;
        REQUIRE(lpvg_can_ebc2_pack(&m, &good_) == lpvg_status_ok);
        REQUIRE(sender_.open());
        REQUIRE(receiver_.open(&filter, 1, socketcan_time_now));
        REQUIRE(lpvg_can_init(&supervisor, lpvg_can_rules, LPVG_CAN_RECEIVED, due_us_) == lpvg_status_ok);
    }

    void run(int64_t for_us) {
        for (const int64_t end = clock_us + for_us; clock_us < end; clock_us += 1000) {
            if (clock_us >= due_us_) {
                due_us_ += LPVG_CAN_EBC2_PERIOD_US;
                sent += sender_.send(good_) ? 1 : 0;
            }
            lpvg_can_frame_t frame{};
            for (int n = 0; n < 1000 && receiver_.receive(frame, clock_us); ++n) {
                uint8_t index = 0U;
                ++received;
                if (first_foreign_us == 0 && std::memcmp(frame.data, good_.data, sizeof frame.data) != 0) {
                    first_foreign_us = frame.t_us;
                }
                if (lpvg_can_receive(&supervisor, &frame, &index) == lpvg_can_event_accepted && supervisor.watch[kIndex].raw[0] != kSpeed) {
                    ++foreign_used;
                }
                if (first_off_us == 0 && was_live_ && state() == lpvg_can_state_off) {
                    first_off_us = frame.t_us;
                }
                was_live_ = was_live_ || state() == lpvg_can_state_live;
            }
            lpvg_can_advance(&supervisor, clock_us);
            std::this_thread::sleep_for(std::chrono::milliseconds(1));
        }
    }

    lpvg_can_state_t state() const { return lpvg_can_state(&supervisor, kIndex); }

    lpvg_can_supervisor_t supervisor{};
    int sent = 0;
    int received = 0;
    int foreign_used = 0;
    int64_t first_foreign_us = 0;
    int64_t first_off_us = 0;
    int64_t clock_us = 1'000'000;

private:
    static constexpr uint16_t kSpeed = 54U * 256U;
    Node sender_, receiver_;
    lpvg_can_frame_t good_{};
    int64_t due_us_ = clock_us;
    bool was_live_ = false;
};

// Runs a shell command beside the test.
class BackgroundCommand {
public:
    explicit BackgroundCommand(std::string command)
        : thread_([this, command] {
              (void)!std::system(command.c_str());
              done = true;
          }) {}
    ~BackgroundCommand() { thread_.join(); }

    std::atomic<bool> done{false};

private:
    std::thread thread_;
};

}  // namespace

TEST_CASE("frames come in order, not back to the sender, and only the filtered", "[socketcan]") {
    Node a, b;
    lpvg_can_frame_t got{};
    REQUIRE(a.open());
    REQUIRE(b.open(kOurs.data(), kOurs.size()));
    CHECK_FALSE(b.receive(got));
    for (uint8_t n = 0; n < 5; ++n) {
        REQUIRE(a.send(frame_of(LPVG_CAN_VDC2_ID, n)));
    }
    CHECK_FALSE(a.receive(got));
    for (uint8_t n = 0; n < 5; ++n) {
        REQUIRE(b.receive(got));
        CHECK(got.id == LPVG_CAN_VDC2_ID);
        CHECK(got.dlc == 8U);
        CHECK(got.data[0] == n);
    }
    CHECK_FALSE(b.receive(got));
    for (const uint32_t id : {0x123U, LPVG_CAN_EXTENDED | 0x18F0093FU, 0x0F0U}) {
        REQUIRE(a.send(frame_of(id, 1)));
    }
    const uint32_t other_priority = LPVG_CAN_EXTENDED | 0x0CF0093EU;
    REQUIRE(a.send(frame_of(other_priority, 7)));
    REQUIRE(b.receive(got));
    CHECK(got.id == other_priority);
    CHECK_FALSE(b.receive(got));
    CHECK(b.driver.error == 0);
}

TEST_CASE("bus-off passes any filter, switches the supervision off, and the driver restarts behind it", "[socketcan]") {
    Node a, b;
    lpvg_can_frame_t got{};
    REQUIRE(a.open());
    REQUIRE(b.open(kOurs.data(), kOurs.size()));
    REQUIRE(a.send(frame_of(LPVG_CAN_VDC2_ID, 1)));
    REQUIRE(a.send(frame_of(LPVG_CAN_ERROR | LPVG_CAN_BUS_OFF, 0)));
    REQUIRE(b.receive(got, 1000));
    CHECK(got.data[0] == 1U);  // came before
    REQUIRE(b.receive(got, 1000));
    CHECK(got.id == (LPVG_CAN_ERROR | LPVG_CAN_BUS_OFF));
    CanBus supervised;
    got.t_us = CanBus::kStart;
    CHECK(supervised.send(got) == lpvg_can_event_bus_off);
    // Off: nothing goes out and nothing comes in, to the last microsecond.
    CHECK_FALSE(b.send(frame_of(LPVG_CAN_GUARD_OUT_ID, 2)));
    CHECK(b.driver.error == ENETDOWN);
    CHECK_FALSE(a.receive(got));
    REQUIRE(a.send(frame_of(LPVG_CAN_VDC2_ID, 3)));
    CHECK_FALSE(b.receive(got, 1000 + SOCKETCAN_RESTART_US - 1));
    REQUIRE(a.send(frame_of(LPVG_CAN_VDC2_ID, 4)));
    // The restart drops what was queued, keeps the filters, and then both ways work.
    CHECK_FALSE(b.receive(got, 1000 + SOCKETCAN_RESTART_US));
    CHECK(b.driver.restarts == 1U);
    REQUIRE(a.send(frame_of(0x123U, 5)));
    REQUIRE(a.send(frame_of(LPVG_CAN_VDC2_ID, 6)));
    REQUIRE(b.receive(got, 1000 + SOCKETCAN_RESTART_US));
    CHECK(got.data[0] == 6U);
    REQUIRE(b.send(frame_of(LPVG_CAN_GUARD_OUT_ID, 7)));
    REQUIRE(a.receive(got));
    CHECK(got.data[0] == 7U);
}

TEST_CASE("a controller that reports its restart is used again at once", "[socketcan]") {
    constexpr uint32_t restarted = LPVG_CAN_ERROR | 0x100U;
    Node a, b;
    lpvg_can_frame_t got{};
    REQUIRE(a.open());
    REQUIRE(b.open(kOurs.data(), kOurs.size()));
    REQUIRE(a.send(frame_of(LPVG_CAN_ERROR | LPVG_CAN_BUS_OFF, 0)));
    REQUIRE(a.send(frame_of(LPVG_CAN_VDC2_ID, 1)));
    REQUIRE(b.receive(got, 1000));
    REQUIRE(a.send(frame_of(restarted, 0)));
    REQUIRE(a.send(frame_of(LPVG_CAN_VDC2_ID, 2)));
    REQUIRE(b.receive(got, 2000));
    CHECK(got.id == restarted);  // an error report like any other to the supervision; the frame before it was not heard
    REQUIRE(b.receive(got, 2000));
    CHECK(got.data[0] == 2U);
    CHECK(b.send(frame_of(LPVG_CAN_GUARD_OUT_ID, 3)));
    CHECK(b.driver.restarts == 0U);
}

TEST_CASE("times are those of arrival on the firmware's clock, or of the call where time is simulated", "[socketcan]") {
    Node a, real, simulated;
    lpvg_can_frame_t got{};
    REQUIRE(a.open());
    REQUIRE(real.open());
    REQUIRE(simulated.open(nullptr, 0, socketcan_time_now));
    const auto before = now_us();
    REQUIRE(a.send(frame_of(LPVG_CAN_VDC2_ID, 1)));
    const auto after = now_us();
    std::this_thread::sleep_for(std::chrono::milliseconds(200));  // waiting in the queue must not count
    const auto called = now_us();
    REQUIRE(real.receive(got, called));
    const auto in_call = now_us() - called;  // the driver reads the clock some time after `called`
    CHECK(got.t_us >= before - in_call - 20'000);  // user-mode Linux has a tick of 10 ms
    CHECK(got.t_us <= after + 20'000);
    REQUIRE(simulated.receive(got, 123'456));
    CHECK(got.t_us == 123'456);
}

TEST_CASE("what cannot be opened or sent says why", "[socketcan]") {
    socketcan_t driver{};
    bus_t bus{};
    CHECK_FALSE(socketcan_open(&driver, "nocan7", nullptr, 0, socketcan_time_arrival, &bus));
    CHECK(driver.error == ENODEV);
    CHECK_FALSE(socketcan_open(&driver, "a_name_longer_than_any", nullptr, 0, socketcan_time_arrival, &bus));
    CHECK(driver.error == EINVAL);
    const socketcan_filter_t many[SOCKETCAN_FILTERS_MAX + 1] = {};
    CHECK_FALSE(socketcan_open(&driver, "vcan0", many, SOCKETCAN_FILTERS_MAX + 1, socketcan_time_arrival, &bus));
    CHECK(driver.error == EINVAL);
    auto frame = frame_of(LPVG_CAN_VDC2_ID, 0);
    CHECK_FALSE(bus_send(&bus, &frame));
    CHECK(driver.error == EBADF);
    Node open;
    REQUIRE(open.open());
    frame.dlc = 9U;
    CHECK_FALSE(open.send(frame));
    CHECK(open.driver.error == EINVAL);
}

TEST_CASE("foreign identifiers at full speed do not reach the receiver", "[socketcan]") {
    Ebc2Link link;
    link.run(800'000);
    REQUIRE(link.state() == lpvg_can_state_live);
    BackgroundCommand flood("cangen -g 0 -p 10 -n 50000 vcan0");  // 11-bit, and
    BackgroundCommand other("cangen -e -I 18F0043E -g 0 -p 10 -n 50000 vcan0");
    while (!flood.done || !other.done) {
        link.run(100'000);
        CHECK(link.state() == lpvg_can_state_live);
    }
    CHECK(link.received == link.sent);
    CHECK(link.supervisor.watch[Ebc2Link::kIndex].count[lpvg_can_event_missed] == 0U);
    CHECK(link.supervisor.count[lpvg_can_event_unknown_id] == 0U);
}

TEST_CASE("our own identifier babbled: off within 5 periods, back 21 periods after, nothing of it used", "[socketcan]") {
    Ebc2Link link;
    link.run(800'000);
    REQUIRE(link.state() == lpvg_can_state_live);
    BackgroundCommand flood("cangen -e -I 18FEBF0B -L 8 -g 0 -p 10 -n 50000 vcan0");
    while (!flood.done) {
        link.run(100'000);
    }
    CHECK(link.first_foreign_us > 0);
    CHECK(link.first_off_us >= link.first_foreign_us);
    CHECK(link.first_off_us - link.first_foreign_us <= 5 * static_cast<int64_t>(LPVG_CAN_EBC2_PERIOD_US));
    CHECK(link.foreign_used <= 1);  // the very first may look like a good one
    link.run(21 * static_cast<int64_t>(LPVG_CAN_EBC2_PERIOD_US));  // twice eight arrivals in time, and five good frames
    CHECK(link.state() == lpvg_can_state_live);
}
