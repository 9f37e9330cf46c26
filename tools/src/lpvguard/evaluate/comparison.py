"""Tables and sentences of an evaluation, for the terminal and the report page.

The tables have one column per detector and one row per fault and way (step, ramp, start). A sentence states
the rate of false alarms at which the detectors are compared. The function `duels` compares the monitor with
each single baseline in each way.
"""

from collections.abc import Mapping
from dataclasses import dataclass

from ..base.rates import hourly_words, share_words
from .detection import WAY_WORDS, median_time, ranking
from .false_alarms import PIECE_S

MONITOR = "monitor"
"""Name of the monitor with all tests at one joint threshold, beside the kinds of baselines.KINDS."""
LEFT_ONE_OUT, HELD_OUT = "left_one_out", "held_out"
"""Judged drives: those of the identification, each without itself, or drives that the identification never
saw."""
CALIBRATED = {LEFT_ONE_OUT: "each drive without itself", HELD_OUT: "drives that it never saw"}
"""Words for the drives that the thresholds judge."""
TOGETHER = "all"
"""Name of the rows that combine the starts of all ways, one row per fault."""
EXPORTED = "exported"
"""All tests at the thresholds that `lpvguard export` writes: joint ones, or each test's own."""
COUNTS_ONLY = "counts only"
"""Words that replace an unstated rate of false alarms."""


def equal_rates(stated: Mapping[str, float | None]) -> str:
    """State the rate of false alarms at which the detectors are compared, or that only counts are compared.

    Parameters
    ----------
    stated : Mapping, rate by detector, or None

    Returns
    -------
    str

    Raises
    ------
    ValueError
        If the rates differ.
    """
    missing = [name for name, rate in stated.items() if rate is None]
    if missing:
        return (
            f"by {COUNTS_ONLY}: too few drives calibrate, so no rate of false alarms is stated for "
            f"{', '.join(missing)}"
        )
    (rate,) = set(stated.values())
    return f"at one guaranteed rate: each one alarms on a further drive with probability at most {rate:g}"


@dataclass(frozen=True)
class DetectorColumn:
    """A column (detector) of the table of detector_rows.

    Attributes
    ----------
    alarms : dict, of FalseAlarms
    faults : list of dict, of fault_rows
    stated : float or None
    """

    alarms: dict
    faults: list[dict]
    stated: float | None


def columns(evaluation: dict) -> dict[str, DetectorColumn]:
    """List the detectors of an evaluation.

    Parameters
    ----------
    evaluation : dict, JSON of `lpvguard evaluate`

    Returns
    -------
    dict[str, DetectorColumn], by name: the monitor, exported and each test, the baselines
    """
    alarms_and_faults = {MONITOR: (evaluation["false_alarms"]["all"], evaluation["faults"])}
    alarms_and_faults |= {name: (t["false_alarms"], t["faults"]) for name, t in evaluation["tests"].items()}
    alarms_and_faults |= {b["kind"]: (b["false_alarms"], b["faults"]) for b in evaluation["baselines"]}
    return {
        name: DetectorColumn(*pair, evaluation["stated_rates"][name])
        for name, pair in alarms_and_faults.items()
    }


def pieces_an_hour(alarms: dict) -> str:
    """Alarmed pieces per hour of judged driving, from a FalseAlarms object; a dash without judged driving."""
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
    """Format the monitor's false alarms, one row per group of drivers.

    Parameters
    ----------
    evaluation : dict, JSON of `lpvguard evaluate`

    Returns
    -------
    list of list of str
    """
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
    """Format false alarms and found faults, one column per detector.

    Parameters
    ----------
    detectors : list[DetectorColumn]
    best : list of str, optional, leader per fault, for a last column

    Returns
    -------
    list of list of str
    """

    def cell(row: dict) -> str:
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
            *(f"{column[0]['untouched_alarms']} of {column[0]['counted']}" for column in faults),
        ],
    ]
    same_rows = list(zip(*faults, strict=True))
    qualify = [any(row["counted"] for row in same) for same in same_rows]
    named = [
        [row_name(same[0]), *map(cell, same)] for same, keep in zip(same_rows, qualify, strict=True) if keep
    ]
    if without := [row_name(same[0]) for same, keep in zip(same_rows, qualify, strict=True) if not keep]:
        named.append([f"no drive qualifies: {'; '.join(without)}", *[""] * len(detectors)])
    rows += named
    ways = list(dict.fromkeys(row["way"] for row in faults[0]))
    for way in ways:
        mine = [[r for r in column if r["way"] == way] for column in faults]
        totals = (
            f"{sum(r['found'] for r in column)} of {sum(r['counted'] for r in column)}" for column in mine
        )
        rows.append([f"{WAY_WORDS[way]}: all faults", *totals])
    if best is None:
        return rows
    before = [""] * (len(rows) - len(ways) - len(named))
    leaders = [name for name, keep in zip(best, qualify, strict=True) if keep]
    after = [""] * (len(named) - len(leaders) + len(ways))
    return [[*row, name] for row, name in zip(rows, [*before, *leaders, *after], strict=True)]


