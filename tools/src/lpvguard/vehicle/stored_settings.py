"""Compare a project file with the one that a result was made with."""

from __future__ import annotations

import json
from typing import TYPE_CHECKING, Any

from pydantic import ValidationError

from ..base import artefacts
from ..base.errors import InputError

if TYPE_CHECKING:
    from .project import Project


def require_settings(stored: dict[str, Any], where: object, project: Project, vehicle: object) -> None:
    """Require that a result was made with the settings of a project.

    The title does not count. A setting that the result does not have counts as the default.

    Parameters
    ----------
    stored : dict[str, Any], settings of the result
    where : object, name of the result in errors
    project : Project
    vehicle : object, name of the project in errors

    Raises
    ------
    InputError
        If a setting differs; the error names the first one.
    """
    differs = artefacts.first_difference(_counted(_completed(stored, project)), _counted(_plain(project)))
    if differs is not None:
        setting, old, new = differs
        raise InputError(
            setting,
            "",
            f"{json.dumps(old)} in {where}, {json.dumps(new)} in {vehicle}",
            "the settings of the result, or a new result with the project's settings",
        )


def _plain(project: Project) -> dict[str, Any]:
    return json.loads(artefacts.to_json(project.model_dump(by_alias=True)))


def _counted(settings: dict[str, Any]) -> dict[str, Any]:
    return {**settings, "title": None}


def _completed(stored: dict[str, Any], project: Project) -> dict[str, Any]:
    """Fill in defaults; leave a document that is no valid project unchanged."""
    try:
        return _plain(type(project).model_validate(stored))
    except ValidationError:
        return stored
