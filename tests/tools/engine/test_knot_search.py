"""Storage functions linear between knots: the block solver against the dense one, the grid, and the
search."""

import itertools
from dataclasses import replace
from types import SimpleNamespace

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
    values = replace(grid, speeds=speeds).F(point(grid), rate)
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
    np.testing.assert_allclose(values, wanted, rtol=1e-12, atol=1e-14)


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
        rows_of_block = slice(rows * k, rows * (k + 2))
        X = random.standard_normal((len(H[rows_of_block]), 4 * rows))
        H[rows_of_block, rows_of_block] += X @ X.T
    unit = 1 / np.sqrt(np.diagonal(H))
    H *= unit * unit[:, None]
    at = [slice(rows * k, rows * (k + 1)) for k in range(count)]
    right = random.standard_normal((size, 2))
    x = knot_search.solved_blocks(
        [np.tril(H[one, one]) for one in at], [H[two, one] for one, two in itertools.pairwise(at)], right
    )
    np.testing.assert_allclose(H @ x, right, rtol=0, atol=1e-9)


@pytest.mark.parametrize("place", [0, 1, 3])
def test_a_matrix_that_no_addition_makes_positive_is_refused(place):
    """The block may lie in the first half, in the last half, or in the middle."""
    beside = [np.zeros((1, 1)) for _ in range(4)]
    beside[place][:] = 1.1
    with pytest.raises(np.linalg.LinAlgError):
        knot_search.solved_blocks([np.eye(1)] * 5, beside, np.ones((5, 1)))


def test_what_is_found_is_positive_for_either_slope_and_near_the_centre(grid):
    point = knot_search.feasible_point(grid, Point(np.tile(np.eye(2), (4, 1, 1))), 0.3, np.eye(4))
    least = np.linalg.eigvalsh(grid.F(point, 0.3))[:, 0]
    assert least.min() > 0 and len(least) == 12
    barrier, gain = grid.barrier(0.3), grid.gain_direction()[None]
    price = barrier.price(grid.cost)
    _, _, decrement = knot_search.newton_step(
        barrier, point.P, np.array([point.excess]), gain, np.zeros(1), price
    )
    assert decrement < knot_search.NEAR


def test_a_rate_out_of_reach_is_given_up_near_the_centre(grid, monkeypatch):
    """F lacks as much at the centre of every weight, so that no step is spent on larger ones."""

    def loud(v):
        G = loop_at(v)
        return replace(G, C=10 * G.C)

    steps, newton_step = [], knot_search.newton_step

    def stub(barrier, P, y, directions, slope, price):
        steps.append(
            (
                slope[0] / (len(directions[0]) * directions.shape[-1]),
                newton_step(barrier, P, y, directions, slope, price),
            )
        )
        return steps[-1][1]

    monkeypatch.setattr(knot_search, "newton_step", stub)
    other = replace(grid, loop_at=loud)
    assert knot_search.feasible_point(other, Point(np.tile(np.eye(2), (4, 1, 1))), 0.3, np.eye(4)) is None
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
    wider = grid.with_speeds(joined)
    assert wider.knots is grid.knots and wider.speeds.tolist() == sorted({*grid.speeds, *joined})
    assert len(wider.F(low, 0.3)) == len(grid.F(low, 0.3)) + 2 * len(joined)
    assert not set(wider.violated(low, 0.3, speeds)) & set(joined)


def test_more_knots_change_nothing(grid):
    low = point(grid)
    wider, same = grid.with_knots(low, np.array([1.0, 1.5, 1.75, 2.5, 2.75, 3.0]))
    np.testing.assert_array_equal(same.P[[0, 1, 3, 5]], low.P)
    np.testing.assert_allclose(same.P[[2, 4]], [0.75 * low.P[1] + 0.25 * low.P[2], low.P[2:].mean(axis=0)])
    assert wider.speeds is grid.speeds and same.excess == low.excess
    np.testing.assert_allclose(wider.F(same, 0.3), grid.F(low, 0.3), atol=1e-12)


def test_no_speed_joins_where_none_is_violated(grid):
    def quiet(v):
        G = loop_at(v)
        return replace(G, C=0.1 * G.C)

    quieter = replace(grid, loop_at=quiet)
    point_found = knot_search.feasible_point(quieter, Point(np.tile(np.eye(2), (4, 1, 1))), 0.3, np.eye(4))
    assert len(quieter.violated(point_found, 0.3, np.linspace(1.0, 3.0, 41))) == 0
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


