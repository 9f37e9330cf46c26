/// @file energy.h -- energy test: can *one* causal Delta of gain at most 1 explain all outputs, from rest until now?
///
/// Class of model error (THEORY 4.1): e_j = Delta (W_delta yhat_j) + w_j. Delta is linear, time-invariant, causal and common to
/// all outputs (S1). The forgetting norm is ||x||^2 = sum over t of rho^(2 (T - t)) x(t)^2 with rho < 1. The left side may have a
/// smaller rho than the right side. F is any stable filter. Then, for every real vector a and at every time T,
///
///     || sum_j a_j F e_j || <= || sum_j a_j F W_delta yhat_j || + sum_j |a_j| sigma_j                         (T19)
///
/// With one Delta_j and W_delta,j for each output (S1_diagonal, LPVG_NDELTA = LPVG_NY), only single outputs are bounded. Then a is a
/// unit vector: ||F e_j|| <= ||F W_delta,j yhat_j|| + sigma_j.
///
/// Assumptions: Delta is analytic with |Delta(z)| <= 1 for |z| >= rho of the right side. ||F w_j|| <= sigma_j at every T. All states
/// are 0 when the sums begin. The left sum may begin later. |Delta| <= 1 on the unit circle alone is not enough: a delay of n samples
/// has the gain rho^-n. A ratio of left to right side above 1 proves (W_delta, sigma) wrong for every such Delta. The alarm threshold is
/// calibrated; it is at least 1 plus the rounding of float. Proof: THEORY 7.2.
///
/// After a restart with first sample t0, Delta, W_delta and F may still respond to earlier samples. The right side then grows by
///
///     sum_j |a_j| rho^(T - t0 + 1) energy_start_j                                                             (T19b)
///
/// `energy_start` is the largest such response on the identification's drives. The statement holds if the driving before the restart
/// left no larger response. The transient of the model is not part of the proof.
///
/// F is the filter of each of LPVG_NBANDS bands in turn: below the first corner, between each and the next, above the last (T21).
/// The filters sum to 1, and each band has its own sigma_j. The memory is memory_s. Above the last corner, the memory of the left side
/// is memory_s * f_first / f_last (T22).
///
/// The filter for W_delta is W_delta((2/Ts) (z/rho - 1) / (z/rho + 1)) (T20). `lpvguard identify` certifies its magnitude on
/// |z| = rho to be above the identified bound. Directions a are in units of sigma with sum |a_j| = 1, so the last term is 1.
/// They form a fixed fan, or are the unit vectors. One call judges one direction in all bands.
///
/// Cost: both functions constant. RAM: sizeof(lpvg_energy_t).
/// Threads: one instance per thread; no function blocks. Fields are private, except those that monitor.h documents.
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

/// Forgetting sums of products in one band.                                               [output unit squared]
typedef struct lpvg_energy_band_t {
    lpvg_real_t left[LPVG_NGRAM];               ///< products of F e_j [output unit squared]
    lpvg_real_t right[LPVG_NGRAM];              ///< products of F W_delta yhat_j [output unit squared]
    lpvg_real_t nominal[LPVG_NGRAM];            ///< products of F yhat_j [output unit squared]
} lpvg_energy_band_t;

typedef struct lpvg_energy_t {
    lpvg_real_t F[LPVG_NBANDS - 1][3 * LPVG_NY];  ///< states of the low-passes for e, yhat and W_delta yhat [output unit]
    lpvg_real_t W[LPVG_NWEIGHT][2][LPVG_NY];    ///< states of the sections of W_delta [output unit]
    lpvg_energy_band_t band[LPVG_NBANDS];
    lpvg_real_t fading;  ///< rho^(2 (T - t0 + 1)), decay of the response to samples before the restart [-]
    lpvg_real_t ratio;  ///< left side over right side in the newest direction, maximum over the bands; 0 at first [-]
    uint32_t strongest;  ///< band of that ratio
    uint32_t direction;  ///< index of the newest direction
    uint32_t next_direction;  ///< index of the direction that is judged next
} lpvg_energy_t;

/// Restarts: filters and sums are 0, and `energy_start` may be remembered. NULL is not checked.
void lpvg_energy_start(lpvg_energy_t* self);

/// Takes e, then yhat (2 LPVG_NY) of one sample. The left sums begin when `settled` is true; it must stay true until the next start.
/// The coefficients must have passed lpvg_coeff_check. NULL is not checked, because the calls come once per sample.
void lpvg_energy_advance(lpvg_energy_t* self, const lpvg_coeff_t* coeff, const lpvg_real_t* signal, bool settled);

/// Judges the next direction. Writes and returns `ratio`: infinity when a sum is not finite. NULL is not checked.
lpvg_real_t lpvg_energy_judge(lpvg_energy_t* self, const lpvg_coeff_t* coeff);

/// Returns the ratio of a vehicle without response (e = -yhat), in the newest direction and strongest band. NULL is not checked.
lpvg_real_t lpvg_energy_evidence(const lpvg_energy_t* self, const lpvg_coeff_t* coeff);

LPVG_EXTERN_C_END
#endif
