"""The Riccati equation of a side, its Hamiltonian and its balancing: residuals, stability, and by hand."""

import numpy as np
import pytest
import scipy.linalg as sl

from lpvguard.engine.synthesis import riccati
from lpvguard.engine.synthesis.direct_terms import unreachable_gain
from lpvguard.engine.synthesis.partition import Plant
from lpvguard.engine.synthesis.riccati import RiccatiSolution, Side, hamiltonian
from lpvguard.engine.synthesis.statespace import EPS, StateSpace


def side(seed: int, n: int = 4, m1: int = 2, m2: int = 2, p: int = 5, direct: float = 0.2) -> Side:
    """A plant side with full-rank D12 and a small D11."""
    random = np.random.default_rng(seed)
    A, B1, B2 = (random.standard_normal(s) for s in ((n, n), (n, m1), (n, m2)))
    C1, D11 = random.standard_normal((p, n)), direct * random.standard_normal((p, m1))
    D12 = np.linalg.qr(random.standard_normal((p, m2)))[0] + 0.1 * random.standard_normal((p, m2))
    return Side(A, B1, B2, C1, D11, D12, np.eye(n))


def terms(one: Side, gamma: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """B, D'C and the indefinite R of w (scaled) and u."""
    B = np.hstack([one.B1, one.B2])
    D = np.hstack([one.D11, one.D12])
    R = D.T @ D - gamma**2 * sl.block_diag(np.eye(one.B1.shape[1]), np.zeros((one.B2.shape[1],) * 2))
    return B, D, R


@pytest.mark.parametrize("seed", range(5))
@pytest.mark.parametrize("gamma", [30.0, 300.0])
def test_the_solution_has_no_residual_and_closes_a_stable_loop(seed, gamma):
    one = side(seed)
    solution = one.solve(gamma)
    assert solution is not None
    X = solution.X
    B, D, R = terms(one, gamma)
    F = -np.linalg.solve(R, D.T @ one.C1 + B.T @ X)
    residual = one.A.T @ X + X @ one.A + one.C1.T @ one.C1 - F.T @ R @ F
    assert np.abs(residual).max() < 1e-8 * (1 + np.abs(X).max()) ** 2
    np.testing.assert_array_equal(X, X.T)
    assert np.linalg.eigvals(one.A + B @ F).real.max() < 0
    assert solution.definite and np.linalg.eigvalsh(X)[0] > 0


def test_without_disturbance_it_is_the_lqr_of_scipy():
    one = side(7, direct=0.0)
    still = Side(one.A, 0 * one.B1, one.B2, one.C1, 0 * one.D11, one.D12, one.basis)
    wanted = sl.solve_continuous_are(
        one.A, one.B2, one.C1.T @ one.C1, one.D12.T @ one.D12, s=one.C1.T @ one.D12
    )
    np.testing.assert_allclose(still.solve(1.0).X, wanted, rtol=1e-8, atol=1e-9)


def test_the_level_ends_the_solution_and_the_bound_is_respected():
    one = side(2)
    assert one.solve(30.0) is not None and one.solve(0.3) is None
    bounded = Side(one.A, one.B1, one.B2, one.C1, one.D11, one.D12, one.basis, bound=30.0)
    assert bounded.solve(30.0) is None and bounded.solve(30.0 * (1 + 1e-11)) is not None
    basis = np.vstack([np.eye(4), np.ones((1, 4))])
    wide = Side(one.A, one.B1, one.B2, one.C1, one.D11, one.D12, basis).solve(30.0)
    np.testing.assert_allclose(wide.X, basis @ one.solve(30.0).X @ basis.T, rtol=1e-12)
    empty = Side(*(np.zeros(s) for s in ((0, 0), (0, 1), (0, 1), (2, 0), (2, 1), (2, 1))), np.zeros((3, 0)))
    assert empty.solve(1.0).X.tolist() == np.zeros((3, 3)).tolist() and empty.solve(1.0).definite


@pytest.mark.parametrize("weight", [0.0, 0.5])
def test_the_hamiltonian_is_the_one_of_the_equation(weight):
    """[A 0; -C'C -A'] - [B; -C'D] R^-1 [D'C B'], R of the level, and the weight's square on the states."""
    one = side(3)
    one = Side(one.A, one.B1, one.B2, one.C1, one.D11, one.D12, one.basis, weight=weight)
    B, D, R = terms(one, 5.0)
    H = np.block([[one.A, np.zeros((4, 4))], [-one.C1.T @ one.C1 - weight**2 * np.eye(4), -one.A.T]])
    H -= np.vstack([B, -one.C1.T @ D]) @ np.linalg.solve(R, np.hstack([D.T @ one.C1, B.T]))
    np.testing.assert_allclose(hamiltonian(one, 5.0), H, rtol=1e-9, atol=1e-9)
    J = np.block([[np.zeros((4, 4)), np.eye(4)], [-np.eye(4), np.zeros((4, 4))]])
    np.testing.assert_allclose(J @ H, (J @ H).T, atol=1e-12 * np.abs(H).max())


def test_what_cancels_in_the_hamiltonian_is_exactly_zero():
    """A control that reaches what z reads through D12 alone: A - B2 R^-1 D12'C1 is 0 but for rounding."""
    C1 = np.array([[1 / 3]])
    one = Side(
        np.array([[0.1 / 3 * 10]]),
        np.zeros((1, 1)),
        np.array([[1.0]]),
        C1,
        np.zeros((1, 1)),
        np.array([[1.0]]),
        np.eye(1),
    )
    assert hamiltonian(one, 1.0)[0, 0] == 0.0


def test_balancing_is_symplectic_by_powers_of_two_and_undoes_units():
    H = hamiltonian(side(4), 30.0)
    unit = np.array([1e6, 1e-3, 1.0, 1e4])
    both = np.concatenate([unit, 1 / unit])
    skewed = H * both / both[:, None]
    balanced, t = riccati.balance_hamiltonian(skewed)
    assert (np.exp2(np.round(np.log2(t))) == t).all()
    scale = np.concatenate([t, 1 / t])
    np.testing.assert_array_equal(balanced, skewed * scale / scale[:, None])
    assert np.linalg.norm(balanced) < 10 * np.linalg.norm(H)
    np.testing.assert_allclose(np.log2(t * unit) - np.log2(t * unit).mean(), 0, atol=3.0)
    tiny = skewed.copy()
    tiny[0, 5] = 1e-30 * np.abs(skewed).max()
    zero = skewed.copy()
    zero[0, 5] = 0.0
    same = riccati.balance_hamiltonian(tiny, floor=1e-20)[1]
    np.testing.assert_array_equal(same, riccati.balance_hamiltonian(zero, floor=1e-20)[1])


@pytest.mark.parametrize("seed", range(4))
def test_subspace_and_pencil_give_one_solution(seed):
    one = side(seed)
    H = hamiltonian(one, 40.0)
    t = np.exp2(np.random.default_rng(seed).integers(-3, 4, 4).astype(float))
    both = np.concatenate([t, 1 / t])
    plain, condition = riccati._subspace_solution(H, np.ones(4))
    scaled, _ = riccati._subspace_solution(H * both / both[:, None], t)
    pencil, other = riccati._pencil_solution(one, 40.0, t)
    for solution in (scaled, pencil):
        np.testing.assert_allclose(solution.X, plain.X, rtol=1e-7, atol=1e-8 * np.abs(plain.X).max())
        assert solution.definite
    assert 1 <= condition < 1e10 and 1 <= other < 1e10
    weighted = Side(one.A, one.B1, one.B2, one.C1, one.D11, one.D12, one.basis, weight=0.7)
    both_ways = (
        riccati._pencil_solution(weighted, 40.0, t)[0].X,
        riccati.stabilising_solution(hamiltonian(weighted, 40.0)).X,
    )
    np.testing.assert_allclose(*both_ways, rtol=1e-7, atol=1e-8)


def test_eigenvalues_on_the_axis_have_no_solution():
    assert riccati.stabilising_solution(np.array([[0.0, -1.0], [1.0, 0.0]])) is None
    assert riccati._subspace_solution(np.diag([0.0, 0.0]), np.ones(1)) == (None, 0.0)
    assert riccati._touches_axis(np.array([[-1e-16, 1.0], [-1.0, -1e-16]]))
    assert riccati._touches_axis(np.diag([-1.0, 0.0]))
    assert not riccati._touches_axis(np.diag([-1.0, -1e-12]))
    assert not riccati._touches_axis(np.array([[-1e-4, 9.0], [-4.0, -1e-4]]))
    slow = np.array([[-1e-9, 400.0], [-400.0, -1e-9]])  # 400 rad/s: 1e-11 of that is 4e-9
    assert riccati._touches_axis(slow) and not riccati._touches_axis(slow - 1e-8 * np.eye(2))


def test_a_solution_that_is_not_definite_says_so():
    """x' = x + u, z = [0; u] costs nothing at X = 0 or 2; with a negative state cost X has both signs."""
    H = np.array([[1.0, -1.0], [0.0, -1.0]])
    solution = riccati.stabilising_solution(H)
    assert solution.X[0, 0] == pytest.approx(2.0) and solution.definite
    negative = riccati.stabilising_solution(np.array([[-1.0, -1.0], [0.5, 1.0]]))
    assert negative.X[0, 0] == pytest.approx(-1 + np.sqrt(0.5)) and not negative.definite
    skew = riccati._from_basis(np.eye(2), np.array([[0.0, 1.0], [-1.0, 0.0]]), np.ones(2), 0.0)
    assert skew == (None, 1.0)
    singular = riccati._from_basis(np.zeros((1, 1)), np.ones((1, 1)), np.ones(1), 0.0)
    assert singular[0] is None
    U2 = np.array([[3.0, 1.0], [1.0, 2.0]])
    in_units = riccati._from_basis(np.eye(2), U2, np.array([2.0, 4.0]), 0.0)[0]
    np.testing.assert_allclose(in_units.X, [[3 / 4, 1 / 8], [1 / 8, 2 / 16]])


@pytest.mark.parametrize("seed", range(3))
def test_the_gain_stabilises_and_none_is_found_where_none_is(seed):
    random = np.random.default_rng(seed)
    A, B = random.standard_normal((4, 4)) + np.eye(4), random.standard_normal((4, 2))
    for unit in (1.0, 1e-6, 1e6):
        F = riccati.stabilising_gain(A, unit * B)
        assert np.linalg.eigvals(A + unit * B @ F).real.max() < 0
        # LQ with unit weights in units in which B is as large as A.
        size = np.linalg.norm(A, 2) / np.linalg.norm(unit * B, 2)
        X = sl.solve_continuous_are(A, size * unit * B, np.eye(4), np.eye(2))
        np.testing.assert_allclose(F, -(size**2) * unit * B.T @ X, rtol=1e-7, atol=1e-7 * np.abs(F).max())
    assert riccati.stabilising_gain(A, 0 * B) is None
    assert riccati.stabilising_gain(np.diag([1.0, -1.0]), np.array([[0.0], [1.0]])) is None


def test_the_frequency_bound_is_what_no_control_takes_away():
    """z1 = w / (s + 1/2), which no control reaches, and z2 = u: the bound is 2, the gain at DC."""
    A = np.diag([-0.5, -2.0])
    one = Side(
        A,
        np.array([[1.0], [0.0]]),
        np.array([[0.0], [1.0]]),
        np.array([[1.0, 0.0], [0.0, 0.0]]),
        np.zeros((2, 1)),
        np.array([[0.0], [1.0]]),
        np.eye(2),
    )
    assert one.frequency_bound() == pytest.approx(2.0, rel=1e-9)
    assert one.frequency_bound(1.5) == pytest.approx(2.0, rel=1e-9), "DC is between the crossings of 1.5"
    assert one.frequency_bound(2.5) == 0.0, "no crossing"
    free = Side(A, one.B1, 0 * one.B2, one.C1, one.D11, one.D12, one.basis)
    assert free.frequency_bound() == 0.0, "no gain closes the loop"
    marked = Side(A, one.B1, one.B2, one.C1, one.D11, one.D12, one.basis, axis=(1.0,))
    assert marked.frequency_bound() == 0.0


@pytest.mark.parametrize("seed", range(3))
def test_no_full_information_controller_is_below_the_frequency_bound(seed):
    """The Riccati equation has no solution below it, and the level that it leaves is close to it."""
    one = side(seed, direct=0.0)
    bound = one.frequency_bound()
    assert bound > 0 and one.solve(0.999 * bound) is None
    G = one._closed
    omega = np.abs(np.concatenate([[0.0], np.linalg.eigvals(one.A), G.poles()]))
    best = 0.0
    for M in G.response(np.unique(omega)):
        known, free = M[:, :2], M[:, 2:]
        left = known - free @ np.linalg.lstsq(free, known, rcond=None)[0]
        best = max(best, np.linalg.norm(left, 2))
    assert bound == pytest.approx(best, rel=1e-9)


# ---------------------------------------------------------------- borders and choices


def test_the_side_of_a_plant_is_bounded_by_what_no_control_reaches_at_once():
    one = side(5, m2=3)
    P = Plant(one.A, one.B1, one.B2, one.C1, np.eye(4)[:1], one.D11, one.D12, np.ones((1, 2)))
    regular_plant = Side.regular(P)
    assert regular_plant.bound == unreachable_gain(P.D11, P.D12, np.zeros(3)) > 0
    assert (
        regular_plant.basis.tolist() == np.eye(4).tolist()
        and regular_plant.C1 is P.C1
        and regular_plant.axis == ()
    )


@pytest.mark.parametrize(("over", "asked"), [(1e-12, False), (0.5e-12, False), (3e-12, True)])
def test_a_level_at_the_bound_has_no_solution(monkeypatch, over, asked):
    one = side(2)
    bounded = Side(one.A, one.B1, one.B2, one.C1, one.D11, one.D12, one.basis, bound=30.0)
    monkeypatch.setattr(riccati, "stabilising_solution", lambda *_: RiccatiSolution(np.eye(4), True))
    assert (bounded.solve(30.0 * (1 + over)) is not None) == asked


def entry(a: float, b: float, c: float) -> float:
    """The first entry of the Hamiltonian of x' = a x + b u, z = c x + u: a - b c."""
    zero = np.zeros((1, 1))
    one = Side(np.array([[a]]), zero, np.array([[b]]), np.array([[c]]), zero, np.ones((1, 1)), np.eye(1))
    return float(hamiltonian(one, 1.0)[0, 0])


@pytest.mark.parametrize(("b", "c"), [(1.0, 1.0), (-1.0, 1.0), (1.0, -1.0), (-1.0, -1.0)])
def test_five_hundred_roundings_of_the_terms_count_as_zero(b, c):
    """The terms are 1 and a little more than 1: together 1000 units of rounding."""
    assert entry(b * c * (1 + 1000 * EPS), b, c) == 0.0
    assert abs(entry(b * c * (1 + 1001 * EPS), b, c)) == pytest.approx(1001 * EPS, abs=0)


@pytest.mark.parametrize("unit", [1e-9, 1.0, 1e9])
def test_the_diagonal_has_no_say_in_the_balancing(unit):
    H = hamiltonian(side(4), 30.0)
    units = np.concatenate([[1e3, 1e-3, 1.0, 1e2], [1e-3, 1e3, 1.0, 1e-2]])
    H = H * units / units[:, None]
    for floor in (0.0, 1e-9):
        _, t = riccati.balance_hamiltonian(H, floor)
        other = unit * H
        np.fill_diagonal(other, 1e6)
        np.testing.assert_array_equal(riccati.balance_hamiltonian(other, floor)[1], t)


def test_an_entry_up_to_the_floor_is_none_beside_the_largest():
    """Of [0, b; 64, 0] the balancing evens out b and 64, unless b is 64 EPS at most."""

    def t(b: float, floor: float) -> float:
        return riccati.balance_hamiltonian(np.array([[0.0, b], [64.0, 0.0]]), floor)[1][0]

    assert t(64 * EPS, EPS) == 1.0 and t(65 * EPS, EPS) < 1e-3 and t(64 * EPS, 0.0) < 1e-3
    assert riccati.balance_hamiltonian(np.array([[0.0, EPS], [64.0, 0.0]]))[1][0] < 1e-3


def test_a_state_between_two_others_is_balanced_too():
    """A chain has no cycle, and yet the state in its middle is to be evened out."""
    H = np.zeros((4, 4))
    H[1, 0], H[2, 1] = 1.0, 2.0**12
    assert riccati.balance_hamiltonian(H)[1].tolist() == [1.0, 0.125, 1.0, 1.0][:2]


def taken(monkeypatch, subspace, pencil=(), size: float = 1e9, gamma: float = 7.0):
    """Which solution ``stabilising_solution`` takes where the subspaces and pencils give the conditions told
    (a negative one: no solution, of that size), and what was asked. A is 4 in the balanced units."""
    t, asked = np.array([2.0, 8.0]), []
    solutions = {c: RiccatiSolution(np.full((1, 1), c), True) for c in (*subspace, *pencil) if c > 0}
    left, others = list(subspace), list(pencil)

    def condition(c):
        return solutions.get(c), abs(c)

    def balance(H, floor):
        asked.append(floor)
        return np.diag([size, 0.0, 0.0, 0.0]), t

    def pencil_of(side, level, scale):
        assert level == gamma
        asked.append(scale.tolist())
        return condition(others.pop(0))

    monkeypatch.setattr(riccati, "balance_hamiltonian", balance)
    monkeypatch.setattr(riccati, "_subspace_solution", lambda H, t: condition(left.pop(0)))
    monkeypatch.setattr(riccati, "_pencil_solution", pencil_of)
    one = side(1, n=2)
    one = Side(np.array([[0.0, 1.0], [0.0, 0.0]]), one.B1, one.B2, one.C1, one.D11, one.D12, one.basis)
    solution = riccati.stabilising_solution(np.eye(4), one, gamma)
    return None if solution is None else solution.X[0, 0], asked


T, ONES = [2.0, 8.0], [1.0, 1.0]


@pytest.mark.parametrize(
    ("subspace", "solution", "asked"),
    [
        ([9999999999.5], 9999999999.5, [0.0]),  # well enough at once
        ([1e10, 1e11], 1e10, [0.0, EPS]),  # else the other balancing is tried, and the better one is kept
        ([1e11, 1e10], 1e10, [0.0, EPS]),
        ([-1e17, 5.0], 5.0, [0.0, EPS]),
        ([1e12, -1.0], 1e12, [0.0, EPS]),
        ([-0.0], None, [0.0]),  # the axis is in the way
        ([-1e17, -1e17], None, [0.0, EPS]),
    ],
)
def test_of_two_balancings_the_better_condition_counts(monkeypatch, subspace, solution, asked):
    assert taken(monkeypatch, subspace, size=1.0) == (solution, asked)


@pytest.mark.parametrize(
    ("subspace", "pencil", "solution"),
    [
        ([2e6], [1e5, 1e7], 1e5),
        ([2e6], [1e7, 1e5], 1e5),
        ([2e6], [-1.0, 3e6], 2e6),
        ([2e6], [-1.0, -1.0], 2e6),
        ([1000001.0], [2.0, 3.0], 2.0),
        ([-0.0], [9.0, 8.0], 8.0),
        ([-0.0], [-1.0, -1.0], None),
    ],
)
def test_a_stiff_hamiltonian_is_asked_as_a_pencil_in_both_units(monkeypatch, subspace, pencil, solution):
    assert taken(monkeypatch, subspace, pencil) == (solution, [0.0, T, ONES])


def test_the_pencil_is_for_what_is_stiff_and_badly_conditioned(monkeypatch):
    assert taken(monkeypatch, [1e6], [2.0, 3.0]) == (1e6, [0.0])
    border = 1e4 * 4.0
    assert taken(monkeypatch, [2e6], [2.0, 3.0], size=border) == (2e6, [0.0])
    assert taken(monkeypatch, [2e6], [2.0, 3.0], size=border * (1 + 1e-12)) == (2.0, [0.0, T, ONES])


def test_equal_conditions_leave_the_first(monkeypatch):
    one, other = (RiccatiSolution(np.full((1, 1), k), True) for k in (1.0, 2.0))
    assert riccati._better((one, 3.0), (other, 3.0))[0] is one
    assert riccati._better((one, 3.0), (other, 2.0))[0] is other
    assert riccati._better((one, 3.0), (None, 2.0))[0] is one


def noises(monkeypatch) -> list[float]:
    """The noise that ``_from_basis`` is told."""
    seen: list[float] = []
    monkeypatch.setattr(riccati, "_from_basis", lambda U1, U2, t, noise: (seen.append(noise), 1.0))
    return seen


def test_the_noise_of_a_subspace_is_that_of_its_slowest_eigenvalue(monkeypatch):
    seen = noises(monkeypatch)
    riccati._subspace_solution(np.diag([-2.0, -0.5, 4.0, 1.0]), np.ones(2))
    riccati._subspace_solution(1e-20 * np.diag([-1.0, 1.0]), np.ones(1))
    size = np.linalg.norm([2.0, 0.5, 4.0, 1.0])
    assert seen == pytest.approx([100 * EPS * size / 0.5, 100 * EPS * 2**0.5 * 1e-20 / EPS], abs=0)


def test_a_subspace_has_half_of_the_eigenvalues_and_none_on_the_axis():
    assert riccati._subspace_solution(np.diag([-1.0, -2.0]), np.ones(1)) == (None, 0.0)
    assert riccati._subspace_solution(np.diag([-1e-20, 1.0]), np.ones(1)) == (None, 0.0)


def test_an_eigenvalue_touches_the_axis_within_twenty_roundings_or_its_own_size():
    """The real parts are told by the diagonal, the imaginary ones by what stands beside it."""
    for size in (1.0, 4.0):
        assert riccati._touches_axis(np.diag([-size, -20 * EPS * size]))
        assert not riccati._touches_axis(np.diag([-size, -21 * EPS * size]))
    T = np.array([[-1.0, 5.0, 7.0], [0.0, -1.0, 9.0], [0.0, -4.0, -1.0]])  # a pair of sqrt(9 4) rad/s
    for pair, real in ((T, 0), (T[::-1, ::-1].T, 2)):
        for k in range(3):
            one = pair.copy()
            one[k, k] = -5e-11
            assert riccati._touches_axis(one) == (k != real)
            one[k, k] = -7e-11
            assert not riccati._touches_axis(one)


def basis(U1, U2, noise: float = 0.0) -> RiccatiSolution | None:
    return riccati._from_basis(np.diag(U1), np.diag(U2), np.ones(2), noise)[0]


@pytest.mark.parametrize(("skew", "good"), [(1e-5, True), (1.1e-5, False), (0.5, False), (-0.5, False)])
def test_a_basis_whose_solution_is_not_symmetric_is_none(skew, good):
    solution = riccati._from_basis(np.eye(2), np.array([[1.0, skew], [0.0, 1.0]]), np.ones(2), 0.0)
    assert (solution[0] is not None) == good


def test_a_basis_of_which_nothing_is_sure_gives_no_solution():
    assert basis([1.0, EPS], [1.0, EPS]) is None and basis([1.0, 0.75 * EPS], [1.0, EPS]) is None
    assert basis([1.0, 2 * EPS], [1.0, EPS]) is not None


@pytest.mark.parametrize(
    ("least", "half", "noise", "definite"),
    [
        (4.0000e4 * EPS, 1.0, 0.0, True),  # 1e4 roundings of 1 + 3
        (3.9998e4 * EPS, 1.0, 0.0, True),
        (4.0002e4 * EPS, 1.0, 0.0, False),
        (7.9e4 * EPS, 0.5, 0.0, True),  # by the condition of U1
        (8.1e4 * EPS, 0.5, 0.0, False),
        (3.9e-10, 1.0, 1e-10, True),  # or the noise
        (4.1e-10, 1.0, 1e-10, False),
        (3.9e-9, 1.0, 1.0, True),  # up to 1e-9
        (4.1e-9, 1.0, 1.0, False),
        (0.39, 1e-10, 1.0, True),  # and a tenth in all
        (0.41, 1e-10, 1.0, False),
    ],
)
def test_a_solution_is_definite_within_what_rounding_does(least, half, noise, definite):
    """X = diag(-least, 3), U1 = diag(1, half)."""
    assert basis([1.0, half], [-least, 3 * half], noise).definite == definite


def pencilled(monkeypatch, alpha, beta, size: float = 4.0) -> float | None:
    """The noise of a pencil's basis, n = 1, with the eigenvalues told; None: (None, 0)."""
    seen = noises(monkeypatch)
    S = np.diag([size, 0.0])
    answer = S, None, np.array(alpha, complex), np.array(beta, float), None, np.eye(2)
    monkeypatch.setattr(riccati.sl, "ordqz", lambda *_, **__: answer)
    with np.errstate(all="raise"):
        solution = riccati._pencil_solution(side(1, n=1, m1=1, m2=2), 30.0, np.ones(1))
    assert seen or solution == (None, 0.0)
    return seen[0] / (100 * EPS * size) if seen else None


@pytest.mark.parametrize(
    ("alpha", "beta", "speed"),
    [
        ([-2, 3], [1, 0.5], 2.0),
        ([-2, 3], [4, 1], 0.5),
        ([-6, 3], [1, 4], 0.75),
        ([-2, 1], [1, 0], 2.0),  # one at infinity
        ([-2, -1], [1, 0], 2.0),
        ([-2, 1, 1], [1, 1, 1], 1.0),
        ([-2, -1], [1, 1], None),
        ([2, 1], [1, 1], None),
        ([-80 * EPS, 1], [1, 1], None),  # 20 roundings of S
        ([-81 * EPS, 1], [1, 1], 81 * EPS),
        ([-0.9e-9 + 100j, 1], [1, 1], None),
        ([-0.9e-9 - 100j, 1], [1, 1], None),
        ([-1.1e-9 + 100j, 1], [1, 1], 1.1e-9),
    ],
)
def test_a_pencil_has_one_stable_half_off_the_axis(monkeypatch, alpha, beta, speed):
    pencil = pencilled(monkeypatch, alpha, beta)
    assert pencil == (None if speed is None else pytest.approx(1 / speed))


def test_a_pencil_whose_halves_cannot_be_told_apart_has_no_solution(monkeypatch):
    def fails(*_, **__):
        raise ValueError

    monkeypatch.setattr(riccati.sl, "ordqz", fails)
    assert riccati._pencil_solution(side(1), 30.0, np.ones(4)) == (None, 0.0)


# ---------------------------------------------------------------- the bound of full information


def informed(A, B1, B2, C1, D11, D12) -> Side:
    return Side(*(np.array(M, dtype=float) for M in (A, B1, B2, C1, D11, D12)), np.eye(len(A)))


def test_the_bound_is_asked_at_the_size_of_complex_poles():
    """A resonance that no control reaches: its gain at the size of its poles, sqrt 1.01 rad/s."""
    A = [[-0.1, 1.0, 0.0], [-1.0, -0.1, 0.0], [0.0, 0.0, -2.0]]
    one = informed(
        A, [[0.0], [1.0], [0.0]], [[0.0], [0.0], [1.0]], [[1, 0, 0], [0, 0, 0]], [[0], [0]], [[0], [1]]
    )
    s = 1j * np.sqrt(1.01)
    assert one.frequency_bound() == pytest.approx(abs(1 / ((s + 0.1) ** 2 + 1)), rel=1e-9)


def test_there_is_no_bound_at_the_level_of_the_direct_term_or_without_a_control():
    one = informed([[-1.0]], [[1.0]], [[1.0]], [[1.0], [0.0]], [[0.0], [0.0]], [[0.0], [1.0]])
    direct = informed([[-1.0]], [[1.0]], [[1.0]], [[1.0], [0.0]], [[2.0], [0.0]], [[0.0], [1.0]])
    assert direct.frequency_bound(2.0) == 0.0 < direct.frequency_bound()
    none = Side(one.A, one.B1, one.B2[:, :0], one.C1, one.D11, one.D12[:, :0], one.basis)
    assert none.frequency_bound() == 0.0
    empty = Side(*(np.zeros(k) for k in ((0, 0), (0, 1), (0, 1), (2, 0), (2, 1), (2, 1))), np.zeros((3, 0)))
    assert empty.frequency_bound() == 0.0


def test_the_frequencies_of_a_level_are_told_the_size_of_a(monkeypatch):
    one, sizes = side(2), []
    monkeypatch.setattr(
        riccati, "axis_frequencies", lambda H, size: sizes.append(size) or np.array([0.0, 1.0])
    )
    one.frequency_bound(30.0)
    assert sizes == [pytest.approx(np.linalg.svd(one.A)[1][0])]


def test_a_frequency_at_a_pole_is_left_out():
    one = side(2, direct=0.0)
    pole = StateSpace([[0.0]], [[1.0, 1.0, 0.0, 0.0]], np.ones((5, 1)), one_to(5, 4))
    vars(one)["_closed"] = pole
    omega = np.abs(np.linalg.eigvals(one.A))
    finite = StateSpace([[-1e-9]], pole.B, pole.C, pole.D)
    known, free = np.split(finite.response(np.unique(omega)), [2], axis=2)
    best = max(
        np.linalg.norm(k - f @ np.linalg.lstsq(f, k, rcond=None)[0], 2)
        for k, f in zip(known, free, strict=True)
    )
    assert one.frequency_bound() == pytest.approx(best, rel=1e-6)


class Known:
    """A closed loop of which the response is told."""

    def __init__(self, *response) -> None:
        self.response = lambda _: np.array(response, dtype=complex)

    def poles(self) -> np.ndarray:
        return np.zeros(0)


def known_bound(*response) -> float:
    """The bound of one disturbance and one control by what the closed loop is told to do with them."""
    one = side(2, m1=1, m2=1)
    vars(one)["_closed"] = Known(*response)
    return one.frequency_bound()


def test_a_frequency_at_which_one_entry_is_infinite_is_left_out():
    assert known_bound([[np.inf, 0.0], [0.0, 1.0]], [[2.0, 0.0], [0.0, 1.0]]) == pytest.approx(2.0)


@pytest.mark.parametrize(("left", "bound"), [(1e-9, 0.0), (1.1e-9, 1.1e-9)])
def test_a_billionth_of_what_is_disturbed_is_rounding(left, bound):
    assert known_bound([[left, 0.0], [1.0, 1.0]]) == pytest.approx(bound, abs=0)


def test_controls_apart_by_a_hundred_thousandth_are_not_sure(monkeypatch):
    answer = {}

    def svd(free, full_matrices):
        assert not full_matrices
        return np.array([[[0.0], [1.0]]]), np.array([[answer["sigma"]]]), None

    monkeypatch.setattr(np.linalg, "svd", svd)
    for answer["sigma"], bound in ((1e-5, 0.0), (1.1e-5, 2.0)):
        assert known_bound([[2.0, 0.0], [0.0, 1.0]]) == pytest.approx(bound)


def one_to(rows: int, columns: int) -> np.ndarray:
    """A matrix of full rank."""
    return np.vander(np.arange(1.0, rows + 1), columns)


@pytest.mark.parametrize("unit", [1e-7, 1.0, 1e7])
@pytest.mark.parametrize("size", [1e-12, 1.0, 1e12])
def test_the_bound_does_not_ask_for_the_unit_of_the_control(unit, size):
    """z1 = w / (s + 1/2), and z2 = u / (s + 2) + u: the bound is 2, in the unit of w."""
    one = informed(
        np.diag([-0.5, -2.0]),
        [[size], [0.0]],
        [[0.0], [unit]],
        [[1.0, 0.0], [0.0, 1.0]],
        [[0.0], [0.0]],
        [[0.0], [unit]],
    )
    assert one.frequency_bound() == pytest.approx(2.0 * size, rel=1e-9)


@pytest.mark.parametrize("apart", [0.0, 1e-7])
def test_controls_that_do_the_same_leave_no_bound_that_is_sure(apart):
    """z1 = w / (s + 1/2); two controls reach z2 alike, and z3 hardly apart."""
    D12 = [[0.0, 0.0], [1.0, 1.0], [0.0, apart]]
    one = informed([[-0.5]], [[1.0]], [[1e-3, 1e-3]], [[1.0], [0.0], [0.0]], [[0.0]] * 3, D12)
    assert one.frequency_bound() == 0.0
    parts = informed(
        [[-0.5]], [[1.0]], [[1e-3, 1e-3]], [[1.0], [0.0], [0.0]], [[0.0]] * 3, [[0, 0], [1, 1], [0, 1]]
    )
    assert parts.frequency_bound() > 1.9
    still = informed(
        [[-0.5]], [[1.0]], [[1e-3, 0.0]], [[1.0], [0.0], [0.0]], [[0.0]] * 3, [[0, 0], [1, 0], [0, 0]]
    )
    assert still.frequency_bound() == 0.0


def test_what_a_control_cancels_but_for_rounding_is_no_bound():
    """z = d (w / (s + 1) + u) with d in no special direction: u = -w / (s + 1)."""
    d = np.array([[0.3], [0.7], [-1.1]])
    one = informed([[-1.0]], [[1.0]], [[0.1]], d, 0 * d, d)
    assert one.frequency_bound() == 0.0
    assert informed([[-1.0]], [[1e9]], [[0.1]], d, 0 * d, d).frequency_bound() == 0.0