@pytest.mark.parametrize("delta", [(1, 2), (2, 1)])
def test_the_gain_of_delta_is_told_by_its_own_inputs_and_outputs(grid, delta):
    """Each inequality has the gain direction of its speed: eta'eta less, xi'xi more."""
    directions = replace(grid, speeds=np.array([1.5, 2.0]), delta=delta).gain_direction()
    assert len(directions) == 6
    for X, v in zip(directions, [1.5] * 4 + [2.0] * 2, strict=True):
        G = loop_at(v)
        N = np.hstack([G.C, G.D])[: delta[0]]
        np.testing.assert_allclose(X, -N.T @ N + np.diag([0, 0, 1, delta[1] - 1]), atol=1e-14)


def test_speeds_at_which_f_vanishes_are_violated(grid):
    """x+ = x at every speed and P constant: F = 0 at rate 0."""
    still = StateSpace(np.eye(2), np.zeros((2, 2)), np.zeros((2, 2)), np.zeros((2, 2)), TS)
    one = replace(grid, loop_at=lambda v: still, delta=(0, 0))
    flat = Point(np.tile(np.eye(2), (4, 1, 1)))
    assert one.violated(flat, 0.0, np.array([1.25, 2.0, 2.75])).tolist() == [1.25, 2.0, 2.75]


def test_coordinates_stay_where_not_every_state_dissipates(grid):
    """One stands still."""
    still = StateSpace(np.diag([1.0, 0.5]), np.zeros((2, 2)), np.zeros((2, 2)), np.zeros((2, 2)), TS)
    one, flat = replace(grid, loop_at=lambda v: still, delta=(0, 0)), Point(np.tile(np.eye(2), (4, 1, 1)))
    assert one.evened(flat) == (one, flat)


# ---------------------------------------------------------------- the factor by halves


@pytest.mark.parametrize(
    ("count", "lengths"), [(1, [0, 0]), (2, [1, 0]), (5, [2, 2]), (6, [3, 2]), (9, [4, 4])]
)
def test_two_threads_factor_halves_of_like_length(count, lengths, monkeypatch):
    asked, threads, factored, pool = [], [], knot_search._factored, knot_search.ThreadPoolExecutor

    def stub(chain, extra):
        asked.append((len(chain[0]), extra))
        return factored(chain, extra)

    def opened(workers):
        threads.append(workers)
        return pool(workers)

    monkeypatch.setattr(knot_search, "_factored", stub)
    monkeypatch.setattr(knot_search, "ThreadPoolExecutor", opened)
    right = np.arange(2.0 * count).reshape(count, 2)
    x = knot_search.solved_blocks([np.eye(1)] * count, [np.zeros((1, 1))] * (count - 1), right)
    np.testing.assert_allclose(x, right)
    assert sorted(n for n, _ in asked) == sorted(lengths) and threads == [2]


def test_the_least_addition_that_makes_a_matrix_positive_is_the_one_solved_with():
    for beside, extra in ((1 + 5e-14, 1e-13), (1 + 5e-10, 1e-9), (1 + 5e-8, 1e-7)):
        x = knot_search.solved_blocks([np.eye(1)] * 2, [np.array([[beside]])], np.array([[1.0], [0.0]]))
        det = (1 + extra) ** 2 - beside**2
        np.testing.assert_allclose(x.ravel() * det, [1.0, -beside], rtol=1e-2)


def test_a_triangle_is_solved_in_pieces_of_200_rows_at_most(monkeypatch):
    rows, solve = [], knot_search.sl.solve_triangular

    def stub(L, right, **options):
        rows.append(len(L))
        return solve(L, right, **options)

    monkeypatch.setattr(knot_search.sl, "solve_triangular", stub)
    L = np.tril(np.random.default_rng(5).uniform(0, 1e-2, (401, 401))) + np.eye(401)
    for size, pieces in ((200, [200]), (201, [100, 101]), (401, [200, 100, 101])):
        rows.clear()
        x = knot_search._divided(L[:size, :size], np.ones((size, 1)))
        np.testing.assert_allclose(L[:size, :size] @ x, 1.0, atol=1e-9)
        assert rows == pieces


