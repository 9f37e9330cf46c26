"""The proof for a Δ that varies: the commutator's identity, its limits, and loops with such a Δ that were
run."""

import numpy as np
import pytest

from lpvguard.engine.blocks import Block
from lpvguard.engine.synthesis import slow_delta
from lpvguard.engine.synthesis.dk import Scaling
from lpvguard.engine.synthesis.interconnection import GeneralisedPlant
from lpvguard.engine.synthesis.norms import hinf_norm
from lpvguard.engine.synthesis.scheduling import closed_scaled
from lpvguard.engine.synthesis.slow_delta import SlowLoop, _next_state, _read, _scalar
from lpvguard.engine.synthesis.statespace import StateSpace, append, gain, to_discrete

DT = 0.1
ONE = Block("full", 1, 1)
SCALING = Scaling(np.array([[0.3, 1.5, -0.7], [-0.2, -1.0, 1.2]]))
NO_CONTROLLER = gain(np.zeros((1, 1)), DT)


def plant(seed: int, level: float) -> GeneralisedPlant:
    """Two blocks of Δ, one error and one disturbance, scaled norm ``level``; its control does nothing."""
    random = np.random.default_rng(seed)
    A = random.standard_normal((4, 4))
    A -= (np.linalg.eigvals(A).real.max() + 0.4) * np.eye(4)
    B, C = np.zeros((4, 4)), np.zeros((4, 4))
    B[:, :3], C[:3] = random.standard_normal((4, 3)), random.standard_normal((3, 4))
    whole = GeneralisedPlant(to_discrete(StateSpace(A, B, C, np.zeros((4, 4))), DT), (ONE, ONE), 2, 2, 1, 1)
    size = np.sqrt(level / hinf_norm(closed_scaled(whole, NO_CONTROLLER, SCALING)).upper)
    G = whole.system
    smaller = StateSpace(G.A, G.B * size, G.C * size, G.D * size**2, DT)
    return GeneralisedPlant(smaller, (ONE, ONE), 2, 2, 1, 1)


def matrix_of(G: StateSpace, n: int) -> np.ndarray:
    """What G makes of n samples from rest, (n p, n m)."""
    pulse, state, p, m = [G.D], G.B, *G.D.shape
    for _ in range(n - 1):
        pulse.append(G.C @ state)
        state = G.A @ state
    out = np.zeros((n, p, n, m))
    for t in range(n):
        for s in range(t + 1):
            out[t, :, s] = pulse[t - s]
    return out.reshape(n * p, n * m)


def test_the_commutator_is_the_change_from_sample_to_sample_between_two_filters():
    n, random = 30, np.random.default_rng(1)
    delta = np.tril(random.standard_normal((n + 1, n + 1)))
    change = (delta[1:, 1:] - delta[:-1, :-1])[:n, :n]
    delta = delta[:n, :n]
    left, _ = SCALING.systems(plant(1, 0.9))
    for d in (to_discrete(one, DT) for one in _scalar(left, plant(1, 0.9), SCALING)):
        inverse = StateSpace(d.A - d.B @ d.C / d.D, d.B / d.D, -d.C / d.D, 1 / d.D, DT)
        d_, inverse_, next_, read = (matrix_of(G, n) for G in (d, inverse, _next_state(d), _read(d)))
        np.testing.assert_allclose(d_ @ inverse_, np.eye(n), atol=1e-12)
        np.testing.assert_allclose(d_ @ delta @ inverse_, delta - read @ change @ next_, atol=1e-10)


@pytest.mark.parametrize("performance", [True, False])
def test_a_delta_that_hardly_varies_leaves_the_scaled_norm(performance):
    loop = SlowLoop(plant(2, 0.95), NO_CONTROLLER, SCALING, performance)
    level = loop.proved(1e-9, loop.even(1e-9))
    assert level == pytest.approx(0.95, rel=1e-3) if performance else level <= 0.951
    rates = [loop.at(rate).level for rate in (1e-3, 1e-1, 10.0)]
    assert rates == sorted(rates) and rates[-1] > rates[0] * 1.05


def test_a_larger_rate_than_the_proved_one_is_not_proved_by_its_constants():
    loop = SlowLoop(plant(3, 0.9), NO_CONTROLLER, SCALING, True)
    minimum = loop.search()
    assert minimum.level < 1 and loop.proved(minimum.rate, minimum.log_constants) == minimum.level
    assert loop.proved(1.2 * minimum.rate, minimum.log_constants) > 1
    assert SlowLoop(plant(3, 1.01), NO_CONTROLLER, SCALING, True).search() is None


