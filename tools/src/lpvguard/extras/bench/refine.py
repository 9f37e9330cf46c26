"""`lpvguard bench refine`: rounds of refinement over a synthetic fleet, one vehicle of which wears.

Each healthy vehicle has a gain of its own, as from tyres and load. In each round every vehicle gives some
drives. A person accepts all that `refine` does not take for a fault. The table counts healthy drives that
alarm and gain faults in them that do, with the core of each round. It also counts worn drives that were
learnt.
"""

import tempfile
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np

from ...base.artefacts import write_files
from ...core.compiled import ALARMING, VERDICTS
from ...drives import fixture
from ...drives.faults import Fault, inject
from ...drives.tables import list_experiments
from ...identify import identification as stage
from ...replay.replayer import Replayer
from ...vehicle.project import Project, load_project
from ..loop.generate import generate
from ..refine.decisions import Evidence, decide
from ..refine.lineage import Lineage, compiled
from ..refine.renewed import renew
from . import parser, require_at_least, show

FAULT = 0.7
"""Gain of the fault, and the gain to which the worn vehicle falls."""
TAKEN_FOR_HEALTHY = 0.85
"""A worn drive with a gain below this must not be learnt."""
DRIVE_S = 140.0
WORN = "worn"


def fleet_drives(
    project: Project, folder: Path, gains: dict[str, list[float]], seed: list[int]
) -> dict[str, float]:
    """Write a folder of drives of each vehicle with these gains; returns the gain by drive."""
    folder.mkdir()
    rows, gain_of = ["experiment,split,driver,vehicle"], {}
    for i, (vehicle, gains_of_vehicle) in enumerate(gains.items()):
        for k, gain in enumerate(gains_of_vehicle):
            name = f"{folder.name}_{vehicle}_{k}"
            random = np.random.default_rng([*seed, i, k])
            speed = float(random.uniform(7.0, 15.0))
            columns, _ = fixture.drive_columns(random, speed, DRIVE_S, project.Ts_s, None)
            columns["r"] = gain * columns["r"]
            write_files(folder, {f"{name}.csv": fixture.csv_text(columns)})
            rows.append(f"{name},valid,human,{vehicle}")
            gain_of[name] = gain
    write_files(folder, {"experiments.csv": "\n".join(rows) + "\n"})
    return gain_of


def alarms(replayer: Replayer, folder: Path, healthy: set[str]) -> dict[str, int]:
    """Healthy drives that alarm as they are, and with a gain fault from the first sample on."""
    alarming = [VERDICTS.index(v) for v in ALARMING]
    counts = {"healthy": 0, "false": 0, "faults_found": 0}
    for e in list_experiments(folder):
        if e.name in healthy:
            drive = replayer.read_file(e.path).drive
            faulty = inject(drive, Fault("gain", FAULT), 0.0, replayer.project.Ts_s)
            counts["healthy"] += 1
            for key, one in (("false", drive), ("faults_found", faulty)):
                counts[key] += bool(np.isin(replayer.replay(one).run.verdict, alarming).any())
    return counts


def rounds(
    project: Project, scratch: Path, seed: int, vehicles: int, drives: int, turns: int
) -> Iterator[dict[str, Any]]:
    """Results of each round of one fleet."""
    random = np.random.default_rng([59, seed])
    own = {f"car_{i:02d}": float(1 + 0.03 * random.standard_normal()) for i in range(vehicles)}
    generate(project, scratch / "known", seed=seed)
    stage.save(*stage.identify(project, scratch / "known"), scratch / "identified")
    folder, known = scratch / "identified", scratch / "known"
    wear = np.linspace(1.0, FAULT, turns * drives + 1)[1:]
    for turn in range(turns):
        gains = {name: [gain] * drives for name, gain in own.items()}
        gains[WORN] = wear[turn * drives : (turn + 1) * drives].tolist()
        new = scratch / f"round_{turn}"
        gain_of = fleet_drives(project, new, gains, [seed, turn])
        healthy = {name for name in gain_of if WORN not in name}
        lineage = Lineage.from_folder(folder, known if turn == 0 else None)
        with compiled(lineage.stored) as replayer:
            counted = alarms(replayer, new, healthy)
        decisions, _ = decide(lineage, Evidence.from_paths(lineage, [new], "vehicle"), scratch)
        signed = decisions.accepting("bench", recentre=False)
        learnt = {d.name for d in signed.accepted}
        if learnt:
            path, out = scratch / f"decisions_{turn}.toml", scratch / f"refined_{turn}"
            path.write_text(signed.text(), encoding="utf-8")
            renew(lineage, path, out)
            folder = out
        worn = {n for n, gain in gain_of.items() if n not in healthy and gain < TAKEN_FOR_HEALTHY}
        yield counted | {
            "learnt": len(learnt & healthy),
            "worn_below": len(worn),
            "worn_learnt": len(learnt & worn),
        }


def words(result: dict[str, Any]) -> str:
    """The table for people."""
    lines = [
        f"{result['vehicles']} healthy vehicles and a worn one, {result['drives']} drives each a round, "
        f"{len(result['seeds'])} fleets",
        f"{'round':>5} {'healthy':>8} {'false alarms':>13} {'faults found':>13} {'learnt':>7} "
        f"{'worn < 0.85':>12} {'of these learnt':>16}",
    ]
    for i, r in enumerate(result["rounds"]):
        lines.append(
            f"{i + 1:>5} {r['healthy']:>8} {r['false']:>13} {r['faults_found']:>13} {r['learnt']:>7} "
            f"{r['worn_below']:>12} {r['worn_learnt']:>16}"
        )
    return "\n".join(lines)


def main(argv: list[str]) -> None:
    """`lpvguard bench refine`."""
    arguments = parser("refine", __doc__)
    arguments.add_argument("--vehicles", type=int, default=4, help="healthy vehicles")
    arguments.add_argument("--drives", type=int, default=2, help="drives of each vehicle in a round")
    arguments.add_argument("--rounds", type=int, default=4)
    arguments.add_argument("--seeds", type=int, default=1, help="fleets")
    options = arguments.parse_args(argv)
    require_at_least("refine", options, vehicles=1, drives=1, rounds=1, seeds=1)
    project, total = load_project("g80"), list[dict[str, Any]]()
    for seed in range(options.seeds):
        with tempfile.TemporaryDirectory() as scratch:
            of_fleet = rounds(project, Path(scratch), seed, options.vehicles, options.drives, options.rounds)
            for i, counts in enumerate(of_fleet):
                if i == len(total):
                    total.append(counts)
                else:
                    total[i] = {key: total[i][key] + counts[key] for key in counts}
    result = {
        "vehicles": options.vehicles,
        "drives": options.drives,
        "seeds": list(range(options.seeds)),
        "rounds": total,
    }
    show(words(result), result, options.json_out)
