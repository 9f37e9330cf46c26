"""The search for mu's lower bound by its pieces: starts, ascents, secants, and what is checked and kept."""

from __future__ import annotations

import itertools

import numpy as np
import pytest

from lpvguard.engine.blocks import Block
from lpvguard.engine.synthesis import mu_lower
from lpvguard.engine.synthesis.structure import Structure

FULL = Structure((Block("full", 2, 1), Block("full", 1, 2)))
MIXED = Structure(
    (
        Block("repeated_real", 2, 2),
        Block("full", 1, 2),
        Block("repeated_complex", 2, 2),
        Block("repeated_real", 1, 1),
    )
)
WIDE = Structure((Block("full", 3, 1), Block("repeated_real", 2, 2)))
SCALARS = Structure((Block("repeated_real", 1, 1), Block("full", 1, 1)))
REAL = Block("repeated_real", 1, 1)


def gauss(seed: int, *shape: int) -> np.ndarray:
    random = np.random.default_rng(seed)
    return random.standard_normal(shape) + 1j * random.standard_normal(shape)


def matrix(structure: Structure, seed: int = 0) -> np.ndarray:
    return gauss(seed, structure.n_rows, structure.n_cols)


def parts_of(seed: int = 0) -> list:
    """Of `MIXED`, of unit size or less."""
    u, v = gauss(seed, 1), gauss(seed + 1, 2)
    return [0.5, np.outer(u, v) / np.linalg.norm(u) / np.linalg.norm(v), np.exp(0.7j), -0.8]


# ---------------------------------------------------------------- vectors and perturbations


def test_a_phase_is_of_size_one_and_that_of_zero_is_one():
    with np.errstate(all="raise"):
        phase = mu_lower._phase(np.array([3 - 4j, -0.25, 0.0, 1e-3j]))
        assert mu_lower._phase(0.0) == 1.0 and mu_lower._phase(-2j) == -1j
    np.testing.assert_allclose(phase, [0.6 - 0.8j, -1.0, 1.0, 1j], rtol=1e-15)


def test_vectors_are_brought_to_length_one_but_zero():
    v = np.array([[3.0, 0.0, 0.3j], [4j, 0.0, 0.4]])
    with np.errstate(all="raise"):
        lengths, unit = mu_lower._lengths(v), mu_lower._unit(v)
        outer = mu_lower._rank_one(np.array([0.1j]), np.array([0.3, 0.4j]))
        assert mu_lower._rank_one(np.zeros(2), np.ones(1)).tolist() == [[0.0], [0.0]]
    assert lengths.tolist() == [5.0, 1e-300, 0.5]
    np.testing.assert_allclose(unit, [[0.6, 0, 0.6j], [0.8j, 0, 0.8]], rtol=1e-15)
    np.testing.assert_allclose(outer, [[0.6j, 0.8]], rtol=1e-15)
    assert mu_lower._largest_eigenvalue(np.diag([2.0, -3j, 1.0])) == -3j


def test_a_perturbation_has_its_parts_on_its_diagonal_and_its_complex_blocks_turned():
    parts = [0.5, np.array([[1.0, 2j]]), 1j, -0.8]
    want = np.zeros((6, 7), complex)
    want[0, 0] = want[1, 1] = 0.5
    want[2, 2:4], want[5, 6] = [1.0, 2j], -0.8
    want[3, 4] = want[4, 5] = 1j
    np.testing.assert_array_equal(mu_lower._assemble(MIXED, parts), want)
    want[2:5] *= 1j
    np.testing.assert_array_equal(mu_lower._assemble(MIXED, parts, 1j), want)


def test_the_size_of_a_perturbation_is_that_of_its_largest_block():
    wide, tall = np.array([[3.0, 4.0]]), np.array([[0.0], [2.0]])
    delta = np.zeros((3, 3))
    delta[:1, :2], delta[1:, 2:] = wide, tall
    structure = Structure((Block("full", 1, 2), Block("full", 2, 1)))
    assert mu_lower._size(structure, delta) == pytest.approx(5.0)
    assert mu_lower._size(structure, np.diag([1.0, 3.0, 0.0])[:, [0, 2, 1]]) == pytest.approx(3.0)


@pytest.mark.parametrize(
    ("moved", "singular"), [(0.0, True), (0.9e-11, True), (3e-11, False), (1e-9, False), (0.1, False)]
)
@pytest.mark.parametrize("scale", [1.0, 1e6])
def test_a_loop_is_singular_where_entries_of_m_move_by_rounding(moved, singular, scale):
    """det(I − M) = 0.5 − 0.5 = 0 in any units of the two signals."""
    M = np.array([[0.5, scale], [0.5 / scale, 0.0]]) * (1 + moved)
    assert mu_lower._is_singular(M, np.eye(2)) is singular


