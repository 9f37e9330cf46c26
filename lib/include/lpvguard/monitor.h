/// @file monitor.h -- on-line monitor of the nominal error: does the vehicle still agree with its identified model?
///
/// Each sample advances the nominal model and forms the nominal error e = y - yhat. The monitor transforms e and yhat with
/// Hann windows at LPVG_NBINS frequencies, called bins; bin 0 is DC (THEORY 3.2). Each bin completes one frame every half frame.
///
/// Frame test. A frame gives the transforms E_j and Z_j of e_j and yhat_j. Its *margin* is
///
///     t* = min over complex d of max( |d| / W_delta, |E_j - d Z_j| / B_w,j for each output j )        (T17)
///
/// t* is the smallest common factor on both fitted bounds that explains the frame. The closed form is exact.
/// With one Delta for each output (S1_diagonal, LPVG_NDELTA = LPVG_NY), each output has its own d_j and W_delta,j:
///
///     t* = max over j of |E_j| / (B_w,j + W_delta,j |Z_j|)
///
/// t* > 1 means: no complex number d within W_delta, with a disturbance within B_w, explains this frame in this bin.
/// The frame test does not refute every causal Delta. Only the energy test makes a statement about causal Delta, given its sigma.
///
/// A frame *counts* if the model had settled, the speed stayed in the scheduling range, and the speed stayed within
/// `speed_tolerance` of the frame's mean. The *statistic* of a bin is the k-th largest margin of its last m counted frames.
/// Frames of a bin are also pooled. The sums run over the counted frames among the last `pool_parts` x `pool_frames` frames. The
/// ratio of an output, with bounds B and W at the speed of the newest frame, is
///
///     |sum of conj(Z_j) E_j| / sqrt(P_j) / max( B_j, W_j sqrt(P_j) ),   P_j = sum of |Z_j|^2        (T51)
///
/// An error that follows the input adds up in the first sum, a disturbance does not. A statistic or a ratio above `threshold` is an
/// alarm. The *evidence* of a frame is the margin that a vehicle without any response would have shown (T18). A frame with evidence
/// at or below the threshold is "not excited". Such a frame can object to no vehicle, so it does not make the verdict valid.
///
/// Two sets (T53). W_delta and B_w above are the *healthy set*: what the drives of the identification showed. The *certificate set*,
/// W_certificate and B_certificate, contains it; the controller is certified for it. An alarm says that the vehicle left the healthy
/// set: the verdict is degraded. It *refutes* the certificate if the frame's margin with the bounds of the certificate exceeds 1: the
/// verdict is invalid. With one Delta common to several outputs a lower bound of that margin is compared. A pool refutes no certificate.
///
/// Energy test (energy.h). It takes every sample. It is judged in each push that judges no frame, once model and F have settled.
/// A *ratio* above `energy_threshold` is an alarm. It refutes the certificate above `energy_certificate`. An alarm is recorded
/// after `energy_rearm` judgements below the threshold, or if it is the first alarm that refutes. The test restarts from rest after
/// a gap, a refused sample, or a speed outside the scheduling range.
///
/// Change test (change.h). It takes every settled block of LPVG_NBLOCK samples. Each output is then judged once, in a later push
/// that closes no frame. A block is lost when the next block ends before all outputs are judged. A *ratio* above `change_threshold`
/// says that the vehicle has changed since identification. It refutes no certificate, so the verdict is degraded. The first such ratio
/// after `change_rearm` judgements below the threshold is recorded as an alarm.
///
/// Integrity. Each push checks the indices of one bin, in turn. An impossible index counts as a refused sample, and the monitor
/// restarts. An infinite or NaN sum of the energy test refutes the certificate, and that test restarts. Damaged coefficients can cause
/// wrong verdicts but no access outside the objects; ecu.h checks the coefficients.
///
/// Use:     init once -> push one sample per period -> read verdict, frame and records at any time.
/// Cost:    nearly the same in each push. A bin processes LPVG_NBLOCK samples at once; each push serves a quarter of the bins.
///          A push judges at most one frame, over LPVG_NPARTS pushes, and none when several frames end. The judgement of a frame
///          follows its end by at most LPVG_NLATENCY samples. A frame that ends fewer than LPVG_NBLOCK samples before a gap is
///          dropped. `lpvguard bench core` counts instructions on three targets. No heap, no locks, no I/O.
/// Threads: one instance per thread. Do not call these functions from two contexts at once.
/// RAM:     sizeof(lpvg_monitor_t). Fields are private; the layout may change.
#ifndef LPVGUARD_MONITOR_H
#define LPVGUARD_MONITOR_H

