// Acceptance of coefficients: every status that coeff.h and status.h document, provoked.
#include "../catch.hpp"

#include <algorithm>
#include <cmath>
#include <cstdint>
#include <cstring>
#include <functional>
#include <iterator>
#include <limits>
#include <string>
#include <type_traits>
#include <vector>

#include "monitor/acceptance.hpp"
#include "lpvguard/monitor.h"

namespace {

using Real = lpvg_real_t;

lpvg_coeff_t sealed(const std::function<void(lpvg_coeff_t&)>& change) {
    lpvg_coeff_t coeff = lpvg_coeff;
    change(coeff);
    coeff.words.crc32 = lpvg_coeff_crc32(&coeff);
    return coeff;
}

// init must say the same as the check, and leave the object as it was.
void check_refused(const lpvg_coeff_t* coeff, lpvg_status_t want) {
    CHECK(lpvg_coeff_check(coeff) == want);
    lpvg_monitor_t monitor, before;
    std::memset(&monitor, 0xA5, sizeof monitor);
    std::memcpy(&before, &monitor, sizeof monitor);
    CHECK(lpvg_monitor_init(&monitor, coeff) == want);
    CHECK(std::memcmp(&monitor, &before, sizeof monitor) == 0);
}

}  // namespace

TEST_CASE("the exported coefficients are accepted", "[unit][coeff]") {
    CHECK(lpvg_coeff_check(&lpvg_coeff) == lpvg_status_ok);
    CHECK(lpvg_coeff_crc32(&lpvg_coeff) == lpvg_coeff.words.crc32);
    lpvg_monitor_t monitor;
    CHECK(lpvg_monitor_init(&monitor, &lpvg_coeff) == lpvg_status_ok);
}

TEST_CASE("NULL is refused", "[unit][coeff][REQ-COEF-5]") {
    check_refused(nullptr, lpvg_status_bad_argument);
    CHECK(lpvg_monitor_init(nullptr, &lpvg_coeff) == lpvg_status_bad_argument);
    CHECK(lpvg_coeff_crc32(nullptr) == 0U);
}

TEST_CASE("foreign, old and erased coefficients are named as such, CRC right or wrong", "[unit][coeff][REQ-COEF-1]") {
    struct Case {
        const char* what;
        lpvg_status_t want;
        std::function<void(lpvg_coeff_t&)> change;
    };
    std::vector<Case> cases = {
        {"erased to 0", lpvg_status_bad_magic, [](lpvg_coeff_t& c) { std::memset(&c, 0x00, sizeof c); }},
        {"erased to 1", lpvg_status_bad_magic, [](lpvg_coeff_t& c) { std::memset(&c, 0xFF, sizeof c); }},
        {"magic", lpvg_status_bad_magic, [](lpvg_coeff_t& c) { ++c.words.magic; }},
        {"schema", lpvg_status_bad_schema, [](lpvg_coeff_t& c) { ++c.words.schema; }},
        {"number type", lpvg_status_bad_size, [](lpvg_coeff_t& c) { c.words.real_bytes = 12U - c.words.real_bytes; }},
        {"estimator", lpvg_status_bad_estimator, [](lpvg_coeff_t& c) { c.words.estimator_id ^= 1U; }},
    };
    for (std::size_t i = 0; i < sizeof lpvg_coeff.words.sizes / sizeof lpvg_coeff.words.sizes[0]; ++i) {
        cases.push_back({"size", lpvg_status_bad_size, [i](lpvg_coeff_t& c) { ++c.words.sizes[i]; }});
    }
    for (const Case& test : cases) {
        CAPTURE(test.what);
        lpvg_coeff_t coeff = lpvg_coeff;
        test.change(coeff);
        check_refused(&coeff, test.want);
        coeff = sealed(test.change);
        check_refused(&coeff, test.want);
    }
}

