#include "../catch.hpp"

#include <cmath>
#include <cstddef>
#include <cstring>
#include <limits>
#include <map>
#include <vector>

#include "lpvguard/j1939.h"

namespace {

using Bytes = std::vector<uint8_t>;

constexpr int64_t step_us = 10'000;
constexpr uint8_t tool = 0xF9U;
constexpr uint64_t name_low = 0x000A'0000'0000'0001U, name_own = 0x000A'0000'0000'0100U, name_high = 0x000A'0000'0000'0200U;
constexpr uint64_t arbitrary = 1ULL << 63U;
constexpr uint32_t claim_pgn = 60928U, request_pgn = 59904U;

struct Message {
    uint32_t pgn;
    uint8_t source, priority, to;
    Bytes data;
    int64_t t_us;
};

uint32_t id_of(uint32_t pgn, uint8_t to, uint8_t source) {
    return LPVG_CAN_EXTENDED | 0x18000000U | (pgn << 8U) | (static_cast<uint32_t>(to) << 8U) | source;
}

lpvg_can_frame_t claim_of(uint8_t source, uint64_t name) {
    lpvg_can_frame_t frame{};
    frame.id = id_of(claim_pgn, 255U, source);
    frame.dlc = 8U;
    for (int i = 0; i < 8; ++i) {
        frame.data[i] = static_cast<uint8_t>(name >> (8 * i));
    }
    return frame;
}

lpvg_can_frame_t request_of(uint32_t pgn, uint8_t to, uint8_t source = tool) {
    lpvg_can_frame_t frame{};
    frame.id = id_of(request_pgn, to, source);
    frame.dlc = 3U;
    frame.data[0] = static_cast<uint8_t>(pgn);
    frame.data[1] = static_cast<uint8_t>(pgn >> 8U);
    frame.data[2] = static_cast<uint8_t>(pgn >> 16U);
    return frame;
}

// CRC-32 as ISO-HDLC defines it, bit by bit.
uint32_t divided(const void* bytes, size_t n) {
    uint32_t rest = 0xFFFFFFFFU;
    for (size_t i = 0; i < n; ++i) {
        rest ^= static_cast<const uint8_t*>(bytes)[i];
        for (int bit = 0; bit < 8; ++bit) {
            rest = (rest >> 1U) ^ ((rest & 1U) != 0U ? 0xEDB88320U : 0U);
        }
    }
    return ~rest;
}

uint32_t sum_of(lpvg_j1939_memory_t memory) {
    memory.crc32 = 0U;
    return divided(&memory, sizeof memory);
}

// A node on its bus, and whoever puts its packets together.
class Node {
public:
    explicit Node(uint8_t address = 0xFCU, uint64_t name = name_own) {
        std::memset(&memory, 0xA5, sizeof memory);
        start(address, name);
    }

    void start(uint8_t address = 0xFCU, uint64_t name = name_own) {
        const lpvg_j1939_config_t config = {name, address};
        left_ = 0U;
        REQUIRE(lpvg_j1939_init(&self, &config, &memory, now_us, &kept) == lpvg_status_ok);
    }

    // One step after a time, and what it sent; whole messages are added to `messages`.
    std::vector<lpvg_can_frame_t> step(const std::vector<lpvg_can_frame_t>& in = {}, int64_t us = step_us) {
        lpvg_can_frame_t out[LPVG_J1939_FRAMES_OUT];
        std::memset(out, 0xA5, sizeof out);
        size_t n = 99U;
        now_us += us;
        REQUIRE(lpvg_j1939_step(&self, now_us, in.data(), in.size(), &findings, out, LPVG_J1939_FRAMES_OUT, &n) == lpvg_status_ok);
        REQUIRE(n <= LPVG_J1939_FRAMES_OUT);
        for (size_t i = 0; i < n; ++i) {
            CHECK(reinterpret_cast<const uint8_t*>(&out[i])[offsetof(lpvg_can_frame_t, data) + 8U] == 0xA5U);  // nothing behind the data
            take(out[i]);
        }
        return {out, out + n};
    }

    void run(int64_t us) {
        for (int64_t until = now_us + us; now_us < until;) {
            step();
        }
    }

    void find(const std::vector<lpvg_can_dtc_t>& codes) {
        findings.n_codes = static_cast<uint8_t>(codes.size());
        for (size_t i = 0; i < codes.size(); ++i) {
            findings.code[i] = codes[i];
        }
    }

    std::vector<Message> of(uint32_t pgn) const {
        std::vector<Message> some;
        for (const Message& m : messages) {
            if (m.pgn == pgn) {
                some.push_back(m);
            }
        }
        return some;
    }

    // What one request is answered with, once the broadcast is over.
    std::vector<Message> ask(uint32_t pgn, uint8_t to = 255U) {
        messages.clear();
        step({request_of(pgn, to)});
        run(3'000'000);
        return of(pgn);
    }

