"""The ν-gap against its closed forms, and what its theorem says of loops."""

import numpy as np
import pytest

from lpvguard.engine.synthesis.errors import SynthesisError
from lpvguard.engine.synthesis.nu_gap import nu_gap, nu_margin
from lpvguard.engine.synthesis.statespace import StateSpace, gain, lft, to_discrete


def first_order(k: float, pole: float) -> StateSpace:
    return StateSpace([[pole]], [[1.0]], [[k]], [[0.0]])


def random_plant(seed: int, inputs: int = 1, outputs: int = 2) -> StateSpace:
    random = np.random.default_rng(seed)
    parts = ((3, 3), (3, inputs), (outputs, 3), (outputs, inputs))
    return StateSpace(*(random.standard_normal(shape) for shape in parts))


def test_of_two_constants_it_is_the_chordal_distance():
    for a, b in ((0.0, 1.0), (2.0, -0.5), (3.0, 4.0)):
        found = nu_gap(gain([[a]]), gain([[b]]))
        want = abs(a - b) / np.hypot(1, a) / np.hypot(1, b)
        assert found.upper == pytest.approx(want, rel=1e-5)


def test_lags_with_opposite_slow_poles_are_near_in_closed_loop():
    """1/(s + e) and 1/(s - e): any gain of 1 stabilises both; the distance is 2e/(1 + e^2) at frequency 0."""
    e = 0.05
    found = nu_gap(first_order(1.0, -e), first_order(1.0, e))
    assert found.upper == pytest.approx(2 * e / (1 + e * e), rel=1e-4) and found.peak_frequency < 1e-3


def test_another_sign_is_a_gap_of_one():
    assert nu_gap(first_order(1.0, -1.0), first_order(-5.0, 1.0)).lower == 1


@pytest.mark.parametrize("seed", range(6))
def test_it_is_symmetric_and_that_of_the_responses(seed):
    first, other = random_plant(seed), random_plant(seed)
    other = StateSpace(other.A + 0.1, other.B, 1.1 * other.C, other.D)
    there, back = nu_gap(first, other), nu_gap(other, first)
    assert there.upper == pytest.approx(back.upper, rel=1e-4)
    if there.lower < 1:
        omega = np.r_[0.0, np.geomspace(1e-3, 1e3, 400), there.peak_frequency]
        P1, P2 = first.response(omega), other.response(omega)

        def root(P):
            values, vectors = np.linalg.eigh(np.eye(P.shape[1]) + P @ np.conj(np.swapaxes(P, 1, 2)))
            return vectors / np.sqrt(values)[:, None, :] @ np.conj(np.swapaxes(vectors, 1, 2))

        distance = root(P2) @ (P1 - P2) @ root(np.conj(np.swapaxes(P1, 1, 2)))
        sizes = np.linalg.norm(distance, 2, axis=(1, 2))
        assert sizes.max() <= there.upper * (1 + 1e-7) and sizes[-1] == pytest.approx(there.lower, rel=1e-4)


def test_a_sampled_plant_has_the_gap_of_its_image():
    first, other = random_plant(7), random_plant(8)
    want = nu_gap(first, other)
    got = nu_gap(to_discrete(first, 0.1), to_discrete(other, 0.1))
    assert got.upper == pytest.approx(want.upper, rel=1e-5)


@pytest.mark.parametrize("seed", range(20))
def test_a_controller_with_a_larger_margin_stabilises_the_other_plant(seed):
    random = np.random.default_rng(seed)
    P, K = random_plant(seed, 2, 2), gain(0.5 * random.standard_normal((2, 2)))
    other = StateSpace(P.A + 0.1 * random.standard_normal((3, 3)), P.B, P.C, P.D)
    margin = nu_margin(P, K)

    def closed(plant):
        n, m = plant.order, plant.n_inputs
        whole = StateSpace(
            plant.A,
            np.hstack([plant.B, plant.B]),
            np.vstack([np.zeros((m, n)), plant.C]),
            np.vstack([np.hstack([np.eye(m), np.eye(m)]), np.hstack([plant.D, plant.D])]),
        )
        return lft(whole, K).stability_margin() > 0

    assert (margin > 0) == closed(P)
    if margin > nu_gap(P, other).upper:
        assert closed(other)
    assert margin <= 1


def test_plants_of_other_shapes_are_refused():
    with pytest.raises(SynthesisError, match="shape"):
        nu_gap(random_plant(1), random_plant(1, outputs=1))
    with pytest.raises(SynthesisError, match="hidden unstable mode"):
        nu_gap(StateSpace([[1.0]], [[0.0]], [[1.0]], [[0.0]]), first_order(1.0, -1.0))
