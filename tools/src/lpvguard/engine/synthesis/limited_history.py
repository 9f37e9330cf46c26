"""The loop of saturation.py with its limit, and the inputs of given size that drive it furthest.

Furthest means the largest wanted demand, its largest step, or the largest output.

For a given input each sample is either within the limit or beyond it. The run's derivative by the input is
therefore a linear loop that varies, and its adjoint costs one run. Repeating w = size · gradient / ‖gradient‖
climbs. The result was simulated, so it is reached.
"""

from dataclasses import dataclass

import numpy as np

from lpvguard.engine.synthesis.statespace import StateSpace

CLIMBS = 12
"""Repetitions at most."""
AIMS = ("demand", "step", "gain")
"""Objectives: the last wanted demand, its last step, and the output's norm over all samples."""


@dataclass(frozen=True)
class LimitedHistory:
    """Loop with a limited demand.

    Attributes
    ----------
    loop : StateSpace, from [p; w] to [u; z], sector's middle closed (limited_loop, kappa inf, Δ closed)
        p = 2 q − u, with q the excess of u over its limit.
    u_max : float, limit of u [input unit]
    """

    loop: StateSpace
    u_max: float

    def run(self, w: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Wanted demand u (T,) and z (T, p) of w (T, m), from rest."""
        G = self.loop
        x, u, z = np.zeros(G.order), np.empty(len(w)), np.empty((len(w), G.n_outputs - 1))
        for k, now in enumerate(w):
            demand = float(G.C[0] @ x)
            inputs = np.concatenate([[self._cut(demand)], now])
            u[k], z[k] = demand, G.C[1:] @ x + G.D[1:] @ inputs
            x = G.A @ x + G.B @ inputs
        return u, z

    def gradient(self, u: np.ndarray, by_u: np.ndarray, by_z: np.ndarray) -> np.ndarray:
        """Derivative (T, m) by the input along the run with the demand u (T,). ``by_u`` (T,), ``by_z`` (T,
        p): derivatives by demand and output."""
        G = self.loop
        costate, out = np.zeros(G.order), np.empty((len(u), G.n_inputs - 1))
        for k in range(len(u) - 1, -1, -1):
            back = G.B.T @ costate + G.D[1:].T @ by_z[k]
            of_p = 1.0 if abs(u[k]) > self.u_max else -1.0
            costate = G.A.T @ costate + G.C[1:].T @ by_z[k] + G.C[0] * (by_u[k] + of_p * back[0])
            out[k] = back[1:]
        return out

    def furthest(self, aim: str, size: float, start: np.ndarray) -> tuple[float, np.ndarray]:
        """The largest |demand|, |step| or ‖z‖/‖w‖ reached by an input of norm ``size``, and that input (T,
        m). ``aim``: of AIMS. ``start`` (T, m): where the climb begins."""
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
