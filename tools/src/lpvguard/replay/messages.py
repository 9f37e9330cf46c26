"""A time series of a replay as messages of JSON, for MCAP files and Foxglove's WebSocket. Three topics:

/lpvguard/sample   a row of the series but its margins: numbers and the verdict; what is null is left out
/lpvguard/margin   a counted frame, when the core said so: rad_s of its bin, and t* as margin
/lpvguard/alarm    foxglove.Log: what the alarm says
"""

from __future__ import annotations

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
    """``t_ns``: time of the series [ns]. ``topic``: of ``schemas``. ``content``: what JSON holds."""

    t_ns: int
    topic: str
    content: dict[str, Any]


def _dense(columns: Iterable[str]) -> list[str]:
    """The columns that a sample says."""
    return [n for n in columns if n != "t" and not n.startswith(MARGIN)]


def schemas(columns: Iterable[str]) -> dict[str, dict[str, Any]]:
    """JSON schema by topic, its title the name of the type. ``columns``: those of the series."""
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


def messages(series: pa.Table, alarms: Iterable[Alarm | dict[str, Any]]) -> list[SeriesMessage]:
    """A time series (series.py) and its alarms, or their objects in the JSON of `replay`, in the order of
    time."""
    times = np.round(numbers(series["t"]) * 1e9).astype(np.int64).tolist()
    found: list[SeriesMessage] = []
    for t, row in zip(times, series.select(_dense(series.column_names)).to_pylist(), strict=True):
        found.append(SeriesMessage(t, "/lpvguard/sample", {k: v for k, v in row.items() if v is not None}))
    for name in series.column_names:
        if name.startswith(MARGIN):
            values = numbers(series[name])
            rad_s = float(name.removeprefix(MARGIN))
            for i in np.flatnonzero(np.isfinite(values)):
                said = {"rad_s": rad_s, "margin": float(values[i])}
                found.append(SeriesMessage(times[i], "/lpvguard/margin", said))
    for alarm in alarms:
        test, t_s = (alarm.test, alarm.t_s) if isinstance(alarm, Alarm) else (alarm["test"], alarm["t_s"])
        t = round(t_s * 1e9)
        log = {"timestamp": {"sec": t // 10**9, "nsec": t % 10**9}, "level": WARNING}
        log |= {"message": alarm_sentence(alarm), "name": test, "file": "", "line": 0}
        found.append(SeriesMessage(t, "/lpvguard/alarm", log))
    return sorted(found, key=lambda m: m.t_ns)
