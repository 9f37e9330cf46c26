"""Choice of the confirmation of the frame test for a stated rate of alarms (THEORY 7.20).

A design k of m alarms by the k-th largest margin among the last m counted frames of a bin. Each design has
the threshold of the stated rate, from the calibration drives. The compiled core judges these drives again
with gain errors that begin at instants of them. The chosen design finds the smallest gain error within
``evaluation.found_within_s`` of judged, excited driving. The first of equal designs is chosen.

A design of several frames that the project states is kept. The comparison is made all the same.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view

from ..base.rates import number_words
from ..core.compiled import Core, Run
from ..drives.excitation import excited
from ..drives.faults import Fault, inject
from ..drives.tables import Drive
from ..vehicle.project import Project
from .calibration import RATED, ROUNDING, RateTarget, Recordings, block_of, calibrate
from .change import FLOOR

Design = tuple[int, int]
"""k and m."""
DESIGNS: tuple[Design, ...] = ((1, 1), (2, 2), (2, 6), (3, 3), (3, 6))
"""Compared designs, the preferred one of equals first."""
ERRORS = np.geomspace(0.05, 1.6, 21)
"""Planted gain errors g; the outputs become 1 - g times themselves."""
FOUND = 0.6
"""Share of the instants from which a gain error must be found."""
RATES_PER_1000_H = (0.1, 0.3, 1.0, 3.0, 10.0, 30.0, 100.0)
"""Rates of the comparison's curves, of all tests together."""
DELAYS = 20
"""Number of delays, evenly spaced up to the longest."""
MOST_DRIVES = 40
"""Largest number of drives with planted gain errors."""
OTHERS = ("energy", "change")
"""Tests beside the frame test that are compared, too."""


def confirmed(scores: np.ndarray, k: int, m: int) -> np.ndarray:
    """Compute the statistic of a design.

    Parameters
    ----------
    scores : ndarray (..., n), scores in the order of time
    k, m : int

    Returns
    -------
    ndarray (..., n), k-th largest of the last m scores; -inf for fewer than k
    """
    before = [(0, 0)] * (scores.ndim - 1)
    padded = np.pad(scores, (*before, (m - 1, 0)), constant_values=-np.inf)
    return np.partition(sliding_window_view(padded, m, axis=-1), m - k, axis=-1)[..., m - k]


def statistics(bins: np.ndarray, margin: np.ndarray, designs: Iterable[Design]) -> dict[Design, np.ndarray]:
    """Compute the statistic (F,) of each counted frame by design, as the core does.

    It is 0 before k frames of its bin. ``bins`` and ``margin`` (F,) are those of each frame, in the order of
    judgement.
    """
    members = [np.flatnonzero(bins == k) for k in np.unique(bins)]
    by_design = {}
    for design in designs:
        statistic = np.zeros(len(bins))
        for own in members:
            statistic[own] = np.maximum(confirmed(margin[own], *design), 0.0)
        by_design[design] = statistic
    return by_design


class Confirmed(NamedTuple):
    """Statistics of a drive by the S tests: the frame test with each design, then OTHERS.

    Attributes
    ----------
    maxima : ndarray (S, B), largest statistic in each block
    judged_s : float, s, time in counted frames
    reached : ndarray (I, len(ERRORS), S, DELAYS)
        Largest statistic until each delay after each instant, with each gain error.
    """

    maxima: np.ndarray
    judged_s: float
    reached: np.ndarray


