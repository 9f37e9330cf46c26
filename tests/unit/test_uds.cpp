#include "../catch.hpp"

#include <cstring>
#include <limits>
#include <vector>

#include "lpvguard/uds.h"

namespace {

using Bytes = std::vector<uint8_t>;

// 520201 = 0x7F009 with FMI 31, 904 = 0x00388 with FMI 9.
const Bytes code_a = {0x09U, 0xF0U, 0xFFU}, code_b = {0x88U, 0x03U, 0x09U};
// 12.5 m/s, bin 9, statistic 1.5, causes 0x1240, 7654 ms, run 1: as DM25 has them.
const Bytes held = {0x00U, 0x2DU, 9U, 0x00U, 0x06U, 0x40U, 0x12U, 0xE6U, 0x1DU, 0U, 0U, 1U};

Bytes operator+(Bytes a, const Bytes& b) {
    a.insert(a.end(), b.begin(), b.end());
    return a;
}

class Node {
public:
    Node() {
        std::memset(&memory, 0, sizeof memory);
        const lpvg_j1939_config_t config = {0x0102030405060708U, 0xFCU};
        REQUIRE(lpvg_j1939_init(&self, &config, &memory, 0, nullptr) == lpvg_status_ok);
        step({});
    }

    void step(const std::vector<lpvg_can_dtc_t>& codes) {
        lpvg_j1939_findings_t findings{};
        findings.freeze = {7'654'321, 1.5F, 12.5F, 0U, 0x1240U, 9U, 0U};
        findings.n_codes = static_cast<uint8_t>(codes.size());
        for (size_t i = 0; i < codes.size(); ++i) {
            findings.code[i] = codes[i];
        }
        lpvg_can_frame_t out[LPVG_J1939_FRAMES_OUT];
        size_t n = 0;
        REQUIRE(lpvg_j1939_step(&self, self.now_us, nullptr, 0U, &findings, out, LPVG_J1939_FRAMES_OUT, &n) == lpvg_status_ok);
    }

    // What lies behind the answer stays as it was.
    Bytes ask(const Bytes& request, size_t max = LPVG_UDS_ANSWER_MAX) const {
        Bytes answer(LPVG_UDS_ANSWER_MAX + 4U, 0xA5U);
        const size_t n = lpvg_uds_answer(&self, request.data(), request.size(), answer.data(), max);
        REQUIRE(n <= max);
        for (size_t i = n; i < answer.size(); ++i) {
            CHECK(answer[i] == 0xA5U);
        }
        answer.resize(n);
        return answer;
    }

    lpvg_j1939_t self;
    lpvg_j1939_memory_t memory;
};

}  // namespace

TEST_CASE("codes are read by status, with their freeze frame and their count", "[unit][uds][REQ-J1939-12]") {
    Node node;
    CHECK(node.ask({0x19U, 2U, 0xFFU}) == Bytes{0x59U, 2U, 9U});
    node.step({{520201U, 31U, 0U}, {904U, 9U, 0U}});
    node.step({{904U, 9U, 0U}});
    const Bytes head = {0x59U, 2U, 9U};
    CHECK(node.ask({0x19U, 2U, 0xFFU}) == head + code_a + Bytes{8U} + code_b + Bytes{9U});
    CHECK(node.ask({0x19U, 2U, 0x01U}) == head + code_b + Bytes{9U});
    CHECK(node.ask({0x19U, 2U, 0x02U}) == head);
    for (const uint8_t record : {0x01U, 0xFFU}) {
        CHECK(node.ask(Bytes{0x19U, 4U} + code_a + Bytes{record}) == Bytes{0x59U, 4U} + code_a + Bytes{8U, 1U, 1U, 0x4CU, 0x01U} + held);
        CHECK(node.ask(Bytes{0x19U, 6U} + code_b + Bytes{record}) == Bytes{0x59U, 6U} + code_b + Bytes{9U, 1U, 1U});
    }
    CHECK(node.ask({0x19U, 4U, 0U, 0U, 0U, 1U}) == Bytes{0x7FU, 0x19U, 0x31U});  // free places hold no code
    CHECK(node.ask(Bytes{0x19U, 0x86U} + code_b + Bytes{1U}).empty());  // the positive answer is suppressed
    CHECK(node.ask(Bytes{0x19U, 0x86U} + code_b + Bytes{2U}) == Bytes{0x7FU, 0x19U, 0x31U});
}

