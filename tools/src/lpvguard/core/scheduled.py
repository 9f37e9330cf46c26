"""A gain-scheduled controller with fixed poles, as in the core (lib/include/lpvguard/controller.h).

    K(z, v) = c(z)' B(v),    c(z) = C (z I - A)^-1 with A, C constant

Only B depends on speed, linearly between nodes. The states have the same meaning at every speed. The response
at a constant speed is exactly the linear interpolation of the responses at the two nodes. A is block diagonal
of pairs of poles in delta-operator observer form [[1 + a, 1], [a', 1]] (Middleton and Goodwin 1990). Two real
poles can become a complex pair without a jump in a and a'. C needs no multiplication.
"""

from __future__ import annotations

import hashlib
from dataclasses import dataclass

import numpy as np
import scipy.linalg as sl

from ..engine.synthesis.statespace import StateSpace


@dataclass(frozen=True)
class Scheduled:
    """Strictly proper discrete-time controllers over speed, one per demand.

    x+ = A x + B(v) m + L(v) (u - C x), u = C x, with the measurement m = [reference, outputs].

    Attributes
    ----------
    Ts : float, s
    speeds : ndarray (G,), m/s, equally spaced
    a : ndarray (n,)
        First columns of the pairs in A - I, then the column of a single state if n is odd; equal for every
        demand.
    B : ndarray (G, n_u, n, 1 + n_y)
    L : ndarray (G, n_u, n, n_u)
    u_max : ndarray (G, n_u), largest |demand| [input unit]
    """

    Ts: float
    speeds: np.ndarray
    a: np.ndarray
    B: np.ndarray
    L: np.ndarray
    u_max: np.ndarray

    @classmethod
    def read(cls, document: dict) -> Scheduled:
        """Controller of a controller.json document."""
        arrays = (np.array(document[key], float) for key in ("speeds", "a", "B", "L", "u_max"))
        return cls(document["Ts_s"], *arrays)

    def digest(self) -> str:
        """SHA-256 over every coefficient; a certificate refers to its controller by this hash."""
        arrays = (np.array(self.Ts), self.speeds, self.a, self.B, self.L, self.u_max)
        return hashlib.sha256(b"".join(np.ascontiguousarray(x, "<f8").tobytes() for x in arrays)).hexdigest()

    @property
    def order(self) -> int:
        """Number of states of all demands together."""
        return self.B.shape[1] * len(self.a)

    def at(self, v: float) -> StateSpace:
        """Controller of the core at speed v, with interpolated float32 coefficients and A - I in double."""
        A, C = self._constant()
        B = self._rows(self.B, v)
        return StateSpace(A, B, C, np.zeros((len(C), B.shape[1])), self.Ts)

    def injection(self, v: float) -> np.ndarray:
        """L (order, n_u) at speed v."""
        return self._rows(self.L, v)

    def injection_radius(self, v: float) -> float:
        """Spectral radius of A - L C at speed v."""
        A, C = self._constant()
        return float(np.abs(np.linalg.eigvals(A - self.injection(v) @ C)).max())

    def limit(self, v: float) -> np.ndarray:
        """Largest |demand| (n_u,) at speed v."""
        return self._between(self.u_max, v)

    def _constant(self) -> tuple[np.ndarray, np.ndarray]:
        """A and C of all demands."""
        A, c = realisation(self.a.astype(np.float32).astype(float))
        n_u = self.B.shape[1]
        return np.kron(np.eye(n_u), A), np.kron(np.eye(n_u), c)

    def _rows(self, values: np.ndarray, v: float) -> np.ndarray:
        """Rows (order, columns) of B or L at speed v."""
        return self._between(values, v).reshape(self.order, -1)

    def _between(self, values: np.ndarray, v: float) -> np.ndarray:
        """Interpolate values (G, ...) at the nodes to speed v."""
        position = np.clip((v - self.speeds[0]) / (self.speeds[-1] - self.speeds[0]), 0.0, 1.0) * (
            len(self.speeds) - 1
        )
        k = min(int(position), len(self.speeds) - 2)
        rounded = values[k : k + 2].astype(np.float32).astype(float)
        return (1 - (position - k)) * rounded[0] + (position - k) * rounded[1]


def realisation(a: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """A (n, n) and C (1, n) of one demand's states: pairs, and a single state if n is odd."""
    n = len(a)
    A, heads = np.eye(n), np.arange(0, n, 2)
    A[np.arange(n), np.arange(n) // 2 * 2] += a
    A[heads[: n // 2], heads[: n // 2] + 1] = 1.0
    return A, np.isin(np.arange(n), heads)[None].astype(float)


def engagement(a: np.ndarray, B: np.ndarray) -> np.ndarray:
    """Matrix E (n, 2) that sets the demand at engagement (bumpless transfer); a (n,), B (n_u, n, m).

    After the change x += E (u - C x, -(C (A x + B m) - C x)) this demand and the next one equal u. The change
    is the most likely one. It is the smallest such change in the metric of the covariance of x. This
    covariance assumes white m of equal size at all speeds. If no state can give both demands, the second
    condition is left out. Raises LinAlgError unless the poles are stable.
    """
    A, c = realisation(a)
    if np.abs(np.linalg.eigvals(A)).max() >= 1:
        raise np.linalg.LinAlgError("a pole on or outside the unit circle")
    drive = np.moveaxis(B, 2, 0).reshape(len(a), -1)
    size = np.linalg.norm(drive, axis=1)
    P = sl.solve_discrete_lyapunov(A, drive @ drive.T) if size.any() else np.eye(len(a))
    M = np.vstack([c, c @ (A - np.eye(len(a)))])
    first = P @ c.T / (c @ P @ c.T)
    rest = M[1] - M[1] @ first * c  # remainder of the second condition when the first one is met
    left = (rest @ P @ rest.T).item()
    if left <= 1e-9 * (M[1] @ P @ M[1]):
        return np.hstack([first, np.zeros_like(first)])
    second = P @ rest.T / left
    return np.hstack([first - second * (M[1] @ first), second])
