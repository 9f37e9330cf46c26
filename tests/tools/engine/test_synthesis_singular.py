"""Singular problems: zeros on the axis, states that are free to set and the regular plant beside; and the
central controller: by hand and by the norm of the loop."""

import numpy as np
import pytest
import scipy.linalg as sl

from lpvguard.engine.synthesis import central, hinf, singular, zeros
from lpvguard.engine.synthesis.norms import hinf_norm
from lpvguard.engine.synthesis.partition import Plant, partition
from lpvguard.engine.synthesis.riccati import RiccatiSolution, Side
from lpvguard.engine.synthesis.statespace import EPS, StateSpace, append, gain, lft, series


def side(A, B2, C1, D12) -> Side:
    A, B2, C1, D12 = (np.array(M, float) for M in (A, B2, C1, D12))
    n, p = len(A), len(C1)
    return Side(A, np.zeros((n, 1)), B2, C1, np.zeros((p, 1)), D12, np.eye(n))


def notch(omega: float, damping: float = 0.0) -> Side:
    """(s^2 + 2 damping s + omega^2) / (s + 1)^2."""
    return side([[0, 1], [-1, -2]], [[0], [1]], [[omega**2 - 1, 2 * damping - 2]], [[1]])


def both(one: Side, other: Side) -> Side:
    return side(*(sl.block_diag(getattr(one, k), getattr(other, k)) for k in ("A", "B2", "C1", "D12")))


# ---------------------------------------------------------------- zeros on the axis


@pytest.mark.parametrize("omega", [0.3, 2.0, 40.0])
def test_a_notch_has_its_zero_on_the_axis_and_a_damped_one_has_none(omega):
    scale = max(1.0, omega)
    assert zeros.axis_zeros(notch(omega), scale) == pytest.approx((omega,), rel=1e-9)
    assert zeros.axis_zeros(notch(omega, 1e-3), scale) == ()
    # Within rounding of the double eigenvalue, but the system matrix keeps its rank.
    assert zeros.axis_zeros(notch(omega, 1e-9 * omega), scale) == ()


def test_zeros_come_once_each_in_order_and_with_the_one_at_DC():
    differentiator = side([[-1]], [[1]], [[-1]], [[1]])  # s / (s + 1)
    fast = side([[-1e6]], [[1]], [[-1e6]], [[1]])  # s / (s + 1e6)
    assert zeros.axis_zeros(fast, 1e6) == (0.0,)
    slow = side([[-1]], [[1]], [[5e-9 - 1]], [[1]])  # (s + 5e-9) / (s + 1)
    assert zeros.axis_zeros(differentiator, 1.0) == (0.0,)
    assert zeros.axis_zeros(slow, 1.0) == ()
    several = both(both(notch(3.0), notch(0.5)), both(notch(3.0), differentiator))
    assert zeros.axis_zeros(several, 3.0) == pytest.approx((0.0, 0.5, 3.0), rel=1e-9)
    near = both(notch(1.0), notch(1.0 + 1e-4))
    assert zeros.axis_zeros(near, 1.0) == pytest.approx((1.0, 1.0 + 1e-4), rel=1e-9)


@pytest.mark.parametrize(("omega", "fast"), [(1e-3, 300.0), (2.0, 300.0), (3e3, 10.0), (0.0, 300.0)])
@pytest.mark.parametrize("seed", range(3))
def test_rounding_of_dense_states_beside_a_fast_one_hides_no_zero_and_makes_none(seed, omega, fast):
    """The zeros are double eigenvalues: rounding moves them by 1e-8 of A, off the axis and apart."""
    random = np.random.default_rng(seed)
    exact = side([[-1]], [[1]], [[-1]], [[1]]) if omega == 0 else notch(omega)
    one = both(exact, side([[-fast]], [[fast]], [[1]], [[1]]))
    T = random.standard_normal((len(one.A),) * 2) + 3 * np.eye(len(one.A))
    dense = side(np.linalg.solve(T, one.A @ T), np.linalg.solve(T, one.B2), one.C1 @ T, one.D12)
    axis_zeros = zeros.axis_zeros(dense, float(np.linalg.norm(dense.A, 2)))
    assert axis_zeros == pytest.approx((omega,), rel=5e-8, abs=1e-12)


