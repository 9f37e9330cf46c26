/// @file ecu.h -- the guarded controller as one object: frames in, frames out, once per sample period.
///
/// A step decodes and checks the received frames, runs the controller and feeds the monitor. The monitor gets the outputs and the demand
/// that is applied from this step on. The step returns up to two messages. The report to the vehicle is sent in every step, with
/// end-to-end protection. It holds the demand, the statistic, the verdict and the supervision state. The trouble-code message DM1 is sent
/// in the first step and then every second.
///
/// Supervision. Its state is the worst state (can.h) of the messages that the loop needs:
///
///     live -- The loop engages when it is asked to and no cause forbids it. The monitor gets samples.
///     hold -- A needed message is late. The loop is released: the demand runs to zero within the rate limit. The monitor has a gap.
///     off  -- A needed message is unusable, or a number was refused. As hold, with a trouble code.
///
/// Released is the safe state. The demand reaches zero after at most the largest u_max / rate_max. The controller's state follows the
/// demand, so a new engagement does not jump (controller.h). A message in state off returns to live after LPVG_CAN_RECOVER_FRAMES good
/// frames. The report shows the loss of a message as hold once its newest good frame is older than LPVG_CAN_HOLD_MISSED + 1/2 of its
/// periods.
///
/// Engagement. The causes LPVG_ECU_CAUSE_* release the loop while they last. The causes in `report_only` of the configuration are
/// reported and release nothing. The loop engages again LPVG_ECU_WAIT_US after the last cause has gone. These rules lock the loop:
///
///     A cause of LPVG_ECU_CAUSES_LATCHING locks when it ends an engagement.
///     After LPVG_ECU_RELEASES_MAX releases by faults, each within LPVG_ECU_RELEASES_US of the previous one, the next one locks.
///     After LPVG_ECU_ENGAGEMENTS_MAX engagements within an hour, the next engagement locks instead.
///
/// An acknowledgement resets none of these counts. The speed counts as outside the scheduling range once it is more than
/// LPVG_ECU_SPEED_HYSTERESIS_MPS beyond an end. It counts as inside again once it is within the ends. Noise at an end therefore
/// does not release. The verdicts not_judged and degraded permit engagement. Outside the range, a valid or degraded verdict is reported
/// as not_judged, because it holds for other speeds.
///
/// Evidence. A start, a gap, a release and a lock void the monitor's evidence. Only frames that began afterwards can make the verdict
/// valid. The watch (watch.h) judges the response from the first engaged sample on. After a gap it judges from LPVG_ECU_SETTLE_US on.
/// A violation makes the verdict invalid. An engagement begins with the share LPVG_ECU_PROBE_SHARE of u_max. Evidence of the watch for
/// LPVG_ECU_PROBE_US raises the share to 1. Where the evidence lapses, the share falls back within LPVG_ECU_AGE_US. If the demand rests
/// at its limit for LPVG_ECU_PROBE_US without evidence, the share does not fall: it rises by one step of LPVG_ECU_PROBE_SHARE. The watch
/// can judge such a step.
///
/// Invalid verdict. It lasts and locks the loop until it is acknowledged, unless `report_only` names it. An acknowledgement is refused
/// while a latching cause is present, and while the engagements of the hour are used up. An invalid verdict can only be acknowledged
/// after LPVG_ECU_CALM_US without engagement. During that time every message must have been live, and no test may have falsified the
/// model. This excludes faulty sensors and disturbances, but says nothing about the response. The response is judged on trial, while
/// engaged. The trial ends well with a valid verdict, or with evidence of the watch for LPVG_ECU_CALM_US. If the verdict becomes
/// invalid during the trial, no further acknowledgement is taken until init. The same holds once the watch has found a wrong response,
/// because a released loop gives no evidence on the response.
///
/// Permission. The vehicle asks for control with its request message (bus.h). A request for control counts once another request has been
/// received since init. Nothing is engaged while another command on the actuator has a higher priority than `priority`. Nothing is
/// engaged while the brake pedal is beyond LPVG_ECU_PEDAL_PERCENT, or while ABS acts. A request to acknowledge acts once, when it begins,
/// as lpvg_ecu_acknowledge does. The measured output of the first actuator is compared with the lagged demand: LPVG_ECU_CAUSE_ACTUATOR.
///
/// Time. A step is due one sample period after the previous one, and is taken from half a period on. An earlier call is refused. A call
/// more than one and a half periods and at most LPVG_ECU_JUMP_US after the previous step is taken as a gap. Any other time is a jump of
/// the clock, and the call is refused. After LPVG_ECU_RESYNC_CALLS such calls at distances of half to one and a half periods, the last
/// one is taken as a gap of LPVG_ECU_JUMP_US. A gap releases. The loop engages only while the mean sample period is within
/// LPVG_ECU_PERIOD_PERCENT of the exported one. The mean is taken over one second, or over half a second after a gap. Monitor and
/// supervision use the ECU's own time `core_us`. It equals the caller's clock up to the first jump, and never jumps.
///
/// Integrity. The values that the reactions need are kept twice, once with every bit inverted. Each step compares the two copies. Each
/// step also adds a few coefficients to a running CRC. One round over all coefficients takes at most LPVG_ECU_ROUND_US, so damage is
/// found within two rounds. Each step limits the demand to the kept limits, whatever the controller has computed. Any damage sets
/// LPVG_ECU_CAUSE_CORRUPT until the next init. The verdict is then fault, controller and monitor do not run, and the demand runs to zero
/// at the kept rate. If neither copy of the kept values matches its sum, the demand is zero at once. The monitor checks its own state.
///
/// Use:     init once -> step every sample period with all frames received since the last step, in order of arrival ->
///          send the returned frames. Ask for engagement in the configuration or with lpvg_ecu_engage.
/// Cost:    constant, apart from lpvg_can_receive for at most LPVG_ECU_FRAMES_IN frames: one controller step, one monitor push.
/// RAM:     sizeof(lpvg_ecu_t). No heap, no locks, no I/O, no clock of its own.
/// Threads: one instance per thread. Interrupts may fill the queue of frames but must not call these functions. Fields are read-only.
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
#define LPVG_ECU_FRAMES_IN 20U  ///< Most frames that one step takes: 10 ms of 250 kbit/s. Older frames are dropped and counted.
#define LPVG_ECU_JUMP_US 1000000U  ///< Longest gap that a step takes at once                       [us]
#define LPVG_ECU_RESYNC_CALLS 3U  ///< Consecutive refused calls, a period apart, that end a jump.
#define LPVG_ECU_WINDOW_US 1000000U  ///< Time over which the mean sample period is measured         [us]
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

