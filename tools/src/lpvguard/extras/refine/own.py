"""Own gains: what each vehicle of a fleet answers to its inputs, beside the known drives.

Vehicles of a fleet differ by their loads. A healthy set of all loads does not see a fault that is as large as
the loads. The outputs of a vehicle's drives are therefore divided by its own gains before they are judged or
learnt. The gains come from the drives that were learnt first of the vehicle. No later drive moves them, so a
slow change stays visible beside them.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import asdict, dataclass, field, replace
from functools import partial
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
from scipy.stats import t as student

from ...base import artefacts
from ...base.errors import InputError
from ...base.parallel import Map
from ...drives.tables import Drive, Experiment, write_divided
from ...replay.replayer import Replayer
from ...vehicle.project import Project
from ..fleet.scores import DriveEstimate, ScoredDrive, scored

RISK = 1e-3
"""Probability that drives are learnt of a vehicle that changed by the tolerance."""
MOST = 5.0
"""Largest own gain; the smallest is its inverse."""
Estimates = Sequence[tuple[DriveEstimate, ...]]


def estimated(first: Replayer, drive: Drive) -> tuple[DriveEstimate, ...]:
    """Estimates of a whole drive, relative to the first identification's model."""
    samples = len(drive.t)
    return scored(first, drive.name, [ScoredDrive.from_drive(first, drive, samples)], samples).estimates


def estimated_file(first: Replayer, experiment: Experiment) -> tuple[DriveEstimate, ...]:
    """Estimates of a drive's file."""
    return estimated(first, first.read_file(experiment.path).drive)


def responses(estimates: Estimates) -> np.ndarray:
    """Gains (N, n_y) of drives, relative to the first identification's model."""
    return np.array([[1 + e.gain for e in drive] for drive in estimates])


@dataclass(frozen=True)
class OwnGain:
    """Gains of a vehicle by output, and the number of drives behind them."""

    gain: tuple[float, ...]
    drives: int


@dataclass(frozen=True)
class OwnGains:
    """Own gains of the vehicles of a lineage, relative to ``known``.

    ``known`` is the mean gain of the first calibrating drives, by output.
    """

    known: tuple[float, ...] = ()
    vehicles: Mapping[str, OwnGain] = field(default_factory=dict)

    @classmethod
    def read(cls, path: Path) -> OwnGains:
        """Read a file of `text`."""
        data = artefacts.read_json(path)
        vehicles = {v: OwnGain(tuple(own["gain"]), own["drives"]) for v, own in data["vehicles"].items()}
        return cls(tuple(data["known"]), vehicles)

    @property
    def text(self) -> str:
        """The gains as JSON."""
        return artefacts.to_json(asdict(self))

    def joined(self, vehicle: str, first: Estimates) -> OwnGains:
        """Add a vehicle, whose first learnt drives have the estimates ``first``.

        Raises InputError for gains beyond MOST.
        """
        gain = tuple(map(float, responses(first).mean(axis=0) / self.known))
        if not all(1 / MOST <= g <= MOST for g in gain):
            raise InputError(
                f"drives of {vehicle}",
                "own gains",
                ", ".join(f"{g:.3g}" for g in gain),
                f"{1 / MOST:g} to {MOST:g} times the known drives': first drives that excite the vehicle",
            )
        return replace(self, vehicles={**self.vehicles, vehicle: OwnGain(gain, len(first))})

    @contextmanager
    def divided(
        self,
        project: Project,
        experiments: Sequence[Experiment],
        vehicle: Mapping[str, str],
        beside: Path,
        workers: Map = map,
    ) -> Iterator[list[Experiment]]:
        """Yield drives whose tables are divided by the gains of their vehicles, in a folder ``beside``.

        Drives of other vehicles stay as they are. The folder is removed at the end.
        """
        with TemporaryDirectory(dir=beside) as folder:
            own = [self.vehicles.get(vehicle[e.name]) for e in experiments]
            divide = partial(_divided, project, Path(folder))
            yield list(workers(divide, list(zip(experiments, own, strict=True))))

    def changes(self, estimates: Estimates) -> np.ndarray:
        """Changes (N, n_y) of the gain on divided drives; -0.3: 30 % below the vehicle's first drives."""
        return responses(estimates) / self.known - 1


def _divided(project: Project, folder: Path, drive: tuple[Experiment, OwnGain | None]) -> Experiment:
    experiment, own = drive
    if own is None:
        return experiment
    path = folder / f"{experiment.name}.parquet"
    write_divided(experiment.path, path, project, own.gain)
    return replace(experiment, path=path)


def mean_changes(
    own: OwnGains, estimates: Mapping[str, Estimates]
) -> dict[str, tuple[np.ndarray, np.ndarray]]:
    """Mean change (n_y,) of each vehicle with own gains since its first drives, and its uncertainty (n_y,).

    The uncertainty covers a mean with probability 1 - RISK on either side. It follows from the spread between
    drives of one vehicle, which is taken to be the same for all vehicles. ``estimates`` holds those of
    divided drives by vehicle.
    """
    changes = {v: own.changes(e) for v, e in estimates.items() if v in own.vehicles}
    if not changes:
        return {}
    free = sum(len(c) - 1 for c in changes.values())
    squares = sum(((c - c.mean(axis=0)) ** 2).sum(axis=0) for c in changes.values())
    spread = np.sqrt(squares / free) if free else np.full(len(own.known), np.inf)
    quantile = float(student.ppf(1 - RISK, max(free, 1)))
    return {
        v: (c.mean(axis=0), quantile * spread * np.sqrt(1 / len(c) + 1 / own.vehicles[v].drives))
        for v, c in changes.items()
    }
