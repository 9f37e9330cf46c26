"""`lpvguard sim`: run the closed loop on a PC: vehicle, CAN frames and compiled ECU loop.

The vehicle is the simulated truck, or an FMU. A vehicle on its own bus (can/own_loop.py) needs an FMU.

The simulator (firmware_sim/) is compiled on first use with the vehicle's generated folder, into the cache of
`replay`. A scenario file states the driving and the faults (firmware_sim/sim/scenario.hpp). Its table
``expect`` states the required reactions and their deadlines. This module checks them:

    [expect]
    verdict = "never_invalid"     # or "any"; or "invalid": not before fault_start_s, then in within_judged_s
    fault_start_s = 60.0
    within_judged_s = 30.0        # seconds of judged driving (THEORY 11) after the fault's start
    supervision = "live"          # once live, always live; or "reacts": live until fault_start_s, then
    within_periods = 5            #   not live within so many periods, and live within 1 s after fault_end_s
    fault_end_s = 35.0
    tracking_ratio_max = 0.25     # optional: tracking_rms / command_rms
"""

from __future__ import annotations

import json
import os
import re
import shutil
import subprocess
import tempfile
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from dataclasses import asdict, dataclass
from functools import cached_property
from pathlib import Path
from typing import Annotated, Any, Literal

import numpy as np
import pyarrow as pa
import pyarrow.csv as pa_csv
from pydantic import Field, model_validator

from ...base import artefacts, native
from ...base.documents import StrictModel, checked, read_toml
from ...base.errors import InputError
from ...can.own_loop import REST_HEADER
from ...core.compiled import CAUSES, EVENTS, SUPERVISION, VERDICTS, core_objects, firmware_root, library_root
from ...core.control_coefficients import ControllerCoefficients, build_controller, replaced_controller
from ...core.targets import EmulatedEcu, emulated_ecu
from ...drives.tables import Drive, speed_of_missing
from ...replay.causes import diagnosed
from ...vehicle.design_settings import DesignSettings
from ...vehicle.nominal import NominalModel
from ...vehicle.project import Project, Signal, parse_project
from .foreign_plant import ForeignPlant

Controller = Literal["designed", "feedforward", "off"]
RECOVERY_S = 1.0
"""After a bus fault, supervision must be live again within this time: five frames of the slowest message, and
a reserve."""

REPORT_ONLY = ("--reactions", "report")
"""Option with which findings are only reported and do not release the controller."""
LINK = ("-ldl",)
LCM_LINK = ("-Wl,--no-as-needed", "-llcm")
FLAGS = ("-std=c++17", "-O2", "-ffp-contract=off", "-fno-math-errno")
OF_NO_VEHICLE = {
    "command",
    "fmu_vehicle",
    "live_scenario",
    "memory_bus",
    "scenario",
    "socketcan_bus",
    "vehicle_model",
}
"""Sources of firmware_sim/sim that do not depend on a vehicle's sizes; they are compiled once."""
OF_BUS = ("lpvg_can_codec.h", REST_HEADER)
"""Headers of a folder with its messages."""
MESSAGE_ID = re.compile(r"#define LPVG_CAN_(?:M\d+_)?(\w+)_ID \(LPVG_CAN_EXTENDED \| 0x([0-9A-F]{8})u\)")
"""Name and identifier of a message in the codec; ``M0_`` numbers those of the car's own bus."""
Seconds = Annotated[float, Field(ge=0, allow_inf_nan=False)]


