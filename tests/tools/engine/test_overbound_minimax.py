"""The search of the least worst ratio by its parts: the grid, the linear program, and the steps from one
program to the next, each by hand or with given answers."""

import math
from types import SimpleNamespace

import numpy as np
import pytest

from lpvguard.engine.overbound import minimax
from lpvguard.engine.overbound.bound import SampledBound
from lpvguard.engine.overbound.minimax import Grid, MinimaxFit


def grid_of(omega, bound, *, strict: bool = False) -> Grid:
    return Grid(SampledBound.read("here", omega, bound, None), strict)


@pytest.fixture
def flat() -> Grid:
    """A bound of 1 from 1 to 2 rad/s, in units of 1."""
    return grid_of([1.0, 2.0], [1.0, 1.0])


def rising(db: float) -> tuple[np.ndarray, np.ndarray]:
    """(N, D) that go from 1 at y = 0 to this ratio at the infinite: over a flat bound their worst ratio."""
    return np.array([1.0, 10.0 ** (db / 10.0)]), np.ones(2)


# ---------------------------------------------------------------- the grid


@pytest.mark.parametrize("strict", [False, True])
def test_a_grid_has_the_samples_a_fiftieth_between_them_and_tails_of_three_decades(strict):
    """Samples of 1, 1.5 and 16 rad/s in a unit of 4, of bounds 1, 8, 2 in a level of 4."""
    grid = grid_of([1.0, 1.5, 16.0], [1.0, 8.0, 2.0], strict=strict)
    w, b = [0.25, 0.375, 4.0], [0.25, 2.0, 0.5]
    tail = [0.02 * (math.log(1e3) / 0.02) ** (i / 29) for i in range(30)]
    at = [0.0, *(w[0] * math.exp(-t) for t in reversed(tail))]
    for lo, hi in ((w[0], w[1]), (w[1], w[2])):
        steps = int(math.log(hi / lo) / 0.02) + 1
        at += [lo * (hi / lo) ** (i / steps) for i in range(steps)]
    at += [w[2], *(w[2] * math.exp(t) for t in tail), math.inf]
    np.testing.assert_allclose(grid.y, np.square(at), rtol=1e-12)
    assert grid.band == pytest.approx((math.log(0.25), math.log(4.0))) and grid.end == pytest.approx(16.0)
    slopes = [math.log(b[i + 1] / b[i]) / math.log(w[i + 1] / w[i]) for i in (0, 1)]
    for x, b2 in zip(at, grid.b2, strict=True):
        bound = b[0] if x <= w[0] else b[1] * (x / w[1]) ** slopes[x > w[1]] if x <= w[2] else b[2]
        ceiling = min(1.0, 100 * 16.0 / x**2) if strict and 0.0 < x < math.inf else 1.0
        assert b2 == pytest.approx(bound**2 * ceiling, rel=1e-10)
    np.testing.assert_array_equal(grid.below, np.array(at) <= w[2] * (1 + 1e-12) if strict else True)
    assert grid.below.shape == grid.y.shape and (grid.below.all() or strict)


def test_a_roll_off_begins_a_decade_beyond_the_band_in_any_unit():
    with np.errstate(all="raise"):
        grid = grid_of([100.0, 225.0], [1.0, 1.0], strict=True)
    far = (grid.y > 100 * grid.end) & np.isfinite(grid.y)
    assert grid.end == pytest.approx((225.0 / grid.samples.unit) ** 2) and grid.end != 1.0
    np.testing.assert_allclose(grid.b2[far], 100 * grid.end / grid.y[far], rtol=1e-12)
    np.testing.assert_allclose(grid.b2[~far], 1.0, rtol=1e-12)
    assert 3 < far.sum() < 20 and grid.b2[-1] == pytest.approx(1.0)


def test_a_place_that_is_put_on_the_grid_has_its_bound():
    grid = grid_of([1.0, 4.0], [1.0, 4.0])
    before = grid.y
    with np.errstate(all="raise"):
        grid.insert(np.array([0.0, 0.31, 7e7, before[40]]))
    fresh = np.setdiff1d(grid.y, before)
    np.testing.assert_allclose(fresh, [0.31, 7e7], rtol=1e-12)
    assert (np.diff(grid.y) > 0).all() and len(grid.y) == len(grid.b2) == len(grid.below) == len(before) + 2
    # Bound w over a level of 2 and w in units of 2: b^2 = y between the samples.
    assert grid.b2[np.argmin(np.abs(grid.y - 0.31))] == pytest.approx(0.31)


