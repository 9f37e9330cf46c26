"""Which recordings set the bounds, and which calibrate: both halves have all surfaces, days and speeds."""

from __future__ import annotations

import re
from collections.abc import Mapping
from datetime import UTC, datetime

import numpy as np

from ..drives.tables import day_of

EPOCH_S = 9.0e8
"""Later times [s] count from 1970, and tell the day."""
SURFACE = re.compile(
    r"(?<![a-z])(wet|dry|snow|ice|icy|gravel|rain|nass|trocken|schnee|eis|schotter|regen)(?![a-z])"
)
"""In names of recordings: the surface."""
CALIBRATING, LEAST_SETTING = 9, 5
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
    """Propose train or valid for each drive: every second recording in the order of surface, day and speed.

    Where the half that calibrates is short of CALIBRATING recordings, it gets as many if LEAST_SETTING remain
    for the bounds. A single recording is split by its drives.

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

    def place(recording: str) -> tuple[str, str, float, str]:
        surface = SURFACE.search(recording.lower())
        mean = float(np.concatenate([v for n, v in speeds.items() if by[n] == recording]).mean())
        return surface[1] if surface else "", days.get(recording, ""), mean, recording

    order = sorted(set(by.values()), key=place)
    setting = set(order[::2])
    if len(order) // 2 < CALIBRATING <= len(order) - LEAST_SETTING:
        picked = np.linspace(0, len(order) - 1, len(order) - CALIBRATING).round().astype(int)
        setting = {order[k] for k in picked}
    return {n: "train" if by[n] in setting else "valid" for n in names}
