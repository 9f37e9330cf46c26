"""Direct terms, blocks, coordinates and storage terms of the synthesis: each piece by numbers worked out by
hand."""

from dataclasses import fields
from fractions import Fraction

import numpy as np
import pytest

from lpvguard.engine.blocks import Block
from lpvguard.engine.synthesis import coordinates, direct_terms, partition, storage_grid
from lpvguard.engine.synthesis.errors import SynthesisError
from lpvguard.engine.synthesis.partition import Plant
from lpvguard.engine.synthesis.statespace import EPS, StateSpace, gain, lft
from lpvguard.engine.synthesis.structure import Structure


def plant(seed: int, dt: float = 0.0) -> StateSpace:
    """3 states, inputs [w1, w2, u1, u2], outputs [z1, z2, z3, y]."""
    random = np.random.default_rng(seed)
    A = random.standard_normal((3, 3))
    A /= 1.5 * np.abs(np.linalg.eigvals(A)).max()
    return StateSpace(A, *(random.standard_normal(s) for s in ((3, 4), (4, 3), (4, 4))), dt)


# ---------------------------------------------------------------- direct terms


def test_the_size_of_a_controls_path_is_per_rate():
    B2, C1 = np.array([[3.0, 0.0], [4.0, 0.0]]), np.array([[5.0, 12.0]])
    assert direct_terms.direct_scale(2.0, B2, C1).tolist() == [32.5, 0.0]
    tiny = np.array([[1e-150]])
    assert direct_terms.direct_scale(0.0, tiny, tiny) == pytest.approx(1.0), "a rate of 0 divides nothing"


def test_rank_counts_columns_at_unit_length_and_what_lies_beside_the_scale_not_at_all():
    one = np.ones(2)
    rank, V = direct_terms.column_rank(np.array([[2e6, 0.0], [0.0, 3e-3]]), one)
    assert rank == 2
    np.testing.assert_allclose(np.linalg.norm(np.diag([2e6, 3e-3]) @ V, axis=0), [1.0, 1.0])
    rank, V = direct_terms.column_rank(np.array([[2.0, 0.0]]), one)
    assert rank == 1
    np.testing.assert_allclose(np.abs(V), [[0.5, 0.0], [0.0, 1.0]])
    D = np.array([[1.0, 2.0, 3.0], [0.0, 1.0, 5.0]])
    rank, V = direct_terms.column_rank(D, np.ones(3))
    assert rank == 2 and np.linalg.norm(D @ V[:, 2]) < 1e-14 < 0.1 < np.linalg.svd(D @ V[:, :2])[1][-1]
    # Unit columns apart by an angle a have singular values near sqrt(2) and a / sqrt(2).
    for angle, expected in ((2.1e-9, 2), (1.9e-9, 1)):
        assert direct_terms.column_rank(np.array([[1.0, 1.0], [0.0, angle]]), one)[0] == expected
    for size, expected in ((0.9e-9, 0), (1e-9, 0), (1.1e-9, 1)):
        assert direct_terms.column_rank(np.array([[0.0], [size]]), np.ones(1))[0] == expected
    assert direct_terms.column_rank(np.zeros((2, 1)), np.zeros(1))[0] == 0
    for shape in ((0, 2), (2, 0)):
        assert direct_terms.column_rank(np.zeros(shape), np.ones(shape[1]))[0] == 0


def test_what_a_control_does_not_reach_stays():
    D11 = np.array([[1.0, 2.0, 2.0], [3.0, 4.0, 5.0]])
    one = np.ones(1)
    assert direct_terms.unreachable_gain(D11, np.array([[0.0], [2.0]]), one) == pytest.approx(3.0)
    assert direct_terms.unreachable_gain(D11, np.zeros((2, 1)), one) == pytest.approx(np.linalg.norm(D11, 2))
    assert direct_terms.unreachable_gain(D11, np.eye(2), np.ones(2)) == 0.0
    turned = np.array([[0.6], [0.8]])
    rest = np.array([0.8, -0.6]) @ D11
    assert direct_terms.unreachable_gain(D11, 1e-3 * turned, one) == pytest.approx(np.linalg.norm(rest))


