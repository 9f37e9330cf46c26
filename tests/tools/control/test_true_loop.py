"""What a loop has beside what is promised: a truck like the nominal model has the nominal loop's margins, one
within the weight at least the promised ones, and a weight that is too small is named."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from hand_controller import hand_controller
from lpvguard.base.errors import InputError
from lpvguard.control import true_loop
from lpvguard.control.true_loop import CertifiedLoop, MeasuredResponse
from lpvguard.core.scheduled import Scheduled
from lpvguard.engine.synthesis.margins import NAMES, margins, of_system
from lpvguard.engine.synthesis.statespace import StateSpace, series
from lpvguard.vehicle.nominal import NominalModel

OMEGA = np.geomspace(0.02, 60.0, 90)
SPEED = 13.7
"""[m/s] Between nodes of the controller."""
LARGER_IS_WORSE = ("gain_down", "Ms", "Mt")


def certified(project, columns: int = 1, size: float = 0.3, structure: str = "K_i") -> CertifiedLoop:
    """The hand-made controller with |W_delta| = size (1 + omega/20) in each of ``columns``."""
    settings = project.design.model_copy(update={"structure": structure})

    def at(omega):
        W = size * (1 + omega / 20)
        return np.column_stack([W] * columns), np.ones((len(omega), 2))

    stored = SimpleNamespace(
        project=project.model_copy(update={"design": settings}),
        fitted=SimpleNamespace(at=at),
        model=NominalModel(project),
    )
    return CertifiedLoop(stored, Scheduled.read(hand_controller(project)))


def measured(loop: CertifiedLoop, *factors) -> MeasuredResponse:
    """The nominal response times 1 + factor of each output."""
    P = loop.model.frequency_response(OMEGA, SPEED)[..., 0]
    return MeasuredResponse(SPEED, 2.0, 1.0, OMEGA, P * (1 + np.column_stack(factors)))


def sampled(model: NominalModel) -> StateSpace:
    """The nominal recursion (T1) at SPEED in state space, its input's past as states."""
    d = model.discretise(np.array([SPEED]))
    n, past = model.n, model.delay + 1
    A, B = np.zeros((n + past, n + past)), np.zeros((n + past, 1))
    A[:n, :n] = d.Ad[0]
    A[n + 1 :, n:-1] = np.eye(past - 1)
    B[n] = 1.0
    A[:n, n + model.delay] += d.B_old[0, :, 0]
    if model.delay:
        A[:n, n + model.delay - 1] += d.B_new[0, :, 0]
    else:
        B[:n, 0] = d.B_new[0, :, 0]
    C = np.hstack([model.C, np.zeros((model.n_y, past))])
    return StateSpace(A, B, C, np.zeros((model.n_y, 1)), model.Ts)


@pytest.mark.parametrize("delay_s", [0.0, 0.05, 0.053])
def test_the_nominal_truck_has_the_margins_of_the_nominal_state_space_loop(truck, delay_s):
    model = truck.model.model_copy(update={"input_delay_s": delay_s})
    loop = certified(truck.model_copy(update={"model": model}))
    true_loop = loop.true(measured(loop, 0 * OMEGA, 0 * OMEGA))
    K = loop.schedule.at(SPEED)
    feedback = StateSpace(K.A, -K.B[:, 1:], K.C, K.D[:, 1:], K.dt)
    system = series(feedback, sampled(loop.model))
    exact = margins(*of_system(system))
    for name in NAMES:
        assert true_loop.margins.by_name[name].value == pytest.approx(exact.by_name[name].value, rel=1e-4), (
            name
        )
    assert (true_loop.v, true_loop.asked, true_loop.amplitude) == (SPEED, 2.0, 1.0)
    assert all(d.ratio < 1e-9 for d in true_loop.deviations)


