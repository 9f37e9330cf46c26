/// @file findings.h -- present findings of an ECU, as trouble codes with a freeze frame. ecu.h fills them; j1939.h reports them.
#ifndef LPVGUARD_FINDINGS_H
#define LPVGUARD_FINDINGS_H

#include <stdint.h>

#include "lpvguard/can.h"

#define LPVG_J1939_CODES_MAX 16u  ///< Most remembered codes, and most active codes.

/// Freeze frame of a code that becomes active.
typedef struct lpvg_j1939_freeze_t {
    int64_t t_us;       ///< time of the finding, clock of the step            [us]
    float statistic;    ///< statistic of the newest judged frame or alarm     [-]
    float speed;        ///< speed; NaN: not known                             [m/s]
    uint32_t sequence;  ///< number of this activation, from 1; set by this module
    uint16_t causes;    ///< LPVG_ECU_CAUSE_*
    uint8_t bin;        ///< bin of the judged frame or of the alarm
    uint8_t test;       ///< lpvg_test_t
} lpvg_j1939_freeze_t;

/// Present findings. lpvg_ecu_findings of ecu.h fills it.
typedef struct lpvg_j1939_findings_t {
    lpvg_j1939_freeze_t freeze;                  ///< freeze frame; its sequence is ignored
    lpvg_can_dtc_t code[LPVG_J1939_CODES_MAX];   ///< most severe first; their occurrence is ignored
    uint8_t n_codes;                             ///< 0 .. LPVG_J1939_CODES_MAX
} lpvg_j1939_findings_t;

#endif
