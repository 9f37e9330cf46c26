"""Compare the time of a vehicle's whole chain with one synthesis by a public package, in the same run.

The chain has three stages: identification from the drives, the frozen design with its proofs of mu, and the
generated C code with repeated proofs. The bench compares their total time with one K_i synthesis of the
paper's case by dkpy. The search for a proof at a moving speed has a separate row and is not in the total. The
processors of the machine share drives and speeds, like the commands with `--jobs`. dkpy uses one processor.
The result is the ratio of waiting times. Other work on the machine increases both times, so the table also
has the ratio of processor seconds.
"""

import os
import tempfile
import time
from collections.abc import Callable
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

from ...base.parallel import Map, workers
from ...control import design
from ...control.controller_export import export_chosen
from ...control.moving_speed import moving_certificates
from ...control.plants import DesignProblem
from ...engine.synthesis.cases import case_plant, read_case
from ...identify import identification as identify
from ...vehicle.project import load_project
from . import parser, show
from ._peers import Peers
from .synthesis import PEER_SCRIPT, judged, question

WANTED = 2.0
"""Wanted ratio of the chain's time to the time of the peer's synthesis, by the clock."""
PEER_LIMIT_S = 3600.0


@dataclass(frozen=True)
class Stage:
    """Time of a stage by the clock and in processor seconds, children included.

    ``summed`` tells that the stage counts in the total of the chain.
    """

    name: str
    seconds: float
    processor: float
    summed: bool = True


def main(argv: list[str]) -> None:
    """Run `lpvguard bench chain DRIVES CASE`."""
    arguments = parser("chain", __doc__)
    arguments.add_argument("drives", type=Path, help="folder of drives with experiments.csv")
    arguments.add_argument("case", type=Path, help="the paper case, tests/data/paper_case.toml")
    arguments.add_argument("--vehicle", default="truck", help="shipped vehicle, or path to a project file")
    arguments.add_argument("--moving", action="store_true", help="search the proof at a moving speed too")
    arguments.add_argument("--jobs", type=int, default=len(os.sched_getaffinity(0)), help="processes")
    arguments.add_argument("--peers", type=Path, help="folder for the peers' environment, made when missing")
    options = arguments.parse_args(argv)
    with workers(options.jobs) as run:
        stages, worst = chain(options.vehicle, options.drives, options.moving, run)
    peer = synthesis_by_peer(options.case, Peers(options.peers))
    show(table(stages, worst, peer), as_dict(stages, worst, peer), options.json_out)


def chain(vehicle: str, drives: Path, moving: bool, run: Map = map) -> tuple[list[Stage], float]:
    """Run the stages of a vehicle (name or project file) and return them with the largest proved mu.

    ``moving`` adds the search for a proof at a moving speed. ``run`` maps over the workers.
    """
    project, stages = load_project(vehicle), []

    def timed(name: str, job: Callable[[], Any], summed: bool = True) -> Any:
        clock, busy = time.perf_counter(), _processor()
        result = job()
        stages.append(Stage(name, time.perf_counter() - clock, _processor() - busy, summed))
        return result

    with tempfile.TemporaryDirectory() as folder:
        identified, designed = Path(folder) / "identify", Path(folder) / "design"
        timed(
            "identification",
            lambda: identify.save(*identify.identify(project, drives, workers=run), identified),
        )
        stored = identify.load(identified)
        result = timed(
            "frozen design and proofs", lambda: design.design(stored, moving_speed=False, workers=run)
        )
        design.save(result, stored, designed)
        timed(
            "C, proved anew", lambda: export_chosen(stored, Path(folder) / "vehicle", designed, workers=run)
        )
        if moving:
            loop = DesignProblem.from_identification(stored), result.schedule, result.scaling
            timed("moving speed", lambda: moving_certificates(*loop, workers=run), False)
    return stages, result.worst


def synthesis_by_peer(case_path: Path, peers: Peers) -> dict:
    """Synthesise K_i of the case with dkpy.

    The result has "seconds", "processor", "claimed", "level", "order" and "note", or only "note" with the
    reason for a missing result.
    """
    case = read_case(case_path)
    plant = case_plant(case, case["objective"][0], "K_i")
    answer = peers.ask(PEER_SCRIPT, question(plant), PEER_LIMIT_S)
    verdict = judged(answer, plant)
    return verdict | {key: answer[key] for key in ("processor",) if key in answer}


def ratios(stages: list[Stage], peer: dict) -> tuple[float, float] | None:
    """Ratio of the chain's time to the peer's, by the clock and by the processor; None without a peer."""
    if "processor" not in peer:
        return None
    summed = [stage for stage in stages if stage.summed]
    clock, processor = sum(s.seconds for s in summed), sum(s.processor for s in summed)
    return clock / peer["seconds"], processor / peer["processor"]


def table(stages: list[Stage], worst: float, peer: dict) -> str:
    """Write the rows as text."""

    def row(name: str, seconds: float, processor: float, note: str = "") -> str:
        return f"{name:34}{seconds:>10.1f}{processor:>12.1f}   {note}".rstrip()

    summed = [stage for stage in stages if stage.summed]
    lines = [f"{'stage':34}{'clock s':>10}{'processor s':>12}"]
    lines += [row(s.name, s.seconds, s.processor, "" if s.summed else "not in the sum") for s in stages]
    whole = sum(s.seconds for s in summed), sum(s.processor for s in summed)
    lines.append(row("chain", *whole, f"worst mu {worst:.4f}"))
    both = ratios(stages, peer)
    if both is None:
        return "\n".join([*lines, f"dkpy, K_i of the paper's case: {peer['note']}"])
    lines.append(
        row("dkpy, K_i of the paper's case", peer["seconds"], peer["processor"], f"mu {peer['level']:.4f}")
    )
    clock, processor = both
    lines.append(f"ratio of seconds {clock:.2f} (wanted {WANTED:g}), of processor seconds {processor:.2f}")
    return "\n".join(lines)


def as_dict(stages: list[Stage], worst: float, peer: dict) -> dict:
    """Numbers for ``--json``."""
    both = ratios(stages, peer)
    return {
        "stages": [asdict(stage) for stage in stages],
        "worst_mu": worst,
        "peer": peer,
        "ratio": None if both is None else both[0],
        "ratio_processor": None if both is None else both[1],
        "wanted": WANTED,
        "ok": None if both is None else both[0] <= WANTED,
    }


def _processor() -> float:
    """Processor seconds of this process and of its children that still run or were waited for."""
    below: dict[int, list[int]] = {}
    ticks: dict[int, int] = {}
    for stat in Path("/proc").glob("[0-9]*/stat"):
        try:
            fields = stat.read_text().rsplit(")", 1)[1].split()
        except OSError:
            continue  # it ended meanwhile
        process = int(stat.parent.name)
        below.setdefault(int(fields[1]), []).append(process)
        ticks[process] = sum(map(int, fields[11:15]))
    whole, rest = 0, [os.getpid()]
    while rest:
        process = rest.pop()
        whole += ticks.get(process, 0)
        rest += below.get(process, [])
    return whole / os.sysconf("SC_CLK_TCK")
