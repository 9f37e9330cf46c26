"""Stage 0: logs as users have them to uniform drive tables, with a report of what was left out and why.

Reads   candump, ASC, BLF, TRC, MF4, CSV, Parquet (can/logs.py); a CAN database; a signal map
Writes  <out>/<log>.csv           one table a drive (<log>_1, _2, ... when it falls into pieces): t [s] and
        the map's columns <out>/<log>.report.json   samples, gaps, wraps, absent values, clock jumps,
        stretches left out <out>/experiments.csv     the index that `lpvguard identify` reads; every drive has
        the split "unassigned" <out>/MANIFEST.json       hashes of the inputs, settings, tool version, and of
        the files as they were written
Next    tables.py reads the tables

The signal map is a TOML file::

    schema = 1
    Ts_s = 0.01                 # grid of the table
    max_gap_s = 0.5             # a longer pause of a signal is left out, a shorter one is interpolated
                                (default 0.5)
    channel = "can0"            # frames of this interface only (default: all)
    j1939 = true                # 29-bit messages are J1939 groups: any priority and sender (default: as the
                                database says)
    time = "t"                  # time column of decoded tables, in s (default: t, time or timestamp)
    format = "csv"              # or "parquet"

    [columns.v]                 # column = factor * (signal in `unit`) + offset
    unit = "m/s"
    message = "SPEED"           # of the database; leave out for logs that are decoded already
    signal = "SPEED"            # signal, channel or column of the log
    factor = 1.0                # -1 turns the signal round, 0.25 makes a mean of four (default 1)
    scale = 0.2777777777777778  # from the signal's unit to `unit`; needed only where the units are not known
    offset = 0.0                # in `unit`

    [columns.delta]             # or a sum of signals: each term as above, the offset beside them
    unit = "rad"
    offset = 0.0
    terms = [{ message = "STEER", signal = "ANGLE" }, { message = "STEER", signal = "FRACTION" }]

Further keys of a column: ``min``, ``max`` (in ``unit``; samples outside are left out) and ``max_gap_s``.
Further keys of a term: ``source_unit`` (instead of the database's), ``wrap`` (period in the signal's own
unit: unwrapped before interpolation; without it wraps are only suspected, and counted in the report),
``channel``, ``source_address`` (J1939) and ``not_available`` ("j1939" or "none"; default: "j1939" when the
message is a J1939 group).

Resampling is linear interpolation between the signal's own samples at their time of arrival; a wheel-speed
frame every 12 ms stays what it was and gets no filter. The table starts with the first time at which every
column has a sample (t = 0 there) and never extrapolates. A time is left out when, for any column, the samples
around it lie further apart than ``max_gap_s``; so is everything across a jump of the log's clock.
"""

from __future__ import annotations

import difflib
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Literal

import numpy as np
from pydantic import BaseModel, ConfigDict, Field, model_validator

from ..base import artefacts
from ..base.documents import checked, read_toml
from ..base.errors import InputError
from ..can.decode import decode_signal, find_frames, is_j1939, load_database, own_database
from ..can.logs import Frames, Series, Table, read_log, stem

REORDER_S = 0.1
"""A step back of the clock up to this is a matter of order (several interfaces, buffered frames): the log is
sorted."""
MIN_ROWS = 2
"""Shorter pieces are left out: a drive table needs at least two samples."""
_WRAP_SHARE = 0.75
"""A signal that moves by more than this share of its range between two samples is reported as a suspected
wrap."""
_LISTED = 50
"""At most so many gaps are listed for a signal; all are counted."""

Positive = Annotated[float, Field(gt=0, allow_inf_nan=False)]
_NS = 1_000_000_000


class _Strict(BaseModel):
    model_config = ConfigDict(extra="forbid", frozen=True)


class Term(_Strict):
    """A signal of the log that a column is made of."""

    signal: str
    message: str | None = None
    factor: float = 1.0
    scale: float | None = None
    source_unit: str | None = None
    wrap: Positive | None = None
    channel: str | None = None
    source_address: Annotated[int, Field(ge=0, le=253)] | None = None
    not_available: Literal["j1939", "none"] | None = None

    @property
    def name(self) -> str:
        return f"{self.message}.{self.signal}" if self.message else self.signal


