// The monitor as a black box: samples in, statuses, frames and verdicts out. Compiled for every test vehicle.
#include "../catch.hpp"

#include <algorithm>
#include <array>
#include <cmath>
#include <complex>
#include <cstring>
#include <functional>
#include <limits>
#include <map>
#include <utility>
#include <vector>

#include "monitor/acceptance.hpp"
#include "monitor_drive.hpp"

namespace {

// This program is about frames: energy test (test_energy.cpp), change test (test_change.cpp) and pools never speak. The certificate's
// bounds are `wider` times those of the healthy set.
lpvg_coeff_t frames_only(const std::function<void(lpvg_coeff_t&)>& change, Real wider = Real(1)) {
    return sealed([&](lpvg_coeff_t& c) {
        c.reals.energy_threshold = Real(1e9);
        c.reals.change_threshold = Real(1e9);
        std::fill_n(&c.reals.pool_scale[0][0][0][0], LPVG_NSPEEDS * LPVG_NBINS * 2 * LPVG_NY, Real(0));
        change(c);
        for (std::size_t b = 0; b < LPVG_NBINS; ++b) {
            for (std::size_t j = 0; j < LPVG_NY; ++j) {
                c.reals.B_certificate[b][j] = wider * c.reals.B_w[b][j];
                c.reals.W_certificate[b][j % LPVG_NDELTA] = wider * c.reals.W_delta[b][j % LPVG_NDELTA];
            }
        }
    });
}

// Only the given bin can object, at threshold 1, and a single frame is enough.
lpvg_coeff_t only_bin(uint32_t bin, Real wider = Real(1)) {
    const auto change = [bin](lpvg_coeff_t& c) {
        c.words.confirm = c.words.of_last = 1U;
        c.reals.threshold = Real(1);
        for (uint32_t b = 0; b < LPVG_NBINS; ++b) {
            for (std::size_t j = 0; j < LPVG_NY; ++j) {
                c.reals.B_w[b][j] = b == bin ? Real(0.001) : Real(1e6);
            }
            std::fill(std::begin(c.reals.W_delta[b]), std::end(c.reals.W_delta[b]), Real(0.2));
        }
    };
    return frames_only(change, wider);
}

bool is_zero(const lpvg_frame_t& f) {
    Real sum = std::fabs(f.speed) + std::fabs(f.margin) + std::fabs(f.statistic) + std::fabs(f.evidence);
    for (std::size_t j = 0; j < LPVG_NY; ++j) {
        sum += std::fabs(f.E[j][0]) + std::fabs(f.E[j][1]) + std::fabs(f.Z[j][0]) + std::fabs(f.Z[j][1]);
    }
    return sum == Real(0) && !f.falsified;
}

}  // namespace

TEST_CASE("cleared memory never reads valid, and nothing works before init", "[unit][monitor][REQ-MON-1]") {
    lpvg_monitor_t monitor;
    std::memset(&monitor, 0, sizeof monitor);
    lpvg_sample_t sample{};
    lpvg_frame_t record{};
    CHECK(static_cast<int>(lpvg_verdict_unknown) == 0);
    CHECK(lpvg_monitor_verdict(&monitor, 0) == lpvg_verdict_fault);
    CHECK(lpvg_monitor_push(&monitor, &sample) == lpvg_status_not_ready);
    CHECK(lpvg_monitor_reason(&monitor) == lpvg_reason_none);
    CHECK(lpvg_monitor_frame(&monitor) == nullptr);
    CHECK_FALSE(lpvg_monitor_take_record(&monitor, &record));
}

TEST_CASE("NULL gives a defined answer everywhere", "[unit][monitor][REQ-MON-13]") {
    Drive drive;
    lpvg_sample_t sample{};
    lpvg_frame_t record{};
    CHECK(lpvg_monitor_push(nullptr, &sample) == lpvg_status_bad_argument);
    CHECK(lpvg_monitor_push(&drive.monitor, nullptr) == lpvg_status_bad_argument);
    CHECK(lpvg_monitor_verdict(nullptr, 0) == lpvg_verdict_fault);
    CHECK(lpvg_monitor_reason(nullptr) == lpvg_reason_none);
    CHECK(lpvg_monitor_frame(nullptr) == nullptr);
    CHECK_FALSE(lpvg_monitor_take_record(nullptr, &record));
    CHECK_FALSE(lpvg_monitor_take_record(&drive.monitor, nullptr));
}

TEST_CASE("a healthy, excited vehicle: unknown until the first frame ends, then valid for good", "[unit][monitor][REQ-MON-6]") {
    Drive drive;
    CHECK(drive.verdict() == lpvg_verdict_unknown);
    CHECK(lpvg_monitor_frame(&drive.monitor)->sequence == 0U);
    uint32_t k = 0;
    while (lpvg_monitor_frame(&drive.monitor)->sequence == 0U) {
        REQUIRE(drive.step() == lpvg_status_ok);
        ++k;
        if (lpvg_monitor_frame(&drive.monitor)->sequence == 0U) {
            REQUIRE(drive.verdict() == lpvg_verdict_unknown);
        }
    }
    CHECK(k >= words().frame_length[LPVG_NBINS - 1]);  // the shortest frame
    CHECK(k < words().frame_length[LPVG_NBINS - 1] + LPVG_NBLOCK);
    drive.settle();
    std::size_t not_valid = 0;
    for (uint32_t i = 0; i < 2U * longest(); ++i) {
        not_valid += drive.step() != lpvg_status_ok || drive.verdict() != lpvg_verdict_valid ? 1U : 0U;
    }
    CHECK(not_valid == 0U);
    CHECK(lpvg_monitor_reason(&drive.monitor) == drive.monitor.frame.reason);
}

TEST_CASE("frames hold the Hann spectra of e and yhat, in amplitude", "[unit][monitor][REQ-MON-2]") {
    const auto bin = GENERATE(0U, 1U, uint32_t{LPVG_NBINS - 1});
    // Odd and even numbers of periods a frame.
    const uint32_t cycles = words().cycles[bin] + (bin == 0U ? 0U : GENERATE(0U, 1U));
    Drive drive(sealed([=](lpvg_coeff_t& c) {
        const double turn = 6.283185307179586 * cycles / c.words.frame_length[bin];
        c.words.cycles[bin] = cycles;
        c.reals.turn[bin][0] = static_cast<Real>(-2.0 * std::sin(0.5 * turn) * std::sin(0.5 * turn));
        c.reals.turn[bin][1] = static_cast<Real>(std::sin(turn));
    }));
    // Also off the bin: a sinusoid in the bin has the same spectrum under other windows of the same sum.
    drive.bin = GENERATE(false, true) ? LPVG_NBINS / 2 : std::max(bin, 1U);
    drive.gain = 0.8;
    // yhat of the monitor is that of the test's own model once the start has decayed, to double's precision too.
    drive.run(8U * words().settle_samples);
    std::vector<std::array<double, LPVG_NY>> output;
    std::vector<lpvg_frame_t> frames;
    const int64_t origin = drive.now() + period_us();
    for (uint32_t k = 0; k < 3U * longest(); ++k) {
        const uint32_t before = drive.monitor.frame.sequence;
        REQUIRE(drive.step() == lpvg_status_ok);
        std::array<double, LPVG_NY> y{};
        for (std::size_t j = 0; j < LPVG_NY; ++j) {
            y[j] = static_cast<double>(drive.sample.y[j]);
        }
        output.push_back(y);
        const lpvg_frame_t& frame = *lpvg_monitor_frame(&drive.monitor);
        if (frame.sequence != before && frame.bin == bin) {
            frames.push_back(frame);
        }
    }
    const auto N = static_cast<int64_t>(words().frame_length[bin]);
    double worst = 0.0;
    std::size_t compared = 0;
    for (const lpvg_frame_t& frame : frames) {
        const int64_t first = (frame.t_end_us - origin) / period_us() - N + 1;
        if (first < 0) {
            continue;
        }
        ++compared;
        for (std::size_t j = 0; j < LPVG_NY; ++j) {
            std::complex<double> Y = 0.0;
            double weight = 0.0;
            for (int64_t n = 0; n < N; ++n) {
                const double turn = 6.283185307179586 * static_cast<double>(n) / static_cast<double>(N);
                const double w = 0.5 - 0.5 * std::cos(turn);
                weight += w;
                Y += w * output[static_cast<std::size_t>(first + n)][j] * std::polar(1.0, -turn * cycles);
            }
            Y *= (cycles == 0U ? 1.0 : 2.0) / weight;
            const std::complex<double> Z(static_cast<double>(frame.Z[j][0]), static_cast<double>(frame.Z[j][1]));
            const std::complex<double> E(static_cast<double>(frame.E[j][0]), static_cast<double>(frame.E[j][1]));
            worst = std::max({worst, std::abs(Y - 0.8 * Z), std::abs(E + 0.2 * Z)});
        }
    }
    CAPTURE(worst);
    CHECK(compared >= 2U);
    CHECK(worst <= (sizeof(Real) == 4U ? 2e-5 : 1e-12));  // signals are of size 0.1 to 1
}

TEST_CASE("a frame is judged at most LPVG_NLATENCY samples after its end, one a push, none lost", "[unit][monitor][REQ-MON-12]") {
    Drive drive;
    std::array<int64_t, LPVG_NBINS> last_end{};
    int64_t latest = 0;
    uint32_t sequence = 0, judged = 0;
    drive.run(20U * longest(), [&](const lpvg_frame_t& frame) {
        ++judged;
        ++sequence;
        CHECK(frame.sequence == sequence);
        latest = std::max(latest, (drive.now() - frame.t_end_us) / period_us());
        const int64_t half = period_us() * (words().frame_length[frame.bin] / 2U);
        const int64_t first_end = 2 * half - period_us();
        CHECK(frame.t_end_us == (last_end[frame.bin] == 0 ? first_end : last_end[frame.bin] + half));
        last_end[frame.bin] = frame.t_end_us;
    });
    CHECK(latest <= LPVG_NLATENCY);
    uint32_t ended = 0;
    for (std::size_t b = 0; b < LPVG_NBINS; ++b) {
        ended += 20U * longest() / (words().frame_length[b] / 2U) - 1U;
    }
    CHECK(ended - judged <= LPVG_NBINS);
}

