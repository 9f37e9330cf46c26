"""The barrier method: derivatives against differences and longer numbers, Newton's step against its
definition, and its searches against results by hand."""

import numpy as np
import pytest
import scipy.linalg as sl
from scipy.optimize import minimize, minimize_scalar

from lft_problems import spd
from lpvguard.engine.synthesis import barrier


def random_problem(seed: int) -> tuple[barrier.Barrier, np.ndarray, np.ndarray]:
    """Two F of two terms, N = 4; some S; and how every F changes with each entry of P's vector."""
    random = np.random.default_rng(seed)
    parts = [(random.standard_normal((3, 4)), random.standard_normal((2, 4))) for _ in range(2)]
    one = barrier.Barrier(parts, random.standard_normal((2, 2)), random.standard_normal((2, 2)))
    S = np.array([spd(random, 4) for _ in range(2)])
    return one, S, np.array([one.F(one.matrices(step), constant=False) for step in np.eye(12)])


def test_the_barriers_matrices_are_those_of_their_vector_and_its_gradient_that_of_the_trace():
    random = np.random.default_rng(9)
    parts = [(random.standard_normal((3, 4)), random.standard_normal((2, 4))) for _ in range(2)]
    phi, after = random.standard_normal((2, 3)), random.standard_normal((2, 3))
    problem = barrier.Barrier(parts, phi, after)
    P = np.array([spd(random, 3) for _ in range(3)])
    p = P[:, problem.upper[0], problem.upper[1]].ravel()
    np.testing.assert_array_equal(problem.matrices(p), P)
    for i, (M, N) in enumerate(parts):
        E = np.eye(3, 4)
        wanted = E.T @ np.tensordot(phi[i], P, 1) @ E - M.T @ np.tensordot(after[i], P, 1) @ M
        np.testing.assert_allclose(problem.F(P, constant=False)[i], wanted, atol=1e-12)
        wanted = wanted - N.T @ N + np.diag([0.0, 0.0, 0.0, 1.0])
        np.testing.assert_allclose(problem.F(P)[i], wanted, atol=1e-12)
    S = np.array([spd(random, 4) for _ in range(2)])
    gradient, hessian = problem.adjoint(S), problem.hessian(S)
    changes = [problem.F(problem.matrices(step), constant=False) for step in np.eye(len(p))]
    for k in range(len(p)):
        for j in range(k + 1):
            wanted = sum(np.trace(s @ a @ s @ b) for s, a, b in zip(S, changes[k], changes[j], strict=True))
            assert hessian[k, j] == pytest.approx(wanted, rel=1e-9, abs=1e-9)
    for k, change in enumerate(changes):
        assert gradient[k] == pytest.approx(np.sum(S * change), rel=1e-10, abs=1e-10)


def test_the_hessian_is_the_derivative_of_the_gradient():
    random = np.random.default_rng(4)
    parts = [(0.3 * random.standard_normal((4, 6)), 0.3 * random.standard_normal((2, 6))) for _ in range(3)]
    problem = barrier.Barrier(parts, random.uniform(1, 2, (3, 3)), random.uniform(1, 2, (3, 3)))
    noise = random.standard_normal((3, 4, 4))
    P = np.array([2 * np.eye(4)] * 3) + 0.05 * (noise + np.swapaxes(noise, 1, 2))
    p = P[:, problem.upper[0], problem.upper[1]].ravel()
    unit = 30 * np.eye(6)

    def slope(q):
        return -problem.adjoint(np.linalg.inv(problem.F(problem.matrices(q)) + unit))

    S = np.linalg.inv(problem.F(P) + unit)
    compiled = np.tril(problem.hessian(S))
    numeric = np.array([(slope(p + h) - slope(p - h)) / 2e-5 for h in 1e-5 * np.eye(len(p))])
    np.testing.assert_allclose(compiled, np.tril(numeric), rtol=0, atol=1e-7 * np.abs(numeric).max())


