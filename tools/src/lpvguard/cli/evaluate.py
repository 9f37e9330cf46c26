"""`lpvguard evaluate`: false alarms and detection of injected faults, leave-one-drive-out, through the
compiled core."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any

import typer
from rich.table import Table

from .shared import (
    Coefficients,
    Jobs,
    JsonOut,
    Scheduler,
    Vehicle,
    app,
    console,
    emit,
    progress_bar,
    replayer_of,
    stored_with_drives,
)


@app.command(epilog="Example: lpvguard evaluate --vehicle g80 out/identify DRIVES --json out/evaluation.json")
def evaluate(
    vehicle: Vehicle,
    identification: Annotated[Path, typer.Argument(help="Folder written by identify.")],
    drives: Annotated[Path, typer.Argument(help="The drive folder it was made from.")],
    coefficients: Coefficients = None,
    json_out: JsonOut = None,
    jobs: Jobs = 1,
    scheduler: Scheduler = None,
) -> None:
    """False alarms and detection of injected faults, leave-one-drive-out, through the compiled core."""
    from ..base.parallel import workers
    from ..evaluate.run import FOUND_WITHIN_S, MONITOR, PIECE_S, TESTS, columns
    from ..evaluate.run import evaluate as stage

    stored, drive_set = stored_with_drives(identification, drives, vehicle)
    replayer = replayer_of(vehicle, coefficients)
    with progress_bar("evaluate") as tell, workers(jobs, scheduler) as run:
        result = stage(stored, drive_set, replayer.core, workers=run, progress=tell)
    emit(json_out, result)
    alarms = Table(
        "drivers",
        "alarmed drives",
        f"alarmed {PIECE_S:g} s pieces",
        "95 % interval of the ratio",
        "an hour judged",
        "judged, h",
        box=None,
    )
    for group, row in result["false_alarms"].items():
        interval = "–" if row["interval"] is None else f"{row['interval'][0]:.3f} .. {row['interval'][1]:.3f}"
        hourly = "–" if row["per_judged_h"] is None else f"{row['per_judged_h']:.2f}"
        alarms.add_row(
            group,
            f"{row['alarmed_drives']} of {row['drives']}",
            f"{row['alarmed']} of {row['pieces']}",
            interval,
            hourly,
            f"{row['judged_h']:.3f}",
        )
    console.print(alarms)
    short = [f"{r['run']} {r['last_piece_s']:.1f} s" for r in result["drives"] if r["last_piece_s"] < PIECE_S]
    console.print(f"last pieces that are shorter: {', '.join(short) or 'none'}")
    for test, claim in result["claims"]["identified"].items():
        console.print(f"{test} test as identified: {claim}")
    for what, claims in result["claims"]["left_one_out"].items():
        console.print(
            f"{'both tests at one threshold' if what == 'monitor' else what + ' test'}, each drive without itself: {'; or '.join(claims)}"
        )
    for name, reason in result["left_out"].items():
        console.print(f"left out: {name}: {reason}")
    for name, reason in result["without_faults"].items():
        console.print(f"no fault injected: {name}: {reason}")
    console.print(
        f"faults injected into {len(result['drives']) - len(result['without_faults'])} of {len(result['drives'])} drives; "
        f"found within {FOUND_WITHIN_S:g} s of judged, excited driving, of all starts (drives: from every start), and the median time:"
    )
    detectors, others = columns(result), [b["kind"] for b in result["baselines"]]
    console.print(_detector_table({name: d for name, d in detectors.items() if name not in others}))
    _print_rates(detectors, [MONITOR, *TESTS])
    if others:
        beside = [MONITOR, *others]
        console.print(
            _detector_table(
                {name: detectors[name] for name in beside},
                [", ".join(row["best"]) for row in result["faults"]],
            )
        )
        _print_rates(detectors, beside)
    else:
        console.print("no baselines: they need another calibration drive when one is left out")


def _detector_table(detectors: dict[str, Any], best: list[str] | None = None) -> Table:
    """False alarms and found faults, a column per detector (evaluate.Column); ``best``: who leads, per
    fault."""
    from ..evaluate.run import detector_rows

    table = Table("", *detectors, *(["best"] if best else []), box=None)
    for row in detector_rows(list(detectors.values()), best):
        table.add_row(*row)
    return table


def _print_rates(detectors: dict[str, Any], names: list[str]) -> None:
    from ..evaluate.run import equal_rates

    console.print(
        f"{', '.join(names)} are compared {equal_rates({name: detectors[name].stated for name in names})}"
    )