#define LPVG_ECU_SPEED_HYSTERESIS_MPS 0.25F  ///< Distance beyond an end at which the speed has left the range [m/s]
#define LPVG_ECU_WAIT_US 500000U  ///< Time from the end of the last cause to engagement        [us]
#define LPVG_ECU_RELEASES_MAX 3U  ///< Number of releases by faults after which the next one locks.
#define LPVG_ECU_RELEASES_US 60000000U  ///< Time without a release by a fault that resets their number [us]
#define LPVG_ECU_ENGAGEMENTS_MAX 60U  ///< Most engagements within an hour; the next one locks.
#define LPVG_ECU_SLOTS 16U  ///< Number of time slots in which engagements are counted.
#define LPVG_ECU_SLOT_US 240000000U  ///< Length of a slot; all slots but one make an hour           [us]
#define LPVG_ECU_CALM_US 10000000U  ///< Calm time before an acknowledgement of an invalid verdict; also the evidence that ends a trial [us]
#define LPVG_ECU_SETTLE_US 1000000U  ///< Time after the newest gap at which the watch begins to judge [us]
#define LPVG_ECU_PROBE_SHARE 0.25F  ///< Share of u_max at which an engagement begins                 [-]
#define LPVG_ECU_PROBE_US 500000U  ///< Time of evidence that raises the share to 1; time at the limit that raises it by one step [us]
#define LPVG_ECU_AGE_US 5000000U  ///< Time without evidence in which the share falls from 1 to the least one [us]

