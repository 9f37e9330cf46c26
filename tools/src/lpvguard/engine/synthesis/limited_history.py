"""Simulation of the loop of saturation.py with its limit, and search for the worst input of a given size.

An input is worst if it causes the largest wanted demand, its largest step, or the largest output. For one
input each sample is either within the limit or beyond it. The derivative of a run by the input is therefore a
linear time-varying loop, and its adjoint costs one run. The iteration w = size · gradient / ‖gradient‖
increases the objective. The result is simulated, so it is a lower bound of the worst case.
"""

from dataclasses import dataclass

import numpy as np

from lpvguard.engine.synthesis.statespace import StateSpace

CLIMBS = 12
"""Largest number of iterations."""
AIMS = ("demand", "step", "gain")
"""Objectives: the last wanted demand, its last step, and the norm of the output over all samples."""


@dataclass(frozen=True)
class LimitedHistory:
    """Loop with a limited demand.

    Attributes
    ----------
    loop : StateSpace, from [p; w] to [u; z], as ``limited_loop`` makes it with kappa inf and a closed Δ
        p = 2 q − u, where q is the excess of u over its limit.
    u_max : float, limit of u [input unit]
    """

    loop: StateSpace
    u_max: float

    def run(self, w: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Wanted demand u (T,) and output z (T, p) for the input w (T, m), from rest."""
        G = self.loop
        x, u, z = np.zeros(G.order), np.empty(len(w)), np.empty((len(w), G.n_outputs - 1))
        for k, now in enumerate(w):
            demand = float(G.C[0] @ x)
            inputs = np.concatenate([[self._cut(demand)], now])
            u[k], z[k] = demand, G.C[1:] @ x + G.D[1:] @ inputs
            x = G.A @ x + G.B @ inputs
        return u, z

    def gradient(self, u: np.ndarray, by_u: np.ndarray, by_z: np.ndarray) -> np.ndarray:
        """Derivative (T, m) of an objective by the input, along the run with the demand u (T,).

        ``by_u`` (T,) and ``by_z`` (T, p) are the derivatives of the objective by demand and output.
        """
        G = self.loop
        costate, out = np.zeros(G.order), np.empty((len(u), G.n_inputs - 1))
        for k in range(len(u) - 1, -1, -1):
            back = G.B.T @ costate + G.D[1:].T @ by_z[k]
            of_p = 1.0 if abs(u[k]) > self.u_max else -1.0
            costate = G.A.T @ costate + G.C[1:].T @ by_z[k] + G.C[0] * (by_u[k] + of_p * back[0])
            out[k] = back[1:]
        return out

    def furthest(self, aim: str, size: float, start: np.ndarray) -> tuple[float, np.ndarray]:
        """Largest value of the objective ``aim`` over inputs of norm ``size``, and its input (T, m).

        ``aim`` is one of AIMS: |demand|, |step| or ‖z‖/‖w‖. The search begins at ``start`` (T, m).
        """
        best, best_input = -np.inf, start
        w = size * start / np.linalg.norm(start)
        for _ in range(CLIMBS):
            u, z = self.run(w)
            value = _aimed(aim, u, z, size)
            if value <= best * (1 + 1e-5):
                break
            best, best_input = value, w
            by_u, by_z = np.zeros(len(u)), np.zeros_like(z)
            if aim == "gain":
                by_z = z
            else:
                by_u[-1] = 1.0  # an input and its negative drive the loop equally far
                if aim == "step":
                    by_u[-2] = -1.0
            slope = self.gradient(u, by_u, by_z)
            w = size * slope / np.linalg.norm(slope)
        return float(best), best_input

    def _cut(self, u: float) -> float:
        return 2 * (u - min(max(u, -self.u_max), self.u_max)) - u


def _last(aim: str, u: np.ndarray) -> float:
    return float(u[-1] if aim == "demand" else u[-1] - u[-2])


def _aimed(aim: str, u: np.ndarray, z: np.ndarray, size: float) -> float:
    return float(np.linalg.norm(z)) / size if aim == "gain" else abs(_last(aim, u))
