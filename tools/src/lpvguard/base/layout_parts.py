"""Parts of a coefficient struct: dimensions, fields, shapes and ranges (layout.py has the tables)."""

import math
import re
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np

from .errors import InputError

DIMENSIONS = {
    "NX": "states of the model",
    "NU": "inputs",
    "NY": "outputs",
    "DELAY": "whole samples of input delay",
    "NBINS": "frequency bins, DC first",
    "NCELLS": "speed cells of the model's table",
    "NVARYING": "entries of the model that vary with speed",
    "NWEIGHT": "sections of the filter W_delta",
    "NDIRECTIONS": "directions of the energy test's fan",
    "NBANDS": "bands of the energy test, one more than its corners",
    "NDELTA": "blocks Delta of the uncertainty: 1 common block, or NY blocks, one for each output",
    "NK": "states of one demand of the controller",
    "NM": "measurements: the reference, then the outputs",
    "NG": "nodes of the controller's speed grid",
}
"""Dimension -> meaning, in the order of LPVG_<name> in lpvguard_vehicle.h. The dimensions of a controller
are 0 without a controller."""

CONSTANTS = {
    "NENTRIES": (
        "(NX * (NX + (2 * NU)))",
        "Entries of Ad (n x n), B_old (n x n_u) and B_new (n x n_u), row after row, one matrix after the "
        "other.",
    ),
    "NHISTORY": ("8", "Largest m of the k-of-m confirmation."),
    "NPOOL": (
        "(6 / NY)",
        "Number of parts of a pool of frames; the newest part grows while the oldest is dropped.",
    ),
    "NSPEEDS": ("3", "Number of equal parts of the scheduling range, each with its own bounds of pools."),
    "NBLOCK": ("4", "Number of samples that a bin processes at once, a power of two."),
    "NPARTS": (
        "(2 - (NDELTA / NY))",
        "Number of pushes for the judgement of a frame: 1 if every output has its own Delta, otherwise 2.",
    ),
    "NLATENCY": (
        "(NBLOCK - 1 + (NBINS / 2) + (NPARTS * NBINS))",
        "Largest number of samples from the end of a frame to its judgement: the block, the pushes that "
        "close several frames, and the queue.",
    ),
}
"""Fixed and computed sizes: C macro LPVG_<name> of coeff.h, with its comment. Divisions are integer
divisions."""


@dataclass(frozen=True)
class Field:
    """A member of a coefficient struct.

    ``shape`` holds expressions of the dimensions; () is a scalar. ``within`` is the interval for every item,
    as "(0, 1]"; its ends are numbers, expressions of dimensions, or scalar fields of the same struct. An
    empty ``within`` allows any finite number.
    """

    name: str
    shape: tuple[str, ...]
    unit: str
    meaning: str
    within: str = ""

    @property
    def declarator(self) -> str:
        """C declarator: the name with its sizes."""
        return self.name + "".join(f"[{macros(size)}]" for size in self.shape)


