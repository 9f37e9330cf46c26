"""Stage 4: fit stable, minimum-phase weights of low order that are proved to lie above the bounds.

Reads   omega (K,) rad/s, bound (K,) in the unit of the weighted signal (NaN: bin without data)
Gives   ``Weight`` W(s) with |W(jw)| >= bound(w) for every w >= 0, and its tightness
Source  Roedoenyi & Bokor, section III, steps 6 and 7; THEORY 5.3

The *worst ratio* is sup |W|/bound over all w, the ends included. A strictly proper weight cannot stay above a
constant for all w, so its claims end at the last sample.

Linear programs find the squared magnitude with the least worst ratio (``minimax``). The weight consists of
its left-half-plane spectral factors. The certificate (``certificate``) finds the largest deficit between the
grid points. Finally the scalar gain ``inflation`` raises the weight by this deficit.

The optimum of a given order may have a break beyond the first or last sample. It may also have a sharp
resonance around a single deep bin of raw scatter. Both are kept, because the fit would be more than 0.01 dB
worse without them. ``breaks_outside`` lists breaks beyond the samples. Pass an envelope if the weight should
not follow the scatter.
"""

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from ...base.errors import InputError
from .bound import SampledBound
from .certificate import Certificate, verify_overbound
from .minimax import STEP_DB, Grid, MinimaxFit, least_worst_ratio
from .weight import Weight, polynomial_roots

_MAX_REFITS = 8


@dataclass(frozen=True)
class OverboundFit:
    """A fitted weight and its quality.

    Attributes
    ----------
    weight : Weight, includes the inflation
    order : int
    worst_ratio_db : float, dB, proved upper limit of sup |W|/bound, 20 log10
    lp_optimum_db : float, dB, smallest ratio that the LP solver finds for this order; not a proved bound
    inflation : float, final scalar gain
    certificate : dict, of ``Certificate.to_dict()``
    ratios_db : dict[int, float], dB, worst ratio per order tried
    floored : tuple of float, rad/s, frequencies where the floor replaced a smaller bound
    breaks_outside : tuple of float, rad/s, |pole| and |zero| below the first or above the last sample
    """

    weight: Weight
    order: int
    worst_ratio_db: float
    lp_optimum_db: float
    inflation: float
    certificate: dict
    ratios_db: dict[int, float]
    floored: tuple[float, ...]
    breaks_outside: tuple[float, ...]


def fit_overbound(
    omega: ArrayLike,
    bound: ArrayLike,
    *,
    max_order: int = 4,
    order: int | None = None,
    floor: float | None = None,
    tol_db: float = 0.3,
    proper: str = "biproper",
    name: str = "",
) -> OverboundFit:
    """Fit the lowest-order stable minimum-phase weight above a bound with the least worst ratio.

    Parameters
    ----------
    omega : array_like (K,), rad/s, > 0, strictly increasing
    bound : array_like (K,), >= 0, NaN in a bin without data
        The bound is interpolated over such bins.
    max_order : int, highest order, default 4
        The chosen n is the smallest for which no n + k lowers the worst ratio by more than k ``tol_db``.
    order : int, optional, fixed order
        A lower order within 0.002 dB replaces it.
    floor : float, optional, replaces smaller bounds; needed if a bound is 0
    tol_db : float, dB, default 0.3
    proper : str, "biproper" (D(inf) > 0, for H-infinity) or "strict"
        "strict" rolls off at or below 10 omega[-1]. Its proof ends at omega[-1].
    name : str, name of the bound in messages, default ''

    Returns
    -------
    OverboundFit

    Raises
    ------
    InputError
        If an input is not valid. The error names the index or the frequency.

    References
    ----------
    Paper, section III, steps 6 and 7; THEORY 5.3.

    Examples
    --------
    >>> fit = fit_overbound([0.1, 1.0, 10.0], [2.0, 2.0, 2.0])
    >>> fit.order, round(float(fit.weight.magnitude(1.0)), 6)
    (0, 2.0)
    """
    source = name or "weight fit"
    lowest = _lowest_order(source, max_order, order, tol_db, proper)
    samples = SampledBound.read(source, omega, bound, floor)
    grid = Grid(samples, strict=proper == "strict")
    best: dict[int, MinimaxFit] = {}
    for n in range(lowest, (max_order if order is None else order) + 1):
        best[n] = least_worst_ratio(grid, n, best.get(n - 1))
        if order is None and best[n].ratio_db <= tol_db:
            break  # no higher order can gain more than tol_db
    chosen = _choose(best, tol_db) if order is None else order
    for n in range(chosen, lowest - 1, -1):
        if best[n].order == n and (closed := _close(grid, best[n], best.get(n - 1))) is not None:
            break
    else:
        raise InputError(
            source, f"order {chosen}", "no weight could be certified", "a smoother bound or another order"
        )
    weight, inflation, certificate, lower_db = closed
    worst_db = _db(certificate.max_ratio)
    return OverboundFit(
        weight=weight,
        order=weight.order,
        worst_ratio_db=worst_db,
        lp_optimum_db=lower_db,
        inflation=inflation,
        certificate=certificate.to_dict() | {"without_data": list(samples.without_data)},
        ratios_db={m: candidate.ratio_db for m, candidate in best.items()} | {n: worst_db},
        floored=samples.floored,
        breaks_outside=_outside(weight, samples),
    )


