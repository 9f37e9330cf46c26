"""Write and read the files between the stages, each whole or not at all.

Every file names its schema, the tool's version and the hashes of its inputs. No file holds the clock time.

Folders     MANIFEST.json lists every other file of its folder with its SHA-256 (``files``). It ends with
            ``seal``, the SHA-256 of its own other content. Reading refuses a folder that differs from its
            manifest. A seal guards against accidents. It is no signature: whoever edits a file can compute
            both hashes again.
Replacing   A folder is replaced only by one of its kind and vehicle, and only while it holds exactly what its
            manifest lists. A single file is replaced when it is empty, has the same bytes, or carries the
            mark of the same command (`mark`).
Writing     A run writes in ``.NAME.lpvguard`` beside the target NAME and holds the kernel's lock on it. A
            killed run leaves this folder behind. The next run into the same target clears it, and first
            undoes a half-done swap.
"""

import hashlib
import json
import os
import re
import shutil
from collections.abc import Iterable, Iterator, Mapping
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any

import numpy as np

from .. import __version__
from . import system
from .errors import InputError

MANIFEST = "MANIFEST.json"
MARK_KEY = "written_by"
"""Key of a JSON output, or of each member of a list, with `mark` as its value."""
_SCRATCH, _NEW, _OLD, _LOCK = "lpvguard-scratch", "new", "old", "lpvguard-lock"
"""Names in a work folder: its marker, the new content, the replaced content, and the lock file."""
_held: dict[Path, Path] = {}
"""Work folders that this process holds, by target."""


def to_json(value: Any) -> str:
    """Return deterministic JSON text: arrays become lists, NaN becomes null, short values share a line.

    Parameters
    ----------
    value : Any

    Returns
    -------
    str
    """
    return _laid_out(_plain(value), "") + "\n"


def _laid_out(item: Any, indent: str, width: int = 100) -> str:
    """JSON of an item in one line where it fits; else scalars share lines and each container has its own."""
    text = json.dumps(item, allow_nan=False)
    if not isinstance(item, (dict, list)) or len(indent) + len(text) <= width:
        return text
    inner = indent + " "
    keys = [f"{json.dumps(key)}: " for key in item] if isinstance(item, dict) else [""] * len(item)
    members = list(item.values()) if isinstance(item, dict) else item
    parts = [key + _laid_out(member, inner, width) for key, member in zip(keys, members, strict=True)]
    scalars = not any(isinstance(member, (dict, list)) for member in members)
    lines = parts[:1]
    for part in parts[1:]:
        if scalars and len(inner) + len(lines[-1]) + len(part) + 3 <= width:
            lines[-1] += f", {part}"
        else:
            lines.append(part)
    return text[0] + "\n" + ",\n".join(inner + line for line in lines) + "\n" + indent + text[-1]


def _plain(item: Any) -> Any:
    """Convert an item to what JSON can hold."""
    if isinstance(item, dict):
        return {str(k): _plain(v) for k, v in item.items()}
    if isinstance(item, (list, tuple)):
        return [_plain(v) for v in item]
    if isinstance(item, (np.ndarray, np.generic)):
        return _plain(item.tolist())
    if isinstance(item, complex):
        return [_plain(item.real), _plain(item.imag)]
    if isinstance(item, float) and not np.isfinite(item):
        return None
    return item


def manifest(kind: str, **content: Any) -> str:
    """Return the manifest text of an artefact.

    Parameters
    ----------
    kind : str, the command that writes it
    **content : Any, further keys

    Returns
    -------
    str
    """
    return to_json({"kind": kind, "schema": 1, "tool": f"lpvguard {__version__}", **content})


def read_json(path: Path) -> Any:
    """Read the value of a JSON file.

    Parameters
    ----------
    path : Path

    Returns
    -------
    Any

    Raises
    ------
    InputError
        If the file cannot be read or is not JSON.
    """
    try:
        return json.loads(path.read_text(encoding="utf-8"))
    except OSError as error:
        raise InputError(
            path, "", f"cannot be read ({error.strerror})", "a file written by lpvguard"
        ) from None
    except ValueError as error:
        raise InputError(path, "", f"not valid JSON ({error})", "a file written by lpvguard") from None


