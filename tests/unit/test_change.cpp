// The change test: its estimate by itself, and as a part of the monitor. Compiled for every test vehicle.
#include "../catch.hpp"

#include <algorithm>
#include <cmath>
#include <cstdint>
#include <cstring>
#include <limits>
#include <vector>

#include "monitor/acceptance.hpp"
#include "monitor_drive.hpp"

namespace {

constexpr std::size_t n_block = LPVG_NBLOCK, parts = 3;

// One output's gain, delay [s] and bias, and how e follows.
struct Fault {
    double gain = 0.0, delay = 0.0, bias = 0.0;
};

// Nominal output of a rich drive, and its slope [1/s], at sample k.
double nominal(double k, std::size_t j) { return (1.0 + 0.5 * j) * (std::sin(0.031 * k + j) + 0.7 * std::sin(0.0072 * k) + 0.3); }
double slope(double k, std::size_t j) {
    return (1.0 + 0.5 * j) * (0.031 * std::cos(0.031 * k + j) + 0.7 * 0.0072 * std::cos(0.0072 * k)) * 1e6 /
           static_cast<double>(period_us());
}

// The test alone, fed with e and yhat of one block after the other.
struct Fed {
    lpvg_coeff_t coeff;
    lpvg_change_t change;
    uint32_t k = 0;
    explicit Fed(const lpvg_coeff_t& c) : coeff(c) { lpvg_change_start(&change); }

    // Every output takes the next block; the largest ratio.
    Real take(const Fault& fault) {
        offer(fault);
        return judged();
    }
    Real take(const Real* signal) {
        lpvg_change_take(&change, signal);
        return judged();
    }
    // The next block, which no output has judged yet.
    void offer(const Fault& fault) {
        Real signal[n_block][2U * LPVG_NY];
        for (auto& row : signal) {
            for (std::size_t j = 0; j < LPVG_NY; ++j) {
                const double yhat = nominal(k, j);
                row[j] = static_cast<Real>(fault.gain * yhat - fault.delay * slope(k, j) + fault.bias);
                row[LPVG_NY + j] = static_cast<Real>(yhat);
            }
            ++k;
        }
        lpvg_change_take(&change, signal[0]);
    }
    Real judged() {
        Real largest = Real(0);
        while (change.pending > 0U) {
            largest = std::max(largest, lpvg_change_judge(&change, &coeff));
        }
        return largest;
    }
    // So many blocks; the estimate is then the last output's.
    void run(uint32_t blocks, const Fault& fault) {
        for (uint32_t i = 0; i < blocks; ++i) {
            (void)take(fault);
        }
    }
};

// A prior so weak that it hardly pulls, and a memory of 400 blocks. Sizes of 1.
lpvg_coeff_t free_estimates(double prior = 1e-3) {
    return sealed([=](lpvg_coeff_t& c) {
        c.reals.change_forget = Real(1.0 / 400.0);
        c.reals.change_block_s = static_cast<Real>(1e-6 * static_cast<double>(n_block * period_us()));
        for (std::size_t j = 0; j < LPVG_NY; ++j) {
            const Real unit[6] = {Real(1), Real(0), Real(0), Real(1), Real(0), Real(1)};
            for (std::size_t i = 0; i < 6U; ++i) {
                c.reals.change_prior[j][i] = static_cast<Real>(prior) * unit[i];
            }
            c.reals.change_unit[j][0] = Real(1);
            c.reals.change_unit[j][1] = Real(20);
            std::fill(std::begin(c.reals.change_scale[j]), std::end(c.reals.change_scale[j]), Real(1));
        }
        c.reals.change_threshold = Real(1e9);
    });
}

// The monitor hears the change test alone. `size` of the largest gain, delay and bias that are normal.
lpvg_coeff_t heard(double size, uint32_t rearm = 20U) {
    return sealed([=](lpvg_coeff_t& c) {
        c.reals.threshold = c.reals.energy_threshold = Real(1e9);
        c.reals.change_threshold = Real(1);
        c.reals.change_forget = Real(0.05);
        c.words.change_rearm = rearm;
        for (std::size_t j = 0; j < LPVG_NY; ++j) {
            const Real prior[6] = {Real(1e-6), Real(0), Real(0), Real(1e-6), Real(0), Real(1e-6)};
            std::memcpy(c.reals.change_prior[j], prior, sizeof prior);
            c.reals.change_unit[j][0] = c.reals.change_unit[j][1] = Real(1) / lpvg_coeff.reals.output_valid[j][1];
            const double in_theta = size * static_cast<double>(lpvg_coeff.reals.output_valid[j][1]);
            c.reals.change_scale[j][0] = static_cast<Real>(1.0 / in_theta);
            c.reals.change_scale[j][1] = c.reals.change_scale[j][2] = static_cast<Real>(1e-9 / in_theta);
        }
    });
}

// Whether a block is taken within ten: some are lost.
bool begins(Drive& drive) {
    for (uint32_t k = 0; k < 10U * n_block && drive.monitor.change.begun == 0U; ++k) {
        drive.run(1U);
    }
    return drive.monitor.change.begun == 1U;
}

std::vector<lpvg_frame_t> records(Drive& drive, uint32_t samples) {
    std::vector<lpvg_frame_t> found;
    for (uint32_t k = 0; k < samples; ++k) {
        REQUIRE(drive.step() == lpvg_status_ok);
        lpvg_frame_t record;
        while (lpvg_monitor_take_record(&drive.monitor, &record)) {
            found.push_back(record);
        }
    }
    return found;
}

}  // namespace

