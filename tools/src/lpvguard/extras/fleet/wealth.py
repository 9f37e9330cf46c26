"""Wealth of a vehicle over its life: a conformal test martingale with a fixed calibration set (THEORY 7.8).

The calibration set has n scores of recordings like those of a healthy life. A further score is compared with
at most LEVELS of them: the largest, the second largest, the fourth largest, and so on. Its *place* is the
number of levels below it. With probability 1 - eta over the calibration set, all true tail probabilities are
within `simultaneous_tails` (T35). The expected factor of every bet is then at most 1 for any distribution
with such tails (T36). Wealth is a non-negative supermartingale from 1, so it reaches 1/alpha with probability
at most alpha, in a life of any length (T37).

Money is put on the bets step by step, because a change may begin late. The arithmetic equals that of the core
(lib/src/services/life.cpp): 32-bit floats in the same order, so that both give the same bits. Factors are
rounded down by more than the rounding error of a step.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import numpy as np
from scipy.optimize import brentq
from scipy.stats import beta, binom

from ...base.errors import InputError

LEVELS = 8
"""Largest number of calibration scores that a new score is compared with."""
POWERS = (0.1, 0.3, 0.6)
"""Powers of the bets: each bet assumes that tail probabilities t become t ** power."""
START = 64
"""Number of recordings after which half of the money is on the bets."""
MOST = 2**24 - 1 - START
"""Largest number of counted recordings, because floats cannot count further. Then no money is added."""
ROUNDED_DOWN = 1 - 2.0**-20
"""Every factor is rounded down by this share. Rounding in a step adds less than 2 ** -22 of the wealth."""
CEILING = np.float32(1e30)
"""Largest wealth of a bet."""


def ranks(n: int) -> np.ndarray:
    """Return the ranks of the levels among n sorted scores; the largest is n.

    Parameters
    ----------
    n : int, number of scores

    Returns
    -------
    ndarray (K,) of int, ascending
    """
    above = 2 ** np.arange(LEVELS)
    return (n + 1 - above[above <= max(1, (n + 1) // 2)])[::-1]


def _all_hold(n: int, rank: np.ndarray, low: np.ndarray) -> float:
    """Probability that all order statistics ``rank`` (K,) of n uniform numbers are at least ``low`` (K,).

    Both arrays ascend; fewer than ``rank`` numbers then lie below each ``low``.
    """
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
    """Bound the probabilities that a further score exceeds the levels.

    With probability 1 - eta over n independent scores all bounds hold. They are Clopper-Pearson bounds with
    one common rate. A recursion over the levels gives this rate exactly.

    Parameters
    ----------
    n : int, number of scores
    eta : float

    Returns
    -------
    ndarray (K,), descending

    Raises
    ------
    InputError
        If n is 0.

    References
    ----------
    THEORY 7.8, (T35).
    """
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
    """Compute the factor of each bet at each place.

    Parameters
    ----------
    tails : ndarray (K,), of `simultaneous_tails`

    Returns
    -------
    ndarray (K + 1, bets) of float32

    References
    ----------
    THEORY 7.8, (T36).
    """
    edges = np.r_[1.0, tails, 0.0][:, None]
    ideal = -np.diff(edges ** np.array(POWERS), axis=0) / -np.diff(edges, axis=0)
    return np.nextafter((ideal * ROUNDED_DOWN).astype(np.float32), np.float32(0))


def alarm_wealth(alpha: float) -> np.float32:
    """Return the alarm level of the wealth, 1/alpha, never rounded down.

    Parameters
    ----------
    alpha : float

    Returns
    -------
    float32

    References
    ----------
    THEORY 7.8, (T37).
    """
    return np.nextafter(np.float32(1 / alpha), np.float32(np.inf))


@dataclass(frozen=True)
class LifeTable:
    """Table of a calibration set.

    Attributes
    ----------
    n : int, number of scores
    alpha, eta : float
    levels : ndarray (K,) of float32, ascending
    factors : ndarray (K + 1, bets) of float32
    """

    n: int
    alpha: float
    eta: float
    levels: np.ndarray
    factors: np.ndarray

    @classmethod
    def from_scores(cls, scores: Iterable[float], alpha: float, eta: float) -> LifeTable:
        """Table from calibration scores in any order.

        Raises InputError for no score, a score that is not finite, and rates outside (0, 1).
        """
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
        """Alarm level of the wealth."""
        return alarm_wealth(self.alpha)

    def place(self, score: np.ndarray | float) -> np.ndarray:
        """Number of levels below each score (N,) or below one score; an equal level does not count."""
        return np.searchsorted(self.levels, np.asarray(score, np.float32), side="left")

    def earliest(self, life: Life) -> int | None:
        """Number of further recordings until a life alarms if all their scores exceed the n scores.

        It is 0 if the life has alarmed, and None if it cannot alarm within MOST recordings.
        """
        count = 0
        while not life.changed_at:
            if count >= 1000:
                return None
            life, count = life.after(len(self.levels), self), count + 1
        return count


def put_aside(recordings: int) -> np.float32:
    """Share of the money that is not yet on the bets, float32."""
    start = np.float32(START)
    return start / (start + np.float32(min(recordings, MOST)))


def stepped(bets: np.ndarray, recordings: int, factor: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Update the wealth by one recording, in float32 and the core's order of operations.

    Parameters
    ----------
    bets : ndarray (..., bets), wealth of the bets
    recordings : int, number before this recording
    factor : ndarray (..., bets), factors at the score's place

    Returns
    -------
    tuple of the wealth of each bet, ndarray (..., bets), and the total wealth, ndarray (...)

    References
    ----------
    THEORY 7.8, (T36).
    """
    rest = put_aside(recordings + 1)
    added = (put_aside(recordings) - rest) / np.float32(len(POWERS))
    bets = np.minimum((bets + added) * factor, CEILING)
    whole = bets[..., 0]
    for i in range(1, len(POWERS)):
        whole = whole + bets[..., i]
    return bets, whole + rest


@dataclass(frozen=True)
class Life:
    """Wealth of a vehicle.

    Attributes
    ----------
    recordings : int, counted so far
    bets : Sequence[float], wealth of each bet
    changed_at : int, number of the recording at which the wealth first reached 1/alpha; 0: never
    """

    recordings: int = 0
    bets: Sequence[float] = (0.0,) * len(POWERS)
    changed_at: int = 0

    @property
    def wealth(self) -> float:
        """The total wealth, 1 at the start."""
        whole = np.float32(self.bets[0])
        for bet in self.bets[1:]:
            whole = whole + np.float32(bet)
        return float(whole + put_aside(self.recordings))

    def after(self, place: int, table: LifeTable) -> Life:
        """This life after a further recording with a score at ``place``."""
        bets, whole = stepped(np.array(self.bets, np.float32), self.recordings, table.factors[place])
        count = min(self.recordings + 1, MOST)
        changed = self.changed_at or (count if whole >= table.alarm else 0)
        return Life(count, tuple(map(float, bets)), changed)
