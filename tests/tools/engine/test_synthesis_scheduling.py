"""The common scaling by made-up levels, and the common family by the loops that it closes."""

import numpy as np
import pytest

from lpvguard.engine.blocks import Block
from lpvguard.engine.synthesis import scheduling
from lpvguard.engine.synthesis.dk import Scaling
from lpvguard.engine.synthesis.hinf import optimal_level
from lpvguard.engine.synthesis.interconnection import GeneralisedPlant
from lpvguard.engine.synthesis.norms import hinf_norm
from lpvguard.engine.synthesis.statespace import StateSpace, lft, to_continuous, to_discrete

DT = 0.1
SCALING = Scaling(np.array([[0.4, 0.5, -0.3]]))
POINTS = np.array([0.7 + 0.2j, -0.4 + 0.9j])


def plant(pole: float = 0.9, blocks: int = 1) -> GeneralisedPlant:
    """[xi, w, n, u] to [eta, z, effort, probe, y]."""
    A = np.array([[pole, 0.1], [0.0, 0.7]])
    B = np.array([[0.1, 0.1, 0.0, 0.2], [0.0, 0.2, 0.0, 0.3]])
    C = np.array([[0.3, 0.0], [1.0, 0.0], [0.0, 0.0], [0.0, 0.01], [1.0, 0.2]])
    D = np.zeros((5, 4))
    D[2, 3], D[4, 2], D[0, 3] = 0.5, 0.3, 0.1
    return GeneralisedPlant(StateSpace(A, B, C, D, DT), (Block("full", 1, 1),) * blocks, blocks, blocks, 1, 1)


def controller() -> StateSpace:
    return StateSpace([[0.5]], [[0.2]], [[-0.3]], [[-0.1]], DT)


def d(s: complex) -> complex:
    """D(s) of SCALING."""
    return np.exp(0.4) * (s / np.exp(0.5) + 1) / (s / np.exp(-0.3) + 1)


def test_the_scaled_plant_is_that_of_continuous_time_between_d_and_its_inverse():
    s = 0.3 + 1.1j
    G = to_continuous(plant().system)
    want = np.diag([d(s), 1, 1, 1, 1]) @ G.evaluate([s])[0] @ np.diag([1 / d(s), 1, 1, 1])
    scaled = scheduling.scaled_plant(plant(), SCALING)
    np.testing.assert_allclose(scaled.evaluate([s])[0], want)
    assert scaled.order == 4 and scaled.dt == 0.0
    np.testing.assert_array_equal(scaled.A[1:3, 1:3], G.A)


def test_the_scaled_loop_is_discrete_and_leaves_what_stands_beside_alone():
    loop = lft(plant().system, controller())
    scaled = scheduling.closed_scaled(plant(), controller(), SCALING)
    assert scaled.dt == DT and scaled.order == 5
    for z, got in zip(POINTS, scaled.evaluate(POINTS), strict=True):
        s = 2 / DT * (z - 1) / (z + 1)
        want = np.diag([d(s), 1, 1, 1]) @ loop.evaluate([z])[0] @ np.diag([1 / d(s), 1, 1])
        np.testing.assert_allclose(got, want)
    plain = scheduling.closed_scaled(plant(blocks=0), controller(), Scaling(np.zeros((0, 1))))
    np.testing.assert_array_equal(plain.A, loop.A)


# ---------------------------------------------------------------- one scaling for all


class MadeUpLevels:
    """The optimum of plant k at parameters x is 1 + |x - centre_k|; what is asked is kept."""

    def __init__(self, monkeypatch, *centres):
        self.centres = [np.array(c) for c in centres]
        self.plants = [plant() for _ in centres]
        self.asked: list[tuple[int, float]] = []
        self.least: list[float] = []
        monkeypatch.setattr(scheduling, "scaled_plant", lambda plant, scaling: (plant, scaling))
        monkeypatch.setattr(scheduling, "optimal_level", self.optimum)
        monkeypatch.setattr(scheduling, "improved_level", self.improved)

    def optimum(self, posed, n_control, n_measurement, rtol):
        assert (n_control, n_measurement, rtol) == (1, 1, scheduling.OPTIMUM_RTOL)
        plant, scaling = posed
        k = [one is plant for one in self.plants].index(True)
        return 1 + float(np.abs(scaling.log_parameters - self.centres[k]).sum())

    def improved(self, posed, n_control, n_measurement, level, rtol, least):
        value = self.optimum(posed, n_control, n_measurement, rtol)
        self.asked.append(([one is posed[0] for one in self.plants].index(True), level))
        self.least.append(least)
        return (max(value, least) if value < level else None) if value > least else least


