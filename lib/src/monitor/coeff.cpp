// coeff.cpp -- acceptance of coefficients; see coeff.h.
#include "lpvguard/coeff.h"

#include "coefficient_checks.hpp"
#include "lpvguard/monitor.h"

namespace {

// What the layout cannot say of single items.
bool frames_fit(const lpvg_coeff_words_t& w) {
    bool good = true;
    for (std::size_t b = 0; b < LPVG_NBINS; ++b) {
        // A frame must be judged before the bin's next one ends. No frame is longer than DC's, whose length the verdict is held for.
        good = good && w.frame_length[b] % 2U == 0U && w.frame_length[b] / 2U > LPVG_NLATENCY && w.frame_length[b] <= w.frame_length[0] &&
               w.cycles[b] < w.frame_length[b] / 2U;
    }
    return good;
}

// Poles of a section of W_delta inside the unit circle.
bool stable(const lpvg_real_t* c) {
    const lpvg_real_t a1 = c[3], a2 = c[4];
    return a2 > lpvg_real_t(0) && a2 < a1 && lpvg_real_t(4) - lpvg_real_t(2) * a1 + a2 > lpvg_real_t(0);
}

bool energy_fits(const lpvg_coeff_reals_t& r) {
    bool good = true;
    lpvg_real_t below = lpvg_real_t(0);
    for (const lpvg_real_t corner : r.energy_corner) {
        if (!(corner >= below)) {
            good = false;
        }
        below = corner;
    }
    for (const auto& weight : r.energy_W) {
        for (const auto& section : weight) {
            good = good && stable(section);
        }
    }
    for (const auto& direction : r.energy_direction) {
        lpvg_real_t sum = lpvg_real_t(0), largest = lpvg_real_t(0);
        for (const lpvg_real_t a : direction) {
            const lpvg_real_t size = a < lpvg_real_t(0) ? -a : a;
            sum += size;
            largest = size > largest ? size : largest;
        }
        good = good && sum > lpvg_real_t(0.9999) && sum < lpvg_real_t(1.0001);
        // No sum of outputs is bounded where each has a Delta of its own.
        good = good && (LPVG_NDELTA == 1 || !(largest < sum));
    }
    return good;
}

// The normal equations have one solution however little is excited.
bool change_fits(const lpvg_coeff_reals_t& r) {
    bool good = true;
    for (const auto& A : r.change_prior) {
        const lpvg_real_t first = A[0] * A[3] - A[1] * A[1], cross = A[0] * A[4] - A[1] * A[2];
        const lpvg_real_t last = A[0] * A[5] - A[2] * A[2];
        good = good && A[0] > lpvg_real_t(0) && first > lpvg_real_t(0) && first * last - cross * cross > lpvg_real_t(0);
    }
    return good;
}

}  // namespace

extern "C" uint32_t lpvg_coeff_crc32(const lpvg_coeff_t* coeff) { return coeff == nullptr ? 0U : lpvguard::coefficients_crc32(*coeff); }

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
    if (w.real_bytes != sizeof(lpvg_real_t) || !lpvguard::sizes_match(w)) {
        return lpvg_status_bad_size;
    }
    if (w.estimator_id != LPVG_ESTIMATOR_ID) {
        return lpvg_status_bad_estimator;
    }
    if (w.crc32 != lpvg_coeff_crc32(coeff)) {
        return lpvg_status_bad_crc;
    }
    if (!lpvguard::all_finite(coeff->reals)) {
        return lpvg_status_not_finite;
    }
    const bool in_range = lpvguard::items_in_range(w) && lpvguard::items_in_range(coeff->reals) && frames_fit(w) &&
                          energy_fits(coeff->reals) && change_fits(coeff->reals);
    return in_range ? lpvg_status_ok : lpvg_status_bad_value;
}
