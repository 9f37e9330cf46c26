"""What is proved of a scheduled loop while the speed moves: robust stability and robust performance, each
with its largest rate |dv/dt| (engine/synthesis/lpv_certificate.py); found, written and proved anew."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np

from ..base.errors import InputError
from ..base.progress import Progress
from ..core.scheduled import Scheduled
from ..engine.synthesis.dk import Scaling
from ..engine.synthesis.interconnection import GeneralisedPlant
from ..engine.synthesis.lpv_certificate import (
    Family,
    LpvCertificate,
    find,
    polynomial_storage,
    prove,
    relevant,
    riccati_storage,
)
from ..engine.synthesis.scheduling import closed_scaled
from ..identify.run import StoredIdentification
from ..vehicle.nominal import NominalModel
from .plants import design_settings, fig1_weights, plant_at

PERFORMANCE_FROM = 0.95
"""Largest frozen mu with which robust performance at a moving speed is searched for: nearer 1 the search
takes as long, and a rate worth stating is not to be had."""
CLAIMS = ("stability", "performance")
"""What is proved of a moving speed, the first for Delta's channels alone."""
MOVING_CLAIMS = {
    "stability": "the loop stays stable for every LTI Delta within W_delta",
    "performance": "the gain of the whole scaled loop is below 1, from rest: robust performance for every "
    "LTI Delta within W_delta",
}
"""What each claim says of every speed of the range and every |dv/dt| up to the stated rate."""


def moving_certificates(
    stored: StoredIdentification,
    schedule: Scheduled,
    scaling: Scaling,
    worst: float,
    progress: Progress = lambda _: None,
) -> dict[str, LpvCertificate | None]:
    """The certificates for a moving speed by claim; None where none is found. ``worst``: the largest mu that
    is proved at a frozen speed."""
    families = scaled_families(stored, schedule, scaling)
    wanted = [claim for claim in families if claim != "performance" or worst <= PERFORMANCE_FROM]

    def proved(claim: str) -> LpvCertificate | None:
        return find(families[claim], lambda text: progress(f"{claim}: {text}"))

    return {claim: proved(claim) if claim in wanted else None for claim in CLAIMS}


def scaled_families(stored: StoredIdentification, schedule: Scheduled, scaling: Scaling) -> dict[str, Family]:
    """By claim the loop over speed under ``scaling``; a design without Delta has performance alone."""
    settings, model = design_settings(stored), NominalModel(stored.project)
    weights = fig1_weights(stored, settings)

    def plant_of(v: float, probes: bool = False) -> GeneralisedPlant:
        return plant_at(stored, model, weights, v, False, settings.structure, probes=probes)

    plant = plant_of(float(schedule.speeds[0]))
    # The probes: state, input, and with state uncertainty an input on every state; see
    # interconnection.generalised_plant.
    held = model.n + model.n_u + (model.n if settings.structure == "K_is" else 0)
    first = scaling.systems(plant)[1].order

    def hold_bounds(low: float, high: float) -> tuple[np.ndarray, np.ndarray]:
        first_derivative, second = model.hold_bounds(low, high)
        return first_derivative[:, :held], second[:, :held]

    family = Family(
        lambda v: closed_scaled(plant_of(v, probes=True), schedule.at(v), scaling),
        schedule.speeds,
        slice(first, first + model.n),
        held,
        hold_bounds,
        schedule.Ts,
    )
    n_z = plant.system.n_outputs - plant.n_measurement
    found = {"performance": relevant(family, slice(0, n_z), slice(None))}
    if plant.blocks:
        rows, columns = slice(0, plant.n_delta_in), slice(0, plant.n_delta_out)
        found["stability"] = relevant(family, rows, columns)
    return {claim: found[claim] for claim in CLAIMS if claim in found}


def require_moving(
    path: Path,
    stated: dict,
    stored: StoredIdentification,
    schedule: Scheduled,
    scaling: Scaling,
    progress: Progress = lambda _: None,
) -> None:
    """InputError unless every rate that the certificates ``stated`` in controller.json name is proved
    anew."""
    families = scaled_families(stored, schedule, scaling)
    for claim in CLAIMS:
        said = stated["moving_speed"].get(claim, {"rate_mps2": np.nan})
        if said["rate_mps2"] is None:
            continue
        progress(f"{claim}: proof between the speeds")
        if claim not in families or not _holds(families[claim], said):
            raise InputError(
                path,
                f"certificates.moving_speed.{claim}",
                f"its storage function does not prove it for |dv/dt| up to {said['rate_mps2']:.4g} m/s2",
                "the coefficients, weights, speeds and P that were certified",
            )


def _holds(family: Family, said: dict) -> bool:
    """Whether what controller.json says of a moving speed is proved anew."""
    if not np.isfinite(said["rate_mps2"]) or said["rate_mps2"] <= 0:
        return False
    family = replace(family, adjoint=said["adjoint"])
    if said["P"] is None:
        storage = riccati_storage(family)
        return storage is not None and prove(family, storage, said["rate_mps2"]) is not None
    n = family.at(float(family.nodes[0])).order
    if [np.size(said["basis"]), *map(np.size, said["P"])] != [n * n, *[n * (n + 1) // 2] * 3]:
        return False
    basis, P = _square(said["basis"]), np.array([_symmetric(P) for P in said["P"]])
    return prove(family, polynomial_storage(family, basis, P), said["rate_mps2"]) is not None


def moving_to_dict(found: dict[str, LpvCertificate | None]) -> dict:
    """``found`` by claim as controller.json holds it; a claim that is not there claims nothing."""
    return {claim: _moving(claim, found.get(claim)) for claim in CLAIMS}


def _moving(claim: str, lpv: LpvCertificate | None) -> dict:
    """A claim about a moving speed as controller.json holds it."""
    if lpv is None:
        return {
            "claim": f"no proof was found: of {claim} at a moving speed nothing is claimed",
            "rate_mps2": None,
        }
    upper = np.triu_indices(len(lpv.storage.basis))
    return {
        "claim": f"at every speed of the range and |dv/dt| up to rate_mps2 {MOVING_CLAIMS[claim]}; nominal "
        "model, weights, fixed D(s), controller, without the states that the claim does not concern",
        "test": "discrete bounded-real inequality, x = basis x~, P(v) = P0 + v P1 + P2 / v (P null: strict "
        "Riccati solutions), linear between knots, by eigenvalues at the ends of cells that cover the range, "
        "a bound of what it loses between them subtracted",
        "rate_mps2": lpv.rate,
        "not_found_mps2": lpv.not_found,
        "adjoint": lpv.storage.adjoint,
        "states": len(lpv.storage.basis),
        "cells": lpv.proof.cells,
        "margin": lpv.proof.margin,
        "basis": None if lpv.P is None else lpv.storage.basis.ravel(),
        "P": None if lpv.P is None else [P[upper] for P in lpv.P],
    }


def _square(values: list[float]) -> np.ndarray:
    n = int(np.sqrt(len(values)))
    return np.array(values, float).reshape(n, n)


def _symmetric(upper: list[float]) -> np.ndarray:
    """A symmetric matrix from its upper triangle row by row."""
    n = int(np.sqrt(2 * len(upper)))
    P = np.zeros((n, n))
    P[np.triu_indices(n)] = upper
    return P + np.triu(P, 1).T
