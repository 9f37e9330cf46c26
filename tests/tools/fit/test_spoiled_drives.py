"""Every way to spoil drives is named for what it is, in all drives or in one among good ones."""

import re
from dataclasses import replace

import numpy as np
import pytest

from known_car import KnownCar, guessed
from lpvguard.base.errors import InputError, InputWarning
from lpvguard.drives.tables import Drive
from lpvguard.fit.damaged_drives import require_unspoiled
from lpvguard.fit.suspicions import judged_beside, screened
from lpvguard.fit.unknowns import Unknowns
from lpvguard.vehicle.project import FitSettings

RANGES = {"L": [1.8, 4.0], "K": [0.0, 0.01], "T1": [5e-4, 0.03]}


@pytest.fixture(scope="module")
def project(g80):
    settings = FitSettings(parameters=RANGES, input_delay_s=[0.0, 0.3])
    return guessed(g80).model_copy(update={"fit": settings})


@pytest.fixture(scope="module")
def drives() -> list[Drive]:
    random = np.random.default_rng(3)
    car = KnownCar.drawn(random)
    return [car.drive(random, v, 60.0, f"at_{v:g}") for v in (6.0, 10.0, 15.0)]


def late(d: Drive, samples: int) -> Drive:
    return Drive(d.name, d.t[:-samples], d.v[samples:], d.u[samples:], d.y[:-samples])


def padded(d: Drive) -> Drive:
    """The output 200 s later, noise before: a fifth of the drive overlaps."""
    pad = np.random.default_rng(2).normal(0.0, 1e-3, (round(200 / (d.t[1] - d.t[0])), 1))
    return replace(d, y=np.r_[pad, d.y[: -len(pad)]])


def frozen(d: Drive) -> Drive:
    y = d.y.copy()
    y[1000:1500] = y[1000]
    return replace(d, y=y)


def held(d: Drive) -> Drive:
    v, u, y = (np.repeat(x[::2], 2, axis=0)[: len(d.t)] for x in (d.v, d.u, d.y))
    return Drive(d.name, d.t, v, u, y)


def shuffled(d: Drive) -> Drive:
    order = np.random.default_rng(1).permutation(len(d.t))
    return Drive(d.name, d.t, d.v[order], d.u[order], d.y[order])


SPOILED = {
    "flipped sign": (lambda d: replace(d, y=-d.y), "column delta: has the other sign (or that of r)"),
    "km/h": (lambda d: replace(d, v=3.6 * d.v), "column v: is in km/h"),
    "mph": (lambda d: replace(d, v=d.v / 0.44704), "column v: is in mph"),
    "degrees": (lambda d: replace(d, u=np.degrees(d.u)), "column delta: is in deg"),
    "degrees a second": (lambda d: replace(d, y=np.degrees(d.y)), "column r: is in deg/s"),
    "steering wheel": (lambda d: replace(d, u=16.0 * d.u), "times too large, as the angle of the steering"),
    "swapped": (lambda d: replace(d, u=d.y, y=d.u), "columns delta and r: are swapped"),
    "delay": (lambda d: late(d, 500), "column r: comes 10 s later than the inputs say"),
    "frozen": (frozen, "the sensor is frozen"),
    "half the rate": (held, "it was recorded at half the rate"),
    "shuffled": (shuffled, "the rows are shuffled"),
}


LONG = {"mph", "degrees", "degrees a second", "steering wheel", "flipped sign", "delay", "swapped"}
"""With all drives spoiled alike; every run has these with one spoiled among good ones."""


@pytest.mark.slow("5 s a case where all drives are fitted in every reading")
@pytest.mark.parametrize(
    "name",
    [
        pytest.param(name, marks=pytest.mark.long("7 s: another spoil")) if name in LONG else name
        for name in SPOILED
    ],
)
def test_drives_spoiled_alike_are_named(project, drives, name):
    spoil, said = SPOILED[name]
    with pytest.raises(InputError) as error:
        spoiled = [spoil(d) for d in drives]
        require_unspoiled(project, spoiled)
        screened(project, spoiled)
    assert said in str(error.value)


@pytest.mark.slow("2 s a case: three drives fitted in every reading")
@pytest.mark.parametrize("name", SPOILED)
def test_one_spoiled_drive_among_good_ones_is_named(project, drives, name):
    spoil, said = SPOILED[name]
    spoiled = [drives[0], spoil(drives[1]), drives[2]]
    try:
        require_unspoiled(project, spoiled)
        screening = screened(project, spoiled)
        assert screening.certain == {"at_10"} and [d.name for d in screening.explained] == ["at_6", "at_15"]
        text = str(screening.faults["at_10"])
    except InputError as error:
        text = str(error)
    assert text.startswith("at_10") and said in text


