/// @file xcp.h -- XCP slave on CAN (ASAM MCD-1 XCP 1.x) that reads the ECU's memory for measurement. It cannot write memory.
///
/// Off by default: the integrator creates a slave and passes frames to it. The slave reads only the memory of its ranges, so it never
/// touches a peripheral register. Each range defines the address that the master uses. Use the linker's address for the A2L of
/// `lpvguard a2l`.
///
/// Commands: CONNECT, DISCONNECT, GET_STATUS, SYNCH, GET_COMM_MODE_INFO, GET_ID (text), SET_MTA, UPLOAD, SHORT_UPLOAD, and the DAQ
/// commands below. A command that writes memory gets ERR_ACCESS_DENIED; any other command gets ERR_CMD_UNKNOWN. The slave does not
/// answer before CONNECT. Numbers have the processor's byte order, which CONNECT reports.
///
/// DAQ list: the master may allocate one list of data that the slave sends at each step. It has up to LPVG_XCP_ODTS_MAX frames, each
/// with up to LPVG_XCP_ODT_ENTRIES_MAX entries and seven bytes. Commands: FREE_DAQ, ALLOC_DAQ, ALLOC_ODT, ALLOC_ODT_ENTRY, SET_DAQ_PTR,
/// WRITE_DAQ, CLEAR_DAQ_LIST, SET_DAQ_LIST_MODE (prescaler, no time stamps), GET_DAQ_LIST_MODE, START_STOP_DAQ_LIST,
/// START_STOP_SYNCH, GET_DAQ_PROCESSOR_INFO, GET_DAQ_RESOLUTION_INFO, GET_DAQ_EVENT_INFO. The only event is the step. The first byte of
/// a frame is its number in the list. WRITE_DAQ refuses entries outside the ranges. CONNECT and DISCONNECT free the list.
///
/// Use:     init -> lpvg_xcp_receive for every frame of the bus, between steps, in the context of lpvg_ecu_step -> lpvg_xcp_event after
///          each step. Send the frames that both write. One answer then holds data of one step.
/// Cost:    a frame with another identifier: one comparison. A command: one pass over the ranges and seven copied bytes. An event: two
///          comparisons, or a copy of each entry while a list runs. No heap, no locks, no I/O.
/// Threads: one object per thread. RAM: sizeof(lpvg_xcp_t).
///
/// Limits: everyone on the bus can read the ranges, because there is no seed and key. Give no range that holds keys.
#ifndef LPVGUARD_XCP_H
#define LPVGUARD_XCP_H

#include "lpvguard/can.h"

