"""Read JSON logs: an object for each line, or a list of objects or of lists. Nested fields are called A.B."""

import json
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pyarrow as pa

from ..base.errors import InputError
from .foreign_logs import DEEPEST
from .text_tables import TextTable, decoded


def read_json(data: bytes, path: Path) -> TextTable:
    """Read objects as rows of a table with text cells; raise InputError for a line that is no object."""
    text = decoded(data, path).strip()
    try:
        try:
            rows = _rows(json.loads(text))
        except ValueError:
            rows = [json.loads(line) for line in text.splitlines() if line.strip()]
    except ValueError as error:
        raise InputError(path, "", f"no JSON ({error})", "an object a line, or a list of them") from None
    flat = [dict(_fields("", row, 0)) for row in rows if isinstance(row, dict)]
    names = list(dict.fromkeys(name for row in flat for name in row))
    if not names:
        raise InputError(path, "", "holds no object with numbers", "an object a line, or a list of them")
    table = pa.table({n: pa.array([row.get(n) for row in flat], pa.string()) for n in names})
    return TextTable(table, 1, {}, False)


def _rows(whole: Any) -> list[Any]:
    """The rows of a whole file: a list, the longest list of objects in an object, or its lists of numbers."""
    if isinstance(whole, list):
        return whole
    lists = {k: v for k, v in whole.items() if isinstance(v, list) and v} if isinstance(whole, dict) else {}
    if objects := [v for v in lists.values() if isinstance(v[0], dict)]:
        return max(objects, key=len)
    longest = max(map(len, lists.values()), default=0)
    columns = {k: v for k, v in lists.items() if len(v) == longest}
    return [dict(zip(columns, row, strict=True)) for row in zip(*columns.values(), strict=True)] or [whole]


def _fields(name: str, value: Any, depth: int) -> Iterator[tuple[str, str]]:
    """Yield the name and the text of each field of an object."""
    if isinstance(value, dict) and depth < DEEPEST:
        for key, inside in value.items():
            yield from _fields(f"{name}.{key}" if name else str(key), inside, depth + 1)
    elif isinstance(value, bool | int | float | str):
        yield name, repr(float(value)) if isinstance(value, float | bool) else str(value)
