"""What terminal and page show of an evaluation.

The table has a column per detector. The words say at which rate of false alarms the detectors are compared.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

from .false_alarms import PIECE_S
from .rates import hourly_words, share_words

MONITOR = "monitor"
"""Name of our own detector beside the kinds of baselines.KINDS: both tests together, at one threshold."""
LEFT_ONE_OUT, HELD_OUT = "left_one_out", "held_out"
"""Which drives are judged: those of the identification, each without itself, or drives that it never saw."""
CALIBRATED = {LEFT_ONE_OUT: "each drive without itself", HELD_OUT: "drives that it never saw"}
"""What the thresholds judge, in words."""
EXPORTED = "exported"
"""Both tests, each at its own threshold, as `lpvguard export` writes them."""
COUNTS_ONLY = "counts only"
"""What stands in the place of a rate of false alarms that is not stated."""


def equal_rates(stated: Mapping[str, float | None]) -> str:
    """The clause for terminal and page that says how detectors are compared.

    It states the one rate of all of them. Where a rate is missing it says whose, and that there are counts
    only. ``stated``: per detector its rate or None. ValueError when the rates differ.
    """
    missing = [name for name, rate in stated.items() if rate is None]
    if missing:
        return (
            f"by {COUNTS_ONLY}: too few drives calibrate, so no rate of false alarms is stated for "
            f"{', '.join(missing)}"
        )
    (rate,) = set(stated.values())
    return f"at one guaranteed rate: each alarms on a further drive with probability at most {rate:g}"


@dataclass(frozen=True)
class DetectorColumn:
    """A detector in the table of detector_rows: its object of FalseAlarms, its rows of fault_rows, its stated
    rate or None."""

    alarms: dict
    faults: list[dict]
    stated: float | None


def columns(evaluation: dict) -> dict[str, DetectorColumn]:
    """Every detector of an evaluation by name, in the order of its JSON: the monitor, exported and each test,
    the baselines."""
    found = {MONITOR: (evaluation["false_alarms"]["all"], evaluation["faults"])}
    found |= {name: (t["false_alarms"], t["faults"]) for name, t in evaluation["tests"].items()}
    found |= {b["kind"]: (b["false_alarms"], b["faults"]) for b in evaluation["baselines"]}
    return {name: DetectorColumn(*of, evaluation["stated_rates"][name]) for name, of in found.items()}


def pieces_an_hour(alarms: dict) -> str:
    """Alarmed pieces an hour of judged driving, of an object of FalseAlarms; a dash without any."""
    return "–" if alarms["per_judged_h"] is None else f"{alarms['per_judged_h']:.2f}"


ALARM_HEAD = (
    "drivers",
    "alarmed drives",
    f"alarmed {PIECE_S:g} s pieces",
    "an hour judged",
    "alarmed recordings, 95 %",
    "an hour judged, 95 %",
    "judged, h",
)
"""Columns of alarm_rows."""


def alarm_rows(evaluation: dict) -> list[list[str]]:
    """False alarms of the monitor, a row per group of drivers."""
    return [
        [
            group,
            f"{row['alarmed_drives']} of {row['drives']}",
            f"{row['alarmed']} of {row['pieces']}",
            pieces_an_hour(row),
            share_words(row["recordings"]),
            hourly_words(row["recordings_per_judged_h"]),
            f"{row['judged_h']:.3f}",
        ]
        for group, row in evaluation["false_alarms"].items()
    ]


def detector_rows(detectors: list[DetectorColumn], best: list[str] | None = None) -> list[list[str]]:
    """Table rows of false alarms and found faults, a column per detector; ``best``: who leads, per fault, in
    a last column."""

    def found(row: dict) -> str:
        if not row["counted"]:
            return "no drive qualifies"
        return f"{row['found']} of {row['counted']} ({row['drives_found']} of {row['drives']})" + (
            "" if row["median_s"] is None else f", {row['median_s']:.2f} s"
        )

    alarms, faults = [d.alarms for d in detectors], [d.faults for d in detectors]
    rows = [
        [
            "stated: a further drive alarms",
            *(COUNTS_ONLY if d.stated is None else f"at most {d.stated:.3g}" for d in detectors),
        ],
        [f"alarmed {PIECE_S:g} s pieces, no fault", *(f"{a['alarmed']} of {a['pieces']}" for a in alarms)],
        ["alarmed drives, no fault", *(f"{a['alarmed_drives']} of {a['drives']}" for a in alarms)],
        ["alarmed pieces an hour judged", *(pieces_an_hour(a) for a in alarms)],
        ["alarmed recordings, no fault, 95 %", *(share_words(a["recordings"]) for a in alarms)],
        [
            "alarmed recordings an hour judged, 95 %",
            *(hourly_words(a["recordings_per_judged_h"]) for a in alarms),
        ],
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
    return [[*row, name] for row, name in zip(rows, [*before, *best, ""], strict=True)]