def test_parrotts_bound_is_that_of_the_row_and_the_column_that_stay():
    D11 = np.array([[1.0, 2.0, 3.0], [4.0, 5.0, 6.0], [7.0, 8.0, 9.0]])
    last = np.array([[0.0], [0.0], [1.0]])
    A, B, C = -np.eye(1), np.zeros((1, 3)), np.zeros((3, 1))
    P = Plant(A, B, np.zeros((1, 1)), C, np.zeros((1, 1)), D11, last, last.T)
    # Rows 1, 2 with every input, or columns 1, 2 with every output.
    want = max(np.linalg.norm(D11[:2], 2), np.linalg.norm(D11[:, :2], 2))
    assert direct_terms.parrott_bound(P) == pytest.approx(want)
    # With A of norm 5 (and not 7, the sum of a column) a cost of 1.67e-10 is beside the path's 1 / 5.
    A, B2, C1 = np.array([[3.0, 0.0], [4.0, 0.0]]), np.array([[1.0], [0.0]]), np.array([[1.0, 0.0]])
    P = Plant(A, np.zeros((2, 1)), B2, C1, C1, np.array([[7.0]]), np.array([[1e-9 / 6]]), np.array([[1.0]]))
    assert direct_terms.parrott_bound(P) == pytest.approx(7.0)


# ---------------------------------------------------------------- blocks of the plant


def test_the_blocks_are_those_of_the_plants_signals():
    G = plant(0)
    P, D22 = partition.partition(G, 2, 1)
    for got, want in (
        (P.A, G.A),
        (P.B1, G.B[:, :2]),
        (P.B2, G.B[:, 2:]),
        (P.C1, G.C[:3]),
        (P.C2, G.C[3:]),
        (P.D11, G.D[:3, :2]),
        (P.D12, G.D[:3, 2:]),
        (P.D21, G.D[3:, :2]),
        (D22, G.D[3:, 2:]),
    ):
        np.testing.assert_array_equal(got, want)
    twice = P.dual.dual
    for field in fields(Plant):
        np.testing.assert_array_equal(getattr(twice, field.name), getattr(P, field.name))
    np.testing.assert_array_equal(P.dual.B2, P.C2.T)
    np.testing.assert_array_equal(P.dual.D12, P.D21.T)


@pytest.mark.parametrize(
    ("n_u", "n_y", "named"),
    [
        (0, 1, "n_control"),
        (4, 1, "n_control"),
        (1, 0, "n_measurement"),
        (1, 4, "n_measurement"),
        (1.0, 1, "n_c"),
    ],
)
def test_one_signal_at_least_stays_beside_controls_and_measurements(n_u, n_y, named):
    with pytest.raises(SynthesisError, match=named) as raised:
        partition.check_shape(plant(0), n_u, n_y)
    assert "a whole number from 1 to 3, because the plant has 4" in str(raised.value)
    partition.check_shape(plant(0), 1, 3)
    partition.check_shape(plant(0), np.int64(3), 1)


def with_pole(at: float, dt: float = 0.1) -> StateSpace:
    """A plant as above with a pole ``at`` that its u reaches and its y shows."""
    G = plant(1)
    A = G.A.copy()
    A[0, 1:] = A[1:, 0] = 0.0
    A[0, 0] = at
    return StateSpace(A, G.B, G.C, 0.3 * G.D, dt)


def test_a_pole_at_minus_one_is_moved_by_a_feedback_that_the_plant_is_closed_with():
    for at in (-1.0, -1 + 0.9e-6, -1 - 0.9e-6):
        G = with_pole(at)
        shift, closed = partition.move_pole_at_minus_one(G, 2, 2)
        assert shift.shape == (2, 2) and closed.dt == 0.1
        assert np.abs(closed.poles() + 1).min() > 1e-3
        point = [0.3 + 1.1j]
        before, after = G.evaluate(point)[0], closed.evaluate(point)[0]
        inject = shift @ np.linalg.inv(np.eye(2) - before[2:, 2:] @ shift)
        np.testing.assert_allclose(after, before + before[:, 2:] @ inject @ before[2:], rtol=1e-10)
    pair = with_pole(-1.0)
    A = pair.A.copy()
    A[:2, :2] = [[-1.0, 0.01], [-0.01, -1.0]]
    for other in (
        with_pole(-1 + 1.1e-6),
        with_pole(-1.0, 0.0),
        gain(np.eye(4), 0.1),
        StateSpace(A, pair.B, pair.C, pair.D, 0.1),
    ):
        shift, closed = partition.move_pole_at_minus_one(other, 2, 1)
        assert closed is other and shift.tolist() == [[0.0], [0.0]]


