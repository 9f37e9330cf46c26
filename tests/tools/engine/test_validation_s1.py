"""Class S1 and the on-line margin against 60-digit arithmetic and a conic solver."""

from decimal import Decimal, getcontext

import numpy as np
import pytest

from lpvguard.base.errors import InputError
from lpvguard.engine.validation import s1

getcontext().prec = 60


def gauss(rng, *shape):
    return rng.normal(size=shape) + 1j * rng.normal(size=shape)


def exact(e, z, gamma):
    """B1 and nu by the textbook formula in 60 digits, from the very doubles that the engine sees."""
    er, ei = [Decimal(float(x.real)) for x in e], [Decimal(float(x.imag)) for x in e]
    zr, zi = [Decimal(float(x.real)) for x in z], [Decimal(float(x.imag)) for x in z]
    power = sum(a * a + b * b for a, b in zip(zr, zi, strict=True))
    re = sum(a * c + b * d for a, b, c, d in zip(zr, zi, er, ei, strict=True)) / power
    im = sum(a * d - b * c for a, b, c, d in zip(zr, zi, er, ei, strict=True)) / power
    error = sum(c * c + d * d for c, d in zip(er, ei, strict=True))
    b1_squared = error - power * (re * re + im * im)
    b1 = b1_squared.sqrt() if b1_squared > 0 else Decimal(0)
    room = (Decimal(float(gamma)) ** 2 - b1_squared) / power
    if room < 0:
        return float(b1), None
    nu = (re * re + im * im).sqrt() - room.sqrt()
    return float(b1), float(max(nu, Decimal(0)))


@pytest.mark.parametrize("n_y", [1, 2, 3, 4])
def test_closed_form_matches_sixty_digits(n_y):
    rng = np.random.default_rng(n_y)
    e, z = gauss(rng, 60, n_y), gauss(rng, 60, n_y) * 10.0 ** rng.uniform(-4, 4, (60, 1))
    gamma = np.linalg.norm(e, axis=1) * rng.uniform(0.3, 1.1, 60)
    r = s1.solve(e, z, gamma)
    for k in range(60):
        b1, nu = exact(e[k], z[k], gamma[k])
        assert r.b1[k] == pytest.approx(b1, rel=1e-12, abs=1e-25)
        assert bool(r.feasible[k]) == (nu is not None)
        if nu is not None:
            assert r.nu[k] == pytest.approx(nu, rel=1e-12, abs=0.0)


@pytest.mark.parametrize("edge", ["gamma_to_e", "gamma_to_b1", "parallel", "orthogonal"])
@pytest.mark.parametrize("distance", [1e-3, 1e-6, 1e-9, 1e-12])
def test_no_digits_are_lost_at_the_edges(edge, distance):
    rng = np.random.default_rng(7)
    for _ in range(12):
        z, off = gauss(rng, 2), gauss(rng, 2)
        e = (0.3 + 0.2j) * z + 0.1 * off
        if edge == "parallel":
            e = (0.3 + 0.2j) * z + distance * off
        if edge == "orthogonal":
            e = off - z * (np.vdot(z, off) / np.vdot(z, z)) + distance * z
        gamma = 0.6 * np.linalg.norm(e)
        if edge == "gamma_to_e":
            gamma = np.linalg.norm(e) * (1 - distance)
        if edge in ("gamma_to_b1", "orthogonal"):
            gamma = exact(e, z, 1.0)[0] * (1 + distance * (1 if edge == "gamma_to_b1" else distance / 10))
        b1, nu = exact(e, z, gamma)
        r = s1.solve(e, z, gamma)
        assert float(r.b1) == pytest.approx(b1, rel=1e-12, abs=1e-25)
        if nu is not None:
            assert float(r.nu) == pytest.approx(nu, rel=1e-12, abs=0.0)


@pytest.mark.parametrize("scale_e, scale_z", [(1e-200, 1.0), (1e200, 1e-100), (1e-160, 1e160), (1.0, 1e-300)])
def test_extreme_magnitudes_neither_overflow_nor_vanish(scale_e, scale_z):
    e, z = np.array([0.3 + 0.1j, -0.2j]), np.array([1.0 + 0j, 0.5 + 0.5j])
    plain = s1.solve(e, z, 0.25)
    scaled = s1.solve(e * scale_e, z * scale_z, 0.25 * scale_e)
    assert float(scaled.b1) == pytest.approx(float(plain.b1) * scale_e, rel=1e-12)
    if np.isfinite(scale_e / scale_z):
        assert float(scaled.nu) == pytest.approx(float(plain.nu) * scale_e / scale_z, rel=1e-12)


