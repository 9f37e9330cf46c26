// begin.hpp -- what init does after its check, for a caller that has checked the coefficients.
#pragma once

#include "lpvguard/monitor.h"

#define lpvg_monitor_begin LPVG_SYM(monitor_begin)

// As lpvg_monitor_init leaves it.
extern "C" void lpvg_monitor_begin(lpvg_monitor_t* self, const lpvg_coeff_t* coeff);
