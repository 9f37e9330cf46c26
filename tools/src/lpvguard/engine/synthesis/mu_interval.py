"""Upper bound of μ on a whole interval of frequencies (THEORY 6.2).

At one frequency the bound β holds with scalings D, G where

    Φ(ω) = β² D_R − M(jω)ᴴ D_L M(jω) − j (G M(jω) − M(jω)ᴴ G) ≻ 0.

With D and G kept, Φ stays positive definite up to the nearest frequency at which it is singular. Those
frequencies are imaginary eigenvalues of one Hamiltonian matrix. Rounding moves such eigenvalues off the
axis, so all near it are taken, and Φ itself is tested between them. Cells found so, each with the scalings of
its own centre, are laid side by side until they cover the interval. No value between grid points is assumed.
"""

from __future__ import annotations

import itertools
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
import scipy.linalg as sl

from lpvguard.engine.blocks import Block
from lpvguard.engine.synthesis.errors import SynthesisError
from lpvguard.engine.synthesis.mu_upper import upper_bound
from lpvguard.engine.synthesis.norms import near_axis
from lpvguard.engine.synthesis.statespace import EPS, StateSpace, balanced, to_continuous
from lpvguard.engine.synthesis.structure import Structure

SHORT = 0.999
"""Of the way to a frequency where Φ is singular, that a cell goes."""
MOST_CELLS = 3000
POINT_RTOL = 1e-4
"""Of the bound at one frequency."""
CLEARLY = 0.95
"""Of the largest bound: below it a cell is wide with any scalings, and those at hand will do."""


@dataclass(frozen=True)
class IntervalBound:
    """``upper``: a bound that holds at every frequency of the interval. ``largest``: the largest bound that
    was computed at one frequency, at ``omega`` [rad/s]; cells: how many cover the interval."""

    upper: float
    largest: float
    omega: float
    cells: int


@dataclass(frozen=True)
class PointBound:
    """A bound at one frequency and its scalings: Φ = fixed + β² scaled − Mᴴ left M − j (skew M − Mᴴ skew) is
    positive definite for every β above ``value``.

    left (Σcols, Σcols), fixed and scaled (Σrows, Σrows), skew (Σrows, Σcols).
    """

    value: float
    left: np.ndarray
    fixed: np.ndarray
    scaled: np.ndarray
    skew: np.ndarray


def mu_interval(
    loop: StateSpace, blocks: Sequence[Block], low: float, high: float, rtol: float = 2e-3
) -> IntervalBound:
    """The bound for ``loop`` (Σcols outputs, Σrows inputs) from ``low`` to ``high`` [rad/s], of which the
    last may be infinite, or in discrete time pi / dt.

    ``upper`` exceeds ``largest`` by ``rtol`` at most. SynthesisError for a loop that is not stable, of
    another shape than the blocks, or whose cells do not cover the interval.
    """
    structure = Structure(tuple(blocks))

    def at(M: np.ndarray, _: float) -> PointBound:
        value, _, left, right, skew = upper_bound(M, structure, POINT_RTOL)
        right = right @ right.conj().T
        return PointBound(value, left @ left.conj().T, np.zeros_like(right), right, skew)

    def held(M: np.ndarray, point: PointBound) -> float:
        return float(np.sqrt(max(sl.eigvalsh(quadratic(M, point), point.scaled)[-1], 0.0)))

    return cover("mu_interval", loop, structure, low, high, rtol, at, held)


def cover(
    name: str,
    loop: StateSpace,
    structure: Structure,
    low: float,
    high: float,
    rtol: float,
    at: Callable[[np.ndarray, float], PointBound],
    held: Callable[[np.ndarray, PointBound], float],
) -> IntervalBound:
    """The interval covered by cells. ``at``: M (Σcols, Σrows) complex and the largest bound so far to the
    bound at that frequency; ``held``: M and a bound elsewhere to what its scalings prove at M (inf: nothing).
    ``name``: who asks, in errors; else as in ``mu_interval``.

    The search begins where the scalings of one frequency prove the least of all poles' frequencies, near the
    peak. Where a neighbour's scalings prove clearly less than the largest bound, none are searched for.
    """
    _require_loop(name, loop, structure)
    last = np.pi / loop.dt if loop.dt else np.inf
    if not 0 <= low < high <= last * (1 + 4 * EPS):
        raise SynthesisError(name, "low, high", f"{low:g}, {high:g}", f"0 <= low < high <= {last:g} rad/s")
    G = balanced(to_continuous(balanced(loop)))

    def warped(omega: float) -> float:
        if not loop.dt:
            return omega
        return np.inf if omega >= last * (1 - 4 * EPS) else 2 / loop.dt * np.tan(0.5 * omega * loop.dt)

    def unwarped(omega: float) -> float:
        return float(2 / loop.dt * np.arctan(0.5 * omega * loop.dt)) if loop.dt else omega

    first, last_warped = warped(low), warped(high)
    size = float(np.abs(G.poles()).max()) if G.order else 1.0
    todo: list[tuple[float, float, PointBound | None]] = [(first, last_warped, None)]
    start = _likely_peak(G, at, held, first, last_warped, size)
    level, largest, where, cells = 0.0, -1.0, 0.0, 0
    while todo:
        a, b, known = todo.pop()
        if cells == MOST_CELLS:
            raise SynthesisError(
                name, f"{unwarped(a):g} rad/s", f"{cells} cells do not cover it", "a smoother loop"
            )
        centre = start if known is None else _centre(a, b, size)
        M = G.response([centre])[0]
        if known is not None and (value := held(M, known)) <= CLEARLY * largest:
            point = replace(known, value=value)
        else:
            point = at(M, max(largest, 0.0))
        if point.value > largest:
            largest, where = point.value, centre
        if np.isinf(largest):
            return IntervalBound(np.inf, np.inf, unwarped(where), cells)
        level = max(level, point.value * (1 + rtol), 1e-12)
        left, right = _cell(G, point, level, centre, a, b)
        cells += 1
        if left > a:
            todo.append((a, left, point))
        if right < b:
            todo.append((right, b, point))
    return IntervalBound(float(level), float(largest), unwarped(where), cells)


