"""Sums of a drive for the regularised model error model: all that is kept of it (THEORY 7.15).

Signals of a drive are decimated and whitened by the drive's own autoregression of its residue. Offsets that
are constant and linear in speed are projected out. Sums of drives add; what a drive deviates by is kept a
drive, in three directions, so memory is a few kilobytes a drive.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import reduce

import numpy as np
from scipy.linalg import solve_toeplitz
from scipy.signal import lfilter

from ..drives.frames import Estimator
from ..drives.tables import Drive
from ..vehicle.nominal import NominalModel
from .error_domain import ErrorDomain

NOISE_ORDER = 12
"""Order of the autoregression that whitens a drive's residue."""
DIRECTIONS = 3
"""Directions in which drives deviate: gain, delay and second difference."""
LEAST_OFFSET = 1e-6
"""Singular value over the largest, below which an offset is no direction of its own."""
SPEED_CELLS, AMPLITUDE_CELLS_PER_KNOT = 16, 4
"""Cells of the histogram of counted samples: over the speed range, and between knots of amplitude."""


def deviations(domain: ErrorDomain) -> np.ndarray:
    """(L, DIRECTIONS) lag values of a unit gain, delay and second difference.

    Each has the frequency response of size 1 at the highest bin: 1, -j sin(w T) and 2 cos(w T) - 2, scaled.
    """
    zero = int(np.flatnonzero(domain.lags == 0)[0])
    angle = domain.omega[-1] * domain.step_s
    out = np.zeros((len(domain.lags), DIRECTIONS))
    out[zero, 0] = 1.0
    out[zero - 1 : zero + 2, 1] = np.array([-0.5, 0.0, 0.5]) / np.sin(min(angle, np.pi / 2))
    out[zero - 1 : zero + 2, 2] = np.array([1.0, -2.0, 1.0]) / (2 - 2 * np.cos(angle))
    return out


@dataclass(frozen=True)
class ErrorSums:
    """Whitened sums over D drives, of every output.

    Attributes
    ----------
    gram : (n_y, p, p) products of regressors over noise variance.
    cross : (n_y, p) products of regressors and error.
    square : (n_y,) sums of squares of the error.
    samples : (n_y,) counted samples.
    drive_gram : (D, n_y, p, 3) products of regressors and a drive's signals of deviation.
    drive_cross : (D, n_y, 3) products of error and signals of deviation.
    drive_own : (D, n_y, 3, 3) products of signals of deviation.
    histogram : (S, A) counted steps by cells of speed and log amplitude.
    groups : (D,) names of the drives' groups.
    """

    gram: np.ndarray
    cross: np.ndarray
    square: np.ndarray
    samples: np.ndarray
    drive_gram: np.ndarray
    drive_cross: np.ndarray
    drive_own: np.ndarray
    histogram: np.ndarray
    groups: tuple[str, ...]

    def plus(self, other: ErrorSums) -> ErrorSums:
        """Sums over the drives of both, these first."""
        return joined([self, other])


def joined(parts: list[ErrorSums]) -> ErrorSums:
    """Sums over all drives of the parts, in their order."""
    return ErrorSums(
        gram=sum_of([p.gram for p in parts]),
        cross=sum_of([p.cross for p in parts]),
        square=sum_of([p.square for p in parts]),
        samples=sum_of([p.samples for p in parts]),
        drive_gram=np.concatenate([p.drive_gram for p in parts]),
        drive_cross=np.concatenate([p.drive_cross for p in parts]),
        drive_own=np.concatenate([p.drive_own for p in parts]),
        histogram=sum_of([p.histogram for p in parts]),
        groups=tuple(g for p in parts for g in p.groups),
    )


def sum_of(arrays: list[np.ndarray]) -> np.ndarray:
    """Sum of arrays of one shape, entry by entry, in their order."""
    return reduce(np.add, arrays)


def noise_filter(residue: np.ndarray, counted: np.ndarray) -> tuple[np.ndarray, float]:
    """Prediction-error filter (NOISE_ORDER + 1,) of a residue, and the variance of what it leaves.

    Parameters
    ----------
    residue : (N,) residue in the output's unit.
    counted : (N,) bool, samples that count.
    """
    x = np.where(counted, residue, 0.0)
    count = max(1, int(counted.sum()))
    lags = np.array([x[: len(x) - k] @ x[k:] for k in range(NOISE_ORDER + 1)]) / count
    lags[0] = lags[0] * (1 + 1e-6) + 1e-30
    a = solve_toeplitz(lags[:-1], lags[1:])
    return np.r_[1.0, -a], float(lags[0] - a @ lags[1:])


def projected_input(
    domain: ErrorDomain, yhat: np.ndarray, instrument: np.ndarray, s: np.ndarray
) -> np.ndarray:
    """(N,) part of the nominal output that follows an instrument: first stage of two-stage least squares.

    Parameters
    ----------
    yhat, instrument, s : (N,) decimated nominal output, instrument and relative speed.
    """
    lagged = lagged_signals(domain, instrument - instrument.mean())
    X = np.column_stack([np.ones_like(s), s, lagged, s[:, None] * lagged])
    return X @ np.linalg.lstsq(X, yhat, rcond=1e-10)[0]


def lagged_signals(domain: ErrorDomain, x: np.ndarray) -> np.ndarray:
    """(N, L) signal x (N,) through the taps of every knot of the lag; zero outside of the drive."""
    ahead = -int(domain.lags[0])
    longer = np.r_[x, np.zeros(ahead)]
    return np.column_stack([lfilter(row, [1.0], longer)[ahead:] for row in domain.taps])


