"""Stage 0: uniform drive tables (CSV, Parquet or MATLAB), checked against the vehicle's signal table.

A drive folder holds one table a drive and ``experiments.csv``. That index has at least the columns
``experiment`` (file stem) and ``split``. A ``driver`` is carried along. Pieces of one recording name it in
``recording``, and drives with something in common name it in ``group``. A drive that shall not count stays
listed, with ``use`` = no and the ``reason``. Nothing is repaired here: an InputError names file, line and
column of what does not fit. ``lpvguard ingest`` turns raw logs into such tables.
"""

from __future__ import annotations

import csv
import io
import re
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pa_parquet

from ..base import artefacts
from ..base.errors import InputError
from ..base.parallel import Map
from ..can.delimited import read_csv
from ..can.logs import INDEX
from ..can.matlab import read_matlab
from ..vehicle.project import Project, Signal
from .records import SUFFIX, record_table

TABLE_SUFFIXES = (".csv", ".parquet", ".mat", SUFFIX)
EXPERIMENTS = INDEX
MOST_MISSING = 0.1
"""Largest share of a table's samples with no value or an impossible one. A wrong unit makes more of them."""


@dataclass(frozen=True)
class Drive:
    """One drive on a uniform grid, in the units of the signal table.

    Where samples are missing, inputs and outputs are filled, and v is outside the model's range. Nothing is
    judged there.

    Attributes
    ----------
    name : str
    t : ndarray (N,), s
    v : ndarray (N,), m/s
    u : ndarray (N, n_u)
    y : ndarray (N, n_y)
    instrument : ndarray (N,) or None, the column that the project names, in its unit
    missing : ndarray (N,) of bool, or None for nowhere
        No sample, no value, or one outside its signal's range.
    """

    name: str
    t: np.ndarray
    v: np.ndarray
    u: np.ndarray
    y: np.ndarray
    instrument: np.ndarray | None = None
    missing: np.ndarray | None = None

    @property
    def missing_samples(self) -> int:
        """Number of missing samples."""
        return 0 if self.missing is None else int(self.missing.sum())

    @property
    def present(self) -> Drive:
        """The drive without its missing samples; its time has gaps."""
        return self if self.missing is None else self._piece(~self.missing)

    @property
    def duration_s(self) -> float:
        """Time from the first to the last sample [s]."""
        return float(self.t[-1] - self.t[0])

    def from_sample(self, k: int) -> Drive:
        """The drive without its first k samples."""
        return self._piece(slice(k, None))

    def before_sample(self, k: int) -> Drive:
        """The first k samples of the drive."""
        return self._piece(slice(None, k))

    def _piece(self, piece: slice | np.ndarray) -> Drive:
        instrument, missing = (None if x is None else x[piece] for x in (self.instrument, self.missing))
        return Drive(
            self.name, self.t[piece], self.v[piece], self.u[piece], self.y[piece], instrument, missing
        )


_DATE = re.compile(r"(20\d\d)[-_.]?([01]\d)[-_.]?([0-3]\d)")


@dataclass(frozen=True)
class Experiment:
    """An entry of ``experiments.csv``.

    Attributes
    ----------
    name, split, driver : str
    path : Path, its table
    recording : str, by default the drive's own name
    group : str or None, driver, road, day or anything else that drives have in common
    """

    name: str
    path: Path
    split: str
    driver: str
    recording: str
    group: str | None = None

    @property
    def group_or_recording(self) -> str:
        """The group, of a drive without one its recording."""
        return self.group or self.recording

    @property
    def identity(self) -> tuple[str | None, ...]:
        """The drive's entry and its table's hash, on which its results depend (base/kept_results.py)."""
        entry = self.name, self.split, self.driver, self.recording, self.group
        return *entry, artefacts.file_hash(self.path)


def day_of(name: str) -> str:
    """Return the date in a drive's name.

    Parameters
    ----------
    name : str

    Returns
    -------
    str, as 2026-04-22; empty without one

    Examples
    --------
    >>> day_of("rl_2026-04-22_03-36-39"), day_of("20251010T0511"), day_of("run_7")
    ('2026-04-22', '2025-10-10', '')
    """
    date = _DATE.search(name)
    return "-".join(date.groups()) if date else ""


