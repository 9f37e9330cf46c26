"""Barrier method for the linear matrix inequalities of lpv_certificate.py."""

import ctypes

import numpy as np
import scipy.linalg as sl

from lpvguard.base import native

WANTED = 0.02
"""The search at one rate stops at this slack, relative to the slack of the mean of the frozen solutions."""
NEWTON_STEPS = 40
"""Largest number of Newton steps for one rate."""
NEAR = 25.0
"""Below this Newton decrement an iterate is near the central path, and the search moves along the path."""


class Barrier:
    """Barrier of the inequalities F_i(P) > 0: value and derivatives of log det F_i.

        F_i(P) = E' (sum_k phi_ik P_k) E - M_i' (sum_k next_ik P_k) M_i - N_i' N_i + diag(0, I)

    ``parts`` holds (M, N) per i. ``phi`` and ``next`` have the shape (count, terms). P (terms, n, n) is
    symmetric. As a vector it holds its upper triangles row by row. M is near E where sampling is fast. All
    terms are therefore computed from D = M - E and phi - next. Slow states have a large P, and products of M
    would lose their digits to rounding.
    """

    def __init__(self, parts: list[tuple[np.ndarray, np.ndarray]], phi: np.ndarray, next_: np.ndarray):
        M, N = (np.array([part[k] for part in parts]) for k in (0, 1))
        self.n, width = M.shape[1:]
        self.D = M - np.eye(self.n, width)
        self.next, self.moved = np.ascontiguousarray(next_), np.ascontiguousarray(phi - next_)
        self.constant = -np.swapaxes(N, 1, 2) @ N
        self.constant[:, self.n :, self.n :] += np.eye(width - self.n)
        self.upper = np.triu_indices(self.n)
        self.twice = np.where(self.upper[0] == self.upper[1], 1.0, 2.0)

    def F(self, P: np.ndarray, constant: bool = True) -> np.ndarray:
        """Every F_i(P), (count, N, N), for P (terms, n, n). ``constant`` False: only the part linear in P."""
        n, after = self.n, np.tensordot(self.next, P, 1)
        over = np.swapaxes(after @ self.D, 1, 2)  # D' P
        out = -over @ self.D
        out[:, :, :n] -= over
        out[:, :n] -= np.swapaxes(over, 1, 2)
        out[:, :n, :n] += np.tensordot(self.moved, P, 1)
        return out + self.constant if constant else out

    def matrices(self, p: np.ndarray) -> np.ndarray:
        """P (terms, n, n) from its vector (terms n (n + 1) / 2,)."""
        p = p.reshape(self.next.shape[1], len(self.twice))
        P = np.zeros((len(p), self.n, self.n))
        P[:, self.upper[0], self.upper[1]] = p
        P[:, self.upper[1], self.upper[0]] = p
        return P

    def adjoint(self, S: np.ndarray) -> np.ndarray:
        """Gradient (size,) of sum_i tr(S_i F_i(P)) by the vector of P, for symmetric S (count, N, N)."""
        x, y, z = self._sides(S)
        G = np.einsum("ik,iab->kab", self.moved, x) - np.einsum(
            "ik,iab->kab", self.next, y + np.swapaxes(y, 1, 2) + z
        )
        return self._vector(G)

    def price(self, cost: np.ndarray) -> np.ndarray:
        """Gradient (size,) of sum_i tr(cost sum_k phi_ik P_k) by the vector of P, with ``cost`` (n, n)."""
        return self._vector(np.einsum("ik,ab->kab", self.next + self.moved, cost))

    def _vector(self, G: np.ndarray) -> np.ndarray:
        """Derivative by the vector of P, from the symmetric derivative G (terms, n, n) by P."""
        return (G[:, self.upper[0], self.upper[1]] * self.twice).ravel()

    def hessian(self, S: np.ndarray) -> np.ndarray:
        """Lower triangle of the Hessian (size, size) of -sum_i log det F_i, from S_i = F_i^-1.

        S is (count, N, N).
        """
        x, y, z = self._sides(S)
        transposed = np.swapaxes(y, 1, 2)
        both, half = x + y + transposed + 0.5 * z, x + 0.5 * y
        matrices = [
            np.ascontiguousarray(m)
            for m in (x, y, transposed, z, both, half, np.swapaxes(half, 1, 2), self.moved, self.next)
        ]
        terms = self.next.shape[1]
        size = terms * len(self.twice)
        H = np.zeros((size, size))
        native.kernels("lyapunov_barrier").lpvg_lyapunov_hessian(
            *(ctypes.c_ssize_t(count) for count in (self.n, len(S), terms)),
            *map(native.pointer, (*matrices, H)),
        )
        return H

    def _sides(self, S: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """E S E', D S E' and D S D', each (count, n, n)."""
        over = self.D @ S
        return S[:, : self.n, : self.n], over[:, :, : self.n], over @ np.swapaxes(self.D, 1, 2)

    def solved(self, S: np.ndarray, right: np.ndarray) -> np.ndarray:
        """Solution X of Hessian X = ``right`` (size, k), with the Hessian at S_i = F_i^-1."""
        H = self.hessian(S)
        scale = 1 / np.sqrt(np.diagonal(H))
        H *= scale
        H *= scale[:, None]
        return sl.cho_solve(factored(H), right * scale[:, None], check_finite=False) * scale[:, None]


def feasible(barrier: Barrier, P: np.ndarray, unit: np.ndarray) -> np.ndarray | None:
    """Search for P with every F_i > 0, from any P.

    Newton's method minimises ``tau t - sum_i log det(F_i + t unit)`` until t < -``WANTED``. It takes at most
    ``NEWTON_STEPS`` steps. It returns the last P with t < 0, or None if there is none. ``unit`` (N, N) > 0 is
    the unit of F.
    """
    size = len(barrier.constant) * len(unit)
    L = np.linalg.inv(np.linalg.cholesky(unit))
    t = 1.05 * max(-float(np.linalg.eigvalsh(L @ barrier.F(P) @ L.T).min()), 1e-3)
    tau, solution = 2.0 * size, None
    price = np.zeros(P.shape[0] * len(barrier.twice))
    for _ in range(NEWTON_STEPS):
        try:
            y = np.array([t])
            P, (t,), decrement = newton_step(barrier, P, y, unit[None, None], np.array([tau]), price)
        except np.linalg.LinAlgError:
            return solution
        if t < 0:
            solution = P
        if t < -WANTED or (decrement < 1.0 and abs(t) > 2 * size / tau):
            return solution  # t is small enough, or it cannot become much smaller
        if decrement < NEAR:
            tau *= 10.0
    return solution


def newton_step(
    barrier: Barrier,
    P: np.ndarray,
    y: np.ndarray,
    directions: np.ndarray,
    slope: np.ndarray,
    price: np.ndarray,
) -> tuple[np.ndarray, np.ndarray, float]:
    """One step of Newton's method: the new P and y, and the Newton decrement.

    The objective is ``price p + slope y - sum_i log det(F_i(P) + sum_j y_j directions_ji)``, where p is the
    vector of P. The shapes are ``price`` (size,), ``slope`` (k,) and ``directions`` (k, count or 1, N, N).
    Raises LinAlgError where rounding exceeds the remaining decrement.
    """
    F = barrier.F(P) + np.tensordot(y, directions, 1)
    L = np.linalg.inv(np.linalg.cholesky(F))
    S = np.swapaxes(L, 1, 2) @ L
    crossed = [S @ direction @ S for direction in directions]
    g = price - barrier.adjoint(S)
    k = len(y)
    g_y = slope - np.array([np.sum(S * direction) for direction in directions]).reshape(k)
    h = np.array([barrier.adjoint(cross) for cross in crossed]).reshape(k, len(g)).T
    h_y = np.array([[np.sum(cross * direction) for direction in directions] for cross in crossed])
    solved = barrier.solved(S, np.column_stack([g, h]))
    d_y = -np.linalg.solve(h_y - h.T @ solved[:, 1:], g_y - h.T @ solved[:, 0])
    d_p = -solved[:, 0] - solved[:, 1:] @ d_y
    d_P = barrier.matrices(d_p)
    d_F = barrier.F(d_P, constant=False) + np.tensordot(d_y, directions, 1)
    curve = np.linalg.eigvalsh(L @ d_F @ np.swapaxes(L, 1, 2))
    length = line_search(curve.ravel(), float(price @ d_p + slope @ d_y))
    return P + length * d_P, y + length * d_y, float(-(g @ d_p + g_y @ d_y))


def factored(H: np.ndarray):
    """SciPy's Cholesky factor of H (n, n), which has a unit diagonal and a filled lower triangle.

    Adds the least of three numbers to the diagonal that makes H positive definite in spite of rounding.
    Raises LinAlgError where none is enough.
    """
    for extra in (1e-13, 1e-11, 1e-9):
        np.fill_diagonal(H, 1 + extra)
        try:
            return sl.cho_factor(H, lower=True, check_finite=False)
        except np.linalg.LinAlgError:
            pass
    raise np.linalg.LinAlgError("not positive definite")


def line_search(curve: np.ndarray, slope: float) -> float:
    """Minimiser over s >= 0 of slope s - sum log(1 + s curve), by safeguarded Newton steps.

    ``curve`` is (n,).
    """
    end = -1 / curve.min() if curve.min() < 0 else np.inf
    s = min(1.0, 0.9 * end)
    for _ in range(30):
        ratio = curve / (1 + s * curve)
        newton = s - (slope - ratio.sum()) / np.sum(ratio**2)
        new = float(np.clip(newton, 0.1 * s, s + 0.9 * (end - s) if np.isfinite(end) else 10 * s))
        if abs(new - s) <= 1e-3 * s:
            break
        s = new
    return s
