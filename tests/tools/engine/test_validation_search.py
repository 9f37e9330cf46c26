"""The branch and bound of the validation: what it returns when it stops; nodes that cover their parent."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from lft_problems import row, scalars_of
from lpvguard.engine.validation import branch, local_search
from lpvguard.engine.validation.branch import Incumbent, _candidates, _NodeBounds, _Search, minimise
from lpvguard.engine.validation.local_search import _Smooth, polish, repeated_starts
from lpvguard.engine.validation.quadratic import Form, Quadratic
from lpvguard.engine.validation.relaxation import Box, BranchNode, Tangent


def two_points(weight: float = 1.0) -> Quadratic:
    """|x - 1|^2 <= p0 and |x + 1|^2 <= p1 / weight: p0 + p1 is least at x = (1 - weight) / (1 + weight)."""
    return Quadratic(
        [Form(row(1, -1), row(0, 1), param=0), Form(row(1, 1), row(0, 1), param=1, slope=1 / weight)], 2, 2
    )


def scalar_problem(kind: str, target: complex) -> Quadratic:
    """x = delta, |x - target|^2 <= p1 / 3 and |delta|^2 <= p0: least at 3 / 4 of the target."""
    forms = [
        scalars_of(kind, row(1, 0), row(0, 1), param=0),
        Form(row(1, -target), row(0, 1), param=1, slope=1 / 3),
    ]
    return Quadratic(forms, 2, 2)


def problem_of(forms: list[Form], asked: list[dict]) -> Quadratic:
    """A problem that adds the scalars at which it is solved to ``asked``, and has one answer for all."""

    class OneAnswer(Quadratic):
        def inside(self, scalars):
            asked.append(dict(scalars))
            return 0.5, np.array([0.0, 1.0])

    return OneAnswer(forms, 1, 2)


@pytest.mark.parametrize("weight", [1.0, 0.25, 9.0])
@pytest.mark.parametrize("nodes", [1, 2, 3, 8, 5000])
def test_an_interval_holds_the_optimum_whenever_the_search_stops(weight, nodes):
    best = 4 * weight / (1 + weight)
    minimum = minimise(two_points(weight), gap=1e-5, max_nodes=nodes)
    assert minimum.lower <= best * (1 + 1e-9) and minimum.upper >= best * (1 - 1e-9)
    assert two_points(weight).cost(minimum.z) == minimum.upper and minimum.lower <= minimum.upper
    assert minimum.nodes <= nodes + 2
    if nodes == 5000:
        assert minimum.upper - minimum.lower <= 1e-5 * minimum.upper
        assert minimum.z[0] == pytest.approx((1 - weight) / (1 + weight), abs=1e-3)


@pytest.mark.parametrize("target", [2.0 + 1j, -1 + 2j, -2 - 0.5j, 1 - 2j])
@pytest.mark.parametrize("kind", ["repeated_complex", "repeated_real"])
def test_a_scalar_is_found_in_every_quadrant(kind, target):
    best = 0.75 * abs(target) ** 2
    if kind == "repeated_real":
        best = 0.75 * target.real**2 + 3 * target.imag**2
    minimum = minimise(scalar_problem(kind, target), gap=1e-4)
    assert minimum.lower <= best * (1 + 1e-9) and minimum.upper >= best * (1 - 1e-9)
    assert minimum.upper - minimum.lower <= 1e-4 * minimum.upper
    want = 0.75 * (target.real if kind == "repeated_real" else target)
    assert minimum.z[0] == pytest.approx(want, abs=0.03)


def test_the_search_ends_once_the_question_is_answered():
    full = minimise(two_points(9.0), gap=1e-9, max_nodes=300)
    below = minimise(two_points(9.0), gap=1e-9, max_nodes=300, enough=3.7)
    assert below.upper <= 3.7 and below.nodes <= full.nodes
    above = minimise(two_points(9.0), gap=1e-9, max_nodes=300, enough=3.0)
    assert above.lower > 3.0 and above.nodes < full.nodes
    # A cost that is a small part of the first counts as none.
    near = minimise(two_points(1e-9), zero=1e-6)
    assert (near.lower, near.upper) == (0.0, 0.0)
    assert minimise(two_points(1e-9), zero=1e-12).upper == pytest.approx(4e-9, rel=1e-3)


def test_known_points_are_begun_with_and_none_is_made_worse():
    problem = two_points(4.0)
    search = Incumbent(problem)
    assert search.cost == np.inf and search.z is None
    search.offer(None)
    assert search.z is None
    raw = search.start([np.array([3.0, 1.0]), np.array([1.0, 1.0])])
    assert raw == pytest.approx(16.0) and search.cost == pytest.approx(3.2, rel=1e-6)
    best, z = search.cost, search.z
    search.offer(np.array([0.0, 1.0]))
    assert search.cost == best and search.z is z
    search = Incumbent(two_points())
    search.offer(np.array([0.3, 1.0]))
    search.offer(np.array([-0.3, 1.0]))
    assert search.z[0] == 0.3, "of two that cost the same the first is kept"
    free = minimise(Quadratic(problem.forms[:1], 1, 2))
    assert (free.lower, free.upper, free.nodes) == (0.0, 0.0, 0) and free.z[0] == pytest.approx(1.0)
    only = minimise(problem, max_nodes=0, points=[np.array([-0.6, 1.0])])
    assert only.upper == pytest.approx(3.2, rel=1e-6) and only.lower <= 3.2


def test_a_point_is_repaired_before_it_is_taken():
    forms = [Form(row(1, 0), row(0, 1), constant=4.0), Form(row(1, -5), row(0, 1), param=0)]
    best = Incumbent(Quadratic(forms, 1, 2))
    best.offer(np.array([5.0, 1.0]))
    assert best.z[0] == pytest.approx(2.0) and best.cost == pytest.approx(9.0)
    scalar = Incumbent(scalar_problem("repeated_complex", 1.0))
    scalar.offer(None)
    assert scalar.z is None


def test_readings_of_a_primal_matrix_are_its_points():
    point = np.array([0.3 - 1j, 2.0, 1.0])
    for scale in (1.0, 7j):
        candidates = _candidates(np.outer(scale * point, np.conj(scale * point)))
        assert len(candidates) >= 2
        for z in candidates[:2]:
            np.testing.assert_allclose(z, point, rtol=1e-9)
    assert _candidates(None) == [] == _candidates(np.full((2, 2), np.nan))
    assert all(z[-1] == 1 for z in _candidates(np.diag([1.0, 0.0, 2.0]).astype(complex)))
    assert len(_candidates(np.diag([2.0, 1.0, 0.0]).astype(complex))) == 0, "no reading has a last entry"


def test_the_children_of_a_cone_cover_it():
    search = _Search(two_points(), 1e-4)
    node = BranchNode(0.0, 0, np.eye(2), {})
    children = search._branch(node, _NodeBounds(0.0, 0.0, 1.0, None, []))
    assert [boxes for _, boxes in children] == [{}, {}]
    rays = [rays.tolist() for rays, _ in children]
    assert sorted(rays) == sorted([[[1.0, 0.0], [0.5, 0.5]], [[0.5, 0.5], [0.0, 1.0]]])
    thin = BranchNode(0.0, 0, np.array([[0.5, 0.5], [0.5 + 4e-7, 0.5 - 4e-7]]), {})
    assert search._branch(thin, _NodeBounds(0.0, 0.0, 1.0, None, [])) is None


@pytest.mark.parametrize("kind", ["repeated_complex", "repeated_real"])
def test_the_first_box_holds_each_scalar_that_costs_no_more_and_is_cut_in_the_middle(kind):
    problem = scalar_problem(kind, 2.0)
    search = _Search(problem, 1e-4)
    search.best.offer(np.array([1.0, 1.0]))
    assert search.best.cost == pytest.approx(4.0)
    box = search._first_box(0)
    side = 2.0 if kind == "repeated_real" else 2.0 + 2.0j
    assert box.high == pytest.approx(side, rel=1e-8) and box.low == -box.high and box.high.real > 2.0
    children = search._cut_box(BranchNode(0.0, 0, np.eye(2), {}))
    assert all(rays.tolist() == [[0.0, 1.0]] for rays, _ in children), "the scalar's size has no direction"
    halves = [boxes[0] for _, boxes in children]
    assert (halves[0], halves[1]) == box.halves()
    tiny = Box(0.5, 0.5 + 1e-10)
    assert search._cut_box(BranchNode(0.0, 0, np.eye(2), {0: tiny})) is None


@pytest.mark.parametrize("kind", ["repeated_complex", "repeated_real", None])
def test_the_local_search_has_the_derivatives_of_its_constraints(kind):
    rng = np.random.default_rng(4)

    def draw() -> np.ndarray:
        return rng.normal(size=(2, 4)) + 1j * rng.normal(size=(2, 4))

    forms = [Form(draw(), row(0, 0, 0, 2), constant=3.0), Form(draw(), draw(), param=0, slope=0.6)]
    if kind:
        forms.append(scalars_of(kind, draw(), draw(), param=1, slope=1.7))
        forms.append(scalars_of(kind, draw(), draw(), constant=2.5, slope=0.4))
    smooth = _Smooth(Quadratic(forms, 2, 4), np.array([0.3, -0.5j, 1 + 1j, 1.0]))
    v = smooth.first + 0.1 * rng.normal(size=len(smooth.first))
    step = 1e-6 * np.eye(len(v))
    for fun, jac in (
        (smooth.inequality, smooth.inequality_jacobian),
        (smooth.equality, smooth.equality_jacobian),
    ):
        if kind is None and fun == smooth.equality:
            continue
        differences = np.array([(fun(v + h) - fun(v - h)) / 2e-6 for h in step]).T
        np.testing.assert_allclose(jac(v), differences, rtol=1e-6, atol=1e-6)
    z, p, scalars = smooth.unpack(smooth.first)
    np.testing.assert_allclose(z, [0.3, -0.5j, 1 + 1j, 1.0])
    sizes = np.zeros(2)
    for f in forms:
        if f.param >= 0:
            sizes[f.param] = np.linalg.norm(f.a @ z) ** 2 / (f.slope * np.linalg.norm(f.b @ z) ** 2)
    np.testing.assert_allclose(p, sizes, rtol=1e-12)
    if kind:
        assert scalars[0] == pytest.approx(
            np.vdot(forms[2].b @ z, forms[2].a @ z) / np.linalg.norm(forms[2].b @ z) ** 2
        )
    # Constraints say what the forms say.
    kept = smooth.inequality(smooth.first)
    assert kept[0] >= 0 if np.linalg.norm(forms[0].a @ z) ** 2 <= 12 else kept[0] < 0
    assert kept[1] == pytest.approx(0.0, abs=1e-9)


def test_the_local_search_finds_the_least_of_a_convex_problem():
    for weight in (1.0, 0.25, 9.0):
        z = polish(two_points(weight), np.array([5.0 + 3j, 1.0]))
        assert z == pytest.approx(np.array([(1 - weight) / (1 + weight), 1.0]), abs=1e-4)
    z = polish(scalar_problem("repeated_complex", 1 - 2j), np.array([0.1, 1.0]))
    assert z[0] == pytest.approx(0.75 * (1 - 2j), abs=1e-4)


@pytest.mark.unhurried
def test_first_points_of_repeated_blocks_keep_the_constant_constraints():
    assert repeated_starts(two_points()) == []
    forms = [
        scalars_of("repeated_real", row(1, 0), row(0, 1), param=0),
        Form(row(1, -0.7), row(0, 1), constant=1e-4),
    ]
    problem = Quadratic(forms, 1, 2)
    starts = repeated_starts(problem)
    assert starts and all(abs(z[0] - 0.7) <= 0.01 * (1 + 1e-6) and abs(z[0].imag) < 1e-12 for z in starts)
    # An imaginary target is out of a real scalar's reach.
    forms[1] = Form(row(1, -0.7j), row(0, 1), constant=1e-4)
    assert repeated_starts(Quadratic(forms, 1, 2)) == []


def begun(forms: list[Form], params: int, *z: complex) -> _Smooth:
    return _Smooth(Quadratic(forms, params, len(z)), np.array(z, complex))


def test_the_local_search_begins_at_the_sizes_of_its_point_in_a_unit_of_their_sum():
    """|3 + 4j|^2 = (p + 1) 2 |5|^2 and |x - 3|^2 = p' |x|^2: 0.5 - 1 below 0, and 1 / 4."""
    forms = [
        Form(row(0, 3 + 4j), row(0, 5), constant=1.0, param=0, slope=2.0),
        Form(row(1, -3), row(1, 0), param=1),
        Form(row(3, 0), row(0, 5), constant=0.04, param=1),  # 36 = (p' + 0.04) 25
    ]
    one = begun(forms, 2, 2.0, 1.0)
    np.testing.assert_allclose(one.unpack(one.first)[1], [0.0, 1.4])
    assert one.p_scale == pytest.approx(1.4) and one.gradient.tolist() == [0, 0, 1, 1]
    assert one.bounds == [(None, None)] * 2 + [(0.0, None)] * 2
    # Without an input the size is a million; a sum of nothing has a unit of 1e-12.
    blind = begun([Form(row(0, 1), row(1, 0), param=0)], 1, 0.0, 1.0)
    assert blind.p_scale == 1e6
    nothing = begun([Form(row(1, 0), row(0, 1), param=0)], 1, 0.0, 1.0)
    assert nothing.p_scale == 1e-12 and nothing.first[2] == 0.0