def test_delta_and_w_attain_the_bound():
    rng = np.random.default_rng(3)
    e, z = gauss(rng, 200, 3), gauss(rng, 200, 3)
    gamma = np.linalg.norm(e, axis=1) * rng.uniform(0.7, 1.05, 200)
    r = s1.solve(e, z, gamma)
    f = r.feasible
    assert f.sum() > 50
    np.testing.assert_allclose(np.abs(r.delta[f]), r.nu[f], rtol=1e-13, atol=1e-300)
    np.testing.assert_allclose((e - r.delta[:, None] * z)[f], r.w[f], atol=1e-14)
    assert np.all(np.linalg.norm(r.w[f], axis=1) <= gamma[f] * (1 + 1e-12))


def test_silent_bins_and_non_finite_bins():
    zero, e = np.zeros(2, complex), np.array([0.3, 0.4j])
    quiet = s1.solve(e, zero, np.array([0.5, 0.4999]))
    assert quiet.feasible.tolist() == [True, False]
    assert quiet.b1.tolist() == pytest.approx([0.5, 0.5])
    assert quiet.nu[0] == 0.0 and quiet.nu[1] == np.inf
    broken = s1.solve(np.array([[np.nan, 0], [1, 1], [np.inf, 1]]), np.ones((3, 2)), 1.5)
    assert np.isnan(broken.nu).tolist() == [True, False, True]
    assert not broken.feasible[0] and np.isnan(broken.b1[2])


@pytest.mark.parametrize("bad", [np.nan, np.inf, 1j * np.inf])
@pytest.mark.parametrize("place", ["e", "z", "gamma"])
@pytest.mark.filterwarnings("ignore:invalid value:RuntimeWarning")
def test_one_number_that_is_not_finite_leaves_no_result_of_its_point_alone(bad, place):
    e, z, gamma = np.full((3, 2), 1.0 + 2.0j), np.full((3, 2), 1.0 + 0j), np.full(3, 2.5)
    z[:, 1] = 0.5j
    whole = s1.solve(e, z, gamma)
    if place == "gamma":
        gamma[1] = abs(bad)
    else:
        {"e": e, "z": z}[place][1, 1] = bad
    broken = s1.solve(e, z, gamma)
    for name in ("b1", "nu", "delta"):
        numbers = getattr(broken, name)
        assert np.isnan(numbers).tolist() == [False, True, False], name
        assert numbers[0] == numbers[2] == getattr(whole, name)[0] != 0.0
    assert broken.feasible.tolist() == [True, False, True]
    assert np.isnan(broken.w).all(axis=1).tolist() == [False, True, False]


@pytest.mark.parametrize("turn", [1, -1, 1j, -1j])
@pytest.mark.parametrize("which", ["e", "z"])
def test_a_single_part_of_either_sign_sets_the_scale(turn, which):
    """One number of E (or of Z) far out of range in one part, the other part 0."""
    for size in (1e-200, 1e200):
        k, m = (size, 1.0) if which == "e" else (1.0, size)
        e, z = np.array([0.5 * turn * k]), np.array([0.25 * turn * m])
        solution = s1.solve(e, z, 0.0)
        assert solution.nu == pytest.approx(2.0 * k / m, rel=1e-14) and solution.feasible
        assert solution.delta == pytest.approx(2.0 * k / m, rel=1e-14)
        assert solution.b1 == 0.0 and np.abs(solution.w) <= 1e-15 * k


def test_a_scalar_product_of_one_is_no_exception():
    for sign in (1.0, -1.0):
        solution = s1.solve(np.full(4, 0.5), np.full(4, 0.5 * sign), 0.0)
        assert solution.delta == sign and solution.nu == 1.0


def test_zeros_leave_nothing_to_explain():
    """E = 0 needs no delta and no w; with no w allowed a delta that fits exactly is feasible."""
    for z in ([0.0, 0.0], [1.0, 2.0]):
        solution = s1.solve(np.zeros(2), np.array(z), 0.0)
        assert solution.feasible and solution.nu == solution.b1 == solution.delta == 0.0
    solution = s1.solve(np.array([2.0, 4j]), np.array([1.0, 2j]), 0.0)
    assert solution.feasible and solution.nu == 2.0 and solution.delta == 2.0 and solution.b1 == 0.0
    only_w = s1.solve(np.array([1.0, 0.0]), np.array([0.0, 1.0]), 1.0)
    assert only_w.feasible and only_w.nu == only_w.delta == 0.0


