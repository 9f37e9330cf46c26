"""The search for the least level on problems made up so that the optimum is known: which levels it asks
about, and what it answers."""

from collections.abc import Callable

import numpy as np
import pytest

from lpvguard.engine.synthesis import gamma_search
from lpvguard.engine.synthesis.central import central_controller
from lpvguard.engine.synthesis.errors import SynthesisError
from lpvguard.engine.synthesis.gamma_search import LIMIT_RTOL, GammaProblem
from lpvguard.engine.synthesis.partition import Plant
from lpvguard.engine.synthesis.riccati import RiccatiSolution
from lpvguard.engine.synthesis.singular import extended_plant

Coupling = Callable[[float], float | None]


class BoundedSide:
    """``bounds``: that of single frequencies, then those that a level shows."""

    def __init__(self, *bounds: float):
        self.bounds, self.levels = list(bounds), []

    def frequency_bound(self, level=None):
        self.levels.append(level)
        return self.bounds.pop(0)


class MadeUp(GammaProblem):
    def __init__(self, coupling: Coupling, floor=0.0, bounds=(0.0,), axis=(), rank_lost=False):
        self.made_up, self.floor, self.axis, self.rank_lost = coupling, floor, axis, rank_lost
        self.control, self.filter = BoundedSide(*bounds), BoundedSide(*[0.5 * b for b in bounds])
        self.asked: list[float] = []

    def coupling(self, gamma):
        self.asked.append(gamma)
        return self.made_up(gamma)


def from_level(optimum: float) -> Coupling:
    """A coupling that grows with the square of the level and is 1 at ``optimum``."""
    return lambda gamma: (gamma / optimum) ** 2


def wall(optimum: float) -> Coupling:
    """No solution up to ``optimum``, and any margin above it."""
    return lambda gamma: np.inf if gamma > optimum else None


# ---------------------------------------------------------------- where it begins


def test_no_frequency_bound_is_asked_about_on_the_axis_or_near_the_floor():
    for problem in (
        MadeUp(wall(1.0), bounds=(2.0,), axis=(0.0,)),
        MadeUp(wall(1.0), floor=2.0 * (1 - LIMIT_RTOL), bounds=(2.0,)),
    ):
        assert problem._frequency_limit(1e-3) == (problem.floor, None) and problem.asked == []
    near = MadeUp(wall(1.0), floor=2.0 * (1 - 1.01 * LIMIT_RTOL), bounds=(2.0,))
    assert near._frequency_limit(1e-3) == (2.0 * (1 + 1e-6), np.inf)


@pytest.mark.parametrize(("rtol", "finer"), [(1e-3, 1e-6), (1e-8, 1e-8)])
def test_the_bound_of_frequencies_rises_to_a_level_that_has_solutions(rtol, finer):
    problem = MadeUp(wall(2.1), bounds=(1.0, 1.5, 2.2, 9.0))
    assert problem._frequency_limit(rtol) == (2.2 * (1 + finer), np.inf)
    assert problem.asked == [x * (1 + finer) for x in (1.0, 1.5, 2.2)]
    assert problem.control.levels == [None, *problem.asked[:2]] == problem.filter.levels
    settled = MadeUp(wall(2.1), bounds=(1.0, 1.0 * (1 + finer)))
    assert settled._frequency_limit(rtol) == (1.0 + finer, None) and len(settled.asked) == 1
    endless = MadeUp(wall(1e9), bounds=[1.0 + k for k in range(40)])
    assert endless._frequency_limit(rtol) == (20.0 * (1 + finer), None) and len(endless.asked) == 20


def test_what_is_certain_is_the_larger_of_floor_and_single_frequencies():
    assert MadeUp(wall(1.0), floor=3.0, bounds=(2.0,)).certain == 3.0
    assert MadeUp(wall(1.0), floor=1.0, bounds=(2.0,)).certain == 2.0


def test_a_level_is_reached_above_the_floor_where_the_coupling_is_above_one():
    problem = MadeUp(from_level(3.0), floor=1.0)
    assert [problem.reached(x) for x in (2.9, 3.0, 3.1)] == [False, False, True]
    floor = MadeUp(from_level(0.1), floor=1.0)
    assert [floor.reached(x) for x in (0.9, 1.0, 1.1)] == [False, False, True]
    assert not MadeUp(lambda gamma: None).reached(5.0)


