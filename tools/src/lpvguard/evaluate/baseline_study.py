"""The baselines (baselines.py) tuned, calibrated and evaluated on the drives of an identification.

A baseline gets the same drives, residuals, calibration drives and alpha as the monitor. Its parameters are
those that find most injected faults (then soonest) on the bound-setting and the other calibration drives. The
drive under test takes part in nothing, whether it was left out or never seen by the identification.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass
from functools import partial

import numpy as np

from ..base.parallel import Map
from ..core.compiled import Core
from ..drives.tables import Experiment
from ..identify.bounds import nominal_error
from ..identify.calibration import Calibration, calibrate
from ..identify.passes import DriveReader
from ..identify.run import DriveSet, StoredIdentification
from ..replay.run import Replayer
from .baselines import GRID, KINDS, TITLES, Bank, Baseline, Scales
from .detection import FaultOutcome, Injection, fault_rows, faulty_drive
from .false_alarms import false_alarms, piece_starts


def _usable_errors(reader: DriveReader, experiment: Experiment) -> tuple[np.ndarray, np.ndarray]:
    drive, e, _ = reader.read(experiment)
    usable = reader.estimator.settled(drive.v)
    return e[usable], drive.u[usable]


def _largest(
    reader: DriveReader, bank: Bank, baselines: Iterable[Baseline], experiment: Experiment
) -> dict[Baseline, np.ndarray]:
    """Largest statistic of each of the ``baselines`` in each 60 s piece (piece_starts)."""
    drive, e, _ = reader.read(experiment)
    starts = piece_starts(len(drive.v), reader.project.Ts_s)
    return {b: np.maximum.reduceat(s, starts) for b, s in bank.statistics(baselines, e, drive.v)}


Cases = dict[tuple[Baseline, float], dict[str, list[FaultOutcome]]]
"""Of one drive: per baseline and threshold, and fault, what became of it from every start."""


def _cases(
    reader: DriveReader,
    core: Core,
    bank: Bank,
    thresholds: dict[Baseline, tuple[float, ...]],
    injection: Injection,
    experiment: Experiment,
) -> Cases:
    """Every baseline at each of its thresholds on one drive; empty where the drive does not qualify."""
    drive, e, _ = reader.read(experiment)
    Ts = reader.project.Ts_s
    clocks = injection.clocks(Replayer(reader.project, core).replay(drive), reader.project.seed)
    if not clocks:
        return {}

    def alarms(error: np.ndarray, v: np.ndarray):
        return (((b, h), s > h) for b, s in bank.statistics(thresholds, error, v) for h in thresholds[b])

    first = {key: [clock.read(hits) for clock in clocks] for key, hits in alarms(e, drive.v)}
    cases: Cases = {key: {f.label: [] for f in injection.faults} for key in first}
    for i, clock in enumerate(clocks):
        for fault in injection.faults:
            faulty = faulty_drive(drive, fault, clock, Ts)
            for key, hits in alarms(nominal_error(faulty, reader.model)[0], faulty.v):
                cases[key][fault.label].append(
                    FaultOutcome.of(experiment.name, Ts, clock, hits, first[key][i])
                )
    return cases


@dataclass(frozen=True)
class OnDrives:
    """What baselines make of drives, by drive: their largest statistic in each 60 s piece, and what became of
    faults."""

    largest: dict[str, dict[Baseline, np.ndarray]]
    cases: dict[str, Cases]

    def alarmed_pieces(self, b: Baseline, threshold: float, name: str) -> tuple[int, int]:
        """(alarmed, all) 60 s pieces of an untouched drive."""
        pieces = self.largest[name][b]
        return int((pieces > threshold).sum()), len(pieces)


class BaselineStudy:
    """The baselines on the drives of an identification: scores, thresholds, searched parameters."""

    def __init__(
        self,
        stored: StoredIdentification,
        drives: DriveSet,
        core: Core,
        *,
        left_out: tuple[str | None, ...],
        injection: Injection,
        workers: Map = map,
        progress: Callable[[str], None] = lambda _: None,
    ):
        """``left_out``: the drives that will be asked about, None for "all calibration drives count".
        ``injection``: the faults to choose parameters by.

        Of the bound-setting drives those count whose input is a command as in use (``data.command_split``).
        """
        groups, reader = stored.manifest["drives"], drives.reader
        used = stored.project.data.command_splits
        setting = [n for n in groups["bounds"] if drives.experiments[n].split in used]
        self.alpha, self.calibration_drives = stored.project.frame_test.alpha, list(stored.calibration.scores)
        self.recordings, self.injection = stored.calibration.recordings, injection
        self.reader, self.core, self.workers, self.progress = reader, core, workers, progress
        chosen = [drives.experiments[n] for n in (*setting, *self.calibration_drives)]
        self.bank = Bank(
            reader.model,
            reader.estimator,
            Scales.of(workers(partial(_usable_errors, reader), [drives.experiments[n] for n in setting])),
        )
        self.largest = self._over(partial(_largest, reader, self.bank, GRID), chosen, "baselines")
        thresholds = {
            b: tuple(sorted({self.calibration(b, name).threshold for name in left_out})) for b in GRID
        }
        self.cases = self._cases(chosen, thresholds)

    def _over(self, task: Callable, chosen: list[Experiment], what: str) -> dict:
        """``task`` of every chosen drive, by name."""
        results = {}
        for e, result in zip(chosen, self.workers(task, chosen), strict=False):
            self.progress(f"{what} of {e.name}")
            results[e.name] = result
        return results

    @property
    def own(self) -> OnDrives:
        """The baselines on the study's own drives."""
        return OnDrives(self.largest, self.cases)

    def on(self, further: list[Experiment]) -> OnDrives:
        """The best of each kind, tuned and calibrated on all own drives, on ``further`` ones."""
        tuned: dict[Baseline, tuple[float, ...]] = {b: (h,) for b, h in map(self.best, KINDS)}
        largest = self._over(partial(_largest, self.reader, self.bank, tuple(tuned)), further, "baselines")
        return OnDrives(largest, self._cases(further, tuned))

    def _cases(
        self, chosen: list[Experiment], thresholds: dict[Baseline, tuple[float, ...]]
    ) -> dict[str, Cases]:
        """What becomes of faults in the chosen drives, at each of the thresholds."""
        task = partial(_cases, self.reader, self.core, self.bank, thresholds, self.injection)
        return self._over(task, chosen, "baselines on faults")

    def calibration(self, b: Baseline, without: str | None = None) -> Calibration:
        """Conformal threshold from the calibration drives but the recording of ``without``; drives on which
        it never spoke give no score, and without any score it never alarms."""
        others = self.recordings.others(self.calibration_drives, without)
        scores = {n: float(self.largest[n][b].max()) for n in others}
        spoken = {n: s for n, s in scores.items() if np.isfinite(s)}
        floor = 0.0 if spoken else np.inf
        return calibrate(spoken, self.alpha, floor=floor, recordings=self.recordings)

    def best(self, kind: str, without: str | None = None) -> tuple[Baseline, float]:
        """The parameters of ``kind`` that find most faults, then soonest, on all drives but the recording of
        ``without``; with their threshold."""

        def merit(b: Baseline) -> tuple[int, float]:
            key = b, self.calibration(b, without).threshold
            cases = [
                c
                for name in self.recordings.others(self.cases, without)
                if (table := self.cases[name])
                for of in table[key].values()
                for c in of
            ]
            late = self.injection.within_s
            return sum(c.found for c in cases), -sum(late if c.s is None else c.s for c in cases)

        b = max((b for b in GRID if b.kind == kind), key=merit)
        return b, self.calibration(b, without).threshold


