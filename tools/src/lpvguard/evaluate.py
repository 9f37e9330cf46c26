"""`lpvguard evaluate`: what the monitor, and each of its two tests alone, does on drives that did not set the bounds, leave-one-drive-out (DESIGN 4.8),
beside three baselines (baselines.py) on the same drives.

Every drive runs through the compiled core with thresholds of the frame test and of the energy test calibrated on all *other* drives that did not set the bounds.
False alarms are counted in whole 60 s pieces; faults are injected from 60 s on and count as found when the first alarm
comes within 30 s of judged, excited driving, provided the untouched drive has none in that time.

A baseline gets the same drives, residuals, calibration drives and alpha. Its parameters are those that find most injected
faults (then soonest) on the bound-setting and the other calibration drives: the drive under test takes part in nothing.
Judged and excited time is the monitor's for all detectors; a baseline may alarm outside of it too.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial

import numpy as np

from .baselines import GRID, KINDS, TITLES, Bank, Baseline, Scales
from .bounds import nominal_error
from .calibration import FEWEST_FOR_ALPHA, Calibration, calibrate
from .core import Core
from .drives import Experiment
from .faults import Fault, inject
from .identify import DriveReader, DriveSet, StoredIdentification
from .parallel import Map
from .replay import Replay, Replayer

PIECE_S = 60.0
FAULT_FROM_S = 60.0
SHORTEST_FOR_FAULTS_S = 120.0
FOUND_WITHIN_S = 30.0
BOOTSTRAP_DRAWS = 10_000
FAULTS = (Fault("gain", 0.6), Fault("gain", -1.0), Fault("freeze"), Fault("input_delay", 0.3), Fault("output_delay", 0.3),
          Fault("gain", 0.7), Fault("gain", 1.3), Fault("bias", 0.05), Fault("input_delay", 0.15),
          Fault("output_delay", 0.15))
MONITOR = "monitor"
"""Name of our own detector beside the kinds of baselines.KINDS: both tests together."""
TESTS = ("frame", "energy")


@dataclass(frozen=True)
class Pieces:
    """Alarmed and all whole 60 s pieces, with a 95 % interval of their ratio from resampling drives."""

    drives: int
    alarmed: int
    pieces: int
    interval: tuple[float, float] | None

    @classmethod
    def of(cls, counts: list[tuple[int, int]], seed: int) -> Pieces:
        alarmed, pieces = (int(sum(c[i] for c in counts)) for i in (0, 1))
        if not pieces:
            return cls(len(counts), 0, 0, None)
        draws = np.random.default_rng(seed).integers(0, len(counts), (BOOTSTRAP_DRAWS, len(counts)))
        table = np.array(counts, float)[draws].sum(axis=1)
        ratio = table[:, 0] / np.maximum(table[:, 1], 1.0)
        low, high = np.percentile(ratio[table[:, 1] > 0], [2.5, 97.5])
        return cls(len(counts), alarmed, pieces, (float(low), float(high)))


def alarm_times(replay: Replay, test: str | None) -> np.ndarray:
    """When a test (None: either) falsified the model [s], in order: falsifying frames, and samples above the energy test's
    threshold, for that test stays where it is while a frame is judged once."""
    frames = [a.t_s for a in replay.alarms if a.test == "frame"] if test != "energy" else []
    over = np.flatnonzero(replay.over) * replay.Ts if test != "frame" else []
    return np.sort(np.concatenate([frames, over]))


def alarmed_pieces(replay: Replay, test: str | None = None) -> tuple[int, int]:
    """(alarmed, all) whole 60 s pieces of a drive, by a test (None: either)."""
    pieces = int(replay.duration_s // PIECE_S)
    hit = set((alarm_times(replay, test) // PIECE_S).astype(int).tolist())
    return sum(1 for p in range(pieces) if p in hit), pieces


@dataclass(frozen=True)
class Clock:
    """Judged, excited, in-range seconds of a drive since its sample ``first``, (N,) at every sample."""

    seconds: np.ndarray
    first: int
    Ts: float

    @classmethod
    def of(cls, replay: Replay, from_s: float = FAULT_FROM_S) -> Clock:
        first = int(round(from_s / replay.Ts))
        relevant = replay.judged & replay.in_range & replay.excited
        relevant[:first] = False
        return cls(np.cumsum(relevant) * replay.Ts, first, replay.Ts)

    def at(self, t_s: float) -> float:
        """The reading [s] at ``t_s`` seconds after the drive's first sample."""
        return float(self.seconds[min(int(round(t_s / self.Ts)), len(self.seconds) - 1)])

    def of_replay(self, replay: Replay, test: str | None = None) -> float | None:
        """The reading at the first alarm of a test (None: either) after ``first``; None: no alarm."""
        return next((self.at(t) for t in alarm_times(replay, test).tolist() if t > self.first * self.Ts), None)

    def of_statistic(self, statistic: np.ndarray, threshold: float) -> float | None:
        """The reading where ``statistic`` (N,) first exceeds ``threshold`` after ``first``; None: nowhere."""
        above = np.flatnonzero(statistic[self.first + 1:] > threshold)
        return float(self.seconds[self.first + 1 + above[0]]) if len(above) else None