# ---------------------------------------------------------------- brackets


def bracket(problem: MadeUp, rtol: float = 1e-3, guess: float | None = None) -> tuple:
    """The bracket that ``optimum`` narrows."""
    brackets: list[tuple] = []
    problem._narrow = lambda rtol, *ends: brackets.append(ends) or 7.0  # type: ignore[method-assign]
    assert problem.optimum(rtol, guess) == 7.0
    return brackets[0]


def test_without_a_bound_the_search_begins_at_one_and_goes_by_tens():
    problem = MadeUp(from_level(300.0))
    assert bracket(problem) == (100.0, pytest.approx(1 / 9), 1000.0, pytest.approx(100 / 9))
    assert problem.asked == [1.0, 10.0, 100.0, 1000.0]
    problem = MadeUp(from_level(0.03))
    assert bracket(problem) == pytest.approx((0.01, 1 / 9, 0.1, 100 / 9))
    assert problem.asked == pytest.approx([1.0, 0.1, 0.01])
    low = MadeUp(wall(0.03))
    assert bracket(low) == (pytest.approx(0.01), None, pytest.approx(0.1), np.inf)
    # A margin of exactly 1 is not above it.
    exact = MadeUp(from_level(1.0))
    assert bracket(exact)[0] == 1.0 and exact.asked == [1.0, 10.0]


def test_above_a_floor_the_search_begins_at_twice_it_and_stays_above_it():
    problem = MadeUp(from_level(2.5), floor=2.0)
    assert bracket(problem) == (2.0, None, 4.0, pytest.approx(2.56)) and problem.asked == [4.0]
    deep = MadeUp(from_level(1e-9), floor=0.3)
    assert bracket(deep) == (0.3, None, 1.0, pytest.approx(1e18)) and deep.asked == [1.0]
    exact = MadeUp(from_level(1e-9), floor=0.1)
    assert bracket(exact)[:3] == (0.1, None, 1.0), "a tenth of the level is the floor itself"
    deep = MadeUp(from_level(1e-9), floor=0.03)
    assert bracket(deep)[:3] == (0.03, None, pytest.approx(0.1)) and len(deep.asked) == 2


def test_the_bound_of_frequencies_is_the_optimum_where_it_is_reached_and_nothing_below_is():
    problem = MadeUp(wall(2.0), bounds=(2.0,))
    limit = 2.0 * (1 + 1e-6)
    assert problem.optimum(1e-3) == limit
    assert problem.asked == [limit, limit * (1 - LIMIT_RTOL)]
    # A bound that is above the optimum is a level like any other.
    wrong = MadeUp(from_level(0.5), floor=0.1, bounds=(2.0,))
    ends = bracket(wrong)
    assert ends == pytest.approx((limit / 10, (limit / 5) ** 2, limit, (limit / 0.5) ** 2))
    assert len(wrong.asked) == 3
    below = MadeUp(from_level(5.0), bounds=(2.0,))
    assert bracket(below) == pytest.approx((2 * limit, 0.64, 20 * limit, 64.0), rel=1e-5)
    assert below.asked == pytest.approx([limit, 2 * limit, 20 * limit])
    between = MadeUp(from_level(3.0), bounds=(2.0,))
    assert bracket(between)[:2] == (limit, pytest.approx(4 / 9, rel=1e-5)), "its coupling is known"


def test_around_a_guess_steps_grow_by_their_squares():
    rtol, factor = 1e-2, 1.2
    problem = MadeUp(from_level(5.0))
    assert bracket(problem, rtol, 4.0)[::2] == pytest.approx((4.8, 4.8 * factor**2))
    assert problem.asked == pytest.approx([4.0, 4.8, 4.8 * factor**2])
    problem = MadeUp(from_level(2.0))
    assert bracket(problem, rtol, 4.0)[::2] == pytest.approx((4 / 1.2**7, 4 / 1.2**3))
    assert problem.asked == pytest.approx([4.0, 4 / 1.2, 4 / 1.2**3, 4 / 1.2**7])
    # No guess is taken that lies at or below the bound of frequencies.
    low = MadeUp(from_level(2.5), bounds=(2.0,))
    bracket(low, rtol, 0.5)
    limit = 2.0 * (1 + 1e-6)
    assert low.asked == pytest.approx([limit, limit * 1.01, limit * 1.01 * 1.2, limit * 1.01 * 1.2**3])
    reached = MadeUp(from_level(0.5), floor=0.1, bounds=(2.0,))
    bracket(reached, rtol, 0.7)
    assert reached.asked[:3] == pytest.approx([limit, limit * (1 - LIMIT_RTOL), limit * 1.01])