@pytest.mark.parametrize(
    ("planted", "value"),
    [
        pytest.param(lambda d: d, 2.0, id="none"),
        pytest.param(lambda d: 0.99 * d, 0.0, id="too small to be singular"),
        pytest.param(lambda d: d + np.diag([0.0, 0.0, 1e-9]), 0.0, id="not a multiple of I"),
        pytest.param(lambda d: d + np.diag([1e-9j, 0.0, 0.0]), 0.0, id="a real block that is complex"),
        pytest.param(lambda d: d + np.eye(3, k=1), 0.0, id="an entry outside of its blocks"),
        pytest.param(lambda d: 0.0 * d, 0.0, id="zero"),
        pytest.param(lambda d: d + np.diag([1.0, 0.0, 0.0]), 1 / 1.5, id="another block larger"),
    ],
)
def test_a_perturbation_attains_its_value_or_nothing(planted, value):
    """μ of diag(1, 2, 2) with a real scalar and a repeated complex one: δ = (0.5, 0.5) is singular."""
    structure = Structure((REAL, Block("repeated_complex", 2, 2)))
    M = np.diag([1.0, 2.0, 2.0]).astype(complex)
    delta = planted(0.5 * np.eye(3, dtype=complex))
    assert mu_lower.attained(M, structure, delta, 1e-11 * np.abs(M)) == pytest.approx(value)


# ---------------------------------------------------------------- candidates


def test_candidates_within_a_millionth_of_the_one_before_count_once():
    values = [2.0, 2.0 * (1 - 1e-6), 1.0, 1 - 1.1e-6, 1 - 2e-6]
    distinct = mu_lower._distinct([(value, None, []) for value in values])
    assert [value for value, *_ in distinct] == [2.0, 1.0, 1 - 1.1e-6]


def test_vertices_have_their_real_blocks_at_plus_or_minus_one_up_to_a_common_sign():
    structure = Structure((REAL, Block("full", 1, 1), REAL, REAL))
    parts = [0.3, "full", 0.5, -0.2]
    signs = [(1, 1), (-1, 1), (1, -1), (-1, -1)]
    assert mu_lower._vertices(structure, parts) == [[1.0, "full", a, b] for a, b in signs]
    assert parts == [0.3, "full", 0.5, -0.2]
    assert mu_lower._vertices(FULL, [1, 2]) == []
    assert mu_lower._vertices(Structure((REAL,)), [0.1]) == [[1.0]]
    for n in (7, 8):
        many = np.array(mu_lower._vertices(Structure((REAL,) * n), [0.1] * n))
        assert len(np.unique(many, axis=0)) == len(many) == 64
        assert (np.abs(many) == 1).all() and (many[:, [0, *range(7, n)]] == 1).all()


def test_a_candidate_is_kept_where_it_attains_more_than_asked_and_makes_the_loop_singular(monkeypatch):
    answers = {"value": 0.25, "delta": np.eye(2), "singular": True}
    monkeypatch.setattr(mu_lower, "_make_singular", lambda *_: (answers["value"], answers["delta"]))
    monkeypatch.setattr(
        mu_lower, "_is_singular", lambda _, delta: delta is answers["delta"] and answers["singular"]
    )
    assert mu_lower._checked("M", FULL, [1.0]) == (0.25, answers["delta"], [1.0])
    assert mu_lower._checked("M", FULL, [1.0], 0.2) == (0.25, answers["delta"], [1.0])
    assert mu_lower._checked("M", FULL, [1.0], 0.25) is None
    answers["singular"] = False
    assert mu_lower._checked("M", FULL, [1.0]) is None
    answers |= {"singular": True, "value": 0.0}
    assert mu_lower._checked("M", FULL, [1.0]) is None
    answers |= {"value": 0.25, "delta": None}
    assert mu_lower._checked("M", FULL, [1.0]) is None
    answers |= {"value": 0.25, "delta": np.eye(2)}
    assert mu_lower._checked("M", FULL, [np.array([[np.nan]])]) is None, "extreme scalings left no candidate"


