/// @file life.h -- lifetime test: do a vehicle's recordings still agree with the calibration recordings?
///
/// Each recording gives one score. The test compares it with a few scores of the calibration set and bets against "the recording
/// agrees". The wealth starts at 1 and grows when bets win. A healthy vehicle reaches the wealth `alarm` = 1/alpha, in a life of any
/// length, with probability at most alpha. This holds for all calibration sets except a stated share (THEORY 7.8). An alarm says
/// "changed"; it falsifies no bound.
///
/// Use:     `lpvguard fleet --export` writes an lpvg_life_table_t. At power-on call lpvg_life_load with the stored bytes, or
///          lpvg_life_init without any. After each recording call lpvg_life_update, then lpvg_life_save into non-volatile memory.
/// Score:   mean of `monitor.change.ratio` over the first `judged_s` seconds of samples with two properties: the speed was in range
///          for longer than the model's settling time, and the ratio is above 0. A shorter recording gives no score.
/// Cost:    constant, once per recording, outside the monitor's step. Independent of the vehicle. No heap, no locks, no I/O.
/// Threads: one object per thread. RAM: sizeof(lpvg_life_t). All numbers are 32-bit floats, and no operation can be contracted, so
///          every target computes the same bits.
#ifndef LPVGUARD_LIFE_H
#define LPVGUARD_LIFE_H

#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>

#include "lpvguard/status.h"

#ifdef __cplusplus
extern "C" {
#endif

#define LPVG_LIFE_MAGIC 0x4546494CU  ///< "LIFE", first byte lowest.
#define LPVG_LIFE_SCHEMA 1U
#define LPVG_LIFE_LEVELS 8U  ///< Largest number of stored calibration scores.
#define LPVG_LIFE_BETS 3U
#define LPVG_LIFE_START 64U      ///< Number of recordings after which half of the wealth is at stake.
#define LPVG_LIFE_MOST 16777151U  ///< Largest number of counted recordings; a float counts exactly up to LPVG_LIFE_START more.
#define LPVG_LIFE_BYTES 28U      ///< Number of stored bytes.

/// Table of a calibration set. Levels and factors beyond n_levels are 0.
typedef struct lpvg_life_table_t {
    uint32_t magic;
    uint32_t schema;
    uint32_t calibrated;  ///< number of calibration recordings
    uint32_t n_levels;    ///< 1 .. LPVG_LIFE_LEVELS
    float judged_s;       ///< length of judged driving for one score                            [s]
    float alarm;          ///< wealth that alarms, 1/alpha                                       [-]
    float level[LPVG_LIFE_LEVELS];  ///< ascending scores of the calibration set                 [-]
    float factor[LPVG_LIFE_LEVELS + 1U][LPVG_LIFE_BETS];  ///< factor of each bet, by the number of levels below the score  [-]
    uint32_t crc32;       ///< CRC-32 (ISO-HDLC) of all words before, low byte first
} lpvg_life_table_t;

typedef struct lpvg_life_t {
    const lpvg_life_table_t* table;
    uint32_t recordings;        ///< number of counted recordings
    float bet[LPVG_LIFE_BETS];  ///< wealth of each bet                                          [-]
    uint32_t changed_at;        ///< number of the recording with which the wealth first reached `alarm`; 0: never
    uint32_t crc32;             ///< CRC-32 of the other fields after the last call
} lpvg_life_t;

/// Checks a table. Returns ok, bad_argument for NULL, bad_magic, bad_schema, bad_crc or not_finite. Returns bad_value when levels do
/// not ascend, a factor is below 0, or the alarm is not above 1.
LPVG_NODISCARD lpvg_status_t lpvg_life_table_check(const lpvg_life_table_t* table);

/// Starts a life without any recording. Keeps a reference to the table.
/// Returns bad_argument for NULL, or the status of lpvg_life_table_check. *self changes only with ok.
LPVG_NODISCARD lpvg_status_t lpvg_life_init(lpvg_life_t* self, const lpvg_life_table_t* table);

/// Takes the score of a recording.
/// Returns ok; bad_argument for NULL; not_ready before init; bad_crc when a bit of *self has changed (load or init it again);
/// bad_sample when the score is not finite or below 0. *self changes only with ok.
LPVG_NODISCARD lpvg_status_t lpvg_life_update(lpvg_life_t* self, float score);

/// Returns the wealth, 1 at first; 0 for NULL and before init.
float lpvg_life_wealth(const lpvg_life_t* self);

/// Returns whether the wealth has ever reached `alarm`; false for NULL and before init.
bool lpvg_life_changed(const lpvg_life_t* self);

/// Writes the bytes to store. They do not depend on the processor's byte order. Returns ok, bad_argument for NULL, not_ready or bad_crc.
LPVG_NODISCARD lpvg_status_t lpvg_life_save(const lpvg_life_t* self, uint8_t bytes[LPVG_LIFE_BYTES]);

/// Continues a life from the bytes that lpvg_life_save wrote.
/// Returns the status of lpvg_life_init; bad_crc when a bit of the bytes has changed; bad_value when they belong to another table
/// or are no life. *self changes only with ok.
LPVG_NODISCARD lpvg_status_t lpvg_life_load(lpvg_life_t* self, const lpvg_life_table_t* table, const uint8_t bytes[LPVG_LIFE_BYTES]);

#ifdef __cplusplus
}
#endif
#endif
