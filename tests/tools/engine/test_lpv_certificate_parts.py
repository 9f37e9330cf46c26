"""The pieces of the certificate at a moving speed, each against what defines it: norms, minima, identities of
Lyapunov and Riccati equations, and loops whose answer is known by hand."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
import scipy.linalg as sl

from lft_problems import spd
from lpvguard.engine.synthesis import lpv_certificate as lpv
from lpvguard.engine.synthesis import storage_grid
from lpvguard.engine.synthesis.statespace import StateSpace

TS = 0.1
NODES = np.array([1.0, 2.0, 3.0])
A_MEAN = np.array([[0.6, 0.2], [-0.3, 0.5]])
A_SLOPE = np.array([[0.0, 0.0], [0.12, -0.08]])
A_BEND = np.array([[0.0, 0.0], [0.05, 0.04]])


def family(gain: float = 0.5, bend: float = 1.0) -> lpv.Family:
    """x+ = A(v) x + [0, 1]' w, z = gain x_1. A is quadratic in v, in its second row: Xi' and Xi'' are known.
    The probes are the state and w."""

    def at(v):
        d = v - 2.0
        C = np.vstack([[gain, 0.0], np.eye(2), [0.0, 0.0]])
        D = np.array([[0.0], [0.0], [0.0], [1.0]])
        return StateSpace(A_MEAN + d * A_SLOPE + bend * d**2 * A_BEND, np.array([[0.0], [1.0]]), C, D, TS)

    def bounds(low, high):
        d = max(abs(low - 2.0), abs(high - 2.0))
        first = np.abs(A_SLOPE[1:]) + 2 * bend * d * np.abs(A_BEND[1:])
        second = 2 * bend * np.abs(A_BEND[1:])
        return np.hstack([first, [[0.0]]]), np.hstack([second, [[0.0]]])

    return lpv.Family(at, NODES, slice(1, 2), 3, bounds, TS)


def dissipated(one: lpv.Family, storage: lpv.Storage, v: float, after: float) -> np.ndarray:
    """F(v, v+) of the module's head, written out."""
    G = one.at(v)
    T = storage.basis
    AB = np.linalg.solve(T, np.hstack([G.A @ T, G.B]))
    CD = np.hstack([G.C[:1] @ T, G.D[:1]])
    return sl.block_diag(storage.at(v), np.eye(G.B.shape[1])) - AB.T @ storage.at(after) @ AB - CD.T @ CD


def test_terms_and_their_slopes():
    v, h = np.array([[2.0, 4.0], [0.5, 10.0]]), 1e-6
    assert storage_grid.terms(v)[0, 1].tolist() == [1.0, 4.0, 0.25] and storage_grid.terms(v).shape == (
        2,
        2,
        3,
    )
    np.testing.assert_allclose(
        storage_grid.slopes(v),
        (storage_grid.terms(v + h) - storage_grid.terms(v - h)) / (2 * h),
        rtol=1e-7,
        atol=1e-9,
    )


def test_a_storage_is_linear_between_its_knots():
    random = np.random.default_rng(1)
    knots = np.array([1.0, 1.5, 3.0, 3.5, 4.0])
    storage = lpv.Storage(np.eye(2), knots, np.array([spd(random, 2) for _ in knots]))
    for v in (1.0, 1.2, 1.5, 2.75, 3.0, 3.4, 3.9, 4.0):
        for i, j in ((0, 0), (0, 1), (1, 1)):
            assert storage.at(v)[i, j] == pytest.approx(np.interp(v, knots, storage.P[:, i, j]))
    for k, slope in enumerate(storage.slopes):
        np.testing.assert_allclose(slope, (storage.P[k + 1] - storage.P[k]) / (knots[k + 1] - knots[k]))
    # What lies beyond the last knots continues the outermost segments.
    np.testing.assert_allclose(storage.at(4.5), storage.P[4] + 0.5 * storage.slopes[3])
    np.testing.assert_allclose(storage.at(0.5), storage.P[0] - 0.5 * storage.slopes[0])


def uneven() -> lpv.Storage:
    """P(v) of one number that bends at 1.5 and 3."""
    P = np.array([2.0, 5.0, 1.0, 4.0])[:, None, None]
    return lpv.Storage(np.eye(1), np.array([1.0, 1.5, 3.0, 4.0]), P)


@pytest.mark.parametrize(
    ("low", "high", "step", "pairs"),
    [
        (1.75, 2.0, 0.125, {(4.0, 10 / 3), (14 / 3, 4.0)}),  # within a segment: 2 / 0.75 down for 1 m/s up
        (1.5, 1.625, 0.125, {(14 / 3, 13 / 3), (5.0, 5.0), (4.25, 5.0)}),  # below, from 1.5 on: 6 for 1 m/s
        (1.5, 1.75, 0.125, {(14 / 3, 4.0), (5 + 1 / 3, 13 / 3 + 1 / 3), (4.25, 13 / 3 - 0.75)}),
        (2.75, 3.0, 0.25, {(1.0, 1.0), (1.0, 1.75), (7 / 3, 5 / 3)}),
        (1.75, 2.0, 2.0, {(5.0, 5.0), (1.0, 1.0), (3.25, 4.0), (-5.5, -4.0)}),
    ],
)
def test_p_after_a_step_lies_on_these_chords(low, high, step, pairs):
    """By hand: what v + step reaches, and the knots on the way; by slopes where a knot is reached by some."""
    chords = uneven().afterwards(low, high, step)
    assert {tuple(round(float(x[0, 0]), 9) for x in pair) for pair in chords} == {
        tuple(round(x, 9) for x in pair) for pair in pairs
    }


def test_no_step_leaves_the_chords():
    """P(v+) of random steps from random cells is between the least and the largest chord at v."""
    storage, random = uneven(), np.random.default_rng(8)
    for _ in range(300):
        k = random.integers(3)
        low, high = np.sort(random.uniform(storage.knots[k], storage.knots[k + 1], 2))
        step = random.uniform(0.0, 0.8)
        pairs = np.array(storage.afterwards(low, high, step))[:, :, 0, 0]
        for v, share in ((low, 0.0), (0.3 * high + 0.7 * low, 0.3), (high, 1.0)):
            chords = (1 - share) * pairs[:, 0] + share * pairs[:, 1]
            for u in np.clip(random.uniform(v - step, v + step, 9), 1.0, 4.0):
                assert chords.min() - 1e-12 <= storage.at(u)[0, 0] <= chords.max() + 1e-12


def test_a_cell_is_cut_where_speeds_begin_to_reach_across_a_knot():
    storage = uneven()
    assert storage.cut(1.5, 3.0, 0.25) in (1.75, 2.75) and storage.cut(1.5, 1.75, 0.25) == 1.625
    assert storage.cut(1.6, 3.0, 0.25) == 2.75 and storage.cut(1.5, 2.9, 0.25) == 1.75, "the nearest"
    assert storage.cut(1.0, 1.5, 0.125) == 1.375 and storage.cut(3.0, 4.0, 0.25) == 3.25
    assert storage.cut(3.5, 4.0, 0.125) == 3.75, "no speed lies beyond the last knot"
    assert storage.cut(1.0, 1.4, 0.15) == 1.35, "nor before the first"


