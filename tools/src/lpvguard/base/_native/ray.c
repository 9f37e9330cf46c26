/* Longest certified step along a ray: the largest length for which multipliers y in a cone are known with
 *
 *     sum_j y_j (Q0_j - length L_j)  >=  0,      trace of the signed groups of y = 1.
 *
 * Each round maximises the least eigenvalue x of that matrix over y by a log-barrier Newton method, and then uses the y
 * found up to the largest length that it proves (Dinkelbach), with bisection in between: far from the end Dinkelbach's
 * steps alone can be a hundred times too short. Groups of y: order 1, a number >= 0; order r > 1, the r^2
 * coordinates of a Hermitian positive semidefinite matrix (diagonal first, then Re and Im of the lower triangle, row by
 * row); order 0, free numbers. engine/validation/lmi.py names the sizes.
 */
#include <float.h>
#include <math.h>
#include <stddef.h>
#include <string.h>

#define MAX_NEWTON 120

typedef struct {
    double re, im;
} cpx;
typedef cpx matrix[MAX_N][MAX_N];
typedef struct {
    int n, m, groups;
    const int *start, *order;
    const cpx *q0, *level;
} problem;

/* Cholesky in place (lower triangle; the upper is ignored); 0 when not positive definite. */
static int cholesky(int n, matrix a) {
    for (int j = 0; j < n; j++) {
        double d = a[j][j].re;
        for (int k = 0; k < j; k++) d -= a[j][k].re * a[j][k].re + a[j][k].im * a[j][k].im;
        if (!(d > 0.0)) return 0;
        d = sqrt(d);
        a[j][j] = (cpx){d, 0.0};
        for (int i = j + 1; i < n; i++) {
            double re = a[i][j].re, im = a[i][j].im;
            for (int k = 0; k < j; k++) {
                re -= a[i][k].re * a[j][k].re + a[i][k].im * a[j][k].im;
                im -= a[i][k].im * a[j][k].re - a[i][k].re * a[j][k].im;
            }
            a[i][j] = (cpx){re / d, im / d};
        }
    }
    return 1;
}

/* out = (C C^*)^-1, Hermitian, from the Cholesky factor. */
static void invert(int n, matrix c, matrix out) {
    matrix t;                                           /* C^-1, lower */
    for (int j = 0; j < n; j++)
        for (int i = j; i < n; i++) {
            double re = i == j ? 1.0 : 0.0, im = 0.0;
            for (int k = j; k < i; k++) {
                re -= c[i][k].re * t[k][j].re - c[i][k].im * t[k][j].im;
                im -= c[i][k].re * t[k][j].im + c[i][k].im * t[k][j].re;
            }
            t[i][j] = (cpx){re / c[i][i].re, im / c[i][i].re};
        }
    for (int i = 0; i < n; i++)
        for (int j = 0; j <= i; j++) {
            double re = 0.0, im = 0.0;
            for (int k = i; k < n; k++) {
                re += t[k][i].re * t[k][j].re + t[k][i].im * t[k][j].im;
                im += t[k][i].re * t[k][j].im - t[k][i].im * t[k][j].re;
            }
            out[i][j] = (cpx){re, im};
            out[j][i] = (cpx){re, -im};
        }
}

/* sum_j y_j (Q0_j - length L_j) - x I. */
static void combine(const problem* p, const double* y, double length, double x, matrix out) {
    const int n = p->n;
    for (int i = 0; i < n; i++)
        for (int j = 0; j <= i; j++) out[i][j] = (cpx){i == j ? -x : 0.0, 0.0};
    for (int k = 0; k < p->m; k++)
        for (int i = 0; i < n; i++)
            for (int j = 0; j <= i; j++) {
                const size_t at = ((size_t)k * (size_t)n + (size_t)i) * (size_t)n + (size_t)j;
                out[i][j].re += y[k] * (p->q0[at].re - length * p->level[at].re);
                out[i][j].im += y[k] * (p->q0[at].im - length * p->level[at].im);
            }
}

/* The Hermitian matrix of one group, lower triangle. */
static void member(int r, const double* y, matrix d) {
    int k = r;
    for (int i = 0; i < r; i++) {
        d[i][i] = (cpx){y[i], 0.0};
        for (int j = 0; j < i; j++, k += 2) d[i][j] = (cpx){y[k], y[k + 1]};
    }
}

static int interior(const problem* p, const double* y) {
    matrix d;
    for (int g = 0; g < p->groups; g++) {
        if (p->order[g] == 1 && !(y[p->start[g]] > 0.0)) return 0;
        if (p->order[g] > 1) {
            member(p->order[g], y + p->start[g], d);
            if (!cholesky(p->order[g], d)) return 0;
        }
    }
    return 1;
}

