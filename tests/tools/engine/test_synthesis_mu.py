"""μ: closed forms for every kind of block, a conic solver for the D,G infimum, and each Δ tried on its
matrix.
"""

import warnings

import cvxpy as cp
import numpy as np
import pytest

from lpvguard.engine.blocks import Block
from lpvguard.engine.synthesis.errors import SynthesisError
from lpvguard.engine.synthesis.mu import mu_bounds
from lpvguard.engine.synthesis.mu_upper import upper_bound
from lpvguard.engine.synthesis.structure import Structure
from lpvguard.extras.problems.synthesis import solve_mu


def full(rows, cols=None):
    return Block("full", rows, cols or rows)


def random_matrix(blocks, seed, spread=0.0):
    rng = np.random.default_rng(seed)
    shape = sum(b.cols for b in blocks), sum(b.rows for b in blocks)
    M = rng.standard_normal(shape) + 1j * rng.standard_normal(shape)
    return (
        10.0 ** rng.uniform(-spread, spread, (shape[0], 1))
        * M
        * 10.0 ** rng.uniform(-spread, spread, shape[1])
    )


def check_delta(M, blocks, bounds):
    """Δ has the structure and the size it claims, and makes I − M Δ singular."""
    delta, r0, c0 = bounds.delta.copy(), 0, 0
    for b in blocks:
        part = delta[r0 : r0 + b.rows, c0 : c0 + b.cols].copy()
        assert np.linalg.norm(part, 2) <= 1 / bounds.lower * (1 + 1e-9)
        if b.kind != "full":
            assert np.allclose(part, part[0, 0] * np.eye(b.rows), atol=1e-12 / bounds.lower)
        if b.kind == "repeated_real":
            assert abs(part[0, 0].imag) <= 1e-12 / bounds.lower
        delta[r0 : r0 + b.rows, c0 : c0 + b.cols] = 0
        r0, c0 = r0 + b.rows, c0 + b.cols
    assert not np.any(delta)
    loop = np.eye(len(M)) - M @ bounds.delta
    assert np.linalg.svd(loop, compute_uv=False)[-1] <= 1e-8 * max(1, np.linalg.norm(loop, 2))


def test_one_full_block_is_the_largest_singular_value():
    M = random_matrix([full(3, 2)], 0)
    bounds = mu_bounds(M, [full(3, 2)])
    assert bounds.upper == pytest.approx(np.linalg.norm(M, 2), rel=1e-8)
    assert bounds.lower == pytest.approx(np.linalg.norm(M, 2), rel=1e-8)


def test_one_repeated_complex_scalar_is_the_spectral_radius():
    block = Block("repeated_complex", 4, 4)
    M = random_matrix([block], 1)
    bounds = mu_bounds(M, [block])
    radius = np.abs(np.linalg.eigvals(M)).max()
    assert bounds.upper == pytest.approx(radius, rel=1e-4) and bounds.upper >= radius * (1 - 1e-9)
    assert bounds.lower == pytest.approx(radius, rel=1e-8)


def test_one_repeated_real_scalar_is_the_largest_real_eigenvalue():
    block = Block("repeated_real", 3, 3)
    T = np.random.default_rng(2).standard_normal((3, 3))
    M = T @ np.array([[-2.0, 0, 0], [0, 1.0, 5.0], [0, -5.0, 1.0]]) @ np.linalg.inv(T)
    bounds = mu_bounds(M, [block])
    assert bounds.lower == pytest.approx(2.0, rel=1e-8)
    assert 2.0 <= bounds.upper <= 2.01  # the infimum 2 is approached by an unbounded G only
    check_delta(M, [block], bounds)


