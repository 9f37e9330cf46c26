"""`lpvguard evaluate`: what the monitor, and each of its two tests alone, does on drives that did not set the
bounds, leave-one-drive-out (THEORY 7.3), beside three baselines (baselines.py) on the same drives.

**Thresholds.** Every drive runs through the compiled core with thresholds calibrated on all *other* drives
that did not set the bounds. The monitor is compared with both tests at one threshold, calibrated jointly
(calibration.joint_scores): by either test, it alarms on a further drive with probability at most alpha, as a
baseline does. Beside it stand each test alone at alpha, and both as exported: each at its own threshold,
together at most twice alpha. Where fewer drives calibrate than alpha needs, no rate is stated, and the
detectors are compared by counts only (`stated_rates`).

**False alarms** are counted in every second of a drive, judged or not: in 60 s pieces, of which the last may
be shorter, and in drives. The rate is alarmed pieces an hour of judged driving; judged is the monitor's for
all detectors.

**Faults** are injected into drives longer than 120 s, from STARTS instants of each, drawn one in each of as
many equal spans between 60 s and the last instant that leaves 30 s of judged, excited driving (why several:
tools/DESIGN_LOG.md).

**Time** runs in judged, excited, in-range driving since the first faulty sample, which counts; judged is the
monitor's for all detectors, though a baseline may alarm outside of it. An alarm stands at the sample with
which the core said so, not at the end of its frame.

**Found**: the first alarm from the fault's start on comes within 30 s, and before any of the same detector on
the untouched drive since that instant. An alarm that the untouched drive raises too does not count, nor does
one that stands when the fault starts. The table also states how often the untouched drive alarms in the time
allowed.

A baseline gets the same drives, residuals, calibration drives and alpha. Its parameters are those that find
most injected faults (then soonest) on the bound-setting and the other calibration drives: the drive under
test takes part in nothing.
"""

from __future__ import annotations

import zlib
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from functools import partial

import numpy as np

from ..base.errors import InputError
from ..base.parallel import Map
from ..core.compiled import TESTS, Core
from ..drives.faults import Fault, inject
from ..drives.tables import Drive, Experiment
from ..identify.bounds import nominal_error
from ..identify.calibration import Calibration, calibrate, joint_scores
from ..identify.energy import ROUNDING
from ..identify.passes import DriveReader
from ..identify.run import DriveSet, StoredIdentification
from ..replay.run import Replay, Replayer
from .baselines import GRID, KINDS, TITLES, Bank, Baseline, Scales

PIECE_S = 60.0
FAULT_FROM_S = 60.0
SHORTEST_FOR_FAULTS_S = 120.0
FOUND_WITHIN_S = 30.0
STARTS = 5
FEWEST_FOR_BASELINES = 2
"""Calibration drives: a baseline has no natural threshold, so one must be left when a drive is left out."""
BOOTSTRAP_DRAWS = 10_000
FAULTS = (
    Fault("gain", 0.6),
    Fault("gain", -1.0),
    Fault("freeze"),
    Fault("input_delay", 0.3),
    Fault("output_delay", 0.3),
    Fault("gain", 0.7),
    Fault("gain", 1.3),
    Fault("bias", 0.05),
    Fault("input_delay", 0.15),
    Fault("output_delay", 0.15),
)
MONITOR = "monitor"
"""Name of our own detector beside the kinds of baselines.KINDS: both tests together, at one threshold."""
EXPORTED = "exported"
"""Both tests, each at its own threshold, as `lpvguard export` writes them."""


