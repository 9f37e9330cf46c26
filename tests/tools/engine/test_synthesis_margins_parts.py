"""Pieces of the margins by numbers worked out by hand: grids, roots, peaks, disks and encirclements."""

import numpy as np
import pytest

from lpvguard.engine.synthesis import margins as m
from lpvguard.engine.synthesis.errors import SynthesisError
from lpvguard.engine.synthesis.interconnection import rational
from lpvguard.engine.synthesis.margins import LoopMargin
from lpvguard.engine.synthesis.statespace import StateSpace, gain

# ---------------------------------------------------------------- what is shown, and what a disk covers


def test_a_margin_is_shown_in_the_unit_that_people_read():
    assert m.shown("phase", np.pi) == pytest.approx(180.0) == m.shown("disk_phase", np.pi)
    assert m.shown("delay", 0.02) == pytest.approx(20.0)
    assert m.shown("gain_up", 2.5) == 2.5


@pytest.mark.parametrize("alpha", [0.0, 0.5, 1.0, 1.9, 2.0, 2.5, 3.0, 7.0])
def test_a_balanced_disk_covers_twice_the_arc_tangent_of_half_its_size(alpha):
    low, high, phase = m.disk_gain_and_phase(alpha, 0.0)
    assert low == pytest.approx(max((2 - alpha) / (2 + alpha), 0.0))
    assert high == (pytest.approx((2 + alpha) / (2 - alpha)) if alpha < 2 else np.inf)
    assert phase == pytest.approx(2 * np.arctan(alpha / 2), abs=1e-7)


def test_a_disk_of_s_is_that_of_a_circle_about_minus_one():
    # |S| <= 1 / alpha keeps 1 + L outside of a circle of radius alpha: factors from 1 / (1 + alpha) on.
    assert m.disk_gain_and_phase(0.5, 1.0)[:2] == (pytest.approx(1 / 1.5), pytest.approx(2.0))
    assert m.disk_gain_and_phase(1.0, 1.0) == (0.5, np.inf, pytest.approx(np.pi / 3))
    assert m.disk_gain_and_phase(3.0, 1.0) == (0.25, np.inf, np.pi)
    assert m.disk_gain_and_phase(0.5, -1.0)[:2] == (pytest.approx(0.5), pytest.approx(1.5))
    assert m.disk_gain_and_phase(3.0, -1.0) == (0.0, 4.0, np.pi)


def test_the_disk_margins_follow_from_the_peaks():
    peak = LoopMargin(4.0, 2.0)
    assert m._disk("S", peak) == {"Ms": peak, "disk_S": LoopMargin(0.25, 2.0)}
    assert m._disk("T", peak) == {"Mt": peak, "disk_T": LoopMargin(0.25, 2.0)}
    disk = m._disk("balanced", peak)
    assert disk["disk_balanced"] == LoopMargin(0.25, 2.0)
    assert disk["disk_gain"].value == pytest.approx(2.25 / 1.75) and disk["disk_gain"].omega == 2.0
    assert disk["disk_phase"].value == pytest.approx(2 * np.arctan(0.125))
    assert m._disk("T", LoopMargin(0.0, 2.0))["disk_T"].value == np.inf


# ---------------------------------------------------------------- samples


def spiked(n: int, *spikes: tuple[int, float], base: float = 0.0) -> tuple[np.ndarray, np.ndarray]:
    """Samples of base times a cubic of log omega, with spikes (index, height)."""
    omega = np.geomspace(0.1, 10.0, n)
    L = base * np.linspace(0.0, 1.0, n) ** 3 + 0j
    for k, height in spikes:
        L[k] += height
    return omega, L


