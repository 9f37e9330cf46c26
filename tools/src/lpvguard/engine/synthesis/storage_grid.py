"""Storage functions P0 + v P1 + P2 / v on a grid of speeds, for the search in lpv_certificate.py."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from lpvguard.engine.synthesis.barrier import Barrier
from lpvguard.engine.synthesis.statespace import StateSpace


def terms(v) -> np.ndarray:
    """Terms (1, v, 1/v) in the last axis, for speeds v [m/s]."""
    v = np.asarray(v, float)
    return np.stack([np.ones_like(v), v, 1 / v], axis=-1)


def slopes(v) -> np.ndarray:
    """Derivatives (0, 1, -1/v²) of ``terms`` in the last axis, for speeds v [m/s]."""
    v = np.asarray(v, float)
    return np.stack([np.zeros_like(v), np.ones_like(v), -1 / v**2], axis=-1)


def refined(nodes: np.ndarray, parts: int) -> np.ndarray:
    """Grid ((K - 1) parts + 1,) that divides each interval of ``nodes`` (K,) into ``parts``."""
    return np.interp(np.arange((len(nodes) - 1) * parts + 1) / parts, np.arange(len(nodes)), nodes)


def parts_in(G: StateSpace, basis: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """[A B], (n, n + m), and [C D], (p, n + m), in the coordinates of ``basis`` (n, n)."""
    return np.linalg.solve(basis, np.hstack([G.A @ basis, G.B])), np.hstack([G.C @ basis, G.D])


def unmoved(parts: list[tuple[np.ndarray, np.ndarray]]) -> Barrier:
    """Barrier with a separate P (n, n) for each of k constant speeds.

    ``parts`` are [A B] (n, n + m) and [C D] (p, n + m) at each speed.
    """
    return Barrier(parts, np.eye(len(parts)), np.eye(len(parts)))


@dataclass(frozen=True)
class StorageGrid:
    """Speeds ``grid`` (k,) [m/s] of a loop sampled at Ts [s].

    ``parts`` are [A B] and [C D] at every speed in the coordinates ``basis`` (n, n). ``units`` (3, 3) defines
    the terms of P in the search as combinations of 1, v and 1 / v that have similar sizes.
    """

    Ts: float
    grid: np.ndarray
    basis: np.ndarray
    parts: list[tuple[np.ndarray, np.ndarray]]
    units: np.ndarray

    @classmethod
    def from_parts(
        cls, Ts: float, grid: np.ndarray, basis: np.ndarray, parts: list[tuple[np.ndarray, np.ndarray]]
    ) -> StorageGrid:
        """Grid with units that give terms of similar sizes."""
        mean, spread = float(grid.mean()), float(np.ptp(grid))
        units = np.array([[1.0, 0, 0], [-mean / spread, 1 / spread, 0], [-1, 0, mean]])
        return cls(Ts, grid, basis, parts, units)

    def fitted(self, values: np.ndarray) -> np.ndarray:
        """Terms (3, n, n) that fit ``values`` (k, n, n) best, by least squares."""
        functions = terms(self.grid) @ self.units.T
        flat = np.linalg.lstsq(functions, values.reshape(len(values), -1), rcond=None)[0]
        return flat.reshape(3, *values.shape[1:])

    def coefficients(self, P: np.ndarray) -> np.ndarray:
        """Coefficients (3, n, n) of 1, v and 1 / v from the terms ``P``."""
        return np.tensordot(self.units.T, P, 1)

    def barrier(self, rate: float) -> Barrier:
        """Barrier of F at every speed, for speeds that rise and that fall by ``rate`` [m/s^2]."""
        now = np.repeat(terms(self.grid) @ self.units.T, 2, axis=0)
        change = slopes(self.grid) @ self.units.T * (rate * self.Ts)
        after = now + np.stack([change, -change], axis=1).reshape(-1, 3)
        return Barrier([part for part in self.parts for _ in range(2)], now, after)