def test_each_constraint_is_in_the_unit_of_its_point_or_a_millionth_of_its_own():
    forms = [
        Form(row(300, 400), row(0, 1), constant=1.0),
        Form(row(3, 4), row(0, 2), param=0),
        Form(row(1, 0), row(0, 1)),
        scalars_of("repeated_complex", row(1, 0), row(0, 1), constant=np.inf),
    ]
    near, far = begun(forms, 1, -4 / 3, 1.0), begun(forms, 1, 1.0, 1.0)
    assert [k for k, _ in far.bounded] == [0, 1, 2]
    assert [far.norms[k] for k in range(3)] == pytest.approx([700**2, 49.0, 1.0])
    assert [near.norms[k] for k in range(3)] == pytest.approx([0.25, 25e-6, (4 / 3) ** 2], rel=1e-9)
    np.testing.assert_allclose(far.inequality(far.first), [1 / 700**2 - 1, 0.0, -1.0], atol=1e-12)


@pytest.mark.parametrize("b", [1e-5, 0.0, 2.0])
def test_a_repeated_scalar_begins_at_the_one_that_fits_best(b):
    """a z = (3 b, 4j b) beside b z = (b, b): the nearest is 1.5 + 2j, and 0 where there is no input."""
    a, b_ = np.array([[0, 3 * b], [0, 4j * b]]), np.array([[0, b], [0, b]], complex)
    one = begun([scalars_of("repeated_complex", a, b_, constant=np.inf)], 1, 0.3, 1.0)
    assert one.unpack(one.first)[2] == [pytest.approx(1.5 + 2j if b else 0.0)]


