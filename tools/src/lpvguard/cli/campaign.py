"""`lpvguard campaign`: score the monitor and the baselines over many simulated runs; stopped half-way, the
same command goes on. Exit 1: a falsified certificate, or another claim missed."""

from pathlib import Path
from typing import Annotated

import typer

from ..base import artefacts
from ..vehicle.stored_settings import require_settings
from .campaign_tables import print_campaign
from .shared import Coefficients, Jobs, JsonOut, Out, Scheduler, app, emit, progress_bar, stored_with_drives


@app.command(
    epilog="Example: lpvguard campaign out/truck/identify out/truck/drives -o out/campaign "
    "--coefficients out/truck/vehicle"
)
def campaign(
    identification: Annotated[Path, typer.Argument(help="Folder written by identify.")],
    drives: Annotated[Path, typer.Argument(help="The drive folder it was made from.")],
    out: Out,
    vehicle: Annotated[str, typer.Option("--vehicle", help="Shipped vehicle with a controller.")] = "truck",
    coefficients: Coefficients = None,
    design: Annotated[
        Path | None, typer.Option(help="Folder written by design: also mu of the faulted loops.")
    ] = None,
    hours: Annotated[
        float, typer.Option(min=0.05, help="Simulated driving of trucks within the bounds.")
    ] = 100.0,
    repeats: Annotated[int, typer.Option(min=1, help="Runs of each severity of each fault.")] = 10,
    seed: Annotated[int, typer.Option(min=0, help="Seed of everything that is drawn.")] = 1,
    json_out: JsonOut = None,
    jobs: Jobs = 1,
    scheduler: Scheduler = None,
) -> None:
    """Score the monitor and the baselines over many simulated runs; stopped half-way, the same command goes
    on. Exit 1: a falsified certificate, or another claim missed."""
    from ..base.parallel import workers
    from ..core.compiled import shipped_vehicle
    from ..extras.loop.campaign.chunked_runs import campaign as stage
    from ..extras.loop.campaign.scenarios import Size

    stored, drive_set = stored_with_drives(identification, drives)
    folder = coefficients or shipped_vehicle(vehicle)
    require_settings(
        artefacts.read_manifest(folder, "vehicle")["project"], folder, stored.project, identification
    )
    with progress_bar("campaign") as tell, workers(jobs, scheduler) as run:
        summary = stage(
            stored,
            drive_set,
            folder,
            out,
            seed=seed,
            size=Size(hours, repeats),
            controller=design and design / "controller.json",
            workers=run,
            progress=tell,
        )
    emit(json_out, summary)
    print_campaign(summary)
    raise typer.Exit(1 if summary["missed"] else 0)
