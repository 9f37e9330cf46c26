"""The pieces of the proof that a weight lies above a bound: polynomials, Bernstein coefficients, Routh's
array and the units, each against its definition."""

import math

import numpy as np
import pytest
import scipy.linalg as sl

from lpvguard.base.errors import InputError
from lpvguard.engine.overbound import certificate as proof
from lpvguard.engine.overbound import weight as weight_module
from lpvguard.engine.overbound.bound import SampledBound
from lpvguard.engine.overbound.certificate import is_hurwitz, squared, verify_overbound
from lpvguard.engine.overbound.noise import subtract_noise
from lpvguard.engine.overbound.weight import Weight, polynomial_roots

# ---------------------------------------------------------------- the bound's samples


def test_units_are_the_powers_of_two_in_the_middle_and_the_change_is_exact():
    omega, bound = np.array([3.0, 10.0, 700.0]), np.array([1e-3, np.nan, 0.25])
    read = SampledBound.read("here", omega, bound, None)
    assert read.unit == 2.0 ** round(0.5 * math.log2(3.0 * 700.0)) == 64.0
    assert read.level == 2.0 ** round(0.5 * math.log2(1e-3 * 0.25)) == 2.0**-6
    assert read.omega.tolist() == [3.0, 700.0] and (read.bound * read.level).tolist() == [1e-3, 0.25]
    assert read.without_data == (10.0,) and read.floored == ()
    assert read.y.tolist() == [(3.0 / 64) ** 2, (700.0 / 64) ** 2]
    turned = read.reciprocal()
    assert turned.bound.tolist() == [1 / b for b in read.bound] and turned.omega is read.omega


def test_a_floor_lifts_what_is_below_it_and_a_value_at_the_floor_stays():
    read = SampledBound.read("here", [1.0, 2.0, 3.0, 4.0], [0.0, 0.5, 0.4, np.nan], 0.5)
    assert (read.bound * read.level).tolist() == [0.5, 0.5, 0.5]
    assert read.floored == (1.0, 3.0) and read.without_data == (4.0,)
    alone = SampledBound.read("here", [5.0], [2.0], None)
    assert (alone.bound * alone.level).tolist() == [2.0] and alone.floored == ()


@pytest.mark.parametrize(
    ("omega", "bound", "floor", "words"),
    [
        ([1.0, 2.0], [1.0, 2e60], None, "a range of at most 1e\\+60"),
        ([1.0, 2.0], [1.0, 0.0], None, "bound at 2 rad/s: is 0, but no weight"),
        ([0.0, 2.0], [1.0, 1.0], None, "omega\\[0\\]"),
        ([1.0, 1.0], [1.0, 1.0], None, "omega\\[1\\].*strictly increasing"),
        ([1.0, 2.0, 1.5], [1.0, 1.0, 1.0], None, "omega\\[2\\].*strictly increasing"),
        ([1.0, np.inf], [1.0, 1.0], None, "omega\\[1\\].*finite frequency"),
        ([1.0, 2.0], [1.0, -1e-9], None, "bound\\[1\\] at 2 rad/s"),
        ([1.0, 2.0], [np.inf, 1.0], None, "bound\\[0\\] at 1 rad/s"),
        ([1.0, 2.0], [1.0, 1.0], 0.0, "floor"),
        ([1.0, 2.0], [1.0, 1.0], np.inf, "floor"),
        ([], [], None, "length >= 1"),
        ([1.0, 2.0], [1.0], None, "length >= 1"),
        ([[1.0]], [[1.0]], None, "length >= 1"),
        ([1.0, 2.0], [np.nan, np.nan], None, "every value is NaN"),
    ],
)
def test_what_is_no_bound_is_named(omega, bound, floor, words):
    with pytest.raises(InputError, match=words):
        SampledBound.read("here", omega, bound, floor)


def test_the_largest_range_is_still_a_bound():
    assert SampledBound.read("here", [1.0, 2.0], [1.0, 1e60], None).bound[1] > 0


# ---------------------------------------------------------------- polynomials


