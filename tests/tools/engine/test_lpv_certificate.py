"""The certificate at a moving speed: what it proves holds along random histories, and what is false is not
proved."""

from dataclasses import replace

import numpy as np
import pytest

from lpvguard.engine.synthesis import lpv_certificate as lpv
from lpvguard.engine.synthesis.statespace import StateSpace
from oscillator import Oscillator

TS = 0.05


def family(gain: float, turn: float = 0.2) -> lpv.Family:
    """A damped oscillator whose stiffness follows the speed, from force to ``gain`` times the position; v in
    1..3 m/s. Its vehicle is the oscillator itself."""

    vehicle = Oscillator(turn, TS)

    def at(v):
        hold = vehicle.hold(v)
        C = np.vstack([[gain, 0.0], np.eye(2), [0.0, 0.0]])
        return StateSpace(hold[:2, :2], hold[:2, 2:], C, np.array([[0.0], [0.0], [0.0], [1.0]]), TS)

    return lpv.Family(at, np.array([1.0, 2.0, 3.0]), slice(0, 2), 3, vehicle.bounds, TS)


@pytest.fixture(scope="module")
def proved():
    return lpv.find(family(0.4))


@pytest.mark.slow("5 s: random speed histories")
def test_a_rate_is_proved_and_the_gain_holds_along_random_speed_histories(proved):
    assert proved.rate > 0.05 and proved.proof.margin > 0
    one, random, largest = family(0.4), np.random.default_rng(1), 0.0
    for period in (3, 20, 60, 120, 300):
        x, v, energy_in, energy_out = np.zeros(2), 2.0, 0.0, 0.0
        for k in range(3000):
            G = one.at(v)
            w = np.sin(0.06 * k + random.normal(0, 0.1))
            energy_in, energy_out = energy_in + w * w, energy_out + float(G.C[0] @ x) ** 2
            x = G.A @ x + G.B[:, 0] * w
            v = np.clip(v + proved.rate * TS * np.sign(np.sin(2 * np.pi * k / period)), 1.0, 3.0)
        largest = max(largest, np.sqrt(energy_out / energy_in))
    assert 0.3 < largest < 1


def test_the_stored_function_is_proved_anew_and_an_altered_one_is_not(proved):
    again = lpv.prove(family(0.4), proved.storage, proved.rate)
    assert again == proved.proof
    assert lpv.prove(family(0.4), proved.storage, 50 * proved.rate) is None
    assert lpv.prove(family(0.58), proved.storage, proved.rate) is None  # its frozen gain is above 1
    P = proved.storage.P.copy()
    P[2] *= 0.5
    assert (
        lpv.prove(family(0.4), lpv.Storage(proved.storage.basis, proved.storage.knots, P), proved.rate)
        is None
    )


@pytest.mark.slow("3 s: two certificates")
def test_a_storage_function_of_the_loop_itself_is_proved_too_and_none_holds_for_the_other_direction(proved):
    primal = lpv._polynomial(family(0.4))
    assert proved.storage.adjoint and not primal.storage.adjoint and primal.rate > 0.05
    assert lpv.prove(family(0.4), primal.storage, primal.rate) == primal.proof
    for one in (proved, primal):
        turned = replace(one.storage, adjoint=not one.storage.adjoint)
        assert lpv.prove(family(0.4), turned, one.rate) is None


@pytest.mark.unhurried
@pytest.mark.parametrize("adjoint", [True, False])
def test_a_cell_bounds_what_the_loop_loses_between_its_ends(proved, adjoint):
    """F at random speeds and steps of a wide cell is nowhere less than what the cell promises."""
    one = replace(family(0.4), adjoint=adjoint)
    certificate = proved if adjoint else lpv._polynomial(one)
    storage, n = certificate.storage, len(certificate.storage.basis)
    rate, random = 0.2 * certificate.rate, np.random.default_rng(7)
    low, high = 1.0, 1.02
    ends = [lpv._End.at_speed(one, storage, v) for v in (low, high)]
    promised = lpv._cell_slack(one, storage, *ends, rate)
    assert promised > 0
    E = np.eye(n, ends[0].S.shape[1])
    for v in random.uniform(low, high, 200):
        end = lpv._End.at_speed(one, storage, v)
        after = storage.at(v + random.uniform(-1, 1) * rate * TS)
        Q = np.block(
            [[after, np.zeros((n, len(end.S) - n))], [np.zeros((len(end.S) - n, n)), np.eye(len(end.S) - n)]]
        )
        assert np.linalg.eigvalsh(lpv._dissipation(end, Q, E))[0] >= promised * (1 - 1e-9)


def test_states_that_a_claim_does_not_concern_are_left_out_and_the_gain_stays():
    """A filter of another input and one that only another output reads."""
    plain = family(0.4)

    def at(v):
        G = plain.at(v)
        A = np.zeros((4, 4))
        A[1:3, 1:3], A[0, 0], A[3, 3], A[3, 1] = G.A, 0.9, 0.8, 0.3
        A[1:3, 0] = G.B[:, 0]
        B = np.zeros((4, 2))
        B[1:3, 0], B[0, 1] = G.B[:, 0], 1.0
        C = np.zeros((5, 4))
        C[0, 1:3], C[1, 3], C[2:, 1:3] = G.C[0], 1.0, G.C[1:]
        C[4, 0] = 1.0  # the filter's output adds to the force
        D = np.zeros((5, 2))
        D[4, 0] = 1.0
        return StateSpace(A, B, C, D, TS)

    wide = lpv.Family(at, plain.nodes, slice(1, 3), 3, plain.hold_bounds, TS)
    kept = lpv.relevant(wide, slice(0, 1), slice(0, 1))
    assert kept.vehicle == slice(0, 2)
    for v in (1.0, 1.7, 3.0):
        for part in "ABCD":
            np.testing.assert_array_equal(getattr(kept.at(v), part), getattr(plain.at(v), part))
    whole = lpv.relevant(wide, slice(0, 2), slice(0, 2))
    np.testing.assert_array_equal(whole.at(1.7).A, at(1.7).A)


def test_nothing_is_found_for_a_loop_whose_frozen_gain_is_not_below_one():
    assert lpv.find(family(1.2)) is None


@pytest.mark.slow("3 s: a certificate on many knots")
def test_a_peak_between_the_knots_is_seen():
    """The proof rests on cells, not on the grid: a resonance that only speeds between the knots have is found
    out."""
    plain = family(0.4)

    def at(v):
        G = plain.at(v)
        return StateSpace(
            G.A, G.B, np.vstack([(1 + 6 * max(0.0, 1 - abs(v - 1.25) / 0.05)) * G.C[:1], G.C[1:]]), G.D, TS
        )

    certificate = lpv.find(plain)
    bad = lpv.Family(at, np.array([1.0, 1.2, 1.25, 1.3, 2.0, 3.0]), plain.vehicle, 3, plain.hold_bounds, TS)
    assert lpv.prove(bad, certificate.storage, certificate.rate) is None
