/* Class S1, E = delta Z + w with one complex scalar delta common to all outputs: closed forms, one point after another.
 *
 * Arrays are C-ordered and contiguous; complex numbers are (re, im) pairs, as numpy's complex128. No heap, no state.
 * Formulas and proofs: engine/validation/s1.py.
 */
#include <math.h>
#include <stddef.h>

typedef struct {
    double hi, lo;
} dd;            /* unevaluated sum hi + lo, about 32 digits */
typedef struct {
    double re, im;
} cpx;

static dd dd_add(dd a, dd b) {
    const double s = a.hi + b.hi, v = s - a.hi;
    const double t = ((a.hi - (s - v)) + (b.hi - v)) + (a.lo + b.lo);
    const double hi = s + t;
    return (dd){hi, t - (hi - s)};
}

static dd dd_prod(double a, double b) {
    const double p = a * b;
    return (dd){p, fma(a, b, -p)};
}

static dd dd_mul(dd a, dd b) {
    dd p = dd_prod(a.hi, b.hi);
    p.lo += a.hi * b.lo + a.lo * b.hi;
    const double hi = p.hi + p.lo;
    return (dd){hi, p.lo - (hi - p.hi)};
}

static dd dd_neg(dd a) { return (dd){-a.hi, -a.lo}; }

static dd dd_abs2(cpx a) { return dd_add(dd_prod(a.re, a.re), dd_prod(a.im, a.im)); }

/* a b - c d, real and imaginary part. */
static void dd_cross(cpx a, cpx b, cpx c, cpx d, dd out[2]) {
    out[0] = dd_add(dd_add(dd_prod(a.re, b.re), dd_prod(-c.re, d.re)), dd_add(dd_prod(-a.im, b.im), dd_prod(c.im, d.im)));
    out[1] = dd_add(dd_add(dd_prod(a.re, b.im), dd_prod(-c.re, d.im)), dd_add(dd_prod(a.im, b.re), dd_prod(-c.im, d.re)));
}

static double abs2(cpx a) { return a.re * a.re + a.im * a.im; }
static double cabs_(cpx a) { return sqrt(abs2(a)); }
static cpx mul(cpx a, cpx b) { return (cpx){a.re * b.re - a.im * b.im, a.re * b.im + a.im * b.re}; }
static cpx conj_mul(cpx a, cpx b) { return (cpx){a.re * b.re + a.im * b.im, a.re * b.im - a.im * b.re}; }
static cpx scale(cpx a, double s) { return (cpx){a.re * s, a.im * s}; }

typedef struct {
    double b1, nu;
    cpx delta;
} s1_result;

static const double edge = 1e-3;                 /* a difference of squares below this, relative, loses three digits */
static const double edge2 = 1e-6;                /* the same for the square of a difference */
static const double tiny = 1e-250, huge_ = 1e250; /* outside, squares of squares under- or overflow */

/* The result from sums that are exact to the last bit: ee_g = |E|^2 - gamma^2, room = gamma^2 |Z|^2 - d2. */
static s1_result finish(double ee_g, double room, double room_scale, double d2, double zz, cpx ze) {
    s1_result r = {sqrt(d2 / zz), 0.0, {0.0, 0.0}};
    if (room < -2e-12 * room_scale) {
        r.nu = INFINITY;
        return r;
    }
    if (ee_g <= 0.0) return r;
    const double aze = cabs_(ze);
    /* Within the tolerance of the edge delta is delta0; ee_g / aze holds what gamma^2 lies below B1^2. */
    r.nu = room > 0.0 ? ee_g / (aze + sqrt(room)) : aze / zz;
    r.delta = aze > 0.0 ? scale(ze, r.nu / aze) : (cpx){0.0, 0.0};
    return r;
}

/* Sums of one point to the last bit, of E / 2^ke and Z / 2^kz. */
typedef struct {
    int ke, kz;
    dd ee, zz, d2, ze_re, ze_im;
} s1_sums;

