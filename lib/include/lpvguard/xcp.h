/// @file xcp.h -- reading the ECU's memory over CAN for measurement: an XCP slave (ASAM MCD-1 XCP 1.x) that cannot write.
///
/// Off by default: a slave exists where the integrator makes one and hands it frames. It reads only memory that its ranges name, so
/// nothing else is seen, and a peripheral register that reacts to reading is never touched. What an address means to the master is the
/// range's own: usually the linker's address, so that the A2L of `lpvguard a2l` fits.
///
/// Commands: CONNECT, DISCONNECT, GET_STATUS, SYNCH, GET_COMM_MODE_INFO, GET_ID (text), SET_MTA, UPLOAD, SHORT_UPLOAD. Each command that
/// writes to memory is answered with ERR_ACCESS_DENIED, every other one with ERR_CMD_UNKNOWN. Nothing is answered before CONNECT. Numbers
/// go in the processor's byte order, which CONNECT tells.
///
/// Use:     init -> lpvg_xcp_receive for every frame of the bus, between steps and in their context: what one answer carries is then of
///          one step. Send what it makes. Outside of lpvg_ecu_step.
/// Cost:    of a frame with another identifier one comparison; of a command one pass over the ranges and seven bytes copied. No heap, no
///          locks, no I/O.
/// Threads: one object per thread. RAM: sizeof(lpvg_xcp_t).
///
/// Limits, assumptions of use: whoever is on the bus can read the ranges: name no keys. Access is not protected by seed and key.
#ifndef LPVGUARD_XCP_H
#define LPVGUARD_XCP_H

#include "lpvguard/can.h"

#ifdef __cplusplus
extern "C" {
#endif

#define LPVG_XCP_RANGES_MAX 16U  ///< Ranges of one slave.

#define LPVG_XCP_ERR_SYNCH 0x00U  ///< Answer to SYNCH.
#define LPVG_XCP_ERR_UNKNOWN 0x20U  ///< No such command.
#define LPVG_XCP_ERR_SYNTAX 0x21U  ///< Too short for the command.
#define LPVG_XCP_ERR_OUT_OF_RANGE 0x22U  ///< A parameter outside its range.
#define LPVG_XCP_ERR_ACCESS_DENIED 0x24U  ///< Memory outside the ranges, or a command that writes.

/// Memory that may be read.
typedef struct lpvg_xcp_range_t {
    uint32_t address;     ///< of its first byte, as the master says it
    uint32_t bytes;       ///< its length, > 0; it ends at 2^32 at the latest                     [bytes]
    const void* data;     ///< where it is
} lpvg_xcp_range_t;

typedef struct lpvg_xcp_config_t {
    uint32_t receive_id;              ///< identifier and flags of commands
    uint32_t send_id;                 ///< of answers
    const char* name;                 ///< answer to GET_ID, ended by a zero, at most 255 characters; outlives the slave
    const lpvg_xcp_range_t* ranges;   ///< [n_ranges], outlives the slave
    uint8_t n_ranges;                 ///< 1 .. 16
} lpvg_xcp_config_t;

typedef struct lpvg_xcp_t {
    lpvg_xcp_config_t config;
    uint32_t name_bytes;  ///< length of its name
    uint32_t mta;       ///< address of the next byte to upload; in the name, its index
    uint32_t commands;  ///< answered, errors included; saturating
    uint32_t errors;    ///< answered with an error other than that of SYNCH; saturating
    bool connected;     ///< by CONNECT
    bool in_name;       ///< the next upload is of the name
} lpvg_xcp_t;

/// Makes *self ready, not connected. Returns bad_argument (NULL, equal identifiers, n_ranges outside 1 .. LPVG_XCP_RANGES_MAX, a range
/// that is empty, without data or beyond 2^32, a longer name); *self is untouched then.
LPVG_NODISCARD lpvg_status_t lpvg_xcp_init(lpvg_xcp_t* self, const lpvg_xcp_config_t* config);

/// Takes a frame of the bus. Returns true where *out is an answer to send; its time is the frame's. False, leaving *out: another
/// identifier, no byte or more than 8, not connected, NULL, or no init.
bool lpvg_xcp_receive(lpvg_xcp_t* self, const lpvg_can_frame_t* frame, lpvg_can_frame_t* out);

#ifdef __cplusplus
}
#endif
#endif
