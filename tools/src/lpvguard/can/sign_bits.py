"""Magnitudes whose sign stands in a bit of its own, as buses of the VW group have them."""

from __future__ import annotations

import re
from typing import TYPE_CHECKING

if TYPE_CHECKING:  # cantools takes long to import
    from cantools.database.can import Message

SIGN_BIT = re.compile(r"sign|sgn|vorzeichen|(?:^|_)vz(?:_|$)|direction|richtung")
"""In the name of a bit that tells the sign of a magnitude beside it."""
_WORDS = re.compile(r"^(sign|sgn|vorzeichen|vz|direction|richtung)$")


def sign_bits(message: Message) -> dict[str, str]:
    """Find the magnitudes of a message and the bits that tell their signs.

    Parameters
    ----------
    message : Message, of cantools

    Returns
    -------
    dict[str, str], by magnitude the bit of the same name with a word for sign
    """
    found = {}
    for bit in message.signals:
        words = _words(bit.name)
        base = [w for w in words if not _WORDS.match(w)]
        if bit.length != 1 or len(base) == len(words):
            continue
        for signal in message.signals:
            if signal.length > 1 and not signal.is_signed and _words(signal.name) == base:
                found[signal.name] = bit.name
    return found


def _words(name: str) -> list[str]:
    return re.sub(r"([a-z])([A-Z])", r"\1_\2", name).lower().strip("_").split("_")
