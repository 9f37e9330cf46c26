"""The realisation that the core runs: its poles, its interpolation, and the change of state that engages without a jump."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.linalg import solve_discrete_lyapunov

from lpvguard.schedule import Scheduled, _first_columns, _observed, engagement, realisation

TS = 0.01
POLES = [(-0.05, -3.0), (-2.0 + 3.0j, -2.0 - 3.0j), (-40.0, -40.0)]
THETA = np.log([[-(p + q).real, (p * q).real] for p, q in POLES]).ravel()


@pytest.fixture(scope="module")
def schedule():
    rng = np.random.default_rng(4)
    a = _first_columns(THETA, TS)
    return Scheduled(TS, np.linspace(8.0, 22.0, 4), a, rng.standard_normal((4, 2, len(a), 3)), np.zeros((4, 2, len(a), 2)))


def test_pairs_have_the_poles_asked_for_and_the_last_state_is_a_delay():
    A, c = realisation(_first_columns(THETA, TS))
    wanted = [np.exp(TS * p) for pair in POLES for p in pair] + [0.0]
    np.testing.assert_allclose(np.sort_complex(np.linalg.eigvals(A)), np.sort_complex(np.array(wanted, complex)), atol=1e-7)
    np.testing.assert_array_equal(c, [[1, 0, 1, 0, 1, 0, 1]])


@pytest.mark.parametrize("n", [1, 2, 6, 7])
def test_what_each_state_adds_to_the_demand(n):
    a = _first_columns(THETA, TS)[-n:] if n in (1, 7) else _first_columns(THETA, TS)[:n]
    A, c = realisation(a)
    z = np.exp(1j * np.array([1e-4, 0.01, 0.5, 3.0]))
    wanted = [(c @ np.linalg.inv(x * np.eye(n) - A))[0] for x in z]
    np.testing.assert_allclose(_observed(a, z), wanted, rtol=1e-8)


def test_between_nodes_the_response_is_the_mean_of_the_nodes(schedule):
    omega = np.array([0.01, 1.0, 50.0])
    low, high = (schedule.at(v).response(omega) for v in schedule.speeds[1:3])
    middle = schedule.at(schedule.speeds[1:3].mean()).response(omega)
    assert middle.shape == (3, 2, 3)
    np.testing.assert_allclose(middle, (low + high) / 2, rtol=1e-9)
    np.testing.assert_array_equal(schedule.at(99.0).B, schedule.at(22.0).B)


def test_engaging_meets_both_samples_by_the_likeliest_change(schedule):
    a, B = schedule.a, schedule.B
    A, c = realisation(a)
    M = np.vstack([c, c @ (A - np.eye(len(a)))])
    E = engagement(a, B)
    np.testing.assert_allclose(M @ E, np.eye(2), atol=1e-7)
    drive = np.moveaxis(B, 2, 0).reshape(len(a), -1)
    likely = np.linalg.inv(solve_discrete_lyapunov(A, drive @ drive.T))
    rng = np.random.default_rng(1)
    for column in E.T:
        for _ in range(20):
            other = rng.standard_normal(len(a)) * np.abs(column)
            other -= np.linalg.pinv(M) @ (M @ other)  # keeps both demands
            assert (column + other) @ likely @ (column + other) > column @ likely @ column


def test_a_delay_alone_can_meet_one_sample_only():
    np.testing.assert_array_equal(engagement(np.array([-1.0]), np.ones((2, 1, 1, 3))), [[1.0, 0.0]])


def test_a_pole_on_the_unit_circle_has_no_likely_state():
    with pytest.raises(np.linalg.LinAlgError, match="unit circle"):
        engagement(np.array([0.0]), np.ones((2, 1, 1, 3)))
