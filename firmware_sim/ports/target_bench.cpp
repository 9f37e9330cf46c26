// target_bench.cpp -- bit-exact results and costs of one vehicle's core on one target.
//
// Runs the drive in target_input.h (made by lpvguard.core.targets) and writes these lines:
//
//   frame BIN T_END_US REASON FALSIFIED then bits of: speed margin statistic evidence, E, Z      results
//   verdict T_US VERDICT                     when the verdict changes
//   demand T_US BITS                         every 100th
//   size NAME BYTES                          of the structs that the caller owns
//   part NAME CALLS WORST MEDIAN STACK       instructions of one call; bytes of stack below the caller
//
// Numbers are decimal; bits of a float are hexadecimal. Result lines are the same on every target. Other lines depend on the target.
#include "port.h"

#include <algorithm>
#include <cmath>
#include <cstddef>
#include <cstdint>
#include <cstring>
#include <initializer_list>

#include "lpvguard/ecu.h"
#include "monitor/margin.hpp"
#include "target_input.h"
#include "text.hpp"
#if __has_include("lpvguard_diagnosis.c")
#define TARGET_DIAGNOSES
#include "lpvguard/diagnosis.h"
#endif
#if __has_include("lpvguard_isolation.c")
#define TARGET_ISOLATES
#include "lpvguard/isolation.h"
#endif
#if LPVG_NK > 0
#include "aes_cmac.hpp"
#include "dense_controller.hpp"
#include "lpvg_can_codec.h"
#include "lpvguard/authentication.h"
#include "lpvguard/evidence.h"
#include "lpvguard/j1939.h"
#include "lpvguard/xcp.h"
#endif