class Expectation(StrictModel):
    """Table ``expect`` of a scenario; see the module's docstring.

    Attributes
    ----------
    verdict, supervision : str
    fault_start_s, fault_end_s : float or None, s
    within_judged_s : float or None, s of judged driving
    within_periods : int or None, periods
    tracking_ratio_max : float or None, tracking_rms / command_rms
    """

    verdict: Literal["never_invalid", "invalid", "any"]
    supervision: Literal["live", "reacts"]
    fault_start_s: Seconds | None = None
    fault_end_s: Seconds | None = None
    within_judged_s: Seconds | None = None
    within_periods: Annotated[int, Field(ge=1)] | None = None
    tracking_ratio_max: Annotated[float, Field(gt=0)] | None = None

    @model_validator(mode="after")
    def _complete(self) -> Expectation:
        if self.verdict == "invalid" and (self.fault_start_s is None or self.within_judged_s is None):
            raise ValueError('verdict "invalid" needs fault_start_s and within_judged_s')
        if self.supervision == "reacts" and (self.fault_start_s is None or self.within_periods is None):
            raise ValueError('supervision "reacts" needs fault_start_s and within_periods')
        return self

    def reaction_s(self, Ts_s: float) -> tuple[float, float] | None:
        """Earliest and latest time [s] for the supervision to leave live; None if it must stay live."""
        if self.supervision == "live" or self.fault_start_s is None or self.within_periods is None:
            return None
        return self.fault_start_s, self.fault_start_s + self.within_periods * Ts_s


@dataclass(frozen=True)
class Scenario:
    """Scenario file.

    Attributes
    ----------
    name : str
    path : Path
    title : str
    seed : int
    expect : Expectation
    """

    name: str
    path: Path
    title: str
    seed: int
    expect: Expectation


def shipped_scenarios() -> list[str]:
    """Names of the scenarios in firmware_sim/scenarios."""
    return sorted(p.stem for p in (firmware_root() / "scenarios").glob("*.toml"))


def load_scenario(name: str) -> Scenario:
    """Load a scenario by shipped name or by path.

    Parameters
    ----------
    name : str

    Returns
    -------
    Scenario

    Raises
    ------
    InputError
        If a field is refused. The error names the file, the field and the expected value.
    """
    path = Path(name)
    if path.suffix != ".toml":
        path = firmware_root() / "scenarios" / f"{name}.toml"
        if not path.is_file():
            raise InputError(
                name, "SCENARIO", "unknown", f"one of {', '.join(shipped_scenarios())}, or a path to *.toml"
            )
    document = read_toml(path, "a scenario file")
    expect = checked(Expectation, document.get("expect"), "a scenario file", path, table="expect")
    seed = document.get("seed", 1)
    if not isinstance(seed, int) or seed < 0:
        raise InputError(path, "seed", repr(seed), "a whole number from 0")
    return Scenario(path.stem, path, str(document.get("title", "")), seed, expect)


def steady_scenario(
    duration_s: float,
    tables: str = "",
    *,
    title: str = "steady driving",
    speed_mps: float = 15.0,
    rms_radps: float = 0.08,
    seed: int = 1,
    expect: str = 'verdict = "any"\nsupervision = "live"',
) -> str:
    """Write a scenario with constant speed and a multisine yaw-rate command of 0.5 to 4 rad/s.

    ``tables`` are further tables of the scenario.
    """
    return f"""\
title = {json.dumps(title)}
duration_s = {duration_s:g}
seed = {seed}
[plant]
speed_profile = [[0.0, {speed_mps:.6g}]]
[command]
kind = "multisine"
spacing = "log"
low_radps = 0.5
high_radps = 4.0
rms_radps = {rms_radps:g}
{tables}
[expect]
{expect}
"""


def can_fault_table(message: str, kind: str, start_s: float, end_s: float, **more: float) -> str:
    """Write the scenario table of one fault on the bus; ``more`` holds its further keys."""
    values = {"message": message, "kind": kind, "start_s": start_s, "end_s": end_s, **more}
    return "[[can_fault]]\n" + "".join(f"{key} = {json.dumps(value)}\n" for key, value in values.items())


