"""Constant scalings: slope and second derivatives of what is made small, and that it is made least."""

from types import SimpleNamespace

import numpy as np
import pytest
from scipy.optimize import minimize

from lpvguard.engine.synthesis import constant_scalings
from lpvguard.engine.synthesis.constant_scalings import FARTHEST, ConstantScalings, _shorter
from lpvguard.engine.synthesis.statespace import EPS, StateSpace, gain

ROWS, COLS, SIZES, REST = [2, 1, 1], [1, 2, 2], np.array([1.0, 2.0, 0.5]), 0.7


def loop(seed: int) -> StateSpace:
    """A stable discrete system of 6 outputs and 7 inputs."""
    random = np.random.default_rng(seed)
    A = random.normal(size=(6, 6))
    A *= 0.8 / np.abs(np.linalg.eigvals(A)).max()
    B, C, D = (random.normal(size=shape) for shape in ((6, 7), (6, 6), (6, 7)))
    return StateSpace(A, B, C, D, 0.01)


@pytest.mark.parametrize("fixed", [0, 1])
@pytest.mark.parametrize("dynamics", [1.0, 3e-3])
def test_slope_and_second_derivatives_are_those_of_differences(fixed, dynamics):
    """Of one peak, and of norms that differ by a thousandth from frequency to frequency."""
    G = loop(1)
    scalings = ConstantScalings(StateSpace(G.A, dynamics * G.B, G.C, G.D, G.dt), ROWS, COLS, fixed)
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
    norm, x = scalings.least(SIZES, REST, np.array([start, -start, 0.0]))
    other = minimize(
        lambda x: scalings._largest(SIZES, REST, x), x, method="Nelder-Mead", options={"maxiter": 2000}
    )
    assert norm <= other.fun * (1 + 0.01) and norm == scalings._largest(SIZES, REST, x)


@pytest.mark.parametrize("seed", range(6))
@pytest.mark.parametrize("start", [(0, 0, 0), (6, -6, 0), (-20, 0, 10), (25, -25, 25)])
def test_a_search_that_asks_only_whether_finds_what_the_whole_one_does(seed, start):
    """From a start at which the norm is 1e20 too: Newton's step is short wherever two frequencies meet."""
    scalings = ConstantScalings(loop(seed), ROWS, COLS)
    norm, _ = scalings.least(SIZES, REST, np.zeros(3))
    for share, below in ((0.95, True), (1.01, False)):
        sizes, rest = share / norm * SIZES, share / norm * REST
        level, x = scalings.least(sizes, rest, np.array(start, float), only_whether=True)
        assert (level < 1) == below and level == scalings._largest(sizes, rest, x)


def test_a_block_that_a_constant_cannot_help_stops_at_the_farthest():
    G = StateSpace(
        np.zeros((1, 1)), np.zeros((1, 2)), np.zeros((2, 1)), np.array([[0.1, 1.0], [0.0, 0.1]]), 0.01
    )
    # The other block's input reaches this one's output alone: the larger the constant, the better.
    norm, x = ConstantScalings(G, [1, 1], [1, 1], 1).least(np.ones(2), 1.0, np.zeros(1))
    assert norm == pytest.approx(0.1, rel=1e-6) and 10 < x[0] <= FARTHEST


# ---------------------------------------------------------------- what is made small


def test_the_mean_is_the_power_mean_of_the_scaled_responses_norm():
    G, x = loop(3), np.array([0.3, -0.2, 0.5])
    omega = np.concatenate([[0.0], np.geomspace(1e-4, np.pi / 0.01 * (1 - 1e-9), 160)])
    left = np.repeat(np.exp(x) * SIZES, ROWS).tolist() + [REST] * 2
    right = np.repeat(np.exp(-x), COLS).tolist() + [1.0] * 2
    sigma = np.linalg.norm(np.diag(left) @ G.response(omega) @ np.diag(right), 2, axis=(1, 2))
    scalings = ConstantScalings(G, ROWS, COLS)
    mean = scalings._mean(SIZES, REST, x)[0]
    assert mean == pytest.approx(np.log(np.mean((sigma / sigma.max()) ** 300)) / 300 + np.log(sigma.max()))
    assert scalings._largest(SIZES, REST, x) == pytest.approx(sigma.max())
    scaled = scalings.scaled(SIZES, REST, x)
    np.testing.assert_allclose(
        scaled.response(omega), np.diag(left) @ G.response(omega) @ np.diag(right), rtol=1e-9, atol=1e-12
    )
    assert scaled.dt == 0.01 and scalings.free == 3
    fixed = ConstantScalings(G, ROWS, COLS, 1).scaled(SIZES, REST, x[1:])
    np.testing.assert_array_equal(fixed.C, scalings.scaled(SIZES, REST, np.r_[0.0, x[1:]]).C)


