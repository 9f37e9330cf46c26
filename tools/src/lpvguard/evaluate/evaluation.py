"""`lpvguard evaluate`: compare the monitor and five baselines on drives that did not set the bounds.

The compiled core processes every drive. One drive of the identification is left out at a time (THEORY 7.3).
Thresholds for this drive come from all *other* drives that did not set the bounds. Drives that the
identification never saw are judged with its stored thresholds (judged_drives.py).

The monitor is compared with all tests at one threshold, calibrated jointly (identify/joint.py). Any of
its tests alarms on a further drive with probability at most alpha, like a baseline. The table also has each
test alone at alpha, and the tests as exported. With ``frame_test.joint`` these have the joint threshold, else
each its own, with at most four times alpha in total. If fewer drives calibrate than alpha needs, no rate is
stated. The detectors are then compared by counts only (`stated_rates`).

The module ``false_alarms.py`` defines false alarms, ``detection.py`` defines found faults, and
``baseline_study.py`` tunes the baselines.
"""

from collections.abc import Callable, Iterable, Iterator
from functools import partial
from itertools import product

import numpy as np

from ..base.errors import InputError
from ..base.parallel import Map
from ..core.compiled import TESTS, Core
from ..drives.tables import Drive, Experiment
from ..identify.calibration import Calibration, Recordings, change_score, energy_score, score
from ..identify.identification import DriveSet, StoredIdentification
from ..identify.joint import POOLS, joint_score, joint_thresholds
from ..identify.passes import DriveReader
from ..replay.replayer import Replay, Replayer
from ..vehicle.project import EvaluationSettings, Project
from .baseline_study import BaselineStudy, evaluate_baselines
from .causes import DIAGNOSED_S, CauseOutcome, CauseOutcomes, cause_table
from .comparison import EXPORTED, LEFT_ONE_OUT, MONITOR, duels
from .detection import FaultOutcome, Injection, Outcomes, fault_rows, margins, ranking, refutable
from .false_alarms import alarmed_pieces, alarming, false_alarms, piece_starts
from .judged_drives import JudgedDrives, calibrations_of, rate_of
from .parts import Names, name_after, part_table

FEWEST_FOR_BASELINES = 2
"""Fewest calibration drives: a baseline has no default threshold, so one must remain if a drive is left
out."""


Found = dict[str, Outcomes]
"""Outcomes per detector and case."""


def _evaluate_drive(
    reader: DriveReader,
    core: Core,
    injection: Injection,
    item: tuple[Experiment, Recordings, dict[str, Calibration], np.ndarray | None],
) -> tuple[dict, Found, CauseOutcomes, Names]:
    """Row of one drive, outcomes per detector and case, and causes and parts from the exported tests.

    Recordings and calibrations are the drive's own. A drive without qualified stretches has no outcomes.
    """
    experiment, recordings, calibrations, pool_scale = item
    together, apart = _replayers(reader.project, core, calibrations, pool_scale)
    detectors = {
        MONITOR: (together, None),
        EXPORTED: (apart, None),
        **{test: (apart, test) for test in calibrations if test != MONITOR},
    }
    project = reader.project
    drive, Ts = reader.read(experiment)[0], project.Ts_s
    untouched = {replayer: replayer.replay(drive) for replayer in (together, apart)}
    replay, injected = untouched[together], list(injection.into(untouched[together], project.seed))
    relevant, starts = replay.in_range & replay.excited, piece_starts(len(replay.judged), Ts)
    row = {
        **_identity(experiment, recordings),
        "calibration": {what: _stated(c) for what, c in calibrations.items()},
        "alarmed": {
            name: alarmed_pieces(untouched[replayer], test)[0] for name, (replayer, test) in detectors.items()
        },
        "pieces": len(starts),
        "last_piece_s": round((len(replay.judged) - 1 - int(starts[-1])) * Ts, 6),
        "duration_s": replay.duration_s,
        "judged_s": replay.judged_s,
        "missing_samples": replay.missing_samples,
        "judged_of_in_range_excited": (
            float((replay.judged & relevant).sum() / relevant.sum()) if relevant.any() else None
        ),
        "fault_starts_s": sorted({clock.first * Ts for _, clock in injected}),
        "scores": _drive_scores(replay),
    }
    outcomes: Found = {name: {case: [] for case in injection.cases} for name in detectors}
    own = margins(replay, drive.t[0])
    causes: CauseOutcomes = {case: [] for case in injection.cases}
    names: Names = {} if apart.namer is None else {None: [name_after(untouched[apart], 0.0)]}

    for case, clock in injected:
        faulty_drive = case.into(drive, clock, Ts, DIAGNOSED_S)
        faulty = {replayer: replayer.replay(faulty_drive) for replayer in untouched}
        if apart.namer is not None:
            names.setdefault(case, []).append(name_after(faulty[apart], clock.first * Ts))
        known = refutable(clock, margins(faulty[together], drive.t[0]), own)
        for name, (replayer, test) in detectors.items():
            first, without = (clock.read(alarming(r[replayer], test)) for r in (faulty, untouched))
            outcome = FaultOutcome.from_times(experiment.name, Ts, clock, first, without, known)
            outcomes[name][case].append(outcome)
        if outcomes[EXPORTED][case][-1].detected:
            causes[case].append(
                CauseOutcome.from_replay(case, project, clock, drive, faulty_drive, faulty[apart])
            )
    if core.diagnoses:
        causes |= _further_causes(apart, injection, drive, untouched[apart])
    return row, outcomes, causes, names


