"""Readings of three columns: which units and which steering ratio make physics of them.

Every combination of units that name and log leave open is held against the ranges of a kind of vehicle. One
that fits is taken; where two do, the user is asked for the option that settles it.
"""

import shlex
import warnings
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import product

import numpy as np

from ..base.errors import InputError, InputWarning
from ..drives.unit_names import DIMENSIONS
from ..drives.units import unit_factor
from ..vehicle.physics import KINDS, KindName, VehicleKind, degrees_per_g
from .steady_turn import Driven, SteadyTurn

ROLES = ("speed", "input", "output")
KNOWN_WITHIN = {"car": 1.25, "truck": 1.25, "model": 1.5, "other": 1.5}
STATED_WITHIN = 1.45
"""The wheelbase that the columns read, over the known one or the other way, is at most this. Model cars
slide; where all units are stated, only a wrong unit is larger."""
DOUBTFUL = 1.4
"""A reading whose lateral acceleration exceeds the kind's by no more may still be meant."""
CREEPING = 0.05
"""A reading whose largest lateral acceleration is below this share of the kind's is doubtful."""
LEAST_LATERAL_MPS2 = {"car": 0.1, "truck": 0.1, "model": 0.35, "other": 0.1}
LEAST_ANGLE_RAD = 0.01
"""If 99 % of a log stay below both, nobody steered, or degrees would be read as radians."""
FULL_LOCK_RAD = (0.3, 0.7)
"""Full lock of road wheels."""
USUAL_UNITS = {"speed": ("m/s", "km/h", "mph", "kn"), "input": ("rad", "deg"), "output": ("rad/s", "deg/s")}
"""Units with which one that a log states is compared."""
TYPICAL = {"car": (15.5, 2.5), "truck": (20.0, 1.5)}
"""By kind: usual steering ratio, and largest lateral acceleration [m/s^2] of a log."""
SPREAD_OF_RATIOS, SPREAD_OF_LENGTHS, SPREAD_OF_LATERAL, SPREAD_OF_SPEEDS = 0.15, 0.1, 0.6, 0.7
"""Standard deviations of logarithms. The length is the one that the columns read, over the known one."""
USUAL_SPEED_MPS, USUAL_UNDERSTEER = 15.0, (2.5, 1.7)
"""Largest speed of a log; mean and standard deviation of the understeer [deg/g]."""
KNOTS = 2.0
"""The same logarithm for knots in place of another unit: few loggers of cars have them."""
DOUBTED = 2.0
"""Logarithm of the likelihood ratio from which another reading casts doubt on a stated unit."""
NEAR = 1.5
"""The same logarithm up to which another unit of the speed is asked about."""
UNCERTAIN = 1.5
"""Largest over smallest of the likely steering ratios from which on they are named."""
ACCELERATION_WITHIN = 1.35
"""A lateral acceleration is speed times yaw rate within this factor; the body's roll adds a tenth."""
SHORT_S = 10.0
"""A shorter log may hold no driving."""
LEAST_EXPLAINED = 0.3
"""Columns that explain less of the yaw rate say nothing of their units."""


@dataclass(frozen=True)
class UnitReading:
    """Units by role, and steering wheel over road wheel, which is 1 at the road wheels.

    ``beyond`` says as a logarithm how far outside of physics the columns then are, ``why`` in words.
    ``atypical`` is the negative logarithm of its likelihood among vehicles and logs of its kind."""

    units: Mapping[str, str]
    ratio: float
    wheelbase_m: float
    understeer_deg_g: float
    lateral_mps2: float
    beyond: float
    why: tuple[str, ...]
    atypical: float = 0.0
    share: float | None = None
    """Full lock [rad] of a steering without a unit, of which it is a share."""

    def words(self) -> str:
        """The reading in words."""
        at = "road wheels" if self.ratio == 1.0 else f"a steering wheel of {self.ratio:.3g}:1"
        steering = f"in {self.units['input']}" if self.share is None else "as a share of full lock"
        return (
            f"speed in {self.units['speed']}, steering {steering} at {at}, yaw rate in "
            f"{self.units['output']} (wheelbase {self.wheelbase_m:.3g} m, understeer "
            f"{self.understeer_deg_g:.2g} deg/g)"
        )


@dataclass(frozen=True)
class Known:
    """Known properties of the vehicle: kind, wheelbase [m], steering ratio. None: not known."""

    kind: KindName
    wheelbase_m: float | None = None
    ratio: float | None = None
    at_steering_wheel: bool | None = None
    """Whether the steering's name says that it is the steering wheel's; None where it does not."""


