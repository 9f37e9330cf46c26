"""`lpvguard bench refine`: rounds of refinement over a simulated fleet with some worn vehicles.

`g80` simulates cars of drives/fixture.py, each with its own gain from tyres and load. `truck` simulates
trucks of firmware_sim/plant, each with its own loads, tyres, friction and brakes. The first identification
uses drives of one vehicle. In each round, every vehicle adds some drives. A person accepts all drives that
`refine` does not judge faulty. With ``--inspect``, the person also inspects vehicles with faulty drives, and
accepts the vehicles without wear. From then on a vehicle is judged beside its own gains.

The table counts drives before each round learns from them. Three counts are of healthy drives: those that
alarm, those that refute the certified model set, and those that alarm with an added gain fault. It also
counts worn drives that were learnt. The response or the brake of a worn vehicle falls from 1 to 0.7 over the
rounds.
"""

import tempfile
from collections.abc import Iterator
from dataclasses import asdict, dataclass, fields, replace
from functools import partial
from itertools import pairwise
from pathlib import Path
from typing import Any, Protocol

import numpy as np

from ...base.artefacts import write_files
from ...base.parallel import Map, workers
from ...core.compiled import is_alarming
from ...drives import fixture
from ...drives.faults import Fault, inject
from ...drives.tables import Experiment, index_text
from ...identify import identification as stage
from ...replay.replayer import Replayer
from ...vehicle.project import Project, load_project
from ..loop.generate import generate, truck_drive
from ..refine.decisions import Decisions, Evidence, decide
from ..refine.judgement import CERTIFICATE, HEALTHY
from ..refine.lineage import Lineage, compiled
from ..refine.proposals import FAULT as FAULTY
from ..refine.proposals import SPREAD
from ..refine.renewed import renew
from . import parser, require_at_least, show

FAULT = 0.7
"""Gain of the fault, and final gain of the worn vehicle."""
TAKEN_FOR_HEALTHY = 0.85
"""A worn drive with a gain below this value must not be learnt."""
WORN = "worn"
VARIATION = {
    "load_ratio": 0.2,
    "cornering_stiffness_front_ratio": 0.08,
    "cornering_stiffness_rear_ratio": 0.08,
    "brake_gain_ratio": 0.05,
}
"""Standard deviation of each property between trucks; the mean is 1."""
FARTHEST = 2.5
"""Largest deviation of a truck in these. The simulator refuses loads below 0.4."""
KNOWN_SPEEDS, SWEEPS_BAR = (8.1, 12.0, 17.0, 21.9), (0.24, 0.8, 2.1)
CALIBRATING_SPEEDS = (8.5, 9.5, 11.0, 13.0, 15.0, 17.0, 19.0, 21.0, 21.5)
PROGRAMMES = ("pulses", "telegraph", "multisine")


class Fleet(Protocol):
    """Kind of vehicle: its project, its known drives, and drives of any vehicle of the fleet."""

    project: Project

    def known(self, folder: Path, seed: int) -> None:
        """Write the drives of the first identification."""

    def drive(self, path: Path, own: np.random.Generator, gain: float, seconds: float, seed: int) -> None:
        """Write a drive of the vehicle with properties drawn by ``own``; ``gain`` multiplies its response."""


class Cars:
    """Cars that each have their own gain."""

    project = load_project("g80")

    def known(self, folder: Path, seed: int) -> None:
        """Write the drives of `lpvguard generate`."""
        generate(self.project, folder, seed)

    def drive(self, path: Path, own: np.random.Generator, gain: float, seconds: float, seed: int) -> None:
        """Write a drive with a mean speed from 7 to 15 m/s."""
        random = np.random.default_rng([seed])
        speed = float(random.uniform(7.0, 15.0))
        columns, _ = fixture.drive_columns(random, speed, seconds, self.project.Ts_s, None)
        columns["r"] = gain * (1 + 0.03 * own.standard_normal()) * columns["r"]
        write_files(path.parent, {path.name: fixture.csv_text(columns)})


def truck_variation(own: np.random.Generator) -> dict[str, float]:
    """Draw the properties of a truck, relative to the nominal ones."""
    return {
        key: 1 + sd * float(np.clip(own.standard_normal(), -FARTHEST, FARTHEST))
        for key, sd in VARIATION.items()
    }