@pytest.mark.parametrize("kind", ["repeated_real", "repeated_complex"])
def test_a_scalar_keeps_its_constant_and_its_size(kind):
    """(p + 0.5) slope - |delta|^2 in the unit of the sum of sizes."""
    form = scalars_of(kind, row(1, 0), row(0, 1), param=0, constant=0.5, slope=2.0)
    one = begun([form], 1, 3.0, 1.0)  # delta = 3: p = 9 / 2 - 0.5
    assert one.p_scale == pytest.approx(4.0)
    v = one.first.copy()
    np.testing.assert_allclose(one.inequality(v), [0.0], atol=1e-12)
    v[3:5] = [1.0, 2.0]
    np.testing.assert_allclose(one.inequality(v), [(4.5 * 2 - 5) / 4])
    v[2] = 2.0
    np.testing.assert_allclose(one.inequality(v), [(8.5 * 2 - 5) / 4])
    rest = one.equality(v)
    np.testing.assert_allclose(rest, [2.0, -2.0, 2.0] if kind == "repeated_real" else [2.0, -2.0])


def test_first_points_are_sampled_about_the_size_at_which_a_block_makes_its_output():
    """delta = 3 beside an input of 2 and an output of 6: four times 3, over three decades."""
    asked: list[dict] = []

    def drawn(kind: str, b: float) -> np.ndarray:
        asked.clear()
        forms = [scalars_of(kind, row(0, 6), row(0, b), param=0), Form(row(1, 0), row(0, 1), constant=1.0)]
        repeated_starts(problem_of(forms, asked))
        assert len(asked) == local_search.SAMPLES + local_search.MAX_POLISHED
        return np.array([one[0] for one in asked[: local_search.SAMPLES]])

    for b, largest in ((2.0, 12.0), (0.0, 1.0)):
        for kind in ("repeated_complex", "repeated_real"):
            points = drawn(kind, b)
            size = np.abs(points)
            assert len(points) == 150 and 0.9 * largest < size.max() <= largest
            assert 1e-3 * largest <= size.min() < 1.2e-3 * largest
            # Even in the logarithm: half of them below the middle decade and a half.
            assert 0.35 < np.mean(size < largest * 10**-1.5) < 0.65
            if kind == "repeated_real":
                assert not points.imag.any() and 0.3 < np.mean(points.real > 0) < 0.7
            else:
                turns = np.histogram(np.angle(points), 4, (-np.pi, np.pi))[0]
                assert turns.min() > 20
    assert drawn("repeated_complex", 2.0)[0] == pytest.approx(0.94518 + 0.24885j, rel=1e-4), "seed 0"


