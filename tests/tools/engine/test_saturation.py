"""What is proved of a limited demand, against runs of the loop with the limit itself."""

import numpy as np
import pytest

from lpvguard.engine.blocks import Block
from lpvguard.engine.synthesis.dk import Scaling
from lpvguard.engine.synthesis.errors import SynthesisError
from lpvguard.engine.synthesis.interconnection import GeneralisedPlant
from lpvguard.engine.synthesis.saturation import LimitedLoop, _proof, _reached, sector
from lpvguard.engine.synthesis.statespace import StateSpace, append

DT, U_MAX, STEP_MAX = 0.1, 1.0, 0.8
SCALING = Scaling(np.array([[0.2, 1.0, -0.5]]))
L = np.array([[0.3], [0.1]])


def plant(delta: float = 0.3) -> GeneralisedPlant:
    """x' = 0.9 x + 0.2 v + 0.1 w, y = x + delta xi, eta = x, z = x - w / 2; one Δ."""
    A, B = [[0.9, 0.05], [0.0, 0.7]], [[0.0, 0.1, 0.2], [0.0, 0.3, 0.0]]
    C = [[1.0, 0.0], [1.0, 0.0], [1.0, 0.0]]
    D = [[0.0, 0.0, 0.0], [0.0, -0.5, 0.0], [delta, 0.0, 0.0]]
    return GeneralisedPlant(StateSpace(A, B, C, D, DT), (Block("full", 1, 1),), 1, 1, 1, 1)


def controller() -> StateSpace:
    return StateSpace([[0.95, 0.1], [0.0, 0.5]], [[-0.03], [-0.15]], [[1.0, 1.0]], [[0.0]], DT)


def run(w: np.ndarray, delta: np.ndarray, limit: float) -> tuple[np.ndarray, np.ndarray]:
    """Wanted demand and z of the loop with the limit itself; ``delta`` multiplies eta at every sample."""
    P, K = plant().system, controller()
    x, k, wanted, errors = np.zeros(2), np.zeros(2), [], []
    for value, d in zip(w, delta, strict=True):
        u = float((K.C @ k)[0])
        v = float(np.clip(u, -limit, limit))
        inputs = np.array([d * (P.C[0] @ x), value, v])
        out = P.C @ x + P.D @ inputs
        wanted.append(u)
        errors.append(out[1])
        x, k = P.A @ x + P.B @ inputs, K.A @ k + K.B[:, 0] * out[2] + L[:, 0] * (v - u)
    return np.array(wanted), np.array(errors)


def loop(kappa: float) -> LimitedLoop:
    return LimitedLoop(plant(), controller(), L, kappa, SCALING)


def worst_for_demand(n: int = 120) -> np.ndarray:
    """The unit disturbance that makes the unlimited nominal loop want the most."""
    pulse, _ = run(np.r_[1.0, np.zeros(n)], np.zeros(n + 1), np.inf)
    w = pulse[:0:-1]
    return w / np.linalg.norm(w)


@pytest.mark.unhurried
@pytest.mark.parametrize("kappa", [1.0, 1.5, 2.0])
def test_no_disturbance_of_the_proved_energy_leaves_the_range_or_exceeds_the_gain(kappa):
    one = loop(kappa)
    constants = one.stability().least(one.ones, 1.0, np.zeros(2))[1]
    gamma, by_gain = one.gain()
    reachable = one.largest_energy([constants, by_gain], U_MAX, STEP_MAX)
    random, largest, moved = np.random.default_rng(5), 0.0, 0.0
    for trial in range(60):
        if trial % 2:
            w = worst_for_demand() * random.choice([-1, 1])
        else:
            w = random.standard_normal(120) * np.exp(-random.uniform(0, 0.1) * np.arange(120))
        w = np.r_[w, np.zeros(80)] * reachable.energy / np.linalg.norm(w)
        delta = np.full(len(w), random.choice([-1.0, 0.0, 1.0])) if trial % 3 else np.zeros(len(w))
        wanted, z = run(w, delta, U_MAX)
        largest = max(largest, np.abs(wanted).max())
        moved = max(moved, np.abs(np.diff(wanted, prepend=0.0)).max())
        assert np.linalg.norm(z) <= gamma * reachable.energy
    assert largest <= kappa * U_MAX and moved <= STEP_MAX
    assert kappa > 1 or largest > 0.3 * U_MAX  # beyond the limit the sector is wider than the dead zone


