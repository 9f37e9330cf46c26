"""The files of the made-up car (tests/other_car.py)."""

from pathlib import Path

import pytest

from other_car import MAP, OTHER_CAR


@pytest.fixture(scope="session")
def car(tmp_path_factory) -> Path:
    """Folder with the car's database car.dbc and the signals map map.toml; only read."""
    folder = tmp_path_factory.mktemp("car")
    (folder / "car.dbc").write_text(OTHER_CAR)
    (folder / "map.toml").write_text(MAP)
    return folder