def test_what_every_second_sample_misses_estimates_the_error_at_the_others():
    # A sixteenth of a spike h that is left out exceeds 0.02 (1 + h) from 0.4706 on.
    for n in (12, 13):
        assert m.of_samples(*spiked(n, (3, 0.470)))(np.ones(1)).shape == (1,)
        with pytest.raises(SynthesisError, match=r"an estimated error of 0\.029"):
            m.of_samples(*spiked(n, (3, 0.472)))
        with pytest.raises(SynthesisError, match=r"an estimated error of 0\.062"):
            m.of_samples(*spiked(n, (3, -1.0j)))
    # Of two that are missed it is the one that is large beside L that counts.
    omega, L = spiked(41, (3, 1.0), (37, 3.0), base=1000.0)
    with pytest.raises(SynthesisError, match=f"L at {omega[3]:.4g} rad/s: an estimated error of 0.0"):
        m.of_samples(omega, L)
    omega, L = spiked(41, (3, 1.0), (37, 4.8), base=5.3)
    with pytest.raises(SynthesisError, match=f"L at {omega[3]:.4g} rad/s: an estimated error of 0.06"):
        m.of_samples(omega, L)
    omega, L = spiked(41, (3, 1.0), (9, -0.9))
    with pytest.raises(SynthesisError, match=f"L at {omega[3]:.4g} rad/s: an estimated error of 0.06"):
        m.of_samples(omega, L)
    m.of_samples(*spiked(12, (3, -0.46)))
    # The last sample belongs to both splines.
    for n in (12, 13):
        m.of_samples(*spiked(n, (n - 1, 0.9)))


def test_between_samples_l_is_a_cubic_of_log_omega_and_beyond_them_constant():
    omega = np.geomspace(0.1, 10.0, 8)

    def cubic(w):
        return (1 + 2j) * np.log(w) ** 3 - 3 * np.log(w) + 0.5j

    response = m.of_samples(omega, cubic(omega))
    listed = m.of_samples(omega.tolist(), cubic(omega).tolist())
    np.testing.assert_array_equal(listed(omega), response(omega))
    for at, same in ((0.7, 0.7), (0.01, 0.1), (50.0, 10.0)):
        np.testing.assert_allclose(response(np.array([at])), cubic(np.array([same])), rtol=1e-10)


def test_samples_out_of_order_or_of_another_length_are_refused():
    omega, L = spiked(9)
    m.of_samples(omega, L)
    twice, zero = omega.copy(), omega.copy()
    twice[4], zero[0] = twice[3], 0.0
    for bad, samples in ((twice, L), (zero, L), (omega, L[:-1]), (omega[:7], L[:7])):
        with pytest.raises(
            SynthesisError, match=r"\d frequencies; expected at least 8 rising frequencies above 0"
        ):
            m.of_samples(bad, samples)
    L[4] = np.nan
    with pytest.raises(SynthesisError, match="not finite"):
        m.of_samples(omega, L)


# ---------------------------------------------------------------- the grid of a system


def grid_of(low: float, last: float, *near: float) -> np.ndarray:
    return np.unique([0.0, *np.geomspace(low, last, 400), *near])


def test_the_first_grid_spans_the_poles_of_both_loops_and_has_points_at_them():
    # 1/(s + 1) closed: a pole at 2. With D = 1 and the same C B: at 1.5.
    for D, closed in ((0.0, 2.0), (1.0, 1.5)):
        grid = m.of_system(StateSpace([[-1.0]], [[1.0]], [[1.0]], [[D]]))[1]
        np.testing.assert_allclose(grid, grid_of(1e-3, 1e3 * closed, 1.0, closed), rtol=1e-12)
    # -0.3 +- 2j, not changed by a loop of gain 0: imaginary parts, and real parts to both sides of them.
    pair = StateSpace([[-0.3, 2.0], [-2.0, -0.3]], [[1.0], [0.0]], [[0.0, 0.0]], [[0.0]])
    size = np.hypot(0.3, 2.0)
    np.testing.assert_allclose(m.of_system(pair)[1], grid_of(1e-3 * size, 1e3 * size, 1.7, 2.0, 2.3))
    # 2/((s + 1)(s + 2)) closed: -1.5 +- j sqrt(7)/2, of size 2.
    across = np.sqrt(7) / 2
    two = StateSpace([[-1.0, 1.0], [0.0, -2.0]], [[0.0], [1.0]], [[2.0, 0.0]], [[0.0]])
    near = grid_of(1e-3, 2e3, 1.0, 2.0, across, across + 1.5)
    np.testing.assert_allclose(m.of_system(two)[1], near, rtol=1e-9)
    # 1 + L = 0 at DC: a pole at 0 has no size.
    static = StateSpace([[-1.0]], [[1.0]], [[-1.0]], [[0.0]])
    np.testing.assert_allclose(m.of_system(static)[1], grid_of(1e-3, 1e3, 1.0))
    np.testing.assert_allclose(m.of_system(gain([[2.0]]))[1], grid_of(1e-3, 1e3))