def test_with_the_limit_never_reached_it_is_the_loop_without():
    one = loop(1.0)
    assert sector(1.0) == 0 and sector(2.0) == 0.5 and sector(np.inf) == 1
    omega = np.array([0.0, 0.3, 3.0])
    p = one.system.response(omega)[:, :, 1]
    assert np.abs(p).max() == 0
    gamma, _ = one.gain()
    other = LimitedLoop(plant(), controller(), 5 * L, 1.0, SCALING)
    assert other.gain()[0] == pytest.approx(gamma)


def test_a_wider_range_costs_gain_and_a_wrong_anti_windup_stability():
    gains = [loop(kappa).gain()[0] for kappa in (1.0, 1.5, 2.0)]
    assert gains == sorted(gains) and gains[2] > 1.02 * gains[0]
    wrong = LimitedLoop(plant(), controller(), np.array([[-0.3], [-0.1]]), 4.0, SCALING)
    assert not wrong.stable or wrong.stability().least(wrong.ones, 1.0, np.zeros(2))[0] > 1


def test_the_energy_is_refused_where_its_constants_prove_nothing():
    one = loop(2.0)
    assert one.energy(np.array([0.0, 12.0]), U_MAX, STEP_MAX) is None
    assert one.energy(np.array([12.0, 0.0]), U_MAX, STEP_MAX) is None


def test_the_proof_fails_for_a_smaller_Q_and_for_a_gain_above_1():
    A, B, C, D = np.array([[0.5]]), np.array([[1.0]]), np.array([[0.3]]), np.array([[0.0]])
    Q = _reached(A, B, C, D, 1e-6 * np.eye(1))
    assert _proof(A, B, C, D, Q) > 1
    assert _proof(A, B, C, D, 0.99 * Q) < 0 > _proof(A, B, C, D, -Q)
    # gain 0.6 at DC; of 1.2 there is no Q
    q = Q[0, 0]
    assert q == pytest.approx(0.25 * q + 1 + (0.15 * q) ** 2 / (1 - 0.09 * q), rel=1e-4)
    other = _reached(A, B, 2 * C, D, 1e-6 * np.eye(1))
    assert other is None or not _proof(A, B, 2 * C, D, other) > 1


def test_a_loop_without_delay_is_refused():
    direct = StateSpace([[0.5]], [[1.0]], [[1.0]], [[1.0]], DT)
    with pytest.raises(SynthesisError, match="a delay of at least one sample"):
        LimitedLoop(plant(), direct, np.zeros((1, 1)), 2.0, SCALING)


def twice(G: StateSpace, inputs: list[int], outputs: list[int]) -> StateSpace:
    """Two of G side by side, with the signals of both in each group of ``inputs`` and ``outputs``."""
    two = append(G, G)
    columns, rows = (
        [k for group in np.split(np.arange(n), np.cumsum(sizes)[:-1]) for k in (*group, *(group + n))]
        for n, sizes in ((G.n_inputs, inputs), (G.n_outputs, outputs))
    )
    return two.select(rows, columns)


def test_two_inputs_side_by_side_have_what_is_proved_of_one():
    """Two loops that share nothing: the same energy where the limits are equal, and that of the narrower
    one."""
    one, kappa = plant(), 1.5
    both = GeneralisedPlant(twice(one.system, [1, 1, 1], [1, 1, 1]), one.blocks * 2, 2, 2, 2, 2)
    limited = LimitedLoop(
        both,
        append(controller(), controller()),
        np.kron(np.eye(2), L),
        kappa,
        Scaling(np.tile(SCALING.log_parameters, (2, 1))),
    )
    alone = loop(kappa)
    constants = alone.stability().least(alone.ones, 1.0, np.zeros(2))[1]
    each = np.repeat(constants, 2)
    want = alone.energy(constants, U_MAX, STEP_MAX)
    assert want is not None
    for limits in (np.array([1.0, 1.0]), np.array([1.0, 0.5]), np.array([0.5, 1.0])):
        got = limited.energy(each, limits * U_MAX, limits * STEP_MAX)
        assert got == pytest.approx(limits.min() * want, rel=1e-4)
    assert limited.stability().proved(limited.ones, 1.0, each) == pytest.approx(
        alone.stability().proved(alone.ones, 1.0, constants), rel=1e-6
    )
