"""Stage 0: turn raw logs into uniform drive tables, with a report of what was left out and why.

Reads   logs: candump, ASC, BLF, TRC, MF4, CSV, VBOX, JSON, Parquet (can/logs.py)
        a CAN database
        a signal map (signal_map.py)
Writes  into the folder <out>

    <log>.csv           one table a drive (<log>_1, _2, ... when it falls into pieces): t [s] and the map's
                        columns
    <log>.report.json   samples, gaps, wraps, absent values, clock jumps, stretches left out
    experiments.csv     the index that `lpvguard identify` reads; every drive has the split "unassigned"
    MANIFEST.json       hashes of the inputs, settings, tool version, and of the files as they were written

Next    tables.py reads the tables
"""

from __future__ import annotations

import difflib
import warnings
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from ..base import artefacts
from ..base.errors import InputError, InputWarning
from ..can.decode import (
    contradicting_range,
    decode_signal,
    find_frames,
    is_j1939,
    load_database,
    own_database,
    signed,
)
from ..can.logs import Frames, Series, Table, read_log, stem
from .resample import (
    NS,
    LogClock,
    Piece,
    Source,
    TableMaker,
    clock_of,
    describe,
    in_order,
    within_limits,
    without_lone,
)
from .signal_map import SignalMap, Term, load_signal_map
from .tables import index_text
from .units import unit_factor

if TYPE_CHECKING:  # cantools takes long to import
    from cantools.database.can import Database, Message, Signal

_REPEATED = 0.5
"""A table repeats the values of a slower signal where a smaller share of its samples is new."""
_WRAP_SHARE = 0.75
"""A step by more than this share of a signal's range is reported as a suspected wrap."""


# ---------------------------------------------------------------------------------------------------- signals


def _scale(term: Term, column: str, unit: str, source_unit: str, where: Path) -> float:
    if term.scale is not None:
        return term.factor * term.scale
    source = term.source_unit or source_unit
    if not source and not term.message:
        source = unit  # a decoded log without units is taken to be in the column's
    conversion = unit_factor(f"{source}/s" if term.rate and source != unit else source, unit)
    if conversion is None:
        raise InputError(
            where,
            f"columns.{column}",
            f"{term.name} is in {source or 'no unit'}, the column in {unit}",
            "scale (or source_unit) in the signal map",
        )
    return term.factor * conversion


def _unknown(where: Path | str, field_: str, name: str, what: str, names: Iterable[str]) -> InputError:
    near = difflib.get_close_matches(name, list(names), n=3, cutoff=0.4)
    return InputError(
        where, field_, f"no {what} {name}", f"one that exists{', such as ' + ', '.join(near) if near else ''}"
    )


def _of_several(messages: list[Message], frames: Frames, inputs: Inputs, where: str) -> Message:
    """Message of a name; if several have it, the one whose identifier is in the log."""
    if len(messages) > 1:
        in_log = [m for m in messages if len(find_frames(frames, m, j1939=is_j1939(m)))]
        if len(in_log) != 1:
            raise InputError(
                inputs.database_path,
                f"{where} of {inputs.map_path}",
                f"{len(messages)} messages are called {messages[0].name} "
                f"({', '.join(f'{m.frame_id:X}' for m in messages)})",
                "a different name for each message in the log",
            )
        messages = in_log
    return messages[0]


def _warn_of_range(message: str, signal: Signal, outside: int, count: int) -> None:
    """Warn where a drive has values outside the database's range, which the ECU would refuse."""
    if not outside:
        return
    why = contradicting_range(signal) or (
        f"signal {signal.name}: the database's range [{signal.minimum:g}|{signal.maximum:g}] leaves them "
        "out; an ECU that is generated from it refuses such frames"
    )
    warnings.warn(f"message {message}: {outside} of {count} values: {why}", InputWarning, stacklevel=1)


