// The fault table: each fault, the state that it must lead to, and by when. VDC2 stands for the unprotected messages,
// GUARD_IN for those with E2E profile 11; both have a period of 10 ms.
#include "../catch.hpp"

#include <algorithm>
#include <deque>

#include "../can_bus.hpp"

namespace {

constexpr int64_t kPeriod = LPVG_CAN_VDC2_PERIOD_US;
constexpr int64_t kWarm = 20;  // good frames before every fault
constexpr auto kVdc2 = LPVG_CAN_VDC2_INDEX;
constexpr auto kGuard = LPVG_CAN_GUARD_IN_INDEX;

int64_t due(int64_t k) { return CanBus::kStart + k * kPeriod; }

// First whole microsecond after `from` at which message `index` is in `state`, when nothing more arrives; -1 by `to`.
int64_t reaches(CanBus& bus, uint8_t index, lpvg_can_state_t state, int64_t from, int64_t to) {
    for (int64_t t = from; t <= to; ++t) {
        if (bus.state_at(index, t) == state) {
            return t;
        }
    }
    return -1;
}

}  // namespace

TEST_CASE("lost frames: 1 nothing, 3 hold, 5 and 20 off, each within half a period of the last missed", "[fault][can][REQ-CAN-2]") {
    struct Case {
        int lost;
        lpvg_can_state_t want;
    };
    const auto c = GENERATE(Case{1, lpvg_can_state_live}, Case{2, lpvg_can_state_live}, Case{3, lpvg_can_state_hold},
                            Case{4, lpvg_can_state_hold}, Case{5, lpvg_can_state_off}, Case{20, lpvg_can_state_off});
    const auto index = GENERATE(as<uint8_t>{}, kVdc2, kGuard);
    CAPTURE(c.lost, +index);
    CanBus bus;
    bus.run(1, kWarm);
    CHECK(bus.state_at(index, due(kWarm + c.lost + 1) - 1) == c.want);
    CHECK(bus.count(index, lpvg_can_event_missed) == static_cast<uint32_t>(c.lost));
    bus.run(kWarm + c.lost + 1, kWarm + c.lost + 1);
    const bool off = c.want == lpvg_can_state_off;
    CHECK(bus.state(index) == (off ? lpvg_can_state_off : lpvg_can_state_live));
    bus.run(kWarm + c.lost + 2, kWarm + c.lost + 5);  // back with the fifth frame: 50 ms
    CHECK(bus.state(index) == lpvg_can_state_live);
    CHECK(bus.count(kGuard, lpvg_can_event_lost) == (off ? 0U : static_cast<uint32_t>(c.lost)));
}

TEST_CASE("silence: hold after exactly 3.5 periods, off after exactly 5.5", "[fault][can][REQ-CAN-2]") {
    CanBus bus;
    bus.run(1, kWarm);
    CHECK(reaches(bus, kVdc2, lpvg_can_state_hold, due(kWarm), due(kWarm + 10)) == due(kWarm) + 7 * kPeriod / 2 + 1);
    CHECK(reaches(bus, kVdc2, lpvg_can_state_off, due(kWarm), due(kWarm + 10)) == due(kWarm) + 11 * kPeriod / 2 + 1);
    CHECK(bus.count(kVdc2, lpvg_can_event_missed) == 5U);
}

TEST_CASE("a period counts as missed half a period after its frame was due, to the microsecond", "[fault][can]") {
    for (const int64_t missed : {1, 2, 3, 100}) {
        CanBus bus;
        bus.run(1, kWarm);
        bus.state_at(kVdc2, due(kWarm) + missed * kPeriod + kPeriod / 2);
        CHECK(bus.count(kVdc2, lpvg_can_event_missed) == static_cast<uint32_t>(missed - 1));
        bus.state_at(kVdc2, due(kWarm) + missed * kPeriod + kPeriod / 2 + 1);
        CHECK(bus.count(kVdc2, lpvg_can_event_missed) == static_cast<uint32_t>(missed));
    }
}

