"""Stage 5: calibrate the tests by split conformal prediction, one by one or together (`joint_scores`).

THEORY 7.3 has the thresholds (T23), their claims (T24) and those of groups. Scores are read from the compiled
core. It carries one threshold: the largest of all, with which every claim holds, or that of a named group.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from scipy.stats import beta

from ..base.errors import InputError
from ..base.rates import number_words
from ..base.tails import Peaks, Tail
from ..core.compiled import Run
from ..drives.tables import EXPERIMENTS, Experiment

ROUNDING = 1e-3
"""Relative margin of an exported threshold for rounding: float, double and fused multiply-add differ by less
(tests/golden/test_one_verdict.py)."""
FEWEST_FOR_ALPHA = 9
"""Fewest recordings for which an alpha is stated (THEORY 7.3)."""
RATED = ("frame", "pools", "energy", "change")
"""Tests that share a rate of alarms equally."""
BLOCK_S = 30.0
"""Length [s] of the blocks of a drive whose maxima a tail is fitted to (THEORY 7.20)."""


@dataclass(frozen=True)
class Recordings:
    """Drives as pieces of recordings, whose scores are not independent draws.

    Attributes
    ----------
    by_drive : dict[str, str], recording by drive, where experiments.csv names it
    setting : tuple of str, recordings of calibration drives that also set the bounds
    groups : dict[str, str], group by drive, where it has one
    """

    by_drive: dict[str, str] = field(default_factory=dict)
    setting: tuple[str, ...] = ()
    groups: dict[str, str] = field(default_factory=dict)

    @classmethod
    def listed(cls, setting: Iterable[Experiment], others: Iterable[Experiment]) -> Recordings:
        """Recordings of the bound-setting drives and the ``others``, from experiments.csv.

        Raises InputError where pieces of one recording are of several groups, or only some others have a
        group.
        """
        setting, others = list(setting), list(others)
        both = {e.recording for e in setting} & {e.recording for e in others}
        by_drive = {e.name: e.recording for e in (*setting, *others) if e.recording != e.name}
        first: dict[str, Experiment] = {}
        for e in (*setting, *others):
            other = first.setdefault(e.recording, e)
            if other.group != e.group:
                raise InputError(
                    e.path.parent / EXPERIMENTS,
                    "column group",
                    f"{other.name} ({other.group or 'none'}) and {e.name} ({e.group or 'none'}) are pieces "
                    f"of recording {e.recording}",
                    "one group for each recording",
                )
        if len({e.group is None for e in others}) > 1:
            without = next(e for e in others if e.group is None)
            raise InputError(
                without.path.parent / EXPERIMENTS,
                "column group",
                f"{without.name} has none, others have one",
                "a group for every drive that calibrates or is judged, or for none",
            )
        return cls(by_drive, tuple(sorted(both)), {e.name: e.group for e in others if e.group is not None})

    def named(self, drive: str) -> str:
        """Recording of the piece ``drive``."""
        return self.by_drive.get(drive, drive)

    def others(self, drives: Iterable[str], without: str | None) -> list[str]:
        """The ``drives`` outside the recording of drive ``without``; None: all."""
        return [d for d in drives if without is None or self.named(d) != self.named(without)]

    def in_group(self, scores: Mapping[str, float], group: str) -> dict[str, float]:
        """The ``scores`` of the drives of a group."""
        return {d: s for d, s in scores.items() if self.groups.get(d) == group}

    def largest(self, scores: Mapping[str, float]) -> dict[str, float]:
        """Score of every recording that did not set the bounds, from the ``scores`` of its drives."""
        by_recording: dict[str, float] = {}
        for drive, value in scores.items():
            if (recording := self.named(drive)) not in self.setting:
                by_recording[recording] = max(value, by_recording.get(recording, value))
        return by_recording


NO_RECORDINGS = Recordings()
"""Every drive is a separate recording."""


@dataclass(frozen=True)
class Extrapolation:
    """Threshold of a rate that the data are too short for, from the tail of their maxima (THEORY 7.20).

    Attributes
    ----------
    per_1000_h : float, the rate, per 1000 h judged
    hours : float, h judged of the recordings
    peaks : int, maxima that the tail is fitted to
    level, scale, shape : float, of the generalised Pareto tail
    threshold : float, before the floor of the test
    interval : tuple of float, of 95 %, of the rate at the threshold, per 1000 h judged
    more_h : float, further hours with which the rate needs no extrapolation
    """

    per_1000_h: float
    hours: float
    peaks: int
    level: float
    scale: float
    shape: float
    threshold: float
    interval: tuple[float, float]
    more_h: float

    def words(self) -> str:
        """The rate, what it rests on, and what would make it exact."""
        low, high = map(number_words, self.interval)
        return (
            f"{self.per_1000_h:g} per 1000 h judged, extrapolated from {self.hours:.3g} hours ({self.peaks} "
            f"peaks, shape {self.shape:.2g}; 95 % interval {low} to {high} per 1000 h); "
            f"{number_words(self.more_h)} more hours judged make it exact"
        )


@dataclass(frozen=True)
class RateTarget:
    """Rate of alarms that a test may have, in place of alpha.

    Attributes
    ----------
    per_1000_h : float, per 1000 h judged
    confident : bool, the threshold is the upper end of its interval, with 95 % confidence
    maxima : Mapping, maxima of the score in blocks of BLOCK_S, by drive
    judged_s : Mapping, s in counted frames, by drive
    """

    per_1000_h: float
    confident: bool
    maxima: Mapping[str, Sequence[float]]
    judged_s: Mapping[str, float]

    @classmethod
    def joint(cls, targets: Sequence[RateTarget]) -> RateTarget:
        """Target of the largest score of all tests, with the sum of their rates."""
        drives = set.intersection(*(set(t.maxima) for t in targets))
        maxima = {d: np.max([t.maxima[d] for t in targets], axis=0).tolist() for d in sorted(drives)}
        return replace(targets[0], per_1000_h=sum(t.per_1000_h for t in targets), maxima=maxima)

    def threshold(self, scores: Mapping[str, float], floor: float, recordings: Recordings) -> GroupThreshold:
        """Conformal threshold of the rate where recordings suffice, else that of their tail, if any."""
        largest, rate = recordings.largest(scores), self.per_1000_h / 1000
        drives_of = {r: [d for d in scores if recordings.named(d) == r] for r in largest}
        hours = {r: sum(self.judged_s[d] for d in drives) / 3600 for r, drives in drives_of.items()}
        whole = sum(hours.values())
        if not whole:
            return GroupThreshold(len(largest))
        exact = _conformal(largest, min(0.5, rate * whole / len(hours)), floor)
        peaks = Peaks.from_maxima(
            {r: [self.maxima[d] for d in drives] for r, drives in drives_of.items()}, hours
        )
        if exact.alpha is not None or peaks is None:
            return exact
        tail = Tail.fitted(peaks)
        threshold = tail.confident_threshold(rate) if self.confident else tail.threshold(rate)
        low, high = tail.interval(threshold)
        more = max(1 / rate, FEWEST_FOR_ALPHA * whole / len(hours)) - whole
        of_tail = (len(peaks.excess), peaks.level, tail.scale, tail.shape, threshold)
        extrapolation = Extrapolation(self.per_1000_h, whole, *of_tail, (1000 * low, 1000 * high), more)
        return replace(exact, threshold=max(floor, threshold), extrapolation=extrapolation)


@dataclass(frozen=True)
class GroupThreshold:
    """Threshold of a group from its ``recordings``; None where they are too few for alpha."""

    recordings: int
    threshold: float | None = None
    alpha: float | None = None
    conditional_bound: float | None = None
    extrapolation: Extrapolation | None = None

    def to_dict(self) -> dict:
        """JSON-able, for `from_dict`."""
        return _with_extrapolation({k: v for k, v in vars(self).items() if k != "extrapolation"}, self)

    @classmethod
    def from_dict(cls, data: dict) -> GroupThreshold:
        """Read back."""
        return cls(**(data | _extrapolation_of(data)))

    def words(self, group: str) -> str:
        """Claim on a further recording of the ``group``."""
        if self.extrapolation is not None:
            return f"group {group}: threshold {self.threshold:.4g}, {self.extrapolation.words()}"
        if self.alpha is None:
            return (
                f"group {group}: {self.recordings} recordings are too few for its own threshold; it has "
                "the pooled one without alpha"
            )
        return (
            f"group {group}: threshold {self.threshold:.4g}, alpha {self.alpha:g} from {self.recordings} "
            f"recordings, with 95 % confidence below {self.conditional_bound:.3f}"
        )


@dataclass(frozen=True)
class Calibration:
    """Threshold of a test with its claim.

    Attributes
    ----------
    threshold : float, pooled; the largest score where no claim can be made
    scores : dict[str, float], by drive
    alpha : float or None, probability of an alarm on a further recording, None without a claim
    conditional_bound : float or None
        Bound on that probability with 95 % confidence over calibration recordings.
    recordings : Recordings
    groups : dict[str, GroupThreshold], by group of experiments.csv
    group : str or None, group of this threshold (``of_group``), None: pooled
    judged_s : dict[str, float], s in counted frames by drive; empty without a claim an hour
    target : RateTarget or None, in place of alpha
    extrapolation : Extrapolation or None, of the pooled threshold
    """

    threshold: float
    scores: dict[str, float]
    alpha: float | None
    conditional_bound: float | None
    recordings: Recordings = NO_RECORDINGS
    groups: dict[str, GroupThreshold] = field(default_factory=dict)
    group: str | None = None
    judged_s: dict[str, float] = field(default_factory=dict)
    target: RateTarget | None = None
    extrapolation: Extrapolation | None = None

    def over(self, judged_s: Mapping[str, float]) -> Calibration:
        """The calibration with the judged time of every drive [s], for claims an hour."""
        return replace(self, judged_s={d: judged_s[d] for d in self.scores})

    @property
    def carried(self) -> float:
        """Threshold in the core: the largest of the pooled one and the groups', or that of ``group``."""
        own = [] if self.group else [g.threshold for g in self.groups.values() if g.threshold is not None]
        return max([self.threshold, *own])

    @property
    def exported(self) -> float:
        """Carried threshold with the margin for rounding, as the core compares with it."""
        return self.carried * (1 + ROUNDING)

    def of_group(self, group: str | None) -> Calibration:
        """The calibration for drives of a group: its own threshold, or the pooled one without alpha.

        Drives of no group have the carried one.
        """
        if group is None:
            return replace(self, threshold=self.carried)
        if not self.groups:
            return self
        own = self.groups.get(group, GroupThreshold(0))
        return replace(
            self,
            threshold=self.threshold if own.threshold is None else own.threshold,
            scores=self.recordings.in_group(self.scores, group),
            alpha=own.alpha,
            conditional_bound=own.conditional_bound,
            extrapolation=own.extrapolation,
            groups={group: own},
            group=group,
        )

    @property
    def decided_by(self) -> str | None:
        """Drive whose score is the carried threshold; None if it is the floor."""
        return next((d for d, s in self.scores.items() if s == self.carried), None)

    def to_dict(self) -> dict:
        """JSON-able, for `from_dict`; ``recordings`` and ``groups`` only if experiments.csv names any."""
        named = self.recordings
        out: dict = {k: getattr(self, k) for k in ("threshold", "scores", "alpha", "conditional_bound")}
        if named.by_drive:
            out["recordings"] = {"of": named.by_drive, "setting": list(named.setting)}
        if self.judged_s:
            out["judged_s"] = self.judged_s
        if self.groups:
            thresholds = {name: g.to_dict() for name, g in self.groups.items()}
            out["groups"] = {"of": named.groups, "thresholds": thresholds, "carried": self.carried}
        if self.target is not None:
            out["target"] = {k: v for k, v in vars(self.target).items() if k != "judged_s"}
        _with_extrapolation(out, self)
        return out if self.group is None else out | {"group": self.group}

    @classmethod
    def from_dict(cls, data: dict) -> Calibration:
        """Calibration from `to_dict`."""
        pieces = data.get("recordings", {"of": {}, "setting": ()})
        grouped = data.get("groups", {"of": {}, "thresholds": {}})
        own = {k: v for k, v in data.items() if k not in ("recordings", "groups")} | _extrapolation_of(data)
        if "target" in data:
            own["target"] = RateTarget(**data["target"], judged_s=data["judged_s"])
        return cls(
            **own,
            recordings=Recordings(pieces["of"], tuple(pieces["setting"]), grouped["of"]),
            groups={name: GroupThreshold.from_dict(g) for name, g in grouped["thresholds"].items()},
        )

    def units(self) -> str:
        """Number of calibrating drives or recordings, in words."""
        count = len(self.recordings.largest(self.scores))
        return f"{count} recordings" if self.recordings.by_drive else f"{count} drives"

    def claim(self) -> str:
        """Claim on the threshold's false alarms, in words."""
        if not self.groups:
            return self._pooled_claim()
        claims = "; ".join(
            g.words(name) + self._hourly(self.recordings.in_group(self.scores, name), g)
            for name, g in self.groups.items()
        )
        if self.group is not None:
            return claims
        return f"pooled: {self._pooled_claim()}; {claims}; the core carries the largest, {self.carried:.4g}"

    def _pooled_claim(self) -> str:
        if self.extrapolation is not None:
            return self.extrapolation.words()
        if self.alpha is not None:
            return (
                f"alpha {self.alpha:g} from {self.units()}, with 95 % confidence below "
                f"{self.conditional_bound:.3f}{self.hourly}"
            )
        if not self.recordings.by_drive:
            return f"alpha is not stated: too few calibration drives ({len(self.scores)})"
        beside = sum(self.recordings.named(d) in self.recordings.setting for d in self.scores)
        return (
            f"alpha is not stated: {len(self.scores)} drives calibrate, of {self.units()} that did not "
            "set the bounds; pieces of one recording are no draws of their own"
            + (f", and {beside} are of recordings that set the bounds" if beside else "")
        )

    @property
    def hourly(self) -> str:
        """Pooled claim an hour judged, as a continuation of it; empty without one."""
        return self._hourly(self.scores, self)

    def _hourly(self, scores: Mapping[str, float], threshold: GroupThreshold | Calibration) -> str:
        """Claim of recordings with these ``scores`` an hour judged, for a further one judged for their
        mean time."""
        counted = self.recordings.largest(scores)
        drives = [d for d in scores if self.recordings.named(d) in counted]
        hours = sum(self.judged_s.get(d, 0.0) for d in drives) / 3600
        if threshold.alpha is None or threshold.conditional_bound is None or not hours:
            return ""
        rate, bound = (x * len(counted) / hours for x in (threshold.alpha, threshold.conditional_bound))
        return f"; {rate:.3g} and {bound:.3g} an hour judged, of {hours:.3g} h"


