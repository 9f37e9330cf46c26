"""Find the part that caused an alarm, by redundant outputs (THEORY 7.21)."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

import numpy as np

from ..base import artefacts
from ..base.runs import runs
from ..core.compiled import VERDICTS, is_alarming
from ..drives.tables import Drive
from ..identify.identification import ISOLATION
from ..identify.isolation import Changes, Isolation, PartFinding, to_check
from ..vehicle.nominal import NominalModel
from ..vehicle.project import Project

NOW = 0.3
"""Share of a fault's usual size (identify/isolation.py) above which the part needs service now."""
SHORTEST = 0.5
"""Least length of a shortened window (before the next alarm or at the end), as a share of a full one."""


@dataclass(frozen=True)
class NamedPart:
    """Parts that differ from the model in a window of a drive.

    Attributes
    ----------
    from_s, until_s : float, s from the drive's start, of the window
    alarm_s : float or None, s, of the alarm that began the window
    since_s : float, s, the onset, or the alarm
    parts : tuple of str, the part or the candidates; empty if no single part explains the difference
    probability : dict[str, float], by part
    what : str, description of the size of the likeliest part
    value, low, high : float or None, size of the likeliest part and its 95 % interval
    unit : str
    service : str or None, "now" or "later"; None without a single part
    says : str, the result as text, with what to check and what to do
    """

    from_s: float
    until_s: float
    alarm_s: float | None
    since_s: float
    parts: tuple[str, ...]
    probability: dict[str, float]
    what: str
    value: float | None
    low: float | None
    high: float | None
    unit: str
    service: str | None
    says: str


def alarms_begin(verdict: np.ndarray, alarming: bool = False) -> tuple[np.ndarray, bool]:
    """Mark the samples with which the core's verdict begins to alarm; samples without a verdict are left out.

    ``verdict`` (N,) holds codes of monitor.h. ``alarming`` tells whether it alarmed before; the second
    result, after the last sample.
    """
    judged = ~np.isin(verdict, [VERDICTS.index(word) for word in ("stale", "fault")])
    state, begin = np.r_[alarming, is_alarming(verdict[judged])], np.zeros(len(verdict), bool)
    begin[judged] = state[1:] & ~state[:-1]
    return begin, bool(state[-1])


class PartNamer:
    """Names parts after the alarms of drives, for a project with ``isolation``."""

    def __init__(self, project: Project, isolation: Isolation):
        self.project, self.isolation = project, isolation

    @classmethod
    def beside(cls, project: Project, folder: Path) -> PartNamer | None:
        """Load the PartNamer of a generated folder; None if the vehicle has no isolation."""
        path = folder / ISOLATION
        if project.isolation is None or not path.is_file():
            return None
        with artefacts.reading(path):
            return cls(project, Isolation.from_dict(artefacts.read_json(path)))

    @cached_property
    def changes(self) -> Changes:
        """Simulated changes (faults) of the parts."""
        return Changes(self.project, NominalModel(self.project))

    def named(
        self, drive: Drive, alarms_s: Sequence[float], onsets_s: Sequence[tuple[float, float]] = ()
    ) -> Iterator[NamedPart]:
        """Yield the parts in successive windows of a drive. Each alarm begins a new window.

        ``alarms_s``: increasing times of the alarms after the drive's first sample [s]. ``onsets_s``: pairs
        of the time of an alarm and the time of its onset.
        """
        start, alarm_s = 0.0, None
        while start < drive.duration_s:
            end = min(self.end(start, alarm_s, alarms_s), drive.duration_s)
            yield from self.window(drive, start, end, alarm_s, onsets_s)
            start, alarm_s = end, end if end in alarms_s else None

    def end(self, start: float, alarm_s: float | None, alarms_s: Sequence[float]) -> float:
        """End [s] of the window that begins at ``start``, with or without an alarm."""
        end = start + self.isolation.window_s
        return min((a for a in alarms_s if start < a < end and alarm_s is None), default=end)

    def window(
        self,
        drive: Drive,
        start: float,
        end: float,
        alarm_s: float | None,
        onsets_s: Sequence[tuple[float, float]],
        clock_s: float = 0.0,
    ) -> Iterator[NamedPart]:
        """Yield the part that differs in a window of a drive, if any.

        ``start`` and ``end`` count from the drive's first sample. ``alarm_s`` is the alarm that began the
        window. ``onsets_s`` holds the times of alarms and of their onsets. ``clock_s`` is added to the times
        of the result. All are in s.
        """
        if alarm_s is None and end - start <= SHORTEST * self.isolation.window_s:
            return
        evidence = self.isolation.evidence(list(self.changes.blocks(drive, start, end)))
        finding = self.isolation.name(evidence, alarmed=alarm_s is not None)
        if finding.differs:
            since = clock_s + min((s for a, s in onsets_s if start <= a <= end), default=start)
            values = (
                finding.parts,
                finding.probability,
                finding.what,
                finding.value,
                finding.low,
                finding.high,
            )
            alarm = None if alarm_s is None else clock_s + alarm_s
            yield NamedPart(
                clock_s + start,
                clock_s + end,
                alarm,
                since,
                *values,
                finding.unit,
                *self._advice(finding, max(since, 0.0)),
            )

    def _advice(self, finding: PartFinding, since_s: float) -> tuple[str | None, str]:
        """When to service the part, and the text of the result."""
        line = f"{finding.words()}, since about {since_s:.0f} s"
        checks = "; ".join(f"check {to_check(self.project, part)}" for part in finding.parts)
        if len(finding.parts) != 1 or finding.value is None:
            return None, f"{line}; {checks}" if checks else line
        usual = next(c.fault for c in self.isolation.columns if c.what == finding.what)
        service = "now" if abs(finding.value) > NOW * usual else "later"
        return service, f"{line}; {checks}; service {service}"