@pytest.mark.parametrize(
    "coefficients", [[3.0], [2.0, -1.0], [1.0, 0.4, 9.0], [1.0, 2.0, 3.0, 4.0], [2.0, 0, 1, -3, 5]]
)
@pytest.mark.parametrize("unit", [1.0, 8.0, 0.25])
def test_the_squared_magnitude_is_the_polynomial_of_the_squared_frequency(coefficients, unit):
    magnitudes = squared(np.array(coefficients), unit)
    assert len(magnitudes) == len(coefficients)
    for w in (0.0, 0.3, 1.0, 7.0):
        wanted = abs(np.polyval(coefficients, 1j * w)) ** 2
        assert np.polyval(magnitudes[::-1], (w / unit) ** 2) == pytest.approx(wanted, rel=1e-12)


def test_routh_agrees_with_the_roots_of_random_polynomials():
    random = np.random.default_rng(5)
    seen = set()
    for _ in range(300):
        n = int(random.integers(0, 6))
        roots = random.normal(-0.4, 0.7, n)
        pairs = random.normal(-0.4, 0.7, 2) + 1j * random.uniform(0.1, 2, 2)
        extra = int(random.integers(0, 3))
        all_roots = np.concatenate([roots, pairs[:extra], pairs[:extra].conj()])
        polynomial = np.real(np.poly(all_roots)) * random.choice([-2.0, 0.5])
        stable = bool((all_roots.real < 0).all())
        assert is_hurwitz(np.atleast_1d(polynomial)) == stable
        seen.add((len(all_roots), stable))
    assert {(n, s) for n in range(1, 6) for s in (True, False)} <= seen


@pytest.mark.parametrize(
    ("coefficients", "stable"),
    [
        ([1.0, 0.0], False),  # at the origin
        ([1.0, 0.0, 4.0], False),  # a pair on the axis
        ([1.0, 1.0, 4.0, 4.0], False),  # the same, and a stable root
        ([1.0, 2.0, 1.0], True),
        ([5.0], True),
        ([-5.0], True),
        ([-1.0, -1.0], True),
        ([1.0, 1e-300], True),
        ([1.0, 3.0, 3.0, 9.0000001], False),
        ([1.0, 3.0, 3.0, 8.9999999], True),
        ([1.0, -1.0, 5.0, 3.0], False),  # one of the wrong sign between others
        ([-1.0, 1.0], False),
    ],
)
def test_routh_on_the_border(coefficients, stable):
    assert is_hurwitz(np.array(coefficients)) is stable


@pytest.mark.parametrize("degree", [3, 4, 6])
def test_bernstein_coefficients_make_the_polynomial_and_bound_its_monomials(degree):
    polynomial = np.pad([2.0, -3.0, 0.5, 1.5], (0, degree - 3))
    lo, hi = np.array([0.0, 0.5, 2.0]), np.array([1.0, 3.0, 2.25])
    powers = proof._bernstein(lo, hi, degree)
    coefficients, sizes = (np.tensordot(c, powers, 1) for c in (polynomial, np.abs(polynomial)))
    t = np.linspace(0, 1, 7)
    basis = [math.comb(degree, k) * t**k * (1 - t) ** (degree - k) for k in range(degree + 1)]
    for i in range(3):
        y = lo[i] + t * (hi[i] - lo[i])
        np.testing.assert_allclose(
            coefficients[i] @ basis, np.polyval(polynomial[::-1], y), rtol=1e-12, atol=1e-12
        )
        np.testing.assert_allclose(sizes[i] @ basis, np.polyval(np.abs(polynomial[::-1]), y), rtol=1e-12)


@pytest.mark.parametrize("slope", [-2.0, -0.5, 0.0, 0.4, 0.9, 1.0, 1.7])
def test_a_piece_is_proved_where_it_holds_and_not_where_a_point_refutes_it(slope):
    """p >= f c y^q on [lo, hi] for p = 1 + y + y^2, q = 2 + y: the least ratio of a fine grid decides."""
    p, q = np.array([1.0, 1.0, 1.0]), np.array([2.0, 1.0, 0.0])
    lo, hi = np.array([0.8]), np.array([1.0])
    shape = (np.array([0.9]), np.array([math.log(0.7)]), np.array([slope]))
    y = np.linspace(0.8, 1.0, 2001)
    bound = 0.7 * (y / 0.9) ** slope
    np.testing.assert_allclose(
        proof._bound_squared(y, *(np.full(len(y), s[0]) for s in shape)), bound, rtol=1e-12
    )
    least = float(((1 + y + y**2) / (bound * (2 + y))).min())
    # The line over the bound costs the square of the piece's relative length, an eighth of its curvature.
    cost = 0.25**2 / 8 * abs(slope * (slope - 1)) + 0.01
    assert proof._nonnegative(p, q, least * (1 - cost), lo, hi, *shape).tolist() == [True]
    assert proof._nonnegative(p, q, least * (1 + 1e-6), lo, hi, *shape).tolist() == [False]
    value, point = proof._attained(p, q, y, tuple(np.full(len(y), s[0]) for s in shape))
    assert value == pytest.approx(least, rel=1e-9) and value < least
    assert (1 + point + point**2) / (0.7 * (point / 0.9) ** slope * (2 + point)) == pytest.approx(
        least, rel=1e-12
    )