def test_a_disturbance_has_no_say_in_where_the_zeros_are():
    one = notch(2.0)
    loud = Side(one.A, 9 * np.ones((2, 1)), one.B2, one.C1, np.array([[7.0]]), one.D12, one.basis)
    assert zeros.axis_zeros(loud, 2.0) == pytest.approx((2.0,), rel=1e-9)


def test_the_defect_of_rank_is_that_of_a_matrix_with_units_taken_out():
    """[[-j, 1], [1, 1]], entries of size 1: its least singular value is sqrt(2 - sqrt 2)."""
    want = np.sqrt(2 - np.sqrt(2))
    assert zeros.rank_defect(side([[0]], [[1]], [[1]], [[1]]), 1.0) == pytest.approx(want)
    assert zeros.rank_defect(side([[0]], [[1e6]], [[1]], [[1e6]]), 1.0) == pytest.approx(want, rel=4e-2)
    assert zeros.rank_defect(side([[0]], [[1]], [[1e-6]], [[1e-6]]), 1.0) == pytest.approx(want, rel=4e-2)
    assert zeros.rank_defect(side([[0]], [[1]], [[1e4]], [[1e4]]), 1e4) > 0.5
    # A control without effect: a column of zeros. More controls than equations: every frequency.
    assert zeros.rank_defect(side([[0]], [[0]], [[1]], [[0]]), 1.0) == 0.0
    assert zeros.rank_defect(side([[0]], [[1, 2, 3]], [[1]], [[1, 0, 0]]), 1.0) == 0.0
    assert zeros.rank_defect(side([[0]], [[1]], [[1], [1]], [[1], [0]]), 1.0) > 0.1
    uneven = np.linalg.svd([[-1j, 1.0], [1.0, 1e-3]])[1][-1]  # the largest of each row and column is 1
    assert zeros.rank_defect(side([[0]], [[1]], [[1]], [[1e-3]]), 1.0) == pytest.approx(uneven)
    assert zeros.rank_defect(notch(2.0), 2.0) < 1e-15
    near, nearer = (zeros.rank_defect(notch(2.0), 2.0 + apart) for apart in (1e-6, 5e-7))
    assert near == pytest.approx(2 * nearer, rel=1e-3)


def loop_of(P: StateSpace, n_u: int = 1, n_y: int = 1) -> Plant:
    return partition(P, n_u, n_y)[0]


def joined(*systems: list[list[StateSpace]]) -> StateSpace:
    """The system of blocks of systems: rows of lists."""
    n = sum(G.order for row in systems for G in row)
    m, p = sum(G.n_inputs for G in systems[0]), sum(row[0].n_outputs for row in systems)
    A, B, C, D = np.zeros((n, n)), np.zeros((n, m)), np.zeros((p, n)), np.zeros((p, m))
    x, i = 0, 0
    for row in systems:
        j = 0
        for G in row:
            s, o, c = slice(x, x + G.order), slice(i, i + G.n_outputs), slice(j, j + G.n_inputs)
            A[s, s], B[s, c], C[o, s], D[o, c] = G.A, G.B, G.C, G.D
            x, j = x + G.order, j + G.n_inputs
        i += row[0].n_outputs
    return StateSpace(A, B, C, D)


def lag(pole: float, k: float, direct: float = 0.0) -> StateSpace:
    return StateSpace([[-pole]], [[1.0]], [[k]], [[direct]])


TURN = gain([[0.6, 0.8], [-0.8, 0.6]])
"""Two controls that both have a share in what one of them cannot do."""


def notch_system(omega: float) -> StateSpace:
    one = notch(omega)
    return StateSpace(one.A, one.B2, one.C1, one.D12)


