"""Read raw CAN frames from text tables: python-can, SavvyCAN, GVRET, Cabana, CSS Electronics and others.

Columns are found by name. Either one column holds all data bytes, or each byte has its own column.
"""

import ast
import base64
import binascii
import math
import re
from collections.abc import Sequence
from pathlib import Path

from ..base.errors import InputError
from .log_types import Frames, frames_of_rows, row_of
from .text_tables import TextTable
from .time_columns import UNITS_NS, times_of_texts, unit_of_time

_COLUMNS = {
    "time": ("timestamp", "time_stamp", "time", "timestampepoch", "abs_time", "t", "micros", "millis"),
    "id": ("arbitration_id", "id", "addr", "address", "can_id", "canid", "messageid", "arb_id", "identifier"),
    "data": ("data", "databytes", "payload", "message"),
    "bus": ("bus", "channel", "chn", "buschannel", "src", "network", "interface"),
    "length": ("len", "dlc", "length", "datalength", "messagelength"),
    "extended": ("extended", "ide", "xtd", "ext", "format"),
    "remote": ("remote", "rtr"),
    "error": ("error",),
}
_BYTE = re.compile(r"(?:d|b|data_?|byte_?)(\d{1,2})")
_NUMBERS = re.compile(r"[\[(]\s*\d{1,3}(\s*,\s*\d{1,3})*\s*[\])]")
"""Data that are written as a Python list of numbers."""
_BYTES = re.compile(r"""bytearray\((b['"].*['"])\)|(b['"].*['"])""", re.DOTALL)
"""Data as Python prints it."""
_WITHOUT_UNIT = re.compile(r"_(s|secs?|seconds|ms|us|ns|hex|dec)$")
_HEXADECIMAL = ("id", "can_id", "canid", "identifier", "arbitration_id")
"""Names of identifier columns that are always hexadecimal."""


def _low(name: str) -> str:
    """A name in lower case, its words joined by _."""
    return re.sub(r"[^a-z0-9]+", "_", name.lower()).strip("_")


def _columns_by_content(names: Sequence[str]) -> dict[str, str]:
    """Return the name of the column for each content."""
    low = {_WITHOUT_UNIT.sub("", _low(name)): name for name in reversed(names)}
    return {
        kind: low[word]
        for kind, words in _COLUMNS.items()
        if (word := next((w for w in words if w in low), None))
    }


def _bytes_of(names: Sequence[str]) -> list[str]:
    """Columns that hold one byte each, in the order of the bytes."""
    numbered = {int(m[1]): n for n in names if (m := _BYTE.fullmatch(n.strip().lower().replace(" ", "_")))}
    return [numbered[k] for k in sorted(numbered)]


def is_raw(names: Sequence[str]) -> bool:
    """Tell if a table with these columns holds raw frames."""
    by_content = _columns_by_content(names)
    return {"time", "id"} <= by_content.keys() and ("data" in by_content or len(_bytes_of(names)) > 1)


def raw_frames(read: TextTable, path: Path) -> Frames:
    """Read the frames of a text table; InputError names a line that is not a frame."""
    table = read.table
    by_content = _columns_by_content(table.column_names)
    columns = {kind: table.column(name).to_pylist() for kind, name in by_content.items()}
    single = (
        None if "data" in by_content else [table.column(n).to_pylist() for n in _bytes_of(table.column_names)]
    )
    t_s = _times(columns["time"], by_content["time"], single is not None)
    of_bytes = _base_of_bytes(single or [columns["data"]])
    base = _base_of_ids(columns["id"], by_content["id"], of_bytes)
    hexadecimal = single is not None or _is_hexadecimal(columns["data"])
    rows, left_out = [], {"error reports": 0, "remote frames": 0}
    for k, text in enumerate(columns["id"]):
        cell = {kind: column[k] for kind, column in columns.items()}
        kind = "error reports" if _yes(cell.get("error")) else "remote frames"
        if _yes(cell.get("error")) or _yes(cell.get("remote")):
            left_out[kind] += 1
            continue
        try:
            digits = str(text).lower().rstrip("xh ")
            identifier = int(digits, 16 if digits.startswith("0x") else base)
            wide = _yes(cell.get("extended")) or identifier > 0x7FF
            length = None if cell.get("length") is None else int(str(cell["length"]), 0)
            data = (
                _payload(cell["data"], hexadecimal)
                if single is None
                else bytes(int(c[k], of_bytes) for c in single[:length] if length is not None or c[k])
            )
            if length is not None and length != len(data):
                raise ValueError(f"{len(data)} bytes, where its length says {length}")
            bus = cell.get("bus")
            rows.append(row_of(t_s[k], identifier, wide, "" if bus is None else bus, data))
        except (TypeError, ValueError) as error:
            raise InputError(
                path,
                f"line {k + read.first_line}",
                f"no frame ({error})",
                "a time, an identifier and as many bytes as the length says",
            ) from None
    return frames_of_rows(rows, {kind: n for kind, n in left_out.items() if n})


