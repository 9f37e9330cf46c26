"""Find further measurements of the yaw rate in a log: names propose them, a fit to the yaw rate decides.

They are another gyro, two wheels' speeds over the track, the lateral acceleration over the speed, and the
change of a receiver's course. Each becomes an output of the same nominal model, and
`[isolation]` tells from them which part differs (THEORY 7.21).
"""

import re
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial

import numpy as np

from ..drives.unit_names import DIMENSIONS
from ..drives.units import unit_factor
from ..vehicle.physics import STANDARD_GRAVITY
from .signals import Proposal, Recording, called, ranked
from .words import ACCELERATION, COURSE, NO_MEASUREMENT, SIDES

BLOCK_S = 1.0
"""Signals are averaged over blocks of this length: a receiver lags, and a wheel's speed is coarse."""
LEAST_BLOCKS = 20
LEAST_CORRELATION = 0.7
"""Least correlation of the blocks with the yaw rate."""
SAME = 0.9999
"""From this correlation of the samples on a signal is a copy of the yaw rate, and nothing redundant."""
WITHIN = 0.35
"""Largest distance of a fitted factor from that of a unit; noise in the yaw rate lowers it."""
TRACKS_M = (1.0, 2.6)
"""Tracks of cars and trucks [m]."""
SLOW_MPS = 3.0
"""Below this speed a course and a quotient by the speed say little."""
MOST = 3
"""Outputs beside the yaw rate; the core has room for four."""


Keys = Mapping[str, float | str | bool]


@dataclass(frozen=True)
class Redundant:
    """A further measurement of the yaw rate as a column of a drive table.

    Attributes
    ----------
    signal, column : str, name of the output and of its column
    terms : tuple of (name, Mapping), signals of the log and the keys of a term of the signal map
    keys : Mapping, further keys of the column
    speed_power : int, power of the measured speed in it
    why : str
    """

    signal: str
    column: str
    terms: tuple[tuple[str, Keys], ...]
    keys: Keys
    speed_power: int
    why: str


@dataclass(frozen=True)
class _Blocks:
    """A recording with its speed and yaw rate, for averages over blocks."""

    recording: Recording
    speed: Proposal
    yaw: Proposal

    def averaged(self, value: np.ndarray) -> np.ndarray:
        """Rows (B, 3) of speed, yaw rate and ``value`` (N,), where all are known and the car moves."""
        r = self.recording
        v, yaw = (
            r.values[p.name] * p.factor * (unit_factor(p.unit, DIMENSIONS[p.role]) or 1.0)
            for p in (self.speed, self.yaw)
        )
        step = max(1, round(BLOCK_S / float(np.median(np.diff(r.t)))))
        rows = len(r.t) // step
        both = np.column_stack([v, yaw, value])[: rows * step].reshape(rows, step, 3).mean(axis=1)
        return both[np.isfinite(both).all(axis=1) & (both[:, 0] >= SLOW_MPS)]


def redundant(recordings: Sequence[Recording], proposals: Mapping[str, Proposal]) -> list[Redundant]:
    """Further measurements of the yaw rate that all recordings hold, at most MOST.

    Parameters
    ----------
    recordings : Sequence of Recording
    proposals : Mapping[str, Proposal], the signals of `proposed`, by role

    Returns
    -------
    list of Redundant
    """
    used = {n for p in proposals.values() for n in (p.name, *p.plus)}
    names = [n for n in recordings[0].values if all(n in r.values for r in recordings) and n not in used]
    blocks = [_Blocks(r, proposals["speed"], proposals["output"]) for r in recordings]
    outputs = []
    for search in (_second_gyro, _wheels, _acceleration, _course):
        best = max(search(names, blocks), key=lambda pair: pair[0], default=None)
        if best is not None:
            outputs.append(best[1])
    return outputs[:MOST]


Scored = Iterator[tuple[float, Redundant]]


