"""Certificates of the validation: levels and lengths by a scan, a semidefinite solver and differences, and
bounds over boxes at the points in them."""

import numpy as np
import pytest

from lft_problems import gauss, hermitian, row, scalars_of
from lpvguard.base.errors import InputError
from lpvguard.engine.validation import lmi
from lpvguard.engine.validation.quadratic import Form, Quadratic
from lpvguard.engine.validation.relaxation import PENALTIES, Box, BranchNode, Relaxation, _HeldScalars


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
    gramian = lmi.gram(left, right, basis)
    assert gramian.shape == (4, 4, 4)
    for k in range(4):
        np.testing.assert_allclose(gramian[k], left.conj().T @ basis[k] @ right, rtol=1e-13)
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
    certificate = lmi.maximise_level(q, c, relative=1e-6)
    assert certificate.x <= best * (1 + 1e-6) and certificate.x_above >= best * (1 - 1e-6)
    assert certificate.x == pytest.approx(best, rel=1e-5)
    assert c.normal @ certificate.y == pytest.approx(1)
    rough = lmi.maximise_level(q, c, relative=0.3)
    assert rough.x_above - rough.x <= 0.3 * rough.x and rough.x <= best * (1 + 1e-9) <= rough.x_above * (
        1 + 2e-9
    )


@pytest.mark.parametrize("shift", [5.0, 0.0])
def test_a_level_is_known_to_a_tenth_or_a_billionth_unless_asked_for_more(shift):
    """Real forms are taken, too."""
    q = np.stack([np.diag([1.0, -1.0]), np.diag([-1.0, 1.0])]) + shift * np.eye(2)
    c = lmi.cone(2 * [("psd", 1)])
    default, stated = lmi.maximise_level(q, c), lmi.maximise_level(q + 0j, c, relative=0.1, absolute=1e-9)
    assert (default.x, default.x_above) == (stated.x, stated.x_above)
    assert default.x <= shift <= default.x_above
    assert 0 < default.x_above - default.x <= max(1e-9, 0.1 * abs(default.x))


def test_the_primal_matrix_is_the_slacks_inverse():
    q = hermitian(np.random.default_rng(2), 3, 5) + np.eye(5)
    c = lmi.maximise_level(q, lmi.cone(3 * [("psd", 1)]), relative=1e-3)
    slack = np.tensordot(c.y, q, axes=1) - c.x * np.eye(5)
    np.testing.assert_allclose(c.inverse @ slack, np.eye(5), atol=1e-6)


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
    reached = lmi.reach(zero, slopes, error)
    for length, slope in zip(reached[:2], slopes, strict=False):
        at = np.linalg.eigvalsh(zero - error * np.eye(4) - length * slope)[0]
        assert abs(at) < 1e-9 and np.linalg.eigvalsh(zero - length * slope)[0] == pytest.approx(
            error, abs=1e-9
        )
    assert reached[2] == np.inf
    least = np.linalg.eigvalsh(zero)[0]
    np.testing.assert_array_equal(lmi.reach(zero, slopes, 1.001 * least), np.zeros(3))
    assert lmi.reach(zero, slopes)[0] > reached[0]
    # Never past the end, whatever rounding does: a trillionth is left.
    assert lmi.reach(np.eye(1), np.ones((1, 1, 1)))[0] == 1 - 1e-12
    assert lmi.reaches(np.eye(1)[None], np.ones((1, 1, 1)), np.zeros(1)).tolist() == [[1 - 1e-12]]


