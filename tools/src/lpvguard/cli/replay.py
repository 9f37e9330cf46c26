"""`lpvguard replay`: run recorded drives through the compiled C core. Exit 1 when any drive alarmed, 2 when
any was unreadable."""

from __future__ import annotations

from functools import partial
from pathlib import Path
from typing import Annotated, Any

import typer
from rich.table import Table

from ..base.errors import InputError
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


@app.command(
    epilog="Examples: lpvguard replay --vehicle g80 RUN.csv --json -; lpvguard replay --vehicle truck RUN.log --to socketcan:vcan0"
)
def replay(
    vehicle: Vehicle,
    logs: Annotated[
        list[Path],
        typer.Argument(help="Drive tables (CSV or Parquet), or raw CAN logs of the vehicle's bus."),
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
    speed: Annotated[
        float | None, typer.Option(help="With --to: times the recorded pace; inf does not wait (default 1).")
    ] = None,
) -> None:
    """Run recorded drives through the compiled C core. Exit 1 when any drive alarmed, 2 when any was
    unreadable.

    Raw logs go through the CAN receiver of the core; "can" in the JSON says what became of the frames, and
    where samples lack.
    """
    if to is not None:
        _play(project_of(vehicle), logs, to, 1.0 if speed is None else speed, channel)
        return
    if speed is not None:
        raise InputError("replay", "--speed", "given without --to", "a bus to play onto")
    from ..base.parallel import workers

    replayer = replayer_of(vehicle, coefficients)
    done: list[dict[str, Any]] = []
    failed = 0
    with progress_bar("replay") as tell, workers(jobs, scheduler) as run:
        for log, result in zip(
            logs,
            run(partial(replayer.summarise_file, channel=channel), [log.absolute() for log in logs]),
            strict=False,
        ):
            tell(log.name)
            if isinstance(result, InputError):
                failed += 1
                complain(result)
            else:
                done.append(result)
    if done and not any(r["judged_s"] for r in done):
        failed += 1
        low, high = replayer.model.speed_range
        complain(
            InputError(
                ", ".join(r["run"] for r in done),
                "",
                "no judged stretch at all",
                f"some steady driving between {low:g} and {high:g} m/s",
            )
        )
    emit(json_out, done)
    table = Table(
        "drive",
        "duration s",
        "judged s",
        "verdict",
        "first invalid s",
        "max margin",
        "max energy ratio",
        "alarms",
        box=None,
    )
    for r in done:
        table.add_row(
            r["run"],
            f"{r['duration_s']:.1f}",
            f"{r['judged_s']:.1f}",
            r["verdict_final"],
            "–" if r["first_invalid_s"] is None else f"{r['first_invalid_s']:.2f}",
            "–" if r["max_margin"] is None else f"{r['max_margin']:.3f}",
            "–" if r["max_energy_ratio"] is None else f"{r['max_energy_ratio']:.3f}",
            str(len(r["alarms"])),
        )
    console.print(table)
    console.print(
        f"thresholds: frame test {replayer.threshold:.4g}, energy test {replayer.energy_threshold:.4g}; core {replayer.core.folder}"
    )
    for r in done:
        for a in r["alarms"][:3]:
            console.print(
                f"{r['run']}: t = {a['t_s']:.2f} s, {_alarm(a)}; a dead vehicle would read {a['evidence']:.2f}"
            )
        if len(r["alarms"]) > 3:
            console.print(f"{r['run']}: {len(r['alarms']) - 3} more alarms (--json lists all)")
        if "can" in r:
            _print_reception(r["run"], r["can"])
    raise typer.Exit(2 if failed else 1 if any(r["alarms"] for r in done) else 0)


def _alarm(a: dict[str, Any]) -> str:
    if a["test"] == "energy":

        def listed(values: list[float]) -> str:
            return ", ".join(f"{x:.3g}" for x in values)

        return (
            f"energy test, v = {a['speed_mps']:.1f} m/s: ratio {a['margin']:.2f} > {a['threshold']:.2f} {a['band']} the corners, in direction "
            f"({listed(a['direction'])}); ||F e|| = {listed(a['E'])} against ||F W_delta yhat|| {listed(a['Z'])} + sigma "
            f"{listed(a['B_w'])}"
        )
    return (
        f"frame test, {a['bin_rad_s']:.3g} rad/s, v = {a['speed_mps']:.1f} m/s: "
        f"margin {a['margin']:.2f} (statistic {a['statistic']:.2f} > {a['threshold']:.2f}); |E| = "
        f"{_norm(a['E']):.3g} against W_delta {a['W_delta']:.3g} x |Z| {_norm(a['Z']):.3g} + B_w "
        f"{', '.join(f'{b:.3g}' for b in a['B_w'])}"
    )


def _print_reception(run: str, can: dict[str, Any]) -> None:
    for message, kinds in can["messages"].items():
        rejected = ", ".join(
            f"{n} {kind}" for kind, n in kinds.items() if kind not in ("accepted", "recovering")
        )
        if rejected:
            console.print(f"{run}: {message}: {kinds.get('accepted', 0)} frames used; {rejected}")
    for gap in can["gaps"][:3]:
        console.print(
            f"{run}: no sample from {gap['from_s']:.2f} to {gap['to_s']:.2f} s: {', '.join(gap['messages'])} not live"
        )
    if len(can["gaps"]) > 3:
        console.print(f"{run}: {len(can['gaps']) - 3} more gaps (--json lists all)")


def _play(project, logs: list[Path], to: str, speed: float, channel: str | None) -> None:
    import can

    from ..can.play import play
    from ..replay.run import bus_frames

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
                    f"{log.name}: {len(frames)} frames onto {interface}, the latest {late * 1e3:.1f} ms behind its time"
                )
    except (OSError, can.CanError) as error:
        raise InputError(
            "replay", f"--to {to}", str(error), "a SocketCAN interface that is up (tools/with-vcan lends one)"
        ) from None


def _norm(values: list[complex]) -> float:
    return sum(abs(x) ** 2 for x in values) ** 0.5