@dataclass(frozen=True)
class Lateral:
    """A lateral acceleration of the log. ``slope`` is its size over that of speed times yaw rate, in units of
    the columns. ``units`` [m/s^2] are those that it may be in."""

    name: str
    slope: float
    units: tuple[float, ...]


def decided(
    turn: SteadyTurn | None,
    drives: Sequence[Driven],
    choices: Mapping[str, Sequence[str]],
    known: Known,
    certain: Collection[str] = ROLES,
    lateral: Lateral | None = None,
) -> tuple[UnitReading, list[str]]:
    """The one reading that fits, and its evidence in sentences. InputError where none fits, or more than one,
    or where another one is much likelier than the stated one.

    ``choices``: role -> units that are possible; ``certain``: roles whose unit the user states.
    """
    if turn is None or not np.isfinite(turn.length).all():
        longest = max(float(d.t[-1] - d.t[0]) for d in drives)
        what = "speed, steering and yaw rate do not move"
        if longest < SHORT_S:
            what = f"the longest log lasts {longest:.3g} s"
        raise InputError("new", "LOG", what, f"logs of {SHORT_S:g} s and more, with driving and steering")
    largest = _largest(drives)
    stated = all(len(choices[role]) == 1 for role in ROLES)
    within = STATED_WITHIN if stated else KNOWN_WITHIN[known.kind]
    measured = _Measured(turn, largest, known, within, lateral)
    candidates = _sorted(measured, choices, _wheels(known))
    if turn.explained < LEAST_EXPLAINED and not (stated and candidates[0].beyond == 0.0):
        raise InputError(
            "new",
            "--speed, --input, --output",
            f"steering explains {max(turn.explained, 0.0):.0%} of the yaw rate: the columns say nothing of "
            "their units",
            "the columns of one vehicle on one clock, or " + ", ".join(_unit_options(choices)),
        )
    shares = _shares(measured, drives, choices)
    near = _fitting(candidates, KINDS[known.kind]) + [r for r in shares if r.beyond == 0.0]
    said = "; or ".join(r.words() for r in near[:3])
    if len(near) > 1 or any(r.share for r in near):
        raise InputError(
            "new",
            _differing(near),
            f"{len(near) if near[1:] else 'no more'} readings fit: {said}",
            " or ".join(dict.fromkeys(_settles(r, near) for r in near)),
        )
    best = candidates[0]
    kind = "vehicle" if known.kind == "other" else known.kind
    if best.beyond > 0.0 or best.lateral_mps2 > KINDS[known.kind].lateral_mps2:
        reasons = ", ".join(best.why) or f"lateral accelerations of {best.lateral_mps2:.3g} m/s^2"
        raise InputError(
            "new",
            "--speed, --input, --output",
            f"no units make a {kind} of them; the nearest: {best.words()}, but {reasons}",
            "the signals of this vehicle, --kind, --wheelbase, or " + ", ".join(_unit_options(choices)),
        )
    if best.ratio != 1.0 and known.wheelbase_m is None and known.ratio is None:
        raise InputError(
            "new",
            "--wheelbase",
            f"not given, and the steering is at a steering wheel: {best.words()}",
            "the wheelbase in m, or --steering-ratio",
        )
    _require_usual(best, measured, choices, certain)
    other = None if "speed" in certain else _another_speed(best, measured)
    _warn_of_ratio(best, measured)
    return best, _evidence(turn, candidates, known, other)


@dataclass(frozen=True)
class _Measured:
    """Quantities of the columns, and what is known: ``largest`` speed, steering, and speed times yaw rate."""

    turn: SteadyTurn
    largest: tuple[float, float, float]
    known: Known
    within: float
    lateral: Lateral | None


def _sorted(
    measured: _Measured, choices: Mapping[str, Sequence[str]], wheels: Sequence[bool]
) -> list[UnitReading]:
    """All readings, the nearest to physics first."""
    readings = [
        _reading(measured, dict(zip(ROLES, units, strict=True)), wheel)
        for units in product(*(choices[role] for role in ROLES))
        for wheel in wheels
    ]
    return sorted(readings, key=lambda reading: reading.beyond)


def _fitting(candidates: Sequence[UnitReading], kind: VehicleKind) -> list[UnitReading]:
    """Readings within physics; beside one that only creeps also faster ones that are slightly beyond."""
    fitting = [r for r in candidates if r.beyond == 0.0]
    if len(fitting) == 1 and (slow := fitting[0].lateral_mps2) < CREEPING * kind.lateral_mps2:
        slightly = [r for r in candidates if 0.0 < r.beyond <= np.log(DOUBTFUL)]
        fitting += [r for r in slightly if r.lateral_mps2 > 10 * slow]
    return fitting


