"""Identify speed, steering and yaw rate among a log's signals, by name, then by the data's unit and sign.

A unit that the log or its database states counts first, then one in the name (`drives/unit_names.py`). What
is left open is decided by physics (`readings.py`), or asked.
"""

import re
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from difflib import get_close_matches

import numpy as np

from ..base.errors import InputError
from ..can.sign_bits import SIGN_BIT
from ..drives.unit_names import BRACKETS, split_name, tokens, unit_of_text, units_in_name, without_unit
from ..drives.units import unit_factor
from ..vehicle.physics import STANDARD_GRAVITY
from .readings import ROLES, Known, Lateral, decided
from .steady_turn import Driven, steady_turn
from .words import (
    ACCELERATION,
    FRACTION,
    GREEK,
    MEASURED_MESSAGE,
    NEVER,
    NEVER_IN,
    NO_ANGLE,
    NO_MEASUREMENT,
    NOT,
    OF_PATHS,
    OTHERS_MESSAGE,
    REQUEST,
    ROAD_WHEEL,
    STEERING_WHEEL,
    WHEEL,
    WITH_UNIT,
    WORDS,
)

NO_SIGNALS_UNIT = re.compile(r"Nm|rpm|r/min|%|V|A|Amps|minute|ms|s|pulses|counts|ticks", re.IGNORECASE)
"""Units of other things."""
FULL_LOCK, HELD = (1.0, 100.0), 5
"""A steering without a unit that stays at one of these largest values for so many samples is a share."""
WHAT = {"speed": "speed", "input": "steering angle", "output": "yaw rate"}
"""By role: what its signal measures."""
GUESSED_UNITS = {"speed": ("m/s", "km/h", "mph"), "input": ("rad", "deg"), "output": ("rad/s", "deg/s")}
"""Units of a signal whose log and name state none."""
RATE_OF = {"deg": "deg/s", "rad": "rad/s", "mrad": "mrad/s"}
"""A yaw rate whose unit leaves the second out."""
PART = 0.2
"""Largest spread of these digits, as a share of the coarse signal's."""
MOST_NAMES = 40
"""So many signals a message names."""
FOLDS = 5
"""A signal that is never negative and comes back to 0 so often is a magnitude."""
FOLLOWS, BLOCK_S = 0.9, 1.0
"""Least correlation of a lateral acceleration with speed times yaw rate, averaged over blocks [s]."""
LEAST_SAMPLES = 20
"""A recording with fewer samples of all three signals says nothing."""


@dataclass(frozen=True)
class Recording:
    """Signals of one log on one time axis: t (N,) [s], values (N,) by name, and units ("" if unknown).

    A value is NaN where a signal has none yet or no more."""

    name: str
    t: np.ndarray
    values: dict[str, np.ndarray]
    units: dict[str, str]
    steps_s: dict[str, float] = field(default_factory=dict)
    """Time from one value of a signal to the next, as far as it is known."""


@dataclass(frozen=True)
class Proposal:
    """A signal for a role: SI value = factor * signal in ``unit``; ``why`` holds sentences.

    ``plus``: signals of its message that are added, the digits beyond its resolution."""

    role: str
    name: str
    unit: str
    factor: float
    why: list[str]
    plus: tuple[str, ...] = ()


def called(words: re.Pattern[str], names: Iterable[str]) -> Iterator[str]:
    """Names that hold one of the words, and tell of a measurement."""
    for name in names:
        low = "_".join(tokens(split_name(name)[1]))
        if words.search(low) and not (NO_MEASUREMENT.search(low) or REQUEST.search(low)):
            yield name


def ranked(role: str, names: Iterable[str], units: Mapping[str, str] | None = None) -> list[str]:
    """Names that may have the role, the likeliest first; ``units``: those that are stated, by name."""
    scores = {}
    for name in names:
        message, last = split_name(name.translate(GREEK))
        low = re.sub(r"[\s/-]+", "_", last.lower())
        unit = (units or {}).get(name, "")
        if NO_MEASUREMENT.search(low) or re.search(NEVER[role], low):
            continue
        if re.search(NEVER_IN[role], message.lower()):
            continue
        sure, may = WORDS[role]
        plain = without_unit(last, role)
        certain = bool(re.search(sure, low) or re.search(sure, plain))
        paths = (name.lower(), f"{message}.{plain}".lower())
        of_path = (re.search(OF_PATHS[role], re.sub(r"[^a-z0-9]+", "_", path)) for path in paths)
        is_path = any(of_path)
        of_twist = 0.25 * (is_path and role != "input" and re.search(r"[xz]$", low) is not None)
        certain = certain or of_twist > 0
        likely = is_path or bool(re.search(may, low) or re.search(may, plain))
        stated, in_name = _unit(unit, role) is not None, bool(units_in_name(last, role))
        if role == "speed":
            likely = likely or in_name
        if certain or likely or ((stated or in_name) and re.search(WITH_UNIT.get(role, "$^"), low)):
            other = OTHERS_MESSAGE.search(message.lower()) and not MEASURED_MESSAGE.search(message.lower())
            less = 1.5 * bool(re.search(NOT[role], low)) + 0.5 * bool(other)
            less += 0.5 * (role == "speed" and WHEEL.search(low) is not None)
            less += 3.0 * (REQUEST.search(low) is not None) + 2.0 * _of_another(unit, role)
            scores[name] = (2 if certain else 1) - less + of_twist + 1.25 * stated
    return sorted(scores, key=lambda name: (-scores[name], len(name), name))


