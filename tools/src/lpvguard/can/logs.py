"""Read logs: raw CAN frames, or tables of decoded signals.

raw      candump (-l, -L, and the screen with -t), ASC, BLF, TRC, MF4 with bus logging, CSV and Parquet with
         the columns of python-can (timestamp, arbitration_id, extended, dlc, data); a line a frame of
         BUSMASTER, CRTD, CanKing, Microchip's analyzer and slcan (line_logs.py);
         each also packed (packed.py) where it is text
decoded  CSV, VBOX, JSON, Parquet and MATLAB files with one column a signal, text also with one row a signal
         (long_tables.py), folders with one of them a topic (topics.py), MF4 with one channel a signal;
         rosbag, MCAP, ULog, DataFlash and openpilot's logs (foreign_logs.py)

A compiled parser reads candump logs, because python-can reads their bus-off reports as frames. python-can and
asammdf read the other raw forms.
"""

import ctypes
import re
import warnings
from dataclasses import replace
from pathlib import Path

import numpy as np

from ..base import artefacts, native
from ..base.errors import InputError, InputWarning
from .damaged import python_can_reader
from .foreign_logs import read_foreign, reader_of
from .line_logs import form_of, read_lines
from .log_types import ERROR_REPORT as ERROR_REPORT
from .log_types import EXTENDED as EXTENDED
from .log_types import FD_BYTES, frames_of_rows, row_of
from .log_types import Frames as Frames
from .log_types import Series as Series
from .log_types import Table as Table
from .matlab import read_matlab
from .mf4 import read_mf4
from .packed import PACKED, names_inside, suffix_inside, unpacked, unpacked_folder
from .sheets import SHEET_SUFFIXES, read_sheet
from .sign_bits import sign_columns
from .topics import joined, topic_files
from .trc import read_trc

INDEX = "experiments.csv"
"""Index of a drive folder."""

_NAME_BYTES, _CHANNELS, _COUNTS = 16, 64, 6
_CANDUMP_SUFFIXES = {".log", ".candump", ".txt", ".crtd", ".can", ".slcan"}
_PYTHON_CAN_SUFFIXES = {".asc", ".blf"}
_TRC_SUFFIX = ".trc"
_MAT_SUFFIX = ".mat"
_MDF_SUFFIXES = {".mf4", ".mdf", ".dat"}
_VBO_SUFFIX = ".vbo"
_JSON_SUFFIXES = {".json", ".jsonl", ".ndjson"}
_TEXT_SUFFIXES = {".csv", ".tsv", ".txt", _VBO_SUFFIX, *_JSON_SUFFIXES, *SHEET_SUFFIXES}
_FOREIGN_SUFFIXES = {".bag", ".mcap", ".ulg", ".bin", ".tlog", ".db3"}
_SUFFIXES = {
    *PACKED,
    *_TEXT_SUFFIXES,
    *_CANDUMP_SUFFIXES,
    *_PYTHON_CAN_SUFFIXES,
    _TRC_SUFFIX,
    *_MDF_SUFFIXES,
    *_FOREIGN_SUFFIXES,
    ".parquet",
    _MAT_SUFFIX,
}
_RAW_COLUMNS = {"timestamp", "arbitration_id", "data"}


def candump_line(t_us: int, channel: str, identifier: int, data: bytes) -> str:
    """Write a line in the form of candump -L and candump -l.

    Parameters
    ----------
    t_us : int, us
    channel : str
    identifier : int, with EXTENDED, and ERROR_REPORT for an error report
    data : bytes

    Returns
    -------
    str
    """
    wide = 8 if identifier & (EXTENDED | ERROR_REPORT) else 3
    frame = f"{identifier & ~EXTENDED:0{wide}X}#{data.hex().upper()}"
    return f"({t_us // 10**6}.{t_us % 10**6:06d}) {channel} {frame}\n"


