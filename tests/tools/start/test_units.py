"""Units by evidence: cars whose units are known are read right, or the user is asked. Counted."""

import os
import warnings
from collections import Counter
from dataclasses import replace
from itertools import product
from pathlib import Path

import numpy as np
import pytest

from known_car import KnownCar
from lpvguard.base.errors import InputError, InputWarning
from lpvguard.can.logs import read_log
from lpvguard.drives.unit_names import units_in_name
from lpvguard.drives.units import unit_factor
from lpvguard.start.readings import ROLES, Known
from lpvguard.start.signals import GUESSED_UNITS, Recording, proposed, ranked
from lpvguard.vehicle.physics import kind_of
from made import ROOT

DATA = Path(os.environ.get("LPVGUARD_DATA", ROOT.parent / "shared/data"))
SI = {"speed": "m/s", "input": "rad", "output": "rad/s"}
CARS = {
    "small": (KnownCar(2.4, 0.0012, 0.005, 0.04, 0.001, 0.0), 14.0),
    "saloon": (KnownCar(2.8, 0.003, 0.007, 0.08, -0.002, 0.002), 15.8),
    "neutral": (KnownCar(2.6, 0.0003, 0.004, 0.0, 0.002, -0.001), 13.0),
    "van": (KnownCar(3.2, 0.0045, 0.009, 0.1, 0.0, 0.001), 18.5),
}
"""Cars, each with its steering ratio."""
SPEEDS = {"town": (5.0, 8.0), "country": (12.0, 20.0), "motorway": (24.0, 32.0)}
COMBINATIONS = list(product(*(GUESSED_UNITS[role] for role in ROLES), (False, True)))


def recordings(car: KnownCar, speeds: tuple[float, float]) -> list[Recording]:
    """A drive at each speed, in SI units at the road wheels."""
    random = np.random.default_rng(57)
    recordings_read = []
    for k, speed in enumerate(speeds):
        d = car.drive(random, speed, 90.0, f"d{k}")
        gentle = min(1.0, 3.0 / float(np.quantile(np.abs(d.v * d.y[:, 0]), 0.99)))  # as people drive
        values = {"speed": d.v, "angle_of_steering": gentle * d.u[:, 0], "yaw_rate": gentle * d.y[:, 0]}
        recordings_read.append(Recording(d.name, d.t, values, {}))
    return recordings_read


def in_units(logs: list[Recording], units: tuple[str, str, str], ratio: float) -> list[Recording]:
    """The same logs in other units, at a steering wheel of a ratio."""
    scale = [1.0 / unit_factor(u, SI[role]) for u, role in zip(units, ROLES, strict=True)]
    scale[1] *= ratio
    return [
        Recording(
            r.name,
            r.t,
            dict(zip(r.values, (s * x for s, x in zip(scale, r.values.values(), strict=True)), strict=True)),
            {},
        )
        for r in logs
    ]


def outcome(logs: list[Recording], units: tuple[str, str, str], ratio: float, known: Known) -> str:
    """Say right, asked, or what else came out."""
    try:
        proposals = proposed(logs, {}, known)
    except InputError as error:
        return "asked" if "readings fit" in str(error) else f"refused: {error}"
    factor = proposals["input"].factor * ratio
    if tuple(proposals[role].unit for role in ROLES) == units and 0.8 < factor < 1.25:
        return "right"
    return f"wrong: {[p.unit for p in proposals.values()]}, steering {factor:.3g} times the right one"


def counted(car: str, speeds: str) -> Counter[str]:
    """Outcomes of all combinations of units for a car and a range of speeds."""
    model, ratio = CARS[car]
    logs = recordings(model, SPEEDS[speeds])
    known = Known(kind_of(model.L), model.L)
    counts: Counter[str] = Counter()
    for *units, wheel in COMBINATIONS:
        at = ratio if wheel else 1.0
        counts[outcome(in_units(logs, tuple(units), at), tuple(units), at, known)] += 1
    return counts


@pytest.mark.slow("3 s: 24 logs")
def test_logs_of_known_units_are_read_right_or_asked():
    counts = counted("saloon", "country")
    assert set(counts) == {"right", "asked"} and counts.total() == 24 and counts["right"] >= 8, counts


@pytest.mark.long("40 s: 288 logs")
def test_288_logs_of_known_units_are_read_right_or_asked(capsys):
    counts = sum((counted(car, speeds) for car, speeds in product(CARS, SPEEDS)), Counter())
    with capsys.disabled():
        print("\nof 288 logs:", ", ".join(f"{n} {what}" for what, n in sorted(counts.items())))
    assert set(counts) == {"right", "asked"} and counts.total() == 288