def test_blocks_that_do_not_pair_are_refused_and_what_is_not_finite_is_passed_on():
    one = np.eye(1)
    with pytest.raises(ValueError):
        knot_search.solved_blocks([one] * 4, [0 * one], np.ones((4, 1)))
    nothing = np.full((3, 1), np.nan)
    assert np.isnan(knot_search._divided(np.eye(3), nothing)).all()
    assert np.isnan(knot_search.solved_blocks([one] * 3, [0 * one] * 2, nothing)).all()


def test_the_hessian_has_two_threads(grid, monkeypatch):
    threads, pool = [], knot_search.ThreadPoolExecutor

    def opened(workers):
        threads.append(workers)
        return pool(workers)

    monkeypatch.setattr(knot_search, "ThreadPoolExecutor", opened)
    barrier = grid.barrier(0.3)
    barrier._blocks(np.tile(np.eye(4), (12, 1, 1)))
    assert threads == [2]


# ---------------------------------------------------------------- the search at one rate


def test_f_is_measured_in_itself_or_in_what_is_nearest_and_positive():
    """By segments; of two that are as near by the mean of both. F that is 0 is not positive."""
    sizes, segment = np.array([1.0, -1.0, 3.0, 0.0, -2.0, 7.0]), np.array([0, 1, 2, 4, 4, 5])
    F = sizes[:, None, None] * np.eye(2)
    F[1, 1, 1] = 9.0
    units = knot_search._units(F, segment, 99 * np.eye(2))
    assert units[:, 0, 0].tolist() == [1.0, 2.0, 3.0, 7.0, 7.0, 7.0] and not units[:, 0, 1].any()
    none = knot_search._units(-np.ones((3, 1, 1)), np.arange(3), np.array([[5.0]]))
    assert none.ravel().tolist() == [5.0] * 3


@pytest.fixture
def stepped(monkeypatch):
    """A barrier whose F is P itself, with scripted Newton steps. Returns the calls."""

    def run(call, script):
        asked, script = [], iter(script)

        def newton_step(barrier, P, y, directions, slope, price):
            asked.append(
                SimpleNamespace(P=P, y=y.tolist(), directions=directions, slope=slope.tolist(), price=price)
            )
            step = next(script)
            if step is None:
                raise np.linalg.LinAlgError
            return P + 1.0, np.array(step[0]), step[1]

        monkeypatch.setattr(knot_search, "newton_step", newton_step)
        return call(SimpleNamespace(F=lambda P: P)), asked

    return run


UNITS = np.tile(np.diag([2.0, 4.0]), (3, 1, 1))
LACKING = np.array([np.eye(2), np.diag([-1.0, -3.0]), np.eye(2)])
"""The second lacks three quarters of its unit."""
ONE_GAIN = np.array([[np.eye(2)] * 3])
NO_GAIN = np.zeros((0, 3, 2, 2))


def feasible(stepped, script, gain=NO_GAIN, start=None):
    start = start or Point(LACKING, 0.0)
    return stepped(lambda barrier: knot_search._feasible(barrier, start, UNITS, gain, "price"), script)


def test_what_f_lacks_is_weighed_more_near_each_centre_until_nothing_lacks(stepped):
    """FIRST_WEIGHT for each of 6 rows; five times as much where the decrement is below 200."""
    script = [([0.3], 200.0), ([0.2], 199.0), ([0.04], 1.0), ([0.0], 200.0), ([-1e-9], 999.0)]
    solution, asked = feasible(stepped, script)
    np.testing.assert_array_equal(solution.P, LACKING + 5.0)
    assert solution.excess == 0.0
    assert asked[0].y == [pytest.approx(1.05 * 0.75 + 1e-3, rel=1e-12)]
    assert [one.y for one in asked[1:]] == [[0.3], [0.2], [0.04], [0.0]]
    assert [one.slope for one in asked] == [[60.0], [60.0], [300.0], [1500.0], [1500.0]]
    assert {one.price for one in asked} == {"price"}
    for one in asked:
        np.testing.assert_array_equal(one.directions, UNITS[None])


def test_a_point_is_out_of_reach_where_too_much_lacks_near_a_centre(stepped):
    assert feasible(stepped, [([0.2 + 1e-9], 199.0)])[0] is None
    assert feasible(stepped, [([0.2 + 1e-9], 200.0), None])[0] is None
    solution, asked = feasible(stepped, [([0.2], 199.0), ([0.04 + 1e-9], 199.0)])
    assert solution is None and len(asked) == 2


