"""Records of the ECU's evidence ring as drive tables (lib/include/lpvguard/evidence.h).

A file ``.lpve`` has the bytes of one record. A sample that is no number has an empty cell.
"""

from __future__ import annotations

import struct
import zlib
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pyarrow as pa

from ..base.errors import InputError
from ..vehicle.project import Project

SUFFIX = ".lpve"
MAGIC, SCHEMA = b"LPVE", 1
LEVELS = ("none", "near", "degraded", "invalid")
_HEADER = struct.Struct("<4s6I4Bfq8f")
_NO_NUMBER = -32768
EXPECTED = "a record of the evidence ring, as lpvg_evidence_read gives it"


@dataclass(frozen=True)
class Record:
    """Record of an event.

    Attributes
    ----------
    number : int
    coefficients : int, CRC-32 of the coefficients that judged
    period_us : int, us
    before : int, samples up to the event
    level : str, of LEVELS
    ratio : float
    t_us : int, us, time of the event
    inputs : int, number of inputs
    values : ndarray (N, channels), speed, inputs and outputs in their units; NaN: no number
    """

    number: int
    coefficients: int
    period_us: int
    before: int
    level: str
    ratio: float
    t_us: int
    inputs: int
    values: np.ndarray


def read_record(path: Path) -> Record:
    """Read the bytes of a record.

    Raises InputError if they are none, of another schema, cut, or a bit has changed.
    """
    data = path.read_bytes()
    if len(data) < _HEADER.size + 4 or data[:4] != MAGIC:
        raise InputError(path, "", f"{len(data)} bytes that are no record", EXPECTED)
    if zlib.crc32(data[:-4]) != int.from_bytes(data[-4:], "little"):
        raise InputError(path, "CRC-32", "differs: a bit has changed, or the end is missing", EXPECTED)
    _, schema, number, coefficients, period_us, samples, before, *rest = _HEADER.unpack_from(data)
    level, channels, inputs, _, ratio, t_us, *scale = rest
    size = _HEADER.size + 2 * samples * channels + 4
    if schema != SCHEMA or not 3 <= channels <= len(scale) or level >= len(LEVELS) or len(data) != size:
        raise InputError(path, "header", f"schema {schema}, {channels} channels, {samples} samples", EXPECTED)
    bits = np.frombuffer(data, "<i2", samples * channels, _HEADER.size).reshape(samples, channels)
    values = np.where(bits == _NO_NUMBER, np.nan, bits * np.array(scale[:channels]))
    return Record(number, coefficients, period_us, before, LEVELS[level], ratio, t_us, inputs, values)


def record_table(path: Path, project: Project) -> pa.Table:
    """Return a record as the drive table of a vehicle, with time from the first sample on.

    Raises InputError if it is no record, or has other signals or another period than the vehicle.
    """
    record = read_record(path)
    signals = [project.speed, *project.inputs, *project.outputs]
    stated = record.inputs, record.values.shape[1] - 1 - record.inputs, record.period_us
    expected = project.n_u, project.n_y, round(1e6 * project.Ts_s)
    if stated != expected:
        words = "{} inputs, {} outputs, {} us a sample"
        raise InputError(
            path, "header", words.format(*stated), f"{words.format(*expected)}, as {project.name}"
        )
    t = np.arange(len(record.values)) * project.Ts_s
    columns = dict(zip((s.column for s in signals), record.values.T, strict=True))
    return pa.table({"t": t, **{name: np.ascontiguousarray(x) for name, x in columns.items()}})