def read_log(
    path: Path, *, time_column: str | None = None, rate_hz: float | None = None, schema: Path | None = None
) -> Frames | Table:
    """Read one log; its form follows from the suffix, and from the content of CSV, Parquet and MF4.

    Parameters
    ----------
    path : Path
    time_column : str, optional, time column of a decoded table, by default the first of t, time, timestamp
    rate_hz : float, optional, Hz, rows per second of a decoded table, used instead of its times
    schema : Path, optional, file log.capnp for an openpilot log

    Returns
    -------
    Frames or Table

    Raises
    ------
    InputError
        If the file is missing, of unknown form, or holds no frame.
    """
    path = Path(path)
    if reader_of(path) is not None and path.exists():
        return read_foreign(path, schema)
    if path.is_dir() and (topics := topic_files(path)):
        tables = {p.stem: read_log(p, time_column=time_column, rate_hz=rate_hz) for p in topics}
        return joined(path, {topic: table for topic, table in tables.items() if isinstance(table, Table)})
    if not path.is_file():
        raise InputError(path, "", "no such file", "a log: candump, ASC, BLF, MF4, CSV or Parquet")
    suffix = suffix_inside(path)
    in_lines = form_of(_text(path, _HEAD)) if suffix in _CANDUMP_SUFFIXES else None
    if in_lines is not None:
        log: Frames | Table = read_lines(path, _text(path), in_lines)
    elif suffix in _CANDUMP_SUFFIXES and not _is_table(path):
        log = _read_candump(path)
    elif suffix in _PYTHON_CAN_SUFFIXES:
        log = _read_python_can(path)
    elif suffix == _TRC_SUFFIX:
        log = read_trc(path, _text(path))
    elif suffix in _MDF_SUFFIXES:
        log = read_mf4(path)
    elif suffix in {*_TEXT_SUFFIXES, *_CANDUMP_SUFFIXES, ".parquet", _MAT_SUFFIX}:
        log = _read_table(path, suffix, time_column, rate_hz)
    else:
        raise InputError(
            path,
            "",
            f"unknown kind of log {suffix or '(no suffix)'}",
            ".log (candump), .asc, .blf, .trc, .mf4, .csv, .tsv, .txt, .vbo, .jsonl, .xlsx, .parquet, .mat; "
            "text also with .gz, .bz2, .xz, .zst, or alone in a .zip",
        )
    if isinstance(log, Frames) and len(log) == 0:
        raise InputError(path, "", "holds no data frame" + _in_words(log.left_out), "at least one frame")
    return log


def _text(path: Path, most: int | None = None) -> str:
    """The first bytes of a log, or all, as text."""
    return unpacked(path, most).decode("utf-8-sig", errors="replace")


def logs_among(paths: list[Path]) -> list[Path]:
    """List the logs that paths name; for a folder or a .zip all in it, in the order of their names.

    Files of other kinds are passed over, and a drive folder's index is too. Folders of folders are not
    searched; those of a .zip are.

    Parameters
    ----------
    paths : list[Path]

    Returns
    -------
    list[Path]

    Raises
    ------
    InputError
        If a folder holds none.
    """
    logs: list[Path] = []
    for path in paths:
        folder = path if path.is_dir() else _archive(path)
        if folder is None:
            logs += [path] if path.name != INDEX else []
            continue
        inside = _inside(folder, deep=folder != path)
        if not inside:
            raise InputError(path, "", "holds no log", "a folder of logs, or the logs themselves")
        logs += inside
    if not logs:
        raise InputError(", ".join(map(str, paths)), "", "is the index of a folder and no drive", "a drive")
    for path in logs:
        artefacts.require_unicode(path)
    return logs


def _inside(folder: Path, *, deep: bool) -> list[Path]:
    """List the logs of a folder; with ``deep``, those of its folders, too."""
    if reader_of(folder) is not None or topic_files(folder):  # one recording
        return [folder]
    logs: list[Path] = []
    for path in sorted(folder.iterdir()):
        unpacked_here = _archive(path)
        if unpacked_here is not None or (deep and path.is_dir()):
            logs += _inside(unpacked_here or path, deep=True)
        elif path.name != INDEX and (_is_log(path) or topic_files(path)):
            logs.append(path)
    return logs


