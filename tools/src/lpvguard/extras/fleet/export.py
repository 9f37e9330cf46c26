"""Write the C header with the table lpvg_life_table_t of the calibration set for the core (life.h)."""

import struct
import zlib

import numpy as np

from ...base.artefacts import mark
from .state import KIND, FleetState
from .wealth import LEVELS, POWERS, LifeTable

MAGIC, SCHEMA = 0x4546494C, 1
"""LPVG_LIFE_MAGIC, LPVG_LIFE_SCHEMA."""


def padded(table: LifeTable) -> tuple[np.ndarray, np.ndarray]:
    """Pad levels (LEVELS,) and factors (LEVELS + 1, bets) with 0 to the core's sizes, as float32."""
    levels = np.zeros(LEVELS, np.float32)
    factors = np.zeros((LEVELS + 1, len(POWERS)), np.float32)
    levels[: len(table.levels)] = table.levels
    factors[: len(table.factors)] = table.factors
    return levels, factors


def crc32(table: LifeTable, judged_s: float) -> int:
    """CRC-32 as in the core, over all previous words, low byte first."""
    levels, factors = padded(table)
    words = struct.pack("<4I", MAGIC, SCHEMA, table.n, len(table.levels))
    numbers = np.concatenate([[judged_s, table.alarm], levels, factors.ravel()]).astype("<f4")
    return zlib.crc32(words + numbers.tobytes())


def _number(value: float) -> str:
    text = f"{np.float32(value):.9g}"
    return (text if any(c in text for c in ".en") else text + ".0") + "F"


def definition(table: LifeTable, judged_s: float, name: str) -> str:
    """C code that defines the table as ``name``, valid in C99 and C++17."""
    levels, factors = padded(table)
    rows = ",\n     ".join("{" + ", ".join(map(_number, row)) + "}" for row in factors.tolist())
    return (
        f"static const lpvg_life_table_t {name} = {{\n"
        f"    {MAGIC}U, {SCHEMA}U, {table.n}U, {len(table.levels)}U, {_number(judged_s)}, "
        f"{_number(float(table.alarm))},\n"
        f"    {{{', '.join(map(_number, levels.tolist()))}}},\n"
        f"    {{{rows}}},\n"
        f"    {crc32(table, judged_s)}U}};\n"
    )


def header(state: FleetState) -> str:
    """Write the C header of `lpvguard fleet --export`.

    Parameters
    ----------
    state : FleetState

    Returns
    -------
    str
    """
    vehicle = state.terms.vehicle
    guard = f"LPVGUARD_LIFE_TABLE_{vehicle.upper()}_H"
    return (
        f"/* {mark(KIND)}: generated, do not edit. alpha {state.terms.alpha:g}, eta {state.terms.eta:g}, "
        f"{state.table.n} recordings calibrate. */\n"
        f"#ifndef {guard}\n#define {guard}\n\n"
        '#include "lpvguard/life.h"\n\n'
        f"{definition(state.table, state.terms.judged_s, f'lpvg_{vehicle}_life_table')}\n#endif\n"
    )
