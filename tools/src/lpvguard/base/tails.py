"""Generalised Pareto tails of declustered maxima: rates of exceedance beyond the data (THEORY 7.20).

Peaks are maxima of blocks that do not adjoin a larger one. Above the level u they have the rate lambda, and
excesses of scale sigma and shape xi. The threshold z is exceeded at the rate

    R(z) = lambda (1 + xi (z - u) / sigma)^(-1 / xi)

Intervals are those of the profile likelihood. Peaks of one recording depend on each other. The deviance is
divided by the ratio of the sandwich variance, clustered by recordings, to that of the model.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy.optimize import brentq, minimize
from scipy.stats import t as student

FEWEST_PEAKS = 10
"""Fewest peaks of which a tail is fitted."""
SHAPES = (0.0, 1.5)
"""Shapes that a fit may take. No bound of the scores is assumed, so none is negative."""
SHAPE_POINTS, GRID_SPREAD = 61, 3.0
"""Shapes of the grid of a profile; half its width in standard deviations of log lambda."""
FARTHEST = 40.0
"""Largest |log| of a rate or threshold over its estimate that an interval is searched to."""


@dataclass(frozen=True)
class Peaks:
    """Declustered maxima above a level.

    Attributes
    ----------
    level : float
    excess : ndarray (n,), peaks minus the level
    cluster : ndarray (n,) of int, recording of each peak
    hours : ndarray (recordings,), hours of each recording
    """

    level: float
    excess: np.ndarray
    cluster: np.ndarray
    hours: np.ndarray

    @classmethod
    def from_maxima(
        cls, maxima: Mapping[str, Sequence[Sequence[float]]], hours: Mapping[str, float]
    ) -> Peaks | None:
        """Peaks of recordings, each a list of drives with the maxima of their blocks.

        The level lies below the 2 n^(2/3) largest of n maxima that do not adjoin, or below half of them where
        these are fewer. None for fewer than FEWEST_PEAKS.
        """
        peaks = [
            (peak, i) for i, drives in enumerate(maxima.values()) for x in drives for peak in separate(x)
        ]
        peaks.sort(reverse=True)
        wanted = int(min(len(peaks) / 2, max(20, 2 * len(peaks) ** (2 / 3))))
        if wanted < FEWEST_PEAKS:
            return None
        level = peaks[wanted][0]
        excess, cluster = np.array(peaks[:wanted]).T
        return cls(level, excess - level, cluster.astype(int), np.array([hours[n] for n in maxima], float))


def separate(blocks: Sequence[float]) -> list[float]:
    """Take the largest of blocks, then the largest of those that do not adjoin it, and so on; none of 0.

    Parameters
    ----------
    blocks : Sequence of float, maxima of successive blocks

    Returns
    -------
    list of float, falling
    """
    left, maxima = np.array(blocks, float), []
    while len(left) and (k := int(left.argmax())) >= 0 and left[k] > 0:
        maxima.append(float(left[k]))
        left[max(0, k - 1) : k + 2] = 0.0
    return maxima


@dataclass(frozen=True)
class Tail:
    """Tail fitted to peaks by maximum likelihood.

    Attributes
    ----------
    peaks : Peaks
    scale, shape : float
    """

    peaks: Peaks
    scale: float
    shape: float

    @classmethod
    def fitted(cls, peaks: Peaks) -> Tail:
        """Fit the tail."""
        mean = float(peaks.excess.mean())

        def negative(p: np.ndarray) -> float:
            return -float(_log_likelihood(peaks.excess, mean * np.exp(p[0]), p[1]).sum())

        bounds = [(-5.0, 5.0), SHAPES]
        best = minimize(negative, [0.0, 0.1], method="Nelder-Mead", bounds=bounds)
        return cls(peaks, mean * float(np.exp(best.x[0])), float(best.x[1]))

    @property
    def frequency(self) -> float:
        """Peaks an hour, lambda."""
        return len(self.peaks.excess) / float(self.peaks.hours.sum())

    def threshold(self, rate: float) -> float:
        """Threshold that is exceeded ``rate`` times an hour; the level where peaks are rarer."""
        return self.peaks.level + self.scale * float(_stretch(max(1.0, self.frequency / rate), self.shape))

    def rate(self, threshold: float) -> float:
        """Exceedances of the threshold an hour, at or above the level."""
        x = (threshold - self.peaks.level) / self.scale
        if abs(self.shape) < 1e-6:
            return self.frequency * float(np.exp(-x))
        return self.frequency * max(0.0, 1 + self.shape * x) ** (-1 / self.shape)

    @cached_property
    def _best(self) -> float:
        return self._joint(self.frequency, self.scale, self.shape)

    def _joint(self, frequency: float, scale: float, shape: float) -> float:
        """Log-likelihood of number and sizes of the peaks."""
        n, hours = len(self.peaks.excess), float(self.peaks.hours.sum())
        of_sizes = float(_log_likelihood(self.peaks.excess, scale, shape).sum())
        return n * float(np.log(frequency)) - frequency * hours + of_sizes

    def deviance(self, threshold: float, rate: float) -> float:
        """Twice the log-likelihood lost where ``threshold`` is exceeded ``rate`` times an hour."""
        excess, n = self.peaks.excess, len(self.peaks.excess)
        spread = GRID_SPREAD / np.sqrt(n)
        frequency = max(self.frequency, rate * np.exp(spread)) * np.exp(np.linspace(-spread, spread, 9)[1:])
        shape = np.linspace(SHAPES[0] + 1e-6, SHAPES[1], SHAPE_POINTS)[:, None]
        log = np.log(frequency / rate)
        with np.errstate(divide="ignore", invalid="ignore"):
            scale = (threshold - self.peaks.level) * shape / np.expm1(shape * log)
            inside = 1 + (shape / scale)[..., None] * excess
            sizes = -n * np.log(scale) - (1 + 1 / shape) * np.log(inside).sum(axis=-1)
        whole = sizes + n * np.log(frequency) - frequency * float(self.peaks.hours.sum())
        best = np.where(np.isfinite(whole), whole, -np.inf).max(axis=1)
        return max(0.0, 2 * (self._best - _vertex(best)))

    def _lost(self, quantile: float, rate: float) -> float:
        """Deviance within which a rate agrees with the peaks, by Student's t over the recordings."""
        t = float(student.ppf(quantile, max(1, len(self.peaks.hours) - 1)))
        return t**2 * self._correction(rate)

    def _correction(self, rate: float) -> float:
        """Variance of the threshold at ``rate``, clustered by recordings, over that of the model; 1 at least.

        Also 1 where the likelihood has no curvature in all directions.
        """
        p = np.array([np.log(self.frequency), np.log(self.scale), self.shape])
        per_peak = [_shifted(self._each, p, i) for i in range(3)]
        hours, cluster = self.peaks.hours, self.peaks.cluster
        scores = np.array([np.bincount(cluster, s, len(hours)) for s in per_peak]).T
        scores[:, 0] = np.bincount(cluster, minlength=len(hours)) - self.frequency * hours
        information = np.zeros((3, 3))
        information[0, 0] = len(self.peaks.excess)
        for i in (1, 2):
            information[i, 1:] = [
                -_shifted(lambda q, i=i: _shifted(self._each, q, i).sum(), p, j) for j in (1, 2)
            ]
        z = [_shifted(lambda q: _level_at(q, rate), p, i) for i in range(3)]
        try:
            along = np.linalg.solve(information, z)
        except np.linalg.LinAlgError:
            return 1.0
        model, count = float(along @ z), len(hours)
        clustered = float(((scores @ along) ** 2).sum()) * count / max(1, count - 1)
        return max(1.0, clustered / model) if model > 0 and np.isfinite(clustered) else 1.0

    def _each(self, p: np.ndarray) -> np.ndarray:
        return _log_likelihood(self.peaks.excess, float(np.exp(p[1])), p[2])

    def interval(self, threshold: float) -> tuple[float, float]:
        """Interval of 95 % of the exceedances of ``threshold`` an hour.

        Its lower end is 0 where the shape may be 0: the tail may then be bounded.
        """
        estimate = max(self.rate(threshold), 1e-300)
        lost = self._lost(0.975, estimate)
        middle = float(np.log(estimate))

        def beyond(log_rate: float) -> float:
            return self.deviance(threshold, float(np.exp(log_rate))) - lost

        most = float(np.log(5 * self.frequency))
        bounded = self._joint(self.frequency, float(self.peaks.excess.mean()), 0.0)
        low = None if 2 * (self._best - bounded) < lost else _crossing(beyond, middle, middle - FARTHEST)
        high = _crossing(beyond, middle, max(most, middle + 1e-6))
        return (0.0 if low is None else float(np.exp(low))), float(np.exp(most if high is None else high))

    def confident_threshold(self, rate: float) -> float:
        """Least threshold that with 95 % confidence is exceeded at most ``rate`` times an hour; or
        infinity."""
        middle = float(np.log(self.threshold(rate) - self.peaks.level))
        lost = self._lost(0.95, rate)

        def beyond(log_above: float) -> float:
            return self.deviance(self.peaks.level + float(np.exp(log_above)), rate) - lost

        high = _crossing(beyond, middle, middle + FARTHEST)
        return float("inf") if high is None else self.peaks.level + float(np.exp(high))


