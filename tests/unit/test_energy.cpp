// The energy test: its sums and filters by themselves, and as a part of the monitor. Compiled for every test vehicle.
#include "../catch.hpp"

#include <algorithm>
#include <cmath>
#include <complex>
#include <cstdint>
#include <cstring>
#include <deque>
#include <utility>
#include <vector>

#include "monitor_drive.hpp"

namespace {

constexpr double pi = 3.141592653589793;

double rho() { return std::sqrt(1.0 - static_cast<double>(lpvg_coeff.reals.energy_forget[0])); }
uint32_t memory() { return static_cast<uint32_t>(std::ceil(1.0 / -std::log(rho()))); }

// W_delta a constant, b(z) = value (z^2) over z^2; sigma the same for all outputs; nothing remembered at a restart.
void with_constant_weight(lpvg_coeff_t& c, double weight, double sigma) {
    for (std::size_t d = 0; d < LPVG_NDELTA; ++d) {
        for (auto& section : c.reals.energy_W[d]) {
            const Real chain[5] = {Real(1), Real(2), Real(1), Real(2), Real(1)};
            std::memcpy(section, chain, sizeof chain);
        }
        for (std::size_t i = 0; i < 3U; ++i) {
            c.reals.energy_W[d][0][i] *= static_cast<Real>(weight);
        }
    }
    for (auto& band : c.reals.energy_scale) {
        std::fill(std::begin(band), std::end(band), static_cast<Real>(1.0 / sigma));
    }
    for (auto& band : c.reals.energy_start) {
        std::fill(std::begin(band), std::end(band), Real(0));
    }
}

// F of a band at z: with the corners' low-passes L, band b is (1 - L[b - 1]) L[b] L[b + 1] ... and band 0 all L.
std::complex<double> filter(const lpvg_coeff_t& c, std::size_t band, std::complex<double> z) {
    const auto low_pass = [&](std::size_t corner) {
        const auto g = static_cast<double>(c.reals.energy_corner[corner]);
        return g * (z + 1.0) / (z - 1.0 + 2.0 * g);
    };
    std::complex<double> response = band == 0U ? 1.0 : 1.0 - low_pass(band - 1U);
    for (std::size_t corner = band; corner < LPVG_NBANDS - 1U; ++corner) {
        response *= low_pass(corner);
    }
    return response;
}

// Only one band is heard, the others' sigma being so large.
void hear_only(lpvg_coeff_t& c, std::size_t band) {
    for (std::size_t b = 0; b < LPVG_NBANDS; ++b) {
        for (Real& scale : c.reals.energy_scale[b]) {
            scale = b == band ? scale : Real(1e-12);
        }
    }
}

// The test alone, fed with e and yhat directly.
struct Fed {
    lpvg_coeff_t coeff;
    lpvg_energy_t energy;
    explicit Fed(const lpvg_coeff_t& c) : coeff(c) { lpvg_energy_start(&energy); }

    // e_j = error[j] * z_e and yhat_j = nominal[j] * z_n; the largest ratio over the whole fan.
    double take(const double* error, double z_e, const double* nominal, double z_n) {
        Real signal[2 * LPVG_NY];
        for (std::size_t j = 0; j < LPVG_NY; ++j) {
            signal[j] = static_cast<Real>(error[j] * z_e);
            signal[LPVG_NY + j] = static_cast<Real>(nominal[j] * z_n);
        }
        lpvg_energy_advance(&energy, &coeff, signal, true);
        double worst = 0.0;
        for (std::size_t d = 0; d < LPVG_NDIRECTIONS; ++d) {
            worst = std::max(worst, static_cast<double>(lpvg_energy_judge(&energy, &coeff)));
        }
        return worst;
    }
};

// Of a direction that looks at one output only.
bool single(const Real* a) {
    return std::count_if(a, a + LPVG_NY, [](Real x) { return x != Real(0); }) == 1;
}

}  // namespace

TEST_CASE("the directions are turned through, and single outputs are among them", "[unit][energy][REQ-MON-14]") {
    Fed fed(lpvg_coeff);
    for (uint32_t k = 0; k < 2U * LPVG_NDIRECTIONS; ++k) {
        (void)lpvg_energy_judge(&fed.energy, &fed.coeff);
        CHECK(fed.energy.direction == k % LPVG_NDIRECTIONS);
    }
    std::size_t singles = 0;
    for (const auto& a : lpvg_coeff.reals.energy_direction) {
        singles += single(a) ? 1U : 0U;
    }
    CHECK(singles == LPVG_NY);
}

TEST_CASE("without any error no band is the strongest but the lowest", "[unit][energy][REQ-MON-14]") {
    Fed fed(lpvg_coeff);
    fed.energy.strongest = LPVG_NBANDS - 1U;  // of the direction before
    CHECK(lpvg_energy_judge(&fed.energy, &fed.coeff) == Real(0));
    CHECK(fed.energy.strongest == 0U);
    CHECK(lpvg_energy_evidence(&fed.energy, &fed.coeff) == Real(0));
}

