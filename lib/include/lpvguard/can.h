/// @file can.h -- frames, end-to-end protection, supervision of what is received, and diagnostics on a J1939 bus.
///
/// The layout of each message is generated from the CAN catalogue (lpvg_can_codec.h: pack, unpack, encode, decode, and
/// the table lpvg_can_rules that goes into lpvg_can_init). This file holds what does not depend on a message.
///
/// Use:     lpvg_can_init once -> lpvg_can_receive for every frame of the bus, in order of arrival
///          -> lpvg_can_advance once per control step -> read lpvg_can_state before using a message's newest value.
/// Cost:    receive: one pass over the rules, then over the signals of one message (8 at most), CRC included; advance:
///          one pass over the rules. Constant, no heap, no locks, no I/O, no recursion.
///          Instructions on a Cortex-M4F at -O2, six rules: receive 265 for a foreign frame, 584 for VDC2 (three signals),
///          732 for a protected frame; advance 167, and one 64-bit division for each period that goes missing.
/// Threads: no hidden state; one supervisor belongs to one thread. An interrupt may fill a queue of frames, not call in.
/// RAM:     sizeof(lpvg_can_supervisor_t). Fields are for reading only.
/// Units:   time in microseconds of one monotonic clock, from 0 to INT64_MAX.
///
/// States of a message (cleared memory reads "off"):
///
///     off  -- LPVG_CAN_RECOVER_FRAMES good frames in a row ---------> live     (nothing is used before)
///     live -- LPVG_CAN_HOLD_MISSED periods missed ------------------> hold     (newest value still given: degrade)
///     hold -- one good frame ---------------------------------------> live
///     live, hold -- LPVG_CAN_OFF_MISSED periods missed -------------> off
///     live, hold -- score of bad frames reaches LPVG_CAN_SCORE_OFF -> off      (+1 each bad, -1 each good, 0 at least)
///     live, hold -- LPVG_CAN_WINDOW_BAD of the newest LPVG_CAN_WINDOW frames were bad -> off
///     any  -- LPVG_CAN_ARRIVALS frames within LPVG_CAN_ARRIVALS_PERIODS periods -> off, until as many have taken longer
///     any  -- LPVG_CAN_RATE_ARRIVALS frames within LPVG_CAN_RATE_PERIODS periods -> off, until as many have taken longer
///     live, hold -- score of frames of a second sender reaches LPVG_CAN_FOREIGN_OFF -> off   (LPVG_CAN_FOREIGN_ADD each frame with
///                   the counter of the newest good one less than 3/4 of a period behind it, -1 each good one, 0 at least)
///     any  -- bus-off, seen as an error frame ----------------------> off
///
/// Period number k counts as missed when the newest accepted frame is older than k + 1/2 periods.
///
/// The window is the one of AUTOSAR's E2E state machine: its size is LPVG_CAN_WINDOW in every state, the largest number of errors is
/// LPVG_CAN_WINDOW_BAD - 1 in VALID, and INIT and INVALID end with LPVG_CAN_RECOVER_FRAMES good frames in a row. The limit on
/// arrivals finds a second sender: a frame inserted between the genuine ones doubles the rate, whatever it holds. The rate over more
/// arrivals finds one that inserts a frame in nine. In a message with a counter each inserted frame makes a genuine one wrong: a second
/// sender is found from one frame in fifteen on, within 2 s from one in ten on.
///
/// Limits: standard J1939 messages have neither counter nor checksum. Of them loss, babbling, absent or erroneous values, range
/// and gradient are found. A repeated or swapped frame of such a message looks valid.
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
#define LPVG_CAN_WINDOW 16u  ///< Newest frames of a message whose errors are counted.
#define LPVG_CAN_WINDOW_BAD 8u  ///< So many bad ones of them switch off.
#define LPVG_CAN_ARRIVALS 8u  ///< Arrivals whose time is measured.
#define LPVG_CAN_ARRIVALS_PERIODS 6u  ///< They must take at least so many periods.
#define LPVG_CAN_RATE_ARRIVALS 64u  ///< Arrivals over which the mean rate is measured.
#define LPVG_CAN_RATE_PERIODS 58u  ///< They must take at least so many periods: the tolerance of the rate is 10 %.
#define LPVG_CAN_FOREIGN_ADD 16u  ///< What a frame adds that a second sender explains.
#define LPVG_CAN_FOREIGN_OFF 96u  ///< So high a score switches off.
#define LPVG_CAN_COUNTER_STEP 5u  ///< Largest step of a counter that is read as loss and not as a wrong sequence.
#define LPVG_CAN_REORDER_US 5000   ///< A frame may carry a time this much before the newest time seen (it waited in a queue).
#define LPVG_CAN_NO_INDEX 0xFFu

/// A frame as it arrived, or as it is to be sent.
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

/// What is accepted of one signal, in raw values. Generated.
typedef struct lpvg_can_signal_rule_t {
    uint8_t start;       ///< Lowest bit, Intel order                                        0 .. 63
    uint8_t length;      ///< Bits                                                           1 .. 16
    uint16_t raw_min;     ///< Smallest accepted
    uint16_t raw_max;     ///< Largest accepted
    uint16_t error_min;   ///< From here up: "error". 0: no such code.
    uint16_t absent_min;  ///< From here up: "not available". 0: no such code.
    uint32_t rate_max;    ///< Largest change per second, raw. 0: unlimited.
} lpvg_can_signal_rule_t;

