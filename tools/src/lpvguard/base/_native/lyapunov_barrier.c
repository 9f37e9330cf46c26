/* Hessian of -sum_i log det F_i for F_i(P) = E' P(v_i) E - G_i' P(v_i+) G_i + const, P(v) = sum_k phi_k(v) P_k.
 *
 * With S_i = F_i^-1: a_i = E S_i E', b_i = G_i S_i G_i', c_i = G_i S_i E', each (count, n, n). phi, next (count, terms): phi_k at
 * v_i and at v_i+. Unknowns: the upper triangles of P_1 .. P_terms row by row; h (terms * n(n+1)/2)^2, rows and columns in that
 * order; the lower triangle of h is written. lpv_certificate.py has the numpy version.
 */
#include <stddef.h>

#define MAX_TERMS 4

void lpvg_lyapunov_hessian(ptrdiff_t n, ptrdiff_t count, ptrdiff_t terms, const double* a, const double* b, const double* c,
                           const double* phi, const double* next, double* h);

void lpvg_lyapunov_hessian(ptrdiff_t n, ptrdiff_t count, ptrdiff_t terms, const double* a, const double* b, const double* c,
                           const double* phi, const double* next, double* h) {
    const ptrdiff_t size = n * (n + 1) / 2, width = terms * size;
    ptrdiff_t row = 0;
    for (ptrdiff_t i = 0; i < n; i++) {
        for (ptrdiff_t j = i; j < n; j++, row++) {
            const double w1 = i == j ? 1.0 : 2.0;
            for (ptrdiff_t s = 0; s < terms; s++)
                for (ptrdiff_t t = 0; t <= s; t++)
                    for (ptrdiff_t q = 0; q < size; q++) h[(s * size + row) * width + t * size + q] = 0.0;
            for (ptrdiff_t m = 0; m < count; m++) {
                const double *ai = a + (m * n + i) * n, *aj = a + (m * n + j) * n;
                const double *bi = b + (m * n + i) * n, *bj = b + (m * n + j) * n;
                const double *cm = c + m * n * n, *ci = cm + i * n, *cj = cm + j * n;
                double f[MAX_TERMS][MAX_TERMS][4];
                for (ptrdiff_t s = 0; s < terms; s++)
                    for (ptrdiff_t t = 0; t <= s; t++) {
                        const double ps = phi[m * terms + s], pt = phi[m * terms + t];
                        const double ns = next[m * terms + s], nt = next[m * terms + t];
                        f[s][t][0] = ps * pt;
                        f[s][t][1] = ns * nt;
                        f[s][t][2] = -ps * nt;
                        f[s][t][3] = -ns * pt;
                    }
                ptrdiff_t q0 = 0;
                for (ptrdiff_t k = 0; k < n; k++) {
                    const double aik = ai[k], ajk = aj[k], bik = bi[k], bjk = bj[k], cik = ci[k], cjk = cj[k];
                    const double* ck = cm + k * n;
                    const double dik = ck[i], djk = ck[j]; /* E S G' */
                    double part[4][256];
                    const ptrdiff_t run = n - k;
                    for (ptrdiff_t l = 0; l < run; l++) {
                        part[0][l] = aik * aj[k + l] + ai[k + l] * ajk;
                        part[1][l] = bik * bj[k + l] + bi[k + l] * bjk;
                        part[3][l] = cik * cj[k + l] + ci[k + l] * cjk;
                    }
                    for (ptrdiff_t l = 0; l < run; l++) part[2][l] = dik * ck[l * n + j] + djk * ck[l * n + i];
                    for (ptrdiff_t p = 0; p < 4; p++) {
                        for (ptrdiff_t l = 0; l < run; l++) part[p][l] *= w1;
                        part[p][0] *= 0.5;
                    }
                    for (ptrdiff_t s = 0; s < terms; s++)
                        for (ptrdiff_t t = 0; t <= s; t++) {
                            double* out = h + (s * size + row) * width + t * size + q0;
                            const double* g = f[s][t];
                            for (ptrdiff_t l = 0; l < run; l++)
                                out[l] += g[0] * part[0][l] + g[1] * part[1][l] + g[2] * part[2][l] + g[3] * part[3][l];
                        }
                    q0 += run;
                }
            }
        }
    }
}
