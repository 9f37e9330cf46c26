"""The general LFT and class S2 against semidefinite and brute-force references; both sides of every answer
are tested."""

import numpy as np
import pytest

from lft_problems import gauss, made_from_truth, substitute
from lpvguard.base.errors import InputError
from lpvguard.engine.blocks import Block
from lpvguard.engine.validation import delta as dl
from lpvguard.engine.validation import lft, lmi, s1
from lpvguard.engine.validation.branch import SLACK, proves
from lpvguard.engine.validation.problem import Lft, parametrise
from lpvguard.engine.validation.quadratic import Form, Quadratic
from lpvguard.engine.validation.relaxation import Box, BranchNode, Relaxation
from lpvguard.engine.validation.scaled_problem import ball, block_form, scaled_problem
from lpvguard.engine.validation.well_posed import block_caps, well_posed

TWO_BLOCKS = pytest.mark.long("10 s: branch and bound over two blocks")
FULL = {
    "one block": (2, [("full", 1, 1)], {}),
    "one wide block, three outputs": (3, [("full", 2, 3)], {}),
    "one output": (1, [("full", 1, 1), ("full", 3, 3)], {}),
    "P12": (3, [("full", 1, 1), ("full", 3, 3)], {"p12": True}),
    "P12 and a wide P22": (2, [("full", 2, 1), ("full", 1, 2)], {"p12": True, "n_w": 3}),
    "M square": (2, [("full", 1, 1)], {"p12": True, "n_w": 1}),
}


@pytest.mark.parametrize("name", FULL)
def test_full_blocks_are_solved_to_a_certified_gap(name):
    n_y, blocks, options = FULL[name]
    for seed in range(3):
        rng = np.random.default_rng(seed)
        problem, nu, w = made_from_truth(rng, n_y, blocks, **options)
        lam, gamma = rng.uniform(0.5, 2.0, len(blocks)), np.linalg.norm(w) * 1.001
        s = lft.optimum(problem, gamma, lam)
        assert s.upper - s.lower <= 1e-3 * s.upper
        assert s.upper <= np.sum(lam * nu**2) * (1 + 1e-6), (
            "the truth explains the data: nothing larger may be reported"
        )
        assert s.upper == pytest.approx(np.sum(lam * s.nu**2), rel=1e-6, abs=1e-12)
        substitute(problem, s, gamma)


PROVED = {
    "two blocks": [("full", 1, 1), ("full", 2, 1)],
    "real and full": [("repeated_real", 2, 2), ("full", 1, 1)],
    "repeated alone": [("repeated_complex", 2, 2)],
}


@pytest.mark.parametrize("name", PROVED)
def test_a_level_is_proved_below_the_optimum_and_not_above(name, monkeypatch):
    scaled = []
    monkeypatch.setattr(
        lft, "_proved", lambda problem, interval, _: scaled.append((problem, interval)) or interval
    )
    for seed in (1, 5, 7):
        problem, _, w = made_from_truth(np.random.default_rng(seed), 2, PROVED[name], noise=0.9)
        lft.optimum(problem, 1.1 * np.linalg.norm(w), np.ones(len(PROVED[name])))
    scaled = [(problem, interval) for problem, interval in scaled if interval.upper > 0]
    assert scaled
    for problem, interval in scaled:
        assert proves(problem, interval.lower * (1 - SLACK), interval.upper)
        assert proves(problem, 0.5 * interval.lower, 2.0 * interval.upper)
        assert not proves(problem, 1.001 * interval.upper, interval.upper)
        assert not proves(problem, 1.001 * interval.upper, 2.0 * interval.upper)
        assert proves(problem, 0.0, 0.0) and not proves(problem, interval.lower, interval.upper, 0)


def forms(problem):
    """Homogeneous maps (xi, eta, w, t) of a problem in the paper's coordinates, for conic references."""
    par = parametrise(problem)
    t = np.zeros((1, par.xi_map.shape[1]))
    t[0, -1] = 1.0
    return (
        dl.split(problem.blocks, par.xi_map, "rows"),
        dl.split(problem.blocks, par.eta_map, "cols"),
        par.w_map,
        t,
    )


