"""The kernel for one block beside a quadratic cost, against branch and bound; the size of a last block by
hand; and the forms that each question puts to branch and bound."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from lft_problems import gauss, made_from_truth, row
from lpvguard.base.errors import InputError
from lpvguard.engine.blocks import Block
from lpvguard.engine.validation import lft
from lpvguard.engine.validation.branch import SLACK, Interval
from lpvguard.engine.validation.problem import Lft
from lpvguard.engine.validation.quadratic import Form, Quadratic
from lpvguard.engine.validation.scaled_problem import EDGE, ROUNDING, ScaledProblem, scaled_problem
from lpvguard.engine.validation.well_posed import block_caps

SHAPES = [([("full", 1, 1)], {}), ([("full", 2, 3)], {}), ([("full", 2, 1)], {"p12": True, "n_w": 3})]


def asked_for(monkeypatch, problem: Lft, gamma: float, lambda_nu, lambda_w):
    """The optimum without the kernel, and what the kernel would have been asked."""
    asked: list[tuple[Quadratic, np.ndarray, ScaledProblem]] = []
    with monkeypatch.context() as patched:
        patched.setattr(lft, "_one_block", lambda *arguments: asked.append(arguments))
        return lft.optimum(problem, gamma, lambda_nu, lambda_w), asked[0]


@pytest.mark.parametrize("blocks, options", SHAPES)
@pytest.mark.parametrize("unit", [1e-3, 1.0, 1e3])
def test_the_kernel_finds_what_branch_and_bound_finds(blocks, options, unit, monkeypatch):
    problem, _, w = made_from_truth(np.random.default_rng(4), 2, blocks, noise=0.5, **options)
    problem = replace(problem, e=unit * problem.e, p21=unit * problem.p21)
    gamma, lambda_w = 1.5 * unit * np.linalg.norm(w), np.linspace(0.3, 2.0, len(w)) / unit**2
    want, (quadratic, caps, scaled) = asked_for(monkeypatch, problem, gamma, [1.7], lambda_w)
    blocks_bound = lft._one_block(quadratic, caps, scaled)
    assert blocks_bound.upper == pytest.approx(want.upper, rel=1e-6)
    assert (1 - 2e-4) * want.upper <= blocks_bound.lower <= want.upper * (1 + 1e-9)
    assert 1 < blocks_bound.nodes < 100, "evaluations of the dual"
    monkeypatch.setattr(lft, "minimise", None)  # not asked where the kernel is near enough
    again = lft.optimum(problem, gamma, [1.7], lambda_w)
    assert (again.lower, again.upper) == (blocks_bound.lower * (1 - SLACK), blocks_bound.upper)


def test_branch_and_bound_takes_over_where_the_kernel_is_not_near_enough(monkeypatch):
    problem, *_ = made_from_truth(np.random.default_rng(4), 2, [("full", 1, 1)], noise=0.5)
    want, (quadratic, caps, scaled) = asked_for(monkeypatch, problem, 0.75, [1.7], [1.0, 1.0])
    blocks_bound = lft._one_block(quadratic, caps, scaled)
    for apart, takes_over in ((1.99e-4, False), (2.01e-4, True)):
        far = replace(blocks_bound, lower=blocks_bound.upper * (1 - apart))
        monkeypatch.setattr(lft, "_one_block", lambda *_, far=far: far)
        again = lft.optimum(problem, 0.75, [1.7], [1.0, 1.0])
        assert again.lower == (want.lower if takes_over else far.lower * (1 - SLACK))
    half = replace(blocks_bound, lower=0.5, upper=1.0)
    monkeypatch.setattr(lft, "_one_block", lambda *_: half)
    monkeypatch.setattr(lft, "proves", lambda *_: True)
    monkeypatch.setattr(lft, "minimise", None)  # not asked: twice the gap to the digit is near enough
    assert lft.optimum(problem, 0.75, [1.7], [1.0, 1.0], gap=0.25).lower == 0.5 * (1 - SLACK)


def test_a_size_near_its_cap_is_left_to_branch_and_bound(monkeypatch):
    """The kernel's p over its limit is the square of the block's size over its cap."""
    problem, _, w = made_from_truth(np.random.default_rng(4), 2, [("full", 1, 1)], noise=0.5)
    want, (quadratic, _, scaled) = asked_for(monkeypatch, problem, 1.5 * np.linalg.norm(w), [1.7], [1.0, 1.0])
    solved, solve = [], lft.s2.solve_forms
    monkeypatch.setattr(
        lft.s2, "solve_forms", lambda *a: solved.append((a[2], solve(*a))) or replace(solved[-1][1], **named)
    )
    named: dict[str, np.ndarray] = {}
    cap = 3.0 * want.nu
    assert lft._one_block(quadratic, cap, scaled) is not None
    p_max, out = solved[0]
    block, z = quadratic.forms[1], out.z[0]
    size = np.linalg.norm(block.a @ z) / np.linalg.norm(block.b @ z)
    assert out.p[0] / p_max == pytest.approx((size / cap[0]) ** 2 * (1 + 1e-9), rel=1e-10)
    near = lft.s2.NEAR_CAP**2 * p_max
    for p, upper, left_alone in (
        (near * (1 - 1e-12), 1.0, False),
        (near, 1.0, False),
        (near * (1 + 1e-12), 1.0, True),
        (near / 2, np.inf, True),
    ):
        named = {"p": np.array([p]), "upper": np.array([upper])}
        assert (lft._one_block(quadratic, cap, scaled) is None) == left_alone
    named = {}
    assert lft._one_block(quadratic, 0.9 * want.nu, scaled) is None


def test_the_cap_is_that_of_the_block_whose_input_varies(monkeypatch):
    """The first block has a constant input: its cost is a quadratic one."""
    problem, *_ = made_from_truth(np.random.default_rng(5), 2, [("full", 1, 1), ("full", 1, 1)], noise=0.5)
    problem = replace(problem, p11=np.diag([0.0, 0.3]).astype(complex))
    want, (quadratic, _, scaled) = asked_for(monkeypatch, problem, 0.3, [1.7, 0.6], None)
    blocks_bound = lft._one_block(quadratic, np.array([1e-6, np.inf]), scaled)
    assert blocks_bound.upper == pytest.approx(want.upper, rel=1e-6)
    assert lft._one_block(quadratic, np.array([np.inf, 1e-6]), scaled) is None


def test_what_is_no_problem_of_the_kernel_is_left_alone(monkeypatch):
    problem, _, w = made_from_truth(np.random.default_rng(4), 2, [("full", 1, 1)], noise=0.5)
    gamma, size_e = 1.5 * np.linalg.norm(w), np.linalg.norm(problem.e)
    _, (quadratic, caps, scaled) = asked_for(monkeypatch, problem, gamma, [1.7], [1.0, 1.0])
    ball, block, cost = quadratic.forms
    n = quadratic.n

    def left_alone(*forms: Form) -> bool:
        return lft._one_block(Quadratic(forms, 2, forms[0].a.shape[1]), caps, scaled) is None

    assert not left_alone(ball, block, cost)
    assert left_alone(ball, block) and left_alone(ball, block, cost, ball)
    assert left_alone(ball, replace(block, repeated="repeated_complex"), cost)
    assert left_alone(replace(ball, constant=1e-12), block, cost), "no point within the ball"
    with np.errstate(all="raise"):
        assert left_alone(ball, replace(block, b=0 * block.b), cost), "a first point of endless size"
    free, wide = replace(cost, a=0 * cost.a, parts=()), replace(ball, constant=(1.1 * size_e) ** 2)
    assert left_alone(wide, block, free), "w alone explains e for nothing"
    fixed = (replace(f, a=f.a[:, -1:], b=f.b[:, -1:], parts=()) for f in (ball, block, cost))
    assert left_alone(*fixed), "nothing is free"
    for most, alone in ((n, False), (n - 1, True)):
        monkeypatch.setattr(lft.s2, "MAX_N", most)
        assert left_alone(ball, block, cost) == alone


def test_the_kernel_gets_each_form_in_a_unit_of_its_own(monkeypatch):
    """|3 x|^2 <= 4 |3|^2, |2 x + 2|^2 <= p / 2 and |5 x|^2 <= p' |2|^2: at x = 0 the cost is p = 8."""
    block = Form(row(2, 2), row(0, 1), param=0, slope=0.5)
    ball, cost = Form(row(3, 0), row(0, 3), constant=4.0), Form(row(5, 0), row(0, 2), param=1)
    asked = []

    def kernel(*arguments):
        asked.append(arguments)
        raise Asked

    monkeypatch.setattr(lft.s2, "solve_forms", kernel)
    with pytest.raises(Asked):
        lft._one_block(Quadratic([ball, block, cost], 2, 2), np.array([3.0]), SimpleNamespace(xi=[block.a]))
    [(forms, start, p_max)] = asked
    first = 2.0**2 / 0.5  # the size at x = 0, where the cost is nothing
    np.testing.assert_array_equal(start, [[0.0, 1.0]])
    assert p_max == pytest.approx(9 / (0.5 * first) * (1 - 1e-9), rel=1e-12)
    np.testing.assert_allclose(forms[0, 0], np.diag([25 / (4 * first), 0]), rtol=1e-12)
    np.testing.assert_allclose(forms[0, 1], np.diag([1 / 4 / (1 + 1e-12), -1]), rtol=1e-14)
    np.testing.assert_allclose(forms[0, 2], np.full((2, 2), 0.5), rtol=1e-12)
    np.testing.assert_allclose(forms[0, 3], np.diag([0, 0.5 * first / 8]), rtol=1e-12)


