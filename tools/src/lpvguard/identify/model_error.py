"""Model error model (T30 to T33; THEORY 7.6): the part of the nominal error that follows the input, with its
standard error. Its frames are not the monitor's.

Length: sums over frames, lines over pools of cells and the bound are one estimator, read together. Only sums
over frames are kept of a drive. Drives are added in the order of their names, so the result does not depend
on their order in a folder.
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
"""Lengths of frames; each doubles the one before."""
AR_ORDER, AR_FLOOR = 8, 1e-6
"""Order of the whitening filter, and the white share that limits its gain to 60 dB."""
STEP = 10 ** (1 / 12)
"""Approximate distance between frequencies of the grid."""
SILENT = 2
"""Highest frequencies of the grid at which a design assumes 1 + rho: it knows nothing beyond them."""
HIGHEST = 0.2
"""End of the grid, as a share of the sampling rate."""
HELD = 0.8
"""Highest frequency of a band, as a share of the Nyquist frequency of decimated signals."""
FEWEST_FRAMES = 8
"""A cell with fewer independent frames is pooled with its neighbour."""
LEAST_FRAMES, FEW_LEVEL = 3.0, 1e-4
"""Fewest frames in the pool of all cells, and the level of the F distribution for fewer than
FEWEST_FRAMES."""
INDEPENDENT = 1 / 1.056
"""Independent frames per Hann frame at half overlap."""
LEVEL = 0.05
"""1 - simultaneous confidence of all estimates."""
FOLDS = 64
"""Groups of drives with separate sums, for leave-one-out; up to that many drives each is a group."""
LEAST_SPREAD = 0.01
"""Least standard deviation of speeds for a line, as a share of half the speed range."""
LACK_OF_FIT = 1e-3
"""Level at which a cell's own line refutes that of a wider pool. A false refutation costs only precision."""
ENDS = np.sqrt(3)
"""Standard deviations from the mean to the ends of evenly spread speeds, where the line is read."""
TINY = 1e-300
NEARLY_SINGULAR = 1e-6
"""Determinant of a matrix over the sum of its squared entries: below it the inverse loses half the digits."""
POWERS = 5
"""Number of powers of s, from 0 on, that weight sums over frames."""
BIASED = (
    "delta_c is the least-squares estimate from the nominal output; a driver who steers against disturbances "
    "biases it, and no column was named that excites from outside"
)
INSTRUMENTAL = "delta_c is the instrumental estimate from the named column, which excites from outside"
"""``claim`` of model_error.json, without and with an instrument."""
ASSUMED = "no reason stated: the vehicle is taken to respond no more than the model"
"""``reason`` of an output that the project does not mention: rho is 1."""


@dataclass(frozen=True)
class ErrorGrid:
    """Grid of the estimate.

    It has frequencies ``omega`` (G,) [rad/s], ``speed_edges`` (C + 1,) [m/s] and ``amplitude_edges`` (A - 1,)
    [input unit].
    """

    Ts: float
    omega: np.ndarray
    speed_edges: np.ndarray
    amplitude_edges: np.ndarray

    @classmethod
    def from_project(cls, project: Project, estimator: Estimator) -> ErrorGrid:
        """The bins, points between distant ones, and STEP by STEP beyond them up to HIGHEST."""
        bins = estimator.omega[estimator.cycles > 0]
        kept = [bins[0]]
        for omega in bins[1:]:  # lines of the plain DFT lie denser than needed
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
        """s, in the shape of the speeds v [m/s]."""
        low, high = self.speed_edges[[0, -1]]
        return (v - 0.5 * (low + high)) / (0.5 * (high - low))

    def speed(self, s: np.ndarray) -> np.ndarray:
        """Speeds [m/s] of s, in the shape of s."""
        low, high = self.speed_edges[[0, -1]]
        return 0.5 * (low + high) + 0.5 * (high - low) * s


