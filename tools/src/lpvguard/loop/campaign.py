"""`lpvguard campaign`: Monte Carlo over the closed loop of the simulated truck, which scores the monitor and
the baselines.

Two groups of runs of DURATION_S each, every one a scenario of its own drawn from (campaign seed, number of
the run):

    within   trucks that vary in load, CG, tyres, brakes and friction, and whose own frequency response lies
             within the bounds; any alarm is false while the demand stays within the amplitude that the
             response was checked for
    faults   KINDS: one fault or variation, of the truck, of the bus, or of both at once, at several
             severities

Within: G is the truck's measured response to sines of RESPONSE_AMPLITUDES_BAR, at the bins and at
RESPONSE_SPEEDS, on a flat road without wind (`plant response`). P is the nominal response, and U is
CHECKED_AMPLITUDE_BAR in every bin. A truck is within the bounds when t* of E = (G - P)U, Z = PU is at most 1.
The disturbance bound used there leaves out the share W_n that zero-input driving needs. Then a frame whose
input stays below U in its bin is explained by some |delta| <= W_delta, road, wind and sensors included. Runs
with a frame of larger input are counted apart. Nothing here or below uses what the monitor says.

What a fault should show is measured off line on the very samples of the run: frames at every STRIDE-th start,
in double precision, by the estimator that set the bounds. A fault is *visible* in a run when t* is at least
1.5 times the threshold in at least 10 % of the frames that lie wholly in excited driving after its start. A
visible fault must be found within 60 s of judged, excited driving. An alarm is *due* by the time that class
Offline derives. Runs in which a detector alarms before the fault do not count for it.

Two things are scored, apart from each other. The detectors of model error on faults of the truck, alone or
with one of the bus. The supervision on faults of the bus, alone or with one of the truck: what it must say at
every tick follows from the frames that were on the bus and the message table (supervision.py). What detectors
say where the bus alone is at fault is counted, not scored: a corrupted or late value that passes for a good
one is a model error to whoever sees no more than the values.

Files in the campaign's folder (each whole or absent; a campaign that was stopped goes on where it was):

    MANIFEST.json      what was asked: seed, sizes, inputs; another campaign is refused; and the seal of the
                       files so far
    baselines.json     parameters and thresholds of the baselines (evaluate.BaselineStudy, all calibration
                       drives)
    plants.json        candidates for "within" with their t*, and t* of the faulted trucks
    chunks/NNNNN.parquet   rows of CHUNK runs
    runs.parquet       all rows
    summary.json       the tables
"""

from __future__ import annotations

import io
import subprocess
import tempfile
from collections.abc import Callable, Iterator
from dataclasses import asdict, dataclass
from functools import cached_property, lru_cache, partial
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
from scipy.stats import beta, chi2

from ..base import artefacts
from ..base.documents import read_toml
from ..base.errors import InputError
from ..base.parallel import Map
from ..can.logs import read_log
from ..control.design import faulted_performance
from ..core.compiled import Core
from ..core.control_coefficients import load_controller
from ..drives.frames import Estimator
from ..drives.tables import Drive
from ..engine.synthesis.statespace import StateSpace, gain
from ..engine.validation import s1
from ..evaluate.baselines import KINDS as BASELINE_KINDS
from ..evaluate.baselines import TITLES, Bank, Baseline, Scales
from ..evaluate.run import COUNTS_ONLY, MONITOR, TESTS, BaselineStudy, Clock, alarming, median_time
from ..identify.bounds import nominal_error
from ..identify.calibration import Calibration, calibrate
from ..identify.run import DriveSet, StoredIdentification
from ..replay.run import Replay, Replayer
from ..vehicle.nominal import NominalModel
from .generate import plant_tool
from .sim import RECOVERY_S, SUPERVISION, Simulator
from .supervision import LIVE, Reactions, limits, needed_messages, required

DURATION_S = 180.0
"""As long as the calibration drives of `generate`: a rate per drive means the same."""
FAULT_FROM_S = 60.0
BUS_FAULT_UNTIL_S = 150.0
FOUND_WITHIN_S = 60.0
VISIBLE_RATIO, VISIBLE_SHARE, VISIBLE_FOUND = 1.5, 0.1, 0.95
STRIDE = 10
LATENCY_S = 1.0
"""From the end of a frame to the verdict that says so: a reserve."""
CHUNK = 40
PLANTS = 24
RESPONSE_SPEEDS = (8.3, 12.0, 17.0, 21.7)
RESPONSE_AMPLITUDES_BAR = (0.5, 1.5)
CHECKED_AMPLITUDE_BAR = 0.75
"""More than the frames of nearly all runs within hold; the others are counted apart. Bounds found from drives
say nothing of a demand that the drives did not hold: at 1.5 bar, of one frequency, the nominal truck itself
leaves them by a third, at 0.5 to 0.7 rad/s."""
FIRST_FAULT = 1_000_000
"""Number of the first run with a fault: what is drawn for it does not depend on the hours within."""
LOOP_SPEEDS = (8.5, 15.0, 21.5)
"""Where mu of a faulted loop is computed; the largest is stated."""
DETECTORS = (MONITOR, *BASELINE_KINDS)

Progress = Callable[[str], None]


# ------------------------------------------------------------------------------------------------- the faults


@dataclass(frozen=True)
class Kind:
    """A kind of fault: ``table`` is the text of its scenario tables, with {x} for the severity, {start} and
    {end} for when it begins and ends [s], {until} for the severity in seconds after its begin.

    ``loop``: severity -> what it does between controller and vehicle and between sensors and controller, as
    (applied, measured), where that is linear and time-invariant; ``response``: whether the truck's frequency
    response tells of it.
    """

    name: str
    unit: str
    values: tuple[float, ...]
    table: str
    loop: Callable[[float, float], tuple[StateSpace, StateSpace]] | None = None
    response: bool = False

    @property
    def from_s(self) -> float:
        return FAULT_FROM_S if "{start}" in self.table else 0.0

    @property
    def of_truck(self) -> bool:
        """Whether the truck, its sensors or its surroundings are at fault."""
        return "plant." in self.table

    @property
    def of_bus(self) -> bool:
        return "can_fault" in self.table

    def text(self, x: float, start_s: float = FAULT_FROM_S) -> str:
        return self.table.format(
            x=f"{x:.9g}", start=f"{start_s:g}", end=f"{BUS_FAULT_UNTIL_S:g}", until=f"{start_s + x:.9g}"
        )


def _measured(yaw: float, wheel: float, Ts: float) -> StateSpace:
    return gain(np.diag([1.0, yaw, wheel]), Ts)


