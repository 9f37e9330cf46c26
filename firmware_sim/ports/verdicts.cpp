// verdicts.cpp -- verdicts of one vehicle's monitor over drives on one target, in an image with only the monitor.
//
// Runs the drives in target_input.h (made by lpvguard.core.targets), each from init on, and writes these lines:
//
//   size monitor BYTES
//   drive NUMBER
//   verdict SAMPLE VERDICT       when it changes
#include "port.h"

#include <algorithm>
#include <cstddef>
#include <cstdint>

#include "lpvguard/monitor.h"
#include "target_input.h"
#include "text.hpp"

namespace {

lpvg_monitor_t monitor;

void write(const char* kind, uint64_t first, const uint64_t* second) {
    char buffer[80];
    Text text(buffer, sizeof buffer);
    text.put(kind).put(' ').number(first);
    if (second != nullptr) {
        text.put(' ').number(*second);
    }
    text.put('\n');
    port_write(buffer);
}

void run_drive(std::size_t begin, std::size_t end) {
    if (lpvg_monitor_init(&monitor, &lpvg_coeff) != lpvg_status_ok) {
        port_write("the monitor refused its coefficients\n");
        port_exit(1);
    }
    uint64_t verdict = lpvg_verdict_unknown;
    for (std::size_t k = begin; k < end; ++k) {
        lpvg_sample_t sample{};
        sample.t_us = static_cast<int64_t>(k - begin + 1U) * lpvg_coeff.words.sample_period_us;
        const float* const row = target_input[k];
        sample.speed = lpvg_real_t{row[0]};
        std::copy_n(row + 1, LPVG_NU, sample.u);
        std::copy_n(row + 1 + LPVG_NU, LPVG_NY, sample.y);
        (void)(lpvg_monitor_push(&monitor, &sample) == lpvg_status_ok);  // the verdict shows a refused sample
        const auto now = static_cast<uint64_t>(lpvg_monitor_verdict(&monitor, sample.t_us));
        if (now != verdict) {
            verdict = now;
            write("verdict", k - begin, &verdict);
        }
    }
}

}  // namespace

int main() {
    write("size monitor", sizeof monitor, nullptr);
    for (std::size_t i = 0; i < TARGET_DRIVES; ++i) {
        write("drive", i, nullptr);
        run_drive(target_drives[i], target_drives[i + 1U]);
    }
    port_write("end\n");
    return 0;
}
