/* One vehicle's task; compiled once per vehicle, its name prefixed like the library's. */
#include "lpvguard/monitor.h"

int LPVG_SYM(task)(void);

static lpvg_monitor_t monitor;

int LPVG_SYM(task)(void) {
    lpvg_sample_t sample = {0};
    int k;

    if (lpvg_monitor_init(&monitor, &lpvg_coeff) != lpvg_status_ok) {
        return 1;
    }
    sample.speed = lpvg_coeff.reals.speed_min;
    for (k = 0; k < 2000; ++k) {
        sample.t_us += lpvg_coeff.words.sample_period_us;
        if (lpvg_monitor_push(&monitor, &sample) != lpvg_status_ok) {
            return 1;
        }
    }
    return lpvg_monitor_frame(&monitor)->sequence > 0U ? 0 : 1;
}
