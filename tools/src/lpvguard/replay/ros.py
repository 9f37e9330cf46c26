"""Write the time series of a replay as ROS 2 messages to an MCAP file (rosbag2), without ROS.

/diagnostics            diagnostic_msgs/DiagnosticArray: at each change of verdict, alarm and second, with the
                        largest ratio of each test to its threshold since the message before; a part that
                        differs has a status of its own at the end of its window (parts.py)
/vehicle/twist          geometry_msgs/TwistStamped: speed as linear.x, measured yaw rate as angular.z
/vehicle/twist_nominal  the same with the nominal yaw rate
/vehicle/drive          ackermann_msgs/AckermannDriveStamped: speed and road-wheel angle

A topic whose signals the vehicle does not have is left out. A yaw rate is an output in rad/s whose name has
the word yaw; a road-wheel angle is an input in rad.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from pathlib import Path
from typing import IO, TYPE_CHECKING, Any

import numpy as np
import pyarrow as pa

from ..base.optional import optional
from ..core.compiled import TESTS
from .alarm_text import alarm_sentence
from .series import TEST_RATIO, numbers

if TYPE_CHECKING:
    from .replayer import Alarm

OK, WARN, ERROR, STALE = range(4)
"""Levels of diagnostic_msgs/DiagnosticStatus."""
LEVELS = {"valid": OK, "degraded": WARN, "invalid": ERROR, "fault": ERROR}
"""Level of each verdict; the others judge nothing and are STALE."""
PERIOD_NS = 10**9
"""Longest time between two diagnostics [ns]."""
NO_RATIO = np.full(len(TESTS), np.nan)
_LINE = "=" * 80
_HEADER = (
    f"{_LINE}\nMSG: std_msgs/Header\nbuiltin_interfaces/Time stamp\nstring frame_id\n"
    f"{_LINE}\nMSG: builtin_interfaces/Time\nint32 sec\nuint32 nanosec\n"
)
DEFINITIONS = {
    "diagnostic_msgs/msg/DiagnosticArray": (
        f"std_msgs/Header header\ndiagnostic_msgs/DiagnosticStatus[] status\n"
        f"{_LINE}\nMSG: diagnostic_msgs/DiagnosticStatus\nbyte level\nstring name\nstring message\n"
        f"string hardware_id\ndiagnostic_msgs/KeyValue[] values\n"
        f"{_LINE}\nMSG: diagnostic_msgs/KeyValue\nstring key\nstring value\n{_HEADER}"
    ),
    "geometry_msgs/msg/TwistStamped": (
        f"std_msgs/Header header\ngeometry_msgs/Twist twist\n"
        f"{_LINE}\nMSG: geometry_msgs/Twist\ngeometry_msgs/Vector3 linear\ngeometry_msgs/Vector3 angular\n"
        f"{_LINE}\nMSG: geometry_msgs/Vector3\nfloat64 x\nfloat64 y\nfloat64 z\n{_HEADER}"
    ),
    "ackermann_msgs/msg/AckermannDriveStamped": (
        f"std_msgs/Header header\nackermann_msgs/AckermannDrive drive\n"
        f"{_LINE}\nMSG: ackermann_msgs/AckermannDrive\nfloat32 steering_angle\n"
        f"float32 steering_angle_velocity\nfloat32 speed\nfloat32 acceleration\nfloat32 jerk\n{_HEADER}"
    ),
}
"""Fields of the message types, as ROS 2 defines them."""
DIAGNOSTICS, TWIST, DRIVE = DEFINITIONS


def write_ros2(
    path: Path,
    vehicle: str,
    series: pa.Table,
    alarms: list[dict[str, Any]],
    parts: Sequence[dict[str, Any]] = (),
) -> None:
    """Write a time series (series.py) to an MCAP file with ROS 2 messages.

    ``vehicle`` is the hardware_id of the diagnostics. ``alarms`` and ``parts`` have the form of the JSON of
    `replay`. Raises InputError if mcap-ros2-support is missing."""
    with path.open("wb") as stream:
        recorder = Ros2Recorder(stream, vehicle)
        recorder.hear(series, alarms, parts)
        recorder.close()


Message = tuple[int, str, str, dict[str, Any]]
"""Time [ns], topic, type and content below the header."""


class Ros2Recorder:
    """Writes a time series piece by piece as an MCAP file with ROS 2 messages.

    Parameters
    ----------
    stream : binary file, open until ``close``
    vehicle : str, hardware_id of the diagnostics

    Raises
    ------
    InputError
        Without mcap-ros2-support.
    """

    def __init__(self, stream: IO[bytes], vehicle: str):
        compression = optional("mcap.writer", "ros2").CompressionType.NONE
        self._writer = optional("mcap_ros2.writer", "ros2").Writer(stream, compression=compression)
        self._kinds = {kind: self._writer.register_msgdef(kind, text) for kind, text in DEFINITIONS.items()}
        self._vehicle, self._number = vehicle, 0
        self._verdict: str | None = None
        self._last, self._largest = -PERIOD_NS, NO_RATIO

    def hear(
        self, series: pa.Table, alarms: Iterable[Alarm | dict[str, Any]], parts: Sequence[dict[str, Any]] = ()
    ) -> None:
        """Write the messages of the next piece; ``parts`` are those of the JSON of `replay`."""
        stamps = np.round(numbers(series["t"]) * 1e9).astype(np.int64)
        if not len(stamps):
            return
        messages = [*self._diagnostics(stamps, series, alarms), *_motions(stamps, series)]
        messages += [_part(self._vehicle, named) for named in parts]
        for t, topic, kind, content in sorted(messages, key=lambda m: m[0]):
            stamp = {"sec": t // 10**9, "nanosec": t % 10**9}
            message = {"header": {"stamp": stamp, "frame_id": "base_link"}, **content}
            self._writer.write_message(topic, self._kinds[kind], message, t, t, self._number)
            self._number += 1

    def listens(self) -> bool:
        """Return True: it takes every piece."""
        return True

    def close(self) -> None:
        """Write the end of the file."""
        self._writer.finish()

    def _diagnostics(
        self, stamps: np.ndarray, series: pa.Table, alarms: Iterable[Alarm | dict[str, Any]]
    ) -> Iterator[Message]:
        """Yield the monitor's state at each change, alarm and second."""
        verdicts = series["verdict"].to_pylist()
        ratios = np.array([numbers(series[TEST_RATIO + test]) for test in TESTS]).T
        sentences: dict[int, list[str]] = {}
        for one in alarms:
            t_s = one["t_s"] if isinstance(one, dict) else one.t_s
            sentences.setdefault(int(np.argmin(np.abs(stamps - t_s * 1e9))), []).append(alarm_sentence(one))
        for k, (t, verdict) in enumerate(zip(stamps.tolist(), verdicts, strict=True)):
            self._largest = np.fmax(self._largest, ratios[k])
            if verdict == self._verdict and 0 <= t - self._last < PERIOD_NS and k not in sentences:
                continue
            values = {"verdict": verdict}
            by_test = zip(TESTS, self._largest.tolist(), strict=True)
            values |= {f"{test} test ratio": f"{x:.4g}" for test, x in by_test if np.isfinite(x)}
            words = "; ".join(sentences.get(k, [verdict.replace("_", " ")]))
            level = LEVELS.get(verdict, STALE)
            yield _status(t, level, "lpvguard: nominal model", words, self._vehicle, values)
            self._verdict, self._last, self._largest = verdict, t, NO_RATIO


