"""Sums of a drive for the regularised model error model (THEORY 7.15). No other data of a drive are kept.

Two passes read the drives. The first estimates the gain, delay and second difference that all drives share.
The second computes these sums. The signals of a drive are decimated, and an autoregression of the residue of
this drive whitens them. Offsets that are constant or linear in speed are projected out. The sums of several
drives are added. Only the products with the deviation of a drive, in three directions, are kept for each
drive. The memory is therefore a few kilobytes for each drive.
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
"""Order of the autoregression that whitens the residue of a drive."""
DIRECTIONS = 3
"""Number of directions in which drives deviate: gain, delay and second difference."""
COMMON = 2 * DIRECTIONS
"""Number of common parameters of all drives: each direction has a constant part and one linear in relative
speed."""
LEAST_OFFSET = 1e-6
"""Offsets with a smaller singular value, relative to the largest, are dropped."""
SPEED_CELLS, AMPLITUDE_CELLS_PER_KNOT = 16, 4
"""Number of cells of the histogram of counted samples: over the speed range, and between two knots of the
amplitude."""


def deviations(domain: ErrorDomain) -> np.ndarray:
    """Compute the lag values of a unit gain, delay and second difference.

    Their frequency responses are 1, -j sin(w T) and 2 cos(w T) - 2, each scaled to size 1 at the highest bin.

    Parameters
    ----------
    domain : ErrorDomain

    Returns
    -------
    ndarray (L, DIRECTIONS)
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
    """Sums of whitened signals over D drives, for every output.

    Attributes
    ----------
    gram : (n_y, p, p) products of regressors, divided by the noise variance.
    cross : (n_y, p) products of regressors and error.
    square : (n_y,) sums of squares of the error.
    samples : (n_y,) counted samples.
    drive_gram : (D, n_y, p, 3) products of regressors and deviation signals of a drive.
    drive_cross : (D, n_y, 3) products of the error and the deviation signals.
    drive_own : (D, n_y, 3, 3) products of the deviation signals.
    histogram : (S, A) numbers of counted steps in cells of speed and log amplitude.
    groups : (D,) names of the groups of the drives.
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
        """Sums over the drives of both, in this order."""
        return joined([self, other])


def joined(parts: list[ErrorSums]) -> ErrorSums:
    """Join sums over drives, in the order of the parts.

    Parameters
    ----------
    parts : list of ErrorSums

    Returns
    -------
    ErrorSums
    """
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
    """Add arrays of one shape, entry by entry, in their order.

    Parameters
    ----------
    arrays : list of ndarray

    Returns
    -------
    ndarray
    """
    return reduce(np.add, arrays)


def noise_filter(residue: np.ndarray, counted: np.ndarray) -> tuple[np.ndarray, float]:
    """Prediction-error filter (NOISE_ORDER + 1,) of a residue (N,), and the variance of the filtered residue.

    Only the ``counted`` samples are used.
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
    """Part (N,) of the nominal output that an instrument predicts.

    This is the first stage of two-stage least squares. yhat, instrument and relative speed s are decimated
    signals (N,).
    """
    lagged = lagged_signals(domain, instrument - instrument.mean())
    X = np.column_stack([np.ones_like(s), s, lagged, s[:, None] * lagged])
    return X @ np.linalg.lstsq(X, yhat, rcond=1e-10)[0]


def lagged_signals(domain: ErrorDomain, x: np.ndarray) -> np.ndarray:
    """Signals (N, L): x (N,) filtered by the taps of every knot of the lag. x is zero outside the drive."""
    ahead = -int(domain.lags[0])
    longer = np.r_[x, np.zeros(ahead)]
    return np.column_stack([lfilter(row, [1.0], longer)[ahead:] for row in domain.taps])


def counted_samples(domain: ErrorDomain, inside: np.ndarray) -> np.ndarray:
    """Mask (N,) of samples whose lags and whitening filter use only samples that are ``inside`` (N,) bool."""
    before = domain.taps.shape[1] + int(domain.lags[0]) + NOISE_ORDER
    ahead = -int(domain.lags[0])
    total = np.r_[0, np.cumsum(inside)]
    n = len(inside)
    out = np.zeros(n, bool)
    k = np.arange(before, n - ahead)
    out[k] = total[k + ahead + 1] - total[k - before] == before + ahead + 1
    return out