def test_the_first_grid_of_a_sampled_loop_ends_at_half_its_rate():
    dt, last = 0.1, 10 * np.pi
    lag = StateSpace([[0.5]], [[1.0]], [[0.25]], [[0.0]], dt)
    slow, fast = np.log(2) / dt, np.log(4) / dt
    np.testing.assert_allclose(m.of_system(lag)[1], grid_of(1e-3 * slow, last, slow, fast))
    # What lies at z = 0 within rounding is a delay, and no pole.
    for pole in (0.0, 0.9e-12, 1e-12):
        delay = StateSpace([[pole]], [[1.0]], [[0.0]], [[0.0]], dt)
        np.testing.assert_allclose(m.of_system(delay)[1], grid_of(1e-3, last))
    # A pole at z = -1/2 alternates.
    size, along = np.hypot(np.log(2), np.pi) / dt, np.log(2) / dt
    alternating = m.of_system(StateSpace([[-0.5]], [[1.0]], [[0.0]], [[0.0]], dt))[1]
    np.testing.assert_allclose(alternating, grid_of(1e-3 * size, last, last - along), rtol=1e-12)
    fast = StateSpace([[1.1e-12]], [[1.0]], [[0.0]], [[0.0]], dt)
    assert m.of_system(fast)[1][1] == pytest.approx(-1e-3 * np.log(1.1e-12) / dt)


def test_an_integrator_is_no_stable_loop():
    with pytest.raises(SynthesisError, match="not stable"):
        m.of_system(StateSpace([[0.0]], [[1.0]], [[1.0]], [[0.0]]))


# ---------------------------------------------------------------- refined grids


def jump(before: complex, after: complex, at: float = 1.5):
    """L that changes at one frequency; the frequencies asked for are kept."""
    asked: list[np.ndarray] = []

    def response(omega):
        asked.append(omega)
        return np.where(omega < at, complex(before), complex(after))

    return response, asked


def test_a_grid_is_halved_geometrically_until_neighbours_are_one_number():
    response, asked = jump(1.0, 2.0)
    omega, L = m._refined(response, np.array([1.0, 2.0]))
    assert len(asked) == 1 + 40 and len(omega) == 42, "2^(2^-39) - 1 is above 1e-12, 2^(2^-40) - 1 is not"
    assert asked[1][0] == pytest.approx(np.sqrt(2)) and asked[2][0] == pytest.approx(2**0.75)
    np.testing.assert_array_equal(L, np.where(omega < 1.5, 1.0, 2.0))
    # From 0 on a point is half of the next one, and the rounds are counted.
    response, asked = jump(1.0, 2.0, at=1e-300)
    omega, _ = m._refined(response, np.array([0.0, 1.0]))
    assert len(asked) == 1 + m.ROUNDS
    np.testing.assert_array_equal(omega, [0.0, *2.0 ** np.arange(-60, 1)])
    # 5000 is 1e-12 of 5e15.
    assert len(m._refined(jump(1.0, 2.0, 5e15)[0], np.array([5e15 - 5000, 5e15]))[0]) == 2


def test_a_grid_is_refined_where_l_or_one_plus_l_moves(monkeypatch):
    grid = np.array([1.0, 2.0])

    def count(before, after):
        return len(m._refined(jump(before, after)[0], grid)[0])

    assert count(1.0, 1.0) == count(1.0, 1.02) == 2 < count(1.0, 1.12)
    assert count(-1.001, -1.0009) > 2, "L moves by 1e-4 and 1 + L by a tenth"
    # What is small at both ends is not followed.
    assert count(0.9e-3, -0.9e-3) == 2 < min(count(0.9e-3, 1e-3), count(1e-3, 0.9e-3))
    assert min(count(0.5e-3, -0.5), count(-0.5, 0.5e-3)) > 2
    monkeypatch.setattr(m, "STEP", float(np.abs(np.log(2.0 + 0j))))
    assert count(1.0, 2.0) == 2


