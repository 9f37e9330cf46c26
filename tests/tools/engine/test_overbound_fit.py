"""The decisions of a weight's fit, by themselves: which orders are tried and chosen, how a candidate becomes
a weight, and when it is refitted."""

import math

import numpy as np
import pytest

from lpvguard.base.errors import InputError
from lpvguard.engine.overbound import fit
from lpvguard.engine.overbound.bound import SampledBound
from lpvguard.engine.overbound.certificate import Certificate, squared, verify_overbound
from lpvguard.engine.overbound.minimax import Grid, MinimaxFit
from lpvguard.engine.overbound.weight import Weight


def test_orders_go_from_the_lowest_that_is_proper_to_eight():
    for proper, lowest in (("biproper", 0), ("strict", 1)):
        for order in (None, lowest, 8):
            assert fit._lowest_order("here", 8 if order is None else order, order, 0.0, proper) == lowest
        for wrong in (lowest - 1, 9, 2.0):
            with pytest.raises(InputError, match=f"here: order: .*from {lowest} to 8"):
                fit._lowest_order("here", 4, wrong, 0.0, proper)
            with pytest.raises(InputError, match="here: max_order"):
                fit._lowest_order("here", wrong, None, 0.0, proper)
    for tol_db in (-1e-9, math.inf, math.nan):
        with pytest.raises(InputError, match="tol_db"):
            fit._lowest_order("here", 4, None, tol_db, "biproper")
    with pytest.raises(InputError, match="'biproper' or 'strict'"):
        fit._lowest_order("here", 4, None, 0.3, "")


@pytest.mark.parametrize(
    ("ratios_db", "tol_db", "order"),
    [
        ([1.0, 0.75], 0.25, 0),
        ([1.0, 0.75], 0.249, 1),
        ([5.0, 5.0, 1.0], 1.0, 2),
        ([5.0, 5.0, 1.0], 2.0, 0),
        ([5.0, 5.0, 1.0], 4.0, 0),
        ([5.0, 2.0, 1.5, 1.2], 0.5, 1),
        ([3.0], 0.0, 0),
        ([3.0, 3.0], 0.0, 0),
    ],
)
def test_the_order_chosen_is_the_smallest_of_which_no_higher_one_gains_the_tolerance_a_state(
    ratios_db, tol_db, order
):
    fits = {n: MinimaxFit(n, *[np.ones(1)] * 2, r, 0.0, np.ones(1)) for n, r in enumerate(ratios_db)}
    assert fit._choose(fits, tol_db) == order
    assert fit._choose({n + 1: f for n, f in fits.items()}, tol_db) == order + 1


class Tried:
    """The orders that a fit tries, with given worst ratios, and those that it closes.

    ``falls_back``: orders that come back as the one below; ``fails``: orders of which no weight is certified.
    """

    def __init__(self, monkeypatch, ratios_db, *, falls_back=(), fails=()):
        self.orders: list[tuple[int, int | None]] = []
        self.closed: list[tuple[int, int | None]] = []
        certificate = verify_overbound(Weight([2.0], [1.0]), [1.0], [1.0])

        def least(grid, n, lower):
            self.orders.append((n, None if lower is None else lower.order))
            return MinimaxFit(n - (n in falls_back), *[np.ones(1)] * 2, ratios_db[n], 0.0, np.ones(1))

        def close(grid, candidate, lower):
            n = candidate.order
            self.closed.append((n, None if lower is None else lower.order))
            return None if n in fails else (Weight([1.0], np.ones(n + 1)), 1.5, certificate, 0.25)

        monkeypatch.setattr(fit, "least_worst_ratio", least)
        monkeypatch.setattr(fit, "_close", close)

    def fit(self, **options) -> fit.OverboundFit:
        return fit.fit_overbound([1.0, 2.0], [1.0, 1.0], **options)


