// The closed-form margin against a slow minimisation that shares nothing with it.
#include "../catch.hpp"

#include <algorithm>
#include <cmath>
#include <complex>
#include <limits>
#include <random>
#include <vector>

#include "margin.hpp"

namespace {

struct Problem {
    std::vector<std::complex<double>> E, Z;
    double W;
    std::vector<double> B;
};

double worst_term(const Problem& p, std::complex<double> d) {
    double worst = std::abs(d) / p.W;
    for (std::size_t j = 0; j < p.E.size(); ++j) {
        worst = std::max(worst, std::abs(p.E[j] - d * p.Z[j]) / p.B[j]);
    }
    return worst;
}

template <class F>
double least(double low, double high, const F& f) {
    const double golden = 0.6180339887498949;
    double a = high - golden * (high - low), b = low + golden * (high - low);
    double fa = f(a), fb = f(b);
    for (int i = 0; i < 70; ++i) {
        if (fa < fb) {
            high = b, b = a, fb = fa;
            fa = f(a = high - golden * (high - low));
        } else {
            low = a, a = b, fa = fb;
            fb = f(b = low + golden * (high - low));
        }
    }
    return std::min(fa, fb);
}

// The maximum is convex in d, so is its minimum over the imaginary part: two nested one-dimensional searches. No d larger
// than W t(0) can do better than d = 0.
double reference(const Problem& p) {
    const double size = p.W * worst_term(p, 0.0);
    return least(-size, size, [&](double re) {
        return least(-size, size, [&](double im) { return worst_term(p, {re, im}); });
    });
}

template <class Real, std::size_t NY>
double margin(const Problem& p) {
    lpvg::Complex2<Real> E[NY], Z[NY];
    Real B[NY];
    for (std::size_t j = 0; j < NY; ++j) {
        E[j] = {static_cast<Real>(p.E[j].real()), static_cast<Real>(p.E[j].imag())};
        Z[j] = {static_cast<Real>(p.Z[j].real()), static_cast<Real>(p.Z[j].imag())};
        B[j] = static_cast<Real>(p.B[j]);
    }
    return static_cast<double>(lpvg::Margin<Real, NY>(E, Z, static_cast<Real>(p.W), B)());
}

template <class Real>
double margin(const Problem& p) {
    switch (p.E.size()) {
        case 1: return margin<Real, 1>(p);
        case 2: return margin<Real, 2>(p);
        case 3: return margin<Real, 3>(p);
        default: return margin<Real, 4>(p);
    }
}

class Random {
public:
    explicit Random(unsigned seed) : engine_(seed) {}
    double uniform() { return static_cast<double>(engine_()) / 4294967296.0; }
    double log_uniform(double low, double high) { return low * std::pow(high / low, uniform()); }
    // Exact in float, so that float and double solve the same problem.
    std::complex<double> complex(double size) {
        const double angle = 6.283185307179586 * uniform();
        return {static_cast<double>(static_cast<float>(size * std::cos(angle))),
                static_cast<double>(static_cast<float>(size * std::sin(angle)))};
    }

private:
    std::mt19937 engine_;
};

Problem random_problem(Random& random, std::size_t n_y) {
    Problem p;
    p.W = static_cast<double>(static_cast<float>(random.log_uniform(0.05, 2.0)));
    for (std::size_t j = 0; j < n_y; ++j) {
        p.E.push_back(random.complex(random.log_uniform(1e-3, 1.0)));
        p.Z.push_back(random.complex(random.log_uniform(1e-3, 10.0)));
        p.B.push_back(static_cast<double>(static_cast<float>(random.log_uniform(1e-3, 1.0))));
    }
    return p;
}

// Largest excess and shortfall, as parts of the margin at d = 0: where the disturbance bounds are far tighter than the
// uncertainty's reach, E - d Z cancels and no more than that can be asked of the number type.
struct Error {
    double above = 0.0, below = 0.0;
    void add(const Problem& p, double got, double want) {
        const double size = worst_term(p, 0.0);
        above = std::max(above, (got - want) / size);
        below = std::max(below, (want - got) / size);
    }
};

constexpr double float_above = 5e-5, float_below = 1e-6;  // as margin.hpp states

void check_against_reference(const std::vector<Problem>& problems) {
    Error in_float, in_double;
    for (const Problem& p : problems) {
        const double want = reference(p);
        in_float.add(p, margin<float>(p), want);
        in_double.add(p, margin<double>(p), want);
    }
    CAPTURE(in_float.above, in_float.below, in_double.above, in_double.below);
    CHECK(in_double.above <= 1e-10);
    CHECK(in_double.below <= 1e-10);  // of which the searches of the reference leave the most
    CHECK(in_float.above <= float_above);
    CHECK(in_float.below <= float_below);
}

}  // namespace

TEST_CASE("the margin is the minimum, for 1 to 4 outputs", "[unit][margin][REQ-MON-3]") {
    const auto n_y = GENERATE(std::size_t{1}, std::size_t{2}, std::size_t{3}, std::size_t{4});
    Random random(17U + static_cast<unsigned>(n_y));
    std::vector<Problem> problems;
    for (int i = 0; i < 150; ++i) {
        problems.push_back(random_problem(random, n_y));
    }
    CAPTURE(n_y);
    check_against_reference(problems);
}

TEST_CASE("one output: |E| / (B + W |Z|), and |E| / B where Z = 0", "[unit][margin][REQ-MON-3]") {
    Random random(3U);
    for (int i = 0; i < 200; ++i) {
        Problem p = random_problem(random, 1U);
        const double want = std::abs(p.E[0]) / (p.B[0] + p.W * std::abs(p.Z[0]));
        CHECK(std::fabs(margin<double>(p) - want) <= 1e-15 * worst_term(p, 0.0));
        p.Z[0] = 0.0;
        CHECK(margin<double>(p) == Approx(std::abs(p.E[0]) / p.B[0]).epsilon(1e-14));
    }
}