def test_what_every_level_reaches_has_the_optimum_0_and_what_none_reaches_none():
    every = MadeUp(lambda gamma: np.inf)
    assert every.optimum(1e-3) == 0.0
    assert every.asked == pytest.approx([10.0**-k for k in range(17)])
    floor = MadeUp(lambda gamma: np.inf, floor=10.0, bounds=(0.0,), axis=(1.0,))
    assert floor.optimum(1e-3) == pytest.approx(10.0, rel=1.1e-3)
    none = MadeUp(lambda gamma: None)
    with pytest.raises(SynthesisError, match=r"no level up to 1e\+12 can be reached"):
        none.optimum(1e-3)
    assert none.asked == pytest.approx([10.0**k for k in range(13)], rel=1e-9)
    none = MadeUp(lambda gamma: None, floor=0.1, axis=(1.0,))
    with pytest.raises(SynthesisError, match=r"no level up to 1e\+14 can be reached"):
        none.optimum(1e-3)


# ---------------------------------------------------------------- narrowing


def shares(values, low_value, high_value, rtol=0.0, low=1.0, high=np.e) -> list[float]:
    """Where in the bracket [low, high], by the logarithm, the levels lie that are asked about when ``values``
    are answered; the bracket is one of length 1 in logarithms unless given."""
    answers, asked = list(values), []

    def coupling(gamma):
        asked.append(float(np.log(gamma / low) / np.log(high / low)))
        if not answers:
            raise InterruptedError
        return answers.pop(0)

    with pytest.raises(InterruptedError):
        MadeUp(coupling)._narrow(rtol, low, low_value, high, high_value)
    return asked


@pytest.mark.parametrize(
    ("low_value", "high_value"), [(0.9, 1.9), (0.1, 1.1), (-3.0, 1.5), (0.99, 900.0), (0.5, 1.5)]
)
def test_a_secant_step_aims_at_a_coupling_of_one_and_a_little_past_it(low_value, high_value):
    t = (1 - low_value) / (high_value - low_value)
    [share] = shares([], low_value, high_value)
    assert share == pytest.approx(np.clip(t, 1e-4, 1 - 1e-4), rel=1e-9)
    [past] = shares([], low_value, high_value, rtol=0.01)
    expected = t + (0.003 if t < 0.5 else -0.003)
    assert past == pytest.approx(np.clip(expected, 1e-4, 1 - 1e-4), rel=1e-9)


def test_a_step_is_the_middle_where_the_couplings_tell_nothing():
    for low_value, high_value in ((None, 2.0), (0.5, np.inf), (-1e3, 2.0), (1e3, 2e3)):
        assert shares([], low_value, high_value) == pytest.approx([0.5])
    assert shares([], -999.0, 1.1)[0] > 0.9


def test_a_secant_step_stays_off_the_ends():
    assert shares([], 1 - 1e-6, 2.0, low=7.0, high=70.0) == pytest.approx([1e-4])
    assert shares([], -900.0, 1 + 1e-6) == pytest.approx([1 - 1e-4])


