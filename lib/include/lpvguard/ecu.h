/// @file ecu.h -- the guarded controller as one object: frames in, frames out, once per sample period.
///
/// A step judges and decodes what was received, cross-checks it and runs the controller. It feeds the monitor with the outputs
/// and the demand applied from this step on. It answers with two messages. The vehicle's report comes every step, end-to-end
/// protected: demand, statistic, verdict, supervision state. The trouble-code message DM1 comes in the first step, then every second.
///
/// Supervision is the worst state (can.h) among the messages that the loop needs:
///
///     live -- engaged when asked to be and no cause forbids it; the monitor is fed
///     hold -- a needed message is late: not engaged, the demand runs to zero within the rate limit; the monitor has a gap
///     off  -- a needed message is unusable, or a number was refused: the same, and a trouble code
///
/// Not engaged is the safe state: the demand reaches zero after at most the largest u_max / rate_max. The controller's state
/// follows the demand, so engaging again does not jump (controller.h). A message that went off must first deliver LPVG_CAN_RECOVER_FRAMES
/// good frames. A lost message shows as hold in the report of the first step later than LPVG_CAN_HOLD_MISSED + 1/2 of its periods after its
/// newest good frame.
///
/// Engagement: the causes LPVG_ECU_CAUSE_* release while they last, but for those that `report_only` of the configuration names.
/// After a release by any cause the loop engages again LPVG_ECU_WAIT_US after its causes have gone. A cause of LPVG_ECU_CAUSES_LATCHING
/// that ends an engagement locks it. After LPVG_ECU_RELEASES_MAX releases by faults, each within LPVG_ECU_RELEASES_US of the one before,
/// the next one locks. After LPVG_ECU_ENGAGEMENTS_MAX engagements within an hour, whatever ended them, the next one locks instead. An
/// acknowledgement forgets none of these counts. The speed leaves the controller's
/// range LPVG_ECU_SPEED_HYSTERESIS_MPS beyond its ends, so that noise at an end does not release, and is back within them.
/// What "no excitation" means for the monitor, verdict not_judged, permits engagement, and so does degraded. Outside the range a valid
/// verdict is reported as not_judged: it is about other speeds.
///
/// Evidence: a start, a gap, a release and a lock void the monitor's evidence: the verdict is valid only from frames that began since. The
/// watch (watch.h) judges the response from the first engaged sample on, behind a gap from LPVG_ECU_SETTLE_US on. What it finds makes the
/// verdict invalid. An engagement begins with LPVG_ECU_PROBE_SHARE of u_max. Evidence of the watch raises that to 1 within
/// LPVG_ECU_PROBE_US. A demand that rests at the limit for that long without evidence gets a step of another such share, which the watch
/// can judge.
///
/// Invalid: unless it is only reported, an invalid verdict stays and locks until it is acknowledged; time does not end it. An
/// acknowledgement is refused while a latching cause stands, and while the hour's engagements are used up. An invalid verdict is
/// acknowledged only after LPVG_ECU_CALM_US without engagement in which every message was live and no test falsified. That speaks against
/// sensors and disturbances alone: the response is judged on trial, while engaged. When that ends invalid, before a verdict was valid and
/// before the watch had evidence for LPVG_ECU_CALM_US, no further acknowledgement is taken until init.
///
/// Permission: the vehicle asks for control by its message (bus.h). Control counts after any other request has been seen since init.
/// While another command on the actuator has a higher priority than `priority`, while the brake pedal is beyond
/// LPVG_ECU_PEDAL_PERCENT, and while ABS acts, nothing is engaged. The request to acknowledge acts as lpvg_ecu_acknowledge where it
/// begins. The actuator is checked against the demand through a lag: LPVG_ECU_CAUSE_ACTUATOR.
///
/// Time: a step is taken half to one and a half sample periods after the newest one. Sooner it is refused. Up to LPVG_ECU_JUMP_US later
/// it is taken as a gap. Anything else is a jump of the clock: refused, until LPVG_ECU_RESYNC_CALLS refused calls have followed
/// each other by half to one and a half periods. The last of them is taken as a gap of LPVG_ECU_JUMP_US. A gap releases. The demand is
/// engaged while the mean period over the newest second, half a second after a gap, is the exported one to LPVG_ECU_PERIOD_PERCENT.
/// Monitor and supervision live on the ECU's own time `core_us`. It is the caller's clock up to the first jump, and never jumps.
///
/// Integrity: what the reactions need is kept twice, once with every bit inverted, and compared in every step. The coefficients' CRCs run
/// through in turn, a few words a step, at most LPVG_ECU_ROUND_US a round: damage is found within two. The demand that leaves a step is
/// within the kept limits, whatever the controller made of it. Anything found sets LPVG_ECU_CAUSE_CORRUPT until the next init: verdict
/// fault, neither controller nor monitor runs, and the demand goes to zero by the kept rate, at once where no copy of the kept values has
/// their sum. The monitor checks its own state in turn.
///
/// Use:     init once -> step every sample period with all frames received since the last step, in order of arrival ->
///          send what it returns. Ask for engagement with the configuration or lpvg_ecu_engage.
/// Cost:    constant apart from lpvg_can_receive for LPVG_ECU_FRAMES_IN frames at most; one controller step, one monitor push.
/// RAM:     sizeof(lpvg_ecu_t). No heap, no locks, no I/O, no clock of its own.
/// Threads: one instance per thread; interrupts may fill the queue of frames, not call in. Fields are for reading only.
#ifndef LPVGUARD_ECU_H
#define LPVGUARD_ECU_H