#define LPVG_ECU_CAUSE_NOT_ASKED 0x0001U  ///< Engagement is not asked for.
#define LPVG_ECU_CAUSE_MESSAGE 0x0002U  ///< A needed message is not live.
#define LPVG_ECU_CAUSE_REFUSED 0x0004U  ///< The controller or the monitor refused the sample of the previous step.
#define LPVG_ECU_CAUSE_TIME 0x0008U  ///< The mean sample period is unknown or deviates from the exported one.
#define LPVG_ECU_CAUSE_RANGE 0x0010U  ///< The speed is outside the controller's scheduling range.
#define LPVG_ECU_CAUSE_UNJUDGED 0x0020U  ///< The newest verdict is unknown, stale or fault.
#define LPVG_ECU_CAUSE_INVALID 0x0040U  ///< The newest verdict is invalid.
#define LPVG_ECU_CAUSE_IMPLAUSIBLE 0x0080U  ///< Sensors contradict each other.
#define LPVG_ECU_CAUSE_OVERRIDE 0x0400U  ///< The driver brakes, or ABS acts.
#define LPVG_ECU_CAUSE_PERMISSION 0x0800U  ///< The vehicle does not ask for control, or another command has priority.
#define LPVG_ECU_CAUSE_ACTUATOR 0x1000U  ///< The actuator does not follow the demand.
#define LPVG_ECU_CAUSE_OFTEN 0x4000U  ///< The loop was engaged LPVG_ECU_ENGAGEMENTS_MAX times within the last hour.
#define LPVG_ECU_CAUSE_CORRUPT 0x2000U  ///< Coefficients, kept values or state are damaged. Lasts until init.
#define LPVG_ECU_CAUSE_WAIT 0x0100U  ///< The last cause ended less than LPVG_ECU_WAIT_US ago.
#define LPVG_ECU_CAUSE_LOCKED 0x0200U  ///< The loop waits for an acknowledgement.

/// Causes that `report_only` may name.
#define LPVG_ECU_CAUSES_OPTIONAL (LPVG_ECU_CAUSE_UNJUDGED | LPVG_ECU_CAUSE_INVALID | LPVG_ECU_CAUSE_IMPLAUSIBLE | LPVG_ECU_CAUSE_ACTUATOR)
/// Causes that lock when they end an engagement.
#define LPVG_ECU_CAUSES_LATCHING (LPVG_ECU_CAUSE_INVALID | LPVG_ECU_CAUSE_IMPLAUSIBLE | LPVG_ECU_CAUSE_ACTUATOR)
/// Causes that are no faults. LPVG_ECU_RELEASES_MAX does not count their releases. LPVG_ECU_ENGAGEMENTS_MAX counts every engagement.
#define LPVG_ECU_CAUSES_ORDINARY (LPVG_ECU_CAUSE_NOT_ASKED | LPVG_ECU_CAUSE_RANGE | LPVG_ECU_CAUSE_OVERRIDE | LPVG_ECU_CAUSE_PERMISSION)

#define LPVG_ECU_ROUND_US 5000000U  ///< Longest round over all coefficients; damage is found within two     [us]
#define LPVG_ECU_ACTUATOR_US 500000U  ///< Time constant of the actuator check                       [us]
#define LPVG_ECU_PEDAL_PERCENT 2.0F  ///< Pedal position beyond which the driver brakes                   [%]

/// Engagement state of the newest step, as reported on the bus.
typedef enum lpvg_ecu_engagement_t {
    lpvg_ecu_released = 0,
    lpvg_ecu_engaged = 1,
    lpvg_ecu_locked = 2  ///< Released until an acknowledgement.
} lpvg_ecu_engagement_t;

/// Limits of the actuator check. The check compares the measured output with the lagged demand of rms x. Its means forget with
/// LPVG_ECU_ACTUATOR_US. The deviation violates the limits in two cases: its part along the demand exceeds relative x + tolerance, or
/// its rms exceeds x + tolerance. All limits are finite and > 0; `relative` may be 0. An actuator stuck at 0 must violate them at the
/// largest demand: tolerance < (1 - relative) u_max.
typedef struct lpvg_ecu_actuator_limits_t {
    float lag_s;  ///< first-order lag from the demand to the measured output             [s]
    float tolerance;  ///< absolute part of the allowed deviation                               [input unit]
    uint16_t confirm;  ///< number of samples by which violations must outnumber agreements
    float relative;  ///< allowed deviation along the demand, as a share of x; 0 .. below 1       [-]
} lpvg_ecu_actuator_limits_t;

