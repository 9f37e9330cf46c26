"""Convert the time series of a replay to JSON messages for MCAP files and Foxglove. There are three topics:

/lpvguard/sample   one row of the series without margins: numbers and the verdict; null values are left out
/lpvguard/margin   one counted frame at the time of its judgement: rad_s of its bin, and t* as margin
/lpvguard/alarm    foxglove.Log: the alarm's sentence
"""

from collections.abc import Iterable
from dataclasses import dataclass
from typing import Any

import numpy as np
import pyarrow as pa

from .alarm_text import alarm_sentence
from .replayer import Alarm
from .series import MARGIN, numbers

WARNING = 3
"""Level of foxglove.Log."""


@dataclass(frozen=True)
class SeriesMessage:
    """A message: time ``t_ns`` in the series [ns], a ``topic`` of ``schemas``, JSON ``content``."""

    t_ns: int
    topic: str
    content: dict[str, Any]


def _dense(columns: Iterable[str]) -> list[str]:
    """Columns of a sample message."""
    return [n for n in columns if n != "t" and not n.startswith(MARGIN)]


def schemas(columns: Iterable[str]) -> dict[str, dict[str, Any]]:
    """Return the JSON schema of each topic; its title is the name of the type.

    Parameters
    ----------
    columns : Iterable[str], of the series

    Returns
    -------
    dict, by topic
    """
    number = {"type": "number"}
    stamp = {"type": "object", "properties": {k: {"type": "integer"} for k in ("sec", "nsec")}}
    log = {
        "timestamp": stamp,
        "level": {"type": "integer"},
        **{k: {"type": "string"} for k in ("message", "name", "file")},
        "line": {"type": "integer"},
    }
    sample = {n: {"type": "string" if n == "verdict" else "number"} for n in _dense(columns)}
    return {
        topic: {"title": name, "type": "object", "properties": properties}
        for topic, name, properties in (
            ("/lpvguard/sample", "lpvguard.Sample", sample),
            ("/lpvguard/margin", "lpvguard.Margin", {"rad_s": number, "margin": number}),
            ("/lpvguard/alarm", "foxglove.Log", log),
        )
    }


def messages(
    series: pa.Table, alarms: Iterable[Alarm | dict[str, Any]], parts: Iterable[dict[str, Any]] = ()
) -> list[SeriesMessage]:
    """Convert a time series, its alarms and the named parts to messages, in the order of time.

    Parameters
    ----------
    series : Table, of series.py
    alarms : Iterable of Alarm or dict, as in the JSON of `replay`
    parts : Iterable of dict, likewise

    Returns
    -------
    list of SeriesMessage
    """
    times = np.round(numbers(series["t"]) * 1e9).astype(np.int64).tolist()
    series_messages: list[SeriesMessage] = []
    for t, row in zip(times, series.select(_dense(series.column_names)).to_pylist(), strict=True):
        series_messages.append(
            SeriesMessage(t, "/lpvguard/sample", {k: v for k, v in row.items() if v is not None})
        )
    for name in series.column_names:
        if name.startswith(MARGIN):
            values = numbers(series[name])
            rad_s = float(name.removeprefix(MARGIN))
            for i in np.flatnonzero(np.isfinite(values)):
                content = {"rad_s": rad_s, "margin": float(values[i])}
                series_messages.append(SeriesMessage(times[i], "/lpvguard/margin", content))
    for alarm in alarms:
        test, t_s = (alarm.test, alarm.t_s) if isinstance(alarm, Alarm) else (alarm["test"], alarm["t_s"])
        series_messages.append(_log(t_s, test, alarm_sentence(alarm)))
    series_messages += [_log(p["until_s"], "part", p["says"]) for p in parts]
    return sorted(series_messages, key=lambda m: m.t_ns)


def _log(t_s: float, name: str, text: str) -> SeriesMessage:
    """A message of the alarm topic."""
    t = round(t_s * 1e9)
    stamp = {"sec": t // 10**9, "nsec": t % 10**9}
    log = {"timestamp": stamp, "level": WARNING, "message": text, "name": name, "file": "", "line": 0}
    return SeriesMessage(t, "/lpvguard/alarm", log)