def list_experiments(folder: Path) -> list[Experiment]:
    """List the drives in use, in the order of the folder's experiments.csv.

    Parameters
    ----------
    folder : Path

    Returns
    -------
    list[Experiment]

    Raises
    ------
    InputError
        If the index cannot be read, or names no drives.
    """
    return _listed(folder)[0]


def set_aside(folder: Path) -> dict[str, str]:
    """Return the drives whose ``use`` is no.

    Parameters
    ----------
    folder : Path

    Returns
    -------
    dict[str, str], reason by drive
    """
    return {name: f"set aside in {EXPERIMENTS}: {why}" for name, why in _listed(folder)[1].items()}


def index_column(folder: Path, column: str) -> dict[str, str]:
    """Read a column of experiments.csv.

    Parameters
    ----------
    folder : Path
    column : str

    Returns
    -------
    dict[str, str], text by drive

    Raises
    ------
    InputError
        If a drive has none.
    """
    index = folder / EXPERIMENTS
    texts = {row["experiment"]: row.get(column) or "" for row in index_rows(index)}
    lacking = next((name for name, text in texts.items() if not text), None)
    if lacking is not None:
        raise InputError(index, f"column {column}", f"{lacking} has none", "a value for every drive")
    return texts


def _listed(folder: Path) -> tuple[list[Experiment], dict[str, str]]:
    """Drives in use, and the reasons of the others."""
    index = folder / EXPERIMENTS
    if not folder.is_dir():
        raise InputError(folder, "", "no such folder", f"a folder of drives with {EXPERIMENTS}")
    if not index.is_file():
        raise InputError(index, "", "missing", "a CSV with the columns experiment, split (and driver)")
    experiments: list[Experiment] = []
    aside: dict[str, str] = {}
    for line, row in enumerate(index_rows(index), start=2):
        for column in ("experiment", "split"):
            if not row.get(column):
                raise InputError(index, f"line {line}, column {column}", "missing or empty", "a value")
        stem = row["experiment"]
        if stem in aside or any(e.name == stem for e in experiments):
            raise InputError(index, f"line {line}, column experiment", f"{stem} occurs twice", "unique names")
        if not _in_use(row, index, line):
            aside[stem] = row["reason"]
            continue
        path = next((p for s in TABLE_SUFFIXES if (p := folder / f"{stem}{s}").is_file()), None)
        if path is None:
            raise InputError(
                index, f"line {line}", f"no table {stem} ({', '.join(TABLE_SUFFIXES)})", "the file beside it"
            )
        driver, recording = row.get("driver") or "unknown", row.get("recording") or stem
        group = row.get("group") or None
        experiments.append(Experiment(stem, path.absolute(), row["split"], driver, recording, group))
    if not experiments:
        raise InputError(index, "", "lists no drive in use", "at least one line")
    return experiments, aside


def index_rows(index: Path) -> list[dict[str, str]]:
    """Read the lines of an experiments.csv by its header.

    Parameters
    ----------
    index : Path

    Returns
    -------
    list of dict, text by column

    Raises
    ------
    InputError
        If it cannot be read, or names no drives.
    """
    expected = "a CSV in UTF-8 with the columns experiment and split"
    try:
        with index.open(newline="", encoding="utf-8-sig") as stream:
            table = csv.DictReader(stream)
            columns, rows = table.fieldnames or [], list(table)
    except (OSError, ValueError, csv.Error) as error:
        raise InputError(index, "", f"cannot be read ({error})", expected) from None
    for column in ("experiment", "split"):
        if column not in columns:
            raise InputError(index, "header", f"column {column} is missing, there is {columns}", expected)
    return rows


def _in_use(row: dict[str, str], index: Path, line: int) -> bool:
    """Return whether a line's drive counts. Raises InputError unless ``use`` is yes, or no with a reason."""
    use = row.get("use") or "yes"
    if use not in ("yes", "no"):
        raise InputError(index, f"line {line}, column use", repr(use), "yes or no")
    if use == "no" and not row.get("reason"):
        raise InputError(
            index, f"line {line}, column reason", "missing or empty", "why the drive is not used"
        )
    return use == "yes"


