"""Summarise an evaluation in at most ten lines: alarms per hour, found and missed faults, best baseline."""

from typing import Any

from .comparison import EXPORTED, MONITOR, TOGETHER, row_name

ALWAYS, NEVER = 0.95, 0.05
"""A fault counts as found from the first share of its starts on, and as missed up to the second."""
NAMED = 6
"""Largest number of faults that one line names."""


def summary(evaluation: dict[str, Any]) -> list[str]:
    """Summarise what an evaluation found.

    Parameters
    ----------
    evaluation : dict, JSON of `lpvguard evaluate`

    Returns
    -------
    list of str, at most ten sentences, alarms without a fault first
    """
    rows = evaluation["faults"]
    counted = [row for row in rows if row["counted"]]
    groups: dict[str, list[str]] = {"found": [], "partly found": [], "missed": []}
    for row in counted:
        share = row["found"] / row["counted"]
        kind = "found" if share >= ALWAYS else "missed" if share <= NEVER else "partly found"
        after = "" if row["median_s"] is None else f", after {row['median_s']:.3g} s"
        groups[kind].append(f"{row_name(row)} ({row['found']} of {row['counted']}{after})")
    starts, detected = (sum(row[key] for row in counted) for key in ("counted", "found"))
    lines = [
        alarm_words(evaluation),
        f"faults: {detected} of {starts} starts found within {evaluation['injection']['within_s']:g} s of "
        f"judged, excited driving; of {len(counted)} faults "
        + ", ".join(f"{len(names)} {kind}" for kind, names in groups.items()),
        *_exported(evaluation, detected),
        *(f"{kind}: {_first(names)}" for kind, names in groups.items() if names),
    ]
    if without := [row_name(row) for row in rows if not row["counted"]]:
        lines.append(f"no drive qualifies for: {_first(without)}")
    if evaluation["without_faults"]:
        lines.append(f"drives without injected faults: {len(evaluation['without_faults'])} (too short)")
    lines.append(_baseline(evaluation))
    return lines


def _first(names: list[str]) -> str:
    more = f"; and {len(names) - NAMED} more" if len(names) > NAMED else ""
    return "; ".join(names[:NAMED]) + more


def alarm_words(evaluation: dict[str, Any]) -> str:
    """Say how many alarms an hour without a fault are promised, and how many were measured.

    Parameters
    ----------
    evaluation : dict, JSON of `lpvguard evaluate`

    Returns
    -------
    str
    """
    counts = evaluation["false_alarms"]["all"]
    stated, hours = evaluation["stated_rates"][MONITOR], counts["judged_h"]
    promised = "no rate is promised, because too few drives calibrate"
    if stated is not None and hours:
        promised = f"promised at most {stated * counts['recordings']['of'] / hours:.3g} per judged hour"
    if target := evaluation.get("rate"):
        promised = f"promised {target['per_1000_h']:g} per 1000 judged hours"
        if target["extrapolated_from_h"] is not None:
            promised += f", extrapolated from {target['extrapolated_from_h']:.3g} hours"
    rate = counts["recordings_per_judged_h"]
    measured = "no rate is measured, because nothing is judged"
    if hours:
        low, high = rate["interval"]
        measured = f"{rate['rate']:.3g} measured (95 %: {low:.2g} to {high:.3g})"
    drives = f"{counts['alarmed_drives']} of {counts['drives']} drives alarm in {hours:.3g} h"
    return f"alarms without a fault: {promised}, {measured}; {drives}"


def _exported(evaluation: dict[str, Any], detected: int) -> list[str]:
    """Say what the exported thresholds find, where these are not the joint one."""
    tests = evaluation["tests"][EXPORTED]
    starts, counts = sum(row["found"] for row in tests["faults"]), tests["false_alarms"]
    if (starts, counts["alarmed_drives"]) == (detected, evaluation["false_alarms"]["all"]["alarmed_drives"]):
        return []
    return [
        f"with a threshold for each test, as exported: {starts} starts found, {counts['alarmed_drives']} of "
        f"{counts['drives']} drives alarm; frame_test.joint = true exports one for all tests"
    ]


def _baseline(evaluation: dict[str, Any]) -> str:
    """The monitor compared with the baseline that finds most."""
    duels = evaluation["duels"]
    whole = [d for d in duels if d["way"] == TOGETHER] or duels
    if not whole:
        return "no baseline: too few drives calibrate one"
    best = max(whole, key=lambda d: d["found"][1])
    ours, theirs = best["found"]
    behind = f"; behind on {_first(best['behind'])}" if best["behind"] else "; behind on none"
    return f"best baseline: {best['kind']} finds {theirs} of {best['counted']} starts, we {ours}{behind}"
