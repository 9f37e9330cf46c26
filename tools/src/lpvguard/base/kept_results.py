"""Results of maps, kept in a folder: one more drive then costs only its own work.

A map of an identification is a function of its arguments and of one drive. The digest of all of these, with
that of this package's sources, names the file of the result. A later run reads what an earlier one kept. It
runs the same code in the same order, so the result has the same bits as without the folder.

A file holds its digest, arrays and JSON. Reading it runs nothing. A damaged file is computed anew. Results of
functions that the codec does not know are not kept.
"""

from __future__ import annotations

import dataclasses
import functools
import hashlib
import io
import json
import platform
import sys
from collections.abc import Callable, Iterable, Iterator
from functools import partial
from pathlib import Path
from types import FunctionType
from typing import Any

import numpy as np
import scipy

from . import artefacts
from .errors import InputError
from .parallel import Item, Map, Result

KIND = "kept results"
SUFFIX = ".kept"
PACKAGE = "lpvguard"
_SCALARS = (type(None), bool, int, float, str)


class _UnknownError(TypeError):
    """A value that the codec does not know."""


def _class_name(kind: type | FunctionType) -> str:
    if kind.__module__.split(".")[0] != PACKAGE or "<" in kind.__qualname__:
        raise _UnknownError(kind.__qualname__)
    return f"{kind.__module__}:{kind.__qualname__}"


def _fields(value: Any) -> list[tuple[str, Any]]:
    """Fields of a dataclass or a named tuple."""
    if isinstance(value, tuple):
        return list(zip(value._fields, value, strict=True))  # type: ignore[attr-defined]
    return [(f.name, getattr(value, f.name)) for f in dataclasses.fields(value)]


def encoded(value: Any, arrays: list[np.ndarray], *, identify: bool = False) -> Any:
    """Return the JSON form of a value; its arrays of any shape (...,) are appended to ``arrays``.

    With ``identify`` the form only names the value: ``identity`` of an object stands for it, and functions
    are allowed. Raises TypeError if the codec does not know the value.
    """
    again = partial(encoded, arrays=arrays, identify=identify)
    if type(value) in _SCALARS:
        return value
    if isinstance(value, np.ndarray | np.generic):
        array = np.asarray(value)
        if array.dtype.hasobject:
            if any(type(x) is not str for x in array.flat):
                raise _UnknownError("object")
            array = array.astype(str)
        arrays.append(array)
        form = "scalar" if isinstance(value, np.generic) else "texts" if value.dtype.hasobject else "array"
        return {form: len(arrays) - 1}
    if type(value) in (list, tuple):
        return {type(value).__name__: [again(x) for x in value]}
    if type(value) is dict:
        return {"dict": [[again(k), again(v)] for k, v in value.items()]}
    if identify and hasattr(value, "identity"):
        return {_class_name(type(value)): again(value.identity)}
    if identify and isinstance(value, partial):
        return {"partial": [again(value.func), again(value.args), again(value.keywords)]}
    if identify and isinstance(value, FunctionType):
        return {"function": _class_name(value)}
    if identify and hasattr(value, "model_dump_json"):
        return {_class_name(type(value)): value.model_dump_json(by_alias=True)}
    if dataclasses.is_dataclass(value) or (isinstance(value, tuple) and hasattr(value, "_fields")):
        return {_class_name(type(value)): [[name, again(x)] for name, x in _fields(value)]}
    raise _UnknownError(type(value).__qualname__)


def decoded(form: Any, arrays: list[np.ndarray]) -> Any:
    """Return the value of a form of `encoded`, whose ``arrays`` have any shape (...,).

    Raises ValueError for another form.
    """
    if not isinstance(form, dict):
        return form
    ((kind, content),) = form.items()
    if kind in ("array", "scalar", "texts"):
        array = arrays[content]
        return array[()] if kind == "scalar" else array.astype(object) if kind == "texts" else array
    if kind in ("list", "tuple"):
        items = [decoded(x, arrays) for x in content]
        return items if kind == "list" else tuple(items)
    if kind == "dict":
        return {decoded(k, arrays): decoded(v, arrays) for k, v in content}
    module, _, name = kind.partition(":")
    result_class: Any = sys.modules.get(module) if module.split(".")[0] == PACKAGE else None
    for part in name.split("."):
        result_class = getattr(result_class, part, None)
    values = {name: decoded(x, arrays) for name, x in content}
    if (
        isinstance(result_class, type)
        and issubclass(result_class, tuple)
        and hasattr(result_class, "_fields")
    ):
        return result_class(**values)
    if not (isinstance(result_class, type) and dataclasses.is_dataclass(result_class)):
        raise ValueError(f"{kind} is no class of results")
    result = object.__new__(result_class)
    for name, x in values.items():
        object.__setattr__(result, name, x)
    return result


