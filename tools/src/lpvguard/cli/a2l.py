"""`lpvguard a2l`: describe a vehicle's object in the image of its ECU (A2L), for any measurement tool."""

from pathlib import Path
from typing import Annotated

import typer

from ..base import artefacts
from .shared import Coefficients, Vehicle, app, console, project_of


@app.command(epilog="Example: lpvguard a2l --vehicle truck --elf firmware.elf --instance ecu -o truck.a2l")
def a2l(
    vehicle: Vehicle,
    elf: Annotated[Path, typer.Option("--elf", help="The ECU's image, compiled with -g.")],
    instance: Annotated[str, typer.Option("--instance", help="Name of the vehicle's object in it.")],
    out: Annotated[Path, typer.Option("-o", "--out", help="File to write.")],
    xcp: Annotated[
        str | None,
        typer.Option("--xcp", metavar="COMMANDS:ANSWERS", help="Identifiers of the image's XCP slave."),
    ] = None,
    coefficients: Coefficients = None,
) -> None:
    """Describe a vehicle's object in the image of its ECU (A2L), for any measurement tool."""
    from ..core.compiled import generated_folder, library_root
    from ..extras.measure.a2l import a2l_text
    from ..extras.measure.xcp_access import XcpAccess

    project = project_of(vehicle)
    generated_folder(project, coefficients, vehicle)
    access = XcpAccess.parse(xcp) if xcp else None
    text, n = a2l_text(project, elf, instance, library_root() / "include" / "lpvguard", access)
    artefacts.write_file(out, text, "a2l")
    console.print(f"{project.name}: {n} measurements of {instance} written to {out}")
