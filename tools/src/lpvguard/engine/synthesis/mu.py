"""Structured singular value: the D,G upper bound to its infimum, and a lower bound by a perturbation that is
checked.

μ(M) = 1 / min{ max_i σ̄(Δ_i) : det(I − M Δ) = 0 } over Δ = diag(Δ_1, Δ_2, ...). Δ is (Σ rows) × (Σ cols) and
M (Σ cols) × (Σ rows) of the blocks: full complex, or δ I with δ complex or real.

Upper bound: the least β with  Mᴴ D_L M + j (G M − Mᴴ G) ≼ β² D_R  (Fan, Tits & Doyle 1991), found by
Newton's method where full blocks leave the largest singular value simple, else by the method of centres.
Both bound the infimum from below, so the returned number is within ``rtol`` of it. It is exact for up to
three full complex blocks. Lower bound: the Δ of that singular value, else the mixed power iteration (Young &
Doyle 1990) from many starts at once. Δ is scaled so that I − M Δ is singular, and that is verified.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from lpvguard.engine.blocks import Block
from lpvguard.engine.synthesis.errors import SynthesisError
from lpvguard.engine.synthesis.mu_lower import lower_bound
from lpvguard.engine.synthesis.mu_upper import upper_bound
from lpvguard.engine.synthesis.structure import Structure


@dataclass(frozen=True)
class MuBounds:
    """lower ≤ μ ≤ upper. ``infimum``: a value that no D scaling goes below, proved when all blocks are full,
    else 0. ``delta`` (Σrows, Σcols) makes I − M Δ singular with max_i σ̄(Δ_i) = 1/lower; None when lower = 0.
    ``D_left``, ``D_right``: the scaling of ``upper``.
    """

    upper: float
    lower: float
    infimum: float
    delta: np.ndarray | None
    D_left: np.ndarray
    D_right: np.ndarray
    G: np.ndarray


def mu_bounds(M: np.ndarray, blocks: Sequence[Block], rtol: float = 1e-8) -> MuBounds:
    """Both bounds of μ for a complex matrix ``M`` (Σcols, Σrows) and a sequence of Block.

    Raises SynthesisError when M is not finite or its shape is not that of the blocks.
    """
    M = np.asarray(M, dtype=complex)
    blocks = tuple(blocks)
    shape = (sum(b.cols for b in blocks), sum(b.rows for b in blocks))
    if M.shape != shape:
        raise SynthesisError(
            "mu", "M", f"shape {M.shape}", f"{shape}, the sums of the blocks' inputs and outputs"
        )
    if not np.all(np.isfinite(M)):
        raise SynthesisError("mu", "M", "a NaN or infinite entry", "finite numbers")
    structure = Structure(blocks)
    upper, infimum, left, right, G = upper_bound(M, structure, rtol)
    lower, delta = (
        lower_bound(M, structure, left, right, upper * (1 - 1e-9), 40) if upper > 0 else (0.0, None)
    )
    D_left, D_right = left @ left.conj().T, right @ right.conj().T
    return MuBounds(upper, min(lower, upper), min(infimum, upper), delta, D_left, D_right, G)


def mu_lower(
    M: np.ndarray,
    blocks: Sequence[Block],
    left: np.ndarray,
    right: np.ndarray,
    enough: float,
    starts: int = 8,
) -> tuple[float, np.ndarray | None]:
    """Lower bound of μ of M (Σcols, Σrows) and the Δ (Σrows, Σcols) that attains it, None for the bound 0.

    ``left`` (Σcols, Σcols) and ``right`` (Σrows, Σrows) make leftᴴ M right⁻ᴴ a well-scaled image of M, which
    speeds the search up. They are factors as ``upper_bound`` gives them. The search ends early at a value of
    ``enough``.
    """
    return lower_bound(np.asarray(M, dtype=complex), Structure(tuple(blocks)), left, right, enough, starts)
