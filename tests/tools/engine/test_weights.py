"""Stage 4: a fitted weight lies above its bound, is nearly as tight as possible, and its certificate cannot
be fooled."""

import json
import math
import statistics
import sys
from collections import Counter
from collections.abc import Iterator
from itertools import islice, pairwise

import numpy as np
import pytest

from lpvguard.base.errors import InputError
from lpvguard.engine.overbound import minimax
from lpvguard.engine.overbound.certificate import verify_overbound
from lpvguard.engine.overbound.fit import fit_overbound
from lpvguard.engine.overbound.noise import subtract_noise
from lpvguard.engine.overbound.weight import Weight
from lpvguard.extras.bench._peers import ask

BAND = np.geomspace(1e-3, 1e3, 401)


def from_breaks(zeros, poles, gain=1.0):
    """gain prod(s/z + 1) / prod(s/p + 1); ``zeros`` and ``poles`` are positive or in conjugate pairs,
    rad/s."""
    num, den = (np.atleast_1d(np.real(np.poly(-np.asarray(v)) / np.prod(v))) for v in (zeros, poles))
    return Weight(gain * num, den)


def dense(omega, bound, per_piece=40):
    """Fine grid with the log-log interpolated bound, a factor 1000 beyond both ends: independent of the
    package."""
    known = ~np.isnan(bound)
    omega, bound = np.asarray(omega)[known], np.asarray(bound)[known]
    pieces = [np.geomspace(a, b, per_piece) for a, b in pairwise(omega)]
    below, beyond = omega[0] * np.geomspace(1e-3, 1, 200), omega[-1] * np.geomspace(1, 1e3, 200)
    grid = np.unique(np.concatenate([[0.0], below, *pieces, beyond]))
    return grid, np.exp(np.interp(np.log(np.maximum(grid, 1e-300)), np.log(omega), np.log(bound)))


def alternation_db(fit, omega, bound):
    """Lower limit of any weight's worst ratio, from this fit alone (de la Vallee-Poussin).

    Let the ratio of a fit of order n be >= H and <= L in turn at 2n + 2 points. A weight of order n whose
    worst ratio were below H/L would make N D* - N* D, of degree 2n in w^2, change sign 2n + 1 times on w >=
    0.
    """
    grid, b = dense(omega, bound, per_piece=200 if len(omega) < 100 else 20)
    grid, b = np.append(grid, 1e9 * grid[-1]), np.append(b, b[-1])
    r = 20 * np.log10(fit.weight.magnitude(grid) / b)

    def turns(low, high):
        side = (r >= high).astype(int) - (r <= low)
        side = side[side != 0]
        return np.count_nonzero(np.diff(side)) + 1 if high > low else 0

    best = 0.0
    for low in r.min() + np.geomspace(1e-4, 1.0, 40):  # highest H for each L
        below, above = low, r.max()
        for _ in range(30):
            high = (below + above) / 2
            below, above = (high, above) if turns(low, high) >= 2 * fit.order + 2 else (below, high)
        best = max(best, below - low)
    return best


def check(fit, omega, bound, gap_db=0.01):
    """What every fit owes: above the bound everywhere, honest about its worst ratio, within ``gap_db`` of the
    optimum."""
    grid, b = dense(omega, bound)
    ratio = fit.weight.magnitude(grid) / b
    assert ratio.min() >= 1.0
    assert 20 * math.log10(ratio.max()) <= fit.worst_ratio_db + 1e-9
    assert 20 * math.log10(ratio.max()) >= fit.worst_ratio_db - 0.02
    assert fit.worst_ratio_db - fit.lp_optimum_db <= gap_db
    assert fit.certificate["ok"]
    assert fit.order == fit.weight.order and fit.weight.num.size == fit.weight.den.size
    assert np.all(fit.weight.poles().real < 0) and np.all(fit.weight.zeros().real < 0)
    return fit


