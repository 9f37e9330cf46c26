"""Tables of `lpvguard evaluate` for people, on standard error."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from rich.table import Table

from .shared import console
from .tables import print_missing, table_of

if TYPE_CHECKING:
    from ..evaluate.comparison import DetectorColumn


def print_evaluation(result: dict[str, Any]) -> None:
    """The object of `lpvguard evaluate --json`: false alarms, claims, faults found, beside the baselines."""
    from ..core.compiled import TESTS
    from ..evaluate.comparison import ALARM_HEAD, CALIBRATED, MONITOR, alarm_rows, columns
    from ..evaluate.false_alarms import PIECE_S
    from ..evaluate.parts import part_lines
    from ..evaluate.summary import summary

    console.print(table_of(ALARM_HEAD, alarm_rows(result)))
    short = [f"{r['run']} {r['last_piece_s']:.1f} s" for r in result["drives"] if r["last_piece_s"] < PIECE_S]
    console.print(f"last pieces that are shorter: {', '.join(short) or 'none'}")
    print_missing(result["drives"])
    for test, claim in result["claims"]["identified"].items():
        console.print(f"{test} test as identified: {claim}")
    for what, claims in result["claims"][result["mode"]].items():
        tests = "all tests at one threshold" if what == MONITOR else what + " test"
        console.print(f"{tests}, {CALIBRATED[result['mode']]}: {'; or '.join(claims)}")
    for name, reason in result["left_out"].items():
        console.print(f"left out: {name}: {reason}", markup=False)
    for name, reason in result["without_faults"].items():
        console.print(f"no fault injected: {name}: {reason}")
    console.print(
        f"faults injected into {len(result['drives']) - len(result['without_faults'])} of "
        f"{len(result['drives'])} drives; found within {result['injection']['within_s']:g} s of judged, "
        "excited driving, as a share of all starts (drives: from every start), with the median time; "
        "a ramp lasts "
        f"{result['injection']['ramp_s']:g} s:"
    )
    detectors, others = columns(result), [b["kind"] for b in result["baselines"]]
    console.print(_detector_table({name: d for name, d in detectors.items() if name not in others}))
    _print_rates(detectors, [MONITOR, *TESTS])
    if others:
        _print_baselines(result, {name: detectors[name] for name in (MONITOR, *others)})
    else:
        console.print("no baselines: too few drives calibrate them")
    _print_causes(result)
    if "parts" in result:
        console.print("parts named in windows after faults of all outputs or of the input:")
        for line in part_lines(result["parts"]):
            console.print(line, markup=False)
    console.print()
    for line in summary(result):
        console.print(line, markup=False)


def _print_causes(result: dict[str, Any]) -> None:
    """Print the causes that the core names for the faults found, as exported."""
    from ..evaluate.causes import CAUSE_HEAD, cause_rows, cause_sentences

    if result["causes"] is None:
        console.print("no causes: the generated folder has no diagnosis")
        return
    console.print("causes named of the faults found with the thresholds as exported:")
    console.print(table_of(CAUSE_HEAD, cause_rows(result["causes"])))
    for line in cause_sentences(result["causes"]):
        console.print(line, markup=False)


def _print_baselines(result: dict[str, Any], detectors: dict[str, DetectorColumn]) -> None:
    """The monitor beside the baselines: together, from when a fault is refutable, and against each alone."""
    from ..evaluate.comparison import DUEL_HEAD, MONITOR, REFUTABLE_HEAD, duel_rows, refutable_rows

    console.print(_detector_table(detectors, [", ".join(row["best"]) for row in result["faults"]]))
    _print_rates(detectors, list(detectors))
    console.print(
        "from when a fault is refutable (the faulty record's off-line margin exceeds 1, the untouched one's "
        "does not): share of these starts that are found, and median time (negative: an alarm before it):"
    )
    head = ("", REFUTABLE_HEAD, *detectors)
    console.print(table_of(head, refutable_rows(list(detectors.values()))))
    console.print(
        f"{MONITOR} against each baseline alone, over the rows of faults; behind: fewer found, or "
        "equally many and later:"
    )
    console.print(table_of(DUEL_HEAD, duel_rows(result)))


def _detector_table(detectors: dict[str, DetectorColumn], best: list[str] | None = None) -> Table:
    """Print false alarms and found faults, a column per detector; ``best`` names the leader by fault."""
    from ..evaluate.comparison import detector_rows

    head = ("", *detectors, *(["best"] if best else []))
    return table_of(head, detector_rows(list(detectors.values()), best))


def _print_rates(detectors: dict[str, DetectorColumn], names: list[str]) -> None:
    from ..evaluate.comparison import equal_rates

    console.print(
        f"{', '.join(names)} are compared {equal_rates({name: detectors[name].stated for name in names})}"
    )
