/// @file authentication.h -- whether a message comes from who holds the key: a second frame with freshness and a truncated CMAC.
///
/// Counter and checksum of end-to-end protection find faults, not attackers: who reads the bus can make both. A message that commands
/// can carry six bytes, which hold no authenticator. So it is followed by a frame of its own:
///
///     bytes 0, 1   low 16 bits of the freshness value, low byte first
///     bytes 2 .. 7 the first 48 bits of AES-128-CMAC (NIST SP 800-38B) over
///                  data id (2, high byte first), number of data bytes (1), data (8, unused ones 0), freshness (8, high byte first)
///
/// This is the truncation of AUTOSAR SecOC with both lengths chosen for a frame of eight bytes. The freshness value counts up with each
/// message and never repeats under a key. The receiver takes the smallest value above its newest whose low bits agree.
///
/// Use:     init -> lpvg_can_auth_receive for every frame of the bus, in order of arrival, in front of lpvg_ecu_step: hand over what it
///          passes. The sender: lpvg_can_auth_protect, then send both frames, the message first.
/// Cost:    per pair one CMAC of 19 bytes, two blocks of AES; the CMAC is a hook, for the part's hardware or a certified library.
///          Of frames that are not the pair's, two comparisons. No heap, no locks, no I/O.
/// Threads: one object per thread. RAM: sizeof(lpvg_can_auth_t).
///
/// Limits, assumptions of use: keys, their storage and their exchange; storing `freshness` over power-off, or one that starts above every
/// value used; a gateway that keeps foreign senders off the bus. An attacker on the bus can still silence a message: then it is lost, and
/// the loop releases. One who holds pairs back can deliver them later, in their order: freshness counts, it knows no time. A 48-bit
/// authenticator is guessed once in 2^48 frames.
#ifndef LPVGUARD_AUTHENTICATION_H
#define LPVGUARD_AUTHENTICATION_H

#include "lpvguard/can.h"

#ifdef __cplusplus
extern "C" {
#endif

#define LPVG_CAN_AUTH_BYTES 19U  ///< What is authenticated, as above.
#define LPVG_CAN_AUTH_WAITING 2U  ///< Messages that may wait for their authenticator; the oldest gives way.

/// AES-128-CMAC of data [n] into mac. Returns false where it could not be made: the frame is then refused.
typedef bool (*lpvg_can_cmac_t)(void* context, const uint8_t* data, size_t n, uint8_t mac[16]);

typedef struct lpvg_can_auth_config_t {
    lpvg_can_cmac_t cmac;
    void* context;      ///< handed to cmac
    uint32_t id;        ///< identifier and flags of the message
    uint32_t auth_id;   ///< of its authenticator
    uint32_t id_mask;   ///< bits of both that must agree (J1939: all but the priority)
    uint32_t pair_us;   ///< longest time from a message to its authenticator                           [us]
    uint16_t data_id;   ///< of the message, as end-to-end protection has it
} lpvg_can_auth_config_t;

/// What became of a frame; also the index of the counters.
typedef enum lpvg_can_auth_event_t {
    lpvg_can_auth_none = 0,     ///< A NULL argument, or no init.
    lpvg_can_auth_passed = 1,   ///< *out is authentic: hand it over.
    lpvg_can_auth_other = 2,    ///< Neither message nor authenticator: *out is the frame, as it came.
    lpvg_can_auth_waiting = 3,  ///< A message that waits for its authenticator.
    lpvg_can_auth_alone = 4,    ///< An authenticator without a message that is recent enough.
    lpvg_can_auth_length = 5,   ///< A message or authenticator with another number of bytes than 1 .. 8 or 8.
    lpvg_can_auth_forged = 6,   ///< An authenticator that belongs to no waiting message, or is of an old freshness.
    lpvg_can_auth_count = 7
} lpvg_can_auth_event_t;

typedef struct lpvg_can_auth_t {
    lpvg_can_auth_config_t config;
    uint64_t freshness;  ///< newest value accepted, or sent
    lpvg_can_frame_t waiting[LPVG_CAN_AUTH_WAITING];
    uint8_t n_waiting;
    uint32_t count[lpvg_can_auth_count];  ///< frames by event, saturating
} lpvg_can_auth_t;

/// Makes *self ready. `freshness`: the newest value that may have been used under this key.
/// Returns bad_argument (NULL, no hook, two equal identifiers under the mask, pair_us of 0); *self is untouched then.
LPVG_NODISCARD lpvg_status_t lpvg_can_auth_init(lpvg_can_auth_t* self, const lpvg_can_auth_config_t* config, uint64_t freshness);

/// Judges one frame; `none`, and nothing happens, for NULL or without init. *out is written with `passed` and `other` only: the authentic
/// message with the time at which it came, or the frame.
lpvg_can_auth_event_t lpvg_can_auth_receive(lpvg_can_auth_t* self, const lpvg_can_frame_t* frame, lpvg_can_frame_t* out);

/// Makes the authenticator of a message that is sent next, after end-to-end protection, and steps the freshness.
/// Returns bad_argument (NULL, dlc outside 1 .. 8), not_ready (no init, no freshness left), bad_sample (no CMAC was made); nothing is
/// changed then.
LPVG_NODISCARD lpvg_status_t lpvg_can_auth_protect(lpvg_can_auth_t* self, const lpvg_can_frame_t* message, lpvg_can_frame_t* authenticator);

#ifdef __cplusplus
}
#endif
#endif
