"""Margins of a loop: closed forms, python-control on random loops, and what a set of loops is promised."""

import os

import control
import numpy as np
import pytest

from lpvguard.engine.synthesis.errors import SynthesisError
from lpvguard.engine.synthesis.interconnection import rational
from lpvguard.engine.synthesis.margins import (
    NAMES,
    SKEWS,
    disk_gain_and_phase,
    guaranteed,
    margins,
    of_samples,
    of_system,
    unstable_poles,
)
from lpvguard.engine.synthesis.norms import hinf_norm
from lpvguard.engine.synthesis.statespace import StateSpace, lft, to_discrete, zero_order_hold

SEEDS = range(80 if os.environ.get("LPVGUARD_FULL") == "1" else 40)
"""Of random loops: even ones continuous, odd ones discrete; two in three are stable when closed."""


def random_loop(seed: int) -> StateSpace:
    """A stable loop of order 1 to 4 whose gain may be too large to close it."""
    random = np.random.default_rng(seed)
    dt, n = 0.5 * (seed % 2), int(random.integers(1, 5))
    A = np.zeros((n, n))
    for k in range(0, n, 2):
        size, damping = 10 ** random.uniform(-0.5, 0.7), random.uniform(0.1, 0.9)
        real, imag = -damping * size, size * np.sqrt(1 - damping**2)
        A[k : k + 2, k : k + 2] = np.array([[real, imag], [-imag, real]])[: n - k, : n - k]
    loop = StateSpace(A, random.normal(size=(n, 1)), random.normal(size=(1, n)), [[0.0]])
    loop = zero_order_hold(loop, dt) if dt else loop
    peak = hinf_norm(loop).upper
    scale = 10 ** random.uniform(-0.3, 0.7) / peak
    return StateSpace(loop.A, scale * loop.B, loop.C, loop.D, loop.dt)


def closed_poles(loop: StateSpace) -> int:
    """Unstable poles of the closed loop, by its eigenvalues."""
    poles = np.linalg.eigvals(loop.A - loop.B @ loop.C / (1 + loop.D[0, 0]))
    return int((np.abs(poles) > 1).sum() if loop.dt else (poles.real > 0).sum())


def peer(loop: StateSpace):
    return control.ss(loop.A, loop.B, loop.C, loop.D, loop.dt)


def nearest(values, otherwise: float) -> float:
    return min(values, default=otherwise)


@pytest.mark.slow("5 s: python-control on random loops")
def test_random_loops_have_the_margins_of_python_control():
    stable = 0
    for seed in SEEDS:
        loop = random_loop(seed)
        ours = margins(*of_system(loop))
        assert ours.unstable_poles == closed_poles(loop), seed
        assert set(ours.by_name) == (set(NAMES) if ours.stable else set())
        if not ours.stable:
            continue
        stable += 1
        by_name, theirs = ours.by_name, peer(loop)
        gains, phases, *_ = control.stability_margins(theirs, returnall=True)
        # A crossing at DC or at half the sampling frequency is not always listed by the peer.
        inside = by_name["gain_up"].omega not in (0.0, np.pi / loop.dt if loop.dt else np.inf)
        if inside:
            up = nearest([g for g in gains if g > 1], np.inf)
            assert by_name["gain_up"].value == pytest.approx(up, rel=1e-6), seed
        down = max([g for g in gains if 0 < g < 1], default=0.0)
        assert by_name["gain_down"].value == pytest.approx(down, rel=1e-6), seed
        phase = nearest(np.abs(np.deg2rad(phases)), np.inf)
        assert by_name["phase"].value == pytest.approx(phase, rel=1e-6), seed
        grid = np.geomspace(1e-3, np.pi / loop.dt if loop.dt else 1e3, 1500)
        for name, skew in SKEWS.items():
            radius = by_name[f"disk_{name}"]
            there = control.disk_margins(theirs, np.array([radius.omega]), skew=skew, returnall=True)[0]
            assert there[0] == pytest.approx(radius.value, rel=1e-6), (seed, name)
            assert control.disk_margins(theirs, grid, skew=skew)[0] >= radius.value * (1 - 1e-6), (seed, name)
        assert by_name["Ms"].value == pytest.approx(1 / by_name["disk_S"].value)
        assert by_name["Mt"].value == pytest.approx(1 / by_name["disk_T"].value)
    assert stable >= 50 / 80 * len(SEEDS)


