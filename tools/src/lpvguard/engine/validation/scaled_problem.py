"""Scale an LFT point to a well-conditioned quadratic problem, and convert its solution back."""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from lpvguard.base.errors import InputError
from lpvguard.engine.blocks import Block
from lpvguard.engine.validation.branch import Interval
from lpvguard.engine.validation.delta import Verification, least_size, split, verify
from lpvguard.engine.validation.problem import IMAGE_TOLERANCE, RANK_TOLERANCE, Lft, parametrise
from lpvguard.engine.validation.quadratic import Form, cancels
from lpvguard.engine.validation.well_posed import block_caps, well_posed

EDGE = 1e-9
"""A gamma_w within this relative distance of B1 counts as B1."""

ROUNDING = 1e-14
"""Rounding error of B1 relative to |e|."""


@dataclass(frozen=True)
class Solution:
    """Interval of the optimum and the explanation that attains ``upper``.

    Attributes
    ----------
    lower, upper : float
    nu : ndarray (tau,), sizes of the blocks
    xi : ndarray (p,) of complex
    eta : ndarray (q,) of complex
    w : ndarray (n_w,) of complex
    b1 : float, right side of (9)
    verification : Verification of the Delta that is built from these signals
    nodes : int, number of nodes of the branch and bound
    """

    lower: float
    upper: float
    nu: np.ndarray
    xi: np.ndarray
    eta: np.ndarray
    w: np.ndarray
    b1: float
    verification: Verification
    nodes: int


