"""Search, store and repeat the proofs for a scheduled loop while the speed moves.

Robust stability is proved up to the largest rate |dv/dt| that is found (engine/synthesis/lpv_certificate.py).
Robust performance is proved for one rate, at the least level that is found (engine/synthesis/least_level.py).
"""

from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from ..base.errors import InputError
from ..base.parallel import Map
from ..base.progress import Progress, counted
from ..base.sampling import evenly
from ..core.scheduled import Scheduled
from ..engine.synthesis.dk import RobustPerformance, Scaling, certify
from ..engine.synthesis.interconnection import GeneralisedPlant
from ..engine.synthesis.least_level import find_level, tuned, weighed
from ..engine.synthesis.lpv_certificate import (
    Family,
    LpvCertificate,
    Storage,
    find,
    polynomial_storage,
    prove,
    relevant,
    riccati_storage,
)
from ..engine.synthesis.scheduling import closed_scaled
from ..engine.synthesis.statespace import StateSpace, lft
from .plants import DesignProblem

PERFORMANCE_RATE = 1.0
"""Rate |dv/dt| in m/s^2 for which robust performance is searched, about that of a truck's service braking."""
TUNING_SPEEDS = 4
"""Number of nodes, ends included, for which the shape of D is searched."""
POSITIVE = ("rate_mps2", "level", "gain")
"""Fields that a claim needs."""
MARGIN_RTOL = 1e-2
"""Share by which a stated margin may exceed the recomputed one. A margin is a small difference of large
numbers."""
CLAIMS = ("stability", "performance")
"""Claims about a moving speed. The first one concerns the channels of Delta alone."""
MOVING_CLAIMS = {
    "stability": "the loop stays stable for every LTI Delta within W_delta",
    "performance": "every LTI Delta within W_delta leaves a gain from w to z below level, from rest: robust "
    "performance with A_t and A_u over level",
}
"""Wording of each claim. A claim holds for every speed of the range and every |dv/dt| up to the stated
rate."""


@dataclass(frozen=True)
class Moving:
    """Certificate of a claim, with its D scaled by the certificate's gain."""

    lpv: LpvCertificate
    scaling: Scaling


def moving_certificates(
    problem: DesignProblem,
    schedule: Scheduled,
    scaling: Scaling,
    progress: Progress = lambda _: None,
    workers: Map = map,
) -> dict[str, Moving | None]:
    """Search the certificates for a moving speed.

    One worker searches for stability while others search for performance.

    Parameters
    ----------
    problem : DesignProblem
    schedule : Scheduled
    scaling : Scaling, start of the search
    progress : Callable, reports progress
    workers : Map

    Returns
    -------
    dict, Moving or None by claim

    References
    ----------
    THEORY 7.5.
    """
    stable = workers(_stability, [(problem, schedule, scaling)])
    progress("performance: scaling")
    delta = _delta(problem.plant(float(schedule.speeds[0])))
    tuned_at = tuning(schedule, problem.plant, scaling)
    own: dict[float, Scaling] = {}

    def family_at(level: float) -> Family:
        own[level] = tuned_at(level)
        return scaled_families(problem, schedule, own[level])["performance"]

    level = find_level(family_at, delta, PERFORMANCE_RATE, lambda text: progress(f"performance: {text}"))
    progress("stability: storage function and proof")
    return {
        "stability": next(iter(stable)),
        "performance": None if level is None else Moving(level, own[level.level]),
    }


def _stability(design: tuple[DesignProblem, Scheduled, Scaling]) -> Moving | None:
    """Certificate of stability; None if there is no Delta, or if no proof is found."""
    problem, schedule, scaling = design
    families = scaled_families(problem, schedule, scaling)
    stable = find(families["stability"]) if "stability" in families else None
    return None if stable is None else Moving(stable, scaling)


