"""Class S1: E = delta Z + w at every bin, one complex scalar delta common to all n_y outputs (T4).

E is the windowed DFT of the nominal error, and Z that of the nominal output. Both are ``(..., n_y)`` complex
in the outputs' own units. Every other argument broadcasts against the leading shape. The closed forms are
exact to rounding. The usual forms lose digits for delta0 -> nu, gamma_w -> B1, gamma_w -> abs(E) and for E
parallel to Z. Differences of nearly equal products are therefore formed in double-double arithmetic
(base/_native/s1.c).

With delta0 = Z^H E / Z^H Z (the least-squares scalar) and, by Lagrange's identity,

    B1^2  = sum_{i<j} |E_i Z_j - E_j Z_i|^2 / |Z|^2             smallest disturbance, right side of (9)
    rho^2 = (gamma_w^2 - B1^2) / |Z|^2                          |delta - delta0| <= rho explains the point
    nu    = (|E|^2 - gamma_w^2) / (|Z|^2 (|delta0| + rho))      = |delta0| - rho without its cancellation
"""

import ctypes
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from lpvguard.base import native
from lpvguard.base.errors import InputError


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


def _points(source: str, e, z, *extra: tuple[str, object, bool]):
    """The leading shape, then contiguous arrays: complex (points, n_y) and real (points[, n_y])."""
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
    S1Result, with the optimal delta and w

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
    b1, nu, delta, w = np.empty(points), np.empty(points), np.empty(points, complex), np.empty_like(e)
    sizes = map(ctypes.c_ssize_t, (points, n))
    native.kernels("s1").lpvg_s1(*sizes, *map(native.pointer, (e, z, gamma, b1, nu, delta, w)))
    feasible = np.isfinite(nu)
    return S1Result(
        b1.reshape(shape),
        feasible.reshape(shape),
        nu.reshape(shape),
        delta.reshape(shape),
        w.reshape(*shape, n),
    )


class LeastSquares(NamedTuple):
    """Least-squares results at every point, in the leading shape of E.

    Attributes
    ----------
    e, z, b1 : ndarray (...), |E|, |Z| and the smallest disturbance B1 [output units]
    delta : ndarray (...), |delta0|
    """

    e: np.ndarray
    z: np.ndarray
    b1: np.ndarray
    delta: np.ndarray


def least(e, z) -> LeastSquares:
    """Compute |E|, |Z|, B1 and |delta0|, see `solve` and `least_squares_delta`.

    Parameters
    ----------
    e, z : array_like (..., n_y) of complex, output units

    Returns
    -------
    LeastSquares, NaN where an input is not finite
    """
    shape, e, z = _points("S1", e, z)
    out = np.empty((len(e), 4))
    native.kernels("s1").lpvg_least(*map(ctypes.c_ssize_t, e.shape), *map(native.pointer, (e, z, out)))
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
    """Result at every point: J of (8) as ``cost``, nu = |delta|, and the optimal delta and w.

    The shapes are those of :class:`S1Result`. ``cost`` and ``nu`` are inf where gamma_w < B1.
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
    # Near the target the formula with the centre loses digits. The step is then the smallest delta that
    # explains the error that the target leaves.
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


MAX_OUTPUTS = 64
"""Largest number of outputs of the compiled margin, which has an array of this size on its stack."""


def margin(e, z, w_delta, w_w) -> np.ndarray:
    """Compute the on-line margin: the least t with |delta_j| <= t W_delta,j, |E_j - delta_j Z_j| <= t W_w,j.

    With n_delta = 1 all outputs share one delta, which gives a weighted 1-centre problem of n_y + 1 discs. By
    Helly's theorem the largest t of all problems with three discs is its solution. A pair of discs or the
    smaller root of a quadratic equation solves each problem with three discs. With n_delta = n_y each output
    has a separate delta, and t is the largest |E_j| / (W_w,j + W_delta,j |Z_j|). If t > 1, no complex delta
    and w within the bounds explain the frame. A causal Delta with memory may still explain it
    (tools/README.md).

    Parameters
    ----------
    e, z : array_like (..., n_y) of complex, output units
    w_delta : array_like (..., n_delta) or float, >= 0
    w_w : array_like (..., n_y), > 0, output units

    Returns
    -------
    ndarray (...), NaN where an input is not finite

    Raises
    ------
    InputError
        If shapes do not fit, W_delta is negative, W_w is not positive, or more than 64 outputs share a delta.

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
    if n > MAX_OUTPUTS:
        raise InputError("margin", "E, Z", f"{n} outputs", f"at most {MAX_OUTPUTS} with a common delta")
    t = np.empty(len(e))
    sizes = map(ctypes.c_ssize_t, (len(e), n))
    native.kernels("s1").lpvg_margin(*sizes, *map(native.pointer, (e, z, w_delta, w_w, t)))
    return t.reshape(shape)