def _replayers(
    project: Project, core: Core, calibrations: dict[str, Calibration], pool_scale: np.ndarray | None
) -> list[Replayer]:
    """Replayers with the joint and with one threshold per test; ``pool_scale`` gives a ratio of 1."""
    thresholds = {what: c.threshold for what, c in calibrations.items()}
    # The core compares a pool with the threshold of frames.
    unit = thresholds["frame"] / thresholds.get(POOLS, thresholds["frame"])
    return [
        Replayer(
            project,
            core,
            threshold=frame,
            energy_threshold=energy,
            change_threshold=change,
            pool_scale=None if pool_scale is None else scale * pool_scale,
        )
        for (frame, energy, change), scale in (
            (joint_thresholds(thresholds[MONITOR]), 1.0),
            ([thresholds[t] for t in TESTS], unit),
        )
    ]


def _identity(experiment: Experiment, recordings: Recordings) -> dict[str, str]:
    """Driver, recording and group of a drive."""
    group = recordings.groups.get(experiment.name)
    named = {
        "run": experiment.name,
        "driver": experiment.driver,
        "recording": recordings.named(experiment.name),
    }
    return named if group is None else named | {"group": group}


def _further_causes(
    replayer: Replayer, injection: Injection, drive: Drive, untouched: Replay
) -> CauseOutcomes:
    """Judge the named causes of the further faults that the monitor of ``replayer`` found."""
    project, Ts = replayer.project, replayer.project.Ts_s
    causes: CauseOutcomes = {case: [] for case in injection.further_cases}
    hits = alarming(untouched)
    for case, clock in product(causes, injection.clocks(untouched, project.seed)):
        faulty = case.into(drive, clock, Ts, DIAGNOSED_S)
        replay = replayer.replay(faulty)
        first, without = clock.read(alarming(replay)), clock.read(hits)
        if FaultOutcome.from_times(drive.name, Ts, clock, first, without).detected:
            causes[case].append(CauseOutcome.from_replay(case, project, clock, drive, faulty, replay))
    return causes


def _drive_scores(replay: Replay) -> dict[str, float | None]:
    """Scores of a drive; a detector alarms if its score exceeds its threshold. None if it did not judge."""
    tests = {
        "frame": score(replay.run),
        "energy": energy_score(replay.run),
        "change": change_score(replay.run),
        POOLS: float(replay.run.frames.pooled.max(initial=0.0)),
    }
    return {MONITOR: joint_score(tests)} | tests


def _stated(c: Calibration) -> dict:
    """Guarantee of a calibration, for the row of a drive."""
    return {
        "threshold": c.threshold,
        "drives": len(c.scores),
        "alpha": c.alpha,
        "conditional_bound": c.conditional_bound,
        "claim": c.claim(),
    }


