/// @file can.h -- CAN frames, end-to-end protection, supervision of received messages, and J1939 trouble codes.
///
/// `lpvguard export` generates the layout of each message from the CAN catalogue. lpvg_can_codec.h holds the functions to pack,
/// unpack, encode and decode. It also holds the table lpvg_can_rules for lpvg_can_init. This file is independent of the messages.
///
/// Use:     lpvg_can_init once -> lpvg_can_receive for every frame of the bus, in order of arrival
///          -> lpvg_can_advance once per control step -> read lpvg_can_state before using a message's newest value.
/// Cost:    receive: one pass over the rules, then over the signals of one message (at most 8), with its CRC; advance:
///          one pass over the rules. Constant time, no heap, no locks, no I/O, no recursion.
///          Instructions on a Cortex-M4F at -O2, six rules: receive 265 for a foreign frame, 584 for VDC2 (three signals),
///          732 for a protected frame; advance 167, and one division for each period that goes missing.
/// Threads: one supervisor belongs to one thread. An interrupt may fill a queue of frames; it must not call these functions.
/// RAM:     sizeof(lpvg_can_supervisor_t). Fields are read-only for the caller.
/// Units:   time in microseconds of one monotonic clock, from 0 to INT64_MAX.
///
/// States of a message (cleared memory reads "off"):
///
///     off  -- LPVG_CAN_RECOVER_FRAMES good frames in a row ---------> live     (nothing is used before)
///     live -- LPVG_CAN_HOLD_MISSED periods missed ------------------> hold     (newest value is old: degrade)
///     hold -- one good frame ---------------------------------------> live
///     live, hold -- LPVG_CAN_OFF_MISSED periods missed -------------> off
///     live, hold -- score of bad frames reaches LPVG_CAN_SCORE_OFF -> off      (+1 each bad, -1 each good, never below 0)
///     live, hold -- LPVG_CAN_WINDOW_BAD of the newest LPVG_CAN_WINDOW frames were bad -> off
///     any  -- LPVG_CAN_ARRIVALS frames within LPVG_CAN_ARRIVALS_PERIODS periods -> off, until as many take longer
///     any  -- LPVG_CAN_RATE_ARRIVALS frames within LPVG_CAN_RATE_PERIODS periods -> off, until as many take longer
///     live, hold -- score of a second sender reaches LPVG_CAN_FOREIGN_OFF -> off   (-1 each good frame, never below 0;
///                   +LPVG_CAN_FOREIGN_ADD each frame that repeats the newest good counter within 3/4 of a period)
///     any  -- bus-off, seen as an error frame ----------------------> off
///
/// The k-th missed period counts when the newest accepted frame is older than k + 1/2 periods.
///
/// Window of errors: as in AUTOSAR's E2E state machine. Its size is LPVG_CAN_WINDOW in every state. VALID allows at most
/// LPVG_CAN_WINDOW_BAD - 1 errors. INIT and INVALID end after LPVG_CAN_RECOVER_FRAMES good frames in a row.
///
/// Second sender: one inserted frame for each genuine frame doubles the rate, and the limit on LPVG_CAN_ARRIVALS finds it. The
/// limit on LPVG_CAN_RATE_ARRIVALS finds one inserted frame in nine. In a message with a counter, each inserted frame makes a
/// genuine frame look repeated. The score then finds one inserted frame in fifteen, and one in ten within 2 s.
///
/// Limits: standard J1939 messages have neither counter nor checksum. For them, supervision finds loss, babbling, absent or
/// erroneous values, and violations of range and gradient. It cannot find a repeated or swapped frame.
#ifndef LPVGUARD_CAN_H
#define LPVGUARD_CAN_H

#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>

#include "lpvguard/status.h"