#include "lpvguard/bus.h"
#include "lpvguard/cause.h"
#include "lpvguard/controller.h"
#include "lpvguard/findings.h"
#include "lpvguard/monitor.h"
#include "lpvguard/watch.h"

#if LPVG_NK > 0

LPVG_EXTERN_C_BEGIN

#define LPVG_ECU_FRAMES_OUT 2U  ///< Most frames that one step returns.
#define LPVG_ECU_FRAMES_IN 20U  ///< Most frames that one step takes: what 250 kbit/s carry in 10 ms. Older ones are counted.
#define LPVG_ECU_JUMP_US 1000000U  ///< Longest gap that is taken at once                          [us]
#define LPVG_ECU_RESYNC_CALLS 3U  ///< Refused calls in step with each other that end a jump.
#define LPVG_ECU_WINDOW_US 1000000U  ///< The mean sample period is measured over this time          [us]
#define LPVG_ECU_PERIOD_PERCENT 2U  ///< Allowed deviation of the mean sample period                [%]

#define lpvg_ecu_config_t LPVG_SYM(ecu_config_t)
#define lpvg_ecu_t LPVG_SYM(ecu_t)
#define lpvg_ecu_clock_t LPVG_SYM(ecu_clock_t)
#define lpvg_ecu_kept_t LPVG_SYM(ecu_kept_t)
#define lpvg_ecu_init LPVG_SYM(ecu_init)
#define lpvg_ecu_engage LPVG_SYM(ecu_engage)
#define lpvg_ecu_step LPVG_SYM(ecu_step)
#define lpvg_ecu_acknowledge LPVG_SYM(ecu_acknowledge)
#define lpvg_ecu_findings LPVG_SYM(ecu_findings)
#define lpvg_ecu_explain LPVG_SYM(ecu_explain)

#define LPVG_ECU_SPEED_HYSTERESIS_MPS 0.25F  ///< Beyond an end of the range by more, the speed has left it [m/s]
#define LPVG_ECU_WAIT_US 500000U  ///< From the end of a cause to engagement                    [us]
#define LPVG_ECU_RELEASES_MAX 3U  ///< Releases by faults after which the next one locks.
#define LPVG_ECU_RELEASES_US 60000000U  ///< Time without one that forgets them                       [us]
#define LPVG_ECU_ENGAGEMENTS_MAX 60U  ///< Engagements within an hour, whatever ended them; the next one locks.
#define LPVG_ECU_SLOTS 16U  ///< They are counted in so many slots of LPVG_ECU_SLOT_US.
#define LPVG_ECU_SLOT_US 240000000U  ///< One slot less than all of them is an hour                 [us]
#define LPVG_ECU_CALM_US 10000000U  ///< Without doubt before an invalid verdict may be acknowledged; evidence that ends a trial [us]
#define LPVG_ECU_SETTLE_US 1000000U  ///< From the newest gap to what the watch judges           [us]
#define LPVG_ECU_PROBE_SHARE 0.25F  ///< Share of u_max at which an engagement begins                 [-]
#define LPVG_ECU_PROBE_US 500000U  ///< Evidence for so long raises it to 1; so does each so long at the limit by another such share [us]

