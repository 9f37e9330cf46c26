"""Tables of `lpvguard campaign` for people, on standard error."""

from __future__ import annotations

from typing import Any

from rich.table import Table

from ..base.rates import hourly_words, share_words
from .shared import console
from .tables import print_rows, table_of


def print_campaign(summary: dict[str, Any]) -> None:
    """The summary of a campaign: falsified certificates, false alarms, detection beside the baselines,
    supervision of the bus, and the claims that it contradicts."""
    _print_falsified(summary)
    _print_within(summary)
    _print_detection(summary)
    _print_invisible(summary)
    _print_bus(summary)
    console.print(f"GUARD_IN {summary['command_authentication']}")
    for text in summary["missed"]:
        console.print(f"missed: {text}")


def _print_falsified(summary: dict[str, Any]) -> None:
    """Every run of a truck within the bounds that did what the certificate rules out."""
    falsified = summary["falsified"]
    console.print(f"runs within the bounds that falsify the certificate: {share_words(falsified['rate'])}")
    for run in falsified["runs"]:
        console.print(
            f"FALSIFIED CERTIFICATE: run {run['number']}, seed {run['seed']}, truck {run['plant']}, "
            f"{run['speed_mps']:.2f} m/s: {'; '.join(run['did'])}"
        )
    wish = share_words(summary["within"]["beyond_wish"])
    console.print(f"runs within the bounds with an error above the requested tenth of the motion: {wish}")


def _print_within(summary: dict[str, Any]) -> None:
    """False alarms of trucks within the bounds, beside the rates that were calibrated."""
    within = summary["within"]
    console.print(
        f"{within['hours']:.1f} h of {within['plants']} trucks within the bounds by their own frequency "
        f"response (of {within['candidates']} drawn)"
    )
    head = ("test", "runs that alarm, 95 %", "calibrated", "such runs an hour, 95 %", "calibrated")
    rows = []
    for test, seen in within["tests"].items():
        calibrated = summary["calibrated"][test]
        stated = (
            ("not stated", "")
            if calibrated["alpha"] is None
            else (f"{calibrated['alpha']:.2%}", f"{calibrated['per_hour']:.2f}")
        )
        hourly = [hourly_words(seen[key]) for key in ("per_hour", "per_judged_hour")]
        rows.append((test, share_words(seen), stated[0], hourly[0], stated[1], hourly[1]))
    console.print(table_of((*head, "such runs an hour judged, 95 %"), rows))


def _print_detection(summary: dict[str, Any]) -> None:
    """The detectors beside one another: over all faults, by kind, and where a baseline wins."""
    from ..evaluate.comparison import COUNTS_ONLY, WAYS_HEAD, way_rows

    detectors, matched, stated = summary["detectors"], summary["matched_claim"], summary["matched_stated"]
    table = Table("", *detectors.values(), box=None)
    for title, rates in (
        ("runs within the bounds that alarm", summary["within"]["alarmed"]),
        ("visible faults found in time", summary["visible"]),
    ):
        table.add_row(title, *(share_words(rates[d]) for d in detectors))
    for title, key in (("average found", "calibrated"), (f"average found, {matched}", "matched")):
        table.add_row(title, *(f"{summary['average'][d][key]:.1%}" for d in detectors))
    table.add_row(
        "at the latter thresholds a further run alarms",
        *(COUNTS_ONLY if stated[d] is None else f"at most {stated[d]:.3g}" for d in detectors),
    )
    console.print(table)
    console.print(f"faults that come in several ways: average found calibrated; {matched}; median time:")
    console.print(table_of((*WAYS_HEAD, *detectors.values()), way_rows(summary)))
    title = f"average over severities: calibrated; {matched}"
    kinds = (
        (
            k["kind"],
            *(f"{k['found'][d]:.0%}, {k['matched'][d]:.0%}" for d in detectors),
            ", ".join(detectors[d] for d in k["best_matched"]),
        )
        for k in summary["kinds"]
    )
    console.print(table_of((title, *detectors.values(), f"best, {matched}"), kinds))
    for b in summary["beaten"]:
        console.print(
            f"a baseline wins, {matched}: {detectors[b['detector']]} on {b['kind']}, {b['matched']:.0%} "
            f"against {b['monitor']:.0%}"
        )


def _print_invisible(summary: dict[str, Any]) -> None:
    """Faults that harm the loop and that the samples do not show."""
    for s in summary["invisible"]:
        harm = "mu is " + format(s["mu_upper"], ".2f") if s["loop_stable"] else "the loop is unstable"
        console.print(
            f"invisible, though {harm}: {s['kind']} {s['severity']:g} {summary['units'][s['kind']]}, "
            f"found {s['found']['monitor']} of {s['runs']}"
        )


def _print_bus(summary: dict[str, Any]) -> None:
    """Print the reactions of the supervision to faults of the bus, and to buses without a fault."""
    kinds = {
        kind: [s for s in summary["bus"] if s["kind"] == kind]
        for kind in dict.fromkeys(s["kind"] for s in summary["bus"])
    }
    print_rows(
        {
            "fault of the bus, by severity": f"{kind}: {', '.join(format(s['severity'], 'g') for s in rows)} "
            f"{summary['units'][kind]}",
            "runs as required": _total_of(rows, "as_required", "runs"),
            "reactions met": _total_of(rows, "met", "due"),
            "not live": _range(rows, "away"),
            "judged": _range(rows, "judged"),
            "alarmed, visible runs": f"{sum(s['alarmed']['monitor'] for s in rows)}, "
            f"{sum(s['visible_runs'] for s in rows)}",
        }
        for kind, rows in kinds.items()
    )
    for which, reactions in summary["supervision"].items():
        console.print(
            f"supervision of a {which} bus as its frames require: {share_words(reactions['as_required'])} "
            f"runs; of {reactions['due']} reactions due, {reactions['met']} came in the required tick"
        )


def _range(rows: list[dict], share: str) -> str:
    return f"{min(r[share] for r in rows):.0%} .. {max(r[share] for r in rows):.0%}"


def _total_of(rows: list[dict], count: str, total: str) -> str:
    return f"{sum(r[count] for r in rows)} of {sum(r[total] for r in rows)}"
