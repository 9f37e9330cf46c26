/* Certified optimum of   min  z* Q0 z + p   over z = (theta, 1), 0 <= p <= p_max,   subject to
 *
 *     z* Qw z <= 0            the disturbance ball
 *     z* (A - p B) z <= 0     one full block whose squared size is p (scaled)
 *
 * Q0 >= 0 is everything that is a plain quadratic (blocks with a constant input, Lambda_w). For fixed p this is a
 * complex quadratic problem with two constraints, whose dual
 *
 *     L(mu, p) = S_tt - S_tT S_TT^-1 S_Tt,   S = Q0 + mu_w Qw + mu_s (A - p B),   S_TT > 0
 *
 * has no gap (Beck and Eldar). For fixed mu, L(mu, .) is concave and stays valid for every smaller p, so over [a, m] the
 * bound is the smaller of a + L(mu, a) and m + L(mu, m). Branch and bound over p.
 */
#include <math.h>
#include <stddef.h>
#include <string.h>

enum {
    MAX_N = 16,
    MAX_OPEN = 256,
    MAX_NEWTON = 60,
    MAX_DUALS = 240
};

typedef struct {
    double re, im;
} cpx;
typedef struct {
    int n;
    const cpx *q0, *qw, *a, *b;
    double p_max, gap;
} problem;
typedef struct {
    double mu[2], value, slope;
    cpx z[MAX_N];
} dual_point;

/* Factor S_TT = C C^*, with the bordered row: returns L(mu, p), or NAN when S_TT is not positive definite. On return
 * c holds the factor (lower triangle), y = C^-1 S_Tt. */
static double factor(const problem* pr, const double mu[2], double p, cpx c[MAX_N][MAX_N], cpx y[MAX_N]) {
    const int n = pr->n, d = n - 1;
    const double mp = mu[1] * p;
    for (int i = 0; i < n; i++) {
        for (int j = 0; j <= i; j++) {
            const int k = i * n + j;
            double re = pr->q0[k].re + mu[0] * pr->qw[k].re + mu[1] * pr->a[k].re - mp * pr->b[k].re;
            double im = pr->q0[k].im + mu[0] * pr->qw[k].im + mu[1] * pr->a[k].im - mp * pr->b[k].im;
            for (int m = 0; m < j; m++) {
                re -= c[i][m].re * c[j][m].re + c[i][m].im * c[j][m].im;
                im -= c[i][m].im * c[j][m].re - c[i][m].re * c[j][m].im;
            }
            if (j < i) {
                const double inv = c[j][j].im;          /* the imaginary place of the diagonal keeps 1 / c_jj */
                c[i][j] = (cpx){re * inv, im * inv};
            } else if (i < d) {
                if (!(re > 0.0)) return NAN;
                c[i][i].re = sqrt(re);
                c[i][i].im = 1.0 / c[i][i].re;
            } else {
                for (int m = 0; m < d; m++) y[m] = (cpx){c[d][m].re, -c[d][m].im};
                return re;
            }
        }
    }
    return NAN;
}

/* v <- C^-1 v for one column. */
static void forward(int d, const cpx c[MAX_N][MAX_N], cpx* v) {
    for (int i = 0; i < d; i++) {
        double re = v[i].re, im = v[i].im;
        for (int m = 0; m < i; m++) {
            re -= c[i][m].re * v[m].re - c[i][m].im * v[m].im;
            im -= c[i][m].re * v[m].im + c[i][m].im * v[m].re;
        }
        v[i] = (cpx){re * c[i][i].im, im * c[i][i].im};
    }
}

/* z = (-S_TT^-1 S_Tt, 1) from y = C^-1 S_Tt. */
static void primal(int d, const cpx c[MAX_N][MAX_N], const cpx* y, cpx* z) {
    for (int i = d - 1; i >= 0; i--) {
        double re = -y[i].re, im = -y[i].im;
        for (int m = i + 1; m < d; m++) {           /* row i of C^* is the conjugate column */
            re -= c[m][i].re * z[m].re + c[m][i].im * z[m].im;
            im -= c[m][i].re * z[m].im - c[m][i].im * z[m].re;
        }
        z[i] = (cpx){re * c[i][i].im, im * c[i][i].im};
    }
    z[d] = (cpx){1.0, 0.0};
}

