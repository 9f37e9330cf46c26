"""Inject faults into drives and decide whether a detector found them in time.

**Faults** are those of an Injection, in three ways:

    step    full size at once, at ``starts`` instants of each drive longer than ``shortest_s``
    ramp    growing for ``ramp_s`` from the same instants, then full size
    start   full size from the first sample of such a drive

The span from ``from_s`` to the last instant that leaves ``within_s`` of judged, excited driving is divided
into equal parts. One random instant is drawn in each part (reason: tools/DESIGN_LOG.md).

**Time** counts judged, excited, in-range driving from the first faulty sample on. All detectors use the
monitor's judged driving, though a baseline may alarm outside it. The time of an alarm is the sample at which
the core judged, not the end of its frame.

**Found**: the first alarm after the fault's start comes within ``within_s``. It also comes before the first
alarm of the same detector on the untouched drive after that instant. An alarm that the detector also raises
on the untouched drive does not count. An alarm that is already present when the fault starts does not count.
The table also states how often the untouched drive alarms in the time allowed.

**Refutable**: an injected fault is refutable from the first judged instant that meets two conditions. The
off-line margin of the faulty record exceeds 1, and the margin of the untouched record does not (`margins`). A
detector that accepts everything within the bounds cannot find the fault earlier. Times are also counted from
this instant. They are negative for an earlier alarm.
"""

from __future__ import annotations

import zlib
from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np

from ..drives.faults import Fault, inject, no_single_cause, stated
from ..drives.tables import Drive
from ..replay.replayer import Replay
from ..vehicle.project import EvaluationSettings, Way

WAY_WORDS: dict[Way, str] = {"step": "step", "ramp": "ramp", "start": "from the start"}
"""Text for the way in which a fault begins."""


@dataclass(frozen=True)
class Case:
    """An injected ``fault`` that begins in a ``way``; its ramp lasts ``ramp_s`` [s]."""

    way: Way
    fault: Fault
    ramp_s: float

    def into(self, drive: Drive, clock: JudgedClock, Ts: float, after_s: float = 0.0) -> Drive:
        """The drive with the fault, cut ``after_s`` [s] after the time allowed for finding it."""
        end = min(clock.end + round(after_s / Ts), len(drive.t))
        return inject(drive.before_sample(end), self.fault, clock.first * Ts, Ts, self.ramp_s)


@dataclass(frozen=True)
class JudgedClock:
    """Clock that counts judged, excited driving in range after a sample of a drive.

    Attributes
    ----------
    seconds : ndarray (N,), s at every sample, the first one included
    first : int, sample at which the clock starts
    within_s : float, s until which a fault counts as found
    """

    seconds: np.ndarray
    first: int
    within_s: float

    @classmethod
    def from_replay(cls, replay: Replay, first: int, within_s: float) -> JudgedClock:
        """Clock of a replayed drive from its sample ``first`` on."""
        relevant = replay.judged & replay.in_range & replay.excited
        relevant[:first] = False
        return cls(np.cumsum(relevant) * replay.Ts, first, within_s)

    @property
    def end(self) -> int:
        """Number of samples up to the last one at which a fault counts as found."""
        return int(np.searchsorted(self.seconds, self.within_s * (1 + 1e-9), side="right"))

    def read(self, hits: np.ndarray) -> float | None:
        """Clock time [s] of the first True of ``hits`` (M,), M <= N, from ``first`` on, or None."""
        return self.read_after(hits[self.first :])

    def read_after(self, hits: np.ndarray) -> float | None:
        """Clock time [s] of the first True of ``hits`` (M,), which begins at ``first``, or None."""
        places = np.flatnonzero(hits)
        return float(self.seconds[self.first + places[0]]) if len(places) else None


