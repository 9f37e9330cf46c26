/* A model's recursion along a drive, x_{k+1} = A_k x_k + f_k, and that of the nominal model from its table over speed.
 * vehicle/nominal.py calls both.
 *
 * a (samples, n, n), f (samples, n), x0 (n,), out (samples, n): C-ordered and contiguous; out[k] is the state before step k.
 * Sums run from the first column on, the forcing last, without contraction.
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

/* The nominal model, x_{k+1} = Ad_k x_k + (B_old,k older_k + B_new,k newer_k), with entries from the table: `entries` (Ad, B_old,
 * B_new row by row) holds those that do not vary; entry `index[i]` is the cubic `cubic[cell][i]` (cells, varying, 4) in the position
 * within the cell. `position` (samples,) is in cells; older, newer (samples, n_u); out (samples + 1, n) begins with the first state.
 */
void lpvg_scheduled(ptrdiff_t samples, ptrdiff_t n, ptrdiff_t n_u, ptrdiff_t cells, ptrdiff_t varying, const ptrdiff_t* index,
                    const double* cubic, const double* position, const double* older, const double* newer, double* entries, double* out);

static inline double product(ptrdiff_t n, const double* row, const double* x) {
    double sum = row[0] * x[0];
    for (ptrdiff_t j = 1; j < n; j++) sum += row[j] * x[j];
    return sum;
}

void lpvg_scheduled(ptrdiff_t samples, ptrdiff_t n, ptrdiff_t n_u, ptrdiff_t cells, ptrdiff_t varying, const ptrdiff_t* index,
                    const double* cubic, const double* position, const double* older, const double* newer, double* entries, double* out) {
    const double *b_old = entries + n * n, *b_new = b_old + n * n_u;
    for (ptrdiff_t k = 0; k < samples; k++) {
        ptrdiff_t cell = position[k] > 0.0 ? (ptrdiff_t)position[k] : 0;
        if (cell >= cells) cell = cells - 1;
        const double p = position[k] - (double)cell;
        const double* c = cubic + cell * varying * 4;
        for (ptrdiff_t i = 0; i < varying; i++, c += 4) entries[index[i]] = c[0] + p * (c[1] + p * (c[2] + p * c[3]));
        for (ptrdiff_t i = 0; i < n; i++) {
            const double forced = product(n_u, b_old + i * n_u, older + k * n_u) + product(n_u, b_new + i * n_u, newer + k * n_u);
            out[(k + 1) * n + i] = product(n, entries + i * n, out + k * n) + forced;
        }
    }
}