TEST_CASE("state, newest freeze frame and NAME are read by identifier", "[unit][uds][REQ-J1939-12]") {
    Node node;
    CHECK(node.ask({0x22U, 0x4CU, 1U}) == Bytes{0x7FU, 0x22U, 0x31U});
    node.step({{904U, 9U, 0U}});
    node.step({{520201U, 31U, 0U}});
    CHECK(node.ask({0x22U, 0x4CU, 0U}) == Bytes{0x62U, 0x4CU, 0U, lpvg_j1939_state_claimed, 0xFCU, 1U, 2U});
    CHECK(node.ask({0x22U, 0x4CU, 1U}) == Bytes{0x62U, 0x4CU, 1U} + code_a + Bytes{1U} + held);
    CHECK(node.ask({0x22U, 0x4CU, 2U}) == Bytes{0x62U, 0x4CU, 2U, 8U, 7U, 6U, 5U, 4U, 3U, 2U, 1U});
    node.memory.entry[0].freeze.sequence = UINT32_MAX - 1U;  // activations are counted this far
    CHECK(node.ask({0x22U, 0x4CU, 1U}) == Bytes{0x62U, 0x4CU, 1U} + code_b + Bytes{1U} + held);
}

TEST_CASE("the third time of a code, in another run and beside another code, is read as such", "[unit][uds][REQ-J1939-12]") {
    Node node;
    node.step({{520201U, 31U, 0U}});
    for (int i = 0; i < 2; ++i) {
        node.step({{520201U, 31U, 0U}, {904U, 9U, 0U}});
        node.step({{520201U, 31U, 0U}});
    }
    node.step({{520201U, 31U, 0U}, {904U, 9U, 0U}});
    for (lpvg_j1939_entry_t& entry : node.memory.entry) {
        entry.run = 7U;
    }
    Bytes in_run_7 = held;
    in_run_7.back() = 7U;
    CHECK(node.ask({0x22U, 0x4CU, 0U}) == Bytes{0x62U, 0x4CU, 0U, lpvg_j1939_state_claimed, 0xFCU, 2U, 2U});
    CHECK(node.ask({0x22U, 0x4CU, 1U}) == Bytes{0x62U, 0x4CU, 1U} + code_b + Bytes{3U} + in_run_7);
    CHECK(node.ask(Bytes{0x19U, 6U} + code_b + Bytes{0xFFU}) == Bytes{0x59U, 6U} + code_b + Bytes{9U, 1U, 3U});
}

TEST_CASE("numbers of a freeze frame are rounded, up to the last that is none of the special ones", "[unit][uds][REQ-J1939-12]") {
    Node node;
    node.step({{904U, 9U, 0U}});
    lpvg_j1939_freeze_t& freeze = node.memory.entry[0].freeze;
    const size_t statistic = 3U + 3U + 1U + 3U, time = statistic + 4U;  // behind head, code and count, speed and bin
    const auto read = [&](size_t at, size_t bytes) {
        const Bytes answer = node.ask({0x22U, 0x4CU, 1U});
        uint32_t value = 0U;
        for (size_t i = 0; i < bytes; ++i) {
            value |= static_cast<uint32_t>(answer.at(at + i)) << (8U * i);
        }
        return value;
    };
    struct Number {
        float steps;  // of 1/1024
        uint32_t raw;
    };
    for (const Number& number : {Number{0.0F, 0U},
                                 {0.25F, 0U},
                                 {0.75F, 1U},
                                 {1.25F, 1U},
                                 {-3.0F, 0U},
                                 {64254.25F, 64254U},
                                 {64254.75F, 64255U},
                                 {64255.0F, 64255U},
                                 {64255.75F, 64255U},
                                 {1e9F, 64255U}}) {
        CAPTURE(number.steps);
        freeze.statistic = number.steps / 1024.0F;
        CHECK(read(statistic, 2U) == number.raw);
    }
    freeze.statistic = std::numeric_limits<float>::quiet_NaN();
    CHECK(read(statistic, 2U) == 0xFFFFU);
    for (const uint32_t ms : {0U, 0xFAFFFFFEU, 0xFAFFFFFFU}) {
        freeze.t_us = int64_t{ms} * 1000 + 999;
        CHECK(read(time, 4U) == ms);
    }
    freeze.t_us = (int64_t{0xFAFFFFFFU} + 1) * 1000;
    CHECK(read(time, 4U) == 0xFAFFFFFFU);
}