def judged_drive(
    core: Core,
    reals: np.ndarray,
    drive: Drive,
    project: Project,
    length: np.ndarray,
    designs: tuple[Design, ...],
    *,
    planted: bool,
) -> Confirmed:
    """Judge a calibration drive by all designs, and with gain errors if ``planted``.

    ``length`` (K,) is the length of a frame in samples. ``reals`` (R,) are the numbers of the core.
    """
    Ts, t0 = project.Ts_s, drive.t[0]

    def run(record: Drive) -> Run:
        return core.monitor(reals=reals, seal=True).run_drive(record)

    whole = run(drive)
    series = _series(whole, whole.frames.t_end_s - t0, Ts, designs)
    maxima = np.zeros((len(series), int(block_of(len(drive.t) * Ts)) + 1))
    for row, (t_s, x) in zip(maxima, series, strict=True):
        np.maximum.at(row, block_of(t_s), x)
    judged = whole.frames.judged(len(drive.t), t0, Ts, length)
    clock = Ts * np.cumsum(judged & excited(drive, project))
    firsts = _instants(clock, project) if planted else []
    longest = project.evaluation.found_within_s
    reached = np.zeros((len(firsts), len(ERRORS), len(series), DELAYS))
    for i, first in enumerate(firsts):
        since = clock - clock[first]
        piece = drive.before_sample(int(np.searchsorted(since, longest * (1 + 1e-9), side="right")))
        for g, error in enumerate(ERRORS):
            faulty = run(inject(piece, Fault("gain", 1.0 - error), first * Ts, Ts))
            for row, (t_s, x) in zip(
                reached[i, g], _series(faulty, faulty.frames.t_judged_s - t0, Ts, designs), strict=True
            ):
                at = np.round(t_s / Ts).astype(int)
                after = at >= first
                step = np.ceil(DELAYS * since[at[after]] / longest - 1e-6).astype(int)
                np.maximum.at(row, np.clip(step - 1, 0, DELAYS - 1), x[after])
    return Confirmed(maxima, Ts * float(judged.sum()), np.maximum.accumulate(reached, axis=-1))


def _series(
    run: Run, t_s: np.ndarray, Ts: float, designs: tuple[Design, ...]
) -> list[tuple[np.ndarray, np.ndarray]]:
    """Times [s] and statistics of every test; ``t_s`` (F,) are the times of the frames."""
    samples, counted = Ts * np.arange(len(run.energy)), run.frames.counted
    by_design = statistics(run.frames.bin[counted], run.frames.margin[counted], designs)
    frames = [(t_s[counted], x) for x in by_design.values()]
    return [*frames, (samples, run.energy), (samples, run.change)]


def _instants(clock: np.ndarray, project: Project) -> list[int]:
    """Samples at which gain errors begin; each leaves the longest delay of judged, excited driving."""
    settings, Ts = project.evaluation, project.Ts_s
    earliest = round(settings.fault_from_s / Ts)
    if len(clock) * Ts <= settings.shortest_drive_s or clock[-1] - clock[earliest] < settings.found_within_s:
        return []
    latest = int(np.searchsorted(clock, clock[-1] - settings.found_within_s, side="right"))
    spans = (np.arange(settings.starts) + 0.5) / settings.starts
    return [int(earliest + span * max(0, latest - earliest)) for span in spans]


