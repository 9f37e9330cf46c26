"""Stage 5: scales of the diagnosis (T38; THEORY 7.9), from the errors of healthy vehicles.

The errors are those over windows of WINDOW_S of settled blocks. A share of their spread, one of KEPT, stays
constant within a drive.
"""

from __future__ import annotations

import ctypes
from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from typing import Any

import numpy as np
from scipy.fft import irfft, next_fast_len, rfft
from scipy.stats import chi2, t

from ..base import native
from ..base.errors import InputError
from ..base.layout import DIAGNOSIS
from ..core.seal import Sealed
from ..drives.frames import Estimator
from ..vehicle.project import Project
from .change import BLOCK, FIRST_BLOCK_END, block_means

WINDOW_S = 10.0
"""Settled time after an alarm that the diagnosis uses [s]."""
DELAYS, MOST_STRIDE, REACH_S = 6, 4, 0.5
"""Number of trial delays (LPVG_DIAGNOSIS_DELAYS), largest number of blocks between two of them, and their
wanted range [s]."""
CELL_S = 0.8
"""Length [s] of a cell of the ring buffer before an alarm, which dates the onset."""
PARTS = 4
UPPER = np.triu_indices(PARTS)
COVERED = 0.95
EXCITED = 0.05
"""Causes are judged only if the mean square of yhat, in units of its size, is at least this number."""
FITS = float(chi2.ppf(0.99, PARTS - 1))
MARGIN = 2.0
"""Least chi-squared distance between the best and the next cause, a likelihood ratio of e."""
ROUGHER, STILLER, STILLEST = 4.0, 0.05, 0.01
"""Limits of the causes noise and frozen output, relative to healthy drives.

Noise is above four times the largest healthy mean square within blocks. A frozen output moves by less than a
twentieth of the least healthy movement, and by less than a hundredth of the model's.
"""
KEPT = (0.0, 0.9, 0.99)
"""Possible shares of the spread that stay constant within a drive. A share below 0.9 counts as none, because
with two windows it makes no interval half as wide."""
GAP = 3
"""Number of windows from the last one of a past to the window that it predicts. Each window begins in the
middle of the previous one, so half a window lies between the past and the prediction, as before an average
alarm."""
STEPS, FEWER_STEPS = 200, 20
"""Number of expectation-maximisation steps: without a start, and from the result of nearly the same
windows."""


@dataclass(frozen=True)
class Windows:
    """Sums over W windows of a drive's settled blocks.

    Attributes
    ----------
    n : ndarray (W,), number of blocks
    gram : ndarray (W, n_y, 4, 4)
    along : ndarray (W, n_y, 4)
    square : ndarray (W, n_y), sum of squares of e
    rough, moved, still : ndarray (W, n_y)
        Mean squares of noise in blocks, of the changes of yhat and of the changes of y.
    correlated : ndarray (W, n_y), factor on the variance for the correlation of the residue
    """

    n: np.ndarray
    gram: np.ndarray
    along: np.ndarray
    square: np.ndarray
    rough: np.ndarray
    moved: np.ndarray
    still: np.ndarray
    correlated: np.ndarray

    @classmethod
    def joined(cls, parts: Sequence[Windows]) -> Windows:
        """Windows of several drives in sequence."""
        return cls(*(np.concatenate([getattr(p, name) for p in parts]) for name in vars(parts[0])))

    def select(self, chosen: np.ndarray) -> Windows:
        """The ``chosen`` (W,) windows."""
        return Windows(*(value[chosen] for value in vars(self).values()))

    @property
    def theta(self) -> np.ndarray:
        """Estimates theta (W, n_y, 4) by the formula of the core."""
        return np.linalg.solve(self._regular, self.along[..., None])[..., 0]

    @property
    def residue(self) -> np.ndarray:
        """Mean square (W, n_y) of the residue."""
        left = self.square - np.einsum("wji,wji->wj", self.along, self.theta)
        return np.maximum(left, 0.0) / self.n[:, None]

    def errors(self, correlated: np.ndarray) -> np.ndarray:
        """Covariance (W, n_y, 4, 4) of the estimation errors, with the factor ``correlated`` (n_y,)."""
        return (correlated * self.residue)[..., None, None] * np.linalg.inv(self._regular)

    def pasts(self) -> Windows:
        """Past of each window of a drive from the GAP-th on.

        It is the sum of the windows up to GAP earlier, without overlap.
        """
        sums = {name: getattr(self, name).copy() for name in ("n", "gram", "along", "square")}
        for value in sums.values():
            for k in range(2, len(value)):
                value[k] += value[k - 2]
        return replace(self, **sums).select(np.arange(len(self.n) - GAP))

    @property
    def _regular(self) -> np.ndarray:
        return self.gram + 1e-5 * self.n[:, None, None, None] * np.eye(PARTS)


