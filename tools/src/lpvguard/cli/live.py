"""`lpvguard live`: a page for browsers of this machine that shows what the core says as frames come."""

from __future__ import annotations

import asyncio
from contextlib import ExitStack
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from ..base import artefacts
from ..base.errors import InputError
from .shared import Coefficients, Vehicle, app, console, replayer_of

if TYPE_CHECKING:
    from ..extras.live.foxglove_server import FoxgloveServer
    from ..replay.replayer import Replayer


@app.command(
    epilog="Examples: lpvguard live --vehicle truck udpm://239.255.76.67:7667?ttl=0; "
    "lpvguard live --vehicle truck socketcan:vcan0; lpvguard live --vehicle truck RUN.log"
)
def live(
    vehicle: Vehicle,
    source: Annotated[
        str,
        typer.Argument(
            help="LCM URL of a simulation, socketcan:INTERFACE with the vehicle's bus, a candump log that "
            "grows, or an MCAP file of ROS 2 with can_msgs/Frame."
        ),
    ],
    coefficients: Coefficients = None,
    channel: Annotated[str | None, typer.Option(help="Interface of a log with several.")] = None,
    window: Annotated[
        float, typer.Option(min=10.0, max=86_400.0, help="Seconds that are kept for scrolling back.")
    ] = 3600.0,
    port: Annotated[int, typer.Option(min=0, max=65_535, help="Port on 127.0.0.1 (0: any free one).")] = 0,
    foxglove: Annotated[
        int | None,
        typer.Option(
            min=0,
            max=65_535,
            help="Also a Foxglove WebSocket on this port of 127.0.0.1 (0: any free one), for Foxglove and "
            "PlotJuggler.",
        ),
    ] = None,
    ros: Annotated[
        Path | None,
        typer.Option("--ros", help="Also an MCAP file with ROS 2 messages, whole when the command ends."),
    ] = None,
) -> None:
    """Show verdict, margins, evidence, energy bands, CAN health and alarms on a page while frames come.

    The page is for browsers of this machine and only reads. An interrupt ends the command with status 0."""
    try:
        from ..extras.live.server import serve
    except ImportError as error:
        raise _not_installed(error, "live") from None
    from ..extras.live.sources import open_source
    from ..extras.live.watch import Listener, Watch
    from ..replay.ros import Ros2Recorder

    replayer, also = replayer_of(vehicle, coefficients), ""
    with ExitStack() as ends:
        opened = open_source(source)
        listeners: list[Listener] = []
        if foxglove is not None:
            server = _foxglove(replayer, foxglove)
            ends.callback(server.stop)
            listeners.append(server)
            also = f", Foxglove at {server.url}"
        if ros is not None:
            stream = ends.enter_context(ends.enter_context(artefacts.new_file(ros, "live")).open("wb"))
            recorder = Ros2Recorder(stream, replayer.project.name)
            ends.callback(recorder.close)
            listeners.append(recorder)
        watch = Watch(replayer, opened, window, channel, listeners=listeners)

        def ready(url: str) -> None:
            console.print(f"live: {source} at {url}{also} (interrupt ends it)")

        asyncio.run(serve(watch, port, ready))


def _foxglove(replayer: Replayer, port: int) -> FoxgloveServer:
    """Foxglove's server on a port. InputError without its package."""
    try:
        from ..extras.live.foxglove_server import FoxgloveServer
    except ImportError as error:
        raise _not_installed(error, "foxglove") from None
    return FoxgloveServer(replayer, port)


def _not_installed(error: ImportError, extra: str) -> InputError:
    return InputError(
        "live", "", f"the Python package {error.name} is not installed", f"pip install 'lpvguard[{extra}]'"
    )