class Trucks:
    """Trucks that differ by VARIATION; ``gain`` multiplies the brakes."""

    project = load_project("truck")

    def known(self, folder: Path, seed: int) -> None:
        """Write sweeps and manoeuvres of the truck of truck.toml."""
        folder.mkdir()
        plan = [("train", p, v, 180.0, 0.25, 1.0) for v in KNOWN_SPEEDS for p in PROGRAMMES]
        plan += [("sweep", "sweep", v, 299.0, u, u) for v in KNOWN_SPEEDS for u in SWEEPS_BAR]
        plan += [("valid", p, v, 180.0, 0.25, 1.0) for v in CALIBRATING_SPEEDS for p in PROGRAMMES[1:]]
        plan += [("noise", "zero", v, 240.0, 0.0, 0.0) for v in (12.0, 17.0)]
        rows = []
        for k, (split, programme, v, seconds, low, high) in enumerate(plan):
            path = folder / f"known_{k:02d}.csv"
            self._write(path, f"speed_profile = [[0.0, {v}]]", programme, seconds, low, high, 1000 * seed + k)
            rows.append((path.stem, split, programme))
        write_files(folder, {"experiments.csv": index_text(rows, "driver")})

    def drive(self, path: Path, own: np.random.Generator, gain: float, seconds: float, seed: int) -> None:
        """Write a drive with three speeds and one programme of the brakes."""
        variation = truck_variation(own)
        variation["brake_gain_ratio"] *= gain
        random = np.random.default_rng([seed])
        speeds = [float(v) for v in random.uniform(8.5, 21.5, 3)]
        profile = [[0.0, speeds[0]]]
        for part, (before, after) in enumerate(pairwise(speeds), start=1):
            profile += [[part * seconds / 3 - 10.0, before], [part * seconds / 3, after]]
        lines = [f"speed_profile = {profile}", "[plant.variation]"]
        lines += [f"{key} = {value:.6g}" for key, value in variation.items()]
        programme = str(random.choice(PROGRAMMES))
        self._write(path, "\n".join(lines), programme, seconds, 0.25, 1.0, seed)

    def _write(
        self, path: Path, plant: str, program: str, seconds: float, low: float, high: float, seed: int
    ) -> None:
        with tempfile.TemporaryDirectory() as scratch:
            scenario = Path(scratch) / "truck.toml"
            scenario.write_text(f"[plant]\n{plant}\n", encoding="utf-8")
            amplitudes = {"amplitude_low": low, "amplitude_high": high}
            truck_drive(path, scenario=scenario, program=program, duration=seconds, seed=seed, **amplitudes)


FLEETS: dict[str, Fleet] = {"g80": Cars(), "truck": Trucks()}


@dataclass(frozen=True)
class FleetSize:
    """Size of a fleet and its rounds, from the options of `main`."""

    vehicles: int
    worn: int
    drives: int
    rounds: int
    seconds: float
    inspect: bool = False


def _write_drive(
    fleet: Fleet, folder: Path, seconds: float, of_drive: tuple[str, list[int], float, int]
) -> None:
    name, own, gain, seed = of_drive
    fleet.drive(folder / f"{name}.csv", np.random.default_rng(own), gain, seconds, seed)


def fleet_drives(
    fleet: Fleet, folder: Path, size: FleetSize, turn: int, seed: int, run: Map = map
) -> dict[str, float]:
    """Write a round's drives, and return the gain by drive."""
    folder.mkdir()
    wear = np.linspace(1.0, FAULT, size.rounds * size.drives + 1)[1:]
    wear = wear[turn * size.drives : (turn + 1) * size.drives]
    rows, gain_of, drives = ["experiment,split,driver,vehicle"], {}, []
    for i in range(size.vehicles + size.worn):
        vehicle = f"car_{i:02d}" if i < size.vehicles else f"{WORN}_{i:02d}"
        for k in range(size.drives):
            name = f"{folder.name}_{vehicle}_{k}"
            gain_of[name] = float(wear[k]) if i >= size.vehicles else 1.0
            own = [59, seed, i]
            drive_seed = int(np.random.SeedSequence([seed, turn, i, k]).generate_state(1)[0])
            drives.append((name, own, gain_of[name], drive_seed))
            rows.append(f"{name},valid,human,{vehicle}")
    for _ in run(partial(_write_drive, fleet, folder, size.seconds), drives):
        pass
    write_files(folder, {"experiments.csv": "\n".join(rows) + "\n"})
    return gain_of


def _fault_found(replayer: Replayer, experiment: Experiment) -> bool:
    """Tell if a drive alarms with a gain fault from the first sample on."""
    drive = inject(
        replayer.read_file(experiment.path).drive, Fault("gain", FAULT), 0.0, replayer.project.Ts_s
    )
    return bool(is_alarming(replayer.replay(drive).run.verdict).any())


def _inspected(signed: Decisions, healthy: set[str]) -> Decisions:
    """Accept drives that were judged faulty if their vehicle is healthy, as an inspection would show."""
    drives = [
        replace(d, action=SPREAD, accept=True, why="inspected")
        if d.proposal == FAULTY and d.name in healthy
        else d
        for d in signed.drives
    ]
    return replace(signed, drives=drives)


