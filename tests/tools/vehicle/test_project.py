"""Project files: what is refused, and how it is said."""

import json
import tomllib
from importlib import resources

import numpy as np
import pytest

from lpvguard.base.errors import InputError
from lpvguard.vehicle.nominal import NominalModel
from lpvguard.vehicle.project import FrameSettings, NuCeiling, load_project, parse_project, shipped_vehicles

VEHICLES = resources.files("lpvguard.vehicle").joinpath("shipped")
TEXT = VEHICLES.joinpath("g80.toml").read_text()


@pytest.mark.parametrize("name", shipped_vehicles())
def test_every_shipped_vehicle_loads_and_is_stable(name):
    assert NominalModel(load_project(name)).slowest_pole > 0


@pytest.mark.parametrize(
    ("old", "new", "says"),
    [
        ("Ts_s = 0.02", "Ts_s = -0.02", "Ts_s"),
        ("Ts_s = 0.02", "Ts_s = 0.02\nTs = 1", "Ts"),
        ('role = "output"', 'role = "scheduling"', "exactly one"),
        ("min = -0.8", "min = 0.9", "road_wheel_angle"),
        ('A = [["-1/T"]]', 'A = [["-1/T", 0]]', "model.A"),
        ("omega_max_radps = 20.106193", "omega_max_radps = 190.0", "half the sampling rate"),
        ("omega_max_radps = 20.106193", "omega_max_radps = 20.1\nf_max_hz = 3.2", "state one"),
        ("omega_max_radps = 20.106193", 'omega_max_radps = "x"', "no frequency in rad/s"),
        ("omega_max_radps = 20.106193", "omega_max_radps = -2.0", "omega_max_radps: -2.0 is no frequency"),
        ("confirm = 1 ", "confirm = 3 ", "confirm"),
        ("schema = 1", "schema = 2", "schema"),
        ("schema = 1", "schema = ", "TOML"),
    ],
)
def test_a_bad_project_file_is_refused_by_field(tmp_path, old, new, says):
    assert old in TEXT
    path = tmp_path / "car.toml"
    path.write_text(TEXT.replace(old, new, 1))
    with pytest.raises(InputError) as caught:
        load_project(path)
    assert str(path) in str(caught.value) and says.lower() in str(caught.value).lower()


@pytest.mark.parametrize(
    ("name", "old", "new", "says"),
    [
        (
            "g80",
            "[frames]",
            '[design]\ncontrolled = "sideslip"\nA_t = 9.0\nA_u = 0.1\ninput_max = [1.0]\n'
            "input_rate_max_per_s = [1.0]\n\n[frames]",
            r"design\.controlled: no output is named sideslip, but yaw_rate",
        ),
        ("truck", "input_max = [6.0]", "input_max = [6.0, 6.0]", r"design\.input_max: must have 1"),
        (
            "truck",
            "input_rate_max_per_s = [40.0]",
            "input_rate_max_per_s = []",
            r"design\.input_rate_max_per_s: must have 1",
        ),
        (
            "truck",
            "lateral_acceleration_max_mps2 = 4.0",
            "lateral_acceleration_max_mps2 = 0.0",
            r"lateral_acceleration_max_mps2",
        ),
        (
            "truck",
            'column = "r"\nunit = "rad/s"',
            'column = "r"\nunit = "deg/s"',
            r"lateral_acceleration_max_mps2: .* yaw_rate in deg/s",
        ),
        ("truck", "nu = [0.35, 2.5]", "nu = [0.35]", "nu_ceiling: omega_radps and nu"),
    ],
)
def test_a_setting_that_does_not_fit_its_vehicle_is_refused(tmp_path, name, old, new, says):
    text = VEHICLES.joinpath(f"{name}.toml").read_text()
    assert text.count(old) == 1
    path = tmp_path / "car.toml"
    path.write_text(text.replace(old, new))
    with pytest.raises(InputError, match=says):
        load_project(path)


@pytest.mark.parametrize(
    ("old", "new", "says"),
    [
        ('A = [["-1/T"]]', 'A = [["1/T"]]', "unstable"),
        ('A = [["-1/T"]]', 'A = [["-1/q"]]', "q"),
        ('A = [["-1/T"]]', 'A = [["__import__(1)"]]', "cannot use"),
        ('A = [["-1/T"]]', 'A = [["-1/"]]', "not an arithmetic expression"),
        ('G = "v/(L + K*v**2)"', 'G = "1/(v - 10)**0/(v - v)"', "not finite"),
    ],
)
def test_a_bad_model_names_the_entry_or_the_speed(tmp_path, old, new, says):
    path = tmp_path / "car.toml"
    path.write_text(TEXT.replace(old, new, 1))
    with pytest.raises(InputError, match=says):
        NominalModel(load_project(path))


def test_a_project_file_elsewhere_is_a_vehicle_too(tmp_path):
    path = tmp_path / "mine.toml"
    path.write_text(TEXT.replace('name = "g80"', 'name = "mine"', 1))
    assert load_project(str(path)).name == "mine"


def test_the_ceiling_is_log_linear_and_zero_at_dc():
    ceiling = NuCeiling(f_hz=[0.5, 2.0], nu=[0.1, 0.6])
    np.testing.assert_allclose(ceiling.at([0.0, 0.1, 0.5, 1.0, 2.0, 9.0]), [0.0, 0.1, 0.1, 0.35, 0.6, 0.6])


def test_frequencies_in_hertz_and_in_radians_are_the_same_project():
    in_radians = VEHICLES.joinpath("truck.toml").read_text()
    in_hertz = (
        in_radians.replace("omega_min_radps = 0.31415927", "f_min_hz = 0.05")
        .replace("omega_max_radps = 12.566371", "f_max_hz = 2.0")
        .replace("omega_radps = [4.3982297, 12.566371]", "f_hz = [0.7, 2.0]")
    )
    energy = "[energy_test]\n{} = [{}, {}]\n\n[frame_test]"
    texts = [
        text.replace("[frame_test]", energy.format(*band))
        for text, band in (
            (in_radians, ("band_radps", 0.62831853, 6.2831853)),
            (in_hertz, ("band_hz", 0.1, 1.0)),
        )
    ]
    assert texts[0] != texts[1]
    one, other = (parse_project(tomllib.loads(text), "truck") for text in texts)
    assert one == other and one.frames.f_min_hz == 0.05
    written = one.model_dump_json(by_alias=True)
    assert "_hz" not in written and parse_project(json.loads(written), "truck").frames == one.frames
    assert "_hz" not in json.dumps(list(FrameSettings.model_json_schema()["properties"]))
