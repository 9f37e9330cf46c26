"""Benches: ``lpvguard bench NAME`` measures a property and compares it with public packages in the same run.

A module of this package is a bench unless its name begins with _. Its ``main(argv)`` is the command
``lpvguard bench <module>``.
"""

import argparse
import sys
from collections.abc import Callable
from importlib import import_module
from pathlib import Path
from pkgutil import iter_modules
from typing import Any

from ...base import artefacts
from ...base.errors import InputError

MAY_IMPORT = (
    "base",
    "vehicle",
    "engine",
    "can",
    "drives",
    "core",
    "identify",
    "control",
    "replay",
    "fleet",
    "refine",
    "loop",
    "problems",
)


def names() -> list[str]:
    """Names of all benches."""
    return sorted(m.name for m in iter_modules(__path__) if not m.name.startswith("_"))


def run(name: str, argv: list[str]) -> None:
    """Run a bench with its own options.

    Parameters
    ----------
    name : str, name of the bench
    argv : list of str, options of the bench

    Raises
    ------
    InputError
        If there is no such bench.
    """
    if name not in names():
        raise InputError("bench", name, "no such bench", " or ".join(names()))
    import_module(f"{__name__}.{name}").main(argv)


class _JsonOut(argparse.Action):
    """Option ``--json``, stored as (path, kind); refuse a file that may not be replaced before the run."""

    def __call__(self, parser: Any, namespace: Any, values: Any, option_string: str | None = None) -> None:
        if values != "-":
            artefacts.require_replaceable_file(Path(values), str(self.const))
        setattr(namespace, self.dest, (values, self.const))


def parser(name: str, description: str | None) -> argparse.ArgumentParser:
    """Make the parser for a bench's options, with the common option ``--json``."""
    made = argparse.ArgumentParser(
        prog=f"lpvguard bench {name}",
        description=description,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    made.add_argument(
        "--json",
        dest="json_out",
        metavar="PATH",
        action=_JsonOut,
        const=f"bench {name}",
        help="write the numbers as JSON; - is standard output",
    )
    return made


def require_at_least(bench: str, options: argparse.Namespace, **least: float) -> None:
    """Raise InputError for the first option that is below its least value."""
    for name, smallest in least.items():
        value = getattr(options, name)
        if value < smallest:
            raise InputError(f"bench {bench}", f"--{name}", f"{value:g}", f"a number from {smallest:g} on")


def numbers_of(
    bench: str, option: str, text: str, good: Callable[[float], bool], expected: str
) -> list[float]:
    """Read the comma-separated numbers of an option; raise InputError unless all are ``good``."""
    try:
        values = [float(word) for word in text.split(",")]
    except ValueError:
        values = []
    if not values or not all(map(good, values)):
        raise InputError(f"bench {bench}", option, repr(text), f"{expected}, separated by commas")
    return values


def show(text: str, value: Any, json_out: tuple[str, str] | None) -> None:
    """Print the table, and write the numbers to the file of ``json_out``; for ``-`` print only the numbers.

    ``json_out`` is the path and the kind of the option ``--json``.
    """
    print(text, file=sys.stderr if json_out and json_out[0] == "-" else sys.stdout)
    if json_out:
        artefacts.write_json(json_out[0], value, json_out[1])