def relaxed_feasible(cp, limits, n):
    """Is there X >= 0, X_tt = 1 with <Q, X> <= 0 for each Q?  (exact for three forms)"""
    x, excess = cp.Variable((n, n), hermitian=True), cp.Variable()
    rows = [cp.real(cp.trace((q / np.linalg.norm(q)) @ x)) <= excess for q in limits]
    cp.Problem(cp.Minimize(excess), [x >> 0, cp.real(cp.trace(x)) == 1, *rows]).solve(solver=cp.CLARABEL)
    return excess.value <= 0


@pytest.mark.unhurried
@pytest.mark.parametrize("name", ["one output", "P12", "P12 and a wide P22"])
def test_common_size_matches_bisection_over_semidefinite_programs(name):
    cp = pytest.importorskip("cvxpy")
    n_y, blocks, options = FULL[name]
    problem, nu, _ = made_from_truth(np.random.default_rng(77), n_y, blocks, **options)
    gamma = 0.7 * np.linalg.norm(np.linalg.pinv(problem.p22) @ problem.e)
    xi, eta, w_map, t = forms(problem)
    low, high = 0.0, 2.0 * float(nu.max())
    for _ in range(18):
        mid = 0.5 * (low + high)
        limits = [w_map.conj().T @ w_map - gamma**2 * (t.T @ t)]
        limits += [a.conj().T @ a - mid**2 * b.conj().T @ b for a, b in zip(xi, eta, strict=True)]
        low, high = (low, mid) if relaxed_feasible(cp, limits, t.shape[1]) else (mid, high)
    s = lft.smallest_common_size(problem, gamma)
    assert np.sqrt(s.lower) <= high * (1 + 1e-4) and np.sqrt(s.upper) >= low * (1 - 1e-4)
    assert s.upper - s.lower <= 1e-3 * s.upper


def scalar_grid(block_type, bound):
    if block_type == "repeated_real":
        return np.linspace(-bound, bound, 50001)
    radius, angle = np.meshgrid(np.linspace(0.0, bound, 301), np.linspace(0, 2 * np.pi, 360, endpoint=False))
    return (radius * np.exp(1j * angle)).ravel()


@pytest.mark.parametrize("block_type", ["repeated_complex", "repeated_real"])
@pytest.mark.parametrize("rows", [2, 3])
def test_repeated_block_beats_no_grid_point_and_is_beaten_by_none(block_type, rows):
    for seed in range(3):
        rng = np.random.default_rng(seed)
        problem, nu, w = made_from_truth(rng, 2, [(block_type, rows, rows)], noise=0.3)
        gamma = np.linalg.norm(w) * 1.05
        s = lft.optimum(problem, gamma, [1.0])
        grid = scalar_grid(block_type, 1.2 * nu[0])
        loop = np.linalg.solve(
            np.eye(rows) - grid[:, None, None] * problem.p11,
            np.broadcast_to(problem.eta0[:, None], (grid.size, rows, 1)),
        )[:, :, 0]
        left = np.linalg.norm(problem.e - grid[:, None] * (loop @ problem.p21.T), axis=1)
        best = np.min(np.abs(grid[left <= gamma])) ** 2
        assert s.lower <= best + 1e-15 and s.upper <= best * (1 + 1e-6) + 1e-15
        assert s.upper >= best * (1 - 0.02) - 1e-15, "the grid is fine enough to come this close"
        assert s.upper - s.lower <= 1e-3 * s.upper
        substitute(problem, s, gamma)


@pytest.mark.unhurried
@pytest.mark.parametrize(
    "blocks, left",
    [
        ([("repeated_complex", 2, 2), ("full", 1, 1)], 1e-3),
        ([("repeated_real", 2, 2), ("full", 2, 2)], 1e-3),
        # 5000 nodes leave 0.40 % there.
        pytest.param([("repeated_real", 1, 1), ("repeated_complex", 2, 2)], 5e-3, marks=TWO_BLOCKS),
    ],
    ids=["complex+full", "real+full", "real+complex"],
)
def test_mixed_blocks_never_exceed_the_truth(blocks, left):
    rng = np.random.default_rng(4)
    problem, nu, w = made_from_truth(rng, 2, blocks, p12=True)
    gamma = np.linalg.norm(w) * 1.001
    s = lft.optimum(problem, gamma, np.ones(len(blocks)), gap=5e-4)
    assert s.lower <= s.upper <= np.sum(nu**2) * (1 + 1e-5)
    assert s.upper - s.lower <= left * s.upper
    substitute(problem, s, gamma)
    m = lft.margin(problem, nu, np.abs(w))
    assert m.upper <= 1 + 1e-5 and m.upper - m.lower <= 1e-3 * m.upper


