"""The certified gain, run: sampled and worst stable Delta with the compiled controller at several speeds;
and, apart, what the same controller does on the nonlinear truck, where nothing is certified.
"""

from __future__ import annotations

from dataclasses import asdict
from pathlib import Path

from ..base import artefacts
from ..control import design
from ..control.plants import frozen_plant
from ..control.robust_run import QUANTISATION, CompiledController, run
from ..core.scheduled import Scheduled
from ..engine.synthesis.dk import certify
from ..identify import run as identify
from ..loop.sim import Simulator, load_scenario
from . import parser, show

DRAWS = 500


def main(argv: list[str]) -> None:
    """`lpvguard bench robust IDENTIFICATION DESIGN VEHICLE`."""
    options = parser("robust", __doc__)
    options.add_argument("identification", type=Path, help="folder written by identify")
    options.add_argument("design", type=Path, help="folder written by design")
    options.add_argument("vehicle", type=Path, help="folder written by export with that design's controller")
    options.add_argument("--draws", type=int, default=DRAWS, help="of Delta and input, all speeds together")
    given = options.parse_args(argv)
    artefacts.read_manifest(given.design, "design")
    stored, document = (
        identify.load(given.identification),
        artefacts.read_json(given.design / "controller.json"),
    )
    schedule, compiled = Scheduled.read(document), CompiledController(given.vehicle)
    speeds = schedule.speeds[:: max(1, (len(schedule.speeds) - 1) // 3)]
    rows = []
    for k, v in enumerate(map(float, speeds)):
        plant = frozen_plant(stored, v)
        scaling = design.stated_scaling(document) if plant.blocks else None
        proved = certify(plant, schedule.at(v), scaling)
        rows.append(
            run(
                compiled,
                plant,
                schedule.at(v),
                v,
                proved,
                -(-given.draws // len(speeds)),
                stored.project.seed + k,
            )
        )
    empirical = Simulator(given.vehicle).run(load_scenario("nominal"))
    ratio = empirical["tracking_rms"] / empirical["command_rms"]
    lines = [
        f"{'v m/s':>6}{'mu':>9}{'sampled':>9}{'worst':>9}{'rounding':>11}  "
        f"kept (quantisation term {QUANTISATION:g})"
    ]
    lines += [
        f"{r.v:6.1f}{r.bound:9.4f}{r.sampled:9.4f}{r.worst:9.4f}{r.rounding:11.2e}  "
        f"{'yes' if r.kept else 'NO'}"
        for r in rows
    ]
    lines.append(
        "nonlinear truck, scenario nominal (measured, not certified): "
        f"tracking error {ratio:.1%} of the command"
    )
    show(
        "\n".join(lines),
        {"linear": [asdict(r) | {"kept": r.kept} for r in rows], "nonlinear_tracking_ratio": ratio},
        given.json_out,
    )