TEST_CASE("the verdict flips exactly where the gain leaves the bound", "[unit][monitor][REQ-MON-5]") {
    const auto bin = GENERATE(1U, uint32_t{LPVG_NBINS - 1});
    const double side = GENERATE(1.0, -1.0);
    const lpvg_coeff_t coeff = only_bin(bin);
    // With E = (g - 1) Z, t* = |g - 1| / (W + B / |Z|) for one output; for more, one of them decides.
    double critical = 0.0;
    {
        Drive drive(coeff);
        drive.bin = bin;
        drive.gain = 1.0 + 0.1 * side;
        drive.settle();
        lpvg_frame_t frame{};
        drive.run(longest(), [&](const lpvg_frame_t& f) { frame = f.bin == bin ? f : frame; });
        REQUIRE(frame.margin > Real(0));
        CHECK(drive.verdict() == lpvg_verdict_valid);
        critical = 0.1 / static_cast<double>(frame.margin);
        if (LPVG_NDELTA == LPVG_NY) {
            double least = std::numeric_limits<double>::infinity();
            for (std::size_t j = 0; j < LPVG_NY; ++j) {
                const double Z = std::hypot(static_cast<double>(frame.Z[j][0]), static_cast<double>(frame.Z[j][1]));
                least = std::min(least, static_cast<double>(coeff.reals.W_delta[bin][j]) + 0.001 / Z);
            }
            CHECK(critical == Approx(least).epsilon(1e-4));
        }
        CHECK(critical > 0.2);  // W_delta
    }
    for (const double part : {0.998, 1.002}) {
        CAPTURE(bin, side, part);
        Drive drive(coeff);
        drive.bin = bin;
        drive.gain = 1.0 + side * critical * part;
        drive.settle();
        drive.run(2U * longest());
        CHECK(drive.verdict() == (part < 1.0 ? lpvg_verdict_valid : lpvg_verdict_invalid));
    }
}

TEST_CASE("a frame beyond the healthy set is degraded, and beyond the certificate set invalid", "[unit][monitor][REQ-MON-5][REQ-MON-20]") {
    const auto bin = GENERATE(1U, uint32_t{LPVG_NBINS - 1});
    const Real wider = Real(2);
    for (const double of_margin : {0.998, 1.002, 1.998, 2.002}) {
        CAPTURE(bin, of_margin);
        double unit = 0.0;  // gain error of a margin of 1
        for (const bool seek : {true, false}) {
            Drive drive(only_bin(bin, wider));
            drive.bin = bin;
            drive.gain = seek ? 0.9 : 1.0 - of_margin * unit;
            drive.settle();
            lpvg_frame_t newest{};
            drive.run(2U * longest(), [&](const lpvg_frame_t& f) { newest = f.bin == bin ? f : newest; });
            unit = seek ? 0.1 / static_cast<double>(newest.margin) : unit;
            if (!seek) {
                const auto expected =
                    of_margin < 1.0 ? lpvg_verdict_valid : (of_margin < 2.0 ? lpvg_verdict_degraded : lpvg_verdict_invalid);
                CHECK(drive.verdict() == expected);
                CHECK(newest.falsified == (of_margin > 1.0));
                CHECK(newest.refuted == (of_margin > 2.0));
            }
        }
    }
}

TEST_CASE("an output by itself refutes the certificate where only its W is wider", "[unit][monitor][REQ-MON-20]") {
    const uint32_t bin = 1U;
    lpvg_coeff_t coeff = only_bin(bin);
    for (Real& W : coeff.reals.W_certificate[bin]) {
        W = Real(3) * coeff.reals.W_delta[bin][0];
    }
    std::fill(std::begin(coeff.reals.B_w[bin]), std::end(coeff.reals.B_w[bin]), Real(1e-6));
    std::fill(std::begin(coeff.reals.B_certificate[bin]), std::end(coeff.reals.B_certificate[bin]), Real(1e-6));
    coeff.words.crc32 = lpvg_coeff_crc32(&coeff);
    for (const double error : {0.59, 0.61}) {
        Drive drive(coeff);
        drive.bin = bin;
        drive.gain = 1.0 - error;
        drive.settle();
        drive.run(2U * longest());
        CHECK(drive.verdict() == (error < 0.6 ? lpvg_verdict_degraded : lpvg_verdict_invalid));
    }
}

TEST_CASE("an output by itself refutes the certificate where only its B is wider", "[unit][monitor][REQ-MON-20]") {
    const uint32_t bin = 1U;
    lpvg_coeff_t coeff = only_bin(bin);
    std::fill(std::begin(coeff.reals.B_w[bin]), std::end(coeff.reals.B_w[bin]), Real(1e-6));
    std::fill(std::begin(coeff.reals.B_certificate[bin]), std::end(coeff.reals.B_certificate[bin]), Real(3e-6));
    coeff.words.crc32 = lpvg_coeff_crc32(&coeff);
    Drive drive(coeff);
    drive.bin = bin;
    drive.gain = 0.7;
    drive.settle();
    drive.run(2U * longest());
    CHECK(drive.verdict() == lpvg_verdict_invalid);
}

TEST_CASE("invalid is held for the longest frame after the last falsifying one", "[unit][monitor][REQ-MON-5]") {
    Drive drive(only_bin(LPVG_NBINS - 1));
    drive.bin = LPVG_NBINS - 1;
    drive.gain = 0.3;
    drive.settle();
    REQUIRE(drive.verdict() == lpvg_verdict_invalid);
    drive.gain = 1.0;
    int64_t last_falsified = drive.monitor.t_falsified_us;
    int64_t recovered = 0;
    for (uint32_t k = 0; k < 3U * longest() && recovered == 0; ++k) {
        REQUIRE(drive.step() == lpvg_status_ok);
        const lpvg_frame_t& frame = *lpvg_monitor_frame(&drive.monitor);
        last_falsified = frame.falsified ? std::max(last_falsified, frame.t_end_us) : last_falsified;
        recovered = drive.verdict() == lpvg_verdict_valid ? drive.now() : 0;
    }
    CHECK(recovered - last_falsified == period_us() * (longest() + 1));
}

TEST_CASE("a frame that ended before its evidence was made void gives none", "[unit][monitor][REQ-MON-5]") {
    Drive drive;
    drive.settle();
    REQUIRE(drive.verdict() == lpvg_verdict_valid);
    lpvg_monitor_void(&drive.monitor);
    CHECK(drive.verdict() == lpvg_verdict_not_judged);
    // Frames are judged a step or more behind their end. The second drive is the first, with its evidence void just before one is judged.
    Drive first, second;
    first.settle();
    second.settle();
    const int64_t known_us = first.monitor.t_evidence_us;
    while (first.monitor.t_evidence_us == known_us) {
        REQUIRE(first.step() == lpvg_status_ok);
        if (first.monitor.t_evidence_us == known_us) {
            REQUIRE(second.step() == lpvg_status_ok);
        }
    }
    REQUIRE(first.monitor.t_evidence_us <= second.monitor.t_us);
    lpvg_monitor_void(&second.monitor);
    REQUIRE(second.step() == lpvg_status_ok);
    CHECK_FALSE(second.monitor.has_evidence);
    drive.run(4U * longest());
    CHECK(drive.verdict() == lpvg_verdict_valid);
    lpvg_monitor_void(nullptr);
    lpvg_monitor_t cleared{};
    lpvg_monitor_void(&cleared);
    CHECK(cleared.t_void_us == 0);
}

TEST_CASE("a quiet vehicle is not judged, for want of excitation", "[unit][monitor][REQ-MON-6]") {
    Drive drive;
    drive.amplitude = 0.0;
    drive.settle();
    drive.run(longest(), [&drive](const lpvg_frame_t& frame) {
        CHECK(frame.reason == lpvg_reason_not_excited);
        CHECK_FALSE(frame.falsified);
        CHECK(frame.evidence <= lpvg_coeff.reals.threshold);
        CHECK(drive.verdict() == lpvg_verdict_not_judged);  // whichever bin the newest frame is of
    });
    CHECK(drive.verdict() == lpvg_verdict_not_judged);
    CHECK(lpvg_monitor_reason(&drive.monitor) == lpvg_reason_not_excited);
}

TEST_CASE("evidence expires after the longest frame", "[unit][monitor][REQ-MON-6]") {
    Drive drive;
    drive.settle();
    REQUIRE(drive.verdict() == lpvg_verdict_valid);
    drive.amplitude = 0.0;
    drive.run(3U * longest());
    CHECK(drive.verdict() == lpvg_verdict_not_judged);
}