def test_margin_scales_with_its_bounds_and_stays_below_the_truth():
    problem, nu, w = made_from_truth(np.random.default_rng(8), 2, [("full", 1, 1), ("full", 3, 3)], p12=True)
    s = lft.margin(problem, nu, np.abs(w))
    assert 0 < s.lower <= s.upper <= 1 + 1e-6
    half = lft.margin(problem, 2 * nu, 2 * np.abs(w))
    assert half.upper == pytest.approx(s.upper / 2, rel=1e-4)
    assert np.all(s.nu <= s.upper * nu * (1 + 1e-6)) and np.all(
        np.abs(s.w) <= s.upper * np.abs(w) * (1 + 1e-6)
    )


def test_lambda_w_trades_disturbance_against_perturbation():
    problem, nu, w = made_from_truth(np.random.default_rng(6), 2, [("full", 1, 1)], noise=0.5)
    gamma = np.linalg.norm(w) * 1.5
    for weight in (0.01, 0.3, 10.0):
        s = lft.optimum(problem, gamma, [1.0], np.full(2, weight))
        assert s.upper - s.lower <= 1e-3 * s.upper
        assert s.upper == pytest.approx(s.nu[0] ** 2 + weight * np.linalg.norm(s.w) ** 2, rel=1e-6)
        assert s.upper <= nu[0] ** 2 + weight * np.linalg.norm(w) ** 2


def scalar_blocks(kinds: tuple[str, ...], p11: float, p21: list, e: list) -> Lft:
    """Blocks of 1 x 1 with an input of 1 beside p11 of their own output; w reaches every output."""
    k, n_y = len(kinds), len(e)
    return Lft(
        tuple(Block(kind, 1, 1) for kind in kinds),
        np.diag([p11] * k).astype(complex),
        np.zeros((k, n_y), complex),
        np.array(p21, complex),
        np.eye(n_y, dtype=complex),
        np.ones(k, complex),
        np.array(e, complex),
    )


@pytest.mark.parametrize("lambda_w", [None, [0.0, 0.0], [2.0, 0.0], [0.0, 0.5], [1.0, 3.0]])
@pytest.mark.parametrize("lambda_nu", [0.0, 0.4, 3.0])
@pytest.mark.parametrize("gamma", [1.52, 1.56])
def test_one_scalar_with_a_constant_input_is_the_closed_trade_off(lambda_w, lambda_nu, gamma):
    z, e = [1.0, 0.5 - 1j], [1.0 + 1j, -0.7]
    least_ratio = lft.optimum(
        scalar_blocks(("full",), 0.0, [[v] for v in z], e), gamma, [lambda_nu], lambda_w
    )
    exact = s1.tradeoff(e, z, gamma, lambda_nu, [0.0, 0.0] if lambda_w is None else lambda_w)
    assert least_ratio.upper == pytest.approx(float(exact.cost), rel=1e-4, abs=1e-9)
    assert least_ratio.lower <= float(exact.cost) * (1 + 1e-9) + 1e-12


def test_a_block_without_a_price_explains_what_it_can():
    """xi_1 for nothing; where it is real, the imaginary part of e = 1 + i is left to the priced one."""
    for kind, cost in (("full", 0.0), ("repeated_complex", 0.0), ("repeated_real", 4.0)):
        problem = scalar_blocks((kind, "full"), 0.0, [[1.0, 1.0]], [1.0 + 1j])
        least_ratio = lft.optimum(problem, 0.0, [0.0, 4.0])
        assert least_ratio.upper == pytest.approx(cost, rel=1e-3, abs=1e-9)
        assert least_ratio.nu[0] > 0.9 and least_ratio.nu[1] == pytest.approx(
            np.sqrt(cost / 4), rel=1e-3, abs=1e-9
        )


