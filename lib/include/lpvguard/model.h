/// @file model.h -- discrete nominal LPV model, advanced at the measured speed.
///
///     yhat_k = C x_k + y0,   x_{k+1} = Ad(v_k) x_k + B_old(v_k) u_{k-d-1} + B_new(v_k) u_{k-d}
///
/// This is the exact zero-order hold of the continuous model (paper, section IV; THEORY 3.1). Cubics in the speed tabulate its
/// entries; the vehicle's MANIFEST.json states their error. Outside the scheduling range the nearest speed is used.
///
/// Cost: constant; the entries are computed anew when the speed has changed. RAM: sizeof(lpvg_model_t).
/// Threads: one instance per thread; no function blocks.
#ifndef LPVGUARD_MODEL_H
#define LPVGUARD_MODEL_H

#include "lpvguard/coeff.h"

LPVG_EXTERN_C_BEGIN

#define lpvg_model_t LPVG_SYM(model_t)
#define lpvg_model_start LPVG_SYM(model_start)
#define lpvg_model_output LPVG_SYM(model_output)
#define lpvg_model_advance LPVG_SYM(model_advance)

typedef struct lpvg_model_t {
    lpvg_real_t x[LPVG_NX];                         ///< state [mixed]
    // cppcheck-suppress misra-c2012-2.2 ; a delay of no sample makes the sum look idle
    lpvg_real_t past[LPVG_DELAY + 1][LPVG_NU];      ///< inputs u_{k-1}, ... u_{k-d-1} minus the offset, newest first [input unit]
    lpvg_real_t entry[LPVG_NENTRIES];               ///< Ad, B_old, B_new at `speed` [mixed]
    uint32_t sum;                                   ///< check sum of `entry`
    lpvg_real_t speed;                              ///< speed of `entry` [m/s]; the most negative number: none yet
} lpvg_model_t;

/// Starts at the measured output y (LPVG_NY): with the state of least norm that has this output, and with constant past input u
/// (LPVG_NU). The coefficients must have passed lpvg_coeff_check. NULL is not checked, because the calls come once per sample.
void lpvg_model_start(lpvg_model_t* self, const lpvg_coeff_t* coeff, const lpvg_real_t* u, const lpvg_real_t* y);

/// Writes the nominal output (LPVG_NY) at the current sample. NULL is not checked.
void lpvg_model_output(const lpvg_model_t* self, const lpvg_coeff_t* coeff, lpvg_real_t* yhat);

/// Advances the state by one sample, with the measured speed [m/s] and input u (LPVG_NU) of the current sample. NULL is not checked.
void lpvg_model_advance(lpvg_model_t* self, const lpvg_coeff_t* coeff, lpvg_real_t speed, const lpvg_real_t* u);

LPVG_EXTERN_C_END
#endif