TEST_CASE("any single flipped bit after the header is a CRC error", "[unit][coeff][REQ-COEF-2]") {
    constexpr std::size_t header = offsetof(lpvg_coeff_words_t, crc32);
    constexpr std::size_t stride = 7;  // coprime to the sizes of words and numbers: every byte place is met
    std::size_t wrong = 0;
    for (std::size_t byte = header; byte < sizeof(lpvg_coeff_t); byte += byte < header + 64U ? 1U : stride) {
        // Padding between words and numbers is no data.
        const bool padding = byte >= sizeof(lpvg_coeff_words_t) && byte < offsetof(lpvg_coeff_t, reals);
        for (unsigned bit = 0; bit < 8U; ++bit) {
            lpvg_coeff_t coeff = lpvg_coeff;
            reinterpret_cast<unsigned char*>(&coeff)[byte] ^= static_cast<unsigned char>(1U << bit);
            wrong += lpvg_coeff_check(&coeff) != (padding ? lpvg_status_ok : lpvg_status_bad_crc) ? 1U : 0U;
        }
    }
    CHECK(wrong == 0U);
}

TEST_CASE("a number that is not finite is refused wherever it stands", "[unit][coeff][REQ-COEF-3]") {
    const Real bad =
        GENERATE(std::numeric_limits<Real>::quiet_NaN(), std::numeric_limits<Real>::infinity(), -std::numeric_limits<Real>::infinity());
    constexpr std::size_t n = sizeof(lpvg_coeff_reals_t) / sizeof(Real);
    std::size_t wrong = 0;
    for (std::size_t i = 0; i < n; ++i) {
        const lpvg_coeff_t coeff =
            sealed([&](lpvg_coeff_t& c) { std::memcpy(reinterpret_cast<unsigned char*>(&c.reals) + i * sizeof bad, &bad, sizeof bad); });
        wrong += lpvg_coeff_check(&coeff) != lpvg_status_not_finite ? 1U : 0U;
    }
    CHECK(wrong == 0U);
}

