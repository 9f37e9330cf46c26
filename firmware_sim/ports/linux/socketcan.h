/* socketcan.h -- a CAN interface of Linux as the firmware's bus: real controllers and vcan.
 *
 * Filters run in the kernel, so foreign frames cost the firmware nothing; error reports always pass, with LPVG_CAN_ERROR
 * set. A CAN FD frame comes with its true length and its first 8 bytes, so that the supervision rejects it by its length.
 * Bus-off: the error report is handed on. From then on nothing is sent or received. SOCKETCAN_RESTART_US later the driver
 * opens its socket anew, which drops what is still queued. The kernel restarts the controller itself (ip link set DEV
 * type can restart-ms 100). Its report of that ends the wait at once. vcan has no controller: an injected report does the same. */
#ifndef LPVGUARD_SOCKETCAN_H
#define LPVGUARD_SOCKETCAN_H

#include <stddef.h>

#include "../../ecu/bus.h"

#ifdef __cplusplus
extern "C" {
#endif

/* Frames with ((id ^ frame id) & mask) == 0 pass; a receiver's rule is of this form: {rule.id, rule.id_mask}. */
typedef struct socketcan_filter_t {
    uint32_t id;
    uint32_t mask;
} socketcan_filter_t;

enum {
    SOCKETCAN_FILTERS_MAX = 32,
    SOCKETCAN_NAME_MAX = 16,
    SOCKETCAN_RESTART_US = 100000
};

/* What t_us of a received frame says. */
typedef enum socketcan_time_t {
    socketcan_time_arrival = 0, /* the firmware's clock when the kernel took the frame: for firmware in real time */
    socketcan_time_now = 1, /* now_us of the call: for simulated time, of which the kernel knows nothing */
} socketcan_time_t;

typedef struct socketcan_t {
    int socket;            /* below 0: not open */
    int error;             /* errno of the newest failure; 0: none */
    socketcan_time_t time;
    bool bus_off;
    int64_t bus_off_us;    /* when it began, by now_us of the call that saw it */
    uint32_t restarts;
    size_t n_filters;
    socketcan_filter_t filters[SOCKETCAN_FILTERS_MAX];
    char interface[SOCKETCAN_NAME_MAX];
} socketcan_t;

/* Opens `interface`, such as "vcan0", and fills *bus, which refers to *self from then on. With n_filters 0 every frame passes.
 * False, with the reason in self->error, when the interface is absent or the kernel refuses. */
bool socketcan_open(socketcan_t* self, const char* interface, const socketcan_filter_t* filters, size_t n_filters, socketcan_time_t time,
                    bus_t* bus);

/* Waits until a frame can be received. False when none came within timeout_ms, or not open. */
bool socketcan_wait(const socketcan_t* self, int timeout_ms);

/* Closes; the bus then neither sends nor receives. Does nothing when not open. */
void socketcan_close(socketcan_t* self);

#ifdef __cplusplus
}
#endif
#endif