def test_the_feedback_at_minus_one_suits_the_units_of_control_and_measurement():
    G = with_pole(-1.0).transformed(np.array([[1.0, 0.0, 0.0], [0.7, 1.0, 0.0], [0.0, 0.0, 1.0]]))
    first = partition.move_pole_at_minus_one(G, 2, 1)[0]
    unit_u, unit_y = np.r_[1.0, 1.0, 1e3, 1e3], np.r_[1.0, 1.0, 1.0, 1e-5]
    other = StateSpace(G.A, G.B * unit_u, unit_y[:, None] * G.C, 0 * G.D, G.dt)
    np.testing.assert_allclose(1e-2 * partition.move_pole_at_minus_one(other, 2, 1)[0], first, rtol=1e-9)
    # A tenth of (1 + |A|) / (|B2| |C2|), times the first normal numbers of seed 0.
    size = (1 + np.linalg.norm(G.A, 2)) / (np.linalg.norm(G.B[:, 2:], 2) * np.linalg.norm(G.C[3:], 2))
    np.testing.assert_allclose(first.ravel(), 0.1 * size * np.array([0.12573, -0.13210]), rtol=1e-4)
    unreached = StateSpace(G.A, 0 * G.B, G.C, G.D, G.dt)
    np.testing.assert_array_equal(partition.move_pole_at_minus_one(unreached, 2, 1)[1].A, G.A)


def test_a_controller_takes_the_feedthrough_that_the_design_left_out():
    G, random = plant(2), np.random.default_rng(3)
    K = StateSpace(*(random.standard_normal(s) for s in ((2, 2), (2, 1), (2, 2), (2, 1))))
    D, D22 = G.D.copy(), G.D[3:, 2:]
    D[3:, 2:] = 0.0
    without = StateSpace(G.A, G.B, G.C, D)
    omega = [0.0, 0.7, 9.0]
    wanted = lft(without, K).response(omega)
    np.testing.assert_allclose(lft(G, partition.absorb_feedthrough(K, D22)).response(omega), wanted)
    assert partition.absorb_feedthrough(K, 0 * D22) is K
    one = np.array([[0.0, 0.5]])
    D[3:, 2:] = one
    G = StateSpace(G.A, G.B, G.C, D)
    np.testing.assert_allclose(lft(G, partition.absorb_feedthrough(K, one)).response(omega), wanted)


def existence(A, B2, C2, direct: StateSpace | None = None) -> str:
    """What the test of existence says of (A, B2, C2); empty where it passes."""
    A, B2, C2 = (np.array(M, float) for M in (A, B2, C2))
    n = len(A)
    P = Plant(A, np.zeros((n, 1)), B2, np.zeros((1, n)), C2, *(np.zeros((1, 1)),) * 3)
    try:
        partition.check_existence(P, direct or gain(np.zeros((1, 1))))
    except SynthesisError as error:
        return str(error)
    return ""


def test_every_pole_that_is_not_stable_is_reached_and_shown():
    both = [[1.0], [1.0]], [[1.0, 1.0]]
    A = [[0.5, 0.0], [0.0, -2.0]]
    assert existence(A, *both) == ""
    assert existence(A, [[1.0], [0.0]], [[1.0, 0.0]]) == "", "what is left out is stable"
    said = existence(A, [[0.0], [1.0]], both[1])
    assert "not stabilisable" in said and "do not reach the pole at 0.5" in said and "actuator" in said
    said = existence(A, both[0], [[0.0, 1.0]])
    assert "not detectable" in said and "do not show the pole at 0.5" in said and "sensor" in said
    assert existence(np.zeros((0, 0)), np.zeros((0, 1)), np.zeros((1, 0))) == ""
    # Units of control and measurement do not matter, nor does the unit of time.
    assert existence(A, [[1e-13], [1e-13]], [[1e9, 1e9]]) == ""
    assert existence([[0.5, 0.0], [1.0, -2.0]], [[1.0], [0.0]], [[0.0, 1.0]]) == "", "seen through the other"
    assert existence([[0.0]], [[1.0]], [[1.0]]) == ""
    assert "at 0+0j" in existence([[0.0]], [[0.0]], [[1.0]]) or "at 0" in existence([[0.0]], [[0.0]], [[1.0]])


