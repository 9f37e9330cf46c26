"""lpvguard_plant_tool as its callers use it: experiments repeat to the byte, and bad input leaves no file.

The tool is the one that `lpvguard generate` runs.
"""

import re
import subprocess

import numpy as np
import pytest

from lpvguard.base.errors import InputError
from lpvguard.extras.loop.generate import plant_tool
from lpvguard.extras.loop.response import frequency_response
from made import ROOT

TOOL = str(plant_tool())

SIGN_FLIP = """
[plant]
speed_profile = [[0, 10], [10, 15]]
[[plant.sensor_fault]]
signal = "yaw_rate"
gain = -1.0
"""


def run(*words):
    return subprocess.run([TOOL, *map(str, words)], capture_output=True, text=True, check=False)


def generate(path, *words):
    done = run("generate", "-o", path, *words)
    assert done.returncode == 0, done.stderr
    return np.loadtxt(path, delimiter=",", skiprows=1)


@pytest.mark.parametrize("program", ["pulses", "telegraph", "multisine", "sweep", "zero"])
def test_an_experiment_repeats_to_the_byte_and_its_seed_matters(tmp_path, program):
    paths = [tmp_path / name for name in ("a.csv", "b.csv", "c.csv")]
    for path, seed in zip(paths, (3, 3, 4), strict=True):
        table = generate(path, "--program", program, "--speed", 17, "--duration", 20, "--seed", seed)
        assert table.shape == (2000, 5)
    assert paths[0].read_bytes() == paths[1].read_bytes()
    assert paths[0].read_bytes() != paths[2].read_bytes()
    assert paths[0].read_text().startswith("t,v,dp,r,delta\n0,")


def test_the_bank_is_a_further_column_that_moves_the_truck(tmp_path):
    options = "--speed", 17, "--duration", 200, "--program", "zero"
    plain = generate(tmp_path / "a.csv", *options)
    banked = generate(tmp_path / "b.csv", *options, "--further-column", "bank")
    assert (tmp_path / "b.csv").read_text().startswith("t,v,dp,r,delta,bank\n")
    np.testing.assert_array_equal(banked[:, :5], plain)
    bank, r = banked[100:-100, 5], banked[200:, 3]
    assert 0.002 < bank.std() < 0.01
    assert np.corrcoef(bank, r)[0, 1] < -0.4, "a second later the truck turns to the low side"
    refused = run("generate", "-o", tmp_path / "c.csv", "--further-column", "wind")
    assert refused.returncode == 2 and "expected bank" in refused.stderr


def test_the_columns_mean_what_the_header_says(tmp_path):
    t, v, dp, r, delta = generate(tmp_path / "a.csv", "--speed", 12, "--duration", 300).T
    assert np.allclose(np.diff(t), 0.01)
    assert np.allclose(v, 12, atol=0.1)
    braked = dp != 0
    assert 0.3 < braked.mean() < 0.7
    assert np.abs(dp[braked]).min() >= 0.5 and np.abs(dp).max() <= 2.0
    assert np.all(dp[t < 1.0] == 0.0)
    assert np.corrcoef(r[100:], dp[:-100])[0, 1] < -0.5, "braking right turns right"
    assert np.corrcoef(r, delta)[0, 1] > 0.9


@pytest.mark.unhurried
def test_the_amplitudes_of_the_programs(tmp_path):
    telegraph = generate(
        tmp_path / "t.csv", "--program", "telegraph", "--amplitude-low", 1, "--amplitude-high", 1
    )[:, 2]
    assert set(np.unique(telegraph)) == {-1.0, 0.0, 1.0}
    multisine = generate(tmp_path / "m.csv", "--program", "multisine", "--duration", 600)[:, 2]
    assert 0.8 < multisine.std() < 1.2 and np.abs(multisine).max() <= 2.0
    assert not generate(tmp_path / "z.csv", "--program", "zero")[:, 2].any()


