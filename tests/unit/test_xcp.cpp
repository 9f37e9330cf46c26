// The XCP slave that only reads: answers byte by byte, then every command of every length against memory that it must not touch.
#include "../catch.hpp"
#include "heap_counter.hpp"
#include "lpvguard/xcp.h"

#include <algorithm>
#include <cstring>
#include <string>
#include <vector>

namespace {

using Bytes = std::vector<uint8_t>;
constexpr uint32_t from_master = 0x98EF27F9U, to_master = 0x98EFF927U;
constexpr uint32_t low = 0x20000100U, top = 0xFFFFFFFCU;

// Memory whose bytes say where they are, between guards that no range names.
struct Slave {
    uint8_t memory[32];
    uint8_t end_of_memory[4] = {0xA0, 0xA1, 0xA2, 0xA3};
    lpvg_xcp_range_t ranges[2] = {{low, 16U, memory + 8}, {top, 4U, end_of_memory}};
    lpvg_xcp_config_t config = {from_master, to_master, "truck 1", ranges, 2U};
    lpvg_xcp_t xcp;
    lpvg_can_frame_t out{};

    Slave() {
        for (uint8_t i = 0; i < sizeof memory; ++i) {
            memory[i] = i >= 8U && i < 24U ? static_cast<uint8_t>(0x40U + i - 8U) : uint8_t{0xEE};
        }
        REQUIRE(lpvg_xcp_init(&xcp, &config) == lpvg_status_ok);
    }
    bool send(const Bytes& bytes, uint32_t id = from_master) {
        lpvg_can_frame_t frame{};
        frame.id = id;
        frame.dlc = static_cast<uint8_t>(bytes.size());
        std::copy_n(bytes.begin(), std::min<size_t>(bytes.size(), 8U), frame.data);
        frame.t_us = 77;
        return lpvg_xcp_receive(&xcp, &frame, &out);
    }
    Bytes ask(const Bytes& bytes) {
        REQUIRE(send(bytes));
        CHECK((out.id == to_master && out.t_us == 77));
        return Bytes(out.data, out.data + out.dlc);
    }
    Bytes ask_at(uint8_t command, uint8_t n, uint32_t address, uint8_t extension = 0U) {
        Bytes bytes = {command, n, 0U, extension, 0U, 0U, 0U, 0U};
        std::memcpy(&bytes[4], &address, sizeof address);
        return ask(bytes);
    }
    void connect() { REQUIRE(ask({0xFF, 0x00})[0] == 0xFF); }
};

Bytes native(uint32_t value) {
    Bytes bytes(sizeof value);
    std::memcpy(bytes.data(), &value, sizeof value);
    return bytes;
}

Bytes joined(Bytes a, const Bytes& b) {
    a.insert(a.end(), b.begin(), b.end());
    return a;
}

const Bytes denied = {0xFE, 0x24}, unknown = {0xFE, 0x20}, syntax = {0xFE, 0x21}, out_of_range = {0xFE, 0x22};

}  // namespace

TEST_CASE("a session: who the slave is, and its memory at an address", "[unit][xcp][REQ-XCP-1]") {
    Slave slave;
    const uint16_t one = 1U;
    uint8_t first = 0U;
    std::memcpy(&first, &one, 1U);
    const bool big = first == 0U;
    CHECK(slave.ask({0xFF, 0x00}) == (big ? Bytes{0xFF, 0x00, 0x81, 8, 0, 8, 1, 1} : Bytes{0xFF, 0x00, 0x80, 8, 8, 0, 1, 1}));
    CHECK(slave.ask({0xFD}) == Bytes{0xFF, 0, 0, 0, 0, 0});
    CHECK(slave.ask({0xFC}) == Bytes{0xFE, 0x00});
    CHECK(slave.ask({0xFB}) == Bytes{0xFF, 0, 0, 0, 0, 0, 0, 1});

    CHECK(slave.ask({0xFA, 0}) == joined({0xFF, 0, 0, 0}, native(7U)));
    CHECK(slave.ask({0xF5, 4}) == Bytes{0xFF, 't', 'r', 'u', 'c'});
    CHECK(slave.ask({0xF5, 4}) == denied);  // longer than what is left, so nothing of it
    CHECK(slave.ask({0xF5, 3}) == Bytes{0xFF, 'k', ' ', '1'});
    CHECK(slave.ask({0xF5, 1}) == denied);
    CHECK(slave.ask({0xFA, 1}) == joined({0xFF, 0, 0, 0}, native(0U)));
    CHECK(slave.ask({0xF5, 1}) == denied);  // address 0 of the memory, not of the name

    CHECK(slave.ask_at(0xF6, 0, low) == Bytes{0xFF});
    CHECK(slave.ask({0xF5, 7}) == Bytes{0xFF, 0x40, 0x41, 0x42, 0x43, 0x44, 0x45, 0x46});
    CHECK(slave.ask({0xF5, 2}) == Bytes{0xFF, 0x47, 0x48});
    CHECK(slave.ask_at(0xF4, 3, low + 13U) == Bytes{0xFF, 0x4D, 0x4E, 0x4F});
    CHECK(slave.ask_at(0xF4, 4, top) == Bytes{0xFF, 0xA0, 0xA1, 0xA2, 0xA3});
    CHECK(slave.ask({0xFA, 0}).size() == 8U);
    CHECK(slave.ask_at(0xF4, 1, low) == Bytes{0xFF, 0x40});  // an address ends the name
    slave.memory[9] = 0x99;
    CHECK(slave.ask({0xF5, 1}) == Bytes{0xFF, 0x99});  // and what comes next is the next byte, as it is now

    CHECK(slave.ask({0xFA, 0}).size() == 8U);
    CHECK(slave.ask({0xF5, 1}) == Bytes{0xFF, 't'});  // the name from its beginning, wherever the address was
    slave.connect();
    CHECK(slave.ask({0xF5, 1}) == denied);  // a new session remembers no address
    CHECK(slave.ask({0xFE}) == Bytes{0xFF});
    CHECK_FALSE(slave.send({0xFD}));
    CHECK(slave.xcp.errors == 4U);
    CHECK(slave.xcp.commands == 24U);
}

