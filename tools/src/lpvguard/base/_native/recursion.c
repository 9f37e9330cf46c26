/* The nominal model's recursion along a drive, x_{k+1} = A_k x_k + f_k. vehicle/nominal.py has the numpy version.
 *
 * a (samples, n, n), f (samples, n), x0 (n,), out (samples, n): C-ordered and contiguous; out[k] is the state before step k.
 * Sums run from the first column on, the forcing last, without contraction: the same bits as the numpy version.
 */
#include <stddef.h>

void lpvg_recursion(ptrdiff_t samples, ptrdiff_t n, const double* a, const double* f, const double* x0, double* out);

void lpvg_recursion(ptrdiff_t samples, ptrdiff_t n, const double* a, const double* f, const double* x0, double* out) {
    for (ptrdiff_t i = 0; i < n && samples > 0; i++) out[i] = x0[i];
    for (ptrdiff_t k = 0; k + 1 < samples; k++) {
        const double* x = out + k * n;
        double* next = out + (k + 1) * n;
        for (ptrdiff_t i = 0; i < n; i++) {
            const double* row = a + (k * n + i) * n;
            double sum = row[0] * x[0];
            for (ptrdiff_t j = 1; j < n; j++) sum += row[j] * x[j];
            next[i] = sum + f[k * n + i];
        }
    }
}
