"""Classify each cell of speed and frequency as proved, blind, without data or violated (THEORY 7.4)."""

from collections.abc import Callable, Iterable
from dataclasses import dataclass

import numpy as np

from ..replay.replayer import Alarm

LEVEL = 0.3
"""Gain error [-] for which the first screen classifies the cells."""
PROVED, BLIND, EMPTY, VIOLATED = "proved", "blind", "no_data", "violated"


@dataclass(frozen=True)
class MapCell:
    """A cell of the map: a speed cell and a bin.

    Attributes
    ----------
    speed_mps : tuple[float, float], m/s
    bin : int
    omega : float, rad/s, 0 at DC
    frames : int, counted frames
    gain_error : float or None, smallest gain error that a test sees, at the percentile's excitation
    strongest : float or None, smallest visible gain error at the strongest excitation
    limit : float or None, limit of detection for a test that knows the form of the error (THEORY 7.19)
    floor : float, smallest gain error that a frame of any excitation shows
    alarms : int, number of alarms of the frame test
    """

    speed_mps: tuple[float, float]
    bin: int
    omega: float
    frames: int
    gain_error: float | None
    strongest: float | None
    limit: float | None
    floor: float
    alarms: int

    @property
    def state(self) -> str:
        """State of the cell.

        PROVED means that there was no alarm although a gain error of LEVEL would have caused one. BLIND means
        that a gain error of LEVEL could stay unseen.
        """
        if self.alarms:
            return VIOLATED
        if self.gain_error is None:
            return EMPTY
        return PROVED if self.gain_error <= LEVEL else BLIND


def cells(seen: dict, alarms: Iterable[Alarm]) -> list[list[MapCell]]:
    """Make the cells by speed, slowest first, and by bin.

    Parameters
    ----------
    seen : dict, visibility.json
    alarms : Iterable of Alarm, of all drives

    Returns
    -------
    list of list of MapCell

    References
    ----------
    THEORY 7.4.
    """
    omega = np.array(seen["omega_rad_s"])
    typical, strongest = seen["at_percentile"], seen["at_strongest"]
    count = np.zeros((len(typical), len(omega)), int)
    for a in alarms:
        if a.bin_rad_s is not None:
            count[speed_row(seen, a.speed_mps), int(np.argmin(np.abs(omega - a.bin_rad_s)))] += 1
    return [
        [
            MapCell(
                (c["speed_mps"][0], c["speed_mps"][1]),
                k,
                float(w),
                c["frames"][k],
                c["gain_error"][k],
                s["gain_error"][k],
                c["limit"][k] if "limit" in c else None,  # older identifications have no limit
                seen["gain_error_floor"][k],
                int(count[row, k]),
            )
            for k, w in enumerate(omega)
        ]
        for row, (c, s) in enumerate(zip(typical, strongest, strict=True))
    ]


def speed_row(seen: dict, speed_mps: float) -> int:
    """Index of the speed cell of visibility.json ``seen`` that holds the speed [m/s] or is nearest to it."""
    starts = [c["speed_mps"][0] for c in seen["at_percentile"]]
    return int(np.clip(np.searchsorted(starts, speed_mps, side="right") - 1, 0, len(starts) - 1))


@dataclass(frozen=True)
class Region:
    """Range of speeds [m/s] with the same chosen runs of bins; a run is its first and last cell."""

    speed_mps: tuple[float, float]
    runs: tuple[tuple[MapCell, MapCell], ...]


def regions(grid: list[list[MapCell]], chosen: Callable[[MapCell], bool]) -> list[Region]:
    """Combine the chosen cells into few regions: neighbouring speed cells with the same bins are joined."""
    joined: list[Region] = []
    for row in grid:
        runs: list[tuple[MapCell, MapCell]] = []
        for cell in row:
            if not chosen(cell):
                continue
            if runs and runs[-1][1].bin == cell.bin - 1:
                runs[-1] = (runs[-1][0], cell)
            else:
                runs.append((cell, cell))
        if not runs:
            continue
        low, high = row[0].speed_mps
        before = joined[-1] if joined else None
        if before and before.speed_mps[1] == low and _bins(before.runs) == _bins(runs):
            joined[-1] = Region((before.speed_mps[0], high), before.runs)
        else:
            joined.append(Region((low, high), tuple(runs)))
    return joined


def _bins(runs: Iterable[tuple[MapCell, MapCell]]) -> list[tuple[int, int]]:
    return [(a.bin, b.bin) for a, b in runs]