def test_a_loop_through_minus_one_or_without_a_value_is_refused():
    for value in (np.nan, -1.0):
        with pytest.raises(SynthesisError, match="off the critical point"):
            m._refined(jump(0.1, value)[0], np.array([1.0, 2.0]))


# ---------------------------------------------------------------- encirclements


def test_poles_are_counted_by_half_turns_round_minus_one():
    """From L = -3 at DC to 0: above the real axis 1 + L turns by -pi, one pole; below it by pi."""
    above = np.array([-3.0, -1.0 + 2j, 0.0])
    assert m.unstable_poles(above) == 1
    assert m.unstable_poles(above[::-1].conj()) == 1
    with pytest.raises(SynthesisError, match="goes round -1 1 times forward"):
        m.unstable_poles(above.conj())
    assert m.unstable_poles(np.array([1.0, 0.5 - 0.5j, -0.5, 0.0])) == 0
    # What lies between the ends and the real axis counts: here each is within the unit circle.
    near = np.array([-0.9 + 0.4j, -0.8 + 0.4j, 0.0, -0.9 - 0.4j])
    assert m.unstable_poles(near) == m.unstable_poles(near[::-1]) == 0
    assert m.unstable_poles(np.array([-0.9 + 0.4j, 0.0, -0.1 - 0.99j])) == 0
    round_twice = -1 + 2 * np.exp(-1j * np.linspace(0, 4 * np.pi, 60))
    assert m.unstable_poles(round_twice) == 4


def test_an_end_that_is_not_near_the_real_axis_is_refused():
    # -3 + 1j is as far from the axis as half of 1 - 3.
    for end, good in ((-3 + 1j, True), (-3 + 1.01j, False), (1j, False), (0.99j, True), (1 - 1j, True)):
        curve = np.array([end, -1 + 2j, 0.0])
        for L, place in ((curve, "first"), (curve[::-1], "last")):
            if good:
                m.unstable_poles(L if abs(end) < 1 or end.real > 0 else np.array([end, end]))
            else:
                with pytest.raises(SynthesisError, match=f"{place} frequency"):
                    m.unstable_poles(L)


# ---------------------------------------------------------------- peaks and roots


def test_the_largest_value_is_followed_from_every_high_neighbourhood():
    grid = np.arange(1.0, 9.0)

    def bump(w, height, at):
        return height * np.maximum(0.0, 1 - ((w - at) / 0.45) ** 2)

    def flat(w):
        return 1.0 + bump(w, 0.2, 4.5)

    largest = m._largest(flat, grid)  # equal at every point of the grid
    assert (largest.value, largest.omega) == (pytest.approx(1.2), pytest.approx(4.5, rel=1e-6))
    assert m._largest(lambda w: 1.0 + 0 * w, grid) == LoopMargin(1.0, 1.0)

    def two(w):  # 2 on the grid at 7, and 3 between 3 and 4, where the grid shows less
        return bump(w, 2.0, 7.0) + bump(w, 3.0, 3.4) + 0.01

    assert m._largest(two, grid).omega == pytest.approx(7.0, rel=1e-6), "3.4 shows 0.64 at 3: not followed"

    def higher(w):
        return two(w) + bump(w, 1.0, 3.0)

    assert m._largest(higher, grid).value == pytest.approx(higher(np.array([3.3])).max(), rel=0.2)
    slow = m._largest(lambda w: 1.0 + bump(1e6 * w, 0.2, 4.3), 1e-6 * grid)
    assert slow.omega == pytest.approx(4.3e-6, rel=1e-6)
    for at in (1.0, 8.0):
        end = m._largest(lambda w, at=at: bump(w, 1.0, at) + 0.1, grid)
        assert (end.value, end.omega) == (pytest.approx(1.1), at)
    for at in (1.2, 7.8):
        inner = m._largest(lambda w, at=at: bump(w, 1.0, at) + 0.1, grid)
        assert (inner.value, inner.omega) == (pytest.approx(1.1), pytest.approx(at, rel=1e-6))
    with_hole = m._largest(lambda w: np.where(w == 2.0, np.nan, bump(w, 1.0, 3.0)), grid)
    assert with_hole == LoopMargin(1.0, 3.0)
    assert m._largest(lambda w: np.nan * w, grid) == LoopMargin(0.0, 1.0)


