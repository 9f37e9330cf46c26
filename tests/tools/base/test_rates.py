"""Rates with exact intervals, and false alarms counted in pieces, drives, recordings and hours."""

import numpy as np
import pytest

from lpvguard.base.rates import hourly_words, per_hour, rate, share_words
from lpvguard.evaluate.false_alarms import FalseAlarms


def test_rates_have_exact_intervals():
    # Clopper and Pearson: 0 of n ends at 1 - 0.025^(1/n); 5 of 10 is 18.71 to 81.29 %.
    assert rate(0, 2000)["interval"] == pytest.approx([0.0, 1 - 0.025 ** (1 / 2000)])
    assert rate(5, 10)["interval"] == pytest.approx([0.1871, 0.8129], abs=1e-4)
    assert rate(3, 3)["interval"][1] == 1.0 and rate(0, 0)["interval"] is None


def test_alarms_an_hour_have_exact_intervals():
    # Poisson: none in h hours ends at -ln(0.025)/h; 10 events are 4.795 to 18.391 (Garwood).
    assert per_hour(0, 100.0)["interval"] == pytest.approx([0.0, -np.log(0.025) / 100])
    assert per_hour(10, 2.0)["interval"] == pytest.approx([4.7954 / 2, 18.3904 / 2], rel=1e-4)
    assert per_hour(10, 2.0)["rate"] == 5.0 and per_hour(0, 0.0)["interval"] is None


def test_no_interval_is_of_zero_width():
    for total in (1, 2, 11, 5000):
        for count in {0, 1, total // 2, total}:
            share, hourly = rate(count, total)["interval"], per_hour(count, 0.01 * total)["interval"]
            assert share[0] <= count / total <= share[1] and share[1] - share[0] > 1e-4
            assert hourly[0] <= count / (0.01 * total) <= hourly[1] and hourly[1] - hourly[0] > 1e-2


@pytest.mark.parametrize(("p", "n"), [(0.02, 11), (0.1, 30), (0.5, 5)])
def test_the_intervals_cover_with_95_percent(p, n):
    random = np.random.default_rng(8)
    share = [rate(int(c), n)["interval"] for c in random.binomial(n, p, 2000)]
    hourly = [per_hour(int(c), n / 10)["interval"] for c in random.poisson(p * n / 10, 2000)]
    for intervals in (share, hourly):
        assert np.mean([low <= p <= high for low, high in intervals]) >= 0.94


def test_false_alarms_are_counted_in_pieces_drives_recordings_and_by_the_hour_judged():
    counted = FalseAlarms.from_counts([(2, 3), (0, 1), (1, 2)], [100.0, 0.0, 260.0], ["a", "b", "a"])
    assert (counted.drives, counted.alarmed_drives, counted.alarmed, counted.pieces) == (3, 2, 3, 6)
    assert counted.judged_h == pytest.approx(0.1) and counted.per_judged_h == pytest.approx(30.0)
    assert counted.recordings == rate(1, 2), "two alarmed pieces of one recording are one"
    assert counted.recordings_per_judged_h == per_hour(1, counted.judged_h)
    assert share_words(counted.recordings) == "1 of 2, 1.26 to 98.74 %"
    assert hourly_words(counted.recordings_per_judged_h) == "10.00, 0.25 to 55.72"


def test_of_nothing_no_rate_is_stated():
    unjudged = FalseAlarms.from_counts([(1, 1)], [0.0], ["a"])
    assert unjudged.per_judged_h is None and unjudged.recordings["interval"] is not None
    assert hourly_words(unjudged.recordings_per_judged_h) == "–"
    none = FalseAlarms.from_counts([], [], [])
    assert (none.drives, none.alarmed_drives, none.pieces, none.per_judged_h) == (0, 0, 0, None)
    assert share_words(none.recordings) == "–"