def test_many_certificates_reach_as_each_alone():
    rng = np.random.default_rng(7)
    a = gauss(rng, 2, 3, 4, 4)
    zeros = a @ a.conj().swapaxes(-1, -2)
    slopes = hermitian(rng, 2, 4)
    slopes = np.concatenate([slopes @ slopes, np.zeros((1, 4, 4))])
    errors = np.full((2, 3), 1e-4)
    errors[1, 2] = 1.01 * np.linalg.eigvalsh(zeros[1, 2])[0]
    errors[0, 1] = 0.6 * np.linalg.eigvalsh(zeros[0, 1])[0]  # less than half is left: not called positive
    times = lmi.reaches(zeros, slopes, errors)
    for i in range(2):
        for j in range(3):
            if (i, j) in ((1, 2), (0, 1)):
                assert (times[i, j] == -np.inf).all()
            else:
                np.testing.assert_allclose(
                    times[i, j], lmi.reach(zeros[i, j], slopes, errors[i, j]), rtol=1e-12
                )


def test_free_forms_of_zero_change_no_level():
    """They make Newton's equations singular: the least step leaves them alone."""
    q = hermitian(np.random.default_rng(3), 2, 3)
    q[0] += 4 * np.eye(3)
    alone = lmi.maximise_level(q, lmi.cone(2 * [("psd", 1)]), relative=1e-4)
    beside = lmi.maximise_level(
        np.concatenate([q, np.zeros((1, 3, 3))]), lmi.cone([*2 * [("psd", 1)], ("free", 1)]), relative=1e-4
    )
    assert beside.x == pytest.approx(alone.x, rel=1e-6) and abs(beside.y[2]) < 1e-12
    np.testing.assert_allclose(beside.y[:2], alone.y, rtol=1e-5)


@pytest.mark.parametrize("seed", range(4))
@pytest.mark.parametrize("copies", [[1.0, 1.0], [1.0, 1.0, 2.0], [1.0, -1.0]])
def test_free_forms_of_one_span_are_one_form_with_multipliers_as_small(seed, copies):
    """Their multiples may cancel; what is left must not rest on the rounding of large ones."""
    q = hermitian(np.random.default_rng(seed), 3, 4)
    q[0] += 5 * np.eye(4)
    once = lmi.maximise_level(q, lmi.cone([*2 * [("psd", 1)], ("free", 1)]), relative=1e-6)
    twice = lmi.maximise_level(
        np.stack([q[0], q[1], *(k * q[2] for k in copies)]),
        lmi.cone([*2 * [("psd", 1)], *len(copies) * [("free", 1)]]),
        relative=1e-6,
    )
    assert twice.x == pytest.approx(once.x, rel=1e-5) and twice.x_above >= once.x * (1 - 1e-9)
    assert np.abs(twice.y).max() < 2 * np.abs(once.y).max()


def test_the_rounding_counts_rows_and_not_forms():
    assert lmi.rounding(np.ones(3), np.ones((3, 2, 2))) == pytest.approx(4 * 2 * 2.0**-52 * 3 * 2, abs=0)


def test_what_nothing_ends_is_divided_by_nothing():
    still, rising = np.zeros((1, 2, 2)), np.stack([np.zeros((2, 2)), 4 * np.eye(2)])
    with np.errstate(all="raise"):
        assert lmi.reach(np.eye(2), still).tolist() == [np.inf]
        assert lmi.reaches(np.eye(2)[None], rising, np.zeros(1)) == pytest.approx(np.array([[np.inf, 0.25]]))


def test_a_zero_must_be_positive_by_more_than_its_error_left_once_more():
    """1 - error has to be above error."""
    times = lmi.reaches(np.stack([np.eye(2)] * 2), np.eye(2)[None], np.array([0.5, 0.499]))
    assert times[0, 0] == -np.inf and times[1, 0] == pytest.approx(0.501)


@pytest.mark.unhurried
@pytest.mark.parametrize("seed", range(4))
def test_a_rays_length_is_where_the_best_level_falls_to_zero(seed):
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
    length, y, inverse = lmi.ray_length(q0, level, c)
    assert length <= low * (1 + 1e-6) and length == pytest.approx(low, rel=2e-4)
    at = np.tensordot(y, q0 - length * level, axes=1)
    assert np.linalg.eigvalsh(at)[0] > -1e-9 and (y > 0).all() and inverse.shape == (4, 4)
    part, _, _ = lmi.ray_length(q0, level, c, 0.3 * low)
    assert 0.3 * low <= part <= low * (1 + 1e-6)