static double form(int n, const cpx* q, const cpx* z) {
    double sum = 0.0;
    for (int i = 0; i < n; i++) {
        double re = 0.0, im = 0.0;
        for (int j = 0; j < n; j++) {
            re += q[i * n + j].re * z[j].re - q[i * n + j].im * z[j].im;
            im += q[i * n + j].re * z[j].im + q[i * n + j].im * z[j].re;
        }
        sum += z[i].re * re + z[i].im * im;
    }
    return sum;
}

/* u = C^-1 (Q z)_T and z* Q z for Q = qa - p qb. */
static double push(const problem* pr, const cpx* qa, const cpx* qb, double p, const cpx c[MAX_N][MAX_N], const cpx* z, cpx* u) {
    const int n = pr->n;
    double value = 0.0;
    for (int i = 0; i < n; i++) {
        double re = 0.0, im = 0.0;
        for (int j = 0; j < n; j++) {
            const cpx q = {qa[i * n + j].re - p * qb[i * n + j].re, qa[i * n + j].im - p * qb[i * n + j].im};
            re += q.re * z[j].re - q.im * z[j].im;
            im += q.re * z[j].im + q.im * z[j].re;
        }
        value += z[i].re * re + z[i].im * im;
        u[i] = (cpx){re, im};
    }
    forward(n - 1, c, u);
    return value;
}

static double dot(int d, const cpx* a, const cpx* b) {
    double s = 0.0;
    for (int i = 0; i < d; i++) s += a[i].re * b[i].re + a[i].im * b[i].im;
    return s;
}

/* Interior-point Newton (predictor, corrector) for max L(mu, p), mu >= 0, from the multipliers in *at.
 *
 * The gradient of L is (z* Qw z, z* (A - p B) z) at z = z(mu), so that a feasible z leaves the gap -mu . gradient
 * between L and the cost of z: the stopping rule is exact. It stops when that gap is below `fine`; already at
 * `coarse` when p + L exceeds `beyond` (only a rough bound is needed there); and when p + L exceeds `enough`.
 * Returns 0 when no multipliers with S_TT > 0 were found. */
