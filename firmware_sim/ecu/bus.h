<<<<<<< HEAD
/// @file bus.h -- the CAN bus as the firmware sees it: three calls, whatever is behind them.
///
/// Implementations: memory (ports/linux/memory_bus.h: deterministic, one process, no privileges), SocketCAN
/// (ports/linux/socketcan_bus.h: real interfaces and vcan), and the controllers of the emulated targets.
///
/// Use:     fill a concrete bus -> open -> send and receive; never wait in either.
/// Threads: one bus object belongs to one thread.
#ifndef LPVGUARD_FIRMWARE_BUS_H
#define LPVGUARD_FIRMWARE_BUS_H

#include <stddef.h>
=======
/* bus.h -- a CAN bus in three calls: a driver's own open fills a bus_t, then send and receive.
 *
 * Drivers: firmware_sim/sim/memory_bus.hpp (deterministic, no kernel), firmware_sim/ports/linux/socketcan.h.
 * Neither call blocks. Times are microseconds of the firmware's clock. */
#ifndef LPVGUARD_FIRMWARE_BUS_H
#define LPVGUARD_FIRMWARE_BUS_H

#include <stdbool.h>
>>>>>>> main
#include <stdint.h>

#include "lpvguard/can.h"

<<<<<<< HEAD
#ifdef __cplusplus
extern "C" {
#endif

typedef enum lpvg_bus_result_t {
    lpvg_bus_ok    = 0,
    lpvg_bus_empty = 1,  ///< receive: nothing has arrived.
    lpvg_bus_full  = 2,  ///< send: no room now; try in the next step.
    lpvg_bus_fault = 3,  ///< Not open, no such interface, or the driver failed. open starts again.
} lpvg_bus_result_t;

/// Frames with (id & mask) == (filter id & mask) pass; flags count as in lpvg_can_frame_t. The receiver's rules are
/// of this form: {rule.id, rule.id_mask}.
typedef struct lpvg_bus_filter_t {
    uint32_t id;
    uint32_t mask;
} lpvg_bus_filter_t;

/// A bus; the first member of every concrete one.
typedef struct lpvg_bus_t lpvg_bus_t;
struct lpvg_bus_t {
    /// (Re)opens: what has arrived before is dropped. Also the way back after bus-off. `filters` [n_filters]; with none, every
    /// frame passes. Error reports always pass, with LPVG_CAN_ERROR set.
    lpvg_bus_result_t (*open)(lpvg_bus_t* self, const lpvg_bus_filter_t* filters, size_t n_filters);
    /// Queues one classic frame of at most 8 bytes; t_us does not travel on a real bus.
    lpvg_bus_result_t (*send)(lpvg_bus_t* self, const lpvg_can_frame_t* frame);
    /// Takes the oldest frame that arrived, with its time of arrival. A CAN FD frame comes with its true length and its first
    /// 8 bytes, so that the supervision rejects it by its length.
    lpvg_bus_result_t (*receive)(lpvg_bus_t* self, lpvg_can_frame_t* frame);
};

#ifdef __cplusplus
}
#endif
=======
typedef struct bus_t {
    void* driver;
    bool (*send_frame)(void* driver, const lpvg_can_frame_t* frame);
    bool (*receive_frame)(void* driver, int64_t now_us, lpvg_can_frame_t* frame);
} bus_t;

/* False when the driver could not take the frame (queue full, bus off). */
static inline bool bus_send(const bus_t* bus, const lpvg_can_frame_t* frame)
{
    return bus->send_frame(bus->driver, frame);
}

/* False when no frame has arrived by now_us. Frames come in order of arrival, with their time in t_us. */
static inline bool bus_receive(const bus_t* bus, int64_t now_us, lpvg_can_frame_t* frame)
{
    return bus->receive_frame(bus->driver, now_us, frame);
}

>>>>>>> main
#endif
