"""An identification as tables and objects."""

from __future__ import annotations

import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from ..base.parallel import workers
from ..control.exported import export_chosen
from ..drives.frames import Estimator
from ..identify import run as stage
from ..identify.calibration import Calibration
from ..identify.weights import Weights
from ..vehicle.nominal import NominalModel
from ..vehicle.project import Project, load_project
from .optional import optional

if TYPE_CHECKING:
    import pandas


def project_of(vehicle: str | Path | Project) -> Project:
    """The project of a shipped vehicle's name, of a path to a project file, or as it is. InputError where it
    is neither."""
    return vehicle if isinstance(vehicle, Project) else load_project(vehicle)


@dataclass(frozen=True)
class Identified:
    """Bounds, weights and thresholds of a vehicle's nominal model. ``folder``: where they are stored; None
    while they are not. ``omega`` (K,): frequencies of the bins [rad/s]."""

    project: Project
    folder: Path | None
    omega: np.ndarray
    fitted: Weights
    calibration: Calibration
    _bounds: dict[str, np.ndarray]
    _found: tuple[stage.Identification, stage.DriveSet] | None = None

    @property
    def bounds(self) -> pandas.DataFrame:
        """A row a bin, indexed by its frequency [rad/s]: frames (how many counted), excitation (largest
        nominal output), gamma_w, nu (one a Delta) and B_w (one an output), in the outputs' units; NaN: no
        data. Needs pandas."""
        columns = {k: self._bounds[k] for k in ("frames", "excitation", "gamma_w", "nu", "B_w")}
        return self._table(columns | {"frames": columns["frames"].astype(int)})

    @property
    def weights(self) -> pandas.DataFrame:
        """A row a bin, indexed by its frequency [rad/s]: W_delta and B_w as the monitor uses them, with the
        final inflation. Needs pandas."""
        return self._table(dict(zip(("W_delta", "B_w"), self.fitted.of_frames(self.omega), strict=True)))

    @property
    def threshold(self) -> float:
        """The frame test's threshold on t* that the core carries."""
        return self.calibration.carried

    @property
    def claim(self) -> str:
        """What the threshold promises, or why it promises nothing, in words."""
        return self.calibration.claim()

    def save(self, folder: str | Path) -> Identified:
        """Write the folder of `lpvguard identify`, whole or not at all, and return it as stored."""
        if self._found is None:
            raise ValueError(f"it is stored in {self.folder} already")
        stage.save(*self._found, Path(folder))
        return load(folder)

    def export(
        self, folder: str | Path, *, controller: str | Path | None = None, group: str | None = None
    ) -> Path:
        """Write the generated C folder of `lpvguard export`, and return its path.

        ``controller``: controller.json or the folder of `design`, None for none; its certificates are proved
        anew. ``group``: whose thresholds the core carries, None for the largest of all. InputError where
        either does not fit.
        """
        chosen = None if controller is None else Path(controller)
        with self.opened() as stored:
            export_chosen(stored, Path(folder), chosen, group)
        return Path(folder)

    @contextmanager
    def opened(self) -> Iterator[stage.StoredIdentification]:
        """The folder read back, every weight proved above its bound anew; one of its own while it is not
        stored."""
        if self.folder is not None:
            yield stage.load(self.folder)
            return
        with (
            tempfile.TemporaryDirectory() as scratch,
            self.save(Path(scratch) / "identify").opened() as stored,
        ):
            yield stored

    def _table(self, columns: dict[str, np.ndarray]) -> pandas.DataFrame:
        pandas = optional("pandas", "pandas")
        outputs = [s.name for s in self.project.outputs]
        flat: dict[str, Any] = {}
        for name, values in columns.items():
            if values.ndim == 1:
                flat[name] = values
            elif values.shape[1] == 1:
                flat[name] = values[:, 0]
            else:
                flat |= {f"{name}/{o}": values[:, j] for j, o in enumerate(outputs)}
        return pandas.DataFrame(flat, index=pandas.Index(self.omega, name="omega_rad_s"))


def identify(
    vehicle: str | Path | Project, drives: str | Path, *, jobs: int = 1, scheduler: str | None = None
) -> Identified:
    """Find bounds, weights and thresholds, as `lpvguard identify` does; ``jobs``: processes that share the
    drives; ``scheduler``: address of a Dask scheduler whose workers share them.

    ``vehicle``: a shipped vehicle's name, the path of a project file, or a Project. ``drives``: folder with
    experiments.csv. Raises InputError that names file, place and what was expected.
    """
    project = project_of(vehicle)
    with workers(jobs, scheduler) as run:
        found = stage.identify(project, Path(drives), workers=run)
    result, b = found[0], found[0].bounds
    return Identified(project, None, b.omega, result.weights, result.calibration, vars(b), found)


def load(folder: str | Path) -> Identified:
    """Read the folder of `lpvguard identify`; every weight is proved above its bound anew, and a changed file
    is an InputError."""
    stored = stage.load(Path(folder))
    omega = Estimator.of(stored.project, NominalModel(stored.project)).omega
    return Identified(stored.project, stored.folder, omega, stored.fitted, stored.calibration, stored.bounds)
