// begin.hpp -- init of the monitor without the check, for a caller that has checked the coefficients.
#pragma once

#include "lpvguard/monitor.h"

#define lpvg_monitor_begin LPVG_SYM(monitor_begin)

// Sets *self to the state after lpvg_monitor_init.
extern "C" void lpvg_monitor_begin(lpvg_monitor_t* self, const lpvg_coeff_t* coeff);
