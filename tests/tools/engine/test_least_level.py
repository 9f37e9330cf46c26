"""A level of robust performance at a moving speed: above what any gain of D allows, proved anew, refused when
anything changes, and kept along random histories with any Delta."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.optimize import minimize_scalar

from lpvguard.engine.synthesis import least_level
from lpvguard.engine.synthesis import lpv_certificate as lpv
from lpvguard.engine.synthesis.dk import Scaling
from lpvguard.engine.synthesis.knot_search import KnotGrid
from lpvguard.engine.synthesis.norms import hinf_norm
from lpvguard.engine.synthesis.statespace import StateSpace
from oscillator import Oscillator

TS = 0.05
DELTA = (1, 1)
RATE = 0.2


def family(turn: float, performance: float = 1.2) -> lpv.Family:
    """An oscillator whose stiffness follows the speed, v in 1..3 m/s. xi and w are forces; eta is 0.35 of the
    position, z ``performance`` times the velocity."""

    vehicle = Oscillator(turn, TS)

    def at(v):
        hold = vehicle.hold(v)
        C = np.vstack([[0.35, 0.0], [0.0, performance], np.eye(2), [0.0, 0.0]])
        D = np.vstack([np.zeros((4, 2)), np.ones((1, 2))])
        return StateSpace(hold[:2, :2], np.repeat(hold[:2, 2:], 2, axis=1), C, D, TS)

    return lpv.Family(at, np.array([1.0, 1.5, 2.0, 2.5, 3.0]), slice(0, 2), 3, vehicle.bounds, TS)


def frozen_level(one: lpv.Family, v: float) -> float:
    """The least level of any gain at a frozen speed, by bisection on the least scaled norm."""

    def least(level: float) -> float:
        def norm(log: float) -> float:
            return hinf_norm(least_level.weighed(one, DELTA, level, np.exp(log)).loop(v), rtol=1e-6).upper

        return minimize_scalar(norm, bounds=(-4, 4), method="bounded", options={"xatol": 1e-6}).fun

    low, high = 0.1, 100.0
    while high > 1.0001 * low:
        middle = np.sqrt(low * high)
        low, high = (low, middle) if least(middle) < 1 else (middle, high)
    return high


@pytest.fixture(scope="module")
def moving():
    one = family(turn=0.2)
    return one, least_level.find_level(lambda _: one, DELTA, RATE)


def test_the_weights_stand_where_they_belong():
    one = family(turn=0.2)
    G, H = one.at(2.0), least_level.weighed(one, DELTA, level=4.0, gain=2.0).at(2.0)
    np.testing.assert_allclose(H.B, G.B * [0.5, 1.0])
    np.testing.assert_allclose(H.C, G.C * np.array([2.0, 0.25, 1.0, 1.0, 1.0])[:, None])
    np.testing.assert_allclose(H.D[2:], G.D[2:] * [0.5, 1.0])
    np.testing.assert_array_equal(H.A, G.A)


def test_no_gain_proves_a_level_below_the_frozen_one(moving):
    one, found = moving
    least = max(frozen_level(one, v) for v in (1.0, 2.0, 3.0))
    for gain in (0.5, 1.0, 2.0):
        below = least_level.weighed(one, DELTA, 0.99 * least, gain * found.gain)
        assert lpv.prove(below, found.storage, RATE) is None


def test_a_level_at_a_moving_speed_is_above_the_frozen_one_and_proved_anew(moving):
    one, found = moving
    assert found.level > max(frozen_level(one, v) for v in (1.0, 2.0, 3.0))
    assert found.rate == RATE and found.proof.margin > 0
    again = least_level.weighed(one, DELTA, found.level, found.gain)
    storage = found.storage
    assert found.own_knots and found.P is None and not storage.adjoint
    assert lpv.prove(again, storage, RATE) is not None
    assert lpv.prove(replace(again, Ts=20 * TS), storage, RATE) is None
    assert lpv.prove(least_level.weighed(one, DELTA, 0.5 * found.level, found.gain), storage, RATE) is None


def test_every_delta_keeps_the_level_along_random_speed_histories(moving):
    """Delta: constants, and all-passes that turn by a quarter at the resonance, where they take damping."""
    one, found = moving
    random, largest = np.random.default_rng(4), 0.0
    turn = np.tan(0.5 * 1.06 * TS)
    lag = (turn - 1) / (turn + 1)
    for size, a in ((-1.0, 1.0), (0.5, 1.0), (1.0, 1.0), (1.0, lag), (-1.0, lag)):
        for period in (10, 60, 200):
            x, v, energy_in, energy_out = np.zeros(2), 2.0, 0.0, 0.0
            phase, eta_before, xi = random.uniform(0, 2 * np.pi), 0.0, 0.0
            for k in range(3000):
                G = one.at(v)
                w, eta, z = np.sin(1.06 * TS * k + phase), G.C[0] @ x, G.C[1] @ x
                # (a + 1 / z) / (1 + a / z); a = 1 is a constant
                xi, eta_before = (eta if a == 1 else a * eta + eta_before - a * xi), eta
                energy_in, energy_out = energy_in + w * w, energy_out + z * z
                x = G.A @ x + G.B @ np.array([size * xi, w])
                v = np.clip(v + RATE * TS * np.sign(np.sin(2 * np.pi * k / period)), 1.0, 3.0)
            largest = max(largest, np.sqrt(energy_out / energy_in))
    assert 0.25 * found.level < largest < found.level


def test_there_is_no_level_for_a_loop_that_delta_makes_unstable():
    unstable = family(turn=0.2)

    def at(v):
        G = unstable.at(v)
        return replace(G, C=G.C * np.array([5.0, 1, 1, 1, 1])[:, None])

    assert least_level.find_level(lambda _: replace(unstable, at=at), DELTA, RATE) is None


@pytest.mark.parametrize(
    ("performance", "level"), [(0.5, 1.0), (1.2, 2.5), (2.0, 5.0), (4.0, 10.0), (40.0, None)]
)
def test_without_delta_the_level_is_the_first_that_leaves_room_above_the_norm(performance, level):
    """The norm is 1.67 ``performance``: 1 leaves room for 0.83, 2.5 for 2 and not for 3.3."""
    alone = lpv.relevant(family(turn=0.0, performance=performance), slice(1, 2), slice(1, 2))
    asked = []
    found = least_level.find_level(lambda level: asked.append(level) or alone, (0, 0), RATE)
    assert (found and (found.level, found.gain)) == (level and (level, 1.0))
    assert asked == [one for one in least_level.LEVELS if level is None or one <= level]
    norm = hinf_norm(alone.loop(2.0), rtol=1e-6).upper
    assert level is None or norm <= least_level.ROOMY * level


def test_a_level_whose_storage_function_is_not_proved_is_left_for_the_next(monkeypatch):
    """At level 1 the frozen gain leaves room; the proof fails there and holds at 2.5."""
    alone = lpv.relevant(family(turn=0.0, performance=0.5), slice(1, 2), slice(1, 2))
    proved, at = least_level.prove, []

    def none_at_first(one, storage, rate):
        at.append(one.at(2.0).C[0, 1])
        return None if at[-1] == 0.5 else proved(one, storage, rate)

    monkeypatch.setattr(least_level, "prove", none_at_first)
    found = least_level.find_level(lambda _: alone, (0, 0), RATE)
    assert found.level == 2.5 and at == [0.5, pytest.approx(0.2)]


def test_p_costs_more_the_further_it_is_from_the_frozen_solutions(monkeypatch):
    """Every search gets COST over their mean, in the coordinates in which it searches."""
    one, given, frozen = family(turn=0.2), [], []
    search, solved = least_level.found_at, least_level.frozen_at

    def told(family, speeds):
        frozen.append(solved(family, speeds))
        return frozen[-1]

    monkeypatch.setattr(least_level, "found_at", lambda *asked: given.append(asked) or search(*asked))
    monkeypatch.setattr(least_level, "frozen_at", told)
    assert least_level.find_level(lambda _: one, DELTA, RATE) is not None
    last = [asked for asked in given if asked[2] == 0.0][-1]
    basis, _, P = frozen[-1]
    for grid, *_ in given[given.index(last) :]:
        moved = np.linalg.solve(basis, grid.basis)
        mean = moved.T @ P.mean(axis=0) @ moved
        np.testing.assert_allclose(grid.cost @ mean, least_level.COST * np.eye(2), atol=1e-9)
    assert len(given) > least_level.RATE_STEPS


def test_knots_join_half_way_between_the_nodes_and_every_quarter_is_asked(moving, monkeypatch):
    """Up to a quarter of the rate the nodes are knots enough; after a proof that fails more is asked."""
    (one, found), given, proofs = moving, [], []
    search, proved = least_level.found_at, least_level.prove

    def none_at_first(*asked):
        proofs.append(asked)
        return proved(*asked) if len(proofs) > 1 else None

    monkeypatch.setattr(least_level, "found_at", lambda *asked: given.append(asked) or search(*asked))
    monkeypatch.setattr(least_level, "prove", none_at_first)
    monkeypatch.setattr(least_level, "LEVELS", (found.level,))
    monkeypatch.setattr(KnotGrid, "violated", lambda *_: np.array([1.01]))
    assert least_level.find_level(lambda _: one, DELTA, RATE).level == found.level
    rates = np.array([rate for _, _, rate, _ in given])
    np.testing.assert_allclose(
        rates * least_level.GRID_SHARE / RATE, [0, *2.0 ** np.arange(-5, 1), 1.0], rtol=1e-12
    )
    coarse, fine = one.nodes.tolist(), np.linspace(1.0, 3.0, 9).tolist()
    assert [grid.knots.tolist() for grid, *_ in given] == [coarse] * 5 + [fine] * 3
    asked = np.linspace(1.0, 3.0, 33).tolist()
    assert [grid.speeds.tolist() for grid, *_ in given] == [asked] * 7 + [sorted([*asked, 1.01])]


def test_d_is_tuned_from_the_best_start():
    """Whatever the order of the starts; from the worse one alone the search ends elsewhere."""
    pole = np.exp(-0.3 * TS)
    G = StateSpace(
        np.array([[pole]]),
        np.array([[0.0, 1 - pole]]),
        np.array([[1.0], [0.0]]),
        np.array([[0, 0], [0.2, 0]]),
        TS,
    )
    good, bad = Scaling(np.array([[-1.0, 0.0, 0.0]])), Scaling(np.array([[9.0, 5.0, -5.0]]))

    def found(*starts):
        return least_level.tuned([G], DELTA, 1.0, starts).log_parameters

    assert np.array_equal(found(bad, good), found(good)) and np.array_equal(found(good, bad), found(good))
    assert not np.array_equal(found(bad), found(good))


def test_the_shape_of_d_is_tuned_and_stays_where_blocks_are_not_scalar():
    """eta = lag w and z = 5 xi / 12: at level 2.5 the best d leaves the geometric mean of 1 and 1 / 6 at zero
    frequency."""
    pole = np.exp(-0.3 * TS)
    lag = StateSpace(np.array([[pole]]), np.array([[1 - pole]]), np.array([[1.0]]), np.zeros((1, 1)), TS)
    # [eta; z] = [0, lag; 5 / 12, 0] [xi; w]
    G = StateSpace(
        lag.A,
        np.hstack([0 * lag.B, lag.B]),
        np.vstack([lag.C, 0 * lag.C]),
        np.array([[0, 0], [5 / 12, 0]]),
        TS,
    )
    omega = np.geomspace(1e-3, 60, 200)

    def norm(scaling):
        d, M = np.exp(scaling.log_magnitude(omega))[0], G.response(omega)
        M[:, 1] /= 2.5
        M[:, 0] *= d[:, None]
        M[:, :, 0] /= d[:, None]
        return np.linalg.norm(M, 2, axis=(1, 2)).max()

    start = Scaling(np.zeros((1, 3)))
    found = least_level.tuned([G], DELTA, 2.5, [start])
    assert norm(start) == pytest.approx(1.0, rel=1e-3) and norm(found) < 1.1 * np.sqrt(1 / 6)
    assert least_level.tuned([G], (2, 1), 2.5, [start]) is start