def test_orders_to_four_are_tried_and_three_tenths_of_a_db_pay_for_a_state(monkeypatch):
    for step, chosen in ((0.301, 4), (0.299, 0)):
        tried = Tried(monkeypatch, [9.0 - step * n for n in range(9)])
        scaling = tried.fit()
        assert tried.orders == [(0, None), (1, 0), (2, 1), (3, 2), (4, 3)]
        assert tried.closed == [(chosen, chosen - 1 if chosen else None)] and scaling.order == chosen
        assert (scaling.inflation, scaling.lp_optimum_db) == (1.5, 0.25)
        assert (
            scaling.worst_ratio_db == scaling.ratios_db[chosen] == pytest.approx(20 * math.log10(2), rel=1e-6)
        )
        assert {n: r for n, r in scaling.ratios_db.items() if n != chosen} == {
            n: 9.0 - step * n for n in range(5) if n != chosen
        }
    tried = Tried(monkeypatch, [9.0 - n for n in range(9)])
    assert tried.fit(max_order=2, tol_db=0.5).order == 2 and len(tried.orders) == 3


def test_a_given_order_is_tried_with_those_below_it_alone(monkeypatch):
    tried = Tried(monkeypatch, [0.1] * 9)
    assert tried.fit(order=2).order == 2
    assert [n for n, _ in tried.orders] == [0, 1, 2] and tried.closed == [(2, 1)]
    assert tried.fit(order=6, proper="strict").order == 6
    assert [n for n, _ in tried.orders[3:]] == [1, 2, 3, 4, 5, 6] and tried.orders[3] == (1, None)


def test_no_order_is_tried_above_one_that_no_other_can_better_by_the_tolerance(monkeypatch):
    for second, n_tried in ((0.3, 2), (0.3001, 3)):
        tried = Tried(monkeypatch, [9.0, second, 0.2, 0.2, 0.2])
        assert tried.fit().order == 1 and len(tried.orders) == n_tried


def test_the_next_lower_order_is_taken_where_one_falls_back_or_cannot_be_certified(monkeypatch):
    tried = Tried(monkeypatch, [9.0, 8.0, 1.0], falls_back=[2])
    assert tried.fit(order=2).order == 1 and tried.closed == [(1, 0)]
    tried = Tried(monkeypatch, [9.0, 8.0, 1.0], fails=[2, 1])
    assert tried.fit(order=2).order == 0 and tried.closed == [(2, 1), (1, 0), (0, None)]
    tried = Tried(monkeypatch, [9.0, 8.0, 1.0], fails=[2, 1, 0])
    with pytest.raises(InputError, match="weight fit: order 2: no weight could be certified"):
        tried.fit(order=2)
    tried = Tried(monkeypatch, [9.0, 8.0, 1.0], fails=[1])
    with pytest.raises(InputError, match="W: order 1: no weight could be certified"):
        tried.fit(order=1, proper="strict", name="W")


def test_what_is_no_bound_of_a_fit_is_told_by_its_name():
    for name, prefix in (("", "weight fit: "), ("W_delta", "W_delta: ")):
        with pytest.raises(InputError, match=f"^{prefix}"):
            fit.fit_overbound([1.0], [np.nan], name=name)


@pytest.mark.parametrize("gain", [1.0, 0.5, 3.0])
def test_a_candidate_is_lifted_to_its_bound_by_its_spectral_factors(gain):
    """W in the units of the samples, times a gain: the inflation makes up for one below 1."""
    W = Weight([2.0, 6.0, 8.0], [1.0, 3.0, 2.0])
    omega = np.geomspace(0.1, 100.0, 400)
    samples = SampledBound.read("here", omega, 0.25 * W.magnitude(omega), None)
    top = 9.0 * gain**2 * squared(0.25 * W.num / samples.level, samples.unit)
    bottom = 9.0 * squared(W.den, samples.unit)
    candidate = MinimaxFit(2, np.pad(top, (0, 1)), np.pad(bottom, (0, 1)), 0.0, 0.0, np.ones(1))
    weight, inflation, certificate = fit._lift(Grid(samples, False), candidate)
    assert certificate.ok and 1.0 <= certificate.min_ratio < (1 + 1e-8 if gain <= 1 else 3.01)
    assert inflation == pytest.approx(max(1.0, 1 / gain), rel=1e-4) and (inflation == 1.0) == (gain == 3.0)
    np.testing.assert_allclose(weight.den, W.den, rtol=1e-6)
    np.testing.assert_allclose(weight.num, 0.25 * gain * inflation * W.num, rtol=1e-6)
    assert weight.den[0] == 1.0


