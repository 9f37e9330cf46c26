"""Count the vehicle parts that windows name after injected faults and on untouched drives (THEORY 7.21).

The faults of `evaluate` act on all outputs at once, or on the input. These faults have no true part, so the
names are counted and not judged. ``bench isolation`` judges names. The scales come from all drives, including
the judged ones.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Iterator

from ..replay.replayer import Replay
from .detection import WAY_WORDS, Case

Names = dict[Case | None, list[str]]
"""Names of parts by case; the key None is the untouched drive."""
NOTHING, NO_SINGLE = "none", "no single part"


def name_after(replay: Replay, start_s: float) -> str:
    """Return the first part that a window names after ``start_s`` from the first sample, else NOTHING."""
    for named in replay.parts or ():
        if named.until_s > start_s:
            return " or ".join(named.parts) or NO_SINGLE
    return NOTHING


def part_table(names: Iterable[Names]) -> list[dict]:
    """Count the named parts by fault and way; the untouched drives come first."""
    total: Names = {}
    for by_case in names:
        for case, said in by_case.items():
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
    """Format the rows of `part_table` as sentences.

    Parameters
    ----------
    rows : list of dict

    Yields
    ------
    str
    """
    for row in rows:
        fault = "untouched drives" if row["fault"] is None else f"{WAY_WORDS[row['way']]}: {row['fault']}"
        yield f"{fault}: " + ", ".join(f"{name} {count}" for name, count in row["names"].items())