TEST_CASE("gain, delay and bias are estimated", "[unit][change][REQ-MON-16]") {
    const Fault faults[] = {{-0.4, 0.0, 0.0}, {0.0, 0.003, 0.0}, {0.0, 0.0, -0.2}, {0.25, -0.002, 0.1}};
    for (const Fault& fault : faults) {
        CAPTURE(fault.gain, fault.delay, fault.bias);
        Fed fed(free_estimates());
        fed.run(3000U, fault);
        CHECK(static_cast<double>(fed.change.estimate[0]) == Approx(fault.gain).margin(2e-3));
        CHECK(static_cast<double>(fed.change.estimate[1]) == Approx(fault.delay).margin(2e-2 * 1e-6 * static_cast<double>(period_us())));
        CHECK(static_cast<double>(fed.change.estimate[2]) == Approx(fault.bias).margin(2e-3));
    }
}

TEST_CASE("the estimate forgets", "[unit][change][REQ-MON-16]") {
    Fed fed(free_estimates());
    fed.run(2000U, {0.5, 0.0, 0.0});
    fed.run(4000U, {0.0, 0.0, 0.0});
    CHECK(std::fabs(static_cast<double>(fed.change.estimate[0])) < 1e-3);
}

TEST_CASE("the prior keeps an estimate near 0 until driving outweighs it", "[unit][change][REQ-MON-16]") {
    Fed strong(free_estimates(1e6)), weak(free_estimates());
    strong.run(3000U, {0.5, 0.0, 0.0});
    weak.run(3000U, {0.5, 0.0, 0.0});
    CHECK(std::fabs(static_cast<double>(strong.change.estimate[0])) < 1e-2);
    CHECK(static_cast<double>(weak.change.estimate[0]) == Approx(0.5).margin(2e-3));
    // As much driving as prior: half the gain, where gain alone is asked for.
    const lpvg_coeff_t equal = sealed([](lpvg_coeff_t& c) {
        c = free_estimates();
        for (auto& A : c.reals.change_prior) {
            const Real prior[6] = {Real(400), Real(0), Real(0), Real(1e9), Real(0), Real(1e9)};
            std::memcpy(A, prior, sizeof prior);
        }
    });
    Fed half(equal);
    Real signal[n_block][2U * LPVG_NY];
    for (uint32_t i = 0; i < 8000U; ++i) {
        for (auto& row : signal) {
            for (std::size_t j = 0; j < LPVG_NY; ++j) {
                row[LPVG_NY + j] = i % 2U == 0U ? Real(1) : Real(-1);
                row[j] = Real(0.5) * row[LPVG_NY + j];
            }
        }
        (void)half.take(signal[0]);
    }
    CHECK(static_cast<double>(half.change.estimate[0]) == Approx(0.25).epsilon(1e-2));
}

TEST_CASE("the first block is only remembered", "[unit][change][REQ-MON-16]") {
    Fed fed(free_estimates());
    CHECK(fed.take({1.0, 0.0, 1.0}) == Real(0));
    CHECK(fed.change.begun == 1U);
    CHECK(fed.take({1.0, 0.0, 1.0}) > Real(0));
}