def _without_faults(row: dict, injection: Injection) -> str:
    """Reason why no fault is injected into a drive."""
    if row["duration_s"] <= injection.shortest_s:
        return f"{row['duration_s']:.1f} s long, no more than {injection.shortest_s:g} s"
    return f"less than {injection.within_s:g} s of judged, excited driving after {injection.from_s:g} s"


def _variance(reader: DriveReader, experiment: Experiment) -> np.ndarray:
    """Variance (n_y,) of the outputs of a drive."""
    return reader.read(experiment)[0].y.var(axis=0)


def _injection(
    stored: StoredIdentification, drives: DriveSet, settings: EvaluationSettings | None, workers: Map
) -> Injection:
    """Make the injection from the settings and from the outputs' spread in drives that set the bounds."""
    if settings is None:
        return Injection.usual()
    setting = [drives.experiments[n] for n in stored.manifest["drives"]["bounds"]]
    within = np.mean(list(workers(partial(_variance, drives.reader), setting)), axis=0)
    return Injection.from_settings(settings, np.sqrt(within))


def one_rate(alphas: Iterable[float | None]) -> float | None:
    """Common alpha of a detector's calibrations, one per left-out drive; None if one states no rate."""
    distinct = set(alphas)
    return None if None in distinct else distinct.pop()


def _false_alarms(detector: str, rows: list[dict]) -> dict:
    """FalseAlarms object of a detector over ``rows`` of drives."""
    return false_alarms([(r["alarmed"][detector], r["pieces"]) for r in rows], rows)


def _stated_rates(
    rows: list[dict], baselines: list[dict], scored: Iterable[str], *, joint: bool
) -> dict[str, float | None]:
    """Stated rate of false alarms on a further drive, per detector; None means counts only.

    The exported tests have the rate of the ``joint`` threshold, or at most the sum of their own rates.
    """
    stated = {what: one_rate(r["calibration"][what]["alpha"] for r in rows) for what in scored}
    tests = [test for test in scored if test != MONITOR]
    apart = [rate for test in tests if (rate := stated[test]) is not None]
    together = sum(apart) if len(apart) == len(tests) else None
    stated |= {EXPORTED: stated[MONITOR] if joint else together}
    return stated | {b["kind"]: one_rate(c["alpha"] for c in b["chosen"].values()) for b in baselines}


def evaluate(
    stored: StoredIdentification,
    drives: DriveSet,
    core: Core,
    *,
    held_out: list[Experiment] | None = None,
    settings: EvaluationSettings | None = None,
    workers: Map = map,
    progress: Callable[[str], None] = lambda _: None,
) -> dict:
    """Evaluate the monitor, its tests and the baselines on judged drives.

    By default each drive of the identification is judged without itself.

    Parameters
    ----------
    stored : StoredIdentification
    drives : DriveSet, the identification's drives
    core : Core
    held_out : list of Experiment, optional, judged instead (judged_drives.drives_to_judge)
    settings : EvaluationSettings, optional, for the injected faults, by default the usual ones
    workers : Map
    progress : Callable, reports progress

    Returns
    -------
    dict, JSON-able table

    Raises
    ------
    InputError
        If no drive is judged.

    References
    ----------
    THEORY 7.3, 7.9.
    """
    judged = (
        JudgedDrives.left_one_out(stored, drives)
        if held_out is None
        else JudgedDrives.held_out(stored, held_out)
    )
    injection = _injection(stored, drives, settings, workers)
    items = [
        (e, judged.recordings, judged.calibrations[n], judged.pool_scale[n])
        for n, e in judged.experiments.items()
    ]
    rows: list[dict] = []
    names = (MONITOR, EXPORTED, *calibrations_of(stored))
    cases: Found = {d: {case: [] for case in injection.cases} for d in names}
    causes: CauseOutcomes = {case: [] for case in (*injection.cases, *injection.further_cases)}
    left_out: dict[str, str] = dict(stored.manifest["drives"]["left_out"]) if held_out is None else {}
    parts: list[Names] = []
    evaluated: Iterator[tuple[dict, Found, CauseOutcomes, Names]] = workers(
        partial(_evaluate_drive, drives.reader, core, injection), items
    )
    for row, outcomes, named, names_of_parts in evaluated:
        progress(row["run"])
        if row["scores"]["frame"] is None:
            left_out[row["run"]] = drives.reader.why_without_frames()
            continue
        rows.append(row)
        parts.append(names_of_parts)
        for detector, by_case in outcomes.items():
            for case, members in by_case.items():
                cases[detector][case] += members
        for case, cause_outcomes in named.items():
            causes[case] += cause_outcomes
    if not rows:
        name, why = next(iter(left_out.items()))
        raise InputError(
            judged.experiments[name].path, "", f"{why}; no drive to judge is left", "a judged drive"
        )
    known = cases[MONITOR]
    baselines = _baselines(stored, drives, core, judged, rows, known, injection, workers, progress)
    table = _table(stored, judged, rows, cases, baselines, injection)
    of_causes = cause_table(causes, stored.project, stored.diagnosis) if core.diagnoses else None
    named_parts = {"parts": part_table(parts)} if any(parts) else {}
    return table | {"causes": of_causes, **named_parts, "left_out": left_out}


