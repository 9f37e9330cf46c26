"""Drives that the nominal model does not explain, and their cost.

Such a drive may contain a slide or a crash, or belong to another day or car. It counts like every other
drive: the bounds hold for it and therefore grow. No drive is left out automatically. A user can set a drive
aside in experiments.csv, with a reason, if the model is not meant for it.
"""

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from ..base.errors import InputError
from ..base.parallel import Map
from ..core.compiled import Core, is_alarming
from ..drives.faults import inject, stated
from ..drives.frames import not_for_the_core
from ..drives.tables import EXPERIMENTS, Experiment
from ..fit.quality import Quality
from ..vehicle.project import EvaluationSettings, Project
from .identification import Identification, identify
from .passes import DriveReader
from .scratch import scratch_core
from .weights import coefficients_of

UNEXPLAINED_VAF = 0.5
"""A drive is unexplained if the model explains less than this share of the variance of an output."""


@dataclass(frozen=True)
class Unexplained:
    """A drive with an output of which the model explains less than UNEXPLAINED_VAF.

    Attributes
    ----------
    name : str
    sets_bounds : bool, whether the drive sets the bounds; otherwise it calibrates
    output : str, the worst output
    vaf : float, explained share of its variance
    gain : float, gain of the output relative to the model
    """

    name: str
    sets_bounds: bool
    output: str
    vaf: float
    gain: float

    def sentence(self) -> str:
        """Sentence with the drive, its role and the reason."""
        left = f"the model leaves {1 - self.vaf:.0%} of {self.output} unexplained"
        gain = f", gain {self.gain:.3f}" if np.isfinite(self.gain) else ""
        return f"{self.name} {'sets the bounds' if self.sets_bounds else 'calibrates'}, and {left}{gain}"


def unexplained(result: Identification) -> list[Unexplained]:
    """Find the unexplained drives among those that set the bounds or calibrate.

    Parameters
    ----------
    result : Identification

    Returns
    -------
    list of Unexplained, each with its worst output
    """
    drives = []
    judged = {*result.bound_drives, *result.calibration_drives}
    for sets_bounds, qualities in ((True, result.model_fit), (False, result.others_fit)):
        for q in qualities:
            one = left_unexplained(result.project, q, sets_bounds) if q.name in judged else None
            if one is not None:
                drives.append(one)
    return drives


def left_unexplained(project: Project, quality: Quality, sets_bounds: bool) -> Unexplained | None:
    """Return the drive if the model does not explain its worst output.

    Parameters
    ----------
    project : Project
    quality : Quality, of the drive
    sets_bounds : bool, whether the drive sets the bounds; otherwise it calibrates

    Returns
    -------
    Unexplained, or None if the model explains the drive
    """
    if np.isnan(quality.vaf).all():
        return None
    j = int(np.nanargmin(quality.vaf))
    if quality.vaf[j] >= UNEXPLAINED_VAF:
        return None
    signal = project.outputs[j].name
    return Unexplained(quality.name, sets_bounds, signal, float(quality.vaf[j]), float(quality.gain[j]))


@dataclass(frozen=True)
class Cost:
    """Numbers of faults that are injected into the remaining drives, and of those that alarm.

    ``total`` faults are injected. ``alarmed`` of them alarm with the bounds of all drives, and
    ``alarmed_without`` with the bounds of the other drives alone.
    """

    names: tuple[str, ...]
    alarmed: int
    alarmed_without: int
    total: int

    def to_dict(self) -> dict[str, Any]:
        """Convert to JSON types, for the output of `identify`."""
        return {
            "names": self.names,
            "found": self.alarmed,
            "found_without": self.alarmed_without,
            "of": self.total,
        }

    def sentences(self) -> list[str]:
        """Sentences on the cost of the drives, and on how to set them aside."""
        these = "it" if len(self.names) == 1 else "them"
        return [
            f"with {these}, {self.alarmed} of {self.total} faults that evaluate injects into the drives that "
            f"calibrate raise an alarm; without {these}, {self.alarmed_without} do",
            f"if the model is not meant for {these}: write no into the column use of {EXPERIMENTS}, and the "
            "reason into the column reason, then fit and identify again",
        ]


def cost(
    result: Identification,
    folder: Path,
    named: list[Unexplained],
    *,
    workers: Map = map,
    progress: Callable[[str], None] = lambda _: None,
) -> Cost | None:
    """Compute the cost of unexplained drives by an identification without them.

    Each fault of the project settings is injected into each calibration drive from the first sample on. Only
    a frozen output begins after a third of the drive.

    Parameters
    ----------
    result : Identification
    folder : Path, folder of the drives
    named : list of Unexplained
    workers : Map
    progress : Callable, reports progress

    Returns
    -------
    Cost, or None
        None without a core, or if the other drives are not enough for an identification.
    """
    names = tuple(u.name for u in named)
    settings = result.project.evaluation
    try:
        other, drives = identify(
            result.project,
            folder,
            workers=workers,
            progress=lambda text: progress(f"again, {text}"),
            without=names,
        )
        known = [drives.experiments[n] for n in other.calibration_drives]
        counts = [_alarms(r, known, settings, workers) for r in (result, other)]
    except InputError:
        return None
    faults = len(stated(settings, np.zeros(result.project.n_y)))
    return Cost(names, counts[0], counts[1], faults * len(known)) if known else None


def _alarms(
    result: Identification, known: list[Experiment], settings: EvaluationSettings, workers: Map
) -> int:
    if result.energy is None or result.change is None:
        raise not_for_the_core(result.project)
    reader, carried = DriveReader(result.project, result.model), result.calibration.exported
    project = result.project
    if result.confirmation is not None:
        project = result.confirmation.of_project(project)
    coefficients = coefficients_of(
        project, result.model, result.estimator, result.weights, carried, result.energy, result.change
    )
    with scratch_core(result.project, coefficients) as core:
        return sum(workers(partial(_alarms_of_drive, reader, core, settings), known))


def _alarms_of_drive(
    reader: DriveReader, core: Core, settings: EvaluationSettings, experiment: Experiment
) -> int:
    """Number of faults that alarm in a drive, 0 where the drive alarms without a fault."""
    drive, Ts = reader.read(experiment)[0], reader.estimator.Ts
    if is_alarming(core.monitor().run_drive(drive).verdict).any():
        return 0
    faults = stated(settings, drive.y.std(axis=0))
    starts = [drive.duration_s / 3 if f.kind == "freeze" else 0.0 for f in faults]
    return sum(
        bool(is_alarming(core.monitor().run_drive(inject(drive, f, start, Ts)).verdict).any())
        for f, start in zip(faults, starts, strict=True)
    )
