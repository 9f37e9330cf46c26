"""Steady turn of a vehicle, fitted in the units of the columns.

In a steady turn ``r = v (delta - trim) / (L + K v^2)``, with L the wheelbase and K the understeer. The
columns have own units: ``v = a v'``, ``delta = b delta'``, ``r = c r'``. With ``P = L c / (a b)`` and ``q = K
a^2 / L`` the steady turn is ``r' = v' (delta' - trim') / (P (1 + q v'^2))``. The columns alone give P, q and
the lag of r. Units are needed to get L and K from them.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import product

import numpy as np
from scipy.signal import lfilter

SLOW = 0.15
"""Below this share of the largest speed a car may go backwards, and most speeds have no sign."""
STEP_S = 0.05
"""Samples are averaged to about this step: driving has nothing faster."""
MOST_SAMPLES = 24_000
LAGS_S = (0.0, 0.05, 0.1, 0.2, 0.35)
DELAYS_S = (0.0, 0.05, 0.1, 0.15, 0.2, 0.3, 0.4)
FINE_LAGS_S = (0.0, *np.geomspace(0.02, 0.6, 16))
FINE_DELAYS_S = tuple(np.arange(0.0, 0.41, 0.02))
"""Lags and delays that are tried together, then one after the other."""
REFINED = 2
BEGINS_S = 1.0
"""Time after which the start of a recording is forgotten."""
SPREADS = np.r_[np.linspace(-0.75, 0.0, 9), np.geomspace(0.05, 20.0, 40)]
"""Values of q times the square of the largest speed that are tried."""
MEMORY_S = 1.5
"""Errors further apart than this count as independent."""
LEAST_DOUBT = 0.003
"""The model is no better than this share of the yaw rate's variance: what leaves so much more is likely."""


@dataclass(frozen=True)
class Driven:
    """The columns of a recording on its time axis: t (N,) [s], v, delta, r (N,) in their own units."""

    t: np.ndarray
    v: np.ndarray
    delta: np.ndarray
    r: np.ndarray


@dataclass(frozen=True)
class SteadyTurn:
    """Steady turn in the units of the columns. ``spread`` (Q,) are the likely q, the likeliest first.
    ``length`` (Q,) is P for each of them, with the sign of the steering. ``lag_s`` is the lag of the yaw rate
    behind the steering. ``explained`` is the explained share of the yaw rate's variance."""

    length: np.ndarray
    spread: np.ndarray
    lag_s: float
    explained: float


def steady_turn(drives: Sequence[Driven]) -> SteadyTurn | None:
    """Fit the steady turn with a lag to recordings; None where nothing moves."""
    averaged = [piece for d in drives if len((piece := _averaged(d)).t) > 3 * BEGINS_S / STEP_S]
    if not averaged:
        return None
    largest = float(np.quantile(np.abs(np.concatenate([p.v for p in averaged])), 0.99))
    pieces = [(p, fast) for p in averaged if (fast := _begun(p, p.v >= SLOW * largest)).any()]
    if not (largest > 0 and pieces):
        return None
    moved = float(np.ptp(np.concatenate([p.delta for p, _ in pieces])))
    target = np.concatenate([(r := _begun(p, p.r)[fast]) - r.mean() for p, fast in pieces])
    if not (moved > 0 and target.any()):
        return None
    coarse = SPREADS[::6] / largest**2
    tried = [
        (_fitted(pieces, q, lag, delay), lag, delay) for lag, delay, q in product(LAGS_S, DELAYS_S, coarse)
    ]
    (_, least), lag, delay = min(tried, key=lambda item: item[0][1])
    spread = SPREADS / largest**2
    for _ in range(REFINED):
        q = min(spread, key=lambda q: _fitted(pieces, q, lag, delay)[1])
        lag = min(FINE_LAGS_S, key=lambda lag: _fitted(pieces, q, lag, delay)[1])
        delay = min(FINE_DELAYS_S, key=lambda delay: _fitted(pieces, q, lag, delay)[1])
    lengths, left = np.array([_fitted(pieces, q, lag, delay) for q in spread]).T
    seconds = sum(int(fast.sum()) * float(np.median(np.diff(p.t))) for p, fast in pieces)
    doubt = left.min() * 3.84 * MEMORY_S / seconds + LEAST_DOUBT * float(target @ target)
    order = np.argsort(left, kind="stable")
    likely = order[left[order] <= left.min() + doubt]
    explained = 1 - min(float(left.min()), least) / float(target @ target)
    return SteadyTurn(lengths[likely], spread[likely], lag + delay, explained)


def _averaged(d: Driven) -> Driven:
    """The recording at steps of about STEP_S, without samples that are no numbers."""
    step = float(np.median(np.diff(d.t)))
    count = max(1, int(STEP_S / step + 1e-6)) if step > 0 else 1
    rows = len(d.t) // count
    rows = min(rows, MOST_SAMPLES)
    parts = [x[: rows * count].reshape(rows, count).mean(1) for x in (d.t, d.v, d.delta, d.r)]
    return Driven(*parts)


def _begun(p: Driven, values: np.ndarray) -> np.ndarray:
    """A column of a recording once its beginning is forgotten."""
    return values[round(BEGINS_S / float(np.median(np.diff(p.t)))) :]


def _fitted(
    pieces: Sequence[tuple[Driven, np.ndarray]], spread: float, lag_s: float, delay_s: float
) -> tuple[float, float]:
    """P and the sum of squares that is left, for one q, lag and delay; each recording has its trim and
    level. Only samples with the mark of a piece count."""
    xx = xy = yy = 0.0
    for p, fast in pieces:
        step = float(np.median(np.diff(p.t)))
        shift = round(delay_s / step)
        rolls = p.v / np.maximum(1 + spread * p.v**2, 0.05)
        delayed = np.r_[np.full(shift, p.delta[0]), p.delta[: len(p.delta) - shift]]
        y = _begun(p, p.r)[fast]
        x, z = _begun(p, _lagged(np.column_stack((rolls * delayed, rolls)), lag_s, step))[fast].T
        x, z, y = x - x.mean(), z - z.mean(), y - y.mean()
        along = float(z @ z)
        if along > 1e-18 * max(float(rolls @ rolls), 1e-300):  # a trim is no level, where the speed moves
            x, y = x - z * (float(x @ z) / along), y - z * (float(y @ z) / along)
        xx, xy, yy = xx + float(x @ x), xy + float(x @ y), yy + float(y @ y)
    if xx <= 0.0 or xy == 0.0:
        return np.inf, yy
    return xx / xy, yy - xy * xy / xx


def _lagged(x: np.ndarray, lag_s: float, step: float) -> np.ndarray:
    """A first-order lag of columns x (N, k), at rest at their first values."""
    if lag_s <= 0:
        return x
    pole = float(np.exp(-step / lag_s))
    return lfilter([1 - pole], [1, -pole], x, axis=0, zi=pole * x[:1])[0]
