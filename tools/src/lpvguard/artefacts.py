"""Files between the stages: written whole or not at all, named with schema, tool version and input hashes, no clock time."""

from __future__ import annotations

import json
import shutil
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np

from . import __version__
from .errors import InputError

MANIFEST = "MANIFEST.json"


def to_json(value: Any) -> str:
    """Deterministic JSON text; arrays become lists, NaN becomes null."""

    def plain(item: Any) -> Any:
        if isinstance(item, dict):
            return {str(k): plain(v) for k, v in item.items()}
        if isinstance(item, (list, tuple)):
            return [plain(v) for v in item]
        if isinstance(item, np.ndarray):
            return plain(item.tolist())
        if isinstance(item, np.generic):
            return plain(item.item())
        if isinstance(item, complex):
            return [plain(item.real), plain(item.imag)]
        if isinstance(item, float) and not np.isfinite(item):
            return None
        return item

    return json.dumps(plain(value), indent=1, allow_nan=False) + "\n"


def manifest(kind: str, **content: Any) -> str:
    """Manifest text of an artefact of ``kind``."""
    return to_json({"kind": kind, "schema": 1, "tool": f"lpvguard {__version__}", **content})


def read_json(path: Path) -> Any:
    try:
        return json.loads(path.read_text(encoding="utf-8"))
    except OSError as error:
        raise InputError(path, "", f"cannot be read ({error.strerror})", "a file written by lpvguard") from None
    except ValueError as error:
        raise InputError(path, "", f"not valid JSON ({error})", "a file written by lpvguard") from None


def read_manifest(folder: Path, kind: str) -> dict[str, Any]:
    """Manifest of an artefact folder; InputError when it is none, of another kind or of another schema."""
    if not (folder / MANIFEST).is_file():
        raise InputError(folder, MANIFEST, "missing", f"a folder written by `lpvguard {kind}`")
    found = read_json(folder / MANIFEST)
    if not isinstance(found, dict) or found.get("kind") != kind or found.get("schema") != 1:
        raise InputError(folder / MANIFEST, "kind, schema", f"{found.get('kind')!r}, {found.get('schema')!r}",
                         f"{kind!r}, 1")
    return found


@contextmanager
def new_folder(target: Path) -> Iterator[Path]:
    """A scratch folder beside ``target`` that takes its place when the block succeeds and vanishes when it fails.

    An existing target is replaced only when it is empty or was written by lpvguard (it has a manifest).
    """
    target = Path(target)
    if target.exists() and (not target.is_dir() or (any(target.iterdir()) and not (target / MANIFEST).is_file())):
        raise InputError(target, "-o", "exists and was not written by lpvguard", "a new or empty folder")
    try:
        target.parent.mkdir(parents=True, exist_ok=True)
        scratch = Path(tempfile.mkdtemp(prefix=f".{target.name}-", dir=target.parent))
    except OSError as error:
        raise InputError(target, "-o", f"cannot be written ({error.strerror})", "a writable place") from None
    try:
        scratch.chmod(0o755)
        yield scratch
        # Two renames and no deletion in between: whoever is killed here leaves the old folder or the new one, whole.
        old = scratch.with_name(scratch.name + "-old")
        if target.exists():
            target.rename(old)
        scratch.rename(target)
        shutil.rmtree(old, ignore_errors=True)
    finally:
        shutil.rmtree(scratch, ignore_errors=True)


def write_file(target: Path, text: str) -> None:
    """Write a text file whole or not at all. A device or pipe is written to, never replaced."""
    target = Path(target)
    try:
        if target.exists() and not target.is_file():
            target.write_text(text, encoding="utf-8")
            return
        target.parent.mkdir(parents=True, exist_ok=True)
        with tempfile.NamedTemporaryFile("w", encoding="utf-8", dir=target.parent, prefix=f".{target.name}-",
                                         delete=False) as stream:
            stream.write(text)
        Path(stream.name).chmod(0o644)
        Path(stream.name).rename(target)
    except OSError as error:
        raise InputError(target, "", f"cannot be written ({error.strerror})", "a writable place") from None


def write_files(folder: Path, files: dict[str, str | bytes]) -> None:
    """Write files into an existing folder, normally one of ``new_folder``."""
    for name, content in files.items():
        data = content.encode() if isinstance(content, str) else content
        (folder / name).write_bytes(data)