class Column(_Strict):
    """A column of the drive table: offset + the sum of its terms, in ``unit``."""

    unit: str
    terms: Annotated[list[Term], Field(min_length=1)]
    offset: float = 0.0
    min: float | None = None
    max: float | None = None
    max_gap_s: Positive | None = None

    @model_validator(mode="before")
    @classmethod
    def _one_term(cls, given):
        """A column of one signal may carry the keys of its term itself."""
        if isinstance(given, dict) and "terms" not in given:
            of_column = {k: v for k, v in given.items() if k in cls.model_fields}
            return {**of_column, "terms": [{k: v for k, v in given.items() if k not in of_column}]}
        return given

    @model_validator(mode="after")
    def _limits_of_one_term(self) -> Column:
        if len(self.terms) > 1 and (self.min is not None or self.max is not None):
            raise ValueError(
                "min and max judge the samples of one signal; a sum of terms has none of its own"
            )
        return self


class SignalMap(_Strict):
    """What a drive table is made of; the module's text says what the keys mean."""

    schema_: Literal[1] = Field(alias="schema")
    Ts_s: Positive
    columns: Annotated[dict[Annotated[str, Field(pattern=r"^[A-Za-z_]\w*$")], Column], Field(min_length=1)]
    max_gap_s: Positive = 0.5
    channel: str | None = None
    j1939: bool | None = None
    time: str | None = None
    format: Literal["csv", "parquet"] = "csv"

    def gap_s(self, column: str) -> float:
        """Longest pause that is interpolated in ``column``."""
        return self.columns[column].max_gap_s or self.max_gap_s

    @model_validator(mode="after")
    def _time_is_taken(self) -> SignalMap:
        if "t" in self.columns:
            raise ValueError("columns: t is the time")
        return self


def load_signal_map(path: Path) -> SignalMap:
    """Read and check a signal map. InputError names file, field and what was expected."""
    return checked(
        SignalMap,
        read_toml(Path(path), "a signal map"),
        "a signal map as `lpvguard ingest --help` describes",
        path,
    )


def map_of_project(project) -> SignalMap:
    """The signal map of a vehicle whose signals have a CAN place: bus value = factor * value."""
    without = [s.name for s in project.signals if s.can is None]
    if without:
        raise InputError(
            f"vehicle {project.name}",
            "signals",
            f"{', '.join(without)} have no `can` entry",
            "a message and a signal for each, or --dbc and --signals",
        )
    columns = {
        s.column: Column(
            unit=s.unit,
            min=s.min,
            max=s.max,
            terms=[Term(message=s.can.message, signal=s.can.signal, scale=1.0 / s.can.factor)],
        )
        for s in project.signals
    }
    return SignalMap(schema=1, Ts_s=project.Ts_s, columns=columns)


# ------------------------------------------------------------------------------------------------------ units

# To SI: dimension, factor.
_UNITS = {
    "rad": ("angle", 1.0),
    "deg": ("angle", np.pi / 180),
    "mrad": ("angle", 1e-3),
    "rad/s": ("rate", 1.0),
    "deg/s": ("rate", np.pi / 180),
    "mrad/s": ("rate", 1e-3),
    "m/s": ("speed", 1.0),
    "km/h": ("speed", 1 / 3.6),
    "mph": ("speed", 0.44704),
    "kn": ("speed", 1852 / 3600),
    "m/s2": ("acceleration", 1.0),
    "g": ("acceleration", 9.80665),
    "Pa": ("pressure", 1.0),
    "kPa": ("pressure", 1e3),
    "bar": ("pressure", 1e5),
    "MPa": ("pressure", 1e6),
    "psi": ("pressure", 6894.757293168),
    "m": ("length", 1.0),
    "mm": ("length", 1e-3),
    "s": ("time", 1.0),
    "ms": ("time", 1e-3),
    "N": ("force", 1.0),
    "kN": ("force", 1e3),
    "Nm": ("torque", 1.0),
    "%": ("ratio", 0.01),
    "1": ("ratio", 1.0),
}
_SPELLINGS = {
    "°": "deg",
    "degree": "deg",
    "degrees": "deg",
    "°/s": "deg/s",
    "degree/s": "deg/s",
    "degrees/s": "deg/s",
    "deg/sec": "deg/s",
    "rad/sec": "rad/s",
    "kph": "km/h",
    "kmh": "km/h",
    "kmph": "km/h",
    "m/s^2": "m/s2",
    "m/s²": "m/s2",
    "m/sec2": "m/s2",
    "m/s/s": "m/s2",
    "m/s**2": "m/s2",
    "n·m": "nm",
    "n*m": "nm",
}
_BY_LOWER_CASE = {name.lower(): name for name in _UNITS}