def _archive(path: Path) -> Path | None:
    """The folder of a .zip with several files, or with one that is no text; None for any other file."""
    if path.suffix.lower() != ".zip" or not path.is_file():
        return None
    files = names_inside(path)
    text = {*_TEXT_SUFFIXES, *_CANDUMP_SUFFIXES, _TRC_SUFFIX}
    return None if len(files) == 1 and Path(files[0]).suffix.lower() in text else unpacked_folder(path)


def _is_log(path: Path) -> bool:
    """Tell from its name if a folder's entry is a log."""
    if reader_of(path) is not None or not path.is_file():
        return reader_of(path) is not None
    try:
        return suffix_inside(path) in _SUFFIXES - _FOREIGN_SUFFIXES - PACKED - {".json"}
    except InputError:  # a .zip of something else
        return False


def stem(path: Path) -> str:
    """Return a log's file name without suffixes; the name of an openpilot log includes its folder.

    Parameters
    ----------
    path : Path

    Returns
    -------
    str
    """
    name = path.name
    for suffix in reversed(path.suffixes):
        if suffix.lower() in _SUFFIXES:
            name = name.removesuffix(suffix)
    return f"{path.absolute().parent.name}_{name}" if name in ("rlog", "qlog") else name


def _is_table(path: Path) -> bool:
    """Tell if a file with a candump suffix holds a table: named columns of numbers and no frame."""
    from .text_tables import read_text_table

    head = unpacked(path, _HEAD)
    if _SCREEN.search(head) or any(_LINE.fullmatch(line) for line in head.split(b"\n")):
        return False
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", InputWarning)
            return len(read_text_table(head, path).table) > 1
    except (InputError, ValueError):
        return False


def is_raw_table(path: Path) -> bool:
    """Tell if a CSV or Parquet file holds raw frames; False if it cannot be read.

    Parameters
    ----------
    path : Path

    Returns
    -------
    bool
    """
    import pyarrow.parquet as pa_parquet

    from .raw_tables import is_raw

    if path.suffix.lower() == _MAT_SUFFIX:
        return False
    try:
        if path.suffix.lower() == ".parquet":
            return set(pa_parquet.read_schema(path).names) >= _RAW_COLUMNS
        with path.open(encoding="utf-8") as text:
            return is_raw(re.split(r"[;,\t]", text.readline().strip()))
    except (OSError, ValueError):  # of pyarrow too
        return False


def _in_words(left_out: dict[str, int]) -> str:
    return " (" + ", ".join(f"{n} {kind}" for kind, n in left_out.items()) + ")" if left_out else ""


# ---------------------------------------------------------------------------------------------------- candump


def _read_candump(path: Path) -> Frames:
    compressed = path.suffix.lower() in PACKED or path.stat().st_size == 0  # an empty file cannot be mapped
    text = np.frombuffer(unpacked(path), np.uint8) if compressed else np.memmap(path, np.uint8, "r")
    frames = candump_frames(text)
    if len(frames) == 0:
        line = frames.left_out.get("first line that is no frame", 1)
        raise InputError(
            path,
            f"line {line}",
            "no frame in the file",
            "(seconds) interface identifier#data, as candump -l writes, or the screen of candump -t a",
        )
    steps = np.diff(frames.t_ns)
    back = int((steps < 0).sum())
    if back > _BACKWARDS * len(frames) or (len(steps) > _MANY and not steps.any()):
        what = f"{back} of {len(frames)} go back" if back else f"all {len(frames)} are the same"
        raise InputError(
            path,
            "times",
            f"{what}: each counts from the frame before, as candump -t d writes",
            "absolute times, as candump -t a, -t z or -l writes",
        )
    return frames