TEST_CASE("a constant error gain reads gain over weight, where sigma is small", "[unit][energy][REQ-MON-14]") {
    Fed fed(sealed([](lpvg_coeff_t& c) { with_constant_weight(c, 0.5, 1e-4); }));
    const double all[4] = {1.0, 1.0, 1.0, 1.0}, error[4] = {0.6, 0.6, 0.6, 0.6};
    const double step = 2.0 * pi * 3.0 / words().frame_length[LPVG_NBINS / 2];
    double ratio = 0.0;
    for (uint32_t k = 0; k < 8U * memory(); ++k) {
        ratio = fed.take(error, std::sin(step * k), all, std::sin(step * k));
    }
    CHECK(ratio == Approx(1.2).epsilon(2e-3));
}

TEST_CASE("without nominal output the ratio is the filtered error's norm over sigma", "[unit][energy][REQ-MON-14]") {
    const double sigma = 0.05, amplitude = 0.2;
    const double all[4] = {1.0, 1.0, 1.0, 1.0};
    for (std::size_t band = 0; band < LPVG_NBANDS; ++band) {
        const lpvg_coeff_t coeff = sealed([&](lpvg_coeff_t& c) {
            with_constant_weight(c, 0.5, sigma);
            hear_only(c, band);
        });
        for (const uint32_t bin : {uint32_t{1}, uint32_t{LPVG_NBINS / 2}, uint32_t{LPVG_NBINS - 1}}) {
            const double step = 2.0 * pi * words().cycles[bin] / words().frame_length[bin];
            Fed fed(coeff);
            double ratio = 0.0, least = 1e9, most = 0.0;
            for (uint32_t k = 0; k < 12U * memory(); ++k) {
                ratio = fed.take(all, amplitude * std::sin(step * k), all, 0.0);
                if (k > 8U * memory()) {
                    least = std::min(least, ratio);
                    most = std::max(most, ratio);
                }
            }
            CAPTURE(band, bin);
            const double norm = std::abs(filter(coeff, band, std::polar(1.0, step))) * amplitude /
                                std::sqrt(2.0 * static_cast<double>(coeff.reals.energy_forget[band])) / sigma;
            // The sum swells and falls with twice the sine's frequency, the more the shorter the memory.
            const auto forget = static_cast<double>(coeff.reals.energy_forget[band]);
            const double swing = forget / std::abs(1.0 - (1.0 - forget) * std::polar(1.0, -2.0 * step));
            CHECK(least == Approx(norm * std::sqrt(1.0 - swing)).epsilon(0.02));
            CHECK(most == Approx(norm * std::sqrt(1.0 + swing)).epsilon(0.02));
        }
    }
}

TEST_CASE("each kind of error is told in its own band", "[unit][energy][REQ-MON-14]") {
    const lpvg_coeff_t coeff = sealed([](lpvg_coeff_t& c) { with_constant_weight(c, 0.5, 0.05); });
    const double all[4] = {1.0, 1.0, 1.0, 1.0};
    const auto strongest = [&](const auto& error) {
        Fed fed(coeff);
        for (uint32_t k = 0; k < 10U * memory(); ++k) {
            (void)fed.take(all, error(k), all, 0.0);
        }
        return fed.energy.strongest;
    };
    CHECK(strongest([](uint32_t) { return 0.2; }) == 0U);
    for (uint32_t band = 1U; band + 1U < LPVG_NBANDS; ++band) {
        const auto between =
            std::sqrt(static_cast<double>(coeff.reals.energy_corner[band - 1U]) * static_cast<double>(coeff.reals.energy_corner[band]));
        CHECK(strongest([&](uint32_t k) { return 0.2 * std::sin(2.0 * std::atan(between / (1.0 - between)) * k); }) == band);
    }
    CHECK(strongest([](uint32_t k) { return k % 2U == 0U ? 0.2 : -0.2; }) == LPVG_NBANDS - 1U);
}

TEST_CASE("errors of opposite sign under one nominal output are seen by the joint form only", "[unit][energy][REQ-MON-14]") {
    if (LPVG_NY < 2 || LPVG_NDELTA > 1) {
        return;
    }
    Fed fed(sealed([](lpvg_coeff_t& c) { with_constant_weight(c, 1.05, 0.01); }));
    double opposite[4] = {1.0, -1.0, 0.0, 0.0}, same[4] = {1.0, 1.0, 0.0, 0.0};
    const double step = 2.0 * pi * 3.0 / words().frame_length[LPVG_NBINS / 2];
    for (uint32_t k = 0; k < 6U * memory(); ++k) {
        CHECK(fed.take(same, std::sin(step * k), same, std::sin(step * k)) <= 1.0);
    }
    lpvg_energy_start(&fed.energy);
    for (uint32_t k = 0; k < 6U * memory(); ++k) {
        (void)fed.take(opposite, std::sin(step * k), same, std::sin(step * k));
    }
    double joint = 0.0;
    for (const auto& a : fed.coeff.reals.energy_direction) {
        const double ratio = static_cast<double>(lpvg_energy_judge(&fed.energy, &fed.coeff));
        if (single(a)) {
            CHECK(ratio <= 1.0);
        }
        joint = std::max(joint, ratio);
    }
    CHECK(joint > 2.0);
}

