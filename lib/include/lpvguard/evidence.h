/// @file evidence.h -- keeps the samples around an alarm, so that the model can learn from them (`lpvguard refine`).
///
/// A ring stores every sample: speed, inputs, outputs. An *event* is a worse verdict (degraded, invalid), or a near alarm: the largest
/// ratio of the drive so far. After `after` further samples the ring is frozen and becomes a *record* with a number. Then the next ring
/// begins. Records of the highest level are kept; within a level, those with the largest ratio. A gap in the samples ends the record.
/// A gap also empties a ring without an event, and a ring with fewer samples since the previous record than there are slots.
///
/// Bytes of a record, the low byte first:
///
///     0  magic "LPVE"       12  CRC of the coefficients   28  level                  32  ratio (float)
///     4  schema             16  period [us]               29  channels               36  time of the event [us], 8 bytes
///     8  number             20  samples                   30  inputs among them      44  value of a bit by channel (float), 8 times
///                           24  samples up to the event   31  0                      76  samples: 16 bits a channel
///
/// and at the end the CRC-32 of all previous bytes. A sample that is not a number is -32768.
///
/// Memory: two areas of non-volatile memory, each LPVG_EVIDENCE_HEAD + lpvg_evidence_size bytes. lpvg_evidence_write_next gives
/// the bytes to write and their place. The head of an area is cleared first and written last. If power fails at any byte,
/// lpvg_evidence_stored finds either the whole previous record or the whole new one.
///
/// UDS: lpvg_evidence_answer answers 22 4C03 (the records: number, level, ratio, size), 35 (upload of a record by its number), 36 and 37.
/// A chunk of 64 bytes also fits one CAN FD frame.
///
/// Use:     init at the start of a drive -> take after each push of the monitor -> read or store records between steps.
/// Cost:    take: one multiplication per channel, and a check of one slot. No heap, no locks, no I/O.
/// Threads: one object per thread. RAM: sizeof(lpvg_evidence_t) and the caller's buffer: 2 * slots * samples * channels bytes.
#ifndef LPVGUARD_EVIDENCE_H
#define LPVGUARD_EVIDENCE_H

#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>

#include "lpvguard/status.h"

