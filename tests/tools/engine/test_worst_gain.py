"""The worst-case gain between frequencies: above every Δ that is tried, attained by one, and sound at slow
poles."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.optimize import minimize

from lpvguard.engine.blocks import Block
from lpvguard.engine.synthesis import worst_gain as parts
from lpvguard.engine.synthesis.frequency_cells import PointBound, continuous_interval
from lpvguard.engine.synthesis.mu import mu_interval
from lpvguard.engine.synthesis.mu_upper import upper_bound
from lpvguard.engine.synthesis.norms import hinf_norm
from lpvguard.engine.synthesis.statespace import StateSpace, append, gain, series, to_discrete
from lpvguard.engine.synthesis.structure import Structure
from lpvguard.engine.synthesis.worst_gain import worst_gain

ONE = Block("full", 1, 1)


def loop_of(seed: int, size: float = 0.2) -> StateSpace:
    random = np.random.default_rng(seed)
    A = random.standard_normal((5, 5))
    A -= (np.linalg.eigvals(A).real.max() + 0.3) * np.eye(5)
    B, C = random.standard_normal((5, 4)), random.standard_normal((4, 5))
    G = StateSpace(A, B, C, 0.1 * random.standard_normal((4, 4)))
    stable = mu_interval(G.select(slice(0, 2), slice(0, 2)), [ONE, ONE], 0.0, np.inf).upper
    weight = gain(np.diag([size / stable, size / stable, 1.0, 1.0]))
    return series(weight, G)


@pytest.mark.unhurried
@pytest.mark.parametrize("seed", [1, 2, 3])
@pytest.mark.parametrize("dt", [0.0, 0.1])
def test_no_delta_of_size_1_exceeds_it_and_one_comes_close(seed, dt):
    loop = loop_of(seed, 0.6)
    loop = to_discrete(loop, dt) if dt else loop
    bound = worst_gain(loop, [ONE, ONE], Block("full", 2, 2), 0.0, np.pi / dt if dt else np.inf)
    random = np.random.default_rng(seed)
    M = loop.response([bound.omega])[0]
    reached = 0.0
    for turn in np.exp(1j * random.uniform(0, 2 * np.pi, (4000, 2))):
        delta = np.diag(turn)
        closed = M[2:, 2:] + M[2:, :2] @ delta @ np.linalg.solve(np.eye(2) - M[:2, :2] @ delta, M[:2, 2:])
        reached = max(reached, np.linalg.norm(closed, 2))
    assert 0.9 * bound.upper <= reached <= bound.upper * (1 + 1e-9)


def test_without_uncertainty_it_is_the_norm():
    loop = loop_of(5)
    bound, norm = worst_gain(loop, [], Block("full", 4, 4), 0.0, np.inf), hinf_norm(loop)
    assert norm.lower * (1 - 1e-9) <= bound.upper <= norm.upper * 1.0025


def test_a_closed_form():
    """1/(s + 1) with Δ about its input: |1 + 0.5 δ|, at most 1.5, at frequency 0."""
    loop = series(StateSpace([[-1.0]], [[1.0]], [[1.0]], [[0.0]]), gain([[1.0, 1.0]]))
    first = StateSpace(loop.A, loop.B, np.vstack([np.zeros((1, 1)), loop.C]), [[0.0, 0.5], [0.0, 0.0]])
    bound = worst_gain(first, [ONE], ONE, 0.0, np.inf)
    assert 1.5 * (1 - 1e-4) <= bound.upper <= 1.5 * 1.003 and bound.omega < 0.1


def test_where_delta_makes_the_loop_unstable_there_is_no_bound():
    assert worst_gain(loop_of(1, 1.2), [ONE, ONE], Block("full", 2, 2), 0.0, np.inf).upper == np.inf


@pytest.mark.parametrize("blocks", [(ONE, ONE), (ONE, Block("repeated_real", 1, 1))])
@pytest.mark.parametrize("dt", [0.0, 0.1])
def test_cells_prove_the_gain_that_is_returned_and_no_planted_one(blocks, dt, monkeypatch):
    loop, performance = loop_of(2, 0.6), Block("full", 2, 2)
    loop, last = (to_discrete(loop, dt), np.pi / dt) if dt else (loop, np.inf)
    bound = worst_gain(loop, blocks, performance, 0.0, last)
    structure = Structure((*blocks, performance))
    G, low, high, _ = continuous_interval("here", loop, structure, 0.0, last)
    assert len(bound.cells) > 1 and parts.proves(bound, G, structure, low, high)
    assert parts.proves(replace(bound, upper=1.5 * bound.upper), G, structure, low, high)
    wrong = (
        replace(bound, upper=0.997 * bound.upper),
        replace(bound, upper=np.inf),
        replace(bound, cells=bound.cells[1:]),
        replace(bound, cells=(replace(bound.cells[0], low=bound.cells[0].low + 0.1), *bound.cells[1:])),
    )
    for planted in wrong:
        assert not parts.proves(planted, G, structure, low, high)
    monkeypatch.setattr(parts, "cover", lambda *_: wrong[0])
    assert worst_gain(loop, blocks, performance, 0.0, last).upper == np.inf, "not proved, not stated"


def test_a_gain_that_is_asked_for_is_proved_and_a_smaller_one_is_not():
    loop, performance = loop_of(2, 0.6), Block("full", 2, 2)
    bound = worst_gain(loop, [ONE, ONE], performance, 0.0, np.inf)
    asked = 1.0015 * bound.largest
    assert worst_gain(loop, [ONE, ONE], performance, 0.0, np.inf, least=asked).upper == asked
    lower = worst_gain(loop, [ONE, ONE], performance, 0.0, np.inf, least=0.995 * bound.largest)
    assert lower.upper > 0.998 * bound.largest


@pytest.mark.parametrize("fast", [1e3, 1e5, 1e7])
def test_a_peak_at_a_slow_pole_beside_a_fast_one_is_not_passed_over(fast):
    """Rounding of the size of the fast pole moves the slow crossing's eigenvalue off the axis."""
    slow = StateSpace([[-1e-3]], [[1e-3]], [[1.0]], [[0.0]])
    other = StateSpace([[-fast, fast], [0.0, -0.5 * fast]], [[0.0], [0.3 * fast]], [[1.0, 0.0]], [[0.0]])
    both = append(slow, other)
    turn = np.array([[0.8, 0.6], [-0.6, 0.8]])
    loop = series(gain(turn), series(both, gain(turn.T)))
    mu = mu_interval(loop, [Block("full", 2, 2)], 0.0, np.inf)
    assert hinf_norm(loop).lower * (1 - 1e-9) <= mu.upper <= hinf_norm(loop).upper * 1.0025


