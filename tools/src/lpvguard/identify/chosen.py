"""Drives of an identification by their role."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from ..drives.tables import Drive, Experiment, bound_setting
from ..vehicle.nominal import NominalModel
from ..vehicle.project import Project
from .passes import DriveReader


class DriveSet:
    """Drives of a folder, read on request.

    Parameters
    ----------
    project : Project
    model : NominalModel
    experiments : list[Experiment]
    """

    def __init__(self, project: Project, model: NominalModel, experiments: list[Experiment]):
        self.reader = DriveReader(project, model)
        self.experiments = {e.name: e for e in experiments}

    def load(self, name: str) -> tuple[Drive, np.ndarray, np.ndarray]:
        """The drive, its nominal error e and nominal output yhat (N, n_y)."""
        return self.reader.read(self.experiments[name])


@dataclass(frozen=True)
class Chosen:
    """Drives by role: those that set the bounds, those without input, and all others, which calibrate."""

    setting: list[Experiment]
    noise: list[Experiment]
    others: list[Experiment]

    @classmethod
    def by_split(cls, project: Project, experiments: list[Experiment], folder: Path) -> Chosen:
        """Roles by the column split of the index; InputError when no drive sets the bounds."""
        setting = bound_setting(project, experiments, folder)
        noise = [e for e in experiments if e.split in project.data.noise_split]
        return cls(setting, noise, [e for e in experiments if e not in setting and e not in noise])
