// Stateful fuzzing of the CAN receiver: decoder and supervision over sequences of frames with jumps of time.
//
// The input is a program, one operation after the other. The low nibble of the first byte of an operation says what
// arrives, its high nibble how long after the operation before (kStepUs). Every third byte or so is frame data.
// After each operation the invariants that can.h promises are checked; any breach aborts.
//
//     clang++ -fsanitize=fuzzer,address,undefined ... && ./fuzz_can corpus/can          campaign
//     built with -DLPVG_FUZZ_REPLAY (any compiler): fuzz_can_replay SEED SEQUENCES FILE...   corpus, then random programs
#include <cstdio>
#include <cstdlib>
#include <cstring>

#include "lpvg_can_codec.h"
#include "lpvguard/can.h"

namespace {

constexpr int64_t kStepUs[16] = {0,      1,      550,    2'499,  2'500,   5'000,     9'000,  10'000,
                                 10'001, 35'001, 55'000, 55'001, 100'000, 1'000'000, -4'000, -1'000'000};
uint64_t g_frames = 0;

[[noreturn]] void fail(const char* what) {
    std::fprintf(stderr, "fuzz_can: broken promise: %s\n", what);
    std::abort();
}
void promise(bool kept, const char* what) {
    if (!kept) {
        fail(what);
    }
}

class Program {
public:
    Program(const uint8_t* data, size_t size) : at_(data), end_(data + size) {}
    bool more() const { return at_ != end_; }
    uint8_t byte() { return more() ? *at_++ : uint8_t{0}; }

private:
    const uint8_t* at_;
    const uint8_t* end_;
};

// The values of an accepted frame lie within the rule, by the generated decoder and not by the supervision's.
void check_values(const lpvg_can_frame_t& frame, uint8_t index) {
    float value = 0.0F;
    if (index == LPVG_CAN_VDC2_INDEX) {
        lpvg_can_vdc2_t m{};
        promise(lpvg_can_vdc2_unpack(&m, &frame) == lpvg_status_ok, "an accepted frame unpacks");
        promise(lpvg_can_decode(&lpvg_can_vdc2_yaw_rate, m.yaw_rate, &value) == lpvg_can_quality_good, "yaw rate is good");
        promise(value >= -1.5001F && value <= 1.5001F, "yaw rate is in range");
    } else if (index == LPVG_CAN_GUARD_IN_INDEX) {
        lpvg_can_guard_in_t m{};
        promise(lpvg_can_guard_in_unpack(&m, &frame) == lpvg_status_ok, "an accepted frame unpacks");
        promise(lpvg_can_decode(&lpvg_can_guard_in_dp_measured, m.dp_measured, &value) == lpvg_can_quality_good, "dp is good");
        promise(value >= -12.5001F && value <= 12.5001F, "dp is in range");
    }
}

void check_state(const lpvg_can_supervisor_t& self, int64_t now_before) {
    promise(self.now_us >= now_before, "time does not go back");
    for (uint8_t i = 0U; i < self.n_rules; ++i) {
        const lpvg_can_watch_t& w = self.watch[i];
        const int64_t age = self.now_us - w.t_accepted_us;
        const int64_t period = self.rules[i].period_us;
        promise(w.state <= lpvg_can_state_live, "state is one of three");
        promise(w.score <= LPVG_CAN_SCORE_OFF && w.good_in_row < LPVG_CAN_RECOVER_FRAMES && w.counter < 15U, "counters");
        promise(w.state == lpvg_can_state_off || w.score < LPVG_CAN_SCORE_OFF, "a full score is off");
        promise(w.state != lpvg_can_state_live || 2 * age <= 7 * period, "live is at most 3.5 periods old");
        promise(w.state != lpvg_can_state_hold || 2 * age <= 11 * period, "hold is at most 5.5 periods old");
    }
}

void receive(lpvg_can_supervisor_t& self, const lpvg_can_frame_t& frame) {
    const int64_t now = self.now_us;
    uint8_t index = 0U;
    const lpvg_can_event_t event = lpvg_can_receive(&self, &frame, &index);
    ++g_frames;
    promise(event > lpvg_can_event_none && event < lpvg_can_event_missed, "a frame has an event");
    if (event == lpvg_can_event_accepted) {
        promise(lpvg_can_state(&self, index) == lpvg_can_state_live, "what is used is live");
    }
    if (event == lpvg_can_event_accepted || event == lpvg_can_event_recovering) {
        check_values(frame, index);
    }
    check_state(self, now);
}

lpvg_can_frame_t good_frame(uint8_t index, uint8_t& counter, uint8_t low) {
    lpvg_can_frame_t frame{};
    frame.dlc = 8U;
    frame.id = lpvg_can_rules[index].id;
    if (index == LPVG_CAN_VDC2_INDEX) {
        const lpvg_can_vdc2_t m = {static_cast<uint16_t>(32000U + low), static_cast<uint16_t>(32000U + low), 32000U, 125U};
        promise(lpvg_can_vdc2_pack(&m, &frame) == lpvg_status_ok, "pack");
    } else if (index == LPVG_CAN_GUARD_IN_INDEX) {
        const lpvg_can_guard_in_t m = {static_cast<uint16_t>(32000U + low), 32000U, 1U, 0U};
        promise(lpvg_can_guard_in_pack(&m, &frame) == lpvg_status_ok, "pack");
        promise(lpvg_can_e2e_protect(&frame, LPVG_CAN_GUARD_IN_E2E_DATA_ID, &counter) == lpvg_status_ok, "protect");
    } else {
        std::memset(frame.data, low & 0x4F, sizeof frame.data);
    }
    return frame;
}

void run(const uint8_t* data, size_t size) {
    Program program(data, size);
    lpvg_can_supervisor_t self{};
    int64_t t = 1'000'000;
    uint8_t counter = 0U;
    promise(lpvg_can_init(&self, lpvg_can_rules, LPVG_CAN_RECEIVED, t) == lpvg_status_ok, "init");
    while (program.more()) {
        const uint8_t op = program.byte();
        t += kStepUs[op >> 4U];
        lpvg_can_frame_t frame{};
        switch (op & 0x0FU) {
            case 0:
            case 1:
            case 2:
            case 3:
            case 4:
            case 5:  // a good frame of one message
                frame = good_frame(op & 0x0FU, counter, program.byte());
                break;
            case 6: {  // ten good frames on time: gets the state machine to live in few bytes
                for (int n = 0; n < 10; ++n, t += 10'000) {
                    frame = good_frame(LPVG_CAN_GUARD_IN_INDEX, counter, 0U);
                    frame.t_us = t;
                    receive(self, frame);
                    frame = good_frame(LPVG_CAN_VDC2_INDEX, counter, 0U);
                    frame.t_us = t;
                    receive(self, frame);
                }
                continue;
            }
            case 7:
            case 8: {  // a good frame with one byte changed
                frame = good_frame((op & 1U) != 0U ? LPVG_CAN_GUARD_IN_INDEX : LPVG_CAN_VDC2_INDEX, counter, 0U);
                const uint8_t at = program.byte();
                frame.data[at & 7U] = program.byte();
                break;
            }
            case 9: {  // protected frame with any payload and any counter
                frame = good_frame(LPVG_CAN_GUARD_IN_INDEX, counter, 0U);
                frame.data[2] = program.byte();
                frame.data[3] = program.byte();
                uint8_t any = static_cast<uint8_t>(program.byte() % 15U);
                promise(lpvg_can_e2e_protect(&frame, LPVG_CAN_GUARD_IN_E2E_DATA_ID, &any) == lpvg_status_ok, "protect");
                break;
            }
            case 10:  // a wrong length
                frame = good_frame(LPVG_CAN_VDC2_INDEX, counter, 0U);
                frame.dlc = program.byte();
                break;
            case 11:  // a skipped frame
                counter = static_cast<uint8_t>((counter + program.byte()) % 15U);
                continue;
            case 12: {  // time alone
                const int64_t now = self.now_us;
                lpvg_can_advance(&self, t);
                check_state(self, now);
                continue;
            }
            case 13:  // an error report
                frame.id = LPVG_CAN_ERROR | program.byte();
                frame.dlc = 8U;
                break;
            case 14: {  // anything at any time
                uint64_t raw = 0U;
                for (int n = 0; n < 8; ++n) {
                    frame.data[n] = program.byte();
                    raw = (raw << 8U) | frame.data[n];
                }
                std::memcpy(&frame.t_us, &raw, sizeof raw);
                frame.id = lpvg_can_rules[raw % LPVG_CAN_RECEIVED].id ^ program.byte();
                frame.dlc = program.byte();
                receive(self, frame);
                continue;
            }
            default:  // one of ours with any data
                frame.id = lpvg_can_rules[program.byte() % LPVG_CAN_RECEIVED].id;
                frame.dlc = 8U;
                for (auto& byte : frame.data) {
                    byte = program.byte();
                }
                break;
        }
        frame.t_us = t;
        receive(self, frame);
    }
}

}  // namespace

