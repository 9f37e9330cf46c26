// authentication.cpp -- see authentication.h.
#include "lpvguard/authentication.h"

#include <cstring>

namespace {

constexpr uint8_t n_data = 8U, n_short = 2U, n_mac = 6U;

bool matches(const lpvg_can_auth_t& self, const lpvg_can_frame_t& frame, uint32_t id) {
    return ((frame.id ^ id) & self.config.id_mask) == 0U;
}

// The authenticator of a message under a freshness value; false where none could be made.
bool authenticator_of(const lpvg_can_auth_t& self, const lpvg_can_frame_t& message, uint64_t freshness, uint8_t (&bytes)[n_data]) {
    uint8_t data[LPVG_CAN_AUTH_BYTES] = {}, mac[16] = {};
    data[0] = static_cast<uint8_t>(self.config.data_id >> 8U);
    data[1] = static_cast<uint8_t>(self.config.data_id & 0xFFU);
    data[2] = message.dlc;
    std::memcpy(&data[3], message.data, message.dlc);
    for (uint8_t i = 0U; i < 8U; ++i) {
        data[11U + i] = static_cast<uint8_t>((freshness >> (56U - 8U * i)) & 0xFFU);
    }
    if (!self.config.cmac(self.config.context, data, sizeof data, mac)) {
        return false;
    }
    bytes[0] = static_cast<uint8_t>(freshness & 0xFFU);
    bytes[1] = static_cast<uint8_t>((freshness >> 8U) & 0xFFU);
    for (uint8_t i = 0U; i < n_mac; ++i) {
        bytes[n_short + i] = mac[i];
    }
    return true;
}

// The smallest value above the newest one whose low bits are those of the frame; 0 where there is none.
uint64_t freshness_of(const lpvg_can_auth_t& self, const lpvg_can_frame_t& frame) {
    const uint64_t low = static_cast<uint64_t>(frame.data[0]) | (static_cast<uint64_t>(frame.data[1]) << 8U);
    const uint64_t same = (self.freshness & ~uint64_t{0xFFFFU}) | low;
    return same > self.freshness ? same : same + 0x10000U;
}

// As long for every difference, so that the time tells nothing of the authenticator.
bool same_bytes(const uint8_t* a, const uint8_t* b) {
    uint8_t differ = 0U;
    for (uint8_t i = 0U; i < n_data; ++i) {
        differ = static_cast<uint8_t>(differ | (a[i] ^ b[i]));
    }
    return differ == 0U;
}

void remove_first(lpvg_can_auth_t& self) {
    static_assert(LPVG_CAN_AUTH_WAITING == 2U, "the second is the only one that moves up");
    --self.n_waiting;
    self.waiting[0] = self.waiting[1];
}

// Those that wait longer than a pair may take, and those of another clock. Damage may have made their number any.
void forget_old(lpvg_can_auth_t& self, int64_t now_us) {
    constexpr uint64_t reorder = LPVG_CAN_REORDER_US;
    self.n_waiting = self.n_waiting <= LPVG_CAN_AUTH_WAITING ? self.n_waiting : uint8_t{0};
    while (self.n_waiting > 0U &&
           static_cast<uint64_t>(now_us) - static_cast<uint64_t>(self.waiting[0].t_us) + reorder > self.config.pair_us + reorder) {
        remove_first(self);
    }
}

lpvg_can_auth_event_t take_message(lpvg_can_auth_t& self, const lpvg_can_frame_t& frame) {
    if (frame.dlc < 1U || frame.dlc > n_data) {
        return lpvg_can_auth_length;
    }
    if (self.n_waiting == LPVG_CAN_AUTH_WAITING) {
        remove_first(self);
    }
    self.waiting[self.n_waiting] = frame;
    ++self.n_waiting;
    return lpvg_can_auth_waiting;
}

lpvg_can_auth_event_t take_authenticator(lpvg_can_auth_t& self, const lpvg_can_frame_t& frame, lpvg_can_frame_t& out) {
    if (frame.dlc != n_data) {
        return lpvg_can_auth_length;
    }
    if (self.n_waiting == 0U) {
        return lpvg_can_auth_alone;
    }
    const uint64_t freshness = freshness_of(self, frame);
    for (uint8_t i = 0U; i < self.n_waiting; ++i) {
        uint8_t bytes[n_data] = {};
        if (freshness > self.freshness && authenticator_of(self, self.waiting[i], freshness, bytes) && same_bytes(bytes, frame.data)) {
            out = self.waiting[i];
            self.freshness = freshness;
            self.n_waiting = 0U;
            return lpvg_can_auth_passed;
        }
    }
    return lpvg_can_auth_forged;
}

}  // namespace

extern "C" {

lpvg_status_t lpvg_can_auth_init(lpvg_can_auth_t* self, const lpvg_can_auth_config_t* config, uint64_t freshness) {
    if (self == nullptr || config == nullptr || config->cmac == nullptr || ((config->id ^ config->auth_id) & config->id_mask) == 0U ||
        config->pair_us == 0U) {
        return lpvg_status_bad_argument;
    }
    *self = lpvg_can_auth_t{};
    self->config = *config;
    self->freshness = freshness;
    return lpvg_status_ok;
}

lpvg_can_auth_event_t lpvg_can_auth_receive(lpvg_can_auth_t* self, const lpvg_can_frame_t* frame, lpvg_can_frame_t* out) {
    if (self == nullptr || frame == nullptr || out == nullptr || self->config.cmac == nullptr) {
        return lpvg_can_auth_none;
    }
    forget_old(*self, frame->t_us);
    lpvg_can_auth_event_t event = lpvg_can_auth_other;
    if (matches(*self, *frame, self->config.id)) {
        event = take_message(*self, *frame);
    } else if (matches(*self, *frame, self->config.auth_id)) {
        event = take_authenticator(*self, *frame, *out);
    } else {
        *out = *frame;
    }
    self->count[event] += self->count[event] < UINT32_MAX ? 1U : 0U;
    return event;
}

lpvg_status_t lpvg_can_auth_protect(lpvg_can_auth_t* self, const lpvg_can_frame_t* message, lpvg_can_frame_t* authenticator) {
    if (self == nullptr || message == nullptr || authenticator == nullptr || message->dlc < 1U || message->dlc > n_data) {
        return lpvg_status_bad_argument;
    }
    if (self->config.cmac == nullptr || self->freshness == UINT64_MAX) {
        return lpvg_status_not_ready;
    }
    uint8_t bytes[n_data] = {};
    if (!authenticator_of(*self, *message, self->freshness + 1U, bytes)) {
        return lpvg_status_bad_sample;
    }
    ++self->freshness;
    authenticator->id = self->config.auth_id;
    authenticator->dlc = n_data;
    authenticator->t_us = message->t_us;
    std::memcpy(authenticator->data, bytes, sizeof bytes);
    return lpvg_status_ok;
}

}  // extern "C"
