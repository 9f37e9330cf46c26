"""The floor that no controller goes below, by Parrott's theorem and another optimiser; the table's cells."""

import csv
import io
from types import SimpleNamespace

import numpy as np
import pytest
from scipy.optimize import minimize

from lpvguard.engine.blocks import Block
from lpvguard.engine.synthesis import limits, table
from lpvguard.engine.synthesis.interconnection import GeneralisedPlant
from lpvguard.engine.synthesis.statespace import StateSpace, gain, to_discrete

ONE = Block("full", 1, 1)
TWO = (ONE, Block("full", 2, 1))


def made(seed: int, blocks=TWO, dt: float = 0.0) -> GeneralisedPlant:
    """A small plant with performance of 2 inputs and 2 outputs, 1 control and 1 measurement."""
    random = np.random.default_rng(seed)
    n_out, n_in = sum(b.rows for b in blocks), sum(b.cols for b in blocks)
    A = random.standard_normal((3, 3)) - 2.5 * np.eye(3)
    shapes = (3, n_out + 3), (n_in + 3, 3), (n_in + 3, n_out + 3)
    G = StateSpace(A, *(random.standard_normal(s) for s in shapes))
    return GeneralisedPlant(to_discrete(G, dt) if dt else G, tuple(blocks), n_out, n_in, 1, 1)


def scaled_norm(plant: GeneralisedPlant, M: np.ndarray, log_d: np.ndarray) -> float:
    """Least norm of D (M11 + M12 Q M21) D^-1 over Q, by Parrott's theorem."""
    blocks = (*plant.blocks, plant.performance_block)
    d = np.exp(np.r_[log_d, 0.0])
    left = np.repeat(d, [b.cols for b in blocks])
    right = np.repeat(d, [b.rows for b in blocks])
    scaled = left[:, None] * M[:-1, :-1] / right
    reached = np.linalg.svd(left[:, None] * M[:-1, -1:])[0]
    seen = np.linalg.svd(M[-1:, :-1] / right)[2].conj().T
    return max(np.linalg.norm(reached[:, 1:].conj().T @ scaled, 2), np.linalg.norm(scaled @ seen[:, 1:], 2))


def least(plant: GeneralisedPlant, M: np.ndarray) -> float:
    starts = np.random.default_rng(0).normal(0, 2, (3, len(plant.blocks)))
    options = {"xatol": 1e-9, "fatol": 1e-12, "maxiter": 4000}
    return min(
        minimize(lambda x: scaled_norm(plant, M, x), s, method="Nelder-Mead", options=options).fun
        for s in starts
    )


@pytest.mark.parametrize(
    ("blocks", "rtol"), [((ONE,), 2e-5), ((Block("full", 2, 1),), 1e-3), ((ONE, ONE), 5e-3)]
)
@pytest.mark.parametrize("seed", range(2))
def test_the_floor_is_the_least_scaled_norm_of_any_controller(seed, blocks, rtol):
    plant = made(seed, blocks)
    M = plant.system.response([0.7])[0]
    floor, want = limits.mu_floor(plant, 0.7, rtol), least(plant, M)
    assert floor.frequency == 0.7
    assert floor.value <= want * (1 + 1e-6) and want <= floor.at * (1 + 1e-9)
    assert floor.value <= floor.at <= floor.value * (1 + 1.05 * rtol)
    assert limits.floor_exceeds(plant, 0.7, want * (1 - 1e-3))
    assert not limits.floor_exceeds(plant, 0.7, want * (1 + 1e-3))


@pytest.mark.unhurried
def test_the_floor_is_as_near_as_was_asked():
    plant = made(1, (ONE,))
    near, far = limits.mu_floor(plant, 0.7), limits.mu_floor(plant, 0.7, rtol=1e-1)
    assert near == limits.mu_floor(plant, 0.7, rtol=2e-5) != limits.mu_floor(plant, 0.7, rtol=1e-8)
    assert near.at / near.value - 1 < 2.1e-5 < 1e-3 < far.at / far.value - 1 < 0.12


