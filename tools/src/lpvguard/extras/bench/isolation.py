"""Confusion table of fault isolation for a car with four redundant outputs (THEORY 7.21).

The scales come from an hour of healthy drives of the synthetic car (_redundant_car.py). Every fault begins in
each of ``--drives`` other drives, and the window after its beginning is judged. The column "predicted" says
yes if the table of isolability distinguishes the part from every other part at the fault's size.

With ``--vehicle`` and ``--data``, the bench judges measured drives of a project with [isolation]. It plants
faults of every sensor in pieces of drives. The scales come from the other drives. With a single drive, they
come from its other pieces.

With ``--nuisance``, the bench judges other loads and tyres of the synthetic car, first undeclared. Then the
scales also come from a group of drives with each of them. ``--hours`` counts windows that differ in so many
hours of each, in place of the table.
"""

from collections import Counter
from collections.abc import Iterable, Mapping
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from ...base.errors import InputError
from ...base.parallel import workers
from ...base.rates import hourly_words, per_hour, rate, share_words
from ...drives.tables import Drive, list_experiments, read_drive
from ...identify.isolation import VEHICLE, Changes, Isolation, is_separable, residual_structure
from ...vehicle.nominal import NominalModel
from ...vehicle.project import Project, load_project
from . import parser, require_at_least, show
from ._planted_parts import held_out, pieces_of, planted
from ._redundant_car import DOUBLE, FAULTS, FURTHER, NUISANCES, PartFault, redundant_drives, redundant_project

HEALTHY_DRIVES, HEALTHY_S, FROM_S = 20, 180.0, 40.0
"""Number and length [s] of the drives for the scales; time at which a fault begins [s]."""
GROUP_DRIVES = 8
"""Number of drives with a declared nuisance."""
RATE_PER_1000_H = 10.0
"""Rate of alarms of the scales "rated": one in 100 h."""
LONG_S, LONG_DRIVES = 600.0, 60
"""Length of a drive whose windows are counted [s]; number of drives that are simulated at once."""
KINDS = ("right", "one of", "wrong", "no single", "healthy")
"""Outcomes: only the right part, the right part among others, other parts, no part, no difference."""


def outcome(parts: tuple[str, ...], differs: bool, true: set[str]) -> str:
    """Return the outcome (one of KINDS) of a window; ``true`` holds the faulty parts."""
    if not differs:
        return "healthy"
    if not parts:
        return "no single"
    if len(parts) == 1:
        return "right" if parts[0] in true else "wrong"
    return "one of" if true & set(parts) else "wrong"


def predicted(isolation: Isolation, fault: PartFault) -> bool:
    """Tell if the table of isolability distinguishes the fault's part from every other part."""
    what, size = {
        "gain": (f"{fault.signal} gain", abs(fault.value - 1)),
        "bias": (f"{fault.signal} bias", fault.value),
        "delay": (f"{fault.signal} delay", fault.value),
        "speed": ("speed factor", abs(fault.value - 1)),
        "tyre": ("K factor", abs(1 / fault.value - 1)),
        "load": ("K factor", abs(fault.value - 1)),
        "offset": ("road_wheel_angle offset", fault.value),
    }[fault.kind]
    return _is_isolable(isolation, what, size)


def _is_isolable(isolation: Isolation, what: str, size: float) -> bool:
    """Tell if a size is large enough to distinguish its part from every other part in a window."""
    return max(isolation.isolable()[what].values()) <= size


Named = tuple[tuple[str, ...], bool]
"""Parts that a window names, and whether the window differs from the model."""


def _named(changes: Changes, isolation: Isolation, drive: Drive, from_s: float = FROM_S) -> Named:
    """Judge the window after ``from_s``: the named parts, and whether the window differs from the model."""
    stretches = list(changes.blocks(drive, from_s, from_s + isolation.window_s))
    finding = isolation.name(isolation.evidence(stretches))
    return finding.parts, finding.differs