def test_only_what_is_near_the_largest_is_followed(monkeypatch):
    grid, asked = np.array([1.0, 2.0, 3.0, 4.0, 5.0]), []

    def size(w):
        asked.extend(w)
        return np.interp(w, grid, [0.0, 1.0, 0.0, 0.61, 0.0])

    m._largest(size, grid)
    golden = 2 * (3 - np.sqrt(5)) / 2  # of each bracket of length 2
    assert asked[5] == pytest.approx(1 + golden) and len(asked) < 150
    assert np.isclose(asked, 3 + golden).any(), "0.61 is above exp(-1/2)"
    monkeypatch.setattr(m, "SEARCHED", 0.0)
    asked.clear()
    m._largest(size, grid)
    assert asked[5:] and all(1 <= w <= 3 for w in asked[5:])
    asked.clear()
    m._largest(lambda w: 0.0 * size(w), grid)
    assert len(asked) == 5, "where all is 0 nothing is searched"
    asked.clear()
    monkeypatch.setattr(m, "SEARCHED", 0.5)
    m._largest(lambda w: asked.extend(w) or 1 + 0.1 * w, grid)
    assert asked[5:] and min(asked[5:]) >= 4, "what rises is followed at its end alone"


def test_zeros_are_found_on_the_grid_between_its_points_and_in_pairs_that_it_misses():
    grid = np.arange(0.0, 8.0)

    def roots(value):
        return sorted(m._roots(lambda w: value(np.asarray(w)), grid))

    np.testing.assert_allclose(roots(lambda w: w - 3.3), [3.3])
    np.testing.assert_allclose(roots(lambda w: 3.3 - w), [3.3])
    np.testing.assert_allclose(roots(lambda w: (w - 3.0) * (w - 5.5)), [3.0, 5.5])
    assert roots(lambda w: 1.0 + w) == []
    for sign in (1, -1):
        pair = roots(lambda w, sign=sign: sign * 0.04 * ((w - 3.4) ** 2 - 0.01))
        np.testing.assert_allclose(pair, [3.3, 3.5], rtol=1e-9)
        assert roots(lambda w, sign=sign: sign * ((w - 3.4) ** 2 - 0.01)) == [], "0.16 is too far from 0"
        assert roots(lambda w, sign=sign: sign * (0.04 * (w - 3.4) ** 2 + 0.01)) == []


def test_what_crosses_zero_is_not_followed_beside_it():
    grid, asked = np.arange(0.0, 8.0), []

    def value(function):
        def noted(w):
            asked.extend([float(x) for x in w] if len(w) == 1 else [])
            return function(np.asarray(w))

        return noted

    for sign in (1, -1):
        [root] = m._roots(value(lambda w, sign=sign: 0.01 * sign * (w - 3.3)), grid)
        assert root == pytest.approx(3.3, rel=1e-14) and all(3 <= w <= 4 for w in asked)
    asked.clear()
    assert m._roots(value(lambda w: np.interp(w, grid[:3], [0.3, 0.05, 0.3])), grid[:3]) == []
    assert asked == [], "a step from 0 is too far"
    [root] = m._roots(value(lambda w: np.cbrt(1e6 * w - 3.3)), 1e-6 * grid)
    assert root == pytest.approx(3.3e-6, rel=1e-12)


def test_every_pair_is_found_between_its_own_neighbours():
    def value(w):  # 0.2 off 2.8, 4.8 and 6.8, and level between
        w = np.asarray(w)
        return 0.04 * (np.min([(w - at) ** 2 for at in (2.8, 4.8, 6.8)], axis=0) - 0.01)

    roots = m._roots(value, np.arange(0.0, 9.0))
    np.testing.assert_allclose(sorted(roots), [2.7, 2.9, 4.7, 4.9, 6.7, 6.9], rtol=1e-9)