/* inverse of D times the k-th basis matrix of order r. */
static void times_basis(int r, matrix inverse, int k, cpx out[MAX_R][MAX_R]) {
    for (int i = 0; i < r; i++)
        for (int j = 0; j < r; j++) out[i][j] = (cpx){0.0, 0.0};
    if (k < r) {
        for (int i = 0; i < r; i++) out[i][k] = inverse[i][k];
        return;
    }
    int row = 1, left = (k - r) / 2;
    while (left >= row) left -= row++;
    const int odd = (k - r) % 2;                        /* even: real unit; odd: imaginary unit */
    for (int i = 0; i < r; i++) {
        const cpx a = inverse[i][row], b = inverse[i][left];
        out[i][left] = odd ? (cpx){-a.im, a.re} : a;    /* entry (row, left) = 1 or j */
        out[i][row] = odd ? (cpx){b.im, -b.re} : b;     /* entry (left, row) = 1 or -j */
    }
}

static void add_group(int r, const double* y, double eps, double* gradient, double* hessian, int stride) {
    matrix d, inverse;
    cpx t[MAX_R * MAX_R][MAX_R][MAX_R];
    member(r, y, d);
    cholesky(r, d);
    invert(r, d, inverse);
    for (int k = 0; k < r * r; k++) {
        times_basis(r, inverse, k, t[k]);
        for (int i = 0; i < r; i++) gradient[k] += eps * t[k][i][i].re;
    }
    for (int k = 0; k < r * r; k++)
        for (int l = 0; l < r * r; l++) {
            double sum = 0.0;
            for (int i = 0; i < r; i++)
                for (int j = 0; j < r; j++) sum += t[k][i][j].re * t[l][j][i].re - t[k][i][j].im * t[l][j][i].im;
            hessian[k * stride + l] += eps * sum;
        }
}

/* Gauss with partial pivoting on a (size x size, stride MAX_M + 2); the solution replaces b. 0 when singular. */
static int gauss(int size, double a[MAX_M + 2][MAX_M + 2], double* b) {
    for (int k = 0; k < size; k++) {
        int best = k;
        for (int i = k + 1; i < size; i++)
            if (fabs(a[i][k]) > fabs(a[best][k])) best = i;
        if (!(fabs(a[best][k]) > 0.0)) return 0;
        if (best != k) {
            for (int j = k; j < size; j++) {
                const double t = a[k][j];
                a[k][j] = a[best][j];
                a[best][j] = t;
            }
            const double t = b[k];
            b[k] = b[best];
            b[best] = t;
        }
        for (int i = k + 1; i < size; i++) {
            const double f = a[i][k] / a[k][k];
            if (f == 0.0) continue;
            for (int j = k + 1; j < size; j++) a[i][j] -= f * a[k][j];
            b[i] -= f * b[k];
        }
    }
    for (int k = size - 1; k >= 0; k--) {
        for (int j = k + 1; j < size; j++) b[k] -= a[k][j] * b[j];
        b[k] /= a[k][k];
    }
    return 1;
}

/* Largest x with a matrix - x I positive definite, from below, by bisection on the factorisation. */
static double least_eigenvalue(const problem* p, const double* y, double length) {
    matrix a;
    double bound = 0.0;
    combine(p, y, length, 0.0, a);
    for (int i = 0; i < p->n; i++) {
        double row = 0.0;
        for (int j = 0; j < p->n; j++) row += j <= i ? hypot(a[i][j].re, a[i][j].im) : hypot(a[j][i].re, a[j][i].im);
        bound = fmax(bound, row);
    }
    double lo = -bound * (1.0 + 1e-9) - 1e-300, hi = bound;
    for (int k = 0; k < 30; k++) {
        const double mid = 0.5 * (lo + hi);
        combine(p, y, length, mid, a);
        if (cholesky(p->n, a))
            lo = mid;
        else
            hi = mid;
    }
    return lo;
}

/* Bound on the rounding error of sum_j y_j Q0_j: free multipliers may be large and cancel. */
static double rounding(const problem* p, const double* y) {
    const size_t entries = (size_t)p->n * (size_t)p->n;
    double sum = 0.0;
    for (int k = 0; k < p->m; k++) {
        double square = 0.0;
        for (size_t i = 0; i < entries; i++) {
            const cpx q = p->q0[(size_t)k * entries + i];
            square += q.re * q.re + q.im * q.im;
        }
        sum += fabs(y[k]) * sqrt(square);
    }
    return 4.0 * p->n * DBL_EPSILON * sum;
}

