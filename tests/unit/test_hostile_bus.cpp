// Attacks on what answers requests of the bus, from a fixed seed: frames of any content in j1939.h and xcp.h, payloads of any content in
// uds.h. Run under sanitizers too. Half of the frames begin as something that is listened to, so that they get behind the first check.
#include "../catch.hpp"

#include <algorithm>
#include <cstring>
#include <iterator>
#include <random>

#include "lpvguard/j1939.h"
#include "lpvguard/uds.h"
#include "lpvguard/xcp.h"

namespace {

constexpr uint8_t own_first = 0xFCU, global = 0xFFU;
constexpr uint64_t own_name = 0x8102030405060708U;  // can take another address

class Chance {
public:
    uint32_t of(uint32_t n) { return static_cast<uint32_t>(random_() % n); }
    uint8_t byte() { return static_cast<uint8_t>(random_()); }
    void fill(uint8_t* bytes, size_t n) {
        std::generate_n(bytes, n, [this] { return byte(); });
    }

private:
    std::mt19937_64 random_{20261123U};
};

uint32_t pgn_of(uint32_t id) {
    const uint32_t pgn = (id >> 8U) & 0x3FFFFU;
    return (pgn & 0xFF00U) < 0xF000U ? pgn & 0x3FF00U : pgn;
}

constexpr uint32_t pgn_request = 59904U, pgn_claim = 60928U, pgn_ack = 59392U, pgn_tp = 60416U, pgn_tp_data = 60160U, pgn_dm1 = 65226U;
constexpr uint32_t asked[] = {65226U, 65227U, 65228U, 65229U, 65235U, 64950U, 64951U, 60928U, 65262U};

lpvg_can_frame_t any_frame(Chance& chance) {
    lpvg_can_frame_t frame{};
    frame.id = (chance.of(8U) == 0U ? 0U : LPVG_CAN_EXTENDED) | (chance.of(1U << 29U));
    frame.dlc = static_cast<uint8_t>(chance.of(4U) == 0U ? chance.of(256U) : 8U);
    chance.fill(frame.data, sizeof frame.data);
    const auto source = chance.byte();
    const uint8_t to = chance.of(2U) == 0U ? own_first : global;
    if (chance.of(4U) == 0U) {  // a request
        const uint32_t pgn = asked[chance.of(static_cast<uint32_t>(std::size(asked)))];
        frame.id = LPVG_CAN_EXTENDED | 0x18EA0000U | uint32_t{to} << 8U | source;
        frame.dlc = 3U;
        for (uint32_t i = 0U; i < 3U; ++i) {
            frame.data[i] = static_cast<uint8_t>(pgn >> (8U * i));
        }
    } else if (chance.of(50U) == 0U) {  // a claim, often of the own address
        frame.id = LPVG_CAN_EXTENDED | 0x18EEFF00U | (chance.of(2U) == 0U ? own_first : source);
        frame.dlc = 8U;
    }
    return frame;
}

// What is sent has the sender's address, and DM1 is a lamp word and codes, padded.
bool well_formed(const lpvg_j1939_t& node, const lpvg_can_frame_t& frame, int64_t now_us) {
    const uint32_t pgn = pgn_of(frame.id);
    const auto source = static_cast<uint8_t>(frame.id & 0xFFU);
    const bool known = pgn == pgn_claim || pgn == pgn_ack || pgn == pgn_tp || pgn == pgn_tp_data ||
                       std::find(std::begin(asked), std::end(asked), pgn) != std::end(asked);
    const bool from_own = source == node.address || (pgn == pgn_claim && source == LPVG_J1939_ADDRESS_NULL);
    bool good = (frame.id & LPVG_CAN_EXTENDED) != 0U && frame.dlc == 8U && frame.t_us == now_us && known && from_own;
    if (pgn == pgn_claim) {
        uint64_t name = 0U;
        for (uint32_t i = 0U; i < 8U; ++i) {
            name |= uint64_t{frame.data[i]} << (8U * i);
        }
        good = good && name == own_name;
    }
    if (pgn == pgn_dm1) {
        good = good && frame.data[6] == 0xFFU && frame.data[7] == 0xFFU && (frame.data[0] == 0U || frame.data[0] == LPVG_CAN_LAMP_AMBER);
    }
    if (pgn == pgn_tp && frame.data[0] == 32U) {  // a broadcast is announced with as many packets as its bytes take
        const uint32_t bytes = frame.data[1] + 256U * frame.data[2];
        good = good && bytes > 8U && bytes <= LPVG_J1939_MESSAGE_MAX && frame.data[3] == (bytes + 6U) / 7U;
    }
    return good;
}

}  // namespace

