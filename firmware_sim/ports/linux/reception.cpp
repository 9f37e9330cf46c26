#include "reception.hpp"

#include <sstream>

namespace {

void note_row(std::array<std::int64_t, lpvg_can_event_count>& first_us, const uint32_t* count, std::int64_t now_us) {
    for (std::size_t event = 0; event < first_us.size(); ++event) {
        if (count[event] > 0U && first_us[event] < 0) {
            first_us[event] = now_us;
        }
    }
}

void write_row(std::ostream& out, std::uint32_t id, unsigned state, const uint32_t* count,
               const std::array<std::int64_t, lpvg_can_event_count>& first_us) {
    out << "[" << id << ", " << state << ", [";
    for (std::size_t event = 0; event < first_us.size(); ++event) {
        out << (event == 0 ? "" : ", ") << count[event];
    }
    out << "], [";
    for (std::size_t event = 0; event < first_us.size(); ++event) {
        out << (event == 0 ? "" : ", ") << (first_us[event] < 0 ? -1.0 : static_cast<double>(first_us[event]) * 1e-6);
    }
    out << "]]";
}

}  // namespace

Reception::Reception() {
    for (Times& row : first_us_) {
        row.fill(-1);
    }
}

void Reception::note(const lpvg_can_supervisor_t& supervisor, std::int64_t now_us) {
    for (std::size_t i = 0; i < supervisor.n_rules; ++i) {
        note_row(first_us_[i], supervisor.watch[i].count, now_us);
    }
    note_row(first_us_.back(), supervisor.count, now_us);
}

std::string Reception::json(const firmware_t& firmware) const {
    const lpvg_can_supervisor_t& supervisor = firmware.ecu.supervisor;
    std::ostringstream out;
    out.precision(9);
    out << "{\"send_failures\": " << firmware.send_failures << ", \"rules\": [";
    for (std::size_t i = 0; i < supervisor.n_rules; ++i) {
        write_row(out, supervisor.rules[i].id & 0x1FFFFFFFU, supervisor.watch[i].state, supervisor.watch[i].count, first_us_[i]);
        out << ", ";
    }
    write_row(out, 0U, supervisor.bus_off, supervisor.count, first_us_.back());
    out << "]}";
    return out.str();
}
