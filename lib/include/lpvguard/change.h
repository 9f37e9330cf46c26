/// @file change.h -- change test: do gain, delay and bias still agree with the identification drives?
///
/// For each output j, the test estimates theta_j = (gain, delay, bias) by least squares from
///
///     e_j = theta_1 yhat_j - theta_2 dyhat_j/dt + theta_3                                                     (T34)
///
/// It uses means over blocks of LPVG_NBLOCK samples, with forgetting. A prior keeps the estimate near 0 without excitation.
///
/// The *ratio* is the largest |theta_i| / size_i. Here size_i is the largest |theta_i| on the drives that set the bounds. A healthy
/// vehicle therefore has a ratio near 1. The ratio compares with earlier estimates, not with W_delta and B_w. It therefore refutes no
/// bound. A ratio above the calibrated threshold says that the vehicle has changed, and the estimate says how (THEORY 7.7).
///
/// Cost: constant. One call judges one output, so a block is spread over pushes. RAM: sizeof(lpvg_change_t).
/// Threads: one instance per thread; no function blocks. Fields are private, except those that monitor.h documents.
#ifndef LPVGUARD_CHANGE_H
#define LPVGUARD_CHANGE_H

#include "lpvguard/coeff.h"

LPVG_EXTERN_C_BEGIN

#define lpvg_change_output_t LPVG_SYM(change_output_t)
#define lpvg_change_t LPVG_SYM(change_t)
#define lpvg_change_start LPVG_SYM(change_start)
#define lpvg_change_take LPVG_SYM(change_take)
#define lpvg_change_judge LPVG_SYM(change_judge)

/// Forgetting sums of one output. The regressors phi = (yhat_j, -dyhat_j/dt, 1) are divided by their sizes.
typedef struct lpvg_change_output_t {
    lpvg_real_t gram[6];   ///< sum of phi phi', upper triangle row by row                   [-]
    lpvg_real_t along[3];  ///< sum of phi e_j                                               [output unit]
    lpvg_real_t before;    ///< mean of yhat_j over the previous block                       [output unit]
} lpvg_change_output_t;

typedef struct lpvg_change_t {
    lpvg_change_output_t output[LPVG_NY];
    uint32_t sum[LPVG_NY];        ///< check sum of each output's sums after its newest block
    lpvg_real_t mean[2 * LPVG_NY];  ///< means of e, then yhat, over the newest block        [output unit]
    lpvg_real_t estimate[3];      ///< newest estimate: gain [-], delay [s], bias [output unit]
    lpvg_real_t ratio;            ///< largest |theta_i| / size_i of the newest estimate; 0 at first [-]
    uint32_t strongest;           ///< 3 * output + part of theta with the largest ratio
    uint32_t pending;             ///< outputs that have not processed the newest block yet
    uint32_t begun;               ///< 1: `before` is valid
} lpvg_change_t;

/// Starts the test: all estimates are 0. NULL is not checked.
void lpvg_change_start(lpvg_change_t* self);

/// Takes a block. `signal` holds e, then yhat (2 LPVG_NY) of LPVG_NBLOCK successive samples, oldest first. Every output then waits
/// for lpvg_change_judge. If an output still waits for the previous block, that block is lost for it. NULL is not checked.
void lpvg_change_take(lpvg_change_t* self, const lpvg_real_t* signal);

/// Judges the next waiting output with the newest block. Call it only while `pending` > 0. Writes `estimate`, `strongest` and `ratio`.
/// Returns the ratio: infinity when a sum is not finite; 0, with a restart of the test, when a check sum differs.
/// The coefficients must have passed lpvg_coeff_check. NULL is not checked.
lpvg_real_t lpvg_change_judge(lpvg_change_t* self, const lpvg_coeff_t* coeff);

LPVG_EXTERN_C_END
#endif