def test_what_is_proved_is_the_norm_over_all_frequencies(monkeypatch):
    """A lag's peak of 3 at frequency 0, and sizes and constants that make 6 of it."""
    lag = StateSpace([[0.9]], [[0.1]], [[3.0]], [[0.0]], 0.01)
    norm = ConstantScalings(lag, [1], [1]).proved(np.array([2.0]), 1.0, np.array([0.7]))
    assert 6.0 <= norm <= 6.0 * (1 + 2e-5)
    alone = ConstantScalings(lag, [], [])
    assert alone.proved(np.zeros(0), 0.5, np.zeros(0)) == pytest.approx(1.5, rel=2e-5)
    assert alone.least(np.zeros(0), 0.5, np.zeros(0)) == (pytest.approx(1.5), pytest.approx([]))
    monkeypatch.setattr(constant_scalings, "hinf_norm", lambda G, rtol: SimpleNamespace(upper=rtol))
    assert alone.proved(np.zeros(0), 0.5, np.zeros(0)) == 1e-5


def test_the_grid_goes_from_zero_to_just_below_half_the_sampling_frequency():
    asked = []
    system = SimpleNamespace(dt=0.01, response=lambda omega: asked.append(omega) or omega)
    assert len(ConstantScalings(system, [], [])._grid) == 161
    [omega] = asked
    assert omega[0] == 0 and omega[1] == pytest.approx(1e-4)
    assert np.pi / 0.01 * (1 - 2e-9) < omega[-1] < np.pi / 0.01
    np.testing.assert_allclose(np.diff(np.log(omega[1:])), np.log(omega[2] / omega[1]))


def made_up(responses) -> ConstantScalings:
    """Of scalar responses at hand; one block."""
    one = ConstantScalings(gain(np.eye(1), 0.01), [1], [1])
    one._grid = np.array(responses, dtype=complex)[:, None, None]
    return one


def test_derivatives_are_worked_out_where_they_have_a_part_in_the_mean(monkeypatch):
    """sigma^300 below EPS of the largest has none: sigma^2 below EPS^(2/300) = 0.7864."""
    sigma = np.sqrt([0.7861, 1.0, 0.7867, 0.1])
    scalings = made_up(sigma)
    seen, derivatives = [], scalings._derivatives
    monkeypatch.setattr(
        scalings, "_derivatives", lambda N, *arguments: seen.append(N) or derivatives(N, *arguments)
    )
    value, *_ = scalings._mean(np.ones(1), 1.0, np.zeros(1))
    np.testing.assert_allclose(seen[0][:, 0, 0], sigma[1:3])
    assert value == pytest.approx(np.log(np.mean(sigma**300)) / 300, rel=1e-12)
    # Of close ones each has its part.
    sigma = np.array([3.0, 2.99, 2.98])
    value, *_ = made_up(sigma)._mean(np.ones(1), 1.0, np.zeros(1))
    assert value == pytest.approx(np.log(3) + np.log(np.mean((sigma / 3) ** 300)) / 300, rel=1e-13)


def test_a_loop_of_zeros_has_the_least_mean_and_no_slope():
    scalings = ConstantScalings(gain(np.zeros((2, 2)), 0.01), [1], [1])
    value, slope, curvature = scalings._mean(np.ones(1), 1.0, np.zeros(1))
    assert value == pytest.approx(0.5 * np.log(1e-300))
    assert np.isfinite(slope).all() and np.isfinite(curvature).all()
    assert scalings.least(np.ones(1), 1.0, np.zeros(1))[0] == 0.0


@pytest.mark.parametrize("size", [1.0, 3.0])
def test_singular_values_that_are_nearly_equal_count_as_a_millionth_apart(size):
    """Of diag(1, 1 - 1e-9) R with R a turn by 45 degrees: the first left vector turns by -2 cos sin = -1."""
    turn = np.array([[1.0, -1.0], [1.0, 1.0]]) * 0.5**0.5
    G = gain(size * np.diag([1.0, 1 - 1e-9]) @ turn, 0.01)
    _, slope, curvature = ConstantScalings(G, [1, 1], [1, 1], 1)._mean(np.ones(2), 1.0, np.zeros(1))
    # Block 2 has none of u, and half of v; |turned|^2 over the gap is 1e6.
    assert slope == pytest.approx([-0.5]) and curvature[0, 0] == pytest.approx(1e6, rel=1e-5)


# ---------------------------------------------------------------- how


