// begin.hpp -- what init does after its check, for a caller that has checked the coefficients.
#pragma once

#include "lpvguard/controller.h"
#include "lpvguard/monitor.h"

#define lpvg_monitor_begin LPVG_SYM(monitor_begin)
#define lpvg_control_begin LPVG_SYM(control_begin)

// As lpvg_monitor_init leaves it.
extern "C" void lpvg_monitor_begin(lpvg_monitor_t* self, const lpvg_coeff_t* coeff);

#if LPVG_NK > 0
// As lpvg_control_init leaves it.
extern "C" void lpvg_control_begin(lpvg_control_t* self, const lpvg_control_coeff_t* coeff);
#endif
