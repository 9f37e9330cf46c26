"""`lpvguard bench core`: ROM, RAM, stack, instructions and processor load of the core on an ECU.

The bench emulates Cortex-M4F, M7 and R5F during a simulated drive. The vehicle is that of the budget in
lib/INTEGRATION.md: the truck with 20 bins, 2 outputs and a controller of 25 states. Every count is a number
of executed *instructions, not cycles*. For cycles, multiply by the processor's cycles per instruction, flash
waits included.
"""

import json
import sys
import tempfile
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from ...base.artefacts import write_files
from ...base.errors import InputError
from ...core.coefficients import build_coefficients, vehicle_files
from ...core.compiled import shipped_vehicle
from ...core.control_coefficients import ControllerCoefficients, build_controller
from ...core.targets import TARGETS, Input, run_evidence, run_host, run_target, run_verdicts
from ...drives.frames import Estimator
from ...engine.overbound.weight import Weight
from ...identify.change import ChangeTest
from ...identify.diagnosis import PARTS, DiagnosisScales
from ...identify.energy import EnergyTest
from ...identify.isolation import Changes, Isolation
from ...identify.isolation_table import isolation_table, parts_header
from ...vehicle.nominal import NominalModel
from ...vehicle.project import Project, load_project, parse_project
from ._redundant_car import FAULTS, redundant_drives, redundant_project

WORST_STEP = 10_800  # instructions, Cortex-M4F, everything included
INIT = 150_000  # instructions, Cortex-M4F
WORST_TO_MEDIAN = 1.35
RAM_BYTES = 12_288
RECORDED_FRAMES = 4  # at least, in that RAM
ROM_BYTES = 57_344  # all parts of the image, with 9.2 kB of diagnosis
STACK_BYTES = 2048
MONITOR_ROM_BYTES = 16_384  # image with only the monitor, for the shipped g80
MONITOR_RAM_BYTES = 4_096
EVIDENCE = 300  # instructions per sample, Cortex-M4F
XCP_IDLE = 0.02  # share of the step while the XCP slave is idle
TRUCK_FRAMES = 4  # largest number of own frames that the truck sends in a step
DENSE_TO_CONTROLLER = 5.0
"""Least ratio of the instructions of a step with full matrices to those of the core's step
(firmware_sim/ports/dense_controller.hpp)."""
CONTROLLER_STATES = 25
ISOLATION_WINDOW_S = 20.0
ISOLATION_PARTS = ("isolation_take", "isolation_work")
"""Parts of the isolation, which a vehicle without redundant outputs does not have. Their stack is apart."""
CYCLES_PER_INSTRUCTION = 1.0
"""Cycles per instruction that the processor load assumes; the report says so."""


def budget_project() -> Project:
    """Project of the truck with 20 bins, DC included."""
    document = load_project("truck").model_dump(by_alias=True)
    document["frames"] |= {"bins_per_decade": 12, "omega_max_radps": 11.938052}
    return parse_project(document, "truck with 20 bins")


