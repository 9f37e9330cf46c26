/// @file counted_bus.hpp -- a SocketCAN bus that knows how many frames are due, for lock-step by simulated time.
///
/// While fewer than `due` frames have come, receive waits up to a second for the next; then it takes what is there. So a run gives
/// the same frames whatever the machine's speed, and frames that others send come on top.
#pragma once

#include <cstdint>

#include "socketcan.h"

class CountedBus {
public:
    /// Opens `interface`; times of frames are those of the call. False with the reason in driver().error.
    bool open(const char* interface, const socketcan_filter_t* filters, std::size_t n_filters) {
        end_ = {this, &CountedBus::send, &CountedBus::receive};
        return socketcan_open(&driver_, interface, filters, n_filters, socketcan_time_now, &raw_);
    }
    /// `heard`: which of the frames sent the other end's filter lets through (null: all); the rest are not counted.
    explicit CountedBus(bool (*heard)(const lpvg_can_frame_t*) = nullptr) : heard_(heard) {}
    CountedBus(const CountedBus&) = delete;
    CountedBus& operator=(const CountedBus&) = delete;
    ~CountedBus() { socketcan_close(&driver_); }

    const bus_t* end() const { return &end_; }
    const socketcan_t& driver() const { return driver_; }

    /// From now on `frames` are due.
    void expect(std::uint64_t frames) {
        due_ = frames;
        received_ = 0;
    }
    bool waited_in_vain() const { return in_vain_; }

    /// Frames sent since the last call that the other end hears.
    std::uint64_t take_sent() {
        const std::uint64_t sent = sent_;
        sent_ = 0;
        return sent;
    }

private:
    static constexpr int patience_ms = 1000;  // a kernel that keeps a frame longer has lost it

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
