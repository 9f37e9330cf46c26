"""State-space algebra: each operation against the transfer functions it claims to form."""

import numpy as np
import pytest

from lpvguard.engine.synthesis.errors import SynthesisError
from lpvguard.engine.synthesis.interconnection import rational, zeros_poles
from lpvguard.engine.synthesis.statespace import (
    StateSpace,
    append,
    balanced,
    gain,
    lft,
    series,
    to_continuous,
    to_discrete,
    zero_order_hold,
)

OMEGA = np.array([0.0, 0.03, 1.0, 40.0, np.inf])


def random_system(seed, n=4, m=3, p=2, dt=0.0):
    rng = np.random.default_rng(seed)
    A = rng.standard_normal((n, n))
    A = A / (1.2 * np.abs(np.linalg.eigvals(A)).max()) if dt else A - 3 * np.eye(n)
    return StateSpace(
        A, rng.standard_normal((n, m)), rng.standard_normal((p, n)), rng.standard_normal((p, m)), dt
    )


def test_response_matches_the_definition_at_finite_and_infinite_frequency():
    G = random_system(0)
    value = G.response(OMEGA)
    assert np.allclose(value[-1], G.D)
    assert np.allclose(value[2], G.D + G.C @ np.linalg.inv(1j * np.eye(4) - G.A) @ G.B)


def test_series_append_and_select_form_the_products_they_name():
    G, H = random_system(1, p=2), random_system(2, m=2)
    assert np.allclose(series(H, G).response(OMEGA), H.response(OMEGA) @ G.response(OMEGA))
    both = append(G, H).response(OMEGA)
    assert np.allclose(both[:, :2, :3], G.response(OMEGA)) and not np.any(both[:, :2, 3:])
    assert np.allclose(G.select([1], slice(0, 2)).response(OMEGA), G.response(OMEGA)[:, [1], :2])


def test_lft_closes_the_loop_with_direct_terms_on_both_sides():
    P, K = random_system(3, m=4, p=5), random_system(4, n=2, m=2, p=1)
    p, k = P.response(OMEGA), K.response(OMEGA)
    p11, p12, p21, p22 = p[:, :3, :3], p[:, :3, 3:], p[:, 3:, :3], p[:, 3:, 3:]
    want = p11 + p12 @ k @ np.linalg.inv(np.eye(2) - p22 @ k) @ p21
    assert np.allclose(lft(P, K).response(OMEGA), want)


def test_lft_refuses_an_algebraic_loop_that_has_no_solution():
    P = gain(np.array([[0.0, 1.0], [1.0, 2.0]]))
    with pytest.raises(SynthesisError, match="well-posed"):
        lft(P, gain(0.5))


@pytest.mark.parametrize("dt", [1e-3, 0.1, 1.0])
def test_bilinear_maps_are_inverse_and_keep_the_response_at_warped_frequencies(dt):
    G = random_system(5)
    D = to_discrete(G, dt)
    omega = np.array([0.0, 0.3, 2.0])
    assert np.allclose(D.response(2 / dt * np.arctan(omega * dt / 2)), G.response(omega))
    assert np.allclose(to_continuous(D).response(omega), G.response(omega))


def test_to_continuous_names_a_pole_at_minus_one():
    with pytest.raises(SynthesisError, match="z = −1"):
        to_continuous(StateSpace([[-1.0]], [[1.0]], [[1.0]], [[0.0]], 0.1))


def test_zero_order_hold_is_the_step_response_of_the_lag():
    G = zero_order_hold(StateSpace([[-2.0]], [[3.0]], [[1.0]], [[0.0]]), 0.1)
    assert np.isclose(G.A[0, 0], np.exp(-0.2)) and np.isclose(G.B[0, 0], 1.5 * (1 - np.exp(-0.2)))


def test_balancing_keeps_the_response_and_evens_out_a_scaling_of_nine_decades():
    G = random_system(6)
    scale = np.diag([1e-9, 1.0, 1e5, 1e9])
    H = balanced(G.transformed(scale))
    assert np.allclose(H.response(OMEGA), G.response(OMEGA), rtol=1e-9)
    assert np.abs(H.A).max() < 30 * np.abs(G.A).max()


def test_zeros_poles_and_rational_agree_with_the_product():
    s = 1j * OMEGA[:-1]
    want = 2.0 * (s / 5 + 1) * (s / 60 + 1) / ((s / 0.02 + 1) * (s / 3 + 1) * (s / 50 + 1))
    assert np.allclose(zeros_poles(2.0, [5.0, 60.0], [0.02, 3.0, 50.0]).response(OMEGA[:-1])[:, 0, 0], want)
    assert np.allclose(rational([9.0], [1.0, 5.4, 9.0]).response([0.0, 1.0])[:, 0, 0], [1.0, 9 / (8 + 5.4j)])


def test_improper_weights_are_refused():
    with pytest.raises(SynthesisError, match="proper"):
        rational([1.0, 0.0, 1.0], [1.0, 2.0])
    with pytest.raises(SynthesisError, match="zeros"):
        zeros_poles(1.0, [1.0], [])


@pytest.mark.parametrize("field, value", [("A", [[np.nan]]), ("B", [[1.0, 2.0]]), ("dt", -1.0)])
def test_bad_matrices_are_named(field, value):
    parts = {"A": [[-1.0]], "B": [[1.0]], "C": [[1.0]], "D": [[0.0]], "dt": 0.0, field: value}
    with pytest.raises(SynthesisError, match=field):
        StateSpace(**parts)