def evaluate_baselines(study: BaselineStudy, rows: list[dict], further: OnDrives | None = None) -> list[dict]:
    """Per kind: false alarms, parameters chosen, and per fault its cases, on the drives of ``rows``; each
    drive with what was tuned without it. ``further``: on drives that are none of the study's."""
    table: list[dict] = []
    on = further or study.own
    for kind in KINDS:
        without = {r["run"]: None if further else r["run"] for r in rows}
        tuned = {run: study.best(kind, name) for run, name in without.items()}
        counts = [on.alarmed_pieces(*key, run) for run, key in tuned.items()]
        cases = {
            f.label: [c for run, key in tuned.items() if on.cases[run] for c in on.cases[run][key][f.label]]
            for f in study.injection.faults
        }
        table.append(
            {
                "kind": kind,
                "title": TITLES[kind],
                "searched": [b.label for b in GRID if b.kind == kind],
                "chosen": {
                    run: {
                        "parameters": b.label,
                        "threshold": h,
                        "alpha": study.calibration(b, without[run]).alpha,
                        "claim": study.calibration(b, without[run]).claim(),
                    }
                    for run, (b, h) in tuned.items()
                },
                "alarmed": {r["run"]: n for r, (n, _) in zip(rows, counts, strict=False)},
                "false_alarms": false_alarms(counts, rows),
                "faults": fault_rows(cases),
            }
        )
    return table
