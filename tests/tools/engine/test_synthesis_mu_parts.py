"""The pieces of the H-infinity norm and of mu's upper bound: level tests, scalings and centres, each by what
defines it."""

import numpy as np
import pytest
import scipy.linalg as sl
from scipy.optimize import minimize

from lpvguard.engine.blocks import Block
from lpvguard.engine.synthesis import frequency_cells as interval
from lpvguard.engine.synthesis import mu, mu_lower, mu_upper, norms
from lpvguard.engine.synthesis.errors import SynthesisError
from lpvguard.engine.synthesis.statespace import StateSpace, to_discrete
from lpvguard.engine.synthesis.structure import Structure

FULL = (Block("full", 2, 1), Block("full", 1, 2))
FOUR = tuple(Block("full", 1, 1) for _ in range(4))
MIXED = (Block("repeated_real", 2, 2), Block("full", 1, 1))


def system(seed: int, n: int = 3, m: int = 2, p: int = 2, direct: float = 0.2) -> StateSpace:
    random = np.random.default_rng(seed)
    A = random.standard_normal((n, n))
    A -= (np.linalg.eigvals(A).real.max() + 0.5) * np.eye(n)
    D = direct * random.standard_normal((p, m))
    return StateSpace(A, random.standard_normal((n, m)), random.standard_normal((p, n)), D)


# ---------------------------------------------------------------- the norm


@pytest.mark.parametrize(("m", "p"), [(2, 2), (1, 3), (3, 1)])
@pytest.mark.parametrize("seed", range(3))
def test_a_level_is_crossed_where_a_singular_value_equals_it(m, p, seed):
    G = system(seed, m=m, p=p)
    grid = np.linspace(0, 60, 60001)
    gains = np.linalg.norm(G.response(grid), 2, axis=(1, 2))
    level = 0.5 * (gains.max() + gains[-1])
    crossings = norms._crossings(G, level)
    crossed = grid[:-1][np.diff(np.sign(gains - level)) != 0]
    assert len(crossed) >= 1
    for omega in crossed:
        assert np.abs(crossings - omega).min() < 1e-2
    assert norms._crossings(G, 1.001 * max(gains.max(), norms.hinf_norm(G).upper)).size == 0
    # The points between: one where the gain is above the level, if it is so anywhere.
    assert np.linalg.norm(G.response(crossings), 2, axis=(1, 2)).max() > level
    assert (
        norms._crossings(StateSpace(np.zeros((0, 0)), np.zeros((0, 1)), np.zeros((1, 0)), [[3.0]]), 1.0).size
        == 0
    )


def test_frequencies_near_the_axis_come_with_zero_the_middles_and_twice_the_last():
    values = np.array([2j, -2j, 8j, -8j, 2.0 + 1j, 2.0 - 1j, -3.0])
    blocks = [[[v.real, v.imag], [-v.imag, v.real]] for v in values[[0, 2, 4]]]
    frequencies = norms.axis_frequencies(sl.block_diag(*blocks, -3.0), 1.0)
    np.testing.assert_allclose(
        np.sort(frequencies), np.sort([0.0, 2.0, 8.0, 1.0, 5.0, 4.0, 16.0]), atol=1e-12
    )
    assert norms.axis_frequencies(np.diag([1.0, -1.0]), 1.0).size == 0
    nearly = [[-0.9e-3, 1.0], [-1.0, -0.9e-3]]
    assert norms.axis_frequencies(np.array(nearly), 0.0).size > 0
    assert norms.axis_frequencies(np.array([[-1.1e-3, 1.0], [-1.0, -1.1e-3]]), 0.0).size == 0
    one = np.sort(norms.axis_frequencies(np.array([[0.0, 3.0], [-3.0, 0.0]]), 1.0))
    np.testing.assert_allclose(one, [0.0, 1.5, 3.0, 6.0])
    # 1e2 EPS of the system's size counts as the axis, at DC too.
    assert norms.axis_frequencies(np.array([[1e-15]]), 1.0).size > 0
    assert norms.axis_frequencies(np.array([[1e-12]]), 1.0).size == 0


def test_the_largest_gain_and_its_frequency():
    G = StateSpace([[-1.0]], [[1.0]], [[1.0]], [[0.0]])
    assert norms._largest(G, [3.0, 0.0, 1.0, np.inf]) == (1.0, 0.0)
    value, where = norms._largest(G, [3.0, 1.0, np.inf])
    assert (value, where) == (pytest.approx(1 / np.sqrt(2)), 1.0)


