"""Samples of bounded size from streams of frames, independent of the number of workers and the order of
drives.

A row is kept when it is among the first ``cap`` of its group in the order of a key. The key depends on the
row alone: a quantity, or a hash of the drive's name and the row's number. Selection is therefore associative
and commutative. A hash as key makes it a uniform draw without replacement.
"""

import zlib
from collections.abc import Iterable

import numpy as np

Rows = dict[str, np.ndarray]
"""Columns of equal length (first axis), with ``group`` (whole numbers) and ``hash`` among them."""


def row_hash(name: str, *numbers: np.ndarray) -> np.ndarray:
    """Hash a drive's name and whole numbers of each row by rounds of splitmix64.

    Parameters
    ----------
    name : str, the drive
    *numbers : ndarray (F,) of int

    Returns
    -------
    ndarray (F,) of uint64
    """
    state = np.full(len(numbers[0]), zlib.crc32(name.encode()), np.uint64)
    for number in numbers:
        z = (state ^ np.asarray(number).astype(np.uint64)) + np.uint64(0x9E3779B97F4A7C15)
        z = (z ^ (z >> np.uint64(30))) * np.uint64(0xBF58476D1CE4E5B9)
        z = (z ^ (z >> np.uint64(27))) * np.uint64(0x94D049BB133111EB)
        state = z ^ (z >> np.uint64(31))
    return state


def first_of_each(rows: Rows, cap: int, *keys: str) -> Rows:
    """Select the first ``cap`` rows of each group.

    Parameters
    ----------
    rows : Rows
    cap : int
    *keys : str, columns to sort by, ascending; ``hash`` decides ties

    Returns
    -------
    Rows, sorted so
    """
    order = np.lexsort((rows["hash"], *(rows[k] for k in reversed(keys)), rows["group"]))
    if not len(order):
        return rows
    group = rows["group"][order]
    begin = np.r_[0, np.flatnonzero(np.diff(group)) + 1]
    rank = np.arange(len(group)) - np.repeat(begin, np.diff(np.r_[begin, len(group)]))
    kept = order[rank < cap]
    return {name: column[kept] for name, column in rows.items()}


def largest_of_each(rows: Rows, size: np.ndarray) -> Rows:
    """Select the row of the largest size in each group.

    Parameters
    ----------
    rows : Rows
    size : ndarray (F,)

    Returns
    -------
    Rows
    """
    best = first_of_each(rows | {"smallness": -size}, 1, "smallness")
    return {name: column for name, column in best.items() if name != "smallness"}


def stacked(parts: Iterable[Rows]) -> Rows:
    """Stack the rows of parts that have the same columns.

    Parameters
    ----------
    parts : Iterable[Rows]

    Returns
    -------
    Rows
    """
    parts = list(parts)
    return {name: np.concatenate([p[name] for p in parts]) for name in parts[0]}


def evenly(n: int, count: int) -> np.ndarray:
    """Choose evenly spaced indices of 0..n - 1, both ends included.

    Parameters
    ----------
    n : int
    count : int, at most so many

    Returns
    -------
    ndarray (count,) or (n,) of int, ascending
    """
    return np.unique(np.linspace(0, n - 1, count).round().astype(int))
