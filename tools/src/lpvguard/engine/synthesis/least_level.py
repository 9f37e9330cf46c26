"""A level of robust performance that a storage function proves while the speed moves.

A scheduled loop has the rows eta of Delta's inputs and z of performance, and the columns xi of Delta's
outputs and w. It keeps the level beta at a rate when a gain g and P(v) > 0 exist with

    x' P(v) x - x+' P(v+) x+ + g^2 (|xi|^2 - |eta|^2) + |w|^2 - |z|^2 / beta^2 > 0

for all v in the range and |v+ - v| <= rate Ts. The gain from w to z, from rest, is then below beta for every
linear time-invariant Delta within the bound. The level beta = 1 is robust performance. Any other beta is
robust performance with z weighted by 1 / beta. g is the gain of the scaling D. The shape of D is given;
``tuned`` finds the best shape at frozen speeds.

``find_level`` searches for g and for a P that is linear between knots, by the barrier method
(knot_search.py). It requires the inequality also at speeds between the knots, because the knots alone would
not imply it there. The search cannot start from the solutions at frozen speeds, whose P changes too quickly
with the speed. It therefore begins at rate 0 with a smooth P0 + v P1 + P2 / v near these solutions. The rate
then doubles step by step, and each step starts from the previous P. P also has a cost, ``COST``. Where a
proof fails, its speeds are added to the grid. ``prove`` proves the level for all speeds.
"""

import itertools
from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np
from scipy.optimize import minimize_scalar

from lpvguard.base.sampling import evenly
from lpvguard.engine.synthesis.dk import Scaling
from lpvguard.engine.synthesis.knot_search import KnotGrid, Point, feasible_point
from lpvguard.engine.synthesis.lpv_certificate import Family, LpvCertificate, Storage, frozen_at, prove
from lpvguard.engine.synthesis.norms import hinf_norm
from lpvguard.engine.synthesis.statespace import StateSpace
from lpvguard.engine.synthesis.storage_grid import StorageGrid, refined, terms, unmoved

LEVELS = (1.0, 2.5, 5.0, 10.0)
"""Levels in the order of trials, until one is proved."""
ROOMY = 0.9
"""The search at moving speeds starts only if the gain at frozen speeds is at most this number."""
GAIN_SPEEDS = 4
"""Number of nodes, ends included, at which D's gain is chosen."""
RATE_STEPS = 6
"""Number of rates after rate 0. Each is twice the previous one, and the last is the wanted rate."""
COST = 1e-4
"""Cost of P in the search, in units of the inverse mean of the frozen solutions.

It limits P to about 1e4 times this mean. A larger P would improve the inequalities only at the grid's speeds.
"""
KNOT_PARTS, SPEED_PARTS = 2, 4
"""Number of segments of P between two nodes, and of intervals between speeds in a segment.

With knots only at the nodes there is no P for the truck's rate.
"""
COARSE_SHARE = 0.25
"""Up to this share of the rate the nodes alone are the knots. Fewer knots make a step cheaper."""
GRID_SHARE = 0.99
"""The proof between the grid's speeds is for this share of the rate of the search."""
ROUNDS = 6
"""Largest number of trial proofs. After a failed proof the grid gets more speeds."""
TUNING_STEPS = (0.3, 0.04)
"""First and last step of the search for D's shape, in logarithms of its parameters."""
SLOWEST, TUNING_POINTS = 1e-4, 220
"""Lowest frequency above zero in rad/s, and number of frequencies, in the search for D's shape."""
FARTHEST_GAIN = 2.0
"""Largest |logarithm| of the first gain of D, relative to the synthesis."""


def weighed(family: Family, delta: tuple[int, int], level: float, gain: float) -> Family:
    """Weight a family of loops for a level and a gain of D.

    Parameters
    ----------
    family : Family
    delta : tuple[int, int], number of rows eta and of columns xi, which come first
    level : float, divides the rows z
    gain : float, multiplies the rows eta and divides the columns xi

    Returns
    -------
    Family
    """
    n_eta, n_xi = delta

    def at(v: float) -> StateSpace:
        G = family.at(v)
        rows, columns = np.ones(G.n_outputs), np.ones(G.n_inputs)
        rows[:n_eta], rows[n_eta : G.n_outputs - family.n_probes] = gain, 1 / level
        columns[:n_xi] = 1 / gain
        return StateSpace(
            G.A, G.B * columns, G.C * rows[:, None], G.D * rows[:, None] * columns, G.dt, G.inputs, G.outputs
        )

    return replace(family, at=at)


