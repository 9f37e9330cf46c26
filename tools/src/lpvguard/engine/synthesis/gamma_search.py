"""Search for γ_opt, the least level of any stabilising controller.

The Riccati equations decide whether one level can be reached. The search first tries the bound at single
frequencies, which is most often the optimum of a weighted problem. Otherwise it brackets the optimum. The
reduced problem of a singular plant does not contain the Parrott bound at the frequency where rank is lost.
This bound is kept separately, as ``floor``.
"""

from collections.abc import Iterator
from functools import cached_property
from typing import TypeGuard

import numpy as np

from lpvguard.engine.synthesis.central import central_controller, coupling_margin
from lpvguard.engine.synthesis.direct_terms import column_rank, direct_scale, parrott_bound
from lpvguard.engine.synthesis.errors import SynthesisError
from lpvguard.engine.synthesis.partition import Plant
from lpvguard.engine.synthesis.riccati import Side
from lpvguard.engine.synthesis.singular import extended_plant, reduced_side
from lpvguard.engine.synthesis.statespace import StateSpace
from lpvguard.engine.synthesis.zeros import axis_bounds, axis_zeros

LIMIT_RTOL = 1e-4
"""Relative rounding error that is allowed in the bound at a single frequency."""
GAMMA_RTOL = 1e-6
"""Relative width of the bracket of a regular problem's optimum."""


def _above_one(value: float | None) -> TypeGuard[float]:
    return value is not None and value > 1