def test_the_borders_of_existence_are_relative_to_the_size_of_A():
    for size in (1.0, 1e4):
        # A pole at -1e-12 of A's size or right of it counts as unstable.
        for share, bad in ((-0.9e-12, True), (-1e-12, True), (-1.1e-12, False)):
            A = [[share * size, 0.0], [0.0, -size]]
            assert bool(existence(A, [[0.0], [1.0]], [[1.0, 1.0]])) == bad, (size, share)
        # [A - p I, B] has a row of that size left: B of unit size is brought to A's.
        for share, bad in ((0.9e-11, True), (1.1e-11, False)):
            A = [[0.0, 0.0], [0.0, -size]]
            assert bool(existence(A, [[share, 0.0], [0.0, 1.0]], [[1.0, 1.0]])) == bad, (size, share)


def test_the_size_of_A_and_B_is_that_of_their_largest_singular_value():
    """[[3, 0], [4, 1]] has 5.08, and columns of 7; [0.6, 0.8] has 1, and entries that sum to 1.4."""
    A = [[-6e-12, 0, 0], [0, -3, 0], [0, -4, -1]]
    assert existence(A, [[0.0], [1.0], [1.0]], np.eye(3)) == ""
    A, B = np.diag([0.0, -1.0, -1.0]), [[1.2e-11, 0.0], [0.0, 0.6], [0.0, 0.8]]
    assert existence(A, B, np.eye(3)) == ""


def test_the_pole_is_named_where_the_plant_has_it():
    direct = gain(np.zeros((1, 1)), 0.5)
    assert "the pole at 1.66667" in existence([[1.0]], [[0.0]], [[1.0]], direct), "(4 + 1) / (4 - 1)"


# ---------------------------------------------------------------- coordinates


def test_a_dense_badly_conditioned_state_is_undone():
    random = np.random.default_rng(4)
    G = StateSpace(-np.diag([1.0, 2.0, 3.0]), np.ones((3, 1)), np.ones((1, 3)), [[0.5]])
    assert coordinates.schur_coordinates(G)[0] is G
    U, V = (np.linalg.qr(random.standard_normal((3, 3)))[0] for _ in range(2))
    T = U * [1e-4, 1.0, 1e4] @ V
    bad = G.transformed(np.linalg.inv(T))
    other, basis = coordinates.schur_coordinates(bad)
    assert np.linalg.norm(other.A) < 0.1 * np.linalg.norm(bad.A)
    np.testing.assert_allclose(basis @ other.A, bad.A @ basis, atol=1e-9 * np.linalg.norm(bad.A))
    np.testing.assert_allclose(basis @ other.B, bad.B, rtol=1e-6)
    np.testing.assert_allclose(other.C, bad.C @ basis)
    one = StateSpace([[-1.0]], [[1e9]], [[1e-9]], [[0.0]])
    same, own = coordinates.schur_coordinates(one)
    assert same is one and own.tolist() == [[1.0]]


@pytest.mark.parametrize(("coupling", "kept"), [(8.0, True), (40.0, False)])
def test_the_schur_form_is_taken_where_A_becomes_ten_times_smaller(coupling, kept):
    """[[-1, c], [0, -1]] with signals that balance the coupling to 1: |A| falls from c to near 2."""
    G = StateSpace([[-1.0, coupling], [0.0, -1.0]], [[0.0], [1.0 / coupling]], [[1.0, 0.0]], [[0.0]])
    other, basis = coordinates.schur_coordinates(G)
    assert (other is G) == kept
    if kept:
        np.testing.assert_array_equal(basis, np.eye(2))