def tuning(
    schedule: Scheduled, plant_of: Callable[[float], GeneralisedPlant], scaling: Scaling, workers: Map = map
) -> Callable[[float], Scaling]:
    """Return a function that gives, for a level, the D with the least frozen gain for this controller.

    plant_of(v) is the generalised plant at v [m/s]; ``scaling`` starts the search. ``workers`` share the
    speeds.
    """
    nodes = schedule.speeds[evenly(len(schedule.speeds), TUNING_SPEEDS)]
    plants = {float(v): plant_of(float(v)) for v in nodes}
    loops = [lft(plant.system, schedule.at(v)) for v, plant in plants.items()]
    # The common D can lie where no change of a single parameter improves it. The D of each speed is then a
    # better start.
    designs = [(plant, schedule.at(v), scaling) for v, plant in plants.items()]
    starts = [scaling, *(one.scaling for one in workers(certified, designs))]
    delta = _delta(plants[float(nodes[0])])
    return lambda level: tuned(loops, delta, level, starts)


def certified(design: tuple[GeneralisedPlant, StateSpace, Scaling | None]) -> RobustPerformance:
    """`certify` for a plant, a controller and a scaling, as sent to workers."""
    return certify(*design)


def _delta(plant: GeneralisedPlant) -> tuple[int, int]:
    """Number of Delta's rows and columns in a closed loop."""
    return plant.n_delta_in, plant.n_delta_out


def scaled_families(problem: DesignProblem, schedule: Scheduled, scaling: Scaling) -> dict[str, Family]:
    """Make the scaled loop over speed for each claim.

    Parameters
    ----------
    problem : DesignProblem
    schedule : Scheduled
    scaling : Scaling

    Returns
    -------
    dict[str, Family], by claim; a design without Delta has only performance
    """
    model, plant = problem.model, problem.plant(float(schedule.speeds[0]))
    # The last outputs and inputs are the probes of interconnection.generalised_plant.
    held = model.held_states + model.n_u + (model.n if problem.settings.structure == "K_is" else 0)
    first = scaling.systems(plant)[1].order

    def hold_bounds(low: float, high: float) -> tuple[np.ndarray, np.ndarray]:
        first_derivative, second = model.hold_bounds(low, high)
        return first_derivative[:, :held], second[:, :held]

    family = Family(
        lambda v: closed_scaled(problem.plant(v, probes=True), schedule.at(v), scaling),
        schedule.speeds,
        slice(first, first + model.n),
        held,
        hold_bounds,
        schedule.Ts,
    )
    n_z = plant.system.n_outputs - plant.n_measurement
    families = {"performance": relevant(family, slice(0, n_z), slice(None))}
    if plant.blocks:
        rows, columns = slice(0, plant.n_delta_in), slice(0, plant.n_delta_out)
        families["stability"] = relevant(family, rows, columns)
    return families


def require_moving(
    path: Path,
    stated: dict,
    problem: DesignProblem,
    schedule: Scheduled,
    progress: Progress = lambda _: None,
    workers: Map = map,
) -> None:
    """Raise InputError unless a new proof confirms every rate in the certificates ``stated``.

    ``workers`` share the claims.
    """
    entries = {claim: stated["moving_speed"].get(claim, {"rate_mps2": np.nan}) for claim in CLAIMS}
    entries = {claim: entry for claim, entry in entries.items() if entry["rate_mps2"] is not None}
    statements = ((problem, schedule, claim, entry) for claim, entry in entries.items())
    texts = [f"{claim}: proof between the speeds" for claim in entries]
    for (claim, entry), holds in zip(
        entries.items(), counted(progress, texts, workers(_holds, statements)), strict=True
    ):
        if not holds:
            raise InputError(
                path,
                f"certificates.moving_speed.{claim}",
                f"its storage function does not prove it for |dv/dt| up to {entry['rate_mps2']:.4g} m/s2",
                "the coefficients, weights, speeds and P that were certified",
            )


