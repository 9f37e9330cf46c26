"""D-K iteration: low-order controllers with a small certified level of robust performance.

Robust performance holds at level β when μ(F_l(P, K)(jω)) ≤ β over the blocks of Δ and the full performance
block. Each Δ block has a scalar D_i(s), stable with stable inverse. Then ‖D F_l(P, K) D⁻¹‖∞ ≤ β proves the
level at every frequency, DC and infinity included (Doyle 1985; Packard & Doyle 1993).

The iteration improves K and D in turn. H∞ synthesis for the scaled plant gives K. A fit of the form
Π (s/z + 1)/(s/p + 1), which lowers the scaled singular values over the whole band, gives D. The reported
level is the certified norm of the final scaled loop. The proof therefore does not depend on the fit.
D(s) covers a Δ that is linear and time-invariant; slow_delta bounds how fast Δ may vary. A constant D
(degree 0) covers a Δ that varies arbitrarily fast.
"""

import itertools
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial

import numpy as np
import scipy.linalg as sl
from scipy.optimize import minimize

from lpvguard.base.parallel import Map
from lpvguard.engine.synthesis.errors import SynthesisError
from lpvguard.engine.synthesis.hinf import HinfResult, hinf_synthesis, improved_level
from lpvguard.engine.synthesis.interconnection import GeneralisedPlant, zeros_poles
from lpvguard.engine.synthesis.mu import mu_lower
from lpvguard.engine.synthesis.norms import NormBracket, hinf_norm
from lpvguard.engine.synthesis.statespace import (
    StateSpace,
    append,
    balanced,
    gain,
    lft,
    series,
    to_continuous,
    to_discrete,
)

SLOWEST, FASTEST = 1e-4, 1e4
"""Range of the scalings' zeros and poles in rad/s."""


@dataclass(frozen=True)
class Scaling:
    """Scaling D(s) = diag(d_1 I, d_2 I, ..., I) with d_i = g Π_k (s/z_k + 1)/(s/p_k + 1).

    Attributes
    ----------
    log_parameters : ndarray (τ, 1 + 2·degree)
        Row i holds [ln g, ln z_1, ln p_1, ...] of block i, with z and p in rad/s. Without blocks τ = 0 and D
        = I.
    """

    log_parameters: np.ndarray

    def log_magnitude(self, omega) -> np.ndarray:
        """ln |d_i(jω)|, (τ, k)."""
        g, z, p = self._parts()
        return g[:, None] + 0.5 * (np.log1p(_squares(omega, z)) - np.log1p(_squares(omega, p))).sum(axis=1)

    def log_gradient(self, omega) -> np.ndarray:
        """Derivatives of each ln |d_i(jω)| by the parameters of block i, (τ, 1 + 2·degree, k)."""
        g, z, p = self._parts()
        out = np.ones((len(g), self.log_parameters.shape[1], np.size(omega)))
        for part, sign, first in ((z, -1, 1), (p, 1, 2)):
            square = _squares(omega, part)
            out[:, first::2] = sign * square / (1 + square)
        return out

    def systems(self, plant: GeneralisedPlant) -> tuple[StateSpace, StateSpace]:
        """Continuous systems D and D⁻¹ of the closed loop.

        D acts on its outputs (inputs of Δ, and z). D⁻¹ acts on its inputs (outputs of Δ, and w).
        """
        left, right = [], []
        for row, block in zip(self.log_parameters, plant.blocks, strict=True):
            g, z, p = np.exp(row[0]), np.exp(row[1::2]), np.exp(row[2::2])
            left += [zeros_poles(g, z, p)] * block.cols
            right += [zeros_poles(1 / g, p, z)] * block.rows
        performance = plant.performance_block
        return append(*left, gain(np.eye(performance.cols))), append(*right, gain(np.eye(performance.rows)))

    def _parts(self):
        return (
            self.log_parameters[:, 0],
            np.exp(self.log_parameters[:, 1::2]),
            np.exp(self.log_parameters[:, 2::2]),
        )


def _squares(omega, corners):
    return (np.asarray(omega, dtype=float)[None, None, :] / corners[:, :, None]) ** 2


@dataclass(frozen=True)
class RobustPerformance:
    """Bounds on μ of one closed loop.

    Attributes
    ----------
    upper : float, proved over all frequencies by ``scaling``
    lower : float, proved by the checked ``delta``
    lower_frequency : float, rad/s
    bracket : NormBracket, norm of the scaled loop
    scaling : Scaling
    delta : ndarray (n_in, n_out) of complex or None, uncertainty that proves ``lower``
    """

    upper: float
    lower: float
    lower_frequency: float
    bracket: NormBracket
    scaling: Scaling
    delta: np.ndarray | None