def counted_samples(domain: ErrorDomain, inside: np.ndarray) -> np.ndarray:
    """(N,) bool: every lag and the whitening filter stay within samples that are ``inside`` (N,) bool."""
    before = domain.taps.shape[1] + int(domain.lags[0]) + NOISE_ORDER
    ahead = -int(domain.lags[0])
    total = np.r_[0, np.cumsum(inside)]
    n = len(inside)
    out = np.zeros(n, bool)
    k = np.arange(before, n - ahead)
    out[k] = total[k + ahead + 1] - total[k - before] == before + ahead + 1
    return out


def error_sums(
    domain: ErrorDomain,
    model: NominalModel,
    estimator: Estimator,
    drive: Drive,
    e: np.ndarray,
    yhat: np.ndarray,
    group: str,
) -> ErrorSums:
    """Sums of one drive; e and yhat (N, n_y) in the outputs' units."""
    n_y = e.shape[1]
    outside = [] if drive.instrument is None else [drive.instrument]
    signals = domain.decimated(np.vstack([e.T, yhat.T, drive.v, *outside]))
    every = slice(None, None, domain.decimation)
    v, amplitude = signals[2 * n_y], domain.amplitude(drive, model)[every]
    inside = estimator.settled(drive.v)[every] & (amplitude >= domain.lowest_knot)
    counted, s = counted_samples(domain, inside), domain.relative_speed(v)
    features = domain.features(s, amplitude)
    p = features.shape[1] * len(domain.lags)
    out = ErrorSums(
        np.zeros((n_y, p, p)),
        np.zeros((n_y, p)),
        np.zeros(n_y),
        np.zeros(n_y),
        np.zeros((1, n_y, p, DIRECTIONS)),
        np.zeros((1, n_y, DIRECTIONS)),
        np.zeros((1, n_y, DIRECTIONS, DIRECTIONS)),
        _histogram(domain, s[counted], amplitude[counted]),
        (group,),
    )
    for j in range(n_y if counted.sum() > 4 * (NOISE_ORDER + 2 * DIRECTIONS + 2) else 0):
        z = signals[n_y + j]
        if outside:
            z = projected_input(domain, z, signals[-1], s)
        lagged = lagged_signals(domain, z)
        whitened = _whitened(domain, signals[j], lagged, z, s, counted)
        if whitened is None:
            continue
        y, L, own, offsets = whitened
        X = (features[counted][:, :, None] * L[:, None, :]).reshape(len(y), -1)
        left, sizes, _ = np.linalg.svd(offsets, full_matrices=False)
        orthogonal = left[:, sizes > LEAST_OFFSET * sizes[0]]
        X, y, own = (x - orthogonal @ (orthogonal.T @ x) for x in (X, y, own))
        out.gram[j], out.cross[j] = X.T @ X, X.T @ y
        out.square[j], out.samples[j] = y @ y, len(y) - orthogonal.shape[1]
        out.drive_gram[0, j], out.drive_cross[0, j], out.drive_own[0, j] = X.T @ own, y @ own, own.T @ own
    return out


def _whitened(
    domain: ErrorDomain,
    e: np.ndarray,
    lagged: np.ndarray,
    z: np.ndarray,
    s: np.ndarray,
    counted: np.ndarray,
) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray] | None:
    """Counted samples of error (n,), lagged signals (n, L), deviations (n, 3) and offsets (n, 2), whitened.

    The noise has unit variance. The residue is that of the drive's own gain, delay and second difference,
    linear in speed. A drive deviates by a factor on its response, so signals of deviation are taken of the
    nominal output z (N,) and the error that these explain. None where z or the residue is silent.
    """
    T = deviations(domain)
    ones, own = np.column_stack([np.ones_like(s), s]), lagged @ T
    X = np.column_stack([own, s[:, None] * own, ones])
    theta = np.linalg.lstsq(X[counted], e[counted], rcond=1e-10)[0]
    whiten, variance = noise_filter(e - X @ theta, counted)
    if not (variance > 0 and np.any(lagged[counted])):
        return None
    explained = X[:, : 2 * DIRECTIONS] @ theta[: 2 * DIRECTIONS]
    response = lagged_signals(domain, z + explained) @ T
    y, L, D, offsets, X = (lfilter(whiten, [1.0], x, axis=0)[counted] for x in (e, lagged, response, ones, X))
    left = y - X @ np.linalg.lstsq(X, y, rcond=1e-10)[0]
    scale = np.sqrt(max(left @ left / (len(y) - X.shape[1] - NOISE_ORDER), 1e-300))
    return y / scale, L / scale, D / scale, offsets


def _histogram(domain: ErrorDomain, s: np.ndarray, a: np.ndarray) -> np.ndarray:
    """(S, A) counts by cells of relative speed s (n,) and log amplitude a (n,)."""
    speed = np.clip(((s + 1) / 2 * SPEED_CELLS).astype(int), 0, SPEED_CELLS - 1)
    knots = domain.amplitude_knots
    cells = AMPLITUDE_CELLS_PER_KNOT * (len(knots) - 1)
    place = np.log(a / knots[0]) / np.log(knots[-1] / knots[0]) * cells
    out = np.zeros((SPEED_CELLS, cells))
    np.add.at(out, (speed, np.clip(place.astype(int), 0, cells - 1)), 1)
    return out