def gain_of_a_run(one: GeneralisedPlant, rate: float, omega: float, random: np.random.Generator) -> float:
    """Energy of z over that of w for multiplications that move at ``rate`` [1/s] up to size 1, under a
    disturbance at ``omega`` [rad/s] that ends midway."""
    G, steps = one.system, 1500
    moves = random.choice([-1.0, 1.0], (steps // 20, 2)).repeat(20, axis=0) * rate * DT
    delta, x, energy = random.uniform(-1, 1, 2), np.zeros(G.order), np.zeros(2)
    for t in range(steps):
        delta = np.clip(delta + moves[t], -1, 1)
        w = np.cos(omega * t * DT) if t < steps // 2 else 0.0
        eta = G.C[:2] @ x + G.D[:2, 2] * w
        xi = np.linalg.solve(np.eye(2) - delta[:, None] * G.D[:2, :2], delta * eta)
        z = G.C[2] @ x + G.D[2, :2] @ xi + G.D[2, 2] * w
        x = G.A @ x + G.B[:, :2] @ xi + G.B[:, 2] * w
        energy += z * z, w * w
    return energy[0] / energy[1]


@pytest.mark.slow("5 s: runs with a Delta")
def test_no_run_with_a_delta_at_the_proved_rate_has_a_gain_above_1():
    largest = []
    for seed in range(4):
        one, random = plant(seed, 0.9), np.random.default_rng(seed)
        peak = hinf_norm(closed_scaled(one, NO_CONTROLLER, SCALING)).peak_frequency
        rate = SlowLoop(one, NO_CONTROLLER, SCALING, True).search().rate
        runs = [gain_of_a_run(one, rate, peak * random.uniform(0.7, 1.3), random) for _ in range(12)]
        largest.append(max(runs))
    assert max(largest) < 1 and max(largest) > 0.02


def test_without_states_of_D_the_proof_is_for_any_rate():
    constant = Scaling(SCALING.log_parameters[:, :1])
    loop = SlowLoop(plant(5, 0.8), NO_CONTROLLER, constant, False)
    slow, fast = loop.at(0.0), loop.at(1e6)
    assert slow.level == pytest.approx(fast.level) and len(slow.log_constants) == 2


def test_the_next_state_is_that_of_the_filter_driven_by_what_it_made_of_its_input():
    random = np.random.default_rng(3)
    d = StateSpace(np.diag([0.3, -0.6]), *(random.standard_normal(s) for s in ((2, 1), (1, 2))), [[2.0]], DT)
    for z in (1.2, 0.4 + 0.9j):
        state = np.linalg.solve(z * np.eye(2) - d.A, d.B)
        np.testing.assert_allclose(_next_state(d).evaluate([z])[0], z * state / d.evaluate([z])[0])
        np.testing.assert_allclose(_read(d).evaluate([z])[0], d.C @ np.linalg.inv(z * np.eye(2) - d.A))


def lag(pole: float) -> StateSpace:
    return StateSpace([[pole]], [[1.0]], [[1.0]], [[0.5]], DT)


@pytest.mark.parametrize("rest", [0, 2])
def test_what_e_sees_stands_beside_and_what_it_does_is_taken_away(rest):
    two = append(lag(0.3), lag(-0.6))
    points = [1.2, 0.4 + 0.9j]
    beside = slow_delta._beside(gain(np.eye(2), DT), two, rest, DT).evaluate(points)
    away = slow_delta._sum(2, two, rest, DT).evaluate(points)
    for E, S, A in zip(two.evaluate(points), beside, away, strict=True):
        want = np.zeros((4 + rest, 2 + rest), complex)
        want[:2, :2], want[2:4, :2], want[4:, 2:] = np.eye(2), E, np.eye(rest)
        np.testing.assert_allclose(S, want, atol=1e-12)
        want = np.zeros((2 + rest, 4 + rest), complex)
        want[:2, :2], want[:2, 2:4], want[2:, 4:] = np.eye(2), -E, np.eye(rest)
        np.testing.assert_allclose(A, want, atol=1e-12)


@pytest.mark.parametrize("performance", [True, False])
def test_rows_and_columns_are_those_of_the_blocks_their_states_and_the_performance(performance):
    """A scaling of second order: two states a channel, for each row and each column of a block of 2 x 3."""
    scaling = Scaling(np.array([[0.3, 1.5, -0.7, 0.2, 0.4], [-0.2, -1.0, 1.2, -0.1, 0.3]]))
    random = np.random.default_rng(1)
    A = np.diag([-1.0, -3.0])
    G = StateSpace(A, random.standard_normal((2, 6)), random.standard_normal((7, 2)), np.zeros((7, 6)))
    whole = GeneralisedPlant(to_discrete(G, DT), (Block("full", 2, 3), ONE), 3, 4, 1, 1)
    loop = SlowLoop(whole, gain(np.zeros((1, 1)), DT), scaling, performance)
    fixed = 2 if performance else 0
    assert (loop.blocks, loop.dt, loop.scalings.fixed) == (2, DT, fixed)
    assert (loop.scalings.rows, loop.scalings.cols) == ([3, 1, 6, 2], [2, 1, 4, 2])
    system = loop.scalings.system
    assert (system.n_outputs, system.n_inputs) == (12 + 2 * performance, 9 + 2 * performance)
    np.testing.assert_allclose(loop._sizes(3.0), [1.0, 1.0, 0.3, 0.3])
    even = loop.even(3.0)
    np.testing.assert_allclose(even[2 - fixed :], -0.5 * np.log(0.3))
    assert len(even) == loop.scalings.free and not even[: 2 - fixed].any() and not loop.even(0.0).any()


class Found:
    """Constants in the place of a search: below 1 up to a rate, each a tenth beside its start."""

    rows, free, fixed = (1, 1, 1, 1), 4, 0

    def __init__(self, limit: float, proved: float):
        self.limit, self.share, self.asked, self.held = limit, proved, [], []

    def least(self, sizes, level, start, decided=False):
        rate = sizes[-1] / DT
        self.asked.append((rate, level, start, decided))
        return rate / self.limit, start + 0.1

    def proved(self, sizes, level, x):
        self.held.append((sizes[-1] / DT, x))
        return sizes[-1] / DT / (self.share * self.limit)


def searched(limit: float, proved: float) -> SlowLoop:
    loop = SlowLoop.__new__(SlowLoop)
    loop.dt, loop.blocks, loop.scalings = DT, 2, Found(limit, proved)
    return loop


@pytest.mark.parametrize("limit", [3e-6, 0.7, 9e3])
@pytest.mark.parametrize(("proved", "share"), [(1.1, 0.98), (0.92, 0.9), (0.75, 0.7), (0.45, 0.4)])
def test_the_largest_rate_is_bisected_and_a_share_of_it_proved(limit, proved, share):
    loop = searched(limit, proved)
    minimum, asked = loop.search(), loop.scalings.asked
    best = max(rate for rate, *_ in asked if rate < limit)
    assert limit * np.exp(-slow_delta.RATE_RTOL) < best < limit
    assert minimum.rate == pytest.approx(share * best) and minimum.level == pytest.approx(
        minimum.rate / proved / limit
    )
    assert len(asked) == 10, "from 1e-6 to 1e4 in halves to 3 %"
    [x] = [start + 0.1 for rate, _, start, _ in asked if rate == best]
    np.testing.assert_array_equal(minimum.log_constants, x)
    below = 0
    for rate, level, start, decided in asked:
        np.testing.assert_allclose(start - loop.even(rate), 0.1 * below, atol=1e-12)
        assert level == 1.0 and decided
        below += rate < limit


def test_without_a_rate_or_a_proof_there_is_none():
    assert searched(0.9e-6, 1.1).search() is None
    loop = searched(1.0, 0.3)
    assert loop.search() is None and len(loop.scalings.held) == len(slow_delta.SHARES)
    loop = searched(1.0, 0.5)
    proved = loop.at(0.3)
    assert (proved.rate, proved.level) == (0.3, pytest.approx(0.6))
    [(rate, level, start, decided)] = loop.scalings.asked
    assert (rate, level, decided) == (pytest.approx(0.3), 1.0, False)
    np.testing.assert_array_equal(start, loop.even(0.3))
    np.testing.assert_array_equal(proved.log_constants, start + 0.1)
    assert loop.proved(0.3, start) == pytest.approx(0.6)


def test_the_scaling_of_a_block_is_taken_from_its_first_channel():
    """Of blocks of 2 x 3 and 1 x 1 with two states a channel."""
    scaling = Scaling(np.array([[0.3, 1.5, -0.7, 0.2, 0.4], [-0.2, -1.0, 1.2, -0.1, 0.3]]))
    blocks = (Block("full", 2, 3), ONE)
    whole = GeneralisedPlant(gain(np.zeros((6, 5)), DT), blocks, 3, 4, 1, 1)
    left, _ = scaling.systems(whole)
    omega = [0.1, 2.0, 40.0]
    for one, k in zip(_scalar(left, whole, scaling), (0, 3), strict=True):
        assert one.order == 2
        np.testing.assert_allclose(one.response(omega)[:, 0, 0], left.response(omega)[:, k, k])
        np.testing.assert_allclose(
            np.abs(one.response(omega)[:, 0, 0]), np.exp(scaling.log_magnitude(np.array(omega))[k // 3])
        )