@dataclass(frozen=True)
class Pieces:
    """Alarmed and all 60 s pieces, a drive's shorter last one included, with a 95 % interval of their ratio
    from resampling drives.

    drives, alarmed_drives: all, and those with an alarmed piece; judged_h: hours of judged driving;
    per_judged_h: alarmed pieces an hour of it, None without any.
    """

    drives: int
    alarmed: int
    pieces: int
    interval: tuple[float, float] | None
    alarmed_drives: int
    judged_h: float
    per_judged_h: float | None

    @classmethod
    def of(cls, counts: list[tuple[int, int]], judged_s: list[float], seed: int) -> Pieces:
        """``counts``: (alarmed, all) pieces of each drive; ``judged_s``: the judged seconds of each."""
        alarmed, pieces = (int(sum(c[i] for c in counts)) for i in (0, 1))
        judged_h = sum(judged_s) / 3600
        rest = sum(c[0] > 0 for c in counts), judged_h, alarmed / judged_h if judged_h else None
        if not pieces:
            return cls(len(counts), 0, 0, None, *rest)
        draws = np.random.default_rng(seed).integers(0, len(counts), (BOOTSTRAP_DRAWS, len(counts)))
        table = np.array(counts, float)[draws].sum(axis=1)
        ratio = table[:, 0] / np.maximum(table[:, 1], 1.0)
        low, high = np.percentile(ratio[table[:, 1] > 0], [2.5, 97.5])
        return cls(len(counts), alarmed, pieces, (float(low), float(high)), *rest)


def alarming(replay: Replay, test: str | None = None) -> np.ndarray:
    """(N,) True at samples where a test (None: either) falsifies the model: with which a falsifying frame was
    judged, and all above the energy test's threshold, for that test stays where it is while a frame is judged
    once."""
    return {"frame": replay.falsified, "energy": replay.over, None: replay.falsified | replay.over}[test]


def piece_starts(samples: int, Ts: float) -> np.ndarray:
    """First sample of each 60 s piece of a drive of ``samples``. The last piece is what remains, up to 60 s
    with the closing sample."""
    return np.arange(0, max(1, samples - 1), round(PIECE_S / Ts))


def alarmed_pieces(replay: Replay, test: str | None = None) -> tuple[int, int]:
    """(alarmed, all) 60 s pieces of a drive, by a test (None: either)."""
    starts = piece_starts(len(replay.judged), replay.Ts)
    return int(np.logical_or.reduceat(alarming(replay, test), starts).sum()), len(starts)


@dataclass(frozen=True)
class Clock:
    """Judged, excited, in-range seconds of a drive from its sample ``first`` on, that one included, (N,) at
    every sample."""

    seconds: np.ndarray
    first: int

    @classmethod
    def of(cls, replay: Replay, first: int) -> Clock:
        relevant = replay.judged & replay.in_range & replay.excited
        relevant[:first] = False
        return cls(np.cumsum(relevant) * replay.Ts, first)

    @property
    def end(self) -> int:
        """Samples up to the last with which a fault is still found in time."""
        return int(np.searchsorted(self.seconds, FOUND_WITHIN_S * (1 + 1e-9), side="right"))

    def read(self, hits: np.ndarray) -> float | None:
        """The reading [s] at the first True of ``hits`` (N or fewer samples) from ``first`` on; None:
        nowhere."""
        found = np.flatnonzero(hits[self.first :])
        return float(self.seconds[self.first + found[0]]) if len(found) else None


def fault_clocks(untouched: Replay, seed: int) -> list[Clock]:
    """One clock for each instant from which faults are injected into a drive; none where the drive does not
    qualify."""
    if untouched.duration_s <= SHORTEST_FOR_FAULTS_S:
        return []
    earliest = round(FAULT_FROM_S / untouched.Ts)
    seconds = Clock.of(untouched, earliest).seconds
    latest = int(np.searchsorted(seconds, seconds[-1] - FOUND_WITHIN_S, side="right"))
    if seconds[-1] < FOUND_WITHIN_S:
        return []
    # A stream of random numbers for each drive: the other drives make no difference.
    random = np.random.default_rng([seed, zlib.crc32(untouched.name.encode())])
    spans = (np.arange(STARTS) + random.uniform(size=STARTS)) / STARTS
    return [Clock.of(untouched, int(first)) for first in earliest + spans * max(0, latest - earliest)]