def test_the_tolerance_of_the_edge_is_relative():
    """gamma_w^2 may lie below |E|^2, and below B1^2, by 2e-12 of itself."""
    for size in (0.51, 0.98):
        e = np.array([size, 0.0])
        for z in ([0.0, 0.0], [0.0, 1.0]):
            for below, feasible in ((2e-12, False), (5e-13, True)):
                solution = s1.solve(e, np.array(z), size * (1 - below))
                assert solution.feasible == feasible, (size, z, below)
                assert solution.nu == (0.0 if feasible else np.inf)


def test_the_least_disturbance_is_feasible_where_e_is_orthogonal_to_z():
    """There |E|^2 - gamma^2 is rounding, and so is the product that it was divided by: delta is delta0."""
    rng = np.random.default_rng(12)
    for slant in (0.0, 1e-14, 1e-9):
        e, z = np.zeros((400, 2), complex), np.zeros((400, 2), complex)
        e[:, 0], z[:, 1] = gauss(rng, 400), gauss(rng, 400)
        z[:, 0] = slant * z[:, 1]
        solution = s1.solve(e, z, s1.solve(e, z, 0.0).b1)
        delta0 = slant * np.abs(e[:, 0] / z[:, 1]) / (1 + slant**2)
        assert solution.feasible.all()
        assert (solution.nu <= delta0 * (1 + 1e-12)).all()
        np.testing.assert_allclose(np.abs(solution.delta), solution.nu, rtol=1e-12)


def test_the_least_squares_scalar_is_the_projection():
    assert s1.least_squares_delta([5, 2], [0, 1]) == 2.0
    assert s1.least_squares_delta([3j, 4.0], [1.0, 1.0]) == 2.0 + 1.5j
    e, z = np.array([[1j, 1.0], [2.0, 3.0]]), np.array([[2.0, 2j], [0.0, 0.0]])
    assert s1.least_squares_delta(e, z).tolist() == [0.0, 0.0]
    assert s1.least_squares_delta([1e300], [1e-5j]) == pytest.approx(-1e305j)
    small = s1.least_squares_delta([2e-300, 0.0], [1e-300, 1e-300])
    assert small == pytest.approx(1.0, rel=1e-14)


def test_gamma_equal_to_b1_is_feasible():
    rng = np.random.default_rng(5)
    e, z = gauss(rng, 500, 2), gauss(rng, 500, 2)
    b1 = s1.solve(e, z, np.zeros(500)).b1
    assert s1.solve(e, z, b1).feasible.all()
    assert not s1.solve(e, z, b1 * (1 - 1e-9)).feasible.any()


@pytest.mark.parametrize("n_y", [1, 2, 3])
def test_tradeoff_matches_a_conic_solver(n_y):
    cp = pytest.importorskip("cvxpy")
    rng = np.random.default_rng(20 + n_y)
    for _ in range(6):
        e, z = gauss(rng, n_y), gauss(rng, n_y)
        b1 = float(s1.solve(e, z, 0.0).b1)
        gamma = b1 + rng.uniform(0.05, 1.0) * (np.linalg.norm(e) - b1)
        lam, lam_w = rng.uniform(0, 2), rng.uniform(0, 2, n_y)
        delta = cp.Variable(complex=True)
        w = e - delta * z
        cost = lam * cp.square(cp.abs(delta)) + cp.sum(cp.multiply(lam_w, cp.square(cp.abs(w))))
        reference = cp.Problem(cp.Minimize(cost), [cp.norm(w) <= gamma]).solve(solver=cp.CLARABEL)
        r = s1.tradeoff(e, z, gamma, lam, lam_w)
        assert float(r.cost) == pytest.approx(reference, rel=1e-6)
        assert np.linalg.norm(r.w) <= gamma * (1 + 1e-9)


def test_a_tradeoff_without_a_price_costs_nothing():
    free = s1.tradeoff(np.array([1.0, 1j]), np.array([1.0, 1.0]), 1.2, 0.0, np.zeros(2))
    assert free.cost == 0.0 and np.linalg.norm(free.w) <= 1.2 * (1 + 1e-12)
    assert free.nu == np.abs(free.delta) > 0.1 and free.delta.imag != 0.0