def test_a_polynomial_storage_has_its_values_at_knots_that_refine_the_nodes():
    random = np.random.default_rng(2)
    P = random.standard_normal((3, 2, 2))
    storage = lpv.polynomial_storage(family(), np.eye(2), P)
    assert len(storage.knots) == 2 * lpv.KNOTS + 1 and set(NODES) <= set(storage.knots)
    np.testing.assert_allclose(np.diff(storage.knots), 1 / lpv.KNOTS)
    for v, value in zip(storage.knots, storage.P, strict=True):
        np.testing.assert_allclose(value, P[0] + v * P[1] + P[2] / v)
    uneven = storage_grid.refined(np.array([0.0, 1.0, 5.0]), 4)
    assert uneven.tolist() == [0.0, 0.25, 0.5, 0.75, 1.0, 2.0, 3.0, 4.0, 5.0]


def test_the_absolute_value_of_a_matrix_is_the_root_of_its_square():
    random = np.random.default_rng(3)
    X = random.standard_normal((5, 5))
    X = X + X.T
    size = lpv._absolute(X)
    np.testing.assert_allclose(size @ size, X @ X, atol=1e-12)
    np.testing.assert_allclose(lpv._absolute(X + np.triu(X, 1) - np.triu(X, 1).T), size, atol=1e-12)
    for other in (size - X, size + X, size):
        assert np.linalg.eigvalsh(other)[0] > -1e-12


def test_two_remainders_are_weighed_at_the_least_cost():
    random = np.random.default_rng(4)
    X, Y, inverse = spd(random, 3), 50 * spd(random, 3), spd(random, 3)
    cost = np.sum(inverse * lpv._weighed(X, Y, inverse))
    etas = np.geomspace(1e-3, 1e3, 4001)
    costs = [np.sum(inverse * (eta * X + Y / eta)) for eta in etas]
    assert cost <= min(costs) + 1e-12 and cost == pytest.approx(min(costs), rel=1e-5)
    assert cost == pytest.approx(2 * np.sqrt(np.sum(inverse * X) * np.sum(inverse * Y)))
    np.testing.assert_allclose(
        lpv._weighed(1e-9 * X, 1e-9 * Y, inverse), 1e-9 * lpv._weighed(X, Y, inverse), rtol=1e-12
    )
    zero = np.zeros((3, 3))
    np.testing.assert_array_equal(lpv._weighed(X, zero, inverse), X)
    np.testing.assert_array_equal(lpv._weighed(zero, Y, inverse), Y)


@pytest.mark.parametrize(
    ("reached", "failed", "wanted"),
    [
        (None, None, 0.25),
        (None, 0.25, 0.0625),
        (None, 0.0625, 0.015625),
        (None, 0.015625, None),
        (None, 0.06, 0.015),
        (None, 0.05, None),
        (7.5, None, 8.0),
        (2.0, 4.2, None),
        (0.25, None, 1.0),
        (4.0, None, 8.0),
        (8.0, None, None),
        (1.0, 4.0, 2.0),
        (1.0, 2.25, 1.5),
        (1.0, 2.0, None),
        (1.0, 2.1, None),
    ],
)
def test_rates_go_by_fours_and_then_by_the_geometric_mean(reached, failed, wanted):
    assert lpv._next_rate(reached, failed) == (wanted and pytest.approx(wanted))


def loops(one: lpv.Family, speeds) -> list[StateSpace]:
    return [one.at(v).select(slice(0, 1), slice(None)) for v in speeds]


def test_the_coordinates_balance_the_sums_of_the_gramians():
    systems = loops(family(), (1.0, 1.7, 3.0))
    # Another unit of a state must not matter.
    unit = np.diag([1e4, 1e-3])
    scaled = [
        StateSpace(unit @ G.A @ np.linalg.inv(unit), unit @ G.B, G.C @ np.linalg.inv(unit), G.D, TS)
        for G in systems
    ]
    for group in (systems, scaled):
        T = lpv._coordinates(group)
        reach = sum(sl.solve_discrete_lyapunov(G.A, G.B @ G.B.T) for G in group) / 3
        seen = sum(sl.solve_discrete_lyapunov(G.A.T, G.C.T @ G.C) for G in group) / 3
        inverse = np.linalg.inv(T)
        balanced, other = inverse @ reach @ inverse.T, T.T @ seen @ T
        np.testing.assert_allclose(balanced, other, atol=1e-6 * balanced.max())
        np.testing.assert_allclose(balanced, np.diag(np.diag(balanced)), atol=1e-6 * balanced.max())


def test_the_coordinates_of_three_states_balance_and_follow_the_states_units():
    """The states may have units that make one of them tiny."""
    random = np.random.default_rng(9)
    A, B, C = 0.3 * random.standard_normal((3, 3)), random.standard_normal((3, 2)), np.eye(1, 3)
    T = lpv._coordinates([StateSpace(A, B, C, np.zeros((1, 2)), TS)])
    inverse = np.linalg.inv(T)
    balanced = inverse @ sl.solve_discrete_lyapunov(A, B @ B.T) @ inverse.T
    np.testing.assert_allclose(balanced, np.diag(np.diag(balanced)), atol=1e-6 * balanced.max())
    seen = T.T @ sl.solve_discrete_lyapunov(A.T, C.T @ C) @ T
    np.testing.assert_allclose(seen, balanced, atol=1e-6 * balanced.max())
    for units in ([1.0, 1.0, 1e-9], [1e9, 1.0, 1.0]):
        U = np.diag(units)
        scaled = StateSpace(U @ A / units, U @ B, C / units, np.zeros((1, 2)), TS)
        np.testing.assert_allclose(np.abs(lpv._coordinates([scaled])), np.abs(U @ T), rtol=1e-5)


def test_what_is_hidden_is_in_proportion_to_the_most_that_a_state_is_reached_or_seen():
    """Two states that move as one are reached by one each, as they are seen."""
    C = np.eye(2, 3)
    T = lpv._coordinates([StateSpace(np.zeros((3, 3)), [[1.0], [1.0], [0.0]], C, np.zeros((2, 1)), TS)])
    np.testing.assert_allclose(np.sort(np.abs(T[2])), [0.0, 0.0, 1.0], atol=1e-9)


def test_a_state_that_is_neither_reached_nor_seen_leaves_a_basis():
    G = StateSpace(
        np.diag([0.5, 0.3]), np.array([[1.0], [0.0]]), np.array([[1.0, 0.0]]), np.zeros((1, 1)), TS
    )
    T = lpv._coordinates([G])
    assert np.isfinite(T).all() and np.linalg.cond(T) < 1e9


@pytest.fixture(scope="module")
def frozen():
    one = family()
    speeds = np.array([1.0, 2.0, 2.6, 3.0])
    basis, parts, P = lpv.frozen_at(one, speeds)
    return one, speeds, basis, parts, P


