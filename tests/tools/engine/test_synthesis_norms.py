"""The H∞ norm: closed forms, poles fourteen decades apart, resonances that no grid would hit."""

import numpy as np
import pytest

from lpvguard.engine.synthesis.interconnection import rational, zeros_poles
from lpvguard.engine.synthesis.norms import _crossings, _sizes, axis_frequencies, hinf_norm
from lpvguard.engine.synthesis.statespace import EPS, StateSpace, append, gain, series, to_discrete


@pytest.mark.parametrize("zeta", [0.5, 1e-2, 1e-4, 1e-7])
def test_second_order_peak_is_the_closed_form(zeta):
    bracket = hinf_norm(rational([1.0], [1.0, 2 * zeta, 1.0]))
    peak = 1 / (2 * zeta * np.sqrt(1 - zeta**2))
    assert bracket.lower <= peak * (1 + 1e-8) and bracket.upper >= peak * (1 - 1e-8)
    assert bracket.upper <= bracket.lower * (1 + 1e-5)
    assert np.isclose(bracket.peak_frequency, np.sqrt(1 - 2 * zeta**2), rtol=1e-3)


def test_all_pass_has_norm_one_and_is_not_read_lower():
    bracket = hinf_norm(series(rational([1.0, -2.0], [1.0, 2.0]), rational([1.0, -1e-4], [1.0, 1e-4])))
    assert bracket.lower <= 1 + 1e-9 and 1 - 1e-9 <= bracket.upper <= 1 + 2e-6


def test_peaks_at_dc_and_at_infinity_are_found_exactly():
    low = hinf_norm(zeros_poles(3.0, [], [2e-5]))
    assert low.peak_frequency == 0 and np.isclose(low.lower, 3.0, rtol=1e-12) and low.upper <= 3 * (1 + 1e-5)
    high = hinf_norm(zeros_poles(0.1, [2e-5], [10.0]))
    assert high.peak_frequency == np.inf and np.isclose(high.lower, 0.1 * 10 / 2e-5)


def test_a_resonance_between_poles_at_1e_minus_5_and_1e8_is_not_lost():
    resonance = rational([1.0], [1.0, 2e-6, 1.0])
    G = append(zeros_poles(1e4, [], [1e-5]), resonance, zeros_poles(1.0, [1e3], [1e8]))
    bracket = hinf_norm(G)
    assert np.isclose(bracket.lower, 5e5, rtol=1e-6) and bracket.upper <= 5e5 * (1 + 1e-5)


def test_the_bracket_of_a_discrete_system_is_that_of_its_tustin_image():
    G = rational([1.0, 3.0], [1.0, 0.02, 4.0])
    continuous, discrete = hinf_norm(G), hinf_norm(to_discrete(G, 0.05))
    assert np.isclose(continuous.upper, discrete.upper, rtol=1e-6)
    assert np.isclose(discrete.peak_frequency, 40 * np.arctan(continuous.peak_frequency / 40), rtol=1e-5)


@pytest.mark.parametrize("seed", range(6))
def test_the_bracket_reaches_over_the_rounding_of_a_loop_near_instability(seed):
    """Damping of 2⁻⁴² in coordinates whose entries are of order one: each is known to 2⁻⁵² only."""
    damping = 2.0**-42
    G = StateSpace([[-damping, 1.0], [-1.0, -damping]], np.eye(2), np.eye(2), np.zeros((2, 2)))
    bracket = hinf_norm(G.transformed(np.random.default_rng(seed).standard_normal((2, 2))))
    assert bracket.upper >= 1 / damping
    assert hinf_norm(G).upper <= 1.01 / damping


def test_unstable_and_marginal_systems_have_no_norm():
    assert hinf_norm(StateSpace([[0.1]], [[1.0]], [[1.0]], [[0.0]])).upper == np.inf
    assert hinf_norm(StateSpace([[0.0]], [[1.0]], [[1.0]], [[0.0]])).upper == np.inf
    assert hinf_norm(StateSpace([[1.01]], [[1.0]], [[1.0]], [[0.0]], 0.1)).upper == np.inf


