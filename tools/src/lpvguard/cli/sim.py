"""`lpvguard sim`: close the loop with the simulated truck over CAN frames. Exit 1 when a run did not show
what its scenario expects."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

import typer

from ..base import artefacts
from ..base.errors import InputError
from .shared import LCM_DEFAULT, Coefficients, JsonOut, app, emit, progress_bar
from .tables import print_runs

if TYPE_CHECKING:
    from ..extras.loop.sim import Scenario, Simulator

Bus = Annotated[str, typer.Option(help="What carries the CAN frames: memory, or socketcan:INTERFACE.")]
EcuProcess = Annotated[
    bool,
    typer.Option("--ecu-process", help="Run the firmware as a process of its own (with --bus socketcan)."),
]
Target = Annotated[
    str,
    typer.Option(
        help="Whose instructions the firmware runs on: host, or cortex-r5f in QEMU with its own CAN "
        "controller (with --bus socketcan)."
    ),
]
Pace = Annotated[
    float | None,
    typer.Option(min=1e-3, max=1e3, help="At most so many times real time (default: as fast as it goes)."),
]
Controller = Annotated[
    Literal["designed", "feedforward", "off"],
    typer.Option(help="feedforward: the command over the model's DC gain; off: never engaged."),
]
LcmUrl = Annotated[
    str | None,
    typer.Option(metavar="URL", help="Publish telemetry there and take commands, as LCM reads it."),
]
Logs = Annotated[
    Path | None,
    typer.Option("-o", "--out", help="Folder for frame logs (candump -L), telemetry and results.json."),
]


@app.command(
    epilog="Examples: lpvguard sim nominal yaw_sign --json -\n\n"
    "tools/with-vcan lpvguard sim nominal --bus socketcan:vcan0 --target cortex-r5f"
)
def sim(
    scenarios: Annotated[
        list[str], typer.Argument(help="Shipped scenarios, or paths to scenario files (*.toml).")
    ],
    vehicle: Annotated[str, typer.Option("--vehicle", help="Shipped vehicle with a controller.")] = "truck",
    coefficients: Coefficients = None,
    bus: Bus = "memory",
    ecu_process: EcuProcess = False,
    target: Target = "host",
    pace: Pace = None,
    controller: Controller = "designed",
    seed: Annotated[int | None, typer.Option(min=0, help="First seed (default: the scenario's).")] = None,
    seeds: Annotated[int, typer.Option(min=1, help="Runs of each scenario, with consecutive seeds.")] = 1,
    lcm: LcmUrl = None,
    paused: Annotated[
        bool, typer.Option("--paused", help="Begin when a client says resume (with --lcm).")
    ] = False,
    out: Logs = None,
    json_out: JsonOut = None,
) -> None:
    """Close the loop with the simulated truck over CAN frames. Exit 1 when a run did not show what its
    scenario expects."""
    from ..core.compiled import shipped_vehicle
    from ..extras.loop.sim import Simulator, load_scenario

    if paused and (lcm is None or lcm.startswith("file:")):
        raise InputError(
            "--paused", "", f"no client can reach --lcm {lcm}", "--lcm with a URL such as " + LCM_DEFAULT
        )
    loaded = [load_scenario(name) for name in scenarios]
    with progress_bar("sim") as tell:
        tell("compiling")
        folder = coefficients or shipped_vehicle(vehicle)
        simulator = Simulator(folder, controller=controller, lcm=lcm is not None)
        one = partial(simulator.run, bus=bus, ecu_process=ecu_process, target=target)
        one = partial(one, pace=pace, lcm=lcm, paused=paused)
        run = partial(_runs, one, loaded, seed, seeds, tell)
        runs = run(None) if out is None else _kept(out, simulator, loaded, run)
    emit(json_out, runs)
    print_runs(runs, bus, simulator)
    raise typer.Exit(1 if any(r["missed"] for r in runs) else 0)


def _runs(
    run: Callable[..., dict[str, Any]],
    scenarios: list[Scenario],
    seed: int | None,
    seeds: int,
    tell: Callable[[str], None],
    into: Path | None,
) -> list[dict[str, Any]]:
    """Every scenario with ``seeds`` consecutive seeds from ``seed`` (None: its own) on, its files written
    below ``into``."""
    runs = []
    for scenario in scenarios:
        first = scenario.seed if seed is None else seed
        for number in range(first, first + seeds):
            tell(f"{scenario.name}, seed {number}")
            runs.append(run(scenario, seed=number, out=into))
    return runs


def _kept(
    out: Path, simulator: Simulator, scenarios: list[Scenario], run: Callable[[Path], list[dict[str, Any]]]
) -> list[dict[str, Any]]:
    """The runs, with the folder of their logs, telemetry and results.json at ``out``."""
    with artefacts.new_folder(out, "sim", simulator.project.name) as folder:
        runs = run(folder)
        # The speed of this machine is no result.
        results = [{k: v for k, v in r.items() if k != "real_time_factor"} for r in runs]
        artefacts.write_files(
            folder,
            {
                "results.json": artefacts.to_json(results),
                artefacts.MANIFEST: artefacts.manifest(
                    "sim",
                    vehicle=simulator.project.name,
                    controller=simulator.controller,
                    scenarios=[s.name for s in scenarios],
                ),
            },
        )
    return runs