def test_the_six_best_samples_are_led_inside_and_what_stays_outside_is_left():
    levels = []

    class Ring(Quadratic):
        def inside(self, scalars):
            level = 2.2 * abs(scalars[0] - 1.0)
            levels.append(level)
            return level, np.array([scalars[0], 1.0])

    forms = [
        scalars_of("repeated_complex", row(0, 1), row(0, 1), param=0),
        Form(row(1, 0), row(0, 1), constant=1.0),
    ]
    starts = repeated_starts(Ring(forms, 1, 2))
    assert len(starts) == local_search.MAX_POLISHED == 6
    reached = [2.2 * abs(z[0] - 1.0) for z in starts]
    assert max(reached) <= 1 + 1e-9
    best = np.sort(levels[:150])[:6]
    assert best[0] < 1.0 < best[1] < best[5] < 2.0, "all but one have to be led there"
    assert min(reached) == pytest.approx(best[0]) and np.sort(reached)[1] > 0.9

    class Outside(Ring):
        def inside(self, scalars):
            level, z = super().inside(scalars)
            return level + 2.0, z

    class Nowhere(Ring):
        def inside(self, scalars):
            return 0.5, None

    assert repeated_starts(Outside(forms, 1, 2)) == [] == repeated_starts(Nowhere(forms, 1, 2))


def test_derivatives_are_those_of_constants_beside_sizes():
    rng = np.random.default_rng(7)

    def draw() -> np.ndarray:
        return rng.normal(size=(2, 3)) + 1j * rng.normal(size=(2, 3))

    forms = [
        Form(draw(), draw(), constant=3.0, slope=0.8),
        Form(draw(), draw(), param=1, constant=0.7, slope=0.6),
        scalars_of("repeated_complex", draw(), draw(), param=0, constant=0.3, slope=1.4),
    ]
    smooth = _Smooth(Quadratic(forms, 2, 3), np.array([0.3, -0.5j, 1.0]))
    v = smooth.first + 0.2 * rng.normal(size=len(smooth.first))
    step = 1e-6 * np.eye(len(v))
    slopes = np.array([(smooth.inequality(v + h) - smooth.inequality(v - h)) / 2e-6 for h in step]).T
    np.testing.assert_allclose(smooth.inequality_jacobian(v), slopes, rtol=1e-6, atol=1e-6)


def test_each_repeated_block_has_a_scalar_of_its_own():
    asked: list[dict] = []
    forms = [
        scalars_of("repeated_complex", row(0, 6), row(0, 2), param=0),
        Form(row(1, 0), row(0, 1), constant=1.0),
        scalars_of("repeated_real", row(0, 1), row(0, 2), param=0),
        scalars_of("repeated_complex", row(0, 30), row(0, 1), param=0),
    ]
    assert len(repeated_starts(problem_of(forms, asked))) == local_search.MAX_POLISHED
    first, real, last = (np.array([one[k] for one in asked[:150]]) for k in (0, 2, 3))
    for sample, largest in ((first, 12.0), (real, 2.0), (last, 120.0)):
        assert 0.8 * largest < np.abs(sample).max() <= largest
    assert not real.imag.any() and first.imag.any() and last.imag.any()
    assert (
        np.abs(np.corrcoef([first.real, first.imag, real.real, last.real, last.imag]) - np.eye(5)).max() < 0.3
    )


@pytest.mark.parametrize("bad", [np.nan, np.inf])
def test_a_search_that_ends_nowhere_has_no_point(bad, monkeypatch):
    monkeypatch.setattr(
        local_search, "minimize", lambda *arguments, **more: SimpleNamespace(x=np.array([0.5, bad, 1.0, 1.0]))
    )
    assert polish(two_points(), np.array([1.0, 1.0])) is None


# --- the search by itself, with bounds and children from a table ---


def bounds(lower: float, edges: float = -np.inf, central: float = np.inf, tangent: Tangent | None = None):
    return _NodeBounds(lower, edges, central, tangent, [])