@dataclass(frozen=True)
class Case:
    """A fault in a drive from ``start_s`` on: judged, excited seconds until it was found, None: it was not;
    and until the detector would have alarmed without the fault, None: not within the time allowed."""

    run: str
    start_s: float
    s: float | None
    untouched_s: float | None

    @classmethod
    def of(cls, run: str, Ts: float, clock: Clock, faulty: np.ndarray, untouched: float | None) -> Case:
        """``faulty``: samples at which the detector alarms with the fault; ``untouched``: the clock at its
        first alarm without."""
        s = clock.read(faulty[: clock.end])
        caused = s is not None and (untouched is None or s < untouched)
        return cls(
            run,
            clock.first * Ts,
            s if caused else None,
            untouched if untouched is not None and untouched <= clock.seconds[clock.end - 1] else None,
        )

    @property
    def found(self) -> bool:
        return self.s is not None


def _faulty(drive: Drive, fault: Fault, clock: Clock, Ts: float) -> Drive:
    """The drive with the fault, cut where it can no longer be found in time."""
    return inject(drive.before_sample(clock.end), fault, clock.first * Ts, Ts)


def _evaluate_drive(
    reader: DriveReader, core: Core, item: tuple[Experiment, dict[str, Calibration]]
) -> tuple[dict, dict[str, dict[str, list[Case]]]]:
    """One drive with calibrations of its own for MONITOR, "frame" and "energy": its row, and per detector and
    fault what became of it from every start (none where the drive does not qualify)."""
    experiment, calibrations = item
    project, thresholds = reader.project, {what: c.threshold for what, c in calibrations.items()}
    together = Replayer(project, core, threshold=thresholds[MONITOR], energy_threshold=thresholds[MONITOR])
    apart = Replayer(project, core, threshold=thresholds["frame"], energy_threshold=thresholds["energy"])
    detectors = {
        MONITOR: (together, None),
        EXPORTED: (apart, None),
        **{test: (apart, test) for test in TESTS},
    }
    drive, Ts = reader.read(experiment)[0], project.Ts_s
    untouched = {replayer: replayer.replay(drive) for replayer in (together, apart)}
    replay = untouched[together]
    relevant, starts = replay.in_range & replay.excited, piece_starts(len(replay.judged), Ts)
    clocks = fault_clocks(replay, project.seed)
    row = {
        "run": experiment.name,
        "driver": experiment.driver,
        "calibration": {
            what: {
                "threshold": c.threshold,
                "drives": len(c.scores),
                "alpha": c.alpha,
                "conditional_bound": c.conditional_bound,
                "claim": c.claim(),
            }
            for what, c in calibrations.items()
        },
        "alarmed": {
            name: alarmed_pieces(untouched[replayer], test)[0] for name, (replayer, test) in detectors.items()
        },
        "pieces": len(starts),
        "last_piece_s": round((len(replay.judged) - 1 - int(starts[-1])) * Ts, 6),
        "duration_s": replay.duration_s,
        "judged_s": replay.judged_s,
        "judged_of_in_range_excited": float((replay.judged & relevant).sum() / relevant.sum())
        if relevant.any()
        else None,
        "fault_starts_s": [c.first * Ts for c in clocks],
    }
    found: dict[str, dict[str, list[Case]]] = {name: {f.label: [] for f in FAULTS} for name in detectors}
    for clock in clocks:
        first = {
            name: clock.read(alarming(untouched[replayer], test))
            for name, (replayer, test) in detectors.items()
        }
        for fault in FAULTS:
            faulty = {replayer: replayer.replay(_faulty(drive, fault, clock, Ts)) for replayer in untouched}
            for name, (replayer, test) in detectors.items():
                found[name][fault.label].append(
                    Case.of(experiment.name, Ts, clock, alarming(faulty[replayer], test), first[name])
                )
    return row, found