def unit_factor(source: str, target: str) -> float | None:
    """Factor from unit ``source`` to ``target``; None when it is unknown or they measure different things.

    >>> round(unit_factor("deg/s", "rad/s"), 6), unit_factor("km/h", "rad")
    (0.017453, None)
    """
    if source == target:
        return 1.0
    known = []
    for text in (source, target):
        plain = text.strip().lower().replace(" ", "")
        known.append(_UNITS.get(_BY_LOWER_CASE.get(_SPELLINGS.get(plain, plain), "")))
    if known[0] is None or known[1] is None or known[0][0] != known[1][0]:
        return None
    return known[0][1] / known[1][1]


# ---------------------------------------------------------------------------------------------------- signals


@dataclass
class _Source:
    """A term of a column with the samples of one log; time in ns of the log's clock, value in the column's
    unit."""

    t_ns: np.ndarray
    value: np.ndarray
    report: dict


def _scale(term: Term, column: str, unit: str, source_unit: str, where: Path) -> float:
    if term.scale is not None:
        return term.factor * term.scale
    given = term.source_unit or source_unit
    if not given and not term.message:
        given = unit  # a decoded log without units is taken to be in the column's
    conversion = unit_factor(given, unit)
    if conversion is None:
        raise InputError(
            where,
            f"columns.{column}",
            f"{term.name} is in {given or 'no unit'}, the column in {unit}",
            "scale (or source_unit) in the signal map",
        )
    return term.factor * conversion


def _unknown(where: Path, field_: str, name: str, what: str, names: Iterable[str]) -> InputError:
    near = difflib.get_close_matches(name, list(names), n=3, cutoff=0.4)
    return InputError(
        where, field_, f"no {what} {name}", f"one that exists{', such as ' + ', '.join(near) if near else ''}"
    )


def _of_several(messages: list, frames: Frames, given: _Inputs, where: str):
    """The message of a name; where a database gives the name to several, the one whose identifier is in the
    log."""
    if len(messages) > 1:
        in_log = [m for m in messages if len(find_frames(frames, m, j1939=is_j1939(m)))]
        if len(in_log) != 1:
            raise InputError(
                given.database_path,
                f"{where} of {given.map_path}",
                f"{len(messages)} messages are called {messages[0].name} ({', '.join(f'{m.frame_id:X}' for m in messages)})",
                "names of its own for each that is in the log",
            )
        messages = in_log
    return messages[0]


def _from_frames(frames: Frames, given: _Inputs, column: str, term: Term) -> _Source:
    map_path, where = given.map_path, f"columns.{column}"
    if term.message is None:
        raise InputError(
            map_path, where, f"{term.signal} names no message", "message = ... (the log holds raw CAN frames)"
        )
    by_name = {m.name: m for m in given.database.messages}
    if term.message not in by_name:
        raise _unknown(given.database_path, f"{where} of {map_path}", term.message, "message", by_name)
    message = _of_several(
        [m for m in given.database.messages if m.name == term.message], frames, given, where
    )
    signals = {s.name: s for s in message.signals}
    if term.signal not in signals:
        raise _unknown(
            given.database_path,
            f"{where} of {map_path}, message {message.name}",
            term.signal,
            "signal",
            signals,
        )
    signal = signals[term.signal]
    j1939 = is_j1939(message) if given.map.j1939 is None else given.map.j1939
    positions = find_frames(
        frames,
        message,
        j1939=j1939,
        channel=term.channel or given.map.channel,
        source_address=term.source_address,
        where=str(map_path),
    )
    codes = term.not_available or ("j1939" if j1939 else "none")
    samples = decode_signal(frames, positions, message, signal, j1939_codes=codes == "j1939")
    report: dict = {
        "message": message.name,
        "signal": signal.name,
        "frames": len(positions),
        "left_out": samples.left_out,
    }
    low, high = signal.minimum, signal.maximum
    if low is not None and high is not None and low < high:
        tolerance = 1e-9 * max(abs(float(low)), abs(float(high)))
        outside = (samples.value < float(low) - tolerance) | (samples.value > float(high) + tolerance)
        report["outside_the_range_of_the_database"] = int(outside.sum())
        if term.wrap is None:
            leaps = np.abs(np.diff(samples.value)) > _WRAP_SHARE * (float(high) - float(low))
            report["suspected_wraps"] = int(leaps.sum())
    scale = _scale(term, column, given.map.columns[column].unit, signal.unit or "", map_path)
    return _Source(frames.t_ns[samples.frame], _unwrap(samples.value, term, report) * scale, report)


