"""A level of robust performance at a moving speed: above what any gain of D allows, proved anew, refused when
anything changes, and kept along random histories with any Delta."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from scipy.optimize import minimize_scalar

from lpvguard.engine.synthesis import least_level
from lpvguard.engine.synthesis import lpv_certificate as lpv
from lpvguard.engine.synthesis.dk import Scaling
from lpvguard.engine.synthesis.knot_search import KnotGrid, Point
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
    direct = replace(one, at=lambda v: replace(one.at(v), D=np.ones((5, 2))))
    H = least_level.weighed(direct, DELTA, level=4.0, gain=2.0).at(2.0)
    np.testing.assert_allclose(H.D, [[1.0, 2.0], [0.125, 0.25], *[[0.5, 1.0]] * 3])
    np.testing.assert_array_equal(H.A, G.A)


@pytest.mark.unhurried
def test_no_gain_proves_a_level_below_the_frozen_one(moving):
    one, certificate = moving
    least = max(frozen_level(one, v) for v in (1.0, 2.0, 3.0))
    for gain in (0.5, 1.0, 2.0):
        below = least_level.weighed(one, DELTA, 0.99 * least, gain * certificate.gain)
        assert lpv.prove(below, certificate.storage, RATE) is None


@pytest.mark.unhurried
def test_a_level_at_a_moving_speed_is_above_the_frozen_one_and_proved_anew(moving):
    one, certificate = moving
    assert certificate.level > max(frozen_level(one, v) for v in (1.0, 2.0, 3.0))
    assert certificate.rate == RATE and certificate.proof.margin > 0
    again = least_level.weighed(one, DELTA, certificate.level, certificate.gain)
    storage = certificate.storage
    assert certificate.own_knots and certificate.P is None and not storage.adjoint
    assert lpv.prove(again, storage, RATE) is not None
    assert lpv.prove(replace(again, Ts=20 * TS), storage, RATE) is None
    assert (
        lpv.prove(least_level.weighed(one, DELTA, 0.5 * certificate.level, certificate.gain), storage, RATE)
        is None
    )


@pytest.mark.slow("8 s: random speed histories")
def test_every_delta_keeps_the_level_along_random_speed_histories(moving):
    """Delta: constants, and all-passes that turn by a quarter at the resonance, where they take damping."""
    one, certificate = moving
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
    assert 0.25 * certificate.level < largest < certificate.level


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
    certificate = least_level.find_level(lambda level: asked.append(level) or alone, (0, 0), RATE)
    assert (certificate and (certificate.level, certificate.gain)) == (level and (level, 1.0))
    assert asked == [one for one in least_level.LEVELS if level is None or one <= level]
    norm = hinf_norm(alone.loop(2.0), rtol=1e-6).upper
    assert level is None or norm <= least_level.ROOMY * level


@pytest.mark.unhurried
def test_a_level_whose_storage_function_is_not_proved_is_left_for_the_next(monkeypatch):
    """At level 1 the frozen gain leaves room; the proof fails there and holds at 2.5."""
    alone = lpv.relevant(family(turn=0.0, performance=0.5), slice(1, 2), slice(1, 2))
    proved, at = least_level.prove, []

    def none_at_first(one, storage, rate):
        at.append(one.at(2.0).C[0, 1])
        return None if at[-1] == 0.5 else proved(one, storage, rate)

    monkeypatch.setattr(least_level, "prove", none_at_first)
    certificate = least_level.find_level(lambda _: alone, (0, 0), RATE)
    assert certificate.level == 2.5 and at == [0.5, pytest.approx(0.2)]


def test_p_costs_more_the_further_it_is_from_the_frozen_solutions(monkeypatch):
    """Every search gets COST over their mean, in the coordinates in which it searches."""
    one, searches, frozen = family(turn=0.2), [], []
    search, solved = least_level.feasible_point, least_level.frozen_at

    def stub(family, speeds):
        frozen.append(solved(family, speeds))
        return frozen[-1]

    monkeypatch.setattr(
        least_level, "feasible_point", lambda *asked: searches.append(asked) or search(*asked)
    )
    monkeypatch.setattr(least_level, "frozen_at", stub)
    assert least_level.find_level(lambda _: one, DELTA, RATE) is not None
    last = [asked for asked in searches if asked[2] == 0.0][-1]
    basis, _, P = frozen[-1]
    for grid, *_ in searches[searches.index(last) :]:
        moved = np.linalg.solve(basis, grid.basis)
        mean = moved.T @ P.mean(axis=0) @ moved
        np.testing.assert_allclose(grid.cost @ mean, least_level.COST * np.eye(2), atol=1e-9)
    assert len(searches) > least_level.RATE_STEPS


def test_knots_join_half_way_between_the_nodes_and_every_quarter_is_asked(moving, monkeypatch):
    """Up to a quarter of the rate the nodes are knots enough; after a proof that fails more is asked."""
    (one, certificate), searches, proofs = moving, [], []
    search, proved = least_level.feasible_point, least_level.prove

    def none_at_first(*asked):
        proofs.append(asked)
        return proved(*asked) if len(proofs) > 1 else None

    monkeypatch.setattr(
        least_level, "feasible_point", lambda *asked: searches.append(asked) or search(*asked)
    )
    monkeypatch.setattr(least_level, "prove", none_at_first)
    monkeypatch.setattr(least_level, "LEVELS", (certificate.level,))
    monkeypatch.setattr(KnotGrid, "violated", lambda *_: np.array([1.01]))
    assert least_level.find_level(lambda _: one, DELTA, RATE).level == certificate.level
    rates = np.array([rate for _, _, rate, _ in searches])
    np.testing.assert_allclose(
        rates * least_level.GRID_SHARE / RATE, [0, *2.0 ** np.arange(-5, 1), 1.0], rtol=1e-12
    )
    coarse, fine = one.nodes.tolist(), np.linspace(1.0, 3.0, 9).tolist()
    assert [grid.knots.tolist() for grid, *_ in searches] == [coarse] * 5 + [fine] * 3
    asked = np.linspace(1.0, 3.0, 33).tolist()
    assert [grid.speeds.tolist() for grid, *_ in searches] == [asked] * 7 + [sorted([*asked, 1.01])]


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

    def tuned_from(*starts):
        return least_level.tuned([G], DELTA, 1.0, starts).log_parameters

    assert np.array_equal(tuned_from(bad, good), tuned_from(good)) and np.array_equal(
        tuned_from(good, bad), tuned_from(good)
    )
    assert not np.array_equal(tuned_from(bad), tuned_from(good))


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
    tuned = least_level.tuned([G], DELTA, 2.5, [start])
    assert norm(start) == pytest.approx(1.0, rel=1e-3) and norm(tuned) < 1.1 * np.sqrt(1 / 6)
    assert least_level.tuned([G], (2, 1), 2.5, [start, tuned]) is start


def at_frequencies(*values) -> SimpleNamespace:
    """A loop of two inputs that has one of the values, (outputs, 2) each, at the lowest frequencies."""

    def response(omega):
        omegas.append(omega)
        return np.concatenate(
            [np.array(values, complex), np.zeros((len(omega) - len(values), len(values[0]), 2))]
        )

    omegas: list[np.ndarray] = []
    return SimpleNamespace(dt=TS, response=response, omegas=omegas)


def shape(*log_parameters: float) -> Scaling:
    return Scaling(np.array([log_parameters]))


def test_d_is_tuned_on_frequencies_up_to_the_sampling_ones_half():
    loop = at_frequencies(np.eye(2))
    least_level.tuned([loop], DELTA, 1.0, [shape(0.0)])
    [omega] = loop.omegas
    assert len(omega) == 221 and omega[0] == 0 and omega[1] == pytest.approx(1e-4)
    assert np.pi / TS * (1 - 2e-9) < omega[-1] < np.pi / TS
    np.testing.assert_allclose(np.diff(np.log(omega[1:])), np.log(omega[2] / omega[1]))


@pytest.mark.parametrize("sign", [1.0, -1.0])
@pytest.mark.parametrize("level", [1.0, 4.0])
def test_the_pattern_of_the_search_for_d(level, sign):
    """The larger of d a and b / d over the level is least at ln d = +-0.52. Steps of 0.3 lead to 0.6, of 0.15
    to 0.45, of 0.075 to 0.525; one of 0.0375 is not asked for."""
    best = sign * 0.52
    a, b = np.exp(-best), level * np.exp(best)
    loops = [at_frequencies([[0, a], [0, 0], [0, 0]]), at_frequencies([[0, 0], [0.6 * b, 0], [0.8 * b, 0]])]
    scaling = least_level.tuned(loops, DELTA, level, [shape(0.0)])
    np.testing.assert_allclose(scaling.log_parameters, [[sign * 0.525]], rtol=1e-12)
    # From farther away each step is repeated while it helps.
    scaling = least_level.tuned(loops, DELTA, level, [shape(best - 1.21)])
    assert scaling.log_parameters[0, 0] - best == pytest.approx(-1.21 + 4 * 0.3)


def test_d_is_tried_up_and_down_by_the_last_step_too(monkeypatch):
    """Least at 0.52: the steps are kept while one helps, and halved down to 0.075 here."""
    loop, tried = at_frequencies([[0, np.exp(-0.52)], [np.exp(0.52), 0]]), []
    monkeypatch.setattr(least_level, "TUNING_STEPS", (0.3, 0.075))
    monkeypatch.setattr(
        least_level, "Scaling", lambda parameters: tried.append(parameters[0, 0]) or Scaling(parameters)
    )
    least_level.tuned([loop], DELTA, 1.0, [shape(0.0)])
    assert tried == pytest.approx(
        [0, 0, 0.3, 0, 0.6, 0.3, 0.9, 0.3, 0.75, 0.45, 0.6, 0.3, 0.525, 0.45, 0.6, 0.45, 0.525], abs=1e-12
    )


def test_a_step_for_d_must_gain_a_hundred_thousandth():
    """The norm of [1, e d] is about 1 + e^2 d^2 / 2: a step of -0.3 gains 0.2256 e^2, of -0.15 0.13 e^2."""
    for square, moved in ((4.3e-5, False), (4.6e-5, True)):
        loop = at_frequencies([[1.0, square**0.5], [0.0, 0.0]])
        scaling = least_level.tuned([loop], DELTA, 1.0, [shape(0.0)])
        assert (scaling.log_parameters[0, 0] < 0) == moved


def test_ds_gain_is_searched_at_four_speeds(monkeypatch):
    one = replace(family(turn=0.2), nodes=np.linspace(1.0, 3.0, 7))
    speeds, asked = [], []
    monkeypatch.setattr(lpv.Family, "loop", lambda self, v: speeds.append(v) or (v, self.at(v)))

    def norm(loop, rtol):
        v, G = loop
        gain = G.C[0, 0] / 0.35
        asked.append((G.C[1, 1] / 1.2, G.B[0, 1] / G.B[0, 0], rtol))
        return SimpleNamespace(upper=v + (np.log(gain) - 0.7) ** 2)

    monkeypatch.setattr(least_level, "hinf_norm", norm)
    gain, least = least_level._least_gain(one, DELTA, 4.0)
    assert np.log(gain) == pytest.approx(0.7, abs=0.02) and least == pytest.approx(3.0, abs=1e-3)
    assert speeds[:4] == pytest.approx([1.0, 5 / 3, 7 / 3, 3.0])
    assert {performance for performance, *_ in asked} == {0.25} and {rtol for *_, rtol in asked} == {1e-3}
    speeds.clear()
    # Without rows of Delta every output is over the level, and the gain is 1.
    least_gain = least_level._least_gain(one, (0, 1), 4.0)
    assert least_gain == (1.0, pytest.approx(3 + (np.log(0.25) - 0.7) ** 2))
    assert len(speeds) == 4 and asked[-1][1] == 1.0


@pytest.mark.parametrize(("best", "log_gain"), [(5.0, 2.0), (-5.0, -2.0)])
def test_ds_gain_is_at_most_e_squared_from_the_given_one(monkeypatch, best, log_gain):
    monkeypatch.setattr(lpv.Family, "loop", lambda self, v: self.at(v).C[0, 0] / 0.35)
    monkeypatch.setattr(
        least_level, "hinf_norm", lambda gain, rtol: SimpleNamespace(upper=(np.log(gain) - best) ** 2)
    )
    asked = []
    search = least_level.minimize_scalar
    monkeypatch.setattr(
        least_level,
        "minimize_scalar",
        lambda *arguments, **how: asked.append(how["options"]) or search(*arguments, **how),
    )
    gain, _ = least_level._least_gain(family(turn=0.2), DELTA, 1.0)
    assert np.log(gain) == pytest.approx(log_gain, abs=0.03) and asked == [{"xatol": 0.02}]


class ToldGrid:
    """Replaces the grid: records its construction and its calls in order. ``violated`` is scripted."""

    def __init__(self, said, violated, loop, Ts, knots, speeds, basis, delta, cost):
        self.said, self.left = said, violated
        self.made = loop, Ts, delta, cost
        self.knots, self.speeds, self.basis = knots, speeds, basis

    def with_knots(self, point, knots):
        self.said.append(("bent", point.excess, len(knots)))
        return self, Point(point.P, point.excess + 0.01)

    def evened(self, point):
        self.said.append(("evened", point.excess))
        return self, Point(point.P, point.excess + 0.001)

    def violated(self, point, rate, speeds):
        self.said.append(("violated", point.excess, rate, len(speeds)))
        return self.left.pop(0)

    def with_speeds(self, joined):
        self.said.append(("joined", joined.tolist()))
        self.speeds = np.sort(np.append(self.speeds, joined))
        return self


def told_level(monkeypatch, points, proofs, violated, frozen_gain=0.9, frozen=True) -> tuple:
    """The certificate of level 10, and what was said and asked in order: searches find points with the excess
    ``points``, and proofs, violated speeds are as told; each last one again and again."""
    said, made = [], []

    def next_of(answers):
        return answers.pop(0) if len(answers) > 1 else answers[0]

    def grid(*arguments):
        made.append(ToldGrid(said, violated, *arguments))
        return made[0]

    def search(grid, point, rate, unit):
        excess = next_of(points)
        said.append(("search", point.excess, rate))
        searches.append((point, unit))
        return None if excess is None else Point(point.P, excess)

    def prove(weighed, storage, rate):
        G = weighed.at(2.0)
        said.append(("proof", G.C[0, 0] / 0.35, G.C[1, 1] / 1.2, rate))
        return next_of(proofs)

    searches: list = []
    monkeypatch.setattr(least_level, "KnotGrid", grid)
    monkeypatch.setattr(least_level, "feasible_point", search)
    monkeypatch.setattr(least_level, "prove", prove)
    monkeypatch.setattr(least_level, "_least_gain", lambda *_: (0.5, frozen_gain))
    if not frozen:
        monkeypatch.setattr(least_level, "frozen_at", lambda *_: said.append("frozen"))
    out = least_level._at_level(family(turn=0.2), DELTA, RATE, 10.0, lambda text: said.append(text))
    return out, said, made, searches


def test_a_level_takes_seven_rates_and_a_proof_with_the_gain_that_the_search_left(monkeypatch):
    out, said, [grid], searches = told_level(monkeypatch, [0.44], ["proved"], [])
    on_grid = RATE / 0.99
    rates = [0.0, *(on_grid * 2.0 ** np.arange(-5, 1))]
    text = [one for one in said if isinstance(one, str)]
    assert text == [
        *(f"storage function for |dv/dt| up to {rate:.3g} m/s2, 2 states" for rate in rates),
        "proof between the speeds",
    ]
    did = [one for one in said if not isinstance(one, str)]
    # Each search begins at what the one before left; from half of the rate on there are more knots.
    want = []
    excess = 0.0
    for k, rate in enumerate(rates):
        if k > 4:
            want.append(("bent", pytest.approx(excess), 9))
            excess += 0.01
        want += [("search", pytest.approx(excess), pytest.approx(rate)), ("evened", 0.44)]
        excess = 0.441
    best = 0.5 * 1.441**0.5
    assert did == [*want, ("proof", pytest.approx(best), 0.1, RATE)]
    assert (out.rate, out.level, out.gain, out.proof) == (RATE, 10.0, pytest.approx(best), "proved")
    assert out.own_knots and out.storage.knots is grid.knots and out.storage.P is searches[-1][0].P
    # What the grid and the first search are given: the frozen solutions, nearly, and what F is measured in.
    wide = least_level.weighed(family(turn=0.2), DELTA, 10.0, 0.5)
    basis, parts, frozen = lpv.frozen_at(wide, wide.nodes)
    loop, Ts, delta, cost = grid.made
    np.testing.assert_array_equal(loop(2.0).C, wide.loop(2.0).C)
    assert (Ts, delta, len(grid.speeds)) == (TS, DELTA, 33)
    np.testing.assert_array_equal(grid.knots, wide.nodes)
    np.testing.assert_allclose(cost @ frozen.mean(axis=0), 1e-4 * np.eye(2), atol=1e-12)
    np.testing.assert_allclose(searches[0][0].P, frozen, rtol=0.01, atol=0.01 * np.abs(frozen).max())
    F = [
        np.block([[P, np.zeros((2, 2))], [np.zeros((2, 2)), np.eye(2)]]) - AB.T @ P @ AB - CD.T @ CD
        for P, (AB, CD) in zip(frozen, parts, strict=True)
    ]
    np.testing.assert_allclose(searches[0][1], np.mean(F, axis=0), atol=1e-9)
    np.testing.assert_array_equal(grid.basis, basis)


@pytest.mark.parametrize(("gain", "room"), [(0.9, True), (0.9 * (1 + 1e-12), False)])
def test_a_level_needs_room_at_frozen_speeds(monkeypatch, gain, room):
    out, said, *_ = told_level(monkeypatch, [0.0], [None], [], frozen_gain=gain, frozen=False)
    assert out is None and said == ["frozen"] * room


def test_a_rate_that_is_not_found_ends_the_level(monkeypatch):
    out, said, *_ = told_level(monkeypatch, [0.0, 0.0, None], ["proved"], [])
    assert out is None and sum(one[0] == "search" for one in said) == 3


def test_after_a_proof_that_fails_more_speeds_are_asked(monkeypatch):
    joined = np.array([1.01, 1.02])
    out, said, *_ = told_level(monkeypatch, [0.0] * 7 + [0.21], [None, "proved"], [joined])
    end = said[said.index("proof between the speeds") :]
    on_grid = pytest.approx(RATE / 0.99)
    assert end == [
        "proof between the speeds",
        ("proof", pytest.approx(0.5 * 1.001**0.5), 0.1, RATE),
        ("violated", 0.001, on_grid, 4 * 32 + 1),
        ("joined", [1.01, 1.02]),
        "storage function at 35 speeds",
        ("search", 0.001, on_grid),
        ("evened", 0.21),
        "proof between the speeds",
        ("proof", pytest.approx(0.5 * 1.211**0.5), 0.1, RATE),
    ]
    assert out.gain == pytest.approx(0.5 * 1.211**0.5)


@pytest.mark.parametrize(
    ("points", "violated", "proofs"),
    [
        ([0.0], [np.array([1.01])] * 6, 6),  # six rounds
        ([0.0], [np.array([1.01]), np.zeros(0)], 2),  # nothing is violated
        ([0.0] * 8 + [None], [np.array([1.01])] * 6, 2),  # the second search fails
    ],
)
def test_a_level_without_a_proof_is_given_up(monkeypatch, points, violated, proofs):
    out, said, *_ = told_level(monkeypatch, points, [None], violated)
    assert out is None and said.count("proof between the speeds") == proofs


def test_the_levels_are_tried_in_order_and_told(monkeypatch):
    asked, said = [], []

    def at_level(family, delta, rate, level, tell):
        asked.append((family, delta, rate, level))
        tell("try")
        return "found" if level == 5.0 else None

    monkeypatch.setattr(least_level, "_at_level", at_level)
    assert least_level.find_level(lambda level: -level, DELTA, RATE, said.append) == "found"
    assert asked == [(-level, DELTA, RATE, level) for level in (1.0, 2.5, 5.0)]
    assert said == ["level 1, try", "level 2.5, try", "level 5, try"]