def _outside(weight: Weight, samples: SampledBound) -> tuple[float, ...]:
    """|pole| and |zero| (rad/s) below the first or above the last sample."""
    breaks = np.sort(np.abs(np.concatenate([weight.zeros(), weight.poles()])))
    return tuple(breaks[(breaks < samples.omega[0]) | (breaks > samples.omega[-1])].tolist())


def _lowest_order(source: str, max_order: int, order: int | None, tol_db: float, proper: str) -> int:
    """Return the lowest order to try; InputError for invalid options."""
    if proper not in ("biproper", "strict"):
        raise InputError(source, "proper", f"{proper!r}", "'biproper' or 'strict'")
    lowest = 1 if proper == "strict" else 0
    for what, value in (("max_order", max_order), ("order", order)):
        if value is not None and not (isinstance(value, int) and lowest <= value <= 8):
            raise InputError(source, what, f"{value!r}", f"an integer from {lowest} to 8")
    if not (math.isfinite(tol_db) and tol_db >= 0):
        raise InputError(source, "tol_db", f"{tol_db!r}", "a finite number of dB >= 0")
    return lowest


def _choose(best: dict[int, MinimaxFit], tol_db: float) -> int:
    """Smallest order n such that no order n + k gains more than k tol_db."""
    return min(best, key=lambda n: best[n].ratio_db + tol_db * n)


def _close(
    grid: Grid, candidate: MinimaxFit, lower_order: MinimaxFit | None
) -> tuple[Weight, float, Certificate, float] | None:
    """Weight, inflation, certificate and lower limit [dB] of a candidate, or None.

    None means that it is not better than the lower order or has no stable spectral factor. If the certificate
    finds a worse ratio than the grid, its frequency is added to the grid and the order is fitted again.
    """
    closed = None
    for _ in range(_MAX_REFITS):
        lifted = _lift(grid, candidate)
        certificate = lifted[2]
        if certificate.ok and (closed is None or certificate.max_ratio < closed[2].max_ratio):
            closed = *lifted, candidate.lower_db
        if closed is not None and _db(closed[2].max_ratio) <= candidate.lower_db + 4 * STEP_DB:
            break
        grid.insert((np.array([certificate.min_ratio_at, certificate.max_ratio_at]) / grid.samples.unit) ** 2)
        candidate = least_worst_ratio(grid, candidate.order, lower_order, candidate)
        if lower_order is not None and candidate.order == lower_order.order:
            break
    worse = (
        closed is not None
        and lower_order is not None
        and _db(closed[2].max_ratio) > lower_order.ratio_db + STEP_DB
    )
    return None if worse else closed


def _lift(grid: Grid, candidate: MinimaxFit) -> tuple[Weight, float, Certificate]:
    """Weight from the spectral factors of a candidate, raised above the bound by a gain.

    Returns the weight, the gain and the certificate.
    """
    samples = grid.samples
    factors = [_spectral_factor(np.trim_zeros(p, "b")) for p in (candidate.top, candidate.bottom)]
    num, den = (p / samples.unit ** np.arange(len(p) - 1, -1, -1.0) for p in factors)
    raw, inflation = Weight(samples.level * num / den[0], den / den[0]), 1.0
    for _ in range(3):
        weight = Weight(raw.num * inflation, raw.den)
        certificate = verify_overbound(weight, samples.omega, samples.bound * samples.level)
        if certificate.ok or certificate.min_ratio == 0.0:
            break
        inflation *= (1.0 + 1e-12) / certificate.min_ratio
    return weight, inflation, certificate


def _spectral_factor(square: np.ndarray) -> np.ndarray:
    """Polynomial p with |p(jw)|^2 = square(w^2) and roots in the open left half-plane, if any.

    It is in descending powers of s.
    """
    roots = polynomial_roots(square[::-1])
    s = -np.sqrt(-roots.astype(complex))
    return math.sqrt(abs(square[-1])) * np.atleast_1d(np.real(np.poly(s)))


def _db(ratio: float) -> float:
    """Ratio in dB, 20 log10. inf stays inf."""
    return 20.0 * math.log10(ratio)
