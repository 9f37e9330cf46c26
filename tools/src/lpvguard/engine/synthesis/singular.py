"""Singular problems: an exact reduction gives the optimum, and a regular plant gives the controller.

A control direction may have no direct cost. The states that it drives then can take any value at no cost, and
they become the controls of a smaller problem (Stoorvogel 1992). The controller comes from a plant with an
extra cost ε on the free directions and an extra noise ε on the free measurements. The level of this plant
holds for the original plant too, because the extended plant has the larger cost.
"""

from dataclasses import replace

import numpy as np

from lpvguard.engine.synthesis.direct_terms import RANK_RTOL, column_rank, direct_scale, unreachable_gain
from lpvguard.engine.synthesis.partition import Plant
from lpvguard.engine.synthesis.riccati import Side
from lpvguard.engine.synthesis.statespace import EPS
from lpvguard.engine.synthesis.zeros import axis_zeros

AXIS_COST = 1e-7
"""State cost, relative to ‖C1‖, that moves zeros off the imaginary axis in the search for the optimum."""


def reduced_side(P: Plant) -> Side:
    """Riccati problem of the control side of P.

    Free directions are removed until D12 has full rank.
    """
    A, B1, B2, C1, D12 = P.A, P.B1, P.B2, P.C1, P.D12
    rate = float(np.linalg.norm(A, 2))
    basis = np.eye(len(A))
    while B2.shape[1]:
        rank, V = column_rank(D12, direct_scale(rate, B2, C1))
        if rank == B2.shape[1]:
            break
        paid, free = B2 @ V[:, :rank], B2 @ V[:, rank:]
        cost = D12 @ V[:, :rank]
        size = np.linalg.norm(free, axis=0)
        free = free / np.where(size > 0, size, 1)
        U, sigma, _ = np.linalg.svd(free)
        U[np.abs(U) < 4 * EPS] = 0.0
        r = int(np.count_nonzero(sigma > RANK_RTOL))
        if r == 0:
            B2, D12 = paid, cost
            break
        driven, rest = U[:, :r], U[:, r:]
        A, B1, B2, C1, D12, basis = (
            rest.T @ A @ rest,
            rest.T @ B1,
            np.hstack([rest.T @ paid, rest.T @ A @ driven]),
            C1 @ rest,
            np.hstack([cost, C1 @ driven]),
            basis @ rest,
        )
    bound = unreachable_gain(P.D11, D12, direct_scale(rate, B2, C1))
    side = Side(A, B1, B2, C1, P.D11, D12, basis, bound)
    axis = axis_zeros(side, rate) if A.size else ()
    if not axis:
        return side
    return replace(side, axis=axis, weight=AXIS_COST * max(float(np.linalg.norm(P.C1, 2)), EPS))


def extended_plant(P: Plant, soft: tuple[bool, bool], epsilon: float) -> Plant:
    """The regular plant with extra costs ε on the controls and extra noises ε on the measurements.

    ``soft`` has two flags: whether the cost, and whether the noise, acts on every state too. This is needed
    where zeros remain on the imaginary axis.
    """
    cost_u, cost_x = _extension(P, soft[0], epsilon)
    noise_y, noise_x = _extension(P.dual, soft[1], epsilon)
    n = len(P.A)
    C1 = np.vstack([P.C1, np.zeros((len(cost_u), n)), cost_x])
    D12 = np.vstack([P.D12, cost_u, np.zeros((len(cost_x), P.D12.shape[1]))])
    B1 = np.hstack([P.B1, np.zeros((n, len(noise_y))), noise_x.T])
    D21 = np.hstack([P.D21, noise_y, np.zeros((len(P.D21), len(noise_x)))])
    D11 = np.zeros((C1.shape[0], B1.shape[1]))
    D11[: P.D11.shape[0], : P.D11.shape[1]] = P.D11
    return Plant(P.A, B1, P.B2, C1, P.C2, D11, D12, D21)


def _extension(P: Plant, axis: bool, epsilon: float) -> tuple[np.ndarray, np.ndarray]:
    """Extra cost rows ε·u and, with ``axis``, ε·x, in units of the plant's costs."""
    size = max(float(np.linalg.norm(P.C1, 2)), EPS)
    reach = np.linalg.norm(P.B2, axis=0)
    unit = np.where(reach > 0, reach / max(reach.max(), 1e-300), 1.0)
    states = epsilon * size * np.eye(len(P.A)) if axis else np.zeros((0, len(P.A)))
    return epsilon * size * np.diag(unit), states
