// loop.cpp -- a linear plant closed with one vehicle's compiled controller, for lpvguard.control.robust_run (ctypes). Not part of the ECU
// image.
#include <cstddef>
#include <cstdint>
#include <limits>
#include <vector>

#include "lpvguard/controller.h"

namespace {

// y += M x, M (rows, columns) row by row.
void accumulate(const double* M, std::size_t rows, std::size_t columns, const double* x, double* y) {
    for (std::size_t i = 0; i < rows; ++i) {
        double sum = 0.0;
        for (std::size_t j = 0; j < columns; ++j) {
            sum += M[i * columns + j] * x[j];
        }
        y[i] += sum;
    }
}

}  // namespace

extern "C" {

// x+ = A x + B [w; u], [z; y] = C x + D [w; u] from rest, u from the controller in the same sample; y must not depend on u.
// sizes: n, n_w, n_z, steps. w (steps, n_w), u (steps, LPVG_NU) and z (steps, n_z) are written. The controller runs without limits.
// Returns the steps in which a limit acted all the same, or -1 when the controller refuses its coefficients or a sample.
int64_t lpvgb_closed_loop(const int64_t* sizes, const double* A, const double* B, const double* C, const double* D, double speed,
                          const double* w, double* u, double* z) {
    const auto n = static_cast<std::size_t>(sizes[0]), n_w = static_cast<std::size_t>(sizes[1]);
    const auto n_z = static_cast<std::size_t>(sizes[2]), steps = static_cast<std::size_t>(sizes[3]);
    const std::size_t n_in = n_w + LPVG_NU, n_out = n_z + LPVG_NM;
    lpvg_control_coeff_t coeff = lpvg_control_coeff;
    for (std::size_t i = 0; i < LPVG_NU; ++i) {
        coeff.reals.rate_max[i] = std::numeric_limits<lpvg_real_t>::max() / 4;
        for (auto& node : coeff.reals.u_max) {
            node[i] = coeff.reals.rate_max[i];
        }
    }
    coeff.words.crc32 = lpvg_control_coeff_crc32(&coeff);
    lpvg_control_t control{};
    if (lpvg_control_init(&control, &coeff) != lpvg_status_ok) {
        return -1;
    }
    std::vector<double> x(n), next(n), in(n_in), out(n_out);
    for (std::size_t k = 0; k < steps; ++k) {
        for (std::size_t i = 0; i < n_w; ++i) {
            in[i] = w[k * n_w + i];
        }
        for (std::size_t i = n_w; i < n_in; ++i) {
            in[i] = 0.0;
        }
        out.assign(n_out, 0.0);
        accumulate(C, n_out, n, x.data(), out.data());
        accumulate(D, n_out, n_in, in.data(), out.data());
        lpvg_real_t m[LPVG_NM];
        for (std::size_t i = 0; i < LPVG_NM; ++i) {
            m[i] = static_cast<lpvg_real_t>(out[n_z + i]);
        }
        if (lpvg_control_step(&control, static_cast<lpvg_real_t>(speed), m, true) != lpvg_status_ok) {
            return -1;
        }
        for (std::size_t i = 0; i < LPVG_NU; ++i) {
            in[n_w + i] = u[k * LPVG_NU + i] = static_cast<double>(control.u[i]);
        }
        out.assign(n_out, 0.0);
        accumulate(C, n_out, n, x.data(), out.data());
        accumulate(D, n_out, n_in, in.data(), out.data());
        for (std::size_t i = 0; i < n_z; ++i) {
            z[k * n_z + i] = out[i];
        }
        next.assign(n, 0.0);
        accumulate(A, n, n, x.data(), next.data());
        accumulate(B, n, n_in, in.data(), next.data());
        x.swap(next);
    }
    return static_cast<int64_t>(control.limited);
}

}  // extern "C"
