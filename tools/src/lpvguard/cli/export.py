"""`lpvguard export`: generate the C folder of a vehicle: coefficients, controller, signal table, CAN codec,
manifest."""

from pathlib import Path
from typing import Annotated

import typer

from .refine_tables import print_changes
from .shared import Jobs, Out, Vehicle, app, console, progress_bar, stored_for, warn_of_ranges


@app.command(epilog="Example: lpvguard export --vehicle g80 out/identify -o lib/vehicles/g80")
def export(
    vehicle: Vehicle,
    identification: Annotated[Path, typer.Argument(help="Folder written by identify.")],
    out: Out,
    controller: Annotated[
        Path | None, typer.Option(help="controller.json, or the folder written by design.")
    ] = None,
    group: Annotated[
        str | None,
        typer.Option(
            help="Group of experiments.csv whose thresholds the core carries (default: the largest of all)."
        ),
    ] = None,
    delta: Annotated[
        Path | None,
        typer.Option(help="Generated folder of before: prints which coefficients changed, and by how much."),
    ] = None,
    jobs: Jobs = 1,
) -> None:
    """Generate the C folder of a vehicle: coefficients, controller, signal table, CAN codec, manifest."""
    from ..base.parallel import workers
    from ..control.controller_export import export_chosen

    identified = stored_for(identification, vehicle)
    warn_of_ranges(identified.project)
    with progress_bar("export") as tell, workers(jobs) as run:
        stored = export_chosen(identified, out, controller, group, tell, run)
    if stored.calibration.groups and stored.calibration.joint is not None:
        console.print(stored.calibration.claim())
    elif stored.calibration.groups:
        console.print(f"frame test: {stored.calibration.claim()}")
        console.print(f"energy test: {stored.energy_of_core.calibration.claim()}")
        console.print(f"change test: {stored.change_of_core.calibration.claim()}")
    if delta is not None:
        from ..core.coefficient_changes import coefficient_changes

        print_changes(coefficient_changes(delta, out))
    proved = "" if controller is None else "; the controller's certificates are proved again"
    files = sum(path.is_file() for path in out.iterdir())
    console.print(f"{stored.project.name}: {files} files written to {out}{proved}")