def test_an_upper_bound_is_attained_by_the_blocks_of_its_singular_vectors(monkeypatch):
    """Each block takes its part of u to that of v; ten times the precision of the bound may be missing."""
    M, asked = matrix(FULL), []
    answers = [None, (1.9, "delta", "parts")]
    left, right = np.diag([2.0, 1.0, 1.0]), np.diag([3.0, 3.0, 1.0])
    monkeypatch.setattr(
        mu_lower,
        "simple_infimum",
        lambda *arguments: asked.append(arguments) or (2.0, 1.0, left, right, None),
    )
    monkeypatch.setattr(mu_lower, "_checked", lambda *arguments: asked.append(arguments) or answers.pop())
    start = np.diag([-5.0, 7j, 1.0])
    assert mu_lower._attained(M, FULL, start) == (1.9, "delta")
    (_, _, rtol, scales), (asked_M, structure, parts, least) = asked
    assert rtol == 1e-10 and scales.tolist() == [5.0, 7.0] and asked_M is M and structure is FULL
    assert least == pytest.approx(2.0 * (1 - 1e-9), rel=1e-12)
    u, _, v = np.linalg.svd(left @ M @ np.linalg.inv(right))
    for part, r, c in zip(parts, FULL.row, FULL.col, strict=True):
        gain = part @ u[r, 0] / np.linalg.norm(u[r, 0])
        np.testing.assert_allclose(gain, v[0, c].conj() / np.linalg.norm(v[0, c]), rtol=1e-12)
        assert np.linalg.norm(part) == pytest.approx(1.0)
    assert mu_lower._attained(M, FULL, start) is None
    monkeypatch.setattr(mu_lower, "simple_infimum", lambda *_: None)
    assert mu_lower._attained(M, FULL, start) is None


# ---------------------------------------------------------------- one perturbation made singular


def test_a_complex_perturbation_is_divided_by_the_largest_eigenvalue():
    M = matrix(FULL)
    parts = [gauss(1, 2, 1), gauss(2, 1, 2)]
    value, delta = mu_lower._make_singular(M, FULL, parts)
    whole = mu_lower._assemble(FULL, parts)
    eigenvalues = np.linalg.eigvals(M @ whole)
    assert value == pytest.approx(np.abs(eigenvalues).max(), rel=1e-12)
    assert np.abs(np.linalg.eigvals(M @ delta) - 1).min() < 1e-12
    np.testing.assert_allclose(value * np.abs(delta), np.abs(whole), rtol=1e-12)
    assert mu_lower._make_singular(0 * M, FULL, parts) == (0.0, None)


def test_each_eigenvalue_of_a_mixed_perturbation_is_made_real_and_the_least_size_counts(monkeypatch):
    M, parts, asked = np.array([[0.0, 1.0], [3.0, 0.0]]), [0.5, np.array([[1j]])], []
    families = [lambda s: np.diag([1.0, 1j])[::-1] + s, lambda s: np.diag([2.0, 1.0])[::-1] + s]
    answers = iter([None, 4.0, 0.5j, 0.5])
    monkeypatch.setattr(
        mu_lower, "_free_parameters", lambda *arguments: arguments == (SCALARS, parts) and families
    )

    def make_real(perturbation, vary, start):
        asked.append((vary, start))
        size = next(answers, None)
        return None if size is None else np.diag([0.1, size])

    monkeypatch.setattr(mu_lower, "_make_real", make_real)
    value, delta = mu_lower._make_singular(M, SCALARS, parts)
    assert value == 2.0 and delta[1, 1] == 0.5j, "the first of two of one size"
    assert [vary for vary, _ in asked] == [families[0]] * 2 + [families[1]] * 2
    assert sorted(start.real + 10 * start.imag for _, start in asked) == [1.0, 2.0, 3.0, 30.0]
    for sizes, value in ([0.5, 3.0], 2.0), ([4.0], 0.25), ([], 0.0):
        answers = iter(sizes)
        assert mu_lower._make_singular(M, SCALARS, parts)[0] == value
    assert mu_lower._make_singular(M, SCALARS, parts) == (0.0, None)


def test_one_parameter_turns_the_complex_blocks_or_moves_a_real_one_within_its_bounds():
    parts = parts_of()
    turn, first, last = mu_lower._free_parameters(MIXED, parts)
    np.testing.assert_allclose(turn(0.3), mu_lower._assemble(MIXED, parts, np.exp(0.3j)), rtol=1e-15)
    for s, moved in ((0.2, 0.7), (0.6, 1.0), (-0.4, 0.1), (-1.7, -1.0)):
        np.testing.assert_allclose(first(s), mu_lower._assemble(MIXED, [moved, *parts[1:]]), rtol=1e-14)
    np.testing.assert_allclose(last(0.3), mu_lower._assemble(MIXED, [*parts[:3], -0.5]), rtol=1e-14)
    assert len(list(mu_lower._free_parameters(Structure((REAL, REAL)), [0.1, 0.2]))) == 2
    assert len(list(mu_lower._free_parameters(FULL, [0, 0]))) == 1


class Family:
    """1 x 1 perturbations of a parameter, or what stands for the n-th of them; notes the parameters asked."""

    def __init__(self, matrix_of) -> None:
        self.of, self.asked = matrix_of, []

    def __call__(self, s: float) -> np.ndarray:
        self.asked.append(s)
        return np.atleast_2d(self.of(s, len(self.asked)))


