"""Identify speed, steering and yaw rate among a log's signals, by name, then by the data's unit and sign.

A car that does not slide turns as its wheels roll: v (delta - trim) = L r, with L the wheelbase. A regression
of v delta on r, each without its part along v, gives L in the columns' units. Its sign is the relative sign.
With the wheelbase known, units follow: a factor of 3.6 means km/h, 57.3 degrees, 10 to 24 the angle of the
steering wheel.
"""

from __future__ import annotations

import re
from collections.abc import Iterable
from dataclasses import dataclass
from itertools import product

import numpy as np

from ..base.errors import InputError
from ..drives.units import unit_factor

ROLES = ("speed", "input", "output")
WORDS = {
    "speed": (r"^(v|vx|v_x|vel|speed)$", r"linear_vel_x|vehicle_speed|speed|velocity|\bvel|geschw"),
    "input": (r"^(delta|steer|swa)$|road_?wheel", r"steer.*ang|ang.*steer|steer|delta|wheel_?angle|lenk"),
    "output": (r"^(r|wz|yaw_?rate)$", r"yaw_?rate|angular_vel_z|gyro_?z|omega_?z|psi_?dot|yaw_?vel|gier"),
}
"""By role: certain names, and parts of likely names."""
NOT = {
    "speed": r"cmd|command|control|target|desired|set_?point|wheel|engine|fan|wind|ang|steer|_y$|_z$",
    "input": r"rate|torque|tq|request|override|speed|vel|fraction|calculated|command|cmd|control",
    "output": r"acc|target|desired|ref",
}
"""By role: words that lower a name's rank, as of commands and derivatives."""
SI = {"speed": "m/s", "input": "rad", "output": "rad/s"}
GUESSED_UNITS = {
    "speed": ("m/s", "km/h"),
    "input": ("rad", "deg"),
    "output": ("rad/s", "deg/s"),
}
"""Likely units, best first. Only a name or a stated unit can distinguish mph from understeer."""
UNIT_MARKS = {
    "speed": {"m/s": r"mps|m_s|ms", "km/h": r"k(m_?h|mph|ph)", "mph": r"mph"},
    "input": {"rad": r"rad", "deg": r"deg|degrees?|grad"},
    "output": {"rad/s": r"rad(_?p?_?s(ec)?)?", "deg/s": r"(deg|grad)(_?p?_?s(ec)?)?|dps"},
}
"""By role: the last words of a name that state its unit."""
FASTEST_MPS = 90.0
LARGEST_LATERAL_MPS2 = 12.0
LARGEST_ROAD_WHEEL_RAD = 0.8
"""Largest angle of a road car."""
AS_KNOWN = (0.7, 1.45)
"""Wheelbase from the data over the known one, where units are right; understeer lengthens it."""
STEERING_RATIO = (10.0, 24.0)
LONGEST_LAG_S = 0.6
SIGN_BIT = re.compile(r"sign|sgn|vorzeichen|(?:^|_)vz(?:_|$)|direction|richtung")
"""In the name of a bit that tells the sign of a magnitude beside it."""


@dataclass(frozen=True)
class Recording:
    """Signals of one log on one time axis: t (N,) [s], values (N,) by name, and units ("" if unknown)."""

    name: str
    t: np.ndarray
    values: dict[str, np.ndarray]
    units: dict[str, str]


@dataclass(frozen=True)
class Proposal:
    """A signal for a role: SI value = factor * signal in ``unit``; ``why`` holds sentences."""

    role: str
    name: str
    unit: str
    factor: float
    why: list[str]


def ranked(role: str, names: Iterable[str]) -> list[str]:
    """Names that may have the role, likeliest first."""
    scores = {}
    for name in names:
        low = re.sub(r"[\s-]+", "_", name.rsplit(".", 1)[-1].lower())
        certain, likely = (re.search(pattern, low) for pattern in WORDS[role])
        if certain or likely:
            scores[name] = (2 if certain else 1) - (1.5 if re.search(NOT[role], low) else 0)
    return sorted(scores, key=lambda name: (-scores[name], len(name), name))


def proposed(
    recordings: list[Recording], chosen: dict[str, str | None], wheelbase_m: float | None
) -> dict[str, Proposal]:
    """A signal a role, of those that all recordings hold. ``chosen``: name by role, or None to choose.

    Raises InputError where nothing fits a role, or no units agree with the wheelbase.
    """
    common = [n for n in recordings[0].values if all(n in r.values for r in recordings)]
    names, why = {}, {}
    for role in ROLES:
        names[role], why[role] = _named(role, common, recordings, chosen.get(role))
    if names["input"] == names["output"]:
        raise InputError(
            "new", "--input, --output", f"{names['input']} is both", "a steering angle and a yaw rate"
        )
    for role in ("input", "output"):
        _require_sign(role, names[role], common, recordings)
    length, correlation = rolled_length(recordings, names)
    units, ratio, said = _units(recordings, names, abs(length), wheelbase_m)
    sign = -1.0 if correlation < 0 else 1.0
    why["input"].append(
        f"correlation of v times it with {names['output']} {correlation:+.2f}: "
        + ("turned round, so that both are positive in the same turn" if sign < 0 else "same sign")
    )
    why["input"] += said
    found = {}
    for role in ROLES:
        factor = {"speed": 1.0, "input": sign / ratio, "output": 1.0}[role]
        found[role] = Proposal(role, names[role], units[role], factor, why[role])
    return found


