"""The closed loop over CAN frames: what the shipped scenarios expect, repeatability, bus faults, bad input,
the command."""

import json
import re
import shutil

import numpy as np
import pytest

from lpvguard.base import artefacts
from lpvguard.base.errors import InputError
from lpvguard.can.catalogue import load_catalogue
from lpvguard.can.logs import EXTENDED, read_log
from lpvguard.extras.loop.sim import (
    Expectation,
    Simulator,
    can_fault_table,
    feedforward,
    load_scenario,
    missed,
    shipped_scenarios,
    steady_scenario,
)
from lpvguard.vehicle.project import load_project
from vcan import sim_words, with_vcan

SEEDS = (1, 2)
LOCKED_SPN = 520204
INVALID_SPN = 520201
MESSAGE_PERIODS = {"VDC2": 0.01, "GUARD_IN": 0.01, "EBC2": 0.1, "EBC1": 0.1}


@pytest.fixture
def scenario(tmp_path):
    """A scenario of so many seconds with further tables."""

    def write(duration: float, more: str = ""):
        path = tmp_path / "scenario.toml"
        path.write_text(small_steps(duration, more))
        return load_scenario(str(path))

    return write


def small_steps(duration: float, more: str = "") -> str:
    return steady_scenario(duration, more, rms_radps=0.05)


def can_fault(message: str, kind: str, **more: float) -> str:
    return can_fault_table(message, kind, 5.0, 10.0, **more)


@pytest.mark.parametrize("name", shipped_scenarios())
@pytest.mark.slow("every shipped scenario, with two seeds")
def test_shipped_scenarios_show_what_they_expect(simulator, name):
    for seed in SEEDS:
        run = simulator.run(load_scenario(name), seed=seed)
        print(
            f"{name}, seed {seed}: invalid at {run['first_invalid_s']}, "
            f"{run['real_time_factor']:.0f} x real time"
        )
        assert run["missed"] == []


def test_the_same_scenario_twice_sends_the_same_bytes(simulator, scenario, tmp_path):
    twice = [simulator.run(scenario(20.0), out=tmp_path / name) for name in ("first", "second")]
    logs = [(tmp_path / name / "scenario-1.log").read_bytes() for name in ("first", "second")]
    assert logs[0] == logs[1] and logs[0].count(b"\n") == twice[0]["frames"] > 0
    for run in twice:
        run.pop("real_time_factor")
    assert twice[0] == twice[1]
    other = simulator.run(scenario(20.0), seed=2)
    assert other["frames_hash"] != twice[0]["frames_hash"]


def test_the_log_is_candump_with_simulated_time(simulator, scenario, tmp_path):
    simulator.run(scenario(1.0), out=tmp_path)
    lines = (tmp_path / "scenario-1.log").read_text().splitlines()
    assert (
        lines[0].startswith("(0.000000) can0 18F0093E#")
        and len(lines[0]) == len("(0.000000) can0 18F0093E#") + 16
    )
    ids = [line.split()[2].split("#")[0] for line in lines]
    # 10 ms: VDC2, GUARD_IN, its authenticator, GUARD_OUT; 100 ms: EBC2, CCVS1, EBC3, EBC1; 1 s: DM1
    assert {i: ids.count(i) for i in ids} == {
        "18F0093E": 100,
        "18FF000B": 100,
        "18FF020B": 100,
        "0CFF01FC": 100,
        "18FEBF0B": 10,
        "18FEF100": 10,
        "18FEAD0B": 10,
        "18F0010B": 10,
        "18FECAFC": 1,
    }


def test_every_report_says_that_commands_are_authenticated(simulator, scenario, tmp_path):
    run = simulator.run(scenario(1.0), out=tmp_path)
    assert run["reception"]["authentication"] == {"passed": 100, "alone": 0, "length": 0, "forged": 0}
    log = read_log(tmp_path / "scenario-1.log")
    reports = log.data[log.id == np.uint32(load_catalogue().message("GUARD_OUT").id | EXTENDED)]
    assert len(reports) == 100 and (reports[:, 6] >> 4 & 3 == 1).all()


def test_not_engaged_the_brakes_stay_released(truck_folder, scenario):
    run = Simulator(truck_folder, controller="off").run(scenario(10.0))
    assert run["demand_max_bar"] < 1 / 2048 and run["supervision"][-1][1] == "live"


def test_feedforward_has_the_limits_of_the_controller_that_it_is_compared_with():
    project, nodes = load_project("truck"), np.linspace(8.0, 22.0, 4)
    u_max, rate_max = np.array([[6.0], [2.0], [1.5], [4.0]]), np.array([40.0])
    reals = feedforward(project, nodes, u_max, rate_max).reals
    finer = np.linspace(8.0, 22.0, len(reals["u_max"]))
    v = np.random.default_rng(1).uniform(8.0, 22.0, 200)
    wanted = np.interp(v, nodes, u_max[:, 0])
    np.testing.assert_allclose(np.interp(v, finer, reals["u_max"][:, 0]), wanted, rtol=1e-12)
    np.testing.assert_array_equal(reals["rate_max"], rate_max)


