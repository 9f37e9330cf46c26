"""Certificates of the validation: levels and lengths by a scan, a semidefinite solver and differences, and
bounds over boxes at the points in them."""

from __future__ import annotations

import numpy as np
import pytest

from lft_problems import gauss, row, scalars_of
from lpvguard.engine.validation import lmi
from lpvguard.engine.validation.quadratic import Form, Quadratic
from lpvguard.engine.validation.relaxation import Box, BranchNode, Relaxation, _HeldScalars


def hermitian(rng: np.random.Generator, *shape: int) -> np.ndarray:
    a = gauss(rng, *shape, shape[-1])
    return a + a.conj().swapaxes(-1, -2)


def test_the_hermitian_basis_spans_the_hermitian_matrices_and_no_more():
    for r in (1, 2, 3, 4):
        basis = lmi.hermitian_basis(r)
        np.testing.assert_array_equal(basis, basis.conj().swapaxes(1, 2))
        assert np.linalg.matrix_rank(np.hstack([basis.real, basis.imag]).reshape(r * r, -1)) == r * r
        np.testing.assert_array_equal(np.trace(basis, axis1=1, axis2=2), [1.0] * r + [0.0] * (r * r - r))
        assert all(basis[i, i, i] == 1 for i in range(r))


def test_a_gram_matrix_is_the_product_with_each_basis_matrix_between():
    rng = np.random.default_rng(1)
    left, right, basis = gauss(rng, 2, 4), gauss(rng, 2, 4), lmi.hermitian_basis(2)
    found = lmi.gram(left, right, basis)
    assert found.shape == (4, 4, 4)
    for k in range(4):
        np.testing.assert_allclose(found[k], left.conj().T @ basis[k] @ right, rtol=1e-13)
    np.testing.assert_allclose(lmi.gram(left, right, None), [left.conj().T @ right])


def test_a_cone_locates_its_groups_and_normalises_the_traces_of_those_with_a_sign():
    c = lmi.cone([("psd", 1), ("free", 2), ("psd", 3), ("free", 1)])
    assert (c.start, c.size, c.order) == ((0, 1, 5, 14), (1, 4, 9, 1), (1, 0, 3, 0))
    np.testing.assert_array_equal(c.normal, [1] + 4 * [0] + 3 * [1] + 6 * [0] + [0])


@pytest.mark.parametrize("seed", range(4))
def test_the_best_level_of_two_forms_is_that_of_a_scan(seed):
    q = hermitian(np.random.default_rng(seed), 2, 4)
    share = np.linspace(0, 1, 2001)[:, None, None]
    levels = np.linalg.eigvalsh(share * q[0] + (1 - share) * q[1])[:, 0]
    c = lmi.maximise_level(q, lmi.cone([("psd", 1), ("psd", 1)]), relative=1e-7, absolute=1e-9)
    # A proof that no level is positive ends the search.
    best = levels.max()
    assert c.x <= best + 1e-4 and c.x_above >= best - 1e-9
    if best > 0:
        assert c.x == pytest.approx(best, rel=1e-4, abs=1e-6) and c.x_above <= c.x * (1 + 1e-6)
    else:
        assert c.x_above < 0
    assert c.y.sum() == pytest.approx(1) and (c.y > 0).all()
    assert np.linalg.eigvalsh(np.tensordot(c.y, q, axes=1))[0] >= c.x - 1e-12