def test_the_peak_of_s_is_its_h_infinity_norm():
    for seed in (3, 8, 20, 21):
        loop = random_loop(seed)
        one = StateSpace(
            loop.A,
            np.hstack([loop.B, -loop.B]),
            np.vstack([loop.C, loop.C]),
            [[0.0, 0.0], [0.0, 0.0]],
            loop.dt,
        )
        T = lft(one, StateSpace(np.zeros((0, 0)), np.zeros((0, 1)), np.zeros((1, 0)), [[1.0]], loop.dt))
        by_name = margins(*of_system(loop))
        if by_name.stable:
            assert by_name.by_name["Mt"].value == pytest.approx(hinf_norm(T).upper, rel=1e-6)


def test_a_delay_of_the_margin_ends_stability_and_a_smaller_one_does_not():
    response, grid = of_system(rational([1.0], [1.0, 1.0, 0.4]))
    by_name = margins(response, grid).by_name
    limit, omega = by_name["delay"].value, by_name["delay"].omega
    assert response(np.array([omega]))[0] * np.exp(-1j * omega * limit) == pytest.approx(-1.0)
    for share, poles in ((0.99, 0), (1.01, 2)):

        def late(w, share=share):
            return response(w) * np.exp(-1j * w * share * limit)

        assert margins(late, grid[grid < 200.0]).unstable_poles == poles


def test_textbook_loops_have_their_closed_form_margins():
    # k/(s + 1)^3 meets the negative real axis at sqrt(3) with k/8.
    by_name = margins(*of_system(rational([2.0], [1.0, 3.0, 3.0, 1.0]))).by_name
    assert by_name["gain_up"].value == pytest.approx(4.0, rel=1e-9)
    assert by_name["gain_up"].omega == pytest.approx(np.sqrt(3), rel=1e-9)
    assert (by_name["gain_down"].value, by_name["gain_down"].omega) == (0.0, None)
    crossing = np.sqrt(2 ** (2 / 3) - 1)
    assert by_name["phase"].omega == pytest.approx(crossing, rel=1e-9)
    assert by_name["phase"].value == pytest.approx(np.pi - 3 * np.arctan(crossing), rel=1e-9)
    assert by_name["delay"].value == pytest.approx(by_name["phase"].value / crossing, rel=1e-9)
    # a/(s + 1): S = (s + 1)/(s + 1 + a), T = a/(s + 1 + a) and S - 1/2 are largest at the ends.
    by_name = margins(*of_system(rational([3.0], [1.0, 1.0]))).by_name
    assert by_name["gain_up"].value == np.inf and by_name["Mt"].value == pytest.approx(0.75)
    assert by_name["Ms"].value == pytest.approx(1.0, rel=1e-6)
    assert by_name["disk_balanced"].value == pytest.approx(2.0, rel=1e-6)
    assert by_name["phase"].value == pytest.approx(np.pi - np.arctan(np.sqrt(8)), rel=1e-9)
    # a/z in discrete time turns once round the circle of radius a.
    by_name = margins(*of_system(StateSpace([[0.0]], [[0.5]], [[1.0]], [[0.0]], 0.1))).by_name
    assert by_name["gain_up"].value == pytest.approx(2.0) and by_name["phase"].value == np.inf
    assert by_name["Ms"].value == pytest.approx(2.0) and by_name["Mt"].value == pytest.approx(1.0)


