"""Shared parts of the verbs: application, common options, progress, files, and reading of an
identification."""

from __future__ import annotations

import sys
import warnings
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer
from rich.console import Console
from rich.progress import BarColumn, SpinnerColumn, Task, TextColumn, TimeElapsedColumn, TimeRemainingColumn
from rich.progress import Progress as Bar
from rich.text import Text

from .. import __version__
from ..base import artefacts
from ..base.errors import InputError, InputWarning
from ..base.progress import Counted, Progress
from ..vehicle.stored_settings import require_settings
from .guard import Application, running
from .sections import Sections

if TYPE_CHECKING:
    from ..base.parallel import Map
    from ..identify.identification import DriveSet, StoredIdentification
    from ..replay.replayer import Replayer
    from ..vehicle.project import Project

PROGRAM = "lpvguard"
COMPLETE = f"_{PROGRAM.upper()}_COMPLETE"
"""The variable with which a shell's completion script asks for what may come next."""
app = Application(
    cls=Sections,
    add_completion=False,
    no_args_is_help=True,
    rich_markup_mode=None,
    pretty_exceptions_enable=False,
    context_settings={"help_option_names": ["-h", "--help"]},
    help="From recorded drives to a compiled monitor and controller. "
    "Exit status 0, 1 (a finding), 2 (bad input).",
)
# Away from a terminal nothing is known of the reader's width: keep rows whole.
console = Console(stderr=True, width=None if sys.stderr and sys.stderr.isatty() else 160, soft_wrap=True)

Vehicle = Annotated[
    str, typer.Option("--vehicle", help="Shipped vehicle, or path to a project file (*.toml).")
]
Out = Annotated[Path, typer.Option("-o", "--out", help="Folder or file to write.")]
JsonOut = Annotated[str | None, typer.Option("--json", help="Write JSON to this file; - is standard output.")]
Jobs = Annotated[int, typer.Option(min=1, help="Processes of this machine that share the work.")]
Scheduler = Annotated[
    str | None, typer.Option(help="Address of a Dask scheduler whose workers share the drives.")
]
Keep = Annotated[
    Path | None,
    typer.Option(help="Folder that keeps what was computed of each drive: a further drive costs seconds."),
]
LCM_DEFAULT = "udpm://239.255.76.67:7667?ttl=0"
Coefficients = Annotated[
    Path | None, typer.Option("--coefficients", help="Generated folder (default: the shipped one).")
]


WHOLE_S = 1e6
"""Time from which the remainder is estimated by all work done, because steps are equal only on the whole
[s]."""


class Remaining(TimeRemainingColumn):
    """An estimate of what remains, where the steps are counted."""

    def render(self, task: Task) -> Text:
        """The estimate, or nothing."""
        left = "" if task.total is None else super().render(task).plain
        return Text(f"{left} left" if left else "")


@contextmanager
def progress_bar(title: str) -> Iterator[Progress]:
    """A bar on standard error while the command works; yields what tells it the step that runs."""
    columns = (
        SpinnerColumn(),
        TextColumn("{task.description}"),
        BarColumn(bar_width=20),
        TimeElapsedColumn(),
        Remaining(),
    )
    with Bar(*columns, console=console, transient=True, speed_estimate_period=WHOLE_S) as bar:
        task = bar.add_task(title, total=None)

        def tell(text: str) -> None:
            bar.update(task, description=f"{title}: {text}")
            if isinstance(text, Counted):
                bar.update(task, completed=text.done, total=text.total)

        yield tell


def emit(json_out: str | None, value: Any, *, each: bool = False) -> None:
    """Write the JSON value to the file of --json (- is standard output), with the mark of the command.

    With ``each``, every member of an object gets the mark. Without --json nothing is written.
    """
    if json_out:
        artefacts.write_json(json_out, value, running(), each=each)


@contextmanager
def keeping(folder: Path | None, workers: Map) -> Iterator[Map]:
    """The map, or one that reads and keeps results in a folder. Unused ones are removed at a good end."""
    if folder is None:
        yield workers
        return
    from ..base.kept_results import KeptResults

    kept = KeptResults(folder)
    yield kept.over(workers)
    kept.drop_unused()


def project_of(vehicle: str, drives: Path | None = None) -> Project:
    """Load the project of a shipped vehicle or of a project file. InputError if there is neither.

    The ranges of the own bus are checked against the folder ``drives``.
    """
    from ..vehicle.project import load_project

    project = load_project(vehicle)
    if drives is not None:
        warn_of_ranges(project, drives)
    return project


def warn_of_ranges(project: Project, folder: Path | None = None) -> None:
    """Warn where the database of the vehicle's own bus has a range that its bits or the drives contradict."""
    if project.can is None:
        return
    import numpy as np

    from ..can.own import own_bus, refused_values
    from ..drives.tables import list_experiments, read_drive

    if folder is None:
        own_bus(project)
        return
    drives = [read_drive(e.path, project) for e in list_experiments(folder)]
    values = np.vstack([np.column_stack((d.v, d.u, d.y)) for d in drives]).T
    names = [s.name for s in (project.speed, *project.inputs, *project.outputs)]
    for sentence in refused_values(project, dict(zip(names, values, strict=True))):
        warnings.warn(sentence, InputWarning, stacklevel=1)


@app.callback(invoke_without_command=True)
def _root(version: Annotated[bool, typer.Option("--version", help="Print the version.")] = False) -> None:
    if version:
        print(f"lpvguard {__version__}")
        raise typer.Exit()


def replayer_of(vehicle: str, coefficients: Path | None) -> Replayer:
    """The compiled core of a vehicle, of its shipped folder or of ``coefficients``. InputError where the
    folder was made with other settings than the project file's."""
    from ..replay.vehicle_core import replayer_for

    return replayer_for(project_of(vehicle), coefficients, vehicle)


def stored_for(identification: Path, vehicle: str) -> StoredIdentification:
    """The identification in a folder, with the vehicle's own bus. InputError where it is of another vehicle,
    or of other settings."""
    from ..identify import identification as stage

    stored, project = stage.load(identification), project_of(vehicle)
    if stored.project.name != project.name:
        raise InputError(identification, "vehicle", stored.project.name, f"an identification of {vehicle}")
    require_settings(artefacts.read_json(identification / "project.json"), identification, project, vehicle)
    return replace(stored, project=stored.project.model_copy(update={"can": project.can}))


def stored_with_drives(
    identification: Path, folder: Path, vehicle: str | None = None
) -> tuple[StoredIdentification, DriveSet]:
    """The identification and the drives that it was made from. ``vehicle`` None accepts any.
    InputError where a drive is not the file that was identified."""
    from ..identify import identification as stage

    stored = stage.load(identification) if vehicle is None else stored_for(identification, vehicle)
    drives = stage.DriveSet(stored.project, stored.model, folder)
    for e in drives.experiments.values():
        if stored.manifest["sha256"].get(e.name) != artefacts.file_hash(e.path):
            raise InputError(
                e.path, "", "is not the file that was identified", f"the drives of {identification}"
            )
    return stored, drives


def complain(error: InputError) -> None:
    """Print the error as every command does, on standard error."""
    print(f"lpvguard: error: {error}", file=sys.stderr)