class ScaledProblem:
    """One LFT point in well-scaled coordinates, with the maps to the signals of the blocks and to w.

    ``xi``, ``eta`` (one map per block), ``w`` (n_w, n) and ``t`` (1, n) map a point z (n,) to signals with
    one common factor. ``dead`` holds the blocks whose input is always zero. ``ball_is_point`` is True if
    gamma_w equals B1.
    """

    def __init__(
        self, problem: Lft, w_scale: np.ndarray, gamma_w: float = np.inf, without: Sequence[int] = ()
    ):
        """``w_scale`` (n_w,) is the size of each disturbance. The blocks ``without`` get xi_i = 0.

        Raises InputError as :func:`problem.parametrise` does, and where only a dead block could explain e.
        """
        self.problem = problem
        par = parametrise(problem)
        self.b1 = par.b1
        # At gamma_w = B1 the ball is one point without an interior, and phi = 0 becomes a constraint.
        self.least_ball = par.b1 * (1.0 - EDGE) - ROUNDING * np.linalg.norm(problem.e)
        self.ball_is_point = bool(gamma_w <= par.b1 * (1.0 + EDGE) + ROUNDING * np.linalg.norm(problem.e))
        first = par.n_phi if self.ball_is_point else 0
        maps = tuple(m[:, first:] for m in (par.xi_map, par.w_map, par.eta_map))
        etas = split(problem.blocks, maps[2], "cols")
        self.dead = [i for i, eta in enumerate(etas) if i in without or not np.any(eta)]
        scaled = np.vstack([maps[0] * self._shares()[:, None], maps[1] / w_scale[:, None]])
        if self.dead:
            rows = split(problem.blocks, np.arange(len(maps[0])), "rows")
            held = np.concatenate([rows[i] for i in self.dead])
            change = self._without(scaled, held)
            scaled, maps = scaled @ change, tuple(m @ change for m in maps)
            maps[0][held] = 0.0  # rounding here would give infinite sizes for eta = 0
        q, r = np.linalg.qr(scaled[:, :-1])
        shift = q.conj().T @ scaled[:, -1]
        rest = np.linalg.norm(scaled[:, -1] - q @ shift)
        kappa = rest if rest > 1e-9 * np.linalg.norm(shift) else 1.0
        d = r.shape[0]
        back = np.zeros((d + 1, d + 1), dtype=complex)
        back[:d, :d] = np.linalg.inv(r)
        back[:d, d] = -(back[:d, :d] @ shift) / kappa
        back[d, d] = 1.0 / kappa
        self._xi, self._w, self._eta = (m @ back for m in maps)
        self.t = np.zeros((1, d + 1), dtype=complex)
        self.t[0, -1] = 1.0 / kappa

    def _shares(self) -> np.ndarray:
        """Share (p,) of e per unit of each signal in xi, 1 for a block without effect on the outputs."""
        blocks, size_e = self.problem.blocks, float(np.linalg.norm(self.problem.e)) or 1.0
        gains = [float(np.linalg.norm(m)) or size_e for m in split(blocks, self.problem.p21.T, "rows")]
        return np.repeat(gains, [b.rows for b in blocks]) / size_e

    def _without(self, scaled: np.ndarray, held: np.ndarray) -> np.ndarray:
        """Map (n, n') to the points where the signals of the dead blocks are 0.

        These signals are the rows ``held`` of ``scaled`` (.., n). Each direction is scaled separately. A
        signal that the data force to zero is then recognised as rounding. Raises InputError when the data
        need a dead block.
        """
        unit = np.linalg.norm(scaled[:, :-1], axis=0)
        left, right = scaled[held, :-1] / unit, -scaled[held, -1]
        u, s, vh = np.linalg.svd(left)
        rank = int(np.sum(s > RANK_TOLERANCE))
        point = vh[:rank].conj().T @ ((u[:, :rank].conj().T @ right) / s[:rank])
        if np.linalg.norm(left @ point - right) > IMAGE_TOLERANCE:
            raise InputError(
                self.problem.source,
                f"block {self.dead[0] + 1}",
                "its input eta is zero, so it cannot explain e",
                "eta0 != 0",
            )
        change = np.zeros((len(unit) + 1, len(unit) - rank + 1), dtype=complex)
        change[:-1] = np.column_stack([vh[rank:].conj().T, point]) / unit[:, None]
        change[-1, -1] = 1.0
        return change

    @cached_property
    def xi(self) -> list[np.ndarray]:
        """Maps (rows_i, n) from z to xi_i, one per block."""
        return split(self.problem.blocks, self._xi, "rows")

    @cached_property
    def eta(self) -> list[np.ndarray]:
        """Maps (cols_i, n) from z to eta_i, one per block."""
        return split(self.problem.blocks, self._eta, "cols")

    @property
    def n(self) -> int:
        """Length of z, the number of free variables plus one."""
        return self.t.shape[1]

    @property
    def w(self) -> np.ndarray:
        """Map (n_w, n) from z to w."""
        return self._w

    def constant_eta(self, i: int) -> bool:
        """Return whether the input of block ``i`` does not depend on the free variables."""
        return not np.any(self.eta[i][:, :-1])

    def signals(self, z: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """xi (p,), eta (q,) and w (n_w,) at ``z`` (n,).

        A xi_i that is only rounding is set to zero. Rounding would give a full block a size. In a repeated
        block xi_i must be a multiple of eta_i, and rounding is not.
        """
        z = z / (self.t @ z)[0]
        xi = np.concatenate([np.zeros(len(m)) if cancels(m, z) else m @ z for m in self.xi])
        return xi, self._eta @ z, self._w @ z

    def points(self, known: Solution | None) -> list[np.ndarray]:
        """List with the point z (n,) of a known explanation; an empty list for None."""
        if known is None:
            return []
        maps, signals = np.vstack([self._xi, self._w]), np.concatenate([known.xi, known.w])
        size = np.maximum(np.linalg.norm(maps, axis=1), 1e-300)
        rest = (signals * self.t[0, -1] - maps[:, -1]) / size
        theta, *_ = np.linalg.lstsq(maps[:, :-1] / size[:, None], rest)
        return [np.append(theta, 1.0)]

    def finish(self, interval: Interval, what: str) -> Solution:
        """Build and verify the explanation of an interval. ``what`` names the bounds in messages.

        Raises InputError when there is no explanation, or it needs a perturbation at the well-posedness cap.
        """
        problem = self.problem
        if interval.z is None:
            raise InputError(
                problem.source,
                what,
                "no Delta of this structure explains e within the bounds",
                "larger bounds, or another structure",
            )
        xi, eta, w = self.signals(interval.z)
        pieces = zip(split(problem.blocks, xi, "rows"), split(problem.blocks, eta, "cols"), strict=True)
        nu = np.array([least_size(a, b) for a, b in pieces])
        if not well_posed(problem, nu):
            caps = ", ".join(f"{c:.6g}" for c in block_caps(problem))
            raise InputError(
                problem.source,
                "nu",
                f"{np.array2string(nu, precision=6)} is at or above the well-posedness cap "
                f"(single full blocks: {caps}), so some allowed Delta may make the LFT singular",
                "sizes below the cap",
            )
        verification = verify(problem.blocks, problem.matrices, problem.e, w, xi, nu)
        return Solution(interval.lower, interval.upper, nu, xi, eta, w, self.b1, verification, interval.nodes)


def scaled_problem(problem: Lft, gamma_w: float, without: Sequence[int] = ()) -> ScaledProblem:
    """Scale the point with |w| <= ``gamma_w`` and xi_i = 0 for the blocks ``without``.

    Raises InputError for a gamma_w that is negative, not finite or below B1, and as :class:`ScaledProblem`
    does.
    """
    if not np.isfinite(gamma_w) or gamma_w < 0.0:
        raise InputError(problem.source, "gamma_w", f"{gamma_w}", "a finite number that is not negative")
    scaled = ScaledProblem(
        problem, np.full(problem.p22.shape[1], gamma_w or np.linalg.norm(problem.e) or 1.0), gamma_w, without
    )
    if gamma_w < scaled.least_ball:
        raise InputError(
            problem.source,
            "gamma_w",
            f"{gamma_w:.6g} is below the smallest disturbance B1 = {scaled.b1:.6g}",
            "gamma_w >= B1",
        )
    return scaled


def ball(scaled: ScaledProblem, gamma_w: float) -> list[Form]:
    """List with |w| <= ``gamma_w`` as a form; an empty list if the ball is one point."""
    return [] if scaled.ball_is_point else [Form(scaled.w, scaled.t, constant=gamma_w**2)]


def block_form(
    scaled: ScaledProblem, i: int, *, constant: float = 0.0, param: int = -1, slope: float = 1.0
) -> Form:
    """Form of block ``i`` with the bound of :class:`quadratic.Form`."""
    block = scaled.problem.blocks[i]
    return Form(
        scaled.xi[i],
        scaled.eta[i],
        constant,
        param,
        slope,
        repeated=block.kind if block.repeated and block.rows > 1 else _scalar(block),
    )


def _scalar(block: Block) -> str | None:
    """Value of ``repeated`` for a 1 x 1 block. A complex scalar counts as full, a real one stays real."""
    return block.kind if block.kind == "repeated_real" else None
