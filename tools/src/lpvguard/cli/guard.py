"""Checks around every command: its outputs are apart from its inputs, replace only their own kind, and are
locked while it runs."""

from collections.abc import Callable
from contextlib import ExitStack
from functools import wraps
from pathlib import Path
from typing import Any

import typer

from ..base import artefacts
from ..base.errors import InputError

_FILES = ("report", "solve", "dbc", "a2l", "fmu", "lcm bus", "plant")
"""Commands whose -o is a file."""
_WRITTEN = ("json_out", "state", "export")
"""Options that name a file to write, whatever the command."""
_KINDS = {"export": "vehicle", "design": None}
"""Kinds of folders that are not named as their command; design writes several."""
_running: list[str] = []
"""Name of the command that runs, as its outputs are marked."""


def _lcm_log(url: str | None) -> list[Path]:
    """The file that an LCM URL makes a log of."""
    return (
        [Path(url.removeprefix("file://").split("?")[0])]
        if url and url.startswith("file:") and "mode=w" in url
        else []
    )


def _named(name: str, parameters: dict[str, Any]) -> tuple[list[Path], list[Path], list[Path]]:
    """Folders and files that a command is asked to write, and every other path among its parameters."""
    folders: list[Path] = []
    files: list[Path] = []
    inputs: list[Path] = []
    for key, value in parameters.items():
        if key in ("pictures", "series"):
            folders += [] if value is None else [Path(value)]
        elif key in ("out", *_WRITTEN):
            if value is not None and str(value) != "-":
                (files if key in _WRITTEN or name in _FILES else folders).append(Path(value))
        elif key == "lcm":
            files += _lcm_log(value)
        elif isinstance(value, typer.Context):  # bench and plant read their options themselves
            for before, word in zip(["", *value.args], value.args, strict=False):
                option, _, rest = word.partition("=")
                if before in ("-o", "--json") or (option == "--json" and rest):
                    files += [Path(rest or word)] if (rest or word) != "-" else []
                elif Path(word).exists():
                    inputs.append(Path(word))
        else:
            # A text that is no path may also be a vehicle's name, a bus or an address.
            items = value if isinstance(value, list) else [value]
            inputs += [
                Path(v) for v in items if isinstance(v, Path) or (isinstance(v, str) and Path(v).is_file())
            ]
    return folders, [f for f in files if not f.exists() or f.is_file() or f.is_dir()], inputs


def _guarded(name: str, command: Callable[..., Any]) -> Callable[..., Any]:
    """The command with outputs apart from its inputs (every other path), replaceable and locked while it
    runs.

    Other outputs are refused before the command starts.
    """

    @wraps(command)
    def run(*arguments: Any, **parameters: Any) -> Any:
        folders, files, inputs = _named(name, parameters)
        kind = f"bench {parameters['name']}" if name == "bench" else name
        with ExitStack() as held:
            for path in (*folders, *files, *inputs):
                artefacts.require_unicode(path)
            for path in inputs:
                artefacts.recover(path)
            if folders or files:
                artefacts.require_apart([*folders, *files], [*inputs, *_own_sources(name)])
            for target in folders:
                held.enter_context(artefacts.claimed(target))
                artefacts.require_replaceable_folder(
                    target, _KINDS.get(name, name), resumed=name == "campaign"
                )
            for target in files:
                held.enter_context(artefacts.claimed(target))
                if name != "lcm bus":  # a log has no room for a mark: its bytes decide, once they are known
                    artefacts.require_replaceable_file(target, kind)
            _running[:] = [kind]
            return command(*arguments, **parameters)

    return run


def _own_sources(command: str) -> list[Path]:
    """Paths that a command compiles or reads of itself. `export` may write the shipped folders."""
    from ..core.compiled import PACKAGE, firmware_root, library_root

    library = library_root()
    sources = [PACKAGE, *([library / "src", library / "include"] if command == "export" else [library])]
    try:
        return [*sources, firmware_root()]
    except InputError:
        return sources


class Application(typer.Typer):
    """Application in which every command is guarded; ``prefix`` precedes the names of its commands in
    marks."""

    prefix = ""

    def command(  # type: ignore[override]  # every option goes on to Typer as it is
        self, name: str | None = None, **options: Any
    ) -> Callable[[Callable[..., Any]], Callable[..., Any]]:
        """Register a command as typer.Typer.command does, guarded. Returns the function as it was."""

        def register(function: Callable[..., Any]) -> Callable[..., Any]:
            super(Application, self).command(name, **options)(
                _guarded(self.prefix + (name or function.__name__), function)
            )
            return function

        return register


def running() -> str:
    """Name of the command that runs, as its outputs are marked."""
    return _running[0]