class Sums(NamedTuple):
    """Sums over frames, (G, P, n_y, C, A, ...).

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
        """Sums of no frame."""
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

        The products are |E|^2, conj(Z) E by its parts, |Z|^2, and |R|^2 times each; then, if R is not Z,
        conj(R) E,
        |R|^2, conj(R) Z and |R|^4.
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
        """Number of independent frames of the estimate, (sum |R|^2)^2 / sum |R|^4, reduced for overlap."""
        return INDEPENDENT * self.rr[..., 0] ** 2 / np.maximum(self.fourth, TINY)

    def plus(self, other: Sums) -> Sums:
        """Sums of the frames of both."""
        return Sums(*(a + b for a, b in zip(self, other, strict=True)))


def prediction_error_filter(x: np.ndarray) -> np.ndarray:
    """Coefficients 1 + a_1 z^-1 + ... (AR_ORDER + 1,) that whiten x (N,): Yule-Walker with AR_FLOOR at lag
    0."""
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
    """Sums of one drive over frames in which the first input's rms exceeds ``excited_std`` [input unit].

    e, yhat (N, n_y) [output units].
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
    """Hann window times an exponential that turns by ``angle`` a sample, (half, 4), cached per process.

    The columns are real and imaginary part of the first half, and of the second.
    """
    n = np.arange(2 * half)
    window = 0.5 - 0.5 * np.cos(2 * np.pi * n / len(n))
    parts = (window * np.exp(-1j * angle * n)).reshape(2, -1)
    return np.stack([x for k in parts for x in (k.real, k.imag)], axis=1)


def _by_halves(signals: np.ndarray, kernel: np.ndarray) -> np.ndarray:
    """Frames (m, N / h - 1) of signals (m, N) at every h-th start, by their ``kernel`` (h, 4).

    Each half frame is the second half of one frame and the first of the next, and is computed once for both.
    """
    sums = signals.reshape(len(signals), -1, len(kernel)) @ kernel
    return np.ascontiguousarray(sums[:, :-1, :2] + sums[:, 1:, 2:]).view(complex)[..., 0]


class _Frames(NamedTuple):
    """Counted frames of one drive, frequency and length ``at`` (g, p).

    Complex ``frames`` (m, F) are E, Z and, if Z is not R, R of every output in turn; speed and amplitude are
    (F,).
    """

    at: tuple[int, int]
    frames: np.ndarray
    speed: np.ndarray
    amplitude: np.ndarray


def _add(moments: np.ndarray, grid: ErrorGrid, frame_sets: list[_Frames]) -> None:
    """Add frames to their cells of ``moments``; the order of frames in a cell stays."""
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
    """(n_y, m, F) of frames (n_y, 3 or 2, F): as ``Sums.of_moments`` reads them."""
    E, Z, R = np.moveaxis(frames, 1, 0)[[0, 1, -1]]
    EE, ZZ, ZE = np.abs(E) ** 2, np.abs(Z) ** 2, Z.conj() * E
    RR = ZZ if frames.shape[1] == 2 else np.abs(R) ** 2
    rows = [EE, ZE.real, ZE.imag, ZZ, RR * EE, RR * ZE.real, RR * ZE.imag, RR * ZZ]
    if frames.shape[1] == 3:
        RE, RZ = R.conj() * E, R.conj() * Z
        rows += [RE.real, RE.imag, RR, RZ.real, RZ.imag, RR**2]
    return np.stack(rows, axis=1)


def model_error_pass(reader: DriveReader, grid: ErrorGrid, experiment: Experiment) -> Sums:
    """The sums of one drive, read by a worker."""
    excited_std = reader.project.frame_test.excited_std
    return drive_sums(grid, reader.model, reader.estimator, excited_std, *reader.read(experiment))


