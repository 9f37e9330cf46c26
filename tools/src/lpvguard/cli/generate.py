"""`lpvguard generate`: write seeded synthetic drives of a vehicle: tables and experiments.csv."""

from typing import Annotated

import typer

from .shared import Out, Vehicle, app, console, progress_bar, project_of


@app.command(epilog="Example: lpvguard generate --vehicle g80 -o out/drives --seed 1")
def generate(
    vehicle: Vehicle,
    out: Out,
    seed: Annotated[int | None, typer.Option(min=0, help="Seed (default: the project file's).")] = None,
) -> None:
    """Write seeded synthetic drives of a vehicle: tables and experiments.csv."""
    from ..extras.loop.generate import generate as run

    project = project_of(vehicle)
    with progress_bar("generate") as tell:
        count = run(project, out, project.seed if seed is None else seed, tell)
    console.print(f"{count} drives written to {out}")