@dataclass(frozen=True)
class DKResult:
    """A controller with its robust-performance certificate.

    ``full_order`` is the order before reduction. ``history`` holds the levels of the iterations.
    """

    controller: StateSpace
    performance: RobustPerformance
    full_order: int
    history: tuple[float, ...]


def dk_synthesis(
    plant: GeneralisedPlant,
    degree: int = 1,
    iterations: int = 4,
    polish: int = 40,
    reduction_loss: float = 3e-5,
    start: Scaling | None = None,
    workers: Map = map,
) -> DKResult:
    """Synthesise a controller for robust performance.

    Parameters
    ----------
    plant : GeneralisedPlant, continuous or discrete
        All its blocks are full and complex. Without blocks the result is that of H∞ synthesis.
    degree : int, order of each d_i, default 1
    iterations : int, number of K steps, with D steps between them, default 4
    polish : int, further K steps that change D's parameters directly, default 40
    reduction_loss : float, largest relative rise of the certified level by order reduction, default 3e-05
    start : Scaling, optional, the first D, by default I
    workers : Map, runs the two directions of a ``polish`` step in parallel

    Returns
    -------
    DKResult

    Raises
    ------
    SynthesisError
        If a block is not full, or H∞ synthesis fails.

    References
    ----------
    THEORY 6. Doyle 1985. Packard & Doyle 1993.
    """
    if any(b.kind != "full" for b in plant.blocks):
        raise SynthesisError("D-K iteration", "blocks", "a repeated block", "full complex blocks")
    work = _Work(plant)
    scaling = start or Scaling(np.tile(np.r_[0.0, [0.0, 0.0] * degree], (len(plant.blocks), 1)))
    history: list[float] = []
    level = None
    if plant.blocks:
        best, best_scaling = np.inf, scaling
        for k in range(iterations):
            result = work.controller(scaling, rtol=2e-5, guess=history[-1] if history else None)
            history.append(result.gamma)
            if result.gamma < best:
                best, best_scaling = result.gamma, scaling
            if k == iterations - 1 or (k > 1 and result.gamma > history[-2] * (1 - 1e-4)):
                break
            scaling = work.fit(lft(work.system, result.controller), scaling, power=10)
        level, scaling = _polish(work, best_scaling, best, polish, workers)
        history.append(level)
    final = work.controller(scaling, backoff=3e-4, guess=level)
    reduced = reduce_controller(work, final.controller, scaling, final.gamma_achieved * (1 + reduction_loss))
    K = to_discrete(reduced, plant.system.dt) if plant.system.dt else reduced
    return DKResult(K, certify(plant, K, scaling), final.controller.order, tuple(history))


def certify(
    plant: GeneralisedPlant, controller: StateSpace, scaling: Scaling | None = None
) -> RobustPerformance:
    """Bound μ over all frequencies for any controller of a plant.

    The upper bound is the lower one of two certified norms: under ``scaling``, and under a scaling fitted
    from it.

    Parameters
    ----------
    plant : GeneralisedPlant
    controller : StateSpace
    scaling : Scaling, optional, by default I

    Returns
    -------
    RobustPerformance, whose bounds are inf for an unstable loop
    """
    work = _Work(plant)
    K = to_continuous(controller)
    loop = lft(work.system, K)
    start = scaling or Scaling(np.tile([0.0, np.log(0.1), np.log(0.1)], (len(plant.blocks), 1)))
    if not loop.stability_margin() > 0:
        return RobustPerformance(np.inf, np.inf, np.nan, NormBracket(np.inf, np.inf, np.nan), start, None)
    if not plant.blocks:
        bracket = hinf_norm(lft(plant.system, controller))
        nothing = Scaling(np.zeros((0, 1)))
        return RobustPerformance(bracket.upper, bracket.lower, bracket.peak_frequency, bracket, nothing, None)
    tried = [start, work.fit(loop, start, power=200)]
    brackets = [work.scaled_norm(loop, one) for one in tried]
    k = int(np.argmin([b.upper for b in brackets]))
    lower, frequency, delta = work.lower(loop, tried[k], brackets[k].peak_frequency)
    return RobustPerformance(
        brackets[k].upper,
        lower,
        work.unwarp(frequency),
        NormBracket(brackets[k].lower, brackets[k].upper, work.unwarp(brackets[k].peak_frequency)),
        tried[k],
        delta,
    )


