/* time_line.h -- how a simulator leads an ECU of its own, a process or an emulated processor, through simulated time.
 *
 * It is a stream of bytes that go both ways. Numbers are as both processors have them (little-endian). A bus carries no time, so
 * one request comes here each tick. The answer comes when everything that the tick sends is on the bus. The counts let each
 * side wait for frames that are still on their way. The ECU begins, with an answer that says it hears. After an answer comes the
 * frame that was judged (Judged, telemetry.hpp), then causes (Found, each output's), then what was asked for (Supervision). */
#ifndef LPVGUARD_TIME_LINE_H
#define LPVGUARD_TIME_LINE_H

#include <stdint.h>

typedef struct time_request_t {
    int64_t now_us;  /* of the tick; below 0: end, answered with the counters as text */
    uint64_t frames; /* sent since the last request and not kept from the ECU by its filter (../../ecu/filter.h) */
    uint64_t supervision; /* 1: asked for */
} time_request_t;

typedef struct time_answer_t {
    uint64_t status; /* lpvg_status_t */
    uint64_t frames; /* sent by the ECU in this tick; of the last answer: bytes of the text that follows */
    uint64_t judged; /* 1: the monitor has judged a frame in this tick */
    uint64_t found; /* 1: an alarm's causes were found after it */
} time_answer_t;

enum {
    TIME_LINE_TEXT_MAX = 16384
};

#endif