def test_frozen_solutions_dissipate_at_their_speed_and_their_coordinates_even_it(frozen):
    one, speeds, basis, parts, P = frozen
    lost = []
    for v, (M, N), here in zip(speeds, parts, P, strict=True):
        constant = lpv.Storage(basis, np.array([0.0, 9.0]), np.array([here, here]))
        F = dissipated(one, constant, v, v)
        assert np.linalg.eigvalsh(F)[0] > 0 and np.linalg.eigvalsh(here)[0] > 0
        G = one.at(v)
        np.testing.assert_allclose(M, np.linalg.solve(basis, np.hstack([G.A @ basis, G.B])), atol=1e-12)
        np.testing.assert_allclose(N, np.hstack([G.C[:1] @ basis, G.D[:1]]), atol=1e-12)
        lost.append(F[:2, :2])
    np.testing.assert_allclose(np.mean(lost, axis=0), np.eye(2), atol=1e-8)
    mean = P.mean(axis=0)
    np.testing.assert_allclose(mean, np.diag(np.diag(mean)), atol=1e-8 * np.abs(mean).max())


@pytest.mark.parametrize(("gain", "there"), [(0.98, True), (1.02, False)])
def test_frozen_solutions_are_there_while_the_gain_of_every_speed_is_below_one(gain, there):
    """z = g x with x+ = a x + w has the gain g / (1 - a), largest at the fastest speed."""

    def at(v):
        C = np.array([[0.4 * gain * (v / 2 if v > 1.5 else 0.5)], [1.0], [0.0]])
        return StateSpace(np.array([[0.6]]), np.array([[1.0]]), C, np.array([[0.0], [0.0], [1.0]]), TS)

    def none(low, high):
        return np.zeros((1, 2)), np.zeros((1, 2))

    one = lpv.Family(at, np.array([1.0, 2.0]), slice(0, 1), 2, none, TS)
    assert (lpv.frozen_at(one, np.array([1.0, 1.4, 2.0])) is not None) == there
    assert lpv.frozen_at(one, np.array([1.0, 1.4])) is not None
    unstable = lpv.Family(
        lambda v: StateSpace(np.array([[1.1]]), *(getattr(at(v), k) for k in "BCD"), TS),
        one.nodes,
        one.vehicle,
        2,
        none,
        TS,
    )
    assert lpv.frozen_at(unstable, np.array([1.0, 2.0])) is None


def test_the_rate_at_the_knots_is_the_one_at_which_the_dissipation_ends():
    one = family(gain=0.3)
    storage = lpv.riccati_storage(one)
    rate = lpv._rate_at_knots(one, storage)

    def least(rate):
        out = np.inf
        for k, v in enumerate(storage.knots):
            for slope in storage.slopes[max(k - 1, 0) : k + 1]:
                for sign in (-1, 1):
                    after = lpv.Storage(storage.basis, np.array([v, v + 1]), np.array([storage.P[k]] * 2))
                    G = one.at(v)
                    AB = np.linalg.solve(storage.basis, np.hstack([G.A @ storage.basis, G.B]))
                    F = dissipated(one, after, v, v) - sign * rate * TS * AB.T @ slope @ AB
                    out = min(out, np.linalg.eigvalsh(F)[0])
        return out

    assert least(0.999 * rate) > 0 > least(1.001 * rate)


@pytest.mark.parametrize(
    "P",
    [
        [0.62, 0.5, 0.5, 0.5],
        [0.5, 0.62, 0.5, 0.5],
        [0.5, 0.5, 0.62, 0.5],
        [0.5, 0.5, 0.5, 0.62],
        [0.3, 0.7, 0.72, 0.74],
        [0.74, 0.72, 0.7, 0.3],
    ],
)
def test_every_knot_bears_the_slopes_on_either_side(P):
    """Of one number P: |dP/dt| times M F^-1 M' at each knot. F is least where P is 0.74, far from the steep
    slope."""
    one, knots, P = scalar(0.5, 0.1), np.array([1.0, 1.5, 2.5, 3.0]), np.array(P)
    slopes, rates = np.diff(P) / np.diff(knots), []
    for k, p in enumerate(P):
        F = np.array([[p - 0.25 * p - 0.01, -0.5 * p], [-0.5 * p, 1 - p]])
        M = np.array([0.5, 1.0])
        rates += [1 / (TS * abs(s) * (M @ np.linalg.solve(F, M))) for s in slopes[max(k - 1, 0) : k + 1] if s]
    storage = lpv.Storage(np.eye(1), knots, P[:, None, None])
    with np.errstate(divide="ignore"):
        assert lpv._rate_at_knots(one, storage) == pytest.approx(min(rates))


def scalar(a: float, gain: float) -> lpv.Family:
    """x+ = a x + w, z = gain x, the same at every speed."""
    C = np.array([[gain], [1.0], [0.0]])
    G = StateSpace(np.array([[a]]), np.array([[1.0]]), C, np.array([[0.0], [0.0], [1.0]]), TS)
    return lpv.Family(lambda v: G, NODES, slice(0, 1), 2, lambda low, high: (np.zeros((1, 2)),) * 2, TS)


def test_of_a_loop_that_does_not_change_the_proof_is_one_eigenvalue():
    one, P = scalar(0.5, 0.4), 0.6
    storage = lpv.Storage(np.eye(1), NODES, np.full((3, 1, 1), P))
    proof = lpv.prove(one, storage, 3.0)
    F = np.array([[P - 0.25 * P - 0.16, -0.5 * P], [-0.5 * P, 1 - P]])
    assert proof.cells == 2 * lpv.FIRST_CELLS
    assert proof.margin == pytest.approx(np.linalg.eigvalsh(F)[0] / P, rel=1e-9)
    # In another coordinate it is the same function.
    scaled = lpv.Storage(np.array([[4.0]]), NODES, np.full((3, 1, 1), 16 * P))
    assert lpv.prove(one, scaled, 3.0) is not None
    assert lpv.prove(one, lpv.Storage(np.eye(1), NODES, np.full((3, 1, 1), -P)), 3.0) is None
    assert lpv.prove(one, lpv.Storage(np.eye(1), NODES, np.full((3, 1, 1), 1.01)), 3.0) is None


@pytest.mark.parametrize("share", [0.98, 1.02])
def test_a_storage_that_rises_with_speed_is_proved_up_to_the_rate_that_it_bears(share):
    """With P(v) = p + s v, F(v, v + d) is linear in v and in d: its worst is at a corner of the range."""
    one, p, s = scalar(0.5, 0.4), 0.5, 0.05
    storage = lpv.Storage(np.eye(1), NODES, (p + s * NODES)[:, None, None])

    def least(rate):
        out = np.inf
        for v in NODES:
            for d in (-rate * TS, rate * TS):
                P, Q = p + s * v, p + s * (v + d)
                out = min(out, np.linalg.eigvalsh([[P - 0.25 * Q - 0.16, -0.5 * Q], [-0.5 * Q, 1 - Q]])[0])
        return out

    low, high = 0.0, 200.0
    for _ in range(60):
        low, high = ((low + high) / 2, high) if least((low + high) / 2) > 0 else (low, (low + high) / 2)
    assert 1.0 < low < 100.0
    assert (lpv.prove(one, storage, share * low) is not None) == (share < 1)