#ifdef __cplusplus
extern "C" {
#endif

#define LPVG_CAN_EXTENDED 0x80000000u  ///< Flag in lpvg_can_frame_t.id: 29-bit identifier (bit values as SocketCAN).
#define LPVG_CAN_REMOTE 0x40000000u  ///< Flag: remote frame. No rule matches one.
#define LPVG_CAN_ERROR 0x20000000u  ///< Flag: the controller reports an error, not a frame of the bus.
#define LPVG_CAN_BUS_OFF 0x00000040u  ///< In an error report: the controller has left the bus.

#define LPVG_CAN_RULES_MAX 8u  ///< Messages that one supervisor can watch.
#define LPVG_CAN_SIGNALS_MAX 8u  ///< Supervised signals of one message.
#define LPVG_CAN_HOLD_MISSED 3u
#define LPVG_CAN_OFF_MISSED 5u
#define LPVG_CAN_SCORE_OFF 5u
#define LPVG_CAN_RECOVER_FRAMES 5u
#define LPVG_CAN_COUNTERS 15u  ///< The end-to-end counter runs from 0 to 14.
#define LPVG_CAN_WINDOW 16u  ///< Number of newest frames of a message in which errors are counted.
#define LPVG_CAN_WINDOW_BAD 8u  ///< Number of bad frames in that window that switches the message off.
#define LPVG_CAN_ARRIVALS 8u  ///< Number of arrivals in the short rate check.
#define LPVG_CAN_ARRIVALS_PERIODS 6u  ///< Least number of periods that these arrivals take.
#define LPVG_CAN_RATE_ARRIVALS 64u  ///< Number of arrivals in the long rate check.
#define LPVG_CAN_RATE_PERIODS 58u  ///< Least number of periods that these arrivals take; the tolerance of the rate is 10 %.
#define LPVG_CAN_FOREIGN_ADD 16u  ///< Increase of the score for a frame that repeats the counter too early.
#define LPVG_CAN_FOREIGN_OFF 96u  ///< Score of a second sender that switches the message off.
#define LPVG_CAN_COUNTER_STEP 5u  ///< Largest counter step that counts as loss; a larger step is a wrong sequence.
#define LPVG_CAN_REORDER_US 5000  ///< A queued frame may be older than the newest time by this much [us]
#define LPVG_CAN_NO_INDEX 0xFFu

/// A received frame, or a frame to send.
typedef struct lpvg_can_frame_t {
    uint32_t id;       ///< Identifier and the flags above
    uint8_t dlc;      ///< Number of data bytes      0 .. 8 (a longer CAN FD frame is given with its true length)
    uint8_t data[8];
    int64_t t_us;     ///< Arrival time              [us]
} lpvg_can_frame_t;

/// Quality of a decoded value. Zero is "absent": a cleared struct never reads as good.
typedef enum lpvg_can_quality_t {
    lpvg_can_quality_absent = 0,  ///< Raw value says "not available".
    lpvg_can_quality_good = 1,
    lpvg_can_quality_error = 2,  ///< Raw value says "error".
    lpvg_can_quality_reserved = 3,  ///< Between the largest data value and the error codes.
} lpvg_can_quality_t;

/// Accepted raw values of one signal. Generated.
typedef struct lpvg_can_signal_rule_t {
    uint8_t start;       ///< Lowest bit, Intel order                                        0 .. 63
    uint8_t length;      ///< Bits                                                           1 .. 16
    uint16_t raw_min;     ///< Smallest accepted
    uint16_t raw_max;     ///< Largest accepted
    uint16_t error_min;   ///< Smallest raw value that means "error". 0: no such code.
    uint16_t absent_min;  ///< Smallest raw value that means "not available". 0: no such code.
    uint32_t rate_max;    ///< Largest change per second, raw. 0: unlimited.
} lpvg_can_signal_rule_t;

/// Rule of one received message. Generated.
typedef struct lpvg_can_rule_t {
    uint32_t id;           ///< Identifier and flags
    uint32_t id_mask;      ///< Bits of the identifier that must agree (J1939: all but the priority)
    uint32_t period_us;    ///< Sending period                                                4 .. 10 000 000
    uint32_t gap_min_us;   ///< Shortest gap between two frames; a shorter one is babbling     below period_us
    uint16_t e2e_data_id;  ///< Data id of profile 11
    uint8_t e2e;          ///< 1: profile 11; 0: neither counter nor checksum
    uint8_t dlc;
    uint8_t n_signals;
    const lpvg_can_signal_rule_t* signals;  ///< [n_signals], outlives the supervisor
} lpvg_can_rule_t;

/// Judgement of a frame. It is also the index of the counters.
typedef enum lpvg_can_event_t {
    lpvg_can_event_none = 0,   ///< An argument is NULL.
    lpvg_can_event_accepted = 1,   ///< The frame is good: use it.
    lpvg_can_event_recovering = 2,   ///< The frame is good, but the message is still off: do not use it.
    lpvg_can_event_unknown_id = 3,   ///< No rule matches; ignored.
    lpvg_can_event_error = 4,   ///< Error report other than bus-off; ignored.
    lpvg_can_event_bus_off = 5,   ///< The controller left the bus: every message is off.
    lpvg_can_event_backwards = 6,   ///< More than LPVG_CAN_REORDER_US before the newest time seen; ignored.
    lpvg_can_event_early = 7,   ///< Babbling: gap below gap_min_us, or too many frames in a rate check.
    lpvg_can_event_length = 8,   ///< Wrong number of bytes.
    lpvg_can_event_checksum = 9,
    lpvg_can_event_repeated = 10,  ///< Same counter as the previous frame: repeated or stuck.
    lpvg_can_event_sequence = 11,  ///< Counter 15, or a step larger than LPVG_CAN_COUNTER_STEP: swapped or inserted.
    lpvg_can_event_absent = 12,  ///< A supervised signal says "not available".
    lpvg_can_event_invalid = 13,  ///< A supervised signal says "error".
    lpvg_can_event_range = 14,
    lpvg_can_event_gradient = 15,
    lpvg_can_event_missed = 16,  ///< A period without an accepted frame (no frame has this event).
    lpvg_can_event_lost = 17,  ///< A frame that the counter skipped (no frame has this event).
    lpvg_can_event_count = 18
} lpvg_can_event_t;

typedef enum lpvg_can_state_t {
    lpvg_can_state_off = 0,  ///< No usable value.
    lpvg_can_state_hold = 1,  ///< Newest value is more than LPVG_CAN_HOLD_MISSED periods old: degrade.
    lpvg_can_state_live = 2,
} lpvg_can_state_t;

/// Supervision of one message.
typedef struct lpvg_can_watch_t {
    int64_t t_accepted_us;  ///< Newest good frame; before the first, the time of init                  [us]
    int64_t t_arrival_us;   ///< Newest frame of this identifier, good or bad                           [us]
    uint32_t count[lpvg_can_event_count];  ///< Frames and periods by kind, saturating
    uint32_t missed;         ///< Periods missed since the newest good frame
    uint16_t raw[LPVG_CAN_SIGNALS_MAX];    ///< Supervised signals of the newest good frame, raw
    uint8_t state;          ///< lpvg_can_state_t
    int64_t t_window_us;    ///< Arrival at which the short rate check began                            [us]
    uint16_t window;        ///< One bit for each newest frame, 1: bad; bit 0 is the newest
    uint8_t window_bad;     ///< Number of bad frames in `window`                                       0 .. 16
    uint8_t arrivals;       ///< Arrivals since t_window_us                                             0 .. 7
    uint8_t fast;           ///< Failed rate checks: bit 0 the short one, bit 1 the long one
    int64_t t_rate_us;      ///< Arrival at which the long rate check began                         [us]
    uint8_t rate_arrivals;  ///< Arrivals since t_rate_us                                               0 .. 63
    uint8_t foreign;        ///< Score of a second sender                                               0 .. 96
    uint8_t score;          ///< Score of bad frames                                                    0 .. 5
    uint8_t good_in_row;    ///< Good frames in a row while off                                         0 .. 5
    uint8_t counter;        ///< Counter of the newest frame with a right checksum                      0 .. 14
    uint8_t has_arrival;    ///< t_arrival_us is known
    uint8_t has_raw;        ///< raw is known, so gradients can be judged
    uint8_t has_counter;    ///< counter is known
} lpvg_can_watch_t;

typedef struct lpvg_can_supervisor_t {
    const lpvg_can_rule_t* rules;                ///< [n_rules]
    int64_t now_us;                     ///< Newest time seen                                   [us]
    uint32_t count[lpvg_can_event_count];///< Frames that belong to no rule, by kind, saturating
    lpvg_can_watch_t watch[LPVG_CAN_RULES_MAX];
    uint8_t n_rules;                    ///< Number of supervised messages                      0 .. 8
    uint8_t bus_off;                    ///< 1 after a bus-off report, until the next ordinary frame
} lpvg_can_supervisor_t;

/// Initialises *self with every message off. It keeps a reference to `rules` [n_rules].
/// Returns ok; bad_argument for NULL, n_rules outside 1 .. LPVG_CAN_RULES_MAX, now_us < 0, or a number of a rule out of range.
/// *self changes only with ok.
LPVG_NODISCARD lpvg_status_t lpvg_can_init(lpvg_can_supervisor_t* self, const lpvg_can_rule_t* rules, size_t n_rules, int64_t now_us);

/// Judges one frame at its time frame->t_us. It first advances the time, as lpvg_can_advance does.
/// *index becomes the index of the frame's rule, or LPVG_CAN_NO_INDEX. The first failed check determines the event.
/// Order of the checks: time, bus error, identifier, gap, length, checksum, counter, then the signals in the order of the rule.
/// Checks of each signal: not available, error, range, gradient. Use a frame only with the event `accepted`.
/// Returns `none` for NULL and changes nothing.
lpvg_can_event_t lpvg_can_receive(lpvg_can_supervisor_t* self, const lpvg_can_frame_t* frame, uint8_t* index);

/// Advances the time: counts missed periods and moves live -> hold -> off. An older time and NULL change nothing.
void lpvg_can_advance(lpvg_can_supervisor_t* self, int64_t now_us);

/// State of message `index` at the newest time. Returns off when self is NULL or index is out of range.
lpvg_can_state_t lpvg_can_state(const lpvg_can_supervisor_t* self, uint8_t index);

/// Protects a frame by AUTOSAR E2E profile 11, data-id mode BOTH, over frame->dlc bytes (2 .. 8).
/// Writes *counter (0 .. 14) to the low nibble of byte 1, keeps the high nibble, and writes the CRC to byte 0. Then steps *counter.
/// Returns bad_argument when a pointer is NULL, or when dlc or *counter is out of range. Nothing changes then.
LPVG_NODISCARD lpvg_status_t lpvg_can_e2e_protect(lpvg_can_frame_t* frame, uint16_t data_id, uint8_t* counter);

/// Checks a frame that lpvg_can_e2e_protect protected. Writes *counter only with ok.
/// Returns ok; bad_sample for a wrong CRC or counter 15; bad_argument when a pointer is NULL or dlc is out of range.
LPVG_NODISCARD lpvg_status_t lpvg_can_e2e_check(const lpvg_can_frame_t* frame, uint16_t data_id, uint8_t* counter);

/// Limits of the cross-checks between different sensors. All are finite and > 0.
typedef struct lpvg_can_plausibility_limits_t {
    float track_m;            ///< Distance of the two wheels whose speeds are compared                 [m]
    float speed_min_mps;      ///< Lowest speed at which the checks judge                               [m/s]
    float lateral_mps2;       ///< Allowed |yaw rate * speed - ay|: bank, side-slip rate, sensor errors [m/s2]
    float yaw_rps;            ///< Allowed |yaw rate - wheel speed difference / track|: slip            [rad/s]
    uint16_t confirm;            ///< A check fails when violations outnumber agreements by this number
} lpvg_can_plausibility_limits_t;

#define LPVG_CAN_IMPLAUSIBLE_LATERAL 1u  ///< Yaw rate against lateral acceleration / speed
#define LPVG_CAN_IMPLAUSIBLE_WHEELS 2u  ///< Yaw rate against wheel speed difference

/// Zero-initialise before first use.
typedef struct lpvg_can_plausibility_t {
    uint16_t score[2];  ///< Violations minus agreements of each check, 0 .. confirm
    uint8_t flags;     ///< LPVG_CAN_IMPLAUSIBLE_*: set when a score reaches confirm, cleared when it returns to 0
} lpvg_can_plausibility_t;

/// Takes one sample of the cross-checks. Yaw rate [rad/s] and lateral acceleration [m/s2] are positive to the left.
/// wheel_difference is right wheel minus left wheel of one unbraked axle [m/s]. `speed` is in [m/s]. A check keeps its score when
/// one of its inputs is not finite, or when the speed is below speed_min_mps.
/// Returns ok; bad_argument for NULL or a limit that is infinite or not > 0.
LPVG_NODISCARD lpvg_status_t lpvg_can_plausibility(lpvg_can_plausibility_t* self, const lpvg_can_plausibility_limits_t* limits,
                                                   float yaw_rate, float lateral, float speed, float wheel_difference);

/// Takes one sample of a check with hysteresis. *score counts violations minus agreements, 0 .. confirm. `failed` is the result of
/// the previous call. The check fails when *score reaches `confirm`, and stays failed until *score returns to 0.
/// Returns whether the check has failed; false for NULL.
bool lpvg_can_confirm(uint16_t* score, bool failed, bool violation, uint16_t confirm);

/// A J1939 trouble code.
typedef struct lpvg_can_dtc_t {
    uint32_t spn;         ///< Suspect parameter number                 0 .. 0x7FFFF
    uint8_t fmi;         ///< Failure mode identifier                  0 .. 31
    uint8_t occurrence;  ///< Occurrence count; 127: unknown           0 .. 127
} lpvg_can_dtc_t;

#define LPVG_CAN_LAMP_PROTECT 0x01u
#define LPVG_CAN_LAMP_AMBER 0x04u
#define LPVG_CAN_LAMP_RED 0x10u
#define LPVG_CAN_LAMP_MIL 0x40u

#define LPVG_CAN_FMI_ERRATIC 2u  ///< Failure mode identifiers (J1939-73): data erratic.
#define LPVG_CAN_FMI_RESPONSE 7u  ///< Mechanical system not responding.
#define LPVG_CAN_FMI_FREQUENCY 8u  ///< Abnormal frequency.
#define LPVG_CAN_FMI_UPDATE_RATE 9u  ///< Abnormal update rate.
#define LPVG_CAN_FMI_RATE_OF_CHANGE 10u  ///< Abnormal rate of change.
#define LPVG_CAN_FMI_ROOT_UNKNOWN 11u  ///< Root cause not known.
#define LPVG_CAN_FMI_BAD_DEVICE 12u  ///< Bad intelligent device or component.
#define LPVG_CAN_FMI_CALIBRATION 13u  ///< Out of calibration.
#define LPVG_CAN_FMI_NETWORK 19u  ///< Received network data in error.
#define LPVG_CAN_FMI_DRIFTED_HIGH 20u  ///< Data drifted high.
#define LPVG_CAN_FMI_DRIFTED_LOW 21u  ///< Data drifted low.
#define LPVG_CAN_FMI_CONDITION 31u  ///< Condition exists.

/// Returns the failure mode identifier LPVG_CAN_FMI_* of an event.
uint8_t lpvg_can_fmi(lpvg_can_event_t event);

/// Packs a DM1 (PGN 65226) with one active trouble code, or with none (dtc NULL). Lamps not in `lamps` (LPVG_CAN_LAMP_*) are off.
/// One frame carries one code: send the most severe one. frame->t_us is kept.
/// Returns bad_argument when frame is NULL, lamps has an unknown bit, or a field of *dtc is too large. Nothing changes then.
LPVG_NODISCARD lpvg_status_t lpvg_can_dm1_pack(lpvg_can_frame_t* frame, uint8_t source_address, uint8_t lamps, const lpvg_can_dtc_t* dtc);

#ifdef __cplusplus
}
#endif
#endif
