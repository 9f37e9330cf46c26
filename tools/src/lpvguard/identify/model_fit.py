"""Quality of the nominal model on the drives that set the bounds.

Bounds are useless if the model explains the drives worse than no model does.
"""

import numpy as np

from ..drives.tables import Experiment
from ..fit.quality import POOR_VAF, Quality, of_drive, pooled_vaf
from ..vehicle.project import Project
from .drive_set import DriveSet
from .passes import DriveReader


def drive_fit(reader: DriveReader, experiment: Experiment) -> Quality:
    """Quality of the model on one drive."""
    drive, _, yhat = reader.read(experiment)
    return of_drive(reader.model, drive, yhat, [])


def require_better_than_none(drives: DriveSet, qualities: list[Quality]) -> None:
    """Raise InputError if the error of an output exceeds its variance, over all drives together."""
    for signal, vaf in zip(drives.reader.project.outputs, pooled_vaf(qualities), strict=True):
        if vaf < 0:
            raise drives.error(
                f"output {signal.name}",
                f"the model is worse than no model: its error has {1 - vaf:.0%} of the variance of the "
                "bound-setting drives",
                "a model of these drives; `lpvguard fit` fits one, and names wrong signs, units or delays",
            )


def evidence(
    omega: np.ndarray, frames: np.ndarray, length: np.ndarray, Ts: float, qualities: list[Quality]
) -> list[str]:
    """Describe the share of driving in counted frames, with one line for each bin above DC.

    The line also has the number of successive frames.

    Parameters
    ----------
    omega : ndarray (K,), rad/s
    frames : ndarray (K,) of int, number of counted frames over all starts
    length : ndarray (K,) of int, length of a frame in samples
    Ts : float, s
    qualities : list of Quality, one for each bound-setting drive

    Returns
    -------
    list of str
    """
    in_range_s = sum(q.judged_s for q in qualities)
    return [
        f"{w:.3g} rad/s: {n * Ts:.0f} of {in_range_s:.0f} s in range count, {n / m:.0f} successive frames "
        f"of {m * Ts:.3g} s"
        for w, n, m in zip(omega, frames, length, strict=True)
        if w > 0
    ]


def sentences(project: Project, qualities: list[Quality]) -> list[str]:
    """Describe the quality with one line for each drive, and a warning for a poor model.

    Parameters
    ----------
    project : Project
    qualities : list of Quality

    Returns
    -------
    list of str
    """
    lines = []
    for q in qualities:
        for j, signal in enumerate(project.outputs):
            poor = "; poor: try lpvguard fit" if q.vaf[j] < POOR_VAF else ""
            lines.append(
                f"{q.name}: the model explains {q.vaf[j]:.2%} of {signal.name}, gain {q.gain[j]:.3f}{poor}"
            )
    return lines