TEST_CASE("a value that the algorithm does not allow is refused", "[unit][coeff][REQ-COEF-4]") {
    struct Case {
        const char* what;
        std::function<void(lpvg_coeff_t&)> change;
    };
    std::vector<Case> cases = {
        {"sample period 0", [](lpvg_coeff_t& c) { c.words.sample_period_us = 0U; }},
        {"k = 0", [](lpvg_coeff_t& c) { c.words.confirm = 0U; }},
        {"k > m", [](lpvg_coeff_t& c) { c.words.confirm = c.words.of_last + 1U; }},
        {"m > history", [](lpvg_coeff_t& c) { c.words.of_last = LPVG_NHISTORY + 1U; }},
        {"speed_min 0", [](lpvg_coeff_t& c) { c.reals.speed_min = Real(0); }},
        {"speed_min = speed_max", [](lpvg_coeff_t& c) { c.reals.speed_min = c.reals.speed_max; }},
        {"speed tolerance 0", [](lpvg_coeff_t& c) { c.reals.speed_tolerance = Real(0); }},
        {"threshold 0", [](lpvg_coeff_t& c) { c.reals.threshold = Real(0); }},
        {"varying entry", [](lpvg_coeff_t& c) { c.words.varying_entry[LPVG_NVARYING - 1] = LPVG_NENTRIES; }},
        {"a frame longer than DC's", [](lpvg_coeff_t& c) { c.words.frame_length[1] = c.words.frame_length[0] + 2U; }},
        {"cycles beyond 2^31", [](lpvg_coeff_t& c) { c.words.cycles[0] = 0x80000000U; }},
    };
    // The energy test.
    const auto spoilt = [&cases](const char* what, const std::function<void(lpvg_coeff_reals_t&)>& change) {
        cases.push_back({what, [change](lpvg_coeff_t& c) { change(c.reals); }});
    };
    cases.push_back({"judged before the frames", [](lpvg_coeff_t& c) { c.words.energy_settle = c.words.settle_samples - 1U; }});
    cases.push_back({"rearm 0", [](lpvg_coeff_t& c) { c.words.energy_rearm = 0U; }});
    spoilt("energy threshold below 1", [](lpvg_coeff_reals_t& r) { r.energy_threshold = Real(0.999); });
    spoilt("energy certificate below 1", [](lpvg_coeff_reals_t& r) { r.energy_certificate = Real(0.999); });
    for (std::size_t place = 0; place < LPVG_NWEIGHT; ++place) {
        const auto poles = [&](const char* what, Real a1, Real a2) {
            spoilt(what, [=](lpvg_coeff_reals_t& r) {
                r.energy_W[LPVG_NDELTA - 1][place][3] = a1;
                r.energy_W[LPVG_NDELTA - 1][place][4] = a2;
            });
        };
        poles("a pole at z = 1", Real(0.5), Real(0));
        poles("poles on the unit circle", Real(0.5), Real(0.5));
        poles("a pole at z = -1", Real(2.5), Real(1));
    }
    spoilt("a corner at DC", [](lpvg_coeff_reals_t& r) { r.energy_corner[0] = Real(0); });
    spoilt("corners that fall", [](lpvg_coeff_reals_t& r) { r.energy_corner[1] = Real(0.999) * r.energy_corner[0]; });
    spoilt("a corner above Nyquist", [](lpvg_coeff_reals_t& r) { r.energy_corner[LPVG_NBANDS - 2] = Real(1); });
    for (std::size_t b = 0; b < LPVG_NBANDS; ++b) {
        spoilt("no forgetting", [b](lpvg_coeff_reals_t& r) { r.energy_forget[b] = Real(0); });
        spoilt("no memory", [b](lpvg_coeff_reals_t& r) { r.energy_forget[b] = Real(1); });
        for (std::size_t j = 0; j < LPVG_NY; ++j) {
            spoilt("sigma infinite", [b, j](lpvg_coeff_reals_t& r) { r.energy_scale[b][j] = Real(0); });
            spoilt("negative energy", [b, j](lpvg_coeff_reals_t& r) { r.energy_start[b][j] = Real(-1); });
        }
    }
    spoilt("a direction that is none", [](lpvg_coeff_reals_t& r) {
        for (Real& a : r.energy_direction[LPVG_NDIRECTIONS - 1]) {
            a = Real(0);
        }
    });
    if (LPVG_NDELTA > 1) {
        spoilt("a sum of outputs that have no common Delta", [](lpvg_coeff_reals_t& r) {
            for (Real& part : r.energy_direction[0]) {
                part = Real(1) / LPVG_NY;
            }
        });
    }
    if (LPVG_NDELTA > 1) {
        spoilt("hardly a sum of outputs that have no common Delta", [](lpvg_coeff_reals_t& r) {
            std::fill(std::begin(r.energy_direction[0]), std::end(r.energy_direction[0]), Real(0));
            r.energy_direction[0][0] = Real(0.999);
            r.energy_direction[0][LPVG_NY - 1] = Real(0.001);
        });
    }
    spoilt("a direction too short", [](lpvg_coeff_reals_t& r) {
        for (Real& a : r.energy_direction[LPVG_NDIRECTIONS - 1]) {
            a *= Real(0.99);
        }
    });
    spoilt("a direction too long", [](lpvg_coeff_reals_t& r) { r.energy_direction[0][0] = Real(-1.5); });
    if (LPVG_NY > 1) {
        spoilt("a sum too long, no part of it above 1",
               [](lpvg_coeff_reals_t& r) { std::fill(std::begin(r.energy_direction[0]), std::end(r.energy_direction[0]), Real(0.75)); });
    }
    for (const Real end : {Real(0.9999), Real(1.0001)}) {
        spoilt("a direction at the end of what rounding excuses", [end](lpvg_coeff_reals_t& r) {
            std::fill(std::begin(r.energy_direction[0]), std::end(r.energy_direction[0]), Real(0));
            r.energy_direction[0][0] = end;
        });
    }
    // The change test.
    cases.push_back({"change rearm 0", [](lpvg_coeff_t& c) { c.words.change_rearm = 0U; }});
    spoilt("a block of no time", [](lpvg_coeff_reals_t& r) { r.change_block_s = Real(0); });
    spoilt("an output that never moves", [](lpvg_coeff_reals_t& r) { r.change_unit[LPVG_NY - 1][1] = Real(0); });
    spoilt("sizes infinite", [](lpvg_coeff_reals_t& r) { r.change_scale[LPVG_NY - 1][2] = Real(0); });
    spoilt("nothing forgotten", [](lpvg_coeff_reals_t& r) { r.change_forget = Real(0); });
    spoilt("all forgotten", [](lpvg_coeff_reals_t& r) { r.change_forget = Real(1); });
    spoilt("change threshold zero", [](lpvg_coeff_reals_t& r) { r.change_threshold = Real(0); });
    const auto prior = [&](const char* what, Real p, Real q, Real s, Real t, Real u, Real w) {
        for (const std::size_t j : {std::size_t{0}, std::size_t{LPVG_NY - 1}}) {
            spoilt(what, [=](lpvg_coeff_reals_t& r) {
                const Real A[6] = {p, q, s, t, u, w};
                std::copy(std::begin(A), std::end(A), std::begin(r.change_prior[j]));
            });
        }
    };
    prior("a prior without gain", Real(0), Real(0), Real(0), Real(1), Real(0), Real(1));
    prior("gain and delay as one", Real(1), Real(1), Real(0), Real(1), Real(0), Real(1));
    prior("gain and bias as one", Real(1), Real(0), Real(1), Real(1), Real(0), Real(1));
    prior("delay and bias as one", Real(1), Real(0), Real(0), Real(1), Real(1), Real(1));
    prior("a prior that is negative", Real(-1), Real(0), Real(0), Real(-1), Real(0), Real(-1));
    for (std::size_t b : {std::size_t{0}, std::size_t{LPVG_NBINS - 1}}) {
        cases.push_back({"odd frame", [b](lpvg_coeff_t& c) { c.words.frame_length[b] -= 1U; }});
        cases.push_back({"half a frame within the latency", [b](lpvg_coeff_t& c) { c.words.frame_length[b] = 2U * LPVG_NLATENCY; }});
        cases.push_back({"above Nyquist", [b](lpvg_coeff_t& c) { c.words.cycles[b] = c.words.frame_length[b] / 2U; }});
        cases.push_back({"W_delta 0", [b](lpvg_coeff_t& c) { c.reals.W_delta[b][LPVG_NDELTA - 1] = Real(0); }});
        cases.push_back({"W_certificate 0", [b](lpvg_coeff_t& c) { c.reals.W_certificate[b][LPVG_NDELTA - 1] = Real(0); }});
        cases.push_back({"scale 0", [b](lpvg_coeff_t& c) { c.reals.scale[b] = Real(0); }});
        cases.push_back({"a pool without a part", [b](lpvg_coeff_t& c) { c.words.pool_parts[b] = 0U; }});
        cases.push_back({"more parts of a pool than its memory", [b](lpvg_coeff_t& c) { c.words.pool_parts[b] = LPVG_NPOOL + 1U; }});
        cases.push_back({"a part without a frame", [b](lpvg_coeff_t& c) { c.words.pool_frames[b] = 0U; }});
        for (std::size_t j = 0; j < LPVG_NY; ++j) {
            cases.push_back({"B_w 0", [b, j](lpvg_coeff_t& c) { c.reals.B_w[b][j] = Real(0); }});
            cases.push_back({"B_certificate 0", [b, j](lpvg_coeff_t& c) { c.reals.B_certificate[b][j] = Real(0); }});
            for (std::size_t i : {std::size_t{0}, std::size_t{1}}) {
                cases.push_back({"scale of a pool below 0", [b, i, j](lpvg_coeff_t& c) { c.reals.pool_scale[0][b][i][j] = Real(-0.001); }});
            }
        }
    }
    for (const Case& test : cases) {
        CAPTURE(test.what);
        const lpvg_coeff_t coeff = sealed(test.change);
        check_refused(&coeff, lpvg_status_bad_value);
    }
}

