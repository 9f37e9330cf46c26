"""Class S1: E = delta Z + w at every bin, one complex scalar delta common to all n_y outputs (T4).

E is the windowed DFT of the nominal error, Z of the nominal output. Both are ``(..., n_y)`` complex in the
outputs' own units. Every other argument broadcasts against the leading shape. The closed forms are exact to
rounding. The usual formulas lose digits for delta0 -> nu, gamma_w -> B1, gamma_w -> abs(E) and for E parallel
to Z. Differences of nearly equal products are therefore formed in double-double arithmetic. The compiled
kernels and the numpy versions agree to 1e-13 relative. Margins agree to 1e-11. They agree to 1e-6 if the
outputs' Z lie decades apart, because the common point of three discs is then a small difference.

With delta0 = Z^H E / Z^H Z (the least-squares scalar) and, by Lagrange's identity,

    B1^2  = sum_{i<j} |E_i Z_j - E_j Z_i|^2 / |Z|^2             smallest disturbance, right side of (9)
    rho^2 = (gamma_w^2 - B1^2) / |Z|^2                          |delta - delta0| <= rho explains the point
    nu    = (|E|^2 - gamma_w^2) / (|Z|^2 (|delta0| + rho))      = |delta0| - rho without its cancellation
"""

import ctypes
from dataclasses import dataclass
from itertools import combinations
from typing import NamedTuple

import numpy as np

from lpvguard.base import native
from lpvguard.base.errors import InputError

EDGE_TOLERANCE = 2e-12
"""gamma_w^2 may lie below B1^2 by this much, relative: a gamma_w that *is* the B1 returned here stays
feasible."""


@dataclass(frozen=True)
class S1Result:
    """Explanation of every point in class S1.

    All values are NaN where an input was not finite.

    Attributes
    ----------
    b1 : ndarray (...), smallest disturbance [output units]
    feasible : ndarray (...) of bool, False where gamma_w < B1
    nu : ndarray (...), |delta|, inf where not feasible
    delta : ndarray (...) of complex
    w : ndarray (..., n_y) of complex, output units
    """

    b1: np.ndarray
    feasible: np.ndarray
    nu: np.ndarray
    delta: np.ndarray
    w: np.ndarray


def _two_sum(a, b):
    s = a + b
    v = s - a
    return s, (a - (s - v)) + (b - v)


def _two_prod(a, b):
    p = a * b
    ah = 134217729.0 * a
    ah = ah - (ah - a)
    bh = 134217729.0 * b
    bh = bh - (bh - b)
    al, bl = a - ah, b - bh
    return p, ((ah * bh - p) + ah * bl + al * bh) + al * bl


def _dd_add(x, y):
    s, t = _two_sum(x[0], y[0])
    t = t + (x[1] + y[1])
    hi = s + t
    return hi, t - (hi - s)


def _dd_mul(x, y):
    p, t = _two_prod(x[0], y[0])
    return p, t + (x[0] * y[1] + x[1] * y[0])


def _dd_dot(pairs):
    """Sum of products a b over ``pairs`` in double-double."""
    total = None
    for a, b in pairs:
        term = _two_prod(a, b)
        total = term if total is None else _dd_add(total, term)
    return total


def _dd_cross(a, b, c, d):
    """Real and imaginary part of a b - c d, each as a double-double pair."""
    re = _dd_dot([(a.real, b.real), (-c.real, d.real), (-a.imag, b.imag), (c.imag, d.imag)])
    im = _dd_dot([(a.real, b.imag), (-c.real, d.imag), (a.imag, b.real), (-c.imag, d.real)])
    return re, im


def _exponent(values: np.ndarray) -> np.ndarray:
    """Exponent of the power of two just above the largest magnitude over the last axis; 0 if all are zero."""
    return np.frexp(np.max(values, axis=-1))[1]