/// What is accepted of one message. Generated.
typedef struct lpvg_can_rule_t {
    uint32_t id;           ///< Identifier and flags
    uint32_t id_mask;      ///< Bits of it that must agree (J1939: all but the priority)
    uint32_t period_us;    ///< Sending period                                                4 .. 10 000 000
    uint32_t gap_min_us;   ///< A frame sooner than this after the one before is babbling     below period_us
    uint16_t e2e_data_id;  ///< Data id of profile 11
    uint8_t e2e;          ///< 1: profile 11; 0: neither counter nor checksum
    uint8_t dlc;
    uint8_t n_signals;
    const lpvg_can_signal_rule_t* signals;  ///< [n_signals], outlives the supervisor
} lpvg_can_rule_t;

/// What became of a frame; also the index of the counters.
typedef enum lpvg_can_event_t {
    lpvg_can_event_none = 0,   ///< A NULL argument.
    lpvg_can_event_accepted = 1,   ///< Use it.
    lpvg_can_event_recovering = 2,   ///< Good, but the message is still off: do not use it.
    lpvg_can_event_unknown_id = 3,   ///< No rule matches; ignored.
    lpvg_can_event_error = 4,   ///< Error report other than bus-off; ignored.
    lpvg_can_event_bus_off = 5,   ///< Every message is off now.
    lpvg_can_event_backwards = 6,   ///< More than LPVG_CAN_REORDER_US before the newest time seen; ignored.
    lpvg_can_event_early = 7,   ///< Babbling: sooner than gap_min_us after the frame before, or too many in a window.
    lpvg_can_event_length = 8,   ///< Wrong number of bytes.
    lpvg_can_event_checksum = 9,
    lpvg_can_event_repeated = 10,  ///< Counter as in the frame before: repeated or stuck.
    lpvg_can_event_sequence = 11,  ///< Counter 15, or a step larger than LPVG_CAN_COUNTER_STEP: swapped or inserted.
    lpvg_can_event_absent = 12,  ///< A supervised signal says "not available".
    lpvg_can_event_invalid = 13,  ///< A supervised signal says "error".
    lpvg_can_event_range = 14,
    lpvg_can_event_gradient = 15,
    lpvg_can_event_missed = 16,  ///< Not of a frame: a period without an accepted frame.
    lpvg_can_event_lost = 17,  ///< Not of a frame: the counter skipped one.
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
    int64_t t_window_us;    ///< Arrival before those that are counted                                  [us]
    uint16_t window;        ///< Newest frames, 1: bad; the newest is bit 0
    uint8_t window_bad;     ///< Bad ones of them                                                       0 .. 16
    uint8_t arrivals;       ///< Since t_window_us                                                      0 .. 7
    uint8_t fast;           ///< Came too fast: 1 the newest LPVG_CAN_ARRIVALS, 2 LPVG_CAN_RATE_ARRIVALS
    int64_t t_rate_us;      ///< Arrival at which the window of the rate began                      [us]
    uint8_t rate_arrivals;  ///< Since t_rate_us                                                        0 .. 63
    uint8_t foreign;        ///< Score of frames of a second sender                                     0 .. 96
    uint8_t score;          ///< Of bad frames                                                          0 .. 5
    uint8_t good_in_row;    ///< While off                                                              0 .. 5
    uint8_t counter;        ///< Of the newest frame with a right checksum                              0 .. 14
    uint8_t has_arrival;    ///< t_arrival_us is known
    uint8_t has_raw;        ///< raw is known: gradients can be judged
    uint8_t has_counter;    ///< counter is known
} lpvg_can_watch_t;

typedef struct lpvg_can_supervisor_t {
    const lpvg_can_rule_t* rules;                ///< [n_rules]
    int64_t now_us;                     ///< Newest time seen                                   [us]
    uint32_t count[lpvg_can_event_count];///< Frames that belong to no rule, by kind, saturating
    lpvg_can_watch_t watch[LPVG_CAN_RULES_MAX];
    uint8_t n_rules;                    ///< Messages that are watched                          0 .. 8
    uint8_t bus_off;                    ///< 1 from a bus-off report to the next ordinary frame
} lpvg_can_supervisor_t;

/// Starts with every message off. `rules` [n_rules] is kept by reference.
/// Returns bad_argument when a pointer is NULL, n_rules is 0 or above LPVG_CAN_RULES_MAX, or now_us < 0. It is also returned when a
/// rule holds a number outside its stated range. *self is untouched then.
LPVG_NODISCARD lpvg_status_t lpvg_can_init(lpvg_can_supervisor_t* self, const lpvg_can_rule_t* rules, size_t n_rules, int64_t now_us);

