"""The ν-gap against its closed forms, and what its theorem says of loops."""

import numpy as np
import pytest
import scipy.linalg as sl

from lpvguard.engine.synthesis import nu_gap as parts
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
        gap = nu_gap(gain([[a]]), gain([[b]]))
        want = abs(a - b) / np.hypot(1, a) / np.hypot(1, b)
        assert gap.upper == pytest.approx(want, rel=1e-5)


def test_lags_with_opposite_slow_poles_are_near_in_closed_loop():
    """1/(s + e) and 1/(s - e): any gain of 1 stabilises both; the distance is 2e/(1 + e^2) at frequency 0."""
    e = 0.05
    gap = nu_gap(first_order(1.0, -e), first_order(1.0, e))
    assert gap.upper == pytest.approx(2 * e / (1 + e * e), rel=1e-4) and gap.peak_frequency < 1e-3


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


@pytest.mark.parametrize("inputs", [1, 2])
@pytest.mark.parametrize("which", ["_left_factor", "_right_factor"])
def test_a_gap_of_wrong_factors_is_refused(inputs, which, monkeypatch):
    """Planted: a factor 1e-5 too large, as of a Riccati solution without digits."""
    first, other = random_plant(3, inputs), random_plant(3, inputs)
    other = StateSpace(other.A + 0.1, other.B, 1.1 * other.C, other.D)
    right = getattr(parts, which)
    assert 0 < nu_gap(first, other).upper < 1

    def planted(P):
        factor = right(P)
        return StateSpace(factor.A, factor.B, (1 + 1e-5) * factor.C, (1 + 1e-5) * factor.D)

    monkeypatch.setattr(parts, which, planted)
    with pytest.raises(SynthesisError, match=r"rad/s: not proved: the plants' distance is"):
        nu_gap(first, other)


def test_plants_of_other_shapes_are_refused():
    with pytest.raises(SynthesisError, match="shape"):
        nu_gap(random_plant(1), random_plant(1, outputs=1))
    with pytest.raises(SynthesisError, match="hidden unstable mode"):
        nu_gap(StateSpace([[1.0]], [[0.0]], [[1.0]], [[0.0]]), first_order(1.0, -1.0))


def test_plants_of_other_sampling_times_are_refused():
    first = to_discrete(random_plant(1), 0.1)
    with pytest.raises(SynthesisError, match="dt"):
        nu_gap(first, to_discrete(random_plant(1), 0.2))
    with pytest.raises(SynthesisError, match="dt"):
        nu_margin(first, gain([[0.0, 0.0]], 0.2))


def test_a_gap_is_one_at_most_and_at_infinity_it_is_seen():
    assert nu_gap(first_order(1e4, -1.0), gain([[0.0]])).upper == 1.0
    opposite = nu_gap(gain([[1.0]]), gain([[-1.0]]))  # 1 + P2 P1 = 0
    assert (opposite.lower, opposite.upper) == (1.0, 1.0) and np.isnan(opposite.peak_frequency)


def test_the_frequency_of_a_sampled_gap_is_that_of_the_sampled_plants():
    """Two lightly damped modes apart: the gap lies between them."""
    first, other = (StateSpace([[-0.02, w], [-w, -0.02]], [[0], [1]], [[0, 1]], [[0]]) for w in (2.0, 2.05))
    want, dt = nu_gap(first, other), 0.4
    got = nu_gap(to_discrete(first, dt), to_discrete(other, dt))
    assert 1.5 < want.peak_frequency < 2.6 and want.upper < 1
    assert got.peak_frequency == pytest.approx(2 / dt * np.arctan(want.peak_frequency * dt / 2), rel=1e-3)


@pytest.mark.parametrize(("p", "k"), [(0.5, -2.0), (3.0, -0.1), (-1.0, 4.0)])
def test_the_margin_of_constants_has_a_closed_form(p, k):
    want = abs(1 - p * k) / np.hypot(1, p) / np.hypot(1, k)
    assert nu_margin(gain([[p]]), gain([[k]])) == pytest.approx(want, rel=2e-6)


def test_the_margin_is_that_of_the_responses_and_not_above_it():
    P, k = first_order(1.0, -1.0), -3.0
    G = P.response(np.geomspace(1e-3, 1e3, 20001))[:, 0, 0]
    want = (np.abs(1 - G * k) / np.hypot(1, np.abs(G)) / np.hypot(1, k)).min()
    assert want * (1 - 1e-5) <= nu_margin(P, gain([[k]])) <= want


@pytest.mark.parametrize("seed", range(6))
def test_the_zeros_that_wind_are_those_of_the_pencil(seed):
    """[[A - s I, B], [C, I + D]] of P2(-s)' P1 loses rank at them; the plants have 3 and 2 states."""
    random = np.random.default_rng(seed)
    P1 = random_plant(seed, 2, 2)
    P2 = StateSpace(*(random.standard_normal(shape) for shape in ((2, 2), (2, 2), (2, 2), (2, 2))))
    A = np.block([[P1.A, np.zeros((3, 2))], [-P2.C.T @ P1.C, -P2.A.T]])
    B, C = np.vstack([P1.B, -P2.C.T @ P1.D]), np.hstack([P2.D.T @ P1.C, P2.B.T])
    pencil = np.block([[A, B], [C, np.eye(2) + P2.D.T @ P1.D]])
    values = sl.eigvals(pencil, sl.block_diag(np.eye(5), np.zeros((2, 2))))
    values = values[np.isfinite(values) & (np.abs(values) < 1e6)]
    assert len(values) == 5
    assert parts._unstable_zeros(P1, P2) == (values.real > 0).sum()


@pytest.mark.parametrize("seed", range(3))
def test_the_factors_are_normalised_stable_and_those_of_the_plant(seed):
    P, omega = random_plant(seed, 2, 2), [0.0, 0.4, 7.0, np.inf]
    right, left = parts._right_factor(P), parts._left_factor(P)
    assert right.stability_margin() > 0 and left.stability_margin() > 0
    for G, N, M in zip(P.response(omega), right.response(omega), left.response(omega), strict=True):
        np.testing.assert_allclose(N.conj().T @ N, np.eye(2), atol=1e-9)
        np.testing.assert_allclose(M @ M.conj().T, np.eye(2), atol=1e-9)
        np.testing.assert_allclose(N[:2], G @ N[2:], atol=1e-9)
        np.testing.assert_allclose(M[:, 2:], -M[:, :2] @ G, atol=1e-9)