static s1_sums sums_with_care(ptrdiff_t n, const cpx* e, const cpx* z, double big_e, double big_z) {
    s1_sums s = {0};
    if (big_e > 0.0) frexp(big_e, &s.ke);
    if (big_z > 0.0) frexp(big_z, &s.kz);
    for (ptrdiff_t i = 0; i < n; i++) {
        const cpx ei = {ldexp(e[i].re, -s.ke), ldexp(e[i].im, -s.ke)}, zi = {ldexp(z[i].re, -s.kz), ldexp(z[i].im, -s.kz)};
        s.ee = dd_add(s.ee, dd_abs2(ei));
        s.zz = dd_add(s.zz, dd_abs2(zi));
        s.ze_re = dd_add(s.ze_re, dd_add(dd_prod(zi.re, ei.re), dd_prod(zi.im, ei.im)));
        s.ze_im = dd_add(s.ze_im, dd_add(dd_prod(zi.re, ei.im), dd_prod(-zi.im, ei.re)));
        for (ptrdiff_t j = 0; j < i; j++) {
            const cpx ej = {ldexp(e[j].re, -s.ke), ldexp(e[j].im, -s.ke)}, zj = {ldexp(z[j].re, -s.kz), ldexp(z[j].im, -s.kz)};
            dd c[2];
            dd_cross(ei, zj, ej, zi, c);
            s.d2 = dd_add(s.d2, dd_add(dd_mul(c[0], c[0]), dd_mul(c[1], c[1])));
        }
    }
    return s;
}

/* Largest parts of E and Z; false where one is not finite. */
static int largest_parts(ptrdiff_t n, const cpx* e, const cpx* z, double* big_e, double* big_z) {
    double sum = 0.0;
    for (ptrdiff_t i = 0; i < n; i++) {
        *big_e = fmax(*big_e, fmax(fabs(e[i].re), fabs(e[i].im)));
        *big_z = fmax(*big_z, fmax(fabs(z[i].re), fabs(z[i].im)));
        sum += (e[i].re + e[i].im) * 0.0 + (z[i].re + z[i].im) * 0.0;
    }
    return isfinite(sum);
}

/* Any scaling, any cancellation: power-of-two scaling, then double-double sums. */
static s1_result s1_careful(ptrdiff_t n, const cpx* e, const cpx* z, double gamma) {
    double big_e = gamma, big_z = 0.0;
    if (!largest_parts(n, e, z, &big_e, &big_z) || !isfinite(gamma)) return (s1_result){NAN, NAN, {NAN, NAN}};
    if (big_e == 0.0) return (s1_result){0.0, 0.0, {0.0, 0.0}};
    const s1_sums s = sums_with_care(n, e, z, big_e, big_z);
    const double g = ldexp(gamma, -s.ke);
    const dd gg = dd_prod(g, g);
    const double ee_g = dd_add(s.ee, dd_neg(gg)).hi;
    s1_result r;
    if (s.zz.hi == 0.0) {
        r = (s1_result){sqrt(s.ee.hi), ee_g <= 2e-12 * gg.hi ? 0.0 : INFINITY, {0.0, 0.0}};
    } else {
        const dd room_scale = dd_mul(gg, s.zz);
        r = finish(ee_g, dd_add(room_scale, dd_neg(s.d2)).hi, room_scale.hi, s.d2.hi, s.zz.hi, (cpx){s.ze_re.hi, s.ze_im.hi});
    }
    r.b1 = ldexp(r.b1, s.ke);
    r.nu = ldexp(r.nu, s.ke - s.kz);
    r.delta = (cpx){ldexp(r.delta.re, s.ke - s.kz), ldexp(r.delta.im, s.ke - s.kz)};
    return r;
}

/* |E|, |Z|, B1 and |delta0| of one point; NaN where it is not finite. */
static void least_careful(ptrdiff_t n, const cpx* e, const cpx* z, double* out) {
    double big_e = 0.0, big_z = 0.0;
    const int finite = largest_parts(n, e, z, &big_e, &big_z);
    const s1_sums s = sums_with_care(n, e, z, finite ? big_e : 1.0, finite ? big_z : 1.0);
    const int none = s.zz.hi == 0.0;
    out[0] = finite ? ldexp(sqrt(s.ee.hi), s.ke) : NAN;
    out[1] = finite ? ldexp(sqrt(s.zz.hi), s.kz) : NAN;
    out[2] = none || !finite ? out[0] : ldexp(sqrt(s.d2.hi / s.zz.hi), s.ke);
    out[3] = !finite ? NAN : none ? 0.0 : ldexp(cabs_((cpx){s.ze_re.hi, s.ze_im.hi}) / s.zz.hi, s.ke - s.kz);
}