def _row(fault: str, part: str, isolable: bool | None, named: Iterable[Named]) -> dict[str, Any]:
    """Make a row of the table; ``part`` holds the faulty parts, joined by "and"."""
    named = list(named)
    counts = Counter(outcome(parts, differs, set(part.split(" and "))) for parts, differs in named)
    return {
        "fault": fault,
        "part": part,
        "predicted": isolable,
        "outcomes": {kind: counts[kind] for kind in KINDS},
        "names": dict(Counter(", ".join(parts) for parts, differs in named if differs)),
    }


def _share(kind: str, rows: list[dict[str, Any]]) -> dict[str, Any]:
    outcomes = [r["outcomes"] for r in rows]
    return rate(sum(o[kind] for o in outcomes), sum(sum(o.values()) for o in outcomes))


def _structure(project: Project) -> dict[str, Any]:
    structure = residual_structure(project)
    separable = {a: [b for b in structure if a != b and is_separable(structure, a, b)] for a in structure}
    return {"structure": structure, "told_apart": separable}


def bench_isolation(drives: int, window_s: float, seed: int, jobs: int) -> dict[str, Any]:
    """All numbers of the table."""
    project = redundant_project()
    changes = Changes(project, NominalModel(project))
    isolation = Isolation.from_drives(changes, redundant_drives(HEALTHY_DRIVES, HEALTHY_S, seed)[0], window_s)
    cases: list[tuple[PartFault, ...]] = [(), *((f,) for f in (*FAULTS, *FURTHER)), *DOUBLE]
    made = redundant_drives(drives, FROM_S + window_s + 1.0, seed + 1, cases, FROM_S)
    rows = []
    with workers(jobs) as run:
        for faults, drives_with in zip(cases, made, strict=True):
            rows.append(
                _row(
                    " and ".join(f.label for f in faults) or "none",
                    " and ".join(f.part for f in faults),
                    predicted(isolation, faults[0]) if len(faults) == 1 else None,
                    run(partial(_named, changes, isolation), drives_with),
                )
            )
    twelve = rows[1 : 1 + len(FAULTS)]
    return {
        "drives": drives,
        "window_s": window_s,
        "rows": rows,
        "right": _share("right", twelve),
        "wrong": _share("wrong", twelve),
        "wrong_of_two": _share("wrong", rows[-len(DOUBLE) :]),
        **_structure(project),
    }


def bench_nuisance(drives: int, window_s: float, seed: int, jobs: int) -> dict[str, Any]:
    """The numbers of loads and tyres that are no faults, undeclared and declared as groups."""
    project = redundant_project()
    changes = Changes(project, NominalModel(project))
    healthy = redundant_drives(HEALTHY_DRIVES, HEALTHY_S, seed)[0]
    groups = redundant_drives(GROUP_DRIVES, HEALTHY_S, seed + 2, NUISANCES)
    made = redundant_drives(drives, FROM_S + window_s + 1.0, seed + 3, ((), *NUISANCES))
    rows = []
    for kind, learnt in (("undeclared", healthy), ("declared", sum(groups, healthy))):
        isolation = Isolation.from_drives(changes, learnt, window_s)
        with workers(jobs) as run:
            for nuisance, judged in zip(((), *NUISANCES), made, strict=True):
                label = " and ".join(f.label for f in nuisance) or "none"
                named = run(partial(_named, changes, isolation), judged)
                rows.append(_row(f"{label}, {kind}", VEHICLE if nuisance else "", None, named))
    undeclared = rows[1 : 1 + len(NUISANCES)]
    return {
        "drives": drives,
        "window_s": window_s,
        "rows": rows,
        "right": _share("right", undeclared),
        "wrong": _share("wrong", undeclared),
        **_structure(project),
    }


def _differing(
    changes: Changes, isolations: Mapping[str, Isolation], drive: Drive
) -> dict[str, list[tuple[str, ...] | None]]:
    """Parts that each window of a drive names by each of several scales; None where the window agrees."""
    stretches = list(changes.blocks(drive))
    named: dict[str, list[tuple[str, ...] | None]] = {}
    for kind, isolation in isolations.items():
        findings = [isolation.name(w) for w in isolation.windows(stretches, changes)]
        named[kind] = [f.parts if f.differs else None for f in findings]
    return named


