"""`lpvguard evaluate`: false alarms and detection of injected faults through the compiled core,
leave-one-drive-out or on drives that the identification never saw."""

from pathlib import Path
from typing import Annotated

import typer

from .evaluation_tables import print_evaluation
from .shared import (
    Coefficients,
    Jobs,
    JsonOut,
    Scheduler,
    Vehicle,
    app,
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
    drives_to_judge: Annotated[
        list[Path] | None,
        typer.Option(
            help="Folder of drives that the identification never saw: judge these, with its calibration as "
            "stored. May be given several times."
        ),
    ] = None,
    coefficients: Coefficients = None,
    json_out: JsonOut = None,
    jobs: Jobs = 1,
    scheduler: Scheduler = None,
) -> None:
    """False alarms and detection of injected faults through the compiled core: of each drive without itself,
    or of drives that the identification never saw."""
    from ..base.parallel import workers
    from ..drives.tables import set_aside
    from ..evaluate.evaluation import evaluate as stage
    from ..evaluate.judged_drives import drives_to_judge as held_out_drives
    from ..vehicle.project import load_project

    settings = load_project(vehicle).evaluation
    stored, drive_set = stored_with_drives(identification, drives, vehicle)
    held_out = held_out_drives(stored, drives_to_judge) if drives_to_judge else None
    replayer = replayer_of(vehicle, coefficients)
    with progress_bar("evaluate") as tell, workers(jobs, scheduler) as run:
        result = stage(
            stored, drive_set, replayer.core, held_out=held_out, settings=settings, workers=run, progress=tell
        )
    for folder in drives_to_judge or []:
        result["left_out"] |= set_aside(folder)
    emit(json_out, result)
    print_evaluation(result)