def test_the_published_example_of_disk_margins_has_its_published_numbers():
    """25/(s^3 + 10 s^2 + 10 s + 10) has 0.46 at 1.94 rad/s and gains from 0.63 to 1.59, by its authors ([13]
    in lib/THEORY.md)."""
    loop = rational([25.0], [1.0, 10.0, 10.0, 10.0])
    by_name = margins(*of_system(loop)).by_name["disk_balanced"]
    assert (by_name.value, by_name.omega) == (pytest.approx(0.46, abs=5e-3), pytest.approx(1.94, abs=0.02))
    low, high, _ = disk_gain_and_phase(by_name.value, SKEWS["balanced"])
    assert (low, high) == (pytest.approx(0.63, abs=5e-3), pytest.approx(1.59, abs=1e-2))
    theirs = control.disk_margins(peer(loop), np.array([by_name.omega]), returnall=True)[0]
    assert theirs[0] == pytest.approx(by_name.value, rel=1e-9)


def test_a_conditionally_stable_loop_has_a_gain_margin_downward():
    # Bode's example: low and high gain are both unstable, counted with a lag far below the crossings.
    loop = rational(np.poly([-1.0, -1.0]) * 20.0, np.poly([-0.05, -0.05, -0.05, -20.0, -40.0]) / 40.0)
    by_name = margins(*of_system(loop))
    assert by_name.unstable_poles == closed_poles(loop) == 0
    up, down = by_name.by_name["gain_up"].value, by_name.by_name["gain_down"].value
    assert 0 < down < 1 < up
    for factor, poles in ((0.99 * up, 0), (1.01 * up, 2), (1.01 * down, 0), (0.99 * down, 2)):
        scaled = StateSpace(loop.A, factor * loop.B, loop.C, loop.D)
        assert margins(*of_system(scaled)).unstable_poles == closed_poles(scaled) == poles


@pytest.mark.parametrize("skew", [-1.0, -0.3, 0.0, 1.0])
@pytest.mark.parametrize("alpha", [0.1, 0.6, 0.95])
def test_a_disk_covers_the_gain_and_phase_of_python_control(alpha, skew):
    low, high, phase = disk_gain_and_phase(alpha, skew)
    # A constant loop with S + (skew - 1)/2 = 1/alpha has this margin at every frequency.
    S = 1 / alpha - (skew - 1) / 2
    system = control.ss([[-1.0]], [[0.0]], [[1.0]], [[1 / S - 1]])
    _, gain_db, phase_deg = control.disk_margins(system, np.array([1.0]), skew=skew, returnall=True)
    assert 20 * np.log10(min(high, 1 / low)) == pytest.approx(gain_db[0])
    assert np.rad2deg(phase) == pytest.approx(phase_deg[0])


def test_a_disk_that_covers_all_is_unlimited():
    assert disk_gain_and_phase(2.0, 0.0) == (0.0, np.inf, pytest.approx(np.pi / 2))
    assert disk_gain_and_phase(np.inf, 0.0) == (0.0, np.inf, np.pi)
    assert disk_gain_and_phase(3.0, 0.0)[:2] == (0.0, np.inf)


def test_samples_give_the_margins_of_the_system():
    for loop in (rational([2.0], [1.0, 3.0, 3.0, 1.0]), to_discrete(rational([2.0], [1, 2, 2, 0.7]), 0.05)):
        response, grid = of_system(loop)
        omega = np.geomspace(1e-3, 60.0, 96)
        exact, sampled = margins(response, grid), margins(of_samples(omega, response(omega)), omega)
        for name in NAMES:
            assert sampled.by_name[name].value == pytest.approx(exact.by_name[name].value, rel=1e-3), name


def test_samples_that_do_not_tell_the_loop_are_refused():
    omega = np.geomspace(0.1, 10.0, 12)
    with pytest.raises(SynthesisError, match=r"L at .* an estimated error of .* more samples"):
        of_samples(omega, np.exp(-2j * omega))
    with pytest.raises(SynthesisError, match="not finite"):
        of_samples(omega, np.full(12, np.nan))
    for bad in (omega[::-1], omega[:5], omega - 0.1):
        with pytest.raises(SynthesisError, match="rising frequencies above 0"):
            of_samples(bad, np.ones(len(bad)))


