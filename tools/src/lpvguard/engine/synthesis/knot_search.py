"""Search for a storage function that is linear between knots, and for D's gain, for least_level.py.

P(v) has a separate value at every knot. An inequality at one speed then concerns the two knots around it.
The Hessian is therefore block tridiagonal, and a Newton step is cheap.

The search increases the rate step by step. The P of the previous rate makes F(P) at rate 0 positive. At f
times that rate ``F(P) + (f - 1) F_0(P) > 0`` holds, where F_0 is F at rate 0. F_0(P) is therefore the unit
of F, and a doubling of the rate takes a few Newton steps. Further steps move P to the centre of the feasible
points. From the border the next search would hardly advance.
"""

from __future__ import annotations

import copy
import itertools
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace
from functools import cached_property, partial

import numpy as np
import scipy.linalg as sl

from lpvguard.engine.synthesis.barrier import Barrier, newton_step
from lpvguard.engine.synthesis.statespace import StateSpace
from lpvguard.engine.synthesis.storage_grid import parts_in

FIRST_WEIGHT, NEXT_FACTOR = 10.0, 5.0
"""First weight of the deficit t, per row of F, and the factor of its increase near the centre."""
STEPS = 60
"""Largest number of Newton steps for one rate."""
OUT_OF_REACH = 2.0
"""The search fails if the deficit t near the centre exceeds this number divided by the weight.

At the centre the least possible t lies within 1 / weight of t.
"""
NEAR, CENTRING_STEPS = 200.0, 4
"""Below this Newton decrement P is near the centre; largest number of steps to the centre once F > 0."""
ADDITIONS = (1e-13, 1e-11, 1e-9, 1e-7)
"""Additions to the unit diagonal of the Hessian, tried in this order, against rounding."""
HALVES = 2
"""Number of threads for the Hessian, and of chains of blocks in its factor. The result has the same bits on
any number of cores."""
SOLVED_AT_ONCE = 200
"""Largest number of rows of a triangular factor that one call solves."""


class KnotBarrier(Barrier):
    """Barrier in which every inequality concerns two neighbouring terms.

    ``segment`` (count,) is the first one.
    """

    def __init__(
        self,
        parts: list[tuple[np.ndarray, np.ndarray]],
        phi: np.ndarray,
        next_: np.ndarray,
        segment: np.ndarray,
    ):
        super().__init__(parts, phi, next_)
        self.segment = segment

    def solved(self, S: np.ndarray, right: np.ndarray) -> np.ndarray:
        """Solution X of Hessian X = ``right`` (size, k), with the Hessian at S_i = F_i^-1."""
        diagonal, beside = self._blocks(S)
        scale = [1 / np.sqrt(np.diagonal(block)) for block in diagonal]
        for block, one in zip(diagonal, scale, strict=True):
            block *= one * one[:, None]
        for block, (one, two) in zip(beside, itertools.pairwise(scale), strict=True):
            block *= one * two[:, None]
        flat = np.concatenate(scale)[:, None]
        return solved_blocks(diagonal, beside, right * flat) * flat

    def _blocks(self, S: np.ndarray) -> tuple[list[np.ndarray], list[np.ndarray]]:
        """Blocks of the Hessian: on its diagonal, and below it.

        Only the lower triangles of the blocks on the diagonal are valid.
        """
        size, terms = len(self.twice), self.next.shape[1]
        diagonal, beside = [np.zeros((size, size))], []

        def pair(k: int) -> np.ndarray:
            here = np.flatnonzero(self.segment == k)
            one = copy.copy(self)
            one.D = self.D[here]
            one.moved, one.next = (np.ascontiguousarray(f[here, k : k + 2]) for f in (self.moved, self.next))
            return one.hessian(S[here])

        with ThreadPoolExecutor(HALVES) as threads:
            for k, H in enumerate(threads.map(pair, range(terms - 1))):
                diagonal[k] += H[:size, :size]
                diagonal.append(H[size:, size:].copy())
                beside.append(H[size:, :size].copy())
        return diagonal, beside


