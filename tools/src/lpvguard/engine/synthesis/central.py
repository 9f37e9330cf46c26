"""Central controller at a level γ from the two Riccati solutions, and the coupling of the two solutions."""

import numpy as np
import scipy.linalg as sl

from lpvguard.engine.synthesis.partition import Plant
from lpvguard.engine.synthesis.riccati import RiccatiSolution, Side
from lpvguard.engine.synthesis.statespace import StateSpace


def coupling_margin(control: RiccatiSolution, filter_: RiccatiSolution, gamma: float) -> float:
    """γ²/ρ(XY), or −1 where X or Y is not positive semidefinite because γ is too low."""
    if not (control.definite and filter_.definite):
        return -1.0
    if control.X.size == 0:
        return np.inf
    largest = np.linalg.eigvals(control.X @ filter_.X).real.max()
    return np.inf if largest <= 0 else gamma**2 / largest


def central_controller(P: Plant, gamma: float) -> StateSpace | None:
    """Central controller of a regular plant at level γ, or None below γ_opt.

    See Zhou, Doyle & Glover 1996, theorem 17.1.
    """
    n, m1, p1 = len(P.A), P.B1.shape[1], P.C1.shape[0]
    control, filter_ = Side.regular(P), Side.regular(P.dual)
    found_X, found_Y = control.solve(gamma), filter_.solve(gamma)
    if found_X is None or found_Y is None or not coupling_margin(found_X, found_Y, gamma) > 1:
        return None
    # Division of w by γ makes the level 1. The plant with this w has the solution Y/γ².
    X, Y = found_X.X, found_Y.X / gamma**2
    B1, D11, D21 = P.B1 / gamma, P.D11 / gamma, P.D21 / gamma
    Dc, Dr = np.hstack([D11, P.D12]), np.vstack([D11, D21])
    R = Dc.T @ Dc - np.diag(np.r_[np.ones(m1), np.zeros(P.B2.shape[1])])
    Rt = Dr @ Dr.T - np.diag(np.r_[np.ones(p1), np.zeros(P.C2.shape[0])])
    F = -np.linalg.solve(R, Dc.T @ P.C1 + np.hstack([B1, P.B2]).T @ X)
    L = -np.linalg.solve(Rt, Dr @ B1.T + np.vstack([P.C1, P.C2]) @ Y).T
    inner, outer = P.C2 + D21 @ F[:m1], P.B2 + L[:, :p1] @ P.D12
    Dk = _central_feedthrough(D11, P.D12, D21)
    Bk = np.linalg.solve(np.eye(n) - Y @ X, -L[:, p1:] + outer @ Dk)
    Ck = F[m1:] - Dk @ inner
    Ak = P.A + B1 @ F[:m1] + P.B2 @ F[m1:] - Bk @ inner
    return StateSpace(Ak, Bk, Ck, Dk)


def _central_feedthrough(D11: np.ndarray, D12: np.ndarray, D21: np.ndarray) -> np.ndarray:
    """Feedthrough D_K of the central controller, with σ̄(D11 + D12 D_K D21) < 1. It is 0 where D11 is 0."""
    if not np.any(D11):
        return np.zeros((D12.shape[1], D21.shape[0]))
    m2, p2 = D12.shape[1], D21.shape[0]
    Qz, Ru = sl.qr(D12, mode="full")
    Qw, Ry = sl.qr(D21.T, mode="full")
    inside = Qz.T @ D11 @ Qw
    D1122, D1121, D1112, D1111 = inside[:m2, :p2], inside[:m2, p2:], inside[m2:, :p2], inside[m2:, p2:]
    Dk = -D1121 @ D1111.T @ np.linalg.solve(np.eye(len(D1111)) - D1111 @ D1111.T, D1112) - D1122
    return np.linalg.solve(Ru[:m2], np.linalg.solve(Ry[:p2], Dk.T).T)
