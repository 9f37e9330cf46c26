"""Direct terms of a generalised plant: rank of D12 and D21, and the part of D11 that no controller can
cancel."""

import numpy as np
import scipy.linalg as sl

from lpvguard.engine.synthesis.partition import Plant

RANK_RTOL = 1e-9
"""Singular values of a column-scaled D12 (row-scaled D21) below this count as zero."""


def direct_scale(rate: float, B2: np.ndarray, C1: np.ndarray) -> np.ndarray:
    """Size (m2,) of each control's path to the cost through states of ``rate`` [rad/s].

    A direct cost far below this size counts as zero.
    """
    return np.linalg.norm(B2, axis=0) * float(np.linalg.norm(C1)) / max(rate, 1e-300)


def column_rank(D: np.ndarray, scale: np.ndarray) -> tuple[int, np.ndarray]:
    """Rank of D and V (m, m) so that D V = [full rank, 0].

    Columns are first scaled to unit length, because the unit of a control is arbitrary. A column far below
    ``scale`` (m,) counts as zero.
    """
    size = np.linalg.norm(D, axis=0)
    live = size > RANK_RTOL * scale
    weight = 1 / np.where(live, size, 1)
    _, sigma, Vt = np.linalg.svd(D * np.where(live, weight, 0.0))
    rank = int(np.count_nonzero(sigma > RANK_RTOL * sigma.max(initial=0.0)))
    return rank, weight[:, None] * Vt.T


def unreachable_gain(D11: np.ndarray, D12: np.ndarray, scale: np.ndarray) -> float:
    """σ̄ of the part of D11 (p1, m1) that no u can cancel through D12 (p1, m2), for any rank of D12.

    ``scale`` (m2,) is that of ``column_rank``.
    """
    rank, V = column_rank(D12, scale)
    Q = sl.qr(D12 @ V[:, :rank], mode="full")[0] if rank else np.eye(D11.shape[0])
    rest = Q[:, rank:].T @ D11
    return float(np.linalg.norm(rest, 2)) if rest.size else 0.0


def parrott_bound(P: Plant) -> float:
    """min over D_K of σ̄(D11 + D12 D_K D21) (Parrott 1978), for any rank of D12 and D21."""
    return max(
        unreachable_gain(Q.D11, Q.D12, direct_scale(float(np.linalg.norm(Q.A, 2)), Q.B2, Q.C1))
        for Q in (P, P.dual)
    )