def test_constants_and_zero_systems_are_exact():
    assert hinf_norm(gain([[3.0, 4.0]])).lower == pytest.approx(5.0, rel=1e-14)
    assert hinf_norm(StateSpace([[-1.0]], [[0.0]], [[1.0]], [[0.0]])).upper == 0.0


def test_a_slow_pole_that_large_entries_hide_widens_the_bracket():
    """Dense coordinates move the pole at 2e-5 rad/s by a part of itself: the norm at DC is known no better
    than that."""
    rng = np.random.default_rng(2)
    G = StateSpace(
        np.diag([-2e-5, -1.0, -30.0, -2e4]), [[2e-5], [1.0], [30.0], [2e4]], [[0.99, 0.3, 0.2, -0.2]], [[0.0]]
    )
    U, V = (np.linalg.qr(rng.standard_normal((4, 4)))[0] for _ in range(2))
    calm, dense = hinf_norm(G), hinf_norm(G.transformed(U @ np.diag(np.geomspace(1, 1e3, 4)) @ V))
    assert calm.upper <= calm.lower * (1 + 2e-6)
    assert dense.upper >= calm.lower and dense.upper > dense.lower * (1 + 1e-3)


def random_system(rng: np.random.Generator, n: int, n_outputs: int, n_inputs: int) -> StateSpace:
    """Stable, with resonances of a damping down to 2 %, and a direct term of the size of the rest."""
    A = rng.standard_normal((n, n))
    A -= (np.linalg.eigvals(A).real.max() + rng.uniform(0.02, 0.5)) * np.eye(n)
    B, C = rng.standard_normal((n, n_inputs)), rng.standard_normal((n_outputs, n))
    return StateSpace(A, B, C, rng.uniform(0.0, 2.0) * rng.standard_normal((n_outputs, n_inputs)))


def largest_at(G: StateSpace, omega) -> np.ndarray:
    """Largest singular values (K,) of C (j omega - A)^-1 B + D at ``omega`` (K,), of D at infinity."""
    omega = np.atleast_1d(omega)
    finite = np.where(np.isfinite(omega), omega, 0.0)[:, None, None]
    states = np.linalg.solve(
        1j * finite * np.eye(len(G.A)) - G.A, np.tile(G.B.astype(complex), (len(omega), 1, 1))
    )
    return np.linalg.norm(
        np.where(np.isfinite(omega)[:, None, None], G.C @ states, 0.0) + G.D, 2, axis=(1, 2)
    )


@pytest.mark.parametrize("shape", [(1, 1), (2, 3), (3, 2), (1, 4), (4, 1), (3, 3)])
def test_the_bracket_holds_the_largest_singular_value_of_random_systems(shape):
    rng = np.random.default_rng(sum(shape) + 7 * shape[0])
    for n in (1, 2, 3, 5, 8):
        G = random_system(rng, n, *shape)
        bracket = hinf_norm(G)
        most = largest_at(G, np.concatenate([[0.0, np.inf], np.geomspace(1e-3, 1e3, 1500)])).max()
        assert most <= bracket.upper <= bracket.lower * (1 + 1e-6) * (1 + 1e-9)
        assert bracket.lower == pytest.approx(largest_at(G, bracket.peak_frequency)[0], rel=1e-11)
        assert bracket.peak_frequency >= 0
        transposed = hinf_norm(StateSpace(G.A.T, G.C.T, G.B.T, G.D.T))
        assert transposed.lower == pytest.approx(bracket.lower, rel=2e-6)
        discrete = hinf_norm(to_discrete(G, 0.4))
        assert discrete.lower == pytest.approx(bracket.lower, rel=2e-6)
        assert np.isinf(bracket.peak_frequency) or discrete.peak_frequency < np.pi / 0.4


