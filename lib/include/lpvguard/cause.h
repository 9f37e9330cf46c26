/// @file cause.h -- cause of an alarm. diagnosis.h finds it; ecu.h reports it.
#ifndef LPVGUARD_CAUSE_H
#define LPVGUARD_CAUSE_H

#include <stdbool.h>
#include <stdint.h>

#include "lpvguard/config.h"

#define lpvg_found_t LPVG_SYM(found_t)

typedef enum lpvg_cause_t {
    lpvg_cause_unknown = 0,  ///< No alarm yet, or too little settled and excited driving since the alarm.
    lpvg_cause_other = 1,    ///< No single cause explains the record.
    lpvg_cause_gain = 2,     ///< The output is the model's output times this factor; 1: no change.
    lpvg_cause_delay = 3,    ///< The output is late by this time; below 0: early, for example after a late input [s].
    lpvg_cause_bias = 4,     ///< The output is larger by this constant [output unit].
    lpvg_cause_sign = 5,     ///< A gain below 0.
    lpvg_cause_frozen = 6,   ///< The output does not move; the value is its mean [output unit].
    lpvg_cause_noise = 7     ///< The output is noisier; the value is the noise's standard deviation [output unit].
} lpvg_cause_t;

/// Result for one output. The interval is 0 for frozen and noise. All numbers are 0 for other.
typedef struct lpvg_found_t {
    lpvg_cause_t cause;
    lpvg_real_t value, low, high;  ///< value of the cause in its unit, and its 95 % interval
    uint32_t onset_blocks;         ///< number of blocks from the onset to the alarm
    bool before;                   ///< the onset is at or before the oldest kept block
} lpvg_found_t;

#endif
