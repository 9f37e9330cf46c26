"""The search for mu's upper bound step by step: Newton's method and the method of centres on functions whose
steps are known, and their control by scripted levels."""

from types import SimpleNamespace

import numpy as np
import pytest
import scipy.linalg as sl

from lpvguard.engine.blocks import Block
from lpvguard.engine.synthesis import mu_upper
from lpvguard.engine.synthesis.structure import Structure

ONE = Block("full", 1, 1)
TWO = (ONE, ONE)
FULL = (Block("full", 2, 1), Block("full", 1, 2))
MIXED = (Block("repeated_real", 2, 2), Block("repeated_complex", 2, 2), Block("full", 1, 2))


def matrix(blocks, seed: int) -> np.ndarray:
    random = np.random.default_rng(seed)
    shape = sum(b.cols for b in blocks), sum(b.rows for b in blocks)
    return random.standard_normal(shape) + 1j * random.standard_normal(shape)


# ---------------------------------------------------------------- the method of centres


@pytest.fixture
def centred(monkeypatch):
    """Every centre of a search: where it starts, what it is asked, and where it ends."""
    calls, centre = [], mu_upper._centre

    def stub(x, F, structure, trace):
        end, Z = centre(x, F, structure, trace)
        calls.append(SimpleNamespace(start=x, F=F, trace=trace, end=end))
        return end, Z

    monkeypatch.setattr(mu_upper, "_centre", stub)
    monkeypatch.setattr(mu_upper, "simple_infimum", lambda *_: None)
    return calls