# ---------------------------------------------------------------- recovery and optimality


@pytest.mark.parametrize(
    ("zeros", "poles", "gain"),
    [
        ([1.0, 2.0, 0.5], [0.1, 8.0, 20.0], 3.0),
        ([0.3, 0.3, 3.0], [0.05, 1.0, 10.0], 1e-6),
        ([0.2 + 0.5j, 0.2 - 0.5j, 4.0], [0.1, 1.0 + 2.0j, 1.0 - 2.0j], 1e5),
        ([0.05, 1.0, 20.0], [0.2, 4.0, 5.0], 0.02),
    ],
)
def test_an_exact_third_order_weight_is_recovered(zeros, poles, gain):
    truth = from_breaks(zeros, poles, gain)
    omega = np.geomspace(1e-4, 1e4, 1001)
    fit = check(fit_overbound(omega, truth.magnitude(omega)), omega, truth.magnitude(omega))
    assert fit.order == 3
    error = 20 * np.log10(fit.weight.magnitude(omega) / truth.magnitude(omega))
    assert np.max(np.abs(error)) <= 0.01
    assert fit.worst_ratio_db <= 0.01


@pytest.mark.unhurried
@pytest.mark.parametrize("order", [1, 2, 3, 4])
@pytest.mark.parametrize("shape", ["rise", "fall", "hump", "walk"])
def test_no_weight_of_that_order_is_tighter(order, shape):
    omega = np.geomspace(1e-2, 1e2, 41)
    walk = np.cumsum(np.random.default_rng(5).standard_normal(41) * 0.3)
    bound = {
        "rise": omega**1.3,
        "fall": omega**-1.5,
        "hump": 1 + 10 * np.exp(-(np.log(omega) ** 2)),
        "walk": np.exp(walk),
    }[shape]
    fit = check(fit_overbound(omega, bound, order=order), omega, bound)
    if fit.order == order:  # else the order below is as good, and it is the one with the full alternation
        assert fit.worst_ratio_db - alternation_db(fit, omega, bound) <= 0.02


def test_the_order_is_the_smallest_whose_successors_do_not_pay():
    omega = BAND
    bound = from_breaks([0.3, 2.0], [0.02, 30.0]).magnitude(omega)
    single = {n: fit_overbound(omega, bound, order=n).worst_ratio_db for n in range(4)}
    assert fit_overbound(omega, bound).order == 2
    assert fit_overbound(omega, bound, tol_db=single[1] - single[2] + 0.5).order < 2
    assert fit_overbound(omega, bound, max_order=1).order <= 1


def test_a_plateau_does_not_stop_the_search():
    omega = np.geomspace(1e-2, 1e2, 60)
    bound = 1 + 10 * np.exp(-(np.log(omega) ** 2))  # symmetric: orders 1 and 3 gain nothing
    fit = check(fit_overbound(omega, bound), omega, bound)
    assert fit.ratios_db[1] == pytest.approx(fit.ratios_db[0], abs=0.01) and fit.order == 4


def test_states_that_gain_nothing_are_not_added():
    assert fit_overbound([1.0, 2.0, 4.0], [3.0, 3.0, 3.0], order=3).order == 0


# ---------------------------------------------------------------- difficult bounds


@pytest.mark.unhurried
def test_cliff_of_60_db_within_a_thousandth_is_bounded_though_not_tightly():
    omega, bound = np.array([1.0, 1.001]), np.array([1.0, 1000.0])
    check(fit_overbound(omega, bound), omega, bound, gap_db=3.0)


@pytest.mark.parametrize(
    ("omega", "bound"),
    [
        ([1.0], [3.0]),
        ([1e-5, 1e5], [2.0, 2.0]),
        ([1.0, 2.0], [1.0, 5.0]),
        ([1.0, 1e6], [1.0, 1e-6]),
        (np.geomspace(1e-3, 1e3, 7), [1, 2, 1, 5, 1, 9, 1]),
    ],
)
def test_few_samples_are_covered_by_a_certified_weight(omega, bound):
    omega, bound = np.asarray(omega), np.asarray(bound, dtype=float)
    check(fit_overbound(omega, bound), omega, bound)


