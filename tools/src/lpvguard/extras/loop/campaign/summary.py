"""Make the tables of a campaign from the rows of its runs.

A fault is *visible* in a run if t* is often at least VISIBLE_RATIO (one_run.py) times the threshold. "Often"
means in the share VISIBLE_SHARE of the frames that lie wholly in excited driving after the fault's start. A
visible fault must be found within FOUND_WITHIN_S of judged, excited driving.
"""

from collections.abc import Iterator
from typing import Any

import numpy as np
import pyarrow as pa

from ....base.rates import per_hour, rate
from ....core.compiled import TESTS
from ....evaluate.baselines import KINDS as BASELINE_KINDS
from ....evaluate.baselines import TITLES
from ....evaluate.comparison import COUNTS_ONLY, MONITOR
from ....evaluate.detection import median_time
from ....evaluate.judged_drives import calibrations_of
from ....identify.calibration import Calibration, calibrate
from ....identify.identification import StoredIdentification
from . import faults
from .conduct import beyond_wish, ruled_out
from .one_run import FOUND_WITHIN_S
from .scenarios import DURATION_S

VISIBLE_SHARE, VISIBLE_FOUND = 0.1, 0.95
LATENCY_S = 1.0
"""Reserve for the time from the end of a frame to its verdict."""
ABOUT_BOUNDS = ("frame", "energy")
"""Tests that are calibrated for a vehicle within the bounds. The change test is calibrated for the identified
vehicle and may alarm for any other truck."""
DETECTORS = (MONITOR, *BASELINE_KINDS)


def summarise(
    table: pa.Table, stored: StoredIdentification, plants: dict, levels: list[dict], tuned: dict
) -> dict[str, Any]:
    """Make the campaign's tables from its rows, as JSON values.

    ``severities``, ``kinds``, ``average`` and ``visible`` concern faults of the truck with their first way.
    ``bus`` concerns faults of the bus. ``ways`` concerns faults that begin in several ways. ``matched`` holds
    thresholds for equal false alarms. At these thresholds, at most a share alpha of the runs within the
    bounds has an alarm. The same holds for the faulty runs before their fault. With enough runs for alpha
    (``matched_stated``), all detectors then have equal false alarms in the loop. ``matched_claim`` says so,
    or says "counts only".
    """
    rows = table.to_pylist()
    kinds = {k.name: k for k in faults.KINDS}
    within = [r for r in rows if r["kind"] == "within"]
    of_truck = [r for r in rows if r["kind"] in kinds and kinds[r["kind"]].of_truck]
    faulty = [r for r in of_truck if r["way"] == kinds[r["kind"]].ways[0]]
    on_bus = [r for r in rows if r["kind"] in kinds and kinds[r["kind"]].of_bus]
    matched, stated = _matched(within, faulty, stored.project.frame_test.alpha)
    severities = _severities(faulty, matched, levels, plants)
    summary = {
        "detectors": {MONITOR: "lpvguard", **TITLES},
        "units": {name: k.unit for name, k in kinds.items()},
        "baselines": [{k: b[k] for k in ("label", "parameters", "threshold")} for b in tuned["chosen"]],
        "alpha": tuned["alpha"],
        "calibrated": _calibrated(stored),
        "within": _within(within)
        | {
            "plants": len({r["plant"] for r in within}),
            "candidates": len(plants["candidates"]),
            "nominal_ratio": plants["nominal"]["ratio"],
            "largest_ratio": max(c["ratio"] for c in plants["candidates"] if c["ratio"] <= 1),
            "checked": plants["checked"],
        },
        "falsified": _falsified(within, [c["tables"] for c in plants["candidates"] if c["ratio"] <= 1]),
        "severities": severities,
        "due": _due(rows),
        "visible": _visible(faulty),
        "average": _average(severities),
        "ways": by_way([r for r in of_truck if len(kinds[r["kind"]].ways) > 1], matched),
        "matched_thresholds": matched,
        "matched_stated": stated,
        "matched_claim": f"{COUNTS_ONLY}: too few runs for equal false alarms"
        if None in stated.values()
        else "equal false alarms in the loop",
        "kinds": [
            kind_row(name, [s for s in severities if s["kind"] == name])
            for name in dict.fromkeys(s["kind"] for s in severities)
        ],
        "command_authentication": "authenticated"
        if all(r["authenticated"] for r in rows)
        else "not authenticated",
        "supervision": {"faulty": _supervision(on_bus), "healthy": _supervision(within)},
        "bus": [_bus_severity(*key, members) for key, members in _by_severity(on_bus).items()],
        "invisible": [s for s in severities if _is_invisible(s)],
    }
    summary["beaten"] = [
        {"kind": k["kind"], "detector": d, "matched": k["matched"][d], "monitor": k["matched"][MONITOR]}
        for k in summary["kinds"]
        for d in BASELINE_KINDS
        if k["matched"][d] > k["matched"][MONITOR]
    ]
    return summary | {"missed": list(_missed(summary))}