@pytest.mark.parametrize("seed", range(3))
@pytest.mark.parametrize("groups", [[("psd", 2), ("psd", 1)], [("psd", 2), ("free", 2)], [("psd", 3)]])
def test_the_best_level_with_matrix_multipliers_is_a_semidefinite_solvers(seed, groups):
    cp = pytest.importorskip("cvxpy")
    rng = np.random.default_rng(10 + seed)
    c = lmi.cone(groups)
    q = hermitian(rng, len(c.normal), 4)
    q[0] += 6 * np.eye(4)  # some multiplier proves a level above 0
    members, level = [], cp.Variable()
    for (kind, r), start in zip(groups, c.start, strict=True):
        y = cp.Variable(r * r)
        members.append((y, kind, r, start))
    matrix = sum(y[k] * q[start + k] for y, _, r, start in members for k in range(r * r))
    rules = [matrix - level * np.eye(4) >> 0]
    rules += [
        sum(y[k] * lmi.hermitian_basis(r)[k] for k in range(r * r)) >> 0
        for y, kind, r, _ in members
        if kind == "psd"
    ]
    trace = sum(y[k] for y, kind, r, _ in members if kind == "psd" for k in range(r))
    best = cp.Problem(cp.Maximize(level), [*rules, trace == 1]).solve(solver=cp.CLARABEL)
    assert best > 0.1
    found = lmi.maximise_level(q, c, relative=1e-6)
    assert found.x <= best * (1 + 1e-6) and found.x_above >= best * (1 - 1e-6)
    assert found.x == pytest.approx(best, rel=1e-5)
    assert c.normal @ found.y == pytest.approx(1)
    rough = lmi.maximise_level(q, c, relative=0.3)
    assert rough.x_above - rough.x <= 0.3 * rough.x and rough.x <= best * (1 + 1e-9) <= rough.x_above * (
        1 + 2e-9
    )


def test_the_primal_matrix_is_the_slacks_inverse():
    q = hermitian(np.random.default_rng(2), 3, 5) + np.eye(5)
    c = lmi.maximise_level(q, lmi.cone(3 * [("psd", 1)]), relative=1e-3)
    slack = np.tensordot(c.y, q, axes=1) - c.x * np.eye(5)
    np.testing.assert_allclose(c.inverse @ slack, np.eye(5), atol=1e-6)


def test_the_barriers_derivatives_are_those_of_its_differences():
    rng = np.random.default_rng(5)
    c = lmi.cone([("psd", 1), ("psd", 2), ("free", 1)])
    q, eps = hermitian(rng, 6, 3), 0.37
    forms = np.concatenate([q, -np.eye(3)[None]])
    v = np.array([0.7, 0.6, 0.5, 0.1, -0.2, 0.3, -9.0])  # y, then x, far below every eigenvalue

    def value(v: np.ndarray) -> float:
        slack = np.tensordot(v, forms, axes=1)
        member = np.tensordot(v[1:5], lmi.hermitian_basis(2), axes=1)
        logs = np.linalg.slogdet(slack)[1] + np.linalg.slogdet(member)[1] + np.log(v[0])
        return v[6] + eps * logs

    def gradient(v: np.ndarray) -> np.ndarray:
        return lmi._barrier(np.linalg.inv(np.tensordot(v, forms, axes=1)), forms, c, v[:6], eps)[0]

    step = 1e-5 * np.eye(7)
    np.testing.assert_allclose(gradient(v), [(value(v + h) - value(v - h)) / 2e-5 for h in step], rtol=1e-6)
    hessian = lmi._barrier(np.linalg.inv(np.tensordot(v, forms, axes=1)), forms, c, v[:6], eps)[1]
    np.testing.assert_allclose(
        hessian, [-(gradient(v + h) - gradient(v - h)) / 2e-5 for h in step], rtol=1e-5, atol=1e-7
    )


def test_a_step_is_halved_until_it_stays_inside():
    c, q = lmi.cone([("psd", 1), ("psd", 1)]), np.stack([np.diag([1.0, 2.0]), np.diag([2.0, 1.0])])
    y, x = np.array([0.5, 0.5]), 0.0
    # y_1 reaches 0 at 0.5 of the step, the slack's least eigenvalue at x = 1.5.
    for step, length in (([-1.0, 1.0, 0.0], 0.25), ([0.0, 0.0, 2.0], 0.5), ([0.1, -0.1, 0.2], 1.0)):
        new, level, slack, taken = lmi._feasible_step(q, c, y, x, np.array(step), 1.0)
        assert taken == length and level == length * step[2]
        np.testing.assert_allclose(new, y + length * np.array(step[:2]))
        np.testing.assert_allclose(slack, np.tensordot(new, q, axes=1) - level * np.eye(2))
    assert lmi._feasible_step(q, c, y, x, np.array([0.0, 0.0, 1e12]), 1.0) is None
    matrix = lmi.cone([("psd", 2)])
    inside = np.array([0.6, 0.4, 0.48, 0.0])  # determinant 0.24 - 0.2304
    assert lmi._interior(matrix, inside) and not lmi._interior(matrix, inside + np.array([0, 0, 0.02, 0]))
    assert not lmi._interior(c, np.array([0.0, 1.0])) and not lmi._interior(c, np.array([1.0, 0.0]))
    assert lmi._interior(lmi.cone([("psd", 1), ("free", 2)]), np.array([1.0, -1, 0, 0, 5]))


