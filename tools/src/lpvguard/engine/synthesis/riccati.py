"""The two Riccati equations of H∞ synthesis at a level γ (Zhou, Doyle & Glover 1996, section 17.1).

One equation belongs to the control side of the plant, the other to its filter side, which is the control side
of the dual plant. The stabilising solution comes from the stable invariant subspace of a balanced
Hamiltonian. Where nearly free controls make this solution inaccurate, it comes from the extended pencil.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

import numpy as np
import scipy.linalg as sl

from lpvguard.engine.synthesis.direct_terms import unreachable_gain
from lpvguard.engine.synthesis.norms import axis_frequencies
from lpvguard.engine.synthesis.partition import Plant
from lpvguard.engine.synthesis.statespace import EPS, StateSpace

STIFF = 1e4
"""A Hamiltonian larger than this multiple of the plant's A has lost digits because of nearly free
controls."""
CANCELLED = 1e-9
"""A remainder of G11 after cancellation by v counts as rounding if it is below this share of G11."""


class RiccatiSolution(NamedTuple):
    """A stabilising solution ``X`` (n, n), symmetric.

    ``definite``: X is positive semidefinite within rounding.
    """

    X: np.ndarray
    definite: bool


@dataclass(frozen=True)
class Side:
    """One Riccati equation of a problem whose D12 has full column rank.

        x' = A x + B1 w + B2 u,   z = C1 x + D11 w + D12 u

    The columns of ``basis`` (n, n_r) are the states that remain after the removal of free states. The
    solution is basis X_r basisᵀ. ``bound`` is the least γ that D11 and D12 allow (full information). ``axis``
    holds the frequencies in rad/s of zeros on the imaginary axis. ``weight`` is the state cost (times I) that
    moves these zeros off the axis.
    """

    A: np.ndarray
    B1: np.ndarray
    B2: np.ndarray
    C1: np.ndarray
    D11: np.ndarray
    D12: np.ndarray
    basis: np.ndarray
    bound: float = 0.0
    axis: tuple[float, ...] = ()
    weight: float = 0.0

    @staticmethod
    def regular(P: Plant) -> Side:
        """Control side of a plant whose D12 has full column rank and which therefore keeps all states."""
        return Side(
            P.A,
            P.B1,
            P.B2,
            P.C1,
            P.D11,
            P.D12,
            np.eye(len(P.A)),
            unreachable_gain(P.D11, P.D12, np.zeros(P.B2.shape[1])),
        )

    def solve(self, gamma: float) -> RiccatiSolution | None:
        """Stabilising solution (n, n) at ``gamma`` in the plant's coordinates, or None."""
        if gamma <= self.bound * (1 + 1e-12):
            return None
        if len(self.A) == 0:
            return RiccatiSolution(np.zeros((len(self.basis), len(self.basis))), True)
        try:
            solution = stabilising_solution(hamiltonian(self, gamma), self, gamma)
        except np.linalg.LinAlgError:
            return None
        if solution is None:
            return None
        return RiccatiSolution(self.basis @ solution.X @ self.basis.T, solution.definite)

    @cached_property
    def _closed(self) -> StateSpace | None:
        """System [G11 G12] from [w; v] to z with the LQ feedback u = F x + v, or None without such an F."""
        F = stabilising_gain(self.A, self.B2) if self.B2.size and not self.axis else None
        if F is None:
            return None
        B, D = np.hstack([self.B1, self.B2]), np.hstack([self.D11, self.D12])
        return StateSpace(self.A + self.B2 @ F, B, self.C1 + self.D12 @ F, D)

    def frequency_bound(self, level: float | None = None) -> float:
        """Lower bound of γ for every controller, even with full information.

        At each frequency it is σ̄ of the part of G11(jω) that no v cancels through G12(jω). The result is the
        maximum over DC and the frequencies of the poles. With a ``level`` the frequencies are those where the
        bound may cross it (axis eigenvalues of the Hamiltonian), and points between them. The result is 0
        where no gain stabilises the loop.
        """
        G = self._closed
        if G is None:
            return 0.0
        if level is None:
            omega = np.abs(np.concatenate([[0.0], np.linalg.eigvals(self.A), G.poles()]))
        else:
            try:
                H = balance_hamiltonian(hamiltonian(self, level))[0]
            except np.linalg.LinAlgError:  # the level is a singular value of the direct terms
                return 0.0
            omega = axis_frequencies(H, float(np.linalg.norm(self.A, 2)))
        response = G.response(np.unique(omega))
        response = response[np.isfinite(response).all(axis=(1, 2))]
        known, free = np.split(response, [self.B1.shape[1]], axis=2)
        size = np.linalg.norm(free, axis=1, keepdims=True)
        U, sigma, _ = np.linalg.svd(free / np.maximum(size, 1e-300), full_matrices=False)
        sure = sigma[:, -1] > 1e-5  # near a zero of G12 its range is rounding
        U, known = U[sure], known[sure]
        rest = known - U @ (U.conj().swapaxes(1, 2) @ known)
        size, whole = (np.linalg.norm(M, 2, axis=(1, 2)) for M in (rest, known))
        return float(size[size > CANCELLED * whole].max(initial=0.0))


