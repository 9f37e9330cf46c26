"""Wealth of a vehicle over its life: a conformal test martingale of a fixed calibration set (THEORY 7.8).

n scores calibrate, of recordings like those of a healthy life. A further score is compared with LEVELS of
them at most: the largest, the second, the fourth, and so on. Its *place* is the number of levels below it.
With probability 1 - eta over the calibration set, all true tails are within `simultaneous_tails` (T35). Every
bet's expected factor is then at most 1 for whatever law has such tails (T36). Wealth is a non-negative
supermartingale from 1, so it reaches 1/alpha with probability at most alpha, in a life of any length (T37).

Money is put on the bets step by step, for a change may begin late. Arithmetic is that of the core
(life.cpp), in 32-bit floats and its order, so that both have the same bits. Factors are rounded down
by more than the rounding of a step adds.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import numpy as np
from scipy.optimize import brentq
from scipy.stats import beta, binom

from ...base.errors import InputError

LEVELS = 8
"""Of the calibration scores a new one is compared with so many at most."""
POWERS = (0.1, 0.3, 0.6)
"""The bets: each is on tails t becoming t ** power."""
START = 64
"""After so many recordings half of the money is on the bets."""
MOST = 2**24 - 1 - START
"""Recordings that are counted. Floats count no further; from then on no money is added."""
ROUNDED_DOWN = 1 - 2.0**-20
"""Of every factor. A step of floats adds less than 2 ** -22 of the wealth."""
CEILING = np.float32(1e30)
"""A bet's wealth is cut here."""


def ranks(n: int) -> np.ndarray:
    """Ranks (K,) of the levels among n sorted scores, the largest is n; ascending."""
    above = 2 ** np.arange(LEVELS)
    return (n + 1 - above[above <= max(1, (n + 1) // 2)])[::-1]


def _all_hold(n: int, rank: np.ndarray, low: np.ndarray) -> float:
    """Probability that each order statistic ``rank`` (K,) of n uniform numbers is at least ``low`` (K,), both
    ascending: fewer than rank numbers lie below each low."""
    law, before = np.r_[1.0, np.zeros(n)], 0.0
    counts = np.arange(n + 1)
    for k, x in zip(rank, low, strict=True):
        step = binom.pmf(
            counts[None, :] - counts[:, None], (n - counts)[:, None], (x - before) / (1 - before)
        )
        law = np.where(counts < k, law @ step, 0.0)
        before = x
    return float(law.sum())


def simultaneous_tails(n: int, eta: float) -> np.ndarray:
    """Upper bounds (K,) of the probabilities that a further score exceeds the levels (T35), descending.

    With probability 1 - eta over n independent scores all hold. Each is the bound of Clopper and Pearson, all
    at one rate, which is exact by a recursion over the levels. InputError without a score."""
    if n < 1:
        raise InputError("calibration", "", "no score", "at least one")
    rank = ranks(n)

    def low(each: float) -> np.ndarray:
        return beta.ppf(each, rank, n + 1 - rank)

    if len(rank) == 1:
        return 1 - low(eta)
    lacking = brentq(lambda x: _all_hold(n, rank, low(x)) - (1 - eta), eta / len(rank), eta, xtol=1e-12)
    return 1 - low(lacking * (1 - 1e-9))


def factors(tails: np.ndarray) -> np.ndarray:
    """What each bet is multiplied by at each place, (K + 1, bets), float32 (T36); ``tails`` (K,)."""
    edges = np.r_[1.0, tails, 0.0][:, None]
    ideal = -np.diff(edges ** np.array(POWERS), axis=0) / -np.diff(edges, axis=0)
    return np.nextafter((ideal * ROUNDED_DOWN).astype(np.float32), np.float32(0))


def alarm_wealth(alpha: float) -> np.float32:
    """1/alpha, not rounded down."""
    return np.nextafter(np.float32(1 / alpha), np.float32(np.inf))


@dataclass(frozen=True)
class LifeTable:
    """What a calibration set gives: ``levels`` (K,) ascending float32, ``factors`` (K + 1, bets) float32."""

    n: int
    alpha: float
    eta: float
    levels: np.ndarray
    factors: np.ndarray

    @classmethod
    def of(cls, scores: Iterable[float], alpha: float, eta: float) -> LifeTable:
        """From the scores of the recordings that calibrate, in whatever order. InputError for a score that is
        not finite, for none, and for rates outside (0, 1)."""
        sorted_scores = np.sort(np.array(list(scores), np.float32))
        for name, value in (("alpha", alpha), ("eta", eta)):
            if not 0 < value < 1:
                raise InputError("life", name, f"{value:g}", "a number between 0 and 1")
        if not np.isfinite(sorted_scores).all():
            raise InputError("calibration", "", "a score that is not finite", "finite scores")
        n = len(sorted_scores)
        tails = simultaneous_tails(n, eta)
        return cls(n, alpha, eta, sorted_scores[ranks(n) - 1], factors(tails))

    @property
    def alarm(self) -> np.float32:
        """The wealth that alarms."""
        return alarm_wealth(self.alpha)

    def place(self, score: np.ndarray | float) -> np.ndarray:
        """How many levels are below each score (N,), or below one; an equal score is not above a level."""
        return np.searchsorted(self.levels, np.asarray(score, np.float32), side="left")

    def earliest(self, life: Life) -> int | None:
        """Further recordings above all n with which the wealth of a life alarms first; 0: it has; None: not
        within MOST."""
        count = 0
        while not life.changed_at:
            if count >= 1000:
                return None
            life, count = life.after(len(self.levels), self), count + 1
        return count


def put_aside(recordings: int) -> np.float32:
    """Share of the money that is not on the bets yet, float32."""
    start = np.float32(START)
    return start / (start + np.float32(min(recordings, MOST)))


def stepped(bets: np.ndarray, recordings: int, factor: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """One recording: wealth of the bets (..., bets) after ``recordings``, times ``factor`` (..., bets) of the
    place; and the whole wealth (...). float32, operation by operation as the core."""
    rest = put_aside(recordings + 1)
    added = (put_aside(recordings) - rest) / np.float32(len(POWERS))
    bets = np.minimum((bets + added) * factor, CEILING)
    whole = bets[..., 0]
    for i in range(1, len(POWERS)):
        whole = whole + bets[..., i]
    return bets, whole + rest


@dataclass(frozen=True)
class Life:
    """The state of a vehicle. ``bets``: wealth of each. ``changed_at``: number of the recording with which
    the wealth first reached 1/alpha; 0: never."""

    recordings: int = 0
    bets: Sequence[float] = (0.0,) * len(POWERS)
    changed_at: int = 0

    @property
    def wealth(self) -> float:
        """The whole wealth; 1 at first."""
        whole = np.float32(self.bets[0])
        for bet in self.bets[1:]:
            whole = whole + np.float32(bet)
        return float(whole + put_aside(self.recordings))

    def after(self, place: int, table: LifeTable) -> Life:
        """After a recording whose score is at ``place``."""
        bets, whole = stepped(np.array(self.bets, np.float32), self.recordings, table.factors[place])
        count = min(self.recordings + 1, MOST)
        changed = self.changed_at or (count if whole >= table.alarm else 0)
        return Life(count, tuple(map(float, bets)), changed)
