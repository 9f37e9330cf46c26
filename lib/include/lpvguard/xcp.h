/// @file xcp.h -- reading the ECU's memory over CAN for measurement: an XCP slave (ASAM MCD-1 XCP 1.x) that cannot write.
///
/// Off by default: a slave exists where the integrator makes one and hands it frames. It reads only memory that its ranges name, so
/// nothing else is seen, and a peripheral register that reacts to reading is never touched. What an address means to the master is the
/// range's own: usually the linker's address, so that the A2L of `lpvguard a2l` fits.
///
/// Commands: CONNECT, DISCONNECT, GET_STATUS, SYNCH, GET_COMM_MODE_INFO, GET_ID (text), SET_MTA, UPLOAD, SHORT_UPLOAD, and those of the
/// list below. Each command that writes to memory is answered with ERR_ACCESS_DENIED, every other one with ERR_CMD_UNKNOWN. Nothing is
/// answered before CONNECT. Numbers go in the processor's byte order, which CONNECT tells.
///
/// List: the master may allocate one list for data that is sent by itself (DAQ), of up to LPVG_XCP_ODTS_MAX frames with up to
/// LPVG_XCP_ODT_ENTRIES_MAX entries and seven bytes each: FREE_DAQ, ALLOC_DAQ, ALLOC_ODT, ALLOC_ODT_ENTRY, SET_DAQ_PTR, WRITE_DAQ,
/// CLEAR_DAQ_LIST, SET_DAQ_LIST_MODE (a prescaler, no time stamps), GET_DAQ_LIST_MODE, START_STOP_DAQ_LIST, START_STOP_SYNCH,
/// GET_DAQ_PROCESSOR_INFO, GET_DAQ_RESOLUTION_INFO, GET_DAQ_EVENT_INFO. Its one event is the step. A frame's first byte is its number in
/// the list. Entries outside the ranges are refused when they are written, not when they are read. CONNECT and DISCONNECT end and free it.
///
/// Use:     init -> lpvg_xcp_receive for every frame of the bus, between steps and in their context: what one answer carries is then of
///          one step. lpvg_xcp_event after each step. Send what they make. Outside of lpvg_ecu_step.
/// Cost:    of a frame with another identifier one comparison; of a command one pass over the ranges and seven bytes copied; of an event
///          without a running list two comparisons, else a copy of each entry. No heap, no locks, no I/O.
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
#define LPVG_XCP_ODTS_MAX 8U  ///< Frames of the list, and most that an event makes.
#define LPVG_XCP_ODT_ENTRIES_MAX 7U  ///< Entries of a frame, and its bytes.
#define LPVG_XCP_EVENT_NAME "step"  ///< Name of the list's event.

#define LPVG_XCP_ERR_SYNCH 0x00U  ///< Answer to SYNCH.
#define LPVG_XCP_ERR_DAQ_ACTIVE 0x11U  ///< The list runs.
#define LPVG_XCP_ERR_UNKNOWN 0x20U  ///< No such command.
#define LPVG_XCP_ERR_SYNTAX 0x21U  ///< Too short for the command.
#define LPVG_XCP_ERR_OUT_OF_RANGE 0x22U  ///< A parameter outside its range.
#define LPVG_XCP_ERR_ACCESS_DENIED 0x24U  ///< Memory outside the ranges, or a command that writes.
#define LPVG_XCP_ERR_MODE 0x27U  ///< A mode that is not supported.
#define LPVG_XCP_ERR_SEQUENCE 0x29U  ///< Not in this order.
#define LPVG_XCP_ERR_DAQ_CONFIG 0x2AU  ///< The list is not complete.
#define LPVG_XCP_ERR_MEMORY_OVERFLOW 0x30U  ///< More than the list can hold.

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
    uint32_t period_us;               ///< from event to event, > 0                                    [us]
} lpvg_xcp_config_t;

/// A frame of the list.
typedef struct lpvg_xcp_odt_t {
    const void* data[LPVG_XCP_ODT_ENTRIES_MAX];  ///< of each entry
    uint8_t bytes[LPVG_XCP_ODT_ENTRIES_MAX];     ///< of each entry, 0: not written                        [bytes]
    uint8_t n_entries;                           ///< allocated
} lpvg_xcp_odt_t;

/// How far the list is allocated.
typedef enum lpvg_xcp_allocation_t {
    lpvg_xcp_allocation_none = 0,
    lpvg_xcp_allocation_freed = 1,
    lpvg_xcp_allocation_list = 2,
    lpvg_xcp_allocation_odts = 3
} lpvg_xcp_allocation_t;

/// The list of data that is sent by itself.
typedef struct lpvg_xcp_daq_t {
    lpvg_xcp_odt_t odt[LPVG_XCP_ODTS_MAX];
    uint8_t allocation;  ///< lpvg_xcp_allocation_t
    uint8_t n_odts;      ///< allocated
    uint8_t next_odt;    ///< to be written; n_odts: none
    uint8_t next_entry;  ///< of it
    uint8_t prescaler;   ///< every so many events are sent; 0: no mode has been set
    uint8_t events;      ///< since the newest that was sent
    bool selected;       ///< to be started or stopped with the others
    bool running;        ///< events are sent
} lpvg_xcp_daq_t;

typedef struct lpvg_xcp_t {
    lpvg_xcp_config_t config;
    uint32_t name_bytes;  ///< length of its name
    const char* text;     ///< what the next upload is of, NULL: memory
    uint32_t text_bytes;  ///< its length                                                            [bytes]
    uint32_t mta;         ///< address of the next byte to upload; in a text, its index
    uint32_t commands;    ///< answered, errors included; saturating
    uint32_t errors;      ///< answered with an error other than that of SYNCH; saturating
    uint32_t missed;      ///< events whose frames found no place, saturating
    lpvg_xcp_daq_t daq;
    bool connected;       ///< by CONNECT
} lpvg_xcp_t;

/// Makes *self ready, not connected. Returns bad_argument (NULL, equal identifiers, n_ranges outside 1 .. LPVG_XCP_RANGES_MAX, a range
/// that is empty, without data or beyond 2^32, a longer name, period_us 0); *self is untouched then.
LPVG_NODISCARD lpvg_status_t lpvg_xcp_init(lpvg_xcp_t* self, const lpvg_xcp_config_t* config);

/// Takes a frame of the bus. Returns true where *out is an answer to send; its time is the frame's. False, leaving *out: another
/// identifier, no byte or more than 8, not connected, NULL, or no init.
bool lpvg_xcp_receive(lpvg_xcp_t* self, const lpvg_can_frame_t* frame, lpvg_can_frame_t* out);

/// A step has ended: writes the frames of a running list to out, with time now_us. Returns how many, at most LPVG_XCP_ODTS_MAX; 0 where
/// none runs or the prescaler leaves this event out, for NULL, and where max_out is less than the list has: all of it or nothing.
size_t lpvg_xcp_event(lpvg_xcp_t* self, int64_t now_us, lpvg_can_frame_t* out, size_t max_out);

#ifdef __cplusplus
}
#endif
#endif