TEST_CASE("repeated frame: found at once where there is a counter; too soon, it is found without one", "[fault][can][REQ-CAN-4]") {
    CanBus bus;
    bus.run(1, kWarm);
    auto again = bus.guard_in(kWarm);
    again.t_us += kPeriod;
    CHECK(bus.send(again) == lpvg_can_event_repeated);
    auto soon = bus.vdc2(kWarm);
    soon.t_us += kPeriod / 8;
    lpvg_can_supervisor_t copy = bus.supervisor;  // the repeated frame above moved time on: judge from before
    copy.now_us = due(kWarm);
    uint8_t index = 0U;
    CHECK(lpvg_can_receive(&copy, &soon, &index) == lpvg_can_event_early);
    CHECK(bus.state(kGuard) == lpvg_can_state_live);  // one is no reason to degrade
}

TEST_CASE("swapped frames: the later-sent one is taken, the earlier-sent one rejected, the next taken", "[fault][can][REQ-CAN-4]") {
    CanBus bus;
    bus.run(1, kWarm);
    auto first = bus.guard_in(kWarm + 2), second = bus.guard_in(kWarm + 1);
    first.t_us = due(kWarm + 1);
    second.t_us = due(kWarm + 2);
    CHECK(bus.send(first) == lpvg_can_event_accepted);
    CHECK(bus.send(second) == lpvg_can_event_sequence);
    CHECK(bus.send(bus.guard_in(kWarm + 3)) == lpvg_can_event_accepted);
    CHECK(bus.state(kGuard) == lpvg_can_state_live);
}

TEST_CASE("delayed frames: by 1 period nothing, by 3 hold and back at once, by 5 off", "[fault][can][REQ-CAN-2]") {
    struct Case {
        int delay;
        lpvg_can_state_t before;
    };
    const auto c = GENERATE(Case{1, lpvg_can_state_live}, Case{3, lpvg_can_state_hold}, Case{5, lpvg_can_state_off});
    CAPTURE(c.delay);
    CanBus bus;
    bus.run(1, kWarm);
    auto frame = bus.guard_in(kWarm + 1);
    frame.t_us += c.delay * kPeriod;
    CHECK(bus.state_at(kGuard, frame.t_us - 1) == c.before);
    CHECK(bus.send(frame) == (c.before == lpvg_can_state_off ? lpvg_can_event_recovering : lpvg_can_event_accepted));
}

TEST_CASE("wrong CRC: rejected at once; hold after 3.5 periods; off within 5 of them", "[fault][can][REQ-CAN-4]") {
    CanBus bus;
    bus.run(1, kWarm);
    for (int64_t k = 1; k <= 5; ++k) {
        auto frame = bus.guard_in(kWarm + k);
        frame.data[5] = static_cast<uint8_t>(frame.data[5] ^ 0x01U);
        CHECK(bus.send(frame) == lpvg_can_event_checksum);
        CHECK(bus.state(kGuard) == (k <= 3 ? lpvg_can_state_live : k == 4 ? lpvg_can_state_hold : lpvg_can_state_off));
    }
    bus.run(kWarm + 6, kWarm + 10);
    CHECK(bus.state(kGuard) == lpvg_can_state_live);
}

TEST_CASE("every other frame wrong is tolerated, three of four are not", "[fault][can]") {
    const int good_every = GENERATE(2, 4);
    CAPTURE(good_every);
    CanBus bus;
    bus.run(1, kWarm);
    for (int64_t k = kWarm + 1; k <= kWarm + 12; ++k) {
        auto frame = bus.guard_in(k);
        if (k % good_every != 0) {
            frame.data[0] = static_cast<uint8_t>(~frame.data[0]);
        }
        bus.send(frame);
    }
    CHECK(bus.state(kGuard) == (good_every == 2 ? lpvg_can_state_live : lpvg_can_state_off));
}

TEST_CASE("stuck counter: off with the fifth frame", "[fault][can][REQ-CAN-4]") {
    CanBus bus;
    bus.run(1, kWarm);
    for (int64_t k = 1; k <= 5; ++k) {
        auto frame = bus.guard_in(kWarm);
        frame.t_us = due(kWarm + k);
        CHECK(bus.send(frame) == lpvg_can_event_repeated);
    }
    CHECK(bus.state(kGuard) == lpvg_can_state_off);
    CHECK(bus.supervisor.watch[kGuard].score == LPVG_CAN_SCORE_OFF);
    auto frame = bus.guard_in(kWarm);  // still stuck: never live again
    for (int64_t k = 6; k <= 40; ++k) {
        frame.t_us = due(kWarm + k);
        bus.send(frame);
        CHECK(bus.state(kGuard) == lpvg_can_state_off);
    }
    CHECK(bus.supervisor.watch[kGuard].score == LPVG_CAN_SCORE_OFF);
}