def _require_sign(role: str, name: str, common: list[str], recordings: list[Recording]) -> None:
    """Raise InputError for a magnitude whose sign is a bit of its message."""
    if min(float(r.values[name].min()) for r in recordings) < 0:
        return
    message, _, signal = name.rpartition(".")
    for other in common:
        beside, _, bit = other.rpartition(".")
        values = np.concatenate([r.values[other] for r in recordings])
        is_bit = values.min() == 0 and values.max() == 1
        if beside == message and other != name and is_bit and SIGN_BIT.search(bit.lower()):
            raise InputError(
                "new",
                f"--{role}",
                f"{name} is never negative; {other} holds its sign",
                f"one signal with its sign, for example a table with {signal} negated where {bit} is set",
            )


def _named(
    role: str, common: list[str], recordings: list[Recording], given: str | None
) -> tuple[str, list[str]]:
    option = f"--{role}"
    if given is not None:
        if given not in common:
            raise InputError("new", option, f"no signal {given} in every log", f"one of {', '.join(common)}")
        return given, ["chosen by you"]
    moving = [n for n in common if any(np.ptp(r.values[n]) > 0 for r in recordings)]
    found = ranked(role, moving)
    if not found:
        still = ranked(role, common)
        what = f"{still[0]} never moves" if still else f"no name looks like the {role}"
        raise InputError("new", option, what, f"{option} NAME, one of {', '.join(moving or common)}")
    others = f"; others: {', '.join(found[1:4])}" if found[1:] else ""
    return found[0], [f"by its name{others}"]


def rolled_length(recordings: list[Recording], names: dict[str, str]) -> tuple[float, float]:
    """Signed wheelbase in the columns' units, and the largest correlation of v times input with the output.

    The correlation is over lags; ``names`` is the column by role. Raises InputError where nothing moves.
    """
    best = (0.0, 0.0)
    lags = round(LONGEST_LAG_S / float(np.median(np.diff(recordings[0].t))))
    for lag in range(0, lags + 1):
        a, b = [], []
        for r in recordings:
            v, u, y = (r.values[names[role]] for role in ROLES)
            if len(v) > 2 * lags:
                along = v[: len(v) - lag]
                a.append(_without(along, along * u[: len(v) - lag]))
                b.append(_without(along, y[lag:]))
        x, z = (np.concatenate(part) if part else np.zeros(2) for part in (a, b))
        if not (x.any() and z.any()):
            continue
        correlation = float(np.dot(x, z) / np.sqrt(np.dot(x, x) * np.dot(z, z)))
        if abs(correlation) > abs(best[1]):
            best = (float(np.dot(x, z) / np.dot(z, z)), correlation)
    if best[1] == 0.0:
        raise InputError("new", ", ".join(names.values()), "do not move", "logs with driving and steering")
    return best


def _without(along: np.ndarray, x: np.ndarray) -> np.ndarray:
    """x (N,) without its part along another signal (N,): the effect of a trim on v delta."""
    return x - along * (np.dot(along, x) / max(float(np.dot(along, along)), 1e-300))


def _units(
    recordings: list[Recording], names: dict[str, str], length: float, wheelbase_m: float | None
) -> tuple[dict[str, str], float, list[str]]:
    """Units, steering ratio and reasons; ``length`` is the wheelbase in the columns' units."""
    stated = {role: recordings[0].units.get(names[role], "") for role in ROLES}
    choices = [
        (stated[role],) if unit_factor(stated[role], SI[role]) else _unit_in_name(role, names[role])
        for role in ROLES
    ]
    for ratio_free in (False, True):
        for units in product(*choices):
            factors = [unit_factor(u, SI[role]) or 1.0 for u, role in zip(units, ROLES, strict=True)]
            metres = length * factors[0] * factors[1] / factors[2]
            found = dict(zip(ROLES, units, strict=True))
            if wheelbase_m is None:
                return (
                    found,
                    1.0,
                    [f"no wheelbase given: units as assumed read {metres:.3g} m; compare it with the car's"],
                )
            share = metres / wheelbase_m
            if not _possible(recordings, names, factors, share if ratio_free else 1.0):
                continue
            if not ratio_free and AS_KNOWN[0] <= share <= AS_KNOWN[1]:
                return found, 1.0, [f"the data read a wheelbase of {metres:.3g} m in these units"]
            if ratio_free and STEERING_RATIO[0] <= share <= STEERING_RATIO[1]:
                ratio = float(f"{share:.3g}")
                return found, ratio, [f"{ratio:g} times too large for road wheels: taken as steering wheel"]
    raise InputError(
        "new",
        ", ".join(names.values()),
        f"give a wheelbase of {length:.3g} in their own units, and {wheelbase_m:g} m in no known units",
        "--speed, --input and --output of this car, with their units in names or database (speed_mph)",
    )


def _unit_in_name(role: str, name: str) -> tuple[str, ...]:
    """Unit in the last words of a name, or else all likely units."""
    words = re.sub(r"[^a-z0-9]+", "_", name.lower()).strip("_")
    marked = tuple(u for u, mark in UNIT_MARKS[role].items() if re.search(rf"(^|_)({mark})$", words))
    return marked or GUESSED_UNITS[role]


def _possible(recordings: list[Recording], names: dict[str, str], factors: list[float], ratio: float) -> bool:
    """Whether a road car can reach the speeds, angles and lateral accelerations of the recordings."""
    scaled = [
        np.concatenate([np.abs(r.values[names[role]]) for r in recordings]) * factor
        for role, factor in zip(ROLES, factors, strict=True)
    ]
    speed, angle, lateral = (
        float(np.quantile(x, 0.99)) for x in (scaled[0], scaled[1] / ratio, scaled[0] * scaled[2])
    )
    return speed <= FASTEST_MPS and angle <= LARGEST_ROAD_WHEEL_RAD and lateral <= LARGEST_LATERAL_MPS2