def _vertex(values: np.ndarray) -> float:
    """Largest of ``values`` on an even grid, by the parabola through it and its neighbours."""
    i = int(values.argmax())
    left, middle, right = values[max(0, i - 1)], values[i], values[min(len(values) - 1, i + 1)]
    bend = left - 2 * middle + right
    if i in (0, len(values) - 1) or not bend < 0 or not np.isfinite(left + right):
        return float(middle)
    return float(middle - (right - left) ** 2 / (8 * bend))


def _crossing(beyond, inside: float, outside: float) -> float | None:
    """Root of ``beyond`` between a point inside an interval and one outside; None where that is inside."""
    step, last = np.sign(outside - inside) * 0.5, inside
    while abs(last - inside) < abs(outside - inside):
        point = last + step
        if beyond(point) > 0:
            return float(brentq(beyond, last, point, xtol=1e-3)) if beyond(last) < 0 else last
        last, step = point, step * 1.5
    return None


def _stretch(ratio: float, shape: float) -> float:
    """(ratio^shape - 1) / shape."""
    log = float(np.log(ratio))
    return log if abs(shape) < 1e-6 else float(np.expm1(shape * log)) / shape


def _level_at(p: np.ndarray, rate: float) -> float:
    return float(np.exp(p[1])) * _stretch(float(np.exp(p[0])) / rate, p[2])


def _shifted(function, p: np.ndarray, i: int):
    """Central difference of ``function`` at ``p`` along its entry i."""
    step = np.zeros(3)
    step[i] = 1e-4
    return (function(p + step) - function(p - step)) / 2e-4


def _log_likelihood(excess: np.ndarray, scale: float, shape: float) -> np.ndarray:
    """Log-likelihood (n,) of excesses."""
    body = np.log1p(shape * excess / scale) / shape if abs(shape) > 1e-6 else excess / scale
    return -np.log(scale) - body * (1 + shape)
