"""The worst Delta by another way: every phase of a scalar one, and the pieces that it is realised from."""

import numpy as np
import pytest

from lpvguard.engine.blocks import Block
from lpvguard.engine.synthesis import worst_case as wc
from lpvguard.engine.synthesis.dk import Scaling
from lpvguard.engine.synthesis.interconnection import GeneralisedPlant
from lpvguard.engine.synthesis.statespace import StateSpace, gain, lft

PHASES = np.exp(1j * np.linspace(-np.pi, np.pi, 7201))
ONE, TWO = Block("full", 1, 1), (Block("full", 2, 1), Block("full", 1, 3))


def plant(dt: float = 0.0, blocks: int = 1, unstable: bool = False) -> GeneralisedPlant:
    """[xi, w, u] to [eta, z, y]; the controller of order 0 is 0."""
    A = np.array([[0.6, 0.2], [-0.2, 0.7]]) if dt else np.array([[-0.4, 1.0], [-1.0, -0.6]])
    A = A + 9 * np.eye(2) * unstable
    B, C = np.array([[0.3, 1.0, 0.5], [0.5, -0.4, 0.2]]), np.array([[0.4, 0.2], [1.0, 0.3], [0.3, 1.0]])
    D = np.array([[0.1, 0.2, 0.0], [0.3, 0.1, 0.0], [0.0, 0.0, 0.0]])
    return GeneralisedPlant(StateSpace(A, B, C, D, dt), (ONE,) * blocks, blocks, blocks, 1, 1)


def nothing(dt: float = 0.0) -> StateSpace:
    return gain([[0.0]], dt)


def largest(M: np.ndarray) -> float:
    """Of M (2, 2) with a scalar Delta of any phase around the first signals."""
    return float(np.abs(M[1, 1] + M[1, 0] * PHASES * M[0, 1] / (1 - M[0, 0] * PHASES)).max())


# ---------------------------------------------------------------- closing and realising


def test_delta_is_closed_around_the_first_signals():
    M = np.random.default_rng(1).standard_normal((5, 6))
    delta = np.random.default_rng(2).standard_normal((2, 3))
    closed = wc.close_delta(gain(M), gain(delta))
    want = M[3:, 2:] + M[3:, :2] @ delta @ np.linalg.solve(np.eye(3) - M[:3, :2] @ delta, M[:3, 2:])
    np.testing.assert_allclose(closed.D, want)


@pytest.mark.parametrize("value", [2 * np.exp(1j * x) for x in (-3.0, -1.5, -0.1, 0.1, 1.2, 3.0)])
@pytest.mark.parametrize("omega", [0.3, 5.0])
def test_an_all_pass_has_the_value_at_its_frequency_and_its_size_at_all(value, omega):
    G = wc._all_pass(value, omega)
    assert G.order == 1 and G.stability_margin() > 0
    np.testing.assert_allclose(G.response([omega])[0, 0, 0], value)
    np.testing.assert_allclose(np.abs(G.response([0.0, 0.1, 1.0, 40.0, np.inf])).ravel(), 2.0)


def test_a_real_value_needs_no_state():
    for value, sign in ((2.0 + 0j, 1), (-2.0 + 0j, -1), (2 - 1.8e-9j, 1), (-2 + 1.8e-9j, -1)):
        G = wc._all_pass(value, 1.0)
        assert G.order == 0 and G.D[0, 0] == pytest.approx(2.0 * sign)
    assert wc._all_pass(1 + 1e-9j, 1.0).order == wc._all_pass(1 - 1e-9j, 1.0).order == 1
    # At DC what is not real keeps its size and the sign of its real part.
    assert wc._all_pass(3 * np.exp(1j), 0.0).D[0, 0] == pytest.approx(3.0)
    assert wc._all_pass(3 * np.exp(2j), 0.0).D[0, 0] == pytest.approx(-3.0)


@pytest.mark.parametrize("dt", [0.0, 0.2])
def test_a_rank_one_matrix_is_had_at_the_frequency_and_its_size_at_all(dt):
    random = np.random.default_rng(3)
    u, v = (random.standard_normal(n) + 1j * random.standard_normal(n) for n in (2, 3))
    G = wc._realise(u, v, 1.7, dt)
    assert G.dt == dt and G.stability_margin() > 0
    np.testing.assert_allclose(G.response([1.7])[0], np.outer(u, v.conj()))
    sizes = np.linalg.svd(G.response([0.0, 0.4, 9.0]), compute_uv=False)
    np.testing.assert_allclose(sizes[:, 0], np.linalg.norm(u) * np.linalg.norm(v))
    np.testing.assert_allclose(sizes[:, 1], 0.0, atol=1e-12)


