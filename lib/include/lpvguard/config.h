/// @file config.h -- number type, symbol prefix and sizes of the vehicle of this translation unit.
///
/// `lpvguard export` generates one folder for each vehicle. Its `lpvguard_vehicle.h` holds the vehicle's name and sizes. Put
/// exactly one such folder on the include path. Every public name then has the vehicle's prefix (lpvg_monitor_init becomes
/// lpvg_g80_monitor_init). An image can therefore hold several vehicles, one per translation unit.
///
/// lpvg_real_t is float. Define LPVG_DOUBLE for every translation unit of an image to get double.
#ifndef LPVGUARD_CONFIG_H
#define LPVGUARD_CONFIG_H

#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>

#include "lpvguard_vehicle.h"

#ifdef LPVG_DOUBLE
typedef double lpvg_real_t;
/// Selects the number that fits lpvg_real_t: rounded to float, or rounded to double.
#define LPVG_NUMBER(as_float, as_double) as_double
#else
typedef float lpvg_real_t;
#define LPVG_NUMBER(as_float, as_double) as_float
#endif

// cppcheck-suppress misra-c2012-20.10 ; the prefix of every public name is made by pasting, so that vehicles share an image
#define LPVG_PASTE3(a, b, c) a##_##b##_##c
#define LPVG_PREFIXED(vehicle, name) LPVG_PASTE3(lpvg, vehicle, name)
#define LPVG_SYM(name) LPVG_PREFIXED(LPVG_VEHICLE, name)

#ifdef __cplusplus
#define LPVG_EXTERN_C_BEGIN extern "C" {
#define LPVG_EXTERN_C_END }
#else
#define LPVG_EXTERN_C_BEGIN
#define LPVG_EXTERN_C_END
#endif

#if (LPVG_NX < 1) || (LPVG_NX > 40) || (LPVG_NU < 1) || (LPVG_NU > 2) || (LPVG_NY < 1) || (LPVG_NY > 4)
#error "lpvguard: supported sizes are 1..40 states, 1..2 inputs, 1..4 outputs"
#endif
#if (LPVG_NBINS < 2) || (LPVG_NBINS > 64)
#error "lpvguard: supported are 2..64 bins, DC included"
#endif
#if !defined(LPVG_NWEIGHT) || !defined(LPVG_NDIRECTIONS)
#error "lpvguard: lpvguard_vehicle.h is of an older exporter (LPVG_NWEIGHT is missing); export the vehicle again"
#endif
#if !defined(LPVG_NBANDS) || (LPVG_NBANDS < 2) || (LPVG_NBANDS > 8)
#error "lpvguard: supported are 2..8 bands of the energy test (LPVG_NBANDS); export the vehicle again"
#endif
#ifndef LPVG_NDELTA
#error "lpvguard: lpvguard_vehicle.h is of an older exporter (LPVG_NDELTA is missing); export the vehicle again"
#elif (LPVG_NDELTA != 1) && (LPVG_NDELTA != LPVG_NY)
#error "lpvguard: supported are one Delta common to all outputs, or one an output (LPVG_NDELTA)"
#endif
#ifndef LPVG_NK
#error "lpvguard: lpvguard_vehicle.h is of an older exporter (LPVG_NK is missing); export the vehicle again"
#endif
#if (LPVG_NK > 0) && ((LPVG_NK * LPVG_NU > 40) || (LPVG_NM != LPVG_NY + 1) || (LPVG_NG < 2))
#error "lpvguard: supported controllers have up to 40 states, the reference and all outputs as measurements, 2 or more nodes"
#endif

#endif