def _s1_numpy(e: np.ndarray, z: np.ndarray, gamma: np.ndarray):
    n = e.shape[-1]
    bad = ~(np.isfinite(e).all(-1) & np.isfinite(z).all(-1) & np.isfinite(gamma))
    e, z, gamma = np.where(bad[:, None], 0.0, e), np.where(bad[:, None], 0.0, z), np.where(bad, 0.0, gamma)
    ke = _exponent(np.concatenate([abs(e.real), abs(e.imag), gamma[:, None]], axis=-1))
    kz = _exponent(np.concatenate([abs(z.real), abs(z.imag)], axis=-1))
    es = np.ldexp(e.real, -ke[:, None]) + 1j * np.ldexp(e.imag, -ke[:, None])
    zs = np.ldexp(z.real, -kz[:, None]) + 1j * np.ldexp(z.imag, -kz[:, None])
    g = np.ldexp(gamma, -ke)
    ei, zi = [es[:, i] for i in range(n)], [zs[:, i] for i in range(n)]
    gg = _two_prod(g, g)
    ee = _dd_dot([(x, x) for i in range(n) for x in (ei[i].real, ei[i].imag)])
    zz = _dd_dot([(x, x) for i in range(n) for x in (zi[i].real, zi[i].imag)])
    ze_re = _dd_dot([pair for i in range(n) for pair in ((zi[i].real, ei[i].real), (zi[i].imag, ei[i].imag))])
    ze_im = _dd_dot(
        [pair for i in range(n) for pair in ((zi[i].real, ei[i].imag), (-zi[i].imag, ei[i].real))]
    )
    d2 = (np.zeros_like(g), np.zeros_like(g))
    for i, j in combinations(range(n), 2):
        for part in _dd_cross(ei[i], zi[j], ei[j], zi[i]):
            d2 = _dd_add(d2, _dd_mul(part, part))
    ee_g = _dd_add(ee, (-gg[0], -gg[1]))[0]
    room_scale = _dd_mul(gg, zz)
    room = _dd_add(room_scale, (-d2[0], -d2[1]))[0]
    no_z = zz[0] == 0.0
    infeasible = np.where(no_z, ee_g > EDGE_TOLERANCE * gg[0], room < -EDGE_TOLERANCE * room_scale[0])
    with np.errstate(divide="ignore", invalid="ignore"):
        b1 = np.where(no_z, np.sqrt(ee[0]), np.sqrt(d2[0] / zz[0]))
        ze = ze_re[0] + 1j * ze_im[0]
        # Near the edge delta is delta0; ee_g / |ze| holds the part of gamma_w^2 below B1^2.
        nu = np.where(room > 0.0, ee_g / (abs(ze) + np.sqrt(room)), abs(ze) / zz[0])
        nu = np.where((ee_g <= 0.0) | no_z, 0.0, nu)
        nu = np.where(infeasible, np.inf, nu)
        delta = np.where(~infeasible & (ze != 0.0), nu * (ze / abs(ze)), 0.0)
    scale = ke - kz
    delta = np.ldexp(delta.real, scale) + 1j * np.ldexp(delta.imag, scale)
    nan = np.where(bad, np.nan, 0.0)
    return np.ldexp(b1, ke) + nan, np.ldexp(nu, scale) + nan, delta + nan


def _points(source: str, e, z, *extra: tuple[str, object, bool]):
    """Broadcast to contiguous arrays (points, n_y) complex and (points[, n_y]) real; also return the
    shape."""
    e, z = np.asarray(e, dtype=complex), np.asarray(z, dtype=complex)
    if e.ndim == 0 or z.ndim == 0 or e.shape[-1] != z.shape[-1] or e.shape[-1] == 0:
        raise InputError(source, "E, Z", f"shapes {e.shape} and {z.shape}", "(..., n_y) both, n_y >= 1")
    n = e.shape[-1]
    arrays = []
    for name, value, per_output in extra:
        a = np.asarray(value, dtype=float)
        if per_output and (a.ndim == 0 or a.shape[-1] != n):
            raise InputError(source, name, f"shape {a.shape}", f"(..., {n}), one per output")
        if np.any(a < 0.0):
            raise InputError(source, name, f"{np.min(a):g}", "numbers that are not negative")
        arrays.append(a)
    leads = [a.shape[:-1] if per else a.shape for a, (_, _, per) in zip(arrays, extra, strict=True)]
    try:
        shape = np.broadcast_shapes(e.shape[:-1], z.shape[:-1], *leads)
    except ValueError:
        raise InputError(
            source, "shapes", f"{e.shape}, {z.shape}, {leads}", "shapes that broadcast"
        ) from None
    count = int(np.prod(shape))

    def flat(a, tail):
        return np.ascontiguousarray(np.broadcast_to(a, (*shape, *tail))).reshape(count, *tail)

    out = [flat(a, (n,) if per else ()) for a, (_, _, per) in zip(arrays, extra, strict=True)]
    return shape, flat(e, (n,)), flat(z, (n,)), *out