@contextmanager
def reading(path: Path) -> Iterator[None]:
    """Turn errors about the shape of a file's content into an InputError that names the file.

    Parameters
    ----------
    path : Path, the file whose content the block takes apart

    Yields
    ------
    None

    Raises
    ------
    InputError
        If the block raises a lookup, type, value, attribute or arithmetic error.
    """
    try:
        yield
    except InputError:
        raise
    except (ArithmeticError, AttributeError, LookupError, TypeError, ValueError) as error:
        reason = str(error).splitlines()[0] if str(error) else ""
        what = f"has unexpected content ({type(error).__name__}: {reason})"
        raise InputError(path, "", what, "the file as lpvguard writes it") from None


def file_hash(path: Path) -> str:
    """Return the SHA-256 of a file's bytes; of a folder, that of its files' hashes.

    Parameters
    ----------
    path : Path

    Returns
    -------
    str
    """
    if path.is_dir():
        text = "".join(file_hash(p) for p in sorted(path.iterdir()) if p.is_file())
        return hashlib.sha256(text.encode()).hexdigest()
    with path.open("rb") as stream:
        return hashlib.file_digest(stream, "sha256").hexdigest()


def digest(document: dict[str, Any]) -> str:
    """SHA-256 of a JSON object without its ``seal``; order of keys and white space do not count."""
    content = _plain({k: v for k, v in document.items() if k != "seal"})
    text = json.dumps(content, sort_keys=True, separators=(",", ":"), allow_nan=False)
    return hashlib.sha256(text.encode()).hexdigest()


def sealed(document: dict[str, Any]) -> dict[str, Any]:
    """Return the JSON object with its digest as ``seal``.

    Parameters
    ----------
    document : dict[str, Any]

    Returns
    -------
    dict[str, Any]
    """
    return {**document, "seal": digest(document)}


def require_seal(path: Path, document: dict[str, Any], writer: str) -> None:
    """Require that a JSON object is as its writer sealed it.

    Parameters
    ----------
    path : Path, where the object was read
    document : dict[str, Any]
    writer : str, the command that writes it

    Raises
    ------
    InputError
        If the seal is missing or does not fit the content.
    """
    if document.get("seal") != digest(document):
        raise InputError(
            path,
            "seal",
            "missing, made by an earlier version"
            if "seal" not in document
            else f"does not fit the content: it was changed after {writer} wrote it",
            f"the file as {writer} writes it",
        )


def seal(folder: Path) -> None:
    """Complete a folder's manifest by the hashes of all other files and its own digest."""
    path = folder / MANIFEST
    document = {k: v for k, v in read_json(path).items() if k not in ("files", "seal")}
    files = {name: file_hash(folder / name) for name in _files_of(folder)}
    path.write_bytes(to_json(sealed({**document, "files": files})).encode())


def _files_of(folder: Path) -> list[str]:
    """Paths below ``folder`` without its manifest and plain folders."""
    below = (p for p in folder.rglob("*") if p.is_symlink() or not p.is_dir())
    return sorted(name for p in below if (name := p.relative_to(folder).as_posix()) != MANIFEST)


def _difference(folder: Path, listed: dict[str, str], *, may_lack: bool = False) -> tuple[str, str] | None:
    """First file in which ``folder`` differs from ``listed`` (name: hash), and how; None if they agree."""
    present = _files_of(folder)
    for name in sorted({*present, *listed}):
        path = folder / name
        if name not in listed:
            return name, f"is not listed in its {MANIFEST}"
        if name not in present:
            if not may_lack:
                return name, f"is missing, though listed in its {MANIFEST}"
        elif path.is_symlink() or not path.is_file() or file_hash(path) != listed[name]:
            return name, f"is not the file that its {MANIFEST} lists: it was changed after lpvguard wrote it"
    return None


def read_manifest(folder: Path, kind: str) -> dict[str, Any]:
    """Read the manifest of an artefact folder and compare the folder with it.

    Parameters
    ----------
    folder : Path
    kind : str, the command that writes such a folder

    Returns
    -------
    dict[str, Any]

    Raises
    ------
    InputError
        If there is none, its kind or schema differs, or any file differs from it.
    """
    folder = Path(folder)
    command = f"`lpvguard {'export' if kind == 'vehicle' else kind}`"
    if not (folder / MANIFEST).is_file():
        raise InputError(folder, MANIFEST, "missing", f"a folder written by {command}")
    document = read_json(folder / MANIFEST)
    if not isinstance(document, dict):
        raise InputError(folder / MANIFEST, "", "not an object", f"a folder written by {command}")
    if document.get("kind") != kind or document.get("schema") != 1:
        raise InputError(
            folder / MANIFEST,
            "kind, schema",
            f"{document.get('kind')!r}, {document.get('schema')!r}",
            f"{kind!r}, 1",
        )
    require_seal(folder / MANIFEST, document, command)
    with reading(folder / MANIFEST):
        differs = _difference(folder, document["files"])
    if differs:
        raise InputError(
            folder / differs[0], "", differs[1], f"the folder as {command} wrote it, or a new one"
        )
    return document