@pytest.mark.parametrize(("size", "phase"), [(2.0, 0.3), (3.0, -1.4), (0.1, 2.6), (2.0, 1.2)])
def test_secant_steps_of_half_a_unit_at_most_take_an_eigenvalue_to_the_real_axis(size, phase):
    """M is 2 and turns the order; beside the eigenvalue that is followed are its opposite, a small one, and
    one of another phase."""

    def value(s, n=0):
        return 2 * size * np.exp(1j * (phase + s))

    others = np.array([-9.0, -np.exp(1j * phase), 0.01j]) * size
    vary = Family(lambda s, n: np.diag([*others, size * np.exp(1j * (phase + s))])[::-1])
    delta = mu_lower._make_real(2 * np.eye(4)[::-1], vary, value(0.0))[::-1]
    *asked, last = vary.asked
    assert last == asked[-1] and asked[0] == 1e-4
    for before, now, after in zip([0.0, *asked[:-2]], asked[:-1], asked[1:], strict=True):
        slope = (value(now).imag - value(before).imag) / (now - before)
        assert after - now == pytest.approx(np.clip(-value(now).imag / slope, -0.5, 0.5), 1e-4, 1e-12)
    assert abs(value(last).imag) < 1e-12 * size
    np.testing.assert_allclose(delta[3, 3], 0.5, rtol=1e-12)
    assert delta[0, 0] == pytest.approx(-9 * size / value(last).real)


@pytest.mark.parametrize(
    ("start", "steps"),
    [(1 + 1e-13j, 0), (100 + 1e-11j, 0), (-1 + 1e-14j, 0), (-1.0, 0), (1 + 3e-13j, 1), (1 - 0.5j, 1)],
)
def test_an_eigenvalue_is_real_to_a_ten_trillionth(start, steps):
    vary = Family(lambda s, n: 4.0)
    assert mu_lower._make_real(np.eye(1), vary, complex(start)) == 4.0 / (4.0 if steps else start.real)
    assert vary.asked == ([1e-4, 1e-4] if steps else [0.0])


@pytest.mark.parametrize(
    ("value", "good"), [(1 + 5e-12j, True), (1 + 1e-11j, True), (1 - 1.1e-11j, False), (100 + 9e-10j, True)]
)
def test_an_eigenvalue_that_does_not_move_is_real_to_a_hundred_billionth(value, good):
    vary = Family(lambda s, n: value)
    delta = mu_lower._make_real(np.eye(1), vary, value)
    assert (delta is not None) == good and vary.asked == [1e-4] * (2 if good else 1)
    assert not good or delta == value / value.real


def test_an_eigenvalue_of_zero_and_one_that_does_not_settle_are_left():
    assert mu_lower._make_real(np.eye(1), Family(lambda s, n: 0.0), 0j) is None
    for size in (1.0, 2e-12):  # the smaller is near enough, but has not settled
        vary = Family(lambda s, n, size=size: 1 + size * 1j * (-1) ** n * (1 + 1 / n))
        assert mu_lower._make_real(np.eye(1), vary, 1 + 3j * size) is None
        assert len(vary.asked) == 30


# ---------------------------------------------------------------- ascents


def test_blocks_are_turned_to_the_gradient_of_the_largest_eigenvalue():
    """To first order |λ| changes by Re(conj(λ) y* dQ x / (|λ| y* x)), y* = l* M: no unit dQ does more."""
    structure = Structure((Block("full", 1, 2), Block("repeated_complex", 2, 2)))
    M, parts = matrix(structure), [np.array([[0.6, 0.8j]]), np.exp(0.4j)]
    Q = mu_lower._assemble(structure, parts)
    values, vectors = np.linalg.eig(M @ Q)
    k = np.abs(values).argmax()
    x, y = vectors[:, k], M.conj().T @ np.linalg.inv(vectors)[k].conj()
    gradient = values[k].conj() / abs(values[k]) * np.outer(x, y.conj())  # y is scaled so that l* x = 1
    full, repeated = mu_lower._align(M, structure, parts, steps=1)
    best = gradient[:2, :1].T.conj()
    np.testing.assert_allclose(full, best / np.linalg.norm(best), rtol=1e-10)
    best = np.trace(gradient[2:, 1:]).conj()
    assert repeated == pytest.approx(best / abs(best), rel=1e-10)

    def reached(steps: int) -> float:
        aligned = mu_lower._align(M, structure, parts, steps)
        return abs(mu_lower._largest_eigenvalue(M @ mu_lower._assemble(structure, aligned)))

    assert reached(0) < reached(1) < reached(2) < reached(5) < reached(20)
    assert reached(200) == pytest.approx(reached(300), rel=1e-11)