@pytest.mark.parametrize(("beyond", "holds"), [(0.53, True), (0.6, False)])
def test_a_slope_that_no_speed_of_a_cell_reaches_is_not_asked_of_it(beyond, holds):
    """At one speed P(v+) has to be below (P - 0.16) / (P + 0.09): 0.576 at the knot, where P is 0.5. The
    slope after it for a whole step, to 0.56, is too much at 1.5 m/s, which is 5 steps away. What is reached
    from the knot is what P rises to, and that alone decides."""
    knots = np.array([1.0, 2.0, 2.05, 3.0])
    storage = lpv.Storage(np.eye(1), knots, np.array([0.63, 0.5, beyond, beyond])[:, None, None])
    step = 0.1
    slope = (0.53 - 0.5) / 0.05
    assert storage.at(1.5)[0, 0] + slope * step > (0.565 - 0.16) / (0.565 + 0.09)
    assert (lpv.prove(scalar(0.5, 0.4), storage, step / TS) is not None) == holds


def roomy() -> tuple[lpv.Family, lpv.Storage]:
    """A loop and a storage function, one segment long, for which F is far from 0; in skew coordinates."""
    basis, turn = np.array([[2.0, 0.5], [0.0, 1.0]]), np.array([[1.0, 0.2], [0.2, -0.5]])
    P = [basis.T @ (0.5 * np.eye(2) + side * 0.03 * turn) @ basis for side in (-1.0, 1.0)]
    return family(gain=0.1, bend=0.5), lpv.Storage(basis, np.array([1.0, 3.0]), np.array(P))


@pytest.mark.parametrize(
    ("low", "high", "rate"), [(1.7, 2.0, 0.4), (2.2, 3.0, 0.1), (1.9, 2.1, 1.0), (1.6, 2.4, 0.0)]
)
def test_what_a_cell_proves_holds_at_every_speed_in_it(low, high, rate):
    one, storage = roomy()
    ends = [lpv._End.at_speed(one, storage, v) for v in (low, high)]
    slack = lpv._cell_slack(one, storage, *ends, rate)
    assert slack is not None and slack > 0
    seen = []
    for v in np.linspace(low, high, 41):
        for d in np.linspace(-rate * TS, rate * TS, 5):
            seen.append(np.linalg.eigvalsh(dissipated(one, storage, v, v + d))[0])
    assert slack <= min(seen) + 1e-12


def test_the_remainder_of_a_cell_falls_as_its_width_squared():
    """So cells half as wide lose a quarter: slope and curvature are weighed each by itself."""
    one, storage = roomy()
    losses = []
    for width in (0.1, 0.05, 0.025, 0.0125):
        low, high = 2.4 - width / 2, 2.4 + width / 2
        slack = lpv._cell_slack(one, storage, *(lpv._End.at_speed(one, storage, v) for v in (low, high)), 0.0)
        least = min(np.linalg.eigvalsh(dissipated(one, storage, v, v))[0] for v in (low, high))
        losses.append(least - slack)
    ratios = np.array(losses[:-1]) / losses[1:]
    np.testing.assert_allclose(ratios, 4.0, rtol=0.05)


# ---------------------------------------------------------------- the family


def test_the_adjoint_loop_is_the_transposed_one_and_neither_has_probes():
    one = family()
    G, loop = one.at(1.7), one.loop(1.7)
    adjoint = replace(one, adjoint=True).loop(1.7)
    for part in "ABCD":
        whole = getattr(G, part)[:1] if part in "CD" else getattr(G, part)
        np.testing.assert_array_equal(getattr(loop, part), whole)
    for part, other in zip("ABCD", "ACBD", strict=True):
        np.testing.assert_array_equal(getattr(adjoint, part), getattr(loop, other).T)
    assert loop.dt == adjoint.dt == TS
    wide = StateSpace([[0.5]], [[1.0, 2.0]], [[1.0], [3.0]], [[0.1, 0.2], [0.0, 1.0]], TS)
    assert replace(one, n_probes=1, adjoint=True).unprobed(wide).D.tolist() == [[0.1], [0.2]]


def web(vehicle: bool = True, hears=lambda v: v > 2.9) -> lpv.Family:
    """Seven states: a filter of w_0 only (0), one that moves it but is not entered (1), the vehicle (2, 3),
    of which 3 is read, one that reads the vehicle where it ``hears`` it alone (4), what z_1 reads of it (5),
    and one by itself with w_1 (6). All by negative entries. Probes: states 2 and 3, and what enters, -w_0."""

    def at(v):
        A = np.zeros((7, 7))
        A[0, 1], A[2, 0], A[3, 2], A[5, 4] = -0.1, -0.2 * vehicle, -0.3, -0.4
        A[4, 3] = -0.5 * hears(v)
        B = np.zeros((7, 2))
        B[0, 0], B[6, 1] = -1.0, -1.0
        C = np.zeros((5, 7))
        C[0, 3], C[1, 5], C[2, 2], C[3, 3] = -1.0, -1.0, 1.0, 1.0
        D = np.zeros((5, 2))
        D[4, 0] = -0.7 * vehicle
        return StateSpace(A, B, C, D, TS)

    def bounds(low, high):
        first = np.arange(6.0).reshape(2, 3)
        return first + low, first + high

    return lpv.Family(at, NODES, slice(2, 4), 3, bounds, TS)


@pytest.mark.parametrize(
    ("rows", "columns", "kept"),
    [
        (slice(0, 1), slice(0, 1), [0, 2, 3]),
        (slice(1, 2), slice(0, 1), [0, 2, 3, 4, 5]),
        (slice(0, 2), slice(0, 2), [0, 2, 3, 4, 5]),
        (slice(0, 2), slice(1, 2), []),
    ],
)
def test_the_states_that_are_kept_are_both_entered_and_read_at_some_speed(rows, columns, kept):
    one = web()
    relevant = lpv.relevant(one, rows, columns)
    for v in (1.0, 2.4, 3.0):
        G, part = one.at(v), relevant.at(v)
        outputs = [*range(2)[rows], 2, 3, 4]
        np.testing.assert_array_equal(part.A, G.A[np.ix_(kept, kept)])
        np.testing.assert_array_equal(part.B, G.B[kept][:, columns])
        np.testing.assert_array_equal(part.C, G.C[np.ix_(outputs, kept)])
        np.testing.assert_array_equal(part.D, G.D[outputs][:, columns])
        assert part.dt == TS
    assert relevant.vehicle == (slice(1, 3) if kept else slice(0, 0))
    first, second = relevant.hold_bounds(1.0, 2.0)
    whole = one.hold_bounds(1.0, 2.0)
    for part, bound in ((first, whole[0]), (second, whole[1])):
        np.testing.assert_array_equal(part, bound if kept else bound[:0])
    assert (relevant.nodes, relevant.n_probes, relevant.Ts, relevant.adjoint) == (one.nodes, 3, TS, False)


def test_states_are_looked_for_half_way_between_the_nodes_too():
    one = web(hears=lambda v: abs(v - 2.5) < 0.1)
    assert lpv.relevant(one, slice(1, 2), slice(0, 1)).at(1.0).order == 5


