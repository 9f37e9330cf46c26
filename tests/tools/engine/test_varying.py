"""Loops that vary from sample to sample, against their whole matrix, finite differences and enumeration."""

import itertools

import numpy as np
import pytest
from scipy.linalg import expm

from lpvguard.engine.synthesis.errors import SynthesisError
from lpvguard.engine.synthesis.lpv_certificate import Family
from lpvguard.engine.synthesis.statespace import StateSpace, append, lft
from lpvguard.engine.synthesis.varying import History, OverSpeed, all_pass, close, steered

N, P, M, T = 3, 2, 2, 12
TS = 0.05


def stack(count: int = 4) -> np.ndarray:
    random = np.random.default_rng(3)
    S = random.standard_normal((count, N + P, N + M))
    S[:, :N, :N] *= 0.4
    return S


def history() -> History:
    return History(stack(), np.random.default_rng(4).integers(0, 4, T), N)


def whole(one: History) -> np.ndarray:
    """The map from all inputs to all outputs, (T p, T m)."""
    inputs = np.eye(T * M).reshape(T * M, T, M)
    return np.array([one.states(w)[1].ravel() for w in inputs]).T


def test_the_gain_is_the_largest_singular_value_of_the_whole_map_and_its_input_reaches_it():
    one = history()
    start = np.random.default_rng(5).standard_normal((T, M))
    gain, w = one.gain(start, 20)
    assert gain == pytest.approx(np.linalg.norm(whole(one), 2), rel=1e-9)
    assert np.linalg.norm(one.states(w)[1]) == pytest.approx(gain) and np.linalg.norm(w) == pytest.approx(1)
    assert one.gain(start, 1)[0] < 0.99 * gain  # a search that ends early reaches less, never more


def test_a_loop_that_no_input_moves_has_gain_0():
    S = stack()
    S[:, N:] = 0
    assert History(S, np.zeros(T, int), N).gain(np.ones((T, M)))[0] == 0


def test_costates_are_the_adjoint():
    one, random = history(), np.random.default_rng(6)
    z = random.standard_normal((T, P))
    assert one.costates(z)[1].ravel() == pytest.approx(whole(one).T @ z.ravel())


def test_growth_is_the_largest_eigenvalue_of_a_period():
    one = history()
    X = np.eye(N)
    for k in one.index:
        X = one.S[k][:N, :N] @ X
    assert one.growth() == pytest.approx(np.abs(np.linalg.eigvals(X)).max())
    large = History(3 * np.eye(N + P, N + M)[None], np.zeros(400, int), N)
    assert np.log(large.growth()) == pytest.approx(400 * np.log(3))


def test_slopes_are_derivatives_by_the_parameter_of_every_sample():
    S, random = np.array([stack()[0]] * T), np.random.default_rng(7)
    dS, w, step = random.standard_normal(S.shape), random.standard_normal((T, M)), 1e-6
    slopes = History(S, np.arange(T), N).slopes(dS, w)
    for k in range(T):
        energy = []
        for sign in (1, -1):
            moved = S.copy()
            moved[k] += sign * step * dS[k]
            energy.append(0.5 * np.sum(History(moved, np.arange(T), N).states(w)[1] ** 2))
        assert slopes[k] == pytest.approx((energy[0] - energy[1]) / (2 * step), rel=1e-5, abs=1e-5)


def test_delta_is_closed_as_by_an_lft_and_a_direct_term_is_refused():
    S = stack(1)
    S[:, N : N + 1, N : N + 1] = 0
    delta = StateSpace([[0.3, 0.1], [0.0, -0.5]], [[1.0], [0.4]], [[0.2, 0.7]], [[0.9]], TS)
    closed = close(S, N, delta)[0]
    G = StateSpace(S[0, :N, :N], S[0, :N, N:], S[0, N:, :N], S[0, N:, N:], TS)
    turned = lft(G.select([1, 0], [1, 0]), delta)
    order = N + delta.order
    turned_by_hand = StateSpace(closed[:order, :order], closed[:order, order:], closed[order:, :order],
                       closed[order:, order:], TS)  # fmt: skip
    omega = [0.0, 1.0, 20.0]
    assert turned_by_hand.response(omega) == pytest.approx(turned.response(omega))
    S[:, N, N] = 1e-3
    with pytest.raises(SynthesisError, match="direct term"):
        close(S, N, delta)