def row_name(row: dict) -> str:
    """Name a row of fault_rows by its way and fault.

    Parameters
    ----------
    row : dict

    Returns
    -------
    str
    """
    return f"{WAY_WORDS[row['way']]}: {row['fault']}"


REFUTABLE_HEAD = "refutable"
"""Heading of the number of starts that were refutable in time."""


def refutable_rows(detectors: list[DetectorColumn]) -> list[list[str]]:
    """Format detection times that are counted from the instant at which a fault becomes refutable.

    A row has the number of starts, and per detector the number found and the median time. A negative time
    means an earlier alarm.

    Parameters
    ----------
    detectors : list[DetectorColumn]

    Returns
    -------
    list of list of str
    """

    def cell(row: dict) -> str:
        return f"{row['refutable_found']}" + (
            "" if row["median_after_s"] is None else f", {row['median_after_s']:.2f} s"
        )

    return [
        [row_name(same[0]), f"{same[0]['refutable']} of {same[0]['counted']}", *map(cell, same)]
        for same in zip(*(d.faults for d in detectors), strict=True)
        if same[0]["counted"]
    ]


def duels(monitor: list[dict], baselines: list[dict]) -> list[dict]:
    """Compare the monitor with each single baseline, for each way and for all ways together.

    ``monitor`` holds rows of fault_rows, ``baselines`` holds objects of the JSON. Keys of the result:

    leads       leader of a row (`ranking`): "monitor", the kind, "tie", or "nobody"
    as_often    rows on which the monitor found as many faults or more
    sooner      rows on which the monitor's median time is less; a missing median counts as the latest
    later       rows on which the monitor's median time is more
    precluded   missed starts at which the untouched drive alarms in the time allowed
    behind      faults on which the monitor found fewer, or found as many but later
    """
    ways = list(dict.fromkeys(m["way"] for m in monitor))
    table = []
    for b in baselines:
        pairs = list(zip(monitor, b["faults"], strict=True))
        table += [_duel(way, b["kind"], [(m, o) for m, o in pairs if m["way"] == way]) for way in ways]
        if len(ways) > 1:
            both = [_together([side[k] for side in pairs]) for k in (0, 1)]
            table.append(_duel(TOGETHER, b["kind"], list(zip(*both, strict=True))))
    return table


def _together(rows: list[dict]) -> list[dict]:
    """Make one row per fault; it combines the starts of all ways in which the fault begins."""
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
    """Compare with one baseline in one way; ``pairs`` holds two rows per fault, the monitor's first."""

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
    """Missed starts of a row of fault_rows at which the untouched drive alarms in the time allowed."""
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
    """Format the comparison of the monitor with each baseline (`duels`), one row per way.

    A row counts the faults on which the monitor found as many or more, was sooner or later, leads or ties. It
    names the faults on which the monitor is behind, and counts precluded starts for both.

    Parameters
    ----------
    evaluation : dict, JSON of `lpvguard evaluate`

    Returns
    -------
    list of list of str
    """
    rows = []
    for duel in evaluation["duels"]:
        total, leads = len(duel["rows"]), [r["leads"] for r in duel["rows"]]
        ties = leads.count("tie")
        rows.append(
            [
                "all ways" if duel["way"] == TOGETHER else WAY_WORDS[duel["way"]],
                duel["kind"],
                *(f"{n} of {duel['counted']}" for n in duel["found"]),
                " and ".join(map(str, duel["precluded"])),
                *(f"{duel[key]} of {total}" for key in ("as_often", "sooner", "later")),
                f"{leads.count(MONITOR)} of {total}" + (f", {ties} tied" if ties else ""),
                "; ".join(duel["behind"]) or "none",
            ]
        )
    return rows


WAYS_HEAD = ("way", "runs")
"""First columns of way_rows; one column per detector follows."""


def way_rows(summary: dict) -> list[list[str]]:
    """Format those faults of a campaign that begin in several ways.

    A row has for each detector the share found at calibrated and at matched thresholds, and the median time.

    Parameters
    ----------
    summary : dict, of a campaign

    Returns
    -------
    list of list of str
    """

    def cell(results: dict, d: str) -> str:
        s = results["median_s"][d]
        shares = f"{results['average'][d]['calibrated']:.1%}, {results['average'][d]['matched']:.1%}"
        return shares + ("" if s is None else f", {s:.2f} s")

    return [
        [WAY_WORDS[way], str(results["runs"]), *(cell(results, d) for d in summary["detectors"])]
        for way, results in summary["ways"].items()
    ]
