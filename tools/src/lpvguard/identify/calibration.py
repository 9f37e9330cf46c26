"""Stage 5: calibrate the tests by split conformal prediction.

THEORY 7.3 defines the thresholds (T23), their claims (T24) and the thresholds of groups. The compiled core
computes the scores. The core contains one threshold. This is the largest of all thresholds, with which every
claim holds, or the threshold of one named group.
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
"""Relative margin of an exported threshold. The rounding of float, double and fused multiply-add differs by
less (tests/golden/test_one_verdict.py)."""
FEWEST_FOR_ALPHA = 9
"""Least number of recordings for a stated alpha (THEORY 7.3)."""
RATED = ("frame", "pools", "energy", "change")
"""Tests that share a target rate of alarms equally."""
BLOCK_S = 30.0
"""Length of a block of a drive [s]. The maxima of the blocks determine the tail of the scores (THEORY
7.20)."""


@dataclass(frozen=True)
class Recordings:
    """Assignment of drives to recordings. Scores of drives from one recording are not independent.

    Attributes
    ----------
    by_drive : dict[str, str], recording of each drive for which experiments.csv names one
    setting : tuple of str, recordings that have both calibration drives and bound-setting drives
    groups : dict[str, str], group of each drive that has one
    """

    by_drive: dict[str, str] = field(default_factory=dict)
    setting: tuple[str, ...] = ()
    groups: dict[str, str] = field(default_factory=dict)

    @classmethod
    def listed(cls, setting: Iterable[Experiment], others: Iterable[Experiment]) -> Recordings:
        """Recordings of the bound-setting drives and the ``others``, from experiments.csv.

        Raises InputError where drives of one recording belong to several groups, or only some others have a
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
                    f"{other.name} ({other.group or 'none'}) and {e.name} ({e.group or 'none'}) belong "
                    f"to one recording, {e.recording}",
                    "one group for each recording",
                )
        if len({e.group is None for e in others}) > 1:
            without = next(e for e in others if e.group is None)
            raise InputError(
                without.path.parent / EXPERIMENTS,
                "column group",
                f"{without.name} has no group, but other drives have one",
                "a group for every drive that calibrates or is judged, or for no drive",
            )
        return cls(by_drive, tuple(sorted(both)), {e.name: e.group for e in others if e.group is not None})

    def named(self, drive: str) -> str:
        """Recording of a drive."""
        return self.by_drive.get(drive, drive)

    def others(self, drives: Iterable[str], without: str | None) -> list[str]:
        """The ``drives`` that do not belong to the recording of drive ``without``, or all drives for None."""
        return [d for d in drives if without is None or self.named(d) != self.named(without)]

    def in_group(self, scores: Mapping[str, float], group: str) -> dict[str, float]:
        """Those of ``scores`` whose drives belong to a group."""
        return {d: s for d, s in scores.items() if self.groups.get(d) == group}

    def largest(self, scores: Mapping[str, float]) -> dict[str, float]:
        """Largest of the ``scores`` of each recording that did not set the bounds."""
        by_recording: dict[str, float] = {}
        for drive, value in scores.items():
            if (recording := self.named(drive)) not in self.setting:
                by_recording[recording] = max(value, by_recording.get(recording, value))
        return by_recording


NO_RECORDINGS = Recordings()
"""Every drive is a separate recording."""