def _second_gyro(names: list[str], blocks: list[_Blocks]) -> Scored:
    """Other signals that a yaw rate is called; their unit is that of the fitted factor."""
    for name in ranked("output", names):
        rows = _stacked(blocks, name)
        if rows is None:
            continue
        correlation, slope, _ = _fitted(rows[:, 2], rows[:, 1], np.empty((len(rows), 0)))
        unit = _unit_of(slope, {u: 1 / (unit_factor(u, "rad/s") or 1.0) for u in ("rad/s", "deg/s")})
        if unit and correlation >= LEAST_CORRELATION and not all(_is_copy(b, name) for b in blocks):
            term: Keys = {"source_unit": unit, "factor": float(np.sign(slope))}
            why = f"{name}: another gyro in {unit}, correlation {correlation:.2f} with the yaw rate"
            yield correlation, Redundant("gyro_2_rate", "r_2", ((name, term),), {}, 0, why)


def _wheels(names: list[str], blocks: list[_Blocks]) -> Scored:
    """Pairs of names that differ in left and right, whose mean is the speed and whose difference turns."""
    for left, right in _pairs(names):
        rows = _stacked(blocks, left)
        other = _stacked(blocks, right)
        if rows is None or other is None or len(rows) != len(other):
            continue
        per_unit = np.median((rows[:, 2] + other[:, 2]) / 2 / rows[:, 0])
        unit = _unit_of(float(per_unit), {u: 1 / (unit_factor(u, "m/s") or 1.0) for u in SPEED_UNITS})
        if unit is None:
            continue
        factor = unit_factor(unit, "m/s") or 1.0
        turned = (other[:, 2] - rows[:, 2]) * factor
        correlation, track, (unequal,) = _fitted(turned, rows[:, 1], rows[:, :1])
        if correlation >= LEAST_CORRELATION and TRACKS_M[0] <= track <= TRACKS_M[1]:
            terms = (
                (right, {"scale": _short(factor * (1 - unequal / 2) / track)}),
                (left, {"scale": _short(-factor * (1 + unequal / 2) / track)}),
            )
            why = (
                f"({right} - {left}) in {unit} over a track of {track:.3g} m, correlation {correlation:.2f} "
                f"with the yaw rate; the wheels' sizes differ by {abs(unequal):.2%}"
            )
            yield correlation, Redundant("wheel_rate", "r_wheels", terms, {}, 0, why)


def _acceleration(names: list[str], blocks: list[_Blocks]) -> Scored:
    """Lateral accelerations: the speed times the yaw rate, and a part of gravity that stays."""
    for name in called(ACCELERATION, names):
        rows = _stacked(blocks, name)
        if rows is None:
            continue
        correlation, slope, _ = _fitted(rows[:, 2], rows[:, 0] * rows[:, 1], np.empty((len(rows), 0)))
        unit = _unit_of(slope, {"m/s^2": 1.0, "g": 1 / STANDARD_GRAVITY})
        if unit and correlation >= LEAST_CORRELATION:
            scale = float(np.sign(slope)) * {"m/s^2": 1.0, "g": STANDARD_GRAVITY}[unit]
            level = float(np.mean(scale * rows[:, 2] - rows[:, 0] * rows[:, 1]))
            keys: Keys = {"over": "v", "over_min": SLOW_MPS, "offset": float(f"{-level:.3g}")}
            why = f"{name} in {unit} over the speed, correlation {correlation:.2f} with speed times yaw rate"
            terms = ((name, {"scale": scale}),)
            yield correlation, Redundant("acceleration_rate", "r_ay", terms, keys, -1, why)


