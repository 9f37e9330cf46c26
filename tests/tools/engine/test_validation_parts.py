"""The parts of the general LFT by themselves: known answers, borders, and the same number by another way."""

import numpy as np
import pytest
from scipy.optimize import minimize_scalar

from lft_problems import gauss, row, scalars_of
from lpvguard.base.errors import InputError
from lpvguard.engine.blocks import Block
from lpvguard.engine.validation import delta as dl
from lpvguard.engine.validation import lft
from lpvguard.engine.validation.branch import Interval
from lpvguard.engine.validation.problem import Lft, parametrise
from lpvguard.engine.validation.quadratic import Form, Quadratic, cancels
from lpvguard.engine.validation.scaled_problem import (
    ScaledProblem,
    Solution,
    ball,
    block_form,
    scaled_problem,
)
from lpvguard.engine.validation.well_posed import block_caps, well_posed


def loop(p11: np.ndarray, *blocks: tuple[str, int, int]) -> Lft:
    """A point of which only P11 (q, p) and the blocks matter."""
    q, p = p11.shape
    one = np.ones((1, 1), complex)
    return Lft(
        tuple(Block(*b) for b in blocks),
        p11.astype(complex),
        np.zeros((q, 1), complex),
        np.ones((1, p), complex),
        one,
        np.ones(q, complex),
        np.ones(1, complex),
    )


# --- well-posedness ---


def test_the_cap_of_a_block_is_one_over_the_largest_singular_value_of_its_own_part():
    p11 = gauss(np.random.default_rng(1), 7, 6)
    # Blocks of 2 x 3, 1 x 2, 2 x 1 and 1 x 1: outputs (rows) are columns of P11, inputs (cols) its rows.
    parts = [p11[:3, :2], p11[3:5, 2:3], p11[5:6, 3:5], p11[6:, 5:]]
    p11[6, 5] = 0.0
    problem = loop(p11, ("full", 2, 3), ("full", 1, 2), ("full", 2, 1), ("full", 1, 1))
    want = [np.linalg.eigvalsh(m.conj().T @ m)[-1] ** -0.5 for m in parts[:3]]
    with np.errstate(all="raise"):
        np.testing.assert_allclose(block_caps(problem), [*want, np.inf], rtol=1e-12)
        problem = loop(0.01 * p11, *((b.kind, b.rows, b.cols) for b in problem.blocks))
        np.testing.assert_allclose(block_caps(problem), [100 * cap for cap in want] + [np.inf], rtol=1e-12)


def test_a_wide_block_is_as_large_as_its_largest_singular_value():
    # xi_1 + xi_2 comes back: a full block of 2 x 1 and size 1 / sqrt(2) makes 1 - [1 1] Delta singular.
    problem = loop(np.ones((1, 2)), ("full", 2, 1))
    assert well_posed(problem, np.array([0.999 / np.sqrt(2)]))
    assert not well_posed(problem, np.array([1.001 / np.sqrt(2)]))


@pytest.mark.parametrize("seed", range(6))
def test_two_full_blocks_are_well_posed_up_to_the_structured_singular_value(seed):
    """mu of two full blocks is the least of sigma_max(D P11 D^-1); it lies below the radius of the matrix of
    the blocks' norms, so that only the S-procedure tells."""
    rng = np.random.default_rng(seed)
    shapes = [((2, 3), (2, 1)), ((3, 2), (1, 3)), ((2, 2), (2, 2))][seed % 3]
    (r1, c1), (r2, c2) = shapes
    p11, nu = gauss(rng, c1 + c2, r1 + r2), rng.uniform(0.3, 3.0, 2)
    problem = loop(p11, ("full", r1, c1), ("full", r2, c2))
    sized = p11 * np.repeat(nu, [r1, r2])

    def scaled(log_d: float) -> float:
        d = np.exp(log_d)
        left, right = np.repeat([1.0, d], [c1, c2]), np.repeat([1.0, d], [r1, r2])
        return float(np.linalg.norm(left[:, None] * sized / right, 2))

    mu = minimize_scalar(scaled, bounds=(-8.0, 8.0), method="bounded", options={"xatol": 1e-8}).fun
    norms = [
        [np.linalg.norm(sized[:c1, :r1], 2), np.linalg.norm(sized[:c1, r1:], 2)],
        [np.linalg.norm(sized[c1:, :r1], 2), np.linalg.norm(sized[c1:, r1:], 2)],
    ]
    assert 0.99 * np.abs(np.linalg.eigvals(norms)).max() > mu, "else the first test decides"
    assert well_posed(problem, 0.99 / mu * nu)
    assert not well_posed(problem, 1.01 / mu * nu)


def test_a_real_block_without_input_and_a_block_of_size_zero_change_nothing():
    turn = np.linalg.qr(gauss(np.random.default_rng(3), 2, 2))[0]
    p11 = np.zeros((4, 4), complex)
    p11[:2, :2] = turn @ np.array([[0.5, 3.0], [0.0, 0.2]]) @ turn.conj().T  # of a scalar: singular at 2
    p11[:2, 2:] = 0.1
    silent = loop(p11, ("repeated_complex", 2, 2), ("repeated_real", 2, 2))
    assert well_posed(silent, np.array([1.9, 7.0])) and not well_posed(silent, np.array([2.01, 7.0]))
    p11[2:] = 4.0
    off = loop(p11, ("repeated_complex", 2, 2), ("repeated_real", 2, 2))
    assert well_posed(off, np.array([1.9, 0.0])) and not well_posed(off, np.array([2.01, 0.0]))


# --- Delta ---

BLOCKS = (Block("full", 2, 3), Block("repeated_complex", 2, 2), Block("repeated_real", 1, 1))


def test_signals_and_maps_are_cut_by_blocks():
    xi, eta = dl.split(BLOCKS, np.arange(5.0), "rows"), dl.split(BLOCKS, np.arange(6.0), "cols")
    assert [x.tolist() for x in xi] == [[0, 1], [2, 3], [4]]
    assert [x.tolist() for x in eta] == [[0, 1, 2], [3, 4], [5]]
    assert [x.shape for x in dl.split(BLOCKS, np.zeros((6, 4)), "cols")] == [(3, 4), (2, 4), (1, 4)]


def test_the_least_size_of_a_block_is_the_ratio_of_what_leaves_and_enters_it():
    assert dl.least_size(np.array([3.0, 4j]), np.array([1.0, 2.0, 2j])) == pytest.approx(5 / 3, rel=1e-15)
    assert dl.least_size(np.zeros(2), np.zeros(2)) == 0.0 == dl.least_size(np.zeros(2), np.ones(2))
    assert dl.least_size(np.array([1e-100]), np.zeros(1)) == np.inf
    assert dl.least_size(np.array([0.5]), np.array([0.25])) == 2.0


def test_each_kind_of_block_maps_its_input_to_its_output_at_the_least_size():
    rng = np.random.default_rng(4)
    xi, eta = gauss(rng, 2), gauss(rng, 3)
    full = dl.construct(BLOCKS[0], xi, eta)
    np.testing.assert_allclose(full @ eta, xi, rtol=1e-12)
    assert np.linalg.norm(full, 2) == pytest.approx(np.linalg.norm(xi) / np.linalg.norm(eta), rel=1e-12)
    eta = gauss(rng, 2)
    np.testing.assert_allclose(
        dl.construct(BLOCKS[1], (0.3 - 0.4j) * eta, eta), (0.3 - 0.4j) * np.eye(2), atol=1e-15
    )
    # Of a real block the nearest real scalar: the imaginary part of 0.3 - 0.4j is left over.
    real = dl.construct(Block("repeated_real", 2, 2), (0.3 - 0.4j) * eta, eta)
    np.testing.assert_allclose(real, 0.3 * np.eye(2), atol=1e-15)
    nothing = dl.construct(BLOCKS[0], np.zeros(2), np.zeros(3))
    assert nothing.shape == (2, 3) and not nothing.any()


