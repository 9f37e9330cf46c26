"""Logs of robots, drones and driver assistance, read by their own libraries: extra ``lpvguard[sources]``.

.bag, rosbag2 folders (metadata.yaml), .mcap (ROS 2 or JSON), .ulg (PX4), .bin and .log (ArduPilot), .tlog
(MAVLink), rlog and qlog (openpilot)

Each number of a message becomes a series TOPIC.field, also in nested fields and short arrays. A time is the
time at which the log received the message. PX4 and ArduPilot logs have the vehicle's own times.
"""

import io
import json
import re
import warnings
from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import redirect_stderr, redirect_stdout
from dataclasses import replace
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np

from ..base.errors import InputError, InputWarning
from ..base.optional import read_by_library
from .log_types import Series, Table
from .packed import unpacked

OPENPILOT = ("rlog", "qlog", "rlog.bz2", "qlog.bz2", "rlog.zst", "qlog.zst")
LONGEST_ARRAY, DEEPEST = 4, 4
"""Arrays with more entries, and fields at a greater depth, are not read as signals."""
IN_SI = re.compile(r"(sensor|geometry|nav|ackermann|autoware\w*)_msgs/(msg/)?(?!Accel)")
"""Types of ROS messages whose definitions state SI units (REP 103)."""
SI_UNITS = (
    (re.compile(r"angular(_velocity)?\.[xyz]$|\.heading_rate$"), "rad/s"),
    (re.compile(r"linear\.[xyz]$|\.(speed|longitudinal_velocity)$"), "m/s"),
    (re.compile(r"linear_acceleration\.[xyz]$"), "m/s^2"),
    (re.compile(r"\.steering_(tire_)?angle$"), "rad"),
)
"""Fields of these messages, and their units."""
Message = tuple[str, int, Any]
"""Topic, time [ns], and the fields as a dictionary, an object or a list."""


def reader_of(path: Path) -> Callable[[Path, Path | None], Table] | None:
    """Return the function (path, schema) -> Table that reads this form of log; None for other forms."""
    if path.is_dir():
        return _rosbag if (path / "metadata.yaml").is_file() else None
    by_suffix = {
        ".bag": _rosbag,
        ".db3": _rosbag,
        ".mcap": _mcap,
        ".ulg": _ulog,
        ".bin": _dataflash,
        ".tlog": _telemetry,
    }
    if path.suffix.lower() == ".log" and path.is_file():
        with path.open("rb") as stream:
            return _dataflash if stream.read(9) == b"FMT, 128," else None
    is_openpilot = any(path.name.lower().endswith(name) for name in OPENPILOT)
    return _openpilot if is_openpilot else by_suffix.get(path.suffix.lower())


def read_foreign(path: Path, schema: Path | None) -> Table:
    """Read a log that `reader_of` knows; raise InputError if its library is missing or it is unreadable."""
    reader = reader_of(path)
    assert reader is not None
    with read_by_library(path, "a whole log of this form"):
        table = reader(path, schema)
    if not table.series:
        raise InputError(path, "", "holds no number", "messages with numbers")
    return table


def _table(messages: Iterator[Message], units: dict[str, str] | None = None) -> Table:
    """Make a series over time of every numeric field of the messages."""
    times: dict[str, list[int]] = {}
    values: dict[str, list[float]] = {}
    for topic, t_ns, fields in messages:
        for name, value in _numbers(topic, fields, 0):
            times.setdefault(name, []).append(t_ns)
            values.setdefault(name, []).append(value)
    return Table(
        {
            name: Series(np.array(times[name], np.int64), np.array(values[name]), (units or {}).get(name, ""))
            for name in sorted(values)
        }
    )


def _numbers(name: str, value: Any, depth: int) -> Iterator[tuple[str, float]]:
    """Yield the name and the value of each number of a message."""
    if isinstance(value, bool | int | float | np.number):
        yield name, float(value)
    elif depth < DEEPEST:
        items: Iterable[tuple[Any, Any]]
        if isinstance(value, dict):
            items = value.items()
        elif isinstance(value, list | tuple | np.ndarray):
            items = [(str(k), x) for k, x in enumerate(value)] if len(value) <= LONGEST_ARRAY else []
        elif hasattr(value, "__dataclass_fields__"):
            items = [(key, getattr(value, key)) for key in value.__dataclass_fields__]
        elif hasattr(value, "__slots__") and not isinstance(value, str | bytes):
            items = [(key, getattr(value, key)) for key in value.__slots__]
        else:
            return
        for key, inside in items:
            if not str(key).startswith("_"):
                yield from _numbers(f"{name}.{key}", inside, depth + 1)


def _rosbag(path: Path, _: Path | None) -> Table:
    from rosbags.highlevel import AnyReader
    from rosbags.typesys import Stores, get_typestore

    folder = path.parent if path.suffix.lower() == ".db3" else path
    with AnyReader([folder], default_typestore=get_typestore(Stores.LATEST)) as reader:
        types = {_topic(connection.topic): connection.msgtype for connection in reader.connections}
        table = _table(
            (_topic(connection.topic), t_ns, reader.deserialize(raw, connection.msgtype))
            for connection, t_ns, raw in reader.messages()
            if connection.msgtype in reader.typestore.fielddefs
        )
    return _in_si(table, types)


