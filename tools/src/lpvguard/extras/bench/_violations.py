"""Search for violations of a certificate at a moving speed: a gain above 1, or growth.

The search varies an LTI Delta within W_delta and a speed history with a stated largest |dv/dt|. Each scalar
block of Delta is an all-pass of at most first order, so its gain is 1 at every frequency. The history holds
one speed for each sample. The search starts from triangular histories. One simulation of the loop and one of
its adjoint give the derivative of the gain by the speed of each sample. Dynamic programming then finds the
admissible history with the largest predicted gain (Frank and Wolfe 1956). A violation is admissible and
simulated, so it refutes the certificate. A search without a violation proves nothing.
"""

from __future__ import annotations

import itertools
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from ...engine.synthesis.lpv_certificate import Family
from ...engine.synthesis.statespace import StateSpace, append, gain
from ...engine.synthesis.varying import History, OverSpeed, all_pass, close, steered

CORNERS = (np.inf, 0.5, 2.0, 8.0)
"""Corner frequencies [rad/s] that are tried for the all-pass of each block; inf: a constant."""
UNIT = 0.02
"""Largest distance between neighbouring speeds on the grid of a history [m/s]."""
SHARES = (1.0, 0.4)
"""Step sizes towards the history with the largest predicted gain, in the order of trial."""
QUICK, WHOLE = 3, 8
"""Steps of the bidiagonal iteration during the search, and at its end."""
ROUNDS = 3
"""Number of rounds over Delta and speeds, and number of speed steps in a round."""
DRAWN = 12
"""Number of random Delta that are tried with the triangles."""
LADDER, PRECISION = 4.0, 1.3
"""Factor between tried rates at first, and factor at which the search stops."""


@dataclass(frozen=True)
class Loop:
    """The searched loop: its first channels are those of Delta, which has ``blocks`` scalar blocks."""

    over: OverSpeed
    blocks: int
    Ts: float

    @property
    def inputs(self) -> int:
        """Number of inputs that remain when Delta is closed."""
        return self.over.at_nodes.shape[2] - self.over.n - self.blocks

    def history(self, speeds: np.ndarray, delta: StateSpace) -> History:
        """The loop with Delta closed along ``speeds`` (T,) [m/s]."""
        visited, index = np.unique(speeds, return_inverse=True)
        S = close(self.over.at(visited), self.over.n, delta)
        return History(S, index, self.over.n + delta.order)

    def delta(self, corners: Sequence[tuple[float, float]]) -> StateSpace:
        """Make a diagonal Delta of all-passes, each from its (sign, corner [rad/s])."""
        if not corners:
            return gain(np.zeros((0, 0)), self.Ts)
        return append(*(all_pass(sign, corner, self.Ts) for sign, corner in corners))


@dataclass(frozen=True)
class Found:
    """A history of the speed (T,) [m/s] and the input ``w`` (T, m) with a large gain.

    ``corners`` holds a (sign, corner [rad/s]) for each block of Delta.
    """

    gain: float
    corners: tuple[tuple[float, float], ...]
    speeds: np.ndarray
    w: np.ndarray


@dataclass(frozen=True)
class SpeedGrid:
    """Grid of the speeds of a history: low + unit i [m/s] for i = 0..places − 1, up to high.

    ``moves`` is the largest number of grid steps from one sample to the next.
    """

    low: float
    high: float
    unit: float
    places: int
    moves: int

    @classmethod
    def for_rate(cls, low: float, high: float, rate: float, Ts: float) -> SpeedGrid:
        """Make a grid from low to high [m/s] for |dv/dt| <= rate [m/s^2]."""
        moves = max(1, int(np.ceil(rate * Ts / UNIT)))
        unit = rate * Ts / moves
        return cls(low, high, unit, int((high - low) / unit * (1 + 1e-12)) + 1, moves)

    def near(self, places: np.ndarray) -> tuple[int, int]:
        """Window of grid places around ``places`` (T,), wider by the largest move in T / 2 samples."""
        reach = self.moves * len(places) // 2
        first, last = int(np.floor(places.min())) - reach, int(np.ceil(places.max())) + reach
        return max(first, 0), min(last, self.places - 1)

    def speeds(self, places: np.ndarray) -> np.ndarray:
        """Speeds (T,) [m/s] of places (T,), rounded to whole places.

        Rounding half up is monotone and keeps whole differences. If no sample of ``places`` moves by more
        than ``moves``, the rounded history does not either.
        """
        whole = np.clip(np.floor(places + 0.5), 0, self.places - 1)
        return np.minimum(self.low + self.unit * whole, self.high)


