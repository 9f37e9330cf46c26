"""Rewrite dialects of Vector's ASC into the dialect that python-can reads.

With ``timestamps relative`` in the header, each line's time is relative to the previous line, but python-can
reads it as absolute. ``CANFD   Start of measurement`` is an event, but python-can reads it as a frame.
"""

import re
from collections.abc import Iterator
from typing import TextIO

_HEAD = re.compile(r"^(\s*base\s+(?:hex|dec)\s+timestamps\s+)relative\b", re.IGNORECASE)
_EVENT = re.compile(r"^\s*(\d+(?:\.\d+)?)(\s.*)$", re.DOTALL)
_START = re.compile(r"^\s*\S+\s+(?:CANFD\s+)?Start of measurement", re.IGNORECASE)


class AscLines:
    """Lines of an ASC log with absolute times and without the start event."""

    def __init__(self, file: TextIO):
        self._file = file
        self._relative = False
        self._now_s = 0.0

    def __iter__(self) -> Iterator[str]:
        return self

    def __next__(self) -> str:
        line = next(self._file)
        if _HEAD.match(line):
            self._relative = True
            return _HEAD.sub(r"\1absolute", line)
        event = _EVENT.match(line) if self._relative else None
        if event:
            self._now_s += float(event[1])
            line = f"{self._now_s:.9f}{event[2]}"
        return "\n" if _START.match(line) else line

    def close(self) -> None:
        """Close the log."""
        self._file.close()