#ifndef LPVG_FUZZ_REPLAY

namespace {
uint64_t g_sequences = 0;
void report() {
    std::fprintf(stderr, "fuzz_can: %llu sequences, %llu frames\n", static_cast<unsigned long long>(g_sequences),
                 static_cast<unsigned long long>(g_frames));
}
}  // namespace

extern "C" int LLVMFuzzerInitialize(int*, char***) { return std::atexit(report); }

extern "C" int LLVMFuzzerTestOneInput(const uint8_t* data, size_t size) {
    ++g_sequences;
    run(data, size);
    return 0;
}

#else

int main(int argc, char** argv) {
    if (argc < 3) {
        std::fprintf(stderr, "usage: %s SEED SEQUENCES [FILE...]\n", argv[0]);
        return 2;
    }
    uint8_t buffer[4096];
    for (int i = 3; i < argc; ++i) {
        std::FILE* file = std::fopen(argv[i], "rb");
        if (file == nullptr) {
            std::fprintf(stderr, "%s: cannot be read\n", argv[i]);
            return 2;
        }
        run(buffer, std::fread(buffer, 1U, sizeof buffer, file));
        std::fclose(file);
    }
    uint64_t random = std::strtoull(argv[1], nullptr, 10) * 2U + 1U;
    const auto sequences = std::strtoull(argv[2], nullptr, 10);
    for (uint64_t n = 0; n < sequences; ++n) {
        for (size_t i = 0; i < 256U; ++i) {
            random ^= random << 13U;
            random ^= random >> 7U;
            random ^= random << 17U;
            buffer[i] = static_cast<uint8_t>(random >> 32U);
        }
        run(buffer, 256U);
    }
    std::printf("%d files, %llu random sequences, %llu frames\n", argc - 3, sequences, static_cast<unsigned long long>(g_frames));
    return 0;
}

#endif
