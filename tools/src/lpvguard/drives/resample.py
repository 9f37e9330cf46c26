"""Samples of several signals on one uniform grid, with a record of what was left out.

Resampling is linear interpolation between the signal's own samples at their time of arrival. No signal is
filtered. The table starts with the first time at which every column has a sample (t = 0 there) and never
extrapolates. A time is left out when, for any column, the samples around it lie further apart than
``max_gap_s``. Times across a jump of the log's clock are left out too.
"""

import warnings
from dataclasses import dataclass
from itertools import product

import numpy as np

from ..base.errors import InputWarning
from .signal_map import Column, SignalMap

REORDER_S = 0.1
"""A smaller step back of the clock is a matter of order (several interfaces, buffered frames): the log is
sorted."""
MIN_ROWS = 2
"""Shorter pieces are left out: a drive table needs at least two samples."""
_LISTED = 50
"""Most gaps listed for a signal; all are counted."""

ALONE, OF_RANGE = 20.0, 0.25
"""A sample stands alone if it is off both its neighbours by more than so many usual steps of the signal, and
than this share of the range in which it is at four of five samples."""
OF_OTHERS, MARKS = 3.0, 3
"""Up to MARKS repeated values at each end mean none if all are off the others by more than OF_OTHERS of these
others' ranges."""
FEW_STEPS = 10
"""So few steps say nothing of a signal's usual ones."""

NS = 1_000_000_000
"""Nanoseconds in a second."""


@dataclass
class Source:
    """A term of a column with its samples: time in ns of the log's clock, value in the column's unit."""

    t_ns: np.ndarray
    value: np.ndarray
    report: dict


@dataclass
class LogClock:
    """Time axis of a log, cut where it jumps: [start, end) positions in the log, and the jumps."""

    t_ns: np.ndarray
    jumps: list[dict]
    cuts: list[int]


def clock_of(t_ns: np.ndarray, max_gap_s: float) -> LogClock:
    """Cut a log's time axis where it jumps.

    It jumps back by more than REORDER_S, or forward by more than 1 s and ``max_gap_s``.

    Parameters
    ----------
    t_ns : ndarray (N,) of int, ns
    max_gap_s : float, s, largest gap that is interpolated

    Returns
    -------
    LogClock
    """
    step = np.diff(t_ns)
    back = step < -REORDER_S * NS
    forward = step > max(max_gap_s, 1.0) * NS
    clock = LogClock(t_ns, jumps=[], cuts=[0])
    for i in np.flatnonzero(back | forward).tolist():
        clock.jumps.append(
            {
                "after_frame": i + 1,
                "kind": "backwards" if back[i] else "pause or jump forwards",
                "from_s": t_ns[i] / NS,
                "to_s": t_ns[i + 1] / NS,
            }
        )
        clock.cuts.append(i + 1)
    clock.cuts.append(len(t_ns))
    return clock


@dataclass
class Piece:
    """Rows of a drive table without a gap: t (rows,) [s], each column (rows,)."""

    t: np.ndarray
    values: dict[str, np.ndarray]
    log_start_s: float


def _resample(grid_ns: np.ndarray, source: Source, max_gap_ns: float) -> tuple[np.ndarray, np.ndarray]:
    """Interpolate linearly at ``grid_ns``; also mark where the samples around lie within ``max_gap_ns``."""
    t = source.t_ns
    after = np.searchsorted(t, grid_ns, side="left")
    exact = t[np.minimum(after, len(t) - 1)] == grid_ns
    before = np.where(exact, after, after - 1)
    inside = (before >= 0) & (after < len(t))
    gap = t[np.clip(after, 0, len(t) - 1)] - t[np.clip(before, 0, len(t) - 1)]
    origin = grid_ns[0]
    value = np.interp((grid_ns - origin) / NS, (t - origin) / NS, source.value)
    return value, inside & (gap <= max_gap_ns)


