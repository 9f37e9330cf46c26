"""A coarse angle with its digits in a signal beside it is read with both, at the rate of its frames."""

import math
import re

import numpy as np
import pytest

from lpvguard.drives.ingest import ingest
from lpvguard.drives.signal_map import map_of_project
from lpvguard.start.new_project import new
from lpvguard.vehicle.project import load_project
from steered_car import write_logs

DBC = """VERSION ""

NS_ :

BS_:

BU_: A

BO_ 37 STEER_ANGLE_SENSOR: 8 A
 SG_ STEER_ANGLE : 3|12@0- (1.5,0) [-500|500] "deg" A
 SG_ STEER_FRACTION : 39|4@0- (0.1,0) [-0.7|0.7] "deg" A
 SG_ STEER_RATE : 35|12@0- (1,0) [-2000|2000] "deg/s" A

BO_ 180 SPEED: 8 A
 SG_ SPEED : 47|16@0+ (0.01,0) [0|250] "km/h" A

BO_ 36 KINEMATICS: 8 A
 SG_ YAW_RATE : 7|16@0- (0.01,0) [-300|300] "deg/s" A
"""


@pytest.fixture
def logs(tmp_path):
    """A minute of two drives at 50 Hz, steered within a few steps of the coarse angle."""
    (tmp_path / "car.dbc").write_text(DBC)

    def frames(v, angle, yaw):
        steps = round(angle / 1.5)
        fraction = max(-7, min(7, round(10 * (angle - 1.5 * steps))))
        return (
            f"025#{steps % 4096:04X}0000{fraction % 16:X}0000000",
            f"0B4#0000000000{round(360 * v):04X}00",
            f"024#{round(100 * yaw) % 65536:04X}000000000000",
        )

    return tmp_path / "car.dbc", write_logs(
        tmp_path,
        3000,
        lambda t: 12 + 2 * math.sin(0.2 * t),
        lambda t: 8 * math.sin(0.7 * t) + 4 * math.sin(2.1 * t),
        frames,
    )


def test_the_digits_beyond_an_angles_resolution_are_added(logs, tmp_path):
    dbc, paths = logs
    made = new("mine", paths, tmp_path / "out", dbc=dbc, wheelbase_m=2.7, ratio=15.0)
    angle = made.proposals["input"]
    assert (angle.name, angle.plus) == (
        "STEER_ANGLE_SENSOR.STEER_ANGLE",
        ("STEER_ANGLE_SENSOR.STEER_FRACTION",),
    )
    assert made.project.Ts_s == 0.02 and abs(15 * angle.factor - 1) < 0.05
    delta = np.loadtxt(tmp_path / "out" / "drives" / "d0.csv", delimiter=",", skiprows=1)[:, 2]
    steps = np.abs(np.diff(delta)) / angle.factor
    assert np.degrees(steps.max()) < 0.5  # the coarse angle jumps by 1.5 degrees
    again = ingest(paths, dbc=dbc, signals_map=tmp_path / "out" / "signals.toml", out=tmp_path / "again")
    assert len(again) == 2
    assert (tmp_path / "again" / "d0.csv").read_bytes() == (
        tmp_path / "out" / "drives" / "d0.csv"
    ).read_bytes()


def test_the_proposed_places_on_the_cars_own_bus_read_the_same_drives(logs, tmp_path):
    dbc, paths = logs
    new("mine", paths, tmp_path / "out", dbc=dbc, wheelbase_m=2.7, ratio=15.0)
    text = (tmp_path / "out" / "mine.toml").read_text()
    assert '# messages.STEER_ANGLE_SENSOR.checksum = "..."' in text and "hyundai_crc8" in text
    assert "# demand.road_wheel_angle = {" in text
    (tmp_path / "mine.toml").write_text(
        re.sub(r"^# (can = |\[can\]|dbc = )", r"\1", text, flags=re.MULTILINE)
    )
    car = load_project(tmp_path / "mine.toml")
    ingest(paths, dbc=dbc, signals_map=map_of_project(car), out=tmp_path / "again")
    ours, theirs = (
        np.loadtxt(tmp_path / folder / "d0.csv", delimiter=",", skiprows=1)
        for folder in ("again", "out/drives")
    )
    assert ours == pytest.approx(theirs, abs=1e-6)