def _delay(seconds: float, Ts: float) -> StateSpace:
    n = max(1, round(seconds / Ts))
    return StateSpace(np.eye(n, k=-1), np.eye(n, 1), np.eye(1, n, k=n - 1), np.zeros((1, 1)), Ts)


def _lag(seconds: float, Ts: float) -> StateSpace:
    pole = np.exp(-Ts / seconds)
    return StateSpace([[pole]], [[1 - pole]], [[1.0]], [[0.0]], Ts)


def _applied(
    system: Callable[[float, float], StateSpace],
) -> Callable[[float, float], tuple[StateSpace, StateSpace]]:
    return lambda x, Ts: (system(x, Ts), _measured(1.0, 1.0, Ts))


_ACTUATOR = "[[plant.actuator_fault]]\nstart_s = {start}\n"
_SURROUNDINGS = "[[plant.surroundings_fault]]\nstart_s = {start}\n"
_YAW = '[[plant.sensor_fault]]\nsignal = "yaw_rate"\nstart_s = {start}\n'
_WHEEL = '[[plant.sensor_fault]]\nsignal = "steering_wheel"\nstart_s = {start}\n'
_FRONT_WHEELS = "".join(
    f'[[plant.sensor_fault]]\nsignal = "wheel_speed_front_{side}"\nstart_s = {{start}}\ngain = {{x}}\n'
    for side in ("left", "right")
)
_VARIATION = "[plant.variation]\n"


def _bus(message: str, kind: str, *more: str, end: str = "{end}") -> str:
    lines = (f'message = "{message}"', f'kind = "{kind}"', "start_s = {start}", f"end_s = {end}", *more)
    return "[[can_fault]]\n" + "".join(f"{line}\n" for line in lines)


def _of_frames(message: str, kind: str, *shares: float, name: str = "", more: tuple[str, ...] = ()) -> Kind:
    """A fault of the bus that befalls a share of a message's frames."""
    return Kind(
        f"{message} {name or kind.replace('_', ' ')}",
        "of the frames",
        shares,
        _bus(message, kind, "probability = {x}", *more),
    )


def _yaw_gain(x: float, Ts: float) -> tuple[StateSpace, StateSpace]:
    return gain([[1.0]], Ts), _measured(x, 1.0, Ts)


def _wheel_gain(x: float, Ts: float) -> tuple[StateSpace, StateSpace]:
    return gain([[1.0]], Ts), _measured(1.0, x, Ts)