def test_every_fourth_step_and_the_third_of_two_that_hardly_help_is_the_middle():
    # Each answer leaves the coupling of the low end small: high falls to the secant's level.
    first, second, third = shares([0.2, 0.3], 0.0, 10.0)
    assert first == pytest.approx(0.1)
    # The bracket [0.1, 1] is more than half of the last one: the next step goes past the root.
    t = (1 - 0.2) / (10.0 - 0.2)
    assert second == pytest.approx(0.1 + 0.9 * (t + 0.02 * (0.5 - t)))
    assert third == pytest.approx(second + 0.5 * (1 - second)), "two have hardly helped"
    # Of a root near the high end the other side is below.
    first, second = shares([1.8], -9.0, 2.0)
    t = 10.0 / 10.8
    assert second == pytest.approx(first * (t - 0.02 * (t - 0.5)))
    # Where each step halves the bracket at least, every fourth is a bisection, and none goes past the root.
    asked = shares([2.0] * 7, 0.5, 2.0, low=2.0, high=2 * np.exp(3))
    ratios = np.array(asked) / [1.0, *asked[:-1]]
    np.testing.assert_allclose(ratios[[0, 1, 2]], 1 / 3)
    np.testing.assert_allclose(ratios[[3, 7]], 0.5)
    np.testing.assert_allclose(ratios[[5, 6]], 1 / 3)
    # After one that hardly helped and one that did, the next does not go past the root either.
    asked = shares([0.5, 2.0], 0.0, 10.0, low=2.0, high=2 * np.exp(3))
    bracket = asked[1] - asked[0]
    assert bracket / (1 - asked[0]) < 0.5
    assert (asked[2] - asked[0]) / bracket == pytest.approx(1 / 3)
    # Half of the bracket is no more than half of it.
    assert shares([0.5], None, 2.0, high=4.0) == pytest.approx([0.5, 0.5 + 0.5 / 3])


def test_the_bracket_is_narrowed_to_the_tolerance_and_its_upper_end_is_the_answer():
    for rtol in (1e-2, 1e-5, 1e-8):
        for optimum in (1.001, 2.0, 9.99):
            for coupling in (from_level(optimum), wall(optimum)):
                problem = MadeUp(coupling)
                got = problem._narrow(rtol, 1.0, coupling(1.0), 10.0, coupling(10.0))
                assert optimum < got <= optimum * (1 + rtol)
                assert len(problem.asked) < 40
    exact = MadeUp(from_level(2.0))
    assert exact._narrow(0.25, 2.0, 1.0, 2.5, 1.5) == 2.5 and exact.asked == []
    assert MadeUp(from_level(2.0))._narrow(0.24, 2.0, 1.0, 2.5, 1.5) < 2.5
    slow = MadeUp(wall(2.0))
    slow._narrow(-1.0, 1.0, None, 10.0, np.inf)
    assert len(slow.asked) == 80


# ---------------------------------------------------------------- attempts, and the problem of a plant


def test_attempts_are_at_shares_of_the_backoff_and_then_with_less_and_less_extra_cost():
    regular = list(MadeUp(wall(1.0)).attempts())
    singular = list(MadeUp(wall(1.0), rank_lost=True).attempts())
    assert regular[:3] == [(0.0, 0.97), (0.0, 0.5), (0.0, 0.25)] and regular[3:] == singular
    assert singular == [(10.0**-k, 0.9) for k in range(1, 15)]
    assert list(MadeUp(wall(1.0), axis=(0.0,)).attempts()) == singular


def plant(D12: float = 1.0, D21: float = 1.0, zero: float = 1.0) -> Plant:
    """x' = -x + w1 + u, z = [x; D12 u], y = (1 - zero) x + D21 w2: with D12 = 0 and D21 = 0 singular."""
    A, B1, B2 = -np.eye(1), np.array([[1.0, 0.0]]), np.eye(1)
    C1, C2 = np.array([[1.0], [0.0]]), np.eye(1)
    return Plant(A, B1, B2, C1, C2, np.zeros((2, 2)), np.array([[0.0], [D12]]), np.array([[0.0, D21]]))


def test_what_is_singular_is_said():
    assert GammaProblem(plant()).notes == [] and not GammaProblem(plant()).singular
    problem = GammaProblem(plant(D12=0.0))
    assert problem.singular and problem.axis == ()
    assert problem.notes == ["D12 has rank 0 of 1 (controls without direct cost): 1 states removed"]
    problem = GammaProblem(plant(D21=0.0))
    assert problem.notes == ["D21 has rank 0 of 1 (measurements without noise): 1 states removed"]


def singular_plant(cost: float = 0.0) -> Plant:
    """A of norm 5, of which the columns sum to 7; the control's path to z is 1 / 5."""
    A, B2, C1 = np.array([[3.0, 0.0], [4.0, 0.0]]), np.array([[1.0], [0.0]]), np.array([[1.0, 0.0]])
    one = np.ones((1, 1))
    return Plant(A, np.zeros((2, 1)), B2, C1, C1, 0 * one, cost * one, one)


