/// @file uds.h -- reads the trouble codes of j1939.h by UDS (ISO 14229-1). The integrator supplies the transport (ISO-TP).
///
/// It answers these requests and changes nothing:
///
///     19 02 MASK            -- codes by status: 59 02 09, then 4 bytes each: the code, its status
///     19 04 CODE RECORD     -- snapshot: 59 04 CODE STATUS 01 01 4C01, then the 12 bytes that DM25 holds of it
///     19 06 CODE RECORD     -- extended data: 59 06 CODE STATUS 01, then the occurrence count
///     22 4C00               -- state of the address, address, active codes, remembered codes
///     22 4C01               -- newest freeze frame: the code, its occurrence count, the 12 bytes; refused with 31 if there is none
///     22 4C02               -- NAME, the low byte first
///
/// A code is 3 bytes as in DM1 (DTC format 02, SAE J1939-73). Status: 01 test failed, 08 confirmed; active 09, previously active 08. A
/// record is 01, or FF for all. Any other request is refused with 7F, the service, and a reason. The reasons are 11 service,
/// 12 sub-function, 13 length, 14 answer too long, 31 no such code, record or identifier. Bit 7 of a sub-function suppresses a positive
/// answer.
///
/// Use:     pass each complete ISO-TP request and send the answer. Link this file only if a tester asks.
/// Cost:    one pass over the codes. No heap, no locks, no I/O, no recursion.
/// RAM:     no object.
/// Threads: call it from the task that steps the object of j1939.h.
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

/// Writes the answer to request [n] into answer [max].
/// Returns the length of the answer. 0 means nothing to send: a suppressed positive answer, NULL, an empty request, no init, or max < 3.
size_t lpvg_uds_answer(const lpvg_j1939_t* self, const uint8_t* request, size_t n, uint8_t* answer, size_t max);

#ifdef __cplusplus
}
#endif
#endif