def triangle(grid: SpeedGrid, samples: int, low: float, high: float, start: float = 0.0) -> np.ndarray:
    """Make a history (samples,) between two speeds at the largest rate, from the share ``start`` of a period
    on.
    """
    first, last = (np.rint((v - grid.low) / grid.unit) for v in (low, high))
    span = max(last - first, 1.0)
    way = (2 * span * start + grid.moves * np.arange(samples)) % (2 * span)
    return grid.speeds(first + np.minimum(way, 2 * span - way))


def sinusoid(grid: SpeedGrid, samples: int, low: float, high: float, start: float = 0.0) -> np.ndarray:
    """Make a sinusoidal history (samples,) whose largest slope is the largest rate.

    It begins at the share ``start`` of the period.
    """
    middle, swing = 0.5 * (low + high), 0.5 * (high - low)
    angle = 2 * np.pi * start + grid.moves * grid.unit / max(swing, grid.unit) * np.arange(samples)
    return grid.speeds((middle + swing * np.sin(angle) - grid.low) / grid.unit)


def ramps(grid: SpeedGrid, samples: int, levels: np.ndarray, hold: int) -> np.ndarray:
    """Make a history (samples,) that moves at the largest rate from level to level, and then back.

    It holds each of the ``levels`` (k,) [m/s] for ``hold`` samples.
    """
    places = np.rint((levels - grid.low) / grid.unit).astype(int)
    parts = [np.full(hold + 1, places[0])]
    for here, there in itertools.pairwise(places):
        way = np.arange(0, abs(there - here), grid.moves)[1:]
        parts += [here + np.sign(there - here) * way, np.full(hold + 1, there)]
    whole = np.concatenate(parts)
    return grid.speeds(np.resize(np.concatenate([whole, whole[::-1]]), samples))


def injected(family: Family) -> Family:
    """Add a channel from Delta's outputs to Delta's inputs to a family.

    With Delta closed, the gain of this channel is unbounded if the loop grows.
    """
    G = family.at(float(family.nodes[0]))
    p, m = G.n_outputs - family.n_probes, G.n_inputs
    rows, columns = np.r_[:p, : G.n_outputs], np.r_[:m, :m]
    return replace(family, at=lambda v: family.at(v).select(rows, columns))


class Search:
    """Search over histories of one loop; ``seed`` draws the first input."""

    def __init__(self, loop: Loop, samples: int, seed: int):
        self.loop, self.samples = loop, samples
        self.first = np.random.default_rng(seed).standard_normal((samples, loop.inputs))

    def at(self, rate: float, enough: float = np.inf, before: Found | None = None) -> Found:
        """Search the largest gain for |dv/dt| <= ``rate`` [m/s^2], until the gain exceeds ``enough``.

        ``before`` is a result at another rate. Its Delta starts the search.
        """
        low, high = self.loop.over.nodes[[0, -1]]
        grid = SpeedGrid.for_rate(low, high, rate, self.loop.Ts)
        corners = before.corners if before else ((1.0, np.inf),) * self.loop.blocks
        starts = [triangle(grid, self.samples, low, high, share) for share in (0.0, 0.5, 0.25, 0.75)]
        tried = [self._measured(speeds, corners, self.first, QUICK) for speeds in starts]
        best = max(tried, key=lambda one: one.gain)
        for _ in range(ROUNDS):
            last = best.gain
            best = self._other_delta(best, enough)
            best = self._other_speeds(best, grid, enough)
            if best.gain > enough or best.gain < last * (1 + 1e-3):
                break
        return self._measured(best.speeds, best.corners, best.w, WHOLE)

    def _measured(self, speeds, corners, w, steps: int) -> Found:
        reached, w = self.loop.history(speeds, self.loop.delta(corners)).gain(w, steps)
        return Found(reached, corners, speeds, w)

    def _other_delta(self, best: Found, enough: float) -> Found:
        """Try all signs and CORNERS, block by block, and return the best result."""
        for block in range(self.loop.blocks):
            for choice in ((sign, corner) for corner in CORNERS for sign in (1.0, -1.0)):
                if best.gain > enough:
                    return best
                corners = (*best.corners[:block], choice, *best.corners[block + 1 :])
                if corners != best.corners:
                    one = self._measured(best.speeds, corners, best.w, QUICK)
                    best = one if one.gain > best.gain else best
        return best

    def _other_speeds(self, best: Found, grid: SpeedGrid, enough: float) -> Found:
        """Step towards the history with the largest predicted gain, while this increases the gain."""
        for _ in range(ROUNDS):
            if best.gain > enough:
                return best
            delta = self.loop.delta(best.corners)
            visited = np.unique(best.speeds)
            dS = self._closed_derivative(visited, delta)
            slope = self.loop.history(best.speeds, delta).slopes(dS, best.w)
            now = (best.speeds - grid.low) / grid.unit
            low, high = grid.near(now)
            favoured = low + steered(slope, grid.moves, high - low + 1)
            for share in SHARES:
                speeds = grid.speeds(now + share * (favoured - now))
                one = self._measured(speeds, best.corners, best.w, QUICK)
                if one.gain > best.gain * (1 + 1e-4):
                    best = one
                    break
            else:
                return best
        return best

    def _closed_derivative(self, speeds: np.ndarray, delta: StateSpace) -> np.ndarray:
        """dS/dv of the loop with Delta closed, by a central difference.

        The closed loop is quadratic in S, so this difference is exact.
        """
        S, dS = self.loop.over.at(speeds), self.loop.over.derivative(speeds)
        less, more = (close(S + sign * dS, self.loop.over.n, delta) for sign in (-1.0, 1.0))
        return 0.5 * (more - less)


