/// @file bus.h -- interface between ecu.cpp and the generated lpvguard_bus.c: the vehicle's signals on its CAN bus.
///
/// `lpvguard export` makes lpvguard_bus.c from the vehicle's signal table and the CAN catalogue. ecu.cpp and the firmware therefore
/// name no message. Values have the units and signs of the signal table.
#ifndef LPVGUARD_BUS_H
#define LPVGUARD_BUS_H

#include "lpvguard/can.h"
#include "lpvguard/config.h"

#if LPVG_NK > 0

LPVG_EXTERN_C_BEGIN

#define lpvg_bus_signals_t LPVG_SYM(bus_signals_t)
#define lpvg_bus_t LPVG_SYM(bus_t)
#define lpvg_bus LPVG_SYM(bus)
#define lpvg_bus_take LPVG_SYM(bus_take)
#define lpvg_bus_pack_report LPVG_SYM(bus_pack_report)

#define LPVG_BUS_REQUEST_RELEASE 0U      ///< Request of the vehicle: release the actuator.
#define LPVG_BUS_REQUEST_CONTROL 1U      ///< Request of the vehicle: control.
#define LPVG_BUS_REQUEST_ACKNOWLEDGE 2U  ///< Request of the vehicle: release, and end a lock (ecu.h).

/// Newest received values. NaN: absent in the newest frame.
typedef struct lpvg_bus_signals_t {
    lpvg_real_t speed;         ///< longitudinal                                              [m/s]
    lpvg_real_t reference;     ///< yaw-rate command, left > 0                                [rad/s]
    lpvg_real_t y[LPVG_NY];    ///< outputs of the signal table                               [output unit]
    float yaw_rate;            ///< from the stability system, left > 0; for cross-checks     [rad/s]
    float lateral;             ///< lateral acceleration, left > 0; for cross-checks          [m/s2]
    float wheel_difference;    ///< right minus left wheel of the unbraked axle; for cross-checks [m/s]
    float brake_pedal;         ///< pedal position, 0 released; for the override              [%]
    float abs_active;          ///< 0 not active, 1 active; for the override                  [-]
    float measured;            ///< measured output of the first actuator; compared with the demand. NaN: not measured [input unit]
    float request;             ///< LPVG_BUS_REQUEST_*                                         [-]
    float other_priority;      ///< highest priority of other commands on the actuator: 0 none, 1 low, 2 medium, 3 high [-]
} lpvg_bus_signals_t;

/// Report of the guarded controller to the vehicle, sent every step.
typedef struct lpvg_bus_report_t {
    float demand;        ///< applied demand, of the first input                            [input unit]
    float statistic;     ///< statistic of the newest judged frame (monitor.h)                [-]
    uint8_t verdict;       ///< lpvg_verdict_t
    uint8_t supervision;   ///< lpvg_can_state_t
    uint8_t engagement;    ///< lpvg_ecu_engagement_t
    uint8_t authenticated;  ///< 1: only authenticated frames of the command message are obeyed; 0: any
} lpvg_bus_report_t;

/// A message that the loop needs.
typedef struct lpvg_bus_need_t {
    uint8_t index;  ///< index in `rules`
    uint32_t spn;    ///< suspect parameter number of the trouble code for its loss
} lpvg_bus_need_t;

typedef struct lpvg_bus_t {
    const lpvg_can_rule_t* rules;  ///< rules of the received messages [n_rules]
    uint8_t n_rules;
    uint8_t own_address;           ///< J1939 source address
    uint32_t command_id;           ///< identifier and flags of the message that commands
    uint32_t authenticator_id;     ///< identifier and flags of its authenticator (authentication.h)
    uint16_t command_data_id;      ///< data id of the command message's end-to-end protection
    uint8_t n_needed;
    lpvg_bus_need_t needed[LPVG_CAN_RULES_MAX];
} lpvg_bus_t;

extern const lpvg_bus_t lpvg_bus;

/// Decodes the signals of an accepted frame of message `index`. Absent values become NaN. NULL is not checked.
void lpvg_bus_take(lpvg_bus_signals_t* signals, uint8_t index, const lpvg_can_frame_t* frame);

/// Packs the report with end-to-end protection and steps *counter. Values saturate at the ends of their range. frame->t_us is kept.
/// Returns ok; bad_argument when a pointer is NULL or *counter is out of range.
LPVG_NODISCARD lpvg_status_t lpvg_bus_pack_report(const lpvg_bus_report_t* report, lpvg_can_frame_t* frame, uint8_t* counter);

LPVG_EXTERN_C_END

#endif
#endif
