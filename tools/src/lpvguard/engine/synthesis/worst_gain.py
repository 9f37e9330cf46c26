"""The worst-case gain: the largest gain from disturbances to errors over every Δ of size 1 (THEORY 7.10).

At one frequency, scalings D, G of the blocks of Δ prove the bound γ if (skewed μ; Packard & Doyle 1993)

    diag(D_R, γ² I) − Mᴴ diag(D_L, I) M − j (G M − Mᴴ G) ≻ 0.

For given D and G the least γ is the largest eigenvalue of a Schur complement. The iteration divides the
performance rows by γ, computes the scalings of μ and from them a lower γ, until γ no longer changes. The
cells of frequency_cells prove the bound between frequencies. They are tested again at the returned bound.
"""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from lpvguard.engine.blocks import Block
from lpvguard.engine.synthesis.frequency_cells import (
    IntervalBound,
    PointBound,
    continuous_interval,
    cover,
    quadratic,
)
from lpvguard.engine.synthesis.mu_upper import POINT_RTOL, upper_bound
from lpvguard.engine.synthesis.real_boxes import ParameterBox, Part, Prover
from lpvguard.engine.synthesis.statespace import StateSpace
from lpvguard.engine.synthesis.structure import Structure

STEPS = 12
"""Largest number of iterations at one frequency."""
LARGEST = 1e6
"""A gain larger than this multiple of the nominal gain counts as unbounded."""


def worst_gain(
    loop: StateSpace,
    blocks: Sequence[Block],
    performance: Block,
    low: float,
    high: float,
    rtol: float = 2e-3,
    least: float = 0.0,
) -> IntervalBound:
    """Bound the gain from disturbances to errors over every Δ of size 1 and a range of frequencies.

    Parameters
    ----------
    loop : StateSpace
        Its first outputs and inputs belong to Δ, the last ones to ``performance``.
    blocks : Sequence[Block], blocks of Δ
    performance : Block, full block from z to [w; n; r_c]
    low, high : float, rad/s, interval, see `cover`
    rtol : float, default 0.002
    least : float, smaller upper bounds are not sought, default 0.0

    Returns
    -------
    IntervalBound, whose ``upper`` is inf if no scalings prove stability, or the cells fail their final test

    Raises
    ------
    SynthesisError
        If the loop or the interval is not valid (see `cover`).

    References
    ----------
    THEORY 7.10.
    """
    structure = Structure((*blocks, performance))
    rows, cols = structure.n_rows - performance.cols, structure.n_cols - performance.rows

    def at(M: np.ndarray, reached: float) -> PointBound:
        nominal = float(np.linalg.norm(M[rows:, cols:], 2))
        start = max(reached, nominal, 1e-12)
        gamma, best = start, None
        for _ in range(STEPS):
            point = _bound(M, structure, rows, cols, gamma)
            if point is None:
                # No scalings prove stability at this level. A larger level gives less weight to the gain.
                if best is not None:
                    break
                gamma *= 4
                if gamma > LARGEST * start:
                    break
                continue
            settled = best is not None and point.value > best.value * (1 - POINT_RTOL)
            best = point if best is None or point.value < best.value else best
            if settled or best.value <= reached:
                break
            gamma = best.value
        if best is None:
            zero = np.zeros((structure.n_cols,) * 2)
            return PointBound(np.inf, np.zeros((structure.n_rows,) * 2), zero, zero, zero)
        return best

    def held(M: np.ndarray, point: PointBound) -> float:
        return _gain(M, point, cols)

    bound = cover("worst_gain", loop, structure, low, high, rtol, at, held, least)
    G, first, last, _ = continuous_interval("worst_gain", loop, structure, low, high)
    return bound if proves(bound, G, structure, first, last) else replace(bound, upper=np.inf)


def proves(bound: IntervalBound, G: StateSpace, structure: Structure, low: float, high: float) -> bool:
    """Return whether the cells of ``bound`` prove its level from ``low`` to ``high`` [rad/s].

    The proof allows for rounding. ``structure`` has the blocks of Δ, then the performance block. The
    performance columns are divided by the level. The proof then is that of μ < 1.
    """
    if not np.isfinite(bound.upper):
        return False
    units = np.ones(structure.n_cols)
    units[structure.col[-1]] = 1 / bound.upper
    edge = np.ones(sum(b.kind == "repeated_real" for b in structure.blocks))
    parts = []
    for one in bound.cells:
        point = one.point
        fixed = np.zeros_like(point.fixed)
        skew = point.skew * units[:, None]
        scalings = PointBound(1.0, point.left, fixed, point.fixed + point.scaled, skew)
        parts.append(Part(ParameterBox(-edge, edge), one.low, one.high, scalings))
    scaled = StateSpace(G.A, G.B * units, G.C, G.D * units)
    return Prover(scaled, structure).verified(parts, 1.0, low, high)


def _bound(M: np.ndarray, structure: Structure, rows: int, cols: int, gamma: float) -> PointBound | None:
    """The least γ for the scalings of μ at level ``gamma``, or None where they prove no bound."""
    scaled = M.copy()
    scaled[rows:] /= gamma
    _, _, left, right, skew = upper_bound(scaled, structure, POINT_RTOL)
    left, right = left @ left.conj().T, right @ right.conj().T
    # Scale the D of the performance block to 1, and undo the division of its rows by gamma.
    to_one = gamma**2 / float(right[-1, -1].real)
    left, right, skew = left * to_one, right * to_one, skew * to_one
    left[rows:, rows:] = np.eye(len(left) - rows)
    fixed, per_level = np.zeros_like(right), np.zeros_like(right)
    fixed[:cols, :cols] = right[:cols, :cols]
    per_level[cols:, cols:] = np.eye(len(right) - cols)
    point = PointBound(0.0, left, fixed, per_level, skew)
    value = _gain(M, point, cols)
    return replace(point, value=value) if np.isfinite(value) else None


def _gain(M: np.ndarray, point: PointBound, cols: int) -> float:
    """The least γ for these scalings, or inf where they prove no bound."""
    N = quadratic(M, point)
    slack = point.fixed[:cols, :cols] - N[:cols, :cols]
    try:
        factor = np.linalg.cholesky(slack)
    except np.linalg.LinAlgError:
        return np.inf
    half = np.linalg.solve(factor, N[:cols, cols:])
    value = float(np.linalg.eigvalsh(N[cols:, cols:] + half.conj().T @ half)[-1])
    return float(np.sqrt(max(value, 0.0)))