@dataclass(frozen=True)
class Extrapolation:
    """Threshold from the tail of the scores, for a rate that the data are too short to measure (THEORY 7.20).

    Attributes
    ----------
    per_1000_h : float, target rate of alarms in 1000 judged hours
    hours : float, h, judged time of the recordings
    peaks : int, number of maxima above the level
    level, scale, shape : float, parameters of the generalised Pareto tail
    threshold : float, threshold before the floor of the test applies
    interval : tuple of float, 95 % interval of the rate at the threshold, in 1000 judged hours
    more_h : float, h, further judged time with which no extrapolation is needed
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
        """Sentence with the rate, its data, and the time that would make it exact."""
        low, high = map(number_words, self.interval)
        return (
            f"{self.per_1000_h:g} alarms per 1000 judged hours, extrapolated from {self.hours:.3g} hours "
            f"({self.peaks} peaks, shape {self.shape:.2g}; 95 % interval {low} to {high} per 1000 h); "
            f"{number_words(self.more_h)} more judged hours would make it exact"
        )


@dataclass(frozen=True)
class RateTarget:
    """Target rate of alarms of a test, in place of alpha.

    Attributes
    ----------
    per_1000_h : float, alarms in 1000 judged hours
    confident : bool, whether the rate holds with 95 % confidence
        The threshold then is the upper end of its interval.
    maxima : Mapping, maxima of the score in blocks of BLOCK_S, by drive
    judged_s : Mapping, s, time in counted frames, by drive
    """

    per_1000_h: float
    confident: bool
    maxima: Mapping[str, Sequence[float]]
    judged_s: Mapping[str, float]

    def threshold(self, scores: Mapping[str, float], floor: float, recordings: Recordings) -> GroupThreshold:
        """Threshold of the rate: conformal where the recordings suffice, else from the tail of the scores."""
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
    """Threshold of a group. It is None where the number of ``recordings`` is too small for alpha."""

    recordings: int
    threshold: float | None = None
    alpha: float | None = None
    conditional_bound: float | None = None
    extrapolation: Extrapolation | None = None

    def to_dict(self) -> dict:
        """Convert to JSON types, for `from_dict`."""
        return _with_extrapolation({k: v for k, v in vars(self).items() if k != "extrapolation"}, self)

    @classmethod
    def from_dict(cls, data: dict) -> GroupThreshold:
        """Threshold from the result of `to_dict`."""
        return cls(**(data | _extrapolation_of(data)))

    def words(self, group: str) -> str:
        """Claim for a further recording of the ``group``, in words."""
        if self.extrapolation is not None:
            return f"group {group}: threshold {self.threshold:.4g}, {self.extrapolation.words()}"
        if self.alpha is None:
            return (
                f"group {group}: {self.recordings} recordings are too few for a separate threshold; "
                "the group has the pooled threshold without alpha"
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
    threshold : float, pooled threshold, or the largest score where no claim is possible
    scores : dict[str, float], by drive
    alpha : float or None, bound of the probability of an alarm on a further recording, None without a claim
    conditional_bound : float or None
        Bound on this probability for the given calibration recordings, with 95 % confidence.
    recordings : Recordings
    groups : dict[str, GroupThreshold], threshold of each group of experiments.csv
    group : str or None, group of this threshold (``of_group``), None for the pooled one
    judged_s : dict[str, float], s, time in counted frames by drive, empty without a claim per hour
    target : RateTarget or None, target rate in place of alpha
    extrapolation : Extrapolation or None, extrapolation of the pooled threshold
    joint : Calibration or None
        Calibration of all tests together, which decides threshold and claim. None: the test has its own.
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
    joint: Calibration | None = None

    def over(self, judged_s: Mapping[str, float]) -> Calibration:
        """The calibration with the judged time of every drive [s], for claims per hour."""
        return replace(self, judged_s={d: judged_s[d] for d in self.scores})

    @property
    def carried(self) -> float:
        """Threshold in the core.

        It is that of ``group``, or the largest of the pooled one and those of all groups.
        """
        own = [] if self.group else [g.threshold for g in self.groups.values() if g.threshold is not None]
        return max([self.threshold, *own])

    @property
    def exported(self) -> float:
        """Threshold with the margin for rounding, as exported to the core."""
        return self.carried * (1 + ROUNDING)

    def of_group(self, group: str | None) -> Calibration:
        """Calibration for drives of a group, with its threshold, or with the pooled one without alpha.

        For drives without a group (None) the threshold is that of the core.
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
            joint=None if self.joint is None else self.joint.of_group(group),
        )

    @property
    def stated(self) -> str:
        """Threshold of the core with its claim, in words; without the claim where it is of all tests."""
        return f"threshold {self.carried:.4g}" + ("" if self.joint else f" ({self.claim()})")

    @property
    def decided_by(self) -> str | None:
        """Drive whose score equals the threshold of the core, or None if the floor decides."""
        if self.joint is not None:
            return self.joint.decided_by
        return next((d for d, s in self.scores.items() if s == self.carried), None)

    def to_dict(self) -> dict:
        """Convert to JSON types, without ``joint``.

        ``recordings`` and ``groups`` exist only if experiments.csv names any.
        """
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
        """Claim about the false alarms at this threshold, in words."""
        if self.joint is not None:
            return f"all tests together: {self.joint.claim()}"
        if not self.groups:
            return self._pooled_claim()
        small = [] if self.group else [n for n, g in self.groups.items() if g.threshold is None]
        named = small if len(small) > 1 else []
        claims = [
            g.words(name) + self._hourly(self.recordings.in_group(self.scores, name), g)
            for name, g in self.groups.items()
            if name not in named
        ]
        if named:
            claims.append(
                f"groups {', '.join(named)}: too few recordings for separate thresholds; they have the "
                "pooled threshold without alpha"
            )
        if self.group is not None:
            return claims[0]
        claims = [f"pooled: {self._pooled_claim()}", *claims]
        return f"{'; '.join(claims)}; the core has the largest, {self.carried:.4g}"

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
            f"alpha is not stated: {len(self.scores)} drives calibrate, from {self.units()} that did not "
            "set the bounds; drives of one recording are not independent"
            + (f", and {beside} drives belong to recordings that set the bounds" if beside else "")
        )

    @property
    def hourly(self) -> str:
        """Text that extends the pooled claim by its rate per judged hour, empty without a claim."""
        return self._hourly(self.scores, self)

    def _hourly(self, scores: Mapping[str, float], threshold: GroupThreshold | Calibration) -> str:
        """Rate per judged hour of recordings with these ``scores``, as text.

        It holds for a further recording with their mean judged time.
        """
        counted = self.recordings.largest(scores)
        drives = [d for d in scores if self.recordings.named(d) in counted]
        hours = sum(self.judged_s.get(d, 0.0) for d in drives) / 3600
        if threshold.alpha is None or threshold.conditional_bound is None or not hours:
            return ""
        rate, bound = (x * len(counted) / hours for x in (threshold.alpha, threshold.conditional_bound))
        return f"; {rate:.3g} and {bound:.3g} per judged hour, from {hours:.3g} h"