def test_order_zero_is_the_largest_bound():
    fit = fit_overbound([1.0, 10.0, 100.0], [1.0, 4.0, 2.0], order=0)
    assert fit.weight.magnitude([0.0, 5.0, 1e9]) == pytest.approx([4.0] * 3, rel=2e-9)
    assert fit.worst_ratio_db == pytest.approx(20 * math.log10(4), abs=1e-6)


@pytest.mark.parametrize("gain", [1e-150, 1e150])
def test_the_unit_of_the_bound_does_not_matter(gain):
    omega = np.geomspace(0.1, 10, 30)
    bound = from_breaks([1.0], [3.0]).magnitude(omega)
    one, other = fit_overbound(omega, bound), fit_overbound(omega, gain * bound)
    assert other.weight.magnitude(omega) / gain == pytest.approx(one.weight.magnitude(omega), rel=1e-3)


@pytest.mark.unhurried
def test_same_input_same_bytes():
    omega = np.geomspace(0.01, 100, 50)
    bound = np.exp(np.random.default_rng(1).standard_normal(50))
    one, other = fit_overbound(omega, bound), fit_overbound(omega, bound)
    assert json.dumps(one.weight.to_dict() | one.certificate) == json.dumps(
        other.weight.to_dict() | other.certificate
    )


def test_strictly_proper_weights_roll_off_and_say_where_the_claim_ends():
    omega = np.geomspace(0.01, 100, 80)
    bound = from_breaks([50.0], [0.5, 2.0]).magnitude(omega)
    fit = fit_overbound(omega, bound, proper="strict")
    inside = np.geomspace(1e-4, 100, 4000)
    b = np.exp(np.interp(np.log(inside), np.log(omega), np.log(bound)))
    assert np.min(fit.weight.magnitude(inside) / b) >= 1.0
    assert fit.weight.num.size == fit.weight.den.size - 1
    assert fit.certificate["ok"] and fit.certificate["omega_max"] == 100.0
    assert fit.worst_ratio_db - fit.lp_optimum_db <= 0.01


@pytest.mark.parametrize("seed", range(4))
def test_strictly_proper_weights_stay_under_their_worst_ratio_beyond_the_band(seed):
    omega = np.geomspace(0.01, 100, 40)
    bound = np.exp(np.cumsum(0.2 * np.random.default_rng(seed).standard_normal(40)))
    fit = fit_overbound(omega, bound, proper="strict")
    beyond = fit.weight.magnitude(np.geomspace(100, 1e7, 2000)) / bound[-1]
    assert fit.certificate["ok"] and 20 * math.log10(beyond.max()) <= fit.worst_ratio_db + 0.1
    assert beyond[-1] <= 1e-3 * beyond[0]
    assert fit.worst_ratio_db - fit.lp_optimum_db <= 0.01


def test_one_sample_has_a_strictly_proper_weight_too():
    assert fit_overbound([3.0], [2.0], proper="strict").certificate["ok"]


# ---------------------------------------------------------------- floor, gaps, refusals


def test_a_floor_replaces_zeros_and_says_where():
    omega, bound = np.array([1.0, 2.0, 3.0]), np.array([1.0, 0.0, 0.05])
    fit = fit_overbound(omega, bound, floor=0.1)
    assert fit.floored == (2.0, 3.0)
    assert np.all(fit.weight.magnitude(omega) >= [1.0, 0.1, 0.1])
    assert verify_overbound(fit.weight, omega, bound, floor=0.1).ok


