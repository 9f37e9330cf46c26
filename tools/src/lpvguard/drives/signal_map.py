"""What a drive table is made of: the signal map of `lpvguard ingest`.

It is a TOML file::

    schema = 1
    Ts_s = 0.01                 # grid of the table
    max_gap_s = 0.5             # a longer pause of a signal is left out, a shorter one is interpolated
                                (default 0.5)
    channel = "can0"            # frames of this interface only (default: all)
    j1939 = true                # 29-bit messages are J1939 groups: any priority and sender (default: as the
                                database says)
    time = "t"                  # time column of decoded tables (default: t, time or timestamp)
    rate_hz = 50.0              # instead of a time column: rows a second of decoded tables
    format = "csv"              # or "parquet"

    [columns.v]                 # column = factor * (signal in `unit`) + offset
    unit = "m/s"
    message = "SPEED"           # of the database; leave out for logs that are decoded already
    signal = "SPEED"            # signal, channel or column of the log
    factor = 1.0                # -1 turns the signal round, 0.25 makes a mean of four (default 1)
    scale = 0.2777777777777778  # from the signal's unit to `unit`; needed only where the units are not known
    offset = 0.0                # in `unit`

    [columns.delta]             # or a sum of signals: each term as above, the offset beside them
    unit = "rad"
    offset = 0.0
    terms = [{ message = "STEER", signal = "ANGLE" }, { message = "STEER", signal = "FRACTION" }]

Further keys of a column: ``min``, ``max`` (in ``unit``; samples outside are left out), ``max_gap_s``, and
``over``. ``over`` is another column of the map by which this one is divided, as a lateral acceleration by the
speed. Its amount counts as ``over_min`` where it is smaller (default 1). The terms then need a ``scale``.
Further keys of a term: ``rate``, ``source_unit`` (instead of the database's), ``wrap``, ``channel``,
``source_address`` (J1939), ``sign`` and ``not_available``. ``rate`` takes the signal's change a second, as of
a course; its unit is then the signal's over s. ``sign`` is a signal of the same message: where it is not 0,
the signal is negative. ``wrap`` is a period in the signal's own unit: the signal is unwrapped before
interpolation. Without it wraps are only suspected, and counted in the report. ``not_available`` is "j1939" or
"none", by default "j1939" when the message is a J1939 group.
"""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any, Literal

from pydantic import Field, model_validator

from ..base.documents import Positive, StrictModel, checked, read_toml
from ..base.errors import InputError
from ..vehicle.project import Project


class Term(StrictModel):
    """A signal of the log that a column is made of."""

    signal: str
    message: str | None = None
    factor: float = 1.0
    scale: float | None = None
    source_unit: str | None = None
    wrap: Positive | None = None
    channel: str | None = None
    source_address: Annotated[int, Field(ge=0, le=253)] | None = None
    sign: str | None = None
    not_available: Literal["j1939", "none"] | None = None
    rate: bool = False

    @property
    def name(self) -> str:
        """MESSAGE.SIGNAL, or the signal alone where it has no message."""
        return f"{self.message}.{self.signal}" if self.message else self.signal


class Column(StrictModel):
    """A column of the drive table: offset + the sum of its terms, in ``unit``, over another column or not."""

    unit: str
    terms: Annotated[list[Term], Field(min_length=1)]
    offset: float = 0.0
    min: float | None = None
    max: float | None = None
    max_gap_s: Positive | None = None
    over: str | None = None
    over_min: Positive = 1.0

    @model_validator(mode="before")
    @classmethod
    def _one_term(cls, column: Any) -> Any:
        """Let a column of one signal carry the keys of its term."""
        if isinstance(column, dict) and "terms" not in column:
            of_column = {k: v for k, v in column.items() if k in cls.model_fields}
            return {**of_column, "terms": [{k: v for k, v in column.items() if k not in of_column}]}
        return column

    @model_validator(mode="after")
    def _limits_of_one_term(self) -> Column:
        if len(self.terms) > 1 and (self.min is not None or self.max is not None):
            raise ValueError(
                "min and max judge the samples of one signal; a sum of terms has none of its own"
            )
        return self


class SignalMap(StrictModel):
    """Content of a drive table; the module's text explains the keys.

    Attributes
    ----------
    schema_ : int, version of the format
    Ts_s : float, s, grid of the table
    columns : dict[str, Column], by name
    max_gap_s : float, s, longest pause of a signal that is interpolated
    channel : str or None, interface whose frames are read, by default all
    j1939 : bool or None, whether 29-bit messages are J1939 groups, by default as the database says
    time : str or None, time column of decoded tables, by default t, time or timestamp
    rate_hz : float or None, Hz, rows a second of decoded tables whose times are not read
    format : str, of the tables
    """

    schema_: Literal[1] = Field(alias="schema")
    Ts_s: Positive
    columns: Annotated[dict[Annotated[str, Field(pattern=r"^[A-Za-z_]\w*$")], Column], Field(min_length=1)]
    max_gap_s: Positive = 0.5
    channel: str | None = None
    j1939: bool | None = None
    time: str | None = None
    rate_hz: Positive | None = None
    format: Literal["csv", "parquet"] = "csv"

    def gap_s(self, column: str) -> float:
        """Longest pause that is interpolated in ``column``."""
        return self.columns[column].max_gap_s or self.max_gap_s

    @model_validator(mode="after")
    def _consistent(self) -> SignalMap:
        if "t" in self.columns:
            raise ValueError("columns: t is the time")
        for name, column in self.columns.items():
            if column.over is None:
                continue
            if column.over not in self.columns or self.columns[column.over].over is not None:
                raise ValueError(f"columns.{name}: over = {column.over} is no column without `over`")
            if any(term.scale is None for term in column.terms):
                raise ValueError(f"columns.{name}: with `over` every term needs a scale")
        return self


def load_signal_map(path: Path) -> SignalMap:
    """Read and check a signal map.

    Parameters
    ----------
    path : Path

    Returns
    -------
    SignalMap

    Raises
    ------
    InputError
        If it does not fit: file, field and what was expected.
    """
    return checked(
        SignalMap,
        read_toml(Path(path), "a signal map"),
        "a signal map as `lpvguard ingest --help` describes",
        path,
    )


def map_of_project(project: Project) -> SignalMap:
    """Make the signal map of a vehicle whose signals have a CAN place.

    The bus value is factor * value. Gates and sums of signals get no ``min`` and ``max``: the vehicle's
    ranges judge the drive table.

    Parameters
    ----------
    project : Project

    Returns
    -------
    SignalMap

    Raises
    ------
    InputError
        If a signal has no CAN place.
    """
    without = [s.name for s in project.signals if s.can is None]
    if without:
        raise InputError(
            f"vehicle {project.name}",
            "signals",
            f"{', '.join(without)} have no `can` entry",
            "a message and a signal for each, or --dbc and --signals",
        )
    columns = {
        s.column: Column(
            unit=s.unit,
            min=None if place.plus or s.role == "gate" else s.min,
            max=None if place.plus or s.role == "gate" else s.max,
            terms=[
                Term(message=place.message, signal=name, scale=1.0 / place.factor)
                for name in (place.signal, *place.plus)
            ],
        )
        for s in project.signals
        if (place := s.can) is not None
    }
    return SignalMap(schema=1, Ts_s=project.Ts_s, columns=columns)
