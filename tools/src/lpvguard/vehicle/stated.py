"""Whether what was made with a project file was made with the one at hand."""

from __future__ import annotations

import json
from typing import TYPE_CHECKING, Any

from ..base import artefacts
from ..base.errors import InputError

if TYPE_CHECKING:
    from .project import Project


def require_settings(stored: dict[str, Any], where: object, project: Project, vehicle: object) -> None:
    """InputError naming the first setting in which the project file is not the one that ``where`` was made
    with. All count but the title, of which nothing is computed. ``vehicle``: what the project is called in
    the error."""
    given = json.loads(artefacts.to_json(project.model_dump(by_alias=True)))
    differs = artefacts.first_difference({**stored, "title": None}, {**given, "title": None})
    if differs is not None:
        setting, old, new = differs
        raise InputError(
            setting,
            "",
            f"{json.dumps(old)} in {where}, {json.dumps(new)} in {vehicle}",
            "the settings that it was made with, or made anew with these",
        )
