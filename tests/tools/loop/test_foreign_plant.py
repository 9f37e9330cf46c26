"""An FMU as the vehicle of `lpvguard sim`: our own truck gives the frames of the built-in one, another
vehicle is driven by the same scenarios, and what does not fit is named."""

import re
from pathlib import Path

import pytest
from c_fmu import c_fmu

from lpvguard.base.errors import InputError
from lpvguard.core.compiled import shipped_vehicle
from lpvguard.extras.fmu.package import plant_fmu
from lpvguard.extras.loop.foreign_plant import PRESSURES, REQUIRED, WHEELS, ForeignPlant
from lpvguard.extras.loop.sim import Simulator, load_scenario, steady_scenario

pytestmark = pytest.mark.slow("20 s: the simulator and FMUs are compiled")
VARIABLES = {
    "dp": (0, "input"),
    "v_wanted": (1, "input"),
    "gain": (2, "parameter"),
    "v": (10, "output"),
    "r": (11, "output"),
    "delta": (12, "output"),
    "ay_g": (13, "output"),
    "pressure": (14, "output"),
}
MAP = """
step_s = 0.005
track_m = 2.0
[parameters]
gain = {gain}
[inputs]
brake_demand = "dp"
speed = "v_wanted"
[outputs]
speed = "v"
yaw_rate = "r"
steering_wheel_angle = {{ variable = "delta", factor = 20.0 }}
lateral_acceleration = {{ variable = "ay_g", factor = 9.81 }}
brake_pressure_difference = "pressure"
true_road_wheel_angle = "delta"
"""


@pytest.fixture(scope="module")
def single_track(tmp_path_factory) -> Path:
    """FMU of another vehicle, in C."""
    return c_fmu("single_track", VARIABLES, tmp_path_factory.mktemp("single_track"))


@pytest.fixture(scope="module")
def simulator() -> Simulator:
    return Simulator(shipped_vehicle("truck"))


def mapped(fmu: Path, folder: Path, text: str) -> ForeignPlant:
    (folder / "map.toml").write_text(text)
    return ForeignPlant(fmu, folder / "map.toml")


@pytest.mark.parametrize("version", (2, 3))
def test_our_own_truck_as_an_fmu_gives_the_bytes_of_the_built_in_one(version, truck, simulator, tmp_path):
    fmu = tmp_path / "truck.fmu"
    fmu.write_bytes(plant_fmu(truck, shipped_vehicle("truck"), version))
    for name, seed in (("dead_yaw_sensor", 1), ("load_plus_40", 7)):
        scenario = load_scenario(name)
        built_in, foreign = (
            simulator.run(scenario, seed=seed, plant=plant) for plant in (None, ForeignPlant(fmu))
        )
        del built_in["real_time_factor"], foreign["real_time_factor"]
        assert foreign == built_in and not foreign["missed"]


@pytest.mark.parametrize(("gain", "expected"), ((0.32, "never_invalid"), (0.1, "invalid")))
def test_another_vehicle_meets_the_scenarios_expectations(gain, expected, single_track, simulator, tmp_path):
    expect = f'verdict = "{expected}"\nsupervision = "live"\nfault_start_s = 0.0\nwithin_judged_s = 10.0'
    (tmp_path / "steady.toml").write_text(steady_scenario(60.0, expect=expect))
    plant = mapped(single_track, tmp_path, MAP.format(gain=gain))
    run = simulator.run(load_scenario(str(tmp_path / "steady.toml")), plant=plant)
    assert run["missed"] == [] and (gain < 0.3 or run["verdict_final"] != "invalid")
    assert run["tracking_rms"] < run["command_rms"]


@pytest.mark.parametrize(
    ("old", "new", "said"),
    (
        ('"dp"', '"dq"', "has no variable dq"),
        ('yaw_rate = "r"\n', "", "outputs.yaw_rate: missing"),
        ("track_m = 2.0\n", "", "without all wheel speeds"),
        ('brake_pressure_difference = "pressure"\n', "", "without brake pressure"),
        ("step_s = 0.005", "step_s = 0.004", "a whole part of 0.01 s"),
        ('speed = "v"', 'sped = "v"', "outputs.sped: unknown"),
        ("track_m", "track", "track"),
        ("step_s = 0.005", 'scenario = "gain"', "of type Real"),
    ),
)
def test_a_map_that_does_not_fit_is_named(old, new, said, single_track, tmp_path):
    with pytest.raises(InputError, match=re.escape(said)):
        mapped(single_track, tmp_path, MAP.format(gain=0.3).replace(old, new, 1))


def test_faults_of_our_truck_are_refused_for_another_vehicle(single_track, simulator, tmp_path):
    plant = mapped(single_track, tmp_path, MAP.format(gain=0.3))
    with pytest.raises(InputError, match=r"plant\.actuator_fault: acts on our truck"):
        simulator.run(load_scenario("brake_gain_40"), plant=plant)


def test_what_the_fmu_says_is_the_error(truck, simulator, tmp_path):
    (tmp_path / "truck.fmu").write_bytes(plant_fmu(truck, shipped_vehicle("truck"), 3))
    text = 'step_s = 0.005\nscenario = "scenario"\n[inputs]\nbrake_demand = "brake_demand"\n[outputs]\n'
    text += "".join(f'{name} = "{name}"\n' for name in (*REQUIRED, *WHEELS, *PRESSURES))
    plant = mapped(tmp_path / "truck.fmu", tmp_path, text)
    with pytest.raises(
        InputError, match=r"communication step size 0\.005 s; expected the sample period 0\.01 s"
    ):
        simulator.run(load_scenario("nominal"), plant=plant)


def test_the_command_takes_fmu_and_map(single_track, lpvguard, tmp_path):
    (tmp_path / "map.toml").write_text(MAP.format(gain=0.1))
    (tmp_path / "weak.toml").write_text(
        steady_scenario(20.0, expect='verdict = "never_invalid"\nsupervision = "live"')
    )
    words = (tmp_path / "weak.toml", "--plant", single_track, "--map", tmp_path / "map.toml")
    assert lpvguard("sim", *words).returncode == 1
    assert "--plant" in lpvguard("sim", "nominal", "--map", tmp_path / "map.toml").stderr
    (tmp_path / "no.fmu").write_text("no archive")
    assert "cannot be read" in lpvguard("sim", "nominal", "--plant", tmp_path / "no.fmu").stderr
