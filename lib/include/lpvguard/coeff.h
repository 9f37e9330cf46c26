/// @file coeff.h -- the coefficients of one vehicle, as `lpvguard export` writes them.
///
/// The struct is data, not an interface to program against: link the generated `lpvguard_coeff.c` and pass
/// `&lpvg_coeff` to the init functions. It consists of 32-bit words followed by numbers of type lpvg_real_t, so that its
/// CRC-32 (ISO-HDLC, over the words and then the numbers, each least significant byte first, with `crc32` read as zero)
/// is the same on every target.
#ifndef LPVGUARD_COEFF_H
#define LPVGUARD_COEFF_H

#include "lpvguard/config.h"
#include "lpvguard/status.h"

LPVG_EXTERN_C_BEGIN

#define LPVG_COEFF_MAGIC 0x4C505647U
#define LPVG_COEFF_SCHEMA 3U
/// Entries of Ad (n x n), B_old (n x n_u) and B_new (n x n_u), row after row, one matrix after the other.
#define LPVG_NENTRIES (LPVG_NX * (LPVG_NX + (2 * LPVG_NU)))

#define lpvg_coeff_words_t LPVG_SYM(coeff_words_t)
#define lpvg_coeff_reals_t LPVG_SYM(coeff_reals_t)
#define lpvg_coeff_t LPVG_SYM(coeff_t)
#define lpvg_coeff LPVG_SYM(coeff)
#define lpvg_coeff_check LPVG_SYM(coeff_check)
#define lpvg_coeff_crc32 LPVG_SYM(coeff_crc32)

typedef struct lpvg_coeff_words_t {
    uint32_t magic;                         ///< LPVG_COEFF_MAGIC
    uint32_t schema;                        ///< LPVG_COEFF_SCHEMA
    uint32_t real_bytes;                    ///< sizeof(lpvg_real_t)
    uint32_t sizes[10];                     ///< LPVG_NX, NU, NY, DELAY, NBINS, NCELLS, NVARYING, NWEIGHT, NDIRECTIONS, NBANDS
    uint32_t estimator_id;                  ///< LPVG_ESTIMATOR_ID: definition of the frames the bounds were made with
    uint32_t crc32;                         ///< over all words and numbers
    uint32_t sample_period_us;              ///< Ts                                             [us]
    uint32_t settle_samples;                ///< samples in range before frames may begin
    uint32_t confirm;                       ///< k of the k-of-m confirmation
    uint32_t of_last;                       ///< m of the k-of-m confirmation, 1..LPVG_NHISTORY
    uint32_t energy_settle;                 ///< samples in range before the left sum of the energy test grows, at least settle_samples
    uint32_t energy_rearm;                  ///< judgements without an exceedance after which the next one is an alarm anew, not 0
    uint32_t frame_length[LPVG_NBINS];      ///< samples a frame, even, none longer than DC's; half exceeds LPVG_NLATENCY (monitor.h)
    uint32_t cycles[LPVG_NBINS];            ///< periods a frame, 0 at DC, fewer than half its samples
    uint32_t varying_entry[LPVG_NVARYING];  ///< which of the LPVG_NENTRIES entries move with speed
} lpvg_coeff_words_t;

typedef struct lpvg_coeff_reals_t {
    lpvg_real_t speed_min;                                  ///< scheduling range                  [m/s]
    lpvg_real_t speed_max;                                  ///<                                   [m/s]
    lpvg_real_t speed_valid[2];                             ///< physical range of the signal      [m/s]
    lpvg_real_t input_valid[LPVG_NU][2];                    ///< physical range                    [input unit]
    lpvg_real_t output_valid[LPVG_NY][2];                   ///< physical range                    [output unit]
    lpvg_real_t speed_tolerance;                            ///< largest |v/mean - 1| in a frame   [-]
    lpvg_real_t input_offset[LPVG_NU];                      ///< subtracted from the input         [input unit]
    lpvg_real_t output_offset[LPVG_NY];                     ///< added to the output               [output unit]
    lpvg_real_t base[LPVG_NENTRIES];                        ///< model entries that do not vary with speed
    lpvg_real_t cell[LPVG_NCELLS][LPVG_NVARYING][4];        ///< cubic in the position 0..1 within a speed cell
    lpvg_real_t C[LPVG_NY][LPVG_NX];                        ///< output matrix
    lpvg_real_t C_pinv[LPVG_NX][LPVG_NY];                   ///< its pseudo-inverse: state of a measured output
    lpvg_real_t turn[LPVG_NBINS][2];                        ///< cos - 1 and sin of the phase step 2 pi cycles / N
    lpvg_real_t taper[LPVG_NBINS][2];                       ///< cos - 1 and sin of the window step 2 pi / N
    lpvg_real_t scale[LPVG_NBINS];                          ///< 2 / sum(window), at DC 1 / sum(window)
    lpvg_real_t energy_corner[LPVG_NBANDS - 1];             ///< g of the low-pass g (z + 1) / (z - 1 + 2 g) at each corner, not falling
    lpvg_real_t energy_W[LPVG_NWEIGHT][5];                  ///< sections of W_delta on |z| = rho, b0 b1 b2 a1 a2 (energy.cpp)
    lpvg_real_t energy_above;                               ///< what stands for W_delta above the last corner
    lpvg_real_t energy_scale[LPVG_NBANDS][LPVG_NY];         ///< 1 / sigma_j of each band          [1/output unit]
    lpvg_real_t energy_forget[LPVG_NBANDS];                 ///< 1 - rho^2, rho of the band
    lpvg_real_t energy_start[LPVG_NBANDS][LPVG_NY];         ///< right sum at rest                 [output unit squared]
    lpvg_real_t energy_direction[LPVG_NDIRECTIONS][LPVG_NY];  ///< a, in units of sigma, sum |a_j| = 1
    lpvg_real_t energy_threshold;                           ///< calibrated threshold of the energy test's ratio
    lpvg_real_t W_delta[LPVG_NBINS];                        ///< |W_delta| at the bin                 [-]
    lpvg_real_t B_w[LPVG_NBINS][LPVG_NY];                   ///< disturbance bound at the bin         [output unit]
    lpvg_real_t threshold;                                  ///< calibrated threshold of the frame test's statistic
} lpvg_coeff_reals_t;

typedef struct lpvg_coeff_t {
    lpvg_coeff_words_t words;
    lpvg_coeff_reals_t reals;
} lpvg_coeff_t;

/// The vehicle's coefficients (generated, read-only).
extern const lpvg_coeff_t lpvg_coeff;

/// Checks magic, schema, sizes, estimator, CRC-32, finiteness and value ranges, in this order.
/// Cost: one pass over the struct. Returns ok, or the status of the first check that fails.
LPVG_NODISCARD lpvg_status_t lpvg_coeff_check(const lpvg_coeff_t* coeff);

/// CRC-32 of the struct as lpvg_coeff_check expects it in `words.crc32`; 0 for NULL.
uint32_t lpvg_coeff_crc32(const lpvg_coeff_t* coeff);

LPVG_EXTERN_C_END
#endif
