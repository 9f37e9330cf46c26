"""TOML files that people write: every fault is an InputError that names file, field, value and what was
expected."""

from typing import ClassVar

import pytest
from pydantic import BaseModel, Field

from lpvguard.base.documents import InRadians, checked, read_toml
from lpvguard.base.errors import InputError


class Wheel(BaseModel):
    radius_m: float = Field(gt=0)


class Car(BaseModel):
    name: str
    wheels: list[Wheel] = []


class Band(InRadians):
    f_hz: float
    FREQUENCIES: ClassVar = {"omega_radps": "f_hz"}


@pytest.mark.parametrize(
    ("text", "says"),
    [
        (b"name = ", r"car.toml: .*; expected a car \(valid TOML\)"),
        (b"name = '\xff'", r"car.toml: .*; expected a car \(valid TOML\)"),
    ],
)
def test_a_file_that_is_no_toml_is_named(tmp_path, text, says):
    path = tmp_path / "car.toml"
    path.write_bytes(text)
    with pytest.raises(InputError, match=says):
        read_toml(path, "a car")


def test_a_missing_file_is_named(tmp_path):
    with pytest.raises(
        InputError, match=r"given: cannot be read \(No such file or directory\); expected a car \(TOML\)"
    ):
        read_toml(tmp_path / "car.toml", "a car", "given")


@pytest.mark.parametrize(
    ("document", "table", "says"),
    [
        (
            {"name": "a", "wheels": [{"radius_m": 0.3}, {"radius_m": -1}]},
            "",
            r"^f: wheels.1.radius_m: .*greater than 0 \(given: -1\); expected a car$",
        ),
        ({}, "", "^f: name: Field required; expected a car$"),
        ({"name": 1}, "car", r"^f: car.name: .*string \(given: 1\)"),
        (None, "car", r"^f: car: .*\(given: None\)"),
    ],
)
def test_the_first_field_that_is_refused_is_named(document, table, says):
    with pytest.raises(InputError, match=says):
        checked(Car, document, "a car", "f", table=table)


def test_a_missing_frequency_is_named_as_files_state_it():
    with pytest.raises(InputError, match=r"^f: band: omega_radps is missing; expected a band$"):
        checked(Band, {}, "a band", "f", table="band")


def test_a_good_document_is_read(tmp_path):
    path = tmp_path / "car.toml"
    path.write_text('name = "a"\n[[wheels]]\nradius_m = 0.3\n')
    assert checked(Car, read_toml(path, "a car"), "a car", path) == Car(
        name="a", wheels=[Wheel(radius_m=0.3)]
    )