@dataclass(frozen=True)
class Peak:
    """Origin of a drive's score: ``t_s`` after its first sample, and ``place``: the bin, or the energy test's
    band.

    ``place`` is None if unknown. ``without`` is the drive's score without that frame and those of its bin
    that overlap it; None for tests without frames.
    """

    t_s: float
    place: int | None = None
    without: float | None = None


def _with_extrapolation(out: dict, threshold: GroupThreshold | Calibration) -> dict:
    """``out`` with the extrapolation, if any."""
    if threshold.extrapolation is not None:
        out["extrapolation"] = vars(threshold.extrapolation)
    return out


def _extrapolation_of(data: dict) -> dict:
    """Field of the extrapolation in ``data``, if any."""
    extrapolation = data.get("extrapolation")
    if extrapolation is None:
        return {}
    return {"extrapolation": Extrapolation(**extrapolation | {"interval": tuple(extrapolation["interval"])})}


def block_of(t_s: np.ndarray | float) -> np.ndarray:
    """Blocks (n,) of BLOCK_S in which times (n,) [s] after a drive's first sample lie."""
    return (np.asarray(t_s) // BLOCK_S).astype(int)


def block_maxima(run: Run, t0: float, Ts: float) -> dict[str, list[float]]:
    """Maxima of the frame, energy and change test's score in blocks of a drive; 0 where nothing is judged.

    ``t0`` is the time of its first sample [s].
    """
    blocks, counted = int(block_of(len(run.energy) * Ts)) + 1, run.frames.counted
    series = {
        "frame": (run.frames.t_end_s[counted] - t0, run.frames.statistic[counted]),
        "energy": (np.arange(len(run.energy)) * Ts, run.energy),
        "change": (np.arange(len(run.change)) * Ts, run.change),
    }
    by_test = {}
    for test, (t, x) in series.items():
        maxima = np.zeros(blocks)
        np.maximum.at(maxima, block_of(t), x)
        by_test[test] = maxima.tolist()
    return by_test


def peaks(run: Run, t0: float, Ts: float, length: np.ndarray) -> dict[str, Peak]:
    """Peaks of every test that judged the drive.

    ``t0`` is the time of its first sample [s], ``length`` (K,) samples of a frame.
    """
    by_test, f = {}, run.frames
    statistic = np.where(f.counted, f.statistic, -np.inf)
    if f.counted.any():
        k = int(np.argmax(statistic))
        other = (f.bin != f.bin[k]) | (np.abs(f.t_end_s - f.t_end_s[k]) > (length[f.bin[k]] - 0.5) * Ts)
        others = statistic[other & f.counted]
        by_test["frame"] = Peak(float(f.t_end_s[k] - t0), int(f.bin[k]), float(others.max(initial=0.0)))
    for test, ratio in (("energy", run.energy), ("change", run.change)):
        if (ratio > 0).any():
            k = int(np.argmax(ratio))
            by_test[test] = Peak(k * Ts, int(run.energy_band[k]) if test == "energy" else None)
    return by_test


def score(run: Run) -> float | None:
    """Return a drive's score in the frame test.

    Parameters
    ----------
    run : Run

    Returns
    -------
    float, or None if no frame counted
    """
    counted = run.frames.counted
    return float(run.frames.statistic[counted].max()) if counted.any() else None


def energy_score(run: Run) -> float | None:
    """Return a drive's score in the energy test, its largest ratio.

    Parameters
    ----------
    run : Run

    Returns
    -------
    float, or None if nothing was judged
    """
    return float(run.energy.max()) if (run.energy > 0).any() else None


def change_score(run: Run) -> float | None:
    """Return a drive's score in the change test, its largest ratio.

    Parameters
    ----------
    run : Run

    Returns
    -------
    float, or None if nothing was judged
    """
    return float(run.change.max()) if (run.change > 0).any() else None


def joint_score(scores: Mapping[str, float | None], floors: Mapping[str, float]) -> float:
    """Compute a drive's score in all tests together, the largest score above its test's floor.

    Every score is in units of the bound-setting drives. A margin and a ratio of the energy test are the least
    inflation of the bounds that agrees with the data. A ratio of the change test is over the largest met. One
    threshold T therefore serves for the largest. A test alarms above the larger of T and its floor, so a
    score below the floor does not count. A monitor of all tests with T alarms on a further drive, by any,
    with probability at most alpha. With a threshold per test that probability is at most alpha times their
    number.

    Parameters
    ----------
    scores : Mapping, score by test, None if not judged
    floors : Mapping, floor by test

    Returns
    -------
    float, 0 without a score above its floor

    References
    ----------
    THEORY 7.3.
    """
    return max((s for test, s in scores.items() if s is not None and s > floors[test]), default=0.0)


def joint_scores(tests: Mapping[str, Mapping[str, float]], floors: Mapping[str, float]) -> dict[str, float]:
    """Compute `joint_score` of every drive that any test judged.

    Parameters
    ----------
    tests : Mapping, scores by test and drive
    floors : Mapping, floor by test

    Returns
    -------
    dict[str, float], by drive
    """
    drives = sorted({n for scores in tests.values() for n in scores})
    return {n: joint_score({test: s[n] for test, s in tests.items() if n in s}, floors) for n in drives}


def calibrate(
    scores: Mapping[str, float],
    alpha: float,
    *,
    floor: float = 1.0,
    unstated_floor: float | None = None,
    recordings: Recordings = NO_RECORDINGS,
    target: RateTarget | None = None,
) -> Calibration:
    """Compute the threshold from the scores of the calibration drives, and that of every group.

    Parameters
    ----------
    scores : Mapping, by drive
    alpha : float, probability of an alarm on a further recording
    floor : float, least threshold, default 1.0: a margin of 1 falsifies nothing
    unstated_floor : float, optional, least threshold without alpha, by default ``floor``
    recordings : Recordings, default NO_RECORDINGS
    target : RateTarget, optional, in place of alpha

    Returns
    -------
    Calibration, with the largest score as threshold if drives are too few

    References
    ----------
    THEORY 7.3, 7.20.
    """

    def threshold(drive_scores: Mapping[str, float]) -> GroupThreshold:
        if target is not None:
            return target.threshold(drive_scores, floor, recordings)
        return _conformal(recordings.largest(drive_scores), alpha, floor)

    names = sorted({recordings.groups[d] for d in scores if d in recordings.groups})
    groups = {g: threshold(recordings.in_group(scores, g)) for g in names}
    pooled = threshold(scores)
    least = floor if unstated_floor is None else unstated_floor
    return Calibration(
        max([least, *scores.values()]) if pooled.threshold is None else pooled.threshold,
        dict(scores),
        pooled.alpha,
        pooled.conditional_bound,
        recordings,
        groups,
        target=target,
        extrapolation=pooled.extrapolation,
    )


def _conformal(largest: Mapping[str, float], alpha: float, floor: float) -> GroupThreshold:
    """Threshold of recordings with these scores; None where they are too few for alpha."""
    n = len(largest)
    rank = math.ceil((n + 1) * (1 - alpha) - 1e-12)
    if n < FEWEST_FOR_ALPHA or rank > n:
        return GroupThreshold(n)
    threshold = float(np.sort(np.array(list(largest.values()), float))[rank - 1])
    return GroupThreshold(n, max(floor, threshold), alpha, float(1 - beta.ppf(0.05, rank, n + 1 - rank)))
