"""Which controllers H-infinity synthesis tries and keeps, on a problem made up so that the level is the norm;
the coordinates that lead back to the plant; and the levels asked for alone."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from lpvguard.engine.synthesis import hinf
from lpvguard.engine.synthesis.coordinates import schur_coordinates
from lpvguard.engine.synthesis.errors import SynthesisError
from lpvguard.engine.synthesis.gamma_search import GAMMA_RTOL
from lpvguard.engine.synthesis.hinf import hinf_synthesis, improved_level, optimal_level
from lpvguard.engine.synthesis.norms import hinf_norm
from lpvguard.engine.synthesis.statespace import StateSpace, gain, lft

PLANT = gain([[0.0, 1.0], [1.0, 0.0]])
"""z = u, y = w: the closed loop is the controller."""


class MadeUp:
    """A problem whose controller at a level is a constant; ``norm(level, epsilon)`` is its size, None: no
    controller."""

    def __init__(self, norm, attempts=(), singular=False):
        self.norm, self.tried, self.notes = norm, [], ["made up"]
        self.listed, self.singular, self.certain = attempts, singular, 0.25

    def attempts(self):
        yield from self.listed

    def controller(self, level, epsilon):
        self.tried.append((level, epsilon))
        size = self.norm(level, epsilon)
        if size == "fails":
            raise np.linalg.LinAlgError("made up")
        return None if size is None else gain([[size]])


def trials(problem, gamma=1.0, backoff=0.1) -> hinf._Trials:
    posed = hinf._Posed(PLANT, problem, np.zeros((1, 1)), np.zeros((1, 1)), np.zeros((0, 0)))
    return hinf._Trials(posed, gamma, backoff)


def test_the_best_certified_controller_is_kept_and_of_equal_ones_the_first():
    sizes = iter([3.0, None, 2.0, "fails", 2.0, 5.0])
    one = trials(MadeUp(lambda *_: next(sizes)))
    assert one.reached == np.inf and not one.good
    for k, reached in enumerate([3.0, 3.0, 2.0, 2.0, 2.0, 2.0]):
        one.attempt(7.0, 10.0**-k)
        assert one.reached == pytest.approx(reached, rel=2e-5) and one.reached >= reached
    best = one.best
    assert best.regularisation == 1e-2 and best.gamma == 1.0 and best.notes == ("made up",)
    assert best.gamma_achieved == best.certificate.upper
    below = trials(MadeUp(lambda *_: 0.5))
    below.attempt(1.0, 0.0)
    assert below.best.gamma == below.best.certificate.lower == pytest.approx(0.5), (
        "a claim is never above a norm"
    )


def test_the_norm_that_is_certified_is_that_of_the_controller_that_is_returned(monkeypatch):
    """Planted: a way back to the plant that doubles the controller."""
    right = hinf._Posed.restore
    monkeypatch.setattr(hinf._Posed, "restore", lambda self, K: gain(2 * right(self, K).D))
    one = trials(MadeUp(lambda *_: 3.0))
    one.attempt(1.0, 0.0)
    assert one.best.controller.D.item() == 6.0 and 6.0 <= one.best.gamma_achieved <= 6.0 * (1 + 2e-5)
    assert one.best.certificate.lower == pytest.approx(6.0) and not one.good


@pytest.mark.parametrize(("size", "good"), [(1.0999, True), (1.1001, False)])
def test_good_is_within_the_backoff_of_the_optimum(size, good):
    one = trials(MadeUp(lambda *_: size))
    one.attempt(1.0, 0.0)
    assert one.good is good


@pytest.mark.parametrize(("order", "budget"), [(0, 100), (5, 100), (20, 50), (400, 25)])
def test_no_more_controllers_are_tried_than_the_order_allows(order, budget):
    problem = MadeUp(lambda *_: 9.0)
    posed = trials(problem).posed
    plant = StateSpace(-np.eye(order), np.zeros((order, 2)), np.zeros((2, order)), PLANT.D)
    one = hinf._Trials(hinf._Posed(plant, problem, posed.D22, posed.shift, posed.basis), 1.0, 0.1)
    assert one.budget == budget
    one.budget = 2
    for _ in range(4):
        one.attempt(1.0, 0.0)
    assert len(problem.tried) == 2 and one.budget == 0


def test_levels_near_the_optimum_are_tried_in_order_until_one_is_good():
    listed = [(1e-1, 0.5), (1e-2, 0.5), (1e-3, 0.25), (1e-4, 0.5)]
    problem = MadeUp(lambda level, epsilon: level + epsilon, listed)
    one = trials(problem)
    one.near_optimum()
    assert [e for _, e in problem.tried] == [1e-1, 1e-2]
    assert [x for x, _ in problem.tried] == pytest.approx([1.05, 1.05])
    assert one.good and one.best.regularisation == 1e-2
    nothing = MadeUp(lambda level, epsilon: level, listed)
    trials(nothing, gamma=0.0).near_optimum()
    assert nothing.tried == []
    far = MadeUp(lambda level, epsilon: 4.0, listed)
    trials(far).near_optimum()
    assert [x for x, _ in far.tried] == pytest.approx([1.05, 1.05, 1.025, 1.05])


def test_from_any_level_that_can_be_reached_it_goes_down_step_by_step():
    """Of a regular problem: levels rise by tens to the first controller, then shares of what was reached."""
    problem = MadeUp(lambda level, _: level * 1.01 if level >= 40.0 else None)
    one = trials(problem)
    one.descend()
    levels = [x for x, _ in problem.tried]
    assert levels[:3] == [1.0, 10.0, 100.0] and {e for _, e in problem.tried} == {0.0}
    assert levels[3:] == pytest.approx([3.03, 30.3, 60.6, 0.9 * 61.206, 55.6363], rel=1e-3)
    assert one.reached == pytest.approx(1.01 * 0.9 * 61.206, rel=1e-3)
    floor = MadeUp(lambda level, _: 1.5)
    trials(floor).descend()
    assert [x for x, _ in floor.tried] == pytest.approx([1.0, 1.005, 1.005, 1.005, 1.35, 1.5], rel=1e-4)
    hopeless = MadeUp(lambda *_: None)
    trials(hopeless).descend()
    assert [x for x, _ in hopeless.tried] == pytest.approx([10.0**k for k in range(12)])
    tiny = MadeUp(lambda *_: None)
    trials(tiny, gamma=0.0).descend()
    assert tiny.tried[0][0] == 1e-6


def test_of_a_singular_problem_the_regularisation_falls_too():
    problem = MadeUp(
        lambda level, epsilon: max(level, 3.0 * epsilon) if epsilon <= 1e-3 else None, singular=True
    )
    one = trials(problem, gamma=2.0, backoff=0.01)
    one.descend()
    assert [e for _, e in problem.tried[:3]] == [1e-1, 1e-2, 1e-3]
    assert one.good, "the first is at the optimum itself"
    stuck = MadeUp(lambda level, epsilon: 5.0, singular=True)
    trials(stuck, gamma=2.0, backoff=0.01).descend()
    seen = [e for _, e in stuck.tried]
    assert seen[:5] == [1e-1, 1e-2, 1e-3, 1e-4, 1e-6], "at the first level"
    assert seen[5:] == pytest.approx([10.0**-k for k in range(1, 13) for _ in range(5)], rel=1e-9)
    deep = MadeUp(lambda level, epsilon: 0.9e-3 * level if epsilon < 1 else None, singular=True)
    end = trials(deep, gamma=1e-13, backoff=0.01)
    end.descend()
    assert end.reached <= 1e-7 * 1e-6 or end.good


def test_what_is_not_resolved_says_between_which_levels_the_optimum_lies():
    one = trials(MadeUp(lambda *_: 4.0))
    one.attempt(1.0, 0.0)
    cells = hinf._unresolved(one.best, one.posed, 1.0)
    assert not cells.resolved and cells.gamma_achieved == one.best.gamma_achieved
    assert cells.notes[0] == "made up" and len(cells.notes) == 2
    assert cells.notes[1] == (
        "not resolved: the best controller achieves 4 and has poles up to 0; the Riccati equations claim 1"
    )


# ---------------------------------------------------------------- problems of a plant


def mixed(seed: int = 1) -> StateSpace:
    """Two disturbances, a control with a cost, a measurement with noise."""
    random = np.random.default_rng(seed)
    A = random.standard_normal((3, 3))
    B = np.hstack([random.standard_normal((3, 1)), np.zeros((3, 1)), random.standard_normal((3, 1))])
    C = np.vstack([random.standard_normal((1, 3)), np.zeros((1, 3)), random.standard_normal((1, 3))])
    D = np.array([[0.0, 0.0, 0.0], [0.0, 0.0, 1.0], [0.0, 0.5, 0.0]])
    return StateSpace(A, B, C, D)


def test_the_basis_leads_from_the_problems_state_to_the_plants():
    plant = mixed().transformed(np.diag([1e4, 1.0, 1e-3]))
    posed = hinf._posed(plant, 1, 1, schur_coordinates)
    seen = []
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(hinf, "GammaProblem", lambda blocks: seen.append(blocks))
        hinf._posed(plant, 1, 1, schur_coordinates)
    [blocks] = seen
    T = posed.basis
    np.testing.assert_allclose(np.linalg.solve(T, plant.A @ T), blocks.A, rtol=1e-9, atol=1e-9)
    np.testing.assert_allclose(
        np.linalg.solve(T, plant.B), np.hstack([blocks.B1, blocks.B2]), rtol=1e-9, atol=1e-12
    )
    assert not np.allclose(T, np.eye(3))


def test_in_the_plants_coordinates_controllers_do_not_depend_on_the_plants_units():
    S = np.diag([1e3, 1.0, 1e-2])
    controllers = []
    for plant in (mixed(), mixed().transformed(S)):
        one = hinf_synthesis(plant, 1, 1)
        K = one.controller.transformed(np.linalg.inv(one.basis))
        assert one.resolved and hinf_norm(lft(plant, one.controller)).upper <= one.gamma * 1.008
        controllers.append(K)
    back = controllers[1].transformed(np.linalg.inv(S))
    np.testing.assert_allclose(
        back.A, controllers[0].A, rtol=1e-4, atol=1e-4 * np.abs(controllers[0].A).max()
    )
    np.testing.assert_allclose(
        back.C, controllers[0].C, rtol=1e-4, atol=1e-4 * np.abs(controllers[0].C).max()
    )


def test_a_level_is_improved_only_where_the_optimum_is_below_it():
    plant = mixed()
    best = optimal_level(plant, 1, 1, 1e-6)
    assert best == pytest.approx(hinf_synthesis(plant, 1, 1).gamma, rel=1e-3)
    assert improved_level(plant, 1, 1, 1.01 * best, 1e-6) == pytest.approx(best, rel=1e-5)
    assert improved_level(plant, 1, 1, 0.99 * best, 1e-6) is None


def test_a_problem_without_a_controller_that_passes_says_so(monkeypatch):
    monkeypatch.setattr(hinf._Trials, "attempt", lambda self, level, epsilon: None)
    with pytest.raises(
        SynthesisError, match=r"no controller passed its certificate.*double precision can show"
    ):
        hinf_synthesis(mixed(), 1, 1)


def test_the_first_coordinates_that_resolve_are_enough_and_else_the_better_result_counts(monkeypatch):
    plain = hinf_synthesis(mixed(), 1, 1)
    answers: list = []
    monkeypatch.setattr(hinf, "_synthesis", lambda *_: answers.pop(0))

    def result(achieved: float, resolved: bool):
        return replace(plain, gamma_achieved=achieved, resolved=resolved)

    answers[:] = [result(3.0, True), result(2.0, True)]
    assert hinf_synthesis(mixed(), 1, 1).gamma_achieved == 3.0 and len(answers) == 1
    for pair in ([3.0, 2.0], [2.0, 3.0]):
        answers[:] = [result(x, False) for x in pair]
        assert hinf_synthesis(mixed(), 1, 1).gamma_achieved == 2.0 and not answers
    answers[:] = [result(3.0, False), result(2.5, True)]
    assert hinf_synthesis(mixed(), 1, 1).resolved


# ---------------------------------------------------------------- what is asked of a problem


class Asked:
    """A problem of which a level is reached from ``optimum`` on."""

    def __init__(self, optimum: float):
        self.best, self.optima, self.levels = optimum, [], []

    def optimum(self, *arguments):
        self.optima.append(arguments)
        return self.best

    def reached(self, level):
        self.levels.append(level)
        return level > self.best


def test_a_level_stands_in_place_of_backoff_and_guess(monkeypatch):
    problem, asked = Asked(2.0), []
    monkeypatch.setattr(hinf, "_posed", lambda *_: SimpleNamespace(problem=problem))
    answer = SimpleNamespace(resolved=True, gamma_achieved=1.0)
    monkeypatch.setattr(hinf, "_synthesis", lambda posed, *arguments: asked.append(arguments) or answer)
    hinf_synthesis(PLANT, 1, 1)
    assert asked == [(0.008, GAMMA_RTOL, None)] and problem.optima == []
    hinf_synthesis(PLANT, 1, 1, level=3.0)
    hinf_synthesis(PLANT, 1, 1, level=2.00001)
    assert asked[1:] == [(0.5, GAMMA_RTOL, 2.0), (1e-4, GAMMA_RTOL, 2.0)]
    assert problem.optima == [(1e-4,), (1e-4,)]


def test_of_equal_results_the_first_is_kept(monkeypatch):
    plain = hinf_synthesis(mixed(), 1, 1)
    first, second = (replace(plain, resolved=False, notes=(name,)) for name in ("first", "second"))
    answers = [first, second]
    monkeypatch.setattr(hinf, "_synthesis", lambda *_: answers.pop(0))
    assert hinf_synthesis(mixed(), 1, 1).notes == ("first",)


def test_the_first_failure_is_told_and_what_would_help(monkeypatch):
    def failing(*errors):
        left = list(errors)

        def fail(*_):
            raise left.pop(0)

        monkeypatch.setattr(hinf, "_synthesis", fail)
        hinf_synthesis(mixed(), 1, 1)

    ours = SynthesisError("H-infinity synthesis", "first", "was bad", "something")
    other = SynthesisError("plant", "second", "was bad", "something")
    monkeypatch.setattr(hinf, "frail_pole", lambda plant: "")
    with pytest.raises(SynthesisError, match="first: was bad; expected an optimum that double precision"):
        failing(ours, other)
    monkeypatch.setattr(hinf, "frail_pole", lambda plant: "pole 7")
    with pytest.raises(
        SynthesisError, match="first: was bad; expected balanced or modal coordinates: pole 7"
    ):
        failing(ours, other)
    with pytest.raises(SynthesisError, match="second: was bad; expected something"):
        failing(other, ours)
    with pytest.raises(np.linalg.LinAlgError, match="first"):
        failing(np.linalg.LinAlgError("first"), ours)


def test_an_optimum_below_the_least_that_matters_is_not_sought(monkeypatch):
    def improved(optimum, level, *least):
        problem = Asked(optimum)
        monkeypatch.setattr(hinf, "_posed", lambda *_: SimpleNamespace(problem=problem))
        return improved_level(PLANT, 1, 1, level, 1e-3, *least), problem.levels, problem.optima

    assert improved(0.2, 3.0) == (0.2, [3.0], [(1e-3, 3.0)])
    assert improved(4.0, 3.0) == (None, [3.0], [])
    assert improved(0.2, 3.0, 0.5) == (0.5, [0.5], [])
    assert improved(0.7, 3.0, 0.5) == (0.7, [0.5, 3.0], [(1e-3, 3.0)])


def test_what_was_closed_and_left_out_is_restored_in_the_plants_time_and_names():
    names = {"inputs": ("w1", "w2", "u"), "outputs": ("z", "y1", "y2")}
    plant = StateSpace(np.zeros((0, 0)), np.zeros((0, 3)), np.zeros((3, 0)), np.zeros((3, 3)), 0.1, **names)
    D22, shift = np.array([[0.5], [0.2]]), np.array([[0.3, -0.4]])
    K = StateSpace([[-2.0]], [[1.0, 0.5]], [[3.0]], [[0.1, 0.2]])
    restored = hinf._Posed(plant, None, D22, shift, np.eye(0)).restore(K)
    z = 0.3 + 0.8j
    k = K.evaluate([20 * (z - 1) / (z + 1)])[0]
    np.testing.assert_allclose(restored.evaluate([z])[0], k @ np.linalg.inv(np.eye(2) + D22 @ k) + shift)
    assert (restored.inputs, restored.outputs, restored.dt) == (("y1", "y2"), ("u",), 0.1)


def test_a_problem_is_posed_in_the_product_of_its_scalings_and_only_where_it_can_be(monkeypatch):
    with pytest.raises(SynthesisError, match="n_control"):
        hinf._posed(mixed(), 0, 1, schur_coordinates)
    G = mixed()
    alone = StateSpace(np.diag([1.0, -1.0, -2.0]), G.B * [[0.0], [1.0], [1.0]], G.C, G.D)
    with pytest.raises(SynthesisError):
        hinf._posed(alone, 1, 1, schur_coordinates)

    def none(_):
        raise AssertionError("a plant without states has no coordinates")

    monkeypatch.setattr(hinf, "GammaProblem", lambda blocks: blocks)
    assert hinf._posed(PLANT, 1, 1, none).basis.shape == (0, 0)
    scales = iter([np.array([2.0, 1.0, 1.0]), np.array([4.0, 1.0, 0.5])])
    monkeypatch.setattr(hinf, "balancing", lambda G: next(scales))
    posed = hinf._posed(G, 1, 1, schur_coordinates)
    T = posed.basis
    np.testing.assert_allclose(np.linalg.solve(T, G.A @ T), posed.problem.A, atol=1e-12)


class Searched(MadeUp):
    floor = 2.0

    def __init__(self, optimum, norm, *arguments, **more):
        super().__init__(norm, *arguments, **more)
        self.found = optimum

    def optimum(self, rtol, guess):
        if self.found is None:
            raise SynthesisError("H-infinity synthesis", "gamma", "none", "one")
        return self.found


def synthesis(problem, backoff=0.1):
    return hinf._synthesis(trials(problem).posed, backoff, 1e-6, None)


def test_a_singular_problem_without_a_bracket_falls_back_on_its_floor():
    with pytest.raises(SynthesisError, match="gamma: none"):
        synthesis(Searched(None, lambda *_: 2.05, [(0.0, 0.5)]))
    problem = Searched(None, lambda *_: 2.05, [(1e-2, 0.5)], singular=True)
    result = synthesis(problem)
    assert result.gamma == 2.0 and problem.tried == [(pytest.approx(2.1), 1e-2)]
    assert result.notes == ("made up", "the optimum could not be bracketed: gamma is a lower bound only")


def test_the_search_goes_down_only_where_nothing_near_the_optimum_was_good():
    good = Searched(1.0, lambda *_: 1.05, [(0.0, 0.5)])
    assert synthesis(good).resolved and len(good.tried) == 1
    far = Searched(1.0, lambda *_: 4.0, [(0.0, 0.5)])
    result = synthesis(far)
    assert not result.resolved and "not resolved" in result.notes[-1] and len(far.tried) == 1 + 5
    unstable = Searched(1.0, None, [(0.0, 0.5)])
    unstable.controller = lambda *_: StateSpace([[3.0]], [[1.0]], [[1.0]], [[0.0]])
    with pytest.raises(SynthesisError, match="no controller passed its certificate"):
        synthesis(unstable)


def test_good_is_at_most_the_backoff_and_a_norm_is_certified_to_five_digits(monkeypatch):
    asked = []
    monkeypatch.setattr(hinf, "hinf_norm", lambda G, rtol: asked.append(rtol) or hinf_norm(G, rtol))
    one = trials(MadeUp(lambda *_: 3.0))
    one.attempt(1.0, 0.0)
    assert asked == [1e-5]
    one.best = replace(one.best, gamma_achieved=1.0 * (1 + 0.1))
    assert one.good
    plant = StateSpace(-np.eye(13), np.zeros((13, 2)), np.zeros((2, 13)), PLANT.D)
    assert hinf._Trials(replace(one.posed, plant=plant), 1.0, 0.1).budget == 76


def test_descending_ends_at_a_good_controller_or_ten_million_times_lower():
    good = MadeUp(lambda level, _: level, singular=True)
    trials(good).descend()
    assert [e for _, e in good.tried] == [1e-1, 1e-2, 1e-3, 1e-4, 1e-6]
    deep = MadeUp(lambda level, _: 0.9e-3 * level, singular=True)
    trials(deep, gamma=1e-30).descend()
    assert len(deep.tried) == 5 + 2, "three per mille of a tenth and of a third each time"
    high = MadeUp(lambda *_: None)
    trials(high, gamma=1e12 - 0.5).descend()
    assert len(high.tried) == 1


def test_the_fastest_pole_of_what_is_not_resolved_is_told():
    one = trials(MadeUp(lambda *_: 4.0))
    one.attempt(1.0, 0.0)
    K = StateSpace(np.diag([-3.0, -1.0]), np.ones((2, 1)), np.ones((1, 2)), [[0.0]])
    cells = hinf._unresolved(replace(one.best, controller=K), one.posed, 1.0)
    assert cells.notes[-1].endswith("has poles up to 3; the Riccati equations claim 1")
