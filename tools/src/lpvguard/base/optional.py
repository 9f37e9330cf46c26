"""Packages that only some uses need, with an error that says how to have them."""

from __future__ import annotations

from importlib import import_module
from typing import Any

from .errors import InputError


def optional(module: str, extra: str) -> Any:
    """The imported module; InputError naming the extra of this package that brings it."""
    try:
        return import_module(module)
    except ModuleNotFoundError:
        raise InputError(module, "", "is not installed", f"pip install 'lpvguard[{extra}]'") from None