def test_an_open_loop_that_is_not_stable_or_not_single_is_refused():
    with pytest.raises(SynthesisError, match="not stable"):
        of_system(rational([1.0], [1.0, -1.0]))
    with pytest.raises(SynthesisError, match="one input"):
        of_system(StateSpace([[-1.0]], [[1.0, 1.0]], [[1.0]], [[0.0, 0.0]]))
    with pytest.raises(SynthesisError, match="well-posed"):
        of_system(StateSpace([[-1.0]], [[1.0]], [[1.0]], [[-1.0]]))
    # 2/(s - 1), closed stably: 1 + L goes round 0 the other way.
    omega = np.concatenate([[0.0], np.geomspace(1e-3, 1e3, 2000)])
    with pytest.raises(SynthesisError, match="stable open loop"):
        unstable_poles(2 / (1j * omega - 1))
    with pytest.raises(SynthesisError, match="last frequency"):
        unstable_poles(np.array([0.5, 1.0, 0.5 - 5.0j]))
    with pytest.raises(SynthesisError, match="-1 at a frequency"):
        margins(lambda w: np.where(w == 1.0, -1.0, 0.1 + 0j), np.array([0.5, 1.0, 2.0]))


def test_what_is_promised_holds_for_every_loop_of_the_set_and_for_one_barely():
    response, grid = of_system(rational([2.0], [1.0, 3.0, 3.0, 1.0]))
    weight = rational([0.3, 0.2], [0.5, 1.0])

    def radius(w):
        return np.abs(response(w) * weight.response(w)[:, 0, 0])

    promised = guaranteed(response, radius, grid).by_name
    barely, larger_is_worse = np.inf, ("gain_down", "Ms", "Mt")
    for turn in np.linspace(-np.pi, np.pi, 25):
        # On the edge of the disk at every frequency, at one angle to its centre.
        def loop(w, turn=turn):
            return response(w) * (1 + weight.response(w)[:, 0, 0] * np.exp(1j * turn))

        omega = grid[grid < 100.0]
        curve = loop(omega)
        S = np.abs(1 / (1 + curve)).max()
        assert promised["Ms"].value * (1 + 1e-9) >= S
        barely = min(barely, promised["Ms"].value / S)
        T = np.abs(curve / (1 + curve)).max()
        assert promised["Mt"].value * (1 + 1e-9) >= T
        half = np.abs(1 / (1 + curve) - 0.5).max()
        assert 1 / half >= promised["disk_balanced"].value * (1 - 1e-9)
        if abs(turn) in (0.0, np.pi):
            by_name = margins(loop, grid).by_name
            for name in NAMES:
                better = by_name[name].value - promised[name].value
                assert better * (-1 if name in larger_is_worse else 1) >= -1e-9, name
    assert barely < 1.01 and promised["gain_up"].value < 4.0
    # At the place of each promised margin the disk touches -1.
    w, factor = np.array([promised["gain_up"].omega]), promised["gain_up"].value
    assert abs(1 + factor * response(w)[0]) == pytest.approx(factor * radius(w)[0], rel=1e-6)
    w, turn = np.array([promised["phase"].omega]), np.exp(-1j * promised["phase"].value)
    assert abs(1 + turn * response(w)[0]) == pytest.approx(radius(w)[0], rel=1e-6)
    w = np.array([promised["delay"].omega])
    late = response(w)[0] * np.exp(-1j * w[0] * promised["delay"].value)
    assert abs(1 + late) == pytest.approx(radius(w)[0], rel=1e-6)


def test_a_set_without_uncertainty_has_the_loops_own_margins_and_a_large_one_none():
    response, grid = of_system(rational([2.0], [1.0, 3.0, 3.0, 1.0]))
    own = margins(response, grid).by_name
    promised = guaranteed(response, lambda w: 1e-7 * np.abs(response(w)), grid).by_name
    for name in ("gain_up", "phase", "delay", "Ms", "Mt", "disk_balanced"):
        assert promised[name].value == pytest.approx(own[name].value, rel=1e-3), name
    assert guaranteed(response, lambda w: 2 * np.abs(response(w)), grid) is None
    assert guaranteed(lambda w: 10 * response(w), lambda w: 0 * w, grid) is None