class _Work:
    """The continuous image of a plant, with the grid on which scalings are fitted."""

    def __init__(self, plant: GeneralisedPlant):
        self.plant = plant
        self.system = to_continuous(plant.system)
        self.omega = np.concatenate(
            [[0.0], np.logspace(-4, 4, 64), [1e12]]
        )  # the first and last stand for DC and infinity
        edges = np.cumsum([0] + [b.cols for b in plant.blocks] + [plant.performance_block.cols])
        self.rows = [slice(a, b) for a, b in itertools.pairwise(edges)]
        edges = np.cumsum([0] + [b.rows for b in plant.blocks] + [plant.performance_block.rows])
        self.cols = [slice(a, b) for a, b in itertools.pairwise(edges)]

    def unwarp(self, omega: float) -> float:
        """Frequency of the plant that corresponds to a frequency of its continuous image [rad/s]."""
        dt = self.plant.system.dt
        return float(2 / dt * np.arctan(omega * dt / 2)) if dt else omega

    def scaled(self, G: StateSpace, scaling: Scaling) -> StateSpace:
        """D G D⁻¹ for a plant or a closed loop (D = I on controls and measurements)."""
        left, right = scaling.systems(self.plant)
        left = append(left, gain(np.eye(G.n_outputs - left.n_outputs)))
        right = append(right, gain(np.eye(G.n_inputs - right.n_inputs)))
        return balanced(series(left, series(G, right)))

    def controller(self, scaling: Scaling, **options) -> HinfResult:
        """Result of H∞ synthesis for the scaled plant. ``options`` are passed to hinf_synthesis."""
        return hinf_synthesis(
            self.scaled(self.system, scaling), self.plant.n_control, self.plant.n_measurement, **options
        )

    def improved(self, level: float, scaling: Scaling) -> float | None:
        """Optimum of the scaled plant where it lies below ``level``, else None."""
        return improved_level(
            self.scaled(self.system, scaling),
            self.plant.n_control,
            self.plant.n_measurement,
            level,
            rtol=2e-5,
        )

    def scaled_norm(self, loop: StateSpace, scaling: Scaling) -> NormBracket:
        """Certified norm of the scaled closed loop: an upper bound of μ at every frequency."""
        return hinf_norm(self.scaled(loop, scaling), rtol=1e-5)

    def fit(self, loop: StateSpace, start: Scaling, power: float) -> Scaling:
        """Scaling with the least power mean of σ̄(D M D⁻¹) over the grid, by BFGS on its log parameters."""
        M = loop.response(self.omega)
        shape = start.log_parameters.shape
        blocks = shape[0]
        low, high = np.log(SLOWEST), np.log(FASTEST)
        spread = np.zeros(shape)
        corners = start.log_parameters[:, 1:]
        if corners.size and np.ptp(corners) == 0:  # leave the stationary points z = p and equal pairs
            pairs = np.arange(corners.shape[1] // 2)
            centre = (pairs - pairs.mean()) * np.log(10.0)
            spread[:, 1::2], spread[:, 2::2] = centre + np.log(3.0), centre - np.log(3.0)

        def objective(x):
            scaling = Scaling(np.clip(x.reshape(shape), low, high))
            d = scaling.log_magnitude(self.omega)
            left, right = np.zeros(M.shape[:2]), np.zeros((len(M), M.shape[2]))
            for i in range(blocks):
                left[:, self.rows[i]], right[:, self.cols[i]] = d[i][:, None], d[i][:, None]
            N = np.exp(left)[:, :, None] * M * np.exp(-right)[:, None, :]
            values, U = np.linalg.eigh(N @ np.conj(np.swapaxes(N, 1, 2)))
            sigma, u = np.sqrt(np.maximum(values[:, -1], 1e-300)), U[:, :, -1]
            v = np.abs(np.einsum("kij,ki->kj", N, u.conj())) ** 2 / sigma[:, None] ** 2
            u = np.abs(u) ** 2
            log_sigma = np.log(sigma)
            top = log_sigma.max()
            weight = np.exp(power * (log_sigma - top))
            value = top + np.log(weight.mean()) / power
            slope = np.array(
                [u[:, self.rows[i]].sum(axis=1) - v[:, self.cols[i]].sum(axis=1) for i in range(blocks)]
            )
            slope = slope * weight / weight.sum()
            return value, np.einsum("ik,ijk->ij", slope, scaling.log_gradient(self.omega)).ravel()

        optimum = minimize(
            objective,
            (start.log_parameters + spread).ravel(),
            jac=True,
            method="BFGS",
            options={"maxiter": 40, "gtol": 1e-6},
        )
        return Scaling(np.clip(optimum.x.reshape(shape), low, high))

    def lower(
        self, loop: StateSpace, scaling: Scaling, peak: float
    ) -> tuple[float, float, np.ndarray | None]:
        """Best lower bound of μ, its frequency [rad/s] and its Δ.

        The bound is computed at the peak of the scaled norm and at the two highest points of the grid.
        """
        left, right = scaling.systems(self.plant)
        sigma = np.linalg.norm(self.scaled(loop, scaling).response(self.omega), 2, axis=(1, 2))
        points = np.unique(np.append(self.omega[np.argsort(sigma)[-2:]], peak))
        blocks = (*self.plant.blocks, self.plant.performance_block)
        scales = (_diagonals(left.response(points)), 1 / _diagonals(right.response(points)))
        bounds = [
            mu_lower(M, blocks, np.diag(L), np.diag(R), sigma.max() * (1 - 1e-6))
            for M, L, R in zip(loop.response(points), *scales, strict=True)
        ]
        k = int(np.argmax([value for value, _ in bounds]))
        return bounds[k][0], float(points[k]), bounds[k][1]


def _diagonals(G: np.ndarray) -> np.ndarray:
    """Magnitudes (k, n) of the diagonals of k matrices."""
    return np.abs(np.diagonal(G, axis1=1, axis2=2))


def _polish(work: _Work, scaling: Scaling, level: float, budget: int, workers: Map) -> tuple[float, Scaling]:
    """Pattern search on the parameters of D. Each of at most ``budget`` trials is one H∞ synthesis."""
    x, size = scaling.log_parameters.copy(), 0.08
    moves = [(i, j) for j in (0, *range(x.shape[1] - 1, 0, -1)) for i in range(x.shape[0])]
    direction = dict.fromkeys(moves, 1.0)
    while budget > 0 and size > 0.01 and moves:
        better = False
        for move in moves:
            along = np.zeros_like(x)
            along[move] = direction[move] * size
            trials = [Scaling(x + along), Scaling(x - along)][:budget]
            for trial, value in zip(
                trials, workers(partial(work.improved, level * (1 - 1e-5)), trials), strict=True
            ):
                budget -= 1
                if value is not None:
                    x, level, better = trial.log_parameters, value, True
                    break
                direction[move] *= -1
        size *= 1.0 if better else 0.5
    return level, Scaling(x)


def reduce_controller(work: _Work, K: StateSpace, scaling: Scaling, level: float) -> StateSpace:
    """K truncated to the fewest states that keep the certified scaled norm ≤ ``level``, or K itself."""
    scaled_plant = work.scaled(work.system, scaling)
    truncated, rank = _truncations(scaled_plant, K)

    def passes(order):
        return hinf_norm(lft(scaled_plant, truncated(order)), rtol=1e-5).upper <= level

    low, high = 0, rank + 1  # order low fails, order high passes; rank + 1 stands for K
    while high - low > 1:
        middle = (low + high) // 2
        if passes(middle):
            high = middle
        else:
            low = middle
    return K if high > rank else balanced(truncated(high))


def _truncations(scaled_plant: StateSpace, K: StateSpace) -> tuple[Callable[[int], StateSpace], int]:
    """Function that truncates K to an order, and the largest order that it accepts.

    The Gramians of the scaled closed loop have blocks that belong to the controller. These blocks show how
    much each controller state contributes to the path from w to z (Ceton, Wortelboer & Bosgra 1993). The
    method also works for unstable controllers. The rank is 0 where the Gramians cannot be computed.
    """
    loop = lft(scaled_plant, K)
    n = scaled_plant.order
    try:
        reach = sl.solve_continuous_lyapunov(loop.A, -loop.B @ loop.B.T)[n:, n:]
        seen = sl.solve_continuous_lyapunov(loop.A.T, -loop.C.T @ loop.C)[n:, n:]
    except np.linalg.LinAlgError:
        return lambda order: K, 0
    R, S = gramian_factor(reach), gramian_factor(seen)
    U, sigma, Vt = np.linalg.svd(S.T @ R)
    rank = int(np.count_nonzero(sigma > 1e-13 * sigma[0]))
    scale = 1 / np.sqrt(sigma[:rank])
    into, out = R @ Vt[:rank].T * scale, (S @ U[:, :rank] * scale).T

    def truncated(order):
        T, L = into[:, :order], out[:order]
        return StateSpace(L @ K.A @ T, L @ K.B, K.C @ T, K.D)

    return truncated, rank


def gramian_factor(gramian: np.ndarray) -> np.ndarray:
    """Square factor F (n, n) of a Gramian (n, n), with F Fᵀ = gramian.

    Negative eigenvalues, which are rounding, are replaced by 0.
    """
    values, vectors = np.linalg.eigh(0.5 * (gramian + gramian.T))
    return vectors * np.sqrt(np.maximum(values, 0.0))
