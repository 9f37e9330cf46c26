"""`lpvguard fmu`: a vehicle's monitor or ECU, or the simulated truck, as a functional mock-up unit (FMU)."""

from pathlib import Path
from typing import Annotated, Literal

import typer

from ..base import artefacts
from .shared import Coefficients, Vehicle, app, console, project_of


@app.command(
    epilog="Examples: lpvguard fmu --vehicle g80 -o g80_monitor.fmu\n\n"
    "lpvguard fmu --vehicle truck --as ecu -o truck_ecu.fmu"
)
def fmu(
    vehicle: Vehicle,
    out: Annotated[Path, typer.Option("-o", "--out", help="File to write.")],
    kind: Annotated[
        Literal["monitor", "ecu", "plant"],
        typer.Option(
            "--as",
            help="ecu: the ECU; plant: the simulated truck. In FMI 3 both have a CAN terminal (FMI-LS-BUS).",
        ),
    ] = "monitor",
    fmi: Annotated[Literal["2", "3"], typer.Option("--fmi", help="Version of FMI.")] = "3",
    coefficients: Coefficients = None,
) -> None:
    """Pack a vehicle's monitor or ECU, or the simulated truck, as a co-simulation FMU."""
    from ..core.compiled import generated_folder
    from ..extras.fmu.package import ecu_fmu, monitor_fmu, plant_fmu

    project = project_of(vehicle)
    folder = generated_folder(project, coefficients, vehicle)
    make = {"monitor": monitor_fmu, "ecu": ecu_fmu, "plant": plant_fmu}[kind]
    data = make(project, folder, int(fmi))
    artefacts.write_bytes(out, data, "fmu")
    console.print(f"{project.name}: {kind} written to {out}, FMI {fmi}.0, {len(data) / 1e6:.1f} MB")