def rounds(
    fleet: Fleet, scratch: Path, seed: int, size: FleetSize, run: Map = map
) -> Iterator[dict[str, Any]]:
    """Yield the results of each round of one fleet."""
    known = scratch / "known"
    folder = scratch / "identified"
    fleet.known(known, seed)
    stage.save(*stage.identify(fleet.project, known, workers=run), folder)
    for turn in range(size.rounds):
        new = scratch / f"round_{turn}"
        gain_of = fleet_drives(fleet, new, size, turn, seed, run)
        healthy = {name for name in gain_of if WORN not in name}
        lineage = Lineage.from_folder(folder, known if turn == 0 else None)
        evidence = Evidence.from_paths(lineage, [new], "vehicle")
        with (
            compiled(lineage.stored) as replayer,
            evidence.divided(lineage.own, fleet.project, scratch, run) as divided,
        ):
            drives = [e for e in divided.experiments if e.name in healthy]
            faults_found = sum(run(partial(_fault_found, replayer), drives))
        decisions, _ = decide(lineage, evidence, scratch, run)
        signed = decisions.accepting("bench", recentre=False)
        if size.inspect:
            signed = _inspected(signed, healthy)
        learnt = {d.name for d in signed.accepted}
        if learnt and turn + 1 < size.rounds:
            path, out = scratch / f"decisions_{turn}.toml", scratch / f"refined_{turn}"
            path.write_text(signed.text(), encoding="utf-8")
            renew(lineage, path, out, workers=run)
            folder = out
        refuted = [d.refutes for d in decisions.drives if d.name in healthy]
        worn = {n for n, gain in gain_of.items() if n not in healthy and gain < TAKEN_FOR_HEALTHY}
        yield {
            "healthy": len(healthy),
            "hours": len(healthy) * size.seconds / 3600,
            "false": sum(HEALTHY in statements for statements in refuted),
            "falsified": sum(CERTIFICATE in statements for statements in refuted),
            "faults_found": faults_found,
            "taken_for_faulty": sum(d.proposal == FAULTY and d.name in healthy for d in decisions.drives),
            "learnt": len(learnt & healthy),
            "worn_below": len(worn),
            "worn_learnt": len(learnt & worn),
        }


def words(result: dict[str, Any]) -> str:
    """Write the table."""
    lines = [
        f"{result['vehicle']}: {result['vehicles']} healthy vehicles and {result['worn']} worn, "
        f"{result['drives']} drives of {result['seconds']:g} s each a round, {len(result['seeds'])} fleets",
        f"{'round':>5} {'healthy':>8} {'hours':>6} {'false alarms':>13} {'falsified':>10} "
        f"{'faults found':>13} {'as faulty':>10} {'learnt':>7} {'worn < 0.85':>12} {'of these learnt':>16}",
    ]
    for i, r in enumerate(result["rounds"]):
        lines.append(
            f"{i + 1:>5} {r['healthy']:>8} {r['hours']:>6.1f} {r['false']:>13} {r['falsified']:>10} "
            f"{r['faults_found']:>13} {r['taken_for_faulty']:>10} {r['learnt']:>7} {r['worn_below']:>12} "
            f"{r['worn_learnt']:>16}"
        )
    return "\n".join(lines)


def main(argv: list[str]) -> None:
    """Run `lpvguard bench refine`."""
    arguments = parser("refine", __doc__)
    arguments.add_argument("--vehicle", choices=sorted(FLEETS), default="g80")
    arguments.add_argument("--vehicles", type=int, default=4, help="healthy vehicles")
    arguments.add_argument("--worn", type=int, default=1, help="vehicles that wear")
    arguments.add_argument("--drives", type=int, default=2, help="drives of each vehicle in a round")
    arguments.add_argument("--seconds", type=float, default=140.0, help="length of a drive")
    arguments.add_argument("--rounds", type=int, default=4)
    arguments.add_argument("--seeds", type=int, default=1, help="fleets")
    arguments.add_argument("--first-seed", type=int, default=0, help="seed of the first fleet")
    arguments.add_argument("--inspect", action="store_true", help="accept what did not wear")
    arguments.add_argument("--jobs", type=int, default=1, help="processes")
    options = arguments.parse_args(argv)
    require_at_least("refine", options, vehicles=1, worn=0, drives=1, rounds=1, seeds=1, seconds=120)
    size = FleetSize(**{field.name: getattr(options, field.name) for field in fields(FleetSize)})
    total = list[dict[str, Any]]()
    seeds = range(options.first_seed, options.first_seed + options.seeds)
    for seed in seeds:
        with tempfile.TemporaryDirectory() as scratch, workers(options.jobs) as run:
            for i, counts in enumerate(rounds(FLEETS[options.vehicle], Path(scratch), seed, size, run)):
                if i == len(total):
                    total.append(counts)
                else:
                    total[i] = {key: total[i][key] + counts[key] for key in counts}
    result = {"vehicle": options.vehicle, **asdict(size), "seeds": list(seeds), "rounds": total}
    show(words(result), result, options.json_out)