def closed(seed: int) -> tuple[dict[str, np.ndarray], np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """(P, e, w, xi, nu) of a loop that is closed with a known Delta of `BLOCKS`."""
    rng = np.random.default_rng(seed)
    p = {"P11": 0.2 * gauss(rng, 6, 5), "P12": 0.3 * gauss(rng, 6, 2), "P21": gauss(rng, 2, 5)}
    p |= {"P22": gauss(rng, 2, 2), "eta0": gauss(rng, 6)}
    total = np.zeros((5, 6), complex)
    u = gauss(rng, 2)[:, None]
    rank_one = u @ gauss(rng, 1, 3)
    nu = np.array([0.4, 0.25, 0.3])
    total[:2, :3] = nu[0] * rank_one / np.linalg.norm(rank_one, 2)
    total[2:4, 3:5] = nu[1] * np.exp(1j) * np.eye(2)
    total[4, 5] = -nu[2]
    w = 0.1 * gauss(rng, 2)
    eta = np.linalg.solve(np.eye(6) - p["P11"] @ total, p["P12"] @ w + p["eta0"])
    xi = total @ eta
    return p, p["P21"] @ xi + p["P22"] @ w, w, xi, np.array([dl.least_size(xi[:2], eta[:3]), *nu[1:]])


def test_an_explanation_is_closed_again_and_what_it_misses_is_its_share_of_e():
    p, e, w, xi, nu = closed(5)
    report = dl.verify(BLOCKS, p, e, w, xi, nu)
    assert report.residual < 1e-13 and [d.shape for d in report.deltas] == [(2, 3), (2, 2), (1, 1)]
    np.testing.assert_allclose(report.sizes, nu, rtol=1e-12)
    for part, xi_i, eta_i in zip(
        report.deltas,
        dl.split(BLOCKS, xi, "rows"),
        dl.split(BLOCKS, p["P11"] @ xi + p["P12"] @ w + p["eta0"], "cols"),
        strict=True,
    ):
        np.testing.assert_allclose(part @ eta_i, xi_i, rtol=1e-10)
    # e moved by a share of its own size: the residual is that share, of the moved e.
    across = np.array([-e[1].conj(), e[0].conj()])
    for share in (0.8e-6, 0.4e-3):
        moved = e + share * across
        report = dl.verify(BLOCKS, p, moved, w, xi, nu, rtol=1e-3)
        assert report.residual == pytest.approx(share / np.sqrt(1 + share**2), rel=1e-6)


def test_what_misses_the_data_or_its_size_by_more_than_a_millionth_is_refused():
    p, e, w, xi, nu = closed(6)
    across = np.array([-e[1].conj(), e[0].conj()])
    dl.verify(BLOCKS, p, e + 0.99e-6 * across, w, xi, nu)
    with pytest.raises(InputError, match="re-simulated"):
        dl.verify(BLOCKS, p, e + 1.01e-6 * across, w, xi, nu)
    for i in range(3):
        short = nu.copy()
        short[i] *= 1 - 0.99e-6
        dl.verify(BLOCKS, p, e, w, xi, short)
        short[i] = nu[i] * (1 - 1.01e-6)
        with pytest.raises(InputError, match="size"):
            dl.verify(BLOCKS, p, e, w, xi, short)


def test_a_residual_at_its_limit_and_an_output_that_is_partly_zero_are_taken():
    p, e, w, xi, nu = closed(8)
    report = dl.verify(BLOCKS, p, e * (1 + 1e-4), w, xi, nu, rtol=1e-3)
    again = dl.verify(BLOCKS, p, e * (1 + 1e-4), w, xi, nu, rtol=report.residual)
    assert again.residual == report.residual == pytest.approx(1e-4, rel=1e-3)
    eta = np.array([1.0, 2j, 0.5])
    np.testing.assert_allclose(dl.construct(BLOCKS[0], np.array([0.0, 2.0]), eta) @ eta, [0.0, 2.0])


def test_data_of_zero_are_explained_by_nothing():
    p, e, w, xi, nu = closed(7)
    report = dl.verify(BLOCKS, p, 0 * e, 0 * w, 0 * xi, 0 * nu)
    assert report.residual == 0.0 and not report.sizes.any()
    with pytest.raises(InputError, match="re-simulated"):
        dl.verify(BLOCKS, p, 0 * e, w, 0 * xi, nu)


# --- all signals that produce e ---


def parts_of(n_y: int, n_w: int, rng: np.random.Generator) -> dict[str, np.ndarray]:
    return {
        "p11": gauss(rng, 6, 5),
        "p12": gauss(rng, 6, n_w),
        "p21": gauss(rng, n_y, 5),
        "p22": gauss(rng, n_y, n_w),
        "eta0": gauss(rng, 6),
        "e": gauss(rng, n_y),
    }


@pytest.mark.parametrize("name", ["p11", "p12", "p21", "p22", "eta0", "e"])
def test_each_matrix_is_held_against_its_shape_and_must_be_finite(name):
    parts = parts_of(4, 3, np.random.default_rng(0))
    Lft(BLOCKS, **parts)
    for axis in range(parts[name].ndim):
        longer = np.concatenate([parts[name], np.take(parts[name], [0], axis)], axis)
        # A longer e is what P21 does not fit, a wider P22 what P12 does not.
        with pytest.raises(InputError, match=r"shape .* to fit the blocks"):
            Lft(BLOCKS, **(parts | {name: longer}))
    for bad in (np.nan, np.inf):
        spoiled = parts[name].copy()
        spoiled.flat[-1] = bad
        with pytest.raises(InputError, match=f"{name}.*not finite"):
            Lft(BLOCKS, **(parts | {name: spoiled}))


def test_no_blocks_and_no_outputs_are_named():
    parts = parts_of(0, 3, np.random.default_rng(0))
    with pytest.raises(InputError, match="at least one block and one output"):
        Lft(BLOCKS, **parts)
    empty = {"p11": np.zeros((0, 0)), "p12": np.zeros((0, 3)), "p21": np.zeros((2, 0)), "eta0": np.zeros(0)}
    with pytest.raises(InputError, match="at least one block and one output"):
        Lft((), **(parts_of(2, 3, np.random.default_rng(0)) | empty))


@pytest.mark.parametrize("n_y, n_w", [(7, 4), (7, 7), (3, 5), (8, 3)])
@pytest.mark.parametrize("unit", [1.0, 1e9, 1e-9])
def test_the_least_disturbance_is_what_p21_cannot_produce_by_any_unit_of_the_blocks(n_y, n_w, unit):
    """Projected on what P21 does not reach, w is the least-norm solution alone; units of xi do not matter."""
    rng = np.random.default_rng(n_y + n_w)
    parts = parts_of(n_y, n_w, rng)
    parts["e"] = parts["p21"] @ gauss(rng, 5) + parts["p22"] @ gauss(rng, n_w)
    beyond = np.linalg.svd(parts["p21"])[0][:, min(n_y, 5) :].conj().T
    least = np.linalg.pinv(beyond @ parts["p22"]) @ (beyond @ parts["e"])
    parts["p21"][:, :2] *= unit
    parts["p11"][:, :2] *= unit
    par = parametrise(Lft(BLOCKS, **parts))
    assert par.b1 == pytest.approx(np.linalg.norm(least), rel=1e-6, abs=1e-9)
    # w moves where P21 can answer; the rest of the freedom leaves w alone.
    stacked = np.hstack([parts["p21"], parts["p22"]])
    free = 5 + n_w - np.linalg.matrix_rank(stacked / np.linalg.norm(stacked, axis=0))
    assert par.xi_map.shape[1] == free + 1
    assert par.n_phi == n_w - np.linalg.matrix_rank(beyond @ parts["p22"], tol=1e-9)
    assert not par.w_map[:, par.n_phi : -1].any()
    np.testing.assert_allclose(par.w_map[:, -1], least, atol=1e-6 * (1 + np.linalg.norm(least)))
    for _ in range(3):
        z = np.append(gauss(rng, free), 1.0)
        made = parts["p21"] @ (par.xi_map @ z) + parts["p22"] @ (par.w_map @ z)
        np.testing.assert_allclose(made, parts["e"], atol=1e-7)
        eta = parts["p11"] @ (par.xi_map @ z) + parts["p12"] @ (par.w_map @ z) + parts["eta0"]
        np.testing.assert_allclose(par.eta_map @ z, eta, rtol=1e-7, atol=1e-7)
        assert np.linalg.norm(par.w_map @ z) ** 2 == pytest.approx(
            np.linalg.norm(z[: par.n_phi]) ** 2 + par.b1**2, rel=1e-8
        )


def test_e_may_leave_the_image_by_a_hundred_millionth_of_its_size():
    rng = np.random.default_rng(9)
    parts = parts_of(4, 2, rng)
    parts["p21"] = parts["p21"][:, :1] @ gauss(rng, 1, 5)  # rank 1, and P22 rank 2: one direction is left
    out = np.linalg.svd(np.hstack([parts["p21"], parts["p22"]]))[0][:, 3]
    inside = parts["p22"] @ np.array([3.0, -4j])
    inside *= 5.0 / np.linalg.norm(inside)
    parametrise(Lft(BLOCKS, **(parts | {"e": inside + 4.95e-8 * out})))
    with pytest.raises(InputError, match="not in Im"):
        parametrise(Lft(BLOCKS, **(parts | {"e": inside + 5.05e-8 * out})))


def test_a_disturbance_that_the_data_fix_moves_in_no_direction():
    """P21 of rank 2 leaves xi free and w fixed: what rounding leaves of the null space in w is no freedom."""
    for seed in range(5):
        parts = parts_of(4, 2, np.random.default_rng(seed))
        parts["p21"] = parts["p21"][:, :2] @ gauss(np.random.default_rng(seed + 9), 2, 5)
        beyond = np.linalg.svd(parts["p21"])[0][:, 2:].conj().T
        w = np.linalg.solve(beyond @ parts["p22"], beyond @ parts["e"])
        par = parametrise(Lft(BLOCKS, **parts))
        assert par.n_phi == 0 and par.b1 == pytest.approx(np.linalg.norm(w), rel=1e-9)
        assert par.xi_map.shape == (5, 4)
        with pytest.raises(InputError, match="B1"):
            lft.optimum(Lft(BLOCKS, **parts), 0.99 * par.b1, [1.0, 1.0, 1.0])


@pytest.mark.parametrize("signal", ["block 1", "block 2", "block 3", "w"])
@pytest.mark.parametrize("unit", [1e13, 1e-13])
def test_a_block_or_the_disturbance_in_another_unit_is_the_same_block(signal, unit):
    parts = parts_of(4, 3, np.random.default_rng(11))
    b1 = parametrise(Lft(BLOCKS, **parts)).b1
    assert b1 < 1e-12, "P21 reaches all of e"
    parts["p21"][:, 2:] = 0.0
    parts["p21"][1] = parts["p21"][2] = 0.0
    moved = {name: m.copy() for name, m in parts.items()}
    columns = {"block 1": slice(2), "block 2": slice(2, 4), "block 3": slice(4, 5)}
    if signal == "w":
        moved["p22"] *= unit
    else:
        moved["p21"][:, columns[signal]] *= unit
    was, now = parametrise(Lft(BLOCKS, **parts)), parametrise(Lft(BLOCKS, **moved))
    assert (was.n_phi, was.xi_map.shape) == (now.n_phi, now.xi_map.shape) == (1, (5, 5))
    assert now.b1 * (unit if signal == "w" else 1.0) == pytest.approx(was.b1, rel=1e-9) and was.b1 > 0.1
    # Blocks 2 and 3 reach no output: each of their signals is free.
    assert np.linalg.matrix_rank(now.xi_map[2:, :-1]) == 3


@pytest.mark.parametrize("columns", [slice(0, 2), slice(2, 4), slice(4, 5)])
def test_units_of_one_block_leave_the_number_of_directions(columns):
    parts = parts_of(5, 4, np.random.default_rng(13))
    moved = {name: m.copy() for name, m in parts.items()}
    moved["p21"][:, columns] *= 1e-13
    was, now = parametrise(Lft(BLOCKS, **parts)), parametrise(Lft(BLOCKS, **moved))
    assert (was.n_phi, was.xi_map.shape) == (now.n_phi, now.xi_map.shape) == (4, (5, 5))


@pytest.mark.parametrize("d, reaches", [(0.8e-10, False), (1.25e-10, True)])
def test_a_direction_of_m_counts_from_a_ten_billionth_of_the_largest(d, reaches):
    one = np.ones((1, 1), complex)
    # Columns of the same size: singular values sqrt(2) and sqrt(2) d.
    problem = Lft(
        (Block("full", 1, 1),),
        one,
        one,
        np.array([[1.0], [d]], complex),
        np.array([[1.0], [-d]], complex),
        np.ones(1, complex),
        np.array([1.0, 1e-3 * d], complex) if reaches else np.array([1.0, 1e-6], complex),
    )
    if reaches:
        par = parametrise(problem)
        # xi + w = 1, xi - w = 1e-3: two equations for two unknowns.
        assert par.b1 == pytest.approx(0.4995, rel=1e-6)
    else:
        with pytest.raises(InputError, match="not in Im"):
            parametrise(problem)


def test_nothing_is_produced_by_a_model_without_gain_and_nothing_is_asked():
    parts = parts_of(2, 3, np.random.default_rng(12))
    for name in ("p21", "p22", "e"):
        parts[name] = 0 * parts[name]
    par = parametrise(Lft(BLOCKS, **parts))
    assert par.b1 == 0.0 and par.n_phi == 3 and np.isfinite(par.xi_map).all()
    assert np.linalg.matrix_rank(np.vstack([par.xi_map, par.w_map])[:, :-1]) == 8
    with pytest.raises(InputError, match="not in Im"):
        parametrise(Lft(BLOCKS, **(parts | {"e": np.array([0j, 1e-100])})))


@pytest.mark.parametrize("d, free", [(2.7e-10, 0), (2.95e-10, 1)])
def test_the_disturbance_moves_where_its_part_of_a_direction_is_above_a_ten_billionth(d, free):
    # xi = (1, -1) leaves d to w. In columns of a common size that direction has d / (2 sqrt(2)) in w.
    problem = Lft(
        (Block("full", 2, 1),),
        np.ones((1, 2), complex),
        np.ones((1, 1), complex),
        np.array([[1.0, 1.0], [1.0, 1.0 + d]], complex),
        np.array([[0.0], [7.0]], complex),
        np.ones(1, complex),
        np.array([0.0, 1.0], complex),
    )
    par = parametrise(problem)
    assert par.n_phi == free and par.b1 == pytest.approx(0.0 if free else 1 / 7, abs=1e-12)


# --- the quadratic problem ---


def test_what_cancels_to_a_trillionth_of_its_terms_is_zero():
    a = np.array([[3.0, -1.0]])
    assert cancels(a, np.array([1.0, 3.0 + 5.9e-12])) and cancels(-1j * a, np.array([1.0, 3.0 - 5.9e-12]))
    assert not cancels(a, np.array([1.0, 3.0 + 6.1e-12])) and cancels(0 * a, np.ones(2))
    assert cancels(-a, np.array([1.0, 3.0])) and cancels(np.abs(a), np.array([1.0, -3.0 + 5.9e-12]))


def test_sizes_are_the_least_that_every_form_allows():
    """z = (x, 1): |2 x|^2 <= (1 + p0) 3 |1 + x|^2, |x - 1|^2 <= p0 / 4, |x|^2 <= p1 and |x| <= 5."""
    forms = [
        Form(row(2, 0), row(1, 1), constant=1.0, param=0, slope=3.0),
        Form(row(1, -1), row(0, 1), param=0, slope=0.25),
        Form(row(1, 0), row(0, 1), param=1),
        Form(row(1, 0), row(0, 1), constant=12.5, slope=2.0),
    ]
    problem = Quadratic(forms, 2, 2)
    for x in (0.3, 1.0, -0.8, 2j, 4.9):
        p0 = max(4 * abs(x) ** 2 / (3 * abs(1 + x) ** 2) - 1, 4 * abs(x - 1) ** 2, 0)
        assert problem.cost(np.array([x, 1.0])) == pytest.approx(p0 + abs(x) ** 2, rel=1e-12)
    only, none = Quadratic(forms[:1], 1, 2), Quadratic([Form(row(1, 0), row(0, 1))], 1, 2)
    with np.errstate(all="raise"):
        assert problem.cost(np.array([-1.0, 1.0])) == np.inf, "no size lets 0 be as large as 2"
        assert only.cost(np.array([0.0, 1.0])) == 0.0, "a size is not negative"
        assert only.cost(np.array([0j, 0.0])) == 0.0, "nothing asks for nothing"
    assert none.cost(np.array([0.0, 1.0])) == 0.0 and none.cost(np.array([1e-9, 1.0])) == np.inf
    border = 5 * np.sqrt(1 + 1e-9)
    assert np.isfinite(problem.cost(np.array([border * (1 - 1e-12), 1.0])))
    assert problem.cost(np.array([border * (1 + 1e-12), 1.0])) == np.inf
    free = Quadratic([Form(row(1, 0), row(0, 1), constant=np.inf)], 1, 2)
    assert free.cost(np.array([1e9, 1.0])) == 0.0, "a block without a cap is not bounded"
    np.testing.assert_array_equal(Quadratic(forms, 2, 4).origin(), [0, 0, 0, 1])


def test_a_repeated_scalar_is_the_one_that_fits_best():
    rng = np.random.default_rng(1)
    a, b, z = gauss(rng, 3, 3), gauss(rng, 3, 3), gauss(rng, 3)
    problem = Quadratic([scalars_of(k, a, b, param=0) for k in ("repeated_complex", "repeated_real")], 1, 3)
    best, _, _, _ = np.linalg.lstsq((b @ z)[:, None], a @ z)
    assert problem.scalar(0, z) == pytest.approx(best[0], rel=1e-12)
    stacked = [np.concatenate([v.real, v.imag]) for v in (b @ z, a @ z)]
    assert problem.scalar(1, z) == pytest.approx(
        stacked[0] @ stacked[1] / (stacked[0] @ stacked[0]), rel=1e-12
    )
    assert Quadratic([scalars_of("repeated_real", a, 0 * b)], 1, 3).scalar(0, z) == 0.0
    assert Quadratic([scalars_of("repeated_complex", a, 0 * b)], 1, 3).scalar(0, z) == 0.0


def test_a_size_that_one_repeated_block_alone_decides_is_its_boxes():
    one = row(1, 0)
    full, real = Form(one, one, param=0), scalars_of("repeated_real", one, one, param=1)
    capped = scalars_of("repeated_complex", one, one, constant=4.0)
    shared = scalars_of("repeated_complex", one, one, param=0)
    problem = Quadratic([full, real, capped], 2, 2)
    assert problem.repeated == [1, 2] and problem.boxed == {1}
    assert Quadratic([full, shared], 1, 2).boxed == set() == Quadratic([capped], 1, 2).boxed
    assert Quadratic([shared, shared], 1, 2).boxed == set()


@pytest.mark.parametrize("seed", range(4))
@pytest.mark.parametrize("unit", [1.0, 1e9])
def test_held_scalars_leave_the_points_that_they_fit_and_the_nearest_of_them(seed, unit):
    rng = np.random.default_rng(seed)
    a, b = gauss(rng, 2, 2, 6), gauss(rng, 2, 2, 6)
    forms = [Form(np.eye(1, 6), np.eye(1, 6)), *(scalars_of("repeated_complex", a[k], b[k]) for k in (0, 1))]
    forms[2] = scalars_of("repeated_complex", unit * a[1], b[1])
    problem, d = Quadratic(forms, 1, 6), {1: 0.3 + 0.4j, 2: unit * (-0.8 + 0.1j)}
    z0 = np.append(gauss(rng, 5), 1.0)
    z, null = problem.on_subspace(z0, d)
    rows = np.vstack([a[0] - d[1] * b[0], a[1] - d[2] / unit * b[1]])
    np.testing.assert_allclose(rows @ z, 0, atol=1e-12)
    assert z[-1] == 1 and null.shape == (5, 1)
    np.testing.assert_allclose(rows[:, :-1] @ null, 0, atol=1e-12)
    np.testing.assert_allclose(null.conj().T @ null, np.eye(1), atol=1e-12)
    np.testing.assert_allclose(null.conj().T @ (z - z0)[:-1], 0, atol=1e-12, err_msg="nearest")
    same, free = problem.on_subspace(z0, {})
    assert same is z0 and free is None
    # Five rows for two free numbers: no point has these scalars.
    narrow = Quadratic([scalars_of("repeated_complex", gauss(rng, 4, 3), gauss(rng, 4, 3))], 1, 3)
    assert narrow.on_subspace(np.ones(3), {0: 0.5}) is None and narrow.inside({0: 0.5}) == (np.inf, None)
    assert narrow.repair(np.ones(3)) is None


@pytest.mark.parametrize("share, sign", [(1.9, 1), (2.1, 1), (1.9, -1), (2.1, -1)])
def test_a_held_scalar_may_miss_its_equation_by_a_billionth_of_the_terms(share, sign):
    """sign delta = delta_0 without a free number that could help: |a| + |delta b| = 2 at most."""
    problem = Quadratic([scalars_of("repeated_complex", row(0, sign), row(0, 1), param=0)], 1, 2)
    mirrored = Quadratic([scalars_of("repeated_complex", row(0, 1), row(0, -1), param=0)], 1, 2)
    z = np.array([0.0, 1.0])
    held = (
        problem.on_subspace(z, {0: sign * (1 + share * 1e-9)}),
        mirrored.on_subspace(z, {0: -1 - share * 1e-9}),
    )
    assert [f is not None for f in held] == [share < 2, share < 2]
    # In a column that cancels there are terms as well: 2 for x of size 1, and 2 for the last one.
    for x in (1.0, -1.0):
        beside = Quadratic(
            [scalars_of("repeated_complex", row(1, 1 + 2 * share * 1e-9), row(1, 1), param=0)], 1, 2
        )
        assert (beside.on_subspace(np.array([x, 1.0]), {0: 1.0}) is not None) == (share < 2)
    nothing = Quadratic([scalars_of("repeated_complex", row(0, 0, 0), row(0, 0, 0), param=0)], 1, 3)
    at, null = nothing.on_subspace(np.array([2.0, 3.0, 1.0]), {0: 0.5})
    np.testing.assert_array_equal(at, [2.0, 3.0, 1.0])
    assert null.shape == (2, 2) and np.linalg.matrix_rank(null) == 2


@pytest.mark.parametrize(
    "a, delta, b",
    [
        (1.0, 1e-12, 1.0),
        (1.0, 5e11, 1e-12),
        (1e-12, 0.5, 1.0),
        (1e-12, 5e11, 1e-12),
        (1.0, 1e-13 - 1, 0.5**0.5),
    ],
)
def test_each_held_block_has_a_unit_of_its_own(a, delta, b):
    """a x_1 = delta b (x_1 + 1), beside a block that fixes x_2 at 2."""
    forms = [
        scalars_of("repeated_complex", row(a, 0, 0), row(b, 0, b), param=0),
        scalars_of("repeated_complex", row(0, 1, 0), row(0, 0, 1), param=1),
    ]
    z, null = Quadratic(forms, 2, 3).on_subspace(np.array([0.0, 0.0, 1.0]), {0: delta, 1: 2.0})
    np.testing.assert_allclose(z, [delta * b / (a - delta * b), 2.0, 1.0], rtol=1e-6, atol=1e-18)
    assert null.shape == (2, 0)


@pytest.mark.parametrize("turn, free", [(1e-10, 1), (3e-10, 0)])
def test_held_rows_are_apart_from_a_ten_billionth_on(turn, free):
    """x_1 = 99 and x_1 + turn x_2 = 99 + 2e-8: in their units the rows are a hundredth of what they hold."""
    forms = [
        scalars_of("repeated_complex", row(1, 0, 0), row(0, 0, 99), param=0),
        scalars_of("repeated_complex", row(1, turn, -2e-8), row(0, 0, 99), param=1),
    ]
    z, null = Quadratic(forms, 2, 3).on_subspace(np.array([0.0, 0.0, 1.0]), {0: 1.0, 1: 1.0})
    assert null.shape == (2, free) and (abs(z[1]) < 1) == (free == 1)


def test_a_point_is_repaired_towards_the_centre_of_the_ball_and_only_to_its_edge():
    rng = np.random.default_rng(3)
    a, z = gauss(rng, 2, 4), np.append(5 * gauss(rng, 3), 1.0)
    centre = np.append(np.linalg.lstsq(a[:, :3], -a[:, 3])[0], 1.0)
    ball_form = Form(a, row(0, 0, 0, 2), constant=0.3, slope=0.5)
    limit = 0.3 * 0.5 * 4
    problem = Quadratic([ball_form, Form(row(1, 0, 0, 0), row(0, 0, 0, 1), param=0)], 1, 4)
    moved = problem.repair(z)
    assert np.linalg.norm(a @ moved) ** 2 == pytest.approx(limit, rel=1e-9)
    # a z is shrunk along itself, because the ball is centred at a z = 0.
    turned = (a @ moved) / (a @ z)
    np.testing.assert_allclose(turned, turned[0].real, rtol=1e-9)
    assert 0 < turned[0].real < 1
    np.testing.assert_array_equal(problem.repair(centre), centre)
    edge = centre + np.sqrt(1 + 0.9e-12) * (moved - centre) * np.append(np.ones(3), 0)
    np.testing.assert_array_equal(problem.repair(edge), edge)
    beyond = centre + 1.03 * (moved - centre) * np.append(np.ones(3), 0)
    assert np.linalg.norm(a @ problem.repair(beyond)) ** 2 == pytest.approx(limit, rel=1e-9)
    # A ball that is touched to a billionth, and one that is missed by more.
    two = np.array([[1, 0], [0, 1]], complex)
    for miss, there in ((0.0, True), (1e-9, True), (1e-7, False)):
        touched = Quadratic([Form(two, row(0, 1), constant=1.0 - miss)], 1, 2).repair(np.array([3.0, 1.0]))
        assert (touched is not None) == there and (not there or abs(touched[0]) < 1e-6)
    # A scalar's own bound is not a ball: its cost says that it is broken.
    capped = Quadratic([scalars_of("repeated_complex", row(1, 0), row(0, 1), constant=1.0)], 1, 2)
    np.testing.assert_allclose(capped.repair(np.array([5.0, 1.0])), [5.0, 1.0])
    assert capped.cost(np.array([5.0, 1.0])) == np.inf
    # Where no z comes inside, there is no such point.
    outside = Quadratic([Form(row(0, 1), row(0, 1), constant=0.99)], 1, 2)
    assert outside.repair(np.array([3.0, 1.0])) is None
    far = Quadratic([Form(np.array([[1, 0], [0, 1]], complex), row(0, 1), constant=0.5)], 1, 2)
    assert far.repair(np.array([3.0, 1.0])) is None


def test_a_repair_keeps_the_repeated_scalars_and_the_ball():
    rng = np.random.default_rng(5)
    a, b, ball_rows = gauss(rng, 2, 6), gauss(rng, 2, 6), gauss(rng, 2, 6)
    forms = [Form(ball_rows, np.eye(1, 6, 5), constant=0.5), scalars_of("repeated_complex", a, b, param=0)]
    problem, z = Quadratic(forms, 1, 6), np.append(9 * gauss(rng, 5), 1.0)
    d = problem.scalar(1, z)
    moved = problem.repair(z)
    np.testing.assert_allclose(a @ moved, d * (b @ moved), rtol=1e-9)
    assert np.linalg.norm(ball_rows @ moved) ** 2 == pytest.approx(0.5, rel=1e-9)
    ratio, inner = problem.inside({1: d})
    assert ratio < 1e-9 and np.linalg.norm(ball_rows @ inner) < 1e-9, "three free numbers, two rows"


def test_the_point_that_violates_the_constants_least():
    # |x - 3| <= 2 by a form and x = delta by a repeated block of one: at delta = 6 the ratio is 1.5.
    forms = [
        Form(row(1, -3), row(0, 2), constant=0.5, slope=2.0),
        scalars_of("repeated_complex", row(1, 0), row(0, 1), param=0),
    ]
    problem = Quadratic(forms, 1, 2)
    for delta, ratio in ((6.0, 1.5), (3.0, 0.0), (1.0, 1.0), (3 + 1j, 0.5)):
        violation, z = problem.inside({1: delta})
        assert violation == pytest.approx(ratio, abs=1e-12) and z == pytest.approx(np.array([delta, 1.0]))
    # Without a held scalar x is free; two such limits, at 0 and 3, meet in between in units of their radii.
    two = Quadratic(
        [Form(row(1, -3), row(0, 1), constant=1.0), Form(row(1, 0), row(0, 1), constant=4.0)], 1, 2
    )
    violation, z = two.inside({})
    assert z[0] == pytest.approx(3 / (1 + 0.25)) and violation == pytest.approx(max(0.6, 1.2))
    slopes = [
        Form(row(1, 0, -3), row(0, 0, 1), constant=0.25, slope=4.0),
        Form(row(1, 0, 0), row(0, 0, 1), constant=16.0, slope=0.25),
        Form(row(0, 1, -5), row(0, 0, 1), constant=1.0),
        Form(row(1, 1, 7), row(0, 0, 1), param=0),
        scalars_of("repeated_complex", row(1, 0, 0), row(0, 0, 1), constant=1e-6),
    ]
    violation, z = Quadratic(slopes, 1, 3).inside({})
    np.testing.assert_allclose(z, [2.4, 5.0, 1.0])
    assert violation == pytest.approx(1.2), "sizes that are asked for and scalars' bounds do not count"
    assert (
        Quadratic([scalars_of("repeated_real", row(1, 0), row(0, 1), param=0)], 1, 2).inside({0: 2.0})[0]
        == 0.0
    )


def test_a_point_without_any_size_is_found_where_there_is_one():
    rng = np.random.default_rng(7)
    xi, w = gauss(rng, 2, 6), gauss(rng, 2, 6)
    one = np.eye(1, 6, 5)
    wanted = Form(xi, one, param=0)
    for unit in (1.0, 1e-14, 1e14):
        for limit in (1e-6, 1.0):
            problem = Quadratic([Form(w, one, constant=limit), Form(unit * xi, one, param=0)], 1, 6)
            z = problem.zero()
            assert z[-1] == 1 and np.linalg.norm(xi @ z) < 1e-12 and np.linalg.norm(w @ z) ** 2 <= limit
    # xi = 0 takes four of the five free numbers, w then has one for two rows: its least norm decides.
    tall = gauss(rng, 4, 6)
    plane = np.linalg.svd(tall[:, :5])[2][4:].conj().T
    at = np.append(np.linalg.lstsq(tall[:, :5], -tall[:, 5])[0], 1.0)
    left = w[:, :5] @ plane
    least = np.linalg.norm(w @ at - left @ np.linalg.lstsq(left, w @ at)[0])
    for share, there in ((0.999, False), (1.001, True)):
        limit = (share * least) ** 2
        problem = Quadratic([Form(w, 2 * one, constant=limit / 8, slope=2.0), Form(tall, one, param=0)], 1, 6)
        assert (problem.zero() is not None) == there
    parts = (tall, 1e14 * xi)
    stacked = Quadratic([Form(np.vstack(parts), one, param=0, parts=parts)], 1, 6)
    assert stacked.zero() is None, "six rows for five free numbers, whichever unit the first four have"
    assert Quadratic([scalars_of("repeated_real", xi, xi, constant=1.0), wanted], 1, 6).zero() is None
    assert Quadratic([scalars_of("repeated_real", xi, xi, param=0)], 1, 6).zero() is not None
    every = gauss(rng, 5, 6)
    none = Quadratic([Form(every, one, constant=1.0)], 1, 6).zero()
    assert np.linalg.norm(every @ none) < 1e-12, "nothing to pay for"
    for maps in ((xi, 1e14 * w), (1e14 * xi, w), (xi, 0 * w)):
        both = Quadratic([Form(m, one, param=0) for m in maps] + [Form(0 * xi, one)], 1, 6).zero()
        assert np.linalg.norm(xi @ both) < 1e-10 and all(cancels(m, both) for m in maps)
    # x_1 = 1 twice, the second time with a trillionth of x_2: x_2 is free to come within 1 of 3.
    almost = [Form(row(1, 0, -1), row(0, 0, 1), param=0), Form(row(1, 5e-13, -1), row(0, 0, 1), param=0)]
    z = Quadratic([*almost, Form(row(0, 1, -3), row(0, 0, 1), constant=1.0)], 1, 3).zero()
    np.testing.assert_allclose(z, [1.0, 3.0, 1.0], atol=1e-9)
    still = [Form(np.zeros((2, 3)), row(0, 0, 1), param=0), Form(row(0, 1, -3), row(0, 0, 1), constant=1.0)]
    np.testing.assert_allclose(Quadratic(still, 1, 3).zero(), [0.0, 3.0, 1.0], atol=1e-12)


def test_a_point_without_any_size_may_be_far_away():
    """x / 1e12 = 1 fixes x however small its part; a limit of twice that does not draw it nearer."""
    far = Form(row(1e-12, -1), row(0, 1), param=0)
    z = Quadratic([far, Form(row(1, 0), row(0, 1), constant=4e24)], 1, 2).zero()
    np.testing.assert_allclose(z, [1e12, 1.0], rtol=1e-12)
    assert Quadratic([far, Form(row(1, 0), row(0, 1), constant=0.25e24)], 1, 2).zero() is None


def test_rows_that_differ_by_a_trillionth_are_one():
    """Taken apart they would ask for x_2 = -10, where x_1 alone is what they ask for."""
    nearly = np.array([[1, 0, 0], [1, 1e-12, 1e-11]], complex)
    ball_form, start = Form(nearly, row(0, 0, 1), constant=1.0), np.array([5.0, 0.0, 1.0])
    moved = Quadratic([ball_form], 1, 3).repair(start)
    np.testing.assert_allclose(moved, [0.5**0.5, 0.0, 1.0], atol=1e-6)
    np.testing.assert_allclose(Quadratic([ball_form], 1, 3).inside({})[1], [0.0, 0.0, 1.0], atol=1e-6)
    np.testing.assert_allclose(Quadratic([ball_form], 1, 3).zero(), [0.0, 0.0, 1.0], atol=1e-6)
    wanted = [
        Form(row(1, 0, -1), row(0, 0, 1), param=0),
        Form(row(1, 5e-13, -1 - 1e-12), row(0, 0, 1), param=0),
    ]
    np.testing.assert_allclose(Quadratic(wanted, 1, 3).zero(), [1.0, 0.0, 1.0], atol=1e-6)


# --- a point in well-scaled coordinates ---


def posed_parts(seed: int, n_y: int = 4, n_w: int = 4) -> dict[str, np.ndarray]:
    parts = parts_of(n_y, n_w, np.random.default_rng(seed))
    return parts | {"p11": 0.1 * parts["p11"]}


def residual_of(problem: Lft, xi: np.ndarray, eta: np.ndarray, w: np.ndarray) -> float:
    """What the signals miss of both equations."""
    output = problem.e - problem.p21 @ xi - problem.p22 @ w
    return float(
        np.linalg.norm(output) + np.linalg.norm(eta - problem.p11 @ xi - problem.p12 @ w - problem.eta0)
    )


@pytest.mark.parametrize("unit", [1.0, 1e6])
@pytest.mark.parametrize("without", [(), (1,), (0, 2)])
@pytest.mark.parametrize("n_w", [4, 6])
def test_every_point_of_the_coordinates_is_a_solution_and_its_size_is_that_of_the_signals(unit, without, n_w):
    parts = posed_parts(21, 4, n_w)
    parts["p21"][:, :2] *= unit
    parts["p11"][:, :2] *= unit
    problem, w_scale = Lft(BLOCKS, **parts), np.linspace(0.5, 2.0, n_w)
    scaled = ScaledProblem(problem, w_scale, without=without)
    held = sum(BLOCKS[i].rows for i in without)
    assert scaled.dead == list(without) and not scaled.ball_is_point and scaled.n == 5 + n_w - 4 - held + 1
    rng, sizes = np.random.default_rng(1), []
    for _ in range(4):
        z = np.append(gauss(rng, scaled.n - 1), 1.0)
        xi, eta, w = scaled.signals(3j * z)
        assert residual_of(problem, xi, eta, w) < 1e-9
        np.testing.assert_allclose(
            np.concatenate([m @ z for m in scaled.eta]) / (scaled.t @ z), eta, atol=1e-9
        )
        np.testing.assert_allclose(scaled.w @ z / (scaled.t @ z), w, atol=1e-12)
        pieces = dl.split(BLOCKS, xi, "rows")
        assert all(not pieces[i].any() for i in without)
        gains = [np.linalg.norm(m.T) for m in dl.split(BLOCKS, problem.p21.T, "rows")]
        share = [
            np.linalg.norm(x) * g / np.linalg.norm(problem.e) for x, g in zip(pieces, gains, strict=True)
        ]
        size = np.linalg.norm(share) ** 2 + np.linalg.norm(w / w_scale) ** 2
        # Columns are orthogonal of size 1, the last one too, all over the factor t.
        assert size == pytest.approx(
            (np.linalg.norm(z[:-1]) ** 2 + 1) / abs((scaled.t @ z)[0]) ** 2, rel=1e-7
        )
        sizes.append(size)
    known = lft.optimum(problem, 10.0, [1.0, 1.0, 1.0]) if not without and unit == 1.0 else None
    assert ScaledProblem(problem, w_scale).points(None) == []
    if known is not None:
        [z] = scaled.points(known)
        for signal, was in zip(scaled.signals(z), (known.xi, known.eta, known.w), strict=True):
            np.testing.assert_allclose(signal, was, atol=1e-9)


def size_of(scaled: ScaledProblem, w_scale: np.ndarray, z: np.ndarray, size_e: float) -> float:
    """|.|^2 of all signals at ``z``, each block's by what it does to e, over the factor t."""
    xi, _, w = scaled.signals(z)
    p21 = scaled.problem.p21
    gains = [np.linalg.norm(m.T) for m in dl.split(scaled.problem.blocks, p21.T, "rows")]
    pieces = dl.split(scaled.problem.blocks, xi, "rows")
    share = [np.linalg.norm(x) * (g / size_e if g else 1.0) for x, g in zip(pieces, gains, strict=True)]
    return (np.linalg.norm(share) ** 2 + np.linalg.norm(w / w_scale) ** 2) * abs((scaled.t @ z)[0]) ** 2


def test_a_block_that_reaches_no_output_is_sized_by_itself_and_an_e_of_zero_by_one():
    parts = posed_parts(27)
    parts["p21"][:, 2:4] = 0.0
    parts["p21"] *= 1e-3
    parts["e"] = parts["p21"] @ np.ones(5)
    for e in (parts["e"], 0 * parts["e"]):
        problem = Lft(BLOCKS, **(parts | {"e": e}))
        size_e = np.linalg.norm(e) or 1.0
        for gamma in (0.5, 0.0):
            scaled = scaled_problem(problem, gamma)
            assert scaled.ball_is_point == (gamma == 0.0)
            z = np.append(gauss(np.random.default_rng(2), scaled.n - 1), 1.0)
            want = np.linalg.norm(z[:-1]) ** 2 + bool(e.any())
            scale = np.full(4, gamma or size_e)
            assert size_of(scaled, scale, z, size_e) == pytest.approx(want, rel=1e-9)
            assert scaled.t[0, -1] == 1.0 or e.any()
            assert scaled.xi[1][:, :-1].any(), "the block is free"


def test_the_point_of_an_explanation_is_found_again_beside_dead_blocks_and_in_any_unit():
    for unit in (1.0, 1e12, 1e-12):
        parts = posed_parts(28)
        for name in ("p11", "p12", "eta0"):
            parts[name][3:5] = 0.0
        parts["p21"][:, :2] *= unit
        parts["p11"][:, :2] *= unit
        problem = Lft(BLOCKS, **parts)
        scaled = scaled_problem(problem, 3.0)
        z = np.append(gauss(np.random.default_rng(5), scaled.n - 1), 1.0)
        xi, eta, w = scaled.signals(z)
        known = Solution(0.0, 1.0, np.ones(3), xi, eta, w, scaled.b1, None, 1)
        [point] = scaled.points(known)
        np.testing.assert_allclose(point, z, rtol=1e-6)


def test_a_least_disturbance_that_is_all_that_is_allowed_is_one_point():
    parts = posed_parts(22, 6, 4)
    parts["e"] = parts["p21"] @ np.ones(5) + parts["p22"] @ np.ones(4)
    parts["p21"][:, 2:] = parts["p21"][:, 2:4] @ np.ones((2, 3))
    parts["e"] = parts["p21"] @ np.ones(5) + parts["p22"] @ np.ones(4)
    problem = Lft(BLOCKS, **parts)
    b1 = parametrise(problem).b1
    assert b1 > 0.1 and parametrise(problem).n_phi > 0
    for share, point in ((1 + 0.9e-9, True), (1 - 0.9e-9, True), (1 + 1.1e-9, False), (2.0, False)):
        scaled = scaled_problem(problem, share * b1)
        assert scaled.ball_is_point == point and scaled.b1 == b1
        assert len(ball(scaled, share * b1)) == (0 if point else 1)
        z = np.append(np.ones(scaled.n - 1), 1.0)
        xi, eta, w = scaled.signals(z)
        assert residual_of(problem, xi, eta, w) < 1e-9
        assert (np.linalg.norm(w) == pytest.approx(b1, rel=1e-9)) == point
    with pytest.raises(InputError, match="below the smallest disturbance B1"):
        scaled_problem(problem, (1 - 1.1e-9) * b1)
    for bad in (-1e-12, np.inf, np.nan):
        with pytest.raises(InputError, match="a finite number that is not negative"):
            scaled_problem(problem, bad)


def test_no_disturbance_counts_to_the_rounding_of_e():
    parts = posed_parts(23, 3, 3)
    problem = Lft(BLOCKS, **(parts | {"e": parts["e"] / np.linalg.norm(parts["e"]) * 50}))
    assert parametrise(problem).b1 < 1e-14, "the blocks reach all outputs"
    assert scaled_problem(problem, 0.0).ball_is_point and scaled_problem(problem, 4e-13).ball_is_point
    assert not scaled_problem(problem, 6e-13).ball_is_point
    form = ball(scaled_problem(problem, 0.3), 0.3)[0]
    scaled = scaled_problem(problem, 0.3)
    assert form.constant == pytest.approx(0.09) and form.param == -1 and form.slope == 1.0
    np.testing.assert_array_equal(form.a, scaled.w)
    np.testing.assert_array_equal(form.b, scaled.t)


def test_a_block_without_input_is_held_at_zero_or_named():
    parts = posed_parts(24)
    for name in ("p11", "p12", "eta0"):
        parts[name][3:5] = 0.0
    problem = Lft(BLOCKS, **parts)
    scaled = ScaledProblem(problem, np.ones(4))
    assert scaled.dead == [1] and not scaled.xi[1].any()
    xi, eta, w = scaled.signals(np.append(np.ones(scaled.n - 1), 1.0))
    assert residual_of(problem, xi, eta, w) < 1e-9 and not xi[2:4].any()
    least_ratio = lft.optimum(problem, 2.0 * np.linalg.norm(problem.e), [1.0, 1.0, 1.0])
    assert least_ratio.nu[1] == 0.0 and not least_ratio.xi[2:4].any()
    # Where e needs that block alone it is named.
    parts["p21"][:, [0, 1, 4]] = 0.0
    parts["p22"][0] = 0.0
    parts["p21"][1:] = 0.0
    for unit in (1.0, 1e-6):
        with pytest.raises(InputError, match=r"block 2.*its input eta is zero"):
            ScaledProblem(Lft(BLOCKS, **(parts | {"e": unit * parts["e"]})), np.ones(4))


def beside_a_dead_block(seed: int, kind: tuple[str, int, int], p21: list[list[float]], e: list[float]) -> Lft:
    """A block without input, and one of 1 x 1 that explains e_2 together with w; outputs turned at random."""
    rng, dead = np.random.default_rng(seed), Block(*kind)
    turn = np.linalg.qr(gauss(rng, len(e), len(e)))[0] if seed else np.eye(len(e))
    p11 = np.zeros((dead.cols + 1, dead.rows + 1), complex)
    p11[-1] = 0.1 * np.abs(p21).sum(axis=0)
    eta0 = np.append(np.zeros(dead.cols, complex), 1.0)
    p22 = np.zeros((len(e), 1), complex)
    p22[1] = 1.0
    blocks = (dead, Block("full", 1, 1))
    return Lft(blocks, p11, 0.2 * eta0[:, None], turn @ np.array(p21), turn @ p22, eta0, turn @ np.array(e))


@pytest.mark.parametrize("seed", range(6))
@pytest.mark.parametrize("unit", [1.0, 1e13, 1e-13])
def test_what_the_data_hold_at_zero_already_is_not_held_again(seed, unit):
    """With xi_2 = 0 by the data themselves nothing is left to hold, or xi_1 alone: e_2 is explained as ever.

    xi + w = 1 and |w| <= 1 / 2 leave xi = 1 / 2, over eta = 1 + 0.1 xi + 0.2 w = 1.15.
    """
    one = beside_a_dead_block(seed, ("full", 1, 1), [[unit, 0], [0, 1]], [0, 1])
    two = beside_a_dead_block(seed, ("full", 2, 1), [[0, unit, 0], [0.7 * unit, 0, 1]], [0, 1])
    for problem in (one, two):
        scaled = scaled_problem(problem, 0.5)
        assert scaled.dead == [0] and scaled.n == 2
        least_ratio = lft.optimum(problem, 0.5, [1.0, 1.0])
        assert least_ratio.nu[0] == 0.0 and least_ratio.nu[1] == pytest.approx(0.5 / 1.15, rel=1e-6)


@pytest.mark.parametrize("share, fits", [(0.9e-8, True), (1.1e-8, False)])
@pytest.mark.parametrize("size", [1.0, 1e-6, 1e6])
def test_a_dead_block_may_be_needed_for_a_hundred_millionth_of_e(share, fits, size):
    problem = beside_a_dead_block(0, ("full", 1, 1), [[3.0, 0], [0, 1]], [share * size, size])
    if fits:
        assert scaled_problem(problem, size).dead == [0]
    else:
        with pytest.raises(InputError, match=r"block 1.*its input eta is zero"):
            scaled_problem(problem, size)


@pytest.mark.parametrize("share, n", [(0.9e-10, 2), (1.2e-10, 1)])
def test_a_dead_block_holds_a_direction_of_which_it_takes_a_ten_billionth(share, n):
    """xi_1 + sqrt(5) share xi_2 = e_1: as xi_2 and w / 0.5 change places by 1 and 2, xi_1 takes a share."""
    problem = beside_a_dead_block(0, ("full", 1, 1), [[1.0, share * np.sqrt(5)], [0, 1]], [0, 1])
    assert scaled_problem(problem, 0.5).n == n


@pytest.mark.parametrize("allowed, t", [(0.9e9, 0.9e9), (1.1e9, 1.0)])
def test_signals_below_a_billionth_of_those_allowed_are_no_least_size(allowed, t):
    """xi + w = 1 with w in a unit so large that it explains e for nothing."""
    one = np.ones((1, 1), complex)
    scaled = scaled_problem(Lft((Block("full", 1, 1),), 0 * one, 0 * one, one, one, one[0], one[0]), allowed)
    assert scaled.t[0, -1].real == pytest.approx(t, rel=1e-5)


def test_the_point_of_an_explanation_is_found_in_a_block_of_a_tiny_unit_alone():
    """xi_1 + xi_2 = e_1 in a unit of 1e-12, xi_3 + w = e_2: no other signal shows xi_1 - xi_2."""
    p21 = np.array([[1e12, 1e12, 0], [0, 0, 1]], complex)
    blocks = (Block("full", 2, 1), Block("full", 1, 1))
    p22, eta0 = np.array([[0], [1]], complex), np.ones(2, complex)
    problem = Lft(blocks, np.zeros((2, 3)), np.zeros((2, 1)), p21, p22, eta0, np.array([1.0, 2.0], complex))
    scaled = scaled_problem(problem, 1.0)
    z = np.append(gauss(np.random.default_rng(6), scaled.n - 1), 1.0)
    assert scaled.n == 3
    [point] = scaled.points(Solution(0.0, 1.0, np.ones(2), *scaled.signals(z), scaled.b1, None, 1))
    np.testing.assert_allclose(point, z, rtol=1e-9)


def test_without_a_disturbance_its_rounding_has_no_size_however_large_e():
    parts = posed_parts(23, 3, 3)
    for unit in (1.0, 1e20):
        scaled = scaled_problem(Lft(BLOCKS, **(parts | {"e": unit * parts["e"]})), 0.0)
        z = np.append(gauss(np.random.default_rng(2), scaled.n - 1), 1.0)
        xi, _, w = scaled.signals(z)
        assert np.linalg.norm(w) < 1e-13 * unit
        gains = [np.linalg.norm(m) for m in dl.split(BLOCKS, scaled.problem.p21.T, "rows")]
        size_e = np.linalg.norm(scaled.problem.e)
        share = [
            np.linalg.norm(x) * g / size_e for x, g in zip(dl.split(BLOCKS, xi, "rows"), gains, strict=True)
        ]
        size = np.linalg.norm(share) * abs((scaled.t @ z)[0])
        assert size**2 == pytest.approx(np.linalg.norm(z) ** 2, rel=1e-9)


def test_the_input_of_a_block_is_constant_where_no_signal_reaches_it():
    parts = posed_parts(25)
    parts["p11"][:3], parts["p12"][:3] = 0.0, 0.0
    scaled = ScaledProblem(Lft(BLOCKS, **parts), np.ones(4))
    assert [scaled.constant_eta(i) for i in range(3)] == [True, False, False]
    parts["p11"][2], parts["p12"][2] = 1.0, 1.0
    assert not ScaledProblem(Lft(BLOCKS, **parts), np.ones(4)).constant_eta(0), "one of its inputs moves"


def test_the_form_of_a_block_is_its_signals_and_a_scalar_of_one_row_is_full_unless_it_is_real():
    parts = posed_parts(26)
    scaled = ScaledProblem(Lft(BLOCKS, **parts), np.ones(4))
    kinds = [None, "repeated_complex", "repeated_real"]
    for i, kind in enumerate(kinds):
        form = block_form(scaled, i, constant=0.5, param=2, slope=3.0)
        assert (form.constant, form.param, form.slope, form.repeated) == (0.5, 2, 3.0, kind)
        np.testing.assert_array_equal(form.a, scaled.xi[i])
        np.testing.assert_array_equal(form.b, scaled.eta[i])
        assert (block_form(scaled, i).constant, block_form(scaled, i).param, block_form(scaled, i).slope) == (
            0,
            -1,
            1,
        )
    others = (Block("full", 2, 3), Block("repeated_real", 2, 2), Block("repeated_complex", 1, 1))
    scaled = ScaledProblem(Lft(others, **parts), np.ones(4))
    assert [block_form(scaled, i).repeated for i in range(3)] == [None, "repeated_real", None]


def test_an_explanation_is_finished_with_its_sizes_or_refused():
    problem = Lft(BLOCKS[:1], **one_block(0.2))
    scaled = scaled_problem(problem, 1.0)
    with pytest.raises(InputError, match="no Delta of this structure explains e within the bounds"):
        scaled.finish(Interval(0.0, np.inf, None, 7), "gamma_w")
    z = scaled.points(lft.optimum(problem, 1.0, [1.0]))[0]
    solution = scaled.finish(Interval(0.25, 0.5, z, 7), "gamma_w")
    assert (solution.lower, solution.upper, solution.nodes, solution.b1) == (0.25, 0.5, 7, scaled.b1)
    eta = problem.p11 @ solution.xi + problem.p12 @ solution.w + problem.eta0
    assert solution.nu[0] == pytest.approx(np.linalg.norm(solution.xi) / np.linalg.norm(eta), rel=1e-12)
    np.testing.assert_allclose(solution.eta, eta, rtol=1e-12)
    # With a loop gain of 1 / nu the same size makes the loop singular.
    hard = Lft(BLOCKS[:1], **one_block(1.001 / solution.nu[0]))
    scaled = scaled_problem(hard, 1.0)
    with pytest.raises(InputError, match="well-posedness cap"):
        scaled.finish(Interval(0.0, 1.0, z, 7), "gamma_w")


def one_block(gain: float) -> dict[str, np.ndarray]:
    """A block of 2 x 3 whose own loop has this gain, in a direction that the input eta0 does not take."""
    p11 = np.zeros((3, 2), complex)
    p11[2, 1] = gain
    return {
        "p11": p11,
        "p12": np.zeros((3, 2), complex),
        "p21": np.eye(2, dtype=complex),
        "p22": np.eye(2, dtype=complex),
        "eta0": np.array([1.0, 0.5j, 0.0]),
        "e": np.array([2.0, 0.0], complex),
    }