@dataclass(frozen=True)
class Injection:
    """Settings of the injected faults and their instants (explained in the module's docstring).

    Attributes
    ----------
    from_s, shortest_s, within_s : float, s
    starts : int, instants per drive
    faults : tuple[Fault, ...]
    ways : tuple[Way, ...]
    ramp_s : float, s
    further : tuple of Fault, injected as steps, to check their causes only (causes.py)
    """

    from_s: float
    shortest_s: float
    within_s: float
    starts: int
    faults: tuple[Fault, ...]
    ways: tuple[Way, ...] = ("step", "ramp", "start")
    ramp_s: float = 20.0
    further: tuple[Fault, ...] = ()

    @classmethod
    def usual(cls) -> Injection:
        """Injection with the default settings and a bias of 0.05."""
        return cls.from_settings(EvaluationSettings(bias=0.05), np.zeros(0))

    @classmethod
    def from_settings(cls, settings: EvaluationSettings, spread: np.ndarray) -> Injection:
        """Make the injection from a project file's settings and the outputs' ``spread`` (n_y,).

        Without a spread there are no further faults.
        """
        times = (settings.fault_from_s, settings.shortest_drive_s, settings.found_within_s)
        faults = stated(settings, spread)
        further = no_single_cause(spread) if len(spread) else ()
        return cls(*times, settings.starts, faults, settings.ways, settings.ramp_s, further)

    def to_dict(self) -> dict:
        """Times, number of starts and ways as JSON."""
        return {k: v for k, v in vars(self).items() if k not in ("faults", "further")} | {
            "ways": list(self.ways)
        }

    @property
    def cases(self) -> list[Case]:
        """Every fault in every way, sorted by way."""
        ramps = {"ramp": self.ramp_s}
        return [Case(way, fault, ramps.get(way, 0.0)) for way in self.ways for fault in self.faults]

    @property
    def further_cases(self) -> list[Case]:
        """The further faults."""
        return [Case("step", fault, 0.0) for fault in self.further]

    def into(self, untouched: Replay, seed: int) -> Iterator[tuple[Case, JudgedClock]]:
        """Every case with the clock of each instant in a drive; empty if the drive does not qualify."""
        clocks = self.clocks(untouched, seed)
        whole = [JudgedClock.from_replay(untouched, 0, self.within_s)] if clocks else []
        for case in self.cases:
            yield from ((case, clock) for clock in (whole if case.way == "start" else clocks))

    def clocks(self, untouched: Replay, seed: int) -> list[JudgedClock]:
        """Clocks of all instants in a drive except its start; empty if the drive does not qualify."""
        if untouched.duration_s <= self.shortest_s:
            return []
        earliest = round(self.from_s / untouched.Ts)
        seconds = JudgedClock.from_replay(untouched, earliest, self.within_s).seconds
        latest = int(np.searchsorted(seconds, seconds[-1] - self.within_s, side="right"))
        if seconds[-1] < self.within_s:
            return []
        # Each drive has its own random numbers, so they do not depend on the other drives.
        random = np.random.default_rng([seed, zlib.crc32(untouched.name.encode())])
        spans = (np.arange(self.starts) + random.uniform(size=self.starts)) / self.starts
        firsts = earliest + spans * max(0, latest - earliest)
        return [JudgedClock.from_replay(untouched, int(first), self.within_s) for first in firsts]


@dataclass(frozen=True)
class FaultOutcome:
    """Outcome of a fault in the drive ``run`` from ``start_s`` [s] on.

    All times are judged, excited seconds, or None if the event does not occur in the time allowed. ``s`` is
    the time until the fault was found. ``untouched_s`` is the time until an alarm without the fault, and
    ``refutable_s`` the time until the fault was refutable.
    """

    run: str
    start_s: float
    s: float | None
    untouched_s: float | None
    refutable_s: float | None = None

    @classmethod
    def from_times(
        cls,
        run: str,
        Ts: float,
        clock: JudgedClock,
        s: float | None,
        untouched: float | None,
        refutable_s: float | None = None,
    ) -> FaultOutcome:
        """Outcome of a fault from the start of ``clock`` on, in a drive with sample time ``Ts`` [s].

        ``s`` and ``untouched`` are the times [s] of the first alarm with and without the fault, or None.
        ``refutable_s`` is the result of `refutable`.
        """
        in_time = clock.seconds[clock.end - 1]
        caused = s is not None and s <= in_time and (untouched is None or s < untouched)
        return cls(
            run,
            clock.first * Ts,
            s if caused else None,
            untouched if untouched is not None and untouched <= in_time else None,
            refutable_s,
        )

    @property
    def detected(self) -> bool:
        """Whether the detector found the fault in time."""
        return self.s is not None


