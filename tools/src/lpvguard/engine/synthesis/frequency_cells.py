"""Bounds proved on a whole interval of frequencies, which adjacent cells cover (THEORY 6.2).

At one frequency, scalings D and G prove the bound β if

    Φ(ω) = β² D_R − M(jω)ᴴ D_L M(jω) − j (G M(jω) − M(jω)ᴴ G) ≻ 0.

With constant D and G, Φ stays positive definite up to the nearest frequency at which Φ is singular. These
frequencies are imaginary eigenvalues of one Hamiltonian matrix. Rounding moves such eigenvalues off the axis.
All eigenvalues near the axis are therefore used, and Φ itself is tested between them and at both ends. Each
test allows for rounding of M and of the products. No value between grid points is assumed.
"""

from __future__ import annotations

import itertools
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial

import numpy as np

from lpvguard.engine.synthesis.errors import SynthesisError
from lpvguard.engine.synthesis.statespace import (
    EPS,
    StateSpace,
    balanced,
    balancing,
    prewarped,
    to_continuous,
)
from lpvguard.engine.synthesis.structure import Structure

SHORT = 0.999
"""A cell covers this share of the distance to a frequency where Φ is singular."""
NEAR, ROUNDED = 1e-2, 1e-8
"""An eigenvalue counts as one on the imaginary axis if its real part is below ``NEAR`` times its magnitude
plus ``ROUNDED`` times the norm of the matrix. Rounding moves a double eigenvalue by about sqrt(eps) times the
norm."""
MOST_CELLS = 3000
ROOM = 0.25
"""Least gap between a computed bound and the level ``least``, as a share of the tolerance."""
CLEARLY = 0.95
"""Share of the largest bound. Below it a neighbour's scalings are used, because a cell is wide with any
scalings."""


@dataclass(frozen=True)
class FrequencyCell:
    """Scalings that prove a bound from ``low`` to ``high`` [rad/s, continuous time]."""

    low: float
    high: float
    point: PointBound


@dataclass(frozen=True)
class IntervalBound:
    """A bound that holds at every frequency of an interval.

    Attributes
    ----------
    upper : float
    largest : float, largest bound that was computed at a single frequency
    omega : float, rad/s, frequency of ``largest``
    cells : tuple of FrequencyCell, cover the interval and each prove the level ``upper``
    """

    upper: float
    largest: float
    omega: float
    cells: tuple[FrequencyCell, ...]


@dataclass(frozen=True)
class PointBound:
    """A bound at one frequency and its scalings.

    ``Φ = fixed + β² scaled − Mᴴ left M − j (skew M − Mᴴ skew)`` is positive definite for every β above
    ``value``. The shapes are left (Σcols, Σcols), fixed and scaled (Σrows, Σrows), skew (Σrows, Σcols).
    """

    value: float
    left: np.ndarray
    fixed: np.ndarray
    scaled: np.ndarray
    skew: np.ndarray


def cover(
    name: str,
    loop: StateSpace,
    structure: Structure,
    low: float,
    high: float,
    rtol: float,
    at: Callable[[np.ndarray, float], PointBound],
    held: Callable[[np.ndarray, PointBound], float],
    least: float = 0.0,
) -> IntervalBound:
    """Cover the interval from ``low`` to ``high`` [rad/s] by cells.

    ``high`` may be inf in continuous time and pi / dt in discrete time. ``name`` names the caller in errors.
    ``loop`` is stable and has Σcols outputs and Σrows inputs. ``at(M, largest)`` returns the bound at a
    frequency from the response M (Σcols, Σrows) and the largest bound so far. ``held(M, point)`` returns the
    bound that the scalings of ``point``, computed at another frequency, prove at M; inf means no bound.
    ``upper`` exceeds ``largest`` by the share ``rtol``, or equals ``least`` where this level can be proved.

    The search begins near the peak, as ``_likely_peak`` estimates it. Where a neighbour's scalings prove
    clearly less than the largest bound, no new scalings are searched. Raises SynthesisError if the loop is
    not stable, its shape is not that of the blocks, or the cells do not cover the interval.
    """
    G, first, last, unwarped = continuous_interval(name, loop, structure, low, high)
    size = float(np.abs(G.poles()).max()) if G.order else 1.0
    todo: list[tuple[float, float, PointBound | None]] = [(first, last, None)]
    start = _likely_peak(G, at, held, first, last, size)
    level, largest, where = least, -1.0, 0.0
    cells: list[FrequencyCell] = []
    while todo:
        a, b, known = todo.pop()
        if len(cells) == MOST_CELLS:
            raise SynthesisError(
                name, f"{unwarped(a):g} rad/s", f"{len(cells)} cells do not cover it", "a smoother loop"
            )
        centre = start if known is None else middle(a, b, size)
        M = G.response([centre])[0]
        if known is not None and (value := held(M, known)) <= CLEARLY * largest:
            point = replace(known, value=value)
        else:
            point = at(M, max(largest, 0.0))
        if point.value > largest:
            largest, where = point.value, centre
        if np.isinf(largest):
            return IntervalBound(np.inf, np.inf, unwarped(where), tuple(cells))
        if point.value * (1 + ROOM * rtol) >= least:
            level = max(level, point.value * (1 + rtol), 1e-12)
        left, right = cell(G, point, level, centre, a, b, partial(_positive_on, G, point, level))
        cells.append(FrequencyCell(left, right, point))
        if left > a:
            todo.append((a, left, point))
        if right < b:
            todo.append((right, b, point))
    return IntervalBound(float(level), float(largest), unwarped(where), tuple(cells))


