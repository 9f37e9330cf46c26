"""Kinds of faults and variations in a campaign, with their severities and their text in a scenario file."""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from ....engine.synthesis.statespace import StateSpace, gain
from ....vehicle.project import Way

FAULT_FROM_S = 60.0
RAMP_S = 20.0
"""Time in which a growing fault reaches its full size."""
WAYS: tuple[Way, ...] = ("step", "ramp", "start")
"""Ways in which a fault of only the truck begins: suddenly, growing for RAMP_S, or at the start of the
run."""
BUS_FAULT_UNTIL_S = 150.0


@dataclass(frozen=True)
class Kind:
    """Kind of fault.

    ``table`` is the text of its scenario tables. In the text, {x} is the severity, {start} and {end} are the
    begin and the end [s], and {until} is x seconds after the begin [s]. ``loop`` gives (applied, measured)
    for a severity if the fault is linear and time-invariant, otherwise it is None. ``applied`` acts between
    controller and vehicle. ``measured`` acts between sensors and controller. ``response`` tells if the
    truck's frequency response shows the fault.
    """

    name: str
    unit: str
    values: tuple[float, ...]
    table: str
    loop: Callable[[float, float], tuple[StateSpace, StateSpace]] | None = None
    response: bool = False

    @property
    def ways(self) -> tuple[Way, ...]:
        """Ways in which the fault begins: a variation at the run's start, a fault of the bus suddenly."""
        if "{start}" not in self.table:
            return ("start",)
        return WAYS[:1] if self.of_bus else WAYS

    def from_s(self, way: Way) -> float:
        """Start of the fault [s]."""
        return 0.0 if way == "start" else FAULT_FROM_S

    @property
    def of_truck(self) -> bool:
        """Tell if the truck, its sensors or its surroundings have a fault."""
        return "plant." in self.table

    @property
    def of_bus(self) -> bool:
        """Tell if the bus has a fault."""
        return "can_fault" in self.table

    def text(self, x: float, way: Way = "step") -> str:
        """Write the scenario tables of the fault with severity ``x`` and the given way."""
        start_s = self.from_s(way)
        return self.table.format(
            x=f"{x:.9g}",
            start=f"{start_s:g}",
            ramp=f"{RAMP_S if way == 'ramp' else 0.0:g}",
            end=f"{BUS_FAULT_UNTIL_S:g}",
            until=f"{start_s + x:.9g}",
        )


def _measured(yaw: float, wheel: float, Ts: float) -> StateSpace:
    return gain(np.diag([1.0, yaw, wheel]), Ts)


def _delay(seconds: float, Ts: float) -> StateSpace:
    n = max(1, round(seconds / Ts))
    return StateSpace(np.eye(n, k=-1), np.eye(n, 1), np.eye(1, n, k=n - 1), np.zeros((1, 1)), Ts)


def _gain_and_delay(x: float, Ts: float) -> StateSpace:
    late = _delay(0.1, Ts)
    return StateSpace(late.A, late.B, x * late.C, late.D, Ts)


def _lag(seconds: float, Ts: float) -> StateSpace:
    pole = np.exp(-Ts / seconds)
    return StateSpace(np.array([[pole]]), np.array([[1 - pole]]), np.array([[1.0]]), np.array([[0.0]]), Ts)


def _applied(
    system: Callable[[float, float], StateSpace],
) -> Callable[[float, float], tuple[StateSpace, StateSpace]]:
    return lambda x, Ts: (system(x, Ts), _measured(1.0, 1.0, Ts))


_ACTUATOR = "[[plant.actuator_fault]]\nstart_s = {start}\nramp_s = {ramp}\n"
_SURROUNDINGS = "[[plant.surroundings_fault]]\nstart_s = {start}\nramp_s = {ramp}\n"
_YAW = '[[plant.sensor_fault]]\nsignal = "yaw_rate"\nstart_s = {start}\nramp_s = {ramp}\n'
_WHEEL = '[[plant.sensor_fault]]\nsignal = "steering_wheel"\nstart_s = {start}\nramp_s = {ramp}\n'
_FRONT_WHEELS = "".join(
    f'[[plant.sensor_fault]]\nsignal = "wheel_speed_front_{side}"\n'
    "start_s = {start}\nramp_s = {ramp}\ngain = {x}\n"
    for side in ("left", "right")
)
VARIATION = "[plant.variation]\n"


def _bus(message: str, kind: str, *more: str, end: str = "{end}") -> str:
    lines = (f'message = "{message}"', f'kind = "{kind}"', "start_s = {start}", f"end_s = {end}", *more)
    return "[[can_fault]]\n" + "".join(f"{line}\n" for line in lines)


def _of_frames(message: str, kind: str, *shares: float, name: str = "", more: tuple[str, ...] = ()) -> Kind:
    """Fault of the bus that affects a share of a message's frames."""
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
        _applied(_gain_and_delay),
        True,
    ),
    Kind("yaw-rate gain", "×", (-1.0, 0.3, 0.5, 0.6, 0.7, 0.85, 1.3, 1.6), _YAW + "gain = {x}\n", _yaw_gain),
    Kind("yaw-rate bias", "rad/s", (0.005, 0.01, 0.02, 0.04, 0.08), _YAW + "bias = {x}\n"),
    Kind("yaw-rate drift", "rad/s²", (1e-4, 3e-4, 1e-3, 3e-3), _YAW + "drift_ps = {x}\n"),
    Kind("yaw-rate noise", "rad/s rms", (0.005, 0.01, 0.02, 0.05, 0.1), _YAW + "extra_noise_rms = {x}\n"),
    # For the loop, a frozen value is a gain of 0.
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
    Kind("load", "×", (0.6, 0.8, 1.2, 1.4), VARIATION + "load_ratio = {x}\n", None, True),
    Kind(
        "centre of gravity",
        "m rearwards",
        (-0.5, -0.25, 0.25, 0.5),
        VARIATION + "cg_shift_m = {x}\n",
        None,
        True,
    ),
    Kind("road bank", "rad rms", (0.008, 0.015, 0.03), VARIATION + "bank_rms_rad = {x}\n"),
    Kind("quantisation", "× grid", (5.0, 20.0, 80.0), VARIATION + "sensor_lsb_ratio = {x}\n"),
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