TEST_CASE("every output is held against its own weight where it has its own Delta", "[unit][energy][REQ-MON-14]") {
    // The outputs' errors are 0.9 of what their weights allow, the last output's 1.2.
    if (LPVG_NDELTA == 1) {
        return;
    }
    Fed fed(sealed([](lpvg_coeff_t& c) {
        with_constant_weight(c, 1.0, 1e-4);
        for (std::size_t d = 0; d < LPVG_NDELTA; ++d) {
            const auto weight = static_cast<Real>(0.2 * static_cast<double>(d + 1U));
            for (std::size_t i = 0; i < 3U; ++i) {
                c.reals.energy_W[d][0][i] *= weight;
            }
        }
    }));
    double all[4] = {1.0, 1.0, 1.0, 1.0}, error[4] = {};
    for (std::size_t j = 0; j < LPVG_NY; ++j) {  // signs alternate: no Delta is common to the outputs
        error[j] = (j + 1U < LPVG_NY ? 0.9 : 1.2) * 0.2 * static_cast<double>(j + 1U) * (j % 2U == 0U ? 1.0 : -1.0);
    }
    const double step = 2.0 * pi * 3.0 / words().frame_length[LPVG_NBINS / 2];
    for (uint32_t k = 0; k < 8U * memory(); ++k) {
        (void)fed.take(error, std::sin(step * k), all, std::sin(step * k));
    }
    for (const auto& a : fed.coeff.reals.energy_direction) {
        CHECK(single(a));
        const double ratio = static_cast<double>(lpvg_energy_judge(&fed.energy, &fed.coeff));
        CHECK(ratio == Approx(a[LPVG_NY - 1] != Real(0) ? 1.2 : 0.9).epsilon(2e-3));
        const double allowed = 0.2 * static_cast<double>(std::find_if(a, a + LPVG_NY, [](Real x) { return x != Real(0); }) - a + 1);
        CHECK(lpvg_energy_evidence(&fed.energy, &fed.coeff) == Approx(1.0 / allowed).epsilon(2e-3));
    }
}

namespace {

// Sums, sections and bands as energy.h and coeff.h define them, in double and by z instead of d = z - 1.
class Definition {
public:
    explicit Definition(const lpvg_coeff_t& c) : r_(c.reals) {}

    void take(const Real* signal, bool settled) {
        double whole[3][LPVG_NY];
        for (std::size_t j = 0; j < LPVG_NY; ++j) {
            whole[0][j] = static_cast<double>(signal[j]);
            whole[1][j] = whole[2][j] = static_cast<double>(signal[LPVG_NY + j]);
            for (std::size_t s = 0; s < LPVG_NWEIGHT; ++s) {
                whole[2][j] = weighted(r_.energy_W[delta_of(j)][s], whole[2][j], past_[s][j]);
            }
        }
        double band[LPVG_NBANDS][3][LPVG_NY];
        for (std::size_t what = 0; what < 3U; ++what) {
            for (std::size_t j = 0; j < LPVG_NY; ++j) {
                double rest = whole[what][j];
                for (std::size_t b = LPVG_NBANDS - 1U; b > 0U; --b) {
                    auto& [x, y] = low_[b - 1U][what][j];
                    const auto g = static_cast<double>(r_.energy_corner[b - 1U]);
                    y = (1.0 - 2.0 * g) * y + g * (rest + x);
                    x = rest;
                    band[b][what][j] = rest - y;
                    rest = y;
                }
                band[0][what][j] = rest;
            }
        }
        const double long_keep = 1.0 - static_cast<double>(r_.energy_forget[0]);
        fading_ *= std::sqrt(long_keep);
        for (std::size_t b = 0; b < LPVG_NBANDS; ++b) {
            add(right_[b], band[b][2], long_keep);
            if (settled) {
                const double keep = 1.0 - static_cast<double>(r_.energy_forget[b]);
                add(left_[b], band[b][0], keep);
                add(nominal_[b], band[b][1], keep);
            }
        }
    }

    // Of direction a: the largest of the bands' ratios, and what it would be of a vehicle that does not answer.
    std::pair<double, double> judged(const Real* a) const {
        double largest = 0.0, dead = 0.0;
        for (std::size_t b = 0; b < LPVG_NBANDS; ++b) {
            const double allowed = norm(right_[b], a, b) + fading_ * remembered(a, b) + 1.0, ratio = norm(left_[b], a, b) / allowed;
            if (ratio > largest) {
                largest = ratio;
                dead = norm(nominal_[b], a, b) / allowed;
            }
        }
        return {largest, dead};
    }

