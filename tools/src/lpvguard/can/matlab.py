"""Read tables from MATLAB files: each vector of numbers is a column, also in structures.

h5py reads files of version 7.3, which are HDF5 (extra ``lpvguard[sources]``).
scipy reads files of version 4. In those of version 5 a damaged number makes it read foreign memory, because
it indexes its table of types; this module reads them itself.
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
_TYPES = {1: "i1", 2: "u1", 3: "i2", 4: "u2", 5: "i4", 6: "u4", 7: "f4", 9: "f8", 12: "i8", 13: "u8"}
"""Types of numbers in the file."""
_FLOATS = {6: "f8", 7: "f4"}
"""Classes of arrays whose numbers may have a shorter type in the file."""
_INT8, _INT32, _UINT32, _MATRIX, _COMPRESSED, _UTF8 = 1, 5, 6, 14, 15, 16
_NUMBERS = range(6, 16)
"""Classes of arrays of numbers: double, single, and integers of 8 to 64 bits."""
_STRUCTURE, _DEEPEST = 2, 6
"""Class of structures, and how deep they may be within each other."""
_OF_SIMULINK = ".signals.values"
"""End of the names of signals that Simulink writes as structures with time."""
_COMPLEX = 0x800
_DESCRIBED = 4096
"""Number of bytes at the start of a compressed variable that hold its description."""
_HDF5, _USER_BLOCK = b"\x89HDF\r\n\x1a\n", 1024
"""Signature of HDF5, and the number of bytes in which it begins."""
_DENSEST = 1032
"""Largest number of bytes that zlib unpacks from one byte."""


def read_matlab(path: Path) -> pa.Table:
    """Read the vectors of numbers among the variables and in structures, there as STRUCTURE.FIELD.

    Parameters
    ----------
    path : Path

    Returns
    -------
    Table, one column for each vector

    Raises
    ------
    InputError
        If the vectors' lengths differ, a vector is damaged, or h5py is missing.
    """
    try:
        content = path.read_bytes()
        variables = _of_hdf5(path) if _HDF5 in content[:_USER_BLOCK] else _vectors(content)
        if variables is None:
            variables = loadmat(io.BytesIO(content), squeeze_me=True)
    except MemoryError:
        raise
    except ImportError as error:
        raise InputError(
            path,
            "",
            f"version 7.3 needs the package {error.name}",
            "pip install 'lpvguard[sources]', or save -v7",
        ) from None
    except Exception as error:  # scipy has no exception class for a broken file
        raise InputError(path, "", f"cannot be parsed ({type(error).__name__}: {error})", EXPECTED) from None
    columns = {n: v for n, v in variables.items() if getattr(v, "ndim", 0) == 1 and v.dtype.kind in "fiu"}
    longest = max(map(len, columns.values()), default=0)
    columns = {n: v for n, v in columns.items() if "." not in n or len(v) == longest}
    if len({len(v) for v in columns.values()}) > 1:
        lengths = ", ".join(f"{n} {len(v)}" for n, v in columns.items())
        raise InputError(path, "", f"variables of different lengths ({lengths})", EXPECTED)
    # A MATLAB file has the byte order of its writer; Arrow needs the native byte order.
    return pa.table({n: v.astype(v.dtype.newbyteorder("=")) for n, v in columns.items()})


def _of_hdf5(path: Path) -> dict[str, np.ndarray]:
    """Vectors of numbers by name in a file of version 7.3, without texts and MATLAB's own groups."""
    import h5py

    vectors: dict[str, np.ndarray] = {}

    def take(name: str, item: h5py.Dataset | h5py.Group) -> None:
        if not isinstance(item, h5py.Dataset) or name.startswith("#") or item.dtype.kind not in "fiu":
            return
        is_text = item.attrs.get("MATLAB_class") in (b"char", "char") or "MATLAB_empty" in item.attrs
        if not is_text and len([n for n in item.shape if n != 1]) == 1:
            vectors[name.replace("/", ".").removesuffix(_OF_SIMULINK)] = item[()].ravel()

    with h5py.File(path, "r") as file:
        file.visititems(take)
    return vectors


