"""A measured disturbance: an input of the model that nobody commands."""

from importlib import resources

import numpy as np
import pytest

from lpvguard.base.errors import InputError
from lpvguard.drives import fixture
from lpvguard.drives.excitation import excited
from lpvguard.drives.tables import Drive
from lpvguard.extras.loop.generate import generate
from lpvguard.identify import identification as stage
from lpvguard.vehicle.project import load_project

TEXT = resources.files("lpvguard.vehicle").joinpath("shipped", "vectoring.toml").read_text()
MOMENT = 'name = "yaw_moment"\nrole = "input"'
DESIGN = "[design]\nA_t = 9.0\nA_u = 0.1\ninput_max = [1.0, 1.0]\ninput_rate_max_per_s = [1.0, 1.0]\n\n[data]"


def project_of(path, text=TEXT):
    path.write_text(text)
    return load_project(path)


@pytest.fixture
def with_moment(tmp_path):
    """The car whose yaw moment is measured, and not commanded."""
    return project_of(tmp_path / "with.toml", TEXT.replace(MOMENT, MOMENT.replace("input", "disturbance")))


@pytest.fixture
def without_moment(tmp_path):
    """The same car without that signal."""
    signal = TEXT[TEXT.index(f"[[signals]]\n{MOMENT}") : TEXT.index('[[signals]]\nname = "yaw_rate"')]
    text = TEXT.replace(signal, "").replace('[["G/T", "kM*G/T"]]', '[["G/T"]]')
    return project_of(
        tmp_path / "without.toml", text.replace("input_offset = [0.0, 0.0]", "input_offset = [0.0]")
    )


def test_a_disturbance_is_an_input_of_the_model_and_no_actuator(with_moment):
    assert [s.name for s in with_moment.inputs] == ["road_wheel_angle", "yaw_moment"]
    assert [s.name for s in with_moment.actuators] == ["road_wheel_angle"]


@pytest.mark.parametrize(
    ("old", "new", "says"),
    [
        ("[data]", DESIGN, "design: a controller cannot command the disturbance yaw_moment"),
        ('angle"\nrole = "input"', 'angle"\nrole = "disturbance"', "road_wheel_angle is a disturbance"),
    ],
)
def test_what_a_disturbance_cannot_be_is_refused(old, new, says, with_moment, tmp_path):
    text = (tmp_path / "with.toml").read_text()
    assert old in text
    with pytest.raises(InputError, match=says):
        project_of(tmp_path / "bad.toml", text.replace(old, new))


@pytest.mark.unhurried
def test_a_measured_disturbance_leaves_the_bounds(with_moment, without_moment, monkeypatch, tmp_path):
    plan = [(split, "human", v, 150.0) for split in ("train", "valid") for v in (8.0, 11.0, 14.0)]
    monkeypatch.setattr(fixture, "PLAN", plan)
    drives = tmp_path / "drives"
    generate(with_moment, drives, 7)
    results = [stage.identify(p, drives)[0] for p in (with_moment, without_moment)]
    known, unknown = (r.bounds for r in results)
    assert np.nanmedian(known.B_w / unknown.B_w) < 0.5
    assert np.nanmax(known.nu) < np.nanmax(unknown.nu)


def test_a_disturbance_alone_excites_no_drive(with_moment):
    t = 0.02 * np.arange(1000)
    drive = Drive("a", t, np.full(1000, 10.0), np.column_stack([0 * t, np.sin(t)]), 0 * t[:, None])
    assert not excited(drive, with_moment).any()
    assert excited(drive, load_project("vectoring")).any()
