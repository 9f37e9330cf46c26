/* can0.h -- CAN controller 0 of the ZynqMP, as QEMU 7.2 models it, as the firmware's bus.
 *
 * QEMU's model differs from silicon in two ways. Its identifier registers hold identifier and flags as SocketCAN has them (silicon:
 * 28..18 in bits 31..21, 17..0 in bits 18..1). Byte 0 of the data is in bits 7..0 (silicon: 31..24). A controller on a virtual bus
 * never goes off by itself: as with vcan, an injected error report says bus-off.
 *
 * The controller is polled, because the model wires no interrupt controller to the RPU. Filter and bus-off are those of
 * ../linux/socketcan.h. What no rule of the vehicle matches is dropped. Off the bus nothing is sent or received for CAN0_RESTART_US. */
#ifndef LPVGUARD_CAN0_H
#define LPVGUARD_CAN0_H

#include <stddef.h>

#include "../../ecu/bus.h"

#ifdef __cplusplus
extern "C" {
#endif

enum {
    CAN0_QUEUE = 128,
    CAN0_RESTART_US = 100000
};

typedef struct can0_t {
    uint32_t also; /* identifier and flags that pass the filter beside the rules; 0: none */
    lpvg_can_frame_t queue[CAN0_QUEUE]; /* taken from the controller, not yet received */
    size_t head, tail;                  /* counted up without end; the index is the remainder */
    uint64_t sent;
    bool bus_off;
    int64_t bus_off_us;
} can0_t;

/* Resets the controller, lets it take every frame, and fills *bus, which refers to *self from then on. `also` is 0. */
void can0_open(can0_t* self, bus_t* bus);

/* Takes frames from the controller into the queue until `frames` that pass the filter have come. Ones beyond the queue are lost. */
void can0_await(can0_t* self, uint64_t frames);

#ifdef __cplusplus
}
#endif
#endif
