/// @file j1939.h -- J1939 service: address claim, requests, trouble codes with memory and freeze frames.
///
/// A communication task calls it, outside lpvg_ecu_step and its budget. It depends on no vehicle.
/// Address: claimed as in J1939-81. The lower NAME wins. If its NAME allows it, a loser takes the next free address from
/// LPVG_J1939_ARBITRARY_MIN to LPVG_J1939_ARBITRARY_MAX. Otherwise it reports "cannot claim" from address 254. An address in that range
/// is used LPVG_J1939_CLAIM_US after its claim, any other address at once.
/// It answers requests (PGN 59904) to all or to its own address:
///
///     address claim 60928 -- the claim, or "cannot claim"
///     DM1 65226, DM2 65227 -- active, previously active codes with their occurrence counts
///     DM4 65229, DM25 64951 -- at most LPVG_J1939_FREEZE_MAX freeze frames, newest first; DM24 64950 describes the layout of DM25
///     DM3 65228, DM11 65235 -- clears previously active, active codes; acknowledges a request to this address
///     any other            -- refuses a request to this address (PGN 59392, control byte 1)
///
/// DM1 is sent every second, and when a code becomes active or inactive, at most once a second for each code. The transport protocol
/// (BAM, J1939-21) broadcasts messages longer than 8 bytes, with at least LPVG_J1939_PACKET_US between packets. Only one broadcast runs
/// at a time; the others wait, DM1 first.
///
/// Memory: lpvg_j1939_memory_t holds the codes, their counts and their freeze frames. The integrator keeps it over a reset, in no-init RAM
/// or non-volatile memory. lpvg_j1939_init checks its CRC-32 and keeps or clears it; every change renews the CRC. A code that is still
/// present after DM11 becomes active again.
///
/// Each freeze frame of DM4 holds its length, the code, and SPN 899, 102, 190, 92 and 110 as not available. The speed (SPN 84) follows,
/// then the data that DM25 holds after the speed. The low byte comes first. These data are:
///
/// - SPN 520210: bin (1 byte)
/// - SPN 520211: statistic (2 bytes, 1/1024)
/// - SPN 520212: causes LPVG_ECU_CAUSE_* (2 bytes)
/// - SPN 520213: time since start (4 bytes, ms)
/// - SPN 520214: number of the run (1 byte)
///
/// Use:     lpvg_j1939_init once -> lpvg_j1939_step at least every LPVG_J1939_STEP_US with all frames received since the last step ->
///          send the returned frames. Ask lpvg_j1939_pass for each frame of lpvg_ecu_step, and send it only if the answer is true.
/// Cost:    a few instructions per received frame, at most LPVG_J1939_CODES_MAX squared comparisons, and one CRC of the memory when a
///          code changed. lib/INTEGRATION.md states the count. No heap, no locks, no I/O, no recursion.
/// RAM:     sizeof(lpvg_j1939_t) + sizeof(lpvg_j1939_memory_t).
/// Threads: one object belongs to one task. The findings are a copy, so lpvg_ecu_step may run in another task.
/// Units:   time in microseconds of one monotonic clock, from 0 to INT64_MAX / 2.
///
/// Limits: a request to this address for more than 8 bytes is answered by a broadcast, never by a connection (RTS/CTS). DM3 and DM11 do
/// not end a lock; lpvg_ecu_acknowledge does.
#ifndef LPVGUARD_J1939_H
#define LPVGUARD_J1939_H

#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>

#include "lpvguard/can.h"
#include "lpvguard/findings.h"
#include "lpvguard/status.h"

