/// @file energy.h -- the energy test: can *one* causal Delta of gain at most 1 (or one an output) explain all outputs, from rest
/// until now?
///
/// Class of model error (THEORY 4.1): e_j = Delta (W_delta yhat_j) + w_j, one linear time-invariant causal Delta common to
/// all outputs (S1). The forgetting norm is ||x||^2 = sum over t of rho^(2 (T - t)) x(t)^2, rho < 1, and F is any stable filter.
/// For every real vector a and at every time T
///
///     || sum_j a_j F e_j || <= || sum_j a_j F W_delta yhat_j || + sum_j |a_j| sigma_j                         (T19)
///
/// With one Delta_j and W_delta,j an output (S1_diagonal, LPVG_NDELTA = LPVG_NY) a sum of outputs is not bounded, so a is one of the
/// unit vectors: ||F e_j|| <= ||F W_delta,j yhat_j|| + sigma_j.
///
/// Assumptions: Delta is analytic and |Delta(z)| <= 1 for |z| >= rho, rho being the band's. ||F w_j|| <= sigma_j at every T. Everything is
/// at rest when the sums begin. A Delta that is bounded on the unit circle alone is not meant: a pure delay of n samples has the gain
/// rho^-n here. The left sum alone may begin later.
/// A ratio above 1 of the left side to the right proves (W_delta, sigma) wrong for every such Delta. The alarm is raised above a
/// calibrated threshold, which is not below 1 plus the rounding of float. Proof: THEORY 7.2.
///
/// After a restart, with t0 its first sample, the right side is larger by what Delta, W_delta and F may remember:
///
///     sum_j |a_j| rho^(T - t0 + 1) sqrt(energy_start_j),   rho that of the lowest band                         (T19b)
///
/// `energy_start` is the largest met on the identification drives, whose driving the one before the restart must not exceed. The model's
/// own transient is not part of the proof: sigma covers it on identification drives that are cut at random.
///
/// F is the filter of each of LPVG_NBANDS bands in turn: below the first corner, between each and the next, above the last (T21).
/// The filters sum to 1, and each band has a sigma_j of its own. The memory is memory_s, above the last corner memory_s * f_first / f_last
/// (T22). There no frame bounds W_delta. So the right side there is
///
///     max( || sum_j a_j F W_delta yhat_j ||, || sum_j a_j F W_above yhat_j || ) + sum_j |a_j| sigma_j            (T19a)
///
/// with the constant W_above = `energy_above` >= 1. It holds for e_j = Delta (W_delta yhat_j) + w_j, for e_j = Delta (W_above yhat_j) +
/// w_j, and for e_j = Delta_1 (W_delta yhat_j) + Delta_2 (W_above yhat_j) + w_j where the gains on |z| = rho add up to at most 1.
///
/// The filter for W_delta is W_delta((2/Ts) (z/rho - 1) / (z/rho + 1)) (T20). `lpvguard identify` certifies its magnitude on
/// |z| = rho to be above the identified bound. Directions a are in units of sigma with sum |a_j| = 1, so the last term is 1.
/// They come from a fixed fan, or are the unit vectors. One direction is judged at a time, in all bands.
///
/// Cost: both functions constant. RAM: sizeof(lpvg_energy_t).
/// Threads: one instance per thread; no function blocks. Fields are private but for those documented in monitor.h.
#ifndef LPVGUARD_ENERGY_H
#define LPVGUARD_ENERGY_H

#include "lpvguard/coeff.h"

LPVG_EXTERN_C_BEGIN

#define LPVG_NGRAM (LPVG_NY * (LPVG_NY + 1) / 2)  ///< entries of a symmetric matrix, row by row from the diagonal on

#define lpvg_energy_band_t LPVG_SYM(energy_band_t)
#define lpvg_energy_t LPVG_SYM(energy_t)
#define lpvg_energy_start LPVG_SYM(energy_start)
#define lpvg_energy_advance LPVG_SYM(energy_advance)
#define lpvg_energy_judge LPVG_SYM(energy_judge)
#define lpvg_energy_evidence LPVG_SYM(energy_evidence)
#define lpvg_energy_explained LPVG_SYM(energy_explained)

/// Forgetting sums of products in one band.                                               [output unit squared]
typedef struct lpvg_energy_band_t {
    lpvg_real_t left[LPVG_NGRAM];               ///< of F e_j [output unit squared]
    lpvg_real_t right[LPVG_NGRAM];              ///< of F W_delta yhat_j, in every band [output unit squared]
    lpvg_real_t nominal[LPVG_NGRAM];            ///< of F yhat_j, from where the left sums begin [output unit squared]
} lpvg_energy_band_t;

typedef struct lpvg_energy_t {
    lpvg_real_t F[LPVG_NBANDS - 1][3 * LPVG_NY];  ///< states of the low-passes for e, yhat and W_delta yhat [output unit]
    lpvg_real_t W[LPVG_NWEIGHT][2][LPVG_NY];    ///< states of the sections of W_delta [output unit]
    lpvg_energy_band_t band[LPVG_NBANDS];
    lpvg_real_t above[LPVG_NGRAM];  ///< of F yhat_j in the last band, from the restart on as `right` is [output unit squared]
    lpvg_real_t fading;  ///< rho^(2 (T - t0 + 1)), of what is remembered at the restart [-]
    lpvg_real_t ratio;  ///< left side over right in the newest direction, largest of all bands; 0 at first [-]
    uint32_t strongest;  ///< the band it is of
    uint32_t direction;  ///< index of the newest direction
    uint32_t next_direction;  ///< index of the one that is judged next
} lpvg_energy_t;

/// A restart: filters and sums at zero, all that may be remembered of before still there. NULL is not checked.
void lpvg_energy_start(lpvg_energy_t* self);

/// Takes e, then yhat (2 LPVG_NY) of one sample. The left sums begin when `settled`, which must stay until the next start.
/// The coefficients must have passed lpvg_coeff_check; no argument may be NULL (not checked: called once per sample).
void lpvg_energy_advance(lpvg_energy_t* self, const lpvg_coeff_t* coeff, const lpvg_real_t* signal, bool settled);

/// Writes and returns `ratio`, in the next direction: infinity where a sum is not finite. NULL is not checked.
lpvg_real_t lpvg_energy_judge(lpvg_energy_t* self, const lpvg_coeff_t* coeff);

/// The ratio that a vehicle which did not respond at all (e = -yhat) would have shown in the newest direction and strongest
/// band. NULL is not checked.
lpvg_real_t lpvg_energy_evidence(const lpvg_energy_t* self, const lpvg_coeff_t* coeff);

/// What the error of an output (< LPVG_NY) may owe to yhat in the newest strongest band: the right side less sigma, of that output alone
/// [output unit]. NULL is not checked.
lpvg_real_t lpvg_energy_explained(const lpvg_energy_t* self, const lpvg_coeff_t* coeff, uint32_t output);

LPVG_EXTERN_C_END
#endif