# -------------------------------------------------------------------------------------------------- baselines


def _usable_errors(reader: DriveReader, experiment: Experiment) -> tuple[np.ndarray, np.ndarray]:
    drive, e, _ = reader.read(experiment)
    usable = reader.estimator.settled(drive.v)
    return e[usable], drive.u[usable]


def _largest(reader: DriveReader, bank: Bank, experiment: Experiment) -> dict[Baseline, np.ndarray]:
    """Largest statistic of each baseline in each 60 s piece (piece_starts)."""
    drive, e, _ = reader.read(experiment)
    starts = piece_starts(len(drive.v), reader.project.Ts_s)
    return {b: np.maximum.reduceat(s, starts) for b, s in bank.statistics(GRID, e, drive.v)}


Cases = dict[tuple[Baseline, float], dict[str, list[Case]]]
"""Of one drive: per baseline and threshold, and fault, what became of it from every start."""


def _cases(
    reader: DriveReader,
    core: Core,
    bank: Bank,
    thresholds: dict[Baseline, tuple[float, ...]],
    experiment: Experiment,
) -> Cases:
    """Every baseline at each of its thresholds on one drive; empty where the drive does not qualify."""
    drive, e, _ = reader.read(experiment)
    clocks, Ts = (
        fault_clocks(Replayer(reader.project, core).replay(drive), reader.project.seed),
        reader.project.Ts_s,
    )
    if not clocks:
        return {}

    def alarms(error: np.ndarray, v: np.ndarray):
        return (((b, h), s > h) for b, s in bank.statistics(thresholds, error, v) for h in thresholds[b])

    first = {key: [clock.read(hits) for clock in clocks] for key, hits in alarms(e, drive.v)}
    cases: Cases = {key: {f.label: [] for f in FAULTS} for key in first}
    for i, clock in enumerate(clocks):
        for fault in FAULTS:
            faulty = _faulty(drive, fault, clock, Ts)
            for key, hits in alarms(nominal_error(faulty, reader.model)[0], faulty.v):
                cases[key][fault.label].append(Case.of(experiment.name, Ts, clock, hits, first[key][i]))
    return cases


class BaselineStudy:
    """The baselines on the drives of an identification: scores, thresholds, searched parameters."""

    def __init__(
        self,
        stored: StoredIdentification,
        drives: DriveSet,
        core: Core,
        *,
        left_out: tuple[str | None, ...],
        workers: Map = map,
        progress: Callable[[str], None] = lambda _: None,
    ):
        """``left_out``: the drives that will be asked about, None for "all calibration drives count"."""
        groups, reader = stored.manifest["drives"], drives.reader
        self.alpha, self.calibration_drives = stored.project.frame_test.alpha, list(stored.calibration.scores)
        chosen = [drives.experiments[n] for n in (*groups["bounds"], *self.calibration_drives)]
        self.bank = Bank(
            reader.model,
            reader.estimator,
            Scales.of(
                workers(partial(_usable_errors, reader), [drives.experiments[n] for n in groups["bounds"]])
            ),
        )

        def over(task: Callable, what: str) -> dict:
            results = {}
            for e, result in zip(chosen, workers(task, chosen), strict=False):
                progress(f"{what} of {e.name}")
                results[e.name] = result
            return results

        self.largest = over(partial(_largest, reader, self.bank), "baselines")
        thresholds = {
            b: tuple(sorted({self.calibration(b, name).threshold for name in left_out})) for b in GRID
        }
        self.cases: dict[str, Cases] = over(
            partial(_cases, reader, core, self.bank, thresholds), "baselines on faults"
        )

    def calibration(self, b: Baseline, without: str | None = None) -> Calibration:
        """Conformal threshold from the calibration drives but ``without``; drives on which it never spoke
        give no score, and without any score it never alarms."""
        scores = {n: float(self.largest[n][b].max()) for n in self.calibration_drives if n != without}
        spoken = {n: s for n, s in scores.items() if np.isfinite(s)}
        return calibrate(spoken, self.alpha, floor=0.0 if spoken else np.inf)

    def best(self, kind: str, without: str | None = None) -> tuple[Baseline, float]:
        """The parameters of ``kind`` that find most faults, then soonest, on all drives but ``without``; with
        their threshold."""

        def merit(b: Baseline) -> tuple[int, float]:
            key = b, self.calibration(b, without).threshold
            cases = [
                c
                for name, table in self.cases.items()
                if name != without and table
                for of in table[key].values()
                for c in of
            ]
            return sum(c.found for c in cases), -sum(c.s if c.found else FOUND_WITHIN_S for c in cases)

        b = max((b for b in GRID if b.kind == kind), key=merit)
        return b, self.calibration(b, without).threshold

    def alarmed_pieces(self, b: Baseline, threshold: float, name: str) -> tuple[int, int]:
        """(alarmed, all) 60 s pieces of an untouched drive."""
        pieces = self.largest[name][b]
        return int((pieces > threshold).sum()), len(pieces)