@pytest.mark.parametrize(
    "omega, bound",
    [
        (np.geomspace(1.0, 100.0, 9), [3.0, 1.0, 4.0, 1.5, 9.0, 2.0, 6.0, 5.0, 3.0]),
        ([1.0, 1.1, 1.2, 1e9], [2.0, 1.0, 3.0, 2.0]),
    ],
)
def test_a_program_begins_with_both_ends_and_the_extremes_of_24_stretches(omega, bound):
    """The second bound has its extremes beside the first sample: the end is none of them."""
    grid = grid_of(omega, bound)
    n, want, at = grid.y.size, {grid.y[0], grid.y[-1]}, 0
    for k in range(24):
        stretch = range(at, at + n // 24 + (k < n % 24))
        at = stretch.stop
        want |= {grid.y[f(stretch, key=lambda i: grid.b2[i])] for f in (min, max)}
    assert at == n
    np.testing.assert_array_equal(grid.start(), sorted(want))


def test_the_powers_of_the_infinite_are_the_leading_coefficients(flat):
    powers = flat.powers(3)
    assert powers.shape == (flat.y.size, 4) and powers[-1].tolist() == [0, 0, 0, 1] and powers[0, 0] == 1.0
    np.testing.assert_allclose(powers[7], [1.0, flat.y[7], flat.y[7] ** 2, flat.y[7] ** 3], rtol=1e-14)


def test_a_ratio_is_none_where_the_denominator_is_not_positive():
    grid = grid_of([1.0, 2.0], [3.0, 3.0])
    top, bottom = np.array([2.0, 1.0]), np.array([4.0, -1.0, 0.0])
    with np.errstate(all="raise"):
        ratio2 = grid.ratio2(top, bottom)
    y, b2 = grid.y[:-1], grid.b2[0]
    assert b2 == pytest.approx((3.0 / grid.samples.level) ** 2)
    want = [(2 + at) / (b2 * (4 - at)) if at < 4 else math.nan for at in y] + [math.nan]
    np.testing.assert_allclose(ratio2, want, rtol=1e-12)
    assert grid.ratio2(np.array([1.0, 5.0]), np.array([1.0, 2.0]))[-1] == pytest.approx(2.5 / b2)
    assert np.isnan(grid.ratio2(np.ones(1), np.zeros(1))).all(), "a denominator of zero"


def test_the_spread_is_that_of_the_rows_from_the_least_below_the_band():
    grid = grid_of([1.0, 2.0], [1.0, 1.0], strict=True)
    ratio2 = np.full(grid.y.size, 3.0)
    ratio2[4], ratio2[-2] = 30.0, 0.01
    assert grid.spread_db(ratio2) == pytest.approx(10.0), "beyond the band nothing must lie above the bound"
    rows = np.array([0, 4, 9, grid.y.size - 2])
    assert grid.spread_db(ratio2[rows], rows) == pytest.approx(10.0)
    assert grid.spread_db(ratio2[rows[2:]], rows[2:]) == 0.0
    ratio2[-2] = 300.0
    assert grid.spread_db(ratio2) == pytest.approx(20.0)
    for wrong in (0.0, -0.5, math.nan):
        ratio2[9] = wrong
        with np.errstate(all="raise"):
            assert grid.spread_db(ratio2) == math.inf
    ratio2[9], ratio2[-2] = 3.0, math.nan
    assert grid.spread_db(ratio2) == math.inf, "a pole beyond the band"
    assert grid.spread_db(np.full(grid.y.size, 1e-3)) == 0.0


# ---------------------------------------------------------------- what fails


def grid_with(y, ratio_db, *, below=None, strict=False):
    """A grid of which only places and the band matter, and ratios given in dB; NaN stays."""
    y = np.asarray(y, float)
    below = np.ones(len(y), bool) if below is None else below
    return SimpleNamespace(y=y, below=below, strict=strict), 10.0 ** (np.asarray(ratio_db, float) / 10.0)


def test_the_places_that_are_added_are_the_local_extremes_outside_one_and_the_level():
    db = np.zeros(100)
    db[0], db[10], db[11], db[20], db[80], db[99] = 3.0, 3.0, 2.5, -1.0, -1.0, 5.0
    db[30] = db[31] = 4.0
    db[40], db[50], db[60], db[70] = 2.00051, 2.00049, -0.00051, -0.00049
    below = np.arange(100) < 75
    grid, ratio2 = grid_with(np.arange(100), db, below=below)
    assert minimax._failures(grid, ratio2, 2.0).tolist() == [0, 10, 20, 30, 31, 40, 60, 99]


def test_one_place_is_added_of_each_stretch_without_a_ratio():
    ratio = np.ones(40)
    ratio[3:7], ratio[20], ratio[38:], ratio[30:33] = np.nan, np.nan, np.nan, -0.5
    y = np.append(np.arange(39.0), np.inf)
    for strict in (False, True):
        grid = SimpleNamespace(y=y, below=np.ones(40, bool), strict=strict)
        with np.errstate(all="raise"):
            places = minimax._failures(grid, ratio, 0.0).tolist()
        assert places == [4, 20, 31, 38], "the middle of each"
    grid, _ = grid_with(range(3), [0, 0, 0])
    with np.errstate(all="raise"):
        assert minimax._failures(grid, np.array([0.0, 1.0, 1.0]), 0.0).tolist() == [0]
    # A strictly proper weight is 0 at the infinite, and nowhere else.
    for strict, places in ((True, [1]), (False, [1, math.inf])):
        grid = SimpleNamespace(y=np.array([0.0, 1.0, 2.0, np.inf]), below=np.zeros(4, bool), strict=strict)
        assert minimax._failures(grid, np.array([1.0, 0.0, 1.0, 0.0]), 0.0).tolist() == places


def test_thirty_extremes_are_added_at_most_the_worst_first():
    db = np.zeros(200)
    db[1:120:3] = np.linspace(1.0, 5.0, 40)
    grid, ratio2 = grid_with(np.arange(200), db)
    assert minimax._failures(grid, ratio2, 0.0).tolist() == list(range(1 + 3 * 10, 120, 3))
    db[1:120:3] = 1.0
    assert minimax._failures(*grid_with(np.arange(200), db), 0.0).tolist() == list(range(1, 90, 3))


@pytest.mark.parametrize("at", [0, 1])
def test_lightly_damped_poles_and_zeros_are_put_on_the_grid_with_a_place_between(flat, monkeypatch, at):
    """Of roots in y only those on the right matter; the leading zeros of a lower degree are cut off."""
    inserted: list[list[float]] = []
    monkeypatch.setattr(flat, "insert", lambda y: inserted.append(y.tolist()))
    roots = [0.5 + 0.1j, 0.5 - 0.1j, 8.0, -3.0, -1 + 2j, -1 - 2j, 0.02, -0.3]
    resonant = np.append(np.real(np.poly(roots))[::-1], [0.0, 0.0])
    damped = np.real(np.poly([-2.0, -0.5, 0.0]))[::-1]
    minimax._resolve(flat, *((resonant, damped) if at == 0 else (damped, resonant)))
    size = math.hypot(0.5, 0.1)
    assert len(inserted) == 1
    want = [0.02, size, 8.0, math.sqrt(0.02 * size), math.sqrt(8.0 * size)]
    # The pair's two sizes differ by rounding, or are one.
    np.testing.assert_allclose(np.unique(np.round(inserted[0], 9)), np.sort(np.round(want, 9)), rtol=1e-6)


# ---------------------------------------------------------------- one linear program


class Program:
    """What is asked of the solver at ``rows``, and an answer given to it."""

    def __init__(self, monkeypatch, grid: Grid, rows, bottom, level_db: float):
        self.grid, self.rows, self.bottom = grid, np.array(rows), np.array(bottom)
        self.t = 10.0 ** (level_db / 20.0)
        self.asked: dict = {}
        self.status = 0
        n = len(bottom) - 1
        self.x = np.array([0.5, -3.0, 2.0, 4.0, -8.0, 1.0, 0.25, 7.0][: 2 * n + 3 - grid.strict])
        monkeypatch.setattr(minimax, "linprog", self.solve)
        powers = grid.powers(n)[self.rows]
        self.answer = minimax._program(grid, powers, self.rows, self.bottom, level_db)

    def solve(self, cost, **named):
        self.asked = named | {"cost": cost}
        return SimpleNamespace(status=self.status, x=self.x)

    def rows_of(self) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
        """Rows of N' and D in units of D_old, the mean of D, and the columns' largest entries."""
        n_rows, d_rows, plain = [], [], []
        for i in self.rows:
            y = self.grid.y[i]
            powers = [y**k for k in range(len(self.bottom))] if np.isfinite(y) else [0, 0, 1]
            size = sum(p * abs(c) for p, c in zip(powers, self.bottom, strict=True))
            old = sum(p * c for p, c in zip(powers, self.bottom, strict=True))
            unit = max(old, 1e-5 * size)
            plain.append([p / size for p in powers])
            d_rows.append([p / unit for p in powers])
            last = len(powers) - self.grid.strict
            n_rows.append([p / unit / self.grid.b2[i] for p in powers[:last]])
        n, d = np.array(n_rows), np.array(d_rows)
        return n, d, np.mean(plain, axis=0), n.max(axis=0), d.max(axis=0)


@pytest.mark.parametrize("strict", [False, True])
def test_a_program_is_asked_in_units_of_the_old_denominator(strict, monkeypatch):
    """bound^2 D <= t N', N' / t - bound^2 D <= tau bound^2 D_old, D >= 1e-5 D_old, mean of D = 1."""
    grid = grid_of([1.0, 9.0], [2.0, 3.0], strict=strict)
    last = len(grid.y) - 1
    program = Program(monkeypatch, grid, [0, 20, 60, 100, last - 5, last], [2.0, -1.0, 0.5], 6.0)
    n, d, mean, n_scale, d_scale = program.rows_of()
    a, tau = program.asked["A_ub"], np.ones((6, 1))
    below = grid.below[program.rows]
    assert below.tolist() == ([True] * 4 + [False] * 2 if strict else [True] * 6)
    n_all, d_all = n / n_scale, d / d_scale
    np.testing.assert_allclose(
        a[:6], np.hstack([-program.t * n_all, below[:, None] * d_all, 0 * tau]), rtol=1e-12
    )
    np.testing.assert_allclose(a[6:12], np.hstack([n_all / program.t, -d_all, -tau]), rtol=1e-12)
    np.testing.assert_allclose(a[12:], np.hstack([0 * n_all, -d_all, 0 * tau]), rtol=1e-12)
    beyond = [0.0] * 6
    if strict:  # N only stays positive
        beyond = [0.0] * 4 + [-1e-5 * grid.end / grid.y[last - 5], 0.0]
    np.testing.assert_allclose(program.asked["b_ub"], [*beyond, *[0.0] * 6, *[-1e-5] * 6], rtol=1e-12)
    columns = a.shape[1]
    assert columns == 7 - strict and program.asked["cost"].tolist() == [0.0] * (columns - 1) + [1.0]
    np.testing.assert_allclose(
        program.asked["A_eq"], [[*[0.0] * (3 - strict), *(mean / d_scale), 0.0]], rtol=1e-12
    )
    assert program.asked["b_eq"] == [1.0] and program.asked["bounds"] == (None, None)
    top, bottom = program.answer
    k = 3 - strict
    raw = program.x[:k] / n_scale, program.x[k:-1] / d_scale
    size = np.abs(raw[1]).max()
    np.testing.assert_allclose(top, raw[0] / size, rtol=1e-12)
    np.testing.assert_allclose(bottom, raw[1] / size, rtol=1e-12)


def test_rows_in_a_sharp_resonance_are_scaled_by_a_part_of_their_terms(monkeypatch):
    """D_old = (1 - y)^2 + 1e-9 is a billionth of its terms' sum at y = 1."""
    grid = grid_of([0.5, 1.0, 2.0], [1.0, 1.0, 1.0])
    at = int(np.argmin(np.abs(grid.y - 1.0)))
    program = Program(monkeypatch, grid, [0, at, len(grid.y) - 1], [1.0 + 1e-9, -2.0, 1.0], 0.0)
    _, d, _, _, scale = program.rows_of()
    np.testing.assert_allclose(program.asked["A_ub"][3:, 3:6], np.vstack([-d / scale] * 2), rtol=1e-6)
    assert d[1, 0] == pytest.approx(1e5 / 4, rel=1e-6)


def test_a_program_that_is_given_up_has_no_answer(monkeypatch):
    grid = grid_of([1.0, 9.0], [2.0, 3.0])
    monkeypatch.setattr(minimax, "linprog", lambda *_, **__: SimpleNamespace(status=4, x=None))
    assert minimax._program(grid, grid.powers(1)[:3], np.arange(3), np.ones(2), 1.0) is None


def test_the_program_finds_the_weight_that_calculus_knows():
    """A bound that is flat needs no more than a constant: at any level the violation is 0, or 1 - 1 / t^2."""
    grid = grid_of([1.0, 2.0], [1.0, 1.0])
    rows = np.arange(0, grid.y.size, 10)
    top, bottom = minimax._program(grid, grid.powers(1)[rows], rows, np.array([1.0, 2.0]), 6.0)
    ratio2 = grid.ratio2(top, bottom)[rows]
    assert grid.spread_db(ratio2, rows) <= 6.0 + 1e-6 and np.abs(bottom).max() == 1.0


# ---------------------------------------------------------------- from one program to the next


class Trials:
    """A bracket whose programs have given worst ratios [dB], None where the solver gives up."""

    def __init__(self, monkeypatch, grid: Grid, reached_db):
        self.grid, self.reached = grid, iter(reached_db)
        self.levels: list[float] = []
        self.bottoms: list[np.ndarray] = []
        self.given: list[tuple[np.ndarray, np.ndarray]] = []
        self.active = grid.y[[0, 7, 50, -1]]
        monkeypatch.setattr(minimax, "_program", self.program)

    def program(self, grid, powers, rows, bottom, level):
        assert grid is self.grid and rows.tolist() == [0, 7, 50, grid.y.size - 1]
        np.testing.assert_array_equal(powers, grid.powers(1)[rows])
        self.levels.append(level)
        self.bottoms.append(bottom)
        db = next(self.reached, None)
        if db is None:
            return None
        top, bottom = rising(db)
        self.given.append((3.0 * top, bottom))
        return self.given[-1]

    def bracket(self, lower_db: float, upper_db: float, tol_db: float):
        bottom = np.array([1.0, 5.0])
        polynomials, lower = minimax._exchange(self.grid, self.active, 1, bottom, lower_db, upper_db, tol_db)
        np.testing.assert_array_equal(self.bottoms[0], bottom) if self.bottoms else None
        return polynomials, lower


def test_a_bracket_is_halved_until_a_step_is_fast_and_then_tried_near_its_upper_end(flat, monkeypatch):
    trials = Trials(monkeypatch, flat, [6.0, 3.4, 4.0])
    bracket_, lower = trials.bracket(0.0, 8.0, 1.0)
    # 6 dB at a trial of 1: the optimum is above 1, and what was found is the new upper end.
    assert trials.levels == pytest.approx([1.0, 3.5, 2.5]) and lower == pytest.approx(2.5)
    np.testing.assert_array_equal(bracket_[1], trials.given[1][1])
    np.testing.assert_allclose(bracket_[0], rising(3.4)[0], rtol=1e-12)
    assert trials.bottoms[1] is trials.given[0][1] and trials.bottoms[2] is trials.given[1][1]
    # A bracket that is just half as wide was a fast step: 3.5 of 7.
    trials = Trials(monkeypatch, flat, [9.0, 9.0, 7.5])
    trials.bracket(0.0, 8.0, 1.0)
    assert trials.levels[:3] == pytest.approx([1.0, 4.5, 7.1])
    # What counts is the bracket's width, not where it lies: 3.7 of 7 is slow.
    trials = Trials(monkeypatch, flat, [5.7])
    trials.bracket(1.0, 8.0, 1.0)
    assert trials.levels[:2] == pytest.approx([2.0, 3.85])
    trials = Trials(monkeypatch, flat, [2.0])
    trials.bracket(0.0, 8.0, 0.5)
    assert trials.levels[:2] == pytest.approx([0.5, 1.55])


def test_a_bracket_that_is_narrow_from_the_start_is_tried_in_its_middle(flat, monkeypatch):
    trials = Trials(monkeypatch, flat, [3.0, 3.0])
    bracket_, lower = trials.bracket(0.0, 1.5, 1.0)
    assert trials.levels == pytest.approx([0.75]) and lower == pytest.approx(0.75) and bracket_ is None
    trials = Trials(monkeypatch, flat, [3.0, 3.0])
    assert trials.bracket(1.0, 2.5, 1.0)[1] == pytest.approx(1.75) == trials.levels[0]
    # One that is no wider than the tolerance is asked whether its lower limit is one.
    trials = Trials(monkeypatch, flat, [3.0])
    assert trials.bracket(0.5, 1.5, 1.0) == (None, 0.5) and trials.levels == [0.5]
    # No better than what is known to be reached: nothing is found.
    trials = Trials(monkeypatch, flat, [5.0])
    assert trials.bracket(0.0, flat.spread_db(flat.ratio2(*rising(5.0))), 3.0)[0] is None


def test_a_verdict_by_rows_of_a_far_denominator_is_asked_again(flat, monkeypatch):
    """The first answer is 0.15 dB where 8 were known: its rows were scaled by what reaches 8."""
    trials = Trials(monkeypatch, flat, [0.15, 0.05, 0.05])
    bracket_, lower = trials.bracket(0.0, 8.0, 0.1)
    assert trials.levels == pytest.approx([0.1, 0.1, 0.0]) and lower == 0.0
    np.testing.assert_allclose(bracket_[0], rising(0.05)[0], rtol=1e-12)
    # With the verdict confirmed the search ends there.
    trials = Trials(monkeypatch, flat, [0.15, 0.12])
    bracket_, lower = trials.bracket(0.0, 8.0, 0.1)
    assert trials.levels == pytest.approx([0.1, 0.1]) and lower == pytest.approx(0.1)
    np.testing.assert_allclose(bracket_[0], rising(0.12)[0], rtol=1e-12)


@pytest.mark.parametrize("known, tol, asked", [(0.599, 0.1, 1), (0.601, 0.1, 2), (0.75, 0.25, 1)])
def test_a_verdict_counts_within_half_a_db_of_what_scaled_its_rows(known, tol, asked, flat, monkeypatch):
    """Rows scaled by what reaches ``known`` say that ``tol`` is infeasible, and reach a little more."""
    trials = Trials(monkeypatch, flat, [tol + 0.05, tol + 0.04, tol + 0.03])
    assert trials.bracket(0.0, known, tol)[1] == pytest.approx(tol)
    assert trials.levels == pytest.approx([tol] * asked)


def test_the_middle_is_tried_after_no_verdict_and_sixty_programs_are_asked_at_most(flat, monkeypatch):
    trials = Trials(monkeypatch, flat, [])
    assert trials.bracket(0.0, 4.0, 1.0) == (None, 0.0)
    assert trials.levels[:4] == pytest.approx([1.0, 2.5, 3.25, 3.625]) and len(trials.levels) == 60
    trials = Trials(monkeypatch, flat, [None, 1.9, None, 1.85])
    assert trials.bracket(0.0, 4.0, 1.0)[1] == pytest.approx(1.45)
    assert trials.levels == pytest.approx([1.0, 2.5, 1.0, 1.45])


def test_a_trial_is_met_to_a_millionth_of_a_db(flat, monkeypatch):
    for over, following in ((0.9e-6, 0.1), (1.1e-6, 1.0)):
        trials = Trials(monkeypatch, flat, [1.0 + over, 0.9, 0.9])
        trials.bracket(0.0, 4.0, 1.0)
        assert trials.levels[1] == pytest.approx(following, abs=1e-5)


# ---------------------------------------------------------------- the search over the rows


class Cuts:
    """A search whose brackets and failures are given: (worst ratio [dB] or None, lower limit), and y."""

    def __init__(self, monkeypatch, grid: Grid, brackets, failures=()):
        self.grid, self.brackets, self.failures = grid, iter(brackets), iter(failures)
        self.asked: list[tuple] = []
        self.looked: list[tuple] = []
        self.resolved: list[tuple] = []
        monkeypatch.setattr(minimax, "_exchange", self.exchange)
        monkeypatch.setattr(minimax, "_failures", self.fail)
        monkeypatch.setattr(minimax, "_resolve", lambda *arguments: self.resolved.append(arguments))

    def exchange(self, grid, active, order, bottom, lower_db, upper_db, tol_db):
        self.asked.append((active, order, bottom, lower_db, upper_db, tol_db))
        db, lower = next(self.brackets)
        if db is None:
            return None, lower
        top, bottom = rising(db) if math.isfinite(db) else (np.ones(2), np.array([1.0, -1.0]))
        return (2.0 * top, bottom), lower

    def fail(self, grid, ratio2, level_db):
        self.looked.append((ratio2, level_db))
        return np.array(next(self.failures, []))

    def column(self, k: int) -> list:
        return [a[k] for a in self.asked]


LOWER = MinimaxFit(0, np.ones(1), np.ones(1), 6.0, 6.0, np.ones(1))


def test_order_zero_is_the_largest_bound_and_its_ratio_that_of_the_bounds():
    grid = grid_of([1.0, 2.0, 3.0], [1.0, 10.0, 5.0])
    fit = minimax.least_worst_ratio(grid, 0, None)
    assert fit.order == 0 and fit.ratio_db == fit.lower_db == pytest.approx(20.0)
    assert fit.top.tolist() == [grid.b2.max()] and fit.bottom.tolist() == [1.0]
    assert fit.active is grid.y


def test_an_order_that_needs_no_improvement_is_not_tried(flat, monkeypatch):
    for db, tried in ((0.002, 0), (0.0021, 1)):
        cuts = Cuts(monkeypatch, flat, [(None, 0.0), (None, 0.0)])
        lower = MinimaxFit(0, np.ones(1), np.ones(1), db, db, np.ones(1))
        assert minimax.least_worst_ratio(flat, 1, lower) is lower and bool(cuts.asked) == bool(tried)


def test_tolerances_follow_the_distance_to_the_lower_limit_down_to_the_step(flat, monkeypatch):
    cuts = Cuts(monkeypatch, flat, [(5.0, 2.0), (None, 2.2), (4.0, 2.5)], [[0.3], []])
    fit = minimax.least_worst_ratio(flat, 1, LOWER)
    assert cuts.column(5) == pytest.approx([1.0, 0.3, 0.002])
    assert cuts.column(3) == [0.0, 2.0, 2.2] and cuts.column(4) == pytest.approx([6.0, 5.0, 5.0])
    assert cuts.column(1) == [1, 1, 1] and (fit.order, fit.lower_db) == (1, 2.5)
    # A first break in the middle of the band, between 1 and 2 rad/s in y.
    np.testing.assert_allclose(cuts.asked[0][2], [1.0, 0.5], rtol=1e-12)
    np.testing.assert_array_equal(cuts.asked[1][2], np.ones(2))
    np.testing.assert_array_equal(cuts.asked[0][0], flat.start())
    for active in (cuts.asked[1][0], cuts.asked[2][0], fit.active):
        np.testing.assert_array_equal(active, np.union1d(flat.start(), [0.3]))
    assert fit.ratio_db == pytest.approx(4.0)
    np.testing.assert_allclose(fit.top, rising(4.0)[0], rtol=1e-12)
    assert [level for _, level in cuts.looked] == [2.0, 2.5] and len(cuts.resolved) == 2
    np.testing.assert_allclose(cuts.resolved[0][1], 2.0 * rising(5.0)[0])


def test_breaks_are_added_up_to_the_order(flat, monkeypatch):
    cuts = Cuts(monkeypatch, flat, [(None, 0.0)] * 2)
    lower = MinimaxFit(1, np.ones(2), np.array([3.0, 1.0]), 6.0, 5.0, np.ones(1))
    minimax.least_worst_ratio(flat, 3, lower)
    np.testing.assert_allclose(cuts.asked[0][2], np.convolve([3.0, 1.0], [1.0, 1.0, 0.25]), rtol=1e-12)
    assert len(cuts.asked) == 2, "nothing at a tenth of the excess, nothing at the step"


def test_what_has_no_ratio_is_no_candidate_and_the_tolerance_stays(flat, monkeypatch):
    cuts = Cuts(
        monkeypatch,
        flat,
        [(math.inf, 1.0), (5.5, 1.0), (5.6, 1.5), (None, 1.5), (None, 1.6)],
        [[0.3], [0.4], [0.5]],
    )
    fit = minimax.least_worst_ratio(flat, 1, LOWER)
    assert cuts.column(5) == pytest.approx([1.0, 1.0, 0.45, 0.41, 0.002])
    assert cuts.column(4) == pytest.approx([6.0, 6.0, 5.5, 5.5, 5.5])
    assert fit.ratio_db == pytest.approx(5.5) and fit.lower_db == 1.6
    np.testing.assert_array_equal(fit.active, np.union1d(flat.start(), [0.3, 0.4, 0.5]))


def test_the_step_is_the_tolerance_once_nothing_fails(flat, monkeypatch):
    cuts = Cuts(monkeypatch, flat, [(5.0, 2.0), (4.0, 2.0)], [[], []])
    assert minimax.least_worst_ratio(flat, 1, LOWER).ratio_db == pytest.approx(4.0)
    assert cuts.column(5) == pytest.approx([1.0, 0.002])
    # What fails at the step is asked again with the step.
    cuts = Cuts(monkeypatch, flat, [(5.0, 2.0), (4.0, 2.0), (3.0, 2.0)], [[], [0.3], []])
    assert minimax.least_worst_ratio(flat, 1, LOWER).ratio_db == pytest.approx(3.0)
    assert cuts.column(5) == pytest.approx([1.0, 0.002, 0.002])
    # What fails is not fresh where the rows have it already.
    cuts = Cuts(monkeypatch, flat, [(5.0, 2.0), (4.0, 2.0)], [[flat.y[0]], [flat.y[0]]])
    minimax.least_worst_ratio(flat, 1, LOWER)
    assert cuts.column(5) == pytest.approx([1.0, 0.002])


def test_two_steps_from_the_lower_limit_are_near_enough(flat, monkeypatch):
    for under, asked in ((0.0039, 1), (0.0041, 2)):
        cuts = Cuts(monkeypatch, flat, [(5.0, 5.0 - under), (4.9, 4.9)], [[0.3], [0.4]])
        minimax.least_worst_ratio(flat, 1, LOWER)
        assert len(cuts.asked) == asked


def test_the_tolerance_is_a_step_at_least(flat, monkeypatch):
    """A tenth of 0.015 would be less."""
    cuts = Cuts(monkeypatch, flat, [(5.0, 4.985), (None, 4.99)], [[0.3]])
    assert minimax.least_worst_ratio(flat, 1, LOWER).lower_db == 4.99
    assert cuts.column(5) == [1.0, 0.002]


def test_a_search_that_finds_nothing_better_keeps_the_lower_order(flat, monkeypatch):
    cuts = Cuts(monkeypatch, flat, [(7.0, 5.0), (6.0, 5.5), (None, 5.6)], [[0.3], []])
    assert minimax.least_worst_ratio(flat, 1, LOWER) is LOWER
    assert cuts.column(5) == pytest.approx([1.0, 0.2, 0.002])


def test_sixty_cuts_are_made_at_most(flat, monkeypatch):
    cuts = Cuts(monkeypatch, flat, [(5.0, 1.0)] * 70, [[0.001 * k] for k in range(1, 70)])
    minimax.least_worst_ratio(flat, 1, LOWER)
    assert len(cuts.asked) == 60


def test_a_search_goes_on_with_what_was_found_before_the_grid_grew(flat, monkeypatch):
    last = MinimaxFit(1, *rising(5.0), 5.0, 3.0, np.array([0.0, 0.7]))
    cuts = Cuts(monkeypatch, flat, [(None, 3.1)], [[0.2, 0.7]])
    fit = minimax.least_worst_ratio(flat, 1, LOWER, last)
    [(active, order, bottom, lower_db, upper_db, tol_db)] = cuts.asked
    assert active.tolist() == [0.0, 0.2, 0.7] and bottom is last.bottom and fit is LOWER
    assert (order, lower_db, upper_db, tol_db) == (1, 3.0, 6.0, 0.002)
    np.testing.assert_allclose(cuts.looked[0][0], flat.ratio2(*rising(5.0)))
    assert cuts.looked[0][1] == 3.0


def test_a_strictly_proper_first_order_begins_with_any_roll_off(monkeypatch):
    grid = grid_of([1.0, 2.0], [1.0, 1.0], strict=True)
    cuts = Cuts(monkeypatch, grid, [(None, 0.5), (None, 0.6)])
    fit = minimax.least_worst_ratio(grid, 1, None)
    ratio2 = 1.0 / (grid.b2[:-1] * (1.0 + 0.5 * grid.y[:-1]))
    least = ratio2[grid.y[:-1] <= grid.end].min()
    spread = 10 * math.log10(ratio2.max() / least)
    assert cuts.column(4) == pytest.approx([spread] * 2) and fit.ratio_db == pytest.approx(spread)
    assert (fit.order, fit.lower_db) == (1, 0.6) and fit.top.tolist() == pytest.approx([1.0 / least])
    np.testing.assert_allclose(fit.bottom, [1.0, 0.5])
    np.testing.assert_array_equal(fit.active, grid.start())
