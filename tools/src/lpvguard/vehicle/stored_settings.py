"""Whether what was made with a project file was made with the one at hand."""

from __future__ import annotations

import json
from typing import TYPE_CHECKING, Any

from pydantic import ValidationError

from ..base import artefacts
from ..base.errors import InputError

if TYPE_CHECKING:
    from .project import Project


def require_settings(stored: dict[str, Any], where: object, project: Project, vehicle: object) -> None:
    """InputError naming the first setting in which the project file is not the one that ``where`` was made
    with. All count but the title, of which nothing is computed. A setting that ``stored`` lacks, since it was
    made before there was one, counts as its default. ``vehicle``: what the project is called in the error."""
    differs = artefacts.first_difference(_counted(_completed(stored, project)), _counted(_plain(project)))
    if differs is not None:
        setting, old, new = differs
        raise InputError(
            setting,
            "",
            f"{json.dumps(old)} in {where}, {json.dumps(new)} in {vehicle}",
            "the settings that it was made with, or made anew with these",
        )


def _plain(project: Project) -> dict[str, Any]:
    return json.loads(artefacts.to_json(project.model_dump(by_alias=True)))


def _counted(settings: dict[str, Any]) -> dict[str, Any]:
    return {**settings, "title": None}


def _completed(stored: dict[str, Any], project: Project) -> dict[str, Any]:
    """With defaults where a setting is missing; as it is where it is no project of today."""
    try:
        return _plain(type(project).model_validate(stored))
    except ValidationError:
        return stored