TEST_CASE("frames that do not count say why and hold nothing else", "[unit][monitor][REQ-MON-7]") {
    const lpvg_coeff_reals_t& r = lpvg_coeff.reals;
    SECTION("settling after the start") {
        Drive drive;
        uint32_t settling = 0;
        drive.run(words().settle_samples + words().frame_length[LPVG_NBINS - 1], [&](const lpvg_frame_t& frame) {
            const int64_t first = frame.t_end_us / period_us() + 1 - words().frame_length[frame.bin];
            const bool settled = first >= static_cast<int64_t>(words().settle_samples);
            CHECK((frame.reason == lpvg_reason_settling) == !settled);
            settling += settled ? 0U : 1U;
            CHECK((settled || is_zero(frame)));
        });
        CHECK(settling > 0U);
    }
    SECTION("out of range, below and above") {
        const Real speed = GENERATE(Real(0.9), Real(1.1));
        Drive drive;
        drive.settle();
        drive.speed = speed < Real(1) ? speed * r.speed_min : speed * r.speed_max;
        drive.run(longest() + LPVG_NBINS);
        drive.run(longest(), [](const lpvg_frame_t& frame) {
            CHECK(frame.reason == lpvg_reason_out_of_range);
            CHECK(is_zero(frame));
        });
        CHECK(drive.verdict() == lpvg_verdict_not_judged);
        CHECK(lpvg_monitor_reason(&drive.monitor) == lpvg_reason_out_of_range);
        drive.speed = cruise();
        drive.settle();
        drive.run(longest(), [](const lpvg_frame_t& frame) { CHECK(frame.reason <= lpvg_reason_not_excited); });
    }
    SECTION("one sample out of range spoils every frame that holds it, and settling begins anew") {
        Drive drive;
        drive.settle();
        drive.speed = r.speed_max * Real(1.01);
        drive.run(1U);
        const int64_t outside = drive.now();
        drive.speed = cruise();
        std::array<std::size_t, 2> seen{};
        drive.run(words().settle_samples + longest() + LPVG_NBINS, [&](const lpvg_frame_t& frame) {
            const int64_t first = frame.t_end_us - period_us() * (words().frame_length[frame.bin] - 1);
            if (frame.t_end_us < outside) {
                CHECK(frame.reason <= lpvg_reason_not_excited);
            } else if (first <= outside) {
                CHECK(frame.reason == lpvg_reason_out_of_range);
                ++seen[0];
            } else if (first <= outside + period_us() * words().settle_samples) {
                CHECK(frame.reason == lpvg_reason_settling);
                ++seen[1];
            }
        });
        CHECK(seen[0] > 0U);
        CHECK(seen[1] > 0U);
    }
    SECTION("speed moves more than the tolerance around its mean, and no less") {
        const Real part = GENERATE(Real(0.95), Real(1.06));
        Drive drive;
        drive.settle();
        // Alternating speeds, so that every frame has the same mean and the same extremes.
        std::size_t frames = 0, moved = 0;
        for (uint32_t k = 0; k < 2U * longest() + LPVG_NBINS; ++k) {
            const Real swing = part * r.speed_tolerance;
            drive.speed = cruise() * (k % 2U == 0U ? Real(1) + swing : Real(1) - swing);
            drive.run(1U, [&](const lpvg_frame_t& frame) {
                if (k > longest() + LPVG_NBINS) {
                    ++frames;
                    moved += frame.reason == lpvg_reason_speed_moved ? 1U : 0U;
                    CHECK((frame.reason != lpvg_reason_speed_moved || is_zero(frame)));
                }
            });
        }
        CHECK(frames > 0U);
        CHECK(moved == (part > Real(1) ? frames : 0U));
    }
}

TEST_CASE("the ends of the scheduling range belong to it", "[unit][monitor][REQ-MON-7]") {
    Drive drive;
    drive.speed = GENERATE(lpvg_coeff.reals.speed_min, lpvg_coeff.reals.speed_max);
    drive.settle();
    std::size_t frames = 0;
    drive.run(longest(), [&](const lpvg_frame_t& frame) {
        ++frames;
        CHECK(frame.reason <= lpvg_reason_not_excited);
    });
    CHECK(frames > 0U);
}

TEST_CASE("a thousandth beyond the ends of the scheduling range is out of it", "[unit][monitor][REQ-MON-7]") {
    Drive drive;
    drive.speed = GENERATE(Real(0.999) * lpvg_coeff.reals.speed_min, Real(1.001) * lpvg_coeff.reals.speed_max);
    drive.settle();
    std::size_t frames = 0;
    drive.run(2U * longest(), [&](const lpvg_frame_t& frame) {
        ++frames;
        CHECK(frame.reason > lpvg_reason_not_excited);
    });
    CHECK(frames > 0U);
}

TEST_CASE("a speed exactly on the tolerance counts", "[unit][monitor][REQ-MON-7]") {
    // 6 and 10 m/s in turn: mean 8 and a quarter of it are exact in binary.
    lpvg_coeff_t coeff = frames_only([](lpvg_coeff_t& c) { c.reals.speed_tolerance = Real(0.25); });
    REQUIRE((coeff.reals.speed_min <= Real(6) && coeff.reals.speed_max >= Real(10)));
    const Real shift = GENERATE(Real(0), Real(1), Real(-1));  // of one extreme, by an eighth: then it is beyond
    const uint32_t place = 2U * GENERATE(range(0U, 4U));      // of that extreme among eight samples
    Drive drive(coeff);
    std::size_t counted = 0, moved = 0;
    for (uint32_t k = 0; k < words().settle_samples + 3U * longest(); ++k) {
        drive.speed = Real(8) + (k % 2U == 0U ? Real(2) : Real(-2));
        drive.speed += (k + place) % 8U == (shift > Real(0) ? 0U : 1U) ? shift / Real(8) : Real(0);
        drive.run(1U, [&](const lpvg_frame_t& frame) {
            if (k > words().settle_samples + 2U * longest()) {
                counted += frame.reason <= lpvg_reason_not_excited ? 1U : 0U;
                moved += frame.reason == lpvg_reason_speed_moved ? 1U : 0U;
            }
        });
    }
    CHECK((shift < Real(0) || shift > Real(0) ? moved : counted) > 0U);
    CHECK((shift < Real(0) || shift > Real(0) ? counted : moved) == 0U);
}

TEST_CASE("one sample beyond the speed tolerance spoils every frame that holds it, wherever it stands", "[unit][monitor][REQ-MON-7]") {
    const uint32_t later = GENERATE(range(0U, uint32_t{LPVG_NBLOCK} + 1U));
    const double side = GENERATE(1.6, -1.6);
    Drive drive;
    drive.settle();
    drive.run(longest() + LPVG_NLATENCY + later);
    drive.speed = cruise() * static_cast<Real>(1.0 + side * static_cast<double>(lpvg_coeff.reals.speed_tolerance));
    REQUIRE((drive.speed > lpvg_coeff.reals.speed_min && drive.speed < lpvg_coeff.reals.speed_max));
    drive.run(1U);
    const int64_t moved = drive.now();
    // Between that sample and those before it, so that neither extreme is the newest.
    drive.speed = cruise() * static_cast<Real>(1.0 + 0.05 * side * static_cast<double>(lpvg_coeff.reals.speed_tolerance));
    std::size_t holding = 0, wrong = 0;
    drive.run(2U * longest(), [&](const lpvg_frame_t& frame) {
        const int64_t first = frame.t_end_us - period_us() * (words().frame_length[frame.bin] - 1);
        const bool holds = first <= moved && moved <= frame.t_end_us;
        holding += holds ? 1U : 0U;
        wrong += (frame.reason == lpvg_reason_speed_moved) != holds ? 1U : 0U;
    });
    CHECK(holding >= LPVG_NBINS);
    CHECK(wrong == 0U);
}

TEST_CASE("a sample that cannot be is a fault until the next good one, and restarts everything", "[unit][monitor][REQ-MON-8]") {
    const lpvg_coeff_reals_t& r = lpvg_coeff.reals;
    const Real nan = std::numeric_limits<Real>::quiet_NaN(), inf = std::numeric_limits<Real>::infinity();
    std::vector<std::function<void(lpvg_sample_t&)>> spoil;
    for (const Real value : {nan, inf, -inf, std::nextafter(r.speed_valid[1], inf), std::nextafter(r.speed_valid[0], -inf)}) {
        spoil.push_back([value](lpvg_sample_t& s) { s.speed = value; });
    }
    for (std::size_t i = 0; i < LPVG_NU; ++i) {
        for (const Real value : {nan, inf, -inf, std::nextafter(r.input_valid[i][1], inf), std::nextafter(r.input_valid[i][0], -inf)}) {
            spoil.push_back([i, value](lpvg_sample_t& s) { s.u[i] = value; });
        }
    }
    for (std::size_t j = 0; j < LPVG_NY; ++j) {
        for (const Real value : {nan, inf, -inf, std::nextafter(r.output_valid[j][1], inf), std::nextafter(r.output_valid[j][0], -inf)}) {
            spoil.push_back([j, value](lpvg_sample_t& s) { s.y[j] = value; });
        }
    }
    Drive drive;
    drive.settle();
    uint32_t bad = 0;
    for (const auto& change : spoil) {
        lpvg_sample_t sample = drive.next();
        change(sample);
        CHECK(lpvg_monitor_push(&drive.monitor, &sample) == lpvg_status_bad_sample);
        CHECK(drive.monitor.bad_samples == ++bad);
        CHECK(drive.verdict() == lpvg_verdict_fault);
        CHECK(drive.step() == lpvg_status_ok);
        CHECK(drive.monitor.restarts == bad + 1U);
        CHECK(drive.verdict() != lpvg_verdict_fault);
    }
    // Nothing may be bridged: a frame that began before the last fault must not come.
    const int64_t restart = drive.now();
    drive.run(LPVG_NLATENCY);  // frames that had ended before may still be judged
    drive.run(longest(),
              [&](const lpvg_frame_t& frame) { CHECK(frame.t_end_us - period_us() * (words().frame_length[frame.bin] - 1) >= restart); });
}

TEST_CASE("the ends of the physical ranges are good", "[unit][monitor][REQ-MON-8]") {
    const std::size_t end = GENERATE(std::size_t{0}, std::size_t{1});
    Drive drive;
    lpvg_sample_t sample = drive.next();
    sample.speed = lpvg_coeff.reals.speed_valid[end];
    for (std::size_t i = 0; i < LPVG_NU; ++i) {
        sample.u[i] = lpvg_coeff.reals.input_valid[i][end];
    }
    for (std::size_t j = 0; j < LPVG_NY; ++j) {
        sample.y[j] = lpvg_coeff.reals.output_valid[j][end];
    }
    CHECK(lpvg_monitor_push(&drive.monitor, &sample) == lpvg_status_ok);
}

TEST_CASE("a first sample that is bad is a fault, not unknown", "[unit][monitor][REQ-MON-8]") {
    Drive drive;
    lpvg_sample_t sample = drive.next();
    sample.speed = std::numeric_limits<Real>::quiet_NaN();
    CHECK(lpvg_monitor_push(&drive.monitor, &sample) == lpvg_status_bad_sample);
    CHECK(drive.verdict() == lpvg_verdict_fault);
    CHECK(lpvg_monitor_push(&drive.monitor, &sample) == lpvg_status_out_of_order);
    CHECK(drive.verdict() == lpvg_verdict_fault);
    CHECK(drive.step() == lpvg_status_ok);
    CHECK(drive.verdict() == lpvg_verdict_unknown);
}