KINDS = (
    Kind(
        "brake gain",
        "×",
        (0.0, 0.15, 0.3, 0.4, 0.5, 0.6, 0.7, 0.85, 1.3, 1.6, 2.0),
        _ACTUATOR + "brake_gain_ratio = {x}\n",
        _applied(lambda x, Ts: gain([[x]], Ts)),
        True,
    ),
    Kind(
        "brake lag", "s", (0.1, 0.2, 0.4, 0.8, 1.6), _ACTUATOR + "extra_lag_s = {x}\n", _applied(_lag), True
    ),
    Kind(
        "brake delay",
        "s",
        (0.05, 0.1, 0.2, 0.3, 0.4, 0.6),
        _ACTUATOR + "extra_delay_s = {x}\n",
        _applied(_delay),
        True,
    ),
    Kind(
        "brake gain and delay 0.1 s",
        "×",
        (0.4, 0.5, 0.6, 0.7, 0.85),
        _ACTUATOR + "brake_gain_ratio = {x}\nextra_delay_s = 0.1\n",
        _applied(
            lambda x, Ts: StateSpace(_delay(0.1, Ts).A, _delay(0.1, Ts).B, x * _delay(0.1, Ts).C, [[0.0]], Ts)
        ),
        True,
    ),
    Kind("yaw-rate gain", "×", (-1.0, 0.3, 0.5, 0.6, 0.7, 0.85, 1.3, 1.6), _YAW + "gain = {x}\n", _yaw_gain),
    Kind("yaw-rate bias", "rad/s", (0.005, 0.01, 0.02, 0.04, 0.08), _YAW + "bias = {x}\n"),
    Kind("yaw-rate drift", "rad/s²", (1e-4, 3e-4, 1e-3, 3e-3), _YAW + "drift_ps = {x}\n"),
    Kind("yaw-rate noise", "rad/s rms", (0.005, 0.01, 0.02, 0.05, 0.1), _YAW + "extra_noise_rms = {x}\n"),
    # A frozen value is a constant and a gain of 0.
    Kind("yaw rate frozen", "", (1.0,), _YAW + "frozen = true\n", lambda x, Ts: _yaw_gain(0.0, Ts)),
    Kind(
        "wheel-angle gain", "×", (-1.0, 0.3, 0.5, 0.7, 0.85, 1.3, 1.6), _WHEEL + "gain = {x}\n", _wheel_gain
    ),
    Kind("steering-wheel bias", "rad", (0.05, 0.1, 0.2, 0.4), _WHEEL + "bias = {x}\n"),
    Kind("steering-wheel drift", "rad/s", (1e-3, 3e-3, 1e-2, 3e-2), _WHEEL + "drift_ps = {x}\n"),
    Kind("steering-wheel noise", "rad rms", (0.02, 0.05, 0.1, 0.2), _WHEEL + "extra_noise_rms = {x}\n"),
    Kind("wheel angle frozen", "", (1.0,), _WHEEL + "frozen = true\n", lambda x, Ts: _wheel_gain(0.0, Ts)),
    Kind("measured speed", "×", (0.7, 0.85, 1.15, 1.3), _FRONT_WHEELS),
    Kind(
        "front tyre stiffness",
        "×",
        (0.15, 0.3, 0.5, 0.7, 0.85),
        _SURROUNDINGS + "cornering_stiffness_front_ratio = {x}\n",
        None,
        True,
    ),
    Kind(
        "rear tyre stiffness",
        "×",
        (0.3, 0.5, 0.7, 0.85),
        _SURROUNDINGS + "cornering_stiffness_rear_ratio = {x}\n",
        None,
        True,
    ),
    Kind(
        "friction",
        "×",
        (0.1, 0.2, 0.35, 0.6),
        _SURROUNDINGS + "friction_left_ratio = {x}\nfriction_right_ratio = {x}\n",
        None,
        True,
    ),
    Kind(
        "split friction",
        "×",
        (0.1, 0.2, 0.35, 0.6),
        _SURROUNDINGS + "friction_left_ratio = {x}\n",
        None,
        True,
    ),
    Kind("crosswind", "m/s", (5.0, 10.0, 15.0, 20.0), _SURROUNDINGS + "crosswind_mps = {x}\n"),
    Kind("load", "×", (0.6, 0.8, 1.2, 1.4), _VARIATION + "load_ratio = {x}\n", None, True),
    Kind(
        "centre of gravity",
        "m rearwards",
        (-0.5, -0.25, 0.25, 0.5),
        _VARIATION + "cg_shift_m = {x}\n",
        None,
        True,
    ),
    Kind("road bank", "rad rms", (0.008, 0.015, 0.03), _VARIATION + "bank_rms_rad = {x}\n"),
    Kind("quantisation", "× grid", (5.0, 20.0, 80.0), _VARIATION + "sensor_lsb_ratio = {x}\n"),
    Kind(
        "front tyre stiffness and yaw-rate gain 1.6",
        "×",
        (0.3, 0.5, 0.7, 0.85),
        _SURROUNDINGS + "cornering_stiffness_front_ratio = {x}\n" + _YAW + "gain = 1.6\n",
    ),
    # Truck and bus at once.
    Kind(
        "brake gain, 5 % of VDC2 lost",
        "×",
        (0.15, 0.3, 0.4, 0.5, 0.7),
        _ACTUATOR + "brake_gain_ratio = {x}\n" + _bus("VDC2", "lost", "probability = 0.05"),
        _applied(lambda x, Ts: gain([[x]], Ts)),
    ),
    Kind(
        "brake gain 0.3, VDC2 lost",
        "of the frames",
        (0.05, 0.2, 0.4, 0.6),
        _ACTUATOR + "brake_gain_ratio = 0.3\n" + _bus("VDC2", "lost", "probability = {x}"),
        _applied(lambda x, Ts: gain([[0.3]], Ts)),
    ),
    Kind(
        "yaw-rate gain, 20 % of GUARD_IN corrupted",
        "×",
        (-1.0, 0.3, 0.5, 0.7, 1.6),
        _YAW + "gain = {x}\n" + _bus("GUARD_IN", "corrupted", "probability = 0.2"),
        _yaw_gain,
    ),
    Kind(
        "brake delay, 30 % of VDC2 late by 10 ms",
        "s",
        (0.1, 0.2, 0.3, 0.4),
        _ACTUATOR + "extra_delay_s = {x}\n" + _bus("VDC2", "delayed", "probability = 0.3", "delay_s = 0.01"),
        _applied(_delay),
    ),
    # The bus alone. VDC2 and EBC2 have neither counter nor checksum, GUARD_IN has both.
    _of_frames("VDC2", "lost", 0.1, 0.3, 0.5, 0.7, 1.0),
    _of_frames("GUARD_IN", "lost", 0.1, 0.3, 0.5, 0.7, 1.0),
    _of_frames("EBC2", "lost", 0.1, 0.3, 0.5, 0.7, 1.0),
    _of_frames("VDC2", "repeated", 0.1, 0.5, 1.0),
    _of_frames("GUARD_IN", "repeated", 0.1, 0.3, 0.5, 1.0),
    _of_frames("GUARD_IN", "stuck_counter", 0.1, 0.3, 0.5, 1.0),
    _of_frames("VDC2", "swapped", 0.1, 0.5, 1.0),
    _of_frames("GUARD_IN", "swapped", 0.1, 0.5, 1.0),
    _of_frames("VDC2", "corrupted", 0.1, 0.3, 0.5, 1.0),
    _of_frames("GUARD_IN", "corrupted", 0.1, 0.3, 0.5, 1.0),
    _of_frames("VDC2", "wrong_length", 0.1, 0.3, 0.5, 1.0),
    _of_frames("VDC2", "babbling", 0.01, 0.1, 0.3, 1.0),
    _of_frames("GUARD_IN", "babbling", 0.01, 0.1, 0.3, 1.0),
    _of_frames("VDC2", "unknown_id", 0.1, 1.0, name="beside foreign frames"),
    _of_frames("VDC2", "delayed", 0.1, 0.3, 0.6, 0.9, name="late by 10 ms", more=("delay_s = 0.01",)),
    _of_frames("GUARD_IN", "delayed", 0.1, 0.3, 0.6, 0.9, name="late by 30 ms", more=("delay_s = 0.03",)),
    Kind("VDC2 delayed", "s", (0.01, 0.03, 0.1, 0.3), _bus("VDC2", "delayed", "delay_s = {x}")),
    Kind("GUARD_IN delayed", "s", (0.01, 0.03, 0.1, 0.3), _bus("GUARD_IN", "delayed", "delay_s = {x}")),
    Kind("EBC2 delayed", "s", (0.1, 0.3, 0.9), _bus("EBC2", "delayed", "delay_s = {x}")),
    Kind("bus-off", "s", (0.05, 0.2, 1.0, 5.0), _bus("VDC2", "bus_off", end="{until}")),
)


# ---------------------------------------------------------------------------------------------- the scenarios


@dataclass(frozen=True)
class Case:
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
    return _VARIATION + "".join(f"{key} = {value:.6g}\n" for key, value in drawn.items())


def scenario_text(seed: int, case: Case) -> str:
    """The scenario file of a run: speed and command drawn, so that the demand stays within what the bounds
    were made from."""
    random = np.random.default_rng([seed, 2, case.number])
    profile = _speed_profile(random)
    demand_bar = random.uniform(0.1, 0.3) if case.plant >= 0 else random.uniform(0.3, 0.7)
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
        + case.tables
    )


def _speed_profile(random: np.random.Generator) -> list[tuple[float, float]]:
    """(time [s], speed [m/s]): constant, drifting by at most 3 m/s, or swept to the farther end of the range
    and back at 0.05 to 0.3 m/s2."""
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


def plan(size: Size, variations: list[str]) -> list[Case]:
    """All runs, in the order of their numbers."""
    runs = int(np.ceil(size.hours * 3600 / DURATION_S))
    cases = [
        Case(n, "within", 0.0, n % len(variations), 0.0, variations[n % len(variations)]) for n in range(runs)
    ]
    faults = [(kind, x) for kind in KINDS for x in kind.values for _ in range(size.repeats)]
    return cases + [
        Case(FIRST_FAULT + n, kind.name, x, -1, kind.from_s, kind.text(x))
        for n, (kind, x) in enumerate(faults)
    ]


# ------------------------------------------------------------------------------------- frequency response, mu