def test_the_hessian_keeps_its_digits_where_states_hardly_move():
    """M is within 1e-7 of the identity, and the same P holds before and after a step: products of M cancel to
    1e-14 of themselves, which doubles do not leave. The reference is in longer numbers."""
    random = np.random.default_rng(6)
    M = np.eye(3, 5) + 1e-7 * random.standard_normal((3, 5))
    X = random.standard_normal((5, 5))
    S = X @ X.T + np.eye(5)
    problem = barrier.Barrier([(M, np.zeros((1, 5)))], np.ones((1, 1)), np.ones((1, 1)))
    lower_half = np.tril(problem.hessian(S[None]))
    changes = [problem.matrices(h)[0].astype(np.longdouble) for h in np.eye(6)]
    long, wide = M.astype(np.longdouble), S.astype(np.longdouble)
    moved = [-long.T @ change @ long for change in changes]
    for one, change in zip(moved, changes, strict=True):
        one[:3, :3] += change
    wanted = np.array([[np.trace(wide @ one @ wide @ other) for other in moved] for one in moved], float)
    scale = np.sqrt(np.diagonal(wanted))
    assert scale.max() < 1e-5
    np.testing.assert_allclose(
        lower_half / np.outer(scale, scale), np.tril(wanted) / np.outer(scale, scale), atol=1e-3
    )
    gradient = np.array([np.trace(wide @ one) for one in moved], float)
    np.testing.assert_allclose(problem.adjoint(S[None]), gradient, rtol=1e-8)


def test_what_the_hessian_solves_it_gives_back():
    one, S, changes = random_problem(2)
    H = np.array(
        [
            [sum(np.trace(s @ a @ s @ b) for s, a, b in zip(S, x, y, strict=True)) for y in changes]
            for x in changes
        ]
    )
    right = np.random.default_rng(3).standard_normal((len(changes), 3))
    np.testing.assert_allclose(H @ one.solved(S, right), right, rtol=1e-6, atol=1e-8)


def test_newtons_method_ends_where_the_priced_barrier_is_least():
    """Two inequalities of a scalar P and one y: the minimiser by another method, with a price and without."""
    rows = ([0.5, 1.0], [0.3, 0.0]), ([0.2, 0.4], [0.1, 0.2])
    parts = [(np.array([M]), np.array([N])) for M, N in rows]
    phi, after = np.array([[1.0, 0.5], [1.0, -0.5]]), np.array([[1.0, 0.4], [1.0, -0.6]])
    one, unit, slope = barrier.Barrier(parts, phi, after), np.eye(2)[None, None], np.array([30.0])

    def value(x, price):
        F = one.F(x[:2].reshape(2, 1, 1)) + x[2] * np.eye(2)
        least = np.linalg.eigvalsh(F).min()
        return np.inf if least <= 0 else price @ x[:2] + slope[0] * x[2] - np.linalg.slogdet(F)[1].sum()

    ends = []
    for cost in (0.0, 2.0):
        price = one.price(np.array([[cost]]))
        np.testing.assert_allclose(price, cost * phi.sum(axis=0))
        P, y = np.array([[[0.5]], [[0.0]]]), np.array([1.0])
        for _ in range(40):
            P, y, decrement = barrier.newton_step(one, P, y, unit, slope, price)
        assert 0 <= decrement < 1e-12
        options = {"xatol": 1e-9, "fatol": 1e-13, "maxiter": 4000}
        least = minimize(value, [0.5, 0.0, 1.0], (price,), method="Nelder-Mead", options=options)
        np.testing.assert_allclose(np.append(P.ravel(), y), least.x, atol=1e-5)
        ends.append(P[0, 0, 0])
    assert ends[1] < 0.95 * ends[0]