#define LPVG_ECU_CAUSE_NOT_ASKED 0x0001U  ///< Nobody asks for engagement.
#define LPVG_ECU_CAUSE_MESSAGE 0x0002U  ///< A needed message is not live.
#define LPVG_ECU_CAUSE_REFUSED 0x0004U  ///< The controller or the monitor refused its sample of the newest step.
#define LPVG_ECU_CAUSE_TIME 0x0008U  ///< The sample period is not measured yet, or is another one.
#define LPVG_ECU_CAUSE_RANGE 0x0010U  ///< The speed is outside the controller's scheduling range.
#define LPVG_ECU_CAUSE_UNJUDGED 0x0020U  ///< The newest verdict is unknown, stale or fault.
#define LPVG_ECU_CAUSE_INVALID 0x0040U  ///< The newest verdict is invalid.
#define LPVG_ECU_CAUSE_IMPLAUSIBLE 0x0080U  ///< Sensors contradict each other.
#define LPVG_ECU_CAUSE_OVERRIDE 0x0400U  ///< The driver brakes, or ABS acts.
#define LPVG_ECU_CAUSE_PERMISSION 0x0800U  ///< The vehicle does not ask for control, or another command goes first.
#define LPVG_ECU_CAUSE_ACTUATOR 0x1000U  ///< The actuator does not do what is demanded.
#define LPVG_ECU_CAUSE_OFTEN 0x4000U  ///< Engaged LPVG_ECU_ENGAGEMENTS_MAX times within the last hour.
#define LPVG_ECU_CAUSE_CORRUPT 0x2000U  ///< Coefficients, kept values or state are damaged; until init.
#define LPVG_ECU_CAUSE_WAIT 0x0100U  ///< The other causes have gone less than LPVG_ECU_WAIT_US ago.
#define LPVG_ECU_CAUSE_LOCKED 0x0200U  ///< Waiting for lpvg_ecu_acknowledge.

/// What `report_only` may name.
#define LPVG_ECU_CAUSES_OPTIONAL (LPVG_ECU_CAUSE_UNJUDGED | LPVG_ECU_CAUSE_INVALID | LPVG_ECU_CAUSE_IMPLAUSIBLE | LPVG_ECU_CAUSE_ACTUATOR)
/// What locks when it ends an engagement.
#define LPVG_ECU_CAUSES_LATCHING (LPVG_ECU_CAUSE_INVALID | LPVG_ECU_CAUSE_IMPLAUSIBLE | LPVG_ECU_CAUSE_ACTUATOR)
/// Releases that are no fault: LPVG_ECU_RELEASES_MAX does not count them, LPVG_ECU_ENGAGEMENTS_MAX does.
#define LPVG_ECU_CAUSES_ORDINARY (LPVG_ECU_CAUSE_NOT_ASKED | LPVG_ECU_CAUSE_RANGE | LPVG_ECU_CAUSE_OVERRIDE | LPVG_ECU_CAUSE_PERMISSION)

#define LPVG_ECU_ROUND_US 5000000U  ///< Longest round of the coefficients; damage is found within two       [us]
#define LPVG_ECU_ACTUATOR_US 500000U  ///< Time constant of the check of the actuator                [us]
#define LPVG_ECU_PEDAL_PERCENT 2.0F  ///< The driver brakes beyond this pedal position                    [%]

/// What the newest step says of itself on the bus.
typedef enum lpvg_ecu_engagement_t {
    lpvg_ecu_released = 0,
    lpvg_ecu_engaged = 1,
    lpvg_ecu_locked = 2  ///< Released, until it is acknowledged.
} lpvg_ecu_engagement_t;

