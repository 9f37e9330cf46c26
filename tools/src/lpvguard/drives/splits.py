"""Which recordings set the bounds, and which calibrate: both halves have all speeds, days and surfaces."""

import re
from collections.abc import Iterable, Mapping
from datetime import UTC, datetime

import numpy as np

from ..base.rates import recordings_for
from .tables import day_of

EPOCH_S = 9.0e8
"""Later times [s] count from 1970, and tell the day."""
SURFACE = re.compile(
    r"(?<![a-z])(wet|dry|snow|ice|icy|gravel|rain|nass|trocken|schnee|eis|schotter|regen)(?![a-z])"
)
"""In names of recordings: the surface."""
DRIVER = re.compile(
    r"(?<![a-z])(?:driver|fahrer|pilot|conducteur|operator)[ _=-]*([a-z]+|\d+)", re.IGNORECASE
)
"""In names of recordings: the driver."""
FASTER = 1.1
"""A recording that calibrates at so many times the mean speed of all that set the bounds is beyond them."""
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


def groups_of(days: Mapping[str, str]) -> dict[str, str]:
    """Propose a group for each recording: its day and driver, as far as they are known.

    Parameters
    ----------
    days : Mapping, day by recording, empty where nothing tells it

    Returns
    -------
    dict[str, str], by recording; empty where some recording has none, or groups would tell nothing

    Examples
    --------
    >>> groups_of({"a_driver_Kim": "2026-04-22", "b_driver_Kim": "2026-04-22", "c": "2026-04-23"})
    {'a_driver_Kim': '2026-04-22 Kim', 'b_driver_Kim': '2026-04-22 Kim', 'c': '2026-04-23'}
    """
    drivers = {r: driver[1] if (driver := DRIVER.search(r)) else "" for r in days}
    groups = {r: f"{day} {drivers[r]}".strip() for r, day in days.items()}
    return groups if all(groups.values()) and 1 < len(set(groups.values())) < len(groups) else {}


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


def split_notes(splits: Mapping[str, str], names: Mapping[str, str], days: Mapping[str, str]) -> list[str]:
    """Say which half is how large, by what the recordings were parted, and which groups there are.

    Parameters
    ----------
    splits : Mapping, train or valid by drive
    names : Mapping, recording by drive
    days : Mapping, day by recording

    Returns
    -------
    list of str
    """
    setting = sum(split == "train" for split in splits.values())
    recordings = sorted(set(names.values()))
    parted = _parted_by(recordings, days, named=True)
    notes = [f"{setting} drives set the bounds, {len(splits) - setting} calibrate, parted by {parted}"]
    if groups := groups_of({r: days.get(r, "") for r in recordings}):
        notes.append(f"groups, each left out in turn: {', '.join(sorted(set(groups.values())))}")
    return notes


def split_advice(
    halves: Mapping[str, bool], speeds: Mapping[str, np.ndarray], groups: Mapping[str, str]
) -> str:
    """Say what only one half of the recordings has, and propose another split.

    Parameters
    ----------
    halves : Mapping, whether it sets the bounds, by recording
    speeds : Mapping, speed (N,) by recording, m/s
    groups : Mapping, group or day by recording, empty where nothing tells it

    Returns
    -------
    str, empty where both halves have all

    Examples
    --------
    >>> speeds = {name: np.array([v]) for name, v in (("a", 9.0), ("b", 10.0), ("c", 20.0), ("d", 21.0))}
    >>> split_advice({"a": True, "b": True, "c": False, "d": False}, speeds, {})
    'c, d calibrate at higher speeds than all that set the bounds; by speed: a, c train, b, d valid'
    """
    setting = [r for r in halves if halves[r]]
    top = FASTER * max((float(speeds[r].mean()) for r in setting), default=0.0)
    beyond = [r for r in halves if not halves[r] and float(speeds[r].mean()) > top]
    lacking = (
        [f"{', '.join(beyond)} calibrate at higher speeds than all that set the bounds"] if beyond else []
    )
    for what, kind_of in (("group or day", groups.get), ("surface", _surface)):
        for kind in sorted({k for r in halves if (k := kind_of(r))}):
            mine = [halves[r] for r in halves if kind_of(r) == kind]
            if len(mine) > 1 and len(set(mine)) == 1:
                lacking.append(f"{what} {kind} only {'sets the bounds' if mine[0] else 'calibrates'}")
    proposed = splits_of(speeds, {r: r for r in halves}, groups)
    if not lacking or {r: split == "train" for r, split in proposed.items()} == dict(halves):
        return ""
    return f"{'; '.join(lacking)}; {proposal_words(proposed, groups)}"


def proposal_words(splits: Mapping[str, str], groups: Mapping[str, str]) -> str:
    """Word a proposed split.

    Parameters
    ----------
    splits : Mapping, train or valid by recording
    groups : Mapping, group or day by recording, empty where nothing tells it

    Returns
    -------
    str
    """
    halves = [
        f"{', '.join(r for r, split in splits.items() if split == half)} {half}"
        for half in ("train", "valid")
    ]
    return f"by {_parted_by(splits, groups)}: {', '.join(halves)}"


def _parted_by(recordings: Iterable[str], days: Mapping[str, str], named: bool = False) -> str:
    """Name what parts recordings, speed and what differs among them; with ``named``, also its values."""
    recordings, by = list(recordings), ["speed"]
    for what, kind_of in (("day", days.get), ("surface", _surface)):
        kinds = sorted({kind for r in recordings if (kind := kind_of(r))})
        if len(kinds) > 1:
            by.append(f"{what} ({', '.join(kinds)})" if named else what)
    return " and ".join(by)


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