TEST_CASE("the least value that the algorithm allows is accepted", "[unit][coeff][REQ-COEF-4]") {
    const std::function<void(lpvg_coeff_t&)> least[] = {
        [](lpvg_coeff_t& c) { c.words.sample_period_us = 1U; },
        [](lpvg_coeff_t& c) { c.words.energy_rearm = 1U; },
        [](lpvg_coeff_t& c) { c.words.change_rearm = 1U; },
        [](lpvg_coeff_t& c) { c.words.pool_parts[0] = 1U; },
        [](lpvg_coeff_t& c) { c.words.pool_parts[0] = LPVG_NPOOL; },
        [](lpvg_coeff_t& c) { c.words.pool_frames[0] = 1U; },
        [](lpvg_coeff_t& c) { c.reals.pool_scale[0][0][0][0] = c.reals.pool_scale[0][0][1][0] = Real(0); },
        [](lpvg_coeff_t& c) { c.reals.speed_min = Real(0.999) * c.reals.speed_max; },
    };
    for (const auto& change : least) {
        const lpvg_coeff_t coeff = sealed(change);
        CHECK(lpvg_coeff_check(&coeff) == lpvg_status_ok);
    }
}

TEST_CASE("a prior is accepted exactly where a decomposition in double finds it positive definite", "[unit][coeff][REQ-COEF-4]") {
    std::uint32_t random = 1U;
    const auto entry = [&random](double low, double high) {
        random = random * 1664525U + 1013904223U;
        return low + (high - low) * static_cast<double>(random >> 8U) / 16777216.0;
    };
    std::size_t definite = 0, other = 0, wrong = 0;
    for (int k = 0; k < 300; ++k) {
        const double mixed = k % 3 == 0 ? 0.5 : 2.0;
        double A[6] = {entry(0.5, 3.0), entry(-mixed, mixed), entry(-mixed, mixed), entry(0.5, 3.0), entry(-mixed, mixed), entry(0.5, 3.0)};
        A[k / 3 % 3 == 0 ? 3 : 5] *= k % 5 == 0 ? -1.0 : 1.0;
        // Cholesky's, of [A0 A1 A2; A1 A3 A4; A2 A4 A5].
        const double second = A[3] - A[1] * A[1] / A[0], below = A[4] - A[1] * A[2] / A[0];
        const double third = A[5] - A[2] * A[2] / A[0] - below * below / second;
        if (std::abs(second) < 1e-3 || std::abs(third) < 1e-3) {
            continue;
        }
        const bool good = second > 0.0 && third > 0.0;
        (good ? definite : other) += 1U;
        const lpvg_coeff_t coeff = sealed([&](lpvg_coeff_t& c) {
            std::transform(std::begin(A), std::end(A), std::begin(c.reals.change_prior[LPVG_NY - 1]),
                           [](double a) { return static_cast<Real>(a); });
        });
        wrong += lpvg_coeff_check(&coeff) != (good ? lpvg_status_ok : lpvg_status_bad_value) ? 1U : 0U;
    }
    CHECK(wrong == 0U);
    CHECK(definite > 50U);
    CHECK(other > 50U);
    // Three thousandths from where it is none any more: by the last entry, then by the fourth with a fifth that makes the rest harmless.
    for (int k = 0; k < 40; ++k) {
        const bool good = k % 2 == 0;
        const double off = good ? 1.003 : 0.997, sign = k % 4 < 2 ? 1.0 : -1.0;
        double A[6] = {entry(1.0, 2.0), entry(0.5, 0.9), sign * entry(0.5, 0.9), entry(2.0, 3.0), entry(0.5, 0.9), 0.0};
        if (k < 20) {
            const double first = A[0] * A[3] - A[1] * A[1], cross = A[0] * A[4] - A[1] * A[2];
            A[5] = (off * cross * cross / first + A[2] * A[2]) / A[0];
        } else {
            A[3] = off * A[1] * A[1] / A[0];
            A[4] = A[1] * A[2] / A[0];
            A[5] = 2.0 * A[2] * A[2] / A[0];
        }
        CAPTURE(k);
        const lpvg_coeff_t coeff = sealed([&](lpvg_coeff_t& c) {
            std::transform(std::begin(A), std::end(A), std::begin(c.reals.change_prior[LPVG_NY - 1]),
                           [](double a) { return static_cast<Real>(a); });
        });
        CHECK(lpvg_coeff_check(&coeff) == (good ? lpvg_status_ok : lpvg_status_bad_value));
    }
}

