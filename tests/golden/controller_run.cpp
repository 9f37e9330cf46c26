// controller_run.cpp -- lpvg_control_step over a file of doubles: rows of speed and measurements in, rows of demands out.
#include <cstdio>

#include "lpvguard/controller.h"

int main() {
    static lpvg_control_t control;
    if (lpvg_control_init(&control, &lpvg_control_coeff) != lpvg_status_ok) {
        return 1;
    }
    double row[1 + LPVG_NM];
    while (std::fread(row, sizeof row, 1, stdin) == 1) {
        lpvg_real_t m[LPVG_NM];
        for (std::size_t i = 0; i < LPVG_NM; ++i) {
            m[i] = static_cast<lpvg_real_t>(row[1 + i]);
        }
        if (lpvg_control_step(&control, static_cast<lpvg_real_t>(row[0]), m, true) != lpvg_status_ok) {
            return 2;
        }
        for (const lpvg_real_t u : control.u) {
            const auto value = static_cast<double>(u);
            std::fwrite(&value, sizeof value, 1, stdout);
        }
    }
    return 0;
}
