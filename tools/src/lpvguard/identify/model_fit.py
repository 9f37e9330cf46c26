"""Quality of the nominal model on the drives that set the bounds.

Bounds around a model that is worse than none say nothing about the vehicle.
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
    """Raise InputError where the model leaves more of an output than its variance, over all drives
    together."""
    for signal, vaf in zip(drives.reader.project.outputs, pooled_vaf(qualities), strict=True):
        if vaf < 0:
            raise drives.error(
                f"output {signal.name}",
                f"the model is worse than none: it leaves {1 - vaf:.0%} of the variance of the bound-setting "
                "drives",
                "a model of these drives; `lpvguard fit` fits it, and names wrong signs, units or delays",
            )


def evidence(
    omega: np.ndarray, frames: np.ndarray, length: np.ndarray, Ts: float, qualities: list[Quality]
) -> list[str]:
    """Word the share of driving in counted frames, a line a bin above DC.

    The line also has the number of successive frames.

    Parameters
    ----------
    omega : ndarray (K,), rad/s
    frames : ndarray (K,) of int, counted frames at every start
    length : ndarray (K,) of int, samples of a frame
    Ts : float, s
    qualities : list of Quality, of the bound-setting drives

    Returns
    -------
    list of str
    """
    in_range_s = sum(q.judged_s for q in qualities)
    return [
        f"{w:.3g} rad/s: {n * Ts:.0f} of {in_range_s:.0f} s in range count, {n / m:.0f} frames of "
        f"{m * Ts:.3g} s one after another"
        for w, n, m in zip(omega, frames, length, strict=True)
        if w > 0
    ]


def sentences(project: Project, qualities: list[Quality]) -> list[str]:
    """Word the quality, a line a drive, with a warning for a poor model.

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