# --- the size of the last block ---


def beside_the_last(first: Block, p11, p21, p22, e) -> Lft:
    """A first block, and a last one of 1 x 1; both have an input of 1 beside ``p11``."""
    k = first.cols + 1
    p11, p21, p22, e = (np.array(v, complex) for v in (p11, p21, p22, e))
    n_w = p22.shape[1]
    return Lft((first, Block("full", 1, 1)), p11, np.zeros((k, n_w)), p21, p22, np.ones(k, complex), e)


def test_a_last_block_without_input_that_nothing_asks_for_has_size_zero(monkeypatch):
    monkeypatch.setattr(lft, "minimise", None)  # not asked
    problem = beside_the_last(Block("full", 1, 1), np.zeros((2, 2)), [[1, 1]], [[1]], [2.0])
    problem = replace(problem, eta0=np.array([1.0, 0.0], complex))
    assert lft.smallest_last_block(problem, 0.5) == (0.0, 0.0)


def test_a_last_block_at_its_cap_is_refused_and_below_it_is_not():
    """xi = 2 over 1 + g xi is beyond the cap 1 / |g| where g xi is below - 1 / 2."""
    for g, fits in ((0.1, True), (-0.2, True), (-0.3, False)):
        p11, p21, p22 = np.diag([0, g]), np.eye(2), np.zeros((2, 1))
        problem = beside_the_last(Block("full", 1, 1), p11, p21, p22, [1.0, 2.0])
        if fits:
            size = abs(2 / (1 + 2 * g))
            assert lft.smallest_last_block(problem, 0.0) == pytest.approx((size, size), rel=1e-3)
        else:
            with pytest.raises(InputError, match=r"block 2: needs 5, which is at or above its cap 3\.33333"):
                lft.smallest_last_block(problem, 0.0)


