"""`lpvguard data`: rebuild a public data set from its origin and compare each file with its hash."""

import csv
import hashlib
import io
from collections.abc import Callable
from pathlib import Path

import numpy as np
from scipy.io import loadmat
from scipy.io.matlab import MatReadError
from scipy.signal import savgol_filter

from ...base import artefacts
from ...base.errors import InputError
from .origin import Origin, origin_of
from .table import CanArrays, Copy, Csv, DataSet, Form, Matlab, PublicFile

ARRAYS = ("address", "data", "src", "t")
"""Files in a folder of CAN arrays, in the order in which they are hashed."""
FRAME_BYTES = 8
"""Frames are filled with zeros up to this length, because the arrays have lost trailing zeros."""


def rebuild(
    name: str, data: DataSet, out: Path, source: Path | None, tell: Callable[[str], None]
) -> list[str]:
    """Write a data set into a folder, whole or not at all.

    Parameters
    ----------
    name : str, name of the data set
    data : DataSet
    out : Path, new folder
    source : Path or None, see :func:`origin_of`
    tell : Callable, reports progress

    Returns
    -------
    list of str, names of its files

    Raises
    ------
    InputError
        If a source or a result differs from the table's hash.
    """
    written = {}
    with artefacts.new_folder(out, "data") as folder, origin_of(data, source) as origin:
        for f in data.files:
            tell(f.name)
            target = folder / f.name
            target.parent.mkdir(parents=True, exist_ok=True)
            target.write_bytes(made(f, data.form, origin))
            written[f.name] = {"commit": f.commit, "path": f.path, "source_sha256": f.source_sha256}
        if data.index is not None:
            (folder / data.index).write_bytes(_index(data))
        text = artefacts.manifest("data", data_set=name, repository=data.repository, sources=written)
        artefacts.write_files(folder, {artefacts.MANIFEST: text})
    return [*written, *([data.index] if data.index else [])]


def made(f: PublicFile, form: Form, origin: Origin) -> bytes:
    """Make the bytes of a file from its source; compare the hashes of the source and the file."""
    form = f.form or form
    names = [f"{f.path}/{n}" for n in ARRAYS] if isinstance(form, CanArrays) else [f.path]
    parts = [origin.read(f.commit, n) for n in names]
    _require(f, f.path, f.source_sha256, b"".join(parts), f"the file of commit {f.commit}")
    try:
        data = _formed(form, parts)
    except (ValueError, KeyError, NotImplementedError, MatReadError) as error:
        raise InputError(
            f.path, "", f"cannot be read as {form.kind} ({error})", "the form in the table"
        ) from None
    _require(f, f.name, f.sha256, data, "the same numbers from the same source (other numpy or scipy?)")
    return data


def _require(f: PublicFile, what: str, sha256: str, data: bytes, expected: str) -> None:
    digest = hashlib.sha256(data).hexdigest()
    if digest != sha256:
        raise InputError(what, "sha256", f"{digest}, not {sha256}", expected)


def _formed(form: Form, parts: list[bytes]) -> bytes:
    if isinstance(form, Copy):
        return parts[0]
    if isinstance(form, Matlab):
        return _of_matlab(form, parts[0])
    return _of_csv(form, parts[0]) if isinstance(form, Csv) else _of_arrays(form, parts)


def _of_matlab(form: Matlab, source: bytes) -> bytes:
    variables = loadmat(io.BytesIO(source))

    def signal(name: str) -> np.ndarray:
        return np.ravel(variables[name]).astype(float)

    t = signal(form.time) - signal(form.time)[0]
    grid = np.arange(0, t[-1], 1 / form.rate_hz)
    fields = []
    for column in form.columns:
        values = grid
        if column.signal is not None:
            of_source = signal(column.signal)
            values = np.interp(grid, t, np.unwrap(of_source) if column.unwrap else of_source)
        if column.slope_samples is not None:
            values = savgol_filter(values, column.slope_samples, 2, deriv=1, delta=1 / form.rate_hz)
        fields.append([f"{x:.{column.decimals}f}" for x in values])
    lines = [",".join(c.name for c in form.columns), *(",".join(row) for row in zip(*fields, strict=True))]
    return ("\n".join(lines) + "\n").encode()


def _of_csv(form: Csv, source: bytes) -> bytes:
    lines = source.decode().splitlines()
    comments = next((k for k, line in enumerate(lines) if not line.startswith("#")), len(lines))
    rows = list(csv.reader(lines[comments:]))
    places = [rows[0].index(name) for name in form.columns] if rows else []
    kept = [",".join(row[p] for p in places) for row in rows]
    return ("\n".join([*lines[:comments], *kept]) + "\n").encode()


def _of_arrays(form: CanArrays, parts: list[bytes]) -> bytes:
    address, data, bus, t = (np.load(io.BytesIO(part), allow_pickle=False) for part in parts)
    lines = []
    for when, number, where, what in zip(
        t.tolist(), bus.tolist(), address.tolist(), data.tolist(), strict=True
    ):
        channel = form.buses.get(str(number))
        if channel is not None:
            lines.append(
                f"({when:.6f}) {channel} {where:03X}#{what.ljust(FRAME_BYTES, bytes(1)).hex().upper()}"
            )
    return ("\n".join(lines) + "\n").encode()


def _index(data: DataSet) -> bytes:
    text = io.StringIO(newline="")
    rows = [f.index for f in data.files if f.index]
    csv.writer(text).writerows([list(rows[0]), *(list(row.values()) for row in rows)])
    return text.getvalue().encode()
