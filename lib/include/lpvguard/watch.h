/// @file watch.h -- does the vehicle respond to the demand as modelled, within seconds of engagement?
///
/// phi is the nominal model's response to the demand alone, from rest at the first engaged sample; e is the monitor's nominal error, and
/// F a high-pass of corner LPVG_WATCH_CORNER_RPS that begins at rest on the first of both. Sums forget with LPVG_WATCH_SHORT_S, for a fault
/// that comes, and with LPVG_WATCH_LONG_S, for one that shows little. For each of both memories and each output j
///
///     P_j = sum of F e_j F phi_j      Q_j = sum of (F phi_j)^2      |P_j| <= gain_j Q_j + disturbance_j sqrt(Q_j)            (T46)
///
/// A vehicle whose response is 1 + d_j times the nominal one has P_j = d_j Q_j + sum of F w_j F phi_j. A violation therefore refutes every
/// constant |d_j| <= gain_j whose disturbance has a part along F phi_j of at most disturbance_j (THEORY 7.14).
///
/// gain_j is the least W_delta,j of all bins: a larger constant error lies outside of the certificate set. Where that set contains
/// gains above LPVG_WATCH_GAIN_MAX, the largest gain that the change test calls healthy stands for it. An output without either is
/// not watched. disturbance_j is the energy test's sigma_j between its outer corners, in the time LPVG_WATCH_COHERENCE_S.
///
/// While the model has not settled since its start, e holds what that left over: the sums begin behind it, and F at rest there.
///
/// The sums are *evidence* where a vehicle that did not respond at all, P_j = -Q_j, would have violated.
///
/// Use:     lpvg_watch_limits once -> lpvg_watch_start at the first engaged sample -> lpvg_watch_take each sample.
/// Cost:    constant; the model's matrices are those of the monitor. RAM: sizeof(lpvg_watch_t). No heap, no locks, no I/O.
/// Threads: one instance per thread. NULL is not checked: called once a sample.
#ifndef LPVGUARD_WATCH_H
#define LPVGUARD_WATCH_H

#include "lpvguard/model.h"

LPVG_EXTERN_C_BEGIN

#define LPVG_WATCH_CORNER_RPS 1.0F  ///< corner of F                                    [rad/s]
#define LPVG_WATCH_SHORT_S 1.0F  ///< shorter time constant of the forgetting        [s]
#define LPVG_WATCH_LONG_S 5.0F  ///< longer one                                     [s]
#define LPVG_WATCH_COHERENCE_S 1.5F  ///< over which a disturbance may go along with the response [s]
#define LPVG_WATCH_MEMORIES 2  ///< the shorter, then the longer
#define LPVG_WATCH_GAIN_MAX 0.6F  ///< largest watched |d|: a gain of 0.3 is beyond it  [-]

#define lpvg_watch_limits_t LPVG_SYM(watch_limits_t)
#define lpvg_watch_t LPVG_SYM(watch_t)
#define lpvg_watch_limits LPVG_SYM(watch_limits)
#define lpvg_watch_start LPVG_SYM(watch_start)
#define lpvg_watch_take LPVG_SYM(watch_take)

/// What the watch derives from the coefficients.
typedef struct lpvg_watch_limits_t {
    lpvg_real_t gain[LPVG_NY];  ///< largest constant |d_j|; 1: output j is not watched                  [-]
    lpvg_real_t disturbance[LPVG_NY];  ///< largest part of F w_j along F phi_j                       [output unit]
    lpvg_real_t share;  ///< of the distance to the input that the high-pass's state moves a sample  [-]
    lpvg_real_t forget[LPVG_WATCH_MEMORIES];  ///< share of the sums forgotten with a sample       [-]
} lpvg_watch_limits_t;

typedef struct lpvg_watch_t {
    lpvg_real_t x[LPVG_NX];  ///< state of the model that the demand alone drives [mixed]
    lpvg_real_t past[LPVG_DELAY + 1][LPVG_NU];  ///< demands, the newest first                  [input unit]
    lpvg_real_t slow[2 * LPVG_NY];  ///< what F takes away from e, then phi                     [output unit]
    lpvg_real_t P[LPVG_WATCH_MEMORIES][LPVG_NY];  ///< sums of F e_j F phi_j                                 [output unit squared]
    lpvg_real_t Q[LPVG_WATCH_MEMORIES][LPVG_NY];  ///< sums of (F phi_j)^2                                   [output unit squared]
    bool violated;  ///< by the newest sums of any output
    bool evidence;  ///< a vehicle that did not respond would have violated with the newest sums of an output
} lpvg_watch_t;

/// The limits of a vehicle whose coefficients have passed lpvg_coeff_check. NULL is not checked.
void lpvg_watch_limits(lpvg_watch_limits_t* limits, const lpvg_coeff_t* coeff);

/// From rest, at the first engaged sample, whose nominal error is e [LPVG_NY]. NULL is not checked.
void lpvg_watch_start(lpvg_watch_t* self, const lpvg_real_t* e);

/// Takes the nominal error e [LPVG_NY] of a sample and the demand u [LPVG_NU] applied from it on. `model` is the monitor's, after that
/// sample; `settled`: the sums have begun. NULL is not checked.
void lpvg_watch_take(lpvg_watch_t* self, const lpvg_watch_limits_t* limits, const lpvg_coeff_t* coeff, const lpvg_model_t* model,
                     bool settled, const lpvg_real_t* e, const lpvg_real_t* u);

LPVG_EXTERN_C_END
#endif