def test_a_sweep_goes_from_0p1_to_30_rad_per_s_at_one_amplitude(tmp_path):
    """Its frequency is exponential in time: equal times have equal ratios of it."""
    duration = 400.0
    words = ("--program", "sweep", "--duration", duration, "--amplitude-low", 0.8, "--amplitude-high", 0.8)
    t, _, dp, _, _ = generate(tmp_path / "s.csv", *words).T
    assert not dp[t <= 1.0].any() and np.abs(dp).max() == pytest.approx(0.8, abs=1e-3)
    rate = np.log(30 / 0.1) / (duration - 1)
    phase = 0.1 / rate * np.expm1(rate * (t - 1))
    np.testing.assert_allclose(dp[t >= 1], 0.8 * np.sin(phase[t >= 1]), atol=2e-3)
    crossings = t[1:][np.diff(np.signbit(dp)) & (t[1:] > 1.5)]
    omega = np.pi / np.diff(crossings)
    assert omega[0] < 0.2 and 27 < omega[-20:].mean() < 30.5
    assert np.all(np.diff(omega[omega < 3]) > 0)


def test_a_scenario_sets_speed_and_faults(tmp_path):
    (tmp_path / "flip.toml").write_text(SIGN_FLIP)
    _, v, _, r, delta = generate(tmp_path / "a.csv", "--scenario", tmp_path / "flip.toml").T
    assert abs(v[0] - 10) < 0.1 and abs(v[-1] - 15) < 0.1
    assert np.corrcoef(r, delta)[0, 1] < -0.9


@pytest.mark.parametrize(
    ("words", "complaint"),
    [
        (["--speed", "40"], "expected a number, 3"),
        (["--speed", "fast"], "expected a number"),
        (["--duration", "nan"], "--duration"),
        (["--seed", "-1"], "expected a whole number"),
        (["--program", "waltz"], "expected pulses, telegraph, multisine, sweep or zero"),
        (["--amplitude-low", "3", "--amplitude-high", "2"], "--amplitude-high"),
        (["--colour", "red"], "--colour: unknown option"),
        (["--seed"], "expected a value"),
        (["--seed", "1", "--seed", "2"], "given twice"),
        (["--parameters", "/nowhere.toml"], "/nowhere.toml: cannot be read"),
        (["--scenario", "/nowhere.toml"], "/nowhere.toml: cannot be read"),
    ],
)
def test_bad_input_exits_2_names_the_fault_and_leaves_no_file(tmp_path, words, complaint):
    done = run("generate", "-o", tmp_path / "a.csv", *words)
    assert done.returncode == 2
    assert complaint in done.stderr
    assert list(tmp_path.iterdir()) == []


def test_an_unwritable_place_is_named(tmp_path):
    done = run("generate", "-o", tmp_path / "missing" / "a.csv")
    assert done.returncode == 2
    assert "missing" in done.stderr


def test_help_lists_the_commands_and_an_unknown_one_is_refused():
    assert "frequency-response" in run("generate", "--help").stdout
    assert run().returncode == 2
    assert "unknown command" in run("dance").stderr


def test_digest_repeats_and_depends_on_the_seed():
    digests = [run("digest", "--duration", 20, "--seed", seed).stdout for seed in (1, 1, 2)]
    assert digests[0] == digests[1] != digests[2]


def response(path, *words):
    done = run("response", "--scenario", path, *words)
    assert done.returncode == 0, done.stderr
    rows = np.loadtxt(done.stdout.splitlines(), delimiter=",", skiprows=1, ndmin=2)
    return rows[:, 0], rows[:, 1] + 1j * rows[:, 2], rows[:, 3] + 1j * rows[:, 4]


def test_the_response_of_a_scenarios_truck_includes_its_faults_from_the_start_on(tmp_path):
    path = tmp_path / "truck.toml"
    path.write_text("[plant]\nspeed_profile = [[0, 10]]\n")
    omega, yaw, wheel = response(path, "--speed", 15, "--omega", "0,0.5,3")
    np.testing.assert_allclose(omega, [0.0, 0.5, 3.0], rtol=5e-4)
    assert yaw[0].imag == 0 and -1.4 * 1.94 / 15 < yaw[0].real < -0.6 * 1.94 / 15 and wheel[0].real < 0
    assert abs(yaw[2]) < abs(yaw[1]) < 1.1 * abs(yaw[0])
    path.write_text(
        "[plant]\nspeed_profile = [[0, 10]]\n[[plant.actuator_fault]]\n"
        "start_s = 60.0\nextra_delay_s = 0.2\nbrake_gain_ratio = 0.5\n"
    )
    _, late, _ = response(path, "--speed", 15, "--omega", "0,0.5,3", "--amplitude", 1)
    np.testing.assert_allclose(
        late / yaw, 0.5 * np.exp(-0.2j * omega), rtol=0.02
    )  # half the force of twice the demand
    for words, complaint in (
        (["--omega", "1,fast"], "--omega 'fast'"),
        (["--omega", "1", "--speed", "50"], "--speed"),
        ([], "--omega: missing"),
    ):
        done = run("response", "--scenario", path, *words)
        assert done.returncode == 2 and complaint in done.stderr