def test_a_pair_of_zeros_is_sought_from_a_step_on_and_where_neighbours_are_level():
    grid = np.array([1.0, 2.0, 3.0, 4.0])
    # Level at 2 and 3, zeros at 2.4 and 2.6.
    value = 0.04 * ((grid - 2.5) ** 2 - 0.01)
    assert value[1] == pytest.approx(value[2])
    roots = m._roots(lambda w: 0.04 * ((np.asarray(w) - 2.5) ** 2 - 0.01), grid)
    np.testing.assert_allclose(sorted(roots), [2.4, 2.6])

    def level(w):  # equal at 1, 2 and 3, or at 2, 3 and 4, with zeros between 2 and 3
        return 0.01 - 0.02 * np.maximum(0.0, 1 - ((w - 2.5) / 0.45) ** 2)

    for rise in (-1.0, 1.0):
        roots = m._roots(lambda w, rise=rise: level(w) + 0.1 * np.maximum(0.0, rise * (w - 2.5) - 0.5), grid)
        assert len(roots) == 2


# ---------------------------------------------------------------- margins of one loop, and of a disk


def constant(value: float):
    return lambda w: value + 0j * w


def test_crossings_are_those_nearest_to_minus_one_on_each_side():
    """L real at the frequencies 1 to 6, and of modulus 1 between some of them."""
    values = np.array([-4.0, -2.0, -0.5, -0.2, 0.4, 0.3])

    def response(w):
        return np.interp(w, np.arange(1.0, 7.0), values) + 1e-3j * np.sin(np.pi * w)

    grid = np.arange(1.0, 6.01, 0.25)
    crossings = m._crossings(response, grid, response(grid))
    assert crossings["gain_up"].value == pytest.approx(2.0, rel=1e-6)
    assert crossings["gain_up"].omega == pytest.approx(3.0)
    assert crossings["gain_down"].value == pytest.approx(0.5, rel=1e-6)
    assert crossings["gain_down"].omega == pytest.approx(2.0)
    assert crossings["phase"].omega == pytest.approx(2 + 2 / 3, rel=1e-5)
    assert crossings["phase"].value == pytest.approx(1e-3 * np.sin(np.pi * 2 / 3), rel=1e-3)


def test_of_crossings_the_nearest_counts_and_of_equal_ones_the_first():
    grid = np.arange(1.0, 8.0)
    values = np.array([-0.25, -0.3, -0.3, -2.5, -3.0, -2.5, -0.2])

    def response(w):
        near = values[np.clip(np.round(w).astype(int) - 1, 0, 6)]
        return near + 1e-3j * np.sin(np.pi * np.asarray(w))

    fine = np.arange(0.75, 7.3, 0.25)
    crossings = m._crossings(response, fine, response(fine))
    assert crossings["gain_up"].value == pytest.approx(1 / 0.3)
    assert crossings["gain_up"].omega == pytest.approx(2.0, rel=1e-9)
    assert crossings["gain_down"].value == pytest.approx(0.4)
    assert crossings["gain_down"].omega == pytest.approx(4.0, rel=1e-9)
    for value in (0.0, -1.0):
        crossings = m._crossings(constant(value), grid, constant(value)(grid))
        assert (crossings["gain_up"], crossings["gain_down"]) == (
            LoopMargin(np.inf, None),
            LoopMargin(0.0, None),
        )


def on_the_circle(*lags: float):
    """L of modulus 1 at 0, 1, .. with a lag behind -1 [degrees] at each, off the circle between them."""
    at = np.arange(len(lags), dtype=float)

    def response(w):
        angle = np.interp(w, at, np.deg2rad(lags)) - np.pi
        return 2.0 ** np.round(np.sin(np.pi * w), 9) * np.exp(1j * angle)

    return response, at