def _require_loop(name: str, loop: StateSpace, structure: Structure) -> None:
    shape = (structure.n_rows, structure.n_cols)
    if loop.D.shape != shape:
        raise SynthesisError(
            name, "loop", f"{loop.D.shape} system", f"{shape}, the sums of the blocks' sides"
        )
    if not loop.stability_margin() > 0:
        raise SynthesisError(name, "loop", "not stable", "a stable loop")


def _likely_peak(
    G: StateSpace,
    at: Callable[[np.ndarray, float], PointBound],
    held: Callable[[np.ndarray, PointBound], float],
    a: float,
    b: float,
    size: float,
) -> float:
    """Of the middle of [a, b] and the frequencies of poles in it, that at which the scalings of the middle
    prove the least."""
    middle = _centre(a, b, size)
    omega = np.abs(G.poles())
    omega = np.unique(np.r_[middle, omega[(omega > a) & (omega < b)]])
    if len(omega) == 1:
        return middle
    point = at(G.response([middle])[0], 0.0)
    if np.isinf(point.value):
        return middle
    return float(omega[np.argmax([held(M, point) for M in G.response(omega)])])


def quadratic(M: np.ndarray, point: PointBound) -> np.ndarray:
    """Mᴴ left M + j (skew M − Mᴴ skewᴴ) (Σrows, Σrows) of M (Σcols, Σrows), Hermitian to the last bit."""
    N = M.conj().T @ point.left @ M + 1j * (point.skew @ M - M.conj().T @ point.skew.conj().T)
    return 0.5 * (N + N.conj().T)


def _centre(a: float, b: float, size: float) -> float:
    if np.isinf(b):
        return max(2 * a, size)
    return float(np.sqrt(a * b)) if a > 0.1 * b else 0.5 * (a + b)


def _cell(
    G: StateSpace, point: PointBound, level: float, centre: float, a: float, b: float
) -> tuple[float, float]:
    """The part of [a, b] about ``centre`` on which Φ is positive definite. Between two neighbours of
    ``_singular`` Φ keeps its signs, so one test decides each gap."""
    singular = _singular(G, point, level)
    factor = np.linalg.inv(np.linalg.cholesky(point.fixed + level**2 * point.scaled))

    def positive(omega: float) -> bool:
        M = G.response([omega])[0] @ factor.conj().T
        skew = 1j * factor @ point.skew @ M
        phi = np.eye(len(factor)) - M.conj().T @ point.left @ M - skew - skew.conj().T
        return bool(np.linalg.eigvalsh(phi)[0] > 0)

    def reach(edges: np.ndarray, end: float) -> float:
        inside = centre
        for edge, after in itertools.pairwise([*edges, end]):
            beyond = 2 * edge if np.isinf(after) else 0.5 * (edge + after)
            if not positive(beyond):
                short = inside + SHORT * (edge - inside)
                return float(short if positive(short) else inside)
            inside = beyond
        return end

    below, above = (singular[side] for side in ((singular < centre) & (singular > a), singular > centre))
    return reach(below[::-1], a), reach(above[above < b], b)


def _singular(G: StateSpace, point: PointBound, level: float) -> np.ndarray:
    """Frequencies (K,), rising, at which Φ may be singular: eigenvalues of its Hamiltonian on or near the
    imaginary axis. They are those of x' = A x + B u with the adjoint state p' = -Aᴴ p - Cᴴ q, where Φ u =
    0."""
    A, B, C, D, n = G.A, G.B, G.C, G.D, G.order
    D_left, jG = point.left, 1j * point.skew
    q_u = D_left @ D + jG.conj().T
    infinity = point.fixed + level**2 * point.scaled - D.T @ D_left @ D - D.T @ jG.conj().T - jG @ D
    u = np.linalg.solve(infinity, np.hstack([(D.T @ D_left + jG) @ C, B.T]))
    free = np.block([[A, np.zeros((n, n))], [-C.T @ D_left @ C, -A.T]])
    hamiltonian = free + np.vstack([B, -C.T @ q_u]) @ u
    if not hamiltonian.imag.any():  # as without G, and with D of full blocks: at a quarter of the cost
        hamiltonian = hamiltonian.real
    values = np.linalg.eigvals(hamiltonian)
    axis = near_axis(values, float(np.linalg.norm(A)))
    return np.unique(values.imag[axis & (values.imag >= 0)])