def hamiltonian(side: Side, gamma: float) -> np.ndarray:
    """Hamiltonian (2n, 2n) of the Riccati equation at a γ above the Parrott bound of its D11."""
    n, m1 = len(side.A), side.B1.shape[1]
    B = np.hstack([side.B1 / gamma, side.B2])
    D = np.hstack([side.D11 / gamma, side.D12])
    R = D.T @ D
    R[:m1, :m1] -= np.eye(m1)
    F = np.linalg.solve(R, np.hstack([D.T @ side.C1, B.T]))
    H = np.block([[side.A, np.zeros((n, n))], [-side.C1.T @ side.C1, -side.A.T]])
    left = np.vstack([B, -side.C1.T @ D])
    out = H - left @ F
    # cancelled terms leave rounding, which balancing would amplify
    terms = np.abs(H) + np.abs(left) @ np.abs(F)
    out[np.abs(out) <= 500 * EPS * terms] = 0.0
    out[n:, :n] -= side.weight**2 * np.eye(n)
    return out


def balance_hamiltonian(H: np.ndarray, floor: float = 0.0) -> tuple[np.ndarray, np.ndarray]:
    """Scale H (2n, 2n) by a symplectic diag(t, 1/t) of powers of two (Benner 2001).

    Returns the scaled H and t (n,).

    Entries up to ``floor`` times the largest entry do not influence t.
    """
    n = len(H) // 2
    off = np.abs(H)
    np.fill_diagonal(off, 0)
    off[off <= floor * off.max(initial=0.0)] = 0.0
    with np.errstate(
        invalid="ignore"
    ):  # scipy also converts the scales to row numbers, which fails for large ones
        _, (scale, _) = sl.matrix_balance(off, separate=True, permute=False)
    logs = np.log2(scale)
    t = 2.0 ** np.round(0.5 * (logs[:n] - logs[n:]))
    both = np.concatenate([t, 1 / t])
    return H * both / both[:, None], t


def stabilising_solution(
    H: np.ndarray, side: Side | None = None, gamma: float = np.inf
) -> RiccatiSolution | None:
    """Symmetric solution X = X2 X1⁻¹ (n, n) from the stable invariant subspace of H (2n, 2n).

    It is None where eigenvalues lie on the imaginary axis. The first balancing uses every entry. If X is
    exactly singular, entries that are rounding in place of zeros make X1 nearly singular. A second balancing
    then ignores such entries. Where H is much larger than the A of its ``side`` (nearly free controls), a
    badly conditioned solution is not trusted. The extended pencil at ``gamma`` then decides. It does not
    contain the inverse that made H large.
    """
    best: tuple[RiccatiSolution | None, float] = None, np.inf
    for floor in (0.0, EPS):
        balanced_H, t = balance_hamiltonian(H, floor)
        solution, condition = _subspace_solution(balanced_H, t)
        best = _better(best, (solution, condition))
        if best[1] < 1e10 or condition == 0.0:  # 0: eigenvalues on the axis
            break
    if (
        side is not None
        and best[1] > 1e6
        and np.linalg.norm(balanced_H) > STIFF * np.linalg.norm(side.A * t / t[:, None])
    ):
        for scale in (t, np.ones_like(t)):
            best = _better(best, _pencil_solution(side, gamma, scale))
    return best[0]


def _better(
    best: tuple[RiccatiSolution | None, float], other: tuple[RiccatiSolution | None, float]
) -> tuple[RiccatiSolution | None, float]:
    """``other`` where it is a solution with a smaller condition number, else ``best``."""
    return other if other[0] is not None and other[1] < best[1] else best


