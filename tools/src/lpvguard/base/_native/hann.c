/* Hann frames of real signals at every start of a stretch, by sliding sums. drives/frames.py calls it.
 *
 * A frame of N samples with c periods is, by the window's three lines l = c - 1, c, c + 1,
 *
 *     X_i = scale sum_n w_n x_{i+n} e^{-2 pi j c n / N} = scale (S_c / 2 - (S_{c-1} + S_{c+1}) / 4),
 *     S_l = e^{2 pi j l i / N} sum_{n = i}^{i + N - 1} x_n e^{-2 pi j l n / N}.
 *
 * The sum of S_l slides: one sample leaves, one comes, with the same factor, which repeats after N samples. After N steps a sum
 * taken anew replaces it, so rounding does not gather.
 */
#include <stddef.h>

#define LANES 4

void lpvg_hann(ptrdiff_t frames, ptrdiff_t m, ptrdiff_t length, const double* x, const double* turn, double scale, double* out);

/* Signals 0 .. live - 1 of x (.., m), at most LANES; `turn` (length, 3, 2): e^{-2 pi j l n / N}; `out` (frames, m, 2). */
static inline void hann(ptrdiff_t frames, ptrdiff_t m, int live, ptrdiff_t length, const double* restrict x, const double* restrict turn,
                        double scale, double* restrict out) {
    double sum[6][LANES] = {{0.0}}, anew[6][LANES] = {{0.0}}, step[LANES] = {0.0}, comes[LANES] = {0.0};
    for (ptrdiff_t n = 0; n < length; n++)
        for (int l = 0; l < live; l++)
            for (int part = 0; part < 6; part++) sum[part][l] += turn[6 * n + part] * x[n * m + l];
    const double half = 0.5 * scale, quarter = 0.25 * scale;
    for (ptrdiff_t i = 0, n = 0; i < frames; i++) {
        const double* restrict t = turn + 6 * n;
        const double ar = quarter * t[0], ai = quarter * t[1], br = half * t[2], bi = half * t[3], cr = quarter * t[4], ci = quarter * t[5];
        double re[LANES], im[LANES];
        for (int l = 0; l < LANES; l++) {
            re[l] = (br * sum[2][l] + bi * sum[3][l]) - (ar * sum[0][l] + ai * sum[1][l]) - (cr * sum[4][l] + ci * sum[5][l]);
            im[l] = (br * sum[3][l] - bi * sum[2][l]) - (ar * sum[1][l] - ai * sum[0][l]) - (cr * sum[5][l] - ci * sum[4][l]);
        }
        for (int l = 0; l < live; l++) {
            out[2 * (i * m + l)] = re[l];
            out[2 * (i * m + l) + 1] = im[l];
        }
        if (i + 1 == frames) return;
        for (int l = 0; l < live; l++) {
            comes[l] = x[(i + length) * m + l];
            step[l] = comes[l] - x[i * m + l];
        }
        for (int part = 0; part < 6; part++)
            for (int l = 0; l < LANES; l++) {
                sum[part][l] += t[part] * step[l];
                anew[part][l] += t[part] * comes[l];
            }
        if (++n == length) {
            n = 0;
            for (int part = 0; part < 6; part++)
                for (int l = 0; l < LANES; l++) {
                    sum[part][l] = anew[part][l];
                    anew[part][l] = 0.0;
                }
        }
    }
}

void lpvg_hann(ptrdiff_t frames, ptrdiff_t m, ptrdiff_t length, const double* x, const double* turn, double scale, double* out) {
    ptrdiff_t first = 0;
    for (; first + LANES <= m; first += LANES)       /* a constant count: two outputs' e and yhat become straight vector code */
        hann(frames, m, LANES, length, x + first, turn, scale, out + 2 * first);
    if (first < m) hann(frames, m, (int)(m - first), length, x + first, turn, scale, out + 2 * first);
}