@pytest.mark.parametrize("omega", [0.0, 0.7, 3.0])
def test_the_rounding_of_a_gain_bounds_what_entries_of_A_do_to_it(omega):
    """Eight units in the last place of every entry, of first order; so it is linear in their size."""
    G = system(2)
    size, random = 1e-6, np.random.default_rng(1)
    values, by_rounding = norms._sizes(G, np.array([omega, np.inf]))
    bound = by_rounding[0] / (8 * norms.EPS) * size
    inverse = np.linalg.inv(1j * omega * np.eye(3) - G.A)
    seen = 0.0
    for _ in range(300):
        E = size * random.choice([-1.0, 1.0], (3, 3)) * np.abs(G.A)
        moved = G.C @ np.linalg.inv(1j * omega * np.eye(3) - G.A - E) @ G.B - G.C @ inverse @ G.B
        seen = max(seen, np.linalg.norm(moved))
    assert 0.2 * bound < seen <= 1.001 * bound
    assert by_rounding[1] == 0.0
    want = np.linalg.norm(G.response([omega, np.inf]), 2, axis=(1, 2))
    np.testing.assert_allclose(values, want, rtol=1e-14)


def test_the_bracket_is_the_level_and_the_rounding_and_exact_without_input_or_output():
    lag = norms.hinf_norm(StateSpace([[-1.0]], [[1.0]], [[1.0]], [[0.0]]), rtol=1e-3)
    assert lag.lower == 1.0 and lag.peak_frequency == 0.0
    assert 1.001 < lag.upper <= 1.001 + 20 * norms.EPS
    for B, C in (([[0.0]], [[1.0]]), ([[1.0]], [[0.0]]), ([[0.0]], [[0.0]])):
        still = norms.hinf_norm(StateSpace([[-1.0]], B, C, [[-2.0]]))
        assert (still.lower, still.upper) == (2.0, 2.0)


@pytest.mark.unhurried
def test_the_norm_does_not_settle_for_a_level_below_the_peak(monkeypatch):
    """A resonance away from every pole's frequency in the start: each level finds it higher."""
    G = system(5)
    grid = np.linspace(0, 100, 200001)
    peak = np.linalg.norm(G.response(grid), 2, axis=(1, 2)).max()
    for rtol in (1e-2, 1e-6):
        norm = norms.hinf_norm(G, rtol)
        assert norm.lower <= peak * (1 + 1e-6) and norm.upper >= peak
        assert norm.upper <= (1 + rtol) * norm.lower * (1 + 1e-9)
        at = np.linalg.norm(G.response([norm.peak_frequency])[0], 2)
        assert at == pytest.approx(norm.lower, rel=1e-9)
    monkeypatch.setattr(norms, "_crossings", lambda H, level: np.array([1.0]))
    levels = iter(np.arange(1000.0, 2000.0))
    monkeypatch.setattr(norms, "_largest", lambda H, omega: (next(levels), 1.0))
    with pytest.raises(ArithmeticError, match="60 steps"):
        norms.hinf_norm(G)
    assert next(levels) == 1060.0, "60 levels"


# ---------------------------------------------------------------- both bounds


@pytest.fixture
def searches(monkeypatch) -> dict:
    """What the searches for both bounds are asked; rounding has put their answers out of order."""
    asked = {}
    left, right = np.array([[2.0, 1j], [0.0, 1.0]]), np.array([[1.0, 0.5j], [0.0, 3.0]])

    def upper_bound(M, structure, rtol, target=0.0):
        asked["upper"] = M, structure.blocks, rtol
        return asked["is"], 3.0, left, right, np.full((2, 2), 5.0)

    def lower_bound(M, structure, left, right, enough, starts):
        asked["lower"] = M, structure.blocks, left, right, enough, starts
        return 2.5, np.full((2, 2), 7.0)

    monkeypatch.setattr(mu, "upper_bound", upper_bound)
    monkeypatch.setattr(mu, "lower_bound", lower_bound)
    monkeypatch.setattr(mu, "_require", lambda *_: None)
    return asked | {"left": left, "right": right, "asked": asked}


