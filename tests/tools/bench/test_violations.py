"""The search for violations: histories are admissible, a violation that is known is found, and none where a
bound is known."""

import numpy as np
import pytest

from lpvguard.engine.synthesis.interconnection import rational
from lpvguard.engine.synthesis.lpv_certificate import Family
from lpvguard.engine.synthesis.statespace import StateSpace, lft, series, zero_order_hold
from lpvguard.engine.synthesis.varying import OverSpeed
from lpvguard.extras.bench import _violations as violations
from lpvguard.extras.bench._violations import (
    Loop,
    Search,
    SpeedGrid,
    closed_period,
    drawn_corners,
    fastest_growth,
    injected,
    least_violating,
    ramps,
    sinusoid,
    triangle,
)

TS = 0.1


def turning(size: float, coupled: float = 0.0) -> Family:
    """x(k+1) = A(v) x, one Δ of gain ``size``: stable at every speed of 0..1, and not where the speed turns
    A's direction to and fro. ``coupled``: Δ's share in A."""
    low, high = np.array([[0.5, 2.0], [0.0, 0.5]]), np.array([[0.5, 0.0], [2.0, 0.5]])

    def at(v: float) -> StateSpace:
        A = size * ((1 - v) * low + v * high)
        B = np.array([[coupled, 1.0], [0.0, 1.0]])
        C = np.array([[coupled, 0.0], [0.1, 0.1]])
        return StateSpace(A, B, C, np.zeros((2, 2)), TS)

    return Family(at, np.array([0.0, 1.0]), slice(0, 0), 0, lambda low, high: (np.zeros((0, 0)),) * 2, TS)


def steps_of(speeds: np.ndarray) -> float:
    return float(np.abs(np.diff(speeds)).max()) / TS


def test_the_window_of_a_history_is_cut_at_the_range_and_is_no_wider_than_it_may_run():
    grid = SpeedGrid.for_rate(0.0, 100.0, 0.1, TS)
    assert grid.near(np.array([500.0, 502.5, 504.0])) == (499, 505)
    assert grid.near(np.full(9, 2.0)) == (0, 6)
    last = grid.places - 1
    assert grid.near(np.full(9, float(last))) == (last - 4, last)


@pytest.mark.parametrize("rate", [0.004, 0.15, 3.0])
def test_profiles_stay_in_the_range_and_move_at_the_largest_rate_and_no_faster(rate):
    grid, random = SpeedGrid.for_rate(8.0, 9.0, rate, TS), np.random.default_rng(1)
    assert grid.unit <= violations.UNIT and grid.moves * grid.unit == pytest.approx(rate * TS)
    samples = int(4 / (rate * TS)) + 20
    profiles = [
        triangle(grid, samples, 8.0, 9.0, 0.3),
        sinusoid(grid, samples, 8.0, 9.0, 0.1),
        ramps(grid, samples, random.uniform(8.0, 9.0, 4), 5),
    ]
    for speeds in profiles:
        assert speeds.shape == (samples,) and speeds.min() >= 8.0 and speeds.max() <= 9.0 + 1e-12
        assert 0.5 * rate < steps_of(speeds) <= rate * (1 + 1e-9)
        period = closed_period(grid, speeds)
        assert steps_of(np.append(period, period[0])) <= rate * (1 + 1e-9)
        assert (period[: len(speeds)] == speeds).all()
    assert np.ptp(profiles[0]) == pytest.approx(1.0, abs=0.5 * rate * TS + 0.02)


@pytest.mark.unhurried
def test_growth_is_found_from_the_rate_on_at_which_it_begins():
    """The periodic triangle decides: below some rate the loop is stable in every cell it passes."""
    loop = Loop(OverSpeed(injected(turning(0.6, 0.01))), 1, TS)
    fast, period = fastest_growth(loop, 10.0, 60, 1)
    assert fast > 1 and steps_of(np.append(period, period[0])) <= 10.0 * (1 + 1e-9)
    assert fastest_growth(loop, 0.02, 60, 1)[0] < 1
    still = Loop(OverSpeed(injected(turning(0.2, 0.01))), 1, TS)  # ‖A‖ < 1 at every speed: no history grows
    assert fastest_growth(still, 10.0, 60, 1)[0] < 1


