/* socketcan.h -- bus driver for Linux: one raw CAN socket on an interface such as can0 or vcan0. */
#ifndef LPVGUARD_SOCKETCAN_H
#define LPVGUARD_SOCKETCAN_H

#include "bus.h"

#ifdef __cplusplus
extern "C" {
#endif

typedef struct socketcan_t {
    int handle; /* of the socket */
} socketcan_t;

/* Opens the interface and fills *bus, which then refers to *self. Receives every frame of the bus but our own, error reports
 * included. A received frame's time is that of the call: tick at least as often as the shortest message's gap matters.
 * False, errno saying why, when there is no such interface, no SocketCAN in the kernel, or an argument is NULL. */
bool socketcan_open(socketcan_t* self, const char* interface, bus_t* bus);

/* Waits until a frame can be received. False when none came within timeout_ms. */
bool socketcan_wait(const socketcan_t* self, int timeout_ms);

void socketcan_close(socketcan_t* self);

#ifdef __cplusplus
}
#endif
#endif