def _require_usual(
    best: UnitReading, measured: _Measured, choices: Mapping[str, Sequence[str]], certain: Collection[str]
) -> None:
    """Raise InputError where another unit than one that the log states, or another place of the steering than
    its name says, makes a much likelier vehicle. What the user states is only warned of."""
    known = measured.known
    if known.kind not in TYPICAL or known.wheelbase_m is None:
        return
    units = {role: tuple(dict.fromkeys((*choices[role], *USUAL_UNITS[role]))) for role in ROLES}
    anywhere = _wheels(replace(known, at_steering_wheel=None))
    asked = {role: choices[role] if role in certain else units[role] for role in ROLES}
    for others, wheels in ((asked, _wheels(known) if "input" in certain else anywhere), (units, anywhere)):
        likely = [r for r in _sorted(measured, others, wheels) if r.beyond == 0.0]
        other = min(likely, key=lambda r: r.atypical, default=best)
        if other.atypical >= best.atypical - DOUBTED:
            continue
        what = f"the stated units make an unusual {known.kind}: {best.words()}; more likely: {other.words()}"
        near = [best, other]
        settles = " or ".join(_settles(r, near) for r in near)
        if others is asked:
            raise InputError("new", _differing(near), what, settles)
        warnings.warn(f"{what}; {settles} says which", InputWarning, stacklevel=1)


def _another_speed(best: UnitReading, measured: _Measured) -> UnitReading | None:
    """The likeliest reading with another unit of the speed alone; None where none is possible.

    Where ratio or understeer is not known, it makes up for miles in place of kilometres. Raise InputError
    where the reading is about as likely. Knots are too near to miles to doubt."""
    known = measured.known
    if known.kind not in TYPICAL or known.ratio is not None:
        return None
    alike = ("kn", "mph") if best.units["speed"] == "kn" else ("kn", best.units["speed"])
    speeds = [u for u in USUAL_UNITS["speed"] if u not in alike]
    choices = {role: [unit] for role, unit in best.units.items()} | {"speed": speeds}
    possible = [r for r in _sorted(measured, choices, _wheels(known)) if r.beyond == 0.0]
    other = min(possible, key=lambda r: r.atypical, default=None)
    if other is not None and _likelier(best, other) < NEAR:
        raise InputError(
            "new",
            "--speed-unit",
            f"another unit of the speed is about as likely: {best.words()}; or {other.words()}",
            " or ".join(_settles(r, [best, other]) for r in (best, other)),
        )
    return other


def _warn_of_ratio(best: UnitReading, measured: _Measured) -> None:
    """Warn where logs at one speed, or with little steering, leave the steering ratio open."""
    known, turn, kind = measured.known, measured.turn, KINDS[measured.known.kind]
    if best.ratio == 1.0 or known.ratio is not None or known.wheelbase_m is None or kind.ratio is None:
        return
    a, b, c = (unit_factor(best.units[role], DIMENSIONS[role]) or 1.0 for role in ROLES)
    ratios = np.clip(np.abs(turn.length) * a * b / c / known.wheelbase_m, *kind.ratio)
    if ratios.max() > UNCERTAIN * ratios.min():
        what = f"steering ratios from {ratios.min():.3g} to {ratios.max():.3g} explain the logs about as well"
        settles = f"{best.ratio:.3g} is taken; --steering-ratio, or logs at more speeds, settle it"
        warnings.warn(f"{what}; {settles}", InputWarning, stacklevel=1)


def _likelier(best: UnitReading, other: UnitReading) -> float:
    """How much likelier a reading is than another, as a logarithm. Knots are as usual here as other units."""
    return other.atypical - best.atypical + KNOTS * (best.units["speed"] == "kn")


def _evidence(
    turn: SteadyTurn, candidates: Sequence[UnitReading], known: Known, other: UnitReading | None
) -> list[str]:
    """Sentences for the first of the readings that remain, and for one with another unit of the speed."""
    best = candidates[0]
    evidence = [f"{turn.explained:.0%} of the yaw rate explained, {best.words()}"]
    if known.wheelbase_m is None:
        evidence.append(f"no wheelbase given: compare {best.wheelbase_m:.3g} m with the vehicle's")
    if other is not None:
        rarer = np.exp(min(_likelier(best, other), 20.0))
        evidence.append(f"{rarer:.2g} times rarer: {other.words()}")
    if len(candidates) > 1:
        evidence.append(f"next best: {candidates[1].words()}, but {', '.join(candidates[1].why)}")
    return evidence