@dataclass(frozen=True)
class Bounds:
    """What a frequency response is held against: the bins, weights at them and W_n, nominal model; from an
    identification."""

    omega: np.ndarray
    W_delta: np.ndarray
    B_w: np.ndarray
    W_n: np.ndarray

    @classmethod
    def of(cls, stored: StoredIdentification, estimator: Estimator) -> Bounds:
        fitted = stored.fitted
        if not fitted.W_n:
            raise InputError(
                stored.folder,
                "W_n",
                "missing: no drive of the noise split",
                "an identification with zero-input drives",
            )
        return cls(
            estimator.omega,
            *fitted.at(estimator.omega),
            fitted.inflation * np.column_stack([w.magnitude(estimator.omega) for w in fitted.W_n]),
        )


def response_margin(
    model: NominalModel, bounds: Bounds, tables: str, demand_bar: float | np.ndarray = CHECKED_AMPLITUDE_BAR
) -> float:
    """Largest t* of a truck's own frequency response over speeds, amplitudes and bins; see the module's
    docstring.

    ``tables``: its variation and faults, as scenario tables. ``demand_bar``: |U| that the frames may hold,
    for all bins or (K,). 1 or less: within the bounds.
    """
    U = np.broadcast_to(demand_bar, bounds.omega.shape)[:, None]
    tool = plant_tool()
    half = 0.5 * bounds.omega * model.Ts
    hold = np.exp(-1j * half) * np.sinc(half / np.pi)  # the demand is held over a sample
    worst = 0.0
    with tempfile.TemporaryDirectory() as scratch:
        path = Path(scratch) / "truck.toml"
        path.write_text("[plant]\nspeed_profile = [[0.0, 15.0]]\n" + tables, encoding="utf-8")
        for v in RESPONSE_SPEEDS:
            P = model.frequency_response(bounds.omega, v)[..., 0]
            for amplitude in RESPONSE_AMPLITUDES_BAR:
                command = [
                    tool,
                    "response",
                    "--scenario",
                    path,
                    "--speed",
                    v,
                    "--amplitude",
                    amplitude,
                    "--omega",
                    ",".join(f"{w:.9g}" for w in bounds.omega),
                ]
                done = subprocess.run([str(c) for c in command], capture_output=True, text=True, check=False)
                if done.returncode != 0:
                    raise InputError(tool, "response", done.stderr.strip(), "a truck that can be driven")
                rows = np.loadtxt(io.StringIO(done.stdout), delimiter=",", skiprows=1)
                G = (rows[:, 1::2] + 1j * rows[:, 2::2]) * hold[:, None]
                left = np.maximum(bounds.B_w - bounds.W_n, 1e-12)
                worst = max(worst, float(s1.margin((G - P) * U, P * U, bounds.W_delta, left).max()))
    return worst


def plants(
    model: NominalModel, bounds: Bounds, seed: int, workers: Map, progress: Progress
) -> dict[str, Any]:
    """Trucks within the bounds, in the order drawn until there are PLANTS, and t* of every faulted truck that
    has a response."""
    margin = partial(response_margin, model, bounds)
    candidates: list[dict[str, Any]] = []
    while sum(c["margin"] <= 1 for c in candidates) < PLANTS:
        tables = [draw_variation(seed, len(candidates) + i) for i in range(8)]
        if len(candidates) >= 20 * PLANTS:
            raise InputError(
                "campaign",
                "within",
                f"{len(candidates)} trucks drawn, too few within the bounds",
                f"{PLANTS} that are",
            )
        for t, value in zip(tables, workers(margin, tables), strict=False):
            progress(f"frequency response of truck {len(candidates)}")
            candidates.append({"tables": t, "margin": value})
    chosen = [(kind, x) for kind in KINDS if kind.response for x in kind.values]
    faulted = []
    for (kind, x), value in zip(
        chosen, workers(margin, [k.text(x, start_s=0.0) for k, x in chosen]), strict=False
    ):
        progress(f"frequency response, {kind.name} {x:g}")
        faulted.append({"kind": kind.name, "severity": x, "margin": value})
    return {"nominal": margin(""), "candidates": candidates, "faulted": faulted}


def loop_levels(stored: StoredIdentification, controller: Path, progress: Progress) -> list[dict[str, Any]]:
    """Upper bound of mu of the certified loop with each linear fault in it, largest over LOOP_SPEEDS; None
    where it is not stable."""
    found = []
    for kind in KINDS:
        for x in kind.values if kind.loop else ():
            progress(f"mu, {kind.name} {x:g}")
            levels = [
                faulted_performance(controller, stored, v, *kind.loop(x, stored.project.Ts_s))
                for v in LOOP_SPEEDS
            ]
            found.append(
                {
                    "kind": kind.name,
                    "severity": x,
                    "stable": bool(np.isfinite(max(levels))),
                    "mu_upper": max(levels) if np.isfinite(max(levels)) else None,
                }
            )
    return found


# ---------------------------------------------------------------------------------------------------- one run