def test_a_cost_beside_the_controls_path_is_none():
    assert GammaProblem(singular_plant(1e-9 / 6)).notes[0].startswith("D12 has rank 0 of 1")


def test_what_is_softened_is_what_keeps_zeros_on_the_axis(monkeypatch):
    probed, asked = [], []
    monkeypatch.setattr(
        gamma_search, "extended_plant", lambda *arguments: probed.append(arguments) or singular_plant(1.0)
    )
    answers = iter([(), (0.0,), (2.0,), ()])
    monkeypatch.setattr(
        gamma_search, "axis_zeros", lambda side, scale: asked.append((side, scale)) or next(answers)
    )
    P = singular_plant()
    assert GammaProblem(P).soft == (False, True)
    assert GammaProblem(P).soft == (True, False)
    assert [scale for _, scale in asked] == pytest.approx([5.0] * 4)
    assert [one[1:] for one in probed] == [((False, False), 1e-2)] * 2 and probed[0][0] is P
    np.testing.assert_array_equal(asked[0][0].B2, P.B2)
    np.testing.assert_array_equal(asked[1][0].B2, P.C2.T)
    assert GammaProblem(plant()).soft == (False, False) and len(probed) == 2


def test_the_floor_is_the_larger_of_the_direct_bound_and_those_at_zeros(monkeypatch):
    monkeypatch.setattr(gamma_search, "parrott_bound", lambda P: 7.0)
    for bound in (3.0, 9.0):
        monkeypatch.setattr(gamma_search, "axis_bounds", lambda P, axis, bound=bound: [bound, 1.0])
        assert GammaProblem(plant()).floor == max(7.0, bound)


def test_a_controller_is_the_central_one_of_the_plant_or_of_that_with_extra_costs():
    P = plant()
    problem = GammaProblem(P)
    for epsilon in (0.0, 0.1, 1.0):
        softened = P if epsilon == 0 else extended_plant(P, (False, False), epsilon)
        want, got = central_controller(softened, 9.0), problem.controller(9.0, epsilon)
        for name in ("A", "B", "C", "D"):
            np.testing.assert_array_equal(getattr(got, name), getattr(want, name))
    assert problem.controller(0.1, 0.0) is None


class SolvedSide:
    def __init__(self, X: float | None):
        self.X, self.levels = X, []

    def solve(self, gamma):
        self.levels.append(gamma)
        return None if self.X is None else RiccatiSolution(self.X * np.eye(1), True)


def test_the_coupling_is_none_where_a_side_has_no_solution():
    problem = GammaProblem(plant())
    for X, Y, want in ((None, 2.0, None), (2.0, None, None), (None, None, None), (2.0, 3.0, 25 / 6)):
        problem._couplings.clear()
        problem.control, problem.filter = SolvedSide(X), SolvedSide(Y)
        assert problem.coupling(5.0) == (want if want is None else pytest.approx(want))
        assert problem.filter.levels == ([] if X is None else [5.0])


def test_zeros_on_the_axis_are_said_and_give_the_floor_and_what_is_softened():
    # From u to z: s / (s + 1), on the axis at 0; w is not seen there.
    one = np.eye(1)
    P = Plant(-one, one, one, -one, one, 3 * one, one, one)
    problem = GammaProblem(P)
    assert problem.axis == (0.0,) and problem.singular and not problem.rank_lost
    assert problem.notes == ["P12 has zeros on the imaginary axis at 0 rad/s"]
    dual = GammaProblem(P.dual)
    assert dual.notes == ["P21 has zeros on the imaginary axis at 0 rad/s"]
    assert problem.floor == pytest.approx(dual.floor)
    both = GammaProblem(Plant(-one, one, one, -one, -one, 3 * one, one, one))
    assert both.axis == (0.0,) and len(both.notes) == 2


def test_a_level_is_asked_of_the_riccati_equations_once():
    problem = GammaProblem(plant())
    first = problem.coupling(2.0)
    problem.control = problem.filter = None  # type: ignore[assignment]
    assert problem.coupling(2.0) == first
    problem = GammaProblem(plant())
    best = problem.optimum(1e-6)
    assert problem.coupling(best) > 1 > (problem.coupling(best * (1 - 1e-5)) or 0.0)