TEST_CASE("a sample that is not newer is counted and changes nothing else", "[unit][monitor][REQ-MON-9]") {
    Drive drive;
    drive.run(longest());
    for (const int64_t back : {int64_t{0}, int64_t{1}, period_us(), int64_t{1} << 40}) {
        lpvg_sample_t sample = drive.sample;
        sample.t_us -= back;
        sample.speed = std::numeric_limits<Real>::quiet_NaN();  // not even looked at
        lpvg_monitor_t expected;
        std::memcpy(&expected, &drive.monitor, sizeof expected);
        ++expected.out_of_order;
        CHECK(lpvg_monitor_push(&drive.monitor, &sample) == lpvg_status_out_of_order);
        CHECK(std::memcmp(&drive.monitor, &expected, sizeof expected) == 0);
    }
}

TEST_CASE("a step of half to one and a half periods goes on, anything else restarts", "[unit][monitor][REQ-MON-9]") {
    struct Step {
        int64_t us;
        uint32_t restarts;
    };
    const int64_t T = period_us();
    const Step step = GENERATE_COPY(Step{T / 2, 0U}, Step{T / 2 - 1, 1U}, Step{T * 3 / 2, 0U}, Step{T * 3 / 2 + 1, 1U}, Step{2 * T, 1U},
                                    Step{int64_t{1} << 33, 1U}, Step{int64_t{1} << 62, 1U});
    Drive drive;
    drive.run(longest() - 1U);
    REQUIRE(drive.monitor.restarts == 1U);
    drive.skip(step.us - T);
    CHECK(drive.step() == lpvg_status_ok);
    CHECK(drive.monitor.restarts == 1U + step.restarts);
    // The DC frame would have ended with this sample.
    CHECK((drive.monitor.bin[0].n == 0U) == (step.restarts == 0U));
}

TEST_CASE("behind a gap in mid-frame every frame is the one of a monitor that starts there", "[unit][monitor][REQ-MON-9]") {
    Drive drive;
    drive.gain = 0.8;
    // Whole blocks, so that both sum in the same order.
    drive.run(LPVG_NBLOCK * ((words().settle_samples + 2U * longest()) / LPVG_NBLOCK + 1U));
    for (const lpvg_bin_t& bin : drive.monitor.bin) {
        REQUIRE((bin.n > 0U || bin.has_before));
    }
    REQUIRE(drive.monitor.bin[0].n > 0U);
    drive.skip(10 * period_us());
    const int64_t restart = drive.now() + 11 * period_us();
    lpvg_monitor_t fresh;
    REQUIRE(lpvg_monitor_init(&fresh, &lpvg_coeff) == lpvg_status_ok);
    using Frames = std::map<std::pair<uint32_t, int64_t>, lpvg_frame_t>;
    Frames of_drive, of_fresh;
    const auto note = [&](const lpvg_monitor_t& monitor, Frames& frames) {
        const lpvg_frame_t& frame = monitor.frame;
        if (frame.sequence > 0U && frame.t_end_us >= restart) {
            frames[{frame.bin, frame.t_end_us}] = frame;
        }
    };
    for (uint32_t k = 0; k < words().settle_samples + 4U * longest(); ++k) {
        REQUIRE(drive.step() == lpvg_status_ok);
        REQUIRE(lpvg_monitor_push(&fresh, &drive.sample) == lpvg_status_ok);
        note(drive.monitor, of_drive);
        note(fresh, of_fresh);
    }
    std::size_t counted = 0, different = 0;
    for (const auto& [where, frame] : of_fresh) {
        const auto same = of_drive.find(where);
        REQUIRE(same != of_drive.end());
        counted += frame.reason == lpvg_reason_none ? 1U : 0U;
        different += same->second.reason != frame.reason || same->second.margin != frame.margin || same->second.speed != frame.speed ||
                             std::memcmp(same->second.E, frame.E, sizeof frame.E) != 0 ||
                             std::memcmp(same->second.Z, frame.Z, sizeof frame.Z) != 0
                         ? 1U
                         : 0U;
    }
    CHECK(counted > 10U);
    CHECK(different == 0U);
}

TEST_CASE("a frame counts that begins with the first settled sample, and none before", "[unit][monitor][REQ-MON-7]") {
    const uint32_t bin = LPVG_NBINS - 1U, half = words().frame_length[bin] / 2U;
    const uint32_t later = GENERATE(0U, 1U);
    Drive drive(sealed([&](lpvg_coeff_t& c) { c.words.settle_samples = half + later; }));
    std::size_t seen = 0;
    drive.run(4U * half + LPVG_NLATENCY, [&](const lpvg_frame_t& frame) {
        const int64_t first = frame.t_end_us / period_us() + 1 - words().frame_length[frame.bin];
        if (frame.bin == bin && first == static_cast<int64_t>(half)) {
            ++seen;
            CHECK((frame.reason == lpvg_reason_settling) == (later == 1U));
        }
    });
    CHECK(seen == 1U);
}

TEST_CASE("stale after five periods, fault when the clock runs backwards", "[unit][monitor][REQ-MON-10]") {
    const int64_t start = GENERATE(int64_t{0}, int64_t{-1000000000000}, (int64_t{1} << 32) - 1000000, int64_t{1} << 62);
    Drive drive(lpvg_coeff, start);
    drive.settle();
    const int64_t now = drive.now();
    CHECK(drive.verdict() == lpvg_verdict_valid);
    CHECK(lpvg_monitor_verdict(&drive.monitor, now + 5 * period_us()) == lpvg_verdict_valid);
    CHECK(lpvg_monitor_verdict(&drive.monitor, now + 5 * period_us() + 1) == lpvg_verdict_stale);
    CHECK(lpvg_monitor_verdict(&drive.monitor, std::numeric_limits<int64_t>::max()) == lpvg_verdict_stale);
    CHECK(lpvg_monitor_verdict(&drive.monitor, now - 1) == lpvg_verdict_fault);
    CHECK(lpvg_monitor_verdict(&drive.monitor, std::numeric_limits<int64_t>::min()) == lpvg_verdict_fault);
    CHECK(drive.step() == lpvg_status_ok);
    CHECK(drive.verdict() == lpvg_verdict_valid);
}

TEST_CASE("the count of settled samples saturates: years later frames still count", "[unit][monitor][REQ-MON-10]") {
    Drive drive;
    drive.settle();
    drive.monitor.settled = std::numeric_limits<uint32_t>::max() - 2U;  // as if pushed for years
    drive.run(longest(), [](const lpvg_frame_t& frame) { CHECK(frame.reason <= lpvg_reason_not_excited); });
    CHECK(drive.verdict() == lpvg_verdict_valid);
}

TEST_CASE("the whole range of the clock can be crossed in one step", "[unit][monitor][REQ-MON-10]") {
    Drive drive(lpvg_coeff, std::numeric_limits<int64_t>::min());
    drive.run(3U);
    CHECK(lpvg_monitor_verdict(&drive.monitor, std::numeric_limits<int64_t>::max()) == lpvg_verdict_stale);
    lpvg_sample_t sample = drive.sample;
    sample.t_us = std::numeric_limits<int64_t>::max();
    CHECK(lpvg_monitor_push(&drive.monitor, &sample) == lpvg_status_ok);
    CHECK(drive.monitor.restarts == 2U);
}

TEST_CASE("the margins of a drive do not depend on where its clock starts", "[unit][monitor][REQ-MON-10]") {
    std::vector<Real> margins[2];
    for (std::size_t i = 0; i < 2U; ++i) {
        Drive drive(lpvg_coeff, i == 0U ? 0 : (int64_t{1} << 32) - 3 * period_us() * longest());
        drive.gain = 0.9;
        drive.run(6U * longest(), [&](const lpvg_frame_t& frame) { margins[i].push_back(frame.margin); });
    }
    CHECK(margins[0] == margins[1]);
}

TEST_CASE("falsifying frames queue up in order; those beyond the queue are counted", "[unit][monitor][REQ-MON-11]") {
    Drive drive(only_bin(LPVG_NBINS - 1));
    drive.bin = LPVG_NBINS - 1;
    drive.gain = 0.3;
    std::vector<lpvg_frame_t> falsified;
    const auto note = [&](const lpvg_frame_t& frame) {
        if (frame.falsified) {
            falsified.push_back(frame);
        }
    };
    while (falsified.size() < LPVG_NRECORDS + 2U) {
        drive.run(1U, note);
    }
    CHECK(drive.monitor.records_lost == 2U);
    lpvg_frame_t record{};
    for (std::size_t i = 0; i < LPVG_NRECORDS; ++i) {
        REQUIRE(lpvg_monitor_take_record(&drive.monitor, &record));
        CHECK(record.sequence == falsified[i].sequence);
        CHECK(record.t_end_us == falsified[i].t_end_us);
        CHECK(record.bin == LPVG_NBINS - 1);
        CHECK(record.margin == falsified[i].margin);
        CHECK(record.statistic == falsified[i].statistic);
        CHECK(record.evidence == falsified[i].evidence);
        CHECK(record.falsified);
        CHECK(record.test == lpvg_test_frame);
        CHECK(record.E[LPVG_NY - 1][1] == falsified[i].E[LPVG_NY - 1][1]);
        CHECK(record.Z[LPVG_NY - 1][1] == falsified[i].Z[LPVG_NY - 1][1]);
        CHECK(record.speed == Approx(static_cast<double>(cruise())).epsilon(1e-5));
    }
    CHECK_FALSE(lpvg_monitor_take_record(&drive.monitor, &record));
    // A place that was read out is free again.
    while (falsified.size() < LPVG_NRECORDS + 3U) {
        drive.run(1U, note);
    }
    REQUIRE(lpvg_monitor_take_record(&drive.monitor, &record));
    CHECK(record.sequence == falsified.back().sequence);
    CHECK(drive.monitor.records_lost == 2U);
}