def test_a_tradeoff_whose_disc_is_one_point_takes_it():
    only = s1.tradeoff(np.array([1.0]), np.array([2.0]), 0.0, 0.0, np.ones(1))
    assert only.delta == only.nu == 0.5 and only.cost == 0.0


def test_the_tradeoff_loses_no_digits_where_it_stops_just_short_of_no_delta():
    """Where w is free the answer is that of S1, here a billionth of the disc's radius of 1000."""
    z, short = gauss(np.random.default_rng(1), 2), np.linspace(1.1e-9, 2e-9, 20)
    e = 1000.0 * np.exp(1j) * z
    gamma = np.linalg.norm(e) * (1 - short)
    solution, exact = s1.tradeoff(e, z, gamma, 1.0, np.zeros(2)), s1.solve(e, z, gamma)
    np.testing.assert_allclose(exact.nu, 1000.0 * short, rtol=1e-6)
    np.testing.assert_allclose(solution.delta, exact.delta, rtol=1e-12)
    np.testing.assert_allclose(solution.nu, exact.nu, rtol=1e-12)


def test_the_tradeoff_within_the_tolerance_of_the_edge_is_least_squares():
    solution = s1.tradeoff(np.array([1.0, 1.0]), np.array([1.0, 0.0]), 1 - 5e-13, 1.0, np.zeros(2))
    assert solution.delta == solution.nu == solution.cost == 1.0


def test_a_tradeoff_of_a_silent_point_and_a_scalar_of_no_output_ask_for_no_division_by_zero():
    with np.errstate(all="raise"):
        silent = s1.tradeoff(np.array([3.0, 4.0]), np.zeros(2), np.array([5.0, 6.0, 4.9]), 1.0, np.ones(2))
        assert s1.least_squares_delta([1.0, 2.0], [0.0, 0.0]) == 0.0
    assert silent.cost.tolist() == [25.0, 25.0, np.inf] and silent.nu.tolist() == [0.0, 0.0, np.inf]


def test_tradeoff_below_b1_is_infinite():
    assert s1.tradeoff(np.array([1, 1j]), np.array([1, 1]), 1e-3, 1.0, np.ones(2)).cost == np.inf


@pytest.mark.parametrize("n_y", [1, 2, 3, 4])
def test_margin_matches_a_conic_solver(n_y):
    cp = pytest.importorskip("cvxpy")
    rng = np.random.default_rng(40 + n_y)
    for _ in range(8):
        e, z = gauss(rng, n_y), gauss(rng, n_y) * 10.0 ** rng.uniform(-1, 1, n_y)
        w_delta, w_w = rng.uniform(0.05, 1.0), rng.uniform(0.05, 1.0, n_y)
        delta, t = cp.Variable(complex=True), cp.Variable()
        limits = [cp.abs(delta) <= t * w_delta]
        limits += [cp.abs(e[j] / w_w[j] - delta * (z[j] / w_w[j])) <= t for j in range(n_y)]
        reference = cp.Problem(cp.Minimize(t), limits).solve(solver=cp.CLARABEL)
        assert float(s1.margin(e, z, w_delta, w_w)) == pytest.approx(reference, rel=1e-6)


@pytest.mark.parametrize("unit", [1.0, 1e-4, 1e4])
@pytest.mark.parametrize(
    ("angles", "accuracy"),
    [
        (lambda small: [0.0 * small, 2 * np.pi / 3 + 0 * small, 4 * np.pi / 3 + 0 * small], 1e-12),
        (lambda small: [0.0 * small, 1.3 + small, np.pi + small], 1e-12),
        (lambda small: [0.0 * small, np.pi - small, np.pi + small**2], 2e-10),
    ],
    ids=["apart", "two_opposite", "nearly_a_pair"],
)
def test_margin_on_three_active_discs_has_full_accuracy(angles, accuracy, unit):
    """delta and the residuals chosen so that all three discs meet in delta at the level t.

    Pulls that no half-plane holds make that point the optimum. Nearly a pair, the level of the triple is the
    root of a quadratic near its double root.
    """
    rng, n = np.random.default_rng(9), 4000
    t, scale = rng.uniform(0.5, 2.0, n), 10.0 ** rng.uniform(-2, 2, n)
    turned = np.array(angles(10.0 ** rng.uniform(-6, -0.6, n))).T + rng.uniform(0, 2 * np.pi, (n, 1))
    pulls = np.exp(1j * rng.permuted(turned, axis=1))
    z, w_w, w_delta = (
        gauss(rng, n, 2),
        scale[:, None] * rng.uniform(0.1, 1.0, (n, 2)),
        scale * rng.uniform(0.1, 1, n),
    )
    delta = -pulls[:, 0] * t * w_delta
    e = delta[:, None] * z + pulls[:, 1:] * z / np.abs(z) * t[:, None] * w_w
    e, w_w = unit * e, unit * w_w
    w_delta = unit * w_delta
    np.testing.assert_allclose(s1.margin(e, z, w_delta[:, None], w_w), t, rtol=accuracy)


