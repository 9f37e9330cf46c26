"""Settings that a folder was made with, beside those of the project file at hand."""

import json

import pytest

from lpvguard.base import artefacts
from lpvguard.base.errors import InputError
from lpvguard.vehicle.project import load_project
from lpvguard.vehicle.stored_settings import require_settings


def stored() -> dict:
    """The truck's settings as a folder has them."""
    return json.loads(artefacts.to_json(load_project("truck").model_dump(by_alias=True)))


def changed(path: str, value: object) -> dict:
    """With another value; without the key where the value is None."""
    settings = stored()
    *above, key = path.split(".")
    inner = settings
    for name in above:
        inner = inner[name]
    if value is None:
        del inner[key]
    else:
        inner[key] = value
    return settings


@pytest.mark.parametrize(("path", "value"), [("title", "Another"), ("design.lambda_s", None)])
def test_a_title_counts_for_nothing_and_what_is_missing_for_its_default(path, value):
    require_settings(changed(path, value), "a folder", load_project("truck"), "truck")


@pytest.mark.parametrize(
    ("path", "value", "old", "new"),
    [
        ("design.lambda_s", 0.1, "0.1", "1.0"),
        ("design.order_loss", 0.5, "0.5", "0.001"),
        ("Ts_s", None, "null", "0.01"),  # a setting without a default: no project of today
        ("no_more", 3, "3", "null"),  # one that there is no more
    ],
)
def test_the_first_other_setting_is_named_with_both_values(path, value, old, new):
    with pytest.raises(InputError) as refused:
        require_settings(changed(path, value), "a folder", load_project("truck"), "truck")
    assert str(refused.value) == (
        f"{path}: {old} in a folder, {new} in truck; expected the settings of the result, "
        "or a new result with the project's settings"
    )


def test_a_missing_setting_is_not_taken_for_a_value_that_is_no_default():
    project = load_project("truck")
    design = project.design.model_copy(update={"lambda_s": 0.1})
    with pytest.raises(InputError, match=r"design.lambda_s: 1.0 in a folder, 0.1 in truck"):
        require_settings(
            changed("design.lambda_s", None),
            "a folder",
            project.model_copy(update={"design": design}),
            "truck",
        )