    // (b0 d^2 + b1 d + b2) / (d^2 + a1 d + a2); past: the newest two values in and out.
    static double weighted(const Real* c, double x, double (&past)[4]) {
        const double b0 = c[0], b1 = c[1], b2 = c[2], a1 = c[3], a2 = c[4];
        const double y = b0 * x + (b1 - 2.0 * b0) * past[0] + (b0 - b1 + b2) * past[1] - (a1 - 2.0) * past[2] - (1.0 - a1 + a2) * past[3];
        past[1] = past[0];
        past[0] = x;
        past[3] = past[2];
        past[2] = y;
        return y;
    }

private:
    using Gram = double[LPVG_NY][LPVG_NY];

    static std::size_t delta_of(std::size_t j) { return LPVG_NDELTA == 1 ? 0U : j; }

    static void add(Gram& gram, const double* x, double keep) {
        for (std::size_t i = 0; i < LPVG_NY; ++i) {
            for (std::size_t j = 0; j < LPVG_NY; ++j) {
                gram[i][j] = keep * gram[i][j] + x[i] * x[j];
            }
        }
    }

    double norm(const Gram& gram, const Real* a, std::size_t b) const {
        double sum = 0.0;
        for (std::size_t i = 0; i < LPVG_NY; ++i) {
            for (std::size_t j = 0; j < LPVG_NY; ++j) {
                sum += static_cast<double>(a[i] * r_.energy_scale[b][i]) * gram[i][j] * static_cast<double>(a[j] * r_.energy_scale[b][j]);
            }
        }
        return std::sqrt(std::max(sum, 0.0));
    }

    double remembered(const Real* a, std::size_t b) const {
        double sum = 0.0;
        for (std::size_t j = 0; j < LPVG_NY; ++j) {
            sum += std::abs(static_cast<double>(a[j] * r_.energy_scale[b][j])) * static_cast<double>(r_.energy_start[b][j]);
        }
        return sum;
    }

    const lpvg_coeff_reals_t& r_;
    double past_[LPVG_NWEIGHT][LPVG_NY][4] = {};
    std::pair<double, double> low_[LPVG_NBANDS - 1][3][LPVG_NY] = {};  // the newest value in, and out
    Gram left_[LPVG_NBANDS] = {}, right_[LPVG_NBANDS] = {}, nominal_[LPVG_NBANDS] = {};
    double fading_ = 1.0;  // rho^(T - t0 + 1)
};

// Every section, output, band and direction differs from every other.
lpvg_coeff_t with_all_different() {
    return sealed([](lpvg_coeff_t& c) {
        lpvg_coeff_reals_t& r = c.reals;
        for (std::size_t d = 0; d < LPVG_NDELTA; ++d) {
            for (std::size_t s = 0; s < LPVG_NWEIGHT; ++s) {
                const Real at = Real(0.03) * static_cast<Real>(d * LPVG_NWEIGHT + s);
                const Real chain[5] = {Real(0.7) - at, Real(0.31) + at, Real(0.11) - at / Real(2), Real(0.6) + at, Real(0.15) + at};
                std::memcpy(r.energy_W[d][s], chain, sizeof chain);
            }
        }
        for (std::size_t b = 0; b < LPVG_NBANDS; ++b) {
            r.energy_forget[b] = Real(0.02) * static_cast<Real>(b + 1U);
            for (std::size_t j = 0; j < LPVG_NY; ++j) {
                r.energy_scale[b][j] = Real(3) + static_cast<Real>(b) - Real(0.8) * static_cast<Real>(j);
                r.energy_start[b][j] = Real(0.5) + Real(0.3) * static_cast<Real>(b) + Real(0.4) * static_cast<Real>(j);
            }
        }
        for (std::size_t b = 0; b + 1U < LPVG_NBANDS; ++b) {
            r.energy_corner[b] = Real(0.05) + Real(0.2) * static_cast<Real>(b);
        }
        if (LPVG_NDELTA == 1 && LPVG_NY == 2) {
            const Real joint[2] = {Real(0.7), Real(-0.3)};
            std::copy(joint, joint + LPVG_NY, r.energy_direction[LPVG_NDIRECTIONS - 1]);
        }
    });
}

}  // namespace

TEST_CASE("ratio and evidence are what their definition says in double, of every direction", "[unit][energy][REQ-MON-14]") {
    const std::size_t loud = GENERATE(range(std::size_t{0}, std::size_t{LPVG_NBANDS}));
    lpvg_coeff_t coeff = with_all_different();
    hear_only(coeff, loud);
    Fed fed(coeff);
    Definition definition(fed.coeff);
    std::uint32_t random = 1U;
    const auto noise = [&random] {
        random = random * 1664525U + 1013904223U;
        return static_cast<Real>(random >> 8U) / Real(1U << 23U) - Real(1);
    };
    double off_ratio = 0.0, off_evidence = 0.0, strongest = 0.0;
    for (uint32_t k = 0; k < 400U; ++k) {
        Real signal[2 * LPVG_NY], common = noise();
        for (Real& x : signal) {  // the outputs go together in part, so that their cross sums count
            x = common + noise();
        }
        const bool settled = k >= 30U && k < 380U;
        lpvg_energy_advance(&fed.energy, &fed.coeff, signal, settled);
        definition.take(signal, settled);
        for (const auto& a : fed.coeff.reals.energy_direction) {
            const auto ratio = static_cast<double>(lpvg_energy_judge(&fed.energy, &fed.coeff));
            const auto [want, dead] = definition.judged(a);
            off_ratio = std::max(off_ratio, std::abs(ratio - want));
            strongest = std::max(strongest, want);
            if (want > 0.0) {
                const auto evidence = static_cast<double>(lpvg_energy_evidence(&fed.energy, &fed.coeff));
                off_evidence = std::max(off_evidence, std::abs(evidence - dead));
            }
        }
    }
    CHECK(strongest > 0.5);
    CHECK(off_ratio <= 1e-4);
    CHECK(off_evidence <= 1e-4);
}