TEST_CASE("a block that nobody judged is lost, and the next is only remembered", "[unit][change][REQ-MON-16]") {
    Fed fed(free_estimates()), lost(free_estimates());
    fed.run(2000U, {0.5, 0.001, 0.0});
    lost.run(1000U, {0.5, 0.001, 0.0});
    const Real odd[n_block][2U * LPVG_NY] = {{Real(9)}, {Real(9)}, {Real(9)}, {Real(9)}};
    lpvg_change_take(&lost.change, odd[0]);
    CHECK(lost.change.begun == 1U);
    lost.run(1000U, {0.5, 0.001, 0.0});
    CHECK(static_cast<double>(lost.change.estimate[0]) == Approx(static_cast<double>(fed.change.estimate[0])).margin(1e-3));
    CHECK(static_cast<double>(lost.change.estimate[1]) == Approx(static_cast<double>(fed.change.estimate[1])).margin(1e-5));
}

TEST_CASE("the ratio is the largest part over its size, of one output after the other", "[unit][change][REQ-MON-16]") {
    for (std::size_t part = 0; part < parts; ++part) {
        const lpvg_coeff_t coeff = sealed([&](lpvg_coeff_t& c) {
            c = free_estimates();
            for (auto& scale : c.reals.change_scale) {
                scale[part] = Real(1000);
            }
        });
        Fed fed(coeff);
        fed.run(3000U, {0.3, 0.004, 0.2});
        const Real last[n_block][2U * LPVG_NY] = {};
        lpvg_change_take(&fed.change, last[0]);
        for (uint32_t j = 0; j < LPVG_NY; ++j) {
            CHECK(fed.change.pending == LPVG_NY - j);
            const Real ratio = lpvg_change_judge(&fed.change, &fed.coeff);
            CHECK(fed.change.strongest == j * parts + part);
            const double theta[parts] = {
                static_cast<double>(fed.change.estimate[0]),
                static_cast<double>(fed.change.estimate[1]) / 20.0 / static_cast<double>(coeff.reals.change_block_s),
                static_cast<double>(fed.change.estimate[2])};
            CHECK(static_cast<double>(ratio) == Approx(1000.0 * std::fabs(theta[part])).epsilon(1e-4));
            CHECK(ratio == fed.change.ratio);
        }
        CHECK(fed.change.pending == 0U);
    }
}

TEST_CASE("a flip in the sums starts them anew", "[unit][change][REQ-MON-17]") {
    const auto spoilt = [](void (*flip)(lpvg_change_t&)) {
        Fed fed(free_estimates());
        fed.run(100U, {0.5, 0.0, 0.0});
        flip(fed.change);
        CHECK(fed.take({0.5, 0.0, 0.0}) < Real(1));
        CHECK(fed.change.begun == 0U);
        CHECK(fed.change.ratio == Real(0));
        fed.run(3000U, {0.5, 0.0, 0.0});
        CHECK(static_cast<double>(fed.change.estimate[0]) == Approx(0.5).margin(2e-3));
    };
    spoilt([](lpvg_change_t& c) { c.output[LPVG_NY - 1].gram[5] = Real(1e30); });
    spoilt([](lpvg_change_t& c) { c.output[LPVG_NY - 1].along[0] += Real(1); });
    spoilt([](lpvg_change_t& c) { c.output[LPVG_NY - 1].before += Real(1); });
    spoilt([](lpvg_change_t& c) { c.sum[LPVG_NY - 1] ^= 1U; });
}

TEST_CASE("a count of waiting outputs that cannot be reads no other memory", "[unit][change][REQ-MON-17]") {
    for (const uint32_t pending : {0U, LPVG_NY + 1U, 0xFFFFFFFFU}) {
        Fed fed(free_estimates());
        fed.run(10U, {0.5, 0.0, 0.0});
        fed.change.pending = pending;
        (void)lpvg_change_judge(&fed.change, &fed.coeff);
        CHECK(fed.change.pending == 0U);
        CHECK(fed.change.strongest / parts == LPVG_NY - 1U);
    }
}

