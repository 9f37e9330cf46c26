"""Drives that the nominal model does not explain, and their cost.

Such a drive (a slide, a crash, the wrong day or car) is bounded like every other: the bounds hold on it, and
grow. Nothing is left out in silence. A user who finds that the model is not meant for the drive sets it aside
in experiments.csv, with the reason.
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
"""Least explained share of an output's variance; below it a drive is called unexplained."""


@dataclass(frozen=True)
class Unexplained:
    """A drive of which the model explains less than UNEXPLAINED_VAF of an output.

    Attributes
    ----------
    name : str
    sets_bounds : bool, the drive sets the bounds; otherwise it calibrates
    output : str
    vaf : float, explained share of the output's variance
    gain : float
    """

    name: str
    sets_bounds: bool
    output: str
    vaf: float
    gain: float

    def sentence(self) -> str:
        """Sentence with the drive, its role and the reason."""
        left = f"the model leaves {1 - self.vaf:.0%} of {self.output}"
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
    """Judge a drive by its worst output.

    Parameters
    ----------
    project : Project
    quality : Quality, of the drive
    sets_bounds : bool, otherwise it calibrates

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
    """Injected faults in the remaining drives: their ``total``, and how many alarm.

    ``alarmed`` alarm with the bounds of all drives, ``alarmed_without`` with those of the other drives alone.
    """

    names: tuple[str, ...]
    alarmed: int
    alarmed_without: int
    total: int

    def to_dict(self) -> dict[str, Any]:
        """Object of the JSON of `identify`."""
        return {
            "names": self.names,
            "found": self.alarmed,
            "found_without": self.alarmed_without,
            "of": self.total,
        }

    def sentences(self) -> list[str]:
        """Cost of the drives, and the lines of experiments.csv that set them aside."""
        these = "it" if len(self.names) == 1 else "them"
        return [
            f"with {these}, {self.alarmed} of {self.total} faults as evaluate injects them alarm in the "
            f"drives that calibrate; without {these}, {self.alarmed_without}",
            f"where the model is not meant for {these}: write no and why into the columns use and reason of "
            f"{EXPERIMENTS}, then fit and identify again",
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

    Every fault of the project's settings is injected into each calibration drive, from its first sample on. A
    frozen output begins after a third of the drive.

    Parameters
    ----------
    result : Identification
    folder : Path, drives
    named : list of Unexplained
    workers : Map
    progress : Callable, reports progress

    Returns
    -------
    Cost, or None if too little remains to identify from, or without a core
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
    coefficients = coefficients_of(
        result.project, result.model, result.estimator, result.weights, carried, result.energy, result.change
    )
    with scratch_core(result.project, coefficients) as core:
        return sum(workers(partial(_alarms_of_drive, reader, core, settings), known))


def _alarms_of_drive(
    reader: DriveReader, core: Core, settings: EvaluationSettings, experiment: Experiment
) -> int:
    """Number of faults that alarm in a drive; 0 where it alarms untouched."""
    drive, Ts = reader.read(experiment)[0], reader.estimator.Ts
    if is_alarming(core.monitor().run_drive(drive).verdict).any():
        return 0
    faults = stated(settings, drive.y.std(axis=0))
    starts = [drive.duration_s / 3 if f.kind == "freeze" else 0.0 for f in faults]
    return sum(
        bool(is_alarming(core.monitor().run_drive(inject(drive, f, start, Ts)).verdict).any())
        for f, start in zip(faults, starts, strict=True)
    )