/// Configuration. `engage` and `report_only` are safe at zero: engagement is not asked for, and every cause releases.
typedef struct lpvg_ecu_config_t {
    bool engage;  ///< engagement is asked for from the start
    uint16_t report_only;  ///< causes of LPVG_ECU_CAUSES_OPTIONAL that are reported but do not release
    uint8_t priority;  ///< highest other_priority (bus.h) at which control is permitted, 0 .. 3
    bool authenticated;  ///< the caller passes only authenticated frames of the command message (authentication.h). Report and DM1 say so
    lpvg_can_plausibility_limits_t plausibility;  ///< limits of the cross-checks
    lpvg_ecu_actuator_limits_t actuator;  ///< limits of the actuator check
} lpvg_ecu_config_t;

/// Findings that DM1 reports. It sends the most severe active one. The order of severity is corrupt, refused, time, message, invalid,
/// actuator, implausible, locked, degraded, keyless.
typedef enum lpvg_ecu_fault_t {
    lpvg_ecu_fault_none = 0,
    lpvg_ecu_fault_refused = 1,  ///< Speed or a measurement was refused, or the controller state was not finite.
    lpvg_ecu_fault_message = 2,  ///< A needed message is not live.
    lpvg_ecu_fault_invalid = 3,  ///< The model is falsified.
    lpvg_ecu_fault_implausible = 4,  ///< Sensors contradict each other.
    lpvg_ecu_fault_time = 5,  ///< The mean sample period deviates from the exported one.
    lpvg_ecu_fault_locked = 6,  ///< The loop waits for an acknowledgement.
    lpvg_ecu_fault_actuator = 7,  ///< The actuator does not follow the demand.
    lpvg_ecu_fault_corrupt = 8,  ///< Coefficients, kept values or state are damaged.
    lpvg_ecu_fault_degraded = 9,  ///< A test alarmed; the certificate is not refuted. Releases nothing.
    lpvg_ecu_fault_keyless = 10  ///< Any frame of the command message is obeyed: `authenticated` is false. Releases nothing.
} lpvg_ecu_fault_t;

#define LPVG_ECU_SPN_REFUSED 520200U  ///< Suspect parameter numbers of the trouble codes, from the range of J1939-73 for makers.
#define LPVG_ECU_SPN_INVALID 520201U
#define LPVG_ECU_SPN_IMPLAUSIBLE 520202U
#define LPVG_ECU_SPN_TIME 520203U
#define LPVG_ECU_SPN_LOCKED 520204U
#define LPVG_ECU_SPN_ACTUATOR 520205U
#define LPVG_ECU_SPN_CORRUPT 520206U
#define LPVG_ECU_SPN_DEGRADED 520207U
#define LPVG_ECU_SPN_KEYLESS 520208U

/// State of the measurement of the mean sample period.
typedef enum lpvg_ecu_pace_t {
    lpvg_ecu_pace_unknown = 0,  ///< Not measured yet since init or the newest gap.
    lpvg_ecu_pace_good = 1,  ///< Within LPVG_ECU_PERIOD_PERCENT of the exported period.
    lpvg_ecu_pace_bad = 2  ///< Outside it.
} lpvg_ecu_pace_t;

/// Clock of the steps.
typedef struct lpvg_ecu_clock_t {
    int64_t jump_us;  ///< time of the newest call outside the accepted times           [us]
    int64_t half_us;  ///< core_us when the current half window began                  [us]
    uint32_t before_us;  ///< length of the previous half window; 0: none                 [us]
    uint32_t steps;  ///< number of steps in the current half window
    uint32_t refused;  ///< number of calls refused for their time, saturating
    uint32_t gaps;  ///< number of gaps and jumps taken, saturating
    uint8_t in_step;  ///< number of consecutive refused calls, a period apart
    uint8_t pace;  ///< lpvg_ecu_pace_t
    bool started;  ///< a step has been taken
} lpvg_ecu_clock_t;

