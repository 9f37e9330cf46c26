"""Proofs for a loop with a limited demand and anti-windup, by sector bounds of the dead zone (THEORY 7.12).

The controller has the state x⁺ = A x + B m − L q. It demands u = C x, and the plant receives v = u − q. For
each input, q is the dead zone of u: zero up to u_max, and the excess beyond. While |u| ≤ κ u_max the dead
zone lies in the sector from 0 to ``s = 1 − 1/κ``. Then ``q = ½ s (u + p)`` with |p| ≤ |u| sample by sample.
The signal p of each input is the output of one more uncertainty block, which is memoryless. Constants commute
with this block, as D(s) commutes with a linear time-invariant Δ. D(s) and the constants scale the outputs and
inputs of the loop. A matrix Q ≻ 0 with

    diag(Q, I) − [A B; C D] diag(Q, I) [A B; C D]ᵀ ≻ 0

proves a gain from w of at most 1, and xᵀQ⁻¹x ≤ ‖w‖² at every time. Then ``|c x| ≤ ‖w‖ √(c Q cᵀ)``. This
keeps u within κ u_max and its steps within a rate limit for every disturbance of bounded energy.
"""

import itertools
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import scipy.linalg as sl

from lpvguard.engine.synthesis.constant_scalings import ConstantScalings
from lpvguard.engine.synthesis.dk import Scaling
from lpvguard.engine.synthesis.errors import SynthesisError
from lpvguard.engine.synthesis.interconnection import GeneralisedPlant
from lpvguard.engine.synthesis.statespace import EPS, StateSpace, append, balancing, gain, series, to_discrete

GAIN_RTOL = 0.02
"""Relative accuracy of the search for gains."""
LARGEST_GAIN = 1e3
BACKOFF = 1.05
"""The proof is tried at the least gain on the grid times this factor."""
OFFSETS = (-4.0, -2.0, 0.0, 2.0, 4.0)
"""Trial offsets of the logarithms of all constants in the search for the energy. They weight the blocks
against w."""
SLACK = 1e-7
"""Extra input on every state, relative to B Bᵀ, which makes the equation of Q strict."""
DOUBLINGS = 40
"""Largest number of doubling steps of a Riccati equation. n steps stand for 2^n samples."""
RESERVE = 64
"""Least distance of an eigenvalue from 0, in units of rounding for each row."""


@dataclass(frozen=True)
class Reachable:
    """Proof that the demand keeps its limits for every ‖w‖ up to ``energy``.

    ``log_constants`` (blocks,) prove it.
    """

    energy: float
    log_constants: np.ndarray


def sector(kappa: float) -> float:
    """Upper slope of the sector of the dead zone while |u| ≤ kappa u_max."""
    return 1 - 1 / kappa


def limited_loop(
    plant: GeneralisedPlant, controller: StateSpace, L: np.ndarray, kappa: float, scaling: Scaling
) -> StateSpace:
    """Build the loop from [Δ outputs, p, w] to [Δ inputs, u, z], with the signals of Δ scaled by D.

    The states are [.., x, x_K, previous u (n_u), ..].

    Parameters
    ----------
    plant : GeneralisedPlant
    controller : StateSpace, strictly proper
    L : ndarray (n, n_u), anti-windup gain
    kappa : float, largest ratio of the demand to its limit
    scaling : Scaling

    Returns
    -------
    StateSpace

    Raises
    ------
    SynthesisError
        If the plant has no delay, or the controller is not strictly proper.

    References
    ----------
    THEORY 7.12.
    """
    P, K, s = plant.system, controller, sector(kappa)
    n_w, n_z = P.n_inputs - plant.n_control, P.n_outputs - plant.n_measurement
    B1, B2, C1, C2 = P.B[:, :n_w], P.B[:, n_w:], P.C[:n_z], P.C[n_z:]
    D11, D12, D21 = P.D[:n_z, :n_w], P.D[:n_z, n_w:], P.D[n_z:, :n_w]
    if P.D[n_z:, n_w:].any() or K.D.any():
        raise SynthesisError(
            "limited loop", "plant", "no delay", "inputs with a delay of at least one sample"
        )
    n, m, n_u = P.order, K.order, plant.n_control
    # The states are x, x_K and the previous demand. The output of the dead zone enters as q.
    A = np.block(
        [
            [P.A, B2 @ K.C, np.zeros((n, n_u))],
            [K.B @ C2, K.A, np.zeros((m, n_u))],
            [np.zeros((n_u, n)), K.C, np.zeros((n_u, n_u))],
        ]
    )
    by_w = np.vstack([B1, K.B @ D21, np.zeros((n_u, n_w))])
    by_q = np.vstack([-B2, -L, np.zeros((n_u, n_u))])
    to_u = np.hstack([np.zeros((n_u, n)), K.C, np.zeros((n_u, n_u))])
    to_z = np.hstack([C1, D12 @ K.C, np.zeros((n_z, n_u))])
    A, to_z = A + 0.5 * s * by_q @ to_u, to_z - 0.5 * s * D12 @ to_u
    xi, eta = plant.n_delta_out, plant.n_delta_in
    B = np.hstack([by_w[:, :xi], 0.5 * s * by_q, by_w[:, xi:]])
    C = np.vstack([to_z[:eta], to_u, to_z[eta:]])
    from_p = -0.5 * s * D12
    D = np.vstack(
        [
            np.hstack([D11[:eta, :xi], from_p[:eta], D11[:eta, xi:]]),
            np.zeros((n_u, n_w + n_u)),
            np.hstack([D11[eta:, :xi], from_p[eta:], D11[eta:, xi:]]),
        ]
    )
    loop = StateSpace(A, B, C, D, P.dt)
    left, right = (to_discrete(G, P.dt) for G in scaling.systems(plant))
    performance = plant.performance_block
    return series(
        append(left.select(slice(0, eta), slice(0, eta)), gain(np.eye(n_u + performance.cols), P.dt)),
        series(
            loop, append(right.select(slice(0, xi), slice(0, xi)), gain(np.eye(n_u + performance.rows), P.dt))
        ),
    )