def _of_another(unit: str, role: str) -> bool:
    """Return whether a stated unit says that a signal cannot have the role."""
    if not unit.strip() or _unit(unit, role):
        return False
    return _of_another_role(unit, role) or NO_SIGNALS_UNIT.fullmatch(unit.strip()) is not None


def proposed(
    recordings: list[Recording],
    chosen: Mapping[str, str | None],
    known: Known,
    units: Mapping[str, str | None] | None = None,
) -> dict[str, Proposal]:
    """A signal a role, of those that all recordings hold.

    ``chosen``, ``units``: role -> name and unit that the user states, or None. InputError where nothing fits
    a role, or where units cannot be told.
    """
    common = [n for n in recordings[0].values if all(n in r.values for r in recordings)]
    names, why = {}, {}
    for role in ROLES:
        names[role], why[role] = _named(role, common, recordings, chosen.get(role))
    if len(set(names.values())) < len(names):
        twice = next(n for n in names.values() if list(names.values()).count(n) > 1)
        options = ", ".join(f"--{role}" for role in ROLES if names[role] == twice)
        raise InputError("new", options, f"{twice} is both", "a signal of its own for each")
    fine = {role: _fine_parts(names[role], common, recordings) for role in ROLES}
    for role, parts in fine.items():
        if parts:
            why[role].append(f"{' and '.join(parts)} added, the digits beyond its resolution")
            recordings = [_added(r, names[role], parts) for r in recordings]
    for role in ("input", "output"):
        _require_sign(role, names[role], common, recordings)
    _require_no_magnitudes(
        {r: names[r] for r in ("input", "output") if chosen.get(r) is None}, names, recordings
    )
    choices = {}
    for role in ROLES:
        choices[role], evidence = _choices(role, names[role], recordings, (units or {}).get(role))
        why[role] += evidence
    drives = [d for r in recordings if len((d := _together(r, names)).t) > LEAST_SAMPLES]
    if not drives:
        raise InputError(
            "new", ", ".join(names.values()), "are nowhere recorded at the same time", "one clock for all"
        )
    if all(np.quantile(d.v, 0.9) <= 0 for d in drives):
        raise InputError("new", "--speed", f"{names['speed']} is not positive", "a speed, positive ahead")
    turn = steady_turn(drives)
    known = replace(known, at_steering_wheel=at_steering_wheel(names["input"]))
    certain = [role for role in ROLES if (units or {}).get(role) is not None]
    lateral = _lateral(recordings, names, common)
    reading, unit_evidence = decided(turn, drives, choices, known, certain, lateral)
    sign = -1.0 if turn is not None and turn.length[0] < 0 else 1.0
    why["input"].append(
        f"in a turn it and {names['output']} have "
        + ("opposite signs: turned round, so that both are positive" if sign < 0 else "the same sign")
    )
    why["input"] += unit_evidence
    factors = {"speed": 1.0, "input": sign / reading.ratio, "output": 1.0}
    return {
        role: Proposal(role, names[role], reading.units[role], factors[role], why[role], fine[role])
        for role in ROLES
    }


def _lateral(recordings: list[Recording], names: Mapping[str, str], common: list[str]) -> Lateral | None:
    """The lateral acceleration of the log that follows speed times yaw rate the best; None without one."""
    candidates: list[tuple[float, Lateral]] = []
    for name in called(ACCELERATION, common):
        if name in names.values():
            continue
        parts = []
        for r in recordings:
            rows = max(1, round(BLOCK_S / float(np.median(np.diff(r.t)))))
            columns = np.array([r.values[n] for n in (names["speed"], names["output"], name)])
            count = columns.shape[1] // rows
            v, yaw, a = columns[:, : count * rows].reshape(3, count, rows).mean(axis=2)
            both = np.array([v * yaw, a])[:, np.isfinite(v * yaw * a)]
            parts.append(both - both.mean(axis=1, keepdims=True) if both.size else both)
        across, a = np.concatenate(parts, axis=1)
        scale = float(np.sqrt((across @ across) * (a @ a))) if len(a) >= LEAST_SAMPLES else 0.0
        if scale > 0 and (correlation := abs(float(across @ a)) / scale) >= FOLLOWS:
            stated = {u for r in recordings if (u := r.units.get(name, "").strip())}
            stated |= set(BRACKETS.findall(name))
            factors = [f for u in stated if (f := unit_factor(u, "m/s2"))] or [1.0, STANDARD_GRAVITY]
            slope = float(np.sqrt(a @ a / (across @ across)))
            candidates.append((correlation, Lateral(name, slope, tuple(factors))))
    return max(candidates, key=lambda pair: pair[0])[1] if candidates else None