TEST_CASE("what is not finite reads as infinite", "[unit][change][REQ-MON-17]") {
    for (const Real bad : {std::numeric_limits<Real>::quiet_NaN(), std::numeric_limits<Real>::infinity()}) {
        Fed fed(free_estimates());
        fed.run(10U, {0.1, 0.0, 0.0});
        Real signal[n_block][2U * LPVG_NY] = {};
        signal[n_block - 1U][LPVG_NY - 1U] = bad;
        lpvg_change_take(&fed.change, signal[0]);
        fed.change.pending = 1U;
        CHECK(lpvg_change_judge(&fed.change, &fed.coeff) == std::numeric_limits<Real>::infinity());
        CHECK(fed.change.strongest / parts == LPVG_NY - 1U);
    }
}

TEST_CASE("the estimate solves the normal equations, as elimination in double does", "[unit][change][REQ-MON-16]") {
    Fed fed(free_estimates());
    const lpvg_coeff_reals_t& r = fed.coeff.reals;
    constexpr std::size_t j = LPVG_NY - 1;
    std::uint32_t random = 1U;
    const auto noise = [&random] {
        random = random * 1664525U + 1013904223U;
        return static_cast<double>(random >> 8U) / 8388608.0 - 1.0;
    };
    for (int k = 0; k < 50; ++k) {
        // A = M M' + 0.2, and A theta = b.
        double M[parts][parts], system[parts][parts + 1] = {};
        for (auto& row : M) {
            std::generate(std::begin(row), std::end(row), noise);
        }
        for (std::size_t a = 0; a < parts; ++a) {
            for (std::size_t b = 0; b < parts; ++b) {
                for (std::size_t c = 0; c < parts; ++c) {
                    system[a][b] += M[a][c] * M[b][c];
                }
            }
            system[a][a] += 0.2;
            system[a][parts] = k == 0 ? 0.0 : noise();
        }
        lpvg_change_output_t& of = fed.change.output[j];
        const double prior = static_cast<double>(r.change_prior[j][0]);
        const double gram[6] = {system[0][0] - prior, system[0][1], system[0][2], system[1][1] - prior, system[1][2], system[2][2] - prior};
        std::transform(std::begin(gram), std::end(gram), std::begin(of.gram), [](double g) { return static_cast<Real>(g); });
        for (std::size_t a = 0; a < parts; ++a) {
            of.along[a] = static_cast<Real>(system[a][parts]);
        }
        fed.change.sum[j] = lpvguard::sum_of_words(of);
        fed.change.begun = 0U;  // this block adds nothing
        fed.change.pending = 1U;
        const Real ratio = lpvg_change_judge(&fed.change, &fed.coeff);
        double theta[parts];
        for (std::size_t a = 0; a < parts; ++a) {
            for (std::size_t b = a + 1U; b < parts; ++b) {
                const double share = system[b][a] / system[a][a];
                for (std::size_t c = a; c <= parts; ++c) {
                    system[b][c] -= share * system[a][c];
                }
            }
        }
        for (std::size_t a = parts; a-- > 0U;) {
            theta[a] = system[a][parts];
            for (std::size_t b = a + 1U; b < parts; ++b) {
                theta[a] -= system[a][b] * theta[b];
            }
            theta[a] /= system[a][a];
        }
        const double sizes[parts] = {static_cast<double>(r.change_unit[j][0]),
                                     static_cast<double>(r.change_unit[j][1]) * static_cast<double>(r.change_block_s), 1.0};
        std::size_t largest = 0;
        CAPTURE(k);
        for (std::size_t a = 0; a < parts; ++a) {
            largest = std::abs(theta[a]) > std::abs(theta[largest]) ? a : largest;
            CHECK(static_cast<double>(fed.change.estimate[a]) == Approx(theta[a] * sizes[a]).epsilon(1e-3).margin(1e-4));
        }
        CHECK(static_cast<double>(ratio) == Approx(std::abs(theta[largest])).epsilon(1e-3));  // all sizes are 1
        CHECK(fed.change.strongest == parts * j + largest);
    }
}

