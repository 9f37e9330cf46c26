"""Reasons why drives do not fit: signs, units, columns and delays that contradict the project file.

A *reading* is a drive with one change: a sign, a unit, two columns, a shift in time. Where the recorded
drives leave much unexplained, every reading is tried within the ranges of [fit]. A reading that leaves a
quarter or less, and little, names the fault. Ranges decide what can be distinguished. Speed in km/h acts like
a wheelbase of 3.6 times the size. A wide range for the wheelbase therefore hides it.
"""

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from functools import partial

import numpy as np

from ..base.errors import InputError
from ..drives.tables import Drive
from ..drives.units import unit_factor
from ..vehicle.project import Project
from .estimate import Fit
from .stretches import judged_samples
from .unknowns import LONGEST_DELAY_S, Unknowns

LITTLE, SURE = 0.1, 0.02
"""Shares of the output's variance. A drive that leaves no more than LITTLE is explained; with an unknown at
the end of its range, no more than SURE."""
MUCH, NOTHING = 0.6, 0.9
"""Shares of the same, averaged over drives, at which one reading is named.

It leaves no more than MUCH. The recorded drives and every other reading leave NOTHING or more.
"""
BETTER = 0.25
"""A reading is better if it leaves no more than this share of the recorded drive's remainder."""
AS_GOOD = 1.5
"""A reading is no reason if it leaves this many times more than parameters of the drive alone.

Such a drive is another car's.
"""
TRIED_ALONE = 6
"""Number of drives fitted alone to find parameters that most drives share, where not all agree."""
OTHER_UNITS = {"m/s": ("km/h", "mph"), "rad": ("deg",), "rad/s": ("deg/s",), "deg": ("rad",)}
LONGEST_SHIFT = 0.9
"""Share of a drive by which columns may be shifted and still be compared."""
WHEEL_RATIOS = (12.0, 16.0, 20.0)
"""Angle of the steering wheel over that of the road wheels, as cars have it."""


@dataclass(frozen=True)
class Reading:
    """A changed drive: place of the fault, its kind, and the drive without it."""

    where: str
    what: str
    expected: str
    read: Callable[[Drive], Drive]


def readings(project: Project) -> Iterator[Reading]:
    """All readings of a project's drives except shifts in time."""
    yield from _signs(project)
    yield from _units(project)
    yield from _swapped(project)


def _signs(project: Project) -> Iterator[Reading]:
    """Readings with changed signs. An input and all outputs together are equivalent; the message names
    both."""
    several = project.n_u * project.n_y > 1
    for i, s in enumerate(project.inputs):
        turned = np.where(np.arange(project.n_u) == i, -1.0, 1.0)
        other = "" if several else f" (or that of {project.outputs[0].column})"
        yield Reading(
            f"column {s.column}",
            f"has the other sign{other}",
            f"{s.name} positive: {s.positive}",
            partial(_turned, u=turned),
        )
    for j, s in enumerate(project.outputs if several else []):
        turned = np.where(np.arange(project.n_y) == j, -1.0, 1.0)
        yield Reading(
            f"column {s.column}",
            "has the other sign",
            f"{s.name} positive: {s.positive}",
            partial(_turned, y=turned),
        )


def _turned(drive: Drive, u: np.ndarray | float = 1.0, y: np.ndarray | float = 1.0) -> Drive:
    return replace(drive, u=drive.u * u, y=drive.y * y)


def _units(project: Project) -> Iterator[Reading]:
    for s in [project.speed, *project.inputs, *project.outputs]:
        for unit in OTHER_UNITS.get(s.unit, ()):
            factor = unit_factor(unit, s.unit) or 1.0
            yield Reading(
                f"column {s.column}",
                f"is in {unit}",
                f"{s.name} in {s.unit}",
                partial(_scaled, project, s.name, factor),
            )
        if s.role == "input" and s.unit in ("rad", "deg"):
            for ratio in WHEEL_RATIOS:
                yield Reading(
                    f"column {s.column}",
                    f"is about {ratio:g} times too large, as the angle of the steering wheel is",
                    f"{s.name}: divide by the steering ratio",
                    partial(_scaled, project, s.name, 1 / ratio),
                )