def solved_blocks(diagonal: list[np.ndarray], beside: list[np.ndarray], right: np.ndarray) -> np.ndarray:
    """Solution X of H X = ``right`` (size, k).

    H is positive definite and block tridiagonal with a unit diagonal. Its blocks are the lower triangles of
    ``diagonal``, and ``beside`` below the diagonal. Raises LinAlgError where no addition is enough.
    """
    middle = len(diagonal) // 2
    halves = [
        (diagonal[:middle], beside[:middle]),
        (diagonal[:middle:-1], [block.T for block in reversed(beside[middle:])]),
    ]
    x = np.split(right, len(diagonal))
    of_half = [x[:middle], x[:middle:-1]]
    for extra in ADDITIONS:
        try:
            with ThreadPoolExecutor(HALVES) as threads:
                chains = list(threads.map(partial(_factored, extra=extra), halves))
            last = _lower(diagonal[middle], [below[-1] for _, below in chains if below], extra)
        except np.linalg.LinAlgError:
            continue
        return _substituted(chains, last, of_half, x[middle])
    raise np.linalg.LinAlgError("not positive definite")


Chain = tuple[list[np.ndarray], list[np.ndarray]]
"""Blocks on the diagonal, and the blocks that couple each of them to the next one, at last to the middle
block."""


def _lower(block: np.ndarray, beside: list[np.ndarray], extra: float) -> np.ndarray:
    """Cholesky factor of ``block`` with the diagonal 1 + extra, less X Xᵀ for each X of ``beside``."""
    rest = block.copy()
    np.fill_diagonal(rest, 1 + extra)
    for one in beside:
        rest -= one @ one.T
    return np.linalg.cholesky(rest)


def _factored(chain: Chain, extra: float) -> Chain:
    """Factor of one chain, from the outermost block to the middle."""
    factors: list[np.ndarray] = []
    below: list[np.ndarray] = []
    for block, other in zip(*chain, strict=True):
        factors.append(_lower(block, below[-1:], extra))
        below.append(_divided(factors[-1], other.T).T)
    return factors, below


def _divided(L: np.ndarray, right: np.ndarray) -> np.ndarray:
    """L^-1 right for a lower triangular L.

    L is split into halves, because NumPy's products let the other thread run and SciPy's solver does not.
    """
    half = len(L) // 2
    if len(L) <= SOLVED_AT_ONCE:
        return sl.solve_triangular(L, right, lower=True, check_finite=False)
    top = _divided(L[:half, :half], right[:half])
    return np.concatenate([top, _divided(L[half:, half:], right[half:] - L[half:, :half] @ top)])


def _substituted(
    chains: list[Chain], last: np.ndarray, right: list[list[np.ndarray]], middle: np.ndarray
) -> np.ndarray:
    """Solution by the factors of both chains and of the middle block.

    ``right`` holds the right sides of each chain, from the outermost block. ``middle`` is that of the middle
    block.
    """
    inwards = []
    for (factors, below), blocks in zip(chains, right, strict=True):
        x: list[np.ndarray] = []
        for k, factor in enumerate(factors):
            rest = blocks[k] - below[k - 1] @ x[-1] if k else blocks[k]
            x.append(sl.solve_triangular(factor, rest, lower=True, check_finite=False))
        if x:
            middle = middle - below[-1] @ x[-1]
        inwards.append(x)
    middle = sl.cho_solve((last, True), middle, check_finite=False)
    for (factors, below), x in zip(chains, inwards, strict=True):
        beside = middle
        for k in reversed(range(len(factors))):
            rest = x[k] - below[k].T @ beside
            x[k] = beside = sl.solve_triangular(factors[k], rest, lower=True, trans="T", check_finite=False)
    return np.concatenate([*inwards[0], middle, *inwards[1][::-1]])


@dataclass(frozen=True)
class Point:
    """P (K, n, n) at the knots. ``excess`` is the square of D's gain, relative to the given loop, less 1."""

    P: np.ndarray
    excess: float = 0.0