def test_a_last_block_of_exactly_its_cap_is_refused(monkeypatch):
    problem = beside_the_last(
        Block("full", 1, 1), np.diag([0, 0.25]), np.eye(2), np.zeros((2, 1)), [1.0, 2.0]
    )
    for upper, fits in ((15.9, True), (16.0, False)):
        answer = Interval(1.0, upper, None, 1)
        monkeypatch.setattr(lft, "minimise", lambda *a, answer=answer: answer)
        if fits:
            assert lft.smallest_last_block(problem, 0.0) == (1.0, np.sqrt(upper))
        else:
            with pytest.raises(InputError, match="at or above its cap 4"):
                lft.smallest_last_block(problem, 0.0)


def test_a_last_block_that_the_data_need_beside_a_real_one_has_its_size():
    """e_2 is the last block's alone; of e_1 = 1 + i the real block takes what is real."""
    real = Block("repeated_real", 1, 1)
    alone = beside_the_last(real, np.zeros((2, 2)), [[1, 0], [0, 1]], [[1], [0]], [0.5, 0.7])
    assert lft.smallest_last_block(alone, 1.0) == pytest.approx((0.7, 0.7), rel=1e-3)
    shared = beside_the_last(real, np.zeros((2, 2)), [[1, 1]], [[1]], [1.0 + 1j])
    for gamma, size in ((0.4, 0.6), (1.1, 0.0)):
        assert lft.smallest_last_block(shared, gamma) == pytest.approx((size, size), rel=1e-3, abs=1e-6)