/* LANES points at a time: the plain formulas in loops that the compiler turns into vector code; the points of the
 * group for which they would lose digits (or that are not finite) are then done again with care. */
#define LANES 8

/* |E|^2, |Z|^2, sum_{i<j} |E_i Z_j - E_j Z_i|^2 and Z^H E of `live` points. */
typedef struct {
    double ee[LANES], zz[LANES], d2[LANES], zr[LANES], zi[LANES];
} group_sums;

static inline void sums_of_group(ptrdiff_t n, int live, const cpx* restrict e, const cpx* restrict z, group_sums* restrict s) {
    for (ptrdiff_t i = 0; i < n; i++) {
        double er[LANES] = {0}, ei[LANES] = {0}, ar[LANES] = {0}, ai[LANES] = {0};
        for (int l = 0; l < live; l++) {
            er[l] = e[l * n + i].re;
            ei[l] = e[l * n + i].im;
            ar[l] = z[l * n + i].re;
            ai[l] = z[l * n + i].im;
        }
        for (int l = 0; l < LANES; l++) {
            s->ee[l] += er[l] * er[l] + ei[l] * ei[l];
            s->zz[l] += ar[l] * ar[l] + ai[l] * ai[l];
            s->zr[l] += ar[l] * er[l] + ai[l] * ei[l];
            s->zi[l] += ar[l] * ei[l] - ai[l] * er[l];
        }
        for (ptrdiff_t j = 0; j < i; j++) {
            double fr[LANES] = {0}, fi[LANES] = {0}, br[LANES] = {0}, bi[LANES] = {0};
            for (int l = 0; l < live; l++) {
                fr[l] = e[l * n + j].re;
                fi[l] = e[l * n + j].im;
                br[l] = z[l * n + j].re;
                bi[l] = z[l * n + j].im;
            }
            for (int l = 0; l < LANES; l++) {
                const double re = (er[l] * br[l] - ei[l] * bi[l]) - (fr[l] * ar[l] - fi[l] * ai[l]);
                const double im = (er[l] * bi[l] + ei[l] * br[l]) - (fr[l] * ai[l] + fi[l] * ar[l]);
                s->d2[l] += re * re + im * im;
            }
        }
    }
}

static inline void s1_group(ptrdiff_t n, int live, const cpx* restrict e, const cpx* restrict z, const double* restrict gamma,
                            double* restrict b1, double* restrict nu, cpx* restrict delta, cpx* restrict w) {
    group_sums s = {{0}, {0}, {0}, {0}, {0}};
    double gg[LANES] = {0}, out_b[LANES], out_n[LANES], out_s[LANES];
    int safe[LANES];
    for (int l = 0; l < live; l++) gg[l] = gamma[l] * gamma[l];
    sums_of_group(n, live, e, z, &s);
    const double *ee = s.ee, *zz = s.zz, *d2 = s.d2, *zr = s.zr, *zi = s.zi;
    for (int l = 0; l < LANES; l++) {
        const double ez = ee[l] * zz[l], gz = gg[l] * zz[l], room = gz - d2[l], ee_g = ee[l] - gg[l];
        const double ze2 = zr[l] * zr[l] + zi[l] * zi[l], aze = sqrt(ze2);
        safe[l] = (ez > tiny) & (ez < huge_) & (zz[l] > tiny) & (zz[l] < huge_) & (gz < huge_) & (gg[l] < huge_) &
                  ((n == 1) | (d2[l] > edge2 * ez)) & (fabs(room) > edge * gz) & (fabs(ee_g) > edge * ee[l]) & (ze2 > edge2 * ez);
        out_b[l] = sqrt(d2[l] / zz[l]);
        out_n[l] = ee_g > 0.0 ? ee_g / (aze + sqrt(room > 0.0 ? room : 0.0)) : 0.0;
        out_s[l] = room < 0.0 ? 0.0 : out_n[l] / aze;
        out_n[l] = room < 0.0 ? INFINITY : out_n[l];
    }
    int all_safe = 1;
    for (int l = 0; l < live; l++) {
        b1[l] = out_b[l];
        nu[l] = out_n[l];
        delta[l] = (cpx){out_s[l] * zr[l], out_s[l] * zi[l]};
        all_safe &= safe[l];
    }
    for (int l = 0; l < live && !all_safe; l++) {
        if (safe[l]) continue;
        const s1_result r = s1_careful(n, e + l * n, z + l * n, gamma[l]);
        b1[l] = r.b1;
        nu[l] = r.nu;
        delta[l] = r.delta;
    }
    for (int l = 0; l < live; l++)
        for (ptrdiff_t i = 0; i < n; i++) {
            const cpx dz = mul(delta[l], z[l * n + i]);
            w[l * n + i] = (cpx){e[l * n + i].re - dz.re, e[l * n + i].im - dz.im};
        }
}