    lpvg_j1939_t self;
    lpvg_j1939_memory_t memory;
    lpvg_j1939_findings_t findings{};
    std::vector<Message> messages;
    int64_t now_us = 1'000'000;
    bool kept = false;

private:
    void take(const lpvg_can_frame_t& frame) {
        CHECK(frame.t_us == now_us);
        CHECK(frame.dlc == 8U);
        const auto priority = static_cast<uint8_t>((frame.id >> 26U) & 7U);
        const auto source = static_cast<uint8_t>(frame.id);
        uint32_t pgn = (frame.id >> 8U) & 0x3FFFFU;
        uint8_t to = 255U;
        if ((pgn & 0xFF00U) < 0xF000U) {
            to = static_cast<uint8_t>(pgn);
            pgn &= 0x3FF00U;
        }
        if (pgn == 0xEC00U) {
            CHECK(priority == 7U);
            CHECK(to == 255U);
            CHECK(frame.data[0] == 32U);
            CHECK(frame.data[4] == 0xFFU);
            CHECK(left_ == 0U);  // one at a time
            left_ = size_ = static_cast<size_t>(frame.data[1] + 256U * frame.data[2]);
            CHECK(size_ > 8U);
            CHECK(frame.data[3] == (size_ + 6U) / 7U);
            pgn_ = frame.data[5] + 256U * frame.data[6] + 65536U * frame.data[7];
            received_.clear();
        } else if (pgn == 0xEB00U) {
            CHECK(priority == 7U);
            CHECK(to == 255U);
            REQUIRE(left_ > 0U);
            CHECK(now_us - packet_us_ >= 50'000);
            CHECK(now_us - packet_us_ <= 200'000);
            CHECK(frame.data[0] == received_.size() / 7U + 1U);
            const size_t n = left_ < 7U ? left_ : 7U;
            received_.insert(received_.end(), &frame.data[1], &frame.data[1] + n);
            for (size_t i = n; i < 7U; ++i) {
                CHECK(frame.data[1U + i] == 0xFFU);
            }
            left_ -= n;
            if (left_ == 0U) {
                messages.push_back({pgn_, source, priority, to, received_, now_us});
            }
        } else {
            CHECK(priority == 6U);
            messages.push_back({pgn, source, priority, to, Bytes(frame.data, frame.data + 8), now_us});
            return;
        }
        packet_us_ = now_us;
    }

    size_t left_ = 0U, size_ = 0U;
    uint32_t pgn_ = 0U;
    int64_t packet_us_ = 0;
    Bytes received_;
};

Bytes code(uint32_t spn, uint8_t fmi, uint8_t n) {
    return {static_cast<uint8_t>(spn), static_cast<uint8_t>(spn >> 8U), static_cast<uint8_t>(((spn >> 16U) << 5U) | fmi), n};
}

Bytes codes_message(uint8_t lamps, const std::vector<Bytes>& codes) {
    Bytes all = {lamps, 0xFFU};
    for (const Bytes& one : codes) {
        all.insert(all.end(), one.begin(), one.end());
    }
    all.resize(all.size() < 6U ? 6U : all.size(), 0U);
    all.resize(all.size() < 8U ? 8U : all.size(), 0xFFU);
    return all;
}

const lpvg_can_dtc_t dtc_a = {520201U, 31U, 0U}, dtc_b = {904U, 9U, 0U}, dtc_c = {520206U, 12U, 0U};

}  // namespace

TEST_CASE("the NAME is packed as J1939-81 draws it, and a field that is too large is refused", "[unit][j1939][REQ-J1939-1]") {
    uint64_t packed = 7U;
    lpvg_j1939_name_t name = {0x1FFFFFU, 0U, 0U, 0U, 0U, 0U, 0U, 0U, false};
    REQUIRE(lpvg_j1939_name_pack(&name, &packed) == lpvg_status_ok);
    CHECK(packed == 0x1FFFFFU);
    name = {1U, 0x7FFU, 0U, 0U, 0U, 0U, 0U, 0U, false};
    REQUIRE(lpvg_j1939_name_pack(&name, &packed) == lpvg_status_ok);
    CHECK(packed == ((0x7FFULL << 21U) | 1U));
    name = {1U, 0U, 7U, 0U, 0xABU, 0U, 0U, 0U, true};
    REQUIRE(lpvg_j1939_name_pack(&name, &packed) == lpvg_status_ok);
    CHECK(packed == (arbitrary | (0xABULL << 40U) | (7ULL << 32U) | 1U));
    name = {0U, 0U, 0U, 31U, 0U, 0x7FU, 15U, 7U, false};
    REQUIRE(lpvg_j1939_name_pack(&name, &packed) == lpvg_status_ok);
    CHECK(packed == ((31ULL << 35U) | (0x7FULL << 49U) | (15ULL << 56U) | (7ULL << 60U)));
    const uint64_t before = packed;
    for (int i = 0; i < 7; ++i) {
        lpvg_j1939_name_t bad{};
        bad.identity = i == 0 ? 0x200000U : 0U;
        bad.manufacturer = i == 1 ? 0x800U : 0U;
        bad.ecu_instance = i == 2 ? 8U : 0U;
        bad.function_instance = i == 3 ? 32U : 0U;
        bad.vehicle_system = i == 4 ? 128U : 0U;
        bad.system_instance = i == 5 ? 16U : 0U;
        bad.industry_group = i == 6 ? 8U : 0U;
        CHECK(lpvg_j1939_name_pack(&bad, &packed) == lpvg_status_bad_argument);
    }
    CHECK(lpvg_j1939_name_pack(nullptr, &packed) == lpvg_status_bad_argument);
    CHECK(lpvg_j1939_name_pack(&name, nullptr) == lpvg_status_bad_argument);
    CHECK(packed == before);
}

TEST_CASE("an address outside the arbitrary range is used with its claim, one in it 250 ms later", "[unit][j1939][REQ-J1939-1]") {
    const auto address = GENERATE(as<uint8_t>{}, 0, 127, 128, 247, 248, 253);
    Node node(address);
    CHECK(lpvg_j1939_address(&node.self) == LPVG_J1939_ADDRESS_NULL);
    CHECK(node.self.address == LPVG_J1939_ADDRESS_NULL);
    lpvg_can_frame_t frame{};
    frame.id = LPVG_CAN_EXTENDED | 0x0CFF01FDU;
    CHECK_FALSE(lpvg_j1939_pass(&node.self, &frame));
    node.step();
    REQUIRE(node.messages.size() >= 1U);
    CHECK(node.messages[0].pgn == claim_pgn);
    CHECK(node.messages[0].to == 255U);
    CHECK(node.messages[0].source == address);
    CHECK(node.messages[0].data == Bytes{0x00, 0x01, 0, 0, 0, 0, 0x0A, 0});
    CHECK(node.messages[0].priority == 6U);
    const bool waits = address >= 128U && address <= 247U;
    const int64_t claimed_us = node.now_us;
    while (lpvg_j1939_address(&node.self) == LPVG_J1939_ADDRESS_NULL) {
        CHECK(node.messages.size() == 1U);
        CHECK_FALSE(lpvg_j1939_pass(&node.self, &frame));
        node.step();
    }
    CHECK(node.now_us - claimed_us == (waits ? 250'000 : 0));
    CHECK(lpvg_j1939_address(&node.self) == address);
    CHECK(node.messages.size() == 2U);  // DM1 is next
    REQUIRE(lpvg_j1939_pass(&node.self, &frame));
    CHECK(frame.id == (LPVG_CAN_EXTENDED | 0x0CFF0100U | address));
    frame.id = LPVG_CAN_EXTENDED | 0x18FECAFCU;
    CHECK_FALSE(lpvg_j1939_pass(&node.self, &frame));  // this module sends it
    frame.id = LPVG_CAN_EXTENDED | 0x18FECBFCU;
    CHECK(lpvg_j1939_pass(&node.self, &frame));
    CHECK_FALSE(lpvg_j1939_pass(&node.self, nullptr));
    CHECK_FALSE(lpvg_j1939_pass(nullptr, &frame));
    CHECK(lpvg_j1939_address(nullptr) == LPVG_J1939_ADDRESS_NULL);
}

TEST_CASE("an address of the arbitrary range waits the whole 250 ms", "[unit][j1939][REQ-J1939-1]") {
    Node node(0x80U);
    node.step();
    node.step({}, static_cast<int64_t>(LPVG_J1939_CLAIM_US) - 1);
    CHECK(lpvg_j1939_address(&node.self) == LPVG_J1939_ADDRESS_NULL);
    node.step({}, 1);
    CHECK(lpvg_j1939_address(&node.self) == 0x80U);
    // A claim that is repeated begins the wait anew.
    Node again(0x80U);
    again.step();
    again.step({request_of(claim_pgn, 255U)}, 0);
    CHECK(again.messages.size() == 2U);
    again.run(240'000);
    again.step({request_of(claim_pgn, 255U)}, 0);
    CHECK(again.messages.size() == 3U);
    again.step({}, static_cast<int64_t>(LPVG_J1939_CLAIM_US) - 1);
    CHECK(lpvg_j1939_address(&again.self) == LPVG_J1939_ADDRESS_NULL);
    again.step({}, 1);
    CHECK(lpvg_j1939_address(&again.self) == 0x80U);
}

TEST_CASE("no time before that of init is taken, and DM1 goes out with the first address even at time 0", "[unit][j1939][REQ-J1939-4]") {
    Node node;
    lpvg_can_frame_t out[LPVG_J1939_FRAMES_OUT];
    size_t n = 0U;
    CHECK(lpvg_j1939_step(&node.self, node.now_us - 1, nullptr, 0U, &node.findings, out, LPVG_J1939_FRAMES_OUT, &n) ==
          lpvg_status_out_of_order);
    node.find({dtc_a});
    node.step();
    node.find({});
    node.now_us = 0;
    node.start();
    node.messages.clear();
    node.step({}, 0);
    CHECK(node.of(65226U).size() == 1U);
    node.find({dtc_a});  // remembered; never told in this run
    node.step({}, 500'000);
    CHECK(node.of(65226U).size() == 2U);
}

TEST_CASE("the lower NAME keeps the address", "[unit][j1939][REQ-J1939-2]") {
    Node node;
    node.step();
    node.messages.clear();
    node.step({claim_of(0xFCU, name_high)});
    REQUIRE(node.messages.size() == 1U);
    CHECK(node.messages[0].pgn == claim_pgn);
    CHECK(node.messages[0].source == 0xFCU);
    node.messages.clear();
    node.step({claim_of(0xFCU, name_own)});  // handed back by the driver
    node.step({claim_of(0x30U, name_low), claim_of(0x31U, name_high), claim_of(254U, name_low)});  // about others
    lpvg_can_frame_t other = claim_of(0xFCU, name_low);
    other.id = id_of(0xEC00U, 255U, 0xFCU);  // another group to all
    node.step({other});
    CHECK(node.messages.empty());
    CHECK(lpvg_j1939_address(&node.self) == 0xFCU);
    node.step({claim_of(0xFCU, name_low | arbitrary)});  // higher by its highest bit alone
    CHECK(lpvg_j1939_address(&node.self) == 0xFCU);
    Node last(253U);
    last.step();
    last.step({claim_of(253U, name_low)});
    CHECK(last.self.state == lpvg_j1939_state_lost);
}

TEST_CASE("who cannot take another address says so from 254, and nothing more", "[unit][j1939][REQ-J1939-2]") {
    Node node;
    node.step();
    node.messages.clear();
    node.find({dtc_a});
    node.step({claim_of(0xFCU, name_low)});
    const int64_t lost_us = node.now_us;
    CHECK(node.self.claim_us - lost_us == 38'000);
    CHECK(lpvg_j1939_address(&node.self) == LPVG_J1939_ADDRESS_NULL);
    node.run(2'000'000);
    REQUIRE(node.messages.size() == 1U);
    CHECK(node.messages[0].source == 254U);
    // NAME 0x000A0000'00000100 folds to 0x000A0100 = 655616, which leaves 38 ms: the step after.
    CHECK(node.messages[0].t_us - lost_us == 40'000);
    CHECK(node.messages[0].data == Bytes{0x00, 0x01, 0, 0, 0, 0, 0x0A, 0});
    node.messages.clear();
    node.step({request_of(claim_pgn, 254U), request_of(65226U, 255U), claim_of(254U, name_low)});  // and another who cannot
    node.run(1'000'000);
    CHECK(node.messages.empty());
    Node odd(0xFCU, name_own | 1U);  // of the NAME the highest bit alone says that it can
    odd.step();
    odd.step({claim_of(0xFCU, name_low)});
    CHECK(odd.self.state == lpvg_j1939_state_lost);
    node.step({request_of(claim_pgn, 255U)});
    CHECK(node.messages.empty());
    node.run(200'000);
    REQUIRE(node.messages.size() == 1U);
    CHECK(node.messages[0].source == 254U);
}

TEST_CASE("who can takes the next free address, and gives up when none is left", "[unit][j1939][REQ-J1939-2]") {
    const auto first = GENERATE(as<uint8_t>{}, 0x20, 246);
    Node node(first, name_own | arbitrary);
    node.step();
    const uint8_t next = first == 0x20U ? 130U : 247U;
    std::vector<lpvg_can_frame_t> others = {claim_of(first, name_low)};
    if (first == 0x20U) {
        others.insert(others.begin(), {claim_of(128U, name_low), claim_of(129U, name_low)});
    }
    node.messages.clear();
    node.step(others);
    REQUIRE(node.messages.size() == 1U);
    CHECK(node.messages[0].source == next);
    CHECK(lpvg_j1939_address(&node.self) == LPVG_J1939_ADDRESS_NULL);
    node.run(240'000);
    CHECK(lpvg_j1939_address(&node.self) == LPVG_J1939_ADDRESS_NULL);
    node.step();
    CHECK(lpvg_j1939_address(&node.self) == next);
    if (first == 246U) {  // round the end of the range
        node.step({claim_of(247U, name_low)});
        CHECK(node.messages.back().source == 128U);
    }
    for (uint32_t address = 128U; address <= 247U; ++address) {
        node.step({claim_of(static_cast<uint8_t>(address), name_low)});
    }
    node.messages.clear();
    node.run(1'000'000);
    REQUIRE(node.messages.size() == 1U);
    CHECK(node.messages[0].source == 254U);
    CHECK(node.self.state == lpvg_j1939_state_lost);
}

TEST_CASE("the search begins at the own address, outside of the range at its begin, and leaves none out", "[unit][j1939][REQ-J1939-2]") {
    const auto outside = GENERATE(as<uint8_t>{}, 0x20, 127, 248, 250, 253);
    Node node(outside, name_own | arbitrary);
    node.step();
    node.step({claim_of(outside, name_low)});
    CHECK(node.self.address == 128U);
    std::vector<lpvg_can_frame_t> others;
    for (uint32_t address = 129U; address < 247U; ++address) {
        others.push_back(claim_of(static_cast<uint8_t>(address), address % 2U == 0U ? name_low : name_high | arbitrary));
    }
    node.step(others);
    CHECK(node.self.address == 128U);
    node.step({claim_of(128U, name_low)});
    CHECK(node.self.address == 247U);
}

TEST_CASE("an address that is lost ends the broadcast, which begins anew from the next one", "[unit][j1939][REQ-J1939-2]") {
    Node node(0x80U, name_own | arbitrary);
    node.find({dtc_a, dtc_b});
    node.run(300'000);
    REQUIRE(node.self.broadcast.next > 0U);
    node.step({claim_of(0x80U, name_low)});
    CHECK(node.self.broadcast.next == 0U);
    CHECK(node.self.address == 0x81U);
}

TEST_CASE("requests: claim, refusal, and what is not looked at", "[unit][j1939][REQ-J1939-3]") {
    Node node;
    node.step();
    node.messages.clear();
    node.step({request_of(claim_pgn, 255U)});
    node.step({request_of(claim_pgn, 0xFCU, 254U)});  // somebody without an address asks
    REQUIRE(node.messages.size() == 2U);
    CHECK(node.messages[1].pgn == claim_pgn);
    CHECK(node.messages[1].source == 0xFCU);
    node.messages.clear();
    node.step({request_of(65262U, 0xFCU)});
    REQUIRE(node.messages.size() == 1U);
    CHECK(node.messages[0].pgn == 59392U);
    CHECK(node.messages[0].to == 255U);
    CHECK(node.messages[0].source == 0xFCU);
    CHECK(node.messages[0].data == Bytes{1U, 0xFFU, 0xFFU, 0xFFU, tool, 0xEEU, 0xFEU, 0x00U});
    node.messages.clear();
    node.step({request_of(65262U, 255U), request_of(65262U, 0x10U), request_of(65262U, 0xFCU, 254U)});
    lpvg_can_frame_t odd = request_of(65262U, 0xFCU);
    odd.dlc = 2U;
    node.step({odd});
    odd.dlc = 3U;
    for (const uint32_t flags : {LPVG_CAN_REMOTE, LPVG_CAN_ERROR}) {
        odd.id = request_of(65262U, 0xFCU).id | flags;
        node.step({odd});
    }
    odd.id &= ~(LPVG_CAN_EXTENDED | LPVG_CAN_ERROR);
    node.step({odd});
    odd.id = request_of(65262U, 0xFCU).id | 0x01000000U;  // another data page
    node.step({odd});
    odd = claim_of(0xFCU, name_low);
    odd.dlc = 7U;
    node.step({odd});
    odd.dlc = 8U;
    odd.id = (odd.id & ~0xFF00U) | 0x1000U;  // not to all
    node.step({odd});
    CHECK(node.messages.empty());
    CHECK(lpvg_j1939_address(&node.self) == 0xFCU);

    // Before the address may be used nothing is answered but claims, then or later.
    Node waiting(0x80U);
    waiting.step({request_of(65262U, 0x80U), request_of(64950U, 0x80U)});
    CHECK(waiting.messages.size() == 1U);
    waiting.run(500'000);
    CHECK(waiting.of(64950U).empty());
}

TEST_CASE("requests of and by the highest address, of DM1, and of a group of another data page", "[unit][j1939][REQ-J1939-3]") {
    Node node(253U);
    node.step();
    node.messages.clear();
    node.step({request_of(65226U, 253U, 253U)});
    REQUIRE(node.messages.size() == 1U);
    CHECK(node.messages[0].pgn == 65226U);
    node.step({request_of(0x1FECAU, 253U, 253U)});
    REQUIRE(node.messages.size() == 2U);
    CHECK(node.messages[1].data == Bytes{1U, 0xFFU, 0xFFU, 0xFFU, 253U, 0xCAU, 0xFEU, 0x01U});
}

TEST_CASE("a refused request forgets nothing", "[unit][j1939][REQ-J1939-3]") {
    Node node;
    node.find({dtc_a});
    node.step();
    node.find({});
    node.step();
    node.step({request_of(65262U, 0xFCU)});
    CHECK(lpvg_j1939_entry(&node.self, 0U) != nullptr);
}

TEST_CASE("each refusal says what it refuses, in the order of the requests, beside a message that waits", "[unit][j1939][REQ-J1939-3]") {
    Node node;
    node.run(500'000);
    node.find({dtc_a, dtc_b});
    node.step();  // the broadcast of DM1 begins
    node.messages.clear();
    node.step({request_of(65227U, 0xFCU), request_of(65262U, 0xFCU), request_of(65263U, 0xFCU, 0x21U)});
    const auto refused = node.of(59392U);
    REQUIRE(refused.size() == 2U);
    CHECK(refused[0].data == Bytes{1U, 0xFFU, 0xFFU, 0xFFU, tool, 0xEEU, 0xFEU, 0x00U});
    CHECK(refused[1].data == Bytes{1U, 0xFFU, 0xFFU, 0xFFU, 0x21U, 0xEFU, 0xFEU, 0x00U});
}

TEST_CASE("refusals beyond the places of a step are counted", "[unit][j1939][REQ-J1939-3]") {
    Node node;
    node.step();
    node.messages.clear();
    const std::vector<lpvg_can_frame_t> many(LPVG_J1939_REFUSALS_MAX + 2U, request_of(65262U, 0xFCU));
    node.step(many);
    CHECK(node.messages.size() == LPVG_J1939_REFUSALS_MAX);
    CHECK(node.self.unanswered == 2U);
    node.self.unanswered = UINT32_MAX - 1U;
    node.step(many);
    CHECK(node.self.unanswered == UINT32_MAX);
    CHECK(node.messages.size() == 2U * LPVG_J1939_REFUSALS_MAX);
}

TEST_CASE("DM1: one code in a frame, every second, and at once when a code comes or goes", "[unit][j1939][REQ-J1939-4]") {
    Node node;
    node.run(1'000'000);
    REQUIRE(node.of(65226U).size() == 1U);  // the first step is 10 ms after init
    CHECK(node.of(65226U)[0].data == codes_message(0U, {}));
    node.run(1'000'000);
    REQUIRE(node.of(65226U).size() == 2U);
    CHECK(node.of(65226U)[1].t_us - node.of(65226U)[0].t_us == 1'000'000);
    node.run(300'000);
    node.messages.clear();
    node.find({dtc_a});
    node.step();
    REQUIRE(node.of(65226U).size() == 1U);
    CHECK(node.of(65226U)[0].data == codes_message(LPVG_CAN_LAMP_AMBER, {code(520201U, 31U, 1U)}));
    const int64_t told_us = node.now_us;
    // Gone half a second later: the same code is told once a second, so by the next periodic one.
    node.run(500'000);
    node.find({});
    node.step();
    CHECK(node.of(65226U).size() == 1U);
    node.run(600'000);
    REQUIRE(node.of(65226U).size() == 2U);
    CHECK(node.of(65226U)[1].t_us - told_us == 1'000'000);
    CHECK(node.of(65226U)[1].data == codes_message(0U, {}));
    node.find({dtc_a});
    node.step();
    REQUIRE(node.of(65226U).size() == 3U);  // at once, for the second time
    CHECK(node.of(65226U)[2].data == codes_message(LPVG_CAN_LAMP_AMBER, {code(520201U, 31U, 2U)}));
    node.run(1'100'000);
    node.messages.clear();
    node.find({});
    node.step();
    CHECK(node.of(65226U).size() == 1U);
}

TEST_CASE("DM1: a code goes at once though another went just before", "[unit][j1939][REQ-J1939-4]") {
    Node node;
    node.run(500'000);
    node.find({dtc_a, dtc_b});
    node.run(2'500'000);
    node.find({dtc_b});
    node.step();
    node.messages.clear();
    node.find({});
    node.step();
    REQUIRE(node.of(65226U).size() == 1U);
    CHECK(node.of(65226U)[0].data == codes_message(0U, {}));
}

TEST_CASE("DM1: a microsecond before its second nothing is told, and other messages do not move it", "[unit][j1939][REQ-J1939-4]") {
    Node node;
    node.step();
    node.run(990'000);
    REQUIRE(node.of(65226U).size() == 1U);
    node.find({dtc_a});
    node.step();  // a second after the first, and at once
    REQUIRE(node.of(65226U).size() == 2U);
    node.find({});
    const auto early = node.step({}, 999'999);
    CHECK(early.empty());
    node.step({}, 1);
    CHECK(node.of(65226U).size() == 3U);
    node.step({request_of(65227U, 255U)}, 500'000);
    CHECK(node.of(65227U).size() == 1U);
    node.step({}, 499'999);
    CHECK(node.of(65226U).size() == 3U);
    node.step({}, 1);
    CHECK(node.of(65226U).size() == 4U);
}

TEST_CASE("DM1: a code in the place of a forgotten one is told at once", "[unit][j1939][REQ-J1939-4]") {
    const lpvg_can_dtc_t zero = {0U, 0U, 0U}, other = {7U, 0U, 0U};
    for (const lpvg_can_dtc_t& code : {zero, other}) {
        Node node;
        node.run(500'000);
        node.find({dtc_a});
        node.step();
        node.find({});
        node.step({request_of(65228U, 255U), request_of(65235U, 255U)});
        CHECK(lpvg_j1939_entry(&node.self, 0U) == nullptr);
        node.messages.clear();
        node.find({code});
        node.step();
        CHECK(node.of(65226U).size() == 1U);
    }
}

TEST_CASE("the occurrence of what is found is not read", "[unit][j1939][REQ-J1939-6]") {
    Node node;
    std::vector<lpvg_can_dtc_t> all;
    std::vector<Bytes> bytes;
    for (uint8_t i = 0U; i < LPVG_J1939_CODES_MAX; ++i) {
        all.push_back({520200U + i, 2U, 99U});
        bytes.push_back(code(520200U + i, 2U, 1U));
    }
    node.find(all);
    node.run(1'500'000);
    CHECK(node.of(65226U).back().data == codes_message(LPVG_CAN_LAMP_AMBER, bytes));
    CHECK(lpvg_j1939_entry(&node.self, LPVG_J1939_CODES_MAX - 1U) != nullptr);
    CHECK(lpvg_j1939_entry(&node.self, LPVG_J1939_CODES_MAX) == nullptr);
    node.findings.n_codes = 0U;
    node.step();
    for (uint8_t i = 0U; i < LPVG_J1939_CODES_MAX; ++i) {
        CHECK(lpvg_j1939_entry(&node.self, i)->active == 0U);
    }
    CHECK(node.ask(65227U).at(0).data == codes_message(0U, bytes));
}

TEST_CASE("a code takes the place of none that is active", "[unit][j1939][REQ-J1939-6]") {
    Node node;
    std::vector<lpvg_can_dtc_t> all;
    for (uint8_t i = 0U; i < LPVG_J1939_CODES_MAX; ++i) {
        all.push_back({1000U + i, 2U, 0U});
    }
    node.find(all);
    node.step();
    const auto gone = GENERATE(as<size_t>{}, 0, 5, 15);
    all[gone] = {600U, 9U, 0U};
    node.find(all);
    node.step();
    node.step();
    CHECK(node.memory.activations == LPVG_J1939_CODES_MAX + 1U);
    CHECK(node.memory.entry[gone].spn == 600U);
}

TEST_CASE("DM1: several codes are broadcast, the gravest first", "[unit][j1939][REQ-J1939-5]") {
    Node node;
    node.run(500'000);
    node.messages.clear();
    node.find({dtc_c, dtc_a, dtc_b});
    const int64_t found_us = node.now_us;
    const auto sent = node.step();
    REQUIRE(sent.size() == 1U);
    CHECK(sent[0].id == (LPVG_CAN_EXTENDED | 0x1CECFFFCU));
    const auto packet = node.step({}, 50'000);
    REQUIRE(packet.size() == 1U);
    CHECK(packet[0].id == (LPVG_CAN_EXTENDED | 0x1CEBFFFCU));
    node.run(200'000);
    REQUIRE(node.of(65226U).size() == 1U);
    CHECK(node.of(65226U)[0].data ==
          codes_message(LPVG_CAN_LAMP_AMBER, {code(520206U, 12U, 1U), code(520201U, 31U, 1U), code(904U, 9U, 1U)}));
    CHECK(node.of(65226U)[0].t_us - found_us == step_us + 2 * 50'000);
    // As many as there are: sixteen codes are 66 bytes, ten packets.
    std::vector<lpvg_can_dtc_t> all;
    std::vector<Bytes> bytes;
    for (uint8_t i = 0U; i < LPVG_J1939_CODES_MAX; ++i) {
        all.push_back({520200U + i, 2U, 0U});
        bytes.push_back(code(520200U + i, 2U, 1U));
    }
    node.messages.clear();
    node.find(all);
    node.run(600'000);
    REQUIRE(node.of(65226U).size() >= 1U);
    CHECK(node.of(65226U)[0].data == codes_message(LPVG_CAN_LAMP_AMBER, bytes));
    // Another code takes the place of one that is not active any more.
    all.back() = {600U, 9U, 0U};
    bytes.back() = code(600U, 9U, 1U);
    node.find(all);
    node.run(3'000'000);
    CHECK(node.of(65226U).back().data == codes_message(LPVG_CAN_LAMP_AMBER, bytes));
}

TEST_CASE("a broadcast whose last packet holds one byte, and the shortest time between packets", "[unit][j1939][REQ-J1939-5]") {
    Node node;
    node.run(500'000);
    node.messages.clear();
    node.find({{1U, 2U, 0U}, {2U, 2U, 0U}, {3U, 2U, 0U}, {4U, 2U, 0U}, {5U, 2U, 0U}});
    REQUIRE(node.step({request_of(65227U, 255U)}).size() == 1U);  // a step begins one message
    CHECK(node.of(65227U).empty());
    REQUIRE(node.step({}, 49'999).size() == 1U);
    CHECK(node.of(65227U).size() == 1U);
    CHECK(node.step({}, 1).size() == 1U);
    node.run(400'000);
    REQUIRE(node.of(65226U).size() == 1U);
    CHECK(node.of(65226U)[0].data.size() == 22U);
}

TEST_CASE("a broadcast waits for the one that runs, a single frame does not", "[unit][j1939][REQ-J1939-5]") {
    Node node;
    node.find({dtc_a, dtc_b});
    node.run(2'500'000);
    node.messages.clear();
    node.step({request_of(65229U, 255U)});
    REQUIRE(node.self.broadcast.next > 0U);
    node.step({request_of(65226U, 255U), request_of(65227U, 255U)});
    REQUIRE(node.messages.size() == 1U);
    CHECK(node.messages[0].pgn == 65227U);  // nothing was active before: one frame
    node.run(1'500'000);
    REQUIRE(node.messages.size() >= 3U);
    CHECK(node.messages[1].pgn == 65229U);
    CHECK(node.messages[2].pgn == 65226U);
}

TEST_CASE("DM2 tells what was active, DM3 forgets it, DM11 forgets what is", "[unit][j1939][REQ-J1939-6]") {
    Node node;
    CHECK(node.ask(65227U).at(0).data == codes_message(0U, {}));
    node.find({dtc_a, dtc_b, dtc_c});
    node.run(1'500'000);
    node.find({dtc_c});
    node.run(1'500'000);
    CHECK(node.ask(65227U).at(0).data == codes_message(LPVG_CAN_LAMP_AMBER, {code(520201U, 31U, 1U), code(904U, 9U, 1U)}));
    node.messages.clear();
    node.step({request_of(65228U, 0xFCU)});
    REQUIRE(node.of(59392U).size() == 1U);
    CHECK(node.of(59392U)[0].data == Bytes{0U, 0xFFU, 0xFFU, 0xFFU, tool, 0xCCU, 0xFEU, 0x00U});
    CHECK(node.ask(65227U).at(0).data == codes_message(LPVG_CAN_LAMP_AMBER, {}));
    // What is still present becomes active anew; what is not, is gone without a trace.
    node.find({dtc_a, dtc_c});
    node.run(1'500'000);
    node.find({dtc_c});
    node.run(1'500'000);
    node.find({dtc_a, dtc_c});
    node.run(1'500'000);
    CHECK(node.of(65226U).back().data == codes_message(LPVG_CAN_LAMP_AMBER, {code(520201U, 31U, 2U), code(520206U, 12U, 1U)}));
    node.messages.clear();
    node.find({dtc_a});
    node.step({request_of(65235U, 255U)});
    CHECK(node.of(59392U).empty());  // nobody acknowledges what all were asked
    CHECK(node.ask(65227U).at(0).data == codes_message(LPVG_CAN_LAMP_AMBER, {}));
    CHECK(node.of(65226U).back().data == codes_message(LPVG_CAN_LAMP_AMBER, {code(520201U, 31U, 1U)}));
    node.step({request_of(65235U, 0xFCU)});
    CHECK(node.of(59392U).size() == 1U);
}

TEST_CASE("the occurrence count and the counters stop at their ends", "[unit][j1939][REQ-J1939-6]") {
    Node node;
    for (int i = 0; i < 130; ++i) {
        node.find({dtc_a});
        node.step();
        node.find({});
        node.step();
    }
    CHECK(node.memory.entry[0].occurrence == 126U);
    CHECK(node.memory.activations == 130U);
    node.memory.activations = UINT32_MAX - 2U;
    for (const uint32_t number : {UINT32_MAX - 1U, UINT32_MAX, UINT32_MAX}) {
        node.find({dtc_a});
        node.step();
        CHECK(node.memory.activations == number);
        const bool shown = node.ask(64951U).at(0).data.size() > 8U;
        CHECK(shown == (number < UINT32_MAX));  // the last number is none
        node.find({});
        node.step();
    }
}

TEST_CASE("the memory survives a reset, its active codes as previously active ones", "[unit][j1939][REQ-J1939-7]") {
    Node node;
    CHECK_FALSE(node.kept);  // what was there had no right sum
    CHECK(node.memory.runs == 1U);
    node.findings.freeze = {5'000'000, 1.5F, 12.0F, 0U, 0x0040U, 3U, 1U};
    node.find({dtc_a, dtc_b});
    node.run(100'000);
    node.start();
    CHECK(node.kept);
    CHECK(node.memory.runs == 2U);
    node.find({});
    CHECK(node.ask(65227U).at(0).data == codes_message(0U, {code(520201U, 31U, 1U), code(904U, 9U, 1U)}));
    const lpvg_j1939_entry_t* entry = lpvg_j1939_entry(&node.self, 0U);
    REQUIRE(entry != nullptr);
    CHECK(entry->freeze.t_us == 5'000'000);
    CHECK(entry->freeze.statistic == 1.5F);
    CHECK(entry->freeze.speed == 12.0F);
    CHECK(entry->freeze.causes == 0x0040U);
    CHECK(entry->freeze.bin == 3U);
    CHECK(entry->freeze.test == 1U);
    CHECK(entry->freeze.sequence == 1U);
    CHECK(entry->run == 1U);
    node.find({dtc_a});
    node.step();
    CHECK(entry->occurrence == 2U);
    CHECK(entry->run == 2U);
    CHECK(lpvg_j1939_entry(&node.self, 2U) == nullptr);
    CHECK(lpvg_j1939_entry(&node.self, LPVG_J1939_CODES_MAX) == nullptr);
    CHECK(lpvg_j1939_entry(nullptr, 0U) == nullptr);
    lpvg_j1939_t fresh{};
    CHECK(lpvg_j1939_entry(&fresh, 0U) == nullptr);
}

TEST_CASE("a code that stays over a reset becomes active anew", "[unit][j1939][REQ-J1939-7]") {
    Node node;
    node.find({dtc_a});
    node.step();
    node.start();
    node.step();
    CHECK(node.memory.entry[0].occurrence == 2U);
}

TEST_CASE("DM3 leaves what is active as it is", "[unit][j1939][REQ-J1939-6]") {
    Node node;
    node.find({dtc_a});
    node.step();
    node.step({request_of(65228U, 0xFCU)});
    CHECK(node.memory.activations == 1U);
}

TEST_CASE("the memory's sum is the CRC-32 of its bytes after every change", "[unit][j1939][REQ-J1939-7]") {
    Node node;
    CHECK(node.memory.crc32 == sum_of(node.memory));
    node.find({dtc_a, dtc_b});
    node.step();
    CHECK(node.memory.crc32 == sum_of(node.memory));
    node.find({dtc_b});
    node.step();
    CHECK(node.memory.crc32 == sum_of(node.memory));
    node.step({request_of(65228U, 0xFCU)});
    CHECK(node.memory.crc32 == sum_of(node.memory));
    ++node.memory.version;  // of another build, whole
    node.memory.crc32 = sum_of(node.memory);
    node.start();
    CHECK_FALSE(node.kept);
}

TEST_CASE("the number of the run stays a number of the bus", "[unit][j1939][REQ-J1939-7]") {
    Node node;
    const uint8_t last = GENERATE(as<uint8_t>{}, 250, 251);
    while (node.memory.runs < last) {
        node.start();
    }
    node.find({dtc_a});
    node.step();
    CHECK(node.memory.entry[0].run == (last == 250U ? 250U : 0U));
}

TEST_CASE("every single bit that flips in the memory clears it", "[unit][j1939][REQ-J1939-7]") {
    Node node;
    node.find({dtc_a, dtc_b});
    node.run(100'000);
    const lpvg_j1939_memory_t good = node.memory;
    for (size_t bit = 0; bit < 8U * sizeof good; ++bit) {
        node.memory = good;
        reinterpret_cast<uint8_t*>(&node.memory)[bit / 8U] ^= static_cast<uint8_t>(1U << (bit % 8U));
        node.start();
        REQUIRE_FALSE(node.kept);
        REQUIRE(node.memory.runs == 1U);
        REQUIRE(lpvg_j1939_entry(&node.self, 0U) == nullptr);
    }
    node.memory = good;
    node.start();
    CHECK(node.kept);
}

TEST_CASE("DM4 and DM25 hold the freeze frames, the newest first, and DM24 says how", "[unit][j1939][REQ-J1939-8]") {
    Node node;
    CHECK(node.ask(65229U).at(0).data == Bytes{0, 0, 0, 0, 0, 0xFF, 0xFF, 0xFF});
    CHECK(node.ask(64951U).at(0).data == Bytes{0, 0, 0, 0, 0, 0xFF, 0xFF, 0xFF});
    const Bytes known = node.ask(64950U).at(0).data;
    CHECK(known == Bytes{84U,   0U,    0x1EU, 2U, 0x12U, 0xF0U, 0xFEU, 1U, 0x13U, 0xF0U, 0xFEU, 2U,
                         0x14U, 0xF0U, 0xFEU, 2U, 0x15U, 0xF0U, 0xFEU, 4U, 0x16U, 0xF0U, 0xFEU, 1U});
    // 12.5 m/s = 45 km/h = 11520 / 256; 1.5 = 1536 / 1024; 7 654 321 us = 7654 ms.
    node.findings.freeze = {7'654'321, 1.5F, 12.5F, 0U, 0x1240U, 9U, 0U};
    node.find({dtc_a});
    node.step();
    const Bytes held = {0x00U, 0x2DU, 9U, 0x00U, 0x06U, 0x40U, 0x12U, 0xE6U, 0x1DU, 0U, 0U, 1U};
    Bytes dm25 = {16U}, dm4 = {22U};
    for (const uint8_t byte : code(520201U, 31U, 1U)) {
        dm25.push_back(byte);
        dm4.push_back(byte);
    }
    dm4.insert(dm4.end(), 6U, 0xFFU);
    dm25.insert(dm25.end(), held.begin(), held.end());
    dm4.insert(dm4.end(), held.begin(), held.end());
    CHECK(node.ask(65229U).at(0).data == dm4);
    CHECK(node.ask(64951U, 0xFCU).at(0).data == dm25);

    // What is not known or does not fit.
    const float inf = std::numeric_limits<float>::infinity();
    node.findings.freeze = {INT64_MAX / 2, inf, NAN, 0U, 0U, 0U, 0U};
    node.find({dtc_a, dtc_b});
    node.step();
    const Bytes two = node.ask(64951U).at(0).data;
    REQUIRE(two.size() == 34U);
    CHECK(Bytes(two.begin() + 1, two.begin() + 5) == code(904U, 9U, 1U));
    CHECK(Bytes(two.begin() + 5, two.begin() + 17) == Bytes{0xFF, 0xFF, 0, 0xFF, 0xFA, 0, 0, 0xFF, 0xFF, 0xFF, 0xFA, 1U});
    CHECK(Bytes(two.begin() + 17, two.end()) == dm25);
    node.findings.freeze = {1'000, 62.75F, -1.0F, 0U, 0U, 0U, 0U};
    node.find({dtc_c});
    node.step();
    const Bytes third = node.ask(64951U).at(0).data;
    CHECK(Bytes(third.begin() + 5, third.begin() + 10) == Bytes{0, 0, 0, 0xFF, 0xFA});
    CHECK(Bytes(third.begin() + 12, third.begin() + 16) == Bytes{1, 0, 0, 0});  // a whole millisecond

    // Eight of many, the newest.
    for (uint8_t i = 0U; i < 10U; ++i) {
        node.find({{1000U + i, 2U, 0U}});
        node.step();
    }
    const Bytes many = node.ask(65229U).at(0).data;
    REQUIRE(many.size() == 8U * 23U);
    for (uint8_t i = 0U; i < 8U; ++i) {
        CHECK(Bytes(many.begin() + 23 * i + 1, many.begin() + 23 * i + 5) == code(1009U - i, 2U, 1U));
    }
    node.find({{1003U, 2U, 0U}});
    node.step();
    const Bytes again = node.ask(65229U).at(0).data;
    CHECK(Bytes(again.begin() + 1, again.begin() + 5) == code(1003U, 2U, 2U));
    CHECK(Bytes(again.begin() + 24, again.begin() + 28) == code(1009U, 2U, 1U));
}

TEST_CASE("arguments and times that make no sense change nothing", "[unit][j1939][REQ-J1939-9]") {
    Node node;
    node.find({dtc_a});
    node.run(50'000);
    const lpvg_j1939_t before = node.self;
    const lpvg_j1939_memory_t memory = node.memory;
    lpvg_can_frame_t out[LPVG_J1939_FRAMES_OUT], in{};
    size_t n = 99U;
    const int64_t t = node.now_us;
    const auto refused = [&](lpvg_status_t want, lpvg_j1939_t* self, int64_t now_us, const lpvg_can_frame_t* frames, size_t n_in,
                             const lpvg_j1939_findings_t* findings, lpvg_can_frame_t* frames_out, size_t max_out) {
        n = 99U;
        CHECK(lpvg_j1939_step(self, now_us, frames, n_in, findings, frames_out, max_out, &n) == want);
        CHECK(n == 0U);
    };
    const auto bad = lpvg_status_bad_argument;
    refused(bad, nullptr, t, &in, 1U, &node.findings, out, LPVG_J1939_FRAMES_OUT);
    refused(bad, &node.self, t, nullptr, 1U, &node.findings, out, LPVG_J1939_FRAMES_OUT);
    refused(bad, &node.self, t, &in, 1U, nullptr, out, LPVG_J1939_FRAMES_OUT);
    refused(bad, &node.self, t, &in, 1U, &node.findings, nullptr, LPVG_J1939_FRAMES_OUT);
    refused(bad, &node.self, t, &in, 1U, &node.findings, out, LPVG_J1939_FRAMES_OUT - 1U);
    CHECK(lpvg_j1939_step(&node.self, t, &in, 1U, &node.findings, out, LPVG_J1939_FRAMES_OUT, nullptr) == bad);
    lpvg_j1939_findings_t wrong = node.findings;
    wrong.n_codes = LPVG_J1939_CODES_MAX + 1U;
    refused(bad, &node.self, t, &in, 1U, &wrong, out, LPVG_J1939_FRAMES_OUT);
    wrong = node.findings;
    wrong.code[0].spn = 0x80000U;
    refused(bad, &node.self, t, &in, 1U, &wrong, out, LPVG_J1939_FRAMES_OUT);
    wrong = node.findings;
    wrong.code[0].fmi = 32U;
    refused(bad, &node.self, t, &in, 1U, &wrong, out, LPVG_J1939_FRAMES_OUT);
    wrong = node.findings;
    wrong.n_codes = 2U;
    wrong.code[1].fmi = 32U;
    refused(bad, &node.self, t, &in, 1U, &wrong, out, LPVG_J1939_FRAMES_OUT);
    refused(lpvg_status_out_of_order, &node.self, t - 1, &in, 1U, &node.findings, out, LPVG_J1939_FRAMES_OUT);
    refused(lpvg_status_out_of_order, &node.self, INT64_MAX / 2 + 1, &in, 1U, &node.findings, out, LPVG_J1939_FRAMES_OUT);
    lpvg_j1939_t fresh{};
    refused(lpvg_status_not_ready, &fresh, t, &in, 1U, &node.findings, out, LPVG_J1939_FRAMES_OUT);

    const lpvg_j1939_config_t config = {name_own, 253U}, above = {name_own, 254U};
    CHECK(lpvg_j1939_init(nullptr, &config, &node.memory, 0, nullptr) == bad);
    CHECK(lpvg_j1939_init(&node.self, nullptr, &node.memory, 0, nullptr) == bad);
    CHECK(lpvg_j1939_init(&node.self, &config, nullptr, 0, nullptr) == bad);
    CHECK(lpvg_j1939_init(&node.self, &above, &node.memory, 0, nullptr) == bad);
    CHECK(lpvg_j1939_init(&node.self, &config, &node.memory, -1, nullptr) == bad);
    CHECK(lpvg_j1939_init(&node.self, &config, &node.memory, INT64_MAX / 2 + 1, nullptr) == bad);
    CHECK(std::memcmp(&before, &node.self, sizeof before) == 0);
    CHECK(std::memcmp(&memory, &node.memory, sizeof memory) == 0);
    CHECK(lpvg_j1939_init(&node.self, &config, &node.memory, INT64_MAX / 2, nullptr) == lpvg_status_ok);
    node.find({{0x7FFFFU, 31U, 0U}});  // the largest numbers there are
    CHECK(lpvg_j1939_step(&node.self, INT64_MAX / 2, nullptr, 0U, &node.findings, out, LPVG_J1939_FRAMES_OUT, &n) == lpvg_status_ok);
    CHECK(n == 2U);
}