def _runs(mask: np.ndarray) -> list[tuple[int, int]]:
    """First and end [first, end) of every stretch of True."""
    edges = np.flatnonzero(np.diff(np.concatenate(([0], mask.astype(np.int8), [0]))))
    return list(zip(edges[::2].tolist(), edges[1::2].tolist(), strict=False))


class TableMaker:
    """Makes the pieces of one log and collects what was left out."""

    def __init__(self, signal_map: SignalMap):
        self.map = signal_map
        self.pieces: list[Piece] = []
        self.left_out: list[dict] = []
        self._first_start: int | None = None

    def add_stretch(self, first_ns: int, last_ns: int, members: dict[str, list[Source]]) -> None:
        """Add the grid of one stretch of unbroken clock with its samples ``members``."""
        empty = [c for c, terms in members.items() if any(len(s.t_ns) == 0 for s in terms)]
        if empty:
            self._leave_out(first_ns, last_ns, empty, "no sample in this stretch of the log")
            return
        start = max(int(s.t_ns[0]) for terms in members.values() for s in terms)
        end = min(int(s.t_ns[-1]) for terms in members.values() for s in terms)
        Ts_ns = self.map.Ts_s * NS
        origin = 0.0
        if self._first_start is None or start < self._first_start:
            self._first_start = start
        else:  # a later stretch stays on the grid of the first
            origin = np.ceil((start - self._first_start) / Ts_ns)
            start = round(self._first_start + origin * Ts_ns)
        rows = int((end - start) // Ts_ns) + 1 if end >= start else 0
        if rows < MIN_ROWS:
            self._leave_out(first_ns, last_ns, [], f"fewer than {MIN_ROWS} rows in common")
            return
        grid = start + np.rint(np.arange(rows) * Ts_ns).astype(np.int64)
        values, good = {}, {}
        for name, terms in members.items():
            column = self.map.columns[name]
            gap_ns = self.map.gap_s(name) * NS
            parts = [_resample(grid, s, gap_ns) for s in terms]
            values[name] = sum(p[0] for p in parts) + column.offset
            good[name] = np.logical_and.reduce([p[1] for p in parts])
        for name, column in self.map.columns.items():
            if column.over is not None:
                by = values[column.over]
                values[name] = (
                    values[name] / np.where(by < 0, -1, 1) / np.maximum(np.abs(by), column.over_min)
                )
        self._cut(grid, origin, values, good)

    def _cut(self, grid: np.ndarray, origin: float, values: dict, good: dict) -> None:
        complete = np.logical_and.reduce(list(good.values()))
        for first, end in _runs(~complete):
            missing = [name for name, mask in good.items() if not mask[first:end].all()]
            self._leave_out(
                int(grid[first]), int(grid[end - 1]), missing, "samples further apart than max_gap_s"
            )
        for first, end in _runs(complete):
            if end - first < MIN_ROWS:
                self._leave_out(
                    int(grid[first]), int(grid[end - 1]), [], f"fewer than {MIN_ROWS} rows between gaps"
                )
                continue
            t = np.round((origin + np.arange(first, end)) * self.map.Ts_s, 9)
            self.pieces.append(Piece(t, {n: v[first:end] for n, v in values.items()}, int(grid[first]) / NS))

    def _leave_out(self, first_ns: int, last_ns: int, columns: list[str], reason: str) -> None:
        self.left_out.append(
            {"from_s": first_ns / NS, "to_s": last_ns / NS, "columns": columns, "reason": reason}
        )


def within_limits(column: Column, terms: list[Source]) -> None:
    """Drop the samples outside [min, max] of the column (which then has one term)."""
    if column.min is None and column.max is None:
        return
    source = terms[0]
    value = source.value + column.offset
    keep = np.ones(len(value), bool)
    if column.min is not None:
        keep &= value >= column.min
    if column.max is not None:
        keep &= value <= column.max
    if not keep.all():
        source.report["left_out"]["outside min and max of the map"] = int((~keep).sum())
        source.t_ns, source.value = source.t_ns[keep], source.value[keep]


def standing_alone(value: np.ndarray) -> np.ndarray:
    """Find samples that stand alone, as a lost frame's or a wrong bit's do: far off both neighbours.

    A repeated value far off all others stands alone, too, as -999 for none.

    Parameters
    ----------
    value : ndarray (N,), finite

    Returns
    -------
    ndarray (N,) of bool
    """
    alone, step = _marks(value), np.diff(value)
    moved = np.abs(step[step != 0])
    if len(moved) >= FEW_STEPS:
        away, back = step[:-1], -step[1:]
        least = np.minimum(np.abs(away), np.abs(back))
        usual = OF_RANGE * float(np.subtract(*np.quantile(value, (0.9, 0.1))))
        off = (away * back > 0) & (least > max(ALONE * float(np.median(moved)), usual))
        alone[1:-1] |= off & (np.abs(value[2:] - value[:-2]) < 0.5 * least)
    return alone


def _marks(value: np.ndarray) -> np.ndarray:
    """True (N,) at the least and largest values where they are repeated and far off all others."""
    none = np.zeros(len(value), bool)
    if not len(value):
        return none
    if np.ptp(value) <= OF_OTHERS * np.diff(np.quantile(value, (0.25, 0.5, 0.75))).min():
        return none
    low, high = _repeated(value), [-x for x in _repeated(-value)]
    most: np.ndarray = none
    for least, largest in product([-np.inf, *low], [np.inf, *high]):
        out = (value <= least) | (value >= largest)
        others, many = value[~out], int(out.sum())
        if not int(most.sum()) < many < len(others) or np.ptp(others) == 0:
            continue
        if min(others.min() - least, largest - others.max()) > OF_OTHERS * np.ptp(others):
            most = out
    return most


def _repeated(value: np.ndarray) -> list[float]:
    """The least values, up to MARKS and to the first that stands once."""
    least: list[float] = []
    rest = value
    while len(least) < MARKS and len(rest) and int((rest == rest.min()).sum()) > 1:
        least.append(float(rest.min()))
        rest = rest[rest > least[-1]]
    return least


def without_lone(column: str, source: Source) -> None:
    """Drop the samples of ``source`` that stand alone, with a warning that names the column and the first."""
    at = np.flatnonzero(standing_alone(source.value))
    if len(at) == 0:
        return
    k = int(at[0])
    warnings.warn(
        f"column {column}: {len(at)} of {len(source.value)} samples stand alone and are left out, the first "
        f"{source.value[k]:.6g} between {source.value[k - 1]:.6g} and {source.value[k + 1]:.6g} at "
        f"{source.t_ns[k] / NS:.3f} s",
        InputWarning,
        stacklevel=1,
    )
    source.report["left_out"]["stand alone"] = len(at)
    keep = np.delete(np.arange(len(source.value)), at)
    source.t_ns, source.value = source.t_ns[keep], source.value[keep]


def in_order(source: Source) -> Source:
    """Sort samples by time. Two at the same time both stay and make a step."""
    t = source.t_ns
    source.report["same_time"] = int((np.diff(t) == 0).sum())
    if (np.diff(t) < 0).any():
        order = np.argsort(t, kind="stable")
        source.report["out_of_order"] = int((np.diff(t) < 0).sum())
        return Source(t[order], source.value[order], source.report)
    return source


def describe(source: Source, max_gap_s: float) -> dict:
    """Report of a term: number of samples, rate and gaps."""
    step = np.diff(source.t_ns)
    pauses = np.flatnonzero(step > max_gap_s * NS)
    listed = [[source.t_ns[i] / NS, source.t_ns[i + 1] / NS] for i in pauses[:_LISTED].tolist()]
    return {
        **source.report,
        "samples": len(source.t_ns),
        "median_period_s": float(np.median(step)) / NS if len(step) else None,
        "longest_pause_s": float(step.max()) / NS if len(step) else None,
        "gaps": len(pauses),
        "gaps_s": listed,
    }
