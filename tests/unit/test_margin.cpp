// The closed-form margin against a long double search that certifies itself: every reference is an interval.
#ifndef _GLIBCXX_ASSERTIONS
#define _GLIBCXX_ASSERTIONS  // an index beyond an array ends the program
#endif
#include "../catch.hpp"
#include "../long_form.hpp"

#include <algorithm>
#include <cmath>
#include <complex>
#include <cstdlib>
#include <limits>
#include <random>
#include <vector>

#include "at_the_end.hpp"
#include "monitor/margin.hpp"

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

using Long = long double;

struct Interval {
    Long low, high;  // a lower bound of the margin by duality; what some d attains
};

// Pairs of terms, then Newton steps on three equal terms. Whatever it does, `high` is attained, and
// `low` holds: no d makes a weighted mean of the squared terms smaller than its closed-form minimum.
class Reference {
public:
    explicit Reference(const Problem& p) : n_(p.E.size() + 1U) {
        for (std::size_t j = 0; j + 1U < n_; ++j) {
            const Long unit = Long(1) / p.B[j];
            e_.push_back({unit * p.E[j].real(), unit * p.E[j].imag()});
            z_.push_back({unit * p.W * p.Z[j].real(), unit * p.W * p.Z[j].imag()});
        }
        e_.push_back({0, 0});
        z_.push_back({1, 0});
        try_point({0, 0});
        for (std::size_t i = 0; i < n_; ++i) {
            bound({{i, Long(1)}}, {0, 0});
            for (std::size_t j = i + 1U; j < n_; ++j) {
                pair(i, j);
            }
        }
        for (std::size_t i = 0; i < n_ && open(); ++i) {
            for (std::size_t j = i + 1U; j < n_ && open(); ++j) {
                for (std::size_t k = j + 1U; k < n_ && open(); ++k) {
                    for (const bool farther : {false, true}) {
                        newton(i, j, k, best_, farther);
                        newton(i, j, k, {0, 0}, farther);
                        newton(i, j, k, {best_.re / 2, best_.im / 2}, farther);
                    }
                }
            }
        }
    }

    Interval operator()() const { return {std::sqrt(low_), std::sqrt(high_)}; }

private:
    using C = lpvg::Complex2<Long>;
    struct Weight {
        std::size_t term;
        Long size;
    };

    std::size_t n_;
    std::vector<C> e_, z_;
    Long low_ = 0, high_ = std::numeric_limits<Long>::infinity();
    C best_{0, 0};

    bool open() const { return high_ > low_ * (1 + Long(1e-15)); }
    C rest(std::size_t m, C d) const { return e_[m] - d * z_[m]; }

    void try_point(C d) {
        Long worst = 0;
        for (std::size_t m = 0; m < n_; ++m) {
            worst = std::max(worst, lpvg::squared(rest(m, d)));
        }
        if (worst < high_) {
            high_ = worst, best_ = d;
        }
    }

    // The minimum over d of sum w |e - d z|^2 / sum w, by completing the square around d.
    void bound(const std::vector<Weight>& weights, C d) {
        Long total = 0, value = 0, curvature = 0;
        C slope{0, 0};
        for (const Weight& w : weights) {
            total += w.size;
            value += w.size * lpvg::squared(rest(w.term, d));
            curvature += w.size * lpvg::squared(z_[w.term]);
            slope = slope + w.size * (lpvg::conj(z_[w.term]) * rest(w.term, d));
        }
        if (total > 0) {
            value -= curvature > 0 ? lpvg::squared(slope) / curvature : 0;
            low_ = std::max(low_, value / total);
        }
    }

    void pair(std::size_t i, std::size_t j) {
        const Long a = std::hypot(z_[i].re, z_[i].im), b = std::hypot(z_[j].re, z_[j].im);
        if (a + b > 0) {
            const C from_i = (a > 0 ? 1 / a : 0) * (e_[i] * lpvg::conj(z_[i]));
            const C from_j = (b > 0 ? 1 / b : 0) * (e_[j] * lpvg::conj(z_[j]));
            const C d = (1 / (a + b)) * (from_i + from_j);
            try_point(d);
            bound({{i, b}, {j, a}}, d);
        }
    }