def _shares(
    measured: _Measured, drives: Sequence[Driven], choices: Mapping[str, Sequence[str]]
) -> list[UnitReading]:
    """Readings of a steering between -1 and 1 as a share of full lock, which follows from the wheelbase."""
    known = measured.known
    steered = np.abs(np.concatenate([d.delta for d in drives]))
    if (
        len(choices["input"]) == 1
        or known.at_steering_wheel
        or (known.ratio or 1.0) != 1.0
        or np.quantile(steered, 0.999) > 1.0
    ):
        return []
    wheelbase = known.wheelbase_m or float(np.sqrt(np.prod(KINDS[known.kind].wheelbase_m)))
    readings = []
    for speed, output in product(choices["speed"], choices["output"]):
        a, c = (unit_factor(u, DIMENSIONS[r]) or 1.0 for u, r in ((speed, "speed"), (output, "output")))
        lock = wheelbase * c / (abs(float(measured.turn.length[0])) * a)
        if FULL_LOCK_RAD[0] <= lock <= FULL_LOCK_RAD[1]:
            units = {"speed": speed, "input": f"{lock:.2g} rad", "output": output}
            readings.append(replace(_reading(measured, units, False), share=lock))
    return readings


def _wheels(known: Known) -> tuple[bool, ...]:
    """Return whether the steering is that of a steering wheel: what remains possible."""
    if known.ratio is not None:
        return (known.ratio != 1.0,)
    if KINDS[known.kind].ratio is None:
        return (False,)
    return (False, True) if known.at_steering_wheel is None else (known.at_steering_wheel,)


def _unit_options(choices: Mapping[str, Sequence[str]]) -> list[str]:
    return [f"--{role}-unit" for role in ROLES if len(choices[role]) > 1] or ["--steering-ratio"]


def _differing(near: Sequence[UnitReading]) -> str:
    """The options whose value differs among readings."""
    names = [f"--{role}-unit" for role in ROLES if len({r.units[role] for r in near}) > 1]
    return ", ".join(names or ["--steering-ratio"])


def _settles(reading: UnitReading, near: Sequence[UnitReading]) -> str:
    """The options that leave one reading of several."""
    options = [
        f"--{role}-unit {shlex.quote(reading.units[role])}"
        for role in ROLES
        if len({r.units[role] for r in near}) > 1
    ]
    if not options or sum(r.units == reading.units for r in near) > 1:
        options.append(f"--steering-ratio {reading.ratio:.3g}")
    return " ".join(options)


def _largest(drives: Sequence[Driven]) -> tuple[float, float, float]:
    """99th percentiles of speed, steering and speed times yaw rate, in the columns' units."""
    v, delta, across = (
        np.concatenate(parts) for parts in zip(*(_magnitudes(d) for d in drives), strict=True)
    )
    return tuple(float(np.quantile(x, 0.99)) for x in (v, delta, across))  # type: ignore[return-value]


