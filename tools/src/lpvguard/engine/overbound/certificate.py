"""Prove that a weight lies above a bound, from the weight's coefficients alone (T10).

A grid proves nothing between its points, so the proof treats one piece of the bound after the other. With y =
w^2, |W|^2 = N(y)/D(y) for polynomials N and D. On one piece bound^2 = c y^q with a real q, which is not a
polynomial. However, y^q is convex (q <= 0 or q >= 1) or concave (0 < q < 1). A straight line L therefore lies
above bound^2 on [a, b]: the chord if it is convex, a tangent if it is concave.

N - r^2 L D is then a polynomial. If all its Bernstein coefficients on [a, b] are >= 0, the polynomial is >=
0, because it is a convex combination of them. Then |W| >= r bound on [a, b]. If a coefficient is negative,
the interval is halved. L and the Bernstein coefficients converge quadratically, so the search ends. [0, w_1]
is a piece with q = 0; [w_K, inf) becomes such a piece in 1/y.

The coefficients of N and D follow from those of W in rational arithmetic. All other rounding errors are
subtracted, except one rounding of the frequency. A proved ratio is 5e-10 below the attained ratio, so a
weight that only touches its bound is not accepted. Routh's array in rational arithmetic decides stability and
minimum phase. The same search with N and D exchanged bounds the worst ratio from above.
"""

import math
from collections.abc import Callable
from dataclasses import asdict, dataclass
from fractions import Fraction
from functools import cache

import numpy as np
from numpy.typing import ArrayLike

from .bound import SampledBound
from .weight import Weight

_PROOF_MARGIN = 1e-9
"""Relative distance, on |W|^2, of a proved ratio below the attained ratio."""

_PATIENCE = 18
"""After this number of halvings, each further one multiplies the margin by four, because rounding stops the
proof."""

_MAX_HALVINGS = 28
_MAX_TESTS = 300_000
_ROUNDING = 1e-13
"""Bound of the rounding of exp, log and the Bernstein coefficients, relative to sum |c_i| y^i."""


@dataclass(frozen=True)
class Certificate:
    """Proved properties of a weight and a bound.

    Attributes
    ----------
    ok, stable, minimum_phase : bool
    min_ratio, max_ratio : float, min_ratio <= |W|/bound <= max_ratio for all 0 <= w <= omega_max
    min_ratio_at, max_ratio_at : float, rad/s, frequencies that attain the ratios within 1e-9
    omega_max : float, rad/s, inf, or the last sample if W is strictly proper
    intervals : int, number of Bernstein tests
    without_data : tuple of float, rad/s, frequencies of NaN samples, over which the bound is interpolated
    """

    ok: bool
    stable: bool
    minimum_phase: bool
    min_ratio: float
    min_ratio_at: float
    max_ratio: float
    max_ratio_at: float
    omega_max: float
    intervals: int
    without_data: tuple[float, ...]

    def to_dict(self) -> dict:
        """Convert the fields to JSON types; an infinite frequency becomes the string "inf"."""
        plain = asdict(self) | {"without_data": list(self.without_data)}
        return {k: "inf" if v == math.inf else v for k, v in plain.items()}


def verify_overbound(
    weight: Weight, omega: ArrayLike, bound: ArrayLike, *, floor: float | None = None, name: str = ""
) -> Certificate:
    """Prove or refute |W| >= bound from the coefficients of W alone, independent of the fit.

    Parameters
    ----------
    weight : Weight
    omega : array_like (K,), rad/s
    bound : array_like (K,), unit of the weighted signal
    floor : float, optional, replaces smaller bounds
    name : str, name of the bound in messages, default ''

    Returns
    -------
    Certificate, whose ``ok`` means that W is stable, minimum-phase and above the bound

    Raises
    ------
    InputError
        If the samples are not a valid bound.

    References
    ----------
    THEORY 5.3, (T10).
    """
    samples = SampledBound.read(name or "weight check", omega, bound, floor)
    strict = weight.num.size < weight.den.size
    stable, minimum_phase = is_hurwitz(weight.den), is_hurwitz(weight.num)
    top, bottom = squared(weight.num / samples.level, samples.unit), squared(weight.den, samples.unit)
    low, low_at, tests = _least_ratio(top, bottom, samples, strict)
    high, high_at, more = _least_ratio(bottom, top, samples.reciprocal(), strict)
    return Certificate(
        ok=bool(stable and minimum_phase and low >= 1.0),
        stable=stable,
        minimum_phase=minimum_phase,
        min_ratio=low,
        min_ratio_at=low_at,
        max_ratio=1.0 / high if high > 0.0 else math.inf,
        max_ratio_at=high_at,
        omega_max=float(samples.omega[-1]) if strict else math.inf,
        intervals=tests + more,
        without_data=samples.without_data,
    )