MIXED = (
    Block("repeated_complex", 2, 2),
    Block("full", 1, 2),
    Block("repeated_real", 2, 2),
    Block("full", 2, 1),
)
"""The last is the performance: its 1 row and 2 columns of M."""


def matrix(seed: int, blocks=MIXED, size: float = 0.2) -> np.ndarray:
    random = np.random.default_rng(seed)
    shape = sum(b.cols for b in blocks), sum(b.rows for b in blocks)
    return size * (random.standard_normal(shape) + 1j * random.standard_normal(shape))


def phi(M: np.ndarray, point: PointBound, level: float) -> np.ndarray:
    skew = 1j * (point.skew @ M - M.conj().T @ point.skew.conj().T)
    return point.fixed + level**2 * point.scaled - M.conj().T @ point.left @ M - skew


@pytest.mark.parametrize("gamma", [3.0, 40.0])
@pytest.mark.parametrize("seed", range(3))
def test_the_scalings_of_a_level_prove_its_gain_and_no_smaller_one(seed, gamma):
    M, structure = matrix(seed), Structure(MIXED)
    rows, cols = structure.n_rows - 1, structure.n_cols - 2
    point = parts._bound(M, structure, rows, cols, gamma)
    assert np.linalg.eigvalsh(phi(M, point, point.value * (1 + 1e-7)))[0] > 0
    assert np.linalg.eigvalsh(phi(M, point, point.value * (1 - 1e-6)))[0] < 0
    assert parts._gain(M, point, cols) == point.value
    assert point.left[rows:, rows:].tolist() == [[1.0]] and not point.left[rows:, :rows].any()
    np.testing.assert_array_equal(point.scaled[cols:, cols:], np.eye(2))
    assert not point.fixed[cols:].any() and not point.scaled[:cols].any()
    # One D for either side of a block.
    for block, row, col in zip(MIXED[:3], structure.row, structure.col, strict=False):
        if block.repeated:
            np.testing.assert_allclose(point.left[row, row], point.fixed[col, col], rtol=1e-9)
        else:
            np.testing.assert_allclose(
                point.left[row, row], point.fixed[col, col][0, 0] * np.eye(2), rtol=1e-9
            )
    random = np.random.default_rng(seed)
    for _ in range(200):
        one, real = np.exp(2j * np.pi * random.uniform()), random.uniform(-1, 1)
        row = random.standard_normal((1, 2)) + 1j * random.standard_normal((1, 2))
        delta = np.zeros((cols, rows), complex)
        delta[:2, :2], delta[3:, 4:] = one * np.eye(2), real * np.eye(2)
        delta[2:3, 2:4] = row / np.linalg.norm(row)
        inner = np.linalg.solve(np.eye(rows) - M[:rows, :cols] @ delta, M[:rows, cols:])
        assert np.linalg.norm(M[rows:, cols:] + M[rows:, :cols] @ delta @ inner, 2) <= point.value


