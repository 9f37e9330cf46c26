"""What the model was tested for and what it is blind to, by speed and frequency: proved, blind, without data
or violated (THEORY 7.4)."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass

import numpy as np

from ..replay.replayer import Alarm

LEVEL = 0.3
"""Gain error that the first screen asks about."""
PROVED, BLIND, EMPTY, VIOLATED = "proved", "blind", "no_data", "violated"


@dataclass(frozen=True)
class MapCell:
    """A speed cell [m/s] and a bin ``omega`` [rad/s], 0 at DC.

    ``frames``: counted. Smallest gain error that the frame test sees: ``gain_error`` at the excitation that
    the percentile of visibility.json reached, ``strongest`` at the strongest frame, ``floor`` at any
    excitation; None without a frame. ``alarms``: of the frame test.
    """

    speed_mps: tuple[float, float]
    bin: int
    omega: float
    frames: int
    gain_error: float | None
    strongest: float | None
    floor: float
    alarms: int

    @property
    def state(self) -> str:
        """PROVED: judged without an alarm, and a gain error of LEVEL alone would have been one. BLIND: it
        could stay unseen."""
        if self.alarms:
            return VIOLATED
        if self.gain_error is None:
            return EMPTY
        return PROVED if self.gain_error <= LEVEL else BLIND


def cells(seen: dict, alarms: Iterable[Alarm]) -> list[list[MapCell]]:
    """Cells by speed, slowest first, and by bin. ``seen``: visibility.json; ``alarms``: of all drives."""
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
                seen["gain_error_floor"][k],
                int(count[row, k]),
            )
            for k, w in enumerate(omega)
        ]
        for row, (c, s) in enumerate(zip(typical, strongest, strict=True))
    ]


def speed_row(seen: dict, speed_mps: float) -> int:
    """The speed cell of visibility.json ``seen`` that holds the speed [m/s]; the nearest one beyond."""
    starts = [c["speed_mps"][0] for c in seen["at_percentile"]]
    return int(np.clip(np.searchsorted(starts, speed_mps, side="right") - 1, 0, len(starts) - 1))


@dataclass(frozen=True)
class Region:
    """Speeds [m/s] at which the same runs of bins, first and last, were chosen."""

    speed_mps: tuple[float, float]
    runs: tuple[tuple[MapCell, MapCell], ...]


def regions(grid: list[list[MapCell]], chosen: Callable[[MapCell], bool]) -> list[Region]:
    """The chosen cells as few regions: runs of bins of each speed cell, neighbours with the same runs
    joined."""
    found: list[Region] = []
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
        before = found[-1] if found else None
        if before and before.speed_mps[1] == low and _bins(before.runs) == _bins(runs):
            found[-1] = Region((before.speed_mps[0], high), before.runs)
        else:
            found.append(Region((low, high), tuple(runs)))
    return found


def _bins(runs: Iterable[tuple[MapCell, MapCell]]) -> list[tuple[int, int]]:
    return [(a.bin, b.bin) for a, b in runs]