def margins(replay: Replay, first_s: float) -> np.ndarray:
    """Off-line margin (N,) at each sample; 0 where nothing is judged.

    It is the maximum of the energy test's ratio and of t* of all counted frames that end at the sample.
    ``first_s`` is the time of the drive's first sample [s].
    """
    frames, largest = replay.run.frames, replay.run.energy.copy()
    ends = np.round((frames.t_end_s[frames.counted] - first_s) / replay.Ts).astype(int)
    np.maximum.at(largest, ends, frames.margin[frames.counted])
    return largest


def refutable(clock: JudgedClock, faulty: np.ndarray, untouched: np.ndarray) -> float | None:
    """Clock time [s] at which an injected fault is first refutable; None if not in the time allowed.

    ``faulty`` (M,), M <= N, and ``untouched`` (N,) are the `margins` of the records with and without the
    fault.
    """
    n = min(clock.end, len(faulty))
    return clock.read((faulty[:n] > 1.0) & (untouched[:n] <= 1.0))


Outcomes = dict[Case, list[FaultOutcome]]
"""Outcomes per case, from every instant of every drive."""


def with_refutable(cases: Outcomes, known: Outcomes) -> Outcomes:
    """A detector's ``cases`` with the refutable times of the ``known`` outcomes."""
    at = {(case, c.run, c.start_s): c.refutable_s for case, members in known.items() for c in members}
    return {
        case: [replace(c, refutable_s=at[case, c.run, c.start_s]) for c in members]
        for case, members in cases.items()
    }


def fault_rows(cases: Outcomes) -> list[dict]:
    """Make one row per case, in the order of ``cases``.

    A row counts found and all outcomes, all drives, and the drives with the fault found from every start. It
    counts the outcomes whose untouched drive alarms in the time allowed, and has the median time [s]. It
    counts the refutable outcomes and the found ones among them, and has their median time after that instant
    [s].
    """
    rows = []
    for case, members in cases.items():
        runs, refuted = {c.run for c in members}, [c for c in members if c.refutable_s is not None]
        after = [None if c.s is None else c.s - c.refutable_s for c in refuted if c.refutable_s is not None]
        rows.append(
            {
                "way": case.way,
                "fault": case.fault.label,
                "found": sum(c.detected for c in members),
                "counted": len(members),
                "drives": len(runs),
                "drives_found": len(runs - {c.run for c in members if not c.detected}),
                "untouched_alarms": sum(c.untouched_s is not None for c in members),
                "median_s": median_time([c.s for c in members]),
                "refutable": len(refuted),
                "refutable_found": sum(c.detected for c in refuted),
                "median_after_s": median_time(after),
                "cases": [vars(c) for c in members],
            }
        )
    return rows


def median_time(seconds: list[float | None]) -> float | None:
    """Compute the median time to the first alarm; a miss counts as the latest time.

    Parameters
    ----------
    seconds : list of float or None, s

    Returns
    -------
    float, s, or None if there are no times or at least half of them are misses
    """
    if not seconds:
        return None
    middle = float(np.median([np.inf if s is None else s for s in seconds]))
    return middle if np.isfinite(middle) else None


def ranking(rows: dict[str, dict]) -> list[str]:
    """List the best detectors for one fault; several detectors can be equally good.

    The share of found cases decides first, then the median time. The result is empty if there is no case or
    no detector found the fault. ``rows`` holds one row of fault_rows per detector.
    """

    def merit(row: dict) -> tuple[float, float]:
        return row["found"] / row["counted"], -(np.inf if row["median_s"] is None else row["median_s"])

    if not all(row["counted"] for row in rows.values()) or not any(row["found"] for row in rows.values()):
        return []
    best = max(merit(row) for row in rows.values())
    return [name for name, row in rows.items() if merit(row) == best]