def test_a_real_scalar_with_a_constant_input_stays_real():
    """e = 1 + i / 2: w takes the imaginary part, and of the real one what is left to it."""
    least_ratio = lft.optimum(scalar_blocks(("repeated_real",), 0.0, [[1.0]], [1.0 + 0.5j]), 0.8, [2.0])
    assert least_ratio.nu[0] == pytest.approx(1 - np.sqrt(0.8**2 - 0.5**2), rel=1e-3)
    assert least_ratio.upper == pytest.approx(2 * least_ratio.nu[0] ** 2, rel=1e-6)


def test_a_real_block_without_a_price_goes_as_far_as_its_cap():
    """3.5 of a cap of 4 at xi_1 = 28: what is left to the priced block is i, and what lowers its size."""
    problem = scalar_blocks(("repeated_real", "full"), 0.25, [[1.0, 1.0]], [28.0 + 1j])
    least_ratio = lft.optimum(problem, 0.0, [0.0, 1.0])
    xi = np.linspace(0.0, 1.0, 10001) + 1j
    best = np.argmin(np.abs(xi / (1 + xi / 4)))
    assert least_ratio.upper == pytest.approx(np.abs(xi / (1 + xi / 4))[best] ** 2, rel=1e-3)
    assert least_ratio.nu[0] == pytest.approx(4 - 16 / (32 - xi[best].real), rel=1e-3)


def test_parametrisation_covers_exactly_the_solutions():
    rng = np.random.default_rng(2)
    for n_w in (1, 2, 4):
        problem, _, _ = made_from_truth(rng, 2, [("full", 2, 2), ("full", 1, 1)], p12=True, n_w=n_w)
        par = parametrise(problem)
        d = par.xi_map.shape[1] - 1
        assert d == 3 + n_w - 2
        for _ in range(10):
            z = np.append(gauss(rng, d), 1.0)
            xi, w = par.xi_map @ z, par.w_map @ z
            np.testing.assert_allclose(problem.p21 @ xi + problem.p22 @ w, problem.e, atol=1e-12)
            power = np.linalg.norm(z[: par.n_phi]) ** 2 + par.b1**2
            assert np.linalg.norm(w) ** 2 == pytest.approx(power, rel=1e-10), "eq. (5)"
            np.testing.assert_allclose(
                par.eta_map @ z, problem.p11 @ xi + problem.p12 @ w + problem.eta0, atol=1e-12
            )


def test_b1_is_the_feasibility_edge():
    problem, _, _ = made_from_truth(np.random.default_rng(3), 3, [("full", 1, 1)], noise=0.4)
    b1 = parametrise(problem).b1
    assert b1 > 0
    s = lft.optimum(problem, b1, [1.0])
    assert np.linalg.norm(s.w) == pytest.approx(b1, rel=1e-8)
    with pytest.raises(InputError, match="B1"):
        lft.optimum(problem, b1 * (1 - 1e-6), [1.0])


@pytest.mark.parametrize(
    "blocks, shape",
    [
        ([("full", 1, 1), ("full", 3, 3)], {}),
        ([("full", 3, 1), ("repeated_complex", 2, 2)], {}),
        ([("full", 2, 3), ("repeated_real", 1, 1)], {"p12": True, "n_w": 5}),
        ([("repeated_real", 3, 3), ("repeated_complex", 2, 2)], {"p12": True}),
    ],
)
def test_zero_is_exactly_zero(blocks, shape):
    for seed in range(4):
        problem, _, _ = made_from_truth(np.random.default_rng(seed), 3, blocks, **shape)
        gamma = 1.01 * np.linalg.norm(np.linalg.pinv(problem.p22) @ problem.e)
        for s in (lft.optimum(problem, gamma, [1.0, 1.0]), lft.smallest_common_size(problem, gamma)):
            assert s.lower == s.upper == 0.0
            assert not np.any(s.nu) and not np.any(s.xi), "rounding in xi is no multiple of eta"
            substitute(problem, s, gamma)


def test_no_disturbance_allowed_and_none_needed():
    problem, nu, _ = made_from_truth(np.random.default_rng(3), 2, [("full", 2, 2)], noise=1e-300)
    s = lft.optimum(problem, 0.0, [1.0])
    assert np.linalg.norm(s.w) <= 1e-12 and 0 < s.upper <= nu[0] ** 2 * (1 + 1e-9)