def test_entries_in_other_coordinates_are_right_to_the_last_digit():
    """T of condition 1e8 by exact fractions; a T that has no inverse in doubles is refused."""
    random = np.random.default_rng(6)
    G = StateSpace(*(random.standard_normal((3, 3)) for _ in range(4)))
    U, V = (np.linalg.qr(random.standard_normal((3, 3)))[0] for _ in range(2))
    T = U * [1e-4, 1.0, 1e4] @ V
    other = coordinates.transformed(G, T)

    def exact(X):
        return np.array([Fraction(float(x)) for x in X.flat]).reshape(X.shape)

    for X, known in ((other.A, exact(G.A) @ exact(T)), (other.B, exact(G.B))):
        rest = (known - exact(T) @ exact(X)).astype(float)
        assert (np.abs(np.linalg.solve(T, rest)) <= EPS * np.abs(X)).all()
    np.testing.assert_array_equal(other.C, (exact(G.C) @ exact(T)).astype(float))
    with pytest.raises(np.linalg.LinAlgError):
        coordinates.transformed(G, U * [1e-20, 1.0, 1.0] @ V)
    small = StateSpace(1e-30 * G.A, 1e-30 * G.B, G.C, G.D)
    with pytest.raises(np.linalg.LinAlgError):
        coordinates.transformed(small, U * [1e-20, 1.0, 1.0] @ V)


@pytest.mark.parametrize("entry", [0.0, 0.5 + 2.0**-53])
def test_its_own_coordinates_keep_every_digit_of_a_system(entry):
    G = StateSpace([[entry]], [[0.0]], [[0.0]], [[0.0]])
    assert coordinates.transformed(G, np.eye(1)).A.item() == entry


@pytest.mark.parametrize("seed", range(6))
def test_coordinates_of_condition_3e12_are_refined_to_the_last_digit(seed):
    random = np.random.default_rng(seed)
    U, V = (np.linalg.qr(random.standard_normal((4, 4)))[0] for _ in range(2))
    T = U * np.geomspace(1, 3e-13, 4) @ V
    G = StateSpace(random.standard_normal((4, 4)), np.zeros((4, 1)), np.zeros((1, 4)), [[0.0]])
    assert np.trace(coordinates.transformed(G, T).A) == pytest.approx(np.trace(G.A), abs=1e-2)


def test_modes_stand_apart_in_real_blocks():
    blocks = np.array([[-1.0, 5.0, 0.0], [-5.0, -1.0, 0.0], [0.0, 0.0, -1e-3]])
    turn = np.linalg.qr(np.random.default_rng(5).standard_normal((3, 3)))[0]
    G = StateSpace(turn @ blocks @ turn.T, turn @ np.ones((3, 1)), np.ones((1, 3)), [[0.0]])
    other, basis = coordinates.modal_coordinates(G)
    assert np.isrealobj(basis)
    np.testing.assert_allclose(basis @ other.A, G.A @ basis, atol=1e-12)
    np.testing.assert_allclose(basis @ other.B, G.B, atol=1e-12)
    slow = int(np.argmin(np.abs(np.diag(other.A))))
    rest = np.delete(np.arange(3), slow)
    assert other.A[slow, slow] == pytest.approx(-1e-3)
    np.testing.assert_allclose(np.r_[other.A[slow, rest], other.A[rest, slow]], 0, atol=1e-12)
    real, _ = coordinates.modal_coordinates(
        StateSpace([[-1.0, 7.0], [0.0, -3.0]], np.eye(2), np.eye(2), np.eye(2))
    )
    np.testing.assert_allclose(np.sort(np.diag(real.A)), [-3.0, -1.0])
    assert abs(real.A[0, 1]) < 1e-12 and abs(real.A[1, 0]) < 1e-12
    for G in (
        StateSpace([[-1.0, 1.0], [0.0, -1.0]], np.eye(2), np.eye(2), np.eye(2)),  # eigenvectors do not span
        StateSpace([[-2.0]], [[1e6]], [[1e-6]], [[0.0]]),
    ):
        other, basis = coordinates.modal_coordinates(G)
        assert other is G and basis.tolist() == np.eye(G.order).tolist()


def nearly(d: float, sign: float, dt: float) -> StateSpace:
    """[[-1, 2], [2, -4 - d]], or with -2: its pole at -d / 5 has the eigenvector (2, 1) on both sides, so the
    last digits of the entries move it by (2 (1 2 + 2 1) + 1 (2 2 + 4 1)) / 5 eps = 3.2 eps.

    With ``dt`` half of [[-1, 1], [1, -1 - d]] and I, or that negative: a pole at 1 - d / 4 moves by eps."""
    if dt:
        A = sign * np.array([[0.5, 0.5], [0.5, 0.5 - d / 2]])
    else:
        A = np.array([[-1.0, 2 * sign], [2 * sign, -4 - d]])
    return StateSpace(A, np.ones((2, 1)), np.ones((1, 2)), [[0.0]], dt)