def test_bins_without_data_are_bridged_and_named():
    omega, bound = np.array([0.5, 1.0, 2.0, 4.0, 9.0]), np.array([np.nan, 1.0, np.nan, 16.0, np.nan])
    fit = check(fit_overbound(omega, bound), omega, bound)
    assert fit.certificate["without_data"] == [0.5, 2.0, 9.0]
    assert fit.weight.magnitude(2.0) >= 4.0


@pytest.mark.parametrize(
    ("omega", "bound", "options", "words"),
    [
        ([1.0, 2.0, 2.0], [1, 1, 1], {}, "omega[2]"),
        ([1.0, 3.0, 2.0], [1, 1, 1], {}, "omega[2]"),
        ([0.0, 1.0], [1, 1], {}, "omega[0]"),
        ([1.0, np.nan], [1, 1], {}, "omega[1]"),
        ([1.0, np.inf], [1, 1], {}, "omega[1]"),
        ([1.0, 2.0], [np.nan, np.nan], {}, "every value is NaN"),
        ([1.0, 2.0], [1, -1], {}, "bound[1] at 2 rad/s"),
        ([1.0, 2.0], [np.inf, 1], {}, "bound[0] at 1 rad/s"),
        ([1.0, 2.0], [1, 0], {}, "bound at 2 rad/s"),
        ([1.0, 2.0], [1, 1e-70], {}, "bound at 2 rad/s"),
        ([1.0, 2.0], [1, 1, 1], {}, "(3,)"),
        ([], [], {}, "(0,)"),
        ([1.0], [1.0], {"floor": 0.0}, "floor"),
        ([1.0], [1.0], {"order": -1}, "order"),
        ([1.0], [1.0], {"order": 2.5}, "order"),
        ([1.0], [1.0], {"order": 0, "proper": "strict"}, "order"),
        ([1.0], [1.0], {"proper": "improper"}, "proper"),
        ([1.0], [1.0], {"tol_db": math.nan}, "tol_db"),
    ],
)
def test_bad_input_is_refused_by_name(omega, bound, options, words):
    with pytest.raises(InputError) as refused:
        fit_overbound(omega, bound, name="W_delta", **options)
    assert words in str(refused.value) and "W_delta" in str(refused.value)


# ---------------------------------------------------------------- planted wrong certificates


@pytest.fixture(scope="module")
def fitted():
    omega = np.geomspace(0.01, 100, 50)
    bound = np.exp(np.cumsum(0.2 * np.random.default_rng(7).standard_normal(50)))
    return fit_overbound(omega, bound), omega, bound


def test_verification_agrees_with_the_stored_certificate(fitted):
    fit, omega, bound = fitted
    stored = Weight.from_dict(json.loads(json.dumps(fit.weight.to_dict())))
    assert verify_overbound(stored, omega, bound).to_dict() == fit.certificate


def test_a_weight_lowered_by_a_thousandth_is_rejected(fitted):
    fit, omega, bound = fitted
    lowered = verify_overbound(Weight(0.999 * fit.weight.num, fit.weight.den), omega, bound)
    assert not lowered.ok and lowered.min_ratio == pytest.approx(0.999, rel=1e-6)


@pytest.mark.parametrize("damping", [0.2, 1e-2, 1e-4])
def test_a_dip_between_samples_is_rejected_and_located(damping):
    omega = np.geomspace(0.1, 10, 12)
    where = math.sqrt(omega[5] * omega[6])
    notch = Weight(
        1.02 * np.array([1.0, 2 * damping * 0.5 * where, where**2]),
        np.array([1.0, 2 * damping * where, where**2]),
    )
    weight = Weight(np.convolve(notch.num, [1.0]), notch.den)
    bound = np.minimum(weight.magnitude(omega) * (1 - 1e-6), 1.0)
    assert np.all(weight.magnitude(omega) > bound)
    report = verify_overbound(weight, omega, bound)
    assert not report.ok and report.min_ratio_at == pytest.approx(where, rel=0.05)