@dataclass(frozen=True)
class KnotGrid:
    """Inequalities at ``speeds`` (k,) [m/s] for P between ``knots`` (K,).

    ``loop_at(v)`` gives the loop at a speed, sampled at Ts [s]. ``basis`` (n, n) are the coordinates.
    ``delta`` holds two numbers: of the first outputs and of the first inputs that belong to Delta. ``cost``
    (n, n) is the cost of P in these coordinates.
    """

    loop_at: Callable[[float], StateSpace]
    Ts: float
    knots: np.ndarray
    speeds: np.ndarray
    basis: np.ndarray
    delta: tuple[int, int]
    cost: np.ndarray

    @cached_property
    def _parts(self) -> list[tuple[np.ndarray, np.ndarray]]:
        return [parts_in(self.loop_at(float(v)), self.basis) for v in self.speeds]

    @cached_property
    def _rows(self) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Index of each inequality's speed, segment of P's slope, and sign of the slope.

        A speed at a knot belongs to the segments on both sides. Each speed has two inequalities, for a rising
        and a falling speed.
        """
        inside = (self.knots[:-1] <= self.speeds[:, None]) & (self.speeds[:, None] <= self.knots[1:])
        speed, segment = np.nonzero(inside)
        return np.repeat(speed, 2), np.repeat(segment, 2), np.tile([1.0, -1.0], len(speed))

    def barrier(self, rate: float) -> KnotBarrier:
        """Barrier of F at every speed, in each of its segments.

        The speeds rise or fall by ``rate`` [m/s^2].
        """
        speed, segment, sign = self._rows
        width = np.diff(self.knots)[segment]
        share = (self.speeds[speed] - self.knots[segment]) / width
        now, after = (
            _between(segment, s, len(self.knots)) for s in (share, share + sign * rate * self.Ts / width)
        )
        return KnotBarrier([self._parts[i] for i in speed], now, after, segment)

    def gain_direction(self) -> np.ndarray:
        """Change of F per unit of the square of D's gain, (count, N, N)."""
        n, (n_eta, n_xi) = len(self.basis), self.delta
        N = np.array([N for _, N in self._parts])
        X = -np.swapaxes(N[:, :n_eta], 1, 2) @ N[:, :n_eta]
        X[:, n : n + n_xi, n : n + n_xi] += np.eye(n_xi)
        return X[self._rows[0]]

    def F(self, point: Point, rate: float) -> np.ndarray:
        """F of every inequality, (count, N, N)."""
        return self.barrier(rate).F(point.P) + point.excess * self.gain_direction()

    def violated(self, point: Point, rate: float, speeds: np.ndarray) -> np.ndarray:
        """Worst of ``speeds`` (m,) in each segment where F is not positive, without speeds of the grid."""
        others = np.setdiff1d(speeds, self.speeds)
        if not len(others):
            return others
        other = replace(self, speeds=others)
        least = np.full(len(others), np.inf)
        np.minimum.at(least, other._rows[0], np.linalg.eigvalsh(other.F(point, rate))[:, 0])
        segment = np.searchsorted(self.knots, others)
        worst = [
            min(np.flatnonzero(segment == k), key=least.__getitem__) for k in np.unique(segment[least <= 0])
        ]
        return others[np.array(worst, int)]

    def with_speeds(self, speeds: np.ndarray) -> KnotGrid:
        """The grid with further inequalities at ``speeds`` (m,)."""
        return replace(self, speeds=np.union1d(self.speeds, speeds))

    def with_knots(self, point: Point, knots: np.ndarray) -> tuple[KnotGrid, Point]:
        """The same P with more knots: ``knots`` (m,), which include those of the grid."""
        k = np.maximum(np.searchsorted(self.knots, knots) - 1, 0)
        share = (knots - self.knots[k]) / np.diff(self.knots)[k]
        P = np.tensordot(_between(k, share, len(self.knots)), point.P, 1)
        return replace(self, knots=knots), replace(point, P=P)

    def evened(self, point: Point) -> tuple[KnotGrid, Point]:
        """The grid in coordinates with a diagonal mean of P, and the identity as the mean of F at rate 0.

        The rounding of the Hessian is least in them. Where the mean of F is not positive, the coordinates
        stay.
        """
        n = len(self.basis)
        F = self.F(point, 0.0).mean(axis=0)[:n, :n]
        if not np.linalg.eigvalsh(F)[0] > 0:
            return self, point
        T = sl.eigh(point.P.mean(axis=0), F)[1]
        inverse = np.linalg.inv(T)
        grid = replace(self, basis=self.basis @ T, cost=inverse @ self.cost @ inverse.T)
        return grid, replace(point, P=T.T @ point.P @ T)