TEST_CASE("the statistic is the k-th largest of the last m margins of the bin", "[unit][monitor][REQ-MON-5]") {
    struct KofM {
        uint32_t k, m;
    };
    const KofM want = GENERATE(KofM{1, 1}, KofM{1, 3}, KofM{2, 3}, KofM{3, 3}, KofM{1, LPVG_NHISTORY - 1}, KofM{5, LPVG_NHISTORY},
                               KofM{LPVG_NHISTORY, LPVG_NHISTORY});
    Drive drive(sealed([&](lpvg_coeff_t& c) {
        c.words.confirm = want.k;
        c.words.of_last = want.m;
    }));
    std::array<std::vector<Real>, LPVG_NBINS> margins;
    std::size_t counted = 0, wrong = 0, falsified = 0, recorded = 0;
    for (uint32_t k = 0; k < 12U * longest(); ++k) {
        drive.gain = 1.0 + 0.5 * std::sin(0.37 * k);  // so that margins differ from frame to frame
        drive.run(1U, [&](const lpvg_frame_t& frame) {
            if (frame.reason > lpvg_reason_not_excited) {
                return;
            }
            ++counted;
            falsified += frame.falsified ? 1U : 0U;
            std::vector<Real>& of_bin = margins[frame.bin];
            of_bin.push_back(frame.margin);
            std::vector<Real> last(of_bin.end() - static_cast<std::ptrdiff_t>(std::min<std::size_t>(want.m, of_bin.size())), of_bin.end());
            std::sort(last.begin(), last.end(), std::greater<Real>());
            const Real statistic = last.size() < want.k ? Real(0) : last[want.k - 1U];
            const bool beyond = std::max(statistic, frame.pooled) > lpvg_coeff.reals.threshold;
            wrong += frame.statistic != statistic || frame.falsified != beyond ? 1U : 0U;
        });
        const lpvg_frame_t& newest = *lpvg_monitor_frame(&drive.monitor);
        lpvg_frame_t record{};
        while (lpvg_monitor_take_record(&drive.monitor, &record)) {
            if (record.test == newest.test && record.sequence == newest.sequence) {
                ++recorded;
                wrong += record.margin != newest.margin || record.statistic != newest.statistic ? 1U : 0U;
            }
        }
    }
    CHECK(counted > 50U);
    CHECK((recorded > 0U) == (falsified > 0U));
    CHECK(wrong == 0U);
}

TEST_CASE("an output that is stuck or turned over is falsified, within the physical ranges", "[unit][monitor][REQ-MON-5]") {
    const double gain = GENERATE(0.0, -1.0, 2.0);
    Drive drive;
    drive.settle();
    REQUIRE(drive.verdict() == lpvg_verdict_valid);
    drive.gain = gain;
    drive.run(4U * longest());
    CHECK(drive.verdict() == lpvg_verdict_invalid);
    CHECK(drive.monitor.bad_samples == 0U);
}

TEST_CASE("a change degrades for the hold time, unless a test falsifies", "[unit][monitor][REQ-MON-16]") {
    // DC's frame is what the hold time goes by: the next one is shorter here.
    Drive drive(sealed([](lpvg_coeff_t& c) { c.words.frame_length[1] = c.words.frame_length[0] - 2U; }));
    drive.settle();
    REQUIRE(drive.verdict() == lpvg_verdict_valid);
    lpvg_monitor_t& m = drive.monitor;
    const int64_t hold = static_cast<int64_t>(longest()) * words().sample_period_us;
    m.has_changed = true;
    m.t_changed_us = m.t_us - hold;
    CHECK(drive.verdict() == lpvg_verdict_degraded);
    --m.t_changed_us;
    CHECK(drive.verdict() == lpvg_verdict_valid);
    m.t_changed_us = m.t_us;
    REQUIRE(drive.step() == lpvg_status_ok);
    CHECK(drive.verdict() == lpvg_verdict_degraded);
    m.has_falsified = true;
    m.t_falsified_us = m.t_us;
    CHECK(drive.verdict() == lpvg_verdict_invalid);
}

TEST_CASE("evidence counts up to the hold time, to the microsecond", "[unit][monitor][REQ-MON-6]") {
    Drive drive;
    drive.settle();
    REQUIRE(drive.verdict() == lpvg_verdict_valid);
    lpvg_monitor_t& m = drive.monitor;
    m.t_evidence_us = m.t_us - static_cast<int64_t>(longest()) * words().sample_period_us;
    CHECK(drive.verdict() == lpvg_verdict_valid);
    --m.t_evidence_us;
    CHECK(drive.verdict() == lpvg_verdict_not_judged);
}

TEST_CASE("a record is taken once, into memory that is there", "[unit][monitor][REQ-MON-11][REQ-MON-13]") {
    Drive drive(only_bin(LPVG_NBINS - 1));
    drive.bin = LPVG_NBINS - 1;
    drive.gain = 0.3;
    while (drive.monitor.n_records == 0U) {
        drive.run(1U);
    }
    const uint32_t sequence = drive.monitor.record[0].sequence;
    CHECK_FALSE(lpvg_monitor_take_record(&drive.monitor, nullptr));
    lpvg_frame_t record{};
    REQUIRE(lpvg_monitor_take_record(&drive.monitor, &record));
    CHECK(record.sequence == sequence);
    CHECK_FALSE(lpvg_monitor_take_record(&drive.monitor, &record));
}

TEST_CASE("state that cannot be is as a refused sample, and everything starts anew", "[unit][monitor][REQ-MON-15]") {
    using Damage = std::function<void(lpvg_monitor_t&)>;
    const auto damage = GENERATE(values<Damage>({
        [](lpvg_monitor_t& m) { m.newest = LPVG_NBLOCK; },
        [](lpvg_monitor_t& m) { m.n_block = LPVG_NBLOCK + 1U; },
        [](lpvg_monitor_t& m) { m.queue_first = LPVG_NBINS; },
        [](lpvg_monitor_t& m) { m.n_queue = LPVG_NBINS + 1U; },
        [](lpvg_monitor_t& m) { m.queue[LPVG_NBINS - 1] = LPVG_NBINS; },
        [](lpvg_monitor_t& m) { m.parts = LPVG_NPARTS; },
        [](lpvg_monitor_t& m) { m.n_records = LPVG_NRECORDS + 1U; },
        [](lpvg_monitor_t& m) { m.energy.next_direction = LPVG_NDIRECTIONS; },
        [](lpvg_monitor_t& m) { m.energy.strongest = LPVG_NBANDS; },
        [](lpvg_monitor_t& m) { m.model.entry[0] *= Real(2); },
        [](lpvg_monitor_t& m) { m.model.entry[LPVG_NENTRIES - 1] += Real(1); },
        [](lpvg_monitor_t& m) { m.energy.F[0][0] += Real(1); },
        [](lpvg_monitor_t& m) { m.energy.W[LPVG_NWEIGHT - 1][1][LPVG_NY - 1] += Real(1); },
        [](lpvg_monitor_t& m) { m.energy.band[0].right[0] = Real(1e30); },
        [](lpvg_monitor_t& m) { m.energy.band[LPVG_NBANDS - 1].right[LPVG_NGRAM - 1] += Real(1); },
        [](lpvg_monitor_t& m) { m.energy.fading += Real(1); },
        [](lpvg_monitor_t& m) {
            m.bin[1].n = words().frame_length[1] / 2U;  // the least that cannot be, seen before the bin takes up more
            m.turn = 0U;
        },
        [](lpvg_monitor_t& m) { m.bin[1].next_history = LPVG_NHISTORY; },
        [](lpvg_monitor_t& m) { m.t_evidence_us = m.t_us + 1; },
        [](lpvg_monitor_t& m) {
            m.has_falsified = true;
            m.t_falsified_us = m.t_us + 1;
        },
        [](lpvg_monitor_t& m) {
            m.has_changed = true;
            m.t_changed_us = m.t_us + 1;
        },
    }));
    Drive drive;
    drive.settle();
    REQUIRE(drive.verdict() == lpvg_verdict_valid);
    drive.monitor.repairs = UINT32_MAX - 1U;
    damage(drive.monitor);
    uint32_t pushes = 1U;
    lpvg_status_t status = drive.step();
    for (; status == lpvg_status_ok && pushes < 2U * LPVG_NBINS; ++pushes) {
        status = drive.step();
    }
    CHECK(pushes <= LPVG_NBINS);  // a bin, or a place of the queue, comes in turn
    CHECK(status == lpvg_status_bad_sample);
    CHECK(drive.verdict() == lpvg_verdict_fault);
    CHECK(drive.monitor.repairs == UINT32_MAX);
    CHECK(lpvg_monitor_push(&drive.monitor, &drive.sample) == lpvg_status_out_of_order);  // its time is the newest, as after any refusal
    drive.monitor.n_queue = LPVG_NBINS + 1U;
    CHECK(drive.step() == lpvg_status_bad_sample);
    CHECK(drive.monitor.repairs == UINT32_MAX);
    CHECK(drive.step() == lpvg_status_ok);
    CHECK(drive.verdict() == lpvg_verdict_unknown);
    drive.settle();
    CHECK(drive.verdict() == lpvg_verdict_valid);
}

TEST_CASE("damage between two turns of the check indexes nothing outside", "[unit][monitor][REQ-MON-15]") {
    const int which = GENERATE(0, 1, 2);
    Drive drive;
    drive.settle();
    std::size_t wrong = 0;
    for (uint32_t k = 0; k < 2U * longest(); ++k) {
        lpvg_monitor_t& m = drive.monitor;
        for (std::size_t b = 0; b < LPVG_NBINS; ++b) {
            const bool checked = b == (m.turn + 1U) % LPVG_NBINS;  // by this step: it must be good
            m.bin[b].next_history = which == 0 && !checked ? LPVG_NHISTORY : m.bin[b].next_history % LPVG_NHISTORY;
            m.queue[b] = which == 1 && !checked ? LPVG_NBINS : m.queue[b] % LPVG_NBINS;
        }
        m.n_queue = which == 2 ? LPVG_NBINS : m.n_queue;
        const bool damaged = m.n_queue > 0U && m.queue[m.queue_first] == LPVG_NBINS;  // what cannot be reads as DC
        const uint32_t sequence = m.frame.sequence;
        wrong += drive.step() == lpvg_status_ok && m.frame.bin < LPVG_NBINS && m.n_queue <= LPVG_NBINS ? 0U : 1U;
        wrong += damaged && m.frame.sequence != sequence && m.frame.bin != 0U ? 1U : 0U;
    }
    CHECK(wrong == 0U);
    CHECK(drive.monitor.repairs == 0U);
}