def test_at_a_zero_of_the_controls_the_nominal_gain_stays():
    """z = X (G w + diag(N, 1) u), y = w + u1 / (s + 4), all stable, X = [1, 1 / (s + 1); 0, 1]: at N's zero
    the row [1, -1 / (s + 1)] of T11 is the first one of G. The second control is given in small units."""
    G = joined([lag(0.7, 3.0, 0.2), lag(0.3, 1.0)], [lag(2.0, 4.0), lag(5.0, 7.0)])
    units = series(TURN, gain(np.diag([1.0, 1e-7])))
    control = series(append(notch_system(2.0), gain([[1.0]])), units)
    measured = series(append(lag(4.0, 1.0), gain([[0.0]])), units)
    X = joined([gain([[1.0]]), lag(1.0, 1.0)], [gain([[0.0]]), gain([[1.0]])])
    whole = series(append(X, gain(np.eye(2))), joined([G, control], [gain(np.eye(2)), measured]))
    P = loop_of(whole, 2, 2)
    bounds = zeros.axis_bounds(P, (2.0, 1.0))
    want = np.linalg.norm(G.response([2.0])[0, 0]) / np.hypot(1, abs(1 / (2j + 1)))
    assert bounds[0] == pytest.approx(want, rel=1e-6)
    assert bounds[1:] == pytest.approx([0.0, 0.0, 0.0], abs=1e-9)
    assert zeros.axis_bounds(P.dual, (2.0,)) == pytest.approx([0.0, bounds[0]], abs=1e-9)
    assert zeros.axis_bounds(P, ()) == []


def test_at_a_zero_of_an_unstable_plant_the_sensitivity_is_one():
    """z = y = w + G u with (s^2 + 4) / ((s - 1) (s + 3)) for the first row of G: S (2j) = 1 there for every
    controller."""
    A, B, C = np.array([[0.0, 1.0], [3.0, -2.0]]), np.array([[0.0], [1.0]]), np.array([[7.0, -2.0]])
    G = series(append(StateSpace(A, B, C, [[1.0]]), lag(1.0, 2.0, 1.0)), TURN)
    still = np.zeros((3, 2))
    P = Plant(G.A, still, G.B, G.C, G.C, np.eye(2), G.D, np.eye(2))
    bounds = zeros.axis_bounds(P, (2.0,))
    assert bounds[0] == pytest.approx(1.0, rel=1e-7) and bounds[1] == pytest.approx(0.0, abs=1e-9)
    hidden = Plant(G.A, still, 0 * G.B, G.C, G.C, np.eye(2), G.D, np.eye(2))
    assert zeros.axis_bounds(hidden, (2.0,)) == [] == zeros.axis_bounds(hidden.dual, (2.0,))
    A = np.array([[1.0, 1.0], [0.0, -1.0]])  # the measured state moves the unstable one, which does not show
    unseen = Plant(A, np.zeros((2, 1)), np.eye(2), np.ones((1, 2)), np.array([[0.0, 1.0]]), *(np.eye(1),) * 3)
    assert zeros.axis_bounds(unseen, (2.0,)) == []


# ---------------------------------------------------------------- states that are free


def posed(A, B2, C1, D12, B1=None, D11=None) -> Plant:
    A, B2, C1, D12 = (np.array(M, float) for M in (A, B2, C1, D12))
    n, p = len(A), len(C1)
    B1 = np.ones((n, 1)) if B1 is None else np.array(B1, float)
    D11 = np.zeros((p, B1.shape[1])) if D11 is None else np.array(D11, float)
    return Plant(A, B1, B2, C1, np.zeros((1, n)), D11, D12, np.zeros((1, B1.shape[1])))


def test_a_regular_side_is_the_plants_own():
    P = posed([[-1, 2], [0, -3]], [[0], [1]], [[1, 0], [0, 0]], [[0], [2]], D11=[[0.3], [0.4]])
    side = singular.reduced_side(P)
    for name in ("A", "B1", "B2", "C1", "D11", "D12"):
        np.testing.assert_array_equal(getattr(side, name), getattr(P, name))
    np.testing.assert_array_equal(side.basis, np.eye(2))
    assert (side.axis, side.weight) == ((), 0.0)
    assert side.bound == pytest.approx(0.3), "what u does not reach of D11"


def test_a_state_that_costs_nothing_to_move_becomes_the_control():
    """x1' = x2 + w, x2' = u, z = [x1; 3 x2]: x2 is the control of x1. With z = x1, x1 itself is free too."""
    P = posed([[0, 1], [0, 0]], [[0], [1]], [[1, 0], [0, 3]], [[0], [0]], B1=[[1], [5]])
    side = singular.reduced_side(P)
    sign = np.sign(side.basis[0, 0])
    np.testing.assert_allclose(side.basis, [[sign], [0]])
    np.testing.assert_allclose(side.A, [[0.0]])
    np.testing.assert_allclose(side.B1 * sign, [[1.0]])
    np.testing.assert_allclose(np.abs(side.B2), [[1.0]])
    np.testing.assert_allclose(side.C1 * sign, [[1.0], [0.0]])
    np.testing.assert_allclose(np.abs(side.D12), [[0.0], [3.0]])
    assert side.basis[1, 0] == 0.0, "no rounding in the place of a zero"
    P = posed([[0, 1], [0, 0]], [[0], [1]], [[1, 0]], [[0]], B1=[[1], [5]])
    side = singular.reduced_side(P)
    assert side.A.shape == (0, 0) and side.basis.shape == (2, 0)
    np.testing.assert_allclose(np.abs(side.D12), [[1.0]])
    assert side.bound == 0.0