@pytest.mark.parametrize(
    ("values", "asked"),
    [
        ([-0.5, 0.5 * (1 + 1e-13), 9.0], 2),
        ([0.5, 0.5 * (1 + 3e-13), 0.5, 9.0], 3),
        ([0.0, 9.0], 1),
        (range(1, 300), 200),
    ],
)
def test_an_ascent_ends_where_it_gains_only_rounding_and_after_two_hundred_steps(monkeypatch, values, asked):
    answers, calls = iter(values), []

    def eig(X, left):
        calls.append(X)
        return np.array([next(answers), 0.0]), np.eye(2), np.eye(2)

    monkeypatch.setattr(mu_lower.sl, "eig", eig)
    structure = Structure((Block("full", 1, 1), Block("full", 1, 1)))
    parts = [np.array([[1j]]), np.array([[1j]])]
    aligned = mu_lower._align(np.eye(2), structure, parts)
    assert len(calls) == asked and (aligned is parts) == (asked == 1)


def test_what_is_left_of_a_loop_closed_by_real_blocks_is_closed_by_the_complex_ones(monkeypatch):
    M, parts, calls = matrix(MIXED), parts_of(), []

    def align(N, rest, parts, steps):
        calls.append((rest, steps))
        return list(parts)

    monkeypatch.setattr(mu_lower, "_align", align)
    ascent = mu_lower._MixedAscent(M, MIXED, parts)
    assert ascent.q.tolist() == [0.5, -0.8] and ascent.parts == parts[1:3]
    q, beta = np.array([0.9, -0.4]), 2.5
    value, aligned = ascent.spectral(q, beta, ascent.parts)
    assert aligned == parts[1:3] and calls[0][1] == 20 and calls[0][0].blocks == MIXED.blocks[1:3]
    delta = mu_lower._assemble(MIXED, [q[0] / beta, parts[1] / value, parts[2] / value, q[1] / beta])
    assert np.linalg.svd(np.eye(7) - M @ delta)[1][-1] < 1e-12
    # No larger eigenvalue: det(I - M Δ(λ)) has no zero outside of it.
    real = mu_lower._assemble(MIXED, [q[0] / beta, 0 * parts[1], 0.0, q[1] / beta])
    rest = mu_lower._assemble(MIXED, [0.0, parts[1], parts[2], 0.0])
    others = np.linalg.eigvals(np.linalg.solve(np.eye(7) - M @ real, M @ rest))
    assert abs(value) == pytest.approx(np.abs(others).max(), rel=1e-10)
    singular = mu_lower._MixedAscent(np.eye(2), SCALARS, [0.5, np.array([[1.0]])])
    assert singular.spectral(np.array([0.5]), 0.5, ["parts"]) == (0.0, ["parts"])


def ascent_of(monkeypatch, q, spectral) -> mu_lower._MixedAscent:
    """Of real scalars and one complex scalar, with what is left of the loop told."""
    structure = Structure((*[REAL] * len(q), Block("full", 1, 1)))
    ascent = mu_lower._MixedAscent(np.eye(len(q) + 1), structure, [*q, np.array([[1.0]])])
    monkeypatch.setattr(ascent, "spectral", spectral)
    return ascent


@pytest.mark.parametrize(("power", "start"), [(-0.5, 1.0), (-0.5, 20.0), (0.4, 2.0), (-3.0, 1.9)])
def test_the_level_is_where_the_eigenvalue_equals_it_by_secants_of_logarithms(monkeypatch, power, start):
    """ρ = 2 β^power: the first step takes β to ρ, each at most by the factor e^0.5."""
    asked = []

    def spectral(q, beta, parts):
        asked.append((beta, parts))
        return -2j * beta**power, len(asked)

    ascent = ascent_of(monkeypatch, [0.5], spectral)
    beta, value = ascent.level(np.array([0.5]), start, 0)
    assert len(asked) < 20 and beta == pytest.approx(2 ** (1 / (1 - power)), rel=1e-12)
    assert value == pytest.approx(-1j * beta)
    assert [parts for _, parts in asked] == list(range(len(asked))) and ascent.parts == len(asked)
    x = np.log([beta for beta, _ in asked])
    f = np.log(2) + (power - 1) * x
    slopes = [-1.0, *np.diff(f) / np.diff(x)]
    for k in range(min(len(x) - 1, 5)):
        assert x[k + 1] - x[k] == pytest.approx(np.clip(-f[k] / slopes[k], -0.5, 0.5), rel=1e-4, abs=1e-11)