@dataclass(frozen=True)
class Layout:
    """A coefficient struct: ``lpvg_<stem>_words_t``, ``lpvg_<stem>_reals_t`` and ``lpvg_<struct>_t`` in C.

    ``dimensions`` have the order of words.sizes.
    """

    stem: str
    struct: str
    header: str
    magic: int
    schema: int
    dimensions: tuple[str, ...]
    words: tuple[Field, ...]
    reals: tuple[Field, ...]

    def head(self, sizes: dict[str, int]) -> dict[str, Any]:
        """The words at the beginning of every struct, for ``sizes`` by dimension."""
        return {
            "magic": self.magic,
            "schema": self.schema,
            "real_bytes": 4,
            "sizes": [sizes[name] for name in self.dimensions],
            "crc32": 0,
        }

    def packed(
        self, part: str, values: dict[str, Any], sizes: dict[str, int], where: object
    ) -> dict[str, np.ndarray]:
        """Arrays of "words" or "reals" by field, in the order of the struct, each in the shape of its field.

        ``sizes`` are by dimension. Raises InputError that names ``where`` and the field, if a field is
        missing, unknown, of the wrong shape, not finite or out of its range.
        """
        fields: tuple[Field, ...] = getattr(self, part)
        names = [field.name for field in fields]
        if set(values) != set(names):
            odd = ", ".join(sorted(set(values) ^ set(names)))
            raise InputError(
                where, odd, "missing or unknown", f"the fields of {self.header}: {', '.join(names)}"
            )
        packed = {
            name: np.array(values[name]) if part == "words" else np.array(values[name], float)
            for name in names
        }
        for field in fields:
            value, shape = packed[field.name], tuple(_evaluated(size, sizes) for size in field.shape)
            if value.shape != shape:
                raise InputError(
                    where,
                    field.name,
                    f"shape {value.shape}",
                    f"{shape}, {text_of_shape(field)} of {self.header}",
                )
            if not np.isfinite(value).all():
                raise InputError(where, field.name, "not finite", "finite numbers")
        for field in fields:
            value = packed[field.name]
            if field.within and not _within(value, field.within, sizes, packed):
                raise InputError(where, field.name, f"{value.tolist()}", f"every item within {field.within}")
        return packed

    def sizes_in(self, words: np.ndarray) -> dict[str, int]:
        """Sizes by dimension from flat words (W,)."""
        at = next(
            i for i, field in enumerate(self.words) if field.name == "sizes"
        )  # the fields before it are scalar
        return dict(zip(self.dimensions, map(int, words[at : at + len(self.dimensions)]), strict=False))

    def split(self, part: str, flat: np.ndarray, sizes: dict[str, int]) -> dict[str, np.ndarray]:
        """Views of flat "words" or "reals" by field, each in its shape; a scalar as (1,)."""
        shapes = {
            field.name: tuple(_evaluated(size, sizes) for size in field.shape) or (1,)
            for field in getattr(self, part)
        }
        ends = np.cumsum([math.prod(shape) for shape in shapes.values()])
        assert ends[-1] == len(flat), f"{self.header}: {ends[-1]} items by the layout, {len(flat)} given"
        return {
            name: items.reshape(shape)
            for (name, shape), items in zip(shapes.items(), np.split(flat, ends[:-1]), strict=False)
        }

    @cached_property
    def macro(self) -> str:
        """Prefix of the names of the struct's C macros."""
        return f"LPVG_{self.stem.upper()}"


def head_fields(macro: str, dimensions: tuple[str, ...]) -> tuple[Field, ...]:
    """The words at the beginning of every struct; ``macro`` is the prefix of its macros."""
    return (
        Field("magic", (), "", f"{macro}_MAGIC"),
        Field("schema", (), "", f"{macro}_SCHEMA"),
        Field("real_bytes", (), "", "sizeof(lpvg_real_t)"),
        Field("sizes", (str(len(dimensions)),), "", "LPVG_" + ", ".join(dimensions)),
    )


def macros(expression: str) -> str:
    """An expression of dimensions in C."""
    return re.sub(r"\b([A-Z]+)\b", r"LPVG_\1", expression)


def constant(name: str, sizes: dict[str, int]) -> int:
    """Value of one of CONSTANTS for given sizes."""
    return _evaluated(CONSTANTS[name][0], sizes)


def _evaluated(expression: str, sizes: dict[str, int]) -> int:
    known = dict(sizes)
    for name in CONSTANTS:
        if name in expression:
            known[name] = constant(name, sizes)
    return eval(expression.replace("/", "//"), {"__builtins__": {}}, known)


def ends_of(interval: str) -> tuple[str, bool, str, bool]:
    """Lower end, whether it is included, upper end, whether it is included."""
    low, high = (end.strip() for end in interval[1:-1].split(","))
    return low, interval[0] == "[", high, interval[-1] == "]"


def _within(value: np.ndarray, interval: str, sizes: dict[str, int], packed: dict[str, np.ndarray]) -> bool:
    def number(end: str) -> float:
        return float(packed[end]) if end in packed else math.inf if end == "inf" else _evaluated(end, sizes)

    low, low_in, high, high_in = ends_of(interval)
    above = value >= number(low) if low_in else value > number(low)
    below = value <= number(high) if high_in else value < number(high)
    return bool((above & below).all())


def text_of_shape(field: Field) -> str:
    """Sizes of a field, for people."""
    return " × ".join(field.shape) or "scalar"
