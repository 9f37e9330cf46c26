/// @file uds.h -- the codes of j1939.h read by UDS (ISO 14229-1): payload in, payload out. The transport (ISO-TP) is the integrator's.
///
/// Answers, and changes nothing:
///
///     19 02 MASK            -- codes by status: 59 02 09, then 4 bytes each: the code, its status
///     19 04 CODE RECORD     -- snapshot: 59 04 CODE STATUS 01 01 4C01, then the 12 bytes that DM25 holds of it
///     19 06 CODE RECORD     -- extended data: 59 06 CODE STATUS 01, then the occurrence count
///     22 4C00               -- state of the address, address, active codes, remembered codes
///     22 4C01               -- newest freeze frame: the code, its occurrence count, the 12 bytes; out of range where there is none
///     22 4C02               -- NAME, the low byte first
///
/// A code is 3 bytes as in DM1 (DTC format 02, SAE J1939-73). Status: 01 test failed, 08 confirmed; active 09, previously active 08. A
/// record is 01, or FF for all. Everything else is refused: 7F, the service, 11 service, 12 sub-function, 13 length, 14 no room for the
/// answer, 31 no such code, record or identifier. Bit 7 of a sub-function suppresses a positive answer.
///
/// Use:     hand over each request that ISO-TP has put together, send what comes back. Leave it out where nothing asks.
/// Cost:    one pass over the codes. No heap, no locks, no I/O, no recursion.
/// RAM:     none of its own.
/// Threads: reads the object of j1939.h: the task that steps it.
#ifndef LPVGUARD_UDS_H
#define LPVGUARD_UDS_H

#include <stddef.h>
#include <stdint.h>

#include "lpvguard/j1939.h"

#ifdef __cplusplus
extern "C" {
#endif

#define LPVG_UDS_ANSWER_MAX 67u  ///< Longest answer: 16 codes by status.
#define LPVG_UDS_STATE 0x4C00u  ///< Identifiers
#define LPVG_UDS_FREEZE 0x4C01u
#define LPVG_UDS_NAME 0x4C02u

/// Writes the answer to request [n] to answer [max] and returns its length. 0, nothing to send: a positive answer is suppressed; NULL, an
/// empty request, no init, or max < 3.
size_t lpvg_uds_answer(const lpvg_j1939_t* self, const uint8_t* request, size_t n, uint8_t* answer, size_t max);

#ifdef __cplusplus
}
#endif
#endif
