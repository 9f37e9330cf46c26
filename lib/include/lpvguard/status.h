/// @file status.h -- what every function of the core returns.
#ifndef LPVGUARD_STATUS_H
#define LPVGUARD_STATUS_H

#ifdef __cplusplus
extern "C" {
#endif

#if defined(__GNUC__)
#define LPVG_NODISCARD __attribute__((warn_unused_result))
#else
#define LPVG_NODISCARD
#endif

typedef enum lpvg_status_t {
    lpvg_ok           = 0,
    lpvg_bad_argument = 1,  ///< A NULL pointer or a setting outside its stated range; nothing was changed.
    lpvg_bad_sample   = 2,  ///< Data that fail a check; the function says which.
} lpvg_status_t;

#ifdef __cplusplus
}
#endif
#endif