def _vectors(content: bytes) -> dict[str, np.ndarray] | None:
    """Vectors of numbers by name in a file of version 5 (to 7.2); None for another version.

    Raises ValueError for a damaged file.
    """
    order = {b"IM": "<", b"MI": ">"}.get(content[126:128])
    if order is None or 0 in content[:4] or int(np.frombuffer(content, order + "u2", 1, 124)[0]) >> 8 != 1:
        return None
    vectors: dict[str, np.ndarray] = {}
    at = 128
    while at < len(content):
        kind, start, size = _tag(content, at, order)
        element, room = content[start : start + size], size
        if len(element) < size:
            raise ValueError("a variable ends behind the file")
        at = start + size
        rest = None
        if kind == _COMPRESSED:
            room = _DENSEST * size
            rest = zlib.decompressobj()
            element = rest.decompress(element, _DESCRIBED)
            kind, start, size = _tag(element, 0, order)
            element = element[start:]
        if kind != _MATRIX or size > room:
            raise ValueError(f"a variable of type {kind} with {size} bytes")
        described = _described(element, order)
        if rest is not None and (described[0] == _STRUCTURE or _is_vector(*described[:2])):
            element += rest.decompress(rest.unconsumed_tail, max(size - len(element), 1))
        vectors |= _of_matrix("", element[:size], order, 0)
    return vectors


def _tag(content: bytes, at: int, order: str) -> tuple[int, int, int]:
    """Read the tag of an element: its type, the start of its data, and the number of data bytes."""
    first, second = (int(word) for word in np.frombuffer(content, order + "u4", 2, at))
    return (first & 0xFFFF, at + 4, first >> 16) if first >> 16 else (first, at + 8, second)


def _part(content: bytes, at: int, order: str, types: set[int]) -> tuple[bytes, int]:
    """An element that describes a variable, and where the next begins. ValueError for one of other types."""
    kind, start, length = _tag(content, at, order)
    if kind not in types or start + length > min(len(content), max(at, 0) + _DESCRIBED):
        raise ValueError(f"a description of type {kind} with {length} bytes")
    return content[start : start + length], -(-(start + length) // 8) * 8


def _described(element: bytes, order: str) -> tuple[int, list[int], str, int]:
    """Class, sides and name of a variable, and where its content begins; class 0 for complex numbers."""
    flags, at = _part(element, 0, order, {_UINT32})
    sides, at = _part(element, at, order, {_INT32})
    name, at = _part(element, at, order, {_INT8, _UTF8})
    word = int(np.frombuffer(flags, order + "u4", 1)[0])
    kind = 0 if word & _COMPLEX else word & 0xFF
    return kind, np.frombuffer(sides, order + "i4").tolist(), name.decode(), at


def _is_vector(kind: int, sides: list[int]) -> bool:
    return kind in _NUMBERS and len([n for n in sides if n != 1]) == 1


def _of_matrix(prefix: str, element: bytes, order: str, depth: int) -> dict[str, np.ndarray]:
    """Vectors of a variable, or of a structure's fields. ValueError where its parts contradict each other."""
    kind, sides, name, at = _described(element, order)
    name = prefix + name
    if kind == _STRUCTURE and prod(sides) == 1 and depth < _DEEPEST:
        return _of_structure(name, element, at, order, depth)
    if kind not in _NUMBERS:
        return {}
    number, start, length = _tag(element, at, order)
    size = np.dtype(_TYPES[number]).itemsize if number in _TYPES else -1
    if length != prod(sides) * size or (_is_vector(kind, sides) and start + length > len(element)):
        raise ValueError(f"{sides} numbers of type {number} in {length} bytes")
    if not _is_vector(kind, sides):
        return {}
    values = np.frombuffer(element, order + _TYPES[number], prod(sides), start)
    return {name.removesuffix(_OF_SIMULINK): values.astype(_FLOATS.get(kind, _TYPES[number]))}


def _of_structure(name: str, element: bytes, at: int, order: str, depth: int) -> dict[str, np.ndarray]:
    """Vectors of a structure's fields."""
    width, at = _part(element, at, order, {_INT32})
    fields, at = _part(element, at, order, {_INT8})
    step = int(np.frombuffer(width, order + "i4", 1)[0])
    if step < 1:
        raise ValueError(f"names of {step} letters")
    vectors: dict[str, np.ndarray] = {}
    for k in range(0, len(fields), step):
        kind, start, size = _tag(element, at, order)
        if kind != _MATRIX or start + size > len(element):
            raise ValueError(f"a field of type {kind} with {size} bytes")
        field = fields[k : k + step].split(b"\0")[0].decode()
        if size:
            vectors |= _of_matrix(f"{name}.{field}", element[start : start + size], order, depth + 1)
        at = -(-(start + size) // 8) * 8
    return vectors