@pytest.mark.unhurried
@pytest.mark.parametrize("seed", range(3))
def test_the_level_at_which_mu_is_one_is_the_gain_of_its_scalings(seed):
    M, structure = matrix(seed), Structure(MIXED)
    low, high = 0.5, 8.0
    while high > low * 1.001:
        middle = np.sqrt(low * high)
        scaled = M.copy()
        scaled[-1] /= middle
        one = upper_bound(scaled, structure, 1e-4)[0] < 1
        low, high = (low, middle) if one else (middle, high)
    assert parts._bound(M, structure, 6, 5, high).value == pytest.approx(high, rel=2e-3)


def test_without_room_for_delta_there_is_no_gain():
    M = matrix(1, size=3.0)
    structure = Structure(MIXED)
    assert parts._bound(M, structure, 6, 5, 1.0) is None
    zero = np.zeros((3, 3))
    zero[0, 0] = 0.5
    two = Structure((ONE, Block("full", 2, 2)))
    assert parts._bound(zero.astype(complex), two, 1, 1, 1.0).value == 0.0


class Asked:
    """`cover` in the place of the cells: it keeps what asks at one frequency."""

    def __init__(self, monkeypatch, bounds=None):
        self.levels = []
        monkeypatch.setattr(parts, "cover", self)
        monkeypatch.setattr(parts, "continuous_interval", lambda *_: (None, 0.0, 1.0, None))
        monkeypatch.setattr(parts, "proves", lambda *_: True)
        if bounds is not None:
            answers = iter(bounds)

            def bound(M, structure, rows, cols, gamma):
                self.levels.append(gamma)
                value = next(answers)
                return None if value is None else PointBound(value, *[np.zeros((1, 1))] * 4)

            monkeypatch.setattr(parts, "_bound", bound)
        worst_gain(None, [ONE, ONE], Block("full", 2, 2), 0.0, 1.0, 0.5)

    def __call__(self, name, loop, structure, low, high, rtol, at, held, least):
        assert (name, low, high, rtol, least) == ("worst_gain", 0.0, 1.0, 0.5, 0.0)
        self.at, self.held = at, held


TALL = np.diag([0.1, 0.1, 3.0, 4.0]).astype(complex)
TALL[2, 3] = 1.0