def bench_nuisance_hours(hours: float, window_s: float, seed: int, jobs: int) -> dict[str, Any]:
    """Count the windows that differ in hours of driving with each nuisance, undeclared and declared."""
    project = redundant_project()
    changes = Changes(project, NominalModel(project))
    healthy = redundant_drives(HEALTHY_DRIVES, HEALTHY_S, seed)[0]
    groups = redundant_drives(GROUP_DRIVES, HEALTHY_S, seed + 2, NUISANCES)
    settings = project.frame_test.model_copy(update={"alarms_per_1000_h": RATE_PER_1000_H})
    rated = Changes(project.model_copy(update={"frame_test": settings}), changes.model)
    isolations = {
        "undeclared": Isolation.from_drives(changes, healthy, window_s),
        "declared": Isolation.from_drives(changes, sum(groups, healthy), window_s),
        "declared, rated": Isolation.from_drives(rated, sum(groups, healthy), window_s),
    }
    cases: list[tuple[PartFault, ...]] = [(), *NUISANCES]
    counts: dict[tuple[str, tuple[PartFault, ...]], Counter[str]] = {
        (kind, case): Counter() for kind in isolations for case in cases
    }
    batches = int(np.ceil(hours * 3600 / (LONG_S * LONG_DRIVES)))
    with workers(jobs) as run:
        for batch in range(batches):
            made = redundant_drives(LONG_DRIVES, LONG_S, 1000 * (seed + 4) + batch, cases)
            for case, drives in zip(cases, made, strict=True):
                for named in run(partial(_differing, changes, isolations), drives):
                    for kind, windows in named.items():
                        own = [parts for parts in windows if parts is not None]
                        counts[kind, case].update(
                            windows=len(windows),
                            differ=len(own),
                            drives=bool(own),
                            sensor=sum(bool(parts) and VEHICLE not in parts for parts in own),
                        )
    rows = []
    for (kind, case), n in counts.items():
        label = " and ".join(f.label for f in case) or "none"
        judged_h = n["windows"] * window_s / 3600
        rows.append(
            {
                "nuisance": f"{label}, {kind}",
                "judged_h": judged_h,
                "drives_with": n["drives"],
                "differ": n["differ"],
                "per_100_h": per_hour(n["differ"], judged_h / 100),
                "sensor": rate(n["sensor"], n["differ"]),
            }
        )
    return {"drives": LONG_DRIVES * batches, "window_s": window_s, "rows": rows}


def hour_words(result: dict[str, Any]) -> str:
    """Write the table of `bench_nuisance_hours`."""
    lines = [
        f"{result['drives']} drives of {LONG_S:g} s each, windows of {result['window_s']:g} s",
        f"{'nuisance':<46}{'judged h':>9}{'drives':>8}  differing windows in 100 h (95 %)       sensor named",
    ]
    for r in result["rows"]:
        start = f"{r['nuisance']:<46}{r['judged_h']:>9.1f}{r['drives_with']:>8}"
        lines.append(f"{start}  {hourly_words(r['per_100_h']):<40}{share_words(r['sensor'])}")
    return "\n".join(lines)