def index_text(rows: Iterable[tuple[str, ...]], *further: str) -> str:
    """Write an experiments.csv.

    Parameters
    ----------
    rows : Iterable of (drive, split, and a text for each further column)
    *further : str, names of the further columns, default 'recording'

    Returns
    -------
    str
    """
    text = io.StringIO()
    csv.writer(text, lineterminator="\n").writerows(
        [("experiment", "split", *(further or ("recording",))), *rows]
    )
    return text.getvalue()


def bound_setting(project: Project, experiments: list[Experiment], folder: Path) -> list[Experiment]:
    """Select the drives whose split sets the bounds.

    Parameters
    ----------
    project : Project
    experiments : list[Experiment]
    folder : Path, the drives' folder, for errors

    Returns
    -------
    list of Experiment

    Raises
    ------
    InputError
        If there is none.
    """
    setting = [e for e in experiments if e.split in project.data.bound_split]
    if not setting:
        raise InputError(
            folder / EXPERIMENTS,
            "column split",
            f"no drive has split {' or '.join(project.data.bound_split)}",
            "at least one drive that sets the bounds",
        )
    return setting


def read_drive(path: Path, project: Project, *, any_values: bool = False) -> Drive:
    """Read and check one drive table.

    A sample is missing when it has no value (an empty cell, NaN) or one outside its signal's range (a spike,
    a reverse piece). Samples that a gate shuts out are missing too, however many.

    Parameters
    ----------
    path : Path
    project : Project
    any_values : bool, take all numbers unchanged and allow no empty cell, default False

    Returns
    -------
    Drive

    Raises
    ------
    InputError
        If a column is missing or no number, the grid does not fit, or more than MOST_MISSING are missing.
    """
    table = _read_table(path, project)
    signals = project.recorded
    columns = ["t", *(s.column for s in signals)]
    if project.model_error.instrument is not None:
        columns.append(project.model_error.instrument)
    for column in columns:
        if column not in table.column_names:
            raise InputError(path, "header", f"column {column} is missing", f"columns {', '.join(columns)}")
    t = _column(path, table, "t")
    _require_finite(path, "t", "s", t)
    if len(t) < 2:
        raise InputError(path, "", f"{len(t)} sample(s)", "at least 2 samples")
    _require_uniform(path, t, project.Ts_s)
    values = {s.name: _column(path, table, s.column) for s in signals}
    instrument = project.model_error.instrument
    outside = None if instrument is None else _column(path, table, instrument)
    if any_values:
        missing = None
        for s in signals:
            _require_finite(path, s.column, s.unit, values[s.name])
    else:
        missing = _missing(path, project, values)
    if outside is not None:
        _require_finite(path, str(instrument), "its own unit", outside)

    del table
    pa.default_memory_pool().release_unused()  # a long drive's text and table are twice its numbers

    def stack(group: list[Signal]) -> np.ndarray:
        return np.column_stack([values[s.name] for s in group])

    return Drive(
        path.stem,
        t,
        values[project.speed.name],
        stack(project.inputs),
        stack(project.outputs),
        outside,
        missing,
    )


def write_divided(path: Path, target: Path, project: Project, divisors: Sequence[float]) -> None:
    """Write a drive table with its outputs divided, as Parquet.

    Parameters
    ----------
    path, target : Path
    project : Project
    divisors : Sequence of float, by output

    Raises
    ------
    InputError
        If the table cannot be read, or lacks an output.
    """
    table = _read_table(path, project)
    for signal, divisor in zip(project.outputs, divisors, strict=True):
        if signal.column not in table.column_names:
            raise InputError(path, "header", f"column {signal.column} is missing", "a column of each output")
        values = pa.array(_column(path, table, signal.column) / divisor)
        table = table.set_column(table.column_names.index(signal.column), signal.column, values)
    pa_parquet.write_table(table, target)


