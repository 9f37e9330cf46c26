"""A vehicle's compiled core, opened for replay or for samples that come one by one."""

from __future__ import annotations

from pathlib import Path

from ..base import artefacts
from ..core.compiled import Core, shipped_vehicle
from ..drives.frames import require_core
from ..vehicle.project import Project
from ..vehicle.stored_settings import require_settings
from .replayer import Replayer


def replayer_for(project: Project, coefficients: Path | None, vehicle: object) -> Replayer:
    """The compiled core of a project, of its shipped folder or of ``coefficients``. InputError where the
    folder was made with other settings. ``vehicle``: what the project is called in that error."""
    require_core(project)
    folder = coefficients or shipped_vehicle(project.name)
    require_settings(artefacts.read_manifest(folder, "vehicle")["project"], folder, project, vehicle)
    return Replayer(project, Core(folder))