TEST_CASE("a damaged number of margins is the largest that there can be: the ring is not left", "[unit][monitor][REQ-MON-15]") {
    lpvg_coeff_t damaged = frames_only([](lpvg_coeff_t& c) { c.words.confirm = 1U; });
    Drive drive(damaged);
    drive.gain = 0.9;
    drive.settle();
    damaged.words.of_last = UINT32_MAX;
    drive.monitor.coeff = &damaged;
    std::array<uint32_t, LPVG_NBINS> counted{};
    drive.run(6U * longest(), [&](const lpvg_frame_t& frame) { ++counted[frame.bin]; });
    CHECK(counted[0] > LPVG_NHISTORY);
    CHECK(drive.monitor.repairs == 0U);
    for (const lpvg_bin_t& bin : drive.monitor.bin) {
        CHECK(std::all_of(std::begin(bin.history), std::end(bin.history), [](Real margin) { return margin > Real(0); }));
    }
}

TEST_CASE("a statistic of exactly the threshold does not falsify", "[unit][monitor][REQ-MON-5]") {
    Real largest = Real(0);
    const auto falsified = [&](Real threshold) {
        Drive drive(frames_only([&](lpvg_coeff_t& c) {
            c.words.confirm = c.words.of_last = 1U;
            c.reals.threshold = threshold;
        }));
        drive.gain = 1.5;
        std::size_t count = 0;
        drive.run(6U * longest(), [&](const lpvg_frame_t& frame) {
            largest = std::max(largest, frame.statistic);
            count += frame.falsified ? 1U : 0U;
        });
        return count;
    };
    (void)falsified(Real(1000));
    const Real seen = largest;
    REQUIRE(seen > Real(1));
    CHECK(falsified(seen) == 0U);
    CHECK(falsified(std::nextafter(seen, Real(0))) > 0U);
}

TEST_CASE("evidence of exactly the threshold is none", "[unit][monitor][REQ-MON-6]") {
    Real largest = Real(0);
    const auto excited = [&](Real threshold) {
        Drive drive(frames_only([&](lpvg_coeff_t& c) { c.reals.threshold = threshold; }));
        std::size_t count = 0;
        drive.run(6U * longest(), [&](const lpvg_frame_t& frame) {
            largest = std::max(largest, frame.evidence);
            count += frame.reason == lpvg_reason_none ? 1U : 0U;
        });
        return count;
    };
    (void)excited(Real(1000));
    const Real seen = largest;
    REQUIRE(seen > Real(1));
    CHECK(excited(seen) == 0U);
    CHECK(excited(std::nextafter(seen, Real(0))) > 0U);
}

TEST_CASE("a record is the frame as it was judged, its reason too", "[unit][monitor][REQ-MON-11]") {
    // A disturbance without any excitation: it falsifies, though a dead vehicle would have passed.
    Drive drive(frames_only([](lpvg_coeff_t& c) {
        c.words.confirm = c.words.of_last = 1U;
        c.reals.threshold = Real(1);
        for (std::size_t b = 0; b < LPVG_NBINS; ++b) {
            std::fill(std::begin(c.reals.B_w[b]), std::end(c.reals.B_w[b]), Real(0.01) * c.reals.output_valid[0][1]);
        }
    }));
    drive.amplitude = 0.0;
    std::size_t compared = 0;
    for (uint32_t k = 0; k < words().settle_samples + 4U * longest(); ++k) {
        lpvg_sample_t sample = drive.next();
        for (std::size_t j = 0; j < LPVG_NY; ++j) {
            sample.y[j] += Real(0.1) * lpvg_coeff.reals.output_valid[j][1];
        }
        REQUIRE(lpvg_monitor_push(&drive.monitor, &sample) == lpvg_status_ok);
        lpvg_frame_t record{};
        if (lpvg_monitor_take_record(&drive.monitor, &record)) {
            const lpvg_frame_t& frame = *lpvg_monitor_frame(&drive.monitor);
            ++compared;
            CHECK(record.sequence == frame.sequence);
            CHECK(record.reason == frame.reason);
            CHECK(record.reason == lpvg_reason_not_excited);
        }
    }
    CHECK(compared > 0U);
}

TEST_CASE("taking a record moves up those that wait, and nothing else", "[unit][monitor][REQ-MON-11]") {
    Drive drive(only_bin(LPVG_NBINS - 1));
    drive.bin = LPVG_NBINS - 1;
    drive.gain = 0.3;
    while (drive.monitor.n_records < LPVG_NRECORDS) {
        drive.run(1U);
    }
    lpvg_monitor_t& m = drive.monitor;
    lpvg_frame_t before[LPVG_NRECORDS], record{};
    std::memcpy(before, m.record, sizeof before);
    REQUIRE(lpvg_monitor_take_record(&m, &record));
    CHECK(m.n_records == LPVG_NRECORDS - 1U);
    CHECK(std::memcmp(&record, &before[0], sizeof record) == 0);
    CHECK(std::memcmp(&m.record[0], &before[1], (LPVG_NRECORDS - 1U) * sizeof record) == 0);
    CHECK(std::memcmp(&m.record[LPVG_NRECORDS - 1U], &before[LPVG_NRECORDS - 1U], sizeof record) == 0);
}

namespace {

// What one push did, told by marks that it writes over.
struct Pushed {
    uint32_t closed;  // frames and first halves
    bool judged, energy, change, taken;
};

Pushed push_marked(Drive& drive) {
    lpvg_monitor_t& m = drive.monitor;
    uint32_t n[LPVG_NBINS];
    for (std::size_t b = 0; b < LPVG_NBINS; ++b) {
        n[b] = m.bin[b].n;
    }
    const uint32_t sequence = m.frame.sequence, parts = m.parts, pending = m.change.pending;
    const Real mark = Real(-1);
    m.energy.ratio = m.change.ratio = mark;
    REQUIRE(drive.step() == lpvg_status_ok);
    Pushed did{0U, m.frame.sequence != sequence || m.parts != parts, m.energy.ratio > mark, m.change.ratio > mark,
               m.change.pending > pending};
    for (std::size_t b = 0; b < LPVG_NBINS; ++b) {
        did.closed += m.bin[b].n < n[b] ? 1U : 0U;
    }
    return did;
}

}  // namespace

TEST_CASE("pushes share the work: several frames close, or a part of one is judged, or the energy test; the change test comes last",
          "[unit][monitor][REQ-MON-12][REQ-MON-14][REQ-MON-16]") {
    const bool together = GENERATE(false, true);  // all frames of one length, so that all close within a block
    Drive drive(frames_only([&](lpvg_coeff_t& c) {
        if (together) {
            std::fill(std::begin(c.words.frame_length), std::end(c.words.frame_length), c.words.frame_length[0]);
        }
    }));
    drive.run(1U);  // starts everything
    std::array<uint32_t, LPVG_NBINS> closed_frames{}, judged_frames{};
    uint32_t parts = 0, several = 0, changes = 0;
    std::size_t wrong = 0;
    for (uint32_t k = 0; k < words().settle_samples + 6U * longest(); ++k) {
        const lpvg_monitor_t& m = drive.monitor;
        const uint32_t before = m.frame.sequence, waiting = m.n_queue, pending = m.change.pending;
        std::array<bool, LPVG_NBINS> had{};
        std::transform(std::begin(m.bin), std::end(m.bin), had.begin(), [](const lpvg_bin_t& bin) { return bin.has_before; });
        std::array<int64_t, LPVG_NBINS> ends{};
        std::transform(std::begin(m.bin), std::end(m.bin), ends.begin(), [](const lpvg_bin_t& bin) { return bin.frame_end_us; });
        const Pushed did = push_marked(drive);
        uint32_t queued = 0;
        for (std::size_t b = 0; b < LPVG_NBINS; ++b) {
            queued += m.bin[b].frame_end_us != ends[b] ? 1U : 0U;
            closed_frames[b] += m.bin[b].frame_end_us != ends[b] ? 1U : 0U;
        }
        judged_frames[m.frame.bin] += m.frame.sequence != before ? 1U : 0U;
        parts += did.judged ? 1U : 0U;
        several += did.closed > 1U ? 1U : 0U;
        changes += did.change ? 1U : 0U;
        wrong += did.judged != (waiting + queued > 0U && did.closed < 2U) ? 1U : 0U;
        wrong += did.energy == did.judged ? 1U : 0U;
        const bool last = m.newest == LPVG_NBLOCK - 1U;
        wrong += !last && did.change != (pending > 0U && !did.judged && did.closed == 0U) ? 1U : 0U;
        wrong += did.taken && !last ? 1U : 0U;
    }
    CHECK(wrong == 0U);
    CHECK((!together || several >= 6U));
    CHECK(changes > 0U);
    const uint32_t judged = drive.monitor.frame.sequence;
    CHECK(parts == judged * LPVG_NPARTS + drive.monitor.parts);
    for (std::size_t b = 0; b < LPVG_NBINS; ++b) {
        CHECK(closed_frames[b] - judged_frames[b] <= 1U);  // none is lost
        CHECK(judged_frames[b] > 4U);
    }
}

TEST_CASE("the sum over the energy test is of its filters and right sums as the newest sample left them", "[unit][monitor][REQ-MON-15]") {
    Drive drive;
    for (uint32_t k = 0; k < 3U * longest(); ++k) {
        REQUIRE(drive.step() == lpvg_status_ok);
        const lpvg_energy_t& energy = drive.monitor.energy;
        uint32_t sum = lpvguard::sum_of_words(energy.F) + lpvguard::sum_of_words(energy.W) + lpvguard::sum_of_words(energy.fading);
        for (const lpvg_energy_band_t& band : energy.band) {
            sum += lpvguard::sum_of_words(band.right);
        }
        REQUIRE(drive.monitor.energy_sum == sum);
    }
}

