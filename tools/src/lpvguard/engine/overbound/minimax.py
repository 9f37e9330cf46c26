"""Find the least worst ratio sup |W|/bound of a given order by a sequence of linear programs.

With y = w^2, |W|^2 = N(y)/D(y) for polynomials N and D. For a fixed t, "bound^2 D <= N <= t^2 bound^2 D" is
linear in (N, D). Each program minimises the violation of the upper inequality at a trial t. This is the
differential correction of Barrodale, Powell and Roberts, SIAM J. Numer. Anal. 9, 1972. Either the program
returns a better weight, or the trial t is infeasible. An infeasible t is a lower limit for any weight of that
order. Each trial is 0.002 dB below the best weight so far.

Rows are divided by bound^2 D of the current D (at least 1e-5 of its sum |d_i| y^i). Then columns are divided
by their largest entry. This is the max-plus scaling around that D. With it monomials keep their accuracy over
six decades. The result "infeasible" counts only if the D that scaled the rows was within 0.5 dB of the
optimum.

A program contains only some points of a fine grid. Grid points where its solution fails are added until none
fails. This grid also contains every lightly damped pole and zero.
"""

import itertools
import math
from dataclasses import dataclass, replace

import numpy as np
from scipy.optimize import linprog

from .bound import SampledBound
from .weight import polynomial_roots

STEP_DB = 0.002
"""Resolution of the search for the least worst ratio."""

_GRID_STEP = 0.02
"""Widest gap of the cutting-plane grid, in ln w."""

_OUTSIDE = 1e3
"""The grid continues by this factor in w beyond both ends."""

_RESOLUTION = 1e-5
"""Smallest D of a row, relative to the D that scales the row."""

_NEAR_DB = 0.5
"""The rows are well scaled if the ratio of their D is within this distance of the optimum [dB]."""

_TOLERANCE = {"primal_feasibility_tolerance": 1e-10, "dual_feasibility_tolerance": 1e-10}
_MAX_PROGRAMS, _MAX_CUTS = 60, 60
_ALL = slice(None)


@dataclass(frozen=True)
class MinimaxFit:
    """N and D, ascending in y, with min N/(bound^2 D) = 1 and the worst ratio ``ratio_db`` on the grid.

    ``lower_db`` is a level that is infeasible for this order, as the rows ``active`` (y values) alone show.
    """

    order: int
    top: np.ndarray
    bottom: np.ndarray
    ratio_db: float
    lower_db: float
    active: np.ndarray


class Grid:
    """The cutting-plane grid: all samples, points between them, both ends and points beyond them.

    ``y`` (G,) ascends from 0 to inf. ``b2`` (G,) is the squared bound. ``below`` (G,) marks the points where
    the bound must be below the weight. ``insert`` adds points where a resonance lies between grid points.
    """

    def __init__(self, samples: SampledBound, strict: bool):
        self.samples, self.strict = samples, strict
        self._log_w, self._log_b = np.log(samples.omega / samples.unit), np.log(samples.bound)
        first, last = self.band = (self._log_w[0], self._log_w[-1])
        self.end = math.exp(2.0 * last)
        tail = np.geomspace(
            _GRID_STEP, math.log(_OUTSIDE), 30
        )  # dense near the corner of the bound at both ends
        fill = [
            np.linspace(a, b, int((b - a) / _GRID_STEP) + 2)[:-1] for a, b in itertools.pairwise(self._log_w)
        ]
        self._place(np.concatenate([[-math.inf], first - tail[::-1], *fill, [last], last + tail, [math.inf]]))

    def _place(self, grid: np.ndarray) -> None:
        self.y = np.exp(2.0 * grid)
        self.b2 = np.exp(2.0 * np.interp(grid, self._log_w, self._log_b))
        if (
            self.strict
        ):  # the upper limit falls from one decade above the band, so that the weight must roll off there
            self.b2[:-1] *= np.minimum(1.0, 100.0 * self.end / np.maximum(self.y[:-1], self.end))
        self.below = grid <= self.band[1] if self.strict else np.ones(grid.size, dtype=bool)
        self._grid = grid

    def insert(self, y: np.ndarray) -> None:
        """Add points of y = (w/unit)^2 to the grid."""
        with np.errstate(divide="ignore"):
            self._place(np.union1d(self._grid, 0.5 * np.log(y)))

    def start(self) -> np.ndarray:
        """Rows of the first linear program (y values).

        They are both ends, and the largest and smallest bound in each of 24 intervals.
        """
        cells = np.array_split(np.arange(self.y.size), 24)
        return np.unique(self.y[[0, -1] + [c[f(self.b2[c])] for c in cells for f in (np.argmin, np.argmax)]])

    def powers(self, degree: int) -> np.ndarray:
        """Powers y^i (G, degree+1). The row of y = inf selects the leading coefficient."""
        rows = self.y[:-1, None] ** np.arange(degree + 1)
        return np.vstack([rows, np.eye(degree + 1)[-1:]])

    def ratio2(self, top: np.ndarray, bottom: np.ndarray) -> np.ndarray:
        """N/(bound^2 D) on the grid, nan where D <= 0."""
        powers = self.powers(len(bottom) - 1)
        low, high = powers @ bottom, powers @ np.pad(top, (0, len(bottom) - len(top)))
        with np.errstate(divide="ignore", invalid="ignore"):
            return np.where(low > 0, high / (self.b2 * low), math.nan)

    def spread_db(self, ratio2: np.ndarray, rows: np.ndarray | slice = _ALL) -> float:
        """Quotient [dB] of the largest and smallest ratio at ``rows``.

        It is inf if no gain raises all of them above the bound.
        """
        if np.isnan(ratio2).any() or not (least := ratio2[self.below[rows]].min()) > 0:
            return math.inf
        return 10.0 * math.log10(ratio2.max() / least)