def _from_table(table: Table, log: Path, given: _Inputs, column: str, term: Term) -> _Source:
    name = next((n for n in (term.name, term.signal) if n in table.series), None)
    if name is None:
        raise _unknown(log, f"columns.{column} of {given.map_path}", term.signal, "column", table.series)
    series: Series = table.series[name]
    finite = np.isfinite(series.value)
    report: dict = {
        "signal": name,
        "left_out": {"no value": int((~finite).sum())} if not finite.all() else {},
    }
    scale = _scale(term, column, given.map.columns[column].unit, series.unit, given.map_path)
    return _Source(series.t_ns[finite], _unwrap(series.value[finite], term, report) * scale, report)


def _unwrap(value: np.ndarray, term: Term, report: dict) -> np.ndarray:
    if term.wrap is None:
        return value
    unwrapped = np.unwrap(value, period=term.wrap)
    turns = np.rint((unwrapped - value) / term.wrap)
    report["wraps"] = int(np.count_nonzero(np.diff(turns)))
    return unwrapped


# ------------------------------------------------------------------------------------------------------ clock


@dataclass
class Clock:
    """The log's time axis cut where it jumps: [start, end) positions in the log, and the jumps."""

    t_ns: np.ndarray
    jumps: list[dict]
    cuts: list[int]


def clock_of(t_ns: np.ndarray, max_gap_s: float) -> Clock:
    """Find where the clock goes back by more than REORDER_S, or forward further than any gap that is
    interpolated."""
    step = np.diff(t_ns)
    back = step < -REORDER_S * _NS
    forward = step > max(max_gap_s, 1.0) * _NS
    clock = Clock(t_ns, jumps=[], cuts=[0])
    for i in np.flatnonzero(back | forward).tolist():
        clock.jumps.append(
            {
                "after_frame": i + 1,
                "kind": "backwards" if back[i] else "pause or jump forwards",
                "from_s": t_ns[i] / _NS,
                "to_s": t_ns[i + 1] / _NS,
            }
        )
        clock.cuts.append(i + 1)
    clock.cuts.append(len(t_ns))
    return clock


def _log_time(log: Frames | Table) -> np.ndarray:
    """Time of everything in the log, in its order: frames, or all samples of all series."""
    if isinstance(log, Frames):
        return log.t_ns
    axes = {id(s.t_ns): s.t_ns for s in log.series.values()}
    if not axes:
        return np.empty(0, np.int64)
    return next(iter(axes.values())) if len(axes) == 1 else np.sort(np.concatenate(list(axes.values())))


# ------------------------------------------------------------------------------------------------- resampling


@dataclass
class _Piece:
    """Rows of a drive table without a gap: t (rows,) [s], each column (rows,)."""

    t: np.ndarray
    values: dict[str, np.ndarray]
    log_start_s: float


def _resample(grid_ns: np.ndarray, source: _Source, max_gap_ns: float) -> tuple[np.ndarray, np.ndarray]:
    """Linear interpolation at ``grid_ns``; also True where the samples around lie at most ``max_gap_ns``
    apart."""
    t = source.t_ns
    after = np.searchsorted(t, grid_ns, side="left")
    exact = t[np.minimum(after, len(t) - 1)] == grid_ns
    before = np.where(exact, after, after - 1)
    inside = (before >= 0) & (after < len(t))
    gap = t[np.clip(after, 0, len(t) - 1)] - t[np.clip(before, 0, len(t) - 1)]
    origin = grid_ns[0]
    value = np.interp((grid_ns - origin) / _NS, (t - origin) / _NS, source.value)
    return value, inside & (gap <= max_gap_ns)


def _runs(mask: np.ndarray) -> list[tuple[int, int]]:
    """[first, end) of every stretch of True."""
    edges = np.flatnonzero(np.diff(np.concatenate(([0], mask.astype(np.int8), [0]))))
    return list(zip(edges[::2].tolist(), edges[1::2].tolist(), strict=False))