ON_A_RAY = {
    "two numbers": [("psd", 1), ("psd", 1)],
    "four numbers": 4 * [("psd", 1)],
    "a matrix and a number": [("psd", 2), ("psd", 1)],
    "a matrix of three and a free number": [("psd", 3), ("free", 1)],
    "a free number between": [("psd", 1), ("free", 1), ("psd", 2)],
}


def along_a_ray(groups: list[tuple[str, int]], seed: int, shift: float = 6.0):
    """(q0, level, cone) of which some multiplier proves a length where ``shift`` is large."""
    rng, c = np.random.default_rng(seed), lmi.cone(groups)
    n, m = 3 + seed % 3, len(c.normal)
    q0, level = hermitian(rng, m, n), np.zeros((m, n, n), complex)
    q0[0] += shift * np.eye(n)
    for (kind, r), start in zip(groups, c.start, strict=True):
        if kind == "psd":
            a = gauss(rng, r if r > 1 else n, n)
            level[start : start + r * r] = lmi.gram(a, a, lmi.hermitian_basis(r) if r > 1 else None)
    return q0, level, c


@pytest.mark.parametrize("name", ON_A_RAY)
def test_rows_that_are_positive_at_any_length_change_none(name):
    """With 14 of them the kernel is the one of larger problems."""
    for seed in range(3):
        q0, level, c = along_a_ray(ON_A_RAY[name], seed)
        n = len(q0[0])
        wide, beside = (np.zeros((len(q0), n + 14, n + 14), complex) for _ in range(2))
        wide[:, :n, :n], beside[:, :n, :n] = q0, level
        wide[:, n:, n:] = 20.0 * c.normal[:, None, None] * np.eye(14)
        length, y, _ = lmi.ray_length(q0, level, c)
        wider, wider_y, inverse = lmi.ray_length(wide, beside, c)
        assert wider == pytest.approx(length, rel=1e-4) and inverse.shape == wide[0].shape
        for multipliers in (y, wider_y):
            assert c.normal @ multipliers == pytest.approx(1.0)
            at = np.tensordot(multipliers, q0 - (1 - 1e-6) * length * level, axes=1)
            assert np.linalg.eigvalsh(at)[0] > 0


def test_a_ray_that_nothing_ends_is_endless():
    """Free multiples of all Hermitian matrices make up for any level; they grow until that is called endless,
    not until they overflow."""
    c = lmi.cone([("psd", 1), ("free", 2)])
    q0 = np.concatenate([np.diag([1.0, -1.0])[None], lmi.hermitian_basis(2)])
    level = np.concatenate([np.array([[[2.0, 1j], [-1j, 1.0]]]), 0 * lmi.hermitian_basis(2)])
    length, y, _ = lmi.ray_length(q0, level, c)
    assert length == np.inf and np.isfinite(y).all()


def test_a_ray_takes_real_and_turned_forms_and_says_where_nothing_is_proved():
    q0, level, c = along_a_ray(ON_A_RAY["four numbers"], 1)
    want = lmi.ray_length(q0.real, level.real, c)[0]
    assert lmi.ray_length(q0.real + 0j, level.real + 0j, c)[0] == pytest.approx(want, rel=1e-9) and want > 0
    want = lmi.ray_length(q0.conj(), level.conj(), c)[0]
    assert lmi.ray_length(q0.swapaxes(1, 2), level.swapaxes(1, 2), c)[0] == pytest.approx(want, rel=1e-9)
    length, y, inverse = lmi.ray_length(q0 - 40 * np.eye(len(q0[0])), level, c)
    assert (length, y) == (0.0, None) and inverse.shape == q0[0].shape