@pytest.mark.parametrize(
    ("weight", "stable", "minimum_phase"),
    [
        (Weight(np.array([10.0, 10.0]), np.array([1.0, -1.0])), False, True),
        (Weight(np.array([10.0, -10.0]), np.array([1.0, 1.0])), True, False),
        (Weight(np.array([10.0, 0.0, 10.0]), np.array([1.0, 2.0, 1.0])), True, False),
        (Weight(np.array([10.0, 10.0]), np.array([1.0, 0.0])), False, True),
    ],
)
def test_unstable_or_nonminimum_phase_weights_are_rejected(weight, stable, minimum_phase):
    report = verify_overbound(weight, [1.0, 2.0], [1e-3, 1e-3])
    assert (report.ok, report.stable, report.minimum_phase) == (False, stable, minimum_phase)


@pytest.mark.parametrize(("omega", "bound"), [([1.0, 10.0], [1.0, 1.0]), ([5.0], [1.0])])
def test_a_weight_below_the_constant_beyond_the_ends_is_rejected(omega, bound):
    high_pass, low_pass = (
        Weight(np.array([10.0, 0.5]), np.array([1.0, 1.0])),
        Weight(np.array([0.5, 60.0]), np.array([1.0, 1.0])),
    )
    assert verify_overbound(high_pass, omega, bound).min_ratio == pytest.approx(0.5, rel=1e-6)
    report = verify_overbound(low_pass, omega, bound)
    assert report.min_ratio == pytest.approx(0.5, rel=1e-6) and report.min_ratio_at == math.inf
    assert report.to_dict()["min_ratio_at"] == "inf"


def test_the_worst_ratio_sees_a_needle_between_samples():
    needle = Weight(np.array([1.0, 0.2, 1.0]), np.array([1.0, 0.002, 1.0]))
    report = verify_overbound(needle, [0.5, 2.0], [0.9, 0.9])
    assert report.ok and report.max_ratio == pytest.approx(100 / 0.9, rel=1e-6)
    assert report.max_ratio_at == pytest.approx(1.0, rel=1e-3)


# ---------------------------------------------------------------- the weight itself


@pytest.mark.parametrize(
    ("zeros", "poles"),
    [
        ([], []),
        ([2.0], [3.0]),
        ([1e-3, 1e2, 1e3], [1e-2, 1e-2, 1e2]),
        ([1.0, 1.0, 1.0], [1.0, 1.0, 1.0]),
        ([0.1 + 1j, 0.1 - 1j, 5.0], [0.5, 2 + 9j, 2 - 9j]),
        ([0.1 + 1j, 0.1 - 1j], [1e-3, 1e3]),
        ([1e-3, 1e3], [0.1 + 1j, 0.1 - 1j]),
        ([1e-4, 1e-1, 3.0, 1e3], [1e-5, 2e-2, 1e2, 1e4]),
        ([], [1.0, 2.0]),
        ([5.0], [1 + 1j, 1 - 1j, 1e-2]),
        ([3.0, 0.2], [1.0, 1.0, 7.0]),
    ],
)
def test_state_space_has_the_response_of_the_weight_and_is_scaled(zeros, poles):
    weight = from_breaks(zeros, poles, 0.7)
    a, b, c, d = weight.to_state_space()
    n = len(poles)
    assert (a.shape, b.shape, c.shape, d.shape) == ((n, n), (n, 1), (1, n), (1, 1))
    for w in [0.0, *np.geomspace(1e-6, 1e6, 60)]:
        exact = 0.7 * np.prod([1 + 1j * w / z for z in zeros]) / np.prod([1 + 1j * w / p for p in poles])
        assert (c @ np.linalg.solve(1j * w * np.eye(n) - a, b) + d)[0, 0] == pytest.approx(
            exact, rel=1e-9, abs=1e-13
        )
        assert weight(1j * w) == pytest.approx(exact, rel=1e-9)
    assert np.sort(np.abs(np.linalg.eigvals(a))) == pytest.approx(np.sort(np.abs(poles)), rel=1e-4)
    assert np.sort(np.abs(weight.zeros())) == pytest.approx(np.sort(np.abs(zeros)), rel=1e-4)


