"""Table of public data sets: origin, conversion and hashes of each file.

The shipped table is ``public.toml``. Other tables have the same form, with one section for each data set.
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
    """Tell if a path stays below its folder."""
    return not path.startswith("/") and ".." not in path.split("/") and "\\" not in path


class MatlabColumn(StrictModel):
    """Column from a MATLAB variable, interpolated linearly to the grid.

    With ``signal`` None, the column is the time. With ``unwrap``, the variable is an angle [rad] that is
    first unwrapped. With ``slope_samples``, the column is the variable's slope over this number of grid
    samples (quadratic least squares).
    """

    name: str
    signal: str | None = None
    decimals: Annotated[int, Field(ge=0, le=12)]
    unwrap: bool = False
    slope_samples: Annotated[int, Field(ge=3)] | None = None


class Matlab(StrictModel):
    """MATLAB variables of equal length, on a grid of ``rate_hz`` from the first value of ``time`` [s]."""

    kind: Literal["matlab"]
    time: str
    rate_hz: Positive
    columns: Annotated[list[MatlabColumn], Field(min_length=1)]


class Csv(StrictModel):
    """Some columns of a CSV, with unchanged fields and comments before the header."""

    kind: Literal["csv"]
    columns: Annotated[list[str], Field(min_length=1)]


class CanArrays(StrictModel):
    """Candump log from four numpy arrays in one folder.

    The arrays are address, data (bytes), src (number of the bus) and t [s]. ``buses`` gives the channel of
    each bus number. Frames of other buses are left out.
    """

    kind: Literal["can_arrays"]
    buses: Annotated[dict[str, str], Field(min_length=1)]


class Copy(StrictModel):
    """Unchanged bytes of the file."""

    kind: Literal["copy"]


Form = Annotated[Matlab | Csv | CanArrays | Copy, Field(discriminator="kind")]


class PublicFile(StrictModel):
    """File of a data set.

    ``name`` is its path in the folder. ``path`` is its path in the repository at ``commit``, or the folder of
    its arrays. ``source_sha256`` is the hash of the source's bytes, with parts in the order of their names.
    ``sha256`` is the hash of the result. With ``form`` None, the file has the form of the data set. ``index``
    is the file's row in the index of the data set.
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
                raise ValueError(f"{path} is not a path below a folder")
        return self


class DataSet(StrictModel):
    """Data set.

    ``repository`` is fetched by git, and ``licence`` is its SPDX name. ``index`` is the name of a CSV file
    with the index rows of the files, or None.
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
    """Load one data set of a table.

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
        If the file is not a table of data sets, or has no section of this name.
    """
    document = read_toml(
        SHIPPED if table is None else table, EXPECTED, "public.toml" if table is None else table
    )
    where = "data" if table is None else table
    if name not in document:
        raise InputError(where, "", f"no data set {name}", f"one of {', '.join(sorted(document))}")
    return checked(DataSet, document[name], EXPECTED, where, table=name)
