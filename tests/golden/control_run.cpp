// control_run.cpp -- the controller of a vehicle as a shared library with numbers in double, whatever it computes with.
#include <cstddef>
#include <cstdint>

#include "lpvguard/controller.h"

namespace {
lpvg_control_t control;
}

extern "C" {

void control_sizes(int64_t* sizes) {
    const int64_t all[] = {LPVG_NK, LPVG_NM, LPVG_NG, LPVG_NU, static_cast<int64_t>(lpvg_control_coeff.words.sample_period_us)};
    for (const int64_t size : all) {
        *sizes++ = size;
    }
}

// speed_min, speed_max, u_max, rate_max, A1, engage, BL, in the order of controller.h.
void control_coefficients(double* values) {
    const auto* reals = reinterpret_cast<const lpvg_real_t*>(&lpvg_control_coeff.reals);
    for (std::size_t i = 0; i < sizeof(lpvg_control_reals_t) / sizeof(lpvg_real_t); ++i) {
        values[i] = static_cast<double>(reals[i]);
    }
}

int control_start() { return lpvg_control_init(&control, &lpvg_control_coeff); }

// n samples: speed (n), m (n, LPVG_NM), engaged (n); demand u (n, LPVG_NU). Returns engaged samples in which a limit acted.
int64_t control_run(int64_t n, const double* speed, const double* m, const uint8_t* engaged, double* u) {
    const uint32_t before = control.limited;
    for (int64_t k = 0; k < n; ++k) {
        lpvg_real_t measured[LPVG_NM];
        for (lpvg_real_t& value : measured) {
            value = static_cast<lpvg_real_t>(*m++);
        }
        if (lpvg_control_step(&control, static_cast<lpvg_real_t>(speed[k]), measured, engaged[k] != 0U) != lpvg_status_ok) {
            return -1;
        }
        for (const lpvg_real_t demand : control.u) {
            *u++ = static_cast<double>(demand);
        }
    }
    return static_cast<int64_t>(control.limited - before);
}
}