TEST_CASE("counter 15 is never sent: rejected under any checksum", "[fault][can]") {
    CanBus bus;
    bus.run(1, 29);  // newest counter: 14, so that 15 looks like the next one
    auto frame = bus.guard_in(30);
    frame.data[1] = 0xFFU;
    int right = 0;
    for (unsigned crc = 0U; crc < 256U; ++crc) {
        frame.data[0] = static_cast<uint8_t>(crc);
        CanBus trial = bus;
        const auto event = trial.send(frame);
        CHECK((event == lpvg_can_event_checksum || event == lpvg_can_event_sequence));
        right += event == lpvg_can_event_sequence ? 1 : 0;
    }
    CHECK(right == 1);
}

TEST_CASE("a sender that starts anew is followed after one rejection", "[fault][can]") {
    CanBus bus;
    bus.run(1, kWarm + 2);  // newest counter: 7
    auto frame = bus.guard_in(15);  // counter 0
    frame.t_us = due(kWarm + 3);
    CHECK(bus.send(frame) == lpvg_can_event_sequence);
    frame = bus.guard_in(16);
    frame.t_us = due(kWarm + 4);
    CHECK(bus.send(frame) == lpvg_can_event_accepted);
}

TEST_CASE("wrong length: every other length is rejected; off with the fifth", "[fault][can][REQ-CAN-4]") {
    for (unsigned dlc = 0U; dlc <= 64U; ++dlc) {
        CanBus bus;
        bus.run(1, kWarm);
        auto frame = bus.vdc2(kWarm + 1);
        frame.dlc = static_cast<uint8_t>(dlc);
        CHECK(bus.send(frame) == (dlc == 8U ? lpvg_can_event_accepted : lpvg_can_event_length));
    }
    CanBus bus;
    bus.run(1, kWarm);
    for (int64_t k = 1; k <= 5; ++k) {
        auto frame = bus.vdc2(kWarm + k);
        frame.dlc = 7U;
        bus.send(frame);
    }
    CHECK(bus.state(kVdc2) == lpvg_can_state_off);
}