def test_last_block_is_not_needed_when_a_repeated_one_explains_the_data():
    problem, _, w = made_from_truth(np.random.default_rng(21), 1, [("repeated_real", 2, 2), ("full", 2, 2)])
    assert lft.smallest_last_block(problem, 3 * np.linalg.norm(w)) == (0.0, 0.0)


def test_last_block_is_not_needed_when_the_disturbance_explains_all_beside_a_repeated_block():
    problem, _, _ = made_from_truth(
        np.random.default_rng(106), 4, [("repeated_real", 2, 2), ("full", 1, 1)], n_w=6, p12=True
    )
    least = np.linalg.norm(np.linalg.pinv(problem.p22) @ problem.e)
    assert lft.smallest_last_block(problem, 1.01 * least) == (0.0, 0.0)
    low, high = lft.smallest_last_block(problem, 0.6 * least)
    assert 0.0 < low <= high, "where it is needed it is not called zero"


@pytest.mark.parametrize("seed", range(4))
def test_singular_p22_fixes_the_scalar_that_makes_the_last_block_superfluous(seed):
    rng = np.random.default_rng(seed)
    blocks = [("repeated_complex", 2, 2), ("full", 1, 1)]
    made, _, _ = made_from_truth(rng, 2, blocks, gain=0.0)
    p22 = gauss(rng, 2, 1) @ gauss(rng, 1, 2)
    problem = Lft(made.blocks, made.p11, made.p12, made.p21, p22, made.eta0, made.e)
    # The inputs are constant and P22 has one dimension: where it does not reach, e fixes delta for each xi of
    # the last block, and |w| = |one - per_xi xi| is left.
    left, inverse = np.linalg.svd(p22)[0][:, 1].conj(), np.linalg.pinv(p22, rcond=1e-10)
    out, last = made.p21[:, :2] @ made.eta0[:2], made.p21[:, 2]
    one = inverse @ (made.e - out * (left @ made.e) / (left @ out))
    per_xi = inverse @ (last - out * (left @ last) / (left @ out))
    least = np.linalg.norm(one)
    assert lft.smallest_last_block(problem, least * (1 + 1e-6)) == (0.0, 0.0)
    low, high = lft.smallest_last_block(problem, 0.7 * least)
    exact = 0.3 * least / np.linalg.norm(per_xi) / abs(made.eta0[2])
    assert low <= exact * (1 + 1e-9) and high == pytest.approx(exact, rel=1e-6)


@pytest.mark.parametrize("structure", ["S2", "other"])
def test_an_optimum_of_zero_is_exactly_zero_in_every_path(structure):
    blocks = [("full", 1, 1), ("full", 3, 3)] if structure == "S2" else [("full", 2, 2), ("full", 3, 3)]
    problem, _, _ = made_from_truth(np.random.default_rng(8), 2, blocks, noise=0.4)
    p11 = np.array(problem.p11)
    if structure == "S2":
        p11[0] = 0.0  # the first block's input is the known u: the compiled kernel's shape
    problem = Lft(problem.blocks, p11, problem.p12, problem.p21, problem.p22, problem.eta0, problem.e)
    s = lft.optimum(problem, 1.4 * np.linalg.norm(problem.e), [0.085, 0.335])
    assert s.lower == s.upper == 0.0


def test_zero_in_one_unit_does_not_hide_a_size_in_another():
    # xi of 1e-7 beside w of 1e7: the least-squares point of both has a small residual, but it is not xi = 0.
    blocks = (Block("repeated_real", 1, 1),)
    one, none = np.ones((1, 1), complex), np.zeros((1, 1), complex)
    problem = Lft(
        blocks, none, none, one * (1e14 + 3e13j), one, np.array([1.0 + 2.0j]), np.array([2e7 + 1e7j])
    )
    s = lft.margin(problem, [1e-7], [1e7])
    # |e - P21 delta eta0| <= t 1e7 with a real delta: least over a fine grid.
    delta = np.linspace(-4e-7, 4e-7, 400001)
    t = np.maximum(
        np.abs(delta) / 1e-7, np.abs(problem.e[0] - problem.p21[0, 0] * delta * problem.eta0[0]) / 1e7
    )
    assert 0.1 < s.lower <= t.min() * (1 + 1e-9) and s.upper == pytest.approx(t.min(), rel=1e-4)