def solve(e, z, gamma_w) -> S1Result:
    """Find the smallest |delta| with ||E - delta Z||_2 <= gamma_w at every point.

    The compiled version takes about 20 ns per point.

    Parameters
    ----------
    e, z : array_like (..., n_y) of complex, output units
    gamma_w : array_like (...), >= 0, output units

    Returns
    -------
    S1Result, with the delta and w that attain it

    Raises
    ------
    InputError
        If shapes do not fit, or gamma_w is negative.

    References
    ----------
    Paper, step 5; THEORY 4.1, (T4), (T5).
    """
    shape, e, z, gamma = _points("S1", e, z, ("gamma_w", gamma_w, False))
    points, n = e.shape
    lib = native.kernels("s1")
    if lib is None:
        b1, nu, delta = _s1_numpy(e, z, gamma)
        w = e - delta[:, None] * z
    else:
        b1, nu, delta, w = (
            np.empty(points),
            np.empty(points),
            np.empty(points, dtype=complex),
            np.empty_like(e),
        )
        size = ctypes.c_ssize_t
        lib.lpvg_s1(size(points), size(n), *map(native.pointer, (e, z, gamma, b1, nu, delta, w)))
    feasible = np.isfinite(nu)
    return S1Result(
        b1.reshape(shape),
        feasible.reshape(shape),
        nu.reshape(shape),
        delta.reshape(shape),
        w.reshape(*shape, n),
    )


class LeastSquares(NamedTuple):
    """Least-squares quantities per point, in the leading shape of E.

    Attributes
    ----------
    e, z, b1 : ndarray (...), |E|, |Z| and the smallest disturbance B1 [output units]
    delta : ndarray (...), |delta0|
    """

    e: np.ndarray
    z: np.ndarray
    b1: np.ndarray
    delta: np.ndarray


def _size(x: np.ndarray) -> np.ndarray:
    scale = np.max(np.abs(x), axis=-1)
    unit = np.divide(x, scale[:, None], out=np.zeros_like(x), where=scale[:, None] > 0)
    return np.linalg.norm(unit, axis=-1) * scale


def least(e, z) -> LeastSquares:
    """Compute |E|, |Z|, B1 and |delta0| as in `solve` and `least_squares_delta`.

    Parameters
    ----------
    e, z : array_like (..., n_y) of complex, output units

    Returns
    -------
    LeastSquares, NaN where an input is not finite
    """
    shape, e, z = _points("S1", e, z)
    lib = native.kernels("s1")
    if lib is None:
        with np.errstate(invalid="ignore"):
            size_e, size_z = map(_size, (e, z))
            columns = [size_e, size_z, _s1_numpy(e, z, size_e)[0], np.abs(least_squares_delta(e, z))]
        out = np.stack(columns, axis=-1)
        out[~(np.isfinite(e) & np.isfinite(z)).all(axis=-1)] = np.nan
    else:
        out = np.empty((len(e), 4))
        lib.lpvg_least(*map(ctypes.c_ssize_t, e.shape), *map(native.pointer, (e, z, out)))
    return LeastSquares(*np.moveaxis(out.reshape(*shape, 4), -1, 0))


def least_squares_delta(e, z) -> np.ndarray:
    """Compute delta0 = Z^H E / |Z|^2, the scalar with the smallest disturbance.

    Parameters
    ----------
    e, z : array_like (..., n_y) of complex, output units

    Returns
    -------
    ndarray (...) of complex, 0 where Z = 0
    """
    e, z = np.asarray(e, dtype=complex), np.asarray(z, dtype=complex)
    scale = np.max(np.abs(z), axis=-1, keepdims=True)
    unit = np.divide(z, scale, out=np.zeros_like(z), where=scale > 0.0)
    zz = np.sum(np.abs(unit) ** 2, axis=-1)
    ze = np.sum(np.conj(unit) * e, axis=-1)
    return np.divide(ze, zz * scale[..., 0], out=np.zeros_like(ze), where=zz > 0.0)


@dataclass(frozen=True)
class TradeoffResult:
    """Result per point: J of (8) as ``cost``, nu = |delta|, and the delta and w that attain it.

    Shapes as in :class:`S1Result`. ``cost`` and ``nu`` are inf where gamma_w < B1.
    """

    cost: np.ndarray
    nu: np.ndarray
    delta: np.ndarray
    w: np.ndarray