def feedforward(
    project: Project, nodes: np.ndarray, u_max: np.ndarray, rate_max: np.ndarray
) -> ControllerCoefficients:
    """Make a controller for comparison: the delayed command divided by the nominal DC gain, without feedback.

    The delay is one sample. The limits are those of the compared controller: u_max (G, 1) [input unit] at its
    nodes (G,) [m/s], and rate_max (1,) [input unit/s]. The new nodes are these nodes and their midpoints, so
    that the limits are equal at every speed. Raises InputError like `build_controller`.
    """
    model = NominalModel(project)
    speeds = np.linspace(nodes[0], nodes[-1], 2 * len(nodes) - 1)
    gain = model.dc_gain(speeds)[:, 0, 0]
    numerators = np.zeros((len(speeds), 1, 1, 1 + model.n_y))
    numerators[:, 0, 0, 0] = 1.0 / gain
    return build_controller(
        project.Ts_s,
        speeds,
        np.array([-1.0]),
        numerators,
        np.zeros((len(speeds), 1, 1, 1)),
        np.interp(speeds, nodes, u_max[:, 0])[:, None],
        rate_max,
        where="feedforward",
    )


def _replace_controller(folder: Path, controller: ControllerCoefficients, target: Path) -> None:
    """Copy a vehicle folder and replace its controller."""
    shutil.copytree(folder, target)
    artefacts.write_files(
        target, replaced_controller((target / "lpvguard_vehicle.h").read_text(), controller)
    )