def _yes(text: object) -> bool:
    return str(text).strip().lower() in ("1", "true", "t", "yes", "x", "ext", "extended", "extend")


def _times(texts: list[str | None], name: str, one_a_byte: bool) -> list[float]:
    """Times [s] of the rows; NaN where there is none."""
    first = next((text for text in texts if text), "0")
    if math.isnan(_number(first)):
        t_ns, bad = times_of_texts(texts)
        return [math.nan if none else t / 1e9 for t, none in zip(t_ns.tolist(), bad.tolist(), strict=True)]
    scale = _seconds(first, name, one_a_byte)
    return [_number(text) * scale for text in texts]


def _number(text: str | None) -> float:
    try:
        return float((text or "").replace(",", "."))
    except ValueError:
        return math.nan


def _seconds(first: str, name: str, one_a_byte: bool) -> float:
    """Seconds of a unit of the time column: GVRET counts microseconds, others write a decimal mark."""
    if unit := unit_of_time(name, {}):
        return UNITS_NS.get(unit, 10**9) / 1e9
    if one_a_byte and re.fullmatch(r"\d+", first):
        return 1e-9 if len(first) >= 19 else 1e-6
    if re.fullmatch(r"\d{19}", first):
        return 1e-9
    return 1e-6 if re.fullmatch(r"\d{16}", first) else 1e-3 if re.fullmatch(r"\d{13}", first) else 1.0


def _base_of_bytes(columns: list[list[str | None]]) -> int:
    """Base of the data bytes: 16 if a byte has a letter or if all bytes have two digits."""
    texts = {text.strip() for column in columns for text in column if text}
    if len(columns) == 1:
        return 10 if all(map(_NUMBERS.fullmatch, texts)) else 16
    if any(re.search(r"[A-Fa-fx]", text) for text in texts):
        return 16
    return 16 if all(len(text) == 2 for text in texts) else 10


def _base_of_ids(texts: list[str | None], name: str, of_bytes: int) -> int:
    low = _low(name)
    letters = any(re.search(r"[A-Fa-f]", t) for t in texts if t and not t.lower().startswith("0x"))
    stated = low.endswith("_hex") or (low in _HEXADECIMAL and of_bytes == 16)
    return 16 if letters or stated else 10


def _squeezed(text: str | None) -> str:
    """Digits of the bytes without 0x, blanks and separators; a list of numbers is decimal."""
    text = (text or "").strip()
    if _NUMBERS.fullmatch(text):
        return "".join(f"{int(number):02x}" for number in re.findall(r"\d+", text))
    if literal := _BYTES.fullmatch(text):
        try:
            return bytes(ast.literal_eval(literal[1] or literal[2])).hex()
        except (SyntaxError, ValueError):
            return text
    return re.sub(r"0x|x\||[\s:.,'\"\[\]-]", "", text, flags=re.IGNORECASE)


def _is_hexadecimal(texts: list[str | None]) -> bool:
    """Tell if all cells are bytes in hexadecimal digits; otherwise python-can wrote them in base64."""
    return all(re.fullmatch(r"([0-9A-Fa-f]{2})*", _squeezed(text)) for text in texts)


def _payload(text: str | None, hexadecimal: bool) -> bytes:
    if hexadecimal:
        return bytes.fromhex(_squeezed(text))
    try:
        return base64.b64decode((text or "").strip(), validate=True)
    except binascii.Error as error:
        raise ValueError(f"data {text!r}: {error}") from None
