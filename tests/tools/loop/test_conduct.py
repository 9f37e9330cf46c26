"""What falsifies a certificate: steady lines are told from noise, resonance, steps and decay; stretches at
the limit; tracking; and which trucks count as within the bounds."""

from types import SimpleNamespace

import numpy as np
import pytest
from scipy.signal import lfilter

from lpvguard.base.errors import InputError
from lpvguard.extras.loop.campaign import chunked_runs, conduct, scenarios, trucks
from lpvguard.extras.loop.campaign.scenarios import Command, Drawn, PlannedRun
from lpvguard.vehicle.nominal import NominalModel

Ts = 0.01
T = np.arange(18000) * Ts
BAND = 1.0
"""[rad/s] Highest commanded frequency."""


def command(rms: float, seed: int = 0) -> np.ndarray:
    """A multisine of 48 lines up to BAND."""
    random = np.random.default_rng(seed)
    lines = np.sin(np.outer(T, random.uniform(0.02, BAND, 48)) + random.uniform(0, 2 * np.pi, 48))
    return rms * np.sqrt(2 / 48) * lines.sum(axis=1)


def resonance(damping: float, rms: float, seed: int) -> np.ndarray:
    """Noise through a resonance of 9 rad/s."""
    pole = np.exp(9.0 * Ts * complex(-damping, np.sqrt(1 - damping**2)))
    x = lfilter(
        [1.0], np.poly([pole, pole.conjugate()]).real, np.random.default_rng(seed).standard_normal(len(T))
    )
    return rms * x / x.std()


def test_a_limit_cycle_is_a_steady_line_with_its_amplitude_and_frequency():
    noise = 0.05 * np.random.default_rng(1).standard_normal(len(T))
    for amplitude in (0.3, 1.0):
        u = command(0.5) + noise + amplitude * np.sin(9.1 * T)
        line = conduct.steady_line(u, Ts, BAND)
        assert line.bar == pytest.approx(amplitude, rel=0.05)
        assert line.radps == pytest.approx(9.1, abs=0.2)
    cut = np.clip(command(0.5) + 20.0 * np.sin(9.1 * T), -2.06, 2.06)
    assert conduct.steady_line(cut, Ts, BAND).bar == pytest.approx(2.06 * 4 / np.pi, rel=0.05), (
        "a square wave"
    )
    late = command(0.5) + np.where(T > 130.0, np.sin(9.1 * T), 0.0)
    assert conduct.steady_line(late, Ts, BAND).bar == pytest.approx(1.0, rel=0.05), "announced late"
    moving = command(0.5) + np.sin(9.1 * T - 0.002 * T**2)
    assert conduct.steady_line(moving, Ts, BAND).bar > 0.8, "its frequency drifts with the speed"


@pytest.mark.parametrize("damping", [0.17, 0.3, 0.7])
def test_noise_through_a_damped_loop_is_no_line(damping):
    """Ms = 3 is a damping of about 0.17."""
    for seed in range(10):
        u = command(0.5, seed) + resonance(damping, 0.5, seed)
        assert conduct.steady_line(u, Ts, BAND).bar == 0.0


def test_a_command_a_step_and_what_decays_are_no_lines():
    assert conduct.steady_line(command(0.7), Ts, BAND).bar == 0.0
    white = np.random.default_rng(2).standard_normal(len(T))
    assert conduct.steady_line(command(0.5) + 0.5 * white, Ts, BAND).bar == 0.0
    decaying = command(0.5) + 2.0 * np.exp(-T / 25.0) * np.sin(9.1 * T)
    assert conduct.steady_line(decaying, Ts, BAND).bar == 0.0
    answer = lfilter([0.02], [1.0, -0.98], np.sign(np.sin(2 * np.pi * T / 25.0)))
    assert conduct.steady_line(1.5 * answer, Ts, 3.0).bar < conduct.LEAST_BAR
    ringing = sum(np.where(a < T, np.exp(-(T - a)) * np.sin(9.1 * (T - a)), 0) for a in range(10, 170, 20))
    assert conduct.steady_line(1.5 * ringing, Ts, BAND).bar < conduct.LEAST_BAR, "a damped answer to steps"
    assert conduct.steady_line(np.zeros(len(T)), Ts, BAND).bar == 0.0
    assert conduct.steady_line(np.ones(100), Ts, BAND).bar == 0.0, "shorter than a window"


def test_a_stretch_at_the_limit_is_not_ended_by_an_instant():
    at = np.zeros(1000, bool)
    assert conduct.longest_stretch(at, Ts) == 0.0
    at[100:160] = True
    at[165:205] = True
    assert conduct.longest_stretch(at, Ts) == pytest.approx(1.05), "50 ms off the limit"
    at[160:165] = at[165:175] = False
    assert conduct.longest_stretch(at, Ts) == pytest.approx(0.6), "150 ms off the limit"
    at[:] = True
    assert conduct.longest_stretch(at, Ts) == pytest.approx(10.0)


