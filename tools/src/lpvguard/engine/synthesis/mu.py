"""Upper and lower bounds of the structured singular value of a matrix and of a loop.

μ(M) = 1 / min{ max_i σ̄(Δ_i) : det(I − M Δ) = 0 } over Δ = diag(Δ_1, Δ_2, ...). A block is full complex, or δ
I with δ complex or real. Δ is (Σ rows) × (Σ cols) and M (Σ cols) × (Σ rows), summed over the blocks.

Upper bound: the least β with Mᴴ D_L M + j (G M − Mᴴ G) ≼ β² D_R (Fan, Tits & Doyle 1991). It is exact for up
to three full complex blocks. With real blocks, further bounds on boxes of their parameters (``real_mu``)
close the gap that D and G leave. Over an interval the bound is proved between frequencies too. Lower bound: a
checked Δ with I − M Δ singular. Every upper bound has a proof: scalings, and the set where they hold.
``Prover.verified`` checks it.
"""

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np
import scipy.linalg as sl

from lpvguard.engine.blocks import Block
from lpvguard.engine.synthesis.errors import SynthesisError
from lpvguard.engine.synthesis.frequency_cells import (
    PointBound,
    continuous_interval,
    cover,
    quadratic,
    response_rounding,
)
from lpvguard.engine.synthesis.mu_lower import SINGULAR_RTOL, attained, lower_bound
from lpvguard.engine.synthesis.mu_upper import POINT_RTOL, scaled_size, triangular_scalings, upper_bound
from lpvguard.engine.synthesis.real_boxes import ParameterBox, Part, Prover
from lpvguard.engine.synthesis.real_crossings import ROUNDING
from lpvguard.engine.synthesis.real_mu import ZERO, real_mu
from lpvguard.engine.synthesis.statespace import StateSpace
from lpvguard.engine.synthesis.structure import Structure

REAL_RTOL, ONE_REAL_RTOL = 2e-3, 1e-6
"""Target of the gap between the bounds with real blocks, and with a single real scalar."""
RESOLVED = 1e-2
"""Largest gap between the bounds at which μ counts as resolved."""
INFLATIONS = (0.0, 1e-14, 1e-12, 1e-10, 1e-8, 1e-6, 1e-5, 1e-4, 1e-3, 5e-3, 0.1, 1.0, 10.0, 100.0, 1e3)
"""The bound at one frequency is raised by these shares, in this order, until its scalings prove it."""
COMPLEX_STARTS, INTERVAL_STARTS = 40, 8
"""Number of starts in the search for a lower bound of a matrix, and at the peak of a loop."""
NOTHING = 1e-300
"""A smaller upper bound counts as 0."""
EMPTY = ParameterBox(np.zeros(0), np.zeros(0))


@dataclass(frozen=True)
class MuBounds:
    """Bounds of μ at one frequency or over an interval.

    Attributes
    ----------
    upper : float, proved by ``proof``
    lower : float, attained at ``omega`` by ``delta``
    omega : float, rad/s, for a matrix 0
    delta : ndarray (Σrows, Σcols) of complex, or None for a lower bound of 0
        It makes I − M Δ singular with max_i σ̄(Δ_i) = 1 / ``lower``.
    proof : tuple of Part, in continuous time (the bilinear image of a discrete loop)
    size : float, ``scaled_size`` of M at ``omega``, or its largest value
        A bound far below it counts as 0.
    """

    upper: float
    lower: float
    omega: float
    delta: np.ndarray | None = field(repr=False)
    proof: tuple[Part, ...] = field(repr=False)
    size: float = field(repr=False)

    @property
    def gap(self) -> float:
        """Share by which the upper bound exceeds the lower one.

        It is 0 for an upper bound of at most ``ZERO`` times size.
        """
        if self.upper <= max(ZERO * self.size, NOTHING):
            return 0.0
        return self.upper / self.lower - 1 if self.lower > 0 else np.inf

    @property
    def resolved(self) -> bool:
        """Whether the gap is at most ``RESOLVED``."""
        return bool(self.gap <= RESOLVED)


