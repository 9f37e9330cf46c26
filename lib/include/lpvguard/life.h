/// @file life.h -- the wealth of a vehicle over its whole life: is it still like the recordings that calibrated, of a fixed length?
///
/// A score a recording, compared with a few scores of the calibration set. Wealth starts at 1 and grows by what bets against "as those
/// that calibrate" win. For all calibration sets but a stated share it reaches `alarm` = 1/alpha in a life of any length with probability
/// alpha at most (THEORY 7.8). An alarm says "changed"; it falsifies no bound.
///
/// Use:     `lpvguard fleet --export` writes an lpvg_life_table_t. lpvg_life_load at power-on with the stored bytes, or lpvg_life_init
///          without any; once a recording lpvg_life_update, then lpvg_life_save into memory that survives power-off.
/// Score:   the mean of `monitor.change.ratio` over the first `judged_s` seconds of samples whose speed was in range for longer than
///          the model settles, and where it is above 0. A recording that is shorter is no recording.
/// Cost:    constant, once a recording: it is no part of the monitor's step. Of no vehicle's sizes. No heap, no locks, no I/O.
/// Threads: one object per thread. RAM: sizeof(lpvg_life_t). Numbers are 32-bit floats whatever the image's number type, and no
///          operation can be contracted: every target has the same bits.
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
#define LPVG_LIFE_LEVELS 8U  ///< Scores of the calibration set, at most.
#define LPVG_LIFE_BETS 3U
#define LPVG_LIFE_START 64U      ///< After so many recordings half of the money is on the bets.
#define LPVG_LIFE_MOST 16777151U  ///< Recordings that are counted: START above it, floats still count by one.
#define LPVG_LIFE_BYTES 28U      ///< What survives power-off.

/// What a calibration set gives. Levels and factors above n_levels are 0.
typedef struct lpvg_life_table_t {
    uint32_t magic;
    uint32_t schema;
    uint32_t calibrated;  ///< recordings that calibrate
    uint32_t n_levels;    ///< 1 .. LPVG_LIFE_LEVELS
    float judged_s;       ///< judged driving that a score is of                                 [s]
    float alarm;          ///< wealth that alarms, 1/alpha                                       [-]
    float level[LPVG_LIFE_LEVELS];  ///< ascending scores of the calibration set                 [-]
    float factor[LPVG_LIFE_LEVELS + 1U][LPVG_LIFE_BETS];  ///< of each bet, by the number of levels below the score  [-]
    uint32_t crc32;       ///< CRC-32 (ISO-HDLC) of all words before, low byte first
} lpvg_life_table_t;

typedef struct lpvg_life_t {
    const lpvg_life_table_t* table;
    uint32_t recordings;        ///< counted
    float bet[LPVG_LIFE_BETS];  ///< wealth of each bet                                          [-]
    uint32_t changed_at;        ///< number of the recording with which the wealth first reached `alarm`; 0: never
    uint32_t crc32;             ///< as the last call left the other fields
} lpvg_life_t;

/// Looks through a table. Returns bad_argument (NULL), bad_magic, bad_schema, bad_crc, not_finite, or bad_value: levels that do not
/// ascend, a factor below 0, an alarm not above 1.
LPVG_NODISCARD lpvg_status_t lpvg_life_table_check(const lpvg_life_table_t* table);

/// A life without any recording. The table is kept by address. Returns what the check says, or bad_argument; *self is untouched then.
LPVG_NODISCARD lpvg_status_t lpvg_life_init(lpvg_life_t* self, const lpvg_life_table_t* table);

/// Takes the score of a recording. Returns bad_argument (NULL), not_ready (no init), bad_crc (a bit of *self has changed: load or
/// init it anew) or bad_sample (not finite, or below 0: no recording is counted); nothing is changed then.
LPVG_NODISCARD lpvg_status_t lpvg_life_update(lpvg_life_t* self, float score);

/// The wealth, 1 at first; 0 for NULL and without init.
float lpvg_life_wealth(const lpvg_life_t* self);

/// Whether the wealth has ever reached `alarm`; false for NULL and without init.
bool lpvg_life_changed(const lpvg_life_t* self);

/// Writes what survives power-off, the same bytes whatever the processor's order. Returns bad_argument (NULL), not_ready, bad_crc.
LPVG_NODISCARD lpvg_status_t lpvg_life_save(const lpvg_life_t* self, uint8_t bytes[LPVG_LIFE_BYTES]);

/// Goes on with a life that lpvg_life_save wrote. Returns what init does, bad_crc where a bit of the bytes has changed, or bad_value where
/// they are of another table or no life; *self is untouched then.
LPVG_NODISCARD lpvg_status_t lpvg_life_load(lpvg_life_t* self, const lpvg_life_table_t* table, const uint8_t bytes[LPVG_LIFE_BYTES]);

#ifdef __cplusplus
}
#endif
#endif
