"""A temporary compiled core."""

import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from ..base import artefacts
from ..core.coefficients import Coefficients, vehicle_files
from ..core.compiled import Core
from ..vehicle.project import Project


@contextmanager
def scratch_core(project: Project, coefficients: Coefficients) -> Iterator[Core]:
    """Compile the core of coefficients in a temporary folder.

    Parameters
    ----------
    project : Project
    coefficients : Coefficients

    Yields
    ------
    Core
    """
    with tempfile.TemporaryDirectory() as folder:
        target = Path(folder) / project.name
        target.mkdir()
        artefacts.write_files(target, vehicle_files(project, coefficients, {}))
        yield Core(target)