def _evaluate_baselines(study: BaselineStudy, rows: list[dict], seed: int) -> list[dict]:
    """Per kind: false alarms, parameters chosen, and per fault its cases; each drive with what was tuned
    without it."""
    table = []
    for kind in KINDS:
        tuned = {r["run"]: study.best(kind, r["run"]) for r in rows}
        counts = [study.alarmed_pieces(*tuned[r["run"]], r["run"]) for r in rows]
        cases = {
            f.label: [
                c for run, key in tuned.items() if study.cases[run] for c in study.cases[run][key][f.label]
            ]
            for f in FAULTS
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
                        "alpha": study.calibration(b, run).alpha,
                        "claim": study.calibration(b, run).claim(),
                    }
                    for run, (b, h) in tuned.items()
                },
                "alarmed": {r["run"]: n for r, (n, _) in zip(rows, counts, strict=False)},
                "false_alarms": vars(Pieces.of(counts, [r["judged_s"] for r in rows], seed)),
                "faults": _fault_rows(cases),
            }
        )
    return table


def _fault_rows(cases: dict[str, list[Case]]) -> list[dict]:
    """Per fault: cases found, all cases, drives, those of them in which it was found from every start, cases
    whose untouched drive alarms in the time allowed, median time."""
    rows = []
    for label, members in cases.items():
        runs = {c.run for c in members}
        rows.append(
            {
                "fault": label,
                "found": sum(c.found for c in members),
                "counted": len(members),
                "drives": len(runs),
                "drives_found": len(runs - {c.run for c in members if not c.found}),
                "untouched_alarms": sum(c.untouched_s is not None for c in members),
                "median_s": median_time([c.s for c in members]),
                "cases": [vars(c) for c in members],
            }
        )
    return rows


def median_time(seconds: list[float | None]) -> float | None:
    """Median time to the first alarm, a miss counting as later than all; None: at least half are misses, or
    there is none."""
    if not seconds:
        return None
    middle = float(np.median([np.inf if s is None else s for s in seconds]))
    return middle if np.isfinite(middle) else None


def ranking(rows: dict[str, dict]) -> list[str]:
    """Who does best on one fault, all that tie: by the share of cases in which it was found, then by the
    median time; nobody where there is no case, or where nobody found one.

    ``rows``: per detector its row of _fault_rows.
    """

    def merit(row: dict) -> tuple[float, float]:
        return row["found"] / row["counted"], -(np.inf if row["median_s"] is None else row["median_s"])

    if not all(row["counted"] for row in rows.values()) or not any(row["found"] for row in rows.values()):
        return []
    best = max(merit(row) for row in rows.values())
    return [name for name, row in rows.items() if merit(row) == best]


COUNTS_ONLY = "counts only"
"""What stands in the place of a rate of false alarms that is not stated."""


