/* can0.h -- CAN controller 0 of the ZynqMP, as QEMU 7.2 models it, as the firmware's bus.
 *
 * QEMU's model differs from silicon in two ways. Its identifier registers hold identifier and flags in the form of SocketCAN (silicon:
 * 28..18 in bits 31..21, 17..0 in bits 18..1). Byte 0 of the data is in bits 7..0 (silicon: 31..24). A controller on a virtual bus
 * never goes off by itself. As with vcan, an injected error report means bus-off.
 *
 * The driver polls the controller, because the model has no interrupt controller at the RPU. Filter and bus-off are those of
 * ../linux/socketcan.h. Frames that match no rule are dropped. After bus-off, nothing is sent or received for CAN0_RESTART_US. */
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
    uint32_t also; /* identifier and flags that also pass the filter; 0: none */
    lpvg_can_frame_t queue[CAN0_QUEUE]; /* frames from the controller that are not yet received */
    size_t head, tail;                  /* these only count up; the index is the remainder */
    uint64_t sent;
    bool bus_off;
    int64_t bus_off_us;
} can0_t;

/* Resets the controller, lets it receive every frame, and fills *bus, which then refers to *self. `also` becomes 0. */
void can0_open(can0_t* self, bus_t* bus);

/* Moves frames from the controller to the queue until `frames` frames have passed the filter. Frames beyond the queue are lost. */
void can0_await(can0_t* self, uint64_t frames);

#ifdef __cplusplus
}
#endif
#endif
