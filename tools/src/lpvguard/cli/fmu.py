"""`lpvguard fmu`: a vehicle's monitor as a functional mock-up unit (FMU) for simulation tools."""

from pathlib import Path
from typing import Annotated, Literal

import typer

from ..base import artefacts
from .shared import Coefficients, Vehicle, app, console, project_of


@app.command(epilog="Example: lpvguard fmu --vehicle g80 -o g80_monitor.fmu")
def fmu(
    vehicle: Vehicle,
    out: Annotated[Path, typer.Option("-o", "--out", help="File to write.")],
    fmi: Annotated[Literal["2", "3"], typer.Option("--fmi", help="Version of FMI.")] = "3",
    coefficients: Coefficients = None,
) -> None:
    """Pack a vehicle's monitor as a co-simulation FMU for simulation tools."""
    from ..core.compiled import generated_folder
    from ..extras.fmu.package import monitor_fmu

    project = project_of(vehicle)
    folder = generated_folder(project, coefficients, vehicle)
    data = monitor_fmu(project, folder, int(fmi))
    artefacts.write_bytes(out, data, "fmu")
    console.print(f"{project.name}: monitor written to {out}, FMI {fmi}.0, {len(data) / 1e6:.1f} MB")
