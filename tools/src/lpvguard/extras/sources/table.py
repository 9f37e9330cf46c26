"""Table of public data sets: origin, conversion and hashes of each file.

The shipped table is ``public.toml``. Another table has the same form: a section a data set.
"""

from __future__ import annotations

from importlib import resources
from pathlib import Path
from typing import Annotated, Literal

from pydantic import Field, model_validator

from ...base.documents import Positive, StrictModel, checked, read_toml
from ...base.errors import InputError

SHIPPED = resources.files(__package__).joinpath("public.toml")
EXPECTED = "a table of public data sets (sources/public.toml shows one)"

Sha256 = Annotated[str, Field(pattern=r"^[0-9a-f]{64}$")]
Commit = Annotated[str, Field(pattern=r"^[0-9a-f]{40}$")]


def _plain(path: str) -> bool:
    """Return whether a path stays below its folder."""
    return not path.startswith("/") and ".." not in path.split("/") and "\\" not in path


class MatlabColumn(StrictModel):
    """A column made of a MATLAB variable, interpolated linearly to the grid.

    ``signal`` None: the time. ``unwrap``: an angle [rad], unwrapped first. ``slope_samples``: its slope over
    so many samples of the grid (least squares, quadratic).
    """

    name: str
    signal: str | None = None
    decimals: Annotated[int, Field(ge=0, le=12)]
    unwrap: bool = False
    slope_samples: Annotated[int, Field(ge=3)] | None = None


class Matlab(StrictModel):
    """MATLAB variables of one length, on a grid of ``rate_hz`` from the first value of ``time`` [s]."""

    kind: Literal["matlab"]
    time: str
    rate_hz: Positive
    columns: Annotated[list[MatlabColumn], Field(min_length=1)]


class Csv(StrictModel):
    """Some columns of a CSV, with unchanged fields and comments before the header."""

    kind: Literal["csv"]
    columns: Annotated[list[str], Field(min_length=1)]


class CanArrays(StrictModel):
    """A candump log of four numpy arrays in one folder.

    They are address, data (bytes), src (number of the bus) and t [s]. ``buses``: number -> channel; frames of
    others are left out.
    """

    kind: Literal["can_arrays"]
    buses: Annotated[dict[str, str], Field(min_length=1)]


class Copy(StrictModel):
    """The bytes of the file."""

    kind: Literal["copy"]


Form = Annotated[Matlab | Csv | CanArrays | Copy, Field(discriminator="kind")]


class PublicFile(StrictModel):
    """A file of a data set.

    ``name`` is its place in the folder. ``path`` is its place in the repository at ``commit`` (for arrays
    their folder). ``source_sha256`` is the hash of the bytes read there, with parts in the order of their
    names. ``sha256`` is that of the result. ``form`` None stands for the data set's. ``index`` is its row of
    the data set's index.
    """

    name: str
    commit: Commit
    path: str
    source_sha256: Sha256
    sha256: Sha256
    form: Form | None = None
    index: dict[str, str] = Field(default_factory=dict)

    @model_validator(mode="after")
    def _stays_below(self) -> PublicFile:
        for path in (self.name, self.path):
            if not _plain(path):
                raise ValueError(f"{path} is no path below a folder")
        return self


class DataSet(StrictModel):
    """A data set.

    ``repository`` is fetched by git, ``licence`` is its SPDX name. ``index``: name of a CSV with the
    ``index`` of every file that has one, or None.
    """

    title: str
    repository: str
    licence: str
    form: Form
    index: str | None = None
    files: Annotated[list[PublicFile], Field(min_length=1)]

    @model_validator(mode="after")
    def _rows_fit(self) -> DataSet:
        names = [f.name for f in self.files]
        twice = sorted({n for n in names if names.count(n) > 1})
        if twice:
            raise ValueError(f"{', '.join(twice)}: listed twice")
        rows = [tuple(f.index) for f in self.files if f.index]
        if self.index is not None and (not rows or len(set(rows)) > 1):
            raise ValueError("index: files whose `index` has the same columns in the same order")
        return self


def load_data_set(name: str, table: Path | None = None) -> DataSet:
    """Load a data set of a table.

    Parameters
    ----------
    name : str
    table : Path, optional, by default the shipped one

    Returns
    -------
    DataSet

    Raises
    ------
    InputError
        If the file is no such table, or has no such section.
    """
    document = read_toml(
        SHIPPED if table is None else table, EXPECTED, "public.toml" if table is None else table
    )
    where = "data" if table is None else table
    if name not in document:
        raise InputError(where, "", f"no data set {name}", f"one of {', '.join(sorted(document))}")
    return checked(DataSet, document[name], EXPECTED, where, table=name)