@pytest.mark.slow("12 s: a simulator around another core")
def test_feedforward_runs_on_the_same_seeds(truck_folder, simulator):
    nominal = load_scenario("nominal")
    compared = Simulator(truck_folder, controller="feedforward").run(nominal)
    closed = simulator.run(nominal)
    assert compared["command_rms"] == closed["command_rms"] and closed["missed"] == []
    assert [text.split()[0] for text in compared["missed"]] == ["tracking"], "the scenario asks for feedback"
    assert closed["tracking_rms"] < compared["tracking_rms"]


def test_a_profile_is_followed_and_its_faults_are_named(simulator, tmp_path):
    path = tmp_path / "profile.toml"
    steady = small_steps(10)
    multisine = steady[steady.index('kind = "multisine"') : steady.index("\n[expect]")]

    def write(knots: str) -> None:
        path.write_text(steady.replace(multisine, f'kind = "profile"\nknots = {knots}\n'))

    write("[[1.0, 0.01], [3.0, 0.05], [3.5, -0.02]]")
    simulator.run(load_scenario(str(path)), out=tmp_path)
    rows = np.genfromtxt(tmp_path / "profile-1.telemetry.csv", delimiter=",", names=True)
    np.testing.assert_allclose(
        rows["command_radps"], np.interp(rows["t_s"], [1.0, 3.0, 3.5], [0.01, 0.05, -0.02]), atol=1e-9
    )
    for knots in ("[]", "[[0.0]]", "[[1.0, 0.0], [1.0, 0.1]]", "[[0.0, 0.9]]", "3.0"):
        write(knots)
        with pytest.raises(InputError, match=r"command\.knots"):
            simulator.run(load_scenario(str(path)))


@pytest.mark.parametrize("message", MESSAGE_PERIODS)
@pytest.mark.parametrize("kind", ["lost", "delayed"])
def test_a_needed_message_that_stops_is_missed_within_5_periods(simulator, scenario, message, kind):
    run = simulator.run(
        scenario(15.0, can_fault(message, kind, **({"delay_s": 1.0} if kind == "delayed" else {})))
    )
    left = next(t for t, state in run["supervision"] if t > 1.0 and state != "live")
    assert 5.0 <= left <= 5.0 + 5 * MESSAGE_PERIODS[message]
    assert run["supervision"][-1][1] == "live" and run["trouble_codes"][1][1]["spn"] != 0
    # Pressures a second old contradict the demand: that locks. Motion a second old is another response.
    codes = {("GUARD_IN", "delayed"): LOCKED_SPN, ("VDC2", "delayed"): INVALID_SPN}
    assert run["trouble_codes"][-1][1]["spn"] == codes.get((message, kind), 0)


def test_corrupted_protected_frames_are_never_used(simulator, scenario):
    run = simulator.run(scenario(15.0, can_fault("GUARD_IN", "corrupted")))
    assert any(state == "off" for t, state in run["supervision"] if 5.0 < t < 10.0)


def test_single_losses_are_bridged(simulator, scenario):
    run = simulator.run(scenario(15.0, can_fault("VDC2", "lost", probability=0.1)))
    assert [state for _, state in run["supervision"]] == ["off", "live"]


def test_a_lost_actuator_is_found(simulator, scenario):
    run = simulator.run(scenario(90.0, "[[plant.actuator_fault]]\nstart_s = 40.0\nbrake_gain_ratio = 0.0\n"))
    assert run["first_invalid_s"] is not None and 40.0 < run["first_invalid_s"] < 70.0


@pytest.mark.long("12 s: a run on a kernel's bus")
@pytest.mark.serial
def test_a_real_can_interface_carries_the_same_frames(simulator, truck_folder, scenario):
    fault = scenario(15.0, can_fault("VDC2", "lost"))
    done = with_vcan(*sim_words(truck_folder, fault.path))
    # The scenario expects supervision to stay live, which it must not: a finding.
    assert done.returncode == 1, done.stderr
    assert json.loads(done.stdout)[0]["frames_hash"] == simulator.run(fault)["frames_hash"]


@pytest.mark.parametrize("bus", ["socketcan:none99", "tin cans"])
def test_a_bus_that_does_not_exist_is_refused(simulator, scenario, bus):
    with pytest.raises(InputError, match=bus):
        simulator.run(scenario(1.0), bus=bus)