def test_power_up_to_a_frequency():
    t = np.arange(1800) * 0.1
    slow, fast = 2 * np.pi * 9 / 180, 2 * np.pi * 90 / 180
    x = 0.3 + np.sin(slow * t) + np.sin(fast * t)
    assert conduct.band_rms(x, 0.1, 1.0) == pytest.approx(np.sqrt(0.09 + 0.5))
    assert conduct.band_rms(x, 0.1, 40.0, lambda omega: 2.0 + (omega > 1)) == pytest.approx(
        np.sqrt(4 * (0.09 + 0.5) + 9 * 0.5)
    )
    assert conduct.band_rms(x, 0.1, 40.0) == pytest.approx(np.sqrt(0.09 + 1.0)) == np.sqrt(np.mean(x**2))


def row(**other) -> dict:
    """Of a run in which nothing is ruled out."""
    good = {"line_bar": 0.0, "line_radps": 0.0, "limited_stretch_s": 0.2, "brake_gain": 1.0}
    error = {"error_rms_radps": 0.0045, "allowed_rms_radps": 0.0121}
    return good | error | {"wanted_rms_radps": 0.05, "free_rms_radps": 0.003} | other


@pytest.mark.parametrize(
    ("other", "said"),
    [
        ({}, []),
        ({"line_bar": 0.26, "line_radps": 9.0}, ["oscillates at 9 rad/s with 0.26 bar"]),
        ({"line_bar": 0.24, "line_radps": 9.0}, []),
        ({"limited_stretch_s": 1.0}, ["saturates for 1 s"]),
        ({"limited_stretch_s": 0.99}, []),
        ({"error_rms_radps": 0.0121}, []),
        ({"error_rms_radps": 0.0122}, ["loses track by 12.2 mrad/s rms up to 1 rad/s, allowed 12.1 "]),
        ({"brake_gain": 0.75, "allowed_rms_radps": 0.0044}, ["loses track"]),
    ],
)
def test_what_a_certificate_rules_out(other, said):
    ruled_out = list(conduct.ruled_out(row(**other)))
    assert len(ruled_out) == len(said)
    for text, start in zip(ruled_out, said, strict=True):
        assert text.startswith(start)


@pytest.fixture
def measured(monkeypatch, truck):
    """A truck whose response is the nominal one times 1 + factor(omega, v, amplitude) of the second output;
    the points that were measured."""
    model, points = NominalModel(truck), []

    def set_factor(factor) -> list:
        def response(tables, v, amplitude, omega):
            points.append((v, amplitude, len(omega)))
            P = model.frequency_response(omega, v)[..., 0]
            return omega, P * np.column_stack([np.ones(len(omega)), 1 + factor(omega, v, amplitude)])

        monkeypatch.setattr(trucks, "frequency_response", response)
        return points

    return set_factor


def bounds(truck, W) -> trucks.CertifiedSet:
    """The set with |W_delta| = W(omega) of both outputs, omega as the sampled loop has it."""

    def at(warped):
        omega = 2 / truck.Ts_s * np.arctan(warped * truck.Ts_s / 2)
        return np.column_stack([W(omega)] * 2), np.ones((len(omega), 2))

    return trucks.CertifiedSet(truck, SimpleNamespace(at=at))


def test_a_truck_beyond_the_weight_at_one_frequency_is_not_within(truck, measured):
    at = trucks.OMEGA[1][3]

    def weight(omega):
        return 0.3 * (1 + omega / 20)

    points = measured(lambda omega, v, amplitude: 0.99 * weight(omega))
    distance = bounds(truck, weight).distance("")
    assert distance.ratio == pytest.approx(0.99) and distance.output == "road_wheel_angle"
    assert distance.least_gain == pytest.approx(1.0)
    assert {v for v, _, _ in points} == {8.0, 12.0, 17.0, 22.0}
    assert {round(u, 2) for _, u, _ in points} == {0.25, 0.7, 2.06}
    assert sum(n for _, _, n in points) == 40 * 12

    def one(omega, v, amplitude):
        """Beyond it at one frequency, one speed and the largest amplitude."""
        beyond = (v == 17.0) & (amplitude > 2.0) & (omega == at)
        return np.where(beyond, 1.01, 0.99) * weight(omega)

    measured(one)
    distance = bounds(truck, weight).distance("")
    assert distance.ratio == pytest.approx(1.01) and distance.omega_radps == at and distance.speed_mps == 17.0
    assert distance.amplitude_bar == pytest.approx(2.0624, abs=1e-4)


