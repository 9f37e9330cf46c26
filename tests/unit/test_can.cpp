#include "../catch.hpp"

#include <climits>
#include <cmath>
#include <limits>
#include <vector>

#include "../can_bus.hpp"

namespace {

using Bytes = std::vector<uint8_t>;

constexpr float kNan = std::numeric_limits<float>::quiet_NaN();
constexpr float kInf = std::numeric_limits<float>::infinity();

const lpvg_can_plausibility_limits_t kLimits = {2.07F, 3.0F, 1.5F, 0.05F, 5U};

}  // namespace

TEST_CASE("E2E profile 11: the published vector, the counter and the free nibble", "[unit][can][REQ-CAN-1]") {
    lpvg_can_frame_t frame{};
    frame.dlc = 8U;
    uint8_t counter = 0U;
    REQUIRE(lpvg_can_e2e_protect(&frame, 0x0123U, &counter) == lpvg_status_ok);
    CHECK(frame.data[0] == 0xCCU);
    CHECK(counter == 1U);

    frame.data[1] = 0xA0U;
    counter = 14U;
    REQUIRE(lpvg_can_e2e_protect(&frame, 0x0123U, &counter) == lpvg_status_ok);
    CHECK(frame.data[1] == 0xAEU);
    CHECK(counter == 0U);  // 15 is never sent
    REQUIRE(lpvg_can_e2e_check(&frame, 0x0123U, &counter) == lpvg_status_ok);
    CHECK(counter == 14U);
}

TEST_CASE("E2E profile 11: every single-bit error and every other data id is found", "[unit][can][REQ-CAN-1]") {
    lpvg_can_frame_t good{};
    good.dlc = GENERATE(as<uint8_t>{}, 2, 5, 8);
    for (uint8_t i = 0U; i < 8U; ++i) {
        good.data[i] = static_cast<uint8_t>(17U * i + 3U);
    }
    uint8_t counter = 7U;
    REQUIRE(lpvg_can_e2e_protect(&good, 0x4C01U, &counter) == lpvg_status_ok);
    for (unsigned bit = 0U; bit < 8U * good.dlc; ++bit) {
        lpvg_can_frame_t bad = good;
        bad.data[bit / 8U] = static_cast<uint8_t>(bad.data[bit / 8U] ^ (1U << (bit % 8U)));
        CAPTURE(bit);
        CHECK(lpvg_can_e2e_check(&bad, 0x4C01U, &counter) == lpvg_status_bad_sample);
    }
    for (unsigned flip = 1U; flip < 256U; ++flip) {  // data ids that differ in one byte
        CHECK(lpvg_can_e2e_check(&good, static_cast<uint16_t>(0x4C01U ^ flip), &counter) == lpvg_status_bad_sample);
        CHECK(lpvg_can_e2e_check(&good, static_cast<uint16_t>(0x4C01U ^ (flip << 8U)), &counter) == lpvg_status_bad_sample);
    }
}

TEST_CASE("E2E profile 11: the checksum of every byte is the one of a division bit by bit", "[unit][can][REQ-CAN-1]") {
    const auto divided = [](const Bytes& bytes) {
        unsigned rest = 0U;
        for (const uint8_t byte : bytes) {
            rest ^= byte;
            for (int bit = 0; bit < 8; ++bit) {
                rest = (rest << 1U) ^ ((rest & 0x80U) != 0U ? 0x11DU : 0U);
            }
        }
        return static_cast<uint8_t>(rest);
    };
    for (unsigned byte = 0U; byte < 256U; ++byte) {
        lpvg_can_frame_t frame{};
        frame.dlc = 3U;
        frame.data[2] = static_cast<uint8_t>(byte);
        uint8_t counter = 3U;
        REQUIRE(lpvg_can_e2e_protect(&frame, 0x0123U, &counter) == lpvg_status_ok);
        CHECK(frame.data[0] == divided({0x23U, 0x01U, 3U, frame.data[2]}));
    }
}

TEST_CASE("E2E profile 11 refuses what it cannot protect and changes nothing", "[unit][can][REQ-CAN-1]") {
    lpvg_can_frame_t frame{};
    uint8_t counter = 0U;
    for (const uint8_t dlc : {uint8_t{0}, uint8_t{1}, uint8_t{9}, uint8_t{255}}) {
        frame.dlc = dlc;
        CHECK(lpvg_can_e2e_protect(&frame, 1U, &counter) == lpvg_status_bad_argument);
        CHECK(lpvg_can_e2e_check(&frame, 1U, &counter) == lpvg_status_bad_argument);
    }
    frame.dlc = 8U;
    counter = 15U;
    CHECK(lpvg_can_e2e_protect(&frame, 1U, &counter) == lpvg_status_bad_argument);
    CHECK(counter == 15U);
    CHECK(lpvg_can_e2e_protect(nullptr, 1U, &counter) == lpvg_status_bad_argument);
    CHECK(lpvg_can_e2e_protect(&frame, 1U, nullptr) == lpvg_status_bad_argument);
    CHECK(lpvg_can_e2e_check(nullptr, 1U, &counter) == lpvg_status_bad_argument);
    CHECK(lpvg_can_e2e_check(&frame, 1U, nullptr) == lpvg_status_bad_argument);
}

TEST_CASE("E2E profile 11: counter 15 is refused under any CRC", "[unit][can]") {
    lpvg_can_frame_t frame{};
    frame.dlc = 8U;
    frame.data[1] = 0x0FU;
    uint8_t counter = 3U;
    for (unsigned crc = 0U; crc < 256U; ++crc) {
        frame.data[0] = static_cast<uint8_t>(crc);
        CHECK(lpvg_can_e2e_check(&frame, 0x0123U, &counter) == lpvg_status_bad_sample);
    }
    CHECK(counter == 3U);
}

