/// @file status.h -- status codes that the functions of lpvguard return.
#ifndef LPVGUARD_STATUS_H
#define LPVGUARD_STATUS_H

/// Marks functions whose result the caller must check.
#if defined(__GNUC__)
#define LPVG_NODISCARD __attribute__((warn_unused_result))
#else
#define LPVG_NODISCARD
#endif

/// Zero is success. Every other value tells which input was refused. The values never change between versions.
typedef enum lpvg_status_t {
    lpvg_status_ok = 0,
    lpvg_status_bad_argument = 1,    ///< A pointer is NULL, or a setting is outside its stated range; nothing was changed.
    lpvg_status_bad_magic = 2,       ///< Coefficients: not lpvguard coefficients, or erased memory.
    lpvg_status_bad_schema = 3,      ///< Coefficients: written by an incompatible version of the exporter.
    lpvg_status_bad_size = 4,        ///< Coefficients: sizes or number type differ from those compiled in.
    lpvg_status_bad_estimator = 5,   ///< Coefficients: bounds were made with another estimator.
    lpvg_status_bad_crc = 6,         ///< Coefficients: CRC-32 differs, a bit has changed.
    lpvg_status_not_finite = 7,      ///< Coefficients: a number is NaN or infinite.
    lpvg_status_bad_value = 8,       ///< Coefficients: a number is outside what the algorithm allows.
    lpvg_status_bad_sample = 9,      ///< Sample or frame: a check that the function documents failed, for example NaN or out of range.
    lpvg_status_out_of_order = 10,   ///< Sample: not newer than the last one; ignored.
    lpvg_status_not_ready = 11       ///< The object has not been initialised.
} lpvg_status_t;

#endif