def test_a_step_is_newtons_along_p_and_y_together():
    """Gradient and second derivatives of the objective by its definition, one variable at a time."""
    random = np.random.default_rng(8)
    one, _, changes = random_problem(5)
    P, y = np.array([2 * np.eye(3)] * 2), np.array([40.0, 3.0])
    directions = np.array([[np.eye(4)] * 2, [np.diag([0.0, 1.0, 2.0, 1.0]), np.eye(4)]])
    slope, price = np.array([5.0, 1.0]), random.standard_normal(len(changes))
    F = one.F(P) + np.tensordot(y, directions, 1)
    assert np.linalg.eigvalsh(F).min() > 0
    S, forms = np.linalg.inv(F), np.concatenate([changes, directions])
    g = np.append(price, slope) - np.einsum("kab,ikba->i", S, forms)
    H = np.einsum("kab,ikbc,kcd,jkda->ij", S, forms, S, forms)
    step = -np.linalg.solve(H, g)
    curve = np.concatenate([sl.eigvalsh(d, f) for d, f in zip(np.tensordot(step, forms, 1), F, strict=True)])
    length = barrier.line_search(curve, float(np.append(price, slope) @ step))
    after, y_after, decrement = barrier.newton_step(one, P, y, directions, slope, price)
    np.testing.assert_allclose(after, P + length * one.matrices(step[:-2]), rtol=1e-6, atol=1e-8)
    np.testing.assert_allclose(y_after, y + length * step[-2:], rtol=1e-7)
    assert decrement == pytest.approx(g @ np.linalg.solve(H, g), rel=1e-7)


def test_a_point_with_every_matrix_positive_is_found_from_any_start_or_none_is():
    """F = P - a^2 P - c^2 > 0 for a scalar P, width one: P > c^2 / (1 - a^2); and both 1 - P > 0 or not."""

    def problem(largest):
        M, N = np.array([[0.5, 1.0]]), np.array([[0.3, 0.0]])
        return barrier.Barrier([(np.sqrt(1 / largest) * M, N)], np.ones((1, 1)), np.ones((1, 1)))

    easy = problem(1.0)
    for start in (-3.0, 0.0, 0.4, 50.0):
        P = barrier.feasible(easy, np.array([[[start]]]), np.eye(2))
        assert P is not None and np.linalg.eigvalsh(easy.F(P)[0])[0] > 0
    # F[1, 1] = 1 - P / largest and F[0, 0] = P (1 - 1 / (4 largest)) - 0.09: no P for a small ``largest``.
    assert barrier.feasible(problem(0.2), np.array([[[0.1]]]), np.eye(2)) is None


def test_a_step_without_y_is_newtons_of_p_alone():
    one, _, changes = random_problem(5)
    one.constant += 60 * np.eye(4)
    P = np.array([2 * np.eye(3)] * 2)
    price = np.random.default_rng(8).standard_normal(len(changes))
    S = np.linalg.inv(one.F(P))
    g = price - np.einsum("kab,ikba->i", S, changes)
    step = -np.linalg.solve(np.einsum("kab,ikbc,kcd,jkda->ij", S, changes, S, changes), g)
    none = np.zeros(0)
    after, y, decrement = barrier.newton_step(one, P, none, np.zeros((0, 1, 4, 4)), none, price)
    assert y.shape == (0,) and decrement == pytest.approx(-g @ step, rel=1e-7)
    moved = (after - P)[:, one.upper[0], one.upper[1]].ravel()
    np.testing.assert_allclose(moved / np.linalg.norm(moved), step / np.linalg.norm(step), atol=1e-7)


def told_steps(monkeypatch, *steps) -> list:
    """Replace ``newton_step``: it returns scripted (P, t, decrement), the last one repeatedly. Returns its
    calls."""
    asked = []

    def step(one, P, t, directions, slope, price):
        asked.append((P[0, 0, 0], t[0], slope[0], directions, price))
        P, t, decrement = steps[min(len(asked), len(steps)) - 1]
        if decrement is None:
            raise np.linalg.LinAlgError
        return np.array([[[P]]]), np.array([t]), decrement

    monkeypatch.setattr(barrier, "newton_step", step)
    return asked


