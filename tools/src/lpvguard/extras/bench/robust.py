"""Compare certificates with the simulated truth.

The bench first tests the certified gain: it simulates random and worst stable Delta with the compiled
controller at several speeds. It then measures the simulated truck with sines over speed, amplitude and
frequency. It compares the margins of the loop with the measured response to the promised margins. It compares
the distance between the response and the nominal model with W_delta.
"""

from collections.abc import Iterator, Sequence
from dataclasses import asdict
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from ...base.parallel import Map, workers
from ...control import controller_file
from ...control.plants import design_settings
from ...control.robust_run import QUANTISATION, CompiledController, RobustRun, certified_runs
from ...control.true_loop import CertifiedLoop, MeasuredResponse, TrueLoop
from ...core.scheduled import Scheduled
from ...engine.synthesis.margins import NAMES, LoopMargins, shown
from ...identify import identification as identify
from ..loop.response import frequency_response
from ..loop.sim import Simulator, load_scenario
from . import numbers_of, parser, show

DRAWS = 500
SPEEDS = 12
OMEGA = np.concatenate([np.geomspace(0.02, 1.0, 20, endpoint=False), np.geomspace(1.0, 60.0, 72)])
"""Frequencies [rad/s] from below the steering task to the range of small loop gain, dense at the truck's
resonance."""
PROCESSES = 2
AMPLITUDES_BAR = (0.25, 0.5, 1.0, 2.0)
"""Default amplitudes, used if neither the command nor the project file states amplitudes."""


def main(argv: list[str]) -> None:
    """Run `lpvguard bench robust IDENTIFICATION DESIGN VEHICLE`."""
    arguments = parser("robust", __doc__)
    arguments.add_argument("identification", type=Path, help="folder written by identify")
    arguments.add_argument("design", type=Path, help="folder written by design")
    arguments.add_argument(
        "vehicle", type=Path, help="folder written by export with that design's controller"
    )
    arguments.add_argument("--draws", type=int, default=DRAWS, help="of Delta and input, all speeds together")
    arguments.add_argument(
        "--amplitudes",
        help="of the demand [bar], comma between; default: design.amplitudes of the project file, else "
        + ", ".join(f"{u:g}" for u in AMPLITUDES_BAR),
    )
    options = arguments.parse_args(argv)
    stored = identify.load(options.identification)
    document = controller_file.require_designed_for(stored, options.design / "controller.json")
    controller_file.require_exported_with(options.design / "controller.json", options.vehicle)
    schedule = Scheduled.read(document)
    demanded = amplitudes(options.amplitudes, design_settings(stored).amplitudes)
    runs = certified_runs(stored, document, CompiledController(options.vehicle), options.draws)
    empirical = Simulator(options.vehicle).run(load_scenario("nominal"))
    ratio = empirical["tracking_rms"] / empirical["command_rms"]
    with workers(PROCESSES) as run_all:
        table = true_table(CertifiedLoop(stored, schedule), demanded, run_all)
    show(
        "\n".join([*_run_lines(runs, ratio), *true_lines(table)]),
        {
            "kind": "robust",
            "schema": 1,
            "vehicle": stored.project.name,
            "coefficients_sha256": schedule.digest(),
            "linear": [asdict(r) | {"kept": r.kept} for r in runs],
            "nonlinear_tracking_ratio": ratio,
            **table,
        },
        options.json_out,
    )


def amplitudes(text: str | None, of_project: Sequence[float] | None) -> list[float]:
    """Choose the amplitudes [bar]: of ``--amplitudes``, else of the project file, else AMPLITUDES_BAR.

    Raises InputError unless all amplitudes are positive numbers.
    """
    if text is None:
        return list(of_project or AMPLITUDES_BAR)
    return numbers_of("robust", "--amplitudes", text, lambda u: 0 < u < np.inf, "positive numbers")


def true_table(
    loop: CertifiedLoop, demanded: Sequence[float], run_all: Map, tables: str = ""
) -> dict[str, Any]:
    """Compute the fields ``amplitudes``, ``promised``, ``true`` and ``beyond`` of robust.json.

    The table has SPEEDS speeds over the model's range, and each amplitude of ``demanded`` [bar]. ``tables``
    states the variation and the faults of the truck, as scenario tables.
    """
    speeds = np.linspace(*loop.model.speed_range, SPEEDS).tolist()
    plan = [(v, a, u) for v in speeds for a, u in zip(demanded, loop.amplitudes(v, demanded), strict=True)]
    loops = [loop.true(measured) for measured in run_all(partial(_measured, tables), plan)]
    rows = [_row(one) for one in loops]
    return {
        "amplitudes": list(demanded),
        "promised": [{"v_mps": v, "margins": _fields(loop.promised(v))} for v in speeds],
        "true": rows,
        "beyond": sum(d["ratio"] > 1 for row in rows for d in row["deviations"]),
    }