def test_the_common_scaling_is_best_for_the_worst_plant(monkeypatch):
    levels = MadeUpLevels(monkeypatch, [[1.0, 0.0]], [[0.0, 0.5]])
    best, level = scheduling.common_scaling(levels.plants, Scaling(np.zeros((1, 2))))
    # At best both plants are 0.75 off; the last step of the search is 0.05.
    assert 1.75 - 1e-9 <= level <= 1.75 + 0.1
    assert level == pytest.approx(1 + max(np.abs(best.log_parameters - c).sum() for c in levels.centres))


def test_steps_begin_at_a_fifth_and_are_halved_until_three_hundredths(monkeypatch):
    levels = MadeUpLevels(monkeypatch, [[0.0]])
    best, level = scheduling.common_scaling(levels.plants, Scaling(np.zeros((1, 1))))
    assert level == 1.0 and best.log_parameters.tolist() == [[0.0]]
    assert levels.asked == [(0, 1.0 * (1 - 1e-4))] * 6, "both ways at 0.2, 0.1 and 0.05"
    levels = MadeUpLevels(monkeypatch, [[-0.55]])
    best, level = scheduling.common_scaling(levels.plants, Scaling(np.zeros((1, 1))))
    assert best.log_parameters == pytest.approx(np.array([[-0.55]])) and level == pytest.approx(1.0)
    # The other way is not tried where the first helps, and a step that helps is taken again.
    levels = MadeUpLevels(monkeypatch, [[0.55]])
    scheduling.common_scaling(levels.plants, Scaling(np.zeros((1, 1))))
    limits = np.array([1.55, 1.35, 1.15, *[1.05] * 6, 1.0, 1.0]) * (1 - 1e-4)
    np.testing.assert_allclose([level for _, level in levels.asked], limits, rtol=1e-9)
    monkeypatch.setattr(scheduling, "LAST_STEP", 0.05)
    levels = MadeUpLevels(monkeypatch, [[0.0]])
    scheduling.common_scaling(levels.plants, Scaling(np.zeros((1, 1))))
    assert len(levels.asked) == 6


def test_the_plant_that_refused_last_is_asked_first(monkeypatch):
    levels = MadeUpLevels(monkeypatch, [[0.0]], [[0.1]], [[0.3]])
    scheduling.common_scaling(levels.plants, Scaling(np.array([[0.15]])))
    # By 0.2: 0 refuses, then 1. By 0.1: 1 refuses, then 2. By 0.05: 0 refuses, then 2.
    assert [k for k, _ in levels.asked] == [0, *(0, 1), 1, *(1, 0, 2), *(2, 1, 0), 2]


def test_without_blocks_nothing_is_scaled(monkeypatch):
    levels = MadeUpLevels(monkeypatch, np.zeros((0, 1)), np.zeros((0, 1)))
    levels.plants[:] = [plant(blocks=0), plant(blocks=0)]
    start = Scaling(np.zeros((0, 1)))
    assert scheduling.common_scaling(levels.plants, start) == (start, 1.0)


def test_all_plants_below_a_limit_give_the_largest_and_else_the_first_that_is_not(monkeypatch):
    levels = MadeUpLevels(monkeypatch, [[0.2]], [[0.5]], [[0.4]])
    at = Scaling(np.zeros((1, 1)))
    assert scheduling._worst_below(levels.plants, 2.0, at) == (1.5, -1)
    assert levels.least == [0.0, 1.2, 1.5]
    assert scheduling._worst_below(levels.plants, 1.45, at) == (None, 1)
    assert scheduling._worst_below(levels.plants, 1.1, at) == (None, 0)


# ---------------------------------------------------------------- one family of controllers


@pytest.fixture(scope="module")
def family():
    plants = [plant(0.9), plant(0.85), plant(0.8)]
    worst = max(optimal_level(scheduling.scaled_plant(p, SCALING), 1, 1, 1e-4) for p in plants)
    at_order, rank = scheduling.common_family(plants, SCALING, 1.2 * worst)
    return plants, 1.2 * worst, at_order, rank


