#include "socketcan_bus.h"

#include <algorithm>
#include <cerrno>
#include <cstring>
#include <ctime>
#include <type_traits>

#include <linux/can.h>
#include <linux/can/error.h>
#include <linux/can/raw.h>
#include <net/if.h>
#include <sys/ioctl.h>
#include <sys/socket.h>
#include <unistd.h>

namespace lpvguard {
namespace {

static_assert(LPVG_CAN_EXTENDED == CAN_EFF_FLAG && LPVG_CAN_REMOTE == CAN_RTR_FLAG && LPVG_CAN_ERROR == CAN_ERR_FLAG &&
              LPVG_CAN_BUS_OFF == CAN_ERR_BUSOFF, "the core's flags are the kernel's");
static_assert(std::is_standard_layout_v<SocketCanBus>);

constexpr size_t kFiltersMax = 32;

SocketCanBus& port_of(lpvg_bus_t* bus) { return *reinterpret_cast<SocketCanBus*>(bus); }

int64_t now_us(clockid_t clock) {
    timespec t{};
    clock_gettime(clock, &t);
    return static_cast<int64_t>(t.tv_sec) * 1'000'000 + t.tv_nsec / 1'000;
}

lpvg_bus_result_t fault(SocketCanBus& port) {
    port.error = errno;
    return lpvg_bus_fault;
}

void shut(SocketCanBus& port) {
    if (port.socket >= 0) {
        ::close(port.socket);
        port.socket = -1;
    }
}

template <class T>
bool set(int socket, int level, int name, const T& value) {
    return ::setsockopt(socket, level, name, &value, sizeof value) == 0;
}

bool set_filters(int socket, const lpvg_bus_filter_t* filters, size_t n) {
    // In a filter the kernel reads the error flag otherwise: in the mask as "error reports only", in the id as "inverted".
    can_filter kernel[kFiltersMax];
    for (size_t i = 0; i < n; ++i) {
        kernel[i].can_id   = filters[i].id & ~CAN_ERR_FLAG;
        kernel[i].can_mask = filters[i].mask & ~CAN_ERR_FLAG;
    }
    return n == 0 || ::setsockopt(socket, SOL_CAN_RAW, CAN_RAW_FILTER, kernel,
                                  static_cast<socklen_t>(n * sizeof kernel[0])) == 0;
}

lpvg_bus_result_t open(lpvg_bus_t* bus, const lpvg_bus_filter_t* filters, size_t n_filters) {
    SocketCanBus& port = port_of(bus);
    shut(port);
    if (n_filters > kFiltersMax) {
        errno = EINVAL;
        return fault(port);
    }
    port.socket = ::socket(PF_CAN, SOCK_RAW | SOCK_NONBLOCK | SOCK_CLOEXEC, CAN_RAW);
    sockaddr_can address{};
    address.can_family  = AF_CAN;
    address.can_ifindex = static_cast<int>(::if_nametoindex(port.interface));
    const can_err_mask_t errors = CAN_ERR_MASK;
    const int            on     = 1;
    if (port.socket < 0 || address.can_ifindex == 0 || !set_filters(port.socket, filters, n_filters) ||
        !set(port.socket, SOL_CAN_RAW, CAN_RAW_ERR_FILTER, errors) || !set(port.socket, SOL_CAN_RAW, CAN_RAW_FD_FRAMES, on) ||
        !set(port.socket, SOL_SOCKET, SO_TIMESTAMPNS, on) ||
        ::bind(port.socket, reinterpret_cast<const sockaddr*>(&address), sizeof address) != 0) {
        const lpvg_bus_result_t result = fault(port);
        shut(port);
        return result;
    }
    return lpvg_bus_ok;
}

lpvg_bus_result_t send(lpvg_bus_t* bus, const lpvg_can_frame_t* frame) {
    SocketCanBus& port = port_of(bus);
    if (frame->dlc > sizeof frame->data) {
        errno = EINVAL;
        return fault(port);
    }
    can_frame out{};
    out.can_id  = frame->id;
    out.can_dlc = frame->dlc;
    std::memcpy(out.data, frame->data, frame->dlc);
    if (::write(port.socket, &out, sizeof out) == static_cast<ssize_t>(sizeof out)) {
        return lpvg_bus_ok;
    }
    return errno == EAGAIN || errno == ENOBUFS ? lpvg_bus_full : fault(port);
}

// Time of arrival on CLOCK_MONOTONIC; the kernel stamps on CLOCK_REALTIME.
int64_t arrival_us(msghdr& message) {
    const int64_t now = now_us(CLOCK_MONOTONIC);
    for (cmsghdr* c = CMSG_FIRSTHDR(&message); c != nullptr; c = CMSG_NXTHDR(&message, c)) {
        if (c->cmsg_level == SOL_SOCKET && c->cmsg_type == SCM_TIMESTAMPNS) {
            timespec stamp{};
            std::memcpy(&stamp, CMSG_DATA(c), sizeof stamp);
            const int64_t waited = now_us(CLOCK_REALTIME) - (static_cast<int64_t>(stamp.tv_sec) * 1'000'000 + stamp.tv_nsec / 1'000);
            return now - std::max<int64_t>(waited, 0);
        }
    }
    return now;
}

lpvg_bus_result_t receive(lpvg_bus_t* bus, lpvg_can_frame_t* frame) {
    SocketCanBus& port = port_of(bus);
    canfd_frame   in{};
    iovec         payload = {&in, sizeof in};
    alignas(cmsghdr) char control[CMSG_SPACE(sizeof(timespec))];
    msghdr message{};
    message.msg_iov        = &payload;
    message.msg_iovlen     = 1;
    message.msg_control    = control;
    message.msg_controllen = sizeof control;
    const ssize_t size     = ::recvmsg(port.socket, &message, 0);
    if (size < 0) {
        return errno == EAGAIN ? lpvg_bus_empty : fault(port);
    }
    frame->id   = in.can_id;
    frame->dlc  = in.len;
    frame->t_us = arrival_us(message);
    std::memcpy(frame->data, in.data, sizeof frame->data);
    return lpvg_bus_ok;
}

}  // namespace

SocketCanBus::SocketCanBus(const char* name) : bus{open, send, receive}, interface(name) {}
SocketCanBus::~SocketCanBus() { shut(*this); }

}  // namespace lpvguard
