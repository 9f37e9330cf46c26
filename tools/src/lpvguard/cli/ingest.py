"""`lpvguard ingest`: turn logs into uniform drive tables, with a report of what was left out and why. Needs
no model."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from ..base.errors import InputError
from .shared import JsonOut, Out, app, console, emit, progress_bar, project_of

if TYPE_CHECKING:
    from ..drives.signal_map import SignalMap


@app.command(epilog="Example: lpvguard ingest drive.log --dbc car.dbc --signals map.toml -o out/drives")
def ingest(
    logs: Annotated[
        list[Path],
        typer.Argument(
            help="candump, ASC, BLF, TRC, MF4, CSV, VBOX, JSON, Parquet; folders, .zip; text also packed."
        ),
    ],
    out: Out,
    dbc: Annotated[
        Path | None, typer.Option(help="CAN database (default: the vehicle's, or our own J1939 one).")
    ] = None,
    signals: Annotated[Path | None, typer.Option(help="Signal map (TOML).")] = None,
    vehicle: Annotated[
        str | None, typer.Option("--vehicle", help="Take the signal map from this vehicle.")
    ] = None,
    channel: Annotated[str | None, typer.Option(help="Interface of raw logs with several.")] = None,
    schema: Annotated[Path | None, typer.Option(help="log.capnp of openpilot's logs.")] = None,
    json_out: JsonOut = None,
) -> None:
    """Turn logs into uniform drive tables, with a report of what was left out and why. Needs no model."""
    from ..can.logs import logs_among
    from ..drives.ingest import ingest as run
    from ..drives.signal_map import map_of_project

    logs = logs_among(logs)
    with progress_bar("ingest"):
        if signals is not None and vehicle is None:
            report = run(logs, dbc=dbc, signals_map=_on(signals, channel), out=out, schema=schema)
        elif signals is None and vehicle is not None:
            project = project_of(vehicle)
            if dbc is None and project.can is not None:
                dbc = Path(project.can.dbc)
            report = run(
                logs, dbc=dbc, signals_map=_on(map_of_project(project), channel), out=out, schema=schema
            )
        else:
            raise InputError("ingest", "--signals, --vehicle", "both or neither given", "exactly one of them")
    emit(json_out, report, each=True)
    console.print(f"{len(logs)} log(s) read; tables and reports written to {out}")


def _on(signals: Path | SignalMap, channel: str | None) -> Path | SignalMap:
    """The signal map for the frames of a channel; as it is for None."""
    from ..drives.signal_map import load_signal_map

    if channel is None:
        return signals
    signal_map = load_signal_map(signals) if isinstance(signals, Path) else signals
    return signal_map.model_copy(update={"channel": channel})
