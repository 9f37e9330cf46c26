"""`lpvguard evaluate`: what the frame test does on drives that did not set the bounds, leave-one-drive-out (DESIGN 4.8).

Every drive runs through the compiled core with a threshold calibrated on all *other* drives that did not set the bounds.
False alarms are counted in whole 60 s pieces; faults are injected from 60 s on and count as found when the first alarm
comes within 30 s of judged, excited driving, provided the untouched drive has none in that time.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial

import numpy as np

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


def alarmed_pieces(replay: Replay) -> tuple[int, int]:
    """(alarmed, all) whole 60 s pieces of a drive."""
    pieces = int(replay.duration_s // PIECE_S)
    hit = {int(a.t_s // PIECE_S) for a in replay.alarms}
    return sum(1 for p in range(pieces) if p in hit), pieces


def time_to_find(faulty: Replay, clean: Replay) -> tuple[float | None, bool]:
    """Judged, excited seconds from the fault to the first alarm (None: no alarm), and whether the untouched drive already
    has an alarm within the time allowed (then the case does not count)."""
    Ts = clean.Ts
    first = int(round(FAULT_FROM_S / Ts))
    relevant = clean.judged & clean.in_range & clean.excited
    relevant[:first] = False
    clock = np.cumsum(relevant) * Ts

    def first_alarm(replay: Replay) -> float | None:
        times = [a.t_s for a in replay.alarms if a.t_s > FAULT_FROM_S]
        return float(clock[min(int(round(times[0] / Ts)), len(clock) - 1)]) if times else None

    disturbed = first_alarm(clean)
    return first_alarm(faulty), disturbed is not None and disturbed <= FOUND_WITHIN_S


def _evaluate_drive(reader: DriveReader, core: Core, case: tuple[Experiment, Calibration]) -> tuple[dict, dict[str, dict]]:
    """One drive with a threshold of its own: its row, and per fault what became of it (none for short drives)."""
    experiment, calibration = case
    replayer = Replayer(reader.project, core, threshold=calibration.threshold)
    drive = reader.read(experiment)[0]
    clean = replayer.replay(drive)
    alarmed, pieces = alarmed_pieces(clean)
    relevant = clean.in_range & clean.excited
    row = {"run": experiment.name, "driver": experiment.driver, "threshold": calibration.threshold, "alpha": calibration.alpha,
           "alarmed": alarmed, "pieces": pieces, "judged_s": clean.judged_s,
           "judged_of_in_range_excited": float((clean.judged & relevant).sum() / max(1, relevant.sum()))}
    found = {}
    for fault in FAULTS if drive.duration_s > SHORTEST_FOR_FAULTS_S else ():
        s, disturbed = time_to_find(replayer.replay(inject(drive, fault, FAULT_FROM_S, reader.project.Ts_s)), clean)
        found[fault.label] = {"run": experiment.name, "s": s, "counts": not disturbed}
    return row, found


def evaluate(stored: StoredIdentification, drives: DriveSet, core: Core, *, workers: Map = map,
             progress: Callable[[str], None] = lambda _: None) -> dict:
    """Leave-one-drive-out evaluation, the drives mapped by ``workers`` (parallel.py); returns the JSON-able table."""
    project, scores = stored.project, stored.calibration.scores
    rows, per_fault = [], {f.label: [] for f in FAULTS}
    cases = [(drives.experiments[name], calibrate({k: v for k, v in scores.items() if k != name}, project.frame_test.alpha))
             for name in scores]
    for row, found in workers(partial(_evaluate_drive, drives.reader, core), cases):
        progress(row["run"])
        rows.append(row | {"score": scores[row["run"]]})
        for label, case in found.items():
            per_fault[label].append(case)
    seed = project.seed
    groups = {"all": rows} | {d: [r for r in rows if r["driver"] == d] for d in sorted({r["driver"] for r in rows})}
    return {
        "threshold_rule": f"all other drives that did not set the bounds, alpha {project.frame_test.alpha:g} "
                          f"(stated from {FEWEST_FOR_ALPHA} drives on)",
        "drives": rows,
        "false_alarms": {g: vars(Pieces.of([(r["alarmed"], r["pieces"]) for r in members], seed))
                         for g, members in groups.items()},
        "faults": [{"fault": label, "found": sum(1 for c in cases if c["counts"] and c["s"] is not None
                                                 and c["s"] <= FOUND_WITHIN_S),
                    "counted": sum(1 for c in cases if c["counts"]), "drives": len(cases), "cases": cases}
                   for label, cases in per_fault.items()],
    }