def _fine_parts(name: str, common: list[str], recordings: list[Recording]) -> tuple[str, ...]:
    """Signals of the same message and unit that a car adds to a coarse one, as a fraction of its step."""
    message, last = split_name(name)
    first = tokens(last)[0]

    def spread(signal: str) -> float:
        return max(float(np.nanmax(r.values[signal]) - np.nanmin(r.values[signal])) for r in recordings)

    def is_part(other: str) -> bool:
        other_message, low = split_name(other.lower())
        same = (
            other_message == message.lower()
            and tokens(low)[:1] == [first]
            and FRACTION.search(low) is not None
        )
        units = {r.units.get(n, "") for r in recordings for n in (name, other)}
        return same and other != name and len(units) == 1 and 0 < spread(other) < PART * spread(name)

    return tuple(other for other in common if message and is_part(other))


def _added(recording: Recording, name: str, parts: tuple[str, ...]) -> Recording:
    """The recording with the sum of a signal and its parts in place of the signal."""
    total = sum((recording.values[part] for part in parts), recording.values[name])
    return replace(recording, values={**recording.values, name: total})


def _together(recording: Recording, names: Mapping[str, str]) -> Driven:
    """The samples of a recording at which all three signals have a value."""
    columns = np.array([recording.t, *(recording.values[names[role]] for role in ROLES)])
    return Driven(*columns[:, np.isfinite(columns).all(axis=0)])


def _choices(
    role: str, name: str, recordings: list[Recording], chosen: str | None
) -> tuple[tuple[str, ...], list[str]]:
    """The units that are possible for a signal, and where from. InputError where two sources differ."""
    if chosen is not None:
        unit = _unit(chosen, role)
        if unit is None:
            raise InputError(
                "new", f"--{role}-unit", chosen, f"a unit such as {', '.join(GUESSED_UNITS[role])}"
            )
        return (unit,), [f"unit {unit} as you say"]
    stated = sorted({u for r in recordings if (u := r.units.get(name, "").strip())})
    option = f"--{role}-unit"
    one = f"--{role} NAME, or {option} with what 1 of it is, as {option} '0.02 {GUESSED_UNITS[role][0]}'"
    if role == "input" and (word := NO_ANGLE.search(re.sub(r"[\s.-]+", "_", name.lower()))):
        raise InputError(
            "new",
            name,
            f"its name says {word[0].strip('_')}, and no angle",
            f"{one}; a middle that is not 0 is the `offset` of a signal map (lpvguard ingest --signals)",
        )
    if len(stated) > 1:
        raise InputError(
            "new", name, f"the logs state the units {' and '.join(stated)}", f"one unit, or --{role}-unit"
        )
    in_name = units_in_name(name, role)
    by_log = _unit(stated[0], role) if stated else None
    if stated and by_log is None:
        if _of_another_role(stated[0], role) or NO_SIGNALS_UNIT.fullmatch(stated[0]):
            raise InputError("new", name, f"its unit is {stated[0]}, none of a {WHAT[role]}", one)
        if not in_name:
            return GUESSED_UNITS[role], [f"its unit {stated[0]} is not known"]
    units = [by_log] if by_log else in_name
    if len({*units, *in_name}) > 1:
        where = (
            f"the log states {by_log}, its name {' and '.join(in_name)}" if by_log else " and ".join(in_name)
        )
        raise InputError("new", name, f"two units: {where}", f"--{role}-unit")
    if units:
        source = f"the log states {stated[0]}" if by_log else "by its name"
        return (units[0],), [f"unit {units[0]}, {source}"]
    if elsewhere := next((u for r in reversed(ROLES) if r != role for u in units_in_name(name, r)), None):
        raise InputError("new", name, f"its name states {elsewhere}, none of a {WHAT[role]}", one)
    largest = max(float(np.nanmax(np.abs(r.values[name]))) for r in recordings)
    held = max(int((np.abs(r.values[name]) == largest).sum()) for r in recordings)
    if role == "input" and largest in FULL_LOCK and held >= HELD:
        what = f"stays at {largest:g}, its largest value, as a share of full lock does"
        raise InputError("new", name, what, f"--input-unit rad or deg where it is an angle, or {one}")
    return GUESSED_UNITS[role], []


