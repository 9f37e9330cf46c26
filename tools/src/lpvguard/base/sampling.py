"""Samples of bounded size from streams of frames: the same rows whatever the number of workers and the order
of the drives.

A row is kept when it is among the first ``cap`` of its group in the order of a key. The key depends on the
row alone: a quantity, or a hash of the drive's name and the row's number. Selecting is therefore associative
and commutative: the sample of two parts is that of both their samples. A hash as key makes it a uniform draw
without replacement.
"""

from __future__ import annotations

import zlib
from collections.abc import Iterable

import numpy as np

Rows = dict[str, np.ndarray]
"""Columns of equal length (first axis), among them ``group`` (whole numbers) and ``hash``."""


def row_hash(name: str, *numbers: np.ndarray) -> np.ndarray:
    """64-bit hash (F,) of a drive's name and whole numbers (F,) of a row; rounds of splitmix64."""
    state = np.full(len(numbers[0]), zlib.crc32(name.encode()), np.uint64)
    for number in numbers:
        z = (state ^ np.asarray(number).astype(np.uint64)) + np.uint64(0x9E3779B97F4A7C15)
        z = (z ^ (z >> np.uint64(30))) * np.uint64(0xBF58476D1CE4E5B9)
        z = (z ^ (z >> np.uint64(27))) * np.uint64(0x94D049BB133111EB)
        state = z ^ (z >> np.uint64(31))
    return state


def first_of_each(rows: Rows, cap: int, *keys: str) -> Rows:
    """The first ``cap`` rows of each group by ascending ``keys``, then ``hash``; sorted so."""
    order = np.lexsort((rows["hash"], *(rows[k] for k in reversed(keys)), rows["group"]))
    if not len(order):
        return rows
    group = rows["group"][order]
    begin = np.r_[0, np.flatnonzero(np.diff(group)) + 1]
    rank = np.arange(len(group)) - np.repeat(begin, np.diff(np.r_[begin, len(group)]))
    kept = order[rank < cap]
    return {name: column[kept] for name, column in rows.items()}


def stacked(parts: Iterable[Rows]) -> Rows:
    """All rows of the parts, which have the same columns."""
    parts = list(parts)
    return {name: np.concatenate([p[name] for p in parts]) for name in parts[0]}


def evenly(n: int, count: int) -> np.ndarray:
    """Of the indices 0..n - 1 an array of shape (count,), evenly apart, ends included, ascending; all (n,)
    where there are fewer."""
    return np.unique(np.linspace(0, n - 1, count).round().astype(int))
