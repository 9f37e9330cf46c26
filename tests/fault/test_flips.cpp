// Single bit flips in coefficients and state of a running ECU. The vehicle is the nominal model; where a flip could hide a fault, its
// actuator loses most of its gain at the time of the flip. What must hold, whatever bit it is:
//
//     no crash, no step refused
//     every demand within the largest limit, and its change within the rate limit, but for the jump to zero
//     a flip in the coefficients is found within two rounds of LPVG_ECU_ROUND_US; then the verdict is fault and the demand zero
//     while the vehicle's gain is at 0.3, none is valid and engaged 30 s after the flip, and none is valid a hold time after that
//
// Every STRIDE-th bit, a different one at each time; all of them with LPVGUARD_FULL=1.
#include "../catch.hpp"
#include "../long_form.hpp"

#include <cmath>
#include <cstdio>
#include <cstring>
#include <memory>

#include "lpvg_can_codec.h"
#include "lpvguard/ecu.h"

namespace {

constexpr int64_t tick_us = 10'000;
constexpr int found_steps = 2 * LPVG_ECU_ROUND_US / tick_us + 2;
constexpr std::size_t times[] = {1'000U, 4'000U, 9'000U};  // steps before the flip

const lpvg_ecu_config_t config = {true, 0U, 0U, {2.07F, 5.0F, 1.5F, 0.15F, 100U}, {0.14F, 1.0F, 30U}};

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
        vdc2.steering_wheel_angle = lpvg_can_vdc2_steering_wheel_angle_encode(20.0F * static_cast<float>(y[LPVG_NY - 1]));
        vdc2.yaw_rate = lpvg_can_vdc2_yaw_rate_encode(static_cast<float>(y[0]));
        vdc2.lateral_acceleration = lpvg_can_vdc2_lateral_acceleration_encode(12.0F * static_cast<float>(y[0]));
        bool packed = lpvg_can_vdc2_pack(&vdc2, &in[n++]) == lpvg_status_ok;
        lpvg_can_guard_in_t guard{};
        guard.dp_measured = lpvg_can_guard_in_dp_measured_encode(static_cast<float>(pressure_));
        guard.yaw_rate_command = lpvg_can_guard_in_yaw_rate_command_encode(0.06F * (std::sin(t) + std::sin(0.5F * t) + std::sin(2.0F * t)));
        guard.control_request = k_ < 20 ? LPVG_BUS_REQUEST_RELEASE : LPVG_BUS_REQUEST_CONTROL;
        packed = packed && lpvg_can_guard_in_pack(&guard, &in[n]) == lpvg_status_ok &&
                 lpvg_can_e2e_protect(&in[n++], LPVG_CAN_GUARD_IN_E2E_DATA_ID, &counter_) == lpvg_status_ok;
        if (k_ % 10 == 0) {
            lpvg_can_ebc2_t ebc2;
            std::memset(&ebc2, 0xFF, sizeof ebc2);
            ebc2.front_axle_speed = lpvg_can_ebc2_front_axle_speed_encode(12.0F * 3.6F);
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

void flip(void* object, std::size_t bit) { static_cast<unsigned char*>(object)[bit / 8U] ^= static_cast<unsigned char>(1U << (bit % 8U)); }

// Runs that differ in one bit from a good one.
class Campaign {
public:
    Campaign(std::size_t time, std::size_t stride) : stride_(long_form() ? 1U : stride), first_(time % stride_) { start_.run(time); }

    // For each bit of n_bytes of an object, `object` of a copy of the loop: `flipped` looks at the copy.
    template <class Object, class Look>
    void each(std::size_t n_bytes, const Object& object, const Look& look) {
        auto copy = std::make_unique<Loop>(start_);
        for (std::size_t bit = first_; bit < 8U * n_bytes; bit += stride_) {
            std::memcpy(static_cast<void*>(copy.get()), &start_, sizeof *copy);
            flip(object(*copy), bit);
            look(*copy, bit);
            model_coeff = lpvg_coeff;
            control_coeff = lpvg_control_coeff;
            ++trials;
        }
    }

    const Loop& start() const { return start_; }
    std::size_t trials = 0;

private:
    std::size_t stride_, first_;
    Loop start_;
};

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

TEST_CASE("a flip in the coefficients is found within two rounds, and never leaves the limits", "[fault][flips][REQ-ECU-15]") {
    const std::size_t time = GENERATE(from_range(std::begin(times), std::end(times)));
    const bool of_model = GENERATE(true, false);
    Campaign campaign(time, 61U);
    std::size_t missed = 0, wrong = 0, valid = 0;
    const std::size_t n_bytes = of_model ? sizeof(lpvg_coeff_t) : sizeof(lpvg_control_coeff_t);
    const auto object = [&](Loop&) { return of_model ? static_cast<void*>(&model_coeff) : static_cast<void*>(&control_coeff); };
    campaign.each(n_bytes, object, [&](Loop& loop, std::size_t bit) {
        loop.gain = 0.3;
        for (int i = 0; i < found_steps && !loop.ecu.kept.corrupt; ++i) {
            loop.step();
            wrong += loop.taken ? 0U : 1U;
        }
        const bool found = loop.ecu.kept.corrupt;
        loop.run(20U);
        missed += found && !(std::fabs(loop.demand) > 0.0) && !loop.engaged() ? 0U : 1U;
        valid += loop.verdict == lpvg_verdict_fault ? 0U : 1U;
        wrong += loop.out_of_limits;
        if (!found || loop.engaged() || std::fabs(loop.demand) > 0.0) {
            std::printf("bit %zu of byte %zu\n", bit % 8U, bit / 8U);
        }
    });
    CHECK(missed == 0U);
    CHECK(valid == 0U);
    CHECK(wrong == 0U);
    CHECK(campaign.trials > 20U);
}

TEST_CASE("a flip in the state leaves no wrong demand, and hides no fault for longer than stated",
          "[fault][flips][REQ-ECU-15][REQ-MON-15]") {
    const std::size_t time = GENERATE(from_range(std::begin(times), std::end(times)));
    Campaign campaign(time, 97U);
    std::size_t wrong = 0, hidden = 0;
    const auto object = [](Loop& loop) { return static_cast<void*>(&loop.ecu); };
    campaign.each(sizeof(lpvg_ecu_t), object, [&](Loop& loop, std::size_t bit) {
        loop.gain = 0.3;
        loop.run(3000U);
        // A loop that the flip has released excites nothing more: what was seen before stands for the hold time.
        const bool acting = loop.valid() && loop.engaged();
        for (std::size_t steps = 0; loop.valid() && steps < lpvg_coeff.words.frame_length[0]; ++steps) {
            loop.step();
        }
        hidden += acting || loop.valid() ? 1U : 0U;
        wrong += loop.out_of_limits;
        if (acting || loop.valid() || loop.out_of_limits > 0U) {
            std::printf("bit %zu of byte %zu\n", bit % 8U, bit / 8U);
        }
    });
    CHECK(hidden == 0U);
    CHECK(wrong == 0U);
    CHECK(campaign.trials > 20U);
}