def test_both_bounds_are_those_of_their_searches_in_order(searches, monkeypatch):
    monkeypatch.setattr(mu, "triangular_scalings", lambda *_: [])
    left, right, asked = (searches[k] for k in ("left", "right", "asked"))
    asked["is"] = 3.0
    bounds = mu.mu_bounds([[1, 0], [0, 1]], list(FOUR[:2]))
    assert bounds.upper == pytest.approx(3.0, rel=1e-9) and bounds.lower == 2.5 and bounds.delta[0, 0] == 7.0
    (part,) = bounds.proof
    np.testing.assert_array_equal(part.point.left, [[5.0, 1j], [-1j, 1.0]])
    np.testing.assert_array_equal(part.point.scaled, [[1.25, 1.5j], [-1.5j, 9.0]])
    M, blocks, rtol = asked["upper"]
    assert M.dtype == complex and blocks == FOUR[:2] and rtol == 1e-8
    M, blocks, *factors, enough, starts = asked["lower"]
    assert M.dtype == complex and blocks == FOUR[:2] and factors[0] is left and factors[1] is right
    assert enough == pytest.approx(bounds.upper * (1 - 1e-9), rel=1e-12) and starts == 40
    mu.mu_bounds(np.eye(2), FOUR[:2], 1e-3)
    assert asked["upper"][2] == 1e-3


def test_scalings_that_prove_nothing_are_replaced_by_none(searches):
    searches["asked"]["is"] = 0.5
    bounds = mu.mu_bounds(np.eye(2), FOUR[:2])
    assert bounds.upper == pytest.approx(1.0, rel=1e-9) and (bounds.proof[0].point.left == np.eye(2)).all()


def test_a_lower_bound_alone_starts_eight_times(searches, monkeypatch):
    assert mu.mu_lower(np.eye(2), FOUR[:2], "left", "right", 0.7) == (0.0, None), "its Delta attains nothing"
    monkeypatch.setattr(mu, "attained", lambda *_: 2.5)
    assert mu.mu_lower([[1, 0], [0, 1]], list(FOUR[:2]), "left", "right", 0.7)[0] == 2.5
    M, blocks, *rest = searches["asked"]["lower"]
    assert M.dtype == complex and blocks == FOUR[:2] and rest == ["left", "right", 0.7, 8]


@pytest.mark.parametrize("bad", [np.nan, np.inf])
def test_a_matrix_is_finite_and_of_its_blocks_shape(bad):
    M = np.eye(2)
    M[0, 1] = bad
    with pytest.raises(SynthesisError, match="NaN or infinite"):
        mu.mu_bounds(M, FOUR[:2])
    for shape in ((2, 3), (3, 2), (2,)):
        with pytest.raises(SynthesisError, match="shape"):
            mu.mu_bounds(np.ones(shape), FOUR[:2])


# ---------------------------------------------------------------- the upper bound of mu


def matrix(blocks, seed: int) -> np.ndarray:
    random = np.random.default_rng(seed)
    shape = sum(b.cols for b in blocks), sum(b.rows for b in blocks)
    return random.standard_normal(shape) + 1j * random.standard_normal(shape)


@pytest.mark.parametrize("blocks", [FULL, MIXED], ids=["full", "mixed"])
@pytest.mark.parametrize("seed", range(3))
def test_the_scalings_prove_the_bound_and_no_smaller_one(blocks, seed):
    structure, M = Structure(blocks), matrix(blocks, seed)
    upper, infimum, left, right, G = mu_upper.upper_bound(M, structure, 1e-6)
    D_left, D_right = left @ left.conj().T, right @ right.conj().T

    def least(level):
        phi = level**2 * D_right - M.conj().T @ D_left @ M - 1j * (G @ M - M.conj().T @ G.conj().T)
        return np.linalg.eigvalsh(phi)[0] / np.linalg.norm(D_right, 2)

    assert least(upper * (1 + 1e-7)) >= 0 > least(upper * (1 - 1e-6))
    assert infimum <= upper
    if blocks is FULL:
        assert infimum == pytest.approx(upper, rel=1e-5)

        def scaled(log_d):
            d = np.exp(log_d[0])
            return np.linalg.norm(np.diag([d, 1, 1]) @ M @ np.diag([1 / d, 1 / d, 1]), 2)

        best = minimize(scaled, [0.0], method="Nelder-Mead", options={"xatol": 1e-9, "fatol": 1e-12}).fun
        assert upper == pytest.approx(best, rel=1e-6)