class ScriptedMean(ConstantScalings):
    """Scalings with a given mean as a function of the logarithms: value, slope and second derivatives."""

    def __init__(self, mean, n: int):
        super().__init__(gain(np.eye(n), 0.01), [1] * n, [1] * n)
        self.mean, self.asked = mean, []

    def _mean(self, sizes, rest, log_constants):
        assert len(self.asked) < 200
        self.asked.append(np.array(log_constants))
        value, slope, curvature = self.mean(np.array(log_constants))
        return value, np.atleast_1d(slope).astype(float), np.atleast_2d(curvature).astype(float)

    def search(self, start, only_whether: bool = False) -> np.ndarray:
        start = np.atleast_1d(np.array(start, dtype=float))
        return self._least_mean(np.ones(len(start)), 1.0, start, only_whether)


def bowl(H, centre, least: float = 0.0):
    H, centre = np.atleast_2d(H), np.atleast_1d(centre)
    return lambda x: (least + 0.5 * (x - centre) @ H @ (x - centre), H @ (x - centre), H)


@pytest.mark.parametrize("H", [0.25, 2.0])
def test_newtons_step_is_that_of_a_curvature_and_a_little_more(H):
    """The root of EPS, times what is larger: the largest second derivative or 1."""
    one = ScriptedMean(bowl(H, 3.0), 1)
    one.search(0.5)
    little = EPS**0.5 * max(H, 1.0)
    assert one.asked[1][0] - 3.0 == pytest.approx(-2.5 * little / (H + little), rel=1e-6)


def test_the_largest_second_derivative_counts_by_its_size():
    """Of [[2, -3], [-3, 2]] along (1, -1) the curvature is 5 and the largest entry 3."""
    H, slope = np.array([[2.0, -3.0], [-3.0, 2.0]]), np.array([1.0, -1.0])
    one = ScriptedMean(lambda x: (-len(one.asked), slope, H), 2)
    one.search([0.0, 0.0])
    np.testing.assert_allclose(one.asked[1], -slope / (5 + 3 * EPS**0.5), rtol=1e-11)


def test_a_step_is_at_most_four_long_in_each_constant():
    one = ScriptedMean(bowl(np.eye(2), [10.0, -5.0]), 2)
    assert one.search([0.0, 0.0]) == pytest.approx([10.0, -5.0])
    np.testing.assert_allclose(one.asked[:4], [[0, 0], [4, -2], [8, -4], [10, -5]], atol=1e-6)
    one = ScriptedMean(bowl(np.eye(2), [-3.0, -10.0]), 2)
    one.search([0.0, 0.0])
    np.testing.assert_allclose(one.asked[1], [-1.2, -4.0], atol=1e-6)


def test_a_constant_at_its_farthest_moves_inwards_alone():
    """A constant at its limit does not influence the others, although they are coupled. Starts are limited to
    it."""
    H = np.array([[1.0, 0.5], [0.5, 1.0]])
    one = ScriptedMean(bowl(H, [40.0, 1.0]), 2)
    minimum = one.search([90.0, 0.0])
    # Of the other alone the slope is x - 1 + (30 - 40) / 2: least at 6, in a step of 4 and one of 2.
    np.testing.assert_allclose(one.asked[:3], [[30, 0], [30, 4], [30, 6]], atol=1e-6)
    assert minimum == pytest.approx([30.0, 6.0])
    other = ScriptedMean(bowl(H, [-40.0, -1.0]), 2)
    assert other.search([-90.0, 0.0]) == pytest.approx([-30.0, -6.0])
    np.testing.assert_allclose(other.asked[:3], [[-30, 0], [-30, -4], [-30, -6]], atol=1e-6)
    for sign in (1.0, -1.0):
        outwards = ScriptedMean(bowl(np.eye(2), [sign * 33.0, 0.0]), 2)
        assert outwards.search([sign * 27.0, 0.0]).tolist() == [sign * 30.0, 0.0]
        near = ScriptedMean(bowl(np.eye(2), [sign * 33.0, 0.0]), 2)
        assert near.search([sign * 29.5, 0.0]).tolist() == [sign * 30.0, 0.0]
        inwards = ScriptedMean(bowl(np.eye(2), [sign * 29.99, 0.0]), 2)
        assert inwards.search([sign * 30.0, 0.0])[0] == pytest.approx(sign * 29.99, abs=1e-6)
    # One without a slope of its own stays as well.
    still = ScriptedMean(lambda x: (-len(still.asked), np.array([0.0, 1.0]), H), 2)
    still.search([30.0, 0.0])
    np.testing.assert_allclose(still.asked[1], [30.0, -1.0], atol=1e-6)