def candump_frames(text: np.ndarray) -> Frames:
    """Parse whole lines of a candump log or of candump's screen output.

    Parameters
    ----------
    text : ndarray (bytes,) of uint8

    Returns
    -------
    Frames
    """
    if b"\x1b[" in text[:_HEAD].tobytes():
        text = np.frombuffer(_COLOUR.sub(b"", text.tobytes()), np.uint8)
    if _SCREEN.search(text[:_HEAD].tobytes()):
        text = np.frombuffer(_SCREEN.sub(_as_logged, text.tobytes()), np.uint8)
    return _parse_candump(text)


_MANY = 20
"""From this number of frames on, equal times of all frames are an error."""
_BACKWARDS = 0.2
"""Largest share of the times that may be earlier than the previous time."""
_HEAD = 1 << 16
"""Number of bytes at the start of a log that show its form."""
_COLOUR = re.compile(rb"\x1b\[[0-9;]*m")
"""Colours of candump -c."""
_SCREEN = re.compile(
    rb"^ *(\((?:[0-9]{1,10}|[0-9]{4}-[0-9]{2}-[0-9]{2} [0-9:]{8})\.[0-9]{1,9}\)) +"
    rb"(\S{1,15}) +(?:[RT]X [-B] [-E] +)?"
    rb"([0-9A-Fa-f]{3}|[0-9A-Fa-f]{8}) +\[([0-9]{1,2})\] *"
    rb"(?:(remote request)|((?:(?:[01]{8}|[0-9A-Fa-f]{2})[ `]?)*))[^\r\n]*",
    re.MULTILINE,
)
"""Line of candump's screen output with time stamps: (seconds) interface identifier [length] bytes."""


def _as_logged(match: re.Match[bytes]) -> bytes:
    """Convert a line of the screen output to the form of candump -l; a two-digit length means CAN FD.

    If the number of bytes contradicts the length, the line is returned unchanged and is no frame.
    """
    stamp, interface, identifier, length, remote, digits = match.groups()
    if b"-" in stamp:  # a date, of candump -t A
        day, _, part = stamp[1:-1].partition(b".")
        stamp = b"(%d.%b)" % (np.datetime64(day.decode().replace(" ", "T"), "s").astype(np.int64), part)
    if remote:
        return b"%b %b %b#R%b" % (stamp, interface, identifier, length)
    data = _screen_bytes(digits, int(length))
    if data is None:
        return match[0]
    mark = b"##0" if len(length) == 2 else b"#"
    return b"%b %b %b%b%b" % (stamp, interface, identifier, mark, data.hex().upper().encode())


def _screen_bytes(digits: bytes, length: int) -> bytes | None:
    """Bytes (length,) of a line of the screen output; None if the number of bytes differs from the length.

    Digits are hexadecimal, or binary with ``-i``. Backticks (option ``-S``) mean that the last byte comes
    first.
    """
    groups = digits.replace(b"`", b" ").split()
    widths = {len(group) for group in groups}
    if len(groups) != length or (not widths <= {2} and not widths <= {8}):
        return None
    data = bytes(int(group, 2 if widths == {8} else 16) for group in groups)
    return data[::-1] if b"`" in digits else data