def test_a_real_block_beside_the_last_goes_as_far_as_its_cap():
    """3.5 of a cap of 4, as xi_1 = 28 over 1 + 28 / 4; then i is left to w and the last block."""
    real = Block("repeated_real", 1, 1)
    problem = beside_the_last(real, np.diag([0.25, 0]), [[1, 1]], [[1]], [28.0 + 1j])
    for gamma, size in ((0.4, 0.6), (1.1, 0.0)):
        assert lft.smallest_last_block(problem, gamma) == pytest.approx((size, size), rel=1e-3, abs=1e-6)


def three(first: str, p11: list[float], e: complex) -> Lft:
    """A first block, a real one and the last, all of 1 x 1 with an input of 1; e is the sum of all and w."""
    blocks = tuple(Block(kind, 1, 1) for kind in (first, "repeated_real", "full"))
    one, none = np.ones((1, 3), complex), np.zeros((3, 1), complex)
    eta0, e_ = np.ones(3, complex), np.array([e])
    return Lft(blocks, np.diag(p11).astype(complex), none, one, np.ones((1, 1), complex), eta0, e_)


def test_two_blocks_beside_the_last_explain_what_they_can_together():
    """A full block takes all of e, however large; two real ones leave the imaginary part."""
    for first, size in (("full", 0.0), ("repeated_real", 0.6)):
        lower, upper = lft.smallest_last_block(three(first, [0.0, 0.0, 0.0], 2.0 + 1j), 0.4)
        assert lower <= upper == pytest.approx(size, rel=1e-3, abs=1e-6)
    # Beyond the cap of a full block too: it is asked for no certificate here.
    far = three("full", [0.25, 0.0, 0.0], -10.0 + 1j)
    assert lft.smallest_last_block(far, 0.4) == (0.0, 0.0)


def is_free(problem: Lft, gamma: float) -> bool:
    return lft._last_block_is_free(problem, gamma, 1e-4, 2000)


def test_a_last_block_is_free_where_a_real_one_within_its_cap_leaves_no_more_than_w():
    """A cap of 4: xi_1 = 28 is 3.5 of its input 8, and xi_1 = -20 would be 5 of -4."""
    real = Block("repeated_real", 1, 1)
    for e, free in ((28.0, True), (-20.0, False)):
        problem = beside_the_last(real, np.diag([0.25, 0]), [[1, 1]], [[1]], [e + 1j])
        assert is_free(problem, 1.1) == free and not is_free(problem, 0.9)
    assert lft.smallest_last_block(problem, 1.1)[1] > 10.0
    # i is left, and w may be so large but for rounding.
    plain = beside_the_last(real, np.zeros((2, 2)), [[1, 1]], [[1]], [2.0 + 1j])
    assert is_free(plain, 1.0 + 1e-14) and not is_free(plain, 1.0 - 0.3e-9)


