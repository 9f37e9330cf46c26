"""Further questions about a controller.json: its identification, its scaling, and mu with a fault in the
loop."""

from pathlib import Path

import numpy as np

from ..base import artefacts
from ..base.errors import InputError
from ..core.control_coefficients import read_controller
from ..core.scheduled import Scheduled
from ..engine.synthesis.dk import Scaling, certify
from ..engine.synthesis.statespace import StateSpace, series
from ..identify.identification import StoredIdentification
from .plants import DesignProblem


def stated_scaling(document: dict) -> Scaling:
    """Read the common scaling of a controller.json.

    Parameters
    ----------
    document : dict

    Returns
    -------
    Scaling
    """
    stated = document["certificates"]
    return Scaling(np.array(stated["scaling_log_parameters"], float).reshape(-1, stated["scaling_columns"]))


def require_designed_for(stored: StoredIdentification, controller: Path) -> dict:
    """Read a controller.json of this identification.

    Parameters
    ----------
    stored : StoredIdentification
    controller : Path

    Returns
    -------
    dict, the document

    Raises
    ------
    InputError
        If it cannot be read, or was designed for another identification.
    """
    document = read_controller(controller)
    if artefacts.read_manifest(controller.parent, "design")["identification"] != stored.manifest:
        raise InputError(
            controller.parent,
            "identification",
            "belongs to another identification",
            f"a design of {stored.folder}",
        )
    return document


def require_exported_with(controller: Path, vehicle: Path) -> None:
    """Require that a generated folder was exported with a controller.json, byte for byte.

    Its certificates are then those that `export` proved for the folder's coefficients.

    Parameters
    ----------
    controller : Path
    vehicle : Path, generated folder

    Raises
    ------
    InputError
        If it was not.
    """
    exported = artefacts.read_manifest(vehicle, "vehicle").get("controller", {}).get("sha256")
    if exported != artefacts.file_hash(controller):
        raise InputError(
            vehicle,
            "controller.sha256",
            "belongs to another controller",
            f"a folder exported with {controller}",
        )


def faulted_performance(
    path: Path, stored: StoredIdentification, v: float, applied: StateSpace, measured: StateSpace
) -> float:
    """Bound mu at a frozen speed with two systems in the loop of a controller.json.

    Parameters
    ----------
    path : Path, controller.json
    stored : StoredIdentification
    v : float, m/s
    applied : StateSpace, n_u inputs and outputs, between controller and vehicle
    measured : StateSpace, on [reference, outputs] before the controller

    Returns
    -------
    float, upper bound of mu, inf for an unstable loop
    """
    document = artefacts.read_json(path)
    plant, K = DesignProblem.from_identification(stored).plant(v), Scheduled.read(document).at(v)
    return certify(
        plant, series(applied, series(K, measured)), stated_scaling(document) if plant.blocks else None
    ).upper
