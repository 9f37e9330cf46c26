"""Live sources of frames: simulation (LCM), CAN interface, growing candump log, MCAP file of ROS 2.

A source keeps at most MOST frames or BLOCK bytes. Further frames wait in the queue of the kernel or of LCM.
Its overflow is counted if the source reports it.
"""

import time
from collections.abc import Iterator
from itertools import islice
from pathlib import Path
from typing import Protocol

import numpy as np

from ...base.errors import InputError
from ...base.optional import optional
from ...can.logs import EXTENDED, Frames, candump_frames

WAIT_S = 0.1
"""Time without a frame after which a source reports it [s]."""
RETRY_S = 1.0
"""Time between two attempts to open a lost interface or log [s]."""
MOST = 4096
"""Most frames that a source returns at once."""
QUEUE = 100_000
"""Most frames in LCM's queue."""
BLOCK = 1 << 18
"""Most bytes of a log that are read at once."""
EXPECTED = "an LCM URL (udpm://...), socketcan:INTERFACE, or the path of a candump log that grows"
ROS_FRAME = "can_msgs/msg/Frame"
"""ROS 2 message type of a CAN frame."""


class FrameSource(Protocol):
    """A live source of frames.

    ``lost`` counts the frames that are known to be lost. ``trouble`` explains why frames are missing; empty
    if unknown.
    """

    name: str
    lost: int
    trouble: str

    def pieces(self) -> Iterator[Frames | None]:
        """Yield frames in the order of arrival without end; None if no frame came for WAIT_S."""
        ...


def open_source(where: str) -> FrameSource:
    """Open a live source of frames.

    Parameters
    ----------
    where : str, LCM address, CAN interface or path of a log

    Returns
    -------
    FrameSource

    Raises
    ------
    InputError
        If the source is none of these, or cannot be opened.
    """
    if where.startswith("socketcan:"):
        return CanSource(where.removeprefix("socketcan:"))
    if "://" in where:
        return LcmSource(where)
    path = Path(where)
    return Ros2Source(path) if path.suffix == ".mcap" else LogSource(path)


class LcmSource:
    """The bus of a simulation that `lpvguard sim --lcm URL` runs."""

    def __init__(self, url: str):
        from ..loop.lcm_client import Client

        self.name, self.lost, self.trouble = url, 0, ""
        self._client = Client(url, ["LPVGUARD_BUS"], QUEUE)

    def pieces(self) -> Iterator[Frames | None]:
        """Yield frames of the bus from LCM; None if no frame came for WAIT_S."""
        newest = -1
        while True:
            heard = [m for _, m in self._client.waiting(WAIT_S, MOST)]
            for message in heard:
                # A restarted simulation counts from 0 again.
                if newest >= 0 and message.sequence > newest + 1:
                    self.lost += message.sequence - newest - 1
                newest = message.sequence
            frames = [
                (m.utime * 1000, m.id | (EXTENDED if m.extended else 0), m.data[: m.dlc])
                for m in heard
                if not m.error
            ]
            yield _joined(frames, "lcm") if frames else None


class CanSource:
    """A SocketCAN interface, used only for reception."""

    def __init__(self, interface: str):
        import can

        self.name, self.lost, self.trouble = f"socketcan:{interface}", 0, ""
        self._interface, self._can = interface, can
        try:
            self._bus: can.BusABC | None = self._open()
        except (OSError, can.CanError) as error:
            raise InputError(
                self.name, "", str(error), "a SocketCAN interface that is up (tools/with-vcan makes one)"
            ) from None

    def pieces(self) -> Iterator[Frames | None]:
        """Yield frames of the interface; None if no frame came within WAIT_S or the interface is missing."""
        while True:
            try:
                self._bus = self._bus or self._open()
                self.trouble = ""
                frames = self._heard(self._bus)
            except (OSError, self._can.CanError) as error:
                self.trouble = str(error)
                if self._bus is not None:
                    self._bus.shutdown()
                self._bus, frames = None, []
                time.sleep(RETRY_S)
            yield _joined(frames, self._interface) if frames else None

    def _open(self):
        return self._can.Bus(self._interface, interface="socketcan", fd=True)

    def _heard(self, bus) -> list[tuple[int, int, bytes]]:
        """Wait for a frame, then collect the frames of at most WAIT_S."""
        frames: list[tuple[int, int, bytes]] = []
        message = bus.recv(WAIT_S)
        ends = time.monotonic() + WAIT_S / 4
        while message is not None and len(frames) < MOST:
            if not (message.is_error_frame or message.is_remote_frame):
                identifier = message.arbitration_id | (EXTENDED if message.is_extended_id else 0)
                frames.append((round(message.timestamp * 1e9), identifier, bytes(message.data)))
            message = bus.recv(max(ends - time.monotonic(), 0.0))
        return frames


