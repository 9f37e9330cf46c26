"""Bounds of μ with real parameters: a checked Δ and a proved level (THEORY 6.2).

The lower bound is that of a Δ that makes I − M(jω) Δ singular (``real_crossings``, ``mu_lower``). The upper
bound is a level slightly above it, proved on boxes of the parameters and cells of frequencies
(``real_boxes``). Where a part cannot be proved, a search from this part may raise the lower bound and with it
the level.
"""

from dataclasses import dataclass

import numpy as np
import scipy.linalg as sl

from lpvguard.engine.synthesis.frequency_cells import PointBound, quadratic
from lpvguard.engine.synthesis.mu_lower import lower_bound
from lpvguard.engine.synthesis.mu_upper import POINT_RTOL, scaled_size, upper_bound
from lpvguard.engine.synthesis.real_boxes import ParameterBox, Part, Prover
from lpvguard.engine.synthesis.real_crossings import NOTHING, Crossing, RealSearch
from lpvguard.engine.synthesis.statespace import StateSpace
from lpvguard.engine.synthesis.structure import Structure

FIRST_PARTS, MOST_PARTS, MOST_MIXED, MORE_PARTS = 200, 1000, 300, 40
"""Largest number of parts: for the requested gap; for ``RELAXED`` with only real blocks; for ``RELAXED`` with
other blocks too; at each further level."""
RELAXED = 9e-3
"""Gap that is accepted where the parts are many. μ counts as resolved with a gap of up to 1 %
(``mu.RESOLVED``)."""
RAISE = 0.05
"""First relative increase of the level after too many parts. It doubles from level to level."""
ZERO = 1e-6
"""A μ below this share of the loop's size counts as zero, and the proved level is this share."""
NARROW, COARSE = 1e-8, 1e-2
"""Half widths of a box relative to 1/β. If a box narrower than ``NARROW`` cannot be proved, the reason is
rounding, and the level is raised. From then on ``COARSE`` replaces ``NARROW``."""
GRID, STARTS, AT_PEAKS = 120, 8, 3
MISSES = 6
"""The searches at one frequency end after this number of searches in sequence without success."""
FIRST, LATER = 4, 8
"""A search for a better lower bound starts from each of the first unproved parts, then from every eighth."""


@dataclass(frozen=True)
class RealMu:
    """Bounds of μ over an interval of frequencies.

    Attributes
    ----------
    upper : float, proved at every frequency by ``proof``
    lower : float, attained by ``delta``, shape (Σrows, Σcols), at ``omega`` [rad/s, continuous time]
    omega : float
    delta : ndarray or None
    proof : tuple of Part
    size : float, ``scaled_size`` where ‖M‖ is largest on a grid of frequencies
    """

    upper: float
    lower: float
    omega: float
    delta: np.ndarray | None
    proof: tuple[Part, ...]
    size: float


def real_mu(
    loop: StateSpace | np.ndarray,
    structure: Structure,
    low: float,
    high: float,
    rtol: float,
    least: float = 0.0,
    known: float = np.inf,
) -> RealMu:
    """Bound μ of a loop that has real blocks, from ``low`` to ``high`` [rad/s].

    ``loop`` is stable and in continuous time, or M (Σcols, Σrows) at one frequency. ``rtol`` is the target of
    the relative gap between the bounds. The gap is larger where the allowed number of parts is too small. The
    search begins at ``least``. It ends at ``known``, a level that is proved already, and its result then has
    no proof.
    """
    prover = Prover(loop, structure, 0.4 * rtol)
    grid = _grid(loop, low, high)
    largest = max((prover.response(omega)[0] for omega in grid), key=np.linalg.norm)
    size = scaled_size(largest, structure)
    search = _LowerSearch(prover, low, high)
    search.start(grid)
    level = max(search.best.value * (1 + rtol), ZERO * size, np.finfo(float).tiny, least)
    edge = np.full(len(search.real), 1 / level)
    todo, proof = [Part(ParameterBox(-edge, edge), low, high)], []
    tried, resisting, share, aim, most, narrow = 0, 0, RAISE, rtol, FIRST_PARTS, NARROW
    while todo and level < known:
        part = todo.pop()
        box = part.box.within(1 / level)
        if box is None:
            continue
        part = Part(box, part.low, part.high, part.point)
        proved, rest, omega = prover.advance(part, level)
        tried += 1
        if proved is not None:
            proof.append(proved)
        else:
            resisting += 1
            if (resisting <= FIRST or resisting % LATER == 0) and search.improve(part, omega):
                level = max(level, search.best.value * (1 + aim))
                rest = [part]
            elif box.radius.max() * level <= narrow:
                most, share, narrow = min(most, tried), max(share, 1.0), COARSE
        todo += rest
        if tried >= most and search.best.value and aim < RELAXED:
            aim, most = RELAXED, tried + (MOST_PARTS if search.pure else MOST_MIXED)
            level = max(level, search.best.value * (1 + aim))
        elif tried >= most:
            level, most, share = level * (1 + share), tried + MORE_PARTS, 2 * share
    best = search.best
    return RealMu(float(level), best.value, best.omega, best.delta, tuple(proof), size)