def test_a_constant_piece_may_begin_at_zero_and_a_pole_there_is_no_least_point():
    zero = proof._bound_squared(np.array([0.0]), np.array([2.0]), np.array([math.log(3.0)]), np.array([0.0]))
    assert zero.tolist() == [pytest.approx(3.0)]
    p, q = np.array([5.0, 1.0]), np.array([0.0, 1.0])
    shapes = tuple(np.full(2, s) for s in (1.0, 0.0, 0.0))
    value, point = proof._attained(p, q, np.array([0.0, 2.0]), shapes)
    assert (value, point) == (pytest.approx(3.5), 2.0)


# ---------------------------------------------------------------- whole certificates, by hand


def test_the_certificate_of_a_first_order_lag_is_known_by_hand():
    """|W|^2 = 4 / (1 + w^2) over a bound of 1 from 0.5 to 1.5 rad/s: 2 at DC, 2 / sqrt(3.25) at the end."""
    W = Weight(np.array([2.0]), np.array([1.0, 1.0]))
    report = verify_overbound(W, [0.5, 1.5], [1.0, 1.0])
    assert report.ok and report.stable and report.minimum_phase
    assert report.min_ratio == pytest.approx(2 / math.sqrt(3.25), rel=1e-8)
    assert report.min_ratio_at == pytest.approx(1.5, rel=1e-8)
    assert report.max_ratio == pytest.approx(2.0, rel=1e-8) and report.max_ratio_at == 0.0
    assert report.omega_max == 1.5 and report.intervals >= 4
    proper = Weight(np.array([0.5, 2.0]), np.array([1.0, 1.0]))
    known = verify_overbound(proper, [0.5, 1.5], [0.4, 0.4])
    assert known.ok and known.omega_max == math.inf
    assert known.min_ratio == pytest.approx(0.5 / 0.4, rel=1e-8) and known.min_ratio_at == math.inf
    assert known.to_dict()["omega_max"] == "inf" and known.to_dict()["min_ratio_at"] == "inf"
    assert not verify_overbound(proper, [0.5, 1.5], [0.6, 0.6]).ok


def test_a_zero_on_the_axis_leaves_no_ratio():
    """|W| = 0 at 1 rad/s, a sample; beside a bound that is met everywhere else."""
    W = Weight(np.array([1.0, 0.0, 1.0]), np.array([1.0, 2.0, 1.0]))
    report = verify_overbound(W, [0.5, 1.0, 2.0], [0.1, 0.1, 0.1])
    assert report.min_ratio == 0.0 and report.min_ratio_at == 1.0
    assert not report.ok and not report.minimum_phase and report.stable
    upside = verify_overbound(Weight(W.den, W.num), [0.5, 1.0, 2.0], [0.1, 0.1, 0.1])
    assert upside.max_ratio == math.inf and not upside.stable and upside.minimum_phase


def test_the_least_ratio_between_two_samples_is_where_calculus_puts_it():
    """|W|^2 = 1 + w^2 over a bound of w^(1/2) from 0.25 to 9 rad/s."""
    W = Weight(np.array([1.0, 1.0]), np.array([1e-9, 1.0]))
    omega = np.array([0.25, 9.0])
    report = verify_overbound(W, omega, np.sqrt(omega))
    # (1 + w^2) / w has its least value 2 at w = 1.
    assert report.min_ratio == pytest.approx(math.sqrt(2.0), rel=1e-7)
    assert report.min_ratio_at == pytest.approx(1.0, rel=1e-3)


