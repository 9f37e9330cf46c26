"""Drives of an identification by their role."""

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
    """Drives of a folder that are in use, read on request.

    Parameters
    ----------
    project : Project
    model : NominalModel
    folder : Path, with experiments.csv
    without : Collection[str], drives to leave out, default ()

    Attributes
    ----------
    folder : Path
    experiments : dict[str, Experiment], by name, in the order of the index
    set_aside : dict[str, str], reason that the index states, by drive
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
        """An InputError about the drives, ready to raise."""
        return InputError(self.folder, where, what, expected)

    def index_error(self, what: str, expected: str) -> InputError:
        """An InputError about the column split of the index, ready to raise."""
        return InputError(self.folder / EXPERIMENTS, "column split", what, expected)


@dataclass(frozen=True)
class Chosen:
    """Drives by what they are for: those that set the bounds, those without input, and all others, which
    calibrate."""

    setting: list[Experiment]
    noise: list[Experiment]
    others: list[Experiment]

    @classmethod
    def by_split(cls, drives: DriveSet) -> Chosen:
        """By the column split of the index; InputError when no drive sets the bounds."""
        project, experiments = drives.reader.project, list(drives.experiments.values())
        setting = bound_setting(project, experiments, drives.folder)
        noise = [e for e in experiments if e.split in project.data.noise_split]
        return cls(setting, noise, [e for e in experiments if e not in setting and e not in noise])


def require_calibration(
    drives: DriveSet, calibrating: Iterable[str], left_out: Mapping[str, str], judged: bool
) -> None:
    """InputError where nothing calibrates: there is no drive to do so, or no test has ``judged`` any.

    ``calibrating``: all but those that set the bounds or are without input. ``left_out``: drive -> why it has
    no frame. A threshold without a drive would be a number that nobody measured.
    """
    names = list(calibrating)
    if not names:
        raise drives.index_error(
            "nothing calibrates: every drive sets the bounds or is without input",
            f"at least one drive of another split; alpha is stated from {FEWEST_FOR_ALPHA} recordings on",
        )
    if not judged:
        reason = next((f"{n}: {left_out[n]}" for n in names if n in left_out), "every bin is silent")
        raise drives.error(
            f"drives that calibrate ({len(names)})",
            f"nothing calibrates: no test judges a drive ({reason})",
            "at least one with a frame of a bin that speaks, or with settled driving for the other tests",
        )