class Scripted(_Search):
    """A search over a tree of numbered nodes: number -> (bound, cost found there, children or None).

    A node's number is its ray's. ``visited``: number, lower, serial and small of each node, as it is bounded.
    """

    def __init__(self, tree: dict, first: float = np.inf, gap: float = 0.1, tangents: dict | None = None):
        super().__init__(two_points(), gap)
        self.tree, self.visited, self.tangents = tree, [], tangents or {}
        self.started: list[list] = []
        self.problem.params = 1

        def start(points):
            self.started.append(list(points))
            self.best.cost = first if len(self.started) == 1 else 50.0
            return self.best.cost

        self.best = SimpleNamespace(cost=np.inf, z="point", start=start, offer=None, improve=None)

    def _bound(self, node):
        number = float(node.rays[0, 0])
        self.visited.append((number, node.lower, node.serial, node.small))
        lower, cost, _ = self.tree[number]
        self.best.cost = min(self.best.cost, cost)
        edges, tangent = self.tangents.get(number, (-np.inf, None))
        return bounds(lower, edges, tangent=tangent)

    def _branch(self, node, bounds):
        children = self.tree[float(node.rays[0, 0])][2]
        return None if children is None else [(np.array([[float(k)]]), {0: k}) for k in children]


NONE = np.inf
TREE = {
    1.0: (1.0, NONE, (2, 3)),
    2.0: (3.0, NONE, None),
    3.0: (2.0, 4.0, (4, 5)),
    4.0: (5.0, NONE, (6, 7)),
    5.0: (2.5, NONE, None),
}


def test_the_search_takes_the_least_bound_first_and_keeps_what_it_cannot_cut():
    search = Scripted(TREE, first=10.0)
    result = search.run(100, 0.0, ["a", "b"], 0.0)
    assert search.visited == [
        (1, 0, 0, False),
        (2, 1, 1, False),
        (3, 1, 2, False),
        (4, 2, 3, False),
        (5, 2, 4, False),
    ]
    assert (result.lower, result.upper, result.z, result.nodes) == (2.5, 4.0, "point", 5)
    assert len(search.started) == 1 and search.started[0][1:] == ["a", "b"]
    np.testing.assert_array_equal(search.started[0][0], [0, 1])


def test_the_search_stops_at_its_gap_and_at_its_nodes():
    tree = TREE | {5.0: (2.5, 2.6, (6, 7)), 6.0: (2.55, NONE, None), 7.0: (2.55, NONE, None)}
    # 2.5 is within a tenth of 2.6: what was cut off before, at 3, is above it.
    result = Scripted(tree, first=10.0).run(100, 0.0, [], 0.0)
    assert (result.lower, result.upper, result.nodes) == (2.5, 2.6, 5)
    fine = Scripted(tree, first=10.0, gap=1e-3)
    result = fine.run(100, 0.0, [], 0.0)
    assert (result.lower, result.upper, result.nodes) == (2.55, 2.6, 7) and len(fine.visited) == 7
    # A node in the heap at the gap ends the search with its own bound.
    ends = {1.0: (9.0, 10.0, (2, 3)), 2.0: (9.5, NONE, None), 3.0: (9.9, NONE, None)}
    search = Scripted(ends, gap=0.1)
    result = search.run(100, 0.0, [], 0.0)
    assert (result.lower, result.nodes, len(search.visited)) == (9.0, 1, 1)
    search = Scripted(ends, gap=0.099)
    result = search.run(100, 0.0, [], 0.0)
    assert result.lower == 9.5 and len(search.visited) == 3
    # One that was below when it was made is not bounded once a point closes its gap.
    closed = {1.0: (1.0, NONE, (2, 3)), 2.0: (1.8, 2.0, None), 3.0: (1.5, NONE, None)}
    search = Scripted(closed, gap=0.5)
    result = search.run(100, 0.0, [], 0.0)
    assert (result.lower, result.upper, result.nodes, len(search.visited)) == (1.0, 2.0, 3, 2)
    # So many nodes are made, and what is open stays below.
    for most, visited, lower in (
        (0, 0, 0.0),
        (1, 1, 1.0),
        (2, 1, 1.0),
        (3, 3, 2.0),
        (4, 3, 2.0),
        (5, 5, 2.5),
    ):
        search = Scripted(TREE, first=10.0)
        result = search.run(most, 0.0, [], 0.0)
        assert (len(search.visited), result.lower) == (visited, lower), most
    uneven = {1.0: (1.0, 10.0, (2, 3)), 2.0: (1.5, NONE, (4, 5))}
    result = Scripted(uneven).run(3, 0.0, [], 0.0)
    assert (result.lower, result.nodes) == (1.0, 5), "the least that is open"


def test_the_search_ends_once_it_knows_on_which_side_of_the_question_the_optimum_is():
    for enough, visited, lower in ((3.9, 5, 2.5), (4.0, 3, 2.0), (0.5, 1, 1.0), (1.5, 3, 2.0), (2.0, 5, 2.5)):
        search = Scripted(TREE, first=10.0)
        result = search.run(100, 0.0, [], enough)
        assert (len(search.visited), result.lower) == (visited, lower), enough


def test_a_cost_that_is_a_small_share_of_the_first_is_nothing():
    for share, zero in ((0.4, True), (0.39, False)):
        search = Scripted(TREE, first=10.0)
        result = search.run(100, share, [], 0.0)
        assert (result.lower == result.upper == 0.0) == zero
        assert result.nodes == (3 if zero else 5) and result.z == "point"
    # Without a first point the first that is found counts: 4 is no small share of itself.
    late = Scripted({1.0: (1.0, 4.0, (2, 3)), 2.0: (3.5, 1.0, None), 3.0: (3.9, NONE, None)})
    assert late.run(100, 0.25, [], 0.0).upper == 0.0
    late = Scripted({1.0: (1.0, 4.0, (2, 3)), 2.0: (3.5, 1.0, None), 3.0: (3.9, NONE, None)})
    assert late.run(100, 0.24, [], 0.0).upper == 1.0