def test_a_certificate_has_at_most_64_rows_256_multipliers_and_groups_of_order_16():
    rng = np.random.default_rng(2)
    for n, groups, fits in (
        (16, 4 * [("psd", 4)], True),
        (17, [("psd", 1)], True),
        (2, [*4 * [("psd", 4)], ("psd", 1)], True),
        (2, [("psd", 5)], True),
        (64, [("psd", 1)], True),
        (2, 4 * [("psd", 8)], True),
        (65, [("psd", 1)], False),
        (2, [*4 * [("psd", 8)], ("free", 1)], False),
        (2, [("psd", 16)], True),
        (2, [("psd", 17)], False),
    ):
        c = lmi.cone(groups)
        q0 = hermitian(rng, len(c.normal), n)
        if fits:
            length, y, inverse = lmi.ray_length(q0 - 1e3 * np.eye(n), 0 * q0, c, 1.0)
            assert inverse.shape == (n, n) and (y is None) == (length == 0.0)
            assert lmi.maximise_level(q0, c).y @ c.normal == pytest.approx(1.0)
        else:
            with pytest.raises(InputError, match="at most 64, 256 and 16"):
                lmi.ray_length(q0, 0 * q0, c)


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
        forms = [scalars_of(kind, row(1, 0), row(0, 1), param=0), Form(row(1, -1j), row(0, 1), param=1)]
        side = 5.0 if kind == "repeated_real" else 5 + 5j
        node = BranchNode(0.0, 0, np.array([[0.0, 1.0]]), {0: Box(-side, side)})
        bound, _, _ = Relaxation(Quadratic(forms, 2, 2)).lower(node, np.inf)
        assert least * (1 - 1e-4) <= bound <= least + 1e-6


def test_a_scalar_without_a_bound_bounds_nothing():
    forms = [
        scalars_of("repeated_complex", row(1, 0), row(0, 1), constant=np.inf),
        Form(row(1, -1), row(0, 1), param=0),
        Form(row(1, 1), row(0, 1), param=1),
    ]
    node = BranchNode(0.0, 0, np.array([[0.5, 0.5]]), {})
    bound, _, _ = Relaxation(Quadratic(forms, 2, 2)).lower(node, np.inf)
    assert bound == pytest.approx(2.0, rel=1e-4)


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


def mixed_forms() -> list[Form]:
    """Forms of one row with every kind of bound; sizes 0 and 1 have two users and one."""
    rng = np.random.default_rng(17)
    maps = gauss(rng, 12, 1, 3)
    return [
        Form(maps[0], maps[1], constant=2.0, slope=3.0),
        Form(maps[2], maps[3], constant=0.5, param=0, slope=2.0),
        scalars_of("repeated_real", maps[4], maps[5], param=1, slope=7.0),
        scalars_of("repeated_complex", maps[6], maps[7], constant=np.inf),
        scalars_of("repeated_complex", maps[8], maps[9], constant=4.0),
        scalars_of("repeated_complex", maps[10], maps[11], param=0, slope=1.5),
    ]


BOXES = {2: Box(1.0, 3.0), 4: Box(-1 + 1j, 1 + 4j), 5: Box(0j, 1 + 1j)}


