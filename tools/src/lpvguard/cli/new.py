"""`lpvguard new`: from a stranger's logs to a project file and a folder of drives."""

from pathlib import Path
from typing import Annotated

import typer

from ..vehicle.physics import KindName
from .shared import Out, app, console, progress_bar

Wheelbase = Annotated[
    float | None, typer.Option(help="Wheelbase [m]; with it units are checked.", min=0.05, max=20)
]
Rate = Annotated[float | None, typer.Option(help="Rows a second of tables without times [Hz].", min=0.1)]
Ratio = Annotated[
    float | None,
    typer.Option("--steering-ratio", help="Steering wheel over road wheel; 1: road wheel.", min=0.1, max=100),
]
Parts = Annotated[
    bool, typer.Option("--parts", help="All measurements of the yaw rate become outputs: names parts.")
]


@app.command(epilog="Example: lpvguard new mycar LOGS/*.csv --wheelbase 2.9 -o mycar")
def new(
    name: Annotated[str, typer.Argument(help="Name of the vehicle: lower case, digits, underscores.")],
    logs: Annotated[list[Path], typer.Argument(help="Logs as of ingest, one a recording, or folders.")],
    out: Out,
    dbc: Annotated[Path | None, typer.Option(help="CAN database of raw logs.")] = None,
    model: Annotated[str, typer.Option(help="yaw-first-order, bicycle, table-1 or own.")] = "yaw-first-order",
    wheelbase: Wheelbase = None,
    channel: Annotated[str | None, typer.Option(help="Interface of raw logs with several.")] = None,
    schema: Annotated[Path | None, typer.Option(help="log.capnp of openpilot's logs.")] = None,
    time: Annotated[str | None, typer.Option(help="Time column of tables.")] = None,
    rate: Rate = None,
    kind: Annotated[
        KindName | None, typer.Option(help="Kind of vehicle (default: as the wheelbase suggests).")
    ] = None,
    ratio: Ratio = None,
    speed: Annotated[str | None, typer.Option(help="Signal that is the speed.")] = None,
    input_: Annotated[str | None, typer.Option("--input", help="Signal that is the steering.")] = None,
    output: Annotated[str | None, typer.Option(help="Signal that is the yaw rate.")] = None,
    speed_unit: Annotated[str | None, typer.Option(help="Its unit, as km/h.")] = None,
    input_unit: Annotated[str | None, typer.Option(help="Its unit, as deg.")] = None,
    output_unit: Annotated[str | None, typer.Option(help="Its unit, as deg/s.")] = None,
    parts: Parts = False,
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
            kind=kind,
            schema=schema,
            channel=channel,
            time=time,
            rate_hz=rate,
            ratio=ratio,
            parts=parts,
            units={"speed": speed_unit, "input": input_unit, "output": output_unit},
        )
    for p in made.proposals.values():
        console.print(
            f"{p.role}: {p.name} in {p.unit}, factor {p.factor:.6g}: {'; '.join(p.why)}", markup=False
        )
    for r in made.further:
        role = "output" if parts else "with --parts an output"
        console.print(f"{role}: {r.signal}: {r.why}", markup=False)
    for text in made.notes:
        console.print(text)
    for log, reason in made.left_out.items():
        console.print(f"left out: {log}: {reason}", markup=False)
    console.print(
        f"written to {out}; read {out}/{name}.toml, then: "
        f"lpvguard fit --vehicle {out}/{name}.toml {out}/drives -o {out}-fit"
    )