@pytest.mark.parametrize("block_type", ["repeated_real", "repeated_complex"])
def test_a_repeated_block_without_freedom_is_recovered(block_type):
    for seed in range(4):
        problem, nu, w = made_from_truth(
            np.random.default_rng(seed), 3, [(block_type, 1, 1)], p12=True, n_w=2
        )
        s = lft.optimum(problem, 2 * np.linalg.norm(w), [1.0])
        substitute(problem, s)
        assert s.nu[0] == pytest.approx(nu[0], rel=1e-9), "M is square: one explanation"


@pytest.mark.parametrize("weight", [1e4, 1e12, 1e26])
def test_a_weight_on_one_block_does_not_hide_the_cost_of_another(weight):
    problem, _, _ = made_from_truth(np.random.default_rng(0), 2, [("full", 2, 2), ("full", 2, 2)], gain=0.0)
    gamma = 0.3 * np.linalg.norm(problem.e)
    second = Lft(
        problem.blocks[1:],
        problem.p11[2:, 2:],
        problem.p12[2:],
        problem.p21[:, 2:],
        problem.p22,
        problem.eta0[2:],
        problem.e,
    )
    alone, s = lft.optimum(second, gamma, [1.0]), lft.optimum(problem, gamma, [weight, 1.0])
    # The first block becomes too dear to use: what is left is the problem without it.
    assert s.lower <= alone.upper and s.upper >= alone.lower * (1 - 2e-3)


@pytest.mark.unhurried
@pytest.mark.parametrize("unit", [1.0, 1e-5])
def test_the_last_block_is_zero_only_where_a_zero_was_found(unit):
    # The least-squares point breaks the real block, so the search starts without a cost to compare zero with.
    problem, nu, w = made_from_truth(np.random.default_rng(0), 4, [("full", 3, 2), ("repeated_real", 2, 2)])
    u = np.diag([1, 1, 1, unit, unit])
    problem = Lft(
        problem.blocks, problem.p11 @ u, problem.p12, problem.p21 @ u, problem.p22, problem.eta0, problem.e
    )
    gamma = 1.001 * np.linalg.norm(w)
    low, high = lft.smallest_last_block(problem, gamma)
    assert 0.1 < low * unit <= high * unit <= nu[1] and high - low <= 1e-3 * high
    # The first block is smaller there, so the least common size is that very number.
    known = lft.optimum(problem, gamma, [1.0, unit**2])
    common = lft.smallest_common_size(problem, gamma, known=known)
    assert np.sqrt(common.lower) <= high * (1 + 1e-6) and np.sqrt(common.upper) >= low * (1 - 1e-6)


def test_a_certificate_does_not_rest_on_rounding():
    # Form 1 forces nothing; a free multiplier of 1e9 leaves rounding errors above the matrix that it should
    # lift.
    rng = np.random.default_rng(3)
    a = gauss(rng, 4, 4)
    cross = a + a.conj().T
    weak = 1e-9 * np.eye(4)
    y = np.array([1.0, 1e9, -1e9])
    forms = np.array([weak, cross, cross * (1 + 1e-18)])
    assert lmi.rounding(y, forms) > 1e-9
    slopes = np.eye(4)[None] * 1e-12
    assert lmi.reach(weak, slopes)[0] > 0 and lmi.reach(weak, slopes, lmi.rounding(y, forms))[0] == 0
    assert lmi.rounding(np.array([1.0, 0.0, 0.0]), forms) < 1e-23


@pytest.mark.slow("6 s: boxes of two repeated blocks")
def test_repeated_blocks_are_settled_by_boxes():
    rng = np.random.default_rng(4)
    problem, nu, w = made_from_truth(rng, 3, [("repeated_real", 2, 2), ("repeated_real", 3, 3)])
    s = lft.optimum(problem, 1.001 * np.linalg.norm(w), [1.0, 1.0], 0.01 * np.ones(3), gap=4e-4)
    assert s.upper - s.lower <= 1e-3 * s.upper
    assert s.nodes <= 1500, "with a direction for each size it takes 2759"
    assert s.upper <= np.sum(nu**2) + 0.01 * np.linalg.norm(w) ** 2 * (1 + 1e-3)
    substitute(problem, s, 1.001 * np.linalg.norm(w))