def equal_rates(stated: Mapping[str, float | None]) -> str:
    """What may be said when detectors are compared, a clause for terminal and page: the one rate stated for
    all of them, or that there are counts only, and whose rate is missing. ``stated``: per detector its rate
    or None."""
    missing = [name for name, rate in stated.items() if rate is None]
    if missing:
        return f"by {COUNTS_ONLY}: too few drives calibrate, so no rate of false alarms is stated for {', '.join(missing)}"
    (rate,) = set(stated.values())
    return f"at one guaranteed rate: each alarms on a further drive with probability at most {rate:g}"


@dataclass(frozen=True)
class Column:
    """A detector in the table of detector_rows: its object of Pieces, its rows of _fault_rows, its stated
    rate or None."""

    alarms: dict
    faults: list[dict]
    stated: float | None


def columns(evaluation: dict) -> dict[str, Column]:
    """Every detector of an evaluation by name, in the order of its JSON: the monitor, exported and each test,
    the baselines."""
    found = {MONITOR: (evaluation["false_alarms"]["all"], evaluation["faults"])}
    found |= {name: (t["false_alarms"], t["faults"]) for name, t in evaluation["tests"].items()}
    found |= {b["kind"]: (b["false_alarms"], b["faults"]) for b in evaluation["baselines"]}
    return {name: Column(*of, evaluation["stated_rates"][name]) for name, of in found.items()}


def detector_rows(detectors: list[Column], best: list[str] | None = None) -> list[list[str]]:
    """Table rows of false alarms and found faults, a column per detector; ``best``: who leads, per fault, in
    a last column."""

    def found(row: dict) -> str:
        if not row["counted"]:
            return "no drive qualifies"
        return f"{row['found']} of {row['counted']} ({row['drives_found']} of {row['drives']})" + (
            "" if row["median_s"] is None else f", {row['median_s']:.2f} s"
        )

    def rate(per_judged_h: float | None) -> str:
        return "–" if per_judged_h is None else f"{per_judged_h:.2f}"

    alarms, faults = [d.alarms for d in detectors], [d.faults for d in detectors]
    rows = [
        [
            "stated: a further drive alarms",
            *(COUNTS_ONLY if d.stated is None else f"at most {d.stated:.3g}" for d in detectors),
        ],
        [f"alarmed {PIECE_S:g} s pieces, no fault", *(f"{a['alarmed']} of {a['pieces']}" for a in alarms)],
        ["alarmed drives, no fault", *(f"{a['alarmed_drives']} of {a['drives']}" for a in alarms)],
        ["alarmed pieces an hour judged", *(rate(a["per_judged_h"]) for a in alarms)],
        [
            "starts, untouched drive alarms",
            *(f"{of[0]['untouched_alarms']} of {of[0]['counted']}" for of in faults),
        ],
    ]
    named = [[same[0]["fault"], *map(found, same)] for same in zip(*faults, strict=False)]
    rows += [
        *named,
        [
            "all faults",
            *(f"{sum(r['found'] for r in of)} of {sum(r['counted'] for r in of)}" for of in faults),
        ],
    ]
    if best is None:
        return rows
    before = [""] * (len(rows) - 1 - len(named))
    return [row + [name] for row, name in zip(rows, [*before, *best, ""], strict=False)]


# -------------------------------------------------------------------------------------------------------- all


def _without_faults(row: dict) -> str:
    """Why no fault is injected into a drive."""
    if row["duration_s"] <= SHORTEST_FOR_FAULTS_S:
        return f"{row['duration_s']:.1f} s long, no more than {SHORTEST_FOR_FAULTS_S:g} s"
    return f"less than {FOUND_WITHIN_S:g} s of judged, excited driving after {FAULT_FROM_S:g} s"


def _one_rate(alphas: Iterable[float | None]) -> float | None:
    """The alpha of a detector's calibrations, one for each drive left out; None where any of them states
    none."""
    found = set(alphas)
    return None if None in found else found.pop()


