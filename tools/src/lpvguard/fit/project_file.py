"""The project file with new numbers; the rest, comments too, stays unchanged."""

import re
from importlib import resources
from pathlib import Path

import numpy as np
import tomlkit
from tomlkit.exceptions import TOMLKitError

from .. import vehicle as vehicles
from ..base.errors import InputError
from .unknowns import Unknowns

DIGITS = 10
"""Significant digits of a fitted number."""
_ENTRY = re.compile(r"(\w+)\[(\d+)\]")


def text_of(vehicle: str) -> str:
    """Read the text of a project file.

    Parameters
    ----------
    vehicle : str, path or shipped vehicle's name

    Returns
    -------
    str

    Raises
    ------
    InputError
        If it cannot be read.
    """
    path = Path(vehicle)
    if path.suffix == ".toml" or path.is_file():
        return path.read_text(encoding="utf-8")
    return (resources.files(vehicles) / "shipped" / f"{vehicle}.toml").read_text(encoding="utf-8")


def with_numbers(text: str, where: str, values: dict[str, float]) -> str:
    """The text with new values by names of `Unknowns`, and with its CAN database beside it.

    Raises InputError where the text cannot be edited.
    """
    try:
        document = tomlkit.parse(text)
        model = document["model"]
        for name, value in values.items():
            number = float(f"{value:.{DIGITS}g}")
            if match := _ENTRY.fullmatch(name):
                model[match[1]][int(match[2])] = number
            elif name in model["parameters"]:
                model["parameters"][name] = number
            else:
                model[name] = number
        if "can" in document:
            document["can"]["dbc"] = Path(document["can"]["dbc"]).name
    except (TOMLKitError, KeyError) as error:
        raise InputError(where, "model", f"cannot be edited ({error})", "a project file") from None
    return tomlkit.dumps(document)


def values_of(unknowns: Unknowns, theta: np.ndarray) -> dict[str, float]:
    """Fitted numbers by name, with the input_offset from the drives' trims; theta (p,)."""
    values = dict(zip(unknowns.names, (float(x) for x in theta), strict=True))
    if unknowns.base.fit.trim == "drive":
        offsets = unknowns.base.model.input_offset or []
        values |= {f"input_offset[{i}]": float(x) for i, x in enumerate(offsets)}
    return values
