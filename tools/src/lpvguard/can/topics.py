"""Read a folder of one recording with a table for each topic, as rosbag exports and data loggers write.

The tables have different columns and a common clock. A column is called TOPIC.column, with TOPIC from the
name of its file.
"""

import re
import warnings
from itertools import combinations
from pathlib import Path

from ..base.errors import InputError, InputWarning
from .log_types import Series, Table

_SUFFIXES = {".csv", ".tsv", ".txt", ".parquet"}
_HEAD = 1 << 16
"""Number of bytes at the start of a table from which its columns are read."""
_COMMON = 0.5
"""Tables that share a larger part of their columns are recordings of one logger, not topics."""
_OF_EVERY_TOPIC = re.compile(r"(^|_)(t|time|timestamp|stamp|secs?|nsecs?|nanosec|seq|frame_id|header)(_|$)")
"""Words in the names of columns that many topics have."""


def topic_files(folder: Path) -> list[Path]:
    """List the tables of a folder that holds one recording with a table for each topic.

    The list is empty for another folder: fewer than two tables, other files, or equal columns.
    """
    inside = sorted(p for p in folder.iterdir() if not p.name.startswith(".")) if folder.is_dir() else []
    files = [p for p in inside if p.suffix.lower() in _SUFFIXES]
    if len(files) < 2 or any(p.name in ("experiments.csv", "MANIFEST.json") for p in inside):
        return []
    columns = [_columns(p) for p in files]
    pairs = combinations(columns, 2)
    apart = all(a and b and len(a & b) <= _COMMON * min(len(a), len(b)) for a, b in pairs)
    return files if apart else []


def _columns(path: Path) -> set[str]:
    """Names of a table's columns without the usual ones; empty if the file is not a table of signals."""
    import pyarrow.parquet as pa_parquet

    from .raw_tables import is_raw
    from .text_tables import read_text_table

    try:
        if path.suffix.lower() == ".parquet":
            names = pa_parquet.read_schema(path).names
        else:
            with path.open("rb") as stream:
                head = stream.read(_HEAD)
            with warnings.catch_warnings():
                warnings.simplefilter("ignore", InputWarning)
                names = read_text_table(head[: head.rfind(b"\n") + 1], path).table.column_names
    except (InputError, OSError, ValueError):  # of pyarrow too
        return set()
    if is_raw(names):
        return set()
    return {n for n in names if not _OF_EVERY_TOPIC.search(re.sub(r"[^a-z0-9]+", "_", n.lower()))}


def joined(folder: Path, topics: dict[str, Table]) -> Table:
    """Join the tables of one recording by their times, with the series TOPIC.column.

    Raises InputError if a topic has no time in common with the others.
    """
    spans = {}
    series: dict[str, Series] = {}
    for topic, table in topics.items():
        for name, one in table.series.items():
            series[f"{topic}.{name}"] = one
            if len(one.t_ns):
                spans[topic] = (int(one.t_ns.min()), int(one.t_ns.max()))
    for (a, (start_a, end_a)), (b, (start_b, end_b)) in combinations(spans.items(), 2):
        if start_a > end_b or start_b > end_a:
            raise InputError(
                folder,
                f"{a}, {b}",
                f"have no time in common: {start_a / 1e9:g} to {end_a / 1e9:g} s, "
                f"{start_b / 1e9:g} to {end_b / 1e9:g} s",
                "tables of one recording on one clock, or each recording in a folder of its own",
            )
    return Table(series)