def test_dictionaries_keep_every_bit():
    weight = Weight(np.array([1 / 3, 1e-300, 0.1]), np.array([1.0, math.pi, 2 / 7]))
    back = Weight.from_dict(json.loads(json.dumps(weight.to_dict())))
    assert back.num.tobytes() == weight.num.tobytes() and back.den.tobytes() == weight.den.tobytes()


@pytest.mark.parametrize(
    ("num", "den"), [([1, 2, 3], [1, 2]), ([0, 1], [1, 1]), ([1], []), ([math.nan], [1]), ([[1]], [1])]
)
def test_a_weight_that_is_none_is_refused(num, den):
    with pytest.raises(InputError):
        Weight(np.array(num, dtype=float), np.array(den, dtype=float))


@pytest.mark.parametrize("data", [{}, {"num": [1]}, {"num": None, "den": [1]}, []])
def test_unreadable_dictionaries_are_refused(data):
    with pytest.raises(InputError):
        Weight.from_dict(data)


# ---------------------------------------------------------------- step 7


def test_noise_is_subtracted_linearly_or_in_squares_and_losses_are_named():
    omega = np.array([1.0, 2.0, 3.0, 4.0])
    total, noise = np.array([5.0, 1.0, np.nan, 1.0]), np.array([3.0, 1.0, 1.0, 2.0])
    values, lost = subtract_noise(total, noise, omega, disturbance_set="paper", floor=0.25)
    assert (
        values.tolist()[:2] == [2.0, 0.25]
        and np.isnan(values[2])
        and values[3] == 0.25
        and lost == [2.0, 4.0]
    )
    values, lost = subtract_noise(total, noise, omega, disturbance_set="covering", floor=0.25)
    assert (
        values.tolist()[:2] == [4.0, 0.25]
        and np.isnan(values[2])
        and values[3] == 0.25
        and lost == [2.0, 4.0]
    )


def test_noise_subtraction_takes_weights():
    omega = np.array([0.1, 1.0, 10.0])
    total, noise = from_breaks([1.0], [10.0], 2.0), from_breaks([], [], 0.5)
    values, lost = subtract_noise(total, noise, omega, disturbance_set="paper", floor=1e-6)
    assert values == pytest.approx(total.magnitude(omega) - 0.5) and lost == []


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"disturbance_set": "joint"}, "disturbance_set"),
        ({"floor": 0.0}, "floor"),
        ({"floor": math.nan}, "floor"),
        ({"B_w": [1.0]}, "B_w"),
        ({"W_n": [1.0, -1.0]}, "W_n at 2 rad/s"),
        ({"B_w": [np.inf, 1.0]}, "B_w at 1 rad/s"),
    ],
)
def test_noise_subtraction_refuses_by_name(changes, words):
    good = {
        "B_w": [2.0, 2.0],
        "W_n": [1.0, 1.0],
        "omega": [1.0, 2.0],
        "disturbance_set": "paper",
        "floor": 0.1,
    }
    with pytest.raises(InputError) as refused:
        subtract_noise(**(good | changes))
    assert words in str(refused.value)


# ---------------------------------------------------------------- the promise of the README


DECADES = (3, 4, 5, 6)


def third_order(rng: np.random.Generator, decades: int) -> Weight:
    """A weight with three real zeros and three real poles. All lie at least a decade inside a band of
    ``decades`` about 1 rad/s."""
    half = decades / 2 - 1
    return Weight(*(np.poly(-(10.0 ** rng.uniform(-half, half, 3))) for _ in range(2)))