def windows_of(
    e: np.ndarray, yhat: np.ndarray, v: np.ndarray, estimator: Estimator, unit: np.ndarray
) -> Windows:
    """Windows of a drive with e and yhat (N, n_y) and v (N,). Each starts in the middle of the previous one.

    ``unit`` (n_y, 2) is 1 / size of yhat and of its change from block to block. A short drive may have a
    single window of at least half the length.
    """
    ends = np.arange(FIRST_BLOCK_END, len(e), BLOCK)[1:]
    at = ends[:, None] + np.arange(1 - BLOCK, 1)
    whole = estimator.settled(v)[at].all(axis=1)
    taken = np.flatnonzero(whole[1:] & whole[:-1]) + 1
    mean_e, mean = (block_means(x, ends) for x in (e, yhat))
    change = np.diff(mean, axis=0, prepend=mean[:1])
    noise = 0.5 * ((e + yhat)[at] * np.array([1.0, -1.0, -1.0, 1.0])[:, None]).sum(axis=1)
    p = mean * unit[:, 0]
    phi = np.stack([p, -change * unit[:, 1], np.ones_like(p), p * np.abs(p)], axis=-1)
    length = round(WINDOW_S / (BLOCK * estimator.Ts))
    starts = range(0, max(len(taken) - length // 2, 0), length // 2)
    indices = [taken[s : s + length] for s in starts if s == 0 or s + length <= len(taken)]
    if not indices:
        return _empty(e.shape[1])
    index = np.stack(indices)  # a shorter window is the only one
    f, x = phi[index].transpose(0, 2, 3, 1), mean_e[index].swapaxes(1, 2)
    whole_change = change + np.diff(mean_e, axis=0, prepend=mean_e[:1])
    windows = Windows(
        np.full(len(index), float(index.shape[1])),
        f @ f.swapaxes(2, 3),
        (f @ x[..., None])[..., 0],
        (x**2).sum(axis=2),
        (noise[index] ** 2).mean(axis=1),
        (change[index] ** 2).mean(axis=1),
        (whole_change[index] ** 2).mean(axis=1),
        np.ones(x.shape[:2]),
    )
    left = x - (windows.theta[..., None, :] @ f)[..., 0, :]
    return replace(windows, correlated=_correlated(left))


def _empty(n_y: int) -> Windows:
    shapes = ((), (n_y, PARTS, PARTS), (n_y, PARTS), *[(n_y,)] * 5)
    return Windows(*(np.zeros((0, *shape)) for shape in shapes))


def _correlated(left: np.ndarray) -> np.ndarray:
    """Factor (W, n_y) on the variance: 1 + 2 times the sum of the correlations of the residues (W, n_y, M).

    The sum ends before the first correlation that is not positive.
    """
    blocks = left.shape[-1]
    padded = next_fast_len(2 * blocks, real=True)
    sums = irfft(np.abs(rfft(left, padded)) ** 2, padded)[..., : max(1, blocks // 2)]
    total = (left**2).sum(axis=-1, keepdims=True)
    share = np.divide(sums, total, out=np.zeros_like(sums), where=total > 0)[..., 1:]
    return 1 + 2 * (share * np.logical_and.accumulate(share > 0, axis=-1)).sum(axis=-1)


def _spread(theta: np.ndarray, errors: np.ndarray, start: np.ndarray | None = None) -> np.ndarray:
    """Second moments (n_y, 4, 4) of a random theta about 0, by expectation and maximisation.

    The estimates ``theta`` (W, n_y, 4) have the covariances ``errors`` (W, n_y, 4, 4). ``start`` (n_y, 4, 4)
    holds the moments of nearly the same windows. With S_w = moments + errors_w and u_w = S_w^-1 theta_w a
    step adds moments (mean of u u' - S^-1) moments.
    """
    theta = np.ascontiguousarray(np.moveaxis(theta, 0, -1))
    errors = np.ascontiguousarray(errors.transpose(2, 3, 1, 0))
    windows = theta.shape[-1]
    scale = np.sqrt((theta**2).mean(axis=-1)) + 1e-12
    moments = np.stack([np.diag(s**2) for s in scale])
    least = 1e-6 * moments
    if start is not None:
        moments = start
    for _ in range(STEPS if start is None else FEWER_STEPS):
        surplus = _surplus(theta, errors, moments)
        moments = moments + moments @ surplus @ moments / windows + least
    return (moments + moments.swapaxes(1, 2)) / 2


def _surplus(theta: np.ndarray, errors: np.ndarray, moments: np.ndarray) -> np.ndarray:
    """Sums (n_y, 4, 4) over windows of u u' - S^-1, for theta (n_y, 4, W), errors (4, 4, n_y, W), moments
    (n_y, 4, 4).
    """
    surplus = np.empty_like(moments)
    sizes = (ctypes.c_ssize_t(size) for size in (len(moments), theta.shape[-1]))
    arrays = (theta, errors, np.ascontiguousarray(moments), surplus)
    native.kernels("spread").lpvg_spread(*sizes, *map(native.pointer, arrays))
    return surplus


@dataclass(frozen=True)
class DiagnosisScales:
    """Scales of every output from the drives that set the bounds.

    Attributes
    ----------
    Ts : float, s
    unit : ndarray (n_y, 2), unit of the change test
    spread : ndarray (n_y, 4, 4), covariance of a healthy theta
    correlated : ndarray (n_y,), factor on the variance of the estimate of theta
    residue : ndarray (n_y, 2), see diagnosis.h
    rough, still : ndarray (n_y,), see diagnosis.h
    enlarged : ndarray (n_y,), factor that ``spread`` and ``correlated`` include
    interval : float, half width of a 95 % interval in standard deviations
    kept : ndarray (n_y,), share of the spread that stays constant within a drive
    windows, drives : int, number of windows and of drives
    """

    Ts: float
    unit: np.ndarray
    spread: np.ndarray
    correlated: np.ndarray
    residue: np.ndarray
    rough: np.ndarray
    still: np.ndarray
    enlarged: np.ndarray
    interval: float
    kept: np.ndarray
    windows: int
    drives: int

    @classmethod
    def from_windows(cls, project: Project, unit: np.ndarray, drives: Sequence[Windows]) -> DiagnosisScales:
        """Return the scales from the windows of the drives that set the bounds; ``unit`` (n_y, 2) are sizes.

        Raises InputError without a window.
        """
        drives = [w for w in drives if len(w.n)]
        if not drives:
            raise InputError(
                "diagnosis",
                "",
                "the drives that set the bounds have no window",
                f"at least {WINDOW_S / 2:g} s of settled driving in range",
            )
        every = Windows.joined(drives)
        correlated = every.correlated.mean(axis=0)
        theta, errors = every.theta, every.errors(correlated)
        spread = _spread(theta, errors)
        others = _of_others([len(w.n) for w in drives], theta, errors, spread)
        enlarged, interval = _needed(len(drives), theta, errors, others)
        y_square = every.gram[..., 0, 0] / every.n[:, None] * unit[:, 0] ** 2
        share = np.maximum((every.residue * y_square).sum(0) / (y_square**2).sum(0), 1e-6)
        constant = (every.residue - share * y_square).max(axis=0)
        least = 1e-6 * unit[:, 0] ** 2
        moving = every.moved > 0
        ratio = np.where(moving, every.still / np.where(moving, every.moved, 1.0), np.inf).min(axis=0)
        return cls(
            project.Ts_s,
            unit,
            enlarged[:, None, None] * spread,
            enlarged * correlated,
            np.column_stack([np.maximum(constant, least), share]),
            ROUGHER * np.maximum(every.rough.max(axis=0), least),
            np.clip(STILLER * ratio, 1e-6, STILLEST),
            enlarged,
            interval,
            _kept(drives, others, correlated, enlarged),
            len(every.n),
            len(drives),
        )

    @property
    def table(self) -> DiagnosisTable:
        """Table of the diagnosis in the core."""
        block_s = BLOCK * self.Ts
        n_y = len(self.unit)
        words = {
            **DIAGNOSIS.head({"NY": n_y}),
            "sample_period_us": round(self.Ts * 1e6),
            "blocks": max(8, round(WINDOW_S / block_s)),
            "stride": int(np.clip(np.ceil(REACH_S / (DELAYS * block_s)), 1, MOST_STRIDE)),
            "cell_blocks": max(1, round(CELL_S / block_s)),
        }
        reals = {
            "block_s": block_s,
            "unit": 1 / self.unit,
            "spread": self.spread[:, UPPER[0], UPPER[1]],
            "correlated": self.correlated,
            "residue": self.residue,
            "rough": self.rough,
            "still": self.still,
            "excited": EXCITED,
            "fits": FITS,
            "margin": MARGIN,
            "interval": self.interval,
            "kept": self.kept,
        }
        return DiagnosisTable({}, words, {name: np.array(value, float) for name, value in reals.items()})

    def to_dict(self) -> dict:
        """Content of diagnosis.json, for `restored`."""
        return {"window_s": WINDOW_S, **{k: v for k, v in vars(self).items() if k != "Ts"}}

    @classmethod
    def restored(cls, project: Project, data: dict) -> DiagnosisScales:
        """Scales from diagnosis.json. An older file has no ``kept``."""
        data = {"kept": np.zeros(project.n_y), **data}
        scalars: dict[str, Any] = {k: data[k] for k in ("interval", "windows", "drives")}
        arrays: dict[str, Any] = {
            k: np.array(v, float) for k, v in data.items() if k not in ("window_s", *scalars)
        }
        return cls(project.Ts_s, **scalars, **arrays)

    @property
    def least(self) -> np.ndarray:
        """Least visible change of gain, delay [s] and bias (n_y, 3).

        Longer records do not reduce it, because healthy vehicles differ by as much. For a gain g it is the
        change of (g - 1)/g, because g scales the spread.
        """
        spread = (1 - self.kept**2)[:, None, None] * self.spread
        alone = self.interval / np.sqrt(np.einsum("jii->ji", np.linalg.inv(spread)))
        return alone[:, : PARTS - 1] / np.column_stack(
            [self.unit / [1.0, BLOCK * self.Ts], np.ones(len(self.unit))]
        )

    def least_text(self, project: Project) -> str:
        """Text with `least` for each output."""
        return "; ".join(
            f"{s.name} gain from {1 / (1 + gain):.2f} to "
            f"{f'{1 / (1 - gain):.2f}' if gain < 1 else 'any above 1'}, "
            f"delay below {delay:.2g} s, bias below {bias:.2g} {s.unit}"
            for s, (gain, delay, bias) in zip(project.outputs, self.least, strict=True)
        )


@dataclass(frozen=True)
class DiagnosisTable(Sealed):
    """The scales in the form of the core (diagnosis.h)."""

    LAYOUT = DIAGNOSIS


def _of_others(
    windows: Sequence[int], theta: np.ndarray, errors: np.ndarray, spread: np.ndarray
) -> np.ndarray:
    """Spread (W, n_y, 4, 4) for each window, from all drives except its own. A single drive uses its own.

    ``windows`` are the numbers of windows of each drive, in the order of ``theta`` and ``errors``. ``spread``
    is that of all drives.
    """
    spreads = np.empty_like(errors)
    for first, end in pairwise(np.cumsum([0, *windows])):
        own = slice(first, end)
        rest, their = (x if len(windows) == 1 else np.delete(x, own, axis=0) for x in (theta, errors))
        spreads[own] = _spread(rest, their, spread)
    return spreads


def _needed(
    drives: int, theta: np.ndarray, errors: np.ndarray, others: np.ndarray
) -> tuple[np.ndarray, float]:
    """Factor (n_y,) >= 1 on the covariances, and half width of an interval in standard deviations.

    With the factor, a share COVERED of the windows lies within the region of the other drives. The half width
    is that of Student's t with as many degrees of freedom as drives, because each drive gives one about 0. It
    is larger where a share COVERED of the gains, delays or biases needs more, with all other parts free.
    ``others`` is the result of `_of_others`.
    """
    information = np.linalg.inv(others + errors)
    alone = (information @ theta[..., None])[..., 0]
    estimates = np.abs(alone) / np.sqrt(np.einsum("wjii->wji", information))
    squares = np.einsum("wji,wji->wj", theta, alone)
    enlarged = np.maximum(1.0, np.quantile(squares, COVERED, axis=0) / chi2.ppf(COVERED, PARTS))
    sizes = estimates[..., : PARTS - 1] / np.sqrt(enlarged)[:, None]
    usual = float(t.ppf((1 + COVERED) / 2, drives))
    return enlarged, max(usual, float(np.quantile(sizes, COVERED, axis=0).max()))


def _kept(
    drives: Sequence[Windows], others: np.ndarray, correlated: np.ndarray, enlarged: np.ndarray
) -> np.ndarray:
    """Share (n_y,) of KEPT that makes the windows most likely, or 0 where no drive is long enough.

    With it, a share COVERED of the windows lies within the region predicted from their past. ``others`` is
    the result of `_of_others`. ``correlated`` does not include ``enlarged`` yet.
    """
    noise, predictions, first = enlarged * correlated, [], 0
    for drive in drives:
        spread = enlarged[:, None, None] * others[first]
        first += len(drive.n)
        if len(drive.n) > GAP:
            predictions.append(np.array([_foretold(drive, noise, spread, share) for share in KEPT]))
    if not predictions:
        return np.zeros(len(enlarged))
    squares, sizes = np.concatenate(predictions, axis=2).swapaxes(0, 1)  # each (KEPT, windows, n_y)
    within = np.quantile(squares, COVERED, axis=1) <= chi2.ppf(COVERED, PARTS)
    within[0] = True
    likelihood = np.where(within, -(squares + sizes).sum(axis=1), -np.inf)
    return np.array(KEPT)[likelihood.argmax(axis=0)]


def _foretold(
    drive: Windows, noise: np.ndarray, spread: np.ndarray, share: float
) -> tuple[np.ndarray, np.ndarray]:
    """Chi-squared of the prediction of windows from their past, and log determinant of its covariance.

    Both are (W - GAP, n_y). The prediction is the best linear estimate if a ``share`` of the ``spread`` (n_y,
    4, 4) stays constant within the drive. ``noise`` (n_y,) is the factor on the variance of the estimates.
    """
    past, after = drive.pasts(), drive.select(np.arange(GAP, len(drive.n)))
    weights = share * spread @ np.linalg.inv(spread + past.errors(noise))
    beside = after.theta - (weights @ past.theta[..., None])[..., 0]
    covariance = spread - share * weights @ spread + after.errors(noise)
    squares = (beside * np.linalg.solve(covariance, beside[..., None])[..., 0]).sum(axis=-1)
    return squares, np.linalg.slogdet(covariance)[1]