# ---------------------------------------------------------------- the search at one frequency


def search_of_two() -> wc._Search:
    """Blocks 2 x 1 and 1 x 3, two performance inputs and one output."""
    system = gain(np.zeros((4 + 1 + 1, 3 + 2 + 1)))
    return wc._Search(GeneralisedPlant(system, TWO, 3, 4, 1, 1))


def test_every_block_is_sized_to_one_by_itself():
    delta = np.zeros((3, 4), complex)
    delta[:2, :1], delta[2:, 1:] = [[3.0], [4.0j]], [[0.0, 0.0, 0.5]]
    sized = search_of_two()._sized(delta)
    want = np.zeros((3, 4), complex)
    want[:2, :1], want[2:, 1:] = [[0.6], [0.8j]], [[0.0, 0.0, 1.0]]
    np.testing.assert_allclose(sized, want)
    np.testing.assert_array_equal(search_of_two()._sized(0 * delta), 0 * delta)


def test_the_gain_with_delta_is_that_of_the_closed_matrix():
    random = np.random.default_rng(4)
    M = random.standard_normal((5, 5)) + 1j * random.standard_normal((5, 5))
    delta = 0.3 * random.standard_normal((3, 4))
    inner = np.linalg.solve(np.eye(4) - M[:4, :3] @ delta, M[:4, 3:])
    want = np.linalg.norm(M[4:, 3:] + M[4:, :3] @ delta @ inner, 2)
    assert search_of_two().gain(M, delta) == pytest.approx(want)


def test_the_parts_of_delta_are_its_singular_vectors_and_at_dc_every_choice_of_signs():
    delta = np.zeros((3, 4), complex)
    u, v = np.array([0.6, 0.8j]), np.array([0.0, 0.6, -0.8])
    delta[:2, 0], delta[2, 1:] = u, v * np.exp(0.7j)
    [parts] = search_of_two().choices(delta, False)
    assert len(parts) == 2
    np.testing.assert_allclose(np.outer(parts[0][0], parts[0][1].conj()), delta[:2, :1], atol=1e-12)
    np.testing.assert_allclose(np.outer(parts[1][0], parts[1][1].conj()), delta[2:, 1:], atol=1e-12)
    choices = list(search_of_two().choices(delta, True))
    assert len(choices) == 4
    both = [tuple(np.outer(u, v) for u, v in parts) for parts in choices]
    for one, two in both:
        # The real part of [0.6, 0.8j], turned so that its largest entry is real: [0, 1].
        np.testing.assert_allclose(np.abs(one), [[0.0], [1.0]], atol=1e-12)
        np.testing.assert_allclose(np.abs(two), [[0.0, 0.6, 0.8]], atol=1e-12)
        assert two[0, 1] * two[0, 2] < 0
    turned = np.zeros((3, 4), complex)
    turned[:2, 0] = [0.6 * np.exp(0.9j), 0.8 * np.exp(2j)]
    want = np.array([0.6 * np.cos(1.1), 0.8])
    for (u, _), _ in search_of_two().choices(turned, True):
        np.testing.assert_allclose(u * np.sign(u[1]), want / np.linalg.norm(want))
    assert {(np.sign(one[1, 0]), np.sign(two[0, 1])) for one, two in both} == {
        (a, b) for a in (-1, 1) for b in (-1, 1)
    }


@pytest.mark.parametrize("seed", range(4))
def test_the_largest_gain_is_that_of_every_phase(seed):
    random = np.random.default_rng(seed)
    M = random.standard_normal((2, 2)) + 1j * random.standard_normal((2, 2))
    M[0, 0] *= 0.6 / abs(M[0, 0])
    search = wc._Search(plant())
    level, delta = search.run(M, np.array([0.7]), 20)
    assert level == pytest.approx(largest(M), rel=1e-5)
    assert abs(delta[0, 0]) == pytest.approx(1.0) and search.gain(M, delta) == level
    nominal = M.copy()
    nominal[1, 1] = 0.0
    assert search.run(nominal, np.array([1.0]), 20)[0] == pytest.approx(largest(nominal), rel=1e-5)
    quiet = M * [[1.0], [1e-3]]
    assert search.run(quiet, np.array([1.0]), 20)[0] == pytest.approx(1e-3 * largest(M), rel=1e-5)
    once = search.run(M, np.array([0.7]), 1)[0]
    assert abs(M[1, 1]) <= once <= level * (1 + 1e-9)
    level, delta = search.run(M, np.array([0.7]), 0)
    assert level == pytest.approx(abs(M[1, 1])) and delta.tolist() == [[0.0]]
    assert search.run(0 * M, np.array([0.7]), 3)[0] == 0.0