def test_repeated_blocks_are_sampled_once_where_the_first_node_left_no_point(monkeypatch):
    monkeypatch.setattr(branch, "repeated_starts", lambda problem: ["sampled"])
    out = {6.0: (46.0, NONE, None), 7.0: (47.0, NONE, None)}
    search = Scripted(TREE | {3.0: (2.0, NONE, (4, 5))} | out)
    result = search.run(100, 0.0, [], 0.0)
    assert [one[-1] for one in search.started[1:]] == ["sampled"] and result.upper == 50.0
    for first, there in ((10.0, NONE), (np.inf, 30.0)):
        search = Scripted(TREE | {1.0: (1.0, there, (2, 3))} | out, first=first)
        search.run(100, 0.0, [], 0.0)
        assert len(search.started) == 1
    none = Scripted({1.0: (1.0, NONE, (2, 3)), 2.0: (NONE, NONE, (4, 5)), 3.0: (NONE, NONE, (4, 5))})
    asked: list[list] = []
    none.best.start = lambda points: asked.append(points) or np.inf
    result = none.run(100, 0.5, [], 0.0)
    assert len(none.visited) == 3 and len(asked) == 2
    assert result.lower == np.inf and result.upper == np.inf, "nothing explains it"


def test_a_node_is_small_where_the_tangents_bound_was_the_better_one():
    def tangent(lower: float) -> Tangent:
        return Tangent(lower, 0.0, 0.0, 0.0, None)

    for edges, known, small in (
        (0.5, None, False),
        (0.5, tangent(0.6), True),
        (0.5, tangent(0.5), False),
        (-np.inf, tangent(0.0), False),
        (-np.inf, tangent(0.1), True),
    ):
        search = Scripted(TREE, first=10.0, tangents={1.0: (edges, known)})
        search.run(100, 0.0, [], 0.0)
        assert [one[3] for one in search.visited] == [False, small, small, False, False]


class ScriptedRelaxation:
    """A relaxation that answers from a table and notes what it is asked."""

    def __init__(self, box: float, tangent: Tangent | None, lower: tuple):
        self.answers, self.asked = (box, tangent, lower), {}

    def box_bound(self, node, params):
        self.asked["box"] = params
        return self.answers[0]

    def tangent(self, node, cutoff):
        self.asked["tangent"] = cutoff
        return self.answers[1]

    def lower(self, node, cutoff):
        self.asked["lower"] = cutoff
        return self.answers[2]


def test_a_nodes_bound_is_the_best_of_its_own_its_boxes_the_tangents_and_the_relaxations():
    primal = np.outer([2.0, 1.0], [2.0, 1.0]).astype(complex)
    tangent = Tangent(3.0, 0.0, 0.0, 0.0, primal)
    for own, box, known, edges, want, asked in (
        (1.0, 0.5, None, 2.0, 2.0, True),
        (1.0, 2.5, None, 2.0, 2.5, True),
        (4.0, 2.5, tangent, 2.0, 4.0, True),
        (1.0, 2.5, tangent, 2.0, 3.0, True),
        (1.0, 2.5, tangent, 6.0, 6.0, True),
        (9.0, 2.5, tangent, 6.0, 9.0, False),
        (8.999, 2.5, tangent, 6.0, 8.999, True),
        (-1.0, -2.0, None, -3.0, 0.0, True),
    ):
        search = _Search(two_points(), 0.1)
        search.best.cost = 10.0
        search.relaxation = relaxation = ScriptedRelaxation(box, known, (edges, 7.0, primal))
        bound = search._bound(BranchNode(own, 3, np.eye(2), {}))
        assert bound.lower == want and bound.tangent is known
        assert relaxation.asked["box"] == {0, 1} and relaxation.asked["tangent"] == 10.0
        assert ("lower" in relaxation.asked) == asked
        each = len(_candidates(primal))
        assert len(bound.readings) == each * ((known is not None) + asked)
        assert (bound.edges, bound.central) == ((edges, 7.0) if asked else (-np.inf, np.inf))
        if asked:
            assert relaxation.asked["lower"] == pytest.approx(9.0 * (1 + 1e-12), rel=1e-14)


def test_a_costly_relaxation_is_left_out_where_the_tangent_was_better():
    for costly, small, asked in ((True, True, False), (True, False, True), (False, True, True)):
        search = _Search(two_points(), 0.1)
        search.best.cost, search._costly = 10.0, costly
        search.relaxation = relaxation = ScriptedRelaxation(1.0, None, (2.0, 7.0, None))
        search._bound(BranchNode(1.0, 3, np.eye(2), {}, small))
        assert ("lower" in relaxation.asked) == asked


def test_more_than_two_dozen_multipliers_of_repeated_blocks_are_costly():
    def block(kind: str | None, rows: int) -> Form:
        return Form(np.eye(rows, 4), np.eye(rows, 4), param=0, repeated=kind)

    real, scalar = "repeated_real", "repeated_complex"
    for blocks, costly in (
        ([(scalar, 3)], False),
        ([(real, 3)], True),
        ([(real, 2), (real, 2)], False),
        ([(real, 2), (real, 2), (scalar, 1)], True),
        ([(scalar, 3), (real, 1), (real, 1)], False),
        ([(scalar, 3), (scalar, 2)], True),
        ([(scalar, 3), (real, 1), (scalar, 1), (scalar, 1)], True),
        ([(None, 4), (None, 4)], False),
    ):
        assert _Search(Quadratic([block(*b) for b in blocks], 1, 4), 0.1)._costly == costly


