"""Text tables as loggers write them: delimiter, decimal mark, header and row of units are found."""

import csv
import io
import re
import warnings
from collections import Counter
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.csv as pa_csv

from ..base.errors import InputError, InputWarning

DELIMITERS = ("\t", ";", ",", "|")
_LOOKED_AT = 60
"""Lines at the start of a file that show its form."""
_COMMENT = re.compile(r"^\s*(#(?!\w*,)|//|%\s|!)")
_NUMBER = re.compile(r"\s*[-+]?(\d+([.,]\d*)?|[.,]\d+)([eE][-+]?\d+)?\s*")
_MISSING = ("", "NA", "N/A", "NaN", "nan", "NAN", "null", "NULL", "None", "-", "--", "-nan", "#N/A", "n/a")
STRAY = 0.02
"""At most this share of a column's cells, or of the lines, may be no number, or have other columns."""


@dataclass(frozen=True)
class TextTable:
    """A table as text says it: columns, line of the first row, unit by column where a row states them."""

    table: pa.Table
    first_line: int
    units: dict[str, str]


def read_text_table(data: bytes, path: Path, text_columns: bool = False) -> TextTable:
    """Read a table of one header line, and of a row of units where there is one.

    Lines before the header and comments are skipped. ``text_columns``: leave every cell as text. InputError
    where no header is found, or where more than STRAY of the lines do not fit it.
    """
    lines = _decoded(data, path).splitlines()
    first = next((k for k, line in enumerate(lines) if line.strip() and not _COMMENT.match(line)), None)
    if first is None:
        raise InputError(path, "", "holds no line of a table", "a header line and rows")
    delimiter, header = _form(lines, first, path)
    names = [name.strip() for name in _cells(lines[header], delimiter)]
    names = [re.sub(r"^[#%]\s*", "", names[0]), *names[1:]]
    if names and not names[-1]:  # a delimiter ends each line
        names = names[:-1]
    _require_header(names, path, header)
    rows = header + 1
    units: dict[str, str] = {}
    if rows < len(lines) and _is_units(cells := _cells(lines[rows], delimiter), lines, rows, delimiter):
        units = {n: c.strip().strip("[]()\"' ") for n, c in zip(names, cells, strict=False)}
        rows += 1
    body = [line for line in lines[rows:] if line.strip() and not _COMMENT.match(line)]
    comma = delimiter != "," and _decimal_commas(body[:_LOOKED_AT], delimiter)
    table = _parsed(body, names, delimiter, comma, path, rows)
    return TextTable(table if text_columns else _numeric(table, comma, path, rows), rows + 1, units)


def _decoded(data: bytes, path: Path) -> str:
    """The text of a file in UTF-8, UTF-16 with its mark, or else Windows' code page."""
    if data[:2] in (b"\xff\xfe", b"\xfe\xff"):
        return data.decode("utf-16", errors="replace")
    if b"\0" in data[:4096]:
        raise InputError(path, "", "is no text: it holds null bytes", "a text table")
    try:
        return data.decode("utf-8-sig")
    except UnicodeDecodeError:
        return data.decode("cp1252", errors="replace")


def _cells(line: str, delimiter: str) -> list[str]:
    if delimiter == " ":
        return line.split()
    return next(csv.reader([line], delimiter=delimiter), [])


def _form(lines: list[str], first: int, path: Path) -> tuple[str, int]:
    """Delimiter, and the line of the header: the last line before rows of numbers that has as many cells."""
    best: tuple[float, str, int] | None = None
    for delimiter in (*DELIMITERS, " "):
        looked = [_cells(line, delimiter) for line in lines[first : first + _LOOKED_AT]]
        widths = Counter(len(cells) for cells in looked if len(cells) > 1)
        if not widths:
            continue
        width, count = widths.most_common(1)[0]
        agree = [k for k, cells in enumerate(looked) if len(cells) == width]
        header = next((k for k in agree if _words(looked[k])), None)
        numbers = sum(_NUMBER.fullmatch(cell) is not None for k in agree for cell in looked[k])
        if header is None:
            continue
        score = count + numbers / (width * max(count, 1)) - (0.5 if delimiter == " " else 0.0)
        if best is None or score > best[0]:
            best = (score, delimiter, first + header)
    if best is None:
        raise InputError(
            path, f"line {first + 1}", "no header: no line of names of columns", "a header line, then rows"
        )
    return best[1], best[2]


def _words(cells: list[str]) -> bool:
    """Return whether a line is a header: words, none of them a number."""
    named = [cell.strip() for cell in cells if cell.strip()]
    return bool(named) and not any(_NUMBER.fullmatch(cell) for cell in named)


