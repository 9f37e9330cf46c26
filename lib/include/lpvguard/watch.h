/// @file watch.h -- watch of the response: does the vehicle follow the demand as modelled, within seconds of engagement?
///
/// phi is the response of the nominal model to the demand. It goes on through missing measurements. e is the measured output minus phi.
/// F takes a part of both signals and starts at rest with them. The sums below begin with the engagement. There are three pairs of them:
/// for sudden faults F takes what is above the energy test's upper corner, and the sums forget with LPVG_WATCH_SHORT_S. For weak ones F
/// is a high-pass with corner LPVG_WATCH_CORNER_RPS and the sums forget with LPVG_WATCH_LONG_S. For demands that hardly move F takes what
/// the first pair leaves, and the sums forget as the energy test does. For each pair and output j
///
///     P_j = sum of F e_j F phi_j      Q_j = sum of (F phi_j)^2      |P_j| <= gain_j Q_j + disturbance_j sqrt(Q_j)            (T46)
///
/// If the response is 1 + d_j times the nominal one, then P_j = d_j Q_j + sum of F w_j F phi_j. A violation therefore refutes every
/// constant |d_j| <= gain_j with a disturbance whose part along F phi_j is at most disturbance_j (THEORY 7.14). A violation counts once
/// Q_j is so large that |d_j| = LPVG_WATCH_ERROR_SHOWN would violate. With a smaller Q_j, P_j shows the effect of earlier demands.
///
/// gain_j is the smallest W_certificate,j of all bins: a larger constant error lies outside the certificate set. If it is above
/// LPVG_WATCH_GAIN_MAX, gain_j is the largest gain that the change test accepts as healthy. If that is too large as well, output j is
/// not watched. disturbance_j comes from the energy test's sigma_j. Above its upper corner it counts over LPVG_WATCH_QUICK_COHERENCE_S.
/// Between the outer corners it counts over LPVG_WATCH_COHERENCE_S. For the third pair the whole sigma_j below the first corner is added
/// in power: a disturbance there may follow the response at all times.
///
/// The sums are *evidence* when a vehicle without response, P_j = -Q_j, would violate the limit.
///
/// Use:     lpvg_watch_limits once -> lpvg_watch_start -> lpvg_watch_take each step, and lpvg_watch_void after it while not engaged.
/// Cost:    constant; the model's matrices are those of the monitor. RAM: sizeof(lpvg_watch_t). No heap, no locks, no I/O.
/// Threads: one instance per thread. NULL is not checked: called once a sample.
#ifndef LPVGUARD_WATCH_H
#define LPVGUARD_WATCH_H

#include "lpvguard/model.h"

LPVG_EXTERN_C_BEGIN

#define LPVG_WATCH_CORNER_RPS 1.0F  ///< corner of the second pair's F                  [rad/s]
#define LPVG_WATCH_SHORT_S 1.0F  ///< shorter time constant of the forgetting        [s]
#define LPVG_WATCH_LONG_S 5.0F  ///< longer time constant of the forgetting         [s]
#define LPVG_WATCH_QUICK_COHERENCE_S 0.75F  ///< longest time for which a disturbance above the outer corner may follow the response [s]
#define LPVG_WATCH_COHERENCE_S 1.5F  ///< longest time for which a disturbance between the outer corners may follow the response [s]
#define LPVG_WATCH_MEMORIES 3  ///< number of memories: the shorter, the longer, and one for the slow parts
#define LPVG_WATCH_GAIN_MAX 0.6F  ///< largest watched |d|: a gain of 0.3 is beyond it  [-]
#define LPVG_WATCH_ERROR_SHOWN 1.5F  ///< |d| that Q_j must suffice to show; a reversed and a tripled response have |d| = 2 [-]

#define lpvg_watch_limits_t LPVG_SYM(watch_limits_t)
#define lpvg_watch_t LPVG_SYM(watch_t)
#define lpvg_watch_limits LPVG_SYM(watch_limits)
#define lpvg_watch_start LPVG_SYM(watch_start)
#define lpvg_watch_void LPVG_SYM(watch_void)
#define lpvg_watch_take LPVG_SYM(watch_take)

/// Limits of the watch, derived from the coefficients.
typedef struct lpvg_watch_limits_t {
    lpvg_real_t gain[LPVG_NY];  ///< largest accepted constant |d_j|; the largest number: output j is not watched [-]
    lpvg_real_t disturbance[LPVG_WATCH_MEMORIES][LPVG_NY];  ///< largest part of F w_j along F phi_j  [output unit]
    lpvg_real_t share;  ///< share of the distance to its input that the slower lag's state moves per sample [-]
    lpvg_real_t keep[2];  ///< share of the first two pairs of sums that one sample keeps        [-]
} lpvg_watch_limits_t;

typedef struct lpvg_watch_t {
    lpvg_real_t x[LPVG_NX];  ///< state of the model whose output is phi       [mixed]
    lpvg_real_t past[LPVG_DELAY + 1][LPVG_NU];  ///< demands minus the offset, the newest first  [input unit]
    lpvg_real_t lag[2][2 * LPVG_NY];  ///< lags of e, then phi, the faster first                [output unit]
    lpvg_real_t P[LPVG_WATCH_MEMORIES][LPVG_NY];  ///< sums of F e_j F phi_j, at last of their slow parts  [output unit squared]
    lpvg_real_t Q[LPVG_WATCH_MEMORIES][LPVG_NY];  ///< sums of (F phi_j)^2, at last of the slow part     [output unit squared]
    bool violated;  ///< the newest sums of an output violate the limit
    bool evidence;  ///< the newest sums of an output are evidence
} lpvg_watch_t;

/// Computes the limits of a vehicle. The coefficients must have passed lpvg_coeff_check. NULL is not checked.
void lpvg_watch_limits(lpvg_watch_limits_t* limits, const lpvg_coeff_t* coeff);

/// Starts with the state of the monitor's model after a sample. NULL is not checked.
void lpvg_watch_start(lpvg_watch_t* self, const lpvg_model_t* model);

/// Clears the sums and their results; the response phi goes on. NULL is not checked.
void lpvg_watch_void(lpvg_watch_t* self);

/// Takes the measured outputs y [LPVG_NY] of a sample and the demand u [LPVG_NU] that is applied after it. `model` is the monitor's model
/// after that sample. y is NULL if there is no measurement; then only phi goes on. While `settled` is false, F is at rest and nothing is
/// summed. `settled` is false in the first sample with a measurement. NULL is not checked otherwise.
void lpvg_watch_take(lpvg_watch_t* self, const lpvg_watch_limits_t* limits, const lpvg_coeff_t* coeff, const lpvg_model_t* model,
                     bool settled, const lpvg_real_t* y, const lpvg_real_t* u);

LPVG_EXTERN_C_END
#endif
