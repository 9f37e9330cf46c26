/* Hessian of -sum_i log det F_i for F_i(P) = E' P(v_i) E - G_i' P(v_i+) G_i + const, P(v) = sum_k phi_k(v) P_k.
 *
 * With D_i = G_i - E, S_i = F_i^-1 and the moved shares e = phi - next: dF_i = E' dP_e E - (D' dP E + E' dP D + D' dP D) with dP_e
 * of e and dP of next. G_i is near E, so products of G_i would cancel to D_i^2, which rounding does not leave.
 * x = E S E', y = D S E', z = D S D', t = x + y + y' + z / 2, r = x + y / 2; yt, rt transposed; each (count, n, n). moved, next
 * (count, terms). Unknowns: the upper triangles of P_1 .. P_terms row by row; h (terms * n(n+1)/2)^2, rows and columns in that
 * order; the lower triangle of h is written.
 */
#include <stddef.h>

#define MAX_TERMS 4
#define MAX_STATES 256

void lpvg_lyapunov_hessian(ptrdiff_t n, ptrdiff_t count, ptrdiff_t terms, const double* x, const double* y, const double* yt,
                           const double* z, const double* t, const double* r, const double* rt, const double* moved, const double* next,
                           double* h);

/* out[l] += a_i[k] b_j[l] + a_j[k] b_i[l] + a_j[l] b_i[k] + a_i[l] b_j[k] for l = k .. k + run - 1. */
static void add_pair(double* out, ptrdiff_t k, ptrdiff_t run, const double* ai, const double* aj, const double* bi, const double* bj) {
    const double aik = ai[k], ajk = aj[k], bik = bi[k], bjk = bj[k];
    for (ptrdiff_t l = 0; l < run; l++) out[l] += aik * bj[k + l] + ajk * bi[k + l] + aj[k + l] * bik + ai[k + l] * bjk;
}

void lpvg_lyapunov_hessian(ptrdiff_t n, ptrdiff_t count, ptrdiff_t terms, const double* x, const double* y, const double* yt,
                           const double* z, const double* t, const double* r, const double* rt, const double* moved, const double* next,
                           double* h) {
    const ptrdiff_t size = n * (n + 1) / 2, width = terms * size;
    ptrdiff_t row = 0;
    for (ptrdiff_t i = 0; i < n; i++) {
        for (ptrdiff_t j = i; j < n; j++, row++) {
            const double w1 = i == j ? 1.0 : 2.0;
            for (ptrdiff_t s = 0; s < terms; s++)
                for (ptrdiff_t u = 0; u <= s; u++)
                    for (ptrdiff_t q = 0; q < size; q++) h[(s * size + row) * width + u * size + q] = 0.0;
            for (ptrdiff_t m = 0; m < count; m++) {
                const ptrdiff_t at_i = (m * n + i) * n, at_j = (m * n + j) * n;
                double f[MAX_TERMS][MAX_TERMS][4];
                for (ptrdiff_t s = 0; s < terms; s++)
                    for (ptrdiff_t u = 0; u <= s; u++) {
                        const double es = moved[m * terms + s], eu = moved[m * terms + u];
                        const double ns = next[m * terms + s], nu = next[m * terms + u];
                        f[s][u][0] = 0.5 * es * eu;
                        f[s][u][1] = ns * nu;
                        f[s][u][2] = -es * nu;
                        f[s][u][3] = -ns * eu;
                    }
                ptrdiff_t q0 = 0;
                for (ptrdiff_t k = 0; k < n; k++) {
                    double part[4][MAX_STATES] = {{0.0}};
                    const ptrdiff_t run = n - k;
                    add_pair(part[0], k, run, x + at_i, x + at_j, x + at_i, x + at_j);
                    add_pair(part[1], k, run, t + at_i, t + at_j, z + at_i, z + at_j);
                    add_pair(part[1], k, run, y + at_i, y + at_j, yt + at_i, yt + at_j);
                    add_pair(part[2], k, run, rt + at_i, rt + at_j, yt + at_i, yt + at_j);
                    add_pair(part[3], k, run, r + at_i, r + at_j, y + at_i, y + at_j);
                    for (ptrdiff_t p = 0; p < 4; p++) {
                        for (ptrdiff_t l = 0; l < run; l++) part[p][l] *= w1;
                        part[p][0] *= 0.5;
                    }
                    for (ptrdiff_t s = 0; s < terms; s++)
                        for (ptrdiff_t u = 0; u <= s; u++) {
                            double* out = h + (s * size + row) * width + u * size + q0;
                            const double* g = f[s][u];
                            for (ptrdiff_t l = 0; l < run; l++)
                                out[l] += g[0] * part[0][l] + g[1] * part[1][l] + g[2] * part[2][l] + g[3] * part[3][l];
                        }
                    q0 += run;
                }
            }
        }
    }
}
