"""Parts that windows name after injected faults, and on untouched drives (THEORY 7.20).

The faults of `evaluate` act on all outputs at once, or on the input. A part is no truth of theirs, so names
are counted and not judged; ``bench isolation`` judges them. The scales come from all drives, those judged
included.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Iterator

from ..replay.replayer import Replay
from .detection import WAY_WORDS, Case

Names = dict[Case | None, list[str]]
"""Names by case; None is the untouched drive."""
NOTHING, NO_SINGLE = "none", "no single part"


def name_after(replay: Replay, start_s: float) -> str:
    """First part that a window named which began or went on after ``start_s`` [s]; NOTHING without one."""
    for named in replay.parts or ():
        if named.until_s > start_s:
            return " or ".join(named.parts) or NO_SINGLE
    return NOTHING


def part_table(names: Iterable[Names]) -> list[dict]:
    """Rows of names and their counts, by fault and way, the untouched drives first."""
    total: Names = {}
    for of in names:
        for case, said in of.items():
            total.setdefault(case, []).extend(said)
    order = sorted(total, key=lambda case: case is not None)
    return [
        {
            "way": None if case is None else case.way,
            "fault": None if case is None else case.fault.label,
            "names": dict(Counter(total[case]).most_common()),
        }
        for case in order
    ]


def part_lines(rows: list[dict]) -> Iterator[str]:
    """The rows in words."""
    for row in rows:
        fault = "untouched drives" if row["fault"] is None else f"{WAY_WORDS[row['way']]}: {row['fault']}"
        yield f"{fault}: " + ", ".join(f"{name} {count}" for name, count in row["names"].items())
