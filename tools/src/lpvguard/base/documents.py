"""Read TOML files that people write and check them against pydantic models."""

import tomllib
from collections.abc import Mapping
from importlib.resources.abc import Traversable
from pathlib import Path
from typing import Annotated, Any, ClassVar, TypeVar

import numpy as np
from pydantic import (
    BaseModel,
    ConfigDict,
    Field,
    GetJsonSchemaHandler,
    SerializerFunctionWrapHandler,
    ValidationError,
    model_serializer,
    model_validator,
)
from pydantic_core import CoreSchema

from .errors import InputError

Model = TypeVar("Model", bound=BaseModel)
Positive = Annotated[float, Field(gt=0, allow_inf_nan=False)]
"""A finite number above zero."""
Fraction = Annotated[float, Field(gt=0, lt=1)]
"""A number above zero and below one."""


class StrictModel(BaseModel):
    """Frozen table of a TOML file that refuses unknown keys."""

    model_config = ConfigDict(extra="forbid", frozen=True)


def in_radians(settings: Mapping[str, Any], keys: Mapping[str, str]) -> dict[str, Any]:
    """Convert the frequencies of a table from Hz to rad/s, with eight digits.

    Parameters
    ----------
    settings : Mapping, the table
    keys : Mapping, key in rad/s -> key in Hz

    Returns
    -------
    dict, in the order of the table

    Examples
    --------
    >>> in_radians({"f_hz": [1.0, 2.0], "nu": [0.1, 0.2]}, {"omega_radps": "f_hz"})
    {'omega_radps': [6.2831853, 12.566371], 'nu': [0.1, 0.2]}
    """
    names = {hertz: radians for radians, hertz in keys.items()}
    return {
        names.get(key, key): _converted(value, 2 * np.pi, 8) if key in names else value
        for key, value in settings.items()
    }


def in_hertz(settings: Mapping[str, Any], keys: Mapping[str, str]) -> dict[str, Any]:
    """Convert the frequencies of a table from rad/s to Hz, with six digits. Older tables state Hz.

    Parameters
    ----------
    settings : Mapping, the table
    keys : Mapping, key in rad/s -> key in Hz

    Returns
    -------
    dict

    Raises
    ------
    ValueError
        If a frequency is no number above 0, or stated in both units.

    Examples
    --------
    >>> in_hertz({"omega_radps": [6.2831853, 12.566371]}, {"omega_radps": "f_hz"})
    {'f_hz': [1.0, 2.0]}
    """
    changed = dict(settings)
    for radians, hertz in keys.items():
        if radians in changed and hertz in changed:
            raise ValueError(f"{radians} and {hertz} are the same: state one")
        for key, factor, unit in ((radians, 1 / (2 * np.pi), "rad/s"), (hertz, 1.0, "Hz")):
            if key in changed:
                value = changed.pop(key)
                try:
                    changed[hertz] = _converted(value, factor, 6)
                    if value is not None and np.min(changed[hertz], initial=np.inf) <= 0:
                        raise ValueError
                except (TypeError, ValueError):
                    raise ValueError(f"{key}: {value!r} is no frequency in {unit}") from None
    return changed


def _converted(value: Any, factor: float, digits: int) -> Any:
    """A number or a list of numbers times a factor; None stays."""
    if value is None:
        return None
    scaled = factor * np.asarray(value, float)
    rounded = [float(f"{x:.{digits}g}") for x in scaled.ravel()]
    return rounded if scaled.ndim else rounded[0]


class InRadians(StrictModel):
    """Table whose frequencies stand in Hz here, and in rad/s in files.

    Attributes
    ----------
    FREQUENCIES : Mapping, key of a file -> attribute, which older files state too
    """

    FREQUENCIES: ClassVar[Mapping[str, str]]

    @model_validator(mode="before")
    @classmethod
    def _read(cls, settings: object) -> object:
        if not isinstance(settings, dict):
            return settings
        inside = in_hertz(settings, cls.FREQUENCIES)
        for radians, hertz in cls.FREQUENCIES.items():
            if cls.model_fields[hertz].is_required() and hertz not in inside:
                raise ValueError(f"{radians} is missing")
        return inside

    @model_serializer(mode="wrap")
    def _written(self, plain: SerializerFunctionWrapHandler) -> dict[str, Any]:
        return in_radians(plain(self), self.FREQUENCIES)

    @classmethod
    def __get_pydantic_json_schema__(cls, core: CoreSchema, handler: GetJsonSchemaHandler) -> dict[str, Any]:
        described = handler(core)
        names = {hertz: radians for radians, hertz in cls.FREQUENCIES.items()}
        described["properties"] = {names.get(k, k): v for k, v in described["properties"].items()}
        described["required"] = [names.get(k, k) for k in described.get("required", [])]
        return described


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
