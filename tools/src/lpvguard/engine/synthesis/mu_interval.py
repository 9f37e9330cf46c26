"""Upper bound of μ on a whole interval of frequencies (THEORY 6.2).

At one frequency the bound β holds with scalings D, G where

    Φ(ω) = β² D_R − M(jω)ᴴ D_L M(jω) − j (G M(jω) − M(jω)ᴴ G) ≻ 0.

With D and G kept, Φ stays positive definite up to the nearest frequency at which it is singular. Those
frequencies are the imaginary eigenvalues of one Hamiltonian matrix. Cells found so, each with the scalings of
its own centre, are laid side by side until they cover the interval. No value between grid points is assumed.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from lpvguard.engine.blocks import Block
from lpvguard.engine.synthesis.errors import SynthesisError
from lpvguard.engine.synthesis.mu_upper import upper_bound
from lpvguard.engine.synthesis.statespace import EPS, StateSpace, balanced, to_continuous
from lpvguard.engine.synthesis.structure import Structure

NEAR = 1e-6
"""An eigenvalue whose real part is below this share of its size counts as imaginary."""
MOST_CELLS = 3000
POINT_RTOL = 1e-4
"""Of the bound at one frequency."""


@dataclass(frozen=True)
class MuInterval:
    """``upper`` >= μ at every frequency of the interval. ``largest``: the largest upper bound that was
    computed at one frequency, at ``omega`` [rad/s]; cells: how many cover the interval."""

    upper: float
    largest: float
    omega: float
    cells: int


def mu_interval(
    loop: StateSpace, blocks: Sequence[Block], low: float, high: float, rtol: float = 2e-3
) -> MuInterval:
    """The bound for ``loop`` (Σcols outputs, Σrows inputs) from ``low`` to ``high`` [rad/s], of which the
    last may be infinite, or in discrete time pi / dt.

    ``upper`` exceeds ``largest`` by ``rtol`` at most. SynthesisError for a loop that is not stable, of
    another shape than the blocks, or whose cells do not cover the interval.
    """
    structure = Structure(tuple(blocks))
    shape = (structure.n_rows, structure.n_cols)
    if loop.D.shape != shape:
        raise SynthesisError(
            "mu_interval", "loop", f"{loop.D.shape} system", f"{shape}, the sums of the blocks' sides"
        )
    if not loop.stability_margin() > 0:
        raise SynthesisError("mu_interval", "loop", "not stable", "a stable loop")
    last = np.pi / loop.dt if loop.dt else np.inf
    if not 0 <= low < high <= last * (1 + 4 * EPS):
        raise SynthesisError(
            "mu_interval", "low, high", f"{low:g}, {high:g}", f"0 <= low < high <= {last:g} rad/s"
        )
    G = balanced(to_continuous(balanced(loop)))

    def warped(omega: float) -> float:
        if not loop.dt:
            return omega
        return np.inf if omega >= last * (1 - 4 * EPS) else 2 / loop.dt * np.tan(0.5 * omega * loop.dt)

    def unwarped(omega: float) -> float:
        return float(2 / loop.dt * np.arctan(0.5 * omega * loop.dt)) if loop.dt else omega

    todo = [(warped(low), warped(high))]
    size = float(np.abs(G.poles()).max()) if G.order else 1.0
    level, largest, at, cells = 0.0, -1.0, 0.0, 0
    while todo:
        a, b = todo.pop()
        if cells == MOST_CELLS:
            raise SynthesisError(
                "mu_interval", f"{unwarped(a):g} rad/s", f"{cells} cells do not cover it", "a smoother loop"
            )
        centre = _centre(a, b, size)
        value, _, left, right, skew = upper_bound(G.response([centre])[0], structure, POINT_RTOL)
        if value > largest:
            largest, at = value, centre
        level = max(level, value * (1 + rtol), 1e-12)
        singular = _singular(G, left @ left.conj().T, right @ right.conj().T, skew, level)
        cells += 1
        below, above = singular[singular <= centre], singular[singular > centre]
        if len(below) and below[-1] > a:
            todo.append((a, float(below[-1])))
        if len(above) and above[0] < b:
            todo.append((float(above[0]), b))
    return MuInterval(float(level), float(largest), unwarped(at), cells)


def _centre(a: float, b: float, size: float) -> float:
    if np.isinf(b):
        return max(2 * a, size)
    return float(np.sqrt(a * b)) if a > 0.1 * b else 0.5 * (a + b)


def _singular(
    G: StateSpace, D_left: np.ndarray, D_right: np.ndarray, skew: np.ndarray, level: float
) -> np.ndarray:
    """Frequencies (K,), rising, at which Φ may be singular: eigenvalues of its Hamiltonian near the imaginary
    axis. They are those of x' = A x + B u with the adjoint state p' = -Aᴴ p - Cᴴ q, where Φ u = 0."""
    A, B, C, D, n = G.A, G.B, G.C, G.D, G.order
    if n == 0:
        return np.zeros(0)
    jG = 1j * skew
    q_u = D_left @ D + jG.conj().T
    infinity = level**2 * D_right - D.T @ D_left @ D - D.T @ jG.conj().T - jG @ D
    u = np.linalg.solve(infinity, np.hstack([(D.T @ D_left + jG) @ C, B.T]))
    free = np.block([[A, np.zeros((n, n))], [-C.T @ D_left @ C, -A.T]])
    hamiltonian = free + np.vstack([B, -C.T @ q_u]) @ u
    values = np.linalg.eigvals(hamiltonian)
    axis = np.abs(values.real) <= NEAR * np.abs(values) + 1e2 * EPS * np.linalg.norm(A, 2)
    return np.unique(values.imag[axis & (values.imag >= 0)])