def test_the_unit_of_frequency_and_of_the_bound_change_nothing_but_themselves():
    W = Weight(np.array([1.0, 3.0, 2.0]), np.array([1.0, 0.5, 4.0]))
    omega, bound = np.array([0.3, 1.0, 4.0]), np.array([0.4, 0.6, 0.5])
    one = verify_overbound(W, omega, bound)
    a, b = 2.0**40, 2.0**-30
    scaled = Weight(b * W.num * a ** np.array([0.0, 1, 2]), W.den * a ** np.array([0.0, 1, 2]))
    other = verify_overbound(scaled, a * omega, b * bound)
    assert other.min_ratio == pytest.approx(one.min_ratio, rel=1e-9)
    assert other.max_ratio == pytest.approx(one.max_ratio, rel=1e-9)
    assert other.max_ratio_at == pytest.approx(a * one.max_ratio_at, rel=1e-9)
    assert other.intervals == one.intervals


@pytest.fixture
def rounds(monkeypatch) -> list[int]:
    """The numbers of intervals that were tested, one by one."""
    sizes, asked = [], proof._nonnegative
    monkeypatch.setattr(proof, "_nonnegative", lambda *a: (sizes.append(len(a[3])), asked(*a))[1])
    return sizes


NOTCHED = Weight([1.0, 0.1, 1.0], [1.0, 2.0, 1.0])
"""|W| has its least value, 0.05, at 1 rad/s."""


@pytest.mark.parametrize("omega", [[0.1, 0.2], [5.0, 10.0], [0.1, 10.0]], ids=["beyond", "before", "inside"])
def test_a_least_ratio_is_found_beyond_the_samples_too(omega, rounds):
    report = verify_overbound(NOTCHED, omega, [0.04, 0.04])
    assert report.ok and report.min_ratio == pytest.approx(0.05 / 0.04, rel=2e-9)
    assert report.min_ratio_at == pytest.approx(1.0, rel=1e-3)
    assert report.intervals == sum(rounds) > len(rounds) > 4


def test_a_proved_ratio_is_half_a_billionth_below_the_one_attained():
    for ratio in (1 + 0.4e-9, 1 + 0.6e-9):
        report = verify_overbound(Weight([ratio], [1.0]), [1.0], [1.0])
        assert report.min_ratio == pytest.approx(ratio * (1 - 0.5e-9), rel=1e-12) and report.intervals == 4
        assert report.ok == (ratio > 1 + 0.5e-9)


def test_a_search_that_takes_too_many_tests_or_halvings_proves_nothing(rounds, monkeypatch):
    top, bottom = squared(NOTCHED.num, 1.0), squared(NOTCHED.den, 1.0)
    samples = SampledBound.read("here", [0.3, 2.0], [1.0, 1.0], None)

    def least() -> tuple[float, float, int]:
        rounds.clear()
        return proof._least_ratio(top, bottom, samples, strict=True)

    assert least()[0] == pytest.approx(0.05, rel=1e-6) and len(rounds) > 3
    first, second = rounds[0], rounds[0] + rounds[1]
    monkeypatch.setattr(proof, "_MAX_TESTS", first)
    assert least()[0] == 0.0 and sum(rounds) == second, "as many as allowed, and those that begin"
    monkeypatch.setattr(proof, "_MAX_TESTS", first - 1)
    result = least()
    assert result[0] == 0.0 and result[2] == sum(rounds) == first and 0.0 <= result[1] <= 2.0
    monkeypatch.undo()
    monkeypatch.setattr(proof, "_MAX_HALVINGS", 2)
    result = proof._least_ratio(top, bottom, samples, strict=True)
    assert result[0] == 0.0 and result[2] == second and 0.0 <= result[1] <= 2.0


def test_where_rounding_stops_a_proof_its_margin_grows():
    """A pole and a zero at 1 rad/s with a damping of 1e-3: the terms of both cancel to a millionth."""
    W = Weight([1.0, 1.8e-3, 1.0], [1.0, 2e-3, 1.0])
    report = verify_overbound(W, [0.1, 10.0], [0.8, 0.8])
    assert report.ok and report.min_ratio == pytest.approx(0.9 / 0.8, rel=1e-6)
    assert 0.9 / 0.8 - report.min_ratio > 1e-8