static int maximise_dual(const problem* pr, double p, double fine, double coarse, double beyond, double enough, dual_point* at) {
    const int d = pr->n - 1;
    cpx c[MAX_N][MAX_N], y[MAX_N], u0[MAX_N], u1[MAX_N];
    double slack[2] = {0.0, 0.0}, *mu = at->mu, value = factor(pr, mu, p, c, y);
    for (int k = 0; k < 60 && isnan(value); k++) {
        mu[1] *= 0.25;
        value = factor(pr, mu, p, c, y);
    }
    if (isnan(value)) return 0;
    for (int it = 0; it < MAX_NEWTON; it++) {
        primal(d, c, y, at->z);
        const double g0 = push(pr, pr->qw, pr->b, 0.0, c, at->z, u0), g1 = push(pr, pr->a, pr->b, p, c, at->z, u1);
        const double gap = -(mu[0] * g0 + mu[1] * g1);
        at->value = value;
        at->slope = 1.0 - mu[1] * form(pr->n, pr->b, at->z);
        if (p + value > enough) break;
        if (g0 <= 0.0 && g1 <= 0.0 && (gap <= fine || (gap <= coarse && p + value > beyond))) break;
        if (it == 0) {
            slack[0] = fmax(-g0, coarse / mu[0]);
            slack[1] = fmax(-g1, coarse / mu[1]);
        }
        const double d0 = slack[0] / mu[0], d1 = slack[1] / mu[1];
        const double h00 = 2.0 * dot(d, u0, u0) + d0, h01 = 2.0 * dot(d, u0, u1), h11 = 2.0 * dot(d, u1, u1) + d1;
        const double det = h00 * h11 - h01 * h01, mean = 0.5 * (mu[0] * slack[0] + mu[1] * slack[1]);
        /* predictor: complementarity zero */
        double s0 = (h11 * g0 - h01 * g1) / det, s1 = (h00 * g1 - h01 * g0) / det;
        double t0 = -slack[0] - d0 * s0, t1 = -slack[1] - d1 * s1, reach = 1.0;
        if (s0 < 0.0) reach = fmin(reach, -mu[0] / s0);
        if (s1 < 0.0) reach = fmin(reach, -mu[1] / s1);
        if (t0 < 0.0) reach = fmin(reach, -slack[0] / t0);
        if (t1 < 0.0) reach = fmin(reach, -slack[1] / t1);
        const double left = 0.5 * ((mu[0] + reach * s0) * (slack[0] + reach * t0) + (mu[1] + reach * s1) * (slack[1] + reach * t1));
        const double ratio = left / mean, eps = fmax(mean * fmax(ratio * ratio * ratio, 1e-3), 0.05 * fine);
        /* corrector towards eps */
        const double e0 = eps / mu[0], e1 = eps / mu[1], b0 = g0 + e0, b1 = g1 + e1;
        s0 = (h11 * b0 - h01 * b1) / det;
        s1 = (h00 * b1 - h01 * b0) / det;
        t0 = e0 - slack[0] - d0 * s0;
        t1 = e1 - slack[1] - d1 * s1;
        if (!isfinite(s0) || !isfinite(s1)) break;
        double length = 1.0;
        if (s0 < 0.0) length = fmin(length, -0.95 * mu[0] / s0);
        if (s1 < 0.0) length = fmin(length, -0.95 * mu[1] / s1);
        const double merit = value + eps * log(mu[0] * mu[1]), before[2] = {mu[0], mu[1]};
        int taken = 0;
        for (int k = 0; k < 40 && !taken; k++, length *= 0.4) {
            mu[0] = before[0] + length * s0;
            mu[1] = before[1] + length * s1;
            value = factor(pr, mu, p, c, y);
            taken = value + eps * log(mu[0] * mu[1]) >= merit - 1e-12 * fabs(merit);   /* false for NaN */
            if (taken) {
                slack[0] = fmax(slack[0] + length * t0, 0.05 * slack[0]);
                slack[1] = fmax(slack[1] + length * t1, 0.05 * slack[1]);
            }
        }
        if (!taken) {
            mu[0] = before[0];
            mu[1] = before[1];
            break;
        }
    }
    return 1;
}

static double bound_at(const problem* pr, const dual_point* at, double p) {
    cpx c[MAX_N][MAX_N], y[MAX_N];
    return p + factor(pr, at->mu, p, c, y);
}

typedef struct {
    double cost, p;
    cpx* z;
} incumbent;

/* Take z when it beats the incumbent; its cost counts its own least p, not the one it was found at. */
static void offer(const problem* pr, const cpx* z, incumbent* best) {
    const double a = form(pr->n, pr->a, z), b = form(pr->n, pr->b, z), p = a <= 0.0 ? 0.0 : b > 0.0 ? a / b : INFINITY;
    const double cost = p + form(pr->n, pr->q0, z);
    if (form(pr->n, pr->qw, z) <= 0.0 && p <= pr->p_max && cost < best->cost) {
        best->cost = cost;
        best->p = p;
        memcpy(best->z, z, sizeof(cpx) * (size_t)pr->n);
    }
}

/* An interval of p; `at` holds multipliers found at hi or above (known), which bound all of it. */
typedef struct {
    double lo, hi, lower, lo_slope;
    int known;
    dual_point at;
} interval;

static double interval_bound(const problem* pr, const interval* v) {
    const double floor_ = fmax(v->lower, v->lo);
    return v->known ? fmax(floor_, fmin(bound_at(pr, &v->at, v->lo), bound_at(pr, &v->at, v->hi))) : floor_;
}