@dataclass(frozen=True)
class Case:
    """A fault in a drive: judged, excited seconds to the first alarm (None: no alarm), and whether the case counts:
    not where the untouched drive alarms within the time allowed."""

    run: str
    s: float | None
    counts: bool

    @classmethod
    def of(cls, run: str, faulty: float | None, clean: float | None) -> Case:
        return cls(run, faulty, clean is None or clean > FOUND_WITHIN_S)

    @property
    def found(self) -> bool:
        return self.counts and self.s is not None and self.s <= FOUND_WITHIN_S


def _evaluate_drive(reader: DriveReader, core: Core, item: tuple[Experiment, Calibration, Calibration]
                    ) -> tuple[dict, dict[str | None, dict[str, Case]]]:
    """One drive with thresholds of its own, of the frame test and of the energy test: its row, and per test (None: either) and
    fault what became of it (none for short drives)."""
    experiment, calibration, energy = item
    replayer = Replayer(reader.project, core, threshold=calibration.threshold, energy_threshold=energy.threshold)
    drive = reader.read(experiment)[0]
    clean = replayer.replay(drive)
    alarmed, pieces = alarmed_pieces(clean)
    relevant = clean.in_range & clean.excited
    row = {"run": experiment.name, "driver": experiment.driver, "threshold": calibration.threshold, "alpha": calibration.alpha,
           "conditional_bound": calibration.conditional_bound, "energy_threshold": energy.threshold,
           "by_test": {test: alarmed_pieces(clean, test)[0] for test in TESTS}, "alarmed": alarmed, "pieces": pieces, "judged_s": clean.judged_s,
           "judged_of_in_range_excited": float((clean.judged & relevant).sum() / max(1, relevant.sum()))}
    clock = Clock.of(clean)
    found: dict[str | None, dict[str, Case]] = {test: {} for test in (None, *TESTS)}
    for fault in FAULTS if drive.duration_s > SHORTEST_FOR_FAULTS_S else ():
        faulty = replayer.replay(inject(drive, fault, FAULT_FROM_S, reader.project.Ts_s))
        for test, cases in found.items():
            cases[fault.label] = Case.of(experiment.name, clock.of_replay(faulty, test), clock.of_replay(clean, test))
    return row, found


# ---------------------------------------------------------------------------------------------------------- baselines

def _usable_errors(reader: DriveReader, experiment: Experiment) -> tuple[np.ndarray, np.ndarray]:
    drive, e, _ = reader.read(experiment)
    usable = reader.estimator.settled(drive.v)
    return e[usable], drive.u[usable]