def test_of_several_phases_and_delays_the_least_counts_and_of_equal_ones_the_first():
    crossings = m._crossings(*(lambda L, w: (L, w, L(w)))(*on_the_circle(100, 20, 350, 200, 350)))
    assert crossings["phase"].value == pytest.approx(np.deg2rad(10))
    assert crossings["phase"].omega == pytest.approx(2.0, abs=1e-9)
    assert crossings["delay"].value == pytest.approx(np.deg2rad(20))
    assert crossings["delay"].omega == pytest.approx(1.0, abs=1e-9)
    crossings = m._crossings(*(lambda L, w: (L, w, L(w)))(*on_the_circle(100, 20, 30, 50)))
    assert crossings["delay"].value == pytest.approx(np.deg2rad(15))

    def quarter(w):  # lags of 90 and 180 degrees at 1 and 2
        return np.where(w == 1, -1j, np.where(w == 2, 1.0, 2.0))

    at = np.array([1.0, 2.0, 3.0])
    assert m._crossings(quarter, at, quarter(at))["delay"] == LoopMargin(np.pi / 2, 1.0)

    def level(w):  # a lag of 90 degrees at 0, 1 and 2: at 0 no delay makes it
        return np.where(np.isin(w, (0.0, 1.0, 2.0)), -1j, 2.0)

    at = np.arange(4.0)
    crossings = m._crossings(level, at, level(at))
    assert crossings["phase"] == LoopMargin(np.pi / 2, 0.0) and crossings["delay"] == LoopMargin(
        np.pi / 4, 2.0
    )


def test_where_l_vanishes_it_is_inside_the_circle():
    with np.errstate(divide="raise"):
        _, unit = m._on_axis_and_circle(lambda w: np.interp(w, [1.0, 2.0], [0.0, 2.0]), np.array([1.0, 2.0]))
    assert unit == pytest.approx([1.5])


def test_the_ends_of_the_grid_count_where_l_is_real_there():
    def response(w):
        return -0.5 + 0.1j * (w - 1.0) * (w - 3.0) + 0 * w

    grid = np.array([1.0, 2.0, 3.0])
    assert m._crossings(response, grid, response(grid))["gain_up"] == LoopMargin(2.0, 1.0)
    tilted = lambda w: (-0.5 - 0.1 * (3.0 - w)) * np.exp(1j * np.where(w == 3.0, 0.9e-9, 0.1))  # noqa: E731
    crossings = m._crossings(tilted, grid, tilted(grid))["gain_up"]
    assert (crossings.value, crossings.omega) == (pytest.approx(2.0), 3.0)
    exact = lambda w: np.where(w == 1.0, -0.5 + 0.5e-9j, -0.5 + 0.1j)  # noqa: E731
    assert m._crossings(exact, grid, exact(grid))["gain_up"] == LoopMargin(2.0, 1.0)
    tilted = lambda w: (-0.5 - 0.1 * (3.0 - w)) * np.exp(1j * np.where(w == 3.0, 1.1e-9, 0.1))  # noqa: E731
    assert m._crossings(tilted, grid, tilted(grid))["gain_up"] == LoopMargin(np.inf, None)


def test_phase_counts_to_both_sides_and_delay_to_one():
    # A phase of 170 degrees at 2 rad/s leads -1 by 10 degrees; as a lag it is 350 degrees.
    angle = np.deg2rad(170.0)

    def leading(w):
        return 2.0 ** (2 - w) * np.exp(1j * angle)

    grid = np.array([1.0, 2.0, 3.0])
    crossings = m._crossings(leading, grid, leading(grid))
    assert crossings["phase"].value == pytest.approx(np.deg2rad(10.0)) and crossings["phase"].omega == 2.0
    assert crossings["delay"].value == pytest.approx(np.deg2rad(350.0) / 2)
    lagging = lambda w: leading(w).conj()  # noqa: E731
    crossings = m._crossings(lagging, grid, lagging(grid))
    assert crossings["phase"].value == pytest.approx(np.deg2rad(10.0))
    assert crossings["delay"].value == pytest.approx(np.deg2rad(10.0) / 2) and crossings["delay"].omega == 2.0


CENTRES = np.array(
    [0.3 + 0.4j, -0.7 + 0.2j, -2.0 + 0.5j, -1.5 - 1.5j, 2.0 - 0.1j, -0.4, -2.0 + 0.1j, -3.0, -0.25, 3.0]
)
RADII = np.array([0.1, 0.3, 0.4, 0.9, 0.5, 0.2, 0.3, 0.5, 0.25, 0.1])


