"""Read VBOX's .vbo files, which have sections of text; `time_columns` reads their clock times."""

import re
from dataclasses import replace
from pathlib import Path

from ..base.errors import InputError
from .text_tables import TextTable, decoded, read_text_table

_SECTION = re.compile(r"\s*\[([^\]]+)\]\s*")
_UNIT = re.compile(r".*\s(kmh|km/h|mph|knots|m/s|g|deg|deg/s)", re.IGNORECASE)
"""Channel in the header, with its unit as the last word."""


def read_vbo(data: bytes, path: Path) -> TextTable:
    """Read the table of a .vbo file.

    Raises InputError if a section is missing, or if the rows do not fit the columns.
    """
    sections: dict[str, list[str]] = {}
    now, first_line = "", 1
    for number, line in enumerate(decoded(data, path).splitlines(), start=1):
        if title := _SECTION.fullmatch(line):
            now = title[1].strip().lower()
            first_line = number + 1 if now == "data" else first_line
        elif line.strip():
            sections.setdefault(now, []).append(line.strip())
    for wanted in ("column names", "data"):
        if wanted not in sections:
            raise InputError(path, f"[{wanted}]", "no such section", "a log as VBOX writes it")
    names = " ".join(sections["column names"]).split()
    lines = ["\t".join(names), *("\t".join(row.split()) for row in sections["data"])]
    read = read_text_table("\n".join(lines).encode(), path)
    of_head = [(m[1] if (m := _UNIT.fullmatch(x)) else "") for x in sections.get("header", [])]
    units = dict(zip(names, of_head, strict=False)) if len(of_head) == len(names) else {}
    units.setdefault("velocity", "km/h")
    stated = sections.get("channel units", [])  # of all channels, or of those after the standard ones
    if len(stated) <= len(names):
        units |= {
            n: u for n, u in zip(reversed(names), reversed(stated), strict=False) if u.strip("()") != "null"
        }
    return replace(read, first_line=first_line, units={n: u for n, u in units.items() if u})
