"""Opens a vehicle's compiled core, for a replay or for a stream of samples."""

from pathlib import Path

from ..core.compiled import Core, generated_folder
from ..drives.frames import require_core
from ..vehicle.project import Project
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
    return Replayer(project, Core(generated_folder(project, coefficients, vehicle)))
