"""Read text tables of loggers: find the delimiter, the decimal mark, the header and the row of units."""

import csv
import io
import re
import warnings
from collections import Counter
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc
import pyarrow.csv as pa_csv

from ..base.errors import InputError, InputWarning

DELIMITERS = ("\t", ";", ",", "|")
_QUOTED = re.compile(r'"(?:[^"]|"")*"')
_MARK = re.compile(r"^\s*(#+|%|//|!)\s*")
"""Mark of a comment before a header."""
_TIME = re.compile(r"\d{1,2}:\d{2}")
_BYTE = re.compile(r"(d|data|b|byte)_?\d", re.IGNORECASE)
"""Last column of a table of raw frames that has one column for each byte."""
_LOOKED_AT = 60
"""Lines at the start of a file that show its form."""
_COMMENT = re.compile(r"^\s*(#(?!\w*,)|#(group|datatype|default),|//|%\s|!)")
_NUMBER = re.compile(r"\s*[-+]?(\d+([.,]\d*)?|[.,]\d+)([eE][-+]?\d+)?\s*")
_WITH_UNIT = r"^\s*(?P<number>[-+]?[\d.,]+(?:[eE][-+]?\d+)?)\s*(?P<unit>[^\s\d.,+-][^\d]*)$"
"""A cell of a number and its unit, as 12.5 km/h."""
_GROUPED = r"^[-+]?[1-9]\d{0,2}(?:%s\d{3})+(?:%s\d*)?$"
"""A number whose thousands are set apart, by which sign, and its decimal mark."""
_MARKED_NUMBERS = (
    (r"([\d.])[dD]([-+]?\d+)$", r"\1e\2"),
    (r"""^=?["'\[]+\s*([-+.\deE]+)\s*["'\]]+$""", r"\1"),
)
"""Numbers with an exponent of Fortran, and in further quotes or brackets, and the same without."""
_MOST_ROWS_OF_WORDS = 4
"""Number of rows below a header that may state units, sources and rates."""
_MISSING = ("", "NA", "N/A", "NaN", "nan", "NAN", "null", "NULL", "None", "-", "--", "-nan", "#N/A", "n/a")
STRAY = 0.02
"""At most this share of a column's cells, or of the lines, may be no number, or have other columns."""
MIXED = 0.8
"""A column with a larger share of cells that are no number is one of words."""


@dataclass(frozen=True)
class TextTable:
    """Text table: columns, line of the first row, and unit by column if the table states units.

    ``comma`` tells that numbers have a decimal comma.
    """

    table: pa.Table
    first_line: int
    units: dict[str, str]
    comma: bool


def read_text_table(data: bytes, path: Path) -> TextTable:
    """Read a table with one header line and an optional row of units; every cell is a text.

    Lines before the header and comments are skipped, unless a comment is the header. Raises InputError if
    there is no header, or if a share of more than STRAY of the lines does not fit the header.
    """
    lines = _unquoted(decoded(data, path).replace("\u2212", "-").splitlines())
    first = next((k for k, line in enumerate(lines) if line.strip() and not _COMMENT.match(line)), None)
    if first is None:
        raise InputError(path, "", "holds no line of a table", "a header line and rows")
    above = next((k for k in range(first - 1, -1, -1) if lines[k].strip()), None)
    form = _form(lines, first) or (_form(lines, above) if above is not None else None)
    if form is None:
        raise InputError(
            path, f"line {first + 1}", "no header: no line of names of columns", "a header line, then rows"
        )
    delimiter, header = form
    names = [name.strip() for name in _cells(_MARK.sub("", lines[header]), delimiter)]
    if names and not names[-1]:  # a delimiter ends each line
        names = names[:-1]
    names, units = _units_of_cells(_apart(names, path, header))
    rows, below = _below(lines, header + 1, delimiter)
    units |= {n: c.strip().strip("[]()\"' ") for n, c in zip(names, below, strict=False)}
    body = [line for line in lines[rows:] if line.strip() and not _COMMENT.match(line)]
    comma = _decimal_commas(body[:_LOOKED_AT], delimiter)
    return TextTable(_parsed(body, names, delimiter, path, rows), rows + 1, units, comma)


def decoded(data: bytes, path: Path) -> str:
    """Decode the text of a file: UTF-8, UTF-16, otherwise the code page of Windows.

    Raises InputError if the file holds null bytes, because then it is not a text.
    """
    if data[:2] in (b"\xff\xfe", b"\xfe\xff"):
        return data.decode("utf-16", errors="replace")
    for start, code in ((1, "utf-16-le"), (0, "utf-16-be")):
        if len(data) > 2 and not data[start:400:2].strip(b"\0"):  # without its mark
            return data.decode(code, errors="replace")
    if b"\0" in data[:4096]:
        raise InputError(path, "", "is no text: it holds null bytes", "a text table")
    try:
        return data.decode("utf-8-sig")
    except UnicodeDecodeError:
        return data.decode("cp1252", errors="replace")


