"""The H∞ norm: closed forms, poles fourteen decades apart, resonances that no grid would hit."""

import numpy as np
import pytest

from lpvguard.engine.synthesis.interconnection import rational, zeros_poles
from lpvguard.engine.synthesis.norms import hinf_norm
from lpvguard.engine.synthesis.statespace import StateSpace, append, gain, series, to_discrete


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
    assert np.isclose(discrete.peak_frequency, 40 * np.arctan(continuous.peak_frequency / 40), rtol=1e-3)


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