TEST_CASE("values at the edge of what is allowed are accepted", "[unit][coeff][REQ-COEF-4]") {
    const lpvg_coeff_t coeff = sealed([](lpvg_coeff_t& c) {
        c.words.of_last = LPVG_NHISTORY;
        c.words.confirm = LPVG_NHISTORY;
        c.words.frame_length[LPVG_NBINS - 1] = 2U * (LPVG_NLATENCY + 1U);
        c.words.cycles[LPVG_NBINS - 1] = LPVG_NLATENCY;
        c.words.varying_entry[0] = LPVG_NENTRIES - 1;
        const auto small = Real(1e-6);  // what has to be positive has no other lower end
        c.reals.speed_min = c.reals.speed_tolerance = c.reals.threshold = small;
        c.reals.energy_threshold = Real(1);
        for (std::size_t b = 0; b < LPVG_NBINS; ++b) {
            c.reals.scale[b] = small;
            std::fill(std::begin(c.reals.W_delta[b]), std::end(c.reals.W_delta[b]), small);
            std::fill(std::begin(c.reals.B_w[b]), std::end(c.reals.B_w[b]), small);
        }
        std::fill(std::begin(c.reals.energy_corner), std::end(c.reals.energy_corner), small);
        c.reals.energy_corner[LPVG_NBANDS - 2] = Real(0.999);
        std::fill(std::begin(c.reals.energy_forget), std::end(c.reals.energy_forget), Real(0.999));
        c.reals.change_forget = Real(0.999);
        for (std::size_t b = 0; b < LPVG_NBANDS; ++b) {
            std::fill(std::begin(c.reals.energy_scale[b]), std::end(c.reals.energy_scale[b]), small);
            std::fill(std::begin(c.reals.energy_start[b]), std::end(c.reals.energy_start[b]), Real(0));
        }
    });
    CHECK(lpvg_coeff_check(&coeff) == lpvg_status_ok);
}