def test_a_gain_rests_on_a_direction_and_not_on_rounding(monkeypatch):
    """Rounding of terms that cancel gives no gain, and a wrong direction gives no higher one."""
    near = np.array([[1.0, 1.0], [1.0, 1.0 + 4e-16]]) + 0j
    zero = np.zeros((1, 2))
    assert limits._gain(np.eye(2), near, zero, zero)[0] < 0.3 * np.linalg.norm(np.linalg.inv(near), 2)
    random, right = np.random.default_rng(0), np.linalg.svd
    image, source = (random.standard_normal((3, 2)) + 0j for _ in range(2))
    best = limits._gain(image, source, np.zeros((1, 3)), np.zeros((1, 3)))[0]
    assert best == pytest.approx(np.linalg.norm(image @ np.linalg.pinv(source), 2), rel=1e-12)
    for seed in range(20):
        turn = np.linalg.qr(np.random.default_rng(seed).standard_normal((2, 2)))[0]
        monkeypatch.setattr(np.linalg, "svd", lambda a, t=turn, **o: [right(a, **o)[0] @ t])
        assert limits._gain(image, source, np.zeros((1, 3)), np.zeros((1, 3)))[0] <= best * (1 + 1e-12)


def test_a_box_is_bounded_from_below_and_exact_at_a_point():
    plant, random = made(5), np.random.default_rng(1)
    M = plant.system.response([0.3])[0]
    one = limits._Frequency(plant, M)
    low = random.uniform(-1, 0, (4, 2))
    high = low + random.uniform(0, 1, (4, 2))
    of_boxes = one.bound(low, high)
    for _ in range(50):
        inside = low + random.uniform(0, 1, (4, 2)) * (high - low)
        exact = one.bound(inside, inside)
        np.testing.assert_allclose(exact, [scaled_norm(plant, M, x) for x in inside], rtol=1e-10)
        assert (of_boxes <= exact * (1 + 1e-12)).all()
    corner = np.zeros((1, 2))
    # The small end on the left of M, the large one on the right.
    wide = one.bound(corner, corner + 1e-9)
    assert wide[0] <= one.bound(corner, corner)[0] <= wide[0] * (1 + 1e-8)


def test_without_blocks_it_is_parrotts_bound_and_nothing_is_searched_for():
    plant = made(2, ())
    M = plant.system.response([0.7])[0]
    want = scaled_norm(plant, M, np.zeros(0))
    floor = limits.mu_floor(plant, 0.7)
    assert floor.value == floor.at == pytest.approx(want)
    assert limits.floor_exceeds(plant, 0.7, want * (1 - 1e-9))
    assert not limits.floor_exceeds(plant, 0.7, want * (1 + 1e-9))
    assert not limits.floor_exceeds(plant, 0.7, floor.value)


def test_where_all_is_seen_and_reached_there_is_no_floor():
    """y is all of w, and u acts on z."""
    system = gain([[3.0, 1.0], [1.0, 0.0]])
    plant = GeneralisedPlant(system, (), 0, 0, 1, 1)
    assert limits.mu_floor(plant) == limits.Floor(0.0, 0.0, 0.0)


def test_a_kernel_is_that_of_singular_values_far_below_the_largest():
    """y = a w1 + w2: of the kernel is what the largest leaves 1e-9 of. With z2 free of u, z1 = u."""
    for small, floor in ((0.9e-9, 1.0), (1.1e-9, 0.0)):
        D = np.array(
            [[1.0, 0.0, 1.0, 0.0], [0.0, 1.0, 0.0, 1.0], [small, 0.0, 0.0, 0.0], [0.0, 1.0, 0.0, 0.0]]
        )
        plant = GeneralisedPlant(gain(D), (), 0, 0, 2, 2)
        assert limits.mu_floor(plant, 0.0).value == pytest.approx(floor)
        dual = GeneralisedPlant(gain(D.T), (), 0, 0, 2, 2)
        assert limits.mu_floor(dual, 0.0).value == pytest.approx(floor)


