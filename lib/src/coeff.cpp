// coeff.cpp -- acceptance of coefficients; see coeff.h.
#include "lpvguard/coeff.h"

#include "acceptance.hpp"
#include "lpvguard/monitor.h"

namespace {

bool sizes_match(const uint32_t* sizes) {
    return sizes[0] == LPVG_NX && sizes[1] == LPVG_NU && sizes[2] == LPVG_NY && sizes[3] == LPVG_DELAY &&
           sizes[4] == LPVG_NBINS && sizes[5] == LPVG_NCELLS && sizes[6] == LPVG_NVARYING &&
           sizes[7] == LPVG_NWEIGHT && sizes[8] == LPVG_NDIRECTIONS && sizes[9] == LPVG_NBANDS;
}

bool words_in_range(const lpvg_coeff_words_t& w) {
    bool good = w.sample_period_us > 0U && w.confirm >= 1U && w.confirm <= w.of_last && w.of_last <= LPVG_NHISTORY &&
                w.energy_settle >= w.settle_samples && w.energy_rearm > 0U;
    for (std::size_t b = 0; b < LPVG_NBINS; ++b) {
        // A frame must be judged before the bin's next one ends. No frame is longer than DC's, whose length the verdict is
        // held for.
        good = good && w.frame_length[b] % 2U == 0U && w.frame_length[b] / 2U > LPVG_NLATENCY &&
               w.frame_length[b] <= w.frame_length[0] && w.cycles[b] < w.frame_length[b] / 2U;
    }
    for (std::size_t i = 0; i < LPVG_NVARYING; ++i) {
        good = good && w.varying_entry[i] < LPVG_NENTRIES;
    }
    return good;
}

// Poles of a section of W_delta inside the unit circle.
bool stable(const lpvg_real_t* c) {
    const lpvg_real_t a1 = c[3], a2 = c[4];
    return a2 > lpvg_real_t(0) && a2 < a1 && lpvg_real_t(4) - lpvg_real_t(2) * a1 + a2 > lpvg_real_t(0);
}

bool energy_in_range(const lpvg_coeff_reals_t& r) {
    bool good = r.energy_threshold >= lpvg_real_t(1) && r.energy_above > lpvg_real_t(0);
    lpvg_real_t below = lpvg_real_t(0);
    for (const lpvg_real_t corner : r.energy_corner) {
        good = good && corner > lpvg_real_t(0) && corner >= below && corner < lpvg_real_t(1);
        below = corner;
    }
    for (const auto& section : r.energy_W) {
        good = good && stable(section);
    }
    for (std::size_t b = 0; b < LPVG_NBANDS; ++b) {
        good = good && r.energy_forget[b] > lpvg_real_t(0) && r.energy_forget[b] < lpvg_real_t(1);
        for (std::size_t j = 0; j < LPVG_NY; ++j) {
            good = good && r.energy_scale[b][j] > lpvg_real_t(0) && r.energy_start[b][j] >= lpvg_real_t(0);
        }
    }
    for (const auto& direction : r.energy_direction) {
        lpvg_real_t sum = lpvg_real_t(0);
        for (const lpvg_real_t a : direction) {
            sum += a < lpvg_real_t(0) ? -a : a;
        }
        good = good && sum > lpvg_real_t(0.9999) && sum < lpvg_real_t(1.0001);
    }
    return good;
}

bool reals_in_range(const lpvg_coeff_reals_t& r) {
    bool good = r.speed_min > lpvg_real_t(0) && r.speed_min < r.speed_max && r.speed_tolerance > lpvg_real_t(0) &&
                r.threshold > lpvg_real_t(0) && energy_in_range(r);
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
    return coeff == nullptr ? 0U : lpvguard::coefficients_crc32(*coeff);
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
    if (!lpvguard::all_finite(coeff->reals)) {
        return lpvg_status_not_finite;
    }
    return words_in_range(w) && reals_in_range(coeff->reals) ? lpvg_status_ok : lpvg_status_bad_value;
}