def test_every_controller_of_the_family_reaches_the_level(family):
    plants, level, at_order, rank = family
    assert rank == 4
    for one, K in zip(plants, at_order(rank), strict=True):
        assert K.dt == DT and K.order == 4
        loop = scheduling.closed_scaled(one, K, SCALING)
        assert loop.stability_margin() > 0 and hinf_norm(loop).upper <= level * (1 + 1e-6)


def test_truncated_or_not_they_share_the_states_of_their_mean_gramians(family):
    plants, _, at_order, rank = family
    members, reach, seen = [], 0.0, 0.0
    for one, K in zip(plants, at_order(rank), strict=True):
        loop = lft(scheduling.scaled_plant(one, SCALING), to_continuous(K))
        members.append(to_continuous(K))
        X = [(0, loop.A, loop.B @ loop.B.T), (1, loop.A.T, loop.C.T @ loop.C)]
        for k, A, Q in X:
            n = len(A)
            kron = np.kron(A, np.eye(n)) + np.kron(np.eye(n), A)
            W = -np.linalg.solve(kron, Q.ravel()).reshape(n, n)[4:, 4:]
            reach, seen = (reach + W, seen) if k == 0 else (reach, seen + W)
    # In the shared states the sums are one diagonal matrix, the largest first.
    np.testing.assert_allclose(reach, np.diag(np.diag(reach)), atol=1e-6 * np.abs(reach).max())
    np.testing.assert_allclose(reach, seen, atol=1e-6 * np.abs(reach).max())
    assert (np.diff(np.diag(reach)) <= 0).all()
    for K, less in zip(members, at_order(2), strict=True):
        cut = to_discrete(StateSpace(K.A[:2, :2], K.B[:2], K.C[:, :2], K.D), DT)
        np.testing.assert_allclose(less.evaluate(POINTS), cut.evaluate(POINTS), rtol=1e-6)
        assert less.order == 2


def test_a_member_is_the_central_controller_in_the_plants_coordinates(family):
    plants, level, *_ = family
    G = scheduling.scaled_plant(plants[0], SCALING)
    K, reach, seen = scheduling._member(1, 1, level, G)
    T = np.diag([1.0, 4.0, 0.5, 2.0])
    other, reach_T, seen_T = scheduling._member(1, 1, level, G.transformed(T))
    np.testing.assert_allclose(T @ other.A @ np.linalg.inv(T), K.A, rtol=5e-3, atol=1e-4)
    np.testing.assert_allclose(T @ reach_T @ T, reach, rtol=5e-3, atol=1e-6)
    np.testing.assert_allclose(T @ seen @ T, seen_T, rtol=5e-3, atol=1e-6)


def test_units_are_those_of_the_middle_plant_and_states_count_beside_the_largest(monkeypatch):
    plants = [plant(pole) for pole in (0.9, 0.85, 0.8, 0.75)]
    seen, G = [], [scheduling.scaled_plant(one, SCALING) for one in plants]
    monkeypatch.setattr(scheduling, "balancing", lambda one: seen.append(one) or np.ones(one.order))
    for gramian, rank in (([1.0, 0.25, 0.5e-13], 2), ([4.0, 1.0, 2e-13], 2), ([1.0, 0.25, 2e-13], 3)):
        made = StateSpace(-np.eye(3), np.ones((3, 1)), np.ones((1, 3)), [[0.0]])
        W = np.diag(gramian) / len(plants)
        monkeypatch.setattr(scheduling, "_member", lambda *_, W=W, made=made: (made, W, W))
        assert scheduling.common_family(plants, SCALING, 1.0)[1] == rank
    np.testing.assert_array_equal(seen[0].A, G[2].A)


def test_states_that_nothing_reaches_are_no_part_of_the_family():
    one = plant()
    G = one.system
    A = np.block([[G.A, np.zeros((2, 1))], [np.zeros((1, 2)), np.array([[0.5]])]])
    B, C = np.vstack([G.B, np.zeros((1, 4))]), np.hstack([G.C, np.zeros((5, 1))])
    wider = GeneralisedPlant(StateSpace(A, B, C, G.D, DT), one.blocks, 1, 1, 1, 1)
    level = 1.2 * optimal_level(scheduling.scaled_plant(one, SCALING), 1, 1, 1e-4)
    assert scheduling.common_family([wider], SCALING, level)[1] == 4