def _part(vehicle: str, named: dict[str, Any]) -> Message:
    """Status of the parts that a window names (parts.py)."""
    values = {"since s": f"{named['since_s']:.1f}", "service": named["service"] or "look for the part"}
    if named["value"] is not None:
        size = " to ".join(f"{named[key]:.4g}" for key in ("low", "high"))
        values |= {named["what"]: f"{named['value']:.4g} ({size}) {named['unit']}".rstrip()}
    values |= {f"probability of {part}": f"{named['probability'][part]:.3g}" for part in named["parts"]}
    level = ERROR if named["service"] == "now" else WARN
    name = f"lpvguard: {' or '.join(named['parts']) or 'no single part'}"
    return _status(round(named["until_s"] * 1e9), level, name, named["says"], vehicle, values)


def _status(t: int, level: int, name: str, message: str, vehicle: str, values: dict[str, str]) -> Message:
    """Diagnostics message with one status at time ``t`` [ns]."""
    status = {
        "level": level,
        "name": name,
        "message": message,
        "hardware_id": vehicle,
        "values": [{"key": key, "value": value} for key, value in values.items()],
    }
    return t, "/diagnostics", DIAGNOSTICS, {"status": [status]}


def _motions(stamps: np.ndarray, series: pa.Table) -> Iterator[Message]:
    """Yield speed with the measured and nominal yaw rate, and with the road-wheel angle."""
    names = series.column_names
    speed, *signals = names[1 : next(k for k, n in enumerate(names) if n.startswith("yhat/"))]
    unit = {n: (series.schema.field(n).metadata or {}).get(b"unit", b"").decode() for n in signals}
    outputs = [n for n in signals if f"yhat/{n}" in names]
    yaw = next((n for n in outputs if "yaw" in n and unit[n] == "rad/s"), None)
    angle = next((n for n in signals if n not in outputs and unit[n] == "rad"), None)
    motions = [
        ("/vehicle/twist", yaw),
        ("/vehicle/twist_nominal", yaw and f"yhat/{yaw}"),
        ("/vehicle/drive", angle),
    ]
    v = numbers(series[speed])
    for topic, column in motions:
        if column is None:
            continue
        x = numbers(series[column])
        for k in np.flatnonzero(np.isfinite(v) & np.isfinite(x)):
            t, moving, value = int(stamps[k]), float(v[k]), float(x[k])
            if topic == "/vehicle/drive":
                drive = dict.fromkeys(("steering_angle_velocity", "acceleration", "jerk"), 0.0)
                yield t, topic, DRIVE, {"drive": {**drive, "steering_angle": value, "speed": moving}}
            else:
                parts = {"linear": (moving, 0.0, 0.0), "angular": (0.0, 0.0, value)}
                twist = {name: dict(zip("xyz", xyz, strict=True)) for name, xyz in parts.items()}
                yield t, topic, TWIST, {"twist": twist}