namespace {

static_assert(sizeof(lpvg_real_t) == 4U, "results are compared as the bits of a float");

// Writes a line of words.
class Line {
public:
    Line& word(const char* text) {
        text_.put(text).put(' ');
        return *this;
    }
    Line& number(uint64_t value) {
        text_.number(value).put(' ');
        return *this;
    }
    Line& bits(float value) {
        uint32_t word = 0;
        std::memcpy(&word, &value, sizeof word);
        for (int shift = 28; shift >= 0; shift -= 4) {
            text_.put("0123456789abcdef"[(word >> shift) & 0xFU]);
        }
        text_.put(' ');
        return *this;
    }
    void write() {
        buffer_[text_.size() - 1U] = '\n';
        port_write(buffer_);
    }

private:
    char buffer_[400];
    Text text_{buffer_, sizeof buffer_};
};

uint32_t counts[TARGET_INPUT_SAMPLES];

// Counts instructions and stack of the calls of one part.
class Part {
public:
    explicit Part(const char* name) : name_(name) {
        const uint32_t begin = port_counter();
        empty_ = port_instructions(begin, port_counter());
    }
    template <class Call>
    void run(Call call) {
        port_stack_paint();
        const uint32_t begin = port_counter();
        call();
        const uint32_t end = port_counter();
        const uint32_t used = port_stack_used();
        stack_ = used > stack_ ? used : stack_;
        const uint32_t n = port_instructions(begin, end);
        counts[n_++] = n > empty_ ? n - empty_ : 0U;
    }
    void write() {
        uint32_t* const middle = counts + n_ / 2U;
        std::nth_element(counts, middle, counts + n_);
        const uint32_t worst = *std::max_element(counts, counts + n_);
        Line().word("part").word(name_).number(n_).number(worst).number(*middle).number(stack_).write();
    }

private:
    const char* name_;
    uint32_t empty_ = 0, stack_ = 0;
    std::size_t n_ = 0;
};

void require(bool ok, const char* what) {
    if (!ok) {
        port_write(what);
        port_exit(1);
    }
}

int64_t time_us(std::size_t k) { return static_cast<int64_t>(k + 1U) * lpvg_coeff.words.sample_period_us; }

lpvg_sample_t sample_at(std::size_t k) {
    lpvg_sample_t sample{};
    const float* row = target_input[k];
    sample.t_us = time_us(k);
    sample.speed = row[0];
    std::memcpy(sample.u, row + 1, sizeof sample.u);
    std::memcpy(sample.y, row + 1 + LPVG_NU, sizeof sample.y);
    return sample;
}

void write_frame(const lpvg_frame_t& f) {
    Line line;
    line.word("frame").number(f.bin).number(static_cast<uint64_t>(f.t_end_us)).number(f.reason).number(f.falsified ? 1U : 0U);
    line.bits(f.speed).bits(f.margin).bits(f.statistic).bits(f.evidence);
    for (std::size_t j = 0; j < LPVG_NY; ++j) {
        line.bits(f.E[j][0]).bits(f.E[j][1]).bits(f.Z[j][0]).bits(f.Z[j][1]);
    }
    line.write();
}

lpvg_monitor_t monitor;

void run_init() {
    Part part("monitor_init");
    part.run([] { require(lpvg_monitor_init(&monitor, &lpvg_coeff) == lpvg_status_ok, "monitor refused the coefficients\n"); });
    part.write();
}

void run_monitor() {
    Part part("monitor_push");
    uint32_t verdict = lpvg_verdict_unknown, sequence = 0U;
    for (std::size_t k = 0; k < TARGET_INPUT_SAMPLES; ++k) {
        const lpvg_sample_t sample = sample_at(k);
        part.run([&] { require(lpvg_monitor_push(&monitor, &sample) == lpvg_status_ok, "a sample was refused\n"); });
        const lpvg_frame_t& frame = *lpvg_monitor_frame(&monitor);
        if (frame.sequence != sequence) {
            sequence = frame.sequence;
            write_frame(frame);
        }
        const auto now = static_cast<uint32_t>(lpvg_monitor_verdict(&monitor, sample.t_us));
        if (now != verdict) {
            verdict = now;
            Line().word("verdict").number(static_cast<uint64_t>(sample.t_us)).number(verdict).write();
        }
    }
    part.write();
}

#ifdef TARGET_DIAGNOSES

// Diagnosis of an alarm: take after a push, work on a block for one output, and judgement of one output. Not part of the step.
void run_diagnosis() {
    static lpvg_diagnosis_t diagnosis;
    require(lpvg_monitor_init(&monitor, &lpvg_coeff) == lpvg_status_ok, "monitor refused the coefficients\n");
    require(lpvg_diagnosis_init(&diagnosis, &lpvg_diagnosis_table) == lpvg_status_ok, "the diagnosis refused its table\n");
    Part take("diagnosis_take");
    for (std::size_t k = 0; k < TARGET_INPUT_SAMPLES; ++k) {
        const lpvg_sample_t sample = sample_at(k);
        require(lpvg_monitor_push(&monitor, &sample) == lpvg_status_ok, "a sample was refused\n");
        take.run([&] { require(lpvg_diagnosis_take(&diagnosis, &monitor) == lpvg_status_ok, "a block was refused\n"); });
        while (lpvg_diagnosis_work(&diagnosis)) {
        }
    }
    take.write();
    require(diagnosis.alarms > 0U && diagnosis.found[0].cause != lpvg_cause_unknown, "no alarm was diagnosed\n");
    require(lpvg_monitor_init(&monitor, &lpvg_coeff) == lpvg_status_ok, "monitor refused the coefficients\n");
    require(lpvg_diagnosis_init(&diagnosis, &lpvg_diagnosis_table) == lpvg_status_ok, "the diagnosis refused its table\n");
    Part work("diagnosis_work");
    for (std::size_t k = 0; k < TARGET_INPUT_SAMPLES; ++k) {
        const lpvg_sample_t sample = sample_at(k);
        require(lpvg_monitor_push(&monitor, &sample) == lpvg_status_ok, "a sample was refused\n");
        require(lpvg_diagnosis_take(&diagnosis, &monitor) == lpvg_status_ok, "a block was refused\n");
        for (bool more = diagnosis.pending > 0U; more;) {
            work.run([&] { more = lpvg_diagnosis_work(&diagnosis); });
        }
    }
    work.write();
}

#endif

#ifdef TARGET_ISOLATES
// Isolation of a vehicle with redundant outputs: take after a push, work on a block or on a hypothesis of a window. Not part of the step.
void run_isolation() {
    static lpvg_isolation_t isolation;
    for (const bool counts_work : {false, true}) {
        require(lpvg_monitor_init(&monitor, &lpvg_coeff) == lpvg_status_ok, "monitor refused the coefficients\n");
        require(lpvg_isolation_init(&isolation, &lpvg_isolation_table) == lpvg_status_ok, "the isolation refused its table\n");
        Part part(counts_work ? "isolation_work" : "isolation_take");
        const auto count = [&part](bool counted, auto call) {
            if (counted) {
                part.run(call);
            } else {
                call();
            }
        };
        for (std::size_t k = 0; k < TARGET_INPUT_SAMPLES; ++k) {
            const lpvg_sample_t sample = sample_at(k);
            require(lpvg_monitor_push(&monitor, &sample) == lpvg_status_ok, "a sample was refused\n");
            count(!counts_work, [&] { require(lpvg_isolation_take(&isolation, &monitor, &sample) == lpvg_status_ok, "no isolation\n"); });
            for (bool more = isolation.pending || isolation.judging; more;) {
                count(counts_work, [&] { more = lpvg_isolation_work(&isolation, &monitor); });
            }
        }
        require(isolation.windows > 0U && isolation.newest.parts != 0U, "no part was named\n");
        part.write();
    }
}

#endif

void run_model() {
    Part part("model_step");
    lpvg_model_t model;
    lpvg_sample_t sample = sample_at(0);
    lpvg_model_start(&model, &lpvg_coeff, sample.u, sample.y);
    for (std::size_t k = 0; k < TARGET_INPUT_SAMPLES; ++k) {
        sample = sample_at(k);
        lpvg_real_t yhat[LPVG_NY];
        part.run([&] {
            lpvg_model_output(&model, &lpvg_coeff, yhat);
            lpvg_model_advance(&model, &lpvg_coeff, sample.speed, sample.u);
        });
    }
    part.write();
}

// Margins of frames with many combinations of sizes. E and Z come from the drive's samples; the bounds are those of every bin.
void run_margin() {
    using Complex = lpvg::Complex2<lpvg_real_t>;
    Part part("margin");
    volatile lpvg_real_t sink = 0.0F;
    for (std::size_t k = LPVG_NBINS; k < TARGET_INPUT_SAMPLES; ++k) {
        Complex E[LPVG_NY], Z[LPVG_NY];
        for (std::size_t j = 0; j < LPVG_NY; ++j) {
            const std::size_t y = 1U + LPVG_NU + j;
            Z[j] = {target_input[k][y], target_input[k - 7U][y]};
            E[j] = {0.3F * target_input[k - 3U][y], 0.1F * target_input[k - 5U][y]};
        }
        const std::size_t b = k % LPVG_NBINS;
        part.run(
            [&] { sink = lpvg::Margin<lpvg_real_t, LPVG_NY, LPVG_NDELTA>(E, Z, lpvg_coeff.reals.W_delta[b], lpvg_coeff.reals.B_w[b])(); });
    }
    part.write();
}

#if LPVG_NK > 0

lpvg_control_t control;
lpvg_ecu_t ecu;

float demands[TARGET_INPUT_SAMPLES];

// The measurements start at zero, so that the engagement changes no state. The dense controller has no such change.
void measurements(std::size_t k, lpvg_real_t* m) {
    std::memset(m, 0, LPVG_NM * sizeof *m);
    if (k > 0U) {
        m[0] = target_input[k][1U + LPVG_NU];
        std::memcpy(&m[1], &target_input[k][1U + LPVG_NU], LPVG_NY * sizeof *m);
    }
}

// Runs the watch of the response over the whole drive.
void run_watch() {
    Part part("watch_take");
    static lpvg_watch_t watch;
    lpvg_watch_limits_t limits;
    lpvg_model_t model;
    lpvg_watch_limits(&limits, &lpvg_coeff);
    for (std::size_t k = 0; k < TARGET_INPUT_SAMPLES; ++k) {
        const lpvg_sample_t sample = sample_at(k);
        if (k == 0U) {
            lpvg_model_start(&model, &lpvg_coeff, sample.u, sample.y);
        }
        lpvg_model_advance(&model, &lpvg_coeff, sample.speed, sample.u);
        if (k == 0U) {
            lpvg_watch_start(&watch, &model);
        } else {
            part.run([&] { lpvg_watch_take(&watch, &limits, &lpvg_coeff, &model, k > 1U, sample.y, sample.u); });
        }
    }
    require(watch.evidence, "the watch has no evidence\n");
    part.write();
}

void run_controller() {
    Part part("control_step");
    require(lpvg_control_init(&control, &lpvg_control_coeff) == lpvg_status_ok, "controller refused the coefficients\n");
    for (std::size_t k = 0; k < TARGET_INPUT_SAMPLES; ++k) {
        const lpvg_sample_t sample = sample_at(k);
        lpvg_real_t m[LPVG_NM];
        measurements(k, m);
        part.run([&] { require(lpvg_control_step(&control, sample.speed, m, true) == lpvg_status_ok, "a measurement was refused\n"); });
        demands[k] = control.u[0];
        if (k % 100U == 0U) {
            Line().word("demand").number(static_cast<uint64_t>(sample.t_us)).bits(control.u[0]).write();
        }
    }
    part.write();
}

// Runs the same control law with full matrices, which must give the same demand.
void run_dense_controller() {
    static DenseController dense(lpvg_control_coeff);
    Part part("dense_step");
    float worst = 0.0F;
    for (std::size_t k = 0; k < TARGET_INPUT_SAMPLES; ++k) {
        const lpvg_sample_t sample = sample_at(k);
        lpvg_real_t m[LPVG_NM];
        measurements(k, m);
        part.run([&] { dense.step(sample.speed, m); });
        worst = std::max(worst, std::fabs(dense.u[0] - demands[k]));
    }
    require(worst <= 1e-4F * lpvg_control_coeff.reals.u_max[0][0], "the dense controller asks for something else\n");
    part.write();
}

// The bus of the truck at its rates: the two 10 ms messages, and every tenth step axle speed and brake pedal.
std::size_t bus_frames(std::size_t k, lpvg_can_frame_t* frames, uint8_t* counter) {
    constexpr float kmh_per_mps = 3.6F, steering_ratio = 20.0F;
    const lpvg_sample_t sample = sample_at(k);
    std::size_t n = 0;
    lpvg_can_vdc2_t vdc2{};
    vdc2.yaw_rate = lpvg_can_encode(&lpvg_can_vdc2_yaw_rate, sample.y[0]);
    vdc2.steering_wheel_angle = lpvg_can_encode(&lpvg_can_vdc2_steering_wheel_angle, steering_ratio * sample.y[LPVG_NY - 1]);
    vdc2.lateral_acceleration = lpvg_can_encode(&lpvg_can_vdc2_lateral_acceleration, sample.speed * sample.y[0]);
    vdc2.longitudinal_acceleration = lpvg_can_encode(&lpvg_can_vdc2_longitudinal_acceleration, 0.0F);
    bool packed = lpvg_can_vdc2_pack(&vdc2, &frames[n++]) == lpvg_status_ok;
    lpvg_can_guard_in_t guard{};
    guard.dp_measured = lpvg_can_encode(&lpvg_can_guard_in_dp_measured, sample.u[0]);
    guard.yaw_rate_command = lpvg_can_encode(&lpvg_can_guard_in_yaw_rate_command, sample.y[0]);
    guard.control_request = k < 20U ? LPVG_BUS_REQUEST_RELEASE : LPVG_BUS_REQUEST_CONTROL;
    guard.other_priority = 0U;
    packed = packed && lpvg_can_guard_in_pack(&guard, &frames[n]) == lpvg_status_ok &&
             lpvg_can_e2e_protect(&frames[n++], LPVG_CAN_GUARD_IN_E2E_DATA_ID, counter) == lpvg_status_ok;
    if (k % 10U == 0U) {
        lpvg_can_ebc2_t ebc2{};
        ebc2.front_axle_speed = lpvg_can_encode(&lpvg_can_ebc2_front_axle_speed, sample.speed * kmh_per_mps);
        packed = packed && lpvg_can_ebc2_pack(&ebc2, &frames[n++]) == lpvg_status_ok;
        const lpvg_can_ebc1_t ebc1{};
        packed = packed && lpvg_can_ebc1_pack(&ebc1, &frames[n++]) == lpvg_status_ok;
    }
    require(packed, "the codec refused a frame\n");
    for (std::size_t i = 0; i < n; ++i) {
        frames[i].t_us = sample.t_us - 600 * static_cast<int64_t>(n - i);  // a 250 kbit/s bus needs 0.6 ms per frame
    }
    return n;
}

// Runs the step under the worst bus load: the largest number of frames, filled up with frames without a rule.
void run_full_bus(uint8_t* counter) {
    Part part("ecu_step_full");
    for (std::size_t k = 0; k < 200U; ++k) {
        lpvg_can_frame_t in[LPVG_ECU_FRAMES_IN] = {}, out[LPVG_ECU_FRAMES_OUT] = {};
        const std::size_t n_own = bus_frames(k + 20U, in, counter);
        const int64_t now_us = time_us(TARGET_INPUT_SAMPLES + k);
        for (std::size_t i = 0; i < LPVG_ECU_FRAMES_IN; ++i) {
            in[i].t_us = now_us;
            in[i].id = i < n_own ? in[i].id : LPVG_CAN_EXTENDED | 0x18FFEE00U;
            in[i].dlc = 8U;
        }
        std::size_t n_out = 0;
        part.run([&] {
            require(lpvg_ecu_step(&ecu, now_us, in, LPVG_ECU_FRAMES_IN, out, LPVG_ECU_FRAMES_OUT, &n_out) == lpvg_status_ok, "no step\n");
        });
    }
    part.write();
}

// Checks a message and its authenticator with a software CMAC that has no table except the S-box. Not part of the step.
void run_authentication() {
    const uint8_t key[16] = {0x2b, 0x7e, 0x15, 0x16, 0x28, 0xae, 0xd2, 0xa6, 0xab, 0xf7, 0x15, 0x88, 0x09, 0xcf, 0x4f, 0x3c};
    static AesCmac cmac(key);
    const lpvg_can_auth_config_t config = {AesCmac::hook, &cmac,  lpvg_bus.command_id,          lpvg_bus.authenticator_id,
                                           0xE3FFFFFFU,   5'000U, LPVG_CAN_GUARD_IN_E2E_DATA_ID};
    static lpvg_can_auth_t sender, receiver;
    require(lpvg_can_auth_init(&sender, &config, 0U) == lpvg_status_ok, "no sender\n");
    require(lpvg_can_auth_init(&receiver, &config, 0U) == lpvg_status_ok, "no receiver\n");
    Part part("auth_pair");
    for (std::size_t k = 0; k < 100U; ++k) {
        lpvg_can_frame_t message{}, authenticator{}, out{};
        message.id = config.id;
        message.dlc = 8U;
        message.data[0] = static_cast<uint8_t>(k);
        message.t_us = time_us(k);
        require(lpvg_can_auth_protect(&sender, &message, &authenticator) == lpvg_status_ok, "no authenticator\n");
        part.run([&] {
            require(lpvg_can_auth_receive(&receiver, &message, &out) == lpvg_can_auth_waiting, "not waiting\n");
            require(lpvg_can_auth_receive(&receiver, &authenticator, &out) == lpvg_can_auth_passed, "not passed\n");
        });
    }
    part.write();
}

// Worst case of the J1939 module, which runs beside the step: all code places used, one code that changes in each step, a full bus of
// requests and claims, and an active broadcast.
void run_j1939() {
    static lpvg_j1939_memory_t memory;
    static lpvg_j1939_t j1939;
    const lpvg_j1939_config_t config = {1U, lpvg_bus.own_address};
    constexpr uint32_t requests[] = {65226U, 65227U, 65229U, 64951U, 65262U};
    require(lpvg_j1939_init(&j1939, &config, &memory, 0, nullptr) == lpvg_status_ok, "the J1939 module refused its set-up\n");
    Part part("j1939_step");
    for (uint32_t k = 0; k < 1000U; ++k) {
        lpvg_can_frame_t in[LPVG_ECU_FRAMES_IN] = {}, out[LPVG_J1939_FRAMES_OUT];
        for (std::size_t i = 0; i < LPVG_ECU_FRAMES_IN; ++i) {
            const uint32_t pgn = requests[i % 5U];
            in[i].id = LPVG_CAN_EXTENDED | 0x18EA00F9U | (static_cast<uint32_t>(lpvg_bus.own_address) << 8U);
            in[i].dlc = 3U;
            in[i].data[0] = static_cast<uint8_t>(pgn);
            in[i].data[1] = static_cast<uint8_t>(pgn >> 8U);
            in[i].data[2] = static_cast<uint8_t>(pgn >> 16U);
        }
        lpvg_j1939_findings_t findings = {};
        findings.n_codes = LPVG_J1939_CODES_MAX - 1U;
        for (uint8_t i = 0U; i < findings.n_codes; ++i) {
            findings.code[i] = {520200U + i, 2U, 0U};
        }
        findings.code[0].spn += k % 2U == 0U ? 100U : 0U;
        std::size_t n_out = 0;
        part.run([&] {
            require(lpvg_j1939_step(&j1939, 10'000 * static_cast<int64_t>(k), in, LPVG_ECU_FRAMES_IN, &findings, out, LPVG_J1939_FRAMES_OUT,
                                    &n_out) == lpvg_status_ok,
                    "no J1939 step\n");
        });
    }
    part.write();
}

// Sends a command that the slave must accept.
void order(lpvg_xcp_t* slave, std::initializer_list<uint8_t> bytes, uint32_t address = 0U) {
    lpvg_can_frame_t command{}, answer{};
    command.id = slave->config.receive_id;
    command.dlc = 8U;
    std::memcpy(&command.data[4], &address, sizeof address);
    std::copy(bytes.begin(), bytes.end(), command.data);
    require(lpvg_xcp_receive(slave, &command, &answer) && answer.data[0] == 0xFFU, "XCP refuses a command\n");
}

// Starts the largest list, with one byte per entry, at every event.
void run_xcp_list(lpvg_xcp_t* slave, uint32_t address) {
    order(slave, {0xD6U});
    order(slave, {0xD5U, 0U, 1U, 0U});
    order(slave, {0xD4U, 0U, 0U, 0U, LPVG_XCP_ODTS_MAX});
    for (uint8_t odt = 0U; odt < LPVG_XCP_ODTS_MAX; ++odt) {
        order(slave, {0xD3U, 0U, 0U, 0U, odt, LPVG_XCP_ODT_ENTRIES_MAX});
        order(slave, {0xE2U, 0U, 0U, 0U, odt, 0U});
        for (uint32_t entry = 0U; entry < LPVG_XCP_ODT_ENTRIES_MAX; ++entry) {
            order(slave, {0xE1U, 0xFFU, 1U, 0U}, address + entry);
        }
    }
    order(slave, {0xE0U, 0U, 0U, 0U, 0U, 0U, 1U, 0U});
    order(slave, {0xDEU, 1U, 0U, 0U});
    lpvg_can_frame_t out[LPVG_XCP_ODTS_MAX];
    Part part("xcp_list");
    for (std::size_t k = 0; k < 100U; ++k) {
        part.run([&] { require(lpvg_xcp_event(slave, time_us(k), out, LPVG_XCP_ODTS_MAX) == LPVG_XCP_ODTS_MAX, "XCP sends nothing\n"); });
    }
    part.write();
}

// Worst cases of the XCP slave: a foreign frame, an event without a list, the longest command in the last of its ranges, and an event with
// the largest list. Not part of the step.
void run_xcp() {
    static lpvg_xcp_range_t ranges[LPVG_XCP_RANGES_MAX];
    for (uint32_t i = 0U; i < LPVG_XCP_RANGES_MAX; ++i) {
        ranges[i] = {i * 0x01000000U, sizeof ecu, &ecu};
    }
    const lpvg_xcp_config_t config = {0x98EF27F9U, 0x98EFF927U, "bench", ranges, LPVG_XCP_RANGES_MAX, 10'000U};
    static lpvg_xcp_t slave;
    require(lpvg_xcp_init(&slave, &config) == lpvg_status_ok, "no XCP slave\n");
    lpvg_can_frame_t foreign{}, command{}, answer{};
    foreign.id = LPVG_CAN_GUARD_IN_ID;
    foreign.dlc = 8U;
    command.id = config.receive_id;
    command.dlc = 8U;
    command.data[0] = 0xFFU;
    require(lpvg_xcp_receive(&slave, &command, &answer), "XCP does not connect\n");
    const uint32_t address = (LPVG_XCP_RANGES_MAX - 1U) * 0x01000000U;
    command.data[0] = 0xF4U;
    command.data[1] = 7U;
    std::memcpy(&command.data[4], &address, sizeof address);
    Part idle("xcp_idle");
    for (std::size_t k = 0; k < 100U; ++k) {
        idle.run([&] { require(!lpvg_xcp_receive(&slave, &foreign, &answer), "XCP answers a foreign frame\n"); });
    }
    idle.write();
    Part event("xcp_event");
    for (std::size_t k = 0; k < 100U; ++k) {
        event.run([&] { require(lpvg_xcp_event(&slave, time_us(k), &answer, 1U) == 0U, "XCP sends without a list\n"); });
    }
    event.write();
    Part upload("xcp_upload");
    for (std::size_t k = 0; k < 100U; ++k) {
        upload.run([&] { require(lpvg_xcp_receive(&slave, &command, &answer) && answer.dlc == 8U, "XCP reads nothing\n"); });
    }
    upload.write();
    run_xcp_list(&slave, address);
}

// Runs the whole step: frames in, supervision, cross-checks, controller, monitor, frames out.
void run_ecu() {
    // The drive does not respond to the demands of this controller. Findings about it must not end the measurement.
    const lpvg_ecu_config_t config = {true,  LPVG_ECU_CAUSES_OPTIONAL,         0U,
                                      false, {2.07F, 5.0F, 1.5F, 0.15F, 100U}, {0.14F, 0.04F, 30U, 0.32F}};
    Part init("ecu_init");
    init.run([&] {
        require(lpvg_ecu_init(&ecu, &lpvg_coeff, &lpvg_control_coeff, &config, 0) == lpvg_status_ok, "the ECU refused its set-up\n");
    });
    init.write();
    Part part("ecu_step");
    uint8_t counter = 0U;
    for (std::size_t k = 0; k < TARGET_INPUT_SAMPLES; ++k) {
        lpvg_can_frame_t in[4] = {}, out[LPVG_ECU_FRAMES_OUT] = {};
        const std::size_t n_in = bus_frames(k, in, &counter);
        std::size_t n_out = 0;
        part.run(
            [&] { require(lpvg_ecu_step(&ecu, time_us(k), in, n_in, out, LPVG_ECU_FRAMES_OUT, &n_out) == lpvg_status_ok, "no step\n"); });
        if (k % 100U == 0U) {
            Line().word("demand").number(static_cast<uint64_t>(time_us(k))).bits(ecu.control.u[0]).write();
        }
    }
    require(ecu.control.engaged && ecu.monitor.frame.sequence > 0U, "the ECU was not engaged to the end\n");
    part.write();
    run_full_bus(&counter);
}

#endif

#ifdef TARGET_EVIDENCE
// Takes samples of the truck's channels with the most slots. Every 60th sample is an alarm, so that records freeze and replace each other.
// Every 70 samples there is a gap.
void run_evidence() {
    constexpr uint32_t samples = 50U, channels = 1U + LPVG_NU + LPVG_NY;
    static int16_t buffer[LPVG_EVIDENCE_SLOTS_MAX * samples * channels];
    static lpvg_evidence_t evidence;
    const lpvg_evidence_config_t config = {
        buffer, samples, 20U, 10'000U, 0U, 0.5F, {1e-3F, 1e-3F, 1e-3F, 1e-3F}, channels, LPVG_NU, LPVG_EVIDENCE_SLOTS_MAX};
    require(lpvg_evidence_init(&evidence, &config) == lpvg_status_ok, "no evidence ring\n");
    Part take("evidence_take");
    for (uint32_t k = 0; k < TARGET_INPUT_SAMPLES; ++k) {
        const float values[channels] = {static_cast<float>(k % 30U), -1.0F, 0.5F, 0.25F};
        const lpvg_evidence_level_t level = k % 60U == 0U ? lpvg_evidence_invalid : lpvg_evidence_none;
        const float ratio = 1.0F + 1e-3F * static_cast<float>(k);
        take.run([&] {
            require(lpvg_evidence_take(&evidence, 10'000 * static_cast<int64_t>(k + 1U + k / 70U), values, level, ratio) == lpvg_status_ok,
                    "no evidence\n");
        });
    }
    require(evidence.numbered > 2U * LPVG_EVIDENCE_SLOTS_MAX, "no records\n");
    take.write();
    lpvg_evidence_reader_t reader{};
    require(lpvg_evidence_open(&reader, &evidence, lpvg_evidence_number(&evidence, 0U)) == lpvg_status_ok, "no record\n");
    uint8_t bytes[LPVG_EVIDENCE_CHUNK];
    Part read("evidence_read");
    for (uint32_t k = 0; k < 5U; ++k) {
        read.run([&] { require(lpvg_evidence_read(&reader, bytes, sizeof bytes) == sizeof bytes, "no bytes\n"); });
    }
    read.write();
}
#endif

}  // namespace

int main() {
    port_counter_start();
#ifdef TARGET_EVIDENCE  // a separate image, because the evidence ring is not part of the ROM budget
    Line().word("size").word("evidence").number(sizeof(lpvg_evidence_t)).write();
    run_evidence();
    port_write("end\n");
    return 0;
#endif
    Line().word("size").word("monitor").number(sizeof(lpvg_monitor_t)).write();
    run_init();
    run_monitor();
#ifdef TARGET_DIAGNOSES
    Line().word("size").word("diagnosis").number(sizeof(lpvg_diagnosis_t)).write();
    run_diagnosis();
#endif
#ifdef TARGET_ISOLATES
    Line().word("size").word("isolation").number(sizeof(lpvg_isolation_t)).write();
    run_isolation();
#endif
    run_model();
    run_margin();
#if LPVG_NK > 0
    Line().word("size").word("control").number(sizeof(lpvg_control_t)).write();
    Line().word("size").word("ecu").number(sizeof(lpvg_ecu_t)).write();
    run_watch();
    run_controller();
    run_dense_controller();
    Line().word("size").word("j1939").number(sizeof(lpvg_j1939_t) + sizeof(lpvg_j1939_memory_t)).write();
    run_ecu();
    run_authentication();
    run_j1939();
    run_xcp();
#endif
    port_write("end\n");
    return 0;
}