class _TableMaker:
    """Makes the pieces of one log; collects what was left out."""

    def __init__(self, signal_map: SignalMap):
        self.map = signal_map
        self.pieces: list[_Piece] = []
        self.left_out: list[dict] = []
        self._first_start: int | None = None

    def add_stretch(self, first_ns: int, last_ns: int, members: dict[str, list[_Source]]) -> None:
        """Grid of one stretch of unbroken clock; ``members`` are the samples in it."""
        empty = [c for c, terms in members.items() if any(len(s.t_ns) == 0 for s in terms)]
        if empty:
            self._leave_out(first_ns, last_ns, empty, "no sample in this stretch of the log")
            return
        start = max(int(s.t_ns[0]) for terms in members.values() for s in terms)
        end = min(int(s.t_ns[-1]) for terms in members.values() for s in terms)
        Ts_ns = self.map.Ts_s * _NS
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
            gap_ns = self.map.gap_s(name) * _NS
            parts = [_resample(grid, s, gap_ns) for s in terms]
            values[name] = sum(p[0] for p in parts) + column.offset
            good[name] = np.logical_and.reduce([p[1] for p in parts])
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
            self.pieces.append(
                _Piece(t, {n: v[first:end] for n, v in values.items()}, int(grid[first]) / _NS)
            )

    def _leave_out(self, first_ns: int, last_ns: int, columns: list[str], reason: str) -> None:
        self.left_out.append(
            {"from_s": first_ns / _NS, "to_s": last_ns / _NS, "columns": columns, "reason": reason}
        )


def _within_limits(column: Column, terms: list[_Source]) -> None:
    """Drops the samples outside [min, max] of the column (which then has one term)."""
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


def _in_order(source: _Source) -> _Source:
    """Samples by time. Two at the same time (frames read from a buffer) both stay: a step, of the earlier to
    the later."""
    t = source.t_ns
    source.report["same_time"] = int((np.diff(t) == 0).sum())
    if (np.diff(t) < 0).any():
        order = np.argsort(t, kind="stable")
        source.report["out_of_order"] = int((np.diff(t) < 0).sum())
        return _Source(t[order], source.value[order], source.report)
    return source


def _describe(source: _Source, max_gap_s: float) -> dict:
    """The report of a term: how many samples, how often, and where they pause."""
    step = np.diff(source.t_ns)
    pauses = np.flatnonzero(step > max_gap_s * _NS)
    listed = [[source.t_ns[i] / _NS, source.t_ns[i + 1] / _NS] for i in pauses[:_LISTED].tolist()]
    return {
        **source.report,
        "samples": len(source.t_ns),
        "median_period_s": float(np.median(step)) / _NS if len(step) else None,
        "longest_pause_s": float(step.max()) / _NS if len(step) else None,
        "gaps": len(pauses),
        "gaps_s": listed,
    }


def _stretch(log: Frames | Table, clock: Clock, first: int, end: int) -> Frames | Table:
    """The part of the log between two jumps of its clock."""
    if len(clock.cuts) == 2:
        return log
    if isinstance(log, Frames):
        cut = slice(first, end)
        return Frames(
            log.t_ns[cut],
            log.id[cut],
            log.channel[cut],
            log.length[cut],
            log.data[cut],
            log.channels,
            log.left_out,
        )
    low, high = int(clock.t_ns[first]), int(clock.t_ns[end - 1])
    series = {}
    for name, s in log.series.items():
        # One time axis: the same positions. Several: only pauses cut, so times say what lies on which side.
        inside = slice(first, end) if len(s.t_ns) == len(clock.t_ns) else (s.t_ns >= low) & (s.t_ns <= high)
        series[name] = Series(s.t_ns[inside], s.value[inside], s.unit)
    return Table(series)


# ------------------------------------------------------------------------------------------------------- runs


@dataclass(frozen=True)
class _Inputs:
    database: object
    database_path: Path | str
    map: SignalMap
    map_path: Path


def _sources(log: Frames | Table, path: Path, given: _Inputs) -> dict[str, list[_Source]]:
    sources = {}
    for name, column in given.map.columns.items():
        if isinstance(log, Frames):
            terms = [_from_frames(log, given, name, term) for term in column.terms]
        else:
            terms = [_from_table(log, path, given, name, term) for term in column.terms]
        _within_limits(column, terms)
        sources[name] = [_in_order(source) for source in terms]
    return sources