class RunningParts:
    """Names parts in the windows of a drive that arrives in pieces.

    Parameters
    ----------
    namer : PartNamer
    """

    def __init__(self, namer: PartNamer):
        self._namer, self._rows = namer, np.empty((0, 0))
        self._start: float | None = None
        self._alarm_s: float | None = None
        self._alarming = False
        self._alarms: list[float] = []
        self._onsets: list[tuple[float, float]] = []

    def take(
        self, piece: Drive, verdict: np.ndarray, onsets_s: Sequence[tuple[float, float]]
    ) -> Iterator[NamedPart]:
        """Parts of the windows that end in a piece.

        ``verdict``: codes of the core (N,). ``onsets_s``: times on the piece's clock, as in `named`.
        """
        missing = np.zeros(len(piece.t), bool) if piece.missing is None else piece.missing
        rows = np.column_stack([piece.t, missing, piece.v, piece.u, piece.y])
        self._rows = np.vstack([self._rows.reshape(-1, rows.shape[1]), rows])
        begin, self._alarming = alarms_begin(verdict, self._alarming)
        self._alarms += piece.t[begin].tolist()
        self._onsets += onsets_s
        if self._start is None:
            self._start = float(piece.t[0])
        changes = self._namer.changes
        newest = self._rows[-1, 0] - changes.ahead * changes.project.Ts_s
        while (end := self._namer.end(self._start, self._alarm_s, self._alarms)) <= newest:
            yield from self._window(self._start, end)
            self._alarm_s = end if end in self._alarms else None
            self._start = end
            self._alarms = [a for a in self._alarms if a > end]
            self._onsets = [o for o in self._onsets if o[0] >= end]

    def _window(self, start: float, end: float) -> Iterator[NamedPart]:
        """Yield the part that a window names, and drop the rows before its warm-up."""
        changes, n_u = self._namer.changes, self._namer.project.n_u
        warm_up = start - (changes.estimator.settle + changes.ahead) * changes.project.Ts_s
        cut = int(np.searchsorted(self._rows[:, 0], warm_up))
        # Blocks are counted from the first sample, and again from the first sample after a gap.
        begun = next((a for a, b in runs(self._rows[:, 1] == 0) if a <= cut < b), cut)
        self._rows = self._rows[begun + max(0, (cut - begun) // changes.step - 1) * changes.step :]
        t, missing, v = self._rows[:, :3].T
        u, y = self._rows[:, 3 : 3 + n_u], self._rows[:, 3 + n_u :]
        drive, t0 = Drive("live", t, v, u, y, missing=missing > 0), float(t[0])
        alarm_s = None if self._alarm_s is None else self._alarm_s - t0
        onsets = [(a - t0, s - t0) for a, s in self._onsets]
        return self._namer.window(drive, start - t0, end - t0, alarm_s, onsets, clock_s=t0)