def test_of_two_controls_the_free_one_is_taken_and_the_paid_one_kept():
    """x1' = x2 + u1, x2' = 4 u1 + 1e-12 u2, z = [x1; 2 u1; 3 x2]."""
    P = posed([[0, 1], [0, 0]], [[1, 0], [4, 1e-12]], [[1, 0], [0, 0], [0, 3]], [[0, 0], [2, 0], [0, 0]])
    side = singular.reduced_side(P)
    np.testing.assert_allclose(np.abs(side.basis), [[1.0], [0.0]])
    assert side.B2.shape == (1, 2) and side.D12.shape == (3, 2)
    # The paid control counts per unit of its cost: 1 / 2 of u1 on x1.
    np.testing.assert_allclose(np.abs(side.B2), [[0.5, 1.0]])
    np.testing.assert_allclose(np.abs(side.D12), [[0, 0], [1, 0], [0, 3]])


def test_a_control_that_does_nothing_is_left_out():
    P = posed([[-1.0]], [[1, 0]], [[1], [0]], [[0, 0], [2, 0]])
    side = singular.reduced_side(P)
    np.testing.assert_allclose(np.abs(side.B2), [[0.5]])
    np.testing.assert_allclose(np.abs(side.D12), [[0.0], [1.0]])
    static = posed(
        np.zeros((0, 0)), np.zeros((0, 2)), np.zeros((2, 0)), [[1, 0], [0, 0]], np.zeros((0, 1)), [[2], [3]]
    )
    side = singular.reduced_side(static)
    assert side.B2.shape == (0, 1) and side.D12.shape == (2, 1) and side.bound == pytest.approx(3.0)
    # One that does nothing beside one that is free.
    P = posed([[-1, 1], [0, -1]], [[0, 0], [0, 2]], [[1, 0], [0, 1]], [[0, 0], [0, 0]])
    side = singular.reduced_side(P)
    np.testing.assert_allclose(np.abs(side.basis), [[1.0], [0.0]])


def test_free_controls_that_drive_one_direction_count_as_one():
    A, C1 = [[-1, 0, 1], [0, -2, 1], [0, 0, -3]], np.eye(3)
    for apart, rank in ((0.9e-9, 1), (4e-9, 2)):
        P = posed(A, [[0, 0], [0, apart], [1, 1]], C1, np.zeros((3, 2)))
        assert singular.reduced_side(P).basis.shape == (3, 3 - rank)


def test_no_rounding_stands_in_the_place_of_a_zero_of_the_states_that_remain():
    for B2 in ([[1, 1], [-1, -1], [-1, -1]], [[0, 1, 1], [1, 2, 2], [1, -2, -1], [-1, 0, -1]]):
        n, m = np.shape(B2)
        P = posed(np.diag(-1.0 - np.arange(n)), B2, np.eye(n), np.zeros((n, m)))
        basis = np.abs(singular.reduced_side(P).basis)
        assert basis.size and ((basis == 0) | (basis > 1e-12)).all()


def test_a_cost_counts_beside_the_path_through_states_at_the_rate_of_A():
    """[[3, 0], [4, 0]] has the rate 5, and a column of 7: beside 1 / 5 a cost of 1e-9 / 6 is none."""
    for cost, free in ((1e-9 / 6, True), (1e-9 / 4.9, False)):
        P = posed([[3, 0], [4, 0]], [[1], [0]], [[1, 0]], [[cost]])
        assert (singular.reduced_side(P).basis.shape[1] < 2) == free