def _unit(text: str, role: str) -> str | None:
    """The unit of a role that a text spells; of a yaw rate also where it leaves the second out."""
    return unit_of_text(text, role) or (
        RATE_OF.get(unit_of_text(text, "input") or "") if role == "output" else None
    )


def _of_another_role(text: str, role: str) -> bool:
    """Return whether a text is a unit, though not one of the role."""
    return any(unit_of_text(text, other) is not None for other in ROLES if other != role)


def at_steering_wheel(name: str) -> bool | None:
    """Return whether a name says that its angle is the steering wheel's; None where it says nothing."""
    low = "_".join(tokens(name))
    wheel, road = STEERING_WHEEL.search(low) is not None, ROAD_WHEEL.search(low) is not None
    return None if wheel == road else wheel


def _require_sign(role: str, name: str, common: list[str], recordings: list[Recording]) -> None:
    """Raise InputError where a signal is a magnitude whose sign stands in a bit of its message."""
    if min(float(np.nanmin(r.values[name])) for r in recordings) < 0:
        return
    message, signal = split_name(name)
    for other in common:
        beside, bit = split_name(other)
        values = np.concatenate([r.values[other] for r in recordings])
        is_bit = np.nanmin(values) == 0 and np.nanmax(values) == 1
        if beside == message and other != name and is_bit and SIGN_BIT.search(bit.lower()):
            raise InputError(
                "new",
                f"--{role}",
                f"{name} is never negative; {other} holds its sign",
                f"one signal with its sign, for example a table with {signal} negated where {bit} is set",
            )


def _require_no_magnitudes(
    proposed: Mapping[str, str], names: Mapping[str, str], recordings: list[Recording]
) -> None:
    """Raise InputError where steering or yaw rate, or both, are magnitudes, which turn back at 0."""
    folded = [
        role for role, name in proposed.items() if _folds([r.values[name] for r in recordings]) >= FOLDS
    ]
    signed = any(np.mean(r.values[names[role]] < 0) > 0.1 for r in recordings for role in ("input", "output"))
    if len(folded) == 2 or (folded and signed):
        said = " and ".join(names[role] for role in folded)
        raise InputError(
            "new",
            ", ".join(f"--{role}" for role in folded),
            f"{said}: never negative, though near 0 many times",
            "signals with their signs, or these options with the names where all turns were to one side",
        )


def _folds(values: list[np.ndarray]) -> int:
    """How often a signal comes back to 0 from a third of its size; 0 where it is ever negative."""
    known = [x[np.isfinite(x)] for x in values]
    if min(x.min(initial=0.0) for x in known) < 0:
        return 0
    large = float(np.quantile(np.concatenate(known), 0.99))
    away = [x[(x < 0.05 * large) | (x > 0.3 * large)] > 0.3 * large for x in known]
    return sum(int((a[:-1] & ~a[1:]).sum()) for a in away)


def _some(names: Sequence[str]) -> str:
    """The first names, and how many more there are."""
    more = f" and {len(names) - MOST_NAMES} more" if len(names) > MOST_NAMES else ""
    return ", ".join(names[:MOST_NAMES]) + more


def _varies(value: np.ndarray) -> bool:
    """Return whether a signal has more than two values; a switch has two."""
    value = value[np.isfinite(value)]
    return len(value) > 0 and bool(((value > value.min()) & (value < value.max())).any())


def _named(
    role: str, common: list[str], recordings: list[Recording], chosen: str | None
) -> tuple[str, list[str]]:
    option = f"--{role}"
    if chosen is not None:
        if chosen not in common:
            near = get_close_matches(chosen, common, n=3) or common
            raise InputError("new", option, f"no signal {chosen} in every log", f"one of {_some(near)}")
        return chosen, ["chosen by you"]
    moving = [n for n in common if any(_varies(r.values[n]) for r in recordings)]
    units = {n: u for r in recordings for n, u in r.units.items()}
    candidates = ranked(role, moving, units)
    if not candidates:
        still = ranked(role, common, units)
        what = f"{still[0]} never moves" if still else f"no name looks like the {role}"
        raise InputError("new", option, what, f"{option} NAME, one of {_some(moving or common)}")
    others = f"; others: {', '.join(candidates[1:4])}" if candidates[1:] else ""
    asked_for = REQUEST.search(split_name(candidates[0])[1].lower())
    command = ", which says a command and no measurement" if asked_for else ""
    return candidates[0], [f"by its name{command}{others}"]
