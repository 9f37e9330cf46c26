// main.cpp -- the ECU's firmware on the emulated Cortex-R5F (QEMU xlnx-zcu102) with its own CAN controller, in simulated time.
//
// The time line (time_line.h) is the semihosting console. Reading it stops the processor until the host has written, so a
// waiting ECU takes no time of the PC. The command line is "yes" (engage) or "no". At the end, the program writes the counters
// of the supervision and the instructions of the ticks as JSON. These are the instructions of firmware_tick, from the processor's
// own counter.
#include "can0.h"
#include "firmware.h"
#include "port.h"
#include "reception.hpp"
#include "telemetry.hpp"
#include "test_key.hpp"
#include "time_line.h"

namespace {

firmware_t firmware;
can0_t can;
char text[TIME_LINE_TEXT_MAX];

struct Instructions {
    std::uint64_t calls = 0, total = 0;
    std::uint32_t worst = 0;

    void take(std::uint32_t n) {
        ++calls;
        total += n;
        worst = n > worst ? n : worst;
    }
};

void answer(std::uint64_t status, std::uint64_t frames, bool judged = false, bool found = false) {
    const time_answer_t out = {status, frames, judged ? 1U : 0U, found ? 1U : 0U};
    port_console_send(&out, sizeof out);
}

}  // namespace

int main() {
    bus_t bus;
    can0_open(&can, &bus);
    char engage[4];
    port_command_line(engage, sizeof engage);
    lpvg_ecu_config_t config = firmware_config;
    config.engage = engage[0] == 'y';
    lpvg_status_t status = firmware_init(&firmware, &bus, &config, test_key(), 0);
    port_counter_start();
    Reception reception;
    Judgements judgements;
    Findings findings;
    Instructions instructions;
    answer(status, 0U);
    time_request_t request;
    for (port_console_receive(&request, sizeof request); request.now_us >= 0; port_console_receive(&request, sizeof request)) {
        can0_await(&can, request.frames);
        const std::uint64_t sent = can.sent;
        const std::uint32_t begin = port_counter();
        status = firmware_tick(&firmware, request.now_us);
        instructions.take(port_instructions(begin, port_counter()));
        firmware_idle(&firmware);
        const bool judged = judgements.note(firmware), found = findings.note(firmware);
        answer(status, can.sent - sent, judged, found);
        if (judged) {
            port_console_send(&judgements.newest(), sizeof judgements.newest());
        }
        if (found) {
            port_console_send(&findings.newest(), sizeof findings.newest());
        }
        if (request.supervision != 0U) {
            const Supervision supervision = supervision_of(firmware);
            port_console_send(&supervision, sizeof supervision);
        }
        reception.note(firmware.ecu.supervisor, request.now_us);
    }
    Text out(text, sizeof text);
    reception.write(firmware, out.put('{'));
    out.put(", \"instructions\": {\"ticks\": ").number(instructions.calls).put(", \"total\": ").number(instructions.total);
    out.put(", \"worst\": ").number(instructions.worst).put("}}");
    answer(lpvg_status_ok, out.size());
    port_console_send(text, out.size());
    return 0;
}