@pytest.mark.parametrize("seed", range(3))
def test_at_one_frequency_the_least_gain_of_all_scalings_is_found(seed, monkeypatch):
    """For two scalar blocks scalings d1, d2 > 0 alone: another optimiser over their logarithms."""
    M = matrix(seed, (ONE, ONE, Block("full", 2, 2)), 0.25)

    def gain_of(logs):
        d = np.diag(np.exp(logs))
        N = M.conj().T @ np.block([[d, np.zeros((2, 2))], [np.zeros((2, 2)), np.eye(2)]]) @ M
        slack = d - N[:2, :2]
        if np.linalg.eigvalsh(slack)[0] <= 0:
            return 1e9
        return np.linalg.eigvalsh(N[2:, 2:] + N[2:, :2] @ np.linalg.solve(slack, N[:2, 2:]))[-1]

    starts = [[a, b] for a in (0.0, 2.0) for b in (0.0, 2.0)]
    options = {"xatol": 1e-10, "fatol": 1e-13}
    best = min(minimize(gain_of, start, method="Nelder-Mead", options=options).fun for start in starts)
    point = Asked(monkeypatch).at(M, 0.0)
    assert np.sqrt(best) * (1 - 1e-8) <= point.value <= np.sqrt(best) * (1 + 2e-4)


def test_levels_begin_at_the_nominal_gain_and_follow_what_was_found(monkeypatch):
    nominal = np.linalg.norm(TALL[2:, 2:], 2)
    asked = Asked(monkeypatch, [10.0, 9.0, 8.0, 8.0])
    assert asked.at(TALL, 0.0).value == 8.0
    assert asked.levels == [pytest.approx(nominal, rel=1e-12), 10.0, 9.0, 8.0]
    asked = Asked(monkeypatch, [10.0, 9.0])
    assert asked.at(TALL, 9.5).value == 9.0, "below what was reached elsewhere nothing is searched for"
    assert asked.levels == [9.5, 10.0]
    asked = Asked(monkeypatch, [10.0, 9.0])
    assert asked.at(TALL, 9.0).value == 9.0
    assert len(asked.levels) == 2
    asked = Asked(monkeypatch, [0.0])
    asked.at(0 * TALL, 0.0)
    assert asked.levels == [1e-12]


def test_a_search_is_settled_where_a_level_gains_less_than_its_tolerance(monkeypatch):
    rtol = parts.POINT_RTOL
    asked = Asked(monkeypatch, [10.0, 10.0 * (1 - 0.9 * rtol), None])
    assert asked.at(TALL, 0.0).value == 10.0 * (1 - 0.9 * rtol) and len(asked.levels) == 2
    asked = Asked(monkeypatch, [10.0, 10.0 * (1 - 1.1 * rtol), None])
    assert asked.at(TALL, 0.0).value == 10.0 * (1 - 1.1 * rtol) and len(asked.levels) == 3
    asked = Asked(monkeypatch, [10.0, 11.0, 5.0])
    assert asked.at(TALL, 0.0).value == 10.0, "the better one is kept"
    asked = Asked(monkeypatch, [100.0 - k for k in range(50)])
    assert asked.at(TALL, 0.0).value == 89.0 and len(asked.levels) == 12


def test_a_level_without_room_is_followed_by_four_times_it_up_to_a_million(monkeypatch):
    nominal = np.linalg.norm(TALL[2:, 2:], 2)
    asked = Asked(monkeypatch, [None, None, 9.0, None, 7.0])
    assert asked.at(TALL, 0.0).value == 9.0
    assert asked.levels == pytest.approx([nominal, 4 * nominal, 16 * nominal, 9.0], rel=1e-12)
    asked = Asked(monkeypatch, [None] * 50)
    bound = asked.at(TALL, 0.0)
    assert asked.levels == pytest.approx([nominal * 4.0**k for k in range(10)]), "4^10 is above a million"
    assert bound.value == np.inf
    assert [M.shape for M in (bound.left, bound.fixed, bound.scaled, bound.skew)] == [(4, 4)] * 4
    assert not any(M.any() for M in (bound.left, bound.fixed, bound.scaled, bound.skew))
    monkeypatch.setattr(parts, "LARGEST", 16.0)
    asked = Asked(monkeypatch, [None] * 50)
    asked.at(TALL, 0.0)
    assert len(asked.levels) == 3, "16 times the nominal gain is not above it"
