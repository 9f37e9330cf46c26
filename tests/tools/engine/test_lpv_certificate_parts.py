"""The pieces of the certificate at a moving speed, each against what defines it: norms, minima, identities of
Lyapunov and Riccati equations, and loops whose answer is known by hand."""

from __future__ import annotations

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
    knots = np.array([1.0, 1.5, 3.0, 4.0])
    storage = lpv.Storage(np.eye(2), knots, np.array([spd(random, 2) for _ in knots]))
    for v in (1.0, 1.2, 1.5, 2.75, 3.0, 3.9, 4.0):
        for i, j in ((0, 0), (0, 1), (1, 1)):
            assert storage.at(v)[i, j] == pytest.approx(np.interp(v, knots, storage.P[:, i, j]))
    for k, slope in enumerate(storage.slopes):
        np.testing.assert_allclose(slope, (storage.P[k + 1] - storage.P[k]) / (knots[k + 1] - knots[k]))
    # What lies beyond the last knots continues the outermost segments.
    np.testing.assert_allclose(storage.at(4.5), storage.P[3] + 0.5 * storage.slopes[2])
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
    found = uneven().afterwards(low, high, step)
    assert {tuple(round(float(x[0, 0]), 9) for x in pair) for pair in found} == {
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
    assert storage.cut(1.0, 1.5, 0.125) == 1.375
    assert storage.cut(3.5, 4.0, 0.125) == 3.75, "no speed lies beyond the last knot"


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
    zero = np.zeros((3, 3))
    np.testing.assert_array_equal(lpv._weighed(X, zero, inverse), X)
    np.testing.assert_array_equal(lpv._weighed(zero, Y, inverse), Y)


@pytest.mark.parametrize(
    ("found", "failed", "wanted"),
    [
        (None, None, 0.25),
        (None, 0.25, 0.0625),
        (None, 0.0625, 0.015625),
        (None, 0.015625, None),
        (None, 0.06, 0.015),
        (0.25, None, 1.0),
        (4.0, None, 8.0),
        (8.0, None, None),
        (1.0, 4.0, 2.0),
        (1.0, 2.25, 1.5),
        (1.0, 2.0, None),
        (1.0, 2.1, None),
    ],
)
def test_rates_go_by_fours_and_then_by_the_geometric_mean(found, failed, wanted):
    assert lpv._next_rate(found, failed) == (wanted and pytest.approx(wanted))


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
    ends = [lpv._End.of(one, storage, v) for v in (low, high)]
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
        slack = lpv._cell_slack(one, storage, *(lpv._End.of(one, storage, v) for v in (low, high)), 0.0)
        least = min(np.linalg.eigvalsh(dissipated(one, storage, v, v))[0] for v in (low, high))
        losses.append(least - slack)
    ratios = np.array(losses[:-1]) / losses[1:]
    np.testing.assert_allclose(ratios, 4.0, rtol=0.05)