def test_the_search_ends_where_a_step_promises_less_than_is_told(monkeypatch):
    """Slope 2^-10 at a curvature that with the little more is 1: a step promises 2^-20."""
    slope, curvature = 2.0**-10, 1 - EPS**0.5

    def asked(least_gain):
        monkeypatch.setattr(constant_scalings, "LEAST_GAIN", least_gain)
        one = ScriptedMean(lambda x: (-float(len(one.asked)), slope, curvature), 1)
        one.search(0.0)
        return len(one.asked)

    assert asked(2.0**-20) == 1 + 40 and asked(2.0**-20 * (1 + EPS)) == 1


def test_a_search_that_asks_only_whether_ends_where_the_mean_says_so():
    """The largest of 161 values is at most the mean times the 300th root of 161."""
    border = -np.log(161) / 300
    for least, ends in ((border, False), (border * (1 + 1e-12), True)):
        for only_whether in (False, True):
            one = ScriptedMean(lambda x, least=least: (least if x[0] == 0 else 9.0, 1e-3, 0.1), 1)
            one.search(0.0, only_whether)
            assert (len(one.asked) == 1) == (ends and only_whether)


def test_a_step_must_keep_a_ten_thousandth_of_its_promise_and_shortens_by_the_cubic():
    """A step of -2 promises 4, from the value 3. The values of its trials are scripted, less 3."""
    first, share = (0.0, 2.0, 1 - EPS**0.5), _shorter(2.0, 4.0, 8.0)
    assert 0.05 < share < 0.5

    def asked(*later):
        values = [first, *later]

        def mean(x):
            k = len(one.asked) - 1
            return (3.0 + values[k][0], *values[k][1:]) if k < len(values) else (9.0, 0, 1)

        one = ScriptedMean(mean, 1)
        minimum = one.search(0.0)
        return [x[0] for x in one.asked], minimum[0]

    flat, steep = (0.0, 1.0), (-4.0, 1.0)
    points, x_end = asked((-4.001e-4, *flat))
    assert points == [0.0, -2.0] and x_end == -2.0
    points, _ = asked((-3.999e-4, *steep), (-1.0, *flat))
    assert points[:3] == pytest.approx([0.0, -2.0, -2 * _shorter(-3.999e-4, 4.0, 8.0)])
    # After the first cut the promise is the share's: what it must keep is less.
    points, x_end = asked((2.0, *steep), (-4.001e-4 * share, *flat))
    assert points == pytest.approx([0.0, -2.0, -2 * share]) and x_end == pytest.approx(-2 * share)
    points, _ = asked((2.0, *steep), (-3.999e-4 * share, *steep), (-1.0, *flat))
    again = _shorter(-3.999e-4 * share, 4 * share, 8 * share)
    assert points[:4] == pytest.approx([0.0, -2.0, -2 * share, -2 * share * again])
    # Just as much is not enough.
    at_border = 0.0 - 1e-4 * 4.0
    one = ScriptedMean(
        lambda x: (0.0 if x[0] == 0 else at_border, 2.0 if x[0] == 0 else 0.0, 1 - EPS**0.5), 1
    )
    assert -1.0 <= one.search(0.0)[0] < 0.0


def test_a_step_is_shortened_thirty_times_at_most():
    one = ScriptedMean(lambda x: (0.0 if x[0] == 0.0 else 1.0, 1.0, 1.0), 1)
    assert one.search(0.0).tolist() == [0.0] and len(one.asked) == 1 + 30


@pytest.mark.parametrize(("change", "slope"), [(1.0, 0.5), (0.2, 1.0), (0.5, 3.0), (0.05, 1.5), (2.0, 3.0)])
def test_the_shorter_step_ends_where_the_cubic_is_least(change, slope):
    """Of value 0 and slope -1 at 0, ``change`` and ``slope`` at 1."""
    cubic = [slope - 1 - 2 * change, 3 * change + 2 - slope, -1.0, 0.0]
    assert np.polyval(cubic, 1) == pytest.approx(change)
    t = np.linspace(0, 1, 100001)
    best = t[np.argmin(np.polyval(cubic, t))]
    assert _shorter(change, 1.0, slope) == pytest.approx(np.clip(best, 0.05, 0.5), abs=2e-5)
    assert _shorter(3 * change, 3.0, 3 * slope) == pytest.approx(_shorter(change, 1.0, slope))


def test_the_shorter_step_is_a_twentieth_to_a_half():
    assert _shorter(1e9, 1.0, 1e9) == 0.05 and _shorter(0.0, 1.0, 3.0) == 0.5