def mu_bounds(M: np.ndarray, blocks: Sequence[Block], rtol: float = 1e-8) -> MuBounds:
    """Bound μ of a complex matrix from both sides.

    Parameters
    ----------
    M : ndarray (Σcols, Σrows) of complex
    blocks : Sequence[Block]
    rtol : float, relative accuracy of the scalings' bound, default 1e-8
        With real blocks the target of the gap is ``REAL_RTOL``.

    Returns
    -------
    MuBounds

    Raises
    ------
    SynthesisError
        If M is not finite, its shape does not fit the blocks, or no bound could be proved.

    References
    ----------
    THEORY 6.
    """
    M = np.asarray(M, dtype=complex)
    structure = Structure(tuple(blocks))
    shape = structure.n_rows, structure.n_cols
    if M.shape != shape:
        raise SynthesisError(
            "mu", "M", f"shape {M.shape}", f"{shape}, the sums of the blocks' inputs and outputs"
        )
    if not np.all(np.isfinite(M)):
        raise SynthesisError("mu", "M", "a NaN or infinite entry", "finite numbers")
    size = scaled_size(M, structure)
    if size == 0:
        return MuBounds(0.0, 0.0, 0.0, None, (), 0.0)
    prover = Prover(M, structure)
    upper, part, left, right = _scaled_bound(prover, M, rtol)
    if structure.complex_only:
        lower, delta = lower_bound(M, structure, left, right, upper * (1 - 1e-9), COMPLEX_STARTS)
        proof: tuple[Part, ...] = (part,)
    else:
        real = real_mu(M, structure, 0.0, 0.0, _aim(structure, REAL_RTOL), known=upper)
        lower, delta, proof = real.lower, real.delta, (part,)
        if real.upper < upper:
            upper, proof = real.upper, real.proof
    bounds = MuBounds(upper, float(min(lower, upper)), 0.0, delta, proof, size)
    _require(prover, bounds, 0.0, 0.0, M, np.zeros(M.shape))
    return bounds


def mu_interval(
    loop: StateSpace,
    blocks: Sequence[Block],
    low: float,
    high: float,
    rtol: float = REAL_RTOL,
    least: float = 0.0,
) -> MuBounds:
    """Bound μ of a loop at every frequency of an interval.

    Parameters
    ----------
    loop : StateSpace, stable, with Σcols outputs and Σrows inputs
    blocks : Sequence[Block]
    low, high : float, rad/s, high may be infinite, or in discrete time pi / dt
    rtol : float, target of the gap
    least : float, first level of the search, default 0.0
        ``upper`` equals this level where it can be proved.

    Returns
    -------
    MuBounds

    Raises
    ------
    SynthesisError
        If the loop is not stable, its shape does not fit the blocks, or no bound could be proved.

    References
    ----------
    THEORY 6.
    """
    structure = Structure(tuple(blocks))
    G, first, last, unwarped = continuous_interval("mu_interval", loop, structure, low, high)
    if structure.complex_only:
        bounds = _complex_interval(loop, structure, low, high, rtol, least)
    else:
        real = real_mu(G, structure, first, last, _aim(structure, rtol), least)
        bounds = MuBounds(real.upper, real.lower, unwarped(real.omega), real.delta, real.proof, real.size)
    M, moved = loop.response([bounds.omega])[0], response_rounding(loop, bounds.omega)
    _require(Prover(G, structure), bounds, first, last, M, moved)
    return bounds


def _aim(structure: Structure, rtol: float) -> float:
    """Return the target of the gap. D and G are exact for a single real scalar."""
    return min(rtol, ONE_REAL_RTOL) if structure.n_rows == 1 else rtol


def _scaled_bound(prover: Prover, M: np.ndarray, rtol: float) -> tuple[float, Part, np.ndarray, np.ndarray]:
    """Return the D, G bound of M, its proof, and factors of D_left and D_right.

    The bound is raised until its scalings prove it in spite of rounding. The scalings of a nearly triangular
    M are tried as well, in the order of their bounds. The last trial has the scalings 1.
    """
    structure = prover.structure
    value, _, left, right, skew = upper_bound(M, structure, rtol)
    n_real = sum(b.kind == "repeated_real" for b in structure.blocks)
    small = M / (4 * float(np.linalg.norm(M)))  # a small M needs no G
    alone = [sides[:2] for sides in triangular_scalings(small, ROUNDING * np.abs(small), structure)]
    with np.errstate(all="ignore"):  # extreme scalings prove nothing
        images = [a.conj().T @ M @ np.linalg.inv(b.conj().T) for a, b in alone]
    tried = [(value, (left, right, skew))]
    for sides, image in zip(alone, images, strict=True):
        if np.isfinite(image).all():
            tried.append((float(np.linalg.norm(image, 2)), (*sides, np.zeros_like(skew))))
    one = np.eye(structure.n_rows), np.eye(structure.n_cols), np.zeros_like(skew)
    levels, last = (
        [(max(n, np.finfo(float).tiny) * (1 + share), sides) for n, sides in those for share in INFLATIONS]
        for those in (tried, [(float(np.linalg.norm(M, 2)), one)])
    )
    for upper, (a, b, G) in sorted(levels, key=lambda level: level[0]) + last:
        D_left, D_right = a @ a.conj().T, b @ b.conj().T
        edge = np.full(n_real, 1 / upper)
        with np.errstate(over="ignore"):  # an infinite G proves nothing
            point = PointBound(1.0, D_left, np.zeros_like(D_right), D_right, G / upper)
        part = Part(ParameterBox(-edge, edge), 0.0, 0.0, point)
        if prover.verified([part], upper, 0.0, 0.0):
            return float(upper), part, left, right
    raise SynthesisError(
        "mu", "mu_upper", "no scalings prove a bound within rounding", "a matrix of like units"
    )