@pytest.mark.parametrize("dt", [0.0, 0.5])
def test_the_highest_floor_of_the_frequencies_below_nyquist_counts(dt):
    plant = made(3, (ONE,), dt)
    omega = np.array([0.2, 3.0, np.pi / 0.5, 9.0, 0.9])
    each = [limits.mu_floor(plant, w) for w in (omega[[0, 1, 2, 4]] if dt else omega)]
    floor = limits.mu_floor(plant, omega)
    best = max(each, key=lambda one: one.value)
    assert floor.frequency == best.frequency
    assert floor.value == pytest.approx(best.value, rel=2.1e-5)
    assert floor.value <= floor.at and floor.value >= max(one.value for one in each) * (1 - 2.1e-5)
    assert limits.GRID[0] == 0 and limits.mu_floor(plant).value > 0
    if dt:
        image = 2 * np.pi / dt - best.frequency  # its response has the same size
        worst = min(each, key=lambda one: one.value)
        assert limits.mu_floor(plant, [worst.frequency, image]) == worst


def along(sign: float, monkeypatch) -> limits._Frequency:
    """One block, and a bound of exp(x) or exp(-x), x the logarithm of its d; |x| up to 2."""
    monkeypatch.setattr(limits, "WIDEST", 2.0)
    one = limits._Frequency(made(3, (ONE,)), np.zeros((4, 4), complex))
    block, performance = np.array([[1.0], [0.0]]), np.array([[0.0], [1.0]])
    one.rows = one.cols = np.array([1, 1])
    one.unseen = (block, performance) if sign > 0 else (performance, block)
    one.unreached = np.zeros((2, 0)), np.zeros((2, 0))
    return one


@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_scalings_are_searched_from_end_to_end_and_not_beyond(sign, monkeypatch):
    one = along(sign, monkeypatch)
    low, high = one.infimum(1e-3, 0.0)
    assert low == pytest.approx(np.exp(-2), rel=1.1e-3) and np.exp(-2) <= high <= low * 1.0011
    assert one.exceeds(np.exp(-2.1)) and not one.exceeds(np.exp(-1.9))


@pytest.mark.parametrize("rounds", [1, 4])
def test_a_search_ends_after_its_rounds(rounds, monkeypatch):
    one = along(1.0, monkeypatch)
    monkeypatch.setattr(limits, "MOST_ROUNDS", rounds)
    counted, divided = [], one._divided
    monkeypatch.setattr(one, "_divided", lambda *boxes: counted.append(1) or divided(*boxes))
    one.infimum(1e-12, 0.0)
    assert len(counted) == rounds
    one.exceeds(np.exp(-2) * (1 + 1e-12))
    assert len(counted) == 2 * rounds


@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_a_search_looks_at_the_middle_of_every_new_box(sign, monkeypatch):
    one, counted = along(sign, monkeypatch), []
    divided = one._divided
    monkeypatch.setattr(one, "_divided", lambda *boxes: counted.append(1) or divided(*boxes))
    assert not one.exceeds(np.exp(-1.9)) and len(counted) == 5, "1 - 2^-5 of the way from 0"
    monkeypatch.setattr(limits, "MOST_ROUNDS", 3)
    assert one.infimum(1e-12, 0.0)[1] == pytest.approx(np.exp(-1.5))


def test_a_frequency_that_cannot_be_the_highest_is_left_early(monkeypatch):
    plant = made(3, (ONE,))
    one = limits._Frequency(plant, plant.system.response([0.2])[0])
    full = one.infimum(1e-6, 0.0)
    counted = []
    monkeypatch.setattr(
        one, "_divided", lambda *boxes: counted.append(1) or limits._Frequency._divided(one, *boxes)
    )
    early = one.infimum(1e-6, full[1] * 10)
    rounds = len(counted)
    assert early[0] <= full[0] * (1 + 1e-9) and full[1] <= early[1] <= full[1] * 10
    one.infimum(1e-6, 0.0)
    assert rounds < len(counted) - rounds
    for enough in full[1] * np.array([1.001, 1.1, 2.0]):
        assert one.infimum(1e-6, enough)[0] <= full[1]


