"""Drives of an identification and their roles."""

from __future__ import annotations

from collections.abc import Collection, Iterable, Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from ..base.errors import InputError
from ..drives.tables import EXPERIMENTS, Drive, Experiment, bound_setting, list_experiments, set_aside
from ..vehicle.nominal import NominalModel
from ..vehicle.project import Project
from .calibration import FEWEST_FOR_ALPHA
from .passes import DriveReader


class DriveSet:
    """The used drives of a folder, which are read on request.

    Parameters
    ----------
    project : Project
    model : NominalModel
    folder : Path, folder with experiments.csv
    without : Collection[str], drives to leave out, default ()

    Attributes
    ----------
    folder : Path
    experiments : dict[str, Experiment], by name, in the order of experiments.csv
    set_aside : dict[str, str], by drive, the reason in experiments.csv
    """

    def __init__(self, project: Project, model: NominalModel, folder: Path, without: Collection[str] = ()):
        self.folder = Path(folder)
        self.reader = DriveReader(project, model)
        listed = list_experiments(self.folder)
        self.experiments = {e.name: e for e in listed if e.name not in without}
        self.set_aside = set_aside(self.folder)

    def load(self, name: str) -> tuple[Drive, np.ndarray, np.ndarray]:
        """The drive, its nominal error e and nominal output yhat (N, n_y)."""
        return self.reader.read(self.experiments[name])

    def error(self, where: str, what: str, expected: str) -> InputError:
        """An InputError about the drives, for the caller to raise."""
        return InputError(self.folder, where, what, expected)

    def index_error(self, what: str, expected: str) -> InputError:
        """An InputError about the column split of experiments.csv, for the caller to raise."""
        return InputError(self.folder / EXPERIMENTS, "column split", what, expected)


@dataclass(frozen=True)
class Chosen:
    """Drives by role: ``setting`` set the bounds, ``noise`` have no input, and ``others`` calibrate."""

    setting: list[Experiment]
    noise: list[Experiment]
    others: list[Experiment]

    @classmethod
    def by_split(cls, drives: DriveSet) -> Chosen:
        """Roles by the column split of experiments.csv. Raises InputError when no drive sets the bounds."""
        project, experiments = drives.reader.project, list(drives.experiments.values())
        setting = bound_setting(project, experiments, drives.folder)
        noise = [e for e in experiments if e.split in project.data.noise_split]
        return cls(setting, noise, [e for e in experiments if e not in setting and e not in noise])


def require_calibration(
    drives: DriveSet, calibrating: Iterable[str], left_out: Mapping[str, str], judged: bool
) -> None:
    """Raise InputError where nothing calibrates, because a threshold without a drive has no measured basis.

    Then there is no calibration drive, or no test has ``judged`` one. ``calibrating`` are the drives that
    neither set the bounds nor lack an input. ``left_out`` maps a drive to the reason why it has no frame.
    """
    names = list(calibrating)
    if not names:
        raise drives.index_error(
            "no drive calibrates: every drive sets the bounds or has no input",
            f"at least one drive of another split; alpha needs at least {FEWEST_FOR_ALPHA} recordings",
        )
    if not judged:
        reason = next((f"{n}: {left_out[n]}" for n in names if n in left_out), "every bin is silent")
        raise drives.error(
            f"drives that calibrate ({len(names)})",
            f"no drive calibrates: no test judges one ({reason})",
            "at least one drive with a frame in a bin that is not silent, or with settled driving",
        )
