"""What else is asked of a controller.json that `lpvguard design` wrote: whose it is, its scaling, and its
mu with a fault in the loop."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from ..base import artefacts
from ..base.errors import InputError
from ..core.control_coefficients import read_controller
from ..core.scheduled import Scheduled
from ..engine.synthesis.dk import Scaling, certify
from ..engine.synthesis.statespace import StateSpace, series
from ..identify.run import StoredIdentification
from .plants import frozen_plant


def stated_scaling(document: dict) -> Scaling:
    """The common scaling of a controller.json."""
    stated = document["certificates"]
    return Scaling(np.array(stated["scaling_log_parameters"], float).reshape(-1, stated["scaling_columns"]))


def require_designed_for(stored: StoredIdentification, controller: Path) -> dict:
    """The document of controller.json; InputError where it cannot be read or was designed for another
    identification."""
    document = read_controller(controller)
    if artefacts.read_manifest(controller.parent, "design")["identification"] != stored.manifest:
        raise InputError(
            controller.parent, "identification", "is another one", f"a design of {stored.folder}"
        )
    return document


def require_exported_with(controller: Path, vehicle: Path) -> None:
    """InputError unless the generated folder ``vehicle`` was exported with this controller.json, byte for
    byte: its certificates are then what `export` proved of the folder's coefficients."""
    exported = artefacts.read_manifest(vehicle, "vehicle").get("controller", {}).get("sha256")
    if exported != artefacts.file_hash(controller):
        raise InputError(
            vehicle, "controller.sha256", "is of another controller", f"a folder exported with {controller}"
        )


def faulted_performance(
    path: Path, stored: StoredIdentification, v: float, applied: StateSpace, measured: StateSpace
) -> float:
    """Upper bound of mu at frozen speed v [m/s] of the loop closed by controller.json with two systems put
    into it.

    ``applied`` (n_u inputs and outputs) acts between controller and vehicle. ``measured`` acts on [reference,
    outputs] before the controller. The bound is inf where the loop is unstable.
    """
    document = artefacts.read_json(path)
    plant, K = frozen_plant(stored, v), Scheduled.read(document).at(v)
    return certify(
        plant, series(applied, series(K, measured)), stated_scaling(document) if plant.blocks else None
    ).upper