def _course(names: list[str], blocks: list[_Blocks]) -> Scored:
    """Courses and headings, which jump by a turn: their change a second."""
    steady = [replace(b, recording=_rising(b.recording)) for b in blocks]
    for name in called(COURSE, names):
        for unit, turn in (("deg", 360.0), ("rad", 2 * np.pi)):
            rows = _stacked(steady, name, partial(_turning, turn=turn))
            if rows is None:
                continue
            correlation, slope, _ = _fitted(rows[:, 2], rows[:, 1], np.empty((len(rows), 0)))
            per = 1.0 if unit == "rad" else float(np.degrees(1.0))
            if correlation >= LEAST_CORRELATION and _unit_of(slope, {unit: per}):
                term: Keys = {
                    "source_unit": unit,
                    "factor": float(np.sign(slope)),
                    "wrap": turn,
                    "rate": True,
                }
                why = f"change of {name} in {unit}, correlation {correlation:.2f} with the yaw rate"
                keys: Keys = {"max_gap_s": 1.5}
                yield correlation, Redundant("course_rate", "r_course", ((name, term),), keys, 0, why)


SPEED_UNITS = ("m/s", "km/h", "mph")


def _short(value: float) -> float:
    return float(f"{value:.6g}")


def _rising(recording: Recording) -> Recording:
    """The recording at times that rise."""
    keep = np.diff(recording.t, prepend=-np.inf) > 0
    values = {n: x[keep] for n, x in recording.values.items()}
    return replace(recording, t=recording.t[keep], values=values)


def _is_copy(block: _Blocks, name: str) -> bool:
    """Return whether a signal's samples follow those of the yaw rate, but for the unit."""
    both = np.array([block.recording.values[n] for n in (name, block.yaw.name)])
    return abs(float(np.corrcoef(both[:, np.isfinite(both).all(axis=0)])[0, 1])) > SAME


def _pairs(names: Sequence[str]) -> Iterator[tuple[str, str]]:
    """Names of a left and a right wheel that are equal but for the side."""
    by_word = {re.sub(r"(?<=[a-z])(?=[A-Z])", "_", name).lower(): name for name in names}
    for word, name in by_word.items():
        for left, right in SIDES.items():
            for match in re.finditer(rf"(?<![a-z]){left}(?![a-z])", word):
                other = by_word.get(word[: match.start()] + right + word[match.end() :])
                if other is not None and not NO_MEASUREMENT.search(word):
                    yield name, other


def _turning(recording: Recording, name: str, turn: float) -> np.ndarray:
    """Change a second (N,) of an angle with the period ``turn``; NaN where a jump was interpolated."""
    x, ok = recording.values[name].copy(), np.isfinite(recording.values[name])
    x[ok] = np.unwrap(x[ok], period=turn)
    change = np.gradient(x, recording.t)
    return np.where(np.abs(change) < turn / 4, change, np.nan)


def _measured(recording: Recording, name: str) -> np.ndarray:
    return recording.values[name]


def _stacked(
    blocks: Sequence[_Blocks], name: str, value: Callable[[Recording, str], np.ndarray] = _measured
) -> np.ndarray | None:
    """Rows (B, 3) of all recordings; None where they are too few."""
    parts = [x for b in blocks if len(x := b.averaged(value(b.recording, name)))]
    if sum(len(x) for x in parts) < LEAST_BLOCKS:
        return None
    return np.concatenate(parts)


def _fitted(y: np.ndarray, x: np.ndarray, further: np.ndarray) -> tuple[float, float, np.ndarray]:
    """Partial correlation of y and x (N,), the factor of x, and those of ``further`` (N, k)."""
    level = np.column_stack([np.ones(len(x)), further])
    size = np.linalg.lstsq(np.column_stack([x, level]), y, rcond=None)[0]
    left = [z - level @ np.linalg.lstsq(level, z, rcond=None)[0] for z in (x, y)]
    norms = float(np.linalg.norm(left[0]) * np.linalg.norm(left[1]))
    return abs(float(left[0] @ left[1])) / norms if norms > 0 else 0.0, float(size[0]), size[2:]


def _unit_of(slope: float, factors: Mapping[str, float]) -> str | None:
    """The unit whose factor is the nearest to the size of a fitted one, if it is near."""
    if not slope:
        return None
    away = {unit: abs(float(np.log(abs(slope) / factor))) for unit, factor in factors.items()}
    unit = min(away, key=lambda u: away[u])
    return unit if away[unit] <= np.log(1 + WITHIN) else None
