"""Storage functions linear between knots: the block solver against the dense one, what joins, and what is
found."""

import itertools
from dataclasses import replace

import numpy as np
import pytest

from lpvguard.engine.synthesis import knot_search
from lpvguard.engine.synthesis.barrier import Barrier
from lpvguard.engine.synthesis.knot_search import KnotBarrier, KnotGrid, Point
from lpvguard.engine.synthesis.statespace import StateSpace

TS = 0.1


def loop_at(v: float) -> StateSpace:
    """Two states that follow the speed, one xi and one w in, eta and z out."""
    A = np.array([[0.8 - 0.05 * v, 0.1 * v], [-0.1 * v, 0.7]])
    B = np.array([[0.1, 0.05 * v], [0.0, 0.1]])
    C = np.array([[0.2, 0.1], [0.3 * v, 0.2]])
    return StateSpace(A, B, C, np.array([[0.0, 0.0], [0.1, 0.0]]), TS)


@pytest.fixture
def grid():
    knots = np.array([1.0, 1.5, 2.5, 3.0])
    return KnotGrid(loop_at, TS, knots, knots, np.eye(2), (1, 1), 1e-4 * np.eye(2))


def point(grid) -> Point:
    """P that bends at every knot, and a gain above that of the loop."""
    return Point(
        np.array([(1 + 0.2 * k) * np.array([[3.0, 0.2 * k], [0.2 * k, 2.0]]) for k in range(4)]), 0.1
    )


def test_f_is_what_the_inequality_says(grid):
    """At a knot and between knots, for either slope and direction, by hand."""
    rate = 0.7
    P, speeds = point(grid).P, np.array([1.5, 2.0])
    found = replace(grid, speeds=speeds).F(point(grid), rate)
    wanted = []
    for v, now, slopes in (
        (1.5, P[1], [(P[1] - P[0]) / 0.5, P[2] - P[1]]),
        (2.0, 0.5 * (P[1] + P[2]), [P[2] - P[1]]),
    ):
        G = loop_at(v)
        M, N = np.hstack([G.A, G.B]), np.hstack([G.C, G.D])
        for slope in slopes:
            for sign in (1.0, -1.0):
                F = -M.T @ (now + sign * rate * TS * slope) @ M - N[1:].T @ N[1:] - 1.1 * N[:1].T @ N[:1]
                F[:2, :2] += now
                wanted.append(F + np.diag([0.0, 0.0, 1.1, 1.0]))
    np.testing.assert_allclose(found, wanted, rtol=1e-12, atol=1e-14)


def test_the_block_solver_agrees_with_the_dense_one(grid):
    grid = replace(grid, speeds=np.array([1.0, 1.5, 1.75, 2.5, 3.0]))
    blocks = grid.barrier(0.7)
    assert type(blocks) is KnotBarrier
    M, N = blocks.D + np.eye(2, 4), np.zeros((2, 4))
    dense = Barrier([(one, N) for one in M], blocks.next + blocks.moved, blocks.next)
    random = np.random.default_rng(3)
    X = random.standard_normal((len(M), 4, 4))
    S, right = X @ np.swapaxes(X, 1, 2) + np.eye(4), random.standard_normal((12, 3))
    np.testing.assert_allclose(blocks.solved(S, right), dense.solved(S, right), rtol=1e-9, atol=1e-12)


@pytest.mark.parametrize(("rows", "count"), [(3, 1), (3, 2), (3, 3), (3, 6), (230, 3)])
def test_the_halves_of_the_factor_meet_whatever_the_number_of_blocks(rows, count):
    """230 rows are more than are solved at once."""
    random, size = np.random.default_rng(4), rows * count
    H = 0.1 * np.eye(size)
    for k in range(max(count - 1, 1)):
        of = slice(rows * k, rows * (k + 2))
        X = random.standard_normal((len(H[of]), 4 * rows))
        H[of, of] += X @ X.T
    unit = 1 / np.sqrt(np.diagonal(H))
    H *= unit * unit[:, None]
    at = [slice(rows * k, rows * (k + 1)) for k in range(count)]
    right = random.standard_normal((size, 2))
    found = knot_search.solved_blocks(
        [np.tril(H[one, one]) for one in at],
        [H[two, one] for one, two in itertools.pairwise(at)],
        right,
    )
    np.testing.assert_allclose(H @ found, right, rtol=0, atol=1e-9)


@pytest.mark.parametrize("place", [0, 1, 3])
def test_a_matrix_that_no_addition_makes_positive_is_refused(place):
    """Wherever the block lies: the first half, the last one, or the middle."""
    beside = [np.zeros((1, 1)) for _ in range(4)]
    beside[place][:] = 1.1
    with pytest.raises(np.linalg.LinAlgError):
        knot_search.solved_blocks([np.eye(1)] * 5, beside, np.ones((5, 1)))


