"""Import optional packages, with an error that names the extra to install."""

from importlib import import_module
from typing import Any

from .errors import InputError


def optional(module: str, extra: str) -> Any:
    """Import a module of an optional package.

    Parameters
    ----------
    module : str
    extra : str, extra of this package that brings it

    Returns
    -------
    module

    Raises
    ------
    InputError
        If it is not installed.
    """
    try:
        return import_module(module)
    except ModuleNotFoundError:
        raise InputError(module, "", "is not installed", f"pip install 'lpvguard[{extra}]'") from None
