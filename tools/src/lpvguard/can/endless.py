"""Damaged logs at which the readers of python-can and asammdf would never end, refused before they begin."""

from __future__ import annotations

import mmap
from collections import deque
from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    import can


def _require_advance(objects: bytes) -> None:
    """ValueError where an object of a BLF container has no bytes: a reader that goes on by its size stays
    there for ever."""
    at = objects.find(b"LOBJ", 0, 8)
    while at >= 0:
        size = int.from_bytes(objects[at + 8 : at + 12], "little")
        if size == 0:
            raise ValueError("an object without bytes")
        at = objects.find(b"LOBJ", at + size, at + size + 8)


def python_can_reader(path: Path) -> can.io.generic.MessageReader:
    """python-can's reader of a log; that of BLF raises ValueError (`_require_advance`) where it would never
    end."""
    import can  # costs 0.2 s, and is not needed for candump

    reader = can.LogReader(path)
    if isinstance(reader, can.BLFReader):
        parse = reader._parse_data

        def parse_what_advances(data: bytes) -> Iterator[can.Message]:
            _require_advance(data)
            return parse(data)

        reader._parse_data = parse_what_advances  # type: ignore[method-assign]
    return reader


def require_ended_lists(path: Path) -> None:
    """ValueError where a list of an MDF file comes back to a block of before.

    asammdf follows the lists of groups, channels and data by the next block's address, and would never end.

    MDF 4 has addresses of 8 bytes: the next block's, and then that of the first block below, from byte 24;
    MDF 3 has them of 4 bytes, from byte 4.
    """
    with path.open("rb") as file:
        if file.read(3) != b"MDF":
            return  # asammdf refuses it
        content = mmap.mmap(file.fileno(), 0, access=mmap.ACCESS_READ)
    version = int.from_bytes(content[28:30], "little")
    first, following, width = (88, 24, 8) if version >= 400 else (68, 4, 4)

    def address(at: int) -> int:
        return int.from_bytes(content[at : at + width], "little")

    def blocks(at: int) -> Iterator[int]:
        seen = set()
        while at:
            if at in seen:
                raise ValueError("a list of blocks without an end")
            seen.add(at)
            yield at
            at = address(at + following)

    with content:
        for group in blocks(address(first)):
            for channels in blocks(address(group + following + width)):
                deque(blocks(address(channels + following + width)), maxlen=0)
            data = address(group + following + 2 * width)
            if content[data : data + 4] == b"##HL":
                data = address(data + following)
            if content[data : data + 4] == b"##DL":
                deque(blocks(data), maxlen=0)
