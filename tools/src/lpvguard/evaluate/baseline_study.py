"""The baselines (baselines.py) tuned, calibrated and evaluated on the drives of an identification.

A baseline gets the same drives, residuals, calibration drives and alpha as the monitor. Its parameters are
those that find the most injected faults on the bound-setting drives and the other calibration drives. A tie
goes to the faster ones. The drive under test takes part in neither tuning nor calibration.
"""

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import partial

import numpy as np

from ..base.parallel import Map
from ..core.compiled import Core
from ..drives.tables import Experiment
from ..identify.bounds import nominal_error
from ..identify.calibration import Calibration, calibrate
from ..identify.identification import DriveSet, StoredIdentification
from ..identify.passes import DriveReader
from ..replay.replayer import Replayer
from .baselines import GRID, KINDS, TITLES, WITH_COMPONENTS, Bank, Baseline, Scales, Sizes
from .detection import Case, FaultOutcome, Injection, Outcomes, fault_rows, with_refutable
from .false_alarms import false_alarms, piece_starts


def _sizes(reader: DriveReader, experiment: Experiment) -> Sizes:
    drive, e, yhat = reader.read(experiment)
    return Sizes.from_drive(e, yhat, drive.u, reader.estimator.settled(drive.v), reader.estimator.Ts)


def _largest(
    reader: DriveReader, bank: Bank, item: tuple[Experiment, tuple[Baseline, ...]]
) -> dict[Baseline, np.ndarray]:
    """Largest statistic in each 60 s piece of the item's drive (piece_starts), for each of its baselines."""
    experiment, baselines = item
    drive, e, yhat = reader.read(experiment)
    starts = piece_starts(len(drive.v), reader.project.Ts_s)
    return {b: np.maximum.reduceat(s, starts) for b, s in bank.statistics(baselines, e, yhat, drive.v)}


def _component_squares(
    reader: DriveReader, bank: Bank, item: tuple[Experiment, tuple[Baseline, ...]]
) -> dict[Baseline, tuple[np.ndarray, int]]:
    """Sums of the squared components of the item's baselines over its drive, and the number of samples."""
    experiment, baselines = item
    drive, e, yhat = reader.read(experiment)
    squares = {}
    for b, components in bank.components(baselines, e, yhat, drive.v):
        usable = components[:, components[0] >= 0]
        squares[b] = np.sum(usable**2, axis=1), usable.shape[1]
    return squares


Key = tuple[Baseline, float]
"""A baseline at a threshold."""


def _outcomes(
    core: Core,
    injection: Injection,
    reader: DriveReader,
    bank: Bank,
    item: tuple[Experiment, tuple[Key, ...]],
) -> Iterator[tuple[Key, Case, FaultOutcome]]:
    """Outcomes of all faults injected into a drive, by key; empty if the drive does not qualify."""
    experiment, keys = item
    drive, e, yhat = reader.read(experiment)
    Ts, thresholds = reader.project.Ts_s, dict[Baseline, list[float]]()
    for b, h in keys:
        thresholds.setdefault(b, []).append(h)
    injected = list(injection.into(Replayer(reader.project, core).replay(drive), reader.project.seed))
    if not injected:
        return
    untouched = dict(bank.statistics(thresholds, e, yhat, drive.v))
    for case, clock in injected:
        faulty = case.into(drive, clock, Ts)
        statistics = bank.statistics(thresholds, *nominal_error(faulty, reader.model), faulty.v, clock.first)
        for b, statistic in statistics:
            for h in thresholds[b]:
                first = clock.read_after(statistic > h)
                without = clock.read_after(untouched[b][clock.first :] > h)
                outcome = FaultOutcome.from_times(experiment.name, Ts, clock, first, without)
                yield (b, h), case, outcome


@dataclass(frozen=True)
class Merit:
    """Number of found faults and the sum of their detection times; a miss counts as the time allowed."""

    detected: int = 0
    seconds: float = 0.0