@pytest.mark.parametrize("blocks", [FULL, (*FULL, Block("full", 1, 1)), FOUR], ids=["two", "three", "four"])
@pytest.mark.parametrize("seed", range(4))
def test_newtons_method_finds_what_the_method_of_centres_finds(blocks, seed, monkeypatch):
    structure, M = Structure(blocks), 10.0 ** (3 * seed - 4) * matrix(blocks, seed)
    infimum_found = mu_upper.simple_infimum(M, structure, 1e-8)
    assert infimum_found is not None
    monkeypatch.setattr(mu_upper, "simple_infimum", lambda *_: None)
    upper, infimum, *_ = mu_upper.upper_bound(M, structure, 1e-7)
    assert infimum_found[0] == pytest.approx(upper, rel=1e-6) and infimum_found[1] <= infimum_found[0] * (
        1 + 1e-15
    )
    assert infimum_found[1] == pytest.approx(infimum_found[0], rel=1e-8) and infimum <= infimum_found[0] * (
        1 + 1e-9
    )
    left, right = infimum_found[2:4]
    assert np.linalg.norm(left @ M @ np.linalg.inv(right), 2) <= infimum_found[0] * (1 + 1e-14)
    # At a simple largest singular value the bound is attained.
    value, delta = mu_lower._attained(M, structure, left)
    assert value == pytest.approx(infimum_found[0], rel=1e-8)
    assert np.linalg.svd(np.eye(len(M)) - M @ delta)[1][-1] < 1e-9
    assert np.linalg.norm(delta, 2) == pytest.approx(1 / value, rel=1e-8)


def test_newtons_method_leaves_a_double_singular_value_and_other_blocks_alone():
    """For M = I every scaling of four blocks has the same singular values. Where a block has no effect, the
    infimum is not attained."""
    structure = Structure(FULL)
    assert mu_upper.simple_infimum(matrix(MIXED, 0), Structure(MIXED), 1e-6) is None
    M = matrix(FULL, 1)
    M[:, :2] = 0.0
    upper, infimum, *_ = mu_upper.upper_bound(M, structure, 1e-6)
    assert upper == pytest.approx(np.linalg.norm(M[1:, 2], 2), rel=1e-3) and infimum <= upper
    assert mu_upper.upper_bound(np.eye(4), Structure(FOUR), 1e-6)[0] == pytest.approx(1, rel=1e-6)


def test_the_derivatives_of_the_largest_singular_value_are_those_of_differences():
    structure, M, x = Structure(FULL), matrix(FULL, 2), np.array([0.3, -0.2])
    rows, cols = [b.cols for b in FULL], [b.rows for b in FULL]
    member = np.array([[1, 0, 0, -1, -1, 0], [0, 1, 1, 0, 0, -1]], float)

    def at(x):
        return mu_upper._newton_model(M, x, rows, cols, member)

    assert structure.n_rows == 3
    step = 1e-5 * np.eye(2)
    value, slope, curvature, low = at(x)
    differences = [[(at(x + h)[k] - at(x - h)[k]) / 2e-5 for h in step] for k in (0, 1)]
    np.testing.assert_allclose(slope, differences[0], rtol=1e-6)
    np.testing.assert_allclose(curvature, differences[1], rtol=1e-6)
    assert low <= mu_upper.upper_bound(M, structure, 1e-9)[0] <= value


def test_a_bound_does_not_depend_on_the_units_of_its_blocks():
    structure, M = Structure(FULL), matrix(FULL, 4)
    d = np.array([1e5, 1.0])
    scaled = mu_upper._spread(d, [1, 2]) @ M @ np.linalg.inv(mu_upper._spread(d, [2, 1]))
    one, other = (mu_upper.upper_bound(X, structure, 1e-6)[0] for X in (M, scaled))
    assert other == pytest.approx(one, rel=1e-5)
    assert mu_upper.upper_bound(1e8 * M, structure, 1e-6)[0] == pytest.approx(1e8 * one, rel=1e-6)
    zero = mu_upper.upper_bound(0 * M, structure, 1e-6)
    assert zero[:2] == (0.0, 0.0) and not zero[4].any()