def _measured(tables: str, point: tuple[float, float, float]) -> MeasuredResponse:
    v, demanded, amplitude = point
    return MeasuredResponse(v, demanded, amplitude, *frequency_response(tables, v, amplitude, OMEGA))


def _fields(margins: LoopMargins | None) -> dict[str, Any] | None:
    """Value and place of each margin, None for an unstable loop; a value of None means unlimited."""
    if margins is None or not margins.stable:
        return None
    return {name: {"value": m.value, "omega_rad_s": m.omega} for name, m in margins.by_name.items()}


def _row(one: TrueLoop) -> dict[str, Any]:
    return {
        "v_mps": one.v,
        "asked": one.asked,
        "amplitude": one.amplitude,
        "unstable_poles": one.margins.unstable_poles,
        "margins": _fields(one.margins),
        "deviations": [
            {
                "output": d.output,
                "ratio": d.ratio,
                "omega_rad_s": d.omega,
                "delta": d.delta,
                "W_delta": d.W_delta,
            }
            for d in one.deviations
        ],
    }


def _run_lines(runs: list[RobustRun], ratio: float) -> Iterator[str]:
    yield (
        f"{'v m/s':>6}{'mu':>9}{'sampled':>9}{'worst':>9}{'rounding':>11}  "
        f"kept (quantisation term {QUANTISATION:g})"
    )
    for r in runs:
        yield (
            f"{r.v:6.1f}{r.bound:9.4f}{r.sampled:9.4f}{r.worst:9.4f}{r.rounding:11.2e}  "
            f"{'yes' if r.kept else 'NO'}"
        )
    yield (
        "nonlinear truck, scenario nominal (measured, not certified): "
        f"tracking error {ratio:.1%} of the command"
    )


def true_lines(table: dict[str, Any]) -> Iterator[str]:
    """Write both tables as text; mark an output whose distance from the nominal model exceeds W_delta."""
    yield ""
    yield "margins, promised for every vehicle within W_delta and true of the truck: gains as factors, phases"
    yield "in degrees, delay in ms, radii of disk margins, and gain and phase that the balanced disk covers"
    titles = ("gain up", "down", "phase", "delay", "Ms", "Mt", "disk S", "disk T", "disk", "gain", "phase")
    yield f"{'v m/s':>6}{'bar':>9}" + "".join(f"{title:>9}" for title in titles)
    promised = {row["v_mps"]: row["margins"] for row in table["promised"]}
    for v, held in promised.items():
        yield f"{v:6.2f}{'promised':>9}" + _numbers(held, "none: a vehicle within W_delta is unstable")
        for row in (r for r in table["true"] if r["v_mps"] == v):
            unstable = f"UNSTABLE: {row['unstable_poles']} poles"
            yield f"{v:6.2f}{row['amplitude']:9.3g}" + _numbers(row["margins"], unstable)
    yield ""
    yield "distance from the nominal model: where |delta| is largest beside W_delta"
    yield f"{'v m/s':>6}{'bar':>9}{'ratio':>9}{'|delta|':>9}{'W_delta':>9}{'rad/s':>9}  output"
    for row in table["true"]:
        for d in row["deviations"]:
            numbers = (d["ratio"], d["delta"], d["W_delta"], d["omega_rad_s"])
            yield (
                f"{row['v_mps']:6.2f}{row['amplitude']:9.3g}"
                + "".join(f" {x:8.3f}" for x in numbers)
                + f"  {d['output']}{'  BEYOND W_delta' if d['ratio'] > 1 else ''}"
            )


def _numbers(margins: dict[str, Any] | None, otherwise: str) -> str:
    if margins is None:
        return "  " + otherwise
    values = {name: margins[name]["value"] for name in NAMES}
    texts = ["-" if x is None or np.isinf(x) else f"{shown(name, x):.3f}" for name, x in values.items()]
    return "".join(f" {text:>8}" for text in texts)
