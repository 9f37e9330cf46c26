"""TOML files that people write: reading them, and checking them against a pydantic model; every fault is an
InputError in one style."""

from __future__ import annotations

import tomllib
from importlib.resources.abc import Traversable
from pathlib import Path
from typing import Annotated, TypeVar

from pydantic import BaseModel, ConfigDict, Field, ValidationError

from .errors import InputError

Model = TypeVar("Model", bound=BaseModel)
Positive = Annotated[float, Field(gt=0, allow_inf_nan=False)]
"""A finite number above zero."""
Fraction = Annotated[float, Field(gt=0, lt=1)]
"""A number above zero and below one."""


class StrictModel(BaseModel):
    """A table of such a file: unknown keys are refused, and what was read does not change."""

    model_config = ConfigDict(extra="forbid", frozen=True)


def read_toml(source: Path | Traversable, what: str, where: object = None) -> dict:
    """The document of a TOML file. ``what`` the file should be, as "a signal map"; ``where``: its name in
    errors, by default its path. Raises InputError when the file cannot be read or is not TOML."""
    where = source if where is None else where
    try:
        return tomllib.loads(source.read_text(encoding="utf-8"))
    except OSError as error:
        raise InputError(where, "", f"cannot be read ({error.strerror})", f"{what} (TOML)") from None
    except (tomllib.TOMLDecodeError, UnicodeDecodeError) as error:
        raise InputError(where, "", str(error), f"{what} (valid TOML)") from None


def checked(model: type[Model], document: object, what: str, where: object, *, table: str = "") -> Model:
    """``document`` as a ``model``. ``table``: the place of the document in its file, when it is a part.
    Raises InputError with the first field that is refused, what was given, and the reason; ``what`` as in
    :func:`read_toml`."""
    try:
        return model.model_validate(document)
    except ValidationError as error:
        first = error.errors()[0]
        field = ".".join([*([table] if table else []), *(str(part) for part in first["loc"])])
        value = first.get("input")
        given = (
            ""
            if isinstance(value, (dict, BaseModel)) or first["type"] == "missing"
            else f" (given: {value!r})"
        )
        raise InputError(where, field, first["msg"].removeprefix("Value error, ") + given, what) from None