def test_rounding_is_taken_off_every_term(monkeypatch):
    monkeypatch.setattr(proof, "_ROUNDING", 0.1)
    p, q = np.array([2.0, -1.0]), np.array([3.0, -1.0])  # at 1/2: 1.5 of 2.5, and 2.5 of 3.5
    shape = tuple(np.array([v]) for v in (1.0, 0.0, 0.0))
    value, point = proof._attained(p, q, np.array([0.5]), shape)
    assert (value, point) == (pytest.approx((1.5 - 0.25) / 2.5, rel=1e-12), 0.5)
    limit = (1.5 - 0.25) / (2.5 + 0.35)
    for factor, proved in ((limit * (1 - 1e-9), True), (limit * (1 + 1e-9), False)):
        at = np.array([0.5])
        assert proof._nonnegative(p, q, factor, at, at, *shape).tolist() == [proved]


@pytest.mark.parametrize("bottom", [[0.0, 1.0], [-1e-20, 1.0]])
def test_a_common_zero_is_no_least_point(bottom):
    shapes = tuple(np.full(2, s) for s in (1.0, 0.0, 0.0))
    value, point = proof._attained(np.array([0.0, 1.0]), np.array(bottom), np.array([0.0, 2.0]), shapes)
    assert (value, point) == (pytest.approx(1.0), 2.0)


def test_what_is_no_bound_of_a_check_is_told_by_its_name():
    W = Weight([1.0], [1.0])
    for name, prefix in (("", "weight check: "), ("W_delta", "W_delta: ")):
        with pytest.raises(InputError, match=f"^{prefix}"):
            verify_overbound(W, [1.0], [np.nan], name=name)


# ---------------------------------------------------------------- weights, noise


@pytest.mark.parametrize("spread", [1.0, 1e12, 1e-12])
def test_roots_are_found_in_any_unit(spread):
    roots = np.array([-1.0, -2.0, -5.0]) * spread
    roots_found = np.sort_complex(polynomial_roots(3.0 * np.poly(roots)))
    np.testing.assert_allclose(roots_found, np.sort_complex(roots.astype(complex)), rtol=1e-9)
    assert polynomial_roots(np.array([2.0])).size == 0
    np.testing.assert_allclose(np.sort(polynomial_roots(np.array([1.0, 3.0, 0.0])).real), [-3.0, 0.0])
    np.testing.assert_allclose(np.sort(polynomial_roots(np.array([-2.0, 0.0, 8.0])).real), [-2.0, 2.0])


@pytest.mark.parametrize("name", ["num", "den"])
@pytest.mark.parametrize("bad", [[1.0, np.nan], [np.inf, 1.0], [0.0, 1.0], [], [[1.0, 2.0]], 3.0])
def test_coefficients_of_a_weight_are_finite_numbers_and_the_first_is_not_zero(name, bad):
    with pytest.raises(InputError, match=f"weight: {name}: .*whose first is not 0"):
        Weight(**({"num": [1.0], "den": [1.0, 2.0]} | {name: bad}))


def test_a_weight_keeps_its_coefficients_and_is_complex_where_it_is_asked_for():
    original = np.array([1.0, 2.0])
    W = Weight(original, original + 1)
    original[0] = 7.0
    assert W.num.tolist() == [1.0, 2.0]
    for coefficients in (W.num, W.den):
        with pytest.raises(ValueError, match="read-only"):
            coefficients[0] = 7.0
    assert W(2).dtype == complex and W(2) == 4 / 7


@pytest.mark.parametrize(
    ("zeros", "poles"),
    [
        ([], [-2.0]),
        ([-3.0], [-2.0]),
        ([-3.0], [-2.0, -0.5]),
        ([-3.0], [-1e-6, -1e6]),
        ([-1.0], [-1.0]),
        ([], []),
        ([], [-1 + 2j, -1 - 2j]),
        ([-4.0], [-1 + 2j, -1 - 2j, -7.0]),
        ([-1 + 1j, -1 - 1j], [-0.1, -0.2, -30.0]),
        ([-1 + 1j, -1 - 1j, -5.0], [-0.1, -0.2, -30.0]),
        ([-1.0, -2.0, -3.0, -4.0], [-0.5 + 1j, -0.5 - 1j, -6.0, -8.0]),
    ],
)
def test_a_realisation_has_the_response_of_its_weight(zeros, poles):
    W = Weight(*(k * np.atleast_1d(np.real(np.poly(v))) for k, v in ((1.5, zeros), (0.5, poles))))
    A, B, C, D = W.to_state_space()
    assert len(A) == W.order == len(poles) and B.shape == (len(poles), 1) and C.shape == (1, len(poles))
    for s in (0.0, 0.7j, 5j, 0.3 + 2j):
        response = (C @ np.linalg.solve(s * np.eye(len(A)) - A, B) + D)[0, 0]
        assert response == pytest.approx(complex(W(s)), rel=1e-9)
    np.testing.assert_allclose(
        np.sort_complex(np.linalg.eigvals(A)), np.sort_complex(np.array(poles, complex)), rtol=1e-7
    )