def _parse_candump(text: np.ndarray) -> Frames:
    """Parse the candump log ``text`` (bytes,) with the compiled parser (``base/_native/candump.c``)."""
    block = 1 << 20  # stays in the cache
    capacity = 1 + sum(
        int(np.count_nonzero(text[i : i + block] == ord("\n"))) for i in range(0, len(text), block)
    )
    for width in (8, FD_BYTES):
        t_ns, id_ = np.empty(capacity, np.int64), np.empty(capacity, np.uint32)
        channel, length = np.empty(capacity, np.uint8), np.empty(capacity, np.uint8)
        data = np.empty((capacity, width), np.uint8)
        names, counts = np.zeros((_CHANNELS, _NAME_BYTES), np.uint8), np.zeros(_COUNTS, np.int64)
        parse = native.kernels("candump").lpvg_candump
        parse.restype = ctypes.c_int64
        n = parse(
            ctypes.c_void_p(text.ctypes.data),
            ctypes.c_int64(len(text)),
            ctypes.c_int(width),
            *(ctypes.c_void_p(a.ctypes.data) for a in (t_ns, id_, channel, length, data, names, counts)),
        )
        bad, first_bad, errors, remote, n_channels, longest = counts.tolist()
        if longest <= width:
            break
    kinds = {
        "error reports": errors,
        "remote frames": remote,
        "lines that are no frame": bad,
        "first line that is no frame": first_bad,
    }
    return Frames(
        t_ns[:n],
        id_[:n],
        channel[:n],
        length[:n],
        data[:n],
        [bytes(row).rstrip(b"\0").decode(errors="replace") for row in names[:n_channels]],
        {kind: count for kind, count in kinds.items() if count},
    )


_LINE = re.compile(
    rb" *\((\d{1,10})\.(\d{1,9})\) +([!-\xff]{1,15}) +([0-9A-Fa-f]{3}|[0-9A-Fa-f]{8})#"
    rb"(?:([Rr].*)|(?:#[0-9A-Fa-f])?((?:[0-9A-Fa-f]{2}){0,64})(?:[ _].*)?)\r?"
)
"""A line of candump -l."""


# ------------------------------------------------------------------------------------------------- python-can


def _read_python_can(path: Path) -> Frames:
    rows: list[tuple[int, int, str, bytes]] = []
    left_out = {"error reports": 0, "remote frames": 0}
    try:
        with python_can_reader(path) as reader:
            for message in reader:
                if message.is_error_frame:
                    left_out["error reports"] += 1
                elif message.is_remote_frame:
                    left_out["remote frames"] += 1
                else:
                    identifier, extended = message.arbitration_id, message.is_extended_id
                    data = bytes(message.data)
                    stated = message.dlc if message.is_fd else min(message.dlc, 8)
                    if len(data) != stated:
                        raise ValueError(f"{len(data)} bytes, where its length says {stated}")
                    rows.append(row_of(message.timestamp, identifier, extended, message.channel, data))
    except Exception as error:  # each reader of python-can has exceptions of its own
        raise InputError(
            path,
            f"frame {len(rows) + 1}",
            f"cannot be read ({type(error).__name__}: {error})",
            f"a {path.suffix} log that python-can reads",
        ) from None
    return frames_of_rows(rows, {kind: n for kind, n in left_out.items() if n})


# ----------------------------------------------------------------------------------------------- CSV, Parquet


def _read_table(path: Path, suffix: str, time_column: str | None, rate_hz: float | None) -> Frames | Table:
    import pyarrow as pa
    import pyarrow.parquet as pa_parquet

    from .text_tables import with_numbers

    units: dict[str, str] = {}
    first_line = 1
    try:
        if suffix == ".parquet":
            table = pa_parquet.read_table(path)
        elif suffix == _MAT_SUFFIX:
            table = read_matlab(path)
        else:
            read = _of_text(path, suffix, time_column, rate_hz)
            if isinstance(read, Frames | Table):
                return read
            read = with_numbers(read, path)
            table, first_line, units = read.table, read.first_line, read.units
    except (pa.ArrowException, OSError) as error:
        raise InputError(
            path,
            "",
            f"cannot be parsed ({str(error).splitlines()[0]})",
            "a table with one header line" if suffix == ".csv" else "a Parquet table",
        ) from None
    names = table.column_names
    if twice := sorted({name for name in names if names.count(name) > 1}):
        raise InputError(
            path, "header", f"two columns are named {twice[0]!r}", "a different name for each column"
        )
    if set(names) >= _RAW_COLUMNS:
        return _raw_table(path, table)
    t_ns, keep, made_of = _times(table, units, path, first_line, time_column, rate_hz)
    series = {
        c: Series(t_ns, _numbers(path, table, c)[keep], units.get(c, ""))
        for c in names
        if c not in made_of and _numeric(table, c)
    }
    for name, bit in sign_columns(series).items():
        what = f"column {name} holds no sign and gets that of {bit}, negative where it is 1"
        warnings.warn(f"{path}: {what}", InputWarning, stacklevel=1)
        signed = np.where(series[bit].value > 0, -1.0, 1.0) * series[name].value
        series[name] = Series(t_ns, signed, series[name].unit)
    return Table(series)