@pytest.mark.unhurried
@pytest.mark.parametrize(
    "blocks",
    [
        [("repeated_complex", 2, 2)],
        pytest.param([("repeated_real", 2, 2), ("repeated_complex", 2, 2)], marks=TWO_BLOCKS),
        pytest.param([("full", 1, 2), ("repeated_complex", 2, 2)], marks=TWO_BLOCKS),
    ],
)
def test_the_tangent_bounds_every_point_of_its_box(blocks):
    """The cost of no point made inside the box is below the bound; halving the box more than halves the
    loss."""
    rng = np.random.default_rng(12)
    problem, nu, w = made_from_truth(rng, 3, blocks, p12=True)
    gamma = 1.1 * np.linalg.norm(w)
    lambda_w = 0.3 * np.sum(nu**2) / np.linalg.norm(w) ** 2 * np.ones(3)
    s = lft.optimum(problem, gamma, np.ones(len(blocks)), lambda_w, gap=4e-4)
    scaled = scaled_problem(problem, gamma)
    forms = ball(scaled, gamma) + [block_form(scaled, i, param=i) for i in range(len(blocks))]
    forms.append(Form(np.sqrt(lambda_w)[:, None] * scaled.w, scaled.t, param=len(blocks)))
    search = Quadratic(forms, len(blocks) + 1, scaled.n)
    at = {k: complex(s.verification.deltas[k - 1][0, 0]) for k in search.repeated}
    rays = np.eye(len(blocks) + 1)[[p for p in range(len(blocks) + 1) if p not in search.boxed]]
    losses = []
    for half in (0.02, 0.01, 0.005):
        boxes = {}
        for k, c in at.items():
            side = half * (1.0 if search.forms[k].repeated == "repeated_real" else 1 + 1j)
            boxes[k] = Box(c - side, c + side)
        bound = Relaxation(search).tangent(BranchNode(0.0, 0, rays, boxes), np.inf)
        # The optimum lies in the box, and so do the nearby points below.
        assert bound.lower <= s.upper * (1 + 1e-9)
        losses.append(bound.centre - bound.box)
        for _ in range(20):
            scalars = {
                k: complex(
                    rng.uniform(b.low.real, b.high.real),
                    rng.uniform(b.low.imag, b.high.imag) if b.high.imag > b.low.imag else 0.0,
                )
                for k, b in boxes.items()
            }
            projected = search.on_subspace(scaled.points(s)[0], scalars)
            z = search.repair(projected[0]) if projected is not None else None
            if z is not None:
                assert search.cost(z) >= bound.lower * (1 - 1e-9)
    assert losses[2] < 0.5 * losses[1] < 0.25 * losses[0]


def test_units_of_a_block_do_not_change_the_answer():
    problem, _, w = made_from_truth(np.random.default_rng(22), 2, [("full", 2, 2), ("full", 1, 1)])
    unit = np.diag([1e5, 1e5, 1e-4])
    other = Lft(
        problem.blocks,
        problem.p11 @ unit,
        problem.p12,
        problem.p21 @ unit,
        problem.p22,
        problem.eta0,
        problem.e,
    )
    gamma = np.linalg.norm(w)
    base, scaled = lft.optimum(problem, gamma, [1.0, 1.0]), lft.optimum(other, gamma, [1e10, 1e-8])
    assert scaled.upper == pytest.approx(base.upper, rel=1e-6) and scaled.lower == pytest.approx(
        base.lower, rel=1e-4
    )


def test_e_outside_the_image_of_m_is_named():
    problem, _, _ = made_from_truth(np.random.default_rng(3), 2, [("full", 1, 1)], n_w=1)
    bad = Lft(problem.blocks, problem.p11, problem.p12, 0 * problem.p21, problem.p22, problem.eta0, problem.e)
    with pytest.raises(InputError, match="not in Im"):
        lft.optimum(bad, 10.0, [1.0])