@dataclass(frozen=True)
class Peak:
    """Time and place of the largest score of a drive.

    ``t_s`` is the time after the first sample. ``place`` is the bin, or the band of the energy test, or None
    if unknown. ``without`` is the score of the drive without this frame and those of its bin that overlap it.
    It is None for tests without frames.
    """

    t_s: float
    place: int | None = None
    without: float | None = None


def _with_extrapolation(out: dict, threshold: GroupThreshold | Calibration) -> dict:
    """Add the extrapolation, if any, to ``out``."""
    if threshold.extrapolation is not None:
        out["extrapolation"] = vars(threshold.extrapolation)
    return out


def _extrapolation_of(data: dict) -> dict:
    """Field of the extrapolation from ``data``, empty without one."""
    extrapolation = data.get("extrapolation")
    if extrapolation is None:
        return {}
    return {"extrapolation": Extrapolation(**extrapolation | {"interval": tuple(extrapolation["interval"])})}


def block_of(t_s: np.ndarray | float) -> np.ndarray:
    """Numbers (n,) of the blocks of BLOCK_S that contain times (n,) [s] after the first sample of a drive."""
    return (np.asarray(t_s) // BLOCK_S).astype(int)


def block_maxima(run: Run, t0: float, Ts: float) -> dict[str, list[float]]:
    """Maxima of the scores of the frame, energy and change test in each block of a drive.

    They are 0 where a test judges nothing. ``t0`` is the time of the first sample [s].
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
    """Peak of every test that judged the drive.

    ``t0`` is the time of the first sample [s]. ``length`` (K,) is the length of a frame in samples.
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
    float, or None without a counted frame
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


def calibrate(
    scores: Mapping[str, float],
    alpha: float,
    *,
    floor: float = 1.0,
    unstated_floor: float | None = None,
    recordings: Recordings = NO_RECORDINGS,
    target: RateTarget | None = None,
) -> Calibration:
    """Compute the pooled threshold and that of every group from the scores of the calibration drives.

    Parameters
    ----------
    scores : Mapping, score by drive
    alpha : float, probability of an alarm on a further recording
    floor : float, least threshold, default 1.0, because a margin of 1 falsifies nothing
    unstated_floor : float, optional, least threshold without alpha, by default ``floor``
    recordings : Recordings, default NO_RECORDINGS
    target : RateTarget, optional, target rate in place of alpha

    Returns
    -------
    Calibration, whose threshold is the largest score if there are too few drives

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
    """Conformal threshold from the scores of recordings. It is None where they are too few for alpha."""
    n = len(largest)
    rank = math.ceil((n + 1) * (1 - alpha) - 1e-12)
    if n < FEWEST_FOR_ALPHA or rank > n:
        return GroupThreshold(n)
    threshold = float(np.sort(np.array(list(largest.values()), float))[rank - 1])
    return GroupThreshold(n, max(floor, threshold), alpha, float(1 - beta.ppf(0.05, rank, n + 1 - rank)))