def test_noise_is_taken_off_point_by_point():
    B, n, omega = (
        np.array([5.0, 3.0, 1.0, np.nan]),
        np.array([3.0, 3.0, 2.0, 1.0]),
        np.array([1.0, 2.0, 3.0, 4.0]),
    )
    values, lost = subtract_noise(B, n, omega, disturbance_set="covering", floor=[0.1, 0.2, 0.3, 0.4])
    np.testing.assert_allclose(values, [4.0, 0.2, 0.3, np.nan])
    assert lost == [2.0, 3.0]
    values, lost = subtract_noise(B, n, omega, disturbance_set="paper", floor=0.5)
    np.testing.assert_allclose(values, [2.0, 0.5, 0.5, np.nan])
    assert lost == [2.0, 3.0]


def test_what_noise_leaves_below_one_is_not_lost_and_every_floor_is_looked_at():
    values, lost = subtract_noise([1.0], [0.5], [1.0], disturbance_set="paper", floor=0.1)
    assert values.tolist() == [0.5] and lost == []
    for floor in ([0.1, 0.0], [np.inf, 0.1], [0.1, np.nan], [-1.0, 0.1]):
        with pytest.raises(InputError, match="floor"):
            subtract_noise([1.0, 1.0], [0.5, 0.5], [1.0, 2.0], disturbance_set="paper", floor=floor)
    small = subtract_noise([0.5, 0.2], [0.3, 0.2], [1.0, 2.0], disturbance_set="covering", floor=0.1)
    np.testing.assert_allclose(small[0], [0.4, 0.1])
    for wrong in ([-1e-9, 0.2], [0.2, np.inf]):
        with pytest.raises(InputError, match="finite magnitude"):
            subtract_noise(wrong, [0.1, 0.1], [1.0, 2.0], disturbance_set="paper", floor=0.1)


@pytest.mark.parametrize("gain", [1e-6, 1.0, 1e7])
def test_the_states_of_a_realisation_are_reached_as_well_as_they_are_seen(gain):
    """The diagonals of both Gramians agree within a factor four."""
    W = Weight(gain * np.poly([-3.0, -200.0, -0.5]), np.poly([-1.0, -1e3, -0.01]))
    A, B, C, _ = W.to_state_space()
    reach = np.diag(sl.solve_continuous_lyapunov(A, -B @ B.T))
    seen = np.diag(sl.solve_continuous_lyapunov(A.T, -C.T @ C))
    assert (reach < 4 * seen).all() and (seen < 4 * reach).all()


def test_sections_go_from_slow_to_fast_and_the_single_pole_comes_last():
    """Pairs of real poles, complex pairs by their frequency."""
    W = Weight([1.0], np.real(np.poly([-1 + 9j, -1 - 9j, -0.1, -0.3, -2 + 2j, -2 - 2j, -50.0])))
    A = W.to_state_space()[0]
    sizes = [np.sqrt(np.linalg.det(A[k : k + 2, k : k + 2])) for k in (0, 2, 4)]
    np.testing.assert_allclose(sizes, [np.sqrt(0.03), np.sqrt(8.0), np.sqrt(82.0)], rtol=1e-6)
    assert A[6, 6] == pytest.approx(-50.0, rel=1e-6)
    factors = [f.tolist() for f in weight_module._quadratics(np.array([-4.0, -0.01 + 0.01j, -0.01 - 0.01j]))]
    assert [len(f) for f in factors] == [3, 2] and factors[1] == [1.0, 4.0]
    three = weight_module._quadratics(np.array([-1 + 9j, -1 - 9j, -0.5 + 0.1j, -0.5 - 0.1j]))
    assert [round(float(f[-1]), 6) for f in three] == [0.26, 82.0]


def test_a_magnitude_of_zero_is_one():
    values, lost = subtract_noise([0.0, 1.0], [0.0, 0.0], [1.0, 2.0], disturbance_set="paper", floor=0.1)
    assert values.tolist() == [0.1, 1.0] and lost == [1.0]