def test_the_rounding_of_a_sum_is_that_of_its_terms():
    forms = np.array([np.diag([3.0, 4.0]), 1j * np.array([[0, 2.0], [-2.0, 0]])])
    want = 4 * 2 * 2.0**-52 * (1.5 * 5 + 0.5 * np.sqrt(8))
    assert lmi.rounding(np.array([1.5, -0.5]), forms) == pytest.approx(want, rel=1e-12, abs=0)


def test_a_certificate_reaches_to_where_it_stops_being_positive():
    rng = np.random.default_rng(6)
    a, slopes = gauss(rng, 4, 4), gauss(rng, 2, 4, 4)
    zero, slopes = a @ a.conj().T + np.eye(4), slopes @ slopes.conj().swapaxes(1, 2)
    slopes = np.concatenate([slopes, np.zeros((1, 4, 4))])
    error = 0.2
    found = lmi.reach(zero, slopes, error)
    for length, slope in zip(found[:2], slopes, strict=False):
        at = np.linalg.eigvalsh(zero - error * np.eye(4) - length * slope)[0]
        assert abs(at) < 1e-9 and np.linalg.eigvalsh(zero - length * slope)[0] == pytest.approx(
            error, abs=1e-9
        )
    assert found[2] == np.inf
    least = np.linalg.eigvalsh(zero)[0]
    np.testing.assert_array_equal(lmi.reach(zero, slopes, 1.001 * least), np.zeros(3))
    assert lmi.reach(zero, slopes)[0] > found[0]
    # Never past the end, whatever rounding does: a trillionth is left.
    assert lmi.reach(np.eye(1), np.ones((1, 1, 1)))[0] == 1 - 1e-12


def test_many_certificates_reach_as_each_alone():
    rng = np.random.default_rng(7)
    a = gauss(rng, 2, 3, 4, 4)
    zeros = a @ a.conj().swapaxes(-1, -2)
    slopes = hermitian(rng, 2, 4)
    slopes = np.concatenate([slopes @ slopes, np.zeros((1, 4, 4))])
    errors = np.full((2, 3), 1e-4)
    errors[1, 2] = 1.01 * np.linalg.eigvalsh(zeros[1, 2])[0]
    errors[0, 1] = 0.6 * np.linalg.eigvalsh(zeros[0, 1])[0]  # less than half is left: not called positive
    found = lmi.reaches(zeros, slopes, errors)
    for i in range(2):
        for j in range(3):
            if (i, j) in ((1, 2), (0, 1)):
                assert (found[i, j] == -np.inf).all()
            else:
                np.testing.assert_allclose(
                    found[i, j], lmi.reach(zeros[i, j], slopes, errors[i, j]), rtol=1e-12
                )


@pytest.mark.parametrize("seed", range(4))
def test_a_rays_length_is_where_the_best_level_falls_to_zero(seed, monkeypatch):
    """Two forms: at each length the best level is that of a scan, and it is zero at the end of the ray."""
    rng = np.random.default_rng(20 + seed)
    q0 = hermitian(rng, 2, 4)
    q0[0] += 6 * np.eye(4)
    level = gauss(rng, 2, 4, 4)
    level = level @ level.conj().swapaxes(1, 2)
    share = np.linspace(0, 1, 4001)[:, None, None]

    def best(length: float) -> float:
        q = q0 - length * level
        return np.linalg.eigvalsh(share * q[0] + (1 - share) * q[1])[:, 0].max()

    low, high = 0.0, 100.0
    for _ in range(40):
        middle = 0.5 * (low + high)
        low, high = (middle, high) if best(middle) > 0 else (low, middle)
    c = lmi.cone([("psd", 1), ("psd", 1)])
    for plain in (False, True):
        monkeypatch.setenv("LPVGUARD_NO_NATIVE", "1" if plain else "")
        length, y, inverse = lmi.ray_length(q0, level, c)
        assert length <= low * (1 + 1e-6) and length == pytest.approx(low, rel=2e-4)
        at = np.tensordot(y, q0 - length * level, axes=1)
        assert np.linalg.eigvalsh(at)[0] > -1e-9 and (y > 0).all() and inverse.shape == (4, 4)
        part, _, _ = lmi.ray_length(q0, level, c, cutoff=0.3 * low)
        assert 0.3 * low <= part <= low * (1 + 1e-6)
    nothing = lmi._ray_length_numpy(q0 - 40 * np.eye(4), level, c, np.inf)
    assert nothing[0] == 0.0 and nothing[1] is None


