"""The part that an alarm is about, by redundant outputs (THEORY 7.21)."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

from ..base import artefacts
from ..drives.tables import Drive
from ..identify.identification import ISOLATION
from ..identify.isolation import VEHICLE, Changes, Isolation, PartFinding
from ..vehicle.nominal import NominalModel
from ..vehicle.project import Project

NOW = 0.3
"""Share of a fault's usual size (identify/isolation.py) above which the part wants service now."""
SHORTEST = 0.5
"""Share of a window that one before the next alarm, or at the end, must last."""


@dataclass(frozen=True)
class NamedPart:
    """Parts that differ in a window of a drive.

    Attributes
    ----------
    from_s, until_s : float, s from the drive's start, of the window
    alarm_s : float or None, s, of the alarm that began the window
    since_s : float, s, the onset, or the alarm
    parts : tuple of str, one part, or those of which it is one; empty where no single part explains it
    probability : dict[str, float], by part
    what : str, the size of the likeliest part in words
    value, low, high : float or None, that size and its 95 % interval
    unit : str
    service : str or None, "now" or "later"; None without a single part
    says : str, all of it in words, what to check and what to do
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


class PartNamer:
    """Names parts after the alarms of drives.

    Parameters
    ----------
    project : Project, with ``isolation``
    isolation : Isolation
    """

    def __init__(self, project: Project, isolation: Isolation):
        self.project, self.isolation = project, isolation

    @classmethod
    def beside(cls, project: Project, folder: Path) -> PartNamer | None:
        """The namer of a generated folder; None where nothing names parts."""
        path = folder / ISOLATION
        if project.isolation is None or not path.is_file():
            return None
        with artefacts.reading(path):
            return cls(project, Isolation.from_dict(artefacts.read_json(path)))

    @cached_property
    def changes(self) -> Changes:
        """Simulated changes of the parts."""
        return Changes(self.project, NominalModel(self.project))

    def named(
        self, drive: Drive, alarms_s: Sequence[float], onsets_s: Sequence[tuple[float, float]] = ()
    ) -> Iterator[NamedPart]:
        """Parts in successive windows of a drive. An alarm begins a new window.

        ``alarms_s``: times of the alarms after the drive's first sample [s], rising. ``onsets_s``: times of
        alarms and of their onsets.
        """
        alarms = iter(alarms_s)
        start, alarm_s, following = 0.0, None, next(alarms, None)
        while start < drive.duration_s:
            end = min(start + self.isolation.window_s, drive.duration_s)
            if alarm_s is None and following is not None:
                end = min(end, following)
            if alarm_s is not None or end - start > SHORTEST * self.isolation.window_s:
                yield from self._window(drive, start, end, alarm_s, onsets_s)
            while following is not None and following < end:
                following = next(alarms, None)
            alarm_s = following if following == end else None
            start = end

    def _window(
        self,
        drive: Drive,
        start: float,
        end: float,
        alarm_s: float | None,
        onsets_s: Sequence[tuple[float, float]],
    ) -> Iterator[NamedPart]:
        """The part that a window names, if any."""
        evidence = self.isolation.evidence(list(self.changes.blocks(drive, start, end)))
        finding = self.isolation.name(evidence, alarmed=alarm_s is not None)
        if finding.differs:
            since = min((s for a, s in onsets_s if start <= a <= end), default=start)
            values = (
                finding.parts,
                finding.probability,
                finding.what,
                finding.value,
                finding.low,
                finding.high,
            )
            yield NamedPart(
                start, end, alarm_s, since, *values, finding.unit, *self._advice(finding, max(since, 0.0))
            )

    def _advice(self, finding: PartFinding, since_s: float) -> tuple[str | None, str]:
        """When to service, and the line of words."""
        line = f"{finding.words()}, since about {since_s:.0f} s"
        checks = "; ".join(f"check {self._check(part)}" for part in finding.parts)
        if len(finding.parts) != 1 or finding.value is None:
            return None, f"{line}; {checks}" if checks else line
        usual = next(c.fault for c in self.isolation.columns if c.what == finding.what)
        service = "now" if abs(finding.value) > NOW * usual else "later"
        return service, f"{line}; {checks}; service {service}"

    def _check(self, part: str) -> str:
        """Words that say what to check of a part: those of the project file, or the usual ones."""
        settings, project = self.project.isolation, self.project
        assert settings is not None
        if part in settings.check:
            return settings.check[part]
        if part == VEHICLE:
            return "tyres, their pressure, and the load"
        if part == settings.part_of(project.speed.name):
            return "the factor of the speed, and the wheels' size"
        if part in {settings.part_of(s.name) for s in project.inputs}:
            return f"zero, ratio and delay of {part}"
        return f"mounting, wiring and calibration of {part}"
