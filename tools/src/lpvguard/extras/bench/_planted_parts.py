"""Faults of every sensor, planted in measured drives that the scales have not seen."""

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
"""Planted sizes: of a delay in s, of bias and offset in standard deviations of the signal."""


@dataclass(frozen=True)
class Planted:
    """A fault of a part: its column, and the size in the column's unit."""

    column: PartColumn
    size: float

    @property
    def label(self) -> str:
        """Name of the fault."""
        return f"{self.column.what} {self.size:+.3g} {self.column.unit}".strip()

    def within(self, changes: Changes, drive: Drive) -> Drive:
        """The drive as it would be measured with the fault from its beginning on."""
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
    """A fault for every size of a sensor; ``spread_u``, ``spread_y``: standard deviations of the signals.
    ``factor``: of all sizes."""
    names = [s.name for s in (*project.inputs, *project.outputs)]
    scale = dict(zip(names, np.r_[spread_u, spread_y].tolist(), strict=True))
    columns = {c.what: c for c in columns_of(project, spread_u, spread_y) if c.part != VEHICLE}.values()
    unit = {c.what: scale[c.what.split(" ")[0]] for c in columns if c.kind in ("bias", "offset")}
    return [Planted(c, factor * SIZES[c.kind] * unit.get(c.what, 1.0)) for c in columns]


def pieces_of(changes: Changes, drives: Sequence[Drive], window_s: float) -> list[tuple[str, Drive]]:
    """Pieces of drives that each hold a window, with a name. Pieces of one name are held out together: those
    of a drive, or each piece of a single drive."""
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
    """Scales from all pieces but those of a name, and these pieces."""
    names = list(dict.fromkeys(n for n, _ in pieces))
    for name in names:
        moments = [moments_of(changes, piece) for n, piece in pieces if n != name]
        begun = Isolation.begun(changes, moments, window_s)
        windows: dict[str, list[WindowSums]] = {n: [] for n in names if n != name}
        for n, piece in pieces:
            if n != name:
                windows[n] += evidence_windows(changes, begun, piece)
        yield begun.finished(list(windows.values())), [piece for n, piece in pieces if n == name]