def _from_frames(frames: Frames, inputs: Inputs, column: str, term: Term) -> Source:
    map_path, where = inputs.map_path, f"columns.{column}"
    if term.message is None:
        raise InputError(
            map_path, where, f"{term.signal} names no message", "message = ... (the log holds raw CAN frames)"
        )
    by_name = {m.name: m for m in inputs.database.messages}
    if term.message not in by_name:
        raise _unknown(inputs.database_path, f"{where} of {map_path}", term.message, "message", by_name)
    message = _of_several(
        [m for m in inputs.database.messages if m.name == term.message], frames, inputs, where
    )
    signals = {s.name: s for s in message.signals}
    if term.signal not in signals:
        raise _unknown(
            inputs.database_path,
            f"{where} of {map_path}, message {message.name}",
            term.signal,
            "signal",
            signals,
        )
    signal = signals[term.signal]
    j1939 = is_j1939(message) if inputs.map.j1939 is None else inputs.map.j1939
    positions = find_frames(
        frames,
        message,
        j1939=j1939,
        channel=term.channel or inputs.map.channel,
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
        _warn_of_range(message.name, signal, int(outside.sum()), len(outside))
        if term.wrap is None:
            leaps = np.abs(np.diff(samples.value)) > _WRAP_SHARE * (float(high) - float(low))
            report["suspected_wraps"] = int(leaps.sum())
    if term.sign is not None:
        if term.sign not in signals:
            raise _unknown(inputs.database_path, f"{where} of {map_path}, sign", term.sign, "signal", signals)
        samples = signed(frames, samples, message, signals[term.sign])
    scale = _scale(term, column, inputs.map.columns[column].unit, signal.unit or "", map_path)
    return _term_source(frames.t_ns[samples.frame], samples.value, scale, term, report)


def _from_table(table: Table, log: Path, inputs: Inputs, column: str, term: Term) -> Source:
    name = next((n for n in (term.name, term.signal) if n in table.series), None)
    if name is None:
        raise _unknown(log, f"columns.{column} of {inputs.map_path}", term.signal, "column", table.series)
    series: Series = table.series[name]
    finite = np.isfinite(series.value)
    report: dict = {
        "signal": name,
        "left_out": {"no value": int((~finite).sum())} if not finite.all() else {},
    }
    scale = _scale(term, column, inputs.map.columns[column].unit, series.unit, inputs.map_path)
    return _term_source(series.t_ns[finite], series.value[finite], scale, term, report)


def _term_source(t_ns: np.ndarray, value: np.ndarray, scale: float, term: Term, report: dict) -> Source:
    """Samples of a term in the column's unit. A rate stands between two samples, without repeated ones."""
    value = _unwrap(value, term, report) * scale
    if not term.rate:
        return Source(t_ns, value, report)
    new = np.diff(value, prepend=np.inf) != 0
    if new.mean() < _REPEATED:
        t_ns, value = t_ns[new], value[new]
    steps = np.diff(t_ns)
    rising = steps > 0
    return Source((t_ns[:-1] + steps // 2)[rising], np.diff(value)[rising] / steps[rising] * NS, report)


def _unwrap(value: np.ndarray, term: Term, report: dict) -> np.ndarray:
    if term.wrap is None:
        return value
    unwrapped = np.unwrap(value, period=term.wrap)
    turns = np.rint((unwrapped - value) / term.wrap)
    report["wraps"] = int(np.count_nonzero(np.diff(turns)))
    return unwrapped


def _log_time(log: Frames | Table) -> np.ndarray:
    """Times of all frames, or of all samples of all series, in the order of the log."""
    if isinstance(log, Frames):
        return log.t_ns
    axes = {id(s.t_ns): s.t_ns for s in log.series.values()}
    if not axes:
        return np.empty(0, np.int64)
    return next(iter(axes.values())) if len(axes) == 1 else np.sort(np.concatenate(list(axes.values())))


def _stretch(log: Frames | Table, clock: LogClock, first: int, end: int) -> Frames | Table:
    """Part of the log between two jumps of its clock."""
    if len(clock.cuts) == 2:
        return log
    if isinstance(log, Frames):
        return log.at(slice(first, end))
    low, high = int(clock.t_ns[first]), int(clock.t_ns[end - 1])
    series = {}
    for name, s in log.series.items():
        # One time axis: the same positions. Several: only pauses cut, so times say what lies on which side.
        inside = slice(first, end) if len(s.t_ns) == len(clock.t_ns) else (s.t_ns >= low) & (s.t_ns <= high)
        series[name] = Series(s.t_ns[inside], s.value[inside], s.unit)
    return Table(series)


# ------------------------------------------------------------------------------------------------------- runs


@dataclass(frozen=True)
class Inputs:
    """Inputs common to all logs: the CAN database and the signal map, each with its origin.

    Attributes
    ----------
    database : Database
    database_path, map_path : Path or str
    map : SignalMap
    schema : Path or None, log.capnp of openpilot's logs
    """

    database: Database
    database_path: Path | str
    map: SignalMap
    map_path: Path
    schema: Path | None = None


def _sources(log: Frames | Table, path: Path, inputs: Inputs) -> dict[str, list[Source]]:
    sources = {}
    for name, column in inputs.map.columns.items():
        if isinstance(log, Frames):
            terms = [_from_frames(log, inputs, name, term) for term in column.terms]
        else:
            terms = [_from_table(log, path, inputs, name, term) for term in column.terms]
        within_limits(column, terms)
        sources[name] = [in_order(source) for source in terms]
        for source in sources[name]:
            without_lone(name, source)
    return sources


def _ingest_one(path: Path, inputs: Inputs) -> tuple[list[Piece], dict]:
    """Pieces and report of one log; InputError when nothing of it remains."""
    log = read_log(path, time_column=inputs.map.time, rate_hz=inputs.map.rate_hz, schema=inputs.schema)
    t_ns = _log_time(log)
    if len(t_ns) == 0:
        raise InputError(path, "", "holds no signal", "at least one column of numbers")
    clock = clock_of(t_ns, max(inputs.map.gap_s(name) for name in inputs.map.columns))
    maker, stretches = TableMaker(inputs.map), []
    for first, end in zip(clock.cuts, clock.cuts[1:], strict=False):
        sources = _sources(_stretch(log, clock, first, end), path, inputs)
        t = t_ns[first:end]
        maker.add_stretch(int(t.min()), int(t.max()), sources)
        stretches.append(
            {
                "from_s": int(t.min()) / NS,
                "to_s": int(t.max()) / NS,
                "columns": {
                    name: {
                        "unit": column.unit,
                        "terms": [describe(s, inputs.map.gap_s(name)) for s in sources[name]],
                    }
                    for name, column in inputs.map.columns.items()
                },
            }
        )
    if not maker.pieces:
        first_left = maker.left_out[0]
        columns = ", ".join(
            f"{c} ({', '.join(t.name for t in inputs.map.columns[c].terms)})" for c in first_left["columns"]
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
        "resampling": "linear interpolation of each signal at its own times, "
        f"grid of {inputs.map.Ts_s:g} s, no filter",
        "clock_jumps": clock.jumps,
        "left_out": maker.left_out,
        "stretches": stretches,
    }
    return maker.pieces, report


def _write_piece(piece: Piece, path: Path) -> None:
    import pyarrow as pa
    import pyarrow.csv as pa_csv
    import pyarrow.parquet as pa_parquet

    table = pa.table({"t": piece.t, **piece.values})
    if path.suffix == ".parquet":
        pa_parquet.write_table(table, path)
    else:
        pa_csv.write_csv(table, path, pa_csv.WriteOptions(quoting_style="none"))


def write_tables(path: Path, inputs: Inputs, folder: Path, halved: bool = False) -> dict:
    """Write the drive tables and the report of one log into an existing folder.

    Parameters
    ----------
    path : Path
    inputs : Inputs
    folder : Path
    halved : bool, a log of one drive becomes two drives, default False

    Returns
    -------
    dict, the report

    Raises
    ------
    InputError
        If nothing of the log remains.
    """
    pieces, report = _ingest_one(path, inputs)
    if halved and len(pieces) == 1:
        pieces = _halves(pieces[0])
    report["drives"] = []
    for k, piece in enumerate(pieces, start=1):
        file = stem(path) + (f"_{k}" if len(pieces) > 1 else "") + f".{inputs.map.format}"
        _write_piece(piece, folder / file)
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
    return report


def _halves(piece: Piece) -> list[Piece]:
    """The first and the second half of a drive."""
    middle = len(piece.t) // 2
    later = piece.log_start_s + float(piece.t[middle] - piece.t[0])
    return [
        Piece(piece.t[part], {n: x[part] for n, x in piece.values.items()}, start)
        for part, start in ((slice(middle), piece.log_start_s), (slice(middle, None), later))
    ]


def ingest(
    logs: Iterable[Path],
    *,
    dbc: Path | None,
    signals_map: Path | SignalMap,
    out: Path,
    schema: Path | None = None,
) -> dict:
    """Turn logs into uniform drive tables in a folder.

    Nothing is written when a log is refused.

    Parameters
    ----------
    logs : Iterable of Path
    dbc : Path, or None for our own DBC; decoded logs need none
    signals_map : Path, or a SignalMap of `map_of_project`
    out : Path, new folder
    schema : Path, optional, log.capnp of openpilot's logs

    Returns
    -------
    dict, the reports by log

    Raises
    ------
    InputError
        If a file cannot be read, the map does not fit, two logs share a name, or nothing of one remains.
    """
    paths = [Path(log) for log in logs]
    if not paths:
        raise InputError("ingest", "LOG", "no log given", "at least one")
    for path in paths:
        if sum(stem(path) == stem(other) for other in paths) > 1:
            raise InputError(
                path, "", f"two logs would both become the drive {stem(path)}", "logs with different names"
            )
    inputs = Inputs(
        load_database(dbc) if dbc else own_database(),
        dbc or "lpvguard's own DBC (no --dbc given)",
        *(
            (signals_map, Path("signal map"))
            if isinstance(signals_map, SignalMap)
            else (load_signal_map(signals_map), Path(signals_map))
        ),
        schema,
    )
    reports = {}
    with artefacts.new_folder(out, "ingest") as folder:
        drives: list[tuple[str, str, str]] = []
        for path in paths:
            reports[stem(path)] = report = write_tables(path, inputs, folder)
            drives += [(Path(d["file"]).stem, "unassigned", stem(path)) for d in report["drives"]]
        hashes = {p.name: artefacts.file_hash(p) for p in [*paths, *([Path(dbc)] if dbc else [])]}
        artefacts.write_files(
            folder,
            {
                "experiments.csv": index_text(drives),
                artefacts.MANIFEST: artefacts.manifest(
                    "ingest", inputs=hashes, signal_map=inputs.map.model_dump(by_alias=True)
                ),
            },
        )
    return reports
