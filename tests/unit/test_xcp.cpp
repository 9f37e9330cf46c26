// The XCP slave that only reads: answers byte by byte, then every command of every length against memory that it must not touch.
#include "../catch.hpp"
#include "heap_counter.hpp"
#include "lpvguard/xcp.h"

#include <algorithm>
#include <cstring>
#include <map>
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
    lpvg_xcp_config_t config = {from_master, to_master, "truck 1", ranges, 2U, 10'000U};
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

const Bytes done = {0xFF}, denied = {0xFE, 0x24}, unknown = {0xFE, 0x20}, syntax = {0xFE, 0x21}, out_of_range = {0xFE, 0x22};
const Bytes active = {0xFE, 0x11}, wrong_mode = {0xFE, 0x27}, sequence = {0xFE, 0x29}, incomplete = {0xFE, 0x2A}, overflow = {0xFE, 0x30};

// Least bytes of each command of the list.
const std::map<unsigned, std::size_t> list_commands = {{0xE3U, 4U}, {0xE2U, 6U}, {0xE1U, 8U}, {0xE0U, 8U}, {0xDFU, 4U},
                                                       {0xDEU, 4U}, {0xDDU, 2U}, {0xDAU, 1U}, {0xD9U, 1U}, {0xD7U, 4U},
                                                       {0xD6U, 1U}, {0xD5U, 4U}, {0xD4U, 5U}, {0xD3U, 6U}};

Bytes half(uint16_t value) {
    Bytes bytes(sizeof value);
    std::memcpy(bytes.data(), &value, sizeof value);
    return bytes;
}

// The master's side of a list.
struct List : Slave {
    List() { connect(); }
    // A command, a byte, the number of a list, then more bytes.
    Bytes on(uint8_t command, const Bytes& more = {}, uint8_t first = 0U, uint16_t list = 0U) {
        return ask(joined(joined({command, first}, half(list)), more));
    }
    Bytes mode(uint8_t prescaler, uint8_t bits = 0U, uint16_t event = 0U, uint8_t priority = 0U) {
        return on(0xE0, joined(half(event), {prescaler, priority}), bits);
    }
    Bytes write(uint8_t n, uint32_t address, uint8_t bit = 0xFFU, uint8_t extension = 0U) {
        return ask(joined({0xE1, bit, n, extension}, native(address)));
    }
    void allocate(const Bytes& entries) {
        REQUIRE(ask({0xD6}) == done);
        REQUIRE(on(0xD5, {}, 0U, 1U) == done);
        REQUIRE(on(0xD4, {static_cast<uint8_t>(entries.size())}) == done);
        for (uint8_t i = 0U; i < entries.size(); ++i) {
            REQUIRE(on(0xD3, {i, entries[i]}) == done);
        }
    }
    // Two frames: bytes 0 to 3 and 14, 15; then all of the last range.
    void configure(uint8_t prescaler = 1U) {
        allocate({2U, 1U});
        REQUIRE(on(0xE2, {0U, 0U}) == done);
        REQUIRE(write(4U, low) == done);
        REQUIRE(write(2U, low + 14U) == done);
        REQUIRE(on(0xE2, {1U, 0U}) == done);
        REQUIRE(write(4U, top) == done);
        REQUIRE(mode(prescaler) == done);
    }
    std::size_t event() { return lpvg_xcp_event(&xcp, 1234, made, LPVG_XCP_ODTS_MAX); }
    Bytes frame(std::size_t i) const { return Bytes(made[i].data, made[i].data + made[i].dlc); }

    lpvg_can_frame_t made[LPVG_XCP_ODTS_MAX] = {};
};

}  // namespace