def test_a_rank_one_matrix_has_the_sum_of_its_products():
    """μ(u vᴴ) = Σ |u_i||v_i| for scalar complex blocks, any number of them: bounds meet far beyond three
    blocks.
    """
    rng = np.random.default_rng(3)
    u, v = (rng.standard_normal(7) + 1j * rng.standard_normal(7) for _ in range(2))
    blocks = [full(1)] * 7
    bounds = mu_bounds(np.outer(u, v.conj()), blocks)
    want = np.sum(np.abs(u * v))
    assert bounds.lower == pytest.approx(want, rel=1e-7) and bounds.upper == pytest.approx(want, rel=1e-7)


@pytest.mark.parametrize("seed", range(5))
@pytest.mark.parametrize("spread", [0.0, 3.0])
def test_up_to_three_full_blocks_the_bounds_meet(seed, spread):
    blocks = [full(1), full(3), full(5, 2)]
    M = random_matrix(blocks, seed, spread)
    bounds = mu_bounds(M, blocks)
    assert bounds.lower == pytest.approx(bounds.upper, rel=1e-7)
    check_delta(M, blocks, bounds)


def conic_upper_bound(M, blocks):
    """The D,G infimum by bisection over feasibility problems of a conic solver."""
    size = np.linalg.norm(M, 2)
    N, R, C = M / size, *M.shape
    DL, DR, G, constraints, r0, c0 = np.zeros((R, R)), np.zeros((C, C)), np.zeros((C, R)), [], 0, 0
    for b in blocks:
        EL, ER = np.eye(R)[:, r0 : r0 + b.cols], np.eye(C)[:, c0 : c0 + b.rows]
        if b.kind == "full":
            d = cp.Variable(nonneg=True)
            DL, DR = DL + d * (EL @ EL.T), DR + d * (ER @ ER.T)
        else:
            D = cp.Variable((b.rows, b.rows), hermitian=True)
            constraints.append(D >> 1e-7 * np.eye(b.rows))
            DL, DR = DL + EL @ D @ EL.T, DR + ER @ D @ ER.T
            if b.kind == "repeated_real":
                G = G + ER @ cp.Variable((b.rows, b.rows), hermitian=True) @ EL.T
        r0, c0 = r0 + b.cols, c0 + b.rows
    level, t = cp.Parameter(nonneg=True), cp.Variable()
    GN = cp.Constant(1j) * (G @ N)
    X = level * DR - N.conj().T @ DL @ N - GN - cp.conj(GN).T
    problem = cp.Problem(
        cp.Maximize(t),
        [
            *constraints,
            0.5 * (X + cp.conj(X).T) >> t * np.eye(C),
            cp.real(cp.trace(cp.Constant(np.eye(R)) @ DL)) == R,
        ],
    )
    low, high = 0.0, 1.0
    for _ in range(16):
        level.value = 0.5 * (low + high)
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            problem.solve(solver="CLARABEL")
        low, high = (low, level.value) if t.value > 0 else (level.value, high)
    return size * np.sqrt(high)


@pytest.mark.unhurried
@pytest.mark.parametrize(
    "seed, blocks",
    [
        (0, [Block("repeated_complex", 2, 2), full(3, 2), full(1)]),
        (1, [Block("repeated_real", 2, 2), full(2)]),
        (2, [Block("repeated_real", 1, 1), Block("repeated_real", 1, 1), full(1, 2)]),
        (3, [Block("repeated_real", 2, 2), Block("repeated_complex", 2, 2), full(1)]),
        (4, [full(1)] * 5),
        (5, [Block("repeated_real", 3, 3), Block("repeated_real", 2, 2)]),
        (6, [Block("repeated_real", 3, 3), Block("repeated_real", 2, 2)]),
    ],
)
def test_the_upper_bound_is_the_infimum_over_d_and_g(seed, blocks):
    M = random_matrix(blocks, seed)
    conic, bounds = conic_upper_bound(M, blocks), mu_bounds(M, blocks)
    assert upper_bound(M, Structure(tuple(blocks)), 1e-8)[0] == pytest.approx(conic, rel=1e-4)
    assert bounds.lower <= bounds.upper <= conic * (1 + 1e-4)
    check_delta(M, blocks, bounds)