def least_worst_ratio(
    grid: Grid, order: int, lower_order: MinimaxFit | None, last: MinimaxFit | None = None
) -> MinimaxFit:
    """Find the least worst ratio of one order.

    The result is the fit ``lower_order`` where the improvement over it is below ``STEP_DB``. ``last`` is the
    fit on the grid before its last points were added.
    """
    best = lower_order
    if order == 0:
        ratio_db = 10.0 * math.log10(grid.b2.max() / grid.b2.min())
        return MinimaxFit(0, np.array([grid.b2.max()]), np.ones(1), ratio_db, ratio_db, grid.y)
    if best is not None and best.ratio_db <= STEP_DB:
        return best
    if last is None:
        active, lower_db, tol = grid.start(), 0.0, 1.0
        bottom = np.ones(1) if best is None else best.bottom
        while len(bottom) <= order:  # add one break in the middle of the band
            bottom = np.convolve(bottom, [1.0, math.exp(-sum(grid.band))])
    else:
        active, lower_db, tol, bottom = last.active, last.lower_db, STEP_DB, last.bottom
        active = np.union1d(active, _failures(grid, grid.ratio2(last.top, last.bottom), lower_db))
    if best is None:  # strictly proper, first order: start from any roll-off
        ratio2 = grid.ratio2(np.ones(1), bottom)
        best = MinimaxFit(
            order,
            1.0 / ratio2[grid.below].min(keepdims=True),
            bottom,
            grid.spread_db(ratio2),
            lower_db,
            active,
        )
    for _ in range(_MAX_CUTS):
        polynomials, lower_db = _exchange(grid, active, order, bottom, lower_db, best.ratio_db, tol)
        if polynomials is None:  # no fit is better than ``best`` by tol
            if tol == STEP_DB:
                break
            tol = STEP_DB
            continue
        top, bottom = polynomials
        _resolve(grid, top, bottom)
        ratio2 = grid.ratio2(top, bottom)
        worst = grid.spread_db(ratio2)
        if worst < best.ratio_db:
            best = MinimaxFit(order, top / ratio2[grid.below].min(), bottom, worst, lower_db, active)
        fresh = np.setdiff1d(_failures(grid, ratio2, lower_db), active)
        if best.ratio_db <= lower_db + 2 * STEP_DB or (not fresh.size and tol == STEP_DB):
            break
        tol = max(STEP_DB, min(tol, 0.1 * (worst - lower_db))) if fresh.size else STEP_DB
        active = np.union1d(active, fresh)
    return best if best.order < order else replace(best, lower_db=lower_db, active=active)


def _resolve(grid: Grid, top: np.ndarray, bottom: np.ndarray) -> None:
    """Add the frequencies of lightly damped poles and zeros to the grid if the ratio fails there."""
    for polynomial in (top, bottom):
        roots = polynomial_roots(np.trim_zeros(polynomial, "b")[::-1])
        near = np.unique(np.abs(roots[roots.real > 0]))
        if near.size:
            grid.insert(np.concatenate([near, np.sqrt(near[1:] * near[:-1])]))