@pytest.mark.parametrize("rounds", [1, 3, 8])
def test_a_search_that_ends_early_still_brackets(rounds, monkeypatch):
    plant = made(1)
    one = limits._Frequency(plant, plant.system.response([0.7])[0])
    low, high = one.infimum(1e-3, 0.0)
    monkeypatch.setattr(limits, "MOST_ROUNDS", rounds)
    below, above = one.infimum(1e-3, 0.0)
    assert below < low and high < above
    assert not one.exceeds(low * (1 - 1e-6)), "undecided"


def test_boxes_of_least_bound_are_cut_first_and_the_others_kept(monkeypatch):
    monkeypatch.setattr(limits, "BOXES_AT_ONCE", 2)
    plant = made(4)
    one = limits._Frequency(plant, plant.system.response([0.7])[0])
    low = np.array([[0.0, 0.0], [1.0, 1.0], [2.0, 2.0], [3.0, 3.0]])
    high = low + np.array([[1.0, 4.0]])
    values = np.array([4.0, 1.0, 3.0, 2.0])
    low2, high2, values2, new = one._divided(low, high, values)
    assert new == 4
    np.testing.assert_array_equal(low2, [[1, 1], [3, 3], [1, 3], [3, 5], [2, 2], [0, 0]])
    np.testing.assert_array_equal(high2, [[2, 3], [4, 5], [2, 5], [4, 7], [3, 6], [1, 4]])
    np.testing.assert_allclose(values2, [*one.bound(low2[:4], high2[:4]), 3.0, 4.0])


def test_the_gain_over_sources_is_a_generalised_eigenvalue():
    random = np.random.default_rng(2)
    image = random.standard_normal((3, 2)) + 1j * random.standard_normal((3, 2))
    source = random.standard_normal((4, 2)) + 1j * random.standard_normal((4, 2))
    left, right = random.standard_normal((2, 3)), random.standard_normal((2, 4))
    gains = limits._gain(image, source, left, right)
    for k in range(2):
        over, under = np.exp(left[k])[:, None] * image, np.exp(right[k])[:, None] * source
        ratio = np.linalg.eigvals(np.linalg.solve(under.conj().T @ under, over.conj().T @ over)).real.max()
        assert gains[k] == pytest.approx(np.sqrt(ratio))
    assert limits._gain(image[:, :0], source[:, :0], left, right).tolist() == [0.0, 0.0]


# ---------------------------------------------------------------- cells of the table


def test_a_cell_is_what_the_synthesis_found_beside_the_floor_and_its_time(monkeypatch):
    bracket = SimpleNamespace(peak_frequency=0.25)
    result = SimpleNamespace(
        performance=SimpleNamespace(upper=0.9, lower=0.8, bracket=bracket),
        controller=gain(np.eye(2)),
        full_order=7,
    )
    clock, asked = iter([100.0, 103.5]), []
    monkeypatch.setattr(table.time, "perf_counter", lambda: next(clock))
    monkeypatch.setattr(
        table, "dk_synthesis", lambda plant, **options: asked.append((plant, options)) or result
    )
    monkeypatch.setattr(table, "mu_floor", lambda plant: limits.Floor(0.7, 0.71, 0.5))
    one = table.cell("plant", "K_i", 95.0, 1e-6, rtol=0.1)
    assert asked == [("plant", {"rtol": 0.1})] and one.seconds == 3.5
    row = one.to_dict()
    assert tuple(row) == table.COLUMNS
    assert list(row.values()) == ["K_i", 95.0, 1e-6, 0.9, 0.8, 0, 7, 0.25, 0.7, 0.5]
    other = row | {"structure": "K_is", "mu_upper": 1 / 3, "order": None}
    read = list(csv.reader(io.StringIO(table.to_csv([row, other]))))
    assert read[0] == list(table.COLUMNS) and len(read) == 3
    assert read[2] == ["K_is", "95", "1e-06", "0.333333333", "0.8", "", "7", "0.25", "0.7", "0.5"]
    monkeypatch.setattr(table, "COLUMNS", table.COLUMNS[:-1])
    with pytest.raises(ValueError, match="longer"):
        one.to_dict()
