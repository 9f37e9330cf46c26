"""Shipped project files beside the data that they are about."""

import numpy as np
import pytest

from lpvguard.drives.ingest import ingest
from lpvguard.drives.signal_map import Column, SignalMap, Term
from lpvguard.drives.tables import read_drive
from lpvguard.extras.loop.generate import truck_drive
from lpvguard.fit.quality import of_drive
from lpvguard.vehicle.nominal import NominalModel
from lpvguard.vehicle.project import load_project

RAW = {"v": ("linear_vel_x", "m/s"), "delta": ("steering_angle", "rad"), "r": ("angular_vel_z", "rad/s")}


@pytest.mark.long("13 s: the race car fitted to its laps")
def test_the_race_cars_model_explains_its_laps(race_car, tmp_path):
    """Each lap with a trim of its own, for the steering's differs by day."""
    car = load_project("f1tenth")
    columns = {name: Column(unit=unit, terms=[Term(signal=signal)]) for name, (signal, unit) in RAW.items()}
    laps = sorted(race_car.glob("rl_*.csv"))
    ingest(
        laps, dbc=None, signals_map=SignalMap(schema=1, Ts_s=car.Ts_s, columns=columns), out=tmp_path / "d"
    )
    assert len(laps) == 6
    explained = []
    for lap in laps:
        drive = read_drive(tmp_path / "d" / f"{lap.stem}.csv", car, any_values=True)
        explained.append(max(_explained(car, drive, trim) for trim in np.arange(-0.3, 0.31, 0.02)))
    assert min(explained) > 0.7 and np.mean(explained) > 0.85


def test_the_fitted_truck_differs_from_the_truck_in_its_model_alone():
    paper, fitted = (load_project(name).model_dump() for name in ("truck", "truck_fitted"))
    assert {key for key in paper if paper[key] != fitted[key]} == {"name", "title", "model"}


@pytest.mark.slow("5 s: drives of the simulated truck")
@pytest.mark.parametrize("speed", [9.0, 15.5, 20.5])
def test_the_fitted_truck_errs_less_than_table_1(tmp_path, speed):
    """Drives of a seed that the fit did not see."""
    path = tmp_path / "drive.csv"
    usual = {"program": "multisine", "amplitude_low": 0.25, "amplitude_high": 1.0}
    truck_drive(path, speed=speed, duration=180.0, seed=977, **usual)
    left = []
    for name in ("truck", "truck_fitted"):
        model = NominalModel(load_project(name))
        drive = read_drive(path, load_project(name))
        left.append(1 - of_drive(model, drive, model.simulate(drive.v, drive.u, drive.y[0]), []).vaf)
    assert np.all(left[1] < left[0])


def _explained(car, drive, trim: float) -> float:
    model = NominalModel(car)
    inside = (drive.v > car.model.speed_min_mps) & (drive.v < car.model.speed_max_mps)
    error = drive.y - model.simulate(drive.v, drive.u - trim, drive.y[0])
    return float(1 - error[inside].var() / drive.y[inside].var())