# --- boxes and bounds over nodes ---


def test_the_moduli_and_halves_of_a_box():
    box = Box(1 - 1j, 4 + 5j)
    assert box.centre == 2.5 + 2j and box.radius == pytest.approx(np.hypot(3, 6) / 2)
    assert box.least == 1.0 and box.most == pytest.approx(np.hypot(4, 5))
    assert set(box.corners) == {1 - 1j, 4 - 1j, 1 + 5j, 4 + 5j} and len(box.corners) == 4
    assert box.halves() == (Box(1 - 1j, 4 + 2j), Box(1 + 2j, 4 + 5j))
    wide = Box(-7 + 2j, -1 + 3j)
    assert wide.least == pytest.approx(np.hypot(1, 2)) and wide.most == pytest.approx(np.hypot(7, 3))
    assert wide.halves() == (Box(-7 + 2j, -4 + 3j), Box(-4 + 2j, -1 + 3j))
    assert Box(-2 - 5j, 3 - 1j).most == pytest.approx(np.hypot(3, 5))
    assert Box(-4 - 5j, 3 - 1j).least == 1.0 and Box(-4 - 5j, 3 - 1j).most == pytest.approx(np.hypot(4, 5))
    line = Box(-2.0, 3.0)
    assert (line.centre, line.radius, line.least, line.most) == (0.5, 2.5, 0.0, 3.0)
    assert line.corners == [-2.0, 3.0] and line.halves() == (Box(-2.0, 0.5), Box(0.5, 3.0))
    assert Box(0j, 1 + 1j).halves() == (Box(0j, 0.5 + 1j), Box(0.5 + 0j, 1 + 1j))


def test_boxes_force_sizes():
    """|delta| >= 2 in units of slope 4, less a constant of 0.25, is a size of 0.75."""
    one = row(1, 0)
    forms = [
        scalars_of("repeated_real", one, row(0, 1), constant=0.25, param=0, slope=4.0),
        scalars_of("repeated_complex", one, row(0, 1), param=0, slope=9.0),
        scalars_of("repeated_real", one, row(0, 1), constant=0.5, param=1),
        scalars_of("repeated_real", one, row(0, 1), constant=1.0),
    ]
    relaxation = Relaxation(Quadratic(forms, 2, 2))

    def bound(boxes: dict[int, Box], params: set[int]) -> float:
        return relaxation.box_bound(BranchNode(0.0, 0, np.eye(2), boxes), params)

    assert bound({0: Box(2.0, 3.0)}, {0, 1}) == 0.75
    assert bound({0: Box(2.0, 3.0), 1: Box(3 + 0j, 4 + 1j)}, {0, 1}) == 1.0
    assert bound({0: Box(2.0, 3.0), 2: Box(-2.0, -1.5)}, {0, 1}) == 0.75 + 1.75
    assert bound({0: Box(2.0, 3.0), 2: Box(-2.0, -1.5)}, {1}) == 1.75
    assert bound({0: Box(-1.0, 0.1), 3: Box(5.0, 6.0)}, {0, 1}) == 0.0
    assert bound({}, {0, 1}) == 0.0


@pytest.mark.parametrize("corner", [3 + 5j, -3 + 5j, -3 - 5j, 3 - 5j])
def test_a_bound_over_a_box_holds_at_its_farthest_corner(corner):
    """x = delta, |x|^2 <= p and |x - corner| <= 0.01: the corner needs p = 34, whatever its quadrant."""
    forms = [
        Form(row(1, -corner), row(0, 1), constant=1e-4),
        scalars_of("repeated_complex", row(1, 0), row(0, 1), param=0),
    ]
    problem = Quadratic(forms, 1, 2)
    near = 0.1 * corner
    low = complex(min(corner.real, near.real), min(corner.imag, near.imag))
    high = complex(max(corner.real, near.real), max(corner.imag, near.imag))
    node = BranchNode(0.0, 0, np.zeros((1, 1)), {1: Box(low, high)})
    relaxation = Relaxation(problem)
    bound, _, _ = relaxation.lower(node, np.inf)
    least = (abs(corner) - 0.01) ** 2
    assert problem.cost(np.array([corner, 1.0])) == pytest.approx(34) and abs(corner) ** 2 == pytest.approx(
        34
    )
    assert bound <= 34
    side = 1e-3 * (1 + 1j)
    tight = BranchNode(0.0, 0, np.zeros((1, 1)), {1: Box(corner - side, corner + side)})
    assert relaxation.lower(tight, np.inf)[0] <= 34
    assert relaxation.box_bound(tight, {0}) == pytest.approx(least, rel=2e-2)