def test_the_grid_of_the_response_holds_what_the_runs_do(truck):
    omega = np.sort(np.concatenate(trucks.OMEGA))
    assert len(omega) == 40 and omega[0] == pytest.approx(0.02) and omega[-1] == pytest.approx(60.0)
    assert len(set(omega)) == 40
    assert (
        trucks.RESPONSE_SPEEDS[0] <= scenarios.SPEEDS[0] < scenarios.SPEEDS[1] <= trucks.RESPONSE_SPEEDS[-1]
    )
    checked = trucks.CertifiedSet(truck, SimpleNamespace()).checked()
    assert [min(u) for u in checked["amplitudes_bar"]] == [conduct.LEAST_BAR] * 4


def test_a_certificate_about_more_than_the_weight_is_refused(truck):
    design = truck.design.model_copy(update={"structure": "K_is"})
    stored = SimpleNamespace(project=truck.model_copy(update={"design": design}), fitted=None)
    with pytest.raises(InputError, match="its certificate needs more than W_delta"):
        trucks.CertifiedSet.from_identification(stored)


def test_speeds_and_demands_of_the_runs_lie_in_what_is_checked():
    """Every kind of command, that of the steering task among them."""
    limit, asked, speeds, kinds = 2.06, [], [], set()
    for n in range(300):
        gain = 1.0 if n % 2 else 0.7
        drawn = Drawn.for_run(limit, 4, PlannedRun(n, "within", 0.0, 0, 0.0, "", gain))
        asked.append(drawn.demand_bar / gain)
        speeds += [v for _, v in drawn.profile]
        kinds.add((drawn.command.keys.split("\n")[0], drawn.command.highest, drawn.command.size))
    assert conduct.LEAST_BAR <= min(asked) < 0.3 and max(asked) == pytest.approx(0.85 * limit)
    assert 8.1 <= min(speeds) < 8.5 and 21.5 < max(speeds) <= 21.9
    assert len(kinds) == 5 and ('kind = "multisine"', 1.0, 0.05) in kinds


@pytest.mark.parametrize("speed", [9.0, 20.0])
def test_a_command_is_as_large_as_the_demand_allows(truck, speed):
    """A sine whose demand is known from the nominal response, and one that is asked for less than that."""
    model, t = NominalModel(truck), np.arange(1800) * 0.1
    omega = 2 * np.pi * 20 / 180
    unit = 0.05 * np.sin(omega * t)
    gain = abs(model.frequency_response(np.array([omega]), speed)[0, 0, 0])
    drawn = Drawn([(0.0, speed)], Command("", 1.0), 1.2, 1)
    assert drawn.size(model, unit, 0.1) == pytest.approx(1.2 * gain, rel=1e-3)
    own = Drawn([(0.0, speed)], Command("", 1.0, 0.01), 1.2, 1)
    assert own.size(model, unit, 0.1) == 0.01
    fast = unit + 0.05 * np.sin(2 * np.pi * 200 / 180 * t)
    assert drawn.size(model, fast, 0.1) == pytest.approx(1.2 * gain, rel=1e-3), "above 4 rad/s nobody follows"
    drifting = Drawn([(0.0, speed), (60.0, speed + 1.9)], Command("", 1.0), 1.2, 1)
    gains = [abs(model.frequency_response(np.array([omega]), v)[0, 0, 0]) for v in (speed, speed + 1.9)]
    assert drifting.size(model, unit, 0.1) == pytest.approx(1.2 * min(gains), rel=1e-3)


@pytest.mark.parametrize(
    ("other", "beyond"),
    [
        # 5 and 3 mrad/s add to 5.83, 7.5 and 3 to 8.08, 1 and 3 to 3.16.
        ({"error_rms_radps": 0.0058}, False),
        ({"error_rms_radps": 0.0059}, True),
        ({"error_rms_radps": 0.0059, "brake_gain": 0.79}, False),
        ({"error_rms_radps": 0.0059, "brake_gain": 0.8}, True),
        ({"error_rms_radps": 0.0081, "brake_gain": 0.75}, True),
        ({"error_rms_radps": 0.0031, "wanted_rms_radps": 0.01}, False),
        ({"error_rms_radps": 0.0032, "wanted_rms_radps": 0.01}, True),
    ],
)
def test_what_is_asked_for_and_not_proved(other, beyond):
    assert conduct.beyond_wish(row(**other)) is beyond


def test_a_campaign_takes_a_folder_with_the_frame_tests_bounds_alone():
    W, B, wider = np.full((3, 2), 0.4), np.full((3, 2), 0.01), np.full((3, 2), 0.9)
    stored = SimpleNamespace(
        folder="found", fitted=SimpleNamespace(of_core=lambda _: iter([(W, B), (wider, wider)]))
    )
    estimator, core = SimpleNamespace(omega=np.arange(3.0)), SimpleNamespace(folder="code")
    chunked_runs._require_same(stored, SimpleNamespace(estimator=estimator, core=core, W_delta=W, B_w=B))
    other = SimpleNamespace(estimator=estimator, core=core, W_delta=wider, B_w=wider)
    with pytest.raises(InputError, match="code: bounds: are not those of the identification"):
        chunked_runs._require_same(stored, other)