def test_balancing_evens_out_rows_and_columns_of_the_blocks():
    blocks = tuple(Block("full", 1, 1) for _ in range(4))
    structure = Structure(blocks)
    M = np.abs(matrix(blocks, 6)) * np.outer([1e3, 1.0, 1e-4, 10.0], [1e-3, 1.0, 1e4, 0.1])
    d = mu_upper._balance(M, structure)
    scaled = d[:, None] * M / d
    np.fill_diagonal(scaled, 0)
    rows, cols = np.linalg.norm(scaled, axis=1), np.linalg.norm(scaled, axis=0)
    np.testing.assert_allclose(rows, cols, rtol=0.05)
    lonely = np.triu(np.ones((2, 2)))
    assert mu_upper._balance(lonely, Structure(blocks[:2])).tolist() == [1.0, 1.0]
    spread = mu_upper._spread(np.array([2.0, 3.0]), [1, 2])
    assert spread.tolist() == np.diag([2.0, 3.0, 3.0]).tolist() and spread.dtype == complex


@pytest.mark.parametrize("seed", range(3))
def test_the_level_of_scalings_is_a_generalised_eigenvalue(seed):
    structure, M = Structure(MIXED), matrix(MIXED, seed)
    random = np.random.default_rng(seed)
    left = np.diag(random.uniform(0.5, 2, 3)).astype(complex)
    right = left.copy()
    g = random.standard_normal((2, 2)) + 1j * random.standard_normal((2, 2))
    G = sl.block_diag(g + g.conj().T, np.zeros((1, 1)))
    D = sl.block_diag(np.eye(2) * 1.3, 0.7).astype(complex)
    N = left.conj().T @ M @ np.linalg.inv(right.conj().T) / 2.0
    wanted = sl.eigvalsh(N.conj().T @ D @ N + 1j * (G @ N - N.conj().T @ G.conj().T), D)[-1]
    level = mu_upper._level(M, left, right, D, D, G, 2.0)
    assert level == pytest.approx(wanted, rel=1e-12) and level > wanted
    L = np.linalg.cholesky(np.array([[2.0, 0.5], [0.5, 1.0]]))
    F = np.array([[[1.0, 2.0], [2.0, 5.0]]])
    np.testing.assert_allclose(L @ mu_upper._whiten(L, F)[0] @ L.T, F[0], atol=1e-14)
    assert structure.n_rows == 3


def test_the_centre_has_no_gradient_along_its_level_set():
    structure, M = Structure(FULL), matrix(FULL, 3)
    N = M / (2.0 * np.linalg.norm(M, 2))
    F = structure.right - N.conj().T @ structure.left @ N
    trace = np.real(np.trace(structure.left, axis1=1, axis2=2))
    x, Z = mu_upper._centre(np.ones(2), F, structure, trace)
    assert trace @ x == pytest.approx(trace.sum(), rel=1e-9)
    np.testing.assert_allclose(Z @ np.tensordot(x, F, 1), np.eye(3), atol=1e-8)

    def value(d):
        point = np.array([d, (trace.sum() - trace[0] * d) / trace[1]])
        signs, logs = zip(
            *(np.linalg.slogdet(np.tensordot(point, E, 1)) for E in (F, structure.left)), strict=True
        )
        return -sum(logs) if min(np.real(signs)) > 0 else np.inf

    h = 1e-4
    assert value(x[0]) <= min(value(x[0] - h), value(x[0] + h))
    gap = mu_upper._dual_gap(x, Z, structure, trace)
    infimum = (mu_upper.upper_bound(N, structure, 1e-8)[0]) ** 2
    assert 0 < 1.0 - gap <= infimum
    assert mu_upper._dual_gap(x, Z, Structure(MIXED), trace) == np.inf


# ---------------------------------------------------------------- mu on an interval