@dataclass(frozen=True)
class _Counted:
    """Decimated signals of a drive, with the mask ``counted`` (N,).

    They are the error and the nominal output (n_y, N), and the relative speed s and the amplitude (N,). With
    an instrument, the part that it predicts replaces the nominal output.
    """

    error: np.ndarray
    nominal: np.ndarray
    s: np.ndarray
    amplitude: np.ndarray
    counted: np.ndarray

    @classmethod
    def from_drive(
        cls,
        domain: ErrorDomain,
        model: NominalModel,
        estimator: Estimator,
        drive: Drive,
        e: np.ndarray,
        yhat: np.ndarray,
    ) -> _Counted:
        """Signals of a drive, from e and yhat (N, n_y) in output units."""
        n_y = e.shape[1]
        outside = [] if drive.instrument is None else [drive.instrument]
        signals = domain.decimated(np.vstack([e.T, yhat.T, drive.v, *outside]))
        every = slice(None, None, domain.decimation)
        nominal, s = signals[n_y : 2 * n_y], domain.relative_speed(signals[2 * n_y])
        if outside:
            nominal = np.array([projected_input(domain, z, signals[-1], s) for z in nominal])
        amplitude = domain.amplitude(drive, model)[every]
        inside = estimator.settled(drive.v)[every] & (amplitude >= domain.lowest_knot)
        counted = counted_samples(domain, inside)
        counted &= counted.sum() > 4 * (NOISE_ORDER + COMMON + 2)
        return cls(signals[:n_y], nominal, s, amplitude, counted)

    def by_speed(self, domain: ErrorDomain, output: int) -> np.ndarray:
        """Regressors (N, COMMON) of gain, delay and second difference, each constant and linear in s."""
        own = lagged_signals(domain, self.nominal[output]) @ deviations(domain)
        return np.column_stack([own, self.s[:, None] * own])

    def whitened(
        self, output: int, by_speed: np.ndarray, signals: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray] | None:
        """Whitened error (n,) and signals (n, m) at the counted samples, and a basis of the offsets.

        The basis is (n, 0 to 2). Their noise has unit variance. The residue is that of a fit of ``by_speed``
        (N, COMMON) to this drive. The result is None where the nominal output or the residue is zero.
        """
        ones = np.column_stack([np.ones_like(self.s), self.s])
        X, e, counted = np.column_stack([by_speed, ones]), self.error[output], self.counted
        if not np.any(by_speed[counted]):
            return None
        whiten, variance = noise_filter(
            e - X @ np.linalg.lstsq(X[counted], e[counted], rcond=1e-10)[0], counted
        )
        if not variance > 0:
            return None
        y, L, offsets, X = (lfilter(whiten, [1.0], x, axis=0)[counted] for x in (e, signals, ones, X))
        left = y - X @ np.linalg.lstsq(X, y, rcond=1e-10)[0]
        scale = np.sqrt(max(left @ left / (len(y) - X.shape[1] - NOISE_ORDER), 1e-300))
        basis, sizes, _ = np.linalg.svd(offsets, full_matrices=False)
        return y / scale, L / scale, basis[:, sizes > LEAST_OFFSET * sizes[0]]


def _without(basis: np.ndarray, x: np.ndarray) -> np.ndarray:
    """x (n, ...) without its projection on an orthonormal basis (n, m)."""
    return x - basis @ (basis.T @ x)


def common_products(
    domain: ErrorDomain,
    model: NominalModel,
    estimator: Estimator,
    drive: Drive,
    e: np.ndarray,
    yhat: np.ndarray,
) -> np.ndarray:
    """Compute the normal equations of one drive for `common_fit`.

    Parameters
    ----------
    domain : ErrorDomain
    model : NominalModel
    estimator : Estimator
    drive : Drive
    e, yhat : ndarray (N, n_y), output units

    Returns
    -------
    ndarray (n_y, COMMON, COMMON + 1)
    """
    counted = _Counted.from_drive(domain, model, estimator, drive, e, yhat)
    out = np.zeros((e.shape[1], COMMON, COMMON + 1))
    for j in range(e.shape[1]):
        by_speed = counted.by_speed(domain, j)
        whitened = counted.whitened(j, by_speed, by_speed)
        if whitened is not None:
            y, X, basis = whitened
            y, X = _without(basis, y), _without(basis, X)
            out[j] = X.T @ np.column_stack([X, y])
    return out