class LimitedLoop:
    """A loop of `limited_loop` with its blocks: Δ, then the limit of every input, then performance.

    Parameters
    ----------
    plant : GeneralisedPlant
    controller : StateSpace
    L : ndarray (n, n_u), anti-windup
    kappa : float
    scaling : Scaling
    """

    def __init__(
        self, plant: GeneralisedPlant, controller: StateSpace, L: np.ndarray, kappa: float, scaling: Scaling
    ):
        self.kappa, self.system = kappa, limited_loop(plant, controller, L, kappa, scaling)
        self.n_u = plant.n_control
        self.rows = [*(b.cols for b in plant.blocks), *[1] * self.n_u]
        self.cols = [*(b.rows for b in plant.blocks), *[1] * self.n_u]
        self.ones = np.ones(len(self.rows))
        # The scalings on the inputs have the states before x.
        before = sum(b.rows for b in plant.blocks) * (scaling.log_parameters.shape[1] // 2)
        self.demand_before = before + plant.system.order + controller.order

    @property
    def stable(self) -> bool:
        """Tell if the loop is stable with the middle of the sector in place of the dead zone."""
        return self.system.stability_margin() > 0

    def stability(self) -> ConstantScalings:
        """Loop without performance.

        A norm below 1 proves that it is stable for every Δ and demand within κ u_max.
        """
        return ConstantScalings(
            self.system.select(slice(0, sum(self.rows)), slice(0, sum(self.cols))), self.rows, self.cols
        )

    def performance(self) -> ConstantScalings:
        """Loop with the blocks and performance."""
        return ConstantScalings(self.system, self.rows, self.cols)

    def gain(self) -> tuple[float, np.ndarray] | None:
        """Compute a gain from w to z for every Δ and every demand within κ u_max.

        Returns the gain and the logarithms (blocks,) of its constants, or None if the proof fails up to
        LARGEST_GAIN.
        """
        if not self.stable:
            return None
        scalings = self.performance()
        low, high = np.log(0.5), np.log(LARGEST_GAIN)
        starts = [np.full(scalings.free, -offset) for offset in (0.0, 4.0)]
        tried = [scalings.least(self.ones, 1 / LARGEST_GAIN, start, True) for start in starts]
        value, best = min(tried, key=lambda one: one[0])
        if not value < 1:
            return None
        while high - low > GAIN_RTOL:
            middle = 0.5 * (low + high)
            value, x = scalings.least(self.ones, float(np.exp(-middle)), best, True)
            if value < 1:
                high, best = middle, x
            else:
                low = middle
        gamma = float(np.exp(high)) * BACKOFF
        return (gamma, best) if scalings.proved(self.ones, 1 / gamma, best) < 1 else None

    def largest_energy(
        self, starts: Sequence[np.ndarray], u_max: np.ndarray, step_max: np.ndarray
    ) -> Reachable | None:
        """The largest energy that the constants of ``starts``, shifted by OFFSETS, prove, or None.

        Each start holds logarithms (blocks,). ``u_max`` and ``step_max`` (n_u,) are those of ``energy``.
        """
        reachable = []
        for start, offset in itertools.product(starts, OFFSETS):
            constants = start + offset
            energy = self.energy(constants, u_max, step_max)
            if energy is not None:
                reachable.append(Reachable(energy, constants))
        return max(reachable, key=lambda one: one.energy, default=None)

    def energy(self, log_constants: np.ndarray, u_max: np.ndarray, step_max: np.ndarray) -> float | None:
        """Compute the largest ‖w‖ with which the demand stays within its limits.

        ``log_constants`` (blocks,) prove |u| ≤ κ ``u_max`` (n_u,) and |u(k) − u(k − 1)| ≤ ``step_max``
        (n_u,). Returns None where Q does not exist or fails its test.
        """
        whole = self.performance().scaled(self.ones, 1.0, log_constants)
        G = whole.select(slice(0, sum(self.rows)), slice(None))
        t = balancing(G)
        A, B, C, D = G.A * t / t[:, None], G.B / t[:, None], G.C * t, G.D
        if not G.stability_margin() > 0:
            return None
        slack = SLACK * np.diag(np.diag(sl.solve_discrete_lyapunov(A, B @ B.T)) + EPS)
        Q = _reached(A, B, C, D, slack)
        if Q is None or not _proof(A, B, C, D, Q) > 1:
            return None
        demand = self.system.C[sum(self.rows) - self.n_u : sum(self.rows)]
        step = demand.copy()
        step[:, self.demand_before : self.demand_before + self.n_u] -= np.eye(self.n_u)
        rows = np.vstack([demand, step]) * t
        largest, moved = np.sqrt(np.einsum("ki,ij,kj->k", rows, Q, rows)).reshape(2, self.n_u)
        return float(min((self.kappa * u_max / largest).min(), (step_max / moved).min()))


def _reached(
    A: np.ndarray, B: np.ndarray, C: np.ndarray, D: np.ndarray, slack: np.ndarray
) -> np.ndarray | None:
    """The least Q with Q = A Q Aᵀ + B Bᵀ + slack + V (I − D Dᵀ − C Q Cᵀ)⁻¹ Vᵀ, V = A Q Cᵀ + B Dᵀ.

    It is computed by doubling (Chu, Fan, Lin and Wang 2004). None where the steps do not converge, for
    example if the gain is not below 1.
    """
    inverse = np.linalg.inv(np.eye(len(D)) - D @ D.T)
    H = B @ B.T + slack + B @ D.T @ inverse @ D @ B.T
    A, G = (A + B @ D.T @ inverse @ C).T, -C.T @ inverse @ C
    for _ in range(DOUBLINGS):
        try:
            W = np.linalg.inv(np.eye(len(A)) + G @ H)
        except np.linalg.LinAlgError:
            return None
        more = A.T @ H @ W @ A
        A, G, H = A @ W @ A, G + A @ W @ G @ A.T, H + 0.5 * (more + more.T)
        if more.max() <= EPS * H.max():
            return H
    return None


def _proof(A: np.ndarray, B: np.ndarray, C: np.ndarray, D: np.ndarray, Q: np.ndarray) -> float:
    """Least eigenvalue of diag(Q, I) − M diag(Q, I) Mᵀ, M = [A B; C D], over its allowance for rounding.

    It is -inf where Q is not positive definite. The states are first scaled to a unit diagonal of Q.
    """
    if not ((np.diag(Q) > 0).all() and np.isfinite(Q).all()):
        return -np.inf
    d = np.sqrt(np.diag(Q))
    A, B, C = A * d / d[:, None], B / d[:, None], C * d
    Q = 0.5 * (Q + Q.T) / d / d[:, None]
    n = len(Q)
    M = np.block([[A, B], [C, D]])
    inner, outer = np.eye(n + B.shape[1]), np.eye(n + len(C))
    inner[:n, :n] = outer[:n, :n] = Q
    F = outer - M @ inner @ M.T
    if np.linalg.eigvalsh(Q)[0] <= RESERVE * EPS * n:
        return -np.inf
    reserve = (
        RESERVE
        * EPS
        * (np.linalg.norm(outer, 2) + np.linalg.norm(np.abs(M) @ np.abs(inner) @ np.abs(M.T), 2))
    )
    return float(np.linalg.eigvalsh(F)[0] / reserve)
