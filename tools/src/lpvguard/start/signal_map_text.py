"""Text of the signal map that `lpvguard new` writes, with the reason for each column."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING

import tomlkit

from ..can.sign_bits import sign_bits
from ..drives.unit_names import DIMENSIONS as SI
from .readings import ROLES
from .redundant import Redundant
from .signals import Proposal

if TYPE_CHECKING:  # cantools takes long to import
    from cantools.database.can import Database

COLUMNS = {"speed": "v", "input": "delta", "output": "r"}
Signals = tuple[dict[str, Proposal], dict[str, tuple[float, float]], list[Redundant]]
"""Proposals and ranges by role, and further measurements of the yaw rate."""


def signal_map_text(
    signals: Signals, Ts: float, read_by: dict[str, str | float | None], sign_bit: dict[str, str]
) -> str:
    """Write a signal map for `ingest`.

    Parameters
    ----------
    signals : Signals
    Ts : float, s
    read_by : dict, by key of the map how the logs are read, None where nothing is stated
    sign_bit : dict[str, str], MESSAGE.SIGNAL of a magnitude -> the signal that tells its sign

    Returns
    -------
    str
    """
    proposals, limits, further = signals
    lines = [
        "# Signal map for `lpvguard ingest`. Left turns are positive.",
        "schema = 1",
        f"Ts_s = {Ts:g}",
        *(
            f"{key} = {tomlkit.item(value).as_string()}"
            for key, value in read_by.items()
            if value is not None
        ),
    ]
    for role in ROLES:
        p = proposals[role]
        lines += ["", *(comment(sentence) for sentence in p.why), f"[columns.{COLUMNS[role]}]"]
        lines += [f'unit = "{SI[role]}"']
        terms = [_term(p, name, sign_bit) for name in (p.name, *p.plus)]
        if p.plus:  # a sum has no limits
            lines += ["terms = [", *(f"    {{ {', '.join(term)} }}," for term in terms), "]"]
        else:
            lines += [*terms[0], f"min = {limits[role][0]:g}      # samples beyond are spikes, and left out"]
            lines += [f"max = {limits[role][1]:g}"]
    for r in further:
        lines += ["", comment(r.why), f"[columns.{r.column}]", f'unit = "{SI["output"]}"', *_keys(r.keys)]
        of_signals = [[*_place(name, sign_bit), *_keys(keys)] for name, keys in r.terms]
        lines += ["terms = [", *(f"    {{ {', '.join(term)} }}," for term in of_signals), "]"]
    return "\n".join(lines) + "\n"


def _term(p: Proposal, name: str, sign_bit: dict[str, str]) -> list[str]:
    """Keys of a signal of a role in a signal map."""
    return [*_place(name, sign_bit), *_keys({"source_unit": p.unit, "factor": p.factor})]


def _place(name: str, sign_bit: dict[str, str]) -> list[str]:
    """Keys that say where a signal is in the log."""
    message, _, signal = name.rpartition(".")
    place = {"message": message} if message else {}
    return _keys(place | {"signal": signal} | ({"sign": sign_bit[name]} if name in sign_bit else {}))


def _keys(keys: Mapping[str, float | str | bool]) -> list[str]:
    return [f"{key} = {tomlkit.item(value).as_string()}" for key, value in keys.items()]


def sign_bits_of(database: Database) -> dict[str, str]:
    """MESSAGE.SIGNAL of every magnitude -> the signal beside it that tells its sign."""
    return {
        f"{message.name}.{name}": bit
        for message in database.messages
        for name, bit in sign_bits(message).items()
    }


def _quoted(text: str) -> str:
    """A signal's name as a string of a TOML file."""
    return tomlkit.item(text).as_string()


def comment(text: str) -> str:
    """A comment of a TOML file: one line without control characters."""
    return "# " + "".join(c if c.isprintable() else " " for c in text)
