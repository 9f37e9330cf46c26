"""The table of bounds beside known truth: its cars, its numbers and its text."""

import json
from dataclasses import replace

import numpy as np
import pytest

from lpvguard.base.errors import InputError
from lpvguard.extras.bench import sharpness
from lpvguard.extras.bench._known_cars import (
    CARS,
    Car,
    DriveDeviations,
    band_noise,
    best_linear_error,
    known_drives,
    true_error,
    yaw_rates,
)
from lpvguard.vehicle.nominal import NominalModel
from lpvguard.vehicle.project import load_project

PROJECT = load_project("g80")
MODEL = NominalModel(PROJECT)


def test_the_linear_car_turns_as_its_stiffnesses_say():
    car = CARS["linear"]
    v, angle = 12.0, 0.01
    n = 400
    r = yaw_rates(car, 0.02, np.full((1, n), v), np.full((1, n), angle), np.zeros((1, n)))[0, -1]
    understeer = 2000 / 2.66 * (1.36 / car.front - 1.30 / car.rear)
    assert r == pytest.approx(v * angle / (2.66 + understeer * v**2), rel=1e-3)


def test_friction_takes_its_share_of_small_angles_and_little_of_large_ones():
    speed, amplitude = np.array([6.0]), np.array([[0.004, 0.2]])
    omega = np.array([1.0])
    free = true_error(Car(), MODEL, omega, speed, amplitude)[0, 0]
    held = true_error(Car(friction_share=0.2), MODEL, omega, speed, amplitude)[0, 0]
    ratio = (1 + held) / (1 + free)
    assert ratio[0] == pytest.approx(0.8, abs=0.005)
    assert abs(ratio[1] - 1) < 0.03


def test_sines_and_multisines_agree_on_a_linear_car():
    car = replace(CARS["linear"], grip_n=1e9)
    where = (np.array([1.0, 6.0]), np.array([8.0, 15.0]), np.full((2, 1), 0.02))
    assert np.abs(best_linear_error(car, MODEL, *where) - true_error(car, MODEL, *where)).max() < 0.02


def test_a_drives_own_gain_and_delay_are_in_its_record():
    still = DriveDeviations(np.array([0.0, 0.1]), np.array([0.0, 0.0]))
    drives = known_drives(CARS["linear"], PROJECT, 2, 20.0, np.random.default_rng(3), still)
    same = known_drives(CARS["linear"], PROJECT, 2, 20.0, np.random.default_rng(3))
    assert np.array_equal(drives[0].y, same[0].y)
    assert np.array_equal(drives[1].u, same[1].u) and not np.allclose(drives[1].y, same[1].y, atol=1e-4)


def test_the_interval_of_a_proportion_is_exact():
    low, high = sharpness.proportion(0, 10)
    assert low == 0 and high == pytest.approx(1 - 0.025**0.1)
    low, high = sharpness.proportion(10, 10)
    assert low == pytest.approx(0.025**0.1) and high == 1


@pytest.mark.slow("15 s: one set of drives and its band, of each car")
def test_the_bound_of_a_set_holds_the_known_error_and_is_near_it(tmp_path, capsys, monkeypatch):
    monkeypatch.setattr(sharpness, "MOST", 8)
    written = tmp_path / "sharpness.json"
    sharpness.main(["--sets", "1", "--seed", "11", "--no-sensitivity", "--json", str(written)])
    result = json.loads(written.read_text())
    assert [(r["car"], r["deviating"]) for r in result["sets"]] == [
        (car, deviating) for deviating in (False, True) for car in CARS
    ]
    one_car = [r for r in result["sets"] if not r["deviating"]]
    assert all(r["ratio"] <= 1 and 1 <= r["loose"] < 2.5 and r["outside"] == 0 for r in one_car)
    assert all(r["ratio_all"] <= r["ratio"] for r in result["sets"])
    assert all(r["further"] == 20 * r["deviating"] for r in result["sets"])
    text = capsys.readouterr().out
    assert "friction, one car: 1 sets" in text and "further drives within" in text


@pytest.mark.parametrize("options", [["--sets", "0"], ["--seed", "-1"]])
def test_numbers_of_sets_that_cannot_be_are_refused(options):
    with pytest.raises(InputError, match="from 1 and 0 on"):
        sharpness.main(options)


@pytest.fixture
def two_days(tmp_path):
    """Four drives of one day, and two of another on which the car turned 1.8 times as far."""
    random, Ts = np.random.default_rng(5), PROJECT.Ts_s
    n = round(40 / Ts)
    v = 10 + 0.4 * band_noise(random, (6, n), (0.004, 0.02), Ts)
    delta = 0.03 * band_noise(random, (6, n), (0.05, 3.0), Ts)
    noise = 3e-3 * band_noise(random, (6, n), (0.03, 1.0), Ts) + 5e-4 * random.standard_normal((6, n))
    rows = ["experiment,split,group"]
    for k, gain in enumerate((1.0, 1.02, 0.98, 1.01, 1.8, 1.82)):
        r = gain * MODEL.simulate(v[k], delta[k, :, None], np.zeros(1))[:, 0] + noise[k]
        columns = np.column_stack([Ts * np.arange(n), v[k], delta[k], r])
        np.savetxt(tmp_path / f"d{k}.csv", columns, delimiter=",", header="t,v,delta,r", comments="")
        rows.append(f"d{k},train,{'monday' if k < 4 else 'tuesday'}")
    (tmp_path / "experiments.csv").write_text("\n".join(rows) + "\n")
    return tmp_path


@pytest.mark.slow("12 s: three bands")
def test_a_group_unlike_the_others_refutes_their_band(two_days, capsys):
    sharpness.main(["--drives", str(two_days)])
    lines = capsys.readouterr().out.splitlines()
    rows = {line.split()[0]: line.split() for line in lines if line.startswith("d")}
    assert all(float(rows[name][-1]) > 1 for name in ("d4", "d5"))
    assert lines[-1].endswith(f"{sum(float(r[-1]) > 1 for r in rows.values())} refute")


def test_measured_drives_of_one_group_are_refused(two_days):
    index = two_days / "experiments.csv"
    index.write_text(index.read_text().replace("tuesday", "monday"))
    with pytest.raises(InputError, match="at least two"):
        sharpness.main(["--drives", str(two_days)])
