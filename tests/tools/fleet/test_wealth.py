"""The wealth of a life: its claims, each against a simulation or a sum of its own."""

import numpy as np
import pytest
from scipy.stats import beta, binomtest

from lpvguard.base.errors import InputError
from lpvguard.extras.fleet.wealth import (
    LEVELS,
    MOST,
    Life,
    LifeTable,
    _all_hold,
    factors,
    put_aside,
    ranks,
    simultaneous_tails,
    stepped,
)

SIZES = (1, 2, 5, 11, 100, 400)


@pytest.mark.parametrize("n", SIZES)
def test_levels_are_the_largest_scores_and_ever_fewer(n):
    rank = ranks(n)
    assert rank[-1] == n and (np.diff(rank) > 0).all() and 1 <= len(rank) <= LEVELS
    assert len(rank) == 1 or rank[0] >= n / 2


@pytest.mark.slow("3 s: random lives")
@pytest.mark.parametrize("eta", [0.05, 0.3])
@pytest.mark.parametrize("n", SIZES)
def test_all_tails_hold_with_the_stated_probability(n, eta):
    tails = simultaneous_tails(n, eta)
    uniform = np.sort(np.random.default_rng(n).random((40_000, n)), axis=1)[:, ranks(n) - 1]
    hold = (1 - uniform <= tails).all(axis=1)
    assert binomtest(int(hold.sum()), len(hold), 1 - eta).pvalue > 1e-4
    wider = (1 - uniform <= tails * 0.9).all(axis=1)
    assert binomtest(int(wider.sum()), len(wider), 1 - eta).pvalue < 1e-4


def test_the_recursion_is_the_integral_over_two_order_statistics():
    # P(U_(1) >= a and U_(2) >= b) of two uniform numbers, a <= b: (1 - a)^2 - (b - a)^2.
    a, b = 0.2, 0.7
    assert _all_hold(2, np.array([1, 2]), np.array([a, b])) == pytest.approx((1 - a) ** 2 - (b - a) ** 2)
    assert simultaneous_tails(1, 0.05) == pytest.approx([1 - beta.ppf(0.05, 1, 1)])


@pytest.mark.unhurried
@pytest.mark.parametrize("n", SIZES)
def test_no_law_within_the_tails_lets_a_bet_grow_and_one_beyond_does(n):
    tails, random = simultaneous_tails(n, 0.05), np.random.default_rng(1)
    bets = factors(tails).astype(float)

    def expected(t: np.ndarray) -> np.ndarray:
        return -np.diff(np.r_[1.0, t, 0.0]) @ bets

    assert (expected(tails) <= 1 - 2.0**-21).all() and (expected(tails) > 1 - 2.0**-19).all()
    for _ in range(200):
        within = np.minimum.accumulate(tails * random.random(len(tails)))
        assert (expected(within) < 1).all()
    assert (expected(np.minimum(1.0, tails * 1.02)) > 1).all()
    assert (np.diff(bets, axis=0) > 0).all()


def many_lives(table: LifeTable, places, recordings: int, lives: int) -> np.ndarray:
    """The recording that alarms first, 0 for never, of so many lives; ``places(t)``: of recording t."""
    bets, first = np.zeros((lives, table.factors.shape[1]), np.float32), np.zeros(lives, int)
    for t in range(recordings):
        bets, whole = stepped(bets, t, table.factors[places(t)])
        first = np.where((first == 0) & (whole >= table.alarm), t + 1, first)
    return first


@pytest.mark.unhurried
@pytest.mark.parametrize("n", [11, 100])
def test_the_worst_law_alarms_in_a_life_at_most_at_the_stated_rate(n):
    alpha, lives = 0.2, 4000
    table = LifeTable.from_scores(np.arange(n), alpha, 0.05)
    tails, random = simultaneous_tails(n, 0.05), np.random.default_rng(2)

    def from_tails(t: np.ndarray):
        return lambda _: (random.random((lives, 1)) < t).sum(axis=1)

    alarmed = int((many_lives(table, from_tails(tails), 1000, lives) > 0).sum())
    assert binomtest(alarmed, lives, alpha, alternative="greater").pvalue > 1e-3
    assert alarmed > 0.3 * alpha * lives  # the bound is not idle
    beyond = (many_lives(table, from_tails(np.minimum(1, 1.5 * tails)), 1000, lives) > 0).mean()
    assert beyond > 0.9


def test_one_life_is_as_many():
    table = LifeTable.from_scores(np.random.default_rng(3).random(40), 0.05, 0.05)
    scores = np.random.default_rng(4).random(300) + np.linspace(0, 0.8, 300)
    places = table.place(scores)
    life, wealth = Life(), []
    for place in places:
        life = life.after(int(place), table)
        wealth.append(life.wealth)
    assert life.changed_at == many_lives(table, lambda t: places[t : t + 1], 300, 1)[0] > 0
    first = next(i for i, w in enumerate(wealth, start=1) if w >= 1 / 0.05)
    assert life.changed_at == first
    assert Life().wealth == 1.0 and life.recordings == 300


def test_a_score_equal_to_a_level_is_not_above_it():
    table = LifeTable.from_scores([1.0, 2.0, 3.0, 4.0], 0.05, 0.05)
    assert table.levels.tolist() == [3.0, 4.0]
    assert table.place([2.9, 3.0, 3.1, 4.0, 4.1]).tolist() == [0, 0, 1, 1, 2]


def test_the_earliest_alarm_is_the_one_that_comes():
    for n, expected in ((11, 7), (100, 3)):
        table = LifeTable.from_scores(np.arange(n), 0.05, 0.05)
        life, count = Life(), 0
        while not life.changed_at:
            life, count = life.after(len(table.levels), table), count + 1
        assert table.earliest(Life()) == count == expected
        assert table.earliest(life) == 0
    assert LifeTable.from_scores([1.0], 1e-30, 0.05).earliest(Life()) is None


def test_wealth_stays_finite_and_counts_end():
    table = LifeTable.from_scores(np.arange(100), 0.05, 0.05)
    life = Life()
    for _ in range(200):
        life = life.after(len(table.levels), table)
    assert np.isfinite(life.wealth) and life.changed_at == 3
    last = Life(MOST, (0.0, 0.0, 0.0)).after(0, table)
    assert last.recordings == MOST and last.bets == (0.0, 0.0, 0.0)
    assert put_aside(MOST) == put_aside(MOST + 1) > 0


@pytest.mark.parametrize(
    ("scores", "alpha", "eta", "what"),
    [
        ([], 0.05, 0.05, "no score"),
        ([1.0, np.nan], 0.05, 0.05, "not finite"),
        ([1.0], 0.0, 0.05, "alpha"),
        ([1.0], 0.05, 1.0, "eta"),
    ],
)
def test_what_is_no_calibration_is_refused(scores, alpha, eta, what):
    with pytest.raises(InputError, match=what):
        LifeTable.from_scores(scores, alpha, eta)