def is_hurwitz(coefficients: np.ndarray) -> bool:
    """Return whether all roots lie in the open left half-plane, by Routh's array in rational arithmetic.

    ``coefficients`` (n + 1,) in descending powers, the first not 0.
    """
    c = [Fraction(float(v)) for v in coefficients]
    if c[0] < 0:
        c = [-v for v in c]
    upper, lower = c[0::2], c[1::2]
    while lower:
        if lower[0] <= 0:
            return False
        quotient = upper[0] / lower[0]
        padded = [*lower[1:], Fraction(0)]
        upper, lower = lower, [u - quotient * p for u, p in zip(upper[1:], padded, strict=False)]
    return True


def squared(coefficients: np.ndarray, unit: float) -> np.ndarray:
    """Coefficients (n + 1,) of |p(j w)|^2 in ascending powers of y = (w/unit)^2, each rounded once.

    ``coefficients`` (n + 1,) of p(s) in descending powers; ``unit`` in rad/s.
    """
    scale = Fraction(unit)
    c = [Fraction(float(v)) * scale**i for i, v in enumerate(coefficients[::-1])]
    square = [Fraction(0)] * len(c)
    for i, ci in enumerate(c):  # p(s) p(-s) at s = jw: odd powers cancel, s^2 = -w^2
        for k in range(i % 2, len(c), 2):
            square[(i + k) // 2] += ci * c[k] * (1 - (i - k) % 4)
    return np.array([float(v) for v in square])


@cache
def _blossom(degree: int) -> tuple[np.ndarray, ...]:
    """Weights (degree + 1, i + 1) of hi^j lo^(i - j) in Bernstein coefficient k of the power y^i."""
    return tuple(
        np.array(
            [
                [math.comb(k, j) * math.comb(degree - k, i - j) / math.comb(degree, i) for j in range(i + 1)]
                for k in range(degree + 1)
            ]
        )
        for i in range(degree + 1)
    )


def _bernstein(lo: np.ndarray, hi: np.ndarray, degree: int) -> np.ndarray:
    """Bernstein coefficients (degree + 1, M, degree + 1) on [lo, hi] (M,) of every power of y.

    They follow from the blossom. Take all products of i factors out of (degree-k) times lo and k times hi.
    Coefficient k of y^i is their mean. For 0 <= lo <= hi nothing cancels within a monomial.
    """
    of_lo, of_hi = (x[:, None] ** np.arange(degree + 1) for x in (lo, hi))
    return np.stack(
        [(of_hi[:, : i + 1] * of_lo[:, i::-1]) @ share.T for i, share in enumerate(_blossom(degree))]
    )


_Shapes = tuple[np.ndarray, np.ndarray, np.ndarray]
_Pieces = tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray, np.ndarray]
"""Intervals [lo, hi] (M,) in y, each with y0, log0 and slope (M,) of :func:`_bound_squared`."""