def first_difference(a: Any, b: Any, path: str = "") -> tuple[str, Any, Any] | None:
    """Find the first place in which two JSON values differ.

    Parameters
    ----------
    a, b : Any
    path : str, where the values stand, default ''

    Returns
    -------
    tuple (path, value in a, value in b), or None if they are equal
    """
    if isinstance(a, dict) and isinstance(b, dict):
        pairs = [(f"{path}.{k}" if path else k, a.get(k), b.get(k)) for k in dict.fromkeys([*a, *b])]
    elif isinstance(a, list) and isinstance(b, list) and len(a) == len(b):
        pairs = [(f"{path}[{i}]", x, y) for i, (x, y) in enumerate(zip(a, b, strict=False))]
    else:
        return None if a == b and isinstance(a, bool) == isinstance(b, bool) else (path, a, b)
    return next((d for p, x, y in pairs if (d := first_difference(x, y, p))), None)


def mark(kind: str) -> str:
    """Return the mark that a command leaves in each file that it writes.

    Parameters
    ----------
    kind : str

    Returns
    -------
    str
    """
    return f"lpvguard {kind}"


def marked(value: Any, kind: str, *, each: bool = False) -> Any:
    """Return a JSON value with its mark: an object, or every member of a list.

    Parameters
    ----------
    value : Any
    kind : str, the command that writes it
    each : bool, mark every member of an object instead, default False

    Returns
    -------
    Any
    """

    def one(item: Any) -> Any:
        return {MARK_KEY: mark(kind), **item} if isinstance(item, dict) else item

    if isinstance(value, list):
        return [one(item) for item in value]
    return {k: one(v) for k, v in value.items()} if each else one(value)


def _carries_mark(text: str, kind: str) -> bool:
    """Return whether the text is JSON, HTML, C, a DBC, an A2L or an FMU with the mark of ``kind``."""
    head = text[:2000]
    if re.search(rf'<meta name="generator" content="{re.escape(mark(kind))}">', head):
        return True
    if kind == "dbc" and head.startswith('VERSION "lpvguard"\n\nNS_ :\n'):
        return True
    begins = {"a2l": "ASAP2_VERSION 1 60\n/begin PROJECT lpvguard ", "fmu": "PK\3\4"}.get(kind)
    if begins and head.startswith(begins) and "lpvguard" in head:
        return True
    if head.startswith(f"/* {mark(kind)}: generated, do not edit."):
        return True
    try:
        value = json.loads(text)
    except ValueError:
        return False
    if isinstance(value, dict) and value.get(MARK_KEY) == mark(kind):
        return True
    members = (
        list(value.values()) if isinstance(value, dict) else value if isinstance(value, list) else [None]
    )
    return all(isinstance(m, dict) and m.get(MARK_KEY) == mark(kind) for m in members)


def _place(target: Path) -> Path:
    """Resolve ``target``. Raises InputError for the root and for a loop of links."""
    try:
        place = Path(target).resolve()
    except (OSError, RuntimeError) as error:
        raise InputError(target, "", f"cannot be written ({error})", "a writable place") from None
    if not place.name:
        raise InputError(target, "", "is the root of the file system", "a folder or file of its own")
    return place


