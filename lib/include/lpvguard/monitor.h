/// @file monitor.h -- does the nominal LPV model still describe this vehicle as well as it was designed for?
///
/// Every sample advances the nominal model and forms the nominal error e = y - yhat. It updates Hann frames of e and yhat
/// in LPVG_NBINS bins (DC first; THEORY 3.2). A bin completes a frame every half frame. The frame's *margin* is
///
///     t* = min over complex d of max( |d| / W_delta, |E_j - d Z_j| / B_w,j for each output j )        (T17)
///
/// the least common inflation of the fitted uncertainty and disturbance bounds that explains the frame. It is exact, in closed form.
/// Where every output has a Delta of its own (S1_diagonal, LPVG_NDELTA = LPVG_NY), so has d_j and W_delta,j:
///
///     t* = max over j of |E_j| / (B_w,j + W_delta,j |Z_j|)
///
/// With t* > 1 no complex number d (no d_j) within W_delta and no disturbance within B_w explain this frame in this bin.
/// It does not refute every causal Delta of a certificate. Of those that forget fast enough the energy test speaks, given its sigma.
///
/// A frame *counts* when the model had settled and the speed kept two limits: the scheduling range, and `speed_tolerance` around
/// the frame's mean. The bin's *statistic* is the k-th largest margin of its last m counted frames. A statistic above `threshold`
/// falsifies the model (frame test). The *evidence* is the margin that a vehicle which did not respond at all would have shown (T18).
/// A frame whose evidence is at or below the threshold is "not excited". It could have falsified no vehicle, so it does not make
/// the verdict valid.
///
/// The energy test (energy.h) takes every sample and is judged in every push that judges no frame. Its *ratio* above
/// `energy_threshold` falsifies the model too. The first such ratio after `energy_rearm` judgements without one is recorded as an
/// alarm. A sample out of the scheduling range, a gap and a refused sample restart the test from rest. It is not judged until the
/// model and F have settled.
///
/// The change test (change.h) takes every settled block of LPVG_NBLOCK samples. In the pushes after it each output is judged once, in one
/// that closes no frame; where the next block ends before, this one is lost. Its *ratio* above `change_threshold` says that the vehicle is
/// not the one that was identified. It refutes no bound, so the verdict is "degraded", not "invalid". The first such ratio after
/// `change_rearm` judgements without one is recorded as an alarm.
///
/// Integrity: every push checks what indexes its state, one bin in turn. State that cannot be is as a refused sample, after which
/// everything starts anew. A sum of the energy test that is not finite falsifies, and that test starts anew. Damaged coefficients make
/// wrong verdicts, but no access outside of the objects: ecu.h checks them in turn.
///
/// Use:     init once -> push one sample per period -> verdict, frame and records at any time.
/// Cost:    even over pushes. A bin takes up LPVG_NBLOCK samples at once, a quarter of the bins each push. At most one frame
///          is judged per push, over LPVG_NPARTS pushes, and none in a push that closes several. A frame is therefore judged at the
///          latest LPVG_NLATENCY samples after its end. One that ends fewer than LPVG_NBLOCK samples before a gap is dropped.
///          Instructions on three targets: `lpvguard bench core`. No heap, no locks, no I/O.
/// Threads: one instance per thread; nothing here may be called from two contexts at once. RAM: sizeof(lpvg_monitor_t).
///          Fields are private; the layout may change.
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
#define lpvg_monitor_init LPVG_SYM(monitor_init)
#define lpvg_monitor_push LPVG_SYM(monitor_push)
#define lpvg_monitor_verdict LPVG_SYM(monitor_verdict)
#define lpvg_monitor_reason LPVG_SYM(monitor_reason)
#define lpvg_monitor_frame LPVG_SYM(monitor_frame)
#define lpvg_monitor_take_record LPVG_SYM(monitor_take_record)
#define lpvg_monitor_void LPVG_SYM(monitor_void)

typedef enum lpvg_verdict_t {
    lpvg_verdict_unknown = 0,     ///< No frame has ended yet. Zero: cleared memory never reads "valid".
    lpvg_verdict_valid = 1,       ///< Within the last hold time a frame with evidence counted, none falsified, nothing changed.
    lpvg_verdict_invalid = 2,     ///< A frame or the energy test falsified the model within the last hold time.
    lpvg_verdict_not_judged = 3,  ///< Frames ended, but none within the hold time is evidence: see lpvg_reason_t.
    lpvg_verdict_stale = 4,       ///< The newest sample is older than five sample periods.
    lpvg_verdict_fault = 5,       ///< The newest sample was refused, or the arguments are wrong.
    lpvg_verdict_degraded =
        6     ///< Not invalid, but the change test spoke within the last hold time: within the bounds, if they hold, and changed.
} lpvg_verdict_t;