@pytest.mark.parametrize(("dt", "border"), [(0.0, 16000 * EPS), (0.1, 4000 * EPS)])
@pytest.mark.parametrize("sign", [1.0, -1.0])
@pytest.mark.parametrize("side", [1.0, -1.0])
def test_a_pole_is_frail_where_the_last_digits_move_it_by_a_thousandth_of_its_room(dt, border, sign, side):
    for d, frail in ((0.5 * border, True), (0.94 * border, True), (1.06 * border, False), (0.5, False)):
        assert bool(coordinates.frail_pole(nearly(side * d, sign, dt))) == frail, d / border
    said = coordinates.frail_pole(nearly(side * 0.5 * border, sign, dt))
    assert f"by up to {(EPS if dt else 3.2 * EPS):.1g}" in said
    pole = sign if dt else -side * 1600 * EPS
    shown = said.split("at ")[1].split()[0].replace("+0j", "").strip("()")
    assert float(shown) == pytest.approx(pole, rel=2e-2)


def test_a_turning_pole_is_frail_as_a_real_one_is():
    """Poles -d / 5 +- 3j: the matrix of before beside itself, joined by 3."""
    block = nearly(8000 * EPS, 1.0, 0.0).A
    A = np.block([[block, 3 * np.eye(2)], [-3 * np.eye(2), block]])
    G = StateSpace(A, np.ones((4, 1)), np.ones((1, 4)), [[0.0]])
    # 3 of the joining entry on each side: (3.2 + 3) eps.
    assert f"by up to {6.2 * EPS:.1g}" in coordinates.frail_pole(G)


@pytest.mark.parametrize("seed", range(8))
def test_what_moves_a_pole_is_told_by_the_inverse_of_the_eigenvectors_too(seed):
    A = np.random.default_rng(seed).standard_normal((4, 4))
    values, vectors = np.linalg.eig(A)
    k = int(np.argmax(np.abs(values.imag)))
    A -= (values[k].real + 1e-14) * np.eye(4)
    moved = EPS * np.abs(np.linalg.inv(vectors)[k]) @ np.abs(A) @ np.abs(vectors[:, k])
    said = coordinates.frail_pole(StateSpace(A, np.ones((4, 1)), np.ones((1, 4)), [[0.0]]))
    assert values[k].imag != 0 and said.endswith(f"by up to {moved:.1g}")


def test_a_pole_without_room_that_nothing_moves_is_not_frail():
    with np.errstate(all="raise"):
        assert coordinates.frail_pole(StateSpace([[0.0]], [[1.0]], [[1.0]], [[0.0]])) == ""
        assert coordinates.frail_pole(gain([[1.0]])) == ""


# ---------------------------------------------------------------- storage terms


def test_terms_their_slopes_and_a_refined_grid():
    assert storage_grid.terms([2.0, 4.0]).tolist() == [[1, 2, 0.5], [1, 4, 0.25]]
    assert storage_grid.slopes([2.0, 4.0]).tolist() == [[0, 1, -0.25], [0, 1, -1 / 16]]
    assert storage_grid.refined(np.array([1.0, 2.0, 6.0]), 2).tolist() == [1, 1.5, 2, 4, 6]
    assert storage_grid.refined(np.array([1.0, 4.0]), 3).tolist() == [1, 2, 3, 4]
    G = plant(3)
    basis = np.diag([1.0, 2.0, 4.0])
    now, out = storage_grid.parts_in(G, basis)
    np.testing.assert_allclose(basis @ now, np.hstack([G.A @ basis, G.B]))
    np.testing.assert_allclose(out, np.hstack([G.C @ basis, G.D]))


def test_a_storage_of_the_grid_is_fitted_and_told_in_speeds():
    grid = np.array([2.0, 3.0, 5.0, 10.0])
    one = storage_grid.StorageGrid.from_parts(0.1, grid, np.eye(2), [])
    # 1, the distance from the mean in spreads, and what mean / v is above 1.
    functions = storage_grid.terms(grid) @ one.units.T
    np.testing.assert_allclose(
        functions, np.stack([np.ones(4), (grid - 5) / 8, 5 / grid - 1], axis=1), atol=1e-15
    )
    random = np.random.default_rng(6)
    of_speed = random.standard_normal((3, 2, 2))
    values = of_speed[0] + grid[:, None, None] * of_speed[1] + of_speed[2] / grid[:, None, None]
    np.testing.assert_allclose(one.coefficients(one.fitted(values)), of_speed, rtol=1e-9)