void lpvg_s1(ptrdiff_t points, ptrdiff_t n, const cpx* e, const cpx* z, const double* gamma, double* b1, double* nu, cpx* delta, cpx* w) {
    ptrdiff_t p = 0;
    if (n == 2)                                      /* constant trip counts: the common case becomes straight vector code */
        for (; p + LANES <= points; p += LANES) s1_group(2, LANES, e + 2 * p, z + 2 * p, gamma + p, b1 + p, nu + p, delta + p, w + 2 * p);
    for (; p < points; p += LANES) {
        const int live = (int)(points - p < LANES ? points - p : LANES);
        s1_group(n, live, e + p * n, z + p * n, gamma + p, b1 + p, nu + p, delta + p, w + p * n);
    }
}

static inline void least_group(ptrdiff_t n, int live, const cpx* restrict e, const cpx* restrict z, double* restrict out) {
    group_sums s = {{0}, {0}, {0}, {0}, {0}};
    double found[4][LANES];
    int safe[LANES];
    sums_of_group(n, live, e, z, &s);
    for (int l = 0; l < LANES; l++) {
        const double ez = s.ee[l] * s.zz[l], ze2 = s.zr[l] * s.zr[l] + s.zi[l] * s.zi[l];
        safe[l] =
            (ez > tiny) & (ez < huge_) & (s.zz[l] > tiny) & (s.zz[l] < huge_) & ((n == 1) | (s.d2[l] > edge2 * ez)) & (ze2 > edge2 * ez);
        found[0][l] = sqrt(s.ee[l]);
        found[1][l] = sqrt(s.zz[l]);
        found[2][l] = sqrt(s.d2[l] / s.zz[l]);
        found[3][l] = sqrt(ze2) / s.zz[l];
    }
    for (int l = 0; l < live; l++) {
        for (int k = 0; k < 4; k++) out[4 * l + k] = found[k][l];
        if (!safe[l]) least_careful(n, e + l * n, z + l * n, out + 4 * l);
    }
}

/* |E|, |Z|, B1 and |delta0| of every point: out (points, 4). */
void lpvg_least(ptrdiff_t points, ptrdiff_t n, const cpx* e, const cpx* z, double* out);

void lpvg_least(ptrdiff_t points, ptrdiff_t n, const cpx* e, const cpx* z, double* out) {
    ptrdiff_t p = 0;
    if (n == 2)
        for (; p + LANES <= points; p += LANES) least_group(2, LANES, e + 2 * p, z + 2 * p, out + 4 * p);
    for (; p < points; p += LANES) least_group(n, (int)(points - p < LANES ? points - p : LANES), e + p * n, z + p * n, out + 4 * p);
}

/* ---- margin: weighted 1-centre of discs |E_k - delta Z_k| <= t B_k; disc 0 is |delta| <= t W (E = 0, Z = 1). ---- */

typedef struct {
    cpx e, z;
    double b, az;
} disc;