@pytest.mark.parametrize(
    ("least", "calls", "inflation"),
    [
        ([1.5], 1, 1.0),
        ([0.5, 1.0], 2, 2.0),
        ([0.5, 0.8, 0.9], 3, 1 / 0.36),
        ([0.5, 0.0], 2, 2.0),
        ([0.0], 1, 1.0),
    ],
)
def test_a_candidate_is_lifted_by_what_the_certificate_finds_three_times_at_most(
    least, calls, inflation, monkeypatch
):
    """Each time by a trillionth more; what has no ratio is not lifted."""
    asked: list[float] = []

    def verify(weight, omega, bound):
        asked.append(weight.num[0])
        ratio = least[len(asked) - 1]
        return Certificate(ratio >= 1.0, True, True, ratio, 1.0, 2.0, 1.0, 9.0, 1, ())

    monkeypatch.setattr(fit, "verify_overbound", verify)
    samples = SampledBound.read("here", [1.0, 2.0], [1.0, 1.0], None)
    candidate = MinimaxFit(0, np.ones(1), np.ones(1), 0.0, 0.0, np.ones(1))
    _, lift, certificate = fit._lift(Grid(samples, False), candidate)
    assert len(asked) == calls and certificate.min_ratio == least[-1]
    lifts = sum(0.0 < r < 1.0 for r in least)
    assert lift == pytest.approx(inflation * (1 + lifts * 1e-12), rel=1e-14)
    assert asked[-1] == pytest.approx(lift * (0.9 if calls == 3 else 1.0), rel=1e-11)


class Closing:
    """A candidate's refits: the worst ratios [dB] that the certificate finds, NaN where it proves nothing."""

    def __init__(self, monkeypatch, found_db, *, order=3):
        self.inserted: list[list[float]] = []
        self.refitted: list[tuple] = []
        self.order = order
        self.found = iter(found_db)
        samples = SampledBound.read("here", [1.0, 16.0], [1.0, 1.0], None)
        self.grid = Grid(samples, False)
        assert samples.unit == 4.0
        monkeypatch.setattr(self.grid, "insert", lambda y: self.inserted.append(y.tolist()))
        monkeypatch.setattr(fit, "_lift", self.lift)
        monkeypatch.setattr(fit, "least_worst_ratio", self.refit)

    def lift(self, grid, candidate):
        db = next(self.found)
        certificate = Certificate(
            bool(db == db), True, True, 1.0, 2.0, 10 ** (np.nan_to_num(db) / 20), 8.0, 9.0, 1, ()
        )
        return len(self.inserted), 1.5, certificate

    def refit(self, *arguments):
        self.refitted.append(arguments)
        return MinimaxFit(self.order, *[np.ones(1)] * 2, 0.0, 0.25, np.ones(1))

    def close(self, lower_db=1.0, lower_order=None):
        candidate = MinimaxFit(3, *[np.ones(1)] * 2, 0.0, lower_db, np.ones(1))
        return fit._close(self.grid, candidate, lower_order)