def least_over(problem: Quadratic, deltas: dict[int, complex]) -> float:
    """Least cost with these scalars over grids of the one number that they leave free, each finer."""
    z, null = problem.on_subspace(problem.inside(deltas)[1], deltas)
    assert null.shape[1] == 1
    axis, at, least = np.linspace(-1, 1, 41), 0.0, np.inf
    grid = (axis[:, None] + 1j * axis).ravel()
    for reach in 4.0 * 0.3 ** np.arange(12):
        points = np.hstack([z[:-1] + (at + reach * grid)[:, None] * null[:, 0], np.ones((len(grid), 1))])
        sizes = np.zeros((len(grid), problem.params))
        for f in problem.forms:
            top, bottom = (np.sum(np.abs(points @ m.T) ** 2, axis=1) for m in (f.a, f.b))
            if f.param < 0:
                sizes[top > f.constant * f.slope * bottom] = np.inf
            else:
                sizes[:, f.param] = np.maximum(sizes[:, f.param], top / (f.slope * bottom) - f.constant)
        costs = sizes.sum(axis=1)
        if costs.min() < least:
            least, at = costs.min(), at + reach * grid[np.argmin(costs)]
    return float(least)


@pytest.mark.parametrize("kind", ["repeated_complex", "repeated_real"])
@pytest.mark.parametrize("seed", range(5))
@pytest.mark.parametrize("shared", [False, True])
def test_both_bounds_over_a_node_lie_below_each_cost_in_it_and_close_to_the_least_of_a_small_one(
    kind, seed, shared
):
    """A ball, a full block and a repeated one of two rows: with the scalar held, three forms, which the
    S-procedure settles without a gap."""
    rng = np.random.default_rng(seed)
    turn = 0.0 if kind == "repeated_real" else 1.0
    centre = complex(0.5, -0.4 * turn)
    maps = gauss(rng, 4, 2, 4)
    block = scalars_of(kind, maps[2], maps[3], param=0 if shared else 1, slope=1.3)
    full = Form(maps[1], row(0, 0, 0, 1.5), param=0, slope=0.7)
    side = 0.3 * (1 + 1j * turn)
    of_box = [0.0, 0.7 * side, -side, np.conj(side), -0.5 * np.conj(side)]
    # A ball that every scalar of the larger box leaves room in, but not much.
    plain = Quadratic([Form(maps[0], row(0, 0, 0, 1), constant=1.0), full, block], 1 if shared else 2, 4)
    room = max(plain.inside({2: centre + d})[0] for d in of_box) ** 2
    forms = [Form(maps[0], row(0, 0, 0, 1), constant=1.3 * room), full, block]
    problem = Quadratic(forms, plain.params, 4)
    assert problem.boxed == (set() if shared else {1})
    relaxation = Relaxation(problem)
    rays = np.array([[1.0] if shared else [1.0, 0.0]])
    for share in (1.0, 1e-5):
        node = BranchNode(0.0, 0, rays, {2: Box(centre - share * side, centre + share * side)})
        lower, central, _ = relaxation.lower(node, np.inf)
        tangent = relaxation.tangent(node, np.inf)
        costs = [least_over(problem, {2: centre + share * d}) for d in of_box]
        assert lower <= min(costs) * (1 + 1e-9) and tangent.lower <= min(costs) * (1 + 1e-9)
        assert lower <= central * (1 + 1e-6) and tangent.box <= tangent.centre * (1 + 1e-6)
        assert tangent.lower <= min(tangent.box, tangent.cone) * (1 + 1e-9)
    assert tangent.centre <= costs[0] * (1 + 1e-9)
    assert lower >= costs[0] * (1 - 2e-3)
    if not shared:
        assert tangent.lower >= costs[0] * (1 - 2e-3)