def require_replaceable_folder(
    target: Path, kind: str | None = None, vehicle: str | None = None, *, resumed: bool = False
) -> None:
    """Require that a target is new, an empty folder, or a result of the same kind and vehicle.

    Parameters
    ----------
    target : Path
    kind, vehicle : str, optional, None allows any
    resumed : bool, the folder may lack listed files, default False

    Raises
    ------
    InputError
        If the folder may not be replaced; files that the manifest does not list are never replaced.
    """
    place = _place(target)
    expected = "a new or empty folder"
    if place == Path.cwd() or place in Path.cwd().parents:
        raise InputError(target, "-o", "is the current folder or lies above it", "a folder of its own")
    if not place.exists() or (place.is_dir() and not any(place.iterdir())):
        return
    if not place.is_dir() or not (place / MANIFEST).is_file():
        raise InputError(target, "-o", "exists and was not written by lpvguard", expected)
    document = read_json(place / MANIFEST)
    if (
        not isinstance(document, dict)
        or "kind" not in document
        or not isinstance(document.get("files"), dict)
        or document.get("seal") != digest(document)
    ):
        raise InputError(
            place / MANIFEST,
            "-o",
            "was changed or written by an earlier version, so the owner of its files is unknown",
            expected,
        )
    for key, expected_value in (("kind", kind), ("vehicle", vehicle)):
        if expected_value is not None and document.get(key) != expected_value:
            raise InputError(
                target,
                "-o",
                f"exists and holds another result: {key} {document.get(key)!r}, not {expected_value!r}",
                expected,
            )
    differs = _difference(place, document["files"], may_lack=resumed)
    if differs:
        raise InputError(place / differs[0], "-o", f"{differs[1]}; the folder is not replaced", expected)


def require_replaceable_file(target: Path, kind: str, data: bytes | None = None) -> None:
    """Require that a target is new, empty, has the same bytes or carries the mark of ``kind``.

    Devices and pipes are never refused.

    Parameters
    ----------
    target : Path
    kind : str
    data : bytes, optional, the new content

    Raises
    ------
    InputError
        If the file may not be replaced.
    """
    target = Path(target)
    if target.is_dir():
        raise InputError(target, "", "is a folder", "a file to write")
    if not target.is_file():
        return
    present = target.read_bytes()
    if present and present != data and not _carries_mark(present.decode("utf-8", "replace"), kind):
        raise InputError(target, "", f"exists and was not written by `lpvguard {kind}`", "a new file")


def _same(a: Path, b: Path) -> bool:
    try:
        return a == b or a.samefile(b)
    except OSError:
        return False


def require_unicode(path: Path) -> None:
    """Require that a path is UTF-8, because manifests, tables and pages name it.

    Parameters
    ----------
    path : Path

    Raises
    ------
    InputError
        If it is not.
    """
    try:
        str(path.absolute()).encode()
    except UnicodeEncodeError:
        raise InputError(repr(os.fsencode(path)), "", "the name is not UTF-8", "another name") from None


def require_apart(outputs: Iterable[Path], inputs: Iterable[Path]) -> None:
    """Require that no output is an input, lies inside one or lies above one.

    Hard and symbolic links are followed.

    Parameters
    ----------
    outputs, inputs : Iterable[Path]

    Raises
    ------
    InputError
        If an output and an input, or two outputs, overlap.
    """
    places = [(out, _place(out)) for out in outputs]
    others = [(path, Path(path).resolve()) for path in inputs]
    for index, (out, place) in enumerate(places):
        for path, other in [*others, *places[:index]]:
            inside = any(_same(p, other) for p in place.parents)
            above = any(_same(p, place) for p in other.parents)
            within = other.is_dir() and place.is_file() and any(_same(p, place) for p in other.iterdir())
            if _same(place, other) or inside or above or within:
                how = (
                    "lies inside" if inside else "lies above" if above else "is a file of" if within else "is"
                )
                raise InputError(
                    out,
                    "output",
                    f"{how} {path}, which this command reads or writes too",
                    "an output that is no input",
                )


def _work_of(place: Path) -> Path:
    return place.with_name(f".{place.name}.lpvguard")


@contextmanager
def _written(target: Path) -> Iterator[None]:
    """Turn errors of the operating system (a full disk, no permission) into one InputError."""
    try:
        yield
    except OSError as error:
        if error.filename is not None:
            place, path = _place(target), Path(os.fsdecode(error.filename)).absolute()
            if path not in place.parents and place.parent not in path.parents:
                raise  # of something else
        raise InputError(
            target, "", f"cannot be written ({error.strerror or error})", "a writable place"
        ) from None


@contextmanager
def claimed(target: Path) -> Iterator[Path]:
    """Hold the work folder of a target until the end of the block.

    The claim clears what a killed run left. One process may claim the same target again.

    Parameters
    ----------
    target : Path

    Yields
    ------
    Path, the work folder

    Raises
    ------
    InputError
        If another run holds it.
    """
    place = _place(target)
    if place in _held:
        yield _held[place]
        return
    work = _work_of(place)
    made = [p for p in (place.parent, *place.parent.parents) if not p.exists()]
    locks: list[int] = []
    try:
        with _written(target), system.undisturbed():
            place.parent.mkdir(parents=True, exist_ok=True)
            locks.append(_lock(target, work))
            _recover(place, work)
            (work / _SCRATCH).touch()
        _held[place] = work
        yield work
    finally:
        try:
            _release(place, work, locks, made)
        except (SystemExit, KeyboardInterrupt):  # a signal before its handler could be put off, or after
            _release(place, work, locks, made)
            raise