def test_the_vehicle_counts_as_moved_by_all_that_its_probes_see():
    """Also by what enters it through a probe alone; its rows are no chord between two speeds."""
    one = web()
    assert lpv.relevant(one, slice(0, 1), slice(0, 1)).at(1.0).order == 3

    def unmoved(v):
        G = one.at(v)
        A, D = G.A.copy(), G.D.copy()
        A[2, 0] = A[3, 2] = 0.0
        return StateSpace(A, G.B, G.C, D, TS)

    still = replace(one, at=unmoved)
    np.testing.assert_array_equal(
        lpv.relevant(still, slice(0, 1), slice(0, 1)).at(1.0).C[1:], [[1, 0], [0, 1], [0, 0]]
    )

    def deaf(v):
        G = unmoved(v)
        return StateSpace(G.A, G.B, G.C, 0 * G.D, TS)

    assert lpv.relevant(replace(one, at=deaf), slice(0, 1), slice(0, 1)).at(1.0).order == 0

    def entered(v):
        G = deaf(v)
        return StateSpace(G.A, G.B - np.eye(7, 2, -2), G.C, G.D, TS)

    assert lpv.relevant(replace(one, at=entered), slice(0, 1), slice(0, 1)).at(1.0).order == 2

    def one_part(v):
        G = unmoved(v)
        C = G.C.copy()
        C[2, 2], C[2, 0] = 0.0, -1.0
        return StateSpace(G.A, G.B, C, 0 * G.D, TS)

    part = lpv.relevant(replace(one, at=one_part), slice(0, 1), slice(0, 1))
    assert part.vehicle == slice(1, 2), "the filter moves the vehicle through its probe"
    np.testing.assert_array_equal(part.hold_bounds(1.0, 2.0)[0], [[4.0, 5.0, 6.0]])


# ---------------------------------------------------------------- cells


ULP = np.spacing(1.375)


@pytest.mark.parametrize(("before", "all_reach"), [(3, True), (4, False)])
def test_a_speed_four_ulp_from_a_cells_end_says_which_segment_is_reached(before, all_reach):
    """From 1.375 a step of 0.125 reaches the knot at 1.5. P there is a pair where all reach it."""
    pairs = uneven().afterwards(1.375 - before * ULP, 1.45, 0.125)
    assert len(pairs) == 3 and any(one is two for one, two in pairs) == all_reach


@pytest.mark.parametrize(("beyond", "pairs"), [(4, 2), (5, 3)])
def test_a_speed_four_ulp_from_a_cells_upper_end_says_so_too(beyond, pairs):
    """A knot that some speeds reach and some do not takes a slope more."""
    assert len(uneven().afterwards(1.3, 1.375 + beyond * ULP, 0.125)) == pairs


@pytest.mark.parametrize(("inside", "cut"), [(4, False), (5, True)])
def test_a_cell_is_cut_at_a_bend_more_than_four_ulp_inside(inside, cut):
    """The bend at 1.375 = 1.5 - 0.125."""
    low = 1.375 - inside * ULP
    assert (uneven().cut(low, 1.45, 0.125) == 1.375) == cut
    high = 1.375 + inside * ULP
    assert (uneven().cut(1.3, high, 0.125) == 1.375) == cut


@pytest.fixture
def celled(monkeypatch):
    """`prove` of a storage with cells of scripted slack: the proof, and the cells that were asked."""

    def run(slack, P=(1.0, 2.0), nodes=(1.0, 2.0), adjoint=False, **limits):
        asked, made, cuts = [], [], []
        knots = np.array([1.0, 2.0])
        storage = lpv.Storage(
            np.eye(2), knots, np.array([np.diag(p * np.array([1.0, 3.0])) for p in P]), adjoint
        )
        for name, value in limits.items():
            monkeypatch.setattr(lpv, name, value)

        def end(one, one_storage, v):
            assert one.adjoint == adjoint and one_storage is storage
            made.append(v)
            return SimpleNamespace(v=v)

        def cell(one, one_storage, low, high, rate):
            asked.append((low.v, high.v))
            return slack(low.v, high.v)

        def cut(self, low, high, step):
            cuts.append(step)
            return 0.5 * (low + high)

        monkeypatch.setattr(lpv._End, "at_speed", end)
        monkeypatch.setattr(lpv, "_cell_slack", cell)
        monkeypatch.setattr(lpv.Storage, "cut", cut)
        proof = lpv.prove(replace(family(), nodes=np.array(nodes)), storage, 3.0)
        assert len(set(made)) == len(made), "each end once"
        assert set(cuts) <= {3.0 * TS}
        return proof, asked

    return run


def test_cells_that_fail_are_halved_until_all_hold(celled):
    proof, asked = celled(lambda low, high: None if high - low > 0.2 else low, adjoint=True)
    assert proof.cells == 8 and len(asked) == 2 + 4 + 8
    assert proof.margin == pytest.approx(1.0 / 3.0), "the mean of P has the trace 6 for two states"
    assert sorted(asked)[0] == (1.0, 1.125)
    assert sorted((low, high) for low, high in asked if high - low < 0.2) == [
        (1 + k / 8, 1 + (k + 1) / 8) for k in range(8)
    ]
    proof, asked = celled(lambda low, high: 0.3, nodes=(1.0, 1.6, 2.0))
    assert proof == lpv.Proof(4, pytest.approx(0.1)) and sorted(asked)[1] == (1.3, 1.6)


def test_a_proof_is_given_up_in_cells_that_are_too_small_or_too_many(celled):
    """None of them holds, or only the last."""
    proof, asked = celled(lambda low, high: None)
    assert proof is None and len(asked) == 10 and asked[-1][1] - asked[-1][0] == 0.5**10
    assert len(celled(lambda low, high: None, SMALLEST_CELL=0.125)[1]) == 4
    proof, asked = celled(lambda low, high: None, SMALLEST_CELL=1e-9, MOST_CELLS=5)
    assert proof is None and len(asked) == 6
    proof, asked = celled(lambda low, high: 1.0 if low == 1.5 else None, SMALLEST_CELL=1e-9, MOST_CELLS=5)
    assert proof is None and len(asked) == 7
    proof, asked = celled(lambda low, high: 1.0 if high - low < 0.1 else None, MOST_CELLS=16)
    assert proof.cells == 16


@pytest.mark.parametrize("P", [(1.0, 0.0), (-1.0, 1.0), (1.0, np.array([-1.0, 1.0]))])
def test_a_storage_function_is_positive_at_every_knot(P, celled):
    assert celled(lambda low, high: 1.0, P=P) == (None, [])


def of_vehicle(v: float) -> np.ndarray:
    """Xi(v) of `two_outputs`, (2, 3)."""
    d = v - 2.0
    return np.array([[0.6, 0.2, 0.0], [-0.3 - 0.05 * d**2, 0.4 + 0.06 * d, 0.8]])