/// Limits of the check of the actuator against the lagged demand of rms x. Means forget with LPVG_ECU_ACTUATOR_US. The deviation violates
/// where its part along the demand is above relative x + tolerance, or its rms above x + tolerance. All are finite, and > 0 where
/// nothing else is said. An actuator stuck at 0 must violate them at the largest demand: tolerance < (1 - relative) u_max.
typedef struct lpvg_ecu_actuator_limits_t {
    float lag_s;  ///< from demand to measured value, as a first-order lag                [s]
    float tolerance;  ///< absolute part of the allowed deviation                               [input unit]
    uint16_t confirm;  ///< samples by which violations must outnumber agreements
    float relative;  ///< part in proportion to the rms x of the lagged demand, 0 .. below 1    [-]
} lpvg_ecu_actuator_limits_t;

/// Zero is safe: not asked, and every cause releases.
typedef struct lpvg_ecu_config_t {
    bool engage;  ///< asked for engagement from the start
    uint16_t report_only;  ///< causes of LPVG_ECU_CAUSES_OPTIONAL that are reported and do not release
    uint8_t priority;  ///< other_priority (bus.h) up to which control is permitted, 0 .. 3
    lpvg_can_plausibility_limits_t plausibility;  ///< limits of the cross-checks
    lpvg_ecu_actuator_limits_t actuator;  ///< limits of the check of the actuator
} lpvg_ecu_config_t;

/// Findings that DM1 tells. Of those that are active it sends the gravest: corrupt, refused, time, message, invalid, actuator,
/// implausible, locked, degraded.
typedef enum lpvg_ecu_fault_t {
    lpvg_ecu_fault_none = 0,
    lpvg_ecu_fault_refused = 1,  ///< Speed or a measurement was refused, or the controller's numbers broke down.
    lpvg_ecu_fault_message = 2,  ///< A needed message is not live.
    lpvg_ecu_fault_invalid = 3,  ///< The model is falsified.
    lpvg_ecu_fault_implausible = 4,  ///< Sensors contradict each other.
    lpvg_ecu_fault_time = 5,  ///< The mean sample period is not the exported one.
    lpvg_ecu_fault_locked = 6,  ///< The loop waits for an acknowledgement.
    lpvg_ecu_fault_actuator = 7,  ///< The actuator does not do what is demanded.
    lpvg_ecu_fault_corrupt = 8,  ///< Coefficients, kept values or state are damaged.
    lpvg_ecu_fault_degraded = 9  ///< The change test spoke: the vehicle is another than the one identified. It releases nothing.
} lpvg_ecu_fault_t;

#define LPVG_ECU_SPN_REFUSED 520200U  ///< Trouble codes without a standard number (J1939-73 leaves these to makers).
#define LPVG_ECU_SPN_INVALID 520201U
#define LPVG_ECU_SPN_IMPLAUSIBLE 520202U
#define LPVG_ECU_SPN_TIME 520203U
#define LPVG_ECU_SPN_LOCKED 520204U
#define LPVG_ECU_SPN_ACTUATOR 520205U
#define LPVG_ECU_SPN_CORRUPT 520206U
#define LPVG_ECU_SPN_DEGRADED 520207U

/// What is known of the sample period.
typedef enum lpvg_ecu_pace_t {
    lpvg_ecu_pace_unknown = 0,  ///< Not measured since init or the newest gap.
    lpvg_ecu_pace_good = 1,  ///< The exported one.
    lpvg_ecu_pace_bad = 2  ///< Another one.
} lpvg_ecu_pace_t;

/// The clock of the steps.
typedef struct lpvg_ecu_clock_t {
    int64_t jump_us;  ///< newest refused call                                         [us]
    int64_t half_us;  ///< core_us when the current half window began                  [us]
    uint32_t before_us;  ///< length of the half window before; 0: none                   [us]
    uint32_t steps;  ///< in the current half window
    uint32_t refused;  ///< calls refused for their time, saturating
    uint32_t gaps;  ///< gaps and jumps taken, saturating
    uint8_t in_step;  ///< refused calls that followed each other in step
    uint8_t pace;  ///< lpvg_ecu_pace_t
    bool started;  ///< a step has been taken
} lpvg_ecu_clock_t;