TEST_CASE("an error of exactly W_delta yhat that rings on is within the bound in every band", "[unit][energy][REQ-MON-14]") {
    // The weight rings for a part of the lower bands' memory. A sine at its resonance ends at once.
    const double share = GENERATE(0.05, 0.2, 0.6), periods = GENERATE(0.5, 3.0, 30.0);
    const double radius = std::exp(-1.0 / (share * memory())), turn = 2.0 * pi * periods / memory();
    const lpvg_coeff_t coeff = sealed([&](lpvg_coeff_t& c) {
        with_constant_weight(c, 1.0, 1e-3);
        for (std::size_t d = 0; d < LPVG_NDELTA; ++d) {
            const double resonance[5] = {0.5, 0.5, 0.4 * (1.0 - 2.0 * radius * std::cos(turn) + radius * radius),
                                         2.0 - 2.0 * radius * std::cos(turn), 1.0 - 2.0 * radius * std::cos(turn) + radius * radius};
            std::copy(std::begin(resonance), std::end(resonance), c.reals.energy_W[d][0]);
        }
    });
    Fed fed(coeff);
    double past[4] = {}, worst = 0.0;
    const double all[4] = {1.0, 1.0, 1.0, 1.0};
    for (uint32_t k = 0; k < 8U * memory(); ++k) {
        const double nominal = k < 5U * memory() ? std::sin(turn * k) : 0.0;
        worst = std::max(worst, fed.take(all, Definition::weighted(coeff.reals.energy_W[0][0], nominal, past), all, nominal));
    }
    CHECK(worst <= 1.0);
    CHECK(worst > 0.5);
}

TEST_CASE("a sum that rounding made negative counts as none", "[unit][energy][REQ-MON-14]") {
    // Outputs that cancel in a direction: its sum is zero but for rounding, which must neither alarm nor excuse.
    if (LPVG_NY != 2 || LPVG_NDELTA > 1) {
        return;
    }
    Fed fed(with_all_different());
    auto& reals = fed.coeff.reals;
    for (auto& band : reals.energy_start) {
        std::fill(std::begin(band), std::end(band), Real(0));
    }
    const auto& a = reals.energy_direction[LPVG_NDIRECTIONS - 1];
    for (std::size_t b = 0; b < LPVG_NBANDS; ++b) {
        const Real first = a[0] * reals.energy_scale[b][0], second = a[1] * reals.energy_scale[b][1];
        const Real cancelling[3] = {second * second, -first * second * Real(1.00001), first * first};
        std::copy(std::begin(cancelling), std::end(cancelling), std::begin(fed.energy.band[b].left));
        std::copy(std::begin(cancelling), std::end(cancelling), std::begin(fed.energy.band[b].right));
    }
    fed.energy.next_direction = LPVG_NDIRECTIONS - 1U;
    CHECK(lpvg_energy_judge(&fed.energy, &fed.coeff) == Real(0));
    const Real alone[3] = {Real(1) / (a[0] * a[0] * reals.energy_scale[0][0] * reals.energy_scale[0][0]), Real(0), Real(0)};
    std::copy(std::begin(alone), std::end(alone), std::begin(fed.energy.band[0].left));  // a norm of one, over sigma alone
    fed.energy.next_direction = LPVG_NDIRECTIONS - 1U;
    CHECK(lpvg_energy_judge(&fed.energy, &fed.coeff) == Approx(1.0).epsilon(1e-5));
}