def _holds(statement: tuple[DesignProblem, Scheduled, str, dict]) -> bool:
    """Tell if a new proof confirms a claim of controller.json about a moving speed."""
    problem, schedule, claim, entry = statement
    if not all(np.isfinite(entry.get(name, np.nan)) and entry[name] > 0 for name in POSITIVE):
        return False
    # Only performance has a level. Stability is claimed at level 1, with the design's own D.
    families = scaled_families(problem, schedule, _scaling(entry["scaling"]))
    if claim not in families:
        return False
    family, delta = families[claim], _delta(problem.plant(float(schedule.speeds[0])))
    family = replace(weighed(family, delta, entry["level"], entry["gain"]), adjoint=entry["adjoint"])
    storage = _storage(family, entry)
    proof = None if storage is None else prove(family, storage, entry["rate_mps2"])
    return proof is not None and entry["margin"] <= proof.margin * (1 + MARGIN_RTOL)


def _storage(family: Family, entry: dict) -> Storage | None:
    """Read the storage function of controller.json; None if it does not fit this loop and its speed range."""
    if entry["P"] is None:
        return riccati_storage(family)
    n, knots = family.at(float(family.nodes[0])).order, entry["knots_mps"]
    terms = 3 if knots is None else np.size(knots)
    if [np.size(entry["basis"]), *map(np.size, entry["P"])] != [n * n, *[n * (n + 1) // 2] * terms]:
        return None
    basis, P = _square(entry["basis"]), np.array([_symmetric(P) for P in entry["P"]])
    if knots is None:
        return polynomial_storage(family, basis, P)
    v = np.array(knots, float)
    if terms < 2 or not (np.diff(v) > 0).all() or [v[0], v[-1]] != family.nodes[[0, -1]].tolist():
        return None
    return Storage(basis, v, P, family.adjoint)


def moving_to_dict(moving: dict[str, Moving | None]) -> dict:
    """Make the entries of controller.json by claim."""
    return {claim: _moving(claim, moving.get(claim)) for claim in CLAIMS}


def _moving(claim: str, moving: Moving | None) -> dict:
    """Entry of a claim about a moving speed in controller.json."""
    if moving is None:
        return {
            "claim": f"no proof was found: of {claim} at a moving speed nothing is claimed",
            "rate_mps2": None,
        }
    lpv = moving.lpv
    P, upper = lpv.storage.P if lpv.own_knots else lpv.P, np.triu_indices(len(lpv.storage.basis))
    return {
        "claim": f"at every speed of the range and |dv/dt| up to rate_mps2 {MOVING_CLAIMS[claim]}; nominal "
        "model, weights, fixed D(s), controller, without the states that the claim does not concern",
        "test": "discrete bounded-real inequality, x = basis x~, P(v) linear between its values P at "
        "knots_mps (null: between those of P0 + v P1 + P2 / v at finer knots; P null: of strict Riccati "
        "solutions), by eigenvalues at the ends of cells that cover the range, a bound of what it loses "
        "between them subtracted",
        "rate_mps2": lpv.rate,
        "level": lpv.level,
        "gain": lpv.gain,
        "scaling": moving.scaling.log_parameters.tolist(),
        "not_found_mps2": lpv.not_found,
        "adjoint": lpv.storage.adjoint,
        "states": len(lpv.storage.basis),
        "cells": lpv.proof.cells,
        "margin": lpv.proof.margin,
        "basis": None if P is None else lpv.storage.basis.ravel(),
        "knots_mps": lpv.storage.knots if lpv.own_knots else None,
        "P": None if P is None else [one[upper] for one in P],
    }


def _scaling(rows: list[list[float]]) -> Scaling:
    """Make D from its parameters, one row for each block of Delta."""
    return Scaling(np.array(rows, float).reshape(len(rows), -1) if rows else np.zeros((0, 1)))


def _square(values: list[float]) -> np.ndarray:
    n = int(np.sqrt(len(values)))
    return np.array(values, float).reshape(n, n)


def _symmetric(upper: list[float]) -> np.ndarray:
    """Make a symmetric matrix from its upper triangle, given row by row."""
    n = int(np.sqrt(2 * len(upper)))
    P = np.zeros((n, n))
    P[np.triu_indices(n)] = upper
    return P + np.triu(P, 1).T
