"""Proof of μ < β by D, G scalings on boxes of real parameters and cells of frequencies (THEORY 6.2).

μ(M(jω)) < β holds on an interval of frequencies exactly when I − M(jω) Δ is regular there for every Δ of size
1/β. The real parameters δ of such Δ fill a box. On a part of this box with centre c and half widths r,

    I − M Δ = (I − M Δ_c)(I − M_c Δ̃),   M_c = (I − M Δ_c)⁻¹ M S,   Δ = Δ_c + S Δ̃,

with S = r for real blocks and 1/β for complex ones, and Δ̃ of size 1. Scalings D, G of M_c prove the part
(``mu_upper``). A part without such scalings is halved (de Gaston & Safonov 1988; Newlin & Young 1997). The
gap of the scalings with real blocks vanishes as the parts shrink. A proof also holds for every larger β,
because its boxes contain the smaller box of that β.
"""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import partial

import numpy as np

from lpvguard.engine.synthesis.frequency_cells import (
    FrequencyCell,
    PointBound,
    cell,
    is_positive,
    middle,
    response_rounding,
)
from lpvguard.engine.synthesis.mu_upper import balance, triangular_scalings, upper_bound
from lpvguard.engine.synthesis.real_crossings import ROUNDING
from lpvguard.engine.synthesis.statespace import StateSpace
from lpvguard.engine.synthesis.structure import Structure

CHECKS = 60
"""Number of additional test frequencies of each proof, over the decades of the poles."""
WIDE = 4.0
"""A part with a larger ratio of its frequencies is halved in frequency before its box is halved."""
MANY = 8.0
"""If a part would need more cells as wide as the first, the cells of its halves are tried."""


@dataclass(frozen=True)
class ParameterBox:
    """A box of real parameters, ``low`` ≤ δ ≤ ``high``, each of shape (k,)."""

    low: np.ndarray
    high: np.ndarray

    @property
    def centre(self) -> np.ndarray:
        """Centre, shape (k,)."""
        return 0.5 * (self.low + self.high)

    @property
    def radius(self) -> np.ndarray:
        """Half widths, shape (k,)."""
        return 0.5 * (self.high - self.low)

    def within(self, size: float) -> ParameterBox | None:
        """Return the part of the box with |δ_i| ≤ ``size``, or None where it is empty."""
        low, high = np.maximum(self.low, -size), np.minimum(self.high, size)
        return ParameterBox(low, high) if (low < high).all() else None

    def halves(self, k: int) -> tuple[ParameterBox, ParameterBox]:
        """Return the two halves across parameter ``k``."""
        middle = self.centre[k]
        low, high = self.low.copy(), self.high.copy()
        low[k] = high[k] = middle
        return ParameterBox(self.low, high), ParameterBox(low, self.high)