def tradeoff(e, z, gamma_w, lambda_nu, lambda_w) -> TradeoffResult:
    """Minimise (8): lambda_nu nu^2 + sum_j lambda_w,j |w_j|^2 subject to |w| <= gamma_w.

    The cost is an isotropic quadratic function of delta. Its minimiser is therefore the unconstrained
    minimiser, projected on the disc of explanations.

    Parameters
    ----------
    e, z : array_like (..., n_y) of complex, output units
    gamma_w : array_like (...), >= 0, output units
    lambda_nu : array_like (...), >= 0
    lambda_w : array_like (..., n_y), >= 0

    Returns
    -------
    TradeoffResult

    Raises
    ------
    InputError
        If shapes do not fit, or a value is negative.

    References
    ----------
    Paper, (8).
    """
    base = solve(e, z, gamma_w)
    shape, e, z, gamma, lam, lam_w = _points(
        "S1 trade-off",
        e,
        z,
        ("gamma_w", gamma_w, False),
        ("lambda_nu", lambda_nu, False),
        ("lambda_w", lambda_w, True),
    )
    curvature = lam + np.sum(lam_w * np.abs(z) ** 2, axis=-1)
    target = np.divide(
        np.sum(lam_w * np.conj(z) * e, axis=-1),
        curvature,
        out=np.zeros(len(e), complex),
        where=curvature > 0.0,
    )
    centre = least_squares_delta(e, z)
    b1, zz = base.b1.ravel(), np.sum(np.abs(z) ** 2, axis=-1)
    slack = np.maximum((gamma - b1) * (gamma + b1), 0.0)
    radius = np.sqrt(np.divide(slack, zz, out=np.full(len(e), np.inf), where=zz > 0.0))
    offset = target - centre
    distance = np.abs(offset)
    outside = distance > radius
    pull = np.divide(radius, distance, out=np.ones(len(e)), where=outside)
    delta = np.where(outside, centre + pull * offset, target)
    # Close to the target the centre would lose digits: the step is the smallest delta that explains what the
    # target leaves.
    near = outside & (distance < 2.0 * radius)
    rest = solve(e[near] - target[near, None] * z[near], z[near], gamma[near])
    delta[near] = np.where(rest.feasible, target[near] + rest.delta, delta[near])
    w = e - delta[:, None] * z
    infeasible = ~base.feasible.ravel()
    cost = np.where(infeasible, np.inf, lam * np.abs(delta) ** 2 + np.sum(lam_w * np.abs(w) ** 2, axis=-1))
    nu = np.where(infeasible, np.inf, np.abs(delta))
    return TradeoffResult(
        cost.reshape(shape), nu.reshape(shape), delta.reshape(shape), w.reshape(*shape, e.shape[-1])
    )


def _np_cross(a, b, c, d):
    re, im = _dd_cross(a, b, c, d)
    return re[0] + 1j * im[0]


def _pair(i, j):
    """Level at which two discs touch; a disc is (E, Z, B, |Z|) with arrays over points."""
    return np.abs(_np_cross(i[0], j[1], j[0], i[1])) / (i[2] * j[3] + j[2] * i[3])


def _reach(i, j, k):
    """Level at which disc k contains the single point that discs i and j share when they touch."""
    den = i[2] * j[3] + j[2] * i[3]
    delta = np.conj(i[1]) * i[0] * (j[2] / (i[3] * den)) + np.conj(j[1]) * j[0] * (i[2] / (j[3] * den))
    return np.abs(k[0] - delta * k[1]) / k[2]


def _triple(i, j, k):
    """Smallest level at which three discs meet in one point, or NaN (derivation: base/_native/s1.c)."""
    rows = []
    for o in (j, k):
        d = _np_cross(o[0], i[1], i[0], o[1])
        g = np.conj(o[1]) * d
        norm = np.abs(g)
        br, bi = o[2] * i[3], i[2] * o[3]
        rows.append((g / norm, -0.5 * np.abs(d) ** 2 / norm, 0.5 * (br - bi) * (br + bi) / norm))
    (a0, p0, q0), (a1, p1, q1) = rows
    det = a0.real * a1.imag - a0.imag * a1.real
    u0 = (p0 * a1.imag - p1 * a0.imag) + 1j * (a0.real * p1 - a1.real * p0)
    u1 = (q0 * a1.imag - q1 * a0.imag) + 1j * (a0.real * q1 - a1.real * q0)
    db2, uu = det**2 * i[2] ** 2, np.abs(u0) ** 2
    pq = np.abs(u0) * np.abs(u1)
    c = np.conj(u0) * u1
    minus = c.real - pq  # if this loses digits, db2 is at least twice the other root, or there is no level
    plus = np.where(c.real < 0.0, c.imag**2 / (pq - c.real), c.real + pq)
    half = db2 - 2.0 * c.real + np.sqrt(np.maximum((2.0 * minus - db2) * (2.0 * plus - db2), 0.0))
    return np.sqrt(2.0 * uu / half)