TEST_CASE("memory outside the ranges is not read", "[unit][xcp][REQ-XCP-2]") {
    Slave slave;
    slave.connect();
    for (uint32_t n = 1U; n <= 7U; ++n) {
        for (uint32_t at = 0U; at < 32U; ++at) {
            const uint32_t address = low - 8U + at;
            const bool inside = at >= 8U && at + n <= 24U;
            const Bytes answer = slave.ask_at(0xF4, static_cast<uint8_t>(n), address);
            CAPTURE(n, at);
            CHECK((answer == denied) == !inside);
            CHECK(answer.size() == (inside ? n + 1U : 2U));
        }
    }
    for (uint8_t n = 1U; n <= 7U; ++n) {
        CHECK((slave.ask_at(0xF4, n, 0xFFFFFFFFU) == denied) == (n > 1U));
        CHECK(slave.ask_at(0xF4, n, 0U) == denied);
    }
    CHECK(slave.ask_at(0xF4, 1, 0xFFFFFFFFU) == Bytes{0xFF, 0xA3});
    CHECK(slave.ask({0xF5, 1}) == denied);  // behind the last address is none
}

TEST_CASE("no command of any length writes, and each has its answer", "[unit][xcp][REQ-XCP-2][REQ-XCP-3]") {
    Slave slave;
    const Slave before = slave;
    for (unsigned command = 0U; command < 256U; ++command) {
        for (std::size_t length = 1U; length <= 8U; ++length) {
            slave.connect();
            const bool known = command >= 0xFAU || (command >= 0xF4U && command <= 0xF6U);
            Bytes bytes = {static_cast<uint8_t>(command), 1U, 0U, 0U, 0U, 0U, 0U, 0U};
            const uint32_t address = low;
            std::memcpy(&bytes[4], &address, sizeof address);
            bytes.resize(length);
            const Bytes answer = slave.ask(bytes);
            CAPTURE(command, length);
            const std::size_t least = command == 0xF6U || command == 0xF4U                       ? 8U
                                      : command == 0xFFU || command == 0xFAU || command == 0xF5U ? 2U
                                                                                                 : 1U;
            if (!known) {
                CHECK(answer == (command >= 0xECU && command <= 0xF0U ? denied : unknown));
            } else if (length < least) {
                CHECK(answer == syntax);
            } else {
                CHECK(answer[0] == (command == 0xFCU || command == 0xF5U ? 0xFE : 0xFF));
            }
        }
    }
    CHECK(std::memcmp(slave.memory, before.memory, sizeof slave.memory) == 0);
    CHECK(std::memcmp(slave.end_of_memory, before.end_of_memory, sizeof slave.end_of_memory) == 0);
}

TEST_CASE("wrong parameters have their error and move nothing", "[unit][xcp][REQ-XCP-3]") {
    Slave slave;
    slave.connect();
    REQUIRE(slave.ask_at(0xF6, 0, low) == Bytes{0xFF});
    CHECK(slave.ask({0xF5, 0}) == out_of_range);
    CHECK(slave.ask({0xF5, 8}) == out_of_range);
    CHECK(slave.ask({0xF5, 255}) == out_of_range);
    CHECK(slave.ask_at(0xF6, 0, low + 4U, 1U) == out_of_range);
    CHECK(slave.ask_at(0xF4, 1, low + 4U, 1U) == out_of_range);
    CHECK(slave.ask({0xF5, 1}) == Bytes{0xFF, 0x40});
    slave.xcp.errors = UINT32_MAX - 1U;
    slave.xcp.commands = UINT32_MAX - 1U;
    CHECK(slave.ask({0xF5, 0}) == out_of_range);
    CHECK(slave.ask({0xF5, 0}) == out_of_range);
    CHECK(slave.xcp.errors == UINT32_MAX);
    CHECK(slave.xcp.commands == UINT32_MAX);
}