@dataclass(frozen=True)
class Confirmation:
    """Comparison of the designs, and the chosen one.

    Attributes
    ----------
    chosen : Design
    stated : bool, whether the project states the chosen design
    per_1000_h : float, target rate of all tests together
    within_s : float, s, longest delay
    starts : int, number of instants with a gain error
    shown : float, the largest of the smallest gain errors of all designs
    rates : list of float, in 1000 h, rates of the curves
    rows : list of dict, a row for each design and each other test
        A row has its ``label``, the ``threshold`` at the target, and ``least``, the smallest gain error found
        in time. The curves are ``least_by_rate`` and ``delay_by_rate`` [s] of the error ``shown``. None
        stands where nothing is found.
    """

    chosen: Design
    stated: bool
    per_1000_h: float
    within_s: float
    starts: int
    shown: float
    rates: list[float]
    rows: list[dict[str, Any]]

    @classmethod
    def compared(
        cls,
        project: Project,
        designs: tuple[Design, ...],
        drives: Mapping[str, Confirmed],
        recordings: Recordings,
    ) -> Confirmation:
        """Compare the designs on the calibration ``drives``."""
        settings, within = project.frame_test, project.evaluation.found_within_s
        target = settings.alarms_per_1000_h
        assert target is not None
        reached = np.concatenate([d.reached for d in drives.values()])
        judged_s = {n: d.judged_s for n, d in drives.items()}
        rates = sorted({*RATES_PER_1000_H, target})
        rows: list[dict[str, Any]] = []
        floors = [*[1.0] * len(designs), 1.0 + ROUNDING, FLOOR]
        labels = [*map(design_words, designs), *(f"{test} test" for test in OTHERS)]
        for i, (label, floor) in enumerate(zip(labels, floors, strict=True)):
            maxima = {n: d.maxima[i].tolist() for n, d in drives.items() if d.maxima[i].any()}
            scores = {n: max(x) for n, x in maxima.items()}
            z = []
            for rate in rates:
                aim = RateTarget(rate / len(RATED), settings.alarms_confident, maxima, judged_s)
                z.append(
                    calibrate(scores, settings.alpha, floor=floor, recordings=recordings, target=aim).carried
                )
            least = [_least(reached[:, :, i, -1] > x) for x in z]
            at = rates.index(target)
            rows.append(
                {"label": label, "threshold": z[at], "least": least[at], "least_by_rate": least, "z": z}
            )
        sizes = [np.inf if r["least"] is None else r["least"] for r in rows[: len(designs)]]
        shown = max((x for x in sizes if np.isfinite(x)), default=float(ERRORS[-1]))
        for i, row in enumerate(rows):
            row["delay_by_rate"] = [_delay(reached[:, :, i] > x, shown, within) for x in row.pop("z")]
        stated = (settings.confirm, settings.of_last)
        chosen = stated if stated[1] > 1 else designs[int(np.argmin(sizes))]
        return cls(chosen, stated[1] > 1, target, within, len(reached), shown, rates, rows)

    def of_project(self, project: Project) -> Project:
        """The project with the chosen design."""
        update = {"confirm": self.chosen[0], "of_last": self.chosen[1]}
        return project.model_copy(update={"frame_test": project.frame_test.model_copy(update=update)})

    def table(self) -> list[dict[str, str]]:
        """The rows of the comparison in words."""
        return [
            {
                "confirmation": r["label"],
                "threshold": f"{r['threshold']:.4g}",
                f"smallest gain error in {self.within_s:g} s": _or_none(r["least"], "{:.2g}"),
                f"gain error {self.shown:.2g} found after, s": _or_none(
                    r["delay_by_rate"][self.rates.index(self.per_1000_h)], "{:.3g}"
                ),
            }
            for r in self.rows
        ]

    def sentence(self) -> str:
        """The choice and its reason."""
        designs = self.rows[: -len(OTHERS)]
        ranked = sorted(designs, key=lambda r: np.inf if r["least"] is None else r["least"])
        best = next(r for r in designs if r["label"] == design_words(self.chosen))
        other = next(r for r in ranked if r is not best)
        reason = "as the project states" if self.stated else "chosen"
        return (
            f"confirmation: {best['label']} frames, {reason}; it finds {_found(best)} within "
            f"{self.within_s:g} s from {FOUND:.0%} of {self.starts} instants at "
            f"{number_words(self.per_1000_h)} alarms per 1000 h; next {other['label']}: {_found(other)}"
        )

    def to_dict(self) -> dict[str, Any]:
        """Convert to JSON types, for `from_dict`."""
        return vars(self)

    @classmethod
    def from_dict(cls, data: dict[str, Any]) -> Confirmation:
        """Comparison from the result of `to_dict`."""
        return cls(**data | {"chosen": tuple(data["chosen"])})


def designs_of(project: Project) -> tuple[Design, ...]:
    """List the compared designs, with that of the project."""
    return tuple(dict.fromkeys((*DESIGNS, (project.frame_test.confirm, project.frame_test.of_last))))


def design_words(design: Design) -> str:
    """Write a design as words.

    Parameters
    ----------
    design : Design

    Returns
    -------
    str
    """
    return f"{design[0]} of {design[1]}"


def _or_none(value: float | None, form: str) -> str:
    return "none" if value is None else form.format(value)


def _found(row: dict[str, Any]) -> str:
    return "no gain error" if row["least"] is None else f"a gain error of {row['least']:.2g}"


def _least(is_found: np.ndarray) -> float | None:
    """Smallest gain error that is found from enough instants, as each larger one is.

    ``is_found`` is (I, len(ERRORS)).
    """
    if not len(is_found):
        return None
    enough = np.logical_and.accumulate((is_found.mean(axis=0) >= FOUND)[::-1])[::-1]
    return float(ERRORS[np.argmax(enough)]) if enough.any() else None


def _delay(is_found: np.ndarray, error: float, longest_s: float) -> float | None:
    """Delay [s] until a gain error is found from enough instants; ``is_found`` (I, len(ERRORS), DELAYS)."""
    if not len(is_found):
        return None
    enough = is_found[:, int(np.argmin(np.abs(ERRORS - error)))].mean(axis=0) >= FOUND
    return longest_s * (int(np.argmax(enough)) + 1) / DELAYS if enough.any() else None