#include "lpvguard/change.h"
#include "lpvguard/energy.h"
#include "lpvguard/model.h"

LPVG_EXTERN_C_BEGIN

#define LPVG_NRECORDS 4  ///< falsifying frames kept until they are read out

#define lpvg_sample_t LPVG_SYM(sample_t)
#define lpvg_frame_t LPVG_SYM(frame_t)
#define lpvg_monitor_t LPVG_SYM(monitor_t)
#define lpvg_bin_t LPVG_SYM(bin_t)
#define lpvg_taken_t LPVG_SYM(taken_t)
#define lpvg_span_t LPVG_SYM(span_t)
#define lpvg_sum_t LPVG_SYM(sum_t)
#define lpvg_pool_t LPVG_SYM(pool_t)
#define lpvg_monitor_init LPVG_SYM(monitor_init)
#define lpvg_monitor_push LPVG_SYM(monitor_push)
#define lpvg_monitor_verdict LPVG_SYM(monitor_verdict)
#define lpvg_monitor_reason LPVG_SYM(monitor_reason)
#define lpvg_monitor_frame LPVG_SYM(monitor_frame)
#define lpvg_monitor_take_record LPVG_SYM(monitor_take_record)
#define lpvg_monitor_void LPVG_SYM(monitor_void)

typedef enum lpvg_verdict_t {
    lpvg_verdict_unknown = 0,     ///< No frame has ended yet. Zero: cleared memory never reads "valid".
    lpvg_verdict_valid = 1,       ///< Within the hold time a frame with evidence counted, and no test alarmed.
    lpvg_verdict_invalid = 2,     ///< A frame or the energy test refuted the certificate set within the last hold time.
    lpvg_verdict_not_judged = 3,  ///< Frames ended, but none within the hold time is evidence: see lpvg_reason_t.
    lpvg_verdict_stale = 4,       ///< The newest sample is older than five sample periods.
    lpvg_verdict_fault = 5,       ///< The newest sample was refused, or the arguments are wrong.
    lpvg_verdict_degraded = 6     ///< Not invalid, but a test alarmed within the hold time. The certificate set is not refuted.
} lpvg_verdict_t;

/// Why the newest frame did not count as evidence.
typedef enum lpvg_reason_t {
    lpvg_reason_none = 0,          ///< The frame is evidence.
    lpvg_reason_not_excited = 1,   ///< Too little excitation: even a vehicle without response would have passed.
    lpvg_reason_speed_moved = 2,   ///< Speed moved more than the frame allows.
    lpvg_reason_out_of_range = 3,  ///< Speed outside the scheduling range.
    lpvg_reason_settling = 4       ///< The model's initial state had not decayed.
} lpvg_reason_t;

/// The test that a record comes from.
typedef enum lpvg_test_t {
    lpvg_test_frame = 0,
    lpvg_test_energy = 1,
    lpvg_test_change = 2
} lpvg_test_t;

typedef struct lpvg_sample_t {
    int64_t t_us;                  ///< time of the sample, monotonic      [us]
    lpvg_real_t speed;             ///< longitudinal speed, forward > 0    [m/s]
    lpvg_real_t u[LPVG_NU];        ///< inputs, in the order and units of the vehicle's signal table
    lpvg_real_t y[LPVG_NY];        ///< outputs, likewise
} lpvg_sample_t;