/// What the reactions need, kept twice.
typedef struct lpvg_ecu_kept_t {
    const lpvg_coeff_t* coeff;
    const lpvg_control_coeff_t* control;
    lpvg_ecu_config_t config;
    lpvg_real_t u_max;  ///< largest of all nodes                                       [input unit]
    lpvg_real_t rate_max;  ///< largest |change of demand|                              [input unit/s]
    lpvg_real_t speed_min;  ///< lowest of the controller's scheduling range                [m/s]
    lpvg_real_t speed_max;  ///< highest of it                                              [m/s]
    lpvg_real_t demand;  ///< newest                                                     [input unit]
    lpvg_watch_limits_t watch;  ///< limits of the check of the response
    int64_t now_us;  ///< of the newest step, the caller's clock                          [us]
    uint32_t period_us;  ///< sample period                                                [us]
    bool engage;  ///< asked for
    bool locked;  ///< until acknowledged
    bool standby;  ///< a request other than control has been seen since init
    bool corrupt;  ///< until init
    bool falsified;  ///< the verdict is invalid, until acknowledged
    bool on_trial;  ///< an invalid verdict was acknowledged, and nothing has spoken for the response since
} lpvg_ecu_kept_t;

typedef struct lpvg_ecu_t {
    lpvg_ecu_kept_t kept;
    uint32_t inverted[sizeof(lpvg_ecu_kept_t) / sizeof(uint32_t)];  ///< its words with every bit inverted
    uint32_t sum;  ///< of its words
    uint32_t crc;  ///< of the coefficients in this round, so far
    uint32_t next_item;  ///< of the model's coefficients, then of the controller's
    uint32_t rounds;  ///< complete, saturating
    lpvg_can_supervisor_t supervisor;
    lpvg_can_plausibility_t plausibility;
    lpvg_bus_signals_t signals;
    float expected;  ///< demand through the actuator's lag                           [input unit]
    int64_t live_us;  ///< core_us of the newest step that was not live                    [us]
    float deviation_along;  ///< mean of (measured value - expected) expected                [input unit squared]
    float deviation_square;  ///< mean square of measured value - expected                [input unit squared]
    float expected_square;  ///< mean square of expected                                   [input unit squared]
    uint16_t deviations;  ///< score of the check of the actuator
    bool actuator_failed;  ///< as that check stands
    lpvg_control_t control;
    lpvg_monitor_t monitor;
    lpvg_bus_report_t report;  ///< as sent by the newest step
    lpvg_ecu_fault_t fault;  ///< gravest active
    int64_t now_us;  ///< of the newest step, the caller's clock; init's before the first; for reading: a step takes the kept one [us]
    int64_t core_us;  ///< of the newest step, the ECU's own time                      [us]
    lpvg_ecu_clock_t clock;
    int64_t dm1_us;  ///< core_us when DM1 was sent                                   [us]
    int64_t caused_us;  ///< core_us when waiting began, the newest time             [us]
    int64_t released_us;  ///< core_us of the newest release by a fault                    [us]
    int64_t doubted_us;  ///< core_us of the newest step that was engaged, not live, or in which a test falsified [us]
    int64_t slot_us;  ///< core_us when the current slot began                           [us]
    uint8_t engagements[LPVG_ECU_SLOTS];  ///< of each slot, a ring
    uint8_t slot;  ///< the current one
    lpvg_watch_t watch;  ///< of the response, while engaged
    lpvg_real_t share;  ///< of u_max that the demand may take                             [-]
    uint32_t limited;  ///< control.limited of the newest step
    uint32_t settled_us;  ///< since the newest gap, up to LPVG_ECU_SETTLE_US           [us]
    uint32_t trial_us;  ///< evidence of the watch since the newest acknowledgement of an invalid verdict [us]
    uint32_t pressed_us;  ///< how long the demand has rested at its limit without evidence    [us]
    bool watched;  ///< the watch runs: the newest step was engaged
    uint16_t causes;  ///< LPVG_ECU_CAUSE_* of the newest step, report_only ones included
    uint16_t lock_causes;  ///< what locked, 0 where nothing has since init
    uint8_t releases;  ///< by faults, as LPVG_ECU_RELEASES_MAX counts them
    bool in_range;  ///< the speed, with hysteresis
    bool acknowledging;  ///< the newest request was to acknowledge
    bool permitted;  ///< no cause released the newest step
    bool was_engaged;  ///< since init
    bool refused;  ///< speed or a measurement of the newest step was refused: the next is not engaged
    bool seen_live;  ///< supervision has been live since init
    uint32_t dropped;  ///< older frames beyond LPVG_ECU_FRAMES_IN of a step, saturating
    uint8_t counter;  ///< of the report message's protection
    uint8_t occurrence;  ///< times a trouble code became active, 126 at most
    uint8_t explained;  ///< failure mode of the codes invalid and degraded, LPVG_CAN_FMI_*
} lpvg_ecu_t;