/* The multipliers with the same share of the trace for each diagonal entry. */
static void even(const problem* p, double* y) {
    double degree = 0.0;
    memset(y, 0, sizeof(double) * (size_t)p->m);
    for (int g = 0; g < p->groups; g++) degree += p->order[g];
    for (int g = 0; g < p->groups; g++)
        for (int i = 0; i < p->order[g]; i++) y[p->start[g] + i] = 1.0 / degree;
}

/* max x at one length. y: the best multipliers; above: more than the optimum; inverse: (matrix - x I)^-1 at y. Returns x. */
static double maximise_level(const problem* p, double length, double relative, double absolute, double* y, double* above, matrix inverse) {
    static const double shrink = 0.15;
    const int n = p->n, m = p->m, size = m + 2;
    static _Thread_local cpx scaled[MAX_M + 1][MAX_N][MAX_N];
    double normal[MAX_M] = {0.0}, kkt[MAX_M + 2][MAX_M + 2], rhs[MAX_M + 2], hessian[(MAX_M + 1) * (MAX_M + 1)];
    int degree = n;
    for (int g = 0; g < p->groups; g++) {
        degree += p->order[g];
        for (int i = 0; i < p->order[g]; i++) normal[p->start[g] + i] = 1.0;
    }
    even(p, y);
    *above = INFINITY;
    const double low = least_eigenvalue(p, y, length);
    double x = low - 0.5 * fmax(1e-3, fabs(low)), eps = 0.5 * (low - x);
    matrix slack;
    combine(p, y, length, x, slack);
    if (!cholesky(n, slack)) return -INFINITY;
    invert(n, slack, inverse);
    for (int it = 0; it < MAX_NEWTON; it++) {
        for (int k = 0; k <= m; k++)
            for (int i = 0; i < n; i++)
                for (int j = 0; j < n; j++) {
                    if (k == m) {
                        scaled[k][i][j] = (cpx){-inverse[i][j].re, -inverse[i][j].im};
                        continue;
                    }
                    double re = 0.0, im = 0.0;
                    for (int l = 0; l < n; l++) {
                        const size_t at = ((size_t)k * (size_t)n + (size_t)l) * (size_t)n + (size_t)j;
                        const cpx q = {p->q0[at].re - length * p->level[at].re, p->q0[at].im - length * p->level[at].im};
                        re += inverse[i][l].re * q.re - inverse[i][l].im * q.im;
                        im += inverse[i][l].re * q.im + inverse[i][l].im * q.re;
                    }
                    scaled[k][i][j] = (cpx){re, im};
                }
        double gradient[MAX_M + 1];
        for (int k = 0; k <= m; k++) {
            double trace = 0.0;
            for (int i = 0; i < n; i++) trace += scaled[k][i][i].re;
            gradient[k] = eps * trace + (k == m ? 1.0 : 0.0);
            for (int l = 0; l <= k; l++) {
                double sum = 0.0;
                for (int i = 0; i < n; i++)
                    for (int j = 0; j < n; j++) sum += scaled[k][i][j].re * scaled[l][j][i].re - scaled[k][i][j].im * scaled[l][j][i].im;
                hessian[k * (m + 1) + l] = hessian[l * (m + 1) + k] = eps * sum;
            }
        }
        for (int g = 0; g < p->groups; g++) {
            const int s = p->start[g];
            if (p->order[g] == 1) {
                gradient[s] += eps / y[s];
                hessian[s * (m + 1) + s] += eps / (y[s] * y[s]);
            } else if (p->order[g] > 1) {
                add_group(p->order[g], y + s, eps, gradient + s, hessian + s * (m + 1) + s, m + 1);
            }
        }
        for (int i = 0; i < size; i++)
            for (int j = 0; j < size; j++) kkt[i][j] = i <= m && j <= m ? hessian[i * (m + 1) + j] * (i == j ? 1.0 + 1e-13 : 1.0) : 0.0;
        for (int i = 0; i < m; i++) {
            kkt[m + 1][i] = kkt[i][m + 1] = normal[i];
            if (hessian[i * (m + 1) + i] == 0.0) kkt[i][i] = 1.0; /* a free form of zeros keeps its multiplier */
        }
        memcpy(rhs, gradient, sizeof gradient);
        rhs[m + 1] = 0.0;
        if (!gauss(size, kkt, rhs)) break;
        double decrement = 0.0;
        for (int k = 0; k <= m; k++) decrement += gradient[k] * rhs[k];
        decrement = sqrt(fmax(decrement / eps, 0.0));
        if (!isfinite(decrement)) break;
        double step = decrement < 0.25 ? 1.0 : 1.0 / (1.0 + decrement);
        if (decrement > 1.0) step = fmin(1.0, 4.0 * step);
        double trial[MAX_M];
        int taken = 0;
        for (; step > 1e-10; step *= 0.5) {
            for (int k = 0; k < m; k++) trial[k] = y[k] + step * rhs[k];
            if (!interior(p, trial)) continue;
            combine(p, trial, length, x + step * rhs[m], slack);
            if (cholesky(n, slack)) {
                taken = 1;
                break;
            }
        }
        if (!taken) break;
        memcpy(y, trial, sizeof(double) * (size_t)m);
        x += step * rhs[m];
        invert(n, slack, inverse);
        if (decrement * step < 0.5 && decrement < 1.0) {
            *above = fmin(*above, x + 2.0 * eps * degree);
            if (*above < 0.0 || *above - x <= fmax(absolute, relative * fabs(x))) break;
            eps *= shrink;
        }
    }
    return x;
}