def _scaled(project: Project, name: str, factor: float, drive: Drive) -> Drive:
    def scale(signals: list) -> np.ndarray:
        return np.array([factor if s.name == name else 1.0 for s in signals])

    v = drive.v * (factor if name == project.speed.name else 1.0)
    return replace(drive, v=v, u=drive.u * scale(project.inputs), y=drive.y * scale(project.outputs))


def _swapped(project: Project) -> Iterator[Reading]:
    signals = [project.speed, *project.inputs, *project.outputs]
    for a in range(len(signals)):
        for b in range(a + 1, len(signals)):
            order = list(range(len(signals)))
            order[a], order[b] = b, a

            yield Reading(
                f"columns {signals[a].column} and {signals[b].column}",
                "are swapped",
                f"{signals[a].name} in {signals[a].column}, {signals[b].name} in {signals[b].column}",
                partial(_ordered, project, order),
            )


def _ordered(project: Project, order: list[int], drive: Drive) -> Drive:
    """The drive with its columns speed, inputs, outputs in another order."""
    values = np.column_stack([drive.v, drive.u, drive.y])[:, order]
    return replace(drive, v=values[:, 0], u=values[:, 1 : 1 + project.n_u], y=values[:, 1 + project.n_u :])


def shifts(project: Project, theta: np.ndarray, drive: Drive) -> Iterator[Reading]:
    """Readings with the outputs moved to where they follow the inputs best.

    Best is the largest product over the overlap, and the largest correlation, which a short overlap after a
    long shift does not hide. Shifts within the range of the delay are left out. ``theta`` (p,) holds the
    unknowns.
    """
    model = Unknowns.from_project(project).model(theta)
    yhat, judged = model.simulate(drive.v, drive.u, drive.y[0]), judged_samples(model, drive.v)
    if judged.sum() < 100 or not yhat[judged].std(axis=0).any():
        return
    n = len(drive.t)
    total, alike = np.zeros(2 * n - 1), np.zeros(2 * n - 1)
    for j in range(project.n_y):
        a, b = (np.where(judged, x - x[judged].mean(), 0.0) for x in (drive.y[:, j], yhat[:, j]))
        size = 1 << (2 * n - 1).bit_length()
        product = np.fft.irfft(np.fft.rfft(a, size) * np.conj(np.fft.rfft(b, size)), size)
        both = np.r_[product[-(n - 1) :], product[:n]]
        total += both / max(float(np.sqrt(np.dot(a, a) * np.dot(b, b))), 1e-300)
        alike += both / np.sqrt(np.maximum(_overlap_energy(a) * _overlap_energy(b)[::-1], 1e-300))
    shift = np.arange(2 * n - 1) - (n - 1)
    alike[np.abs(shift) > LONGEST_SHIFT * n] = 0.0
    high = project.fit.input_delay_s[1] if project.fit.input_delay_s else LONGEST_DELAY_S
    for lag in dict.fromkeys(int(shift[np.argmax(x)]) for x in (total, alike)):
        if not -3 <= lag <= 3 + high / project.Ts_s and abs(lag) <= LONGEST_SHIFT * n:
            yield _moved(project, lag, high)


def _overlap_energy(x: np.ndarray) -> np.ndarray:
    """Sums (2 n - 1,) of x² over the overlap when x (n,) is moved back by -(n - 1) to n - 1 samples."""
    squares = x**2
    return np.r_[np.cumsum(squares), np.cumsum(squares[::-1])[-2::-1]]


def _moved(project: Project, lag: int, high: float) -> Reading:
    """Reading with the outputs ``lag`` samples earlier; ``high`` is the longest delay expected [s]."""
    k, word = abs(lag), "later" if lag > 0 else "earlier"

    def read(d: Drive) -> Drive:
        if lag > 0:
            return Drive(d.name, d.t[:-k], d.v[:-k], d.u[:-k], d.y[k:])
        return Drive(d.name, d.t[:-k], d.v[k:], d.u[k:], d.y[:-k])

    columns = ", ".join(s.column for s in project.outputs)
    return Reading(
        f"column {columns}",
        f"comes {k * project.Ts_s:.4g} s {word} than the inputs say",
        f"a delay of at most {high:g} s (fit.input_delay_s), and columns of one recording and one clock",
        read,
    )


# ---------------------------------------------------------------------------------------------------- judging