def test_a_certificate_is_made_of_each_bound_each_box_and_the_reality_of_scalars():
    forms = mixed_forms()
    problem = Quadratic(forms, 2, 3)
    assert problem.boxed == {1}
    aa, bb = ([m.conj().T @ m for m in maps] for maps in ([f.a for f in forms], [f.b for f in forms]))

    def off_centre(k: int, centre: complex) -> np.ndarray:
        d = forms[k].a - centre * forms[k].b
        return d.conj().T @ d

    turned = 1j * forms[2].a.conj().T @ forms[2].b
    wanted = [
        (aa[0] - 6 * bb[0], 0 * bb[0], -1),
        (aa[1] - bb[1], 2 * bb[1], 0),
        (aa[2] - 9 * bb[2], 0 * bb[2], -1),
        (turned + turned.conj().T, 0 * bb[2], -1),
        (off_centre(2, 2.0) - bb[2], 0 * bb[2], -1),
        (aa[4] - 4 * bb[4], 0 * bb[4], -1),
        (off_centre(4, 2.5j) - 3.25 * bb[4], 0 * bb[4], -1),
        (aa[5], 1.5 * bb[5], 0),
        (off_centre(5, 0.5 + 0.5j) - 0.5 * bb[5], 0 * bb[5], -1),
    ]
    g = Relaxation(problem)._generators(BOXES)
    assert len(g.q0) == len(wanted) and g.param.tolist() == [w[2] for w in wanted]
    assert g.cone.order == (1, 1, 1, 0, 1, 1, 1, 1, 1)
    for q0, level, (zero, slope, _) in zip(g.q0, g.level, wanted, strict=True):
        np.testing.assert_allclose(q0, zero / np.abs(zero).max(), atol=1e-14)
        np.testing.assert_allclose(level, slope / np.abs(zero).max(), atol=1e-14)
    # Without a box a size of its own is a level like any other.
    g = Relaxation(problem)._generators({})
    assert g.param.tolist() == [-1, 0, 1, -1, -1, 0] and g.cone.order == (1, 1, 1, 0, 1, 1)
    np.testing.assert_allclose(g.level[2], 7 * bb[2] / np.abs(aa[2]).max(), atol=1e-14)
    # The forms that are no repeated block's alone are what the tangent is made of.
    plain = Relaxation(problem)._plain
    assert plain.param.tolist() == [-1, 0] and plain.cone.order == (1, 1)
    assert Relaxation(Quadratic(forms[2:5], 2, 3))._plain is None
    nothing = Relaxation(Quadratic([Form(row(0, 0), row(0, 0), param=0)], 1, 2))._plain
    np.testing.assert_array_equal(nothing.q0, np.zeros((1, 2, 2)))
    endless = [Form(row(1, 0), row(0, 1), constant=np.inf), Form(row(1, 1), row(0, 1), param=0)]
    assert Relaxation(Quadratic(endless, 1, 2))._plain.param.tolist() == [0]
    alone = [endless[0], scalars_of("repeated_real", row(1, 0), row(0, 1), param=0)]
    assert Relaxation(Quadratic(alone, 1, 2))._plain is None
    small = Relaxation(Quadratic([Form(row(0.1, 0), row(0, 0.2), param=0)], 1, 2))
    np.testing.assert_allclose(small._plain.q0, [np.diag([1.0, 0.0])])
    np.testing.assert_allclose(small._plain.level, [np.diag([0.0, 4.0])])
    small._generators = None  # without repeated blocks they are made once
    assert small.lower(BranchNode(0.0, 0, np.eye(1), {}), 1.0)[0] == pytest.approx(0.0, abs=1e-6)


def test_a_cones_bound_is_what_its_centres_certificate_proves_at_its_edges(monkeypatch):
    forms = [
        Form(row(1, -1), row(0, 1), param=0),
        Form(row(1, 1), row(0, 1), param=1),
        scalars_of("repeated_complex", row(2, 0), row(0, 1), param=2, slope=0.5),
    ]
    relaxation = Relaxation(Quadratic(forms, 3, 2))
    rays = np.array([[0.9, 0.1, 0.0], [0.3, 0.7, 0.0]])
    node = BranchNode(0.0, 1, rays, {2: Box(1 + 1j, 2 + 2j)})
    base = 2 / 0.5
    g = relaxation._generators(node.boxes)
    y = np.array([0.5, 0.3, 0.01, 0.01])
    asked = []
    answer = (0.7, y, np.eye(2))
    monkeypatch.setattr(lmi, "ray_length", lambda *arguments: asked.append(arguments) or answer)
    for cutoff, left in ((10.0, 6.0), (3.0, 0.0)):
        lower, central, inverse = relaxation.lower(node, cutoff)
        q0, level, cone, most = asked.pop()
        assert most == pytest.approx(left) and most >= 0.0
        assert cone.order == (1, 1, 1, 1) and central == pytest.approx(base + 0.7) and inverse is answer[2]
        np.testing.assert_array_equal(q0, g.q0)
        weights = np.array([0.6, 0.4, 0.0, 0.0])
        np.testing.assert_allclose(level, g.level * weights[:, None, None])
    zero = np.tensordot(y, g.q0, axes=1)
    slopes = [y[0] * r[0] * g.level[0] + y[1] * r[1] * g.level[1] for r in rays]
    proved = lmi.reach(zero, np.array(slopes), lmi.rounding(y, g.q0))
    assert 0.0 < proved.min() < 0.9 * proved.max() < np.inf
    assert lower == pytest.approx(base + proved.min())
    answer = (0.7, None, None)
    assert relaxation.lower(node, 10.0) == (pytest.approx(base), pytest.approx(base + 0.7), None)


