/* The whole of lpvguard's on-line use: init once, push one sample a period, read the verdict.
 *
 * Drives straight ahead at 10 m/s for 40 s. Expected output:
 *
 *     verdict: not_judged (too little excitation), 0 frames recorded
 */
#include <stdio.h>

#include "lpvguard/monitor.h"
#include "lpvguard_signals.h"

static lpvg_monitor_t monitor;

int main(void) {
    static const char* const names[] = {"unknown", "valid", "invalid", "not_judged", "stale", "fault", "degraded"};
    const int64_t period_us = lpvg_coeff.words.sample_period_us;
    int64_t t_us = 0;
    int k;

    if (lpvg_monitor_init(&monitor, &lpvg_coeff) != lpvg_status_ok) {
        return 1;
    }
    for (k = 0; k < 2000; ++k) {
        lpvg_sample_t sample = {0};
        t_us = k * period_us;
        sample.t_us = t_us;
        sample.speed = (lpvg_real_t)10;
        sample.u[LPVG_INPUT_ROAD_WHEEL_ANGLE] = (lpvg_real_t)0;
        sample.y[LPVG_OUTPUT_YAW_RATE] = (lpvg_real_t)0;
        if (lpvg_monitor_push(&monitor, &sample) != lpvg_status_ok) {
            return 1;
        }
    }
    printf("verdict: %s%s, %u frames recorded\n", names[lpvg_monitor_verdict(&monitor, t_us)],
           lpvg_monitor_reason(&monitor) == lpvg_reason_not_excited ? " (too little excitation)" : "", (unsigned)monitor.n_records);
    return lpvg_monitor_verdict(&monitor, t_us) == lpvg_verdict_not_judged ? 0 : 1;
}
