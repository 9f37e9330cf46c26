"""Stage 5, calibration of the frame test and of the energy test by split conformal prediction.

Each test is calibrated by itself, or both together (`joint_scores`). The exchangeable unit is the drive
(THEORY 7.3).

A drive's score is the largest k-of-m statistic over its counted frames, or the largest ratio of the energy
test, read from the compiled core. The threshold is the ceil((n + 1)(1 - alpha))-th smallest score of n
calibration drives. A further, exchangeable drive then alarms with probability at most alpha. With n < 1/alpha
- 1 no finite threshold has that property, and alpha is not stated.
"""

from __future__ import annotations

import math
from dataclasses import asdict, dataclass

import numpy as np
from scipy.stats import beta

from ..core.compiled import Run

FEWEST_FOR_ALPHA = 9
"""Below this many calibration drives no alpha is stated at all (THEORY 7.3)."""


@dataclass(frozen=True)
class Calibration:
    """``alpha`` and ``conditional_bound`` are None where no claim can be made; then the threshold is the
    largest score.

    conditional_bound: with 95 % confidence over the calibration drives, the false-alarm probability of a
    further drive is below this number.
    """

    threshold: float
    scores: dict[str, float]
    alpha: float | None
    conditional_bound: float | None

    def to_dict(self) -> dict:
        """JSON-able; the constructor takes it back."""
        return asdict(self)

    def claim(self) -> str:
        """What may be said of the threshold's false alarms, in words; never a threshold without it."""
        if self.alpha is None:
            return f"alpha is not stated: too few calibration drives ({len(self.scores)})"
        return (
            f"alpha {self.alpha:g} from {len(self.scores)} drives, with 95 % confidence below "
            f"{self.conditional_bound:.3f}"
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


def calibrate(scores: dict[str, float], alpha: float, *, floor: float = 1.0) -> Calibration:
    """Threshold from the scores of the calibration drives, at least ``floor``: a margin of 1 falsifies
    nothing."""
    values = np.sort(np.array(list(scores.values()), float))
    n = len(values)
    if n == 0:
        return Calibration(floor, {}, None, None)
    rank = math.ceil((n + 1) * (1 - alpha) - 1e-12)
    stated = n >= FEWEST_FOR_ALPHA and rank <= n
    rank = min(rank, n)
    return Calibration(
        threshold=max(floor, float(values[rank - 1])),
        scores=dict(scores),
        alpha=alpha if stated else None,
        conditional_bound=float(1 - beta.ppf(0.05, rank, n + 1 - rank)) if stated else None,
    )
