"""`lpvguard new`: from a stranger's logs to a project file and a folder of drives."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from .shared import Out, app, console, progress_bar


@app.command(epilog="Example: lpvguard new mycar LOGS/*.csv --wheelbase 2.9 -o mycar")
def new(
    name: Annotated[str, typer.Argument(help="Name of the vehicle: lower case, digits, underscores.")],
    logs: Annotated[list[Path], typer.Argument(help="Logs as of ingest, one a recording, or folders.")],
    out: Out,
    dbc: Annotated[Path | None, typer.Option(help="CAN database of raw logs.")] = None,
    model: Annotated[str, typer.Option(help="yaw-first-order, bicycle, table-1 or own.")] = "yaw-first-order",
    wheelbase: Annotated[
        float | None, typer.Option(help="Wheelbase [m]; with it units are checked.", min=0.05, max=20)
    ] = None,
    speed: Annotated[str | None, typer.Option(help="Signal that is the speed.")] = None,
    input_: Annotated[str | None, typer.Option("--input", help="Signal that is the steering.")] = None,
    output: Annotated[str | None, typer.Option(help="Signal that is the yaw rate.")] = None,
) -> None:
    """Look at logs, propose signals, units, signs, rate and frames; write a project file and its drives."""
    from ..can.logs import logs_among
    from ..start.new_project import new as run

    with progress_bar("new"):
        made = run(
            name,
            logs_among(logs),
            out,
            dbc=dbc,
            model=model,
            chosen={"speed": speed, "input": input_, "output": output},
            wheelbase_m=wheelbase,
        )
    for p in made.proposals.values():
        console.print(f"{p.role}: {p.name} in {p.unit}, factor {p.factor:.6g}: {'; '.join(p.why)}")
    for text in made.notes:
        console.print(text)
    for log, reason in made.left_out.items():
        console.print(f"left out: {log}: {reason}")
    console.print(
        f"written to {out}; read {out}/{name}.toml, then: "
        f"lpvguard fit --vehicle {out}/{name}.toml {out}/drives -o {out}-fit"
    )
