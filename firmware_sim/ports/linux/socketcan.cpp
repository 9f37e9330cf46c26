#include "socketcan.h"

#include <algorithm>
#include <cerrno>
#include <cstring>
#include <ctime>

#include <linux/can.h>
#include <linux/can/error.h>
#include <linux/can/raw.h>
#include <net/if.h>
#include <poll.h>
#include <sys/socket.h>
#include <unistd.h>

namespace {

static_assert(LPVG_CAN_EXTENDED == CAN_EFF_FLAG && LPVG_CAN_REMOTE == CAN_RTR_FLAG && LPVG_CAN_ERROR == CAN_ERR_FLAG &&
                  LPVG_CAN_BUS_OFF == CAN_ERR_BUSOFF,
              "the core's flags are the kernel's");

template <class T>
bool set(int socket, int level, int name, const T& value) {
    return ::setsockopt(socket, level, name, &value, sizeof value) == 0;
}

bool set_filters(int socket, const socketcan_filter_t* filters, size_t n) {
    // In a filter, the error flag has another meaning for the kernel: "error reports only" in the mask, "inverted" in the id.
    can_filter kernel[SOCKETCAN_FILTERS_MAX];
    for (size_t i = 0; i < n; ++i) {
        kernel[i].can_id = filters[i].id & ~CAN_ERR_FLAG;
        kernel[i].can_mask = filters[i].mask & ~CAN_ERR_FLAG;
    }
    return n == 0 || ::setsockopt(socket, SOL_CAN_RAW, CAN_RAW_FILTER, kernel, static_cast<socklen_t>(n * sizeof kernel[0])) == 0;
}

bool open_socket(socketcan_t& self) {
    sockaddr_can address{};
    address.can_family = AF_CAN;
    address.can_ifindex = static_cast<int>(::if_nametoindex(self.interface));
    const can_err_mask_t errors = CAN_ERR_MASK;
    const int on = 1;
    if (address.can_ifindex != 0) {
        self.socket = ::socket(PF_CAN, SOCK_RAW | SOCK_NONBLOCK | SOCK_CLOEXEC, CAN_RAW);
    }
    if (self.socket < 0 || !set_filters(self.socket, self.filters, self.n_filters) ||
        !set(self.socket, SOL_CAN_RAW, CAN_RAW_ERR_FILTER, errors) || !set(self.socket, SOL_CAN_RAW, CAN_RAW_FD_FRAMES, on) ||
        !set(self.socket, SOL_SOCKET, SO_TIMESTAMPNS, on) ||
        ::bind(self.socket, reinterpret_cast<const sockaddr*>(&address), sizeof address) != 0) {
        self.error = errno;
        socketcan_close(&self);
        return false;
    }
    return true;
}

// Ends the bus-off when its time is over. Returns true during the bus-off.
bool still_off(socketcan_t& self, int64_t now_us) {
    if (self.bus_off && now_us - self.bus_off_us >= SOCKETCAN_RESTART_US) {
        socketcan_close(&self);
        if (open_socket(self)) {
            self.bus_off = false;
            ++self.restarts;
        } else {
            self.bus_off_us = now_us;  // the interface is missing: try again
        }
    }
    return self.bus_off;
}

bool send(void* driver, const lpvg_can_frame_t* frame) {
    auto& self = *static_cast<socketcan_t*>(driver);
    if (self.bus_off) {
        self.error = ENETDOWN;
        return false;
    }
    if (frame->dlc > sizeof frame->data) {
        self.error = EINVAL;
        return false;
    }
    can_frame out{};
    out.can_id = frame->id;
    out.can_dlc = frame->dlc;
    std::memcpy(out.data, frame->data, frame->dlc);
    if (::write(self.socket, &out, sizeof out) == static_cast<ssize_t>(sizeof out)) {
        return true;
    }
    self.error = errno;
    return false;
}

int64_t microseconds(const timespec& t) { return static_cast<int64_t>(t.tv_sec) * 1'000'000 + t.tv_nsec / 1'000; }

// Returns the time for which the frame was in the socket's queue.
int64_t waited_us(msghdr& message) {
    for (cmsghdr* c = CMSG_FIRSTHDR(&message); c != nullptr; c = CMSG_NXTHDR(&message, c)) {
        if (c->cmsg_level == SOL_SOCKET && c->cmsg_type == SCM_TIMESTAMPNS) {
            timespec stamp{}, now{};
            std::memcpy(&stamp, CMSG_DATA(c), sizeof stamp);
            clock_gettime(CLOCK_REALTIME, &now);  // the clock of the kernel's time stamps
            return std::max<int64_t>(microseconds(now) - microseconds(stamp), 0);
        }
    }
    return 0;
}

bool receive_one(socketcan_t& self, int64_t now_us, lpvg_can_frame_t* frame) {
    canfd_frame in{};
    iovec payload = {&in, sizeof in};
    alignas(cmsghdr) char control[CMSG_SPACE(sizeof(timespec))];
    msghdr message{};
    message.msg_iov = &payload;
    message.msg_iovlen = 1;
    message.msg_control = control;
    message.msg_controllen = sizeof control;
    if (::recvmsg(self.socket, &message, 0) < 0) {
        self.error = errno == EAGAIN ? self.error : errno;
        return false;
    }
    frame->id = in.can_id;
    frame->dlc = in.len;
    frame->t_us = self.time == socketcan_time_now ? now_us : now_us - waited_us(message);
    std::memcpy(frame->data, in.data, sizeof frame->data);
    return true;
}

bool receive(void* driver, int64_t now_us, lpvg_can_frame_t* frame) {
    auto& self = *static_cast<socketcan_t*>(driver);
    bool off = still_off(self, now_us);
    while (receive_one(self, now_us, frame)) {
        const bool report = (frame->id & CAN_ERR_FLAG) != 0U;
        if (report && (frame->id & CAN_ERR_RESTARTED) != 0U) {
            self.bus_off = off = false;
        } else if (report && (frame->id & CAN_ERR_BUSOFF) != 0U && !off) {
            self.bus_off = true;
            self.bus_off_us = now_us;
        }
        if (!off) {
            return true;
        }
        // A controller in bus-off receives nothing. On a vcan, other nodes do not notice the bus-off.
    }
    return false;
}

}  // namespace

bool socketcan_open(socketcan_t* self, const char* interface, const socketcan_filter_t* filters, size_t n_filters, socketcan_time_t time,
                    bus_t* bus) {
    *self = socketcan_t{};
    self->time = time;
    self->socket = -1;
    *bus = {self, send, receive};
    if (n_filters > SOCKETCAN_FILTERS_MAX || std::strlen(interface) >= SOCKETCAN_NAME_MAX) {
        self->error = EINVAL;
        return false;
    }
    self->n_filters = n_filters;
    std::copy_n(filters, n_filters, self->filters);
    std::strcpy(self->interface, interface);
    return open_socket(*self);
}

bool socketcan_wait(const socketcan_t* self, int timeout_ms) {
    pollfd readable{self->socket, POLLIN, 0};
    return ::poll(&readable, 1, timeout_ms) > 0 && (readable.revents & POLLIN) != 0;
}

void socketcan_close(socketcan_t* self) {
    if (self->socket >= 0) {
        ::close(self->socket);
        self->socket = -1;
    }
}