def test_the_barrier_of_a_rate_holds_both_ways_at_every_speed():
    grid, rate = np.array([2.0, 5.0]), 3.0
    G = plant(7)
    part = storage_grid.parts_in(StateSpace(G.A, G.B[:, :2], G.C[:2], G.D[:2, :2]), np.eye(3))
    other = tuple(2 * M for M in part)
    one = storage_grid.StorageGrid.from_parts(0.1, grid, np.eye(3), [part, other])
    barrier = one.barrier(rate)
    functions = storage_grid.terms(grid) @ one.units.T
    moved = [(v + s * 1e-6, v - s * 1e-6) for v in grid for s in (1, -1)]
    for k, (ahead, behind) in enumerate(moved):
        slope = (storage_grid.terms(ahead) - storage_grid.terms(behind)) @ one.units.T / 2e-6
        np.testing.assert_allclose(barrier.next[k] + barrier.moved[k], functions[k // 2])
        np.testing.assert_allclose(barrier.next[k], functions[k // 2] + rate * 0.1 * slope, rtol=1e-6)
        np.testing.assert_array_equal(barrier.D[k], (part, other)[k // 2][0] - np.eye(3, 5))
    still = storage_grid.unmoved([part, other])
    assert still.next.tolist() == np.eye(2).tolist() and not still.moved.any()


# ---------------------------------------------------------------- blocks of Delta


def test_the_bases_of_the_scalings_commute_with_every_delta_and_are_orthogonal():
    blocks = (Block("full", 2, 3), Block("repeated_real", 2, 2), Block("repeated_complex", 2, 2))
    one = Structure(blocks)
    assert one.row == [slice(0, 3), slice(3, 5), slice(5, 7)] and one.n_rows == 7
    assert one.col == [slice(0, 2), slice(2, 4), slice(4, 6)] and one.n_cols == 6
    assert (len(one.left), len(one.right), len(one.skew)) == (9, 9, 4)
    assert not one.complex_only and Structure(blocks[::2]).complex_only
    assert Structure(blocks[:1]).skew.shape == (0, 2, 3)
    random = np.random.default_rng(8)
    delta = np.zeros((6, 7), complex)
    delta[:2, :3] = random.standard_normal((2, 3)) + 1j * random.standard_normal((2, 3))
    delta[2:4, 3:5] = 0.7 * np.eye(2)
    delta[4:, 5:] = (0.3 - 0.4j) * np.eye(2)
    for left, right in zip(one.left, one.right, strict=True):
        assert set(np.abs(right).ravel()) == set(np.abs(left).ravel()) == {0.0, 1.0}
        np.testing.assert_allclose(delta @ left, right @ delta)
        np.testing.assert_array_equal(right, right.conj().T)
    for G in one.skew:
        product = delta.conj().T @ G
        np.testing.assert_allclose(product, product.conj().T)
    for basis in (one.right, one.skew):
        gram = np.einsum("aij,bij->ab", basis.conj(), basis)
        np.testing.assert_array_equal(gram, np.diag(np.diag(gram)))
        assert (np.diag(gram).real > 0).all()


def test_coordinates_and_magnitude_belong_to_the_bases():
    blocks = (Block("full", 2, 3), Block("repeated_real", 2, 2))
    one = Structure(blocks)
    x = np.array([0.5, 1.0, -2.0, 3.0, 4.0, 0.1, -0.2, 0.3, 0.7])
    D, G = np.tensordot(x[:5], one.right, 1), np.tensordot(x[5:], one.skew, 1)
    np.testing.assert_allclose(one.coordinates(D, G), x)
    left, right = one.magnitude(G)
    np.testing.assert_allclose(left[3:, 3:] @ left[3:, 3:], G[2:, 3:] @ G[2:, 3:], atol=1e-14)
    np.testing.assert_array_equal(left[3:, 3:], right[2:, 2:])
    assert np.linalg.eigvalsh(left[3:, 3:])[0] > 0
    assert not left[:3].any() and not right[:2].any() and left.shape == (5, 5) and right.shape == (4, 4)