@pytest.mark.unhurried
@pytest.mark.parametrize("seed", [0, 1, 3])
def test_the_lower_bound_of_real_blocks_is_the_reciprocal_of_the_size_of_delta(seed):
    """Also where every real block ends inside its bound."""
    blocks = [Block("repeated_real", 2, 2), Block("repeated_real", 2, 2)]
    M = random_matrix(blocks, seed, spread=3.0)
    bounds = mu_bounds(M, blocks)
    check_delta(M, blocks, bounds)
    size = max(np.linalg.norm(bounds.delta[k : k + 2, k : k + 2], 2) for k in (0, 2))
    assert bounds.lower == pytest.approx(1 / size, rel=1e-9)


def test_the_scalings_prove_the_upper_bound():
    blocks = [Block("repeated_real", 2, 2), full(2, 1)]
    M = random_matrix(blocks, 7)
    upper, _, left, right, G = upper_bound(M, Structure(tuple(blocks)), 1e-8)
    skew, D_right = 1j * (G @ M), right @ right.conj().T
    X = M.conj().T @ left @ left.conj().T @ M + skew + skew.conj().T - upper**2 * D_right
    assert np.linalg.eigvalsh(X).max() <= 1e-6 * np.linalg.norm(D_right, 2) * upper**2


def test_zero_and_nilpotent_matrices_have_mu_zero():
    assert mu_bounds(np.zeros((2, 2)), [full(1), full(1)]).upper == 0
    bounds = mu_bounds(np.array([[0, 5.0], [0, 0]]), [full(1), full(1)])
    assert bounds.upper < 1e-5 and bounds.lower == 0


@pytest.mark.parametrize(
    "change, where",
    [
        ({"M": [[[1, 0]], [[2, 0]]]}, "M"),
        ({"blocks": []}, "blocks"),
        ({"blocks": [{"type": "half", "rows": 1, "cols": 1}]}, "block"),
        ({"blocks": [{"type": "repeated_real", "rows": 1, "cols": 2}]}, "block"),
        ({"M": [[1, 0, 0]]}, "M"),
        ({"blocks": [{"type": "full", "rows": 0, "cols": 1}]}, "rows"),
        ({"M": [[[1, float("nan")]]]}, "M"),
    ],
)
def test_solve_names_the_bad_field(change, where):
    problem = {"id": "m", "M": [[[1.0, 2.0]]], "blocks": [{"type": "full", "rows": 1, "cols": 1}]}
    assert solve_mu(problem)["mu_upper"] == pytest.approx(np.sqrt(5))
    with pytest.raises(SynthesisError, match=where):
        solve_mu(problem | change)


@pytest.mark.unhurried
@pytest.mark.parametrize("seed", [102, 301])
def test_the_lower_bound_of_a_mixed_problem_is_the_best_of_a_dense_search(seed):
    """Two real scalars and a full block: every (δ1, δ2) on a grid, the full block by its singular value."""
    blocks = [Block("repeated_real", 1, 1), Block("repeated_real", 1, 1), full(1, 2)]
    M = random_matrix(blocks, seed)
    bounds = mu_bounds(M, blocks)
    grid = np.linspace(-1, 1, 101)
    q = np.stack(np.meshgrid(grid, grid), -1).reshape(-1, 2)
    low, high = 0.3 * bounds.upper, bounds.upper
    for _ in range(14):
        beta = 0.5 * (low + high)
        loop = np.eye(2) - M[:2, :2] * (q / beta)[:, None, :]
        inner = np.linalg.solve(loop, np.broadcast_to(M[:2, 2:], (len(q), 2, 1)))
        rest = M[2:, 2:] + (M[2:, :2] * (q / beta)[:, None, :]) @ inner
        low, high = (beta, high) if np.linalg.norm(rest, 2, axis=(1, 2)).max() >= beta else (low, beta)
    assert bounds.lower >= low * (1 - 1e-3)
    check_delta(M, blocks, bounds)
