"""`lpvguard sim`: close the loop with the simulated truck or an FMU over CAN frames, or with members of a
vehicle's identified set. Exit 1 when a run did not show what its scenario expects or its certificate
proves."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import asdict
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

import typer

from ..base import artefacts
from ..base.errors import InputError
from .shared import LCM_DEFAULT, Coefficients, JsonOut, app, emit, progress_bar
from .tables import print_members, print_runs

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


Members = Annotated[
    Path | None,
    typer.Option(
        help="Identification of any vehicle with a controller: its set's sampled and worst members replace "
        "the truck and the bus (with --design and --coefficients)."
    ),
]
Plant = Annotated[
    Path | None,
    typer.Option(help="FMU (co-simulation, FMI 2 or 3) that is the vehicle in place of the truck."),
]
PlantMap = Annotated[
    Path | None,
    typer.Option(
        "--map",
        help="TOML file that names the FMU's variables (default: the names of our truck's FMU, or of the "
        "signal table of a vehicle on its own bus).",
    ),
]
Design = Annotated[Path | None, typer.Option(help="Folder written by design, for --members.")]
Draws = Annotated[int, typer.Option(min=1, help="Sampled members, for --members.")]


@app.command(
    epilog="Examples: lpvguard sim nominal yaw_sign --json -\n\n"
    "lpvguard sim --members out/identify --design out/design --coefficients out/vehicle\n\n"
    "tools/with-vcan lpvguard sim nominal --bus socketcan:vcan0 --target cortex-r5f"
)
def sim(
    scenarios: Annotated[
        list[str] | None, typer.Argument(help="Shipped scenarios, or paths to scenario files (*.toml).")
    ] = None,
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
    plant: Plant = None,
    plant_map: PlantMap = None,
    members: Members = None,
    design: Design = None,
    draws: Draws = 40,
    json_out: JsonOut = None,
) -> None:
    """Close the loop with the simulated truck over CAN frames. Exit 1 when a run did not show what its
    scenario expects. A vehicle on its own bus needs --plant. With --members, close the compiled controller of
    any vehicle with members of its identified set."""
    if members is not None:
        if scenarios or design is None or coefficients is None:
            expected = "--design, --coefficients and no scenario"
            raise InputError("sim", "--members", "given without its options", expected)
        raise typer.Exit(_with_members(members, design, coefficients, draws, json_out))
    if not scenarios:
        raise InputError("sim", "SCENARIOS", "missing", "one or more, or --members")
    from ..core.compiled import shipped_vehicle
    from ..extras.loop.foreign_plant import ForeignPlant
    from ..extras.loop.sim import Simulator, load_scenario

    if paused and (lcm is None or lcm.startswith("file:")):
        raise InputError(
            "--paused", "", f"no client can reach --lcm {lcm}", "--lcm with a URL such as " + LCM_DEFAULT
        )
    if plant_map is not None and plant is None:
        raise InputError("sim", "--map", "given without its FMU", "--plant")
    loaded = [load_scenario(name) for name in scenarios]
    with progress_bar("sim") as tell:
        tell("compiling")
        folder = coefficients or shipped_vehicle(vehicle)
        simulator = Simulator(folder, controller=controller, lcm=lcm is not None)
        one = partial(simulator.run, bus=bus, ecu_process=ecu_process, target=target)
        own = simulator.project if simulator.own_bus else None
        vehicle_fmu = None if plant is None else ForeignPlant(plant, plant_map, own)
        one = partial(one, pace=pace, lcm=lcm, paused=paused, plant=vehicle_fmu)
        run = partial(_runs, one, loaded, seed, seeds, tell)
        runs = run(None) if out is None else _kept(out, simulator, loaded, run)
    emit(json_out, runs)
    print_runs(runs, bus, simulator)
    raise typer.Exit(1 if any(r["missed"] for r in runs) else 0)


def _with_members(identification: Path, design: Path, vehicle: Path, draws: int, json_out: str | None) -> int:
    """Run the compiled controller with members of the set. Returns the exit status: 1 when a run leaves what
    is proved."""
    from ..control.controller_file import require_designed_for, require_exported_with
    from ..control.robust_run import CompiledController, certified_runs
    from ..identify.identification import load

    stored = load(identification)
    document = require_designed_for(stored, design / "controller.json")
    require_exported_with(design / "controller.json", vehicle)
    with progress_bar("sim") as tell:
        tell("members of the set")
        runs = certified_runs(stored, document, CompiledController(vehicle), draws)
    emit(json_out, [asdict(r) | {"kept": r.kept} for r in runs])
    print_members(runs)
    return 0 if all(r.kept for r in runs) else 1


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
