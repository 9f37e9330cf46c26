"""Stage 5, calibration of the frame test and of the energy test by split conformal prediction.

Each test is calibrated by itself, or both together (`joint_scores`). The exchangeable unit is the recording
(THEORY 7.3): a drive, or all drives that experiments.csv says are pieces of one.

A drive's score is the largest k-of-m statistic over its counted frames, or the largest ratio of the energy
test, read from the compiled core. A recording's score is the largest of its drives. The threshold is the
ceil((n + 1)(1 - alpha))-th smallest score of n recordings of which no drive set the bounds. A further,
exchangeable recording then alarms with probability at most alpha. With n < 1/alpha - 1 no finite threshold
has that property, and alpha is not stated.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field

import numpy as np
from scipy.stats import beta

from ..core.compiled import Run
from ..drives.tables import Experiment

FEWEST_FOR_ALPHA = 9
"""Below this many recordings no alpha is stated at all (THEORY 7.3)."""


@dataclass(frozen=True)
class Recordings:
    """Which drives are pieces of one recording: their scores are no draws of their own.

    of: drive -> recording, where experiments.csv says so; any other is a recording of its own. setting:
    recordings of calibration drives that also set the bounds.
    """

    of: dict[str, str] = field(default_factory=dict)
    setting: tuple[str, ...] = ()

    @classmethod
    def listed(cls, setting: Iterable[Experiment], others: Iterable[Experiment]) -> Recordings:
        """Those of the drives that set the bounds and of the ``others``, as experiments.csv has them."""
        setting, others = list(setting), list(others)
        both = {e.recording for e in setting} & {e.recording for e in others}
        of = {e.name: e.recording for e in (*setting, *others) if e.recording != e.name}
        return cls(of, tuple(sorted(both)))

    def named(self, drive: str) -> str:
        """The recording that ``drive`` is a piece of."""
        return self.of.get(drive, drive)

    def others(self, drives: Iterable[str], without: str | None) -> list[str]:
        """The ``drives`` that are no pieces of the recording of drive ``without``; None: all."""
        return [d for d in drives if without is None or self.named(d) != self.named(without)]

    def largest(self, scores: Mapping[str, float]) -> dict[str, float]:
        """Score of every recording that did not set the bounds, from the ``scores`` of its drives."""
        found: dict[str, float] = {}
        for drive, value in scores.items():
            if (recording := self.named(drive)) not in self.setting:
                found[recording] = max(value, found.get(recording, value))
        return found


NO_RECORDINGS = Recordings()
"""Every drive is a recording of its own."""


@dataclass(frozen=True)
class Calibration:
    """``scores``: by drive. ``alpha`` and ``conditional_bound`` are None where no claim can be made; then the
    threshold is the largest score.

    conditional_bound: with 95 % confidence over the calibration recordings, the false-alarm probability of a
    further one is below this number.
    """

    threshold: float
    scores: dict[str, float]
    alpha: float | None
    conditional_bound: float | None
    recordings: Recordings = NO_RECORDINGS

    def to_dict(self) -> dict:
        """JSON-able, for `from_dict`; ``recordings`` where experiments.csv names any."""
        own = {k: v for k, v in vars(self).items() if k != "recordings"}
        if self.recordings == NO_RECORDINGS:
            return own
        return own | {"recordings": {"of": self.recordings.of, "setting": list(self.recordings.setting)}}

    @classmethod
    def from_dict(cls, data: dict) -> Calibration:
        """From what `to_dict` gave."""
        named = data.get("recordings", {"of": {}, "setting": ()})
        return cls(**data | {"recordings": Recordings(named["of"], tuple(named["setting"]))})

    def units(self) -> str:
        """How many drives or recordings calibrate, in words."""
        count = len(self.recordings.largest(self.scores))
        return f"{count} recordings" if self.recordings.of else f"{count} drives"

    def claim(self) -> str:
        """What may be said of the threshold's false alarms, in words; never a threshold without it."""
        if self.alpha is not None:
            return (
                f"alpha {self.alpha:g} from {self.units()}, with 95 % confidence below "
                f"{self.conditional_bound:.3f}"
            )
        if self.recordings == NO_RECORDINGS:
            return f"alpha is not stated: too few calibration drives ({len(self.scores)})"
        beside = sum(self.recordings.named(d) in self.recordings.setting for d in self.scores)
        return (
            f"alpha is not stated: {len(self.scores)} drives calibrate, of {self.units()} that did not "
            "set the bounds; pieces of one recording are no draws of their own"
            + (f", and {beside} are of recordings that set the bounds" if beside else "")
        )


def score(run: Run) -> float | None:
    """Score of a drive; None when no frame counted."""
    counted = run.frames.counted
    return float(run.frames.statistic[counted].max()) if counted.any() else None


def energy_score(run: Run) -> float | None:
    """Score of a drive in the energy test: its largest ratio; None when it was never judged."""
    return float(run.energy.max()) if (run.energy > 0).any() else None


def joint_scores(frame: dict[str, float], energy: dict[str, float]) -> dict[str, float]:
    """Scores of both tests together, per drive the larger of ``frame`` and ``energy``.

    A margin and a ratio are both the least inflation of the bounds with which the data agree. The bounds are
    W_delta and B_w, or W_delta and sigma. One threshold therefore serves for the larger. A monitor of both
    tests with it alarms on a further drive, by either, with probability at most alpha. With each test at its
    own threshold that probability is at most twice alpha.
    """
    return {n: max(s[n] for s in (frame, energy) if n in s) for n in {**frame, **energy}}


def calibrate(
    scores: Mapping[str, float],
    alpha: float,
    *,
    floor: float = 1.0,
    recordings: Recordings = NO_RECORDINGS,
) -> Calibration:
    """Threshold from the scores of the calibration drives, at least ``floor``: a margin of 1 falsifies
    nothing."""
    values = np.sort(np.array(list(recordings.largest(scores).values()), float))
    n = len(values)
    rank = math.ceil((n + 1) * (1 - alpha) - 1e-12)
    if n < FEWEST_FOR_ALPHA or rank > n:
        return Calibration(max([floor, *scores.values()]), dict(scores), None, None, recordings)
    return Calibration(
        threshold=max(floor, float(values[rank - 1])),
        scores=dict(scores),
        alpha=alpha,
        conditional_bound=float(1 - beta.ppf(0.05, rank, n + 1 - rank)),
        recordings=recordings,
    )