def test_the_response_is_driven_in_whole_samples_and_a_delay_turns_it(tmp_path):
    path = tmp_path / "truck.toml"
    path.write_text("[plant]\nspeed_profile = [[0, 10]]\n")
    omega, G = frequency_response("", 15.0, 0.5, np.array([0.3, 2.0, 9.0, 40.0, 60.0]))
    again, yaw, wheel = response(path, "--speed", 15, "--omega", "0.3,2,9,40,60", "--amplitude", 0.5)
    assert np.array_equal(again, omega) and np.array_equal(G, np.column_stack([yaw, wheel]))
    samples = 2 * np.pi / omega / 0.01  # whole periods take whole samples, at least 1000
    periods = np.ceil(1000 / (2 * np.pi / np.array([0.3, 2.0, 9.0, 40.0, 60.0]) / 0.01))
    np.testing.assert_allclose(periods * samples, np.round(periods * samples), atol=1e-3)
    late = "[[plant.actuator_fault]]\nstart_s = 0.0\nextra_delay_s = 0.05\n"
    _, delayed = frequency_response(late, 15.0, 0.5, np.array([0.3, 2.0, 9.0, 40.0, 60.0]))
    np.testing.assert_allclose(delayed, G * np.exp(-0.05j * omega)[:, None], rtol=0.02)
    with pytest.raises(InputError, match="response"):
        frequency_response("", 99.0, 0.5, omega)


TRUCK = ROOT / "firmware_sim/plant/truck.toml"
LIMITS = "limits (1 bar, to 6 rad/s): median in 3 .. 13 %, worst at most 40 %"


def compare(tmp_path, brake_force, points):
    """Exit status, verdict, and per speed: (medians, worsts) [%] of yaw rate and wheel angle per pressure to
    6 rad/s, and the row's mark."""
    text, count = re.subn(
        r"(brake_force_npbar = \{ value = )800\.0", rf"\g<1>{brake_force}", TRUCK.read_text(encoding="utf-8")
    )
    assert count == 1
    (tmp_path / "truck.toml").write_text(text, encoding="utf-8")
    done = run("frequency-response", "--points", points, "--parameters", tmp_path / "truck.toml")
    assert LIMITS in done.stdout and done.stderr == ""
    rows = [line for line in done.stdout.splitlines() if re.match(r" *\d+\.0 \|", line)]
    assert [float(row.split("|")[0]) for row in rows] == [8, 10, 12, 14, 16, 18, 20, 22]
    numbers = [
        [[float(x) for x in re.findall(r"[\d.]+(?= %)", column)] for column in row.split("|")[1:3]]
        for row in rows
    ]
    marks = [row.endswith("OUTSIDE") for row in rows]
    return done.returncode, done.stdout.splitlines()[-1], np.array(numbers), marks


@pytest.mark.slow("3 s: every limit of the truck")
def test_the_shipped_truck_keeps_the_designs_distance_from_table_i(tmp_path):
    status, verdict, numbers, marks = compare(tmp_path, 800.0, 24)
    assert status == 0 and verdict == "within the limits" and not any(marks)
    median, worst = numbers[..., 0], numbers[..., 1]
    assert median.min() >= 3 and median.max() <= 13 and worst.max() <= 40


@pytest.mark.slow("2 s: the truck measured")
def test_each_limit_puts_a_truck_outside(tmp_path):
    """Both limits of the median alone; the worst only beside a median that is too far."""
    causes = set()
    for brake_force in (820.0, 960.0):  # few frequencies: the medians spread
        status, verdict, numbers, marks = compare(tmp_path, brake_force, 6)
        assert status == 1 and verdict == "OUTSIDE the limits"
        for row, mark in zip(numbers, marks, strict=True):
            median, worst = row.T
            broken = {
                name
                for name, bad in (("too near", median < 3), ("too far", median > 13), ("worst", worst > 40))
                if bad.any()
            }
            assert mark == bool(broken), (row, mark)
            causes.add(tuple(sorted(broken)))
    assert {("too near",), ("too far",), ("too far", "worst"), ()} <= causes