class Shift:
    """Transformation of a loop with Δ into a loop with the Δ̃ of one box.

    ``box`` holds the parameters of the real blocks, in the order of the blocks. ``size`` of complex blocks is
    1/β.
    """

    def __init__(self, structure: Structure, box: ParameterBox, size: float):
        self.offset = np.zeros((structure.n_cols, structure.n_rows))
        self.scale = np.full(structure.n_cols, size)
        real = iter(zip(box.centre, box.radius, strict=True))
        for block, r, c in zip(structure.blocks, structure.row, structure.col, strict=True):
            if block.kind == "repeated_real":
                centre, radius = next(real)
                self.offset[c, r] = centre * np.eye(block.rows)
                self.scale[c] = radius

    def matrix(self, M: np.ndarray, moved: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return M_c of M, shape (Σcols, Σrows), and the rounding of its entries.

        ``moved`` is the rounding of the entries of M.
        """
        opened = np.linalg.inv(np.eye(len(M)) - M @ self.offset)
        with np.errstate(
            over="ignore", invalid="ignore"
        ):  # for an infinite Δ, which is refused as not finite
            shifted = opened @ M * self.scale
            entries = np.abs(opened) @ moved
            return shifted, entries * self.scale + entries @ np.abs(self.offset) @ np.abs(shifted)

    def system(self, G: StateSpace) -> StateSpace:
        """Return the loop whose response is M_c, for a loop ``G`` with the response M."""
        opened = np.linalg.inv(np.eye(G.n_outputs) - G.D @ self.offset)
        fed = self.offset @ opened
        return StateSpace(
            G.A + G.B @ fed @ G.C,
            (G.B @ fed @ G.D + G.B) * self.scale,
            opened @ G.C,
            opened @ G.D * self.scale,
        )


def proved_at(
    M: np.ndarray, moved: np.ndarray, structure: Structure, slack: float, nearby: PointBound | None
) -> PointBound | None:
    """Find scalings that prove μ(M) < 1 for M (Σcols, Σrows); None where no scalings prove it.

    ``moved`` (Σcols, Σrows) is the rounding of the entries of M. The search ends at a bound ``slack`` below
    1. It tries the scalings ``nearby`` first.
    """
    if not np.isfinite(M).all():
        return None
    left, right = balance(M, structure)
    no_skew = np.zeros((len(right), len(left)))
    alone = PointBound(1.0, left, np.zeros_like(right), right, no_skew)
    for simple in (nearby, alone):
        if simple is not None and is_positive(M, moved, simple, 1.0):
            return simple
    scalings = [upper_bound(M, structure, 0.25 * slack, 1.0)[2:]]
    for left, right, skew in itertools.chain(scalings, triangular_scalings(M, moved, structure)):
        right = right @ right.conj().T
        point = PointBound(1.0, left @ left.conj().T, np.zeros_like(right), right, skew)
        if is_positive(M, moved, point, 1.0):
            return point
    return None


@dataclass(frozen=True)
class Part:
    """A box of parameters for frequencies from ``low`` to ``high`` [rad/s], continuous time.

    ``point`` holds the scalings that prove the part. Before its proof it holds those of a neighbour, if any.
    """

    box: ParameterBox
    low: float
    high: float
    point: PointBound | None = None


class Prover:
    """Proof of μ < β, part by part.

    ``loop`` is in continuous time, or M (Σcols, Σrows) at one frequency. ``slack`` is that of `proved_at`.
    """

    def __init__(self, loop: StateSpace | np.ndarray, structure: Structure, slack: float = 0.0):
        self.loop, self.structure, self.slack = loop, structure, slack
        poles = np.abs(loop.poles()) if isinstance(loop, StateSpace) and loop.order else np.ones(1)
        self.slowest, self.fastest = float(poles.min()), float(poles.max())
        self.checked = np.zeros(0)
        if isinstance(loop, StateSpace):
            decades = np.geomspace(0.1 * self.slowest, 10 * self.fastest, CHECKS)
            self.checked = np.unique(np.concatenate([poles, np.abs(loop.poles().imag), decades]))

    def response(self, omega: float) -> tuple[np.ndarray, np.ndarray]:
        """Return M at ``omega`` [rad/s] and the rounding of its entries, both of shape (Σcols, Σrows)."""
        if isinstance(self.loop, StateSpace):
            return self.loop.response([omega])[0], response_rounding(self.loop, omega)
        return self.loop, ROUNDING * np.abs(self.loop)

    def advance(self, part: Part, beta: float) -> tuple[Part | None, list[Part], float]:
        """Prove one cell of ``part`` at level ``beta``.

        Returns the proved cell (None where no scalings prove one), the parts that remain, and the frequency
        [rad/s] of the search for scalings.
        """
        shift = Shift(self.structure, part.box, 1 / beta)
        centre, M = self._centre(part), None
        inside = middle(part.low, part.high, self.fastest)
        for omega in dict.fromkeys((centre, inside)) if part.low < part.high else (centre,):
            try:
                M, moved = shift.matrix(*self.response(omega))
            except np.linalg.LinAlgError:  # the centre of the box is singular
                continue
            point = proved_at(M, moved, self.structure, self.slack, part.point)
            if point is None:
                break
            low, high = self._reached(shift, FrequencyCell(part.low, part.high, point), omega)
            cut = low > part.low or high < part.high
            if (cut and self._is_narrow(part)) or not self._holds(shift, low, high, point):
                continue
            proved = Part(part.box, low, high, point)
            boxes = self._wider(part, proved, M, omega, beta) or [proved]
            rest = [replace(p, low=part.low, high=low) for p in boxes if low > part.low]
            rest += [replace(p, low=high, high=part.high) for p in boxes if high < part.high]
            return proved, rest, centre
        return None, self._halves(part, M), centre

    def _wider(self, part: Part, proved: Part, M: np.ndarray, omega: float, beta: float) -> list[Part]:
        """Return the halves of ``part``'s box with their scalings, if they need fewer cells.

        The scalings are those at ``omega`` [rad/s]. The result is empty if cells like ``proved`` are at least
        as fast. If an eigenvalue of M Δ is nearly real at all frequencies of the part, scalings of the whole
        box hold only on narrow cells. M belongs to the whole box.
        """
        width = self._width(proved)
        if not 0 < width < self._width(part) / MANY:
            return []
        halves, cells = [], 0.0
        for half in self._halved_box(part, M):
            shift = Shift(self.structure, half.box, 1 / beta)
            try:
                point = proved_at(*shift.matrix(*self.response(omega)), self.structure, self.slack, None)
            except np.linalg.LinAlgError:  # the centre of the box is singular
                return []
            if point is None:
                return []
            reached = self._reached(shift, FrequencyCell(part.low, part.high, point), omega)
            halves.append(replace(half, point=point))
            cells += 1 / max(self._width(replace(half, low=reached[0], high=reached[1])), width / MANY)
        return halves if cells * width < 1 else []

    def _width(self, part: Part) -> float:
        """Return the logarithmic width of ``part``'s frequencies, within the decades of the poles."""
        low, high = np.clip((part.low, part.high), 0.1 * self.slowest, 10 * self.fastest)
        return float(np.log(high / low))

    def verified(self, parts: Sequence[Part], beta: float, low: float, high: float) -> bool:
        """Return whether ``parts`` prove μ < ``beta`` from ``low`` to ``high`` [rad/s].

        The scalings of each part must pass a new test on its box and frequencies. The parts together must
        contain every Δ of size 1/β at every frequency.
        """
        for part in parts:
            if part.point is None:
                return False
            shift = Shift(self.structure, part.box, 1 / beta)
            omega = self._centre(part)
            if not self._positive(shift, part.point, omega):
                return False
            if not self._holds(shift, part.low, part.high, part.point):
                return False
            if self._reached(shift, FrequencyCell(part.low, part.high, part.point), omega) != (
                part.low,
                part.high,
            ):
                return False
        size = np.full(sum(b.kind == "repeated_real" for b in self.structure.blocks), 1 / beta)
        corners = [(np.append(p.box.low, p.low), np.append(p.box.high, p.high)) for p in parts]
        return _contain(corners, np.append(-size, low), np.append(size, high))

    def _reached(self, shift: Shift, within: FrequencyCell, omega: float) -> tuple[float, float]:
        """Ends of the largest part of the cell ``within``, around ``omega``, on which its scalings hold."""
        if not isinstance(self.loop, StateSpace):
            return within.low, within.high

        positive = partial(self._positive, shift, within.point)
        return cell(shift.system(self.loop), within.point, 1.0, omega, within.low, within.high, positive)

    def _positive(self, shift: Shift, point: PointBound, omega: float) -> bool:
        try:
            return is_positive(*shift.matrix(*self.response(omega)), point, 1.0)
        except np.linalg.LinAlgError:  # the centre of the box is singular
            return False

    def _holds(self, shift: Shift, low: float, high: float, point: PointBound) -> bool:
        """Return whether the scalings hold at the frequencies of ``checked`` in [low, high]."""
        inside = self.checked[(self.checked >= low) & (self.checked <= high)]
        return all(self._positive(shift, point, omega) for omega in inside)

    def _is_narrow(self, part: Part) -> bool:
        """Return whether M hardly changes over ``part``.

        Cells that leave a rest of such a part would never end.
        """
        return (
            part.high <= max(part.low * (1 + self.slack), self.slack * self.slowest)
            or part.low * self.slack >= self.fastest
        )

    def _centre(self, part: Part) -> float:
        """Return a frequency [rad/s] of ``part``: its middle, or its end at 0 or infinity if it is narrow."""
        if part.low == part.high or (part.low == 0.0 and self._is_narrow(part)):
            return part.low
        if np.isinf(part.high) and self._is_narrow(part):
            return part.high
        return middle(part.low, part.high, self.fastest)

    def _halves(self, part: Part, M: np.ndarray | None) -> list[Part]:
        """Halve the frequency interval of a wide part, or else its box."""
        if part.high > max(WIDE * part.low, self.slowest) and part.low < self.fastest:
            omega = middle(part.low, part.high, self.fastest)
            return [replace(part, high=omega, point=None), replace(part, low=omega, point=None)]
        return self._halved_box(part, M)

    def _halved_box(self, part: Part, M: np.ndarray | None) -> list[Part]:
        """Halve the box of ``part`` across the parameter with the largest effect on M."""
        weight = part.box.radius
        if M is not None:
            s = self.structure
            weight = np.array(
                [
                    np.linalg.norm(M[r]) * np.linalg.norm(M[:, c])
                    for block, r, c in zip(s.blocks, s.row, s.col, strict=True)
                    if block.kind == "repeated_real"
                ]
            )
        return [replace(part, box=half, point=None) for half in part.box.halves(int(np.argmax(weight)))]


def _contain(boxes: Sequence[tuple[np.ndarray, np.ndarray]], low: np.ndarray, high: np.ndarray) -> bool:
    """Return whether the union of ``boxes`` contains the box from ``low`` to ``high``, all (d,)."""
    near = [(a, b) for a, b in boxes if (a <= high).all() and (b >= low).all()]
    if any((a <= low).all() and (b >= high).all() for a, b in near):
        return True
    for a, b in near:
        for axis in range(len(low)):
            for face in (a[axis], b[axis]):
                if low[axis] < face < high[axis]:
                    first, second = high.copy(), low.copy()
                    first[axis] = second[axis] = face
                    return _contain(near, low, first) and _contain(near, second, high)
    return False
