/// @file j1939.h -- J1939 beside the step: address claim, requests, trouble codes with memory and freeze frames.
///
/// Stands beside lpvg_ecu_step and outside of its budget: a communication task calls it. It depends on no vehicle.
/// Address: claimed as in J1939-81. The lower NAME wins. Who loses takes the next free address from LPVG_J1939_ARBITRARY_MIN to
/// LPVG_J1939_ARBITRARY_MAX when its NAME says that it can, and otherwise tells from address 254 that it cannot claim. An address in that
/// range is used LPVG_J1939_CLAIM_US after its claim, any other one at once.
/// Requests (PGN 59904) to all or to the own address are answered:
///
///     address claim 60928 -- the claim, or that it cannot
///     DM1 65226, DM2 65227 -- active, previously active codes with the times that each became active
///     DM4 65229, DM25 64951 -- freeze frames, the newest first, LPVG_J1939_FREEZE_MAX at most; DM24 64950 says how DM25 is read
///     DM3 65228, DM11 65235 -- forgets previously active, active codes; acknowledged where it was asked of this address
///     any other            -- refused (PGN 59392, control byte 1) where it was asked of this address
///
/// DM1 goes out when a code becomes active or has gone, for each code once a second at most, and every second. What is longer than
/// 8 bytes is broadcast by the transport protocol (BAM, J1939-21), a packet LPVG_J1939_PACKET_US or more after the one before.
/// One broadcast runs at a time, the others wait: DM1 first.
///
/// Memory: codes, their counts and what each froze stand in lpvg_j1939_memory_t, which the integrator keeps over a reset
/// (no-init RAM or non-volatile memory). Its CRC-32 is checked by init, which keeps or clears it, and renewed with every change. A code
/// that is still present after DM11 becomes active anew.
///
/// DM4 holds, of each freeze frame: its length, the code, SPN 899, 102, 190, 92 and 110 as not available, the speed (SPN 84), then what
/// DM25 holds behind the speed: SPN 520210 bin (1 byte), 520211 statistic (2 bytes, 1/1024), 520212 causes (2 bytes, LPVG_ECU_CAUSE_*),
/// 520213 time since start (4 bytes, ms), 520214 number of the run (1 byte), all with the low byte first.
///
/// Use:     lpvg_j1939_init once -> lpvg_j1939_step at least every LPVG_J1939_STEP_US with all frames received since -> send what it
/// returns.
///          Frames of lpvg_ecu_step go through lpvg_j1939_pass, and only those that it lets pass are sent.
/// Cost:    a few instructions for each frame received, at most LPVG_J1939_CODES_MAX squared comparisons, one CRC of the memory where a
///          code changed. lib/INTEGRATION.md has the count. No heap, no locks, no I/O, no recursion.
/// RAM:     sizeof(lpvg_j1939_t) + sizeof(lpvg_j1939_memory_t).
/// Threads: no hidden state; one object belongs to one task. The findings are a copy, so that the step may run in another one.
/// Units:   time in microseconds of one monotonic clock, from 0 to INT64_MAX / 2.
///
/// Limits: a request to this address alone for more than 8 bytes is answered by broadcast too, never by a connection (RTS/CTS). The clear
/// by DM3 or DM11 ends no lock: lpvg_ecu_acknowledge does.
#ifndef LPVGUARD_J1939_H
#define LPVGUARD_J1939_H

#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>

#include "lpvguard/can.h"
#include "lpvguard/status.h"