def _release(place: Path, work: Path, locks: list[int], made: list[Path]) -> None:
    """Clear the work folder, give the lock in ``locks`` back and remove empty folders ``made`` for it."""
    with system.undisturbed():
        _held.pop(place, None)
        while locks:
            with suppress(OSError, InputError):
                _recover(place, work)
                (work / _SCRATCH).unlink(missing_ok=True)
            with suppress(OSError):
                system.unlock_folder(locks.pop(), work, _LOCK)
        for folder in made:
            with suppress(OSError):
                folder.rmdir()  # stays when anything is in it


def _lock(target: Path, work: Path) -> int:
    """Make the work folder and lock it; InputError while another run holds it."""
    while True:
        work.mkdir(exist_ok=True)
        try:
            handle = system.lock_folder(work, _LOCK)
        except FileNotFoundError:
            continue  # its holder has just removed it
        if handle is None:
            raise InputError(target, "", "is held by another run that writes there", "one run at a time")
        return handle


def _recover(place: Path, work: Path) -> None:
    """Undo a half-done swap and clear a work folder; InputError when it holds foreign files."""
    names = {p.name for p in work.iterdir()} - {_LOCK}
    foreign = sorted(names - {_SCRATCH, _NEW, _OLD} if _SCRATCH in names else names)
    if foreign:
        raise InputError(
            work / foreign[0],
            "",
            "is in a folder where lpvguard writes, but lpvguard did not write it",
            "another place for it",
        )
    if _OLD in names and not os.path.lexists(place):
        (work / _OLD).rename(place)
    for name in (_NEW, _OLD):
        path = work / name
        if path.is_dir() and not path.is_symlink():
            shutil.rmtree(path)
        else:
            path.unlink(missing_ok=True)


def recover(target: Path) -> None:
    """Undo a swap of ``target`` that a killed run left half done.

    Parameters
    ----------
    target : Path
    """
    place = _place(target)
    if not place.exists() and (_work_of(place) / _OLD).exists():
        with claimed(target):
            pass


def _sync(path: Path) -> None:
    """Force a file, or a folder with all below it, onto the disk."""
    for item in ([*path.rglob("*")] if path.is_dir() else []) + [path]:
        system.sync(item)


def _swap(work: Path, place: Path) -> None:
    """Put the new folder in place of the old one, which `claimed` then clears."""
    _sync(work / _NEW)
    if not place.is_dir() or not any(place.iterdir()):
        system.rename_over(work / _NEW, place)
    elif not system.exchange(work / _NEW, place):
        # Killed between the two, the next run puts the old one back.
        place.rename(work / _OLD)
        (work / _NEW).rename(place)
    system.sync(place.parent)


@contextmanager
def new_folder(target: Path, kind: str, vehicle: str | None = None) -> Iterator[Path]:
    """Give a scratch folder that takes the target's place when the block succeeds.

    The block writes the files and a manifest of this kind. The folder is then sealed. It vanishes when the
    block fails.

    Parameters
    ----------
    target : Path
    kind : str
    vehicle : str, optional, see `require_replaceable_folder`

    Yields
    ------
    Path

    Raises
    ------
    InputError
        If the target may not be replaced or cannot be written.
    """
    with claimed(target) as work, _written(target):
        require_replaceable_folder(target, kind, vehicle)
        place, new = _place(target), work / _NEW
        new.mkdir()
        yield new
        seal(new)
        require_replaceable_folder(target, kind, vehicle)
        _swap(work, place)


@contextmanager
def new_file(target: Path, kind: str) -> Iterator[Path]:
    """Give a scratch file that takes the target's place when the block succeeds.

    Parameters
    ----------
    target : Path
    kind : str, see `require_replaceable_file`

    Yields
    ------
    Path

    Raises
    ------
    InputError
        If the target may not be replaced or cannot be written.
    """
    with claimed(target) as work, _written(target):
        require_replaceable_file(target, kind)
        yield work / _NEW
        _publish(work, _place(target))


def _publish(work: Path, place: Path) -> None:
    _sync(work / _NEW)
    system.rename_over(work / _NEW, place)
    system.sync(place.parent)