def test_the_scaling_goes_to_the_search_of_mu_beside_one_for_performance(monkeypatch):
    asked = []

    def lower(M, blocks, left, right, enough, starts):
        asked.append((M, blocks, np.diag(left), np.diag(right), enough, starts))
        return 0.0, None

    monkeypatch.setattr(wc, "mu_lower", lower)
    M = np.arange(1.0, 26.0).reshape(5, 5)
    level, delta = search_of_two().run(M, np.array([2.0, 3.0]), 5)
    [(scaled, blocks, left, right, enough, starts)] = asked
    assert level == pytest.approx(np.hypot(24.0, 25.0)) and not delta.any()
    np.testing.assert_allclose(scaled, np.vstack([M[:4], M[4:] / level]))
    assert left.tolist() == [2.0, 3.0, 3.0, 3.0, 1.0] and right.tolist() == [2.0, 2.0, 3.0, 1.0, 1.0]
    assert blocks == (*TWO, Block("full", 2, 1)) and enough == np.inf and starts == 4


def test_a_step_that_gains_nothing_ends_the_search(monkeypatch):
    search = wc._Search(plant())
    gains = iter([2.0, 2.0 * (1 + 1e-6), 9.0])
    monkeypatch.setattr(wc, "mu_lower", lambda *_, **__: (1.0, np.array([[2.0 + 0j]])))
    monkeypatch.setattr(search, "gain", lambda M, delta: next(gains))
    level, delta = search.run(np.eye(2), np.array([1.0]), 5)
    assert level == 2.0 and delta.tolist() == [[1.0]] and list(gains) == [9.0]


# ---------------------------------------------------------------- over frequencies


@pytest.mark.parametrize("dt", [0.0, 0.2])
def test_the_worst_case_is_the_largest_over_phases_and_frequencies(dt):
    one = plant(dt)
    omega = np.array([0.0, 0.4, 0.9, 1.3, 2.0, 5.0, 15.0, 16.0])
    worst = wc.worst_case(one, nothing(dt), omega=omega)
    M = lft(one.system, nothing(dt)).response(omega[omega * dt < np.pi])
    sizes = [largest(m) for m in M]
    sizes[0] = max(abs(M[0, 1, 1] + M[0, 1, 0] * s * M[0, 0, 1] / (1 - M[0, 0, 0] * s)) for s in (1, -1))
    k = int(np.argmax(sizes))
    assert worst.gain == pytest.approx(sizes[k], rel=1e-4) and worst.frequency == omega[k]
    assert worst.nominal == pytest.approx(abs(M[k, 1, 1])) and worst.size == pytest.approx(1.0, rel=1e-4)
    assert worst.delta.dt == dt and worst.delta.stability_margin() > 0
    closed = wc.close_delta(lft(one.system, nothing(dt)), worst.delta)
    assert np.abs(closed.response([worst.frequency])).item() == pytest.approx(worst.gain)


def test_at_dc_the_sign_that_is_worse_is_found():
    one = plant()
    worst = wc.worst_case(one, nothing(), omega=np.array([0.0]))
    M = lft(one.system, nothing()).response([0.0])[0].real
    gains = [abs(M[1, 1] + M[1, 0] * s * M[0, 1] / (1 - M[0, 0] * s)) for s in (1, -1)]
    assert worst.gain == pytest.approx(max(gains)) and worst.frequency == 0.0


