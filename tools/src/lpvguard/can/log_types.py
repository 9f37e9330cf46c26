"""Types for the contents of a log: raw frames, or decoded signals."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from ..base.errors import InputError

EXTENDED = 0x80000000
"""Flag in ``Frames.id``: 29-bit identifier."""
ERROR_REPORT = 0x20000000
"""Flag in the identifier of an error report, as candump logs it."""

FD_BYTES = 64
"""Largest number of data bytes in a frame."""
LATEST_S = 9_000_000_000
"""Latest time [s] that 64 bits of nanoseconds can hold, rounded down."""


@dataclass(frozen=True)
class Frames:
    """Raw frames in the order of the log.

    Attributes
    ----------
    t_ns : ndarray (N,) of int, ns
    id : ndarray (N,) of int, identifier with the flag EXTENDED
    channel : ndarray (N,) of int, index into ``channels``
    length : ndarray (N,) of int, bytes
    data : ndarray (N, width) of uint8
    channels : list of str
    """

    t_ns: np.ndarray
    id: np.ndarray
    channel: np.ndarray
    length: np.ndarray
    data: np.ndarray
    channels: list[str]
    left_out: dict[str, int] = field(default_factory=dict)
    """Number of other entries of the log, by kind: error reports, remote frames, lines without a frame."""

    def __len__(self) -> int:
        return len(self.t_ns)

    def of_channel(self, channel: str | None, where: Path | str) -> Frames:
        """Frames of one channel (None: all); raise InputError if the log ``where`` has no such channel."""
        if channel is None:
            return self
        if channel not in self.channels:
            raise InputError(
                where, "channel", f"{channel} is not in the log", f"one of {', '.join(self.channels)}"
            )
        at = self.channel == self.channels.index(channel)
        return self.at(at)

    def at(self, rows: np.ndarray | slice) -> Frames:
        """Select frames; ``rows`` is a mask (N,), positions or a slice."""
        return Frames(
            self.t_ns[rows],
            self.id[rows],
            self.channel[rows],
            self.length[rows],
            self.data[rows],
            self.channels,
            self.left_out,
        )


@dataclass(frozen=True)
class Series:
    """Signal of a decoded log.

    Attributes
    ----------
    t_ns : ndarray (N,) of int, ns
    value : ndarray (N,), NaN where the log has no value
    unit : str, unit that the log states, or ""
    """

    t_ns: np.ndarray
    value: np.ndarray
    unit: str = ""


@dataclass(frozen=True)
class Table:
    """Decoded log: its series by signal."""

    series: dict[str, Series]


def row_of(
    t_s: float, identifier: int, extended: bool, channel: object, data: bytes
) -> tuple[int, int, str, bytes]:
    """Make a row: time [ns], identifier with its flag, channel, data; ValueError for impossible values."""
    if not 0 <= identifier < (1 << 29 if extended else 1 << 11):
        raise ValueError(f"identifier {identifier:#x} has too many bits")
    if not abs(t_s) <= LATEST_S:
        raise ValueError(f"time {t_s} s")
    if len(data) > FD_BYTES:
        raise ValueError(f"{len(data)} bytes of data")
    return round(t_s * 1e9), identifier | (EXTENDED if extended else 0), str(channel), data


def frames_of_rows(rows: list[tuple[int, int, str, bytes]], left_out: dict[str, int]) -> Frames:
    """Make frames from rows of `row_of`."""
    width = max((len(row[3]) for row in rows), default=8)
    width = 8 if width <= 8 else FD_BYTES
    channels = sorted({row[2] for row in rows})
    position = {name: i for i, name in enumerate(channels)}
    data = np.frombuffer(b"".join(row[3].ljust(width, b"\0") for row in rows), np.uint8).reshape(-1, width)
    return Frames(
        np.array([row[0] for row in rows], np.int64),
        np.array([row[1] for row in rows], np.uint32),
        np.array([position[row[2]] for row in rows], np.uint8),
        np.array([len(row[3]) for row in rows], np.uint8),
        data,
        channels,
        left_out,
    )