def scalar(count: int = 3) -> barrier.Barrier:
    """F = diag(P / 2 - 0.09, 1), ``count`` times: M = [1 / sqrt 2, 0] and N = [0.3, 0]."""
    part = np.array([[0.5**0.5, 0.0]]), np.array([[0.3, 0.0]])
    return barrier.Barrier([part] * count, np.ones((count, 1)), np.ones((count, 1)))


def found_by(P: float = -2.0, unit=(4.0, 1.0)) -> float | None:
    solution = barrier.feasible(scalar(), np.array([[[P]]]), np.diag(unit))
    return None if solution is None else solution[0, 0, 0]


def test_the_search_begins_just_where_every_matrix_is_positive(monkeypatch):
    """t is 5 % beyond what lacks in the unit, or beyond 0.001 of it; tau is two per row."""
    asked = told_steps(monkeypatch, (1.0, -0.03, 0.0))
    assert found_by() == 1.0 and found_by(P=5.0) == 1.0
    (P, t, tau, directions, price), other = asked
    assert (P, tau) == (-2.0, 2 * 3 * 2) and t == pytest.approx(1.05 * 1.09 / 4)
    np.testing.assert_array_equal(directions, np.diag([4.0, 1.0])[None, None])
    assert price.tolist() == [0.0] and other[1] == pytest.approx(1.05e-3)
    # In a unit that is not diagonal, and with two terms, 0.2 and 0.3 of P.
    part, unit = (np.array([[0.5**0.5, 0.0]]), np.array([[0.3, 0.0]])), np.array([[4.0, 1.0], [1.0, 2.0]])
    two = barrier.Barrier([part], np.array([[0.2, 0.3]]), np.array([[0.2, 0.3]]))
    barrier.feasible(two, np.array([[[-2.0]], [[-2.0]]]), unit)
    least = sl.eigvalsh(np.diag([-0.5 - 0.09, 1.0]), unit)[0]
    assert asked[2][1] == pytest.approx(-1.05 * least) and asked[2][4].tolist() == [0.0, 0.0]


def test_tau_grows_where_the_step_was_near_the_centre(monkeypatch):
    asked = told_steps(
        monkeypatch, (1.0, 0.02, 30.0), (2.0, 0.02, 25.0), (3.0, 0.02, 24.9), (4.0, -0.03, 5.0)
    )
    assert found_by() == 4.0
    assert [one[:2] for one in asked[1:]] == [(1.0, 0.02), (2.0, 0.02), (3.0, 0.02)]
    assert [one[2] for one in asked] == pytest.approx([12.0, 12.0, 12.0, 120.0])


@pytest.mark.parametrize(
    ("t", "decrement", "ends"),
    [
        (-0.0201, 9.0, True),
        (-0.02, 9.0, False),
        (1.01, 0.9, True),  # beyond 2 size / tau = 1
        (1.0, 0.9, False),
        (1.01, 1.0, False),
        (0.9, 0.9, False),
    ],
)
def test_the_search_ends_with_enough_or_where_the_centre_is_too_far(monkeypatch, t, decrement, ends):
    asked = told_steps(monkeypatch, (1.0, t, decrement), (2.0, -0.03, 9.0))
    assert found_by() == ((1.0 if t < 0 else None) if ends else 2.0) and len(asked) == 2 - ends


def test_a_centre_below_zero_but_not_far_enough_is_taken_as_it_is(monkeypatch):
    """At tau 12000 the centre is at most 0.001 above the least t."""
    near = 0.9, 0.005, 9.0
    asked = told_steps(monkeypatch, near, near, near, (1.0, -0.0011, 0.9), (2.0, -0.03, 9.0))
    assert found_by() == 1.0 and len(asked) == 4
    asked = told_steps(monkeypatch, near, near, near, (1.0, -0.0009, 0.9), (2.0, -0.03, 9.0))
    assert found_by() == 2.0