def write_file(target: Path, text: str, kind: str) -> None:
    """Write a text file as ``write_bytes`` does.

    Parameters
    ----------
    target : Path
    text : str
    kind : str, the command that writes it
    """
    write_bytes(target, text.encode(), kind)


def write_bytes(target: Path, data: bytes, kind: str) -> None:
    """Write a file whole or not at all.

    A device or pipe is written to, never replaced.

    Parameters
    ----------
    target : Path
    data : bytes
    kind : str, the command that writes it

    Raises
    ------
    InputError
        If the target may not be replaced or cannot be written.
    """
    target = Path(target)
    if target.exists() and not target.is_file() and not target.is_dir():
        with _written(target):
            target.write_bytes(data)
        return
    with claimed(target) as work, _written(target):
        require_replaceable_file(target, kind, data)
        (work / _NEW).write_bytes(data)
        _publish(work, _place(target))


def write_json(target: str, value: Any, kind: str, *, each: bool = False) -> None:
    """Write JSON with its mark to a file, or to standard output for ``-``.

    Parameters
    ----------
    target : str
    value : Any
    kind : str
    each : bool, see `marked`, default False

    Raises
    ------
    InputError
        If the target may not be replaced or cannot be written.
    """
    text = to_json(marked(value, kind, each=each))
    if target == "-":
        print(text, end="")
    else:
        write_file(Path(target), text, kind)


class KeptFolder:
    """Folder of a command that can be resumed.

    The manifest lists every file before it appears. Files that it does not list are never replaced.

    Parameters
    ----------
    folder, work : Path
    document : dict[str, Any]
    """

    def __init__(self, folder: Path, work: Path, document: dict[str, Any]):
        self.folder, self._work, self._document = folder, work, document

    def has(self, name: str) -> bool:
        """Whether the file is there."""
        return (self.folder / name).is_file()

    def write(self, name: str, data: bytes) -> None:
        """Write one file, whole or not at all."""
        with _written(self.folder / name):
            listed, value = self._document["files"], hashlib.sha256(data).hexdigest()
            if self.has(name):
                if listed.get(name) == value:
                    return
                if listed.get(name) != file_hash(self.folder / name):
                    raise InputError(
                        self.folder / name,
                        "",
                        "appeared while this command ran",
                        "no other files in its folder",
                    )
                (self.folder / name).unlink()
            self._document["files"] = dict(sorted({**listed, name: value}.items()))
            self._write_manifest()
            (self.folder / name).parent.mkdir(parents=True, exist_ok=True)
            (self._work / _NEW).write_bytes(data)
            _publish(self._work, self.folder / name)

    def _write_manifest(self) -> None:
        (self._work / _NEW).write_bytes(to_json(sealed(self._document)).encode())
        _publish(self._work, self.folder / MANIFEST)


@contextmanager
def kept_folder(target: Path, kind: str, **settings: Any) -> Iterator[KeptFolder]:
    """Give the folder of a command that can be stopped and resumed.

    Parameters
    ----------
    target : Path
    kind : str
    **settings : Any, the settings of the command, kept in the manifest

    Yields
    ------
    KeptFolder

    Raises
    ------
    InputError
        If the target holds anything else, or a result of other settings.
    """
    place = _place(target)
    document = json.loads(manifest(kind, **settings))
    with claimed(target) as work:
        if place.is_dir() and any(place.iterdir()) and not (place / MANIFEST).is_file():
            raise InputError(target, "-o", f"exists and is no {kind}", "a new or empty folder")
        require_replaceable_folder(target, kind, resumed=True)
        stored = read_json(place / MANIFEST) if (place / MANIFEST).is_file() else None
        if stored and {k: v for k, v in stored.items() if k not in ("files", "seal")} != document:
            raise InputError(
                target,
                "-o",
                f"holds a {kind} with other settings or another vehicle",
                "a new folder, or the same settings",
            )
        with _written(target):
            folder = KeptFolder(place, work, {**document, "files": stored["files"] if stored else {}})
            if not stored:
                place.mkdir(exist_ok=True)
                folder._write_manifest()
        yield folder


def write_files(folder: Path, files: Mapping[str, str | bytes]) -> None:
    """Write files into an existing folder, normally one of `new_folder`.

    Parameters
    ----------
    folder : Path
    files : Mapping[str, str, bytes], by name; text becomes UTF-8
    """
    for name, content in files.items():
        data = content.encode() if isinstance(content, str) else content
        (folder / name).write_bytes(data)
