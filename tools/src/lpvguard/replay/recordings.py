"""Write the time series of a replay to files of other tools: Parquet, MCAP (Foxglove, ROS 2), MF4.

MCAP files hold the messages of messages.py with their schemas; times are those of the series [ns].
PlotJuggler reads them, too. MF4 files have a channel with a unit for each column. A margin has its own time
base: the times of judgement.
"""

import json
from collections.abc import Sequence
from datetime import UTC, datetime
from pathlib import Path
from typing import Any, Literal

import numpy as np
import pyarrow as pa
from pyarrow.parquet import write_table

from ..base.optional import optional
from .messages import messages, schemas
from .ros import write_ros2
from .series import MARGIN, numbers

Kind = Literal["parquet", "mcap", "mf4", "ros2"]
SUFFIX: dict[Kind, str] = {"parquet": ".parquet", "mcap": ".mcap", "mf4": ".mf4", "ros2": ".mcap"}
BEGINNING = datetime(1970, 1, 1, tzinfo=UTC)
"""Start time in the files, because a series holds seconds after its first sample and no time of day."""
_HISTORY = "<FHcomment><TX>lpvguard replay</TX><tool_id>lpvguard</tool_id></FHcomment>"


def write_series(
    path: Path,
    kind: Kind,
    series: pa.Table,
    alarms: list[dict[str, Any]],
    vehicle: str,
    parts: Sequence[dict[str, Any]] = (),
) -> None:
    """Write a time series to a file of another tool.

    Parameters
    ----------
    path : Path
    kind : Kind
    series : Table, of series.py
    alarms : list of dict, as in the JSON of `replay`
    vehicle : str
    parts : Sequence of dict, as in the JSON of `replay`, for MCAP and ROS 2

    Raises
    ------
    InputError
        If the package of ``kind`` is not installed.
    """
    if kind == "parquet":
        write_table(series, path)
    elif kind == "mcap":
        _write_mcap(path, series, alarms, parts)
    elif kind == "ros2":
        write_ros2(path, vehicle, series, alarms, parts)
    else:
        _write_mf4(path, series)


def _write_mcap(
    path: Path, series: pa.Table, alarms: list[dict[str, Any]], parts: Sequence[dict[str, Any]]
) -> None:
    mcap = optional("mcap.writer", "mcap")
    with path.open("wb") as stream:
        writer = mcap.Writer(stream, compression=mcap.CompressionType.NONE)
        writer.start(library="lpvguard")
        channels = {}
        for topic, schema in schemas(series.column_names).items():
            schema_id = writer.register_schema(schema["title"], "jsonschema", json.dumps(schema).encode())
            channels[topic] = writer.register_channel(topic, "json", schema_id)
        for k, m in enumerate(messages(series, alarms, parts)):
            writer.add_message(channels[m.topic], m.t_ns, json.dumps(m.content).encode(), m.t_ns, k)
        writer.finish()


def _write_mf4(path: Path, series: pa.Table) -> None:
    from asammdf import MDF, Signal
    from asammdf.blocks.v4_blocks import FileHistory

    t = numbers(series["t"])
    dense: list[Signal] = []
    margins: list[Signal] = []
    for name in series.column_names:
        if name in ("t", "verdict"):  # the column verdict_code has its number
            continue
        values = numbers(series[name])
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
