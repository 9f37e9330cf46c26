"""A vehicle for tests of what moves with the speed: a damped oscillator whose stiffness follows it."""

import numpy as np
from scipy.linalg import expm


class Oscillator:
    """A(v) = [[0, 1], [-(1 + turn (v - 1)), -0.6]], B = [0, 1], sampled at Ts [s] with the force held; v in
    m/s."""

    def __init__(self, turn: float, Ts: float):
        self.turn, self.Ts = turn, Ts

    def hold(self, v: float) -> np.ndarray:
        """[A B] of a sample, (2, 3), above a row [0 0 1]."""
        return expm(self._continuous(v) * self.Ts)

    def bounds(self, low: float, high: float) -> tuple[np.ndarray, np.ndarray]:
        """Bounds (2, 3) of the first and the second derivative of ``hold`` by v, for speeds of low..high."""
        slope = np.zeros((3, 3))
        slope[1, 0] = self.turn
        size, zero = np.abs(self._continuous(high)), np.zeros((3, 3))
        series = expm(np.block([[size, slope, zero], [zero, size, slope], [zero, zero, size]]) * self.Ts)
        return series[:2, 3:6], 2 * series[:2, 6:]

    def _continuous(self, v: float) -> np.ndarray:
        return np.array([[0.0, 1.0, 0.0], [-1.0 - self.turn * (v - 1), -0.6, 1.0], [0, 0, 0]])