def tuned(
    loops: list[StateSpace], delta: tuple[int, int], level: float, starts: Sequence[Scaling]
) -> Scaling:
    """Search for the D with the least gain over several loops at frozen speeds.

    A pattern search begins at the best start. It runs only if every block of Delta is one row eta and one
    column xi. Otherwise the result is the first start.

    Parameters
    ----------
    loops : list of StateSpace, discrete and unscaled
    delta : tuple[int, int], see `weighed`
    level : float
    starts : Sequence[Scaling], all of the same degree

    Returns
    -------
    Scaling
    """
    if delta != (len(starts[0].log_parameters),) * 2:
        return starts[0]
    n = delta[0]
    fastest = np.pi / loops[0].dt * (1 - 1e-9)
    omega = np.concatenate([[0.0], np.geomspace(SLOWEST, fastest, TUNING_POINTS)])
    M = np.array([G.response(omega) for G in loops])
    M[:, :, n:] /= level

    def worst(log_parameters: np.ndarray) -> float:
        d = np.exp(Scaling(log_parameters).log_magnitude(omega)).T
        rows, columns = np.ones((len(omega), M.shape[2])), np.ones((len(omega), M.shape[3]))
        rows[:, :n], columns[:, :n] = d, 1 / d
        return float(np.linalg.norm(rows[:, :, None] * M * columns[:, None, :], 2, axis=(2, 3)).max())

    best = min((start.log_parameters.copy() for start in starts), key=worst)
    step, last = TUNING_STEPS
    least = worst(best)
    while step >= last:
        improved = False
        for index, sign in itertools.product(np.ndindex(best.shape), (1.0, -1.0)):
            other = best.copy()
            other[index] += sign * step
            value = worst(other)
            if value < least * (1 - 1e-5):
                best, least, improved = other, value, True
        step *= 1.0 if improved else 0.5
    return Scaling(best)


def find_level(
    family_at: Callable[[float], Family],
    delta: tuple[int, int],
    rate: float,
    progress: Callable[[str], None] = lambda _: None,
) -> LpvCertificate | None:
    """Search for a storage function at the first of ``LEVELS`` that can be proved.

    Parameters
    ----------
    family_at : Callable, returns the family of loops, scaled by D, for a level
    delta : tuple[int, int], see `weighed`
    rate : float, m/s^2, largest |dv/dt|
    progress : Callable, reports progress

    Returns
    -------
    LpvCertificate, or None

    References
    ----------
    THEORY 6.
    """
    for level in LEVELS:

        def tell(text: str, level: float = level) -> None:
            progress(f"level {level:g}, {text}")

        certificate = _at_level(family_at(level), delta, rate, level, tell)
        if certificate is not None:
            return certificate
    return None


def _at_level(
    family: Family, delta: tuple[int, int], rate: float, level: float, progress: Callable[[str], None]
) -> LpvCertificate | None:
    """Certificate at one level. None where the gain at frozen speeds is too large, or the search fails."""
    gain, frozen_gain = _least_gain(family, delta, level)
    if frozen_gain > ROOMY:
        return None
    wide = weighed(family, delta, level, gain)
    first = frozen_at(wide, family.nodes)
    if first is None:
        return None
    basis, parts, frozen = first
    functions = StorageGrid.from_parts(wide.Ts, family.nodes, basis, parts)
    knots = refined(family.nodes, KNOT_PARTS)
    smooth = np.tensordot(terms(family.nodes) @ functions.units.T, functions.fitted(frozen), 1)
    point, unit = Point(smooth), unmoved(parts).F(frozen).mean(axis=0)
    cost = COST * np.linalg.inv(frozen.mean(axis=0))
    grid = KnotGrid(wide.loop, wide.Ts, family.nodes, refined(knots, SPEED_PARTS), basis, delta, cost)
    on_grid = rate / GRID_SHARE
    for part in (0.0, *np.exp2(np.arange(RATE_STEPS) - RATE_STEPS + 1.0)):
        progress(f"storage function for |dv/dt| up to {part * on_grid:.3g} m/s2, {len(basis)} states")
        if part > COARSE_SHARE:
            grid, point = grid.with_knots(point, knots)
        candidate = feasible_point(grid, point, part * on_grid, unit)
        if candidate is None:
            return None
        grid, point = grid.evened(candidate)
    for _ in range(ROUNDS):
        progress("proof between the speeds")
        best = gain * float(np.sqrt(1 + point.excess))
        storage = Storage(grid.basis, grid.knots, point.P, wide.adjoint)
        proof = prove(weighed(family, delta, level, best), storage, rate)
        if proof is not None:
            return LpvCertificate(rate, storage, None, proof, None, level, best, own_knots=True)
        joined = grid.violated(point, on_grid, refined(grid.speeds, 4))
        if not len(joined):
            return None
        grid = grid.with_speeds(joined)
        progress(f"storage function at {len(grid.speeds)} speeds")
        candidate = feasible_point(grid, point, on_grid, unit)
        if candidate is None:
            return None
        grid, point = grid.evened(candidate)
    return None


def _least_gain(family: Family, delta: tuple[int, int], level: float) -> tuple[float, float]:
    """Gain of D with the least loop gain at some of the nodes (frozen speeds), and this loop gain."""
    some = family.nodes[evenly(len(family.nodes), GAIN_SPEEDS)]

    def worst(log_gain: float) -> float:
        one = weighed(family, delta, level, np.exp(log_gain))
        return max(hinf_norm(one.loop(float(v)), rtol=1e-3).upper for v in some)

    if not delta[0]:
        return 1.0, worst(0.0)
    optimum = minimize_scalar(
        worst, bounds=(-FARTHEST_GAIN, FARTHEST_GAIN), method="bounded", options={"xatol": 0.02}
    )
    return float(np.exp(optimum.x)), float(optimum.fun)
