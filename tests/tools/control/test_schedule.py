"""The realisation that the core runs: its poles, its interpolation, and the change of state that engages
without a jump."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.linalg import solve_discrete_are, solve_discrete_lyapunov

from lpvguard.control.schedule import RECOVERY_EFFORT, FrozenLoop, first_columns, fit_by_pairs, observed
from lpvguard.core.control_coefficients import build_controller
from lpvguard.core.scheduled import Scheduled, engagement, realisation
from lpvguard.engine.synthesis.dk import Scaling
from lpvguard.engine.synthesis.interconnection import GeneralisedPlant
from lpvguard.engine.synthesis.statespace import StateSpace, lft, series, zero_order_hold

TS = 0.01
POLES = [(-0.05, -3.0), (-2.0 + 3.0j, -2.0 - 3.0j), (-40.0, -40.0)]
COLUMNS = np.append(first_columns(np.exp(TS * np.array(POLES, complex).ravel())), -1.0)


@pytest.fixture(scope="module")
def schedule():
    rng = np.random.default_rng(4)
    a = COLUMNS
    return Scheduled(
        TS,
        np.linspace(8.0, 22.0, 4),
        a,
        rng.standard_normal((4, 2, len(a), 3)),
        np.zeros((4, 2, len(a), 2)),
        np.array([[6.0, 1.0], [5.0, 2.0], [3.0, 4.0], [2.0, 8.0]]),
    )


def test_pairs_have_the_poles_asked_for_and_the_last_state_is_a_delay():
    A, c = realisation(COLUMNS)
    wanted = [np.exp(TS * p) for pair in POLES for p in pair] + [0.0]
    np.testing.assert_allclose(
        np.sort_complex(np.linalg.eigvals(A)), np.sort_complex(np.array(wanted, complex)), atol=1e-7
    )
    np.testing.assert_array_equal(c, [[1, 0, 1, 0, 1, 0, 1]])


@pytest.mark.parametrize("n", [1, 2, 6, 7])
def test_what_each_state_adds_to_the_demand(n):
    a = COLUMNS[-n:] if n in (1, 7) else COLUMNS[:n]
    A, c = realisation(a)
    z = np.exp(1j * np.array([1e-4, 0.01, 0.5, 3.0]))
    wanted = [(c @ np.linalg.inv(x * np.eye(n) - A))[0] for x in z]
    np.testing.assert_allclose(observed(a, z), wanted, rtol=1e-8)


def test_between_nodes_the_response_is_the_mean_of_the_nodes(schedule):
    omega = np.array([0.01, 1.0, 50.0])
    low, high = (schedule.at(v).response(omega) for v in schedule.speeds[1:3])
    middle = schedule.at(schedule.speeds[1:3].mean()).response(omega)
    assert middle.shape == (3, 2, 3)
    np.testing.assert_allclose(middle, (low + high) / 2, rtol=1e-9)
    np.testing.assert_array_equal(schedule.at(99.0).B, schedule.at(22.0).B)


def test_the_limit_is_that_of_the_node_and_between_nodes_their_line(schedule):
    for v, wanted in zip(schedule.speeds, schedule.u_max, strict=True):
        np.testing.assert_allclose(schedule.limit(v), wanted, rtol=1e-12)
    third = schedule.speeds[1] + (schedule.speeds[2] - schedule.speeds[1]) / 4
    np.testing.assert_allclose(schedule.limit(third), [4.5, 2.5], rtol=1e-12)
    for outside, node in ((0.0, 0), (99.0, -1)):
        np.testing.assert_array_equal(schedule.limit(outside), schedule.u_max[node])


def test_the_digest_is_of_every_coefficient(schedule):
    arrays = ("speeds", "a", "B", "L", "u_max")
    others = [replace(schedule, **{key: getattr(schedule, key) + 1e-9}) for key in arrays]
    assert len({s.digest() for s in [schedule, replace(schedule, Ts=0.02), *others]}) == 7


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


def two_input_loop(v: float) -> FrozenLoop:
    """A stable vehicle of two inputs and outputs at a speed, and a controller for it that has three fixed
    poles and a delay."""
    eye, zero = np.eye(2), np.zeros((2, 2))
    vehicle = zero_order_hold(
        StateSpace(
            np.array([[-1.0, 0.3 * v], [0.0, -4.0]]), np.array([[0.5 * v, 0.1], [0.2, 1.0]]), eye, zero
        ),
        TS,
    )
    A = np.exp(TS * np.array([-0.5, -3.0, -12.0]))
    numerators = np.array(
        [
            [[0.4, -0.3, 0.1], [1.0, -0.8, -0.2]],
            [[-0.2, 0.1, -0.5], [0.3, 0.2, -0.6]],
            [[0.1, -0.4, 0.0], [0.0, -0.1, -0.4]],
        ]
    )
    K = StateSpace(
        np.diag(A),
        (1 - A)[:, None] * np.array([[1.0, -1.0, 0.0], [0.0, 0.0, -1.0], [1.0, 0.0, -1.0]]) / v,
        numerators[:, :, 0].T + numerators[:, :, 1].T * v,
        np.zeros((2, 3)),
        TS,
    )
    K = series(StateSpace(zero, eye, eye, zero, TS), K)
    # w = (r, noise); z = (r - y_1, u / 10); m = (r, y + noise).
    B = np.hstack([np.zeros((2, 3)), vehicle.B])
    C = np.vstack([-vehicle.C[:1], np.zeros((3, 2)), vehicle.C])
    D = np.zeros((6, 5))
    D[0, 0] = D[3, 0] = D[4, 1] = D[5, 2] = 1.0
    D[1, 3] = D[2, 4] = 0.1
    return FrozenLoop(K, GeneralisedPlant(StateSpace(vehicle.A, B, C, D, TS), (), 0, 0, 2, 3), vehicle)


def test_two_inputs_are_met_by_poles_common_to_both():
    speeds = np.linspace(1.0, 2.0, 3)
    loops = [two_input_loop(v) for v in speeds]
    assert all(lft(loop.plant.system, loop.controller).stability_margin() > 0 for loop in loops)
    schedule = fit_by_pairs(loops, speeds, Scaling(np.zeros((0, 1))), np.tile([2.0, 1.0], (3, 1)))(2)
    omega = np.logspace(-1, 2, 40)
    for v, loop in zip(speeds, loops, strict=False):
        wanted = loop.controller.response(omega)
        assert np.abs(schedule.at(v).response(omega) - wanted).max() <= 1e-3 * np.abs(wanted).max()
        assert schedule.injection_radius(v) < 1
    coefficients = build_controller(
        TS, speeds, schedule.a, schedule.B, schedule.L, schedule.u_max, np.array([9.0, 9.0])
    )
    assert coefficients.sizes == {"NK": 5, "NM": 3, "NG": 3} and coefficients.reals["BL"].shape == (
        3,
        2,
        5,
        5,
    )


def test_a_measurement_that_no_node_needs_moves_no_state():
    """The noisy copy of an output that a noiseless one beside it makes useless, up to rounding."""
    speeds = np.linspace(1.0, 2.0, 3)
    loops = [two_input_loop(v) for v in speeds]
    K = [loop.controller for loop in loops]
    faint = [replace(k, B=k.B * np.array([1.0, 1.0, 1e-9])) for k in K]
    scaling, limits = Scaling(np.zeros((0, 1))), np.tile([2.0, 1.0], (3, 1))
    for controllers, used in ((K, [True, True, True]), (faint, [True, True, False])):
        schedule = fit_by_pairs(
            [replace(loop, controller=k) for loop, k in zip(loops, controllers, strict=True)],
            speeds,
            scaling,
            limits,
        )(2)
        assert (np.abs(schedule.B).max(axis=(0, 1, 2)) > 0).tolist() == used


def test_under_limits_the_law_is_that_of_model_recovery():
    """Demands held at zero under a step of the reference: L alone against the recursion with the vehicle's
    lag xi in it."""
    speeds, node = np.linspace(1.0, 2.0, 3), 1
    limits = np.array([[2.0, 1.0], [1.0, 3.0], [5.0, 0.2]])  # each node's L is about its own
    schedule = fit_by_pairs([two_input_loop(v) for v in speeds], speeds, Scaling(np.zeros((0, 1))), limits)(5)
    np.testing.assert_array_equal(schedule.u_max, limits)
    u_max = limits[node]
    K, vehicle, L = schedule.at(1.5), two_input_loop(1.5).vehicle, schedule._rows(schedule.L, 1.5)
    A, B, C = vehicle.A, vehicle.B, vehicle.C
    top = (C @ np.linalg.solve(np.eye(2) - A, B))[0] * u_max
    Q, R = np.outer(C[0], C[0]) / (top @ top), RECOVERY_EFFORT * np.diag(u_max**-2.0)
    X = solve_discrete_are(A, B, Q, R)
    F = np.linalg.solve(R + B.T @ X @ B, B.T @ X @ A)
    x, exact, xi, demands, wanted = np.zeros(K.order), np.zeros(K.order), np.zeros(2), [], []
    for _ in range(500):
        demands.append(K.C @ x)
        wanted.append(K.C @ exact + F @ xi)
        x = K.A @ x + K.B @ [1.0, 0.0, 0.0] - L @ demands[-1]
        exact = K.A @ exact + K.B @ np.append(1.0, C @ xi)
        xi = (A - B @ F) @ xi + B @ wanted[-1]
    assert np.abs(np.array(demands) - wanted).max() <= 0.025 * np.abs(wanted).max()
