"""Read the descriptions of struct fields from the core's headers: text, unit and range.

A field's description is its Doxygen comment: `///<` after the field, or the `///` lines before it. The unit
is the last text in square brackets. A range is written `0 .. 16`.
"""

import re
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

from ...base.errors import InputError

_STRUCT = re.compile(r"^typedef struct (\w+) \{\n(.*?)^\} \1;", re.MULTILINE | re.DOTALL)
_DECLARATION = re.compile(
    r"^\s*(?:const\s+)?[A-Za-z_]\w*\*?\s+(?P<names>\*?\w[^;]*);\s*(?:///<\s?(?P<text>.*))?$"
)
_WRAPPED = re.compile(r",\n\s*(?=\w)")
"""A declaration that continues in the next line."""
_UNIT = re.compile(r"\s*\[(?P<unit>[^\[\]]*)\]")
_RANGE = re.compile(r"(?<![\w.])(?P<low>-?\d+) \.\. (?P<high>-?\d+)(?![\w.])")


@dataclass(frozen=True)
class Described:
    """Description of a field: ``text`` without the unit, ``unit`` or None, and the ``limits`` in the text."""

    text: str
    unit: str | None
    limits: tuple[float, float] | None


def described_fields(include: Path) -> dict[str, dict[str, Described]]:
    """Read the descriptions in all headers ``*.h`` of the folder ``include``, by struct and field.

    A field without a comment has the text "". Raises InputError if there is no struct.
    """
    by_struct = {
        struct: {name: _described(text) for name, text in _fields(body)}
        for header in sorted(include.glob("*.h"))
        for struct, body in _STRUCT.findall(header.read_text(encoding="utf-8"))
    }
    if not by_struct:
        raise InputError(include, "", "no struct in its headers", "the core's folder of headers")
    return by_struct


def _fields(body: str) -> Iterator[tuple[str, str]]:
    """Name and comment of every field of a struct's body."""
    before: list[str] = []
    for line in _WRAPPED.sub(", ", body).splitlines():
        if line.strip().startswith("//"):
            before += [line.strip().removeprefix("///").strip()] if line.strip().startswith("///") else []
            continue
        declared = _DECLARATION.match(line)
        if declared is not None:
            text = " ".join([*before, declared["text"] or ""]).strip()
            for name in re.sub(r"\[[^\]]*\]", "", declared["names"]).split(","):
                yield name.strip().lstrip("*"), text
        before = []


def _described(comment: str) -> Described:
    units = list(_UNIT.finditer(comment))
    unit = units[-1] if units else None
    text = comment if unit is None else comment[: unit.start()] + comment[unit.end() :]
    limits = _RANGE.search(text)
    return Described(
        re.sub(r"\s+", " ", text).strip(),
        None if unit is None else unit["unit"],
        None if limits is None else (float(limits["low"]), float(limits["high"])),
    )
