"""Plant faults of every sensor in measured drives that did not set the scales."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np

from ...drives.tables import Drive
from ...identify.isolation import (
    VEHICLE,
    Changes,
    Isolation,
    PartColumn,
    WindowSums,
    columns_of,
    evidence_windows,
    moments_of,
)
from ...vehicle.project import Project

SIZES = {"gain": -0.4, "delay": 0.3, "bias": 1.0, "offset": 1.0, "factor": 0.2}
"""Sizes of the planted faults: a delay in s; a bias or an offset in standard deviations of the signal."""


@dataclass(frozen=True)
class Planted:
    """Fault of a part: its column, and its size in the column's unit."""

    column: PartColumn
    size: float

    @property
    def label(self) -> str:
        """Name of the fault."""
        return f"{self.column.what} {self.size:+.3g} {self.column.unit}".strip()

    def within(self, changes: Changes, drive: Drive) -> Drive:
        """Make the drive that would be measured with the fault during the whole drive."""
        kind, place, project = self.column.kind, self.column.place, changes.project
        if kind == "factor":
            settings = project.isolation
            assert settings is not None
            powers = np.array([settings.speed_power.get(s.name, 0) for s in project.outputs])
            return replace(drive, v=drive.v * (1 + self.size), y=drive.y * (1 + self.size) ** powers)
        is_output = self.column.what.split(" ")[0] in {s.name for s in project.outputs}
        signals = (drive.y if is_output else drive.u).copy()
        x = signals[:, place]
        if kind == "delay":
            lag = min(len(x) - 1, round(self.size / project.Ts_s))
            signals[:, place] = np.r_[np.repeat(x[:1], lag), x[: len(x) - lag]]
        else:
            signals[:, place] = x * (1 + self.size) if kind == "gain" else x + self.size
        return replace(drive, y=signals) if is_output else replace(drive, u=signals)


def planted(project: Project, spread_u: np.ndarray, spread_y: np.ndarray, factor: float) -> list[Planted]:
    """List the faults of every sensor and size.

    ``spread_u`` and ``spread_y`` are the standard deviations of the signals. ``factor`` multiplies all sizes.
    """
    names = [s.name for s in (*project.inputs, *project.outputs)]
    scale = dict(zip(names, np.r_[spread_u, spread_y].tolist(), strict=True))
    columns = {c.what: c for c in columns_of(project, spread_u, spread_y) if c.part != VEHICLE}.values()
    unit = {c.what: scale[c.what.split(" ")[0]] for c in columns if c.kind in ("bias", "offset")}
    return [Planted(c, factor * SIZES[c.kind] * unit.get(c.what, 1.0)) for c in columns]


def pieces_of(changes: Changes, drives: Sequence[Drive], window_s: float) -> list[tuple[str, Drive]]:
    """Divide drives into named pieces that each hold a window.

    Pieces of the same name are held out together. With several drives, all pieces of a drive have the same
    name. With a single drive, each piece has its own name.
    """
    Ts = changes.project.Ts_s
    unused = max(changes.estimator.settle, changes.ahead) + changes.ahead + changes.step
    length = round(window_s / Ts) + unused
    pieces = []
    for d in drives:
        for k in range(len(d.t) // length):
            at = slice(k * length, (k + 1) * length)
            missing = None if d.missing is None else d.missing[at]
            piece = Drive(f"{d.name}_{k}", d.t[at], d.v[at], d.u[at], d.y[at], missing=missing)
            pieces.append((d.name if len(drives) > 1 else piece.name, piece))
    return [(name, piece) for name, piece in pieces if list(changes.blocks(piece))]


def held_out(
    changes: Changes, pieces: Sequence[tuple[str, Drive]], window_s: float
) -> Iterator[tuple[Isolation, list[Drive]]]:
    """Yield, for each name, the scales from all other pieces, and the pieces of this name."""
    names = list(dict.fromkeys(n for n, _ in pieces))
    for name in names:
        moments = [moments_of(changes, piece) for n, piece in pieces if n != name]
        begun = Isolation.begun(changes, moments, window_s)
        windows: dict[str, list[WindowSums]] = {n: [] for n in names if n != name}
        for n, piece in pieces:
            if n != name:
                windows[n] += evidence_windows(changes, begun, piece)
        yield begun.finished(list(windows.values())), [piece for n, piece in pieces if n == name]
