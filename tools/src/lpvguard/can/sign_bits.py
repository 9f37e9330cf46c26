"""Find magnitudes with a separate sign bit, as on buses of the VW group."""

from __future__ import annotations

import re
from typing import TYPE_CHECKING

import numpy as np

from .log_types import Series

if TYPE_CHECKING:  # cantools takes long to import
    from cantools.database.can import Message, Signal

SIGN_BIT = re.compile(r"sign|sgn|vorzeichen|(?:^|_)vz(?:_|$)|direction|richtung")
"""Words in the name of a sign bit."""
_WORDS = re.compile(r"^(sign|sgn|vorzeichen|vz|direction|richtung)$")


def sign_bits(message: Message) -> dict[str, str]:
    """Find the magnitudes of a message and their sign bits.

    Parameters
    ----------
    message : Message, of cantools

    Returns
    -------
    dict[str, str]
        Sign bit by magnitude. The bit has the magnitude's name with a word for sign, or it follows the
        magnitude and has the first words of its name.
    """
    signs: dict[str, str] = {}
    magnitudes = [s for s in message.signals if s.length > 1 and not s.is_signed and float(s.offset) >= 0]
    for bit in message.signals:
        words = _words(bit.name)
        base = [w for w in words if not _WORDS.match(w)]
        if bit.length != 1 or len(base) == len(words):
            continue
        same = [s for s in magnitudes if _words(s.name) == base]
        behind = [s for s in magnitudes if _words(s.name)[: len(base)] == base and _follows(bit, s)]
        signs |= {s.name: bit.name for s in same or behind[:1]}
    return signs


def sign_columns(series: dict[str, Series]) -> dict[str, str]:
    """Find the magnitudes among a table's columns, and their sign columns of 0 and 1.

    The series have a common time axis. A sign column has the name of its magnitude, apart from a unit, with a
    word for sign.
    """
    signs: dict[str, str] = {}
    for bit, values in series.items():
        base = [w for w in _words(bit) if not _WORDS.match(w)]
        if len(base) == len(_words(bit)):
            continue
        same = [n for n in series if n != bit and _words(n) == base]
        longer = [n for n in series if n != bit and _words(n)[: len(base)] == base != []]
        same = same or (longer if len(longer) == 1 else [])
        if same and np.isin(np.unique(values.value[np.isfinite(values.value)]), (0.0, 1.0)).all():
            signs |= {n: bit for n in same if not (series[n].value < 0).any()}
    return signs


def _follows(bit: Signal, magnitude: Signal) -> bool:
    """Tell if a bit directly follows a little-endian magnitude, or follows it after one other bit."""
    top = magnitude.start + magnitude.length
    return magnitude.byte_order == "little_endian" and bit.start in (top, top + 1)


def _words(name: str) -> list[str]:
    parted = re.sub(r"[\s-]+|(?<=[a-z])(?=[A-Z])|(?<=[A-Z0-9])(?=(?:Sign|Sgn|Vorzeichen)$)", "_", name)
    return parted.lower().strip("_").split("_")