TEST_CASE("a session: who the slave is, and its memory at an address", "[unit][xcp][REQ-XCP-1]") {
    Slave slave;
    const uint16_t one = 1U;
    uint8_t first = 0U;
    std::memcpy(&first, &one, 1U);
    const bool big = first == 0U;
    CHECK(slave.ask({0xFF, 0x00}) == (big ? Bytes{0xFF, 0x04, 0x81, 8, 0, 8, 1, 1} : Bytes{0xFF, 0x04, 0x80, 8, 8, 0, 1, 1}));
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
            const bool of_list = list_commands.count(command) > 0U;
            const bool known = command >= 0xFAU || (command >= 0xF4U && command <= 0xF6U) || of_list;
            Bytes bytes = {static_cast<uint8_t>(command), 1U, 0U, 0U, 0U, 0U, 0U, 0U};
            const uint32_t address = low;
            std::memcpy(&bytes[4], &address, sizeof address);
            bytes.resize(length);
            const Bytes answer = slave.ask(bytes);
            CAPTURE(command, length);
            const std::size_t least = of_list                                                    ? list_commands.at(command)
                                      : command == 0xF6U || command == 0xF4U                     ? 8U
                                      : command == 0xFFU || command == 0xFAU || command == 0xF5U ? 2U
                                                                                                 : 1U;
            if (!known) {
                CHECK(answer == (command >= 0xECU && command <= 0xF0U ? denied : unknown));
            } else if (length < least) {
                CHECK(answer == syntax);
            } else if (of_list) {
                // Without a list nothing but information and the end of it is to be had.
                const bool anyway = command == 0xDAU || command == 0xD9U || command == 0xD7U || command == 0xD6U || command == 0xDDU;
                CHECK((answer == sequence) == !anyway);
                CHECK((answer[0] == 0xFFU) == anyway);
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
    slave.xcp.errors = 0U;
    CHECK(slave.ask({0xF5, 1}) == Bytes{0xFF, 0x41});
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
    config.period_us = 0U;
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
    CHECK(slave.ask({0xFA, 1}) == joined({0xFF, 0, 0, 0}, native(0U)));
    CHECK(slave.ask({0xF5, 1}) == Bytes{0xFF, 0x40});  // what is not offered is no text: the address is 0
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

TEST_CASE("what the slave says of its list", "[unit][xcp][REQ-XCP-4]") {
    List slave;
    CHECK(slave.ask({0xDA}) == joined(joined(joined({0xFF, 0x03}, half(0U)), half(1U)), {0, 0}));
    CHECK(slave.ask({0xD9}) == Bytes{0xFF, 1, 7, 1, 0, 0, 0, 0});
    CHECK(slave.ask({0xD7, 0, 0, 0}) == Bytes{0xFF, 0x84, 1, 4, 100, 5, 0});  // 100 times 100 us
    CHECK(slave.ask({0xF5, 4}) == Bytes{0xFF, 's', 't', 'e', 'p'});
    CHECK(slave.ask({0xF5, 1}) == denied);
    CHECK(slave.on(0xD7, {}, 0U, 1U) == out_of_range);
    CHECK(slave.ask_at(0xF4, 1, low) == Bytes{0xFF, 0x40});  // an address ends the text
    slave.allocate({1U});
    CHECK(slave.ask({0xDA}) == joined(joined(joined({0xFF, 0x03}, half(1U)), half(1U)), {0, 0}));
    for (const auto& [period_us, cycle, unit] : {std::tuple{255U, 255, 3}, {256U, 25, 4}, {20'000U, 200, 5}, {2'550'000U, 255, 7}}) {
        slave.config.period_us = period_us;
        REQUIRE(lpvg_xcp_init(&slave.xcp, &slave.config) == lpvg_status_ok);
        slave.connect();
        const Bytes said = slave.ask({0xD7, 0, 0, 0});
        CHECK((said[4] == cycle && said[5] == unit));
    }
}

TEST_CASE("a list sends what memory holds at each event", "[unit][xcp][REQ-XCP-4]") {
    List slave;
    CHECK(slave.event() == 0U);
    slave.configure();
    CHECK(slave.on(0xE2, {1U, 0U}) == done);  // the pointer has no part in what is sent
    CHECK(slave.event() == 0U);
    CHECK(slave.on(0xDE, {}, 2U) == Bytes{0xFF, 0});  // selected
    CHECK(slave.on(0xDF) == Bytes{0xFF, 0x01, 0, 0, 0, 0, 1, 0});
    CHECK(slave.event() == 0U);
    CHECK(slave.ask({0xDD, 1}) == done);
    CHECK(slave.on(0xDF) == Bytes{0xFF, 0x40, 0, 0, 0, 0, 1, 0});
    CHECK(slave.ask({0xFD}) == Bytes{0xFF, 0x40, 0, 0, 0, 0});
    slave.memory[8] = 0x99;
    REQUIRE(slave.event() == 2U);
    CHECK(slave.frame(0) == Bytes{0, 0x99, 0x41, 0x42, 0x43, 0x4E, 0x4F});
    CHECK(slave.frame(1) == Bytes{1, 0xA0, 0xA1, 0xA2, 0xA3});
    for (std::size_t i = 0; i < 2U; ++i) {
        CHECK((slave.made[i].id == to_master && slave.made[i].t_us == 1234));
    }
    slave.memory[8] = 0x98;
    REQUIRE(slave.event() == 2U);
    CHECK(slave.frame(0)[1] == 0x98);

    CHECK(lpvg_xcp_event(&slave.xcp, 0, slave.made, 1U) == 0U);  // all of it or nothing
    CHECK(slave.xcp.missed == 1U);
    slave.xcp.missed = UINT32_MAX - 1U;
    for (int k = 0; k < 2; ++k) {
        CHECK(lpvg_xcp_event(&slave.xcp, 0, slave.made, 0U) == 0U);
        CHECK(slave.xcp.missed == UINT32_MAX);
    }
    CHECK(lpvg_xcp_event(&slave.xcp, 0, slave.made, 2U) == 2U);
    CHECK(lpvg_xcp_event(nullptr, 0, slave.made, 2U) == 0U);
    CHECK(lpvg_xcp_event(&slave.xcp, 0, nullptr, 2U) == 0U);

    CHECK(slave.ask({0xDD, 2}) == done);  // stops what is selected, which this one is not
    CHECK(slave.event() == 2U);
    CHECK(slave.on(0xDE, {}, 2U) == Bytes{0xFF, 0});
    CHECK(slave.event() == 2U);  // it runs on
    CHECK(slave.ask({0xDD, 2}) == done);
    CHECK(slave.event() == 0U);
    CHECK(slave.ask({0xDD, 1}) == done);  // and is not selected any more
    CHECK(slave.event() == 0U);
    CHECK(slave.on(0xDE, {}, 1U) == Bytes{0xFF, 0});
    CHECK(slave.event() == 2U);
    CHECK(slave.on(0xDE, {}, 0U) == Bytes{0xFF, 0});
    CHECK(slave.event() == 0U);
    CHECK(slave.on(0xDE, {}, 1U) == Bytes{0xFF, 0});
    CHECK(slave.ask({0xDD, 0}) == done);
    CHECK(slave.event() == 0U);
    CHECK(slave.ask({0xFD}) == Bytes{0xFF, 0, 0, 0, 0, 0});
}

TEST_CASE("a prescaler leaves events out, and its first is sent", "[unit][xcp][REQ-XCP-4]") {
    const uint8_t prescaler = GENERATE(uint8_t{1}, uint8_t{2}, uint8_t{3}, uint8_t{255});
    List slave;
    slave.configure(prescaler);
    REQUIRE(slave.on(0xDE, {}, 1U) == Bytes{0xFF, 0});
    for (unsigned k = 0U; k < 600U; ++k) {
        CHECK(slave.event() == (k % prescaler == 0U ? 2U : 0U));
    }
}

TEST_CASE("the largest list is sent whole, and nothing larger is allocated", "[unit][xcp][REQ-XCP-4][REQ-XCP-5]") {
    List slave;
    slave.allocate(Bytes(8U, 7U));
    for (uint8_t odt = 0U; odt < 8U; ++odt) {
        REQUIRE(slave.on(0xE2, {odt, 0U}) == done);
        for (uint32_t entry = 0U; entry < 7U; ++entry) {
            REQUIRE(slave.write(1U, low + odt + entry) == done);
        }
        CHECK(slave.write(1U, low) == sequence);  // behind the last entry is none
    }
    REQUIRE(slave.mode(1U) == done);
    REQUIRE(slave.on(0xDE, {}, 1U) == Bytes{0xFF, 0});
    CHECK(lpvg_xcp_event(&slave.xcp, 0, slave.made, 7U) == 0U);
    REQUIRE(slave.event() == 8U);
    for (uint8_t odt = 0U; odt < 8U; ++odt) {
        Bytes wanted = {odt};
        for (uint8_t entry = 0U; entry < 7U; ++entry) {
            wanted.push_back(static_cast<uint8_t>(0x40U + odt + entry));
        }
        CHECK(slave.frame(odt) == wanted);
    }
    REQUIRE(slave.ask({0xD6}) == done);
    CHECK(slave.event() == 0U);
    CHECK(slave.on(0xD5, {}, 0U, 0U) == out_of_range);
    CHECK(slave.on(0xD5, {}, 0U, 2U) == overflow);
    REQUIRE(slave.on(0xD5, {}, 0U, 1U) == done);
    CHECK(slave.on(0xD4, {0U}) == out_of_range);
    CHECK(slave.on(0xD4, {9U}) == overflow);
    REQUIRE(slave.on(0xD4, {8U}) == done);
    CHECK(slave.on(0xD3, {0U, 0U}) == out_of_range);
    CHECK(slave.on(0xD3, {0U, 8U}) == overflow);
    CHECK(slave.on(0xD3, {8U, 1U}) == out_of_range);
}

TEST_CASE("a list is allocated in its order", "[unit][xcp][REQ-XCP-5]") {
    List slave;
    CHECK(slave.on(0xD5, {}, 0U, 1U) == sequence);
    CHECK(slave.on(0xD4, {1U}) == sequence);
    REQUIRE(slave.ask({0xD6}) == done);
    CHECK(slave.on(0xD4, {1U}) == sequence);
    CHECK(slave.on(0xD3, {0U, 1U}) == sequence);
    CHECK(slave.on(0xDE, {}, 1U) == sequence);
    CHECK(slave.write(1U, low) == sequence);
    REQUIRE(slave.on(0xD5, {}, 0U, 1U) == done);
    CHECK(slave.on(0xD5, {}, 0U, 1U) == sequence);
    CHECK(slave.on(0xD3, {0U, 1U}) == sequence);
    CHECK(slave.on(0xE2, {0U, 0U}) == out_of_range);
    CHECK(slave.on(0xD4, {1U}, 0U, 1U) == out_of_range);
    CHECK(slave.on(0xD4, {1U}, 0U, 256U) == out_of_range);
    REQUIRE(slave.mode(1U) == done);
    CHECK(slave.on(0xDE, {}, 1U) == incomplete);  // no frame
    REQUIRE(slave.on(0xD4, {2U}) == done);
    CHECK(slave.on(0xD4, {2U}) == sequence);
    CHECK(slave.write(1U, low) == sequence);
    REQUIRE(slave.on(0xD3, {0U, 2U}) == done);
    CHECK(slave.on(0xE2, {0U, 2U}) == out_of_range);
    CHECK(slave.on(0xE2, {1U, 0U}) == out_of_range);
    CHECK(slave.on(0xE2, {2U, 0U}) == out_of_range);
    REQUIRE(slave.on(0xE2, {0U, 0U}) == done);
    REQUIRE(slave.write(3U, low) == done);
    CHECK(slave.on(0xDE, {}, 2U) == incomplete);  // the second frame has nothing
    REQUIRE(slave.on(0xD3, {1U, 1U}) == done);
    REQUIRE(slave.on(0xE2, {1U, 0U}) == done);
    CHECK(slave.on(0xDE, {}, 1U) == incomplete);
    REQUIRE(slave.write(7U, low) == done);
    CHECK(slave.on(0xDE, {}, 3U) == wrong_mode);
    CHECK(slave.ask({0xDD, 3}) == wrong_mode);
    REQUIRE(slave.on(0xDE, {}, 1U) == Bytes{0xFF, 0});
    REQUIRE(slave.event() == 2U);
    CHECK(slave.frame(0) == Bytes{0, 0x40, 0x41, 0x42});  // an entry that is not written is left out
    CHECK(slave.frame(1).size() == 8U);
}

TEST_CASE("a list without a mode is not started", "[unit][xcp][REQ-XCP-5]") {
    List slave;
    slave.allocate({1U});
    REQUIRE(slave.on(0xE2, {0U, 0U}) == done);
    REQUIRE(slave.write(1U, low) == done);
    CHECK(slave.on(0xDE, {}, 1U) == incomplete);
    CHECK(slave.mode(0U) == out_of_range);
    CHECK(slave.mode(1U, 0U, 1U) == out_of_range);
    CHECK(slave.mode(1U, 0U, 256U) == out_of_range);
    CHECK(slave.mode(1U, 0U, 0U, 1U) == out_of_range);
    for (unsigned bit = 0U; bit < 8U; ++bit) {
        CHECK(slave.mode(1U, static_cast<uint8_t>(1U << bit)) == wrong_mode);
    }
    CHECK(slave.on(0xDE, {}, 1U) == incomplete);
    CHECK(slave.on(0xDE, {}, 0U) == Bytes{0xFF, 0});  // what does not run may be stopped
    REQUIRE(slave.mode(1U) == done);
    CHECK(slave.on(0xDE, {}, 1U) == Bytes{0xFF, 0});
}

TEST_CASE("entries are of the ranges, and no longer than their frame", "[unit][xcp][REQ-XCP-2][REQ-XCP-5]") {
    List slave;
    slave.allocate({2U});
    const auto first = [&] { REQUIRE(slave.on(0xE2, {0U, 0U}) == done); };
    first();
    CHECK(slave.write(0U, low) == out_of_range);
    CHECK(slave.write(8U, low) == out_of_range);
    CHECK(slave.write(1U, low, 0U) == out_of_range);
    CHECK(slave.write(1U, low, 0xFFU, 1U) == out_of_range);
    CHECK(slave.write(1U, low - 1U) == denied);
    CHECK(slave.write(2U, low + 15U) == denied);
    CHECK(slave.write(5U, top) == denied);
    REQUIRE(slave.write(4U, low) == done);  // what was refused has not moved on
    CHECK(slave.write(4U, low + 4U) == out_of_range);
    REQUIRE(slave.write(3U, low + 4U) == done);
    first();
    CHECK(slave.write(5U, low) == out_of_range);
    REQUIRE(slave.write(2U, low) == done);  // in place of the four
    REQUIRE(slave.write(5U, low) == done);
    REQUIRE(slave.mode(1U) == done);
    REQUIRE(slave.on(0xDE, {}, 1U) == Bytes{0xFF, 0});
    REQUIRE(slave.event() == 1U);
    CHECK(slave.frame(0) == Bytes{0, 0x40, 0x41, 0x40, 0x41, 0x42, 0x43, 0x44});
    REQUIRE(slave.on(0xE3) == done);  // clearing ends it, and keeps what is allocated
    CHECK(slave.event() == 0U);
    CHECK(slave.on(0xDE, {}, 1U) == incomplete);
    CHECK(slave.write(1U, low) == sequence);
    first();
    REQUIRE(slave.write(1U, low + 1U) == done);
    REQUIRE(slave.on(0xDE, {}, 1U) == Bytes{0xFF, 0});
    REQUIRE(slave.event() == 1U);
    CHECK(slave.frame(0) == Bytes{0, 0x41});
    REQUIRE(slave.on(0xDE, {}, 2U) == Bytes{0xFF, 0});
    REQUIRE(slave.on(0xE3) == done);
    REQUIRE(slave.ask({0xDD, 1}) == done);
    CHECK(slave.event() == 0U);  // nor is it selected
}

TEST_CASE("a running list is not changed, and ends with its session", "[unit][xcp][REQ-XCP-5]") {
    List slave;
    slave.configure();
    REQUIRE(slave.on(0xE2, {0U, 0U}) == done);
    REQUIRE(slave.on(0xDE, {}, 1U) == Bytes{0xFF, 0});
    CHECK(slave.on(0xD4, {1U}) == active);
    CHECK(slave.on(0xD3, {0U, 1U}) == active);
    CHECK(slave.on(0xE2, {0U, 0U}) == active);
    CHECK(slave.mode(2U) == active);
    CHECK(slave.write(1U, low) == active);
    CHECK(slave.on(0xD5, {}, 0U, 1U) == sequence);
    CHECK(slave.event() == 2U);
    SECTION("a new session") { slave.connect(); }
    SECTION("its end") { REQUIRE(slave.ask({0xFE}) == done); }
    SECTION("a new list") { REQUIRE(slave.ask({0xD6}) == done); }
    CHECK(slave.event() == 0U);
    slave.connect();
    CHECK(slave.on(0xDE, {}, 1U) == sequence);
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

TEST_CASE("a frame of the list holds nothing but its number and its entries", "[unit][xcp][REQ-XCP-4]") {
    List slave;
    slave.configure();
    REQUIRE(slave.on(0xDE, {}, 1U) == Bytes{0xFF, 0});
    std::memset(slave.made, 0xEE, sizeof slave.made);
    REQUIRE(slave.event() == 2U);
    for (std::size_t i = 0; i < 2U; ++i) {
        CHECK(std::all_of(slave.made[i].data + slave.made[i].dlc, std::end(slave.made[i].data), [](uint8_t byte) { return byte == 0U; }));
    }
}

TEST_CASE("a list is told from its allocation on, and what is told of its event does not end it", "[unit][xcp][REQ-XCP-4]") {
    List slave;
    const auto lists = [&] { return slave.ask({0xDA}).at(2) + slave.ask({0xDA}).at(3); };
    REQUIRE(slave.ask({0xD6}) == done);
    CHECK(lists() == 0);
    REQUIRE(slave.on(0xD5, {}, 0U, 1U) == done);
    CHECK(lists() == 1);
    REQUIRE(slave.ask({0xD7, 0, 0, 0})[0] == 0xFF);
    CHECK(lists() == 1);
    slave.configure();
    CHECK(slave.on(0xDF) == Bytes{0xFF, 0, 0, 0, 0, 0, 1, 0});  // neither selected nor running
    REQUIRE(slave.on(0xDE, {}, 2U) == Bytes{0xFF, 0});
    CHECK(slave.ask({0xDD, 3}) == wrong_mode);
    CHECK(slave.on(0xDF) == Bytes{0xFF, 0x01, 0, 0, 0, 0, 1, 0});  // still selected
}

TEST_CASE("entries that are allocated or cleared are empty, and none stands behind the last", "[unit][xcp][REQ-XCP-5]") {
    List slave;
    slave.allocate({7U});
    REQUIRE(slave.mode(1U) == done);
    REQUIRE(slave.on(0xE2, {0U, 6U}) == done);
    REQUIRE(slave.write(2U, low) == done);  // the last entry alone is enough
    CHECK(slave.write(2U, low) == sequence);  // and none follows it
    REQUIRE(slave.on(0xDE, {}, 1U) == Bytes{0xFF, 0});
    REQUIRE(slave.event() == 1U);
    CHECK(slave.frame(0) == Bytes{0, 0x40, 0x41});
    REQUIRE(slave.on(0xDE, {}, 0U) == Bytes{0xFF, 0});
    REQUIRE(slave.on(0xD3, {0U, 7U}) == done);
    CHECK(slave.on(0xDE, {}, 1U) == incomplete);

    slave.allocate(Bytes(8U, 1U));
    REQUIRE(slave.mode(1U) == done);
    const auto write = [&](uint8_t odt) {
        REQUIRE(slave.on(0xE2, {odt, 0U}) == done);
        REQUIRE(slave.write(1U, low + odt) == done);
    };
    for (const uint8_t odt : {uint8_t{8}, uint8_t{9}, uint8_t{255}}) {
        CHECK(slave.on(0xE2, {odt, 0U}) == out_of_range);
    }
    for (uint8_t odt = 0U; odt < 8U; ++odt) {
        write(odt);
    }
    REQUIRE(slave.on(0xDE, {}, 1U) == Bytes{0xFF, 0});
    REQUIRE(slave.on(0xDE, {}, 0U) == Bytes{0xFF, 0});
    REQUIRE(slave.on(0xE2, {0U, 0U}) == done);
    REQUIRE(slave.on(0xE3) == done);
    CHECK(slave.write(1U, low) == sequence);  // clearing forgets where the next entry goes
    for (uint8_t odt = 0U; odt < 8U; ++odt) {
        CHECK(slave.on(0xDE, {}, 1U) == incomplete);
        write(odt);
    }
    CHECK(slave.on(0xDE, {}, 1U) == Bytes{0xFF, 0});
}