/// Why the newest frame did not count as evidence.
typedef enum lpvg_reason_t {
    lpvg_reason_none = 0,          ///< It did.
    lpvg_reason_not_excited = 1,   ///< Counted, but too little excitation: even a dead vehicle would have passed.
    lpvg_reason_speed_moved = 2,   ///< Speed moved more than the frame allows.
    lpvg_reason_out_of_range = 3,  ///< Speed outside the scheduling range.
    lpvg_reason_settling = 4       ///< The model's initial state had not decayed.
} lpvg_reason_t;

/// What a record tells of.
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

/// One frame of one bin, as it was judged; or, among the records only, an alarm of the energy test. Of an alarm, `bin` is
/// band * LPVG_NDIRECTIONS + direction (energy.h). Both `margin` and `statistic` are the ratio, and `evidence` is the ratio that a
/// vehicle which did not respond would have shown. `speed` is the sample's. E[j][0] is the norm of F e_j and Z[j][0]
/// lpvg_energy_explained; the imaginary parts are 0.
/// Of an alarm of the change test `bin` is the output times 3 plus the part of the estimate (0 gain, 1 delay, 2 bias). `evidence` is the
/// ratio of a lost output, a gain of -1. E[0] holds gain and delay of that output, Z[0][0] its bias; the rest is 0.
typedef struct lpvg_frame_t {
    uint32_t sequence;             ///< number of frames closed so far, this one included; 0: none yet
    lpvg_test_t test;              ///< what the record tells of
    uint32_t bin;                  ///< 0 is DC
    int64_t t_end_us;              ///< time of the frame's last sample                    [us]
    lpvg_reason_t reason;          ///< none or not_excited: it counted; else why not, and the rest is zero
    bool falsified;                ///< statistic above the threshold
    lpvg_real_t speed;             ///< mean speed                                         [m/s]
    lpvg_real_t margin;            ///< t*; 1: exactly explained by the fitted bounds      [-]
    lpvg_real_t statistic;         ///< k-th largest of the bin's last m margins, 0 before there are k [-]
    lpvg_real_t evidence;          ///< margin of a vehicle that does not respond          [-]
    lpvg_real_t E[LPVG_NY][2];     ///< nominal error, real and imaginary part             [output unit]
    lpvg_real_t Z[LPVG_NY][2];     ///< nominal output, likewise                           [output unit]
} lpvg_frame_t;

/// Sums over half a frame of e and yhat times the exponential: plain, and with the rising half of the window.
typedef struct lpvg_sum_t {
    lpvg_real_t plain_re[2 * LPVG_NY], plain_im[2 * LPVG_NY];    ///< plain, of e then yhat                    [output unit]
    lpvg_real_t rising_re[2 * LPVG_NY], rising_im[2 * LPVG_NY];  ///< with the rising half of the window, likewise [output unit]
} lpvg_sum_t;

/// What the speed did over half a frame.
typedef struct lpvg_span_t {
    lpvg_real_t speed_low;                    ///< lowest speed                                       [m/s]
    lpvg_real_t speed_high;                   ///< highest speed                                      [m/s]
    lpvg_real_t speed_sum;                    ///< sum over the samples                               [m/s]
    lpvg_reason_t reason;                     ///< why it is no evidence
} lpvg_span_t;

/// What the bins keep of a sample besides its signals.
typedef struct lpvg_taken_t {
    int64_t t_us;                             ///< time of the sample                                 [us]
    lpvg_span_t span;                         ///< of this one sample
} lpvg_taken_t;

typedef struct lpvg_bin_t {
    uint32_t n;                               ///< samples in the current half frame
    lpvg_real_t phasor[2], window[2];         ///< exp(j phase) and exp(j window phase) / 2 of the next sample [-]
    lpvg_sum_t sum;                           ///< current half
    lpvg_span_t span, span_before;            ///< current and previous half
    lpvg_real_t rising_re[2 * LPVG_NY], rising_im[2 * LPVG_NY];  ///< rising sums of the previous half [output unit]
    bool has_before;                          ///< previous half complete
    lpvg_real_t frame_re[2 * LPVG_NY], frame_im[2 * LPVG_NY];    ///< frame that waits to be judged: E then Z [output unit]
    lpvg_span_t frame_span;
    int64_t frame_end_us;                     ///< time of its last sample                            [us]
    lpvg_real_t history[LPVG_NHISTORY];       ///< margins of the last counted frames, a ring; 0: none yet [-]
    uint32_t next_history;                    ///< where the next margin goes
} lpvg_bin_t;