def over() -> tuple[Family, OverSpeed]:
    """A vehicle of two states whose stiffness follows the speed, and a third state that is affine between
    nodes."""

    def at(v: float) -> StateSpace:
        hold = expm(np.array([[0.0, 1.0, 0.0], [-1.0 - v, -0.6, 1.0], [0, 0, 0]]) * TS)
        A = np.zeros((3, 3))
        A[:2, :2], A[2] = hold[:2, :2], [0.1, 0.0, 0.5 + 0.1 * abs(v - 2)]
        B = np.vstack([hold[:2, 2:], [[v]]])
        C = np.vstack([[1.0, 0.0, 0.3], np.eye(2, 3), np.zeros(3)])
        return StateSpace(A, B, C, np.array([[0.0], [0.0], [0.0], [1.0]]), TS)

    family = Family(
        at, np.array([1.0, 2.0, 4.0]), slice(0, 2), 3, lambda low, high: (np.eye(2), np.eye(2)), TS
    )
    return family, OverSpeed(family)


def test_matrices_over_speed_are_those_of_the_family_and_so_is_their_derivative():
    family, over_speed = over()
    speeds = np.array([1.0, 1.03, 1.97, 2.0, 3.3, 4.0])
    for v, S in zip(speeds, over_speed.at(speeds), strict=True):
        G = family.loop(v)
        assert pytest.approx(np.block([[G.A, G.B], [G.C, G.D]]), abs=1e-9) == S
    inner, step = np.array([1.4, 2.7, 3.9]), 1e-6
    by_difference = (over_speed.at(inner + step) - over_speed.at(inner - step)) / (2 * step)
    assert over_speed.derivative(inner) == pytest.approx(by_difference, abs=1e-7)
    for v in (0.99, 4.01):
        with pytest.raises(SynthesisError, match="1 to 4 m/s"):
            over_speed.at(np.array([2.0, v]))


@pytest.mark.parametrize("sign", [1.0, -1.0])
@pytest.mark.parametrize("corner", [np.inf, 0.3, 8.0])
def test_an_all_pass_has_gain_1_everywhere_and_its_sign_at_zero(sign, corner):
    one = all_pass(sign, corner, TS)
    values = one.response(np.linspace(0, np.pi / TS, 50))[:, 0, 0]
    assert np.abs(values) == pytest.approx(np.ones(50)) and values[0] == pytest.approx(sign)
    if np.isfinite(corner):
        assert one.stability_margin() > 0
        warped = 2 / TS * np.arctan(corner * TS / 2)
        assert one.response([warped])[0, 0, 0] == pytest.approx(-1j * sign)
    assert append(one, one).n_inputs == 2


@pytest.mark.unhurried
@pytest.mark.parametrize("moves", [1, 2])
def test_the_favoured_places_are_the_best_of_all_that_move_so_little(moves):
    random, places, length = np.random.default_rng(8), 4, 6
    for _ in range(20):
        slope = random.standard_normal(length)
        places_found = steered(slope, moves, places)
        assert (
            np.abs(np.diff(places_found)).max() <= moves
            and places_found.min() >= 0
            and places_found.max() < places
        )
        best = max(
            float(np.dot(slope, way))
            for way in itertools.product(range(places), repeat=length)
            if np.abs(np.diff(way)).max() <= moves
        )
        assert float(slope @ places_found) == pytest.approx(best, abs=1e-5)


def tall() -> History:
    """3 outputs and 1 input."""
    random = np.random.default_rng(9)
    S = random.standard_normal((4, N + 3, N + 1))
    S[:, :N, :N] *= 0.4
    return History(S, random.integers(0, 4, T), N)


def test_outputs_and_inputs_may_be_of_different_number():
    one = tall()
    assert one.shape == (3, 1)
    every = np.array([one.states(w)[1].ravel() for w in np.eye(T).reshape(T, T, 1)]).T
    z = np.random.default_rng(6).standard_normal((T, 3))
    both, w = one.costates(z)
    assert w.ravel() == pytest.approx(every.T @ z.ravel()) and both.shape == (T, N + 3)
    np.testing.assert_array_equal(both[:, N:], z)
    np.testing.assert_array_equal(both[-1, :N], 0)
    gain, w = one.gain(np.ones((T, 1)), 12)
    assert gain == pytest.approx(np.linalg.norm(every, 2), rel=1e-9) and w.shape == (T, 1)
    x, _ = one.states(w)
    np.testing.assert_array_equal(x[:, N:], w)
    for k in range(T - 1):
        np.testing.assert_allclose(x[k + 1, :N], (one.S[one.index[k]] @ x[k])[:N])