def _read_table(path: Path, project: Project) -> pa.Table:
    if not path.is_file():
        raise InputError(path, "", "no such file", "a drive table: CSV, Parquet or MATLAB")
    if path.stat().st_size == 0:
        raise InputError(path, "", "the file is empty", "a header line and samples")
    try:
        if path.suffix == ".parquet":
            return pa_parquet.read_table(path)
        if path.suffix == ".mat":
            return read_matlab(path)
        if path.suffix == SUFFIX:
            return record_table(path, project)
        table, skipped = read_csv(path.read_bytes(), ["", "NA", "null"])
        if skipped:
            raise InputError(path, "line 1", "comments before the header", "a header line first")
        return table
    except (pa.ArrowException, OSError) as error:
        raise InputError(
            path,
            "",
            f"cannot be parsed ({str(error).splitlines()[0]})",
            "a CSV with one header line, Parquet, or MATLAB variables",
        ) from None


def _line(index: int) -> str:
    return f"line {index + 2}"


def _column(path: Path, table: pa.Table, column: str) -> np.ndarray:
    """Numbers (N,) of a column, NaN where a cell is empty; InputError for text that is no number."""
    chunked = table.column(column)
    if pa.types.is_floating(chunked.type) or pa.types.is_integer(chunked.type):
        values = chunked.cast(pa.float64()).to_numpy(zero_copy_only=False)
        return np.ascontiguousarray(values, float)
    values = np.full(len(chunked), np.nan)
    for i, item in enumerate(chunked.to_pylist()):
        try:
            values[i] = np.nan if item is None else float(item)
        except (TypeError, ValueError):
            raise InputError(
                path, f"{_line(i)}, column {column}", f"{item!r} is no number", "a number, or nothing"
            ) from None
    return values


def _require_finite(path: Path, column: str, unit: str, values: np.ndarray) -> None:
    bad = np.flatnonzero(~np.isfinite(values))
    if len(bad):
        raise InputError(
            path,
            f"{_line(bad[0])}, column {column}",
            f"{values[bad[0]]}",
            f"a finite number in {unit} ({len(bad)} such values in the file)",
        )


def _require_uniform(path: Path, t: np.ndarray, Ts: float) -> None:
    step = np.diff(t)
    backwards = np.flatnonzero(step <= 0)
    if len(backwards):
        k = backwards[0] + 1
        shuffled = ", and back so often that the rows are shuffled" if len(backwards) > 0.2 * len(t) else ""
        raise InputError(
            path,
            f"{_line(k)}, column t",
            f"time goes from {t[k - 1]:g} to {t[k]:g} s{shuffled}",
            "strictly increasing time",
        )
    typical = float(np.median(step))
    # Half a sample of drift against the grid is the most that a rounded time column can explain.
    off = np.flatnonzero(
        (np.abs(step - Ts) > 0.25 * Ts) | (np.abs(t[1:] - t[0] - Ts * np.arange(1, len(t))) > 0.5 * Ts)
    )
    if len(off):
        k = off[0] + 1
        raise InputError(
            path,
            f"{_line(k)}, column t",
            f"step of {step[k - 1]:g} s to t = {t[k]:g} s{_other_rate(typical, Ts)}",
            f"a uniform grid of {Ts:g} s (lpvguard ingest resamples)",
        )


def _other_rate(typical: float, Ts: float) -> str:
    """Hint on a table's typical step [s] that is not the sample time Ts [s]."""
    if abs(typical - Ts) <= 0.25 * Ts:
        return ""
    return f"; the table has {Ts / typical:.3g} times the rate of the project file"