@pytest.mark.long("10 s: every reading of five drives fitted")
@pytest.mark.parametrize("name", ["flipped sign", "degrees a second"])
def test_what_is_wrong_with_all_is_named_where_two_of_five_are_beyond_any_model(project, drives, name):
    random = np.random.default_rng(5)
    slides = [
        replace(d, name=f"slide_{d.name}", y=0.1 * random.standard_normal(d.y.shape)) for d in drives[:2]
    ]
    spoil, said = SPOILED[name]
    with pytest.raises(InputError) as error:
        screened(project, [spoil(d) for d in [*drives, *slides]])
    assert said in str(error.value)


@pytest.mark.slow("2 s: every reading fitted")
def test_a_long_delay_is_found_where_a_fifth_of_the_drive_is_left(project, drives):
    random = np.random.default_rng(3)
    late = padded(KnownCar.drawn(random).drive(random, 12.0, 250.0, "late"))
    faults = screened(project, [*drives, late]).faults
    assert "column r: comes 200 s later than the inputs say" in str(faults["late"])


def test_a_column_that_begins_late_is_said_to_stand_or_to_be_late(project, drives):
    y = drives[1].y.copy()
    y[: round(20 / project.Ts_s)] = y[0]
    with pytest.raises(InputError, match=r"the sensor is frozen, or the column begins 19\.98 s late"):
        require_unspoiled(project, [drives[0], replace(drives[1], y=y)])


def test_a_speed_in_whole_kilometres_an_hour_is_not_frozen(project, drives):
    """As an OBD logger has it, once a second and interpolated, on a motorway."""
    d = drives[2]
    seconds = np.arange(0.0, d.t[-1] + 1.0)
    whole = np.rint(3.6 * np.interp(seconds, d.t, d.v)) + (seconds > 30) * np.rint(np.sin(seconds))
    whole[10:18] = whole[10]
    require_unspoiled(project, [replace(d, v=np.interp(d.t, seconds, whole) / 3.6)])


def test_good_drives_pass(project, drives):
    require_unspoiled(project, drives)
    screening = screened(project, drives)
    assert screening.explained == drives and screening.faults == {}


def test_a_drive_twice_is_named_also_when_it_was_cut(project, drives):
    twin = replace(drives[0].from_sample(700), name="twin")
    with pytest.raises(InputError, match="twin: is the same recording as at_6"):
        require_unspoiled(project, [*drives, twin])


@pytest.mark.slow("3 s: every reading fitted")
def test_another_cars_drive_is_named_and_left_out(project, drives):
    random = np.random.default_rng(8)
    other = KnownCar(3.9, 0.004, 0.009, 0.1, 0.0, 0.0).drive(random, 11.0, 60.0, "other")
    screening = screened(project, [*drives, other])
    assert "other: needs other parameters than the other drives (L = " in str(screening.faults["other"])
    assert screening.certain == set() and screening.explained == drives


@pytest.mark.long("8 s: every reading fitted")
def test_noise_without_a_car_is_refused(project, drives):
    random = np.random.default_rng(9)
    noise = [replace(d, y=0.05 * random.standard_normal(d.y.shape)) for d in drives]
    with pytest.raises(InputError, match="no parameters within the ranges"):
        screened(project, noise)


def test_a_drive_beside_the_models_speeds_is_said_to_be_there(project):
    """Nothing of it is judged: that is no fault of its signals."""
    random = np.random.default_rng(3)
    car = KnownCar.drawn(random)
    slow = car.drive(random, 1.5, 30.0, "slow")
    unknowns = Unknowns.from_project(project)
    faults, certain = judged_beside(unknowns, unknowns.start, [slow])
    text = (
        rf"slow: nothing is judged: at {slow.v.min():.3g} to {slow.v.max():.3g} m/s.*expected 3.5 to 19 m/s"
    )
    assert re.search(text, str(faults["slow"])) and not certain


def test_samples_that_stand_alone_are_named(project, drives):
    y = drives[1].y.copy()
    y[[700, 1400]] = 0.6
    with pytest.warns(
        InputWarning, match=r"column r: 2 samples stand alone, the first 0.6 rad/s at 14.000 s"
    ):
        require_unspoiled(project, [drives[0], replace(drives[1], y=y)])
