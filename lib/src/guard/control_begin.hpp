// control_begin.hpp -- init of the controller without the check, for a caller that has checked the coefficients.
#pragma once

#include "lpvguard/controller.h"

#define lpvg_control_begin LPVG_SYM(control_begin)

#if LPVG_NK > 0
// Sets *self to the state after lpvg_control_init.
extern "C" void lpvg_control_begin(lpvg_control_t* self, const lpvg_control_coeff_t* coeff);
#endif