def scalings(structure: Structure, x: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    n = len(structure.left)
    return tuple(
        np.tensordot(part, basis, 1)
        for part, basis in ((x[:n], structure.left), (x[:n], structure.right), (x[n:], structure.skew))
    )


@pytest.mark.parametrize("blocks", [FULL, MIXED], ids=["full", "mixed"])
@pytest.mark.parametrize("seed", range(2))
def test_every_centre_starts_a_twentieth_of_the_way_above_the_last_one_in_its_coordinates(
    blocks, seed, centred
):
    """The slack of the level is what one pencil says before a centre is absorbed and another one after."""
    structure, M = Structure(blocks), matrix(blocks, seed)
    left, right = structure.n_rows, structure.n_cols
    mu_upper.upper_bound(M, structure, 1e-3)
    assert len(centred) >= 3
    slack, wanted = [], (np.eye(left), np.eye(right), np.zeros((right, left)))
    for call in centred:
        assert call.trace.tolist() == [
            *np.real(np.trace(structure.left, axis1=1, axis2=2)),
            *np.zeros(len(structure.skew)),
        ]
        for x in (call.start, call.end):
            S = np.tensordot(x, call.F, 1)
            np.testing.assert_allclose(S, S.conj().T, atol=1e-12 * np.abs(S).max())
            slack.append(sl.eigh(S, scalings(structure, x)[1], eigvals_only=True)[0])
        for coordinates, matrix_ in zip(scalings(structure, call.start), wanted, strict=True):
            np.testing.assert_allclose(coordinates, matrix_, atol=1e-8)
        D_left, D_right, G = scalings(structure, call.end)
        L, R = (
            np.linalg.inv(np.linalg.cholesky(D + size))
            for D, size in zip((D_left, D_right), structure.magnitude(G), strict=True)
        )
        wanted = (L @ D_left @ L.conj().T, R @ D_right @ R.conj().T, R @ G @ L.conj().T)
    assert blocks is FULL or np.abs(scalings(structure, centred[0].end)[2]).max() > 0.01
    assert slack[0] == pytest.approx(0.1, rel=1e-9), "a tenth above the largest singular value"
    np.testing.assert_allclose(slack[2::2], 0.05 * np.array(slack[1:-1:2]), rtol=1e-5)


@pytest.mark.parametrize("rtol", [1e-2, 1e-6])
def test_the_search_brackets_the_infimum_as_closely_as_it_is_asked(rtol, centred):
    structure, M = Structure((*FULL, ONE)), matrix((*FULL, ONE), 5)
    upper, infimum, *_ = mu_upper.upper_bound(M, structure, rtol)
    exact = mu_upper.upper_bound(M, structure, 1e-9)[0]
    assert infimum <= exact * (1 + 1e-9) and exact <= upper * (1 + 1e-9)
    assert infimum * (1 + rtol) >= upper * (1 - 1e-9)
    if rtol == 1e-2:
        assert infimum < exact * (1 - 1e-4), "no closer"


@pytest.fixture
def scripted(monkeypatch):
    """`upper_bound` of diag(2, 1) with two scalar blocks, of which a centre only multiplies the first scale:
    by ``moves``; None: no centre. What the centres prove is scripted: ``values``, and how far below its level
    the infimum may lie, ``gaps``. What the search gives, and its levels."""

    def run(values, gaps=(), rtol=1e-3, moves=()):
        values, gaps, moves, levels = iter(values), iter(gaps), iter(moves), []

        def centre(x, F, structure, trace):
            levels.append(1.0 + float(F[0][0, 0].real))  # F = (level - 1, level - 1/4)
            assert 1.0 + F[0][0, 0] == pytest.approx(0.25 + F[1][1, 1]) and trace.tolist() == [1.0, 1.0]
            np.testing.assert_allclose(x, [1.0, 1.0])
            if (move := next(moves, 1.0)) is None:
                raise np.linalg.LinAlgError
            return x * [move, 1.0], np.eye(2)

        monkeypatch.setattr(mu_upper, "_centre", centre)
        monkeypatch.setattr(mu_upper, "simple_infimum", lambda *_: None)
        monkeypatch.setattr(mu_upper, "_level", lambda *_: next(values))
        monkeypatch.setattr(mu_upper, "_dual_gap", lambda *_: next(gaps, np.inf))
        return mu_upper.upper_bound(np.diag([2.0, 1.0]).astype(complex), Structure(TWO), rtol), levels

    return run


def test_levels_fall_to_a_twentieth_above_the_best_whose_scalings_are_kept(scripted):
    result, levels = scripted([1.0, 1.05, 0.9, 0.0], gaps=[0.5, 9.0, 0.3], moves=[4.0, 9.0, 16.0, 0.25])
    third = 1.0 + 0.05**2 * 0.1
    np.testing.assert_allclose(levels, [1.1, 1.005, third, 0.9 + 0.05 * (third - 0.9)])
    upper, infimum, left, right, G = result
    assert (upper, infimum) == (0.0, pytest.approx(2 * np.sqrt(third - 0.3)))
    np.testing.assert_allclose(left, np.diag([2.0 * 4.0 * 0.5, 1.0]))
    np.testing.assert_allclose(right, left)
    assert not G.any()
    result, levels = scripted([1.0, 0.5], moves=[4.0, None])
    assert result[0] == 2.0 and result[1] == 0.0 and result[2][0, 0] == 2.0 and len(levels) == 2
    result, _ = scripted([1.0, 1.0], moves=[4.0, 9.0, None])
    assert result[2][0, 0] == 2.0, "of equals the first"
    assert scripted([-1e-20])[0][0] == 0.0, "rounding of what is 0"


@pytest.mark.parametrize(
    ("value", "infimum", "rtol", "ends"),
    [
        (1.0, 0.8, 0.125, True),  # a quarter above, twice the tolerance of the root
        (1.0 + 1e-9, 0.8, 0.125, False),
        (9e-15, -1.0, 1e-3, True),
        (1e-14, -1.0, 1e-3, False),
        (1.1 - 5.4e-4, -1.0, 0.5, True),  # the level falls by less than a thousandth of the tolerance
        (1.1 - 5.6e-4, -1.0, 0.5, False),
        (1.1, -1.0, 0.0, False),
    ],
)
def test_the_search_ends_near_the_infimum_or_where_levels_stand(value, infimum, rtol, ends, scripted):
    """Here the level 1.1."""
    _, levels = scripted([value, 0.0], gaps=[1.1 - infimum], rtol=rtol)
    assert len(levels) == (1 if ends else 2)


def test_what_newtons_method_finds_is_the_bound(monkeypatch):
    asked, M, structure = [], matrix(FULL, 0), Structure(FULL)

    def stub(*args):
        asked.append(args)
        return "found"

    monkeypatch.setattr(mu_upper, "simple_infimum", stub)
    assert mu_upper.upper_bound(M, structure, 1e-3) == "found"
    [(matrix_asked, in_, rtol, d)] = asked
    assert matrix_asked is M and in_ is structure and rtol == 1e-3
    np.testing.assert_array_equal(d, mu_upper._balance(M, structure))


def test_a_search_that_does_not_end_is_given_up(scripted):
    values = 1.0 * 0.999 ** np.arange(400)
    _, levels = scripted(values, rtol=0.0)
    assert len(levels) == 300


# ---------------------------------------------------------------- Newton's method


@pytest.fixture
def modelled(monkeypatch):
    """`simple_infimum` with a model of the logarithms of the scales in place of the singular value: what it
    gives, and where it looked."""

    def run(model, start, rtol=1e-3, level=1.0):
        blocks, seen, levels = (ONE,) * len(start), [], []

        def stub(M, x, rows, cols, member):
            seen.append(x.tolist())
            return model(x)

        def proved(*args):
            levels.append(args)
            return level

        monkeypatch.setattr(mu_upper, "_newton_model", stub)
        monkeypatch.setattr(mu_upper, "_level", proved)
        M = np.eye(len(blocks), dtype=complex)
        return mu_upper.simple_infimum(M, Structure(blocks), rtol, np.exp(start)), seen, levels

    return run


def bowl(x):
    """2 + (x_0 - 1)^2 + 4 (x_1 - 0.5)^2, whose minimum the bound from below meets."""
    d = x[:2] - [1.0, 0.5]
    value = 2.0 + d[0] ** 2 + 4 * d[1] ** 2
    low = 2.0 if np.abs(d).max() < 1e-9 else 0.0
    return value, np.array([2 * d[0], 8 * d[1], 99.0]), np.diag([2.0, 8.0, 99.0]), low


def line(value, slope=None, curvature=None, low=lambda t: 0.0):
    """A model of the difference of two logarithms."""

    def model(x):
        t = x[0] - x[1]
        s = slope(t) if slope else 0.0
        c = curvature(t) if curvature else 1.0
        return value(t), np.array([s, -s]), np.array([[c, -c], [-c, c]]), low(t)

    return model


def test_a_step_goes_to_the_minimum_and_the_last_scale_stays(modelled):
    result, seen, levels = modelled(bowl, [0.0, 0.0, 0.3], level=0.25)
    np.testing.assert_allclose(seen, [[0.0, 0.0, 0.3], [1.0, 0.5, 0.3]])
    [(_, left, right, I_left, I_right, G, size)] = levels
    np.testing.assert_allclose(left, np.diag(np.exp([1.0, 0.5, 0.3])))
    np.testing.assert_allclose(right, left)
    assert I_left.tolist() == I_right.tolist() == np.eye(3).tolist() and size == 2.0 and not G.any()
    assert result[:2] == (1.0, 1.0) and result[2] is left and result[3] is right and result[4] is G
    assert modelled(bowl, [0.0, 0.0, 0.3], level=4.0)[0][:2] == (4.0, 2.0)
    assert modelled(bowl, [0.0, 0.0, 0.3], level=-1.0)[0][:2] == (0.0, 0.0)


def test_no_scale_moves_further_than_a_factor_of_e_squared_at_once(modelled):
    _, seen, _ = modelled(bowl, [-9.0, 5.5, 0.0])
    np.testing.assert_allclose(seen[:3], [[-9.0, 5.5, 0.0], [-7.0, 4.5, 0.0], [-5.0, 3.5, 0.0]])
    np.testing.assert_allclose(seen[-1], [1.0, 0.5, 0.0])
    assert len(seen) == 6


def test_a_step_is_halved_until_the_value_falls(modelled):
    """The steps for |t|^(4/3) go three times as far as t; those for t^2 with half its curvature twice."""
    _, seen, _ = modelled(
        line(
            lambda t: np.abs(t) ** (4 / 3),
            lambda t: 4 / 3 * np.cbrt(t),
            lambda t: 4 / 9 * np.abs(t) ** (-2 / 3),
            lambda t: 9.0 if abs(t) < 0.1 else 0.0,
        ),
        [0.5, 0.0],
    )
    np.testing.assert_allclose([x[0] for x in seen], [0.5, -1.0, -0.25, 0.5, 0.125, -0.25, -0.0625])
    _, seen, _ = modelled(
        line(lambda t: t * t, lambda t: 2 * t, lambda t: 1.0, lambda t: 0.0 if t else 1.0), [0.5, 0.0]
    )
    np.testing.assert_allclose([x[0] for x in seen], [0.5, -0.5, 0.0], err_msg="no fall is no gain")


@pytest.mark.parametrize(("ahead", "taken"), [(2.0, True), (2.0 + 1e-9, False)])
def test_a_point_at_its_bound_from_below_is_taken_and_ends_the_search(ahead, taken, modelled):
    """Also where the value does not fall; within half the tolerance, here a quarter of 1.6."""
    model = line(lambda t: ahead if t else 1.0, lambda t: -1.0, low=lambda t: 1.6 if t else 0.0)
    got, seen, _ = modelled(model, [0.0, 0.0], rtol=0.5)
    assert (got is not None) == taken and seen[1] == [1.0, 0.0]
    assert seen[2:3] == ([] if taken else [[0.5, 0.0]])
    again, seen, _ = modelled(line(lambda t: ahead, low=lambda t: 1.6), [0.0, 0.0], rtol=0.5)
    assert (again is not None) == taken and len(seen) == 1


def test_a_step_that_would_have_to_be_shorter_than_the_shortest_is_none(modelled, monkeypatch):
    rising = line(lambda t: 1.0 + abs(t), lambda t: -1.0)
    result, seen, _ = modelled(rising, [0.0, 0.0])
    assert result is None
    np.testing.assert_allclose([x[0] for x in seen], [0.0, *0.5 ** np.arange(20)])
    monkeypatch.setattr(mu_upper, "SHORTEST_STEP", 0.25)
    assert len(modelled(rising, [0.0, 0.0])[1]) == 3


@pytest.mark.parametrize(
    ("slope", "curvature"), [(1.0, 0.0), (1.0, np.nan), (0.5, -0.5), (0.0, 1.0), (np.inf, 1.0)]
)
def test_without_a_way_down_newtons_method_ends(slope, curvature, modelled):
    result, seen, _ = modelled(line(lambda t: 9.0 - abs(t), lambda t: slope, lambda t: curvature), [0.0, 0.0])
    assert result is None and len(seen) == 1


def test_newtons_method_has_so_many_steps(modelled):
    result, seen, _ = modelled(line(lambda t: 99.0 - t, lambda t: -0.25), [0.0, 0.0])
    assert result is None and len(seen) == 1 + mu_upper.NEWTON_STEPS == 26
    np.testing.assert_allclose(np.diff(np.array(seen)[:, 0]), 0.25)


def test_the_singular_value_is_modelled_by_the_blocks_of_rows_and_columns(monkeypatch):
    asked, M = [], matrix(FULL, 1)

    def model(*args):
        asked.append(args)
        return 1.0, np.zeros(2), np.eye(2), 1.0

    monkeypatch.setattr(mu_upper, "_newton_model", model)
    mu_upper.simple_infimum(M, Structure(FULL), 1e-3)
    [(matrix_asked, x, rows, cols, member)] = asked
    assert matrix_asked is M and (rows, cols) == ([1, 2], [2, 1])
    np.testing.assert_allclose(np.exp(x), mu_upper._balance(M, Structure(FULL)))
    assert member.tolist() == [[1, 0, 0, -1, -1, 0], [0, 1, 1, 0, 0, -1]]
    assert mu_upper.simple_infimum(M, Structure((Block("full", 3, 3),)), 1e-3) is None
    other = Structure((Block("repeated_real", 1, 1), Block("full", 2, 2)))
    assert mu_upper.simple_infimum(M, other, 1e-3) is None
    assert len(asked) == 1


@pytest.mark.parametrize("silent", [False, True])
def test_the_bound_from_below_is_the_least_gain_of_a_block(silent):
    """Of M z for z the scaled right singular vector; a block that has no part in z says nothing."""
    M, x = matrix(FULL, 2), np.array([0.3, -0.2])
    if silent:
        M[:, :2] = 0.0
    member = np.array([[1, 0, 0, -1, -1, 0], [0, 1, 1, 0, 0, -1]], float)
    value, _, _, low = mu_upper._newton_model(M, x, [1, 2], [2, 1], member)
    left, right = np.diag(np.exp(x[[0, 1, 1]])), np.diag(np.exp(x[[0, 0, 1]]))
    _, sigma, Vh = np.linalg.svd(left @ M @ np.linalg.inv(right))
    z = np.linalg.inv(right) @ Vh[0].conj()
    gains = [
        np.linalg.norm(M[r] @ z) / np.linalg.norm(z[c])
        for r, c in ((slice(0, 1), slice(0, 2)), (slice(1, 3), slice(2, 3)))
        if np.linalg.norm(z[c]) > 1e-12
    ]
    assert value == pytest.approx(sigma[0]) and low == pytest.approx(min(gains))
    assert len(gains) == 2 - silent


def test_a_block_outside_of_the_largest_singular_vectors_says_nothing_of_the_bound():
    """Its part of both is zero to the last digit."""
    member = np.array([[1, 0, -1, 0], [0, 1, 0, -1]], float)
    for gains in ([2.0, 1.0], [1.0, 2.0], [2.0, 0.0]):
        with np.errstate(all="raise"):
            model = mu_upper._newton_model(
                np.diag(gains).astype(complex), np.zeros(2), [1, 1], [1, 1], member
            )
        assert (model[0], model[3]) == (2.0, 2.0)


@pytest.mark.parametrize("blocks", [((1, 2), (1, 1)), ((2, 1), (1, 1))], ids=["low", "wide"])
def test_newtons_model_of_a_matrix_of_fewer_rows_or_columns_is_that_of_its_singular_value(blocks):
    structure = Structure(tuple(Block("full", rows, cols) for rows, cols in blocks))
    M, x, h = matrix(structure.blocks, 3), np.array([0.3, -0.2]), 1e-5
    rows, cols = [r.stop - r.start for r in structure.row], [c.stop - c.start for c in structure.col]
    member = np.zeros((2, sum(M.shape)))
    for k, (r, c) in enumerate(zip(structure.row, structure.col, strict=True)):
        member[k, r], member[k, len(M) + c.start : len(M) + c.stop] = 1.0, -1.0

    def value(x):
        return np.linalg.norm(
            np.diag(np.exp(np.repeat(x, rows))) @ M @ np.diag(np.exp(-np.repeat(x, cols))), 2
        )

    model, slope, *_ = mu_upper._newton_model(M, x, rows, cols, member)
    assert model == pytest.approx(value(x))
    np.testing.assert_allclose(
        slope, [(value(x + h * e) - value(x - h * e)) / (2 * h) for e in np.eye(2)], rtol=1e-6
    )


# ---------------------------------------------------------------- start, level, gap


def test_balancing_goes_on_until_a_sweep_changes_less_than_a_hundredth(monkeypatch):
    asked = []

    def never(before, now, rtol):
        asked.append((before.copy(), now.copy(), rtol))
        return len(asked) == 99

    monkeypatch.setattr(np, "allclose", never)
    M = np.array([[5.0, 1.0], [16.0, 7.0]], complex)
    d = mu_upper._balance(M, Structure(TWO))
    assert len(asked) == 50 and {rtol for *_, rtol in asked} == {1e-2}
    assert asked[0][0].tolist() == [1.0, 1.0] and asked[0][1].tolist() == [4.0, 1.0]
    assert asked[1][0].tolist() == [4.0, 1.0] and d.tolist() == [4.0, 1.0]
    monkeypatch.setattr(np, "allclose", lambda *_, **__: True)
    for one, wanted in (
        ([[0, 1e-30], [1.0, 0]], [1e12, 1e-3]),
        ([[0, 1.0], [1e-30, 0]], [1e-12, 1e3]),
        ([[0, 1e-60], [1.0, 0]], [1e12, 1e-12]),
    ):
        d = mu_upper._balance(np.array(one), Structure(TWO))
        assert d[0] == wanted[0] and d[1] == pytest.approx(wanted[1], rel=1e-9)
    for one in ([[1.0, 2.0], [0.0, 1.0]], [[1.0, 0.0], [2.0, 1.0]]):
        assert mu_upper._balance(np.array(one), Structure(TWO)).tolist() == [1.0, 1.0]
    uneven = np.array([[0, 3.0, 4.0], [6.0, 1.0, 0], [8.0, 0, 1.0]])
    np.testing.assert_allclose(
        mu_upper._balance(uneven, Structure((ONE, Block("full", 2, 2)))), [np.sqrt(2), 1.0]
    )


def test_balancing_ends_near_its_limit_and_not_at_it():
    """Of these three blocks three sweeps are enough; a fourth one still moves them a little."""
    M = np.array([[1.0, 2.0, 0.1], [0.3, 1.0, 5.0], [4.0, 0.2, 1.0]])
    each = [slice(k, k + 1) for k in range(3)]
    d = mu_upper._balance(M, SimpleNamespace(blocks=each, row=each, col=each))
    off = M * (1 - np.eye(3))
    ratio = np.linalg.norm(off.T * d, axis=1) / np.linalg.norm(off / d, axis=1)
    moved = np.abs(np.sqrt(ratio) / d - 1).max()
    assert 1e-9 < moved < 1e-2


def test_the_level_of_dense_scalings_is_a_generalised_eigenvalue(monkeypatch):
    """With rounding that is seen beside the rest, by the sizes of all that is summed."""
    eps = 1e-4
    monkeypatch.setattr(np, "finfo", lambda kind: SimpleNamespace(eps=eps))
    random, M = np.random.default_rng(2), matrix(MIXED, 4)
    rows, cols = M.shape

    def dense(n):
        return random.standard_normal((n, n)) + 1j * random.standard_normal((n, n)) + 3 * np.eye(n)

    left, right, D_left, D_right = (dense(n) for n in (rows, cols, rows, cols))
    D_left, D_right = D_left @ D_left.conj().T, D_right @ D_right.conj().T
    G = dense(max(rows, cols))[:cols, :rows]
    N = left.conj().T @ M @ np.linalg.inv(right.conj().T) / 3.0
    W = N.conj().T @ D_left @ N + 1j * (G @ N) + (1j * (G @ N)).conj().T
    sizes = np.einsum("ka,kl,lb->ab", np.abs(left), np.abs(M), np.abs(np.linalg.inv(right.conj().T))) / 3.0
    lost = 8 * eps * np.linalg.norm(sizes) * (np.linalg.norm(N) + 2 * np.linalg.norm(G))
    level = mu_upper._level(M, left, right, D_left, D_right, G, 3.0)
    assert level == pytest.approx(sl.eigvalsh(W + lost * np.eye(cols), D_right)[-1], rel=1e-9)


def test_the_level_counts_the_rounding_of_terms_that_cancel():
    """leftH M = [0, 1] from terms of 2e8 and 1, over units of 2 and of 4."""
    left = np.array([[1.0, 0.0], [1e8, 1.0]], complex)
    M, right = np.array([[-1e8], [1.0]], complex), np.array([[2.0]], complex)
    G = np.array([[3.0, 4.0]], complex)
    terms, N, eps = np.hypot(2e8, 1.0) / 8.0, 1.0 / 8.0, np.finfo(float).eps
    level = mu_upper._level(M, left, right, np.eye(2), np.eye(1), G, 4.0)
    wanted = N**2 + 8 * eps * terms * (N + 2 * 5.0)
    assert level - N**2 == pytest.approx(wanted - N**2, rel=1e-8)


def test_the_gap_is_what_the_multipliers_leave_of_each_block():
    """By hand: D = diag(2, 3, 3), tr D = 8, so nu = 6 / 8."""
    structure, x = Structure(FULL), np.array([2.0, 3.0])
    Z, nu = np.diag([0.5, 0.25, 2.0]).astype(complex), 6 / 8
    trace = np.array([1.0, 2.0])
    first, second = (nu - 1 / 2) / 0.75, 2 * (nu - 1 / 3) / 2.0
    assert first < second
    assert mu_upper._dual_gap(x, Z, structure, trace) == pytest.approx(second)
    Z[0, 0] = 0.05
    assert mu_upper._dual_gap(x, Z, structure, trace) == pytest.approx((nu - 1 / 2) / 0.3)


def test_whitening_divides_by_a_factor_on_both_sides():
    random = np.random.default_rng(3)
    L = np.tril(random.standard_normal((3, 3)) + 1j * random.standard_normal((3, 3))) + 3 * np.eye(3)
    F = random.standard_normal((2, 3, 3)) + 1j * random.standard_normal((2, 3, 3))
    for white, f in zip(mu_upper._whiten(L, F), F, strict=True):
        np.testing.assert_allclose(L @ white @ L.conj().T, f, atol=1e-12)


# ---------------------------------------------------------------- one centre


def reference_steps(x, F, structure, trace):
    """Points of damped Newton steps along the line of equal trace, for two scales, by the barrier's own two
    derivatives; and Z at the last one."""
    along, points = np.array([trace[1], -trace[0]]), [x]
    decrement = np.inf
    while decrement >= 1e-5:
        slope = curvature = 0.0
        for basis in (F, structure.left):
            part = np.linalg.solve(np.tensordot(x, basis, 1), np.tensordot(along, basis, 1))
            slope -= np.real(np.trace(part))
            curvature += np.real(np.trace(part @ part))
        decrement = abs(slope) / np.sqrt(curvature)
        length = 1 / (1 + decrement) if decrement > 0.25 else 1.0
        x = x - length * slope / curvature * along
        points.append(x)
    return np.array(points), np.linalg.inv(np.tensordot(x, F, 1))


@pytest.mark.parametrize("unit", [1.0, 1e12])
@pytest.mark.parametrize("start", [[1.0, 1.0], [3.0, 0.1]])
def test_a_centre_is_found_by_newtons_steps_whatever_the_unit_of_a_scale(unit, start, monkeypatch):
    structure, M = Structure(FULL), matrix(FULL, 3)
    N = M / (4.0 * np.linalg.norm(M, 2))
    units, tensordot, seen = np.array([unit, 1.0]), np.tensordot, []
    F = (structure.right - N.conj().T @ structure.left @ N) * units[:, None, None]
    structure.left = structure.left * units[:, None, None]
    trace, x = np.array([1.0, 2.0]) * units * unit, np.array(start) / units
    points, Z = reference_steps(x, F, structure, trace)

    def stub(point, basis, axes):
        if basis is F:
            seen.append(point * units)
        return tensordot(point, basis, axes)

    with monkeypatch.context() as patch:
        patch.setattr(np, "tensordot", stub)
        centre, Z_found = mu_upper._centre(x, F, structure, trace)
    assert len(seen) == len(points) > 4
    np.testing.assert_allclose(seen, points * units, rtol=1e-7, atol=1e-9)
    np.testing.assert_allclose(centre * units, points[-1] * units, rtol=1e-9)
    np.testing.assert_allclose(Z_found, Z, rtol=1e-6, atol=1e-9)


def test_the_centre_of_dense_scalings_has_no_slope_along_any_direction_of_equal_trace():
    structure, M = Structure(MIXED), matrix(MIXED, 3)
    N = M / (2.0 * np.linalg.norm(M, 2))
    skew = 1j * (structure.skew @ N)
    F = np.concatenate(
        [structure.right - N.conj().T @ structure.left @ N, -(skew + np.conj(np.swapaxes(skew, 1, 2)))]
    )
    n = len(structure.left)
    trace = np.append(np.real(np.trace(structure.left, axis1=1, axis2=2)), np.zeros(len(structure.skew)))
    start = structure.coordinates(np.eye(structure.n_cols), np.zeros((structure.n_cols, structure.n_rows)))
    x, Z = mu_upper._centre(start, F, structure, trace)
    assert trace @ x == pytest.approx(trace @ start)
    S, D = np.tensordot(x, F, 1), np.tensordot(x[:n], structure.left, 1)
    np.testing.assert_allclose(Z @ S, np.eye(len(S)), atol=1e-8)
    slope = np.array([np.real(np.trace(Z @ f)) for f in F])
    slope[:n] += [np.real(np.trace(np.linalg.solve(D, e))) for e in structure.left]
    slope[n:] -= mu_upper.G_WEIGHT * x[n:]
    slope -= trace * (slope @ trace) / (trace @ trace)
    assert np.abs(slope).max() < 1e-6


THREE = (Block("full", 3, 1),) * 2
"""The barrier of the centre's coordinates is 4 times -log of each: its curvature at 1 is 4."""


@pytest.fixture
def steps(monkeypatch):
    """`_centre` of the barrier above from (1, 1), by scripted steps where the curvature is 1: the centre,
    and how many it asked."""

    def run(moves):
        structure, moves, count = Structure(THREE), iter(moves), []

        def lstsq(K, right, rcond):
            count.append(rcond)
            return np.array([*next(moves), 7.0]), None, None, None

        monkeypatch.setattr(np.linalg, "lstsq", lstsq)
        x, _ = mu_upper._centre(np.ones(2), structure.right, structure, np.ones(2))
        return x, count

    return run


@pytest.mark.parametrize(("move", "length"), [(0.25, 1.0), (0.5, 1 / 1.5), (2.0, 1 / 3)])
def test_steps_are_damped_from_a_quarter_of_the_curvature_on(move, length, steps):
    x, count = steps([(move, 0.0), (0.0, 0.0)])
    np.testing.assert_allclose(x, [1.0 + length * 0.5 * move, 1.0], rtol=1e-12)
    assert count == [1e-14] * 2


def test_a_centre_is_where_a_step_is_shorter_than_so_much(steps):
    assert len(steps([(1e-5, 0.0), (0.99e-5, 0.0)])[1]) == 2


def test_so_many_steps_are_taken_to_a_centre(steps):
    _, count = steps([(1e-4, -1e-4)] * 99)
    assert len(count) == 60


def test_a_step_out_of_the_set_is_halved_and_given_up_when_it_is_tiny(steps, monkeypatch):
    cholesky, refused = np.linalg.cholesky, []

    def rounded(X):
        if count_down[0] and not np.allclose(np.diag(X), 1.0, rtol=1e-12, atol=0):
            count_down[0] -= 1
            refused.append(float(X[0, 0].real) - 1)
            raise np.linalg.LinAlgError
        return cholesky(X)

    monkeypatch.setattr(np.linalg, "cholesky", rounded)
    count_down = [3]
    x, _ = steps([(0.25, 0.0), (0.0, 0.0)])
    np.testing.assert_allclose(x, [1.0 + 0.125 / 8, 1.0])
    np.testing.assert_allclose(refused, 0.125 * 0.5 ** np.arange(3))
    count_down, refused[:] = [-1], []
    x, count = steps([(0.25, 0.0)] * 2)
    np.testing.assert_allclose(refused, 0.125 * 0.5 ** np.arange(20))
    assert x.tolist() == [1.0, 1.0] and len(count) == 1
