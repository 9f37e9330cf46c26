"""A slowly varying Δ: the commutator of Δ and a dynamic scaling D, as one more uncertainty (THEORY 7.11).

A block's scaling is d = D∞ + C (q − A)⁻¹ B in discrete time, stable with stable inverse, q the shift by
one sample. For any causal linear Δ and its change over one sample, E = q Δ q⁻¹ − Δ,

    d Δ d⁻¹ = Δ − C (q − A)⁻¹ E q X,     X = (q − A)⁻¹ B d⁻¹,

with E acting on each of d's states alike. Let no Δ change by more than r Ts in gain from sample to sample.
Then the loop with DΔD⁻¹ is the scaled loop with two blocks: Δ of gain 1, and E of gain r Ts. Constants
commute with operators of any speed. A norm below 1 under constant scalings of the blocks is therefore a
proof.
"""

from dataclasses import dataclass

import numpy as np

from lpvguard.engine.synthesis.constant_scalings import ConstantScalings
from lpvguard.engine.synthesis.dk import Scaling
from lpvguard.engine.synthesis.interconnection import GeneralisedPlant
from lpvguard.engine.synthesis.scheduling import closed_scaled
from lpvguard.engine.synthesis.statespace import StateSpace, append, gain, series, to_discrete

SHARES = (0.98, 0.9, 0.7, 0.4)
"""Shares of the grid's rate that are tried in the proof."""
RATES = 1e-6, 1e4
"""Least and largest rate that is looked for [1/s]."""
RATE_RTOL = 0.03


@dataclass(frozen=True)
class SlowProof:
    """``rate`` [1/s]: Δ may change by rate · Ts in gain from sample to sample. ``log_constants``:
    logarithms of the constants: of the blocks of Δ where only stability counts, then of each E. ``level``:
    the norm that was proved."""

    rate: float
    log_constants: np.ndarray
    level: float


class SlowLoop:
    """The scaled closed loop with the blocks Δ, then E, then performance.

    Parameters
    ----------
    plant : GeneralisedPlant
    controller : StateSpace, which makes a stable discrete loop
    scaling : Scaling
    performance : bool, count the gain from [w; n; r_c] to z; otherwise only stability
    """

    def __init__(self, plant: GeneralisedPlant, controller: StateSpace, scaling: Scaling, performance: bool):
        self.dt = plant.system.dt
        loop = closed_scaled(plant, controller, scaling)
        if not performance:
            loop = loop.select(slice(0, plant.n_delta_in), slice(0, plant.n_delta_out))
        n_z, n_w = loop.n_outputs - plant.n_delta_in, loop.n_inputs - plant.n_delta_out
        left, _ = scaling.systems(plant)
        # Of each block: H from its scaled input to q X, F from E's output to its scaled output.
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
        """The norm from above over all frequencies with ``log_constants`` (free,); below 1 it proves
        ``rate``."""
        return self.scalings.proved(self._sizes(rate), 1.0, log_constants)

    def search(self) -> SlowProof | None:
        """The largest rate found with a proof; None: none from RATES on."""
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
        """The level proved for a given ``rate``, which may be 1 or more."""
        _, x = self.scalings.least(self._sizes(rate), 1.0, self.even(rate))
        return SlowProof(rate, x, self.proved(rate, x))

    def even(self, rate: float) -> np.ndarray:
        """Logarithms (free,) of constants that give a rate above 0 in equal parts to rows and columns of
        E."""
        start = np.zeros(self.scalings.free)
        if rate > 0:
            start[self.blocks - self.scalings.fixed :] = -0.5 * np.log(rate * self.dt)
        return start

    def _sizes(self, rate: float) -> np.ndarray:
        """1 for each block of Δ, and the rate a sample for each E."""
        return np.where(np.arange(len(self.scalings.rows)) < self.blocks, 1.0, rate * self.dt)


def _scalar(left: StateSpace, plant: GeneralisedPlant, scaling: Scaling) -> list[StateSpace]:
    """The scaling of each block once, continuous."""
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
    """q X: from the scaled signal d y to the next state of d, driven by y."""
    B = d.B / d.D
    A = d.A - B @ d.C
    return StateSpace(A, B, A, B, d.dt)


def _read(d: StateSpace) -> StateSpace:
    """C (q − A)⁻¹, from an input on every state."""
    n = d.order
    return StateSpace(d.A, np.eye(n), d.C, np.zeros((1, n)), d.dt)


def _beside(first: StateSpace, second: StateSpace, rest: int, dt: float) -> StateSpace:
    """From [ẑ; z] to [ẑ; second ẑ; z]."""
    both = append(first, second)
    twice = np.vstack([np.eye(first.n_inputs)] * 2)
    joined = series(both, gain(twice, dt))
    return append(joined, gain(np.eye(rest), dt))


def _sum(width: int, acted: StateSpace, rest: int, dt: float) -> StateSpace:
    """From [ŵ; e; w] to [ŵ − acted e; w]."""
    added = series(
        gain(np.hstack([np.eye(width), -np.eye(width)]), dt), append(gain(np.eye(width), dt), acted)
    )
    return append(added, gain(np.eye(rest), dt))