@pytest.mark.slow("3 s: drawn vehicles")
@pytest.mark.parametrize("columns", [1, 2])
def test_a_vehicle_within_the_weight_has_at_least_what_is_promised(truck, columns):
    loop = certified(truck, columns)
    promised = loop.promised(SPEED)
    assert promised is not None
    W = loop.W_delta(OMEGA)
    assert W.shape == (len(OMEGA), columns)
    random = np.random.default_rng(columns)
    for _ in range(12):
        # All-pass lags and gains of size at most 1: each output's own where each has a weight.
        turns = random.uniform(0.1, 30.0, 2) if columns == 2 else np.repeat(random.uniform(0.1, 30.0), 2)
        signs = random.choice([-1.0, 1.0], 2) if columns == 2 else np.repeat(random.choice([-1.0, 1.0]), 2)
        delta = signs * (turns - 1j * OMEGA[:, None]) / (turns + 1j * OMEGA[:, None])
        true_loop = loop.true(measured(loop, *(delta * W * 0.999).T))
        assert all(d.ratio <= 1 for d in true_loop.deviations)
        for name in NAMES:
            better = true_loop.margins.by_name[name].value - promised.by_name[name].value
            assert better * (-1 if name in LARGER_IS_WORSE else 1) >= -1e-3, name


def test_own_weights_of_each_output_promise_no_more_than_one_for_both(truck):
    common, own = (certified(truck, columns).promised(SPEED).by_name for columns in (1, 2))
    for name in NAMES:
        better = common[name].value - own[name].value
        assert better * (-1 if name in LARGER_IS_WORSE else 1) >= -1e-9, name


def test_a_weight_that_is_too_small_is_named_with_place_and_both_numbers(truck):
    loop = certified(truck, 2)
    bump = 0.9 * np.exp(-((np.log(OMEGA / OMEGA[60]) / 0.2) ** 2))
    first, second = loop.true(measured(loop, 0.1 + 0 * OMEGA, bump)).deviations
    assert (first.output, second.output) == tuple(s.name for s in truck.outputs)
    assert first.ratio < 1 < second.ratio
    at = int(np.argmax(bump / loop.W_delta(OMEGA)[:, 1]))
    assert second.omega == OMEGA[at]
    assert second.delta == pytest.approx(bump[at]) and second.W_delta == loop.W_delta(OMEGA)[at, 1]


def test_the_weight_is_read_where_tustins_map_puts_it(truck):
    loop = certified(truck, size=1.0)
    warped = 2 / truck.Ts_s * np.tan(60.0 * truck.Ts_s / 2)
    assert loop.W_delta(np.array([60.0]))[0, 0] == pytest.approx(1 + warped / 20)


def test_a_weight_that_lets_a_vehicle_go_unstable_promises_nothing(truck):
    assert certified(truck, size=50.0).promised(SPEED) is None


def test_an_unstable_true_loop_says_so(truck):
    loop = certified(truck)
    true_loop = loop.true(measured(loop, *[-60.0 + 0 * OMEGA] * 2))
    assert not true_loop.margins.stable and true_loop.margins.by_name == {}


def test_amplitudes_are_reduced_to_the_edge_and_not_left_out(truck):
    loop = certified(truck)
    v = truck.model.speed_max_mps
    edge = true_loop.LATERAL_ACCELERATION_MAX / (v * abs(loop.model.frequency_response([0.0], v)[0, 0, 0]))
    assert loop.amplitudes(v, [0.5 * edge, 2 * edge, 3 * edge]) == pytest.approx([0.5 * edge, edge, edge])


def test_what_has_no_promise_about_the_weight_alone_or_no_stable_controller_is_refused(truck):
    for structure in ("K_inf", "K_is"):
        with pytest.raises(InputError, match=r"design.structure: .* expected K_i"):
            certified(truck, structure=structure)
    loop = certified(truck)
    loop.schedule = replace(loop.schedule, a=np.array([0.1, *loop.schedule.a[1:]]))
    with pytest.raises(InputError, match="unstable pole"):
        loop.promised(SPEED)