def test_scalars_are_held_in_units_of_their_block_at_the_centre_and_the_corners():
    forms = mixed_forms()
    held = _HeldScalars(Quadratic(forms, 2, 3), BOXES)
    np.testing.assert_array_equal(held.centre, [2.0, 2.5j, 0.5 + 0.5j])
    assert len(held.corners) == 2 * 4 * 4
    assert {tuple(c) for c in held.corners} == {
        (a, b, c) for a in BOXES[2].corners for b in BOXES[4].corners for c in BOXES[5].corners
    }
    d = [0.5, 1j, 2.0]
    rows = held.rows(np.array(d))
    for k, c, scalar, held_row in zip((2, 4, 5), held.centre, d, rows, strict=True):
        a, b = forms[k].a, forms[k].b
        unit = np.linalg.norm(a) + abs(c) * np.linalg.norm(b)
        np.testing.assert_allclose(held_row, ((a - scalar * b) / unit)[0], rtol=1e-13)
    # Of the three only the first has a size of its own: (2 * 2 * 0.5 - 2^2) / 7.
    assert held.base(np.array(d)) == pytest.approx(-2 / 7)
    with pytest.raises(ValueError, match="longer"):
        held.rows(np.array([*d, 1.0]))


# --- the tangent ---


def held_and_free() -> tuple[Quadratic, BranchNode]:
    """Three forms, sizes 0 and 1 among them, and two repeated blocks of one row: of five signals three are
    left."""
    maps = gauss(np.random.default_rng(23), 10, 1, 5)
    forms = [
        Form(maps[0], maps[1], constant=2.0, slope=3.0),
        Form(maps[2], maps[3], constant=0.5, param=0, slope=2.0),
        Form(maps[4], maps[5], param=1),
        scalars_of("repeated_complex", maps[6], maps[7], param=2),
        scalars_of("repeated_real", maps[8], maps[9], constant=4.0),
    ]
    rays = np.array([[0.9, 0.1, 0.0], [0.3, 0.7, 0.0]])
    return Quadratic(forms, 3, 5), BranchNode(0.0, 1, rays, {3: Box(1 + 1j, 2 + 3j), 4: Box(-1.0, 2.0)})


def all_held() -> tuple[Quadratic, BranchNode]:
    return Quadratic(mixed_forms(), 2, 3), BranchNode(0.0, 1, np.array([[0.8, 0.0], [0.2, 0.0]]), BOXES)