def closed_period(grid: SpeedGrid, speeds: np.ndarray) -> np.ndarray:
    """Extend a history (T,) to one period: at its end, it returns to its first speed at the largest rate."""
    way = np.arange(0.0, abs(speeds[-1] - speeds[0]), grid.moves * grid.unit)[1:]
    back = speeds[-1] + np.sign(speeds[0] - speeds[-1]) * way
    return np.concatenate([speeds, grid.speeds((back - grid.low) / grid.unit)])


def fastest_growth(loop: Loop, rate: float, samples: int, seed: int) -> tuple[float, np.ndarray]:
    """Search the fastest growth over one period with |dv/dt| <= ``rate``, for a loop of `injected`.

    The search tries the history with the largest gain, extended to a period, and triangles with random Delta.
    Returns the factor of one period (above 1: growth), and its speeds (T,) [m/s].
    """
    low, high = loop.over.nodes[[0, -1]]
    grid, random = SpeedGrid.for_rate(low, high, rate, loop.Ts), np.random.default_rng(seed)
    largest = Search(loop, samples, seed).at(rate)
    tried = [(largest.corners, closed_period(grid, largest.speeds))]
    drawn = [largest.corners, *(drawn_corners(random, loop.blocks) for _ in range(DRAWN))]
    for share in (1.0, 0.5, 0.2, 0.07):  # of the range
        for place in (0.0, 0.5, 1.0):
            first = low + place * (1 - share) * (high - low)
            last = first + share * (high - low)
            period = max(2, 2 * int(np.rint((last - first) / grid.unit)) // grid.moves)
            speeds = triangle(grid, period, first, last)
            tried += [(corners, closed_period(grid, speeds)) for corners in drawn]
    grown = [loop.history(speeds, loop.delta(corners)).growth() for corners, speeds in tried]
    k = int(np.argmax(grown))
    return grown[k], tried[k][1]


def drawn_corners(random: np.random.Generator, blocks: int) -> tuple[tuple[float, float], ...]:
    """Draw random all-passes (sign, corner); about every third one is a constant.

    The corners lie between the least and the largest finite CORNERS.
    """
    finite = [c for c in CORNERS if np.isfinite(c)]
    return tuple(
        (
            float(random.choice([-1.0, 1.0])),
            np.inf
            if random.random() < 1 / 3
            else float(np.exp(random.uniform(*np.log([0.1, 2 * max(finite)])))),
        )
        for _ in range(blocks)
    )


@dataclass(frozen=True)
class LeastRate:
    """Least rate |dv/dt| with a violation, and the largest tried rate below it without one.

    ``rate`` [m/s^2] is None if no tried rate has a violation. ``without`` [m/s^2] is 0 if no rate was tried.
    """

    rate: float | None
    without: float


def least_violating(violates: Callable[[float], bool], largest: float, smallest: float) -> LeastRate:
    """Find the least rate [m/s^2] with a violation, between ``smallest`` and ``largest``.

    The search divides the rate by LADDER while there is a violation. It then bisects until the ratio of the
    two rates is at most PRECISION.
    """
    if not violates(largest):
        return LeastRate(None, largest)
    rate, without = largest, 0.0
    while rate / LADDER >= smallest:
        if violates(rate / LADDER):
            rate /= LADDER
        else:
            without = rate / LADDER
            break
    while without and rate / without > PRECISION:
        middle = float(np.sqrt(rate * without))
        if violates(middle):
            rate = middle
        else:
            without = middle
    return LeastRate(rate, without)