def _complex_interval(
    loop: StateSpace, structure: Structure, low: float, high: float, rtol: float, least: float
) -> MuBounds:
    """Bound μ over an interval without real blocks, with the parameters of ``mu_interval``."""

    def at(M: np.ndarray, _: float) -> PointBound:
        value, _, left, right, skew = upper_bound(M, structure, POINT_RTOL)
        right = right @ right.conj().T
        return PointBound(value, left @ left.conj().T, np.zeros_like(right), right, skew)

    def held(M: np.ndarray, point: PointBound) -> float:
        return float(np.sqrt(max(sl.eigvalsh(quadratic(M, point), point.scaled)[-1], 0.0)))

    bound = cover("mu_interval", loop, structure, low, high, rtol, at, held, least)
    M = loop.response([bound.omega])[0]
    upper, _, left, right, _ = upper_bound(M, structure, POINT_RTOL)
    lower, delta = lower_bound(M, structure, left, right, upper * (1 - POINT_RTOL), INTERVAL_STARTS)
    proof = tuple(Part(EMPTY, c.low, c.high, c.point) for c in bound.cells)
    return MuBounds(bound.upper, float(lower), bound.omega, delta, proof, scaled_size(M, structure))


def _require(
    prover: Prover, bounds: MuBounds, low: float, high: float, M: np.ndarray, moved: np.ndarray
) -> None:
    """Raise SynthesisError unless both bounds are proved. The error names the failing and the proved bound.

    The proof of the upper bound must hold on [``low``, ``high``] [rad/s], and Δ must attain the lower bound
    at M, whose entries have the rounding ``moved``.
    """
    upper = prover.verified(bounds.proof, bounds.upper, low, high)
    lower = bounds.lower == 0 or _attains(M, prover.structure, bounds.delta, bounds.lower, moved)
    if upper and lower:
        return
    wrong = [] if upper else [f"the scalings do not prove the upper bound {bounds.upper:.6g} within rounding"]
    wrong += [] if lower else [f"Delta does not attain the lower bound {bounds.lower:.6g} within rounding"]
    known = f"; mu is at least {bounds.lower:.6g}" if lower else ""
    known += f"; mu is at most {bounds.upper:.6g}" if upper else ""
    raise SynthesisError(
        "mu",
        "mu_lower" if upper else "mu_upper",
        f"not proved: {', and '.join(wrong)}{known}",
        "a loop whose signals and states are scaled to like sizes",
    )


def mu_lower(
    M: np.ndarray,
    blocks: Sequence[Block],
    left: np.ndarray,
    right: np.ndarray,
    enough: float,
    starts: int = 8,
) -> tuple[float, np.ndarray | None]:
    """Lower bound of μ of M (Σcols, Σrows), and the Δ (Σrows, Σcols) that attains it.

    ``left`` (Σcols, Σcols) and ``right`` (Σrows, Σrows) are the factors that ``upper_bound`` returns. They
    make leftᴴ M right⁻ᴴ a well-scaled image of M, which speeds up the search. The search ends early at the
    value ``enough``. The result is (0, None) where no Δ attains its value within rounding.
    """
    M, structure = np.asarray(M, dtype=complex), Structure(tuple(blocks))
    value, delta = lower_bound(M, structure, left, right, enough, starts)
    held = _attains(M, structure, delta, value, np.zeros(M.shape))
    return (value, delta) if held else (0.0, None)


def _attains(
    M: np.ndarray, structure: Structure, delta: np.ndarray | None, value: float, moved: np.ndarray
) -> bool:
    """Return whether Δ proves the lower bound ``value`` at M, whose entries have the rounding ``moved``."""
    if delta is None:
        return False
    moved = np.maximum(moved, SINGULAR_RTOL * np.abs(M))
    return bool(value <= attained(M, structure, delta, moved) * (1 + SINGULAR_RTOL))