TEST_CASE("the sums are what double says of every output, each with its own prior", "[unit][change][REQ-MON-16]") {
    const lpvg_coeff_t coeff = sealed([](lpvg_coeff_t& c) {
        c = free_estimates();
        for (std::size_t j = 0; j < LPVG_NY; ++j) {
            const Real more = static_cast<Real>(3U * j);
            const Real prior[6] = {more + Real(20), Real(1), Real(-2), more + Real(30), Real(3), more + Real(10)};
            std::copy(std::begin(prior), std::end(prior), std::begin(c.reals.change_prior[j]));
            c.reals.change_unit[j][0] = Real(1) + Real(0.5) * static_cast<Real>(j);
            c.reals.change_unit[j][1] = Real(20) + Real(5) * static_cast<Real>(j);
        }
    });
    const lpvg_coeff_reals_t& r = coeff.reals;
    const Fault fault = {0.3, 0.004, 0.2};
    constexpr uint32_t blocks = 500U;
    double A[LPVG_NY][6], along[LPVG_NY][parts] = {};
    for (std::size_t j = 0; j < LPVG_NY; ++j) {
        std::fill(std::begin(A[j]), std::end(A[j]), 0.0);
        double before = 0.0;
        for (uint32_t k = 0; k < blocks; ++k) {
            double e = 0.0, yhat = 0.0;
            for (uint32_t i = 0; i < n_block; ++i) {
                const double at = n_block * k + i;
                yhat += nominal(at, j) / n_block;
                e += (fault.gain * nominal(at, j) - fault.delay * slope(at, j) + fault.bias) / n_block;
            }
            const double phi[parts] = {yhat * static_cast<double>(r.change_unit[j][0]),
                                       (before - yhat) * static_cast<double>(r.change_unit[j][1]), 1.0};
            before = yhat;
            if (k == 0U) {
                continue;
            }
            const double kept = 1.0 - static_cast<double>(r.change_forget);
            for (std::size_t a = 0, at = 0; a < parts; ++a) {
                along[j][a] = kept * along[j][a] + phi[a] * e;
                for (std::size_t b = a; b < parts; ++b, ++at) {
                    A[j][at] = kept * A[j][at] + phi[a] * phi[b];
                }
            }
        }
    }
    Fed fed(coeff);
    fed.run(blocks - 1U, fault);
    fed.offer(fault);
    for (std::size_t j = 0; j < LPVG_NY; ++j) {
        (void)lpvg_change_judge(&fed.change, &fed.coeff);
        for (std::size_t i = 0; i < 6U; ++i) {
            CHECK(static_cast<double>(fed.change.output[j].gram[i]) == Approx(A[j][i]).epsilon(1e-4).margin(2e-3));
        }
        // (A + prior) theta = along.
        const double theta[parts] = {static_cast<double>(fed.change.estimate[0]) / static_cast<double>(r.change_unit[j][0]),
                                     static_cast<double>(fed.change.estimate[1]) /
                                         (static_cast<double>(r.change_unit[j][1]) * static_cast<double>(r.change_block_s)),
                                     static_cast<double>(fed.change.estimate[2])};
        const std::size_t place[parts][parts] = {{0U, 1U, 2U}, {1U, 3U, 4U}, {2U, 4U, 5U}};
        for (std::size_t a = 0; a < parts; ++a) {
            double sum = 0.0;
            for (std::size_t b = 0; b < parts; ++b) {
                sum += (A[j][place[a][b]] + static_cast<double>(r.change_prior[j][place[a][b]])) * theta[b];
            }
            CHECK(sum == Approx(along[j][a]).epsilon(1e-4).margin(2e-3));
        }
    }
}

TEST_CASE("a block that comes before every output has judged the last one starts the sums behind it", "[unit][change][REQ-MON-16]") {
    Fed fed(free_estimates());
    fed.run(3U, Fault{});
    REQUIRE(fed.change.begun == 1U);
    const Real quiet[n_block][2U * LPVG_NY] = {};
    lpvg_change_take(&fed.change, quiet[0]);
    CHECK(fed.change.begun == 1U);
    lpvg_change_take(&fed.change, quiet[0]);  // none has judged
    CHECK(fed.change.begun == 0U);
    for (uint32_t j = 0U; j < LPVG_NY; ++j) {
        CHECK(fed.change.begun == 0U);
        (void)lpvg_change_judge(&fed.change, &fed.coeff);
    }
    CHECK(fed.change.begun == 1U);
}

