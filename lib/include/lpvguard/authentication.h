/// @file authentication.h -- authentication of a CAN message by a second frame with freshness value and truncated CMAC.
///
/// Counter and checksum of end-to-end protection find faults, not attackers: anyone on the bus can compute both. A command message
/// has no room for an authenticator. The sender therefore sends a second frame after it, the authenticator:
///
///     bytes 0, 1   low 16 bits of the freshness value, low byte first
///     bytes 2 .. 7 the first 48 bits of AES-128-CMAC (NIST SP 800-38B) over
///                  data id (2, high byte first), number of data bytes (1), data (8, unused ones 0), freshness (8, high byte first)
///
/// This is the truncation of AUTOSAR SecOC, with both lengths chosen for a frame of eight bytes. The freshness value increases with
/// each message and never repeats under one key. The receiver assumes the smallest value above its newest with equal low bits.
///
/// Use:     receiver: init -> lpvg_can_auth_receive for every frame of the bus, in order of arrival -> give the passed frames to
///          lpvg_ecu_step. Sender: lpvg_can_auth_protect -> send the message, then the authenticator.
/// Cost:    each pair needs one CMAC of 19 bytes (two AES blocks). The CMAC is a hook for the part's hardware or a certified library.
///          Each other frame needs two comparisons. No heap, no locks, no I/O.
/// Threads: one object per thread. RAM: sizeof(lpvg_can_auth_t).
///
/// Assumptions of use: the integrator stores and exchanges the keys. The integrator stores `freshness` over power-off, or starts above
/// every used value. A gateway keeps foreign senders off the bus.
/// Limits: an attacker on the bus can still suppress a message; the message is then lost and the loop releases. An attacker who holds
/// pairs back can deliver them later in their order, because the freshness value is no time. A random 48-bit authenticator passes
/// once in 2^48 frames.
#ifndef LPVGUARD_AUTHENTICATION_H
#define LPVGUARD_AUTHENTICATION_H

#include "lpvguard/can.h"

#ifdef __cplusplus
extern "C" {
#endif

#define LPVG_CAN_AUTH_BYTES 19U  ///< Number of authenticated bytes, as above.
#define LPVG_CAN_AUTH_WAITING 2U  ///< Messages that can wait for their authenticator; a further one replaces the oldest.

/// Hook: writes the AES-128-CMAC of data [n] to mac. Returns false on failure; the frame is then refused.
typedef bool (*lpvg_can_cmac_t)(void* context, const uint8_t* data, size_t n, uint8_t mac[16]);

typedef struct lpvg_can_auth_config_t {
    lpvg_can_cmac_t cmac;
    void* context;      ///< first argument of cmac
    uint32_t id;        ///< identifier and flags of the message
    uint32_t auth_id;   ///< identifier and flags of the authenticator
    uint32_t id_mask;   ///< bits of both that must agree (J1939: all but the priority)
    uint32_t pair_us;   ///< longest time from a message to its authenticator                           [us]
    uint16_t data_id;   ///< data id of the message's end-to-end protection
} lpvg_can_auth_config_t;

/// Judgement of a frame. It is also the index of the counters.
typedef enum lpvg_can_auth_event_t {
    lpvg_can_auth_none = 0,     ///< An argument is NULL, or the object is not initialised.
    lpvg_can_auth_passed = 1,   ///< *out is the authentic message: use it.
    lpvg_can_auth_other = 2,    ///< Neither message nor authenticator: *out is the received frame.
    lpvg_can_auth_waiting = 3,  ///< A message; it waits for its authenticator.
    lpvg_can_auth_alone = 4,    ///< An authenticator without a recent message.
    lpvg_can_auth_length = 5,   ///< Wrong length: a message needs 1 .. 8 bytes, an authenticator 8.
    lpvg_can_auth_forged = 6,   ///< The authenticator fits no waiting message, or its freshness is old.
    lpvg_can_auth_count = 7
} lpvg_can_auth_event_t;

typedef struct lpvg_can_auth_t {
    lpvg_can_auth_config_t config;
    uint64_t freshness;  ///< newest accepted or sent freshness value
    lpvg_can_frame_t waiting[LPVG_CAN_AUTH_WAITING];
    uint8_t n_waiting;
    uint32_t count[lpvg_can_auth_count];  ///< frames by event, saturating
} lpvg_can_auth_t;

/// Initialises *self. `freshness` is the newest value that may have been used under this key.
/// Returns ok; bad_argument for NULL, a missing hook, equal identifiers under the mask, or pair_us 0. *self changes only with ok.
LPVG_NODISCARD lpvg_status_t lpvg_can_auth_init(lpvg_can_auth_t* self, const lpvg_can_auth_config_t* config, uint64_t freshness);

/// Judges one frame. Writes *out only with `passed` (the authentic message, with its own arrival time) and `other` (the frame).
/// Returns `none` for NULL and before init, and changes nothing then.
lpvg_can_auth_event_t lpvg_can_auth_receive(lpvg_can_auth_t* self, const lpvg_can_frame_t* frame, lpvg_can_frame_t* out);

/// Makes the authenticator of a message, after its end-to-end protection, and steps the freshness value.
/// Returns ok; bad_argument for NULL or a dlc outside 1 .. 8; not_ready before init or when no freshness value is left; bad_sample
/// when the hook failed. Nothing changes unless ok is returned.
LPVG_NODISCARD lpvg_status_t lpvg_can_auth_protect(lpvg_can_auth_t* self, const lpvg_can_frame_t* message, lpvg_can_frame_t* authenticator);

#ifdef __cplusplus
}
#endif
#endif