typedef struct lpvg_monitor_t {
    const lpvg_coeff_t* coeff;
    lpvg_model_t model;
    lpvg_energy_t energy;                     ///< `energy.ratio` may be read
    uint32_t energy_sum;                      ///< of the words of its filters, right sums and `fading`, after the newest sample
    uint32_t energy_quiet;                    ///< judgements since the energy test's last exceedance, energy_rearm at most
    lpvg_change_t change;                     ///< `change.ratio` and `change.estimate` may be read
    uint32_t change_quiet;                    ///< judgements since the change test's last exceedance, change_rearm at most
    lpvg_bin_t bin[LPVG_NBINS];
    lpvg_frame_t frame;                       ///< newest judged frame
    lpvg_frame_t record[LPVG_NRECORDS];
    uint32_t n_records, records_lost;         ///< records that wait; those that found no place
    uint32_t settled;                         ///< samples since the speed entered the range, saturating
    lpvg_taken_t block[LPVG_NBLOCK];          ///< newest samples, a ring
    /// e, then yhat of the newest samples: the ring twice, so that a block is in one piece. [output unit]
    lpvg_real_t signal[2 * LPVG_NBLOCK][2 * LPVG_NY];
    uint32_t newest, n_block;                 ///< its newest entry; entries since the start, LPVG_NBLOCK at most
    uint32_t queue[LPVG_NBINS];               ///< bins whose frames wait to be judged, a ring
    uint32_t queue_first, n_queue;            ///< first of the queue; how many wait
    uint32_t parts;                           ///< parts done of the judgement of the first in the queue
    lpvg_real_t by_pairs;                     ///< what they found (margin.hpp)                       [-]
    int64_t t_us;                             ///< time of the newest accepted sample                 [us]
    int64_t t_evidence_us, t_falsified_us, t_changed_us;  ///< ends of the newest frames with evidence / that falsified; newest change [us]
    int64_t t_void_us;  ///< frames that ended until then are no evidence       [us]
    bool running, has_evidence, has_falsified, has_changed, refused;  ///< started; which times are known; the newest sample was refused
    uint32_t bad_samples, out_of_order, restarts;  ///< samples refused; samples ignored; starts anew
    uint32_t repairs;  ///< times that its state could not be, saturating
    uint32_t turn;  ///< bin that was checked last
} lpvg_monitor_t;

/// Makes *self ready; coefficients stay referenced and must outlive it.
/// Returns bad_argument for NULL, or what lpvg_coeff_check says; *self is untouched unless ok is returned.
LPVG_NODISCARD lpvg_status_t lpvg_monitor_init(lpvg_monitor_t* self, const lpvg_coeff_t* coeff);

/// Takes the sample of one period. Returns ok; bad_argument (NULL); not_ready (no init).
/// Returns bad_sample when a number is NaN, Inf or outside its physical range, or when its state cannot be. It is counted, the verdict is
/// fault, and frames and model restart with the next good sample. Returns out_of_order for a sample not newer than the last: counted,
/// ignored. A step in time of less than half or more than one and a half periods restarts frames and model; nothing is bridged.
LPVG_NODISCARD lpvg_status_t lpvg_monitor_push(lpvg_monitor_t* self, const lpvg_sample_t* sample);

/// Verdict at time now_us on the clock of the samples. Pure function; NULL, no init or now_us before the newest sample
/// give fault. The hold time is the length of the longest frame.
lpvg_verdict_t lpvg_monitor_verdict(const lpvg_monitor_t* self, int64_t now_us);

/// Why the newest frame was no evidence; none before the first frame and for NULL.
lpvg_reason_t lpvg_monitor_reason(const lpvg_monitor_t* self);

/// The newest closed frame; its `sequence` tells whether there is a new one. NULL for NULL or before init.
const lpvg_frame_t* lpvg_monitor_frame(const lpvg_monitor_t* self);

/// Moves the oldest recorded falsifying frame into *record and frees its place. False when there is none or for NULL.
/// While LPVG_NRECORDS frames wait, further ones are only counted.
bool lpvg_monitor_take_record(lpvg_monitor_t* self, lpvg_frame_t* record);

/// Voids the evidence: every bin begins a new frame, and the verdict is valid only from frames that began after the call. What falsified
/// and what changed stays. So does a gap in the samples. Nothing for NULL or before init.
void lpvg_monitor_void(lpvg_monitor_t* self);

LPVG_EXTERN_C_END
#endif