#ifdef __cplusplus
extern "C" {
#endif

#define LPVG_EVIDENCE_MAGIC 0x4556504CU  ///< "LPVE", first byte lowest.
#define LPVG_EVIDENCE_SCHEMA 1U
#define LPVG_EVIDENCE_CHANNELS_MAX 8U  ///< Most channels.
#define LPVG_EVIDENCE_SLOTS_MAX 8U  ///< Most slots: one ring, the others for records.
#define LPVG_EVIDENCE_HEADER 76U  ///< Bytes of a record before its samples.
#define LPVG_EVIDENCE_HEAD 16U  ///< Bytes of an area before the record.
#define LPVG_EVIDENCE_CHUNK 64U  ///< Most bytes of a chunk.
#define LPVG_EVIDENCE_RECORDS 0x4C03U  ///< Identifier of the records in UDS.
#define LPVG_EVIDENCE_ANSWER_MAX 94U  ///< Longest answer: seven records.

/// Reason for a record, in increasing order of importance.
typedef enum lpvg_evidence_level_t {
    lpvg_evidence_none = 0,
    lpvg_evidence_near = 1,      ///< The largest ratio of the drive, without an alarm.
    lpvg_evidence_degraded = 2,  ///< Verdict degraded.
    lpvg_evidence_invalid = 3    ///< Verdict invalid.
} lpvg_evidence_level_t;

typedef struct lpvg_evidence_config_t {
    int16_t* buffer;        ///< [slots * samples * channels], outlives the object
    uint32_t samples;       ///< samples of a record, > after
    uint32_t after;         ///< samples after an event, >= slots
    uint32_t period_us;     ///< sample period, 1 .. 10^9                                        [us]
    uint32_t coefficients;  ///< CRC-32 of the coefficients that judge
    float near_ratio;       ///< least ratio of a near alarm; above 1: none                      [-]
    float scale[LPVG_EVIDENCE_CHANNELS_MAX];  ///< value of one bit by channel, > 0              [channel unit]
    uint8_t channels;       ///< speed, inputs and outputs, 3 .. LPVG_EVIDENCE_CHANNELS_MAX
    uint8_t inputs;         ///< number of inputs, 1 .. channels - 2
    uint8_t slots;          ///< 2 .. LPVG_EVIDENCE_SLOTS_MAX
} lpvg_evidence_config_t;

/// A ring, or the record made from it.
typedef struct lpvg_evidence_slot_t {
    uint32_t number;  ///< number of the record; 0: none
    uint32_t next;    ///< index of the next sample, which is the oldest one of a full ring
    uint32_t count;   ///< samples in the ring
    uint32_t before;  ///< samples up to the event
    int64_t t_us;     ///< time of the event                                                     [us]
    float ratio;      ///< largest ratio since the event                                         [-]
    uint32_t rank;    ///< order of the record by level, then ratio; 0: none
    lpvg_evidence_level_t level;
} lpvg_evidence_slot_t;

typedef struct lpvg_evidence_t {
    lpvg_evidence_config_t config;
    float bits[LPVG_EVIDENCE_CHANNELS_MAX];  ///< 1 / scale
    lpvg_evidence_slot_t slot[LPVG_EVIDENCE_SLOTS_MAX];
    uint32_t active;     ///< slot of the ring
    uint32_t remaining;  ///< samples until the ring is frozen; 0: no event
    uint32_t numbered;   ///< number of the newest record
    uint32_t gap_us;     ///< least step that is a gap: one and a half periods                   [us]
    uint32_t seen;       ///< number of slots checked so far for `least`
    uint32_t least;      ///< slot for the next ring; `active`: none found yet
    int64_t t_us;        ///< time of the newest sample                                          [us]
    float largest;       ///< largest ratio of the drive so far                                  [-]
    lpvg_evidence_level_t level;  ///< level of the newest sample
    bool running;        ///< a sample has been taken
} lpvg_evidence_t;

/// State of reading a record from its first to its last byte.
typedef struct lpvg_evidence_reader_t {
    const lpvg_evidence_t* ring;
    uint32_t number;  ///< number of the record
    uint32_t slot;
    uint32_t offset;  ///< bytes read so far
    uint32_t size;    ///< bytes of the record
    uint32_t crc;     ///< CRC-32 of the bytes read so far, not yet inverted
} lpvg_evidence_reader_t;

/// A whole record in non-volatile memory.
typedef struct lpvg_evidence_stored_t {
    const uint8_t* record;  ///< NULL: none
    uint32_t size;          ///< bytes of the record
    uint32_t sequence;      ///< number of the write
    uint8_t area;           ///< 0 or 1
} lpvg_evidence_stored_t;

/// Bytes to write.
typedef struct lpvg_evidence_chunk_t {
    uint32_t offset;  ///< from the start of the area
    uint32_t size;
    uint8_t data[LPVG_EVIDENCE_CHUNK];
    uint8_t area;     ///< 0 or 1
} lpvg_evidence_chunk_t;

/// State of writing a record.
typedef struct lpvg_evidence_writer_t {
    lpvg_evidence_reader_t reader;
    uint32_t sequence;  ///< number of this write
    uint8_t area;       ///< 0 or 1
    uint8_t step;       ///< 0: clears the head; 1: writes the record; 2: writes the head; 3: done
} lpvg_evidence_writer_t;

/// An upload by UDS.
typedef struct lpvg_evidence_upload_t {
    lpvg_evidence_reader_t reader;
    uint8_t data[LPVG_EVIDENCE_CHUNK];  ///< newest block
    uint32_t size;                      ///< number of bytes in it
    uint8_t counter;                    ///< number of the block
    bool open;
} lpvg_evidence_upload_t;

/// Initialises *self without a record.
/// Returns ok, or bad_argument for NULL or a setting outside its range. *self changes only with ok.
LPVG_NODISCARD lpvg_status_t lpvg_evidence_init(lpvg_evidence_t* self, const lpvg_evidence_config_t* config);

/// Takes a sample at t_us [us]. `values` [channels] are speed, inputs, outputs. `level` is the level of the verdict; none if the
/// verdict is neither degraded nor invalid. `ratio` is the largest ratio of a test to its threshold; ignored if it is not finite.
/// Returns ok; bad_argument for NULL; not_ready before init; out_of_order for a sample that is not newer, which is ignored.
LPVG_NODISCARD lpvg_status_t lpvg_evidence_take(lpvg_evidence_t* self, int64_t t_us, const float* values, lpvg_evidence_level_t level,
                                                float ratio);

/// Returns the number of a record by its rank (0 is the highest); 0 for NULL and if there is none.
uint32_t lpvg_evidence_number(const lpvg_evidence_t* self, uint32_t rank);

/// Returns the size of the longest record of a configuration [bytes]; 0 for NULL.
uint32_t lpvg_evidence_size(const lpvg_evidence_config_t* config);

/// Frees the slot of a record after it was read or stored. Returns false if there is no such record, and for NULL.
bool lpvg_evidence_release(lpvg_evidence_t* self, uint32_t number);

/// Begins to read a record. Returns ok, bad_argument for NULL, or bad_value if no record has that number.
LPVG_NODISCARD lpvg_status_t lpvg_evidence_open(lpvg_evidence_reader_t* reader, const lpvg_evidence_t* ring, uint32_t number);

/// Writes the next bytes of the record into bytes [max]. Returns their number, 0 at the end and for NULL. It also returns 0
/// once a higher record has replaced this one; `offset` then stays below `size`.
size_t lpvg_evidence_read(lpvg_evidence_reader_t* reader, uint8_t* bytes, size_t max);

/// Finds the newest whole record in two areas [capacity]. Returns ok, bad_argument for NULL, or bad_crc if neither area has one;
/// *found then has no record.
LPVG_NODISCARD lpvg_status_t lpvg_evidence_stored(const uint8_t* first, const uint8_t* second, size_t capacity,
                                                  lpvg_evidence_stored_t* found);

/// Begins to write a record into the area that does not hold `newest`. Returns the status of lpvg_evidence_open.
LPVG_NODISCARD lpvg_status_t lpvg_evidence_write(lpvg_evidence_writer_t* writer, const lpvg_evidence_t* ring, uint32_t number,
                                                 const lpvg_evidence_stored_t* newest);

/// Gives the next bytes to write, in the order in which they must reach the memory. Returns false when all are written, for NULL, and
/// once the record has been replaced; the other area is then unchanged.
bool lpvg_evidence_write_next(lpvg_evidence_writer_t* writer, lpvg_evidence_chunk_t* chunk);

/// Answers a UDS request [n] into answer [max], as lpvg_uds_answer does. Returns the length of the answer, 0 for nothing to send: NULL,
/// an empty request, or max below LPVG_EVIDENCE_ANSWER_MAX. Reasons of a refusal: 11 service, 13 length, 24 no upload is open, 31 no such
/// identifier or record, 73 number of the block.
size_t lpvg_evidence_answer(lpvg_evidence_upload_t* upload, const lpvg_evidence_t* ring, const uint8_t* request, size_t n, uint8_t* answer,
                            size_t max);

#ifdef __cplusplus
}
#endif
#endif
