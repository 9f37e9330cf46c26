/* socketcan.c -- see socketcan.h. */
#include "socketcan.h"

#include <errno.h>
#include <linux/can.h>
#include <linux/can/error.h>
#include <linux/can/raw.h>
#include <net/if.h>
#include <poll.h>
#include <string.h>
#include <sys/socket.h>
#include <unistd.h>

/* A frame that is shorter than struct can_frame never comes: the socket delivers whole ones. */
static bool receive_frame(void* driver, int64_t now_us, lpvg_can_frame_t* frame)
{
    const socketcan_t* self = (const socketcan_t*)driver;
    struct can_frame raw;
    if (recv(self->handle, &raw, sizeof raw, MSG_DONTWAIT) != (ssize_t)sizeof raw) {
        return false;
    }
    frame->id = raw.can_id; /* flags have the same bit values: can.h */
    frame->dlc = raw.can_dlc;
    memcpy(frame->data, raw.data, sizeof frame->data);
    frame->t_us = now_us;
    return true;
}

static bool send_frame(void* driver, const lpvg_can_frame_t* frame)
{
    const socketcan_t* self = (const socketcan_t*)driver;
    struct can_frame raw;
    memset(&raw, 0, sizeof raw);
    raw.can_id = frame->id;
    raw.can_dlc = frame->dlc;
    memcpy(raw.data, frame->data, sizeof raw.data);
    return send(self->handle, &raw, sizeof raw, MSG_DONTWAIT) == (ssize_t)sizeof raw;
}

bool socketcan_open(socketcan_t* self, const char* interface, bus_t* bus)
{
    const can_err_mask_t errors = CAN_ERR_MASK;
    struct sockaddr_can address;
    if (self == NULL || interface == NULL || bus == NULL) {
        errno = EINVAL;
        return false;
    }
    memset(&address, 0, sizeof address);
    address.can_family = AF_CAN;
    address.can_ifindex = (int)if_nametoindex(interface);
    if (address.can_ifindex == 0) {
        return false;
    }
    self->handle = socket(PF_CAN, SOCK_RAW, CAN_RAW);
    if (self->handle < 0) {
        return false;
    }
    if (setsockopt(self->handle, SOL_CAN_RAW, CAN_RAW_ERR_FILTER, &errors, sizeof errors) != 0 ||
        bind(self->handle, (const struct sockaddr*)&address, sizeof address) != 0) {
        const int reason = errno;
        close(self->handle);
        errno = reason;
        return false;
    }
    bus->driver = self;
    bus->send_frame = send_frame;
    bus->receive_frame = receive_frame;
    return true;
}

bool socketcan_wait(const socketcan_t* self, int timeout_ms)
{
    struct pollfd readable;
    readable.fd = self->handle;
    readable.events = POLLIN;
    return poll(&readable, 1, timeout_ms) > 0;
}

void socketcan_close(socketcan_t* self)
{
    close(self->handle);
}