def _matched(
    within: list[dict], faulty: list[dict], alpha: float
) -> tuple[dict[str, float], dict[str, float | None]]:
    """Threshold for equal false alarms by detector, and its rate: alpha, or None for too few runs."""
    before = [r for r in faulty if r["fault_s"] > 0]
    calibrations = {
        d: (
            _calibration([r[f"{d}_score"] for r in within], alpha),
            _calibration([r[f"{d}_score_before"] for r in before], alpha),
        )
        for d in DETECTORS
    }
    thresholds = {d: max(c.threshold for c in both) for d, both in calibrations.items()}
    return thresholds, {
        d: alpha if all(c.alpha is not None for c in both) else None for d, both in calibrations.items()
    }


def _severities(
    faulty: list[dict], matched: dict[str, float], levels: list[dict], plants: dict
) -> list[dict[str, Any]]:
    """Make a row for each kind and severity of a fault of the truck.

    A row also has mu of the loop with the fault, and the distance of the truck's response from the nominal
    response, if they were computed.
    """
    loops = {(row["kind"], row["severity"]): row for row in levels}
    response = {(row["kind"], row["severity"]): row["ratio"] for row in plants["faulted"]}
    severities = []
    for key, members in _by_severity(faulty).items():
        loop = loops.get(key, {"stable": True, "mu_upper": None})
        severities.append(
            _severity(*key, members, matched)
            | {
                "loop_stable": loop["stable"],
                "mu_upper": loop["mu_upper"],
                "response_ratio": response.get(key),
            }
        )
    return severities


def _calibrated(stored: StoredIdentification) -> dict[str, dict[str, Any]]:
    """Calibrated rate of each test per run, and per hour of such runs."""
    return {
        test: {
            "claim": c.claim(),
            "alpha": c.alpha,
            "conditional_bound": c.conditional_bound,
            "threshold": c.carried,
            "per_hour": c.alpha and c.alpha * 3600 / DURATION_S,
        }
        for test, c in calibrations_of(stored).items()
    }


def _due(rows: list[dict]) -> dict[str, Any]:
    """Number of alarms that were due within the run, and number that came in time."""
    due = [
        r for r in rows if r["due_s"] is not None and r["fault_s"] + r["due_s"] + LATENCY_S <= r["duration_s"]
    ]
    came = [
        r["ecu_invalid_s"] is not None and r["ecu_invalid_s"] <= r["fault_s"] + r["due_s"] + LATENCY_S
        for r in due
    ]
    return rate(sum(came), len(due))


def by_way(rows: list[dict], matched: dict[str, float]) -> dict[str, dict[str, Any]]:
    """Results by way, from the rows of faults that begin in several ways.

    Each way has the number of runs. Each detector has the share of found faults, averaged over kinds and
    severities, and the median time [s] over all runs. A time is judged, excited driving since the fault's
    start.
    """
    results = {}
    for way in dict.fromkeys(r["way"] for r in rows):
        mine = [r for r in rows if r["way"] == way]
        severities = [_severity(*key, members, matched) for key, members in _by_severity(mine).items()]
        results[way] = {
            "runs": len(mine),
            "average": _average(severities),
            "median_s": {
                d: median_time([None if r[f"{d}_before"] else r[f"{d}_found_s"] for r in mine])
                for d in DETECTORS
            },
        }
    return results


def _visible(faulty: list[dict]) -> dict[str, dict[str, Any]]:
    """Count the visible faults that each detector found in time, among the runs without an earlier alarm."""
    visible = [r for r in faulty if _is_visible(r)]
    counted = {d: [r for r in visible if not r[f"{d}_before"]] for d in DETECTORS}
    return {d: rate(sum(_found(r, d) for r in rows), len(rows)) for d, rows in counted.items()}