def test_a_level_that_no_eigenvalue_meets_is_sought_forty_times(monkeypatch):
    asked = []
    for share, rate, n in ((2.0, 0.5, 40), (0.5, -0.5, 40), (0.0, -0.5, 2)):  # of zero: no loop at all
        asked.clear()

        def spectral(q, beta, parts, share=share):
            asked.append(beta)
            return share * beta, 0

        with np.errstate(divide="raise", invalid="raise"):
            ascent_of(monkeypatch, [0.5], spectral).level(np.array([0.5]), 1.0, 0)
        np.testing.assert_allclose(asked[:n], np.exp(rate * np.arange(n)), rtol=1e-12)
        assert len(asked) == 40


def searched(monkeypatch, q, gain, **named) -> tuple[list, float, np.ndarray]:
    """What a pattern search for the largest ``gain(q)`` asks and finds, started with β = 1."""
    asked = []

    def spectral(q, beta, parts):
        asked.append(q.tolist())
        return 1j * gain(q) if named.get("always") is None else beta * named["always"], "aligned"

    def level(q, beta, parts):
        ascent.parts = [np.array([[1.0]])]
        return gain(q), -1j * gain(q)

    ascent = ascent_of(monkeypatch, q, spectral)
    monkeypatch.setattr(ascent, "level", level)
    return asked, *ascent.run(1.0, *named.get("budget", ()))


def test_a_pattern_search_goes_on_from_what_is_better_and_narrows_where_nothing_is(monkeypatch):
    asked, beta, delta = searched(monkeypatch, [0.0], lambda q: 2 - abs(q[0] - 0.5))
    steps = [0.4, 0.0, 0.8, 0.0, 0.56, 0.4, 0.72, 0.4, 0.624, 0.496, 0.56, 0.432]
    np.testing.assert_allclose(np.ravel(asked)[: len(steps)], steps, atol=1e-12)
    assert beta == pytest.approx(2.0, abs=1e-4) and beta * delta[0, 0].real == pytest.approx(0.5, abs=1e-4)
    assert beta * delta[1, 1] == pytest.approx(1j), "turned so that the eigenvalue is real"
    asked, beta, delta = searched(monkeypatch, [0.0, 0.7], lambda q: 9 - abs(q[1] - 2) - abs(q[0] + 2))
    np.testing.assert_allclose(asked[:3], [[0.4, 0.7], [-0.4, 0.7], [-0.4, 1.0]], atol=1e-12)
    np.testing.assert_allclose(beta * np.diag(delta)[:2], [-1.0, 1.0], atol=1e-12)
    assert ([-1.0, 1.0] in asked) and np.abs(asked).max() == 1.0


def test_a_pattern_search_ends_at_a_hundred_thousandth_or_with_its_budget(monkeypatch):
    def flat(q):
        return 1.0

    assert len(searched(monkeypatch, [0.0], flat, always=0.5)[0]) == 24, "twelve sizes, to 1.7e-5"
    for share, better in ((1 + 1e-9, False), (1 + 0.9e-9, False), (1 + 1.1e-9, True), (-2, True), (2j, True)):
        asked, *_ = searched(monkeypatch, [0.0], flat, always=share)
        assert len(asked) == (120 if better else 24)
    assert len(searched(monkeypatch, [1.0], flat, always=2.0)[0]) == 121, "one, then two a round"
    for budget, count in ((3, 4), (4, 4), (5, 6)):
        assert len(searched(monkeypatch, [0.0], flat, always=2.0, budget=(budget,))[0]) == count


# ---------------------------------------------------------------- the power iteration


def reference(N, structure, b, q, steps: int) -> list:
    """One run of the mixed power iteration as Young & Doyle write it (1990): a, z on the inputs of Δ, w, b on
    its outputs."""
    w, q = b, list(q)
    size = np.linalg.norm
    kinds = [block.kind for block in structure.blocks]
    blocks = list(zip(itertools.count(), kinds, structure.row, structure.col, strict=False))

    def factor(k, kind, a, w, b):
        inner = np.vdot(w, a)
        if kind == "repeated_complex":
            return inner / abs(inner)
        q[k] = min(1.0, max(-1.0, np.sign(q[k]) * size(b) / size(a) + inner.real))
        return q[k]

    for _ in range(steps):
        a = N @ b / size(N @ b)
        z, after = np.zeros(N.shape[0], complex), np.zeros(N.shape[1], complex)
        for k, kind, r, c in blocks:
            if kind == "full":
                z[r] = a[r] / size(a[r]) * size(w[c])
            else:
                z[r] = w[c] * factor(k, kind, a[r], w[c], b[c])
        w = N.conj().T @ z / size(N.conj().T @ z)
        for k, kind, r, c in blocks:
            if kind == "full":
                after[c] = w[c] / size(w[c]) * size(a[r])
            else:
                after[c] = a[r] * np.conj(factor(k, kind, a[r], w[c], b[c]))
        b = after
    makers = {
        "full": lambda k, w, a: np.outer(w, a.conj()) / size(w) / size(a),
        "repeated_complex": lambda k, w, a: np.vdot(a, w) / abs(np.vdot(a, w)),
        "repeated_real": lambda k, w, a: q[k],
    }
    return [makers[kind](k, w[c], a[r]) for k, kind, r, c in blocks]


