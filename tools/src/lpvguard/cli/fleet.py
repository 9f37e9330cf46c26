"""`lpvguard fleet`: the wealth of vehicles over their lives, a score a recording. Exit 1 when any changed."""

from pathlib import Path
from typing import Annotated

import typer

from ..base import artefacts
from .shared import Coefficients, Jobs, JsonOut, Scheduler, Vehicle, app, emit, progress_bar, replayer_of
from .tables import print_fleet


@app.command(
    epilog="Example: lpvguard fleet --vehicle g80 --calibration HEALTHY DRIVES --state out/fleet.json"
)
def fleet(
    vehicle: Vehicle,
    drives: Annotated[Path, typer.Argument(help="Folder of drives, in the order of its experiments.csv.")],
    calibration: Annotated[
        Path | None,
        typer.Option(help="Folder of healthy drives that calibrate. Not where the state has them already."),
    ] = None,
    state: Annotated[
        Path | None, typer.Option(help="File that keeps calibration set and wealth between calls.")
    ] = None,
    coefficients: Coefficients = None,
    order: Annotated[
        str | None, typer.Option(help="Column of experiments.csv whose text orders the drives.")
    ] = None,
    by: Annotated[
        str | None, typer.Option(help="Column of experiments.csv that names the vehicle (default: one).")
    ] = None,
    judged_s: Annotated[
        float | None, typer.Option(help="Judged driving that each recording's score is of, s (default 60).")
    ] = None,
    alpha: Annotated[
        float | None, typer.Option(help="P(ever alarm) of a life, given the set (default 0.05).")
    ] = None,
    eta: Annotated[
        float | None, typer.Option(help="Share of sets for which that may fail (default 0.05).")
    ] = None,
    export: Annotated[
        Path | None, typer.Option(help="C header to write: the calibration set's table for the core.")
    ] = None,
    json_out: JsonOut = None,
    jobs: Jobs = 1,
    scheduler: Scheduler = None,
) -> None:
    """The wealth of vehicles over their lives: a score a recording, and what changed. Exit 1 when any did.

    "changed" says that the drives are not like those that calibrate; it falsifies no bound.
    """
    from ..base.parallel import workers
    from ..extras.fleet.export import header
    from ..extras.fleet.recordings import Listed, begun, changed, follow
    from ..extras.fleet.state import KIND

    replayer, listed = replayer_of(vehicle, coefficients), Listed.from_folder(drives, order, by)
    stated = {"judged_s": judged_s, "alpha": alpha, "eta": eta}
    with progress_bar("fleet") as tell, workers(jobs, scheduler) as run:
        before, left_out = begun(replayer, state, calibration, stated, run, tell)
        after, result = follow(replayer, before, listed, left_out, run, tell)
    if export is not None:
        artefacts.write_file(export, header(after), KIND)
    emit(json_out, result)
    if state is not None:  # last: a call that fails before has counted nothing
        after.write(state)
    print_fleet(result)
    raise typer.Exit(1 if changed(result) else 0)