def bounds() -> Iterator[tuple[str, np.ndarray, np.ndarray]]:
    """(name, omega (K,) rad/s, bound (K,)), 32 of them, always the same."""
    for decades in DECADES:
        rng = np.random.default_rng(decades)
        omega = np.geomspace(10 ** (-decades / 2), 10 ** (decades / 2), 40 * decades)
        fine = np.geomspace(omega[0], omega[-1], 1024)

        def smooth(at, rng=rng, decades=decades):
            return third_order(rng, decades).magnitude(at)

        yield f"third order, {decades} decades", omega, smooth(omega)
        yield f"ripple, {decades} decades", omega, smooth(omega) * 10 ** (0.1 * np.sin(5 * np.log(omega)))
        yield f"walk, {decades} decades", omega, np.exp(np.cumsum(0.15 * rng.standard_normal(omega.size)))
        yield f"cliff down, {decades} decades", omega, np.where(omega < 1, 1.0, 1e-3)
        yield f"cliff up, {decades} decades", omega, np.where(omega < 3, 1e-3, 1.0)
        yield f"steps, {decades} decades", omega, np.repeat(10.0 ** rng.uniform(-1, 1, omega.size // 10), 10)
        yield f"scatter, {decades} decades", fine, smooth(fine) * np.exp(0.5 * rng.standard_normal(1024))
        yield (
            f"rayleigh scatter, {decades} decades",
            fine,
            smooth(fine) * np.abs(rng.standard_normal(1024) + 1j * rng.standard_normal(1024)),
        )


@pytest.mark.slow("5 s: 11 weights fitted")
@pytest.mark.parametrize("every", [pytest.param(1, marks=pytest.mark.long("15 s: 32 weights fitted")), 3])
def test_32_bounds_are_covered_tightly_by_few_linear_programs(every, monkeypatch):
    """The time of a fit goes into its linear programs. Every third bound is of each kind and of each number
    of decades."""
    programs = []
    solve = minimax.linprog
    monkeypatch.setattr(
        minimax,
        "linprog",
        lambda *arguments, **options: programs.append(name) or solve(*arguments, **options),
    )
    for name, omega, bound in islice(bounds(), 0, None, every):
        fit = fit_overbound(omega, bound, name=name)
        grid, b = dense(omega, bound, per_piece=7)
        assert np.min(fit.weight.magnitude(grid) / b) >= 1.0, name
        assert fit.certificate["ok"] and fit.worst_ratio_db - fit.lp_optimum_db <= 0.01, name
    count = Counter(programs)
    assert (
        len(count) == -(-32 // every)
        and statistics.median(count.values()) <= 65
        and max(count.values()) <= 130
    )  # 57.5 and 108


@pytest.mark.unhurried
@pytest.mark.parametrize("decades", DECADES)
def test_an_exact_weight_comes_back_within_a_hundredth_of_a_db(decades):
    """The samples reach two decades beyond its breaks: the bound is constant beyond its ends, and a weight
    that still falls there is not above it. A chord of the log-log bound lies above a weight that bends
    upwards, so there are 1024 of them."""
    truth = third_order(np.random.default_rng(decades), decades)
    omega = np.geomspace(10 ** (-decades / 2 - 1), 10 ** (decades / 2 + 1), 1024)
    fit = fit_overbound(omega, truth.magnitude(omega), order=3)
    grid = np.geomspace(omega[0], omega[-1], 20 * omega.size)
    distance = 20 * np.log10(fit.weight.magnitude(grid) / truth.magnitude(grid))
    assert fit.order == 3 and np.abs(distance).max() <= 0.01


@pytest.mark.parametrize(
    ("script", "limit_s", "note"),
    [
        ("raise SystemExit('no wheel')", 60, "failed: no wheel"),
        ("pass", 60, "failed: no message"),
        ("import time; time.sleep(60)", 0.2, "no answer in 0.2 s"),
    ],
)
def test_what_keeps_a_peer_from_answering_is_told(script, limit_s, note):
    assert ask(sys.executable, script, {}, limit_s) == {"note": note}
