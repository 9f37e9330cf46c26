"""`lpvguard identify`: find the unfalsified bounds, fit the weights, calibrate the frame test (paper, steps
1-7)."""

from pathlib import Path
from typing import Annotated

import typer

from .shared import (
    Jobs,
    JsonOut,
    Keep,
    Out,
    Scheduler,
    Vehicle,
    app,
    console,
    emit,
    keeping,
    progress_bar,
    project_of,
)
from .tables import print_evidence, print_tests


@app.command(epilog="Example: lpvguard identify --vehicle g80 DRIVES -o out/identify")
def identify(
    vehicle: Vehicle,
    drives: Annotated[Path, typer.Argument(help="Folder of drives with experiments.csv.")],
    out: Out,
    json_out: JsonOut = None,
    jobs: Jobs = 1,
    scheduler: Scheduler = None,
    keep: Keep = None,
) -> None:
    """Find the unfalsified bounds, fit the weights, calibrate the frame test (paper, steps 1-7)."""
    from ..base.parallel import workers
    from ..identify import identification as stage
    from ..identify.deciders import decides_bounds, decides_thresholds, outlying, silence, unresolved
    from ..identify.unexplained import cost, unexplained

    project = project_of(vehicle)
    with progress_bar("identify") as tell, workers(jobs, scheduler) as started, keeping(keep, started) as run:
        result, drive_set = stage.identify(project, drives, workers=run, progress=tell)
        stage.save(result, drive_set, out)
        named, decided_by = unexplained(result), [*decides_bounds(result), *decides_thresholds(result)]
        floors, warnings = unresolved(result), [*(d.text for d in decided_by if d.alone), *outlying(result)]
        price = cost(result, drives, named, workers=run, progress=tell) if named else None
    emit(
        json_out,
        {
            "bound_drives": result.bound_drives,
            "calibration_drives": result.calibration_drives,
            "left_out": result.left_out,
            **result.calibration.to_dict(),
            "inflation": result.weights.inflation,
            "silent": silence(result),
            "unresolved": floors,
            "decided_by": [d.text for d in decided_by],
            "warnings": warnings,
            "energy": result.energy.to_dict() if result.energy else None,
            "change": result.change.to_dict() if result.change else None,
            "model_fit": [q.to_dict() for q in result.model_fit],
            "unexplained": [vars(u) for u in named],
            "unexplained_cost": None if price is None else price.to_dict(),
        },
    )
    c = result.calibration
    console.print(f"{len(result.bound_drives)} drives set the bounds: {', '.join(result.bound_drives)}")
    console.print(
        f"{len(result.calibration_drives)} others calibrate: {', '.join(result.calibration_drives)}"
    )
    print_evidence(result, [*silence(result), *floors, *(d.text for d in decided_by if not d.alone)])
    for line in warnings:
        console.print(f"warning: {line}", style="yellow")
    for u in named:
        console.print(f"unexplained: {u.sentence()}")
    for line in [] if price is None else price.sentences():
        console.print(f"unexplained: {line}")
    for name, reason in result.left_out.items():
        console.print(f"left out: {name}: {reason}", markup=False)
    print_tests(result)
    console.print(
        f"threshold {c.carried:.4g} ({c.claim()}); "
        f"final inflation {result.weights.inflation:.6g}; written to {out}"
    )
