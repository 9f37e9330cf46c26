"""`lpvguard replay`: run recorded drives through the compiled C core. Exit 1 when any drive alarmed, 2 when
any was unreadable."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

import typer

from ..base import artefacts
from ..base.errors import InputError
from ..base.progress import Counted
from .shared import (
    Coefficients,
    Jobs,
    JsonOut,
    Scheduler,
    Vehicle,
    app,
    complain,
    console,
    emit,
    progress_bar,
    project_of,
    replayer_of,
)
from .tables import print_replays

if TYPE_CHECKING:
    from ..replay.recordings import Kind
    from ..replay.replayer import Replayer
    from ..vehicle.project import Project


@app.command(
    epilog="Examples: lpvguard replay --vehicle g80 RUN.csv --json -; "
    "lpvguard replay --vehicle truck RUN.log --to socketcan:vcan0"
)
def replay(
    vehicle: Vehicle,
    logs: Annotated[
        list[Path],
        typer.Argument(help="Drive tables (CSV or Parquet), raw CAN logs of the vehicle's bus, or folders."),
    ],
    coefficients: Coefficients = None,
    json_out: JsonOut = None,
    jobs: Jobs = 1,
    scheduler: Scheduler = None,
    channel: Annotated[str | None, typer.Option(help="Interface of a raw log with several.")] = None,
    to: Annotated[
        str | None,
        typer.Option("--to", metavar="socketcan:INTERFACE", help="Play onto this bus and judge nothing."),
    ] = None,
    series: Annotated[
        Path | None,
        typer.Option("--table", help="Folder for the time series: a file a drive, a row a sample."),
    ] = None,
    kind: Annotated[
        Literal["parquet", "mcap", "mf4", "ros2"],
        typer.Option(
            "--as",
            help="With --table: Parquet, MCAP (Foxglove, PlotJuggler), MF4, or MCAP with ROS 2 messages.",
        ),
    ] = "parquet",
    speed: Annotated[
        float | None, typer.Option(help="With --to: times the recorded pace; inf does not wait (default 1).")
    ] = None,
) -> None:
    """Run recorded drives through the compiled C core. Exit 1 when any drive alarmed, 2 when any was
    unreadable.

    Raw logs go through the CAN receiver of the core; "can" in the JSON says what became of the frames, and
    where samples lack.
    """
    from ..can.logs import logs_among

    logs = logs_among(logs)
    if to is not None:
        if series is not None:
            raise InputError("replay", "--table", "given with --to, which judges nothing", "one of them")
        _play(project_of(vehicle), logs, to, 1.0 if speed is None else speed, channel)
        return
    if series is None and kind != "parquet":
        raise InputError("replay", f"--as {kind}", "given without --table", "a folder to write to")
    if speed is not None:
        raise InputError("replay", "--speed", "given without --to", "a bus to play onto")
    replayer = replayer_of(vehicle, coefficients)
    with _series_folder(series, logs, replayer) as folder:
        done, failed = _replayed(replayer, logs, channel, folder, kind, jobs, scheduler)
    emit(json_out, done)
    print_replays(done, replayer)
    raise typer.Exit(2 if failed else 1 if any(r["alarms"] for r in done) else 0)


@contextmanager
def _series_folder(table: Path | None, logs: list[Path], replayer: Replayer) -> Iterator[Path | None]:
    """The folder that takes the place of ``table`` when all series are in it; None without --table."""
    if table is None:
        yield None
        return
    from ..can.logs import stem

    names = [stem(log) for log in logs]
    twice = next((n for n in names if names.count(n) > 1), None)
    if twice is not None:
        raise InputError("replay", "--table", f"two logs are called {twice}", "different names")
    vehicle = replayer.project.name
    with artefacts.new_folder(table, "replay", vehicle) as folder:
        yield folder
        artefacts.write_files(folder, {artefacts.MANIFEST: artefacts.manifest("replay", vehicle=vehicle)})


def _replayed(
    replayer: Replayer,
    logs: list[Path],
    channel: str | None,
    folder: Path | None,
    kind: Kind,
    jobs: int,
    scheduler: str | None,
) -> tuple[list[dict[str, Any]], bool]:
    """The object of every drive that could be read, and whether anything was complained about. The drives'
    time series go into ``folder``."""
    from ..base.parallel import workers
    from ..replay.recordings import SUFFIX, write_series

    done: list[dict[str, Any]] = []
    failed = False
    with progress_bar("replay") as tell, workers(jobs, scheduler) as run:
        task = partial(replayer.summarise_file, channel=channel, with_series=folder is not None)
        results = run(task, [log.absolute() for log in logs])
        for i, (log, result) in enumerate(zip(logs, results, strict=True), start=1):
            tell(Counted(log.name, i, len(logs)))
            if isinstance(result, InputError):
                failed = True
                complain(result)
            else:
                summary, series = result
                done.append(summary)
                if folder is not None:
                    path = folder / f"{summary['run']}{SUFFIX[kind]}"
                    named = summary.get("parts", ())
                    write_series(path, kind, series, summary["alarms"], replayer.project.name, named)
    if done and not any(r["judged_s"] for r in done):
        failed = True
        low, high = replayer.model.speed_range
        complain(
            InputError(
                ", ".join(r["run"] for r in done),
                "",
                "no judged stretch at all",
                f"some steady driving between {low:g} and {high:g} m/s",
            )
        )
    return done, failed


def _play(project: Project, logs: list[Path], to: str, speed: float, channel: str | None) -> None:
    """Play logs onto a bus, at ``speed`` times their pace. InputError where there is no such bus."""
    import can

    from ..can.play import play
    from ..replay.replayer import bus_frames

    kind, _, interface = to.partition(":")
    if kind != "socketcan" or not interface:
        raise InputError("replay", "--to", to, "socketcan:INTERFACE")
    if not speed > 0:
        raise InputError("replay", "--speed", f"{speed:g}", "a number above 0, or inf")
    loaded = [(log, bus_frames(log, project).of_channel(channel, log)) for log in logs]
    try:
        with can.Bus(interface, interface="socketcan", fd=True) as bus, progress_bar("replay") as tell:
            for log, frames in loaded:
                tell(f"{log.name} onto {interface}")
                late = play(frames, bus, speed=speed)
                console.print(
                    f"{log.name}: {len(frames)} frames onto {interface}, "
                    f"the latest {late * 1e3:.1f} ms behind its time"
                )
    except (OSError, can.CanError) as error:
        raise InputError(
            "replay", f"--to {to}", str(error), "a SocketCAN interface that is up (tools/with-vcan lends one)"
        ) from None