TEST_CASE("samples in range are counted from the first, up to what a word holds", "[unit][monitor][REQ-MON-7][REQ-MON-10]") {
    Drive drive;
    for (uint32_t k = 1; k <= 10U; ++k) {
        REQUIRE(drive.step() == lpvg_status_ok);
        CHECK(drive.monitor.settled == k);
    }
    drive.speed = lpvg_coeff.reals.speed_max * Real(1.01);
    for (int k = 0; k < 2; ++k) {
        REQUIRE(drive.step() == lpvg_status_ok);
        CHECK(drive.monitor.settled == 0U);
    }
    drive.speed = cruise();
    REQUIRE(drive.step() == lpvg_status_ok);
    CHECK(drive.monitor.settled == 1U);
    drive.monitor.settled = std::numeric_limits<uint32_t>::max() - 1U;
    for (int k = 0; k < 3; ++k) {
        REQUIRE(drive.step() == lpvg_status_ok);
        CHECK(drive.monitor.settled == std::numeric_limits<uint32_t>::max());
    }
}

TEST_CASE("out of range the energy test rests, after a single sample in range too", "[unit][monitor][REQ-MON-14]") {
    const uint32_t in_range = GENERATE(1U, 2U, 300U);
    lpvg_energy_t rest{};
    lpvg_energy_start(&rest);
    const auto rests = [&](const lpvg_energy_t& energy) {
        return std::memcmp(energy.F, rest.F, sizeof rest.F) == 0 && std::memcmp(energy.W, rest.W, sizeof rest.W) == 0 &&
               std::memcmp(energy.band, rest.band, sizeof rest.band) == 0 && energy.fading == Real(1);
    };
    Drive drive;
    drive.run(in_range);
    CHECK_FALSE(rests(drive.monitor.energy));
    drive.speed = lpvg_coeff.reals.speed_max * Real(1.01);
    for (int k = 0; k < 5; ++k) {
        drive.run(1U);
        CHECK(rests(drive.monitor.energy));
    }
}

TEST_CASE("a refused sample has its time: it is not taken again", "[unit][monitor][REQ-MON-8][REQ-MON-9]") {
    Drive drive;
    drive.run(5U);
    lpvg_sample_t sample = drive.next();
    sample.speed = std::numeric_limits<Real>::quiet_NaN();
    REQUIRE(lpvg_monitor_push(&drive.monitor, &sample) == lpvg_status_bad_sample);
    sample.speed = cruise();
    CHECK(lpvg_monitor_push(&drive.monitor, &sample) == lpvg_status_out_of_order);
    CHECK(drive.monitor.out_of_order == 1U);
    CHECK(drive.step() == lpvg_status_ok);
}

TEST_CASE("a step of half the clock's range and a period is no period", "[unit][monitor][REQ-MON-9][REQ-MON-10]") {
    Drive drive(lpvg_coeff, std::numeric_limits<int64_t>::min());
    drive.run(3U);
    lpvg_sample_t sample = drive.sample;
    sample.t_us = drive.now() + std::numeric_limits<int64_t>::max() + 1 + period_us();  // twice that step is two periods, modulo 2^64
    REQUIRE(lpvg_monitor_push(&drive.monitor, &sample) == lpvg_status_ok);
    CHECK(drive.monitor.restarts == 2U);
}

TEST_CASE("the newest falsification counts, whichever test it is of and whenever it is judged", "[unit][monitor][REQ-MON-5][REQ-MON-14]") {
    const int64_t start = GENERATE(int64_t{0}, int64_t{-1000000000000});
    Drive drive(sealed([](lpvg_coeff_t& c) {
                    c.words.confirm = c.words.of_last = 1U;
                    c.reals.threshold = c.reals.energy_threshold = c.reals.energy_certificate = Real(1);
                    c.reals.change_threshold = Real(1e9);
                }),
                start);
    drive.gain = -1.0;
    int64_t newest = std::numeric_limits<int64_t>::min();
    std::size_t behind = 0;
    for (uint32_t k = 0; k < words().energy_settle + 4U * longest(); ++k) {
        lpvg_monitor_t& m = drive.monitor;
        const uint32_t sequence = m.frame.sequence;
        m.energy.ratio = Real(0);
        REQUIRE(drive.step() == lpvg_status_ok);
        const bool frame = m.frame.sequence != sequence && m.frame.refuted;
        behind += frame && m.frame.t_end_us < newest ? 1U : 0U;
        newest = std::max({newest, frame ? m.frame.t_end_us : newest, m.energy.ratio > Real(1) ? drive.now() : newest});
        REQUIRE(m.has_falsified == (newest > std::numeric_limits<int64_t>::min()));
        REQUIRE((!m.has_falsified || m.t_falsified_us == newest));
        REQUIRE((drive.verdict() == lpvg_verdict_invalid) ==
                (m.has_falsified && drive.now() - newest <= static_cast<int64_t>(longest()) * period_us()));
    }
    CHECK(behind > 0U);
    CHECK(drive.monitor.repairs == 0U);
}

namespace {

// Only one part of one output's estimate is heard, above 1; sizes of gain and delay differ.
lpvg_coeff_t change_only(std::size_t output, std::size_t part, Real scale, uint32_t rearm) {
    return sealed([=](lpvg_coeff_t& c) {
        c.reals.threshold = c.reals.energy_threshold = Real(1e9);
        c.reals.change_threshold = Real(1);
        c.reals.change_forget = Real(0.05);
        c.words.change_rearm = rearm;
        for (std::size_t j = 0; j < LPVG_NY; ++j) {
            const Real prior[6] = {Real(1e-6), Real(0), Real(0), Real(1e-6), Real(0), Real(1e-6)};
            std::memcpy(c.reals.change_prior[j], prior, sizeof prior);
            c.reals.change_unit[j][0] = Real(1 + j) / lpvg_coeff.reals.output_valid[j][1];
            c.reals.change_unit[j][1] = Real(5 + j) / lpvg_coeff.reals.output_valid[j][1];
            std::fill(std::begin(c.reals.change_scale[j]), std::end(c.reals.change_scale[j]), Real(1e-9) * Real(1 + j));
        }
        c.reals.change_scale[output][part] = scale;
    });
}

// Until the change test has judged so many times.
void judge_change(Drive& drive, uint32_t times) {
    for (uint32_t k = 0; times > 0U; ++k) {
        REQUIRE(k < 100U * LPVG_NBLOCK + 10U * longest());
        times -= push_marked(drive).change ? 1U : 0U;
    }
}

}  // namespace

TEST_CASE("an alarm of the change test names output and part, and holds estimate, time and what a lost output would read",
          "[unit][monitor][REQ-MON-16]") {
    const std::size_t output = GENERATE(range(std::size_t{0}, std::size_t{LPVG_NY})), part = GENERATE(range(0U, 3U));
    const lpvg_coeff_t coeff = change_only(output, part, Real(1e9), 5U);
    lpvg_coeff_t still = coeff;
    still.reals.change_threshold = Real(1e30);
    Drive drive(coeff);
    drive.gain = 0.7;
    drive.monitor.coeff = &still;
    drive.settle();  // frames have been judged by then
    drive.monitor.coeff = &coeff;
    for (uint32_t k = 0; drive.monitor.n_records == 0U; ++k) {
        REQUIRE(k < words().settle_samples + 4U * longest());
        REQUIRE(drive.step() == lpvg_status_ok);
    }
    const lpvg_change_t& said = drive.monitor.change;
    lpvg_frame_t alarm{};
    REQUIRE(lpvg_monitor_take_record(&drive.monitor, &alarm));
    CHECK(alarm.test == lpvg_test_change);
    CHECK(alarm.bin == 3U * output + part);
    CHECK(alarm.bin == said.strongest);
    CHECK(alarm.sequence == drive.monitor.frame.sequence);
    CHECK(alarm.sequence > 0U);
    CHECK(alarm.t_end_us == drive.now());
    CHECK(alarm.t_end_us > 0);
    CHECK(alarm.reason == lpvg_reason_none);
    CHECK(alarm.falsified);
    CHECK(alarm.speed == drive.speed);
    CHECK((alarm.margin == said.ratio && alarm.statistic == said.ratio));
    CHECK(alarm.evidence == coeff.reals.change_scale[output][0] / coeff.reals.change_unit[output][0]);
    CHECK((alarm.E[0][0] == said.estimate[0] && alarm.E[0][1] == said.estimate[1] && alarm.Z[0][0] == said.estimate[2]));
    CHECK((said.estimate[0] != said.estimate[1] && said.estimate[1] != said.estimate[2] && said.estimate[2] != Real(0)));
    CHECK(alarm.Z[0][1] == Real(0));
    for (std::size_t j = 1; j < LPVG_NY; ++j) {
        CHECK((alarm.E[j][0] == Real(0) && alarm.E[j][1] == Real(0) && alarm.Z[j][0] == Real(0) && alarm.Z[j][1] == Real(0)));
    }
    CHECK(drive.monitor.t_changed_us == drive.now());
}

TEST_CASE("a ratio of exactly the change test's threshold says nothing", "[unit][monitor][REQ-MON-16]") {
    Real largest = Real(0);
    const auto changed = [&](Real threshold) {
        lpvg_coeff_t coeff = change_only(LPVG_NY - 1, 0U, Real(10), 5U);
        coeff.reals.change_threshold = threshold;
        Drive drive(sealed([&](lpvg_coeff_t& c) { c.reals = coeff.reals; }));
        drive.gain = 0.7;
        drive.run(words().settle_samples + 2U * longest());
        for (uint32_t k = 0; k < 4U * longest(); ++k) {
            drive.run(1U);
            largest = std::max(largest, drive.monitor.change.ratio);
        }
        return drive.monitor.has_changed;
    };
    // From the beginning, as the monitor judges it.
    (void)changed(Real(1e9));
    Real highest = largest;
    {
        lpvg_coeff_t coeff = change_only(LPVG_NY - 1, 0U, Real(10), 5U);
        coeff.reals.change_threshold = Real(1e9);
        Drive drive(sealed([&](lpvg_coeff_t& c) { c.reals = coeff.reals; }));
        drive.gain = 0.7;
        for (uint32_t k = 0; k < words().settle_samples + 6U * longest(); ++k) {
            drive.run(1U);
            highest = std::max(highest, drive.monitor.change.ratio);
        }
    }
    REQUIRE(highest > Real(0));
    CHECK_FALSE(changed(highest));
    CHECK(changed(std::nextafter(highest, Real(0))));
}

