"""Which recordings set the bounds, and which calibrate: both halves have all speeds, days and surfaces."""

import re
from collections.abc import Mapping
from datetime import UTC, datetime

import numpy as np

from ..base.rates import recordings_for
from ..drives.tables import day_of

EPOCH_S = 9.0e8
"""Later times [s] count from 1970, and tell the day."""
SURFACE = re.compile(
    r"(?<![a-z])(wet|dry|snow|ice|icy|gravel|rain|nass|trocken|schnee|eis|schotter|regen)(?![a-z])"
)
"""In names of recordings: the surface."""
CALIBRATING, LEAST_SETTING = recordings_for(0.1), 5
"""So many calibrating recordings allow alpha 0.1; so many at least set the bounds."""


def day(name: str, start_s: float) -> str:
    """Find the day of a log, by its name, or by times since 1970.

    Parameters
    ----------
    name : str, of the file
    start_s : float, s, its first time

    Returns
    -------
    str, as 2026-04-22; empty where nothing tells it

    Examples
    --------
    >>> day("run_7.csv", 1.7e9), day("run_7.csv", 3.0)
    ('2023-11-14', '')
    """
    since_1970 = datetime.fromtimestamp(start_s, UTC).date().isoformat() if start_s > EPOCH_S else ""
    return day_of(name) or since_1970


def splits_of(
    speeds: Mapping[str, np.ndarray], names: Mapping[str, str], days: Mapping[str, str]
) -> dict[str, str]:
    """Propose train or valid for each drive: every second recording, by mean speed, sets the bounds.

    Where the half that calibrates is short of CALIBRATING recordings, it gets as many if LEAST_SETTING remain
    for the bounds. A day or surface that one half has alone gives a recording for one of the same speed. A
    single recording is split by its drives.

    Parameters
    ----------
    speeds : Mapping, speed (N,) by drive, m/s
    names : Mapping, recording by drive
    days : Mapping, day by recording

    Returns
    -------
    dict[str, str], by drive
    """
    by = dict(names) if len(set(names.values())) > 1 else {n: n for n in names}
    means = {
        r: float(np.concatenate([v for n, v in speeds.items() if by[n] == r]).mean())
        for r in set(by.values())
    }
    order = sorted(means, key=lambda r: (means[r], r))
    setting = set(order[::2])
    if len(order) // 2 < CALIBRATING <= len(order) - LEAST_SETTING:
        picked = np.linspace(0, len(order) - 1, len(order) - CALIBRATING).round().astype(int)
        setting = {order[k] for k in picked}
    setting = _with_each_in_both(order, setting, {r: (_surface(r), days.get(r, "")) for r in order})
    return {n: "train" if by[n] in setting else "valid" for n in names}


def split_words(splits: Mapping[str, str], names: Mapping[str, str], days: Mapping[str, str]) -> str:
    """Say which half is how large, and by what the recordings were parted.

    Parameters
    ----------
    splits : Mapping, train or valid by drive
    names : Mapping, recording by drive
    days : Mapping, day by recording

    Returns
    -------
    str
    """
    setting = sum(split == "train" for split in splits.values())
    by = ["speed"]
    for what, kind_of in (("day", days.get), ("surface", _surface)):
        if kinds := sorted({kind for r in set(names.values()) if (kind := kind_of(r))}):
            by.append(f"{what} ({', '.join(kinds)})")
    parted = " and ".join(by)
    return f"{setting} drives set the bounds, {len(splits) - setting} calibrate, parted by {parted}"


def _surface(recording: str) -> str:
    """Surface that a recording's name tells; empty without one."""
    surface = SURFACE.search(recording.lower())
    return surface[1] if surface else ""


def _with_each_in_both(order: list[str], setting: set[str], kinds: Mapping[str, tuple[str, str]]) -> set[str]:
    """Recordings that set the bounds, so that every kind with two recordings or more is in both halves.

    ``order`` is that of speed; ``kinds`` holds surface and day by recording.
    """
    halves = {r: r in setting for r in order}

    def alone(kind: tuple[str, str], half: bool) -> int:
        return sum(kinds[r] == kind and halves[r] == half for r in order)

    for kind in sorted(set(kinds.values())):
        mine = [r for r in order if kinds[r] == kind]
        if len(mine) < 2 or 0 < alone(kind, True) < len(mine):
            continue
        middle = mine[len(mine) // 2]
        half = halves[middle]
        others = [r for r in order if halves[r] != half and alone(kinds[r], not half) > 1]
        if others:
            taken = min(others, key=lambda r: (abs(order.index(r) - order.index(middle)), r))
            halves[middle], halves[taken] = not half, half
    return {r for r in order if halves[r]}