def evaluate(
    stored: StoredIdentification,
    drives: DriveSet,
    core: Core,
    *,
    workers: Map = map,
    progress: Callable[[str], None] = lambda _: None,
) -> dict:
    """Leave-one-drive-out evaluation, the drives mapped by ``workers`` (base/parallel.py); returns the
    JSON-able table.

    InputError without any judged drive beside those that set the bounds.
    """
    project, alpha, seed = stored.project, stored.project.frame_test.alpha, stored.project.seed
    frame, energy = stored.calibration.scores, stored.energy.calibration.scores
    if not frame:
        raise InputError(
            stored.folder,
            "drives",
            "every judged drive set the bounds: none is left to evaluate",
            "at least one drive whose "
            f"split is not {' or '.join(project.data.bound_split)} and in which a frame counts",
        )
    scores = {MONITOR: joint_scores(frame, energy), "frame": frame, "energy": energy}
    floors = {MONITOR: 1.0 + ROUNDING, "frame": 1.0, "energy": 1.0 + ROUNDING}
    items = [
        (
            drives.experiments[name],
            {
                what: calibrate({k: v for k, v in of.items() if k != name}, alpha, floor=floors[what])
                for what, of in scores.items()
            },
        )
        for name in frame
    ]
    rows: list[dict] = []
    cases: dict[str, dict[str, list[Case]]] = {
        d: {f.label: [] for f in FAULTS} for d in (MONITOR, EXPORTED, *TESTS)
    }
    for row, found in workers(partial(_evaluate_drive, drives.reader, core), items):
        progress(row["run"])
        rows.append(row | {"scores": {what: of.get(row["run"]) for what, of in scores.items()}})
        for detector, by_fault in found.items():
            for label, members in by_fault.items():
                cases[detector][label] += members

    def pieces(detector: str, members: list[dict]) -> dict:
        return vars(
            Pieces.of(
                [(r["alarmed"][detector], r["pieces"]) for r in members],
                [r["judged_s"] for r in members],
                seed,
            )
        )

    groups = {"all": rows} | {
        d: [r for r in rows if r["driver"] == d] for d in sorted({r["driver"] for r in rows})
    }
    faults, baselines = _fault_rows(cases[MONITOR]), []
    if len(rows) >= FEWEST_FOR_BASELINES:
        study = BaselineStudy(stored, drives, core, left_out=tuple(frame), workers=workers, progress=progress)
        baselines = _evaluate_baselines(study, rows, seed)
    stated = {what: _one_rate(r["calibration"][what]["alpha"] for r in rows) for what in scores}
    apart = [stated[test] for test in TESTS]
    stated |= {EXPORTED: None if None in apart else sum(apart)}
    stated |= {b["kind"]: _one_rate(c["alpha"] for c in b["chosen"].values()) for b in baselines}
    best = [
        ranking({MONITOR: row} | {b["kind"]: b["faults"][i] for b in baselines})
        for i, row in enumerate(faults)
    ]
    return {
        "threshold_rule": "all other drives that did not set the bounds",
        "claims": {
            "identified": {"frame": stored.calibration.claim(), "energy": stored.energy.calibration.claim()},
            "left_one_out": {
                what: sorted({r["calibration"][what]["claim"] for r in rows}) for what in scores
            },
        },
        "stated_rates": stated,
        "drives": rows,
        "without_faults": {r["run"]: _without_faults(r) for r in rows if not r["fault_starts_s"]},
        "left_out": stored.manifest["drives"]["left_out"],
        "false_alarms": {g: pieces(MONITOR, members) for g, members in groups.items()},
        "faults": [row | {"best": names} for row, names in zip(faults, best, strict=False)],
        "tests": {
            d: {"false_alarms": pieces(d, rows), "faults": _fault_rows(cases[d])} for d in (EXPORTED, *TESTS)
        },
        "baselines": baselines,
    }