/// One judged frame of one bin. A record may also hold an alarm of the energy test or of the change test.
///
/// Alarm of the energy test: `bin` is band * LPVG_NDIRECTIONS + direction (energy.h). `margin` and `statistic` are its ratio.
/// `evidence` is the ratio of a vehicle without response. `speed` is the speed of the sample. E[j][0] is the norm of F e_j, and
/// Z[j][0] is the norm of F W_delta yhat_j. The imaginary parts are 0.
///
/// Alarm of the change test: `bin` is 3 * output + part of the estimate (0 gain, 1 delay, 2 bias). `margin` and `statistic` are its ratio.
/// `evidence` is the ratio of a lost output (gain -1). E[0] holds gain and delay of the output, Z[0][0] its bias. All other numbers are 0.
typedef struct lpvg_frame_t {
    uint32_t sequence;             ///< number of frames closed so far, this one included; 0: none yet
    lpvg_test_t test;              ///< the test that judged
    uint32_t bin;                  ///< 0 is DC
    int64_t t_end_us;              ///< time of the frame's last sample                    [us]
    lpvg_reason_t reason;          ///< none or not_excited: the frame counted; another reason: all fields below are 0
    bool falsified;                ///< an alarm: statistic or pooled ratio above the threshold
    bool refuted;                  ///< an alarm that refutes the certificate set: the verdict is invalid
    lpvg_real_t speed;             ///< mean speed                                         [m/s]
    lpvg_real_t margin;            ///< t*; 1: exactly explained by the fitted bounds      [-]
    lpvg_real_t statistic;         ///< k-th largest of the bin's last m margins, 0 before there are k [-]
    lpvg_real_t evidence;          ///< larger of margin and pooled ratio of a vehicle that does not respond [-]
    lpvg_real_t E[LPVG_NY][2];     ///< nominal error, real and imaginary part             [output unit]
    lpvg_real_t Z[LPVG_NY][2];     ///< nominal output, likewise                           [output unit]
    lpvg_real_t pooled;            ///< largest ratio of the pool (T51), 0 without one     [-]
} lpvg_frame_t;

/// Sums over half a frame of (e, yhat) times the complex exponential.
typedef struct lpvg_sum_t {
    lpvg_real_t plain_re[2 * LPVG_NY], plain_im[2 * LPVG_NY];    ///< without window: e, then yhat             [output unit]
    lpvg_real_t rising_re[2 * LPVG_NY], rising_im[2 * LPVG_NY];  ///< times the rising half of the window: e, then yhat [output unit]
} lpvg_sum_t;

/// Sums over the counted frames of a part of a pool.
typedef struct lpvg_pool_t {
    lpvg_real_t re[LPVG_NY], im[LPVG_NY];     ///< conj(Z_j) E_j                                      [output unit squared]
    lpvg_real_t power[LPVG_NY];               ///< |Z_j|^2                                            [output unit squared]
} lpvg_pool_t;

/// Speed over half a frame.
typedef struct lpvg_span_t {
    lpvg_real_t speed_low;                    ///< lowest speed                                       [m/s]
    lpvg_real_t speed_high;                   ///< highest speed                                      [m/s]
    lpvg_real_t speed_sum;                    ///< sum over the samples                               [m/s]
    lpvg_reason_t reason;                     ///< why the half frame is no evidence
} lpvg_span_t;

/// Time and speed of a sample, kept for the bins.
typedef struct lpvg_taken_t {
    int64_t t_us;                             ///< time of the sample                                 [us]
    lpvg_span_t span;                         ///< of this sample
} lpvg_taken_t;

typedef struct lpvg_bin_t {
    uint32_t n;                               ///< samples in the current half frame
    lpvg_real_t phasor[2], window[2];         ///< exp(j phase) and exp(j window phase) / 2 of the next sample [-]
    lpvg_sum_t sum;                           ///< current half
    lpvg_span_t span, span_before;            ///< current and previous half
    lpvg_real_t rising_re[2 * LPVG_NY], rising_im[2 * LPVG_NY];  ///< rising sums of the previous half [output unit]
    bool has_before;                          ///< previous half complete
    lpvg_real_t frame_re[2 * LPVG_NY], frame_im[2 * LPVG_NY];    ///< frame that waits for its judgement: E, then Z [output unit]
    lpvg_span_t frame_span;
    int64_t frame_end_us;                     ///< time of the last sample of that frame              [us]
    lpvg_real_t history[LPVG_NHISTORY];       ///< margins of the last counted frames, a ring; 0: none yet [-]
    uint32_t next_history;                    ///< where the next margin goes
    lpvg_pool_t pool[LPVG_NPOOL];             ///< a ring of parts
    uint32_t part, in_part;                   ///< the newest part; its frames, counted or not
} lpvg_bin_t;

