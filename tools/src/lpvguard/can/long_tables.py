"""Read tables with one signal per row (time, name, value, unit), as diagnosis tools write them."""

import re
from pathlib import Path

import numpy as np
import pyarrow as pa

from ..base.errors import InputError
from .log_types import Series
from .text_tables import TextTable, with_numbers

_NAME = re.compile(
    r"(telemetry_|signal_?|channel_?|parameter_?)?name|pid|signal|channel|parameter|variable|key|metric|field"
)
_VALUE = re.compile(r"(telemetry_|signal_?)?(value|val)|reading")
_UNIT = re.compile(r"units?")
_MOST_NAMES, _LEAST_ROWS = 1000, 5
"""Largest number of signal names, and least average number of rows for each name."""


def long_columns(read: TextTable) -> tuple[str, str, str | None] | None:
    """Find the columns of a table with one signal per row.

    Parameters
    ----------
    read : TextTable, every cell as text

    Returns
    -------
    tuple of the columns of names, of values and of units (or None); None for another kind of table
    """
    low = {re.sub(r"[^a-z0-9]+", "_", name.lower()).strip("_"): name for name in read.table.column_names}
    name, value, unit = (
        next((n for key, n in low.items() if pattern.fullmatch(key)), None)
        for pattern in (_NAME, _VALUE, _UNIT)
    )
    if name is None or value is None:
        return None
    distinct = len(read.table.column(name).unique())
    few = 1 < distinct <= min(_MOST_NAMES, read.table.num_rows / _LEAST_ROWS)
    return (name, value, unit) if few else None


def series_of_rows(
    read: TextTable, columns: tuple[str, str, str | None], t_ns: np.ndarray, keep: np.ndarray, path: Path
) -> dict[str, Series]:
    """Make one series for each signal name.

    Parameters
    ----------
    read : TextTable, every cell as text
    columns : tuple, result of `long_columns`
    t_ns : ndarray (K,) of int, ns, times of the rows that have a time
    keep : ndarray (N,) of bool, mask of the rows that have a time
    path : Path, named in errors

    Returns
    -------
    dict[str, Series], by name, for the names with numbers

    Raises
    ------
    InputError
        If no name has numbers.
    """
    name, value, unit = columns
    table = read.table.filter(pa.array(keep))
    names = table.column(name).combine_chunks().dictionary_encode()
    index = names.indices.fill_null(-1).to_numpy()
    series = {}
    for code, one in sorted(enumerate(names.dictionary.to_pylist()), key=lambda item: item[1]):
        at = np.flatnonzero(index == code)
        part = table.select([value]).take(at)
        read_part = with_numbers(TextTable(part, read.first_line, {}, read.comma), path)
        numbers = read_part.table.column(value)
        if pa.types.is_floating(numbers.type):
            units = table.column(unit).take(at).to_pylist() if unit else [read_part.units.get(value, "")]
            stated = next((u for u in units if u), "")
            series[one] = Series(t_ns[at], numbers.fill_null(np.nan).to_numpy(), stated)
    if not series:
        raise InputError(path, f"column {value}", "holds no numbers", "a value in each row")
    return series
