"""Compute the largest tracking error that the certificate allows for a run within the bounds.

If mu is below 1, the worst gain from the normalised inputs of Fig. 1 to W_t e_t is at most 1. This holds at
every frequency and for every Delta within W_Delta. e_t is the difference of the yaw rate from the reference
model's response. It satisfies

    |e_t|^2 <= (|c / W_C|^2 + |w_r / W_wr|^2 + |w_d / W_wd|^2 + |n_r / W_nr|^2 + |n_d / W_nd|^2) / |W_t|^2

with the run's command c, disturbance w and noise n of yaw rate and road-wheel angle. w is the motion of the
same truck without command and controller, on the same road and in the same wind. n is the noise of the
truck's sensors.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ....control.plants import DesignProblem
from ....engine.synthesis.interconnection import PlantWeights
from ....engine.synthesis.statespace import StateSpace
from ....identify.identification import StoredIdentification
from .conduct import STEERING_RADPS, band_rms


@dataclass(frozen=True)
class TrackingBound:
    """Bound of the tracking error from the certificate with these weights."""

    weights: PlantWeights

    @classmethod
    def from_identification(cls, stored: StoredIdentification) -> TrackingBound:
        """Make the bound for designs of an identification; raise InputError if no design is possible."""
        return cls(DesignProblem.from_identification(stored).weights)

    def rms(self, command: np.ndarray, w: np.ndarray, n: np.ndarray, Ts: float, Ts_n: float) -> float:
        """Compute the largest rms error up to STEERING_RADPS [rad/s].

        ``command`` (N,) [rad/s] and disturbance ``w`` (N, 2) [rad/s, rad] have the period ``Ts`` [s]. Noise
        ``n`` (M, 2) has the period ``Ts_n`` [s].
        """
        W = self.weights
        parts = (
            (command, Ts, W.W_C),
            *((column, Ts, weight) for column, weight in zip(w.T, W.W_w, strict=True)),
            *((column, Ts_n, weight) for column, weight in zip(n.T, W.W_n, strict=True)),
        )
        return float(np.sqrt(sum(self._rms(x, step, weight) ** 2 for x, step, weight in parts)))

    def _rms(self, x: np.ndarray, Ts: float, normalised_by: StateSpace) -> float:
        """Contribution of one input, at the frequencies of its own record."""

        def gain(omega: np.ndarray) -> np.ndarray:
            return 1.0 / np.abs(self.weights.W_t.response(omega) * normalised_by.response(omega))[:, 0, 0]

        return band_rms(x, Ts, STEERING_RADPS, gain)