def continuous_interval(
    name: str, loop: StateSpace, structure: Structure, low: float, high: float
) -> tuple[StateSpace, float, float, Callable[[float], float]]:
    """Return the balanced loop in continuous time, its interval, and the map of frequencies to ``loop``.

    Parameters, errors and units are those of ``cover``.
    """
    _require_loop(name, loop, structure)
    last = np.pi / loop.dt if loop.dt else np.inf
    if not 0 <= low < high <= last * (1 + 4 * EPS):
        raise SynthesisError(name, "low, high", f"{low:g}, {high:g}", f"0 <= low < high <= {last:g} rad/s")
    G = balanced(to_continuous(balanced(loop)))

    def warped(omega: float) -> float:
        return np.inf if omega >= last * (1 - 4 * EPS) else prewarped(omega, loop.dt)

    def unwarped(omega: float) -> float:
        return float(2 / loop.dt * np.arctan(0.5 * omega * loop.dt)) if loop.dt else omega

    return G, warped(low), warped(high), unwarped


def _positive_on(G: StateSpace, point: PointBound, level: float, omega: float) -> bool:
    return is_positive(G.response([omega])[0], response_rounding(G, omega), point, level)


def response_rounding(G: StateSpace, omega: float) -> np.ndarray:
    """Return the error (p, m) of the response G(jω) from rounding of the entries of A, B, C and D.

    The estimate is of first order in each entry, so it does not depend on the units of the states. It is
    infinite where jω is a pole up to rounding.
    """
    moved = np.abs(G.D)
    if G.order and np.isfinite(omega):
        point = np.exp(1j * omega * G.dt) if G.dt else 1j * omega
        try:
            inverse = np.linalg.inv(point * np.eye(G.order) - G.A)
        except np.linalg.LinAlgError:
            return np.full(G.D.shape, np.inf)
        left, right = np.abs(G.C @ inverse), np.abs(inverse @ G.B)
        pencil = np.abs(G.A) + abs(point) * np.eye(G.order)
        moved = moved + left @ pencil @ right + np.abs(G.C) @ right + left @ np.abs(G.B)
    return 16 * EPS * moved


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
    """Estimate of the frequency in [a, b] with the largest bound.

    The candidates are the middle of [a, b] and the frequencies of poles in it. The scalings of the middle
    prove the worst bound at the chosen one.
    """
    between = middle(a, b, size)
    omega = np.abs(G.poles())
    omega = np.unique(np.r_[between, omega[(omega > a) & (omega < b)]])
    if len(omega) == 1:
        return between
    point = at(G.response([between])[0], 0.0)
    if np.isinf(point.value):
        return between
    return float(omega[np.argmax([held(M, point) for M in G.response(omega)])])


def quadratic(M: np.ndarray, point: PointBound) -> np.ndarray:
    """Mᴴ left M + j (skew M − Mᴴ skewᴴ) (Σrows, Σrows) of M (Σcols, Σrows), Hermitian to the last bit."""
    N = M.conj().T @ point.left @ M + 1j * (point.skew @ M - M.conj().T @ point.skew.conj().T)
    return 0.5 * (N + N.conj().T)


def middle(a: float, b: float, size: float) -> float:
    """Return a frequency between ``a`` and ``b`` [rad/s]. ``size`` is the magnitude of the fastest pole."""
    if np.isinf(b):
        return max(2 * a, size)
    return float(np.sqrt(a * b)) if a > 0.1 * b else 0.5 * (a + b)