def _baselines(
    stored: StoredIdentification,
    drives: DriveSet,
    core: Core,
    judged: JudgedDrives,
    rows: list[dict],
    known: Outcomes,
    injection: Injection,
    workers: Map,
    progress: Callable[[str], None],
) -> list[dict]:
    """Results of the baselines on the judged drives of ``rows``; empty if too few drives calibrate."""
    alone = judged.mode == LEFT_ONE_OUT
    if len(stored.calibration.scores) < FEWEST_FOR_BASELINES - (not alone):
        return []
    study = BaselineStudy(
        stored,
        drives,
        core,
        left_out=tuple(judged.experiments) if alone else (None,),
        injection=injection,
        workers=workers,
        progress=progress,
    )
    on = study.on([judged.experiments[r["run"]] for r in rows], left_out=alone)
    return evaluate_baselines(rows, on, known)


def _table(
    stored: StoredIdentification,
    judged: JudgedDrives,
    rows: list[dict],
    cases: Found,
    baselines: list[dict],
    injection: Injection,
) -> dict:
    """JSON object of `lpvguard evaluate` from rows of drives and cases of monitor and baselines."""
    tests = calibrations_of(stored)
    scored = (MONITOR, *tests)
    groups = {"all": rows} | {
        d: [r for r in rows if r["driver"] == d] for d in sorted({r["driver"] for r in rows})
    }
    for name in sorted({r["group"] for r in rows if "group" in r}):
        groups[f"group {name}"] = [r for r in rows if r.get("group") == name]
    faults = fault_rows(cases[MONITOR])
    best = [
        ranking({MONITOR: row} | {b["kind"]: b["faults"][i] for b in baselines})
        for i, row in enumerate(faults)
    ]
    return {
        "mode": judged.mode,
        "threshold_rule": judged.rule,
        "claims": {
            "identified": {test: c.claim() for test, c in tests.items()},
            judged.mode: {what: sorted({r["calibration"][what]["claim"] for r in rows}) for what in scored},
        },
        "stated_rates": _stated_rates(rows, baselines, scored, joint=stored.project.frame_test.joint),
        **({} if (rate := rate_of(judged, stored)) is None else {"rate": rate}),
        "drives": rows,
        "injection": injection.to_dict(),
        "without_faults": {r["run"]: _without_faults(r, injection) for r in rows if not r["fault_starts_s"]},
        "false_alarms": {g: _false_alarms(MONITOR, members) for g, members in groups.items()},
        "faults": [row | {"best": names} for row, names in zip(faults, best, strict=True)],
        "tests": {
            d: {"false_alarms": _false_alarms(d, rows), "faults": fault_rows(cases[d])}
            for d in (EXPORTED, *tests)
        },
        "baselines": baselines,
        "duels": duels(faults, baselines),
    }