def two_outputs() -> tuple[lpv.Family, lpv.Storage]:
    """A vehicle of two states and a controller of one, with two outputs. The probes move with the speed.

    P has entries below 0, and F is far from 0. The bounds are larger than they have to be.
    """

    def at(v):
        d = v - 2.0
        probes = np.array([[1.0, 0.1 * d, 0.0, 0.0], [0.2, 1.0, 0.0, 0.0], [-0.1, 0.2 * d, 0.3, 1.0]])
        AB = np.vstack([of_vehicle(v) @ probes, [0.1, -0.1, 0.3, 0.2]])
        CD = np.vstack([[0.1, 0.0, 0.0, 0.0], [0.0, 0.05, 0.02, 0.02], probes])
        return StateSpace(AB[:, :3], AB[:, 3:], CD[:, :3], CD[:, 3:], TS)

    def bounds(low, high):
        d = max(abs(low - 2.0), abs(high - 2.0))
        first = np.array([[0.15, 0.05, 0.1], [0.2, 0.25, 0.05]])
        second = np.array([[0.5, 0.1, 0.25], [0.3, 0.15, 0.2]])
        return first + 0.1 * d, second

    basis = np.array([[2.0, -0.5, 0.2], [0.0, 1.0, 0.3], [0.1, 0.0, 1.5]])
    turn = np.array([[1.0, 0.4, -0.6], [0.4, -0.5, 0.3], [-0.6, 0.3, 0.2]])
    P = [basis.T @ (0.5 * np.eye(3) + side * 0.03 * turn) @ basis for side in (-1.0, 1.0)]
    one = lpv.Family(at, NODES, slice(0, 2), 3, bounds, TS)
    return one, lpv.Storage(basis, np.array([1.0, 3.0]), np.array(P))


@pytest.mark.parametrize("adjoint", [False, True])
def test_an_end_holds_the_loop_and_p_in_the_coordinates_and_their_sizes(adjoint):
    one, storage = two_outputs()
    end = lpv._End.at_speed(replace(one, adjoint=adjoint), storage, 1.7)
    G, T = one.at(1.7), storage.basis
    A, B, C, D = (
        (part.T for part in (G.A, G.C[:2], G.B, G.D[:2])) if adjoint else (G.A, G.B, G.C[:2], G.D[:2])
    )
    np.testing.assert_allclose(end.S[:3], np.linalg.solve(T, np.hstack([A @ T, B])), atol=1e-14)
    np.testing.assert_allclose(end.S[3:], np.hstack([C @ T, D]), atol=1e-14)
    np.testing.assert_allclose(end.P, storage.at(1.7))
    assert end.v == 1.7
    assert end.sizes == pytest.approx(
        (max(np.abs(row).sum() for row in end.P), np.linalg.svd(end.S)[1].max() ** 2)
    )


@pytest.mark.parametrize("adjoint", [False, True])
def test_the_vehicles_share_of_the_loop_is_what_changes_with_speed(adjoint):
    one, storage = two_outputs()
    one = replace(one, adjoint=adjoint)
    still = []
    for v in (1.2, 2.9):
        end, Xi = lpv._End.at_speed(one, storage, v), of_vehicle(v)
        still.append(end.S - end.left @ (Xi.T if adjoint else Xi) @ end.right)
    np.testing.assert_allclose(still[1], still[0], atol=1e-14)


def crossed(reached, bound, right, inverse):
    """Of every entry of bound its two squares by the root of their costs' ratio, one by one."""
    out = np.zeros_like(inverse)
    for a in range(bound.shape[0]):
        for b in range(bound.shape[1]):
            X, r = sum(np.outer(x[:, a], x[:, a]) for x in reached), np.outer(right[b], right[b])
            x_cost, r_cost = np.sum(inverse * X), np.sum(inverse * r)
            if x_cost > 0 and r_cost > 0:
                eta = np.sqrt(r_cost / x_cost)
                out += bound[a, b] * (eta * X + r / eta)
    return out


def test_products_are_weighed_one_by_one_and_those_with_nothing_left_out():
    random = np.random.default_rng(6)
    inverse, bound = spd(random, 4), random.uniform(0.1, 1.0, (3, 2))
    reached = [random.standard_normal((4, 3)) for _ in range(2)]
    right = random.standard_normal((2, 4))
    right[0] *= 1e-3
    for x in reached:
        x[:, 0] *= 1e-3
    np.testing.assert_allclose(
        lpv._crossed(reached, bound, right, inverse), crossed(reached, bound, right, inverse), rtol=1e-10
    )
    for x in reached:
        x[:, 1] = 0.0
    reached[0][:, 2] = 0.0
    right[1] = right[0, 0] = reached[0][0, 0] = reached[1][0, 0] = 0.0
    bounds = lpv._crossed(reached, bound, right, inverse)
    assert np.isfinite(bounds).all()
    np.testing.assert_allclose(bounds, crossed(reached, bound, right, inverse), rtol=1e-10)


def test_a_part_too_small_to_be_squared_is_weighed_as_one_of_size_one():
    one = np.ones((1, 1))
    assert lpv._crossed([1e-200 * one], 3 * one, 2 * one, one) == 3 / 2 * 4
    assert lpv._crossed([2 * one], 3 * one, 1e-200 * one, one) == 3 / 2 * 4


@pytest.mark.parametrize("adjoint", [False, True])
@pytest.mark.parametrize(("low", "high", "rate"), [(1.8, 1.85, 0.4), (2.2, 2.23, 0.1), (1.98, 2.02, 1.0)])
def test_a_cells_slack_is_f_less_what_its_chords_may_lose(low, high, rate, adjoint, monkeypatch):
    """By hand, with rounding that is seen beside the rest."""
    monkeypatch.setattr(lpv, "EPS", 1e-5)
    one, storage = two_outputs()
    one = replace(one, adjoint=adjoint)
    if adjoint:
        storage = replace(storage, P=10 * storage.P)
    ends = [lpv._End.at_speed(one, storage, v) for v in (low, high)]
    first, second = one.hold_bounds(low, high)
    width, n = high - low, 3
    bound = np.hstack([width**2 / 8 * second, width**2 / 8 * second, width / 4 * first])
    S = [end.S for end in ends]
    if adjoint:
        bound, right = bound.T, ends[0].right
        left = np.hstack([ends[0].left, ends[1].left, ends[1].left - ends[0].left])
    else:
        left = ends[0].left
        right = np.vstack([ends[0].right, ends[1].right, ends[1].right - ends[0].right])
    slacks = []
    for after in storage.afterwards(low, high, rate * TS):
        Q = [sl.block_diag(P, np.eye(len(S[0]) - n)) for P in after]
        F = [
            sl.block_diag(end.P, np.eye(S[0].shape[1] - n)) - end.S.T @ q @ end.S
            for end, q in zip(ends, Q, strict=True)
        ]
        inverse, turned = np.linalg.inv(F[0] + F[1]), after[1] - after[0]
        dP, dM = sl.sqrtm(turned @ turned).real, S[1][:n] - S[0][:n]
        X, Y = dM.T @ dP @ dM, S[0][:n].T @ dP @ S[0][:n] + S[1][:n].T @ dP @ S[1][:n]
        x, y = np.sum(inverse * X), np.sum(inverse * Y)
        eta = np.sqrt(y / x) if x > 0 and y > 0 else 1.0
        lost = 0.25 * (eta * X + Y / eta)
        lost = lost + crossed([s.T @ q @ left for s in S for q in Q], bound, right, inverse)
        size = sum(np.abs(left.T @ q @ left) for q in Q)
        pressed = bound.T @ size @ bound
        lost = lost + right.T @ np.diag(pressed.sum(axis=1)) @ right
        for end, f, q in zip(ends, F, Q, strict=True):
            on_P = np.abs(end.P).sum(axis=1).max()
            on_Q = np.linalg.norm(end.S, 2) ** 2 * np.abs(q).sum(axis=1).max()
            by_rounding = 4 * len(f) * (on_P + on_Q)
            slacks.append((np.linalg.eigvalsh(f - lost)[0] - 1e-5 * by_rounding, by_rounding))
    slack = lpv._cell_slack(one, storage, *ends, rate)
    least, by_rounding = min(slacks)
    assert least > 0 and slack == pytest.approx(least, rel=1e-9)
    monkeypatch.setattr(lpv, "EPS", 1e-5 + (least + 0.01) / by_rounding)
    assert lpv._cell_slack(one, storage, *ends, rate) is None, "0.01 below 0"


