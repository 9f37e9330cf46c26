// Single bit flips in coefficients and state of a running ECU. The vehicle is the nominal model; where a flip could hide a fault, its
// actuator loses most of its gain at the time of the flip. What must hold, whatever bit it is:
//
//     no crash, no step refused
//     every demand within the largest limit, and its change within the rate limit, but for the jump to zero
//     a flip in the coefficients is found within two rounds of LPVG_ECU_ROUND_US; then the verdict is fault and the demand zero
//     while the vehicle's gain is at 0.3, none is valid and engaged 30 s after the flip, and none is valid a hold time after that
//
// Every STRIDE-th bit, a different one at each time. With LPVGUARD_FULL=1 all of them, and the table by field of lib/REQUIREMENTS.md is
// compared; LPVGUARD_FLIPS=lib/REQUIREMENTS.md writes it.
#include "../catch.hpp"
#include "../long_form.hpp"
#include "../marked_table.hpp"

#include <algorithm>
#include <cmath>
#include <cstddef>
#include <cstdio>
#include <cstring>
#include <memory>
#include <sstream>
#include <string>
#include <vector>

#include "lpvg_can_codec.h"
#include "lpvguard/ecu.h"

namespace {

constexpr int64_t tick_us = 10'000;
constexpr std::size_t found_steps = 2U * LPVG_ECU_ROUND_US / tick_us + 2;
constexpr std::size_t times[] = {1'000U, 4'000U, 9'000U};  // steps before the flip

const lpvg_ecu_config_t config = {true, 0U, 0U, false, {2.07F, 5.0F, 1.5F, 0.15F, 100U}, {0.14F, 0.04F, 30U, 0.25F}};

lpvg_coeff_t model_coeff;
lpvg_control_coeff_t control_coeff;

// The ECU in the loop with its nominal model. Copies run on from where they were made.
class Loop {
public:
    Loop() {
        model_coeff = lpvg_coeff;
        control_coeff = lpvg_control_coeff;
        REQUIRE(lpvg_ecu_init(&ecu, &model_coeff, &control_coeff, &config, 0) == lpvg_status_ok);
        const lpvg_real_t nothing[LPVG_NY] = {};
        lpvg_model_start(&vehicle_, &lpvg_coeff, nothing, nothing);
    }

    void step() {
        lpvg_real_t y[LPVG_NY];
        lpvg_model_output(&vehicle_, &lpvg_coeff, y);
        lpvg_can_frame_t in[4] = {}, out[LPVG_ECU_FRAMES_OUT];
        std::size_t n_in = 0U, n_out = 0U;
        const int64_t now_us = k_ * tick_us;
        pack(in, n_in, y);
        for (std::size_t i = 0; i < n_in; ++i) {
            in[i].t_us = now_us;
        }
        taken = lpvg_ecu_step(&ecu, now_us, in, n_in, out, LPVG_ECU_FRAMES_OUT, &n_out) == lpvg_status_ok;
        ++k_;
        const double before = demand;
        if (taken) {
            demand = static_cast<double>(ecu.report.demand);
            verdict = ecu.report.verdict;
        }
        const auto& r = lpvg_control_coeff.reals;
        double top = 0.0;
        for (const auto& node : r.u_max) {
            top = std::fmax(top, static_cast<double>(node[0]));
        }
        const double change = 1.5 * 1.002 * static_cast<double>(r.rate_max[0]) * 0.01;
        const bool within = std::fabs(demand) <= 1.002 * top && (std::fabs(demand - before) <= change || !(std::fabs(demand) > 0.0));
        out_of_limits += within ? 0U : 1U;
        const lpvg_real_t u[LPVG_NU] = {static_cast<lpvg_real_t>(gain * demand)};
        lpvg_model_advance(&vehicle_, &lpvg_coeff, lpvg_real_t(12), u);
        pressure_ += (demand - pressure_) / 15.0;
    }

    void run(std::size_t steps) {
        for (std::size_t i = 0; i < steps; ++i) {
            step();
        }
    }

    bool valid() const { return verdict == lpvg_verdict_valid; }
    bool engaged() const { return ecu.report.engagement == lpvg_ecu_engaged; }

    lpvg_ecu_t ecu;
    double gain = 1.0, demand = 0.0;
    std::size_t out_of_limits = 0;
    uint8_t verdict = 0;
    bool taken = false;

private:
    void pack(lpvg_can_frame_t* in, std::size_t& n, const lpvg_real_t* y) {
        const auto t = static_cast<float>(k_) * 0.01F;
        lpvg_can_vdc2_t vdc2{};
        vdc2.steering_wheel_angle = lpvg_can_encode(&lpvg_can_vdc2_steering_wheel_angle, 20.0F * static_cast<float>(y[LPVG_NY - 1]));
        vdc2.yaw_rate = lpvg_can_encode(&lpvg_can_vdc2_yaw_rate, static_cast<float>(y[0]));
        vdc2.lateral_acceleration = lpvg_can_encode(&lpvg_can_vdc2_lateral_acceleration, 12.0F * static_cast<float>(y[0]));
        bool packed = lpvg_can_vdc2_pack(&vdc2, &in[n++]) == lpvg_status_ok;
        lpvg_can_guard_in_t guard{};
        guard.dp_measured = lpvg_can_encode(&lpvg_can_guard_in_dp_measured, static_cast<float>(pressure_));
        guard.yaw_rate_command =
            lpvg_can_encode(&lpvg_can_guard_in_yaw_rate_command, 0.06F * (std::sin(t) + std::sin(0.5F * t) + std::sin(2.0F * t)));
        guard.control_request = k_ < 20 ? LPVG_BUS_REQUEST_RELEASE : LPVG_BUS_REQUEST_CONTROL;
        packed = packed && lpvg_can_guard_in_pack(&guard, &in[n]) == lpvg_status_ok &&
                 lpvg_can_e2e_protect(&in[n++], LPVG_CAN_GUARD_IN_E2E_DATA_ID, &counter_) == lpvg_status_ok;
        if (k_ % 10 == 0) {
            lpvg_can_ebc2_t ebc2;
            std::memset(&ebc2, 0xFF, sizeof ebc2);
            ebc2.front_axle_speed = lpvg_can_encode(&lpvg_can_ebc2_front_axle_speed, 12.0F * 3.6F);
            const lpvg_can_ebc1_t ebc1{};
            packed =
                packed && lpvg_can_ebc2_pack(&ebc2, &in[n++]) == lpvg_status_ok && lpvg_can_ebc1_pack(&ebc1, &in[n++]) == lpvg_status_ok;
        }
        REQUIRE(packed);
    }

    lpvg_model_t vehicle_;
    double pressure_ = 0.0;
    int64_t k_ = 0;
    uint8_t counter_ = 0;
};

// A group of members in which bits are flipped, up to the next group; padding counts to the group before it.
struct Field {
    const char* name;
    std::size_t offset;
};

#define LPVG_WORDS(name, first) {"words: " name, offsetof(lpvg_coeff_t, words.first)}
#define LPVG_REALS(name, first) {"reals: " name, offsetof(lpvg_coeff_t, reals.first)}
#define LPVG_STATE(name, first) {name, offsetof(lpvg_ecu_t, first)}

const std::vector<Field> model_fields = {
    {"words: magic to crc32", 0U},
    LPVG_WORDS("sample_period_us to change_rearm", sample_period_us),
    LPVG_WORDS("frame_length to varying_entry", frame_length),
    LPVG_REALS("speed_min to output_offset", speed_min),
    LPVG_REALS("base to C_pinv", base),
    LPVG_REALS("turn to scale", turn),
    LPVG_REALS("energy_corner to energy_certificate", energy_corner),
    LPVG_REALS("change_block_s to change_threshold", change_block_s),
    LPVG_REALS("W_delta to threshold", W_delta),
};
const std::vector<Field> control_fields = {{"words", 0U}, {"reals", offsetof(lpvg_control_coeff_t, reals)}};
const std::vector<Field> state_fields = {
    LPVG_STATE("kept to crc", kept),         LPVG_STATE("supervisor to expected", supervisor),
    LPVG_STATE("control", control),          LPVG_STATE("monitor: coeff to change_quiet", monitor.coeff),
    LPVG_STATE("monitor: bin", monitor.bin), LPVG_STATE("monitor: frame to bad_samples", monitor.frame),
    LPVG_STATE("report to dm1_us", report),  LPVG_STATE("watch to causes", watch),
};

// What the flips in a field did.
struct Tally {
    std::size_t trials = 0U, stuck = 0U, wrong = 0U, longest = 0U;  // longest: steps until it no longer acts on the damage
};

// Of one flip: whether it stayed, let a wrong demand out, and for how many steps the loop went on with it.
struct Outcome {
    bool stuck;
    std::size_t wrong, steps;
};

// Runs that differ in one bit from a good one, by field.
class Campaign {
public:
    Campaign(const char* part, const std::vector<Field>& fields, std::size_t n_bytes, std::size_t stride)
        : part_(part), fields_(fields), tallies_(fields.size()), n_bytes_(n_bytes), stride_(long_form() ? 1U : stride) {}

    // For each bit of an object, `object` of a copy of a loop that has run for `time` steps, what `run` makes of the copy.
    template <class Object, class Run>
    void each(std::size_t time, const Object& object, const Run& run) {
        const auto start = std::make_unique<Loop>();
        start->run(time);
        auto copy = std::make_unique<Loop>(*start);
        for (std::size_t bit = time % stride_; bit < 8U * n_bytes_; bit += stride_) {
            std::memcpy(static_cast<void*>(copy.get()), start.get(), sizeof *copy);
            static_cast<unsigned char*>(object(*copy))[bit / 8U] ^= static_cast<unsigned char>(1U << (bit % 8U));
            copy->gain = 0.3;
            take(bit, run(*copy));
            model_coeff = lpvg_coeff;
            control_coeff = lpvg_control_coeff;
        }
    }

    // Fails where a flip did what none may; returns the rows of the table.
    std::string rows() const {
        std::ostringstream text;
        for (std::size_t i = 0U; i < fields_.size(); ++i) {
            const Tally& t = tallies_[i];
            CAPTURE(part_, fields_[i].name);
            CHECK(t.stuck == 0U);
            CHECK(t.wrong == 0U);
            text << head(i) << t.trials << " | " << t.stuck << " | " << t.wrong << " | " << std::ceil(0.01 * static_cast<double>(t.longest))
                 << " |\n";
        }
        return text.str();
    }

    // What a row begins with, whatever the flips do.
    std::string head(std::size_t i) const {
        const std::size_t end = i + 1U < fields_.size() ? fields_[i + 1U].offset : n_bytes_;
        return std::string("| ") + part_ + " | `" + fields_[i].name + "` | " + std::to_string(8U * (end - fields_[i].offset)) + " | ";
    }

    std::size_t size() const { return fields_.size(); }
    std::size_t trials() const {
        std::size_t sum = 0U;
        for (const Tally& t : tallies_) {
            sum += t.trials;
        }
        return sum;
    }

private:
    void take(std::size_t bit, const Outcome& outcome) {
        const auto behind = std::upper_bound(fields_.begin(), fields_.end(), bit / 8U,
                                             [](std::size_t byte, const Field& field) { return byte < field.offset; });
        Tally& tally = tallies_[static_cast<std::size_t>(behind - fields_.begin() - 1)];
        ++tally.trials;
        tally.stuck += outcome.stuck ? 1U : 0U;
        tally.wrong += outcome.wrong > 0U ? 1U : 0U;
        tally.longest = std::max(tally.longest, outcome.steps);
        if (outcome.stuck || outcome.wrong > 0U) {
            std::printf("%s: bit %zu of byte %zu\n", part_, bit % 8U, bit / 8U);
        }
    }

    const char* part_;
    const std::vector<Field>& fields_;
    std::vector<Tally> tallies_;
    std::size_t n_bytes_, stride_;
};

// Of a flip in the coefficients: until it is found. It stays where it is not, or where the loop acts all the same.
Outcome until_found(Loop& loop) {
    std::size_t steps = 0U, refused = 0U;
    for (; steps < found_steps && !loop.ecu.kept.corrupt; ++steps) {
        loop.step();
        refused += loop.taken ? 0U : 1U;
    }
    const bool found = loop.ecu.kept.corrupt;
    loop.run(20U);
    const bool released = !(std::fabs(loop.demand) > 0.0) && !loop.engaged() && loop.verdict == lpvg_verdict_fault;
    return {!found || !released, loop.out_of_limits + refused, steps};
}

// Of a flip in the state: until the loop last was valid and engaged, with the fault of the vehicle that began with the flip. A loop that
// the flip has released excites nothing more: what was seen before stands for the hold time.
Outcome until_last_valid(Loop& loop) {
    std::size_t last = 0U;
    for (std::size_t steps = 1U; steps <= 3000U; ++steps) {
        loop.step();
        last = loop.valid() && loop.engaged() ? steps : last;
    }
    const bool acting = last == 3000U;
    for (std::size_t steps = 0; loop.valid() && steps < lpvg_coeff.words.frame_length[0]; ++steps) {
        loop.step();
    }
    return {acting || loop.valid(), loop.out_of_limits, last};
}

}  // namespace

TEST_CASE("the loop that bits are flipped in is engaged and valid, and its fault is found without a flip", "[fault][flips][REQ-ECU-15]") {
    for (const std::size_t time : times) {
        auto loop = std::make_unique<Loop>();
        loop->run(time);
        CAPTURE(time, +loop->verdict, loop->ecu.causes);
        CHECK(loop->engaged());
        CHECK(std::fabs(loop->demand) > 0.01);
        loop->gain = 0.3;
        std::size_t steps = 0;
        for (; loop->verdict != lpvg_verdict_invalid && steps < 6000U; ++steps) {
            loop->step();
        }
        std::printf("gain 0.3 after %zu steps: invalid after %.2f s\n", time, 0.01 * static_cast<double>(steps));
        CHECK(loop->verdict == lpvg_verdict_invalid);
        CHECK(loop->out_of_limits == 0U);
        loop->run(3000U);
        CHECK(loop->ecu.rounds >= 6U);
        CHECK_FALSE(loop->ecu.kept.corrupt);
    }
}

TEST_CASE("no flip leaves valid standing or a wrong demand: coefficients are found, state is found, healed or outlived",
          "[fault][flips][REQ-ECU-15][REQ-MON-15]") {
    Campaign model("model coefficients", model_fields, sizeof(lpvg_coeff_t), 61U);
    Campaign control("controller coefficients", control_fields, sizeof(lpvg_control_coeff_t), 61U);
    Campaign state("state", state_fields, sizeof(lpvg_ecu_t), 97U);
    for (const std::size_t time : times) {
        model.each(time, [](Loop&) { return static_cast<void*>(&model_coeff); }, until_found);
        control.each(time, [](Loop&) { return static_cast<void*>(&control_coeff); }, until_found);
        state.each(time, [](Loop& loop) { return static_cast<void*>(&loop.ecu); }, until_last_valid);
    }
    std::string text =
        "| of | field | bits | flips | stuck | demand beyond limits | longest [s] |\n| --- | --- | --- | --- | --- | --- | --- |\n";
    MarkedTable table("flips", "test_flips");
    for (const Campaign* campaign : {&model, &control, &state}) {
        CHECK(campaign->trials() > 20U);
        text += campaign->rows();
        for (std::size_t i = 0U; i < campaign->size(); ++i) {
            CAPTURE(campaign->head(i));
            CHECK((std::getenv("LPVGUARD_FLIPS") != nullptr || table.text().find(campaign->head(i)) != std::string::npos));
        }
    }
    if (long_form()) {
        table.require(text, "LPVGUARD_FLIPS");
    }
}
