"""The branch and bound of the validation: what it returns when it stops; nodes that cover their parent."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest

from lft_problems import row, scalars_of
from lpvguard.engine.validation import local_search
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


def told(forms: list[Form], asked: list[dict]) -> Quadratic:
    """A problem that adds the scalars at which it is solved to ``asked``, and has one answer for all."""

    class Told(Quadratic):
        def inside(self, scalars):
            asked.append(dict(scalars))
            return 0.5, np.array([0.0, 1.0])

    return Told(forms, 1, 2)


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
        forms = [
            scalars_of(kind, row(0, 6), row(0, b), param=0),
            Form(row(1, 0), row(0, 1), constant=1.0),
        ]
        repeated_starts(told(forms, asked))
        assert len(asked) == local_search.SAMPLES + local_search.MAX_POLISHED
        return np.array([one[0] for one in asked[: local_search.SAMPLES]])

    for b, largest in ((2.0, 12.0), (0.0, 1.0)):
        for kind in ("repeated_complex", "repeated_real"):
            found = drawn(kind, b)
            size = np.abs(found)
            assert len(found) == 150 and 0.9 * largest < size.max() <= largest
            assert 1e-3 * largest <= size.min() < 1.2e-3 * largest
            # Even in the logarithm: half of them below the middle decade and a half.
            assert 0.35 < np.mean(size < largest * 10**-1.5) < 0.65
            if kind == "repeated_real":
                assert not found.imag.any() and 0.3 < np.mean(found.real > 0) < 0.7
            else:
                turns = np.histogram(np.angle(found), 4, (-np.pi, np.pi))[0]
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
    found = np.array([(smooth.inequality(v + h) - smooth.inequality(v - h)) / 2e-6 for h in step]).T
    np.testing.assert_allclose(smooth.inequality_jacobian(v), found, rtol=1e-6, atol=1e-6)


def test_each_repeated_block_has_a_scalar_of_its_own():
    asked: list[dict] = []
    forms = [
        scalars_of("repeated_complex", row(0, 6), row(0, 2), param=0),
        Form(row(1, 0), row(0, 1), constant=1.0),
        scalars_of("repeated_real", row(0, 1), row(0, 2), param=0),
        scalars_of("repeated_complex", row(0, 30), row(0, 1), param=0),
    ]
    assert len(repeated_starts(told(forms, asked))) == local_search.MAX_POLISHED
    first, real, last = (np.array([one[k] for one in asked[:150]]) for k in (0, 2, 3))
    for found, largest in ((first, 12.0), (real, 2.0), (last, 120.0)):
        assert 0.8 * largest < np.abs(found).max() <= largest
    assert not real.imag.any() and first.imag.any() and last.imag.any()
    assert (
        np.abs(np.corrcoef([first.real, first.imag, real.real, last.real, last.imag]) - np.eye(5)).max() < 0.3
    )


@pytest.mark.parametrize("bad", [np.nan, np.inf])
def test_a_search_that_ends_nowhere_has_no_point(bad, monkeypatch):
    monkeypatch.setattr(
        local_search, "minimize", lambda *given, **more: SimpleNamespace(x=np.array([0.5, bad, 1.0, 1.0]))
    )
    assert polish(two_points(), np.array([1.0, 1.0])) is None
