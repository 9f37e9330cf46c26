/// @file controller.h -- robust controller, scheduled over speed, with limits, anti-windup and bumpless engagement.
///
///     v_k = C x_k                                                        wanted demand (D = 0: H-infinity controllers)
///     u_k = v_k within u_{k-1} -+ rate_max Ts, then within -+ u_max      applied demand; engaged
///     u_k = 0   within u_{k-1} -+ rate_max Ts                            not engaged: released no faster than demanded
///     x_{k+1} = x_k + A1 x_k + B(speed) m_k + L(speed) (u_k - v_k)       A1 = A - I, formed in double
///
/// m = (reference, outputs y in the order of the vehicle's signal table).
///
/// Realisation: poles do not depend on the speed, zeros do. Every demand owns LPVG_NK states with the same poles: pairs (h, t),
/// then a single one where LPVG_NK is odd. With a = A1[2p], a' = A1[2p + 1], b and b' the pair's rows of B and L times (m, u - v),
///
///     h+ = h + a h + t + b       t+ = t + a' h + b'       demand: sum of all h       single: h+ = h + a h + b
///
/// so A1 holds one number a state, C none, and what lies in a state means the same at every speed. B and L are interpolated
/// linearly between LPVG_NG speeds, equally spaced over the scheduling range; beyond its ends the nearest speed is used. At a
/// constant speed the frequency response is then the linear interpolation of its neighbours, and A - L C that of theirs.
///
/// Anti-windup: u - v is not zero while a limit acts or the controller is not engaged. L adds it to the states. L is a fit to
/// model recovery (tools/src/lpvguard/schedule.py): the states go on as in the loop without limits, and a state feedback lets
/// the nominal vehicle's lag behind that loop die out. A - L C is stable.
/// Engaging: the state is changed once by `engage` times (u - v, -(v_next - v)), v_next being the next demand at the present m.
/// Then neither this demand nor the next one jumps. Of all such changes it is the likeliest one when m is white noise.
///
/// Numbers: a slow pole changes its state by less than one rounding of float. The part that rounding takes is kept and added in
///          the next step, so slow poles and integrators keep their precision.
///
/// Use:     init once -> step once per sample period.
/// Cost:    LPVG_NU LPVG_NK (1 + 2 (LPVG_NM + LPVG_NU)) multiplications and as many additions a step, whether or not the
///          speed moves: nothing is cached. The step that engages adds about half as much.
/// RAM:     sizeof(lpvg_control_t): (2 LPVG_NK + 1) LPVG_NU numbers and counters. No heap, no locks, no I/O.
/// Threads: one instance per thread. Fields are for reading only.
///
/// A vehicle without controller (LPVG_NK 0) has none of this.
#ifndef LPVGUARD_CONTROLLER_H
#define LPVGUARD_CONTROLLER_H

#include "lpvguard/config.h"
#include "lpvguard/status.h"

#if LPVG_NK > 0

LPVG_EXTERN_C_BEGIN

#define LPVG_CONTROL_MAGIC 0x4C505643U
#define LPVG_CONTROL_SCHEMA 2U

#define lpvg_control_words_t LPVG_SYM(control_words_t)
#define lpvg_control_reals_t LPVG_SYM(control_reals_t)
#define lpvg_control_coeff_t LPVG_SYM(control_coeff_t)
#define lpvg_control_coeff LPVG_SYM(control_coeff)
#define lpvg_control_t LPVG_SYM(control_t)
#define lpvg_control_coeff_check LPVG_SYM(control_coeff_check)
#define lpvg_control_coeff_crc32 LPVG_SYM(control_coeff_crc32)
#define lpvg_control_init LPVG_SYM(control_init)
#define lpvg_control_step LPVG_SYM(control_step)

typedef struct lpvg_control_words_t {
    uint32_t magic;                     ///< LPVG_CONTROL_MAGIC
    uint32_t schema;                    ///< LPVG_CONTROL_SCHEMA
    uint32_t real_bytes;                ///< sizeof(lpvg_real_t)
    uint32_t sizes[4];                  ///< LPVG_NK, NM, NG, NU
    uint32_t crc32;                     ///< over all words and numbers, as in coeff.h
    uint32_t sample_period_us;          ///< Ts                                                       [us]
} lpvg_control_words_t;

/// States in units of the demand; the rest in the units of the signal table.
typedef struct lpvg_control_reals_t {
    lpvg_real_t speed_min;                          ///< first node                                   [m/s]
    lpvg_real_t speed_max;                          ///< last node                                    [m/s]
    lpvg_real_t u_max[LPVG_NU];                     ///< largest |demand|                             [input unit]
    lpvg_real_t rate_max[LPVG_NU];                  ///< largest |change of demand|                   [input unit/s]
    lpvg_real_t A1[LPVG_NK];                        ///< a, a' of every pair, a of a single state
    lpvg_real_t engage[LPVG_NK][2];                 ///< change of x for what v misses, and for its drift
    lpvg_real_t BL[LPVG_NG][LPVG_NU][LPVG_NK][LPVG_NM + LPVG_NU];  ///< rows of B, then of L
} lpvg_control_reals_t;

typedef struct lpvg_control_coeff_t {
    lpvg_control_words_t words;
    lpvg_control_reals_t reals;
} lpvg_control_coeff_t;

/// The vehicle's controller (generated lpvguard_control.c, read-only).
extern const lpvg_control_coeff_t lpvg_control_coeff;

typedef struct lpvg_control_t {
    const lpvg_control_coeff_t* coeff;
    lpvg_real_t x[LPVG_NU][LPVG_NK];      ///< states of every demand
    lpvg_real_t carry[LPVG_NU][LPVG_NK];  ///< what rounding took from the newest change of each state; added to the next
    lpvg_real_t u[LPVG_NU];               ///< newest applied demand                                  [input unit]
    bool engaged;                         ///< of the newest step
    uint32_t limited;                     ///< engaged steps in which a limit changed the demand, saturating
    uint32_t bad_samples;                 ///< refused steps, saturating
} lpvg_control_t;

/// Checks magic, schema, sizes, CRC-32, finiteness and value ranges, in this order.
/// Cost: one pass over the struct. Returns ok, or the status of the first check that fails; bad_argument for NULL.
LPVG_NODISCARD lpvg_status_t lpvg_control_coeff_check(const lpvg_control_coeff_t* coeff);

/// CRC-32 of the struct as the check expects it in `words.crc32`; 0 for NULL.
uint32_t lpvg_control_coeff_crc32(const lpvg_control_coeff_t* coeff);

/// Makes *self ready: state and demand zero, not engaged. Coefficients stay referenced and must outlive it.
/// Returns bad_argument for NULL, or what lpvg_control_coeff_check says; *self is untouched unless ok is returned.
LPVG_NODISCARD lpvg_status_t lpvg_control_init(lpvg_control_t* self, const lpvg_control_coeff_t* coeff);

/// One sample: measured speed [m/s], measurements m (LPVG_NM), engaged or not. self->u becomes the demand to apply from
/// now to the next sample. Returns ok; bad_argument (NULL), not_ready (no init): nothing happens.
/// bad_sample (speed or m not finite, or the states grown until C x is not: counted): the step is made not engaged with m
/// left out, so the demand runs to zero; states that have grown so far are cleared.
LPVG_NODISCARD lpvg_status_t lpvg_control_step(lpvg_control_t* self, lpvg_real_t speed, const lpvg_real_t* m, bool engaged);

LPVG_EXTERN_C_END

#endif
#endif