def test_zeros_on_the_axis_are_given_a_small_cost():
    one = notch(2.0)
    P = posed(one.A, one.B2, 5 * one.C1, 5 * one.D12)
    side = singular.reduced_side(P)
    assert side.axis == pytest.approx((2.0,), rel=1e-9)
    assert side.weight == pytest.approx(1e-7 * np.linalg.norm(5 * one.C1), rel=1e-12)
    # z = 0 x + u of an undamped oscillator: without a state cost the weight is eps.
    P = posed([[0, 1], [-1, 0]], [[0], [1]], [[0, 0]], [[1]])
    side = singular.reduced_side(P)
    assert side.axis == pytest.approx((1.0,)) and side.weight == 1e-7 * EPS


def test_the_regular_plant_has_the_extra_costs_and_noises_and_no_others():
    random = np.random.default_rng(0)
    G = StateSpace(*(random.standard_normal(s) for s in ((3, 3), (3, 4), (4, 3), (4, 4))))
    P = loop_of(G, 2, 1)
    for soft in ((False, False), (True, False), (False, True), (True, True)):
        extended, eps = singular.extended_plant(P, soft, 0.1), 0.1
        rows, cols = 3 + 2 + 3 * soft[0], 2 + 1 + 3 * soft[1]
        assert (
            extended.C1.shape == (rows, 3)
            and extended.B1.shape == (3, cols)
            and extended.D11.shape == (rows, cols)
        )
        np.testing.assert_array_equal(extended.D11[:3, :2], P.D11)
        assert not extended.D11[3:].any() and not extended.D11[:, 2:].any()
        np.testing.assert_array_equal(extended.C1[:3], P.C1)
        np.testing.assert_array_equal(extended.B1[:, :2], P.B1)
        np.testing.assert_array_equal(extended.D12[:3], P.D12)
        np.testing.assert_array_equal(extended.D21[:, :2], P.D21)
        assert not extended.C1[3:5].any() and not extended.B1[:, 2:3].any()
        assert not extended.D12[5:].any() and not extended.D21[:, 3:].any()
        reach = np.linalg.norm(P.B2, axis=0)
        cost, noise = eps * np.linalg.norm(P.C1, 2), eps * np.linalg.norm(P.B1, 2)
        np.testing.assert_allclose(extended.D12[3:5], cost * np.diag(reach / reach.max()))
        np.testing.assert_allclose(extended.D21[:, 2:3], [[noise]])
        np.testing.assert_allclose(extended.C1[5:], cost * np.eye(3)[: 3 * soft[0]])
        np.testing.assert_allclose(extended.B1[:, 3:], noise * np.eye(3)[:, : 3 * soft[1]])
        for name in ("A", "B2", "C2"):
            np.testing.assert_array_equal(getattr(extended, name), getattr(P, name))
    idle = posed([[-1.0]], [[0, 4]], [[2]], [[0, 0]])
    np.testing.assert_allclose(singular.extended_plant(idle, (False, False), 0.1).D12[1:], 0.2 * np.eye(2))
    small = posed([[-1.0]], [[1e-6, -4e-6]], [[2]], [[0, 0]])
    np.testing.assert_allclose(
        singular.extended_plant(small, (False, False), 0.1).D12[1:], np.diag([0.05, 0.2])
    )
    idle = posed([[-1.0]], [[0]], [[0]], [[0]])
    np.testing.assert_allclose(singular.extended_plant(idle, (False, False), 1.0).D12[1:], [[EPS]])


# ---------------------------------------------------------------- the central controller


def solution(diagonal, definite: bool = True) -> RiccatiSolution:
    return RiccatiSolution(np.diag(diagonal), definite)


def test_the_coupling_is_the_level_squared_over_the_largest_eigenvalue_of_both():
    X, Y = solution([2.0, 1.0]), solution([3.0, 7.0])
    assert central.coupling_margin(X, Y, 4.0) == pytest.approx(16 / 7)
    turned = RiccatiSolution(np.array([[2.0, 1.0], [1.0, 2.0]]), True)
    largest = np.linalg.eigvals(turned.X @ Y.X).real.max()
    assert central.coupling_margin(turned, Y, 4.0) == pytest.approx(16 / largest)
    assert central.coupling_margin(solution([1.0], False), solution([1.0]), 1.0) == -1.0
    assert central.coupling_margin(solution([1.0]), solution([1.0], False), 1.0) == -1.0
    assert central.coupling_margin(solution([0.25]), solution([0.5]), 1.0) == pytest.approx(8.0)
    with np.errstate(all="raise"):
        assert central.coupling_margin(solution([0.0]), solution([1.0]), 1.0) == np.inf
    below = solution([-1e-20]), solution([1.0])  # as rounding leaves it
    assert central.coupling_margin(*below, 1.0) == np.inf
    empty = RiccatiSolution(np.zeros((0, 0)), True)
    assert central.coupling_margin(empty, empty, 1.0) == np.inf


