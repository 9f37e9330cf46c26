// Authentication of the messages that command: published vectors, then an ECU whose bus has an attacker.
#include "../../firmware_sim/ports/test_key.hpp"
#include "ecu_bench.hpp"
#include "lpvguard/authentication.h"

#include <array>

namespace {

constexpr uint8_t key[16] = {0x2b, 0x7e, 0x15, 0x16, 0x28, 0xae, 0xd2, 0xa6, 0xab, 0xf7, 0x15, 0x88, 0x09, 0xcf, 0x4f, 0x3c};
AesCmac cmac(key);

lpvg_can_auth_config_t config() { return {AesCmac::hook, &cmac, 0x8CFF01F0U, 0x8CFF02F0U, 0xE3FFFFFFU, 5'000U, 0x4C01U}; }

lpvg_can_frame_t message(uint8_t value, int64_t t_us, uint8_t dlc = 8U) {
    lpvg_can_frame_t frame{};
    frame.id = config().id;
    frame.dlc = dlc;
    frame.data[0] = value;
    frame.t_us = t_us;
    return frame;
}

struct Pair {
    lpvg_can_auth_t sender, receiver;
    lpvg_can_frame_t out{};
    explicit Pair(uint64_t freshness = 0U) {
        const auto with = config();
        REQUIRE(lpvg_can_auth_init(&sender, &with, freshness) == lpvg_status_ok);
        REQUIRE(lpvg_can_auth_init(&receiver, &with, freshness) == lpvg_status_ok);
    }
    lpvg_can_frame_t authenticator(const lpvg_can_frame_t& of) {
        lpvg_can_frame_t made{};
        REQUIRE(lpvg_can_auth_protect(&sender, &of, &made) == lpvg_status_ok);
        return made;
    }
    lpvg_can_auth_event_t take(const lpvg_can_frame_t& frame) { return lpvg_can_auth_receive(&receiver, &frame, &out); }
};

// The firmware on a bus with the bench's frames, each command followed by its authenticator, and with what `beside` adds.
class Firmware {
public:
    Firmware(Bench& bench, const firmware_key_t* key) : bench_(bench) {
        REQUIRE(firmware_authenticate(&sender_, test_key()) == lpvg_status_ok);
        REQUIRE(firmware_init(&of, &bus_, &bench_config, key, 0) == lpvg_status_ok);
        bench.filter = [this](const Frames& frames) {
            for (const auto& frame : frames) {
                received_.push_back(frame);
                if (frame.id == LPVG_CAN_GUARD_IN_ID) {
                    recording.push_back({frame, {}});
                    REQUIRE(lpvg_can_auth_protect(&sender_, &frame, &recording.back()[1]) == lpvg_status_ok);
                    received_.push_back(recording.back()[1]);
                }
            }
            return frames;
        };
    }
    void step() {
        bench_.step();
        REQUIRE(firmware_tick(&of, bench_.now_us) == lpvg_status_ok);
        CHECK(received_.empty());
    }
    void beside(lpvg_can_frame_t frame, int64_t t_us) {
        frame.t_us = t_us;
        received_.push_back(frame);
    }

    using Frames = std::vector<lpvg_can_frame_t>;
    firmware_t of{};
    std::vector<std::array<lpvg_can_frame_t, 2>> recording;

private:
    static bool send(void*, const lpvg_can_frame_t*) { return true; }
    static bool receive(void* self, int64_t, lpvg_can_frame_t* frame) {
        Frames& frames = static_cast<Firmware*>(self)->received_;
        if (frames.empty()) {
            return false;
        }
        *frame = frames.front();
        frames.erase(frames.begin());
        return true;
    }

    Bench& bench_;
    bus_t bus_{this, send, receive};
    lpvg_can_auth_t sender_;
    Frames received_;
};

bool same_report(const Bench& bench, const Firmware& firmware) {
    return std::memcmp(&bench.ecu.report, &firmware.of.ecu.report, sizeof bench.ecu.report) == 0;
}

}  // namespace

TEST_CASE("the simulation's CMAC gives the published vectors", "[unit][auth]") {
    // FIPS 197 appendix B, then SP 800-38B appendix D.1: 0, 16, 40 and 64 bytes.
    uint8_t block[16] = {0x32, 0x43, 0xf6, 0xa8, 0x88, 0x5a, 0x30, 0x8d, 0x31, 0x31, 0x98, 0xa2, 0xe0, 0x37, 0x07, 0x34};
    cmac.encrypt(block);
    const uint8_t cipher[16] = {0x39, 0x25, 0x84, 0x1d, 0x02, 0xdc, 0x09, 0xfb, 0xdc, 0x11, 0x85, 0x97, 0x19, 0x6a, 0x0b, 0x32};
    CHECK(std::memcmp(block, cipher, sizeof block) == 0);
    const uint8_t text[64] = {0x6b, 0xc1, 0xbe, 0xe2, 0x2e, 0x40, 0x9f, 0x96, 0xe9, 0x3d, 0x7e, 0x11, 0x73, 0x93, 0x17, 0x2a,
                              0xae, 0x2d, 0x8a, 0x57, 0x1e, 0x03, 0xac, 0x9c, 0x9e, 0xb7, 0x6f, 0xac, 0x45, 0xaf, 0x8e, 0x51,
                              0x30, 0xc8, 0x1c, 0x46, 0xa3, 0x5c, 0xe4, 0x11, 0xe5, 0xfb, 0xc1, 0x19, 0x1a, 0x0a, 0x52, 0xef,
                              0xf6, 0x9f, 0x24, 0x45, 0xdf, 0x4f, 0x9b, 0x17, 0xad, 0x2b, 0x41, 0x7b, 0xe6, 0x6c, 0x37, 0x10};
    struct Vector {
        std::size_t n;
        uint8_t mac[16];
    };
    const Vector vectors[] = {
        {0, {0xbb, 0x1d, 0x69, 0x29, 0xe9, 0x59, 0x37, 0x28, 0x7f, 0xa3, 0x7d, 0x12, 0x9b, 0x75, 0x67, 0x46}},
        {16, {0x07, 0x0a, 0x16, 0xb4, 0x6b, 0x4d, 0x41, 0x44, 0xf7, 0x9b, 0xdd, 0x9d, 0xd0, 0x4a, 0x28, 0x7c}},
        {40, {0xdf, 0xa6, 0x67, 0x47, 0xde, 0x9a, 0xe6, 0x30, 0x30, 0xca, 0x32, 0x61, 0x14, 0x97, 0xc8, 0x27}},
        {64, {0x51, 0xf0, 0xbe, 0xbf, 0x7e, 0x3b, 0x9d, 0x92, 0xfc, 0x49, 0x74, 0x17, 0x79, 0x36, 0x3c, 0xfe}},
    };
    for (const Vector& v : vectors) {
        uint8_t mac[16];
        cmac.mac(text, v.n, mac);
        CAPTURE(v.n);
        CHECK(std::memcmp(mac, v.mac, sizeof mac) == 0);
    }
}

TEST_CASE("the authenticator is the freshness and the head of the CMAC over what is documented", "[unit][auth][REQ-AUTH-1]") {
    Pair pair(0x0102030405060708U - 1U);
    lpvg_can_frame_t frame = message(0xA5U, 7, 3U);
    frame.data[7] = 0xEEU;  // beyond dlc: not sent
    const auto made = pair.authenticator(frame);
    const uint8_t data[LPVG_CAN_AUTH_BYTES] = {0x4C, 0x01, 3, 0xA5, 0, 0, 0, 0, 0, 0, 0, 1, 2, 3, 4, 5, 6, 7, 8};
    uint8_t mac[16];
    cmac.mac(data, sizeof data, mac);
    CHECK(made.id == config().auth_id);
    CHECK(made.dlc == 8U);
    CHECK(made.t_us == 7);
    CHECK(made.data[0] == 8U);
    CHECK(made.data[1] == 7U);
    CHECK(std::memcmp(&made.data[2], mac, 6) == 0);
    CHECK(pair.sender.freshness == 0x0102030405060708U);
}

TEST_CASE("a message passes with its authenticator, once, as it came", "[unit][auth][REQ-AUTH-1]") {
    Pair pair;
    for (int64_t k = 0; k < 70'000; ++k) {  // beyond the freshness bits that are sent
        const auto frame = message(static_cast<uint8_t>(k), 10'000 * k);
        auto made = pair.authenticator(frame);
        if (k % 1000 != 1) {
            continue;  // lost, nearly all of them
        }
        made.t_us += 600;
        REQUIRE(pair.take(frame) == lpvg_can_auth_waiting);
        REQUIRE(pair.take(made) == lpvg_can_auth_passed);
        REQUIRE(std::memcmp(&pair.out, &frame, sizeof frame) == 0);
        REQUIRE(pair.take(frame) == lpvg_can_auth_waiting);
        REQUIRE(pair.take(made) == lpvg_can_auth_forged);  // replayed at once
    }
    CHECK(pair.receiver.count[lpvg_can_auth_passed] == 70U);
    CHECK(pair.receiver.freshness == 69'002U);
    lpvg_can_frame_t other = message(1U, 0);
    other.id = 0x98FEF100U;
    CHECK(pair.take(other) == lpvg_can_auth_other);
    CHECK(std::memcmp(&pair.out, &other, sizeof other) == 0);
}

TEST_CASE("an identifier is the message's where it agrees under the mask, and only there", "[unit][auth][REQ-AUTH-1]") {
    for (unsigned bit = 0U; bit < 32U; ++bit) {
        Pair pair;
        auto frame = message(1U, 0);
        frame.id ^= uint32_t{1} << bit;
        const bool masked = (config().id_mask >> bit & 1U) == 0U;
        CAPTURE(bit);
        CHECK(pair.take(frame) == (masked ? lpvg_can_auth_waiting : lpvg_can_auth_other));
        auto with = config();
        with.auth_id = with.id ^ (uint32_t{1} << bit);
        CHECK(lpvg_can_auth_init(&pair.sender, &with, 0U) == (masked ? lpvg_status_bad_argument : lpvg_status_ok));
    }
}

TEST_CASE("the freshness that is sent in part goes on beyond its second overflow", "[unit][auth][REQ-AUTH-1]") {
    Pair pair(0x2FFFEU);
    for (const uint64_t next : {0x2FFFFU, 0x30000U, 0x30001U}) {
        CHECK(pair.take(message(1U, 0)) == lpvg_can_auth_waiting);
        CHECK(pair.take(pair.authenticator(message(1U, 0))) == lpvg_can_auth_passed);
        CHECK(pair.receiver.freshness == next);
    }
}

TEST_CASE("every bit of message and authenticator counts, and so do key and data id", "[unit][auth][REQ-AUTH-2]") {
    Pair pair;
    const auto frame = message(0x5AU, 0);
    const auto made = pair.authenticator(frame);
    std::size_t passed = 0;
    for (unsigned bit = 0U; bit < 128U; ++bit) {
        auto a = frame, b = made;
        uint8_t* const byte = bit < 64U ? &a.data[bit / 8U] : &b.data[(bit - 64U) / 8U];
        *byte = static_cast<uint8_t>(*byte ^ (1U << (bit % 8U)));
        CHECK(pair.take(a) == lpvg_can_auth_waiting);
        passed += pair.take(b) == lpvg_can_auth_passed ? 1U : 0U;
        pair.receiver.n_waiting = 0U;
    }
    CHECK(passed == 0U);
    pair.receiver.config.data_id = 0x4C02U;
    CHECK(pair.take(frame) == lpvg_can_auth_waiting);
    CHECK(pair.take(made) == lpvg_can_auth_forged);
    pair.receiver.config.data_id = 0x4C01U;
    const uint8_t wrong_key[16] = {1};
    AesCmac wrong(wrong_key);
    pair.receiver.config.context = &wrong;
    CHECK(pair.take(made) == lpvg_can_auth_forged);
    pair.receiver.config.context = &cmac;
    CHECK(pair.take(made) == lpvg_can_auth_passed);
    auto shorter = message(0x5AU, 0, 7U);
    const auto second = pair.authenticator(message(0x5AU, 0));
    CHECK(pair.take(shorter) == lpvg_can_auth_waiting);
    CHECK(pair.take(second) == lpvg_can_auth_forged);
}

TEST_CASE("a message that an attacker puts before the authenticator does not push the genuine one out; more of them do",
          "[unit][auth][REQ-AUTH-2]") {
    const int injected = GENERATE(0, 1, 2);
    Pair pair;
    const auto frame = message(1U, 0);
    const auto made = pair.authenticator(frame);
    CHECK(pair.take(frame) == lpvg_can_auth_waiting);
    for (int i = 0; i < injected; ++i) {
        CHECK(pair.take(message(99U, 100)) == lpvg_can_auth_waiting);
    }
    CHECK(pair.take(made) == (injected < 2 ? lpvg_can_auth_passed : lpvg_can_auth_forged));
    CHECK((injected == 2 || pair.out.data[0] == 1U));
}

TEST_CASE("two messages wait, the newest ones, and an authenticator finds either of them", "[unit][auth][REQ-AUTH-1][REQ-AUTH-2]") {
    const std::size_t genuine = GENERATE(0U, 1U, 2U), sent = GENERATE(1U, 2U, 3U);
    if (genuine >= sent) {
        return;
    }
    Pair pair;
    const auto made = pair.authenticator(message(static_cast<uint8_t>(genuine), static_cast<int64_t>(genuine)));
    for (std::size_t i = 0; i < sent; ++i) {
        CHECK(pair.take(message(static_cast<uint8_t>(i), static_cast<int64_t>(i))) == lpvg_can_auth_waiting);
    }
    const bool waits = genuine + 2U >= sent;
    CHECK(pair.take(made) == (waits ? lpvg_can_auth_passed : lpvg_can_auth_forged));
    CHECK((!waits || pair.out.data[0] == genuine));
}

TEST_CASE("a message that no longer waits does not pass", "[unit][auth][REQ-AUTH-2]") {
    Pair pair;
    const auto first = message(1U, 0), second = message(2U, 1), third = message(3U, 2);
    const auto of_first = pair.authenticator(first), of_second = pair.authenticator(second);
    CHECK(pair.take(first) == lpvg_can_auth_waiting);
    CHECK(pair.take(second) == lpvg_can_auth_waiting);
    CHECK(pair.take(of_first) == lpvg_can_auth_passed);
    CHECK(pair.take(of_second) == lpvg_can_auth_alone);
    CHECK(pair.take(third) == lpvg_can_auth_waiting);
    CHECK(pair.take(of_second) == lpvg_can_auth_forged);
}

TEST_CASE("each next freshness is known by its low bits, odd and even, and none comes again behind the last", "[unit][auth][REQ-AUTH-2]") {
    Pair pair;
    std::vector<lpvg_can_frame_t> recorded;
    for (int64_t k = 0; k < 4; ++k) {
        const auto frame = message(static_cast<uint8_t>(k), k, 1U);  // one byte is a message, too
        recorded.push_back(pair.authenticator(frame));
        CHECK(pair.take(frame) == lpvg_can_auth_waiting);
        CHECK(pair.take(recorded.back()) == lpvg_can_auth_passed);
        CHECK(pair.receiver.freshness == static_cast<uint64_t>(k) + 1U);
    }
    Pair last(UINT64_MAX);  // a recording from the beginning of the count
    for (int64_t k = 0; k < 4; ++k) {
        CHECK(last.take(message(static_cast<uint8_t>(k), k, 1U)) == lpvg_can_auth_waiting);
        CHECK(last.take(recorded[static_cast<std::size_t>(k)]) == lpvg_can_auth_forged);
    }
}

TEST_CASE("a message waits for its authenticator as long as it may, on a clock that may be any", "[unit][auth][REQ-AUTH-2]") {
    struct Times {
        int64_t message_us, authenticator_us;
        bool passes;
    };
    const Times t = GENERATE(values<Times>({
        {1'000, 6'000, true},
        {1'000, 6'001, false},
        {9'000, 4'000, true},
        {9'000, 3'999, false},
        {INT64_MAX, 0, false},
        {0, INT64_MAX, false},
    }));
    Pair pair;
    const auto frame = message(1U, t.message_us);
    auto made = pair.authenticator(frame);
    made.t_us = t.authenticator_us;
    CHECK(pair.take(frame) == lpvg_can_auth_waiting);
    CHECK(pair.take(made) == (t.passes ? lpvg_can_auth_passed : lpvg_can_auth_alone));
}

TEST_CASE("wrong lengths, missing arguments, a hook that fails and the last freshness are refused", "[unit][auth][REQ-AUTH-3]") {
    Pair pair;
    auto with = config();
    lpvg_can_auth_t cleared{};
    lpvg_can_frame_t out{};
    const auto frame = message(1U, 0);
    CHECK(lpvg_can_auth_init(nullptr, &with, 0U) == lpvg_status_bad_argument);
    CHECK(lpvg_can_auth_init(&cleared, nullptr, 0U) == lpvg_status_bad_argument);
    with.cmac = nullptr;
    CHECK(lpvg_can_auth_init(&cleared, &with, 0U) == lpvg_status_bad_argument);
    with = config();
    with.auth_id = with.id ^ ~with.id_mask;
    CHECK(lpvg_can_auth_init(&cleared, &with, 0U) == lpvg_status_bad_argument);
    with = config();
    with.pair_us = 0U;
    CHECK(lpvg_can_auth_init(&cleared, &with, 0U) == lpvg_status_bad_argument);
    CHECK(lpvg_can_auth_receive(&cleared, &frame, &out) == lpvg_can_auth_none);
    CHECK(lpvg_can_auth_receive(nullptr, &frame, &out) == lpvg_can_auth_none);
    CHECK(lpvg_can_auth_receive(&pair.receiver, nullptr, &out) == lpvg_can_auth_none);
    CHECK(lpvg_can_auth_receive(&pair.receiver, &frame, nullptr) == lpvg_can_auth_none);
    CHECK(lpvg_can_auth_protect(nullptr, &frame, &out) == lpvg_status_bad_argument);
    CHECK(lpvg_can_auth_protect(&pair.sender, nullptr, &out) == lpvg_status_bad_argument);
    CHECK(lpvg_can_auth_protect(&pair.sender, &frame, nullptr) == lpvg_status_bad_argument);
    CHECK(lpvg_can_auth_protect(&cleared, &frame, &out) == lpvg_status_not_ready);
    for (const uint8_t dlc : {uint8_t{0}, uint8_t{9}, uint8_t{64}}) {
        const auto wrong = message(1U, 0, dlc);
        CHECK(lpvg_can_auth_protect(&pair.sender, &wrong, &out) == lpvg_status_bad_argument);
        CHECK(pair.take(wrong) == lpvg_can_auth_length);
    }
    auto made = pair.authenticator(frame);
    made.dlc = 7U;
    CHECK(pair.take(frame) == lpvg_can_auth_waiting);
    CHECK(pair.take(made) == lpvg_can_auth_length);
    made.dlc = 8U;
    for (const uint8_t damaged : {uint8_t{LPVG_CAN_AUTH_WAITING + 1U}, uint8_t{200}}) {
        CHECK(pair.take(frame) == lpvg_can_auth_waiting);
        pair.receiver.n_waiting = damaged;
        CHECK(pair.take(made) == lpvg_can_auth_alone);
    }

    pair.receiver.config.cmac = pair.sender.config.cmac = [](void*, const uint8_t*, size_t, uint8_t*) { return false; };
    const uint64_t before = pair.sender.freshness;
    CHECK(lpvg_can_auth_protect(&pair.sender, &frame, &out) == lpvg_status_bad_sample);
    CHECK(pair.sender.freshness == before);
    CHECK(pair.take(frame) == lpvg_can_auth_waiting);
    CHECK(pair.take(made) == lpvg_can_auth_forged);

    Pair last(UINT64_MAX - 1U);
    made = last.authenticator(frame);
    CHECK(lpvg_can_auth_protect(&last.sender, &frame, &out) == lpvg_status_not_ready);
    CHECK(last.take(frame) == lpvg_can_auth_waiting);
    CHECK(last.take(made) == lpvg_can_auth_passed);
    made.data[0] = made.data[1] = 0U;  // nothing is above the newest
    CHECK(last.take(frame) == lpvg_can_auth_waiting);
    CHECK(last.take(made) == lpvg_can_auth_forged);
    last.receiver.count[lpvg_can_auth_forged] = UINT32_MAX - 1U;
    for (int i = 0; i < 2; ++i) {
        CHECK(last.take(made) == lpvg_can_auth_forged);
        CHECK(last.receiver.count[lpvg_can_auth_forged] == UINT32_MAX);
    }
}

TEST_CASE("an attacker who knows counter, checksum and every frame sent gets no step of the ECU", "[unit][auth][ecu][REQ-AUTH-2]") {
    // Frames as the bus of the bench has them; the second sender inserts one after each genuine one, or a recording is played bench.
    const bool replayed = GENERATE(false, true);
    lpvg_can_auth_t sender, receiver;
    auto with = config();
    with.id = LPVG_CAN_GUARD_IN_ID;
    with.auth_id = lpvg_bus.authenticator_id;
    REQUIRE(lpvg_can_auth_init(&sender, &with, 0U) == lpvg_status_ok);
    REQUIRE(lpvg_can_auth_init(&receiver, &with, 0U) == lpvg_status_ok);
    Bench bench;
    std::vector<lpvg_can_frame_t> recording;
    std::size_t commanded = 0U, engaged = 0U, replays = 0U;
    bench.filter = [&](const std::vector<lpvg_can_frame_t>& frames) {
        std::vector<lpvg_can_frame_t> bus, out;
        for (const auto& frame : frames) {
            bus.push_back(frame);
            if (frame.id == LPVG_CAN_GUARD_IN_ID) {
                lpvg_can_frame_t made{};
                REQUIRE(lpvg_can_auth_protect(&sender, &frame, &made) == lpvg_status_ok);
                bus.push_back(made);
                if (bench.k > 300 && replayed) {  // the genuine pair is gone, one from before is in its place
                    bus.resize(bus.size() - 2U);
                    ++replays;
                    for (std::size_t i = 0; i < 2U; ++i) {
                        auto old = recording[(2U * replays + i) % recording.size()];
                        old.t_us = frame.t_us;
                        bus.push_back(old);
                    }
                } else if (bench.k > 300) {
                    auto forged = frame;
                    uint8_t counter = static_cast<uint8_t>((frame.data[1] + 1U) % LPVG_CAN_COUNTERS);
                    forged.data[3] = 0xFFU;
                    REQUIRE(lpvg_can_e2e_protect(&forged, LPVG_CAN_GUARD_IN_E2E_DATA_ID, &counter) == lpvg_status_ok);
                    bus.push_back(forged);
                    made.data[7] ^= 1U;
                    bus.push_back(made);
                }
                if (bench.k <= 300) {
                    recording.push_back(frame);
                    recording.push_back(made);
                }
            }
        }
        for (const auto& frame : bus) {
            lpvg_can_frame_t passed{};
            const auto event = lpvg_can_auth_receive(&receiver, &frame, &passed);
            if (event == lpvg_can_auth_passed || event == lpvg_can_auth_other) {
                commanded += bench.k > 300 && event == lpvg_can_auth_passed && passed.data[3] == 0xFFU ? 1U : 0U;
                out.push_back(passed);
            }
        }
        return out;
    };
    bench.run_until_engaged();
    while (bench.k < 301) {
        bench.step();
    }
    REQUIRE(bench.engaged());
    for (int i = 0; i < 500; ++i) {
        bench.step();
        engaged += i >= 5 && bench.engaged() ? 1U : 0U;
    }
    CHECK(commanded == 0U);
    CHECK(engaged == (replayed ? 0U : 495U));  // the genuine sender still steers; without it the loop is released
}

TEST_CASE("the firmware refuses a replayed command in one of five frames, counts it, and obeys the genuine ones alone",
          "[unit][auth][ecu][REQ-AUTH-2][REQ-AUTH-4]") {
    const bool whole = GENERATE(true, false);  // with its authenticator, or alone
    Bench bench;
    Firmware attacked(bench, test_key());
    uint32_t replays = 0U;
    for (int i = 0; i < 2'000; ++i) {
        bench.command = 0.05F + 0.0001F * static_cast<float>(i % 100);
        attacked.step();
        CHECK(same_report(bench, attacked));
        if (i >= 14 && i % 5 == 0) {  // it has the next frame's counter and comes 2 ms before that one
            const auto& old = attacked.recording[attacked.recording.size() - 15U];
            attacked.beside(old[0], bench.now_us + tick_us - 2'000);
            if (whole) {
                attacked.beside(old[1], bench.now_us + tick_us - 2'000);
            }
            ++replays;
        }
    }
    CHECK(bench.engaged());
    CHECK(attacked.of.ecu.report.authenticated == 1U);
    CHECK(attacked.of.authentication.count[lpvg_can_auth_forged] == (whole ? replays : 0U));
    CHECK(attacked.of.authentication.count[lpvg_can_auth_waiting] == 2'000U + replays);
    CHECK(attacked.of.authentication.count[lpvg_can_auth_passed] == 2'000U);
}

TEST_CASE("a firmware without a key obeys every command and says so in each report", "[unit][auth][ecu][REQ-AUTH-4]") {
    lpvg_ecu_config_t keyless = bench_config;
    keyless.authenticated = false;
    Bench bench(keyless);
    Firmware firmware(bench, nullptr);
    for (int i = 0; i < 300; ++i) {
        firmware.step();
        CHECK(same_report(bench, firmware));
        CHECK(firmware.of.ecu.report.authenticated == 0U);
    }
    CHECK(bench.engaged());
    CHECK(firmware.of.authentication.count[lpvg_can_auth_passed] == 0U);
}

TEST_CASE("a firmware with a key obeys no command without an authenticator, and refuses a key without a hook",
          "[unit][auth][ecu][REQ-AUTH-4]") {
    firmware_key_t without = *test_key();
    without.cmac = nullptr;
    firmware_t firmware{};
    const bus_t bus{};
    CHECK(firmware_init(&firmware, &bus, &bench_config, &without, 0) == lpvg_status_bad_argument);
    CHECK(firmware_init(&firmware, &bus, nullptr, test_key(), 0) == lpvg_status_bad_argument);
    Bench bench;
    Firmware other(bench, test_key());
    bench.filter = [](const std::vector<lpvg_can_frame_t>& frames) { return frames; };
    for (int i = 0; i < 100; ++i) {
        bench.step();
        for (const auto& frame : bench.handed) {
            other.beside(frame, frame.t_us);
        }
        REQUIRE(firmware_tick(&other.of, bench.now_us) == lpvg_status_ok);
    }
    CHECK(bench.live());
    CHECK(other.of.ecu.report.supervision == lpvg_can_state_off);
    CHECK(other.of.ecu.report.demand == 0.0F);
}