def common_fit(products: np.ndarray) -> np.ndarray:
    """Fit the common gain, delay and second difference of all drives, each constant and linear in s.

    Parameters
    ----------
    products : ndarray (n_y, COMMON, COMMON + 1), sum of `common_products` over drives

    Returns
    -------
    ndarray (n_y, COMMON)
    """
    return np.array([np.linalg.lstsq(part[:, :-1], part[:, -1], rcond=1e-10)[0] for part in products])


def error_sums(
    domain: ErrorDomain,
    model: NominalModel,
    estimator: Estimator,
    drive: Drive,
    e: np.ndarray,
    yhat: np.ndarray,
    group: str,
    common: np.ndarray,
) -> ErrorSums:
    """Compute the sums of one drive.

    The deviation of a drive is a factor on the response of the vehicle. The deviation signals are therefore
    computed from the nominal output and the common error of all drives. With the error of the drive itself
    they would explain any error.

    Parameters
    ----------
    domain : ErrorDomain
    model : NominalModel
    estimator : Estimator
    drive : Drive
    e, yhat : ndarray (N, n_y), output units
    group : str, group of the drive
    common : ndarray (n_y, COMMON), result of `common_fit`

    Returns
    -------
    ErrorSums
    """
    n_y = e.shape[1]
    counted = _Counted.from_drive(domain, model, estimator, drive, e, yhat)
    features = domain.features(counted.s, counted.amplitude)
    p = features.shape[1] * len(domain.lags)
    out = ErrorSums(
        np.zeros((n_y, p, p)),
        np.zeros((n_y, p)),
        np.zeros(n_y),
        np.zeros(n_y),
        np.zeros((1, n_y, p, DIRECTIONS)),
        np.zeros((1, n_y, DIRECTIONS)),
        np.zeros((1, n_y, DIRECTIONS, DIRECTIONS)),
        _histogram(domain, counted.s[counted.counted], counted.amplitude[counted.counted]),
        (group,),
    )
    for j in range(n_y):
        by_speed, z = counted.by_speed(domain, j), counted.nominal[j]
        response = lagged_signals(domain, z + by_speed @ common[j]) @ deviations(domain)
        whitened = counted.whitened(j, by_speed, np.column_stack([lagged_signals(domain, z), response]))
        if whitened is None:
            continue
        y, signals, basis = whitened
        lagged, own = np.split(signals, [-DIRECTIONS], axis=1)
        X = (features[counted.counted][:, :, None] * lagged[:, None, :]).reshape(len(y), -1)
        X, y, own = (_without(basis, x) for x in (X, y, own))
        out.gram[j], out.cross[j] = X.T @ X, X.T @ y
        out.square[j], out.samples[j] = y @ y, len(y) - basis.shape[1]
        out.drive_gram[0, j], out.drive_cross[0, j], out.drive_own[0, j] = X.T @ own, y @ own, own.T @ own
    return out


def _histogram(domain: ErrorDomain, s: np.ndarray, a: np.ndarray) -> np.ndarray:
    """Counts (S, A) in cells of relative speed s (n,) and log amplitude a (n,)."""
    speed = np.clip(((s + 1) / 2 * SPEED_CELLS).astype(int), 0, SPEED_CELLS - 1)
    knots = domain.amplitude_knots
    cells = AMPLITUDE_CELLS_PER_KNOT * (len(knots) - 1)
    place = np.log(a / knots[0]) / np.log(knots[-1] / knots[0]) * cells
    out = np.zeros((SPEED_CELLS, cells))
    np.add.at(out, (speed, np.clip(place.astype(int), 0, cells - 1)), 1)
    return out
