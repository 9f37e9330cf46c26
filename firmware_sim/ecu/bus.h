/* bus.h -- a CAN bus in three calls: the open function of a driver fills a bus_t, then send and receive.
 *
 * Drivers: firmware_sim/sim/memory_bus.hpp (deterministic, no kernel), firmware_sim/ports/linux/socketcan.h.
 * Neither call blocks. Times are microseconds of the firmware's clock. */
#ifndef LPVGUARD_FIRMWARE_BUS_H
#define LPVGUARD_FIRMWARE_BUS_H

#include <stdbool.h>
#include <stdint.h>

#include "lpvguard/can.h"

typedef struct bus_t {
    void* driver;
    bool (*send_frame)(void* driver, const lpvg_can_frame_t* frame);
    bool (*receive_frame)(void* driver, int64_t now_us, lpvg_can_frame_t* frame);
} bus_t;

/* Returns false if the driver could not take the frame (queue full, bus off). */
static inline bool bus_send(const bus_t* bus, const lpvg_can_frame_t* frame) { return bus->send_frame(bus->driver, frame); }

/* Returns false if no frame has arrived by now_us. Frames come in order of arrival, with their time in t_us. */
static inline bool bus_receive(const bus_t* bus, int64_t now_us, lpvg_can_frame_t* frame) {
    return bus->receive_frame(bus->driver, now_us, frame);
}

#endif