class _LowerSearch:
    """Search for the smallest Δ of a loop with real blocks. ``best`` is the smallest so far."""

    def __init__(self, prover: Prover, low: float, high: float):
        self.prover, self.one_frequency = prover, low == high
        structure = prover.structure
        self.real = [k for k, b in enumerate(structure.blocks) if b.kind == "repeated_real"]
        self.pure = len(self.real) == len(structure.blocks)
        rows = np.concatenate([np.r_[structure.row[k]] for k in self.real])
        cols = np.concatenate([np.r_[structure.col[k]] for k in self.real])
        places, self.embedded = np.ix_(rows, cols), np.ix_(cols, rows)

        def response(omega: float) -> tuple[np.ndarray, np.ndarray]:
            M, moved = prover.response(omega)
            return M[places], moved[places]

        real_blocks = Structure(tuple(structure.blocks[k] for k in self.real))
        self.search = RealSearch(response, real_blocks, low, high)
        self.best, self.misses = NOTHING, 0

    def start(self, grid: np.ndarray) -> None:
        """Search from crossings on ``grid`` (K,) [rad/s] and at the frequencies where M is largest."""
        for parameters, omega in self.search.starts(grid, STARTS):
            self._from_parameters(parameters, omega)
        if self.one_frequency or not self.pure:
            sizes = [(float(np.linalg.norm(self.prover.response(w)[0], 2)), w) for w in grid]
            for _, omega in sorted(sizes)[-AT_PEAKS:]:
                self._at_frequency(omega)

    def improve(self, part: Part, omega: float) -> bool:
        """Search from a part that could not be proved. Returns whether ``best`` became better."""
        before = self.best.value
        if part.box.centre.any():
            self._from_parameters(part.box.centre, omega)
        for parameters, _ in self.search.starts(np.array([omega]), 2, 0.3):
            self._from_parameters(parameters, omega)
        if not self.pure:
            self._at_frequency(omega)
        return self.best.value > before

    def _from_parameters(self, parameters: np.ndarray, omega: float) -> None:
        crossing = self.search.polished(parameters, omega)
        if crossing.delta is not None:
            structure = self.prover.structure
            delta = np.zeros((structure.n_cols, structure.n_rows), complex)
            delta[self.embedded] = crossing.delta
            self._offer(Crossing(crossing.value, crossing.omega, delta))

    def _at_frequency(self, omega: float) -> None:
        M, _ = self.prover.response(omega)
        structure = self.prover.structure
        upper, _, left, right, skew = upper_bound(M, structure, POINT_RTOL)
        if upper > self.best.value and self.misses < MISSES:
            before = self.best.value
            right_square = right @ right.conj().T
            point = PointBound(upper, left @ left.conj().T, 0 * right_square, right_square, skew)
            vectors = sl.eigh(quadratic(M, point), right_square)[1][:, -2:].T
            value, delta = lower_bound(M, structure, left, right, upper, STARTS, vectors=vectors)
            self._offer(Crossing(value, omega, delta))
            self.misses = 0 if self.best.value > before else self.misses + 1

    def _offer(self, crossing: Crossing) -> None:
        if crossing.delta is not None and crossing.value > self.best.value * (1 + 1e-9):
            self.best = crossing


def _grid(loop: StateSpace | np.ndarray, low: float, high: float) -> np.ndarray:
    """Grid (K,) [rad/s] of [low, high]: both ends, the decades of the poles, and points near each pole."""
    if not isinstance(loop, StateSpace):
        return np.array([low])
    poles = np.abs(loop.poles()) if loop.order else np.ones(1)
    spread = np.concatenate(
        [
            np.geomspace(0.1 * poles.min(), 10 * poles.max(), GRID),
            np.outer(poles, np.linspace(0.7, 1.3, 11)).ravel(),
        ]
    )
    return np.unique(np.concatenate([[low, high], spread[(spread > low) & (spread < high)]]))