def test_the_search_climbs_above_every_start_and_stops_where_it_is_told_to():
    loop = Loop(OverSpeed(turning(0.6, 0.3)), 1, TS)
    search, rate = Search(loop, 60, 2), 3.0
    violation = search.at(rate)
    grid = SpeedGrid.for_rate(0.0, 1.0, rate, TS)
    starts = [triangle(grid, 60, 0.0, 1.0, share) for share in (0.0, 0.25, 0.5, 0.75)]
    reached = [
        loop.history(speeds, loop.delta(((sign, np.inf),))).gain(search.first, 8)[0]
        for speeds in starts
        for sign in (1.0, -1.0)
    ]
    assert violation.gain > 1.05 * max(reached) and steps_of(violation.speeds) <= rate * (1 + 1e-9)
    again = loop.history(violation.speeds, loop.delta(violation.corners)).states(violation.w)[1]
    assert np.linalg.norm(again) / np.linalg.norm(violation.w) == pytest.approx(violation.gain)
    assert search.at(rate).gain == violation.gain  # the seed decides
    early = search.at(rate, 0.1)
    assert 0.1 < early.gain < violation.gain


def test_without_delta_the_speeds_alone_are_searched():
    violation = Search(Loop(OverSpeed(turning(0.6)), 0, TS), 40, 3).at(5.0)
    assert violation.corners == () and violation.gain > 0


def lpvtools_example(rho: float) -> StateSpace:
    """From [ξ, d] to [η, e]: the worst-case example of LPVTools' manual, after Pfifer and Seiler (2014).

    G = K/(tau s + 1), half a second of delay by a second-order Padé approximation, Δ of size 0.1 at the
    input, and a PI controller, all over rho in 2..7. Sampled with its inputs held.
    """
    tau, K = np.sqrt(133.6 - 16.8 * rho), np.sqrt(4.8 * rho - 8.6)
    Kp, Ki, Td = (2 * 0.7 * 0.25 * tau - 1) / K, 0.25**2 * tau / K, 0.5
    delay = rational([Td**2 / 12, -Td / 2, 1], [Td**2 / 12, Td / 2, 1])
    P = series(StateSpace([[-1 / tau]], [[1 / tau]], [[K]], [[0.0]]), delay)
    B = np.hstack([0.1 * P.B, np.zeros((P.order, 1)), P.B])
    D = np.array([[0.0, 0.0, 1.0], [0.0, 1.0, 0.0], [0.0, 1.0, 0.0]])
    open_loop = StateSpace(P.A, B, np.vstack([np.zeros((1, P.order)), -P.C, -P.C]), D)
    return zero_order_hold(lft(open_loop, StateSpace([[0.0]], [[Ki]], [[1.0]], [[Kp]])), TS)


@pytest.mark.slow("3 s: a search for the worst run")
def test_the_published_example_of_lpvtools_is_bracketed_by_its_published_bounds(monkeypatch):
    """For |d rho/dt| <= 0.1 its manual proves at most 1.8925, and without a bound on the rate 63.87. It shows
    1.2968 with the frozen loops' worst Δ; ours, also a constant, comes with a history chosen for it."""
    monkeypatch.setattr(violations, "CORNERS", (np.inf,))
    nodes, nothing = np.linspace(2.0, 7.0, 51), np.zeros((0, 0))
    family = Family(lpvtools_example, nodes, slice(0, 0), 0, lambda low, high: (nothing, nothing), TS)
    search = Search(Loop(OverSpeed(family), 1, TS), 900, 1)
    slow, fast = search.at(0.1), search.at(20.0)
    assert 1.2968 < slow.gain < 1.8925
    assert slow.gain < fast.gain < 63.87


@pytest.mark.parametrize("threshold", [0.3, 7.0, 40.0])
def test_the_least_rate_is_bracketed(threshold):
    asked = []

    def violates(rate: float) -> bool:
        asked.append(rate)
        return rate > threshold

    bracket = least_violating(violates, 50.0, 0.01)
    assert bracket.without <= threshold < bracket.rate <= violations.PRECISION * bracket.without
    assert len(asked) < 12


def test_the_ladder_ends_where_nothing_or_everything_violates():
    assert least_violating(lambda rate: False, 50.0, 0.01) == violations.LeastRate(None, 50.0)
    bracket = least_violating(lambda rate: True, 50.0, 0.01)
    assert bracket.without == 0 and 0.01 <= bracket.rate < 0.04


def test_drawn_all_passes_have_both_signs_and_constants_among_them():
    drawn = [one for _ in range(50) for one in drawn_corners(np.random.default_rng(_), 2)]
    assert {sign for sign, _ in drawn} == {1.0, -1.0}
    assert 0.2 < np.mean([np.isinf(corner) for _, corner in drawn]) < 0.5