/// Values that the reactions need. They are kept twice.
typedef struct lpvg_ecu_kept_t {
    const lpvg_coeff_t* coeff;
    const lpvg_control_coeff_t* control;
    lpvg_ecu_config_t config;
    lpvg_real_t u_max[LPVG_NU];  ///< largest |demand| of all nodes                     [input unit]
    lpvg_real_t rate_max[LPVG_NU];  ///< largest |change of demand|                     [input unit/s]
    lpvg_real_t speed_min;  ///< lower end of the controller's scheduling range             [m/s]
    lpvg_real_t speed_max;  ///< upper end of the controller's scheduling range             [m/s]
    lpvg_real_t demand[LPVG_NU];  ///< newest demand                                     [input unit]
    lpvg_watch_limits_t watch;  ///< limits of the watch of the response
    int64_t now_us;  ///< time of the newest step on the caller's clock                   [us]
    uint32_t period_us;  ///< sample period                                                [us]
    bool engage;  ///< engagement is asked for
    bool locked;  ///< locked until an acknowledgement
    bool standby;  ///< a request other than control has been received since init
    bool corrupt;  ///< damage was found; lasts until init
    bool falsified;  ///< the verdict is invalid until an acknowledgement
    bool on_trial;  ///< an invalid verdict was acknowledged, and the response has not been confirmed since
    bool refuted;  ///< the watch found the response wrong; lasts until init
} lpvg_ecu_kept_t;

typedef struct lpvg_ecu_t {
    lpvg_ecu_kept_t kept;
    uint32_t inverted[sizeof(lpvg_ecu_kept_t) / sizeof(uint32_t)];  ///< words of `kept` with every bit inverted
    uint32_t sum;  ///< sum of the words of `kept`
    uint32_t crc;  ///< CRC of the coefficients checked so far in this round
    uint32_t next_item;  ///< next coefficient to check: first the model's, then the controller's
    uint32_t rounds;  ///< number of complete rounds, saturating
    lpvg_can_supervisor_t supervisor;
    lpvg_can_plausibility_t plausibility;
    lpvg_bus_signals_t signals;
    float expected;  ///< first demand after the actuator's lag                       [input unit]
    int64_t live_us;  ///< core_us of the newest step that was not live                    [us]
    float deviation_along;  ///< mean of (measured - expected) expected                      [input unit squared]
    float deviation_square;  ///< mean square of measured - expected                      [input unit squared]
    float expected_square;  ///< mean square of expected                                   [input unit squared]
    uint16_t deviations;  ///< score of the actuator check
    bool actuator_failed;  ///< result of the actuator check
    lpvg_control_t control;
    lpvg_monitor_t monitor;
    lpvg_bus_report_t report;  ///< report sent by the newest step
    lpvg_ecu_fault_t fault;  ///< most severe active finding
    int64_t now_us;  ///< copy of kept.now_us for reading; before the first step the time of init [us]
    int64_t core_us;  ///< time of the newest step, the ECU's own time                 [us]
    lpvg_ecu_clock_t clock;
    int64_t dm1_us;  ///< core_us when DM1 was sent last                              [us]
    int64_t caused_us;  ///< core_us of the newest step with a releasing cause        [us]
    int64_t released_us;  ///< core_us of the newest release by a fault                    [us]
    int64_t doubted_us;  ///< core_us of the newest step that was engaged or not live, or in which a test falsified [us]
    int64_t slot_us;  ///< core_us when the current slot began                           [us]
    uint8_t engagements[LPVG_ECU_SLOTS];  ///< number of engagements in each slot, as a ring
    uint8_t slot;  ///< index of the current slot
    lpvg_watch_t watch;  ///< watch of the response while engaged
    lpvg_real_t share;  ///< share of u_max that the demand may use                       [-]
    uint32_t limited;  ///< value of control.limited at the newest step
    uint32_t settled_us;  ///< time since the newest gap, up to LPVG_ECU_SETTLE_US      [us]
    uint32_t trial_us;  ///< time with evidence of the watch since the newest acknowledgement of an invalid verdict [us]
    uint32_t pressed_us;  ///< time for which the demand has rested at its limit without evidence [us]
    uint16_t causes;  ///< LPVG_ECU_CAUSE_* of the newest step, report_only ones included
    uint16_t lock_causes;  ///< causes of the newest lock; 0: no lock since init
    uint8_t releases;  ///< number of releases by faults for LPVG_ECU_RELEASES_MAX
    bool in_range;  ///< the speed is in the scheduling range, with hysteresis
    bool acknowledging;  ///< the newest request is to acknowledge
    bool permitted;  ///< nothing prevented engagement in the newest step
    bool was_engaged;  ///< the loop has been engaged since init
    bool refused;  ///< the sample of the newest step was refused; the next step is not engaged
    bool seen_live;  ///< supervision has been live since init
    uint32_t dropped;  ///< number of frames dropped beyond LPVG_ECU_FRAMES_IN of a step, saturating
    uint8_t counter;  ///< counter of the report's end-to-end protection
    uint8_t occurrence;  ///< number of activations of trouble codes, at most 126
    uint8_t explained;  ///< failure mode LPVG_CAN_FMI_* of the codes invalid and degraded
} lpvg_ecu_t;

