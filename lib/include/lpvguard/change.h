/// @file change.h -- the change test: are the vehicle's gain, delay and bias still those of the drives it was identified from?
///
/// Of every output j it keeps the least-squares estimate theta_j = (gain, delay, bias) of
///
///     e_j = theta_1 yhat_j - theta_2 dyhat_j/dt + theta_3                                                     (T34)
///
/// over the means of blocks of LPVG_NBLOCK samples, with forgetting, and with a prior that keeps it near 0 where nothing excites it.
/// The ratio is the largest |theta_i| over its size on the drives that set the bounds (1: as large as was met). The others must allow what
/// |Delta| <= 1 could make of the output, and a disturbance that follows it. This one knows only how large an estimate has been. So
/// it refutes no bound. Above a calibrated threshold it says that the vehicle has changed since, and the estimate says how (THEORY 7.7).
///
/// Cost: constant; an output a call, so that a block is spread over pushes. RAM: sizeof(lpvg_change_t).
/// Threads: one instance per thread; no function blocks. Fields are private but for those documented in monitor.h.
#ifndef LPVGUARD_CHANGE_H
#define LPVGUARD_CHANGE_H

#include "lpvguard/coeff.h"

LPVG_EXTERN_C_BEGIN

#define lpvg_change_output_t LPVG_SYM(change_output_t)
#define lpvg_change_t LPVG_SYM(change_t)
#define lpvg_change_start LPVG_SYM(change_start)
#define lpvg_change_take LPVG_SYM(change_take)
#define lpvg_change_judge LPVG_SYM(change_judge)

/// Forgetting sums of one output, of products of the regressors phi = (yhat_j, -dyhat_j/dt, 1), each over its size.
typedef struct lpvg_change_output_t {
    lpvg_real_t gram[6];   ///< of phi phi', the upper triangle row by row                   [-]
    lpvg_real_t along[3];  ///< of phi e_j                                                   [output unit]
    lpvg_real_t before;    ///< mean of yhat_j over the block before                         [output unit]
} lpvg_change_output_t;

typedef struct lpvg_change_t {
    lpvg_change_output_t output[LPVG_NY];
    uint32_t sum[LPVG_NY];        ///< of the words of each output, as its newest block left them
    lpvg_real_t mean[2 * LPVG_NY];  ///< of e, then yhat, over the newest block              [output unit]
    lpvg_real_t estimate[3];      ///< newest estimate: gain [-], delay [s], bias [output unit]
    lpvg_real_t ratio;            ///< its largest part over the size of the bound-setting drives; 0 at first [-]
    uint32_t strongest;           ///< the output it is of times 3, plus the part
    uint32_t pending;             ///< outputs that have not taken the newest block yet
    uint32_t begun;               ///< 1: `before` holds
} lpvg_change_t;

/// Without any sample: estimates of 0. NULL is not checked.
void lpvg_change_start(lpvg_change_t* self);

/// Takes a block: `signal` has e, then yhat (2 LPVG_NY) of LPVG_NBLOCK successive samples, the oldest first. Every output waits to be
/// judged by it. Where one still waits for the block before, that is lost, and this one is only remembered. NULL is not checked.
void lpvg_change_take(lpvg_change_t* self, const lpvg_real_t* signal);

/// The next output that waits takes the block and is judged; only while `pending` > 0. Writes `estimate` and `strongest`, and writes and
/// returns `ratio`: infinity where a sum is not finite. Sums that are not as the last call left them start the test anew, and the ratio is
/// 0. The coefficients must have passed lpvg_coeff_check; NULL is not checked.
lpvg_real_t lpvg_change_judge(lpvg_change_t* self, const lpvg_coeff_t* coeff);

LPVG_EXTERN_C_END
#endif
