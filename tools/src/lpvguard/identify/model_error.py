"""Model error model (T30 to T33; THEORY 7.6): the part of the nominal error that the input explains, with its
standard error.

Its frames differ from those of the monitor. Only sums over the frames of a drive are kept. Drives are added
in the order of their names, so the result does not depend on their order in a folder.

Length: the three steps form one estimator. They are sums over frames, lines over pools of cells,
and the bound.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field, fields, replace
from functools import lru_cache, partial
from itertools import accumulate, pairwise, zip_longest
from typing import NamedTuple

import numpy as np
from scipy.linalg import solve_toeplitz
from scipy.signal import lfilter

from ..base.errors import InputError
from ..base.parallel import Map
from ..drives.frames import Estimator
from ..drives.tables import Drive, Experiment
from ..vehicle.nominal import NominalModel, evaluate
from ..vehicle.project import Project
from .error_band import LEVEL as BAND_LEVEL
from .error_band import ErrorBand, error_band
from .error_domain import ErrorDomain
from .error_sums import ErrorSums, joined
from .passes import DriveReader

PERIODS = (4, 8, 16, 32)
"""Lengths of frames in periods. Each length is twice the previous one."""
AR_ORDER, AR_FLOOR = 8, 1e-6
"""Order of the whitening filter, and the share of white noise that limits its gain to 60 dB."""
STEP = 10 ** (1 / 12)
"""Approximate distance between frequencies of the grid."""
SILENT = 2
"""Number of the highest grid frequencies at which a design assumes 1 + rho, as if no drive informed there."""
HIGHEST = 0.2
"""Highest frequency of the grid, as a share of the sampling rate."""
HELD = 0.8
"""Highest frequency of a band, as a share of the Nyquist frequency of the decimated signals."""
FEWEST_FRAMES = 8
"""A cell with fewer independent frames is pooled with its neighbour."""
LEAST_FRAMES, FEW_LEVEL = 3.0, 1e-4
"""Least number of frames in the pool of all cells, and the level of the F distribution for fewer than
FEWEST_FRAMES."""
INDEPENDENT = 1 / 1.056
"""Number of independent frames per Hann frame with half overlap."""
LEVEL = 0.05
"""1 - simultaneous confidence of all estimates."""
FOLDS = 64
"""Largest number of groups of drives with separate sums, for leave-one-out. Up to this number each drive is a
group."""
LEAST_SPREAD = 0.01
"""Least standard deviation of the speeds for a fitted slope, as a share of half the speed range."""
LACK_OF_FIT = 1e-3
"""Level of the test that rejects a pool because the line of one cell differs. A false rejection costs only
precision."""
ENDS = np.sqrt(3)
"""A line is evaluated at this number of standard deviations from the mean, the ends of uniformly distributed
speeds."""
TINY = 1e-300
NEARLY_SINGULAR = 1e-6
"""A 2 x 2 matrix is nearly singular if |determinant| / sum of squared entries is below this. Its inverse
loses half the digits."""
POWERS = 5
"""Number of powers of s, from 0 on, in the sums over frames."""
BIASED = (
    "delta_c is the least-squares estimate from the nominal output; a driver who steers against disturbances "
    "biases it, because no column with an external excitation is named"
)
INSTRUMENTAL = "delta_c is the instrumental estimate from the named column with an external excitation"
"""``claim`` of model_error.json, without and with an instrument."""
ASSUMED = "no reason stated: assumed that the vehicle responds no more than the model"
"""``reason`` of an output without a rho in the project, for which rho is 1."""


@dataclass(frozen=True)
class ErrorGrid:
    """Grid of the estimate: frequencies ``omega`` (G,) [rad/s], and edges of the speed and amplitude cells.

    The edges are ``speed_edges`` (C + 1,) [m/s] and ``amplitude_edges`` (A - 1,) [input unit].
    """

    Ts: float
    omega: np.ndarray
    speed_edges: np.ndarray
    amplitude_edges: np.ndarray

    @classmethod
    def from_project(cls, project: Project, estimator: Estimator) -> ErrorGrid:
        """Grid of the bins, with further points between and above them.

        Above the last bin the points have the ratio STEP, up to HIGHEST.
        """
        bins = estimator.omega[estimator.cycles > 0]
        kept = [bins[0]]
        for omega in bins[1:]:  # lines of the plain DFT are denser than needed
            if omega >= kept[-1] * STEP * (1 - 1e-3):
                kept.append(omega)
        points = [
            np.geomspace(a, b, 1 + round(np.log(b / a) / np.log(STEP)), endpoint=False)
            for a, b in pairwise(kept)
        ]
        beyond = kept[-1] * STEP ** np.arange(
            1 + np.log(2 * np.pi * HIGHEST / estimator.Ts / kept[-1]) // np.log(STEP)
        )
        omega = np.concatenate([*points, beyond])
        return cls(
            estimator.Ts,
            omega,
            np.linspace(*estimator.speed_range, project.model_error.speed_cells + 1),
            np.array(project.model_error.amplitude_edges, float),
        )

    @property
    def cells(self) -> tuple[int, int]:
        """Numbers of speed cells and of amplitude classes."""
        return len(self.speed_edges) - 1, len(self.amplitude_edges) + 1

    def relative(self, v: np.ndarray) -> np.ndarray:
        """Relative speed s, -1 to 1 over the range, in the shape of the speeds v [m/s]."""
        low, high = self.speed_edges[[0, -1]]
        return (v - 0.5 * (low + high)) / (0.5 * (high - low))

    def speed(self, s: np.ndarray) -> np.ndarray:
        """Speeds [m/s] of relative speeds s, in the shape of s."""
        low, high = self.speed_edges[[0, -1]]
        return 0.5 * (low + high) + 0.5 * (high - low) * s


class Sums(NamedTuple):
    """Sums over frames, (G, P, n_y, C, A, ...), with the relative speed s and R, the instrument or else Z.

    - ``ee`` sums |E|^2, and ``fourth`` sums |R|^4.
    - ``ze``, ``re`` (..., 2) sum s^k conj(Z) E and s^k conj(R) E.
    - ``zz``, ``rr``, ``rz`` (..., 3) sum s^k |Z|^2, s^k |R|^2 and s^k conj(R) Z.
    - ``ree`` (..., 3), ``rze`` (..., 4), ``rzz`` (..., 5) sum s^k |R|^2 times |E|^2, conj(Z) E and |Z|^2.
    """

    fourth: np.ndarray
    ee: np.ndarray
    ze: np.ndarray
    re: np.ndarray
    zz: np.ndarray
    rr: np.ndarray
    rz: np.ndarray
    ree: np.ndarray
    rze: np.ndarray
    rzz: np.ndarray

    @classmethod
    def none(cls, grid: ErrorGrid, n_y: int) -> Sums:
        """Sums without frames, all 0."""
        shape = (len(grid.omega), len(PERIODS), n_y, *grid.cells)
        return cls(
            fourth=np.zeros(shape),
            ee=np.zeros(shape),
            ze=np.zeros((*shape, 2), complex),
            re=np.zeros((*shape, 2), complex),
            zz=np.zeros((*shape, 3)),
            rr=np.zeros((*shape, 3)),
            rz=np.zeros((*shape, 3), complex),
            ree=np.zeros((*shape, 3)),
            rze=np.zeros((*shape, 4), complex),
            rzz=np.zeros((*shape, 5)),
        )

    @classmethod
    def of_moments(cls, moments: np.ndarray) -> Sums:
        """Sums from moments (..., m, POWERS) of products times powers of s.

        The products are |E|^2, conj(Z) E (real and imaginary part), |Z|^2, and |R|^2 times each of these. If
        R is not Z, conj(R) E, |R|^2, conj(R) Z and |R|^4 follow.
        """

        def real(row: int, powers: int) -> np.ndarray:
            return moments[..., row, :powers].copy()

        def both(row: int, powers: int) -> np.ndarray:
            return real(row, powers) + 1j * real(row + 1, powers)

        alone = moments.shape[-2] == 8
        return cls(
            fourth=real(7 if alone else 13, 1)[..., 0],
            ee=real(0, 1)[..., 0],
            ze=both(1, 2),
            re=both(1 if alone else 8, 2),
            zz=real(3, 3),
            rr=real(3 if alone else 10, 3),
            rz=real(3, 3).astype(complex) if alone else both(11, 3),
            ree=real(4, 3),
            rze=both(5, 4),
            rzz=real(7, 5),
        )

    @property
    def independent(self) -> np.ndarray:
        """Effective number of independent frames, (sum |R|^2)^2 / sum |R|^4, reduced for overlap."""
        return INDEPENDENT * self.rr[..., 0] ** 2 / np.maximum(self.fourth, TINY)

    def plus(self, other: Sums) -> Sums:
        """Sums of the frames of both."""
        return Sums(*(a + b for a, b in zip(self, other, strict=True)))


def prediction_error_filter(x: np.ndarray) -> np.ndarray:
    """Coefficients 1 + a_1 z^-1 + ... (AR_ORDER + 1,) of the filter that whitens x (N,).

    They solve the Yule-Walker equations, with AR_FLOOR added at lag 0.
    """
    x = x - x.mean()
    lags = np.array([x[: len(x) - k] @ x[k:] for k in range(AR_ORDER + 1)])
    if not lags[0] > 0:
        return np.eye(1, AR_ORDER + 1)[0]
    lags[0] *= 1 + AR_FLOOR
    return np.r_[1.0, -solve_toeplitz(lags[:-1], lags[1:])]


def drive_sums(
    grid: ErrorGrid,
    model: NominalModel,
    estimator: Estimator,
    excited_std: float,
    drive: Drive,
    e: np.ndarray,
    yhat: np.ndarray,
) -> Sums:
    """Sums of one drive over its excited frames.

    In these the rms of the first input exceeds ``excited_std`` [input unit]. e and yhat (N, n_y) are in
    output units.
    """
    settled = estimator.settled(drive.v)
    if settled.sum() < 2 * AR_ORDER:
        return Sums.none(grid, model.n_y)
    signals, filters, lags = [], [], np.arange(AR_ORDER + 1)
    for j in range(model.n_y):
        whiten = prediction_error_filter(yhat[settled, j])
        filters.append(whiten)
        outside = [] if drive.instrument is None else [drive.instrument]
        signals += [lfilter(whiten, [1.0], x) for x in (e[:, j], yhat[:, j], *outside)]
    stacked = np.array(signals)
    each = len(stacked) // model.n_y
    power = np.r_[0.0, np.cumsum((drive.u[:, 0] - model.input_offset[0]) ** 2)]
    total, whole = (np.r_[0.0, np.cumsum(x)] for x in (drive.v, settled))
    frame_sets: list[_Frames] = []
    for g, omega in enumerate(grid.omega):
        whitened = np.repeat(np.abs(np.array(filters) @ np.exp(-1j * omega * grid.Ts * lags)), each)
        for p, periods in enumerate(PERIODS):
            half = round(periods * np.pi / omega / grid.Ts)
            length, halves = 2 * half, len(drive.t) // half
            if length > len(drive.t):
                break
            each_half = half * np.arange(halves)
            low, high = (x.reduceat(drive.v[: halves * half], each_half) for x in (np.minimum, np.maximum))
            driven, inside, square = (x[: halves * half + 1 : half] for x in (total, whole, power))
            speed = (driven[2:] - driven[:-2]) / length
            tolerance = estimator.speed_tolerance * speed
            good = inside[2:] - inside[:-2] == length
            good &= np.maximum(high[1:], high[:-1]) - speed <= tolerance
            good &= speed - np.minimum(low[1:], low[:-1]) <= tolerance
            amplitude = np.sqrt(2 * (square[2:] - square[:-2]) / length)
            good &= amplitude > np.sqrt(2) * excited_std
            if not good.any():
                continue
            frames = (
                _by_halves(stacked[:, : halves * half], _kernel(omega * grid.Ts, half))[:, good]
                / whitened[:, None]
            )
            frame_sets.append(_Frames((g, p), frames, speed[good], amplitude[good]))
    rows = 8 if drive.instrument is None else 14
    moments = np.zeros((len(grid.omega), len(PERIODS), model.n_y, *grid.cells, rows, POWERS))
    if frame_sets:
        _add(moments, grid, frame_sets)
    return Sums.of_moments(moments)


@lru_cache(maxsize=1024)
def _kernel(angle: float, half: int) -> np.ndarray:
    """Hann window times an exponential that turns by ``angle`` per sample, (half, 4), cached in each process.

    The columns are the real and imaginary parts of the first half, and then those of the second half.
    """
    n = np.arange(2 * half)
    window = 0.5 - 0.5 * np.cos(2 * np.pi * n / len(n))
    parts = (window * np.exp(-1j * angle * n)).reshape(2, -1)
    return np.stack([x for k in parts for x in (k.real, k.imag)], axis=1)


def _by_halves(signals: np.ndarray, kernel: np.ndarray) -> np.ndarray:
    """Frames (m, N / h - 1) of signals (m, N) that start every h samples, by their ``kernel`` (h, 4).

    Each half frame is the second half of one frame and the first half of the next. It is computed once for
    both.
    """
    sums = signals.reshape(len(signals), -1, len(kernel)) @ kernel
    return np.ascontiguousarray(sums[:, :-1, :2] + sums[:, 1:, 2:]).view(complex)[..., 0]


class _Frames(NamedTuple):
    """Counted frames of one drive, one frequency and one length, whose indices are ``at`` (g, p).

    Complex ``frames`` (m, F) holds E, Z and, if R is not Z, R of each output in turn. speed and amplitude are
    (F,).
    """

    at: tuple[int, int]
    frames: np.ndarray
    speed: np.ndarray
    amplitude: np.ndarray


def _add(moments: np.ndarray, grid: ErrorGrid, frame_sets: list[_Frames]) -> None:
    """Add frames to their cells of ``moments``. The order of the frames in a cell stays the same."""
    n_y = moments.shape[2]
    speed, amplitude = (
        np.concatenate([getattr(f, name) for f in frame_sets]) for name in ("speed", "amplitude")
    )
    frames = np.concatenate([f.frames for f in frame_sets], axis=1)
    cell = np.clip(np.searchsorted(grid.speed_edges, speed, "right") - 1, 0, grid.cells[0] - 1)
    within = cell * grid.cells[1] + np.searchsorted(grid.amplitude_edges, amplitude, "right")
    owner = np.repeat(np.arange(len(frame_sets)), [len(f.speed) for f in frame_sets])
    places = owner * np.prod(grid.cells) + within
    order = np.argsort(places, kind="stable")
    places, s = places[order], grid.relative(speed[order])
    products = _products(frames[:, order].reshape(n_y, -1, len(order)))
    powers = np.vander(s, POWERS, increasing=True)
    edges = np.flatnonzero(np.r_[True, places[1:] != places[:-1], True])
    cells = np.stack(np.unravel_index(places[edges[:-1]], (len(frame_sets), *grid.cells)), axis=1).tolist()
    for (k, c, a), (first, end) in zip(cells, pairwise(edges.tolist()), strict=True):
        moments[(*frame_sets[k].at, slice(None), c, a)] += products[..., first:end] @ powers[first:end]


def _products(frames: np.ndarray) -> np.ndarray:
    """Products (n_y, m, F) of frames (n_y, 3 or 2, F), in the order of ``Sums.of_moments``."""
    E, Z, R = np.moveaxis(frames, 1, 0)[[0, 1, -1]]
    EE, ZZ, ZE = np.abs(E) ** 2, np.abs(Z) ** 2, Z.conj() * E
    RR = ZZ if frames.shape[1] == 2 else np.abs(R) ** 2
    rows = [EE, ZE.real, ZE.imag, ZZ, RR * EE, RR * ZE.real, RR * ZE.imag, RR * ZZ]
    if frames.shape[1] == 3:
        RE, RZ = R.conj() * E, R.conj() * Z
        rows += [RE.real, RE.imag, RR, RZ.real, RZ.imag, RR**2]
    return np.stack(rows, axis=1)


def model_error_pass(reader: DriveReader, grid: ErrorGrid, experiment: Experiment) -> Sums:
    """Sums of one drive, which a worker reads."""
    excited_std = reader.project.frame_test.excited_std
    return drive_sums(grid, reader.model, reader.estimator, excited_std, *reader.read(experiment))


@dataclass(frozen=True)
class ErrorEstimate:
    """Estimates (G, n_y, C, A) of every cell, at the speed of the cell with the largest |delta_c| + k se.

    They are NaN without frames. Pooled cells have equal estimates.

    Attributes
    ----------
    delta : ndarray (G, n_y, C, A) of complex, delta_c
    se : ndarray (G, n_y, C, A), standard error of delta_c
    v : ndarray (G, n_y, C, A), m/s
    n : ndarray (G, n_y, C, A), number of independent frames
    periods : ndarray (G, n_y, C, A), periods in a frame
    moved : ndarray (G, n_y, C, A)
        Change by frames of twice the length, in standard errors, inf if unknown.
    coherent : ndarray (G, n_y, C, A), share of sum |E|^2 that delta_c Z explains
    """

    delta: np.ndarray
    se: np.ndarray
    v: np.ndarray
    n: np.ndarray
    periods: np.ndarray
    moved: np.ndarray
    coherent: np.ndarray

    @property
    def k(self) -> float:
        """Factor for the simultaneous level, sqrt(ln(N/LEVEL)) for N complex estimates (T31).

        A pool counts once.
        """
        estimates = self.se.reshape(-1, np.prod(self.se.shape[2:], dtype=int))
        N = sum(len(np.unique(row[np.isfinite(row)])) for row in estimates)
        return float(np.sqrt(np.log(max(1, N) / LEVEL)))

    @property
    def upper(self) -> np.ndarray:
        """Upper bound |delta_c| + k se, inf without an estimate."""
        return np.where(np.isfinite(self.se), np.abs(self.delta) + self.k * self.se, np.inf)

    @property
    def lower(self) -> np.ndarray:
        """Lower bound |delta_c| - k se, at least 0, and 0 without an estimate."""
        return np.where(np.isfinite(self.se), np.maximum(np.abs(self.delta) - self.k * self.se, 0.0), 0.0)

    @property
    def tells(self) -> np.ndarray:
        """Mask (G, n_y) of informative frequencies.

        There k se < 1 in all cells, so they refute a vehicle without response.
        """
        return np.all(np.where(np.isfinite(self.se), self.k * self.se, np.inf) < 1, axis=(2, 3))

    def to_dict(self) -> dict:
        """Convert to JSON types for `from_dict`, with k."""
        columns = {f.name: getattr(self, f.name) for f in fields(self) if f.name != "delta"}
        return {"k": self.k, "delta_re": self.delta.real, "delta_im": self.delta.imag, **columns}

    @classmethod
    def from_dict(cls, data: dict) -> ErrorEstimate:
        """Estimate from the result of `to_dict`."""
        columns = {f.name: np.array(data[f.name], float) for f in fields(cls) if f.name != "delta"}
        columns["moved"] = np.where(np.isnan(columns["moved"]), np.inf, columns["moved"])
        re, im = (np.array(data[key], float) for key in ("delta_re", "delta_im"))
        return cls(delta=re + 1j * im, **columns)

    @classmethod
    def from_sums(cls, sums: Sums, grid: ErrorGrid) -> ErrorEstimate:
        """Estimate from sums, with the best length of frames.

        The best length has the narrowest pool. Among lengths with equal pools, it is the converged length
        with the least standard error. If none has converged, it is the length with the least change by
        doubling, in standard errors.
        """
        pools = _pools(sums)
        pool = _chosen(pools)
        fit = pools[-1]
        for k in range(len(pools) - 2, -1, -1):
            fit = fit.replaced(pool <= k, pools[k])
        s = fit.worst_end()
        delta, se = (x[..., 0] for x in fit.at(s[..., None]))
        se = se * _few(fit.n)
        enough = np.isfinite(se) & (fit.n >= LEAST_FRAMES)
        moved = np.full(se.shape, np.inf)
        for k, lines in enumerate(pools):
            # The line of frames of twice the length, over the same pool and at the same speed.
            twice, spread = (x[..., 0] for x in lines.doubled().at(s[:, :-1, ..., None]))
            here = enough[:, :-1] & (pool[:, :-1] == k) & np.isfinite(spread)
            moved[:, :-1][here] = np.abs(delta[:, :-1] - twice)[here] / np.maximum(spread[here], TINY)
        rank = np.where(moved < 1, se / (1 + se), 2 + np.minimum(moved, 1e6)) + 1e7 * pool
        best = np.argmin(np.where(enough, rank, np.inf), axis=1)[:, None]

        def taken(x: np.ndarray) -> np.ndarray:
            return np.take_along_axis(x, best, 1)[:, 0]

        known = taken(enough)
        return cls(
            np.where(known, taken(delta), np.nan),
            np.where(known, taken(se), np.nan),
            np.where(known, grid.speed(taken(s)), np.nan),
            taken(fit.n),
            np.array(PERIODS)[best[:, 0]],
            taken(moved),
            1.0 - taken(fit.residue),
        )


@dataclass(frozen=True)
class _Lines:
    """Lines a + b s of every cell (G, P, n_y, C, A): theta (..., 2), covariance (..., 2, 2), and statistics.

    ``mean`` and ``spread`` are the mean and standard deviation of s over the frames. ``n`` is the number of
    independent frames. ``residue`` is its share of sum |E|^2.
    """

    theta: np.ndarray
    covariance: np.ndarray
    mean: np.ndarray
    spread: np.ndarray
    n: np.ndarray
    residue: np.ndarray

    def at(self, s: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """delta_c and its standard error at s (..., m), in the shape of s."""
        row = np.stack([np.ones_like(s), s], axis=-1)
        square = np.einsum("...mi,...ij,...mj->...m", row, self.covariance, row).real
        return np.einsum("...mi,...i->...m", row, self.theta), np.sqrt(np.maximum(square, 0.0))

    def ends(self, deviations: float) -> np.ndarray:
        """Relative speeds s (..., 2) that lie ``deviations`` standard deviations below and above the mean."""
        away = deviations * self.spread[..., None] * np.array([-1, 1])
        return np.clip(self.mean[..., None] + away, -1, 1)

    def worst_end(self) -> np.ndarray:
        """Relative speed s at the end of each cell with the larger |delta_c| + 3 se."""
        ends = self.ends(ENDS)
        delta, se = self.at(ends)
        size = np.abs(delta) + 3 * se
        end = np.argmax(np.where(np.isfinite(size), size, -1.0), axis=-1)
        return np.take_along_axis(ends, end[..., None], -1)[..., 0]

    def replaced(self, where: np.ndarray, other: _Lines) -> _Lines:
        """These lines, replaced by the ``other`` lines at ``where`` (G, P, n_y, C, A)."""

        def one(mine: np.ndarray, theirs: np.ndarray) -> np.ndarray:
            return np.where(where.reshape(*where.shape, *[1] * (mine.ndim - where.ndim)), theirs, mine)

        return _Lines(*(one(getattr(self, f.name), getattr(other, f.name)) for f in fields(self)))

    def doubled(self) -> _Lines:
        """Lines of frames of twice the length, for all but the last of the P lengths."""
        return _Lines(*(getattr(self, f.name)[:, 1:] for f in fields(self)))


def _quantile(n: np.ndarray, level: float) -> np.ndarray:
    """Number of standard errors that |delta - delta_c| exceeds with probability ``level``.

    n is the number of independent frames. |delta - delta_c|^2 / se^2 has the distribution F(2, 2 nu) with nu
    = n - 2.
    """
    freedom = np.maximum(n - 2, 1.0)
    return np.sqrt(freedom * np.expm1(-np.log(level) / freedom))


def _few(n: np.ndarray) -> np.ndarray:
    """Factor that enlarges the standard errors of n < FEWEST_FRAMES frames, 1 elsewhere.

    With it they have the same quantile as those of many frames.
    """
    return np.where(n < FEWEST_FRAMES, _quantile(n, FEW_LEVEL) / np.sqrt(-np.log(FEW_LEVEL)), 1.0)


def _fitted(s: Sums) -> _Lines:
    """Fit the line of every cell by (instrumental) least squares.

    b is 0 where the frames have a single speed or are too few for a slope.
    """
    n, weight = s.independent, np.maximum(s.rr[..., 0], TINY)
    mean = s.rr[..., 1] / weight
    spread = np.sqrt(np.maximum(s.rr[..., 2] / weight - mean**2, 0.0))
    sloped = (spread > LEAST_SPREAD) & (n >= FEWEST_FRAMES)
    empty = (n < 2) | ~(np.abs(s.rz[..., 0]) > 0)

    def matrix(sums: np.ndarray) -> np.ndarray:
        M = sums[..., np.add.outer(np.arange(2), np.arange(2))].astype(complex)
        M[..., 0, 1] *= sloped
        M[..., 1, 0] *= sloped
        M[..., 1, 1] = np.where(sloped, M[..., 1, 1], M[..., 0, 0])
        return M

    RZ, ZZ = matrix(s.rz), matrix(s.zz)
    RZ[empty] = np.eye(2)
    scale = np.abs(RZ[..., 0, 0])[..., None, None]
    inverse = _inverse(RZ / scale) / scale
    keep = np.stack([np.ones_like(sloped), sloped], axis=-1)
    theta = (inverse @ (s.re * keep)[..., None])[..., 0] * keep
    explained = np.einsum("...i,...ij,...j->...", theta.conj(), ZZ, theta).real
    residue = np.maximum(s.ee - 2 * (theta.conj() * s.ze).sum(axis=-1).real + explained, 0.0)
    # White's covariance allows a residue of different size in each frame. Overlapping frames count as fewer.
    few = n / np.maximum(n - 1 - sloped, 1e-9) / INDEPENDENT
    covariance = inverse @ _scatter(s, theta) @ np.conj(np.swapaxes(inverse, -1, -2)) * few[..., None, None]
    covariance = covariance * keep[..., None] * keep[..., None, :]
    theta[empty], covariance[empty] = np.nan, np.nan
    return _Lines(theta, covariance, mean, spread, n, residue / np.maximum(s.ee, TINY))


def _inverse(M: np.ndarray) -> np.ndarray:
    """Inverses of M (..., 2, 2), or pseudo-inverses where M is nearly singular."""
    det = M[..., 0, 0] * M[..., 1, 1] - M[..., 0, 1] * M[..., 1, 0]
    near = np.abs(det) <= NEARLY_SINGULAR * (np.abs(M) ** 2).sum(axis=(-2, -1))
    out = np.empty_like(M)
    out[..., 0, 0], out[..., 1, 1] = M[..., 1, 1], M[..., 0, 0]
    out[..., 0, 1], out[..., 1, 0] = -M[..., 0, 1], -M[..., 1, 0]
    out /= np.where(near, 1.0, det)[..., None, None]
    out[near] = np.linalg.pinv(M[near], rcond=1e-12)
    return out


def _scatter(s: Sums, theta: np.ndarray) -> np.ndarray:
    """Sum (..., 2, 2) of |R|^2 |E - (a + b s) Z|^2 [1 s; s s^2] over the frames, with theta = (a, b)."""
    a, b = theta[..., 0, None], theta[..., 1, None]
    moments = (
        s.ree
        - 2 * (a.conj() * s.rze[..., :3] + b.conj() * s.rze[..., 1:]).real
        + np.abs(a) ** 2 * s.rzz[..., :3]
        + 2 * (a.conj() * b).real * s.rzz[..., 1:4]
        + np.abs(b) ** 2 * s.rzz[..., 2:]
    )
    # Rounding may make an even moment negative. The moment of s may have either sign.
    moments[..., ::2] = np.maximum(moments[..., ::2], 0.0)
    return moments[..., np.add.outer(np.arange(2), np.arange(2))]


def _joined(second: np.ndarray, fourth: np.ndarray) -> np.ndarray:
    """Number (N, K), from 0 on, of the group of each of K neighbouring classes.

    Groups are joined until each has FEWEST_FRAMES or only one group remains. ``second`` and ``fourth`` (N, K)
    are the sums of |R|^2 and |R|^4 of each class. The group with the fewest frames is joined first, with the
    smaller of its neighbours.
    """
    every = np.arange(second.shape[1])
    groups = np.broadcast_to(every, second.shape)
    for _ in every[1:]:
        inside = groups[:, None] == every[:, None]
        sums = [np.where(inside, x[:, None], 0.0).sum(axis=2) for x in (second, fourth)]
        n = np.where(inside.any(axis=2), INDEPENDENT * sums[0] ** 2 / np.maximum(sums[1], TINY), np.inf)
        k = n.argmin(axis=1)[:, None]
        beside = np.pad(n, ((0, 0), (1, 1)), constant_values=np.inf)
        left, right = (np.take_along_axis(beside, k + i, 1) for i in (0, 2))
        short = (np.take_along_axis(n, k, 1) < FEWEST_FRAMES) & (groups.max(axis=1, keepdims=True) > 0)
        groups = groups - (short & (groups > np.where(left <= right, k - 1, k)))
    return groups


def _shared(s: Sums, cells: int) -> Sums:
    """Sums over groups of ``cells`` neighbouring speed cells. Each cell gets the sums of its group."""

    def one(field: np.ndarray) -> np.ndarray:
        shape = field.shape
        parts = field.reshape(*shape[:3], shape[3] // cells, cells, *shape[4:])
        return np.broadcast_to(parts.sum(axis=4, keepdims=True), parts.shape).reshape(shape)

    return Sums(*map(one, s))


def _classes_joined(s: Sums) -> Sums:
    """Sums in which amplitude classes with fewer than FEWEST_FRAMES frames are joined with neighbours.

    Each class gets the sums of its joined classes.
    """
    second, fourth = (x.sum(axis=3) for x in (s.rr[..., 0], s.fourth))
    groups = _joined(*(x.reshape(-1, x.shape[-1]) for x in (second, fourth))).reshape(second.shape)
    same = (groups[..., :, None] == groups[..., None, :]).astype(float)[..., None, :, :]

    def one(field: np.ndarray) -> np.ndarray:
        return (same @ field.reshape(*s.ee.shape, -1)).reshape(field.shape)

    return Sums(*map(one, s))


def _pools(sums: Sums) -> list[_Lines]:
    """Lines of every cell over pools of one, two, four, ... speed cells, up to all."""
    joined, cells = _classes_joined(sums), sums.ee.shape[3]
    return [_fitted(_shared(joined, 2**k)) for k in range(cells.bit_length())]


def _chosen(pools: list[_Lines]) -> np.ndarray:
    """Index (G, P, n_y, C, A) of the pool of every cell: the widest pool that fits its cells.

    A pool fits if its line agrees with that of each of its cells with FEWEST_FRAMES frames, at the level
    LACK_OF_FIT. They are compared one standard deviation of speed below and above the mean. A pool that is
    rejected with one length of frames is rejected with all. A pool with fewer than FEWEST_FRAMES frames is
    replaced by the next wider one.
    """
    own, cells = pools[0], pools[0].n.shape[3]
    ends = own.ends(1.0)
    delta, se = own.at(ends)
    allowed = _quantile(own.n, LACK_OF_FIT)[..., None]
    chosen, undecided = np.zeros(own.n.shape, int), np.ones(own.n.shape, bool)
    for k in range(len(pools) - 1, 0, -1):
        with np.errstate(invalid="ignore"):
            away = (np.abs(delta - pools[k].at(ends)[0]) > allowed * se).any(axis=-1)
        refuted = (away & (own.n >= FEWEST_FRAMES)).any(axis=1)
        parts = refuted.reshape(*refuted.shape[:2], cells >> k, 1 << k, -1).any(axis=3)
        refuted = np.repeat(parts, 1 << k, axis=2)[:, None]
        chosen[undecided & ~refuted] = k
        undecided = undecided & refuted
    for k, lines in enumerate(pools[:-1]):
        chosen[(chosen == k) & (lines.n < FEWEST_FRAMES)] = k + 1
    return chosen


def claim(project: Project) -> str:
    """Describe delta_c and its possible bias, in words.

    Parameters
    ----------
    project : Project

    Returns
    -------
    str
    """
    return BIASED if project.model_error.instrument is None else INSTRUMENTAL


def beyond(project: Project, grid: ErrorGrid) -> np.ndarray:
    """Return the bound 1 + rho on |delta| where no drive informs. rho is a bound on |G/P|.

    Parameters
    ----------
    project : Project
    grid : ErrorGrid

    Returns
    -------
    ndarray (G, n_y), at least 2

    Raises
    ------
    InputError
        If the ratio of the project is below 1 or not finite at some frequency.

    References
    ----------
    THEORY 7.6, (T32).
    """
    stated = {b.output: b for b in project.model_error.beyond}
    columns = []
    for signal in project.outputs:
        if signal.name not in stated:
            columns.append(np.full(len(grid.omega), 2.0))
            continue
        where = f"vehicle {project.name}, model_error.beyond of {signal.name}"
        rho = np.broadcast_to(
            evaluate(stated[signal.name].ratio, {"omega": grid.omega}, where), grid.omega.shape
        )
        if not (np.isfinite(rho) & (rho >= 1)).all():
            raise InputError(
                where, "ratio", f"a least value of {rho.min():.6g}", "at least 1 at every frequency"
            )
        columns.append(1 + rho)
    return np.column_stack(columns)


def last_telling(estimate: ErrorEstimate) -> np.ndarray:
    """Return the index of the last informative grid frequency.

    Parameters
    ----------
    estimate : ErrorEstimate

    Returns
    -------
    ndarray (n_y,) of int, -1 without an informative frequency
    """
    return np.array([np.flatnonzero(tells)[-1] if tells.any() else -1 for tells in estimate.tells.T])


def uncertainty_bound(project: Project, grid: ErrorGrid, estimate: ErrorEstimate) -> np.ndarray:
    """Bound (G, n_delta) that W_delta must cover (T31, T32).

    Up to the last informative frequency it is the largest |delta_c| + k se of all cells. At an uninformative
    frequency it is at most 1 + rho, unless |delta_c| - k se is larger. Above the last informative frequency
    it is at least 1 + rho. In a design, the last SILENT frequencies of the grid also count as above it.
    """
    upper, lower = (x.max(axis=(2, 3)) for x in (estimate.upper, estimate.lower))
    dead = beyond(project, grid)
    out = np.where(estimate.tells, upper, np.maximum(np.minimum(upper, dead), lower))
    after = np.arange(len(grid.omega))[:, None] > np.minimum(last_telling(estimate), _last(project, grid))
    out = np.where(after, np.maximum(dead, lower), out)
    return out if project.n_delta == project.n_y else out.max(axis=1, keepdims=True)


def band_bound(project: Project, grid: ErrorGrid, bands: list[ErrorBand]) -> np.ndarray:
    """Compute the bound (G, n_delta) that W_delta must cover by the ``bands`` of all outputs.

    The frequencies of the bands are the first ones of the grid. A band gives no information at a speed and
    amplitude with k sd >= 1 + rho. There, and above the frequencies of the band, the bound is 1 + rho, unless
    the lower bound of the band is larger (T32). In a design, the last SILENT frequencies of the grid also
    count as above the band.
    """
    out = beyond(project, grid)
    for j, band in enumerate(bands):
        dead = out[: len(band.omega), j, None, None]
        informed = (np.arange(len(band.omega)) <= _last(project, grid))[:, None, None]
        needed = np.where(informed & (band.k * band.sd < dead), band.upper, np.maximum(dead, band.lower))
        out[: len(band.omega), j] = needed.max(axis=(1, 2))
    return out if project.n_delta == project.n_y else out.max(axis=1, keepdims=True)


def _last(project: Project, grid: ErrorGrid) -> int:
    """Index of the last grid frequency that may be informative."""
    return len(grid.omega) - 1 - SILENT * (project.design is not None)


def band_frequencies(grid: ErrorGrid, domain: ErrorDomain) -> np.ndarray:
    """Select the grid frequencies (F,) [rad/s] that the decimated signals contain."""
    return grid.omega[grid.omega <= HELD * np.pi / domain.step_s]


def bands_of(
    domain: ErrorDomain, omega: np.ndarray, seed: int, likes: list[ErrorBand] | None, sums: ErrorSums
) -> list[ErrorBand]:
    """Band of every output from the ``sums`` of drives, at ``omega`` (G,) [rad/s].

    ``likes`` are the bands of more drives, whose hyperparameters are used.
    """
    return [
        error_band(domain, sums, j, omega, seed, like=None if likes is None else likes[j])
        for j in range(len(sums.gram))
    ]


@dataclass(frozen=True)
class ModelError:
    """Model error model of an identification.

    Attributes
    ----------
    grid : ErrorGrid
    setting : ErrorEstimate, estimate from the drives that set the bounds
    bound : ndarray (G, n_delta), bound from ``setting``, or from ``bands`` without a ceiling on nu
    judging : ErrorEstimate or None, estimate from the drives that judge the bound
    left_out : list of float
        For each fold, the least ratio of the bound of the other folds to its |delta_c| - k se. It is inf
        where this is nowhere above 0.
    bands : list of dict, for each output the band of a further drive
    """

    grid: ErrorGrid
    setting: ErrorEstimate
    bound: np.ndarray
    judging: ErrorEstimate | None
    left_out: list[float]
    bands: list[dict] = field(default_factory=list)

    @classmethod
    def from_sums(
        cls, project: Project, grid: ErrorGrid, setting: list[Sums], judging: list[Sums], workers: Map = map
    ) -> ModelError:
        """Model error from the sums of folds of drives.

        ``setting`` must have at least one fold. ``workers`` run the folds in parallel.
        """
        estimate = ErrorEstimate.from_sums(_total(setting), grid)
        return cls(
            grid,
            estimate,
            uncertainty_bound(project, grid, estimate),
            ErrorEstimate.from_sums(_total(judging), grid) if judging else None,
            list(workers(partial(_left_out, project, grid), _each_and_others(setting))),
        )

    def with_bands(
        self,
        project: Project,
        domain: ErrorDomain,
        sums: list[ErrorSums],
        folds: list[ErrorEstimate],
        workers: Map = map,
    ) -> ModelError:
        """The model error with the bands of ``sums``, one for each fold.

        ``folds`` are the separate estimates of each fold. Without a ceiling on nu, the bands set the bound.
        """
        fit_bands = partial(bands_of, domain, band_frequencies(self.grid, domain), project.seed)
        bands = fit_bands(None, joined(sums))
        with_bands = replace(
            self,
            bands=[
                {
                    "omega_rad_s": b.omega,
                    "speed_mps": b.speed,
                    "amplitude": b.amplitude,
                    "upper": b.upper,
                    "lower": b.lower,
                    "typical": b.typical(project.frame_test.alpha),
                    "k": b.k,
                    "level": 1 - BAND_LEVEL,
                    "hyperparameters": b.hyper,
                }
                for b in bands
            ],
        )
        if project.bounds.nu_ceiling is not None:
            return with_bands
        others = [joined(sums[:k] + sums[k + 1 :]) for k in range(len(sums))] if len(sums) > 1 else []
        ratios = [
            covered(band_bound(project, self.grid, left), own)
            for left, own in zip(workers(partial(fit_bands, bands), others), folds, strict=False)
        ]
        return replace(with_bands, bound=band_bound(project, self.grid, bands), left_out=ratios)

    def at_bins(self, estimator: Estimator) -> np.ndarray:
        """Bound (K, n_delta) at the bins, 0 at DC."""
        return np.where(estimator.cycles[:, None] > 0, self.bound[self._places(estimator)], 0.0)

    def typical(self, estimator: Estimator) -> np.ndarray:
        """Compute the typical error (K, n_delta) of a further drive at the bins, from the bands.

        It is the median over speeds and amplitudes. DC has the error of the lowest frequency.
        """
        each = np.column_stack([np.array(b["typical"])[self._places(estimator)] for b in self.bands])
        return each if self.bound.shape[1] > 1 else each.max(axis=1, keepdims=True)

    def _places(self, estimator: Estimator) -> np.ndarray:
        """Index (K,) of the grid frequency of each bin. DC has the lowest frequency."""
        bins = np.maximum(estimator.omega, self.grid.omega[0])
        return np.argmin(np.abs(np.log(bins[:, None] / self.grid.omega)), axis=1)

    @property
    def coverage(self) -> float:
        """Share of the folds that the bound of the other folds covers."""
        return float(np.mean([ratio >= 1 for ratio in self.left_out])) if self.left_out else float("nan")

    def to_dict(self, project: Project) -> dict:
        """Convert to JSON types, for `from_dict`.

        The result also has the assumption above the informative frequencies, and its reason.
        """
        last = last_telling(self.setting)
        reasons = {b.output: b.reason for b in project.model_error.beyond}
        return {
            "claim": claim(project),
            "instrument": project.model_error.instrument,
            "omega_rad_s": self.grid.omega,
            "speed_edges_mps": self.grid.speed_edges,
            "amplitude_edges": self.grid.amplitude_edges,
            "bound": self.bound,
            "beyond": {
                s.name: {
                    "last_rad_s": None if k < 0 else self.grid.omega[k],
                    "bound": column,
                    "reason": reasons.get(s.name, ASSUMED),
                }
                for s, k, column in zip(project.outputs, last, beyond(project, self.grid).T, strict=True)
            },
            "setting": self.setting.to_dict(),
            "judging": None if self.judging is None else self.judging.to_dict(),
            "left_out": {"folds": len(self.left_out), "coverage": self.coverage, "ratios": self.left_out},
            **({"bands": self.bands} if self.bands else {}),
        }

    @classmethod
    def from_dict(cls, project: Project, estimator: Estimator, data: dict) -> ModelError:
        """Model error from the result of `to_dict`. The bound is computed again, unless bands set it."""
        grid = ErrorGrid.from_project(project, estimator)
        setting = ErrorEstimate.from_dict(data["setting"])
        judging = None if data["judging"] is None else ErrorEstimate.from_dict(data["judging"])
        ratios = [np.inf if r is None else r for r in data["left_out"]["ratios"]]
        bands = data.get("bands", [])
        bound = np.array(data["bound"], float) if bands else uncertainty_bound(project, grid, setting)
        return cls(grid, setting, bound, judging, ratios, bands)


def _left_out(project: Project, grid: ErrorGrid, fold: tuple[Sums, Sums]) -> float:
    """Least ratio of the bound of the other folds to |delta_c| - k se of a fold.

    ``fold`` holds the sums of the fold and those of all others.
    """
    own, others = (ErrorEstimate.from_sums(sums, grid) for sums in fold)
    return covered(uncertainty_bound(project, grid, others), own)


def covered(bound: np.ndarray, own: ErrorEstimate) -> float:
    """Least ratio of a ``bound`` (G, n_delta) to |delta_c| - k se of an estimate.

    It is inf where |delta_c| - k se is nowhere above 0.
    """
    lower = own.lower.max(axis=(2, 3))
    return float((bound / np.maximum(lower, TINY)).min(where=lower > 0, initial=np.inf))


def _each_and_others(folds: list[Sums]) -> Iterator[tuple[Sums, Sums]]:
    """Yield every fold with the sum of all others; nothing for a single fold."""
    after = list(accumulate(folds[:0:-1], Sums.plus))[::-1]
    before: Sums | None = None
    for own, later in zip_longest(folds[: len(folds) if after else 0], after):
        others = [part for part in (before, later) if part is not None]
        yield own, _total(others)
        before = own if before is None else before.plus(own)


def _total(folds: list[Sums]) -> Sums:
    total = folds[0]
    for sums in folds[1:]:
        total = total.plus(sums)
    return total