def test_a_last_block_is_free_where_w_is_all_that_the_data_leave_it():
    """e_2 is w's alone, and w has no more: one point, to a billionth."""
    real, p21 = Block("repeated_real", 1, 1), [[1, 1], [0, 0]]
    for e, free in ((2.0, True), (2.0 + 0.5j, False)):
        problem = beside_the_last(real, np.zeros((2, 2)), p21, np.eye(2), [e, 1.0])
        assert is_free(problem, 1.0 - 0.4e-9) == free


def test_blocks_that_are_not_repeated_have_no_cap_beside_the_last():
    assert is_free(three("full", [0.25, 0.0, 0.0], -10.0 + 1j), 0.4)
    assert not is_free(three("repeated_real", [0.0, 0.0, 0.0], 2.0 + 1j), 0.4)
    full = Block("full", 1, 1)
    problem = beside_the_last(full, np.diag([0.25, 0]), np.eye(2), np.zeros((2, 1)), [-10.0, 0.7])
    assert lft.smallest_last_block(problem, 0.0) == pytest.approx((0.7, 0.7), rel=1e-3)


def test_the_margin_of_disturbances_alone_is_the_largest_of_them():
    problem = beside_the_last(Block("full", 1, 1), np.zeros((2, 2)), np.zeros((2, 2)), np.eye(2), [3.0, 4j])
    t = lft.margin(problem, [1.0, 1.0], [1.0, 2.0])
    assert (t.lower, t.upper) == pytest.approx((3.0, 3.0), rel=1e-3)


# --- what branch and bound is asked ---

KINDS = (
    Block("full", 1, 1),  # of a constant input
    Block("full", 1, 2),  # of no input
    Block("full", 2, 1),
    Block("repeated_complex", 2, 2),
    Block("repeated_real", 2, 2),  # of a constant input
    Block("repeated_real", 2, 2),  # of no input
)


def of_all_kinds(*order: int) -> Lft:
    """The blocks of `KINDS` in this order; two disturbances for three outputs."""
    rng, blocks = np.random.default_rng(31), [KINDS[k] for k in order]
    q, p = sum(b.cols for b in blocks), sum(b.rows for b in blocks)
    p11, p12, eta0 = 0.2 * gauss(rng, q, p), 0.2 * gauss(rng, q, 2), gauss(rng, q)
    ends = np.cumsum([b.cols for b in blocks])
    for k, block, end in zip(order, blocks, ends, strict=True):
        own = slice(end - block.cols, end)
        if k in (0, 1, 4, 5):
            p11[own], p12[own] = 0.0, 0.0
        if k in (1, 5):
            eta0[own] = 0.0
    return Lft(tuple(blocks), p11, p12, gauss(rng, 3, p), gauss(rng, 3, 2), eta0, gauss(rng, 3))


class Asked(Exception):
    """In place of a search."""


def question(monkeypatch, ask, *arguments, **named):
    """(Quadratic, further arguments) of the search that ``ask`` begins; how often the kernel was tried."""
    tried, seen = [], []

    def search(*arguments, **more):
        seen.append((arguments, more))
        raise Asked

    with monkeypatch.context() as patched:
        patched.setattr(lft, "_one_block", lambda *a: tried.append(a))
        patched.setattr(lft, "minimise", search)
        with pytest.raises(Asked):
            ask(*arguments, **named)
    [((quadratic, *rest), more)] = seen
    return quadratic, rest, more, len(tried)


def bounds_of(quadratic: Quadratic) -> list[tuple[float, int, float, str | None]]:
    return [(f.constant, f.param, pytest.approx(f.slope), f.repeated) for f in quadratic.forms]


