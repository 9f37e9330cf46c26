"""Time series of a replay in the files of other tools: Parquet, MCAP (Foxglove, PlotJuggler), MF4.

MCAP has three topics of JSON messages, with their schemas. Times are those of the series [ns].
/lpvguard/sample   a row of the series but its margins: numbers and the verdict; what is null is left out
/lpvguard/margin   a counted frame, when the core said so: rad_s of its bin, and t* as margin
/lpvguard/alarm    foxglove.Log: what the alarm says
MF4 has a channel a column with its unit. A margin has its own times, those at which the core said it.
"""

from __future__ import annotations

import json
from datetime import UTC, datetime
from pathlib import Path
from typing import Any, Literal, get_args

import numpy as np
import pyarrow as pa
from pyarrow.parquet import write_table

from ..base.errors import InputError
from .series import MARGIN
from .told import alarm_sentence

Kind = Literal["parquet", "mcap", "mf4"]
KINDS: tuple[Kind, ...] = get_args(Kind)
BEGINNING = datetime(1970, 1, 1, tzinfo=UTC)
"""What files call their start: a series says seconds after its first sample, and no time of day."""
_HISTORY = "<FHcomment><TX>lpvguard replay</TX><tool_id>lpvguard</tool_id></FHcomment>"
WARNING = 3
"""Level of foxglove.Log."""


def write_series(path: Path, kind: Kind, series: pa.Table, alarms: list[dict[str, Any]]) -> None:
    """Write a time series (series.py) to ``path``. ``alarms``: those of the object of `replay --json`.

    InputError where the package of ``kind`` is not installed."""
    if kind == "parquet":
        write_table(series, path)
    elif kind == "mcap":
        _write_mcap(path, series, alarms)
    else:
        _write_mf4(path, series)


def _numbers(column: pa.ChunkedArray) -> np.ndarray:
    """A column's numbers, NaN where it is null."""
    return column.cast(pa.float64()).to_numpy(zero_copy_only=False)


def _write_mcap(path: Path, series: pa.Table, alarms: list[dict[str, Any]]) -> None:
    try:
        from mcap.writer import CompressionType, Writer
    except ImportError:
        raise InputError("mcap", "", "the Python package is not installed", "lpvguard[mcap]") from None
    times = np.round(_numbers(series["t"]) * 1e9).astype(np.int64).tolist()
    dense = [n for n in series.column_names if n != "t" and not n.startswith(MARGIN)]
    kinds = {n: {"type": "string" if n == "verdict" else "number"} for n in dense}
    messages: list[tuple[int, str, dict[str, Any]]] = []
    for t, row in zip(times, series.select(dense).to_pylist(), strict=True):
        messages.append((t, "sample", {k: v for k, v in row.items() if v is not None}))
    for name in series.column_names:
        if name.startswith(MARGIN):
            values = _numbers(series[name])
            rad_s = float(name.removeprefix(MARGIN))
            for i in np.flatnonzero(np.isfinite(values)):
                messages.append((times[i], "margin", {"rad_s": rad_s, "margin": values[i]}))
    for alarm in alarms:
        t = round(alarm["t_s"] * 1e9)
        stamp = {"sec": t // 10**9, "nsec": t % 10**9}
        text = {"message": alarm_sentence(alarm), "name": alarm["test"], "file": "", "line": 0}
        messages.append((t, "alarm", {"timestamp": stamp, "level": WARNING, **text}))
    number = {"type": "number"}
    schemas = {
        "sample": ("lpvguard.Sample", kinds),
        "margin": ("lpvguard.Margin", {"rad_s": number, "margin": number}),
        "alarm": (
            "foxglove.Log",
            {
                "timestamp": {
                    "type": "object",
                    "properties": {"sec": {"type": "integer"}, "nsec": {"type": "integer"}},
                },
                "level": {"type": "integer"},
                **{k: {"type": "string"} for k in ("message", "name", "file")},
                "line": {"type": "integer"},
            },
        ),
    }
    with path.open("wb") as stream:
        writer = Writer(stream, compression=CompressionType.NONE)
        writer.start(library="lpvguard")
        channels = {}
        for topic, (name, properties) in schemas.items():
            schema = {"title": name, "type": "object", "properties": properties}
            of = writer.register_schema(name, "jsonschema", json.dumps(schema).encode())
            channels[topic] = writer.register_channel(f"/lpvguard/{topic}", "json", of)
        for k, (t, topic, message) in enumerate(sorted(messages, key=lambda m: m[0])):
            writer.add_message(channels[topic], t, json.dumps(message).encode(), t, k)
        writer.finish()


def _write_mf4(path: Path, series: pa.Table) -> None:
    from asammdf import MDF, Signal
    from asammdf.blocks.v4_blocks import FileHistory

    t = _numbers(series["t"])
    dense: list[Signal] = []
    margins: list[Signal] = []
    for name in series.column_names:
        if name in ("t", "verdict"):  # verdict_code says it in numbers
            continue
        values = _numbers(series[name])
        here = np.isfinite(values) if name.startswith(MARGIN) else np.ones(len(t), bool)
        unit = (series.schema.field(name).metadata or {}).get(b"unit", b"").decode()
        signal = Signal(values[here], t[here], unit, name)
        (margins if name.startswith(MARGIN) else dense).append(signal)
    with MDF(version="4.10") as mdf:
        mdf.start_time = BEGINNING
        mdf.append(dense, comment="lpvguard replay", common_timebase=True)
        for signal in margins:
            if len(signal):
                mdf.append([signal], comment="lpvguard replay: margins", common_timebase=True)
        history = FileHistory()
        history.time_stamp, history.comment = BEGINNING, _HISTORY
        mdf.file_history = [history]
        mdf.save(path, overwrite=True, add_history_block=False)
