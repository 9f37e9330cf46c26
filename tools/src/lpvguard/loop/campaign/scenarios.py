"""The plan of a campaign: every run's number, truck and fault, and the scenario file of a run. What is drawn
depends on the seed and the number of the run alone."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from . import faults
from .faults import VARIATION

DURATION_S = 180.0
"""As long as the calibration drives of `generate`: a rate per drive means the same."""
FIRST_FAULT = 1_000_000
"""Number of the first run with a fault: what is drawn for it does not depend on the hours within."""


@dataclass(frozen=True)
class PlannedRun:
    """One run. ``plant``: index of the truck of group "within", -1 elsewhere; ``tables``: its fault or
    variation."""

    number: int
    kind: str
    severity: float
    plant: int
    fault_s: float
    tables: str


@dataclass(frozen=True)
class Size:
    """How much: hours of driving within the bounds, runs of each severity of each kind."""

    hours: float
    repeats: int


def plan(size: Size, variations: list[str]) -> list[PlannedRun]:
    """All runs, in the order of their numbers."""
    runs = int(np.ceil(size.hours * 3600 / DURATION_S))
    within = [
        PlannedRun(n, "within", 0.0, n % len(variations), 0.0, variations[n % len(variations)])
        for n in range(runs)
    ]
    chosen = [(kind, x) for kind in faults.KINDS for x in kind.values for _ in range(size.repeats)]
    return within + [
        PlannedRun(FIRST_FAULT + n, kind.name, x, -1, kind.from_s, kind.text(x))
        for n, (kind, x) in enumerate(chosen)
    ]


def draw_variation(seed: int, candidate: int) -> str:
    """A truck that differs from truck.toml in everything that a fleet's trucks differ in, some little, some
    much."""
    random = np.random.default_rng([seed, 1, candidate])
    reach = {
        "load_ratio": 0.2,
        "cg_shift_m": 0.15,
        "cg_height_ratio": 0.15,
        "friction_left_ratio": 0.15,
        "cornering_stiffness_front_ratio": 0.1,
        "cornering_stiffness_rear_ratio": 0.1,
        "brake_gain_ratio": 0.15,
        "brake_lag_ratio": 0.3,
        "extra_brake_delay_s": 0.02,
    }
    size = random.uniform(0.2, 1.0)
    drawn = {key: size * random.uniform(-most, most) for key, most in reach.items()}
    drawn = {key: x + 1.0 if key.endswith("ratio") else x for key, x in drawn.items()}
    drawn["extra_brake_delay_s"] = abs(drawn["extra_brake_delay_s"])
    drawn["friction_right_ratio"] = drawn["friction_left_ratio"]
    return VARIATION + "".join(f"{key} = {value:.6g}\n" for key, value in drawn.items())


def scenario_text(seed: int, planned: PlannedRun) -> str:
    """The scenario file of a run: speed and command drawn, so that the demand stays within what the bounds
    were made from."""
    random = np.random.default_rng([seed, 2, planned.number])
    profile = speed_profile(random)
    demand_bar = random.uniform(0.1, 0.3) if planned.plant >= 0 else random.uniform(0.3, 0.7)
    yaw_rate = 1.94 / max(v for _, v in profile) * demand_bar  # Table I's gain at DC
    command = (
        'kind = "multisine"\nspacing = "log"\nlow_radps = 0.5\nhigh_radps = 4.0\nrms_radps = {r:.6g}',
        'kind = "multisine"\nspacing = "linear"\nlow_radps = 0.05\nhigh_radps = 2.0\nrms_radps = {r:.6g}',
        'kind = "steps"\namplitude_radps = {r:.6g}\nperiod_s = {p:.6g}',
    )[random.integers(3)]
    return (
        f"duration_s = {DURATION_S:g}\nseed = {random.integers(1 << 31)}\n[command]\n"
        + command.format(r=yaw_rate, p=random.uniform(5.0, 12.0))
        + "\n[plant]\nspeed_profile = ["
        + ", ".join(f"[{t:.6g}, {v:.6g}]" for t, v in profile)
        + "]\n"
        + planned.tables
    )


def speed_profile(random: np.random.Generator) -> list[tuple[float, float]]:
    """Knots (time [s], speed [m/s]) of a random speed profile.

    The speed is constant, drifts by at most 3 m/s, or is swept to the farther end of the range and back at
    0.05 to 0.3 m/s2.
    """
    first = random.uniform(9.0, 21.0)
    manner = random.integers(5)
    if manner < 2:
        return [(0.0, first)]
    if manner < 4:
        return [
            (0.0, first),
            (40.0, first),
            (150.0, float(np.clip(first + random.uniform(-3.0, 3.0), 8.5, 21.5))),
        ]
    end = 21.0 if first < 15.0 else 9.0
    takes_s = abs(end - first) / random.uniform(0.05, 0.3)
    return [(0.0, first), (20.0, first), (20.0 + takes_s, end), (20.0 + 2.0 * takes_s, first)]
