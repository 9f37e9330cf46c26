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
    """Return the columns of names, values and units (or None) of a text table with one signal per row.

    Returns None for another kind of table.
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
    """Make one series for each signal name of a text table; raise InputError if no name has numbers.

    ``columns`` comes from `long_columns`. ``keep`` (N,) marks the rows that have a time, ``t_ns`` (K,) [ns]
    are their times.
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