@dataclass(frozen=True)
class Screened:
    """Drives that the model can explain, start values (p,) from them, and an error for each other drive.

    ``certain`` names the drives whose fault is known.
    """

    explained: list[Drive]
    theta: np.ndarray
    faults: dict[str, InputError]
    certain: set[str]


def screened(project: Project, drives: list[Drive]) -> Screened:
    """Sort drives into those that one set of parameters explains and the others, with a reason each.

    Raises InputError when all have the same fault.
    """
    unknowns = Unknowns.from_project(project)
    theta, left = _common(unknowns, drives)
    bad_end = bool(unknowns.at_end(theta))
    if all(x <= (SURE if bad_end else LITTLE) for x in left):
        return Screened(drives, theta, {}, set())
    explained = [d for d, x in zip(drives, left, strict=True) if x <= LITTLE]
    if 2 * len(explained) < len(drives) or bad_end:
        _require_no_common_fault(unknowns, drives, left)
    if not explained and float(np.median(left)) >= 1:
        raise InputError(
            ", ".join(d.name for d in drives),
            "",
            "no parameters within the ranges of [fit] explain the drives better than none, and no sign, "
            "unit, swap or delay does",
            "drives of this vehicle, and a model of it",
        )
    if not explained:
        return Screened(drives, theta, {}, set())
    faults, certain = judged_beside(unknowns, theta, drives)
    return Screened([d for d in drives if d.name not in faults], theta, faults, certain)


def judged_beside(
    unknowns: Unknowns, theta: np.ndarray, drives: list[Drive]
) -> tuple[dict[str, InputError], set[str]]:
    """Fault of each drive that theta (p,) does not explain, and the names of those whose fault is certain."""
    left = [_left(unknowns, theta, d) for d in drives]
    faults: dict[str, InputError] = {}
    certain: set[str] = set()
    for d, x in zip(drives, left, strict=True):
        if x > LITTLE and (fault := _fault_of(unknowns, theta, d, x)) is not None:
            faults[d.name] = fault[0]
            certain |= {d.name} if fault[1] else set()
    return faults, certain


def _left(unknowns: Unknowns, theta: np.ndarray, drive: Drive) -> float:
    """Share of the outputs' variance that the model leaves, averaged over outputs; inf where nothing is
    judged."""
    try:
        model = unknowns.model(theta)
    except InputError:
        return np.inf
    judged = judged_samples(model, drive.v)
    y = drive.y[judged]
    if len(y) < 2.0 / model.Ts or not np.all(y.std(axis=0) > 0):
        return np.inf
    e = y - model.simulate(drive.v, drive.u, drive.y[0])[judged]
    return float(np.mean(e.var(axis=0) / y.var(axis=0)))


def _fitted(unknowns: Unknowns, drives: list[Drive]) -> np.ndarray | None:
    """Parameters (p,) of least plain squares, of few stretches; None where nothing is judged."""
    try:
        return Fit(unknowns, drives).begun(unknowns.start)
    except InputError:
        return None


def _common(unknowns: Unknowns, drives: list[Drive]) -> tuple[np.ndarray, list[float]]:
    """Parameters (p,) that explain as many drives as possible, and the remainder of each."""

    def left(theta: np.ndarray) -> list[float]:
        return [_left(unknowns, theta, d) for d in drives]

    together = _fitted(unknowns, drives)
    theta = unknowns.start if together is None else together
    best = left(theta)
    if all(x <= LITTLE for x in best):
        return theta, best
    longest = sorted(drives, key=lambda d: (-len(d.t), d.name))[:TRIED_ALONE]
    for d in longest if len(drives) > 1 else []:
        alone = _fitted(unknowns, [d])
        if alone is not None:
            rest = left(alone)
            if (_agreeing(rest), -np.median(rest)) > (_agreeing(best), -np.median(best)):
                theta, best = alone, rest
    agreeing = [d for d, x in zip(drives, best, strict=True) if x <= LITTLE]
    again = _fitted(unknowns, agreeing) if len(agreeing) > 1 else None
    if again is not None and _agreeing(rest := left(again)) >= _agreeing(best):
        return again, rest
    return theta, best


def _together(left: list[float]) -> float:
    """Mean remainder of the drives, at most 1 each."""
    return float(np.mean(np.minimum(left, 1.0)))