/// Makes *self ready at time now_us, 0 .. INT64_MAX / 2. Coefficients stay referenced and must outlive it.
/// Returns bad_argument (NULL, now_us outside, report_only with another bit, a priority or limit outside its range).
/// Returns what lpvg_coeff_check or lpvg_control_coeff_check say, or bad_value when the two sample periods differ or are above a
/// quarter of LPVG_ECU_WINDOW_US.
/// *self is untouched unless ok is returned.
LPVG_NODISCARD lpvg_status_t lpvg_ecu_init(lpvg_ecu_t* self, const lpvg_coeff_t* coeff, const lpvg_control_coeff_t* control,
                                           const lpvg_ecu_config_t* config, int64_t now_us);

/// Asks for engagement or release from the next step on. Nothing for NULL.
void lpvg_ecu_engage(lpvg_ecu_t* self, bool engage);

/// Ends a lock from the next step on, unless what stands forbids it (see Invalid above). Returns whether the loop is not locked any more;
/// false for NULL.
bool lpvg_ecu_acknowledge(lpvg_ecu_t* self);

/// One sample period. frames_in [n_in] may be NULL when n_in is 0; a time stamp after now_us counts as now_us.
/// *n_out frames are written to frames_out, with time now_us. Returns ok; bad_argument (NULL, or max_out < LPVG_ECU_FRAMES_OUT),
/// not_ready (no init), out_of_order (a time that is refused, see above; the first step: before init or beyond INT64_MAX / 2).
/// Unless it is ok, nothing is received or sent, nothing but `clock` is changed, and *n_out, where given, is 0.
LPVG_NODISCARD lpvg_status_t lpvg_ecu_step(lpvg_ecu_t* self, int64_t now_us, const lpvg_can_frame_t* frames_in, size_t n_in,
                                           lpvg_can_frame_t* frames_out, size_t max_out, size_t* n_out);

/// What is wrong after the newest step, for lpvg_j1939_step: every finding that is active, in the order of lpvg_ecu_fault_t's gravity, each
/// message that is not live by itself. The freeze frame holds the causes, the speed, the time of the step on the caller's clock, and of
/// the newest judged frame bin and statistic. While the verdict is invalid these are of the newest recorded alarm, where one waits.
/// Returns ok; bad_argument (NULL), not_ready (no init), *findings is untouched then.
LPVG_NODISCARD lpvg_status_t lpvg_ecu_findings(const lpvg_ecu_t* self, lpvg_j1939_findings_t* findings);

/// What the newest alarm's cause is: from the next step on the codes invalid and degraded carry its failure mode. Gain and sign: out of
/// calibration. Delay: abnormal update rate. Bias: data drifted high, or low. Frozen: abnormal rate of change. Noise: data erratic. Other:
/// root cause not known. NULL and unknown: condition exists, as after init. Call it with what lpvg_diagnosis_named says whenever that may
/// have changed. Nothing for NULL self.
void lpvg_ecu_explain(lpvg_ecu_t* self, const lpvg_found_t* found);

LPVG_EXTERN_C_END

#endif
#endif
