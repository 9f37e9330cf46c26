"""The worst stable Δ of size 1 for a closed loop, as a system for simulation.

Let γ be the largest gain from [w; n; r_c] to z over ‖Δ_i‖ ≤ 1 at a frequency. The loop with its performance
rows divided by γ has μ = 1 (skewed μ; Packard & Doyle 1993). The lower bound of μ gives the Δ that attains
it: a complex rank-one matrix Δ_i = u vᴴ for each block. A stable all-pass can have any phase at one
frequency. Therefore

    Δ_i(s) = u(s) v(s)ᵀ,     u_k(s) = ±|u_k| (β_k − s)/(β_k + s),  v alike,

has σ̄(Δ_i(jω)) = ‖u‖ ‖v‖ = 1 at every ω and equals u vᴴ at the chosen frequency. In discrete time Δ_i is the
image of this system by Tustin's map. At DC such a Δ is real, and the search tries every combination of signs.
"""

import itertools
from dataclasses import dataclass

import numpy as np

from lpvguard.engine.synthesis.dk import Scaling
from lpvguard.engine.synthesis.interconnection import GeneralisedPlant
from lpvguard.engine.synthesis.mu import mu_lower
from lpvguard.engine.synthesis.norms import hinf_norm
from lpvguard.engine.synthesis.statespace import StateSpace, append, gain, lft, prewarped, series, to_discrete

GRID = np.r_[0.0, np.geomspace(1e-3, 1e2, 61)]
"""Default frequencies of the search [rad/s]."""
REFINED = 4
"""Number of frequencies, those with the largest gains, at which the full search runs."""
GAIN_RTOL = 1e-6
LEAST_LEVEL = 1e-12
"""Share of ‖M‖ that replaces a gain of zero."""


@dataclass(frozen=True)
class WorstCase:
    """The worst Δ and its effect on the closed loop.

    Attributes
    ----------
    delta : StateSpace, stable
    size : float, ‖Δ‖∞, at most 1 within rounding
    frequency : float, rad/s
    gain : float, gain from [w; n; r_c] to z at ``frequency``, measured on the closed loop
    nominal : float, this gain without Δ
    """

    delta: StateSpace
    size: float
    frequency: float
    gain: float
    nominal: float


def close_delta(loop: StateSpace, delta: StateSpace) -> StateSpace:
    """Close Δ around the first outputs and inputs of a loop: the upper LFT.

    Parameters
    ----------
    loop, delta : StateSpace

    Returns
    -------
    StateSpace
    """
    n_in, n_out = delta.n_inputs, delta.n_outputs
    rows = np.r_[n_in : loop.n_outputs, :n_in]
    cols = np.r_[n_out : loop.n_inputs, :n_out]
    return lft(loop.select(rows, cols), delta)


def worst_case(
    plant: GeneralisedPlant, controller: StateSpace, scaling: Scaling | None = None, omega=GRID
) -> WorstCase:
    """Search and verify the worst Δ over frequencies.

    The result is checked: Δ is stable with size 1, and the closed loop is stable with this gain. Without
    blocks Δ has the shape (0, 0), and the gain is the nominal peak.

    Parameters
    ----------
    plant : GeneralisedPlant
    controller : StateSpace
    scaling : Scaling, optional, from the certificate of the loop, which helps the search
    omega : array_like (K,), rad/s, frequencies from Nyquist's on are left out

    Returns
    -------
    WorstCase

    Raises
    ------
    ArithmeticError
        If the search finds no Δ of size 1 that keeps the loop stable.

    References
    ----------
    Packard & Doyle 1993.
    """
    loop = lft(plant.system, controller)
    omega = np.unique(omega[omega * loop.dt < np.pi])
    M = loop.response(omega)
    nominal = np.linalg.norm(M[:, plant.n_delta_in :, plant.n_delta_out :], 2, axis=(1, 2))
    if not plant.blocks:
        k = int(np.argmax(nominal))
        return WorstCase(
            gain(np.zeros((0, 0)), loop.dt), 0.0, float(omega[k]), float(nominal[k]), float(nominal[k])
        )
    warped = prewarped(omega, loop.dt)
    d = np.exp(scaling.log_magnitude(warped)) if scaling else np.ones((len(plant.blocks), len(omega)))
    search = _Search(plant)
    rough = [search.run(M[k], d[:, k], 1)[0] for k in range(len(omega))]
    candidates = []
    for k in np.argsort(rough, kind="stable")[::-1][:REFINED]:
        _, delta = search.run(M[k], d[:, k], 20)
        for parts in search.choices(delta, omega[k] == 0):
            realised = append(*(_realise(u, v, omega[k], loop.dt) for u, v in parts))
            closed = close_delta(loop, realised)
            if closed.stability_margin() > 0:
                measured = np.linalg.norm(closed.response(omega[k]), 2, axis=(1, 2)).item()
                candidates.append(
                    WorstCase(
                        realised, hinf_norm(realised).upper, float(omega[k]), measured, float(nominal[k])
                    )
                )
    if not candidates:
        raise ArithmeticError("the search found no Delta of size 1 that keeps the loop stable")
    return max(candidates, key=lambda one: one.gain)