TEST_CASE("what is not for the slave is not answered, and wrong arguments are refused", "[unit][xcp][REQ-XCP-3]") {
    Slave slave;
    for (unsigned command = 0U; command < 255U; ++command) {
        CHECK_FALSE(slave.send({static_cast<uint8_t>(command), 0, 0, 0, 0, 0, 0, 0}));
    }
    CHECK_FALSE(slave.send({0xFF, 0}, from_master ^ 1U));
    CHECK_FALSE(slave.send({}));
    CHECK_FALSE(slave.send(Bytes(9U, 0xFF)));
    CHECK_FALSE(slave.xcp.connected);
    CHECK(slave.xcp.commands == 0U);
    slave.connect();
    CHECK_FALSE(slave.send({}));
    CHECK_FALSE(slave.send({0xFD}, to_master));
    lpvg_can_frame_t frame{};
    frame.id = from_master;
    frame.dlc = 2U;
    frame.data[0] = 0xFF;
    CHECK_FALSE(lpvg_xcp_receive(nullptr, &frame, &slave.out));
    CHECK_FALSE(lpvg_xcp_receive(&slave.xcp, nullptr, &slave.out));
    CHECK_FALSE(lpvg_xcp_receive(&slave.xcp, &frame, nullptr));
    lpvg_xcp_t cleared{};
    cleared.config.receive_id = from_master;
    CHECK_FALSE(lpvg_xcp_receive(&cleared, &frame, &slave.out));

    const auto refused = [&](const lpvg_xcp_config_t& config) {
        slave.xcp.commands = 123U;
        return lpvg_xcp_init(&slave.xcp, &config) == lpvg_status_bad_argument && slave.xcp.commands == 123U;
    };
    CHECK(lpvg_xcp_init(nullptr, &slave.config) == lpvg_status_bad_argument);
    CHECK(lpvg_xcp_init(&slave.xcp, nullptr) == lpvg_status_bad_argument);
    lpvg_xcp_config_t config = slave.config;
    config.name = nullptr;
    CHECK(refused(config));
    config = slave.config;
    config.ranges = nullptr;
    CHECK(refused(config));
    config = slave.config;
    config.send_id = config.receive_id;
    CHECK(refused(config));
    config = slave.config;
    config.n_ranges = 0U;
    CHECK(refused(config));
    std::vector<lpvg_xcp_range_t> many(17U, slave.ranges[0]);
    config.ranges = many.data();
    config.n_ranges = 17U;
    CHECK(refused(config));
    config.n_ranges = 16U;
    CHECK(lpvg_xcp_init(&slave.xcp, &config) == lpvg_status_ok);
    many[15].address = 0U;
    slave.connect();
    CHECK(slave.ask({0xF5, 1}) == Bytes{0xFF, 0x40});  // the last range counts, and a session begins at address 0
    CHECK(slave.ask_at(0xF4, 1, 0U) == Bytes{0xFF, 0x40});
    many[0] = {low, 16U, nullptr};
    CHECK(refused(config));
    many[0] = {low, 1U, slave.memory};
    CHECK(lpvg_xcp_init(&slave.xcp, &config) == lpvg_status_ok);
    config.n_ranges = 1U;
    CHECK(lpvg_xcp_init(&slave.xcp, &config) == lpvg_status_ok);
    config.n_ranges = 16U;
    many[15] = {0U, 0U, slave.memory};
    CHECK(refused(config));
    many[15] = {low, 16U, nullptr};
    CHECK(refused(config));
    many[15] = {low, 0U, slave.memory};
    CHECK(refused(config));
    many[15] = {top, 5U, slave.memory};
    CHECK(refused(config));
    many[15] = {top, 4U, slave.memory};
    const std::string longest(255U, 'n'), longer(256U, 'n');
    config.name = longer.c_str();
    CHECK(refused(config));
    config.name = longest.c_str();
    CHECK(lpvg_xcp_init(&slave.xcp, &config) == lpvg_status_ok);
    slave.connect();
    CHECK(slave.ask({0xFA, 0}) == joined({0xFF, 0, 0, 0}, native(255U)));
    config.name = "";
    CHECK(lpvg_xcp_init(&slave.xcp, &config) == lpvg_status_ok);
    slave.connect();
    CHECK(slave.ask({0xFA, 0}) == joined({0xFF, 0, 0, 0}, native(0U)));
}

TEST_CASE("nothing of a session is on the heap", "[unit][xcp][REQ-XCP-1]") {
    Slave slave;
    lpvg_can_frame_t frame{};
    frame.id = from_master;
    frame.dlc = 8U;
    const long before = heap_allocations();
    for (unsigned command = 0U; command < 256U; ++command) {
        frame.data[0] = static_cast<uint8_t>(255U - command);
        (void)lpvg_xcp_receive(&slave.xcp, &frame, &slave.out);
    }
    const long after = heap_allocations();
    CHECK(after == before);
}
