"""Read tables from MATLAB files of `save -v7`: each vector of numbers is a column.

A damaged number makes scipy read foreign memory, because it indexes its table of types. This module therefore
checks the variables' descriptions first. scipy then reads only sound vectors of numbers.
"""

import io
import zlib
from math import prod
from pathlib import Path

import numpy as np
import pyarrow as pa
from scipy.io import loadmat

from ..base.errors import InputError

EXPECTED = "vectors of one length, a variable a column (save -v7)"
_SIZES = {1: 1, 2: 1, 3: 2, 4: 2, 5: 4, 6: 4, 7: 4, 9: 8, 12: 8, 13: 8}
"""Number of bytes by the number type in the file."""
_INT8, _INT32, _UINT32, _MATRIX, _COMPRESSED, _UTF8 = 1, 5, 6, 14, 15, 16
_NUMBERS = range(6, 16)
"""Array classes with numbers: double, single, and integers of 8 to 64 bits."""
_COMPLEX = 0x800
_DESCRIBED = 4096
"""Number of bytes at the start of a compressed variable that hold its description."""
_DENSEST = 1032
"""Largest number of bytes that zlib unpacks from one byte."""


def read_matlab(path: Path) -> pa.Table:
    """Read all variables that are vectors of numbers.

    Parameters
    ----------
    path : Path

    Returns
    -------
    Table, one column for each vector

    Raises
    ------
    InputError
        If the vectors' lengths differ, if a vector is damaged, or if the file is an HDF5 file of version 7.3.
    """
    try:
        content = path.read_bytes()
        variables = loadmat(io.BytesIO(content), squeeze_me=True, variable_names=_vectors(content))
    except MemoryError:
        raise
    except Exception as error:  # scipy has no exception class for a broken file
        raise InputError(path, "", f"cannot be parsed ({type(error).__name__}: {error})", EXPECTED) from None
    columns = {n: v for n, v in variables.items() if getattr(v, "ndim", 0) == 1 and v.dtype.kind in "fiu"}
    if len({len(v) for v in columns.values()}) > 1:
        lengths = ", ".join(f"{n} {len(v)}" for n, v in columns.items())
        raise InputError(path, "", f"variables of different lengths ({lengths})", EXPECTED)
    # A MATLAB file has the byte order of its writer; Arrow needs the native byte order.
    return pa.table({n: v.astype(v.dtype.newbyteorder("=")) for n, v in columns.items()})


def _vectors(content: bytes) -> list[str] | None:
    """Names of the vectors of numbers in a file of version 5 to 7.2; None for another version.

    Raises ValueError for a damaged file.
    """
    order = {b"IM": "<", b"MI": ">"}.get(content[126:128])
    if order is None or 0 in content[:4] or int(np.frombuffer(content, order + "u2", 1, 124)[0]) >> 8 != 1:
        return None
    names, at = [], 128
    while at < len(content):
        kind, start, size = _tag(content, at, order)
        element, room = content[start : start + size], size
        if len(element) < size:
            raise ValueError("a variable ends behind the file")
        at = start + size
        if kind == _COMPRESSED:
            room = _DENSEST * size
            element = zlib.decompressobj().decompress(element, _DESCRIBED)
            kind, start, size = _tag(element, 0, order)
            element = element[start:]
        if kind != _MATRIX or size > room:
            raise ValueError(f"a variable of type {kind} with {size} bytes")
        if name := _vector(element, size, order):
            names.append(name)
    return names


def _tag(content: bytes, at: int, order: str) -> tuple[int, int, int]:
    """Read the tag of an element: its type, the start of its data, and the number of data bytes."""
    first, second = (int(word) for word in np.frombuffer(content, order + "u4", 2, at))
    return (first & 0xFFFF, at + 4, first >> 16) if first >> 16 else (first, at + 8, second)


def _vector(element: bytes, size: int, order: str) -> str:
    """Name of a variable if it is a vector of numbers, otherwise "".

    Raises ValueError if the variable's parts contradict its description.
    """
    at, parts = 0, []
    for types in ({_UINT32}, {_INT32}, {_INT8, _UTF8}):
        kind, start, length = _tag(element, at, order)
        if kind not in types or start + length > len(element):
            raise ValueError(f"a description of type {kind} with {length} bytes")
        parts.append(element[start : start + length])
        at = -(-(start + length) // 8) * 8
    flags = int(np.frombuffer(parts[0], order + "u4", 1)[0])
    if flags & 0xFF not in _NUMBERS or flags & _COMPLEX:
        return ""
    sides = np.frombuffer(parts[1], order + "i4").tolist()
    kind, start, length = _tag(element, at, order)
    if length != prod(sides) * _SIZES.get(kind, -1) or start + length > size:
        raise ValueError(f"{sides} numbers of type {kind} in {length} bytes")
    return parts[2].decode() if len([n for n in sides if n != 1]) == 1 else ""
