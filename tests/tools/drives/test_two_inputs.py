"""The synthetic car with steering and torque vectoring: two inputs from its drives to its model."""

import numpy as np
import pytest

from lpvguard.base.errors import InputError
from lpvguard.drives import fixture
from lpvguard.drives.tables import read_drive
from lpvguard.vehicle.nominal import NominalModel
from lpvguard.vehicle.project import load_project


@pytest.fixture
def short(monkeypatch):
    monkeypatch.setattr(fixture, "PLAN", [("train", "human", 9.0, 60.0), ("valid", "mpc", 14.0, 60.0)])


def explained(car, drive) -> float:
    inside = (drive.v > 4.0) & (drive.v < 19.0)
    error = drive.y - NominalModel(car).simulate(drive.v, drive.u, drive.y[0])
    return float(1 - error[inside].var() / drive.y[inside].var())


@pytest.mark.unhurried
def test_the_model_needs_both_inputs_to_explain_the_drives(short, tmp_path):
    car = load_project("vectoring")
    rows = fixture.write_drives(car, tmp_path, car.seed, lambda _: None)
    assert [split for _, split, _ in rows] == ["train", "valid"] and car.n_u == 2
    for name, _, _ in rows:
        drive = read_drive(tmp_path / f"{name}.csv", car)
        assert explained(car, drive) > 0.98
        for one in range(2):
            drive.u[:, one] *= 0.0
            assert explained(car, drive) < 0.75
            drive = read_drive(tmp_path / f"{name}.csv", car)


def test_a_car_without_vectoring_drives_as_before(short, tmp_path):
    """Its random numbers are not those of the moment."""
    with_it, without = load_project("vectoring"), load_project("g80")
    for car, folder in ((with_it, "a"), (without, "b")):
        (tmp_path / folder).mkdir()
        fixture.write_drives(car, tmp_path / folder, 1, lambda _: None)
    a, b = (np.genfromtxt(tmp_path / f / "synthetic_00.csv", delimiter=",", names=True) for f in ("a", "b"))
    assert np.array_equal(a["delta"], b["delta"]) and np.array_equal(a["v"], b["v"])
    assert "moment" not in b.dtype.names and not np.array_equal(a["r"], b["r"])


def test_a_second_input_of_another_unit_is_refused(tmp_path):
    car = load_project("vectoring")
    signals = [s.model_copy(update={"unit": "Nm"}) if s.name == "yaw_moment" else s for s in car.signals]
    with pytest.raises(InputError, match="yaw_moment: in Nm; expected a yaw moment in kN m"):
        fixture.write_drives(car.model_copy(update={"signals": signals}), tmp_path, 1, lambda _: None)