def test_the_first_readings_are_all_searched_from_and_later_ones_where_they_are_better():
    search = _Search(two_points(), 0.1)
    done: list[tuple[str, float]] = []

    def offer(z):
        done.append(("offer", z))
        search.best.cost = min(search.best.cost, z)

    search.best = SimpleNamespace(cost=5.0, offer=offer, improve=lambda z: done.append(("improve", z)))
    search._read([9.0, 8.0])
    assert done == [("offer", 9.0), ("improve", 9.0), ("offer", 8.0), ("improve", 8.0)]
    search._read([9.0, 9.0, 9.0])
    done.clear()
    search._read([7.0, 6.0, 5.0])
    assert done == [("offer", 7.0), ("improve", 7.0), ("offer", 6.0), ("offer", 5.0)], "the sixth is the last"
    done.clear()
    search._read([7.0, 4.0])
    search._read([5.5, 4.0])
    search._read([5.0])
    search._read([])
    assert done == [("offer", 7.0), ("offer", 5.5), ("offer", 5.0)], "one alone is offered"
    done.clear()
    search._read([3.0, 2.0])
    assert done == [("offer", 3.0), ("improve", 3.0)]


def test_readings_are_the_column_of_t_and_the_two_leading_vectors_with_a_last_entry():
    turn = np.linalg.qr(np.array([[1.0, 2, 3], [0, 1j, 4], [2, 0, 1]]))[0]
    primal = turn @ np.diag([1.0, 5.0, 3.0]) @ turn.conj().T
    wanted = [primal[:, -1], turn[:, 1], turn[:, 2]]
    candidates = _candidates(primal)
    assert len(candidates) == 3
    for z, v in zip(candidates, wanted, strict=True):
        np.testing.assert_allclose(z, v / v[-1], rtol=1e-9)
    np.testing.assert_array_equal(_candidates(np.full((1, 1), 2.0 + 0j)), 2 * [[1.0]])
    one_bad = primal.copy()
    one_bad[0, 0] = np.inf
    assert _candidates(one_bad) == []
    for last, kept in ((1.1e-9, 2), (0.9e-9, 1)):
        thin = np.array([[1.0, last], [last, 0.0]], complex)  # vectors (1, last) and (-last, 1)
        assert len(_candidates(thin)) == 1 + (kept - 1)
    # The share is of the vector's own size: 1e-8 beside 1e3 is nothing.
    assert len(_candidates(np.array([[5.0, 1e3], [1e3, 1e-8]], complex))) == 2


def test_a_cone_is_cut_where_its_loss_is_half_of_the_boxes_and_a_box_elsewhere():
    """Losses are central - edges of the cone and cost - central of the relaxation, or the tangent's own."""
    kind = "repeated_complex"
    forms = [
        scalars_of(kind, row(1, 0), row(0, 1), param=0),
        Form(row(1, -2), row(0, 1), param=1),
        Form(row(1, 2), row(0, 1), param=2),
    ]
    search = _Search(Quadratic(forms, 3, 2), 0.1)
    search.best.cost = 10.0
    search._first_boxes = box = {0: Box(-1 - 1j, 1 + 1j)}
    node = BranchNode(0.0, 1, np.array([[0.0, 1.0, 0.0], [0.0, 0.0, 1.0]]), box)

    def cuts(bounds: _NodeBounds, node: BranchNode = node) -> str:
        children = search._branch(node, bounds)
        if children is None:
            return "nothing"
        return "cone" if all(boxes is node.boxes for _, boxes in children) else "box"

    tangent = Tangent(5.0, 8.0, 6.0, 4.0, None)  # cone 4, twice box 4
    assert cuts(bounds(0.0, edges=4.0, central=6.0)) == "cone"  # 2 beside 4
    assert cuts(bounds(0.0, edges=4.01, central=6.0)) == "box"
    assert cuts(bounds(0.0, edges=4.9, central=5.0, tangent=tangent)) == "cone"
    assert cuts(bounds(0.0, edges=5.0, central=5.01, tangent=tangent)) == "box", "the tangent is not better"
    assert cuts(bounds(0.0, edges=4.9, central=5.0, tangent=replace(tangent, cone=6.0))) == "cone"
    assert cuts(bounds(0.0, edges=4.9, central=5.0, tangent=replace(tangent, cone=6.01))) == "box"
    assert cuts(bounds(0.0, edges=4.9, central=5.0, tangent=replace(tangent, box=3.9))) == "box"
    # Without boxes they come first; one ray cannot be cut; without a point nothing bounds a box.
    wide = bounds(0.0, edges=0.0, central=9.0)
    assert cuts(wide) == "cone" and cuts(wide, replace(node, boxes={})) == "box"
    assert cuts(wide, replace(node, rays=node.rays[:1])) == "box"
    search.best.cost = np.inf
    assert cuts(bounds(0.0, edges=4.9, central=5.0)) == "nothing", "an endless loss of the boxes"
    assert cuts(bounds(0.0, edges=4.0, central=5.0, tangent=tangent), replace(node, boxes={})) == "cone"