def test_a_real_scalar_does_not_reach_an_imaginary_target():
    """x = delta and |x - 1j|^2 <= p1: a real delta leaves 1, a complex one nothing."""
    for kind, least in (("repeated_real", 1.0), ("repeated_complex", 0.0)):
        forms = [
            scalars_of(kind, row(1, 0), row(0, 1), param=0),
            Form(row(1, -1j), row(0, 1), param=1),
        ]
        side = 5.0 if kind == "repeated_real" else 5 + 5j
        node = BranchNode(0.0, 0, np.array([[0.0, 1.0]]), {0: Box(-side, side)})
        found, _, _ = Relaxation(Quadratic(forms, 2, 2)).lower(node, np.inf)
        assert least * (1 - 1e-4) <= found <= least + 1e-6


def test_a_scalar_without_a_bound_bounds_nothing():
    forms = [
        scalars_of("repeated_complex", row(1, 0), row(0, 1), constant=np.inf),
        Form(row(1, -1), row(0, 1), param=0),
        Form(row(1, 1), row(0, 1), param=1),
    ]
    node = BranchNode(0.0, 0, np.array([[0.5, 0.5]]), {})
    found, _, _ = Relaxation(Quadratic(forms, 2, 2)).lower(node, np.inf)
    assert found == pytest.approx(2.0, rel=1e-4)


def test_a_cone_of_sizes_is_bounded_at_its_edges():
    """|x - 1|^2 <= p0 and |x + 1|^2 <= p1: the least sum on a ray, and over a cone of rays."""
    forms = [Form(row(1, -1), row(0, 1), param=0), Form(row(1, 1), row(0, 1), param=1)]
    relaxation = Relaxation(Quadratic(forms, 2, 2))
    for rays, centre in (
        (np.eye(2), 0.5),
        (np.array([[0.6, 0.4], [0.4, 0.6]]), 0.5),
        (np.array([[0.9, 0.1]]), 0.9),
    ):
        lower, central, _ = relaxation.lower(BranchNode(0.0, 0, rays, {}), np.inf)
        exact = 4 / (np.sqrt(centre) + np.sqrt(1 - centre)) ** 2
        assert central == pytest.approx(exact, rel=1e-4) and lower <= central * (1 + 1e-9)
        # No point of the cone costs less: |x - 1| + |x + 1| is at least 2.
        for share in np.linspace(rays[:, 0].min(), rays[:, 0].max(), 11):
            assert lower <= 4 / (np.sqrt(share) + np.sqrt(1 - share)) ** 2 * (1 + 1e-9)
        if len(rays) == 1:
            assert lower == pytest.approx(central, rel=1e-6)
    assert relaxation.tangent(BranchNode(0.0, 0, np.eye(2), {}), np.inf) is None
    assert 1.5 <= relaxation.lower(BranchNode(0.0, 0, np.array([[0.5, 0.5]]), {}), 1.5)[0] <= 2 * (1 + 1e-9)


def test_a_constant_beside_a_size_is_taken_off_what_a_scalar_forces():
    """x = delta and |x|^2 <= 1 + p: at delta = 2 the size is 3."""
    forms = [
        Form(row(1, 0), row(0, 1), constant=100.0),
        scalars_of("repeated_real", row(1, 0), row(0, 1), constant=1.0, param=0),
    ]
    problem = Quadratic(forms, 1, 2)
    node = BranchNode(0.0, 0, np.zeros((1, 1)), {1: Box(2.0 - 1e-6, 2.0 + 1e-6)})
    relaxation = Relaxation(problem)
    assert problem.cost(np.array([2.0, 1.0])) == 3.0
    assert relaxation.lower(node, 10.0)[0] <= 13.0 and relaxation.box_bound(node, {0}) == pytest.approx(
        3.0, rel=1e-5
    )
    held = _HeldScalars(problem, node.boxes)
    assert held.base(np.array([2.0])) == pytest.approx(3.0, rel=1e-5)
    # The tangent of |d|^2 at the centre lies below it.
    assert held.base(np.array([3.0])) == pytest.approx(2 * 2 * 3 - 4 - 1, rel=1e-5)