TEST_CASE("any frames leave the J1939 node with a good address and good messages",
          "[unit][hostile][j1939][REQ-J1939-2][REQ-J1939-3][REQ-J1939-9]") {
    Chance chance;
    lpvg_j1939_memory_t memory{};
    lpvg_j1939_t node;
    const lpvg_j1939_config_t config = {own_name, own_first};
    size_t wrong = 0U, sent = 0U, broadcasts = 0U, lost = 0U, moved = 0U, refused = 0U;
    for (int episode = 0; episode < 40; ++episode) {
        std::memset(&memory, 0, sizeof memory);
        REQUIRE(lpvg_j1939_init(&node, &config, &memory, 0, nullptr) == lpvg_status_ok);
        lpvg_j1939_findings_t findings{};
        int64_t now_us = 0;
        for (int k = 0; k < 2'000; ++k) {
            if (chance.of(30U) == 0U) {
                findings.n_codes = static_cast<uint8_t>(chance.of(LPVG_J1939_CODES_MAX + 1U));
                for (uint8_t i = 0U; i < findings.n_codes; ++i) {
                    findings.code[i] = {520'200U + i, static_cast<uint8_t>(chance.of(4U)), 0U};
                }
            }
            lpvg_can_frame_t in[6], out[LPVG_J1939_FRAMES_OUT];
            const size_t n_in = chance.of(7U);
            std::generate_n(in, n_in, [&chance] { return any_frame(chance); });
            size_t n_out = 99U;
            const int64_t next_us = now_us + (chance.of(100U) == 0U ? -1 : 10'000);
            const lpvg_status_t status = lpvg_j1939_step(&node, next_us, in, n_in, &findings, out, LPVG_J1939_FRAMES_OUT, &n_out);
            const bool late = next_us < now_us && k > 0;
            now_us = status == lpvg_status_ok ? next_us : now_us;
            wrong += (status == lpvg_status_ok) == (late || next_us < 0) ? 1U : 0U;
            refused += status != lpvg_status_ok ? 1U : 0U;
            wrong += n_out > (status == lpvg_status_ok ? LPVG_J1939_FRAMES_OUT : 0U) ? 1U : 0U;
            for (size_t i = 0U; i < n_out; ++i) {
                wrong += well_formed(node, out[i], now_us) ? 0U : 1U;
                broadcasts += pgn_of(out[i].id) == pgn_tp ? 1U : 0U;
            }
            sent += n_out;
            const uint8_t address = lpvg_j1939_address(&node);
            wrong += address == own_first || (address >= 128U && address <= 247U) || address == LPVG_J1939_ADDRESS_NULL ? 0U : 1U;
            wrong += node.state == lpvg_j1939_state_claimed ? (address == node.address ? 0U : 1U)
                                                            : (address == LPVG_J1939_ADDRESS_NULL ? 0U : 1U);
            lost += node.state == lpvg_j1939_state_lost ? 1U : 0U;
            moved += address >= 128U && address <= 247U ? 1U : 0U;

            uint8_t request[12], answer[LPVG_UDS_ANSWER_MAX + 1U];
            const size_t n = chance.of(sizeof request + 1U), max = chance.of(LPVG_UDS_ANSWER_MAX + 1U);
            chance.fill(request, sizeof request);
            request[0] = chance.of(3U) == 0U ? request[0] : (chance.of(2U) == 0U ? uint8_t{0x19} : uint8_t{0x22});
            request[1] = chance.of(2U) == 0U ? request[1] : static_cast<uint8_t>(request[0] == 0x22 ? 0x4C : 2U * chance.of(4U));
            request[2] = chance.of(2U) == 0U ? request[2] : static_cast<uint8_t>(chance.of(3U));
            std::memset(answer, 0xA5, sizeof answer);
            const lpvg_j1939_t before = node;
            const lpvg_j1939_memory_t kept = memory;
            const size_t length = lpvg_uds_answer(&node, request, n, answer, max);
            wrong += length <= max && answer[max] == 0xA5U ? 0U : 1U;
            if (length > 0U) {
                const bool negative = answer[0] == 0x7FU && length == 3U && answer[1] == request[0];
                wrong += negative || answer[0] == static_cast<uint8_t>(request[0] + 0x40U) ? 0U : 1U;
            }
            wrong += std::memcmp(&before, &node, sizeof node) == 0 && std::memcmp(&kept, &memory, sizeof memory) == 0 ? 0U : 1U;
        }
    }
    CAPTURE(sent, broadcasts, lost, moved, refused);
    CHECK(wrong == 0U);
    CHECK((sent > 10'000U && broadcasts > 1'000U && moved > 1'000U && refused > 100U));
}

TEST_CASE("any commands leave memory alone, and XCP sends nothing else than it", "[unit][hostile][xcp][REQ-XCP-2][REQ-XCP-5]") {
    constexpr uint32_t place = 0x20000000U, to_slave = 0x98EF27F9U, to_master = 0x98EFF927U;
    constexpr uint8_t inside = 0x5CU, outside = 0xA3U;
    uint8_t memory[64];
    std::memset(memory, outside, sizeof memory);
    std::memset(memory + 16, inside, 32U);
    const lpvg_xcp_range_t range = {place, 32U, memory + 16};
    const lpvg_xcp_config_t config = {to_slave, to_master, "hostile", &range, 1U, 10'000U};
    lpvg_xcp_t slave;
    REQUIRE(lpvg_xcp_init(&slave, &config) == lpvg_status_ok);
    Chance chance;
    size_t wrong = 0U, answered = 0U, listed = 0U;
    const uint8_t in_order[] = {0xD6U, 0xD5U, 0xD4U, 0xD3U, 0xE2U, 0xE1U, 0xE0U, 0xDEU};
    uint32_t next = 0U;
    for (int k = 0; k < 1'000'000; ++k) {
        lpvg_can_frame_t command{}, answer{};
        command.id = chance.of(20U) == 0U ? chance.of(UINT32_MAX) : to_slave;
        command.dlc = static_cast<uint8_t>(chance.of(10U) == 0U ? chance.of(256U) : 8U);
        chance.fill(command.data, sizeof command.data);
        if (chance.of(10U) == 0U) {
            command.data[0] = 0xFFU;
            next = 0U;
        }
        if (chance.of(8U) != 0U) {  // the next command of a list, mostly with parameters that it takes
            const uint8_t good[][8] = {{0xD6U},
                                       {0xD5U, 0U, 1U, 0U},
                                       {0xD4U, 0U, 0U, 0U, 1U},
                                       {0xD3U, 0U, 0U, 0U, 0U, 2U},
                                       {0xE2U},
                                       {0xE1U, 0xFFU, static_cast<uint8_t>(1U + chance.of(8U)), 0U},
                                       {0xE0U, 0U, 0U, 0U, 0U, 0U, 1U, 0U},
                                       {0xDEU, 1U}};
            std::memcpy(command.data, good[next], 8U);
            if (in_order[next] == 0xE1U) {
                const uint32_t address = place - 8U + chance.of(48U);
                std::memcpy(&command.data[4], &address, sizeof address);
            }
            next = (next + 1U) % static_cast<uint32_t>(std::size(in_order));
            command.data[chance.of(8U)] ^= chance.of(12U) == 0U ? chance.byte() : uint8_t{0};
        }
        if (lpvg_xcp_receive(&slave, &command, &answer)) {
            ++answered;
            wrong += answer.id == to_master && answer.dlc >= 1U && answer.dlc <= 8U && answer.data[0] >= 0xFEU ? 0U : 1U;
            wrong += command.id == to_slave && (slave.connected || command.data[0] == 0xFEU) ? 0U : 1U;
            const bool upload =
                answer.data[0] == 0xFFU && (command.data[0] == 0xF4U || (command.data[0] == 0xF5U && slave.text == nullptr));
            for (uint8_t i = 1U; upload && i < answer.dlc; ++i) {
                wrong += answer.data[i] == inside ? 0U : 1U;
            }
        }
        lpvg_can_frame_t list[LPVG_XCP_ODTS_MAX];
        const size_t n = lpvg_xcp_event(&slave, k, list, LPVG_XCP_ODTS_MAX);
        listed += n;
        wrong += n <= LPVG_XCP_ODTS_MAX && (n == 0U || slave.connected) ? 0U : 1U;
        for (size_t i = 0U; i < n; ++i) {
            wrong += list[i].id == to_master && list[i].dlc >= 2U && list[i].dlc <= 8U && list[i].data[0] == i ? 0U : 1U;
            for (uint8_t b = 1U; b < list[i].dlc; ++b) {
                wrong += list[i].data[b] == inside ? 0U : 1U;
            }
        }
    }
    CAPTURE(answered, listed);
    CHECK(wrong == 0U);
    CHECK((answered > 100'000U && listed > 1'000U));
    CHECK(std::count(memory, memory + sizeof memory, inside) == 32);
    CHECK(std::count(memory, memory + sizeof memory, outside) == 32);
}
