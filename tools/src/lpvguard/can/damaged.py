"""Refuse damaged logs with which python-can or asammdf would never end or would read foreign memory."""

from __future__ import annotations

import mmap
from collections import deque
from collections.abc import Iterator
from math import prod
from pathlib import Path
from typing import TYPE_CHECKING

from .asc_dialects import AscLines

if TYPE_CHECKING:
    import can

_VIRTUAL = {3, 6}
"""Channel types of MDF 4 that have no bytes in the record."""
_HAS_INVALIDATION = 2
"""Flag of a channel of MDF 4 with an invalidation bit."""


def _require_advance(objects: bytes) -> None:
    """Raise ValueError for an empty object of a BLF container, because the reader would loop for ever."""
    at = objects.find(b"LOBJ", 0, 8)
    while at >= 0:
        size = int.from_bytes(objects[at + 8 : at + 12], "little")
        if size == 0:
            raise ValueError("an object without bytes")
        at = objects.find(b"LOBJ", at + size, at + size + 8)


def python_can_reader(path: Path) -> can.io.generic.MessageReader:
    """Return python-can's reader of a log.

    The BLF reader raises ValueError where it would never end (`_require_advance`). The ASC reader reads
    further dialects (`AscLines`).
    """
    import can  # costs 0.2 s, and is not needed for candump

    reader = can.LogReader(path)
    if isinstance(reader, can.ASCReader):
        reader.file = AscLines(reader.file)  # type: ignore[assignment]
    if isinstance(reader, can.BLFReader):
        parse = reader._parse_data

        def parse_what_advances(data: bytes) -> Iterator[can.Message]:
            _require_advance(data)
            return parse(data)

        reader._parse_data = parse_what_advances  # type: ignore[method-assign]
    return reader


class _Mdf:
    """Blocks of an MDF file.

    In MDF 4, addresses have 8 bytes and begin at byte 24 of a block. In MDF 3, they have 4 bytes and begin at
    byte 4. The first address is that of the next block; the addresses of child blocks follow.
    """

    def __init__(self, content: mmap.mmap):
        self.content = content
        self.is_4 = self.number(28, 2) >= 400
        self.first, self.following, self.width = (88, 24, 8) if self.is_4 else (68, 4, 4)

    def number(self, at: int, size: int) -> int:
        return int.from_bytes(self.content[at : at + size], "little")

    def link(self, at: int, index: int) -> int:
        """Read address ``index`` of a block; index 0 is the address of the next block."""
        return self.number(at + self.following + index * self.width, self.width)

    def fields(self, at: int) -> int:
        """Start of the fields of an MDF 4 block, after its addresses."""
        return at + 24 + 8 * self.number(at + 16, 8)

    def kind(self, at: int) -> bytes:
        return self.content[at : at + 4]

    def blocks(self, at: int) -> Iterator[int]:
        """Yield the blocks of the list that begins at an address; raise ValueError for a circular list."""
        seen = set()
        while at:
            if at in seen:
                raise ValueError("a list of blocks without an end")
            seen.add(at)
            yield at
            at = self.link(at, 0)

    def groups(self) -> Iterator[int]:
        return self.blocks(self.number(self.first, self.width))

    def require_inside(self, channels: int, record: int, invalidation: int) -> None:
        """Raise ValueError unless all channels of a list lie within a record and its invalidation bytes."""
        for channel in self.blocks(channels):
            if self.is_4:
                start, bits = self._place(channel, invalidation)
                parts = self.link(channel, 1)
                if self.kind(parts) == b"##CA":
                    array = self.fields(parts)
                    bits *= prod(self.number(array + 16 + 8 * k, 8) for k in range(self.number(array + 2, 2)))
                    parts = self.link(parts, 0)
                if self.kind(parts) == b"##CN":
                    self.require_inside(parts, record, invalidation)
            else:
                start = 8 * self.number(channel + 226, 2) + self.number(channel + 186, 2)
                bits = self.number(channel + 188, 2)
            if start + bits > 8 * record:
                raise ValueError("a channel beyond its record")

    def _place(self, channel: int, invalidation: int) -> tuple[int, int]:
        """First bit and number of bits of an MDF 4 channel within its record."""
        own = self.fields(channel)
        has_bit = self.number(own + 12, 4) & _HAS_INVALIDATION
        if has_bit and self.number(own + 16, 4) >= 8 * invalidation:
            raise ValueError("an invalidation bit beyond its record")
        if self.number(own, 1) in _VIRTUAL:
            return 0, 0
        return 8 * self.number(own + 4, 4) + self.number(own + 3, 1), self.number(own + 8, 4)


def require_sound_blocks(path: Path) -> None:
    """Raise ValueError for an MDF file with a circular list, or with a channel beyond its record.

    asammdf would follow a circular list for ever. It would read the bytes of a channel beyond its record from
    foreign memory.
    """
    with path.open("rb") as file:
        if file.read(3) != b"MDF":
            return  # asammdf refuses it
        content = mmap.mmap(file.fileno(), 0, access=mmap.ACCESS_READ)
    with content:
        mdf = _Mdf(content)
        for group in mdf.groups():
            for channels in mdf.blocks(mdf.link(group, 1)):
                if mdf.is_4:
                    own = mdf.fields(channels)
                    record, invalidation = mdf.number(own + 24, 4), mdf.number(own + 28, 4)
                else:
                    record, invalidation = mdf.number(channels + 20, 2), 0
                mdf.require_inside(mdf.link(channels, 1), record, invalidation)
            data = mdf.link(group, 2)
            if mdf.kind(data) == b"##HL":
                data = mdf.link(data, 0)
            if mdf.kind(data) == b"##DL":
                deque(mdf.blocks(data), maxlen=0)