def _in_si(table: Table, types: Mapping[str, str]) -> Table:
    """State the units of the messages of ROS that are in SI. ``types``: message type by topic."""

    def unit(name: str) -> str:
        field_of_si = IN_SI.match(types.get(name.split(".")[0], "")) is not None
        return next((u for fields, u in SI_UNITS if field_of_si and fields.search(name)), "")

    return Table({n: replace(s, unit=s.unit or unit(n)) for n, s in table.series.items()})


def _topic(name: str) -> str:
    return name.strip("/").replace("/", "_")


def _mcap(path: Path, _: Path | None) -> Table:
    from mcap.reader import make_reader
    from mcap_ros2.decoder import DecoderFactory

    factory, types = _Undecoded(), dict[str, str]()

    def messages() -> Iterator[Message]:
        for schema, channel, message, ros in make_reader(
            stream, decoder_factories=factories
        ).iter_decoded_messages():
            types[_topic(channel.topic)] = schema.name if schema else ""
            yield _topic(channel.topic), message.log_time, ros

    with path.open("rb") as stream:
        factories: list[Any] = [DecoderFactory(), factory]
        table = _in_si(_table(messages()), types)
    if not table.series and factory.encodings:
        raise InputError(
            path, "", f"its messages are in {', '.join(sorted(factory.encodings))}", "those of ROS 2, or JSON"
        )
    return table


class _Undecoded:
    """Decoders for MCAP messages that are not of ROS 2: JSON is decoded, other messages are not."""

    def __init__(self) -> None:
        self.encodings: set[str] = set()

    def decoder_for(self, message_encoding: str, _: object) -> Callable[[bytes], Any]:
        if message_encoding == "json":
            return json.loads
        self.encodings.add(message_encoding)
        return lambda _: None


def _ulog(path: Path, _: Path | None) -> Table:
    from pyulog import ULog

    series = {}
    for data in ULog(str(path)).data_list:
        topic = data.name if data.multi_id == 0 else f"{data.name}_{data.multi_id}"
        t_ns = np.asarray(data.data["timestamp"], np.int64) * 1000
        for field, value in data.data.items():
            if field != "timestamp" and np.asarray(value).dtype.kind in "iufb":
                series[f"{topic}.{field}"] = Series(t_ns, np.asarray(value, float))
    return Table(series)


_DATAFLASH_UNITS = {"deg/s": "deg/s", "deg": "deg", "rad": "rad", "rad/s": "rad/s", "m/s": "m/s", "s": "s"}


def _dataflash(path: Path, _: Path | None) -> Table:
    from pymavlink.DFReader import DFReader_binary, DFReader_text

    said = io.StringIO()  # pymavlink prints a line for each damaged message
    with redirect_stdout(said), redirect_stderr(said):
        log = (DFReader_text if path.suffix.lower() == ".log" else DFReader_binary)(str(path))
    units: dict[str, str] = {}

    def messages() -> Iterator[Message]:
        while (message := log.recv_msg()) is not None:
            kind = message.get_type()
            fields = message.to_dict()
            fields.pop("mavpackettype", None)
            if "TimeUS" in fields:
                t_us = fields.pop("TimeUS")
                for field in fields:
                    unit = message.fmt.get_unit(field) if hasattr(message.fmt, "get_unit") else ""
                    units.setdefault(f"{kind}.{field}", _DATAFLASH_UNITS.get(unit, ""))
                yield kind, int(t_us) * 1000, fields

    with redirect_stdout(said), redirect_stderr(said):
        table = _table(messages())
    if damaged := said.getvalue().count("bad msg"):
        what = f"pymavlink calls {damaged} messages damaged"
        warnings.warn(f"{path}: {what}", InputWarning, stacklevel=1)
    return Table({n: Series(s.t_ns, s.value, units.get(n, "")) for n, s in table.series.items()})


def _telemetry(path: Path, _: Path | None) -> Table:
    """Read MAVLink messages that a ground station stored."""
    from pymavlink import mavutil

    def messages() -> Iterator[Message]:
        log = mavutil.mavlink_connection(str(path))
        while (message := log.recv_msg()) is not None:
            fields = message.to_dict()
            kind = fields.pop("mavpackettype")
            if kind != "BAD_DATA":
                yield kind, round(message._timestamp * 1e9), fields

    return _table(messages())


def _openpilot(path: Path, schema: Path | None) -> Table:
    if schema is None:
        raise InputError(
            path,
            "--schema",
            "not given",
            "the file log.capnp of the openpilot that wrote the log, with what it imports",
        )
    if not schema.is_file():
        raise InputError(schema, "--schema", "no such file", "a schema of Cap'n Proto, log.capnp")
    event = _event_of(schema)
    data = unpacked(path)

    def messages() -> Iterator[Message]:
        for one in event.read_multiple_bytes(data):
            kind = one.which()
            fields = getattr(one, str(kind))
            if hasattr(fields, "to_dict"):
                yield str(kind), int(one.logMonoTime), fields.to_dict()

    return _table(messages())


@cache
def _event_of(schema: Path) -> Any:
    """Load the type Event of a schema with a separate parser."""
    import capnp

    capnp.remove_import_hook()
    return capnp.SchemaParser().load(str(schema)).Event