def test_a_static_set_has_the_margins_of_its_nearest_loop():
    grid = np.array([0.0, 1.0, 4.0])

    def promised(c, r):
        promise = m.guaranteed(constant(c), lambda w: r + 0 * w, grid)
        return promise if promise is None else promise.by_name

    assert promised(-0.25, 0.75) is None is promised(-3.0, 2.0)
    assert promised(-0.25, 0.74) is not None is not promised(-3.0, 1.99)
    near = promised(-0.25, 0.1)
    assert near["gain_up"] == LoopMargin(pytest.approx(1 / 0.35), 0.0)
    for name, unlimited in (("gain_down", 0.0), ("phase", np.inf), ("delay", np.inf)):
        assert near[name] == LoopMargin(unlimited, None)
    assert near["Ms"].value == pytest.approx(1 / 0.65)
    far = promised(-3.0, 0.5)
    assert far["gain_down"] == LoopMargin(pytest.approx(0.4), 0.0)
    assert far["gain_up"] == LoopMargin(np.inf, None)
    ahead = promised(1.0, 0.3)
    turn = np.pi - 2 * np.arcsin(0.15)
    assert ahead["phase"] == LoopMargin(pytest.approx(turn), 0.0)
    assert ahead["delay"] == LoopMargin(pytest.approx(turn / 4.0), 4.0)
    stable = m.guaranteed(constant(1.0), lambda w: 0.3 + 0 * w, grid)
    assert stable.stable and list(stable.by_name) == list(m.NAMES)


def test_a_loop_is_stable_or_says_how_many_poles_are_not():
    stable, not_ = (m.margins(*m.of_system(rational([k], [1.0, 3.0, 3.0, 1.0]))) for k in (2.0, 9.0))
    assert stable.stable and stable.unstable_poles == 0 and list(stable.by_name) == list(m.NAMES)
    assert not not_.stable and not_.unstable_poles == 2 and not_.by_name == {}


@pytest.mark.parametrize("skew", [-1.0, 0.0, 1.0, 0.4])
def test_the_worst_sensitivity_is_the_largest_over_the_disks_edge(skew):
    edge = CENTRES + RADII * np.exp(1j * np.linspace(0, 2 * np.pi, 20001))[:, None]
    want = np.abs(1 / (1 + edge) + (skew - 1) / 2).max(axis=0)
    peaks = m._worst_sensitivity(lambda w: CENTRES, lambda w: RADII, skew, np.zeros(10))
    np.testing.assert_allclose(peaks, want, rtol=1e-6)


def test_factors_and_turns_that_bring_a_disk_to_minus_one():
    below, above = m._gains(CENTRES, RADII)
    factors = np.geomspace(1e-3, 1e3, 300001)
    for c, r, low, high in zip(CENTRES, RADII, below, above, strict=True):
        touched = factors[np.abs(1 + factors * c) <= factors * r]
        assert low == pytest.approx(max(touched[touched < 1], default=0.0), rel=1e-3)
        assert high == pytest.approx(min(touched[touched > 1], default=np.inf), rel=1e-3)
    assert [float(k[0]) for k in m._gains(np.array([-0.5 + 0j]), np.array([0.5]))] == [0.0, np.inf]
    assert (below > 0).sum() >= 2 and np.isfinite(above).sum() >= 2
    lags = np.linspace(0.0, 2 * np.pi, 40001)
    turn, lag = m._turn(CENTRES, RADII), m._lag(CENTRES, RADII)
    for c, r, least_turn, least_lag in zip(CENTRES, RADII, turn, lag, strict=True):
        touched = lags[np.abs(1 + np.exp(-1j * lags) * c) <= r]
        assert least_lag == pytest.approx(min(touched, default=np.inf), abs=5e-4)
        either = np.minimum(touched, 2 * np.pi - touched)
        assert least_turn == pytest.approx(min(either, default=np.inf), abs=5e-4)
    assert np.isfinite(lag).any() and not np.isfinite(lag).all()