TEST_CASE("a changed gain is an alarm with its estimate, and again only after a pause", "[unit][change][REQ-MON-16]") {
    const uint32_t rearm = 20U;
    Drive drive(heard(0.1, rearm));
    const uint32_t settle = words().settle_samples;
    CHECK(records(drive, settle + 4U * longest()).empty());
    CHECK(lpvg_monitor_verdict(&drive.monitor, drive.sample.t_us) != lpvg_verdict_degraded);
    drive.gain = 0.5;
    while (drive.monitor.n_records == 0U) {
        drive.run(1U);
        REQUIRE(drive.now() < 20 * static_cast<int64_t>(longest()) * period_us());
    }
    const lpvg_change_t said = drive.monitor.change;  // of the sample that the alarm came with
    const int64_t alarmed_us = drive.now();
    const uint32_t sequence = drive.monitor.frame.sequence;
    const std::vector<lpvg_frame_t> found = records(drive, 4U * longest());
    REQUIRE(found.size() == 1U);
    const lpvg_frame_t& alarm = found[0];
    CHECK(alarm.test == lpvg_test_change);
    CHECK(alarm.bin == said.strongest);
    CHECK(alarm.t_end_us == alarmed_us);
    CHECK(alarm.sequence == sequence);
    CHECK(alarm.E[0][0] == said.estimate[0]);
    CHECK(alarm.E[0][1] == said.estimate[1]);
    CHECK(alarm.Z[0][0] == said.estimate[2]);
    CHECK(alarm.Z[0][1] == Real(0));
    CHECK(alarm.falsified);
    CHECK(alarm.bin % parts == 0U);
    CHECK(alarm.margin > Real(1));
    CHECK(alarm.statistic == alarm.margin);
    CHECK(alarm.evidence == Approx(10.0).epsilon(1e-3));
    CHECK(alarm.speed == drive.speed);
    CHECK(static_cast<double>(alarm.E[0][0]) < -0.1);
    CHECK(lpvg_monitor_verdict(&drive.monitor, drive.sample.t_us) == lpvg_verdict_degraded);
    CHECK(static_cast<double>(drive.monitor.change.estimate[0]) == Approx(-0.5).margin(0.05));
    drive.gain = 1.0;
    CHECK(records(drive, n_block * (200U + 2U * rearm)).empty());
    drive.gain = 0.5;
    CHECK_FALSE(records(drive, 4U * longest()).empty());
}

TEST_CASE("no block is taken before the model has settled, out of range or over a gap", "[unit][change][REQ-MON-16]") {
    Drive drive(heard(0.1));
    drive.gain = 0.5;
    const uint32_t settle = words().settle_samples;
    for (uint32_t k = 0; k < settle; ++k) {
        REQUIRE(drive.step() == lpvg_status_ok);
        CHECK(drive.monitor.change.begun == 0U);
    }
    CHECK(begins(drive));
    drive.speed = Real(0.5) * (lpvg_coeff.reals.speed_valid[0] + lpvg_coeff.reals.speed_min);
    drive.run(2U * n_block);
    CHECK(drive.monitor.change.begun == 0U);
    drive.speed = cruise();
    drive.run(settle);
    CHECK(begins(drive));
    lpvg_sample_t late = drive.next();
    late.t_us += 10 * period_us();
    REQUIRE(lpvg_monitor_push(&drive.monitor, &late) == lpvg_status_ok);
    CHECK(drive.monitor.change.begun == 0U);
}

TEST_CASE("a sum that is not finite falsifies, and the test starts anew", "[unit][change][REQ-MON-17]") {
    Drive drive(heard(1e6));
    drive.run(words().settle_samples + 8U * n_block);
    REQUIRE(begins(drive));
    while (drive.monitor.change.pending == 0U) {
        REQUIRE(drive.step() == lpvg_status_ok);
    }
    drive.monitor.change.mean[LPVG_NY - drive.monitor.change.pending] = std::numeric_limits<Real>::infinity();
    const std::vector<lpvg_frame_t> found = records(drive, n_block);
    REQUIRE(found.size() == 1U);
    CHECK(found[0].test == lpvg_test_change);
    CHECK(lpvg_monitor_verdict(&drive.monitor, drive.sample.t_us) == lpvg_verdict_degraded);
    CHECK(drive.monitor.change.begun == 0U);
}