def test_each_priced_block_has_a_size_and_those_of_constant_input_share_one(monkeypatch):
    problem = of_all_kinds(0, 1, 2, 3, 4, 5)
    scaled, caps = scaled_problem(problem, 0.8), block_caps(problem)
    assert scaled.dead == [1, 5] and scaled.constant_eta(0) and scaled.constant_eta(4)
    ball = (pytest.approx(0.64), -1, 1.0, None)
    asked, _, more, tried = question(
        monkeypatch, lft.optimum, problem, 0.8, [0.5, 1.0, 0.5, 4.0, 3.0, 1.0], [0.0, 9.0], gap=0.1
    )
    assert more == {"gap": 0.1} and asked.params == 4 and tried == 0
    sizes = [(0.0, 0, 2.0, None), (0.0, 1, 0.25, "repeated_complex"), (0.0, 2, 1 / 3, "repeated_real")]
    assert bounds_of(asked) == [ball, *sizes, (0.0, 3, 1.0, None)]
    for form, i in zip(asked.forms[1:4], (2, 3, 4), strict=True):
        np.testing.assert_array_equal(form.a, scaled.xi[i])
        np.testing.assert_array_equal(form.b, scaled.eta[i])
    # 9 |w_2|^2 + 0.5 |xi_1|^2 / |eta_1|^2, over |t|^2.
    shared, z = asked.forms[4], np.append(gauss(np.random.default_rng(2), scaled.n - 1), 1.0)
    xi, eta, w = scaled.signals(z)
    cost = 9 * abs(w[1]) ** 2 + 0.5 * abs(xi[0]) ** 2 / abs(eta[0]) ** 2
    over = np.linalg.norm(shared.b @ z) ** 2
    assert np.linalg.norm(shared.a @ z) ** 2 / over == pytest.approx(cost, rel=1e-9)
    assert over == pytest.approx(abs((scaled.t @ z)[0]) ** 2)
    assert [len(part) for part in shared.parts] == [2, 1]
    # Without a price a repeated block has its cap, and a full one nothing.
    free, _, _, tried = question(monkeypatch, lft.optimum, problem, 0.8, np.zeros(6))
    capped = [(pytest.approx(caps[3] ** 2), -1, 1.0, "repeated_complex"), (np.inf, -1, 1.0, "repeated_real")]
    assert bounds_of(free) == [ball, *capped] and free.params == 1 and tried == 0
    one, *_ = question(monkeypatch, lft.optimum, problem, 0.8, [0.0, 0.0, 0.5, 0.0, 0.0, 0.0])
    assert bounds_of(one) == [ball, sizes[0], *capped] and one.params == 1


def test_the_kernel_is_tried_with_one_size_beside_a_plain_cost_alone(monkeypatch):
    problem = of_all_kinds(0, 1, 2, 3, 4, 5)
    for lambda_nu, lambda_w, tried in (
        ([1.0, 0.0, 1.0, 0.0, 0.0, 0.0], None, 1),
        ([0.0, 0.0, 1.0, 0.0, 0.0, 0.0], [1.0, 0.0], 1),
        ([0.0, 0.0, 1.0, 1.0, 0.0, 0.0], None, 0),
        ([0.0, 0.0, 0.0, 0.0, 0.0, 0.0], [1.0, 1.0], 0),
        ([1.0, 0.0, 1.0, 1.0, 0.0, 0.0], None, 0),
    ):
        assert question(monkeypatch, lft.optimum, problem, 0.8, lambda_nu, lambda_w)[3] == tried


def test_the_margin_asks_for_a_size_over_each_bound(monkeypatch):
    problem = of_all_kinds(0, 1, 2, 3, 4, 5)
    asked, rest, more, _ = question(
        monkeypatch, lft.margin, problem, [2.0, 1.0, 0.5, 4.0, 3.0, 1.0], [0.3, 7.0], gap=0.1
    )
    assert not rest and more == {"gap": 0.2} and asked.params == 1
    kinds = [None, None, "repeated_complex", "repeated_real"]
    slopes = [0.09, 49.0, 4.0, 0.25, 16.0, 9.0]
    assert bounds_of(asked) == [(0.0, 0, s, k) for s, k in zip(slopes, [None, None, *kinds], strict=True)]
    scaled = ScaledProblem(problem, np.array([0.3, 7.0]))
    for j in range(2):
        np.testing.assert_array_equal(asked.forms[j].a, scaled.w[j : j + 1])
        np.testing.assert_array_equal(asked.forms[j].b, scaled.t)