def _ingest_one(path: Path, given: _Inputs) -> tuple[list[_Piece], dict]:
    """Pieces and report of one log; InputError when nothing of it remains."""
    log = read_log(path, time_column=given.map.time)
    t_ns = _log_time(log)
    if len(t_ns) == 0:
        raise InputError(path, "", "holds no signal", "at least one column of numbers")
    clock = clock_of(t_ns, max(given.map.gap_s(name) for name in given.map.columns))
    maker, stretches = _TableMaker(given.map), []
    for first, end in zip(clock.cuts, clock.cuts[1:], strict=False):
        sources = _sources(_stretch(log, clock, first, end), path, given)
        t = t_ns[first:end]
        maker.add_stretch(int(t.min()), int(t.max()), sources)
        stretches.append(
            {
                "from_s": int(t.min()) / _NS,
                "to_s": int(t.max()) / _NS,
                "columns": {
                    name: {
                        "unit": column.unit,
                        "terms": [_describe(s, given.map.gap_s(name)) for s in sources[name]],
                    }
                    for name, column in given.map.columns.items()
                },
            }
        )
    if not maker.pieces:
        first_left = maker.left_out[0]
        columns = ", ".join(
            f"{c} ({', '.join(t.name for t in given.map.columns[c].terms)})" for c in first_left["columns"]
        )
        raise InputError(
            path,
            columns,
            f"nothing remains: {first_left['reason']}",
            "every column of the map at the same time",
        )
    report = {
        "log": path.name,
        "sha256": artefacts.file_hash(path),
        "kind": "raw frames" if isinstance(log, Frames) else "decoded signals",
        "frames": len(log) if isinstance(log, Frames) else None,
        "not_frames": log.left_out if isinstance(log, Frames) else {},
        "channels": log.channels if isinstance(log, Frames) else [],
        "resampling": f"linear interpolation of each signal at its own times, grid of {given.map.Ts_s:g} s, no filter",
        "clock_jumps": clock.jumps,
        "left_out": maker.left_out,
        "stretches": stretches,
    }
    return maker.pieces, report


def _write_piece(piece: _Piece, path: Path) -> None:
    import pyarrow as pa
    import pyarrow.csv as pa_csv
    import pyarrow.parquet as pa_parquet

    table = pa.table({"t": piece.t, **piece.values})
    if path.suffix == ".parquet":
        pa_parquet.write_table(table, path)
    else:
        pa_csv.write_csv(table, path, pa_csv.WriteOptions(quoting_style="none"))


def ingest(logs: Iterable[Path], *, dbc: Path | None, signals_map: Path | SignalMap, out: Path) -> dict:
    """Turn ``logs`` into uniform drive tables in the folder ``out``; returns what the reports say, log by
    log.

    ``dbc`` None takes our own DBC; decoded logs need none. ``signals_map`` is a file, or a map that is made
    already (``map_of_project``). Raises InputError for a file that cannot be read, a map that does not fit
    database or log, two logs of the same name, and a log of which nothing remains; nothing is written then.
    """
    paths = [Path(log) for log in logs]
    if not paths:
        raise InputError("ingest", "LOG", "no log given", "at least one")
    for path in paths:
        if sum(stem(path) == stem(other) for other in paths) > 1:
            raise InputError(
                path, "", f"two logs would both become the drive {stem(path)}", "logs with different names"
            )
    ready = isinstance(signals_map, SignalMap)
    given = _Inputs(
        database=load_database(dbc) if dbc else own_database(),
        database_path=dbc or "lpvguard's own DBC (no --dbc given)",
        map=signals_map if ready else load_signal_map(signals_map),
        map_path=Path("signal map") if ready else Path(signals_map),
    )
    reports = {}
    with artefacts.new_folder(out, "ingest") as folder:
        drives = []
        for path in paths:
            pieces, report = _ingest_one(path, given)
            report["drives"] = []
            for k, piece in enumerate(pieces, start=1):
                name = stem(path) + (f"_{k}" if len(pieces) > 1 else "")
                file = f"{name}.{given.map.format}"
                _write_piece(piece, folder / file)
                drives.append(name)
                report["drives"].append(
                    {
                        "file": file,
                        "rows": len(piece.t),
                        "t_first_s": float(piece.t[0]),
                        "t_last_s": float(piece.t[-1]),
                        "log_time_of_first_row_s": piece.log_start_s,
                    }
                )
            artefacts.write_files(folder, {f"{stem(path)}.report.json": artefacts.to_json(report)})
            reports[stem(path)] = report
        inputs = {p.name: artefacts.file_hash(p) for p in [*paths, *([Path(dbc)] if dbc else [])]}
        artefacts.write_files(
            folder,
            {
                "experiments.csv": "experiment,split\n" + "".join(f"{d},unassigned\n" for d in drives),
                artefacts.MANIFEST: artefacts.manifest(
                    "ingest", inputs=inputs, signal_map=given.map.model_dump(by_alias=True)
                ),
            },
        )
    return reports