@pytest.mark.parametrize("shape", [(1, 1), (2, 3), (3, 2), (3, 3)])
def test_a_level_is_crossed_where_a_singular_value_is_that_level(shape):
    """Below the norm every point where the largest singular value meets the level is among those found; above
    it there is none.
    """
    rng = np.random.default_rng(3 + shape[0])
    for n in (2, 4, 6):
        G = random_system(rng, n, *shape)
        bracket = hinf_norm(G)
        grid = np.geomspace(1e-3, 1e3, 4000)
        values, ends = largest_at(G, grid), largest_at(G, [0.0, np.inf]).max()
        for share in (0.3, 0.7, 0.95):
            level = ends + share * (bracket.lower - ends)
            crossed = np.flatnonzero(np.diff(values > level))
            crossings = _crossings(G, level)
            for k in crossed:
                near = (crossings >= grid[k] * (1 - 1e-6)) & (crossings <= grid[k + 1] * (1 + 1e-6))
                assert near.any(), (n, share, grid[k])
        assert _crossings(G, 1.01 * bracket.upper).size == 0
    assert _crossings(gain(np.ones(shape)), 2.0).size == 0


def test_a_first_order_lag_crosses_each_level_below_its_gain():
    G = rational([3.0], [2.0, 1.0])  # 3 / (2 s + 1)
    for level in (0.1, 1.0, 2.9):
        assert np.isclose(_crossings(G, level), np.sqrt((3 / level) ** 2 - 1) / 2, rtol=1e-9).any()
    assert _crossings(G, 3.1).size == 0


def test_a_pole_is_looked_for_on_the_axis_alone():
    """j times the slow pair is 0.1 beside the pole at -2: there the response is twenty times the norm."""
    G = append(rational([0.001], [1.0, 0.2, 4.01]), rational([1.0], [1.0, 2.0]))
    assert hinf_norm(G).lower == pytest.approx(0.5, rel=1e-6)


def test_a_system_whose_input_does_not_reach_its_output_has_norm_zero():
    G = StateSpace(np.diag([-1.0, -2.0]), [[1.0], [0.0]], [[0.0, 1.0]], [[0.0]])
    bracket = hinf_norm(G)
    assert bracket.lower == 0.0 and bracket.upper <= 1e-99


def with_eigenvalues(*pairs: complex) -> np.ndarray:
    """A real matrix with these eigenvalues and their conjugates."""
    out = np.zeros((2 * len(pairs), 2 * len(pairs)))
    for k, value in enumerate(pairs):
        out[2 * k : 2 * k + 2, 2 * k : 2 * k + 2] = [[value.real, value.imag], [-value.imag, value.real]]
    return out


def test_frequencies_on_the_axis_stand_with_dc_those_between_and_one_above():
    three = with_eigenvalues(1j, 4j, 9j, 1 + 2j, -1 + 2j)
    frequencies = axis_frequencies(three, 1.0)
    between, geometric = [0.5, 2.5, 6.5], [2.0, 6.0]
    np.testing.assert_allclose(frequencies, [0.0, 1.0, 4.0, 9.0, *between, *geometric, 18.0], rtol=1e-12)
    np.testing.assert_allclose(axis_frequencies(with_eigenvalues(3j), 1.0), [0.0, 3.0, 1.5, 6.0], rtol=1e-12)
    two = [0.0, 2.0, 8.0, 1.0, 5.0, 4.0, 16.0]
    np.testing.assert_allclose(axis_frequencies(with_eigenvalues(2j, 8j), 1.0), two, rtol=1e-12)
    assert axis_frequencies(with_eigenvalues(1 + 2j, -1 + 2j), 1.0).size == 0


@pytest.mark.parametrize("sign", [1, -1])
def test_near_the_axis_is_a_thousandth_of_an_eigenvalue_and_what_rounding_of_a_moves(sign):
    for size in (0.05, 1.0, 40.0):
        inside, outside = (with_eigenvalues(size * (sign * share + 1j)) for share in (0.99e-3, 1.01e-3))
        assert axis_frequencies(inside, 1.0)[1] == pytest.approx(size)
        assert axis_frequencies(outside, 1.0).size == 0
    # An eigenvalue on the real axis, where a thousandth of it says nothing: by the size of A alone.
    for scale in (1.0, 1e6):
        limit = 100 * EPS * scale / (1 - 1e-3)
        assert axis_frequencies(np.array([[sign * 0.999 * limit]]), scale).tolist() == [0.0, 0.0]
        assert axis_frequencies(np.array([[sign * 1.001 * limit]]), scale).size == 0


