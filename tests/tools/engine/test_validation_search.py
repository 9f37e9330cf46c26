"""The branch and bound of the validation: what it returns when it stops; nodes that cover their parent."""

from __future__ import annotations

import numpy as np
import pytest

from lft_problems import row, scalars_of
from lpvguard.engine.validation.branch import Incumbent, _candidates, _NodeBounds, _Search, minimise
from lpvguard.engine.validation.local_search import _Smooth, polish, repeated_starts
from lpvguard.engine.validation.quadratic import Form, Quadratic
from lpvguard.engine.validation.relaxation import Box, BranchNode


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


@pytest.mark.parametrize("weight", [1.0, 0.25, 9.0])
@pytest.mark.parametrize("nodes", [1, 2, 3, 8, 5000])
def test_an_interval_holds_the_optimum_whenever_the_search_stops(weight, nodes):
    best = 4 * weight / (1 + weight)
    found = minimise(two_points(weight), gap=1e-5, max_nodes=nodes)
    assert found.lower <= best * (1 + 1e-9) and found.upper >= best * (1 - 1e-9)
    assert two_points(weight).cost(found.z) == found.upper and found.lower <= found.upper
    assert found.nodes <= nodes + 2
    if nodes == 5000:
        assert found.upper - found.lower <= 1e-5 * found.upper
        assert found.z[0] == pytest.approx((1 - weight) / (1 + weight), abs=1e-3)


@pytest.mark.parametrize("target", [2.0 + 1j, -1 + 2j, -2 - 0.5j, 1 - 2j])
@pytest.mark.parametrize("kind", ["repeated_complex", "repeated_real"])
def test_a_scalar_is_found_in_every_quadrant(kind, target):
    best = 0.75 * abs(target) ** 2
    if kind == "repeated_real":
        best = 0.75 * target.real**2 + 3 * target.imag**2
    found = minimise(scalar_problem(kind, target), gap=1e-4)
    assert found.lower <= best * (1 + 1e-9) and found.upper >= best * (1 - 1e-9)
    assert found.upper - found.lower <= 1e-4 * found.upper
    want = 0.75 * (target.real if kind == "repeated_real" else target)
    assert found.z[0] == pytest.approx(want, abs=0.03)


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
    only = minimise(problem, max_nodes=0, points=[np.array([-0.6, 1.0])])
    assert only.upper == pytest.approx(3.2, rel=1e-6) and only.lower <= 3.2


def test_readings_of_a_primal_matrix_are_its_points():
    point = np.array([0.3 - 1j, 2.0, 1.0])
    for scale in (1.0, 7j):
        found = _candidates(np.outer(scale * point, np.conj(scale * point)))
        assert len(found) >= 2
        for z in found[:2]:
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