def test_what_was_found_before_the_last_step_counts(monkeypatch):
    told_steps(monkeypatch, (1.0, -0.01, 50.0), (2.0, 0.0, 50.0), (3.0, 0.0, None))
    assert found_by() == 1.0
    told_steps(monkeypatch, (1.0, 0.0, 50.0), (3.0, 0.0, None))
    assert found_by() is None
    asked = told_steps(monkeypatch, (1.0, 0.5, 50.0))
    assert found_by() is None and len(asked) == 40


def test_a_singular_matrix_is_factored_with_the_least_addition_and_an_indefinite_one_is_not():
    ones = np.ones((3, 3))
    factor, lower = barrier.factored(ones.copy())
    assert lower and np.tril(factor) @ np.tril(factor).T == pytest.approx(ones, abs=1e-12)
    slightly = np.array([[1.0, 1 + 5e-10], [1 + 5e-10, 1.0]])
    assert barrier.factored(slightly.copy())[0][1, 1] < 1e-4
    with pytest.raises(np.linalg.LinAlgError):
        barrier.factored(np.array([[1.0, 1.1], [1.1, 1.0]]))


def test_the_diagonal_is_raised_in_three_steps(monkeypatch):
    seen = []

    def never(H, lower, check_finite):
        seen.append(H.diagonal().tolist())
        raise np.linalg.LinAlgError

    monkeypatch.setattr(barrier.sl, "cho_factor", never)
    with pytest.raises(np.linalg.LinAlgError):
        barrier.factored(np.eye(2))
    assert seen == [[1 + extra] * 2 for extra in (1e-13, 1e-11, 1e-9)]


@pytest.mark.parametrize("seed", range(6))
def test_the_line_search_finds_the_minimum_inside_its_domain(seed):
    random = np.random.default_rng(seed)
    curve = random.normal(0.0, 1.0, 8)
    if seed % 2:
        curve = np.abs(curve)  # no end of the domain
    slope = 0.3 * np.sum(curve) if seed % 2 else np.sum(curve) - 0.7 * np.sum(curve**2)
    end = -1 / curve.min() if curve.min() < 0 else 50.0

    def value(s):
        return slope * s - np.sum(np.log1p(s * curve))

    best = minimize_scalar(value, bounds=(0, end * (1 - 1e-9)), method="bounded", options={"xatol": 1e-12}).x
    step = barrier.line_search(curve, slope)
    assert 0 < step < end and step == pytest.approx(best, rel=2e-3)


@pytest.mark.parametrize(
    ("curve", "slope", "minimiser"),
    [
        ([1.0], 0.5, 1.0),  # it begins at the least, 1
        ([-2.0], -20.0, 0.45),  # and here at 0.9 of the way to the end
        ([0.0, 1.0], 0.5, 1.0),
        ([-1.0], -1e9, 0.999),  # 0.9 of what is left, until a thousandth remains
        ([1.0], 0.0, 2.0**31 - 1),  # s becomes 2 s + 1, in 30 steps
        ([1e-12], -1.0, 1e30),  # ten times as far at most
        ([1.0], 1e9, 1e-30),  # a tenth at least
    ],
)
def test_the_line_search_by_hand(curve, slope, minimiser):
    assert barrier.line_search(np.array(curve), slope) == pytest.approx(minimiser, rel=1e-12, abs=0)


def test_the_line_search_begins_at_nine_tenths_of_the_way_to_the_end():
    """A start at the minimum does not move, whatever the curvature elsewhere."""
    curve = np.array([-2.0, 100.0])
    slope = float(np.sum(curve / (1 + 0.45 * curve)))
    assert barrier.line_search(curve, slope) == pytest.approx(0.45, rel=1e-12)


def test_the_line_search_ends_where_a_step_is_a_thousandth():
    """log(1 + s) against slope s: from 1 Newton's method goes to 3 - 4 slope."""
    for off, ends in ((0.9e-3, True), (1.1e-3, False)):
        step = barrier.line_search(np.array([1.0]), 0.5 - off / 4)
        assert (step == 1.0) == ends and step == pytest.approx(1.0 + off, rel=1.2e-3)
