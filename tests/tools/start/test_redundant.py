"""Further measurements of the yaw rate in a log become outputs, with an isolation table."""

import numpy as np
import pytest

from lpvguard.drives.tables import list_experiments, read_drive
from lpvguard.extras.bench._redundant_car import redundant_drives
from lpvguard.start.new_project import new
from lpvguard.vehicle.nominal import NominalModel
from lpvguard.vehicle.project import load_project

TRACK_M, LENGTH_M = 1.6, 2.66
FURTHER = ["wheel_rate", "acceleration_rate", "course_rate"]


def write_logs(folder, names=("wheel_speed_rl", "wheel_speed_rr", "lat_accel", "course"), course_step=1):
    """Logs of a car: gyro, wheels in km/h, lateral acceleration in g, clockwise course in deg."""
    logs = []
    for k, d in enumerate(redundant_drives(2, 120.0, 7)[0]):
        gyro, wheels, across, course = d.y.T
        turned = np.degrees(-np.cumsum(course) * 0.02) % 360.0
        held = np.arange(len(d.t)) // course_step * course_step
        columns = [
            d.t,
            d.v,
            d.u[:, 0],
            gyro,
            3.6 * (d.v - TRACK_M / 2 * wheels),
            3.6 * (d.v + TRACK_M / 2 * wheels),
            (across * d.v + 0.2) / 9.80665,
            turned[held],
        ]
        logs.append(folder / f"log_{k}.csv")
        header = ",".join(("time", "speed", "steering_angle", "yaw_rate", *names))
        np.savetxt(logs[-1], np.column_stack(columns), "%.9g", ",", header=header, comments="")
    return logs


@pytest.mark.parametrize("course_step", [1, 10])
def test_redundant_outputs_are_found_with_unit_sign_and_track(tmp_path, course_step):
    logs = write_logs(tmp_path, course_step=course_step)
    made = new("mine", logs, tmp_path / "out", wheelbase_m=LENGTH_M, parts=True)
    assert [r.signal for r in made.further] == FURTHER
    assert "a track of 1.59 m" in made.further[0].why and "lat_accel in g" in made.further[1].why
    project = load_project(tmp_path / "out" / "mine.toml")
    settings = project.isolation
    assert [s.name for s in project.outputs] == ["yaw_rate", *FURTHER] and project.model.C == [[1.0]] * 4
    assert settings.vehicle == ("K", "T1") and settings.speed_power == {"acceleration_rate": -1}
    for experiment in list_experiments(tmp_path / "out" / "drives"):
        drive = read_drive(tmp_path / "out" / "drives" / f"{experiment.name}.csv", project)
        slow = drive.y[: len(drive.y) // 50 * 50].reshape(-1, 50, 4).mean(axis=1)
        assert np.corrcoef(slow.T)[0, 1:].min() > 0.9
        assert np.abs(slow[:, 1:] - slow[:, :1]).std(axis=0) == pytest.approx(0, abs=0.25 * slow[:, 0].std())
    assert NominalModel(project).n_y == 4


def test_without_the_option_they_are_named_and_no_outputs(tmp_path):
    made = new("mine", write_logs(tmp_path), tmp_path / "out", wheelbase_m=LENGTH_M)
    assert [r.signal for r in made.further] == FURTHER
    assert made.project.n_y == 1 and made.project.isolation is None


def test_names_alone_make_no_output(tmp_path):
    """The names of the wheels are on the wrong sides, and the acceleration is not lateral."""
    names = ("wheel_speed_rr", "wheel_speed_rl", "temperature", "yaw_rate_copy")
    logs = write_logs(tmp_path, names)
    for log in logs:
        head, *rows = log.read_text().splitlines()
        copied = [",".join([*row.split(",")[:-1], row.split(",")[3]]) for row in rows]
        log.write_text("\n".join([head, *copied]))
    made = new("mine", logs, tmp_path / "out", wheelbase_m=LENGTH_M)
    assert made.further == []


def test_a_second_gyro_of_another_make_is_an_output(tmp_path):
    logs = write_logs(tmp_path, ("left", "right", "other", "imu_gyro_z"))
    random = np.random.default_rng(1)
    for log in logs:
        head, *rows = log.read_text().splitlines()
        cells = [row.split(",") for row in rows]
        lines = [
            ",".join([*c[:-1], f"{-57.2958 * float(c[3]) + 0.1 * random.standard_normal():.9g}"])
            for c in cells
        ]
        log.write_text("\n".join([head, *lines]))
    made = new("mine", logs, tmp_path / "out", wheelbase_m=LENGTH_M, chosen={"output": "yaw_rate"})
    second = next(r for r in made.further if r.signal == "gyro_2_rate")
    assert second.terms[0][1] == {"source_unit": "deg/s", "factor": -1.0}