def bench_measured(project: Project, drives: list[Drive], window_s: float, size: float) -> dict[str, Any]:
    """Compute the numbers for faults planted in measured drives; ``size`` is a factor of the usual sizes.

    Raises InputError if there are too few drives.
    """
    changes = Changes(project, NominalModel(project))
    pieces = pieces_of(changes, drives, window_s)
    if len({name for name, _ in pieces}) < 3:
        counted = f"{len(pieces)} pieces of {window_s:g} s in {len(drives)} drives"
        raise InputError("bench isolation", "--data", counted, "three drives, or three pieces of one")
    spread_u, spread_y = (np.concatenate([getattr(d, x) for d in drives]).std(axis=0) for x in ("u", "y"))
    folds = list(held_out(changes, pieces, window_s))
    rows = []
    for fault in (None, *planted(project, spread_u, spread_y, size)):
        named, isolable = [], True
        for isolation, held in folds:
            for drive in held:
                faulty = drive if fault is None else fault.within(changes, drive)
                named.append(_named(changes, isolation, faulty, 0.0))
            isolable &= fault is None or _is_isolable(isolation, fault.column.what, abs(fault.size))
        label, part = ("none", "") if fault is None else (fault.label, fault.column.part)
        rows.append(_row(label, part, None if fault is None else isolable, named))
    return {
        "drives": len(pieces),
        "window_s": window_s,
        "rows": rows,
        "right": _share("right", rows[1:]),
        "wrong": _share("wrong", rows[1:]),
        **_structure(project),
    }


def words(result: dict[str, Any]) -> str:
    """The table."""
    lines = [
        f"{result['drives']} drives a fault, windows of {result['window_s']:g} s",
        f"{'fault':<54}" + "".join(f"{kind:>10}" for kind in KINDS) + "  predicted",
    ]
    for r in result["rows"]:
        counts = "".join(f"{r['outcomes'][kind]:>10}" for kind in KINDS)
        said = {None: "", True: "yes", False: "no"}[r["predicted"]]
        lines.append(f"{r['fault']:<54}{counts}  {said}".rstrip())
    lines += [
        f"single parts: right {share_words(result['right'])}; wrong {share_words(result['wrong'])}",
        *(
            f"two faults at once, named by another part: {share_words(result[key])}"
            for key in ("wrong_of_two",)
            if key in result
        ),
        *(
            f"by structure {part} is told from {', '.join(others) or 'no other part'}"
            for part, others in result["told_apart"].items()
        ),
    ]
    return "\n".join(lines)


def _measured(vehicle: str | None, data: Path | None) -> tuple[Project, list[Drive]]:
    """Load the project and the drives of the options; raise InputError if one or [isolation] is missing."""
    if vehicle is None or data is None:
        raise InputError("bench isolation", "--vehicle and --data", "one is missing", "both or none")
    project = load_project(vehicle)
    if project.isolation is None:
        raise InputError(vehicle, "isolation", "missing", "a table [isolation], as `lpvguard new` writes it")
    drives = [read_drive(e.path, project) for e in list_experiments(data)]
    return project, drives


def main(argv: list[str]) -> None:
    """Run `lpvguard bench isolation`."""
    arguments = parser("isolation", __doc__)
    arguments.add_argument("--drives", type=int, default=50, help="drives of each fault")
    arguments.add_argument("--window", type=float, default=60.0, help="s of driving that a name rests on")
    arguments.add_argument("--seed", type=int, default=1)
    arguments.add_argument("--jobs", type=int, default=1, help="processes that share the drives")
    arguments.add_argument("--nuisance", action="store_true", help="other loads and tyres in place of faults")
    arguments.add_argument("--hours", type=float, help="with --nuisance: hours of each in which to count")
    arguments.add_argument("--vehicle", help="project file with [isolation], of measured drives")
    arguments.add_argument("--data", type=Path, help="folder of its drives")
    arguments.add_argument("--size", type=float, default=1.0, help="factor of the planted faults' sizes")
    options = arguments.parse_args(argv)
    require_at_least("isolation", options, drives=1, window=10, jobs=1, size=0.01)
    if options.hours is not None:
        require_at_least("isolation", options, hours=1)
        result = bench_nuisance_hours(options.hours, options.window, options.seed, options.jobs)
        show(hour_words(result), result, options.json_out)
        return
    if options.vehicle or options.data:
        result = bench_measured(*_measured(options.vehicle, options.data), options.window, options.size)
    else:
        bench = bench_nuisance if options.nuisance else bench_isolation
        result = bench(options.drives, options.window, options.seed, options.jobs)
    show(words(result), result, options.json_out)