def _missing(path: Path, project: Project, values: dict[str, np.ndarray]) -> np.ndarray | None:
    """True (N,) where a sample has no possible value, or a gate is shut; None where nowhere.

    ``values`` are filled there in place.
    """
    signals = [project.speed, *project.inputs, *project.outputs]
    outside = {s.name: _outside(s, values[s.name]) for s in project.recorded}
    missing = np.logical_or.reduce([outside[s.name] for s in signals])
    if missing.mean() > MOST_MISSING:
        for s in sorted(signals, key=lambda s: -outside[s.name].sum()):
            _refuse_outside(path, s, values[s.name])
    missing = np.logical_or.reduce([missing, *(outside[s.name] for s in project.gates)])
    if not missing.any():
        return None
    if missing.all():
        for s in sorted(project.gates, key=lambda s: -outside[s.name].sum()):
            _refuse_outside(path, s, values[s.name])
    index = np.arange(len(missing))
    for s in signals:
        values[s.name] = np.interp(index, index[~missing], values[s.name][~missing])
    values[project.speed.name][missing] = speed_of_missing(project)
    return missing


def speed_of_missing(project: Project) -> float:
    """Return the speed of missing samples, outside the model's range.

    Parameters
    ----------
    project : Project

    Returns
    -------
    float, m/s
    """
    return 0.0 if project.model.speed_min_mps > 0 else 2.0 * project.model.speed_max_mps


def missing_words(name: str, samples: int) -> str:
    """Word the number of a drive's missing samples.

    Parameters
    ----------
    name : str, the drive
    samples : int

    Returns
    -------
    str
    """
    return f"{name}: {samples} samples without a value, or with one outside its signal's range, are missing"


def _outside(signal: Signal, values: np.ndarray) -> np.ndarray:
    """True (N,) where there is no value within the signal's range."""
    return ~((values >= signal.min) & (values <= signal.max))


def _refuse_outside(path: Path, signal: Signal, values: np.ndarray) -> None:
    """Raise InputError for the first value outside the signal's range."""
    outside = np.flatnonzero(_outside(signal, values))
    if len(outside):
        k = outside[0]
        hint = "; is it in degrees?" if signal.unit.startswith("rad") and np.isfinite(values[k]) else ""
        raise InputError(
            path,
            f"{_line(k)}, column {signal.column}",
            f"{values[k]:g}{hint}",
            f"{signal.min:g} to {signal.max:g} {signal.unit} ({len(outside)} such values in the file)",
        )


def require_units(path: Path | str, drive: Drive, nominal_output: np.ndarray, settled: np.ndarray) -> None:
    """Refuse a drive whose output is about 57 times (or 1/57 of) the nominal one: degrees for radians.

    Small angles in degrees can stay within the signal's range. A factor of 40 to 80 together with a
    correlation above 0.8 is refused. A faulty sensor does not do that; it would be a finding and no input
    error.

    Parameters
    ----------
    path : Path or str
    drive : Drive
    nominal_output : ndarray (N, n_y), output units
    settled : ndarray (N,) of bool, in speed range, and the initial state forgotten

    Raises
    ------
    InputError
        If an output seems to have the other unit.
    """
    for j in range(drive.y.shape[1]):
        y, yhat = drive.y[settled, j], nominal_output[settled, j]
        if len(y) < 2 or not (np.std(y) > 0 and np.std(yhat) > 0):
            continue
        ratio = np.std(y) / np.std(yhat)
        if abs(np.corrcoef(y, yhat)[0, 1]) > 0.8 and (40 < ratio < 80 or 40 < 1 / ratio < 80):
            raise InputError(
                path,
                f"output {j}",
                f"is {ratio:.3g} times the nominal model's",
                "radians (a factor near 57.3 means that one column is in degrees)",
            )


def table_hashes(experiments: list[Experiment], workers: Map = map) -> dict[str, str]:
    """Hash every drive's table.

    Parameters
    ----------
    experiments : list[Experiment]
    workers : Map

    Returns
    -------
    dict[str, str], SHA-256 by drive

    Raises
    ------
    InputError
        If two are the same: one drive would count twice.
    """
    hashes: dict[str, str] = {}
    first: dict[str, str] = {}
    for e, digest in zip(
        experiments, workers(artefacts.file_hash, [e.path for e in experiments]), strict=False
    ):
        if digest in first:
            raise InputError(
                e.path.parent / EXPERIMENTS,
                "column experiment",
                f"{e.name} is the same table as {first[digest]}, byte for byte",
                "every drive once",
            )
        hashes[e.name], first[digest] = digest, e.name
    return hashes
