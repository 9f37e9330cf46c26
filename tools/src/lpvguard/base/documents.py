"""Read TOML files that people write and check them against pydantic models."""

import tomllib
from collections.abc import Mapping
from importlib.resources.abc import Traversable
from pathlib import Path
from typing import Annotated, TypeVar

import numpy as np
from pydantic import BaseModel, ConfigDict, Field, ValidationError

from .errors import InputError

Model = TypeVar("Model", bound=BaseModel)
Positive = Annotated[float, Field(gt=0, allow_inf_nan=False)]
"""A finite number above zero."""
Fraction = Annotated[float, Field(gt=0, lt=1)]
"""A number above zero and below one."""


class StrictModel(BaseModel):
    """Frozen table of a TOML file that refuses unknown keys."""

    model_config = ConfigDict(extra="forbid", frozen=True)


def in_hertz(settings: object, keys: Mapping[str, str]) -> object:
    """Convert the frequencies of a table from rad/s to Hz, with six digits.

    Parameters
    ----------
    settings : object, the table; anything else stays
    keys : Mapping, key in rad/s -> key in Hz

    Returns
    -------
    object

    Raises
    ------
    ValueError
        If a frequency is no number, or stated in both units.

    Examples
    --------
    >>> in_hertz({"omega_radps": [6.2831853, 12.566371]}, {"omega_radps": "f_hz"})
    {'f_hz': [1.0, 2.0]}
    """
    if not isinstance(settings, dict):
        return settings
    changed = dict(settings)
    for stated, key in keys.items():
        if stated not in changed:
            continue
        if key in changed:
            raise ValueError(f"{stated} and {key} are the same: state one")
        value = changed.pop(stated)
        try:
            omega = np.asarray(value, float)
        except (TypeError, ValueError):
            raise ValueError(f"{stated}: {value!r} is no frequency in rad/s") from None
        hertz = [float(f"{w / (2 * np.pi):.6g}") for w in omega.ravel()]
        changed[key] = hertz if omega.ndim else hertz[0]
    return changed


def read_toml(source: Path | Traversable, what: str, where: object = None) -> dict:
    """Read a TOML file.

    Parameters
    ----------
    source : Path or Traversable
    what : str, what the file should be, as "a signal map"
    where : object, its name in errors, by default its path

    Returns
    -------
    dict

    Raises
    ------
    InputError
        If the file cannot be read or is not TOML.
    """
    where = source if where is None else where
    try:
        return tomllib.loads(source.read_text(encoding="utf-8"))
    except OSError as error:
        raise InputError(where, "", f"cannot be read ({error.strerror})", f"{what} (TOML)") from None
    except (tomllib.TOMLDecodeError, UnicodeDecodeError) as error:
        raise InputError(where, "", str(error), f"{what} (valid TOML)") from None


def checked(model: type[Model], document: object, what: str, where: object, *, table: str = "") -> Model:
    """Validate a document against a pydantic model.

    Parameters
    ----------
    model : type[Model]
    document : object
    what : str, what the file should be, as "a signal map"
    where : object, its name in errors
    table : str, place of the document in its file, default ''

    Returns
    -------
    Model

    Raises
    ------
    InputError
        If a field is refused; it names the first one, its value and the reason.
    """
    try:
        return model.model_validate(document)
    except ValidationError as error:
        first = error.errors()[0]
        field = ".".join([*([table] if table else []), *(str(part) for part in first["loc"])])
        value = first.get("input")
        value_text = (
            ""
            if isinstance(value, (dict, BaseModel)) or first["type"] == "missing"
            else f" (given: {value!r})"
        )
        raise InputError(
            where, field, first["msg"].removeprefix("Value error, ") + value_text, what
        ) from None