def test_no_slack_is_left_at_zero(monkeypatch):
    one, storage = two_outputs()
    ends = [lpv._End.at_speed(one, storage, v) for v in (1.9, 2.0)]
    monkeypatch.setattr(lpv, "EPS", 0.0)
    monkeypatch.setattr(np.linalg, "eigvalsh", lambda X: np.zeros(len(X)))
    assert lpv._cell_slack(one, storage, *ends, 0.1) is None


def test_what_is_dissipated_is_symmetric_to_the_last_digit():
    one, storage = two_outputs()
    end = lpv._End.at_speed(one, storage, 1.7)
    Q = spd(np.random.default_rng(3), 5)
    assert (end.S.T @ Q @ end.S != (end.S.T @ Q @ end.S).T).any()
    F = lpv._dissipation(end, Q, np.eye(3, 4))
    np.testing.assert_array_equal(F, F.T)
    np.testing.assert_allclose(F, sl.block_diag(end.P, np.eye(1)) - end.S.T @ Q @ end.S, atol=1e-12)


@pytest.mark.parametrize(("after", "holds"), [(0.1, True), (-0.1, False), (0.0, False)])
def test_no_slack_is_left_where_p_after_a_step_is_not_positive(after, holds, monkeypatch):
    """F is the larger for it, and proves nothing."""
    storage = lpv.Storage(np.eye(1), NODES, np.ones((3, 1, 1)))
    monkeypatch.setattr(lpv.Storage, "afterwards", lambda *_: [(np.full((1, 1), after),) * 2])
    one = scalar(0.5, 0.1)
    ends = [lpv._End.at_speed(one, storage, v) for v in (1.85, 1.95)]
    assert (lpv._cell_slack(one, storage, *ends, 1.0) is not None) == holds


# ---------------------------------------------------------------- frozen solutions


def test_a_loop_on_the_border_of_stability_has_no_frozen_solutions(monkeypatch):
    def never(loops):
        raise AssertionError("asked")

    monkeypatch.setattr(lpv, "_coordinates", never)
    for margins in ((0.0, 0.5), (0.5, 0.0), (0.5, -0.5)):
        one = SimpleNamespace(
            loop=lambda v, margin_at=margins: SimpleNamespace(stability_margin=lambda: margin_at[v])
        )
        assert lpv.frozen_at(one, np.arange(2)) is None


def test_a_storage_of_frozen_solutions_is_of_the_loop_that_was_asked():
    for adjoint in (False, True):
        one = replace(family(), adjoint=adjoint)
        storage = lpv.riccati_storage(one)
        assert storage.adjoint == adjoint and len(storage.knots) == 2 * lpv.KNOTS + 1
        assert lpv.polynomial_storage(one, np.eye(2), np.zeros((3, 2, 2))).adjoint == adjoint
    assert lpv.riccati_storage(family(gain=9.0)) is None


@pytest.fixture
def norms(monkeypatch):
    """Norms of the loops with extra inputs and outputs: below 1 where the extra is less than ``bears``."""

    def set_(bears, value=2.0):
        asked = []

        def hinf_norm(G, rtol):
            slack = G.B[0, -2] ** 2
            asked.append((G, rtol))
            return SimpleNamespace(upper=0.5 if slack < bears else value)

        monkeypatch.setattr(lpv, "hinf_norm", hinf_norm)
        return asked

    return set_


PARTS = [
    (np.array([[0.5, 0.1, 1.0], [0.0, 0.4, 0.2]]), np.array([[0.3, 0.1, 0.2], [0.0, 0.1, 0.1]])),
    (np.array([[0.6, 0.0, 0.7], [0.1, 0.3, 0.1]]), np.array([[0.2, 0.2, 0.1], [0.1, 0.0, 0.2]])),
]


@pytest.mark.parametrize(("bears", "slack"), [(1.0, 3e-4), (2e-4, 1e-4), (2e-6, 1e-6)])
def test_frozen_solutions_have_the_largest_slack_that_every_speed_bears(bears, slack, norms):
    asked = norms(bears)
    solutions = lpv._frozen(PARTS, TS)
    for P, (M, N), (G, rtol) in zip(solutions, PARTS, asked[-2:], strict=True):
        extra = np.sqrt(slack) * np.eye(2)
        A, B, C = M[:, :2], np.hstack([M[:, 2:], extra]), np.vstack([N[:, :2], extra])
        D = sl.block_diag(N[:, 2:], np.zeros((2, 2)))
        for part, wanted in zip("ABCD", (A, B, C, D), strict=True):
            np.testing.assert_allclose(getattr(G, part), wanted)
        assert G.dt == TS and rtol == 1e-3
        over = A.T @ P @ B + C.T @ D
        inside = np.eye(3) - D.T @ D - B.T @ P @ B
        np.testing.assert_allclose(
            P, A.T @ P @ A + C.T @ C + over @ np.linalg.solve(inside, over.T), atol=1e-10
        )
        assert np.linalg.eigvalsh(inside)[0] > 0 and (P == P.T).all()


def test_without_a_norm_below_one_or_a_solution_nothing_is_frozen(norms, monkeypatch):
    asked = norms(0.0, value=1.0)
    assert lpv._frozen(PARTS, TS) is None and len(asked) == len(lpv.SLACKS)
    norms(1.0)
    options = []

    def solve(*args, **options_given):
        options.append(options_given["balanced"])
        raise next(errors)

    monkeypatch.setattr(lpv.sl, "solve_discrete_are", solve)
    errors = iter([np.linalg.LinAlgError, ValueError] * 3)
    assert lpv._frozen(PARTS, TS) is None and options == [False] * len(lpv.SLACKS)
    monkeypatch.setattr(lpv.sl, "solve_discrete_are", lambda *_, **__: np.array([[1.0, 4.0], [0.0, 3.0]]))
    np.testing.assert_array_equal(lpv._frozen(PARTS, TS), [[[1.0, 2.0], [2.0, 3.0]]] * 2)


# ---------------------------------------------------------------- coordinates