    void newton(std::size_t i, std::size_t j, std::size_t k, C d, bool farther) {
        for (int step = 0; step < 6 && open(); ++step) {
            const C gi = lpvg::conj(z_[i]) * rest(i, d), gj = lpvg::conj(z_[j]) * rest(j, d), gk = lpvg::conj(z_[k]) * rest(k, d);
            const C a = gj - gi, b = gk - gi;
            const Long fi = lpvg::squared(rest(i, d)), fj = lpvg::squared(rest(j, d)) - fi, fk = lpvg::squared(rest(k, d)) - fi;
            const Long si = lpvg::squared(z_[i]), sj = lpvg::squared(z_[j]) - si, sk = lpvg::squared(z_[k]) - si;
            const Long det = 2 * lpvg::cross(a, b);
            if (!(std::fabs(det) > 0)) {
                return;
            }
            const C p{(fj * b.im - fk * a.im) / det, (fk * a.re - fj * b.re) / det};
            const C q{(sj * b.im - sk * a.im) / det, (sk * a.re - sj * b.re) / det};
            const Long half = Long(0.5) - (p.re * q.re + p.im * q.im);
            const Long root = std::sqrt(std::max(Long(0), half * half - lpvg::squared(p) * lpvg::squared(q)));
            const bool far = farther && step == 0;
            const Long top = far ? half + root : lpvg::squared(p), bottom = far ? lpvg::squared(q) : half + root;
            if (!(bottom > 0)) {
                return;
            }
            d = d + p + (top / bottom) * q;
            try_point(d);
            // Weights with which the gradients at d vanish, if they have one sign.
            const C hi = lpvg::conj(z_[i]) * rest(i, d), hj = lpvg::conj(z_[j]) * rest(j, d), hk = lpvg::conj(z_[k]) * rest(k, d);
            const Long wi = lpvg::cross(hj, hk), wj = lpvg::cross(hk, hi), wk = lpvg::cross(hi, hj);
            if (std::min({wi, wj, wk}) >= 0 || std::max({wi, wj, wk}) <= 0) {
                bound({{i, std::fabs(wi)}, {j, std::fabs(wj)}, {k, std::fabs(wk)}}, d);
            }
        }
    }
};

double reference(const Problem& p) { return static_cast<double>(Reference(p)().high); }

struct Answer {
    double margin, dead;
};

template <class Real, std::size_t NY>
Answer answer(const Problem& p) {
    lpvg::Complex2<Real> E[NY], Z[NY];
    Real B[NY];
    for (std::size_t j = 0; j < NY; ++j) {
        E[j] = {static_cast<Real>(p.E[j].real()), static_cast<Real>(p.E[j].imag())};
        Z[j] = {static_cast<Real>(p.Z[j].real()), static_cast<Real>(p.Z[j].imag())};
        B[j] = static_cast<Real>(p.B[j]);
    }
    const auto W = static_cast<Real>(p.W);
    lpvg::CommonMargin<Real, NY> of(E, Z, &W, B);
    const auto dead = static_cast<double>(of.dead());
    return {static_cast<double>(of()), dead};
}

template <class Real>
Answer answer(const Problem& p) {
    switch (p.E.size()) {
        case 1: return answer<Real, 1>(p);
        case 2: return answer<Real, 2>(p);
        case 3: return answer<Real, 3>(p);
        default: return answer<Real, 4>(p);
    }
}