@pytest.mark.parametrize(
    ("change", "says"),
    [
        (("duration_s = 5", "duration_s = -1"), "duration_s"),
        (("rms_radps", "rms"), "command.rms"),
        (('kind = "multisine"', 'kind = "noise"'), "command.kind"),
        (("[command]", "[command]\nextra = 1"), "extra"),
        (("speed_profile", "profile"), "speed_profile"),
        (('verdict = "any"', 'verdict = "maybe"'), "expect.verdict"),
        (('verdict = "any"', 'verdict = "invalid"'), "within_judged_s"),
        (("title", "titel"), "titel"),
        (("[expect]", can_fault("VDC2", "stuck_counter") + "[expect]"), "only GUARD_IN has a counter"),
        (("[expect]", can_fault("VDC2", "lots") + "[expect]"), "can_fault.kind"),
        (("[expect]", can_fault("VDC2", "lost", delay_s=1.0) + "[expect]"), "can_fault.delay_s"),
    ],
)
def test_bad_scenarios_are_refused_by_field(simulator, tmp_path, change, says):
    path = tmp_path / "bad.toml"
    path.write_text(small_steps(5).replace(*change))
    with pytest.raises(InputError, match=says):
        simulator.run(load_scenario(str(path)))


@pytest.mark.slow("6 s: another vehicle's simulator is compiled")
def test_unknown_scenarios_and_vehicles_without_controller_are_refused(vehicle):
    with pytest.raises(InputError, match="nominal"):
        load_scenario("no_such_scenario")
    with pytest.raises(InputError, match="controller"):
        Simulator(vehicle)


def test_expectations_find_what_is_missing(simulator, scenario):
    run = simulator.run(scenario(5.0))
    live = Expectation(verdict="any", supervision="live")
    assert not list(missed(live, run, 0.01))
    invalid = Expectation(verdict="invalid", supervision="live", fault_start_s=1.0, within_judged_s=1.0)
    assert list(missed(invalid, run, 0.01)) == ["never invalid"]
    early = run | {"first_invalid_s": 0.5}
    assert "before the fault" in next(missed(invalid, early, 0.01))
    late = run | {"first_invalid_s": 4.0, "judged_to_invalid_s": 2.0}
    assert "judged driving" in next(missed(invalid, late, 0.01))
    never = Expectation(verdict="never_invalid", supervision="live", tracking_ratio_max=1e-6)
    assert [text.split()[0] for text in missed(never, late, 0.01)] == ["invalid", "tracking"]
    reacts = Expectation(
        verdict="any", supervision="reacts", fault_start_s=2.0, fault_end_s=3.0, within_periods=5
    )
    assert "still live" in next(missed(reacts, run, 0.01))
    for changes, says in (
        ([[0.0, "live"], [1.0, "off"]], "before the fault"),
        ([[0.0, "off"]], "never live"),
        ([[0.0, "live"], [2.03, "off"]], "not live again"),
    ):
        assert says in next(missed(reacts, run | {"supervision": changes}, 0.01))


@pytest.mark.unhurried
def test_the_command_writes_json_and_its_status_says_whether_expectations_were_met(
    lpvguard, truck_folder, tmp_path
):
    done = lpvguard("sim", "dead_yaw_sensor", "--coefficients", truck_folder, "--json", "-", "--seeds", 2)
    assert done.returncode == 0, done.stderr
    runs = json.loads(done.stdout)
    assert [r["seed"] for r in runs] == [1, 2]
    assert {
        "scenario",
        "expected",
        "verdict_final",
        "first_invalid_s",
        "tracking_rms",
        "command_rms",
        "frames",
        "real_time_factor",
    } <= set(runs[0])
    strict = tmp_path / "strict.toml"
    strict.write_text(
        small_steps(5).replace('supervision = "live"', 'supervision = "live"\ntracking_ratio_max = 1e-9')
    )
    done = lpvguard("sim", strict, "--coefficients", truck_folder)
    assert done.returncode == 1 and "tracking error" in done.stderr
    done = lpvguard("sim", "nowhere.toml", "--coefficients", truck_folder)
    assert done.returncode == 2 and "nowhere.toml" in done.stderr


@pytest.mark.slow("11 s: a simulator around another core")
def test_changing_one_coefficient_is_noticed_at_start(truck_folder, scenario, tmp_path):
    folder = tmp_path / "altered"
    shutil.copytree(truck_folder, folder)
    source = (folder / "lpvguard_control.c").read_text()
    nodes = len(artefacts.read_manifest(folder, "vehicle")["controller"]["speeds"])
    altered = re.sub(r"\.u_max = .*", ".u_max = {" + "{LPVG_NUMBER(3.5f, 3.5)}, " * nodes + "},", source)
    assert altered != source
    (folder / "lpvguard_control.c").write_text(altered)
    with pytest.raises(InputError, match=r"lpvguard_control\.c: is not the file"):
        Simulator(folder)
    artefacts.seal(folder)  # what the seal does not notice is noticed all the same
    with pytest.raises(InputError, match="refused its coefficients"):
        Simulator(folder).run(scenario(5.0))