def _between(segment: np.ndarray, share: np.ndarray, knots: int) -> np.ndarray:
    """Weights (count, knots) of linear interpolation at the fraction ``share`` of ``segment``."""
    out = np.zeros((len(segment), knots))
    out[np.arange(len(out)), segment] = 1 - share
    out[np.arange(len(out)), segment + 1] = share
    return out


def feasible_point(grid: KnotGrid, start: Point, rate: float, unit: np.ndarray) -> Point | None:
    """A point with F > 0 for ``rate`` [m/s^2], near the centre of all such points, or None.

    ``unit`` (N, N) > 0 is the unit of F where F is positive nowhere at ``start`` and rate 0.
    """
    barrier = grid.barrier(rate)
    gain = grid.gain_direction()[None] if grid.delta[0] else np.zeros((0, *barrier.constant.shape))
    price = barrier.price(grid.cost)
    point = _feasible(barrier, start, _units(grid.F(start, 0.0), barrier.segment, unit), gain, price)
    return None if point is None else _centred(barrier, point, gain, price)


def _units(F: np.ndarray, segment: np.ndarray, unit: np.ndarray) -> np.ndarray:
    """Unit of each F_i: F_i (N, N) itself where it is positive.

    Elsewhere it is the mean of the positive F_i in the nearest segment that has any, or ``unit`` where no F_i
    is positive. A unit of another scale would hide the deficit of F_i from Newton's method.
    """
    positive = np.linalg.eigvalsh(F)[:, 0] > 0
    if not positive.any():
        return np.broadcast_to(unit, F.shape)
    out = F.copy()
    for i in np.flatnonzero(~positive):
        distance = np.where(positive, np.abs(segment - segment[i]), np.inf)
        out[i] = F[distance == distance.min()].mean(axis=0)
    return out


def _feasible(
    barrier: KnotBarrier, start: Point, units: np.ndarray, gain: np.ndarray, price: np.ndarray
) -> Point | None:
    """Newton's method on weight t - sum_i log det(F_i + t units_i) until t < 0.

    None where t stays positive.
    """
    P, size = start.P, len(units) * units.shape[-1]
    L = np.linalg.inv(np.linalg.cholesky(units))
    excess = np.full(len(gain), start.excess)
    F = barrier.F(P) + np.tensordot(excess, gain, 1)
    t = -float(np.linalg.eigvalsh(L @ F @ np.swapaxes(L, 1, 2)).min())
    if t < 0:
        return start
    y, weight = np.array([1.05 * t + 1e-3, *excess]), FIRST_WEIGHT
    directions = np.concatenate([units[None], gain])
    for _ in range(STEPS):
        slope = np.zeros(len(y))
        slope[0] = weight * size
        try:
            P, y, decrement = newton_step(barrier, P, y, directions, slope, price)
        except np.linalg.LinAlgError:
            return None
        if y[0] < 0:
            return Point(P, float(y[1:].sum()))
        if decrement < NEAR:
            if y[0] > OUT_OF_REACH / weight:
                return None
            weight *= NEXT_FACTOR
    return None


def _centred(barrier: KnotBarrier, point: Point, gain: np.ndarray, price: np.ndarray) -> Point:
    """A point nearer to the centre, after a few Newton steps."""
    P, y = point.P, np.full(len(gain), point.excess)
    for _ in range(CENTRING_STEPS):
        try:
            P, y, decrement = newton_step(barrier, P, y, gain, np.zeros(len(y)), price)
        except np.linalg.LinAlgError:
            break
        if decrement < NEAR:
            break
    return Point(P, float(y.sum()))