def _margin_numpy(e, z, w_delta, w_w):
    n = e.shape[-1]
    ones = np.ones(len(e), dtype=complex)
    discs = [(0.0 * ones, ones, w_delta, ones.real)]
    discs += [(e[:, k], z[:, k], w_w[:, k], np.abs(z[:, k])) for k in range(n)]
    best = np.zeros(len(e))
    with np.errstate(divide="ignore", invalid="ignore"):
        for i, j in combinations(range(n + 1), 2):
            # A disc with Z = 0 is the whole plane or empty, and its pairs have the level of this disc.
            best = np.fmax(best, _pair(discs[i], discs[j]))
        for trio in combinations(range(n + 1), 3):
            d = [discs[m] for m in trio]
            levels = np.stack([_pair(d[0], d[1]), _pair(d[0], d[2]), _pair(d[1], d[2])])
            worst = np.argmax(levels, axis=0)
            order = [(0, 1, 2), (0, 2, 1), (1, 2, 0)]
            first, second, third = (
                tuple(np.choose(worst, [d[o[slot]][field] for o in order]) for field in range(4))
                for slot in range(3)
            )
            # If the third disc contains the point of the worst pair, this is at most the level of that pair.
            joint = np.minimum(_reach(first, second, third), _triple(first, second, third))
            best = np.fmax(best, joint)  # NaN for Z = 0, and if the third disc never leaves the first one
    finite = np.isfinite(e).all(-1) & np.isfinite(z).all(-1) & np.isfinite(w_delta) & np.isfinite(w_w).all(-1)
    return np.where(finite, best, np.nan)


MAX_OUTPUTS = 64
"""Largest number of outputs for the compiled margin (a fixed array on its stack)."""


def margin(e, z, w_delta, w_w) -> np.ndarray:
    """Compute the on-line margin: the least t with |delta_j| <= t W_delta,j, |E_j - delta_j Z_j| <= t W_w,j.

    With n_delta = 1 all outputs share one delta: this is a weighted 1-centre problem of n_y + 1 discs. By
    Helly's theorem its solution is the worst of all problems of three discs. Each of these is a pair of
    discs, or the smaller root of a quadratic equation. With n_delta = n_y each output has a separate delta,
    and t is the largest |E_j| / (W_w,j + W_delta,j |Z_j|). If t > 1, no complex delta and w within the bounds
    explain the frame. A causal Delta with memory may still explain it (tools/README.md).

    Parameters
    ----------
    e, z : array_like (..., n_y) of complex, output units
    w_delta : array_like (..., n_delta), >= 0, a number for (1,)
    w_w : array_like (..., n_y), > 0, output units

    Returns
    -------
    ndarray (...), NaN where an input is not finite

    Raises
    ------
    InputError
        If shapes do not fit, W_delta is negative, or W_w is not positive.

    References
    ----------
    THEORY 7.1, (T17).
    """
    n = np.shape(e)[-1] if np.ndim(e) else 0
    w_delta = np.atleast_1d(np.asarray(w_delta, float))
    if w_delta.shape[-1] not in (1, n):
        raise InputError("margin", "W_delta", f"shape {w_delta.shape}", f"(..., 1) or (..., {n})")
    if n > 1 and w_delta.shape[-1] == n:
        shape, e, z, w_delta, w_w = _points("margin", e, z, ("W_delta", w_delta, True), ("W_w", w_w, True))
    else:
        shape, e, z, w_delta, w_w = _points(
            "margin", e, z, ("W_delta", w_delta[..., 0], False), ("W_w", w_w, True)
        )
    if np.any(w_w == 0.0):
        raise InputError("margin", "W_w", "0", "positive numbers")
    if w_delta.ndim > 1:
        t = (np.abs(e) / (w_w + w_delta * np.abs(z))).max(axis=-1)
        finite = np.isfinite(e) & np.isfinite(z) & np.isfinite(w_delta) & np.isfinite(w_w)
        return np.where(finite.all(axis=-1), t, np.nan).reshape(shape)
    points = len(e)
    lib = native.kernels("s1")
    if lib is None or n > MAX_OUTPUTS:
        return _margin_numpy(e, z, w_delta, w_w).reshape(shape)
    t = np.empty(points)
    size = ctypes.c_ssize_t
    lib.lpvg_margin(size(points), size(n), *map(native.pointer, (e, z, w_delta, w_w, t)))
    return t.reshape(shape)