def plant(seed: int, direct: float) -> StateSpace:
    """3 states, [w1..w3; u1, u2] to [z1..z4; y1, y2], no D22."""
    random = np.random.default_rng(seed)
    A, B, C = (random.standard_normal(s) for s in ((3, 3), (3, 5), (6, 3)))
    D = random.standard_normal((6, 5))
    D[:4, :3] *= direct
    D[4:, 3:] = 0.0
    return StateSpace(A, B, C, D)


@pytest.mark.parametrize("direct", [0.0, 0.5, 3.0])
@pytest.mark.parametrize("seed", range(4))
def test_the_central_controller_keeps_its_level_down_to_the_optimum(seed, direct):
    G = plant(seed, direct)
    P = loop_of(G, 2, 2)
    least = hinf.optimal_level(G, 2, 2, 1e-7)
    for above in (1e-3, 0.3, 5.0):
        level = least * (1 + above)
        K = central.central_controller(P, level)
        assert K.order == 3
        assert hinf_norm(lft(G, K)).lower < level
    assert central.central_controller(P, least * (1 - 1e-4)) is None


@pytest.mark.parametrize("seed", range(3))
def test_where_the_terms_are_normal_it_is_the_one_of_doyle_glover_khargonekar_francis(seed):
    """D12 = [0; I], D21 = [0 I], C1 and B1 beside them: K from X, Y, F, L and Z at the level."""
    random, level = np.random.default_rng(seed), 30.0
    A, B2, C2 = (random.standard_normal(s) for s in ((3, 3), (3, 2), (1, 3)))
    B1, C1 = random.standard_normal((3, 2)), random.standard_normal((3, 3))
    B1[:, 1], C1[1:] = 0.0, 0.0
    P = Plant(A, B1, B2, C1, C2, np.zeros((3, 2)), np.eye(3)[:, 1:], np.eye(2)[1:])

    def solved(A, B, C, D):
        """A'X + XA + C'C - X (B B' - D D' / level^2) X = 0, by the Hamiltonian."""
        H = np.block([[A, D @ D.T / level**2 - B @ B.T], [-C.T @ C, -A.T]])
        n = len(A)
        U = sl.schur(H, sort="lhp")[1][:, :n]
        return U[n:] @ np.linalg.inv(U[:n])

    X, Y = solved(A, B2, C1, B1), solved(A.T, C2.T, B1.T, C1.T)
    F, L, Z = -B2.T @ X, -Y @ C2.T, np.linalg.inv(np.eye(3) - Y @ X / level**2)
    K = central.central_controller(P, level)
    want = StateSpace(A + B1 @ B1.T @ X / level**2 + B2 @ F + Z @ L @ C2, -Z @ L, F, np.zeros((2, 1)))
    omega = [0.0, 0.4, 3.0, np.inf]
    np.testing.assert_allclose(K.response(omega), want.response(omega), rtol=1e-6, atol=1e-9)


@pytest.mark.parametrize("m1", [3, 5])
@pytest.mark.parametrize("seed", range(3))
def test_without_states_it_meets_parrotts_bound(seed, m1):
    random = np.random.default_rng(seed)
    D = random.standard_normal((6, m1 + 2))
    D[4:, m1:] = 0.0
    D11, D12, D21 = D[:4, :m1], D[:4, m1:], D[4:, :m1]
    G = gain(D)
    rows, cols = sl.null_space(D12.T).T @ D11, D11 @ sl.null_space(D21)
    bound = max(np.linalg.norm(rows, 2), np.linalg.norm(cols, 2))
    for above in (1e-3, 1.0, 100.0):
        K = central.central_controller(loop_of(G, 2, 2), bound * (1 + above))
        assert np.linalg.norm(D11 + D12 @ K.D @ D21, 2) < bound * (1 + above)
    assert central.central_controller(loop_of(G, 2, 2), bound * (1 - 1e-6)) is None
