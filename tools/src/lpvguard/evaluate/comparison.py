"""What terminal and page show of an evaluation.

The tables have a column per detector and a row per fault and way. The words say at which rate of false alarms
the detectors are compared. Beside each baseline alone stands the monitor, way by way (`duels`).
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

from ..base.rates import hourly_words, share_words
from .detection import WAY_WORDS, median_time, ranking
from .false_alarms import PIECE_S

MONITOR = "monitor"
"""Name of our own detector beside the kinds of baselines.KINDS: all tests together, at one threshold."""
LEFT_ONE_OUT, HELD_OUT = "left_one_out", "held_out"
"""Which drives are judged: those of the identification, each without itself, or drives that it never saw."""
CALIBRATED = {LEFT_ONE_OUT: "each drive without itself", HELD_OUT: "drives that it never saw"}
"""What the thresholds judge, in words."""
TOGETHER = "all"
"""In the place of a way: the starts of all ways, one row a fault."""
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
    named = [[row_name(same[0]), *map(found, same)] for same in zip(*faults, strict=True)]
    rows += named
    ways = list(dict.fromkeys(row["way"] for row in faults[0]))
    for way in ways:
        mine = [[r for r in of if r["way"] == way] for of in faults]
        totals = (f"{sum(r['found'] for r in of)} of {sum(r['counted'] for r in of)}" for of in mine)
        rows.append([f"{WAY_WORDS[way]}: all faults", *totals])
    if best is None:
        return rows
    before = [""] * (len(rows) - len(ways) - len(named))
    return [[*row, name] for row, name in zip(rows, [*before, *best, *[""] * len(ways)], strict=True)]


def row_name(row: dict) -> str:
    """The way and the fault of a row of fault_rows, in words."""
    return f"{WAY_WORDS[row['way']]}: {row['fault']}"


REFUTABLE_HEAD = "refutable"
"""Heading of the column that says how many starts were refutable in time."""


def refutable_rows(detectors: list[DetectorColumn]) -> list[list[str]]:
    """Table rows of the faults from when they are refutable on: of how many starts. Per detector how many of
    these were found, and the median time from then on; negative where an alarm is sooner."""

    def found(row: dict) -> str:
        return f"{row['refutable_found']}" + (
            "" if row["median_after_s"] is None else f", {row['median_after_s']:.2f} s"
        )

    return [
        [row_name(same[0]), f"{same[0]['refutable']} of {same[0]['counted']}", *map(found, same)]
        for same in zip(*(d.faults for d in detectors), strict=True)
    ]


def duels(monitor: list[dict], baselines: list[dict]) -> list[dict]:
    """The monitor beside each baseline alone, way by way. Where there are several, all ways together come
    last. Said is who leads on a row (`ranking`), and how often over the rows of a way.

    ``monitor``: rows of fault_rows; ``baselines``: objects of the JSON. ``leads``: "monitor", the kind,
    "tie", or "nobody", where neither found one. ``as_often``: rows on which the monitor found as many or
    more. ``sooner``, ``later``: rows on which its median is less, more; no median counts as later than any.
    ``precluded``: starts at which monitor and baseline missed a fault since the untouched drive makes them
    alarm in the time allowed. Such a miss says where a false alarm fell, not what a detector can see.
    ``behind``: faults on which it found fewer, or found as many and later.
    """
    ways = list(dict.fromkeys(m["way"] for m in monitor))
    found = []
    for b in baselines:
        pairs = list(zip(monitor, b["faults"], strict=True))
        found += [_duel(way, b["kind"], [(m, o) for m, o in pairs if m["way"] == way]) for way in ways]
        if len(ways) > 1:
            both = [_together([side[k] for side in pairs]) for k in (0, 1)]
            found.append(_duel(TOGETHER, b["kind"], list(zip(*both, strict=True))))
    return found


def _together(rows: list[dict]) -> list[dict]:
    """One row a fault, of the starts of all its ways."""
    faults: dict[str, list[dict]] = {}
    for row in rows:
        faults.setdefault(row["fault"], []).append(row)
    return [
        {
            "fault": fault,
            "found": sum(row["found"] for row in same),
            "counted": sum(row["counted"] for row in same),
            "median_s": median_time([case["s"] for row in same for case in row["cases"]]),
            "cases": [case for row in same for case in row["cases"]],
        }
        for fault, same in faults.items()
    ]


def _duel(way: str, kind: str, pairs: list[tuple[dict, dict]]) -> dict:
    """One baseline in one way; ``pairs``: the monitor's row and its, fault by fault."""

    def leads(monitor: dict, other: dict) -> str:
        first = ranking({MONITOR: monitor, kind: other})
        return "tie" if len(first) > 1 else first[0] if first else "nobody"

    def median(row: dict) -> float:
        return float("inf") if row["median_s"] is None else row["median_s"]

    rows = [
        {
            "fault": m["fault"],
            "counted": m["counted"],
            "found": [m["found"], o["found"]],
            "median_s": [m["median_s"], o["median_s"]],
            "leads": leads(m, o),
        }
        for m, o in pairs
    ]
    return {
        "way": way,
        "kind": kind,
        "found": [sum(r["found"][i] for r in rows) for i in (0, 1)],
        "precluded": [sum(map(_precluded, side)) for side in zip(*pairs, strict=True)],
        "counted": sum(r["counted"] for r in rows),
        "as_often": sum(m["found"] >= o["found"] for m, o in pairs),
        "sooner": sum(median(m) < median(o) for m, o in pairs),
        "later": sum(median(m) > median(o) for m, o in pairs),
        "behind": [r["fault"] for r in rows if r["leads"] == kind],
        "rows": rows,
    }


