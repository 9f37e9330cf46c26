"""Which part a fault is named as: the confusion table of a car with four redundant outputs (THEORY 7.21).

The scales come from an hour of healthy drives of the synthetic car (_redundant_car.py). Every fault
begins in each of ``--drives`` other drives. The window after it is judged. The column "predicted" says yes
where the table of isolability tells the part from every other one at the fault's size.
"""

from collections import Counter
from functools import partial
from typing import Any

from ...base.parallel import workers
from ...base.rates import rate, share_words
from ...drives.tables import Drive
from ...identify.isolation import Changes, Isolation, residual_structure, told_apart
from ...vehicle.nominal import NominalModel
from . import parser, require_at_least, show
from ._redundant_car import DOUBLE, FAULTS, FURTHER, PartFault, redundant_drives, redundant_project

HEALTHY_DRIVES, HEALTHY_S, FROM_S = 20, 180.0, 40.0
"""Drives of the scales and their length [s]; begin of a fault [s]."""
KINDS = ("right", "one of", "wrong", "no single", "healthy")
"""Outcomes: the part alone, the part among others, other parts, none that explains it, no difference."""


def outcome(parts: tuple[str, ...], differs: bool, true: set[str]) -> str:
    """Outcome of KINDS of a window; ``true``: parts at fault."""
    if not differs:
        return "healthy"
    if not parts:
        return "no single"
    if len(parts) == 1:
        return "right" if parts[0] in true else "wrong"
    return "one of" if true & set(parts) else "wrong"


def predicted(isolation: Isolation, fault: PartFault) -> bool:
    """Return whether the table of isolability tells the fault's part from every other one."""
    what, size = {
        "gain": (f"{fault.signal} gain", abs(fault.value - 1)),
        "bias": (f"{fault.signal} bias", fault.value),
        "delay": (f"{fault.signal} delay", fault.value),
        "speed": ("speed factor", abs(fault.value - 1)),
        "tyre": ("K factor", abs(1 / fault.value - 1)),
        "load": ("K factor", abs(fault.value - 1)),
        "offset": ("road_wheel_angle offset", fault.value),
    }[fault.kind]
    return max(isolation.isolable()[what].values()) <= size


def _named(changes: Changes, isolation: Isolation, drive: Drive) -> tuple[tuple[str, ...], bool]:
    """Parts that the window after FROM_S names, and whether it differs."""
    stretches = list(changes.blocks(drive, FROM_S, FROM_S + isolation.window_s))
    finding = isolation.name(isolation.evidence(stretches))
    return finding.parts, finding.differs


def bench_isolation(drives: int, window_s: float, seed: int, jobs: int) -> dict[str, Any]:
    """All numbers of the table."""
    project = redundant_project()
    changes = Changes(project, NominalModel(project))
    isolation = Isolation.from_drives(changes, redundant_drives(HEALTHY_DRIVES, HEALTHY_S, seed)[0], window_s)
    cases: list[tuple[PartFault, ...]] = [(), *((f,) for f in (*FAULTS, *FURTHER)), *DOUBLE]
    made = redundant_drives(drives, FROM_S + window_s + 1.0, seed + 1, cases, FROM_S)
    rows: list[dict[str, Any]] = []
    outcomes: list[Counter[str]] = []
    with workers(jobs) as run:
        for faults, drives_with in zip(cases, made, strict=True):
            named = list(run(partial(_named, changes, isolation), drives_with))
            true = {f.part for f in faults}
            counts = Counter(outcome(parts, differs, true) for parts, differs in named)
            outcomes.append(counts)
            rows.append(
                {
                    "fault": " and ".join(f.label for f in faults) or "none",
                    "part": " and ".join(f.part for f in faults),
                    "predicted": predicted(isolation, faults[0]) if len(faults) == 1 else None,
                    "outcomes": {kind: counts[kind] for kind in KINDS},
                    "names": dict(Counter(", ".join(parts) for parts, differs in named if differs)),
                }
            )
    structure = residual_structure(project)
    twelve, doubles = outcomes[1 : 1 + len(FAULTS)], outcomes[-len(DOUBLE) :]

    def share(kind: str, rows_counted: list[Counter[str]]) -> dict[str, Any]:
        return rate(sum(counts[kind] for counts in rows_counted), drives * len(rows_counted))

    return {
        "drives": drives,
        "window_s": window_s,
        "rows": rows,
        "right": share("right", twelve),
        "wrong": share("wrong", twelve),
        "wrong_of_two": share("wrong", doubles),
        "structure": structure,
        "told_apart": {
            a: [b for b in structure if a != b and told_apart(structure, a, b)] for a in structure
        },
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
        f"twelve single faults: right {share_words(result['right'])}; wrong {share_words(result['wrong'])}",
        f"two faults at once, named by another part: {share_words(result['wrong_of_two'])}",
        *(
            f"by structure {part} is told from {', '.join(others) or 'no other part'}"
            for part, others in result["told_apart"].items()
        ),
    ]
    return "\n".join(lines)


def main(argv: list[str]) -> None:
    """`lpvguard bench isolation`."""
    arguments = parser("isolation", __doc__)
    arguments.add_argument("--drives", type=int, default=50, help="drives of each fault")
    arguments.add_argument("--window", type=float, default=60.0, help="s of driving that a name rests on")
    arguments.add_argument("--seed", type=int, default=1)
    arguments.add_argument("--jobs", type=int, default=1, help="processes that share the drives")
    options = arguments.parse_args(argv)
    require_at_least("isolation", options, drives=1, window=10, jobs=1)
    result = bench_isolation(options.drives, options.window, options.seed, options.jobs)
    show(words(result), result, options.json_out)
