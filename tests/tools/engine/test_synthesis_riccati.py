"""The Riccati equation of a side, its Hamiltonian and its balancing: residuals, stability, and by hand."""

from __future__ import annotations

import numpy as np
import pytest
import scipy.linalg as sl

from lpvguard.engine.synthesis import riccati
from lpvguard.engine.synthesis.riccati import Side, hamiltonian


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
    found = one.solve(gamma)
    assert found is not None
    X = found.X
    B, D, R = terms(one, gamma)
    F = -np.linalg.solve(R, D.T @ one.C1 + B.T @ X)
    residual = one.A.T @ X + X @ one.A + one.C1.T @ one.C1 - F.T @ R @ F
    assert np.abs(residual).max() < 1e-8 * (1 + np.abs(X).max()) ** 2
    np.testing.assert_array_equal(X, X.T)
    assert np.linalg.eigvals(one.A + B @ F).real.max() < 0
    assert found.definite and np.linalg.eigvalsh(X)[0] > 0


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
    for found in (scaled, pencil):
        np.testing.assert_allclose(found.X, plain.X, rtol=1e-7, atol=1e-8 * np.abs(plain.X).max())
        assert found.definite
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
    found = riccati.stabilising_solution(H)
    assert found.X[0, 0] == pytest.approx(2.0) and found.definite
    negative = riccati.stabilising_solution(np.array([[-1.0, -1.0], [0.5, 1.0]]))
    assert negative.X[0, 0] == pytest.approx(-1 + np.sqrt(0.5)) and not negative.definite
    skew = riccati._from_basis(np.eye(2), np.array([[0.0, 1.0], [-1.0, 0.0]]), np.ones(2))
    assert skew == (None, 1.0)
    singular = riccati._from_basis(np.zeros((1, 1)), np.ones((1, 1)), np.ones(1))
    assert singular[0] is None
    in_units = riccati._from_basis(np.eye(2), np.array([[3.0, 1.0], [1.0, 2.0]]), np.array([2.0, 4.0]))[0]
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
