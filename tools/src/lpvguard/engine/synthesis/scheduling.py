"""A family of controllers for the operating points of a scheduled plant, suited for interpolation.

Three measures keep neighbouring controllers similar. First, all points have the same scaling D, which is the
best for the worst point, and the same level γ. Central controllers of neighbouring plants are similar at one
level, but not near each plant's own optimum. Second, the controllers keep the plant's coordinates, because
the state of a central controller estimates that of the plant. Third, one projection truncates all
controllers. It uses the sums of the closed-loop Gramians over the points (Wood, Goddard & Glover 1996).
Separate truncations would keep different states.
"""

from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import partial

import numpy as np
import scipy.linalg as sl

from lpvguard.base.parallel import Map
from lpvguard.engine.synthesis.dk import Scaling, gramian_factor
from lpvguard.engine.synthesis.hinf import hinf_synthesis, improved_level, optimal_level
from lpvguard.engine.synthesis.interconnection import GeneralisedPlant
from lpvguard.engine.synthesis.statespace import (
    StateSpace,
    append,
    balancing,
    gain,
    lft,
    scaled_states,
    series,
    to_continuous,
    to_discrete,
)

FIRST_STEP, LAST_STEP = 0.2, 0.03
"""Steps of the pattern search for the common scaling, in the logarithm of its parameters."""
OPTIMUM_RTOL = 1e-4


def scaled_plant(plant: GeneralisedPlant, scaling: Scaling) -> StateSpace:
    """D P D⁻¹ in continuous time, with the states [D⁻¹; P; D] in their original coordinates."""
    left, right = scaling.systems(plant)
    G = to_continuous(plant.system)
    left = append(left, gain(np.eye(G.n_outputs - left.n_outputs)))
    right = append(right, gain(np.eye(G.n_inputs - right.n_inputs)))
    return series(left, series(G, right))


def closed_scaled(plant: GeneralisedPlant, controller: StateSpace, scaling: Scaling) -> StateSpace:
    """Close the discrete loop D F_l(P, K) D⁻¹ from [Δ outputs; w] to [Δ inputs; z].

    The states are [D⁻¹; P; K; D]. Tustin's method maps D to discrete time.

    Parameters
    ----------
    plant : GeneralisedPlant
    controller : StateSpace
    scaling : Scaling

    Returns
    -------
    StateSpace
    """
    loop = lft(plant.system, controller)
    left, right = (to_discrete(G, loop.dt) for G in scaling.systems(plant))
    return series(left, series(loop, right))


def common_scaling(
    plants: Sequence[GeneralisedPlant], start: Scaling, workers: Map = map
) -> tuple[Scaling, float]:
    """Search for the scaling with the least worst-case optimum over plants, by pattern search.

    Parameters
    ----------
    plants : Sequence[GeneralisedPlant]
    start : Scaling
    workers : Map, runs the two directions of a parameter in parallel

    Returns
    -------
    tuple of Scaling and float, its worst-case optimum
    """
    order = list(range(len(plants)))
    best = start
    level = max(
        optimal_level(scaled_plant(plant, start), plant.n_control, plant.n_measurement, OPTIMUM_RTOL)
        for plant in plants
    )
    step = FIRST_STEP
    while step >= LAST_STEP:
        improved = False
        for index in np.ndindex(best.log_parameters.shape):
            along = np.zeros_like(best.log_parameters)
            along[index] = step
            tried = [Scaling(best.log_parameters + along), Scaling(best.log_parameters - along)]
            ordered = list(order)
            worst_below = partial(_worst_below, [plants[k] for k in ordered], level * (1 - OPTIMUM_RTOL))
            for scaling, (value, offender) in zip(tried, workers(worst_below, tried), strict=True):
                if value is not None:
                    best, level, improved = scaling, value, True
                    break
                order.remove(ordered[offender])
                order.insert(0, ordered[offender])
        step *= 1.0 if improved else 0.5
    return best, level


def _worst_below(
    plants: Sequence[GeneralisedPlant], limit: float, scaling: Scaling
) -> tuple[float | None, int]:
    """The largest optimum when all lie below ``limit``.

    Otherwise None, and the index of the first plant whose optimum does not. The search skips a plant that
    reaches the largest optimum so far.
    """
    largest = 0.0
    for k, plant in enumerate(plants):
        shape = plant.n_control, plant.n_measurement
        value = improved_level(scaled_plant(plant, scaling), *shape, limit, OPTIMUM_RTOL, largest)
        if value is None:
            return None, k
        largest = max(largest, value)
    return largest, -1


def common_family(
    plants: Sequence[GeneralisedPlant], scaling: Scaling, level: float, workers: Map = map
) -> tuple[Callable[[int], list[StateSpace]], int]:
    """Compute controllers of all plants at one level, truncated to the same states.

    Parameters
    ----------
    plants : Sequence[GeneralisedPlant], discrete, all with the same structure
    scaling : Scaling
    level : float, above the optimum of each plant
    workers : Map, runs the plants in parallel

    Returns
    -------
    tuple of Callable, which returns the list of StateSpace for an order, and int, the largest order

    References
    ----------
    Wood, Goddard & Glover 1996.
    """
    scaled = [scaled_plant(plant, scaling) for plant in plants]
    t = balancing(scaled[len(scaled) // 2])
    member = partial(_member, plants[0].n_control, plants[0].n_measurement, level)
    full = list(workers(member, [scaled_states(G, t) for G in scaled]))
    R = gramian_factor(np.sum([reach for _, reach, _ in full], axis=0))
    S = gramian_factor(np.sum([seen for _, _, seen in full], axis=0))
    U, sigma, Vt = np.linalg.svd(S.T @ R)
    rank = int(np.count_nonzero(sigma > 1e-13 * sigma[0]))
    scale = 1 / np.sqrt(sigma[:rank])
    into, out = R @ Vt[:rank].T * scale, (S @ U[:, :rank] * scale).T

    def at_order(order: int) -> list[StateSpace]:
        T, L = into[:, :order], out[:order]
        return [
            to_discrete(replace(K, A=L @ K.A @ T, B=L @ K.B, C=K.C @ T), plant.system.dt)
            for (K, *_), plant in zip(full, plants, strict=True)
        ]

    return at_order, rank


def _member(
    n_control: int, n_measurement: int, level: float, G: StateSpace
) -> tuple[StateSpace, np.ndarray, np.ndarray]:
    """Central controller of the scaled plant ``G`` at ``level``, and its blocks of both Gramians (n, n)."""
    n, synthesis = G.order, hinf_synthesis(G, n_control, n_measurement, level=level)
    K = synthesis.controller.transformed(np.linalg.inv(synthesis.basis))
    loop = lft(G, K)
    reach = sl.solve_continuous_lyapunov(loop.A, -loop.B @ loop.B.T)[n:, n:]
    seen = sl.solve_continuous_lyapunov(loop.A.T, -loop.C.T @ loop.C)[n:, n:]
    return K, reach, seen