TEST_CASE("the change test alarms anew after as many quiet judgements as are stated, and not before", "[unit][monitor][REQ-MON-16]") {
    const uint32_t rearm = GENERATE(6U, 7U), quiet = rearm - GENERATE(1U, 0U);
    const lpvg_coeff_t loud = change_only(0U, 0U, Real(1e9), rearm);
    lpvg_coeff_t still = loud;
    still.reals.change_threshold = Real(1e30);
    Drive drive(loud);
    drive.gain = 0.7;
    drive.run(words().settle_samples + 2U * longest());
    REQUIRE(drive.monitor.n_records == 1U);
    // The outputs that are not heard are quiet: those judgements count as well.
    while (drive.monitor.change_quiet != 0U) {
        judge_change(drive, 1U);
    }
    drive.monitor.n_records = 0U;
    drive.monitor.coeff = &still;
    judge_change(drive, quiet);
    CHECK(drive.monitor.change_quiet == quiet);
    const uint32_t of_output = drive.monitor.change.pending % LPVG_NY;  // 0: the first output is next
    if (of_output == 0U) {
        drive.monitor.coeff = &loud;
        judge_change(drive, 1U);
        CHECK(drive.monitor.n_records == (quiet == rearm ? 1U : 0U));
        CHECK(drive.monitor.change_quiet == 0U);
    }
}

TEST_CASE("the change test takes whole blocks of settled samples, and their mean, the oldest first", "[unit][monitor][REQ-MON-16]") {
    Drive drive(frames_only([](lpvg_coeff_t& c) { c.words.settle_samples = 0U; }));  // settled from the first sample
    drive.gain = 0.9;
    const lpvg_monitor_t& m = drive.monitor;
    std::size_t blocks = 0, wrong = 0;
    for (uint32_t k = 1; k <= 2U * longest(); ++k) {
        const Pushed did = push_marked(drive);
        if (!did.taken) {
            continue;
        }
        ++blocks;
        CHECK(k >= LPVG_NBLOCK);
        for (std::size_t i = 0; i < 2U * LPVG_NY; ++i) {
            Real sum = m.signal[0][i];
            for (std::size_t row = 1; row < LPVG_NBLOCK; ++row) {
                sum += m.signal[row][i];
            }
            wrong += m.change.mean[i] != sum * (Real(1) / Real(LPVG_NBLOCK)) ? 1U : 0U;
        }
    }
    CHECK(blocks > 10U);
    CHECK(wrong == 0U);
}

namespace {

// Scale of the error of output j in part `at` of the speed range.
Real error_scale(std::size_t at, std::size_t j) { return Real(1 + j) * Real(1 + at); }

// Bin 1 pools with the given parts and frames of a part; `share` is the scale of the error's share. Frames alone never object.
lpvg_coeff_t pooling(
    uint32_t parts, uint32_t frames, Real share = Real(1e6), const std::function<void(lpvg_coeff_t&)>& change = [](lpvg_coeff_t&) {}) {
    return frames_only([&](lpvg_coeff_t& c) {
        c.reals.threshold = Real(1e9);
        for (std::size_t at = 0; at < LPVG_NSPEEDS; ++at) {
            for (std::size_t j = 0; j < LPVG_NY; ++j) {
                c.reals.pool_scale[at][1][0][j] = error_scale(at, j);
                c.reals.pool_scale[at][1][1][j] = share;
            }
        }
        c.words.pool_parts[1] = parts;
        c.words.pool_frames[1] = frames;
        change(c);
    });
}

// What a pool of these frames reads, the newest last: its ratio, and that of a vehicle without response.
std::array<double, 2> reckoned(const std::vector<lpvg_frame_t>& frames, std::size_t held, std::size_t at, double share) {
    std::array<double, 2> found{};
    for (std::size_t j = 0; j < LPVG_NY; ++j) {
        std::complex<double> along = 0.0;
        double power = 0.0;
        for (std::size_t i = frames.size() - std::min(held, frames.size()); i < frames.size(); ++i) {
            const lpvg_frame_t& f = frames[i];
            if (f.reason > lpvg_reason_not_excited) {
                continue;
            }
            const std::complex<double> E(f.E[j][0], f.E[j][1]), Z(f.Z[j][0], f.Z[j][1]);
            along += std::conj(Z) * E;
            power += std::norm(Z);
        }
        const double size = std::sqrt(power), unit = static_cast<double>(error_scale(at, j));
        found[0] = std::max(found[0], power > 0.0 ? std::min(std::abs(along) / size * unit, std::abs(along) / power * share) : 0.0);
        found[1] = std::max(found[1], std::min(size * unit, share));
    }
    return found;
}

}  // namespace

TEST_CASE("a pool sums the counted frames of its parts, of which the newest grows, with the bounds of its speed",
          "[unit][monitor][REQ-MON-19]") {
    const uint32_t parts = GENERATE(1U, uint32_t{LPVG_NPOOL}), in_part = GENERATE(1U, 2U);
    const std::size_t at = GENERATE(0U, 1U, 2U);
    const Real share = GENERATE(Real(1e-3), Real(1e6));
    const auto& reals = lpvg_coeff.reals;
    const auto speed_at = [&](double position) {
        return reals.speed_min + static_cast<Real>(position) * (reals.speed_max - reals.speed_min);
    };
    const Real speed = speed_at((static_cast<double>(at) + 0.5) / LPVG_NSPEEDS);
    Drive drive(pooling(parts, in_part, share));
    drive.bin = 1U;
    std::vector<lpvg_frame_t> frames;
    std::size_t uncounted = 0, beyond = 0;
    for (uint32_t k = 0; k < 24U; ++k) {
        drive.gain = 0.8 + 0.02 * (k % 5U);
        drive.speed = k == 12U ? speed_at(at == 0U ? 0.9 : 0.1) : speed;
        drive.run(words().frame_length[1] / 2U, [&](const lpvg_frame_t& f) {
            if (f.bin != 1U) {
                CHECK(f.pooled == Real(0));
                return;
            }
            frames.push_back(f);
            uncounted += f.reason > lpvg_reason_not_excited ? 1U : 0U;
            if (f.reason > lpvg_reason_not_excited) {
                CHECK(f.pooled == Real(0));
                return;
            }
            const std::size_t held = (parts - 1U) * in_part + (frames.size() - 1U) % in_part + 1U;
            const auto expected = reckoned(frames, held, at, static_cast<double>(share));
            CHECK(static_cast<double>(f.pooled) == Approx(expected[0]).epsilon(1e-4));
            CHECK(static_cast<double>(f.evidence) >= expected[1] * (1.0 - 1e-4));
            beyond += static_cast<double>(f.evidence) > expected[1] * (1.0 + 1e-4) ? 1U : 0U;
        });
    }
    CHECK(frames.size() > 2U * LPVG_NPOOL + 3U);
    CHECK(uncounted > 0U);
    CHECK(beyond < frames.size());
}

TEST_CASE("a pool alarms where no frame of it does, refutes nothing, and is recorded",
          "[unit][monitor][REQ-MON-19][REQ-MON-20][REQ-MON-11]") {
    Drive drive(pooling(LPVG_NPOOL, 1U));
    drive.bin = 1U;
    drive.gain = 0.8;
    drive.settle();
    Real single = Real(0), largest = Real(0);
    drive.run(2U * LPVG_NPOOL * words().frame_length[1], [&](const lpvg_frame_t& f) {
        single = single == Real(0) && f.bin == 1U && f.pooled > Real(0) ? f.pooled : single;
        largest = std::max(largest, f.pooled);
    });
    REQUIRE(largest > Real(1.25) * single);
    const Real between = Real(0.75) * largest;
    Drive judged(pooling(LPVG_NPOOL, 1U, Real(1e6), [=](lpvg_coeff_t& c) {
        c.reals.threshold = between;
        for (auto& row : c.reals.B_w) {
            std::fill(std::begin(row), std::end(row), Real(1e6));
        }
    }));
    judged.bin = 1U;
    judged.gain = 0.8;
    judged.settle();
    judged.run(2U * LPVG_NPOOL * words().frame_length[1]);
    CHECK(judged.verdict() == lpvg_verdict_degraded);
    lpvg_frame_t record{};
    REQUIRE(lpvg_monitor_take_record(&judged.monitor, &record));
    CHECK(record.falsified);
    CHECK_FALSE(record.refuted);
    CHECK(record.pooled > between);
    CHECK(record.statistic < between);
}

TEST_CASE("a gap empties the pools, and damaged sizes never lead outside them", "[unit][monitor][REQ-MON-19][REQ-MON-15]") {
    Drive drive(pooling(LPVG_NPOOL, 1U));
    drive.bin = 1U;
    drive.gain = 0.8;
    drive.settle();
    drive.run(4U * words().frame_length[1]);
    drive.skip(10 * period_us());
    REQUIRE(drive.step() == lpvg_status_ok);
    for (const lpvg_bin_t& bin : drive.monitor.bin) {
        std::size_t filled = 0;
        for (const lpvg_pool_t& part : bin.pool) {
            filled += part.power[0] > Real(0) ? 1U : 0U;
        }
        CHECK(filled <= 1U);  // a frame that waited for its judgement
    }
    const_cast<lpvg_coeff_t*>(drive.monitor.coeff)->words.pool_parts[1] = UINT32_MAX;
    for (uint32_t k = 0; k < 2U * LPVG_NPOOL * words().frame_length[1]; ++k) {
        REQUIRE(drive.step() == lpvg_status_ok);
        CHECK(drive.monitor.bin[1].part < LPVG_NPOOL);
    }
    drive.monitor.bin[1].part = LPVG_NPOOL;
    for (uint32_t k = 0; k < LPVG_NBINS; ++k) {
        (void)drive.step();
    }
    CHECK(drive.monitor.repairs == 1U);
}