class Tangents:
    """A tangent of which the answers of the ray and of what the corners reach are given."""

    def __init__(self, monkeypatch, problem: Quadratic, node: BranchNode):
        self.relaxation, self.node = Relaxation(problem), node
        self.held = _HeldScalars(problem, node.boxes)
        self.scalars = [self.held.centre, *self.held.corners]
        self.asked: list[tuple] = []
        self.shown: list[tuple] = []
        self.lengths = np.zeros((len(self.scalars), len(PENALTIES), 1 + len(node.rays)))
        self.ray: tuple = (0.7, np.array([0.5, 0.3, 0.2]), np.eye(3))
        monkeypatch.setattr(lmi, "ray_length", lambda *arguments: self.asked.append(arguments) or self.ray)
        monkeypatch.setattr(lmi, "reaches", lambda *arguments: self.shown.append(arguments) or self.lengths)

    def kernel(self) -> np.ndarray:
        """Projector on the signals that the scalars of the centre leave."""
        rows = self.held.rows(self.held.centre)
        return np.eye(rows.shape[1]) - np.linalg.pinv(rows) @ rows

    def certificates(self, y: np.ndarray, length: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """What the corners must reach: ``zeros``, ``slopes`` and ``errors`` of :func:`lmi.reaches`.

        Q + Y^* A + A^* Y is the certificate itself on the kernel and the penalty on |A z|^2 beside it.
        """
        g, n = self.relaxation._plain, len(self.kernel())
        rays = np.vstack([self.node.rays.mean(axis=0), self.node.rays])
        zero = sum(y[j] * g.q0[j] for j in range(len(y)))
        slopes = [
            sum(y[j] * r[g.param[j]] * g.level[j] for j in range(len(y)) if g.param[j] >= 0) for r in rays
        ]
        at, rows, on = zero - length * slopes[0], self.held.rows(self.held.centre), self.kernel()
        off, inverse = np.eye(n) - on, np.linalg.pinv(rows)
        zeros, errors = [], []
        for penalty in np.linalg.norm(at) * np.array([1e-2, 0.1, 1.0, 10.0, 1e2, 1e3, 1e4]):
            change = on @ at @ on + penalty * rows.conj().T @ rows - at
            lift = (on @ change @ off + 0.5 * off @ change @ off) @ inverse
            terms = [lift @ self.held.rows(d) for d in self.scalars]
            zeros.append([zero + t + t.conj().T for t in terms])
            errors.append(4 * n * 2.0**-52 * (np.abs(y) @ np.linalg.norm(g.q0, axis=(1, 2))))
            errors[-1] += 8 * n * 2.0**-52 * np.linalg.norm(lift)
        return np.array(zeros).swapaxes(0, 1), np.array(slopes), np.array(errors)

    def compare(self, y: np.ndarray, length: float) -> None:
        zeros, slopes, errors = self.shown.pop()
        want = self.certificates(y, length)
        np.testing.assert_allclose(zeros, want[0], rtol=1e-9, atol=1e-9)
        np.testing.assert_allclose(slopes, want[1], rtol=1e-12, atol=1e-14)
        np.testing.assert_allclose(errors, np.broadcast_to(want[2], zeros.shape[:2]), rtol=1e-9)


def test_a_tangent_asks_for_a_certificate_of_what_the_centres_scalars_leave(monkeypatch):
    tangents = Tangents(monkeypatch, *held_and_free())
    kernel, g = tangents.kernel(), tangents.relaxation._plain
    base = abs(1.5 + 2j) ** 2
    for cutoff, left in ((10.0, 10 - base), (base + 0.5, 0.5), (3.0, 0.0), (np.inf, np.inf)):
        tangent_point = tangents.relaxation.tangent(tangents.node, cutoff)
        q0, level, cone, most = tangents.asked.pop()
        assert (
            most == pytest.approx(left)
            and cone is g.cone
            and tangent_point.centre == pytest.approx(base + 0.7)
        )
        # The same eigenvalues in whichever coordinates of the kernel, beside two zeros.
        shares = np.array([0.0, 0.6, 0.4])
        for mix in np.random.default_rng(3).normal(size=(3, 3)):
            for inner, outer in ((q0, g.q0), (level, shares[:, None, None] * g.level)):
                inside, whole = (
                    np.linalg.eigvalsh(np.tensordot(mix, m, axes=1)) for m in (inner, kernel @ outer @ kernel)
                )
                np.testing.assert_allclose(np.sort([*inside, 0, 0]), whole, atol=1e-12)
        np.testing.assert_allclose(tangent_point.inverse, kernel, atol=1e-12)
    tangents.ray = (0.7, tangents.ray[1], None)
    assert tangents.relaxation.tangent(tangents.node, 10.0).inverse is None
    tangents.ray = (0.0, None, np.eye(3))
    assert tangents.relaxation.tangent(tangents.node, 10.0) is None, "nothing is proved"


def test_a_tangent_lifts_its_certificate_off_the_kernel_and_moves_it_to_the_corners(monkeypatch):
    tangents = Tangents(monkeypatch, *held_and_free())
    for length in (0.7, np.inf):
        tangents.ray = (length, *tangents.ray[1:])
        tangents.relaxation.tangent(tangents.node, 10.0)
        tangents.compare(tangents.ray[1], 0.7 if length == 0.7 else 0.0)


def test_a_tangent_without_a_signal_left_has_a_certificate_all_the_same(monkeypatch):
    tangents = Tangents(monkeypatch, *all_held())
    tangent_point = tangents.relaxation.tangent(tangents.node, 10.0)
    assert not tangents.asked and tangent_point.inverse is None
    assert tangent_point.centre == pytest.approx(4 / 7), "the one block with a size of its own"
    tangents.compare(np.array([0.5, 0.5]), 0.0)


@pytest.mark.parametrize("problem", [held_and_free, all_held])
def test_a_tangents_bound_is_the_best_penaltys_at_its_worst_corner_and_ray(problem, monkeypatch):
    tangents = Tangents(monkeypatch, *problem())
    rng, bases = np.random.default_rng(5), [tangents.held.base(d) for d in tangents.scalars]
    for _ in range(20):
        tangents.lengths = rng.uniform(0.0, 10.0, tangents.lengths.shape)
        tangents.lengths[0] -= 20.0  # at the centre, which is no corner
        bounds = np.array([b + m for b, m in zip(bases, tangents.lengths, strict=True)])
        worst = [min(bounds[c, k, r] for c in range(1, len(bases)) for r in (1, 2)) for k in range(7)]
        kept = bounds[:, worst.index(max(worst))]
        tangent_point = tangents.relaxation.tangent(tangents.node, 10.0)
        assert tangent_point.lower == pytest.approx(max(worst), rel=1e-12)
        assert tangent_point.box == pytest.approx(min(kept[1:, 0]), rel=1e-12)
        assert tangent_point.cone == pytest.approx(min(kept[0, 1:]), rel=1e-12)


def test_there_is_no_tangent_without_boxes_or_forms_beside_them(monkeypatch):
    tangents = Tangents(monkeypatch, *held_and_free())
    assert tangents.relaxation.tangent(BranchNode(0.0, 0, tangents.node.rays, {}), 10.0) is None
    alone = Relaxation(Quadratic([scalars_of("repeated_real", row(1, 0), row(0, 1), param=0)], 1, 2))
    assert alone.tangent(BranchNode(0.0, 0, np.zeros((1, 1)), {0: Box(1.0, 2.0)}), 10.0) is None


@pytest.mark.parametrize("angle, left", [(1.8e-10, 3), (2.2e-10, 2)])
def test_scalars_hold_a_direction_of_more_than_a_ten_billionth(angle, left, monkeypatch):
    """Two rows of size 1 at an angle: their singular values are sqrt(2) and angle / sqrt(2)."""
    forms = [
        Form(row(1, 1, 1, 1), row(0, 0, 0, 1), param=0),
        scalars_of("repeated_real", row(1, 0, 0, 0), row(0, 0, 0, 1), constant=1.0),
        scalars_of("repeated_real", row(1, angle, 0, 0), row(0, 0, 0, 1), constant=1.0),
    ]
    node = BranchNode(0.0, 0, np.eye(1), {1: Box(-1.0, 1.0), 2: Box(-1.0, 1.0)})
    tangents = Tangents(monkeypatch, Quadratic(forms, 1, 4), node)
    tangents.ray = (0.0, np.ones(1), None)
    tangents.relaxation.tangent(node, 10.0)
    assert tangents.asked[0][0].shape == (1, left, left)