def _average(severities: list[dict]) -> dict[str, dict[str, float]]:
    """Share of runs with a found fault by detector, averaged over the severities."""
    return {
        d: {
            "calibrated": float(np.mean([s["found"][d] / s["runs"] for s in severities])),
            "matched": float(np.mean([s["matched"][d] / s["runs"] for s in severities])),
        }
        for d in DETECTORS
    }


def _is_invisible(severity: dict[str, Any]) -> bool:
    """Tell if a fault that costs stability or performance is visible in less than half of its runs."""
    harmful = not severity["loop_stable"] or (severity["mu_upper"] is not None and severity["mu_upper"] >= 1)
    return severity["visible_runs"] < severity["runs"] / 2 and harmful


def _by_severity(rows: list[dict]) -> dict[tuple[str, float], list[dict]]:
    groups: dict[tuple[str, float], list[dict]] = {}
    for r in rows:
        groups.setdefault((r["kind"], r["severity"]), []).append(r)
    return groups


def _missed(summary: dict[str, Any]) -> Iterator[str]:
    """List the claims that the campaign contradicts, one sentence each."""
    falsified = summary["falsified"]["rate"]
    if falsified["count"]:
        yield (
            f"{falsified['count']} of {falsified['of']} runs of trucks within the bounds falsify "
            "the certificate"
        )
    for test in ABOUT_BOUNDS:
        seen, calibrated = summary["within"]["tests"][test], summary["calibrated"][test]["alpha"]
        if calibrated is not None and seen["interval"] is not None and seen["interval"][1] > calibrated:
            yield (
                f"{test} test: {seen['count']} of {seen['of']} runs within the bounds alarm, "
                f"up to {seen['interval'][1]:.2%} with 95 %, calibrated {calibrated:.2%}"
            )
    for bus, rates in ((bus, s["as_required"]) for bus, s in summary["supervision"].items()):
        if rates["count"] < rates["of"]:
            yield (
                f"{bus} bus: in {rates['of'] - rates['count']} of {rates['of']} runs the supervision did not "
                "report the required states"
            )
    due = summary["due"]
    if due["count"] < due["of"]:
        yield f"{due['of'] - due['count']} of {due['of']} alarms that were due did not come by then"
    visible = summary["visible"][MONITOR]
    if visible["of"] and visible["count"] < VISIBLE_FOUND * visible["of"]:
        yield (
            f"{visible['count']} of {visible['of']} visible faults found within {FOUND_WITHIN_S:g} s, "
            f"wanted {VISIBLE_FOUND:.0%}"
        )
    average = {d: a["matched"] for d, a in summary["average"].items()}
    for d in BASELINE_KINDS:
        if average[d] >= average[MONITOR]:
            yield (
                f"{TITLES[d]} finds {average[d]:.1%} on average ({summary['matched_claim']}), "
                f"the monitor {average[MONITOR]:.1%}"
            )


def _calibration(scores: list[float], alpha: float) -> Calibration:
    """Conformal calibration on healthy runs; a run without a statistic gives no score."""
    return calibrate({str(i): s for i, s in enumerate(scores) if np.isfinite(s)}, alpha, floor=0.0)


def _is_visible(row: dict) -> bool:
    return row["visible_share"] >= VISIBLE_SHARE and row["excited_after_s"] > 0


def _found(row: dict, detector: str) -> bool:
    s = row[f"{detector}_found_s"]
    return not row[f"{detector}_before"] and s is not None and s <= FOUND_WITHIN_S


def _alarms(row: dict, detector: str) -> bool:
    return row[f"{detector}_before"] or row[f"{detector}_found_s"] is not None


def _falsified(within: list[dict], tables: list[str]) -> dict[str, Any]:
    """Names and rate of the runs within the bounds that contradict the certificate (conduct.py).

    ``tables`` are the scenario tables of these trucks.
    """
    runs = [
        {key: r[key] for key in ("number", "seed", "plant", "speed_mps")}
        | {"tables": tables[r["plant"]], "did": did}
        for r, did in ((r, list(ruled_out(r))) for r in within)
        if did
    ]
    return {"rate": rate(len(runs), len(within)), "runs": runs}


