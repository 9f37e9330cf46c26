"""Run the closed loop of trucks that differ from the nominal truck in one property, over speed and seeds.

In every run, the compiled controller follows the command of the steering task, 0.02 to 1 rad/s. The table
shows the worst run of each truck, and contradictions to a certificate (loop/campaign/conduct.py). A
contradiction is a steady oscillation of the demand above the commanded band, or a demand that stays at its
limit. A third contradiction is an error beyond the allowed share of the command.
"""

import tempfile
from collections.abc import Iterator, Sequence
from functools import lru_cache, partial
from pathlib import Path
from typing import Any

import numpy as np

from ...base.parallel import Map, workers
from ..loop.campaign.conduct import (
    LEAST_BAR,
    SATURATED_S,
    STEERING_RADPS,
    TRACKED,
    TRACKED_WEAK,
    WEAK_BRAKES,
    steady_line,
)
from ..loop.campaign.faults import VARIATION
from ..loop.campaign.one_run import limited_stretch
from ..loop.campaign.scenarios import STEERING_RMS, Command, Drawn
from ..loop.sim import Simulator
from . import numbers_of, parser, show

TRUCKS = (
    *(("brake_gain_ratio", x) for x in (0.75, 0.85, 0.95, 1.0, 1.05, 1.15, 1.25)),
    *(("extra_brake_delay_s", x) for x in (0.01, 0.02, 0.03)),
    *(("load_ratio", x) for x in (0.8, 0.9, 1.1, 1.2)),
)
"""Changed property, as in a scenario file, and its value."""
SPEEDS, SEEDS = tuple(float(v) for v in range(8, 23)), (1, 2, 3)
"""Speeds in m/s."""
PROCESSES = 2


def main(argv: list[str]) -> None:
    """Run `lpvguard bench steer VEHICLE`."""
    arguments = parser("steer", __doc__)
    arguments.add_argument("vehicle", type=Path, help="folder written by export with a controller")
    arguments.add_argument("--speeds", help="m/s, comma between; default: 8 to 22 in steps of 1")
    arguments.add_argument("--seeds", help="of noise, road and wind, comma between; default: 1,2,3")
    options = arguments.parse_args(argv)
    speeds = _numbers("--speeds", options.speeds, SPEEDS)
    seeds = [int(x) for x in _numbers("--seeds", options.seeds, SEEDS, whole=True)]
    with workers(PROCESSES) as run_all:
        rows = list(steered(options.vehicle, TRUCKS, speeds, seeds, run_all))
    show("\n".join(lines(rows)), {"runs": rows}, options.json_out)


def _numbers(
    option: str, text: str | None, otherwise: Sequence[float], *, whole: bool = False
) -> list[float]:
    """Read the numbers of an option; raise InputError unless all are finite, >= 0 and, if asked, whole."""
    if text is None:
        return list(otherwise)
    kind = "whole numbers" if whole else "numbers"
    return numbers_of(
        "steer",
        option,
        text,
        lambda x: 0 <= x < np.inf and (x.is_integer() or not whole),
        f"{kind} from 0 on",
    )


def steered(
    vehicle: Path,
    trucks: Sequence[tuple[str, float]],
    speeds: Sequence[float],
    seeds: Sequence[int],
    run_all: Map = map,
) -> Iterator[dict[str, Any]]:
    """Yield a row for each run: the changed property, speed [m/s], seed, and results of `_row`."""
    points = [(key, x, v, seed) for key, x in trucks for v in speeds for seed in seeds]
    return run_all(partial(_row, vehicle.resolve()), points)


@lru_cache(maxsize=1)
def _simulator(vehicle: Path) -> Simulator:
    return Simulator(vehicle)


def _row(vehicle: Path, point: tuple[str, float, float, int]) -> dict[str, Any]:
    """Make a row of the table.

    ``tracking`` is the rms error of the yaw rate divided by the command's rms. ``limited_s`` is the longest
    time of the demand at its limit. ``line_bar`` and ``line_radps`` describe a steady oscillation of the
    demand. ``falsified`` lists the contradictions to a certificate.
    """
    key, value, v, seed = point
    simulator = _simulator(vehicle)
    command = Command.multisine("log", 0.02, STEERING_RADPS, size=STEERING_RMS)
    text = Drawn([(0.0, v)], command, 0.0, seed).text(f"{VARIATION}{key} = {value:.6g}\n", STEERING_RMS)
    with tempfile.TemporaryDirectory() as scratch:
        path = Path(scratch) / "scenario.toml"
        path.write_text(text, encoding="utf-8")
        facts, drive = simulator.drive(path)
    tracking = facts["tracking_rms"] / facts["command_rms"]
    limited = limited_stretch(simulator, drive)
    line = steady_line(drive.u[:, 0], simulator.project.Ts_s, command.highest)
    weak = key == "brake_gain_ratio" and value < WEAK_BRAKES
    did = {
        "oscillates": line.bar >= LEAST_BAR,
        "saturates": limited >= SATURATED_S,
        "loses track": tracking > (TRACKED_WEAK if weak else TRACKED),
    }
    return {
        "differs": key,
        "value": value,
        "v_mps": v,
        "seed": seed,
        "tracking": tracking,
        "limited_s": limited,
        "line_bar": line.bar,
        "line_radps": line.radps,
        "falsified": [what for what, true in did.items() if true],
    }


def lines(rows: Sequence[dict[str, Any]]) -> Iterator[str]:
    """Write the worst run of each truck, then every run that contradicts a certificate."""
    titles = f"{'differs':<20}{'value':>7}{'runs':>6}"
    yield titles + f"{'tracking':>10}{'at limit s':>12}{'line bar':>10}  ruled out"
    trucks = dict.fromkeys((row["differs"], row["value"]) for row in rows)
    for key, value in trucks:
        members = [row for row in rows if (row["differs"], row["value"]) == (key, value)]
        worst = [max(row[name] for row in members) for name in ("tracking", "limited_s", "line_bar")]
        yield (
            f"{key:<20}{value:>7g}{len(members):>6}{worst[0]:>10.1%}{worst[1]:>12.2f}{worst[2]:>10.2f}"
            f"  {sum(bool(row['falsified']) for row in members)}"
        )
    bad = [row for row in rows if row["falsified"]]
    for row in bad:
        yield (
            f"{', '.join(row['falsified'])}: {row['differs']} {row['value']:g}, {row['v_mps']:g} m/s, "
            f"seed {row['seed']}: tracking {row['tracking']:.1%}, {row['limited_s']:.2f} s at the limit, "
            f"line {row['line_bar']:.2f} bar at {row['line_radps']:.3g} rad/s"
        )
    yield f"{len(bad)} of {len(rows)} runs show what a certificate rules out"