class _Search:
    """Search for the largest gain (skewed μ) at one frequency."""

    def __init__(self, plant: GeneralisedPlant):
        self.blocks = (*plant.blocks, plant.performance_block)
        self.a, self.b = plant.n_delta_in, plant.n_delta_out
        self.rows = np.cumsum([0, *(one.cols for one in plant.blocks)])
        self.cols = np.cumsum([0, *(one.rows for one in plant.blocks)])

    def run(self, M: np.ndarray, d: np.ndarray, steps: int) -> tuple[float, np.ndarray]:
        """The largest gain that the search finds, and its Δ with blocks of size 1.

        d (τ,) are helpful scalings. Each step divides the performance rows by the gain so far, takes the Δ of
        the lower bound of μ, and scales its blocks to size 1.
        """
        left, right = (
            np.concatenate([np.full(n, x) for n, x in zip(sizes, [*d, 1.0], strict=True)])
            for sizes in ([b.cols for b in self.blocks], [b.rows for b in self.blocks])
        )
        level, best = float(np.linalg.norm(M[self.a :, self.b :], 2)), np.zeros((self.b, self.a), complex)
        least = max(LEAST_LEVEL * float(np.linalg.norm(M, 2)), float(np.finfo(float).tiny))
        for _ in range(steps):
            scaled = M.copy()
            scaled[self.a :] /= max(level, least)
            _, delta = mu_lower(scaled, self.blocks, np.diag(left), np.diag(right), np.inf, starts=4)
            if delta is None:
                break
            delta = self._sized(delta)
            reached = self.gain(M, delta)
            if not reached > level * (1 + GAIN_RTOL):
                break
            level, best = reached, delta
        return level, best

    def gain(self, M: np.ndarray, delta: np.ndarray) -> float:
        """σ̄ of M, closed with Δ, from the performance inputs to the performance outputs."""
        a, b = self.a, self.b
        inner = np.linalg.solve(np.eye(a) - M[:a, :b] @ delta, M[:a, b:])
        return float(np.linalg.norm(M[a:, b:] + M[a:, :b] @ delta @ inner, 2))

    def _blocks_of(self, delta: np.ndarray):
        return [
            (slice(*c), slice(*r), delta[slice(*c), slice(*r)])
            for c, r in zip(itertools.pairwise(self.cols), itertools.pairwise(self.rows), strict=True)
        ]

    def _sized(self, delta: np.ndarray) -> np.ndarray:
        out = np.zeros((self.b, self.a), complex)
        for c, r, block in self._blocks_of(delta):
            size = np.linalg.norm(block, 2)
            out[c, r] = block / size if size > 0 else block
        return out

    def choices(self, delta: np.ndarray, real: bool):
        """Pairs (u, v) for each block with Δ_i = u vᴴ and ‖u‖ ‖v‖ = 1.

        With ``real`` they are the real parts, once for every combination of signs.
        """
        parts = []
        for _, _, block in self._blocks_of(delta):
            U, _, Vh = np.linalg.svd(block)
            u, v = U[:, 0], Vh[0].conj()
            if real:
                turned = [(x * np.exp(-1j * np.angle(x[np.argmax(np.abs(x))]))).real for x in (u, v)]
                u, v = (x / np.linalg.norm(x) for x in turned)
            parts.append((u, v))
        for signs in itertools.product((1.0, -1.0), repeat=len(parts)) if real else [[1.0] * len(parts)]:
            yield [(sign * u, v) for sign, (u, v) in zip(signs, parts, strict=True)]


def _realise(u: np.ndarray, v: np.ndarray, omega: float, dt: float) -> StateSpace:
    """System u(s) v(s)ᵀ of all-passes with u(jω) v(jω)ᵀ = u vᴴ."""
    warped = prewarped(omega, dt)
    one = np.ones((1, 1))
    left = series(append(*(_all_pass(x, warped) for x in u)), gain(np.repeat(one, len(u), axis=0)))
    right = series(gain(np.repeat(one, len(v), axis=1)), append(*(_all_pass(x, warped) for x in v.conj())))
    both = series(left, right)
    return to_discrete(both, dt) if dt else both


def _all_pass(value: complex, omega: float) -> StateSpace:
    """Stable system of constant magnitude |value| that equals ``value`` at ``omega`` > 0.

    At ``omega`` = 0 only the sign of the real part of ``value`` counts.
    """
    size, phase = abs(value), np.angle(value)
    if omega == 0 or abs(np.sin(phase)) < 1e-9:
        return gain([[np.copysign(size, np.cos(phase))]])
    signed, lag = np.copysign(size, -phase), phase % -np.pi  # phase of (β − s)/(β + s), within (−π, 0)
    beta = omega / np.tan(-0.5 * lag)
    # −1 + 2β/(s + β)
    return StateSpace(
        np.array([[-beta]]), np.ones((1, 1)), np.array([[2 * beta * signed]]), np.array([[-signed]])
    )
