"""Parameters that differ between days are named with their errors; those of one car are not."""

import re
from dataclasses import replace

import numpy as np
import pytest

from known_car import SPEEDS, KnownCar
from lpvguard.drives.tables import day_of
from lpvguard.fit.differences import differences, outlook
from lpvguard.fit.estimate import Fit
from lpvguard.fit.unknowns import Unknowns
from lpvguard.vehicle.project import load_project

DAYS = ("2025-01-01", "2025-02-03")


def said_of(first: KnownCar, second: KnownCar, groups: dict[str, str] | None = None) -> list[str]:
    """Sentences on eight drives, four of each car and day."""
    random = np.random.default_rng(3)
    cars = zip((first, second), DAYS, strict=True)
    drives = [car.drive(random, v, 60.0, f"{day}_at_{v:g}") for car, day in cars for v in SPEEDS]
    fit = Fit(Unknowns.from_project(load_project("g80")), drives)
    return differences(fit, fit.estimated(fit.unknowns.start), groups or {})


@pytest.mark.slow("20 s: two fits of eight drives")
def test_a_delay_that_changed_overnight_is_named_and_one_car_is_not():
    car = KnownCar(2.8, 0.003, 0.006, 0.04, 0.0, 0.0)
    assert said_of(car, car) == []
    said = said_of(car, replace(car, delay=0.08, L=3.2))
    days = {text.split()[0]: text for text in said if "between days or groups" in text}
    assert set(days) >= {"L", "input_delay_s"}
    value = r"([\d.]+) \(standard error ([\d.]+)\) in "
    pattern = f": {value}2025-01-01, {value}2025-02-03"
    early, error, late, _ = map(float, re.search(pattern, days["input_delay_s"]).groups())
    assert abs(early - 0.04) < 0.005 and abs(late - 0.08) < 0.015 and error < 0.003  # one step is short


def test_a_day_is_read_from_a_name():
    assert day_of("rl_2026-04-22_03-36-39") == "2026-04-22" and day_of("log.20251010-051109") == "2025-10-10"
    assert day_of("run_7") == day_of("12345678") == ""


@pytest.mark.parametrize(
    ("recordings", "said"),
    [
        (0, "0 recordings calibrate: no alpha; 4 more would allow alpha 0.2"),
        (9, "9 recordings calibrate: alpha 0.1; 10 more would allow alpha 0.05"),
        (19, "19 recordings calibrate: alpha 0.05; 30 more would allow alpha 0.02"),
        (200, "200 recordings calibrate: alpha 0.01"),
    ],
)
def test_what_more_recordings_would_allow_is_said(recordings, said):
    assert outlook(recordings) == said