/// Judges one frame at its own time frame->t_us (so it also does what lpvg_can_advance does).
/// *index becomes the rule that it belongs to, LPVG_CAN_NO_INDEX when none. The first check that fails names the event.
/// The order is: time, bus error, identifier, gap, length, checksum, counter, then the supervised signals in the order of the rule.
/// Each signal is checked for: not available, error, range, gradient. Only `accepted` frames may be used.
/// NULL gives `none`, and nothing happens.
lpvg_can_event_t lpvg_can_receive(lpvg_can_supervisor_t* self, const lpvg_can_frame_t* frame, uint8_t* index);

/// Lets time pass: counts missed periods and moves live -> hold -> off. A time before the newest seen, and NULL, change nothing.
void lpvg_can_advance(lpvg_can_supervisor_t* self, int64_t now_us);

/// State of message `index` at the newest time seen; off when self is NULL or index is out of range.
lpvg_can_state_t lpvg_can_state(const lpvg_can_supervisor_t* self, uint8_t index);

/// AUTOSAR E2E profile 11, data-id mode BOTH, over frame->dlc bytes (2 .. 8). Writes *counter (0 .. 14) to the low nibble of
/// byte 1 and keeps the high nibble. Writes the CRC to byte 0, and steps *counter for the next frame.
/// Returns bad_argument, changing nothing, when a pointer is NULL, dlc or *counter is out of range.
LPVG_NODISCARD lpvg_status_t lpvg_can_e2e_protect(lpvg_can_frame_t* frame, uint16_t data_id, uint8_t* counter);

/// Returns ok and *counter when the CRC is right. Returns bad_sample when it is not or the counter is 15, and bad_argument when a
/// pointer is NULL or dlc is out of range. *counter is written only with ok.
LPVG_NODISCARD lpvg_status_t lpvg_can_e2e_check(const lpvg_can_frame_t* frame, uint16_t data_id, uint8_t* counter);

/// Limits of the cross-checks between signals of different sensors. All > 0 and finite.
typedef struct lpvg_can_plausibility_limits_t {
    float track_m;            ///< Distance of the two wheels whose speeds are compared                 [m]
    float speed_min_mps;      ///< Below it nothing is judged                                           [m/s]
    float lateral_mps2;       ///< Allowed |yaw rate * speed - ay|: bank, side-slip rate, sensor errors [m/s2]
    float yaw_rps;            ///< Allowed |yaw rate - wheel speed difference / track|: slip            [rad/s]
    uint16_t confirm;            ///< Samples by which violations must outnumber agreements
} lpvg_can_plausibility_limits_t;

#define LPVG_CAN_IMPLAUSIBLE_LATERAL 1u  ///< Yaw rate against lateral acceleration / speed
#define LPVG_CAN_IMPLAUSIBLE_WHEELS 2u  ///< Yaw rate against wheel speed difference

/// Zero-initialise before first use.
typedef struct lpvg_can_plausibility_t {
    uint16_t score[2];  ///< Violations minus agreements of the two checks, 0 .. confirm
    uint8_t flags;     ///< LPVG_CAN_IMPLAUSIBLE_*: set when a score reaches confirm, cleared when it is back at 0
} lpvg_can_plausibility_t;

/// One sample of the cross-checks. Yaw rate [rad/s] and lateral acceleration [m/s2] are positive to the left; speed is in m/s.
/// wheel_difference = right wheel - left wheel of one unbraked axle [m/s]. A check whose inputs are not finite is left out, and so
/// is every check below speed_min_mps: its score stays. Returns ok; bad_argument (NULL, or a limit that is not > 0, or infinite).
LPVG_NODISCARD lpvg_status_t lpvg_can_plausibility(lpvg_can_plausibility_t* self, const lpvg_can_plausibility_limits_t* limits,
                                                   float yaw_rate, float lateral, float speed, float wheel_difference);

/// One sample of a check that takes more than one: `*score` counts violations minus agreements, 0 .. confirm. Returns whether the
/// check has failed: from the score `confirm` on, and until it is back at 0 while `failed`, what the call before returned.
/// False for NULL.
bool lpvg_can_confirm(uint16_t* score, bool failed, bool violation, uint16_t confirm);

/// A J1939 trouble code.
typedef struct lpvg_can_dtc_t {
    uint32_t spn;         ///< Suspect parameter number                 0 .. 0x7FFFF
    uint8_t fmi;         ///< Failure mode identifier                  0 .. 31
    uint8_t occurrence;  ///< Times seen; 127: unknown                 0 .. 127
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

/// Failure mode identifier LPVG_CAN_FMI_* of an event.
uint8_t lpvg_can_fmi(lpvg_can_event_t event);

/// DM1 (PGN 65226) with one active trouble code, or with none (dtc NULL), and the lamps LPVG_CAN_LAMP_*, the others off.
/// Several codes need the transport protocol: send the gravest. frame->t_us is kept.
/// Returns bad_argument, changing nothing, when frame is NULL, lamps holds another bit, or a field of *dtc is too large.
LPVG_NODISCARD lpvg_status_t lpvg_can_dm1_pack(lpvg_can_frame_t* frame, uint8_t source_address, uint8_t lamps, const lpvg_can_dtc_t* dtc);

#ifdef __cplusplus
}
#endif
#endif