/* A point strictly between: where the slopes of p + g(p) at the ends say that the minimum lies, in log p. */
static double cut(const interval* v) {
    if (v->lo <= 0.0) return v->hi * (v->at.slope > 0.0 ? 0.125 : 0.5);
    const double ratio = v->hi / v->lo, f0 = v->lo_slope * v->lo, f1 = v->at.slope * v->hi;
    double x = 0.5;
    if (f0 < 0.0 && f1 > 0.0) x = fmin(0.85, fmax(0.15, -f0 / (f1 - f0)));
    return ratio > 1.5 ? v->lo * pow(ratio, x) : v->lo + x * (v->hi - v->lo);
}

/* Dual at hi, from the multipliers that v carries: lifted off zero, where an interior-point method would stall. */
static void evaluate(const problem* pr, interval* v, incumbent* best) {
    const double cost = fmin(best->cost, 1.0), lift = 1e-3 * cost;   /* 1: the scale of the problem, before any point is known */
    v->at.mu[0] = fmax(v->at.mu[0], lift);
    v->at.mu[1] = fmax(v->at.mu[1], lift);
    v->known =
        maximise_dual(pr, v->hi, 0.1 * pr->gap * cost, 0.02 * cost, 1.05 * best->cost, fmin(best->cost, 1e9) + (v->hi - v->lo), &v->at);
    if (v->known) offer(pr, v->at.z, best);
    v->lower = interval_bound(pr, v);
}

/* z: a feasible start, then the point that attains the upper bound. out: lower, upper, p of the upper, duals used. */
static void solve_point(const problem* pr, cpx* z, double out[4]) {
    interval open[MAX_OPEN];
    cpx start[MAX_N];
    incumbent best = {INFINITY, 0.0, z};
    double closed = INFINITY;
    int count = 1, duals = 1;
    memcpy(start, z, sizeof(cpx) * (size_t)pr->n);
    offer(pr, start, &best);
    open[0] = (interval){.hi = fmin(pr->p_max, best.cost), .lo_slope = -1.0, .at = {.mu = {1.0, 1.0}}};
    evaluate(pr, &open[0], &best);
    while (count > 0) {
        int least = 0;
        for (int i = 1; i < count; i++)
            if (open[i].lower < open[least].lower) least = i;
        interval right = open[least];
        if (right.lower >= best.cost * (1.0 - pr->gap) || duals >= MAX_DUALS || count + 1 >= MAX_OPEN) break;
        open[least] = open[--count];
        interval left = right;
        left.hi = right.lo = cut(&right);
        duals++;
        evaluate(pr, &left, &best);
        right.lo_slope = left.known ? left.at.slope : -1.0;
        right.lower = interval_bound(pr, &right);
        const interval* child[2] = {&left, &right};
        for (int i = 0; i < 2; i++) {
            if (child[i]->lower < best.cost * (1.0 - pr->gap))
                open[count++] = *child[i];
            else
                closed = fmin(closed, child[i]->lower);
        }
    }
    for (int i = 0; i < count; i++) closed = fmin(closed, open[i].lower);
    out[0] = fmin(closed, best.cost);
    out[1] = best.cost;
    out[2] = best.p;
    out[3] = duals;
}

/* forms: per point Q0, Qw, A, B, each n x n; z per point n. Returns 0, or 1 when n does not fit the fixed arrays. */
int lpvg_s2(ptrdiff_t points, ptrdiff_t n, const cpx* forms, const double* p_max, double gap, cpx* z, double* out) {
    if (n < 2 || n > MAX_N) return 1;
    for (ptrdiff_t k = 0; k < points; k++) {
        const cpx* f = forms + k * 4 * n * n;
        const problem pr = {(int)n, f, f + n * n, f + 2 * n * n, f + 3 * n * n, p_max[k], gap};
        solve_point(&pr, z + k * n, out + 4 * k);
    }
    return 0;
}
