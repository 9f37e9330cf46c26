"""How well the nominal model explains the drives that set the bounds. Bounds around a model that is worse
than none say nothing of the vehicle."""

from __future__ import annotations

from pathlib import Path

from ..base.errors import InputError
from ..drives.tables import Experiment
from ..fit.quality import POOR_VAF, Quality, of_drive, pooled_vaf
from ..vehicle.project import Project
from .passes import DriveReader


def drive_fit(reader: DriveReader, experiment: Experiment) -> Quality:
    """What the model explains of one drive."""
    drive, _, yhat = reader.read(experiment)
    return of_drive(reader.model, drive, yhat, [])


def require_better_than_none(project: Project, found: list[Quality], folder: Path) -> None:
    """InputError where the model leaves more of an output than there is, over all drives together."""
    for signal, vaf in zip(project.outputs, pooled_vaf(found), strict=True):
        if vaf < 0:
            raise InputError(
                folder,
                f"output {signal.name}",
                f"the model is worse than none: it leaves {1 - vaf:.0%} of the variance of the bound-setting "
                "drives",
                "a model of these drives; `lpvguard fit` fits it, and names wrong signs, units or delays",
            )


def sentences(project: Project, found: list[Quality]) -> list[str]:
    """A line a drive, and a warning where the model is poor."""
    lines = []
    for q in found:
        for j, signal in enumerate(project.outputs):
            poor = "; poor: try lpvguard fit" if q.vaf[j] < POOR_VAF else ""
            lines.append(
                f"{q.name}: the model explains {q.vaf[j]:.2%} of {signal.name}, gain {q.gain[j]:.3f}{poor}"
            )
    return lines