def _exchange(
    grid: Grid,
    active: np.ndarray,
    order: int,
    bottom: np.ndarray,
    lower_db: float,
    upper_db: float,
    tol_db: float,
) -> tuple[tuple[np.ndarray, np.ndarray] | None, float]:
    """Bracket the optimum over the rows ``active`` (y values) to ``tol_db``.

    Returns (N, D) or None, and an infeasible level. ``upper_db`` is a feasible level. None means that it
    cannot be improved by ``tol_db``.
    """
    rows = np.searchsorted(grid.y, active)
    powers = grid.powers(order)
    polynomials, level = None, min(lower_db + tol_db, 0.5 * (lower_db + upper_db))
    judged_by = math.inf  # ratio of the ``bottom`` that scaled the last infeasible program
    for _ in range(_MAX_PROGRAMS):
        if upper_db - lower_db <= tol_db:
            if judged_by <= lower_db + max(tol_db, _NEAR_DB):
                break
            level = lower_db  # bad row scaling may have caused the result "infeasible": solve again
        gap = upper_db - lower_db
        answer = _program(grid, powers[rows], rows, bottom, level)
        if answer is None:  # the solver failed
            level = 0.5 * (level + upper_db)
            continue
        ratio2 = grid.ratio2(*answer)[rows]
        reached = grid.spread_db(ratio2, rows)
        if reached > level + 1e-6:
            lower_db, judged_by = level, upper_db
        elif level <= lower_db:
            lower_db = 0.0
        if reached < upper_db:
            upper_db = reached
            bottom = answer[1]
            polynomials = answer[0] / ratio2[grid.below[rows]].min(), bottom
        slow = upper_db - lower_db > 0.5 * gap
        level = 0.5 * (lower_db + upper_db) if slow else upper_db - 0.9 * tol_db
    return polynomials, lower_db


def _program(
    grid: Grid, powers: np.ndarray, rows: np.ndarray, bottom: np.ndarray, level_db: float
) -> tuple[np.ndarray, np.ndarray] | None:
    """(N, D) of the linear program at the trial worst ratio ``level_db``, None if the solver fails.

    Unknowns are N' = N/t, D and tau. D_old is the D of ``bottom``:

        bound^2 D <= t N',  N'/t - bound^2 D <= tau bound^2 D_old,
        D >= 1e-5 D_old,  mean of D = 1,  least tau

    Each row is divided by D_old, or by 1e-5 of its sum |d_i| y^i if that is larger. The solver's tolerance is
    then relative even in a sharp resonance. N must only be positive where a strictly proper weight may fall
    below the bound.
    """
    t = 10.0 ** (level_db / 20.0)
    size = powers @ np.abs(bottom)
    d_rows = powers / size[:, None]
    mean = d_rows.mean(axis=0)
    d_rows /= np.maximum(powers @ bottom / size, _RESOLUTION)[:, None]
    n_rows = d_rows[:, :-1] if grid.strict else d_rows
    n_rows = n_rows / grid.b2[rows, None]
    n_scale, d_scale = n_rows.max(axis=0), d_rows.max(axis=0)
    n_rows, d_rows, mean = n_rows / n_scale, d_rows / d_scale, mean / d_scale
    below, tau = grid.below[rows], np.ones((len(rows), 1))
    a_ub = np.vstack(
        [
            np.hstack([-t * n_rows, d_rows * below[:, None], np.zeros_like(tau)]),
            np.hstack([n_rows / t, -d_rows, -tau]),
            np.hstack([np.zeros_like(n_rows), -d_rows, np.zeros_like(tau)]),
        ]
    )
    roll_off = np.where(below, 0.0, -_RESOLUTION * grid.end / np.maximum(grid.y[rows], grid.end))
    b_ub = np.concatenate([roll_off, np.zeros(len(rows)), np.full(len(rows), -_RESOLUTION)])
    cost = np.zeros(a_ub.shape[1])
    cost[-1] = 1.0
    a_eq = np.concatenate([np.zeros(n_rows.shape[1]), mean, [0.0]])[None, :]
    answer = linprog(
        cost,
        A_ub=a_ub,
        b_ub=b_ub,
        A_eq=a_eq,
        b_eq=[1.0],
        bounds=(None, None),
        method="highs-ds",
        options=_TOLERANCE,
    )
    if answer.status != 0:
        return None
    top, bottom = answer.x[: n_rows.shape[1]] / n_scale, answer.x[n_rows.shape[1] : -1] / d_scale
    return top / np.abs(bottom).max(), bottom / np.abs(bottom).max()


def _failures(grid: Grid, ratio2: np.ndarray, level_db: float) -> np.ndarray:
    """Points (y values) that the grid of a program needs in addition.

    They are the worst local extremes outside [1, level], and one point per interval with D <= 0.
    """
    bad = ~((ratio2 > 0) | (grid.strict & np.isinf(grid.y)))
    log_r = 10.0 * np.log10(np.where(ratio2 > 0, ratio2, 1.0))
    miss = np.maximum(log_r - level_db, -log_r * grid.below)
    ends = np.pad(miss, 1, mode="edge")
    peak = np.flatnonzero((miss > 0.25 * STEP_DB) & (miss >= ends[:-2]) & (miss >= ends[2:]))
    peak = peak[np.argsort(-miss[peak], kind="stable")[:30]]
    runs = np.flatnonzero(np.diff(np.concatenate([[0], bad.astype(int), [0]])))
    return np.unique(grid.y[np.concatenate([peak, (runs[0::2] + runs[1::2] - 1) // 2])])