def _agreeing(left: list[float]) -> int:
    return sum(x <= LITTLE for x in left)


def _require_no_common_fault(unknowns: Unknowns, drives: list[Drive], left: list[float]) -> None:
    """Raise InputError when one reading explains the drives together, and the recorded drives do not.

    Where many of them are beyond any model, a reading may leave up to MUCH. The recorded drives and every
    other reading must then leave almost everything unexplained.
    """
    now = _together(left)
    tried: list[tuple[bool, float, int, Reading]] = []
    for i, reading in enumerate(readings(unknowns.base)):
        read = [reading.read(d) for d in drives]
        theta = _fitted(unknowns, read)
        if theta is not None:
            then = _together([_left(unknowns, theta, d) for d in read])
            tried.append((bool(unknowns.at_end(theta)), then, i, reading))
    explaining = [t for t in tried if t[1] <= LITTLE and t[1] <= BETTER * now]
    partly = [t for t in tried if t[1] <= MUCH]
    others = [t[1] for t in tried if not partly or t is not partly[0]]
    if not explaining and len(partly) == 1 and min([now, *others]) >= NOTHING:
        explaining = partly
    if explaining:
        _, then, _, reading = min(explaining)
        raise _error(", ".join(d.name for d in drives), reading, then, now)
    for d, x in zip(drives, left, strict=True):
        error = _shift_of(unknowns, unknowns.start, d, x) if x > SURE else None
        if error is not None:
            raise error


def _shift_of(unknowns: Unknowns, theta: np.ndarray, drive: Drive, left: float) -> InputError | None:
    for reading in shifts(unknowns.base, theta, drive):
        read = reading.read(drive)
        own = _fitted(unknowns, [read])
        then = np.inf if own is None else _left(unknowns, own, read)
        if then <= LITTLE and then <= BETTER * left:
            return _error(drive.name, reading, then, left)
    return None


def _fault_of(
    unknowns: Unknowns, theta: np.ndarray, drive: Drive, left: float
) -> tuple[InputError, bool] | None:
    """Fault of one drive among others that theta (p,) explains, and whether it is certain.

    The result is None where the drive is only explained poorly.
    """
    tried = [(_left(unknowns, theta, r.read(drive)), i, r) for i, r in enumerate(readings(unknowns.base))]
    then, _, reading = min(tried)
    own = _fitted(unknowns, [drive])
    alone = np.inf if own is None else _left(unknowns, own, drive)
    if then <= LITTLE and then <= BETTER * left and then <= AS_GOOD * alone:
        return _error(drive.name, reading, then, left), True
    late = _shift_of(unknowns, theta, drive, left)
    if late is not None:
        return late, True
    if own is not None and alone <= LITTLE and alone <= BETTER * left:
        names = [n for n in unknowns.base.model.parameters if n in unknowns.names]
        values = ", ".join(
            f"{n} = {own[unknowns.names.index(n)]:.4g} instead of {theta[unknowns.names.index(n)]:.4g}"
            for n in names
        )
        return (
            InputError(
                drive.name,
                "",
                f"needs other parameters than the other drives ({values}): it leaves {alone:.1%} with its "
                f"own, {left:.1%} with theirs",
                "drives of one car: same vehicle, tyres and load, and within its grip",
            ),
            False,
        )
    if left < 1:
        return None
    if not np.isfinite(left):
        low, high = unknowns.base.model.speed_min_mps, unknowns.base.model.speed_max_mps
        speeds = f"{drive.v.min():.3g} to {drive.v.max():.3g} m/s"
        what = f"nothing is judged: at {speeds} it is nowhere long enough in the model's range"
        return InputError(drive.name, "", what, f"{low:g} to {high:g} m/s"), False
    return (
        InputError(
            drive.name,
            "",
            f"the model leaves {left:.0%} of the output, and no sign, unit, swap or delay explains it",
            "drives in the range where the model holds, with steering that moves the car",
        ),
        False,
    )


def _error(name: str, reading: Reading, then: float, now: float) -> InputError:
    as_it_is = "nothing can be judged" if not np.isfinite(now) else f"{now:.0%} is left"
    return InputError(
        name,
        reading.where,
        f"{reading.what}: with this change the model leaves {then:.1%} of the output; without it, {as_it_is}",
        reading.expected,
    )