template <class Real>
double margin(const Problem& p) {
    return answer<Real>(p).margin;
}
template <class Real>
double dead(const Problem& p) {
    return answer<Real>(p).dead;
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

// Problems of every kind: sizes over many decades, outputs that agree, nearly in line, with equal radii, fading out.
Problem hard_problem(Random& random, std::size_t n_y) {
    const auto single = [](double x) { return static_cast<double>(static_cast<float>(x)); };
    const int kind = static_cast<int>(8.0 * random.uniform());
    Problem p;
    p.W = single(random.log_uniform(0.02, 3.0));
    const std::complex<double> common = random.complex(p.W * random.log_uniform(0.1, 3.0));
    const double spread = random.log_uniform(1e-7, 1.0);
    for (std::size_t j = 0; j < n_y; ++j) {
        const double B = single(kind == 1 ? 1.0 : random.log_uniform(kind == 0 ? 1e-3 : 0.2, 1.0));
        const double reach[] = {0.1, 10.0, 1e-5, 20.0, 1e-3, 2e4};  // W |Z| / B, by kind
        const std::size_t row = kind == 2 ? 2U : (kind == 3 ? 4U : 0U);
        std::complex<double> E = random.complex(B * random.log_uniform(0.3, 3.0));
        std::complex<double> Z = random.complex(B / p.W * random.log_uniform(reach[row], reach[row + 1U]));
        switch (kind) {
            case 0: E = random.complex(random.log_uniform(1e-3, 1.0)), Z = random.complex(random.log_uniform(1e-3, 10.0)); break;
            case 1: E = random.complex(random.log_uniform(1e-9, 1e9)), Z = random.complex(random.log_uniform(1e-9, 1.0)); break;
            case 4: E = Z * common + random.complex(B * random.log_uniform(1e-6, 1.0)); break;
            case 5: E = Z * common * (random.uniform() < 0.5 ? -0.5 : 2.0) * std::polar(1.0, spread * random.uniform()); break;
            case 6: Z *= B / p.W * (1.0 + spread * random.uniform()) / std::abs(Z); break;
            case 7:
                E *= random.uniform() < 0.3 ? random.log_uniform(1e-12, 1.0) : (random.uniform() < 0.1 ? 0.0 : 1.0);
                Z *= random.uniform() < 0.3 ? random.log_uniform(1e-12, 1.0) : (random.uniform() < 0.1 ? 0.0 : 1.0);
                break;
            default: break;
        }
        p.E.push_back({single(E.real()), single(E.imag())});
        p.Z.push_back({single(Z.real()), single(Z.imag())});
        p.B.push_back(B);
    }
    return p;
}

// Largest excess and shortfall, as parts of the margin at d = 0: where the disturbance bounds are far tighter than the
// uncertainty's reach, E - d Z cancels and no more than that can be asked of the number type.
struct Error {
    double above = -std::numeric_limits<double>::infinity(), below = above;
    void add(const Problem& p, double got, double want) {
        const double size = worst_term(p, 0.0);
        if (size > 0.0) {
            above = std::max(above, (got - want) / size);
            below = std::max(below, (want - got) / size);
        }
    }
};

constexpr double float_below = 1.1e-6;  // as margin.hpp states; above: nothing, but where subnormal numbers are zero
constexpr double flushed_above = 1e-6;
constexpr double separate_below = 1.1e-6;  // of the margin itself, with a Delta an output

void check_against_reference(const std::vector<Problem>& problems) {
    Error in_float, in_double;
    for (const Problem& p : problems) {
        const double want = reference(p);
        in_float.add(p, margin<float>(p), want);
        in_double.add(p, margin<double>(p), want);
    }
    CAPTURE(in_float.above, in_float.below, in_double.above, in_double.below);
    CHECK(in_double.above <= 0.0);
    CHECK(in_double.below <= 2e-15);
    CHECK(in_float.above <= 0.0);
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

// 10^5 problems a size; with LPVGUARD_FULL=1 10^6.
TEST_CASE("float never exceeds the margin and comes within 1.1e-6 of it", "[unit][margin][many][REQ-MON-3]") {
    const auto n_y = GENERATE(std::size_t{1}, std::size_t{2}, std::size_t{3}, std::size_t{4});
    const int count = long_form() ? 1000000 : 100000;
    Random random(29U + static_cast<unsigned>(n_y));
    Error error;
    Long widest = 0;
    for (int i = 0; i < count; ++i) {
        const Problem p = hard_problem(random, n_y);
        const Interval want = Reference(p)();
        widest = std::max(widest, (want.high - want.low) / std::max(Long(1e-300), Long(worst_term(p, 0.0))));
        error.add(p, margin<float>(p), static_cast<double>(want.high));
    }
    CAPTURE(n_y, error.above, error.below, widest);
    CHECK(widest <= Long(1e-9));  // the reference is certain
    CHECK(error.above <= (std::getenv("LPVGUARD_FLUSH_TO_ZERO") == nullptr ? 0.0 : flushed_above));
    CHECK(error.below <= float_below);
}

TEST_CASE("a small Z beside a large one", "[unit][margin][REQ-MON-3]") {
    const Problem p{{{-0.0697, -0.0337}, {0.1437, -0.1258}}, {{0.0050, -0.0002}, {-0.8243, 0.2694}}, 0.264, {0.0743, 0.1476}};
    CHECK(reference(p) == Approx(1.02444).epsilon(1e-3));  // the data were rounded to four decimals
    CHECK(margin<float>(p) == Approx(reference(p)).epsilon(2e-6));
    CHECK(margin<float>(p) <= reference(p));
}

TEST_CASE("a frame whose first solution of three equal terms is poor still has its margin", "[unit][margin][REQ-MON-3]") {
    // Gradients nearly in line, of which one solution more keeps too few digits; a discriminant in which the two solutions' distance
    // comes from the cross product alone; one that rounding makes negative.
    const Problem frames[] = {
        {{{0.0257239901, -0.187044784}, {0.131143019, 0.689893484}},
         {{-5.12327211e-05, -1.57941473e-05}, {-4.42958721e-06, 2.57700975e-06}},
         2.00756168,
         {0.217837736, 0.810476661}},
        {{{0.0319802649, 0.190391123}, {0.0359129608, 0.05999602}, {0.00803558528, 0.0287942905}, {0.178581282, -0.0797409341}},
         {{0.0631776648, -0.0716893792}, {0.01811986, 0.0173274423}, {-0.0507516285, -0.0167199489}, {-0.673588826, 1.19340569}},
         0.421059072,
         {0.188263133, 0.183305144, 0.0221000612, 0.00514105335}},
        {{{0.000468305137, -0.00124154461}, {0.0109866513, -0.00717151817}, {0.462720841, 0.0388351753}},
         {{6.47269301, -3.63465363}, {-0.276815293, -0.019565642}, {-0.455851279, -3.9109583}},
         1.73680568,
         {0.593844652, 0.0165322181, 0.00246922136}},
    };
    for (Problem p : frames) {
        const auto single = [](std::complex<double> x) { return std::complex<double>(std::complex<float>(x)); };
        std::transform(p.E.begin(), p.E.end(), p.E.begin(), single);
        std::transform(p.Z.begin(), p.Z.end(), p.Z.begin(), single);
        std::transform(p.B.begin(), p.B.end(), p.B.begin(), [](double x) { return static_cast<double>(static_cast<float>(x)); });
        p.W = static_cast<double>(static_cast<float>(p.W));
        check_against_reference({p});
    }
}

TEST_CASE("one output: |E| / (B + W |Z|), and |E| / B where Z = 0", "[unit][margin][REQ-MON-3]") {
    Random random(3U);
    for (int i = 0; i < 200; ++i) {
        Problem p = random_problem(random, 1U);
        const double want = std::abs(p.E[0]) / (p.B[0] + p.W * std::abs(p.Z[0]));
        CHECK(std::fabs(margin<double>(p) - want) <= 2e-15 * worst_term(p, 0.0));
        p.Z[0] = 0.0;
        CHECK(margin<double>(p) == Approx(std::abs(p.E[0]) / p.B[0]).epsilon(1e-14));
    }
}

namespace {

// Every output with a Delta of its own: the margin in long double, of the frame as the number type has it, and what the core
// says of it.
template <class Real, std::size_t NY>
void check_separate(unsigned seed, int count, double below) {
    Random random(seed);
    double above = -std::numeric_limits<double>::infinity(), least = 0.0, dead = 0.0;
    for (int i = 0; i < count; ++i) {
        lpvg::Complex2<Real> E[NY], Z[NY];
        Real W[NY], B[NY];
        Long want = 0, gone = 0;
        for (std::size_t j = 0; j < NY; ++j) {
            const Problem p = hard_problem(random, 1U);
            E[j] = {static_cast<Real>(p.E[0].real()), static_cast<Real>(p.E[0].imag())};
            Z[j] = {static_cast<Real>(p.Z[0].real()), static_cast<Real>(p.Z[0].imag())};
            W[j] = static_cast<Real>(p.W);
            B[j] = static_cast<Real>(p.B[0]);
            const Long e = std::hypot(Long(E[j].re), Long(E[j].im)), z = std::hypot(Long(Z[j].re), Long(Z[j].im));
            want = std::max(want, e / (Long(B[j]) + Long(W[j]) * z));
            gone = std::max(gone, z / (Long(B[j]) + Long(W[j]) * z));
        }
        const lpvg::Margin<Real, NY, NY> margin(E, Z, W, B);
        if (want > 0) {
            const Long got = margin();
            above = std::max(above, static_cast<double>((got - want) / want));
            least = std::max(least, static_cast<double>((want - got) / want));
        }
        dead = std::max(dead, std::fabs(static_cast<double>((Long(margin.dead()) - gone) / std::max(gone, Long(1e-300)))));
    }
    CAPTURE(NY, above, least, dead);
    CHECK(above <= 0.0);
    CHECK(least <= below);
    CHECK(dead <= below);
}

void check_every_size_separate(unsigned seed, int frames) {
    check_separate<float, 1>(seed, frames, separate_below);
    check_separate<float, 2>(seed + 1U, frames, separate_below);
    check_separate<float, 3>(seed + 2U, frames, separate_below);
    check_separate<float, 4>(seed + 3U, frames, separate_below);
    check_separate<double, 2>(seed + 4U, frames / 10, 4e-15);
}

}  // namespace

TEST_CASE("with a Delta an output the margin is the worst output's, never above it", "[unit][margin][REQ-MON-3]") {
    check_every_size_separate(51U, 10000);
}

TEST_CASE("with a Delta an output the margin of 10^6 frames is the worst output's", "[unit][margin][many][REQ-MON-3]") {
    check_every_size_separate(41U, 1000000);
}

TEST_CASE("with a Delta an output nothing is lost of a frame beyond the range or not finite", "[unit][margin][REQ-MON-4]") {
    using C = lpvg::Complex2<float>;
    const float W[2] = {0.3F, 0.2F}, B[2] = {0.1F, 0.2F};
    const auto t = [&](C e, C z) {
        const C E[2] = {{0.1F, 0.0F}, e}, Z[2] = {{1.0F, 0.0F}, z};
        return lpvg::Margin<float, 2, 2>(E, Z, W, B)();
    };
    CHECK(t({0.3F, 0.4F}, {0.0F, 0.0F}) == Approx(2.5).epsilon(2e-6));
    CHECK(t({0.0F, 0.0F}, {1.0F, 0.0F}) == Approx(0.25).epsilon(2e-6));  // the other output's
    for (const float bad : {std::numeric_limits<float>::quiet_NaN(), std::numeric_limits<float>::infinity(), 1e30F}) {
        CHECK(std::isinf(t({bad, 0.0F}, {1.0F, 0.0F})));
        CHECK(std::isinf(t({1.0F, 0.0F}, {0.0F, bad})));
    }
}

TEST_CASE("with a Delta an output two numbers beyond the range do not cancel to a small one", "[unit][margin][REQ-MON-4]") {
    using C = lpvg::Complex2<float>;
    const float W = 0.3F, B = 0.1F;
    const C huge{1e30F, 0.0F};
    const float t = lpvg::Margin<float, 1, 1>(&huge, &huge, &W, &B)();
    CHECK(t == std::numeric_limits<float>::infinity());
}

TEST_CASE("the evidence is the margin of a vehicle that does not respond", "[unit][margin][REQ-MON-3]") {
    const auto n_y = GENERATE(std::size_t{1}, std::size_t{2}, std::size_t{3}, std::size_t{4});
    Random random(31U);
    for (int i = 0; i < 200; ++i) {
        Problem p = random_problem(random, n_y);
        for (std::size_t j = 0; j < n_y; ++j) {
            p.E[j] = -p.Z[j];
        }
        CHECK(dead<double>(p) == Approx(reference(p)).epsilon(1e-12));
        CHECK(dead<float>(p) == Approx(reference(p)).epsilon(1e-6));
        std::fill(p.Z.begin(), p.Z.end(), 0.0);
        CHECK(dead<float>(p) == 0.0);
    }
}

TEST_CASE("where candidates overflow the margin is still no more than that of d = 0", "[unit][margin][REQ-MON-4]") {
    const auto n_y = GENERATE(std::size_t{1}, std::size_t{2}, std::size_t{3}, std::size_t{4});
    Random random(37U);
    Problem p = random_problem(random, n_y);
    for (std::complex<double>& z : p.Z) {
        z *= 1e30;
    }
    CHECK(margin<float>(p) <= worst_term(p, 0.0) * (1.0 + 1e-6));
    // Where E conj(Z) overflows too, d = 0 is all that is left.
    const Problem last{std::vector<std::complex<double>>(n_y, 1e9), std::vector<std::complex<double>>(n_y, 1e35), 1.0,
                       std::vector<double>(n_y, 1.0)};
    CHECK(margin<float>(last) == Approx(1e9).epsilon(1e-6));
}

TEST_CASE("a margin that rounding swallows is zero, never below", "[unit][margin][REQ-MON-3]") {
    Random random(39U);
    for (int i = 0; i < 50; ++i) {
        const std::complex<double> Z = random.complex(1e9);
        CHECK(margin<float>({{Z * 1e-9}, {Z}, 1.0, {1.0}}) == 0.0);
    }
}

#if defined(__linux__)
namespace {

template <std::size_t NY, std::size_t ND>
void check_reads() {
    using C = lpvg::Complex2<float>;
    const AtTheEnd<C> E(std::vector<C>(NY, C{0.3F, 0.4F})), Z(std::vector<C>(NY, C{1.0F, 0.0F}));
    const AtTheEnd<float> W(std::vector<float>(ND, 0.2F)), B(std::vector<float>(NY, 0.05F));
    lpvg::Margin<float, NY, ND> margin(E.get(), Z.get(), W.get(), B.get());
    CHECK(margin() == Approx(2.0).epsilon(1e-5));
}

}  // namespace

TEST_CASE("nothing is read behind a frame", "[unit][margin][REQ-MON-3]") {
    check_reads<1, 1>();
    check_reads<2, 1>();
    check_reads<4, 1>();
    check_reads<2, 2>();
    check_reads<4, 4>();
}
#endif

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
    CHECK(error.above <= 0.0);
    CHECK(error.below <= float_below);
}

TEST_CASE("beyond the range the margin errs high only", "[unit][margin][subnormal][REQ-MON-4]") {
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

TEST_CASE("a margin within the range of float is found though |E| / B squared is not", "[unit][margin][REQ-MON-4]") {
    const lpvg::Complex2<float> E[1] = {{2e19F, 0.0F}}, Z[1] = {{1e3F, 0.0F}};
    const float one = 1.0F;
    const float t = lpvg::CommonMargin<float, 1>(E, Z, &one, &one)();
    CHECK(t >= 2e19F / 1001.0F);
    CHECK(t <= 2.0001e19F / 1001.0F);
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
    const Problem bad_error{{{bad, 0.0}}, {{1.0, 0.0}}, 0.3, {0.1}}, bad_output{{{1.0, 0.0}}, {{bad, 0.0}}, 0.3, {0.1}};
    CHECK(std::isinf(margin<float>(bad_error)));
    CHECK(std::isinf(margin<float>(bad_output)));
}
