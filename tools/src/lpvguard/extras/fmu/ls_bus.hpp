// ls_bus.hpp -- a CAN terminal of FMI-LS-BUS 1.0 (network abstraction): frames as operations of its CAN protocol, version 1.0.0.
//
// Tx_Clock ticks every sample period. Then the unit sends and receives (communicate), and Tx_Data holds its operations. Nothing is waited
// for: Confirm, Arbitration Lost, Bus Error, Status, Configuration and Wakeup are taken and change nothing.
#pragma once

#include <algorithm>
#include <cstring>

#include "lpvguard/can.h"
#include "unit.hpp"

namespace lpvguard_fmu {

enum BusReference : unsigned {
    vr_rx_data = 400,
    vr_rx_clock,
    vr_tx_data,
    vr_tx_clock
};

enum Operation : uint32_t {
    op_format_error = 0x01,
    op_can_transmit = 0x10,
    op_can_fd_transmit = 0x11,
    op_can_xl_transmit = 0x12,
    op_confirm = 0x20,
    op_arbitration_lost = 0x30,
    op_bus_error = 0x31,
    op_configuration = 0x40,
    op_status = 0x41,
    op_wakeup = 0x42
};

// Received frames that wait, and the operations of Tx_Data. Plain bytes; a copy is a saved state.
class Terminal {
public:
    bool ticked, communicated;  // in this period
    static constexpr std::size_t frames_max = 128, bytes_max = 4096;

    // The bus simulation is told the bit rate, and to send again what loses the arbitration.
    void configure(uint32_t bits_ps) {
        const unsigned char rate[] = {0x1, byte(bits_ps, 0), byte(bits_ps, 1), byte(bits_ps, 2), byte(bits_ps, 3)};
        const unsigned char arbitration[] = {0x4, 0x1};
        put(op_configuration, rate, sizeof rate);
        put(op_configuration, arbitration, sizeof arbitration);
    }

    bool send(const lpvg_can_frame_t& frame) {
        const uint32_t id = frame.id & 0x1FFFFFFFU;
        unsigned char content[8U + sizeof frame.data] = {
            byte(id, 0), byte(id, 1), byte(id, 2), byte(id, 3), (frame.id & LPVG_CAN_EXTENDED) != 0U, 0U, frame.dlc, 0U};
        std::memcpy(content + 8, frame.data, frame.dlc);
        return put(op_can_transmit, content, 8U + frame.dlc);
    }

    // Takes operations that arrive at t_us. False: more frames than wait here.
    bool take(const unsigned char* data, std::size_t size, int64_t t_us) {
        bool all = true;
        while (size > 0U) {
            const uint32_t length = size < 8U ? 0U : number(data + 4);
            if (length < 8U || length > size || !take_one(number(data), data + 8, length - 8U, t_us, all)) {
                refuse(data, length < 8U || length > size ? size : length);
            }
            if (length < 8U || length > size) {
                return all;
            }
            data += length;
            size -= length;
        }
        return all;
    }

    bool receive(lpvg_can_frame_t& frame) {
        if (read_ == n_frames_) {
            read_ = n_frames_ = 0U;
            return false;
        }
        frame = frames_[read_++];
        return true;
    }

    // Frames that come more than once a step arrive together. Gives them the times of their period, back to the step before, in order.
    template <class Period>
    void spread(int64_t step_us, Period period_us) {
        const auto end = frames_ + n_frames_;
        for (auto frame = frames_ + read_; frame != end; ++frame) {
            const int64_t later = std::count_if(frame + 1, end, [&](const lpvg_can_frame_t& other) { return other.id == frame->id; });
            frame->t_us -= std::min(later * period_us(frame->id), step_us);
        }
        std::stable_sort(frames_ + read_, end, [](const auto& a, const auto& b) { return a.t_us < b.t_us; });
    }

    const unsigned char* data() const { return bytes_; }
    std::size_t size() const { return n_bytes_; }
    void clear() { n_bytes_ = 0U; }

private:
    static unsigned char byte(uint32_t value, unsigned k) { return static_cast<unsigned char>(value >> (8U * k)); }
    static uint32_t number(const unsigned char* b) {
        return b[0] | static_cast<uint32_t>(b[1]) << 8U | static_cast<uint32_t>(b[2]) << 16U | static_cast<uint32_t>(b[3]) << 24U;
    }