@pytest.mark.parametrize("steps", [1, 2, 4])
@pytest.mark.parametrize("structure", [MIXED, WIDE], ids=["mixed", "wide"])
def test_every_run_of_the_power_iteration_is_one_of_its_own(structure, steps):
    """From so many random vectors, and from the right singular vectors."""
    N, starts = matrix(structure, 3) / 10, 3
    random, (rows, cols) = np.random.default_rng(1), N.shape
    count = starts + min(rows, cols)
    b = random.standard_normal((cols, count)) + 1j * random.standard_normal((cols, count))
    b[:, starts:] = np.linalg.svd(N)[2][: min(rows, cols)].conj().T
    uniform = random.uniform(-1, 1, (len(structure.blocks), count))
    candidates = mu_lower._power_iteration(N, structure, starts, steps)
    assert len(candidates) == count
    for s in range(count):
        q = uniform[:, s] if s % 2 else np.ones(len(structure.blocks))
        for one, other in zip(candidates[s], reference(N, structure, b[:, s], q, steps), strict=True):
            np.testing.assert_allclose(one, other, rtol=1e-9, atol=1e-12)


def test_a_power_iteration_whose_runs_move_along_the_negative_real_axis_goes_on():
    two = Structure((Block("full", 1, 1), Block("full", 1, 1)))
    N = matrix(two, 1) / 10
    vectors = np.linalg.svd(N)[2].conj()
    for one, b in zip(mu_lower._power_iteration(N, two, 0, 4), vectors, strict=True):
        np.testing.assert_allclose(one, reference(N, two, b, [], 4), rtol=1e-9)


def test_the_power_iteration_ends_where_no_run_moves(monkeypatch):
    asked = []
    unit = mu_lower._unit
    monkeypatch.setattr(mu_lower, "_unit", lambda v: asked.append(v) or unit(v))
    one = Structure((Block("full", 2, 2),))
    mu_lower._power_iteration(np.outer([1.0, 2j], [0.5, 1.0]), one, 2, 50)
    assert len(asked) in (4, 6)
    asked.clear()
    mu_lower._power_iteration(np.diag([1.0, 0.9]), one, 2, 50)
    assert len(asked) == 100, "the singular vectors stay, the others move on"


def test_a_repeated_block_multiplies_by_a_phase_or_a_number_within_one():
    q = np.array([[9.0] * 8, [0.3, -0.2, 0.0, -0.1, 1.0, -1.0, 1.0, -1.0]])
    a = np.array([[0.6] * 8, [0.8j] * 8])
    w = np.array([[0.5, 0.5, 0.25, 0.5, 5, -5, 0, 0], [0.1j, 1, 0, 0, 0, 0, 1, 1]], complex)
    b = np.array([[0.3, 0.15, 7.0, 0.3, 0, 0, 1, 1], [0.4, 0.2, 7.0, 0, 0, 0, 0, 0]])
    factor = mu_lower._factor(Block("repeated_real", 2, 2), a, w, b, q, 1)
    np.testing.assert_allclose(factor, [0.5 + 0.38, -0.25 + 0.3, 0.15, 1e-3, 1, -1, 1, -1], rtol=1e-14)
    np.testing.assert_array_equal(q, [[9.0] * 8, factor])
    w[:, -1] = 0.0
    factor = mu_lower._factor(Block("repeated_complex", 2, 2), a, w, b, q, 0)
    turned = (0.3 + 0.8j) / abs(0.3 + 0.8j)
    np.testing.assert_allclose(factor, [1, turned, 1, 1, 1, -1, 1j, 1], rtol=1e-14)
    assert (q[0] == 9.0).all()


# ---------------------------------------------------------------- the whole search


