"""`lpvguard generate`: write a folder of synthetic drives of a vehicle.

`car` simulates the car (drives/fixture.py). `truck` runs the simulated truck of firmware_sim/plant at
constant speeds over the model's range. This truck is independent of the nominal model. There are swept sines
from 0.1 to 30 rad/s with the least and the largest usual amplitudes. There are also brake manoeuvres between
these amplitudes, and runs without input.
"""

import subprocess
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

from ...base import artefacts, native
from ...base.errors import InputError
from ...core.compiled import firmware_root
from ...drives import fixture
from ...drives.tables import EXPERIMENTS, index_text
from ...vehicle.project import Project

DURATION_S = 180.0
SWEEP_DURATION_S = 599.0
MANOEUVRE_BAR = (0.25, 1.0)
"""Least and largest amplitude of a manoeuvre's demand."""
SWEEPS_BAR = (0.24, 0.24, 0.24, 0.24, 0.8, 2.1, 2.1, 2.1)
"""Amplitudes of the swept sines. Kingpin friction dominates at the smallest one. The largest one, 2.06 bar,
gives a lateral acceleration of 4 m/s2. The small one is driven four times, because road and wind have effects
of the same size. The large one is driven three times, because the tyres then make the error depend on
speed."""
EDGE_SWEEPS_BAR = (2.1, 2.1, 2.1)
"""Further amplitudes at the least and the largest speed, where the error is largest and least linear over
speed."""
ZERO_INPUT_DURATION_S = 240.0
# The speeds are just inside 8 to 22 m/s, so that noise of the speed sensor keeps all samples within the
# range.
BOUND_SPEEDS = (8.1, 10.0, 12.0, 14.0, 16.0, 18.0, 20.0, 21.9)
CALIBRATION_SPEEDS = (8.5, 9.5, 11.0, 13.0, 15.0, 17.0, 19.0, 21.0, 21.5)
ZERO_INPUT_SPEEDS = (8.1, 12.0, 17.0, 21.9)
PROGRAMMES = ("pulses", "telegraph", "multisine")


def plant_tool() -> Path:
    """Compile the plant's tool from firmware_sim/plant on first use.

    Returns
    -------
    Path

    Raises
    ------
    InputError
        If the sources are missing.
    """
    root = firmware_root() / "plant"
    sources = [*sorted((root / "src").glob("*.cpp")), *sorted((root / "tool").glob("*.cpp"))]
    flags = ("-std=c++17", "-O2", "-ffp-contract=off", f'-DLPVGUARD_TRUCK_TOML="{root / "truck.toml"}"')
    try:
        return native.compile_executable(
            sources,
            flags=flags,
            include_dirs=[root / "include", root / "src", root / "tool"],
            name="plant_tool",
        )
    except native.NativeError as error:
        raise InputError(
            root, "compiling the simulated truck", str(error), "a C++17 compiler and libtomlplusplus-dev"
        ) from None


@dataclass(frozen=True)
class _Planned:
    """Plan of a drive of the truck: split, programme, speed [m/s], duration [s], amplitudes [bar]."""

    split: str
    programme: str
    speed: float
    duration: float
    amplitudes: tuple[float, float] = MANOEUVRE_BAR


def _truck_plan() -> list[_Planned]:
    """Plan the drives.

    Sweeps that set the bounds have every amplitude at every speed. Calibrating sweeps alternate the
    amplitudes.
    """
    plan = [_Planned("train", p, v, DURATION_S) for v in BOUND_SPEEDS for p in PROGRAMMES]
    sweeps = [(v, u) for v in BOUND_SPEEDS for u in SWEEPS_BAR]
    sweeps += [(v, u) for v in (BOUND_SPEEDS[0], BOUND_SPEEDS[-1]) for u in EDGE_SWEEPS_BAR]
    plan += [_Planned("sweep", "sweep", v, SWEEP_DURATION_S, (u, u)) for v, u in sweeps]
    plan += [_Planned("valid", p, v, DURATION_S) for v in CALIBRATION_SPEEDS for p in PROGRAMMES]
    for k, v in enumerate(CALIBRATION_SPEEDS):
        u = SWEEPS_BAR[k % len(SWEEPS_BAR)]
        plan.append(_Planned("valid", "sweep", v, SWEEP_DURATION_S, (u, u)))
    return plan + [_Planned("noise", "zero", v, ZERO_INPUT_DURATION_S) for v in ZERO_INPUT_SPEEDS]


def truck_drive(path: Path, **options: object) -> None:
    """Write the table of a drive of the simulated truck.

    Parameters
    ----------
    path : Path, table
    **options : object, options of ``lpvguard_plant_tool generate``, with ``_`` instead of ``-``

    Raises
    ------
    InputError
        If the tool refuses an option.
    """
    tool = plant_tool()
    words = [word for name, value in options.items() for word in (f"--{name.replace('_', '-')}", value)]
    command = [str(word) for word in (tool, "generate", "-o", path, *words)]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    if done.returncode != 0:
        raise InputError(tool, path.stem, done.stderr.strip(), "a drive of the simulated truck")


def _truck(project: Project, folder: Path, seed: int, tell: Callable[[str], None]) -> list[fixture.Row]:
    rows = []
    bank = {"further_column": "bank"} if "bank" in {s.column for s in project.inputs} else {}
    for index, d in enumerate(_truck_plan()):
        name = f"{d.programme}_{index:02d}_{d.speed:g}mps".replace(".", "p")
        tell(name)
        truck_drive(
            folder / f"{name}.csv",
            speed=d.speed,
            program=d.programme,
            amplitude_low=d.amplitudes[0],
            amplitude_high=d.amplitudes[1],
            duration=d.duration,
            seed=seed * 1000 + index,
            **bank,
        )
        rows.append((name, d.split, d.programme))
    return rows


def generate(project: Project, target: Path, seed: int, tell: Callable[[str], None] = lambda _: None) -> int:
    """Write a folder of synthetic drives, whole or not at all.

    Parameters
    ----------
    project : Project
    target : Path, new folder
    seed : int
    tell : Callable, reports progress

    Returns
    -------
    int, number of drives

    Raises
    ------
    InputError
        If the project names no generator, or the folder may not be replaced.
    """
    makers = {"car": fixture.write_drives, "truck": _truck}
    if project.data.generator not in makers:
        raise InputError(f"vehicle {project.name}", "data.generator", "not set", " or ".join(makers))
    with artefacts.new_folder(target, "generate", project.name) as folder:
        rows = makers[project.data.generator](project, folder, seed, tell)
        artefacts.write_files(
            folder,
            {
                EXPERIMENTS: index_text(rows, "driver"),
                artefacts.MANIFEST: artefacts.manifest(
                    "generate", vehicle=project.name, seed=seed, drives=[r[0] for r in rows]
                ),
            },
        )
    return len(rows)