class Simulator:
    """Compiled simulator of one vehicle.

    Parameters
    ----------
    folder : Path, generated folder with a controller
    controller : str, "designed" for the folder's own controller, or another one for comparison
    lcm : bool, allow publishing and commands over LCM (needs liblcm-dev and lcm-gen), default False

    Raises
    ------
    InputError
        If the folder has no controller or does not compile.
    """

    def __init__(self, folder: Path, *, controller: Controller = "designed", lcm: bool = False):
        self.folder, self.controller, self._lcm = Path(folder), controller, lcm
        self._emulated: dict[str, EmulatedEcu] = {}
        manifest = artefacts.read_manifest(self.folder, "vehicle")
        if "controller" not in manifest:
            raise InputError(
                folder, "controller", "the vehicle has none", "a folder exported with a controller"
            )
        self.project = parse_project(manifest["project"], str(self.folder / artefacts.MANIFEST))
        self.own_bus = (self.folder / REST_HEADER).is_file()
        """True if the loop is on the car's own bus."""
        codec = self.folder / OF_BUS[0]
        if not codec.is_file():
            expected = "a vehicle whose demand our CAN message or [can.demand] carries, exported anew"
            raise InputError(folder, "controller", "the vehicle has no bus for it", expected)
        self.messages = {int(i, 16): name for name, i in MESSAGE_ID.findall(codec.read_text())}
        """Name of each message by identifier."""
        self.nodes = np.array(manifest["controller"]["speeds"])
        """Speeds (G,) [m/s] of the demand's limit, which is interpolated between them."""
        self.u_max = np.array(manifest["controller"]["u_max"])
        """Limit of the demand (G, n_u) [input unit] at these speeds."""
        if controller == "feedforward":
            if self.project.n_u != 1 or self.own_bus:
                expected = "designed, or off, for a vehicle on its own bus"
                raise InputError(folder, "--controller", controller, expected)
            limits = (self.nodes, self.u_max, np.array(manifest["controller"]["rate_max"]))
            with tempfile.TemporaryDirectory() as scratch:
                variant = Path(scratch) / self.folder.name
                _replace_controller(self.folder, feedforward(self.project, *limits), variant)
                self.program = self._build(variant)
        else:
            self.program = self._build(self.folder)

    @cached_property
    def ecu_program(self) -> Path:
        """Compile lpvguard_ecu, the firmware as a separate process on a CAN interface."""
        root = firmware_root()
        own = [*_ecu_sources(root), root / "ports" / "linux_ecu" / "main.cpp"]
        try:
            objects = core_objects(self.folder) + _objects(
                own, [*_ecu_folders(root), *_core_folders(self.folder)]
            )
            return native.compile_executable(objects, flags=(), name=f"ecu_{self.folder.name}")
        except native.NativeError as error:
            raise InputError(
                self.folder,
                "compiling the ECU's program",
                str(error).strip(),
                "a C++17 compiler and Eigen 3.4",
            ) from None

    def emulated(self, target: str) -> EmulatedEcu:
        """Build the firmware for an emulated processor with a CAN controller."""
        if target not in self._emulated:
            self._emulated[target] = emulated_ecu(target, self.folder)
        return self._emulated[target]

    def _build(self, folder: Path) -> Path:
        main = firmware_root() / "sim" / "main.cpp"
        try:
            objects = loop_objects(folder, main, lcm=self._lcm)
            return native.compile_executable(
                objects, flags=(*LINK, *(LCM_LINK if self._lcm else ())), name=f"sim_{folder.name}"
            )
        except native.NativeError as error:
            raise InputError(
                folder,
                "compiling the simulator",
                str(error).strip(),
                "a C++17 compiler, Eigen 3.4 and libtomlplusplus-dev",
            ) from None

    def run(
        self,
        scenario: Scenario,
        *,
        seed: int | None = None,
        bus: str = "memory",
        out: Path | None = None,
        ecu_process: bool = False,
        target: str = "host",
        pace: float | None = None,
        lcm: str | None = None,
        paused: bool = False,
        report_only: bool = False,
        plant: ForeignPlant | None = None,
    ) -> dict[str, Any]:
        """Run a scenario; return the object of `lpvguard sim --json`.

        seed         seed of the run; None for the scenario's seed
        bus          memory, or socketcan:INTERFACE
        out          folder for NAME-SEED.log (candump -L), .frames.csv, .telemetry.csv, and .drive.csv (a
                     drive table)
        ecu_process  run the firmware as a separate process, which needs SocketCAN
        target       host, or an emulated processor, which needs SocketCAN. With an emulated processor, the
                     result has ``ecu``: the target, the hash of the ELF file and the instructions of the
                     ticks
        pace         largest multiple of real time
        lcm          URL for publishing and commands, for a simulator with ``lcm``. With ``out``,
                     NAME-SEED.applied.toml is the scenario with the changes of the clients
        paused       wait until a client sends resume
        report_only  findings do not release the controller, as in `drive`; not on an emulated processor
        plant        FMU that replaces the vehicle

        The same scenario, seed and vehicle give the same bytes, except for real_time_factor. This factor is
        the simulated time divided by the processor time, or by the elapsed time with another process. Raises
        InputError if the simulator refuses its input.
        """
        seed = scenario.seed if seed is None else seed
        emulated = None if target == "host" else self.emulated(target)
        command: list[Any] = ["--seed", seed, "--bus", bus]
        command += REPORT_ONLY if report_only else ()
        if ecu_process or emulated is not None:
            command += ["--ecu", _joining(bus, self.ecu_program if emulated is None else emulated.program)]
        if lcm is not None:
            command += ["--lcm", lcm, "--start", "paused" if paused else "running"]
        if pace is not None:
            command += ["--pace", pace]
        with tempfile.TemporaryDirectory() as scratch:
            if plant is None and self.own_bus:
                expected = "an FMU of the vehicle, which is on its own bus"
                raise InputError(self.folder, "--plant", "missing", expected)
            if plant is not None:
                command += ["--plant", plant.linked(scenario.path, Path(scratch) / "fmu")]
            stem = (out or Path(scratch)) / f"{scenario.name}-{seed}"
            frames = stem.with_name(stem.name + ".frames.csv")
            command += ["--frames", frames]
            if out is not None:
                out.mkdir(parents=True, exist_ok=True)
                command += ["--log", f"{stem}.log", "--telemetry", f"{stem}.telemetry.csv"]
                command += ["--drive", f"{stem}.drive.csv"]
                command += [] if lcm is None else ["--applied", f"{stem}.applied.toml"]
            facts = self._execute(scenario.path, command)
            rows = np.genfromtxt(frames, delimiter=",", names=True, ndmin=1)
        result = self._result(scenario, facts, rows)
        if emulated is not None:
            counted, elf = facts["reception"]["instructions"], emulated.elf_sha256
            result["ecu"] = {"target": target, "elf_sha256": elf, "instructions": counted}
        return result

    def drive(
        self, path: Path, *, seed: int | None = None, log: Path | None = None, telemetry: Path | None = None
    ) -> tuple[dict[str, Any], Drive]:
        """Run the scenario file ``path``; return the simulator's output and the drive.

        The drive holds the monitor's input, without the samples that the monitor did not receive. ``log`` is
        a file for all frames of the bus in the form of candump -L. ``telemetry`` is a CSV file with the
        loop's state every 100 ms. Findings are only reported, so that the loop continues after the first
        finding.
        """
        with tempfile.TemporaryDirectory() as scratch:
            table = Path(scratch) / f"{path.stem}.csv"
            command: list[Any] = ["--drive", table, *REPORT_ONLY]
            for option, value in (("--seed", seed), ("--log", log), ("--telemetry", telemetry)):
                command += () if value is None else (option, value)
            facts = self._execute(path, command)
            return facts, self._without_gaps(path.stem, pa_csv.read_csv(table))

    def _execute(self, scenario: Path, options: list[Any]) -> dict[str, Any]:
        """Run the simulator with a scenario file and options; raise InputError if it refuses them."""
        words = [self.program, scenario, "--parameters", firmware_root() / "plant" / "truck.toml"]
        words += ["--engage", "no" if self.controller == "off" else "yes", *options]
        p = self.project
        words += ["--columns", ",".join(["t", *(s.column for s in (p.speed, *p.inputs, *p.outputs))])]
        words += [] if p.design is None else ["--reference", _reference_model(p.design)]
        done = subprocess.run([str(w) for w in words], capture_output=True, text=True, check=False)
        if done.returncode != 0:
            raise InputError(
                scenario, "", done.stderr.strip(), "a scenario and a bus that the simulator accepts"
            )
        facts = json.loads(done.stdout)
        diagnoses = [
            asdict(
                diagnosed(
                    self.project,
                    CAUSES[cause],
                    output,
                    numbers,
                    found_s=found_s,
                    alarm_s=alarm_s,
                    since_s=onset_s,
                    at_least=bool(before),
                )
            )
            for found_s, alarm_s, onset_s, before, output, cause, *numbers in facts["causes"]
        ]
        changes = {
            key: [[t, names[value]] for t, value in facts[key]]
            for key, names in (("verdicts", VERDICTS), ("supervision", SUPERVISION))
        }
        del facts["causes"]
        if not self.own_bus:
            facts["demand_max_bar"] = facts["demand_max"][0]
        return facts | changes | {"verdict_final": VERDICTS[facts["verdict_final"]], "diagnoses": diagnoses}

    def _without_gaps(self, name: str, table: pa.Table) -> Drive:
        p = self.project
        t = table["t"].to_numpy()
        row = np.round((t - t[0]) / p.Ts_s).astype(int)
        newest = np.searchsorted(row, np.arange(row[-1] + 1), side="right") - 1
        missing = row[newest] != np.arange(row[-1] + 1)

        def stack(signals: list[Signal]) -> np.ndarray:
            return np.column_stack([table[s.column].to_numpy().astype(float) for s in signals])[newest]

        v = stack([p.speed])[:, 0]
        return Drive(
            name,
            t[0] + np.arange(len(v)) * p.Ts_s,
            np.where(missing, speed_of_missing(p), v),
            stack(p.inputs),
            stack(p.outputs),
            missing=missing if missing.any() else None,
        )

    def _result(self, scenario: Scenario, facts: dict[str, Any], rows: np.ndarray) -> dict[str, Any]:
        expect = scenario.expect
        first_invalid = next((t for t, verdict in facts["verdicts"] if verdict == "invalid"), None)
        start = expect.fault_start_s or 0.0
        spans = judged_spans(rows)
        judged = None if first_invalid is None else overlap(spans, start, first_invalid)
        result = {
            "scenario": scenario.name,
            "title": scenario.title,
            "controller": self.controller,
            "expected": expect.model_dump(exclude_none=True),
            "first_invalid_s": first_invalid,
            "judged_to_invalid_s": judged,
            "judged_s": overlap(spans, start, facts["duration_s"]),
            "max_margin": float(rows["margin"].max(initial=0.0)),
            **facts,
            "reception": _reception(facts["reception"], self.messages),
        }
        return result | {"missed": list(missed(expect, result, self.project.Ts_s))}