/// Makes *self ready at time now_us, 0 .. INT64_MAX / 2. The coefficients stay referenced and must outlive *self.
/// Returns ok; bad_argument (NULL, now_us out of range, another bit in report_only, a priority or limit out of range); the status of
/// lpvg_coeff_check or lpvg_control_coeff_check; bad_value when the two sample periods differ or exceed a quarter of LPVG_ECU_WINDOW_US.
/// Unless ok is returned, *self is unchanged.
LPVG_NODISCARD lpvg_status_t lpvg_ecu_init(lpvg_ecu_t* self, const lpvg_coeff_t* coeff, const lpvg_control_coeff_t* control,
                                           const lpvg_ecu_config_t* config, int64_t now_us);

/// Asks for engagement or for release from the next step on. Does nothing for NULL.
void lpvg_ecu_engage(lpvg_ecu_t* self, bool engage);

/// Ends a lock from the next step on, unless the rules above refuse it (Invalid verdict).
/// Returns whether the loop is unlocked; false for NULL.
bool lpvg_ecu_acknowledge(lpvg_ecu_t* self);

/// Takes the step at time now_us. frames_in [n_in] may be NULL when n_in is 0. A time stamp after now_us counts as now_us. Writes *n_out
/// frames with time now_us to frames_out.
/// Returns ok; bad_argument (NULL, or max_out < LPVG_ECU_FRAMES_OUT); not_ready (no init); out_of_order (now_us is refused, see Time above;
/// in the first step, now_us is before init or beyond INT64_MAX / 2). Unless ok is returned, nothing is received or sent, and *n_out
/// is 0 if it was given. After out_of_order only `clock`, and what the check of the kept values restored, may have changed.
LPVG_NODISCARD lpvg_status_t lpvg_ecu_step(lpvg_ecu_t* self, int64_t now_us, const lpvg_can_frame_t* frames_in, size_t n_in,
                                           lpvg_can_frame_t* frames_out, size_t max_out, size_t* n_out);

/// Lists all active findings after the newest step for lpvg_j1939_step, the most severe first (lpvg_ecu_fault_t). Each message that is
/// not live has a code of its own. The freeze frame holds the causes, the speed, and the time of the step on the caller's clock. It
/// also holds bin, test and statistic of the newest judged frame. While the verdict is invalid or degraded, these come from the newest
/// recorded alarm instead, if one waits to be read.
/// Returns ok; bad_argument (NULL); not_ready (no init). Unless ok is returned, *findings is unchanged.
LPVG_NODISCARD lpvg_status_t lpvg_ecu_findings(const lpvg_ecu_t* self, lpvg_j1939_findings_t* findings);

/// Sets the failure mode of the codes invalid and degraded, from the next step on, to the cause of the newest alarm. Gain and sign: out of
/// calibration. Delay: abnormal update rate. Bias: data drifted high, or low. Frozen: abnormal rate of change. Noise: data erratic.
/// Other: root cause not known. NULL and unknown: condition exists, as after init. Call it with the result of lpvg_diagnosis_named
/// whenever that may have changed. Does nothing when self is NULL.
void lpvg_ecu_explain(lpvg_ecu_t* self, const lpvg_found_t* found);

LPVG_EXTERN_C_END

#endif
#endif
