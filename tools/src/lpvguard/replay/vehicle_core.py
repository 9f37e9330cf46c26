"""Opens a vehicle's compiled core, for a replay or for a stream of samples."""

from pathlib import Path

from ..base import artefacts
from ..core.compiled import Core, shipped_vehicle
from ..drives.frames import require_core
from ..vehicle.project import Project
from ..vehicle.stored_settings import require_settings
from .replayer import Replayer


def replayer_for(project: Project, coefficients: Path | None, vehicle: object) -> Replayer:
    """Open the compiled core of a project.

    Parameters
    ----------
    project : Project
    coefficients : Path, or None for the shipped folder
    vehicle : object, name of the project in errors

    Returns
    -------
    Replayer

    Raises
    ------
    InputError
        If the folder was made with other settings.
    """
    require_core(project)
    folder = coefficients or shipped_vehicle(project.name)
    require_settings(artefacts.read_manifest(folder, "vehicle")["project"], folder, project, vehicle)
    return Replayer(project, Core(folder))