def budget_controller(project: Project) -> ControllerCoefficients:
    """Make a stable controller with 25 states and 8 nodes; it has the budget's size but is not a design."""
    model = NominalModel(project)
    rng = np.random.default_rng(25)
    speeds = np.linspace(*model.speed_range, 8)
    n, Ts = CONTROLLER_STATES, project.Ts_s
    decay, turn = rng.uniform(0.2, 10.0, (2, n // 2))
    d = np.expm1((-decay + 1j * turn) * Ts)  # pole minus one, for every pair
    a = np.append(np.column_stack([2 * d.real, -(np.abs(d) ** 2)]).ravel(), -1.0)
    scale = np.append(Ts * np.column_stack([np.ones(n // 2), np.abs(d)]).ravel(), 1.0)
    B = (
        0.5
        * scale[:, None]
        * rng.standard_normal((n, 1 + model.n_y))
        * np.linspace(1.0, 1.2, len(speeds))[:, None, None, None]
    )
    B = np.repeat(B, model.n_u, axis=1)
    return build_controller(
        Ts,
        speeds,
        a,
        B,
        np.zeros((len(speeds), model.n_u, n, model.n_u)),
        np.repeat(np.linspace(6.0, 4.0, len(speeds))[:, None], model.n_u, axis=1),
        np.full(model.n_u, 40.0),
    )


def budget_diagnosis(project: Project) -> DiagnosisScales:
    """Make diagnosis scales of the budget's size; they are not those of a vehicle."""
    n_y = project.n_y
    return DiagnosisScales(
        project.Ts_s,
        np.full((n_y, 2), [0.1, 0.01]),
        np.tile(1e-4 * np.eye(PARTS), (n_y, 1, 1)),
        np.full(n_y, 4.0),
        np.full((n_y, 2), [1e-2, 1e-2]),
        np.full(n_y, 1e-1),
        np.full(n_y, 1e-2),
        np.ones(n_y),
        2.0,
        np.full(n_y, 0.9),
        windows=100,
        drives=10,
    )


def write_budget_vehicle(folder: Path) -> Project:
    """Write a generated folder of the budget's sizes, with placeholder bounds."""
    project = budget_project()
    model = NominalModel(project)
    estimator = Estimator.from_project(project, model)
    W_delta = np.outer(np.linspace(0.1, 0.4, estimator.n_bins), np.ones(project.n_delta))
    B_w = np.outer(np.linspace(0.02, 0.01, estimator.n_bins), np.ones(project.n_y))
    # Order 6 is the largest of the truck's project: three sections for each Delta.
    corners = np.geomspace(0.5, 20.0, 6)
    weight = Weight(0.4 * np.poly(-1.2 * corners), np.poly(-corners))
    energy = EnergyTest.design(
        project,
        estimator,
        [weight] * project.n_delta,
        estimator.omega[1:],
        np.full((estimator.n_bins - 1, project.n_delta), 0.1),
        1.0,
    )
    sigma = np.tile([0.1, 0.05], (len(energy.F), 1))
    energy = replace(energy, sigma=sigma, start=50.0 * sigma**2)
    coefficients = build_coefficients(
        project, model, estimator, W_delta, B_w, 1.5, energy, ChangeTest.design(project)
    )
    folder.mkdir(parents=True, exist_ok=True)
    write_files(
        folder,
        vehicle_files(
            project,
            coefficients,
            {"kind": "vehicle", "project": project.model_dump(by_alias=True)},
            budget_controller(project),
            budget_diagnosis(project).table,
        ),
    )
    return project


def write_redundant_vehicle(folder: Path, project: Project, isolation: Isolation, threshold: float) -> None:
    """Write a generated folder of the car with four outputs, with placeholder bounds.

    Only its frame test alarms, above ``threshold``.
    """
    model = NominalModel(project)
    estimator = Estimator.from_project(project, model)
    ones = np.ones((estimator.n_bins, project.n_y))
    energy = EnergyTest.design(
        project,
        estimator,
        [Weight(np.array([0.3]), np.array([1.0]))] * project.n_delta,
        estimator.omega[1:],
        np.full((estimator.n_bins - 1, project.n_delta), 0.1),
        1.0,
    )
    energy = replace(energy, sigma=np.full((len(energy.F), project.n_y), 10.0))
    quiet = ChangeTest.design(project)
    quiet = replace(quiet, largest=1e3 * quiet.largest)
    W_delta, B_w = 0.3 * ones[:, : project.n_delta], 0.01 * ones
    coefficients = build_coefficients(project, model, estimator, W_delta, B_w, threshold, energy, quiet)
    parts = (isolation_table(project, isolation), parts_header(project, isolation))
    folder.mkdir()
    write_files(folder, vehicle_files(project, coefficients, {"kind": "vehicle"}, isolation=parts))


def count_isolation(target: str) -> dict[str, Any]:
    """Return ``parts`` and ``structs`` of the isolation of the car with four outputs, as `run_target`."""
    project = redundant_project()
    changes = Changes(project, NominalModel(project))
    isolation = Isolation.from_drives(changes, redundant_drives(6, 100.0, 1)[0], ISOLATION_WINDOW_S)
    ((drive,),) = redundant_drives(1, 3 * ISOLATION_WINDOW_S, 3, [FAULTS[:1]], ISOLATION_WINDOW_S)
    with tempfile.TemporaryDirectory() as scratch:
        folder = Path(scratch) / project.name
        write_redundant_vehicle(folder, project, isolation, 1.5)
        run = run_target(target, folder, Input(drive.v, drive.u, drive.y), same_bits=False)
    parts = {name: part for name, part in run["parts"].items() if name in ISOLATION_PARTS}
    return {"parts": parts, "structs": {"isolation": run["structs"]["isolation"]}}


def drive_of(project: Project, *, seed: int = 3) -> Input:
    """Simulate a drive in which every bin completes judged frames and the speed changes in every sample."""
    model = NominalModel(project)
    estimator = Estimator.from_project(project, model)
    n = int(estimator.settle + 1.75 * estimator.length[0])
    rng = np.random.default_rng(seed)
    t = np.arange(n) * project.Ts_s
    low, high = model.speed_range
    v = 0.5 * (low + high) * (1.0 + 0.05 * np.sin(0.1 * t))
    frequencies = rng.uniform(0.05, 2.0, 8)
    u = np.column_stack(
        [
            0.05 * s.max * np.sin(2 * np.pi * np.outer(t, frequencies) + rng.uniform(0, 6, 8)).sum(axis=1)
            for s in project.inputs
        ]
    )
    yhat = model.simulate(v, u, model.output_offset)
    scale = np.std(yhat, axis=0)
    # The gain is doubled. Frames of the lower bins then falsify the model. Frames of the higher bins pass,
    # because their bounds are wide.
    y = 2.0 * yhat + 0.05 * scale * rng.standard_normal(yhat.shape)
    return Input(v, u, y)


def bench_core(targets: tuple[str, ...] = tuple(TARGETS), *, clock_mhz: float = 168.0) -> dict[str, Any]:
    """Measure all targets; each entry also tells whether its results equal the host's bit for bit.

    ``load_percent`` is the share of a sample period that the worst step takes at ``clock_mhz``, with one
    cycle per instruction.
    """
    with tempfile.TemporaryDirectory() as scratch:
        folder = Path(scratch) / "truck"
        project = write_budget_vehicle(folder)
        drive = drive_of(project)
        host = run_host(folder, drive)
        rows = []
        for name in targets:
            run = count(name, folder, drive)
            run["bit_identical"] = (
                run_target(name, folder, drive, same_bits=True)["results"] == host["results"]
            )
            del run["results"]
            step = run["parts"]["ecu_step"]
            run["dense_to_controller"] = dense_to_controller(run)
            run["load_percent"] = (
                100 * step["worst"] * CYCLES_PER_INSTRUCTION / (clock_mhz * 1e6 * project.Ts_s)
            )
            rows.append(run)
    return {
        "vehicle": "truck, 20 bins x 2 outputs, controller of 25 states",
        "Ts_s": project.Ts_s,
        "clock_mhz": clock_mhz,
        "unit": "executed instructions, not cycles (QEMU -icount)",
        "samples": len(drive.v),
        "targets": rows,
    }


def count(target: str, folder: Path, drive: Input) -> dict[str, Any]:
    """Return the counts of `run_target` with ``rom_total``, ``worst_to_median`` and ``monitor_only``."""
    run = run_target(target, folder, drive, same_bits=False)
    step = run["parts"]["ecu_step"]
    run["rom_total"] = sum(run["rom"].values())
    run["worst_to_median"] = step["worst"] / step["median"]
    run["monitor_only"] = monitor_only(target)
    for beside in (run_evidence(target, folder), count_isolation(target)):
        run["parts"] |= beside["parts"]
        run["structs"] |= beside["structs"]
    return run


def stack_of(run: dict[str, Any]) -> int:
    """Deepest stack of the parts [bytes], without the isolation."""
    return max(part["stack"] for name, part in run["parts"].items() if name not in ISOLATION_PARTS)


def dense_to_controller(run: dict[str, Any]) -> float:
    """Ratio of a step's instructions with full matrices to those of the core, for the same controller."""
    return run["parts"]["dense_step"]["median"] / run["parts"]["control_step"]["median"]


def print_report(report: dict[str, Any]) -> None:
    """Print the table."""
    print(
        f"{report['vehicle']}; counts are {report['unit']}, "
        "read by the program on the target from its own counter"
    )
    for run in report["targets"]:
        rom, structs = run["rom"], run["structs"]
        agrees = "bit-identical to" if run["bit_identical"] else "DIFFER FROM"
        print(f"\n{run['title']}  ELF {run['elf_sha256'][:16]}  results {agrees} the host's")
        print(f"  ROM {run['rom_total']} bytes (" + ", ".join(f"{k} {v}" for k, v in rom.items()) + ")")
        print(
            "  RAM "
            + ", ".join(f"{k} {v}" for k, v in structs.items())
            + " bytes (the ECU's includes the others)"
        )
        print(
            f"  {'part':<14} {'worst [instr]':>14} {'median [instr]':>15} {'worst/median':>13} "
            f"{'stack [B]':>10}"
        )
        for name, part in run["parts"].items():
            print(
                f"  {name:<14} {part['worst']:>14} {part['median']:>15} "
                f"{part['worst'] / part['median']:>13.2f} {part['stack']:>10}"
            )
        print(
            "  memory map "
            + ", ".join(f"{name} {s['bytes']} at {s['address']:#010x}" for name, s in run["map"].items())
        )
        print(
            "  dense_step: the same controller with full matrices, "
            f"{run['dense_to_controller']:.1f} times control_step"
        )
        print(
            f"  whole step: {run['load_percent']:.2f} % of {report['clock_mhz']:g} MHz "
            f"at Ts {report['Ts_s']:g} s, if an instruction took one cycle"
        )


BUDGET = ("<!-- budget: written by `lpvguard bench core --guide`, do not edit -->\n", "<!-- budget: end -->")
"""Marks at the beginning and at the end of the table in the integration guide."""


def monitor_only(target: str) -> dict[str, int]:
    """Bytes of ``rom`` and ``ram`` of an image with only the monitor of the shipped g80."""
    at_rest = Input(np.full(2, 10.0), np.zeros((2, 1)), np.zeros((2, 1)))
    alone = run_verdicts(target, shipped_vehicle("g80"), [at_rest], fused=True)
    return {"rom": sum(alone.rom.values()), "ram": alone.ram_bytes}


def _part(name: str, count: str = "worst") -> Callable[[dict[str, Any]], str]:
    return lambda run: str(run["parts"][name][count])


GUIDE_ROWS: tuple[tuple[str, str, Callable[[dict[str, Any]], str]], ...] = (
    ("worst step [instr]", f"{WORST_STEP} (Cortex-M4F)", _part("ecu_step")),
    ("median [instr]", "", _part("ecu_step", "median")),
    ("worst/median", f"{WORST_TO_MEDIAN:g}", lambda run: f"{run['worst_to_median']:.2f}"),
    ("monitor in it, worst [instr]", "", _part("monitor_push")),
    ("controller in it, worst [instr]", "", _part("control_step")),
    ("watch in it, worst [instr]", "", _part("watch_take")),
    ("RAM [B]", f"{RAM_BYTES}", lambda run: str(run["structs"]["ecu"])),
    ("ROM [B]", f"{ROM_BYTES} (Cortex-M4F)", lambda run: str(run["rom_total"])),
    ("stack [B]", f"{STACK_BYTES}", lambda run: str(stack_of(run))),
    ("init [instr]", f"{INIT}", _part("ecu_init")),
    ("step, full bus [instr]", "", _part("ecu_step_full")),
    ("authenticated message [instr]", "", _part("auth_pair")),
    ("J1939 step, beside [instr]", "", _part("j1939_step")),
    ("J1939 RAM [B]", "", lambda run: str(run["structs"]["j1939"])),
    ("diagnosis, a sample [instr]", "", _part("diagnosis_take")),
    ("diagnosis, a call beside [instr]", "", _part("diagnosis_work")),
    ("diagnosis RAM [B]", "", lambda run: str(run["structs"]["diagnosis"])),
    ("isolation, four outputs, a sample [instr]", "", _part("isolation_take")),
    ("isolation, a call beside [instr]", "", _part("isolation_work")),
    ("isolation, stack of a call [B]", "", _part("isolation_work", "stack")),
    ("isolation RAM [B]", "", lambda run: str(run["structs"]["isolation"])),
    ("XCP idle, a frame [instr]", "", _part("xcp_idle")),
    ("XCP idle, a step [instr]", "", _part("xcp_event")),
    ("XCP upload [instr]", "", _part("xcp_upload")),
    ("XCP list of 56 entries, a step [instr]", "", _part("xcp_list")),
    ("evidence, a sample [instr]", f"{EVIDENCE} (Cortex-M4F)", _part("evidence_take")),
    ("evidence, 64 bytes read [instr]", "", _part("evidence_read")),
    ("evidence RAM, without the samples [B]", "", lambda run: str(run["structs"]["evidence"])),
    ("monitor alone, g80: ROM [B]", f"{MONITOR_ROM_BYTES}", lambda run: str(run["monitor_only"]["rom"])),
    ("monitor alone, g80: RAM [B]", f"{MONITOR_RAM_BYTES}", lambda run: str(run["monitor_only"]["ram"])),
)
"""Rows of the guide's table: name, budget, and function that gives a target's number."""


def write_guide(path: Path, report: dict[str, Any]) -> None:
    """Write the measured table between its marks in the guide; raise InputError without the marks."""
    text = path.read_text(encoding="utf-8")
    before, begin, rest = text.partition(BUDGET[0])
    _, end, after = rest.partition(BUDGET[1])
    if not end:
        raise InputError(path, "", "no place for the table", f"{BUDGET[0].strip()} and {BUDGET[1]}")
    targets, clock = report["targets"], f"of {report['clock_mhz']:g} MHz"
    rows = [
        ["target", "budget", *(run["title"] for run in targets)],
        ["---"] * (2 + len(targets)),
        *([name, budget, *map(measured, targets)] for name, budget, measured in GUIDE_ROWS),
        [clock, "", *(f"{run['load_percent']:.2f} %" for run in targets)],
        ["ELF", "", *(run["elf_sha256"][:16] for run in targets)],
    ]
    table = "".join(f"| {' | '.join(row)} |\n" for row in rows)
    path.write_text(before + begin + table + end + after, encoding="utf-8")


def main(argv: list[str] | None = None) -> None:
    """Run ``lpvguard bench core [--clock-mhz 168] [--target cortex-m4f] [--json] [--guide FILE]``."""
    import argparse

    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--clock-mhz", type=float, default=168.0)
    parser.add_argument("--target", action="append", choices=tuple(TARGETS))
    parser.add_argument("--json", action="store_true")
    parser.add_argument(
        "--guide", type=Path, help="also write the budget's table into this integration guide"
    )
    arguments = parser.parse_args(argv)
    report = bench_core(tuple(arguments.target or TARGETS), clock_mhz=arguments.clock_mhz)
    if arguments.guide:
        write_guide(arguments.guide, report)
    if arguments.json:
        json.dump(report, sys.stdout, indent=1)
        print()
    else:
        print_report(report)


if __name__ == "__main__":
    main()