@dataclass(frozen=True)
class ErrorEstimate:
    """Estimates by (G, n_y, C, A) at the end of each cell's speeds with the largest |delta_c| + k se.

    They are NaN without frames. Pooled cells hold the same.

    Attributes
    ----------
    delta : ndarray (G, n_y, C, A) of complex, delta_c
    se : ndarray (G, n_y, C, A), standard error of delta_c
    v : ndarray (G, n_y, C, A), m/s
    n : ndarray (G, n_y, C, A), number of independent frames
    periods : ndarray (G, n_y, C, A), periods in a frame
    moved : ndarray (G, n_y, C, A), standard errors of the change by doubled frames, inf: unknown
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
        """Factor of the simultaneous level: sqrt(ln(N/LEVEL)) for N complex estimates (T31); a pool counts
        once."""
        estimates = self.se.reshape(-1, np.prod(self.se.shape[2:], dtype=int))
        N = sum(len(np.unique(row[np.isfinite(row)])) for row in estimates)
        return float(np.sqrt(np.log(max(1, N) / LEVEL)))

    @property
    def upper(self) -> np.ndarray:
        """|delta_c| + k se; inf without an estimate."""
        return np.where(np.isfinite(self.se), np.abs(self.delta) + self.k * self.se, np.inf)

    @property
    def lower(self) -> np.ndarray:
        """|delta_c| - k se, at least 0; 0 without an estimate."""
        return np.where(np.isfinite(self.se), np.maximum(np.abs(self.delta) - self.k * self.se, 0.0), 0.0)

    @property
    def tells(self) -> np.ndarray:
        """(G, n_y): every cell would have refuted a vehicle that does not respond, k se < 1."""
        return np.all(np.where(np.isfinite(self.se), self.k * self.se, np.inf) < 1, axis=(2, 3))

    def to_dict(self) -> dict:
        """JSON-able, for `from_dict`; also k."""
        columns = {f.name: getattr(self, f.name) for f in fields(self) if f.name != "delta"}
        return {"k": self.k, "delta_re": self.delta.real, "delta_im": self.delta.imag, **columns}

    @classmethod
    def from_dict(cls, data: dict) -> ErrorEstimate:
        """Read back."""
        columns = {f.name: np.array(data[f.name], float) for f in fields(cls) if f.name != "delta"}
        columns["moved"] = np.where(np.isnan(columns["moved"]), np.inf, columns["moved"])
        re, im = (np.array(data[key], float) for key in ("delta_re", "delta_im"))
        return cls(delta=re + 1j * im, **columns)

    @classmethod
    def from_sums(cls, sums: Sums, grid: ErrorGrid) -> ErrorEstimate:
        """Estimate from sums with the best length of frames.

        Best are the lengths with the narrowest pool, among these that with the least standard error of the
        converged ones. If none has converged, it is the one with the least change by doubling, in standard
        errors.
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
            # The line of doubled frames over the same pool, at the same speed.
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
    """Lines a + b s of every cell, (G, P, n_y, C, A): theta (..., 2), covariance (..., 2, 2), and statistics.

    These are mean and standard deviation of the frames' s, independent frames n, and the residue's share of
    sum |E|^2.
    """

    theta: np.ndarray
    covariance: np.ndarray
    mean: np.ndarray
    spread: np.ndarray
    n: np.ndarray
    residue: np.ndarray

    def at(self, s: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """delta_c and its standard error at s (..., m), in that shape."""
        row = np.stack([np.ones_like(s), s], axis=-1)
        square = np.einsum("...mi,...ij,...mj->...m", row, self.covariance, row).real
        return np.einsum("...mi,...i->...m", row, self.theta), np.sqrt(np.maximum(square, 0.0))

    def ends(self, deviations: float) -> np.ndarray:
        """s (..., 2) so many standard deviations of the frames' s below and above their mean."""
        away = deviations * self.spread[..., None] * np.array([-1, 1])
        return np.clip(self.mean[..., None] + away, -1, 1)

    def worst_end(self) -> np.ndarray:
        """s at the end of each cell's speeds with the larger |delta_c| + 3 se."""
        ends = self.ends(ENDS)
        delta, se = self.at(ends)
        size = np.abs(delta) + 3 * se
        end = np.argmax(np.where(np.isfinite(size), size, -1.0), axis=-1)
        return np.take_along_axis(ends, end[..., None], -1)[..., 0]

    def replaced(self, where: np.ndarray, other: _Lines) -> _Lines:
        """These lines, with the ``other`` ones at ``where`` (G, P, n_y, C, A)."""

        def one(mine: np.ndarray, theirs: np.ndarray) -> np.ndarray:
            return np.where(where.reshape(*where.shape, *[1] * (mine.ndim - where.ndim)), theirs, mine)

        return _Lines(*(one(getattr(self, f.name), getattr(other, f.name)) for f in fields(self)))

    def doubled(self) -> _Lines:
        """Lines of frames twice as long, for all but the last of P."""
        return _Lines(*(getattr(self, f.name)[:, 1:] for f in fields(self)))


def _quantile(n: np.ndarray, level: float) -> np.ndarray:
    """Standard errors that |delta - delta_c| exceeds with probability ``level``; n: independent frames.

    |delta - delta_c|^2 / se^2 follows F(2, 2 nu), nu = n - 2.
    """
    freedom = np.maximum(n - 2, 1.0)
    return np.sqrt(freedom * np.expm1(-np.log(level) / freedom))


def _few(n: np.ndarray) -> np.ndarray:
    """Factor on standard errors from n < FEWEST_FRAMES frames to the quantile of many; 1 elsewhere."""
    return np.where(n < FEWEST_FRAMES, _quantile(n, FEW_LEVEL) / np.sqrt(-np.log(FEW_LEVEL)), 1.0)


def _fitted(s: Sums) -> _Lines:
    """(Instrumental) least squares of every cell. Frames of one speed, or too few for a line, give b = 0."""
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
    # White's covariance: the residue need not be as large in every frame. Overlapping frames count as fewer.
    few = n / np.maximum(n - 1 - sloped, 1e-9) / INDEPENDENT
    covariance = inverse @ _scatter(s, theta) @ np.conj(np.swapaxes(inverse, -1, -2)) * few[..., None, None]
    covariance = covariance * keep[..., None] * keep[..., None, :]
    theta[empty], covariance[empty] = np.nan, np.nan
    return _Lines(theta, covariance, mean, spread, n, residue / np.maximum(s.ee, TINY))


def _inverse(M: np.ndarray) -> np.ndarray:
    """Inverses of M (..., 2, 2); pseudo-inverses of nearly singular ones."""
    det = M[..., 0, 0] * M[..., 1, 1] - M[..., 0, 1] * M[..., 1, 0]
    near = np.abs(det) <= NEARLY_SINGULAR * (np.abs(M) ** 2).sum(axis=(-2, -1))
    out = np.empty_like(M)
    out[..., 0, 0], out[..., 1, 1] = M[..., 1, 1], M[..., 0, 0]
    out[..., 0, 1], out[..., 1, 0] = -M[..., 0, 1], -M[..., 1, 0]
    out /= np.where(near, 1.0, det)[..., None, None]
    out[near] = np.linalg.pinv(M[near], rcond=1e-12)
    return out


def _scatter(s: Sums, theta: np.ndarray) -> np.ndarray:
    """(..., 2, 2): sum of |R|^2 |E - (a + b s) Z|^2 [1 s; s s^2] over frames, theta = (a, b)."""
    a, b = theta[..., 0, None], theta[..., 1, None]
    moments = (
        s.ree
        - 2 * (a.conj() * s.rze[..., :3] + b.conj() * s.rze[..., 1:]).real
        + np.abs(a) ** 2 * s.rzz[..., :3]
        + 2 * (a.conj() * b).real * s.rzz[..., 1:4]
        + np.abs(b) ** 2 * s.rzz[..., 2:]
    )
    # Rounding may leave an even moment below 0; that of s has either sign.
    moments[..., ::2] = np.maximum(moments[..., ::2], 0.0)
    return moments[..., np.add.outer(np.arange(2), np.arange(2))]


def _joined(second: np.ndarray, fourth: np.ndarray) -> np.ndarray:
    """Group (N, K), from 0 on, of each of K neighbours, joined until each group has FEWEST_FRAMES or one is
    left.

    ``second`` and ``fourth`` (N, K) are their sums of |R|^2 and |R|^4. The group with the fewest frames is
    joined first, with the smaller of its neighbours.
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
    """Sums of every ``cells`` neighbouring speed cells, added and given to each."""

    def one(field: np.ndarray) -> np.ndarray:
        shape = field.shape
        parts = field.reshape(*shape[:3], shape[3] // cells, cells, *shape[4:])
        return np.broadcast_to(parts.sum(axis=4, keepdims=True), parts.shape).reshape(shape)

    return Sums(*map(one, s))


def _classes_joined(s: Sums) -> Sums:
    """Sums with each amplitude class replaced by those of its joined classes, where it has too few frames.

    Classes are joined where their drives alone have fewer than FEWEST_FRAMES.
    """
    second, fourth = (x.sum(axis=3) for x in (s.rr[..., 0], s.fourth))
    groups = _joined(*(x.reshape(-1, x.shape[-1]) for x in (second, fourth))).reshape(second.shape)
    same = (groups[..., :, None] == groups[..., None, :]).astype(float)[..., None, :, :]

    def one(field: np.ndarray) -> np.ndarray:
        return (same @ field.reshape(*s.ee.shape, -1)).reshape(field.shape)

    return Sums(*map(one, s))


def _pools(sums: Sums) -> list[_Lines]:
    """Lines over single speed cells, over pools of two, of four and so on up to all, at every cell."""
    joined, cells = _classes_joined(sums), sums.ee.shape[3]
    return [_fitted(_shared(joined, 2**k)) for k in range(cells.bit_length())]


def _chosen(pools: list[_Lines]) -> np.ndarray:
    """Index of every cell's pool (G, P, n_y, C, A): the widest that fits, wider with fewer than
    FEWEST_FRAMES.

    A pool fits when no cell in it with FEWEST_FRAMES has a line that refutes it at LACK_OF_FIT, one standard
    deviation of speed to either side of the mean. A pool refuted with frames of one length is refuted for
    all.
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
    """Return the bound on |delta| where no drive informs, 1 + rho with rho a bound on |G/P|.

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
        If the project's ratio is below 1 or not finite somewhere.

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
            raise InputError(where, "ratio", f"{rho.min():.6g} at its least", "at least 1 at every frequency")
        columns.append(1 + rho)
    return np.column_stack(columns)


def last_telling(estimate: ErrorEstimate) -> np.ndarray:
    """Return the last grid frequency at which every cell is informative.

    Parameters
    ----------
    estimate : ErrorEstimate

    Returns
    -------
    ndarray (n_y,) of int, index, -1 for none
    """
    return np.array([np.flatnonzero(tells)[-1] if tells.any() else -1 for tells in estimate.tells.T])


def uncertainty_bound(project: Project, grid: ErrorGrid, estimate: ErrorEstimate) -> np.ndarray:
    """(G, n_delta): bound that W_delta must cover (T31, T32).

    Up to the last informative frequency it is the largest |delta_c| + k se of all cells. Where a cell would
    not have refuted a vehicle that does not respond, it is at most 1 + rho unless |delta_c| - k se is larger.
    Beyond the last informative frequency it is at least 1 + rho. For a design, the last SILENT frequencies
    count as beyond it.
    """
    upper, lower = (x.max(axis=(2, 3)) for x in (estimate.upper, estimate.lower))
    dead = beyond(project, grid)
    out = np.where(estimate.tells, upper, np.maximum(np.minimum(upper, dead), lower))
    after = np.arange(len(grid.omega))[:, None] > np.minimum(last_telling(estimate), _last(project, grid))
    out = np.where(after, np.maximum(dead, lower), out)
    return out if project.n_delta == project.n_y else out.max(axis=1, keepdims=True)


def band_bound(project: Project, grid: ErrorGrid, bands: list[ErrorBand]) -> np.ndarray:
    """Compute the bound (G, n_delta) that W_delta must cover by the ``bands`` of all outputs.

    The bands have the first of the grid's frequencies. A band gives no information at a speed and amplitude
    with k sd >= 1 + rho. There, and beyond its frequencies, at most 1 + rho is required (T32). For a design,
    the last SILENT frequencies count as beyond them.
    """
    out = beyond(project, grid)
    for j, band in enumerate(bands):
        dead = out[: len(band.omega), j, None, None]
        informed = (np.arange(len(band.omega)) <= _last(project, grid))[:, None, None]
        needed = np.where(informed & (band.k * band.sd < dead), band.upper, np.maximum(dead, band.lower))
        out[: len(band.omega), j] = needed.max(axis=(1, 2))
    return out if project.n_delta == project.n_y else out.max(axis=1, keepdims=True)


def _last(project: Project, grid: ErrorGrid) -> int:
    """Index of the last frequency that may inform."""
    return len(grid.omega) - 1 - SILENT * (project.design is not None)


def band_frequencies(grid: ErrorGrid, domain: ErrorDomain) -> np.ndarray:
    """Select the grid's frequencies (F,) [rad/s] that the decimated signals hold."""
    return grid.omega[grid.omega <= HELD * np.pi / domain.step_s]


def bands_of(
    domain: ErrorDomain, omega: np.ndarray, seed: int, likes: list[ErrorBand] | None, sums: ErrorSums
) -> list[ErrorBand]:
    """Band of every output of the drives' ``sums`` at ``omega`` (G,) [rad/s]; ``likes``: of more drives."""
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
    setting : ErrorEstimate, of the drives that set the bounds
    bound : ndarray (G, n_delta), bound from ``setting``, or without a ceiling on nu from ``bands``
    judging : ErrorEstimate or None, of the drives that judge the bound
    left_out : list of float
        Per fold the least ratio of the others' bound to its |delta_c| - k se, inf: no demand.
    bands : list of dict, per output the band of a further drive
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
        """Model error from the sums of folds of drives, at least one of which sets the bounds.

        ``workers`` share the folds.
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
        """With the bands of ``sums``, one a fold; ``folds``: each one's own estimate.

        Where no ceiling on nu is set, they are the bound.
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
        """(K, n_delta) the bound at the bins, 0 at DC."""
        return np.where(estimator.cycles[:, None] > 0, self.bound[self._places(estimator)], 0.0)

    def typical(self, estimator: Estimator) -> np.ndarray:
        """Compute the error (K, n_delta) of a further drive at the bins; only for bands. It is the median
        over speeds and amplitudes. DC has the error of the lowest frequency."""
        each = np.column_stack([np.array(b["typical"])[self._places(estimator)] for b in self.bands])
        return each if self.bound.shape[1] > 1 else each.max(axis=1, keepdims=True)

    def _places(self, estimator: Estimator) -> np.ndarray:
        """(K,) index of the grid's frequency at each bin; DC has the lowest."""
        bins = np.maximum(estimator.omega, self.grid.omega[0])
        return np.argmin(np.abs(np.log(bins[:, None] / self.grid.omega)), axis=1)

    @property
    def coverage(self) -> float:
        """Share of the folds that the bound of the others covers."""
        return float(np.mean([ratio >= 1 for ratio in self.left_out])) if self.left_out else float("nan")

    def to_dict(self, project: Project) -> dict:
        """JSON-able, for `from_dict`, with the assumption beyond the data and its reason."""
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
        """Read back; the bound is computed again from the estimates, unless bands set it."""
        grid = ErrorGrid.from_project(project, estimator)
        setting = ErrorEstimate.from_dict(data["setting"])
        judging = None if data["judging"] is None else ErrorEstimate.from_dict(data["judging"])
        ratios = [np.inf if r is None else r for r in data["left_out"]["ratios"]]
        bands = data.get("bands", [])
        bound = np.array(data["bound"], float) if bands else uncertainty_bound(project, grid, setting)
        return cls(grid, setting, bound, judging, ratios, bands)


def _left_out(project: Project, grid: ErrorGrid, fold: tuple[Sums, Sums]) -> float:
    """Least ratio of the others' bound to the own |delta_c| - k se, from a ``fold``'s sums and theirs."""
    own, others = (ErrorEstimate.from_sums(sums, grid) for sums in fold)
    return covered(uncertainty_bound(project, grid, others), own)


def covered(bound: np.ndarray, own: ErrorEstimate) -> float:
    """Least ratio of a ``bound`` (G, n_delta) to |delta_c| - k se of an estimate; inf where that is nowhere
    above 0."""
    lower = own.lower.max(axis=(2, 3))
    return float((bound / np.maximum(lower, TINY)).min(where=lower > 0, initial=np.inf))


def _each_and_others(folds: list[Sums]) -> Iterator[tuple[Sums, Sums]]:
    """Every fold with the sum of all others; none for a single fold."""
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