def test_steps_are_counted_and_a_start_that_lacks_nothing_is_found(stepped):
    solution, asked = feasible(stepped, [([0.5], 999.0)] * 99)
    assert solution is None and len(asked) == knot_search.STEPS == 60
    inside = Point(np.tile(np.eye(2), (3, 1, 1)), 0.25)
    solution, asked = feasible(stepped, [], start=inside)
    assert solution is inside and not asked
    border = Point(np.tile(np.diag([0.0, 1.0]), (3, 1, 1)), 0.25)
    assert len(feasible(stepped, [([-1.0], 1.0)], start=border)[1]) == 1


def test_the_gain_is_searched_beside_p_from_where_it_is(stepped):
    """An excess of 0.5 adds half the identity: the second then lacks 5/8 of its unit."""
    script = [([0.1, 0.9], 1.0), ([-0.1, 0.75], 1.0)]
    solution, asked = feasible(stepped, script, ONE_GAIN, Point(LACKING, 0.5))
    assert asked[0].y == [pytest.approx(1.05 * 0.625 + 1e-3), 0.5]
    assert [one.slope for one in asked] == [[60.0, 0.0], [300.0, 0.0]]
    np.testing.assert_array_equal(asked[0].directions, [UNITS, *ONE_GAIN])
    assert solution.excess == 0.75


def test_what_f_lacks_is_an_eigenvalue_over_its_unit(stepped):
    units = np.array([[[2.0, 1.0], [1.0, 4.0]]] * 3)
    _, asked = stepped(
        lambda barrier: knot_search._feasible(barrier, Point(LACKING), units, NO_GAIN, "price"),
        [([-1.0], 1.0)],
    )
    roots = np.roots([7.0, 10.0, 3.0])  # det(F - x unit) of the second
    assert asked[0].y == [pytest.approx(1.05 * -roots.min() + 1e-3)]


@pytest.mark.parametrize(
    ("script", "steps", "moves"),
    [([([0.1], 200.0)] * 9, 4, 4), ([([0.1], 200.0), ([0.2], 199.0)], 2, 2), ([([0.1], 200.0), None], 2, 1)],
)
def test_four_steps_at_most_go_to_the_centre(script, steps, moves, stepped):
    point_found, asked = stepped(
        lambda barrier: knot_search._centred(barrier, Point(LACKING, 0.5), ONE_GAIN, "price"), script
    )
    assert len(asked) == steps and asked[0].y == [0.5]
    assert all(one.slope == [0.0] and one.price == "price" and one.directions is ONE_GAIN for one in asked)
    np.testing.assert_array_equal(point_found.P, LACKING + moves)
    assert point_found.excess == script[moves - 1][0][0]
    point_found, asked = stepped(
        lambda barrier: knot_search._centred(barrier, Point(LACKING), NO_GAIN, "price"), [([], 1.0)]
    )
    assert point_found.excess == 0.0 and asked[0].y == asked[0].slope == []


def test_a_search_is_told_its_units_its_gain_and_its_price(grid, monkeypatch):
    asked = {}

    def feasible(barrier, start, units, gain, price):
        asked["feasible"] = barrier, start, units, gain, price
        return asked["point"]

    def centred(barrier, point, gain, price):
        asked["centred"] = barrier, point, gain, price
        return "centred"

    monkeypatch.setattr(knot_search, "_feasible", feasible)
    monkeypatch.setattr(knot_search, "_centred", centred)
    quiet = StateSpace(0.5 * np.eye(2), 0.1 * np.eye(2), 0.1 * np.eye(2), np.zeros((2, 2)), TS)
    start, unit = point(grid), 5 * np.eye(4)
    for delta, gains in (((1, 1), 1), ((0, 0), 0), ((0, 1), 0), ((1, 0), 1)):
        one = replace(grid, delta=delta, loop_at=lambda v: quiet)
        asked["point"] = "point"
        assert knot_search.feasible_point(one, start, 0.3, unit) == "centred"
        barrier, begun, units, gain, price = asked["feasible"]
        assert begun is start and gain.shape == (gains, 12, 4, 4)
        assert asked["centred"] == (barrier, "point", gain, price)
        wanted = one.barrier(0.3)
        np.testing.assert_array_equal(barrier.next, wanted.next)
        np.testing.assert_array_equal(price, wanted.price(grid.cost))
        np.testing.assert_array_equal(units, one.F(start, 0.0))
        if gains:
            np.testing.assert_array_equal(gain[0], one.gain_direction())
        asked["point"] = None
        assert knot_search.feasible_point(one, start, 0.3, unit) is None