#ifdef __cplusplus
extern "C" {
#endif

#define LPVG_J1939_CODES_MAX 16u  ///< Codes remembered; so many may be active.
#define LPVG_J1939_FREEZE_MAX 8u  ///< Freeze frames in an answer.
#define LPVG_J1939_FRAMES_OUT 8u  ///< Most frames that one step returns.
#define LPVG_J1939_REFUSALS_MAX 4u  ///< Acknowledgements of one step; requests beyond are counted.
#define LPVG_J1939_STEP_US 100000u  ///< Longest time between steps, so that packets follow each other within 200 ms [us]
#define LPVG_J1939_PACKET_US 50000u  ///< Shortest time between two packets                                 [us]
#define LPVG_J1939_DM1_US 1000000u  ///< Period of DM1                                                     [us]
#define LPVG_J1939_CLAIM_US 250000u  ///< From the claim of an arbitrary address to its use                 [us]
#define LPVG_J1939_ARBITRARY_MIN 128u  ///< Addresses that a loser takes
#define LPVG_J1939_ARBITRARY_MAX 247u
#define LPVG_J1939_ADDRESS_NULL 254u  ///< Source of who has no address
#define LPVG_J1939_ADDRESS_ALL 255u  ///< Destination of what is for all
#define LPVG_J1939_MESSAGE_MAX 184u  ///< Longest message: DM4 with LPVG_J1939_FREEZE_MAX freeze frames.

#define LPVG_J1939_SPN_BIN 520210u  ///< What a freeze frame holds (numbers that J1939-73 leaves to makers).
#define LPVG_J1939_SPN_STATISTIC 520211u
#define LPVG_J1939_SPN_CAUSES 520212u
#define LPVG_J1939_SPN_TIME 520213u
#define LPVG_J1939_SPN_RUN 520214u

/// NAME of a controller application (J1939-81).
typedef struct lpvg_j1939_name_t {
    uint32_t identity;            ///< 0 .. 0x1FFFFF, of each device another one
    uint16_t manufacturer;        ///< 0 .. 2047, assigned by SAE
    uint8_t ecu_instance;         ///< 0 .. 7
    uint8_t function_instance;    ///< 0 .. 31
    uint8_t function;             ///< 0 .. 255
    uint8_t vehicle_system;       ///< 0 .. 127
    uint8_t system_instance;      ///< 0 .. 15
    uint8_t industry_group;       ///< 0 .. 7; 1: on-highway
    bool arbitrary;               ///< may take another address
} lpvg_j1939_name_t;

typedef struct lpvg_j1939_config_t {
    uint64_t name;    ///< of lpvg_j1939_name_pack; bit 63: may take another address
    uint8_t address;  ///< preferred, 0 .. 253
} lpvg_j1939_config_t;

/// What a code that becomes active freezes.
typedef struct lpvg_j1939_freeze_t {
    int64_t t_us;       ///< time of the finding, the step's clock             [us]
    float statistic;    ///< of the newest judged frame, or of the alarm       [-]
    float speed;        ///< NaN: not known                                    [m/s]
    uint32_t sequence;  ///< number of this activation, from 1; by the module
    uint16_t causes;    ///< LPVG_ECU_CAUSE_*
    uint8_t bin;        ///< of the frame or of the energy test's alarm
    uint8_t test;       ///< lpvg_test_t
} lpvg_j1939_freeze_t;

/// What is wrong now: lpvg_ecu_findings of ecu.h fills it.
typedef struct lpvg_j1939_findings_t {
    lpvg_j1939_freeze_t freeze;                  ///< its sequence is not read
    lpvg_can_dtc_t code[LPVG_J1939_CODES_MAX];   ///< the gravest first; their occurrence is not read
    uint8_t n_codes;                             ///< 0 .. LPVG_J1939_CODES_MAX
} lpvg_j1939_findings_t;

/// A code that is or was active.
typedef struct lpvg_j1939_entry_t {
    lpvg_j1939_freeze_t freeze;  ///< when it became active last
    uint32_t spn;
    uint8_t fmi;
    uint8_t occurrence;          ///< times that it became active, 126 at most; 0: the place is free
    uint8_t active;              ///< 1: now
    uint8_t run;                 ///< in which run it became active last, modulo 251
} lpvg_j1939_entry_t;

/// What survives a reset. Without holes, so that its CRC is defined.
typedef struct lpvg_j1939_memory_t {
    uint32_t version;      ///< of this struct
    uint32_t runs;         ///< times that init kept it, and once for the clear
    uint32_t activations;  ///< saturating
    uint32_t crc32;        ///< CRC-32 (ISO-HDLC) of all of it, this read as zero
    lpvg_j1939_entry_t entry[LPVG_J1939_CODES_MAX];
} lpvg_j1939_memory_t;

typedef enum lpvg_j1939_state_t {
    lpvg_j1939_state_none = 0,     ///< Before the first step.
    lpvg_j1939_state_waiting = 1,  ///< Claimed, not yet used.
    lpvg_j1939_state_claimed = 2,
    lpvg_j1939_state_lost = 3      ///< Cannot claim an address; nothing else is sent.
} lpvg_j1939_state_t;

/// A broadcast of several packets.
typedef struct lpvg_j1939_broadcast_t {
    int64_t packet_us;  ///< when the newest packet left                    [us]
    uint16_t size;      ///< bytes
    uint8_t next;       ///< number of the next packet, from 1; 0: none runs
    uint8_t data[LPVG_J1939_MESSAGE_MAX];
} lpvg_j1939_broadcast_t;

/// An acknowledgement to send.
typedef struct lpvg_j1939_answer_t {
    uint32_t pgn;
    uint8_t control;  ///< 0 positive, 1 negative
    uint8_t to;
} lpvg_j1939_answer_t;

typedef struct lpvg_j1939_t {
    lpvg_j1939_config_t config;
    lpvg_j1939_memory_t* memory;
    int64_t now_us;                         ///< of the newest step                                [us]
    int64_t claim_us;                       ///< when a claim is or was due                        [us]
    int64_t dm1_us;                         ///< when the newest DM1 began                         [us]
    int64_t told_us[LPVG_J1939_CODES_MAX];  ///< when a change of this entry was told last         [us]
    lpvg_j1939_broadcast_t broadcast;
    lpvg_j1939_answer_t answer[LPVG_J1939_REFUSALS_MAX];
    uint32_t unanswered;                    ///< requests beyond LPVG_J1939_REFUSALS_MAX, saturating
    uint32_t taken[8];                      ///< addresses that others have claimed, a bit each
    uint8_t listed[LPVG_J1939_CODES_MAX];   ///< entries of the active codes, the gravest first
    uint8_t n_listed;
    uint8_t n_answers;
    uint8_t waiting;                        ///< messages to send, a bit each
    uint8_t state;                          ///< lpvg_j1939_state_t
    uint8_t address;                        ///< claimed or being claimed; LPVG_J1939_ADDRESS_NULL: none
    bool claim;                             ///< a claim is to be sent at claim_us
    bool changed;                           ///< the memory, since its CRC was made
} lpvg_j1939_t;

/// Packs a NAME. Returns ok; bad_argument for NULL and for a field that is too large, *packed is untouched then.
LPVG_NODISCARD lpvg_status_t lpvg_j1939_name_pack(const lpvg_j1939_name_t* name, uint64_t* packed);

/// Makes *self ready. `memory` stays referenced and must outlive it: kept where its CRC is right, its active codes then being previously
/// active ones, else cleared. *kept, which may be NULL, says which. Returns ok; bad_argument (NULL, an address above 253, a time
/// outside), *self and *memory are untouched then.
LPVG_NODISCARD lpvg_status_t lpvg_j1939_init(lpvg_j1939_t* self, const lpvg_j1939_config_t* config, lpvg_j1939_memory_t* memory,
                                             int64_t now_us, bool* kept);

/// Takes the frames received since the newest step, of which it looks at claims and requests, and what is wrong now. `frames_in` may be
/// NULL when n_in is 0. *n_out frames are written to frames_out, with time now_us.
/// Returns ok; bad_argument (NULL, max_out < LPVG_J1939_FRAMES_OUT, too many codes or one that is no code), not_ready (no init),
/// out_of_order (a time before the newest step's, or beyond INT64_MAX / 2). Unless it is ok, nothing changes, and *n_out, where given, is
/// 0.
LPVG_NODISCARD lpvg_status_t lpvg_j1939_step(lpvg_j1939_t* self, int64_t now_us, const lpvg_can_frame_t* frames_in, size_t n_in,
                                             const lpvg_j1939_findings_t* findings, lpvg_can_frame_t* frames_out, size_t max_out,
                                             size_t* n_out);

/// Whether a frame of the step may be sent now, which then carries the claimed address. Not while no address is claimed. Not DM1, which
/// this module sends. False for NULL.
bool lpvg_j1939_pass(const lpvg_j1939_t* self, lpvg_can_frame_t* frame);

/// Address that may be used, LPVG_J1939_ADDRESS_NULL where there is none and for NULL.
uint8_t lpvg_j1939_address(const lpvg_j1939_t* self);

/// Entry `index` of the memory with its freeze frame; NULL where the place is free, for NULL, and before init.
const lpvg_j1939_entry_t* lpvg_j1939_entry(const lpvg_j1939_t* self, uint8_t index);

#ifdef __cplusplus
}
#endif
#endif
