/// @file socketcan_bus.h -- a CAN interface of Linux: real controllers and vcan.
///
/// Filters run in the kernel, so foreign frames cost the firmware nothing. Times of arrival are the kernel's, moved to
/// CLOCK_MONOTONIC. Bus-off arrives as an error report; a real interface comes back by its restart-ms setting, the socket by
/// open. CAN FD frames are received and given with their true length.
#ifndef LPVGUARD_SOCKETCAN_BUS_H
#define LPVGUARD_SOCKETCAN_BUS_H

#include "../../ecu/bus.h"

namespace lpvguard {

struct SocketCanBus {
    /// `interface`, such as "vcan0", outlives the bus.
    explicit SocketCanBus(const char* interface);
    ~SocketCanBus();
    SocketCanBus(const SocketCanBus&)            = delete;
    SocketCanBus& operator=(const SocketCanBus&) = delete;

    lpvg_bus_t  bus;  ///< Give &bus to the firmware.
    const char* interface;
    int         socket = -1;
    int         error  = 0;  ///< errno of the newest fault
};

}  // namespace lpvguard

#endif
