"""`lpvguard sim`: close the loop with the simulated truck over CAN frames. Exit 1 when a run did not show
what its scenario expects."""

from __future__ import annotations

from contextlib import nullcontext
from pathlib import Path
from typing import Annotated, Literal

import typer
from rich.table import Table

from ..base import artefacts
from ..base.errors import InputError
from .shared import LCM_DEFAULT, Coefficients, JsonOut, app, console, emit, progress_bar


@app.command(
    epilog="Examples: lpvguard sim nominal yaw_sign --json -\n\ntools/with-vcan lpvguard sim nominal --bus socketcan:vcan0 --target cortex-r5f"
)
def sim(
    scenarios: Annotated[
        list[str], typer.Argument(help="Shipped scenarios, or paths to scenario files (*.toml).")
    ],
    vehicle: Annotated[str, typer.Option("--vehicle", help="Shipped vehicle with a controller.")] = "truck",
    coefficients: Coefficients = None,
    bus: Annotated[
        str, typer.Option(help="What carries the CAN frames: memory, or socketcan:INTERFACE.")
    ] = "memory",
    ecu_process: Annotated[
        bool,
        typer.Option(
            "--ecu-process", help="Run the firmware as a process of its own (with --bus socketcan)."
        ),
    ] = False,
    target: Annotated[
        str,
        typer.Option(
            help="Whose instructions the firmware runs on: host, or cortex-r5f in QEMU with its own CAN "
            "controller (with --bus socketcan)."
        ),
    ] = "host",
    pace: Annotated[
        float | None,
        typer.Option(
            min=1e-3, max=1e3, help="At most so many times real time (default: as fast as it goes)."
        ),
    ] = None,
    controller: Annotated[
        Literal["designed", "feedforward", "off"],
        typer.Option(help="feedforward: the command over the model's DC gain; off: never engaged."),
    ] = "designed",
    seed: Annotated[int | None, typer.Option(min=0, help="First seed (default: the scenario's).")] = None,
    seeds: Annotated[int, typer.Option(min=1, help="Runs of each scenario, with consecutive seeds.")] = 1,
    lcm: Annotated[
        str | None,
        typer.Option(metavar="URL", help="Publish telemetry there and take commands, as LCM reads it."),
    ] = None,
    paused: Annotated[
        bool, typer.Option("--paused", help="Begin when a client says resume (with --lcm).")
    ] = False,
    out: Annotated[
        Path | None,
        typer.Option("-o", "--out", help="Folder for frame logs (candump -L), telemetry and results.json."),
    ] = None,
    json_out: JsonOut = None,
) -> None:
    """Close the loop with the simulated truck over CAN frames. Exit 1 when a run did not show what its
    scenario expects."""
    from ..core.compiled import shipped_vehicle
    from ..loop.sim import Simulator, load_scenario

    if paused and (lcm is None or lcm.startswith("file:")):
        raise InputError(
            "--paused", "", f"no client can reach --lcm {lcm}", "--lcm with a URL such as " + LCM_DEFAULT
        )
    loaded = [load_scenario(name) for name in scenarios]
    runs = []
    with progress_bar("sim") as tell:
        tell("compiling")
        simulator = Simulator(
            coefficients or shipped_vehicle(vehicle), controller=controller, lcm=lcm is not None
        )
        with (
            nullcontext()
            if out is None
            else artefacts.new_folder(out, "sim", simulator.project.name) as folder
        ):
            for scenario in loaded:
                first = scenario.seed if seed is None else seed
                for number in range(first, first + seeds):
                    tell(f"{scenario.name}, seed {number}")
                    runs.append(
                        simulator.run(
                            scenario,
                            seed=number,
                            bus=bus,
                            out=folder,
                            ecu_process=ecu_process,
                            target=target,
                            pace=pace,
                            lcm=lcm,
                            paused=paused,
                        )
                    )
            if folder is not None:
                # How fast this machine was belongs to nobody's results.
                results = [{k: v for k, v in r.items() if k != "real_time_factor"} for r in runs]
                artefacts.write_files(
                    folder,
                    {
                        "results.json": artefacts.to_json(results),
                        artefacts.MANIFEST: artefacts.manifest(
                            "sim",
                            vehicle=simulator.project.name,
                            controller=controller,
                            scenarios=[s.name for s in loaded],
                        ),
                    },
                )
    emit(json_out, runs)
    table = Table(
        "scenario",
        "seed",
        "verdict",
        "invalid at s",
        "judged s to it",
        "max margin",
        "tracking",
        "x real time",
        "missed",
        box=None,
    )
    for r in runs:
        invalid = (
            ("–", "–")
            if r["first_invalid_s"] is None
            else (f"{r['first_invalid_s']:.2f}", f"{r['judged_to_invalid_s']:.2f}")
        )
        ratio = f"{r['tracking_rms'] / r['command_rms']:.1%}" if r["command_rms"] else "–"
        table.add_row(
            r["scenario"],
            str(r["seed"]),
            r["verdict_final"],
            *invalid,
            f"{r['max_margin']:.3f}",
            ratio,
            f"{r['real_time_factor']:.0f}",
            "; ".join(r["missed"]) or "nothing",
        )
    console.print(table)
    console.print(f"{bus} bus, controller {controller}, coefficients {simulator.folder}")
    for r in runs:
        if "ecu" in r:
            ecu, counted = r["ecu"], r["ecu"]["instructions"]
            console.print(
                f"{r['scenario']}: {ecu['target']}, ELF {ecu['elf_sha256'][:16]}; of {counted['ticks']} ticks the worst took {counted['worst']} "
                f"instructions, the mean {counted['total'] / counted['ticks']:.0f} (not cycles)"
            )
    raise typer.Exit(1 if any(r["missed"] for r in runs) else 0)