class GammaProblem:
    """Search for the optimum of one continuous plant, and its central controllers.

    ``notes`` describe singularities in words. ``floor`` is the largest Parrott bound, of the direct terms and
    of the zeros on the imaginary axis. ``axis`` holds the frequencies of these zeros in rad/s.
    """

    def __init__(self, P: Plant):
        self.P = P
        self.control, self.filter = reduced_side(P), reduced_side(P.dual)
        n = len(P.A)
        self.notes: list[str] = []
        self._couplings: dict[float, float | None] = {}  # one level is often needed again
        self.rank_lost = False
        for side, Q, name, signal in (
            (self.control, P, "D12", "controls without direct cost"),
            (self.filter, P.dual, "D21", "measurements without noise"),
        ):
            full_rank = Q.D12.shape[1]
            rank, _ = column_rank(Q.D12, direct_scale(float(np.linalg.norm(Q.A, 2)), Q.B2, Q.C1))
            if rank < full_rank:
                self.rank_lost = True
                self.notes.append(
                    f"{name} has rank {rank} of {full_rank} ({signal}): {n - side.A.shape[0]} states removed"
                )
            if side.axis:
                where = "P12" if name == "D12" else "P21"
                shown = ", ".join(f"{w:.4g}" for w in side.axis)
                self.notes.append(f"{where} has zeros on the imaginary axis at {shown} rad/s")
        self.axis = tuple(sorted(set(self.control.axis + self.filter.axis)))
        self.floor = max([parrott_bound(P), *axis_bounds(P, self.axis)])
        self.soft = (False, False)
        if self.singular:
            probe = extended_plant(P, self.soft, 1e-2)
            scale = float(np.linalg.norm(P.A, 2))
            self.soft = (
                bool(axis_zeros(Side.regular(probe), scale)),
                bool(axis_zeros(Side.regular(probe.dual), scale)),
            )

    @property
    def singular(self) -> bool:
        """Whether D12 or D21 has lost rank or P12 or P21 has a zero on the imaginary axis."""
        return self.rank_lost or bool(self.axis)

    @property
    def certain(self) -> float:
        """Lower bound of γ for every controller, from single frequencies and direct terms alone."""
        return max(self.floor, self._lowest)

    @cached_property
    def _lowest(self) -> float:
        """Lower bound of γ from single frequencies: DC and those of the poles."""
        return max(side.frequency_bound() for side in (self.control, self.filter))

    def coupling(self, gamma: float) -> float | None:
        """γ²/ρ(XY), above 1 exactly when γ is reached.

        It is negative past a blow-up of X or Y, and None without a solution.
        """
        if gamma not in self._couplings:
            X = self.control.solve(gamma)
            Y = self.filter.solve(gamma) if X is not None else None
            self._couplings[gamma] = None if X is None or Y is None else coupling_margin(X, Y, gamma)
        return self._couplings[gamma]

    def reached(self, gamma: float) -> bool:
        """Whether some stabilising controller reaches ``gamma``."""
        return gamma > self.floor and _above_one(self.coupling(gamma))

    def optimum(self, rtol: float, guess: float | None = None) -> float:
        """The infimum of reachable γ, to ``rtol``.

        It equals the bound at single frequencies where this bound can be reached. Otherwise the search
        brackets it above this bound or around ``guess``, and secant steps narrow the bracket. The search
        starts from above. Far below the optimum, rounding may make the Riccati equations seem to have a
        solution. Raises SynthesisError when no level can be reached.
        """
        limit, value = self._frequency_limit(rtol)
        floor, floor_value, start = limit, value, max(2 * limit, 1.0)
        if _above_one(value):
            if not self.reached(limit * (1 - LIMIT_RTOL)):
                return limit
            floor, floor_value, start = self.floor, None, limit
        scale, growth = max(self.floor, 1e-3), 10.0
        if guess:
            start, growth = max(guess, limit * (1 + rtol)), 1 + 20 * rtol
        if start > limit:
            value = self.coupling(start)
        if _above_one(value):
            high, high_value, low, low_value = start, value, floor, floor_value
            while low < high / growth:
                trial = high / growth
                value = self.coupling(trial)
                if not _above_one(value):
                    low, low_value = trial, value
                    break
                high, high_value, growth = trial, value, growth**2 if guess else growth
                if high < 1e-12 * scale:
                    return floor
        else:
            low, low_value, high, high_value = self._reachable(
                start, value, growth, 1e14 * scale, bool(guess)
            )
        return self._narrow(rtol, low, low_value, high, high_value)

    def _reachable(
        self, low: float, low_value: float | None, growth: float, limit: float, faster: bool
    ) -> tuple[float, float | None, float, float]:
        """A bracket above the unreachable level ``low``: both ends, and the ``coupling`` at each.

        Levels grow by the factor ``growth``. With ``faster`` this factor is squared at each step. Raises
        SynthesisError above ``limit``.
        """
        while True:
            high, growth = low * growth, growth**2 if faster else growth
            value = self.coupling(high)
            if high > limit:
                raise SynthesisError(
                    "H-infinity synthesis",
                    "gamma",
                    f"no level up to {high:.1g} can be reached",
                    "an optimum that double precision can show",
                )
            if _above_one(value):
                return low, low_value, high, value
            low, low_value = high, value

    def _frequency_limit(self, rtol: float) -> tuple[float, float | None]:
        """A level ``rtol`` above the largest bound at a single frequency, and the ``coupling`` at this level.

        Where a Riccati equation has no solution, the axis eigenvalues of its Hamiltonian show frequencies
        where the bound may be larger (as in Bruinsma & Steinbuch 1990).
        """
        sides = self.control, self.filter
        bound, level, value = self._lowest, self.floor, None
        if self.axis or bound * (1 - LIMIT_RTOL) <= level:  # near the floor, rounding decides
            return level, None
        for _ in range(20):
            if bound <= level:
                break
            level = bound * (1 + min(rtol, GAMMA_RTOL))  # the finer tolerance costs no more
            value = self.coupling(level)
            if value is not None:
                break
            bound = max(side.frequency_bound(level) for side in sides)
        return level, value

    def _narrow(
        self, rtol: float, low: float, low_value: float | None, high: float, high_value: float
    ) -> float:
        """Secant steps on γ²/ρ − 1 in log γ, guarded by bisection, until high/low ≤ 1 + rtol."""
        stalled = 0
        for step in range(80):
            if high <= low * (1 + rtol):
                break
            a, b = np.log(low), np.log(high)
            width = b - a
            middle = a + 0.5 * width
            if (
                low_value is not None
                and np.isfinite(high_value)
                and abs(low_value) < 1e3
                and stalled < 2
                and step % 4 != 3
            ):
                t = (1 - low_value) / (high_value - low_value)
                # aim a little past the root: the next step then approaches from the other side
                past = 0.3 * rtol + (0.02 * width * abs(0.5 - t) if stalled else 0.0)
                middle = np.clip(
                    a + t * width + (past if t < 0.5 else -past), a + 1e-4 * width, b - 1e-4 * width
                )
            gamma = float(np.exp(middle))
            value = self.coupling(gamma)
            if _above_one(value):
                high, high_value = gamma, value
            else:
                low, low_value = gamma, value
            stalled = stalled + 1 if np.log(high / low) > 0.5 * width else 0
        return high

    def attempts(self) -> Iterator[tuple[float, float]]:
        """Pairs (ε, share of the back-off) in the order of trials, mild controllers first."""
        if not self.singular:
            yield from ((0.0, share) for share in (0.97, 0.5, 0.25))
        for exponent in range(1, 15):
            yield 10.0**-exponent, 0.9

    def controller(self, gamma: float, epsilon: float) -> StateSpace | None:
        """Central controller at ``gamma`` of the plant with extra cost and noise ε, or None.

        None means that ``gamma`` is too low.
        """
        P = self.P if epsilon == 0 else extended_plant(self.P, self.soft, epsilon)
        return central_controller(P, gamma)
