"""Linear loops whose matrices change from sample to sample: the gain of one history, and its growth.

A history is [x(k+1); z(k)] = S_k [x(k); w(k)], k = 0..T − 1, from rest, with each S_k one of a stack. Its
gain is the largest ‖z‖/‖w‖, ‖·‖ the Euclidean norm over all samples and channels. The bidiagonal iteration of
Golub and Kahan (1965) on the loop and its adjoint finds the input. A simulation of that input measures the
gain. The result is therefore reached, and a lower bound of the largest.
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
"""Points of the vehicle's splines in every interval between nodes."""
STEPS = 8
"""Steps of the bidiagonal iteration, each a simulation forwards and one backwards."""


@dataclass(frozen=True)
class History:
    """History of a loop with varying matrices.

    Attributes
    ----------
    S : ndarray (K, n + p, n + m), each [A B; C D]
    index : ndarray (T,) of int, matrix of each sample
    n : int, number of states
    """

    S: np.ndarray
    index: np.ndarray
    n: int

    @property
    def shape(self) -> tuple[int, int]:
        """(p, m): outputs and inputs."""
        return self.S.shape[1] - self.n, self.S.shape[2] - self.n

    def states(self, w: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """[x; w] of every sample (T, n + m) and z (T, p) of the input w (T, m), from rest."""
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
        """Run the adjoint, and return [λ(k + 1); z(k)] of every sample (T, n + p) and its output (T, m).

        The output is the gradient of ½‖z‖² by w where z (T, p) is the loop's output.
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
        """The gain reached and its input w (T, m), of norm 1; ``start`` (T, m): where the search begins."""
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
            for _ in (0, 1):  # twice: once leaves what rounding makes of nearly parallel vectors
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
        """Factor by which the largest mode grows in a period where the history is one: above 1 the periodic
        loop is unstable."""
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
        """Derivative (T,) of ½‖z‖² by each sample's parameter, for the input w (T, m).

        S has the derivative ``dS`` (K, n + p, n + m) by this parameter.
        """
        x, z = self.states(w)
        x_after, _ = self.costates(z)
        out = np.empty(len(w))
        for k, i in enumerate(self.index):
            out[k] = x_after[k] @ (dS[i] @ x[k])
        return out


class OverSpeed:
    """Matrices of a family of loops at any speed.

    They are affine between the family's nodes, except for the vehicle's rows, which cubic splines follow.

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
        """S (K, n + p, n + m) at ``speeds`` (K,) [m/s] within the nodes."""
        k, share = self._place(speeds)
        S = self.at_nodes[k] + share[:, None, None] * (self.at_nodes[k + 1] - self.at_nodes[k])
        S[:, self.rows] = self._spline(speeds)
        return S

    def derivative(self, speeds: np.ndarray) -> np.ndarray:
        """dS/dv (K, n + p, n + m); at a node that of the interval that begins there."""
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
    """Close Δ around the first outputs and inputs of a stack.

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
        If one of these inputs acts on such an output at once.
    """
    q, r = delta.n_inputs, delta.n_outputs
    eta, xi = slice(n, n + q), slice(n, n + r)
    if S[:, eta, xi].any():
        raise SynthesisError("loop", "Δ's channels", "a direct term", "none: Δ is closed sample by sample")
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
    """Build sign (c − s)/(c + s) under Tustin's map, of gain 1 at every frequency for a sign of 1 or −1.

    Parameters
    ----------
    sign : float
    corner : float, rad/s, inf: the constant ``sign``
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
    """Find the history of places with the largest sum of slope times place, by dynamic programming.

    Parameters
    ----------
    slope : ndarray (T,)
    moves : int, largest change a sample
    places : int, number of places

    Returns
    -------
    ndarray (T,) of int, in 0..places − 1
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