TEST_CASE("unknown ids at full speed change no state and no value", "[fault][can]") {
    CanBus bus;
    bus.run(1, kWarm);
    const auto before = bus.supervisor;
    lpvg_can_frame_t frame{};
    frame.dlc = 8U;
    for (uint32_t n = 0U; n < 100'000U; ++n) {
        frame.id = (n % 2U == 0U) ? (LPVG_CAN_EXTENDED | (n * 2654435761U & 0x1FFFFFFFU)) : (n & 0x7FFU);
        frame.t_us = due(kWarm) + n / 50U;
        const auto event = bus.send(frame);
        if (event != lpvg_can_event_unknown_id) {
            REQUIRE(bus.count(kVdc2, event) + bus.count(kGuard, event) > 0U);  // a hash hit one of our ids
        }
    }
    for (uint8_t i = 0U; i < LPVG_CAN_RECEIVED; ++i) {
        CHECK(std::memcmp(&bus.supervisor.watch[i], &before.watch[i], sizeof before.watch[i]) == 0);
    }
    CHECK(bus.supervisor.count[lpvg_can_event_unknown_id] == 100'000U);
}

TEST_CASE("babbling with random data: off within one period, no frame of it used, live 21 periods after", "[fault][can][REQ-CAN-4]") {
    CanBus bus;
    bus.run(1, kWarm);
    uint32_t noise = 12345U;
    int64_t t = due(kWarm) + 100;
    int64_t off_at = -1;
    int used = 0;
    auto frame = bus.vdc2(kWarm);
    for (int n = 0; n < 5000; ++n, t += 550) {  // back to back at 250 kbit/s, for 2.75 s
        for (auto& byte : frame.data) {
            noise = noise * 1664525U + 1013904223U;
            byte = static_cast<uint8_t>(noise >> 24U);
        }
        frame.t_us = t;
        used += bus.send(frame) == lpvg_can_event_accepted ? 1 : 0;
        if (off_at < 0 && bus.state(kVdc2) == lpvg_can_state_off) {
            off_at = t;
        }
    }
    CHECK(used == 0);
    REQUIRE(off_at > 0);
    CHECK(off_at - due(kWarm) <= kPeriod);
    const int64_t next = (t - CanBus::kStart) / kPeriod + 1;
    bus.run(next, next + 20);  // twice eight arrivals in time, and five good frames
    CHECK(bus.state(kVdc2) == lpvg_can_state_live);
}

TEST_CASE("half of the checksums wrong: off with the eighth bad frame of sixteen, and never back", "[fault][can][REQ-CAN-9]") {
    const bool alternating = GENERATE(true, false);
    CanBus bus;
    bus.run(1, kWarm);
    uint32_t noise = 1U;
    int64_t off_at = -1;
    int64_t live = 0;
    for (int64_t k = 1; k <= 60'000; ++k) {  // ten minutes
        noise = noise * 1664525U + 1013904223U;
        auto frame = bus.guard_in(kWarm + k);
        frame.data[5] = static_cast<uint8_t>(frame.data[5] ^ ((alternating ? k % 2 : noise >> 31U) != 0 ? 1U : 0U));
        bus.send(frame);
        off_at = off_at < 0 && bus.state(kGuard) == lpvg_can_state_off ? k : off_at;
        live += off_at >= 0 && bus.state(kGuard) == lpvg_can_state_live ? 1 : 0;
    }
    CHECK(off_at > 0);
    CHECK(off_at <= (alternating ? 15 : 100));
    CHECK(live <= (alternating ? 0 : 60'000 / 4));  // a random half brings five good ones in a row now and then
}

TEST_CASE("whatever the order of good and bad frames, off and live are those of the rule written out", "[fault][can][REQ-CAN-9]") {
    const uint32_t bad_of_256 = GENERATE(60U, 90U, 110U, 128U);
    CanBus bus;
    bus.run(1, kWarm);
    std::deque<bool> newest(LPVG_CAN_WINDOW, false);
    bool off = false;
    int score = 0, good_in_row = 0, switched = 0;
    std::size_t wrong = 0, by_window = 0;
    uint32_t noise = 7U;
    for (int64_t k = kWarm + 1; k <= kWarm + 4'000; ++k) {
        noise = noise * 1664525U + 1013904223U;
        const bool bad = (noise >> 24U) < bad_of_256;
        auto frame = bus.guard_in(k);
        frame.data[5] = static_cast<uint8_t>(frame.data[5] ^ (bad ? 1U : 0U));
        bus.send(frame);
        if (off) {
            good_in_row = bad ? 0 : good_in_row + 1;
            if (good_in_row == LPVG_CAN_RECOVER_FRAMES) {
                off = false;
                score = 0;
                newest.assign(LPVG_CAN_WINDOW, false);
            }
        } else {
            score = bad ? score + 1 : std::max(score - 1, 0);
            newest.push_back(bad);
            newest.pop_front();
            const auto many = std::count(newest.begin(), newest.end(), true) >= LPVG_CAN_WINDOW_BAD;
            by_window += many && score < LPVG_CAN_SCORE_OFF ? 1U : 0U;
            off = many || score >= LPVG_CAN_SCORE_OFF;
            switched += off ? 1 : 0;
            good_in_row = 0;
        }
        wrong += (bus.state(kGuard) == lpvg_can_state_off) != off ? 1U : 0U;
    }
    CHECK(wrong == 0U);
    CHECK((bad_of_256 < 110U || (switched > 10 && by_window > 0U)));
}

TEST_CASE("a second sender is found by the rate, whatever it sends and whenever", "[fault][can][REQ-CAN-9]") {
    const int64_t after_us = GENERATE(0, 100, 2'400, 2'600, 5'000, 7'400, 7'600, 9'900);
    const bool guarded = GENERATE(false, true);
    const uint8_t index = guarded ? kGuard : kVdc2;
    CanBus bus;
    bus.run(1, kWarm);
    int64_t off_at = -1, live = 0;
    for (int64_t k = kWarm + 1; k <= kWarm + 1'000; ++k) {
        auto genuine = guarded ? bus.guard_in(k) : bus.vdc2(k);
        auto other = guarded ? bus.guard_in(k + 1) : bus.vdc2(k);  // counter + 1 with a right checksum
        other.t_us = genuine.t_us + after_us;
        bus.send(genuine);
        bus.send(other);
        off_at = off_at < 0 && bus.state(index) == lpvg_can_state_off ? k - kWarm : off_at;
        live += off_at >= 0 && bus.state(index) == lpvg_can_state_live ? 1 : 0;
    }
    CAPTURE(after_us, guarded);
    CHECK(off_at > 0);
    CHECK(off_at <= 8);
    CHECK(live == 0);
}

TEST_CASE("jitter of a period, and a frame lost now and then, are no second sender", "[fault][can][REQ-CAN-9]") {
    CanBus bus;
    bus.run(1, kWarm);
    uint32_t noise = 7U;
    int64_t off = 0, t_us = due(kWarm);
    for (int64_t k = kWarm + 1; k <= kWarm + 10'000; ++k) {
        noise = noise * 1664525U + 1013904223U;
        auto frame = bus.vdc2(k);
        const int64_t jittered = frame.t_us + static_cast<int64_t>(noise >> 20U);  // up to 4.1 ms
        frame.t_us = t_us = jittered > t_us + kPeriod / 4 ? jittered : t_us + kPeriod / 4;
        if (k % 7 != 0) {
            bus.send(frame);
        }
        off += bus.state(kVdc2) == lpvg_can_state_off ? 1 : 0;
    }
    CHECK(off == 0);
}

TEST_CASE("bus-off: everything off at once, back after 5 good frames; other error reports change nothing", "[fault][can][REQ-CAN-5]") {
    CanBus bus;
    bus.run(1, kWarm);
    lpvg_can_frame_t error{};
    error.dlc = 8U;
    error.t_us = due(kWarm) + 1;
    error.id = 0x20000004U;  // controller problem
    CHECK(bus.send(error) == lpvg_can_event_error);
    CHECK(bus.state(kVdc2) == lpvg_can_state_live);
    error.id = 0x20000040U;  // as SocketCAN reports it
    CHECK(bus.send(error) == lpvg_can_event_bus_off);
    CHECK(bus.supervisor.bus_off == 1U);
    for (uint8_t i = 0U; i < LPVG_CAN_RECEIVED; ++i) {
        CHECK(bus.state(i) == lpvg_can_state_off);
    }
    bus.run(kWarm + 1, kWarm + 4);
    CHECK(bus.supervisor.bus_off == 0U);
    CHECK(bus.state(kVdc2) == lpvg_can_state_off);
    bus.run(kWarm + 5, kWarm + 5);
    CHECK(bus.state(kVdc2) == lpvg_can_state_live);
    CHECK(bus.state(kGuard) == lpvg_can_state_live);
}

TEST_CASE("a value that jumps and stays is refused until the allowed change has caught up", "[fault][can]") {
    CanBus bus;
    bus.run(1, kWarm);
    const auto jumped = lpvg_can_encode(&lpvg_can_vdc2_yaw_rate, 0.05F + 0.25F);
    int64_t k = kWarm;
    lpvg_can_event_t event = lpvg_can_event_none;
    while (event != lpvg_can_event_accepted && k < kWarm + 10) {
        ++k;
        auto frame = bus.vdc2(k);
        frame.data[3] = static_cast<uint8_t>(jumped & 0xFFU);
        frame.data[4] = static_cast<uint8_t>(jumped >> 8U);
        event = bus.send(frame);
    }
    CHECK(k == kWarm + 3);  // 10 rad/s2 for 30 ms
    CHECK(bus.count(kVdc2, lpvg_can_event_gradient) == 2U);
}

TEST_CASE("time jumps forward: off at once; the counters of missed periods saturate or match", "[fault][can]") {
    CanBus bus;
    bus.run(1, kWarm);
    CHECK(bus.state_at(kVdc2, due(kWarm + 1000)) == lpvg_can_state_off);
    CHECK(bus.count(kVdc2, lpvg_can_event_missed) == 999U);
    bus.run(kWarm + 1001, kWarm + 1005);
    CHECK(bus.state(kVdc2) == lpvg_can_state_live);
}