def _joining(bus: str, program: Path) -> Path:
    """Return ``program`` for a separate process; raise InputError if no process can join ``bus``."""
    if not bus.startswith("socketcan:"):
        raise InputError(bus, "bus", "has no other process", "socketcan:INTERFACE")
    return program


def loop_objects(folder: Path, main: Path, *, lcm: bool = False) -> list[Path]:
    """Compile a program ``main`` with the simulated loop of a generated folder; return its objects.

    Raises NativeError if a source does not compile.
    """
    root = firmware_root()
    plant = [root / "plant" / "include", root / "plant" / "src", root / "plant" / "tool"]
    of_no_vehicle = [root / "sim", *_ecu_folders(root), *plant, library_root() / "include"]
    of_vehicle = [*of_no_vehicle, *_core_folders(folder)]
    without = {"main", "publisher_none"} if lcm else {"main"}
    without.add("truck_node" if (folder / REST_HEADER).is_file() else "own_node")
    sim = [s for s in sorted((root / "sim").glob("*.cpp")) if s.stem not in without]
    truth = [*sorted((root / "plant" / "src").glob("*.cpp")), root / "plant" / "tool" / "arguments.cpp"]
    objects = core_objects(folder)
    objects += _objects(truth, plant)
    with tempfile.TemporaryDirectory() as codec:
        for header in OF_BUS:
            if (folder / header).is_file():
                shutil.copy(folder / header, codec)
        objects += _objects([s for s in sim if s.stem in OF_NO_VEHICLE], [*of_no_vehicle, Path(codec)])
    own = [s for s in sim if s.stem not in OF_NO_VEHICLE]
    objects += _objects([*own, *_ecu_sources(root), main], of_vehicle)
    return objects + ([_lcm_publisher(root, FLAGS, of_vehicle)] if lcm else [])