TEST_CASE("a restart stays sound because the right side holds what Delta may remember", "[unit][energy][REQ-MON-14]") {
    // Delta of gain 1 on |z| = rho: (rho / z)^delay. At the restart it still holds what came before.
    const double all[4] = {1.0, 1.0, 1.0, 1.0}, weight = 0.8, step = 2.0 * pi * 3.0 / words().frame_length[LPVG_NBINS / 2];
    const uint32_t delay = memory() / 4U;
    const auto worst_after_restart = [&](bool remembered) {
        lpvg_coeff_t coeff = sealed([&](lpvg_coeff_t& c) {
            with_constant_weight(c, weight, 0.01);
            std::fill(std::begin(c.reals.energy_forget), std::end(c.reals.energy_forget), c.reals.energy_forget[0]);
        });
        Fed probe(coeff);
        for (uint32_t k = 0; k < 4U * memory(); ++k) {
            (void)probe.take(all, 0.0, all, std::sin(step * k));
        }
        for (std::size_t b = 0; b < LPVG_NBANDS; ++b) {
            for (Real& start : coeff.reals.energy_start[b]) {
                start = remembered ? std::sqrt(Real(1.1) * probe.energy.band[b].right[0]) : Real(0);
            }
        }
        Fed fed(coeff);
        std::deque<double> past(delay, 0.0);
        double worst = 0.0;
        for (uint32_t k = 0; k < 6U * memory(); ++k) {
            const double z = k < 4U * memory() ? std::sin(step * k) : 0.0;  // the input ends as the sums restart
            if (k == 4U * memory()) {
                const lpvg_energy_t before = fed.energy;
                lpvg_energy_start(&fed.energy);
                std::memcpy(fed.energy.F, before.F, sizeof before.F);  // F itself is settled: only the sums are at rest
                std::memcpy(fed.energy.W, before.W, sizeof before.W);
                worst = 0.0;
            }
            worst = std::max(worst, fed.take(all, weight * std::pow(rho(), delay) * past.front(), all, z));
            past.pop_front();
            past.push_back(z);
        }
        return worst;
    };
    CHECK(worst_after_restart(true) <= 1.0);
    CHECK(worst_after_restart(false) > 1.5);
}

namespace {

// Frames and change test never speak; the energy test does above 1.
lpvg_coeff_t energy_only(double weight) {
    return sealed([weight](lpvg_coeff_t& c) {
        with_constant_weight(c, weight, 1e-3);
        c.reals.energy_threshold = Real(1.001);
        c.reals.energy_certificate = Real(1);
        c.reals.threshold = c.reals.change_threshold = Real(1e9);
        for (auto& band : c.reals.energy_start) {
            std::fill(std::begin(band), std::end(band), Real(0));
        }
    });
}

}  // namespace

TEST_CASE("the monitor judges after the settling time, and alarms once a memory", "[unit][energy][REQ-MON-14]") {
    Drive drive(energy_only(0.3));
    drive.gain = 0.5;
    uint32_t first = 0U, k = 0U;
    lpvg_frame_t record{};
    while (drive.monitor.n_records == 0U) {
        drive.run(1U);
        ++k;
        if (drive.monitor.energy.ratio > Real(0) && first == 0U) {
            first = k;
        }
        REQUIRE(k < words().energy_settle + 20U * memory());
    }
    CHECK(first > words().energy_settle);
    CHECK(first <= words().energy_settle + LPVG_NBINS + 2U);  // a push that judges a frame does not judge the energy test
    CHECK(drive.verdict() == lpvg_verdict_invalid);
    REQUIRE(lpvg_monitor_take_record(&drive.monitor, &record));
    CHECK(record.test == lpvg_test_energy);
    CHECK(record.falsified);
    CHECK(record.refuted);
    CHECK(record.t_end_us == drive.now());
    CHECK(record.bin == drive.monitor.energy.strongest * LPVG_NDIRECTIONS + drive.monitor.energy.direction);
    CHECK(record.speed == cruise());
    CHECK(record.margin > Real(1.001));
    CHECK(record.statistic == record.margin);
    // e = -0.5 yhat, so that a dead vehicle would read twice as much.
    CHECK(record.evidence == Approx(static_cast<double>(record.margin) * 2.0).epsilon(1e-3));
    CHECK(record.sequence == drive.monitor.frame.sequence);
    CHECK(drive.monitor.frame.sequence > 0U);
    const lpvg_energy_band_t& loudest = drive.monitor.energy.band[drive.monitor.energy.strongest];
    CHECK(record.E[0][0] == std::sqrt(loudest.left[0]));
    CHECK(record.Z[0][0] == std::sqrt(loudest.right[0]));
    CHECK(record.E[LPVG_NY - 1][0] == std::sqrt(loudest.left[LPVG_NGRAM - 1]));
    CHECK(record.Z[LPVG_NY - 1][0] == std::sqrt(loudest.right[LPVG_NGRAM - 1]));
    for (std::size_t j = 0; j < LPVG_NY; ++j) {
        CHECK(record.E[j][0] > Real(0));
        CHECK(record.Z[j][0] > Real(0));
        CHECK(record.E[j][1] == Real(0));
        CHECK(record.Z[j][1] == Real(0));
    }
    if (LPVG_NY == 1) {
        const double explained = static_cast<double>(record.Z[0][0]) + 1e-3;
        CHECK(static_cast<double>(record.margin) == Approx(static_cast<double>(record.E[0][0]) / explained).epsilon(1e-4));
    }
    // It stays above: no second alarm, but the verdict is held on.
    drive.run(longest() + 3U * memory());
    CHECK(drive.verdict() == lpvg_verdict_invalid);
    CHECK(drive.monitor.n_records == 0U);
    // Well again for longer than the hold and the memory, then another alarm.
    drive.gain = 1.0;
    drive.run(20U * memory() + 2U * words().energy_rearm + longest());
    CHECK(drive.verdict() != lpvg_verdict_invalid);
    drive.gain = 0.5;
    drive.run(8U * memory());
    CHECK(drive.monitor.n_records == 1U);
    CHECK(drive.monitor.records_lost == 0U);
}