def _subspace_solution(H: np.ndarray, t: np.ndarray) -> tuple[RiccatiSolution | None, float]:
    """The solution from one balanced H, and the condition number of X1 (0 with eigenvalues on the axis)."""
    n = len(H) // 2
    T, U, stable = sl.schur(H, sort="lhp", check_finite=False)
    if stable != n or _touches_axis(T):
        return None, 0.0
    speed = np.abs(np.diag(T)).min()  # slowest real part
    return _from_basis(U[:n, :n], U[n:, :n], t, noise=1e2 * EPS * np.linalg.norm(T) / max(speed, EPS))


def _pencil_solution(side: Side, gamma: float, t: np.ndarray) -> tuple[RiccatiSolution | None, float]:
    """The same solution from the extended pencil in (x, λ, [w; u], z) (Van Dooren 1981).

    The pencil does not contain squares of γ and D. An orthogonal transformation eliminates the algebraic
    variables. ``t`` scales x, and 1/t scales λ.
    """
    n, m1, m = len(side.A), side.B1.shape[1], side.B1.shape[1] + side.B2.shape[1]
    p = len(side.C1)
    A, C = side.A * t / t[:, None], side.C1 * t
    B, D = np.hstack([side.B1 / gamma, side.B2]) / t[:, None], np.hstack([side.D11 / gamma, side.D12])
    J = np.diag(np.r_[np.ones(m1), np.zeros(m - m1)])
    Z = np.zeros
    M = np.block(
        [
            [A, Z((n, n)), B, Z((n, p))],
            [-np.diag((side.weight * t) ** 2), -A.T, Z((n, m)), -C.T],
            [C, Z((p, n)), D, -np.eye(p)],
            [Z((m, n)), B.T, -J, D.T],
        ]
    )
    Q = sl.qr(M[:, 2 * n :], mode="full")[0][:, m + p :].T
    try:
        S, _, alpha, beta, _, V = sl.ordqz(Q @ M[:, : 2 * n], Q[:, : 2 * n], sort="lhp", output="real")
    except ValueError:  # eigenvalues of both sides too close to separate
        return None, 0.0
    stable = np.count_nonzero(alpha.real * beta < 0)
    if stable != n or np.any(np.abs(alpha.real) <= 20 * EPS * np.linalg.norm(S) + 1e-11 * np.abs(alpha.imag)):
        return None, 0.0
    speed = np.abs(alpha.real / np.where(beta == 0, EPS, beta)).min()
    return _from_basis(V[:n, :n], V[n:, :n], t, noise=1e2 * EPS * np.linalg.norm(S) / speed)


def _from_basis(
    U1: np.ndarray, U2: np.ndarray, t: np.ndarray, noise: float
) -> tuple[RiccatiSolution | None, float]:
    """X = U2 U1⁻¹ from an orthonormal basis [U1; U2] of the stable subspace.

    X is in the units before the scaling ``t``. ``noise`` is the error of the basis where it is larger than
    rounding.
    """
    condition = float(np.linalg.cond(U1))
    skew = U1.T @ U2
    if (skew - skew.T).max() > 1e-5 or not condition < 1 / EPS:
        return None, condition
    X = np.linalg.solve(U1.T, U2.T)
    X = 0.5 * (X + X.T)
    # in these units U is orthogonal, so X carries an error of about eps · cond(U1) · (1 + ‖X‖)
    values = np.linalg.eigvalsh(X)
    tolerance = min(max(1e4 * EPS, min(noise, 1e-9)) * condition, 0.1)
    definite = values[0] >= -tolerance * (1 + values[-1])
    return RiccatiSolution(X / t / t[:, None], bool(definite)), condition


def _touches_axis(T: np.ndarray) -> bool:
    """Whether an eigenvalue of the real Schur form T is, within rounding, on the imaginary axis."""
    diagonal, sub = np.diag(T), np.diag(T, -1)
    size = np.abs(diagonal)
    imaginary = np.zeros_like(size)
    pairs = np.flatnonzero(sub)
    width = np.sqrt(np.abs(sub[pairs] * T[pairs, pairs + 1]))
    imaginary[pairs] = imaginary[pairs + 1] = width
    return bool(np.any(size <= 20 * EPS * np.linalg.norm(T) + 1e-11 * imaginary))


def stabilising_gain(A: np.ndarray, B: np.ndarray) -> np.ndarray | None:
    """LQ gain F (m, n) with A + B F stable and unit weights in balanced units, or None (always for B = 0)."""
    width = np.linalg.norm(B, 2)
    if width == 0:
        return None
    size, n = np.linalg.norm(A, 2) / width, len(A)
    scaled = size * B
    X = stabilising_solution(np.block([[A, -scaled @ scaled.T], [-np.eye(n), -A.T]]))
    return None if X is None else -size * scaled.T @ X.X