def _merits(
    core: Core,
    injection: Injection,
    reader: DriveReader,
    bank: Bank,
    item: tuple[Experiment, tuple[Key, ...]],
) -> dict[Key, Merit]:
    """Merit of each of the keys (parameter sets) on a drive."""
    merits = dict.fromkeys(item[1], Merit())
    for key, _, outcome in _outcomes(core, injection, reader, bank, item):
        s = injection.within_s if outcome.s is None else outcome.s
        merits[key] = Merit(merits[key].detected + outcome.detected, merits[key].seconds + s)
    return merits


def _judged(
    core: Core,
    injection: Injection,
    reader: DriveReader,
    bank: Bank,
    item: tuple[Experiment, tuple[Key, ...]],
) -> dict[Key, Outcomes]:
    """Outcomes of each of the keys on a drive."""
    outcomes: dict[Key, Outcomes] = {key: {case: [] for case in injection.cases} for key in item[1]}
    for key, case, outcome in _outcomes(core, injection, reader, bank, item):
        outcomes[key][case].append(outcome)
    return outcomes


@dataclass(frozen=True)
class OnDrives:
    """Results of the best baseline of each kind, by drive: calibration, count of 60 s pieces, outcomes."""

    chosen: dict[str, dict[str, tuple[Baseline, Calibration]]]
    pieces: dict[str, dict[str, tuple[int, int]]]
    outcomes: dict[str, dict[str, Outcomes]]


class BaselineStudy:
    """The baselines on the drives of an identification: scores, thresholds, searched parameters.

    Only bound-setting drives with commands as in use (``data.command_split``) take part.

    Parameters
    ----------
    stored : StoredIdentification
    drives : DriveSet, the identification's drives
    core : Core
    left_out : tuple of str or None, drives to leave out later; None: all calibration drives count
    injection : Injection, faults by which parameters are chosen
    workers : Map
    progress : Callable, reports progress
    """

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
        used = stored.project.data.command_splits
        setting = [n for n in stored.manifest["drives"]["bounds"] if drives.experiments[n].split in used]
        self.alpha, self.calibration_drives = stored.project.frame_test.alpha, list(stored.calibration.scores)
        self.recordings, self.injection = stored.calibration.recordings, injection
        self.reader, self.core, self.workers, self.progress = drives.reader, core, workers, progress
        chosen = [drives.experiments[n] for n in (*setting, *self.calibration_drives)]
        self.bank = self._bank([drives.experiments[n] for n in setting])
        self.largest = self._over(_largest, [(e, GRID) for e in chosen], "baselines")
        keys = tuple(
            (b, h) for b in GRID for h in sorted({self.calibration(b, n).threshold for n in left_out})
        )
        self.merits: dict[str, dict[Key, Merit]] = self._inject(_merits, [(e, keys) for e in chosen])

    def _bank(self, setting: list[Experiment]) -> Bank:
        """The detectors, scaled by the ``setting`` drives."""
        model, estimator = self.reader.model, self.reader.estimator
        scales = Scales.from_sizes(self.workers(partial(_sizes, self.reader), setting))
        self.bank = Bank(model, estimator, scales).prepared(GRID)
        by_drive = self._over(_component_squares, [(e, GRID) for e in setting], "sizes of baselines").values()
        sums = {b: [squares[b] for squares in by_drive] for b in GRID if b.kind in WITH_COMPONENTS}
        sizes = {
            b: np.sqrt(sum(squares for squares, _ in parts) / max(1, sum(n for _, n in parts)))
            for b, parts in sums.items()
        }
        return Bank(model, estimator, scales, sizes).prepared(GRID)

    def _over(self, task: Callable, items: list[tuple], what: str) -> dict:
        """Run ``task`` on each item; return the results by the name of the item's experiment."""
        results = {}
        mapped = self.workers(partial(task, self.reader, self.bank), items)
        for (experiment, *_), result in zip(items, mapped, strict=False):
            self.progress(f"{what} of {experiment.name}")
            results[experiment.name] = result
        return results

    def _inject(self, task: Callable, items: list[tuple]) -> dict:
        """Results of ``task`` on faults injected into every item."""
        return self._over(partial(task, self.core, self.injection), items, "baselines on faults")

    def calibration(self, b: Baseline, without: str | None = None) -> Calibration:
        """Conformal threshold from the calibration drives without the recording of ``without``.

        A drive on which the baseline has no statistic gives no score. Without any score it never alarms.
        """
        others = self.recordings.others(self.calibration_drives, without)
        scores = {n: float(self.largest[n][b].max()) for n in others}
        spoken = {n: s for n, s in scores.items() if np.isfinite(s)}
        floor = 0.0 if spoken else np.inf
        return calibrate(spoken, self.alpha, floor=floor, recordings=self.recordings)

    def best(self, kind: str, without: str | None = None) -> tuple[Baseline, Calibration]:
        """Parameters of ``kind`` that find the most faults, and their calibration.

        Faster parameters win a tie. The recording of ``without`` does not count.
        """
        others = self.recordings.others(self.merits, without)

        def merit(b: Baseline) -> tuple[int, float]:
            key = b, self.calibration(b, without).threshold
            merits = [self.merits[name][key] for name in others]
            return sum(m.detected for m in merits), -sum(m.seconds for m in merits)

        b = max((b for b in GRID if b.kind == kind), key=merit)
        return b, self.calibration(b, without)

    def on(self, judged: list[Experiment], *, left_out: bool) -> OnDrives:
        """Results of the best baseline of each kind on the ``judged`` drives.

        With ``left_out``, each is tuned and calibrated without the drive under test. Otherwise it is tuned
        and calibrated on all drives of the study.
        """
        chosen = {
            e.name: {kind: self.best(kind, e.name if left_out else None) for kind in KINDS} for e in judged
        }
        keys = {n: tuple((b, c.threshold) for b, c in by_kind.values()) for n, by_kind in chosen.items()}
        further = [(e, tuple(b for b, _ in keys[e.name])) for e in judged if e.name not in self.largest]
        largest = self.largest | self._over(_largest, further, "baselines")
        outcomes = self._inject(_judged, [(e, keys[e.name]) for e in judged])
        return OnDrives(
            chosen,
            {n: {b.kind: alarmed(largest[n][b], h) for b, h in pairs} for n, pairs in keys.items()},
            {n: {b.kind: outcomes[n][b, h] for b, h in pairs} for n, pairs in keys.items()},
        )


