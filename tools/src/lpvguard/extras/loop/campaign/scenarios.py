"""Plan a campaign: number, truck, fault and scenario file of every run.

The random numbers of a run depend only on the seed and on the number of the run.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ....vehicle.nominal import NominalModel
from ....vehicle.project import Way
from . import faults
from .conduct import LEAST_BAR, STEERING_RADPS
from .faults import VARIATION

DURATION_S = 180.0
"""Duration of a run, equal to the calibration drives of `generate`, so that rates per drive are
comparable."""
FIRST_FAULT = 1_000_000
"""Number of the first run with a fault. The random numbers of faults thus do not depend on the hours
"within"."""
SPEEDS = (8.1, 21.9)
"""[m/s] Speeds of the runs. With noise, the wheel speeds must stay within the controller's range 8 to 22."""
STEERING_RMS = 0.05
"""[rad/s] Rms of the steering task's command, before any reduction to the truck's limit."""
HIGHEST_COMMAND_RADPS = 4.0
FAULT_BAR = 0.9
"""Least peak demand of runs with a fault, so that the fault can show."""
ROOM = 0.85
"""Share of the controller's limit that a command may need. The rest is for road, wind and noise. A
certificate only covers the loop within its limits."""
UNIT = 0.05
"""[rad/s] Size of a command for which the demand is computed."""
REFERENCE_RADPS = 3.0
"""Frequency of the simulator's reference model 9 / (s^2 + 5.4 s + 9) (firmware_sim/sim/command.hpp)."""


@dataclass(frozen=True)
class PlannedRun:
    """Plan of one run.

    ``plant`` is the index of a truck of the group "within", and -1 for other runs. ``tables`` state the fault
    or the variation. ``gain`` is the least gain of a truck within the bounds, divided by the nominal gain.
    ``way`` is the way in which the fault begins.
    """

    number: int
    kind: str
    severity: float
    plant: int
    fault_s: float
    tables: str
    gain: float = 1.0
    way: Way = "start"


@dataclass(frozen=True)
class Size:
    """Size of a campaign.

    Attributes
    ----------
    hours : float, h of driving within the bounds
    repeats : int
    """

    hours: float
    repeats: int


def plan(size: Size, trucks: list[tuple[str, float]]) -> list[PlannedRun]:
    """Plan all runs, in the order of their numbers; ``trucks`` holds tables and least gains "within"."""
    runs = int(np.ceil(size.hours * 3600 / DURATION_S))
    within = [
        PlannedRun(n, "within", 0.0, n % len(trucks), 0.0, *trucks[n % len(trucks)]) for n in range(runs)
    ]
    chosen = [(kind, x) for kind in faults.KINDS for x in kind.values for _ in range(size.repeats)]
    # All faults with their first way come first, so that further ways do not change the numbers of the runs.
    ordered = [(kind, x, kind.ways[0]) for kind, x in chosen]
    ordered += [(kind, x, way) for n in (1, 2) for kind, x in chosen for way in kind.ways[n : n + 1]]
    return within + [
        PlannedRun(FIRST_FAULT + n, kind.name, x, -1, kind.from_s(way), kind.text(x, way), way=way)
        for n, (kind, x, way) in enumerate(ordered)
    ]


def draw_variation(seed: int, candidate: int) -> str:
    """Draw a truck that differs from truck.toml, by small or large amounts, in all properties of a fleet."""
    random = np.random.default_rng([seed, 1, candidate])
    reach = {
        "load_ratio": 0.2,
        "cg_shift_m": 0.15,
        "cg_height_ratio": 0.15,
        "friction_left_ratio": 0.15,
        "cornering_stiffness_front_ratio": 0.1,
        "cornering_stiffness_rear_ratio": 0.1,
        "brake_gain_ratio": 0.25,
        "brake_lag_ratio": 0.3,
        "extra_brake_delay_s": 0.03,
    }
    size = random.uniform(0.2, 1.0)
    drawn = {key: size * random.uniform(-most, most) for key, most in reach.items()}
    drawn = {key: x + 1.0 if key.endswith("ratio") else x for key, x in drawn.items()}
    drawn["extra_brake_delay_s"] = abs(drawn["extra_brake_delay_s"])
    drawn["friction_right_ratio"] = drawn["friction_left_ratio"]
    return VARIATION + "".join(f"{key} = {value:.6g}\n" for key, value in drawn.items())


@dataclass(frozen=True)
class Command:
    """Yaw-rate command without its size; the size is the rms of a multisine or the amplitude of steps.

    Attributes
    ----------
    keys : str, keys of a scenario file
    highest : float, rad/s, upper end of the commanded band; for steps, that of the reference model
    size : float or None, rad/s, own size of the command
    """

    keys: str
    highest: float
    size: float | None = None

    @classmethod
    def multisine(cls, spacing: str, low: float, high: float, size: float | None = None) -> Command:
        """Make a multisine between two frequencies [rad/s] with "linear" or "log" spacing."""
        keys = f'kind = "multisine"\nspacing = "{spacing}"\nlow_radps = {low:g}\nhigh_radps = {high:g}\n'
        return cls(keys + "rms_radps", high, size)

    @classmethod
    def steps(cls, period_s: float) -> Command:
        """Make steps from side to side, two per period."""
        return cls(f'kind = "steps"\nperiod_s = {period_s:.6g}\namplitude_radps', REFERENCE_RADPS)


