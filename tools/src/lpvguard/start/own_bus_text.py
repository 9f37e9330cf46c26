"""Text of a project file about the car's own bus, as comments."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import get_args

import tomlkit

from ..drives.unit_names import DIMENSIONS as SI
from ..drives.units import unit_factor
from ..vehicle.project import Checksum
from .readings import ROLES
from .signal_map_text import comment
from .signals import Proposal

SIGNALS = ("speed", "road_wheel_angle", "yaw_rate")
"""Names in the project file, in the order of ROLES."""


def with_own_bus(text: str, proposals: Mapping[str, Proposal], dbc: Path) -> str:
    """Add the places of the signals, and a proposed table ``[can]``, to a project file.

    Parameters
    ----------
    text : str, of the project file
    proposals : Mapping, by role
    dbc : Path, CAN database that named the signals

    Returns
    -------
    str
        All additions are comments.
    """
    for role, name in zip(ROLES, SIGNALS, strict=True):
        head = f'name = "{name}"\n'
        text = text.replace(head, f"{head}# can = {_place(role, proposals[role])}\n", 1)
    messages = dict.fromkeys(p.name.rpartition(".")[0] for p in proposals.values())
    lines = [
        "The car's own bus: uncomment it and each signal's `can`. `replay` then reads raw logs as the ECU",
        "does; with a controller `export` writes the ECU's loop. Put the database beside this file. A demand",
        "needs a message of its own there. Checksums (can.messages.NAME.checksum) are one of",
        *_wrapped(get_args(Checksum)),
        "[can]",
        f"dbc = {tomlkit.item(dbc.name).as_string()}",
        f'demand.{SIGNALS[1]} = {{ message = "...", signal = "...", factor = 57.29577951308232 }}',
        *(f'messages.{tomlkit.key(name).as_string()}.checksum = "..."' for name in messages),
    ]
    return text + "\n" + "".join(f"{comment(line)}\n" for line in lines)


def _place(role: str, p: Proposal) -> str:
    """Inline table of a signal's place: bus value = factor * SI value."""
    message, _, signal = p.name.rpartition(".")
    factor = 1.0 / (p.factor * (unit_factor(p.unit, SI[role]) or 1.0))
    place = {"message": message, "signal": signal, "factor": float(f"{factor:.15g}")}
    if p.plus:
        place["plus"] = [name.rpartition(".")[2] for name in p.plus]
    table = tomlkit.inline_table()
    table.update(place)
    return table.as_string()


def _wrapped(words: tuple[str, ...]) -> list[str]:
    """Lines of at most eight words."""
    return [", ".join(words[k : k + 8]) for k in range(0, len(words), 8)]