def _objects(sources: list[Path], includes: list[Path]) -> list[Path]:
    """Compile sources of firmware_sim/ to objects; raise NativeError if a source does not compile."""
    with ThreadPoolExecutor(os.cpu_count()) as pool:
        return list(pool.map(lambda s: native.compile_object(s, flags=FLAGS, include_dirs=includes), sources))


def _core_folders(folder: Path) -> list[Path]:
    """Header folders of the core, for a generated folder."""
    return [library_root() / "include", library_root() / "src", folder]


def _ecu_folders(root: Path) -> list[Path]:
    """Header folders of the firmware and its ports."""
    return [root / "ecu", root / "ports", *_ports(root)]


def _ecu_sources(root: Path) -> list[Path]:
    """Sources of the firmware for both the simulator and the process on a CAN interface."""
    return [*sorted((root / "ecu").glob("*.c")), *(s for p in _ports(root) for s in sorted(p.glob("*.cpp")))]


def _ports(root: Path) -> list[Path]:
    """Folders that the ECU on Linux and its simulator share."""
    return [root / "ports" / "ecu_process", root / "ports" / "linux"]


def _lcm_publisher(root: Path, flags: tuple[str, ...], includes: list[Path]) -> Path:
    """Compile the LCM publisher with its message types; raise NativeError without lcm-gen."""
    # lcm-gen must have the version of the linked library. C++ code of another version does not compile.
    prefix = subprocess.run(
        ["pkg-config", "--variable=prefix", "lcm"], capture_output=True, text=True, check=False
    ).stdout.strip()
    generator = Path(prefix, "bin", "lcm-gen")
    if not prefix or not generator.is_file():
        raise native.NativeError("LCM not found; install liblcm-dev, liblcm-bin and libglib2.0-dev")
    with tempfile.TemporaryDirectory() as types:
        subprocess.run(
            [generator, "--cpp", "--cpp-hpath", types, *sorted((root / "lcm").glob("*.lcm"))], check=True
        )
        return native.compile_object(
            root / "lcm" / "publisher_lcm.cpp", flags=flags, include_dirs=[*includes, types]
        )