@dataclass(frozen=True)
class Offline:
    """What the samples of a run show, whatever the monitor says: frames of all bins, by the estimator that
    set the bounds, in double.

    visible_share: share with t* >= VISIBLE_RATIO times the threshold of the frames that lie wholly in excited
    driving after the fault, 0 without any. due_s: when a monitor with these bounds must have alarmed [s after
    the fault], None: never. It judges a frame every half frame; where t* >= VISIBLE_RATIO times the threshold
    at every start of half a frame, one of these is judged, and ended, by the end of the last. median,
    largest: of t* of the frames after the fault.
    """

    visible_share: float
    due_s: float | None
    median: float | None
    largest: float

    @classmethod
    def of(cls, replayer: Replayer, drive: Drive, from_s: float) -> Offline:
        model, estimator = replayer.model, replayer.estimator
        e, yhat = nominal_error(drive, model)
        both = np.hstack([e, yhat])
        calm = np.concatenate([[0], np.cumsum(~replayer.excited(drive))])
        first = first_sample(drive, from_s, model.Ts)
        excited, after, due = [], [], np.inf
        for k, length in enumerate(estimator.length):
            counted = estimator.counted(drive.v, k)[::STRIDE]
            starts = STRIDE * np.flatnonzero(counted)
            starts = starts[starts + length > first]
            frames = estimator.transform(both, k, starts)
            margins = s1.margin(
                frames[:, : e.shape[1]], frames[:, e.shape[1] :], replayer.W_delta[k], replayer.B_w[k]
            )
            later = starts >= first
            after.append(margins[later])
            excited.append(margins[later & (calm[starts + length] == calm[starts])])
            begin = _first_stretch(starts, margins >= VISIBLE_RATIO * replayer.threshold, length // 2)
            due = due if begin is None else min(due, (begin + length // 2 + length - first) * model.Ts)
        excited, after = np.concatenate(excited), np.concatenate(after)
        share = float((excited >= VISIBLE_RATIO * replayer.threshold).mean()) if len(excited) else 0.0
        return cls(
            share,
            due if np.isfinite(due) else None,
            float(np.median(after)) if len(after) else None,
            float(after.max(initial=0.0)),
        )


def _first_stretch(starts: np.ndarray, above: np.ndarray, length: int) -> int | None:
    """First of ``starts`` (STRIDE apart, but for gaps) from which all are ``above`` for ``length`` samples;
    None: nowhere."""
    good = starts[above]
    edges = np.flatnonzero(np.diff(good) != STRIDE) + 1
    return next(
        (int(run[0]) for run in np.split(good, edges) if len(run) and run[-1] - run[0] >= length), None
    )


def first_sample(drive: Drive, run_s: float, Ts: float) -> int:
    """Index of the first sample at or after a time of the run: the drive begins when the ECU has all signals,
    tenths of a second later."""
    return max(0, round((run_s - float(drive.t[0])) / Ts))


@dataclass(frozen=True)
class Context:
    """What every worker needs; it builds simulator and core from ``folder`` (same path on every machine) and
    its cache."""

    folder: Path
    seed: int
    scales: tuple[tuple[float, ...], tuple[float, ...]]
    baselines: tuple[tuple[Baseline, float], ...]

    @cached_property
    def tools(self) -> tuple[Simulator, Replayer, Bank]:
        return _tools(self.folder, self.scales)

    def __getstate__(self) -> dict:
        return {k: v for k, v in self.__dict__.items() if k != "tools"}


@lru_cache(maxsize=2)
def _tools(
    folder: Path, scales: tuple[tuple[float, ...], tuple[float, ...]]
) -> tuple[Simulator, Replayer, Bank]:
    simulator = Simulator(folder)
    replayer = Replayer(simulator.project, Core(folder))
    return (
        simulator,
        replayer,
        Bank(replayer.model, replayer.estimator, Scales(*(np.array(s) for s in scales))),
    )


def run_case(context: Context, case: Case) -> dict[str, Any]:
    """One run: simulated, replayed through the core, judged by every detector and off line. A row of the
    Parquet files."""
    simulator, replayer, bank = context.tools
    with tempfile.TemporaryDirectory() as scratch:
        path = Path(scratch) / "scenario.toml"
        path.write_text(scenario_text(context.seed, case), encoding="utf-8")
        log = path.with_suffix(".log") if "can_fault" in case.tables else None
        facts, drive, present = simulator.drive(path, log=log)
        reactions = supervision(simulator, facts, read_toml(path, "a scenario file"), log, case.fault_s)
    replay = replayer.replay(drive, present)
    clock = Clock.of(replay, first_sample(drive, case.fault_s, replay.Ts))
    offline = Offline.of(replayer, drive, case.fault_s)
    row: dict[str, Any] = {
        "number": case.number,
        "kind": case.kind,
        "severity": case.severity,
        "plant": case.plant,
        "seed": facts["seed"],
        "fault_s": case.fault_s,
        "duration_s": facts["duration_s"],
        "speed_mps": float(drive.v.mean()),
        "frames_hash": facts["frames_hash"],
        "demand_max_bar": facts["demand_max_bar"],
        "frame_demand_max_bar": float(largest_input(replayer, drive).max()),
        "tracking_ratio": facts["tracking_rms"] / facts["command_rms"] if facts["command_rms"] else None,
        "judged_s": replay.judged_s,
        "excited_after_s": float(clock.seconds[-1]),
        "visible_share": offline.visible_share,
        "due_s": offline.due_s,
        "offline_median": offline.median,
        "offline_max": offline.largest,
        "ecu_invalid_s": next((t for t, verdict in facts["verdicts"] if verdict == "invalid"), None),
        **{f"supervision_{key}": value for key, value in asdict(reactions).items()},
    }
    for test in TESTS:
        hits = alarming(replay, test)
        row |= {
            f"alarms_{test}": sum(a.test == test for a in replay.alarms),
            f"alarmed_{test}": bool(hits.any()),
            f"{test}_found_s": clock.read(hits),
        }
    row |= _judged(MONITOR, _statistic(replayer, replay, drive), 1.0, clock)
    e = nominal_error(drive, replayer.model)[0]
    thresholds = dict(context.baselines)
    for b, values in bank.statistics(thresholds, e, drive.v):
        row |= _judged(b.kind, values, thresholds[b], clock)
    return row


def supervision(
    simulator: Simulator, facts: dict[str, Any], scenario: dict[str, Any], log: Path | None, from_s: float
) -> Reactions:
    """What the ECU reported of its bus from ``from_s`` on (not before the bus came up), against what the
    frames in the ``log`` require; None: of a bus without fault, which requires it to be live. ``facts``,
    ``scenario``: as the simulator prints and was given them."""
    Ts = simulator.project.Ts_s
    ticks_us = np.arange(round(max(from_s, RECOVERY_S) / Ts), round(facts["duration_s"] / Ts)) * round(
        Ts * 1e6
    )
    times, states = zip(*facts["supervision"], strict=False)
    said = np.array([SUPERVISION.index(s) for s in states])[
        np.searchsorted(np.round(np.array(times) * 1e6), ticks_us, side="right") - 1
    ]
    if log is None:
        return Reactions.of(said, np.full(len(ticks_us), LIVE), Ts)
    off_us = [
        round(fault["start_s"] * 1e6) for fault in scenario.get("can_fault", ()) if fault["kind"] == "bus_off"
    ]
    return Reactions.of(
        said,
        required(
            read_log(log), needed_messages(simulator.project), ticks_us, off_us, limits(simulator.project)
        ),
        Ts,
    )


def _statistic(replayer: Replayer, replay: Replay, drive: Drive) -> np.ndarray:
    """(N,) of the monitor: the larger of the frame test's statistic (where frames were judged) and the energy
    test's ratio, each over its threshold; -inf where neither judged. Above 1: an alarm."""
    frames = replay.run.frames
    statistic = np.where(replay.run.energy > 0, replay.run.energy / replayer.energy_threshold, -np.inf)
    at = np.round((frames.t_judged_s - drive.t[0]) / replay.Ts).astype(int)
    np.maximum.at(statistic, at[frames.counted], frames.statistic[frames.counted] / replayer.threshold)
    return statistic


def _judged(name: str, statistic: np.ndarray, threshold: float, clock: Clock) -> dict[str, Any]:
    """NAME_before, NAME_found_s at the threshold; largest statistic before the fault and within the time
    allowed after it."""
    within = slice(clock.first, int(np.searchsorted(clock.seconds, FOUND_WITHIN_S, side="right")))
    before = float(statistic[: clock.first].max(initial=-np.inf))
    return {
        f"{name}_before": before > threshold,
        f"{name}_found_s": clock.read(statistic > threshold),
        f"{name}_score_before": before,
        f"{name}_score_within": float(statistic[within].max(initial=-np.inf)),
        f"{name}_score": float(statistic.max(initial=-np.inf)),
    }


def largest_input(replayer: Replayer, drive: Drive) -> np.ndarray:
    """(K,) largest |U| of the first input in the counted frames of each bin [input unit]; 0 where there are
    none."""
    estimator = replayer.estimator
    largest = np.zeros(estimator.n_bins)
    for k in range(estimator.n_bins):
        starts = STRIDE * np.flatnonzero(estimator.counted(drive.v, k)[::STRIDE])
        largest[k] = np.abs(estimator.transform(drive.u[:, :1], k, starts)).max(initial=0.0)
    return largest


# ----------------------------------------------------------------------------------------------- the campaign


def campaign(
    stored: StoredIdentification,
    drives: DriveSet,
    folder: Path,
    out: Path,
    *,
    seed: int,
    size: Size,
    controller: Path | None = None,
    workers: Map = map,
    progress: Progress = lambda _: None,
) -> dict[str, Any]:
    """Run or go on with the campaign in ``out``; returns its summary.

    ``folder``: generated folder with controller, of this identification; ``controller``: controller.json
    written by `design`, for mu of the faulted loops. InputError when ``out`` holds another campaign, or one
    of these belongs to another identification.
    """
    simulator, core = Simulator(folder), Core(folder)
    replayer = Replayer(simulator.project, core)
    _require_same(stored, replayer)
    if controller is not None:
        _require_designed_for(stored, controller)
    with artefacts.kept_folder(
        out,
        "campaign",
        seed=seed,
        size=asdict(size),
        vehicle=artefacts.read_manifest(folder, "vehicle"),
        plan={k.name: [k.table, *k.values] for k in KINDS},
        duration_s=DURATION_S,
    ) as kept_in:
        return _go_on(
            stored, drives, folder, kept_in, replayer, core, seed, size, controller, workers, progress
        )


def _go_on(
    stored: StoredIdentification,
    drives: DriveSet,
    folder: Path,
    out: artefacts.KeptFolder,
    replayer: Replayer,
    core: Core,
    seed: int,
    size: Size,
    controller: Path | None,
    workers: Map,
    progress: Progress,
) -> dict[str, Any]:
    def kept(name: str, make: Callable[[], Any]) -> Any:
        if not out.has(name):
            out.write(name, artefacts.to_json(make()).encode())
        return artefacts.read_json(out.folder / name)

    tuned = kept("baselines.json", lambda: _tune(stored, drives, core, workers, progress))
    found = kept(
        "plants.json",
        lambda: plants(replayer.model, Bounds.of(stored, replayer.estimator), seed, workers, progress),
    )
    levels = kept("loops.json", lambda: loop_levels(stored, controller, progress)) if controller else []
    context = Context(
        Path(folder).absolute(),
        seed,
        (tuple(tuned["scales"]["error"]), tuple(tuned["scales"]["input"])),
        tuple((Baseline(**b["parameters"]), b["threshold"]) for b in tuned["chosen"]),
    )
    cases = plan(size, [c["tables"] for c in found["candidates"] if c["margin"] <= 1][:PLANTS])
    chunks = [cases[i : i + CHUNK] for i in range(0, len(cases), CHUNK)]
    names = [f"chunks/{i:05d}.parquet" for i in range(len(chunks))]
    left = [(n, c) for n, c in zip(names, chunks, strict=False) if not out.has(n)]
    rows = iter(workers(partial(run_case, context), [case for _, chunk in left for case in chunk]))
    done = sum(len(c) for c in chunks) - sum(len(c) for _, c in left)
    for name, chunk in left:
        table = []
        for case in chunk:
            table.append(next(rows))
            done += 1
            progress(f"run {done} of {len(cases)}, {case.kind}")
        out.write(name, _parquet(pa.Table.from_pylist(table, schema=_schema(table[0]))))
    table = pa.concat_tables([pq.read_table(out.folder / n) for n in names])
    out.write("runs.parquet", _parquet(table))
    summary = summarise(table, stored, found, levels, tuned)
    out.write("summary.json", artefacts.to_json(summary).encode())
    return summary


def _require_same(stored: StoredIdentification, replayer: Replayer) -> None:
    W_delta, B_w = stored.fitted.at(replayer.estimator.omega)
    if not (np.allclose(W_delta, replayer.W_delta, rtol=1e-4) and np.allclose(B_w, replayer.B_w, rtol=1e-4)):
        raise InputError(
            replayer.core.folder,
            "bounds",
            "are not those of the identification",
            f"an export of {stored.folder}",
        )


def _require_designed_for(stored: StoredIdentification, controller: Path) -> None:
    load_controller(controller)
    if artefacts.read_manifest(controller.parent, "design")["identification"] != stored.manifest:
        raise InputError(
            controller.parent, "identification", "is another one", f"a design of {stored.folder}"
        )


def _tune(
    stored: StoredIdentification, drives: DriveSet, core: Core, workers: Map, progress: Progress
) -> dict[str, Any]:
    study = BaselineStudy(stored, drives, core, left_out=(None,), workers=workers, progress=progress)
    chosen = [study.best(kind) for kind in BASELINE_KINDS]
    return {
        "scales": asdict(study.bank.scales),
        "alpha": study.calibration(chosen[0][0]).alpha,
        "chosen": [{"label": b.label, "parameters": asdict(b), "threshold": h} for b, h in chosen],
    }


def _schema(row: dict[str, Any]) -> pa.Schema:
    """Numbers may be null anywhere, so types go by name and value, not by what the first rows happen to
    hold."""
    types = {int: pa.int64(), str: pa.string(), bool: pa.bool_()}
    return pa.schema([(name, types.get(type(value), pa.float64())) for name, value in row.items()])


def _parquet(table: pa.Table) -> bytes:
    stream = io.BytesIO()
    pq.write_table(table, stream)
    return stream.getvalue()


# ------------------------------------------------------------------------------------------------- the tables


def rate(count: int, of: int) -> dict[str, Any]:
    """A ratio of runs with its exact 95 % interval (Clopper and Pearson)."""
    low = float(beta.ppf(0.025, count, of - count + 1)) if count else 0.0
    high = float(beta.ppf(0.975, count + 1, of - count)) if count < of else 1.0
    return {"count": count, "of": of, "interval": [low, high] if of else None}


def per_hour(count: int, hours: float) -> dict[str, Any]:
    """Events an hour with their exact 95 % interval (Poisson). The events must be independent: runs that
    alarm, not their alarms."""
    low = float(chi2.ppf(0.025, 2 * count)) / 2 if count else 0.0
    high = float(chi2.ppf(0.975, 2 * count + 2)) / 2
    return {
        "rate": count / hours if hours else None,
        "interval": [low / hours, high / hours] if hours else None,
    }


def summarise(
    table: pa.Table, stored: StoredIdentification, found: dict, levels: list[dict], tuned: dict
) -> dict[str, Any]:
    """The campaign's tables from its rows; JSON-able. ``severities``, ``kinds``, ``average``, ``visible``:
    faults of the truck; ``bus``: of the bus.

    ``matched``: with every detector's threshold such that by the rule of identify/calibration.py at most
    alpha of the runs within the bounds alarm, and at most alpha of the faulty runs before their fault. Only
    where there are runs enough for alpha (``matched_stated``) are these equal false alarms in the loop;
    ``matched_claim`` says so, or "counts only".
    """
    rows = table.to_pylist()
    drawn = [r for r in rows if r["kind"] == "within"]
    within = [r for r in drawn if r["frame_demand_max_bar"] <= CHECKED_AMPLITUDE_BAR]
    beyond = [r for r in drawn if r["frame_demand_max_bar"] > CHECKED_AMPLITUDE_BAR]
    kinds = {k.name: k for k in KINDS}
    faulty = [r for r in rows if r["kind"] in kinds and kinds[r["kind"]].of_truck]
    on_bus = [r for r in rows if r["kind"] in kinds and kinds[r["kind"]].of_bus]
    alpha = stored.project.frame_test.alpha
    before = [r for r in faulty if r["fault_s"] > 0]
    calibrations = {
        d: (
            _calibration([r[f"{d}_score"] for r in within], alpha),
            _calibration([r[f"{d}_score_before"] for r in before], alpha),
        )
        for d in DETECTORS
    }
    matched = {d: max(c.threshold for c in both) for d, both in calibrations.items()}
    loops = {(row["kind"], row["severity"]): row for row in levels}
    response = {(row["kind"], row["severity"]): row["margin"] for row in found["faulted"]}
    severities = []
    for key, members in _by_severity(faulty).items():
        loop = loops.get(key, {"stable": True, "mu_upper": None})
        severities.append(
            _severity(*key, members, matched)
            | {
                "loop_stable": loop["stable"],
                "mu_upper": loop["mu_upper"],
                "response_margin": response.get(key),
            }
        )
    visible = [r for r in faulty if _is_visible(r)]
    due = [
        r for r in rows if r["due_s"] is not None and r["fault_s"] + r["due_s"] + LATENCY_S <= r["duration_s"]
    ]
    units = {name: k.unit for name, k in kinds.items()}
    stated = {
        d: alpha if all(c.alpha is not None for c in both) else None for d, both in calibrations.items()
    }
    summary = {
        "detectors": {MONITOR: "lpvguard", **TITLES},
        "units": units,
        "baselines": tuned["chosen"],
        "alpha": tuned["alpha"],
        "calibrated": {
            test: {
                "claim": c.claim(),
                "alpha": c.alpha,
                "conditional_bound": c.conditional_bound,
                "threshold": c.threshold,
                "per_hour": c.alpha and c.alpha * 3600 / DURATION_S,
            }
            for test, c in (("frame", stored.calibration), ("energy", stored.energy.calibration))
        },
        "within": _within(within)
        | {
            "beyond_checked_amplitude": rate(sum(_alarms(r, MONITOR) for r in beyond), len(beyond)),
            "plants": len({r["plant"] for r in within}),
            "candidates": len(found["candidates"]),
            "nominal_margin": found["nominal"],
            "largest_margin": max(c["margin"] for c in found["candidates"] if c["margin"] <= 1),
        },
        "severities": severities,
        "due": rate(
            sum(
                r["ecu_invalid_s"] is not None and r["ecu_invalid_s"] <= r["fault_s"] + r["due_s"] + LATENCY_S
                for r in due
            ),
            len(due),
        ),
        "visible": {
            d: rate(
                sum(_found(r, d) for r in visible if not r[f"{d}_before"]),
                sum(not r[f"{d}_before"] for r in visible),
            )
            for d in DETECTORS
        },
        "average": {
            d: {
                "calibrated": float(np.mean([s["found"][d] / s["runs"] for s in severities])),
                "matched": float(np.mean([s["matched"][d] / s["runs"] for s in severities])),
            }
            for d in DETECTORS
        },
        "matched_thresholds": matched,
        "matched_stated": stated,
        "matched_claim": f"{COUNTS_ONLY}: too few runs for equal false alarms"
        if None in stated.values()
        else "equal false alarms in the loop",
        "kinds": [
            _kind(name, [s for s in severities if s["kind"] == name])
            for name in dict.fromkeys(s["kind"] for s in severities)
        ],
        "supervision": {"faulty": _supervision(on_bus), "healthy": _supervision(drawn)},
        "bus": [_bus_severity(*key, members) for key, members in _by_severity(on_bus).items()],
        "invisible": [
            s
            for s in severities
            if s["visible_runs"] < s["runs"] / 2
            and (not s["loop_stable"] or (s["mu_upper"] is not None and s["mu_upper"] >= 1))
        ],
    }
    summary["beaten"] = [
        {"kind": k["kind"], "detector": d, "matched": k["matched"][d], "monitor": k["matched"][MONITOR]}
        for k in summary["kinds"]
        for d in BASELINE_KINDS
        if k["matched"][d] > k["matched"][MONITOR]
    ]
    return summary | {"missed": list(_missed(summary))}


def _by_severity(rows: list[dict]) -> dict[tuple[str, float], list[dict]]:
    groups: dict[tuple[str, float], list[dict]] = {}
    for r in rows:
        groups.setdefault((r["kind"], r["severity"]), []).append(r)
    return groups


def _missed(summary: dict[str, Any]) -> Iterator[str]:
    """Claims that the campaign contradicts, a sentence each."""
    for test, seen in summary["within"]["tests"].items():
        calibrated = summary["calibrated"][test]["alpha"]
        if calibrated is not None and seen["interval"] is not None and seen["interval"][1] > calibrated:
            yield (
                f"{test} test: {seen['count']} of {seen['of']} runs within the bounds alarm, up to {seen['interval'][1]:.2%} with 95 %, "
                f"calibrated {calibrated:.2%}"
            )
    for bus, said in ((bus, s["as_required"]) for bus, s in summary["supervision"].items()):
        if said["count"] < said["of"]:
            yield f"{bus} bus: in {said['of'] - said['count']} of {said['of']} runs the supervision did not say what the frames require"
    due = summary["due"]
    if due["count"] < due["of"]:
        yield f"{due['of'] - due['count']} of {due['of']} alarms that were due did not come by then"
    found = summary["visible"][MONITOR]
    if found["of"] and found["count"] < VISIBLE_FOUND * found["of"]:
        yield f"{found['count']} of {found['of']} visible faults found within {FOUND_WITHIN_S:g} s, wanted {VISIBLE_FOUND:.0%}"
    average = {d: a["matched"] for d, a in summary["average"].items()}
    for d in BASELINE_KINDS:
        if average[d] >= average[MONITOR]:
            yield f"{TITLES[d]} finds {average[d]:.1%} on average ({summary['matched_claim']}), the monitor {average[MONITOR]:.1%}"


def _calibration(scores: list[float], alpha: float) -> Calibration:
    """Conformal calibration on healthy stretches; those on which the detector never spoke give no score."""
    return calibrate({str(i): s for i, s in enumerate(scores) if np.isfinite(s)}, alpha, floor=0.0)


def _is_visible(row: dict) -> bool:
    return row["visible_share"] >= VISIBLE_SHARE and row["excited_after_s"] > 0


def _found(row: dict, detector: str) -> bool:
    s = row[f"{detector}_found_s"]
    return not row[f"{detector}_before"] and s is not None and s <= FOUND_WITHIN_S


def _alarms(row: dict, detector: str) -> bool:
    return row[f"{detector}_before"] or row[f"{detector}_found_s"] is not None


def _within(rows: list[dict]) -> dict[str, Any]:
    """Alarm rates of trucks within the bounds, per run of DURATION_S (the exchangeable unit), by detector and
    test."""
    hours = sum(r["duration_s"] for r in rows) / 3600
    alarmed = {d: sum(_alarms(r, d) for r in rows) for d in DETECTORS}
    trucks: dict[int, bool] = {}
    for r in rows:
        trucks[r["plant"]] = trucks.get(r["plant"], False) or _alarms(r, MONITOR)
    return {
        "runs": len(rows),
        "hours": hours,
        "judged_hours": sum(r["judged_s"] for r in rows) / 3600,
        "alarmed": {d: rate(n, len(rows)) for d, n in alarmed.items()},
        "alarmed_trucks": rate(sum(trucks.values()), len(trucks)),
        "tests": {
            t: rate(n, len(rows))
            | {"per_hour": per_hour(n, hours), "alarms": sum(r[f"alarms_{t}"] for r in rows)}
            for t, n in ((t, sum(r[f"alarmed_{t}"] for r in rows)) for t in TESTS)
        },
    }


def _severity(kind: str, x: float, rows: list[dict], matched: dict[str, float]) -> dict[str, Any]:
    def at_matched(r: dict, d: str) -> bool:
        return not r[f"{d}_score_before"] > matched[d] and r[f"{d}_score_within"] > matched[d]

    return {
        "kind": kind,
        "severity": x,
        "runs": len(rows),
        "visible_runs": sum(map(_is_visible, rows)),
        "visible_share": float(np.median([r["visible_share"] for r in rows])),
        "found": {d: sum(_found(r, d) for r in rows) for d in DETECTORS},
        "matched": {d: sum(at_matched(r, d) for r in rows) for d in DETECTORS},
        "median_s": {
            d: median_time([r[f"{d}_found_s"] for r in rows if not r[f"{d}_before"]]) for d in DETECTORS
        },
    }


def _supervision(rows: list[dict]) -> dict[str, Any]:
    """Runs in which all was as required, and reactions due and met. Not of trucks that alone are at fault:
    one that leaves the controller's range of speeds is refused, which the ECU reports as "off" though its bus
    is live."""
    return {
        "as_required": rate(sum(map(_as_required, rows)), len(rows)),
        "due": sum(r["supervision_due"] for r in rows),
        "met": sum(r["supervision_met"] for r in rows),
    }


def _as_required(row: dict) -> bool:
    """Whether the supervision said at every tick what it had to, and nothing worse."""
    return (
        row["supervision_met"] == row["supervision_due"]
        and row["supervision_late_s"] == 0.0 == row["supervision_unwarranted_s"]
    )


def _bus_severity(kind: str, x: float, rows: list[dict]) -> dict[str, Any]:
    """What the supervision made of a fault of the bus. Of the time since its begin ``away`` is the share for
    which it could not be live, ``judged`` that in which the monitor judged excited driving: after every gap
    the model has to settle first. ``alarmed``: runs in which a detector alarmed since, which need not be
    wrong: see ``visible_runs``."""
    return {
        "kind": kind,
        "severity": x,
        "runs": len(rows),
        "as_required": sum(map(_as_required, rows)),
        "due": sum(r["supervision_due"] for r in rows),
        "met": sum(r["supervision_met"] for r in rows),
        "late_s": max(r["supervision_late_s"] for r in rows),
        "unwarranted_s": sum(r["supervision_unwarranted_s"] for r in rows),
        "away": float(np.mean([r["supervision_away_s"] / (r["duration_s"] - r["fault_s"]) for r in rows])),
        "judged": float(np.mean([r["excited_after_s"] / (r["duration_s"] - r["fault_s"]) for r in rows])),
        "alarmed": {d: sum(r[f"{d}_found_s"] is not None for r in rows) for d in DETECTORS},
        "visible_runs": sum(map(_is_visible, rows)),
    }


def _kind(name: str, rows: list[dict]) -> dict[str, Any]:
    """A kind's average over its severities, and who is best (all that tie; nobody where nobody found a fault)
    at calibrated and at matched thresholds."""
    shares = {d: float(np.mean([s["found"][d] / s["runs"] for s in rows])) for d in DETECTORS}
    matched = {d: float(np.mean([s["matched"][d] / s["runs"] for s in rows])) for d in DETECTORS}

    def best(found: dict[str, float]) -> list[str]:
        return [d for d, share in found.items() if 0 < share == max(found.values())]

    return {
        "kind": name,
        "found": shares,
        "matched": matched,
        "best": best(shares),
        "best_matched": best(matched),
    }
