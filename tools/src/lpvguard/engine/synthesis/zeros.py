"""Zeros of P12 and P21 on the imaginary axis, and the lower bounds of γ that they imply."""

from dataclasses import replace

import numpy as np
from scipy.optimize import minimize_scalar

from lpvguard.engine.synthesis.partition import Plant
from lpvguard.engine.synthesis.riccati import Side, balance_hamiltonian, hamiltonian, stabilising_gain
from lpvguard.engine.synthesis.statespace import StateSpace

ZERO_RTOL = 1e-12
"""Largest ``rank_defect`` at a zero."""


def axis_zeros(side: Side, scale: float) -> tuple[float, ...]:
    """Frequencies of the imaginary-axis zeros of x' = A x + B2 u, z = C1 x + D12 u.

    Candidates are the eigenvalues of its LQ problem on the axis. These are at least double, so rounding moves
    them by the square root of eps times ``scale``, the norm of A. A slow zero may therefore look like one on
    the axis. A candidate is a zero only where the system matrix itself loses rank.
    """
    H = hamiltonian(replace(side, B1=side.B1[:, :0], D11=side.D11[:, :0]), 1.0)
    eigenvalues = np.linalg.eigvals(balance_hamiltonian(H)[0])
    near = np.abs(eigenvalues.real) <= 1e-7 * np.abs(eigenvalues) + 1e-8 * scale
    zeros: list[float] = []
    for omega in np.abs(eigenvalues.imag[near]):
        width = 1e-6 * omega + 1e-7 * scale
        if any(abs(omega - known) <= width for known in zeros):
            continue
        points = [0.0] if omega <= width else []
        points.append(
            minimize_scalar(
                lambda w: rank_defect(side, w),
                bounds=(max(omega - width, 0.0), omega + width),
                method="bounded",
                options={"xatol": 1e-15 * (omega + width)},
            ).x
        )
        best = min(points, key=lambda w: rank_defect(side, w))
        if rank_defect(side, best) <= ZERO_RTOL:
            zeros.append(best)
    return tuple(np.unique(np.round(zeros, 12)))


def rank_defect(side: Side, omega: float) -> float:
    """Relative distance of the system matrix ``[A − jωI, B2; C1, D12]`` from loss of column rank.

    It is the smallest singular value after scaling of the rows and columns to similar size. 0 means that j
    ``omega`` (in rad/s) is a zero.
    """
    M = np.block([[side.A - 1j * omega * np.eye(len(side.A)), side.B2], [side.C1, side.D12]])
    if M.shape[0] < M.shape[1]:
        return 0.0
    for _ in range(8):
        for axis in (1, 0):
            size = np.sqrt(np.abs(M).max(axis=axis, keepdims=True))
            M = M / np.where(size > 0, size, 1)
    return float(np.linalg.svd(M, compute_uv=False)[-1])


def axis_bounds(P: Plant, frequencies: tuple[float, ...]) -> list[float]:
    """Two Parrott bounds at each zero on the imaginary axis, with ``frequencies`` in rad/s.

    All stable closed loops are T11 + T12 Q T21 (Zhou, Doyle & Glover 1996, section 12.8). An LQ gain F and
    its dual L define the factors. At a zero no Q can change part of this sum. A column that vanishes at the
    zero is rounding and still counts as a direction, so a single control gives no bound.
    """
    if not frequencies:
        return []
    n = len(P.A)
    F, L = stabilising_gain(P.A, P.B2), stabilising_gain(P.A.T, P.C2.T)
    if F is None or L is None:
        return []
    L = L.T
    AF, AL, CF, BL = P.A + P.B2 @ F, P.A + L @ P.C2, P.C1 + P.D12 @ F, P.B1 + L @ P.D21
    T11 = StateSpace(
        np.block([[AF, -P.B2 @ F], [np.zeros((n, n)), AL]]),
        np.vstack([P.B1, BL]),
        np.hstack([CF, -P.D12 @ F]),
        P.D11,
    )
    T12, T21 = StateSpace(AF, P.B2, CF, P.D12), StateSpace(AL, BL, P.C2, P.D21)
    out = []
    for G11, G12, G21 in zip(*(T.response(frequencies) for T in (T11, T12, T21)), strict=True):
        for side, free in ((G11, G12), (G11.conj().T, G21.conj().T)):
            U, sigma, _ = np.linalg.svd(free / np.maximum(np.linalg.norm(free, axis=0), 1e-300))
            rank = int(np.count_nonzero(sigma > 1e-5))
            rest = U[:, rank:].conj().T @ side
            out.append(float(np.linalg.norm(rest, 2)) if rest.size else 0.0)
    return out
