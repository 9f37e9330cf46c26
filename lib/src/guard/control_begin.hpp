// control_begin.hpp -- what init of the controller does after its check, for a caller that has checked the coefficients.
#pragma once

#include "lpvguard/controller.h"

#define lpvg_control_begin LPVG_SYM(control_begin)

#if LPVG_NK > 0
// As lpvg_control_init leaves it.
extern "C" void lpvg_control_begin(lpvg_control_t* self, const lpvg_control_coeff_t* coeff);
#endif
