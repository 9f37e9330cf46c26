"""`lpvguard lcm`: watch and lead a simulation that runs with `sim --lcm URL`."""

from pathlib import Path
from typing import Annotated, Literal

import typer

from ..base import artefacts
from ..base.errors import InputError
from .guard import Application
from .shared import LCM_DEFAULT, Out, app

lcm_app = Application(
    no_args_is_help=True,
    rich_markup_mode=None,
    help="Watch and lead a simulation that runs with `sim --lcm URL`.",
)
lcm_app.prefix = "lcm "
app.add_typer(lcm_app, name="lcm")
LcmUrl = Annotated[str, typer.Option("--url", help="Where it publishes, as LCM reads it.")]


@lcm_app.command("watch", epilog="Example: lpvguard lcm watch --silence 60")
def lcm_watch(
    url: LcmUrl = LCM_DEFAULT,
    silence: Annotated[
        float, typer.Option(min=0.1, help="Give up after so many seconds without a message.")
    ] = 10.0,
) -> None:
    """Print what changes: verdict, supervision, trouble codes, counted frames with margin and statistic,
    commands. Ends with the run."""
    from ..extras.loop.lcm_client import Client, watch

    heard = False
    for line in watch(Client(url).messages(silence)):
        print(line, flush=True)
        heard = True
    if not heard:
        raise InputError(
            url, "", f"nothing heard within {silence:g} s", "a simulation that runs with --lcm at this URL"
        )


@lcm_app.command(
    "send",
    epilog="Examples: lpvguard lcm send step --ticks 100\n\n"
    "lpvguard lcm send inject 'plant.sensor_fault = [{signal = \"yaw_rate\", gain = 0.7}]'\n\n"
    "lpvguard lcm send clear 'plant.sensor_fault[0]'",
)
def lcm_send(
    action: Annotated[
        Literal["pause", "resume", "step", "stop", "inject", "clear"],
        typer.Argument(help="stop ends the run, clear ends a fault."),
    ],
    entry: Annotated[
        str,
        typer.Argument(
            help="inject: one entry of a scenario file (TOML) without start_s: can_fault, "
            "plant.sensor_fault, plant.actuator_fault, plant.surroundings_fault, plant.speed_change. "
            "clear: its name."
        ),
    ] = "",
    ticks: Annotated[int, typer.Option(min=1, help="step: so many ticks of 10 ms, then paused again.")] = 1,
    url: LcmUrl = LCM_DEFAULT,
) -> None:
    """Tell it what to do, and print from when it acts. Exit 2 when it refuses or does not answer."""
    from ..extras.loop.lcm_client import Client, state_name

    answer = Client(url).command(action, entry, ticks=ticks)
    entry = f", {answer.entry}" if answer.entry else ""
    print(f"{answer.utime * 1e-6:.2f} s: {state_name(answer)}{entry}")


@lcm_app.command(
    "bus",
    epilog="Example: lpvguard lcm bus RECORDED.lcm -o DRIVE.log && lpvguard replay --vehicle truck DRIVE.log",
)
def lcm_bus(log: Annotated[Path, typer.Argument(help="Log of lcm-logger.")], out: Out) -> None:
    """The CAN frames of an LCM log as candump -L writes them: the log that `sim -o` writes, byte for byte."""
    from ..extras.loop.lcm_client import log_line, read_log

    lines = [log_line(message) for channel, message in read_log(log) if channel == "LPVGUARD_BUS"]
    if not lines:
        raise InputError(
            log, "LPVGUARD_BUS", "holds no frame", "a log of lcm-logger while a simulation ran with --lcm"
        )
    artefacts.write_file(out, "".join(lines), "lcm bus")