def test_what_is_found_is_positive_for_either_slope_and_near_the_centre(grid):
    found = knot_search.found_at(grid, Point(np.tile(np.eye(2), (4, 1, 1))), 0.3, np.eye(4))
    least = np.linalg.eigvalsh(grid.F(found, 0.3))[:, 0]
    assert least.min() > 0 and len(least) == 12
    barrier, gain = grid.barrier(0.3), grid.gain_direction()[None]
    price = barrier.price(grid.cost)
    _, _, decrement = knot_search.newton_step(
        barrier, found.P, np.array([found.excess]), gain, np.zeros(1), price
    )
    assert decrement < knot_search.NEAR


def test_a_rate_out_of_reach_is_given_up_near_the_centre(grid, monkeypatch):
    """F lacks as much at the centre of every weight, so that no step is spent on larger ones."""

    def loud(v):
        G = loop_at(v)
        return replace(G, C=10 * G.C)

    steps, newton_step = [], knot_search.newton_step

    def told(barrier, P, y, directions, slope, price):
        steps.append(
            (
                slope[0] / (len(directions[0]) * directions.shape[-1]),
                newton_step(barrier, P, y, directions, slope, price),
            )
        )
        return steps[-1][1]

    monkeypatch.setattr(knot_search, "newton_step", told)
    other = replace(grid, loop_at=loud)
    assert knot_search.found_at(other, Point(np.tile(np.eye(2), (4, 1, 1))), 0.3, np.eye(4)) is None
    weight, (_, y, decrement) = steps[-1]
    assert (
        weight == knot_search.FIRST_WEIGHT and decrement < knot_search.NEAR and len(steps) < knot_search.STEPS
    )
    assert y[0] > knot_search.OUT_OF_REACH / weight


def test_the_worst_speed_of_every_segment_is_asked_besides(grid):
    speeds = np.linspace(1.0, 3.0, 41)
    low = replace(point(grid), P=0.05 * point(grid).P)
    joined = grid.violated(low, 0.3, speeds)
    assert len(joined) == 3 and not set(joined) & set(grid.knots)
    for v in joined:
        k = np.searchsorted(grid.knots, v)
        inside = speeds[(speeds > grid.knots[k - 1]) & (speeds < grid.knots[k])]
        least = {
            u: np.linalg.eigvalsh(replace(grid, speeds=np.array([u])).F(low, 0.3))[:, 0].min() for u in inside
        }
        assert min(least, key=least.__getitem__) == v
    wider = grid.asked_at(joined)
    assert wider.knots is grid.knots and wider.speeds.tolist() == sorted({*grid.speeds, *joined})
    assert len(wider.F(low, 0.3)) == len(grid.F(low, 0.3)) + 2 * len(joined)
    assert not set(wider.violated(low, 0.3, speeds)) & set(joined)


def test_more_knots_change_nothing(grid):
    low = point(grid)
    wider, same = grid.bent_at(low, np.array([1.0, 1.5, 1.75, 2.5, 2.75, 3.0]))
    np.testing.assert_array_equal(same.P[[0, 1, 3, 5]], low.P)
    np.testing.assert_allclose(same.P[[2, 4]], [0.75 * low.P[1] + 0.25 * low.P[2], low.P[2:].mean(axis=0)])
    assert wider.speeds is grid.speeds and same.excess == low.excess
    np.testing.assert_allclose(wider.F(same, 0.3), grid.F(low, 0.3), atol=1e-12)


def test_no_speed_joins_where_none_is_violated(grid):
    def quiet(v):
        G = loop_at(v)
        return replace(G, C=0.1 * G.C)

    quieter = replace(grid, loop_at=quiet)
    found = knot_search.found_at(quieter, Point(np.tile(np.eye(2), (4, 1, 1))), 0.3, np.eye(4))
    assert len(quieter.violated(found, 0.3, np.linspace(1.0, 3.0, 41))) == 0
    assert len(grid.violated(point(grid), 0.3, grid.speeds)) == 0, "nothing is left to ask"


def test_even_coordinates_change_nothing_but_the_coordinates(grid):
    one = point(grid)
    other, moved = grid.evened(one)
    mean = other.F(moved, 0.0).mean(axis=0)[:2, :2]
    np.testing.assert_allclose(mean, np.eye(2), atol=1e-9)
    assert abs(moved.P.mean(axis=0)[0, 1]) < 1e-9 * np.trace(moved.P.mean(axis=0))
    assert other.barrier(0.3).price(other.cost) @ moved.P[:, *np.triu_indices(2)].ravel() == pytest.approx(
        grid.barrier(0.3).price(grid.cost) @ one.P[:, *np.triu_indices(2)].ravel()
    )
    signs = np.sign(np.linalg.eigvalsh(other.F(moved, 0.3))), np.sign(np.linalg.eigvalsh(grid.F(one, 0.3)))
    np.testing.assert_array_equal(*signs)
    worse = replace(one, P=-one.P)
    assert grid.evened(worse) == (grid, worse)