TEST_CASE("what is not offered is refused by the code that says why", "[unit][uds][REQ-J1939-12]") {
    Node node;
    std::vector<lpvg_can_dtc_t> all;
    for (uint32_t i = 0; i < LPVG_J1939_CODES_MAX; ++i) {
        all.push_back({1000U + i, 2U, 0U});
    }
    node.step(all);
    const auto refused = [](uint8_t service, uint8_t why) { return Bytes{0x7FU, service, why}; };
    CHECK(node.ask({0x10U, 1U}) == refused(0x10U, 0x11U));
    CHECK(node.ask({0xFFU}) == refused(0xFFU, 0x11U));
    CHECK(node.ask({0x19U, 1U, 0xFFU}) == refused(0x19U, 0x12U));
    CHECK(node.ask({0x19U, 1U}) == refused(0x19U, 0x12U));
    for (const uint8_t kind : {uint8_t{3}, uint8_t{5}, uint8_t{7}}) {
        CHECK(node.ask({0x19U, kind, 0xFFU}) == refused(0x19U, 0x12U));
    }
    CHECK(node.ask({0x19U}) == refused(0x19U, 0x13U));
    CHECK(node.ask({0x19U, 2U}) == refused(0x19U, 0x13U));
    CHECK(node.ask({0x19U, 2U, 1U, 1U}) == refused(0x19U, 0x13U));
    CHECK(node.ask({0x19U, 4U, 0U, 0U, 0U}) == refused(0x19U, 0x13U));
    CHECK(node.ask({0x22U, 0x4CU}) == refused(0x22U, 0x13U));
    CHECK(node.ask({0x22U, 0x4CU, 0U, 0U}) == refused(0x22U, 0x13U));
    CHECK(node.ask({0x22U, 0x4CU, 3U}) == refused(0x22U, 0x31U));
    CHECK(node.ask({0x19U, 4U, 0U, 0U, 0U, 1U}) == refused(0x19U, 0x31U));
    CHECK(node.ask({0x19U, 4U, 0xE8U, 3U, 3U, 1U}) == refused(0x19U, 0x31U));  // another FMI
    CHECK(node.ask({0x19U, 4U, 0x08U, 3U, 2U, 1U}) == refused(0x19U, 0x31U));
    CHECK(node.ask({0x19U, 4U, 0xE8U, 4U, 2U, 1U}) == refused(0x19U, 0x31U));
    CHECK(node.ask({0x19U, 4U, 0xE8U, 3U, 2U, 2U}) == refused(0x19U, 0x31U));
    CHECK(node.ask({0x19U, 4U, 0xE8U, 3U, 2U, 1U})[0] == 0x59U);
    CHECK(node.ask({0x19U, 2U, 1U}).size() == LPVG_UDS_ANSWER_MAX);
    CHECK(node.ask({0x19U, 2U, 1U}, LPVG_UDS_ANSWER_MAX - 1U) == refused(0x19U, 0x14U));
    CHECK(node.ask({0x10U}, 2U).empty());
    CHECK(node.ask({0x10U}, 3U) == refused(0x10U, 0x11U));
    CHECK(node.ask({0x22U, 0x4CU, 3U}, 3U) == refused(0x22U, 0x31U));

    uint8_t answer[LPVG_UDS_ANSWER_MAX];
    const uint8_t request[] = {0x10U};
    CHECK(lpvg_uds_answer(nullptr, request, 1U, answer, sizeof answer) == 0U);
    CHECK(lpvg_uds_answer(&node.self, nullptr, 1U, answer, sizeof answer) == 0U);
    CHECK(lpvg_uds_answer(&node.self, request, 0U, answer, sizeof answer) == 0U);
    CHECK(lpvg_uds_answer(&node.self, request, 1U, nullptr, sizeof answer) == 0U);
    const lpvg_j1939_t fresh{};
    CHECK(lpvg_uds_answer(&fresh, request, 1U, answer, sizeof answer) == 0U);
}