def _least_ratio(
    top: np.ndarray, bottom: np.ndarray, samples: SampledBound, strict: bool
) -> tuple[float, float, int]:
    """Proved lower bound of inf sqrt(top/bottom)/bound, its frequency (rad/s, within 1e-9), number of tests.

    ``top`` and ``bottom`` are polynomials in ascending powers of y, in the unit of ``samples``, with bottom
    >= 0. Returns 0 and the frequency if no positive ratio could be proved. With ``strict``, frequencies
    beyond the last sample are left out.
    """
    size = max(len(top), len(bottom))
    top, bottom = (np.pad(p, (0, size - len(p))) for p in (top, bottom))
    y, log_b2 = samples.y, 2.0 * np.log(samples.bound)
    # The same logarithm as in ``_bound_squared``, however close the samples are.
    slopes = np.diff(log_b2) / np.log(y[1:] / y[:-1])
    inside: _Pieces = (
        np.append(0.0, y[:-1]),
        y,
        np.append(y[0], y[:-1]),
        np.append(log_b2[0], log_b2[:-1]),
        np.append(0.0, slopes),
    )
    families: list[tuple[np.ndarray, np.ndarray, _Pieces, Callable[[float], float]]] = [
        (top, bottom, inside, lambda v: samples.unit * math.sqrt(v))
    ]
    if not strict:  # [y_K, inf) in 1/y: the reversed polynomials on [0, 1/y_K]
        beyond = (np.zeros(1), 1.0 / y[-1:], 1.0 / y[-1:], log_b2[-1:], np.zeros(1))
        families.append(
            (top[::-1], bottom[::-1], beyond, lambda v: samples.unit / math.sqrt(v) if v else math.inf)
        )
    least, at, tests, margin = math.inf, math.nan, 0, _PROOF_MARGIN
    for p, q, pieces, frequency in families:
        points, shapes = np.concatenate(pieces[:2]), _twice(pieces[2:])
        for halvings in range(_MAX_HALVINGS):
            margin = max(margin, _PROOF_MARGIN * 4.0 ** (halvings - _PATIENCE))
            value, point = _attained(p, q, points, shapes)
            if value < least:
                least, at = value, frequency(point)
            if not least > 0.0:
                return 0.0, at, tests
            tests += len(pieces[0])
            open_ = ~_nonnegative(p, q, least * (1.0 - margin), *pieces)
            lo, hi, y0, log0, slope = (v[open_] for v in pieces)
            shapes = (y0, log0, slope)
            if not lo.size:
                break
            if tests > _MAX_TESTS:
                return 0.0, frequency(hi[0]), tests
            points = np.where(lo > 0, np.sqrt(lo * hi), 0.25 * hi)
            pieces = (np.concatenate([lo, points]), np.concatenate([points, hi]), *_twice(shapes))
        else:
            return 0.0, frequency(hi[0]), tests
    return math.sqrt(least * (1.0 - margin)), at, tests


def _twice(shapes: _Shapes) -> _Shapes:
    """Shape data of the two halves of every piece: all left halves, then all right halves."""
    y0, log0, slope = (np.tile(v, 2) for v in shapes)
    return y0, log0, slope


def _bound_squared(points: np.ndarray, y0: np.ndarray, log0: np.ndarray, slope: np.ndarray) -> np.ndarray:
    """Bound^2 = c y^q of one piece; its value at y0 is exp(log0). Pieces with q = 0 may contain y = 0."""
    with np.errstate(divide="ignore", invalid="ignore"):
        exponent = np.where(slope == 0, 0.0, slope * np.log(points / y0))
    return np.exp(log0 + exponent)


def _attained(p: np.ndarray, q: np.ndarray, points: np.ndarray, shapes: _Shapes) -> tuple[float, float]:
    """Least p/(bound^2 q) over ``points`` minus its rounding error, and the point; inf where q = 0."""
    powers = points[:, None] ** np.arange(len(p))
    bottom = (powers @ q) * _bound_squared(points, *shapes)
    with np.errstate(divide="ignore", invalid="ignore"):
        ratio = np.where(bottom > 0, (powers @ p - _ROUNDING * (powers @ np.abs(p))) / bottom, math.inf)
    k = int(np.argmin(ratio))
    return float(ratio[k]), float(points[k])


def _nonnegative(
    p: np.ndarray,
    q: np.ndarray,
    factor: float,
    lo: np.ndarray,
    hi: np.ndarray,
    y0: np.ndarray,
    log0: np.ndarray,
    slope: np.ndarray,
) -> np.ndarray:
    """Mask (M,) of the intervals [lo, hi] on which p >= factor bound^2 q is proved."""
    at_lo, at_hi = (_bound_squared(v, y0, log0, slope) for v in (lo, hi))
    with np.errstate(divide="ignore", invalid="ignore"):
        middle = np.sqrt(lo * hi)  # a piece from 0 is constant and needs no tangent
        tangent = _bound_squared(middle, y0, log0, slope) * (
            1.0 + slope * (np.array([lo, hi]) / middle - 1.0)
        )
    concave = (slope > 0) & (slope < 1)
    line_lo, line_hi = (
        factor * np.where(concave, tangent[0], at_lo),
        factor * np.where(concave, tangent[1], at_hi),
    )
    n = len(p) - 1
    basis = _bernstein(lo, hi, n)
    p_c, p_abs, q_c, q_abs = (np.tensordot(c, basis, 1) for c in (p, np.abs(p), q, np.abs(q)))
    proved = np.ones(lo.size, dtype=bool)
    for k in range(n + 2):  # coefficient k of p and of (line q), both raised to degree n + 1
        value = np.zeros(lo.size)
        for weight, index, line in ((n + 1 - k, k, line_lo), (k, k - 1, line_hi)):
            if weight:
                value += weight * (
                    p_c[:, index]
                    - line * q_c[:, index]
                    - _ROUNDING * (p_abs[:, index] + line * q_abs[:, index])
                )
        proved &= value >= 0
    return proved