def alarmed(largest: np.ndarray, threshold: float) -> tuple[int, int]:
    """Number of (alarmed, all) pieces of a drive, from the ``largest`` statistic (P,) in each."""
    return int((largest > threshold).sum()), len(largest)


def evaluate_baselines(rows: list[dict], on: OnDrives, known: Outcomes) -> list[dict]:
    """False alarms, chosen parameters and outcomes per kind, on the drives of ``rows``.

    ``known`` holds the monitor's outcomes. They state when a fault was refutable.
    """
    table: list[dict] = []
    for kind in KINDS:
        counts = [on.pieces[r["run"]][kind] for r in rows]
        outcomes: Outcomes = {
            case: [c for r in rows for c in on.outcomes[r["run"]][kind][case]] for case in known
        }
        table.append(
            {
                "kind": kind,
                "title": TITLES[kind],
                "searched": [b.label for b in GRID if b.kind == kind],
                "chosen": {
                    r["run"]: {
                        "parameters": b.label,
                        "threshold": c.threshold,
                        "alpha": c.alpha,
                        "claim": c.claim(),
                    }
                    for r in rows
                    for b, c in [on.chosen[r["run"]][kind]]
                },
                "alarmed": {r["run"]: n for r, (n, _) in zip(rows, counts, strict=True)},
                "false_alarms": false_alarms(counts, rows),
                "faults": fault_rows(with_refutable(outcomes, known)),
            }
        )
    return table