def test_without_blocks_it_is_the_nominal_peak():
    one = plant(0.2, blocks=0)
    omega = np.array([3.0, 0.4, 0.4, 100.0])
    worst = wc.worst_case(one, nothing(0.2), omega=omega)
    M = np.linalg.norm(lft(one.system, nothing(0.2)).response([0.4, 3.0]), 2, axis=(1, 2))
    assert worst.gain == worst.nominal == M.max() and worst.frequency == [0.4, 3.0][int(np.argmax(M))]
    # At and above half the sampling frequency there is nothing to ask: 10 pi is DC again.
    high = StateSpace([[-0.9]], [[1.0, 0.0]], [[1.0], [0.0]], np.zeros((2, 2)), 0.2)
    for beyond, system in ((10 * np.pi, one.system), (np.pi / 0.2, high)):
        nominal = GeneralisedPlant(system, (), 0, 0, 1, 1)
        assert wc.worst_case(nominal, nothing(0.2), omega=np.array([3.0, beyond])).frequency == 3.0
    assert worst.size == 0.0 and worst.delta.D.shape == (0, 0) and worst.delta.dt == 0.2


@pytest.mark.parametrize("dt", [0.0, 0.2])
def test_the_search_goes_on_at_the_four_frequencies_of_largest_gain(monkeypatch, dt):
    omega, asked = np.array([0.5, 1.0, 1.5, 2.0, 2.5, 3.0]), []
    rough = iter([1.0, 6.0, 2.0, 5.0, 3.0, 4.0])
    scaling = Scaling(np.array([[0.3, 0.5, -1.0]]))

    def run(self, M, d, steps):
        asked.append((M[1, 1], float(d[0]), steps))
        return next(rough, 0.0), np.array([[1.0 + 0j]])

    real, choices = [], wc._Search.choices
    monkeypatch.setattr(
        wc._Search, "choices", lambda self, delta, at_dc: real.append(at_dc) or choices(self, delta, at_dc)
    )
    monkeypatch.setattr(wc._Search, "run", run)
    wc.worst_case(plant(dt), nothing(dt), scaling, omega)
    M = lft(plant(dt).system, nothing(dt)).response(omega)[:, 1, 1]
    order = [0, 1, 2, 3, 4, 5, 1, 3, 5, 4]
    assert [steps for *_, steps in asked] == [1] * 6 + [20] * 4
    np.testing.assert_allclose([m for m, *_ in asked], M[order])
    warped = 10 * np.tan(0.1 * omega) if dt else omega
    np.testing.assert_allclose([d for _, d, _ in asked], np.exp(scaling.log_magnitude(warped)[0])[order])
    asked.clear()
    rough = iter([1.0] * 6)
    wc.worst_case(plant(dt), nothing(dt), None, omega)
    assert {d for _, d, _ in asked} == {1.0} and real == [False] * 8
    wc.worst_case(plant(dt), nothing(dt), None, np.array([0.0]))
    assert real[8:] == [True]


def test_the_gain_is_the_largest_singular_value_of_the_closed_loop():
    G = plant().system
    B, C = G.B[:, [0, 1, 0, 2]], G.C[[0, 1, 0, 2]]
    D = np.diag([0.1, 0.2, 0.3, 0.0])
    one = GeneralisedPlant(StateSpace(G.A, B, C, D), (ONE,), 1, 1, 1, 1)
    worst = wc.worst_case(one, nothing(), omega=np.array([0.9]))
    closed = wc.close_delta(lft(one.system, nothing()), worst.delta)
    sizes = np.linalg.svd(closed.response([0.9])[0], compute_uv=False)
    assert worst.gain == pytest.approx(sizes[0]) and sizes[1] > 0.01 * sizes[0]


@pytest.mark.parametrize("pole", [0.0, 0.5])
def test_a_pole_that_is_not_stable_and_that_delta_does_not_reach_leaves_no_worst_case(pole):
    G = plant().system
    A = np.block([[G.A, np.zeros((2, 1))], [np.zeros((1, 2)), np.array([[pole]])]])
    B, C = np.vstack([G.B, np.zeros((1, 3))]), np.hstack([G.C, np.zeros((3, 1))])
    one = GeneralisedPlant(StateSpace(A, B, C, G.D), (ONE,), 1, 1, 1, 1)
    with pytest.raises(ArithmeticError, match="keeps the loop stable"):
        wc.worst_case(one, nothing(), omega=np.array([0.9]))


def test_a_loop_that_no_delta_leaves_stable_has_no_worst_case():
    with pytest.raises(ArithmeticError, match="keeps the loop stable"):
        wc.worst_case(plant(unstable=True), nothing(), omega=np.array([0.0, 1.0]))