def _unquoted(lines: list[str]) -> list[str]:
    """Lines without the quotes that a spreadsheet puts around a whole line."""
    inside = [line[1:-1].replace('""', '"') if _QUOTED.fullmatch(line) else line for line in lines]
    quoted = sum(a is not b and "," in a for a, b in zip(inside, lines, strict=True))
    return inside if quoted > 0.5 * len(lines) else lines


def _cells(line: str, delimiter: str) -> list[str]:
    if delimiter == " ":
        return line.split()
    return next(csv.reader([line], delimiter=delimiter), [])


def _apart(names: list[str], path: Path, header: int) -> list[str]:
    """Append a number to each repeated name."""
    if "" in names and len(names) > 1:
        names = [name or f"column {k + 1}" for k, name in enumerate(names)] if names.count("") > 1 else names
    seen: Counter[str] = Counter()
    apart = []
    for name in names:
        seen[name] += 1
        apart.append(name if seen[name] == 1 else f"{name} #{seen[name]}")
    if twice := sorted(name for name, n in seen.items() if n > 1):
        warnings.warn(
            f"{path}: header, line {header + 1}: columns of the same name ({', '.join(twice)}): the further "
            f"ones are called {', '.join(n for n in apart if n not in names)}",
            InputWarning,
            stacklevel=1,
        )
    return apart


def _units_of_cells(names: list[str]) -> tuple[list[str], dict[str, str]]:
    """Names and units of a RaceCapture header, whose cells are "NAME"|"UNIT"|..."""
    parts = [[part.strip('" ') for part in name.split("|")] for name in names]
    if any(len(part) < 3 for part in parts):
        return names, {}
    return [part[0] for part in parts], {part[0]: part[1] for part in parts}


def _below(lines: list[str], row: int, delimiter: str) -> tuple[int, list[str]]:
    """First row of numbers below a header, and the cells of the row of units (empty without one)."""
    units: list[str] = []
    passed = row
    for _ in range(_MOST_ROWS_OF_WORDS):
        while passed < len(lines) and not lines[passed].strip():
            passed += 1
        cells = _cells(lines[passed], delimiter) if passed < len(lines) else []
        if not _words(cells) or any(_TIME.search(cell) for cell in cells):
            break
        units, passed = units or cells, passed + 1
    else:
        return row, []
    return (passed, units) if any(_NUMBER.fullmatch(cell) for cell in cells) else (row, [])


def _form(lines: list[str], first: int) -> tuple[str, int] | None:
    """Find the delimiter and the header: the first line of words with as many cells as most lines."""
    best: tuple[float, str, int] | None = None
    for delimiter in (*DELIMITERS, " "):
        looked = [_cells(_MARK.sub("", line), delimiter) for line in lines[first : first + _LOOKED_AT]]
        widths = Counter(len(cells) for cells in looked if len(cells) > 1)
        if not widths:
            continue
        width, count = widths.most_common(1)[0]
        agree = [k for k, cells in enumerate(looked) if len(cells) == width]
        short = [k for k, cells in enumerate(looked) if len(cells) == width - 1 > 1]  # a delimiter ends rows
        header = _header(looked, agree, short)
        numbers = sum(_NUMBER.fullmatch(cell) is not None for k in agree for cell in looked[k])
        if header is None:
            continue
        score = count + numbers / (width * max(count, 1)) - (0.5 if delimiter == " " else 0.0)
        if best is None or score > best[0]:
            best = (score, delimiter, first + header)
    return best and best[1:]


def _header(looked: list[list[str]], agree: list[int], short: list[int]) -> int | None:
    """Line of the header: among the lines of words, the first one with the most rows of numbers below."""
    words = {k for k in (*agree, *short) if _words(looked[k]) and not any(map(_TIME.search, looked[k]))}
    rows: dict[int, int] = {}
    header = None
    for k, cells in enumerate(looked):
        if k in words:
            header = k if header is None else header
            rows.setdefault(header, 0)
        elif any(cells):
            header = None
            if rows and k in agree:
                rows[max(rows)] += 1
    best = max(rows, key=lambda k: rows[k], default=None)
    return next((k for k in rows if best is not None and looked[k] == looked[best]), None)


def _words(cells: list[str]) -> bool:
    """Tell if a line is a header: it has words and no number."""
    named = [cell.strip() for cell in cells if cell.strip()]
    return bool(named) and not any(_NUMBER.fullmatch(cell) for cell in named)


def _decimal_commas(body: list[str], delimiter: str) -> bool:
    """Tell if numbers have a decimal comma."""
    if delimiter == "," and not any('"' in line for line in body):
        return False
    cells = [cell.strip() for line in body for cell in _cells(line, delimiter)]
    cells = [c for c in cells if not re.match(_GROUPED % (",", r"\."), c)] or cells
    commas = sum(re.fullmatch(r"[-+]?\d*,\d+([eE][-+]?\d+)?", cell) is not None for cell in cells)
    points = sum(re.fullmatch(r"[-+]?\d*\.\d+([eE][-+]?\d+)?", cell) is not None for cell in cells)
    return commas > points