def _reference_model(design: DesignSettings) -> str:
    """Coefficients of W_R for the simulator, by descending power."""
    both = [design.W_R_num, design.W_R_den]
    if max(map(len, both)) > 3:
        raise InputError("design", "W_R_den", "of an order above 2", "at most order 2 for sim")
    return " ".join(f"{c:.17g}" for row in both for c in [0.0] * (3 - len(row)) + row)


def _reception(raw: dict[str, Any], names: dict[int, str]) -> dict[str, Any]:
    """Counters of the supervision by message and kind of event, and first time [s] of each kind.

    ``names`` holds the messages' names by identifier. The message "other" counts frames without a rule.
    """
    names = names | {0: "other"}
    messages = {}
    for identifier, state, counts, first_s in raw["rules"]:
        seen = [(kind, n, t) for kind, n, t in zip(EVENTS, counts, first_s, strict=False) if n]
        messages[names[identifier]] = {
            **({"state": SUPERVISION[state]} if identifier else {"bus_off": bool(state)}),
            "counts": {kind: n for kind, n, _ in seen},
            "first_s": {kind: t for kind, _, t in seen},
        }
    return {
        "send_failures": raw["send_failures"],
        "authentication": raw["authentication"],
        "messages": messages,
    }


def judged_spans(rows: np.ndarray) -> list[list[float]]:
    """Join the time spans [t0, t1] [s] of the counted frames, in order of time.

    ``rows`` (F,) is the simulator's table of frames with the fields reason, t_begin_s and t_end_s.
    """
    counted = rows[rows["reason"] <= 1]
    spans: list[list[float]] = []
    for begin, end in sorted(zip(counted["t_begin_s"].tolist(), counted["t_end_s"].tolist(), strict=False)):
        if spans and begin <= spans[-1][1]:
            spans[-1][1] = max(spans[-1][1], end)
        else:
            spans.append([begin, end])
    return spans


def overlap(spans: list[list[float]], start: float, end: float) -> float:
    """Total time [s] of the parts of ``spans`` between start and end [s]."""
    return round(sum(max(0.0, min(b, end) - max(a, start)) for a, b in spans), 6)


def missed(expect: Expectation, result: dict[str, Any], Ts_s: float) -> Iterator[str]:
    """Yield a sentence for each expectation of a scenario that a run did not meet."""
    first = result["first_invalid_s"]
    if expect.verdict == "never_invalid" and first is not None:
        yield f"invalid at {first:g} s"
    if expect.verdict == "invalid":
        if first is None:
            yield "never invalid"
        elif first < expect.fault_start_s:
            yield f"invalid at {first:g} s, before the fault"
        elif result["judged_to_invalid_s"] > expect.within_judged_s:
            yield f"invalid only after {result['judged_to_invalid_s']:g} s of judged driving"
    ratio = result["tracking_rms"] / result["command_rms"] if result["command_rms"] else 0.0
    if expect.tracking_ratio_max is not None and ratio > expect.tracking_ratio_max:
        yield f"tracking error is {ratio:.1%} of the command"
    yield from _supervision_missed(expect, result["supervision"], Ts_s)


def _supervision_missed(expect: Expectation, changes: list[list], Ts_s: float) -> Iterator[str]:
    """Yield a sentence for each expectation about the supervision that a run did not meet."""
    first_live = next((t for t, state in changes if state == "live"), None)
    if first_live is None:
        yield "supervision was never live"
        return
    left = [t for t, state in changes if t > first_live and state != "live"]
    reaction = expect.reaction_s(Ts_s)
    if reaction is None:
        if left:
            yield f"supervision left live at {left[0]:g} s"
        return
    start, deadline = reaction
    if left and left[0] < start:
        yield f"supervision left live at {left[0]:g} s, before the fault"
    elif not left or left[0] > deadline + 1e-9:
        yield f"supervision still live at {deadline:g} s"
    elif expect.fault_end_s is not None:
        at_deadline = [state for t, state in changes if t <= expect.fault_end_s + RECOVERY_S]
        if at_deadline[-1] != "live":
            yield f"supervision not live again at {expect.fault_end_s + RECOVERY_S:g} s"