def test_a_gramian_sums_a_million_steps():
    a = 1 - 1e-7
    L = lpv._reached(np.array([[a]]), np.array([[2.0]]))
    wanted = 4 * -np.expm1(2 * 2.0**lpv.DOUBLINGS * np.log(a)) / (1 - a**2)
    assert L[0, 0] ** 2 == pytest.approx(wanted, rel=1e-6)


@pytest.mark.parametrize("width", [1, 3, 7])
def test_rows_are_told_by_as_many_columns(width):
    X = np.random.default_rng(5).standard_normal((3, width))
    L = lpv._rows(X)
    assert L.shape == (3, 3)
    np.testing.assert_allclose(L @ L.T, X @ X.T, atol=1e-12)


@pytest.mark.parametrize(("entered", "read"), [(0.0, 0.0), (1.0, 0.0), (0.0, 1.0)])
def test_a_state_that_is_not_both_entered_and_read_keeps_its_unit(entered, read):
    G = StateSpace(np.diag([0.5, 0.3]), [[1.0], [entered]], [[1.0, read]], [[0.0]], TS)
    T = lpv._coordinates([G])
    assert np.isfinite(T).all() and np.linalg.cond(T) < 1e9
    if entered == read == 0.0:
        np.testing.assert_allclose(np.abs(T[1]), [0.0, 1.0], atol=1e-12)
    else:
        reach = sl.solve_discrete_lyapunov(G.A, G.B @ G.B.T)
        seen = sl.solve_discrete_lyapunov(G.A.T, G.C.T @ G.C)
        hidden = lpv.HIDDEN * np.eye(2)
        inverse = np.linalg.inv(T)
        balanced = inverse @ (reach + hidden * reach.diagonal().max()) @ inverse.T
        other = T.T @ (seen + hidden * seen.diagonal().max()) @ T
        np.testing.assert_allclose(balanced, other, rtol=1e-3, atol=1e-9 * balanced.max())


# ---------------------------------------------------------------- the search


@pytest.fixture
def searched(monkeypatch):
    """`_on_grid` where a storage function is found up to the rate ``found`` and proved at the rates
    ``proved``: what it gives, the starts of the searches, and the proofs asked."""

    def run(largest, proved=(), start=True):
        tried, asked = [], []
        search = SimpleNamespace(
            fitted=lambda frozen: ("fitted", frozen),
            barrier=lambda rate: rate,
            coefficients=lambda P: ("coefficients", P),
        )

        def feasible(rate, P, unit):
            assert unit.tolist() == [4.0, 6.0]
            tried.append((rate, P))
            return rate if rate <= largest else None

        def prove(one, storage, rate):
            asked.append((storage[2][1], round(rate, 9)))
            return "proof" if round(rate, 9) in proved else None

        monkeypatch.setattr(
            lpv, "frozen_at", lambda one, grid: ("basis", "parts", "frozen") if start else None
        )
        monkeypatch.setattr(
            lpv,
            "StorageGrid",
            SimpleNamespace(from_parts=lambda Ts, grid, basis, parts: search if parts == "parts" else None),
        )
        F = SimpleNamespace(F=lambda frozen: np.array([[2.0, 5.0], [6.0, 7.0]]))
        monkeypatch.setattr(lpv, "unmoved", lambda parts: F)
        monkeypatch.setattr(lpv, "feasible", feasible)
        monkeypatch.setattr(lpv, "polynomial_storage", lambda *args: args)
        monkeypatch.setattr(lpv, "prove", prove)
        return lpv._on_grid(family(), NODES), tried, asked

    return run


def test_rates_are_searched_from_the_last_one_found_and_proved_from_the_largest(searched):
    one = ("fitted", "frozen")
    (there, certificate), tried, asked = searched(1.5, {0.7, 0.2375})
    assert tried == [(0.25, one), (1.0, 0.25), (4.0, 1.0), (2.0, 1.0)]
    assert asked == [(1.0, 0.95), (1.0, 0.7)] and there is True
    assert (certificate.rate, certificate.P, certificate.proof, certificate.not_found) == (
        0.7,
        ("coefficients", 1.0),
        "proof",
        2.0,
    )
    assert certificate.storage[1:] == ("basis", ("coefficients", 1.0)) and not certificate.own_knots
    (there, certificate), _, asked = searched(1.5, {0.175})
    assert there and certificate.rate == 0.25 * 0.7 and certificate.P == ("coefficients", 0.25)
    assert asked == [(1.0, 0.95), (1.0, 0.7), (1.0, 0.5), (0.25, 0.2375), (0.25, 0.175)]
    assert searched(99.0, {7.6})[0][1].not_found is None


def test_what_is_found_and_not_proved_is_told_from_what_is_not_found(searched):
    assert searched(1.5)[0] == (True, None)
    result, tried, asked = searched(0.0)
    assert result == (False, None) and not asked
    assert [rate for rate, _ in tried] == [0.25, 0.0625, 0.015625]
    assert searched(9.0, start=False) == ((False, None), [], [])


@pytest.mark.parametrize(
    ("answers", "wanted"),
    [
        ([(True, "one")], "one"),
        ([(True, None), (True, "two")], "two"),
        ([(True, None), (False, None)], None),
        ([(False, None)], None),
        ([(True, None)] * 3, None),
    ],
)
def test_grids_are_refined_while_what_is_found_is_not_proved(answers, wanted, monkeypatch):
    grids, answers = [], iter(answers)

    def on_grid(one, grid):
        grids.append(len(grid))
        return next(answers)

    monkeypatch.setattr(lpv, "_on_grid", on_grid)
    assert lpv._polynomial(family()) == wanted
    assert next(answers, None) is None and grids == [3, 5, 9][: len(grids)]


def test_frozen_solutions_are_proved_at_half_the_rate_of_the_knots(monkeypatch):
    asked = []

    def prove(one, storage, rate):
        asked.append((storage, rate))
        return answer

    monkeypatch.setattr(lpv, "riccati_storage", lambda one: storage)
    monkeypatch.setattr(lpv, "_rate_at_knots", lambda one, storage: 3.0)
    monkeypatch.setattr(lpv, "prove", prove)
    storage, answer = "storage", "proof"
    assert lpv._riccati(family()) == lpv.LpvCertificate(1.5, "storage", None, "proof", None)
    assert asked == [("storage", 1.5)]
    answer = None
    assert lpv._riccati(family()) is None
    storage = None
    assert lpv._riccati(family()) is None and len(asked) == 2


def test_the_adjoint_is_asked_first_and_polynomials_before_frozen_solutions(monkeypatch):
    asked = []

    def stub(name):
        def ask(one):
            asked.append((name, one.adjoint))
            return "found" if len(asked) == rank else None

        return ask

    monkeypatch.setattr(lpv, "_polynomial", stub("polynomial"))
    monkeypatch.setattr(lpv, "_riccati", stub("riccati"))
    order = [("polynomial", True), ("riccati", True), ("polynomial", False), ("riccati", False)]
    for rank in (1, 2, 3, 4, 5):
        asked.clear()
        assert lpv.find(family()) == ("found" if rank < 5 else None)
        assert asked == order[:rank]