def _parsed(body: list[str], names: list[str], delimiter: str, path: Path, rows: int) -> pa.Table:
    """Read all cells as text; leave out lines with a wrong number of cells, up to a share of STRAY."""
    columns = len(names)
    if delimiter == " ":
        body, delimiter = ["\t".join(line.split()) for line in body], "\t"
    bad: list[int] = []

    def other(row: pa_csv.InvalidRow) -> str:
        bad.append(row.number if row.number is not None else 0)
        return "skip"

    if body and max(len(_cells(line, delimiter)) for line in body[:_LOOKED_AT]) == columns + 1:
        names = [*names, "\0"]  # a delimiter ends each line
    if _BYTE.fullmatch(names[columns - 1]):  # a frame with fewer bytes has fewer cells
        body = [line + delimiter * (len(names) - 1 - line.count(delimiter)) for line in body]
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


def with_numbers(read: TextTable, path: Path) -> TextTable:
    """Convert text columns to numbers where possible; a few cells without a number count as missing.

    If a unit follows every number of a column, it is the unit of the column.
    """
    columns, units = {}, dict(read.units)
    for name in read.table.column_names:
        text = pc.utf8_trim_whitespace(read.table.column(name).combine_chunks())
        if unit := _unit_of_cells(text):
            units.setdefault(name, unit)
        columns[name] = _numbers(text, bool(unit), read.comma, path, name)
    return replace(read, table=pa.table(columns), units=units)


def _numbers(trimmed: pa.StringArray, has_unit: bool, comma: bool, path: Path, name: str) -> pa.Array:
    text = trimmed
    if has_unit:
        trimmed = pc.replace_substring_regex(trimmed, r"\s*[^\s\d.,+-][^\d]*$", "")
    plain = _ungrouped(trimmed, comma)
    for mark, number in (("", ""), *_MARKED_NUMBERS):
        plain = pc.replace_substring_regex(plain, mark, number) if mark else plain
        try:
            return pc.cast(plain, pa.float64())
        except pa.ArrowInvalid:
            pass
    fits = pc.fill_null(pc.match_substring_regex(plain, r"^[-+]?(\d+(\.\d*)?|\.\d+)([eE][-+]?\d+)?$"), False)
    fits = pc.or_(
        fits, pc.fill_null(pc.match_substring_regex(plain, r"(?i)^[-+]?(inf|infinity|nan)$"), False)
    )
    stray = pc.and_(pc.invert(fits), pc.is_valid(plain))
    n, held = int(pc.sum(stray).as_py() or 0), int(pc.sum(pc.is_valid(plain)).as_py() or 0)
    is_text = n > max(1, STRAY * held)
    if is_text and n > MIXED * held:
        return text
    at = int(np.flatnonzero(stray.to_numpy(zero_copy_only=False))[0])
    so = "it is left out" if is_text else "they count as missing"
    warnings.warn(
        f"{path}: column {name}: {n} of {held} cells hold no number, the first {text[at].as_py()!r} in row "
        f"{at + 1}; {so}",
        InputWarning,
        stacklevel=1,
    )
    if is_text:
        return text
    return pc.cast(pc.if_else(fits, plain, None), pa.float64())


def _unit_of_cells(text: pa.StringArray) -> str:
    """Unit that follows the number of every cell, for example 12.5 km/h; "" without such a unit."""
    first = next((cell for cell in text[:_LOOKED_AT].to_pylist() if cell), "")
    match = re.match(_WITH_UNIT, first)
    if match is None or not match["unit"][0].isprintable():
        return ""
    held = text.drop_null()
    alike = pc.sum(pc.match_substring_regex(held, rf"^\s*[-+]?[\d.,]+\s*{re.escape(match['unit'])}$"))
    return match["unit"].strip() if len(held) > 1 and alike.as_py() >= (1 - STRAY) * len(held) else ""


def _ungrouped(text: pa.StringArray, comma: bool) -> pa.StringArray:
    """Rewrite numbers with a decimal point and without separators of thousands."""
    for sign in (("." if comma else ","), "'", "\u2019", " ", "\u00a0", "\u202f"):
        if not (pc.any(pc.match_substring(text, sign)).as_py() or False):
            continue
        grouped = pc.match_substring_regex(text, _GROUPED % (re.escape(sign), "," if comma else r"\."))
        marked = pc.match_substring(text, sign)
        if pc.all(pc.or_(grouped, pc.invert(marked))).as_py():
            text = pc.replace_substring(text, sign, "")
    return pc.replace_substring(text, ",", ".") if comma else text