def test_the_widest_pair_of_rays_is_cut_in_its_middle():
    forms = [Form(row(1, -k), row(0, 1), param=k) for k in range(3)]
    search = _Search(Quadratic(forms, 3, 2), 0.1)
    rays = np.array([[0.5, 0.5, 0.0], [0.9, 0.1, 0.0], [0.0, 0.2, 0.8]])
    children = search._branch(BranchNode(0.0, 1, rays, {}), bounds(0.0))
    middle = 0.5 * (rays[1] + rays[2])
    np.testing.assert_allclose(children[0][0], [rays[0], rays[1], middle])
    np.testing.assert_allclose(children[1][0], [rays[0], middle, rays[2]])
    for apart, cut in ((1.1e-6, True), (0.9e-6, False)):
        thin = np.array([[0.5, 0.5, 0.0], [0.5 + apart / np.sqrt(2), 0.5 - apart / np.sqrt(2), 0.0]])
        assert (search._branch(BranchNode(0.0, 1, thin, {}), bounds(0.0)) is not None) == cut
    border = np.array([[0.0, 0.0, 0.0], [1e-6, 0.0, 0.0]])
    assert search._branch(BranchNode(0.0, 1, border, {}), bounds(0.0)) is None
    one = BranchNode(0.0, 1, rays[:1], {})
    assert search._branch(one, bounds(0.0)) is None
    search.best.cost = 1.0
    assert search._branch(one, bounds(0.0)) is None, "no box where no block is repeated"


def test_the_box_that_is_widest_beside_its_first_is_halved():
    kind = "repeated_real"
    forms = [
        scalars_of(kind, row(1, 0), row(0, 1), param=0, slope=4.0),
        Form(row(1, 0), row(0, 1), param=2),
        scalars_of("repeated_complex", row(1, 0), row(0, 1), constant=9.0),
        scalars_of(kind, row(1, 0), row(0, 1), constant=np.inf),
        scalars_of(kind, row(1, 0), row(0, 1), constant=0.25, param=1),
    ]
    search = _Search(Quadratic(forms, 3, 2), 0.1)
    search.best.cost = 2.0
    node = BranchNode(0.0, 1, np.eye(3), {})
    children = search._cut_box(node)
    first = search._first_boxes
    assert list(first) == [0, 2, 4], "what has no bound has no box"
    assert first[0].high == pytest.approx(np.sqrt(2 * 4), rel=2e-9) and first[0].high > np.sqrt(8)
    assert first[2].high == pytest.approx(3 + 3j, rel=2e-9) and first[2].low == -first[2].high
    assert first[4].high == pytest.approx(np.sqrt(2.25), rel=2e-9)
    assert [boxes[0] for _, boxes in children] == list(first[0].halves())
    assert all(boxes[2] == first[2] and boxes[4] == first[4] for _, boxes in children)
    for rays, _ in children:
        np.testing.assert_array_equal(rays, [[0.0, 0.0, 1.0]])
    # Later boxes are measured by the first, whatever the best cost is by then.
    search.best.cost = 1.0
    for half, cut in (
        ({0: Box(-1.0, 1.0), 2: Box(-1 - 1j, 1 + 1j), 4: Box(-0.1, 0.1)}, 0),
        ({0: Box(-0.5, 0.5), 2: Box(-1 - 1j, 1 + 1j), 4: Box(-0.1, 0.1)}, 2),
        ({0: Box(-0.5, 0.5), 2: Box(-1 - 1j, 0j), 4: Box(-0.5, 0.5)}, 4),
    ):
        children = search._cut_box(BranchNode(0.0, 1, np.eye(3)[2:], half))
        assert [boxes[cut] for _, boxes in children] == list(half[cut].halves())
        assert all(rays is children[0][0] for rays, _ in children)
    for share, ends in ((1.1e-9, False), (0.9e-9, True)):
        tiny = {k: Box(share * box.low, share * box.high) for k, box in first.items()}
        assert (search._cut_box(BranchNode(0.0, 1, np.eye(3)[2:], tiny)) is None) == ends
    search._cut_box(node)
    assert search._first_boxes == first, "a later node without boxes does not change the measure"
    search._first_boxes = {0: Box(-0.1, 0.1), 2: Box(-4.0, 4.0)}
    shares = {0: Box(-0.09, 0.09), 2: Box(-3.0, 3.0)}
    children = search._cut_box(BranchNode(0.0, 1, np.eye(3)[2:], shares))
    assert [boxes[0] for _, boxes in children] == list(shares[0].halves()), "0.9 beside 0.75"
    search._first_boxes = {0: Box(-1.0, 1.0)}
    assert search._cut_box(BranchNode(0.0, 1, np.eye(3)[2:], {0: Box(-1e-9, 1e-9)})) is None
    # Where every size is a block's own there is no direction; where no block has a bound there is no box.
    own = _Search(Quadratic([scalars_of(kind, row(1, 0), row(0, 1), param=0)], 1, 2), 0.1)
    own.best.cost = 2.0
    np.testing.assert_array_equal(own._cut_box(BranchNode(0.0, 0, np.eye(1), {}))[0][0], [[0.0]])
    endless = _Search(Quadratic([forms[3], Form(row(1, 0), row(0, 1), param=0)], 1, 2), 0.1)
    endless.best.cost = 2.0
    assert endless._cut_box(BranchNode(0.0, 0, np.eye(1), {})) is None
    own.best.cost, own._first_boxes = 0.0, {}
    with np.errstate(all="raise"):
        assert own._cut_box(BranchNode(0.0, 0, np.eye(1), {})) is None, "a cost of nothing leaves no box"