def test_a_size_at_the_cap_is_never_returned_as_a_bound():
    # e needs xi = e / p21 on a block whose loop gain is 1 / nu: only a singular loop gets there.
    block = (Block("full", 2, 2),)
    rng = np.random.default_rng(1)
    problem = Lft(
        block,
        10.0 * np.eye(2, dtype=complex),
        np.zeros((2, 2), complex),
        np.eye(2, dtype=complex),
        np.eye(2, dtype=complex),
        0.01 * gauss(rng, 2),
        np.array([1.0 + 0j, -1.0]),
    )
    assert block_caps(problem)[0] == pytest.approx(0.1)
    solution = None
    try:
        solution = lft.optimum(problem, 0.01, [1.0])
    except InputError as exc:
        assert "cap" in str(exc)
    if solution is not None:
        assert solution.nu[0] < 0.1
    assert not well_posed(problem, np.array([0.1]))
    assert well_posed(problem, np.array([0.0999]))


@pytest.mark.parametrize("block_type", ["full", "repeated_complex", "repeated_real"])
def test_well_posedness_is_that_of_the_structure(block_type):
    # delta P11 is singular at 1 / delta = an eigenvalue: 2j for any scalar, 0.5 for a real one, |P11| for a
    # full block.
    turn = np.linalg.qr(gauss(np.random.default_rng(3), 3, 3))[0]
    p11 = turn @ np.array([[2j, 4.0, 0.0], [0.0, 0.5, 3.0], [0.0, 0.0, 0.1]]) @ turn.conj().T
    cap = {"full": 1 / np.linalg.norm(p11, 2), "repeated_complex": 0.5, "repeated_real": 2.0}[block_type]
    zero, one = np.zeros((3, 3), complex), np.ones(3, complex)
    problem = Lft((Block(block_type, 3, 3),), p11, zero, np.eye(3) + zero, np.eye(3) + zero, one, one)
    assert well_posed(problem, np.array([0.98 * cap]))
    assert not well_posed(problem, np.array([1.0001 * cap]))


def test_a_block_without_input_cannot_explain():
    zero = np.zeros((1, 1), complex)
    silent = Lft(
        (Block("full", 1, 1),),
        zero,
        np.zeros((1, 1), complex),
        np.ones((1, 1), complex),
        np.ones((1, 1), complex),
        np.zeros(1, complex),
        np.ones(1, complex),
    )
    with pytest.raises(InputError, match=r"zero|B1|no Delta"):
        lft.optimum(silent, 0.5, [1.0])
    assert lft.optimum(silent, 1.1, [1.0]).upper == 0.0


@pytest.mark.parametrize(
    "change, word", [({"p11": np.zeros((3, 3))}, "p11"), ({"eta0": np.array([np.nan])}, "eta0")]
)
def test_shapes_and_values_are_named(change, word):
    parts = {
        "p11": np.zeros((1, 1)),
        "p12": np.zeros((1, 1)),
        "p21": np.ones((1, 1)),
        "p22": np.ones((1, 1)),
        "eta0": np.ones(1),
        "e": np.ones(1),
    }
    with pytest.raises(InputError, match=word):
        Lft((Block("full", 1, 1),), **(parts | change))


def test_bad_blocks_are_named():
    for bad in (("round", 1, 1), ("full", 0, 1), ("repeated_real", 2, 1)):
        with pytest.raises(InputError):
            Block(*bad)


def test_delta_is_verified_before_it_is_returned():
    problem, _, _ = made_from_truth(np.random.default_rng(5), 2, [("full", 1, 1), ("full", 2, 2)], p12=True)
    s = lft.optimum(problem, 0.11, [1.0, 1.0])
    dl.verify(problem.blocks, problem.matrices, problem.e, s.w, s.xi, s.nu)
    with pytest.raises(InputError, match="size"):
        dl.verify(problem.blocks, problem.matrices, problem.e, s.w, s.xi, 0.9 * s.nu)
    with pytest.raises(InputError, match="re-simulated"):
        dl.verify(problem.blocks, problem.matrices, problem.e, s.w, 1.1 * s.xi, 2 * s.nu)
    with pytest.raises(InputError, match="an eta that is not zero"):
        dl.construct(Block("full", 1, 1), np.ones(1), np.zeros(1))
