"""Tails of declustered maxima against laws whose rates are known."""

import numpy as np
import pytest

from lpvguard.base.tails import Peaks, Tail, separate

BLOCKS_PER_H = 120


def peaks_of(scores: np.ndarray) -> Peaks:
    names = [str(i) for i in range(len(scores))]
    hours = dict.fromkeys(names, scores.shape[1] / BLOCKS_PER_H)
    peaks = Peaks.from_maxima({n: [x] for n, x in zip(names, scores, strict=True)}, hours)
    assert peaks is not None
    return peaks


def test_neighbours_of_a_larger_maximum_are_no_peaks_of_their_own():
    assert separate([1.0, 5.0, 4.0, 3.0, 0.0, 2.0]) == [5.0, 3.0, 2.0]
    assert separate([0.0, 0.0]) == [] == separate([])


def test_the_level_leaves_the_largest_maxima():
    scores = np.random.default_rng(1).exponential(size=(40, 30))
    peaks = peaks_of(scores)
    every = sorted(p for x in scores for p in separate(x))
    assert peaks.level == every[-len(peaks.excess) - 1]
    assert sorted(peaks.excess + peaks.level) == every[-len(peaks.excess) :]
    assert len(peaks.excess) == int(2 * len(every) ** (2 / 3))
    assert Peaks.from_maxima({"a": [[1.0] * 30]}, {"a": 0.25}) is None


@pytest.mark.parametrize("shape", [0.0, 0.3])
def test_a_long_record_has_the_rate_of_its_law(shape):
    x = np.random.default_rng(2).exponential(size=(4000, 30))
    tail = Tail.fitted(peaks_of(x if shape == 0 else np.expm1(shape * x) / shape))
    assert tail.shape == pytest.approx(shape, abs=0.06)
    for rate in (0.1, 0.01, 0.001):
        z = tail.threshold(rate)
        true = BLOCKS_PER_H * (np.exp(-z) if shape == 0 else (1 + shape * z) ** (-1 / shape))
        assert tail.rate(z) == pytest.approx(rate)
        low, high = tail.interval(z)
        assert low <= true <= high and 0.3 < true / rate < 3
        assert tail.confident_threshold(rate) > z


def test_a_bounded_tail_is_taken_for_an_exponential_one():
    tail = Tail.fitted(peaks_of(np.random.default_rng(3).uniform(size=(100, 30))))
    assert tail.shape == pytest.approx(0.0, abs=1e-6)
    assert tail.threshold(1e-3) > 1.0
    assert tail.interval(tail.threshold(1e-3))[0] == 0.0


def test_recordings_that_differ_widen_the_interval():
    random = np.random.default_rng(4)
    alike = random.exponential(size=(60, 30))
    differing = alike / random.gamma(4.0, 0.25, size=(60, 1))
    width = []
    for scores in (alike, differing):
        tail = Tail.fitted(peaks_of(scores))
        width.append(tail.interval(tail.threshold(0.01))[1])
    assert width[1] > 2 * width[0]