TEST_CASE("init refuses rules that make no sense and leaves the struct alone", "[unit][can][REQ-CAN-8]") {
    lpvg_can_supervisor_t self;
    std::memset(&self, 0xA5, sizeof self);
    const lpvg_can_supervisor_t before = self;
    lpvg_can_signal_rule_t signal = {0U, 16U, 0U, 100U, 0U, 0U, 0U};
    lpvg_can_rule_t rule = {1U, 0xFFFFFFFFU, 10'000U, 0U, 0U, 0U, 8U, 1U, &signal};
    const auto refused = [&](size_t n = 1U, int64_t now = 0) {
        const bool status = lpvg_can_init(&self, &rule, n, now) == lpvg_status_bad_argument;
        return status && std::memcmp(&self, &before, sizeof self) == 0;
    };
    CHECK(lpvg_can_init(nullptr, &rule, 1U, 0) == lpvg_status_bad_argument);
    CHECK(lpvg_can_init(&self, nullptr, 1U, 0) == lpvg_status_bad_argument);
    CHECK(refused(0U));
    CHECK(refused(LPVG_CAN_RULES_MAX + 1U));
    CHECK(refused(1U, -1));
    SECTION("period too short") {
        rule.period_us = 3U;
        CHECK(refused());
    }
    SECTION("period too long") {
        rule.period_us = 10'000'001U;
        CHECK(refused());
    }
    SECTION("gap not below the period") {
        rule.gap_min_us = 10'000U;
        CHECK(refused());
    }
    SECTION("too many bytes") {
        rule.dlc = 9U;
        CHECK(refused());
    }
    SECTION("unknown protection") {
        rule.e2e = 2U;
        CHECK(refused());
    }
    SECTION("protection without room") {
        rule.e2e = 1U;
        rule.dlc = 1U;
        rule.n_signals = 0U;
        CHECK(refused());
    }
    SECTION("too many signals") {
        rule.n_signals = LPVG_CAN_SIGNALS_MAX + 1U;
        CHECK(refused());
    }
    SECTION("signals missing") {
        rule.signals = nullptr;
        CHECK(refused());
    }
    SECTION("no bits") {
        signal.length = 0U;
        CHECK(refused());
    }
    SECTION("too many bits") {
        signal.length = 17U;
        CHECK(refused());
    }
    SECTION("beyond the frame") {
        signal.start = 49U;
        CHECK(refused());
    }
    SECTION("empty range") {
        signal.raw_min = 101U;
        CHECK(refused());
    }
    SECTION("a signal behind the first") {
        const lpvg_can_signal_rule_t two[] = {signal, {49U, 16U, 0U, 100U, 0U, 0U, 0U}};
        rule.n_signals = 2U;
        rule.signals = two;
        CHECK(refused());
    }
    SECTION("a rule behind the first") {
        lpvg_can_rule_t two[] = {rule, rule};
        two[1].period_us = 3U;
        CHECK(lpvg_can_init(&self, two, 2U, 0) == lpvg_status_bad_argument);
    }
    SECTION("and takes the rest") { CHECK(lpvg_can_init(&self, &rule, 1U, 0) == lpvg_status_ok); }
    SECTION("and takes the ends of every range") {
        const lpvg_can_signal_rule_t one_bit[LPVG_CAN_SIGNALS_MAX] = {
            {15U, 1U, 1U, 1U, 0U, 0U, 0U}, {0U, 1U, 0U, 0U, 0U, 0U, 0U}, {0U, 16U, 0U, 9U, 0U, 0U, 0U}, {0U, 1U, 0U, 1U, 0U, 0U, 0U},
            {0U, 1U, 0U, 1U, 0U, 0U, 0U},  {0U, 1U, 0U, 1U, 0U, 0U, 0U}, {0U, 1U, 0U, 1U, 0U, 0U, 0U},  {0U, 1U, 0U, 1U, 0U, 0U, 0U}};
        const lpvg_can_rule_t shortest = {1U, 0U, 4U, 3U, 0U, 1U, 2U, LPVG_CAN_SIGNALS_MAX, one_bit};
        lpvg_can_rule_t all[LPVG_CAN_RULES_MAX];
        for (auto& each : all) {
            each = shortest;
        }
        all[1].period_us = 10'000'000U;
        CHECK(lpvg_can_init(&self, all, LPVG_CAN_RULES_MAX, INT64_MAX) == lpvg_status_ok);
    }
}

TEST_CASE("a protected message has room for its checksum and counter, whatever is supervised in it", "[unit][can][REQ-CAN-8]") {
    const lpvg_can_signal_rule_t signals[] = {{0U, 4U, 0U, 15U, 0U, 0U, 0U}, {4U, 4U, 0U, 15U, 0U, 0U, 0U}};
    for (const uint8_t dlc : {uint8_t{0}, uint8_t{1}, uint8_t{2}, uint8_t{8}}) {
        for (const uint8_t n_signals : {uint8_t{0}, uint8_t{1}, uint8_t{2}}) {
            if (dlc == 0U && n_signals > 0U) {
                continue;  // a signal does not fit
            }
            for (const uint8_t e2e : {uint8_t{0}, uint8_t{1}}) {
                lpvg_can_supervisor_t self;
                const lpvg_can_rule_t rule = {1U, 0xFFFFFFFFU, 10'000U, 0U, 0U, e2e, dlc, n_signals, signals};
                CAPTURE(static_cast<int>(dlc), static_cast<int>(n_signals), static_cast<int>(e2e));
                CHECK((lpvg_can_init(&self, &rule, 1U, 0) == lpvg_status_ok) == (e2e == 0U || dlc >= 2U));
            }
        }
    }
}

TEST_CASE("cleared memory and NULL read as off and do nothing", "[unit][can][REQ-CAN-8]") {
    lpvg_can_supervisor_t self{};
    lpvg_can_frame_t frame{};
    uint8_t index = 0U;
    CHECK(lpvg_can_state(&self, 0U) == lpvg_can_state_off);
    CHECK(lpvg_can_state(nullptr, 0U) == lpvg_can_state_off);
    CHECK(lpvg_can_receive(&self, &frame, &index) == lpvg_can_event_unknown_id);
    CHECK(index == LPVG_CAN_NO_INDEX);
    CHECK(lpvg_can_receive(nullptr, &frame, &index) == lpvg_can_event_none);
    CHECK(lpvg_can_receive(&self, nullptr, &index) == lpvg_can_event_none);
    CHECK(lpvg_can_receive(&self, &frame, nullptr) == lpvg_can_event_none);
    lpvg_can_advance(nullptr, 1);
}

TEST_CASE("what stood in the memory before init is forgotten", "[unit][can][REQ-CAN-8]") {
    CanBus bus;
    std::memset(&bus.supervisor, 0xA5, sizeof bus.supervisor);
    REQUIRE(lpvg_can_init(&bus.supervisor, lpvg_can_rules, LPVG_CAN_RECEIVED, CanBus::kStart) == lpvg_status_ok);
    CanBus cleared;
    bus.run(1, 6);
    cleared.run(1, 6);
    CHECK(bus.supervisor.now_us == cleared.supervisor.now_us);
    CHECK(std::memcmp(bus.supervisor.count, cleared.supervisor.count, sizeof cleared.supervisor.count) == 0);
    for (uint8_t i = 0U; i < LPVG_CAN_RECEIVED; ++i) {
        CHECK(bus.state(i) == cleared.state(i));
        CHECK(std::memcmp(bus.supervisor.watch[i].count, cleared.supervisor.watch[i].count, sizeof cleared.supervisor.watch[i].count) == 0);
    }
}

TEST_CASE("the time of init is the newest seen", "[unit][can][REQ-CAN-8]") {
    CanBus bus;
    lpvg_can_frame_t frame = bus.vdc2(1);
    frame.t_us = CanBus::kStart - LPVG_CAN_REORDER_US - 1;
    CHECK(bus.send(frame) == lpvg_can_event_backwards);
    frame.t_us += 1;
    CHECK(bus.send(frame) == lpvg_can_event_recovering);
}

TEST_CASE("as many messages as there is room for", "[unit][can][REQ-CAN-8]") {
    lpvg_can_rule_t rules[LPVG_CAN_RULES_MAX];
    for (uint8_t i = 0U; i < LPVG_CAN_RULES_MAX; ++i) {
        rules[i] = {i, 0xFFFFFFFFU, 10'000U, 0U, 0U, 0U, 0U, 0U, nullptr};
    }
    lpvg_can_supervisor_t self;
    REQUIRE(lpvg_can_init(&self, rules, LPVG_CAN_RULES_MAX, 0) == lpvg_status_ok);
    lpvg_can_frame_t frame{};
    uint8_t index = 0U;
    for (int64_t k = 1; k <= 5; ++k) {
        for (uint8_t i = 0U; i < LPVG_CAN_RULES_MAX; ++i) {
            frame.id = i;
            frame.t_us = 10'000 * k;
            (void)lpvg_can_receive(&self, &frame, &index);
            CHECK(index == i);
        }
    }
    for (uint8_t i = 0U; i < LPVG_CAN_RULES_MAX; ++i) {
        CHECK(lpvg_can_state(&self, i) == lpvg_can_state_live);
    }
    CHECK(lpvg_can_state(&self, LPVG_CAN_RULES_MAX) == lpvg_can_state_off);
    CHECK(lpvg_can_state(&self, LPVG_CAN_NO_INDEX) == lpvg_can_state_off);
    frame.id = LPVG_CAN_ERROR | 1U;  // an error, and another bit than that of bus-off
    CHECK(lpvg_can_receive(&self, &frame, &index) == lpvg_can_event_error);
    CHECK(index == LPVG_CAN_NO_INDEX);
    frame.id = LPVG_CAN_ERROR | LPVG_CAN_BUS_OFF;
    CHECK(lpvg_can_receive(&self, &frame, &index) == lpvg_can_event_bus_off);
    for (uint8_t i = 0U; i < LPVG_CAN_RULES_MAX; ++i) {
        CHECK(lpvg_can_state(&self, i) == lpvg_can_state_off);
    }
}

namespace {

constexpr int64_t kRulePeriod = 10'000;

// A supervisor of one protected message of two bytes.
struct Protected {
    lpvg_can_rule_t rule = {1U, 0xFFFFFFFFU, static_cast<uint32_t>(kRulePeriod), 0U, 0x0123U, 1U, 2U, 0U, nullptr};
    lpvg_can_supervisor_t self;

    Protected() { REQUIRE(lpvg_can_init(&self, &rule, 1U, 0) == lpvg_status_ok); }

    lpvg_can_event_t send(int64_t t_us, int64_t counter) {
        lpvg_can_frame_t frame{};
        frame.id = 1U;
        frame.dlc = 2U;
        frame.t_us = t_us;
        auto next = static_cast<uint8_t>(counter % LPVG_CAN_COUNTERS);
        REQUIRE(lpvg_can_e2e_protect(&frame, 0x0123U, &next) == lpvg_status_ok);
        uint8_t index = 0U;
        return lpvg_can_receive(&self, &frame, &index);
    }
    bool off() const { return lpvg_can_state(&self, 0U) == lpvg_can_state_off; }
};

// Genuine frames, and after_us behind each nth of them a frame whose counter is `ahead` of it. Returns how many periods until off.
int64_t periods_until_off(Protected& bus, int64_t every, int64_t after_us, int64_t ahead) {
    for (int64_t k = 1; k <= 20; ++k) {
        bus.send(kRulePeriod * k, k);
    }
    REQUIRE_FALSE(bus.off());
    for (int64_t k = 21; k <= 420; ++k) {
        bus.send(kRulePeriod * k, k);
        if (bus.off()) {
            return k - 20;
        }
        if (k % every == 0) {
            bus.send(kRulePeriod * k + after_us, k + ahead);
        }
        if (bus.off()) {
            return k - 20;
        }
    }
    return INT64_MAX;
}

}  // namespace

TEST_CASE("a thin second sender is found by the counters of its frames", "[unit][can][REQ-CAN-9]") {
    const int64_t every = GENERATE(5, 10);
    Protected bus;
    const int64_t periods = periods_until_off(bus, every, kRulePeriod / 2, 1);
    CAPTURE(every);
    CHECK(periods <= 20 * every);
}

TEST_CASE("a frame that repeats a counter late, or any other that is bad, is no second sender", "[unit][can][REQ-CAN-9]") {
    Protected bus;
    for (int64_t k = 1; k <= 400; ++k) {
        bus.send(kRulePeriod * k, k);
        if (k > 20 && k % 20 == 0) {
            CHECK(bus.send(kRulePeriod * k + kRulePeriod * 9 / 10, k) == lpvg_can_event_repeated);
        }
        if (k > 20 && k % 20 == 10) {
            CHECK(bus.send(kRulePeriod * k + kRulePeriod / 4, k + 12) == lpvg_can_event_sequence);
        }
        CHECK((k <= 5 || !bus.off()));
    }
    CHECK(bus.self.watch[0].foreign == 0U);
}

TEST_CASE("a score of a second sender's frames falls with good frames", "[unit][can][REQ-CAN-9]") {
    Protected bus;
    for (int64_t k = 1; k <= 20; ++k) {
        bus.send(kRulePeriod * k, k);
    }
    CHECK(bus.send(kRulePeriod * 20 + kRulePeriod / 4, 20) == lpvg_can_event_repeated);
    CHECK(bus.self.watch[0].foreign == LPVG_CAN_FOREIGN_ADD);
    for (int64_t k = 21; k <= 23; ++k) {
        bus.send(kRulePeriod * k, k);
    }
    CHECK(bus.self.watch[0].foreign == LPVG_CAN_FOREIGN_ADD - 3U);
}

TEST_CASE("a bad frame counts as a second sender's by the counter alone, with whatever else it breaks", "[unit][can][REQ-CAN-9]") {
    Protected bus;
    bus.rule.gap_min_us = static_cast<uint32_t>(kRulePeriod / 2);
    CHECK(bus.send(kRulePeriod / 4, LPVG_CAN_COUNTERS) == lpvg_can_event_recovering);
    CHECK(bus.send(kRulePeriod / 2, 0) == lpvg_can_event_early);
    CHECK(bus.self.watch[0].foreign == LPVG_CAN_FOREIGN_ADD);
    Protected fresh;
    fresh.rule.gap_min_us = static_cast<uint32_t>(kRulePeriod / 2);
    lpvg_can_frame_t frame{};
    frame.id = 1U;
    uint8_t index = 0U;
    CHECK(lpvg_can_receive(&fresh.self, &frame, &index) == lpvg_can_event_length);
    frame.t_us = kRulePeriod / 4;
    CHECK(lpvg_can_receive(&fresh.self, &frame, &index) == lpvg_can_event_early);  // before any counter
    CHECK(fresh.self.watch[0].foreign == 0U);
    fresh.rule.e2e = 0U;
    frame.t_us = kRulePeriod / 3;
    CHECK(lpvg_can_receive(&fresh.self, &frame, &index) == lpvg_can_event_early);
    CHECK(fresh.self.watch[0].foreign == 0U);
}

TEST_CASE("a mean rate that is a sixth too high switches off, and the right one back on", "[unit][can][REQ-CAN-9]") {
    Protected bus;
    const int64_t fast = kRulePeriod * 6 / 7;
    int64_t t_us = 0, k = 1;
    int64_t sent = 0;
    for (; sent < 3 * int64_t{LPVG_CAN_RATE_ARRIVALS} && (sent < 20 || !bus.off()); ++sent, ++k) {
        bus.send(t_us += fast, k);
    }
    CHECK(bus.off());
    CHECK(sent <= LPVG_CAN_RATE_ARRIVALS + 1);
    for (sent = 0; sent < 3 * int64_t{LPVG_CAN_RATE_ARRIVALS} && bus.off(); ++sent, ++k) {
        bus.send(t_us += kRulePeriod, k);
    }
    CHECK_FALSE(bus.off());
}

TEST_CASE("silence while recovering begins the count anew", "[unit][can][REQ-CAN-3]") {
    CanBus bus;
    bus.run(1, 3);
    for (int64_t k = 10; k <= 13; ++k) {
        CHECK(bus.send(bus.vdc2(k)) == lpvg_can_event_recovering);
    }
    CHECK(bus.send(bus.vdc2(14)) == lpvg_can_event_accepted);
}

TEST_CASE("more than an hour of silence counts every period, 2^32 us a call", "[unit][can][REQ-CAN-3]") {
    CanBus bus;
    bus.run(1, 5);
    const int64_t last_us = bus.vdc2(5).t_us, period = LPVG_CAN_VDC2_PERIOD_US;
    const int64_t periods = 2 * int64_t{UINT32_MAX} / period;
    for (const int64_t counted : {int64_t{UINT32_MAX} / period, periods - 1, periods - 1}) {
        lpvg_can_advance(&bus.supervisor, last_us + periods * period);
        CHECK(bus.count(LPVG_CAN_VDC2_INDEX, lpvg_can_event_missed) == counted);
    }
}

TEST_CASE("a good frame ends a pause: the next one is counted from it", "[unit][can][REQ-CAN-3]") {
    CanBus bus;
    bus.run(1, 5);
    REQUIRE(bus.count(LPVG_CAN_VDC2_INDEX, lpvg_can_event_missed) == 0U);
    for (const int64_t k : {8, 11}) {
        CHECK(bus.send(bus.vdc2(k)) == lpvg_can_event_accepted);
    }
    CHECK(bus.count(LPVG_CAN_VDC2_INDEX, lpvg_can_event_missed) == 4U);
}

TEST_CASE("half a period after a missed one nothing more is missed", "[unit][can][REQ-CAN-3]") {
    CanBus bus;
    bus.run(1, 5);
    const int64_t last_us = bus.vdc2(5).t_us, period = LPVG_CAN_VDC2_PERIOD_US;
    lpvg_can_advance(&bus.supervisor, last_us + 6 * period);
    REQUIRE(bus.count(LPVG_CAN_VDC2_INDEX, lpvg_can_event_missed) == 5U);
    REQUIRE(bus.state(LPVG_CAN_VDC2_INDEX) == lpvg_can_state_off);
    auto bad = bus.vdc2(11);
    bad.dlc = 7U;
    CHECK(bus.send(bad) == lpvg_can_event_length);
    lpvg_can_advance(&bus.supervisor, last_us + 6 * period + period / 2);
    CHECK(bus.count(LPVG_CAN_VDC2_INDEX, lpvg_can_event_missed) == 5U);
    CHECK(bus.supervisor.watch[LPVG_CAN_VDC2_INDEX].window == 1U);
    lpvg_can_advance(&bus.supervisor, last_us + 6 * period + period / 2 + 1);
    CHECK(bus.count(LPVG_CAN_VDC2_INDEX, lpvg_can_event_missed) == 6U);
}

TEST_CASE("arrivals are counted by eights: six periods are enough, a microsecond less is not", "[unit][can][REQ-CAN-9]") {
    const auto window = GENERATE(1, 2);
    const lpvg_can_rule_t rule = {1U, 0xFFFFFFFFU, 8'000U, 0U, 0U, 0U, 0U, 0U, nullptr};
    lpvg_can_supervisor_t self;
    REQUIRE(lpvg_can_init(&self, &rule, 1U, 0) == lpvg_status_ok);
    lpvg_can_frame_t frame{};
    frame.id = 1U;
    frame.t_us = 1'000'000;
    uint8_t index = 0U;
    const int last = 8 * window;
    for (int k = 0; k <= last; ++k) {
        frame.t_us += k == last ? 5'999 : 6'000;
        CAPTURE(k);
        CHECK((lpvg_can_receive(&self, &frame, &index) == lpvg_can_event_early) == (k == last));
    }
}

TEST_CASE("a message becomes live with the fifth good frame and not before", "[unit][can][REQ-CAN-3]") {
    CanBus bus;
    REQUIRE(bus.packed());
    for (int64_t k = 1; k <= 4; ++k) {
        CHECK(bus.send(bus.vdc2(k)) == lpvg_can_event_recovering);
        CHECK(bus.send(bus.guard_in(k)) == lpvg_can_event_recovering);
        CHECK(bus.state(LPVG_CAN_VDC2_INDEX) == lpvg_can_state_off);
    }
    CHECK(bus.send(bus.vdc2(5)) == lpvg_can_event_accepted);
    CHECK(bus.send(bus.guard_in(5)) == lpvg_can_event_accepted);
    CHECK(bus.state(LPVG_CAN_VDC2_INDEX) == lpvg_can_state_live);
    CHECK(bus.state(LPVG_CAN_GUARD_IN_INDEX) == lpvg_can_state_live);
    CHECK(bus.state(LPVG_CAN_EBC2_INDEX) == lpvg_can_state_off);
}

TEST_CASE("five good frames means in a row: a bad one starts the count anew, and live starts with a clean score",
          "[unit][can][REQ-CAN-3]") {
    CanBus bus;
    bus.run(1, 4);
    auto bad = bus.vdc2(5);
    bad.dlc = 7U;
    CHECK(bus.send(bad) == lpvg_can_event_length);
    for (int64_t k = 6; k <= 9; ++k) {
        CHECK(bus.send(bus.vdc2(k)) == lpvg_can_event_recovering);
    }
    CHECK(bus.send(bus.vdc2(10)) == lpvg_can_event_accepted);
    CHECK(bus.supervisor.watch[LPVG_CAN_VDC2_INDEX].score == 0U);
    CHECK(bus.supervisor.watch[LPVG_CAN_VDC2_INDEX].good_in_row == 0U);
}

TEST_CASE("eight bad frames of the newest sixteen switch off, counted from the recovery on", "[unit][can][REQ-CAN-9]") {
    CanBus bus;
    bus.run(1, 5);
    int64_t k = 6;
    // Good and bad in turn never reach the score. Returns how many bad ones it takes.
    const auto bad_until_off = [&] {
        int bad = 0;
        while (bad < 20 && bus.state(LPVG_CAN_VDC2_INDEX) == lpvg_can_state_live) {
            auto frame = bus.vdc2(k++);
            frame.dlc = 7U;
            CHECK(bus.send(frame) == lpvg_can_event_length);
            ++bad;
            if (bus.state(LPVG_CAN_VDC2_INDEX) == lpvg_can_state_live) {
                CHECK(bus.send(bus.vdc2(k++)) == lpvg_can_event_accepted);
            }
        }
        return bad;
    };
    CHECK(bad_until_off() == static_cast<int>(LPVG_CAN_WINDOW_BAD));
    for (int i = 0; i < static_cast<int>(LPVG_CAN_RECOVER_FRAMES); ++i) {
        (void)bus.send(bus.vdc2(k++));
    }
    CHECK(bus.state(LPVG_CAN_VDC2_INDEX) == lpvg_can_state_live);
    CHECK(bad_until_off() == static_cast<int>(LPVG_CAN_WINDOW_BAD));
}

TEST_CASE("twice the rate switches off at once, whatever the score, until eight arrivals have taken their time", "[unit][can][REQ-CAN-9]") {
    CanBus bus;
    bus.run(1, 5);
    int sent = 0;
    int64_t t_us = bus.vdc2(5).t_us;
    const auto send = [&](int64_t after_us) {
        auto frame = bus.vdc2(6);
        t_us += after_us;
        frame.t_us = t_us;
        return bus.send(frame);
    };
    for (; bus.state(LPVG_CAN_VDC2_INDEX) == lpvg_can_state_live && sent < 30; ++sent) {
        (void)send(LPVG_CAN_VDC2_PERIOD_US / 2);
    }
    CHECK(sent <= 2 * static_cast<int>(LPVG_CAN_ARRIVALS));
    CHECK(bus.supervisor.watch[LPVG_CAN_VDC2_INDEX].score < LPVG_CAN_SCORE_OFF);
    CHECK(bus.count(LPVG_CAN_VDC2_INDEX, lpvg_can_event_early) == 1U);
    int back = 0;
    for (; bus.state(LPVG_CAN_VDC2_INDEX) != lpvg_can_state_live && back < 60; ++back) {
        (void)send(LPVG_CAN_VDC2_PERIOD_US);
    }
    CHECK(back <= static_cast<int>(LPVG_CAN_ARRIVALS + LPVG_CAN_RECOVER_FRAMES));
    CHECK(back > static_cast<int>(LPVG_CAN_RECOVER_FRAMES));
}

TEST_CASE("any number of bad frames while off is forgotten with the recovery", "[unit][can][REQ-CAN-9]") {
    CanBus bus;
    for (int64_t k = 1; k <= 20; ++k) {  // good ones between, or silence would begin the count anew
        auto frame = bus.vdc2(k);
        frame.dlc = k % 2 == 0 ? frame.dlc : uint8_t{7};
        CHECK(bus.send(frame) == (k % 2 == 0 ? lpvg_can_event_recovering : lpvg_can_event_length));
    }
    CHECK(bus.supervisor.watch[LPVG_CAN_VDC2_INDEX].window_bad == 10U);
    for (int64_t k = 21; k <= 24; ++k) {
        CHECK(bus.state(LPVG_CAN_VDC2_INDEX) == lpvg_can_state_off);
        (void)bus.send(bus.vdc2(k));
    }
    CHECK(bus.state(LPVG_CAN_VDC2_INDEX) == lpvg_can_state_live);
}

TEST_CASE("only the supervised bits count: the others may hold anything", "[unit][can]") {
    CanBus bus;
    lpvg_can_frame_t frame{};
    frame.id = LPVG_CAN_EBC1_ID;
    frame.dlc = 8U;
    std::memset(frame.data, 0xFF, 8U);
    frame.data[0] = 0xDFU;  // ABS active: 01
    frame.data[1] = 0x00U;
    frame.t_us = CanBus::kStart + LPVG_CAN_EBC1_PERIOD_US;
    CHECK(bus.send(frame) == lpvg_can_event_recovering);
    CHECK(bus.supervisor.watch[LPVG_CAN_EBC1_INDEX].raw[0] == 1U);
    frame.data[0] = 0xEFU;  // 10: error
    frame.t_us += LPVG_CAN_EBC1_PERIOD_US;
    CHECK(bus.send(frame) == lpvg_can_event_invalid);
}

TEST_CASE("a value from before the switch-off, or before a bad frame while off, limits no gradient", "[unit][can]") {
    CanBus bus;
    const auto with = [&](int64_t k, float yaw_rate) {
        const auto raw = lpvg_can_encode(&lpvg_can_vdc2_yaw_rate, yaw_rate);
        auto f = bus.vdc2(k);
        f.data[3] = static_cast<uint8_t>(raw & 0xFFU);
        f.data[4] = static_cast<uint8_t>(raw >> 8U);
        return f;
    };
    const auto spoil = [&](int64_t k) {
        auto f = bus.vdc2(k);
        f.dlc = 7U;
        bus.send(f);
    };
    bus.run(1, 5);
    for (int64_t k = 6; k <= 10; ++k) {
        spoil(k);
    }
    REQUIRE(bus.state(LPVG_CAN_VDC2_INDEX) == lpvg_can_state_off);
    CHECK(bus.send(with(11, -1.4F)) == lpvg_can_event_recovering);  // 1.45 rad/s in 60 ms, were it one signal
    CHECK(bus.send(with(12, 1.4F)) == lpvg_can_event_gradient);     // but while recovering, gradients count
    CHECK(bus.send(with(13, 1.4F)) == lpvg_can_event_recovering);
    spoil(14);
    CHECK(bus.send(with(15, -1.4F)) == lpvg_can_event_recovering);
}

TEST_CASE("a frame exactly one smallest gap after the one before is not babbling", "[unit][can]") {
    CanBus bus;
    auto frame = bus.vdc2(1);
    CHECK(bus.send(frame) == lpvg_can_event_recovering);
    frame.t_us += lpvg_can_rules[LPVG_CAN_VDC2_INDEX].gap_min_us;
    CHECK(bus.send(frame) == lpvg_can_event_recovering);
    frame.t_us += lpvg_can_rules[LPVG_CAN_VDC2_INDEX].gap_min_us - 1;
    CHECK(bus.send(frame) == lpvg_can_event_early);
}

TEST_CASE("a frame too soon behind one that was refused is early, too", "[unit][can]") {
    CanBus bus;
    auto frame = bus.vdc2(1);
    frame.dlc = 7U;
    CHECK(bus.send(frame) == lpvg_can_event_length);
    frame.t_us += lpvg_can_rules[LPVG_CAN_VDC2_INDEX].gap_min_us - 1;
    CHECK(bus.send(frame) == lpvg_can_event_early);
}

TEST_CASE("any priority of the same group and source is the same message; another source is not", "[unit][can]") {
    CanBus bus;
    auto frame = bus.vdc2(1);
    frame.id = LPVG_CAN_EXTENDED | 0x0CF0093EU;
    CHECK(bus.send(frame) == lpvg_can_event_recovering);
    frame.id = LPVG_CAN_EXTENDED | 0x18F0093FU;
    CHECK(bus.send(frame) == lpvg_can_event_unknown_id);
    frame.id = 0x18F0093EU;  // not marked as extended
    CHECK(bus.send(frame) == lpvg_can_event_unknown_id);
    frame.id = LPVG_CAN_EXTENDED | LPVG_CAN_REMOTE | 0x18F0093EU;
    CHECK(bus.send(frame) == lpvg_can_event_unknown_id);
}

TEST_CASE("the first counter may be any, and a protected frame's signals are judged too", "[unit][can][REQ-CAN-4]") {
    CanBus bus;
    CHECK(bus.send(bus.guard_in(15)) == lpvg_can_event_recovering);  // counter 0
    auto frame = bus.guard_in(16);
    lpvg_can_guard_in_t in{};
    in.dp_measured = lpvg_can_encode(&lpvg_can_guard_in_dp_measured, 0.5F);
    in.yaw_rate_command = 0xFFFFU;
    in.control_request = 1U;
    REQUIRE(lpvg_can_guard_in_pack(&in, &frame) == lpvg_status_ok);
    frame.t_us = bus.guard_in(16).t_us;
    uint8_t counter = 1U;
    REQUIRE(lpvg_can_e2e_protect(&frame, LPVG_CAN_GUARD_IN_E2E_DATA_ID, &counter) == lpvg_status_ok);
    CHECK(bus.send(frame) == lpvg_can_event_absent);
}

TEST_CASE("the counter of a message: 15, a repetition and a jump are refused, a small step counts what was lost",
          "[unit][can][REQ-CAN-4]") {
    CanBus bus;
    const auto guard_in = LPVG_CAN_GUARD_IN_INDEX;
    const auto with = [&](int64_t k, uint8_t sent) {
        auto f = bus.guard_in(k);
        REQUIRE(lpvg_can_e2e_protect(&f, LPVG_CAN_GUARD_IN_E2E_DATA_ID, &sent) == lpvg_status_ok);
        return f;
    };
    bus.run(1, 5);
    REQUIRE(bus.state(guard_in) == lpvg_can_state_live);
    CHECK(bus.send(with(6, 5U)) == lpvg_can_event_repeated);
    CHECK(bus.send(with(7, 5U + LPVG_CAN_COUNTER_STEP)) == lpvg_can_event_accepted);
    CHECK(bus.count(guard_in, lpvg_can_event_lost) == LPVG_CAN_COUNTER_STEP - 1U);
    CHECK(bus.send(with(8, (6U + 2U * LPVG_CAN_COUNTER_STEP) % 15U)) == lpvg_can_event_sequence);
    // The only counter 15 that a receiver can see has a right checksum: any of the 256 may be it.
    unsigned refused = 0U;
    for (unsigned crc = 0U; crc < 256U; ++crc) {
        auto f = bus.guard_in(9);
        f.data[1] = static_cast<uint8_t>(f.data[1] | 0x0FU);
        f.data[0] = static_cast<uint8_t>(crc);
        CanBus fresh;
        refused += fresh.send(f) == lpvg_can_event_sequence ? 1U : 0U;
    }
    CHECK(refused == 1U);
}

TEST_CASE("an error frame is counted and changes no message; bus-off switches all off", "[unit][can][REQ-CAN-5]") {
    CanBus bus;
    bus.run(1, 5);
    lpvg_can_frame_t error{};
    error.id = LPVG_CAN_ERROR;
    error.t_us = bus.supervisor.now_us;
    const uint32_t* count = bus.supervisor.watch[LPVG_CAN_VDC2_INDEX].count;
    CHECK(count[lpvg_can_event_recovering] == LPVG_CAN_RECOVER_FRAMES - 1U);
    CHECK(count[lpvg_can_event_accepted] >= 1U);
    CHECK(bus.send(error) == lpvg_can_event_error);
    CHECK(bus.supervisor.count[lpvg_can_event_error] == 1U);
    CHECK(bus.state(LPVG_CAN_VDC2_INDEX) == lpvg_can_state_live);
    CHECK(bus.supervisor.bus_off == 0U);
    error.id |= LPVG_CAN_BUS_OFF;
    CHECK(bus.send(error) == lpvg_can_event_bus_off);
    CHECK(bus.state(LPVG_CAN_VDC2_INDEX) == lpvg_can_state_off);
    CHECK(bus.supervisor.bus_off == 1U);
}

TEST_CASE("limits of a signal are exact: the last good raw value and the first bad one", "[unit][can][REQ-CAN-4]") {
    struct Case {
        uint16_t raw;
        lpvg_can_event_t want;
    };
    // yaw rate of VDC2: supervised from -1.5 to 1.5 rad/s
    const auto c = GENERATE(Case{19825, lpvg_can_event_recovering}, Case{19824, lpvg_can_event_range},
                            Case{44400, lpvg_can_event_recovering}, Case{44401, lpvg_can_event_range}, Case{0xFAFF, lpvg_can_event_range},
                            Case{0xFB00, lpvg_can_event_range}, Case{0xFDFF, lpvg_can_event_range}, Case{0xFE00, lpvg_can_event_invalid},
                            Case{0xFEFF, lpvg_can_event_invalid}, Case{0xFF00, lpvg_can_event_absent}, Case{0xFFFF, lpvg_can_event_absent});
    CAPTURE(c.raw);
    CanBus bus;
    auto frame = bus.vdc2(1);
    frame.data[3] = static_cast<uint8_t>(c.raw & 0xFFU);
    frame.data[4] = static_cast<uint8_t>(c.raw >> 8U);
    CHECK(bus.send(frame) == c.want);
}

TEST_CASE("gradient: the largest allowed step passes, one more is rejected, a pause allows more", "[unit][can][REQ-CAN-4]") {
    CanBus bus;
    bus.run(1, 5);
    const auto base = lpvg_can_encode(&lpvg_can_vdc2_yaw_rate, 0.05F);
    const uint16_t limit = 820U;  // 10 rad/s2 * 8192 / (rad/s) * 10 ms, and one step of rounding
    const auto with = [&](int64_t k, unsigned raw) {
        auto frame = bus.vdc2(k);
        frame.data[3] = static_cast<uint8_t>(raw & 0xFFU);
        frame.data[4] = static_cast<uint8_t>(raw >> 8U);
        return frame;
    };
    SECTION("allowed") { CHECK(bus.send(with(6, base + limit)) == lpvg_can_event_accepted); }
    SECTION("too much, upwards") { CHECK(bus.send(with(6, base + limit + 1U)) == lpvg_can_event_gradient); }
    SECTION("too much, downwards") { CHECK(bus.send(with(6, base - limit - 1U)) == lpvg_can_event_gradient); }
    SECTION("two periods") { CHECK(bus.send(with(7, base + 2U * limit - 1U)) == lpvg_can_event_accepted); }
    SECTION("a limit without a remainder") {  // lateral acceleration: 150 m/s3 * 2048 / (m/s2) * 10 ms = 3072
        const auto lateral = lpvg_can_encode(&lpvg_can_vdc2_lateral_acceleration, 0.7F);
        for (const unsigned step : {3074U, 3073U}) {
            CanBus fresh = bus;
            auto frame = bus.vdc2(6);
            frame.data[5] = static_cast<uint8_t>((lateral + step) & 0xFFU);
            frame.data[6] = static_cast<uint8_t>((lateral + step) >> 8U);
            CHECK(fresh.send(frame) == (step == 3073U ? lpvg_can_event_accepted : lpvg_can_event_gradient));
        }
    }
    SECTION("a frame that comes early: as after one period") {
        auto frame = with(6, base + limit);
        frame.t_us -= LPVG_CAN_VDC2_PERIOD_US / 4;
        CHECK(bus.send(frame) == lpvg_can_event_accepted);
    }
    SECTION("two periods, too much") { CHECK(bus.send(with(7, base + 2U * limit)) == lpvg_can_event_gradient); }
}

TEST_CASE("a signal without codes and without a rate takes any change and every raw value of its range", "[unit][can]") {
    const lpvg_can_signal_rule_t plain = {4U, 16U, 0U, 0xFFFFU, 0U, 0U, 0U};  // in three bytes
    const lpvg_can_rule_t rules[] = {{1U, 0xFFFFFFFFU, 10'000U, 0U, 0U, 0U, 3U, 1U, &plain},
                                     {2U, 0xFFFFFFFFU, 10'000U, 0U, 0U, 0U, 0U, 0U, nullptr}};
    lpvg_can_supervisor_t self;
    REQUIRE(lpvg_can_init(&self, rules, 2U, 0) == lpvg_status_ok);
    uint8_t index = 0U;
    for (int64_t k = 1; k <= 10; ++k) {
        lpvg_can_frame_t frame{};
        frame.id = 1U;
        frame.dlc = 3U;
        frame.t_us = 10'000 * k;
        frame.data[0] = (k % 2 == 0) ? 0x1FU : 0xE0U;
        frame.data[1] = (k % 2 == 0) ? 0x32U : 0xCDU;
        frame.data[2] = (k % 2 == 0) ? 0xF4U : 0x0BU;
        CHECK(lpvg_can_receive(&self, &frame, &index) == (k < 5 ? lpvg_can_event_recovering : lpvg_can_event_accepted));
        CHECK(self.watch[0].raw[0] == (k % 2 == 0 ? 0x4321U : 0xBCDEU));
        frame.id = 2U;  // a message of no byte is a sign of life
        frame.dlc = 0U;
        lpvg_can_receive(&self, &frame, &index);
        CHECK(index == 1U);
    }
    CHECK(lpvg_can_state(&self, 1U) == lpvg_can_state_live);
}

TEST_CASE("the smallest codes and rates count", "[unit][can][REQ-CAN-4]") {
    const lpvg_can_signal_rule_t signals[] = {
        {0U, 8U, 0U, 255U, 0U, 1U, 0U}, {8U, 8U, 0U, 255U, 1U, 0U, 0U}, {16U, 8U, 0U, 255U, 0U, 0U, 1U}};
    const lpvg_can_rule_t rule = {1U, 0xFFFFFFFFU, 999'999U, 0U, 0U, 0U, 3U, 3U, signals};
    lpvg_can_supervisor_t self;
    REQUIRE(lpvg_can_init(&self, &rule, 1U, 0) == lpvg_status_ok);
    const auto event = [&](uint8_t absent, uint8_t error, uint8_t value) {
        lpvg_can_frame_t frame{};
        frame.id = 1U;
        frame.dlc = 3U;
        frame.t_us = self.now_us + 999'999;
        frame.data[0] = absent;
        frame.data[1] = error;
        frame.data[2] = value;
        uint8_t index = 0U;
        return lpvg_can_receive(&self, &frame, &index);
    };
    CHECK(event(0U, 0U, 7U) == lpvg_can_event_recovering);
    CHECK(event(0U, 0U, 8U) == lpvg_can_event_recovering);
    CHECK(event(0U, 0U, 10U) == lpvg_can_event_gradient);  // 1 a second and one of rounding, in a microsecond less than a second
    CHECK(event(1U, 0U, 10U) == lpvg_can_event_absent);
    CHECK(event(0U, 1U, 10U) == lpvg_can_event_invalid);
    REQUIRE(lpvg_can_init(&self, &rule, 1U, 0) == lpvg_status_ok);
    CHECK(event(0U, 0U, 0U) == lpvg_can_event_recovering);
    CHECK(event(0U, 0U, 1U) == lpvg_can_event_recovering);  // from zero too
}

TEST_CASE("a signal is read wherever it begins", "[unit][can]") {
    for (uint8_t start = 0U; start <= 48U; ++start) {
        const lpvg_can_signal_rule_t signal = {start, 16U, 0U, 0xFFFFU, 0U, 0U, 0U};
        const lpvg_can_rule_t rule = {1U, 0xFFFFFFFFU, 10'000U, 0U, 0U, 0U, 8U, 1U, &signal};
        lpvg_can_supervisor_t self;
        REQUIRE(lpvg_can_init(&self, &rule, 1U, 0) == lpvg_status_ok);
        const uint64_t bits = ~(uint64_t{0xFFFFU} << start) | (uint64_t{0xA5C3U} << start);
        lpvg_can_frame_t frame{};
        frame.id = 1U;
        frame.dlc = 8U;
        for (unsigned i = 0U; i < 8U; ++i) {
            frame.data[i] = static_cast<uint8_t>(bits >> (8U * i));
        }
        uint8_t index = 0U;
        CHECK(lpvg_can_receive(&self, &frame, &index) == lpvg_can_event_recovering);
        CAPTURE(start);
        CHECK(self.watch[0].raw[0] == 0xA5C3U);
    }
}

TEST_CASE("signals in the last bytes of a frame", "[unit][can]") {
    const lpvg_can_signal_rule_t last[] = {{56U, 8U, 0U, 0xFFU, 0U, 0U, 0U}, {48U, 16U, 0U, 0xFFFFU, 0U, 0U, 0U}};
    const lpvg_can_rule_t rule = {1U, 0xFFFFFFFFU, 10'000U, 0U, 0U, 0U, 8U, 2U, last};
    lpvg_can_supervisor_t self;
    REQUIRE(lpvg_can_init(&self, &rule, 1U, 0) == lpvg_status_ok);
    lpvg_can_frame_t frame{};
    frame.id = 1U;
    frame.dlc = 8U;
    frame.data[6] = 0x34U;
    frame.data[7] = 0x12U;
    uint8_t index = 0U;
    CHECK(lpvg_can_receive(&self, &frame, &index) == lpvg_can_event_recovering);
    CHECK(self.watch[0].raw[0] == 0x12U);
    CHECK(self.watch[0].raw[1] == 0x1234U);
}

TEST_CASE("counters saturate", "[unit][can]") {
    CanBus bus;
    bus.supervisor.count[lpvg_can_event_unknown_id] = UINT32_MAX;
    lpvg_can_frame_t frame{};
    frame.id = 1U;
    frame.t_us = CanBus::kStart;
    CHECK(bus.send(frame) == lpvg_can_event_unknown_id);
    CHECK(bus.supervisor.count[lpvg_can_event_unknown_id] == UINT32_MAX);
}

TEST_CASE("a frame from the queue may be a little older than the clock, no more", "[unit][can][REQ-CAN-8]") {
    CanBus bus;
    bus.run(1, 5);
    auto frame = bus.vdc2(6);
    lpvg_can_advance(&bus.supervisor, frame.t_us + LPVG_CAN_REORDER_US);
    CHECK(bus.send(frame) == lpvg_can_event_accepted);
    frame = bus.vdc2(7);
    lpvg_can_advance(&bus.supervisor, frame.t_us + LPVG_CAN_REORDER_US + 1);
    CHECK(bus.send(frame) == lpvg_can_event_backwards);
    CHECK(bus.supervisor.count[lpvg_can_event_backwards] == 1U);
    CHECK(bus.state(LPVG_CAN_VDC2_INDEX) == lpvg_can_state_live);
    lpvg_can_advance(&bus.supervisor, 0);  // the clock itself cannot go back
    CHECK(bus.supervisor.now_us == frame.t_us + LPVG_CAN_REORDER_US + 1);
}

TEST_CASE("the ends of the clock overflow nothing", "[unit][can][REQ-CAN-8]") {
    CanBus bus;
    bus.run(1, 5);
    lpvg_can_frame_t frame = bus.vdc2(6);
    frame.t_us = INT64_MIN;
    CHECK(bus.send(frame) == lpvg_can_event_backwards);
    frame.t_us = INT64_MAX;
    CHECK(bus.send(frame) == lpvg_can_event_recovering);
    CHECK(bus.state(LPVG_CAN_VDC2_INDEX) == lpvg_can_state_off);
    CHECK(bus.count(LPVG_CAN_VDC2_INDEX, lpvg_can_event_missed) == UINT32_MAX / LPVG_CAN_VDC2_PERIOD_US);
    CHECK(bus.send(frame) == lpvg_can_event_early);
}

TEST_CASE("cross-checks: agreement, each disagreement alone, confirmation and release", "[unit][can][REQ-CAN-6]") {
    lpvg_can_plausibility_t self{};
    const auto step = [&](float r, float ay, float v, float dv) {
        REQUIRE(lpvg_can_plausibility(&self, &kLimits, r, ay, v, dv) == lpvg_status_ok);
    };
    const float r = 0.1F, v = 15.0F, ay = r * v, dv = r * kLimits.track_m;
    for (int i = 0; i < 100; ++i) {
        step(r, ay, v, dv);
    }
    CHECK(self.flags == 0U);
    for (int i = 0; i < 4; ++i) {
        step(r, ay + 1.6F, v, dv);
        CHECK(self.flags == 0U);
    }
    step(r, kNan, v, dv);
    CHECK(self.score[0] == 4U);  // what cannot be judged is no agreement
    step(r, ay + 1.6F, v, dv);
    CHECK(self.flags == LPVG_CAN_IMPLAUSIBLE_LATERAL);
    for (int i = 0; i < 4; ++i) {
        step(r, ay, v, dv);
    }
    CHECK(self.flags == LPVG_CAN_IMPLAUSIBLE_LATERAL);
    step(r, ay, v, dv);
    CHECK(self.flags == 0U);
    for (int i = 0; i < 5; ++i) {
        CHECK(self.flags == 0U);
        step(r, ay, v, dv - 0.06F * kLimits.track_m);
    }
    CHECK(self.flags == LPVG_CAN_IMPLAUSIBLE_WHEELS);
    for (int i = 0; i < 100; ++i) {
        step(5.0F * r, 5.0F * ay, v, 5.0F * dv);
    }
    CHECK(self.flags == 0U);
}

TEST_CASE("cross-checks: a deviation of exactly the limit is none; long violation delays the release no further", "[unit][can]") {
    lpvg_can_plausibility_t self{};
    for (const float sign : {1.0F, -1.0F}) {
        for (int i = 0; i < 10; ++i) {  // 0.5 rad/s * 4 m/s - 0.5 m/s2 = 1.5 m/s2
            REQUIRE(lpvg_can_plausibility(&self, &kLimits, sign * 0.5F, sign * 0.5F, 4.0F, kNan) == lpvg_status_ok);
        }
        CHECK(self.score[0] == 0U);
    }
    for (int i = 0; i < 50; ++i) {  // at exactly the lowest speed that is judged
        REQUIRE(lpvg_can_plausibility(&self, &kLimits, 1.0F, 0.0F, kLimits.speed_min_mps, kNan) == lpvg_status_ok);
    }
    CHECK(self.flags == LPVG_CAN_IMPLAUSIBLE_LATERAL);
    CHECK(self.score[0] == kLimits.confirm);
    for (int i = 0; i < 5; ++i) {
        REQUIRE(lpvg_can_plausibility(&self, &kLimits, 0.0F, 0.0F, 4.0F, kNan) == lpvg_status_ok);
    }
    CHECK(self.flags == 0U);
}

TEST_CASE("cross-checks: a thousandth above a limit is a violation, a thousandth below is none", "[unit][can][REQ-CAN-6]") {
    const float r = GENERATE(0.0F, 0.8F), share = GENERATE(0.999F, 1.001F), v = 15.0F;
    lpvg_can_plausibility_t self{};
    const float ay = r * v + share * kLimits.lateral_mps2, dv = (r + share * kLimits.yaw_rps) * kLimits.track_m;
    REQUIRE(lpvg_can_plausibility(&self, &kLimits, r, ay, v, dv) == lpvg_status_ok);
    CHECK(self.score[0] == (share > 1.0F ? 1U : 0U));
    CHECK(self.score[1] == (share > 1.0F ? 1U : 0U));
}

TEST_CASE("cross-checks leave out what cannot be judged", "[unit][can][REQ-CAN-6]") {
    lpvg_can_plausibility_t self{};
    struct Case {
        float r, ay, v, dv;
    };
    const auto c = GENERATE(Case{kNan, 0.0F, 15.0F, 0.0F}, Case{1.0F, 0.0F, 2.9F, 0.0F}, Case{1.0F, 0.0F, kNan, 0.0F},
                            Case{kInf, 0.0F, 15.0F, 0.0F}, Case{1.0F, kNan, 15.0F, kInf});
    for (int i = 0; i < 20; ++i) {
        REQUIRE(lpvg_can_plausibility(&self, &kLimits, c.r, c.ay, c.v, c.dv) == lpvg_status_ok);
    }
    CHECK(self.flags == 0U);
    CHECK(self.score[0] + self.score[1] == 0);
}

TEST_CASE("cross-checks refuse limits that are not positive", "[unit][can][REQ-CAN-6]") {
    lpvg_can_plausibility_t self{};
    lpvg_can_plausibility_limits_t limits = kLimits;
    CHECK(lpvg_can_plausibility(nullptr, &limits, 0.0F, 0.0F, 10.0F, 0.0F) == lpvg_status_bad_argument);
    CHECK(lpvg_can_plausibility(&self, nullptr, 0.0F, 0.0F, 10.0F, 0.0F) == lpvg_status_bad_argument);
    const lpvg_can_plausibility_limits_t small = {0.5F, 0.5F, 0.5F, 0.5F, 1U};
    CHECK(lpvg_can_plausibility(&self, &small, 0.0F, 0.0F, 10.0F, 0.0F) == lpvg_status_ok);
    SECTION("track") { limits.track_m = 0.0F; }
    SECTION("track infinite") { limits.track_m = kInf; }
    SECTION("speed") { limits.speed_min_mps = kNan; }
    SECTION("speed 0") { limits.speed_min_mps = 0.0F; }
    SECTION("lateral") { limits.lateral_mps2 = -1.0F; }
    SECTION("lateral 0") { limits.lateral_mps2 = 0.0F; }
    SECTION("yaw") { limits.yaw_rps = 0.0F; }
    SECTION("confirm") { limits.confirm = 0U; }
    CHECK(lpvg_can_plausibility(&self, &limits, 0.0F, 0.0F, 10.0F, 0.0F) == lpvg_status_bad_argument);
}

TEST_CASE("DM1: one code, none, and what does not fit", "[unit][can][REQ-CAN-7]") {
    lpvg_can_frame_t frame{};
    frame.t_us = 42;
    const lpvg_can_dtc_t yaw = {1808U, 9U, 3U};
    REQUIRE(lpvg_can_dm1_pack(&frame, 0xFCU, LPVG_CAN_LAMP_AMBER, &yaw) == lpvg_status_ok);
    CHECK(frame.id == (LPVG_CAN_EXTENDED | 0x18FECAFCU));
    const uint8_t want[8] = {0x04, 0xFF, 0x10, 0x07, 0x09, 0x03, 0xFF, 0xFF};
    CHECK(std::memcmp(frame.data, want, 8U) == 0);
    CHECK(frame.t_us == 42);
    CHECK(frame.dlc == 8U);
    for (unsigned bit = 0U; bit < 19U; ++bit) {  // the number's bits lie in order, its three highest above the failure mode
        const lpvg_can_dtc_t one = {uint32_t{1U} << bit, 0U, 0U};
        REQUIRE(lpvg_can_dm1_pack(&frame, 0xFCU, 0U, &one) == lpvg_status_ok);
        const uint32_t place = bit < 16U ? bit : bit + 5U;
        CHECK((frame.data[2] | (frame.data[3] << 8U) | (static_cast<uint32_t>(frame.data[4]) << 16U)) == uint32_t{1U} << place);
    }

    const lpvg_can_dtc_t largest = {0x7FFFFU, 31U, 127U};
    REQUIRE(lpvg_can_dm1_pack(&frame, 0xFCU, 0x55U, &largest) == lpvg_status_ok);
    const uint8_t full[8] = {0x55, 0xFF, 0xFF, 0xFF, 0xFF, 0x7F, 0xFF, 0xFF};
    CHECK(std::memcmp(frame.data, full, 8U) == 0);

    REQUIRE(lpvg_can_dm1_pack(&frame, 0xFCU, 0U, nullptr) == lpvg_status_ok);
    const uint8_t none[8] = {0x00, 0xFF, 0x00, 0x00, 0x00, 0x00, 0xFF, 0xFF};
    CHECK(std::memcmp(frame.data, none, 8U) == 0);

    const lpvg_can_dtc_t bad[] = {{0x80000U, 0U, 0U}, {0U, 32U, 0U}, {0U, 0U, 128U}};
    for (const auto& dtc : bad) {
        CHECK(lpvg_can_dm1_pack(&frame, 0xFCU, 0U, &dtc) == lpvg_status_bad_argument);
    }
    CHECK(lpvg_can_dm1_pack(&frame, 0xFCU, 0x02U, nullptr) == lpvg_status_bad_argument);
    CHECK(lpvg_can_dm1_pack(nullptr, 0xFCU, 0U, nullptr) == lpvg_status_bad_argument);
    CHECK(std::memcmp(frame.data, none, 8U) == 0);
}

TEST_CASE("every event has a failure mode of J1939", "[unit][can][REQ-CAN-7]") {
    CHECK(lpvg_can_fmi(lpvg_can_event_missed) == 9U);
    CHECK(lpvg_can_fmi(lpvg_can_event_checksum) == 19U);
    CHECK(lpvg_can_fmi(lpvg_can_event_gradient) == 10U);
    CHECK(lpvg_can_fmi(lpvg_can_event_early) == 8U);
    CHECK(lpvg_can_fmi(lpvg_can_event_range) == 2U);
    CHECK(lpvg_can_fmi(lpvg_can_event_accepted) == 31U);
    for (int event = 0; event < lpvg_can_event_count; ++event) {
        CHECK(lpvg_can_fmi(static_cast<lpvg_can_event_t>(event)) <= 31U);
    }
}

TEST_CASE("a check that takes several samples fails at its score and holds until the score is back at nothing", "[unit][can][REQ-CAN-6]") {
    uint16_t score = 0U;
    bool failed = false;
    const bool violations[] = {true, true, false, true, true, false, false, false, true};
    const bool wanted[] = {false, false, false, false, true, true, true, false, false};
    for (std::size_t i = 0; i < sizeof violations; ++i) {
        failed = lpvg_can_confirm(&score, failed, violations[i], 3U);
        CHECK(failed == wanted[i]);
    }
    CHECK_FALSE(lpvg_can_confirm(nullptr, true, true, 1U));
}