/* a b - c d; *lost counts the differences that cancel so far that they must be formed with care. */
static inline cpx cross(cpx a, cpx b, cpx c, cpx d, int careful, int* lost) {
    const cpx x = mul(a, b), y = mul(c, d), z = {x.re - y.re, x.im - y.im};
    if (!careful) {
        *lost |= abs2(z) < 1e-6 * (abs2(x) + abs2(y));
        return z;
    }
    dd out[2];
    dd_cross(a, b, c, d, out);
    return (cpx){out[0].hi, out[1].hi};
}

static inline double pair_t(disc i, disc j, int careful, int* lost) {
    return cabs_(cross(i.e, j.z, j.e, i.z, careful, lost)) / (i.b * j.az + j.b * i.az);
}

/* Level at which disc k reaches the one point that discs i and j share at their own level. */
static inline double reach(disc i, disc j, disc k) {
    const double den = i.b * j.az + j.b * i.az;
    const cpx si = scale(conj_mul(i.z, i.e), j.b / (i.az * den)), sj = scale(conj_mul(j.z, j.e), i.b / (j.az * den));
    const cpx delta = {si.re + sj.re, si.im + sj.im}, dz = mul(delta, k.z);
    return cabs_((cpx){k.e.re - dz.re, k.e.im - dz.im}) / k.b;
}

/* Smallest t at which three discs meet in one point, from the residual u of the first: |u| = t B_i,
 * |D_j + u Z_j| = t B_j |Z_i|, D_j = E_j Z_i - E_i Z_j. Both differences from |u|^2 are linear in u, with right-hand
 * side Re(conj(g) u); t^2 is then the smaller root of a quadratic. NaN when two discs are concentric: a pair decides. */
static inline double triple(disc i, disc j, disc k, int careful, int* lost) {
    const cpx dj = cross(j.e, i.z, i.e, j.z, careful, lost), dk = cross(k.e, i.z, i.e, k.z, careful, lost);
    const cpx gj = conj_mul(j.z, dj), gk = conj_mul(k.z, dk);
    const double nj = 1.0 / cabs_(gj), nk = 1.0 / cabs_(gk);
    const cpx a = scale(gj, nj), b = scale(gk, nk);
    const double pj = -0.5 * abs2(dj) * nj, pk = -0.5 * abs2(dk) * nk;
    const double qj = 0.5 * (j.b * i.az - i.b * j.az) * (j.b * i.az + i.b * j.az) * nj;
    const double qk = 0.5 * (k.b * i.az - i.b * k.az) * (k.b * i.az + i.b * k.az) * nk;
    const double det = a.re * b.im - a.im * b.re;
    const cpx u0 = {pj * b.im - pk * a.im, a.re * pk - b.re * pj};
    const cpx u1 = {qj * b.im - qk * a.im, a.re * qk - b.re * qj};
    const double db2 = det * det * i.b * i.b, uu = abs2(u0), pq = sqrt(uu * abs2(u1));
    const cpx c = conj_mul(u0, u1);
    const double less = c.im * c.im / (pq + fabs(c.re)), more = pq + fabs(c.re);
    const double minus = c.re > 0.0 ? -less : -more;   /* Re - |..| and Re + |..|, without cancellation */
    const double plus = c.re > 0.0 ? more : less;
    const double disc_ = (2.0 * minus - db2) * (2.0 * plus - db2);
    return sqrt(2.0 * uu / (db2 - 2.0 * c.re + sqrt(disc_ > 0.0 ? disc_ : 0.0)));
}

static inline disc pick(int first, disc a, disc b) {
    return (disc){{first ? a.e.re : b.e.re, first ? a.e.im : b.e.im},
                  {first ? a.z.re : b.z.re, first ? a.z.im : b.z.im},
                  first ? a.b : b.b,
                  first ? a.az : b.az};
}