def test_the_common_size_asks_for_one_size_of_all_blocks_and_begins_at_what_is_known(monkeypatch):
    problem = of_all_kinds(0, 1, 2, 3, 4, 5)
    known = [np.ones(3)]
    monkeypatch.setattr(
        ScaledProblem, "points", lambda self, solution: known if solution == "found before" else []
    )
    asked, rest, more, _ = question(
        monkeypatch, lft.smallest_common_size, problem, 0.8, gap=0.1, max_nodes=7, known="found before"
    )
    assert rest == [0.1, 7] and more == {"points": known} and asked.params == 1
    kinds = [None, None, "repeated_complex", "repeated_real"]
    assert bounds_of(asked) == [(pytest.approx(0.64), -1, 1.0, None), *((0.0, 0, 1.0, k) for k in kinds)]


def test_the_last_blocks_size_is_asked_beside_the_caps_of_repeated_ones(monkeypatch):
    problem = of_all_kinds(0, 3, 1, 4, 5, 2)
    caps, known = block_caps(problem), [np.ones(3)]
    monkeypatch.setattr(
        ScaledProblem, "points", lambda self, solution: known if solution == "found before" else []
    )
    capped = [(pytest.approx(caps[1] ** 2), -1, 1.0, "repeated_complex"), (np.inf, -1, 1.0, "repeated_real")]
    free, rest, more, _ = question(
        monkeypatch, lft.smallest_last_block, problem, 0.8, gap=0.1, max_nodes=7, known="found before"
    )
    assert bounds_of(free) == [(0.0, 0, 1.0, None), *capped] and free.params == 1
    assert rest == [0.1, 7] and more == {"enough": pytest.approx(0.64 * (1 + ROUNDING), rel=1e-15)}
    without = scaled_problem(problem, 0.8, [5])
    np.testing.assert_array_equal(free.forms[0].a, without.w)
    np.testing.assert_array_equal(free.forms[0].b, without.t)
    ball, own = (pytest.approx(0.64), -1, 1.0, None), (0.0, 0, 1.0, None)
    alone, *_ = question(monkeypatch, lft.smallest_last_block, of_all_kinds(0, 2), 0.8)
    assert bounds_of(alone) == [ball, own], "without a repeated block that is not asked first"
    monkeypatch.setattr(lft, "_last_block_is_free", lambda *a: False)
    asked, rest, more, _ = question(
        monkeypatch, lft.smallest_last_block, problem, 0.8, gap=0.1, max_nodes=7, known="found before"
    )
    assert bounds_of(asked) == [ball, *capped, own] and asked.params == 1
    assert rest == [0.1, 7, lft.ZERO, known] and not more
    np.testing.assert_array_equal(asked.forms[-1].a, scaled_problem(problem, 0.8).xi[5])


def test_a_last_block_is_free_up_to_the_rounding_of_the_ball_or_its_edge_where_that_is_one_point(monkeypatch):
    real, p21 = Block("repeated_real", 1, 1), [[1, 1], [0, 0]]
    problem = beside_the_last(real, np.zeros((2, 2)), p21, np.eye(2), [2.0, 1.0])
    for gamma, slack in ((1.0, EDGE), (1.5, ROUNDING)):
        limit = gamma**2 * (1 + slack)
        for upper, free in ((limit, True), (limit * (1 + 3e-16), False)):
            answer = Interval(0.0, upper, None, 1)
            monkeypatch.setattr(lft, "minimise", lambda *a, answer=answer, **b: answer)
            assert is_free(problem, gamma) == free