typedef struct lpvg_monitor_t {
    const lpvg_coeff_t* coeff;
    lpvg_model_t model;
    lpvg_energy_t energy;                     ///< `energy.ratio` may be read
    uint32_t energy_sum;                      ///< check sum of the filters, right sums and `fading` of `energy`
    uint32_t energy_quiet;                    ///< judgements since the energy test's last exceedance, energy_rearm at most
    lpvg_change_t change;                     ///< `change.ratio` and `change.estimate` may be read
    uint32_t change_quiet;                    ///< judgements since the change test's last exceedance, change_rearm at most
    lpvg_bin_t bin[LPVG_NBINS];
    lpvg_frame_t frame;                       ///< newest judged frame
    lpvg_frame_t record[LPVG_NRECORDS];
    uint32_t n_records, records_lost;         ///< records that wait; records lost because none was free
    uint32_t settled;                         ///< samples since the speed entered the range, saturating
    lpvg_taken_t block[LPVG_NBLOCK];          ///< newest samples, a ring
    /// e, then yhat of the newest samples: the ring twice, so that a block is in one piece. [output unit]
    lpvg_real_t signal[2 * LPVG_NBLOCK][2 * LPVG_NY];
    uint32_t newest, n_block;                 ///< index of the newest entry; number of entries since a start or a void
    uint32_t queue[LPVG_NBINS];               ///< bins whose frames wait to be judged, a ring
    uint32_t queue_first, n_queue;            ///< index of the first bin in the queue; number of bins in it
    uint32_t parts;                           ///< finished parts of the judgement of the first bin
    lpvg_real_t by_pairs;                     ///< intermediate result of these parts (margin.hpp)    [-]
    int64_t t_us;                             ///< time of the newest accepted sample                 [us]
    int64_t t_evidence_us, t_falsified_us,
        t_changed_us;  ///< end of the newest frame with evidence; newest alarm that refutes the certificate; newest other alarm [us]
    int64_t t_void_us;                        ///< frames that ended at or before this time are no evidence [us]
    bool running, has_evidence, has_falsified, has_changed, refused;  ///< started; the times above are known; the newest sample was refused
    uint32_t bad_samples, out_of_order, restarts;  ///< refused samples; ignored samples; restarts
    uint32_t repairs;  ///< restarts because of an impossible state, saturating
    uint32_t turn;  ///< newest checked bin
} lpvg_monitor_t;

/// Initialises *self. It keeps a reference to the coefficients; they must outlive it.
/// Returns bad_argument for NULL, or the status of lpvg_coeff_check. *self changes only with ok.
LPVG_NODISCARD lpvg_status_t lpvg_monitor_init(lpvg_monitor_t* self, const lpvg_coeff_t* coeff);

/// Takes the sample of one period.
/// Returns ok; bad_argument for NULL; not_ready before init.
/// Returns bad_sample when a number is NaN, infinite or outside its physical range, or when the state is impossible. The sample is
/// counted, the verdict is fault, and frames and model restart with the next good sample.
/// Returns out_of_order for a sample that is not newer than the last one. The sample is counted and ignored.
/// A time step below 0.5 or above 1.5 periods is a gap: frames and model restart.
LPVG_NODISCARD lpvg_status_t lpvg_monitor_push(lpvg_monitor_t* self, const lpvg_sample_t* sample);

/// Verdict at time now_us [us], on the clock of the samples. The hold time is the length of the longest frame.
/// Returns fault for NULL, before init, and for a now_us before the newest sample. Changes nothing.
lpvg_verdict_t lpvg_monitor_verdict(const lpvg_monitor_t* self, int64_t now_us);

/// Why the newest frame is no evidence. Returns none before the first frame and for NULL.
lpvg_reason_t lpvg_monitor_reason(const lpvg_monitor_t* self);

/// Newest judged frame. A new frame has a new `sequence`. Returns NULL for NULL and before init.
const lpvg_frame_t* lpvg_monitor_frame(const lpvg_monitor_t* self);

/// Moves the oldest record into *record and frees its place. Returns false when there is none, and for NULL.
/// While LPVG_NRECORDS records wait, further ones are only counted (`records_lost`).
bool lpvg_monitor_take_record(lpvg_monitor_t* self, lpvg_frame_t* record);

/// Discards the evidence. Every bin begins a new frame; only frames that begin after the call can make the verdict valid.
/// Falsifications and changes are kept. A gap in the samples has the same effect. Does nothing for NULL and before init.
void lpvg_monitor_void(lpvg_monitor_t* self);

LPVG_EXTERN_C_END
#endif