class Search:
    """A search whose candidates are names, each with a value (a candidate without one fails the check)."""

    def __init__(self, monkeypatch, candidates, vertices=(), aligned=None, risen=None):
        self.asked: list = []
        self.values: dict[str, float] = {}
        aligned, risen = aligned or {}, risen or {}
        search = self

        class Ascent:
            def __init__(self, M, structure, parts):
                self.parts = parts

            def run(self, value):
                search.asked.append((self.parts, value))
                return risen[self.parts]

        def checked(M, structure, parts, least=0.0):
            value = {**dict(candidates), **dict(vertices), **aligned}[parts]
            return (value, f"Δ{parts}", parts) if value is not None and value > least else None

        def align(scaled, structure, parts):
            self.asked.append(parts)
            return f"{parts}+"

        def iteration(scaled, structure, starts, steps):
            self.scaled, self.counts = scaled, (starts, steps)
            return [name for name, _ in candidates]

        monkeypatch.setattr(mu_lower, "_attained", lambda *_: None)
        monkeypatch.setattr(mu_lower, "_power_iteration", iteration)
        monkeypatch.setattr(
            mu_lower, "_vertices", lambda s, parts: [n for n, _ in vertices if parts == candidates[-1][0]]
        )
        monkeypatch.setattr(mu_lower, "_checked", checked)
        monkeypatch.setattr(mu_lower, "_align", align)
        monkeypatch.setattr(mu_lower, "_MixedAscent", Ascent)
        monkeypatch.setattr(mu_lower, "_is_singular", lambda M, delta: delta != "not singular")

    def run(self, structure: Structure, enough: float = np.inf) -> tuple:
        eye = np.eye(structure.n_rows), np.eye(structure.n_cols)
        return mu_lower.lower_bound(matrix(structure), structure, *eye, enough, 5)


def test_the_search_runs_on_the_balanced_matrix_of_size_one(monkeypatch):
    M = matrix(FULL)
    M[0, 0] = 0.0
    search = Search(monkeypatch, [("a", 1.0)], aligned={"a+": None})
    left, right = (
        np.triu(matrix(Structure((Block("full", 3, 3),)), 1)),
        np.diag([1j, 2.0, 4.0]) + np.eye(3, k=1),
    )
    assert mu_lower.lower_bound(M, FULL, left, right, 0.5, 7) == (1.0, "Δa")
    want = left.conj().T @ M @ np.linalg.inv(right).conj().T
    np.testing.assert_allclose(search.scaled, want / np.linalg.svd(want)[1][0], rtol=1e-12)
    assert search.counts == (7, 200)
    monkeypatch.setattr(mu_lower, "_attained", lambda *arguments: arguments)
    for passed, want in zip(mu_lower.lower_bound(M, FULL, left, right, 0.5, 7), (M, FULL, left), strict=True):
        assert passed is want
    assert mu_lower.lower_bound(0 * M, FULL, left, right, 0.5, 7) == (0.0, None)


def test_the_best_of_candidates_and_vertices_counts_and_none_is_zero(monkeypatch):
    candidates = [("a", 1.0), ("b", None), ("c", 2.0)]
    two = Structure((REAL, REAL))
    search = Search(monkeypatch, candidates, [("d", 3.0), ("e", 2.5)])
    assert search.run(two) == (3.0, "Δd") and not search.asked
    assert Search(monkeypatch, [("a", None)]).run(two) == (0.0, None)
    assert Search(monkeypatch, [("a", None)]).run(FULL) == (0.0, None)
    assert Search(monkeypatch, [("a", None)]).run(SCALARS) == (0.0, None)


def test_complex_blocks_are_aligned_from_the_three_best_until_it_is_enough(monkeypatch):
    candidates = [("a", 1.0), ("b", 4.0), ("c", 2.0), ("d", 3.0)]
    search = Search(monkeypatch, candidates, aligned={"b+": 3.9, "d+": 5.0, "c+": 4.5})
    assert search.run(FULL) == (5.0, "Δd+") and search.asked == ["b", "d", "c"]
    for enough, asked in ((5.0, ["b", "d"]), (5.1, ["b", "d", "c"]), (4.0, []), (4.1, ["b", "d"])):
        search.asked.clear()
        assert search.run(FULL, enough)[0] == (5.0 if asked else 4.0) and search.asked == asked


def test_a_mixed_problem_rises_from_six_that_differ_until_it_is_enough(monkeypatch):
    candidates = [(name, 10.0 - k) for k, name in enumerate("abcdefgh")]
    candidates.insert(1, ("A", 10.0 - 1e-7))
    risen = {"a": (10.0, "Δ10"), "b": (13.0, "not singular"), "c": (12.0, "Δ12")}
    risen |= {"d": (9.0, "Δ9"), "e": (12.5, "Δ12.5"), "f": (12.5, "no better")}
    search = Search(monkeypatch, candidates, risen=risen)
    assert search.run(SCALARS) == (12.5, "Δ12.5")
    assert search.asked == [(name, 10.0 - k) for k, name in enumerate("abcdef")]
    for enough, asked in ((12.0, "abc"), (12.1, "abcde"), (10.0, ""), (12.5, "abcde")):
        search.asked.clear()
        search.run(SCALARS, enough)
        assert [name for name, _ in search.asked] == list(asked)