@pytest.mark.slow("6 s: five fits")
def test_a_measured_minute_in_five_systems_of_units_is_read_right_or_asked_about():
    log = DATA / "comma2k19_rav4" / "rav4_100hz.csv"
    if not log.is_file():
        pytest.skip(f"no measured drive: {log}")
    series = read_log(log).series
    values = {"speed": "v", "steering": "sw_angle", "yaw_rate": "r_can"}
    t = (series["v"].t_ns - series["v"].t_ns[0]) / 1e9
    minute = [Recording("minute", t, {name: series[column].value for name, column in values.items()}, {})]
    systems = [("m/s", "rad", "rad/s"), ("m/s", "deg", "deg/s"), ("km/h", "deg", "deg/s")]
    systems += [("mph", "deg", "deg/s"), ("km/h", "rad", "rad/s")]
    said = [outcome(in_units(minute, units, 1.0), units, 16.9, Known("car", 2.66)) for units in systems]
    assert set(said) <= {"right", "asked"}, said


def test_a_stated_unit_that_makes_an_unusual_car_is_asked_about():
    """A speed in m/s that a header says to be in mph looks like another ratio: not taken in silence."""
    (log,) = in_units(recordings(CARS["saloon"][0], SPEEDS["country"])[:1], ("m/s", "deg", "deg/s"), 20.0)
    stated = {"speed": "mph", "input": "deg", "output": "deg/s"}
    units = dict(zip(log.values, stated.values(), strict=True))
    known = Known("car", 2.8)
    with pytest.raises(InputError, match=r"unusual car: speed in mph.*more likely: speed in m/s"):
        proposed([replace(log, units=units)], {}, known)
    with pytest.warns(InputWarning, match="the stated units make an unusual car"):
        proposed([log], {}, known, stated)
    with warnings.catch_warnings():
        warnings.filterwarnings("error", message=".*unusual")
        proposed([log], {}, known, stated | {"speed": "m/s"})
        proposed([log], {}, replace(known, ratio=20.0 / 1.6), stated)
    with pytest.warns(InputWarning, match="steering ratios from .* explain the logs about as well"):
        proposed([log], {}, known, stated | {"speed": "m/s"})


def test_a_lateral_acceleration_tells_the_unit_of_the_speed():
    """Miles and kilometres an hour look alike; one of them times the yaw rate is the acceleration."""
    logs = recordings(CARS["small"][0], SPEEDS["country"])
    random = np.random.default_rng(3)
    for unit in ("km/h", "mph"):
        known, units = Known("car", 2.4), (unit, "deg", "deg/s")
        assert outcome(in_units(logs, units, 14.0), units, 14.0, known) == "asked"
        with_ay = [
            replace(
                r,
                values=r.values
                | {"ay": s.values["speed"] * s.values["yaw_rate"] + random.normal(0, 0.1, len(r.t))},
            )
            for r, s in zip(in_units(logs, units, 14.0), logs, strict=True)
        ]
        assert outcome(with_ay, units, 14.0, known) == "right"
    false = [replace(r, units={"speed": "km/h"}) for r in with_ay]
    with pytest.raises(InputError, match=r"ay is [\d.]+ times speed times yaw rate"):
        proposed(false, {}, known)


def test_a_model_cars_commands_beyond_full_lock_are_not_taken_for_degrees():
    """As of a race car's program, whose commands in rad exceed what the servo can do."""
    car = KnownCar(0.33, 0.03, 0.02, 0.1, 0.0, 0.0)
    d = car.drive(np.random.default_rng(5), 4.5, 60.0, "laps")
    values = {"speed": d.v, "steering": 20.0 * d.u[:, 0], "yaw_rate": 20.0 * d.y[:, 0]}
    known = Known("model", car.L)
    with pytest.raises(InputError, match=r"2 readings fit: .* in deg at .* in rad at .*--input-unit rad"):
        proposed([Recording("laps", d.t, values, {})], {}, known)