def _rounding(G: StateSpace, omega: float) -> float:
    return float(_sizes(G, np.array([omega]))[1][0])


def test_rounding_of_a_moves_the_response_entry_by_entry():
    rng = np.random.default_rng(8)
    G, omega = random_system(rng, 3, 2, 2), 0.7
    inverse = np.linalg.inv(1j * omega * np.eye(3) - G.A)
    left, right = np.abs(G.C @ inverse), np.abs(inverse @ G.B)
    moved = np.zeros((2, 2))
    for i in range(3):
        for k in range(3):
            moved += np.outer(left[:, i], right[k]) * abs(G.A[i, k])
    want = 8 * 2.0**-52 * np.sqrt((moved**2).sum())
    assert _rounding(G, omega) == pytest.approx(want, rel=1e-9, abs=0.0)
    assert _rounding(G, np.inf) == 0.0 == _rounding(gain([[3.0]]), 1.0)
    one = StateSpace([[-2.0]], [[3.0]], [[5.0]], [[0.0]])
    assert _rounding(one, 1.0) == pytest.approx(8 * 2.0**-52 * 5 * 3 * 2 / 5, rel=1e-9, abs=0.0)


def test_a_norm_reaches_over_the_rounding_of_a_pole_that_large_entries_hide():
    slow = 1e-12  # DC is 1, and a rounding of A by 8 units moves it by 8 EPS of itself
    G = append(
        StateSpace([[-slow]], [[slow]], [[1.0]], [[0.0]]), StateSpace([[-1.0]], [[1.0]], [[0.5]], [[0.0]])
    )
    dense = G.transformed(np.array([[1.0, 0.6], [0.4, 1.0]]))
    values, moved = _sizes(dense, np.array([np.inf, 2.0, 0.0]))
    assert values[1:] == pytest.approx([largest_at(dense, w)[0] for w in (2.0, 0.0)], rel=1e-6)
    assert values[2] + moved[2] > 1 + 1e-4
    assert (values[0], moved[0]) == (0.0, 0.0)
    assert hinf_norm(dense).upper >= (values[2] + moved[2]) * (1 - 1e-2)


MIX = np.array([[1.0, 0.6, -0.3], [0.4, 1.0, 0.5], [-0.2, 0.7, 1.0]])
"""Coordinates in which a slow pole hides in entries of order one."""


def test_a_norm_reaches_over_the_rounding_of_a_slow_pole_far_below_its_peak():
    """DC is 0.999, known to a fifth; the peak of 1 lies at 1 rad/s and is known to all digits."""
    slow = StateSpace([[-1e-12]], [[1e-12]], [[0.999]], [[0.0]])
    dense = append(slow, rational([0.2, 0.0], [1.0, 0.2, 1.0])).transformed(MIX)
    bracket = hinf_norm(dense)
    values, moved = _sizes(dense, np.array([0.0, 1.0]))
    assert bracket.peak_frequency == pytest.approx(1.0, rel=1e-6) and moved[0] > 0.1 > 1e-9 > moved[1]
    assert bracket.upper >= (values[0] + moved[0]) * (1 - 1e-2)


@pytest.mark.parametrize("damping", np.linspace(0.1, 0.3, 40))
def test_a_norm_reaches_over_the_rounding_at_its_peak(damping):
    """The peak lies below the frequencies of its poles, where rounding moves less."""
    slow = rational([1e-16], [1.0, 2e-8 * damping, 1e-16])
    dense = append(slow, StateSpace([[-1.0]], [[1.0]], [[0.5]], [[0.0]])).transformed(MIX)
    bracket = hinf_norm(dense)
    values, moved = _sizes(dense, np.array([bracket.peak_frequency]))
    assert moved[0] > 1e-3 * values[0] and bracket.upper >= (1 - 1e-5) * (values[0] + moved[0])


def test_a_response_at_a_pole_on_the_axis_is_refused():
    with pytest.raises(np.linalg.LinAlgError, match="a pole on the imaginary axis"):
        _sizes(StateSpace([[0.0]], [[1.0]], [[1.0]], [[0.0]]), np.array([1.0, 0.0]))