TEST_CASE("outputs with Z = 0 bound from below and add no candidate", "[unit][margin][REQ-MON-3]") {
    const auto n_y = GENERATE(std::size_t{2}, std::size_t{3}, std::size_t{4});
    Random random(5U);
    std::vector<Problem> problems;
    for (int i = 0; i < 40; ++i) {
        Problem p = random_problem(random, n_y);
        p.Z[static_cast<std::size_t>(i) % n_y] = 0.0;
        problems.push_back(p);
    }
    check_against_reference(problems);
    Problem silent = random_problem(random, n_y);
    std::fill(silent.E.begin(), silent.E.end(), 0.0);
    CHECK(margin<float>(silent) == 0.0);
    std::fill(silent.Z.begin(), silent.Z.end(), 0.0);
    CHECK(margin<float>(silent) == 0.0);
}

TEST_CASE("collinear and coinciding centres, equal radii", "[unit][margin][REQ-MON-3]") {
    Random random(7U);
    std::vector<Problem> problems;
    for (int i = 0; i < 40; ++i) {
        Problem p = random_problem(random, 3U);
        const std::complex<double> direction = random.complex(1.0);
        for (std::size_t j = 0; j < 3U; ++j) {
            p.Z[j] = 1.0 + static_cast<double>(j);
            p.E[j] = p.Z[j] * direction * (i % 4 == 0 ? 1.0 : 0.25 * static_cast<double>(j) - 0.25);  // in line, or all at one
            if (i % 2 == 0) {
                p.B[j] = p.Z[j].real() * p.W;  // every radius is that of |d|
            }
        }
        problems.push_back(p);
    }
    for (const double spread : {1e-3, 1e-6}) {  // close to in line: the quadratic's determinant nearly vanishes
        for (int i = 0; i < 10; ++i) {
            Problem p = problems[static_cast<std::size_t>(4 * i + 1)];
            p.E[1] += spread * random.complex(1.0);
            problems.push_back(p);
        }
    }
    check_against_reference(problems);
}

TEST_CASE("units of the outputs are free from 1e-30 to 1e30", "[unit][margin][REQ-MON-3]") {
    Random random(11U);
    for (int i = 0; i < 100; ++i) {
        const Problem p = random_problem(random, 3U);
        for (const int exponent : {-99, -40, 40, 99}) {
            Problem scaled = p;
            for (std::size_t j = 0; j < 3U; ++j) {
                const double unit = std::ldexp(1.0, j == 1U ? -exponent : exponent);
                scaled.E[j] *= unit, scaled.Z[j] *= unit, scaled.B[j] *= unit;
            }
            CHECK(margin<float>(scaled) == margin<float>(p));
        }
    }
}

TEST_CASE("|E| / B and W |Z| / B may reach the stated range", "[unit][margin]") {
    Random random(13U);
    Error error;
    for (int i = 0; i < 100; ++i) {
        const Problem p = random_problem(random, 3U);
        const double want = margin<double>(p);
        for (const double scale : {1e-6, 1e-3, 1e3, 1e6}) {
            // Margin and d grow with E; d shrinks as Z grows, W with it.
            Problem large = p, steep = p;
            for (std::size_t j = 0; j < 3U; ++j) {
                large.E[j] *= scale;
                steep.Z[j] *= scale;
            }
            steep.W /= scale;
            error.add(p, margin<float>(large) / scale, want);
            error.add(p, margin<float>(steep), want);
        }
    }
    CAPTURE(error.above, error.below);
    CHECK(error.above <= float_above);
    CHECK(error.below <= float_below);
}

TEST_CASE("beyond the range the margin errs high only", "[unit][margin][REQ-MON-4]") {
    Random random(19U);
    Error error;
    std::size_t not_a_number = 0;
    for (int i = 0; i < 2000; ++i) {
        Problem p;
        p.W = random.log_uniform(1e-30, 1e30);
        for (std::size_t j = 0; j < 2U; ++j) {
            p.E.push_back(random.complex(random.log_uniform(1e-30, 1e30)));
            p.Z.push_back(random.complex(random.log_uniform(1e-30, 1e30)));
            p.B.push_back(random.log_uniform(1e-30, 1e30));
        }
        const double got = margin<float>(p), want = margin<double>(p);
        not_a_number += std::isnan(got) ? 1U : 0U;
        if (worst_term(p, 0.0) > 1e-18) {  // smaller ones vanish when squared in float
            error.add(p, got, want);
        }
    }
    CAPTURE(error.below);
    CHECK(not_a_number == 0U);
    CHECK(error.below <= float_below);
}

TEST_CASE("a nominal output that fades out cannot hide an error", "[unit][margin][REQ-MON-4]") {
    for (double size = 1e-5; size > 1e-45; size *= 0.1) {
        CAPTURE(size);
        const Problem p{{{0.3, 0.4}, {0.1, 0.0}}, {size, {0.0, size}}, 0.3, {0.01, 0.02}};
        CHECK(margin<float>(p) == Approx(50.0).epsilon(1e-3));
    }
}

TEST_CASE("a frame that is not finite falsifies", "[unit][margin][REQ-MON-4]") {
    const double bad = GENERATE(std::numeric_limits<double>::quiet_NaN(), std::numeric_limits<double>::infinity());
    CHECK(std::isinf(margin<float>({{bad, 0.0}, {1.0, 1.0}, 0.3, {0.1, 0.1}})));
    CHECK(std::isinf(margin<float>({{0.0, 1.0}, {1.0, bad}, 0.3, {0.1, 0.1}})));
}
