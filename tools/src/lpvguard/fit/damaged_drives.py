"""Drives that were spoiled: repeated in the folder, rows out of order, frozen values, or each value twice.

No model is needed to detect it. Every finding names drive, column and time.
"""

import warnings
from collections.abc import Iterator

import numpy as np

from ..base.errors import InputError, InputWarning
from ..drives.resample import standing_alone
from ..drives.tables import Drive
from ..vehicle.project import Project, Signal
from .stretches import stretches_of

SAME_ROWS = 0.5
"""Share of a drive's rows in another one from which the two count as the same."""
ROUGH = 1.0
"""Mean square of a signal's step over its variance: 2 in random order, far below 1 for a sampled motion."""
UNLIKE_NOISE = 0.05
"""Spread of a speed that is no noise, as a share of the speed."""
STANDS_S = 5.0
"""A signal that moves elsewhere but not for so long is frozen."""
SHORT_S, OFTEN = 0.5, 5
"""A coarse signal stands so often for so long: a motorway's speed in whole km/h, interpolated."""
MOVES = 0.5
"""A signal moves where more than this share of its steps is not 0."""
HELD = 0.9
"""Share of steps that are 0 at every second sample, from which a signal comes at half the rate."""


def require_unspoiled(project: Project, drives: list[Drive]) -> None:
    """InputError for the first drive that was spoiled; a warning of samples that stand alone."""
    for error in spoiled(project, drives):
        raise error
    for drive in drives:
        for signal, x in _columns(project, drive):
            at = np.flatnonzero(standing_alone(x))
            if len(at):
                first = f"{x[at[0]]:.6g} {signal.unit} at {drive.t[at[0]]:.3f} s"
                what = f"{len(at)} samples stand alone, the first {first}; lpvguard ingest leaves them out"
                warnings.warn(f"{drive.name}: column {signal.column}: {what}", InputWarning, stacklevel=1)


def spoiled(project: Project, drives: list[Drive]) -> Iterator[InputError]:
    """Errors of spoiled drives."""
    yield from _doubled(drives)
    for drive in drives:
        yield from _shuffled(project, drive)
        for signal, x in _columns(project, drive):
            yield from _at_half_rate(drive, signal, x)
            yield from _frozen(drive, signal, x, drive.v >= project.model.speed_min_mps)


def _columns(project: Project, drive: Drive) -> Iterator[tuple[Signal, np.ndarray]]:
    yield project.speed, drive.v
    yield from zip(project.inputs, drive.u.T, strict=True)
    yield from zip(project.outputs, drive.y.T, strict=True)


def _doubled(drives: list[Drive]) -> Iterator[InputError]:
    rows = []
    for d in drives:
        values = np.ascontiguousarray(np.column_stack([d.v, d.u, d.y]))
        moving = np.r_[True, np.any(np.diff(values, axis=0) != 0, axis=1)]
        rows.append({row.tobytes() for row in values[moving]})
    for i, mine in enumerate(rows):
        for j in range(i):
            shared = len(mine & rows[j])
            if len(mine) > 10 and shared > SAME_ROWS * min(len(mine), len(rows[j])):
                yield InputError(
                    drives[i].name,
                    "",
                    f"is the same recording as {drives[j].name}: {shared} rows are in both",
                    "every recording once",
                )


def _shuffled(project: Project, drive: Drive) -> Iterator[InputError]:
    """Return whether every column jumps, as when rows are out of order. The noise of a held speed jumps as
    well, so the speed has to differ by more than noise does."""
    columns = [x for _, x in _columns(project, drive) if np.var(x) > 0]
    rough = all(np.mean(np.diff(x) ** 2) > ROUGH * np.var(x) for x in columns)
    if rough and np.std(drive.v) > UNLIKE_NOISE * np.mean(np.abs(drive.v)):
        yield InputError(
            drive.name,
            f"column {project.speed.column}",
            "jumps from sample to sample as in random order: the rows are shuffled",
            "rows in the order of time",
        )


def _at_half_rate(drive: Drive, signal: Signal, x: np.ndarray) -> Iterator[InputError]:
    """Return whether samples are held: one of the two phases of the steps is 0 where the other moves."""
    step = np.diff(x) != 0
    phases = sorted(float(np.mean(step[p::2])) if len(step[p::2]) else 0.0 for p in (0, 1))
    if phases[0] < 1 - HELD and phases[1] > MOVES:
        yield InputError(
            drive.name,
            f"column {signal.column}",
            "holds every value for two samples: it was recorded at half the rate",
            "a table at the signal's own rate, or interpolated (lpvguard ingest)",
        )


def _frozen(drive: Drive, signal: Signal, x: np.ndarray, driving: np.ndarray) -> Iterator[InputError]:
    """Return whether a signal that elsewhere changes at most samples stands while the vehicle drives."""
    Ts = float(drive.t[1] - drive.t[0])
    stands = np.r_[False, np.diff(x) == 0] & driving
    short = stretches_of(stands, max(2, round(SHORT_S / Ts)))
    long = [s for s in short if s.stop - s.start >= round(STANDS_S / Ts)]
    if len(short) - len(long) >= OFTEN:
        return
    elsewhere = np.ones(len(x), bool)
    for s in long:
        elsewhere[s] = False
    if long and elsewhere.sum() > STANDS_S / Ts and np.mean(np.diff(x[elsewhere]) != 0) > MOVES:
        worst = max(long, key=lambda s: s.stop - s.start)
        late = worst.start <= 1  # the first sample has no step
        begins = f", or the column begins {drive.t[worst.stop - 1] - drive.t[0]:.4g} s late" if late else ""
        yield InputError(
            drive.name,
            f"column {signal.column}, {drive.t[worst.start]:g} to {drive.t[worst.stop - 1]:g} s",
            f"stays at {x[worst.start]:g} {signal.unit} but moves at most samples elsewhere: the sensor is "
            f"frozen{begins}",
            "the drive without this stretch",
        )