def _magnitudes(d: Driven) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return |speed|, |steering| and |speed times yaw rate|, (N,) each, the last two about their medians."""
    turned, yaw = d.delta - np.median(d.delta), d.r - np.median(d.r)
    return np.abs(d.v), np.abs(turned), np.abs(d.v * yaw)


def _reading(measured: _Measured, units: dict[str, str], wheel: bool) -> UnitReading:
    """One combination of units; of the likely spreads the one with which it is the nearest to physics."""
    turn, largest, known, within = measured.turn, measured.largest, measured.known, measured.within
    kind = KINDS[known.kind]
    a, b, c = (unit_factor(units[role], DIMENSIONS[role]) or 1.0 for role in ROLES)
    best: UnitReading | None = None
    atypical = np.inf
    for length, spread in zip(np.abs(turn.length), turn.spread, strict=True):
        read = float(length) * a * b / c
        ratio, wheelbase = _steering(read, wheel, known, kind)
        understeer = degrees_per_g(float(spread) * wheelbase / a**2)
        speed, angle, lateral = largest[0] * a, largest[1] * b / ratio, largest[2] * a * c
        reasons = [
            _beyond(f"wheelbase {wheelbase:.3g} m", wheelbase, *_wheelbases(known, kind, within)),
            _beyond(f"steering ratio {ratio:.3g}", ratio, *_ratios(wheel, known, kind)),
            _beyond_by(f"understeer {understeer:.2g} deg/g", understeer, *kind.understeer_deg_g),
            _beyond(f"speeds of {speed:.3g} m/s", speed, *kind.speed_mps),
            _beyond(f"road wheels turned by {angle:.2g} rad", angle, 0.0, kind.angle_rad),
            _beyond(
                f"lateral accelerations of {lateral:.3g} m/s^2", lateral, 0.0, DOUBTFUL * kind.lateral_mps2
            ),
        ]
        if measured.lateral is not None:
            reasons.append(_unlike(measured.lateral, a * c))
        if angle < LEAST_ANGLE_RAD:
            least = LEAST_LATERAL_MPS2[known.kind]
            reasons.append(_beyond(f"lateral accelerations of {lateral:.1g} m/s^2", lateral, least, np.inf))
        beyond = sum(size for size, _ in reasons)
        unlikely = _atypical(known, (ratio if wheel else None, read / ratio), understeer, lateral, speed)
        if best is None or beyond < best.beyond:
            why = tuple(text for size, text in reasons if size > 0)
            best = UnitReading(units, ratio, wheelbase, understeer, lateral, beyond, why)
            atypical = unlikely
        elif beyond == best.beyond:
            atypical = min(atypical, unlikely)
    assert best is not None
    return replace(best, atypical=atypical + KNOTS * (units["speed"] == "kn"))


def _atypical(
    known: Known, steering: tuple[float | None, float], understeer: float, lateral: float, speed: float
) -> float:
    """The negative logarithm of the likelihood of a reading; 0 where nothing is known of the kind.

    ``steering``: ratio, None at the road wheels, and wheelbase [m]. A ratio that is known says nothing.
    """
    if known.kind not in TYPICAL or known.wheelbase_m is None:
        return 0.0
    (ratio, wheelbase), (usual_ratio, usual_lateral) = steering, TYPICAL[known.kind]
    away = [
        np.log(max(lateral, 1e-9) / usual_lateral) / SPREAD_OF_LATERAL,
        np.log(max(speed, 1e-9) / USUAL_SPEED_MPS) / SPREAD_OF_SPEEDS,
        (understeer - USUAL_UNDERSTEER[0]) / USUAL_UNDERSTEER[1],
        np.log(wheelbase / known.wheelbase_m) / SPREAD_OF_LENGTHS,
    ]
    if ratio is not None and known.ratio is None:
        away.append(np.log(ratio / usual_ratio) / SPREAD_OF_RATIOS)
    return 0.5 * float(np.square(away).sum())


def _unlike(lateral: Lateral, scale: float) -> tuple[float, str]:
    """How far a lateral acceleration is from speed times yaw rate, which are ``scale`` times the columns'."""
    sizes = [lateral.slope * unit / scale for unit in lateral.units]
    size = min(sizes, key=lambda x: abs(np.log(x)))
    beyond = max(abs(float(np.log(size))) - float(np.log(ACCELERATION_WITHIN)), 0.0)
    return beyond, f"{lateral.name} is {size:.2g} times speed times yaw rate" if beyond else ""


def _steering(read: float, wheel: bool, known: Known, kind: VehicleKind) -> tuple[float, float]:
    """Steering ratio and wheelbase [m], where the columns read a wheelbase of ``read`` at ratio 1."""
    if not wheel:
        return 1.0, read
    if known.ratio is not None:
        return known.ratio, read / known.ratio
    if known.wheelbase_m is not None:
        return float(f"{read / known.wheelbase_m:.3g}"), known.wheelbase_m
    middle = float(np.sqrt(np.prod(kind.wheelbase_m)))
    least, most = kind.ratio or (1.0, 1.0)
    ratio = float(np.clip(read / middle, least, most))
    return ratio, read / ratio


def _wheelbases(known: Known, kind: VehicleKind, within: float) -> tuple[float, float]:
    if known.wheelbase_m is None:
        return kind.wheelbase_m
    return known.wheelbase_m / within, known.wheelbase_m * within


def _ratios(wheel: bool, known: Known, kind: VehicleKind) -> tuple[float, float]:
    return kind.ratio if wheel and known.ratio is None and kind.ratio is not None else (0.0, np.inf)


def _beyond(what: str, value: float, least: float, most: float) -> tuple[float, str]:
    """How far a value is outside of a range, as a logarithm, with the words for it."""
    if value > most:
        return float(np.log(value / most)), f"{what}, at most {most:.3g}"
    if value < least:
        return float(np.log(least / max(value, 1e-300))), f"{what}, at least {least:.3g}"
    return 0.0, ""


def _beyond_by(what: str, value: float, least: float, most: float) -> tuple[float, str]:
    """The same of a value that may be negative: over the range's width."""
    outside = max(least - value, value - most, 0.0) / (most - least)
    return outside, f"{what}, from {least:g} to {most:g}" if outside else ""
