"""Read a controller.json: controller, identification, scaling, and mu with a fault in the loop."""

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from ..base import artefacts
from ..base.errors import InputError
from ..core.control_coefficients import read_controller
from ..core.scheduled import Scheduled
from ..engine.synthesis.dk import Scaling, certify
from ..engine.synthesis.statespace import StateSpace, series
from ..identify.identification import StoredIdentification
from .plants import DesignProblem, design_settings


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


@dataclass(frozen=True)
class PresentController:
    """A designed controller, as it runs in the field.

    Attributes
    ----------
    document : dict, the controller.json
    schedule : Scheduled
    scaling : Scaling
    """

    document: dict
    schedule: Scheduled
    scaling: Scaling

    @classmethod
    def from_path(cls, path: Path, stored: StoredIdentification) -> "PresentController":
        """Read a controller.json, or a folder's controller.json, for another identification of its vehicle.

        Raises InputError if the file cannot be read, was altered, or belongs to another vehicle or structure.
        """
        path = path / "controller.json" if path.is_dir() else path
        document = artefacts.read_json(path)
        if "certificates" not in document:
            raise InputError(path, "certificates", "missing", "a file that `lpvguard design` wrote")
        artefacts.require_seal(path, document, "`lpvguard design`")
        schedule, project = Scheduled.read(document), stored.project
        is_of = (
            document["certificates"]["structure"],
            schedule.Ts,
            schedule.B.shape[1],
            schedule.B.shape[3] - 1,
            *schedule.speeds[[0, -1]].tolist(),
        )
        want = (
            design_settings(stored).structure,
            project.Ts_s,
            len(project.inputs),
            len(project.outputs),
            *stored.model.speed_range,
        )
        if is_of != want:
            raise InputError(
                path,
                "structure, Ts_s, inputs, outputs, speeds",
                f"are {', '.join(map(str, is_of))}",
                f"{', '.join(map(str, want))} of {project.name}",
            )
        return cls(document, schedule, stated_scaling(document))


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
        If the file cannot be read, or if the controller was designed for another identification.
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
    """Require that a generated folder was exported with exactly this controller.json.

    `export` has then proved the file's certificates for the folder's coefficients.

    Parameters
    ----------
    controller : Path
    vehicle : Path, generated folder

    Raises
    ------
    InputError
        If the folder was exported with another file or none.
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