def digest_of(value: Any) -> str:
    """Return the SHA-256 of a value as `encoded` identifies it; raise TypeError for an unknown kind."""
    arrays: list[np.ndarray] = []
    sha = hashlib.sha256(json.dumps(encoded(value, arrays, identify=True)).encode())
    for array in arrays:
        sha.update(f"{array.dtype.str}{array.shape}".encode() + np.ascontiguousarray(array).tobytes())
    return sha.hexdigest()


@functools.cache
def _sources() -> str:
    """Digest of this package's sources and of what computes with them."""
    root = Path(__file__).parents[1]
    sha = hashlib.sha256(f"{sys.version} {np.__version__} {scipy.__version__} {platform.machine()}".encode())
    for path in sorted(p for p in root.rglob("*") if p.suffix in (".py", ".cpp", ".hpp", ".json")):
        sha.update(f"{path.relative_to(root)}".encode() + path.read_bytes())
    return sha.hexdigest()


class KeptResults:
    """Folder of kept results.

    Parameters
    ----------
    folder : Path, new, empty, or one of this class

    Attributes
    ----------
    read, computed : int, results so far

    Raises
    ------
    InputError
        If the folder is anything else.
    """

    def __init__(self, folder: Path):
        self.folder, self.read, self.computed = Path(folder), 0, 0
        self._used: set[Path] = set()
        self._items: dict[Any, str] = {}
        note = self.folder / artefacts.MANIFEST
        if self.folder.is_dir() and any(self.folder.iterdir()):
            if not note.is_file() or artefacts.read_json(note).get("kind") != KIND:
                raise InputError(folder, "", f"exists and holds no {KIND}", "a new or empty folder")
            return
        artefacts.require_unicode(self.folder)
        self.folder.mkdir(parents=True, exist_ok=True)
        note.write_text(artefacts.manifest(KIND), encoding="utf-8")

    def over(self, workers: Map) -> Map:
        """Return a map that reads what the folder keeps, and keeps what ``workers`` computes."""

        def run(function: Callable[[Item], Result], items: Iterable[Item], /) -> Iterator[Result]:
            items = list(items)
            try:
                task = _sources() + digest_of(function)
                places = [self._place(task, item) for item in items]
            except TypeError:
                return workers(function, items)
            missing = [i for i, place in enumerate(places) if not place.is_file()]
            computed = dict.fromkeys(missing, workers(function, [items[i] for i in missing]))
            return self._results(function, items, places, computed)

        return run

    def _results(
        self,
        function: Callable[[Item], Result],
        items: list[Item],
        places: list[Path],
        computed: dict[int, Iterator[Result]],
    ) -> Iterator[Result]:
        for i, (item, place) in enumerate(zip(items, places, strict=True)):
            kept = None if i in computed else _read(place)
            if kept is None:
                self.computed += 1
                kept = _write(place, next(computed[i]) if i in computed else function(item))
            else:
                self.read += 1
            self._used.add(place)
            yield kept[0]

    def _place(self, task: str, item: Any) -> Path:
        """File of an item's result; a drive's table is read once."""
        try:
            digest = self._items.setdefault(item, "") or digest_of(item)
            self._items[item] = digest
        except TypeError:  # unhashable, as arrays are
            digest = digest_of(item)
        return self.folder / (hashlib.sha256((task + digest).encode()).hexdigest() + SUFFIX)

    def drop_unused(self) -> None:
        """Remove the results that this object did not use: those of earlier bounds."""
        for place in self.folder.glob("*" + SUFFIX):
            if place not in self._used:
                place.unlink()


def _write(place: Path, result: Any) -> tuple[Any]:
    """Keep a result; returns it as it will be read. A result that the codec does not know is not kept."""
    arrays: list[np.ndarray] = []
    try:
        form = encoded(result, arrays)
    except _UnknownError:
        return (result,)
    stream = io.BytesIO()
    np.savez(stream, np.array(json.dumps(form)), *arrays)
    data = stream.getvalue()
    data = hashlib.sha256(data).digest() + data
    new = place.with_suffix(".new")
    new.write_bytes(data)
    new.replace(place)
    read = _read(place)
    assert read is not None
    return read


def _read(place: Path) -> tuple[Any] | None:
    """A kept result; None where the file is damaged: its first bytes are the SHA-256 of the others."""
    content = place.read_bytes()
    digest, data = content[: hashlib.sha256().digest_size], content[hashlib.sha256().digest_size :]
    if hashlib.sha256(data).digest() != digest:
        return None
    with np.load(io.BytesIO(data), allow_pickle=False) as stored_arrays:
        form, *arrays = (stored_arrays[f"arr_{i}"] for i in range(len(stored_arrays.files)))
        return (decoded(json.loads(str(form)), arrays),)