def _within(rows: list[dict]) -> dict[str, Any]:
    """Alarm rates of trucks within the bounds, per run of DURATION_S, by detector and test."""
    hours, judged = (sum(r[key] for r in rows) / 3600 for key in ("duration_s", "judged_s"))
    alarmed = {d: sum(_alarms(r, d) for r in rows) for d in DETECTORS}
    trucks: dict[int, bool] = {}
    for r in rows:
        trucks[r["plant"]] = trucks.get(r["plant"], False) or _alarms(r, MONITOR)
    return {
        "runs": len(rows),
        "hours": hours,
        "judged_hours": judged,
        "alarmed": {d: rate(n, len(rows)) for d, n in alarmed.items()},
        "beyond_wish": rate(sum(map(beyond_wish, rows)), len(rows)),
        "alarmed_trucks": rate(sum(trucks.values()), len(trucks)),
        "tests": {
            t: rate(n, len(rows))
            | {
                "per_hour": per_hour(n, hours),
                "per_judged_hour": per_hour(n, judged),
                "alarms": sum(r[f"alarms_{t}"] for r in rows),
            }
            for t, n in ((t, sum(r[f"alarmed_{t}"] for r in rows)) for t in TESTS)
        },
    }


def _severity(kind: str, x: float, rows: list[dict], matched: dict[str, float]) -> dict[str, Any]:
    def at_matched(r: dict, d: str) -> bool:
        return not r[f"{d}_score_before"] > matched[d] and r[f"{d}_score_within"] > matched[d]

    return {
        "kind": kind,
        "severity": x,
        "runs": len(rows),
        "visible_runs": sum(map(_is_visible, rows)),
        "visible_share": float(np.median([r["visible_share"] for r in rows])),
        "found": {d: sum(_found(r, d) for r in rows) for d in DETECTORS},
        "matched": {d: sum(at_matched(r, d) for r in rows) for d in DETECTORS},
        "median_s": {
            d: median_time([r[f"{d}_found_s"] for r in rows if not r[f"{d}_before"]]) for d in DETECTORS
        },
    }


def _supervision(rows: list[dict]) -> dict[str, Any]:
    """Count the runs with all required states, the required reactions and the correct reactions.

    Faults of only the truck are left out. If such a truck leaves the controller's speed range, the ECU
    reports "off" although its bus is live.
    """
    return {
        "as_required": rate(sum(map(_as_required, rows)), len(rows)),
        "due": sum(r["supervision_due"] for r in rows),
        "met": sum(r["supervision_met"] for r in rows),
    }


def _as_required(row: dict) -> bool:
    """Tell if the supervision reported the required state at every tick, and no worse state."""
    return (
        row["supervision_met"] == row["supervision_due"]
        and row["supervision_late_s"] == 0.0 == row["supervision_unwarranted_s"]
    )


def _bus_severity(kind: str, x: float, rows: list[dict]) -> dict[str, Any]:
    """Reactions of the supervision to a fault of the bus.

    ``away`` is the share of time since the fault's begin without a live bus. ``judged`` is the share of time
    with judged, excited driving, because the model must settle after every gap. ``alarmed`` counts runs with
    an alarm since the begin. Such an alarm can be right: see ``visible_runs``.
    """
    return {
        "kind": kind,
        "severity": x,
        "runs": len(rows),
        "as_required": sum(map(_as_required, rows)),
        "due": sum(r["supervision_due"] for r in rows),
        "met": sum(r["supervision_met"] for r in rows),
        "late_s": max(r["supervision_late_s"] for r in rows),
        "unwarranted_s": sum(r["supervision_unwarranted_s"] for r in rows),
        "away": float(np.mean([r["supervision_away_s"] / (r["duration_s"] - r["fault_s"]) for r in rows])),
        "judged": float(np.mean([r["excited_after_s"] / (r["duration_s"] - r["fault_s"]) for r in rows])),
        "alarmed": {d: sum(r[f"{d}_found_s"] is not None for r in rows) for d in DETECTORS},
        "visible_runs": sum(map(_is_visible, rows)),
    }


def kind_row(name: str, rows: list[dict]) -> dict[str, Any]:
    """Average a kind over its severities; list the best detectors at calibrated and at matched thresholds.

    All detectors with an equal best result are listed. The list is empty if no detector found a fault.
    """
    shares = {d: float(np.mean([s["found"][d] / s["runs"] for s in rows])) for d in DETECTORS}
    matched = {d: float(np.mean([s["matched"][d] / s["runs"] for s in rows])) for d in DETECTORS}

    def best(by_detector: dict[str, float]) -> list[str]:
        return [d for d, share in by_detector.items() if 0 < share == max(by_detector.values())]

    return {
        "kind": name,
        "found": shares,
        "matched": matched,
        "best": best(shares),
        "best_matched": best(matched),
    }