def _require_header(names: list[str], path: Path, header: int) -> None:
    if twice := sorted(name for name, n in Counter(names).items() if n > 1):
        what = f"two columns are named {twice[0]!r}" if twice[0] else "two columns have no name"
        raise InputError(path, f"header, line {header + 1}", what, "a name of its own for each")


def _is_units(cells: list[str], lines: list[str], row: int, delimiter: str) -> bool:
    """Return whether a line under the header states units: no number or time of day, then numbers."""
    if not _words(cells) or any(re.search(r"\d{2}:\d{2}", cell) for cell in cells):
        return False
    below = _cells(lines[row + 1], delimiter) if row + 1 < len(lines) else []
    return any(_NUMBER.fullmatch(cell) for cell in below)


def _decimal_commas(body: list[str], delimiter: str) -> bool:
    """Return whether numbers are written with a comma."""
    cells = [cell.strip() for line in body for cell in _cells(line, delimiter)]
    commas = sum(re.fullmatch(r"[-+]?\d*,\d+([eE][-+]?\d+)?", cell) is not None for cell in cells)
    points = sum(re.fullmatch(r"[-+]?\d*\.\d+([eE][-+]?\d+)?", cell) is not None for cell in cells)
    return commas > points


def _parsed(
    body: list[str], names: list[str], delimiter: str, comma: bool, path: Path, rows: int
) -> pa.Table:
    """All cells as text; lines with other columns are left out, and more than STRAY of them refused."""
    columns = len(names)
    if delimiter == " ":
        body, delimiter = ["\t".join(line.split()) for line in body], "\t"
    bad: list[int] = []

    def other(row: pa_csv.InvalidRow) -> str:
        bad.append(row.number if row.number is not None else 0)
        return "skip"

    if body and len(next(csv.reader([body[0]], delimiter=delimiter))) == columns + 1:
        names = [*names, "\0"]  # a delimiter ends each line
    kind = pa.string()
    table = pa_csv.read_csv(
        io.BytesIO(("\n".join(body) + "\n").encode()),
        pa_csv.ReadOptions(column_names=names, use_threads=False),
        pa_csv.ParseOptions(delimiter=delimiter, invalid_row_handler=other),
        pa_csv.ConvertOptions(
            column_types=dict.fromkeys(names, kind), null_values=_MISSING, strings_can_be_null=True
        ),
    ).select(list(range(columns)))
    if len(bad) > max(1, STRAY * len(body)):
        raise InputError(
            path,
            f"line {rows + bad[0]}" if bad[0] else "",
            f"{len(bad)} of {len(body)} lines have not {columns} columns as the header has",
            "as many cells in each line",
        )
    if bad:
        warnings.warn(
            f"{path}: {len(bad)} line(s) without {columns} cells left out", InputWarning, stacklevel=1
        )
    return table


def _numeric(table: pa.Table, comma: bool, path: Path, rows: int) -> pa.Table:
    """The table with numbers in the columns that hold them; a stray cell that is none counts as missing."""
    columns = {}
    for name in table.column_names:
        text = table.column(name).combine_chunks()
        columns[name] = _numbers(text, comma, path, name, rows)
    return pa.table(columns)


def _numbers(text: pa.StringArray, comma: bool, path: Path, name: str, rows: int) -> pa.Array:
    import pyarrow.compute as pc

    trimmed = pc.utf8_trim_whitespace(text)
    if comma:
        trimmed = pc.replace_substring(trimmed, ",", ".")
    try:
        return pc.cast(trimmed, pa.float64())
    except pa.ArrowInvalid:
        pass
    fits = pc.fill_null(
        pc.match_substring_regex(trimmed, r"^[-+]?(\d+(\.\d*)?|\.\d+)([eE][-+]?\d+)?$"), False
    )
    fits = pc.or_(
        fits, pc.fill_null(pc.match_substring_regex(trimmed, r"(?i)^[-+]?(inf|infinity|nan)$"), False)
    )
    stray = pc.and_(pc.invert(fits), pc.is_valid(trimmed))
    n, held = int(pc.sum(stray).as_py() or 0), int(pc.sum(pc.is_valid(trimmed)).as_py() or 0)
    if n > max(1, STRAY * held):
        return text
    at = int(np.flatnonzero(stray.to_numpy(zero_copy_only=False))[0])
    warnings.warn(
        f"{path}: column {name}: {n} cell(s) hold no number and count as missing, "
        f"the first {text[at].as_py()!r} in row {at + 1}",
        InputWarning,
        stacklevel=1,
    )
    return pc.cast(pc.if_else(fits, trimmed, None), pa.float64())