static inline double margin_of_three(disc d0, disc d1, disc d2, int careful, int* lost) {
    const double t01 = pair_t(d0, d1, careful, lost), t02 = pair_t(d0, d2, careful, lost), t12 = pair_t(d1, d2, careful, lost);
    const int last0 = (t12 >= t01) & (t12 >= t02), last1 = !last0 & (t02 >= t01);   /* the disc outside the worst pair */
    const disc i = pick(last0, d1, d0), j = pick(last0 | last1, d2, d1), k = pick(last0, d0, pick(last1, d1, d2));
    const double t = last0 ? t12 : last1 ? t02 : t01;
    const double above = reach(i, j, k), joint = triple(i, j, k, careful, lost);
    const double bounded = joint > t ? (joint < above ? joint : above) : t;   /* also when nearly collinear, or NaN */
    return above > t ? bounded : t;
}

#define MAX_DISCS 65

static double margin_point(ptrdiff_t n, const cpx* e, const cpx* z, double w_delta, const double* w_w) {
    disc d[MAX_DISCS];
    double best = 0.0, sum = w_delta;
    int m = 1, lost = 0;
    d[0] = (disc){{0.0, 0.0}, {1.0, 0.0}, w_delta, 1.0};
    for (ptrdiff_t i = 0; i < n; i++) {
        const disc o = {e[i], z[i], w_w[i], cabs_(z[i])};
        sum += o.e.re + o.e.im + o.z.re + o.z.im + o.b;
        if (o.az > 0.0)
            d[m++] = o;
        else
            best = fmax(best, cabs_(o.e) / o.b);   /* Z = 0: delta has no part in it */
    }
    if (m == 2) best = fmax(best, pair_t(d[0], d[1], 1, &lost));
    for (int i = 0; i < m; i++)
        for (int j = i + 1; j < m; j++)
            for (int k = j + 1; k < m; k++) best = fmax(best, margin_of_three(d[i], d[j], d[k], 1, &lost));
    return isfinite(sum) ? best : NAN;
}

/* Two outputs, the common case: LANES points as vector code; those that cancel or hold a zero are done again. */
static void margin_group_of_two(const cpx* e, const cpx* z, const double* w_delta, const double* w_w, double* t) {
    double f[10][LANES];
    int lost[LANES];
    for (int l = 0; l < LANES; l++) {
        f[0][l] = e[2 * l].re, f[1][l] = e[2 * l].im, f[2][l] = z[2 * l].re, f[3][l] = z[2 * l].im, f[4][l] = w_w[2 * l];
        f[5][l] = e[2 * l + 1].re, f[6][l] = e[2 * l + 1].im, f[7][l] = z[2 * l + 1].re, f[8][l] = z[2 * l + 1].im;
        f[9][l] = w_w[2 * l + 1];
    }
    for (int l = 0; l < LANES; l++) {
        const cpx z1 = {f[2][l], f[3][l]}, z2 = {f[7][l], f[8][l]};
        const disc d0 = {{0.0, 0.0}, {1.0, 0.0}, w_delta[l], 1.0};
        const disc d1 = {{f[0][l], f[1][l]}, z1, f[4][l], cabs_(z1)}, d2 = {{f[5][l], f[6][l]}, z2, f[9][l], cabs_(z2)};
        int cancels = 0;
        const double value = margin_of_three(d0, d1, d2, 0, &cancels);
        const double size = abs2(d1.e) * d1.az + abs2(d2.e) * d2.az;
        lost[l] = cancels | !(value > 0.0) | !(value < huge_) | !(d1.az * d2.az > tiny) | !(size < huge_) | !(size > tiny);
        t[l] = value;
    }
    for (int l = 0; l < LANES; l++)
        if (lost[l]) t[l] = margin_point(2, e + 2 * l, z + 2 * l, w_delta[l], w_w + 2 * l);
}

void lpvg_margin(ptrdiff_t points, ptrdiff_t n, const cpx* e, const cpx* z, const double* w_delta, const double* w_w, double* t) {
    ptrdiff_t p = 0;
    if (n == 2)
        for (; p + LANES <= points; p += LANES) margin_group_of_two(e + 2 * p, z + 2 * p, w_delta + p, w_w + 2 * p, t + p);
    for (; p < points; p++) t[p] = margin_point(n, e + p * n, z + p * n, w_delta[p], w_w + p * n);
}