TEST_CASE("the left sums begin with the sample behind the settling time", "[unit][energy][REQ-MON-14]") {
    Drive drive(energy_only(0.3));
    drive.gain = 0.5;
    const auto begun = [&] {
        return std::any_of(std::begin(drive.monitor.energy.band), std::end(drive.monitor.energy.band),
                           [](const lpvg_energy_band_t& band) { return band.left[0] > Real(0) || band.nominal[0] > Real(0); });
    };
    drive.run(words().energy_settle);
    CHECK_FALSE(begun());
    drive.run(1U);
    CHECK(begun());
}

TEST_CASE("leaving the speed range, a gap and a refused sample start it from rest", "[unit][energy][REQ-MON-14]") {
    Drive drive(energy_only(0.3));
    drive.gain = 0.5;
    drive.run(words().energy_settle + 6U * memory());
    const auto judged = [&] {
        drive.run(LPVG_NBINS + 2U);
        return drive.monitor.energy.ratio > Real(0);
    };
    CHECK(judged());
    drive.speed = Real(0.5) * lpvg_coeff.reals.speed_min;
    drive.run(1U);
    drive.speed = cruise();
    CHECK_FALSE(judged());
    drive.run(words().energy_settle);
    CHECK(judged());
    drive.skip(period_us());
    CHECK_FALSE(judged());
    drive.run(words().energy_settle);
    CHECK(judged());
    lpvg_sample_t sample = drive.next();
    sample.speed = std::numeric_limits<Real>::quiet_NaN();
    CHECK(lpvg_monitor_push(&drive.monitor, &sample) == lpvg_status_bad_sample);
    CHECK_FALSE(judged());
}

TEST_CASE("within the bound it never speaks, and a verdict on frames stands by itself", "[unit][energy][REQ-MON-14]") {
    Drive drive(energy_only(0.3));
    drive.gain = 0.75;
    drive.settle();
    drive.run(20U * memory());
    CHECK(drive.monitor.n_records == 0U);
    CHECK(drive.monitor.energy.ratio > Real(0.5));
    CHECK(drive.verdict() != lpvg_verdict_invalid);
}

TEST_CASE("a bound that is not finite excuses nothing, in no direction that it is of", "[unit][energy][REQ-MON-15]") {
    Fed fed(lpvg_coeff);
    fed.energy.band[0].right[0] = std::numeric_limits<Real>::infinity();
    for (const auto& a : lpvg_coeff.reals.energy_direction) {
        const Real ratio = lpvg_energy_judge(&fed.energy, &fed.coeff);
        CHECK((a[0] == Real(0) || ratio == std::numeric_limits<Real>::infinity()));
    }
}

// Makes what was written to the right sums what the newest sample left, as far as the monitor can tell.
static void take_as_computed(lpvg_monitor_t& monitor, const lpvg_energy_t& before) {
    for (std::size_t b = 0; b < LPVG_NBANDS; ++b) {
        uint32_t now[sizeof before.band[b].right / (sizeof(uint32_t))], then[sizeof now / sizeof now[0]];
        std::memcpy(now, monitor.energy.band[b].right, sizeof now);
        std::memcpy(then, before.band[b].right, sizeof then);
        for (std::size_t i = 0; i < sizeof now / sizeof now[0]; ++i) {
            monitor.energy_sum += now[i] - then[i];
        }
    }
}

TEST_CASE("a sum that is not finite falsifies, and the test starts anew", "[unit][energy][REQ-MON-15][REQ-MON-4]") {
    const Real what = GENERATE(std::numeric_limits<Real>::quiet_NaN(), std::numeric_limits<Real>::infinity());
    const bool left = GENERATE(false, true);
    Drive drive;
    drive.run(words().energy_settle + 10U);
    REQUIRE(drive.verdict() != lpvg_verdict_invalid);
    const lpvg_energy_t before = drive.monitor.energy;
    auto& band = drive.monitor.energy.band[LPVG_NBANDS - 1];
    std::fill(std::begin(left ? band.left : band.right), std::end(left ? band.left : band.right), what);
    take_as_computed(drive.monitor, before);
    drive.run(2U * LPVG_NBINS);
    CHECK(drive.verdict() == lpvg_verdict_invalid);
    for (const auto& each : drive.monitor.energy.band) {
        CHECK(std::isfinite(each.left[0] + each.right[0] + each.nominal[0]));
    }
    lpvg_frame_t alarm{};
    REQUIRE(lpvg_monitor_take_record(&drive.monitor, &alarm));
    CHECK(alarm.test == lpvg_test_energy);
    CHECK_FALSE(std::isfinite(alarm.margin));
}

