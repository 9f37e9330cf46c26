/* A step of expectation and maximisation for the second moments of a random theta. identify/diagnosis.py calls it.
 *
 * With S_w = found + errors_w and u_w = S_w^-1 theta_w of every window w the sum of u_w u_w' - S_w^-1, by the Cholesky factor of S_w.
 * Windows go through in lanes, side by side.
 */
#include <math.h>
#include <stddef.h>

#define PARTS 4
#define LANES 8
#define EACH_LANE for (int l = 0; l < LANES; l++)

void lpvg_spread(ptrdiff_t n_y, ptrdiff_t windows, const double* theta, const double* errors, const double* found, double* surplus);

/* Rows of the lower triangle m with m' m = s^-1, in every lane; of s the lower triangle is read. */
static inline void inverse_factor(double s[PARTS][PARTS][LANES], double m[PARTS][PARTS][LANES]) {
    double low[PARTS][PARTS][LANES];
    for (int i = 0; i < PARTS; i++) {
        for (int k = 0; k <= i; k++) {
            double rest[LANES];
            EACH_LANE rest[l] = s[i][k][l];
            for (int j = 0; j < k; j++) EACH_LANE rest[l] -= low[i][j][l] * low[k][j][l];
            if (k < i)
                EACH_LANE low[i][k][l] = rest[l] * m[k][k][l];
            else
                EACH_LANE m[i][i][l] = 1.0 / sqrt(rest[l]);
        }
        for (int k = 0; k < i; k++) {
            double sum[LANES] = {0.0};
            for (int j = k; j < i; j++) EACH_LANE sum[l] += low[i][j][l] * m[j][k][l];
            EACH_LANE m[i][k][l] = -m[i][i][l] * sum[l];
        }
    }
}

/* theta (n_y, 4, windows), errors (4, 4, n_y, windows), found and surplus (n_y, 4, 4): C-ordered and contiguous. */
void lpvg_spread(ptrdiff_t n_y, ptrdiff_t windows, const double* theta, const double* errors, const double* found, double* surplus) {
    for (ptrdiff_t j = 0; j < n_y; j++) {
        double total[PARTS][PARTS][LANES] = {{{0.0}}};
        for (ptrdiff_t w = 0; w < windows; w += LANES) {
            const int live = windows - w < LANES ? (int)(windows - w) : LANES;
            double s[PARTS][PARTS][LANES], m[PARTS][PARTS][LANES], t[PARTS][LANES] = {{0.0}}, u[PARTS][LANES], counts[LANES];
            EACH_LANE counts[l] = l < live ? 1.0 : 0.0;
            for (int i = 0; i < PARTS; i++) {
                for (int l = 0; l < live; l++) t[i][l] = theta[(j * PARTS + i) * windows + w + l];
                for (int k = 0; k <= i; k++) {
                    const double* of_windows = errors + ((i * PARTS + k) * n_y + j) * windows + w;
                    EACH_LANE s[i][k][l] = i == k ? 1.0 : 0.0; /* lanes beyond the last window */
                    for (int l = 0; l < live; l++) s[i][k][l] = found[(j * PARTS + i) * PARTS + k] + of_windows[l];
                }
            }
            inverse_factor(s, m);
            double white[PARTS][LANES] = {{0.0}};
            for (int i = 0; i < PARTS; i++)
                for (int k = 0; k <= i; k++) EACH_LANE white[i][l] += m[i][k][l] * t[k][l];
            for (int k = 0; k < PARTS; k++) {
                EACH_LANE u[k][l] = 0.0;
                for (int i = k; i < PARTS; i++) EACH_LANE u[k][l] += m[i][k][l] * white[i][l];
                for (int n = 0; n <= k; n++) {
                    double inverse[LANES] = {0.0};
                    for (int i = k; i < PARTS; i++) EACH_LANE inverse[l] += m[i][k][l] * m[i][n][l];
                    EACH_LANE total[k][n][l] += u[k][l] * u[n][l] - counts[l] * inverse[l];
                }
            }
        }
        for (int k = 0; k < PARTS; k++)
            for (int n = 0; n <= k; n++) {
                double sum = 0.0;
                EACH_LANE sum += total[k][n][l];
                surplus[(j * PARTS + k) * PARTS + n] = surplus[(j * PARTS + n) * PARTS + k] = sum;
            }
    }
}
