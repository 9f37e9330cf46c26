"""Gain and growth of a linear loop whose matrices change from sample to sample.

A history is [x(k+1); z(k)] = S_k [x(k); w(k)], k = 0..T − 1, from rest. Each S_k is one matrix of a stack.
The gain of a history is the largest ‖z‖/‖w‖, with the Euclidean norm over all samples and channels. The
bidiagonal iteration of Golub and Kahan (1965) on the loop and its adjoint finds an input. A simulation of
this input measures its gain. The result is therefore a lower bound of the gain of the history.
"""

from dataclasses import dataclass

import numpy as np
from scipy.interpolate import CubicSpline
from scipy.ndimage import maximum_filter1d

from lpvguard.engine.synthesis.errors import SynthesisError
from lpvguard.engine.synthesis.lpv_certificate import Family
from lpvguard.engine.synthesis.statespace import StateSpace, gain, to_discrete
from lpvguard.engine.synthesis.storage_grid import refined

PARTS = 16
"""Number of intervals of the vehicle's splines between two nodes."""
STEPS = 8
"""Steps of the bidiagonal iteration. Each step is one forward and one backward simulation."""


@dataclass(frozen=True)
class History:
    """History of a loop with varying matrices.

    Attributes
    ----------
    S : ndarray (K, n + p, n + m), each [A B; C D]
    index : ndarray (T,) of int, index of the matrix in S for each sample
    n : int, number of states
    """

    S: np.ndarray
    index: np.ndarray
    n: int

    @property
    def shape(self) -> tuple[int, int]:
        """Numbers (p, m) of outputs and inputs."""
        return self.S.shape[1] - self.n, self.S.shape[2] - self.n

    def states(self, w: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Simulate the input w (T, m) from rest, and return [x; w] (T, n + m) and z (T, p) of all samples."""
        n = self.n
        both, z = np.zeros((len(w), self.S.shape[2])), np.empty((len(w), self.shape[0]))
        both[:, n:] = w
        matrices = list(self.S)
        last = len(w) - 1
        for k, i in enumerate(self.index.tolist()):
            after = matrices[i] @ both[k]
            z[k] = after[n:]
            if k < last:
                both[k + 1, :n] = after[:n]
        return both, z

    def costates(self, z: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Simulate the adjoint loop, and return [λ(k + 1); z(k)] (T, n + p) and its output (T, m).

        If z (T, p) is the output of the loop, the output of the adjoint is the gradient of ½‖z‖² by w.
        """
        n = self.n
        both, w = np.zeros((len(z), self.S.shape[1])), np.empty((len(z), self.shape[1]))
        both[:, n:] = z
        matrices = [matrix.T for matrix in self.S]
        index = self.index.tolist()
        for k in range(len(z) - 1, -1, -1):
            before = matrices[index[k]] @ both[k]
            w[k] = before[n:]
            if k:
                both[k - 1, :n] = before[:n]
        return both, w

    def gain(self, start: np.ndarray, steps: int = STEPS) -> tuple[float, np.ndarray]:
        """Lower bound of the gain, and its input w (T, m) of norm 1.

        The search begins at ``start`` (T, m).
        """
        shape = start.shape
        right: list[np.ndarray] = [start.ravel() / np.linalg.norm(start)]
        left: list[np.ndarray] = []
        alpha, beta = [], []
        for _ in range(steps):
            u = self.states(right[-1].reshape(shape))[1].ravel()
            u -= sum((float(u @ q) * q for q in left), np.zeros_like(u))
            alpha.append(float(np.linalg.norm(u)))
            if not alpha[-1] > 0:
                return 0.0, start / np.linalg.norm(start)
            left.append(u / alpha[-1])
            v = self.costates(left[-1].reshape(len(start), -1))[1].ravel()
            for _ in (0, 1):  # twice, because of rounding with nearly parallel vectors
                v -= sum(float(v @ q) * q for q in right)
            beta.append(float(np.linalg.norm(v)))
            if not beta[-1] > 1e-12 * alpha[0]:
                break
            right.append(v / beta[-1])
        size = len(alpha)
        B = np.diag(alpha) + np.diag(beta[: size - 1], 1)
        w = (np.linalg.svd(B)[2][0] @ right[:size]).reshape(shape)
        w /= np.linalg.norm(w)
        return float(np.linalg.norm(self.states(w)[1])), w

    def growth(self) -> float:
        """Growth factor of the fastest mode over one period, if the history is one period of a periodic loop.

        The periodic loop is unstable if the factor is above 1.
        """
        n = self.n
        A = np.ascontiguousarray(self.S[:, :n, :n])
        X, size = np.eye(n), 0.0
        for i in self.index:
            X = A[i] @ X
            norm = np.abs(X).max()
            if norm > 1e100:
                X, size = X / norm, size + np.log(norm)
        return float(np.exp(min(np.log(np.abs(np.linalg.eigvals(X)).max()) + size, 700.0)))

    def slopes(self, dS: np.ndarray, w: np.ndarray) -> np.ndarray:
        """Derivative (T,) of ½‖z‖² by a parameter of each sample, for the input w (T, m).

        ``dS`` (K, n + p, n + m) is the derivative of S by this parameter.
        """
        x, z = self.states(w)
        x_after, _ = self.costates(z)
        out = np.empty(len(w))
        for k, i in enumerate(self.index):
            out[k] = x_after[k] @ (dS[i] @ x[k])
        return out


class OverSpeed:
    """Matrices of a family of loops at any speed.

    They are affine in the speed between the family's nodes. Cubic splines approximate the vehicle's rows.

    Parameters
    ----------
    family : Family
    """

    def __init__(self, family: Family):
        self.nodes = np.asarray(family.nodes, float)
        grid = refined(self.nodes, PARTS)
        loops = [_whole(family, float(v)) for v in grid]
        self.n = family.at(float(self.nodes[0])).order
        self.rows = family.vehicle
        self.at_nodes = np.array(loops[::PARTS])
        self._spline = CubicSpline(grid, np.array([S[self.rows] for S in loops]))

    def at(self, speeds: np.ndarray) -> np.ndarray:
        """Matrices S (K, n + p, n + m) at ``speeds`` (K,) [m/s] between the first and last node."""
        k, share = self._place(speeds)
        S = self.at_nodes[k] + share[:, None, None] * (self.at_nodes[k + 1] - self.at_nodes[k])
        S[:, self.rows] = self._spline(speeds)
        return S

    def derivative(self, speeds: np.ndarray) -> np.ndarray:
        """Derivatives dS/dv (K, n + p, n + m) at ``speeds`` (K,).

        At a node they are those of the interval above it.
        """
        k, _ = self._place(speeds)
        width = np.diff(self.nodes)[k]
        dS = (self.at_nodes[k + 1] - self.at_nodes[k]) / width[:, None, None]
        dS[:, self.rows] = self._spline(speeds, 1)
        return dS

    def _place(self, speeds: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        if not ((speeds >= self.nodes[0]) & (speeds <= self.nodes[-1])).all():
            raise SynthesisError(
                "loop over speed",
                "speeds",
                f"{np.min(speeds):g} to {np.max(speeds):g} m/s",
                f"{self.nodes[0]:g} to {self.nodes[-1]:g} m/s",
            )
        k = np.clip(np.searchsorted(self.nodes, speeds, side="right") - 1, 0, len(self.nodes) - 2)
        return k, (speeds - self.nodes[k]) / np.diff(self.nodes)[k]


def _whole(family: Family, v: float) -> np.ndarray:
    G = family.loop(v)
    return np.block([[G.A, G.B], [G.C, G.D]])


def close(S: np.ndarray, n: int, delta: StateSpace) -> np.ndarray:
    """Close Δ around the first outputs and inputs of each matrix of a stack.

    Parameters
    ----------
    S : ndarray (K, n + p, n + m)
    n : int, number of states
    delta : StateSpace

    Returns
    -------
    ndarray (K, n + n_Δ + p', n + n_Δ + m'), with p' and m' the remaining signals

    Raises
    ------
    SynthesisError
        If the loop has a direct term from an output of Δ to an input of Δ.
    """
    q, r = delta.n_inputs, delta.n_outputs
    eta, xi = slice(n, n + q), slice(n, n + r)
    if S[:, eta, xi].any():
        raise SynthesisError(
            "loop", "Δ's channels", "a direct term", "no direct term from Δ's output to Δ's input"
        )
    rest_rows, rest_columns = np.r_[:n, n + q : S.shape[1]], np.r_[:n, n + r : S.shape[2]]
    inner, out = S[:, rest_rows][:, :, rest_columns], S[:, rest_rows][:, :, xi]
    into = S[:, eta][:, :, rest_columns]
    closed = inner + out @ delta.D @ into
    held = np.broadcast_to(delta.A, (len(S), *delta.A.shape))
    return np.block(
        [
            [closed[:, :n, :n], out[:, :n] @ delta.C, closed[:, :n, n:]],
            [delta.B @ into[:, :, :n], held, delta.B @ into[:, :, n:]],
            [closed[:, n:, :n], out[:, n:] @ delta.C, closed[:, n:, n:]],
        ]
    )


def all_pass(sign: float, corner: float, dt: float) -> StateSpace:
    """Build the discrete image of sign (c − s)/(c + s), whose gain is |sign| at every frequency.

    Parameters
    ----------
    sign : float
    corner : float, rad/s, c; inf gives the constant ``sign``
    dt : float, s

    Returns
    -------
    StateSpace
    """
    if np.isinf(corner):
        return gain([[sign]], dt)
    continuous = StateSpace(
        np.array([[-corner]]), np.ones((1, 1)), np.array([[2 * corner * sign]]), np.array([[-sign]])
    )
    return to_discrete(continuous, dt)


def steered(slope: np.ndarray, moves: int, places: int) -> np.ndarray:
    """Find the sequence of places with the largest sum of slope times place, by dynamic programming.

    Parameters
    ----------
    slope : ndarray (T,)
    moves : int, largest change of the place from sample to sample
    places : int, number of places

    Returns
    -------
    ndarray (T,) of int, from 0 to places − 1
    """
    at, reach = np.arange(places), 2 * moves + 1
    best = np.empty((len(slope), places), np.float32)
    ahead = np.zeros(places)
    for k in range(len(slope) - 1, -1, -1):
        now = slope[k] * at + ahead
        now -= now.max()
        best[k] = now
        ahead = maximum_filter1d(now, reach, mode="nearest")
    out = np.empty(len(slope), int)
    out[0] = int(np.argmax(best[0]))
    for k in range(1, len(slope)):
        low = max(out[k - 1] - moves, 0)
        out[k] = low + int(np.argmax(best[k, low : out[k - 1] + moves + 1]))
    return out