TEST_CASE("a ratio of exactly the energy test's threshold does not falsify", "[unit][energy][REQ-MON-14]") {
    Real largest = Real(0);
    const auto falsified = [&](Real threshold) {
        lpvg_coeff_t coeff = energy_only(0.3);
        coeff.reals.energy_threshold = threshold;
        coeff.words.crc32 = lpvg_coeff_crc32(&coeff);
        Drive drive(coeff);
        drive.gain = 0.5;
        for (uint32_t k = 0; k < words().energy_settle + 6U * memory(); ++k) {
            drive.run(1U);
            largest = std::max(largest, drive.monitor.energy.ratio);
        }
        return drive.monitor.has_falsified;
    };
    (void)falsified(Real(1e9));
    const Real seen = largest;
    REQUIRE(seen > Real(1));
    CHECK_FALSE(falsified(seen));
    CHECK(falsified(std::nextafter(seen, Real(1))));
}

TEST_CASE("the energy test refutes the certificate above its ratio, and says so once", "[unit][energy][REQ-MON-14][REQ-MON-20]") {
    const auto largest_of = [](lpvg_coeff_t coeff) {
        Drive drive(coeff);
        drive.gain = 0.5;
        Real largest = Real(0);
        for (uint32_t k = 0; k < words().energy_settle + 20U * memory(); ++k) {
            drive.run(1U);
            largest = std::max(largest, drive.monitor.energy.ratio);
        }
        return largest;
    };
    lpvg_coeff_t coeff = energy_only(0.3);
    const Real seen = largest_of(coeff);
    const bool refuted = GENERATE(false, true);
    coeff.reals.energy_certificate = refuted ? Real(0.5) * (Real(1) + seen) : seen;
    coeff.words.crc32 = lpvg_coeff_crc32(&coeff);
    Drive drive(coeff);
    drive.gain = 0.5;
    std::vector<lpvg_frame_t> records;
    for (uint32_t k = 0; k < words().energy_settle + 20U * memory(); ++k) {
        drive.run(1U);
        lpvg_frame_t record{};
        if (lpvg_monitor_take_record(&drive.monitor, &record)) {
            records.push_back(record);
        }
    }
    CHECK(drive.verdict() == (refuted ? lpvg_verdict_invalid : lpvg_verdict_degraded));
    CHECK(drive.monitor.has_falsified == refuted);
    const auto of = [&](bool which) {
        return std::count_if(records.begin(), records.end(), [&](const auto& r) { return r.refuted == which; });
    };
    CHECK(of(false) == 1);
    CHECK(of(true) == (refuted ? 1 : 0));
}

TEST_CASE("the energy test alarms anew after as many quiet judgements as are stated, and not before", "[unit][energy][REQ-MON-14]") {
    const uint32_t rearm = 7U, quiet = GENERATE(6U, 7U);
    lpvg_coeff_t loud = energy_only(0.3);
    loud.words.energy_rearm = rearm;
    loud.words.crc32 = lpvg_coeff_crc32(&loud);
    lpvg_coeff_t still = loud;
    still.reals.energy_threshold = Real(1e9);
    Drive drive(loud);
    drive.gain = 0.5;
    // Well above in every direction.
    drive.run(words().energy_settle + 6U * memory());
    REQUIRE(drive.verdict() == lpvg_verdict_invalid);
    const auto judged = [&] {
        do {
            drive.monitor.energy.ratio = Real(-1);
            drive.run(1U);
        } while (drive.monitor.energy.ratio < Real(0));
        return drive.monitor.energy.ratio;
    };
    REQUIRE(judged() > Real(1.001));
    drive.monitor.n_records = 0U;
    drive.monitor.coeff = &still;
    for (uint32_t k = 0; k < quiet; ++k) {
        CHECK(judged() > Real(1.001));
    }
    CHECK(drive.monitor.energy_quiet == quiet);
    drive.monitor.coeff = &loud;
    CHECK(judged() > Real(1.001));
    CHECK(drive.monitor.n_records == (quiet == rearm ? 1U : 0U));
}

TEST_CASE("anew means that the settling time runs again", "[unit][energy][REQ-MON-15]") {
    Drive drive;
    const auto begun = [&] {
        return std::any_of(std::begin(drive.monitor.energy.band), std::end(drive.monitor.energy.band),
                           [](const lpvg_energy_band_t& band) { return band.nominal[0] > Real(0); });
    };
    drive.run(words().energy_settle + 10U);
    REQUIRE(begun());
    auto& left = drive.monitor.energy.band[0].left;
    std::fill(std::begin(left), std::end(left), std::numeric_limits<Real>::infinity());
    while (!drive.monitor.has_falsified) {
        drive.run(1U);
    }
    CHECK(drive.monitor.t_falsified_us == drive.now());
    CHECK_FALSE(begun());
    drive.run(words().energy_settle);
    CHECK_FALSE(begun());
    drive.run(1U);
    CHECK(begun());
}
