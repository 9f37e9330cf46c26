/* socketcan.h -- a CAN interface of Linux as the firmware's bus: real controllers and vcan.
 *
 * Filters run in the kernel, so foreign frames cost the firmware nothing. Error reports always pass, with LPVG_CAN_ERROR
 * set. A CAN FD frame comes with its true length and its first 8 bytes, so that the supervision rejects it by its length.
 * Bus-off: the driver passes the error report and then neither sends nor receives. SOCKETCAN_RESTART_US later, it opens its
 * socket again, which drops all queued frames. The kernel restarts the controller itself (ip link set DEV type can
 * restart-ms 100), and its report of the restart ends the wait at once. On vcan, an injected report has the same effect. */
#ifndef LPVGUARD_SOCKETCAN_H
#define LPVGUARD_SOCKETCAN_H

#include <stddef.h>

#include "../../ecu/bus.h"

#ifdef __cplusplus
extern "C" {
#endif

/* Frames with ((id ^ frame id) & mask) == 0 pass. A receiver's rule has this form: {rule.id, rule.id_mask}. */
typedef struct socketcan_filter_t {
    uint32_t id;
    uint32_t mask;
} socketcan_filter_t;

enum {
    SOCKETCAN_FILTERS_MAX = 32,
    SOCKETCAN_NAME_MAX = 16,
    SOCKETCAN_RESTART_US = 100000
};

/* Meaning of t_us of a received frame. */
typedef enum socketcan_time_t {
    socketcan_time_arrival = 0, /* time on the firmware's clock when the kernel received the frame: for real time */
    socketcan_time_now = 1, /* now_us of the call: for simulated time, which the kernel does not know */
} socketcan_time_t;

typedef struct socketcan_t {
    int socket;            /* below 0: not open */
    int error;             /* errno of the newest failure; 0: none */
    socketcan_time_t time;
    bool bus_off;
    int64_t bus_off_us;    /* begin of the bus-off: now_us of the call that received its report */
    uint32_t restarts;
    size_t n_filters;
    socketcan_filter_t filters[SOCKETCAN_FILTERS_MAX];
    char interface[SOCKETCAN_NAME_MAX];
} socketcan_t;

/* Opens `interface`, such as "vcan0", and fills *bus, which then refers to *self. With n_filters 0, every frame passes.
 * Returns false, with the reason in self->error, if the interface is missing or the kernel refuses. */
bool socketcan_open(socketcan_t* self, const char* interface, const socketcan_filter_t* filters, size_t n_filters, socketcan_time_t time,
                    bus_t* bus);

/* Waits until a frame can be received. Returns false if none arrived within timeout_ms, or if the bus is not open. */
bool socketcan_wait(const socketcan_t* self, int timeout_ms);

/* Closes the bus, which then neither sends nor receives. Does nothing if it is not open. */
void socketcan_close(socketcan_t* self);

#ifdef __cplusplus
}
#endif
#endif