def _largest(reader: DriveReader, bank: Bank, experiment: Experiment) -> dict[Baseline, np.ndarray]:
    """Largest statistic of each baseline: in each whole 60 s piece, and last in what remains after them."""
    drive, e, _ = reader.read(experiment)
    length = int(round(PIECE_S / reader.project.Ts_s))
    pieces = int(drive.duration_s // PIECE_S)
    return {b: np.array([*s[:pieces * length].reshape(pieces, length).max(axis=1, initial=-np.inf),
                         s[pieces * length:].max(initial=-np.inf)])
            for b, s in bank.statistics(GRID, e, drive.v)}


def _times(reader: DriveReader, core: Core, bank: Bank, thresholds: dict[Baseline, tuple[float, ...]],
           experiment: Experiment) -> dict[tuple[Baseline, float], dict[str, Case]]:
    """What becomes of every fault in a drive, for every baseline and each of its thresholds; empty for short drives."""
    drive, e, _ = reader.read(experiment)
    if drive.duration_s <= SHORTEST_FOR_FAULTS_S:
        return {}
    clock = Clock.of(Replayer(reader.project, core).replay(drive))

    def alarms(error: np.ndarray) -> dict[tuple[Baseline, float], float | None]:
        return {(b, h): clock.of_statistic(s, h) for b, s in bank.statistics(thresholds, error, drive.v) for h in thresholds[b]}

    clean = alarms(e)
    cases: dict[tuple[Baseline, float], dict[str, Case]] = {key: {} for key in clean}
    for fault in FAULTS:
        error = nominal_error(inject(drive, fault, FAULT_FROM_S, reader.project.Ts_s), reader.model)[0]
        for key, s in alarms(error).items():
            cases[key][fault.label] = Case.of(experiment.name, s, clean[key])
    return cases


class BaselineStudy:
    """The baselines on the drives of an identification: scores, thresholds, searched parameters."""

    def __init__(self, stored: StoredIdentification, drives: DriveSet, core: Core, *, left_out: tuple[str | None, ...],
                 workers: Map = map, progress: Callable[[str], None] = lambda _: None):
        """``left_out``: the drives that will be asked about, None for "all calibration drives count"."""
        groups, reader = stored.manifest["drives"], drives.reader
        self.alpha, self.calibration_drives = stored.project.frame_test.alpha, list(stored.calibration.scores)
        chosen = [drives.experiments[n] for n in (*groups["bounds"], *self.calibration_drives)]
        self.bank = Bank(reader.model, reader.estimator, Scales.of(
            workers(partial(_usable_errors, reader), [drives.experiments[n] for n in groups["bounds"]])))

        def over(task: Callable, what: str) -> dict:
            results = {}
            for e, result in zip(chosen, workers(task, chosen)):
                progress(f"{what} of {e.name}")
                results[e.name] = result
            return results

        self.largest = over(partial(_largest, reader, self.bank), "baselines")
        thresholds = {b: tuple(sorted({self.calibration(b, name).threshold for name in left_out})) for b in GRID}
        self.cases = over(partial(_times, reader, core, self.bank, thresholds), "baselines on faults")

    def calibration(self, b: Baseline, without: str | None = None) -> Calibration:
        """Conformal threshold from the calibration drives but ``without``; drives on which it never spoke give no score."""
        scores = {n: float(self.largest[n][b].max()) for n in self.calibration_drives if n != without}
        return calibrate({n: s for n, s in scores.items() if np.isfinite(s)}, self.alpha, floor=0.0)

    def best(self, kind: str, without: str | None = None) -> tuple[Baseline, float]:
        """The parameters of ``kind`` that find most faults, then soonest, on all drives but ``without``; with their threshold."""

        def merit(b: Baseline) -> tuple[int, float]:
            key = b, self.calibration(b, without).threshold
            cases = [c for name, table in self.cases.items() if name != without and table for c in table[key].values()]
            return sum(c.found for c in cases), -sum(min(c.s, FOUND_WITHIN_S) if c.found else FOUND_WITHIN_S for c in cases)

        b = max((b for b in GRID if b.kind == kind), key=merit)
        return b, self.calibration(b, without).threshold

    def alarmed_pieces(self, b: Baseline, threshold: float, name: str) -> tuple[int, int]:
        """(alarmed, all) whole 60 s pieces of an untouched drive."""
        pieces = self.largest[name][b][:-1]
        return int((pieces > threshold).sum()), len(pieces)


def _evaluate_baselines(study: BaselineStudy, rows: list[dict], seed: int) -> list[dict]:
    """Per kind: false alarms, parameters chosen, and per fault its cases; each drive with what was tuned without it."""
    table = []
    for kind in KINDS:
        tuned = {r["run"]: study.best(kind, r["run"]) for r in rows}
        counts = [study.alarmed_pieces(*tuned[r["run"]], r["run"]) for r in rows]
        cases = {f.label: [study.cases[run][key][f.label] for run, key in tuned.items() if study.cases[run]] for f in FAULTS}
        table.append({"kind": kind, "title": TITLES[kind], "searched": [b.label for b in GRID if b.kind == kind],
                      "chosen": {run: {"parameters": b.label, "threshold": h} for run, (b, h) in tuned.items()},
                      "false_alarms": vars(Pieces.of(counts, seed)), "faults": _fault_rows(cases)})
    return table


def _fault_rows(cases: dict[str, list[Case]]) -> list[dict]:
    return [{"fault": label, "found": sum(c.found for c in members), "counted": sum(c.counts for c in members),
             "drives": len(members), "median_s": median_time([c.s for c in members if c.counts]),
             "cases": [vars(c) for c in members]} for label, members in cases.items()]


def median_time(seconds: list[float | None]) -> float | None:
    """Median time to the first alarm, a miss counting as later than all; None: at least half are misses, or there is none."""
    if not seconds:
        return None
    middle = float(np.median([np.inf if s is None else s for s in seconds]))
    return middle if np.isfinite(middle) else None


def ranking(rows: dict[str, dict]) -> list[str]:
    """Who does best on one fault, all that tie: by the share of drives in which it was found, then by the median time.

    ``rows``: per detector its row of _fault_rows. A case that does not count was not found.
    """

    def merit(row: dict) -> tuple[float, float]:
        return row["found"] / max(1, row["drives"]), -(np.inf if row["median_s"] is None else row["median_s"])

    best = max(merit(row) for row in rows.values())
    return [name for name, row in rows.items() if merit(row) == best]


# ---------------------------------------------------------------------------------------------------------------- all

def evaluate(stored: StoredIdentification, drives: DriveSet, core: Core, *, workers: Map = map,
             progress: Callable[[str], None] = lambda _: None) -> dict:
    """Leave-one-drive-out evaluation, the drives mapped by ``workers`` (parallel.py); returns the JSON-able table."""
    project, scores, energy = stored.project, stored.calibration.scores, stored.energy
    rows, per_fault = [], {test: {f.label: [] for f in FAULTS} for test in (None, *TESTS)}

    def others(name: str, of: dict[str, float]) -> dict[str, float]:
        return {k: v for k, v in of.items() if k != name}

    alpha, energy_scores = project.frame_test.alpha, energy.calibration.scores
    items = [(drives.experiments[name], calibrate(others(name, scores), alpha),
              energy.calibrated(others(name, energy_scores), alpha).calibration) for name in scores]
    for row, found in workers(partial(_evaluate_drive, drives.reader, core), items):
        progress(row["run"])
        rows.append(row | {"score": scores[row["run"]], "energy_score": energy_scores.get(row["run"])})
        for test, cases in found.items():
            for label, case in cases.items():
                per_fault[test][label].append(case)
    seed = project.seed
    groups = {"all": rows} | {d: [r for r in rows if r["driver"] == d] for d in sorted({r["driver"] for r in rows})}
    study = BaselineStudy(stored, drives, core, left_out=tuple(scores), workers=workers, progress=progress)
    faults, baselines = _fault_rows(per_fault[None]), _evaluate_baselines(study, rows, seed)
    best = [ranking({MONITOR: row} | {b["kind"]: b["faults"][i] for b in baselines}) for i, row in enumerate(faults)]
    return {
        "threshold_rule": f"all other drives that did not set the bounds, alpha {project.frame_test.alpha:g} "
                          f"(stated from {FEWEST_FOR_ALPHA} drives on)",
        "drives": rows,
        "false_alarms": {g: vars(Pieces.of([(r["alarmed"], r["pieces"]) for r in members], seed))
                         for g, members in groups.items()},
        "faults": [row | {"best": names} for row, names in zip(faults, best)],
        "tests": {test: {"false_alarms": vars(Pieces.of([(r["by_test"][test], r["pieces"]) for r in rows], seed)),
                         "faults": _fault_rows(per_fault[test])} for test in TESTS},
        "baselines": baselines,
    }