def _of_text(path: Path, suffix: str, time_column: str | None, rate_hz: float | None):
    """Read a text table: Frames for raw frames, a Table for one signal per row, otherwise a TextTable."""
    from .json_lines import read_json
    from .long_tables import long_columns, series_of_rows
    from .raw_tables import is_raw, raw_frames
    from .text_tables import read_text_table, with_numbers
    from .vbo import read_vbo

    readers = {
        _VBO_SUFFIX: read_vbo,
        **dict.fromkeys(_JSON_SUFFIXES, read_json),
        **dict.fromkeys(SHEET_SUFFIXES, read_sheet),
    }
    reader = readers.get(suffix, read_text_table)
    read = reader(unpacked(path), path)
    if is_raw(read.table.column_names):
        return raw_frames(read, path)
    columns = long_columns(read)
    if columns is None:
        return read
    others = with_numbers(replace(read, table=read.table.drop_columns([columns[1]])), path)
    t_ns, keep, _ = _times(others.table, read.units, path, read.first_line, time_column, rate_hz)
    return Table(series_of_rows(read, columns, t_ns, keep, path))


def _times(
    table, units: dict[str, str], path: Path, first_line: int, named: str | None, rate_hz: float | None
) -> tuple[np.ndarray, np.ndarray, set[str]]:
    """Times of the rows from ``rate_hz`` if it is given, otherwise from `time_of`."""
    from .time_columns import time_of

    if rate_hz is None:
        return time_of(table, units, path, first_line, named)
    t_ns = np.rint(np.arange(table.num_rows) * (1e9 / rate_hz)).astype(np.int64)
    return t_ns, np.ones(table.num_rows, bool), set()


def _numeric(table, column: str) -> bool:
    import pyarrow as pa

    kind = table.schema.field(column).type
    return pa.types.is_floating(kind) or pa.types.is_integer(kind) or pa.types.is_boolean(kind)


def _numbers(path: Path, table, column: str) -> np.ndarray:
    import pyarrow as pa

    try:
        return table.column(column).cast(pa.float64()).fill_null(np.nan).to_numpy()
    except pa.ArrowException as error:
        raise InputError(path, f"column {column}", str(error).splitlines()[0], "numbers") from None


def _raw_table(path: Path, table) -> Frames:
    def plain(name: str, default) -> list:
        return table.column(name).to_pylist() if name in table.column_names else [default] * table.num_rows

    rows = []
    columns = (
        plain("timestamp", None),
        plain("arbitration_id", None),
        plain("extended", None),
        plain("channel", ""),
        plain("data", None),
    )
    for number, (t, identifier, extended, channel, data) in enumerate(zip(*columns, strict=False), start=1):
        try:
            if isinstance(identifier, str):
                identifier = int(identifier, 16)
            payload = bytes.fromhex(data) if isinstance(data, str) else bytes(data)
            wide = identifier > 0x7FF if extended is None else bool(extended)
            rows.append(row_of(float(t), identifier, wide, channel, payload))
        except (TypeError, ValueError) as error:
            raise InputError(
                path,
                f"row {number}",
                f"no frame ({error})",
                "timestamp in s, arbitration_id, data as bytes or hexadecimal text",
            ) from None
    return frames_of_rows(rows, {})
