"""Import optional packages, with an error that names the extra to install."""

from collections.abc import Iterator
from contextlib import contextmanager
from importlib import import_module
from pathlib import Path
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


@contextmanager
def read_by_library(path: Path, expected: str) -> Iterator[None]:
    """Turn the errors of a library of the extra ``sources`` that reads a file into input errors.

    Parameters
    ----------
    path : Path, named in errors
    expected : str, what the file should be

    Raises
    ------
    InputError
        If the library is missing, or raises.
    """
    try:
        yield
    except InputError:
        raise
    except ImportError as error:
        raise InputError(
            path, "", f"reading it needs the package {error.name}", "pip install 'lpvguard[sources]'"
        ) from None
    except Exception as error:  # each library has exceptions of its own
        raise InputError(path, "", f"cannot be read ({type(error).__name__}: {error})", expected) from None