@dataclass(frozen=True)
class Drawn:
    """Randomly drawn properties of a run.

    Attributes
    ----------
    profile : list of (time [s], speed [m/s]), knots
    command : Command
    demand_bar : float, bar, peak demand of the nominal truck
    seed : int, seed of noise, road and wind
    """

    profile: list[tuple[float, float]]
    command: Command
    demand_bar: float
    seed: int

    @classmethod
    def for_run(cls, limit_bar: float, seed: int, planned: PlannedRun) -> Drawn:
        """Draw the properties from the campaign's seed and the run's number.

        The truck's peak demand lies between LEAST_BAR (FAULT_BAR with a fault) and the share ROOM of the
        controller's limit ``limit_bar``. The demand then stays within the checked amplitudes and the limits.
        """
        random = np.random.default_rng([seed, 2, planned.number])
        profile = speed_profile(random)
        command = _command(random, planned.plant >= 0)
        least, most = LEAST_BAR if planned.plant >= 0 else FAULT_BAR, ROOM * limit_bar
        demand = float(np.exp(random.uniform(np.log(least), np.log(most))))
        if command.size is not None:
            demand = most
        return cls(profile, command, planned.gain * demand, int(random.integers(1 << 31)))

    def size(self, model: NominalModel, unit: np.ndarray, Ts: float) -> float:
        """Compute the size of the command [rad/s] for which the nominal truck needs ``demand_bar``.

        The command's own size is an upper limit. The amplitude of the demand (sqrt 2 times its rms, as in the
        bounds) is at least LEAST_BAR. ``unit`` (N,) is the reference model's response to this command at size
        UNIT [rad/s], every ``Ts`` [s]. The truck follows this response up to HIGHEST_COMMAND_RADPS, at every
        speed of the run.
        """
        spectrum = np.fft.rfft(unit)
        omega = 2 * np.pi * np.arange(len(spectrum)) / (len(unit) * Ts)
        followed = omega[omega <= HIGHEST_COMMAND_RADPS]
        speeds = [v for _, v in self.profile]
        needed, amplitude = 0.0, np.inf
        for v in np.linspace(min(speeds), max(speeds), 5):
            P = model.frequency_response(followed, float(v))[:, 0, 0]
            demand = np.fft.irfft(spectrum[: len(followed)] / P, len(unit))
            needed = max(needed, float(np.abs(demand).max()))
            amplitude = min(amplitude, float(np.sqrt(2 * np.mean(demand**2))))
        size = max(self.demand_bar / needed, LEAST_BAR / amplitude) * UNIT
        return size if self.command.size is None else min(size, self.command.size)

    def text(self, tables: str, size: float) -> str:
        """Write a scenario file with ``tables`` of faults and variation; the command has ``size`` [rad/s]."""
        knots = ", ".join(f"[{t:.6g}, {v:.6g}]" for t, v in self.profile)
        return (
            f"duration_s = {DURATION_S:g}\nseed = {self.seed}\n[command]\n{self.command.keys} = {size:.6g}\n"
            f"[plant]\nspeed_profile = [{knots}]\n{tables}"
        )


def _command(random: np.random.Generator, within: bool) -> Command:
    """Draw the command of a run; trucks ``within`` the bounds also get commands of the steering task.

    Steps of trucks within the bounds are slow enough to be tracked. Steps of trucks with faults keep the
    monitor's frames excited.
    """
    wide = (
        Command.multisine("linear", 0.05, 2.0),
        Command.multisine("log", 0.5, HIGHEST_COMMAND_RADPS),
        Command.steps(random.uniform(*(12.0, 40.0) if within else (5.0, 12.0))),
    )
    steering = (
        Command.multisine("linear", 0.02, STEERING_RADPS, size=STEERING_RMS),
        Command.multisine("linear", 0.02, STEERING_RADPS),
    )
    chosen = (*steering, *wide) if within else wide
    return chosen[random.integers(len(chosen))]


def speed_profile(random: np.random.Generator) -> list[tuple[float, float]]:
    """Draw the knots (time [s], speed [m/s]) of a random speed profile.

    The speed is constant, or drifts by at most 3 m/s, or moves to the farther end of the range and back. This
    last movement has an acceleration of 0.05 to 0.3 m/s2.
    """
    slowest, fastest = SPEEDS
    first = random.uniform(slowest, fastest)
    manner = random.integers(5)
    if manner < 2:
        return [(0.0, first)]
    if manner < 4:
        return [
            (0.0, first),
            (40.0, first),
            (150.0, float(np.clip(first + random.uniform(-3.0, 3.0), slowest, fastest))),
        ]
    end = fastest if first < 0.5 * (slowest + fastest) else slowest
    takes_s = abs(end - first) / random.uniform(0.05, 0.3)
    return [(0.0, first), (20.0, first), (20.0 + takes_s, end), (20.0 + 2.0 * takes_s, first)]