/* Largest length at which y still certifies (and everything shorter) in spite of an ``error`` of the matrix; INFINITY when no length ends
 * it. */
static double reach(const problem* p, const double* y, double from, double error) {
    matrix a;
    double lo = from, hi = fmax(2.0 * from, 1e-12);
    combine(p, y, lo, error, a);
    if (!cholesky(p->n, a)) return 0.0;
    for (;; hi *= 4.0) {
        if (hi > 1e30) return INFINITY;
        combine(p, y, hi, error, a);
        if (!cholesky(p->n, a)) break;
        lo = hi;
    }
    for (int k = 0; k < 60 && hi - lo > 1e-9 * hi; k++) {
        const double mid = lo > 0.0 && hi > 2.0 * lo ? sqrt(lo * hi) : 0.5 * (lo + hi);
        combine(p, y, mid, error, a);
        if (cholesky(p->n, a))
            lo = mid;
        else
            hi = mid;
    }
    return lo;
}

/* max x with sum_j y_j Q_j - x I >= 0. y (m) out: its multipliers; above: more than the optimum; inverse (n x n) out: of that matrix. */
double lpvg_level(int n, int m, int groups, const int* start, const int* order, const cpx* q, double relative, double absolute, double* y,
                  double* above, cpx* inverse) {
    const problem p = {n, m, groups, start, order, q, q};
    matrix inv;
    const double x = maximise_level(&p, 0.0, relative, absolute, y, above, inv);
    for (int i = 0; i < n; i++)
        for (int j = 0; j < n; j++) inverse[i * n + j] = inv[i][j];
    return x;
}

/* Returns the certified length. y (m) out: its multipliers, valid when *found; inverse (n x n) out: the primal at the end. */
double lpvg_ray(int n, int m, int groups, const int* start, const int* order, const cpx* q0, const cpx* level, double cutoff, double* y,
                int* found, cpx* inverse) {
    const problem p = {n, m, groups, start, order, q0, level};
    *found = 0;
    double above, length = 0.0, next[MAX_M];
    matrix inv;
    double beyond = INFINITY;                           /* a length that is known, or taken, not to be provable */
    for (int round_ = 0; round_ < 80; round_++) {
        /* In turn: at the proven length itself (Dinkelbach, fast near the end), and boldly ahead (bisection). */
        const int ahead = round_ % 2;
        double at = length;
        if (ahead && beyond < INFINITY) at = beyond > 4.0 * length ? sqrt(fmax(length, 1e-6 * beyond) * beyond) : 0.5 * (length + beyond);
        if (ahead && beyond == INFINITY) at = cutoff < INFINITY ? fmax(cutoff, length) : 8.0 * length;
        const double x = maximise_level(&p, at, 0.3, 1e-8, next, &above, inv), error = rounding(&p, next);
        if (ahead && !(x > error)) {
            beyond = at;
            continue;
        }
        for (int i = 0; i < n; i++)
            for (int j = 0; j < n; j++) inverse[i * n + j] = inv[i][j];
        if (!(x > error)) break;
        memcpy(y, next, sizeof(double) * (size_t)m);
        *found = 1;
        const double longer = fmax(at, reach(&p, y, at, error));
        const int done = !ahead && (longer <= length * (1.0 + 1e-6) || beyond <= longer * (1.0 + 1e-5));
        length = fmax(length, longer);
        if (done || length >= cutoff) break;
    }
    return length;
}
