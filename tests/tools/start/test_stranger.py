"""The stranger: from raw logs of a car that nobody here knows to a guarded car, by commands alone."""

from __future__ import annotations

import json

import numpy as np
import pytest


@pytest.mark.slow("40 s: fit, identification and evaluation of 22 recordings")
def test_a_race_car_goes_from_raw_logs_to_its_page(race_car, lpvguard, few_baselines, tmp_path):
    raw = sorted(race_car.glob("*.csv"))
    car, fit, found, code = (tmp_path / n for n in ("car", "fit", "found", "code"))
    drives = car / "drives"

    def run(*words: object, status: tuple[int, ...] = (0,)) -> str:
        done = lpvguard(*words)
        assert done.returncode in status, done.stderr
        return done.stderr

    said = run("new", "racer", *raw, "--wheelbase", 0.33, "-o", car)
    assert "input: steering_angle in rad" in said and "speed: linear_vel_x in m/s" in said
    run("fit", "--vehicle", car / "racer.toml", drives, "-o", fit, status=(1,))
    vehicle = fit / "racer.toml"
    fitted = json.loads((fit / "fit.json").read_text())
    values = {u["name"]: u["value"] for u in fitted["unknowns"]}
    assert 0.25 < values["L"] < 0.42 and 0.08 < values["input_delay_s"] < 0.2
    laps = [q["vaf"][0] for q in fitted["unseen"] if q["name"].startswith("rl_")]
    assert len(laps) == 4 and min(laps) > 0.8 and np.mean(laps) > 0.87
    said = run("identify", "--vehicle", vehicle, drives, "-o", found, "--json", tmp_path / "identify.json")
    calibrated = json.loads((tmp_path / "identify.json").read_text())
    assert "poor: try lpvguard fit" in said and 1.0 < calibrated["threshold"] < 3.0
    run("export", "--vehicle", vehicle, found, "-o", code)
    run("replay", "--vehicle", vehicle, "--coefficients", code, drives / f"{raw[-1].stem}.csv", status=(0, 1))
    table = tmp_path / "evaluation.json"
    run("evaluate", "--vehicle", vehicle, "--coefficients", code, found, drives, "--json", table)
    evaluated = json.loads(table.read_text())
    assert len(evaluated["drives"]) - len(evaluated["without_faults"]) >= 4
    assert any(row["fault"] == "output + 0.5 of its spread" for row in evaluated["faults"])
    run("report", found, drives, "--vehicle", vehicle, "--coefficients", code, "-o", tmp_path / "page.html")
    assert (tmp_path / "page.html").stat().st_size > 100_000