#ifdef __cplusplus
extern "C" {
#endif

#define LPVG_J1939_FREEZE_MAX 8u  ///< Most freeze frames in an answer.
#define LPVG_J1939_FRAMES_OUT 8u  ///< Most frames that one step returns.
#define LPVG_J1939_REFUSALS_MAX 4u  ///< Most acknowledgements of one step; further requests are only counted.
#define LPVG_J1939_STEP_US 100000u  ///< Longest time between steps; packets then follow within 200 ms  [us]
#define LPVG_J1939_PACKET_US 50000u  ///< Shortest time between two packets                                 [us]
#define LPVG_J1939_DM1_US 1000000u  ///< Period of DM1                                                     [us]
#define LPVG_J1939_CLAIM_US 250000u  ///< Time from the claim of an arbitrary address to its use            [us]
#define LPVG_J1939_ARBITRARY_MIN 128u  ///< First address that a loser may take
#define LPVG_J1939_ARBITRARY_MAX 247u  ///< Last address that a loser may take
#define LPVG_J1939_ADDRESS_NULL 254u  ///< Source address of a node without address
#define LPVG_J1939_ADDRESS_ALL 255u  ///< Destination address for all nodes
#define LPVG_J1939_MESSAGE_MAX 184u  ///< Longest message: DM4 with LPVG_J1939_FREEZE_MAX freeze frames.

#define LPVG_J1939_SPN_BIN 520210u  ///< Contents of a freeze frame (J1939-73 leaves these numbers to makers).
#define LPVG_J1939_SPN_STATISTIC 520211u
#define LPVG_J1939_SPN_CAUSES 520212u
#define LPVG_J1939_SPN_TIME 520213u
#define LPVG_J1939_SPN_RUN 520214u

/// NAME of a controller application (J1939-81).
typedef struct lpvg_j1939_name_t {
    uint32_t identity;            ///< 0 .. 0x1FFFFF, unique for each device
    uint16_t manufacturer;        ///< 0 .. 2047, assigned by SAE
    uint8_t ecu_instance;         ///< 0 .. 7
    uint8_t function_instance;    ///< 0 .. 31
    uint8_t function;             ///< 0 .. 255
    uint8_t vehicle_system;       ///< 0 .. 127
    uint8_t system_instance;      ///< 0 .. 15
    uint8_t industry_group;       ///< 0 .. 7; 1: on-highway
    bool arbitrary;               ///< the node may take another address
} lpvg_j1939_name_t;

typedef struct lpvg_j1939_config_t {
    uint64_t name;    ///< NAME, packed by lpvg_j1939_name_pack; bit 63: the node may take another address
    uint8_t address;  ///< preferred address, 0 .. 253
} lpvg_j1939_config_t;

/// A code that is or was active.
typedef struct lpvg_j1939_entry_t {
    lpvg_j1939_freeze_t freeze;  ///< freeze frame of the newest activation
    uint32_t spn;
    uint8_t fmi;
    uint8_t occurrence;          ///< number of activations, at most 126; 0: the place is free
    uint8_t active;              ///< 1: active now
    uint8_t run;                 ///< number of the run of the newest activation, modulo 251
} lpvg_j1939_entry_t;

/// Data that survives a reset. The struct has no padding, so its CRC is defined.
typedef struct lpvg_j1939_memory_t {
    uint32_t version;      ///< version of this struct
    uint32_t runs;         ///< number of runs since init cleared it
    uint32_t activations;  ///< number of activations, saturating
    uint32_t crc32;        ///< CRC-32 (ISO-HDLC) of the struct, with this field read as zero
    lpvg_j1939_entry_t entry[LPVG_J1939_CODES_MAX];
} lpvg_j1939_memory_t;

typedef enum lpvg_j1939_state_t {
    lpvg_j1939_state_none = 0,     ///< Before the first step.
    lpvg_j1939_state_waiting = 1,  ///< An address is claimed but not yet used.
    lpvg_j1939_state_claimed = 2,
    lpvg_j1939_state_lost = 3      ///< No address could be claimed; nothing else is sent.
} lpvg_j1939_state_t;

/// A broadcast of several packets.
typedef struct lpvg_j1939_broadcast_t {
    int64_t packet_us;  ///< time of the newest packet                      [us]
    uint16_t size;      ///< length                                        [bytes]
    uint8_t next;       ///< number of the next packet, from 1; 0: none runs
    uint8_t data[LPVG_J1939_MESSAGE_MAX];
} lpvg_j1939_broadcast_t;

/// An acknowledgement to send.
typedef struct lpvg_j1939_answer_t {
    uint32_t pgn;
    uint8_t control;  ///< 0 positive, 1 negative
    uint8_t to;       ///< destination address
} lpvg_j1939_answer_t;

typedef struct lpvg_j1939_t {
    lpvg_j1939_config_t config;
    lpvg_j1939_memory_t* memory;
    int64_t now_us;                         ///< time of the newest step                           [us]
    int64_t claim_us;                       ///< time at which a claim is or was due               [us]
    int64_t dm1_us;                         ///< time at which the newest DM1 began                [us]
    int64_t told_us[LPVG_J1939_CODES_MAX];  ///< time of the newest DM1 for a change of each entry [us]
    lpvg_j1939_broadcast_t broadcast;
    lpvg_j1939_answer_t answer[LPVG_J1939_REFUSALS_MAX];
    uint32_t unanswered;                    ///< requests beyond LPVG_J1939_REFUSALS_MAX, saturating
    uint32_t taken[8];                      ///< addresses that others have claimed, one bit each
    uint8_t listed[LPVG_J1939_CODES_MAX];   ///< entries of the active codes, most severe first
    uint8_t n_listed;
    uint8_t n_answers;
    uint8_t waiting;                        ///< messages to send, one bit each
    uint8_t state;                          ///< lpvg_j1939_state_t
    uint8_t address;                        ///< claimed or being claimed; LPVG_J1939_ADDRESS_NULL: none
    bool claim;                             ///< a claim will be sent at claim_us
    bool changed;                           ///< the memory has changed since its CRC was computed
} lpvg_j1939_t;

/// Packs a NAME. Returns ok; bad_argument for NULL or a field that is too large. *packed changes only with ok.
LPVG_NODISCARD lpvg_status_t lpvg_j1939_name_pack(const lpvg_j1939_name_t* name, uint64_t* packed);

/// Initialises *self and keeps a reference to `memory`, which must outlive it. With a right CRC the memory is kept, and its active codes
/// become previously active. Otherwise it is cleared. *kept says which; `kept` may be NULL.
/// Returns ok; bad_argument for NULL, an address above 253, or a time out of range. *self and *memory change only with ok.
LPVG_NODISCARD lpvg_status_t lpvg_j1939_init(lpvg_j1939_t* self, const lpvg_j1939_config_t* config, lpvg_j1939_memory_t* memory,
                                             int64_t now_us, bool* kept);

/// Takes the frames received since the last step and the present findings. It reads claims and requests, and ignores other frames.
/// `frames_in` may be NULL when n_in is 0. Writes *n_out frames to frames_out, with time now_us.
/// Returns ok; bad_argument for NULL, max_out < LPVG_J1939_FRAMES_OUT, too many codes or an impossible code; not_ready before init;
/// out_of_order for a time before the last step or beyond INT64_MAX / 2. Unless ok is returned, nothing changes and *n_out is 0.
LPVG_NODISCARD lpvg_status_t lpvg_j1939_step(lpvg_j1939_t* self, int64_t now_us, const lpvg_can_frame_t* frames_in, size_t n_in,
                                             const lpvg_j1939_findings_t* findings, lpvg_can_frame_t* frames_out, size_t max_out,
                                             size_t* n_out);

/// Decides whether a frame of lpvg_ecu_step may be sent, and writes the claimed address into it.
/// Returns false while no address is claimed, for a DM1 (this module sends it), and for NULL.
bool lpvg_j1939_pass(const lpvg_j1939_t* self, lpvg_can_frame_t* frame);

/// Returns the usable address; LPVG_J1939_ADDRESS_NULL when there is none, and for NULL.
uint8_t lpvg_j1939_address(const lpvg_j1939_t* self);

/// Returns entry `index` of the memory with its freeze frame; NULL when the place is free, for NULL, and before init.
const lpvg_j1939_entry_t* lpvg_j1939_entry(const lpvg_j1939_t* self, uint8_t index);

#ifdef __cplusplus
}
#endif
#endif
