"""The worst-case gain between frequencies: above every Δ that is tried, attained by one, and sound at slow
poles."""

import numpy as np
import pytest

from lpvguard.engine.blocks import Block
from lpvguard.engine.synthesis.mu_interval import mu_interval
from lpvguard.engine.synthesis.norms import hinf_norm
from lpvguard.engine.synthesis.statespace import StateSpace, append, gain, series, to_discrete
from lpvguard.engine.synthesis.worst_gain import worst_gain

ONE = Block("full", 1, 1)


def loop_of(seed: int, size: float = 0.2) -> StateSpace:
    random = np.random.default_rng(seed)
    A = random.standard_normal((5, 5))
    A -= (np.linalg.eigvals(A).real.max() + 0.3) * np.eye(5)
    B, C = random.standard_normal((5, 4)), random.standard_normal((4, 5))
    G = StateSpace(A, B, C, 0.1 * random.standard_normal((4, 4)))
    stable = mu_interval(G.select(slice(0, 2), slice(0, 2)), [ONE, ONE], 0.0, np.inf).upper
    weight = gain(np.diag([size / stable, size / stable, 1.0, 1.0]))
    return series(weight, G)


@pytest.mark.parametrize("seed", [1, 2, 3])
@pytest.mark.parametrize("dt", [0.0, 0.1])
def test_no_delta_of_size_1_exceeds_it_and_one_comes_close(seed, dt):
    loop = loop_of(seed, 0.6)
    loop = to_discrete(loop, dt) if dt else loop
    found = worst_gain(loop, [ONE, ONE], Block("full", 2, 2), 0.0, np.pi / dt if dt else np.inf)
    random = np.random.default_rng(seed)
    M = loop.response([found.omega])[0]
    reached = 0.0
    for turn in np.exp(1j * random.uniform(0, 2 * np.pi, (4000, 2))):
        delta = np.diag(turn)
        closed = M[2:, 2:] + M[2:, :2] @ delta @ np.linalg.solve(np.eye(2) - M[:2, :2] @ delta, M[:2, 2:])
        reached = max(reached, np.linalg.norm(closed, 2))
    assert 0.9 * found.upper <= reached <= found.upper * (1 + 1e-9)


def test_without_uncertainty_it_is_the_norm():
    loop = loop_of(5)
    found, norm = worst_gain(loop, [], Block("full", 4, 4), 0.0, np.inf), hinf_norm(loop)
    assert norm.lower * (1 - 1e-9) <= found.upper <= norm.upper * 1.0025


def test_a_closed_form():
    """1/(s + 1) with Δ about its input: |1 + 0.5 δ|, at most 1.5, at frequency 0."""
    loop = series(
        StateSpace([[-1.0]], [[1.0]], [[1.0]], [[0.0]]),
        gain([[1.0, 1.0]]),
    )
    first = StateSpace(loop.A, loop.B, np.vstack([np.zeros((1, 1)), loop.C]), [[0.0, 0.5], [0.0, 0.0]])
    found = worst_gain(first, [ONE], ONE, 0.0, np.inf)
    assert 1.5 * (1 - 1e-4) <= found.upper <= 1.5 * 1.003 and found.omega < 0.1


def test_where_delta_makes_the_loop_unstable_there_is_no_bound():
    assert worst_gain(loop_of(1, 1.2), [ONE, ONE], Block("full", 2, 2), 0.0, np.inf).upper == np.inf


@pytest.mark.parametrize("fast", [1e3, 1e5, 1e7])
def test_a_peak_at_a_slow_pole_beside_a_fast_one_is_not_passed_over(fast):
    """Rounding of the size of the fast pole moves the slow crossing's eigenvalue off the axis."""
    slow = StateSpace([[-1e-3]], [[1e-3]], [[1.0]], [[0.0]])
    other = StateSpace([[-fast, fast], [0.0, -0.5 * fast]], [[0.0], [0.3 * fast]], [[1.0, 0.0]], [[0.0]])
    both = append(slow, other)
    turn = np.array([[0.8, 0.6], [-0.6, 0.8]])
    loop = series(gain(turn), series(both, gain(turn.T)))
    mu = mu_interval(loop, [Block("full", 2, 2)], 0.0, np.inf)
    assert hinf_norm(loop).lower * (1 - 1e-9) <= mu.upper <= hinf_norm(loop).upper * 1.0025
