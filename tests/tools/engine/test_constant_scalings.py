"""Constant scalings: slope and second derivatives of what is made small, and that it is made least."""

import numpy as np
import pytest
from scipy.optimize import minimize

from lpvguard.engine.synthesis.constant_scalings import FARTHEST, ConstantScalings
from lpvguard.engine.synthesis.statespace import StateSpace

ROWS, COLS, SIZES, REST = [2, 1, 1], [1, 2, 2], np.array([1.0, 2.0, 0.5]), 0.7


def loop(seed: int) -> StateSpace:
    """A stable discrete system of 6 outputs and 7 inputs."""
    random = np.random.default_rng(seed)
    A = random.normal(size=(6, 6))
    A *= 0.8 / np.abs(np.linalg.eigvals(A)).max()
    B, C, D = (random.normal(size=shape) for shape in ((6, 7), (6, 6), (6, 7)))
    return StateSpace(A, B, C, D, 0.01)


@pytest.mark.parametrize("fixed", [0, 1])
def test_slope_and_second_derivatives_are_those_of_differences(fixed):
    scalings = ConstantScalings(loop(1), ROWS, COLS, fixed)
    x = np.random.default_rng(2).normal(size=scalings.free)
    _, slope, curvature = scalings._mean(SIZES, REST, x)
    h = 1e-5
    ends = [[scalings._mean(SIZES, REST, x + s * h * e) for s in (1, -1)] for e in np.eye(scalings.free)]
    for k, (after, before) in enumerate(ends):
        assert np.isclose((after[0] - before[0]) / (2 * h), slope[k], rtol=0, atol=1e-8)
        assert np.allclose((after[1] - before[1]) / (2 * h), curvature[k], rtol=0, atol=1e-6)


@pytest.mark.parametrize("seed", range(5))
@pytest.mark.parametrize("start", [0.0, 6.0])
def test_no_other_search_finds_a_lesser_norm(seed, start):
    scalings = ConstantScalings(loop(seed), ROWS, COLS)
    found, x = scalings.least(SIZES, REST, np.array([start, -start, 0.0]))
    other = minimize(
        lambda x: scalings._largest(SIZES, REST, x), x, method="Nelder-Mead", options={"maxiter": 2000}
    )
    assert found <= other.fun * (1 + 0.01) and found == scalings._largest(SIZES, REST, x)


@pytest.mark.parametrize("seed", range(6))
@pytest.mark.parametrize("start", [(0, 0, 0), (6, -6, 0), (-20, 0, 10), (25, -25, 25)])
def test_a_search_that_asks_only_whether_finds_what_the_whole_one_does(seed, start):
    """From a start at which the norm is 1e20 too: Newton's step is short wherever two frequencies meet."""
    scalings = ConstantScalings(loop(seed), ROWS, COLS)
    norm, _ = scalings.least(SIZES, REST, np.zeros(3))
    for share, below in ((0.95, True), (1.01, False)):
        sizes, rest = share / norm * SIZES, share / norm * REST
        found, x = scalings.least(sizes, rest, np.array(start, float), only_whether=True)
        assert (found < 1) == below and found == scalings._largest(sizes, rest, x)


def test_a_block_that_a_constant_cannot_help_stops_at_the_farthest():
    G = StateSpace(
        np.zeros((1, 1)), np.zeros((1, 2)), np.zeros((2, 1)), np.array([[0.1, 1.0], [0.0, 0.1]]), 0.01
    )
    # The other block's input reaches this one's output alone: the larger the constant, the better.
    found, x = ConstantScalings(G, [1, 1], [1, 1], 1).least(np.ones(2), 1.0, np.zeros(1))
    assert found == pytest.approx(0.1, rel=1e-6) and 10 < x[0] <= FARTHEST