class LogSource:
    """A candump log that another program writes; a restarted log is read again."""

    def __init__(self, path: Path):
        if not path.is_file():
            raise InputError(path, "", "no such file", EXPECTED)
        self.name, self.lost, self.trouble = str(path), 0, ""
        self._path = path

    def pieces(self) -> Iterator[Frames | None]:
        """Yield frames of the added lines; None if there are none or the log is missing."""
        while True:
            try:
                yield from self._until_replaced()
            except OSError as error:
                self.trouble = str(error)
                time.sleep(RETRY_S)
                yield None

    def _until_replaced(self) -> Iterator[Frames | None]:
        """Yield frames of the file until another file replaces it or it becomes shorter."""
        with self._path.open("rb") as stream:
            inode, rest = self._path.stat().st_ino, b""
            self.trouble = ""
            while True:
                text = stream.read(BLOCK)
                whole, newline, rest = (rest + text).rpartition(b"\n")
                frames = candump_frames(np.frombuffer(whole + newline, np.uint8)) if whole else None
                if len(rest) > BLOCK:
                    raise OSError(f"no end of line within {BLOCK} bytes: {EXPECTED}")
                if text:
                    yield frames if frames is not None and len(frames) else None
                    continue
                now = self._path.stat()
                if now.st_ino != inode or now.st_size < stream.tell():
                    return
                time.sleep(WAIT_S)
                yield None


class Ros2Source:
    """The CAN frames of a ROS 2 recording (MCAP), then silence."""

    def __init__(self, path: Path):
        if not path.is_file():
            raise InputError(path, "", "no such file", "an MCAP file of ROS 2")
        self.name, self.lost, self.trouble = str(path), 0, ""
        self._path = path
        self._open = optional("mcap.reader", "ros2").make_reader
        self._decoder = optional("mcap_ros2.decoder", "ros2").DecoderFactory

    def pieces(self) -> Iterator[Frames | None]:
        """Yield frames of the topics of can_msgs/Frame in the order of time, then None without end."""
        frames = self._frames()
        while piece := list(islice(frames, MOST)):
            yield _joined(piece, "ros2")
        while True:
            time.sleep(WAIT_S)
            yield None

    def _frames(self) -> Iterator[tuple[int, int, bytes]]:
        """Time, identifier and data of every frame; InputError if there is none."""
        known = False
        with self._path.open("rb") as stream:
            reader = self._open(stream, decoder_factories=[self._decoder()])
            for schema, _, message, frame in reader.iter_decoded_messages():
                if schema.name == ROS_FRAME:
                    known = True
                    if not (frame.is_rtr or frame.is_error):
                        identifier = frame.id | (EXTENDED if frame.is_extended else 0)
                        yield message.log_time, identifier, bytes(frame.data[: frame.dlc])
        if not known:
            raise InputError(self._path, "", f"no message of {ROS_FRAME}", "a recording of a CAN bus")


def _joined(frames: list[tuple[int, int, bytes]], channel: str) -> Frames:
    """Frames of (time [ns], identifier with EXTENDED, data)."""
    data = np.zeros((len(frames), max(8, *(len(d) for _, _, d in frames))), np.uint8)
    for row, (_, _, content) in zip(data, frames, strict=True):
        row[: len(content)] = np.frombuffer(bytes(b & 0xFF for b in content), np.uint8)
    return Frames(
        np.array([t for t, _, _ in frames], np.int64),
        np.array([i for _, i, _ in frames], np.uint32),
        np.zeros(len(frames), np.uint8),
        np.array([len(d) for _, _, d in frames], np.uint8),
        data,
        [channel],
    )