    bool put(uint32_t operation, const unsigned char* content, std::size_t size) {
        const auto length = static_cast<uint32_t>(8U + size);
        if (n_bytes_ + length > bytes_max) {
            return false;
        }
        for (const uint32_t value : {operation, length}) {
            for (unsigned k = 0; k < 4U; ++k) {
                bytes_[n_bytes_++] = byte(value, k);
            }
        }
        std::memcpy(bytes_ + n_bytes_, content, size);
        n_bytes_ += static_cast<uint32_t>(size);
        return true;
    }

    // A corrupt operation goes back to its sender.
    void refuse(const unsigned char* operation, std::size_t size) {
        unsigned char content[2U + 1024U];
        size = size < 1024U ? size : 1024U;
        content[0] = byte(static_cast<uint32_t>(size), 0);
        content[1] = byte(static_cast<uint32_t>(size), 1);
        std::memcpy(content + 2, operation, size);
        static_cast<void>(put(op_format_error, content, 2U + size));
    }

    // False: corrupt. CAN FD and CAN XL frames and remote requests are for others.
    bool take_one(uint32_t operation, const unsigned char* content, std::size_t size, int64_t t_us, bool& all) {
        switch (operation) {
            case op_can_transmit: {
                const std::size_t dlc = size < 8U ? 0U : content[6] + 256U * content[7];
                if (size != 8U + dlc || dlc > 8U) {
                    return false;
                }
                const uint32_t id = number(content) | (content[4] != 0U ? LPVG_CAN_EXTENDED : 0U);
                lpvg_can_frame_t frame{};
                frame.id = id;
                frame.dlc = static_cast<uint8_t>(dlc);
                frame.t_us = t_us;
                std::memcpy(frame.data, content + 8, dlc);
                if (content[5] == 0U) {
                    all = n_frames_ < frames_max && all;
                    if (n_frames_ < frames_max) {
                        frames_[n_frames_++] = frame;
                    }
                }
                return true;
            }
            case op_can_fd_transmit:
            case op_can_xl_transmit:
            case op_configuration:
            case op_format_error: return true;
            case op_confirm:
            case op_arbitration_lost: return size == 4U;
            case op_bus_error: return size == 7U;
            case op_status: return size == 1U;
            case op_wakeup: return size == 0U;
            default: return false;
        }
    }

    lpvg_can_frame_t frames_[frames_max];
    unsigned char bytes_[bytes_max];
    uint32_t n_frames_, read_, n_bytes_;
};

// A unit with one terminal. Without event mode it has none, and its plain inputs act.
class BusUnit : public Unit {
public:
    using Unit::Unit;

    bool has_events() const final { return true; }
    Status set_binary(unsigned reference, const unsigned char* data, std::size_t size) final {
        if (reference != vr_rx_data) {
            return none(reference, "binary input");
        }
        return terminal().take(data, size, now_us()) ? ok
                                                     : say(warning,
                                                           "CAN.Rx_Data: more frames than the %zu that wait here; "
                                                           "the rest is lost",
                                                           Terminal::frames_max);
    }
    Status get_binary(unsigned reference, const unsigned char*& data, std::size_t& size) final {
        if (reference != vr_tx_data) {
            return none(reference, "binary output");
        }
        const Status status = communicate_once();
        data = terminal().data();
        size = terminal().size();
        return status;
    }
    Status tick(unsigned reference) final {
        if (reference == vr_tx_clock) {
            terminal().ticked = true;
            return ok;
        }
        return reference == vr_rx_clock ? ok : none(reference, "input clock");
    }
    Status update() final {
        const Status status = communicate_once();
        if (terminal().communicated) {
            terminal().clear();
        }
        return status;
    }
    Status step() final {
        if (with_events && !terminal().communicated) {
            return say(error,
                       "doStep at %.6f s: CAN.Tx_Clock has not ticked; activate it every %.9g s in event mode, or instantiate "
                       "without event mode for the plain inputs",
                       now_s, period_s());
        }
        const Status status = advance();
        terminal().ticked = terminal().communicated = false;
        return status;
    }

protected:
    BusUnit(const BusUnit&) = default;
    virtual Terminal& terminal() = 0;
    virtual Status communicate() = 0;  // at now_s: takes what has arrived, and sends
    virtual Status advance() = 0;      // by one period
    int64_t now_us() const { return static_cast<int64_t>(now_s * 1e6 + 0.5); }

private:
    Status communicate_once() {
        if (!terminal().ticked || terminal().communicated) {
            return ok;
        }
        terminal().communicated = true;
        return communicate();
    }
};

}  // namespace lpvguard_fmu
