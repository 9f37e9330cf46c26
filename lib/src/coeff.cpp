// coeff.cpp -- acceptance of coefficients; see coeff.h.
#include "lpvguard/coeff.h"

#include <cmath>
#include <cstring>
#include <type_traits>

#include "lpvguard/monitor.h"

namespace {

static_assert(std::is_standard_layout<lpvg_coeff_words_t>::value, "words are walked as bytes");
static_assert(sizeof(lpvg_coeff_words_t) % sizeof(uint32_t) == 0U, "words only");
static_assert(sizeof(lpvg_coeff_reals_t) % sizeof(lpvg_real_t) == 0U, "numbers only");
static_assert(sizeof(lpvg_real_t) == 4U || sizeof(lpvg_real_t) == 8U, "float or double");

constexpr std::size_t n_words = sizeof(lpvg_coeff_words_t) / sizeof(uint32_t);
constexpr std::size_t n_reals = sizeof(lpvg_coeff_reals_t) / sizeof(lpvg_real_t);
constexpr std::size_t crc_word = offsetof(lpvg_coeff_words_t, crc32) / sizeof(uint32_t);

uint32_t crc32_byte(uint32_t crc, uint32_t byte) {
    crc ^= byte;
    for (int bit = 0; bit < 8; ++bit) {
        crc = (crc >> 1U) ^ ((crc & 1U) != 0U ? 0xEDB88320U : 0U);
    }
    return crc;
}

// Least significant byte first whatever the target's byte order.
template <class Word>
uint32_t crc32_word(uint32_t crc, Word word) {
    for (std::size_t i = 0; i < sizeof(Word); ++i) {
        crc = crc32_byte(crc, static_cast<uint32_t>((word >> (8U * i)) & 0xFFU));
    }
    return crc;
}

lpvg_real_t real_at(const lpvg_coeff_t* coeff, std::size_t i) {
    lpvg_real_t value;
    std::memcpy(&value, reinterpret_cast<const unsigned char*>(&coeff->reals) + i * sizeof value, sizeof value);
    return value;
}

uint32_t word_at(const lpvg_coeff_t* coeff, std::size_t i) {
    uint32_t value;
    std::memcpy(&value, reinterpret_cast<const unsigned char*>(&coeff->words) + i * sizeof value, sizeof value);
    return value;
}

bool sizes_match(const uint32_t* sizes) {
    return sizes[0] == LPVG_NX && sizes[1] == LPVG_NU && sizes[2] == LPVG_NY && sizes[3] == LPVG_DELAY &&
           sizes[4] == LPVG_NBINS && sizes[5] == LPVG_NCELLS && sizes[6] == LPVG_NVARYING;
}

bool words_in_range(const lpvg_coeff_words_t& w) {
    bool good = w.sample_period_us > 0U && w.confirm >= 1U && w.confirm <= w.of_last && w.of_last <= LPVG_NHISTORY;
    for (std::size_t b = 0; b < LPVG_NBINS; ++b) {
        // One bin is judged a sample, so a half frame must outlast a round through all bins.
        good = good && w.frame_length[b] % 2U == 0U && w.frame_length[b] / 2U > LPVG_NBINS &&
               2U * w.cycles[b] < w.frame_length[b];
    }
    for (std::size_t i = 0; i < LPVG_NVARYING; ++i) {
        good = good && w.varying_entry[i] < LPVG_NENTRIES;
    }
    return good;
}

bool reals_in_range(const lpvg_coeff_reals_t& r) {
    bool good = r.speed_min > lpvg_real_t(0) && r.speed_min < r.speed_max && r.speed_tolerance > lpvg_real_t(0) &&
                r.threshold > lpvg_real_t(0);
    for (std::size_t b = 0; b < LPVG_NBINS; ++b) {
        good = good && r.W_delta[b] > lpvg_real_t(0) && r.scale[b] > lpvg_real_t(0);
        for (std::size_t j = 0; j < LPVG_NY; ++j) {
            good = good && r.B_w[b][j] > lpvg_real_t(0);
        }
    }
    return good;
}

}  // namespace

extern "C" uint32_t lpvg_coeff_crc32(const lpvg_coeff_t* coeff) {
    if (coeff == nullptr) {
        return 0U;
    }
    using Bits = std::conditional_t<sizeof(lpvg_real_t) == 4U, uint32_t, uint64_t>;
    uint32_t crc = 0xFFFFFFFFU;
    for (std::size_t i = 0; i < n_words; ++i) {
        crc = crc32_word(crc, i == crc_word ? 0U : word_at(coeff, i));
    }
    for (std::size_t i = 0; i < n_reals; ++i) {
        const lpvg_real_t value = real_at(coeff, i);
        Bits bits;
        std::memcpy(&bits, &value, sizeof bits);
        crc = crc32_word(crc, bits);
    }
    return ~crc;
}

extern "C" lpvg_status_t lpvg_coeff_check(const lpvg_coeff_t* coeff) {
    if (coeff == nullptr) {
        return lpvg_status_bad_argument;
    }
    const lpvg_coeff_words_t& w = coeff->words;
    if (w.magic != LPVG_COEFF_MAGIC) {
        return lpvg_status_bad_magic;
    }
    if (w.schema != LPVG_COEFF_SCHEMA) {
        return lpvg_status_bad_schema;
    }
    if (w.real_bytes != sizeof(lpvg_real_t) || !sizes_match(w.sizes)) {
        return lpvg_status_bad_size;
    }
    if (w.estimator_id != LPVG_ESTIMATOR_ID) {
        return lpvg_status_bad_estimator;
    }
    if (w.crc32 != lpvg_coeff_crc32(coeff)) {
        return lpvg_status_bad_crc;
    }
    for (std::size_t i = 0; i < n_reals; ++i) {
        if (!std::isfinite(real_at(coeff, i))) {
            return lpvg_status_not_finite;
        }
    }
    return words_in_range(w) && reals_in_range(coeff->reals) ? lpvg_status_ok : lpvg_status_bad_value;
}
