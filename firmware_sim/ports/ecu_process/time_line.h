/* time_line.h -- protocol between a simulator and its ECU (a process or an emulated processor) in simulated time.
 *
 * The time line is a stream of bytes in both directions. Numbers are little-endian, as on both processors. A bus carries no time,
 * so the simulator sends one request per tick. The ECU answers when all frames of the tick are on the bus. With the counts, each
 * side waits for frames that have not arrived yet. The ECU begins with an answer, which tells that it is ready. An answer is followed
 * by the judged frame (Judged, telemetry.hpp), then the causes (Found, one per output), then the requested Supervision. */
#ifndef LPVGUARD_TIME_LINE_H
#define LPVGUARD_TIME_LINE_H

#include <stdint.h>

typedef struct time_request_t {
    int64_t now_us;  /* time of the tick; below 0: end, answered with the counters as text */
    uint64_t frames; /* number of frames since the last request that pass the ECU's filter (../../ecu/filter.h) */
    uint64_t supervision; /* 1: requested */
} time_request_t;

typedef struct time_answer_t {
    uint64_t status; /* lpvg_status_t */
    uint64_t frames; /* number of frames from the ECU in this tick; in the last answer: bytes of the following text */
    uint64_t judged; /* 1: the monitor judged a frame in this tick */
    uint64_t found; /* 1: the causes of an alarm were found after the tick */
} time_answer_t;

enum {
    TIME_LINE_TEXT_MAX = 16384
};

#endif