@pytest.mark.unhurried
def test_margin_of_dense_degenerate_cases_is_bracketed():
    # Collinear centres, equal discs, a silent output: pairs and triples nearly coincide there.
    rng = np.random.default_rng(11)
    for k in range(300):
        z = np.array([1.0, rng.choice([1.0, 0.0, 1e-9, 1 + 1e-12])], complex)
        e = (
            rng.normal(size=2) * z
            + (rng.normal(size=2) * 10.0 ** rng.uniform(-16, -8)) * 1j * (k % 2)
            + (z == 0) * 0.1
        )
        w_delta, w_w = 10.0 ** rng.uniform(-3, 1), 10.0 ** rng.uniform(-3, 1, 2)
        t = float(s1.margin(e, z, w_delta, w_w))
        grid = np.linspace(-1.0, 1.0, 2001) * 5.0
        level = np.maximum(
            np.abs(grid) / w_delta, np.max(np.abs(e[:, None] - grid * z[:, None]) / w_w[:, None], axis=0)
        )
        assert t <= level.min() * (1 + 1e-9)
        slope = 1.0 / w_delta + np.max(np.abs(z) / w_w)
        if level.argmin() not in (0, len(grid) - 1):
            assert t >= level.min() - slope * 0.005 - 1e-7


@pytest.mark.parametrize("n_y", [2, 3])
def test_with_a_delta_an_output_the_margin_is_the_worst_of_the_outputs_alone(n_y):
    rng = np.random.default_rng(6)
    e, z = gauss(rng, 500, n_y), gauss(rng, 500, n_y)
    z[::7, 0] = 0.0
    w_delta, w_w = rng.uniform(0.1, 1, (500, n_y)), rng.uniform(0.1, 1, (500, n_y))
    t = s1.margin(e, z, w_delta, w_w)
    alone = [s1.margin(*(a[:, j : j + 1] for a in (e, z, w_delta, w_w))) for j in range(n_y)]
    np.testing.assert_allclose(t, np.max(alone, axis=0), rtol=1e-14)
    # One delta common to all is one of them: it never explains more.
    widest = np.broadcast_to(w_delta.max(axis=1, keepdims=True), w_delta.shape)
    assert (s1.margin(e, z, widest, w_w) <= s1.margin(e, z, widest[:, :1], w_w) * (1 + 1e-12)).all()
    e[3, 1] = np.nan
    assert np.isnan(s1.margin(e, z, w_delta, w_w)[3])


@pytest.mark.parametrize("bad", [np.nan, np.inf])
@pytest.mark.parametrize("separate", [False, True])
@pytest.mark.parametrize("place", range(4))
def test_one_number_that_is_not_finite_leaves_no_margin_of_its_point_alone(bad, separate, place):
    arguments = [np.ones((9, 3)) for _ in range(4)]
    if not separate:
        arguments[2] = np.ones((9, 1))
    arguments[place][4, -1] = bad
    t = s1.margin(*arguments)
    assert np.isnan(t).tolist() == [k == 4 for k in range(9)]
    np.testing.assert_allclose(np.delete(t, 4), 0.5)


def test_each_argument_of_the_margin_may_lead_the_shape():
    e, z, w_delta, w_w = (
        np.array([3.0, 1j]),
        np.ones(2),
        np.array([[0.5], [1.0]]),
        np.array([[2.0, 1.0], [1.0, 2.0]]),
    )
    alone = [float(s1.margin(e, z, w_delta[k], w_w[k])) for k in range(2)]
    assert s1.margin(e, z, w_delta, w_w).tolist() == pytest.approx(alone, rel=1e-14)
    both = s1.margin(e, z, np.array([0.5, 1.0]), w_w)
    assert both.tolist() == pytest.approx([3.0 / 2.5, 3.0 / 1.5])
    assert s1.margin(e, z, np.ones(1), np.ones(2)).shape == ()
    # One output whose Z is 0: its disturbance alone.
    assert s1.margin([3.0], [0.0], 1.0, [2.0]) == 1.5