def is_positive(M: np.ndarray, moved: np.ndarray, point: PointBound, level: float) -> bool:
    """Return whether Φ ≻ 0 at ``level`` for every matrix near M.

    M (Σcols, Σrows) is the response at one frequency. ``moved`` (Σcols, Σrows) bounds the rounding of its
    entries."""
    try:
        factor = np.linalg.inv(np.linalg.cholesky(point.fixed + level**2 * point.scaled))
    except np.linalg.LinAlgError:
        return False
    if not (np.isfinite(M).all() and np.isfinite(factor).all()):
        return False
    with np.errstate(over="ignore", invalid="ignore"):  # scalings of no use
        N, skew = M @ factor.conj().T, factor @ point.skew
        turned = 1j * skew @ N
        phi = np.eye(len(factor)) - N.conj().T @ point.left @ N - turned - turned.conj().T
        # First order in the change of M, and the rounding of the products themselves.
        moved = (moved + 4 * EPS * np.abs(M)) @ np.abs(factor).T
        change = np.abs(N).T @ np.abs(point.left) @ moved + np.abs(skew) @ moved
    return bool(np.isfinite(phi).all()) and bool(np.linalg.eigvalsh(phi)[0] > 2 * np.linalg.norm(change))


def cell(
    G: StateSpace,
    point: PointBound,
    level: float,
    centre: float,
    a: float,
    b: float,
    positive: Callable[[float], bool],
) -> tuple[float, float]:
    """Return the part of [a, b] about ``centre`` on which Φ is positive definite.

    Between two neighbouring frequencies of ``_singular`` the eigenvalues of Φ keep their signs. One test by
    ``positive`` therefore decides each gap.
    """
    singular = _singular(G, point, level)

    def reach(edges: np.ndarray, end: float) -> float:
        inside = centre
        for edge, after in itertools.pairwise([*edges, end]):
            beyond = 2 * edge if np.isinf(after) else 0.5 * (edge + after)
            if not positive(beyond):
                short = edge / SHORT if np.isinf(inside) else inside + SHORT * (edge - inside)
                return float(short if positive(short) else inside)
            inside = beyond
        return end if positive(end) else inside

    below, above = (singular[side] for side in ((singular < centre) & (singular > a), singular > centre))
    return reach(below[::-1], a), reach(above[above < b], b)


def _singular(G: StateSpace, point: PointBound, level: float) -> np.ndarray:
    """Return the frequencies (K,), ascending, at which Φ may be singular.

    They are eigenvalues, on or near the imaginary axis, of a Hamiltonian matrix. This matrix belongs to x' =
    A x + B u with the adjoint state p' = -Aᴴ p - Cᴴ q, where Φ u = 0. Extreme scalings would cost all its
    digits. Inputs are therefore scaled to make fixed + level² scaled the identity, and outputs to make left
    the identity.
    """
    right = np.linalg.inv(np.linalg.cholesky(point.fixed + level**2 * point.scaled)).conj().T
    root = np.linalg.cholesky(point.left + np.finfo(float).tiny * np.eye(len(point.left)))
    real = not (right.imag.any() or root.imag.any())
    B, C, D = G.B @ right, root.conj().T @ G.C, root.conj().T @ G.D @ right
    A = G.A
    if real and G.order:
        t = balancing(StateSpace(A, B.real, C.real, D.real))
        A, B, C = A * t / t[:, None], B / t[:, None], C * t
    jG = 1j * right.conj().T @ point.skew @ np.linalg.inv(root.conj().T)
    n = G.order
    q_u = D + jG.conj().T
    infinity = np.eye(len(right)) - D.conj().T @ D - D.conj().T @ jG.conj().T - jG @ D
    u = np.linalg.solve(infinity, np.hstack([q_u.conj().T @ C, B.conj().T]))
    free = np.block([[A, np.zeros((n, n))], [-C.conj().T @ C, -A.T]])
    hamiltonian = free + np.vstack([B, -C.conj().T @ q_u]) @ u
    if not hamiltonian.imag.any():  # real where G = 0 and all blocks are full: a quarter of the cost
        hamiltonian = hamiltonian.real
    values = np.linalg.eigvals(hamiltonian)
    room = NEAR * np.abs(values) + ROUNDED * float(np.linalg.norm(hamiltonian))
    return np.unique(values.imag[(np.abs(values.real) <= room) & (values.imag >= 0)])
