/// @file counted_bus.hpp -- a SocketCAN bus that knows how many frames are due, for lock-step with simulated time.
///
/// While fewer than `due` frames have arrived, receive waits up to a second for the next one. A run therefore gives the same
/// frames at every speed of the machine. Frames of other senders are additional.
#pragma once

#include <cstdint>

#include "socketcan.h"

class CountedBus {
public:
    /// Opens `interface`. Times of frames are those of the call. Returns false with the reason in driver().error.
    bool open(const char* interface, const socketcan_filter_t* filters, std::size_t n_filters) {
        end_ = {this, &CountedBus::send, &CountedBus::receive};
        return socketcan_open(&driver_, interface, filters, n_filters, socketcan_time_now, &raw_);
    }
    /// `heard` tells which sent frames pass the filter of the other end (null: all). Only these frames are counted.
    explicit CountedBus(bool (*heard)(const lpvg_can_frame_t*) = nullptr) : heard_(heard) {}
    CountedBus(const CountedBus&) = delete;
    CountedBus& operator=(const CountedBus&) = delete;
    ~CountedBus() { socketcan_close(&driver_); }

    const bus_t* end() const { return &end_; }
    const socketcan_t& driver() const { return driver_; }

    /// Sets the number of due frames from now on.
    void expect(std::uint64_t frames) {
        due_ = frames;
        received_ = 0;
    }
    bool waited_in_vain() const { return in_vain_; }

    /// Returns the number of frames since the last call that pass the filter of the other end.
    std::uint64_t take_sent() {
        const std::uint64_t sent = sent_;
        sent_ = 0;
        return sent;
    }

private:
    static constexpr int patience_ms = 1000;  // after this time, the kernel has lost the frame

    static bool send(void* self, const lpvg_can_frame_t* frame) {
        auto& bus = *static_cast<CountedBus*>(self);
        const bool done = bus_send(&bus.raw_, frame);
        bus.sent_ += done && (bus.heard_ == nullptr || bus.heard_(frame)) ? 1U : 0U;
        return done;
    }
    static bool receive(void* self, std::int64_t now_us, lpvg_can_frame_t* frame) {
        auto& bus = *static_cast<CountedBus*>(self);
        if (bus.received_ < bus.due_ && !bus.driver_.bus_off && !socketcan_wait(&bus.driver_, patience_ms)) {
            bus.in_vain_ = true;
            bus.due_ = 0;
        }
        const bool got = bus_receive(&bus.raw_, now_us, frame);
        bus.received_ += got ? 1U : 0U;
        return got;
    }

    socketcan_t driver_{-1, 0, socketcan_time_now, false, 0, 0, 0, {}, {}};
    bool (*heard_)(const lpvg_can_frame_t*);
    bus_t raw_{}, end_{};
    std::uint64_t due_ = 0, received_ = 0, sent_ = 0;
    bool in_vain_ = false;
};
