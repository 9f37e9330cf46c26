"""Proofs for a slowly varying Δ, with its commutator with a dynamic scaling D as one more uncertainty (THEORY
7.11).

The scaling of a block is d = D∞ + C (q − A)⁻¹ B in discrete time, stable with a stable inverse. q is the
shift by one sample. A causal linear Δ changes by E = q Δ q⁻¹ − Δ over one sample. Then

    d Δ d⁻¹ = Δ − C (q − A)⁻¹ E q X,     X = (q − A)⁻¹ B d⁻¹,

where E acts on each state of d separately. Let the gain of E be at most r Ts. The loop with DΔD⁻¹ then is the
scaled loop with two blocks: Δ of gain 1, and E of gain r Ts. Constants commute with operators that vary
arbitrarily fast. A norm below 1 under constant scalings of the blocks is therefore a proof.
"""

from dataclasses import dataclass

import numpy as np

from lpvguard.engine.synthesis.constant_scalings import ConstantScalings
from lpvguard.engine.synthesis.dk import Scaling
from lpvguard.engine.synthesis.interconnection import GeneralisedPlant
from lpvguard.engine.synthesis.scheduling import closed_scaled
from lpvguard.engine.synthesis.statespace import StateSpace, append, gain, series, to_discrete

SHARES = (0.98, 0.9, 0.7, 0.4)
"""The proof tries these shares of the rate that the search on the grid gives."""
RATES = 1e-6, 1e4
"""Least and largest rate of the search [1/s]."""
RATE_RTOL = 0.03


@dataclass(frozen=True)
class SlowProof:
    """A proof for a slowly varying Δ.

    Δ may change by a gain of ``rate`` · Ts from sample to sample, with ``rate`` in 1/s. ``log_constants`` are
    the logarithms of the constants: of the blocks of Δ in a proof of stability alone, then of each E.
    ``level`` is the proved norm.
    """

    rate: float
    log_constants: np.ndarray
    level: float


class SlowLoop:
    """The scaled closed loop with the blocks Δ, then E, then performance.

    Parameters
    ----------
    plant : GeneralisedPlant
    controller : StateSpace, makes the discrete loop stable
    scaling : Scaling
    performance : bool, include the gain from [w; n; r_c] to z; otherwise prove stability only
    """

    def __init__(self, plant: GeneralisedPlant, controller: StateSpace, scaling: Scaling, performance: bool):
        self.dt = plant.system.dt
        loop = closed_scaled(plant, controller, scaling)
        if not performance:
            loop = loop.select(slice(0, plant.n_delta_in), slice(0, plant.n_delta_out))
        n_z, n_w = loop.n_outputs - plant.n_delta_in, loop.n_inputs - plant.n_delta_out
        left, _ = scaling.systems(plant)
        # For each block, H goes from its scaled input to q X, and F from the output of E to its scaled
        # output.
        H, F, sizes = [], [], []
        d = [to_discrete(system, self.dt) for system in _scalar(left, plant, scaling)]
        for system, block in zip(d, plant.blocks, strict=True):
            H.append(append(*[_next_state(system)] * block.cols))
            F.append(append(*[_read(system)] * block.rows))
            sizes.append((system.order * block.cols, system.order * block.rows))
        self.blocks = len(plant.blocks)
        seen, acted = append(*H), append(*F)
        into = _beside(gain(np.eye(plant.n_delta_in), self.dt), seen, n_z, self.dt)
        out = _sum(plant.n_delta_out, acted, n_w, self.dt)
        fixed = self.blocks if performance else 0
        moving = self.blocks if scaling.log_parameters.shape[1] > 1 else 0
        self.scalings = ConstantScalings(
            series(into, series(loop, out)),
            [*(b.cols for b in plant.blocks), *(s for s, _ in sizes[:moving])],
            [*(b.rows for b in plant.blocks), *(s for _, s in sizes[:moving])],
            fixed,
        )

    def proved(self, rate: float, log_constants: np.ndarray) -> float:
        """Upper bound of the norm over all frequencies with ``log_constants`` (free,).

        Below 1 it proves ``rate``.
        """
        return self.scalings.proved(self._sizes(rate), 1.0, log_constants)

    def search(self) -> SlowProof | None:
        """Proof with the largest rate that the search finds within RATES, or None."""
        low, high = np.log(RATES)
        best: tuple[float, np.ndarray] | None = None
        beside = 0.0
        while high - low > RATE_RTOL:
            middle = 0.5 * (low + high)
            rate = float(np.exp(middle))
            even = self.even(rate)
            value, x = self.scalings.least(self._sizes(rate), 1.0, even + beside, True)
            if value < 1:
                low, best, beside = middle, (rate, x), x - even
            else:
                high = middle
        if best is None:
            return None
        for share in SHARES:
            level = self.proved(share * best[0], best[1])
            if level < 1:
                return SlowProof(share * best[0], best[1], level)
        return None

    def at(self, rate: float) -> SlowProof:
        """Proof of a level for a given ``rate``. The level may be 1 or more."""
        _, x = self.scalings.least(self._sizes(rate), 1.0, self.even(rate))
        return SlowProof(rate, x, self.proved(rate, x))

    def even(self, rate: float) -> np.ndarray:
        """Logarithms (free,) of constants that split a rate above 0 equally between rows and columns of E."""
        start = np.zeros(self.scalings.free)
        if rate > 0:
            start[self.blocks - self.scalings.fixed :] = -0.5 * np.log(rate * self.dt)
        return start

    def _sizes(self, rate: float) -> np.ndarray:
        """Gains of the blocks: 1 for each block of Δ, and rate · Ts for each E."""
        return np.where(np.arange(len(self.scalings.rows)) < self.blocks, 1.0, rate * self.dt)


def _scalar(left: StateSpace, plant: GeneralisedPlant, scaling: Scaling) -> list[StateSpace]:
    """Continuous scalar scaling d of each block."""
    firsts = np.cumsum([0, *(block.cols for block in plant.blocks)])[:-1]
    order = (scaling.log_parameters.shape[1] - 1) // 2
    out = []
    for k in firsts:
        states = slice(order * k, order * (k + 1))
        out.append(
            StateSpace(
                left.A[states, states], left.B[states, k : k + 1], left.C[k : k + 1, states], left.D[k, k]
            )
        )
    return out


def _next_state(d: StateSpace) -> StateSpace:
    """System q X, from the scaled signal d y to the next state of d, whose input is y."""
    B = d.B / d.D
    A = d.A - B @ d.C
    return StateSpace(A, B, A, B, d.dt)


def _read(d: StateSpace) -> StateSpace:
    """System C (q − A)⁻¹, from an input on every state of d."""
    n = d.order
    return StateSpace(d.A, np.eye(n), d.C, np.zeros((1, n)), d.dt)


def _beside(first: StateSpace, second: StateSpace, rest: int, dt: float) -> StateSpace:
    """System from [ẑ; z] to [first ẑ; second ẑ; z], where z has ``rest`` signals."""
    both = append(first, second)
    twice = np.vstack([np.eye(first.n_inputs)] * 2)
    joined = series(both, gain(twice, dt))
    return append(joined, gain(np.eye(rest), dt))


def _sum(width: int, acted: StateSpace, rest: int, dt: float) -> StateSpace:
    """System from [ŵ; e; w] to [ŵ − acted e; w], where w has ``rest`` signals."""
    added = series(
        gain(np.hstack([np.eye(width), -np.eye(width)]), dt), append(gain(np.eye(width), dt), acted)
    )
    return append(added, gain(np.eye(rest), dt))