TEST_CASE("a section is accepted where its poles are inside the unit circle, and not on or outside", "[unit][coeff][REQ-COEF-4]") {
    // In z: the roots of z^2 - 2 z + 1 + a1 (z - 1) + a2.
    const struct {
        double a1, a2;
    } near[] = {{0.5, 0.001}, {0.5, 0.499}, {2.499, 0.999}, {3.9, 3.85}};
    for (const auto& c : near) {
        for (const double off : {-0.002, 0.0, 0.002}) {
            const double a1 = c.a1 + (c.a1 > 1.0 ? off : 0.0), a2 = c.a2 + (c.a1 > 1.0 ? 0.0 : off);
            // z^2 + p z + q has both roots inside where |q| < 1 and |p| < 1 + q (Jury).
            const double p = a1 - 2.0, q = 1.0 - a1 + a2;
            const bool inside = std::abs(q) < 1.0 && std::abs(p) < 1.0 + q;
            CAPTURE(a1, a2);
            const lpvg_coeff_t coeff = sealed([=](lpvg_coeff_t& changed) {
                changed.reals.energy_W[LPVG_NDELTA - 1][0][3] = static_cast<Real>(a1);
                changed.reals.energy_W[LPVG_NDELTA - 1][0][4] = static_cast<Real>(a2);
            });
            CHECK(lpvg_coeff_check(&coeff) == (inside ? lpvg_status_ok : lpvg_status_bad_value));
        }
    }
}

TEST_CASE("words and numbers are walked by themselves, whatever lies between and behind them", "[unit][coeff][REQ-COEF-2][REQ-COEF-3]") {
    struct Words {
        uint32_t magic, crc32;
    };
    struct Reals {
        Real first, second;
    };
    struct Holed {
        Words words;
        alignas(32) Reals reals;
    };
    using Bits = std::conditional_t<sizeof(Real) == 4U, uint32_t, uint64_t>;
    const Reals reals = {Real(1.5), Real(-2.25)};
    uint32_t crc = lpvguard::crc32_word(lpvguard::crc32_word(lpvguard::crc32_start, uint32_t{0x4C505647U}), uint32_t{0});
    crc = lpvguard::crc32_word(crc, lpvguard::item_at<Bits>(reals, 0U));
    crc = lpvguard::crc32_word(crc, lpvguard::item_at<Bits>(reals, 1U));
    for (const int between : {0x00, 0xA5, 0xFF}) {
        Holed holed;
        std::memset(static_cast<void*>(&holed), between, sizeof holed);
        holed.words.magic = 0x4C505647U;
        holed.words.crc32 = 0x12345678U;  // is read as zero
        std::memcpy(&holed.reals, &reals, sizeof reals);
        CHECK(lpvguard::coefficients_crc32(holed) == ~crc);
    }

    Real numbers[2][2] = {{Real(1), Real(2)}, {std::numeric_limits<Real>::quiet_NaN(), Real(4)}};
    CHECK(lpvguard::all_finite(numbers[0]));
    CHECK_FALSE(lpvguard::all_finite(numbers[1]));
}