def test_a_map_of_few_directions_ends_the_iteration():
    """One sample alone has outputs, at once: its matrix is the whole map."""
    S = np.zeros((2, N + 2, N + 2))
    S[1, N:, N:] = [[3.0, 1.0], [0.0, 2.0]]
    index = np.zeros(T, int)
    index[4] = 1
    one = History(S, index, N)
    gain, w = one.gain(np.ones((T, 2)))
    assert gain == pytest.approx(np.linalg.norm(S[1, N:, N:], 2), rel=1e-12)
    assert np.linalg.norm(w) == pytest.approx(1) and np.linalg.norm(w[4]) == pytest.approx(1)
    assert np.linalg.norm(History(0 * S, index, N).gain(np.full((T, 2), 5.0))[1]) == pytest.approx(1)


def test_growth_is_kept_within_what_a_double_holds():
    tripled = 3 * np.eye(N + P, N + M)[None]
    assert History(tripled, np.zeros(2000, int), N).growth() == np.exp(700)
    # Scaled down on the way, but not before 1e100: 250 samples come to 1e119.
    for samples in (200, 215, 250):
        grown = History(tripled, np.zeros(samples, int), N).growth()
        assert np.log(grown) == pytest.approx(samples * np.log(3), rel=1e-12)
    turned = np.concatenate([-tripled, tripled])
    assert History(turned, np.r_[0, np.ones(2000, int)], N).growth() == np.exp(700), "all entries below 0"
    mixed = np.array([np.diag([2.0, -5.0, 1.0, 0.0, 0.0]), np.diag([3.0, 0.1, 1.0, 0.0, 0.0])])
    assert History(mixed, np.array([0, 1]), N).growth() == pytest.approx(6.0)


@pytest.mark.parametrize(("q", "r"), [(2, 1), (1, 2)])
def test_delta_may_have_more_inputs_than_outputs_and_fewer(q, r):
    random = np.random.default_rng(10)
    S = random.standard_normal((2, N + q + 2, N + r + 2))
    S[:, N : N + q, N : N + r] = 0
    delta = StateSpace(
        np.diag([0.3, -0.2]), *(random.standard_normal(s) for s in ((2, q), (r, 2), (r, q))), TS
    )
    for one, closed in zip(S, close(S, N, delta), strict=True):
        G = StateSpace(one[:N, :N], one[:N, N:], one[N:, :N], one[N:, N:], TS)
        turned = lft(G.select([*range(q, q + 2), *range(q)], [*range(r, r + 2), *range(r)]), delta)
        order = N + 2
        turned_by_hand = StateSpace(closed[:order, :order], closed[:order, order:], closed[order:, :order],
                           closed[order:, order:], TS)  # fmt: skip
        assert turned_by_hand.response([0.0, 1.0, 20.0]) == pytest.approx(turned.response([0.0, 1.0, 20.0]))
    S[1, N + q - 1, N] = 1e-3
    with pytest.raises(SynthesisError, match="direct term"):
        close(S, N, delta)


def test_an_all_pass_may_have_another_size():
    assert np.abs(all_pass(0.5, 3.0, TS).response([0.0, 2.0, 40.0])[:, 0, 0]) == pytest.approx(0.5)
    assert all_pass(0.5, np.inf, TS).D.tolist() == [[0.5]]


def test_small_slopes_count_before_large_ones():
    """Whatever a million times larger follows, once there is time to go to its best place."""
    small = 1e-3 * np.random.default_rng(11).standard_normal(25)
    slope = np.concatenate([small, np.zeros(6), np.full(40, 1e6)])
    np.testing.assert_array_equal(steered(slope, 1, 5)[:24], steered(small, 1, 5)[:24])


def test_at_a_node_the_interval_that_begins_there_counts_and_at_the_last_the_one_before():
    family, over_speed = over()
    after = over_speed.derivative(np.array([1.0, 2.0]))
    before = over_speed.derivative(np.array([4.0]))[0]
    # The third state's own coupling is 0.5 + 0.1 |v - 2|: it falls up to 2 m/s and rises from there.
    assert after[:, 2, 2] == pytest.approx([-0.1, 0.1]) and before[2, 2] == pytest.approx(0.1)
    assert over_speed.n == 3 and len(over_speed.at_nodes) == 3
    middle = family.loop(2.5)  # the vehicle's rows are followed between the nodes, not interpolated
    assert over_speed.at(np.array([2.5]))[0][:2] == pytest.approx(
        np.hstack([middle.A[:2], middle.B[:2]]), abs=1e-9
    )