@pytest.mark.unhurried
@pytest.mark.parametrize("seed", range(3))
def test_the_singular_frequencies_are_those_of_phi(seed):
    """Where Phi changes its sign on a grid there is one, at which the least |eigenvalue| vanishes. There may
    be more: what is near counts."""
    G = system(seed, n=3, m=3, p=3)
    random = np.random.default_rng(seed)
    D = np.diag(random.uniform(0.5, 2.0, 3)).astype(complex)
    D[:2, :2] = [[1.5, 0.3j], [-0.3j, 1.0]]
    skew = np.zeros((3, 3), complex)
    skew[:2, :2] = [[0.4, 0.1 + 0.2j], [0.1 - 0.2j, -0.3]]

    def phi(omega, level):
        M = G.response([omega])[0]
        return level**2 * D - M.conj().T @ D @ M - 1j * (skew @ M - M.conj().T @ skew.conj().T)

    grid = np.linspace(0.0, 20.0, 4001)
    least = np.array([np.linalg.eigvalsh(phi(w, 1.0))[0] for w in grid])
    level = 0.7 * np.sqrt(1.0 - least.min())
    point = interval.PointBound(level, D, np.zeros_like(D), D, skew)
    frequencies = interval._singular(G, point, level)
    values = np.array([np.linalg.eigvalsh(phi(w, level)) for w in grid])
    crossed = grid[:-1][(np.diff(np.sign(values), axis=0) != 0).any(axis=1)]
    assert len(crossed) and (np.diff(frequencies) > 0).all() and (frequencies >= 0).all()
    for omega in crossed:
        nearest = frequencies[np.abs(frequencies - omega).argmin()]
        assert abs(nearest - omega) < 1e-2
        assert np.abs(np.linalg.eigvalsh(phi(nearest, level))).min() < 1e-6 * level**2
    none = StateSpace(np.zeros((0, 0)), np.zeros((0, 3)), np.zeros((3, 0)), G.D)
    assert interval._singular(none, point, level).size == 0


def test_the_centre_of_a_cell_is_geometric_where_its_ends_are_far_apart_but_not_at_zero():
    assert interval.middle(1.0, 4.0, 7.0) == 2.0
    assert interval.middle(0.0, 4.0, 7.0) == 2.0
    assert interval.middle(0.1, 1.1, 7.0) == pytest.approx(0.6)
    assert interval.middle(0.1, 1.0, 7.0) == pytest.approx(0.55), "a tenth is not above a tenth"
    assert interval.middle(0.11, 1.0, 7.0) == pytest.approx(np.sqrt(0.11))
    assert interval.middle(2.0, np.inf, 7.0) == 7.0 and interval.middle(5.0, np.inf, 7.0) == 10.0


@pytest.mark.parametrize("dt", [0.0, 0.2])
def test_the_bound_on_an_interval_is_the_norm_there(dt):
    loop = StateSpace([[-0.05, 1.0], [-1.0, -0.05]], [[0.0], [1.0]], [[1.0, 0.0]], [[0.0]])
    loop = to_discrete(loop, dt) if dt else loop
    last = np.pi / dt if dt else np.inf
    grid = np.linspace(0.0, min(last, 30.0), 30001)
    gains = np.abs(loop.response(grid)[:, 0, 0])
    for low, high in ((0.0, last), (0.0, 0.8), (0.9, 1.4), (1.3, last), (0.2, 5.0)):
        inside = (grid >= low) & (grid <= high)
        interval = mu.mu_interval(loop, [Block("full", 1, 1)], low, high)
        assert gains[inside].max() <= interval.upper <= 1.01 * gains[inside].max()
        assert interval.lower <= interval.upper and low <= interval.omega <= high and interval.proof
        at = np.abs(loop.response([interval.omega])[0, 0, 0])
        assert interval.lower == pytest.approx(at, rel=1e-9)


def test_the_lower_bound_on_an_interval_is_mus_at_its_frequency():
    loop = system(7, n=4, m=3, p=3)
    interval = mu.mu_interval(loop, FULL, 0.0, np.inf)
    M = loop.response([interval.omega])[0]
    assert interval.lower == pytest.approx(mu_upper.upper_bound(M, Structure(FULL), 1e-8)[0], rel=1e-6)


@pytest.mark.parametrize(("low", "high"), [(-0.1, 1.0), (1.0, 1.0), (2.0, 1.0), (0.0, 17.0), (np.nan, 1.0)])
def test_an_interval_lies_between_zero_and_half_the_rate(low, high):
    loop = to_discrete(StateSpace([[-1.0]], [[1.0]], [[1.0]], [[0.0]]), 0.2)
    with pytest.raises(SynthesisError, match="low, high"):
        mu.mu_interval(loop, [Block("full", 1, 1)], low, high)
    assert mu.mu_interval(loop, [Block("full", 1, 1)], 0.0, np.pi / 0.2).upper == pytest.approx(1.0, rel=5e-3)