def test_going_backwards_with_a_speed_without_sign_turns_no_sign():
    """As a sports car's log began: out of a parking space with a full turn of the wheel."""
    (log, _) = in_units(recordings(CARS["saloon"][0], SPEEDS["country"]), ("m/s", "deg", "deg/s"), 15.8)
    t = np.arange(750) * 0.02
    turns = 450.0 * np.sin(0.8 * t)
    yaw = -np.degrees(1.5 / 2.8 * np.tan(np.radians(turns / 15.8)))
    back = {"speed": 1.5 + 0 * t, "angle_of_steering": turns, "yaw_rate": yaw}
    values = {name: np.r_[back[name], x] for name, x in log.values.items()}
    whole = Recording("a", np.arange(len(values["speed"])) * 0.02, values, {})
    units = {"speed": "m/s", "input": "deg", "output": "deg/s"}
    signals = proposed([whole], {}, Known("car", 2.8), units)
    assert 0.9 < signals["input"].factor * 15.8 < 1.1


SPELLINGS = {
    "speed": {
        "m/s": ("v_m_s", "vehicle_speed_mps", "vx_ms", "speed (m s^-1)", "Speed [meter / second]"),
        "km/h": (
            "speed_kmh",
            "Speed (km/h)",
            "vehicleSpeedKph",
            "v_km_h",
            "Tempo in km/h",
            "Geschw. [Km/hr]",
        ),
        "mph": ("SpeedMPH", "speed_mph_filtered", "VehSpd_miles_per_hour", "speed (mi/h)"),
        "kn": ("GPS Speed (knots)", "sog_kts"),
        "cm/s": ("speed (cm/s)",),
        "mm/s": ("speed_mm_s",),
        "0.9144 m/s": ("speed [yd/s]",),
        "0.1 km/h": ("speed [0.1 km/h]",),
        None: ("speed", "Geschwindigkeit", "v", "speed_2", "rms"),
    },
    "input": {
        "rad": ("steer_rad", "steering_angle_rad_raw", "delta [radian]"),
        "deg": (
            "Lenkradwinkel_Grad",
            "Lenkradwinkel (Grad)",
            "SteeringAngle[deg]",
            "SWA_degrees",
            "StrAngle °",
            "Ângulo do volante (graus)",
            "rattvinkel_grader",
        ),
        "0.000290888209 rad": ("delta (arcmin)",),
        "mrad": ("winkel_mrad",),
        "gon": ("delta (gon)",),
        "turn": ("steering_turns",),
        None: ("LenkRadWinkel", "steering_angle", "steering_grade"),
    },
    "output": {
        "rad/s": ("yaw_rate_radps", "yawRateRadPerSec", "r_rad_s", "gyro_z_rads", "yaw (rad s-1)"),
        "deg/s": (
            "Gierrate_Grad_s",
            "Gierrate [°/s]",
            "yaw_rate_dps",
            "Gierrate in Grad pro Sekunde",
            "YawRate_deg/s",
        ),
        "rpm": ("yaw_rate (rev/min)",),
        "deg/min": ("yaw_rate [deg/min]",),
        "gon/s": ("yaw rate [gon/s]",),
        None: ("yaw_rate", "gyro_z", "gyro_rps"),
    },
}


@pytest.mark.parametrize("role", SPELLINGS)
def test_a_name_states_its_unit_in_any_usual_spelling(role):
    for unit, names in SPELLINGS[role].items():
        for name in names:
            assert units_in_name(name, role)[:1] == ([unit] if unit else []), name


@pytest.mark.long("50 s: 108 logs")
def test_a_false_unit_of_the_speed_is_not_taken_in_silence(capsys):
    """Headers that state another unit of the speed than the numbers have, at a steering wheel, and true ones.
    A mile looks like a kilometre where the ratio makes up for it; then the user is asked."""
    counts: Counter[str] = Counter()
    for (car, ratio), speeds in product(CARS.values(), SPEEDS.values()):
        logs = recordings(car, speeds)
        for true, stated in product(("m/s", "km/h", "mph"), repeat=2):
            read = in_units(logs, (true, "deg", "deg/s"), ratio)
            units = dict(zip(read[0].values, (stated, "deg", "deg/s"), strict=True))
            is_true = "true" if true == stated else "false"
            try:
                proposed([replace(r, units=units) for r in read], {}, Known(kind_of(car.L), car.L))
                counts[f"{is_true}, taken"] += 1
            except InputError:
                counts[f"{is_true}, asked or refused"] += 1
    with capsys.disabled():
        print(f"\nof {counts.total()} stated units:", counts)
    assert counts["false, asked or refused"] == 72 and counts["true, taken"] >= 24, counts


def test_greek_letters_are_read_as_their_names():
    names = ["δ [deg]", "ψ\u0307 [deg/s]", "ω_z", "v"]
    assert ranked("input", names) == ["δ [deg]"]
    assert set(ranked("output", names)) == {"ψ\u0307 [deg/s]", "ω_z"}