def test_a_candidate_that_is_near_its_lower_limit_is_closed_at_once(monkeypatch):
    for over, refits in ((0.00799, 0), (0.00801, 1)):
        closing = Closing(monkeypatch, [1.0 + over, 0.25])
        weight, inflation, _, lower_db = closing.close()
        assert (weight, inflation, lower_db) == (refits, 1.5, (1.0, 0.25)[refits])
        assert len(closing.refitted) == refits


def test_a_refit_takes_the_places_of_the_worst_ratios_and_the_best_certified_one_is_kept(monkeypatch):
    closing = Closing(monkeypatch, [np.nan, 5.0, 6.0, 4.0, np.nan, 7.0, 8.0, 9.0, 0.0])
    lower = MinimaxFit(2, *[np.ones(1)] * 2, 4.0, 0.0, np.ones(1))
    weight, _, certificate, lower_db = closing.close(lower_order=lower)
    assert weight == 3 and certificate.max_ratio == pytest.approx(10**0.2) and lower_db == 0.25
    assert closing.inserted == [[0.25, 4.0]] * 8, "(2 / 4)^2 and (8 / 4)^2, eight times"
    grid, order, below, last = closing.refitted[0]
    assert (grid, order, below) == (closing.grid, 3, lower) and last.lower_db == 1.0
    assert closing.refitted[1][3].lower_db == 0.25
    assert Closing(monkeypatch, [np.nan] * 8).close() is None


def test_a_weight_worse_than_the_lower_order_is_none(monkeypatch):
    for over, closed in ((0.0019, True), (0.0021, False)):
        lower = MinimaxFit(2, *[np.ones(1)] * 2, 5.0 - over, 0.0, np.ones(1))
        assert (Closing(monkeypatch, [5.0] * 8).close(lower_order=lower) is not None) == closed
    assert Closing(monkeypatch, [5.0] * 8).close() is not None
    # A refit that comes back as the lower order ends the search, with what was certified before.
    closing = Closing(monkeypatch, [5.0, 4.0], order=2)
    lower = MinimaxFit(2, *[np.ones(1)] * 2, 5.0, 0.0, np.ones(1))
    assert closing.close(lower_order=lower)[0] == 0 and len(closing.refitted) == 1
    assert Closing(monkeypatch, [np.nan], order=2).close(lower_order=lower) is None


def test_breaks_outside_are_those_beyond_the_samples_in_order():
    W = Weight(np.real(np.poly([-1.5, -10.0, -0.2])), np.real(np.poly([-2.0, -0.5, -1 - 2j, -1 + 2j])))
    samples = SampledBound.read("here", [1.0, 3.0], [1.0, 1.0], None)
    assert fit._outside(W, samples) == pytest.approx((0.2, 0.5, 10.0))
    exact = Weight([1.0, 1.0], [1.0, 3.0])
    assert fit._outside(exact, samples) == (), "a break at a sample is not outside"


@pytest.mark.parametrize("p", [[3.0], [2.0, 1.0], [1.0, 3.0, 2.0], [0.5, 1.0, 4.0], [-1.0, -3.0, -3.0, -1.0]])
def test_a_spectral_factor_has_the_square_and_its_roots_on_the_left(p):
    factor = fit._spectral_factor(squared(np.array(p), 1.0))
    np.testing.assert_allclose(factor, np.abs(p), rtol=1e-4)
    mirrored = np.array(p) * (-1.0) ** np.arange(len(p))
    np.testing.assert_allclose(fit._spectral_factor(squared(mirrored, 1.0)), np.abs(p), rtol=1e-4)


def test_a_square_that_falls_below_zero_has_a_factor_all_the_same():
    """1 - y: the certificate judges it."""
    np.testing.assert_allclose(fit._spectral_factor(np.array([4.0, -4.0])), [2.0, 0.0], atol=1e-12)


def test_decibels_are_those_of_amplitudes_and_nothing_bounds_the_infinite():
    assert fit._db(10.0) == 20.0 and fit._db(0.1) == -20.0 and fit._db(math.inf) == math.inf