def test_no_more_than_64_outputs_share_a_delta():
    ones = np.ones(65)
    assert s1.margin(ones[:64], ones[:64], 1.0, ones[:64]) == pytest.approx(0.5)
    with pytest.raises(InputError, match=r"margin.*65 outputs.*at most 64"):
        s1.margin(ones, ones, 1.0, ones)
    assert s1.margin(ones, ones, ones, ones) == pytest.approx(0.5)


@pytest.mark.parametrize(
    "call, word",
    [
        (lambda: s1.solve(np.ones(2), np.ones(3), 1.0), "shapes"),
        (lambda: s1.solve(np.ones((4, 2)), np.ones((3, 2)), 1.0), "broadcast"),
        (lambda: s1.solve(1.0, np.ones(1), 1.0), "shapes"),
        (lambda: s1.solve(np.ones(1), 1.0, 1.0), "shapes"),
        (lambda: s1.solve(np.ones(0), np.ones(0), 1.0), "shapes"),
        (lambda: s1.margin(np.ones(2), np.ones(2), 1.0, 1.0), "W_w"),
        (lambda: s1.margin(1.0, 1.0, 1.0, 1.0), "shapes"),
        (lambda: s1.solve(np.ones(2), np.ones(2), -1.0), "gamma_w"),
        (lambda: s1.margin(np.ones(2), np.ones(2), 1.0, np.ones(3)), "W_w"),
        (lambda: s1.margin(np.ones(2), np.ones(2), 1.0, np.array([2.0, 0.0])), "W_w"),
        (lambda: s1.margin(np.ones(2), np.ones(2), -1.0, np.ones(2)), "W_delta"),
        (lambda: s1.margin(np.ones(2), np.ones(2), [1.0, -1.0], np.ones(2)), "W_delta"),
        (lambda: s1.margin(np.ones(2), np.ones(2), np.ones(3), np.ones(2)), "W_delta"),
    ],
)
def test_bad_arguments_are_named(call, word):
    with pytest.raises(InputError, match=word):
        call()


@pytest.mark.parametrize("n_y", [1, 2, 3])
def test_least_has_the_sizes_and_what_solve_and_the_least_squares_scalar_say(n_y):
    """Random points, and such as cancel: parallel, orthogonal, zero, and decades away from 1."""
    random = np.random.default_rng(n_y)
    e, z = (random.standard_normal((40, n_y)) + 1j * random.standard_normal((40, n_y)) for _ in range(2))
    e[:5], z[5:10], e[10:15] = (2 + 1j) * z[:5], 0.0, 0.0
    e[15:20] *= 1e-200
    z[20:25] *= 1e180
    if n_y > 1:
        e[25:30, 0], e[25:30, 1] = z[25:30, 1].conj(), -z[25:30, 0].conj()
        e[30:35, 0], z[30:35, 1] = 0.0, 0.0
    sizes = s1.least(e, z)
    scale = np.abs(e).max(axis=1) + (np.abs(e).max(axis=1) == 0)
    np.testing.assert_allclose(sizes.e, np.linalg.norm(e / scale[:, None], axis=1) * scale, rtol=1e-13)
    np.testing.assert_allclose(sizes.b1, s1.solve(e, z, sizes.e).b1, rtol=1e-12)
    np.testing.assert_allclose(
        sizes.delta, np.abs(s1.least_squares_delta(e, z)), rtol=1e-12, atol=1e-15 * sizes.delta.max()
    )
    assert (sizes.z[5:10] == 0).all() and (sizes.delta[5:10] == 0).all()
    assert sizes.z[20] == pytest.approx(1e180 * np.linalg.norm(z[20] / 1e180), rel=1e-13)
    most = s1.least(1e308 * np.eye(1, n_y), 1e308 * np.eye(1, n_y))
    assert most.delta == pytest.approx(1.0) and most.b1 == 0.0
    e[0, 0], z[1, 0] = np.nan, np.inf
    assert np.isnan(np.array(s1.least(e[:2], z[:2]))).all()
