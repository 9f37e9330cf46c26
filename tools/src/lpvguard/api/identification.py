"""Run or load an identification and return tables and objects."""

from __future__ import annotations

import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from ..base.optional import optional
from ..base.parallel import workers
from ..control.controller_export import export_chosen
from ..identify import identification as stage
from ..identify.calibration import Calibration
from ..identify.weights import Weights
from ..vehicle.project import Project, load_project

if TYPE_CHECKING:
    import pandas


def project_of(vehicle: str | Path | Project) -> Project:
    """Return the project of a shipped vehicle or of a path, or the given project.

    Parameters
    ----------
    vehicle : str, Path or Project

    Returns
    -------
    Project

    Raises
    ------
    InputError
        If the argument is none of these.
    """
    return vehicle if isinstance(vehicle, Project) else load_project(vehicle)


@dataclass(frozen=True)
class Identified:
    """Bounds, weights and thresholds of a vehicle's nominal model.

    Attributes
    ----------
    project : Project
    folder : Path or None, where they are stored
    omega : ndarray (K,), rad/s, frequencies of the bins
    fitted : Weights, before the final inflation
    calibration : Calibration, of the frame test
    """

    project: Project
    folder: Path | None
    omega: np.ndarray
    fitted: Weights
    calibration: Calibration
    _bounds: dict[str, np.ndarray]
    _found: tuple[stage.Identification, stage.DriveSet] | None = None

    @property
    def bounds(self) -> pandas.DataFrame:
        """Table of the bounds with one row per bin; the index is the frequency [rad/s]. Needs pandas.

        Columns: frames (number of counted frames), excitation (largest nominal output), gamma_w, nu (one per
        Delta) and B_w (one per output), in the outputs' units. NaN means no data.
        """
        columns = {k: self._bounds[k] for k in ("frames", "excitation", "gamma_w", "nu", "B_w")}
        return self._table(columns | {"frames": columns["frames"].astype(int)})

    @property
    def weights(self) -> pandas.DataFrame:
        """Table of the frame test's W_delta and B_w with final inflation, one row per bin. Needs pandas.

        They belong to the healthy set, or to the certificate's set if there is no healthy set.
        """
        return self._table(dict(zip(("W_delta", "B_w"), self.fitted.of_frames(self.omega), strict=True)))

    @property
    def threshold(self) -> float:
        """Threshold on t* of the frame test in the core."""
        return self.calibration.carried

    @property
    def claim(self) -> str:
        """Sentence on what the threshold promises, or on why it promises nothing."""
        return self.calibration.claim()

    def save(self, folder: str | Path) -> Identified:
        """Write the folder of `lpvguard identify` as a whole; an error leaves no part of it.

        Parameters
        ----------
        folder : str or Path

        Returns
        -------
        Identified, as stored

        Raises
        ------
        InputError
            If the folder may not be replaced.
        """
        if self._found is None:
            raise ValueError(f"it is already stored in {self.folder}")
        stage.save(*self._found, Path(folder))
        return load(folder)

    def export(
        self, folder: str | Path, *, controller: str | Path | None = None, group: str | None = None
    ) -> Path:
        """Write the generated C folder of `lpvguard export`.

        Parameters
        ----------
        folder : str or Path
        controller : str or Path, optional, controller.json or the folder of `design`
            Its certificates are proved again.
        group : str, optional, group of drives whose thresholds are exported
            By default the largest of all groups.

        Returns
        -------
        Path, the folder

        Raises
        ------
        InputError
            If the controller or the group does not fit.
        """
        chosen = None if controller is None else Path(controller)
        with self.opened() as stored:
            export_chosen(stored, Path(folder), chosen, group)
        return Path(folder)

    @contextmanager
    def opened(self) -> Iterator[stage.StoredIdentification]:
        """Open the stored or a temporary folder and prove again that every weight lies above its bound.

        Yields
        ------
        stage.StoredIdentification
        """
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


def identify_drives(
    vehicle: str | Path | Project, drives: str | Path, *, jobs: int = 1, scheduler: str | None = None
) -> Identified:
    """Find bounds, weights and thresholds, as `lpvguard identify` does.

    Parameters
    ----------
    vehicle : str, Path or Project, shipped vehicle's name, path of a project file, or a project
    drives : str or Path, folder with experiments.csv
    jobs : int, processes that share the drives, default 1
    scheduler : str, optional, address of a Dask scheduler whose workers share them

    Returns
    -------
    Identified

    Raises
    ------
    InputError
        If an input does not fit; it names file, place and what was expected.
    """
    project = project_of(vehicle)
    with workers(jobs, scheduler) as run:
        identified = stage.identify(project, Path(drives), workers=run)
    result, b = identified[0], identified[0].bounds
    return Identified(project, None, b.omega, result.weights, result.calibration, vars(b), identified)


def load(folder: str | Path) -> Identified:
    """Read the folder of `lpvguard identify` and prove again that every weight lies above its bound.

    Parameters
    ----------
    folder : str or Path

    Returns
    -------
    Identified

    Raises
    ------
    InputError
        If a file was changed.
    """
    stored = stage.load(Path(folder))
    omega = stored.estimator.omega
    return Identified(stored.project, stored.folder, omega, stored.fitted, stored.calibration, stored.bounds)
