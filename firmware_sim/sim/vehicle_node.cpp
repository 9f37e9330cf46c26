#include "vehicle_node.hpp"

#include <algorithm>
#include <cmath>
#include <cstring>
#include <iterator>
#include <stdexcept>

#include "test_key.hpp"

namespace lpvguard_sim {
namespace {

constexpr std::uint64_t bus_fault_stream = 200;
constexpr std::int64_t standby_us = 200'000;  // the vehicle asks for control after this time

void require(lpvg_status_t status) {
    if (status != lpvg_status_ok) {
        throw std::logic_error("the codec refused a frame of the simulator's own");
    }
}

float decoded(const lpvg_can_scale_t& scale, std::uint16_t raw) {
    float value = 0.0F;
    static_cast<void>(lpvg_can_decode(&scale, raw, &value));
    return value;
}

}  // namespace

VehicleNode::VehicleNode(const bus_t* bus, double steering_ratio, const std::vector<CanFault>& faults, std::uint64_t seed)
    : bus_(bus), steering_ratio_(steering_ratio), random_(seed, bus_fault_stream) {
    revise(faults);
    require(lpvg_can_init(&supervisor_, &lpvg_can_rules[LPVG_CAN_GUARD_OUT_INDEX], 1, 0));
    require(firmware_authenticate(&authentication_, test_key()));
}

void VehicleNode::revise(const std::vector<CanFault>& faults) {
    for (std::size_t i = 0; i < faults.size(); ++i) {
        if (i < faults_.size()) {
            faults_[i].window = faults[i].window;
        } else {
            faults_.push_back({faults[i]});
        }
    }
}

// Sends the command: to control, after some time in which the loop is released.
void VehicleNode::send_command(std::int64_t now_us, lpvg_can_guard_in_t& command) {
    lpvg_can_frame_t frame{};
    frame.t_us = now_us;
    command.control_request = now_us < standby_us ? LPVG_BUS_REQUEST_RELEASE : LPVG_BUS_REQUEST_CONTROL;
    command.other_priority = 0U;
    require(lpvg_can_guard_in_pack(&command, &frame));
    require(lpvg_can_e2e_protect(&frame, LPVG_CAN_GUARD_IN_E2E_DATA_ID, &counter_));
    put(frame);
}

void VehicleNode::put(const lpvg_can_frame_t& sent) {
    lpvg_can_frame_t frame = sent;
    const double time_s = static_cast<double>(frame.t_us) * 1e-6;
    bool goes_out = true;
    lpvg_can_frame_t& newest = newest_[sent.id];
    for (Fault& fault : faults_) {
        if (goes_out && fault.id == frame.id && fault.kind != CanFault::Kind::bus_off && fault.window.contains(time_s) &&
            random_.uniform() < fault.probability) {
            goes_out = spoil(fault, frame, newest);
        }
    }
    newest = sent;
    if (goes_out && !bus_off_) {
        transmit(frame);
    }
}

// Sends a command with its authenticator.
void VehicleNode::transmit(const lpvg_can_frame_t& frame) {
    bus_send(bus_, &frame);
    if (frame.id == lpvg_bus.command_id) {
        lpvg_can_frame_t authenticator{};
        require(lpvg_can_auth_protect(&authentication_, &frame, &authenticator));
        bus_send(bus_, &authenticator);
    }
}

// Applies the fault to the frame. Returns false if the frame is not sent (now).
bool VehicleNode::spoil(Fault& fault, lpvg_can_frame_t& frame, const lpvg_can_frame_t& before) {
    const bool first = !fault.holds;
    switch (fault.kind) {
        case CanFault::Kind::lost: return false;
        case CanFault::Kind::corrupted: {
            const auto bit = static_cast<unsigned>(random_.uniform(0.0, 64.0));
            frame.data[bit / 8U] = static_cast<std::uint8_t>(frame.data[bit / 8U] ^ (1U << (bit % 8U)));
            return true;
        }
        case CanFault::Kind::delayed: delayed_.push_back({frame.t_us + std::llround(fault.delay_s * 1e6), frame}); return false;
        case CanFault::Kind::swapped:
            fault.holds = first;
            if (first) {
                fault.held = frame;
                return false;
            }
            transmit(frame);
            std::memcpy(frame.data, fault.held.data, sizeof frame.data);
            return true;
        case CanFault::Kind::repeated:
        case CanFault::Kind::stuck_counter:
            if (first) {
                fault.holds = true;
                fault.held = before;
            }
            if (fault.kind == CanFault::Kind::repeated) {
                std::memcpy(frame.data, fault.held.data, sizeof frame.data);
            } else {
                auto counter = static_cast<std::uint8_t>(fault.held.data[1] & 0x0FU);
                require(lpvg_can_e2e_protect(&frame, LPVG_CAN_GUARD_IN_E2E_DATA_ID, &counter));
            }
            return true;
        case CanFault::Kind::wrong_length: --frame.dlc; return true;
        case CanFault::Kind::unknown_id: send_beside(frame, LPVG_CAN_EXTENDED | 0x18FFEE00U); return true;
        case CanFault::Kind::babbling: send_beside(frame, frame.id); return true;
        case CanFault::Kind::bus_off:  // affects no single frame, see off_the_bus
            break;
    }
    return true;
}

// Sends ten frames with random data. Together with the good frames, they are half the load of 250 kbit/s in 10 ms.
void VehicleNode::send_beside(const lpvg_can_frame_t& frame, std::uint32_t id) {
    lpvg_can_frame_t beside = frame;
    beside.id = id;
    for (int n = 0; n < 10; ++n) {
        for (std::uint8_t& byte : beside.data) {
            byte = static_cast<std::uint8_t>(random_.uniform(0.0, 256.0));
        }
        transmit(beside);
    }
}

// The controller's error report is the last frame. Then no frame passes.
bool VehicleNode::off_the_bus(std::int64_t now_us) {
    bool off = false;
    for (Fault& fault : faults_) {
        if (fault.kind == CanFault::Kind::bus_off && fault.window.contains(static_cast<double>(now_us) * 1e-6)) {
            off = true;
            if (!fault.holds) {
                fault.holds = true;
                lpvg_can_frame_t report{};
                report.id = LPVG_CAN_ERROR | LPVG_CAN_BUS_OFF;
                report.dlc = 8;
                report.t_us = now_us;
                bus_send(bus_, &report);
            }
        }
    }
    return off;
}

void VehicleNode::release_due(std::int64_t now_us) {
    std::size_t kept = 0;
    for (Delayed& waiting : delayed_) {
        if (waiting.due_us <= now_us) {
            waiting.frame.t_us = now_us;
            if (!bus_off_) {
                transmit(waiting.frame);
            }
        } else {
            delayed_[kept++] = waiting;
        }
    }
    delayed_.resize(kept);
}

void VehicleNode::receive(std::int64_t now_us) {
    lpvg_can_frame_t frame;
    while (bus_receive(bus_, now_us, &frame)) {
        if (bus_off_) {
            continue;
        }
        std::uint8_t index = LPVG_CAN_NO_INDEX;
        const lpvg_can_event_t event = lpvg_can_receive(&supervisor_, &frame, &index);
        if (event == lpvg_can_event_accepted || event == lpvg_can_event_unknown_id) {
            take_demand(frame);
        }
        if (event == lpvg_can_event_accepted) {
            lpvg_can_guard_out_t out{};
            require(lpvg_can_guard_out_unpack(&out, &frame));
            const auto byte = [](std::uint16_t raw) { return static_cast<std::uint8_t>(raw); };
            const float margin = decoded(lpvg_can_guard_out_monitor_margin, out.monitor_margin);
            report_ = {static_cast<float>(demand_[0]), margin,
                       byte(out.monitor_verdict),      byte(out.supervision_state),
                       byte(out.engagement),           byte(out.command_authentication)};
        } else if ((frame.id & 0x00FFFF00U) == 0x00FECA00U) {  // DM1: one frame, one code (lpvg_can_dm1_pack)
            trouble_.spn = frame.data[2] + 256U * frame.data[3] + 65536U * (frame.data[4] >> 5U);
            trouble_.fmi = frame.data[4] & 0x1FU;
        }
    }
    lpvg_can_advance(&supervisor_, now_us);
    if (lpvg_can_state(&supervisor_, 0) == lpvg_can_state_off) {
        std::fill(std::begin(demand_), std::end(demand_), 0.0);
        report_.supervision = lpvg_can_state_off;
    }
}

}  // namespace lpvguard_sim