def _precluded(row: dict) -> int:
    """Starts of a row of fault_rows that were missed and whose untouched drive alarms in the time allowed."""
    return sum(c["s"] is None and c["untouched_s"] is not None for c in row["cases"])


DUEL_HEAD = (
    "way",
    "against",
    "found",
    "it found",
    "missed for an alarm of its own, both",
    "as many or more",
    "sooner",
    "later",
    "leads",
    "behind on",
)
"""Columns of duel_rows."""


def duel_rows(evaluation: dict) -> list[list[str]]:
    """The monitor beside each baseline alone, a row a way. Counted are rows of faults: where it found as many
    or more, where its median is less or more, where it leads, where it ties. Named is where it is behind.
    Starts missed since the untouched drive alarms are counted for both (`duels`)."""
    rows = []
    for duel in evaluation["duels"]:
        of, leads = len(duel["rows"]), [r["leads"] for r in duel["rows"]]
        ties = leads.count("tie")
        rows.append(
            [
                "all ways" if duel["way"] == TOGETHER else WAY_WORDS[duel["way"]],
                duel["kind"],
                *(f"{n} of {duel['counted']}" for n in duel["found"]),
                " and ".join(map(str, duel["precluded"])),
                *(f"{duel[key]} of {of}" for key in ("as_often", "sooner", "later")),
                f"{leads.count(MONITOR)} of {of}" + (f", {ties} tied" if ties else ""),
                "; ".join(duel["behind"]) or "none",
            ]
        )
    return rows


WAYS_HEAD = ("way", "runs")
"""First columns of way_rows; a column per detector follows."""


def way_rows(summary: dict) -> list[list[str]]:
    """Of a campaign's summary, table rows of the faults that come in several ways. Per detector the average
    found at calibrated and at matched thresholds, and the median time."""

    def found(of: dict, d: str) -> str:
        s = of["median_s"][d]
        shares = f"{of['average'][d]['calibrated']:.1%}, {of['average'][d]['matched']:.1%}"
        return shares + ("" if s is None else f", {s:.2f} s")

    return [
        [WAY_WORDS[way], str(of["runs"]), *(found(of, d) for d in summary["detectors"])]
        for way, of in summary["ways"].items()
    ]
