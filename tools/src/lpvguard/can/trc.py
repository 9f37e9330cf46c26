"""Read traces with the suffix .trc: PCAN 1.0 to 2.1 and CANHacker 2 and 3.

PCAN writes times in ms from a start in its header. CANHacker writes seconds. A line is refused if its length
differs from the number of its bytes.
"""

import re
from pathlib import Path

from ..base.errors import InputError
from .log_types import Frames, frames_of_rows, row_of

_COLUMNS = {"1.0": "NOILD", "1.1": "NOTIlD", "1.2": "NOBTIlD", "1.3": "NOBTIRlD"}
"""Columns by version of PCAN, in the letters of version 2."""
_DATA = frozenset(("", "Rx", "Tx", "DT", "FD", "FB", "FE", "BI"))
"""Line types that are data frames."""
_FD_LENGTHS = (12, 16, 20, 24, 32, 48, 64)
"""Number of bytes for the length codes from 9 on."""
_DAYS_TO_1970 = 25569
"""Start of the day count of PCAN, 1899-12-30."""
_CANHACKER = re.compile(
    r"\s*(?P<O>\d+[.,]\d+)\s+(?:(?P<B>\d+)\s+(?P<flags>[0-9A-Fa-f]{4,8})\s+(?=[0-9A-Fa-f]{3,8}\s+\d{1,2}\s))?"
    r"(?P<I>[0-9A-Fa-f]{3,8})\s+(?P<l>\d{1,2})(?:\s+(?P<D>RTR.*|(?:[0-9A-Fa-f]{2}(?:\s+|$))*))?.*"
)
_Row = tuple[int, int, str, bytes]


def read_trc(path: Path, text: str) -> Frames:
    """Read the frames of a trace.

    Raises InputError if a line is not a frame, or if its length differs from the number of its bytes.
    """
    rows: list[_Row] = []
    left_out = {"error reports": 0, "remote frames": 0}
    hacker = text.lstrip().startswith("@") or re.search(r"^\s*Time\s+ID\s+DLC\b", text, re.MULTILINE)
    version, start_s, columns = "1.0", 0.0, ""
    for number, raw in enumerate(text.splitlines(), start=1):
        line = raw.strip()
        key, _, value = line.partition("=")
        if key == ";$FILEVERSION":
            version = value.strip()
        elif key == ";$STARTTIME":
            start_s = (_number(value, path, number) - _DAYS_TO_1970) * 86400.0
        elif key == ";$COLUMNS":
            columns = "".join(part.strip() for part in value.split(","))
        if not line or line[0] in ";@#" or line.startswith("Time"):
            continue
        try:
            if hacker:
                kind, row = _canhacker(line)
            else:
                kind, row = _pcan(line, columns or _COLUMNS[version], start_s)
        except KeyError:
            known = ", ".join([*_COLUMNS, "2.0 and 2.1 with $COLUMNS"])
            raise InputError(path, "$FILEVERSION", version, f"one of {known}") from None
        except (ValueError, IndexError) as error:
            what = str(error) if isinstance(error, ValueError) else "too few columns"
            raise InputError(
                path, f"line {number}", f"no frame ({what}): {line[:60]}", "time, identifier, length, bytes"
            ) from None
        if row is not None:
            rows.append(row)
        else:
            left_out[kind] += 1
    return frames_of_rows(rows, {kind: n for kind, n in left_out.items() if n})


def _number(text: str, path: Path, number: int) -> float:
    try:
        return float(text)
    except ValueError:
        raise InputError(path, f"line {number}", f"{text!r} is no number", "days since 1899-12-30") from None


def _pcan(line: str, columns: str, start_s: float) -> tuple[str, _Row | None]:
    """Kind of a line, and its row if the line is a data frame."""
    cells = dict(zip(columns, line.split(maxsplit=len(columns) - 1), strict=False))
    kind = cells.get("T", "")
    data = cells.get("D", "")
    if kind == "RR" or data.startswith("RTR"):
        return "remote frames", None
    if kind not in _DATA or cells.get("I") == "FFFFFFFF" or data.startswith("ERROR"):
        return "error reports", None
    if not {"O", "I"} <= cells.keys():
        raise IndexError
    code = int(cells.get("l", cells.get("L", "")))
    classic = kind in ("", "Rx", "Tx", "DT")
    length = code if "l" in cells and not classic else min(code, 8) if classic else _length_of(code)
    return "", _row(float(cells["O"]) / 1e3 + start_s, cells["I"], cells.get("B", "1"), length, data)


def _length_of(code: int) -> int:
    """Number of data bytes for a length code of CAN FD."""
    return code if code <= 8 else _FD_LENGTHS[code - 9]


def _canhacker(line: str) -> tuple[str, _Row | None]:
    match = _CANHACKER.fullmatch(line)
    if match is None:
        raise ValueError("not as CANHacker writes it")
    data = (match["D"] or "").strip()
    if data.startswith("RTR"):
        return "remote frames", None
    time_s = float(match["O"].replace(",", "."))
    length = int(match["l"])
    stated = " ".join(data.split()[:length])  # a comment may look like bytes
    return "", _row(time_s, match["I"], match["B"] or "1", length, stated)


def _row(time_s: float, identifier: str, channel: str, length: int, data: str) -> _Row:
    """Make the row of one frame with `row_of`; raise ValueError if length and bytes disagree."""
    payload = bytes.fromhex(data)
    if len(payload) != length:
        raise ValueError(f"{len(payload)} bytes, where its length says {length}")
    value = int(identifier, 16)
    return row_of(time_s, value, len(identifier) > 4 or value > 0x7FF, channel, payload)
