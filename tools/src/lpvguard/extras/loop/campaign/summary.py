"""Tables of a campaign from the rows of its runs.

A fault is *visible* in a run when t* is at least VISIBLE_RATIO (one_run.py) times the threshold often enough.
This must hold in VISIBLE_SHARE of the frames that lie wholly in excited driving after its start. A visible
fault must be found within FOUND_WITHIN_S of judged, excited driving.
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
"""Reserve from the end of a frame to its verdict."""
ABOUT_BOUNDS = ("frame", "energy")
"""Tests that are calibrated for a vehicle within the bounds. The change test is calibrated for the identified
vehicle and may alarm for any other truck."""
DETECTORS = (MONITOR, *BASELINE_KINDS)


def summarise(
    table: pa.Table, stored: StoredIdentification, plants: dict, levels: list[dict], tuned: dict
) -> dict[str, Any]:
    """The campaign's tables from its rows; JSON-able.

    ``severities``, ``kinds``, ``average``, ``visible``: faults of the truck in their first way; ``bus``: of
    the bus. ``ways``: faults that begin in several ways. At thresholds ``matched`` at most alpha of the runs
    within the bounds alarm, and of the faulty runs before their fault. With enough runs for alpha
    (``matched_stated``) these are equal false alarms in the loop; ``matched_claim`` says so, or "counts
    only".
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
    """Threshold of equal false alarms per detector, and its rate: alpha, or None with too few runs
    (``summarise``)."""
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
    """A row per kind and severity of a fault of the truck.

    It has mu of the faulted loop and the distance of its response from the nominal one, where computed.
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
    """Calibrated rate of each test for a run, and for an hour of such runs."""
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
    """Alarms due within the run, and those that came in time."""
    due = [
        r for r in rows if r["due_s"] is not None and r["fault_s"] + r["due_s"] + LATENCY_S <= r["duration_s"]
    ]
    came = [
        r["ecu_invalid_s"] is not None and r["ecu_invalid_s"] <= r["fault_s"] + r["due_s"] + LATENCY_S
        for r in due
    ]
    return rate(sum(came), len(due))


def by_way(rows: list[dict], matched: dict[str, float]) -> dict[str, dict[str, Any]]:
    """Results per way of the ``rows`` of faults that begin in several ways.

    They hold the runs, and per detector the share found, averaged over kinds and severities, and the median
    time [s] over all runs. A time is judged, excited driving since the fault's start.
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
    """Visible faults that each detector found in time, of those without an earlier alarm."""
    visible = [r for r in faulty if _is_visible(r)]
    counted = {d: [r for r in visible if not r[f"{d}_before"]] for d in DETECTORS}
    return {d: rate(sum(_found(r, d) for r in rows), len(rows)) for d, rows in counted.items()}


def _average(severities: list[dict]) -> dict[str, dict[str, float]]:
    """Share of runs with the fault found, per detector, averaged over the severities."""
    return {
        d: {
            "calibrated": float(np.mean([s["found"][d] / s["runs"] for s in severities])),
            "matched": float(np.mean([s["matched"][d] / s["runs"] for s in severities])),
        }
        for d in DETECTORS
    }


def _is_invisible(severity: dict[str, Any]) -> bool:
    """Return whether a fault is visible in less than half of its runs although the loop loses stability or
    performance."""
    harmful = not severity["loop_stable"] or (severity["mu_upper"] is not None and severity["mu_upper"] >= 1)
    return severity["visible_runs"] < severity["runs"] / 2 and harmful


def _by_severity(rows: list[dict]) -> dict[tuple[str, float], list[dict]]:
    groups: dict[tuple[str, float], list[dict]] = {}
    for r in rows:
        groups.setdefault((r["kind"], r["severity"]), []).append(r)
    return groups


def _missed(summary: dict[str, Any]) -> Iterator[str]:
    """Claims that the campaign contradicts, a sentence each."""
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
    """Conformal calibration on healthy stretches; those without a statistic give no score."""
    return calibrate({str(i): s for i, s in enumerate(scores) if np.isfinite(s)}, alpha, floor=0.0)


def _is_visible(row: dict) -> bool:
    return row["visible_share"] >= VISIBLE_SHARE and row["excited_after_s"] > 0


def _found(row: dict, detector: str) -> bool:
    s = row[f"{detector}_found_s"]
    return not row[f"{detector}_before"] and s is not None and s <= FOUND_WITHIN_S


def _alarms(row: dict, detector: str) -> bool:
    return row[f"{detector}_before"] or row[f"{detector}_found_s"] is not None


def _falsified(within: list[dict], tables: list[str]) -> dict[str, Any]:
    """Names and rate of the runs of trucks within the bounds that contradict the certificate (conduct.py).

    ``tables`` are of these trucks.
    """
    runs = [
        {key: r[key] for key in ("number", "seed", "plant", "speed_mps")}
        | {"tables": tables[r["plant"]], "did": did}
        for r, did in ((r, list(ruled_out(r))) for r in within)
        if did
    ]
    return {"rate": rate(len(runs), len(within)), "runs": runs}


def _within(rows: list[dict]) -> dict[str, Any]:
    """Alarm rates of trucks within the bounds per run of DURATION_S (the exchangeable unit), by detector
    and test."""
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
    """Runs with all required states, and reactions due and met.

    Faults of the truck alone are left out: a truck that leaves the controller's range of speeds is refused,
    which the ECU reports as "off" though its bus is live.
    """
    return {
        "as_required": rate(sum(map(_as_required, rows)), len(rows)),
        "due": sum(r["supervision_due"] for r in rows),
        "met": sum(r["supervision_met"] for r in rows),
    }


def _as_required(row: dict) -> bool:
    """Return whether the supervision reported the required state at every tick, and none worse."""
    return (
        row["supervision_met"] == row["supervision_due"]
        and row["supervision_late_s"] == 0.0 == row["supervision_unwarranted_s"]
    )


def _bus_severity(kind: str, x: float, rows: list[dict]) -> dict[str, Any]:
    """Reactions of the supervision to a fault of the bus.

    ``away`` is the share of time since its begin with no live bus. ``judged`` is the share with judged,
    excited driving: after every gap the model has to settle first. ``alarmed`` counts runs with an alarm
    since, which need not be wrong: see ``visible_runs``.
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
    """Average of a kind over its severities, and the best detectors at calibrated and at matched thresholds.

    All that tie are best; none where none found a fault.
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
