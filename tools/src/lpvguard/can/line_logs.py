"""Raw frames with a line each: BUSMASTER, CRTD (OVMS), Kvaser's CanKing, Microchip's analyzer, slcan.

The form is that of the first line that is a frame. The clock of BUSMASTER begins anew at midnight, that of
slcan after a minute. Bytes are hexadecimal where each has two digits.
"""

import re
from pathlib import Path

from ..base.errors import InputError
from .log_types import Frames, frames_of_rows, row_of

_BYTE = r"(?:0x)?[0-9A-Fa-f]{1,3}"
_BYTES = rf"(?P<data>(?:{_BYTE}(?:[ ;]+{_BYTE})*)?)"
_FORMS = tuple(
    re.compile(pattern)
    for pattern in (
        # BUSMASTER: time of day, direction, channel, identifier, type, length, bytes
        r"(?P<h>\d+):(?P<min>\d+):(?P<sec>\d+):(?P<part>\d+)\s+[RT]x\s+(?P<bus>\d+)\s+"
        rf"(?P<id>(?:0x)?[0-9A-Fa-f]+)\s+(?P<kind>s|x|sr|xr)\s+(?P<length>\d+)\s*{_BYTES}\s*",
        # CRTD: time, bus, direction and bits of the identifier, identifier, bytes
        rf"(?P<s>\d+\.\d+) (?P<bus>\d*)[RT](?P<kind>11|29) (?P<id>[0-9A-Fa-f]+) ?{_BYTES}\s*",
        # CanKing: channel, identifier, flags, length, bytes, time, direction
        r"\s*(?P<bus>\d+)\s+(?P<id>[0-9A-Fa-f]+)\s+(?:(?P<kind>[A-Za-z]+)\s+)?(?P<length>\d+)\s+"
        rf"(?:{_BYTES}\s+)?(?P<s>\d+\.\d+)\s+[RT]\s*",
        # Microchip: ms, direction, identifier, length, bytes
        r"(?P<ms>\d+);[RT]X;(?P<id>(?:0x)?[0-9A-Fa-f]+)(?P<kind>x?);(?P<length>\d+);?" + rf"{_BYTES};?\s*",
        # slcan: t or T, identifier, length, bytes, ms; a terminal may write a time in front
        r"(?:[\[(]?(?P<s>\d+\.\d+)[\])]?[ ,;\t]+)?(?P<kind>t(?=[0-9A-Fa-f]{4})|T(?=[0-9A-Fa-f]{9}))"
        r"(?P<id>(?<=t)[0-9A-Fa-f]{3}|(?<=T)[0-9A-Fa-f]{8})(?P<length>[0-8])(?P<rest>[0-9A-Fa-f]*)\s*",
    )
)
_HEADS = re.compile(r"\*|//|Chn |\d+\.\d+ \d*C|\s*$")
"""How lines begin that are no frame and tell of the log."""
_LEAST = 0.5
"""Least share of the lines after the first frame that are frames."""


def form_of(text: str) -> re.Pattern[str] | None:
    """Find the form of the first line of a text that is a frame; None where no line is one."""
    return next((form for line in text.splitlines() for form in _FORMS if form.fullmatch(line)), None)


def read_lines(path: Path, text: str, form: re.Pattern[str]) -> Frames:
    """Read the frames of a log, whose lines have the ``form`` that `form_of` found.

    Raises InputError if most lines are no frame, a frame has no time, or its length is not that of its bytes.
    """
    lines = [(n, line) for n, line in enumerate(text.splitlines(), start=1) if not _HEADS.match(line)]
    frames = [(n, match.groupdict()) for n, line in lines if (match := form.fullmatch(line))]
    others = [n for n, line in lines if n > frames[0][0] and not form.fullmatch(line)]
    if len(others) > _LEAST * len(lines):
        raise InputError(path, f"line {others[0]}", "no frame, as most lines", "lines as the first frame's")
    numbers = " ".join(cells.get("data") or "" for _, cells in frames).replace(";", " ").split()
    parts = 10.0 ** -max(3, *(len(cells.get("part") or "") for _, cells in frames), 0)
    decimal = "***DEC***" in text or any(len(byte) != 2 for byte in numbers if "x" not in byte)
    base = 10 if decimal else 16
    clock = _Clock("***RELATIVE MODE***" in text, parts)
    rows, left_out = [], {"error reports": 0, "remote frames": 0}
    for number, cells in frames:
        kind = (cells["kind"] or "").lower()
        if "r" in kind or "e" in kind:
            left_out["remote frames" if "r" in kind else "error reports"] += 1
            continue
        try:
            if cells.get("rest") is not None:
                size = 2 * int(cells["length"])
                cells |= {
                    "data": " ".join(re.findall("..", cells["rest"][:size])),
                    "stamp": cells["rest"][size:],
                }
            data = bytes(
                int(byte, 0 if "x" in byte else base) for byte in re.findall(_BYTE, cells["data"] or "")
            )
            if int(cells.get("length") or len(data)) != len(data):
                raise ValueError(f"{len(data)} bytes, where its length says {cells['length']}")
            identifier = int(cells["id"], 0 if "x" in cells["id"] else base)
            extended = kind in ("x", "29") or cells["kind"] == "T" or identifier > 0x7FF
            rows.append(row_of(clock.seconds(cells), identifier, extended, cells.get("bus") or "", data))
        except ValueError as error:
            expected = "a time, an identifier and as many bytes as the length says"
            raise InputError(path, f"line {number}", f"no frame ({error})", expected) from None
    left_out["lines that are no frame"] = len(others)
    return frames_of_rows(rows, {what: n for what, n in left_out.items() if n})


class _Clock:
    """Clock of a log, which gives the times [s] of its lines, also where it begins anew.

    With ``relative``, each time counts from the previous line. The last number of a time of day counts in
    ``part_s`` [s], because some tools write no leading zeros.
    """

    def __init__(self, relative: bool, part_s: float):
        self._relative, self._part_s = relative, part_s
        self._now = self._turns = 0.0

    def seconds(self, cells: dict[str, str | None]) -> float:
        """The time of a line. ValueError where it has none."""
        period = 0.0
        if cells.get("s"):
            t = float(cells["s"] or 0)
        elif cells.get("ms"):
            t = int(cells["ms"] or 0) / 1e3
        elif cells.get("h"):
            h, minutes, seconds = (int(cells[unit] or 0) for unit in ("h", "min", "sec"))
            t, period = h * 3600 + minutes * 60 + seconds + int(cells["part"] or 0) * self._part_s, 86_400.0
        elif len(stamp := cells.get("stamp") or "") == 4:
            t, period = int(stamp, 16) / 1e3, 60.0
        else:
            raise ValueError("no time: slcan's adapter writes one after its command Z1")
        if self._relative:
            t += self._now
        elif period and t + self._turns < self._now - period / 2:
            self._turns += period
        self._now = t + (0.0 if self._relative else self._turns)
        return self._now