#ifdef __cplusplus
extern "C" {
#endif

#define LPVG_XCP_RANGES_MAX 16U  ///< Most ranges of one slave.
#define LPVG_XCP_ODTS_MAX 8U  ///< Most frames of the list, and of one event.
#define LPVG_XCP_ODT_ENTRIES_MAX 7U  ///< Most entries of a frame, and most data bytes.
#define LPVG_XCP_EVENT_NAME "step"  ///< Name of the list's event.

#define LPVG_XCP_ERR_SYNCH 0x00U  ///< Answer to SYNCH.
#define LPVG_XCP_ERR_DAQ_ACTIVE 0x11U  ///< The list runs.
#define LPVG_XCP_ERR_UNKNOWN 0x20U  ///< No such command.
#define LPVG_XCP_ERR_SYNTAX 0x21U  ///< Too short for the command.
#define LPVG_XCP_ERR_OUT_OF_RANGE 0x22U  ///< A parameter outside its range.
#define LPVG_XCP_ERR_ACCESS_DENIED 0x24U  ///< Memory outside the ranges, or a command that writes.
#define LPVG_XCP_ERR_MODE 0x27U  ///< A mode that is not supported.
#define LPVG_XCP_ERR_SEQUENCE 0x29U  ///< Wrong order of commands.
#define LPVG_XCP_ERR_DAQ_CONFIG 0x2AU  ///< The list is not complete.
#define LPVG_XCP_ERR_MEMORY_OVERFLOW 0x30U  ///< The list is full.

/// Memory that may be read.
typedef struct lpvg_xcp_range_t {
    uint32_t address;     ///< address of the first byte, as the master uses it
    uint32_t bytes;       ///< length, > 0; address + bytes is at most 2^32                      [bytes]
    const void* data;     ///< location of the first byte
} lpvg_xcp_range_t;

typedef struct lpvg_xcp_config_t {
    uint32_t receive_id;              ///< identifier and flags of commands
    uint32_t send_id;                 ///< identifier and flags of answers
    const char* name;                 ///< answer to GET_ID, zero-terminated, at most 255 characters; outlives the slave
    const lpvg_xcp_range_t* ranges;   ///< [n_ranges], outlives the slave
    uint8_t n_ranges;                 ///< 1 .. 16
    uint32_t period_us;               ///< period of the events, > 0                                  [us]
} lpvg_xcp_config_t;

/// One frame of the DAQ list.
typedef struct lpvg_xcp_odt_t {
    const void* data[LPVG_XCP_ODT_ENTRIES_MAX];  ///< location of each entry
    uint8_t bytes[LPVG_XCP_ODT_ENTRIES_MAX];     ///< length of each entry, 0: not written                 [bytes]
    uint8_t n_entries;                           ///< number of allocated entries
} lpvg_xcp_odt_t;

/// Progress of the list's allocation.
typedef enum lpvg_xcp_allocation_t {
    lpvg_xcp_allocation_none = 0,
    lpvg_xcp_allocation_freed = 1,
    lpvg_xcp_allocation_list = 2,
    lpvg_xcp_allocation_odts = 3
} lpvg_xcp_allocation_t;

/// The DAQ list.
typedef struct lpvg_xcp_daq_t {
    lpvg_xcp_odt_t odt[LPVG_XCP_ODTS_MAX];
    uint8_t allocation;  ///< lpvg_xcp_allocation_t
    uint8_t n_odts;      ///< number of allocated frames
    uint8_t next_odt;    ///< frame that WRITE_DAQ writes next; n_odts: none
    uint8_t next_entry;  ///< entry of that frame
    uint8_t prescaler;   ///< every prescaler-th event is sent; 0: no mode is set
    uint8_t events;      ///< events since the newest sent one
    bool selected;       ///< selected for START_STOP_SYNCH
    bool running;        ///< the list is being sent
} lpvg_xcp_daq_t;

typedef struct lpvg_xcp_t {
    lpvg_xcp_config_t config;
    uint32_t name_bytes;  ///< length of config.name                                                 [bytes]
    const char* text;     ///< text of the next upload; NULL: memory
    uint32_t text_bytes;  ///< length of the text                                                    [bytes]
    uint32_t mta;         ///< address, or index in the text, of the next byte to upload
    uint32_t commands;    ///< answered commands, errors included, saturating
    uint32_t errors;      ///< commands answered with an error, except SYNCH, saturating
    uint32_t missed;      ///< events without room for their frames, saturating
    lpvg_xcp_daq_t daq;
    bool connected;       ///< CONNECT came last
} lpvg_xcp_t;

/// Initialises *self, not connected.
/// Returns ok; bad_argument for NULL, equal identifiers, n_ranges outside 1 .. LPVG_XCP_RANGES_MAX, a range that is empty, without data
/// or beyond 2^32, a name that is too long, or period_us 0. *self changes only with ok.
LPVG_NODISCARD lpvg_status_t lpvg_xcp_init(lpvg_xcp_t* self, const lpvg_xcp_config_t* config);

/// Takes a frame of the bus. Returns true when *out is an answer to send, with the time of the frame.
/// Returns false and leaves *out for another identifier, 0 or more than 8 bytes, no connection, NULL, and before init.
bool lpvg_xcp_receive(lpvg_xcp_t* self, const lpvg_can_frame_t* frame, lpvg_can_frame_t* out);

/// Call it after each step. Writes all frames of a running list to out, with time now_us.
/// Returns their number, at most LPVG_XCP_ODTS_MAX. Returns 0 when no list runs, when the prescaler skips this event, for NULL, and when
/// max_out is smaller than the list.
size_t lpvg_xcp_event(lpvg_xcp_t* self, int64_t now_us, lpvg_can_frame_t* out, size_t max_out);

#ifdef __cplusplus
}
#endif
#endif
