#include "reception.hpp"

namespace {

constexpr std::uint64_t us_per_s = 1'000'000U;

void note_row(std::int64_t* first_us, const std::uint32_t* count, std::int64_t now_us) {
    for (std::size_t event = 0; event < lpvg_can_event_count; ++event) {
        if (count[event] > 0U && first_us[event] < 0) {
            first_us[event] = now_us;
        }
    }
}

void write_row(Text& out, std::uint32_t id, unsigned state, const std::uint32_t* count, const std::int64_t* first_us) {
    out.put('[').number(id).put(", ").number(state).put(", [");
    for (std::size_t event = 0; event < lpvg_can_event_count; ++event) {
        out.put(event == 0 ? "" : ", ").number(count[event]);
    }
    out.put("], [");
    for (std::size_t event = 0; event < lpvg_can_event_count; ++event) {
        out.put(event == 0 ? "" : ", ");
        if (first_us[event] < 0) {
            out.put("-1");
        } else {
            const auto us = static_cast<std::uint64_t>(first_us[event]);
            out.number(us / us_per_s).put('.').number(us % us_per_s, 6);
        }
    }
    out.put("]]");
}

// Counts of the authentication, which precedes the supervision; null without a key.
void write_authentication(Text& out, const lpvg_can_auth_t& of) {
    if (of.config.cmac == nullptr) {
        out.put("null");
        return;
    }
    out.put("{\"passed\": ").number(of.count[lpvg_can_auth_passed]).put(", \"alone\": ").number(of.count[lpvg_can_auth_alone]);
    out.put(", \"length\": ").number(of.count[lpvg_can_auth_length]).put(", \"forged\": ").number(of.count[lpvg_can_auth_forged]).put('}');
}

}  // namespace

Reception::Reception() {
    for (auto& row : first_us_) {
        for (std::int64_t& first : row) {
            first = -1;
        }
    }
}

void Reception::note(const lpvg_can_supervisor_t& supervisor, std::int64_t now_us) {
    for (std::size_t i = 0; i < supervisor.n_rules; ++i) {
        note_row(first_us_[i], supervisor.watch[i].count, now_us);
    }
    note_row(first_us_[LPVG_CAN_RULES_MAX], supervisor.count, now_us);
}

void Reception::write(const firmware_t& firmware, Text& out) const {
    const lpvg_can_supervisor_t& supervisor = firmware.ecu.supervisor;
    out.put("\"send_failures\": ").number(firmware.send_failures).put(", \"authentication\": ");
    write_authentication(out, firmware.authentication);
    out.put(", \"rules\": [");
    for (std::size_t i = 0; i < supervisor.n_rules; ++i) {
        write_row(out, supervisor.rules[i].id & 0x1FFFFFFFU, supervisor.watch[i].state, supervisor.watch[i].count, first_us_[i]);
        out.put(", ");
    }
    write_row(out, 0U, supervisor.bus_off, supervisor.count, first_us_[LPVG_CAN_RULES_MAX]);
    out.put(']');
}
